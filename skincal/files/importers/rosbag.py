"""Bags of ROS as the chunks of a session: each stream is a topic, or several topics of the patches of a skin.

A topic may have the options of a running robot's address (`skincal.ros.topics`): `/skin?field=sensors[0].values`,
`/skin?msg=TaxelData.msg`, `/joint_states?joints=l_elbow,l_wrist`, `/skin/a+/skin/b`.

Messages are placed by the stamps in their headers where all streams have them by one clock, otherwise by the recorder's clock:
then a header's stamp counts if it agrees with the arrival, after a constant difference was removed.
"""

from __future__ import annotations

import contextlib
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby, islice
from pathlib import Path

import numpy as np

from skincal.files.importers.bag_poses import POSE_TYPES, AnyReader, BagPoseReader, guess_tools
from skincal.files.importers.bag_reader import Bag, BagTopic
from skincal.files.importers.even_times import space_evenly
from skincal.files.importers.registry import RANK_OF_GUESS_BY_CHANNELS, RecordedPlace, StoppedError, StreamGuess
from skincal.files.importers.tape import NumberFile, Tape
from skincal.files.importers.timeline import OpenRecording, Timeline, check_overlap, count_repeated, late_streams
from skincal.geometry import FloatArray
from skincal.model.errors import InputError, plural
from skincal.model.readings import Stream
from skincal.ros.layouts import RunReader
from skincal.ros.messages import MessageReader, is_seldom_a_skin, number_fields, streams_of
from skincal.ros.patches import SkinPatches
from skincal.ros.proposals import is_command, natural_order
from skincal.ros.tool_poses import TF_MESSAGE, static_topic
from skincal.ros.topics import TopicChoice
from skincal.ros.types import MessageError, MessageTypes, full_type_name
from skincal.streams.decoders.records import POSE_KIND
from skincal.streams.links import LinkSpec
from skincal.words.frame_words import frame_words

MESSAGES_READ_TO_GUESS_STREAM = 100
"""Messages of a topic that are read to guess its stream."""
SENSOR_TOPIC_MIN_RATE_HZ = 5.0
"""A topic with fewer messages a second is hardly a sensor: a press lasts a second."""
SAME_CLOCK_MAX_DIFFERENCE_S = 0.02
"""Clocks that differ by less are taken for one clock: a message may usually wait for as long before it is recorded."""
MESSAGE_DELAY_MAX_S = 0.5
"""An unsteady delay below this is that of messages, not of a clock: stamps are the better time."""
MAX_DELAY_SPREAD_S = 0.1
"""Of 80 % of the delays of a stream whose sender has another clock; beyond it the arrival is the better time."""
MESSAGES_PER_PROGRESS_REPORT = 2000
"""Messages between two reports of progress: some 0.05 s."""
MESSAGES_DECODED_TOGETHER = 1024
"""Messages of a stream that are read together."""
MESSAGES_DECODED_TOGETHER_MAX_BYTES = 1 << 20
"""Bounds their memory."""
DELAYS_IN_MEDIAN_MAX = 1 << 18
"""Delays whose median is the difference of two clocks: those of four minutes at 1 kHz, from the whole recording."""
TOPICS_LISTED_MAX = 8
"""Topics that a sentence lists."""


# ------------------------------------------------------------------ guess


def guess_streams(path: Path) -> list[StreamGuess]:
    """Guess the streams of the topics of a bag, from their types and first messages.

    Raises InputError: it cannot be read, or no topic has readings.
    """
    with Bag(path) as bag:
        spread = _spread_messages(bag)
        guesses = [guess for topic in bag.topics.values() if (guess := _guess(bag, topic, spread[topic.name])) is not None]
        guesses += guess_tools(bag, {name: [data for _, data in messages] for name, messages in spread.items()})
        if not guesses:
            raise InputError(f"{path}: no topic has readings of a sensor or skin; it has {list_topics(bag)}.")
    return [*guesses, *_joined_patches(guesses)]


