"""A flat layout laid on the part: where its maker's plan says that each taxel is.

A board bends with the surface and does not stretch, so a point of the layout at distance d and angle a from the anchor
lies at the end of the straight geodesic that leaves the anchor at angle a and is d long. On a mesh a straight geodesic
is straight within each triangle, and at an edge it goes on as it would if both triangles were unfolded into one plane
(Polthier and Schmies, "Straightest geodesics on polyhedral surfaces", 1998). Past the rim it goes on straight in the
last triangle's plane. Boards stretch on a doubly curved part; that is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.errors import InputError
from skincal.readings import FloatArray, IntArray
from skincal.skin import Anchor, Layout, Module
from skincal.surface.edges import neighbours
from skincal.surface.mesh import Surface
from skincal.surface.nearest import nearest_in_metric

OUTLINE_STEP = 0.002
"""m. Longest piece of a drawn outline: on a forearm of 40 mm radius it leaves the surface by 0.01 mm."""
ANCHOR_GAP_MAX = 0.02
"""m. An anchor farther from the surface is of another frame or unit: no cover is that thick."""
_PULL = 1e-9
"""Share of the way to the triangle's middle that a walk is pulled at each edge, so that it never runs through a vertex."""
_CROSSINGS_MAX = 20_000
"""A walk that crosses more edges goes round in circles at a vertex; it is left where it is."""


@dataclass(frozen=True, slots=True, eq=False)
class LaidSkin:
    """The layout in the link frame, metres."""

    places: FloatArray
    """(width, 3) float; NaN where a channel is no taxel or its module has no anchor."""
    normals: FloatArray
    """(width, 3) float, unit, outward; NaN likewise."""
    outlines: tuple[FloatArray, ...]
    """For each module (v, 3) float, closed: the last point joins the first; no rows where it has no anchor."""
    off_surface: IntArray
    """Channels that lie past the rim of the surface, ascending."""


def lay(layout: Layout, anchor: Anchor | None, surface: Surface | None) -> LaidSkin | None:
    """Lay each module from its own anchor, or else from the layout's; None where there is no anchor at all.

    Raises
    ------
    InputError
        An anchor is farther than `ANCHOR_GAP_MAX` from the surface, or its normal points into the part.
    """
    anchors = [module.anchor or anchor for module in layout.modules]
    if all(own is None for own in anchors):
        return None
    walker = None if surface is None else _Walker(surface)
    places, normals = np.full((layout.width, 3), np.nan), np.full((layout.width, 3), np.nan)
    beyond = np.zeros(layout.width, dtype=bool)
    outlines: list[FloatArray] = []
    for module, own in zip(layout.modules, anchors, strict=True):
        if own is None:
            outlines.append(np.empty((0, 3)))
            continue
        outline = subdivided(module.outline)
        flat = np.concatenate([module.pads, outline]) - own.at
        points, sides, past = _on_plane(flat, own) if walker is None else walker.walk(flat, own, _name(module))
        count = len(module.channels)
        places[module.channels], normals[module.channels] = points[:count], sides[:count]
        beyond[module.channels] = past[:count]
        outlines.append(points[count:])
    return LaidSkin(places, normals, tuple(outlines), np.flatnonzero(beyond))


def _name(module: Module) -> str:
    return f"the anchor of module {module.id}"


def subdivided(outline: FloatArray) -> FloatArray:
    """Cut the sides of a closed polygon (v, 2) into pieces no longer than `OUTLINE_STEP`; returns (n, 2)."""
    pieces: list[FloatArray] = []
    for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / OUTLINE_STEP)))
        pieces.append(start + np.arange(count)[:, None] / count * (end - start))
    return np.concatenate(pieces)


Laid = tuple[FloatArray, FloatArray, NDArray[np.bool_]]
"""Points (n, 3), unit normals (n, 3), and whether each lies past the rim (n,)."""


def _on_plane(flat: FloatArray, anchor: Anchor) -> Laid:
    normal = anchor.normal / np.linalg.norm(anchor.normal)
    x, y = _tangents(anchor.x, normal)
    points = anchor.point + flat[:, :1] * x + flat[:, 1:] * y
    return points, np.broadcast_to(normal, points.shape).copy(), np.zeros(len(points), dtype=bool)


