"""Readings of ROS messages: from bytes of both versions, from JSON, and from a laboratory's own definition."""

import math

import numpy as np
import pytest

from skincal.model.errors import InputError
from skincal.model.readings import Stream
from skincal.ros.layouts import find_layout
from skincal.ros.messages import JOINT_STATE, MessageReader, find_field, streams_of
from skincal.ros.patches import SkinPatches
from skincal.ros.topics import TopicChoice
from skincal.ros.types import MessageError, MessageTypes
from tests.skincal.ros_support import make_message

STAMP = {"sec": 1700000000, "nanosec": 250000000}
HEADER = {"stamp": STAMP, "frame_id": "sensor"}
SECONDS = 1700000000.25
LAB_TYPE = "lab_msgs/msg/TaxelData"
LAB_DEFINITION = "Header header\nuint8 cdc_length\nfloat32[] cdc\nstring name\nlab_msgs/Cell[2] cells\n"
CELL_DEFINITION = "float64 a\nuint8[] raw\n"
XYZ = ("x", "y", "z")


def vector(values):
    return dict(zip(XYZ, values, strict=True))


def xela(forces):
    taxels = [[vector((1, 2, 3)), vector((4, 5, 6))], [vector((7, 8, 9))]]
    sensors = [
        {"message": 5, "time": SECONDS, "model": "m", "sensor_pos": k, "taxels": each, "forces": forces[k]}
        for k, each in enumerate(taxels)
    ]
    return {"sensors": sensors}


WRENCH = {"force": vector((1.0, -2.0, 3.0)), "torque": vector((0.1, 0.2, -0.3))}
JOINTS = {"header": HEADER, "name": ["b", "wheel", "a"], "position": [0.5, 9.0, -1.0], "velocity": [], "effort": []}
SENSORS = [{"name": "l", "values": [1.5, 2.0]}, {"name": "r", "values": [0.25]}]
LAB = {"header": HEADER, "cdc_length": 2, "cdc": [3.0, 4.5], "name": "n", "cells": [{"a": 1.0, "raw": [7, 200]}] * 2}
POSE = {"position": vector((0.5, -0.25, 0.125)), "orientation": {**vector((0.0, 0.0, 0.0)), "w": 1.0}}
CASES = (
    ("geometry_msgs/msg/PoseStamped", "", {"header": HEADER, "pose": POSE}, Stream.TIP, [0.5, -0.25, 0.125]),
    ("geometry_msgs/msg/PointStamped", "", {"header": HEADER, "point": POSE["position"]}, Stream.TIP, [0.5, -0.25, 0.125]),
    ("geometry_msgs/msg/WrenchStamped", "", {"header": HEADER, "wrench": WRENCH}, Stream.WRENCH, [1, -2, 3, 0.1, 0.2, -0.3]),
    ("geometry_msgs/msg/WrenchStamped", "wrench.torque", {"header": HEADER, "wrench": WRENCH}, Stream.SKIN, [0.1, 0.2, -0.3]),
    ("geometry_msgs/msg/Wrench", "", WRENCH, Stream.WRENCH, [1, -2, 3, 0.1, 0.2, -0.3]),
    ("sensor_msgs/msg/JointState", "", JOINTS, Stream.JOINTS, np.degrees([0.5, 9.0, -1.0])),
    ("std_msgs/msg/UInt8MultiArray", "", {"layout": {"dim": [], "data_offset": 0}, "data": [0, 255]}, Stream.SKIN, [0, 255]),
    ("std_msgs/msg/Int32MultiArray", "", {"layout": {"dim": [], "data_offset": 0}, "data": [-7]}, Stream.SKIN, [-7]),
    ("sensor_msgs/msg/ChannelFloat32", "", SENSORS[0], Stream.SKIN, [1.5, 2.0]),
    ("tactile_msgs/msg/TactileState", "", {"header": HEADER, "sensors": SENSORS}, Stream.SKIN, [1.5, 2.0, 0.25]),
    ("tactile_msgs/msg/TactileState", "sensors[1].values", {"header": HEADER, "sensors": SENSORS}, Stream.SKIN, [0.25]),
    ("xela_server_ros2/msg/SensStream", "", xela([[], []]), Stream.SKIN, [3, 6, 9]),
    ("xela_server_ros2/msg/SensStream", "", xela([[vector((1, 2, 0.5))], [vector((1, 2, 0.75))]]), Stream.SKIN, [0.5, 0.75]),
    ("xela_server_ros/msg/SensStream", "", xela([[], []]), Stream.SKIN, [3, 6, 9]),
    ("xela_server_ros2/msg/SensStream", "sensors.taxels", xela([[], []]), Stream.SKIN, [1, 2, 3, 4, 5, 6, 7, 8, 9]),
    (LAB_TYPE, "", LAB, Stream.SKIN, [3.0, 4.5]),
    (LAB_TYPE, "cells.raw", LAB, Stream.SKIN, [7, 200, 7, 200]),
    (LAB_TYPE, "cells[1].raw[1]", LAB, Stream.SKIN, [200]),
    (LAB_TYPE, "cdc", LAB, Stream.JOINTS, np.degrees([3.0, 4.5])),
)


