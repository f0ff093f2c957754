"""Surface from a part's mesh file: checked, merged and turned outward, with findings.

A robot cover is an open shell with slivers, unshared vertices and sometimes a turned panel. No hole is filled and no vertex
moved.

**Winding.** Within a component it is made consistent. Each triangle is a node twice, as wound and turned. An edge whose two
triangles run along it in opposite directions joins equal copies, else different ones. A component of this double cover is one
consistent choice.

**Outside.** The heights h = n.(c - o) of the triangles' planes over the component's centroid o, with normals n and centroids c,
decide: their mean over the area is positive for a closed part (three times its volume over its area) and for each open shell
seen from its convex side. s = mean(h)/sqrt(mean(h^2)) is about 0.8 for any arc, and about 0 for a flat, wavy or rough sheet. A
component with a small s is judged about the centroid of the whole part; if that fails, the file's winding holds. A consistently
wound component inside the box of a larger one is the inner wall of a cover and keeps the file's winding.
"""

from __future__ import annotations

import hashlib
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray
from skincal.mesh.findings import (
    MIN_TRIANGLE_HEIGHT_M,
    VERTEX_MERGE_DISTANCE_M,
    FindingKind,
    MeshFinding,
    box_words,
    count_finding,
    words_finding,
)
from skincal.mesh.readers import read_mesh, reader_of
from skincal.mesh.search import surface_in_solver
from skincal.mesh.surface import Edges, Surface, find_edges, make_surface, pairs_within, triangle_heights
from skincal.model.errors import InputError
from skincal.model.given import MAX_MESH_BYTES, read_regular
from skincal.model.length_units import METRES_PER_UNIT
from skincal.model.scene import SurfaceSpec

MIN_DIAGONAL_M, MAX_DIAGONAL_M = 0.005, 3.0
"""Of the box of a robot part: a fingertip to a whole torso. Millimetres taken for metres miss it by a thousand."""
MAX_VERTEX_PAIRS_COMPARED = 30_000_000
"""Pairs of vertices: 3 s. A million vertices of a cover make a tenth; 20,000 vertices in one micrometre make 200 million."""
MIN_INSIDE_OUTSIDE_SCORE = 0.1
"""Smallest |s| that separates inside from outside: chance reaches it on a rough flat sheet of 100 triangles."""
FLAT_COMPONENT_MAX_HEIGHT_M = 1e-6
"""A component with smaller heights (rms) is flat."""
MAX_OUTER_WALL_CANDIDATES = 32
"""Largest components that are compared as outer walls."""
KEPT_MESHES, KEPT_MESH_MAX_BYTES = 2, 4 << 20
"""Meshes that stay ready for other sessions of the same part, and the size of a file from which on none stays."""


class MeshSizeError(InputError):
    """A mesh is not as large as a robot part. `seen` is the sentence without its advice."""

    def __init__(self, seen: str) -> None:
        super().__init__(f"{seen} Correct its unit (--unit, or unit in the scene), or its scale in the URDF.")
        self.seen = seen


def load_surface(spec: SurfaceSpec) -> tuple[Surface, tuple[MeshFinding, ...]]:
    """Read a mesh into the link frame with outward normals; also return the findings.

    Raises InputError: the file is missing, unreadable, of an unknown format, empty, has vertices that are not finite, or is a
    thousand times too large or too small.
    """
    reader_of(spec.path)  # a file with another suffix is not even opened
    data = read_regular(spec.path, MAX_MESH_BYTES, what="mesh file", advice="check [surface] mesh in the scene")
    make = _make_surface if len(data) <= KEPT_MESH_MAX_BYTES else _make_surface.__wrapped__
    return make(data, spec.path, spec.scale, spec.replaces_unit, np.asarray(spec.link_from_mesh, dtype=np.float64).tobytes())


@lru_cache(maxsize=KEPT_MESHES)
def _make_surface(
    data: bytes, path: Path, scale: float, replaces_unit: bool, link_from_mesh: bytes
) -> tuple[Surface, tuple[MeshFinding, ...]]:
    """Make the surface of a file's bytes; the pose is that of a `SurfaceSpec` as bytes."""
    spec = SurfaceSpec(path, scale, np.frombuffer(link_from_mesh).reshape(4, 4), replaces_unit)
    mesh = read_mesh(spec.path, data)
    vertices, triangles = mesh.vertices, mesh.triangles
    if len(triangles) == 0:
        raise InputError(f"{spec.path}: the mesh is empty ({len(vertices)} vertices, no triangle); export the part again.")
    _check_finite(spec.path, vertices)
    scale, unit_findings = _choose_scale(spec, mesh.unit)
    size = _check_size(spec, scale, vertices[triangles.ravel()])
    vertices = vertices * scale @ spec.link_from_mesh[:3, :3].T + spec.link_from_mesh[:3, 3]
    if np.linalg.det(spec.link_from_mesh[:3, :3]) < 0:
        triangles = triangles[:, [0, 2, 1]]  # a mirror turns the winding
    vertices, triangles, merged = merge_vertices(vertices, triangles)
    triangles, dropped = _drop(spec.path, vertices, triangles)
    triangles, wound = orient_outward(vertices, triangles)
    surface = make_surface(vertices, triangles, hashlib.sha256(data).hexdigest())
    # Written now, so that the first poke does not wait for it.
    surface_in_solver(surface)
    counts = {
        # An STL repeats the corners of every triangle.
        FindingKind.MERGED: 0 if spec.path.suffix.lower() == ".stl" else merged,
        **dropped,
        FindingKind.SLIVERS: int(surface.is_sliver.sum()),
        **wound,
    }
    found = [count_finding(kind, count) for kind, count in counts.items() if count]
    return surface, (size, *unit_findings, *mesh.findings, *found)


