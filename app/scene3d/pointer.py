"""The mouse over the 3D view: turn, shift, come nearer, pick. Keys are left to the window."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from PySide6.QtCore import QEvent, QObject, QPointF, Qt
from PySide6.QtGui import QMouseEvent, QWheelEvent
from PySide6.QtWidgets import QWidget

from app.scene3d import camera

if TYPE_CHECKING:
    from vtkmodules.vtkRenderingCore import vtkCamera

    from app.scene3d.stage import Stage

CLICK_PIXELS = 4.0
"""A press that moves less before its release is a click: hands tremble by two or three pixels."""
DEGREES_PER_WIDTH = 220.0
"""A drag across the shorter side of the view turns the part by this much: a bit more than its far side."""
WHEEL_STEP = 1.15
"""Factor of nearness for one notch of the wheel."""
NOTCH = 120.0
"""Qt's units of a notch."""
KEYS = (QEvent.Type.KeyPress, QEvent.Type.KeyRelease, QEvent.Type.ShortcutOverride)


class Pointer(QObject):
    """Turns mouse events of a canvas into moves of the stage's camera and into clicks.

    Left drag turns, middle or shift-left drag shifts, right drag and the wheel come nearer, a left click picks. The canvas
    itself sees neither mouse nor keys, so no key binding of VTK can fire.

    Parameters
    ----------
    moved : called after the camera moved
    clicked : called with x and y of a click, pixels of the picture from its lower left
    """

    def __init__(
        self, canvas: QWidget, stage: Stage, moved: Callable[[], None], clicked: Callable[[float, float], None]
    ) -> None:
        super().__init__(canvas)
        self._canvas = canvas
        self._stage = stage
        self._moved = moved
        self._clicked = clicked
        self._start = QPointF()
        self._last = QPointF()
        self._dragged = False
        canvas.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        canvas.installEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: ARG002
        """Take mouse events, pass keys on to the window, leave the rest to the canvas."""
        kind = event.type()
        if isinstance(event, QWheelEvent):
            self._near(WHEEL_STEP ** (event.angleDelta().y() / NOTCH))
        elif kind in (QEvent.Type.MouseButtonPress, QEvent.Type.MouseButtonDblClick) and isinstance(event, QMouseEvent):
            self._start = self._last = event.position()
            self._dragged = False
            self._stage.hold(True)
        elif kind == QEvent.Type.MouseMove and isinstance(event, QMouseEvent):
            self._drag(event)
        elif kind == QEvent.Type.MouseButtonRelease and isinstance(event, QMouseEvent):
            self._release(event)
        elif kind in KEYS:
            event.ignore()
        else:
            return False
        return True

    def _drag(self, event: QMouseEvent) -> None:
        buttons = event.buttons()
        if buttons == Qt.MouseButton.NoButton:
            return
        if not self._dragged and (event.position() - self._start).manhattanLength() < CLICK_PIXELS:
            return
        self._dragged = True
        step, self._last = event.position() - self._last, event.position()
        size = max(1, min(self._canvas.width(), self._canvas.height()))
        shifting = buttons & Qt.MouseButton.MiddleButton or event.modifiers() & Qt.KeyboardModifier.ShiftModifier
        if shifting:
            height = max(1, self._canvas.height())
            camera.shift(self._camera(), step.x() / height, -step.y() / height)
        elif buttons & Qt.MouseButton.LeftButton:
            camera.orbit(self._camera(), step.x() * DEGREES_PER_WIDTH / size, -step.y() * DEGREES_PER_WIDTH / size)
        else:
            camera.approach(self._camera(), WHEEL_STEP ** (-step.y() / 20))
        self._note_move()

    def _release(self, event: QMouseEvent) -> None:
        self._stage.hold(event.buttons() != Qt.MouseButton.NoButton)
        if self._dragged or event.button() != Qt.MouseButton.LeftButton:
            return
        density = self._canvas.devicePixelRatioF()
        self._clicked(event.position().x() * density, (self._canvas.height() - event.position().y()) * density)

    def _near(self, factor: float) -> None:
        camera.approach(self._camera(), factor)
        self._note_move()

    def _camera(self) -> vtkCamera:
        return self._stage.renderer.GetActiveCamera()

    def _note_move(self) -> None:
        self._stage.touch(time.monotonic())
        self._moved()
