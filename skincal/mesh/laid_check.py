"""Check of a laid layout: taxels off the mesh, folded round a rim, on the wrong face, pressed together or on each other.

The window's page for parts and `scene show` say the same sentences. A skin that bends gently passes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray
from skincal.mesh.geodesics import MeshPoints, geodesics_of
from skincal.mesh.lay import PlacedLayout, place_anchor, subdivide_outline
from skincal.mesh.search import nearest_points
from skincal.mesh.surface import Surface, entry_points, pairs_within
from skincal.model.errors import plural
from skincal.model.skin import Anchor, Layout

TAXEL_OFF_MESH_MIN_DISTANCE_M = 0.0005
"""m. A taxel further from the mesh is off it: covers are no thinner."""
MODULES_OVERLAP_BELOW_SPACINGS = 0.6
"""Of the spacing: two modules with nearer taxels overlap. In triangles no point is farther than 0.58 from a taxel."""
ON_ITSELF_BELOW_SPACINGS = 0.72
"""Of the spacing: a grid on another one has taxels within 0.71."""
SAME_MODULE_MIN_FLAT_SPACINGS = 2.0
"""Of the spacing: overlapping taxels of one module are farther apart than this in the layout's plane."""
PATH_STEP_M = 0.0005
"""m. Along a path the normal is looked at in such steps."""
SHARP_BEND_REACH_M = 0.003
"""m. Mean normals over this length before and after a place are compared."""
SHARP_BEND_REACH_SPACINGS = 1.5
"""Of the spacing: a finer skin may bend around smaller radii."""
SHARP_BEND_MIN_TURN_DEG = 62.0
"""Of the mean normals: an edge, or a bend with a radius below 2.8 mm. A skin bends less; so do cylinders drawn with 6 sides."""
MIN_CHORD_OF_NEIGHBOURS, MAX_CHORD_OF_NEIGHBOURS = 0.6, 1.4
"""Distance of neighbours on the part over that in the layout; a fold by 90 degrees between them leaves 0.7."""
NEIGHBOUR_MAX_SPACINGS = 1.5
OPPOSITE_FACE_MAX_COSINE = -0.5
OPPOSITE_FACE_MIN_DETOUR = 3.5
"""Path in the layout over distance on the part, of two taxels on opposite faces: at most 2.4 round a cylinder."""
MAX_COMPARED_TAXELS = 600
"""Of a layout, each with each other; of a larger one every second or third taxel."""
FACES_SENSOR_MIN_MEDIAN_COSINE = 0.5
FACES_SENSOR_MIN_SHARE = 0.95
"""Share of taxels on whose outer side the sensor is."""
CONVEX_MIN_SLOPE = 0.02
"""Mean slope from a taxel down to its neighbours on a convex face: 0.07 at a radius of 70 mm and a spacing of 10 mm."""
WALL_BEHIND_MAX_M = 0.02
"""m. A thicker part has no other face that the operator may have meant."""
LANDMARK_OFF_MESH_MIN_DISTANCE_M = 0.002
"""m. Heads of screws that a mesh leaves out are no higher; the tip of a tool is no sharper."""
TORN_OUTLINE_MIN_STRETCH = 1.5
"""Distance of successive outline points on the part over that in the layout: a hole sends them different ways."""
RIM_REACH_SHARE = 0.5
"""Of the reach of a sharp bend: a taxel whose own normal turned so shortly before it is on a rim."""


@dataclass(frozen=True, slots=True, eq=False)
class LaidFindings:
    """What is wrong with a layout on a mesh."""

    off_channels: IntArray
    """(n,) channels whose position is off the mesh."""
    sentences: tuple[str, ...]
    folded_channels: IntArray
    """(n,) channels that lie beyond a sharp bend, or on the wrong face."""


@dataclass(frozen=True, slots=True, eq=False)
class _Laid:
    """Taxels of a layout that have a position on the part."""

    layout: Layout
    surface: Surface
    channels: IntArray
    """(n,) of the taxels."""
    flat: FloatArray
    """(n, 2) float, metres, the layout's plane."""
    places: FloatArray
    """(n, 3) float, metres, link frame."""
    normals: FloatArray
    """(n, 3) float, unit."""
    sheet: IntArray
    """(n,) taxels with the same number are laid from one anchor."""