@pytest.fixture(params=[1, 2])
def types(request, tmp_path):
    (tmp_path / "TaxelData.msg").write_text(LAB_DEFINITION.replace("lab_msgs/Cell", "Cell"))
    (tmp_path / "Cell.msg").write_text(CELL_DEFINITION)
    found = MessageTypes(request.param)
    found.add_file(tmp_path / "TaxelData.msg", LAB_TYPE)
    return found


@pytest.mark.parametrize(("type_name", "field", "content", "stream", "expected"), CASES)
def test_bytes_and_json_give_the_same_values_and_stamp(types, type_name, field, content, stream, expected):
    message = make_message(types, type_name, content)
    store = types._store
    data = bytes((store.serialize_cdr if types.ros == 2 else store.serialize_ros1)(message, type_name))
    read = types.decode(data, type_name)
    assert stream in streams_of(types, type_name, field)
    for each in (read, content):
        reader = MessageReader(types, type_name, stream, field)
        np.testing.assert_allclose(reader.values_of(each), expected, rtol=1e-15)
        has_stamp = "header" in content or "Sens" in type_name
        assert reader.stamp_of(each) == (SECONDS if has_stamp else None)


def serialized(types, type_name, content, little_endian=True):
    message = make_message(types, type_name, content)
    if types.ros == 1:
        return bytes(types._store.serialize_ros1(message, type_name))
    return bytes(types._store.serialize_cdr(message, type_name, little_endian=little_endian))


@pytest.mark.parametrize("little_endian", [True, False])
@pytest.mark.parametrize("frame", ["", "ft", "odd_frame_é"])
@pytest.mark.parametrize(("type_name", "field", "content", "stream", "expected"), CASES)
def test_many_messages_are_read_as_one_by_one(types, type_name, field, content, stream, expected, frame, little_endian):
    content = content | {"header": HEADER | {"frame_id": frame}} if "header" in content else content
    good = serialized(types, type_name, content, little_endian)
    many, one = (MessageReader(types, type_name, stream, field) for _ in range(2))
    layout = find_layout(types, many, good)
    np.testing.assert_allclose(layout.read([good])[0], [expected], rtol=1e-15)
    # Any bytes where texts and lengths are not: numbers, NaN, and padding.
    messages = [good, *np.random.default_rng(1).integers(0, 256, (40, len(good)), np.uint8)]
    for each in messages[1:]:
        each[layout.fixed_at] = layout.fixed
    messages = [bytes(each) for each in messages]
    with np.errstate(all="ignore"):
        values, stamps = layout.read(messages)
        singles = [types.decode(each, type_name) for each in messages]
        np.testing.assert_array_equal(values, [one.values_of(each) for each in singles])
    np.testing.assert_array_equal(stamps, [np.nan if (s := one.stamp_of(each)) is None else s for each in singles])
    for at in layout.fixed_at:
        other = good[:at] + bytes([good[at] ^ 1]) + good[at + 1 :]
        assert layout.read([good, other]) is None
    assert layout.read([good, good + b"\0"]) is None


