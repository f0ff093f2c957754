"""Programs read the exports that the manual recommends: `python3 -m pytest tests/consumers/by_name`.

Each has an environment of its own below `out/`, which is made at the first run: a few minutes and 4 GB for all of them.
"""

import re
import shutil
import subprocess
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.files.consumers import EXPORT_CONSUMERS
from skincal.files.export import write_calibration
from skincal.files.formats import ExportOptions, Inertia
from skincal.files.reference import read_place_sets
from skincal.taxels.result import Method
from tests.consumers.by_name.installed import read_with
from tests.consumers.flat_pad import flat_calibration
from tests.consumers.robots import (
    LINK,
    Kinematics,
    Skin,
    assert_taxels_are_right,
    read_kinematics,
    without_massless_leaves,
)
from tests.consumers.test_whole_frames import assert_frames_are_right, make_turned, write

pytestmark = pytest.mark.timeout(1200)  # installs the programs
CHOICE = {each.program: each for each in EXPORT_CONSUMERS}
SMALL_SDF = f"""<sdf version="1.9"><model name="arm">
  <link name="base"><inertial><mass>2.5</mass></inertial></link>
  <link name="{LINK}"><pose>0.1 0.2 0.3 0.4 0.5 0.6</pose><inertial><mass>0.5</mass></inertial></link>
  <joint name="turn" type="revolute"><parent>base</parent><child>{LINK}</child><axis><xyz>0 1 0</xyz>
    <limit><lower>-1</lower><upper>1</upper></limit></axis></joint>
</model></sdf>"""


def write_for(program: str, skin: Skin, tmp_path, robot=None, prefix: str | None = None):
    """Write the export that the manual recommends for a program."""
    each = CHOICE[program]
    inertia = Inertia.TINY if "--inertia tiny" in each.options else Inertia.NONE
    into = robot if "--into" in each.options else None
    path = tmp_path / f"{program}{each.format_.suffix}"
    return skin.write(each.format_.value, path, ExportOptions(prefix=prefix, inertia=inertia, into=into))


def check_robot(reader: str, path, skin: Skin, mine: Kinematics, tmp_path, **more):
    """Compare joints and poses; return the reader's result."""
    angles = [mine.random_angles(seed) for seed in range(3)]
    found, said = read_with(reader, tmp_path, file=path, base=mine.base, angles=angles, names=skin.names(), **more)
    assert sorted(found["moving"]) == sorted(mine.moving)
    for each, poses in zip(angles, found["poses"], strict=True):
        placed = {name: np.array(pose) for name, pose in poses.items()}
        assert_taxels_are_right(placed, skin, mine.pose(LINK, each))
    return found, said


def alone(reader: str, robot, mine: Kinematics, tmp_path):
    return read_with(reader, tmp_path, file=robot, base=mine.base, angles=[mine.random_angles(0)], names=[])[0]


def test_idyntree_finds_every_taxel(skin: Skin, icub, tmp_path):
    mine = read_kinematics(icub)
    found, _ = check_robot("idyntree", write_for("iDynTree", skin, tmp_path, icub), skin, mine, tmp_path)
    before = alone("idyntree", icub, mine, tmp_path)
    assert found["moving"] == before["moving"]
    assert found["mass"] == pytest.approx(before["mass"], abs=1e-9)


def test_idyntree_reads_a_tactile_sensor_without_an_error(skin: Skin, icub, tmp_path):
    path, mine = write_for("RViz", skin, tmp_path, icub), read_kinematics(icub)
    found, said = read_with("idyntree", tmp_path, file=path, base=mine.base, angles=[], names=[])
    assert "ERROR" not in said
    assert found["mass"] == pytest.approx(mine.mass, abs=1e-9)
    path.write_text(path.read_text().replace(' type="tactile"', ""))
    assert "type is required" in read_with("idyntree", tmp_path, file=path, base=mine.base, angles=[], names=[])[1]


def test_pybullet_finds_every_taxel_without_new_mass(skin: Skin, icub, tmp_path):
    robot = without_massless_leaves(icub, tmp_path / "small.urdf")
    mine = read_kinematics(robot)
    found, _ = check_robot("pybullet", write_for("PyBullet", skin, tmp_path, robot), skin, mine, tmp_path)
    before = alone("pybullet", robot, mine, tmp_path)
    assert found["mass"] - before["mass"] == pytest.approx(len(skin.channels) * 1e-6, abs=1e-7)


