"""Topics are proposed by what they carry over the whole bag, by the scene's joints and by their names, not by the alphabet."""

import numpy as np
import pytest

from skincal.cli import main
from skincal.files.importers.preview import RecordingFiles, guess_streams, preview_recording
from skincal.files.importers.registry import RecordedPlace
from skincal.model.readings import Stream
from skincal.ros.proposals import is_command, name_rank, natural_order
from tests.skincal.ros_support import (
    JOINT_NAMES,
    JOINTS_TYPE,
    SKIN_TYPE,
    WRENCH_TYPE,
    BagFile,
    joints_message,
    skin_message,
    wrench_message,
)


@pytest.mark.parametrize(
    "name",
    [
        "/joint_command",
        "/admittance/target_wrench",
        "/arm/jointCmd",
        "/desired_joints",
        "/arm/set_point",
        "/setpoints/ft",
        "/JointGoal",
    ],
)
def test_commands_are_known_by_their_names(name):
    assert is_command(name)


@pytest.mark.parametrize("name", ["/joint_states", "/ft_sensor/wrench", "/skin/raw", "/commander_robot/joint_states"])
def test_measured_values_are_no_commands(name):
    assert not is_command(name)


def test_usual_names_come_first_and_processed_values_last():
    names = ["/arm/filtered_joint_states", "/arm/angles", "/joint_states"]
    assert sorted(names, key=lambda name: name_rank(name, Stream.JOINTS)) == ["/joint_states", "/arm/angles", names[0]]
    assert name_rank("/ft/raw", Stream.WRENCH) < name_rank("/ft/filtered", Stream.WRENCH)
    assert sorted(["/t10", "/t9", "/t1/b", "/t1/a"], key=natural_order) == ["/t1/a", "/t1/b", "/t9", "/t10"]


def write(path, kind, topics, seconds=20.0):
    """Write topics at 20 Hz; each has a type and a function of the time that gives its values."""
    with BagFile(path, kind) as bag:
        for k in range(round(20 * seconds)):
            ns = 10**18 + k * 50_000_000
            for name, (type_name, values_at, *rest) in topics.items():
                values = values_at(k / 20)
                content = (
                    wrench_message(ns, values) if type_name == WRENCH_TYPE
                    else joints_message(ns, values, *rest) if type_name == JOINTS_TYPE
                    else {"data": values[0]} if type_name.endswith("/Float32")
                    else skin_message(values)
                )  # fmt: skip
                bag.add(name, type_name, ns, content)
    return bag.path


def moves_from(start_s, width):
    """Values that are constant until `start_s`."""
    return lambda t: np.arange(width) + 0.1 * max(0.0, t - start_s)


def still(width):
    return lambda _: np.arange(width, dtype=float)


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "ros1"])
def test_a_topic_that_moves_late_in_the_bag_comes_before_one_that_never_does(tmp_path, kind):
    topics = {
        "/a/wrench": (WRENCH_TYPE, still(6)),
        "/b/wrench": (WRENCH_TYPE, moves_from(12, 6)),
        "/a/skin": (SKIN_TYPE, still(24)),
        "/b/skin": (SKIN_TYPE, moves_from(15, 24)),
        "/a/joint_states": (JOINTS_TYPE, still(5)),
        "/b/joint_states": (JOINTS_TYPE, moves_from(17, 5)),
    }
    path = write(tmp_path / "bag", kind, topics)
    assert guess_streams([path]) == RecordingFiles(
        *(RecordedPlace(path, f"/b/{name}") for name in ("wrench", "skin", "joint_states"))
    )


def test_names_decide_between_topics_that_all_move(tmp_path):
    topics = {
        "/admittance/target_wrench": (WRENCH_TYPE, moves_from(0, 6)),
        "/ft/filtered": (WRENCH_TYPE, moves_from(0, 6)),
        "/ft/raw": (WRENCH_TYPE, moves_from(0, 6)),
        "/skin/filtered": (SKIN_TYPE, moves_from(0, 24)),
        "/skin/raw": (SKIN_TYPE, moves_from(0, 24)),
        "/joint_command": (JOINTS_TYPE, moves_from(0, 5)),
        "/joint_states": (JOINTS_TYPE, moves_from(9, 5)),
    }
    path = write(tmp_path / "bag", "mcap", topics)
    found = guess_streams([path], 24)
    assert [place.topic for place in found.places.values()] == ["/ft/raw", "/skin/raw", "/joint_states"]
    assert found.sentences_on_others([Stream.WRENCH, Stream.JOINTS]) == [
        "wrench: /ft/raw was chosen; it could be /admittance/target_wrench or /ft/filtered, too. "
        "If one of them is meant, name it.",
        "joints: /joint_states was chosen; it could be /joint_command, too. If one of them is meant, name it.",
    ]
    assert found.sentences_on_others([]) == []
    assert any("it could be /skin/filtered, too" in each for each in preview_recording(found).findings)
    only = write(tmp_path / "only", "mcap", {name: topics[name] for name in ("/ft/raw", "/skin/raw", "/joint_command")})
    assert guess_streams([only]).joints is None, "a command is never proposed"


def test_the_topic_with_the_joints_of_the_scene_is_proposed(tmp_path):
    topics = {
        "/joint_states": (JOINTS_TYPE, moves_from(0, 2), ("wheel_left", "wheel_right")),
        "/upper/angles": (JOINTS_TYPE, moves_from(0, 5)),
        "/ft": (WRENCH_TYPE, moves_from(0, 6)),
        "/skin": (SKIN_TYPE, moves_from(0, 24)),
    }
    path = write(tmp_path / "bag", "mcap", topics)
    assert guess_streams([path], 24).joints == RecordedPlace(path, "/joint_states")
    assert guess_streams([path], 24, ("", *JOINT_NAMES[1:])).joints == RecordedPlace(path, "/upper/angles")


def test_single_numbers_on_numbered_topics_are_a_skin_of_as_many_channels(tmp_path):
    topics = {f"/taxel/t{k}": ("std_msgs/msg/Float32", lambda t, k=k: [k + t]) for k in range(12)}
    topics |= {"/battery": ("std_msgs/msg/Float32", lambda t: [t]), "/ft": (WRENCH_TYPE, moves_from(0, 6))}
    path = write(tmp_path / "bag", "mcap", topics)
    assert guess_streams([path], 12).skin == RecordedPlace(path, "+".join(f"/taxel/t{k}" for k in range(12)))
    assert guess_streams([path], 5).skin is None
    assert guess_streams([path]).skin is None


def test_the_command_prints_the_other_topics(tmp_path, capsys):
    topics = {
        "/joint_command": (JOINTS_TYPE, moves_from(0, 5)),
        "/joint_states": (JOINTS_TYPE, moves_from(9, 5)),
        "/ft": (WRENCH_TYPE, moves_from(0, 6)),
        "/skin": (SKIN_TYPE, moves_from(0, 384)),
    }
    path = write(tmp_path / "bag", "mcap", topics)
    arguments = ["import", "rosbag", str(path), "--scene", "icub-forearm", "--out"]
    assert main([*arguments, str(tmp_path / "a")]) == 0
    said = capsys.readouterr()
    assert "joints: /joint_states was chosen; it could be /joint_command, too." in said.out + said.err
    # As the sentence says: the other one is named, and there are no others to tell.
    assert main([*arguments, str(tmp_path / "b"), "--joints", "/joint_command"]) == 0
    said = capsys.readouterr()
    assert "joints: /joint_command (sensor_msgs/msg/JointState)." in said.out + said.err
    assert "was chosen" not in said.out + said.err
