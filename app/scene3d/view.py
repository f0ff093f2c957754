"""The widget of the 3D view: it shows snapshots and reports clicked taxels.

Importing this module loads neither VTK nor pyvista; `begin` does, in a thread, while the window works.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from PySide6.QtCore import QEvent, QObject, QPointF, Qt, QTimer, Signal
from PySide6.QtGui import QEnterEvent, QMouseEvent, QResizeEvent, QShowEvent, QWheelEvent
from PySide6.QtWidgets import QLabel, QStackedLayout, QWidget

from app.scene3d import camera
from app.scene3d.canvas import Canvas, best_canvas, load, mount, prepare_import, release
from app.scene3d.scene_state import DARK, LIGHT, Comparison, StaticScene
from app.state.camera_pose import PLAIN_POSE, CameraPose
from app.theme import WIDGET_GAP_PX
from app.workers.threads import ThreadService
from skincal.model.errors import InputError

if TYPE_CHECKING:
    from app.scene3d.canvas import AnyCanvas
    from app.scene3d.scene_renderer import SceneRenderer
    from app.state.view_state import ViewState

LOG = logging.getLogger(__name__)
AnyAnswer = TypeVar("AnyAnswer")
VTK_CLOSE_TIMEOUT_S = 60.0  # Closing waits at most this long for VTK to load: a program that ends while VTK draws crashes
SETTLED_AFTER_MS = 5_000  # At the latest: a driver may hang, and readings of the session come
MAX_CLICK_MOVE_PX = 4.0  # A press that moves less before its release is a click: hands tremble by two or three pixels
ROTATION_PER_FULL_DRAG_DEG = 220.0
"""A drag across the shorter side of the view turns the part by this much: a bit more than to its far side."""
ZOOM_FACTOR_PER_WHEEL_NOTCH = 1.15  # Zoom factor for one notch of the wheel
NOTE_TOP_PX = 44  # A message of one line lies above the note
QT_WHEEL_UNITS_PER_NOTCH = 120.0  # Qt's units of a notch
KEYS = (QEvent.Type.KeyPress, QEvent.Type.KeyRelease, QEvent.Type.ShortcutOverride)


class Pointer(QObject):
    """Turns mouse events of a canvas into camera moves and clicks.

    Left drag rotates, middle or shift-left drag pans, right drag and the wheel zoom, a left click picks. The canvas
    itself sees neither mouse nor keys, so no key binding of VTK can fire.
    """

    def __init__(self, view: View3D, canvas: QWidget, renderer: SceneRenderer) -> None:
        super().__init__(canvas)
        self._view, self._canvas, self._renderer = view, canvas, renderer
        self._start = self._last = QPointF()
        self._dragged = False
        self._has_grip = False  # The drag moves what `View3D.grip` has gripped
        canvas.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        canvas.installEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: ARG002
        """Handle mouse events, pass keys on to the window, leave other events to the canvas."""
        kind = event.type()
        if isinstance(event, QWheelEvent):
            notches = event.angleDelta().y() / QT_WHEEL_UNITS_PER_NOTCH
            if not self._view.turn_wheel(notches, *self._pixels(event.position())):
                camera.zoom(self._renderer.camera, ZOOM_FACTOR_PER_WHEEL_NOTCH**notches)
                self._note_move(keeps_distance=True)
        elif kind in (QEvent.Type.MouseButtonPress, QEvent.Type.MouseButtonDblClick) and isinstance(event, QMouseEvent):
            self._start = self._last = event.position()
            self._dragged = False
            is_left = event.button() == Qt.MouseButton.LeftButton
            self._has_grip = is_left and self._view.grip(*self._pixels(event.position()))
            self._renderer.auto_camera.held = True
        elif kind == QEvent.Type.MouseMove and isinstance(event, QMouseEvent):
            self._drag(event)
        elif kind == QEvent.Type.MouseButtonRelease and isinstance(event, QMouseEvent):
            self._release(event)
        elif isinstance(event, QEnterEvent):
            # A window that covered the pointer, such as a tooltip, is gone: the pointer need not move for that.
            self._view.hover(*self._pixels(event.position()))
            return False
        elif kind in KEYS:
            event.ignore()
        else:
            return False
        return True

    def _drag(self, event: QMouseEvent) -> None:
        buttons = event.buttons()
        if buttons == Qt.MouseButton.NoButton:
            self._view.hover(*self._pixels(event.position()))
            return
        if not self._dragged and (event.position() - self._start).manhattanLength() < MAX_CLICK_MOVE_PX:
            return
        self._dragged = True
        if self._has_grip:
            self._view.drag_grip(*self._pixels(event.position()))
            return
        step, self._last = event.position() - self._last, event.position()
        size = max(1, min(self._canvas.width(), self._canvas.height()))
        if buttons & Qt.MouseButton.MiddleButton or event.modifiers() & Qt.KeyboardModifier.ShiftModifier:
            height = max(1, self._canvas.height())
            camera.pan(self._renderer.camera, step.x() / height, -step.y() / height)
        elif buttons & Qt.MouseButton.LeftButton:
            degrees_per_pixel = ROTATION_PER_FULL_DRAG_DEG / size
            camera.rotate(self._renderer.camera, step.x() * degrees_per_pixel, -step.y() * degrees_per_pixel)
            self._note_move(keeps_distance=False)
            return
        else:
            camera.zoom(self._renderer.camera, ZOOM_FACTOR_PER_WHEEL_NOTCH ** (-step.y() / 20))
        self._note_move(keeps_distance=True)

    def _release(self, event: QMouseEvent) -> None:
        self._renderer.auto_camera.held = event.buttons() != Qt.MouseButton.NoButton
        if event.button() == Qt.MouseButton.LeftButton:
            self._has_grip = False
            if not self._dragged:
                self._view.pick(*self._pixels(event.position()))

    def _pixels(self, position: QPointF) -> tuple[float, float]:
        """Convert a position in the widget to device pixels from the lower left."""
        density = self._canvas.devicePixelRatioF()
        return position.x() * density, (self._canvas.height() - position.y()) * density

    def _note_move(self, *, keeps_distance: bool) -> None:
        self._renderer.note_manual_move(time.monotonic(), keeps_distance=keeps_distance)
        self._view.request_picture()


class View3D(QWidget):
    """The 3D view of a session, its picture made as `canvas` says; by default what suits the machine."""

    taxel_picked = Signal(int)  # Channel whose estimate was clicked
    surface_picked = Signal(object)
    """(3,) float, metres, link frame: the point of the part that was clicked while one was wanted (`set_picking`)."""
    ready = Signal()  # The picture is there
    settled = Signal()  # The picture is there, or why there is none; in any case after `SETTLED_AFTER_MS`, and then twice

    def __init__(self, parent: QWidget | None = None, canvas: Canvas | None = None) -> None:
        super().__init__(parent)
        self.setAccessibleName("3D view")
        self.setMinimumSize(240, 180)
        self._choice = canvas
        self._colours = DARK
        self._static: StaticScene | None = None
        self._state: Any = None  # `ViewState`, or the subclass's own
        self._difference = False
        self._comparison: Comparison | None = None
        self._turning = True
        self._hidden: frozenset[str] = frozenset()
        self._picking = False
        self._renderer: SceneRenderer | None = None
        self._canvas: AnyCanvas | None = None
        self._threads: ThreadService | None = None  # Loads the picture; one for each `begin`
        self._late = QTimer(self, singleShot=True, interval=SETTLED_AFTER_MS)
        self._late.timeout.connect(self.settled)
        self._message = QLabel("The 3D view is loading …", self, alignment=Qt.AlignmentFlag.AlignCenter, wordWrap=True)
        self._stack = QStackedLayout(self)
        self._stack.addWidget(self._message)
        self._note = QLabel("", self, wordWrap=True, textFormat=Qt.TextFormat.PlainText)
        self._note.setAccessibleName("note in the 3D view")
        self._note.setAutoFillBackground(True)
        self._note.setMargin(WIDGET_GAP_PX)
        self._note.hide()

    def build_scene(self, static: StaticScene) -> None:
        """Start to build the layers that a scene supports; call once the window is on the screen.

        Returns at once; `ready` follows. A second call replaces the scene.
        """
        self.close_view()
        self._static = static
        self._choice = choice = self._choice or best_canvas()
        size, colours, state = self._pixels(), self._colours, self._state

        def work() -> SceneRenderer | None:
            try:
                return load(choice, static, colours, size, state)
            except Exception as error:
                LOG.exception("the 3D view cannot be made")
                # Any error of a driver or a library: the session goes on without the picture.
                raise InputError(f"There is no 3D view: {error}\n\nEverything else works.") from error

        def start() -> None:
            # Neither is called after the end of the view.
            threads.submit(work, self._settling(self._mount), self._settling(self._message.setText), dropped=release)

        self._threads = threads = ThreadService("scene3d", self)
        self._late.start()
        prepare_import(choice, self, start)

    def _settling(self, receive: Callable[[AnyAnswer], None]) -> Callable[[AnyAnswer], None]:
        """Make a receiver of an answer that emits `settled` after it, once the picture is painted."""

        def receive_and_settle(answer: AnyAnswer) -> None:
            self._late.stop()
            try:
                receive(answer)
            finally:
                # Qt paints what was requested before this.
                QTimer.singleShot(0, self, self.settled.emit)

        return receive_and_settle

    def _pixels(self) -> tuple[int, int]:
        """Size in device pixels, at least 1."""
        density = self.devicePixelRatioF()
        return max(1, round(self.width() * density)), max(1, round(self.height() * density))

    def show_state(self, state: ViewState) -> bool:
        """Show a tick; return whether the picture changes.

        Asks for one picture at most, and for none when nothing changed. While the view is not built or not visible, the
        state is kept, and shown later.
        """
        self._state = state
        return self.isVisible() and self._show_state()

    def set_note(self, text: str) -> None:
        """Show a note over the upper edge of the picture; nothing for an empty text."""
        if text == self._note.text():
            return
        self._note.setText(text)
        self._note.setVisible(bool(text))
        self._place_note()

    def _place_note(self) -> None:
        width = self.width() - 2 * WIDGET_GAP_PX
        self._note.setGeometry(WIDGET_GAP_PX, NOTE_TOP_PX, width, self._note.heightForWidth(width))
        self._note.raise_()

    def set_difference(self, wanted: bool) -> None:
        """Show or hide the lines from each estimate to another method's estimate."""
        self._difference = wanted
        self._lay_over()

    def set_comparison(self, comparison: Comparison | None) -> None:
        """Show sets of positions over each other instead of the estimates; `None` shows the estimates again."""
        self._comparison = comparison
        self._lay_over()

    def _lay_over(self) -> None:
        if self._renderer is not None:
            self._renderer.lay_over(self._comparison, difference=self._difference)
            self._show_state()

    def set_turning(self, wanted: bool) -> None:
        """Switch automatic turns of the camera to the target between pokes on or off."""
        self._turning = wanted
        if self._renderer is not None:
            self._renderer.auto_camera.wanted = wanted
            self._show_state()

    def hide_layers(self, names: frozenset[str]) -> None:
        """Hide the layers with these names, and show all others; one of them is the target's `cone`."""
        self._hidden = names
        if self._renderer is not None:
            self._renderer.hide(names)
            self.request_picture()

    @property
    def canvas(self) -> QWidget | None:
        """Widget of the picture; `None` before it is there."""
        return self._canvas

    @property
    def can_pick(self) -> bool:
        """Whether the view shows a part that can be clicked."""
        return self._renderer is not None and self._renderer.static.surface is not None

    @property
    def picking(self) -> bool:
        """Whether the next click on the part picks a point, not a taxel."""
        return self._picking

    def set_picking(self, wanted: bool) -> None:
        """Make the next click pick a point of the part, or let clicks select taxels again.

        Meanwhile the pointer is a cross, and the camera turns by the mouse alone. A click beside the part means nothing.
        """
        self._picking = wanted
        if self._canvas is not None:
            self._canvas.setCursor(Qt.CursorShape.CrossCursor if wanted else Qt.CursorShape.ArrowCursor)

    def set_dark(self, dark: bool) -> None:
        self._colours = DARK if dark else LIGHT
        if self._renderer is not None:
            self._renderer.set_colours(self._colours)
            self._show_state()
            self.request_picture()

    def reset_camera(self) -> None:
        """Bring the whole part into the picture, seen from the skin's side."""
        if self._renderer is not None:
            self._renderer.note_manual_move(time.monotonic())
            self._renderer.fit()
            self.request_picture()

    def eye(self) -> CameraPose:
        """Return the pose of the camera; `PLAIN_POSE` before the first picture."""
        return PLAIN_POSE if self._renderer is None else camera.pose_of(self._renderer.camera)

    def list_layers(self) -> tuple[str, ...]:
        """Return the names of the layers that exist; empty while the view is not built."""
        return () if self._renderer is None else self._renderer.list_layers()

    def screenshot(self, path: Path) -> None:
        """Write the present picture to an image file; the name's ending gives the format.

        Raises
        ------
        InputError
            There is no picture yet, or the file cannot be written.
        """
        if self._canvas is None:
            raise InputError("The 3D view has no picture yet; wait until it is ready.")
        if not self._canvas.grabFramebuffer().save(str(path)):
            raise InputError(f"{path}: the picture cannot be written; choose a folder that exists and a name ending in .png.")

    def close_view(self) -> None:
        """Stop the 3D view and release its resources; the empty widget stays. Safe at any time and more than once."""
        self._late.stop()
        threads, self._threads = self._threads, None
        if threads is not None:
            threads.close(VTK_CLOSE_TIMEOUT_S)
        if self._renderer is not None:
            self._renderer.close()
        if self._canvas is not None:
            self._stack.removeWidget(self._canvas)
            self._canvas.close()
            self._canvas.deleteLater()
        self._renderer = self._canvas = None

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._place_note()

    def showEvent(self, event: QShowEvent) -> None:
        """Show the newest moment, which was only kept while the view was hidden."""
        super().showEvent(event)
        self._show_state()

    def _show_state(self) -> bool:
        if self._renderer is None or self._state is None:
            return False
        changed = self._renderer.show(self._state)
        turned = not self._picking and self._renderer.turn(self._state, time.monotonic())
        if not turned and not changed:
            return False
        self.request_picture()
        return True

    def request_picture(self) -> None:
        if self._canvas is not None:
            self._canvas.update()

    def _mount(self, loaded: SceneRenderer | None) -> None:
        if self._choice is None or self._static is None:
            return
        self._canvas, self._renderer = mount(self._choice, loaded, self._static, self._colours, self)
        Pointer(self, self._canvas, self._renderer)
        self._stack.addWidget(self._canvas)
        self._stack.setCurrentWidget(self._canvas)
        self._note.raise_()
        # Theme, size and what is shown may have changed since the loading began.
        if self._choice is Canvas.RASTER:
            self._renderer.plotter.window_size = self._pixels()
        self._renderer.set_colours(self._colours)
        self._renderer.hide(self._hidden)
        self._renderer.fit()
        self._renderer.lay_over(self._comparison, difference=self._difference)
        self.set_turning(self._turning)
        self.set_picking(self._picking)
        self._show_state()
        self.request_picture()
        self.ready.emit()

    def hover(self, x: float, y: float) -> None:
        """React to the pointer over a pixel while no button is down."""

    def grip(self, x: float, y: float) -> bool:  # noqa: ARG002
        """Grip what a drag moves instead of the camera; return whether there is something. Pixels as in `pick`."""
        return False

    def drag_grip(self, x: float, y: float) -> None:
        """Move what was gripped to a pixel."""

    def turn_wheel(self, notches: float, x: float, y: float) -> bool:  # noqa: ARG002
        """Turn what is at a pixel instead of zooming; return whether there is something."""
        return False

    def pick(self, x: float, y: float) -> None:
        """Report what is at a pixel of the device, counted from the lower left."""
        if self._renderer is None:
            return
        if not self._picking:
            channel = self._renderer.pick(x, y)
            if channel is not None:
                self.taxel_picked.emit(channel)
            return
        # A pixel's place is that of its upper left corner: what is meant is its middle.
        place = self._renderer.pick_surface(x + 0.5, y - 0.5)
        if place is not None:
            self.set_picking(False)
            self.surface_picked.emit(place)
