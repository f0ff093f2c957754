"""Libraries read the whole frame of taxels of three axes: yourdfpy and pinocchio from URDF, MuJoCo from MJCF."""

import re
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import yaml
import yourdfpy
from scipy.spatial.transform import Rotation

from skincal.axes.taxel_frames import FrameState
from skincal.files.export import write_calibration
from skincal.files.reference import read_place_sets
from skincal.model.urdf_xml import parse_xml
from skincal.taxels.result import Method
from tests.consumers.flat_pad import flat_calibration
from tests.consumers.robots import LINK
from tests.skincal.files.files_support import make_calibration, make_part, with_turns

UNKNOWN = {0: FrameState.IN_PLANE_UNKNOWN, 15: FrameState.MIRRORED}


def make_turned(folder):
    """Make a part, its calibration, and the true rotations of its taxels."""
    part = make_part(folder)
    calibration, rotations = with_turns(make_calibration(part), UNKNOWN)
    return part, calibration, rotations


@pytest.fixture(scope="module")
def turned(tmp_path_factory):
    return make_turned(tmp_path_factory.mktemp("part"))


def assert_frames_are_right(found, turned):
    """Compare poses (4, 4) by name with the true frames; a taxel without a turn has its normal as z."""
    part, calibration, rotations = turned
    for channel in calibration.channels:
        pose = found[f"{LINK}_taxel_{channel}"]
        np.testing.assert_allclose(pose[:3, 3], part.places[channel], atol=1e-8)
        if channel in UNKNOWN:
            np.testing.assert_allclose(pose[:3, 2], part.normals[channel], atol=1e-7)
        else:
            np.testing.assert_allclose(pose[:3, :3], rotations[channel], atol=1e-7)


def write(turned, format_, folder):
    path = folder / f"skin.{format_}"
    said = write_calibration(turned[1], format_, path, Method.SURFACE)
    return path, said


def test_yourdfpy_reads_the_whole_frame_of_urdf(turned, tmp_path):
    robot = yourdfpy.URDF.load(str(write(turned, "urdf", tmp_path)[0]), load_meshes=False)
    assert_frames_are_right({name: robot.get_transform(name, LINK) for name in robot.link_map if name != LINK}, turned)


def test_pinocchio_reads_the_whole_frame_of_urdf(turned, tmp_path):
    pinocchio = pytest.importorskip("pinocchio", reason="pinocchio has no wheel for this system")
    model = pinocchio.buildModelFromUrdf(str(write(turned, "urdf", tmp_path)[0]))
    assert_frames_are_right({frame.name: frame.placement.homogeneous for frame in model.frames}, turned)


def test_mujoco_reads_the_whole_frame_of_a_site(turned, tmp_path, monkeypatch):
    mujoco = pytest.importorskip("mujoco", reason="mujoco has no wheel for this system")
    monkeypatch.chdir(tmp_path)
    model = mujoco.MjModel.from_xml_path(str(write(turned, "mjcf", tmp_path)[0]))
    data, found = mujoco.MjData(model), {}
    mujoco.mj_forward(model, data)
    for number in range(model.nsite):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = data.site_xmat[number].reshape(3, 3), data.site_xpos[number]
        found[model.site(number).name] = pose
    assert_frames_are_right(found, turned)


def pose_of(numbers):
    pose = np.eye(4)
    pose[:3, 3], pose[:3, :3] = numbers[:3], Rotation.from_euler("xyz", numbers[3:]).as_matrix()
    return pose


def test_frames_of_sdf_and_a_tactile_sensor_are_whole_by_their_own_references(turned, tmp_path):
    """Both have roll, pitch and yaw about fixed axes: sdformat.org/spec (pose), and URDF's origin."""
    sdf = ET.parse(write(turned, "sdf", tmp_path)[0]).getroot()
    found = {each.get("name"): [float(word) for word in each.find("pose").text.split()] for each in sdf.iter("frame")}
    assert_frames_are_right({name: pose_of(numbers) for name, numbers in found.items()}, turned)
    sensor = ET.parse(write(turned, "tactile-urdf", tmp_path)[0]).getroot()
    found = {
        f"{LINK}_taxel_{each.get('idx')}": [float(word) for word in f"{each.get('xyz')} {each.get('rpy')}".split()]
        for each in sensor.iter("taxel")
    }
    assert_frames_are_right({name: pose_of(numbers) for name, numbers in found.items()}, turned)


@pytest.mark.parametrize("format_", ["urdf", "sdf", "mjcf", "tactile-urdf"])
def test_the_comments_say_what_is_known_of_each_turn(turned, format_, tmp_path):
    text = write(turned, format_, tmp_path)[0].read_text()
    assert "turn turn in the plane unknown" not in text
    assert re.search(r"in the plane unknown \(.*press leaning\): channels 0( |$)", text, re.MULTILINE)
    assert re.search(r"mirrored axes \(no rotation.*\): channels 15( |$)", text, re.MULTILINE)
    assert re.search(r"turn known \(.*\): channels 1-14, 16-17,", text)
    assert "x = value 2, y = -value 1, z = -value 3 of the three values of a taxel" in text
    parse_xml(text.encode(), tmp_path)


def test_a_tactile_sensor_with_turns_is_read_as_positions(turned, tmp_path):
    path = tmp_path / "skin.tactile.urdf"
    write_calibration(turned[1], "tactile-urdf", path, Method.SURFACE)
    (found,) = read_place_sets(path)
    assert sorted(found.places) == sorted(turned[1].channels)


def geometry_of(path):
    """Read by the documented schema alone."""
    document = yaml.safe_load(path.read_text())
    assert (document["frame"], document["units"]) == ("sensor", "mm")
    assert "millimetres and degrees in" in path.read_text().partition("\n")[0], "the comments have the units of the rows"
    assert document["num_taxels"] == len(document["taxels"])
    assert len({"rotation" in row for row in document["taxels"]}) == 1, "a rotation for all taxels or for none"
    return document


def test_a_taxel_geometry_has_each_row_of_the_stream(tmp_path):
    calibration, rotations = flat_calibration(tmp_path)
    assert write_calibration(calibration, "taxel-geometry", tmp_path / "pad.yaml", Method.FREE) == ()
    document = geometry_of(tmp_path / "pad.yaml")
    assert document["name"] == "tip_skin"
    for channel, row in enumerate(document["taxels"]):
        np.testing.assert_allclose(row["position"], calibration.estimates_by(Method.FREE)[channel].position * 1e3, atol=1e-6)
        np.testing.assert_allclose(row["rotation"], rotations[channel], atol=1e-8)
        assert (row["channel"], row["state"], row["turn"]) == (channel, "touched", "known")
        np.testing.assert_allclose(row["turn_sd_deg"], np.degrees(0.01), rtol=1e-2)


def test_a_taxel_geometry_invents_no_turn_and_no_position(turned, tmp_path):
    path, said = write(turned, "taxel-geometry", tmp_path)
    document = geometry_of(path)
    assert not any("rotation" in row for row in document["taxels"])
    assert (document["taxels"][0]["turn"], document["taxels"][15]["turn"]) == ("turn in the plane unknown", "mirrored axes")
    # Channels 18 and 22 of a triangle with ten pads have no pad.
    assert document["taxels"][18]["state"] == "no taxel"
    assert np.isnan(document["taxels"][18]["position"]).all()
    assert any("the turn of these is unknown: channels 0, 15. Press them, leaning." in sentence for sentence in said)
    assert any("rows without a position have .nan: channels 18, 22, 24-35" in sentence for sentence in said)
