"""The picture of one scene: its layers in a pyvista plotter of any kind, on the screen or not, and the camera.

Only the layers that the scene supports are built: without a mesh no surface layer, without a laid layout no outlines.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pyvista as pv
from vtkmodules.vtkCommonCore import vtkCommand
from vtkmodules.vtkRenderingCore import vtkCellPicker

from app.scene3d import camera
from app.scene3d.axes import AxesLayer
from app.scene3d.camera import AutoCamera, Viewpoint, place, pose_of
from app.scene3d.estimates import CompareLayer, EstimatesLayer, UncertaintyLayer
from app.scene3d.hints import HintsLayer
from app.scene3d.kept_part import KeptPart
from app.scene3d.labels import Labels
from app.scene3d.landmarks import LandmarksLayer
from app.scene3d.lines import DRAWN_TOOL_LENGTH_M
from app.scene3d.mesh_actors import FRONT, PART, WITHIN, Layer, window_of
from app.scene3d.part_layers import ModulesLayer, SurfaceLayer
from app.scene3d.robot_tip import RobotTipLayer
from app.scene3d.scene_state import DEFAULT_VIEW_HALF_HEIGHT_M, Comparison, SceneColours, StaticScene
from app.scene3d.target import TargetLayer
from skincal.geometry import FloatArray

if TYPE_CHECKING:
    from app.state.view_state import ViewState

MIN_VIEW_HALF_HEIGHT_M = 0.015  # m, of the view: half a module
FIRST_LEAN_DEG = (-14.0, -10.0)  # The first view is this far off straight, so that depth can be seen
PLOTTER_SHAPE = (1, 3)
"""Shape of the plotter's grid: its renderers (see `mesh_actors`) are all as large as the picture."""
FONT_POINTS_PER_INCH = 72.0
DEPTH_STEP_M = DRAWN_TOOL_LENGTH_M  # Of the ends of the box that the camera's depth range holds


