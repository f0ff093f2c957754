"""Flat layout placed on the part: the planned position of each taxel.

A module bends with the surface and does not stretch. So a point of the layout at distance d and angle a from the anchor is at
the end of the straight geodesic of length d that leaves the anchor at angle a (`geodesics.py`). The stretching of modules on a
doubly curved part is neglected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, tangent_axes
from skincal.mesh.geodesics import MeshPoints, geodesics_of
from skincal.mesh.search import nearest_in_metric
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.skin import Anchor, Layout, Module

OUTLINE_PIECE_MAX_LENGTH_M = 0.002
"""Longest piece of a drawn outline: on a forearm of 40 mm radius it leaves the surface by 0.01 mm."""
ANCHOR_TO_SURFACE_MAX_M = 0.02
"""An anchor farther from the surface is of another frame or unit: no cover is that thick."""
MIN_WALL_THICKNESS_M = 0.0005
"""A wall that faces as the anchor does is behind another one if it is farther by more: covers are no thinner."""
OPPOSITE_WALL_MIN_COSINE = 0.5
"""A wall into which a normal points faces against it within 60 degrees; one at an edge faces sideways."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedLayout:
    """Layout in the link frame, metres."""

    places: FloatArray
    """(width, 3) float; NaN if a channel is no taxel or its module has no anchor."""
    normals: FloatArray
    """(width, 3) float, unit, outward; NaN likewise."""
    outlines: tuple[FloatArray, ...]
    """Of each module (v, 3) float, closed: the last point joins the first; no rows without an anchor."""


def place_layout(layout: Layout, anchor: Anchor | None, surface: Surface | None) -> PlacedLayout | None:
    """Place each module from its own anchor, or else from the layout's; `None` without any anchor.

    Raises InputError: an anchor is farther than `ANCHOR_TO_SURFACE_MAX_M` from the surface, or no triangle faces its normal.
    """
    anchors = [module.anchor or anchor for module in layout.modules]
    if all(own is None for own in anchors):
        return None
    places, normals = np.full((layout.width, 3), np.nan), np.full((layout.width, 3), np.nan)
    outlines = [np.empty((0, 3))] * len(anchors)
    with_anchor = [(index, own) for index, own in enumerate(anchors) if own is not None]
    flats = [_flat_points(layout.modules[index], own) for index, own in with_anchor]
    names = [f"the anchor of module {layout.modules[index].id}" for index, _ in with_anchor]
    owns, ends = [own for _, own in with_anchor], np.cumsum([len(flat) for flat in flats])[:-1]
    points, sides = _placed_points(owns, flats, names, surface)
    for (index, _), own_points, own_sides in zip(with_anchor, np.split(points, ends), np.split(sides, ends), strict=True):
        channels = layout.modules[index].channels
        count = len(channels)
        places[channels], normals[channels] = own_points[:count], own_sides[:count]
        outlines[index] = own_points[count:]
    return PlacedLayout(places, normals, tuple(outlines))


def _flat_points(module: Module, anchor: Anchor) -> FloatArray:
    """Return a module's taxels and then its outline, (n, 2) float, metres from its anchor in the flat layout."""
    return np.concatenate([module.pads, subdivide_outline(module.outline)]) - anchor.at


def _placed_points(
    anchors: Sequence[Anchor], flats: Sequence[FloatArray], names: Sequence[str], surface: Surface | None
) -> tuple[FloatArray, FloatArray]:
    """Place the flat points of each anchor; return all points and the normals there, (n, 3) float each."""
    if surface is not None:
        rows = np.repeat(np.arange(len(flats)), [len(flat) for flat in flats])
        start = place_anchors(surface, anchors, names).select(rows)
        end = geodesics_of(surface).walk(start, np.concatenate(flats))
        return end.points, surface.normals[end.triangles]
    points, sides = [np.empty((0, 3))], [np.empty((0, 3))]
    for own, flat in zip(anchors, flats, strict=True):
        normal = own.normal / np.linalg.norm(own.normal)
        x, y = tangent_axes(own.x, normal)
        points.append(own.point + flat[:, :1] * x + flat[:, 1:] * y)
        sides.append(np.broadcast_to(normal, points[-1].shape))
    return np.concatenate(points), np.concatenate(sides)


