"""The stage: the layers of one scene in one renderer, and the camera before them; over all, a scale bar and the link's axes.

Only what the scene supports is built: no mesh, no surface layer; no layout, or a layout without a place, no outlines. Landmarks
may be added to any scene, and be asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

# Drawing code behind the classes below: each registers itself as it is imported.
import vtkmodules.vtkRenderingFreeType
import vtkmodules.vtkRenderingOpenGL2  # noqa: F401
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonCore import vtkCommand, vtkPoints
from vtkmodules.vtkCommonDataModel import vtkPolyData
from vtkmodules.vtkRenderingCore import (
    VTK_LIGHT_TYPE_HEADLIGHT,
    vtkActor2D,
    vtkLight,
    vtkPolyDataMapper2D,
    vtkProp,
    vtkProperty2D,
    vtkRenderer,
    vtkTextActor,
)

from app.scene3d import camera
from app.scene3d.axes import AxesLayer
from app.scene3d.camera import Sight, Turner, project, ray, sight_of
from app.scene3d.estimates import CompareLayer, EstimatesLayer, UncertaintyLayer
from app.scene3d.landmarks import LandmarksLayer
from app.scene3d.names import make_readable
from app.scene3d.part_layers import ModulesLayer, SurfaceLayer
from app.scene3d.scene_state import DEFAULT_RADIUS, Look, StaticScene, View3DState, unit
from app.scene3d.shapes import DrawnShape, Layer, cells, written
from app.scene3d.target import TargetLayer
from skincal.geometry import FloatArray
from skincal.mesh.surface import seen_point

EDGE = 26
"""Pixels between the hints and the edge of the picture."""
ARM = 30
"""Pixels, length of an axis that lies in the picture's plane."""
BAR = 120.0
"""Pixels, longest scale bar."""
LETTERS = ("x", "y", "z")


LINE, RIM = 2.0, 1.5
"""Pixels of a line of the hints, and on each side of it."""


class HintsLayer(Layer):
    """The scale in millimetres at the lower right, the link's axes at the lower left."""

    name = "hints"

    def __init__(self) -> None:
        super().__init__()
        self._xy = np.zeros((12, 3), dtype=np.float32)
        self._points = vtkPoints(data=numpy_to_vtk(self._xy))
        mapper = vtkPolyDataMapper2D()
        mapper.SetInputData(vtkPolyData(points=self._points, lines=cells(np.arange(12).reshape(-1, 2))))
        self.lines = vtkActor2D(mapper=mapper, property=vtkProperty2D(line_width=LINE))
        # Below the lines: they are seen on the part, of whatever grey, as beside it.
        self.rim = vtkActor2D(mapper=mapper, property=vtkProperty2D(line_width=LINE + 2 * RIM))
        self.texts = [written(vtkTextActor(), letter) for letter in LETTERS]
        self.length = written(vtkTextActor())

    def props(self) -> Sequence[vtkProp]:
        """Return the lines on their rim, then the letters."""
        return self.rim, self.lines, *self.texts, self.length

    def draw(self) -> None:
        """Draw the axes as they lie in the picture, and a bar of a round length."""
        self.lines.GetProperty().SetColor(*unit(self.look.ink))
        self.rim.GetProperty().SetColor(*unit(self.look.background))
        for text in (*self.texts, self.length):
            make_readable(text, self.look, self.look.ink)
        if self.sight is None:
            return
        self._xy[:6, :2] = self._axes(self.sight)
        self._xy[6:, :2] = self._bar(self.sight)
        self._points.GetData().Modified()
        self._points.Modified()

    def _axes(self, sight: Sight) -> FloatArray:
        turned = np.stack([sight.eye.right, sight.eye.up], axis=1)
        middle = np.full(2, EDGE + ARM)
        for text, direction in zip(self.texts, turned, strict=True):
            text.SetPosition(*(middle + direction * ARM * 1.3))
        return np.stack([np.tile(middle, (3, 1)), middle + ARM * turned], axis=1).reshape(6, 2)

    def _bar(self, sight: Sight) -> FloatArray:
        length_mm = round_below(BAR / sight.scale * 1e3)
        right, low = sight.size[0] - EDGE, EDGE
        left, tick = right - length_mm * 1e-3 * sight.scale, 5
        self.length.SetInput(f"{length_mm:g} mm")
        self.length.SetPosition((left + right) / 2, low + 14)
        ends = [[(end, low - tick), (end, low + tick)] for end in (left, right)]
        return np.array([(left, low), (right, low), *ends[0], *ends[1]])


