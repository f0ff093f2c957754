"""Targets by ROS 2: a robot's own node reads them and answers, on the loopback interface."""

import json
import time
from contextlib import closing
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")

from skincal.model.errors import InputError
from skincal.robot.ros_targets import STRING, RosTargets, parse_ros_targets, quaternion_along
from skincal.robot.target_lines import Answer, AnswerKind, Held, Judged, NoTarget, PokeTarget
from skincal.robot.target_server import ROBOT_LINES_PER_S_MAX, RobotChange, TargetServer
from skincal.robot.targets import check_targets, open_targets
from skincal.ros.dds import Message, Participant
from skincal.taxels.result import State
from tests.skincal.meanwhile import PATIENCE_S
from tests.skincal.ros.dds_peer import DOMAIN, Peer, PoseStamped, String

PLACE, PUSH = np.array([0.01, -0.02, 0.03]), np.array([0.6, 0.0, -0.8])
TARGET = PokeTarget(7, 12, PLACE, PUSH, False, "forearm", "1", 9.5, 0.6)


def until(found, take, count):
    """Take until so many were found."""
    end_s = time.monotonic() + PATIENCE_S
    while len(found) < count:
        assert time.monotonic() < end_s, found
        found += take()
        time.sleep(0.01)
    return found


def test_a_robot_reads_targets_and_verdicts_also_later_and_answers():
    with closing(RosTargets(DOMAIN)) as targets:
        targets.send([TARGET])
        peer = Peer()  # comes later: the target is latched
        reader = peer.reader("/skincal/target", PoseStamped, latched=True)
        (target,) = until([], lambda: reader.take(10), 1)
        assert target.header.frame_id == "forearm"
        assert abs(target.header.stamp.sec - time.time()) < PATIENCE_S
        place, turn = target.pose.position, target.pose.orientation
        assert (place.x, place.y, place.z) == tuple(PLACE)
        x, y, z, w = turn.x, turn.y, turn.z, turn.w
        assert np.allclose([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], PUSH, atol=1e-12)
        words = peer.reader("/skincal/verdict", String, latched=True)
        first = until([], lambda: words.take(10), 1)
        targets.send([Held(7), Judged(7), Judged(8, "too light"), NoTarget.WAIT])
        told = [json.loads(each.data) for each in until(first, lambda: words.take(10), 5)]
        assert told[0] == {
            "target": 7, "channel": 12, "known_point": False, "frame": "forearm", "pose": "1",
            "place": PLACE.tolist(), "push": PUSH.tolist(), "force": 9.5, "hold": 0.6,
        }  # fmt: skip
        assert told[1:] == [
            {"held": 7},
            {"verdict": "accepted", "number": 7, "reason": ""},
            {"verdict": "rejected", "number": 8, "reason": "too light"},
            {"state": "wait"},
        ]
        peer.publish("/skincal/reached", String("robot 0.1 2"))
        came = until([], targets.read_answers, 2)
        assert came[:2] == [RobotChange.CAME, "A robot connected by ROS 2."]
        for text in ("reached 7", "skip 8 too far", "dance", ""):
            peer.publish("/skincal/reached", String(text))
        found = until(came[2:], targets.read_answers, 3)
        assert [each for each in found if isinstance(each, Answer)] == [
            Answer(AnswerKind.REACHED, 7),
            Answer(AnswerKind.SKIP, 8, "too far"),
        ]
        assert "A message on /skincal/reached is not used: it says 'dance'" in "".join(x for x in found if isinstance(x, str))
        targets.refuse("it answers 9")
        assert until([], targets.read_answers, 1) == ["An answer on /skincal/reached is not used: it answers 9"]
        peer.drop("/skincal/reached")
        assert RobotChange.LEFT in until([], targets.read_answers, 2)
    last = [json.loads(each.data) for each in until([], lambda: words.take(10), 3)]
    assert last[1:] == [{"state": "wait"}, {"state": "stop"}]