def examine_layout(
    layout: Layout,
    anchor: Anchor | None,
    laid: PlacedLayout | None,
    surface: Surface | None,
    sensor: FloatArray | None = None,
) -> LaidFindings:
    """Find taxels and outlines that no real skin would have where they are laid.

    Parameters
    ----------
    anchor : of the layout; modules may have their own
    laid : result of `place_layout` with the same anchor and surface; `None` if nothing is laid
    sensor : (3,) metres, link frame: origin of the force/torque sensor; `None` if it is unknown
    """
    none = np.empty(0, np.int64)
    if laid is None:
        return LaidFindings(none, (), none)
    known = layout.channels[np.isfinite(laid.places[layout.channels, 0])]
    unplaced = [module.id for module in layout.modules if np.isnan(laid.places[module.channels, 0]).all()]
    sentences = [f"Not on the part: {_modules(unplaced)}. Click where the layout lies."] if unplaced else []
    if surface is None or not len(known):
        return LaidFindings(none, (*sentences, *_module_overlaps(layout, laid, known)), none)
    skin = _Laid(layout, surface, known, layout.places[known], laid.places[known], laid.normals[known], _sheets(layout)[known])
    near, _ = nearest_points(surface, skin.places)
    off = known[np.linalg.norm(near - skin.places, axis=1) > TAXEL_OFF_MESH_MIN_DISTANCE_M]
    beyond = np.intersect1d(_find_folded(layout, anchor, surface), known)
    shapes = _shape_sentences(skin, beyond, _find_torn(layout, laid))
    too_large = _size_sentence(skin, is_doubtful=bool(len(off) or shapes))
    if too_large:
        return LaidFindings(off, (*sentences, too_large), beyond)
    if len(off):
        verb = "is" if len(off) == 1 else "are"
        named = f"{plural(len(off), 'taxel')} of {_modules_of(layout, off)}"
        sentences.append(f"{named} {verb} off the mesh: slide or turn the layout.")
    sentences += [*shapes, *_module_overlaps(layout, laid, known)]
    if sensor is not None and not shapes:
        sentences += _inner_face(skin, sensor)
    return LaidFindings(off, tuple(sentences), beyond)


def _sheets(layout: Layout) -> IntArray:
    """Give each channel the number of the anchor from which it is laid: 0 for the layout's own."""
    sheet = np.zeros(layout.width, np.int64)
    for index, module in enumerate(layout.modules):
        if module.anchor is not None:
            sheet[module.channels] = index + 1
    return sheet


def _shape_sentences(skin: _Laid, beyond: IntArray, torn: Sequence[int]) -> list[str]:
    """Describe a fold; without one, opposite faces, neighbours at a wrong distance, and taxels on each other."""
    layout = skin.layout
    if len(beyond):
        verb = "lies" if len(beyond) == 1 else "lie"
        return [
            f"{plural(len(beyond), 'taxel')} of {_modules_of(layout, beyond)} {verb} beyond a rim, a sharp edge or a hole of "
            "the part, round which the layout was folded. Slide or turn the layout, or make it smaller; if the skin spans a "
            "hole, use a mesh without it."
        ]
    sentences = [*_opposite_faces(skin), *_wrong_distances(skin), *_on_itself(skin)]
    if torn and not sentences:
        sentences.append(
            f"The outline of {_modules(torn)} is torn by a hole, an edge or a bump of the part; its taxels are not. If a taxel "
            "lies wrong, slide or turn the layout."
        )
    return sentences


def _find_folded(layout: Layout, anchor: Anchor | None, surface: Surface) -> IntArray:
    """Find the channels whose path from the anchor has a sharp bend."""
    beyond = [np.empty(0, np.int64)]
    for module in layout.modules:
        own = module.anchor or anchor
        if own is not None:
            start = place_anchor(surface, own, f"the anchor of module {module.id}")
            beyond.append(module.channels[_has_sharp_bend(surface, start, module.pads - own.at, layout.spacing)])
    return np.sort(np.concatenate(beyond))


