"""Corners and faces of a mesh file: STL (binary, ASCII), OBJ, PLY, OFF.

Own small readers, since importing a mesh library costs longer than reading the mesh (trimesh with scipy: about a
second, most of it holding the interpreter's lock). Only geometry is read; polygons are cut into fans of triangles.
Nothing is merged, dropped or repaired here.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from skincal.geometry.arrays import FloatArray, IntArray
from skincal.model.errors import InputError
from skincal.surface.ply import read_ply

Mesh = tuple[FloatArray, IntArray]
"""Vertices (nv, 3) in the file's unit, triangles (nt, 3)."""

_STL_HEADER = 84
_STL_RECORD = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_mesh(path: Path, data: bytes) -> Mesh:
    """Read the vertices and triangles in a mesh file's bytes.

    Parameters
    ----------
    path : the file's name; its suffix tells the format
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
    vertices, polygons = read_ply(data)
    if isinstance(polygons, np.ndarray):
        return vertices, polygons
    return vertices, fan([corner for polygon in polygons for corner in polygon], [len(polygon) for polygon in polygons])


_READERS: dict[str, Callable[[bytes], Mesh]] = {
    ".stl": _read_stl,
    ".obj": _read_obj,
    ".ply": _read_ply_mesh,
    ".off": _read_off,
}
