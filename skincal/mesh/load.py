"""A part's mesh file becomes a surface: checked, merged and turned outward, and what was found is said.

A robot cover is an open shell with slivers, unshared vertices and now and then a turned panel. No hole is filled and no
vertex moved.

Which side is outside? Within a component the winding is made consistent: triangles are nodes in two copies, as wound and
turned, and an edge whose two triangles run along it in opposite directions joins equal copies, in the same direction
different ones. A component of that double cover is one consistent choice.

Which choice is outward then follows from the heights h = n.(c - o) of its triangles' planes over the component's centroid
o, with the normals n and centroids c: their mean over the area is positive for a closed part (three times its volume
over its area) and for every open shell seen from its convex side. s = mean(h)/sqrt(mean(h^2)) is about 0.8 for an arc
however shallow, and about 0 for a sheet that is flat, wavy or rough. A component that does not show it by its own centroid
is judged about the centroid of the whole part; if that does not show it either, the file's winding holds. A consistently
wound component that lies inside the box of a larger one is the inner wall of a cover and keeps the file's winding.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skincal.geometry.arrays import FloatArray, IntArray
from skincal.mesh.read import read_mesh
from skincal.mesh.search import solver_copy
from skincal.mesh.surface import SLIVER_RATIO, Surface, find_edges, heights, make_surface
from skincal.model.errors import InputError
from skincal.model.scene import UNITS, SurfaceSpec

SIZE_MIN, SIZE_MAX = 0.005, 3.0
"""m. Diagonal of the box of a robot part: a fingertip to a whole torso. Millimetres taken for metres, or metres for
millimetres, miss it by a thousand."""
MERGE_DISTANCE = 1e-6
"""m. Vertices this near are one: a hundredth of what a cover is made to, far above the rounding of a 32-bit file."""
ZERO_HEIGHT = 1e-7
"""m. A triangle flatter than this has no direction: a 32-bit file in millimetres rounds 0.5 m to 3e-8 m."""
SIDE_MIN = 0.1
"""Smallest |s| that separates inside from outside: chance reaches it on a rough flat sheet of 100 triangles."""
FLAT_HEIGHT = 1e-6
"""m. A component whose heights are below this (rms) is flat: it is the distance at which vertices are one."""
_SWEEP = np.array([0.4472135954999579, 0.5773502691896258, 0.6831300510639733])
"""A unit direction along which no CAD grid lines up, so that few vertices fall together when projected on it."""
_WALLS = 32
"""Largest components that are looked at as outer walls."""


class FindingKind(Enum):
    """What is said about a mesh; the value is its short name."""

    SIZE = "size"
    MERGED = "merged vertices"
    ZERO_AREA = "zero-area triangles"
    DUPLICATES = "duplicate triangles"
    SLIVERS = "slivers"
    OPEN_EDGES = "open edges"
    NON_MANIFOLD = "non-manifold edges"
    COMPONENTS = "components"
    WINDING = "inconsistent winding"
    TURNED = "turned normals"
    ONE_SIDED = "one-sided"
    FLAT = "flat"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing found in a mesh, and what was done about it."""

    kind: FindingKind
    count: int
    sentence: str


def load_surface(spec: SurfaceSpec) -> tuple[Surface, tuple[Finding, ...]]:
    """Read a mesh into the link frame with outward normals, and say what was found.

    Raises
    ------
    InputError
        The file is missing, unreadable, of an unknown format, empty, has vertices that are not finite, or is a
        thousand times too large or too small; the message says what was seen and what to do.
    """
    data = _read_bytes(spec.path)
    vertices, triangles = read_mesh(spec.path, data)
    if len(triangles) == 0:
        raise InputError(f"{spec.path}: the mesh is empty ({len(vertices)} vertices, no triangle); export the part again.")
    _check_finite(spec.path, vertices)
    size = _check_size(spec, vertices[triangles.ravel()])
    vertices = vertices * spec.scale @ spec.link_from_mesh[:3, :3].T + spec.link_from_mesh[:3, 3]
    vertices, triangles, merged = merge_vertices(vertices, triangles)
    triangles, dropped = _drop(spec.path, vertices, triangles)
    winding = wind_outward(vertices, triangles)
    surface = make_surface(vertices, winding.triangles, hashlib.sha256(data).hexdigest())
    # Now, so that the first poke does not wait for it.
    solver_copy(surface)
    findings = [size, *_merge_findings(merged), *dropped, *_shape_findings(surface), *_winding_findings(winding)]
    return surface, tuple(findings)


def _read_bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such mesh file; check [surface] mesh in the scene.") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path and its rights.") from None


def _check_finite(path: Path, vertices: FloatArray) -> None:
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise InputError(
            f"{path}: {int(bad.sum())} of {len(vertices)} vertices are NaN or infinite (the first is {int(bad.argmax())}); "
            "finite coordinates were expected: export the part again."
        )


