"""glTF: files by trimesh and by hand; truth by the numbers that were written."""

import base64
import json
import re
import struct

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from test_load import box_mesh, load, tube_mesh

from skincal.mesh.findings import FindingKind
from skincal.mesh.readers import read_mesh
from skincal.model.errors import InputError
from tests.approved import approved

POINTS = np.array([(0, 0, 0), (40, 0, 0), (40, 40, 0), (0, 40, 0)], dtype="<f4")
CORNERS = np.array([0, 1, 2, 0, 2, 3], dtype="<u2")


def document(points=POINTS, corners=CORNERS, **changes):
    """Describe two arrays and a mesh; also return their bytes."""
    body = points.tobytes() + corners.tobytes()
    types = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
    entry = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": types[points.dtype.str[1:]], "count": len(points), "type": "VEC3"},
            {"bufferView": 1, "componentType": types[corners.dtype.str[1:]], "count": len(corners), "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": points.nbytes},
            {"buffer": 0, "byteOffset": points.nbytes, "byteLength": corners.nbytes},
        ],
        "buffers": [{"byteLength": len(body)}],
    }  # fmt: skip
    return {**entry, **changes}, body


def glb(entry, body):
    text = json.dumps(entry).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(body), 0x004E4942) + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def read(tmp_path, entry, body):
    return read_mesh(tmp_path / "a.glb", glb(entry, body))


def test_a_glb_of_another_program_is_in_metres_and_its_axes_are_reported(tmp_path):
    vertices, triangles = tube_mesh()
    data = trimesh.Trimesh(vertices * 1e-3, triangles, process=False).export(file_type="glb")
    surface, found = load(tmp_path, data, "part.glb", scale=1.0)
    np.testing.assert_allclose(surface.corners, (vertices * 1e-3)[triangles], atol=1e-8)
    assert "unit m)" in found[FindingKind.SIZE].sentence
    assert found[FindingKind.GLTF_AXES].sentence == approved("mesh.gltf_axes")
    assert set(found) == {FindingKind.SIZE, FindingKind.GLTF_AXES, FindingKind.OPEN_EDGES}


def test_numbers_in_millimetres_are_read_by_a_typed_unit(tmp_path):
    vertices, triangles = tube_mesh()
    data = trimesh.Trimesh(vertices, triangles, process=False).export(file_type="glb")
    surface, found = load(tmp_path, data, "part.glb", scale=1e-3, replaces_unit=True)
    np.testing.assert_allclose(surface.corners, (vertices * 1e-3)[triangles], atol=1e-8)
    assert found[FindingKind.UNIT_REPLACED].sentence == approved("mesh.unit_replaced", unit="1 m")


