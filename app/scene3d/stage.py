"""The layers of one scene in one renderer, and the camera before them.

Only what the scene supports is built: no mesh, no surface layer; no layout, or a layout without a place, no outlines. Landmarks
may be added to any scene, and be asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import vtkmodules.vtkRenderingFreeType
import vtkmodules.vtkRenderingOpenGL2  # noqa: F401  (drawing code behind the classes below; it registers itself)
from vtkmodules.vtkCommonCore import vtkCommand
from vtkmodules.vtkRenderingCore import vtkLight, vtkRenderer

from app.scene3d import camera
from app.scene3d.axes import AxesLayer
from app.scene3d.compare import CompareLayer
from app.scene3d.estimates import EstimatesLayer
from app.scene3d.ground import DEFAULT_RADIUS, Frame, Ground
from app.scene3d.hints import HintsLayer
from app.scene3d.landmarks import LandmarksLayer
from app.scene3d.looks import Look, unit
from app.scene3d.modules import ModulesLayer
from app.scene3d.picking import nearest_at, project, ray, seen_point
from app.scene3d.shapes import Shape
from app.scene3d.surface import SurfaceLayer
from app.scene3d.target import TargetLayer
from app.scene3d.turning import Turner
from app.scene3d.uncertainty import UncertaintyLayer
from skincal.geometry.arrays import FloatArray, IntArray

SMALLEST = 0.015
"""m. Half the height of the view at least: half a module."""
LEAN_DEG = (-14.0, -10.0)
"""The first view is this far off straight, so that depth can be seen."""


class Layer(Protocol):
    """One kind of thing in the picture; its constructor makes its actors."""

    @property
    def name(self) -> str:
        """What the layer shows, in one word."""
        ...

    def dress(self, look: Look) -> None:
        """Take the colours of a theme; called before the first `show`."""
        ...

    def show(self, frame: Frame) -> bool:
        """Change arrays in place; return whether anything changed."""
        ...


class Stage:
    """Layers, lights and camera of a scene.

    Parameters
    ----------
    renderer : of any window: on the screen or not
    """

    def __init__(self, renderer: vtkRenderer, ground: Ground, look: Look) -> None:
        self.renderer = renderer
        self.ground = ground
        self.moved = False
        """The operator moved the camera: it is theirs from then on."""
        self.estimates = EstimatesLayer(renderer, ground)
        self.hints = HintsLayer(renderer)
        self.compare = CompareLayer(renderer, ground)
        self.landmarks = LandmarksLayer(renderer, ground)
        self.target = TargetLayer(renderer, ground)
        self.layers = self._build(renderer, ground)
        self.turner = Turner(ground.surface, camera.level_of(ground.extent))
        self._reach = (np.zeros(3), DEFAULT_RADIUS)
        _light(renderer)
        # Blending without sorting: the stage orders its translucent faces by culling (see `surface`), at half the time.
        renderer.SetUseOIT(False)
        self._observer = renderer.AddObserver(vtkCommand.StartEvent, self._before_picture)
        self.dress(look)

    def _build(self, renderer: vtkRenderer, ground: Ground) -> tuple[Layer, ...]:
        layers: list[Layer] = []
        layout = ground.scene.skin.layout
        if ground.shaded is not None:
            layers.append(SurfaceLayer(renderer, ground.shaded))
        if layout is not None and ground.laid is not None and np.isfinite(ground.places[:, 0]).any():
            layers.append(ModulesLayer(renderer, ground, layout, ground.laid))
        others = (self.estimates, AxesLayer(renderer, ground), UncertaintyLayer(renderer, ground))
        return (*layers, *others, self.landmarks, self.target, self.compare, self.hints)

    def list_layers(self) -> tuple[str, ...]:
        """Return the names of the layers that this scene has."""
        return tuple(layer.name for layer in self.layers)

    def dress(self, look: Look) -> None:
        """Take the colours of a theme."""
        self.renderer.SetBackground(*unit(look.background))
        for layer in self.layers:
            layer.dress(look)

    def show(self, frame: Frame) -> bool:
        """Show a moment; return whether the picture changes."""
        changed = [layer.show(frame) for layer in self.layers]
        if any(changed) and not len(self.ground.extent):
            self._follow_estimates()
        return any(changed)

    def turn(self, frame: Frame, now_s: float) -> bool:
        """Turn the camera to the target where it has to; return whether it moved."""
        width, height = self.renderer.GetSize()
        return self.turner.step(self.renderer.GetActiveCamera(), max(width, 1) / max(height, 1), frame, now_s)

    def touch(self, now_s: float) -> None:
        """Note that the operator moved the camera."""
        self.moved = True
        self.turner.touch(now_s)

    def hold(self, down: bool) -> None:
        """Note that a button of the mouse went down on the picture, or up."""
        self.turner.held = down

    def warm(self, draw: Callable[[], object]) -> None:
        """Draw a picture with something of every kind in it, so that no later one waits for a shader to be compiled."""
        middle = np.zeros((2, 3)) if not len(self.ground.extent) else np.tile(self.ground.extent.mean(axis=0), (2, 1))
        shapes = [shape for layer in self.layers for shape in vars(layer).values() if isinstance(shape, Shape)]
        waiting = [shape for shape in shapes if not shape.actor.GetVisibility()]
        for shape in waiting:
            shape.set(middle, np.zeros((2, 3), np.uint8))
        self.fit()
        draw()
        for shape in waiting:
            shape.set(np.empty((0, 3)), np.empty((0, 3), np.uint8))

    def fit(self) -> None:
        """Bring the whole part into the picture."""
        self.moved = False
        points = self.ground.extent if len(self.ground.extent) else self._known()
        width, height = self.renderer.GetSize()
        active = self.renderer.GetActiveCamera()
        least = SMALLEST if len(self.ground.extent) else DEFAULT_RADIUS
        camera.fit(active, points, self.ground.facing, max(width, 1) / max(height, 1), least)
        half = float(np.tan(np.radians(camera.VIEW_ANGLE / 2)) * active.GetDistance())
        self._reach = (np.array(active.GetFocalPoint()), half)
        if len(self.ground.extent):
            camera.orbit(active, *LEAN_DEG)

    def _known(self) -> FloatArray:
        """Return (n, 3) float, metres, what the session knows of the part: estimates and landmarks."""
        return np.concatenate([self.estimates.places, self.landmarks.places])

    def _follow_estimates(self) -> None:
        """Where nothing but the session tells where the part is, keep them in the picture."""
        places, (middle, half) = self._known(), self._reach
        if not self.moved and len(places) and np.linalg.norm(places - middle, axis=1).max() > half:
            self.fit()

    def pick(self, x: float, y: float) -> int | None:
        """Return the channel whose estimate a click means; x and y are pixels from the lower left."""
        screen = project(self.renderer, self.estimates.places)
        screen[~self.estimates.near] = np.nan
        row = nearest_at(screen, x, y, self.estimates.balls.actor.GetProperty().GetPointSize() / 2)
        return None if row is None else int(self.estimates.shown[row])

    def pick_surface(self, x: float, y: float) -> FloatArray | None:
        """Return the point of the part that is seen at a place of the picture, (3,) float, metres; None beside the part.

        Parameters
        ----------
        x, y : pixels from the lower left
        """
        surface = self.ground.surface
        return None if surface is None else seen_point(surface, *ray(self.renderer, x, y))

    def screen_places(self) -> tuple[IntArray, FloatArray]:
        """Return the channels that have a ball, (k,), and where the balls appear, (k, 3): see `picking.project`."""
        return self.estimates.shown, project(self.renderer, self.estimates.places)

    def close(self) -> None:
        """Let go of the renderer."""
        self.renderer.RemoveObserver(self._observer)
        self.renderer.RemoveAllViewProps()

    def _before_picture(self, *_: object) -> None:
        """Fit what depends on the camera; changes nothing else, so it asks for no further picture."""
        active = self.renderer.GetActiveCamera()
        size = self.renderer.GetSize()
        sight = camera.sight_of(active, size[1])
        # The clipping range has no say in where the camera stands; the names' places need one that holds the landmarks.
        self.renderer.ResetCameraClippingRange()
        for layer in (self.estimates, self.landmarks, self.target, self.compare):
            layer.follow(sight)
        self.hints.follow(active, (size[0], size[1]))
        self.renderer.ResetCameraClippingRange()


def _light(renderer: vtkRenderer) -> None:
    """One light at the camera: on software OpenGL a second one costs as much as the mesh."""
    renderer.RemoveAllLights()
    renderer.SetAutomaticLightCreation(False)
    light = vtkLight()
    light.SetLightTypeToHeadlight()
    renderer.AddLight(light)