def _spread_messages(bag: Bag) -> dict[str, list[tuple[int, bytes]]]:
    """Collect arrivals and bytes of messages of each topic that may have readings, from all parts of the bag."""
    found: dict[str, list[tuple[int, bytes]]] = {name: [] for name in bag.topics}
    wanted = [
        each.name
        for each in bag.topics.values()
        if each.type_name and each.messages and (_streams_of(bag, each) or full_type_name(each.type_name) in POSE_TYPES)
    ]
    for topic, arrival_ns, data in bag.spread_messages(wanted):
        found[topic].append((arrival_ns, data))
    return found


def _streams_of(bag: Bag, topic: BagTopic) -> tuple[Stream, ...]:
    try:
        bag.define(topic.name)
        return tuple(each for each in streams_of(bag.types, topic.type_name) if each is not Stream.TIP)
    except InputError:
        return ()


def _guess(bag: Bag, topic: BagTopic, spread: Sequence[tuple[int, bytes]]) -> StreamGuess | None:
    if not topic.type_name or not topic.messages:
        return None
    try:
        if not (streams := _streams_of(bag, topic)):
            return None
        reader = MessageReader(bag.types, topic.type_name, streams[0])
    except InputError:
        return None
    rows: list[FloatArray] = []
    arrivals: list[int] = []
    first = ((arrival_ns, data) for _, arrival_ns, data in islice(bag.messages([topic.name]), MESSAGES_READ_TO_GUESS_STREAM))
    for is_first, messages in ((True, first), (False, spread)):
        for arrival_ns, data in messages:
            with contextlib.suppress(MessageError):
                values = reader.values_of(bag.types.decode(data, topic.type_name))
                if values is not None:
                    rows.append(values)
                    arrivals += [arrival_ns] if is_first else []
    if not rows:
        return None
    width = Counter(map(len, rows)).most_common(1)[0][0]
    changes = any(len(row) == width and not np.array_equal(row, rows[0]) for row in rows)
    is_fast = len(arrivals) > 1 and (len(arrivals) - 1) * 1e9 >= SENSOR_TOPIC_MIN_RATE_HZ * (arrivals[-1] - arrivals[0])
    stream = streams[0] if len(streams) == 1 else None
    joints = tuple(filter(None, reader.joints)) if reader.by_name else ()
    rank = RANK_OF_GUESS_BY_CHANNELS if is_seldom_a_skin(topic.type_name) else int(not changes) + int(not is_fast)
    return StreamGuess(RecordedPlace(bag.path, topic.name), stream, width, joints, rank)


def _joined_patches(guesses: Sequence[StreamGuess]) -> list[StreamGuess]:
    """Guess that all likely skins are the patches of one, and that topics with numbered names are.

    They are in the order of their names, and of the numbers in them.
    """
    may_be_skin = [each for each in guesses if each.stream in (None, Stream.SKIN) and not is_command(each.place.topic)]
    groups = [[each for each in may_be_skin if each.rank == 0]]
    alike = dict[str, list[StreamGuess]]()
    for each in may_be_skin:
        alike.setdefault(re.sub(r"\d+", "#", each.place.topic), []).append(each)
    groups += [each for each in alike.values() if each != groups[0]]
    found: list[StreamGuess] = []
    for group in groups:
        patches = sorted(group, key=lambda each: natural_order(each.place.topic))
        if len(patches) > 1:
            place = RecordedPlace(patches[0].place.path, "+".join(each.place.topic for each in patches))
            width = sum(each.width for each in patches)
            found.append(StreamGuess(place, Stream.SKIN, width, rank=RANK_OF_GUESS_BY_CHANNELS))
    return found


def list_topics(bag: Bag) -> str:
    """List the topics of a bag with their types, for a sentence."""
    words = [f"{each.name} ({each.kind})" for each in list(bag.topics.values())[:TOPICS_LISTED_MAX]]
    more = len(bag.topics) - len(words)
    return (", ".join(words) + (f" and {more} more" if more else "")) or "no topics"


# ------------------------------------------------------------------ reading


