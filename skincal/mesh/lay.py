"""Flat layout placed on the part: the planned position of each taxel.

A module bends with the surface and does not stretch. So a point of the layout at distance d and angle a from the anchor is at
the end of the straight geodesic of length d that leaves the anchor at angle a (`geodesics.py`). The stretching of modules on a
doubly curved part is neglected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, tangent_axes
from skincal.mesh.geodesics import MeshPoints, geodesics_of
from skincal.mesh.search import nearest_in_metric
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.skin import Anchor, Layout

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
    outlines: list[FloatArray] = []
    for module, own in zip(layout.modules, anchors, strict=True):
        if own is None:
            outlines.append(np.empty((0, 3)))
            continue
        outline = subdivide_outline(module.outline)
        flat = np.concatenate([module.pads, outline]) - own.at
        name = f"the anchor of module {module.id}"
        if surface is None:
            normal = own.normal / np.linalg.norm(own.normal)
            x, y = tangent_axes(own.x, normal)
            points = own.point + flat[:, :1] * x + flat[:, 1:] * y
            sides = np.broadcast_to(normal, points.shape)
        else:
            start = place_anchor(surface, own, name).select(np.zeros(len(flat), dtype=np.int64))
            end = geodesics_of(surface).walk(start, flat)
            points, sides = end.points, surface.normals[end.triangles]
        count = len(module.channels)
        places[module.channels], normals[module.channels] = points[:count], sides[:count]
        outlines.append(points[count:])
    return PlacedLayout(places, normals, tuple(outlines))


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
    # Only triangles that face as the anchor does: the inner wall of a cover may be as near.
    found = nearest_in_metric(surface, np.eye(3)[None], anchor.point[None], -anchor.normal[None])
    if found.triangles[0] < 0:
        raise InputError(f"{name}: no triangle of the surface faces its normal {anchor.normal.tolist()}; correct the normal.")
    gap = float(np.sqrt(found.values[0]))
    if gap > ANCHOR_TO_SURFACE_MAX_M:
        raise InputError(
            f"{name} lies {gap * 1e3:.1f} mm from the surface; at most {ANCHOR_TO_SURFACE_MAX_M * 1e3:.0f} mm was expected: "
            "check point_mm, the mesh's unit and its pose."
        )
    x, _ = tangent_axes(anchor.x, surface.normals[found.triangles[0]])
    return MeshPoints(found.triangles, found.points, x[None])