def test_gltf_with_everything_in_it_is_read(tmp_path):
    entry, body = document()
    entry["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(body).decode()
    mesh = read_mesh(tmp_path / "a.gltf", json.dumps(entry).encode())
    assert mesh.vertices.tolist() == POINTS.tolist()
    assert mesh.triangles.tolist() == CORNERS.reshape(-1, 3).tolist()


def test_nodes_within_nodes_carry_their_meshes(tmp_path):
    turn = Rotation.from_rotvec([0.3, -0.7, 1.1])
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = Rotation.from_rotvec([1, 2, 3]).as_matrix(), [7, 8, 9]
    nodes = [
        {"mesh": 0, "translation": [1, 2, 3], "rotation": turn.as_quat().tolist(), "scale": [1, 2, 3], "children": [1]},
        {"mesh": 0, "matrix": moved.T.ravel().tolist()},
        {"mesh": 0, "translation": [1000, 0, 0]},
    ]
    mesh = read(tmp_path, *document(nodes=nodes))

    def outer(p):
        return turn.apply(p * np.array([1, 2, 3])) + np.array([1, 2, 3])

    inner = POINTS @ moved[:3, :3].T + moved[:3, 3]
    # The third node is in no scene.
    np.testing.assert_allclose(mesh.vertices, np.r_[outer(POINTS), outer(inner)], atol=1e-5)


def test_without_a_scene_all_nodes_without_a_parent_are_read(tmp_path):
    entry, body = document(nodes=[{"mesh": 0}, {"children": [2]}, {"mesh": 0, "translation": [0, 0, 5]}])
    del entry["scene"], entry["scenes"]
    assert read(tmp_path, entry, body).vertices[:, 2].tolist() == [0] * 4 + [5] * 4


@pytest.mark.parametrize("scale", [[1, -1, 1], [-1, -1, -1]])
def test_a_mirrored_node_keeps_the_outside_outside(tmp_path, scale):
    vertices, triangles = box_mesh()
    entry, body = document(vertices.astype("<f4"), triangles.ravel().astype("<u2"), nodes=[{"mesh": 0, "scale": scale}])
    surface, found = load(tmp_path, glb(entry, body), "a.glb")
    assert (np.einsum("ij,ij->i", surface.normals, surface.centres.T) > 0).all()
    assert FindingKind.TURNED not in found


@pytest.mark.parametrize(("mode", "corners"), [(4, [0, 1, 2, 0, 2, 3]), (5, [3, 0, 2, 1]), (6, [0, 1, 2, 3]), (4, None)])
def test_triangles_strips_and_fans_cover_the_square(tmp_path, mode, corners):
    points = POINTS if corners is not None else POINTS[CORNERS]
    entry, body = document(points, np.array(corners or [0], dtype="<u2"))
    primitive = entry["meshes"][0]["primitives"][0]
    primitive["mode"] = mode
    if corners is None:
        del primitive["indices"]
    entry["meshes"][0]["primitives"].append({"attributes": {"POSITION": 0}, "mode": 1})
    mesh = read(tmp_path, entry, body)
    a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    assert (np.cross(b - a, c - a)[:, 2] / 2).tolist() == [800.0, 800.0]


def test_interleaved_and_sparse_and_whole_numbers(tmp_path):
    # A normal after each position.
    body = b"".join(point.tobytes() + np.array([0, 0, 1], "<f4").tobytes() for point in POINTS)
    entry, _ = document()
    entry["bufferViews"] = [
        {"buffer": 0, "byteLength": 96, "byteStride": 24},
        {"buffer": 0, "byteOffset": 96, "byteLength": 12},
    ]
    entry["buffers"] = [{"byteLength": 108}]
    assert read(tmp_path, entry, body + CORNERS.tobytes()).vertices.tolist() == POINTS.tolist()
    # The third point moves to z = 5.
    entry, body = document()
    entry["bufferViews"] += [
        {"buffer": 0, "byteOffset": 60, "byteLength": 2},
        {"buffer": 0, "byteOffset": 64, "byteLength": 12},
    ]
    entry["accessors"][0]["sparse"] = {
        "count": 1, "indices": {"bufferView": 2, "componentType": 5123}, "values": {"bufferView": 3},
    }  # fmt: skip
    entry["buffers"] = [{"byteLength": 76}]
    body += struct.pack("<HH3f", 2, 0, 40, 40, 5)
    assert read(tmp_path, entry, body).vertices[2].tolist() == [40, 40, 5]
    # Whole numbers that stand for 0 to 1.
    entry, body = document(np.array([(0, 0, 0), (65535, 0, 0), (0, 13107, 0), (0, 0, 65535)], dtype="<u2"))
    entry["accessors"][0]["normalized"] = True
    entry["extensionsRequired"] = ["KHR_mesh_quantization"]
    np.testing.assert_allclose(read(tmp_path, entry, body).vertices, [(0, 0, 0), (1, 0, 0), (0, 0.2, 0), (0, 0, 1)], atol=1e-12)


def changed(place, value):
    entry, body = document()
    target = entry
    for key in place[:-1]:
        target = target[key]
    target[place[-1]] = value
    return glb(entry, body)


PLAIN = glb(*document())
PRIMITIVE = ("meshes", 0, "primitives", 0)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (PLAIN[:-10], "it may be cut off"),
        (PLAIN[:15], "bytes"),
        (PLAIN.replace(b"glTF\x02", b"glTF\x01"), "glTF 1"),
        (PLAIN.replace(b"JSON", b"JSOM"), "no JSON part"),
        (b"{}", "version"),
        (b"[1]", "no JSON object"),
        (b"nonsense", "no JSON: "),
        (changed(("extensionsRequired",), ["KHR_draco_mesh_compression"]), "KHR_draco_mesh_compression"),
        (changed(("bufferViews", 0, "extensions"), {"EXT_meshopt_compression": {}}), "compressed"),
        (changed(("nodes", 0, "extensions"), {"EXT_mesh_gpu_instancing": {}}), "EXT_mesh_gpu_instancing"),
        (changed(("nodes", 0, "skin"), 0), "bones"),
        (changed(("nodes", 0, "weights"), [0.5]), "blend shapes"),
        (changed(("nodes", 0, "children"), [0]), "several parents"),
        (changed(("nodes", 0, "mesh"), 3), "meshes 3 is named"),
        (changed(("nodes", 0, "mesh"), -1), "meshes -1 is named"),
        (changed(("nodes", 0, "mesh"), "0"), "whole number"),
        (changed(("nodes", 0, "rotation"), [0, 0, 0, 0]), "0 0 0 0"),
        (changed(("nodes", 0, "scale"), [1, "2", 3]), "3 numbers"),
        (changed(("accessors", 0, "count"), 4_000_000_000), "4000000000"),
        (changed(("accessors", 0, "count"), 5), "announced in"),
        (changed(("accessors", 0, "byteOffset"), -12), "announced in"),
        (changed(("accessors", 0, "type"), "VEC2"), "VEC3 was expected"),
        (changed(("accessors", 0), {"componentType": 5126, "count": 4, "type": "VEC3"}), "compressed"),
        (changed(("accessors", 0, "componentType"), 5124), "no number type"),
        (changed(("accessors", 1, "count"), 5), "whole triangles"),
        (changed(("accessors", 1, "componentType"), 5122), "indices"),
        (changed(("bufferViews", 0, "byteLength"), 4000), "announced in"),
        (changed(("bufferViews", 0, "byteStride"), 2), "announced in"),
        (changed((*PRIMITIVE, "mode"), 9), "mode 9"),
        (changed((*PRIMITIVE, "attributes"), {}), "POSITION is missing"),
        (changed(("buffers", 0, "uri"), "part.bin"), "another file"),
        (changed(("buffers", 0, "uri"), "../../secret.bin"), "another file"),
        (changed(("buffers", 0, "uri"), "data:;base64,???"), "base64"),
        (changed(("buffers", 0, "uri"), "http://a/b"), "another file"),
        (glb(*document(corners=np.array([0, 1, 9], dtype="<u2"))), "name vertices 0 to 9"),
        (changed(("nodes",), 7), "no list"),
        (changed(("nodes", 0), 7), "no JSON object"),
    ],
)
def test_a_file_that_cannot_be_read_in_full_gets_a_sentence(tmp_path, data, said):
    path = tmp_path / ("a.glb" if data.startswith(b"glTF") else "a.gltf")
    with pytest.raises(InputError, match=re.escape(said)):
        read_mesh(path, data)


def test_bytes_after_the_end_are_counted(tmp_path):
    mesh = read_mesh(tmp_path / "a.glb", PLAIN + b"1234567")
    assert mesh.findings[0].sentence == approved("mesh.bytes_after_end", count=7)


def test_vertices_that_are_not_finite_are_refused(tmp_path):
    points = POINTS.copy()
    points[1, 1] = np.nan
    with pytest.raises(InputError, match="NaN or infinite"):
        load(tmp_path, glb(*document(points)), "a.glb")