def test_urchin_finds_every_taxel_without_new_mass(skin: Skin, icub, tmp_path):
    mine = read_kinematics(icub)
    found, _ = check_robot("urchin", write_for("PyBullet", skin, tmp_path, icub), skin, mine, tmp_path)
    before = alone("urchin", icub, mine, tmp_path)
    assert found["mass"] - before["mass"] == pytest.approx(len(skin.channels) * 1e-6, abs=1e-9)


def test_drake_welds_the_skin_to_the_robot_without_new_mass(skin: Skin, icub, tmp_path):
    mine, path = read_kinematics(icub), write_for("Drake", skin, tmp_path)
    before = alone("drake", icub, mine, tmp_path)
    skins = [{"file": str(path), "link": LINK}]
    found, _ = check_robot("drake", icub, skin, mine, tmp_path, skins=skins)
    assert found["bodies"] == before["bodies"] + 1
    assert found["mass"] - before["mass"] == pytest.approx(1e-6, abs=1e-9)
    one = read_with("drake", tmp_path, file=icub, base=mine.base, angles=[mine.random_angles(0)], names=[], skins=skins)[0]
    np.testing.assert_allclose(one["mass_matrix"], before["mass_matrix"], atol=1e-5)


def test_drake_reads_two_skins_and_a_whole_robot(skin: Skin, icub, tmp_path):
    mine = read_kinematics(icub)
    skins = [{"file": str(write_for("Drake", skin, tmp_path)), "link": LINK}]
    (tmp_path / "second").mkdir()
    skins.append({"file": str(write_for("Drake", skin, tmp_path / "second", prefix="second_")), "link": LINK})
    check_robot("drake", icub, skin, mine, tmp_path, skins=skins)
    found, _ = check_robot("drake", skin.write("urdf", tmp_path / "w.urdf", ExportOptions(into=icub)), skin, mine, tmp_path)
    assert found["mass"] == pytest.approx(mine.mass, abs=1e-9)


def test_drake_and_gazebo_read_a_robot_in_sdf(skin: Skin, tmp_path):
    robot = tmp_path / "robot.sdf"
    robot.write_text(SMALL_SDF)
    path = write_for("Gazebo", skin, tmp_path, robot)
    task = {"base": LINK, "angles": [{"turn": 0.4}], "names": skin.names()}
    found, _ = read_with("drake", tmp_path, file=path, **task)
    assert (found["mass"], found["moving"], found["bodies"]) == (3.0, ["turn"], 3)
    assert_taxels_are_right({name: np.array(pose) for name, pose in found["poses"][0].items()}, skin, np.eye(4))


