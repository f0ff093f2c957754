"""The part's mesh: matt grey, so that hue is free for the modules.

The outer side is drawn half transparent and the inner side opaque, as two actors that share one mesh. So an estimate that
lies a little inside the part shows through the near wall, while the far wall hides what is behind it, and neither
needs the picture sorted by depth.
"""

from __future__ import annotations

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkPolyData
from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper, vtkRenderer

from app.scene3d.shapes import Layer, cells
from app.scene3d.static_scene import Look, Shaded, unit

FRONT_OPACITY = 0.55
"""Share of light that the near wall keeps: an estimate inside still looks unlike one outside."""
SHADE = 0.15
"""Share of the inner side's brightness that depends on where it faces; worked out once, since lighting costs every frame."""
SHADE_FROM = np.array([0.36, 0.48, 0.8])
"""(3,) unit, link frame: the inner side is brightest where its outer side faces this way."""


class SurfaceLayer(Layer):
    """The mesh; nothing in it changes during a session."""

    name = "surface"

    def __init__(self, renderer: vtkRenderer, shaded: Shaded) -> None:
        mesh = _polydata(shaded)
        self._normals = shaded.normals
        self._tinted = vtkPolyData()
        self._tinted.ShallowCopy(mesh)
        self.inside = _side(self._tinted, hidden="front")
        self.outside = _side(mesh, hidden="back")
        self.inside.GetProperty().LightingOff()
        self.outside.GetProperty().SetOpacity(FRONT_OPACITY)
        for actor in (self.inside, self.outside):
            renderer.AddActor(actor)

    def set_colours(self, look: Look) -> None:
        """Take the colours of a theme."""
        self.outside.GetProperty().SetColor(*unit(look.front))
        tint = 1.0 - SHADE + SHADE * (self._normals @ SHADE_FROM)
        colours = np.clip(np.outer(tint, look.back), 0, 255).astype(np.uint8)
        self._tinted.GetPointData().SetScalars(numpy_to_vtk(colours, deep=True))


def _side(mesh: vtkPolyData, hidden: str) -> vtkActor:
    mapper = vtkPolyDataMapper()
    mapper.SetInputData(mesh)
    mapper.SetColorModeToDirectScalars()
    mapper.SetStatic(True)
    actor = vtkActor()
    actor.SetMapper(mapper)
    look = actor.GetProperty()
    look.SetBackfaceCulling(hidden == "back")
    look.SetFrontfaceCulling(hidden == "front")
    look.SetAmbient(0.25)
    look.SetDiffuse(0.75)
    look.SetSpecular(0.0)
    return actor


def _polydata(shaded: Shaded) -> vtkPolyData:
    points, normals, triangles = shaded
    mesh = vtkPolyData()
    places = vtkPoints()
    places.SetData(numpy_to_vtk(points.astype(np.float32), deep=True))
    mesh.SetPoints(places)
    mesh.SetPolys(cells(triangles))
    mesh.GetPointData().SetNormals(numpy_to_vtk(normals.astype(np.float32), deep=True))
    return mesh
