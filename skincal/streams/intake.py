"""Chunks and events of all links in, paired samples out.

The output depends on the items fed and nothing else: no wall clock, no thread. So a journal of the items, fed again, gives the
same samples bit for bit.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import accumulate, pairwise
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from skincal.devices.family import AUTO_FORMAT
from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.readings import (
    SENSOR_STREAMS,
    Batch,
    Chunk,
    LinkEvent,
    LinkHealth,
    LinkState,
    Loss,
    Outages,
    Sample,
    SideReading,
    Stream,
    merge_side_readings,
)
from skincal.model.wrench_frames import FindFrame, WrenchFrames, unchecked_frame
from skincal.streams.clocks import Timestamper
from skincal.streams.decoders.auto_detect import LinkDecoder, decoder_class
from skincal.streams.expected_readings import TIP_WIDTH, ExpectedReadings
from skincal.streams.link_diagnosis import LinkMonitor
from skincal.streams.links import LinkSpec, format_of, make_link_decoder
from skincal.streams.pairing import Pairing, PairingWithTool

LIVE_CURVE_SPAN_S = 10.0
"""s of wrenches that the live curves show."""
RATE_AVERAGING_WINDOW_NS = 2_000_000_000
RATE_COUNTING_STEP_NS = 100_000_000
"""ns of readings counted together for the rate."""
LOSSES_THAT_BREAK_COUNTING = (Loss.BAD_WIDTH, Loss.UNREADABLE, Loss.BAD_CHECKSUM, Loss.MISSING)
"""Losses after which a count of readings no longer gives the time."""


class Intake:
    """Decodes, dates and pairs the data of a session's links; `find_frame` finds the frames that messages name for the wrench.

    The constructor raises InputError: a format is not known, or two links have one name.
    """

    def __init__(self, expected: ExpectedReadings, links: Sequence[LinkSpec], find_frame: FindFrame = unchecked_frame) -> None:
        self._links = {spec.name: LinkIntake(expected, spec, find_frame) for spec in links}
        self._expected = expected
        if len(self._links) < len(links):
            raise InputError("Two links have the same name; expected a name of its own for each.")
        self.frozen: frozenset[str] = frozenset()
        """Names of the links on which a stream that always has noise repeats one reading."""
        self.has_new_frames = True
        """Whether a message named a new frame of the wrench; reset by who looks at `wrench_frames`."""
        self._skin_link = next((link for link in self._links.values() if Stream.SKIN in link.spec.carries), None)
        self._has_one_wrench = sum(not each.carries or Stream.WRENCH in each.carries for each in links) == 1
        self._pairing = Pairing() if expected.has_wrench else PairingWithTool()
        self._now_s = -np.inf

    @property
    def down(self) -> frozenset[str]:
        """Names of the links that are not open, or that send no measurement."""
        links = self._links.items()
        return frozenset(name for name, link in links if link.state is not LinkState.OPEN or link.monitor.is_lifeless)

    @property
    def wrench_frames(self) -> tuple[str, ...]:
        """Names of the frames that messages of the wrench named, in their order."""
        return tuple(name for link in self._links.values() for name in link.frames.names)

    @property
    def skin_unit(self) -> str:
        """Unit that the skin's device names; empty for raw values."""
        return "" if self._skin_link is None else self._skin_link.skin_unit

    @property
    def unpaired(self) -> int:
        """Skin frames that found no wrench, LATE or UNPAIRED; the losses of the skin's link count them by reason."""
        return self._pairing.counts.total()

    def use_tool_delay(self, delay_s: float) -> None:
        """Take the poses of the tool to be from this much before their stamps, s, from the next skin frame on."""
        self._pairing.tool_delay_s = delay_s

    @property
    def tool_change_s(self) -> float:
        """Median time, s, from one pose of the moving tool to the next different one; NaN with few of them."""
        return self._pairing.tool_change_s

    def check(self, item: Chunk | LinkEvent) -> None:
        """Raise InputError for an item of an unknown link."""
        if item.link not in self._links:
            raise InputError(f"Bytes of a link named {item.link!r} came; expected one of {', '.join(self._links) or 'none'}.")

    def feed(self, item: Chunk | LinkEvent) -> list[Sample]:
        """Process the next item of the queue or the journal; return the completed samples, in order. Raises as `check`."""
        self.check(item)
        link = self._links[item.link]
        for arrived in link.feed(item):
            self._add_to_pairing(arrived)
        self._note_frames_of(link)
        if link.monitor.is_frozen != (item.link in self.frozen):
            self.frozen ^= {item.link}
        # Two readers stamp their bytes before they queue them, so items may be out of order by a little.
        self._now_s = max(self._now_s, item.host_ns * 1e-9)
        return self._pairing.pop_paired(self._now_s)

    @property
    def is_frame_waiting(self) -> bool:
        """Whether a skin frame waits for its wrench."""
        return self._pairing.is_waiting

    def knows(self, link: str) -> bool:
        """Whether a link has this name."""
        return link in self._links

    def feed_many(self, chunks: Sequence[Chunk]) -> Iterator[tuple[Sequence[Sample], bool]]:
        """Process the next chunks of known links together, with the effect of `feed` for each.

        Yields after each chunk its samples, and whether its link froze or works again. Until the last one, `health` is ahead.
        """
        parts = {
            name: self._feed_parts(self._links[name], [each for each in chunks if each.link == name])
            for name in dict.fromkeys(chunk.link for chunk in chunks)
        }
        pairing = self._pairing
        for chunk in chunks:
            name = chunk.link
            is_frozen = next(parts[name])
            changes_frozen = is_frozen != (name in self.frozen)
            if changes_frozen:
                self.frozen ^= {name}
            self._now_s = max(self._now_s, chunk.host_ns * 1e-9)
            yield pairing.pop_paired(self._now_s) if pairing.is_waiting else (), changes_frozen

    def _feed_parts(self, link: LinkIntake, chunks: Sequence[Chunk]) -> Iterator[bool]:
        """Add the readings of a link's chunks to the pairing, a chunk at a time; yield whether the link is frozen after it."""
        for found in link.feed_many(chunks):
            self._note_frames_of(link)
            if isinstance(found, LinkRun):
                yield from self._add_run(found)
                continue
            for arrived in found:
                self._add_to_pairing(arrived)
            yield link.monitor.is_frozen

    def _add_run(self, run: LinkRun) -> Iterator[bool]:
        """Add the readings of a run to the pairing, a chunk at a time; yield whether its link is frozen after it."""
        whole, ends = run.whole, [0, *run.ends]
        # Wrenches of two links would be stored in another order.
        if (
            whole.batch.stream is Stream.WRENCH
            and self._has_one_wrench
            and self._pairing.hold_wrench(whole.stamps, whole.batch)
        ):
            for (begin, end), is_frozen in zip(pairwise(ends), run.frozen, strict=True):
                self._pairing.ring.release(end - begin)
                yield is_frozen
            return
        parts = zip(pairwise(ends), run.arrivals, run.frozen, strict=True)
        for (begin, end), arrival_s, is_frozen in parts:
            self._add_to_pairing(TimestampedBatch(whole.batch.rows(begin, end), whole.stamps[begin:end], arrival_s))
            yield is_frozen

    def _note_frames_of(self, link: LinkIntake) -> None:
        if link.frames_named != link.frames_noted:
            link.frames_noted, self.has_new_frames = link.frames_named, True

    def _add_to_pairing(self, arrived: TimestampedBatch) -> None:
        batch, stamps, values = arrived.batch, arrived.stamps.tolist(), arrived.batch.values
        if batch.stream is Stream.WRENCH:
            self._pairing.add_wrench(arrived.stamps, batch)
        elif batch.stream is Stream.SKIN:
            for stamp, frame in zip(stamps, values, strict=True):
                self._pairing.add_frame(stamp, arrived.arrival_s, frame)
        else:
            for stamp, reading in zip(stamps, values, strict=True):
                self._add_reading(batch.stream, stamp, reading)

    def _add_reading(self, stream: Stream, stamp_s: float, values: FloatArray) -> None:
        """Add a reading of joints, tip or tool to the pairing, unless it is no use."""
        if stream is Stream.TIP:
            if len(values) >= TIP_WIDTH and all(map(math.isfinite, values.tolist())):
                self._pairing.add_tip(stamp_s, values[:TIP_WIDTH])
        elif stream is Stream.TOOL:
            if math.isfinite(values[0]):
                self._pairing.add_tool(stamp_s, values)
        elif self._expected.has_angles(values):
            self._pairing.add_joints(stamp_s, values)

    def recent_wrench(self, after_s: float = -math.inf) -> tuple[FloatArray, FloatArray]:
        """Return stamps (n,), seconds, and wrenches (n, 6) of the last ten seconds that are later than `after_s`, as sent."""
        ring = self._pairing.ring
        return ring.since(max(ring.newest_s - LIVE_CURVE_SPAN_S, math.nextafter(after_s, math.inf)))

    def side_readings(self) -> dict[str, Mapping[str, SideReading]]:
        """Return the other quantities that each link's device measured."""
        return {name: link.side_readings() for name, link in self._links.items()}

    def health(self, now_ns: int) -> tuple[LinkHealth, ...]:
        """Return the state and figures of each link; the rate counts the two seconds before `now_ns` of the monotonic clock."""
        none: Counter[Loss] = Counter()
        return tuple(
            link.health(now_ns, self._pairing.counts if Stream.SKIN in link.spec.carries else none)
            for link in self._links.values()
        )


