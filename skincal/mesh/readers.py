"""Vertices and faces of a mesh file: STL (binary, ASCII), OBJ, PLY, OFF.

Own small readers: importing a mesh library takes longer than reading the mesh (trimesh with scipy about a second, most of it
holding the interpreter's lock). Only geometry is read; polygons are cut into fans of triangles. Nothing is repaired here.

PLY: G. Turk, "The PLY polygon file format", 1994; elements other than `vertex` and `face` are skipped.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray
from skincal.model.errors import InputError

Mesh = tuple[FloatArray, IntArray]
"""Vertices (nv, 3) in the file's unit, triangles (nt, 3)."""

_STL_HEADER_BYTES = 84
_STL_RECORD = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_FACE_LISTS = ("vertex_indices", "vertex_index")
MAX_TEXT_MESH_BYTES = 64 << 20
"""Largest mesh in text: a word of some bytes takes forty while it is read. A million triangles of OBJ are 60 MB."""
NUMBER_TEXT_MAX_CHARS = 64
"""Longest number in text: a double needs 24. An array of words is as wide as the longest of them."""


def read_mesh(path: Path, data: bytes) -> Mesh:
    """Read a mesh file's bytes; the suffix of `path` names the format.

    Raises InputError: the suffix is unknown, or the content is not of that format.
    """
    reader = reader_of(path)
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


def reader_of(path: Path) -> Callable[[bytes], Mesh]:
    """Find the reader for a suffix. Raises InputError: it is unknown."""
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        known = ", ".join(_READERS)
        raise InputError(f"{path}: the suffix {path.suffix or '(none)'!r} is not a mesh format read here; expected {known}.")
    return reader


def triangulate(corners: Sequence[int], sizes: Sequence[int]) -> IntArray:
    """Cut polygons into fans of triangles, (nt, 3) int, in their order.

    `corners` holds the vertices of all polygons in turn, `sizes` their counts.
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
    count = int.from_bytes(data[80:_STL_HEADER_BYTES], "little") if len(data) >= _STL_HEADER_BYTES else -1
    size = _STL_HEADER_BYTES + count * _STL_RECORD.itemsize
    # By the size and not by the first word: there are binary files that begin with "solid".
    if count >= 0 and len(data) == size:
        corners = np.frombuffer(data, _STL_RECORD, count, _STL_HEADER_BYTES)["corners"].astype(float).reshape(-1, 3)
    elif data.lstrip()[:5].lower() == b"solid":
        words = re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", _check_text_size(data))
        corners = _numbers([word for point in words for word in point]).reshape(-1, 3)
        if len(corners) % 3:
            raise ValueError(f"{len(corners)} corners do not make whole triangles")
    elif not data:
        corners = np.empty((0, 3))
    else:
        raise ValueError(f"{len(data)} bytes; {size} expected for the {count} triangles announced")
    return corners, np.arange(len(corners)).reshape(-1, 3)


def _check_text_size(data: bytes) -> bytes:
    if len(data) > MAX_TEXT_MESH_BYTES:
        raise ValueError(f"{len(data)} bytes of text; {MAX_TEXT_MESH_BYTES} at most were expected: write it as a binary file")
    return data


def _numbers(words: list[bytes]) -> FloatArray:
    longest = max(map(len, words), default=0)
    if longest > NUMBER_TEXT_MAX_CHARS:
        raise ValueError(f"a number of {longest} letters")
    return np.array(words, dtype="S").astype(float)


def _point(words: list[bytes]) -> tuple[float, float, float]:
    # A fourth number (w) or colours may follow.
    if len(words) < 3:
        raise ValueError("a vertex with fewer than 3 numbers")
    return float(words[0]), float(words[1]), float(words[2])


def _vertices(numbers: list[float]) -> FloatArray:
    return np.array(numbers, dtype=float).reshape(-1, 3)


def _read_obj(data: bytes) -> Mesh:
    # Word by word into flat lists: so the reading thread lets the window's run. One call for all, or many small lists for the
    # garbage collector, would block it.
    points: list[float] = []
    corners: list[int] = []
    sizes: list[int] = []
    for line in _check_text_size(data).replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
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
    lines = [line for line in re.sub(rb"#[^\n]*", b"", _check_text_size(data)).splitlines() if line.strip()]
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


class _Property(NamedTuple):
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
        # Each record has at least a byte: a larger count is wrong.
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
    # Words become doubles, so that both kinds of body are read alike.
    return elements, _Body(_numbers(_check_text_size(body).split()).astype("<f8").tobytes(), "<")


class _Body:
    """Reader of a PLY body, record by record, or an element at once if its records have one size."""

    def __init__(self, data: bytes, order: str) -> None:
        self._data, self._order = data, order
        self._at = 0

    @property
    def left(self) -> int:
        """Unread bytes."""
        return len(self._data) - self._at

    def _take(self, kind: str, count: int) -> list[float]:
        if count < 0:
            raise ValueError(f"a list of {count} numbers")
        numbers = np.frombuffer(self._data, self._order + kind, count, self._at)
        self._at += numbers.nbytes
        return numbers.astype(float).tolist()

    def row(self, element: _Element) -> list[list[float]]:
        """Read the next record: the numbers of each property."""
        return [
            self._take(item.kind, int(self._take(item.count_kind, 1)[0]) if item.count_kind else 1)
            for item in element.properties
        ]

    def table(self, element: _Element) -> NDArray[np.void] | None:
        """Read all records of `element` if every list in them has three numbers, else `None`."""
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


_READERS: dict[str, Callable[[bytes], Mesh]] = {".stl": _read_stl, ".obj": _read_obj, ".ply": _read_ply, ".off": _read_off}
MESH_SUFFIXES = tuple(_READERS)
"""Endings of mesh files that are read."""
