"""The part's mesh in matt grey, and the planned modules on it.

The outer side is half transparent and the inner side opaque, as two actors of one mesh. So the force axis of a poke is seen
inside the part, the far wall hides what is behind it, and neither needs the picture sorted by depth.
"""

from __future__ import annotations

import numpy as np
import pyvista as pv

from app.scene3d.camera import facing
from app.scene3d.lines import closed
from app.scene3d.mesh_actors import PART, WITHIN, Dots, Label, Layer, Segments
from app.scene3d.scene_state import ColourArray, SceneColours, StaticScene, rgb
from app.theme import module_hue
from skincal.geometry import FloatArray
from skincal.mesh.lay import PlacedLayout
from skincal.mesh.surface import Surface
from skincal.model.skin import Layout

FRONT_FACES_OPACITY = 0.55


class SurfaceLayer(Layer):
    """The mesh of the part; it does not change during a session."""

    name = "surface"

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene, surface: Surface) -> None:
        super().__init__(plotter, static)
        self.mesh = _mesh_of(surface)
        plotter.subplot(0, PART)
        self.inside = plotter.add_mesh(
            self.mesh, culling="front", ambient=0.8, diffuse=0.2, copy_mesh=False, reset_camera=False, render=False
        )  # fmt: skip
        plotter.subplot(0, WITHIN)
        self.outside = plotter.add_mesh(
            self.mesh, culling="back", opacity=FRONT_FACES_OPACITY, ambient=0.25, diffuse=0.75, copy_mesh=False,
            reset_camera=False, render=False,
        )  # fmt: skip

    def set_surface(self, surface: Surface) -> None:
        self.mesh.shallow_copy(_mesh_of(surface))

    def set_colours(self, colours: SceneColours) -> None:
        self.inside.prop.color, self.outside.prop.color = colours.back, colours.front


def _mesh_of(surface: Surface) -> pv.PolyData:
    # Without normals: each triangle has one shade. The shader computes its normal, in three quarters of the time.
    return pv.PolyData.from_regular_faces(surface.vertices, surface.triangles)


OUTLINE_HEIGHT_ABOVE_PART_M = 4e-4
"""m. Lines and dots float this far above the part, so that the mesh's flat triangles do not cut them."""
MODULE_TO_NUMBER_GAP_PX = 2.0  # Between a module's first corner and its number: no taxel is there
MIN_NUMBERED_MODULE_SIZE_PX = 40.0  # Numbers on modules that are smaller on the screen would cover them
MIN_MODULE_FACING_COSINE = 0.3
"""Cosine. Numbers of modules that are turned further from the camera would overlap at the part's edge."""
MAX_NUMBERED_MODULES = 40  # Numbers on more modules than this would cover the skin
PLAN_DOT_HUE_SHARE = 0.55  # Of the hue in a dot of the plan, the rest is grey: fainter than any estimate


class ModulesLayer(Layer):
    """The modules as planned: outlines in their hues, the taxels as faint dots, the modules' numbers."""

    name = "modules"
    dot_px = 3.0
    hue_share = PLAN_DOT_HUE_SHARE

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene, layout: Layout, laid: PlacedLayout) -> None:
        super().__init__(plotter, static)
        self.outlines, self.dots = Segments(plotter, PART, 2.0), Dots(plotter, PART, self.dot_px, is_lit=False)
        self._set_modules(layout, laid)

    def set_layout(self, static: StaticScene, layout: Layout, laid: PlacedLayout) -> None:
        self.static = static
        self._set_modules(layout, laid)
        self.set_colours(self.colours)
        self.draw()

    def _set_modules(self, layout: Layout, laid: PlacedLayout) -> None:
        self.outlines.show(*_outline_segments(layout, laid))
        self._module_size = 0.0
        self._numbers: list[tuple[Label, FloatArray]] = []
        for module, outline in zip(layout.modules, laid.outlines, strict=True):
            places, normals = laid.places[module.channels], laid.normals[module.channels]
            known, corners = np.isfinite(places[:, 0]), outline[np.isfinite(outline).all(axis=1)]
            if known.any() and len(corners):
                normal = normals[known].mean(axis=0)
                self._numbers.append(
                    (Label(str(module.id), corners[0], MODULE_TO_NUMBER_GAP_PX), normal / np.linalg.norm(normal))
                )
                self._module_size = float(np.ptp(corners, axis=0).max())

    def set_colours(self, colours: SceneColours) -> None:
        self.colours = colours
        known = np.isfinite(self.static.places[:, 0])
        points = (self.static.places + OUTLINE_HEIGHT_ABOVE_PART_M * self.static.normals)[known]
        shades = self.hue_share * self.static.hues[known] + (1 - self.hue_share) * np.array(colours.faint)
        self.dots.show(points, shades.astype(np.uint8))

    def draw(self) -> None:
        """Leave out the numbers of modules that are turned away."""
        if self.viewpoint is None or len(self._numbers) > MAX_NUMBERED_MODULES:
            return
        position, is_flat = self.viewpoint.pose.position, self.static.surface is None
        self.labels = [
            label
            for label, normal in self._numbers
            if self._module_size > MIN_NUMBERED_MODULE_SIZE_PX * self.viewpoint.pixel
            and (is_flat or facing(normal[None], label.at[None], position)[0] > MIN_MODULE_FACING_COSINE)
        ]


def _outline_segments(layout: Layout, laid: PlacedLayout) -> tuple[FloatArray, ColourArray]:
    ends, hues = [np.empty((0, 2, 3))], [np.empty((0, 3), np.uint8)]
    for index, (module, outline) in enumerate(zip(layout.modules, laid.outlines, strict=True)):
        if len(outline):
            sides = closed(_lifted(outline, laid.places[module.channels], laid.normals[module.channels]))
            sides = sides[np.isfinite(sides).all(axis=(1, 2))]
            ends.append(sides)
            hues.append(np.tile(np.array(rgb(module_hue(index)), np.uint8), (2 * len(sides), 1)))
    return np.concatenate(ends), np.concatenate(hues)


def _lifted(outline: FloatArray, places: FloatArray, normals: FloatArray) -> FloatArray:
    """Move each corner outward along the normal of the nearest taxel of the module."""
    known = np.isfinite(places[:, 0]) & np.isfinite(normals[:, 0])
    if not known.any():
        return outline
    distance = np.linalg.norm(outline[:, None] - places[known], axis=-1)
    return (
        outline + OUTLINE_HEIGHT_ABOVE_PART_M * normals[known][np.where(np.isfinite(distance), distance, np.inf).argmin(axis=1)]
    )
