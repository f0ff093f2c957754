"""COLLADA: files by pycollada and by hand; truth by matrices written out here and by numbers known beforehand."""

import re
import warnings

import collada
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_load import box_mesh, load, tube_mesh

from skincal.mesh.findings import FindingKind
from skincal.mesh.readers import read_mesh
from skincal.model.errors import InputError
from tests.approved import approved


def written(vertices, triangles, unit=1.0, up="Z_UP", pose=None, kind="triangles"):
    """Write a mesh by pycollada, with normals in the same list of indices."""
    file = collada.Collada()
    file.assetInfo.unitname, file.assetInfo.unitmeter, file.assetInfo.upaxis = "unit", unit, getattr(collada.asset.UP_AXIS, up)
    points = collada.source.FloatSource("points", np.ravel(vertices), ("X", "Y", "Z"))
    normals = collada.source.FloatSource("normals", np.array([0.0, 0, 1]), ("X", "Y", "Z"))
    geometry = collada.geometry.Geometry(file, "shape", "shape", [points, normals])
    inputs = collada.source.InputList()
    inputs.addInput(0, "VERTEX", "#points")
    inputs.addInput(1, "NORMAL", "#normals")
    indices = np.stack([np.ravel(triangles), np.zeros(np.size(triangles), int)], axis=1).ravel()
    if kind == "triangles":
        geometry.primitives.append(geometry.createTriangleSet(indices, inputs, "paint"))
    else:
        geometry.primitives.append(geometry.createPolylist(indices, np.full(len(triangles), 3), inputs, "paint"))
    file.geometries.append(geometry)
    moves = [] if pose is None else [collada.scene.MatrixTransform(np.ravel(pose))]
    node = collada.scene.Node("node", children=[collada.scene.GeometryNode(geometry, [])], transforms=moves)
    file.scenes.append(collada.scene.Scene("scene", [node]))
    file.scene = file.scenes[0]
    text = bytearray()

    class Sink:
        def write(self, data):
            text.extend(data)

        def close(self):
            pass

        def flush(self):
            pass

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        file.write(Sink())
    return bytes(text)


SHAPE = """<source id="s"><float_array id="a" count="{count}">{numbers}</float_array><technique_common>
<accessor source="#a" count="{points}" stride="3"><param name="X"/><param name="Y"/><param name="Z"/></accessor>
</technique_common></source><vertices id="v"><input semantic="POSITION" source="#s"/></vertices>"""
INPUT = '<input semantic="VERTEX" source="#v" offset="0"/>'


def by_hand(faces, points, nodes='<node><instance_geometry url="#g"/></node>', asset="", more="", xmlns=True):
    numbers = np.ravel(points)
    shape = SHAPE.format(count=len(numbers), numbers=" ".join(map(repr, numbers.tolist())), points=len(points))
    name = ' xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"' if xmlns else ""
    return f"""<?xml version="1.0" encoding="utf-8"?><COLLADA{name}><asset>{asset}</asset>
<library_geometries><geometry id="g"><mesh>{shape}{faces}</mesh></geometry></library_geometries>{more}
<library_visual_scenes><visual_scene id="w">{nodes}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#w"/></scene></COLLADA>""".encode()


SQUARE = [(0.0, 0, 0), (40, 0, 0), (40, 40, 0), (0, 40, 0)]
TWO_TRIANGLES = f"<triangles count='2'>{INPUT}<p>0 1 2 0 2 3</p></triangles>"


@pytest.mark.parametrize("kind", ["triangles", "polylist"])
@pytest.mark.parametrize(("unit", "name"), [(1.0, "m"), (0.01, "cm"), (0.001, "mm"), (0.0254, "in")])
def test_the_unit_of_the_file_counts(tmp_path, unit, name, kind):
    vertices, triangles = tube_mesh()
    data = written(vertices * 1e-3 / unit, triangles, unit, kind=kind)
    surface, found = load(tmp_path, data, "part.dae", scale=1.0)
    np.testing.assert_allclose(surface.corners, (vertices * 1e-3)[triangles], atol=1e-7)
    assert f"unit {name})" in found[FindingKind.SIZE].sentence
    assert FindingKind.UP_AXIS not in found


