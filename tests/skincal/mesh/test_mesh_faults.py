"""Mesh files with faults that went without a word: each one gets its sentence, and no large memory; harmless sizes alone."""

from pathlib import Path

import numpy as np
import pytest

from skincal.mesh import collada, gltf, polygons
from skincal.mesh.findings import FindingKind
from skincal.mesh.load import load_surface
from skincal.mesh.readers import read_mesh
from skincal.model.errors import InputError
from skincal.model.scene import SurfaceSpec
from tests.skincal.mesh.test_collada import INPUT, SQUARE, TWO_TRIANGLES, by_hand
from tests.skincal.mesh.test_gltf import document, glb

NODE = '<node><instance_geometry url="#g"/></node>'


def read(name, data):
    return read_mesh(Path(name), data)


def kinds(mesh):
    return [finding.kind for finding in mesh.findings]


def stl(*parts, last="endsolid b\n"):
    facet = "facet normal 0 0 1\nouter loop\n{}endloop\nendfacet\n"
    corners = [facet.format("".join(f"vertex {x} {y} {k}\n" for x, y in ((0, 0), (40, 0), (0, 40)))) for k in parts]
    return (f"solid a\n{corners[0]}endsolid a\nsolid b\n{''.join(corners[1:])}{last}").encode()


def test_a_cut_text_of_several_solids_is_named():
    assert kinds(read("a.stl", stl(0, 1, 2))) == []
    cut = read("a.stl", stl(0, 1, last=""))
    assert kinds(cut) == [FindingKind.NO_END]
    assert len(cut.triangles) == 2


def ply(vertices="float x\nproperty float y\nproperty float z", faces="list uchar int vertex_indices", body="", form="ascii"):
    return (
        f"ply\nformat {form} 1.0\nelement vertex 4\nproperty {vertices}\nelement face 2\nproperty {faces}\nend_header\n{body}"
    ).encode()


POINTS = "0 0 0\n4 0 0\n4 4 0\n0 4 0\n"


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "names vertex 0, and OBJ counts from 1"),
        ("a.obj", b"v 0 0 1_0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "'1_0' is no number"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3_0\n", "'3_0' is no whole number"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\0\0\0", r"'3\x00\x00\x00' is no whole number"),
        ("a.obj", b"v 0 0 0\nv 1\0 0 0\nv 0 1 0\nf 1 2 3\n", r"'1\x00' is no number"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n", "a whole number of more than 63 bits"),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\0", r"'2\x00' is no whole number"),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n1_0 0 0\n0 1 0\n3 0 1 2\n", "is no number"),
        ("a.ply", ply(body=POINTS + "3 0 1 2\n3 0 2 0.6\n"), "names vertex 0.6; a whole number"),
        ("a.ply", ply(body=POINTS + "3 0 1 2\n4 0 2 3 0.6\n"), "names vertex 0.6; a whole number"),
        ("a.ply", ply(body=POINTS + "3 0 1 2\n3 0 2 nan\n"), "names vertex nan; a whole number"),
        ("a.ply", ply(body=POINTS + "3 0 1 2\n3 0 2 1_0\n"), "'1_0' is no number"),
        ("a.ply", ply(body=POINTS + "3 0 1 2\n3 0 2 3\0\n"), r"'3\x00' is no number"),
        ("a.stl", stl(0, 1).replace(b"vertex 40", b"vertex 40\0"), r"'40\x00' is no number"),
        ("a.ply", ply(vertices="float x\nproperty float y", body="0 0\n4 0\n4 4\n0 4\n3 0 1 2\n3 0 2 3\n"), "have no z"),
        ("a.ply", ply(faces="list uchar integer vertex_indices", body=POINTS), "'integer' is no number type of PLY"),
        ("a.ply", ply(form="binary", body=POINTS), "the format 'binary' is not one of binary_little_endian"),
        ("a.ply", ply(body=POINTS + "3 0 1 2\n4 0 2"), "numbers are announced, and"),
        ("a.ply", b"ply\nformat ascii 1.0\nproperty float x\nend_header\n", "before the first element"),
        ("a.ply", ply().replace(b"vertex 4", b"vertex four"), "'four' is no whole number"),
    ],
)
def test_numbers_that_are_none_get_a_sentence_without_jargon(name, data, said):
    with pytest.raises(InputError) as caught:
        read(name, data)
    assert said in str(caught.value)
    assert not any(
        word in str(caught.value) for word in ("KeyError", "Python int", "invalid literal", "list index", "buffer is smaller")
    )


@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.obj", "# C:\\parts\\\nv 0 0 0 # corner\nv 1 0 0#\nv 0 1 0\nf 1 2 3 # face\n"),
        ("a.off", "# cover\nOFF\n3 1 0 # counts\n0 0 0\n1 0 0\n0 1 0#\n3 0 1 2\n"),
    ],
)
def test_a_comment_ends_with_its_line(name, text, line_end):
    mesh = read(name, text.replace("\n", line_end).encode())
    np.testing.assert_array_equal(mesh.vertices[mesh.triangles], [[(0, 0, 0), (1, 0, 0), (0, 1, 0)]])


