"""Topics of a running ROS 2 graph, by DDS and without ROS: their publishers and types, and messages as bytes (CDR).

For DDS the topic `/a/b` is named `rt/a/b`, and the type `p/msg/T` is `p::msg::dds_::T_`. `cyclonedds` takes part in the graph
as a participant of its own; it is imported with the first one. A reader checks each message by its type's definition, and keeps
the bytes as they came. `CYCLONEDDS_URI` chooses the network, as for ROS itself; `ROS_LOCALHOST_ONLY` counts, too. The domain is
a number from 0 to 232; `ROS_DOMAIN_ID` is the default. Source: ROS 2 design article on topic and service names; Cyclone DDS 11.
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Generator
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any

from skincal.model.errors import InputError
from skincal.ros.types import MessageError, MessageTypes

INSTALL_HINT = (
    "Topics of ROS 2 are read by the packages cyclonedds and rosbags, which are not both installed; install them: "
    "python -m pip install 'skincal[ros2]' (or python3 start.py --ros2)"
)
LOOPBACK_CONFIG = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1" multicast="true"/></Interfaces></General>'
    "</Domain></CycloneDDS>"
)
TOPIC_PREFIX = "rt"
ROS_DOMAIN_ID_MAX = 232
"""Larger domains have no ports."""
MESSAGES_PER_READ_MAX = 1000
"""Messages of one topic that are taken at once."""
UNREAD_MESSAGES_MAX = 4000
"""Messages of one topic that wait for this program: four seconds at 1 kHz. Those beyond are counted."""
WRITER_WAIT_FOR_READER_MAX_MS = 100
"""ms. Longest wait of a writer for a slow reader."""
_TYPE_LOCK = threading.RLock()
"""`cyclonedds` builds types in one thread at a time."""


def default_domain() -> int:
    """Read the domain from `ROS_DOMAIN_ID`; 0 without it. Raises InputError."""
    return read_domain(os.environ.get("ROS_DOMAIN_ID") or "0", "ROS_DOMAIN_ID")


def read_domain(text: str, where: str) -> int:
    """Read the number of a domain. Raises InputError."""
    if not (text.isascii() and text.isdigit() and len(text) < 4 and int(text) <= ROS_DOMAIN_ID_MAX):
        raise InputError(f"{where} is {text!r}; expected the number of a ROS 2 domain, 0 to {ROS_DOMAIN_ID_MAX}.")
    return int(text)


@cache
def _module(name: str) -> Any:
    """Import a module of `cyclonedds`. Raises InputError: it is not installed, or does not run on this machine."""
    try:
        import_module("cyclonedds")
        return import_module(f"cyclonedds.{name}")
    except ModuleNotFoundError:
        raise InputError(INSTALL_HINT) from None
    except Exception as error:  # noqa: BLE001 - its loader raises plain exceptions of its own
        raise InputError(f"The package cyclonedds cannot be loaded ({error}); install it again.") from None


def message_types() -> MessageTypes:
    """Make the definitions of messages. Raises InputError: a package of the extra is not installed."""
    try:
        return MessageTypes()
    except InputError:
        raise InputError(INSTALL_HINT) from None


def _stay_local() -> None:
    """Use the loopback interface if ROS stays on this machine and no network is chosen for DDS."""
    is_local = os.environ.get("ROS_LOCALHOST_ONLY") == "1" or os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") == "LOCALHOST"
    if is_local and "CYCLONEDDS_URI" not in os.environ:
        os.environ["CYCLONEDDS_URI"] = LOOPBACK_CONFIG


def dds_type_name(type_name: str) -> str:
    """Write `package/msg/Type` as DDS names it."""
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def ros_type_name(dds_name: str) -> str:
    """Read DDS's name of a type; empty if ROS did not make it."""
    words = dds_name.split("::")
    if len(words) != 4 or words[1] != "msg" or words[2] != "dds_" or not words[3].endswith("_"):
        return ""
    return f"{words[0]}/msg/{words[3][:-1]}"


def _reliability() -> Any:
    return _module("core").Policy.Reliability.Reliable(_module("util").duration(milliseconds=WRITER_WAIT_FOR_READER_MAX_MS))


class DdsError(InputError):
    """DDS refused a call; a later one may succeed."""


