"""Vertices and faces of a mesh file: STL (binary, ASCII), OBJ, PLY, OFF; COLLADA and glTF by their own modules.

Own small readers: a mesh library takes longer to import than the mesh to read, and loses damage without a word
(docs/decisions/mesh-readers.md). Only geometry is read. Nothing is repaired here.

PLY: G. Turk, "The PLY polygon file format", 1994; elements other than `vertex` and `face` are skipped.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray
from skincal.mesh.file_numbers import decode_text, drop_mark, parse_numbers, parse_whole, parse_wholes, show_word
from skincal.mesh.findings import FindingKind, MeshFinding, count_finding, words_finding
from skincal.mesh.polygons import NO_POLYGONS, Polygons, check_corners, cut_polygons, polygons_of, triangles_of
from skincal.model.errors import InputError


@dataclass(frozen=True, slots=True, eq=False)
class FileMesh:
    """Mesh as a file has it."""

    vertices: FloatArray
    """(nv, 3) float, in the file's unit."""
    triangles: IntArray
    """(nt, 3) int."""
    findings: tuple[MeshFinding, ...] = ()
    """Remarks about the file."""
    unit: float | None = None
    """Metres per unit; `None` if the format names none."""

    @property
    def points(self) -> FloatArray:
        """(nv, 3) float, in metres if the file names its unit."""
        return self.vertices * (1.0 if self.unit is None else self.unit)


_STL_HEADER_BYTES = 84
_STL_RECORD = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_BYTE_ORDER_OF_PLY_FORMAT = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_FACE_LISTS = ("vertex_indices", "vertex_index")
_COMMENT_PATTERN = re.compile(rb"#[^\r\n]*")
OFF_KINDS = rb"(ST|C|N)*OFF"
"""First word of OFF files whose lines begin with three coordinates; texture, colours and normals follow them."""


def read_mesh(path: Path, data: bytes) -> FileMesh:
    """Read a mesh file's bytes; the suffix of `path` names the format.

    Raises InputError: the suffix is unknown, or the content is not of that format.
    """
    reader = reader_of(path)
    try:
        read = reader(data)
        check_corners(read)
        if read.sizes.min(initial=3) < 3:
            raise ValueError(f"a face with {read.sizes.min()} corners")
    except (ValueError, IndexError, KeyError, OverflowError) as error:
        raise InputError(f"{path}: not a readable {path.suffix[1:].upper()} mesh ({error}); export the mesh again.") from None
    cut = cut_polygons(read.vertices, read.corners, read.sizes)
    counts = {FindingKind.NOT_FLAT: cut.not_flat, FindingKind.CROSSING: cut.crossing, FindingKind.TOO_LARGE: cut.too_large}
    found = (count_finding(kind, count) for kind, count in counts.items() if count)
    return FileMesh(read.vertices, cut.triangles, (*read.findings, *found), read.unit)


def reader_of(path: Path) -> Callable[[bytes], Polygons]:
    """Find the reader for a suffix. Raises InputError: it is unknown."""
    reader = _READER_OF_SUFFIX.get(path.suffix.lower())
    if reader is None:
        known = ", ".join(_READER_OF_SUFFIX)
        raise InputError(f"{path}: the suffix {path.suffix or '(none)'!r} is not a mesh format read here; expected {known}.")
    return reader


def _read_stl(data: bytes) -> Polygons:
    count = int.from_bytes(data[80:_STL_HEADER_BYTES], "little") if len(data) >= _STL_HEADER_BYTES else -1
    after = len(data) - _STL_HEADER_BYTES - count * _STL_RECORD.itemsize
    # By the size and not by the first word: there are binary files that begin with "solid". The count of a text is enormous.
    if count >= 0 and after >= 0:
        if count == 0 and after >= _STL_RECORD.itemsize:
            raise ValueError(f"no triangle is announced, and {after} bytes follow")
        corners = np.frombuffer(data, _STL_RECORD, count, _STL_HEADER_BYTES)["corners"].astype(float).reshape(-1, 3)
        return _soup(corners, (count_finding(FindingKind.BYTES_AFTER_END, after),) if after else ())
    if not data:
        return NO_POLYGONS
    text = decode_text(data).lstrip()
    if text[:5].lower() != b"solid":
        raise ValueError(f"{len(data)} bytes; {len(data) - after} expected for the {max(count, 0)} triangles announced")
    words = re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", text, re.IGNORECASE)
    corners = parse_numbers([word for point in words for word in point]).reshape(-1, 3)
    loops = len(re.findall(rb"\bendloop\b", text, re.IGNORECASE))
    if len(corners) != 3 * loops:
        raise ValueError(f"{len(corners)} corners in {loops} triangles")
    begins, ends = (
        len(re.findall(rb"^\s*" + word + rb"\b", text, re.IGNORECASE | re.MULTILINE)) for word in (b"solid", b"endsolid")
    )
    return _soup(corners, () if ends >= begins or not loops else (words_finding(FindingKind.NO_END, ""),))


