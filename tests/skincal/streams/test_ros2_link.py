"""Topics of ROS 2 over DDS on the loopback interface: real publishers in this and in other processes, killed and changed."""

import json
import sys
import time
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")

from cyclonedds.idl import make_idl_struct

from skincal.cli import devices, main
from skincal.devices import ros2
from skincal.devices.link import FailureKind, LinkError
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, LinkEvent, LinkState, Loss, Stream
from skincal.model.scene import load_scene
from skincal.ros import dds
from skincal.ros.topics import TopicChoice
from skincal.ros.types import MessageTypes
from skincal.streams import ros_topics
from skincal.streams.clocks import MAX_CLOCK_RATE_DIFFERENCE
from skincal.streams.decoders.auto_detect import make_decoder
from skincal.streams.links import ChunkQueue, LinkSpec, Reader, open_link
from skincal.streams.ros_topics import read_robot_description
from tests.skincal.meanwhile import PATIENCE_S, meanwhile
from tests.skincal.ros.dds_peer import DOMAIN, Cells, Peer, String, Vector3, joints, process, skin, wrench

# Topics that are counted have a domain of their own: DDS keeps those of earlier tests for a while.
LISTED_DOMAIN, LIMIT_DOMAIN = DOMAIN + 101, (DOMAIN + 31) % 100 + 132


@contextmanager
def publishing(*messages, hz=100.0, latched=False, domain=DOMAIN):
    """Publish (topic, maker) again and again from this process, until the end of the block."""
    peer, number = Peer(domain), 0

    def run(over):
        nonlocal number
        while not over.wait(1.0 / hz):
            number += 1
            for topic, make in messages:
                peer.publish(topic, make(number), latched=latched)

    with meanwhile(run):
        yield peer


def spec(topics, *carries, **options):
    words = "&".join(f"{key}={value}" for key, value in {"domain": DOMAIN, **options}.items())
    return LinkSpec("link", f"ros2:{topics}?{words}", carries)


def decode(data, *carries, names=(), channels=None):
    decoder = make_decoder("ros2", channels, carries)
    decoder.joint_names = names
    return decoder.feed(data), decoder


def read(link, enough=10_000):
    """Read at least so many bytes."""
    data, end_s = b"", time.monotonic() + PATIENCE_S
    while len(data) < enough and time.monotonic() < end_s:
        data += link.read(0.1)
    return data


def cells(number):
    return Cells([1, 2, 3], [Vector3(float(number), 2.0, 3.0), Vector3(4.0, 5.0, 6.0)])


@pytest.mark.parametrize(
    ("topics", "messages", "stream", "options", "names", "last"),
    [
        ("/ft", [("/ft", wrench)], Stream.WRENCH, {}, (), [0.25, 0.5, -0.75]),
        ("/skin", [("/skin", skin)], Stream.SKIN, {}, (), [1.0, 2.0, 3.0]),
        ("/j", [("/j", joints)], Stream.JOINTS, {}, ("wrist", "elbow"), [0.5]),
        ("/j", [("/j", joints)], Stream.JOINTS, {"joints": "elbow"}, ("wrist",), [0.5]),
        ("/b+/a", [("/a", skin), ("/b", partial(skin, channels=2))], Stream.SKIN, {}, (), [1.0, 2.0, 3.0]),
        ("/ft", [("/ft", wrench)], Stream.SKIN, {"field": "wrench.torque"}, (), [0.25, 0.5, -0.75]),
    ],
)
def test_messages_of_a_publisher_become_readings(topics, messages, stream, options, names, last):
    with publishing(*messages), closing(open_link(spec(topics, stream, **options))) as link:
        data = read(link)
    (batch,), decoder = decode(data, stream, names=names)
    assert batch.stream is stream
    assert batch.values[-1][-len(last) :].tolist() == last
    # A busy machine may publish two patches half a period apart, which are then no pair.
    assert decoder.counts.total() == (decoder.counts[Loss.MISSING] if "+" in topics else 0)
    assert "+" in topics or decoder.device_message == ""
    # Dated by the publisher's clock, which is this machine's.
    assert np.all(np.diff(batch.device_s) > 0)
    assert abs(batch.device_s[-1] - time.time()) < PATIENCE_S
    (ahead,) = decoder.side_readings.values()
    assert -1e3 * PATIENCE_S < ahead.least <= ahead.most < 1.0


