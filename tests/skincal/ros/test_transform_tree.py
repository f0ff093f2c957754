"""Chains of transforms: against the product of matrices, at one time, with static ones, with breaks, and through links."""

import json
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from skincal.devices.decoding import pack
from skincal.devices.ros2 import write_head
from skincal.devices.rosbridge import RosbridgeDecoder, RosbridgeHandshake
from skincal.model.readings import Loss, Stream
from skincal.ros.tool_poses import TF_MESSAGE, ToolPoseReader
from skincal.ros.topics import TopicChoice
from skincal.ros.transform_tree import TransformTree, frame_pairs

JOINTS = ("base_link", "link1", "link2", "link3", "flange")


def matrix(pose):
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = Rotation.from_quat(pose[3:]).as_matrix(), pose[:3]
    return found


def joint(number, time_s):
    """Pose of a link in the one before it: it keeps its place and turns about an axis of its own."""
    axis = np.eye(3)[number % 3]
    return (0.1 * number, 0.05, 0.2, *Rotation.from_rotvec(axis * math.sin(0.7 * time_s + number)).as_quat().tolist())


def arm(time_s):
    """Truth: the flange in base_link."""
    found = np.eye(4)
    for number in range(1, len(JOINTS)):
        found = found @ matrix(joint(number, time_s))
    return found


TOOL0 = (0.0, 0.0, 0.1, *Rotation.from_rotvec([0.0, 0.0, -np.pi / 2]).as_quat().tolist())
BASE = (0.1, -0.2, 0.3, *Rotation.from_rotvec([0.3, 0.0, 2.0]).as_quat().tolist())
"""Static: the tool at the flange, and `base` in `base_link`."""


def tree_with_static(frame="tool0", base="base"):
    tree = TransformTree(frame, base)
    tree.add("flange", "tool0", None, TOOL0, is_static=True)
    tree.add("base_link", "base", None, BASE, is_static=True)
    return tree


def truth(time_s):
    return np.linalg.inv(matrix(BASE)) @ arm(time_s) @ matrix(TOOL0)


def test_a_chain_is_the_product_of_its_matrices_also_against_a_sibling_frame():
    tree = tree_with_static()
    for k in range(20):
        t = 100.0 + 0.02 * k
        for number in range(1, len(JOINTS)):
            assert tree.add(JOINTS[number - 1], JOINTS[number], t, joint(number, t), is_static=False)
        stamp_s, pose = tree.take_pose()
        assert stamp_s == t
        np.testing.assert_allclose(matrix(pose), truth(t), atol=1e-12)
        assert tree.take_pose() is None, "one pose a time"


def test_transforms_of_several_senders_are_taken_at_one_time():
    """The first joint comes each 30 ms, the others each 10 ms and later: the chain is that of the newest common time."""
    tree, taken = tree_with_static(), []
    for k in range(100):
        t = 50.0 + 0.01 * k
        if k % 3 == 0:
            tree.add("base_link", "link1", t, joint(1, t), is_static=False)
        for number in range(2, len(JOINTS)):
            late = t - 0.004 * number
            tree.add(JOINTS[number - 1], JOINTS[number], late, joint(number, late), is_static=False)
        found = tree.take_pose()
        taken += [] if found is None else [found]
    assert len(taken) >= 32
    stamps = [stamp for stamp, _ in taken]
    assert stamps == sorted(set(stamps))
    errors = [np.abs(matrix(pose) - truth(stamp)).max() for stamp, pose in taken]
    assert max(errors) < 1e-4, "a joint of 0.49 rad/s^2, interpolated over 30 ms: 0.49 * 0.03^2 / 8 = 5.5e-5 rad"
    last = [np.abs(matrix(pose) - truth(stamp + 0.016)).max() for stamp, pose in taken]
    assert max(last) > 1e-3, "another time is another pose"