def anchor_remarks(layout: Layout, anchor: Anchor | None, surface: Surface | None) -> tuple[str, ...]:
    """Warn of modules whose anchor's normal points into the part: they are placed on the wall behind."""
    owns = {module.id: own for module in layout.modules if (own := module.anchor or anchor) is not None}
    if surface is None or not owns:
        return ()
    points, normals = (np.stack(rows) for rows in zip(*((own.point, own.normal) for own in owns.values()), strict=True))
    turns = np.broadcast_to(np.eye(3), (len(points), 3, 3))
    near, facing = (nearest_in_metric(surface, turns, points, pushes) for pushes in (None, -normals))
    gaps = np.sqrt(facing.values) - np.sqrt(near.values)
    against = np.einsum("ij,ij->i", surface.normals[near.triangles], normals) < -OPPOSITE_WALL_MIN_COSINE * np.linalg.norm(
        normals, axis=1
    )
    wrong = against & (facing.triangles >= 0) & (gaps > MIN_WALL_THICKNESS_M)
    if not wrong.any():
        return ()
    ids = [str(id_) for id_, bad in zip(owns, wrong, strict=True) if bad]
    named = ", ".join([*ids[:3], *["..."][: len(ids) > 3]])
    gap = np.sqrt(facing.values[wrong].max())
    return (
        f"The anchor of {'module' if len(ids) == 1 else 'modules'} {named} lies where the mesh faces the other way, so that "
        f"its layout was laid on the wall behind, {gap * 1e3:.1f} mm away; expected a normal that points out of the part: "
        "check its normal and point_mm.",
    )


def subdivide_outline(outline: FloatArray) -> FloatArray:
    """Cut the sides of a closed polygon (v, 2) into pieces no longer than `OUTLINE_PIECE_MAX_LENGTH_M`: (n, 2)."""
    pieces: list[FloatArray] = []
    for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / OUTLINE_PIECE_MAX_LENGTH_M)))
        # Without the end, with which the next side begins.
        pieces.append(start + np.arange(count)[:, None] / count * (end - start))
    return np.concatenate(pieces)


def place_anchor(surface: Surface, anchor: Anchor, name: str) -> MeshPoints:
    """Find an anchor's point on a surface; `InputError` as for `place_layout`."""
    return place_anchors(surface, [anchor], [name])


def place_anchors(surface: Surface, anchors: Sequence[Anchor], names: Sequence[str]) -> MeshPoints:
    """Find the points of anchors on a surface; `InputError` as for `place_layout`, on the first bad one."""
    # Only triangles that face as the anchor does: the inner wall of a cover may be as near.
    points, normals = (np.stack(rows) for rows in zip(*((own.point, own.normal) for own in anchors), strict=True))
    found = nearest_in_metric(surface, np.broadcast_to(np.eye(3), (len(points), 3, 3)), points, -normals)
    gaps = np.sqrt(found.values)
    for row in np.flatnonzero((found.triangles < 0) | (gaps > ANCHOR_TO_SURFACE_MAX_M)).tolist()[:1]:
        if found.triangles[row] < 0:
            raise InputError(
                f"{names[row]}: no triangle of the surface faces its normal {anchors[row].normal.tolist()}; correct the normal."
            )
        raise InputError(
            f"{names[row]} lies {gaps[row] * 1e3:.1f} mm from the surface; at most {ANCHOR_TO_SURFACE_MAX_M * 1e3:.0f} mm was "
            "expected: check point_mm, the mesh's unit and its pose."
        )
    x = [tangent_axes(own.x, surface.normals[triangle])[0] for own, triangle in zip(anchors, found.triangles, strict=True)]
    return MeshPoints(found.triangles, found.points, np.stack(x))