def _tangents(x: FloatArray, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the unit directions of the layout's x and y in the plane of `normal`, right-handed about it."""
    x = x - (x @ normal) * normal
    x = x / np.linalg.norm(x)
    return x, np.cross(normal, x)


class _Walker:
    """Walks many straight geodesics of one surface at once."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        self.other = neighbours(surface.triangles)
        corners = surface.corners
        along = corners[:, [1, 2, 0]] - corners
        self.along = along / np.linalg.norm(along, axis=2, keepdims=True)
        self.outward = np.cross(self.along, surface.normals[:, None])
        """(nt, 3, 3) unit normal of each side, in the triangle's plane, out of the triangle."""
        self.middles = surface.centres.T

    def _start(self, anchor: Anchor, name: str) -> tuple[int, FloatArray]:
        found = nearest_in_metric(self.surface, np.eye(3), anchor.point, -anchor.normal)
        if found is None:
            raise InputError(
                f"{name}: no triangle of the surface faces its normal {anchor.normal.tolist()}; correct the normal."
            )
        gap = float(np.sqrt(found.value))
        if gap > ANCHOR_GAP_MAX:
            raise InputError(
                f"{name} lies {gap * 1e3:.1f} mm from the surface; at most {ANCHOR_GAP_MAX * 1e3:.0f} mm was expected: "
                "check point_mm, the mesh's unit and its pose."
            )
        return found.triangle, found.point

    def walk(self, flat: FloatArray, anchor: Anchor, name: str) -> Laid:
        """Walk from the anchor to each of `flat` (n, 2), offsets in the layout's plane."""
        triangle, point = self._start(anchor, name)
        normal = self.surface.normals[triangle]
        x, y = _tangents(anchor.x, normal)
        left = np.linalg.norm(flat, axis=1)
        ahead = flat[:, :1] * x + flat[:, 1:] * y
        ahead = np.divide(ahead, left[:, None], out=np.broadcast_to(x, ahead.shape).copy(), where=left[:, None] > 0)
        walks = _Walks(
            np.full(len(flat), triangle), np.tile(point, (len(flat), 1)), ahead, left, np.zeros(len(flat), dtype=bool)
        )
        self._pull(walks, np.arange(len(flat)))
        for _ in range(_CROSSINGS_MAX):
            going = np.flatnonzero(walks.left > 0)
            if going.size == 0:
                break
            self._cross(walks, going)
        return walks.points, self.surface.normals[walks.triangles], walks.past

    def _cross(self, walks: _Walks, going: IntArray) -> None:
        """Move each walk on to the side through which it leaves its triangle, and over it; or to its end."""
        at, points, ahead = walks.triangles[going], walks.points[going], walks.ahead[going]
        rate = np.einsum("nij,nj->ni", self.outward[at], ahead)
        gap = np.einsum("nij,nij->ni", self.outward[at], self.surface.corners[at] - points[:, None])
        ways = np.divide(np.maximum(gap, 0.0), rate, out=np.full_like(rate, np.inf), where=rate > 0)
        side = ways.argmin(axis=1)
        row = np.arange(len(going))
        over = self.other[at, side]
        way = ways[row, side]
        stays = (way >= walks.left[going]) | (over < 0)
        # A walk that meets the rim goes on straight.
        walks.past[going] = (over < 0) & (way < walks.left[going])
        way = np.where(stays, walks.left[going], way)
        walks.points[going] = points + way[:, None] * ahead
        walks.left[going] = np.where(stays, 0.0, walks.left[going] - way)
        moves = np.flatnonzero(~stays)
        next_at = over[moves] // 3
        edge = self.along[at[moves], side[moves]]
        walks.ahead[going[moves]] = self._unfold(ahead[moves], edge, at[moves], next_at)
        walks.triangles[going[moves]] = next_at
        self._pull(walks, going[moves])

    def _unfold(self, ahead: FloatArray, edge: FloatArray, at: IntArray, next_at: IntArray) -> FloatArray:
        """Turn directions about the edge from one triangle's plane into the next one's."""
        along = np.einsum("ni,ni->n", ahead, edge)[:, None]
        across = np.einsum("ni,ni->n", ahead, np.cross(self.surface.normals[at], edge))[:, None]
        turned = along * edge + across * np.cross(self.surface.normals[next_at], edge)
        return turned / np.linalg.norm(turned, axis=1, keepdims=True)

    def _pull(self, walks: _Walks, which: IntArray) -> None:
        at = walks.triangles[which]
        off = self.middles[at] - walks.points[which]
        # Back into the plane, too, so that rounding does not add up over many triangles.
        lift = np.einsum("ni,ni->n", off, self.surface.normals[at])[:, None] * self.surface.normals[at]
        walks.points[which] += _PULL * off + lift


@dataclass(slots=True)
class _Walks:
    """Where many walks stand; changed in place."""

    triangles: IntArray
    points: FloatArray
    ahead: FloatArray
    left: FloatArray
    past: NDArray[np.bool_]
