"""Building blocks of layers: meshes that are added to the plotter once and change in place.

The picture has three renderers with one camera. `PART` draws the part without its outer side. `WITHIN` draws the half
transparent outer side and what changes inside the part, with the depth of `PART`. `FRONT` draws, on top and without regard to
depth, what the part must not cover; its layers leave out what faces away from the camera.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, cast

import numpy as np
import pyvista as pv
from vtkmodules.vtkRenderingCore import vtkRenderWindow

from app.scene3d.camera import Viewpoint
from app.scene3d.scene_state import DARK, Colour, ColourArray, Comparison, SceneColours, StaticScene
from skincal.geometry import FloatArray

if TYPE_CHECKING:
    from app.state.view_state import ViewState

PART, WITHIN, FRONT = 0, 1, 2  # Columns of the plotter's grid, drawn in this order
NO_POINTS: FloatArray = np.empty((0, 3))


def window_of(plotter: pv.BasePlotter) -> vtkRenderWindow:
    """Return the window of a plotter that is not closed."""
    assert plotter.render_window is not None
    return plotter.render_window


class MeshActor(ABC):
    """One mesh of the plotter, one colour a point; it is made once, and its arrays change in place."""

    def __init__(self, plotter: pv.BasePlotter, renderer: int, pixels: float, **look: Any) -> None:
        # VTK compiles a shader for what the mesh holds when it is drawn first (`SceneRenderer.compile_shaders`).
        self.mesh = self.connect(np.zeros((2, 3)))
        self.mesh["rgb"] = np.zeros((self.mesh.n_points, 3), np.uint8)
        self.pixels = pixels  # Width of lines, or diameter of points, in pixels of the desktop
        self.hidden = False
        self.is_empty = True
        plotter.subplot(0, renderer)
        self.renderer = renderer
        self.actor = plotter.add_mesh(
            self.mesh, scalars="rgb", rgb=True, copy_mesh=False, show_scalar_bar=False, reset_camera=False, render=False, **look
        )
        # pyvista puts a filter in Python before the mapper, to select the colours. VTK would ask it several times a picture.
        self.mesh.set_active_scalars("rgb")
        self.actor.mapper.SetInputData(self.mesh)
        self.actor.visibility = False
        self._keep_arrays()

    def _keep_arrays(self) -> None:
        """Keep the arrays of the mesh: each question to pyvista for one costs as much as a hundred points."""
        self._points: Any = self.mesh.points
        self._colours: Any = self.mesh.point_data["rgb"]

    @abstractmethod
    def connect(self, points: FloatArray) -> pv.PolyData:
        """Make the mesh whose lines connect these points."""

    def show(self, points: FloatArray, colours: ColourArray | Colour) -> None:
        """Show other points, (..., 3), metres, in colours, (n, 3) uint8, or one for all; without points show nothing."""
        points = points.reshape(-1, 3)
        self.is_empty = len(points) == 0
        if not self.is_empty:
            if len(points) == len(self._points):
                self._points[:] = points
            else:
                other = self.connect(points)
                other["rgb"] = np.zeros((len(points), 3), np.uint8)
                other.set_active_scalars("rgb")
                self.mesh.shallow_copy(other)
                self._keep_arrays()
            self._colours[:] = colours
        self.update_visibility()

    def update_visibility(self) -> None:
        self.actor.visibility = not (self.hidden or self.is_empty)

    def set_pixel_ratio(self, ratio: float) -> None:
        """Follow the screen: `ratio` device pixels are one pixel of the desktop."""
        self.actor.prop.line_width = self.actor.prop.point_size = self.pixels * ratio


class Dots(MeshActor):
    """Points of one size in pixels, drawn as lit balls."""

    def __init__(self, plotter: pv.BasePlotter, renderer: int, pixels: float, *, is_lit: bool = True) -> None:
        super().__init__(
            plotter, renderer, pixels, render_points_as_spheres=True, lighting=is_lit, ambient=0.35, diffuse=0.75
        )  # fmt: skip

    def connect(self, points: FloatArray) -> pv.PolyData:
        return pv.PolyData(points.copy())


class Segments(MeshActor):
    """Line segments of one width in pixels: each two points in turn are joined."""

    def __init__(self, plotter: pv.BasePlotter, renderer: int, pixels: float, *, opacity: float = 1.0) -> None:
        super().__init__(plotter, renderer, pixels, lighting=False, opacity=opacity)

    def connect(self, points: FloatArray) -> pv.PolyData:
        return pv.line_segments_from_points(points)


class Solid(MeshActor):
    """Triangles of one colour, not lit: `template` is moved as a whole, `show` gets its points."""

    def __init__(self, plotter: pv.BasePlotter, template: pv.PolyData, *, is_outline: bool = False) -> None:
        self.template = cast("pv.PolyData", template.triangulate())
        self.template.clear_data()
        # Of a solid that is a little larger only the far walls are drawn: they are an outline of the one inside.
        super().__init__(plotter, FRONT, 1.0, lighting=False, culling="front" if is_outline else "none")

    def connect(self, points: FloatArray) -> pv.PolyData:  # noqa: ARG002
        return self.template.copy()


class Label(NamedTuple):
    """Words in the picture."""

    text: str
    at: FloatArray
    """(3,) float, metres."""
    gap: float = 0.0
    """Pixels of the desktop from `at` to the words next to it; 0 for words in the middle of `at`."""
    priority: float = 0.0
    """Of two labels that would cover each other, the one with the lower priority is left out."""


class Layer:
    """One kind of object in the 3D picture, such as landmarks."""

    name: ClassVar[str]

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene) -> None:
        self.plotter, self.static = plotter, static
        self.colours = DARK
        self.viewpoint: Viewpoint | None = None  # `None` before the first picture
        self.labels: Sequence[Label] = ()
        self.difference = False  # Draw a line from each estimate to another method's
        self.comparison: Comparison | None = None  # `None` while nothing is compared

    def parts(self) -> Mapping[str, Sequence[MeshActor]]:
        """Return the actors by the name with which they are switched on and off."""
        return {self.name: [actor for actor in vars(self).values() if isinstance(actor, MeshActor)]}

    def set_colours(self, colours: SceneColours) -> None:
        """Take the colours of a theme; called before the first `show`."""
        self.colours = colours
        self.draw()

    def show(self, state: ViewState) -> bool:  # noqa: ARG002
        """Update the meshes to a moment of the session; return whether anything changed."""
        return False

    def obstacles(self) -> FloatArray:
        """Return points that labels should not cover, (n, 3) float, metres."""
        return NO_POINTS

    def follow_camera(self, viewpoint: Viewpoint) -> None:
        """Update meshes and labels that depend on the camera; called before each picture after the camera moved."""
        self.viewpoint = viewpoint
        self.draw()

    def draw(self) -> None:
        """Update the meshes that depend on the theme or the camera."""
