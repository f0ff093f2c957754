"""Dialog for the thresholds of a poke: value and reason of each, the newest pokes, and a field to change it."""

from __future__ import annotations

from dataclasses import asdict

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QShowEvent
from PySide6.QtWidgets import QDialogButtonBox, QGridLayout, QLabel, QLineEdit, QScrollArea, QWidget

from app.dialogs.dialog import Dialog
from app.panels.widgets import fit_to_screen, panel_scroll_area, secondary_label, set_bold
from app.state.view_state import ViewState
from app.theme import WIDGET_GAP_PX
from skincal.contacts.outcome import Outcome
from skincal.contacts.thresholds import NEWEST_POKES_COMPARED, threshold_uses
from skincal.model.actions import SetThresholds
from skincal.model.scene import ContactSettings
from skincal.words.threshold_words import (
    THRESHOLDS_INTRODUCTION,
    ThresholdWords,
    objections,
    shown_value,
    threshold_groups,
    typed_value,
    use_words,
    with_unit,
)

SIZE_PX = (620, 600)


class ThresholdRow:
    """Field of one threshold, with a problem, its reason and the newest pokes below."""

    def __init__(self, words: ThresholdWords, of_scene: str, grid: QGridLayout) -> None:
        self.field = QLineEdit()
        self.field.setAccessibleName(", ".join(filter(None, (words.title, words.unit.text))))
        self.field.setAccessibleDescription(words.reason)
        self.objection = QLabel(wordWrap=True)
        self.objection.hide()
        self.used = secondary_label(wrap=True)
        title = QLabel(words.title)
        title.setBuddy(self.field)
        at = grid.rowCount()
        for column, widget in enumerate((title, self.field, QLabel(words.unit.text), secondary_label(f"scene: {of_scene}"))):
            grid.addWidget(widget, at, column)
        for below, widget in enumerate((self.objection, secondary_label(words.reason, wrap=True), self.used), start=1):
            grid.addWidget(widget, at + below, 0, 1, 4)
        grid.setRowMinimumHeight(at + 4, WIDGET_GAP_PX)

    def show_problem(self, sentence: str) -> None:
        self.objection.setText(f"\N{BALLOT X} {sentence}")
        self.objection.setVisible(bool(sentence))


class ThresholdsDialog(Dialog):
    """Dialog for the poke thresholds; it stays open next to the window and follows the session.

    Parameters
    ----------
    scene : thresholds in the scene's file
    has_sensor : the rig has a force/torque sensor
    """

    thresholds_wanted = Signal(object)  # `SetThresholds`

    def __init__(self, scene: ContactSettings, parent: QWidget | None = None, *, has_sensor: bool = True) -> None:
        super().__init__("Thresholds of a poke", parent, is_kept=True)
        self._scene: dict[str, float] = asdict(scene)
        self._now = dict(self._scene)
        self._state: ViewState | None = None
        self._newest: list[Outcome] | None = None  # Pokes that are shown
        self.area = QScrollArea()
        # It follows the focus of its fields.
        self.area.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        inner = panel_scroll_area(self.area)
        self._grid = QGridLayout(inner)
        self._grid.setColumnStretch(3, 1)
        self.rows: dict[str, ThresholdRow] = {}
        for title, group in threshold_groups(has_sensor=has_sensor).items():
            heading = QLabel(title)
            set_bold(heading)
            self._grid.addWidget(heading, self._grid.rowCount(), 0, 1, 4)
            for name, words in group.items():
                row = self.rows[name] = ThresholdRow(words, with_unit(name, self._scene[name]), self._grid)
                row.field.textEdited.connect(self._edited)
        self.use = self.buttons.addButton("Use", QDialogButtonBox.ButtonRole.ApplyRole)
        self.back = self.buttons.addButton("Use those of the scene", QDialogButtonBox.ButtonRole.ResetRole)
        self.fill(secondary_label(THRESHOLDS_INTRODUCTION, wrap=True), (self.area, 1))
        self.use.setDefault(True)
        self._show_fields()
        self.use.clicked.connect(self._use)
        self.back.clicked.connect(lambda: self.thresholds_wanted.emit(SetThresholds()))

    def show_state(self, state: ViewState) -> None:
        """Show the thresholds in use and the newest pokes, if the dialog is visible."""
        self._state = state
        if not self.isVisible():
            return
        decisions = state.snapshot.decisions
        if decisions.skin_response_min:
            self._scene["response_min"] = decisions.skin_response_min
        now = asdict(decisions.thresholds)
        if now != self._now:
            self._now = now
            self._show_fields()
        newest = [record.outcome for record in state.snapshot.pokes[-NEWEST_POKES_COMPARED:]]
        # By identity: outcomes hold arrays, which have no truth value.
        if self._newest is None or list(map(id, newest)) != list(map(id, self._newest)):
            self._newest = newest
            for name, use in threshold_uses(newest, list(self.rows)).items():
                self.rows[name].used.setText(use_words(name, use))

    def showEvent(self, event: QShowEvent) -> None:
        """Show the newest state, with the focus on the first field."""
        super().showEvent(event)
        if self._state is not None:
            self.show_state(self._state)
        fit_to_screen(self, SIZE_PX)
        first = next(iter(self.rows.values())).field
        self.area.verticalScrollBar().setValue(0)
        first.setFocus()
        first.selectAll()

    def _show_fields(self) -> None:
        for name, row in self.rows.items():
            row.field.setText(shown_value(name, self._now[name]))
            row.show_problem("")
        self._enable()

    def _edited(self) -> None:
        self._show_problems(objections(self._typed()))
        self._enable()

    def _enable(self) -> None:
        self.use.setEnabled(self._typed() != self._now)
        self.back.setEnabled(self._now != self._scene)

    def _typed(self) -> dict[str, float]:
        """Read the fields, SI units; an unchanged field gives exactly the present value, which has more digits."""
        return {name: self._typed_value(name, now) if name in self.rows else now for name, now in self._now.items()}

    def _typed_value(self, name: str, now: float) -> float:
        text = self.rows[name].field.text().strip()
        return now if text == shown_value(name, now) else typed_value(name, text)

    def _show_problems(self, wrong: dict[str, str]) -> None:
        for name, row in self.rows.items():
            row.show_problem(wrong.get(name, ""))

    def _use(self) -> None:
        typed = self._typed()
        wrong = objections(typed)
        self._show_problems(wrong)
        if wrong:
            row = self.rows[next(name for name in self.rows if name in wrong)]
            self.area.ensureWidgetVisible(row.objection)
            row.field.setFocus()
            row.field.selectAll()
            return
        changed = {name: float(value) for name, value in typed.items() if value != self._scene[name]}
        self.thresholds_wanted.emit(SetThresholds(tuple(changed), tuple(changed.values())))
