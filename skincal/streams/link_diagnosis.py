"""Diagnose a link: expected readings, readings of another stream, no readings, or frozen values.

The diagnosis uses the link's state, the instants of its bytes and readings, their number of values and their bits. While a
wanted stream is missing, a second decoder, which takes every stream of every width, tells what comes instead.

*Frozen.* A force/torque sensor always has noise. If its readings do not differ in one bit for `FROZEN_IF_UNCHANGED_FOR_NS`, it
has stopped to measure or its driver repeats old readings, provided that most readings before differed from the one before them,
or that none ever did. In between lies a sensor whose resolution hides its noise: it is not called frozen. Joints that stand
still repeat every bit, and so does a skin of eight bits behind a threshold: they are never called frozen.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray
from skincal.model.readings import LINK_SILENT_AFTER_S, Batch, Freeze, LinkAnswer, LinkEvent, LinkState, LinkVerdict, Stream
from skincal.streams.decoders.auto_detect import LinkDecoder
from skincal.streams.decoders.line_forms import last_clean_line, nearest_form

REPORT_NO_READING_AFTER_NS = 1_000_000_000
"""ns of bytes without a reading: text is believed after 0.3 s, and a slow board sends ten readings in this time."""
SILENT_NS = round(LINK_SILENT_AFTER_S * 1e9)
FROZEN_IF_UNCHANGED_FOR_NS = 1_000_000_000
NOISE_MIN_SHARE = {
    Stream.WRENCH: 0.5, Stream.SKIN: 0.9, Stream.JOINTS: math.inf, Stream.TIP: math.inf, Stream.TOOL: math.inf,
}  # fmt: skip
"""Share of the readings that differ from the one before them, from which a stream has noise. A skin behind a threshold has a
small one; joints and a tip may rest."""
ALTERNATION_MIN_RATIO = 10.0
"""Change from a wrench to the next one, over that to the one after it, in a mixture of two series; noise has about 1."""
ALTERNATION_MIN_FORCE_N = 0.5
"""Smallest such change: above the steps of a coarse sensor."""
ALTERNATION_MIN_READINGS = 20
"""Wrenches in a row that alternate. No vibration of half the sensor's rate lasts as long, so far above the noise."""
MAX_SKIN_LEVELS = 2
"""Values of a skin that was made binary."""
NOISE_MIN_CHANGED_READINGS = 20
"""Readings that differ from the one before, until a stream is known to have noise."""
MIN_READINGS_FOR_DIAGNOSIS = 5
"""Equal readings that show a wrong stream, or that nothing changes; garbage now and then holds a line with a number."""
TAIL_BYTES = 1024
"""Last bytes that are kept to show a line of a link without readings."""
MAX_VALUES_PER_WRENCH_READING = 12
"""No force/torque sensor sends more values with a reading: six, or six and as many of something else."""


class Differences(NamedTuple):
    """Differences of readings of one stream that came together, each from the one before it."""

    readings: int
    changes: int
    """Number of readings that differ in a bit."""
    newest: int
    """Index of the last of these; 0 if there is none."""
    last: NDArray[np.uint64]
    """(1, width) bits of the last reading."""