def _check_finite(path: Path, vertices: FloatArray) -> None:
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise InputError(
            f"{path}: {int(bad.sum())} of {len(vertices)} vertices are NaN or infinite (the first is {int(bad.argmax())}); "
            "finite coordinates were expected: export the part again."
        )


def _length(metres: float) -> str:
    return f"{metres * 1e3:.4g} mm" if metres < 1 else f"{metres:.4g} m"


def _choose_scale(spec: SurfaceSpec, file_unit: float | None) -> tuple[float, list[MeshFinding]]:
    """Choose the metres per unit of a file. A typed unit replaces the file's."""
    if file_unit is None:
        return spec.scale, []
    if not spec.replaces_unit:
        return spec.scale * file_unit, []
    differs = not np.isclose(spec.scale, file_unit, rtol=1e-6)
    return spec.scale, [words_finding(FindingKind.UNIT_REPLACED, _length(file_unit))] if differs else []


def _check_size(spec: SurfaceSpec, scale: float, corners: FloatArray) -> MeshFinding:
    stretches = np.linalg.norm(spec.link_from_mesh[:3, :3], axis=0)
    with np.errstate(over="ignore"):
        box = (corners.max(axis=0) - corners.min(axis=0)) * stretches
        raw = float(np.linalg.norm(box))
    unit = min(METRES_PER_UNIT, key=lambda name: abs(METRES_PER_UNIT[name] - scale))
    diagonal = raw * scale
    if MIN_DIAGONAL_M <= diagonal <= MAX_DIAGONAL_M:
        words = f"{box_words((box * scale * 1e3).tolist())} (diagonal {_length(diagonal)}, unit {unit}); check that it is so"
        return words_finding(FindingKind.SIZE, words)
    fitting = {
        name: raw * unit_m for name, unit_m in METRES_PER_UNIT.items() if MIN_DIAGONAL_M <= raw * unit_m <= MAX_DIAGONAL_M
    }
    likely = "; ".join(f"unit {name} would give {_length(size)}" for name, size in fitting.items())
    raise MeshSizeError(
        f"{spec.path}: the part's box has a diagonal of {_length(diagonal)} with unit {unit}; "
        f"{_length(MIN_DIAGONAL_M)} to {_length(MAX_DIAGONAL_M)} was expected: {likely or 'no known unit makes it fit'}."
    )


def _drop(path: Path, vertices: FloatArray, triangles: IntArray) -> tuple[IntArray, dict[FindingKind, int]]:
    """Drop triangles without area and duplicates; return the counts, too."""
    flat = triangle_heights(vertices[triangles])[0] < MIN_TRIANGLE_HEIGHT_M
    triangles = triangles[~flat]
    again = _first_equal(np.sort(triangles, axis=1)) != np.arange(len(triangles))
    triangles = triangles[~again]
    if len(triangles) == 0:
        raise InputError(f"{path}: no triangle of the mesh has an area; a surface was expected: export the part again.")
    return triangles, {FindingKind.ZERO_AREA: int(flat.sum()), FindingKind.DUPLICATES: int(again.sum())}


def merge_vertices(vertices: FloatArray, triangles: IntArray) -> tuple[FloatArray, IntArray, int]:
    """Merge vertices nearer than `VERTEX_MERGE_DISTANCE_M`, and drop unused ones.

    Returns vertices and triangles, in the order of the file, and the number of merged vertices.
    """
    used = np.zeros(len(vertices), dtype=bool)
    used[triangles] = True
    triangles = (np.cumsum(used) - 1)[triangles]
    vertices = vertices[used]
    same = _first_equal(vertices)
    keep = np.flatnonzero(same == np.arange(len(vertices)))
    near = connected_components(len(keep), pairs_within(vertices[keep], VERTEX_MERGE_DISTANCE_M, MAX_VERTEX_PAIRS_COMPARED))
    index = np.empty(len(vertices), dtype=np.int64)
    index[keep] = keep[near]
    index = index[same]
    kept = index == np.arange(len(vertices))
    return vertices[kept], (np.cumsum(kept) - 1)[index[triangles]], int((~kept).sum())


