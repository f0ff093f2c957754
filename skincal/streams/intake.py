"""Chunks and events of all links in, paired samples out.

The output depends on the items fed and nothing else: no wall clock, no thread. So a journal of the items, fed again, gives the
same samples bit for bit.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from skincal.devices.family import AUTO
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
from skincal.streams.link_diagnosis import Differences, LinkMonitor
from skincal.streams.links import LinkSpec, format_of, make_link_decoder
from skincal.streams.pairing import Pairing

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
        self._pairing = Pairing()
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
        return next((link.skin_unit for link in self._links.values() if Stream.SKIN in link.spec.carries), "")

    @property
    def unpaired(self) -> int:
        """Skin frames that found no wrench, LATE or UNPAIRED; the losses of the skin's link count them by reason."""
        return self._pairing.counts.total()

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
        if link.frames.count != link.frames_noted:
            link.frames_noted, self.has_new_frames = link.frames.count, True
        if link.monitor.is_frozen != (item.link in self.frozen):
            self.frozen ^= {item.link}
        # Two readers stamp their bytes before they queue them, so items may be out of order by a little.
        self._now_s = max(self._now_s, item.host_ns * 1e-9)
        return self._pairing.pop_paired(self._now_s)

    def read_ahead(self, chunks: Sequence[Chunk]) -> None:
        """Decode the chunks that are fed next, in this order, many at a time. The samples stay the same."""
        for name, link in self._links.items():
            link.read_ahead([chunk for chunk in chunks if chunk.link == name])

    def _add_to_pairing(self, arrived: TimestampedBatch) -> None:
        batch, stamps = arrived.batch, arrived.stamps
        if batch.stream is Stream.WRENCH:
            self._pairing.add_wrench(stamps, batch)
            return
        for stamp, values in zip(stamps.tolist(), batch.values, strict=True):
            if batch.stream is Stream.SKIN:
                self._pairing.add_frame(stamp, arrived.arrival_s, values)
            elif batch.stream is Stream.TIP:
                if len(values) >= TIP_WIDTH and all(map(math.isfinite, values.tolist())):
                    self._pairing.add_tip(stamp, values[:TIP_WIDTH])
            elif batch.stream is Stream.TOOL:
                if math.isfinite(values[0]):
                    self._pairing.add_tool(stamp, values)
            elif self._expected.has_angles(values):
                self._pairing.add_joints(stamp, values)

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
    change: Differences | None = None
    """Differences between the readings, if they were read ahead."""


class LinkIntake:
    """One link: its decoder, its clocks and its figures."""

    def __init__(self, expected: ExpectedReadings, spec: LinkSpec, find_frame: FindFrame = unchecked_frame) -> None:
        self.spec, self._expected = spec, expected
        self.frames = WrenchFrames(find_frame)
        """Frames of the wrenches."""
        self.frames_noted = 0
        """Number of them that `Intake.has_new_frames` counts."""
        self._numberless = 0
        self._stamper = Timestamper()
        self._format = format_of(spec.address, spec.format)
        # Frames that need a recipe do not say what they hold, so no other decoder can read them.
        kind = None if self._format == AUTO else decoder_class(self._format)
        streams = spec.carries if kind is not None and kind.single_stream else SENSOR_STREAMS
        look = None if kind is not None and kind.needs_recipe else lambda: LinkDecoder(self._format, None, streams)
        self.monitor = LinkMonitor(spec.carries, expected.widths, look)
        self._decoder = self._new_decoder()
        self._ahead: deque[tuple[Chunk, TimestampedBatch]] = deque()
        """Chunks that are decoded and dated already."""
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

    def read_ahead(self, chunks: Sequence[Chunk]) -> None:
        """Decode and date the next chunks of this link at once, if their format allows it."""
        found = self._decoder.feed_many([chunk.data for chunk in chunks])
        if found is None:
            return
        whole, ends = found
        arrivals = [chunk.host_ns * 1e-9 for chunk in chunks]
        stamps = self._stamper.stamp(whole, np.repeat(arrivals, np.diff(ends, prepend=0)))
        parts = (stamps[begin:end] for begin, end in pairwise([0, *ends]))
        dated = map(TimestampedBatch, whole.cut(ends), parts, arrivals, self.monitor.compare_ahead(whole, ends))
        self._ahead.extend(zip(chunks, dated, strict=True))

    def feed(self, item: Chunk | LinkEvent) -> list[TimestampedBatch]:
        """Return the readings that bytes, or the end of a link, complete: the format may not have been sure before."""
        return self._take_chunk(item) if isinstance(item, Chunk) else self._take_event(item)

    def _take_chunk(self, chunk: Chunk) -> list[TimestampedBatch]:
        if self._last_ns == 0 and self.state is LinkState.LOST:
            self.state, self._text = LinkState.OPEN, ""
        if self._outage_began_ns:
            self._outages, self._outage_began_ns = self._outages_until(chunk.host_ns), 0
        self._last_ns = chunk.host_ns
        if self._ahead:
            ahead, dated = self._ahead.popleft()
            assert ahead is chunk, "chunks come in the order in which they were read ahead"
            self._count_readings([(chunk.host_ns, dated.batch)])
            self.monitor.on_data(chunk.data, chunk.host_ns, [dated.batch], dated.change)
            return [dated]
        # Counted before the batches are dated: after a loss a count of readings no longer gives the time.
        before = self._uncountable_losses()
        batches = self._decoder.feed(chunk.data, chunk.host_ns)
        if self._uncountable_losses() > before:
            self._stamper.note_loss()
        self._count_readings(batches)
        self._numberless += sum(self._expected.count_numberless(batch) for _, batch in batches)
        self.monitor.on_data(chunk.data, chunk.host_ns, [batch for _, batch in batches])
        return self._dated(batches)

    def _take_event(self, event: LinkEvent) -> list[TimestampedBatch]:
        batches: list[tuple[int, Batch]] = []
        self.monitor.on_event(event)
        if event.state is LinkState.ENDED:
            batches = self._decoder.finish()
            self._count_readings(batches)
            self._numberless += sum(self._expected.count_numberless(batch) for _, batch in batches)
        elif event.state is LinkState.OPEN and self._last_ns:
            # A new decoder: half a record from before the break must not be joined to the first one after it.
            self._losses_before += self._decoder.current.counts
            self._side_readings_before = self.side_readings()
            self._decoder = self._new_decoder()
            self._stamper.reset_clocks()
        if event.state in (LinkState.LOST, LinkState.FAILED) and self._last_ns and not self._outage_began_ns:
            self._outage_began_ns = self._last_ns
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

    def _count_readings(self, batches: list[tuple[int, Batch]]) -> None:
        for arrival_ns, batch in batches:
            self._readings += len(batch.seq)
            step_ns, count = arrival_ns - arrival_ns % RATE_COUNTING_STEP_NS, len(batch.seq)
            if self._rate and self._rate[-1][0] == step_ns:
                count += self._rate.pop()[1]
            self._rate.append((step_ns, count))

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
            verdict=self.monitor.diagnose(now_ns),
            address=spec.address,
            freezes=self.monitor.freezes,
            levels=self.monitor.levels,
            numberless=self._numberless,
            mixed=self.monitor.mixed_readings,
            outages=self._outages_until(now_ns),
        )

    @property
    def skin_unit(self) -> str:
        """Unit that the device names for the skin's values; empty for raw values."""
        return self._decoder.current.skin_unit

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