def _has_sharp_bend(surface: Surface, start: MeshPoints, ways: FloatArray, spacing: float) -> NDArray[np.bool_]:
    """Whether each of n straight paths from one start, `ways` (n, 2) metres, bends sharply over a rim, an edge or a hole."""
    lengths = np.linalg.norm(ways, axis=1)
    counts = np.maximum(np.ceil(lengths / PATH_STEP_M).astype(np.int64), 1)
    ends = np.cumsum(counts + 1) - 1
    path = np.repeat(np.arange(len(ways)), counts + 1)
    at = np.arange(len(path)) - (ends - counts)[path]
    share = at / counts[path]
    points = geodesics_of(surface).walk(start.select(np.zeros(len(path), np.int64)), share[:, None] * ways[path])
    normals = surface.normals[points.triangles]
    reach = min(SHARP_BEND_REACH_M, SHARP_BEND_REACH_SPACINGS * spacing)
    steps = np.minimum((counts + 1) // 2, max(1, round(reach / PATH_STEP_M)))
    # Mean normals before and after each place: a groove or a letter in the part has little weight in them.
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(normals, axis=0)])
    after = np.flatnonzero((at >= 1) & (at + steps[path] <= counts[path] + 1))
    width = steps[path[after]]
    # The anchor's normal counts as the path before the anchor: an edge beside it is an edge, too.
    earlier = np.minimum(at[after], width)
    first = normals[(ends - counts)[path[after]]]
    one = sums[after] - sums[after - earlier] + (width - earlier)[:, None] * first
    two = sums[after + width] - sums[after]
    sharp = np.cos(np.radians(SHARP_BEND_MIN_TURN_DEG))
    sizes = np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1)
    is_sharp = np.einsum("ij,ij->i", one, two) < sharp * sizes
    before = ends - np.minimum(counts, np.maximum(1, (RIM_REACH_SHARE * steps + 0.5).astype(np.int64)))
    is_on_rim = np.einsum("ij,ij->i", normals[before], normals[ends]) < sharp
    return is_on_rim | (np.bincount(path[after[is_sharp]], minlength=len(ways)) > 0)


def _find_torn(layout: Layout, laid: PlacedLayout) -> list[int]:
    """List the modules, by id, with successive outline points that lie far apart on the part."""
    torn = list[int]()
    for module, outline in zip(layout.modules, laid.outlines, strict=True):
        flat = subdivide_outline(module.outline)
        if len(outline) == len(flat):
            pieces = (np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1) for points in (outline, flat))
            real, wanted = pieces
            if (real > TORN_OUTLINE_MIN_STRETCH * wanted).any():
                torn.append(module.id)
    return torn


def _size_sentence(skin: _Laid, *, is_doubtful: bool) -> str:
    """Describe a layout that is larger than the part; empty if it may fit."""
    across = float(np.linalg.norm(np.ptp(skin.flat, axis=0))) * 1e3
    part = float(np.linalg.norm(np.ptp(skin.surface.vertices, axis=0))) * 1e3
    # A sleeve may be longer than the part, and fits; modules with anchors of their own have no size together.
    if not is_doubtful or across <= part or len(np.unique(skin.sheet)) > 1:
        return ""
    return (
        f"The layout is larger than the part: {across:.3g} mm from corner to corner, and the part {part:.3g} mm. Check the "
        "unit of the mesh and the spacing of the layout, or choose a smaller layout."
    )


