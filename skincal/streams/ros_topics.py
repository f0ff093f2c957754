"""Topics of a running ROS 2 graph that can be read: type, rate, newest values, and a proposal for each stream."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skincal.devices.decoding import WRENCH_VALUES
from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.readings import Stream
from skincal.ros.dds import Participant, TopicReader, default_domain
from skincal.ros.messages import MessageReader, is_seldom_a_skin, streams_of
from skincal.ros.proposals import is_command, name_rank
from skincal.ros.tool_poses import TF_MESSAGE, stamped_poses
from skincal.ros.types import MessageError, MessageTypes
from skincal.streams.links import parse_address

LISTEN_TO_TOPICS_S = 2.0
"""s. Publishers are found within some 0.2 s, and a topic of 2 Hz sends twice."""
TOPIC_POLL_PERIOD_S = 0.05
LISTED_TOPICS_MAX = 60
"""Topics that are read while they are listed."""
LISTED_FRAMES_MAX = 12
TEXT_TYPE = "std_msgs/msg/String"
WAIT_FOR_ROBOT_DESCRIPTION_MAX_S = 5.0
"""s for a latched message to come."""


@dataclass(frozen=True, slots=True)
class FoundTopic:
    """A topic with a publisher."""

    topic: str
    type_name: str
    stream: Stream | None
    """Its likely stream; `None` if its type has no definition here, or it has not sent yet."""
    rate: float
    """Messages per second while it was listed."""
    values: FloatArray | None
    """(n,) float, newest values: N and N m, raw values of a skin, or degrees. `None` before the first message."""
    is_dedicated: bool = False
    """Its type is made for the stream; other types only have numbers."""
    has_changed: bool = False
    """Its messages were not all equal."""
    joints: tuple[str, ...] = ()
    """Names of its joints, if it has some."""
    frames: tuple[str, ...] = ()
    """Frames of its transforms, if it has some: a pose of a tool needs two of them."""

    @property
    def address(self) -> str:
        return f"ros2:{self.topic}"

    @property
    def words(self) -> str:
        """Type, rate and newest values for the operator."""
        kind = self.type_name.replace("/msg/", "/")
        if self.frames:
            more = ", ..." if len(self.frames) > LISTED_FRAMES_MAX else ""
            listed = ", ".join(self.frames[:LISTED_FRAMES_MAX])
            return f"{kind}, {self.rate:.0f}/s, frames {listed}{more}: --tool needs ?frame=TOOL&base=BASE"
        if self.values is None:
            return f"{kind}, {'silent' if self.stream else 'its definition is needed: ?msg=FILE'}"
        shown = " ".join(f"{value:.4g}" for value in self.values[:WRENCH_VALUES].tolist())
        more = ", ..." if len(self.values) > WRENCH_VALUES else ""
        return f"{kind}, {self.rate:.0f}/s, {len(self.values)} values: {shown}{more}"


@dataclass(slots=True)
class _Listened:
    type_name: str
    reader: TopicReader | None
    count: int = 0
    first: bytes = b""
    newest: bytes = b""
    times_ns: list[int] = field(default_factory=list[int])
    """Publisher's clock at the first and the newest message."""


def list_ros_topics() -> tuple[list[FoundTopic], int]:
    """Listen to the domain of `ROS_DOMAIN_ID` for `LISTEN_TO_TOPICS_S` and list the topics that can be read, by name.

    Returns the topics, and the number of those beyond `LISTED_TOPICS_MAX` that were left out.

    Raises InputError: DDS is not installed or refuses.
    """
    participant = Participant(default_domain())
    types = participant.types
    heard: dict[str, _Listened] = {}
    left_out = set[str]()
    try:
        end_s = time.monotonic() + LISTEN_TO_TOPICS_S
        while time.monotonic() < end_s:
            new = [each for each in participant.publishers() if each[0] not in heard and _can_be_read(types, each[1])]
            for topic, name in sorted(new, key=lambda each: len(streams_of(types, each[1])) or len(Stream) + 1):
                if sum(each.reader is not None for each in heard.values()) < LISTED_TOPICS_MAX:
                    heard[topic] = _Listened(name, _open_reader(participant, topic, name))
                else:
                    left_out.add(topic)
            time.sleep(TOPIC_POLL_PERIOD_S)
            for each in heard.values():
                for message in [] if each.reader is None else each.reader.take_messages():
                    each.count, each.first, each.newest = each.count + 1, each.first or message.data, message.data
                    each.times_ns = [*each.times_ns[:1], message.source_ns]
    finally:
        participant.close()
    return [_describe(types, topic, each) for topic, each in sorted(heard.items())], len(left_out)


def _can_be_read(types: MessageTypes, type_name: str) -> bool:
    """Leave out types of ROS without readings of a sensor or skin, and names that ROS does not allow."""
    try:
        # Cameras would fill the network.
        has_readings = not is_seldom_a_skin(type_name) and bool(streams_of(types, type_name))
        return has_readings or type_name == TF_MESSAGE or not types.is_standard(type_name)
    except InputError:
        return False