def test_joints_are_found_by_name_also_in_parts_of_the_robot(types):
    reader = MessageReader(types, "sensor_msgs/JointState", Stream.JOINTS, joints=("a", "b", "c"))
    assert reader.values_of(JOINTS) is None
    assert reader.missing_joints.startswith("No position of c came; the messages have b, wheel, a.")
    assert reader.values_of(JOINTS | {"name": ["gripper"], "position": [1.0]}) is None
    part = JOINTS | {"name": ["c"], "position": [0.25]}
    np.testing.assert_allclose(reader.values_of(part), np.degrees([-1.0, 0.5, 0.25]))
    assert reader.missing_joints == ""
    assert reader.values_of(JOINTS | {"position": []}) is None
    assert reader.silent_joints == ""
    later = {"header": {"stamp": {"sec": STAMP["sec"] + 2, "nanosec": 0}}, "name": ["c", "a"], "position": [0.0, 0.0]}
    reader.values_of(later)
    assert reader.silent_joints.startswith("No position of b comes any more")
    reader.values_of(later | {"name": [f"other{n}" for n in range(1000)], "position": [0.0] * 1000})
    assert len(reader.seen_joints) < 20
    with pytest.raises(MessageError, match="3 names and 1 positions"):
        reader.values_of(JOINTS | {"position": [1.0]})


def test_many_joint_states_of_a_part_take_the_other_joints_as_they_were(types):
    def data(names, position):
        return serialized(types, JOINT_STATE, JOINTS | {"name": names, "position": position})

    reader = MessageReader(types, JOINT_STATE, Stream.JOINTS, joints=("a", "", "c"))
    first, second = data(["a", "x", "a"], [7.0, 8.0, 0.5]), data(["a", "x", "a"], [7.0, 8.0, 0.75])
    assert find_layout(types, reader, first) is None  # c did not come yet
    reader.values_of(types.decode(data(["c"], [2.0]), JOINT_STATE))
    values, _ = find_layout(types, reader, first).read([first, second])
    np.testing.assert_array_equal(values, np.degrees([[0.5, 0, 2], [0.75, 0, 2]]))
    assert reader.seen_joints == {"a": 0.75, "x": 8.0, "c": 2.0}


def test_json_of_a_bridge_has_bytes_in_base64_and_null_for_nan(types):
    reader = MessageReader(types, "std_msgs/UInt8MultiArray", Stream.SKIN)
    assert reader.values_of({"data": "AP8="}).tolist() == [0, 255]
    reader = MessageReader(types, "std_msgs/Float32MultiArray", Stream.SKIN)
    assert math.isnan(reader.values_of({"data": [1.0, None]})[1])
    wrench, tactile, joints = (
        MessageReader(types, name, stream, field)
        for name, stream, field in (
            ("geometry_msgs/WrenchStamped", Stream.WRENCH, ""),
            ("tactile_msgs/TactileState", Stream.SKIN, "sensors[0].values"),
            (JOINT_STATE, Stream.JOINTS, ""),
        )
    )
    whole = MessageReader(types, "tactile_msgs/TactileState", Stream.SKIN)
    hostile = (
        *((joints, {"position": [1.0], "name": name}) for name in (5, None, [[1]], [None])),
        *((each, {"sensors": sensors}) for each in (tactile, whole) for sensors in (None, 5, {"a": 1}, [5])),
        (tactile, {"sensors": {}}),
        (wrench, {"wrench": 7}),
    )
    for each, message in hostile:
        with pytest.raises(MessageError):
            each.values_of(message)
    for stamp in (5, {"sec": 10**400}, {"sec": 1, "nanosec": 10**400}, {"sec": None}, {"sec": {}}, [], {"nanosec": "5"}):
        assert wrench.stamp_of({"header": {"stamp": stamp}}) is None
    for damaged in ({}, {"data": "AP8"}, {"data": [[1.0]]}, {"data": {"a": 1}}, {"data": ["x"]}, [], None):
        with pytest.raises(MessageError):
            reader.values_of(damaged)
    assert (
        MessageReader(types, "std_msgs/Header", Stream.SKIN, "stamp").stamp_of({"stamp": {"secs": 3, "nsecs": 5}}) == 3 + 5e-9
    )