def _length(metres: float) -> str:
    return f"{metres * 1e3:.4g} mm" if metres < 1 else f"{metres:.4g} m"


def _check_size(spec: SurfaceSpec, corners: FloatArray) -> Finding:
    box = corners.max(axis=0) - corners.min(axis=0)
    raw = float(np.linalg.norm(box))
    unit = min(UNITS, key=lambda name: abs(UNITS[name] - spec.scale))
    diagonal = raw * spec.scale
    if SIZE_MIN <= diagonal <= SIZE_MAX:
        sides = " x ".join(f"{side * spec.scale * 1e3:.4g}" for side in box)
        sentence = f"The part is {sides} mm (diagonal {_length(diagonal)}, unit {unit}); check that it is so."
        return Finding(FindingKind.SIZE, 0, sentence)
    fitting = {name: raw * scale for name, scale in UNITS.items() if SIZE_MIN <= raw * scale <= SIZE_MAX}
    likely = "; ".join(f"unit {name} would give {_length(size)}" for name, size in fitting.items())
    raise InputError(
        f"{spec.path}: the part's box has a diagonal of {_length(diagonal)} with unit {unit}; {_length(SIZE_MIN)} to "
        f"{_length(SIZE_MAX)} was expected: {likely or 'no known unit makes it fit'}. Correct [surface] unit in the scene."
    )


def _drop(path: Path, vertices: FloatArray, triangles: IntArray) -> tuple[IntArray, list[Finding]]:
    findings: list[Finding] = []
    height, longest = heights(vertices[triangles])
    flat = height < ZERO_HEIGHT
    if flat.any():
        sentence = f"Triangles without area (flatter than {ZERO_HEIGHT * 1e9:.0f} nm), dropped: {int(flat.sum())}."
        findings.append(Finding(FindingKind.ZERO_AREA, int(flat.sum()), sentence))
        triangles, height, longest = triangles[~flat], height[~flat], longest[~flat]
    again = duplicate_triangles(triangles)
    if again.any():
        sentence = f"Triangles that were there twice, dropped: {int(again.sum())}."
        findings.append(Finding(FindingKind.DUPLICATES, int(again.sum()), sentence))
        triangles, height, longest = triangles[~again], height[~again], longest[~again]
    if len(triangles) == 0:
        raise InputError(f"{path}: no triangle of the mesh has an area; a surface was expected: export the part again.")
    slivers = int((longest > SLIVER_RATIO * height).sum())
    if slivers:
        sentence = f"Slivers (over {SLIVER_RATIO:.0f} times as long as high), used as they are: {slivers}."
        findings.append(Finding(FindingKind.SLIVERS, slivers, sentence))
    return triangles, findings


def _merge_findings(merged: int) -> list[Finding]:
    if merged == 0:
        return []
    sentence = f"Vertices within {MERGE_DISTANCE * 1e6:.0f} um of another, merged: {merged}."
    return [Finding(FindingKind.MERGED, merged, sentence)]


def _shape_findings(surface: Surface) -> list[Finding]:
    edges = find_edges(surface.triangles)
    findings: list[Finding] = []
    if len(edges.open):
        sentence = f"The mesh has open rims, as covers have ({len(edges.open)} edges); it is used as it is."
        findings.append(Finding(FindingKind.OPEN_EDGES, len(edges.open), sentence))
    if edges.non_manifold:
        sentence = f"Edges shared by three or more triangles, across which no pad is laid: {edges.non_manifold}."
        findings.append(Finding(FindingKind.NON_MANIFOLD, edges.non_manifold, sentence))
    return findings


def _winding_findings(winding: Winding) -> list[Finding]:
    said = [
        (FindingKind.COMPONENTS, winding.components, "Pieces that share no edge: {}.", 1),
        (FindingKind.WINDING, winding.against, "Triangles wound against their neighbours, turned: {}.", 0),
        (FindingKind.TURNED, winding.turned, "Triangles that pointed inward, by the shape of the part, turned: {}.", 0),
        (FindingKind.ONE_SIDED, winding.one_sided, "Pieces with one side only, normals as in the file: {}.", 0),
        (
            FindingKind.FLAT,
            winding.undecided,
            "Pieces whose shape does not tell inside from outside, normals as in the file: {}.",
            0,
        ),
    ]
    return [Finding(kind, count, sentence.format(count)) for kind, count, sentence, usual in said if count > usual]


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


def duplicate_triangles(triangles: IntArray) -> NDArray[np.bool_]:
    """Return (nt,) True for each triangle whose three vertices an earlier triangle has, in whatever order."""
    corners = np.sort(triangles, axis=1)
    order = np.lexsort(corners.T)
    ranked = corners[order]
    again = np.zeros(len(triangles), dtype=bool)
    again[order[1:]] = (ranked[1:] == ranked[:-1]).all(axis=1)
    return again


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
    """Return for each component 1 where it is wound outward, -1 inward, 0 where its shape does not show it."""
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
        # Of a closed component the sign of the volume decides, however thin its walls are.
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
