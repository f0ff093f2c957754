"""Topics of ROS 2 by DDS: wrench, skin and joints in the messages that robots publish, and in a laboratory's own.

The link hands on packets (`decoding.pack`). The first one, kind 0, is JSON: the topics, the types that their publishers have,
definitions that are not standard, and the options of the address. Packets of kind 1 and up are the messages of the topics in
their order: the publisher's clock and this machine's time of day at the arrival (int64, nanoseconds since 1970), then the
message as it came (CDR). Kind 255 counts lost messages.

A reading is dated by the stamp in its header, or by the clock of its publisher (`TopicClock`). Several topics are joined to
one skin, their values one after the other: a frame has a message of each topic, whose stamps agree, and the stamp of the first
topic (`SkinPatches`). Messages that find no partners are counted as missing.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any, ClassVar, cast

from skincal.devices.decoding import (
    NO_SEQ,
    TIME_STAMP_MAX_S,
    WRENCH_VALUES,
    FrameDecoder,
    FrameSplitter,
    pack,
    packet_splitter,
)
from skincal.devices.family import DeviceAddress, Family, Form, Route, Vector
from skincal.model.errors import InputError
from skincal.model.pose_form import PoseForm, RotationForm
from skincal.model.readings import Loss, Stream
from skincal.ros.dds import message_types, read_domain
from skincal.ros.layouts import RunReader
from skincal.ros.messages import MessageReader, streams_of
from skincal.ros.patches import SkinPatches
from skincal.ros.tool_poses import ToolPoseReader, static_topic
from skincal.ros.topics import TOPIC_OPTIONS, TopicChoice
from skincal.ros.types import MessageError, MessageTypes

MESSAGE_MAX_BYTES = 1 << 22
"""Bytes. The definitions of a type fit, and a skin of 100,000 channels."""
HEAD_KIND, LOSS_KIND = 0, 255
TOPICS_PER_SKIN_MAX = 100
TIMES_STRUCT = struct.Struct("<2q")
LOSSES_STRUCT = struct.Struct("<2I")
PACE_TIME_S, PACE_ERROR_MAX = 4.0, 0.015
"""s, and relative error. Stamps are compared with the publisher's clock over this time. The error is below the difference of
speeds that `ConvexHullClock` follows (`MAX_CLOCK_RATE_DIFFERENCE`)."""
CLOCK_DIFFERENCE = "stamps ahead of this machine's clock, ms"


def write_head(choice: TopicChoice, types: Sequence[str], definitions: Mapping[str, str]) -> bytes:
    """Write the first packet.

    Parameters
    ----------
    types : of each topic
    definitions : text of each type that is not standard, by its name
    """
    head = {"topics": choice.topics, "types": list(types), "definitions": dict(definitions)}
    frames = {name: value for name, value in (("frame", choice.frame), ("base", choice.base)) if value}
    return pack(HEAD_KIND, json.dumps(head | {"field": choice.field, "joints": choice.joints} | frames).encode())


def write_message(topic: int, source_ns: int, arrival_ns: int, data: bytes) -> bytes:
    """Write the packet of a message; `topic` is its index."""
    return pack(1 + topic, TIMES_STRUCT.pack(source_ns, arrival_ns) + data)


def write_losses(lost: int, dropped: int) -> bytes:
    """Write how many messages were lost on the way, and how many found no room here."""
    return pack(LOSS_KIND, LOSSES_STRUCT.pack(lost, dropped))


class TopicClock:
    """Clock of one topic: the stamps in its messages, or that of its publisher once they are of no use.

    Stamps are of no use if they are missing, stand still, or do not keep pace with the publisher's clock, as in a simulation
    that runs slower than real time. Their pace is that of the least delay between stamp and publishing, so that a message that
    was published late does not matter.
    """

    def __init__(self) -> None:
        self._begin_s = math.nan
        self._least_delay_s, self._delay_before_s = math.inf, math.nan
        self._last = math.nan
        self._has_stamps = True

    def time_of(self, stamp: float | None, source_s: float) -> float:
        """Return the time of a message by one clock, seconds; NaN if there is none."""
        if stamp is None or not abs(stamp) < TIME_STAMP_MAX_S or stamp == self._last or not self._keeps_pace(stamp, source_s):
            self._has_stamps = False
        self._last = math.nan if stamp is None else stamp
        return stamp if stamp is not None and self._has_stamps else source_s

    def _keeps_pace(self, stamp: float, source_s: float) -> bool:
        if math.isnan(source_s):
            return True
        if math.isnan(self._begin_s):
            self._begin_s = source_s
        passed_s = source_s - self._begin_s
        if passed_s < PACE_TIME_S:
            self._least_delay_s = min(self._least_delay_s, source_s - stamp)
            return True
        change_s = self._least_delay_s - self._delay_before_s
        self._begin_s, self._delay_before_s = source_s, self._least_delay_s
        self._least_delay_s = source_s - stamp
        # NaN, after the first time, is no error.
        return not abs(change_s) > PACE_ERROR_MAX * passed_s


class TopicDecoder(FrameDecoder):
    """Decodes messages of topics that make one stream; subclasses find topic and message in a packet.

    The constructor raises InputError: the package that knows the standard messages is missing.
    """

    starts_whole: ClassVar[bool] = True
    names_frames: ClassVar[bool] = True
    defined_pose: ClassVar[PoseForm | None] = PoseForm(RotationForm.QUATERNION_XYZW)

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._types = self._make_types()
        self._choice: TopicChoice | None = None
        self._stream = Stream.SKIN
        self._readers: dict[int, MessageReader | ToolPoseReader] = {}
        self._clocks: dict[int, TopicClock] = {}
        self._arrival_s = math.nan
        self._patches = SkinPatches(())
        self._type_problem = "it does not say which topics follow"

    def _make_types(self) -> MessageTypes:
        return MessageTypes()

    def _make_splitter(self) -> FrameSplitter:
        return packet_splitter(MESSAGE_MAX_BYTES)

    def _use_head(self, payload: bytes) -> Loss | None:
        """Take the first packet: topics, definitions, options, and the types that are known."""
        try:
            head = cast("dict[str, Any]", json.loads(payload))
            options = {"field": head["field"], "joints": ",".join(head["joints"])}
            options |= {name: head[name] for name in ("frame", "base") if isinstance(head.get(name), str)}
            for name, text in head["definitions"].items():
                self._types.add_definition(name, text)
            self._choice = TopicChoice.make("+".join(head["topics"]), options)
            self._patches, self._type_problem = SkinPatches(self._choice.topics), ""
            for topic, type_name in enumerate(head["types"]):
                if type_name:
                    self._use_type(topic, type_name)
        except (ValueError, RecursionError, TypeError, KeyError, AttributeError, IndexError, InputError) as error:
            self._type_problem = f"The first packet cannot be read: {error}"
            self._problem = self._type_problem
            return Loss.UNREADABLE
        self._problem = self._type_problem
        return None

    def _use_type(self, topic: int, type_name: str) -> None:
        """Learn the type of a topic. A type that cannot be read becomes the device's message."""
        assert self._choice is not None
        if self._carries == (Stream.TOOL,):
            self._use_pose_type(topic, type_name, self._choice)
            return
        possible = [s for s in streams_of(self._types, type_name, self._choice.field) if s in self._carries]
        wanted = Stream.SKIN if len(self._choice.topics) > 1 else possible[0] if possible else self._carries[0]
        if wanted not in possible:
            wanted_words = " or ".join(stream.value for stream in self._carries)
            self._type_problem = (
                f"{self._choice.topics[topic]} has messages of {type_name}, which are not known as {wanted_words}; choose "
                "another topic, or name the values by ?field=PATH and a laboratory's own type by ?msg=FILE"
            )
            return
        try:
            joints = self._choice.joints or self.joint_names
            self._readers[topic] = MessageReader(self._types, type_name, wanted, self._choice.field, joints)
        except InputError as error:
            self._type_problem = str(error).rstrip(".")
            return
        self._stream, self._clocks[topic] = wanted, TopicClock()

    def _use_pose_type(self, topic: int, type_name: str, choice: TopicChoice) -> None:
        # The static transforms belong to the tree of the others.
        others = [each for each in self._readers.values() if isinstance(each, ToolPoseReader)]
        try:
            self._readers[topic] = others[0] if others else ToolPoseReader(type_name, choice.frame, choice.base)
        except InputError as error:
            self._type_problem = str(error).rstrip(".")
            return
        self._stream, self._clocks[topic] = Stream.TOOL, TopicClock()

    def _is_static(self, topic: int) -> bool:
        return self._choice is not None and topic > 0 and self._choice.topics[topic] == static_topic(self._choice.topics[0])

    def _take_pose(self, topic: int, reader: ToolPoseReader, message: Any, source_s: float, arrival_s: float) -> Loss | None:
        """Add the tool's pose of a message; a message about other frames of `/tf` is no loss."""
        try:
            found = reader.find_pose(message, is_static=self._is_static(topic))
        except MessageError as error:
            self._problem = f"A message cannot be read: {error}"
            return Loss.UNREADABLE
        self._status = reader.problem
        if found is None:
            return None if not reader.problem else Loss.NO_POSE if reader.is_late else Loss.OTHER_FRAME
        stamp = self._date(topic, found.stamp_s, source_s, arrival_s)
        self.units[Stream.TOOL] = f"pose of {found.child or 'the tool'} in {found.parent or 'a frame without a name'}, m"
        return self._add(Stream.TOOL, NO_SEQ, stamp, found.values)

    def _take_message(self, topic: int, message: Any, source_s: float, arrival_s: float) -> Loss | None:
        """Add the readings of a message; the times are seconds since 1970, NaN if they are not known."""
        reader = self._readers[topic]
        if isinstance(reader, ToolPoseReader):
            return self._take_pose(topic, reader, message, source_s, arrival_s)
        try:
            values = reader.values_of(message, arrival_s)
            if values is not None and not len(values):
                raise MessageError("it has no values")
        except MessageError as error:
            self._problem = f"A message cannot be read: {error}"
            return Loss.UNREADABLE
        stamp = self._date(topic, reader.stamp_of(message), source_s, arrival_s)
        if values is None:
            self._status = reader.missing_joints
            return None
        self._status = self._type_problem or reader.silent_joints
        if self._stream is Stream.WRENCH and len(values) == WRENCH_VALUES:
            known = self._wrenches_from(reader.frame_of(message), values[None])
            if known is None:
                return None
            values = known[0]
        if len(self._patches.topics) == 1:
            return self._add(self._stream, NO_SEQ, stamp, values)
        before = sum(self._patches.superseded)
        frame = self._patches.add(topic, values, stamp)
        if unpaired := sum(self._patches.superseded) - before:
            self._count_missing(unpaired)
            self._status = self._type_problem or self._patches.problem
        return None if frame is None else self._add(self._stream, NO_SEQ, self._patches.stamp_s, frame)

    def _date(self, topic: int, stamp: float | None, source_s: float, arrival_s: float) -> float:
        """Return the time of a readable message by the device's clock, s; note how far that is ahead of this machine's."""
        self.valid_records += 1
        time_s = self._clocks[topic].time_of(stamp, source_s)
        # Messages that were read together have one arrival.
        if arrival_s != self._arrival_s and math.isfinite(time_s) and math.isfinite(arrival_s):
            self._arrival_s = arrival_s
            self._add_side_reading(CLOCK_DIFFERENCE, 1e3 * (time_s - arrival_s))
        return time_s