def test_a_flood_and_refused_writes_are_one_sentence_each(monkeypatch):
    with closing(RosTargets(DOMAIN)) as targets:
        flood = [Message(k * 10**6, targets._types.encode(String(f"reached {k}"), STRING)) for k in range(300)]
        monkeypatch.setattr(targets._answers, "take_messages", lambda: flood)
        found = targets.read_answers()
        assert sum(isinstance(each, Answer) for each in found) == ROBOT_LINES_PER_S_MAX
        assert [each for each in found if isinstance(each, str)] == [
            "The robot sends more than 50 lines in a second; those beyond are not used."
        ]
        monkeypatch.setattr(targets._answers, "take_messages", list)
        for writer in (targets._target, targets._verdict, targets._taxels):
            monkeypatch.setattr(writer, "_write", lambda *_: -10)
        targets.send([TARGET, TARGET, NoTarget.WAIT])
        targets.show_taxels("forearm", [SimpleNamespace(state=State.UNSEEN, position=None)])
        (sentence, *_) = found = targets.read_answers()
        assert sentence.startswith("DDS does not write a geometry_msgs/msg/PoseStamped")
        targets.send([TARGET, NoTarget.WAIT])
        assert len(found) == 3
        assert targets.read_answers() == []


def test_positions_of_taxels_are_latched_markers():
    estimates = [
        SimpleNamespace(state=State.TOUCHED, position=PLACE),
        SimpleNamespace(state=State.UNSEEN, position=None),
        SimpleNamespace(state=State.TOUCHED, position=-PLACE),
    ]
    with closing(RosTargets(DOMAIN)) as targets, closing(Participant(DOMAIN)) as viewer:
        targets.show_taxels("forearm", estimates[:2])
        targets.show_taxels("forearm", estimates)
        targets.show_taxels("forearm", estimates)
        reader = viewer.reader("/skincal/taxels", "visualization_msgs/msg/MarkerArray", latched=True)
        found = until([], reader.take_messages, 1)
        assert len(found) == 1
        (marker,) = viewer.types.decode(found[0].data, "visualization_msgs/msg/MarkerArray").markers
        targets.show_taxels("forearm", estimates[1:2])
        (last,) = until([], reader.take_messages, 1)
        (none,) = viewer.types.decode(last.data, "visualization_msgs/msg/MarkerArray").markers
    assert (marker.header.frame_id, marker.type, marker.action, marker.scale.x) == ("forearm", 7, 0, 0.004)
    assert [(each.x, each.y, each.z) for each in marker.points] == [tuple(PLACE), tuple(-PLACE)]
    assert none.action == 3


def test_frames_of_taxels_are_latched_static_transforms():
    turned = np.eye(4)
    turned[:3, :3], turned[:3, 3] = Rotation.from_rotvec([0.3, -1.2, 0.5]).as_matrix(), PLACE
    with closing(RosTargets(DOMAIN)) as targets, closing(Participant(DOMAIN)) as viewer:
        reader = viewer.reader("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
        targets.show_frames("tip", {})
        targets.show_frames("tip", {3: turned})
        targets.show_frames("tip", {3: turned.copy()})
        (first,) = until([], reader.take_messages, 1)
        targets.show_frames("tip", {3: turned, 4: np.eye(4)})
        (second,) = until([], reader.take_messages, 1)
        (one,), both = (viewer.types.decode(each.data, "tf2_msgs/msg/TFMessage").transforms for each in (first, second))
    assert (one.header.frame_id, one.child_frame_id) == ("tip", "tip_taxel_3")
    place, turn = one.transform.translation, one.transform.rotation
    assert (place.x, place.y, place.z) == tuple(PLACE)
    np.testing.assert_allclose(Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix(), turned[:3, :3], atol=1e-12)
    assert [each.child_frame_id for each in both] == ["tip_taxel_3", "tip_taxel_4"]


@pytest.mark.parametrize("push", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -0.6, -0.8)])
def test_z_of_the_pose_is_the_direction_of_the_push(push):
    x, y, z, w = quaternion_along(np.array(push, float))
    assert x * x + y * y + z * z + w * w == pytest.approx(1.0)
    assert [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)] == pytest.approx(list(push), abs=1e-9)


def test_the_option_names_a_port_or_a_domain(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    assert (parse_ros_targets("ros2:"), parse_ros_targets("ros2:?domain=7")) == (DOMAIN, 7)
    with closing(open_targets("0")) as server:
        assert isinstance(server, TargetServer)
    with closing(open_targets("ros2:")) as targets:
        assert targets.place == f"/skincal/target of ROS 2 domain {DOMAIN}"
    for wrong in ("ros2:7", "ros2:?domain=400", "ros2:?port=1", "ros2:/x"):
        with pytest.raises(InputError, match="expected"):
            check_targets(wrong)
