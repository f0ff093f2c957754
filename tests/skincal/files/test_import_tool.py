"""Recordings of a tool's poses become sessions: bags with a moving frame, tables and robometry logs give the same estimates."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import skincal
from skincal.cli import main
from skincal.files.importers.arrays import guess_streams as guess_arrays
from skincal.files.importers.arrays import open_recording as open_arrays
from skincal.files.importers.preview import guess_streams, preview_recording
from skincal.files.importers.registry import RecordedPlace
from skincal.files.importers.rosbag import open_recording as open_bag
from skincal.files.importers.yarp_folder import open_recording as open_yarp
from skincal.model.errors import InputError
from skincal.model.pose_form import PoseForm, RotationForm
from skincal.model.readings import Loss, Stream
from skincal.model.scene import load_scene
from skincal.session.importing import check_recorded_tool, find_topics, of_scene
from skincal.session.replay import load
from skincal.streams.decoders.auto_detect import make_decoder
from skincal.taxels.result import Method
from tests.skincal.files.test_robometry import MatFile
from tests.skincal.ros_support import SKIN_TYPE, BagFile, header, skin_message
from tests.skincal.session.test_no_sensor import MARKS, readings, scene_of, scene_text
from tests.skincal.session.test_tool_rig import TAXELS

POSE, TREE = "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage"
FORM = 'rotation = "xyzw"\nunit = "m"\n'
START_NS = 1_700_000_000 * 10**9
POKES = np.concatenate([MARKS[:3], TAXELS[::3], TAXELS[::3]])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Times (n,) s and values of both streams, and the folder of the scene."""
    folder = tmp_path_factory.mktemp("tool")
    scene_of(folder, scene_text(FORM))
    every = list(readings(POKES))
    return folder, {
        name: (np.array([t for of, t, _ in every if of == name]), np.array([v for of, _, v in every if of == name]))
        for name in ("skin", "tool")
    }


def transform(stamp_ns, parent, child, values):
    place, turn = dict(zip("xyz", values[:3], strict=True)), dict(zip("xyzw", values[3:], strict=True))
    return {"header": header(stamp_ns) | {"frame_id": parent}, "child_frame_id": child} | {
        "transform": {"translation": place, "rotation": turn}
    }


def write_bag(path, streams, kind):
    """Write a bag; `kind` is the type of the poses. A `/tf` has the joints of an arm, and a base that does not move, too."""
    with BagFile(path, "mcap") as bag:
        for t, row in zip(*streams["skin"], strict=True):
            bag.add("/skin", SKIN_TYPE, START_NS + round(1e9 * t), skin_message(row))
        for t, row in zip(*streams["tool"], strict=True):
            ns = START_NS + round(1e9 * t)
            if kind == POSE:
                pose = {
                    "position": dict(zip("xyz", row[:3], strict=True)),
                    "orientation": dict(zip("xyzw", row[3:], strict=True)),
                }
                bag.add("/tool", POSE, ns, {"header": header(ns) | {"frame_id": "base"}, "pose": pose})
                continue
            joint = [0.0, 0.1, 0.3, *Rotation.from_rotvec([0.0, 0.0, np.sin(t)]).as_quat()]
            bag.add("/tf", TREE, ns, {"transforms": [transform(ns, "shoulder", "upper_arm", joint)]})
            bag.add("/tf", TREE, ns, {"transforms": [transform(ns, "base", "tool0", row)]})
    return bag.path


