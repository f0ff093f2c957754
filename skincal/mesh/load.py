"""Corners and faces of a mesh file: STL (binary, ASCII), OBJ, PLY, OFF.

Own small readers, since importing a mesh library costs longer than reading the mesh (trimesh with scipy: about a
second, most of it holding the interpreter's lock). Only geometry is read; polygons are cut into fans of triangles.
Nothing is merged, dropped or repaired here.

PLY: G. Turk, "The PLY polygon file format", 1994; elements other than `vertex` and `face` are stepped over.

A part's mesh file becomes a surface: checked, merged and turned outward, and what was found is said.

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
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray
from skincal.mesh.search import surface_in_solver
from skincal.mesh.surface import SLIVER_RATIO, Surface, find_edges, heights, make_surface, pairs_within
from skincal.model.errors import InputError
from skincal.model.given import MESH_MOST, read_regular
from skincal.model.scene import UNITS, SurfaceSpec

Mesh = tuple[FloatArray, IntArray]
"""Vertices (nv, 3) in the file's unit, triangles (nt, 3)."""

_STL_HEADER = 84
_STL_RECORD = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_FACE_LISTS = ("vertex_indices", "vertex_index")
TEXT_MESH_MOST = 64 << 20
"""Bytes of a mesh in words: each word of some bytes takes forty while it is read. A million triangles of OBJ are 60 MB."""
WORD_MOST = 64
"""Bytes of a number in words: a double needs 24. An array of words is as wide as the longest of them."""


def read_mesh(path: Path, data: bytes) -> Mesh:
    """Read vertices (nv, 3), in the file's unit, and triangles (nt, 3), indices in range, in a mesh file's bytes.

    The suffix of `path` names the format.

    Raises InputError: the suffix is not known, or the content is not of that format.
    """
    reader = _reader_of(path)
    try:
        vertices, triangles = reader(data)
    except (ValueError, IndexError, KeyError, OverflowError) as error:
        raise InputError(f"{path}: not a readable {path.suffix[1:].upper()} mesh ({error}); export the mesh again.") from None
    if triangles.size and (triangles.min() < 0 or triangles.max() >= len(vertices)):
        raise InputError(
            f"{path}: triangles name vertices {int(triangles.min())} to {int(triangles.max())}, and there are {len(vertices)}; "
            "the file is damaged: export the mesh again."
        )
    return vertices, triangles


def _reader_of(path: Path) -> Callable[[bytes], Mesh]:
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        known = ", ".join(_READERS)
        raise InputError(f"{path}: the suffix {path.suffix or '(none)'!r} is not a mesh format read here; expected {known}.")
    return reader


def triangulate(corners: Sequence[int], sizes: Sequence[int]) -> IntArray:
    """Cut polygons into fans of triangles, (nt, 3) int, in their order.

    `corners` holds the vertices of all polygons, one after the other, `sizes` how many each of them has.
    """
    flat, size = np.array(corners, dtype=np.int64), np.array(sizes, dtype=np.int64)
    if size.min(initial=3) < 3:
        raise ValueError(f"a face with {size.min()} corners")
    first = np.cumsum(size) - size
    polygon = np.repeat(np.arange(len(size)), size - 2)
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(size - 2) - (size - 2), size - 2)
    second = first[polygon] + step + 1
    return np.stack([flat[first[polygon]], flat[second], flat[second + 1]], axis=1)


def _read_stl(data: bytes) -> Mesh:
    count = int.from_bytes(data[80:_STL_HEADER], "little") if len(data) >= _STL_HEADER else -1
    size = _STL_HEADER + count * _STL_RECORD.itemsize
    # By the size and not by the first word: there are binary files that begin with "solid".
    if count >= 0 and len(data) == size:
        corners = np.frombuffer(data, _STL_RECORD, count, _STL_HEADER)["corners"].astype(float).reshape(-1, 3)
    elif data.lstrip()[:5].lower() == b"solid":
        words = re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", _in_words(data))
        corners = _numbers([word for point in words for word in point]).reshape(-1, 3)
        if len(corners) % 3:
            raise ValueError(f"{len(corners)} corners do not make whole triangles")
    elif not data:
        corners = np.empty((0, 3))
    else:
        raise ValueError(f"{len(data)} bytes; {size} expected for the {count} triangles announced")
    return corners, np.arange(len(corners)).reshape(-1, 3)