def test_a_scale_of_a_urdf_multiplies_the_unit_and_a_typed_unit_replaces_it(tmp_path):
    vertices, triangles = tube_mesh()
    data = written(vertices * 0.1, triangles, unit=0.01)
    surface, _ = load(tmp_path, data, "part.dae", scale=2.0)
    np.testing.assert_allclose(surface.corners, (vertices * 2e-3)[triangles], atol=1e-7)
    surface, found = load(tmp_path, data, "typed.dae", scale=0.0254, replaces_unit=True)
    np.testing.assert_allclose(surface.corners, (vertices * 0.1 * 0.0254)[triangles], atol=1e-7)
    assert found[FindingKind.UNIT_REPLACED].sentence == approved("mesh.unit_replaced", unit="10 mm")
    _, found = load(tmp_path, data, "same.dae", scale=0.01, replaces_unit=True)
    assert FindingKind.UNIT_REPLACED not in found


@pytest.mark.parametrize(("up", "axis"), [("Y_UP", "y"), ("X_UP", "x")])
def test_the_axes_are_those_of_the_file_whatever_points_up(tmp_path, up, axis):
    """Kinova's, REEM-C's and other robots have Y_UP in files whose numbers are in the axes of the link."""
    vertices, triangles = tube_mesh()
    surface, found = load(tmp_path, written(vertices, triangles, up=up), "part.dae")
    np.testing.assert_allclose(surface.corners, (vertices * 1e-3)[triangles], atol=1e-7)
    assert found[FindingKind.UP_AXIS].sentence == approved("mesh.up_axis", axis=axis)


def test_nodes_within_nodes_carry_their_geometry(tmp_path):
    below = '<node><rotate>0 0 1 90</rotate><scale>2 1 1</scale><instance_geometry url="#g"/></node>'
    nodes = f'<node><translate>100 0 0</translate><rotate>1 0 0 30</rotate>{below}<instance_node url="#again"/></node>'
    again = '<library_nodes><node id="again"><translate>0 0 7</translate><instance_geometry url="#g"/></node></library_nodes>'
    mesh = read_mesh(tmp_path / "a.dae", by_hand(TWO_TRIANGLES, SQUARE, nodes, more=again))
    outer = Rotation.from_euler("x", 30, degrees=True)
    one = outer.apply(Rotation.from_euler("z", 90, degrees=True).apply(np.array(SQUARE) * [2, 1, 1]))
    two = outer.apply(np.array(SQUARE) + np.array([0, 0, 7]))
    np.testing.assert_allclose(mesh.vertices, np.r_[one, two] + [100, 0, 0], atol=1e-12)


def test_a_mirrored_node_keeps_the_outside_outside(tmp_path):
    vertices, triangles = box_mesh()
    corners = " ".join(map(str, triangles.ravel()))
    data = by_hand(
        f"<triangles count='12'>{INPUT}<p>{corners}</p></triangles>", vertices, '<node><scale>1 -1 1</scale>'
        '<instance_geometry url="#g"/></node>',
    )  # fmt: skip
    surface, found = load(tmp_path, data, "a.dae")
    assert (np.einsum("ij,ij->i", surface.normals, surface.centres.T) > 0).all()
    assert FindingKind.TURNED not in found


@pytest.mark.parametrize(
    ("faces", "area"),
    [
        (f"<polylist count='1'>{INPUT}<vcount>6</vcount><p>0 1 2 3 4 5</p></polylist>", 3900),
        (f"<polygons count='1'>{INPUT}<p>0 1 2 3 4 5</p></polygons>", 3900),
        (f"<trifans count='1'>{INPUT}<p>4 5 0 1 2 3</p></trifans>", 3900),
        (f"<tristrips count='1'>{INPUT}<p>5 0 4 1</p><p>4 1 3 2</p></tristrips>", 3900),
        (f"<lines count='1'>{INPUT}<p>0 1</p></lines><triangles count='1'>{INPUT}<p>0 1 2</p></triangles>", 3200),
    ],
)
def test_each_kind_of_faces_has_the_area_of_the_plate(tmp_path, faces, area):
    plate = [(0.0, 80, 0), (0, 0, 0), (80, 0, 0), (80, 30, 0), (30, 30, 0), (30, 80, 0)]
    mesh = read_mesh(tmp_path / "a.dae", by_hand(faces, plate))
    a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    areas = np.cross(b - a, c - a)[:, 2] / 2
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(area)