def test_own_types_without_an_array_give_all_numbers():
    types = MessageTypes()
    types.add_definition(
        "a/P", "std_msgs/Header header\nfloat32 left\nstring s\na/Q q\n" + "=" * 80 + "\nMSG: a/Q\nint16 right\n"
    )
    assert find_field(types, "a/P") == ""
    reader = MessageReader(types, "a/P", Stream.SKIN)
    assert reader.values_of({"left": 1.5, "q": {"right": -3}}).tolist() == [1.5, -3]


def test_a_type_of_one_recording_is_none_of_another():
    MessageTypes().add_definition("a/P", "float32 left\n")
    assert not MessageTypes().is_standard("a/P")
    with pytest.raises(MessageError, match="a/msg/P"):
        MessageTypes().fields_of("a/P")


@pytest.mark.parametrize("part", ["Taxel", "lab_msgs/Taxel", "lab_msgs/msg/Taxel", "other_pkg/Taxel", "other_pkg/msg/Taxel"])
def test_definitions_of_parts_are_found_by_their_package(tmp_path, part):
    for package in ("lab_msgs", "other_pkg"):
        (tmp_path / package / "msg").mkdir(parents=True)
    (tmp_path / "lab_msgs/msg/Skin.msg").write_text(f"{part}[] taxels\n")
    (tmp_path / ("other_pkg" if "other" in part else "lab_msgs") / "msg/Taxel.msg").write_text("Cell cell\n")
    (tmp_path / ("other_pkg" if "other" in part else "lab_msgs") / "msg/Cell.msg").write_text("float32[] raw\n")
    types = MessageTypes()
    types.add_file(tmp_path / "lab_msgs/msg/Skin.msg", "lab_msgs/Skin")
    assert find_field(types, "lab_msgs/Skin") == "taxels.cell.raw"


@pytest.mark.parametrize("type_name", ["sensor_msgs/msg/CompressedImage", "std_msgs/msg/String", "nobody/msg/Knows"])
def test_types_that_no_sensor_publishes_are_not_proposed(type_name):
    assert streams_of(MessageTypes(), type_name) == ()


@pytest.mark.parametrize(
    ("type_name", "field", "words"),
    [
        ("nobody/Knows", "", "nobody/msg/Knows has no definition here; add its .msg file"),
        ("std_msgs/String", "data", "is text; expected numbers"),
        ("std_msgs/Header", "stamp.minute", "'minute' is not among sec, nanosec"),
        ("std_msgs/Header", "stamp[0]", "has no such element"),
        ("std_msgs/Float32MultiArray", "data[0", "is not among layout, data"),
        ("std_msgs/Empty2", "", "has no definition"),
        ("a b", "", "is no type of a ROS message"),
    ],
)
def test_fields_that_do_not_exist_are_named(type_name, field, words):
    with pytest.raises(InputError, match=words.replace("[", r"\[")):
        MessageReader(MessageTypes(), type_name, Stream.SKIN, field)


@pytest.mark.parametrize(
    "definition",
    [
        "flo at x",
        "int32 \x00",
        "a/B[] more\n",
        "float64[4000000000] x\n",
        "uint8[] x\nFoo f\n",
        "=" * 80 + "\nMSG: a/B\n",
        "x" * (1 << 21),
    ],
)
def test_hostile_definitions_give_a_sentence(definition):
    def read():
        types = MessageTypes()
        types.add_definition("a/B", definition)
        return MessageReader(types, "a/B", Stream.SKIN).values_of(types.decode(b"\0\1\0\0" + b"\xff" * 100, "a/B"))

    with pytest.raises((InputError, MessageError)):
        read()


