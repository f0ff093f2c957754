"""The list of pokes: what each ended as, undo, exclude and restore."""

from __future__ import annotations

from collections import Counter

from PySide6.QtCore import QItemSelection, QItemSelectionModel, QPoint, Qt, Signal
from PySide6.QtGui import QAction
from PySide6.QtWidgets import QAbstractItemView, QHeaderView, QMenu, QTableView, QVBoxLayout, QWidget

from app.display_units import ChannelNames
from app.panels.poke_table import PokeTable
from app.panels.texts import put, quiet
from app.state.view_state import ViewState
from app.theme import GAP, Colours
from app.words import peak_channel, pokes_words, rejections
from skincal.session.snapshot import Snapshot


class PokesPanel(QWidget):
    """A table of pokes and a line that counts why pokes were rejected."""

    selection_changed = Signal()
    taxel_wanted = Signal(int)
    """A poke was chosen by hand: the channel that answered it most."""

    def __init__(self, names: ChannelNames, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.model = PokeTable(names)
        self.table = QTableView()
        self.table.setModel(self.model)
        self.tally = quiet(wrap=True)
        self.tally.setContentsMargins(GAP, GAP // 2, GAP, GAP // 2)
        self.actions_offered: list[QAction] = []
        self._generation: tuple[object, object] = (None, None)
        self._prepare()
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(0)
        column.addWidget(self.tally)
        column.addWidget(self.table, 1)
        self.setWhatsThis(
            "Every poke, newest first, with what it ended as. An excluded poke stays in the recording, counts for nothing "
            "and can be restored; the estimates follow at once."
        )

    def _prepare(self) -> None:
        table = self.table
        table.setAccessibleName("pokes")
        table.setTabKeyNavigation(False)
        table.setShowGrid(False)
        table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        table.setSelectionMode(QAbstractItemView.SelectionMode.ExtendedSelection)
        table.setContextMenuPolicy(Qt.ContextMenuPolicy.CustomContextMenu)
        table.verticalHeader().hide()
        table.verticalHeader().setDefaultSectionSize(table.fontMetrics().height() + 8)
        table.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        header = table.horizontalHeader()
        header.setHighlightSections(False)
        header.setMinimumSectionSize(24)
        for column, text in enumerate(("00000", "", "00-00 +0", "00.0", "00\N{DEGREE SIGN}0", "Pitch0")):
            fixed = QHeaderView.ResizeMode.Stretch if not text else QHeaderView.ResizeMode.Fixed
            header.setSectionResizeMode(column, fixed)
            if text:
                header.resizeSection(column, table.fontMetrics().horizontalAdvance(text) + 12)
        table.selectionModel().selectionChanged.connect(self._selection_changed)
        table.customContextMenuRequested.connect(self._menu)

    def show_state(self, state: ViewState) -> None:
        """Show the pokes of a tick; nothing happens where they are the same."""
        generation = (state.revision, state.method)
        if generation == self._generation:
            return
        self._generation = generation
        self.model.show(state.snapshot, state.by_channel())
        put(self.tally, tally_words(state.snapshot))

    def set_colours(self, colours: Colours) -> None:
        """Follow the theme."""
        self.model.set_colours(colours)
        self.table.viewport().update()

    def selected(self) -> tuple[int, ...]:
        """Return the numbers of the selected pokes, ascending."""
        rows = self.table.selectionModel().selectedRows()
        return tuple(sorted(self.model.record(index.row()).outcome.poke for index in rows))

    def select(self, poke: int) -> None:
        """Select a poke by its number and bring it into sight."""
        row = self.model.row_of(poke)
        if row is not None:
            flags = QItemSelectionModel.SelectionFlag
            index = self.model.index(row, 0)
            self.table.selectionModel().setCurrentIndex(index, flags.ClearAndSelect | flags.Rows)
            self.table.scrollTo(index)

    def _selection_changed(self, _new: QItemSelection, _old: QItemSelection) -> None:
        self.selection_changed.emit()
        rows = self.table.selectionModel().selectedRows()
        if len(rows) == 1:
            peak = peak_channel(self.model.record(rows[0].row()).outcome)
            if peak is not None:
                self.taxel_wanted.emit(peak)

    def _menu(self, place: QPoint) -> None:
        menu = QMenu(self)
        menu.addActions(self.actions_offered)
        menu.popup(self.table.viewport().mapToGlobal(place))


def tally_words(snapshot: Snapshot) -> str:
    """Return how many pokes there are and why some do not count."""
    reasons = Counter(outcome.reason.value for outcome in rejections(snapshot))
    told = ", ".join(f"{reason}: {n}" for reason, n in reasons.most_common(4))
    return pokes_words(snapshot, f" ({told})" if told else "")
