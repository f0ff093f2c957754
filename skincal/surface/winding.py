"""Which side of the surface is outside.

Within a component the winding is made consistent: triangles are nodes in two copies, as wound and turned, and an edge
whose two triangles run along it in opposite directions joins equal copies, in the same direction different ones. A
component of that double cover is one consistent choice.

Which choice is outward is then told by the heights h = n.(c - o) of its triangles' planes over the component's centroid
o, with the normals n and centroids c: their mean over the area is positive for a closed part (three times its volume
over its area) and for every open shell seen from its convex side. s = mean(h)/sqrt(mean(h^2)) is about 0.8 for an arc
however shallow, and about 0 for a sheet that is flat, wavy or rough. A component that does not tell by its own centroid
is judged about the centroid of the whole part; if that does not tell either, the file's winding holds. A consistently
wound component that lies inside the box of a larger one is the inner wall of a cover and keeps the file's winding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.geometry.arrays import FloatArray, IntArray
from skincal.surface.edges import connected, find_edges

SIDE_MIN = 0.1
"""Smallest |s| that tells inside from outside: chance reaches it on a rough flat sheet of 100 triangles."""
FLAT_HEIGHT = 1e-6
"""m. A component whose heights are below this (rms) is flat: it is the distance at which vertices are one."""
_WALLS = 32
"""Largest components that are looked at as outer walls."""


@dataclass(frozen=True, slots=True, eq=False)
class Winding:
    """Triangles with normals outward, and what had to be turned for it."""

    triangles: IntArray
    components: int
    against: int
    """Triangles that were wound against the rest of their component."""
    turned: int
    """Triangles of components that were turned as a whole, since they pointed inward."""
    one_sided: int
    """Components without two sides (a Moebius strip): left as wound."""
    undecided: int
    """Components whose shape does not tell inside from outside; as wound."""


def wind_outward(vertices: FloatArray, triangles: IntArray) -> Winding:
    """Make the winding of each component consistent and outward."""
    component, flip, one_sided = _consistent(triangles)
    triangles = np.where(flip[:, None], triangles[:, [0, 2, 1]], triangles)
    mended = np.bincount(component, flip) > 0
    side = _side(vertices, triangles, component)
    inner = _inside_another(vertices, triangles, component) & ~mended
    turn = (side < 0) & ~inner & ~one_sided
    turned = turn[component]
    triangles = np.where(turned[:, None], triangles[:, [0, 2, 1]], triangles)
    return Winding(
        triangles=triangles,
        components=len(side),
        against=int(flip.sum()),
        turned=int(turned.sum()),
        one_sided=int(one_sided.sum()),
        undecided=int((side == 0).sum()),
    )


def _consistent(triangles: IntArray) -> tuple[IntArray, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return each triangle's component, whether to turn it, and which components have one side only."""
    count = len(triangles)
    edges = find_edges(triangles)
    one, two = edges.pairs[:, 0] // 3, edges.pairs[:, 1] // 3
    # Node 2 t is triangle t as wound, node 2 t + 1 the same turned.
    joins = [np.stack([2 * one + copy, 2 * two + (copy ^ edges.against)], axis=1) for copy in (0, 1)]
    label = connected(2 * count, np.concatenate(joins)).reshape(count, 2)
    _, component = np.unique(label.min(axis=1), return_inverse=True)
    one_sided = np.bincount(component, label[:, 0] == label[:, 1]) > 0
    flip = label[:, 0] > label[:, 1]
    # The majority of a component holds as wound.
    minority = np.bincount(component, flip) * 2 > np.bincount(component)
    return component, (flip ^ minority[component]) & ~one_sided[component], one_sided


def _side(vertices: FloatArray, triangles: IntArray, component: IntArray) -> FloatArray:
    """Return for each component 1 where it is wound outward, -1 inward, 0 where its shape does not tell."""
    corners = vertices[triangles]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    size = np.linalg.norm(area, axis=1)
    middle = corners.mean(axis=1)
    total = np.bincount(component, size)
    own = np.stack([np.bincount(component, size * middle[:, axis]) / total for axis in range(3)], axis=1)
    whole = size @ middle / size.sum()
    is_open = np.bincount(component[find_edges(triangles).open // 3], minlength=len(total)) > 0

    def about(origin: FloatArray) -> FloatArray:
        flux = (area * (middle - origin)).sum(axis=1)
        through, square = np.bincount(component, flux), np.bincount(component, flux**2 / size)
        spread = np.sqrt(square * total)
        # Of a closed component the sign of the volume tells, however thin its walls are.
        clear = (np.abs(through) > SIDE_MIN * spread) | ~is_open
        return np.where(clear & (square > FLAT_HEIGHT**2 * total), np.sign(through), 0.0)

    side = about(own[component])
    return np.where(side != 0, side, about(whole))


def _inside_another(vertices: FloatArray, triangles: IntArray, component: IntArray) -> NDArray[np.bool_]:
    """Return (components,) True where a component's box lies within the box of a component that is larger."""
    count = int(component.max()) + 1
    corners = vertices[triangles]
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, component, corners.min(axis=1))
    np.maximum.at(high, component, corners.max(axis=1))
    inside = np.zeros(count, dtype=bool)
    size = np.prod(high - low, axis=1)
    # Only the largest boxes can hold others: quadratic in components would not do for a soup.
    for outer in np.argsort(-size, kind="stable")[:_WALLS]:
        within = (low >= low[outer]).all(axis=1) & (high <= high[outer]).all(axis=1) & (size < size[outer])
        inside |= within
    return inside