def _soup(corners: FloatArray, findings: tuple[MeshFinding, ...]) -> Polygons:
    return triangles_of(corners, np.arange(len(corners)), findings)


def _coordinates(words: list[bytes]) -> list[bytes]:
    # A fourth number (w), colours or a normal may follow.
    if len(words) < 3:
        raise ValueError("a vertex with fewer than 3 numbers")
    return words[:3]


def _read_obj(data: bytes) -> Polygons:
    points: list[bytes] = []
    indices: list[bytes] = []
    sizes: list[int] = []
    known: list[int] = []
    """Vertices before each face."""
    # Comments first: a folder at the end of one may end with the sign that continues a line.
    text = _COMMENT_PATTERN.sub(b"", decode_text(data)).replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    for line in text.splitlines():
        words = line.split()
        if words and words[0] == b"v":
            points += _coordinates(words[1:])
        elif words and words[0] == b"f":
            known.append(len(points) // 3)
            sizes.append(len(words) - 1)
            indices += [word.partition(b"/")[0] for word in words[1:]] if b"/" in line else words[1:]
    if data and not points and not sizes:
        raise ValueError("no line starts with v or f")
    vertices, named = parse_numbers(points).reshape(-1, 3), parse_wholes(indices)
    if not named.all():
        raise ValueError("a face names vertex 0, and OBJ counts from 1")
    # Indices count from 1; a negative one counts back from the last vertex read so far.
    counts = np.array(sizes, dtype=np.int64)
    corners = np.where(named > 0, named - 1, np.repeat(np.array(known, dtype=np.int64), counts) + named)
    return Polygons(vertices, corners, counts)


def _read_off(data: bytes) -> Polygons:
    lines = [line for line in _COMMENT_PATTERN.sub(b"", decode_text(data)).splitlines() if line.strip()]
    if not lines:
        return NO_POLYGONS
    kind, rest = [*lines[0].split(None, 1), b""][:2]
    if not re.fullmatch(OFF_KINDS, kind):
        raise ValueError(f"the first word is {show_word(kind)!r}; OFF was expected, with or without ST, C and N before it")
    if rest.split()[:1] == [b"BINARY"]:
        raise ValueError("it is binary; OFF in text was expected")
    # The counts may stand on the line of the first word.
    lines = [*([rest] if rest.strip() else []), *lines[1:]]
    vertex_count, face_count = (parse_whole(word) for word in [*lines[0].split(), b"", b""][:2])
    if min(vertex_count, face_count) < 0 or len(lines) < 1 + vertex_count + face_count:
        raise ValueError(f"{len(lines) - 1} lines; {vertex_count} vertices and {face_count} faces announced")
    points: list[bytes] = []
    for line in lines[1 : 1 + vertex_count]:
        points += _coordinates(line.split())
    corners: list[bytes] = []
    sizes: list[int] = []
    for line in lines[1 + vertex_count : 1 + vertex_count + face_count]:
        words = line.split()
        size = parse_whole(words[0])
        if len(words) <= size:
            raise ValueError(f"a face of {size} corners with {len(words) - 1} indices")
        corners += words[1 : 1 + size]
        sizes.append(size)
    return Polygons(parse_numbers(points).reshape(-1, 3), parse_wholes(corners), np.array(sizes, dtype=np.int64))


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


def _read_ply(data: bytes) -> Polygons:
    if not data:
        return NO_POLYGONS
    elements, body = _read_header(data)
    vertices, faces = NO_POLYGONS.vertices, NO_POLYGONS
    for element in elements:
        # Each record has at least a byte: a larger count is wrong.
        if not 0 <= element.count <= (body.remaining_bytes if element.properties else 0):
            raise ValueError(f"{element.count} records of {element.name!r} announced in {body.remaining_bytes} bytes")
        if element.name == "vertex":
            records = body.table(element)
            if records is None:
                raise ValueError(f"the file ends before its {element.count} vertices")
            missing = [axis for axis in "xyz" if axis not in (records.dtype.names or ())]
            if missing:
                raise ValueError(f"its vertices have no {missing[0]}")
            vertices = np.stack([records[axis][:, 0] for axis in "xyz"]).astype(float).T
        elif element.name == "face":
            faces = _ply_faces(element, body)
        else:
            for _ in range(element.count):
                body.row(element)
    return faces._replace(vertices=vertices)


def _read_header(data: bytes) -> tuple[list[_Element], _Body]:
    head, mark, body = drop_mark(data).partition(b"end_header")
    # Latin-1 takes every byte: comments in the header come in any encoding.
    lines = [line.split() for line in head.decode("latin-1").splitlines()]
    if not mark or not lines or lines[0] != ["ply"]:
        raise ValueError("no PLY header")
    order, types, elements = "", dict.fromkeys(_TYPES, "f8"), list[_Element]()
    for words in lines[1:]:
        kinds = [word for word in words[1:-1] if word != "list"] if words[:1] == ["property"] else []
        if unknown := [kind for kind in kinds if kind not in _TYPES]:
            raise ValueError(f"{unknown[0][:20]!r} is no number type of PLY")
        if kinds and not elements:
            raise ValueError("a property comes before the first element")
        match words:
            case ["format", name, _] if name not in _BYTE_ORDER_OF_PLY_FORMAT:
                raise ValueError(f"the format {name[:30]!r} is not one of {', '.join(_BYTE_ORDER_OF_PLY_FORMAT)}")
            case ["format", name, _]:
                order = _BYTE_ORDER_OF_PLY_FORMAT[name]
                types = _TYPES if order else types
            case ["element", name, count]:
                elements.append(_Element(name, parse_whole(count.encode()), []))
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
    return elements, _Body(parse_numbers(decode_text(body).split()).astype("<f8").tobytes(), "<")


class _Body:
    """Reader of a PLY body, record by record, or an element at once if its records have one size."""

    def __init__(self, data: bytes, order: str) -> None:
        self._data, self._order = data, order
        self._at = 0

    @property
    def remaining_bytes(self) -> int:
        """Unread bytes."""
        return len(self._data) - self._at

    def _read_numbers(self, kind: str, count: int) -> list[float]:
        if not 0 <= count <= self.remaining_bytes // np.dtype(kind).itemsize:
            raise ValueError(f"{count} numbers are announced, and {self.remaining_bytes} bytes follow: it may be cut off")
        numbers = np.frombuffer(self._data, self._order + kind, count, self._at)
        self._at += numbers.nbytes
        return numbers.astype(float).tolist()

    def row(self, element: _Element) -> list[list[float]]:
        """Read the next record: the numbers of each property."""
        return [
            self._read_numbers(item.kind, self._read_count(item.count_kind) if item.count_kind else 1)
            for item in element.properties
        ]

    def _read_count(self, kind: str) -> int:
        return int(_whole_numbers(np.array(self._read_numbers(kind, 1)))[0])

    def table(self, element: _Element) -> NDArray[np.void] | None:
        """Read all records of `element` if every list in them has three numbers, else `None`."""
        parts: list[tuple[str, str, tuple[int, ...]]] = []
        for item in element.properties:
            if item.count_kind:
                parts.append((f"{item.name} length", self._order + item.count_kind, (1,)))
            parts.append((item.name, self._order + item.kind, (3 if item.count_kind else 1,)))
        dtype = np.dtype(parts)
        if self.remaining_bytes < element.count * dtype.itemsize:
            return None
        records = np.frombuffer(self._data, dtype, element.count, self._at)
        if not all((records[name] == 3).all() for name, _, _ in parts if name.endswith(" length")):
            return None
        self._at += records.nbytes
        return records


def _whole_numbers(numbers: NDArray[Any]) -> IntArray:
    """Convert indices. Raises ValueError: one is no whole number."""
    # NaN and numbers beyond the range become some other number.
    with np.errstate(invalid="ignore"):
        whole = numbers.astype(np.int64)
    if (whole != numbers).any():
        raise ValueError(f"a face names vertex {float(numbers[whole != numbers][0]):g}; a whole number was expected")
    return whole


def _ply_faces(element: _Element, body: _Body) -> Polygons:
    names = [item.name if item.count_kind else "" for item in element.properties]
    named = next((name for name in names if name in _FACE_LISTS), None)
    if named is None:
        raise ValueError("faces without vertex_indices; triangle strips are not read")
    records = body.table(element)
    if records is not None:
        return triangles_of(NO_POLYGONS.vertices, _whole_numbers(records[named]))
    place = names.index(named)
    polygons = [_whole_numbers(np.array(body.row(element)[place])).tolist() for _ in range(element.count)]
    corners = [corner for polygon in polygons for corner in polygon]
    return polygons_of(NO_POLYGONS.vertices, corners, [len(polygon) for polygon in polygons])


def _read_dae(data: bytes) -> Polygons:
    from skincal.mesh.collada import read_collada  # most parts have a mesh in another format

    return read_collada(data)


def _read_glb(data: bytes) -> Polygons:
    from skincal.mesh.gltf import read_gltf

    return read_gltf(data)


_READER_OF_SUFFIX: dict[str, Callable[[bytes], Polygons]] = {
    ".stl": _read_stl, ".obj": _read_obj, ".ply": _read_ply, ".off": _read_off,
    ".dae": _read_dae, ".glb": _read_glb, ".gltf": _read_glb,
}  # fmt: skip
SUFFIXES_WITH_UNIT = (".dae", ".glb", ".gltf")
"""Endings of files that name their unit."""
MESH_SUFFIXES = tuple(_READER_OF_SUFFIX)
"""Endings of mesh files that are read."""
