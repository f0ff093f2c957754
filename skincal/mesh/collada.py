"""Polygons of a COLLADA file (`.dae`): the geometries of its scene, each at the matrix of its nodes.

Khronos, "COLLADA - Digital Asset Schema Release 1.4.1" and "1.5.0", 2008. Triangles, polylists, polygons, strips and fans are
read, the unit of `<asset>`, and nodes within nodes with instances of them. Other files are never opened. Unknown geometry is
refused by its name: a part must not lose a piece in silence. Lines have no surface and are skipped.

The axes are not turned by `<up_axis>`. RViz, Gazebo and MoveIt do not turn them: the axes of a URDF's meshes are the link's.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, cross_matrix
from skincal.mesh.file_numbers import decode_text, is_utf16, parse_numbers, parse_wholes
from skincal.mesh.findings import FindingKind, count_finding, words_finding
from skincal.mesh.polygons import NO_POLYGONS, Polygons, check_matrix, cut_fan, cut_strip, join_by_points, place_polygons

MAX_NODES = 100_000
"""Nodes of a scene with all instances. A node that names another twice, and so on, has two to the power of its depth."""
MAX_XML_DEPTH = 1000
"""Elements within elements. A scene has a few dozen."""
FACE_TAGS = ("triangles", "polylist", "polygons", "tristrips", "trifans")
TAGS_WITHOUT_SURFACE = ("lines", "linestrips", "source", "vertices", "extra", "asset")
"""Elements of a mesh that have no surface."""


def read_collada(data: bytes) -> Polygons:
    """Read a COLLADA file. Raises ValueError: it cannot be read, or not in full."""
    if not data:
        return NO_POLYGONS
    file = _File(_parse_xml(data))
    unit, up = file.unit(), file.up_axis()
    findings = (words_finding(FindingKind.UP_AXIS, up[0].lower()),) if up in ("X_UP", "Y_UP") else ()
    if file.lacks_length():
        findings = (*findings, words_finding(FindingKind.UNIT_WITHOUT_LENGTH, "1 m"))
    polygons = place_polygons(file.placed_geometries(), unit, findings)
    if not file.short_lists:
        return polygons
    return polygons._replace(findings=(*findings, count_finding(FindingKind.SHORT_LISTS, file.short_lists)))


def _parse_xml(data: bytes) -> Element:
    """Parse XML with names without their prefixes."""

    def refuse_doctype(*_: object) -> None:
        raise ValueError("it has a document type (<!DOCTYPE>), which COLLADA does not need: remove it")

    depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_XML_DEPTH:
            raise ValueError(f"over {MAX_XML_DEPTH} elements within one another")
        builder.start(tag.rpartition(":")[2], attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag.rpartition(":")[2])

    # A text in UTF-16 is UTF-8 by now, in spite of its first line.
    parser, builder = expat.ParserCreate("utf-8" if is_utf16(data) else None), TreeBuilder()
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = refuse_doctype
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(decode_text(data), True)
    except (expat.ExpatError, LookupError) as error:
        raise ValueError(f"no XML: {error}") from None
    root = builder.close()
    if root.tag != "COLLADA":
        raise ValueError(f"its first element is {root.tag[:40]!r}; COLLADA was expected")
    return root


class _File:
    """Elements of a COLLADA file by their ids."""

    def __init__(self, root: Element) -> None:
        self._root = root
        self._by_id: dict[str, Element] = {}
        for element in root.iter():
            if element.get("id"):
                self._by_id.setdefault(element.get("id", ""), element)
        self._points: dict[int, FloatArray] = {}
        self.short_lists = 0
        """Elements that announce more faces than they have."""
        self._geometries: dict[int, list[Polygons]] = {}

    def unit(self) -> float:
        """Metres per unit."""
        unit = self._root.find("asset/unit")
        metres = 1.0 if unit is None else _metres(unit)
        if not 0 < metres < np.inf:
            raise ValueError(f"its unit is {metres:g} m; a length above 0 was expected")
        return metres

    def lacks_length(self) -> bool:
        """Whether the file names a unit without its length."""
        unit = self._root.find("asset/unit")
        return unit is not None and "meter" not in unit.attrib

    def up_axis(self) -> str:
        """`X_UP`, `Y_UP` or `Z_UP`; empty if the file does not say."""
        return (self._root.findtext("asset/up_axis") or "").strip()

    def placed_geometries(self) -> Iterator[tuple[Polygons, FloatArray]]:
        """List the polygons of the scene with their matrices, (4, 4)."""
        scene = self._root.find("scene/instance_visual_scene")
        top = self._root.find("library_visual_scenes/visual_scene") if scene is None else self._named(scene, "url")
        if top is None:
            for geometry in self._root.findall("library_geometries/geometry"):
                yield from ((part, np.eye(4)) for part in self._parts(geometry))
            return
        waiting, seen = [(node, np.eye(4)) for node in reversed(top.findall("node"))], 0
        while waiting:
            node, above = waiting.pop()
            with np.errstate(over="ignore", invalid="ignore"):
                matrix = above @ _node_matrix(node)
            for child in node:
                if child.tag == "instance_geometry":
                    seen += 1
                    yield from ((part, matrix) for part in self._parts(self._named(child, "url")))
                elif child.tag == "instance_controller":
                    raise ValueError("bones or blend shapes move it (instance_controller): apply them in the modelling program")
            below = [each if each.tag == "node" else self._named(each, "url") for each in node if _is_node(each)]
            seen += len(below)
            if seen > MAX_NODES:
                raise ValueError(f"its scene has over {MAX_NODES} nodes: a node names others many times, geometries, or itself")
            waiting += [(each, matrix) for each in reversed(below)]

    def _named(self, element: Element, attribute: str) -> Element:
        url = element.get(attribute, "").strip()
        if url == "#":
            raise ValueError(f"{element.tag} names nothing ({url!r})")
        if not url.startswith("#"):
            raise ValueError(f"{element.tag} names {url[:80]!r}, which is not in this file: save all in one file")
        if url[1:] not in self._by_id:
            raise ValueError(f"{element.tag} names {url[:80]}, which is missing")
        return self._by_id[url[1:]]

    def _parts(self, geometry: Element) -> list[Polygons]:
        """Read the polygons of a geometry; each geometry is read once."""
        if id(geometry) not in self._geometries:
            mesh = geometry.find("mesh")
            if mesh is None:
                kinds = ", ".join(child.tag[:40] for child in geometry) or "nothing"
                raise ValueError(f"a geometry is {kinds}; mesh was expected: convert it to polygons")
            unknown = [child.tag for child in mesh if child.tag not in (*FACE_TAGS, *TAGS_WITHOUT_SURFACE)]
            if unknown:
                raise ValueError(f"a mesh has {unknown[0][:40]}, which is not read: export triangles")
            own = geometry.find("asset/unit")
            if own is not None and _metres(own) != self.unit():
                raise ValueError("a geometry has a unit of its own (asset), which is not read: export it in the file's unit")
            self._geometries[id(geometry)] = join_by_points(
                [self._read_faces(child) for child in mesh if child.tag in FACE_TAGS]
            )
        return self._geometries[id(geometry)]

    def _read_faces(self, faces: Element) -> Polygons:
        if faces.find("ph") is not None:
            raise ValueError("its polygons have holes (ph), which are not read: export triangles")
        inputs = faces.findall("input")
        offsets = parse_wholes([each.get("offset", "0").encode() for each in inputs])
        if len(inputs) == 0 or offsets.min() < 0:
            raise ValueError(f"{faces.tag} without an input")
        at, points = next(
            ((offset, each) for offset, each in zip(offsets.tolist(), inputs, strict=True) if _is_position(each)), (0, None)
        )
        if points is None:
            raise ValueError(f"{faces.tag} without vertices")
        width = int(offsets.max()) + 1
        lists = [_rows(parse_wholes(_words(each)), width)[:, at] for each in faces.findall("p")]
        corners = np.concatenate(lists) if lists else NO_POLYGONS.corners
        if faces.tag == "triangles":
            sizes = np.full(len(_rows(corners, 3)), 3)
        elif faces.tag == "polylist":
            counts = faces.find("vcount")
            sizes = NO_POLYGONS.sizes if counts is None else parse_wholes(_words(counts))
            if sizes.sum() != len(corners):
                raise ValueError(f"a polylist has {len(corners)} corners; its vcount says {sizes.sum()}")
        elif faces.tag == "polygons":
            sizes = np.array([len(each) for each in lists], dtype=np.int64)
        else:
            cut = cut_strip if faces.tag == "tristrips" else cut_fan
            triangles = np.concatenate([np.empty((0, 3), dtype=np.int64), *map(cut, lists)])
            corners, sizes = triangles.ravel(), np.full(len(triangles), 3)
        (announced,) = parse_wholes([faces.get("count", "0").encode()])
        found = len(lists) if faces.tag in ("tristrips", "trifans") else len(sizes)
        self.short_lists += int(announced > found)
        return Polygons(self._points_of(self._named(points, "source")), corners, sizes)

    def _points_of(self, source: Element) -> FloatArray:
        """Read points once: faces of several materials share them."""
        if id(source) not in self._points:
            self._points[id(source)] = self._read_points(source)
        return self._points[id(source)]

    def _read_points(self, source: Element) -> FloatArray:
        if source.tag == "vertices":
            inputs = [each for each in source.findall("input") if each.get("semantic") == "POSITION"]
            if not inputs:
                raise ValueError("vertices without positions")
            source = self._named(inputs[0], "source")
        accessor, array = source.find("technique_common/accessor"), source.find("float_array")
        if accessor is None:
            return _rows(parse_numbers(_words(array)), 3)
        if accessor.get("source", "").strip():
            array = self._named(accessor, "source")
        numbers = parse_numbers(_words(array))
        count, stride, offset = parse_wholes(
            [accessor.get(key, default).encode() for key, default in _ACCESSOR_DEFAULTS]
        ).tolist()
        names = [param.get("name", "").upper() for param in accessor.findall("param")]
        columns = [names.index(axis) for axis in "XYZ"] if {"X", "Y", "Z"} <= set(names) else [0, 1, 2]
        if not (offset >= 0 and max(columns) < stride <= 1000 and 0 <= count <= (len(numbers) - offset) // stride):
            raise ValueError(f"{len(numbers)} numbers do not hold {count} points of {stride} numbers")
        return numbers[offset : offset + count * stride].reshape(count, stride)[:, columns]


Number = TypeVar("Number", np.float64, np.int64)
_ACCESSOR_DEFAULTS = (("count", "0"), ("stride", "1"), ("offset", "0"))


def _metres(unit: Element) -> float:
    """Read the length of a unit; 1 m without one."""
    (metres,) = parse_numbers([unit.get("meter", "1").strip().encode()])
    return float(metres)


def _is_position(given: Element) -> bool:
    return given.get("semantic") in ("VERTEX", "POSITION")


def _is_node(element: Element) -> bool:
    return element.tag in ("node", "instance_node")


def _words(element: Element | None) -> list[bytes]:
    return [] if element is None else (element.text or "").encode().split()


def _rows(numbers: NDArray[Number], width: int) -> NDArray[Number]:
    if len(numbers) % width:
        raise ValueError(f"{len(numbers)} numbers; a multiple of {width} was expected")
    return numbers.reshape(-1, width)


_TRANSFORM_NUMBERS = {"matrix": 16, "translate": 3, "rotate": 4, "scale": 3, "lookat": 9, "skew": 7}


def _node_matrix(node: Element) -> FloatArray:
    """Multiply the transforms of a node, (4, 4): the first is applied last."""
    matrix = np.eye(4)
    for step in node:
        if step.tag not in _TRANSFORM_NUMBERS:
            continue
        numbers = parse_numbers(_words(step))
        if len(numbers) != _TRANSFORM_NUMBERS[step.tag] or not np.isfinite(numbers).all():
            raise ValueError(f"{step.tag} of a node has {len(numbers)} numbers; {_TRANSFORM_NUMBERS[step.tag]} were expected")
        each = np.eye(4)
        if step.tag == "matrix":
            each = check_matrix(numbers.reshape(4, 4))
        elif step.tag == "translate":
            each[:3, 3] = numbers
        elif step.tag == "scale":
            each[[0, 1, 2], [0, 1, 2]] = numbers
        elif step.tag == "rotate":
            each[:3, :3] = _rotation(numbers[:3], float(np.radians(numbers[3])))
        else:
            raise ValueError(f"a node is placed by {step.tag}, which is not read: export a matrix")
        matrix = matrix @ each
    return matrix


def _rotation(axis: FloatArray, angle: float) -> FloatArray:
    length = float(np.linalg.norm(axis))
    if length == 0:
        return np.eye(3)
    cross = cross_matrix(axis / length)
    turned: FloatArray = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)
    return turned
