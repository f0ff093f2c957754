"""Corners and faces of a mesh file: STL (binary, ASCII), OBJ, PLY, OFF.

Own small readers, since importing a mesh library costs longer than reading the mesh (trimesh with scipy: about a
second, most of it holding the interpreter's lock). Only geometry is read; polygons are cut into fans of triangles.
Nothing is merged, dropped or repaired here.

PLY: G. Turk, "The PLY polygon file format", 1994; elements other than `vertex` and `face` are stepped over.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skincal.geometry.arrays import FloatArray, IntArray
from skincal.model.errors import InputError

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


def read_mesh(path: Path, data: bytes) -> Mesh:
    """Read the vertices and triangles in a mesh file's bytes.

    Parameters
    ----------
    path : the file's name; its suffix names the format
    data : the file's content

    Returns
    -------
    vertices : (nv, 3) float, the file's unit
    triangles : (nt, 3) int, indices in range

    Raises
    ------
    InputError
        The suffix is not known, or the content is not of that format.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        known = ", ".join(_READERS)
        raise InputError(f"{path}: the suffix {path.suffix or '(none)'!r} is not a mesh format read here; expected {known}.")
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


def fan(corners: Sequence[int], sizes: Sequence[int]) -> IntArray:
    """Cut polygons into fans of triangles.

    Parameters
    ----------
    corners : the vertices of all polygons, one after the other
    sizes : number of vertices of each polygon

    Returns
    -------
    (nt, 3) int, in the order of the polygons
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
    if count >= 0 and len(data) == size:
        corners = np.frombuffer(data, _STL_RECORD, count, _STL_HEADER)["corners"].astype(float).reshape(-1, 3)
    elif data.lstrip()[:5].lower() == b"solid":
        words = re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", data)
        corners = np.array(words).astype(float).reshape(-1, 3)
        if len(corners) % 3:
            raise ValueError(f"{len(corners)} corners do not make whole triangles")
    elif not data:
        corners = np.empty((0, 3))
    else:
        raise ValueError(f"{len(data)} bytes; {size} expected for the {count} triangles announced")
    return corners, np.arange(len(corners)).reshape(-1, 3)


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
    for line in data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
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
    return _vertices(points), fan(corners, sizes)


def _read_off(data: bytes) -> Mesh:
    lines = [line for line in re.sub(rb"#[^\n]*", b"", data).splitlines() if line.strip()]
    if not lines:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    if lines[0].split()[0] != b"OFF":
        raise ValueError("the first word is not OFF")
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
    return _vertices(points), fan(corners, sizes)


def _read_ply_mesh(data: bytes) -> Mesh:
    vertices, polygons = _read_ply(data)
    if isinstance(polygons, np.ndarray):
        return vertices, polygons
    return vertices, fan([corner for polygon in polygons for corner in polygon], [len(polygon) for polygon in polygons])


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


def _read_ply(data: bytes) -> tuple[FloatArray, IntArray | list[list[int]]]:
    """Read vertices (nv, 3) and faces: (nt, 3) where all are triangles, else a list of polygons.

    Raises
    ------
    ValueError, KeyError, IndexError
        The content is not a PLY file of polygons.
    """
    if not data:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    order, elements, body = _read_header(data)
    cursor = _Words(body) if order == "" else _Bytes(body, order)
    vertices, faces = np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    polygons: IntArray | list[list[int]] = faces
    for element in elements:
        if element.name == "vertex":
            vertices = _ply_vertices(element, cursor)
        elif element.name == "face":
            polygons = _ply_faces(element, cursor)
        else:
            for _ in range(element.count):
                cursor.row(element)
    return vertices, polygons


def _read_header(data: bytes) -> tuple[str, list[_Element], bytes]:
    head, mark, body = data.partition(b"end_header")
    lines = [line.split() for line in head.decode("latin-1").splitlines()]
    if not mark or not lines or lines[0] != ["ply"]:
        raise ValueError("no PLY header")
    order, elements = "", list[_Element]()
    for words in lines[1:]:
        match words:
            case ["format", name, _]:
                order = _ORDERS[name]
            case ["element", name, count]:
                elements.append(_Element(name, int(count), []))
            case ["property", "list", count_kind, kind, name]:
                elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[count_kind]))
            case ["property", kind, name]:
                elements[-1].properties.append(_Property(name, _TYPES[kind], ""))
            case _:
                continue
    return order, elements, body[2:] if body[:2] == b"\r\n" else body[1:]


class _Words:
    """Reads an ASCII body word by word."""

    def __init__(self, body: bytes) -> None:
        self.words = body.split()
        self.at = 0

    def row(self, element: _Element) -> list[list[float]]:
        """Return the next record: for each property its numbers."""
        record: list[list[float]] = []
        for item in element.properties:
            count = 1
            if item.count_kind:
                count = int(self.words[self.at])
                self.at += 1
            record.append([float(word) for word in self.words[self.at : self.at + count]])
            if count < 0 or len(record[-1]) < count:
                raise ValueError("the file ends early")
            self.at += count
        return record

    def table(self, element: _Element, dtype: np.dtype[np.void]) -> FloatArray | None:
        """Return `element` as (count, numbers) where each record has as many words as `dtype` has numbers, else None."""
        width = sum(int(np.prod(dtype[name].shape)) for name in dtype.names or ())
        words = self.words[self.at : self.at + element.count * width]
        if len(words) < element.count * width:
            return None
        table = np.array(words, dtype="S").astype(float).reshape(element.count, width)
        if not _lengths_fit(element, dtype, table):
            return None
        self.at += element.count * width
        return table


class _Bytes:
    """Reads a binary body record by record, or an element at once where its records have one size."""

    def __init__(self, body: bytes, order: str) -> None:
        self.body = body
        self.order = order
        self.at = 0

    def _take(self, kind: str, count: int) -> list[float]:
        numbers = np.frombuffer(self.body, self.order + kind, count, self.at)
        self.at += numbers.nbytes
        return [float(number) for number in numbers]

    def row(self, element: _Element) -> list[list[float]]:
        """Return the next record: for each property its numbers."""
        record: list[list[float]] = []
        for item in element.properties:
            count = int(self._take(item.count_kind, 1)[0]) if item.count_kind else 1
            record.append(self._take(item.kind, count))
        return record

    def table(self, element: _Element, dtype: np.dtype[np.void]) -> FloatArray | None:
        """Return `element` as (count, numbers) where each record has the size of `dtype`, else None."""
        dtype = dtype.newbyteorder("<" if self.order == "<" else ">")
        if len(self.body) - self.at < element.count * dtype.itemsize:
            return None
        records = np.frombuffer(self.body, dtype, element.count, self.at)
        columns = [records[name].astype(float).reshape(element.count, -1) for name in dtype.names or ()]
        table = np.concatenate(columns, axis=1)
        if not _lengths_fit(element, dtype, table):
            return None
        self.at += element.count * dtype.itemsize
        return table


def _triangle_dtype(element: _Element) -> np.dtype[np.void]:
    """Return the record of `element` if every list in it has three numbers."""
    parts: list[tuple[str, str, tuple[int, ...]]] = []
    for item in element.properties:
        if item.count_kind:
            parts.append((f"{item.name} length", item.count_kind, (1,)))
        parts.append((item.name, item.kind, (3,) if item.count_kind else (1,)))
    return np.dtype(parts)


def _column(element: _Element, name: str) -> int:
    """Return the first column of property `name` in the table of `element` with lists of three."""
    at = 0
    for item in element.properties:
        at += 1 if item.count_kind else 0
        if item.name == name:
            return at
        at += 3 if item.count_kind else 1
    raise ValueError(f"no property {name}")


def _lengths_fit(element: _Element, dtype: np.dtype[np.void], table: FloatArray) -> bool:
    lists = [item.name for item in element.properties if item.count_kind]
    return all(bool((table[:, _column(element, name) - 1] == 3).all()) for name in lists) and dtype.names is not None


def _ply_vertices(element: _Element, cursor: _Words | _Bytes) -> FloatArray:
    table = cursor.table(element, _triangle_dtype(element))
    if table is None:
        raise ValueError(f"the file ends before its {element.count} vertices")
    return table[:, [_column(element, axis) for axis in "xyz"]]


def _ply_faces(element: _Element, cursor: _Words | _Bytes) -> IntArray | list[list[int]]:
    named = [item.name for item in element.properties if item.name in _FACE_LISTS and item.count_kind]
    if not named:
        raise ValueError("faces without vertex_indices; triangle strips are not read")
    table = cursor.table(element, _triangle_dtype(element))
    if table is not None:
        at = _column(element, named[0])
        return table[:, at : at + 3].astype(np.int64)
    place = [item.name for item in element.properties].index(named[0])
    return [[int(index) for index in cursor.row(element)[place]] for _ in range(element.count)]


_READERS: dict[str, Callable[[bytes], Mesh]] = {
    ".stl": _read_stl,
    ".obj": _read_obj,
    ".ply": _read_ply_mesh,
    ".off": _read_off,
}