def round_below(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above `value`."""
    power = 10.0 ** np.floor(np.log10(value))
    # The slack keeps a round length that a rounding made a little too long.
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value * (1 + 1e-9)))


SMALLEST = 0.015
"""m. Half the height of the view at least: half a module."""
LEAN_DEG = (-14.0, -10.0)
"""The first view is this far off straight, so that depth can be seen."""
REACH = 14.0
"""Pixels. A click this near to a ball means it: half a finger's width on a common screen."""


class Stage:
    """Layers, lights and camera of a scene, in the renderer of any window: on the screen or not."""

    def __init__(self, renderer: vtkRenderer, static: StaticScene, look: Look) -> None:
        self.renderer = renderer
        self.static = static
        self.moved = False
        """The operator moved the camera: it is theirs from then on."""
        self.estimates = EstimatesLayer(static)
        self.target, self.compare = TargetLayer(renderer, static, self.estimates), CompareLayer(static)
        self.landmarks = LandmarksLayer(renderer, static, self.target, self.estimates)
        self.layers = self._build(static)
        self._hidden: frozenset[str] = frozenset()
        self.hide(self._hidden)
        self.turner = Turner(static.surface, camera.level_of(static.extent))
        self._reach = (np.zeros(3), DEFAULT_RADIUS)
        _light(renderer)
        # Blending without sorting: the stage orders its translucent faces by culling (see `surface`), at half the time.
        renderer.SetUseOIT(False)
        # At the start of every picture, whoever asked for it.
        self._observer = renderer.AddObserver(vtkCommand.StartEvent, self._before_picture)
        self.set_colours(look)

    def _build(self, static: StaticScene) -> tuple[Layer, ...]:
        layers: list[Layer] = []
        layout = static.scene.skin.layout
        if static.shaded is not None:
            layers.append(SurfaceLayer(static.shaded))
        if layout is not None and static.laid is not None and np.isfinite(static.places[:, 0]).any():
            layers.append(ModulesLayer(static, layout, static.laid))
        # The landmarks' names make room for the target.
        others = (self.estimates, AxesLayer(static), UncertaintyLayer(static), self.target, self.landmarks)
        return (*layers, *others, self.compare, HintsLayer())

    def list_layers(self) -> tuple[str, ...]:
        """Return the names of the layers that this scene has."""
        return tuple(layer.name for layer in self.layers)

    def set_colours(self, look: Look) -> None:
        """Take the colours of a theme."""
        self.renderer.SetBackground(*unit(look.background))
        for layer in self.layers:
            layer.set_colours(look)

    def hide(self, names: frozenset[str]) -> None:
        """Leave these out of the picture, and show all others; names are those of `Layer.parts`."""
        self._hidden = names
        self.renderer.RemoveAllViewProps()
        for layer in self.layers:
            for name, props in layer.parts().items():
                for prop in props if name not in names else ():
                    self.renderer.AddViewProp(prop)

    def show(self, state: View3DState) -> bool:
        """Show a moment; return whether the picture changes."""
        changed = [layer.show(state) and layer.name not in self._hidden for layer in self.layers]
        if any(changed) and not len(self.static.extent):
            self._keep_known_in_picture()
        return any(changed)

    def turn(self, state: View3DState, now_s: float) -> bool:
        """Turn the camera to the target where it has to; return whether it moved."""
        width, height = self.renderer.GetSize()
        return self.turner.step(self.renderer.GetActiveCamera(), (max(width, 1), max(height, 1)), state, now_s)

    def touch(self, now_s: float) -> None:
        """Note that the operator moved the camera."""
        self.moved = True
        self.turner.touch(now_s)

    def hold(self, down: bool) -> None:
        """Note that a button of the mouse went down on the picture, or up."""
        self.turner.held = down

    def warm(self, draw: Callable[[], object]) -> None:
        """Draw a picture with something of every kind in it, so that no later one waits for a shader to be compiled."""
        middle = np.zeros((2, 3)) if not len(self.static.extent) else np.tile(self.static.extent.mean(axis=0), (2, 1))
        shapes = [shape for layer in self.layers for shape in vars(layer).values() if isinstance(shape, DrawnShape)]
        waiting = [shape for shape in shapes if not shape.actor.GetVisibility()]
        for shape in waiting:
            shape.set(middle, np.zeros((2, 3), np.uint8))
        self.fit()
        draw()
        for shape in waiting:
            shape.clear()

    def fit(self) -> None:
        """Bring the whole part into the picture."""
        self.moved = False
        points = self.static.extent if len(self.static.extent) else self._known()
        width, height = self.renderer.GetSize()
        active = self.renderer.GetActiveCamera()
        least = SMALLEST if len(self.static.extent) else DEFAULT_RADIUS
        camera.fit(active, points, self.static.facing, max(width, 1) / max(height, 1), least)
        half = float(np.tan(np.radians(camera.VIEW_ANGLE / 2)) * active.GetDistance())
        self._reach = (np.array(active.GetFocalPoint()), half)
        if len(self.static.extent):
            camera.orbit(active, *LEAN_DEG)

    def _known(self) -> FloatArray:
        """Return (n, 3) float, metres, what the session knows of the part: estimates and landmarks."""
        return np.concatenate([self.estimates.places, self.landmarks.places])

    def _keep_known_in_picture(self) -> None:
        """Keep estimates and landmarks in the picture where nothing else says where the part is."""
        places, (middle, half) = self._known(), self._reach
        if not self.moved and len(places) and np.linalg.norm(places - middle, axis=1).max() > half:
            self.fit()

    def pick(self, x: float, y: float) -> int | None:
        """Return the channel whose estimate a click means; x and y are pixels from the lower left."""
        if self.estimates.name in self._hidden:
            return None
        screen = project(self.renderer, self.estimates.places)
        screen[~self.estimates.near] = np.nan
        row = nearest_at(screen, x, y, self.estimates.balls.actor.GetProperty().GetPointSize() / 2)
        return None if row is None else int(self.estimates.shown[row])

    def pick_surface(self, x: float, y: float) -> FloatArray | None:
        """Return the point of the part that is seen at a pixel, (3,) float, metres; None beside the part; x, y as in `pick`."""
        surface = self.static.surface
        return None if surface is None else seen_point(surface, *ray(self.renderer, x, y))

    def close(self) -> None:
        """Let go of the renderer."""
        self.renderer.RemoveObserver(self._observer)
        self.renderer.RemoveAllViewProps()

    def _before_picture(self, *_: object) -> None:
        """Fit what depends on the camera; changes nothing else, so it asks for no further picture."""
        # VTK leaves room before and behind what it finds, enough for what the layers lift now.
        self.renderer.ResetCameraClippingRange()
        sight = sight_of(self.renderer)
        for layer in self.layers:
            layer.fit_to(sight)


def _light(renderer: vtkRenderer) -> None:
    """One light at the camera: on software OpenGL a second one costs as much as the mesh."""
    renderer.RemoveAllLights()
    renderer.SetAutomaticLightCreation(False)
    renderer.AddLight(vtkLight(light_type=VTK_LIGHT_TYPE_HEADLIGHT))


def nearest_at(screen: FloatArray, x: float, y: float, ball: float) -> int | None:
    """Return the row of the point that a click means: the foremost ball that it hits, else the nearest within `REACH`.

    `screen` is (n, 3) float, from `project`; x and y are pixels from the lower left, as `ball`, the radius of a drawn ball.
    """
    away = np.hypot(screen[:, 0] - x, screen[:, 1] - y)
    # So, and not `> 1`: the depth of what lies behind the camera is NaN.
    away[~(np.abs(screen[:, 2]) <= 1.0)] = np.inf
    hit = np.flatnonzero(away <= ball)
    if len(hit):
        return int(hit[np.argmin(screen[hit, 2])])
    if len(away) == 0 or not away.min() <= REACH:
        return None
    return int(np.argmin(away))
