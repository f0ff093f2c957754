"""Topics of ROS 2 by DDS; each message becomes a packet (`skincal/devices/ros2.py`)."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path

from skincal.devices.link import FailureKind, LinkError
from skincal.devices.ros2 import MESSAGE_MAX_BYTES, TIMES_STRUCT, topics_of, write_head, write_losses, write_message
from skincal.model.errors import InputError
from skincal.model.readings import Stream
from skincal.ros.dds import DdsError, Message, Participant, TopicReader, default_domain
from skincal.ros.tool_poses import TF_MESSAGE, static_topic
from skincal.ros.topics import TopicChoice
from skincal.ros.types import MessageError, read_definition
from skincal.streams.transports import Opening

FIND_PUBLISHERS_MAX_S = 3.0
"""s for the publishers to be found. Within one network it takes some 0.2 s."""
FIND_PUBLISHERS_POLL_PERIOD_S = 0.05
GATHER_MESSAGES_S = 0.03
"""s. Messages that come so soon after one another are read together: it spares the processor, and they are dated by stamps."""
LOSS_CHECK_PERIOD_S = 0.5
"""s between two looks at losses and publishers."""
CHECK_PUBLISHERS_IF_SILENT_FOR_S = 1.5
"""s without a message after which the publishers of a topic are looked at: it takes some 0.2 s to be matched with one."""
TOPICS_NAMED_MAX = 5


def open_transport(opening: Opening) -> DdsLink:
    """Take part in the graph and read the topics of the address."""
    try:
        return DdsLink(opening)
    except InputError as error:
        kind = FailureKind.OTHER if isinstance(error, DdsError) else FailureKind.ADDRESS
        raise LinkError(kind, f"{opening.address.label}: {error}") from error


class DdsLink:
    """Reader of one or more topics. Raises LinkError; InputError: DDS is not installed, or an option is wrong."""

    tried: tuple[int, ...] = ()

    def __init__(self, opening: Opening) -> None:
        self._label, self._choice = opening.address.label, topics_of(opening.address)
        domain = opening.address.options.get("domain")
        self._participant = Participant(default_domain() if domain is None else int(domain))
        types = self._participant.types
        self._readers: list[TopicReader] = []
        self._static: TopicReader | None = None
        """Of `/tf_static`; `None` unless poses are read from `/tf`."""
        try:
            self._types = self._find_types(opening)
            definitions = dict[str, str]()
            for topic, name in zip(self._choice.topics, self._types, strict=True):
                if self._choice.msg is not None and not types.is_standard(name):
                    definitions[name] = read_definition(Path(self._choice.msg), name)
                    types.add_definition(name, definitions[name])
                self._readers.append(self._participant.reader(topic, name))
            self._static = self._open_static(opening)
        except MessageError as error:
            self.close()
            raise LinkError(FailureKind.OTHER, f"{self._label}: {error}.") from error
        except BaseException:
            self.close()
            raise
        self._head = write_head(*self._described(), definitions)
        self._check_s = time.monotonic()
        self._last_s = [self._check_s] * len(self._readers)
        """When each topic sent last."""
        self._too_long = 0
        self._failure: LinkError | None = None
        """Raised once the messages that came before it are read."""

    def _open_static(self, opening: Opening) -> TopicReader | None:
        """Open the reader of `/tf_static`, next to one of `/tf`: its transforms are latched."""
        if opening.carries != (Stream.TOOL,) or self._types != [TF_MESSAGE]:
            return None
        return self._participant.reader(static_topic(self._choice.topics[0]), TF_MESSAGE, latched=True)

    def _described(self) -> tuple[TopicChoice, list[str]]:
        """Return the topics that are read, and their types."""
        if self._static is None:
            return self._choice, self._types
        (topic,) = self._choice.topics
        return replace(self._choice, topics=(topic, static_topic(topic))), [*self._types, TF_MESSAGE]

    def _find_types(self, opening: Opening) -> list[str]:
        """Wait for a publisher of each topic and return the types. Raises LinkError."""
        end_s = time.monotonic() + FIND_PUBLISHERS_MAX_S
        while True:
            known = {topic: name for topic, name in self._participant.publishers() if name}
            missing = [topic for topic in self._choice.topics if topic not in known]
            if not missing:
                return [known[topic] for topic in self._choice.topics]
            if time.monotonic() > end_s or opening.is_cancelled():
                raise LinkError(FailureKind.ABSENT, f"{self._label}: {self._absent_words(missing[0], sorted(known))}")
            time.sleep(FIND_PUBLISHERS_POLL_PERIOD_S)

    def _absent_words(self, topic: str, known: list[str]) -> str:
        if not known:
            return (
                f"no publisher is seen in ROS 2 domain {self._participant.domain}. Start the robot's part; check ROS_DOMAIN_ID "
                "(?domain=N), and that the network passes UDP multicast, which DDS needs."
            )
        some, domain = ", ".join(known[:TOPICS_NAMED_MAX]), self._participant.domain
        return (
            f"no publisher of {topic} is in ROS 2 domain {domain}; {len(known)} topics are there, such as {some}. "
            "Start its publisher, or check the name (skincal devices lists topics)."
        )

    def read(self, timeout_s: float) -> bytes:
        if self._head:
            head, self._head = self._head, b""
            return head
        if self._failure is not None:
            raise self._failure
        if self._participant.wait(timeout_s):
            time.sleep(GATHER_MESSAGES_S)
        arrival_ns, now_s = time.time_ns(), time.monotonic()
        waiting = [self._take_messages(reader) for reader in self._readers]
        self._last_s = [now_s if messages else last for messages, last in zip(waiting, self._last_s, strict=True)]
        waiting += [] if self._static is None else [self._take_messages(self._static)]
        # In turn: the patches of one moment stay together, although several messages of each are read at once.
        packets = [
            write_message(topic, message.source_ns, arrival_ns, message.data)
            for turn in zip_longest(*waiting)
            for topic, message in enumerate(turn)
            if message is not None
        ]
        if now_s - self._check_s >= LOSS_CHECK_PERIOD_S:
            self._check_s = now_s
            lost, dropped = map(sum, zip(*(reader.take_losses() for reader in self._readers), strict=True))
            dropped, self._too_long = dropped + self._too_long, 0
            if lost or dropped:
                packets.append(write_losses(lost, dropped))
            try:
                self._check_publishers(now_s)
            except LinkError as failure:
                self._failure = failure
        return b"".join(packets)

    def _take_messages(self, reader: TopicReader) -> list[Message]:
        try:
            found = reader.take_messages()
        except DdsError as error:
            raise LinkError(FailureKind.VANISHED, f"{self._label}: {error}") from error
        # A longer packet would make all that follow unreadable.
        short = [each for each in found if len(each.data) + TIMES_STRUCT.size <= MESSAGE_MAX_BYTES]
        self._too_long += len(found) - len(short)
        return short

    def _check_publishers(self, now_s: float) -> None:
        """Raise LinkError if a silent topic has no publisher, or a new one of another type."""
        found: dict[str, str] = dict(self._participant.publishers())
        for topic, expected, reader, last_s in zip(self._choice.topics, self._types, self._readers, self._last_s, strict=True):
            if now_s - last_s < CHECK_PUBLISHERS_IF_SILENT_FOR_S:
                continue
            name = found.get(topic)
            if name is None:
                raise LinkError(FailureKind.VANISHED, f"{self._label}: the publisher of {topic} is gone; start it again.")
            if name != expected:
                sentence = f"{self._label}: {topic} is now of the type {name or 'of another program'}, not {expected}."
                raise LinkError(FailureKind.VANISHED, sentence)
            if not reader.publishers:
                raise LinkError(
                    FailureKind.OTHER,
                    f"{self._label}: a publisher of {topic} is there, but its {expected} has another definition than here; "
                    "name its .msg file by ?msg=FILE.",
                )

    def write(self, data: bytes) -> None:
        """Send nothing: topics are only read."""
        del data

    def close(self) -> None:
        self._readers.clear()
        self._static = None
        self._participant.close()
