"""The part's mesh: matt grey, so that hue is free for the modules.

The outer side is drawn half transparent and the inner side opaque, as two actors that share one mesh. So an estimate that
lies a little inside the part shows through the near wall, while the far wall hides what is behind it, and neither
needs the picture sorted by depth.

The modules as planned: outlines in their hues, the taxels of the plan as faint dots, the modules' numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkPolyData
from vtkmodules.vtkRenderingCore import vtkActor, vtkBillboardTextActor3D, vtkPolyDataMapper, vtkProp, vtkProperty

from app.scene3d.names import make_readable
from app.scene3d.scene_state import HUES, ColourArray, Look, Shaded, StaticScene, unit
from app.scene3d.shapes import Dots, Layer, Segments, cells, closed, written
from app.scene3d.wall import facing
from skincal.geometry import FloatArray
from skincal.mesh.lay import LaidSkin
from skincal.model.skin import Layout

FRONT_OPACITY = 0.55
"""Share of light that the near wall keeps: an estimate inside still looks unlike one outside."""
SHADE = 0.15
"""Share of the inner side's brightness that depends on where it faces; worked out once, since lighting costs every frame."""
SHADE_FROM = np.array([0.36, 0.48, 0.8])
"""(3,) unit, link frame: the inner side is brightest where its outer side faces this way."""


class SurfaceLayer(Layer):
    """The mesh; nothing in it changes during a session."""

    name = "surface"

    def __init__(self, shaded: Shaded) -> None:
        super().__init__()
        points, self._normals, triangles = shaded
        # Copied (`deep`): VTK does not keep numpy's memory alive, and these arrays go with this function.
        places = vtkPoints(data=numpy_to_vtk(points.astype(np.float32), deep=True))
        mesh = vtkPolyData(points=places, polys=cells(triangles))
        mesh.GetPointData().SetNormals(numpy_to_vtk(self._normals.astype(np.float32), deep=True))
        self._tinted = vtkPolyData()
        # The same points and triangles in memory: only the inner side has a tint at each.
        self._tinted.ShallowCopy(mesh)
        self.inside = _side(self._tinted, frontface_culling=True, lighting=False)
        self.outside = _side(mesh, backface_culling=True, opacity=FRONT_OPACITY)

    def props(self) -> Sequence[vtkProp]:
        """Return the inner side, which is drawn first, then the outer."""
        return self.inside, self.outside

    def set_colours(self, look: Look) -> None:
        """Take the colours of a theme."""
        self.outside.GetProperty().SetColor(*unit(look.front))
        tint = 1.0 - SHADE + SHADE * (self._normals @ SHADE_FROM)
        colours = np.clip(np.outer(tint, look.back), 0, 255).astype(np.uint8)
        self._tinted.GetPointData().SetScalars(numpy_to_vtk(colours, deep=True))


def _side(mesh: vtkPolyData, **look: float) -> vtkActor:
    # Static: VTK need not ask before each picture whether the mesh changed.
    mapper = vtkPolyDataMapper(static=True)
    mapper.SetInputData(mesh)
    mapper.SetColorModeToDirectScalars()
    return vtkActor(mapper=mapper, property=vtkProperty(ambient=0.25, diffuse=0.75, specular=0.0, **look))


LIFT = 4e-4
"""m. Lines and dots float this far above the part, so that the mesh's flat triangles do not cut them."""
TOWARD_CORNER = 0.8
"""Share of the way from a module's middle to its first corner: its number stands where no taxel is."""
NUMBER_LIFT = 15e-3
"""m. So far towards the camera numbers are drawn: before the balls beside them, and before the curved part."""
TURNED = 0.3
"""Cosine. Numbers of modules that are turned further from the camera would stand in each other's way at the part's edge."""
MOST_NUMBERS = 40
"""Numbers on more modules than this would cover the skin that they name."""
FADE = 0.55
"""Share of the hue in a dot of the plan, the rest is the mesh's grey: fainter than any estimate."""