@dataclass(slots=True)
class _Recorded:
    """A stream while its messages are read."""

    stream: Stream
    choice: TopicChoice
    readers: dict[str, AnyReader]
    """By topic."""
    patches: SkinPatches | None
    tape: Tape = field(default_factory=Tape)
    arrivals: NumberFile = field(default_factory=NumberFile)
    """Seconds by the recorder's clock."""
    stamps: NumberFile = field(default_factory=NumberFile)
    """Seconds by the sender's clock; NaN without one."""
    messages: Counter[str] = field(default_factory=Counter[str])
    """By topic."""
    frames: Counter[str] = field(default_factory=Counter[str])
    """Readings of a wrench by the frame that their messages name; empty for none."""
    unreadable: int = 0
    why_unreadable: str = ""

    runs: dict[str, RunReader] = field(default_factory=dict[str, RunReader])
    """By topic."""
    _waiting: list[tuple[str, int, bytes]] = field(default_factory=list[tuple[str, int, bytes]])
    _waiting_bytes: int = 0

    def add(self, types: MessageTypes, topic: str, arrival_ns: int, data: bytes) -> None:
        """Take a message. It may wait for others, which are faster to read together; see `read_waiting`."""
        self._waiting.append((topic, arrival_ns, data))
        self._waiting_bytes += len(data)
        if len(self._waiting) >= MESSAGES_DECODED_TOGETHER or self._waiting_bytes >= MESSAGES_DECODED_TOGETHER_MAX_BYTES:
            self.read_waiting(types)

    def read_waiting(self, types: MessageTypes) -> None:
        """Read the messages that wait."""
        waiting, self._waiting, self._waiting_bytes = self._waiting, [], 0
        for (topic, _), group in groupby(waiting, lambda message: (message[0], len(message[2]))):
            run = [(arrival_ns, data) for _, arrival_ns, data in group]
            self.messages[topic] += len(run)
            # Patches of a skin wait for each other, one message at a time.
            if self.patches is not None or not self._read_run(types, topic, run):
                for message in run:
                    self._read_message(types, topic, *message)

    def _read_run(self, types: MessageTypes, topic: str, run: Sequence[tuple[int, bytes]]) -> bool:
        """Read messages of one length together. Returns False, and takes nothing, if they have not one layout."""
        of_topic = self.readers[topic]
        if isinstance(of_topic, BagPoseReader):
            return False  # a message may have poses of many frames, or none
        reader = self.runs.setdefault(topic, RunReader(types, of_topic))
        arrivals_s = np.array([arrival_ns for arrival_ns, _ in run]) * 1e-9
        read = reader.read([data for _, data in run], arrivals_s)
        if read is None:
            return False
        values, stamps = read
        self._note_frame(self.runs[topic].frame, len(values))
        self.tape.add_many(values)
        self.arrivals.extend(arrivals_s)
        self.stamps.extend(stamps)
        return True

    def _read_message(self, types: MessageTypes, topic: str, arrival_ns: int, data: bytes) -> None:
        reader = self.readers[topic]
        try:
            message = types.decode(data, reader.type_name)
            values = reader.values_of(message, arrival_ns * 1e-9)
        except MessageError as error:
            self.unreadable += 1
            self.why_unreadable = self.why_unreadable or str(error)
            return
        stamp = reader.stamp_of(message)
        stamp_s = np.nan if stamp is None else stamp
        if values is not None and self.patches is not None:
            values = self.patches.add(self.choice.topics.index(topic), values, stamp_s)
            stamp_s = self.patches.stamp_s
        if values is not None:
            self._note_frame(reader.frame_of(message), 1)
            self.tape.add(values)
            self.arrivals.append(arrival_ns * 1e-9)
            self.stamps.append(stamp_s)

    def _note_frame(self, name: str, readings: int) -> None:
        """Note the frame of the next readings of a wrench."""
        if self.stream is Stream.WRENCH:
            self.frames[name] += readings
            self.tape.set_frame(name)

    @property
    def last_arrival(self) -> float:
        """Arrival of the last reading, s."""
        return float(self.arrivals.read(len(self.arrivals) - 1, len(self.arrivals))[0])

    def clocks(self) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield blocks of arrivals and stamps, (n,) s."""
        yield from zip(self.arrivals.blocks(), self.stamps.blocks(), strict=True)

    def findings(self) -> list[str]:
        """Sentences on the messages."""
        reader = self.readers[self.choice.topics[0]]
        field_words = f", field {reader.field}" if self.choice.field else ""
        found = [f"{self.choice} ({reader.type_name}){field_words}{frame_words(self.frames)}."]
        if isinstance(reader, BagPoseReader) and reader.parent:
            found.append(f"its poses are in the frame {reader.parent}.")
        if isinstance(reader, BagPoseReader) and reader.left_out:
            why = f" ({reader.missing_joints})" if reader.missing_joints else ""
            found.append(f"{plural(reader.left_out, 'message')} gave no pose{why}.")
        if self.stream is Stream.JOINTS and reader.joints:
            found.append(f"the order of the joints is {', '.join(name or 'unused' for name in reader.joints)}.")
        for name, silence in reader.silences.items():
            after_s = silence.since_s - float(self.arrivals.read(0, 1)[0])
            found.append(
                f"no position of {name} came with {plural(silence.messages, 'message')}, first after {after_s:.1f} s: "
                "they are left out, and the arm pose is unknown until it comes again."
            )
        if self.unreadable:
            found.append(f"{plural(self.unreadable, 'message')} left out: {self.why_unreadable}.")
        for topic, count in zip(self.choice.topics, self.patches.superseded if self.patches else [], strict=False):
            if count:
                found.append(f"{plural(count, 'message')} of {topic} left out: a newer one came before the frame was complete.")
        return [f"{self.stream.value}: {sentence}" for sentence in found]


def open_recording(
    places: Mapping[Stream, RecordedPlace], joints: Sequence[str] = (), go_on: Callable[[float], bool] = lambda _: True
) -> OpenRecording:
    """Read the topics of a bag through.

    Parameters
    ----------
    joints : names of the columns of the joint stream, empty for an unused column; without them all joints of the first message
    go_on : gets the finished share, 0 to 1, and says whether to continue

    Raises
    ------
    InputError
        The bag or a topic cannot be read, has no message or no stamp in common with the others.
    StoppedError
        `go_on` said no.
    """
    paths = {place.path for place in places.values()}
    if len(paths) > 1:
        raise InputError(f"The topics are of {len(paths)} bags; expected one bag with all of them.")
    with Bag(paths.pop()) as bag:
        streams = [_prepare(bag, stream, place.topic, joints) for stream, place in places.items()]
        _read_messages(bag, streams, go_on)
        for each in streams:
            _require_readings(bag, each)
        findings = [f"the bag: {sentence}" for sentence in bag.findings]
        if bag.damage:
            findings.append(
                f"the bag is damaged after {max(each.last_arrival for each in streams) - bag.span_ns[0] * 1e-9:.1f} s "
                f"({bag.damage}): everything after it is missing."
            )
        findings += _missing_messages(bag, streams)
    times, clock_findings = place_in_time(streams)
    timelines = [Timeline(each.stream.value, seconds) for each, seconds in zip(streams, times, strict=True)]
    for each, timeline in zip(streams, timelines, strict=True):
        findings += [*each.findings(), *timeline.sentences()]
    check_overlap(timelines)
    findings += [*clock_findings, *late_streams(timelines)]
    return OpenRecording(
        tuple(LinkSpec(each.stream.value, f"file:{bag.path}::{each.choice}", (each.stream,), "records") for each in streams),
        tuple(timelines),
        tuple(
            lambda tape=each.tape, stamps=line.stamps: tape.lines(stamps) for each, line in zip(streams, timelines, strict=True)
        ),
        tuple(findings),
    )


def _prepare(bag: Bag, stream: Stream, text: str, joints: Sequence[str]) -> _Recorded:
    """Make the readers of the topics of a stream. Raises InputError: a topic or its type cannot be read."""
    if not text:
        raise InputError(f"{bag.path}: the topic of the {stream.value} is not named; it has {list_topics(bag)}.")
    choice = TopicChoice.parse(text)
    if len(choice.topics) > 1 and stream is not Stream.SKIN:
        raise InputError(f"{text}: several topics can be the patches of a skin only; expected one topic of the {stream.value}.")
    readers: dict[str, AnyReader] = {}
    for name in choice.topics:
        topic = bag.topics.get(name)
        if topic is None:
            raise InputError(f"{bag.path}: has no topic {name}; it has {list_topics(bag)}.")
        if topic.encoding:
            raise InputError(f"{bag.path}: the messages of {name} are {topic.encoding}; expected those of ROS (cdr or ros1).")
        if not topic.type_name:
            raise InputError(f"{bag.path}: the messages of {name} are of several types; record it again with one type.")
        if choice.msg is not None:
            bag.types.add_file(choice.msg, topic.type_name)
        else:
            bag.define(name)
        if stream is Stream.TOOL:
            reader = readers[name] = _pose_reader(bag, topic, choice)
            _add_static_transforms(bag, topic, reader)
            continue
        try:
            readers[name] = MessageReader(bag.types, topic.type_name, stream, choice.field, choice.joints or joints)
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
        if not choice.field and stream not in (found := streams_of(bag.types, topic.type_name)):
            kinds = " or ".join(each.value for each in found) or "no known readings"
            fields = ", ".join(number_fields(bag.types, topic.type_name)[:TOPICS_LISTED_MAX])
            advice = f" If they are in one of its fields, name it: {name}?field=PATH, with one of {fields}." if fields else ""
            raise InputError(f"{name}: its messages ({topic.type_name}) hold {kinds}; expected the {stream.value}.{advice}")
    tape = Tape(POSE_KIND if stream is Stream.TOOL else 0)
    return _Recorded(stream, choice, readers, SkinPatches(choice.topics) if len(choice.topics) > 1 else None, tape)


def _pose_reader(bag: Bag, topic: BagTopic, choice: TopicChoice) -> BagPoseReader:
    """Make the reader of a tool's poses. Raises InputError: the messages hold none, or name the frames that move."""
    try:
        return BagPoseReader(topic.type_name, choice)
    except InputError as error:
        if full_type_name(topic.type_name) != TF_MESSAGE:
            raise InputError(f"{topic.name}: {error}") from None
        spread = {name: [data for _, data in messages] for name, messages in _spread_messages(bag).items()}
        moving = [guess.place.topic for guess in guess_tools(bag, spread)]
        named = " or ".join(each for each in moving if "?" in each) or f"{topic.name}?frame=tool0&base=base"
        raise InputError(
            f"{bag.path}: {topic.name} has poses of many frames; name the tool's and its base, as in {named}."
        ) from None


