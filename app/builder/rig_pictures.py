"""Three pictures to choose from: the force/torque sensor is below the part, on the tool, or there is none."""

from __future__ import annotations

from PySide6.QtCore import QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QFont, QPainter, QPaintEvent, QPen, QPolygonF
from PySide6.QtWidgets import QAbstractButton, QButtonGroup, QSizePolicy, QWidget

from app.panels.layouts import make_row
from app.panels.widgets import escape_tooltip, mix, theme_colours
from app.text_size import scaled
from app.theme import WIDGET_GAP_PX, Colours
from skincal.part.tool_draft import Rig

RIG_NAMES = {Rig.BELOW: "Belo&w the part", Rig.ON_TOOL: "O&n the tool", Rig.NONE: "None: tip &alone"}
RIG_DESCRIPTIONS = {
    Rig.BELOW: "the force/torque sensor is below the part: it feels every poke on it",
    Rig.ON_TOOL: "the force/torque sensor is on the tool, as in a cobot's wrist; the tool's poses are streamed",
    Rig.NONE: "there is no force/torque sensor; the poses of a tool with a pointed tip are streamed",
}
BOX_WIDTH, BOX_HEIGHT = 100.0, 70.0  # Units of the drawings
PICTURE_WIDTH_PX, PICTURE_HEIGHT_PX = 146, 104
CAPTION_LINES_PX = 24
BENCH_Y, SENSOR_HEIGHT = 64.0, 7.0
PART_LEFT, PART_WIDTH, PART_HEIGHT = 26.0, 36.0, 17.0
TIP_X = 44.0
"""The tip touches the skin here."""
ELBOW, SHOULDER, BASE = QPointF(60.0, 6.0), QPointF(88.0, 24.0), QPointF(88.0, BENCH_Y)
"""Joints of the arm that holds the tool."""