def _open_reader(participant: Participant, topic: str, type_name: str) -> TopicReader | None:
    try:
        return participant.reader(topic, type_name)
    except (MessageError, InputError):
        return None


def _describe(types: MessageTypes, topic: str, heard: _Listened) -> FoundTopic:
    passed_s = (heard.times_ns[-1] - heard.times_ns[0]) * 1e-9 if len(heard.times_ns) > 1 else 0.0
    rate = (heard.count - 1) / passed_s if passed_s > 0 else 0.0
    if heard.type_name == TF_MESSAGE:
        return FoundTopic(topic, heard.type_name, Stream.TOOL, rate, None, frames=_list_frames(types, heard))
    streams = streams_of(types, heard.type_name)
    values, has_changed, joints = None, False, ()
    if heard.newest and streams:
        try:
            # As a skin: the values of any type without a meaning.
            reader = MessageReader(types, heard.type_name, streams[0] if len(streams) == 1 else Stream.SKIN)
            first = reader.values_of(types.decode(heard.first, heard.type_name))
            first = None if first is None else first.copy()
            values = reader.values_of(types.decode(heard.newest, heard.type_name))
            joints = tuple(filter(None, reader.joints)) if reader.by_name else ()
            has_changed = first is not None and values is not None and not np.array_equal(first, values, equal_nan=True)
        except (MessageError, InputError):
            streams = ()
    stream = streams[0] if streams else None
    if len(streams) > 1 and values is not None and len(values) == WRENCH_VALUES:
        stream = Stream.WRENCH
    return FoundTopic(topic, heard.type_name, stream, rate, values, len(streams) == 1, has_changed, joints)


def _list_frames(types: MessageTypes, heard: _Listened) -> tuple[str, ...]:
    """List the frames in the first and the newest message of a topic of transforms, by name."""
    found: set[str] = set()
    for data in filter(None, (heard.first, heard.newest)):
        with contextlib.suppress(MessageError):
            for each in stamped_poses(types.decode(data, TF_MESSAGE), TF_MESSAGE):
                found |= {each.parent, each.child}
    return tuple(sorted(found - {""}))


def propose_topics(found: Sequence[FoundTopic], joints: Sequence[str] = ()) -> dict[Stream, FoundTopic]:
    """Choose a topic for each stream of those that send: the widest skin, and the fastest wrench and joints.

    A type that is made for the stream comes first, then a topic with the scene's joints, then one whose values change, then
    the usual name of measured values. Commands are never proposed.

    Parameters
    ----------
    joints : names of the scene's joints, if they are known
    """
    proposed: dict[Stream, FoundTopic] = {}
    for stream in Stream:
        sending = [
            (each, each.values)
            for each in found
            if each.stream is stream and each.values is not None and not is_command(each.topic)
        ]
        if sending:
            proposed[stream] = max(sending, key=lambda pair: _rank(stream, *pair, joints))[0]
    return proposed


def _rank(stream: Stream, found: FoundTopic, values: FloatArray, joints: Sequence[str]) -> tuple[object, ...]:
    width = len(values) if stream is Stream.SKIN else 0
    scene_joints = len(set(joints) & set(found.joints)) if stream is Stream.JOINTS else 0
    named = -name_rank(found.topic, stream)
    return found.is_dedicated, scene_joints, found.has_changed, width, named, found.rate, found.topic


def read_robot_description(address: str) -> bytes:
    """Read the URDF of a robot from its latched topic, such as `ros2:/robot_description`.

    Raises InputError: the address is wrong, nothing is published there, or it is no URDF.
    """
    found = parse_address(address)
    if found.route.scheme != "ros2":
        raise InputError(f"{address}: expected a topic of ROS 2, such as ros2:/robot_description.")
    domain = found.options.get("domain")
    participant = Participant(default_domain() if domain is None else int(domain))
    types = participant.types
    try:
        reader = participant.reader(found.path, TEXT_TYPE, latched=True)
        participant.wait(WAIT_FOR_ROBOT_DESCRIPTION_MAX_S)
        messages = reader.take_messages()
        seen = dict(participant.publishers()).get(found.path)
    finally:
        participant.close()
    if not messages:
        why = "nothing publishes it" if seen is None else f"it has {seen}, or its publisher does not latch it"
        raise InputError(f"{address}: no robot description came ({why}); start the robot_state_publisher, or name a file.")
    try:
        text = str(types.decode(messages[-1].data, TEXT_TYPE).data)
    except MessageError as error:
        raise InputError(f"{address}: {error}.") from None
    if "<robot" not in text:
        raise InputError(f"{address}: its text is no URDF; expected <robot>.")
    return text.encode()
