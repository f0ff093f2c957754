"""Placing a layout on a part by hand: an anchor at a clicked point, slid, turned, or of one module alone.

An anchor that moves keeps its x axis as parallel as the surface allows.
"""

from __future__ import annotations

import re
from collections.abc import MutableMapping
from typing import Any, cast

import numpy as np

from skincal.files.layout_file import set_key
from skincal.geometry import FloatArray, tangent_axes
from skincal.mesh.geodesics import geodesics_of
from skincal.mesh.lay import place_anchor
from skincal.mesh.search import nearest_points
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.skin import Anchor, Layout, Module
from skincal.part.part_draft import AnchorDraft

_MODULE_START = re.compile(r"(?m)^(?=\[\[modules\]\])")
MIN_SURFACE_TILT_SIN_FOR_LEVEL_AXIS = 0.3  # On a surface that is tilted less, no direction is level: the link's x axis is taken
FLAT_NORMAL = np.array([0.0, 0.0, 1.0])


def anchor_at(
    surface: Surface | None, layout: Layout, point: FloatArray, before: Anchor | None, at: FloatArray | None = None
) -> Anchor:
    """Make the anchor that lays a point of the layout at a point (3,) of the part, metres.

    Parameters
    ----------
    surface : `None` for a flat part: its normal is the link's z axis
    before : anchor whose x axis is kept, carried along; `None` for a level one: the layout's y axis is as near to the link's z
        axis as it can be
    at : (2,) point of the layout, metres; `None` for that of `before`, or the middle of the layout
    """
    normal = FLAT_NORMAL if before is None or surface is not None else before.normal
    if surface is not None:
        near, triangles = nearest_points(surface, point[None])
        point, normal = near[0], surface.normals[triangles[0]]
    x = level_axis(normal) if before is None else before.x
    x, _ = tangent_axes(x, normal, fallback=True)
    if at is None:
        at = middle_of(layout) if before is None else before.at
    return Anchor(at, point, x, normal)


def level_axis(normal: FloatArray) -> FloatArray:
    """Give the x axis, (3,), of an upright layout where the outward normal is `normal`; it may not be perpendicular to it."""
    level = np.cross([0.0, 0.0, 1.0], normal)
    return np.array([1.0, 0.0, 0.0]) if np.linalg.norm(level) < MIN_SURFACE_TILT_SIN_FOR_LEVEL_AXIS else level


def turn_of(anchor: Anchor) -> float:
    """Compute the turn of a layout from upright, degrees, -180 to 180, counter-clockwise seen from outside."""
    level, up = tangent_axes(level_axis(anchor.normal), anchor.normal, fallback=True)
    return float(np.degrees(np.arctan2(anchor.x @ up, anchor.x @ level)))


def middle_of(layout: Layout) -> FloatArray:
    """Find the middle of a layout's taxels, (2,) metres."""
    places = layout.places[layout.channels]
    return (places.min(axis=0) + places.max(axis=0)) / 2.0


def turned_anchor(anchor: Anchor, degrees: float) -> Anchor:
    """Turn an anchor about its normal, counter-clockwise seen from outside."""
    x, y = tangent_axes(anchor.x, anchor.normal)
    angle = np.radians(degrees)
    return Anchor(anchor.at, anchor.point, np.cos(angle) * x + np.sin(angle) * y, anchor.normal)


def nudged_anchor(surface: Surface | None, anchor: Anchor, x: float, y: float) -> Anchor:
    """Slide an anchor along the layout's axes by `x` and `y`, metres."""
    if surface is None:
        along, across = tangent_axes(anchor.x, anchor.normal)
        return Anchor(anchor.at, anchor.point + x * along + y * across, anchor.x, anchor.normal)
    end = geodesics_of(surface).walk(place_anchor(surface, anchor, "the anchor"), np.array([[x, y]]))
    return Anchor(anchor.at, end.points[0], end.x[0], surface.normals[end.triangles[0]])


def anchor_of_module(surface: Surface | None, module: Module, anchor: Anchor | None) -> Anchor | None:
    """Compute the anchor of one module where it lies now: at its origin; `None` if it is not laid."""
    own = module.anchor or anchor
    if own is None:
        return None
    there = nudged_anchor(surface, own, *(module.place - own.at).tolist())
    return Anchor(module.place, there.point, there.x, there.normal)


def with_module_anchor(text: str, module: int, anchor: AnchorDraft | None) -> str:
    """Give a module of a layout's text an anchor of its own, or none; all else stays as it was.

    Raises InputError: the text is written in a way that can be read, but not changed, or has no such module.
    """
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    # One table at a time: to parse 350 of them takes two seconds.
    pieces = _MODULE_START.split(text)
    at = next((at for at, piece in enumerate(pieces) if re.search(rf"^id[ \t]*=[ \t]*{module}\b", piece, re.MULTILINE)), None)
    if len(pieces) < 2 or at is None:
        pieces, at = [text], 0
    try:
        document = tomlkit.parse(pieces[at])
        for table in cast("list[MutableMapping[str, Any]]", document["modules"]):
            if int(table["id"]) == module:
                if anchor is None:
                    table.pop("anchor", None)
                else:
                    own = tomlkit.inline_table()
                    for key in ("at_mm", "point_mm", "x", "normal"):
                        own[key] = list(getattr(anchor, key))
                    set_key(table, "anchor", own)
                return "".join([*pieces[:at], str(tomlkit.dumps(document)), *pieces[at + 1 :]])
    except (TOMLKitError, KeyError) as error:
        raise InputError(f"The layout's file cannot be changed here ({error}); change it by hand.") from None
    raise InputError(f"The layout has no module {module}; choose one of its modules.")