class _StreamHistory:
    """Arrival times of one stream's readings, and whether their values change or repeat."""

    def __init__(self, stream: Stream, last: NDArray[np.uint64], host_ns: int) -> None:
        self._noise_share = NOISE_MIN_SHARE[stream]
        self._ended_freezes: list[tuple[int, int | None]] = []
        self.last_ns = self._changed_ns = host_ns
        self.last = last
        """(1, width) bits of the last reading."""
        self._equal = 0
        """Readings since a bit changed."""
        self._changes = 0
        self._earlier = 0
        """Readings before the equal ones, without those of a freeze."""

    def add(self, change: Differences, host_ns: int) -> None:
        """Add readings, in their order."""
        if change.changes:
            if self.is_frozen:
                self._ended_freezes.append((self._changed_ns, host_ns))
            self._earlier += change.newest + (0 if self.is_frozen else self._equal)
            self._changes, self._changed_ns, self._equal = self._changes + change.changes, host_ns, -change.newest
        self._equal += change.readings
        self.last_ns, self.last = host_ns, change.last

    def add_parts(
        self, changed: NDArray[np.bool_], ends: Sequence[int], host_ns: Sequence[int], last: NDArray[np.uint64]
    ) -> list[bool]:
        """Add readings that came in parts; return after each part whether the stream is frozen.

        Parameters
        ----------
        changed : (n,) whether each reading differs from the one before it
        ends : rows after each part, ascending
        host_ns : arrival of each part
        last : (1, width) bits of the last reading
        """
        is_quick = all(
            0 <= after - before < FROZEN_IF_UNCHANGED_FOR_NS for before, after in pairwise([self._changed_ns, *host_ns])
        )
        if not self.is_frozen and is_quick and changed.all():
            # The usual sensor with noise.
            self._earlier += self._equal + len(changed) - 1
            self._changes, self._equal = self._changes + len(changed), 1
            self.last_ns, self.last, self._changed_ns = host_ns[-1], last, host_ns[-1]
            return [False] * len(ends)
        count, rows, times = len(changed), changed.nonzero()[0], np.array(host_ns)
        changed_ns = times[np.searchsorted(ends, rows, side="right")]
        unchanged_ns = np.diff(changed_ns, prepend=self._changed_ns, append=times[-1])
        if self.is_frozen or unchanged_ns.max() >= FROZEN_IF_UNCHANGED_FOR_NS or (times[1:] < times[:-1]).any():
            return self._add_each_part(changed, ends, host_ns, last)
        equal = count - int(rows[-1]) if len(rows) else self._equal + count
        self._earlier += self._equal + count - equal
        self._changes, self._equal = self._changes + len(rows), equal
        self._changed_ns = int(changed_ns[-1]) if len(rows) else self._changed_ns
        self.last_ns, self.last = host_ns[-1], last
        return [False] * len(ends)

    def _add_each_part(
        self, changed: NDArray[np.bool_], ends: Sequence[int], host_ns: Sequence[int], last: NDArray[np.uint64]
    ) -> list[bool]:
        found: list[bool] = []
        for (begin, end), at_ns in zip(pairwise([0, *ends]), host_ns, strict=True):
            self.add(_differences(changed[begin:end], last), at_ns)
            found.append(self.is_frozen)
        return found

    @property
    def width(self) -> int:
        return self.last.shape[1]

    @property
    def _is_constant(self) -> bool:
        return self._equal >= MIN_READINGS_FOR_DIAGNOSIS and self.last_ns - self._changed_ns >= FROZEN_IF_UNCHANGED_FOR_NS

    @property
    def is_frozen(self) -> bool:
        """Whether no bit has changed for long, and most readings before that differed from the one before them."""
        is_noisy = self._changes >= NOISE_MIN_CHANGED_READINGS and self._changes > self._noise_share * self._earlier
        return is_noisy and self._is_constant

    @property
    def never_changed(self) -> bool:
        return self._is_constant and not self._changes

    @property
    def freezes(self) -> list[tuple[int, int | None]]:
        """Begin and end of each freeze, ns; no end for the present one."""
        return [*self._ended_freezes, *([(self._changed_ns, None)] if self.is_frozen else [])]

    @property
    def constant_since_ns(self) -> int:
        """Arrival of the last reading that differed from the one before it, or of the first one."""
        return self._changed_ns


def _add_levels(levels: set[float], values: FloatArray) -> set[float] | None:
    """Add the values of skin frames, (n, channels); `None` if there are more than `MAX_SKIN_LEVELS`."""
    known = list(levels)
    if len(known) == MAX_SKIN_LEVELS and ((values == known[0]) | (values == known[1]) | np.isnan(values)).all():
        return levels
    # The usual skin has more values in one frame.
    for row in (values[:1], values):
        levels = levels | set(np.unique(row[np.isfinite(row)]).tolist())
        if len(levels) > MAX_SKIN_LEVELS:
            return None
    return levels


