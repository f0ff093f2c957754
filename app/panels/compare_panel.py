"""The panel that compares two sets of places: arrows of difference in the 3D view, and here what they come to.

It works, and the 3D view draws the arrows, only while the panel is on the screen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QHideEvent, QShowEvent
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QScrollArea,
    QTreeWidget,
    QVBoxLayout,
)

from app.panels.widgets import (
    TaxelList,
    embolden,
    fit_rows,
    on_panel,
    plain_tip,
    put_rows,
    quiet,
    short_box,
    table,
    theme_colours,
)
from app.scene3d.scene_state import DARK, LIGHT, Cloud, Comparison, Tint
from app.state.place_sets import Pair, PlaceOrigin, Places, Source, default_pair, sources_of
from app.state.view_state import ViewState
from app.text.compare_text import (
    ARROW_SCALES,
    MODULE_HEADINGS,
    MODULE_HINTS,
    arrow_words,
    difference_words,
    listed_modules,
    listed_words,
    misfit_words,
    module_cells,
    motion_words,
    save_hint,
    scale_choice,
    source_words,
    spacing_words,
    worst_words,
)
from app.theme import GAP
from skincal.geometry import FloatArray
from skincal.model.skin import Layout
from skincal.modules.health import PlannedNeighbours, neighbours_of
from skincal.session.error_history import ModulesFound
from skincal.taxels.differences import ModuleDifference, repeatability, worst_rows
from skincal.taxels.result import Method
from skincal.words.units import ChannelNames

if TYPE_CHECKING:
    from skincal.session.part import Part

WORST = 10
"""Taxels in the list of the worst."""
ROWS_SHOWN = 7
"""Modules that are seen at once: those of a forearm; beyond it the list scrolls."""
BLACK_DOT, ARROW = "\N{BLACK CIRCLE}", "\N{RIGHTWARDS ARROW}"
TINTS = {Method.FREE: Tint.FREE, Method.SURFACE: Tint.SURFACE, Method.MODULES: Tint.MODULES}


class ComparePanel(QScrollArea):
    """What is compared above, how far it lies apart below, module by module and taxel by taxel."""

    taxel_wanted = Signal(int)
    comparison_changed = Signal(object)
    """`Comparison`, or None while nothing is compared."""
    layout_wanted = Signal(object)
    """`LayoutRepair`: the corrected layout is to be saved."""
    file_wanted = Signal()
    """The operator is to choose a file of places."""
    session_wanted = Signal()
    """And this the folder of another session."""

    def __init__(self, part: Part, methods: tuple[Method, ...], names: ChannelNames) -> None:
        super().__init__()
        self._methods = methods
        self._names = names
        self._layout = part.scene.skin.layout
        self._channels = part.channels
        self._places = Places(part.channels, None if part.laid is None else part.laid.places)
        self._neighbours: PlannedNeighbours | None = None
        """Of the layout; made when first needed."""
        self._found: ModulesFound | None = None
        self._state: ViewState | None = None
        self._sources: tuple[Source, ...] = ()
        self._chosen: Pair | None = None
        """What the operator chose; None while they chose nothing."""
        self._shown: tuple[object, ...] = ()
        self.boxes = (short_box("from"), short_box("to"))
        self.all = QCheckBox("all")
        self.scale = QComboBox()
        self.legend = QLabel()
        self.add_file, self.add_session = (QPushButton(f"Add {what}\N{HORIZONTAL ELLIPSIS}") for what in ("file", "session"))
        self.summary = QLabel()
        self.motion = quiet(wrap=True)
        self.health = QLabel()
        self.save = QPushButton("Save the corrected layout\N{HORIZONTAL ELLIPSIS}")
        self.spacing = quiet(wrap=True)
        self.listed = quiet()
        self.modules = table("modules", MODULE_HEADINGS, MODULE_HINTS)
        self.worst = TaxelList("taxels that lie farthest apart")
        self._fill()
        self._arrange()
        self._connect()

    def _fill(self) -> None:
        self.scale.addItems([scale_choice(scale) for scale in ARROW_SCALES])
        self.scale.setAccessibleName("length of the arrows")
        self.scale.setToolTip("How many times their own length the arrows are drawn")
        self.all.setToolTip("Show the layout and every method's places over each other")
        self.modules.setSelectionMode(QTreeWidget.SelectionMode.NoSelection)
        self.modules.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        # The space bar pauses: Enter presses the button that has the focus.
        for button in (self.save, self.add_file, self.add_session):
            button.setAutoDefault(True)
        self.add_file.setToolTip("Compare with a calibration (JSON, CSV, iCub) or a truth.json")
        self.add_session.setToolTip("Compare with another recorded session, by each of its methods")
        embolden(self.summary)
        for label in (self.legend, self.summary, self.health):
            label.setWordWrap(True)
        self.legend.setTextFormat(Qt.TextFormat.RichText)
        self.legend.setProperty("rich", True)
        self.setWhatsThis(
            "How far the places of the taxels lie apart by two ways to know them. Errors of the rig move whole modules, so a "
            "module's difference is given in two: its shift, and what is left after its best turn and shift, its shape."
        )

    def _arrange(self) -> None:
        choices = QGridLayout()
        choices.setHorizontalSpacing(GAP)
        choices.setVerticalSpacing(GAP // 2)
        choices.setColumnStretch(1, 1)
        for row, (text, box, other) in enumerate(zip(("From", "To"), self.boxes, (self.all, self.scale), strict=True)):
            choices.addWidget(quiet(text), row, 0)
            choices.addWidget(box, row, 1)
            choices.addWidget(other, row, 2)
        more = QHBoxLayout()
        more.addWidget(self.add_file)
        more.addWidget(self.add_session)
        more.addStretch(1)
        choices.addLayout(more, 2, 1, 1, 2)
        inner = on_panel(self)
        column = QVBoxLayout(inner)
        column.setContentsMargins(GAP, GAP, GAP, GAP)
        column.addLayout(choices)
        for widget in (self.legend, self.summary, self.motion, self.health):
            column.addWidget(widget)
        column.addWidget(self.save, 0, Qt.AlignmentFlag.AlignLeft)
        for widget in (self.listed, self.modules, self.spacing):
            column.addWidget(widget)
        column.addWidget(quiet("Farthest apart"))
        column.addWidget(self.worst, 1)
        for empty in (self.health, self.save, self.listed, self.motion):
            empty.hide()
        for widget in (self.modules, self.spacing):
            widget.setVisible(self._layout is not None)
        self.setWidget(inner)
        # What is found is saved by Tab and Enter.
        self.setTabOrder(self.scale, self.save)

    def _connect(self) -> None:
        for box in self.boxes:
            # Of the operator's hand alone: Qt does not send it for what the program sets.
            box.activated.connect(self._choose)
        self.all.toggled.connect(self.show_again)
        self.scale.activated.connect(self.show_again)
        self.worst.taxel_wanted.connect(self.taxel_wanted)
        self.save.clicked.connect(self._save_wanted)
        self.add_file.clicked.connect(self.file_wanted)
        self.add_session.clicked.connect(self.session_wanted)

    # Showing

    def show_state(self, state: ViewState) -> None:
        """Compare the places of a tick; nothing happens where they are the same, or where nobody sees it."""
        self._state = state
        if not self.isVisible():
            return
        self._found = state.modules
        choices = (self._chosen, self.all.isChecked(), self.scale.currentIndex())
        shown = (state.revision, state.method, state.review, state.modules, *choices)
        if shown == self._shown:
            return
        self._shown = shown
        self._show_sources(state)
        pair = self.pair(state)
        here, there = (self._places.find(source, state) for source in pair)
        self._show_numbers(pair, here, there)
        self._show_health(state)
        self._draw(state, here, there)

    def pair(self, state: ViewState) -> Pair:
        """Return what is compared: what the operator chose as long as it is there."""
        chosen = self._chosen
        if chosen is not None and set(chosen) <= set(self._sources):
            return chosen
        return default_pair(self._sources, state.method)

    def _show_sources(self, state: ViewState) -> None:
        sources = sources_of(self._methods, state.review, laid=self._places.laid, others=self._places.others)
        # A box that is filled anew closes its list under the operator's hand.
        if sources != self._sources:
            self._sources = sources
            for box in self.boxes:
                box.clear()
                box.addItems([source_words(source) for source in sources])
        for box, source in zip(self.boxes, self.pair(state), strict=True):
            box.setCurrentIndex(sources.index(source))

    def _show_numbers(self, pair: Pair, here: FloatArray, there: FloatArray) -> None:
        owners = None if self._layout is None else self._layout.module_of[self._channels]
        found = repeatability(here, there, owners)
        lengths, channels = found.lengths, self._channels.tolist()
        self.summary.setText(difference_words(found.summary, pair, self._names, channels))
        self.motion.setText("" if pair[0] == pair[1] else motion_words(found.motion))
        self.motion.setVisible(bool(self.motion.text()))
        rows = [] if pair[0] == pair[1] else worst_rows(lengths, WORST).tolist()
        self.worst.show_taxels([(channels[row], worst_words(channels[row], float(lengths[row]), self._names)) for row in rows])
        if self._layout is not None:
            self._show_modules(self._layout, found.modules, there)

    def _show_modules(self, layout: Layout, every: Sequence[ModuleDifference], there: FloatArray) -> None:
        spacing, modules = self._ratios(there), layout.modules
        self.listed.setText(listed_words(len(every)))
        self.listed.setVisible(bool(self.listed.text()))
        cells = [
            module_cells(found, modules[found.module].id, len(modules[found.module].channels), float(spacing[found.module]))
            for found in listed_modules(every)
        ]
        put_rows(self.modules, cells)
        fit_rows(self.modules, ROWS_SHOWN)

    def _ratios(self, places: FloatArray) -> FloatArray:
        """Return how far neighbours lie apart over the layout's spacing, module by module and at last over all."""
        if self._layout is None:
            return np.full(1, np.nan)
        if self._neighbours is None:
            self._neighbours = neighbours_of(self._layout)
        return self._neighbours.ratios(self._channels, places)

    def _show_health(self, state: ViewState) -> None:
        ratios = {
            method: float(self._ratios(self._places.find(Source(PlaceOrigin.METHOD, method), state))[-1])
            for method in self._methods
        }
        self.spacing.setText(spacing_words(ratios))
        found = state.modules
        sentences = () if found is None else misfit_words(found.mend, found.judged, found.method)
        self.health.setText("\n".join(sentences))
        self.health.setVisible(bool(sentences))
        self.save.setVisible(found is not None and bool(found.mend.changes))
        if found is not None:
            self.save.setToolTip(plain_tip(save_hint(found.mend)))

    def _save_wanted(self) -> None:
        if self._found is not None:
            self.layout_wanted.emit(self._found.mend)

    def _draw(self, state: ViewState, here: FloatArray, there: FloatArray) -> None:
        """Have the 3D view draw it, and say what is what there."""
        scale = ARROW_SCALES[self.scale.currentIndex()]
        first, second = self.pair(state)
        sets = [(Tint.FROM, first), (Tint.TO, second)]
        if self.all.isChecked():
            sources = [source for source in self._sources if source.origin in (PlaceOrigin.LAYOUT, PlaceOrigin.METHOD)]
            sets = [(Tint.LAYOUT if source.method is None else TINTS[source.method], source) for source in sources]
        clouds = tuple(Cloud(tint, self._places.find(source, state)) for tint, source in sets)
        # Words that belong to a sign are not parted at the end of a line.
        dots = [f"{_sign(BLACK_DOT, tint)}&nbsp;{escape(source_words(source)).replace(' ', '&nbsp;')}" for tint, source in sets]
        arrows = _sign(ARROW, Tint.TO) + "&nbsp;" + escape(arrow_words((first, second), scale, named=self.all.isChecked()))
        self.legend.setText("&nbsp;&nbsp; ".join([*dots, arrows]))
        ends = np.stack([here, here + scale * (there - here)], axis=1)
        self.comparison_changed.emit(Comparison(clouds, ends))

    def showEvent(self, event: QShowEvent) -> None:
        """Compare what came while it was hidden."""
        super().showEvent(event)
        self.show_again()

    def hideEvent(self, event: QHideEvent) -> None:
        """Show the estimates again in the 3D view."""
        super().hideEvent(event)
        self._shown = ()
        self.comparison_changed.emit(None)

    # What the operator wants

    @property
    def others(self) -> tuple[Source, ...]:
        """The sets of places that were offered."""
        return self._places.others

    def offer(self, source: Source, places: Mapping[int, FloatArray], *, choose: bool = False) -> None:
        """Take a set of places, as for `Places.offer`; where the operator asked for it, `choose` it in place of the second."""
        self._places.offer(source, places)
        if choose and self._state is not None:
            self._chosen = self.pair(self._state)[0], source
        self.show_again()

    def show_again(self) -> None:
        """Show the newest tick anew, in the colours that hold now."""
        self._shown = ()
        if self._state is not None:
            self.show_state(self._state)

    def _choose(self) -> None:
        first, second = (self._sources[box.currentIndex()] for box in self.boxes)
        self._chosen = first, second
        self.show_again()


def _sign(sign: str, tint: Tint) -> str:
    red, green, blue = (DARK if theme_colours().dark else LIGHT).tints[tint]
    return f'<span style="color:#{red:02x}{green:02x}{blue:02x}">{sign}</span>'