class _StructBuilder:
    """Makes the types of `cyclonedds` from message definitions."""

    def __init__(self, types: MessageTypes) -> None:
        self._types, self._made = types, dict[str, Any]()
        self._begun: set[str] = set()
        names = _module("idl.types")
        numbers = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64")
        bytes_ = dict.fromkeys(("char", "byte", "octet"), names.uint8)
        self._base: dict[str, Any] = {"bool": bool, "string": str, **bytes_, **{name: getattr(names, name) for name in numbers}}

    def struct(self, type_name: str) -> Any:
        """Make the type of a message. Raises MessageError: DDS cannot carry it, or it has no definition."""
        if type_name in self._begun:
            raise MessageError(f"the type {type_name} contains itself, which DDS cannot carry; correct its .msg file")
        if type_name not in self._made:
            self._begun.add(type_name)
            try:
                self._made[type_name] = self._make(type_name)
            finally:
                self._begun.discard(type_name)
        return self._made[type_name]

    def _make(self, type_name: str) -> Any:
        names, fields = _module("idl.types"), dict[str, Any]()
        for field in self._types.fields_of(type_name):
            if field.kind != "message" and field.type_name not in self._base:
                raise MessageError(f"the type {type_name} has a {field.type_name} ({field.name}), which is not read here")
            kind = self.struct(field.type_name) if field.kind == "message" else self._base[field.type_name]
            if field.is_array:
                kind = names.array[kind, field.length] if field.length else names.sequence[kind]
            fields[field.name] = kind
        return _module("idl").make_idl_struct(f"{type_name.split('/')[-1]}_", dds_type_name(type_name), fields)


@contextlib.contextmanager
def _in_words(what: str) -> Generator[None]:
    """Raise DdsError for a failure of DDS."""
    try:
        yield
    except _module("core").DDSException as error:
        raise DdsError(
            f"{what}: DDS refuses ({' '.join(str(error).split())}); check the network and the variable CYCLONEDDS_URI."
        ) from None


class Participant:
    """A participant of a ROS 2 domain, for one thread. Raises InputError: DDS is not installed, or refuses."""

    def __init__(self, domain: int) -> None:
        self.domain, self.types = domain, message_types()
        _stay_local()
        self._open: list[TopicReader | TopicWriter] = []
        self._publishers: dict[str, tuple[int, str, str]] = {}
        """When each publisher was found, its topic and type."""
        with _in_words(f"ROS 2 domain {domain}"):
            self._participant = _module("domain").DomainParticipant(domain)
            self._waitset: Any = _module("core").WaitSet(self._participant)
            builtin = _module("builtin")
            self._discovery = builtin.BuiltinDataReader(self._participant, builtin.BuiltinTopicDcpsPublication)
        with _TYPE_LOCK:
            self._structs = _StructBuilder(self.types)

    def publishers(self) -> list[tuple[str, str]]:
        """List topic and type of each publisher that is known now, the newest last; the type is empty if it is not ROS's."""
        alive = _module("core").InstanceState.Alive
        while found := self._discovery.take(MESSAGES_PER_READ_MAX):
            for each in found:
                key, info = str(each.key), each.sample_info
                if info.instance_state != alive:
                    self._publishers.pop(key, None)
                elif each.topic_name.startswith(f"{TOPIC_PREFIX}/"):
                    topic = each.topic_name.removeprefix(TOPIC_PREFIX)
                    self._publishers[key] = info.source_timestamp, topic, ros_type_name(each.type_name)
        return [(topic, type_name) for _, topic, type_name in sorted(self._publishers.values())]

    def reader(self, topic: str, type_name: str, *, reliable: bool = False, latched: bool = False) -> TopicReader:
        """Open a reader, by default for any publisher.

        Parameters
        ----------
        reliable : lost messages are sent again; a publisher of best effort is not read
        latched : the last message from before is read, too; a publisher that is not latched is not read

        Raises InputError: DDS refuses; MessageError: the type cannot be read.
        """
        core, policy = _module("core"), _module("core").Policy
        qos = core.Qos(
            _reliability() if reliable or latched else policy.Reliability.BestEffort,
            policy.Durability.TransientLocal if latched else policy.Durability.Volatile,
            # Not the last ones: a message that finds no room is counted, one that is overwritten is not.
            policy.History.KeepAll,
            policy.ResourceLimits(max_samples=UNREAD_MESSAGES_MAX),
            # Other makers describe the members of a message by other names.
            policy.TypeConsistency.AllowTypeCoercion(True, True, True),
        )
        with _in_words(topic):
            reader = TopicReader(self._participant, self._topic(topic, type_name), qos)
            self._waitset.attach(reader.condition)
        self._open.append(reader)
        return reader

    def writer(self, topic: str, type_name: str, *, latched: bool = False) -> TopicWriter:
        """Open a reliable writer; a latched one keeps its last message for readers that come later.

        Raises InputError: DDS refuses; MessageError: the type cannot be written.
        """
        core, policy = _module("core"), _module("core").Policy
        qos = core.Qos(
            _reliability(),
            policy.Durability.TransientLocal if latched else policy.Durability.Volatile,
            policy.History.KeepLast(MESSAGES_PER_READ_MAX),
            policy.DurabilityService(0, policy.History.KeepLast(1), -1, -1, -1),
        )
        with _in_words(topic):
            writer = TopicWriter(
                _module("pub").DataWriter(self._participant, self._topic(topic, type_name), qos), type_name, self.types
            )
        self._open.append(writer)
        return writer

    def wait(self, timeout_s: float) -> bool:
        """Wait at most `timeout_s` for a message of one of the readers; say whether one is there."""
        return bool(self._waitset.wait(round(timeout_s * 1e9)))

    def _topic(self, topic: str, type_name: str) -> Any:
        with _TYPE_LOCK:
            return _module("topic").Topic(self._participant, f"{TOPIC_PREFIX}{topic}", self._structs.struct(type_name))

    def close(self) -> None:
        """Leave the graph with all readers and writers."""
        # A condition belongs to its reader, and the set of conditions comes first.
        del self._waitset
        for each in self._open:
            each.close()
        del self._discovery, self._participant