def test_a_laboratorys_own_type_is_read_and_replayed_without_its_file(tmp_path):
    (tmp_path / "Cells.msg").write_text("uint8[3] id\ngeometry_msgs/Vector3[] pairs\n")
    with publishing(("/cells", cells)):
        with closing(open_link(spec("/cells", Stream.SKIN, field="pairs", msg=tmp_path / "Cells.msg"))) as link:
            data = read(link)
        with pytest.raises(LinkError, match=r"lab_msgs/msg/Cells has no definition.*msg="):
            open_link(spec("/cells", Stream.SKIN))
    (tmp_path / "Cells.msg").unlink()
    (batch,), decoder = decode(data, Stream.SKIN)
    assert batch.values[-1][1:].tolist() == [2.0, 3.0, 4.0, 5.0, 6.0]
    assert decoder.counts.total() == 0
    # The bytes alone give the same readings to the last bit, in one piece or in many.
    pieces = make_decoder("ros2", None, (Stream.SKIN,))
    again = [each for at in range(0, len(data), 7) for each in pieces.feed(data[at : at + 7])]
    assert np.concatenate([each.values for each in again]).tobytes() == batch.values.tobytes()
    assert np.concatenate([each.device_s for each in again]).tobytes() == batch.device_s.tobytes()


def tree(types, *transforms):
    """A TFMessage of (parent, child, seconds, x y z and quaternion x y z w)."""

    def make(name, **fields):
        package = "std_msgs" if name == "Header" else "builtin_interfaces" if name == "Time" else "geometry_msgs"
        return types.make(f"{package}/msg/{name}", **fields)

    def one(parent, child, seconds, pose):
        stamp = make("Time", sec=int(seconds), nanosec=int(1e9 * (seconds % 1.0)))
        place = make("Vector3", x=pose[0], y=pose[1], z=pose[2])
        turn = make("Quaternion", x=pose[3], y=pose[4], z=pose[5], w=pose[6])
        return make(
            "TransformStamped",
            header=make("Header", stamp=stamp, frame_id=parent),
            child_frame_id=child,
            transform=make("Transform", translation=place, rotation=turn),
        )

    return types.make("tf2_msgs/msg/TFMessage", transforms=[one(*each) for each in transforms])


