"""Vertices merged and useless triangles dropped; nothing is filled, moved or added."""

from __future__ import annotations

import numpy as np

from skincal.geometry.arrays import FloatArray, IntArray
from skincal.surface.edges import connected

MERGE_DISTANCE = 1e-6
"""m. Vertices this near are one: a hundredth of what a cover is made to, far above the rounding of a 32-bit file."""
ZERO_HEIGHT = 1e-7
"""m. A triangle flatter than this has no direction: a 32-bit file in millimetres rounds 0.5 m to 3e-8 m."""
SLIVER_RATIO = 100.0
"""Longest side over height of a triangle that is reported as a sliver: its smallest angle is below 0.6 degrees."""
_SWEEP = np.array([0.4472135954999579, 0.5773502691896258, 0.6831300510639733])
"""A unit direction along which no CAD grid lines up, so that few vertices fall together when projected on it."""


def merge_vertices(vertices: FloatArray, triangles: IntArray) -> tuple[FloatArray, IntArray, int]:
    """Make one vertex of those nearer than `MERGE_DISTANCE`; vertices no triangle uses go.

    Returns
    -------
    vertices, triangles : in the order of the file
    merged : number of vertices that became another
    """
    used = np.zeros(len(vertices), dtype=bool)
    used[triangles] = True
    triangles = (np.cumsum(used) - 1)[triangles]
    vertices = vertices[used]
    same = _identical(vertices)
    keep = np.flatnonzero(same == np.arange(len(vertices)))
    near = connected(len(keep), _near_pairs(vertices[keep]))
    index = np.empty(len(vertices), dtype=np.int64)
    index[keep] = keep[near]
    index = index[same]
    kept = index == np.arange(len(vertices))
    return vertices[kept], (np.cumsum(kept) - 1)[index[triangles]], int((~kept).sum())


def _identical(vertices: FloatArray) -> IntArray:
    """Return for each vertex the first vertex with the very same coordinates."""
    if len(vertices) == 0:
        return np.empty(0, dtype=np.int64)
    order = np.lexsort(vertices.T)
    ranked = vertices[order]
    new = np.r_[True, (ranked[1:] != ranked[:-1]).any(axis=1)]
    first = np.empty(len(vertices), dtype=np.int64)
    # lexsort is stable, so the first of a run is the lowest index.
    first[order] = order[np.flatnonzero(new)][np.cumsum(new) - 1]
    return first


def _near_pairs(vertices: FloatArray) -> IntArray:
    """Return (m, 2): the pairs nearer than `MERGE_DISTANCE`, by a sweep along one direction; exact."""
    along = vertices @ _SWEEP
    order = np.argsort(along, kind="stable")
    along = along[order]
    pairs: list[IntArray] = []
    here = np.arange(len(order))
    step = 1
    while True:
        here = here[here + step < len(order)]
        here = here[along[here + step] - along[here] <= MERGE_DISTANCE]
        if here.size == 0:
            break
        a, b = order[here], order[here + step]
        near = np.linalg.norm(vertices[a] - vertices[b], axis=1) <= MERGE_DISTANCE
        pairs.append(np.stack([a[near], b[near]], axis=1))
        step += 1
    return np.concatenate(pairs) if pairs else np.empty((0, 2), dtype=np.int64)


def heights(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the smallest height and the longest side of each triangle of `corners` (nt, 3, 3), metres."""
    edges = corners[:, [1, 2, 0]] - corners
    lengths = np.linalg.norm(edges, axis=2)
    longest = lengths.argmax(axis=1)
    row = np.arange(len(corners))
    double_area = np.linalg.norm(np.cross(edges[row, (longest + 1) % 3], edges[row, (longest + 2) % 3]), axis=1)
    top = lengths[row, longest]
    return np.divide(double_area, top, out=np.zeros_like(top), where=top > 0), top


def duplicate_triangles(triangles: IntArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return (nt,) True for each triangle whose three vertices an earlier triangle has, in whatever order."""
    corners = np.sort(triangles, axis=1)
    order = np.lexsort(corners.T)
    ranked = corners[order]
    again = np.zeros(len(triangles), dtype=bool)
    again[order[1:]] = (ranked[1:] == ranked[:-1]).all(axis=1)
    return again