@dataclass(frozen=True, slots=True)
class Message:
    """A message as DDS delivered it."""

    source_ns: int
    """The publisher's clock when it was written, nanoseconds since 1970."""
    data: bytes
    """CDR, with its header of four bytes."""


class TopicReader:
    """Reads one topic."""

    def __init__(self, participant: Any, topic: Any, qos: Any) -> None:
        core = _module("core")
        self._reader = _module("sub").DataReader(participant, topic, qos)
        self._any: int = core.SampleState.Any | core.ViewState.Any | core.InstanceState.Any
        self.condition = core.ReadCondition(self._reader, self._any)
        self._take: Any = _module("_clayer").ddspy_take

    def take_messages(self) -> list[Message]:
        """Return the messages that wait, at most `MESSAGES_PER_READ_MAX`."""
        found = self._take(self._reader._ref, self._any, MESSAGES_PER_READ_MAX)  # noqa: SLF001 - its own way would decode the bytes
        if isinstance(found, int):
            raise DdsError(f"DDS cannot read ({found}).")
        return [Message(info.source_timestamp, data) for data, info in found if info.valid_data]

    def take_losses(self) -> tuple[int, int]:
        """Count the messages that were lost on the way, and those that found no room here, since the last call."""
        lost, full = self._reader.get_sample_lost_status(), self._reader.get_sample_rejected_status()
        return lost.total_count_change, full.total_count_change

    @property
    def publishers(self) -> int:
        """Number of publishers of the topic."""
        return int(self._reader.get_subscription_matched_status().current_count)

    def close(self) -> None:
        """For `Participant.close`."""
        del self.condition, self._reader


class TopicWriter:
    """Writes one topic."""

    def __init__(self, writer: Any, type_name: str, types: MessageTypes) -> None:
        self._writer, self._type_name, self._types = writer, type_name, types
        self._write: Any = _module("_clayer").ddspy_write

    def write(self, message: Any) -> None:
        """Write a message. Raises InputError."""
        self.write_bytes(self._types.encode(message, self._type_name))

    def write_bytes(self, data: bytes) -> None:
        """Write a message that is CDR. Raises InputError."""
        code = self._write(self._writer._ref, data)  # noqa: SLF001 - as in `TopicReader.take_messages`
        if code < 0:
            raise DdsError(f"DDS does not write a {self._type_name} ({code}).")

    def wait_for_readers(self, timeout_s: float) -> None:
        """Wait at most `timeout_s` until all readers have what was written."""
        with contextlib.suppress(_module("core").DDSException):
            self._writer.wait_for_acks(_module("util").duration(seconds=timeout_s))

    @property
    def readers(self) -> int:
        """Number of readers that get the messages."""
        return int(self._writer.get_publication_matched_status().current_count)

    def close(self) -> None:
        """For `Participant.close`."""
        del self._writer