def test_a_slow_transform_whose_messages_are_late_is_taken_with_one_of_1_khz():
    tree, taken = TransformTree("link2", "base_link"), []
    for k in range(4000):
        t = 50.0 + 0.001 * k
        tree.add("base_link", "link1", t, joint(1, t), is_static=False)
        if k % 1000 == 999:
            late = t - 0.8
            tree.add("link1", "link2", late, joint(2, late), is_static=False)
        taken += filter(None, [tree.take_pose()])
    assert [stamp for stamp, _ in taken] == pytest.approx([50.199, 51.199, 52.199, 53.199])
    for stamp, pose in taken:
        np.testing.assert_allclose(matrix(pose), matrix(joint(1, stamp)) @ matrix(joint(2, stamp)), atol=1e-6)


def test_the_rotation_between_two_stamps_is_that_of_slerp():
    first, second = Rotation.from_rotvec([0.1, 0.2, 0.3]), Rotation.from_rotvec([-1.0, 0.4, 2.0])
    tree = TransformTree("b", "a")
    for stamp, turn in ((1.0, first), (2.0, second)):
        tree.add("a", "m", stamp, (stamp, 0.0, 0.0, *(-turn.as_quat()).tolist()), is_static=False)
    tree.add("m", "b", 1.25, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), is_static=False)
    stamp, pose = tree.take_pose()
    assert stamp == 1.25
    expected = Slerp([1.0, 2.0], Rotation.concatenate([first, second]))(1.25)
    assert (Rotation.from_quat(pose[3:]).inv() * expected).magnitude() < 1e-12
    assert pose[0] == pytest.approx(1.25)


def test_a_break_in_the_chain_is_named_with_the_frames_that_came():
    tree = TransformTree("tool0", "base")
    tree.add("base", "link1", 1.0, joint(1, 1.0), is_static=False)
    assert tree.take_pose() is None
    assert tree.problem == "No transform of tool0 has come; frames that came: base, link1"
    tree.add("link2", "tool0", 1.0, TOOL0, is_static=False)
    assert tree.take_pose() is None
    assert tree.problem == (
        "No transforms lead from base to tool0: tool0 belongs to the tree of link2, base to that of base; frames that came: "
        "base, link1, link2, tool0"
    )
    tree.add("link1", "link2", 1.0, joint(2, 1.0), is_static=False)
    assert tree.take_pose() is not None
    assert tree.problem == ""


def test_a_frame_that_is_moved_to_another_parent_leaves_the_one_before():
    tree = TransformTree("tool0", "base")
    tree.add("base", "flange", 1.0, joint(1, 1.0), is_static=False)
    tree.add("flange", "tool0", None, TOOL0, is_static=True)
    np.testing.assert_allclose(matrix(tree.take_pose()[1]), matrix(joint(1, 1.0)) @ matrix(TOOL0), atol=1e-12)
    tree.add("flange", "changer", None, BASE, is_static=True)
    tree.add("changer", "tool0", None, TOOL0, is_static=True)
    tree.add("base", "flange", 2.0, joint(1, 2.0), is_static=False)
    moved = matrix(joint(1, 2.0)) @ matrix(BASE) @ matrix(TOOL0)
    np.testing.assert_allclose(matrix(tree.take_pose()[1]), moved, atol=1e-12)


def test_a_transform_that_is_no_longer_published_gives_no_pose():
    tree = TransformTree("b", "a")
    tree.add("a", "m", 10.0, joint(1, 10.0), is_static=False)
    poses = 0
    for k in range(300):
        tree.add("m", "b", 10.0 + 0.01 * k, joint(2, 10.0 + 0.01 * k), is_static=False)
        poses += tree.take_pose() is not None
    assert poses == 1
    assert tree.is_late
    assert tree.problem == "The transform of m in a is 3.0 s older than others of its chain: is it still published?"


def test_a_sender_that_starts_again_with_an_earlier_clock_is_followed():
    tree = TransformTree("b", "a")
    for start in (100.0, 5.0):
        for k in range(5):
            t = start + 0.01 * k
            tree.add("a", "m", t, joint(1, t), is_static=False)
            tree.add("m", "b", t, joint(2, t), is_static=False)
            stamp, pose = tree.take_pose()
            assert stamp == t
            np.testing.assert_allclose(matrix(pose), matrix(joint(1, t)) @ matrix(joint(2, t)), atol=1e-12)