class TimestampedBatch(NamedTuple):
    """Readings of one stream that arrived together."""

    batch: Batch
    stamps: FloatArray
    """(n,) host's clock at each reading, seconds."""
    arrival_s: float


class LinkRun(NamedTuple):
    """Readings of successive chunks of a link, decoded together."""

    whole: TimestampedBatch
    ends: list[int]
    """Row after the readings of each chunk."""
    arrivals: list[float]
    """Arrival of each chunk, seconds."""
    frozen: list[bool]
    """Whether the link is frozen after each chunk."""


class DecodedChunk(NamedTuple):
    """Readings of one chunk, not dated yet."""

    batches: list[tuple[int, Batch]]
    """Each with its arrival, ns."""
    loses_count: bool
    """After this chunk a count of readings no longer gives the time."""
    has_news: bool
    """The device named a frame or a unit, or measures something else, too."""


class LinkIntake:
    """One link: its decoder, its clocks and its figures."""

    def __init__(self, expected: ExpectedReadings, spec: LinkSpec, find_frame: FindFrame = unchecked_frame) -> None:
        self.spec, self._expected = spec, expected
        self.frames = WrenchFrames(find_frame)
        """Frames of the wrenches."""
        self.frames_named, self.frames_noted = 0, 0
        """Number of frames that the processed chunks named, and that `Intake.has_new_frames` counts."""
        self.skin_unit = ""
        """Unit that the device names for the skin's values; empty for raw values."""
        self._numberless = 0
        self._stamper = Timestamper()
        self._format = format_of(spec.address, spec.format)
        # Frames that need a recipe do not say what they hold, so no other decoder can read them.
        kind = None if self._format == AUTO_FORMAT else decoder_class(self._format)
        streams = spec.carries if kind is not None and kind.single_stream else SENSOR_STREAMS
        look = None if kind is not None and kind.needs_recipe else lambda: LinkDecoder(self._format, None, streams)
        self.monitor = LinkMonitor(spec.carries, expected.widths, look)
        self._decoder = self._new_decoder()
        self._losses_before: Counter[Loss] = Counter()
        """Losses of the decoders that the link had before it was last opened."""
        self._side_readings_before: Mapping[str, SideReading] = {}
        self.state, self._text = LinkState.LOST, "not opened yet"
        self._readings = 0
        self._last_ns = 0
        self._outages = Outages()
        self._outage_began_ns = 0
        """Last bytes before the present outage; 0 without one."""
        self._rate: deque[tuple[int, int]] = deque(maxlen=RATE_AVERAGING_WINDOW_NS // RATE_COUNTING_STEP_NS + 1)
        """Begin of a step, ns, and its number of readings."""

    def _new_decoder(self) -> LinkDecoder:
        decoder = make_link_decoder(self.spec.address, self._format, self._expected.channels, self.spec.carries)
        decoder.use_scene(self._expected, self.frames)
        return decoder

    def feed_many(self, chunks: Sequence[Chunk]) -> Iterator[LinkRun | list[TimestampedBatch]]:
        """Process the next chunks with the effect of `feed` for each.

        Yields runs of chunks whose readings are finite and complete, and between them the readings of a single chunk. The
        decoder may be a chunk ahead of what was yielded.
        """
        rest = deque(chunks)
        while rest and not self._is_steady:
            yield self.feed(rest.popleft())
        at_once = self._decoder.feed_many([chunk.data for chunk in rest]) if len(rest) > 1 else None
        if at_once is not None:
            self._note_names()
            yield self._dated_run(*at_once, rest)
            return
        while rest:
            usual, unusual = self._decode_usual(rest)
            if usual:
                yield self._dated_run(*_joined(usual), [rest.popleft() for _ in usual])
            if unusual is not None:
                yield self._finish_chunk(rest.popleft(), unusual)

    @property
    def _is_steady(self) -> bool:
        """Whether the link works, and carries one stream."""
        return bool(self._last_ns) and not self._outage_began_ns and len(self.spec.carries) == 1

    def _decode_usual(self, chunks: Iterable[Chunk]) -> tuple[list[Batch], DecodedChunk | None]:
        """Decode the leading chunks that a run may have: their batches, and the next chunk's readings, if there is one."""
        usual: list[Batch] = []
        for chunk in chunks:
            decoded = self._decode(chunk)
            (arrival_ns, batch), is_one = decoded.batches[0] if decoded.batches else (0, None), len(decoded.batches) == 1
            is_usual = is_one and not decoded.loses_count and not decoded.has_news and arrival_ns == chunk.host_ns
            if batch is None or not is_usual or not np.isfinite(batch.values).all():
                return usual, decoded
            if usual and usual[0].values.shape[1] != batch.values.shape[1]:
                return usual, decoded
            usual.append(batch)
        return usual, None

    def _dated_run(self, whole: Batch, ends: list[int], chunks: Collection[Chunk]) -> LinkRun:
        """Date and count readings, (n,) of one stream; `ends` are the rows after each chunk."""
        times_ns, counts = [chunk.host_ns for chunk in chunks], [end - begin for begin, end in pairwise([0, *ends])]
        arrivals = [host_ns * 1e-9 for host_ns in times_ns]
        stamps = self._stamper.stamp(whole, np.repeat(arrivals, counts))
        self._last_ns = times_ns[-1]
        self._count_readings(zip(times_ns, counts, strict=True))
        frozen = self.monitor.on_run(whole, ends, times_ns)
        return LinkRun(TimestampedBatch(whole, stamps, arrivals[-1]), ends, arrivals, frozen)

    def feed(self, item: Chunk | LinkEvent) -> list[TimestampedBatch]:
        """Return the readings that bytes, or the end of a link, complete: the format may not have been sure before."""
        return self._take_chunk(item) if isinstance(item, Chunk) else self._take_event(item)

    def _take_chunk(self, chunk: Chunk) -> list[TimestampedBatch]:
        if self._last_ns == 0 and self.state is LinkState.LOST:
            self.state, self._text = LinkState.OPEN, ""
        if self._outage_began_ns:
            self._outages, self._outage_began_ns = self._outages_until(chunk.host_ns), 0
        return self._finish_chunk(chunk, self._decode(chunk))

    def _decode(self, chunk: Chunk) -> DecodedChunk:
        losses, names = self._uncountable_losses(), (self.frames.count, self._decoder.current.skin_unit)
        batches = self._decoder.feed(chunk.data, chunk.host_ns)
        current = self._decoder.current
        has_news = names != (self.frames.count, current.skin_unit) or bool(current.side_readings)
        return DecodedChunk(batches, self._uncountable_losses() > losses, has_news)

    def _finish_chunk(self, chunk: Chunk, decoded: DecodedChunk) -> list[TimestampedBatch]:
        """Count and date the readings of a chunk."""
        self._last_ns = chunk.host_ns
        self._note_names()
        # Before the batches are dated.
        if decoded.loses_count:
            self._stamper.note_loss()
        self._count_batches(decoded.batches)
        self.monitor.on_data(chunk.data, chunk.host_ns, [batch for _, batch in decoded.batches])
        return self._dated(decoded.batches)

    def _note_names(self) -> None:
        self.frames_named, self.skin_unit = self.frames.count, self._decoder.current.skin_unit

    def _take_event(self, event: LinkEvent) -> list[TimestampedBatch]:
        batches: list[tuple[int, Batch]] = []
        self.monitor.on_event(event)
        if event.state is LinkState.ENDED:
            batches = self._decoder.finish()
            self._count_batches(batches)
        elif event.state is LinkState.OPEN and self._last_ns:
            # A new decoder: half a record from before the break must not be joined to the first one after it.
            self._losses_before += self._decoder.current.counts
            self._side_readings_before = self.side_readings()
            self._decoder = self._new_decoder()
            self._stamper.reset_clocks()
        if event.state in (LinkState.LOST, LinkState.FAILED) and self._last_ns and not self._outage_began_ns:
            self._outage_began_ns = self._last_ns
        self._note_names()
        self._losses_before[Loss.DROPPED] += event.dropped
        self.state, self._text = event.state, event.text
        return self._dated(batches)

    def _outages_until(self, now_ns: int) -> Outages:
        """Count the outages, with the present one."""
        if not self._outage_began_ns:
            return self._outages
        return self._outages.plus(Outages(1, max(0.0, (now_ns - self._outage_began_ns) * 1e-9)))

    def _dated(self, batches: Sequence[tuple[int, Batch]]) -> list[TimestampedBatch]:
        arrived = [(batch, host_ns * 1e-9) for host_ns, batch in batches]
        return [TimestampedBatch(batch, self._stamper.stamp(batch, arrival_s), arrival_s) for batch, arrival_s in arrived]

    def _uncountable_losses(self) -> int:
        counts = self._decoder.current.counts
        return sum(counts[loss] for loss in LOSSES_THAT_BREAK_COUNTING) if counts else 0

    def _count_batches(self, batches: Sequence[tuple[int, Batch]]) -> None:
        self._count_readings((arrival_ns, len(batch.seq)) for arrival_ns, batch in batches)
        self._numberless += sum(self._expected.count_numberless(batch) for _, batch in batches)

    def _count_readings(self, arrived: Iterable[tuple[int, int]]) -> None:
        """Count readings: when some arrived, ns, and how many."""
        rate = self._rate
        for arrival_ns, count in arrived:
            self._readings += count
            step_ns = arrival_ns - arrival_ns % RATE_COUNTING_STEP_NS
            if rate and rate[-1][0] == step_ns:
                rate[-1] = step_ns, rate[-1][1] + count
            else:
                rate.append((step_ns, count))

    def health(self, now_ns: int, pairing: Mapping[Loss, int] = MappingProxyType({})) -> LinkHealth:
        """Return the state and figures of the link; `pairing` holds losses of the pairing, which count for the skin's link."""
        spec, decoder = self.spec, self._decoder.current
        return LinkHealth(
            spec.name,
            self.state,
            self._text or (decoder.device_message if self.state is LinkState.OPEN else ""),
            spec.carries,
            decoder.name,
            self._readings,
            self._rate_until(now_ns),
            self._last_ns,
            losses=self._losses_before + decoder.counts + Counter(pairing),
            beside=self.side_readings(),
            frames=self.frames.names,
            units="; ".join(words for stream, words in decoder.units.items() if stream in spec.carries),
            skin_unit=self.skin_unit,
            sent_pose=self._decoder.current.sent_pose,
            verdict=self.monitor.diagnose(now_ns),
            address=spec.address,
            freezes=self.monitor.freezes,
            levels=self.monitor.levels,
            numberless=self._numberless,
            mixed=self.monitor.mixed_readings,
            outages=self._outages_until(now_ns),
        )

    def side_readings(self) -> Mapping[str, SideReading]:
        """Return the other quantities that the device measured."""
        return merge_side_readings(self._side_readings_before, self._decoder.current.side_readings)

    def _rate_until(self, now_ns: int) -> float:
        """Return readings per second over the last two seconds, or since the first reading if that is less."""
        now_step_ns = now_ns - now_ns % RATE_COUNTING_STEP_NS
        # The step in progress is not full yet: with it the rate would flicker.
        counted = [
            (step_ns, count) for step_ns, count in self._rate if now_step_ns - RATE_AVERAGING_WINDOW_NS <= step_ns < now_step_ns
        ]
        if not counted:
            return 0.0
        return sum(count for _, count in counted) / ((now_step_ns - counted[0][0]) * 1e-9)


def _joined(batches: Sequence[Batch]) -> tuple[Batch, list[int]]:
    """Join batches of one stream and width; return also the rows after each."""
    if len(batches) == 1:
        return batches[0], [len(batches[0].seq)]
    columns = zip(*((each.seq, each.device_s, each.values, each.saturated, each.invalid) for each in batches), strict=True)
    return Batch(batches[0].stream, *map(np.concatenate, columns)), list(accumulate(len(each.seq) for each in batches))