class ModulesLayer(Layer):
    """What the maker of the skin says; nothing in it changes during a session."""

    name = "modules"

    def __init__(self, static: StaticScene, layout: Layout, laid: LaidSkin) -> None:
        super().__init__()
        self.outlines = Segments(pixels=2.0)
        self.outlines.join(*_outline_segments(layout, laid))
        self.dots = Dots(pixels=3.0)
        self.known = np.isfinite(static.places[:, 0])
        self.places = (static.places + LIFT * static.normals)[self.known]
        self.hues = static.hues[self.known]
        self.numbers = _numbers(layout, laid) if len(layout.modules) <= MOST_NUMBERS else []
        self._on_surface = static.surface is not None

    def props(self) -> Sequence[vtkProp]:
        """Return outlines and dots, then the numbers before them."""
        return *super().props(), *(number.text for number in self.numbers)

    def set_colours(self, look: Look) -> None:
        """Take the colours of a theme."""
        super().set_colours(look)
        grey = np.array(look.faint, dtype=float)
        self.dots.set(self.places, (FADE * self.hues + (1 - FADE) * grey).astype(np.uint8))
        for number in self.numbers:
            make_readable(number.text, look, look.ink)

    def draw(self) -> None:
        """Keep the numbers before the balls, and leave out those of modules that are turned away."""
        if self.sight is None:
            return
        for number in self.numbers:
            number.text.SetPosition(*self.sight.lift(number.place, NUMBER_LIFT))
            seen = facing(number.normal[None], number.place[None], self.sight)[0] > TURNED
            number.text.SetVisibility(bool(seen or not self._on_surface))


def _outline_segments(layout: Layout, laid: LaidSkin) -> tuple[FloatArray, ColourArray]:
    ends: list[FloatArray] = []
    hues: list[ColourArray] = []
    for index, (module, outline) in enumerate(zip(layout.modules, laid.outlines, strict=True)):
        near = laid.places[module.channels], laid.normals[module.channels]
        sides = closed(_lifted(outline, *near)) if len(outline) else np.empty((0, 2, 3))
        sides = sides[np.isfinite(sides).all(axis=(1, 2))]
        ends.append(sides)
        hues.append(np.tile(HUES[index % len(HUES)], (len(sides), 1)))
    return np.concatenate(ends), np.concatenate(hues)


def _lifted(outline: FloatArray, places: FloatArray, normals: FloatArray) -> FloatArray:
    """Move each corner outward along the normal of the nearest taxel of the module."""
    known = np.isfinite(places[:, 0]) & np.isfinite(normals[:, 0])
    if not known.any():
        return outline
    distance = np.linalg.norm(outline[:, None] - places[known], axis=-1)
    return outline + LIFT * normals[known][np.where(np.isfinite(distance), distance, np.inf).argmin(axis=1)]


class Number(NamedTuple):
    """A module's number."""

    text: vtkBillboardTextActor3D
    place: FloatArray
    """(3,) float, metres."""
    normal: FloatArray
    """(3,) float, unit: which way the module faces."""


def _numbers(layout: Layout, laid: LaidSkin) -> list[Number]:
    numbers: list[Number] = []
    for module, outline in zip(layout.modules, laid.outlines, strict=True):
        places, normals = laid.places[module.channels], laid.normals[module.channels]
        known, corners = np.isfinite(places[:, 0]), outline[np.isfinite(outline).all(axis=1)]
        if not known.any() or not len(corners):
            continue
        middle, normal = places[known].mean(axis=0), normals[known].mean(axis=0)
        text = written(vtkBillboardTextActor3D(), str(module.id), letters=15)
        text.GetTextProperty().SetBold(True)
        place = middle + TOWARD_CORNER * (corners[0] - middle)
        numbers.append(Number(text, place, normal / np.linalg.norm(normal)))
    return numbers