def _add_static_transforms(bag: Bag, topic: BagTopic, reader: BagPoseReader) -> None:
    """Read the topic of fixed transforms next to one of moving ones, before all others: they hold for all times."""
    static = bag.topics.get(static_topic(topic.name))
    if full_type_name(topic.type_name) != TF_MESSAGE or static is None or full_type_name(static.type_name) != TF_MESSAGE:
        return
    bag.define(static.name)
    for _, _, data in bag.messages([static.name]):
        with contextlib.suppress(MessageError):
            reader.add_static(bag.types.decode(data, static.type_name))


def _read_messages(bag: Bag, streams: Sequence[_Recorded], go_on: Callable[[float], bool]) -> None:
    of_topic = dict[str, list[_Recorded]]()
    for each in streams:
        for name in each.choice.topics:
            of_topic.setdefault(name, []).append(each)
    total = max(1, sum(bag.topics[name].messages for name in of_topic))
    for count, (topic, arrival_ns, data) in enumerate(bag.messages(of_topic.keys(), in_file_order=True)):
        for each in of_topic[topic]:
            each.add(bag.types, topic, arrival_ns, data)
        if count % MESSAGES_PER_PROGRESS_REPORT == 0 and not go_on(min(1.0, count / total)):
            raise StoppedError
    for each in streams:
        each.read_waiting(bag.types)