def test_a_lost_transform_of_a_chain_is_no_pose():
    tree = TransformTree("b", "a")
    tree.add("a", "m", 1.0, joint(1, 1.0), is_static=False)
    tree.add("m", "b", 1.0, (0.0,) * 7, is_static=False)
    assert tree.take_pose()[1] == (0.0,) * 7, "zeros, which a reader drops and counts"


def test_the_pairs_of_root_and_leaf_are_those_of_chains():
    assert frame_pairs({("a", "b"), ("b", "c"), ("a", "d"), ("x", "y")}) == [("a", "c")]
    assert frame_pairs({("a", "b"), ("b", "a")}) == []


# ------------------------------------------------------------------ through a link


def message(*transforms):
    def header(parent, stamp):
        return {"stamp": {"sec": int(stamp), "nanosec": round(1e9 * (stamp % 1.0))}, "frame_id": parent}

    def named(values):
        return dict(zip("xyzw", values, strict=False))

    return {
        "transforms": [
            {
                "header": header(parent, stamp),
                "child_frame_id": child,
                "transform": {"translation": named(pose[:3]), "rotation": named(pose[3:])},
            }
            for parent, child, stamp, pose in transforms
        ]
    }


def published(topic, content):
    return pack(1, json.dumps({"op": "publish", "topic": topic, "msg": content}).encode())


def test_a_link_with_its_static_topic_gives_the_chain():
    choice = TopicChoice.parse("/tf+/tf_static?frame=tool0&base=base")
    decoder = RosbridgeDecoder(None, (Stream.TOOL,))
    moving = [
        published("/tf", message(*((JOINTS[n - 1], JOINTS[n], t, joint(n, t)) for n in range(1, len(JOINTS)))))
        for t in (7.5, 7.75, 8.0)
    ]
    static = published("/tf_static", message(("flange", "tool0", 3.0, TOOL0), ("base_link", "base", 3.0, BASE)))
    head = write_head(choice, [TF_MESSAGE, TF_MESSAGE], {})
    batches = decoder.feed(head + moving[0])
    assert batches == []
    assert "No transform of tool0 or base has come" in decoder.device_message
    assert decoder.counts == {Loss.OTHER_FRAME: 1}
    (batch,) = decoder.feed(static + moving[1] + published("/tf", message(("map", "cart", 7.9, BASE))) + moving[2])
    assert batch.device_s.tolist() == [7.5, 7.75, 8.0]
    for row, stamp in zip(batch.values, batch.device_s, strict=True):
        np.testing.assert_allclose(row.reshape(3, 4), truth(stamp)[:3], atol=1e-9)
    assert decoder.counts == {Loss.OTHER_FRAME: 1}
    assert decoder.device_message == ""


def test_rosbridge_subscribes_to_the_static_topic_if_somebody_publishes_it():
    def answer(topic, type_name):
        return pack(
            1, json.dumps({"op": "service_response", "id": topic, "values": {"type": type_name}, "result": True}).encode()
        )

    for static_type, expected in (("tf2_msgs/TFMessage", {"/tf", "/tf_static"}), ("", {"/tf"})):
        handshake = RosbridgeHandshake(("/tf", "/tf_static"), "", ("/tf_static",))
        sent = handshake.on_data(answer("/tf", "tf2_msgs/TFMessage")) + handshake.on_data(answer("/tf_static", static_type))
        assert {json.loads(line)["topic"] for line in sent.decode().splitlines()} == expected


def test_a_single_transform_is_read_as_it_came():
    reader = ToolPoseReader(TF_MESSAGE, "tool0", "base")
    found = reader.find_pose(message(("base", "tool0", 7.5, TOOL0)))
    assert found.values.tolist() == list(TOOL0)
