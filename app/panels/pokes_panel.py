"""The Pokes tab: all pokes, newest first, with their outcomes.

Cells are computed for the visible rows only: a session has thousands of pokes, and each new one changes the tilts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import (
    QAbstractTableModel,
    QEvent,
    QItemSelection,
    QItemSelectionModel,
    QModelIndex,
    QPersistentModelIndex,
    Qt,
    Signal,
)
from PySide6.QtGui import QColor
from PySide6.QtWidgets import QAbstractItemView, QHeaderView, QTableView

from app.panels.panel import Panel
from app.panels.widgets import escape_tooltip, make_copyable, secondary_label, theme_colours
from app.state.view_state import ViewState
from app.theme import WIDGET_GAP_PX
from skincal.contacts.outcome import Contact, Outcome, Rejection
from skincal.model.actions import MissedLandmark
from skincal.session.snapshot import PokeRecord, Snapshot
from skincal.taxels.poke_figures import doubting, force_of, peak_channel, pitch_of, tilt_of
from skincal.taxels.result import Estimate
from skincal.words.poke_words import missed_words, poke_count_words, rejection_words, short_rejection, words_of_reason
from skincal.words.taxel_words import doubt_mark, doubt_words
from skincal.words.units import DASH, ChannelNames, cell, number

if TYPE_CHECKING:
    from skincal.following.guided_session import GuidedSession

_Index = QModelIndex | QPersistentModelIndex
HEADINGS = ("#", "Outcome", "Taxel", "Force\nN", "Tilt\n\N{DEGREE SIGN}", "Twist\nmm")
_COLUMN_HINTS = (
    "Number of the poke in the session",
    "Accepted, or why not",
    "Taxel that answered most, and how many more did",
    "Force of the poke",
    "Angle between the push and the inward normal",
    "Moment about the push over the force: beyond the noise it shows a second contact or a torque",
)

_WIDEST_CELLS = ("00000", "", "0000 +0", "Force", "Tilt0", "Twist0")
"""Widest text of each column; the empty one takes the rest."""


class PokeTable(QAbstractTableModel):
    """The pokes of a snapshot, newest first."""

    def __init__(self, names: ChannelNames) -> None:
        super().__init__()
        self._names = names
        self._records: tuple[PokeRecord, ...] = ()
        self._estimates: Mapping[int, Estimate] = {}
        self._doubting: Mapping[int, Sequence[Estimate]] = {}
        self._at_landmarks: Mapping[int, str] = {}
        self._taken = frozenset[int]()  # Taken from their landmark by the operator
        self._missed: Mapping[int, MissedLandmark] = {}

    def show(self, snapshot: Snapshot, estimates: Mapping[int, Estimate]) -> None:
        """Show the pokes of another snapshot; tell the view what changed."""
        records = snapshot.pokes
        self._estimates, self._at_landmarks = estimates, snapshot.at_landmarks
        self._taken = snapshot.decisions.taken_from_landmarks
        self._missed = snapshot.decisions.missed_landmarks
        self._doubting = doubting(estimates.values())
        old, added = self._records, len(records) - len(self._records)
        # Pokes are only added at the end; anything else, for example after an undo, is another list.
        if added < 0 or any(a.outcome.poke != b.outcome.poke for a, b in zip(old[-1:], records[len(old) - 1 :], strict=False)):
            self.beginResetModel()
            self._records = records
            self.endResetModel()
            return
        if added:
            self.beginInsertRows(QModelIndex(), 0, added - 1)
            self._records = records
            self.endInsertRows()
        self._records = records
        # Outcome and tilt of all pokes follow the estimates; the view reads its visible rows only.
        if records:
            self.dataChanged.emit(self.index(0, 0), self.index(len(records) - 1, len(HEADINGS) - 1))

    def record(self, row: int) -> PokeRecord:
        return self._records[len(self._records) - 1 - row]

    def row_of(self, poke: int) -> int | None:
        return next((len(self._records) - 1 - i for i, r in enumerate(self._records) if r.outcome.poke == poke), None)

    def rowCount(self, parent: _Index = QModelIndex()) -> int:  # noqa: B008
        # Qt also asks for the children of cells: a table has none.
        return 0 if parent.isValid() else len(self._records)

    def columnCount(self, parent: _Index = QModelIndex()) -> int:  # noqa: B008
        return 0 if parent.isValid() else len(HEADINGS)

    def headerData(self, section: int, orientation: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        if orientation is not Qt.Orientation.Horizontal:
            return None
        if role == Qt.ItemDataRole.TextAlignmentRole:
            return int(_alignment(section) | Qt.AlignmentFlag.AlignVCenter)
        return {Qt.ItemDataRole.DisplayRole: HEADINGS[section], Qt.ItemDataRole.ToolTipRole: _COLUMN_HINTS[section]}.get(
            Qt.ItemDataRole(role)
        )

    def data(self, index: _Index, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        record = self.record(index.row())
        if role == Qt.ItemDataRole.DisplayRole:
            return self._text(record, index.column())
        if role == Qt.ItemDataRole.TextAlignmentRole:
            return int(_alignment(index.column()) | Qt.AlignmentFlag.AlignVCenter)
        if role == Qt.ItemDataRole.ForegroundRole:
            return self._colour(record, index.column())
        if role == Qt.ItemDataRole.ToolTipRole:
            return escape_tooltip(self._hint(record))
        return None

    def _colour(self, record: PokeRecord, column: int) -> QColor | None:
        colours = theme_colours()
        if self._is_out(record):
            return QColor(colours.muted)
        if isinstance(record.outcome, Rejection) and record.outcome.poke not in self._at_landmarks:
            return QColor(colours.bad if column == 1 else colours.muted)
        return QColor(colours.accent) if column == 1 else None

    def _is_out(self, record: PokeRecord) -> bool:
        return record.excluded or (isinstance(record.outcome, Rejection) and record.outcome.poke in self._taken)

    def _hint(self, record: PokeRecord) -> str:
        outcome = record.outcome
        if isinstance(outcome, Rejection):
            name, missed = self._at_landmarks.get(outcome.poke), self._missed.get(outcome.poke)
            if missed is not None:
                return missed_words(missed)
            return rejection_words(outcome) if name is None else f"at landmark {name}, where no taxel needs to answer"
        answered = ", ".join(self._names.short(int(c)) for c in outcome.channels)
        pose = f"\narm pose {outcome.pose}" if outcome.pose else ""
        change = (
            f"\nsensor zero changed by {number(outcome.tare_change, 2)} N" if outcome.tare_change == outcome.tare_change else ""
        )
        doubters = () if record.excluded else self._doubting.get(outcome.poke, ())
        doubts = "".join(f"\n{doubt_words(outcome, estimate, self._names)}" for estimate in doubters)
        return f"answered: {answered}{pose}{change}{doubts}"

    def _text(self, record: PokeRecord, column: int) -> str:
        outcome = record.outcome
        if column == 0:
            return str(outcome.poke)
        if column == 1 and not record.excluded and outcome.poke in self._at_landmarks:
            return f"\N{WHITE DIAMOND} {self._at_landmarks[outcome.poke]}"
        if column == 1 and isinstance(outcome, Rejection) and outcome.poke in self._missed:
            return f"\N{BALLOT X} not at {self._missed[outcome.poke].name}"
        if column == 1 and self._is_out(record):
            return "\N{CIRCLED MINUS} excluded"
        if column == 1:
            return _outcome_text(record.outcome, doubt_mark(outcome.poke, self._doubting.get(outcome.poke, ()), self._names))
        if column == 2:
            return self._taxel(record)
        return self._measured(outcome, column) if isinstance(outcome, Contact) else ""

    def _taxel(self, record: PokeRecord) -> str:
        peak = peak_channel(record.outcome)
        if peak is None:
            return DASH
        more = len(record.outcome.channels) - 1
        return self._names.short(peak) + (f" +{more}" if more else "")

    def _measured(self, contact: Contact, column: int) -> str:
        force = force_of(contact)
        if force is None or column == 3:
            return number(force, 1)
        if column == 4:
            return cell(tilt_of(contact, self._estimates), "rad", 0)
        return cell(pitch_of(contact), "m")


def _outcome_text(outcome: Outcome, doubt: str) -> str:
    if isinstance(outcome, Rejection):
        return f"\N{BALLOT X} {short_rejection(outcome)}"
    return f"\N{CIRCLE WITH LEFT HALF BLACK} {doubt}" if doubt else "\N{CHECK MARK} accepted"


def _alignment(column: int) -> Qt.AlignmentFlag:
    return Qt.AlignmentFlag.AlignLeft if column in (1, 2) else Qt.AlignmentFlag.AlignRight


class PokesPanel(Panel):
    """A table of pokes, and a line that counts the rejections."""

    title = "Pokes"
    selection_changed = Signal()

    def __init__(self, guided: GuidedSession) -> None:
        super().__init__()
        self.model = PokeTable(guided.names)
        self.table = QTableView(showGrid=False)
        self.table.setModel(self.model)
        self.tally = secondary_label(wrap=True)
        self.tally.setContentsMargins(WIDGET_GAP_PX, WIDGET_GAP_PX // 2, WIDGET_GAP_PX, WIDGET_GAP_PX // 2)
        table = self.table
        table.setAccessibleName("pokes")
        make_copyable(table)
        # Tab goes to the next part of the window, as everywhere.
        table.setTabKeyNavigation(False)
        table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        table.setSelectionMode(QAbstractItemView.SelectionMode.ExtendedSelection)
        table.verticalHeader().hide()
        table.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        header = table.horizontalHeader()
        header.setHighlightSections(False)
        header.setMinimumSectionSize(24)
        for column, text in enumerate(_WIDEST_CELLS):
            header.setSectionResizeMode(column, QHeaderView.ResizeMode.Fixed if text else QHeaderView.ResizeMode.Stretch)
        self._fit_cells()
        table.selectionModel().selectionChanged.connect(self._selection_changed)
        self.fill(self.tally, (self.table, 1), gap=0)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setWhatsThis(
            "Every poke, newest first, with its outcome. An excluded poke stays in the recording, is not used for the "
            "estimates, and can be restored."
        )

    def _fit_cells(self) -> None:
        metrics = self.fontMetrics()
        self.table.verticalHeader().setDefaultSectionSize(metrics.height() + 8)
        for column, text in enumerate(_WIDEST_CELLS):
            if text:
                header = self.table.horizontalHeader()
                header.resizeSection(column, max(metrics.horizontalAdvance(text) + 12, header.sectionSizeHint(column)))

    def changeEvent(self, event: QEvent) -> None:
        super().changeEvent(event)
        if event.type() is QEvent.Type.FontChange:
            self._fit_cells()

    def depends_on(self, state: ViewState) -> tuple[object, ...]:
        return state.revision, state.method

    def update_view(self, state: ViewState) -> None:
        self.model.show(state.snapshot, state.by_channel())
        self.tally.setText(tally_words(state.snapshot))

    def selected(self) -> tuple[int, ...]:
        """Return the numbers of the selected pokes, ascending."""
        rows = self.table.selectionModel().selectedRows()
        return tuple(sorted(self.model.record(index.row()).outcome.poke for index in rows))

    def select(self, poke: int) -> None:
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


MAX_NAMED_REASONS = 4  # Reasons of rejections that are counted apart


def tally_words(snapshot: Snapshot) -> str:
    """Count the pokes and the reasons of rejections."""
    rejected = list(snapshot.poke_counts.rejected.items())[:MAX_NAMED_REASONS]
    arm_pose = next((record.outcome.pose for record in reversed(snapshot.pokes) if record.outcome.pose), "")
    counted = ", ".join(f"{words_of_reason(reason, arm_pose)}: {n}" for reason, n in rejected)
    return poke_count_words(snapshot.poke_counts, f" ({counted})" if counted else "")