def _require_readings(bag: Bag, each: _Recorded) -> None:
    """Raise InputError: a stream has no reading."""
    if each.tape.rows:
        return
    name = str(each.choice)
    missing = next((sentence for reader in each.readers.values() if (sentence := reader.missing_joints)), "")
    silent = [topic for topic in each.choice.topics if not each.messages[topic]]
    if silent:
        why = f"{', '.join(silent)} has no message" + (f" before the damage ({bag.damage})" if bag.damage else "")
        why += "; choose another topic"
    elif missing:
        why = missing.rstrip(".")
    else:
        why = f"none of its {plural(each.messages.total(), 'message')} has a reading"
        why += f" ({each.why_unreadable})" if each.why_unreadable else "; choose another topic or field"
    raise InputError(f"{bag.path}: {name}: {why}.")


def _missing_messages(bag: Bag, streams: Sequence[_Recorded]) -> list[str]:
    """Compare the numbers of messages with those of the bag's index."""
    found: list[str] = []
    for each in streams:
        for topic, read in each.messages.items():
            expected = bag.topics[topic].messages
            if read < expected:
                found.append(f"{each.stream.value}: the bag announces {expected} messages of {topic}; {read} could be read.")
    return found


# ------------------------------------------------------------------ time


def place_in_time(streams: Sequence[_Recorded]) -> tuple[list[Iterator[FloatArray]], list[str]]:
    """Choose the times of the readings of each stream.

    Returns
    -------
    blocks of (n,) seconds for each stream, and sentences on the clocks.
    """
    coarse = [_has_coarse_stamps(each) for each in streams]
    delays = [(np.empty(0), len(each.stamps)) if bad else _delays(each) for each, bad in zip(streams, coarse, strict=True)]
    offsets = [float(np.median(some)) if len(some) else np.nan for some, _ in delays]
    # NaN if a stream has no stamps.
    have_one_clock = max(offsets) - min(offsets) <= SAME_CLOCK_MAX_DIFFERENCE_S and not np.isnan(offsets).any()
    times: list[Iterator[FloatArray]] = []
    findings: list[str] = []
    for each, offset, (some, unstamped), is_coarse in zip(streams, offsets, delays, coarse, strict=True):
        name, shift = each.stream.value, 0.0
        if unstamped == len(each.stamps):
            why = "most of its stamps are that of the message before" if is_coarse else "its messages have no stamp"
            evenly = space_evenly(np.concatenate(list(each.arrivals.blocks()))) if each.stream is not Stream.JOINTS else None
            if evenly is None:
                findings.append(f"{name}: {why}; they are placed by their arrival at the recorder.")
                times.append(each.arrivals.blocks())
                continue
            findings.append(
                f"{name}: {why}, and they arrive in groups; they are placed evenly, by their count, "
                f"{1 / evenly[1]:.3g} a second."
            )
            times.append(iter([evenly[0]]))
            continue
        if not have_one_clock and abs(offset) > SAME_CLOCK_MAX_DIFFERENCE_S:
            low, high = np.quantile(some, [0.1, 0.9])
            is_steady = high - low <= MAX_DELAY_SPREAD_S
            if not is_steady and abs(offset) > MESSAGE_DELAY_MAX_S:
                findings.append(
                    f"{name}: its stamps differ from the arrival by {low:.3f} to {high:.3f} s; it is placed by its arrival."
                )
                times.append(each.arrivals.blocks())
                continue
            shift = offset if is_steady else 0.0
            corrected = "this was corrected" if is_steady else "this was not corrected, since it changes"
            findings.append(f"{name}: its clock differs from the recorder's by {-offset:+.3f} s; {corrected}.")
        elif have_one_clock and abs(offset) > SAME_CLOCK_MAX_DIFFERENCE_S:
            findings.append(f"{name}: it is placed by the stamps of its sender, {-offset:+.3f} s from the recorder's clock.")
        if unstamped:
            findings.append(f"{name}: {plural(unstamped, 'message')} without a stamp: placed by the arrival.")
        times.append(_shifted_stamps(each, offset, shift))
    return times, findings


def _has_coarse_stamps(each: _Recorded) -> bool:
    """Whether most stamps are that of the message before: they have too few digits, or the sender's clock stands still."""
    return 2 * sum(count_repeated(np.diff(stamps)) for stamps in each.stamps.blocks()) > len(each.stamps)


def _shifted_stamps(each: _Recorded, offset: float, shift: float) -> Iterator[FloatArray]:
    for arrival, stamp in each.clocks():
        yield np.where(np.isnan(stamp), arrival - offset, stamp) + shift


def _delays(each: _Recorded) -> tuple[FloatArray, int]:
    """Compute the times from stamp to arrival of at most `DELAYS_IN_MEDIAN_MAX` messages, (n,) s; count missing stamps."""
    step, some, unstamped = -(-len(each.stamps) // DELAYS_IN_MEDIAN_MAX), list[FloatArray](), 0
    for arrival, stamp in each.clocks():
        delay = arrival - stamp
        known = delay[~np.isnan(delay)]
        some.append(known[::step].copy())
        unstamped += len(delay) - len(known)
    return np.concatenate(some), unstamped