def test_a_tool_behind_several_transforms_is_read_with_those_that_are_latched():
    root_half = 0.5**0.5
    arm, tool = (0.3, 0.0, 0.5, 0.0, 0.0, root_half, root_half), (0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    with closing(dds.Participant(DOMAIN)) as robot:
        static = robot.writer("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
        moving = robot.writer("/tf", "tf2_msgs/msg/TFMessage")
        # Before anybody listens.
        static.write(tree(robot.types, ("flange", "tool0", 0.0, tool)))

        def send(over):
            while not over.wait(0.01):
                now = time.time()
                moving.write(tree(robot.types, ("base", "link1", now, arm)))
                moving.write(tree(robot.types, ("link1", "flange", now, arm)))

        with meanwhile(send), closing(open_link(spec("/tf", Stream.TOOL, frame="tool0", base="base"))) as link:
            decoder, rows, end_s = make_decoder("ros2", None, (Stream.TOOL,)), [], time.monotonic() + PATIENCE_S
            while len(rows) < 5 and time.monotonic() < end_s:
                rows += [row for batch in decoder.feed(link.read(0.1)) for row in batch.values]
    # Rz(90) at (0.3, 0, 0.5), twice, then 0.1 along x: x of the tool is -x of the base.
    expected = [[-1.0, 0.0, 0.0, 0.2], [0.0, -1.0, 0.0, 0.3], [0.0, 0.0, 1.0, 1.0]]
    np.testing.assert_allclose(rows[-1].reshape(3, 4), expected, atol=1e-9)
    assert decoder.device_message == ""


def test_a_tree_of_transforms_is_listed_with_its_frames_and_not_proposed():
    types = dds.message_types()
    identity = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    data = [
        types.encode(tree(types, (parent, child, 1.0, identity)), "tf2_msgs/msg/TFMessage")
        for parent, child in (("base", "link1"), ("link1", "tool0"))
    ]
    heard = ros_topics._Listened("tf2_msgs/msg/TFMessage", None, 101, data[0], data[1], [0, 10**9])
    found = ros_topics._describe(types, "/tf", heard)
    assert found.words == "tf2_msgs/TFMessage, 100/s, frames base, link1, tool0: --tool needs ?frame=TOOL&base=BASE"
    assert ros_topics._can_be_read(types, "tf2_msgs/msg/TFMessage")
    assert ros_topics.propose_topics([found]) == {}, "two frames must be chosen"


class Recorded:
    """A reader and what it brought."""

    def __init__(self, link):
        self._items, self.states, self.data = ChunkQueue(), [], b""
        self._reader = Reader(link, self._items)
        self._reader.start()

    def until(self, done):
        end_s = time.monotonic() + PATIENCE_S
        while not done(self):
            assert time.monotonic() < end_s, self.states
            item = self._items.get(timeout=PATIENCE_S)
            if isinstance(item, LinkEvent):
                self.states.append((item.state, item.text))
                self.data = b"" if item.state is LinkState.OPEN else self.data
            else:
                assert isinstance(item, Chunk)
                self.data += item.data
        return self

    def close(self):
        self._reader.stop()


def test_a_publisher_that_is_killed_comes_back_and_changes_its_type():
    with closing(Recorded(spec("/x", Stream.WRENCH, Stream.SKIN))) as link:
        with process("/x=wrench") as child:
            link.until(lambda got: len(got.data) > 5000)
            child.kill()  # the graph takes ten seconds to notice
            with process("/x=wrench"):
                before = len(link.data)
                link.until(lambda got: len(got.data) > before + 5000)
        assert [state for state, _ in link.states] == [LinkState.OPEN]
        batches, decoder = decode(link.data, Stream.WRENCH)
        assert [each.stream for each in batches] == [Stream.WRENCH]
        assert decoder.counts[Loss.UNREADABLE] == 0
        with process("/x=skin"):
            link.until(lambda got: len(got.states) > 2 and len(got.data) > 5000)
        state, sentence = link.states[1]
        assert state is LinkState.LOST
        assert "is now of the type std_msgs/msg/Float32MultiArray, not geometry_msgs/msg/WrenchStamped" in sentence
        assert decode(link.data, Stream.WRENCH, Stream.SKIN)[0][0].stream is Stream.SKIN


def test_ten_publishers_are_one_skin_in_the_order_of_the_address():
    topics = [f"/patch{number}" for number in (3, 1, 4, 5, 9, 2, 6, 8, 7, 0)]
    makers = [(topic, lambda _, topic=topic: skin(int(topic[-1]), 2)) for topic in topics]
    with publishing(*sorted(makers)), closing(open_link(spec("+".join(topics), Stream.SKIN))) as link:
        data = read(link, 50_000)
    (batch,), _ = decode(data, Stream.SKIN, channels=20)
    assert batch.values[-1][::2].tolist() == [3, 1, 4, 5, 9, 2, 6, 8, 7, 0]


@pytest.mark.parametrize(
    ("topic", "options", "message"),
    [
        ("/nobody", {}, r"no publisher of /nobody is in ROS 2 domain \d+; \d+ topics are there, such as /"),
        ("/ft", {"domain": 101}, r"no publisher is seen in ROS 2 domain 101\. .*ROS_DOMAIN_ID"),
    ],
)
def test_a_missing_topic_or_another_domain_is_a_sentence(monkeypatch, topic, options, message):
    monkeypatch.setattr("skincal.streams.transports.dds.FIND_PUBLISHERS_MAX_S", 1.0)
    with publishing(("/ft", wrench)), pytest.raises(LinkError, match=message) as raised:
        open_link(spec(topic, Stream.WRENCH, **options))
    assert raised.value.kind is FailureKind.ABSENT


def test_messages_that_find_no_room_are_counted(monkeypatch):
    monkeypatch.setattr(dds, "UNREAD_MESSAGES_MAX", 50)
    with publishing(("/ft", wrench), hz=1.0) as peer:
        peer.publish("/ft", wrench(0))
        with closing(open_link(spec("/ft", Stream.WRENCH))) as link:
            read(link, 300)  # the publisher is known
            for number in range(1, 201):
                peer.publish("/ft", wrench(number))
            data, end_s = b"", time.monotonic() + PATIENCE_S
            while ros2.write_losses(0, 0)[:1] not in data[-13:] and time.monotonic() < end_s:
                data += link.read(0.1)
    decoder = make_decoder("ros2", None, (Stream.WRENCH,))
    batches = decoder.feed(ros2.write_head(ros2.TopicChoice(("/ft",)), ["geometry_msgs/msg/WrenchStamped"], {}) + data)
    got = sum(len(each.seq) for each in batches)
    assert decoder.counts[Loss.DROPPED] > 100
    assert 200 <= decoder.counts[Loss.DROPPED] + got <= 200 + PATIENCE_S


def test_a_missing_package_is_one_sentence(monkeypatch):
    dds._module.cache_clear()
    monkeypatch.setitem(sys.modules, "cyclonedds.domain", None)
    monkeypatch.setitem(sys.modules, "cyclonedds.core", None)
    try:
        with pytest.raises(LinkError, match=r"pip install 'skincal\[ros2\]'") as raised:
            open_link(spec("/ft", Stream.WRENCH))
    finally:
        dds._module.cache_clear()
    assert raised.value.kind is FailureKind.ADDRESS


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are counted in /proc")
def test_no_thread_outlives_the_last_link():
    def threads():
        return len(list(Path("/proc/self/task").iterdir()))

    with publishing(("/ft", wrench)):
        before = threads()
        for _ in range(3):
            with closing(open_link(spec("/ft", Stream.WRENCH, domain=DOMAIN))) as link:
                read(link, 1000)
        assert threads() == before


HEAD = {"topics": ["/s"], "types": ["std_msgs/msg/Float32MultiArray"], "definitions": {}, "field": "", "joints": []}


@pytest.mark.parametrize(
    ("head", "problem"),
    [
        ({**HEAD, "types": ["sensor_msgs/msg/Imu"]}, "/s has messages of sensor_msgs/msg/Imu, which are not known as wrench"),
        ({**HEAD, "field": "depth"}, "not known as wrench"),
        ({**HEAD, "topics": 3}, "The first packet cannot be read"),
        ([], "The first packet cannot be read"),
        ({**HEAD, "types": ["std_msgs/msg/Int8MultiArray"]}, "A message cannot be read: it has no values"),
    ],
)
def test_a_topic_that_is_no_sensor_says_so(head, problem):
    data = ros2.pack(ros2.HEAD_KIND, json.dumps(head).encode()) + ros2.write_message(0, 1, 1, bytes(16))
    _, decoder = decode(data, Stream.WRENCH)
    assert decoder.valid_records == 0
    assert problem in decoder.device_message
    assert decoder.counts[Loss.UNREADABLE] >= 1


def test_messages_that_are_read_together_are_those_read_one_by_one():
    types, kind = MessageTypes(), "geometry_msgs/msg/WrenchStamped"
    packets = list[bytes]()
    for number in range(100):
        # Stamps end in the third run; one frame has another name, one message is cut off, another is no number.
        header = types.make(
            "std_msgs/msg/Header",
            stamp=types.make("builtin_interfaces/msg/Time", sec=1000 if number < 60 else 0, nanosec=number * 10**7),
            frame_id="ft" if number != 33 else "another",
        )
        torque = types.make("geometry_msgs/msg/Vector3", x=float(number), y=np.nan if number == 17 else -0.1)
        wrench = types.make("geometry_msgs/msg/Wrench", torque=torque)
        data = types.encode(types.make(kind, header=header, wrench=wrench), kind)
        packets.append(ros2.write_message(0, number * 10**7, 5 + number // 20, data if number != 50 else data[:-9]))
        packets += [ros2.write_losses(1, 2)] * (number == 70)
    (_, many), (_, one) = (decode(ros2.write_head(TopicChoice(("/ft",)), [kind], {}), Stream.WRENCH) for _ in range(2))
    (whole,) = many.feed(b"".join(packets))
    singles = [batch for packet in packets for batch in one.feed(packet)]
    for name in ("values", "device_s", "seq", "invalid"):
        assert getattr(whole, name).tobytes() == np.concatenate([getattr(each, name) for each in singles]).tobytes()
    assert (len(whole.seq), many._runs._layout is not None, one._runs._layout) == (98, True, None)
    lost = {Loss.MISSING: 1, Loss.DROPPED: 2, Loss.UNREADABLE: 1, Loss.NOT_A_NUMBER: 1, Loss.OTHER_FRAME: 1}
    assert many.counts == one.counts == lost
    assert (many.side_readings, many.valid_records) == (one.side_readings, 99)


@pytest.mark.parametrize(
    ("stamps", "used"),
    [
        ([5.0, 6.0, 7.0], [5.0, 6.0, 7.0]),
        ([5.0, 5.0, 6.0], [5.0, 101.0, 102.0]),
        ([None, 1.0], [100.0, 101.0]),
        ([9e9, 1.0], [100.0, 101.0]),
    ],
)
def test_stamps_that_stand_still_or_are_absurd_are_not_used(stamps, used):
    clock = ros2.TopicClock()
    assert [clock.time_of(stamp, 100.0 + at) for at, stamp in enumerate(stamps)] == used


@pytest.mark.parametrize(("speed", "is_used"), [(1.0, True), (0.99, True), (0.975, False), (0.95, False), (0.5, False)])
def test_stamps_that_the_clock_cannot_follow_are_not_used(speed, is_used):
    clock = ros2.TopicClock()
    # Every tenth message is published half a second late.
    times = [(5.0 + speed * n / 100, 100.0 + n / 100 + 0.5 * (n % 10 == 3)) for n in range(6000)]
    used = [clock.time_of(*each) == each[0] for each in times]
    assert all(used[:400])
    assert (used[-1], all(used[900:])) == (is_used, is_used)
    assert is_used or not any(used[900:])
    assert ros2.PACE_ERROR_MAX < MAX_CLOCK_RATE_DIFFERENCE


def test_one_of_two_topics_that_ends_is_noticed_while_the_other_sends():
    gone = Peer()
    gone.publish("/gone", skin(1))
    with publishing(("/kept", skin)), closing(open_link(spec("/kept+/gone", Stream.SKIN))) as link:
        read(link)
        gone.drop("/gone")
        with pytest.raises(LinkError, match="the publisher of /gone is gone") as raised:
            read(link, 10**9)
    assert raised.value.kind is FailureKind.VANISHED


def test_a_message_that_is_too_long_is_skipped_and_counted(monkeypatch):
    monkeypatch.setattr("skincal.streams.transports.dds.MESSAGE_MAX_BYTES", 10_000)
    channels = lambda number: 4 if number % 10 else 5000  # noqa: E731
    with publishing(("/s", lambda number: skin(number, channels(number)))), closing(open_link(spec("/s", Stream.SKIN))) as link:
        data = read(link, 20_000)
    (batch,), decoder = decode(data, Stream.SKIN)
    skipped = set(range(int(batch.values[0, 0]), int(batch.values[-1, 0]))) - set(batch.values[:, 0].astype(int))
    assert skipped
    assert all(number % 10 == 0 for number in skipped)
    assert decoder.counts[Loss.DROPPED] >= 1
    assert decoder.counts[Loss.UNREADABLE] == 0


def test_a_type_that_contains_itself_is_a_sentence(tmp_path):
    (tmp_path / "Cells.msg").write_text("uint8[3] id\nCells[] pairs\n")
    with publishing(("/cells", cells)), pytest.raises(LinkError, match="lab_msgs/msg/Cells contains itself"):
        open_link(spec("/cells", Stream.SKIN, field="id", msg=tmp_path / "Cells.msg"))


def test_topics_are_listed_with_rate_and_values_and_proposed(monkeypatch, capsys):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(LISTED_DOMAIN))
    monkeypatch.setattr(devices, "_ports", list)
    monkeypatch.setattr(devices, "_yarp_ports", lambda: ([], ""))
    monkeypatch.setattr(devices, "_trackers", list)
    wanted = {"wrench": "ros2:/ft/wrench", "skin": "ros2:/skin/all", "joints": "ros2:/joint_states"}
    topics = [("/ft/wrench", wrench), ("/skin/all", partial(skin, channels=48)), ("/skin/few", skin), ("/joint_states", joints)]
    # Names that ROS does not allow, and a wide array that stands still.
    odd = make_idl_struct("T_", "my-pkg::msg::dds_::T_", {"data": str})
    others = [
        ("/robot_description", lambda _: String("<robot/>")),
        ("/cells", cells),
        ("/odd", lambda _: odd("x")),
        ("/still", lambda _: skin(1, 90)),
    ]
    with publishing(*topics, *others, hz=50, domain=LISTED_DOMAIN):
        main(["devices", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["proposed"] == wanted
    words = {each["address"]: each["what"] for each in found["devices"]}
    assert set(words) == {*wanted.values(), "ros2:/skin/few", "ros2:/cells", "ros2:/still"}
    assert words["ros2:/cells"] == "lab_msgs/Cells, its definition is needed: ?msg=FILE"
    kind, rate, values, *_ = words["ros2:/ft/wrench"].split(", ")
    assert (kind, values.split(":")[0]) == ("geometry_msgs/WrenchStamped", "6 values")
    assert 5.0 < float(rate.removesuffix("/s")) < 60.0


def test_topics_beyond_the_limit_are_counted_and_known_types_come_first(monkeypatch, capsys):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(LIMIT_DOMAIN))
    monkeypatch.setattr(devices, "_ports", list)
    monkeypatch.setattr(devices, "_yarp_ports", lambda: ([], ""))
    monkeypatch.setattr(devices, "_trackers", list)
    monkeypatch.setattr(ros_topics, "LISTED_TOPICS_MAX", 1)
    with publishing(("/a", cells), ("/b", wrench), ("/c", wrench), hz=50, domain=LIMIT_DOMAIN):
        main(["devices"])
    said = capsys.readouterr()
    assert "more that are not listed" in said.err
    assert sum("/s, 6 values" in line for line in said.out.splitlines()) == 1


@pytest.mark.parametrize(
    ("stream", "topics", "best"),
    [
        (Stream.SKIN, ["/array 96 0 1", "/taxels 24 1 0"], "/taxels"),
        (Stream.SKIN, ["/map 96 0 0", "/array 24 0 1"], "/array"),
        (Stream.SKIN, ["/hand 24 0 1", "/arm 96 0 1"], "/arm"),
        (Stream.WRENCH, ["/six 6 0 1", "/ft 6 1 0"], "/ft"),
    ],
)
def test_made_types_and_changing_values_are_proposed_first(stream, topics, best):
    found = []
    for topic, width, is_dedicated, has_changed in map(str.split, topics):
        values, flags = np.zeros(int(width)), (is_dedicated == "1", has_changed == "1")
        found.append(ros_topics.FoundTopic(topic, "a/msg/T", stream, 50.0, values, *flags))
    assert ros_topics.propose_topics(found)[stream].topic == best


def test_commands_are_not_proposed_and_the_topic_with_the_joints_of_the_scene_is():
    def topic(name, *joints, changed=True, stream=Stream.JOINTS):
        return ros_topics.FoundTopic(name, "a/msg/T", stream, 50.0, np.zeros(6), True, changed, joints=joints)

    states, command = topic("/joint_states", "elbow"), topic("/z/joint_command", "elbow", "wrist")
    other = topic("/z/joint_states", "wheel")
    assert ros_topics.propose_topics([states, command]) == {Stream.JOINTS: states}
    assert ros_topics.propose_topics([command]) == {}
    assert ros_topics.propose_topics([states, other], ["elbow"]) == {Stream.JOINTS: states}
    assert ros_topics.propose_topics([states, other], ["wheel"]) == {Stream.JOINTS: other}
    raw, filtered = (topic(f"/ft/{name}", stream=Stream.WRENCH) for name in ("a_raw", "filtered"))
    assert ros_topics.propose_topics([filtered, raw]) == {Stream.WRENCH: raw}


URDF = """<robot name="r">
<link name="base"/>
<link name="arm"><visual><geometry><mesh filename="package://lab/part.stl"/></geometry></visual></link>
<joint name="ft" type="fixed"><parent link="base"/><child link="arm"/><origin xyz="0 0 0.1"/></joint>
</robot>"""


def test_the_description_of_a_running_robot_makes_a_scene(tmp_path, capsys):
    peer = Peer()
    peer.publish("/robot_description", String(URDF), latched=True)
    peer.publish("/chatter", String("hello"), latched=True)
    (tmp_path / "part.stl").write_text(
        "solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0.1 0 0\nvertex 0 0.1 0\nendloop\nendfacet\nendsolid s\n"
    )
    scene = tmp_path / "part" / "scene.toml"
    part = ["--link", "arm", "--sensor", "ft", "--channels", "4", "--package", f"lab={tmp_path}"]
    address = f"ros2:/robot_description?domain={DOMAIN}"
    assert main(["scene", "new", *part, "--urdf", address, "--out", str(scene), "--json"]) == 0, capsys.readouterr().err
    capsys.readouterr()
    assert (tmp_path / "part" / "scene.urdf").read_text() == URDF
    assert np.array(load_scene(scene).sensor_pose).shape == (4, 4)
    with pytest.raises(InputError, match=r"/chatter.*no URDF"):
        read_robot_description(f"ros2:/chatter?domain={DOMAIN}")
    with pytest.raises(InputError, match=r"/nothing.*nothing publishes it"):
        read_robot_description(f"ros2:/nothing?domain={DOMAIN}")
