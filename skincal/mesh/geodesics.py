"""Straight paths over a mesh, many at once: each triangle in a plane of its own, unfolded into its neighbours' planes.

The algorithm: `skincal/solver/source/walk.h`. A path has the same bits for any other paths that are walked with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, IntArray, select_rows
from skincal.mesh.search import surface_in_solver
from skincal.mesh.surface import Surface, cached_per_surface, neighbours
from skincal.solver.machine import Machine


@dataclass(frozen=True, slots=True, eq=False)
class MeshPoints:
    """n points on a surface, each with a direction along it."""

    triangles: IntArray
    """(n,)."""
    points: FloatArray
    """(n, 3) float, metres, in the planes of the triangles."""
    x: FloatArray
    """(n, 3) float, unit, in the planes of the triangles."""

    def select(self, rows: IntArray | slice) -> MeshPoints:
        return select_rows(self, rows)


@dataclass(frozen=True, eq=False)
class Geodesics:
    """Surface prepared for walking; its triangles have an area."""

    machine: Machine
    ground: int
    """Place of its `Ground` in the machine."""

    def walk(self, start: MeshPoints, ways: FloatArray) -> MeshPoints:
        """Walk along geodesics from n points to their ends; the start's direction x is carried along.

        `ways` are (n, 2) float, metres: the distances along the start's x, and along normal x x.
        """
        end = self.machine.run(
            "walk",
            ground=self.ground,
            walks=len(ways),
            ways=ways,
            points=start.points,
            x=start.x,
            triangles=start.triangles,
        )
        return MeshPoints(end["triangles"].astype(np.int64), end["points"], end["x"])


@cached_per_surface
def geodesics_of(surface: Surface) -> Geodesics:
    """Prepare a surface for walking."""
    machine, place = surface_in_solver(surface)
    return Geodesics(machine, machine.store("Ground", surface=place, over=neighbours(surface.triangles) // 3))