class RigButton(QAbstractButton):
    """One picture with its name."""

    def __init__(self, rig: Rig) -> None:
        super().__init__()
        self.rig = rig
        self.setText(RIG_NAMES[rig])
        self.setAccessibleName(RIG_DESCRIPTIONS[rig])
        self.setToolTip(RIG_DESCRIPTIONS[rig])
        self.setCheckable(True)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)

    def sizeHint(self) -> QSize:
        return QSize(scaled(PICTURE_WIDTH_PX), scaled(PICTURE_HEIGHT_PX + CAPTION_LINES_PX))

    def minimumSizeHint(self) -> QSize:
        caption = self.fontMetrics().horizontalAdvance(self.text().replace("&", "")) + 2 * WIDGET_GAP_PX
        return QSize(max(scaled(PICTURE_WIDTH_PX) * 3 // 4, caption), self.sizeHint().height())

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter, colours = QPainter(self), theme_colours()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if not self.isEnabled():
            painter.setOpacity(0.45)
        frame = QRectF(self.rect()).adjusted(1.5, 1.5, -1.5, -1.5)
        painter.setBrush(QColor(colours.raised if self.isChecked() else colours.panel))
        painter.setPen(QPen(QColor(colours.accent if self.isChecked() else colours.edge), 2.5 if self.isChecked() else 1.0))
        painter.drawRoundedRect(frame, 6.0, 6.0)
        if self.hasFocus():
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.setPen(QPen(QColor(colours.text), 1.0, Qt.PenStyle.DashLine))
            painter.drawRoundedRect(frame.adjusted(3, 3, -3, -3), 4.0, 4.0)
        caption = frame.adjusted(4, frame.height() - scaled(CAPTION_LINES_PX), -4, -3)
        font = QFont(self.font())
        font.setBold(self.isChecked())
        painter.setFont(font)
        painter.setPen(QColor(colours.text))
        painter.drawText(caption, int(Qt.AlignmentFlag.AlignCenter | Qt.TextFlag.TextShowMnemonic), self.text())
        room = frame.adjusted(8, 8, -8, -scaled(CAPTION_LINES_PX) - 2)
        scale = min(room.width() / BOX_WIDTH, room.height() / BOX_HEIGHT)
        painter.translate(room.center().x() - scale * BOX_WIDTH / 2, room.center().y() - scale * BOX_HEIGHT / 2)
        painter.scale(scale, scale)
        draw_rig(painter, colours, self.rig)
        painter.end()


def draw_rig(painter: QPainter, colours: Colours, rig: Rig) -> None:
    """Draw a rig into a box of `BOX_WIDTH` by `BOX_HEIGHT`."""
    lift = SENSOR_HEIGHT if rig is Rig.BELOW else 0.0
    line = QPen(QColor(colours.text), 1.2)
    painter.setPen(QPen(QColor(colours.muted), 1.6))
    painter.drawLine(QPointF(4, BENCH_Y), QPointF(96, BENCH_Y))
    # The part with its skin.
    top = BENCH_Y - PART_HEIGHT - lift
    painter.setPen(line)
    painter.setBrush(mix(colours.panel, colours.muted, 0.35))
    painter.drawRoundedRect(QRectF(PART_LEFT, top, PART_WIDTH, PART_HEIGHT), 3.0, 3.0)
    painter.setPen(Qt.PenStyle.NoPen)
    painter.setBrush(QColor(colours.warn))
    for column in range(6):
        painter.drawEllipse(QPointF(PART_LEFT + 4.0 + 5.6 * column, top + 0.4), 1.7, 1.7)
    if rig is Rig.BELOW:
        _draw_sensor(painter, colours, QRectF(PART_LEFT + 6, BENCH_Y - lift, PART_WIDTH - 12, lift))
        _draw_hand(painter, colours, top)
    else:
        _draw_arm(painter, colours, rig, top)


def _draw_sensor(painter: QPainter, colours: Colours, box: QRectF) -> None:
    painter.setPen(QPen(QColor(colours.text), 1.0))
    painter.setBrush(QColor(colours.accent))
    painter.drawRoundedRect(box, 2.0, 2.0)


def _draw_tip(painter: QPainter, colours: Colours, start: float, end: float) -> None:
    """Draw a pointed tip from one height to another."""
    painter.setPen(Qt.PenStyle.NoPen)
    painter.setBrush(QColor(colours.text))
    neck = end - 5.0
    painter.drawRect(QRectF(TIP_X - 1.6, start, 3.2, neck - start))
    painter.drawPolygon(QPolygonF([QPointF(TIP_X - 1.6, neck), QPointF(TIP_X + 1.6, neck), QPointF(TIP_X, end)]))


def _draw_hand(painter: QPainter, colours: Colours, top: float) -> None:
    """Draw a probe with a grip, and the way of the push."""
    _draw_tip(painter, colours, top - 24.0, top - 2.5)
    painter.setPen(QPen(QColor(colours.text), 1.2))
    painter.setBrush(mix(colours.panel, colours.muted, 0.6))
    painter.drawRoundedRect(QRectF(TIP_X - 4.5, top - 37.0, 9.0, 16.0), 3.0, 3.0)


def _draw_arm(painter: QPainter, colours: Colours, rig: Rig, top: float) -> None:
    """Draw a robot's arm that holds the tip, with a sensor in its wrist or without."""
    wrist = QPointF(TIP_X, 12.0)
    painter.setPen(QPen(mix(colours.panel, colours.muted, 0.75), 7.0, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
    for start, end in ((BASE, SHOULDER), (SHOULDER, ELBOW), (ELBOW, wrist)):
        painter.drawLine(start, end)
    painter.setPen(QPen(QColor(colours.text), 1.0))
    painter.setBrush(QColor(colours.panel))
    for joint in (SHOULDER, ELBOW):
        painter.drawEllipse(joint, 2.6, 2.6)
    begin = 15.0
    if rig is Rig.ON_TOOL:
        _draw_sensor(painter, colours, QRectF(TIP_X - 7, begin, 14, SENSOR_HEIGHT))
        begin += SENSOR_HEIGHT
    _draw_tip(painter, colours, begin, top - 2.5)


class RigChoice(QWidget):
    """The three pictures; one is chosen."""

    chosen = Signal(object)  # `Rig`, by the operator

    def __init__(self) -> None:
        super().__init__()
        self.setAccessibleName("place of the force/torque sensor")
        self.buttons = {rig: RigButton(rig) for rig in Rig}
        self._group = QButtonGroup(self)
        for button in self.buttons.values():
            self._group.addButton(button)
        make_row(*self.buttons.values(), within=self, margins=0, gap=WIDGET_GAP_PX)
        self._shown = Rig.BELOW
        self._group.buttonToggled.connect(self._on_toggle)

    def show_rig(self, rig: Rig, why_not: str) -> None:
        """Show the choice; `why_not` is why a tool cannot be chosen, empty if it can."""
        self._shown = rig
        self.buttons[rig].setChecked(True)
        for each, button in self.buttons.items():
            is_possible = not why_not or each is Rig.BELOW or each is rig
            button.setEnabled(is_possible)
            button.setToolTip(RIG_DESCRIPTIONS[each] if is_possible else escape_tooltip(why_not))

    def _on_toggle(self, button: QAbstractButton, on: bool) -> None:
        # The arrow keys of a group check the next button without a click.
        if on and isinstance(button, RigButton) and button.rig is not self._shown:
            self._shown = button.rig
            self.chosen.emit(button.rig)