class Ros2Decoder(TopicDecoder):
    """Decodes what the transport `dds` hands on."""

    name: ClassVar[str] = "ROS 2"

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        self._runs: RunReader | None = None
        """Of a single topic."""
        super().__init__(channels, carries)

    def _make_types(self) -> MessageTypes:
        return message_types()

    def _use_type(self, topic: int, type_name: str) -> None:
        super()._use_type(topic, type_name)
        reader = self._readers.get(topic)
        # Joints of several nodes are kept one by one, and so are patches, which wait for each other.
        if isinstance(reader, MessageReader) and not reader.by_name and len(self._patches.topics) == 1:
            self._runs = RunReader(self._types, reader)

    def _decode_frames(self, frames: Sequence[bytes | None]) -> None:
        # Messages of one length mostly differ in their numbers alone, and are faster to read together.
        for is_run, group in groupby(frames, self._run_length):
            run = list(group)
            if not is_run or not self._decode_run([frame for frame in run if frame]):
                super()._decode_frames(run)

    def _run_length(self, frame: bytes | None) -> int:
        """Length of a message of the only topic; 0 for other frames."""
        return len(frame) if frame and frame[0] == 1 and self._runs is not None and len(frame) > TIMES_STRUCT.size else 0

    def _decode_run(self, frames: Sequence[bytes]) -> bool:
        """Add the readings of messages of one length. Return False, and add nothing, if they are read one by one."""
        if self._runs is None or (read := self._runs.read([frame[1 + TIMES_STRUCT.size :] for frame in frames])) is None:
            return False
        self._status = self._type_problem
        rows = read[0]
        if self._stream is Stream.WRENCH and rows.shape[1] == WRENCH_VALUES:
            known = self._wrenches_from(self._runs.frame, rows)
            if known is None:
                return True
            rows = known
        for frame, values, stamp_s in zip(frames, rows, read[1].tolist(), strict=True):
            source_ns, arrival_ns = TIMES_STRUCT.unpack_from(frame, 1)
            time_s = self._date(0, None if math.isnan(stamp_s) else stamp_s, source_ns * 1e-9, arrival_ns * 1e-9)
            if (problem := self._add(self._stream, NO_SEQ, time_s, values)) is not None:
                self.counts[problem] += 1
        return True

    def _decode(self, frame: bytes) -> Loss | None:
        kind, payload = frame[0], frame[1:]
        if kind == HEAD_KIND:
            return self._use_head(payload)
        if kind == LOSS_KIND:
            if len(payload) != LOSSES_STRUCT.size:
                return Loss.UNREADABLE
            lost, dropped = LOSSES_STRUCT.unpack(payload)
            self._count_missing(lost)
            if dropped:
                self.counts[Loss.DROPPED] += dropped
            return None
        topic = kind - 1
        if topic not in self._readers or len(payload) < TIMES_STRUCT.size:
            self._problem = self._type_problem
            return Loss.UNREADABLE
        source_ns, arrival_ns = TIMES_STRUCT.unpack_from(payload)
        try:
            message = self._types.decode(payload[TIMES_STRUCT.size :], self._readers[topic].type_name)
        except MessageError as error:
            self._problem = f"A message cannot be read: {error}"
            return Loss.UNREADABLE
        return self._take_message(topic, message, source_ns * 1e-9, arrival_ns * 1e-9)