class SceneRenderer:
    """Layers, light and camera of a scene in a plotter of shape `PLOTTER_SHAPE`."""

    first_lean_deg = FIRST_LEAN_DEG

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene, colours: SceneColours) -> None:
        self.plotter, self.static, self.window = plotter, static, window_of(plotter)
        self.is_moved = False  # The operator moved the camera
        self.scales: Callable[[], tuple[float, float]] = lambda: (1.0, 1.0)
        """Device pixels a pixel of the desktop, and size of the text in sizes of the desktop's."""
        self.renderer, within, front = (plotter.renderers[index] for index in (PART, WITHIN, FRONT))
        self.window.SetNumberOfLayers(3)
        within.SetLayer(WITHIN)
        within.SetPreserveDepthBuffer(True)
        front.SetLayer(FRONT)
        for renderer in (self.renderer, within, front):
            renderer.SetViewport(0.0, 0.0, 1.0, 1.0)
            # One light at the camera: on software OpenGL a second one costs as much as the mesh.
            renderer.add_light(pv.Light(light_type="headlight"))
            # Blending without sorting: the part's two sides are ordered by culling, at half the time.
            renderer.SetUseOIT(False)
        self.camera = self.renderer.camera
        plotter.link_views()
        self.layers = self.build_layers()
        self._actors = [actor for layer in self.layers for own in layer.parts().values() for actor in own]
        # pyvista looks at each name that is asked of an object, and a picture would ask for hundreds.
        self._bounds_of = [renderer.ComputeVisiblePropBounds for renderer in (self.renderer, within, front)]
        self.labels = Labels(plotter)
        self._labels_key: list[tuple[str, bytes, float]] | None = None
        self._hidden: frozenset[str] = frozenset()
        self._surface_actor = next((layer.outside for layer in self.layers if isinstance(layer, SurfaceLayer)), None)
        half_height = MIN_VIEW_HALF_HEIGHT_M if len(static.extent) else DEFAULT_VIEW_HALF_HEIGHT_M
        self.auto_camera = AutoCamera(
            static.surface, camera.Framing(static.extent, static.facing), half_height, self.first_lean_deg
        )
        self._viewpoint: Viewpoint | None = None
        self._scales = (0.0, 0.0)
        self._fitted_size = (0, 0)
        self._known_reach = (np.zeros(3), DEFAULT_VIEW_HALF_HEIGHT_M)
        # At the start of every picture, also of those that Qt requests.
        self.kept_part = KeptPart(self.window, self.renderer, within, front) if self.window.GetOffScreenRendering() else None
        self._observer = self.window.AddObserver(vtkCommand.StartEvent, self._before_picture)
        self.set_colours(colours)

    def build_layers(self) -> tuple[Layer, ...]:
        """Make the layers that the scene supports."""
        plotter, static, layout = self.plotter, self.static, self.static.layout
        self.estimates, self.target = EstimatesLayer(plotter, static), TargetLayer(plotter, static)
        self.landmarks, self.compare = LandmarksLayer(plotter, static), CompareLayer(plotter, static)
        layers: list[Layer] = []
        if static.surface is not None:
            layers.append(SurfaceLayer(plotter, static, static.surface))
        if layout is not None and static.laid is not None and np.isfinite(static.places[:, 0]).any():
            layers.append(ModulesLayer(plotter, static, layout, static.laid))
        hints = HintsLayer(plotter, static)
        hints.frame = static.scene.link
        others = (self.estimates, AxesLayer(plotter, static), UncertaintyLayer(plotter, static), self.target, self.landmarks)
        return (*layers, *others, *self._turns(), self.compare, hints, RobotTipLayer(plotter, static), *self._tool())

    def _turns(self) -> Sequence[Layer]:
        if self.static.scene.skin.axes is None:
            return ()
        from app.scene3d.taxel_axes import TaxelAxesLayer  # other skins do without

        return (TaxelAxesLayer(self.plotter, self.static, self.estimates),)

    def _tool(self) -> Sequence[Layer]:
        if self.static.scene.tool is None:
            return ()
        from app.scene3d.tool import ToolLayer  # other parts do without

        return (ToolLayer(self.plotter, self.static),)

    def list_layers(self) -> tuple[str, ...]:
        """Return the names of the layers that this scene has."""
        return tuple(layer.name for layer in self.layers)

    def set_colours(self, colours: SceneColours) -> None:
        self.renderer.SetBackground(*pv.Color(colours.background).float_rgb)
        self.labels.set_colours(colours)
        for layer in self.layers:
            layer.set_colours(colours)

    def hide(self, names: frozenset[str]) -> None:
        """Hide the parts with these names (see `Layer.parts`), and show all others."""
        self._hidden, self._viewpoint = names, None
        for layer in self.layers:
            if isinstance(layer, SurfaceLayer):
                layer.inside.visibility = layer.outside.visibility = layer.name not in names
            for name, actors in layer.parts().items():
                for actor in actors:
                    actor.hidden = name in names
                    actor.update_visibility()

    def lay_over(self, comparison: Comparison | None, *, difference: bool) -> None:
        """Set what `show` lays over the estimates: compared sets, or lines to another method's."""
        for layer in self.layers:
            layer.comparison, layer.difference = comparison, difference

    def show(self, state: ViewState) -> bool:
        """Update all layers; return whether the picture changes. Positions in another frame than the part's are left out."""
        state = state.on_part
        changed = [layer.name for layer in self.layers if layer.show(state)]
        places, (middle, reach) = self._known_places(), self._known_reach
        # Nothing else says where the part is.
        is_followed = len(places) and not len(self.static.extent) and not self.is_moved
        if is_followed and np.linalg.norm(places - middle, axis=1).max() > reach:
            self.fit()
        return not self._hidden.issuperset(changed)

    def turn(self, state: ViewState, now_s: float) -> bool:
        """Turn the camera to the target if needed; return whether it moved."""
        height = self.window.GetSize()[1] / self.scales()[0]
        return self.auto_camera.advance(self.camera, self.aspect(), height, state, now_s)

    def note_manual_move(self, now_s: float, *, keeps_distance: bool = False) -> None:
        self.is_moved = True
        self.auto_camera.note_manual_move(now_s, keeps_distance=keeps_distance)

    def fit(self) -> None:
        self.is_moved = False
        pose = self.fitted_pose()
        place(self.camera, pose)
        self._known_reach = pose.focus, camera.VIEW_SLOPE * pose.distance
        self._fitted_size = self.window.GetSize()

    def fitted_pose(self) -> camera.CameraPose:
        """Return the camera pose that shows the whole part."""
        if not len(self.static.extent):
            self.auto_camera.framing = camera.Framing(self._known_places(), self.static.facing)
        return self.auto_camera.rest(self.aspect())

    def compile_shaders(self) -> None:
        """Draw a picture with something of every kind in it, so that no later one waits for a shader to be compiled."""
        for actor in self._actors:
            actor.actor.visibility = True
        self.fit()
        self.window.Render()
        for actor in self._actors:
            actor.update_visibility()

    def pick(self, x: float, y: float) -> int | None:
        """Return the channel whose estimate is at a pixel, counted from the lower left; `None` if there is none."""
        return self.estimates.pick(x, y, self.plotter.renderers[FRONT])

    def pick_surface(self, x: float, y: float) -> FloatArray | None:
        """Return the point of the part that is seen at a pixel, (3,) float, metres; `None` next to the part."""
        if self._surface_actor is None or self.static.surface is None:
            return None
        picker = vtkCellPicker()
        picker.SetTolerance(0.0)
        picker.PickFromListOn()
        picker.AddPickList(self._surface_actor)
        if not picker.Pick(x, y, 0.0, self.renderer):
            return None
        at = np.array(picker.GetPickPosition())
        # The inner side of the part is no place to poke.
        outward = self.static.surface.normals[picker.GetCellId()]
        return at if outward @ (pose_of(self.camera).position - at) > 0.0 else None

    def close(self) -> None:
        self.window.RemoveObserver(self._observer)
        if self.kept_part is not None:
            self.kept_part.close()
        for renderer in self.plotter.renderers:
            renderer.RemoveAllViewProps()

    def _known_places(self) -> FloatArray:
        """Return the positions of estimates and landmarks, (n, 3) float, metres."""
        return np.concatenate([self.estimates.places, self.landmarks.places])

    def aspect(self) -> float:
        """Return the picture's width over its height."""
        width, height = self.window.GetSize()
        return max(width, 1) / max(height, 1)

    def _before_picture(self, *_: object) -> None:
        """Follow the camera and the screen; changes nothing else, so it asks for no further picture."""
        scales, window = self.scales(), self.window
        if not self.is_moved and window.GetSize() != self._fitted_size:
            # The part fills a picture of another shape, too.
            self.fit()
        if scales != self._scales:
            self._scales = scales
            window.SetDPI(round(FONT_POINTS_PER_INCH * scales[0]))
            self.labels.set_font_scale(scales[1])
            for actor in self._actors:
                actor.set_pixel_ratio(scales[0])
        viewpoint = Viewpoint(pose_of(self.camera), window.GetSize(), scales[0])
        if not viewpoint.is_same(self._viewpoint):
            self._viewpoint = viewpoint
            for layer in self.layers:
                layer.follow_camera(viewpoint)
            self._labels_key = None
        labels = [label for layer in self.layers if layer.name not in self._hidden for label in layer.labels]
        key = [(label.text, label.at.tobytes(), label.gap) for label in labels]
        if key != self._labels_key:
            self._labels_key = key
            obstacles = np.concatenate([layer.obstacles() for layer in self.layers])
            self.labels.show(labels, obstacles, viewpoint)
        self._set_depth_range()
        if self.kept_part is not None:
            self.kept_part.prepare(viewpoint, self._actors, self.labels.version, self.camera.GetClippingRange())
            self.labels.set_drawn(self.kept_part.has_labels_to_draw(self.labels.boxes(viewpoint)))

    def _set_depth_range(self) -> None:
        """Set the depths between which the camera sees: a force axis that turns at the part does not change them."""
        bounds = np.array([bounds() for bounds in self._bounds_of]).reshape(3, 3, 2)
        ends = bounds * (1.0, -1.0)  # Of both ends the lower one is further out
        seen = np.minimum(ends[PART] - 2.0 * DEPTH_STEP_M, (np.floor(ends[WITHIN:] / DEPTH_STEP_M) * DEPTH_STEP_M).min(axis=0))
        self.renderer.ResetCameraClippingRange(*(seen * (1.0, -1.0)).ravel())
