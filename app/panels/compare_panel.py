"""The Compare tab: arrows in the 3D view from one set of taxel positions to another, and the differences in numbers.

It works, and the 3D view draws the arrows, only while the tab is visible.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QHideEvent, QShowEvent
from PySide6.QtWidgets import QCheckBox, QComboBox, QGridLayout, QLabel, QPushButton, QTreeWidget

from app.panels.layouts import make_row
from app.panels.panel import Panel
from app.panels.widgets import (
    TaxelList,
    compact_combo,
    escape_tooltip,
    fit_rows,
    put_rows,
    rich_label,
    secondary_label,
    set_bold,
    table,
    theme_colours,
)
from app.scene3d.scene_state import DARK, LIGHT, Comparison, TaxelAxes
from app.state.position_sets import LAYOUT_SET, default_pair, in_order, method_label, position_sets, unique_name
from app.state.view_state import ViewState
from app.theme import WIDGET_GAP_PX
from skincal.files.reference import Origin
from skincal.geometry import FloatArray
from skincal.model.skin import Layout
from skincal.modules.health import PlannedNeighbours, neighbours_of
from skincal.part.robot_places import robot_places
from skincal.taxels.differences import ModuleDifference, repeatability, worst_rows
from skincal.words.compare_words import (
    ARROW_SCALES,
    MODULE_HEADINGS,
    MODULE_HINTS,
    arrow_words,
    axes_legend,
    difference_words,
    listed_modules,
    listed_words,
    misfit_words,
    module_cells,
    motion_words,
    save_hint,
    spacing_words,
)
from skincal.words.units import TIMES, millimetres

if TYPE_CHECKING:
    from skincal.files.reference import TaxelPositions
    from skincal.following.guided_session import GuidedSession

MAX_LISTED_WORST_TAXELS = 10
MAX_VISIBLE_MODULE_ROWS = 7  # Modules of a forearm; a longer list scrolls
BLACK_DOT, ARROW = "\N{BLACK CIRCLE}", "\N{RIGHTWARDS ARROW}"
TRUTH_SET = "Truth"


class ComparePanel(Panel):
    """Choice of two sets above, their differences by module and by taxel below."""

    title = "Compare"
    file_wanted = Signal()  # Ask for a file with positions to compare with
    session_wanted = Signal()  # Ask for another session
    layout_wanted = Signal()  # Ask for a file, and write the corrected layout to it

    def __init__(self, guided: GuidedSession) -> None:
        super().__init__()
        self._guided, self._layout = guided, guided.part.scene.skin.layout
        self._channels, laid = guided.part.channels, guided.part.laid
        self._laid = None if laid is None or not np.isfinite(laid.places[self._channels]).any() else laid.places[self._channels]
        self._others: dict[str, FloatArray] = {}
        self._paths: dict[str, Path | None] = {}  # Where the other sets were read; `None` for the truth and references
        if (frames := robot_places(guided.part.scene)) is not None:
            self._others[frames.name], self._paths[frames.name] = in_order(self._channels, frames.places), None
        self._axes: dict[str, Mapping[int, FloatArray]] = {}  # Axes of taxels of the other sets, where they have some
        self.modules_check = guided.modules
        self._neighbours: PlannedNeighbours | None = None  # Made when first needed
        self._sets: dict[str, FloatArray] = {}
        self._chosen: tuple[str, str] | None = None  # The operator's choice, if any
        self.boxes = (compact_combo("from"), compact_combo("to"))
        self.all, self.scale = QCheckBox("all"), QComboBox()
        self.legend, self.summary, self.health = rich_label(wrap=True), QLabel(wordWrap=True), QLabel(wordWrap=True)
        # The space bar pauses, so Enter presses the button that has the focus.
        self.add_file, self.add_session = (
            QPushButton("Add file…", autoDefault=True),
            QPushButton("Add session…", autoDefault=True),
        )
        self.save_button = QPushButton("Save the corrected layout…", autoDefault=True)
        self.motion, self.spacing, self.listed = secondary_label(wrap=True), secondary_label(wrap=True), secondary_label()
        self.turns = QLabel(wordWrap=True)
        self.modules = table("modules", MODULE_HEADINGS, MODULE_HINTS)
        self.worst = TaxelList("taxels with the largest difference")
        self._prepare()
        self._arrange()
        for box in self.boxes:
            # Qt sends this for the operator's choice only.
            box.activated.connect(self._choose)
        self.all.toggled.connect(self.show_again)
        self.scale.activated.connect(self.show_again)
        self.worst.taxel_wanted.connect(self.taxel_wanted)
        self.save_button.clicked.connect(self.layout_wanted)
        self.add_file.clicked.connect(self.file_wanted)
        self.add_session.clicked.connect(self.session_wanted)

    def _prepare(self) -> None:
        self.scale.addItems([f"{TIMES} {scale}" for scale in ARROW_SCALES])
        self.scale.setAccessibleName("length of the arrows")
        self.scale.setToolTip("Scale of the arrows")
        self.all.setToolTip("Show the layout and the positions by every method together")
        self.modules.setSelectionMode(QTreeWidget.SelectionMode.NoSelection)
        self.modules.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.add_file.setToolTip("Compare with a calibration (JSON, CSV, iCub) or truth.json")
        self.add_session.setToolTip("Compare with another recorded session, by each of its methods")
        set_bold(self.summary)
        self.setWhatsThis(
            "Differences between two sets of taxel positions. Errors of the rig move whole modules, so the difference "
            "of a module has two parts: its shift, and its shape, the rest after the best rotation and shift."
        )

    def _arrange(self) -> None:
        choices = QGridLayout()
        choices.setHorizontalSpacing(WIDGET_GAP_PX)
        choices.setVerticalSpacing(WIDGET_GAP_PX // 2)
        choices.setColumnStretch(1, 1)
        for row, (text, box, other) in enumerate(zip(("From", "To"), self.boxes, (self.all, self.scale), strict=True)):
            for column, widget in enumerate((secondary_label(text), box, other)):
                choices.addWidget(widget, row, column)
        choices.addLayout(make_row(self.add_file, self.add_session, 1), 2, 1, 1, 2)
        self.fill(
            choices, self.legend, self.summary, self.motion, self.turns, self.health,
            (self.save_button, 0, Qt.AlignmentFlag.AlignLeft), self.listed, self.modules, self.spacing,
            secondary_label("Largest differences"), (self.worst, 1),
            margins=WIDGET_GAP_PX,
        )  # fmt: skip
        for empty in (self.health, self.save_button, self.listed, self.motion, self.turns):
            empty.hide()
        for widget in (self.modules, self.spacing):
            widget.setVisible(self._layout is not None)
        self.setTabOrder(self.scale, self.save_button)

    # Showing

    def show_state(self, state: ViewState) -> None:
        self._state = state
        if self.isVisible():
            super().show_state(state)

    def depends_on(self, state: ViewState) -> tuple[object, ...]:
        return state.revision, state.method, state.review, self.modules_check.found

    def update_view(self, state: ViewState) -> None:
        before, self._sets = list(self._sets), position_sets(state, self._channels, self._guided.methods, self._laid)
        self._sets |= self._others
        # A box that is filled again closes its list under the operator's hand.
        if list(self._sets) != before:
            for box in self.boxes:
                box.clear()
                box.addItems(list(self._sets))
        pair = self.pair(state)
        for box, name in zip(self.boxes, pair, strict=True):
            box.setCurrentText(name)
        here, there = (self._sets[name] for name in pair)
        self._show_numbers(pair, here, there)
        axes = self._show_turns(state, pair)
        self._show_health()
        self._draw(pair, here, there, axes)

    def pair(self, state: ViewState) -> tuple[str, str]:
        """Return the compared sets: the operator's choice as long as both exist."""
        if self._chosen is not None and set(self._chosen) <= set(self._sets):
            return self._chosen
        return default_pair(list(self._sets), state.method)

    def _show_numbers(self, pair: tuple[str, str], here: FloatArray, there: FloatArray) -> None:
        names, channels, is_same = self._guided.names, self._channels.tolist(), pair[0] == pair[1]
        found = repeatability(here, there, None if self._layout is None else self._layout.module_of[self._channels])
        self.summary.setText(difference_words(found.summary, pair, names, channels))
        self.motion.setText("" if is_same else motion_words(found.motion))
        self.motion.setVisible(bool(self.motion.text()))
        rows = [] if is_same else worst_rows(found.lengths, MAX_LISTED_WORST_TAXELS).tolist()
        self.worst.show_taxels(
            [(channels[row], f"{names.taxel(channels[row])}   {millimetres(float(found.lengths[row]))}") for row in rows]
        )
        if self._layout is not None:
            self._show_modules(self._layout, found.modules, there)

    def _show_turns(self, state: ViewState, pair: tuple[str, str]) -> tuple[TaxelAxes, ...]:
        """Compare the axes of taxels that measure three; return those of both sets for the picture."""
        if self._guided.part.scene.skin.axes is None:
            return ()
        from skincal.axes.session_turns import ShownTurn  # other skins do without
        from skincal.axes.turn_differences import axes_of_turns, compare_turns
        from skincal.words.turn_words import turn_difference_words

        channels, snapshot = self._channels.tolist(), state.snapshot.on_part
        found = {channel: snapshot.shown_turn(channel) for channel in channels}
        own = axes_of_turns({channel: turn for channel, turn in found.items() if isinstance(turn, ShownTurn)})
        # A layout has no axes; one session has the same by each method.
        here, there = (self._axes.get(name, {} if name in self._others or name == LAYOUT_SET else own) for name in pair)
        same = here is there
        words = "" if same else turn_difference_words(compare_turns(here, there), self._guided.names.taxel)
        shown = here, {} if same else there
        legend = axes_legend(*(name if axes else "" for name, axes in zip(pair, shown, strict=True)))
        self.turns.setText(f"{words} {legend}".strip())
        self.turns.setVisible(bool(self.turns.text()))
        unknown = np.full((3, 3), np.nan)
        drawn = [np.array([known.get(channel, unknown) for channel in channels]) for known in shown]
        return tuple(TaxelAxes(self._sets[name], axes) for name, axes in zip(pair, drawn, strict=True))

    def _show_modules(self, layout: Layout, differences: Sequence[ModuleDifference], there: FloatArray) -> None:
        spacing, modules = self._spacing_ratios(there), layout.modules
        self.listed.setText(listed_words(len(differences)))
        self.listed.setVisible(bool(self.listed.text()))
        cells = [
            module_cells(found, modules[found.module].id, len(modules[found.module].channels), float(spacing[found.module]))
            for found in listed_modules(differences)
        ]
        put_rows(self.modules, cells)
        fit_rows(self.modules, MAX_VISIBLE_MODULE_ROWS)

    def _spacing_ratios(self, positions: FloatArray) -> FloatArray:
        """Return the spacing of neighbours over that of the layout, for each module and last for all."""
        if self._layout is None:
            return np.full(1, np.nan)
        if self._neighbours is None:
            self._neighbours = neighbours_of(self._layout)
        return self._neighbours.ratios(self._channels, positions)

    def _show_health(self) -> None:
        own = {method: self._sets[method_label(method)] for method in self._guided.methods}
        self.spacing.setText(spacing_words({method: float(self._spacing_ratios(at)[-1]) for method, at in own.items()}))
        found = self.modules_check.found
        sentences = () if found is None else misfit_words(found.mend, found.judged, found.method)
        self.health.setText("\n".join(sentences))
        self.health.setVisible(bool(sentences))
        self.save_button.setVisible(found is not None and bool(found.mend.changes))
        if found is not None:
            self.save_button.setToolTip(escape_tooltip(save_hint(found.mend)))

    def _draw(self, pair: tuple[str, str], here: FloatArray, there: FloatArray, axes: tuple[TaxelAxes, ...]) -> None:
        """Draw the sets in the 3D view, and explain the picture."""
        scale = ARROW_SCALES[self.scale.currentIndex()]
        shown = {"from": pair[0], "to": pair[1]}
        if self.all.isChecked():
            every = {"layout": LAYOUT_SET, **{method.value: method_label(method) for method in self._guided.methods}}
            shown = {tint: name for tint, name in every.items() if name in self._sets}
        # A sign and its words stay in one line.
        dots = [f"{_sign(BLACK_DOT, tint)}&nbsp;{escape(name).replace(' ', '&nbsp;')}" for tint, name in shown.items()]
        arrows = f"{_sign(ARROW, 'to')}&nbsp;{escape(arrow_words(pair, scale, named=self.all.isChecked()))}"
        self.legend.setText("&nbsp;&nbsp; ".join([*dots, arrows]))
        ends = np.stack([here, here + scale * (there - here)], axis=1)
        self.comparison_changed.emit(Comparison({tint: self._sets[name] for tint, name in shown.items()}, ends, axes))

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        self.show_again()

    def hideEvent(self, event: QHideEvent) -> None:
        super().hideEvent(event)
        self._shown = ()
        self.comparison_changed.emit(None)

    def _choose(self) -> None:
        first, second = (box.currentText() for box in self.boxes)
        self._chosen = first, second
        self.show_again()

    # More sets

    def add_reference(self, reference: TaxelPositions) -> None:
        name = TRUTH_SET if reference.origin is Origin.TRUTH else reference.name
        self._others[name], self._axes[name] = in_order(self._channels, reference.places), reference.axes
        self._paths[name] = None
        self.show_again()

    def add_sets(self, path: Path, found: Sequence[TaxelPositions]) -> None:
        """Add sets that were read from a file or a session, and compare with the first."""
        names = [unique_name(each.name, path, self._paths) for each in found]
        for name, each in zip(names, found, strict=True):
            self._others[name], self._paths[name] = in_order(self._channels, each.places), path
            self._axes[name] = each.axes
        if names and self._state is not None:
            self._chosen = self.pair(self._state)[0], names[0]
        self.show_again()


def _sign(sign: str, tint: str) -> str:
    red, green, blue = (DARK if theme_colours().dark else LIGHT).tints[tint]
    return f'<span style="color:#{red:02x}{green:02x}{blue:02x}">{sign}</span>'
