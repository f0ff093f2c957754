"""The normals by which a mesh is shaded: smooth where the part is smooth, sharp along its edges."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skincal.geometry.arrays import FloatArray, IntArray

CREASE = float(np.cos(np.radians(40.0)))
"""Cosine. A triangle more than 40 degrees off the mean of a vertex is beyond an edge; below it the part is smooth."""


class Shaded(NamedTuple):
    """A mesh with one normal a point."""

    points: FloatArray
    """(k, 3) float, metres; the mesh's vertices come first."""
    normals: FloatArray
    """(k, 3) float, unit."""
    triangles: IntArray
    """(nt, 3) int."""


def shade(vertices: FloatArray, triangles: IntArray, normals: FloatArray) -> Shaded:
    """Give every corner the normal to shade it with: smooth, but sharp along edges.

    A corner takes the mean normal of its vertex, weighted by area. Where that is more than `CREASE` off one of the
    vertex's triangles, every corner there gets a point of its own with its triangle's normal.

    Parameters
    ----------
    vertices : (nv, 3) float, metres
    triangles : (nt, 3) int
    normals : (nt, 3) float, unit
    """
    corners = vertices[triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    weighted = np.repeat(normals * areas[:, None], 3, axis=0)
    owner = triangles.ravel()
    mean = np.stack([np.bincount(owner, weighted[:, axis], len(vertices)) for axis in range(3)], axis=1)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), np.finfo(float).tiny)
    own = np.repeat(normals, 3, axis=0)
    on_edge = np.zeros(len(vertices), dtype=bool)
    on_edge[owner[np.einsum("ix,ix->i", mean[owner], own) < CREASE]] = True
    sharp = np.flatnonzero(on_edge[owner])
    split = owner.copy()
    split[sharp] = len(vertices) + np.arange(len(sharp))
    points = np.concatenate([vertices, vertices[owner[sharp]]])
    return Shaded(points, np.concatenate([mean, own[sharp]]), split.reshape(-1, 3))