def _in_words(data: bytes) -> bytes:
    """Return the bytes of a mesh in words; `ValueError` where they are too many."""
    if len(data) > TEXT_MESH_MOST:
        raise ValueError(f"{len(data)} bytes of text; {TEXT_MESH_MOST} at most were expected: write it as a binary file")
    return data


def _numbers(words: list[bytes]) -> FloatArray:
    longest = max(map(len, words), default=0)
    if longest > WORD_MOST:
        raise ValueError(f"a number of {longest} letters")
    return np.array(words, dtype="S").astype(float)


def _point(words: list[bytes]) -> tuple[float, float, float]:
    """Return the first three numbers; a fourth (w) or colours may follow."""
    if len(words) < 3:
        raise ValueError("a vertex with fewer than 3 numbers")
    return float(words[0]), float(words[1]), float(words[2])


def _vertices(numbers: list[float]) -> FloatArray:
    return np.array(numbers, dtype=float).reshape(-1, 3)


def _read_obj(data: bytes) -> Mesh:
    # Word by word into flat lists: a reading thread then leaves room for the window's, which one call for all, or a hundred
    # thousand small lists for the garbage collector to walk, does not.
    points: list[float] = []
    corners: list[int] = []
    sizes: list[int] = []
    for line in _in_words(data).replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        words = line.split()
        if words and words[0] == b"v":
            points.extend(_point(words[1:]))
        elif words and words[0] == b"f":
            known = len(points) // 3
            indices = [int(word.partition(b"/")[0]) for word in words[1:]]
            # Indices count from 1; a negative one counts back from the last vertex read so far.
            corners.extend([i - 1 if i > 0 else known + i for i in indices])
            sizes.append(len(indices))
    if data and not points and not sizes:
        raise ValueError("no line starts with v or f")
    return _vertices(points), triangulate(corners, sizes)


def _read_off(data: bytes) -> Mesh:
    lines = [line for line in re.sub(rb"#[^\n]*", b"", _in_words(data)).splitlines() if line.strip()]
    if not lines:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    if lines[0].split()[0] != b"OFF":
        raise ValueError("the first word is not OFF")
    # The counts may stand on the line of the first word.
    lines = [*([lines[0].strip()[3:]] if lines[0].strip() != b"OFF" else []), *lines[1:]]
    vertex_count, face_count = (int(word) for word in lines[0].split()[:2])
    if len(lines) < 1 + vertex_count + face_count:
        raise ValueError(f"{len(lines) - 1} lines; {vertex_count} vertices and {face_count} faces announced")
    points: list[float] = []
    for line in lines[1 : 1 + vertex_count]:
        points.extend(_point(line.split()))
    corners: list[int] = []
    sizes: list[int] = []
    for line in lines[1 + vertex_count : 1 + vertex_count + face_count]:
        words = line.split()
        size = int(words[0])
        if len(words) <= size:
            raise ValueError(f"a face of {size} corners with {len(words) - 1} indices")
        corners.extend([int(word) for word in words[1 : 1 + size]])
        sizes.append(size)
    return _vertices(points), triangulate(corners, sizes)


@dataclass(frozen=True, slots=True)
class _Property:
    name: str
    kind: str
    """numpy's name of the number type."""
    count_kind: str
    """Type of a list's length; empty for a single number."""


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]


def _read_ply(data: bytes) -> Mesh:
    if not data:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    elements, body = _read_header(data)
    vertices, triangles = np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    for element in elements:
        # Each record has a byte at least: a count is believed as far as there are bytes.
        if not 0 <= element.count <= (body.left if element.properties else 0):
            raise ValueError(f"{element.count} records of {element.name!r} announced in {body.left} bytes")
        if element.name == "vertex":
            records = body.table(element)
            if records is None:
                raise ValueError(f"the file ends before its {element.count} vertices")
            vertices = np.stack([records[axis][:, 0] for axis in "xyz"]).astype(float).T
        elif element.name == "face":
            triangles = _ply_faces(element, body)
        else:
            for _ in range(element.count):
                body.row(element)
    return vertices, triangles


