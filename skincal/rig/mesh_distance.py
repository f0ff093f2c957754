"""Distance of a tool's touches from the mesh of a part whose pose is given.

A wrong tip, a wrong radius of its ball and a wrong pose of the part all move the touches off the mesh. A right rig touches it
within the error of the tip and the height of the foam. A tip that is wrong along the push leaves the test pokes in agreement,
since all pokes of a taxel are wrong alike: the mesh alone shows it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.mesh.surface import Surface
from skincal.model.scene import NoiseSettings
from skincal.rig.part_touches import MESH_SD_M, PartTouches

OFF_MESH_MIN_TOUCHES = 6
OFF_MESH_MIN_M = 0.006
"""m, median distance. Foam of a robot skin is 2 to 5 mm thick; less also comes from the ordinary error of a typed pose."""
OFF_MESH_MIN_SDS = 4.0
"""The same in standard deviations of one touch."""


@dataclass(frozen=True, slots=True)
class MeshDistance:
    """Distance of touches from the mesh that is far beyond their error."""

    touches: int
    """Number of touches."""
    distance: float
    """m, median distance from the nearest point of the mesh."""
    height: float
    """m, median height over the mesh: negative inside the part."""
    expected: float
    """m, median sd of the height of one touch."""


def find_mesh_distance(touches: PartTouches, surface: Surface, noise: NoiseSettings) -> MeshDistance | None:
    """Measure how far touches lie from the mesh; `None` if they agree with it, or are too few.

    Parameters
    ----------
    touches : `place` and `push` in the link frame
    noise : of the scene: `skin` is the sd of the foam's height
    """
    from skincal.mesh.search import nearest_pushed_points  # a part without a mesh does without

    rows = touches.on_mesh
    if len(rows) < OFF_MESH_MIN_TOUCHES:
        return None
    used = touches.rows(rows)
    near, triangles = nearest_pushed_points(surface, used.place, used.push)
    normals, off = surface.normals[triangles], used.place - near
    variances = np.einsum("ni,nij,nj->n", normals, np.linalg.inv(used.precision), normals) + noise.skin**2 + MESH_SD_M**2
    distance, expected = float(np.median(np.linalg.norm(off, axis=1))), float(np.sqrt(np.median(variances)))
    if distance < max(OFF_MESH_MIN_M, OFF_MESH_MIN_SDS * expected):
        return None
    return MeshDistance(len(rows), distance, float(np.median(np.sum(normals * off, axis=1))), expected)
