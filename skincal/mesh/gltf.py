"""Triangles of a glTF 2.0 file (`.glb`, or `.gltf` with everything in it): the meshes of its scene, each at its node.

Khronos, "glTF 2.0 Specification", 2021; `KHR_mesh_quantization`. Numbers in other files are refused, not opened: a scene and a
session keep one file of the part. Compressed geometry, bones, and extensions that place geometry are refused by their name: a
part must not lose a piece in silence. Points and lines have no surface and are skipped.

The axes are not turned from y up to z up: public robots with GLB files have the link's axes in them.
"""

from __future__ import annotations

import base64
import binascii
import struct
from collections.abc import Iterator
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray, cross_matrix
from skincal.mesh.file_numbers import decode_text
from skincal.mesh.findings import FindingKind, MeshFinding, count_finding, words_finding
from skincal.mesh.polygons import (
    MAX_PLACED_CORNERS,
    NO_POLYGONS,
    Polygons,
    check_matrix,
    cut_fan,
    cut_strip,
    join_by_points,
    place_polygons,
    triangles_of,
)
from skincal.model.given import parse_json

MAGIC, JSON_CHUNK, BINARY_CHUNK = b"glTF", 0x4E4F534A, 0x004E4942
SAVE_AS_GLB = "save it as GLB, which is one file"
_NUMBER_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_ACCESSOR_WIDTHS = {"SCALAR": 1, "VEC3": 3}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_HARMLESS_EXTENSIONS = (
    "KHR_materials_", "KHR_texture_", "KHR_lights_", "KHR_mesh_quantization", "KHR_xmp", "EXT_texture_", "MSFT_texture_",
)  # fmt: skip
"""Beginnings of names: extensions without geometry."""
_PLACING_EXTENSIONS = ("EXT_mesh_gpu_instancing",)


def read_gltf(data: bytes) -> Polygons:
    """Read a glTF file. Raises ValueError: it cannot be read, or not in full."""
    if not data:
        return NO_POLYGONS
    document, binary, findings = _open_glb(data) if data.startswith(MAGIC) else (_parse(decode_text(data)), None, ())
    findings = (*findings, words_finding(FindingKind.GLTF_AXES, ""))
    return place_polygons(_File(_typed(document), binary, len(data)).placed_meshes(), 1.0, findings)