def test_zeros_of_a_sparse_accessor_are_no_more_than_the_file_can_name():
    entry, body = document()
    place = len(body)
    body += np.array([1, 2, 3], "<u2").tobytes() + b"\0\0" + np.array([(40, 0, 0), (40, 40, 0), (0, 40, 0)], "<f4").tobytes()
    entry["buffers"][0]["byteLength"] = len(body)
    entry["bufferViews"] += [
        {"buffer": 0, "byteOffset": place, "byteLength": 6}, {"buffer": 0, "byteOffset": place + 8, "byteLength": 36}
    ]  # fmt: skip
    points = entry["accessors"][0]
    del points["bufferView"]
    points["sparse"] = {"count": 3, "indices": {"bufferView": 2, "componentType": 5123}, "values": {"bufferView": 3}}
    mesh = read("a.glb", glb(entry, body))
    np.testing.assert_array_equal(mesh.vertices, [(0, 0, 0), (40, 0, 0), (40, 40, 0), (0, 40, 0)])
    points["count"] = 100_000
    with pytest.raises(InputError, match="announces 100000 entries in a file of"):
        read("a.glb", glb(entry, body))


def materials(count, each="0 1 2"):
    return "".join(f"<triangles count='1'>{INPUT}<p>{each}</p></triangles>" for _ in range(count))


def test_many_materials_on_one_array_are_read_once_and_count_once(monkeypatch):
    points = np.random.default_rng(1).random((50, 3))
    for module in (polygons, gltf):
        monkeypatch.setattr(module, "MAX_PLACED_CORNERS", 200)
    mesh = read("a.dae", by_hand(materials(40), points))
    assert (len(mesh.vertices), len(mesh.triangles)) == (50, 40), "and not 40 x 50 vertices"
    entry, body = document()
    entry["meshes"][0]["primitives"] *= 30
    mesh = read("a.glb", glb(entry, body))
    assert (len(mesh.vertices), len(mesh.triangles)) == (4, 60)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig"])
def test_collada_in_utf_16_is_read(encoding):
    text = by_hand(TWO_TRIANGLES, SQUARE).decode()
    plain = read("a.dae", text.encode())
    name = "UTF-16" if encoding == "utf-16" else "UTF-8"
    other = read("a.dae", text.replace('encoding="utf-8"', f'encoding="{name}"').encode(encoding))
    np.testing.assert_array_equal(other.vertices[other.triangles], plain.vertices[plain.triangles])


def test_lists_that_are_shorter_than_announced_and_units_without_length_are_named():
    plain = by_hand(TWO_TRIANGLES, SQUARE)
    assert kinds(read("a.dae", plain)) == []
    short = read("a.dae", plain.replace(b"count='2'", b"count='3'"))
    assert kinds(short) == [FindingKind.SHORT_LISTS]
    assert len(short.triangles) == 2
    bare = read("a.dae", by_hand(TWO_TRIANGLES, SQUARE, asset='<unit name="part"/>'))
    assert kinds(bare) == [FindingKind.UNIT_WITHOUT_LENGTH]
    assert bare.unit == 1.0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ((b'<instance_geometry url="#g"/>', b'<instance_node url="#"/>'), "instance_node names nothing"),
        ((b'<geometry id="g">', b'<geometry id="g"><asset><unit meter="0.001"/></asset>'), "unit of its own"),
        ((b"<node>", b"<node><matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 2</matrix>"), "last row of a node's matrix is 0 0 0 2"),
    ],
)
def test_what_moves_a_part_in_an_unread_way_is_refused(change, said):
    with pytest.raises(InputError, match=said):
        read("a.dae", by_hand(TWO_TRIANGLES, SQUARE).replace(*change))


def test_a_matrix_of_gltf_with_another_last_row_is_refused():
    entry, body = document()
    entry["nodes"][0]["matrix"] = [1, 0, 0, 0.5, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    with pytest.raises(InputError, match=r"last row of a node's matrix is 0\.5 0 0 1"):
        read("a.glb", glb(entry, body))


def test_empty_geometries_in_many_places_end_at_the_limit(monkeypatch):
    monkeypatch.setattr(collada, "MAX_NODES", 100)
    nodes = ("<node>" + '<instance_geometry url="#g"/>' * 30 + "</node>") * 5
    with pytest.raises(InputError, match="over 100 nodes: a node names others many times, geometries"):
        read("a.dae", by_hand("", SQUARE, nodes=nodes))


def test_huge_scales_are_refused_without_a_warning(tmp_path):
    entry, body = document()
    entry["nodes"][0]["scale"] = [1e300, 1e300, 1e300]
    (tmp_path / "a.glb").write_bytes(glb(entry, body))
    with pytest.raises(InputError, match="no known unit makes it fit"):
        load_surface(SurfaceSpec(tmp_path / "a.glb", 1.0, np.eye(4)))
    nodes = NODE.replace("<node>", "<node><scale>1e200 1 1</scale><scale>1e200 1 1</scale>")
    assert np.isinf(read("a.dae", by_hand(TWO_TRIANGLES, SQUARE, nodes=nodes)).vertices).any()


def test_a_polygon_beyond_the_limit_of_ears_is_not_called_crossing(monkeypatch):
    angle = np.linspace(0, 2 * np.pi, 41)[:-1]
    star = np.where(np.arange(40) % 2, 1.0, 0.4)[:, None] * np.c_[np.cos(angle), np.sin(angle)]
    text = "".join(f"v {x} {y} 0\n" for x, y in star) + "f " + " ".join(map(str, range(1, 41))) + "\n"
    whole = read("a.obj", text.encode())
    assert (len(whole.triangles), kinds(whole)) == (38, [])
    monkeypatch.setattr(polygons, "MAX_EAR_TESTS", 20)
    assert kinds(read("a.obj", text.encode())) == [FindingKind.TOO_LARGE]
