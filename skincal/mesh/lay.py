"""A flat layout laid on the part: where its maker's plan says that each taxel is.

A module bends with the surface and does not stretch, so a point of the layout at distance d and angle a from the anchor
lies at the end of the straight geodesic that leaves the anchor at angle a and is d long (`geodesics.py`). Modules stretch on a
doubly curved part; that is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray
from skincal.mesh.geodesics import MeshPoints, geodesics_of
from skincal.mesh.search import nearest_in_metric
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.skin import Anchor, Layout

OUTLINE_STEP = 0.002
"""m. Longest piece of a drawn outline: on a forearm of 40 mm radius it leaves the surface by 0.01 mm."""
ANCHOR_GAP_MAX = 0.02
"""m. An anchor farther from the surface is of another frame or unit: no cover is that thick."""

BEHIND = 0.0005
"""m. A wall that faces as the anchor does is behind another one if it is farther by more: covers are no thinner."""
AGAINST = 0.5
"""Cosine. A wall beside an edge faces sideways; one that a normal points into faces against it, within 60 degrees."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedLayout:
    """The layout in the link frame, metres."""

    places: FloatArray
    """(width, 3) float; NaN where a channel is no taxel or its module has no anchor."""
    normals: FloatArray
    """(width, 3) float, unit, outward; NaN likewise."""
    outlines: tuple[FloatArray, ...]
    """For each module (v, 3) float, closed: the last point joins the first; no rows where it has no anchor."""


def place_layout(layout: Layout, anchor: Anchor | None, surface: Surface | None) -> PlacedLayout | None:
    """Lay each module from its own anchor, or else from the layout's; None where there is no anchor at all.

    Raises InputError: an anchor is farther than `ANCHOR_GAP_MAX` from the surface, or its normal points into the part.
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
        points, sides = _on_plane(flat, own) if surface is None else _on_surface(flat, own, surface, name)
        count = len(module.channels)
        places[module.channels], normals[module.channels] = points[:count], sides[:count]
        outlines.append(points[count:])
    return PlacedLayout(places, normals, tuple(outlines))


def anchor_remarks(layout: Layout, anchor: Anchor | None, surface: Surface | None) -> tuple[str, ...]:
    """Say of which modules the anchor's normal points into the part: they come onto the wall behind; all as for `lay`."""
    owns = {module.id: own for module in layout.modules if (own := module.anchor or anchor) is not None}
    if surface is None or not owns:
        return ()
    points, normals = (np.stack(rows) for rows in zip(*((own.point, own.normal) for own in owns.values()), strict=True))
    turns = np.broadcast_to(np.eye(3), (len(points), 3, 3))
    near, facing = (nearest_in_metric(surface, turns, points, pushes) for pushes in (None, -normals))
    gaps = np.sqrt(facing.values) - np.sqrt(near.values)
    against = np.einsum("ij,ij->i", surface.normals[near.triangles], normals) < -AGAINST * np.linalg.norm(normals, axis=1)
    wrong = against & (facing.triangles >= 0) & (gaps > BEHIND)
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
    """Cut the sides of a closed polygon (v, 2) into pieces no longer than `OUTLINE_STEP`; returns (n, 2)."""
    pieces: list[FloatArray] = []
    for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / OUTLINE_STEP)))
        # Without its end, with which the next side begins.
        pieces.append(start + np.arange(count)[:, None] / count * (end - start))
    return np.concatenate(pieces)


def _on_plane(flat: FloatArray, anchor: Anchor) -> tuple[FloatArray, FloatArray]:
    normal = anchor.normal / np.linalg.norm(anchor.normal)
    x, y = _tangents(anchor.x, normal)
    points = anchor.point + flat[:, :1] * x + flat[:, 1:] * y
    return points, np.broadcast_to(normal, points.shape).copy()


def _tangents(x: FloatArray, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the unit directions of the layout's x and y in the plane of `normal`, right-handed about it."""
    x = x - (x @ normal) * normal
    x = x / np.linalg.norm(x)
    return x, np.cross(normal, x)


def _on_surface(flat: FloatArray, anchor: Anchor, surface: Surface, name: str) -> tuple[FloatArray, FloatArray]:
    start = place_anchor(surface, anchor, name).take(np.zeros(len(flat), dtype=np.int64))
    walked = geodesics_of(surface).walk(start, flat)
    return walked.points, surface.normals[walked.triangles]


def place_anchor(surface: Surface, anchor: Anchor, name: str) -> MeshPoints:
    """Return where an anchor stands on a surface, one place.

    Raises InputError: as for `lay`.
    """
    # Only triangles that face the way the anchor does: the inner wall of a cover may lie as near.
    found = nearest_in_metric(surface, np.eye(3)[None], anchor.point[None], -anchor.normal[None])
    if found.triangles[0] < 0:
        raise InputError(f"{name}: no triangle of the surface faces its normal {anchor.normal.tolist()}; correct the normal.")
    gap = float(np.sqrt(found.values[0]))
    if gap > ANCHOR_GAP_MAX:
        raise InputError(
            f"{name} lies {gap * 1e3:.1f} mm from the surface; at most {ANCHOR_GAP_MAX * 1e3:.0f} mm was expected: "
            "check point_mm, the mesh's unit and its pose."
        )
    x, _ = _tangents(anchor.x, surface.normals[found.triangles[0]])
    return MeshPoints(found.triangles, found.points, x[None])