def test_a_file_without_a_scene_or_with_prefixes_is_read(tmp_path):
    text = by_hand(TWO_TRIANGLES, SQUARE)
    alone = re.sub(rb"<library_visual_scenes>.*</scene>", b"", text, flags=re.DOTALL)
    prefixed = re.sub(rb"<(/?)(?=[A-Za-z])", rb"<\1c:", by_hand(TWO_TRIANGLES, SQUARE, xmlns=False))
    for data in (alone, prefixed, b"\xef\xbb\xbf" + text):
        assert len(read_mesh(tmp_path / "a.dae", data).triangles) == 2


def bomb():
    names = "".join(
        f'<node id="n{k}"><instance_node url="#n{k + 1}"/><instance_node url="#n{k + 1}"/></node>' for k in range(40)
    )
    more = f'<library_nodes>{names}<node id="n40"><instance_geometry url="#g"/></node></library_nodes>'
    return by_hand(TWO_TRIANGLES, SQUARE, '<node><instance_node url="#n0"/></node>', more=more)


PLAIN = by_hand(TWO_TRIANGLES, SQUARE)
ENTITIES = b'<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;">]>'


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (PLAIN.replace(b"<COLLADA", ENTITIES + b"<COLLADA"), "document type"),
        (PLAIN[:-40], "no XML"), (b"<robot/>", "COLLADA was expected"), (b"\x00\x01", "no XML"),
        (b"<COLLADA>" + b"<a>" * 5000, "elements within one another"),
        (bomb(), "names others many times"),
        (by_hand(TWO_TRIANGLES, SQUARE, '<node id="n"><instance_node url="#n"/></node>'), "or itself"),
        (by_hand(TWO_TRIANGLES, SQUARE, '<node><instance_geometry url="other.dae#g"/></node>'), "not in this file"),
        (by_hand(TWO_TRIANGLES, SQUARE, '<node><instance_geometry url="file:///etc/passwd"/></node>'), "not in this file"),
        (by_hand(TWO_TRIANGLES, SQUARE, '<node><instance_geometry url="#h"/></node>'), "which is missing"),
        (by_hand(TWO_TRIANGLES, SQUARE, '<node><instance_controller url="#g"/></node>'), "instance_controller"),
        (by_hand(TWO_TRIANGLES, SQUARE, '<node><skew>1 2 3 4 5 6 7</skew></node>'), "placed by skew"),
        (by_hand(TWO_TRIANGLES, SQUARE, '<node><matrix>1 2 3</matrix></node>'), "has 3 numbers"),
        (by_hand("<patches/>", SQUARE), "has patches"),
        (by_hand(f"<polygons>{INPUT}<ph><p>0 1 2</p><h>0 1 2</h></ph></polygons>", SQUARE), "holes"),
        (by_hand(f"<polylist>{INPUT}<vcount>900000000</vcount><p>0 1 2</p></polylist>", SQUARE), "vcount says 900000000"),
        (by_hand(f"<triangles>{INPUT}<p>0 1</p></triangles>", SQUARE), "a multiple of 3"),
        (by_hand(f"<triangles>{INPUT}<p>0 1 9</p></triangles>", SQUARE), "name vertices 0 to 9"),
        (by_hand(f"<triangles>{INPUT}<p>0 1 -1</p></triangles>", SQUARE), "name vertices -1 to 1"),
        (PLAIN.replace(b'count="4" stride="3"', b'count="4000000000" stride="3"'), "do not hold"),
        (PLAIN.replace(b"40.0", b"40,5", 1), "decimal comma"),
        (by_hand(TWO_TRIANGLES, SQUARE, asset='<unit meter="0"/>'), "above 0"),
        (by_hand(TWO_TRIANGLES, SQUARE, asset='<unit meter="inch"/>'), "is no number"),
    ],
)  # fmt: skip
def test_a_file_that_cannot_be_read_in_full_gets_a_sentence(tmp_path, data, said):
    with pytest.raises(InputError, match=re.escape(said)) as error:
        read_mesh(tmp_path / "a.dae", data)
    assert "b'" not in str(error.value)


def test_many_copies_of_a_large_shape_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("skincal.mesh.polygons.MAX_PLACED_CORNERS", 100)
    nodes = '<node><instance_geometry url="#g"/></node>' * 11
    with pytest.raises(InputError, match="over 100 corners"):
        read_mesh(tmp_path / "a.dae", by_hand(TWO_TRIANGLES, SQUARE, nodes))
