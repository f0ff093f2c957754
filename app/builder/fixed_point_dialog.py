"""The fixed-point test on the tool's own stream: touch one point from four sides; it shows tip, scatter and a wrong form."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QKeySequence, QShortcut
from PySide6.QtWidgets import QLabel, QListWidget, QPushButton, QWidget

from app.builder.live_row import LiveRow
from app.dialogs.dialog import Dialog, StandardButton
from app.panels.layouts import make_row
from app.panels.widgets import secondary_label, set_bold
from app.theme import WIDGET_GAP_PX
from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.length_units import METRES_PER_UNIT
from skincal.model.pose_form import PoseForm
from skincal.model.readings import Stream
from skincal.part.part_draft import MM_DIGITS, rounded
from skincal.part.tool_draft import ToolDraft
from skincal.rig.pivot import Mistake, PivotResult, PivotState
from skincal.rig.touch_series import RestWindow, TouchSeries
from skincal.streams.expected_readings import ExpectedReadings
from skincal.words.tool_words import form_words, pivot_sentences
from skincal.words.units import count, millimetres, point_mm

TEST_STEPS = (
    "1. Fix a point: a screw with a slot, a pin, a dent in a plate.\n"
    "2. Touch it with the tip, hold still for half a second, and press Space.\n"
    "3. Four times or more. Lean the tool by 20 degrees or more each time, to all sides, and turn it about itself."
)
DIALOG_WIDTH_PX = 640
TOUCH_LIST_HEIGHT_PX = 130
RESULT_LINES = 4
COUNT_FONT_SIZE_PT = 16.0


class FixedPointDialog(Dialog):
    """Counts touches, and says what they show. It changes a `ToolDraft`.

    Parameters
    ----------
    tool : with the form of the poses, and the tip if it is known
    address : of the tool's stream, to begin with; empty if it is unknown
    """

    found = Signal(object)  # `ToolDraft` with the tip, and with the form that fits

    def __init__(self, tool: ToolDraft, address: str = "", parent: QWidget | None = None) -> None:
        super().__init__("Fixed-point test", parent, StandardButton.Ok | StandardButton.Cancel)
        self._tool, self._series, self._rest = tool, TouchSeries(), RestWindow()
        self._form = _form_of(tool)
        self._result: PivotResult | None = None
        self.live = LiveRow(Stream.TOOL)
        self.live.expect(_expected(tool))
        self.count = QLabel()
        set_bold(self.count, COUNT_FONT_SIZE_PT)
        self.count.setAccessibleName("touches")
        self.touch = QPushButton("Take the touch  (Space)", autoDefault=False)
        self.remove = QPushButton("&Remove the selected", autoDefault=False)
        self.list = QListWidget()
        self.list.setAccessibleName("touches, with the distance of each from the point")
        self.list.setSelectionMode(QListWidget.SelectionMode.ExtendedSelection)
        self.list.setMinimumHeight(TOUCH_LIST_HEIGHT_PX)
        self.said = QLabel(wordWrap=True, textFormat=Qt.TextFormat.PlainText)
        self.said.setAccessibleName("result of the test")
        # The longest result: nothing moves when it comes.
        self.said.setMinimumHeight(RESULT_LINES * self.fontMetrics().lineSpacing())
        self.said.setAlignment(Qt.AlignmentFlag.AlignTop)
        self.said.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.use_form = QPushButton(autoDefault=False)
        self.use_form.hide()
        ok = self.button(StandardButton.Ok)
        ok.setText("&Use this tip")
        ok.setAutoDefault(False)
        steps = secondary_label(TEST_STEPS, wrap=True)
        self.fill(
            steps,
            self.live,
            make_row(self.count, 1, self.touch, self.remove, gap=WIDGET_GAP_PX),
            self.list,
            self.said,
            make_row(self.use_form, 1),
        )
        self.setMinimumWidth(DIALOG_WIDTH_PX)
        self._connect()
        self.live.row.set_address(address, agreed=bool(address))
        self.live.resume()
        (self.touch if address else self.live.row.field).setFocus()
        self._show_touches()

    def _connect(self) -> None:
        # In its field the space bar writes a space.
        self.live.row.agreed.connect(self.touch.setFocus)
        self.live.read.connect(lambda poses: self._rest.add(time.monotonic(), poses))
        self.touch.clicked.connect(self.take_touch)
        self.remove.clicked.connect(self._remove)
        self.list.itemSelectionChanged.connect(lambda: self.remove.setEnabled(bool(self.list.selectedItems())))
        self.use_form.clicked.connect(self._use_other_form)
        self.buttons.accepted.connect(self._accept)
        self.finished.connect(lambda _: self.live.stop())
        QShortcut(QKeySequence(Qt.Key.Key_Space), self, self.take_touch)

    def take_touch(self) -> None:
        """Take the present pose as a touch, if the tool is at rest."""
        sent = self.live.sent_pose
        if sent is None:
            self.said.setText("\N{BALLOT X} No pose of the tool came yet: name its address above, and press Enter.")
            return
        try:
            self._rest.require_rest(time.monotonic())
        except InputError as error:
            self.said.setText(f"\N{BALLOT X} {error}")
            return
        self._form = self._form or sent.form
        self._series = self._series.added(sent)
        self._show_touches()

    def _remove(self) -> None:
        self._series = self._series.removed([index.row() for index in self.list.selectedIndexes()])
        self._show_touches()

    def _show_touches(self) -> None:
        """Show the touches and what they say."""
        made, missing = len(self._series.touches), self._series.missing
        more = f": {missing} more are needed" if missing > 1 else ": one more is needed" if missing else ""
        self.count.setText(f"{count(made, 'touch', 'touches')}{more}" if made else "No touch yet")
        problem = ""
        try:
            self._result = self._series.judge(self._form)
        except InputError as error:
            self._result, problem = None, f"\N{BALLOT X} {error}"
        result = self._result
        self.said.setText("\n".join(pivot_sentences(result, self._typed_tip)) if result is not None else problem)
        misses = None if result is None else result.reading.fit.misses
        self.list.clear()
        for row, touch in enumerate(self._series.touches):
            miss = "" if misses is None else f"   misses the point by {millimetres(float(misses[row]))}"
            self.list.addItem(f"{row + 1}   tool at ({point_mm(np.array(touch.position))}) mm{miss}")
        self.remove.setEnabled(False)
        other = None if result is None or result.state is not PivotState.OTHER_READING else result.others[0]
        can_change = other is not None and other.mistake is Mistake.NONE and self._tool.form is not None
        self.use_form.setVisible(can_change)
        if other is not None:
            self.use_form.setText(f"Read them as {form_words(other.form)}")
        self.button(StandardButton.Ok).setEnabled(result is not None and result.state is PivotState.AGREES)

    @property
    def _typed_tip(self) -> FloatArray | None:
        """(3,) metres: the tip that was typed before; `None` without one."""
        tip = self._tool.tip_mm
        return None if tip is None or not any(tip) else np.array(tip) * 1e-3

    def _use_other_form(self) -> None:
        if self._result is not None:
            self._form = self._result.others[0].form
            has_angles = self._form.rotation.has_angles
            degrees = self._form.degrees if has_angles else None
            self._tool = replace(self._tool, rotation=self._form.rotation.value, degrees=degrees)
            self.live.expect(_expected(self._tool))
            # The touches stay: their numbers are those that the device sent.
            self._show_touches()

    def _accept(self) -> None:
        result = self._result
        if result is not None and result.state is PivotState.AGREES:
            tip = rounded(result.reading.fit.tip * 1e3, MM_DIGITS)
            self.found.emit(replace(self._tool, tip_mm=tip))
            self.accept()


def _form_of(tool: ToolDraft) -> PoseForm | None:
    return None if tool.form is None else PoseForm(tool.form, bool(tool.degrees))


def _expected(tool: ToolDraft) -> ExpectedReadings:
    """Make the values that the stream has by the draft; a missing unit is metres, until it is chosen."""
    form = _form_of(tool)
    return ExpectedReadings(1, pose_form=None if form is None else (form, METRES_PER_UNIT[tool.unit or "m"]))
