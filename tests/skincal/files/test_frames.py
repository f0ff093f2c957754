"""Frames of taxels for robot descriptions, read back by parsers of their own."""

import io
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.files.export import WRITER_OF_FORMAT, write_calibration
from skincal.files.formats import ExportFormat, ExportOptions, Inertia
from skincal.files.frames import mjcf_text, npz_bytes, quaternions_of, sdf_text, urdf_text
from skincal.files.reference import load_reference, read_place_sets
from skincal.files.tactile_urdf import tactile_urdf_text
from skincal.model.errors import InputError
from skincal.taxels.result import Method
from tests.skincal.files.files_support import estimate, make_calibration

OF_ONE = (ExportFormat.URDF, ExportFormat.TACTILE_URDF, ExportFormat.SDF, ExportFormat.MJCF, ExportFormat.NPZ)
LEFT_OUT = (5, 13)
LINK = "r_forearm_dh_frame"


@pytest.fixture(scope="module")
def calibration(part):
    return make_calibration(part, unseen=LEFT_OUT[:1], blind=LEFT_OUT[1:])


def numbers(text: str | None) -> list[float]:
    assert text is not None
    return [float(word) for word in text.split()]


def urdf_poses(text: str) -> dict[str, tuple[list[float], Rotation]]:
    """Positions and turns by child link; roll, pitch and yaw about fixed axes."""
    poses = {}
    for joint in ET.fromstring(text).iter("joint"):
        origin = joint.find("origin")
        assert joint.get("type") == "fixed"
        assert joint.find("parent").get("link") == "r_forearm_dh_frame"
        poses[joint.find("child").get("link")] = (
            numbers(origin.get("xyz")), Rotation.from_euler("xyz", numbers(origin.get("rpy")))
        )  # fmt: skip
    return poses


def sdf_poses(text: str) -> dict[str, tuple[list[float], Rotation]]:
    poses = {}
    for frame in ET.fromstring(text).iter("frame"):
        assert frame.get("attached_to") == "r_forearm_dh_frame"
        values = numbers(frame.find("pose").text)
        poses[frame.get("name")] = values[:3], Rotation.from_euler("xyz", values[3:])
    return poses


def mjcf_poses(text: str) -> dict[str, tuple[list[float], Rotation]]:
    root = ET.fromstring(text)
    assert [touch.get("site") for touch in root.iter("touch")] == [site.get("name") for site in root.iter("site")]
    return {
        site.get("name"): (
            numbers(site.get("pos")), Rotation.from_quat(numbers(site.get("quat")), scalar_first=True)
        )
        for site in root.iter("site")
    }  # fmt: skip


@pytest.mark.parametrize(("text_of", "poses_of"), [(urdf_text, urdf_poses), (sdf_text, sdf_poses), (mjcf_text, mjcf_poses)])
def test_each_taxel_has_a_frame_at_its_place_with_z_outward(part, calibration, text_of, poses_of):
    poses = poses_of(text_of(calibration, Method.SURFACE))
    placed = [channel for channel in calibration.channels.tolist() if channel not in LEFT_OUT]
    assert list(poses) == [f"{LINK}_taxel_{channel}" for channel in placed]
    for channel in placed:
        position, turn = poses[f"{LINK}_taxel_{channel}"]
        assert np.allclose(position, part.places[channel], atol=1e-9)
        assert np.allclose(turn.apply([0.0, 0.0, 1.0]), part.normals[channel], atol=1e-8)


