"""A 3D view on a (virtual) screen, and what its pixels show."""

from __future__ import annotations

import time

import numpy as np
from PySide6.QtCore import QEvent, QPoint, QPointF, Qt
from PySide6.QtGui import QImage, QMouseEvent, QWheelEvent
from PySide6.QtWidgets import QApplication, QMainWindow, QWidget

from app.scene3d import camera
from app.scene3d.canvas import Canvas
from app.scene3d.mesh_actors import MeshActor
from app.scene3d.scene_renderer import SceneRenderer
from app.scene3d.scene_state import StaticScene
from app.scene3d.view import View3D
from skincal.part.part import Part
from tests.app.scene3d_support import box, laid, layout, project, scene

KEPT: list[QMainWindow] = []  # Windows of this test: Python would delete them with their views


def make_view(qtbot, canvas=Canvas.RASTER, surface=True, plan=True, skin=None):
    """A view of the box with skin, built and on the screen."""
    plan_of = layout()
    return view_of(qtbot, canvas, scene(plan_of if plan else None), box() if surface else None, laid(plan_of) if plan else skin)


def view_of(qtbot, canvas, of, surface, skin):
    """A view of a scene with 24 channels, built and on the screen."""
    window = QMainWindow()
    KEPT.append(window)
    view = View3D(window, canvas)
    window.setCentralWidget(view)
    window.resize(640, 480)
    qtbot.addWidget(window, before_close_func=lambda _: view.close_view())
    with qtbot.waitExposed(window):
        window.show()
    with qtbot.waitSignal(view.ready, timeout=60_000):
        view.build_scene(StaticScene(Part(of, surface, skin, np.arange(24), ())))
    settle()
    return view


def renderer_of(view: View3D) -> SceneRenderer | None:
    """What VTK draws, layer by layer: what pixels cannot show, tests ask of VTK's own objects."""
    return view._renderer


def canvas_of(view: View3D) -> QWidget | None:
    """The widget under the pointer, which a hand clicks and drags."""
    return view.childAt(view.rect().center())


def points_of(actor: MeshActor) -> np.ndarray:
    """The points of a mesh as VTK draws them, (n, 3) metres; none while it is not seen."""
    return np.array(actor.mesh.points) if actor.actor.visibility else np.empty((0, 3))


def make_plotter(size=(640, 480)):
    """A plotter that is never on a screen, for layers without a view."""
    from app.scene3d.drawing_probe import choose_offscreen
    from app.scene3d.offscreen import make_plotter

    choose_offscreen()
    return make_plotter(size)


def settle():
    """Let everything be painted that was asked for."""
    for _ in range(4):
        QApplication.processEvents()


def pixels(view):
    """What the screen shows of the view, (height, width, 3) uint8."""
    settle()
    image = view.window().grab().toImage().convertToFormat(QImage.Format.Format_RGB888)
    rows = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), image.bytesPerLine())
    return rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).copy()


def around(picture, place, reach=6):
    x, y = (round(v) for v in place)
    return picture[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1].astype(int)


def turn(view: View3D, right_deg: float, up_deg: float) -> None:
    """Turn the part under the camera, as a drag of the mouse does."""
    camera.rotate(renderer_of(view).renderer.GetActiveCamera(), right_deg, up_deg)
    renderer_of(view).note_manual_move(time.monotonic())
    canvas_of(view).update()


def screen_place(view: View3D, channel: int) -> tuple[float, float] | None:
    """Where a taxel's estimate appears, in the widget's coordinates; None where it does not."""
    shown = renderer_of(view).estimates
    if channel not in shown.shown:
        return None
    at = project(renderer_of(view).renderer, shown.places)[list(shown.shown).index(channel), :2]
    x, y = at / view.devicePixelRatioF()
    return float(x), float(view.height() - y)


class Drawn:
    """Counts the pictures that VTK draws."""

    def __init__(self, view):
        self.count = 0
        renderer_of(view).window.AddObserver("EndEvent", self._note)

    def _note(self, *_):
        self.count += 1


def drag(canvas, button):
    for kind, x, held in (
        (QEvent.Type.MouseButtonPress, 200, button),
        (QEvent.Type.MouseMove, 230, button),
        (QEvent.Type.MouseMove, 260, button),
        (QEvent.Type.MouseButtonRelease, 260, Qt.MouseButton.NoButton),
    ):
        pressed = Qt.MouseButton.NoButton if kind == QEvent.Type.MouseMove else button
        event = QMouseEvent(kind, QPointF(x, 200), QPointF(x, 200), pressed, held, Qt.KeyboardModifier.NoModifier)
        QApplication.sendEvent(canvas, event)


def wheel(canvas, turn):
    at = QPointF(200, 200)
    none, plain, phase = Qt.MouseButton.NoButton, Qt.KeyboardModifier.NoModifier, Qt.ScrollPhase.NoScrollPhase
    QApplication.sendEvent(canvas, QWheelEvent(at, at, QPoint(), QPoint(0, turn), none, plain, phase, False))
