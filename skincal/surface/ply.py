"""Vertices and polygons of a PLY file, ASCII or binary.

Source: G. Turk, "The PLY polygon file format", 1994. Elements other than `vertex` and `face` are stepped over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry.arrays import FloatArray, IntArray

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_FACE_LISTS = ("vertex_indices", "vertex_index")


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


def read_ply(data: bytes) -> tuple[FloatArray, IntArray | list[list[int]]]:
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
            vertices = _vertices(element, cursor)
        elif element.name == "face":
            polygons = _faces(element, cursor)
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


def _vertices(element: _Element, cursor: _Words | _Bytes) -> FloatArray:
    table = cursor.table(element, _triangle_dtype(element))
    if table is None:
        raise ValueError(f"the file ends before its {element.count} vertices")
    return table[:, [_column(element, axis) for axis in "xyz"]]


def _faces(element: _Element, cursor: _Words | _Bytes) -> IntArray | list[list[int]]:
    named = [item.name for item in element.properties if item.name in _FACE_LISTS and item.count_kind]
    if not named:
        raise ValueError("faces without vertex_indices; triangle strips are not read")
    table = cursor.table(element, _triangle_dtype(element))
    if table is not None:
        at = _column(element, named[0])
        return table[:, at : at + 3].astype(np.int64)
    place = [item.name for item in element.properties].index(named[0])
    return [[int(index) for index in cursor.row(element)[place]] for _ in range(element.count)]