def test_frames_are_the_same_in_every_format_for_normals_all_around(calibration):
    rng = np.random.default_rng(3)
    normals = np.vstack([rng.standard_normal((40, 3)), np.eye(3), -np.eye(3)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    channels = calibration.channels.tolist()[: len(normals)]
    # The last one has no normal: its frame stands as the link's.
    known = [*normals[: len(channels) - 1], None]
    found = tuple(estimate(channel, Method.FREE, rng.standard_normal(3), n) for channel, n in zip(channels, known, strict=True))
    turned = replace(calibration, channels=channels, estimates={Method.FREE: found})
    first, second, third = (
        poses_of(text_of(turned, Method.FREE))
        for text_of, poses_of in ((urdf_text, urdf_poses), (sdf_text, sdf_poses), (mjcf_text, mjcf_poses))
    )
    for name, normal in zip(first, known, strict=True):
        for other in (second, third):
            assert (first[name][1].inv() * other[name][1]).magnitude() < 1e-7
        expected = [0.0, 0.0, 1.0] if normal is None else normal
        assert np.allclose(first[name][1].apply([0.0, 0.0, 1.0]), expected, atol=1e-8)
    assert first[f"{LINK}_taxel_{channels[-1]}"][1].magnitude() == 0.0


def test_a_touch_site_ends_half_way_to_its_neighbour(part, calibration):
    layout = part.scene.skin.layout
    assert layout is not None
    sizes = {float(site.get("size")) for site in ET.fromstring(mjcf_text(calibration, Method.FREE)).iter("site")}
    assert list(sizes) == [pytest.approx(layout.spacing / 2, rel=1e-6)]


def test_an_archive_holds_poses_and_covariances_without_pickles(part, calibration):
    found = np.load(io.BytesIO(npz_bytes(calibration, Method.SURFACE)), allow_pickle=False)
    placed = [channel for channel in calibration.channels.tolist() if channel not in LEFT_OUT]
    assert found["channel"].tolist() == placed
    assert np.array_equal(found["position"], part.places[placed])
    assert np.array_equal(found["normal"], part.normals[placed])
    by_channel = {each.channel: each for each in calibration.estimates_by(Method.SURFACE)}
    assert all(np.array_equal(found["covariance"][i], by_channel[channel].covariance) for i, channel in enumerate(placed))
    assert np.array_equal(found["quaternion_wxyz"], quaternions_of(part.normals[placed]))
    assert [str(found[name]) for name in ("frame", "method", "units")] == ["r_forearm_dh_frame", "surface", "m"]


@pytest.mark.parametrize("format_", OF_ONE)
def test_an_unknown_normal_and_no_taxel_at_all_are_written_too(calibration, format_, tmp_path):
    bare = estimate(0, Method.FREE, np.array([0.0, 0.1, 0.04]), None)
    some = replace(calibration, channels=[0], estimates={Method.FREE: (bare,)})
    write_calibration(some, format_.value, tmp_path / "one", Method.FREE)
    none = replace(calibration, channels=[], estimates={Method.FREE: ()})
    said = write_calibration(none, format_.value, tmp_path / "none", Method.FREE)
    assert len(said) == 1
    if format_ is ExportFormat.NPZ:
        assert np.isnan(np.load(tmp_path / "one")["normal"]).all()
        assert np.load(tmp_path / "none")["covariance"].shape == (0, 3, 3)
    else:
        assert "taxel_0" in (tmp_path / "one").read_text().replace('taxel idx="0', "taxel_0")
        assert ET.parse(tmp_path / "none") is not None


@pytest.mark.parametrize("format_", OF_ONE)
def test_the_lint_speaks_alike_of_every_format(part, format_, tmp_path):
    off = make_calibration(part, unseen=(5,), shift=0.1)
    said = write_calibration(off, format_.value, tmp_path / "file", Method.SURFACE)
    assert said == write_calibration(off, "ply", tmp_path / "ply", Method.SURFACE)
    assert len(said) > 1


@pytest.mark.parametrize("text_of", [urdf_text, sdf_text, mjcf_text, tactile_urdf_text])
def test_names_from_strangers_stay_names(calibration, text_of):
    hostile = 'a"b<c>&--\x01\ud800 d'
    scene = replace(calibration.scene, link=hostile, name=hostile)
    root = ET.fromstring(text_of(replace(calibration, scene=scene), Method.FREE))
    values = {value for element in root.iter() for value in element.attrib.values()}
    assert 'a"b<c>&--__ d' in values


def test_every_format_has_an_ending_and_a_line_of_its_own():
    assert len({each.suffix for each in ExportFormat}) == len(ExportFormat)
    assert set(WRITER_OF_FORMAT) == set(ExportFormat)
    assert all(each.description.endswith(".") and "\n" not in each.description for each in ExportFormat)


def test_a_tactile_sensor_has_every_taxel_and_is_read_as_known_positions(part, calibration, tmp_path):
    path = tmp_path / "skin.tactile.urdf"
    write_calibration(calibration, "tactile-urdf", path, Method.SURFACE)
    (sensor,) = ET.parse(path).getroot().findall("sensor")
    assert sensor.find("parent").get("link") == "r_forearm_dh_frame"
    assert sensor.find("tactile").get("channel") == sensor.get("name") == f"{LINK}_skin"
    assert sensor.get("type") == "tactile", "iDynTree reports an error for a sensor without"
    for taxel in sensor.iter("taxel"):
        outward = Rotation.from_euler("xyz", numbers(taxel.get("rpy"))).apply([0.0, 0.0, 1.0])
        assert np.allclose(outward, part.normals[int(taxel.get("idx"))], atol=1e-8)
        assert float(taxel.find("geometry/cylinder").get("radius")) > 0
    placed = [channel for channel in calibration.channels.tolist() if channel not in LEFT_OUT]
    known = load_reference(path, "r_forearm_dh_frame", placed)
    assert sorted(known.places) == placed
    assert all(np.allclose(known.places[channel], part.places[channel], atol=1e-9) for channel in placed)


TAXEL = '<taxel idx="{}" xyz="0 0 1" rpy="0 0 0"/>'
SENSOR = '<sensor name="s">{}<origin xyz="1 0 0" rpy="0 1.5707963267948966 0"/><tactile>{}</tactile></sensor>'
PARENT = '<parent link="l"/>'


def test_a_tactile_sensor_of_another_program_is_read_with_its_origin(tmp_path):
    # The namespace of tactile_toolbox's own test file, its array, and a second sensor.
    sensors = [SENSOR.format(PARENT, inside) for inside in (TAXEL.format(4), "<array rows='2' cols='2' size='1 1'/>")]
    (tmp_path / "a.urdf").write_text('<robot xmlns="http://www.ros.org"><link name="l"/>' + "".join(sensors) + "</robot>")
    (found,) = read_place_sets(tmp_path / "a.urdf")
    assert (found.name, found.link, list(found.places)) == ("a.urdf, s", "l", [4])
    assert np.allclose(found.places[4], [2.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot/>", "no tactile sensor"),
        (SENSOR.format("", TAXEL.format(0)), "no <parent link>"),
        (SENSOR.format(PARENT, TAXEL.format(-1)), "idx of a taxel"),
        (SENSOR.format(PARENT, TAXEL.format(0).replace("0 0 1", "0 nan 1")), "3 finite numbers"),
        ("<robot", "not an XML file"),
        ("<!DOCTYPE r><r/>", "document type"),
    ],
)
def test_a_damaged_tactile_sensor_is_refused(tmp_path, text, words):
    (tmp_path / "a.urdf").write_text(f"<robot>{text}</robot>" if text.startswith("<sensor") else text)
    with pytest.raises(InputError, match=words):
        read_place_sets(tmp_path / "a.urdf")


def names_of(text: str | bytes) -> set[str]:
    """Names of everything but joints, which have those of their links."""
    return {each.get("name") for each in ET.fromstring(text).iter() if each.get("name") and each.tag not in ("joint", "touch")}


@pytest.mark.parametrize("text_of", [urdf_text, sdf_text, mjcf_text, tactile_urdf_text])
def test_two_skins_of_one_robot_share_no_name(calibration, text_of):
    other = replace(calibration, scene=replace(calibration.scene, link="l_forearm_dh_frame"))
    shared = names_of(text_of(calibration, Method.FREE)) & names_of(text_of(other, Method.FREE))
    assert shared <= {calibration.scene.name}, "the name of the document alone"


@pytest.mark.parametrize("prefix", ["", "left_", "a/b.c-"])
@pytest.mark.parametrize("text_of", [urdf_text, sdf_text, mjcf_text, tactile_urdf_text])
def test_a_prefix_begins_every_name(calibration, text_of, prefix):
    chosen = replace(calibration, options=ExportOptions(prefix=prefix))
    found = names_of(text_of(chosen, Method.FREE)) - {calibration.scene.name, LINK}
    expected = {f"{prefix}taxel_{channel}" for channel in calibration.channels.tolist() if channel not in LEFT_OUT}
    skin = {f"{prefix}skin"}
    of_format = {urdf_text: expected, sdf_text: expected | skin, mjcf_text: expected | skin, tactile_urdf_text: skin}
    assert found == of_format[text_of]


@pytest.mark.parametrize("prefix", ["a b", "/arm", "::", "a\n", "<", "a&"])
def test_a_prefix_that_cannot_begin_a_name_is_refused(calibration, prefix, tmp_path):
    with pytest.raises(InputError, match=r"^The prefix \(--prefix\) is .*; expected letters, digits"):
        write_calibration(calibration, "urdf", tmp_path / "a.urdf", Method.FREE, ExportOptions(prefix=prefix))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("format_", list(ExportFormat))
def test_an_option_that_a_format_does_not_know_is_refused_and_named(calibration, format_, tmp_path):
    every = ExportOptions("chest", "left_", Inertia.TINY, tmp_path / "robot.urdf")
    for name in ("part", "prefix", "inertia", "into"):
        one = replace(ExportOptions(), **{name: getattr(every, name)})
        if name in format_.options:
            one.require_use(format_)
            assert one.for_format(format_) == one
            continue
        with pytest.raises(InputError, match=rf"^--{name} .*; expected --format .*, not {format_.value}"):
            write_calibration(calibration, format_, tmp_path / "file", Method.FREE, one)
        assert one.for_format(format_) == ExportOptions()
    assert not list(tmp_path.iterdir())


def test_a_link_of_urdf_has_a_mass_only_if_that_is_wanted(calibration):
    bare = ET.fromstring(urdf_text(calibration, Method.FREE))
    assert bare.find(".//inertial") is None
    assert bare.find("mujoco/compiler").get("fusestatic") == "false", "otherwise MuJoCo keeps no taxel"
    tiny = ET.fromstring(urdf_text(replace(calibration, options=ExportOptions(inertia=Inertia.TINY)), Method.FREE))
    links = tiny.findall("link")
    assert len(links) == len(bare.findall("link")) > 1
    for link in links:
        assert float(link.find("inertial/mass").get("value")) == 1e-6
        moments = {name: float(text) for name, text in link.find("inertial/inertia").attrib.items()}
        assert moments == {"ixx": 1e-12, "ixy": 0, "ixz": 0, "iyy": 1e-12, "iyz": 0, "izz": 1e-12}


def test_the_link_of_sdf_has_almost_no_mass(calibration):
    """Without `<inertial>` SDFormat means 1 kg and 1 kg m^2."""
    inertial = ET.fromstring(sdf_text(calibration, Method.FREE)).find("model/link/inertial")
    assert float(inertial.findtext("mass")) == 1e-6
    moments = {each.tag: float(each.text) for each in inertial.find("inertia")}
    assert moments == {"ixx": 1e-9, "ixy": 0, "ixz": 0, "iyy": 1e-9, "iyz": 0, "izz": 1e-9}


def test_the_sites_stand_in_a_frame_that_can_be_attached(calibration):
    text = mjcf_text(calibration, Method.FREE)
    body = ET.fromstring(text).find("worldbody/body")
    assert [(each.tag, each.get("name")) for each in body] == [("frame", f"{LINK}_skin")]
    assert {each.tag for each in body.find("frame")} == {"site"}
    assert f'<attach model="{LINK}_skin" frame="{LINK}_skin" prefix=""/>' in text


def test_the_lines_of_the_manual_give_each_contact_to_its_taxel(calibration, tmp_path, monkeypatch):
    page = (Path(__file__).parents[3] / "docs" / "simulators.md").read_text(encoding="utf-8")
    lines = re.search(r"```python\n(taxels = .*?)```", page, re.DOTALL)[1]
    (tmp_path / "forearm.npz").write_bytes(npz_bytes(calibration, Method.SURFACE))
    monkeypatch.chdir(tmp_path)
    found = np.load("forearm.npz")
    turn, shift = Rotation.from_euler("xyz", [0.3, -1.0, 2.0]).as_matrix(), np.array([1.0, 2.0, 3.0])
    forces = np.array([[0, 0, 5.0], [3, 4, 0]])
    points = found["position"][[4, 9]] @ turn.T + shift + 1e-4
    names = {"numpy": np, "link_position": shift, "link_rotation": turn, "contact_points": points, "contact_forces": forces}
    exec(lines, names)
    assert names["answers"].tolist() == [5.0 if k in (4, 9) else 0.0 for k in range(len(found["channel"]))]