def _opposite_faces(skin: _Laid) -> list[str]:
    """Find taxels that the layout's path brings round to the opposite face."""
    chosen = np.arange(0, len(skin.channels), -(-len(skin.channels) // MAX_COMPARED_TAXELS) or 1)
    flat, places, normals, sheet = skin.flat[chosen], skin.places[chosen], skin.normals[chosen], skin.sheet[chosen]
    detour = np.linalg.norm(flat[:, None] - flat[None], axis=2)
    distance = np.linalg.norm(places[:, None] - places[None], axis=2)
    is_opposite = (
        (normals @ normals.T < OPPOSITE_FACE_MAX_COSINE)
        & (distance < WALL_BEHIND_MAX_M)
        & (distance * OPPOSITE_FACE_MIN_DETOUR < detour)
        & (sheet[:, None] == sheet[None])
    )
    if not is_opposite.any():
        return []
    first, second = (int(index) for index in np.unravel_index(np.where(is_opposite, distance, np.inf).argmin(), distance.shape))
    return [
        f"The layout goes round to the opposite face of the part: channels {skin.channels[chosen[first]]} and "
        f"{skin.channels[chosen[second]]} are {distance[first, second] * 1e3:.1f} mm apart through the part and "
        f"{detour[first, second] * 1e3:.0f} mm along the layout. Slide or turn the layout, unless the skin is wrapped round "
        "the part."
    ]


def _wrong_distances(skin: _Laid) -> list[str]:
    """Find neighbours that the part presses together or pulls apart."""
    pairs = _near_pairs(skin, NEIGHBOUR_MAX_SPACINGS)
    flat = np.linalg.norm(skin.flat[pairs[:, 0]] - skin.flat[pairs[:, 1]], axis=1)
    real = np.linalg.norm(skin.places[pairs[:, 0]] - skin.places[pairs[:, 1]], axis=1)
    wrong = (flat > 0.0) & ((real < MIN_CHORD_OF_NEIGHBOURS * flat) | (real > MAX_CHORD_OF_NEIGHBOURS * flat))
    if not wrong.any():
        return []
    share = np.divide(real, flat, out=np.ones_like(real), where=wrong)
    worst = int(np.abs(np.log(np.maximum(share, 1e-9))).argmax())
    one, two = sorted(skin.channels[pairs[worst]].tolist())
    return [
        f"A flat layout does not fit the part here: channels {one} and {two} are {flat[worst] * 1e3:.1f} mm apart in the "
        f"layout and {real[worst] * 1e3:.1f} mm on the part ({plural(int(wrong.sum()), 'such pair')}). Slide or turn the "
        "layout, or divide it into modules with anchors of their own."
    ]


def _near_pairs(skin: _Laid, spacings: float) -> IntArray:
    """List (m, 2) pairs of neighbours in the layout's plane that one anchor lays."""
    reach = spacings * skin.layout.spacing
    if not np.isfinite(reach):
        return np.empty((0, 2), np.int64)
    pairs = pairs_within(np.column_stack([skin.flat, np.zeros(len(skin.flat))]), reach)
    return pairs[skin.sheet[pairs[:, 0]] == skin.sheet[pairs[:, 1]]]


def _on_itself(skin: _Laid) -> list[str]:
    """Find taxels of one module that overlap."""
    layout = skin.layout
    if not np.isfinite(layout.spacing):
        return []
    pairs = pairs_within(skin.places, ON_ITSELF_BELOW_SPACINGS * layout.spacing)
    owners = layout.module_of[skin.channels[pairs]]
    apart = np.linalg.norm(skin.flat[pairs[:, 0]] - skin.flat[pairs[:, 1]], axis=1)
    same_face = np.einsum("ij,ij->i", skin.normals[pairs[:, 0]], skin.normals[pairs[:, 1]]) > 0.0
    found = pairs[(owners[:, 0] == owners[:, 1]) & (apart > SAME_MODULE_MIN_FLAT_SPACINGS * layout.spacing) & same_face]
    if not len(found):
        return []
    one, two = sorted(skin.channels[found[0]].tolist())
    return [f"The layout overlaps itself, such as channel {one} and {two}: slide or turn the layout, or make it smaller."]


def _module_overlaps(layout: Layout, laid: PlacedLayout, known: IntArray) -> list[str]:
    """Find modules that overlap."""
    if len(layout.modules) < 2 or not len(known):
        return []
    places, normals = laid.places[known], laid.normals[known]
    pairs = pairs_within(places, MODULES_OVERLAP_BELOW_SPACINGS * layout.spacing)
    # Modules on the two faces of a thin part do not overlap.
    pairs = pairs[np.einsum("ij,ij->i", normals[pairs[:, 0]], normals[pairs[:, 1]]) > 0.0]
    owners = layout.module_of[known[pairs]]
    both = sorted({(int(min(pair)), int(max(pair))) for pair in owners if pair[0] != pair[1]})
    if not both:
        return []
    first, second = (layout.modules[index].id for index in both[0])
    more = f", and {len(both) - 1} more pairs" if len(both) > 1 else ""
    return [f"Modules {first} and {second}{more} overlap: turn the layout, or move modules alone."]


def _inner_face(skin: _Laid, sensor: FloatArray) -> list[str]:
    """Find out whether the layout is on the face of a thin wall that faces the sensor."""
    to_sensor = sensor - skin.places
    distances = np.linalg.norm(to_sensor, axis=1)
    size = float(np.linalg.norm(np.ptp(skin.surface.vertices, axis=0)))
    # A sensor in another limb is on no side of the wall.
    if len(skin.channels) < 2 or np.median(distances) > size or distances.min() == 0.0:
        return []
    cosines = np.einsum("ij,ij->i", to_sensor, skin.normals) / distances
    if np.median(cosines) < FACES_SENSOR_MIN_MEDIAN_COSINE or (cosines > 0.0).mean() < FACES_SENSOR_MIN_SHARE:
        return []
    pairs = _near_pairs(skin, NEIGHBOUR_MAX_SPACINGS)
    ways = skin.places[pairs[:, 1]] - skin.places[pairs[:, 0]]
    lengths = np.linalg.norm(ways, axis=1)
    rises = np.einsum("ij,ij->i", ways, skin.normals[pairs[:, 0]] - skin.normals[pairs[:, 1]]) / 2.0
    # The outer face of a foot below its ankle is convex.
    if len(pairs) and (rises / np.maximum(lengths, 1e-9)).mean() < -CONVEX_MIN_SLOPE:
        return []
    middle = int(np.linalg.norm(skin.places - skin.places.mean(axis=0), axis=1).argmin())
    point, normal = skin.places[middle], skin.normals[middle]
    walls = (entry_points(skin.surface, point, normal) - point) @ normal
    behind = -walls[walls < -TAXEL_OFF_MESH_MIN_DISTANCE_M]
    if not len(behind) or behind.min() > WALL_BEHIND_MAX_M:
        return []
    return [
        f"The layout is on the face towards the force/torque sensor; the other face is {behind.min() * 1e3:.1f} mm behind "
        "it. If the skin is on the other face, place the layout there."
    ]


def landmark_findings(places: Mapping[str, FloatArray], surface: Surface | None) -> tuple[str, ...]:
    """Find landmarks that are off the mesh; `places` (3,) metres, by name, in the mesh's frame."""
    if surface is None or not places:
        return ()
    points = np.array(list(places.values()))
    near, _ = nearest_points(surface, points)
    return tuple(
        off_mesh_words(f"Landmark {name}", point, found)
        for name, point, found in zip(places, points, near, strict=True)
        if np.linalg.norm(found - point) > LANDMARK_OFF_MESH_MIN_DISTANCE_M
    )


def off_mesh_words(what: str, point: FloatArray, nearest: FloatArray) -> str:
    """Give the distance of a point from the mesh, and the nearest point of the mesh, both (3,) metres."""
    text = ", ".join(f"{round(1e3 * value, 1) + 0.0:.1f}" for value in nearest.tolist())
    distance = 1e3 * float(np.linalg.norm(nearest - point))
    return f"{what} is {distance:.1f} mm from the mesh; the nearest point of the mesh is {text} mm. Check its position."


def _modules_of(layout: Layout, channels: IntArray) -> str:
    return _modules(sorted({layout.modules[int(index)].id for index in layout.module_of[channels]}))


def _modules(ids: Sequence[int]) -> str:
    shown = ", ".join(map(str, ids[:5])) + (" ..." if len(ids) > 5 else "")
    return f"module {shown}" if len(ids) == 1 else f"modules {shown}"