def run_sdformat(*words) -> str:
    command = next((found for each in ("gz", "ign") if (found := shutil.which(each))), None)
    if command is None:
        pytest.skip("neither gz nor ign is installed (Debian: ignition-tools and libsdformat-dev)")
    done = subprocess.run([command, "sdf", *words], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def frames_of(text: str) -> dict[str, ET.Element]:
    return {each.get("name"): each for each in ET.fromstring(text).iter("frame")}


def test_gazebos_parser_reads_the_skin_alone_and_in_the_icub(skin: Skin, icub, tmp_path):
    path = write_for("Drake", skin, tmp_path)
    assert "Valid" in run_sdformat("-k", path)
    assert set(frames_of(run_sdformat("-p", path))) == set(skin.names())
    # The conversion drops the links without mass, so that the skin goes on another one here.
    robot = tmp_path / "icub.sdf"
    robot.write_text(re.sub(r"(?<=['\">])r_forearm(?=['\"<])", LINK, run_sdformat("-p", icub)))
    out = write_for("Gazebo", skin, tmp_path, robot)
    assert "Valid" in run_sdformat("-k", out)
    printed = run_sdformat("-p", out)
    frames = frames_of(printed)
    for name, (position, _) in skin.poses().items():
        pose = frames[name].find("pose")
        assert (frames[name].get("attached_to"), pose.get("relative_to")) == (LINK, LINK)
        np.testing.assert_allclose([float(word) for word in pose.text.split()][:3], position, atol=1e-6)
    masses = [[float(each.text) for each in ET.fromstring(text).iter("mass")] for text in (printed, robot.read_text())]
    assert masses[0] == masses[1]


def test_an_older_sdf_is_converted_as_its_sentence_says(skin: Skin, tmp_path):
    robot = tmp_path / "old.sdf"
    robot.write_text(SMALL_SDF.replace('"1.9"', '"1.6"'))
    with pytest.raises(Exception, match=re.escape("gz sdf -p old.sdf > robot.sdf")):
        write_for("Gazebo", skin, tmp_path, robot)
    converted = tmp_path / "robot.sdf"
    converted.write_text(run_sdformat("-p", robot))
    assert set(frames_of(write_for("Gazebo", skin, tmp_path, converted).read_text())) == set(skin.names())


@pytest.mark.parametrize("program", ["pinocchio", "RViz"])
def test_check_urdf_reads_the_icub_with_taxels(skin: Skin, icub, tmp_path, program):
    """urdfdom is the parser of RViz and robot_state_publisher."""
    command = shutil.which("check_urdf")
    if command is None:
        pytest.skip("check_urdf is not installed (Debian: liburdfdom-tools)")
    path = write_for(program, skin, tmp_path, icub)
    done = subprocess.run([command, path], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, "Error" in done.stderr) == (0, False), done.stderr
    if program == "pinocchio":
        assert all(re.search(rf"child\(\d+\): +{name}$", done.stdout, re.MULTILINE) for name in skin.names())
    else:
        (found,) = read_place_sets(path)
        assert sorted(found.places) == skin.channels


def assert_points_are_right(positions, normals, quality, skin: Skin) -> None:
    np.testing.assert_allclose(positions, [position for position, _ in skin.poses().values()], atol=1e-7)
    np.testing.assert_allclose(normals, [normal for _, normal in skin.poses().values()], atol=1e-6)
    np.testing.assert_allclose(np.ravel(quality), 1.0, atol=1e-6)


def test_open3d_keeps_every_number(skin: Skin, tmp_path):
    found, _ = read_with("open3d", tmp_path, file=write_for("Open3D", skin, tmp_path))
    assert_points_are_right(found["positions"], found["normals"], found["quality"], skin)
    assert np.ravel(found["channel"]).tolist() == skin.channels
    assert {"method", "sd_mm"} <= set(found)


def test_meshlab_keeps_the_quality(skin: Skin, tmp_path):
    found, _ = read_with("pymeshlab", tmp_path, file=write_for("MeshLab", skin, tmp_path))
    assert_points_are_right(found["positions"], found["normals"], found["quality"], skin)


def test_blender_keeps_every_number(skin: Skin, tmp_path):
    found, _ = read_with("blender", tmp_path, file=write_for("Blender", skin, tmp_path))
    assert_points_are_right(found["position"], found["normal"], found["quality"], skin)
    assert found["channel"] == skin.channels
    assert {"method", "sd_mm"} <= set(found)


def test_nb_touch_reads_positions_and_rotations_and_finds_a_push(tmp_path):
    calibration, rotations = flat_calibration(tmp_path)
    each = CHOICE["nb-touch"]
    path = tmp_path / f"tip{each.format_.suffix}"
    write_calibration(calibration, each.format_.value, path, Method.FREE)
    reading = [0.3, -0.2, -1.5]
    found, _ = read_with("nb_touch", tmp_path, file=path, pushed=[0, 5], reading=reading)
    places = np.array([estimate.position for estimate in calibration.estimates_by(Method.FREE)])
    np.testing.assert_allclose(found["positions"], places, atol=1e-9)
    np.testing.assert_allclose(found["orientations"], rotations, atol=1e-8)
    for taxel, push in zip((0, 5), found["pushes"], strict=True):
        np.testing.assert_allclose(push["cop"], places[taxel], atol=1e-6)
        np.testing.assert_allclose(push["force"], rotations[taxel] @ reading, atol=1e-4)


@pytest.fixture(scope="module")
def turned(tmp_path_factory):
    return make_turned(tmp_path_factory.mktemp("part"))


def test_urchin_reads_the_whole_frame_of_urdf(turned, tmp_path):
    path, names = write(turned, "urdf", tmp_path)[0], [f"{LINK}_taxel_{channel}" for channel in turned[1].channels]
    found, _ = read_with("urchin", tmp_path, file=path, base=LINK, angles=[{}], names=names)
    assert_frames_are_right({name: np.array(pose) for name, pose in found["poses"][0].items()}, turned)


def test_gazebos_parser_reads_the_whole_frame_of_sdf(turned, tmp_path):
    found = {}
    for name, frame in frames_of(run_sdformat("-p", write(turned, "sdf", tmp_path)[0])).items():
        *place, roll, pitch, yaw = map(float, frame.find("pose").text.split())
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix(), place
        found[name] = pose
    assert_frames_are_right(found, turned)