def test_damaged_bytes_give_a_sentence_or_values(types):
    message = make_message(types, LAB_TYPE, LAB)
    store = types._store
    good = bytes((store.serialize_cdr if types.ros == 2 else store.serialize_ros1)(message, LAB_TYPE))
    reader, refused = MessageReader(types, LAB_TYPE, Stream.SKIN), 0
    for at in range(len(good)):
        for damaged in (good[:at], good[:at] + bytes([good[at] ^ 0xFF]) + good[at + 1 :], good + bytes(at)):
            try:
                reader.values_of(types.decode(damaged, LAB_TYPE))
            except MessageError:
                refused += 1
    assert refused > len(good)


def test_two_definitions_of_one_type_are_refused():
    types = MessageTypes()
    types.add_definition("a/B", "int32 x\n")
    with pytest.raises(InputError, match="one definition"):
        types.add_definition("a/B", "int16 x\n")


def test_patches_make_frames_in_the_order_of_their_topics():
    patches = SkinPatches(["/a", "/b"])
    assert patches.add(1, np.array([3.0])) is None
    assert patches.add(1, np.array([4.0])) is None
    assert patches.waiting_for == ["/a"]
    assert patches.add(0, np.array([1.0, 2.0])).tolist() == [1, 2, 4]
    assert patches.superseded == [0, 1]
    assert patches.add(0, np.array([9.0, 9.0])) is None


def joined(arrivals):
    """Frames of (patch, stamp), with the stamp as value; and the patches."""
    patches = SkinPatches(["/a", "/b"])
    frames = [patches.add(patch, np.array([stamp]), stamp) for patch, stamp in arrivals]
    return [each.tolist() for each in frames if each is not None], patches


@pytest.mark.parametrize(
    ("lost", "late_s", "ahead_s"),
    [
        (set(), 0.1, 0.0),
        ({(0, 5)}, 0.1, 0.0),
        ({(1, 5)}, 0.1, 0.0),
        ({(0, 5), (1, 8), (1, 9)}, 0.4, 0.0),
        ({(0, 5)}, 0.1, -3.3),
    ],
)
def test_a_lost_message_shifts_no_patch(lost, late_s, ahead_s):
    arrivals = [(patch, n + patch * late_s) for n in range(40) for patch in (0, 1) if (patch, n) not in lost]
    # Messages of one patch come in groups: no order of arrival may matter.
    arrivals.sort(key=lambda each: each[1] + each[0] * ahead_s)
    frames, patches = joined(arrivals)
    complete = [n for n in range(40) if not {(0, n), (1, n)} & lost]
    # Before the period is known, messages are joined as they come.
    assert [each for each in frames if each[0] > 4] == [[n, n + late_s] for n in complete if n > 4]
    assert patches.stamp_s == frames[-1][0]
    assert len(frames) * 2 + sum(patches.superseded) + sum(map(len, patches._waiting)) == len(arrivals)


def test_the_slowest_patch_sets_the_rate_and_takes_the_nearest_of_the_others():
    arrivals = sorted([(0, n / 4) for n in range(80)] + [(1, n + 0.55) for n in range(20)], key=lambda each: each[1])
    frames, _ = joined(arrivals)
    assert [each for each in frames if each[1] > 3] == [[n + 0.5, n + 0.55] for n in range(3, 20)]


def test_patches_with_stamps_of_two_clocks_are_joined_as_they_come():
    frames, patches = joined([(patch, n + 1000.0 * patch) for n in range(200) for patch in (0, 1)])
    assert {round(b - a) for a, b in frames[50:]} <= {999, 1000}
    assert len(frames) > 120
    assert "different clocks" in patches.problem


@pytest.mark.parametrize(
    "text", ["/a", "/skin/a+/skin/b?field=sensors[0].values", "/j?joints=l_elbow,l_wrist", "/s?field=cdc&msg=/home/x%2By/T.msg"]
)
def test_topics_are_written_as_they_are_read(text):
    choice = TopicChoice.parse(text)
    assert str(choice) == text
    assert TopicChoice.parse(str(choice)) == choice


@pytest.mark.parametrize("text", ["", "/a+", "/a b", "/a?filed=x", "7"])
def test_wrong_topics_are_refused(text):
    with pytest.raises(InputError):
        TopicChoice.parse(text)