def _differences(changed: NDArray[np.bool_], last: NDArray[np.uint64]) -> Differences:
    """Count the readings (n,) that changed; `last` is (1, width), the bits of the last one."""
    rows = changed.nonzero()[0]
    return Differences(len(changed), len(rows), int(rows[-1]) if len(rows) else 0, last)


def _bits(values: FloatArray) -> NDArray[np.uint64]:
    return np.atleast_2d(np.ascontiguousarray(values)).view(np.uint64)


class LinkMonitor:
    """Collects the data of one link, and diagnoses the link.

    Parameters
    ----------
    carries : wanted streams; none for those that come
    widths : number of values of a reading of each stream, if it is known; for joints and a tip the least
    make_fallback : makes a decoder of every stream and width; `None` if the format cannot be read so
    noisy : streams whose readings always differ
    """

    def __init__(
        self,
        carries: Sequence[Stream],
        widths: Mapping[Stream, int],
        make_fallback: Callable[[], LinkDecoder] | None,
        noisy: Collection[Stream] = (Stream.WRENCH,),
    ) -> None:
        self._carries, self._widths, self._noisy = tuple(carries), widths, noisy
        self._make_fallback = make_fallback
        self._streams: dict[Stream, _StreamHistory] = {}
        self._freezes_before: list[Freeze] = []
        """Of the devices that the link had before."""
        self.mixed_readings = 0
        """Wrenches that alternate between two series."""
        self._wrenches: FloatArray = np.empty((0, 6))
        """The last two."""
        self._alternating = 0
        self._levels: set[float] | None = set()
        """Values of the skin so far; `None` for more than `MAX_SKIN_LEVELS`."""
        self._bauds_tried: tuple[int, ...] = ()
        self._has_failed = False
        self._ended_ns: int | None = None
        self._forget_data(0)

    def _forget_data(self, host_ns: int) -> None:
        """Forget the data: another device may be connected now."""
        self._freezes_before = list(self.freezes)
        self._streams.clear()
        self._opened_ns, self._last_ns = host_ns, 0
        self._tail = b""
        """Last bytes while a wanted stream is missing."""
        self._missing_since_ns: int | None = None
        """Arrival of the first bytes while a wanted stream is missing."""
        self._fallback: LinkDecoder | None = None
        self._unexpected: Counter[tuple[Stream, int]] = Counter()
        """Number of unwanted readings by stream and number of values."""

    def on_event(self, event: LinkEvent) -> None:
        """Follow the link's state."""
        self._has_failed = event.state in (LinkState.LOST, LinkState.FAILED)
        self._ended_ns = event.host_ns if event.state is LinkState.ENDED else None
        if event.state is not LinkState.OPEN or event.dropped:
            return
        self._bauds_tried = event.tried
        if event.tried:
            self._fallback = None
        else:
            self._forget_data(event.host_ns)

    def _find_changes(self, batch: Batch) -> tuple[NDArray[np.bool_], NDArray[np.uint64]]:
        """Find the (n,) readings that differ from the one before them; return also the bits of the last one, (1, width)."""
        known, bits = self._streams.get(batch.stream), _bits(batch.values)
        changed = np.zeros(len(bits), np.bool_)
        if len(bits) > 1:
            changed[1:] = (bits[1:] != bits[:-1]).any(axis=1)
        if known is not None and known.width == bits.shape[1]:
            changed[0] = not np.array_equal(bits[:1], known.last)
        return changed, bits[-1:]

    def _history(self, stream: Stream, last: NDArray[np.uint64], host_ns: int) -> _StreamHistory:
        """Find the history of a stream; begin a new one for another width."""
        known = self._streams.get(stream)
        if known is None or known.width != last.shape[1]:
            known = self._streams[stream] = _StreamHistory(stream, last, host_ns)
        return known

    def on_data(self, data: bytes, host_ns: int, batches: Sequence[Batch]) -> None:
        """Process bytes, and the readings that a decoder of the wanted streams made of them."""
        self._last_ns = host_ns
        self._opened_ns = self._opened_ns or host_ns
        for batch in batches:
            if np.isfinite(batch.values[-1]).any():
                changed, last = self._find_changes(batch)
                self._history(batch.stream, last, host_ns).add(_differences(changed, last), host_ns)
            self._look_at_values(batch)
        if self._wanted_streams and not self._missing(host_ns):
            self._note_nothing_missing()
        else:
            self._missing_since_ns = self._missing_since_ns or host_ns
            self._count_unexpected(data, host_ns)

    def on_run(self, batch: Batch, ends: Sequence[int], host_ns: Sequence[int]) -> list[bool]:
        """Process finite readings of the only wanted stream, which came in parts of one reading or more.

        The effect is that of `on_data` for each part. Returns after each part whether the link is frozen.

        Parameters
        ----------
        ends : rows after each part, ascending
        host_ns : arrival of each part
        """
        self._last_ns = host_ns[-1]
        self._opened_ns = self._opened_ns or host_ns[0]
        changed, last = self._find_changes(batch)
        frozen = self._history(batch.stream, last, host_ns[0]).add_parts(changed, ends, host_ns, last)
        self._look_at_values(batch)
        self._note_nothing_missing()
        return frozen if batch.stream in self._noisy else [False] * len(ends)

    def _look_at_values(self, batch: Batch) -> None:
        if batch.stream is Stream.WRENCH:
            self._count_alternations(self.find_alternations(batch.values))
        if batch.stream is Stream.SKIN and self._levels is not None:
            self._levels = _add_levels(self._levels, batch.values)

    def _note_nothing_missing(self) -> None:
        self._missing_since_ns, self._fallback, self._tail = None, None, b""
        self._unexpected.clear()

    def find_alternations(self, values: FloatArray) -> list[bool]:
        """Find the next (n, 6) wrenches that differ from the one before them, but not from the one before that.

        The first two readings have no such, and are left out.
        """
        known = self._wrenches if self._wrenches.shape[1] == values.shape[1] else values[:0]
        rows = np.concatenate([known, values])
        self._wrenches = rows[-2:]
        offs = (rows[2:, :3] - before[:, :3] for before in (rows[1:-1], rows[:-2]))
        # As `np.linalg.norm`, in half its time for few rows.
        step, over_two = (np.sqrt(np.add.reduce(off * off, axis=1)) for off in offs)
        found: list[bool] = (step > np.maximum(ALTERNATION_MIN_RATIO * over_two, ALTERNATION_MIN_FORCE_N)).tolist()
        return found

    def _count_alternations(self, alternates: Sequence[bool]) -> None:
        """Count wrenches that alternate between two series."""
        if not self._alternating and True not in alternates:
            return
        for each in alternates:
            self._alternating = self._alternating + 1 if each else 0
            if self._alternating >= ALTERNATION_MIN_READINGS:
                self.mixed_readings += ALTERNATION_MIN_READINGS if self._alternating == ALTERNATION_MIN_READINGS else 1

    def _count_unexpected(self, data: bytes, host_ns: int) -> None:
        self._tail = (self._tail + data[-TAIL_BYTES:])[-TAIL_BYTES:]
        if self._fallback is None and self._make_fallback is not None:
            self._fallback = self._make_fallback()
        for _, batch in [] if self._fallback is None else self._fallback.feed(data, host_ns):
            width = batch.values.shape[1]
            if batch.stream not in self._carries or width != self._widths.get(batch.stream, width):
                self._unexpected[batch.stream, width] += len(batch.seq)

    @property
    def levels(self) -> tuple[float, ...]:
        """The two values that all channels of the skin ever had; empty if they had one, or more."""
        return tuple(sorted(self._levels)) if self._levels is not None and len(self._levels) == MAX_SKIN_LEVELS else ()

    @property
    def freezes(self) -> tuple[Freeze, ...]:
        """Freezes of the streams with noise."""
        found = list(self._freezes_before)
        for stream, history in self._streams.items():
            found += [Freeze(stream, *span) for span in history.freezes]
            if stream in self._noisy and history.never_changed:
                found.append(Freeze(stream, history.constant_since_ns, None))
        return tuple(found)

    @property
    def is_frozen(self) -> bool:
        """Whether a stream that always has noise, and showed it, repeats one reading."""
        return any(self._streams[stream].is_frozen for stream in self._noisy if stream in self._streams)

    @property
    def is_lifeless(self) -> bool:
        """Whether a stream that always has noise is frozen, or never changed: it is no measurement."""
        return any(self._is_lifeless(stream) for stream in self._streams)

    def _is_lifeless(self, stream: Stream) -> bool:
        history = self._streams[stream]
        return stream in self._noisy and (history.is_frozen or history.never_changed)

    def diagnose(self, now_ns: int) -> LinkVerdict:
        """Diagnose the link at an instant of the host's monotonic clock."""
        now_ns = now_ns if self._ended_ns is None else min(now_ns, self._ended_ns)
        missing = self._missing(now_ns)
        first = missing[0] if missing else None
        if self._has_failed:
            return LinkVerdict(LinkAnswer.NO_ANSWER, first)
        if self._wanted_streams and not missing:
            return self._diagnose_readings()
        if self._last_ns and now_ns - self._last_ns <= SILENT_NS:
            return self._diagnose_bytes(first, now_ns)
        is_silent = self._opened_ns and now_ns - self._opened_ns > SILENT_NS
        return LinkVerdict(LinkAnswer.NO_ANSWER if is_silent else LinkAnswer.LISTENING, first, tried=self._bauds_tried)

    @property
    def _wanted_streams(self) -> tuple[Stream, ...]:
        return self._carries or tuple(self._streams)

    def _missing(self, now_ns: int) -> list[Stream]:
        """Return the wanted streams without a recent reading."""
        known = self._streams
        return [each for each in self._wanted_streams if each not in known or now_ns - known[each].last_ns > SILENT_NS]

    def _diagnose_readings(self) -> LinkVerdict:
        for stream in self._wanted_streams:
            width = self._streams[stream].width
            has_any_width = stream in (Stream.JOINTS, Stream.TIP)
            if has_any_width and (width < self._widths.get(stream, 0) or self._is_skin(width, stream)):
                return self._wrong_width(stream, stream, width)
            if self._is_lifeless(stream):
                return LinkVerdict(LinkAnswer.FROZEN, stream)
        skin = self._streams.get(Stream.SKIN)
        return LinkVerdict(LinkAnswer.GOOD, tried=self._bauds_tried, unchanged=skin is not None and skin.never_changed)

    def _diagnose_bytes(self, wanted: Stream | None, now_ns: int) -> LinkVerdict:
        if self._fallback is not None and self._unexpected and wanted is not None:
            (stream, width), count = self._unexpected.most_common(1)[0]
            if count >= MIN_READINGS_FOR_DIAGNOSIS and count > self._fallback.current.counts.total():
                return replace(self._wrong_width(wanted, stream, width), line=last_clean_line(self._tail))
        is_early = self._missing_since_ns is None or now_ns - self._missing_since_ns < REPORT_NO_READING_AFTER_NS
        if is_early:
            return LinkVerdict(LinkAnswer.LISTENING, wanted, tried=self._bauds_tried)
        line = last_clean_line(self._tail)
        nearest = nearest_form(line) if line else ""
        return LinkVerdict(LinkAnswer.NO_READING, wanted, tried=self._bauds_tried, line=line, nearest=nearest)

    def _wrong_width(self, wanted: Stream, decoded_as: Stream, width: int) -> LinkVerdict:
        """Name the stream that sends lines of this width; lines without names were decoded as a skin of any width."""
        found = Stream.WRENCH if decoded_as is Stream.WRENCH else Stream.SKIN if self._is_skin(width, wanted) else wanted
        if found is not wanted and found not in self._carries:
            return LinkVerdict(LinkAnswer.OTHER_STREAM, wanted, found, width)
        return LinkVerdict(LinkAnswer.OTHER_WIDTH, wanted, width=width, expected=self._widths.get(wanted, 0))

    def _is_skin(self, width: int, wanted: Stream) -> bool:
        # An arm may have any number of joints: an iCub's arm port sends 16.
        return width == self._widths.get(Stream.SKIN) or (wanted is not Stream.JOINTS and width > MAX_VALUES_PER_WRENCH_READING)