def topics_of(address: DeviceAddress) -> TopicChoice:
    """Return the topics of an address and how they are read. Raises InputError."""
    return TopicChoice.make(address.path, address.options)


def has_topics(address: DeviceAddress) -> bool:
    """Check the names of the topics, and their number."""
    try:
        return len(topics_of(address).topics) <= TOPICS_PER_SKIN_MAX
    except InputError:
        return False


def _has_domain(address: DeviceAddress) -> bool:
    try:
        read_domain(address.options.get("domain", "0"), "domain")
    except InputError:
        return False
    return has_topics(address)


_VECTOR_CDR = bytes.fromhex(
    "00010000" "5100000000c2eb0b" "03000000" "66740000"
    "000000000000f83f" "00000000000002c0" "0000000000003e40"
    "000000000000c03f" "000000000000e0bf" "000000000000b03f"
)  # fmt: skip
"""Stamp 81.2 s, frame `ft`, wrench."""
_VECTOR_HEAD = write_head(TopicChoice(("/ft/wrench",)), ("geometry_msgs/msg/WrenchStamped",), {})
_VECTOR_BYTES = write_message(0, 81_200_300_000, 81_200_900_000, _VECTOR_CDR)

DEVICE_FAMILY = Family(
    routes=(
        Route(
            usage="ros2:/ft/wrench",
            form=Form.PATH,
            transport="dds",
            format="ros2",
            options=("domain", *TOPIC_OPTIONS),
            check=_has_domain,
            needs_every_byte=True,
        ),
    ),
    decoders={"ros2": Ros2Decoder},
    vectors=(
        Vector(
            "ros2",
            (Stream.WRENCH,),
            _VECTOR_HEAD + _VECTOR_BYTES,
            ((1.5, -2.25, 30.0, 0.125, -0.5, 0.0625),),
            repeat=_VECTOR_BYTES,
        ),
    ),
)