def _open_glb(data: bytes) -> tuple[Any, bytes | None, tuple[MeshFinding, ...]]:
    if len(data) < 20:
        raise ValueError(f"{len(data)} bytes; at least 20 were expected")
    _, version, length = struct.unpack_from("<III", data)
    if version != 2:
        raise ValueError(f"it is glTF {version}; glTF 2 was expected: convert it")
    if length > len(data):
        raise ValueError(f"{len(data)} bytes; {length} were announced: it may be cut off")
    chunks: dict[int, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > length:
            raise ValueError(f"a part of {size} bytes is announced, and {length - at - 8} follow: it may be cut off")
        chunks.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    if JSON_CHUNK not in chunks:
        raise ValueError("it has no JSON part")
    after = len(data) - length
    findings = (count_finding(FindingKind.BYTES_AFTER_END, after),) if after else ()
    return _parse(chunks[JSON_CHUNK]), chunks.get(BINARY_CHUNK), findings


def _parse(text: bytes) -> Any:
    try:
        return parse_json(text)
    except ValueError as error:
        raise ValueError(f"its document is no JSON: {error}") from None


class _File:
    """A glTF document with its numbers."""

    def __init__(self, document: dict[str, Any], binary: bytes | None, size: int) -> None:
        self._document, self._binary, self._size = document, binary, size
        version = _entry(document, "asset").get("version", "")
        if not str(version).startswith("2"):
            raise ValueError(f"its version is {str(version)[:20]!r}; 2.0 was expected")
        for name in _list(document, "extensionsRequired"):
            if not str(name).startswith(_HARMLESS_EXTENSIONS):
                raise ValueError(f"it needs the extension {str(name)[:60]}, which is not read: export it without")
        self._buffers: dict[int, bytes] = {}
        self._meshes: dict[int, list[Polygons]] = {}
        self._positions: dict[int, FloatArray] = {}

    def placed_meshes(self) -> Iterator[tuple[Polygons, FloatArray]]:
        """List the triangles of the scene with their matrices, (4, 4)."""
        nodes = _list(self._document, "nodes")
        waiting = [(index, np.eye(4)) for index in reversed(self._roots(nodes))]
        seen: set[int] = set()
        while waiting:
            index, above = waiting.pop()
            if index in seen:
                raise ValueError(f"node {index} has several parents; a tree was expected")
            seen.add(index)
            node = self._item("nodes", index)
            extensions = _entry(node, "extensions")
            placing = [name for name in _PLACING_EXTENSIONS if name in extensions]
            if placing:
                raise ValueError(f"a node uses {placing[0]}, which is not read: export it without")
            matrix = above @ _node_matrix(node)
            if "mesh" in node:
                if "skin" in node:
                    raise ValueError("bones move a mesh (skin): apply them in the modelling program")
                yield from ((part, matrix) for part in self._parts(_whole(node, "mesh"), _list(node, "weights")))
            waiting += [(_index(child), matrix) for child in reversed(_list(node, "children"))]

    def _roots(self, nodes: list[Any]) -> list[int]:
        if _list(self._document, "scenes"):
            return [_index(node) for node in _list(self._item("scenes", _whole(self._document, "scene", 0)), "nodes")]
        children = {_index(child) for node in nodes if isinstance(node, dict) for child in _list(_typed(node), "children")}
        return [index for index in range(len(nodes)) if index not in children]

    def _item(self, key: str, index: int) -> dict[str, Any]:
        items = _list(self._document, key)
        if not 0 <= index < len(items):
            raise ValueError(f"{key} {index} is named, and there are {len(items)}")
        return _typed(items[index])

    def _parts(self, index: int, node_weights: list[Any]) -> list[Polygons]:
        """Read the parts of a mesh; each mesh is read once."""
        mesh = self._item("meshes", index)
        if any(weight != 0 for weight in (*node_weights, *_list(mesh, "weights"))):
            raise ValueError("blend shapes move it (weights): apply them in the modelling program")
        if index not in self._meshes:
            parts = [self._read_primitive(_typed(each)) for each in _list(mesh, "primitives")]
            self._meshes[index] = join_by_points([part for part in parts if part is not None])
        return self._meshes[index]

    def _points(self, index: int) -> FloatArray:
        """Read positions once: primitives of several materials share them."""
        if index not in self._positions:
            self._positions[index] = self._numbers(index, "VEC3").astype(float)
        return self._positions[index]

    def _read_primitive(self, primitive: dict[str, Any]) -> Polygons | None:
        mode = _whole(primitive, "mode", _TRIANGLES)
        if mode in range(_TRIANGLES):
            return None
        points = self._points(_whole(_entry(primitive, "attributes"), "POSITION"))
        corners: IntArray = np.arange(len(points))
        if "indices" in primitive:
            given = self._numbers(_whole(primitive, "indices"), "SCALAR")
            if given.dtype.kind != "u":
                raise ValueError("its indices are no whole numbers above 0")
            corners = given[:, 0].astype(np.int64)
        if mode == _TRIANGLES:
            if len(corners) % 3:
                raise ValueError(f"{len(corners)} corners do not make whole triangles")
        elif mode in (_STRIP, _FAN):
            corners = (cut_strip if mode == _STRIP else cut_fan)(corners)
        else:
            raise ValueError(f"mode {mode} of a primitive is unknown")
        return triangles_of(points, corners)

    def _numbers(self, index: int, kind: str) -> NDArray[Any]:
        """Read an accessor, (count, 1 or 3)."""
        accessor = self._item("accessors", index)
        if accessor.get("type") != kind:
            raise ValueError(f"accessor {index} is {str(accessor.get('type'))[:20]}; {kind} was expected")
        count, width = _whole(accessor, "count"), _ACCESSOR_WIDTHS[kind]
        if not 0 <= count <= MAX_PLACED_CORNERS:
            raise ValueError(f"accessor {index} announces {count} entries; at most {MAX_PLACED_CORNERS} were expected")
        number_type = _number_type(accessor)
        if "bufferView" in accessor:
            numbers = self._view(accessor, number_type, count, width).copy()
        elif "sparse" in accessor:
            # Zeros are not in the file. But a corner that counts is named by an index, which has a byte at least.
            if count > self._size:
                raise ValueError(f"accessor {index} announces {count} entries in a file of {self._size} bytes")
            numbers = np.zeros((count, width), number_type)
        else:
            raise ValueError(f"accessor {index} has no numbers; they may be compressed: export it without compression")
        if "sparse" in accessor:
            sparse = _entry(accessor, "sparse")
            indices, changed = _whole(sparse, "count"), _entry(sparse, "indices")
            places = self._view(changed, _number_type(changed), indices, 1)[:, 0].astype(np.int64)
            if places.size and (places.min() < 0 or places.max() >= count):
                raise ValueError(f"accessor {index} changes entry {places.max()} of {count}")
            numbers[places] = self._view(_entry(sparse, "values"), number_type, indices, width)
        if accessor.get("normalized") is True and number_type.kind in "iu":
            return np.maximum(numbers / float(np.iinfo(number_type).max), -1.0)
        return numbers

    def _view(self, given: dict[str, Any], number_type: np.dtype[Any], count: int, width: int) -> NDArray[Any]:
        view = self._item("bufferViews", _whole(given, "bufferView"))
        if _entry(view, "extensions"):
            raise ValueError("its numbers are compressed: export it without compression")
        buffer = self._buffer(_whole(view, "buffer"))
        begin, length = _whole(view, "byteOffset", 0), _whole(view, "byteLength")
        first, entry = _whole(given, "byteOffset", 0), number_type.itemsize * width
        stride = _whole(view, "byteStride", entry)
        end = first + (count - 1) * stride + entry if count > 0 else first
        if not (
            0 <= first <= end <= length and begin >= 0 and begin + length <= len(buffer) and stride >= entry and count >= 0
        ):
            raise ValueError(f"{count} entries of {entry} bytes are announced in {min(length, len(buffer))} bytes")
        return np.ndarray((count, width), number_type, buffer, begin + first, (stride, number_type.itemsize))

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            uri = self._item("buffers", index).get("uri")
            if uri is None:
                if index != 0 or self._binary is None:
                    raise ValueError(f"buffer {index} has no bytes")
                self._buffers[index] = self._binary
            else:
                self._buffers[index] = _decode_uri(str(uri))
        return self._buffers[index]


def _decode_uri(uri: str) -> bytes:
    head, comma, text = uri.partition(",")
    if not head.startswith("data:"):
        raise ValueError(f"its numbers are in another file ({uri[:80]}), which is not opened: {SAVE_AS_GLB}")
    if not comma or not head.endswith(";base64"):
        raise ValueError(f"its numbers are not in base64: {SAVE_AS_GLB}")
    try:
        return base64.b64decode(text, validate=True)
    except binascii.Error as error:
        raise ValueError(f"its numbers are no base64 ({error})") from None


def _number_type(entry: dict[str, Any]) -> np.dtype[Any]:
    kind = _whole(entry, "componentType")
    if kind not in _NUMBER_TYPES:
        raise ValueError(f"{kind} is no number type of glTF")
    return np.dtype(_NUMBER_TYPES[kind])


def _node_matrix(node: dict[str, Any]) -> FloatArray:
    if "matrix" in node:
        return check_matrix(_vector(node, "matrix", [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]).reshape(4, 4).T)
    matrix = np.eye(4)
    *axis, real = _vector(node, "rotation", [0, 0, 0, 1])
    length = float(np.linalg.norm([*axis, real]))
    if length == 0:
        raise ValueError("the rotation of a node is 0 0 0 0")
    cross = cross_matrix(np.array(axis) / length)
    rotation = np.eye(3) + 2 * real / length * cross + 2 * cross @ cross
    matrix[:3, :3] = rotation * _vector(node, "scale", [1, 1, 1])
    matrix[:3, 3] = _vector(node, "translation", [0, 0, 0])
    return matrix


def _vector(entry: dict[str, Any], key: str, default: list[float]) -> FloatArray:
    values = _list(entry, key) or default
    if len(values) != len(default) or not all(isinstance(value, int | float) for value in values):
        raise ValueError(f"{key} of a node is not {len(default)} numbers")
    return np.array(values, dtype=float)


def _typed(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError("an entry is no JSON object")
    return cast(dict[str, Any], value)


def _entry(entry: dict[str, Any], key: str) -> dict[str, Any]:
    return _typed(entry.get(key, {}))


def _list(entry: dict[str, Any], key: str) -> list[Any]:
    value = entry.get(key, [])
    if not isinstance(value, list):
        raise ValueError(f"{key} is no list")
    return cast(list[Any], value)


def _index(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"{str(value)[:20]!r} is no whole number")
    return value


def _whole(entry: dict[str, Any], key: str, default: int | None = None) -> int:
    if key not in entry:
        if default is None:
            raise ValueError(f"{key} is missing")
        return default
    return _index(entry[key])