def write_arm_bag(path, streams):
    """Write a bag whose tool hangs at an arm: a `/tf` of two joints, each in a message of its own, and a latched `/tf_static`.

    The first joint turns as it likes, so the second one's place and turn are those that put the tool where it is.
    """
    mount = [0.0, 0.0, 0.1, *Rotation.from_rotvec([0.0, 0.0, -np.pi / 2]).as_quat()]
    base = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]

    def matrix(pose):
        found = np.eye(4)
        found[:3, :3], found[:3, 3] = Rotation.from_quat(pose[3:]).as_matrix(), pose[:3]
        return found

    with BagFile(path, "mcap") as bag:
        for t, row in zip(*streams["skin"], strict=True):
            bag.add("/skin", SKIN_TYPE, START_NS + round(1e9 * t), skin_message(row))
        for k, (t, row) in enumerate(zip(*streams["tool"], strict=True)):
            ns = START_NS + round(1e9 * t)
            shoulder = [0.0, 0.1, 0.3, *Rotation.from_rotvec([0.0, 0.0, np.sin(t)]).as_quat()]
            rest = np.linalg.inv(matrix(shoulder)) @ matrix(base) @ matrix(row) @ np.linalg.inv(matrix(mount))
            elbow = [*rest[:3, 3], *Rotation.from_matrix(rest[:3, :3]).as_quat()]
            bag.add("/tf", TREE, ns, {"transforms": [transform(ns, "base_link", "upper_arm", shoulder)]})
            bag.add("/tf", TREE, ns, {"transforms": [transform(ns, "upper_arm", "flange", elbow)]})
            if k == 1:  # late, as in a bag that began before its publisher
                fixed = [transform(ns, "flange", "tool0", mount), transform(ns, "base_link", "base", base)]
                bag.add("/tf_static", TREE, ns, {"transforms": fixed})
    return bag.path


def test_a_tool_at_an_arm_of_several_transforms_gives_the_poses_of_one(made, tmp_path, capsys):
    folder, streams = made
    short = {name: (times[:200], rows[:200]) for name, (times, rows) in streams.items()}
    bag = write_arm_bag(tmp_path / "arm", short)
    found = open_bag({Stream.SKIN: RecordedPlace(bag, "/skin"), Stream.TOOL: RecordedPlace(bag, "/tf?frame=tool0&base=base")})
    decoder = make_decoder("records", None, (Stream.TOOL,))
    poses = np.concatenate(
        [batch.values for chunk in found.chunks() if chunk.link == "tool" for batch in decoder.feed(chunk.data)]
    )
    expected = np.concatenate([Rotation.from_quat(short["tool"][1][:, 3:]).as_matrix(), short["tool"][1][:, :3, None]], axis=2)
    np.testing.assert_allclose(poses.reshape(-1, 3, 4), expected, atol=1e-9)
    assert any("its poses are in the frame base" in each for each in found.findings)
    assert not any("gave no pose" in each for each in found.findings)
    guesses = guess_streams([bag], 9)
    assert guesses.places[Stream.TOOL].topic == "/tf?frame=tool0&base=base_link", "the root and the frame with a tool's name"
    scene, topics = folder / "scene.toml", ["--skin", "/skin", "--tool", "/tf?frame=tool0&base=wall"]
    assert main(["import", "rosbag", str(bag), *topics, "--scene", str(scene), "--out", str(tmp_path / "out")]) == 2
    assert "No transform of wall has come; frames that came: base, base_link, flange" in " ".join(
        capsys.readouterr().err.split()
    )


def test_messages_after_a_transform_that_stopped_are_counted_and_the_reason_is_said(tmp_path):
    turn = [0.0, 0.0, 0.0, 1.0]
    with BagFile(tmp_path / "stopped", "mcap") as bag:
        for k in range(200):
            ns = START_NS + k * 20_000_000
            bag.add("/skin", SKIN_TYPE, ns, skin_message(np.zeros(9)))
            bag.add("/tf", TREE, ns, {"transforms": [transform(ns, "base", "flange", [0.4, 0.001 * k, 0.3, *turn])]})
            if k <= 100:
                bag.add("/tf", TREE, ns, {"transforms": [transform(ns, "flange", "tool0", [0.0, 0.0, 0.1, *turn])]})
    path = bag.path
    found = open_bag({Stream.SKIN: RecordedPlace(path, "/skin"), Stream.TOOL: RecordedPlace(path, "/tf?frame=tool0&base=base")})
    # The last 2 s have no flange_from_tool0; the first of them is too new to be missed.
    (said,) = [each for each in found.findings if "gave no pose" in each]
    assert 40 <= int(re.search(r"(\d+) messages gave no pose", said)[1]) <= 50
    assert "The transform of tool0 in flange is" in said


