"""Topics of ROS 1 and ROS 2 by a rosbridge server: JSON over a websocket, for networks that DDS does not pass.

The link asks `rosapi` for the type of each topic, subscribes, and hands on each message as a packet. The first packet, kind 0,
has the topics and options of the address; the answers with the types follow, so that bytes play alone. A reading is dated by
the stamp in its header, else by its count. Source: protocol of rosbridge_suite, `ROSBRIDGE_PROTOCOL.md`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, cast

from skincal.devices.decoding import pack, packet_splitter
from skincal.devices.family import DeviceAddress, Family, Form, Handshake, HandshakeError, Questions, Route, Vector
from skincal.devices.link import FailureKind, LinkError
from skincal.devices.ros2 import HEAD_KIND, MESSAGE_MAX_BYTES, TopicDecoder, has_topics, topics_of, write_head
from skincal.model.errors import InputError
from skincal.model.readings import Loss, Stream
from skincal.ros.tool_poses import static_topic
from skincal.ros.topics import TOPIC_OPTIONS, TopicChoice
from skincal.ros.types import full_type_name, read_definition

TYPE_SERVICE = "/rosapi/topic_type"
SERVER_TEXT_SHOWN_MAX_CHARS = 80
ABSENT_TYPE = "-"
"""Of an optional topic without a publisher."""


def _read_json(payload: bytes) -> dict[str, Any]:
    """Read a message of the server. Raises ValueError."""
    try:
        message: Any = json.loads(payload)
    except RecursionError:
        raise ValueError(payload) from None
    if not isinstance(message, dict):
        raise ValueError(payload)
    return cast("dict[str, Any]", message)


def _answered_type(message: dict[str, Any], topics: Sequence[str]) -> tuple[int, str] | None:
    """Read the index of a topic and its type from an answer of `rosapi`; the type is empty if the topic has none."""
    name = message.get("id")
    if message.get("op") != "service_response" or name not in topics:
        return None
    values = message.get("values")
    found = cast("dict[str, Any]", values).get("type") if isinstance(values, dict) and message.get("result", True) else None
    return topics.index(name), found if isinstance(found, str) else ""


class RosbridgeHandshake(Handshake):
    """Asks for the types of the topics, then subscribes to all of them. Each line is a message of its own.

    A topic of `optional` without a publisher is left out.
    """

    def __init__(self, topics: Sequence[str], type_name: str = "", optional: Sequence[str] = ()) -> None:
        self._topics = tuple(topics)
        self._optional = frozenset(optional)
        self._types = [type_name] * len(topics)
        self._packets = packet_splitter(MESSAGE_MAX_BYTES)

    @property
    def is_ready(self) -> bool:
        return all(self._types)

    def opening(self) -> bytes:
        if self.is_ready:
            return self._subscriptions()
        asked = [
            {"op": "call_service", "id": topic, "service": TYPE_SERVICE, "args": {"topic": topic}} for topic in self._topics
        ]
        return "\n".join(map(json.dumps, asked)).encode()

    def on_data(self, data: bytes) -> bytes:
        if self.is_ready:
            return b""
        for frame in self._packets.split(data):
            try:
                answer = None if frame is None else _answered_type(_read_json(frame[1:]), self._topics)
            except ValueError:
                raise HandshakeError("what answers there is no rosbridge") from None
            if answer is None:
                continue
            topic, found = answer
            if not found and self._topics[topic] in self._optional:
                found = ABSENT_TYPE
            if not found:
                raise HandshakeError(
                    f"it knows no type of {self._topics[topic]}; start its publisher and the node rosapi, or name the type by "
                    "?type=geometry_msgs/WrenchStamped"
                )
            self._types[topic] = found[:SERVER_TEXT_SHOWN_MAX_CHARS]
            if self.is_ready:
                return self._subscriptions()
        return b""

    def _subscriptions(self) -> bytes:
        wanted = [
            {"op": "subscribe", "topic": topic, "type": name}
            for topic, name in zip(self._topics, self._types, strict=True)
            if name != ABSENT_TYPE
        ]
        return "\n".join(map(json.dumps, wanted)).encode()


class RosbridgeDecoder(TopicDecoder):
    """Decodes the messages of a rosbridge server."""

    name: ClassVar[str] = "rosbridge"

    def _decode(self, frame: bytes) -> Loss | None:
        if frame[0] == HEAD_KIND:
            return self._use_head(frame[1:])
        if self._choice is None:
            self._problem = self._type_problem
            return Loss.UNREADABLE
        try:
            message = _read_json(frame[1:])
            answer = _answered_type(message, self._choice.topics)
            if answer is not None and answer[1]:
                self._use_type(answer[0], full_type_name(answer[1]))
        except (ValueError, InputError):
            return Loss.UNREADABLE
        if message.get("op") == "status" and message.get("level") == "error":
            self._problem = f"The server says: {str(message.get('msg'))[:SERVER_TEXT_SHOWN_MAX_CHARS]}"
        if message.get("op") != "publish":
            return None
        topic = message.get("topic")
        index = self._choice.topics.index(topic) if topic in self._choice.topics else -1
        if index not in self._readers:
            self._problem = self._type_problem or "A message of an unknown topic came"
            return Loss.UNREADABLE
        return self._take_message(index, message.get("msg"), math.nan, math.nan)


def _with_handshake(address: DeviceAddress, questions: Questions) -> DeviceAddress:
    """Fill in the first packet and the handshake. Raises LinkError: the definition of a type is not usable."""
    del questions
    choice, definitions = topics_of(address), dict[str, str]()
    optional: tuple[str, ...] = ()
    if choice.frame and choice.base and len(choice.topics) == 1:  # a tree, whose fixed transforms have a topic of their own
        optional = (static_topic(choice.topics[0]),)
        choice = replace(choice, topics=(*choice.topics, *optional))
    try:
        type_name = full_type_name(address.options["type"]) if "type" in address.options else ""
        if choice.msg is not None:
            if not type_name:
                raise InputError("with msg=FILE the address needs type=package/Type, too.")
            definitions[type_name] = read_definition(Path(choice.msg), type_name)
    except InputError as error:
        raise LinkError(FailureKind.ADDRESS, f"{address.text}: {error}") from error
    head = write_head(choice, [type_name] * len(choice.topics), definitions)
    handshake = RosbridgeHandshake(choice.topics, address.options.get("type", ""), optional)
    return replace(address, first_bytes=head, handshake=handshake)


_VECTOR_ANSWER = {"op": "service_response", "id": "/ft", "values": {"type": "geometry_msgs/WrenchStamped"}, "result": True}
_VECTOR_MESSAGE = {
    "op": "publish",
    "topic": "/ft",
    "msg": {
        "header": {"seq": 7, "stamp": {"secs": 81, "nsecs": 200000000}, "frame_id": "ft"},
        "wrench": {"force": {"x": 1.5, "y": -2.25, "z": 30.0}, "torque": {"x": 0.125, "y": -0.5, "z": 0.0625}},
    },
}
_VECTOR_HEAD = write_head(TopicChoice(("/ft",)), ("",), {}) + pack(1, json.dumps(_VECTOR_ANSWER).encode())
_VECTOR_BYTES = pack(1, json.dumps(_VECTOR_MESSAGE).encode())

DEVICE_FAMILY = Family(
    routes=(
        Route(
            usage="rosbridge://192.168.1.5:9090/ft/wrench",
            form=Form.HOST_PATH,
            transport="websocket",
            format="rosbridge",
            port=9090,
            options=("type", *TOPIC_OPTIONS),
            message_max=MESSAGE_MAX_BYTES,
            check=has_topics,
            needs_every_byte=True,
            prepare=_with_handshake,
        ),
    ),
    decoders={"rosbridge": RosbridgeDecoder},
    vectors=(
        Vector(
            "rosbridge",
            (Stream.WRENCH,),
            _VECTOR_HEAD + _VECTOR_BYTES,
            ((1.5, -2.25, 30.0, 0.125, -0.5, 0.0625),),
            repeat=_VECTOR_BYTES,
        ),
    ),
)
