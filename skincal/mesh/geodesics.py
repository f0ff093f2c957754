"""Straight ways over a mesh, many at once: each triangle in a plane of its own, unfolded into its neighbours' planes.

How they are found, and why they are straight: `skincal/solver/source/walk.h`. A walk has the same bits whichever others are
walked with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.mesh.search import surface_in_solver
from skincal.mesh.surface import Surface, cached_per_surface, neighbours
from skincal.solver.machine import INTEGER, WORD, Machine


@dataclass(frozen=True, slots=True, eq=False)
class MeshPoints:
    """n places on a surface, each with a direction along it."""

    triangles: IntArray
    """(n,)."""
    points: FloatArray
    """(n, 3) float, metres, in the planes of the triangles."""
    x: FloatArray
    """(n, 3) float, unit, in the planes of the triangles."""

    def take(self, rows: IntArray | slice) -> MeshPoints:
        """Return some of them."""
        return MeshPoints(self.triangles[rows], self.points[rows], self.x[rows])


@dataclass(frozen=True, eq=False)
class Geodesics:
    """A surface whose triangles have an area, ready to be walked on."""

    machine: Machine
    ground: int
    """The place of its `Ground` there."""

    def walk(self, start: MeshPoints, ways: FloatArray) -> MeshPoints:
        """Return where straight walks from each of n places end; x there is the start's x, carried along.

        `ways` are (n, 2) float, metres: how far along the start's x, and along normal x x.
        """
        with self.machine.call() as call:
            points, x = call.changed(start.points), call.changed(start.x)
            triangles = call.changed(start.triangles, INTEGER)
            call.run("walk", [self.ground, len(ways), call.give(ways), points, x, triangles])
            return MeshPoints(call.taken(triangles).astype(np.int64), call.taken(points), call.taken(x))


@cached_per_surface
def geodesics_of(surface: Surface) -> Geodesics:
    """Return the surface ready to be walked on."""
    machine, place = surface_in_solver(surface)
    over = neighbours(surface.triangles) // 3
    return Geodesics(machine, machine.keep(np.array([place, machine.keep(over.astype(np.int32))], dtype=WORD)))