def write_tables(folder, streams, names=("x", "y", "z", "qx", "qy", "qz", "qw")):
    heads = {"skin": [f"t{n}" for n in range(9)], "tool": [f"tcp_{name}" for name in names]}
    for name, (times, rows) in streams.items():
        lines = (f"{t!r},{','.join(map(repr, row))}\n" for t, row in zip(times.tolist(), rows.tolist(), strict=True))
        (folder / f"{name}.csv").write_text(f"t_s,{','.join(heads[name])}\n{''.join(lines)}")
    return ["--skin", str(folder / "skin.csv"), "--tool", str(folder / "tool.csv")]


def write_log(path, streams):
    log = MatFile(path)
    for name, channel in (("tool", "tool_pose"), ("skin", "skins::plate")):
        log.channel(channel, streams[name][1], times=streams[name][0])
    return log.close()


def imported(scene, out, arguments, capsys):
    """Import, and give the positions of the free method and the findings."""
    capsys.readouterr()
    assert main(["import", *map(str, arguments), "--scene", str(scene), "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    found = load(out).snapshot().estimates[Method.FREE]
    return result, np.array([np.full(3, np.nan) if each.position is None else each.position for each in found])


def poses_in(recording, form):
    """Upper rows (n, 3, 4) of the tool's poses of a recording, read in a form."""
    (link,) = [each for each in recording.links if each.name == "tool"]
    decoder = make_decoder(link.format, None, (Stream.TOOL,))
    decoder.set_pose_form(PoseForm(form), 1.0)
    data = [chunk.data for chunk in recording.chunks() if chunk.link == "tool"]
    return np.concatenate([batch.values for each in data for batch in decoder.feed(each)]).reshape(-1, 3, 4)


def matrices(rows):
    return np.concatenate([Rotation.from_quat(rows[:, 3:]).as_matrix(), rows[:, :3, None]], axis=2)


def test_arrays_of_quaternions_and_matrices_give_the_same_poses(made, tmp_path):
    _, streams = made
    (times, skin), (_, rows) = ((t[:200], v[:200]) for t, v in (streams["skin"], streams["tool"]))
    upper = matrices(rows)
    whole = np.concatenate([upper, np.broadcast_to([[[0.0, 0.0, 0.0, 1.0]]], (len(upper), 1, 4))], axis=1)
    np.savez(tmp_path / "log.npz", t=times, tactile=skin, tool_pose=rows, ee_matrix=whole, upper_pose=upper)
    path = tmp_path / "log.npz"
    for name, form, said in (
        ("tool_pose", RotationForm.QUATERNION_XYZW, "poses of 7 values"),
        ("ee_matrix", RotationForm.MATRIX, "poses of 4 x 4"),
        ("upper_pose", RotationForm.MATRIX, "poses of 3 x 4"),
    ):
        found = open_arrays({Stream.SKIN: RecordedPlace(path, "tactile"), Stream.TOOL: RecordedPlace(path, name)})
        np.testing.assert_allclose(poses_in(found, form), upper, atol=1e-9)
        assert any(said in each for each in found.findings)
    guessed = {each.place.topic for each in guess_arrays(path) if each.stream is Stream.TOOL}
    assert guessed == {"tool_pose", "ee_matrix", "upper_pose"}
    with pytest.raises(InputError, match=r"a row of tactile has 9 values; expected a pose"):
        open_arrays({Stream.TOOL: RecordedPlace(path, "tactile")})


def test_a_table_of_arrays_with_two_markers_is_no_pose(tmp_path):
    columns = [(name, "f8") for name in ("t", "x_a", "y_a", "z_a", "x_b", "y_b", "z_b")]
    np.save(tmp_path / "log.npy", np.ones(50, columns))
    with pytest.raises(InputError, match="are x_a, y_a, z_a, x_b, y_b, z_b, the places of several things; expected the place"):
        open_arrays({Stream.TOOL: RecordedPlace(tmp_path / "log.npy", "*")})


def test_a_log_of_yarp_gives_the_poses_of_its_cartesian_controller(made, tmp_path):
    """The state of iCub's Cartesian controller: x y z, an axis and the angle about it."""
    _, streams = made
    times, rows = (each[:200] for each in streams["tool"])
    vectors = Rotation.from_quat(rows[:, 3:]).as_rotvec()
    angles = np.linalg.norm(vectors, axis=1, keepdims=True)
    values = np.hstack([rows[:, :3], vectors / angles, angles])
    (tmp_path / "data.log").write_text(
        "".join(
            f"{k} {1e9 + t:.6f} {' '.join(map(repr, row))}\n"
            for k, (t, row) in enumerate(zip(times, values.tolist(), strict=True))
        )
    )
    (tmp_path / "info.log").write_text(
        "Type: Bottle;\n[0.0] /icub/cartesianController/right_arm/state:o [connected]\nStamp: tx;\n"
    )
    found = open_yarp({Stream.TOOL: RecordedPlace(tmp_path)})
    np.testing.assert_allclose(poses_in(found, RotationForm.AXIS_ANGLE), matrices(rows), atol=1e-9)
    as_quaternions = poses_in(open_yarp({Stream.TOOL: RecordedPlace(tmp_path)}), RotationForm.QUATERNION_XYZW)
    assert np.isnan(as_quaternions).all(), "an axis and an angle are no quaternion"
    (tmp_path / "data.log").write_text("0 1000000000.0 1 2 3\n1 1000000000.1 1 2 3\n")
    with pytest.raises(InputError, match="its lines hold 3 values; expected a pose of the tool: 6, 7, 12 or 16"):
        open_yarp({Stream.TOOL: RecordedPlace(tmp_path)})


def test_columns_that_name_another_order_of_the_quaternion_than_the_scene_are_refused(made, tmp_path, capsys):
    folder, streams = made
    short = {name: (times[:60], rows[:60]) for name, (times, rows) in streams.items()}
    tables = write_tables(tmp_path, short, ("x", "y", "z", "qw", "qx", "qy", "qz"))
    out = tmp_path / "out"
    assert main(["import", "csv", *tables, "--scene", str(folder / "scene.toml"), "--out", str(out)]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert 'name the quaternion in the order w x y z, and scene.toml has rotation = "xyzw" in [tool]' in said
    assert not out.exists()


@pytest.mark.parametrize(
    ("names", "rotation", "unit", "degrees", "says"),
    [
        ("qx qy qz qw x y z", "xyzw", "m", "", "the rotation before the place; expected x y z, then the rotation"),
        ("rx ry rz x y z", "vector", "m", "false", "the rotation before the place"),
        ("a b c x y z", "abc", "m", "false", "the rotation before the place"),
        ("roll pitch yaw x y z", "rpy", "m", "false", "the rotation before the place"),
        ("a_x a_y a_z b_x b_y b_z", "vector", "m", "false", "the places of several things; expected the place x y z and"),
        ("x1 y1 z1 x2 y2 z2", "rpy", "m", "true", "the places of several things"),
        ("hand_x hand_y hand_z arm_rx arm_ry arm_rz", "vector", "m", "false", "the place of one thing and the rotation of"),
        ("x_mm y_mm z_mm rx ry rz", "vector", "m", "false", 'the lengths in mm, and scene.toml has unit = "m" in [tool]'),
        ("x y z roll_deg pitch_deg yaw_deg", "rpy", "m", "false", "the angles in deg, and scene.toml has degrees = false"),
        ("x y z roll_rad pitch_rad yaw_rad", "rpy", "m", "true", "the angles in rad, and scene.toml has degrees = true"),
        ("x_[mm] y_[mm] z_[mm] a_[deg] b_[deg] c_[deg]", "abc", "mm", "true", ""),
        ("x_m y_m z_m qx qy qz qw", "xyzw", "m", "", ""),
        ("tx ty tz qx qy qz qw", "xyzw", "m", "", ""),
        ("tx ty tz q0 qx qy qz", "xyzw", "m", "", 'the quaternion in the order w x y z, and scene.toml has rotation = "xyzw"'),
        ("tx ty tz q0 qx qy qz", "wxyz", "m", "", ""),
        ("q0 qx qy qz tx ty tz", "wxyz", "m", "", "the rotation before the place"),
    ],
)
def test_column_names_that_contradict_the_form_of_the_poses_are_refused(
    tmp_path, monkeypatch, capsys, names, rotation, unit, degrees, says
):
    # The middle of a long sentence is left out, and a path is part of it.
    monkeypatch.chdir(tmp_path)
    form = f'rotation = "{rotation}"\nunit = "{unit}"\n' + f"degrees = {degrees}\n" * bool(degrees)
    scene_of(tmp_path, scene_text(form))
    times, columns = np.arange(60) / 50, names.split()
    rows = np.full((60, len(columns)), 0.1)
    rows[:, :3] = 100.0 if unit == "mm" else 0.1
    rows[:, 6:] = np.sqrt(1.0 - 3 * 0.01)
    tables = write_tables(Path(), {"skin": (times, np.zeros((60, 9))), "tool": (times, rows)}, columns)
    code = main(["import", "csv", *tables, "--scene", "scene.toml", "--out", "out"])
    assert says in " ".join(capsys.readouterr().err.split())
    assert code == (2 if says else 0)
    assert (tmp_path / "out").exists() != bool(says)


def test_a_header_of_streamed_lines_is_compared_with_the_scene():
    row = "0.1,-0.2,0.3,0.038135,0.189308,0.239298,0.951549\n"
    for names, poses in (("qx,qy,qz,qw", 5), ("qw,qx,qy,qz", 0), ("a,b,c,d", 5)):
        decoder = make_decoder("text", None, (Stream.TOOL,))
        decoder.set_pose_form(PoseForm(RotationForm.QUATERNION_XYZW), 1.0)
        batches = decoder.feed(f"t_s,x,y,z,{names}\n{''.join(f'{k}.0,{row}' for k in range(5))}".encode())
        assert sum(len(batch.seq) for batch in batches) == poses
        assert decoder.counts[Loss.NO_POSE] == 5 - poses
        assert ("in the order w x y z" in decoder.device_message) == (poses == 0)


def test_units_and_order_in_a_header_of_streamed_lines_are_compared_with_the_scene():
    for names, says in (
        ("x_m,y_m,z_m,rx,ry,rz", ""),
        ("x_mm,y_mm,z_mm,rx,ry,rz", 'The header names the lengths in mm, and the scene has unit = "m" in [tool]'),
        ("x,y,z,rx_deg,ry_deg,rz_deg", "The header names the angles in deg, and the scene has degrees = false in [tool]"),
        ("rx,ry,rz,x,y,z", "The header is rx ry rz x y z, the rotation before the place; expected x y z, then the rotation"),
        ("a_x,a_y,a_z,b_x,b_y,b_z", "The header is a_x a_y a_z b_x b_y b_z, the places of several things; expected"),
    ):
        decoder = make_decoder("text", None, (Stream.TOOL,))
        decoder.set_pose_form(PoseForm(RotationForm.ROTATION_VECTOR), 1.0)
        batches = decoder.feed(f"t_s,{names}\n{''.join(f'{k}.0,0.1,-0.2,0.3,0.1,0.2,0.3{chr(10)}' for k in range(5))}".encode())
        assert sum(len(batch.seq) for batch in batches) == (0 if says else 5)
        assert says in decoder.device_message


def test_python_reads_the_poses_of_a_tool(made, tmp_path):
    folder, streams = made
    short = {name: (times[:150], rows[:150]) for name, (times, rows) in streams.items()}
    write_tables(tmp_path, short)
    plate = skincal.Scene.load(folder / "scene.toml")
    by_tables = skincal.read_csv(plate, None, tmp_path / "skin.csv", tool=tmp_path / "tool.csv")
    by_bag = skincal.read_bag(plate, write_bag(tmp_path / "tree", short, TREE), tool="/tf?frame=tool0&base=base")
    assert by_tables.pokes
    assert len(by_bag.pokes) == len(by_tables.pokes)
    with pytest.raises(InputError, match="expected the link of the tool's poses"):
        skincal.read_csv(plate, None, tmp_path / "skin.csv")


def test_bag_tables_and_log_give_the_same_estimates(made, tmp_path, capsys):
    folder, streams = made
    scene = folder / "scene.toml"
    _, by_tables = imported(scene, tmp_path / "a", ["csv", *write_tables(tmp_path, streams)], capsys)
    assert np.isfinite(by_tables).all(axis=1).sum() == 3
    result, by_tree = imported(scene, tmp_path / "b", ["rosbag", write_bag(tmp_path / "tree", streams, TREE)], capsys)
    assert any("/tf?frame=tool0&base=base" in each for each in result["findings"])
    _, by_log = imported(scene, tmp_path / "c", ["robometry", write_log(tmp_path / "log.mat", streams)], capsys)
    for other in (by_tree, by_log):
        np.testing.assert_allclose(other, by_tables, atol=1e-4, equal_nan=True)


def test_the_frame_that_moves_is_proposed_and_poses_of_another_form_too(made, tmp_path):
    _, streams = made
    short = {name: (times[:150], rows[:150]) for name, (times, rows) in streams.items()}
    found = guess_streams([write_bag(tmp_path / "pose", short, POSE)], 9)
    assert found.places[Stream.TOOL].topic == "/tool"
    found = guess_streams([write_bag(tmp_path / "tree", short, TREE)], 9)
    assert found.places[Stream.TOOL].topic == "/tf?frame=tool0&base=base", "a joint only turns"
    write_tables(tmp_path, short)
    found = guess_streams([tmp_path / "tool.csv", tmp_path / "skin.csv"], 9)
    assert found.places[Stream.TOOL].path.name == "tool.csv"
    assert found.places[Stream.SKIN].path.name == "skin.csv"
    found = guess_streams([write_log(tmp_path / "log.mat", short)], 9)
    assert found.places[Stream.TOOL].topic == "tool_pose"


def test_a_preview_of_a_rig_without_a_sensor_has_skin_and_tool(made, tmp_path):
    folder, streams = made
    scene = load_scene(folder / "scene.toml")
    short = {name: (times[:150], rows[:150]) for name, (times, rows) in streams.items()}
    write_tables(tmp_path, short)
    files = of_scene(guess_streams([tmp_path / "tool.csv", tmp_path / "skin.csv"], 9), scene)
    preview = preview_recording(files)
    assert {each.stream for each in preview.streams} == {Stream.SKIN, Stream.TOOL}
    assert preview.misfits(scene, "") == ()
    assert any("order x y z w" in each for each in preview.findings)
    assert not any("left out" in each for each in preview.findings)


def test_what_is_missing_or_in_another_order_is_named(made, tmp_path, capsys):
    folder, streams = made
    short = {name: (times[:60], rows[:60]) for name, (times, rows) in streams.items()}
    bag = write_bag(tmp_path / "tree", short, TREE)

    def refused(arguments, scene=folder / "scene.toml"):
        assert main(["import", *map(str, arguments), "--scene", str(scene), "--out", str(tmp_path / "out")]) == 2
        return " ".join(capsys.readouterr().err.split())

    tables = write_tables(tmp_path, short)
    assert "expected the link of the tool's poses" in refused(["csv", *tables[:2]])
    assert "name the tool's and its base" in refused(["rosbag", bag, "--skin", "/skin", "--tool", "/tf"])
    tables = write_tables(tmp_path, short, ("x", "y", "z", "qz", "qy", "qx", "qw"))
    assert "in the order z y x w" in refused(["csv", *tables])
    bare = tmp_path / "bare"
    bare.mkdir()
    scene_of(bare, scene_text())
    tables = write_tables(tmp_path, short)
    assert "numbers do not say the form of a pose" in refused(["csv", *tables], bare / "scene.toml")
    with pytest.raises(InputError, match="the link of the tool's poses"):
        check_recorded_tool(load_scene(bare / "scene.toml"), {Stream.SKIN: RecordedPlace(bag, "/skin")})
    assert find_topics(bag, {}, load_scene(bare / "scene.toml"), None)[0].keys() == {Stream.SKIN, Stream.TOOL}