def _first_equal(rows: NDArray[np.float64] | IntArray) -> IntArray:
    """Find for each row (n, d) the first row that is equal."""
    if len(rows) == 0:
        return np.empty(0, dtype=np.int64)
    order = np.lexsort(rows.T)
    ranked = rows[order]
    new = np.r_[True, (ranked[1:] != ranked[:-1]).any(axis=1)]
    first = np.empty(len(rows), dtype=np.int64)
    # lexsort is stable, so the first of a run is the lowest index.
    first[order] = order[np.flatnonzero(new)][np.cumsum(new) - 1]
    return first


def connected_components(count: int, pairs: IntArray) -> IntArray:
    """Label `count` nodes, connected by `pairs` (m, 2), by the lowest number in their component."""
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


def orient_outward(vertices: FloatArray, triangles: IntArray) -> tuple[IntArray, dict[FindingKind, int]]:
    """Make the winding of each component consistent and outward; return the counts of findings, too."""
    edges = find_edges(triangles)
    component, flip, one_sided = _consistent(len(triangles), edges)
    triangles = np.where(flip[:, None], triangles[:, [0, 2, 1]], triangles)
    mended = np.bincount(component, flip) > 0
    # A triangle that is turned keeps its edges.
    side = _side(vertices, triangles, component, edges.open // 3)
    inner = _inside_another(vertices, triangles, component) & ~mended
    turn = (side < 0) & ~inner & ~one_sided
    turned = turn[component]
    triangles = np.where(turned[:, None], triangles[:, [0, 2, 1]], triangles)
    return triangles, {
        FindingKind.OPEN_EDGES: len(edges.open),
        FindingKind.NON_MANIFOLD: edges.non_manifold,
        FindingKind.COMPONENTS: len(side) if len(side) > 1 else 0,
        FindingKind.WINDING: int(flip.sum()),
        FindingKind.TURNED: int(turned.sum()),
        FindingKind.ONE_SIDED: int(one_sided.sum()),
        FindingKind.FLAT: int((side == 0).sum()),
    }


def _consistent(count: int, edges: Edges) -> tuple[IntArray, NDArray[np.bool_], NDArray[np.bool_]]:
    """Find each triangle's component, whether to turn it, and the components with one side only."""
    one, two = edges.pairs[:, 0] // 3, edges.pairs[:, 1] // 3
    # Node 2 t is triangle t as wound, node 2 t + 1 the same turned.
    joins = [np.stack([2 * one + copy, 2 * two + (copy ^ edges.against)], axis=1) for copy in (0, 1)]
    label = connected_components(2 * count, np.concatenate(joins)).reshape(count, 2)
    lowest, is_lowest = label.min(axis=1), np.zeros(2 * count, dtype=bool)
    is_lowest[lowest] = True
    component = (np.cumsum(is_lowest) - 1)[lowest]
    one_sided = np.bincount(component, label[:, 0] == label[:, 1]) > 0
    flip = label[:, 0] > label[:, 1]
    # The majority of a component holds as wound.
    minority = np.bincount(component, flip) * 2 > np.bincount(component)
    return component, (flip ^ minority[component]) & ~one_sided[component], one_sided


def _side(vertices: FloatArray, triangles: IntArray, component: IntArray, at_rim: IntArray) -> FloatArray:
    """Compute for each component 1 if it is wound outward, -1 inward, 0 if its shape does not show it.

    `at_rim` are triangles with an open edge.
    """
    corners = vertices[triangles]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    size = np.linalg.norm(area, axis=1)
    middle = corners.mean(axis=1)
    total = np.bincount(component, size)
    own = np.stack([np.bincount(component, size * middle[:, axis]) / total for axis in range(3)], axis=1)
    whole = size @ middle / size.sum()
    is_open = np.bincount(component[at_rim], minlength=len(total)) > 0

    def about(origin: FloatArray) -> FloatArray:
        flux = (area * (middle - origin)).sum(axis=1)
        through, square = np.bincount(component, flux), np.bincount(component, flux**2 / size)
        spread = np.sqrt(square * total)
        # For a closed component the sign of the volume decides, however thin its walls are.
        clear = (np.abs(through) > MIN_INSIDE_OUTSIDE_SCORE * spread) | ~is_open
        return np.where(clear & (square > FLAT_COMPONENT_MAX_HEIGHT_M**2 * total), np.sign(through), 0.0)

    side = about(own[component])
    return np.where(side != 0, side, about(whole))


def _inside_another(vertices: FloatArray, triangles: IntArray, component: IntArray) -> NDArray[np.bool_]:
    """Tell for each component whether its box is inside the box of a larger one."""
    count = int(component.max()) + 1
    if count == 1:
        return np.zeros(1, dtype=bool)
    corners = vertices[triangles]
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, component, corners.min(axis=1))
    np.maximum.at(high, component, corners.max(axis=1))
    inside = np.zeros(count, dtype=bool)
    size = np.prod(high - low, axis=1)
    # Only the largest boxes are compared: all pairs would take too long for a triangle soup.
    for outer in np.argsort(-size, kind="stable")[:MAX_OUTER_WALL_CANDIDATES]:
        within = (low >= low[outer]).all(axis=1) & (high <= high[outer]).all(axis=1) & (size < size[outer])
        inside |= within
    return inside