def _read_header(data: bytes) -> tuple[list[_Element], _Body]:
    head, mark, body = data.partition(b"end_header")
    # Latin-1 takes every byte: comments in the header come in any encoding.
    lines = [line.split() for line in head.decode("latin-1").splitlines()]
    if not mark or not lines or lines[0] != ["ply"]:
        raise ValueError("no PLY header")
    order, types, elements = "", dict.fromkeys(_TYPES, "f8"), list[_Element]()
    for words in lines[1:]:
        match words:
            case ["format", name, _]:
                order = _ORDERS[name]
                types = _TYPES if order else types
            case ["element", name, count]:
                elements.append(_Element(name, int(count), []))
            case ["property", "list", count_kind, kind, name]:
                elements[-1].properties.append(_Property(name, types[kind], types[count_kind]))
            case ["property", kind, name]:
                elements[-1].properties.append(_Property(name, types[kind], ""))
            case _:
                continue
    if order:
        # One line end and no more: a binary body may begin with the same bytes.
        return elements, _Body(body[2:] if body[:2] == b"\r\n" else body[1:], order)
    # Words become doubles, whatever their type, so that both kinds of body are read alike.
    return elements, _Body(_numbers(_in_words(body).split()).astype("<f8").tobytes(), "<")


class _Body:
    """Reads a PLY body record by record, or an element at once where its records have one size."""

    def __init__(self, data: bytes, order: str) -> None:
        self._data, self._order = data, order
        self._at = 0

    @property
    def left(self) -> int:
        """Bytes that were not read yet."""
        return len(self._data) - self._at

    def _take(self, kind: str, count: int) -> list[float]:
        if count < 0:
            raise ValueError(f"a list of {count} numbers")
        numbers = np.frombuffer(self._data, self._order + kind, count, self._at)
        self._at += numbers.nbytes
        return numbers.astype(float).tolist()

    def row(self, element: _Element) -> list[list[float]]:
        """Return the next record: for each property its numbers."""
        record: list[list[float]] = []
        for item in element.properties:
            count = int(self._take(item.count_kind, 1)[0]) if item.count_kind else 1
            record.append(self._take(item.kind, count))
        return record

    def table(self, element: _Element) -> NDArray[np.void] | None:
        """Return all records of `element` where every list in them has three numbers, else None."""
        parts: list[tuple[str, str, tuple[int, ...]]] = []
        for item in element.properties:
            if item.count_kind:
                parts.append((f"{item.name} length", self._order + item.count_kind, (1,)))
            parts.append((item.name, self._order + item.kind, (3 if item.count_kind else 1,)))
        dtype = np.dtype(parts)
        if self.left < element.count * dtype.itemsize:
            return None
        records = np.frombuffer(self._data, dtype, element.count, self._at)
        if not all((records[name] == 3).all() for name, _, _ in parts if name.endswith(" length")):
            return None
        self._at += records.nbytes
        return records


def _ply_faces(element: _Element, body: _Body) -> IntArray:
    names = [item.name if item.count_kind else "" for item in element.properties]
    named = next((name for name in names if name in _FACE_LISTS), None)
    if named is None:
        raise ValueError("faces without vertex_indices; triangle strips are not read")
    records = body.table(element)
    if records is not None:
        return records[named].astype(np.int64)
    polygons = [[int(index) for index in body.row(element)[names.index(named)]] for _ in range(element.count)]
    return triangulate([corner for polygon in polygons for corner in polygon], [len(polygon) for polygon in polygons])


_READERS: dict[str, Callable[[bytes], Mesh]] = {
    ".stl": _read_stl,
    ".obj": _read_obj,
    ".ply": _read_ply,
    ".off": _read_off,
}


