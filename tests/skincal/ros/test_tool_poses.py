"""Poses of a tool from messages of ROS: which frames are taken, which are refused, and the way through a link's decoder."""

import json

import numpy as np
import pytest

from skincal.devices.decoding import pack
from skincal.devices.ros2 import write_head
from skincal.devices.rosbridge import RosbridgeDecoder
from skincal.model.errors import InputError
from skincal.model.readings import Loss, Stream
from skincal.ros.tool_poses import POSE_STAMPED, TF_MESSAGE, TRANSFORM_STAMPED, ToolPoseReader
from skincal.ros.topics import TopicChoice
from skincal.ros.types import MessageError

PLACE, TURN = (0.1, -0.2, 0.3), (0.038135, 0.189308, 0.239298, 0.951549)


def named(values):
    return dict(zip("xyzw", values, strict=False))


def header(frame, seconds=7):
    return {"stamp": {"sec": seconds, "nanosec": 500_000_000}, "frame_id": frame}


def pose(frame="base"):
    return {"header": header(frame), "pose": {"position": named(PLACE), "orientation": named(TURN)}}


def transform(child="tool0", parent="base", place=PLACE):
    return {
        "header": header(parent),
        "child_frame_id": child,
        "transform": {"translation": named(place), "rotation": named(TURN)},
    }


def test_a_pose_and_a_transform_give_the_same_numbers():
    for reader, message in ((ToolPoseReader(POSE_STAMPED), pose()), (ToolPoseReader(TRANSFORM_STAMPED), transform())):
        found = reader.find_pose(message)
        np.testing.assert_allclose(found.values, [*PLACE, *TURN])
        assert (found.parent, found.stamp_s) == ("base", 7.5)


def test_the_wanted_transform_of_many_is_found_in_its_base():
    reader = ToolPoseReader(TF_MESSAGE, "tool0", "base")
    others = [transform("elbow", place=(1, 1, 1)), transform("tool0", "base_link", (2, 2, 2))]
    np.testing.assert_allclose(reader.find_pose({"transforms": [*others, transform("/tool0", "/base")]}).values[:3], PLACE)
    assert reader.find_pose({"transforms": [others[0]]}) is None
    assert reader.problem == ""
    assert reader.find_pose({"transforms": others}) is None
    # One frame has moved to another parent.
    assert "tool0 belongs to the tree of base_link, base to that of base" in reader.problem


def test_a_frame_that_changes_is_refused():
    reader = ToolPoseReader(POSE_STAMPED)
    assert reader.find_pose(pose("base")) is not None
    assert reader.find_pose(pose("base_link")) is None
    assert "base_link; expected base" in reader.problem


def test_a_tree_of_frames_needs_a_choice_and_other_types_are_no_poses():
    for chosen in ({}, {"frame": "tool0"}, {"base": "base"}):
        with pytest.raises(InputError, match=r"ros2:/tf\?frame=tool0&base=base"):
            ToolPoseReader(TF_MESSAGE, **chosen)
    with pytest.raises(InputError, match="hold no pose of a tool"):
        ToolPoseReader("geometry_msgs/msg/PointStamped")


def test_a_damaged_message_is_an_error():
    with pytest.raises(MessageError, match="orientation is missing"):
        ToolPoseReader(POSE_STAMPED).find_pose({"header": header("base"), "pose": {"position": named(PLACE)}})


def published(message):
    return pack(1, json.dumps({"op": "publish", "topic": "/tf", "msg": message}).encode())


def test_a_decoder_gives_the_rows_of_the_pose_and_counts_what_is_none():
    choice = TopicChoice.parse("/tf?frame=tool0&base=base")
    assert str(choice) == "/tf?frame=tool0&base=base"
    decoder = RosbridgeDecoder(None, (Stream.TOOL,))
    lost = transform()
    lost["transform"] = {"translation": named((0, 0, 0)), "rotation": named((0, 0, 0, 0))}
    data = write_head(choice, [TF_MESSAGE], {}) + b"".join(
        published({"transforms": each}) for each in ([transform()], [transform("elbow")], [lost], [transform("tool0", "world")])
    )
    (batch,) = decoder.feed(data)
    assert batch.stream is Stream.TOOL
    np.testing.assert_allclose(batch.values[0].reshape(3, 4)[:, 3], PLACE)
    np.testing.assert_allclose(batch.values[0].reshape(3, 4)[0, :3], [0.813798, -0.440970, 0.378522], atol=2e-6)
    assert np.isnan(batch.values[1]).all()
    assert batch.device_s[0] == 7.5
    assert decoder.counts == {Loss.NO_POSE: 1, Loss.OTHER_FRAME: 1}
