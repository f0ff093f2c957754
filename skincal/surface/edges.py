"""Which triangles meet at which edge, and what hangs together.

A side of a triangle is numbered h = 3 triangle + side; side s runs from corner s to corner (s + 1) mod 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """The edges of a set of triangles."""

    open: IntArray
    """(k,) sides that no other triangle shares: the rim."""
    non_manifold: int
    """Edges shared by three or more triangles."""
    pairs: IntArray
    """(m, 2) sides that two triangles share."""
    against: IntArray
    """(m,) 1 where both triangles of the pair run along the edge in the same direction, so one is turned; else 0."""


def find_edges(triangles: IntArray) -> Edges:
    """Find the edges of `triangles` (nt, 3)."""
    start, end = triangles.ravel(), triangles[:, [1, 2, 0]].ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.argsort(low * (int(triangles.max(initial=0)) + 1) + high, kind="stable")
    low, high = low[order], high[order]
    first = np.flatnonzero(np.r_[True, (low[1:] != low[:-1]) | (high[1:] != high[:-1])]) if len(order) else order
    counts = np.diff(np.r_[first, len(order)])
    shared = first[counts == 2]
    pairs = np.stack([order[shared], order[shared + 1]], axis=1)
    against = (start[pairs[:, 0]] == start[pairs[:, 1]]).astype(np.int64)
    return Edges(order[first[counts == 1]], int((counts > 2).sum()), pairs, against)


def neighbours(triangles: IntArray) -> IntArray:
    """Return (nt, 3): the side on the other side of each side, -1 at the rim and at non-manifold edges."""
    pairs = find_edges(triangles).pairs
    other = np.full(triangles.size, -1, dtype=np.int64)
    other[pairs[:, 0]], other[pairs[:, 1]] = pairs[:, 1], pairs[:, 0]
    return other.reshape(-1, 3)


def connected(count: int, pairs: IntArray) -> IntArray:
    """Label what hangs together: (count,) each node's label is the lowest number of its component.

    Parameters
    ----------
    count : number of nodes
    pairs : (m, 2) nodes that hang together
    """
    labels = np.arange(count)
    a, b = pairs[:, 0], pairs[:, 1]
    while True:
        la, lb = labels[a], labels[b]
        differ = la != lb
        if not differ.any():
            return labels
        a, b, la, lb = a[differ], b[differ], la[differ], lb[differ]
        # Hook the higher root on the lower one, then shorten every path to its root.
        np.minimum.at(labels, np.maximum(la, lb), np.minimum(la, lb))
        while True:
            shorter = labels[labels]
            if np.array_equal(shorter, labels):
                break
            labels = shorter


def triangle_normals(corners: FloatArray) -> FloatArray:
    """Return (nt, 3) unit normals of `corners` (nt, 3, 3) as wound, right-handed.

    The two shortest edges are crossed: they lose the fewest digits for a needle.
    """
    edges = corners[:, [1, 2, 0]] - corners
    lengths = np.linalg.norm(edges, axis=2)
    longest = lengths.argmax(axis=1)
    row = np.arange(len(corners))
    normals = np.cross(edges[row, (longest + 1) % 3], edges[row, (longest + 2) % 3])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)