SIZE_MIN, SIZE_MAX = 0.005, 3.0
"""m. Diagonal of the box of a robot part: a fingertip to a whole torso. Millimetres taken for metres, or metres for
millimetres, miss it by a thousand."""
MERGE_DISTANCE = 1e-6
"""m. Vertices this near are one: a hundredth of what a cover is made to, far above the rounding of a 32-bit file."""
NEAR_MOST = 30_000_000
"""Pairs of vertices that are looked at for being that near: 3 s. A million vertices of a cover make a tenth; 20,000 vertices in
one micrometre would make 200 million."""
ZERO_HEIGHT = 1e-7
"""m. A triangle flatter than this has no direction: a 32-bit file in millimetres rounds 0.5 m to 3e-8 m."""
SIDE_MIN = 0.1
"""Smallest |s| that separates inside from outside: chance reaches it on a rough flat sheet of 100 triangles."""
FLAT_HEIGHT = 1e-6
"""m. A component whose heights are below this (rms) is flat: it is the distance at which vertices are one."""
_WALLS = 32
"""Largest components that are looked at as outer walls."""


class FindingKind(Enum):
    """What is found in a mesh; the value is the sentence on it, with a gap for how many there are."""

    SIZE = "The part is {}."
    MERGED = f"Vertices within {MERGE_DISTANCE * 1e6:.0f} um of another, merged: {{}}."
    ZERO_AREA = f"Triangles without area (flatter than {ZERO_HEIGHT * 1e9:.0f} nm), dropped: {{}}."
    DUPLICATES = "Triangles that were there twice, dropped: {}."
    SLIVERS = f"Slivers (over {SLIVER_RATIO:.0f} times as long as high), used as they are: {{}}."
    OPEN_EDGES = "The mesh has open rims, as covers have ({} edges); it is used as it is."
    NON_MANIFOLD = "Edges shared by three or more triangles, across which no pad is laid: {}."
    COMPONENTS = "Pieces that share no edge: {}."
    WINDING = "Triangles wound against their neighbours, turned: {}."
    TURNED = "Triangles that pointed inward, by the shape of the part, turned: {}."
    ONE_SIDED = "Pieces with one side only, normals as in the file: {}."
    FLAT = "Pieces whose shape does not tell inside from outside, normals as in the file: {}."


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing found in a mesh, and what was done about it."""

    kind: FindingKind
    count: int
    sentence: str


def load_surface(spec: SurfaceSpec) -> tuple[Surface, tuple[Finding, ...]]:
    """Read a mesh into the link frame with outward normals, and say what was found.

    Raises InputError: the file is missing, unreadable, of an unknown format, empty, has vertices that are not finite, or is a
    thousand times too large or too small; the message says what was seen and what to do.
    """
    _reader_of(spec.path)  # what has another suffix is not even opened
    data = read_regular(spec.path, MESH_MOST, what="mesh file", advice="check [surface] mesh in the scene")
    vertices, triangles = read_mesh(spec.path, data)
    if len(triangles) == 0:
        raise InputError(f"{spec.path}: the mesh is empty ({len(vertices)} vertices, no triangle); export the part again.")
    _check_finite(spec.path, vertices)
    size = _check_size(spec, vertices[triangles.ravel()])
    vertices = vertices * spec.scale @ spec.link_from_mesh[:3, :3].T + spec.link_from_mesh[:3, 3]
    vertices, triangles, merged = merge_vertices(vertices, triangles)
    triangles, dropped = _drop(spec.path, vertices, triangles)
    triangles, wound = orient_outward(vertices, triangles)
    surface = make_surface(vertices, triangles, hashlib.sha256(data).hexdigest())
    # Now, so that the first poke does not wait for it.
    surface_in_solver(surface)
    edges = find_edges(triangles)
    counts = {
        FindingKind.MERGED: merged,
        **dropped,
        FindingKind.SLIVERS: int(surface.slim.sum()),
        FindingKind.OPEN_EDGES: len(edges.open),
        FindingKind.NON_MANIFOLD: edges.non_manifold,
        **wound,
    }
    found = [Finding(kind, count, kind.value.format(count)) for kind, count in counts.items() if count]
    return surface, (size, *found)


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
        words = f"{sides} mm (diagonal {_length(diagonal)}, unit {unit}); check that it is so"
        return Finding(FindingKind.SIZE, 0, FindingKind.SIZE.value.format(words))
    fitting = {name: raw * scale for name, scale in UNITS.items() if SIZE_MIN <= raw * scale <= SIZE_MAX}
    likely = "; ".join(f"unit {name} would give {_length(size)}" for name, size in fitting.items())
    raise InputError(
        f"{spec.path}: the part's box has a diagonal of {_length(diagonal)} with unit {unit}; {_length(SIZE_MIN)} to "
        f"{_length(SIZE_MAX)} was expected: {likely or 'no known unit makes it fit'}. Correct [surface] unit in the scene."
    )


def _drop(path: Path, vertices: FloatArray, triangles: IntArray) -> tuple[IntArray, dict[FindingKind, int]]:
    """Drop triangles without area and those that are there twice; return how many of each."""
    flat = heights(vertices[triangles])[0] < ZERO_HEIGHT
    triangles = triangles[~flat]
    again = duplicate_triangles(triangles)
    triangles = triangles[~again]
    if len(triangles) == 0:
        raise InputError(f"{path}: no triangle of the mesh has an area; a surface was expected: export the part again.")
    return triangles, {FindingKind.ZERO_AREA: int(flat.sum()), FindingKind.DUPLICATES: int(again.sum())}


def merge_vertices(vertices: FloatArray, triangles: IntArray) -> tuple[FloatArray, IntArray, int]:
    """Make one vertex of those nearer than `MERGE_DISTANCE`; vertices no triangle uses go.

    Returns vertices and triangles, in the order of the file, and how many vertices became another.
    """
    used = np.zeros(len(vertices), dtype=bool)
    used[triangles] = True
    triangles = (np.cumsum(used) - 1)[triangles]
    vertices = vertices[used]
    same = _identical(vertices)
    keep = np.flatnonzero(same == np.arange(len(vertices)))
    near = connected_components(len(keep), pairs_within(vertices[keep], MERGE_DISTANCE, NEAR_MOST))
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


def duplicate_triangles(triangles: IntArray) -> NDArray[np.bool_]:
    """Return (nt,) True for each triangle whose three vertices an earlier triangle has, in whatever order."""
    corners = np.sort(triangles, axis=1)
    order = np.lexsort(corners.T)
    ranked = corners[order]
    again = np.zeros(len(triangles), dtype=bool)
    again[order[1:]] = (ranked[1:] == ranked[:-1]).all(axis=1)
    return again


def connected_components(count: int, pairs: IntArray) -> IntArray:
    """Label `count` nodes, of which `pairs` (m, 2) hang together: each has the lowest number of its component."""
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
    """Make the winding of each component consistent and outward; return what had to be turned for it, and what is odd."""
    component, flip, one_sided = _consistent(triangles)
    triangles = np.where(flip[:, None], triangles[:, [0, 2, 1]], triangles)
    mended = np.bincount(component, flip) > 0
    side = _side(vertices, triangles, component)
    inner = _inside_another(vertices, triangles, component) & ~mended
    turn = (side < 0) & ~inner & ~one_sided
    turned = turn[component]
    triangles = np.where(turned[:, None], triangles[:, [0, 2, 1]], triangles)
    return triangles, {
        FindingKind.COMPONENTS: len(side) if len(side) > 1 else 0,
        FindingKind.WINDING: int(flip.sum()),
        FindingKind.TURNED: int(turned.sum()),
        FindingKind.ONE_SIDED: int(one_sided.sum()),
        FindingKind.FLAT: int((side == 0).sum()),
    }


def _consistent(triangles: IntArray) -> tuple[IntArray, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return each triangle's component, whether to turn it, and which components have one side only."""
    count = len(triangles)
    edges = find_edges(triangles)
    one, two = edges.pairs[:, 0] // 3, edges.pairs[:, 1] // 3
    # Node 2 t is triangle t as wound, node 2 t + 1 the same turned.
    joins = [np.stack([2 * one + copy, 2 * two + (copy ^ edges.against)], axis=1) for copy in (0, 1)]
    label = connected_components(2 * count, np.concatenate(joins)).reshape(count, 2)
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
