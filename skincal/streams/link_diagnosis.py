"""What a link brings, judged: readings as wanted, another stream's, none at all, or always the same one.

A link is judged by its state, the instants of its bytes and readings, their number of values and their bits. While something
is missing that is wanted, a second decoder, which takes every stream of every width, says what comes instead.

*Frozen.* A force/torque sensor always has noise. So one whose readings do not differ in one bit for `FROZEN_NS` has stopped to
measure, or its driver repeats old ones, if most readings before differed from the one before them, or if none ever did; what
lies between is a sensor that is read too coarsely to show its noise, and is left alone. Joints that stand still are the same to
the last bit, and so is a skin of eight bits behind a threshold: they are never called frozen.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray
from skincal.model.readings import (
    SILENT_S,
    Batch,
    LinkAnswer,
    LinkEvent,
    LinkState,
    LinkVerdict,
    SkinBatch,
    Stream,
    WrenchBatch,
)
from skincal.streams.decoders.auto_detect import LinkDecoder

JUDGE_NS = 1_000_000_000
"""ns of bytes without a reading before that is said: text is believed after 0.3 s, a slow board sends ten readings."""
SILENT_NS = round(SILENT_S * 1e9)
FROZEN_NS = 1_000_000_000
"""ns without a bit that changes."""
NOISY = 20
"""Readings that differ from the one before, at least, until a stream is known to have noise."""
ENOUGH = 5
"""Readings alike that show what comes, or that nothing changes; garbage now and then holds a line with a number."""
MAX_WRENCH_VALUES = 12
"""Values. No force/torque sensor sends more with a reading: six, or six and as many of something else."""


def values_of(batch: Batch) -> tuple[Stream, FloatArray]:
    """Return the stream of a batch and its values, (n, width)."""
    if isinstance(batch, WrenchBatch):
        return Stream.WRENCH, batch.wrench
    return (Stream.SKIN, batch.values) if isinstance(batch, SkinBatch) else (Stream.JOINTS, batch.angles)


class Differences(NamedTuple):
    """How readings of one stream that came together differ, each from the one before it."""

    readings: int
    changes: int
    """How many of them differ in a bit."""
    newest: int
    """Index of the last of these; 0 where there is none."""
    last: NDArray[np.uint64]
    """(1, width) bits of the last reading."""


def _changes(before: NDArray[np.uint64], bits: NDArray[np.uint64], ends: Sequence[int]) -> list[Differences]:
    """Return the change of each part of (n, width) readings; each part ends before one of `ends`, ascending to n."""
    differs = np.empty(len(bits), np.int64)
    differs[0] = (bits[:1] != before).any()
    differs[1:] = (bits[1:] != bits[:-1]).any(axis=1)
    begins = np.array([0, *ends[:-1]])
    changes = np.add.reduceat(differs, begins)
    newest = np.maximum(np.maximum.reduceat(differs * np.arange(len(bits)), begins) - begins, 0)
    parts = zip(pairwise([0, *ends]), changes.tolist(), newest.tolist(), strict=True)
    return [Differences(end - begin, count, at, bits[end - 1 : end]) for (begin, end), count, at in parts]


class _Heard:
    """What one stream brought: when, and how its bits changed from reading to reading."""

    def __init__(self, last: NDArray[np.uint64], host_ns: int) -> None:
        self.last_ns = self.changed_ns = host_ns
        self.last = last
        """(1, width) bits of the last reading."""
        self._alike = 0
        """Readings since a bit changed."""
        self.changes = 0
        self._counted = 0
        """Readings before these, without those of a freeze."""

    def take(self, change: Differences, host_ns: int) -> None:
        """Take readings, in their order."""
        if change.changes:
            self._counted += change.newest + (0 if self.froze else self._alike)
            self.changes, self.changed_ns, self._alike = self.changes + change.changes, host_ns, -change.newest
        self._alike += change.readings
        self.last_ns, self.last = host_ns, change.last

    @property
    def constant(self) -> bool:
        """Whether no bit has changed for long."""
        return self._alike >= ENOUGH and self.last_ns - self.changed_ns >= FROZEN_NS

    @property
    def froze(self) -> bool:
        """Whether no bit has changed for long, where before at least every second reading differed from the one before."""
        return self.constant and self.changes >= NOISY and 2 * self.changes > self._counted

    @property
    def lifeless(self) -> bool:
        """Whether no bit has changed for long after noise, or ever."""
        return self.froze or (self.constant and not self.changes)


def _bits(values: FloatArray) -> NDArray[np.uint64]:
    return np.atleast_2d(np.ascontiguousarray(values)).view(np.uint64)


class LinkMonitor:
    """Hears what one link brings, and judges it.

    Parameters
    ----------
    carries : streams that are wanted of it; none for those that come
    widths : number of values of a reading of each stream, as far as it is known; for joints the least
    second_look : makes a decoder of every stream and width; None where the format cannot be read so
    noisy : streams whose readings always differ
    """

    def __init__(
        self,
        carries: Sequence[Stream],
        widths: Mapping[Stream, int],
        second_look: Callable[[], LinkDecoder] | None,
        noisy: Collection[Stream] = (Stream.WRENCH,),
    ) -> None:
        self._carries, self._widths, self._noisy = tuple(carries), widths, noisy
        self._make = second_look
        self._heard: dict[Stream, _Heard] = {}
        self._tried: tuple[int, ...] = ()
        self._failed = False
        self._ended_ns: int | None = None
        self._begin(0)

    def _begin(self, host_ns: int) -> None:
        """Begin to listen, to another device perhaps."""
        self._opened_ns, self._last_ns = host_ns, 0
        self._since_ns: int | None = None
        """Arrival of the first bytes while something that is wanted is missing."""
        self._look: LinkDecoder | None = None
        self._instead: Counter[tuple[Stream, int]] = Counter()
        """Readings that are not wanted, by what they are taken for and their number of values."""

    def follow(self, event: LinkEvent) -> None:
        """Follow the link's state."""
        self._failed = event.state in (LinkState.LOST, LinkState.FAILED)
        self._ended_ns = event.host_ns if event.state is LinkState.ENDED else None
        if event.state is not LinkState.OPEN or event.dropped:
            return
        self._tried = event.tried
        if event.tried:
            self._look = None
        else:
            self._heard.clear()
            self._begin(event.host_ns)

    def compare(self, batch: Batch, ends: Sequence[int]) -> list[Differences]:
        """Return how the readings of a batch differ, part by part; each part ends before one of `ends`, ascending."""
        stream, values = values_of(batch)
        known, bits = self._heard.get(stream), _bits(values)
        fits = known is not None and known.last.shape == bits[:1].shape
        return _changes(known.last if known is not None and fits else bits[:1], bits, ends)

    def hear(self, data: bytes, host_ns: int, batches: Sequence[Batch], change: Differences | None = None) -> None:
        """Take bytes and the readings that a decoder of the wanted streams made of them.

        `change` says how these differ where they are one batch, of numbers alone, that was compared already.
        """
        self._last_ns = host_ns
        self._opened_ns = self._opened_ns or host_ns
        for batch in batches:
            stream, values = values_of(batch)
            if change is not None or np.isfinite(values[-1]).any():
                news = change or self.compare(batch, [len(values)])[0]
                known = self._heard.get(stream)
                if known is None or known.last.shape != news.last.shape:
                    known = self._heard[stream] = _Heard(news.last, host_ns)
                known.take(news, host_ns)
        if self._wanted and not self._missing(host_ns):
            self._since_ns, self._look = None, None
            self._instead.clear()
        else:
            self._since_ns = self._since_ns or host_ns
            self._look_again(data, host_ns)

    def _look_again(self, data: bytes, host_ns: int) -> None:
        if self._look is None and self._make is not None:
            self._look = self._make()
        if self._look is None:
            return
        for _, batch in self._look.feed(data, host_ns):
            stream, values = values_of(batch)
            width = values.shape[1]
            if stream not in self._carries or width != self._widths.get(stream, width):
                self._instead[stream, width] += len(values)

    @property
    def frozen(self) -> bool:
        """Whether a stream that always has noise, and showed it, repeats one reading."""
        return any(self._heard[stream].froze for stream in self._noisy if stream in self._heard)

    @property
    def lifeless(self) -> bool:
        """Whether a stream that always has noise is frozen, or never changed: nothing of it is a measurement."""
        return any(self._heard[stream].lifeless for stream in self._noisy if stream in self._heard)

    def judge(self, now_ns: int) -> LinkVerdict:
        """Return what is found at an instant of the host's monotonic clock."""
        now_ns = now_ns if self._ended_ns is None else min(now_ns, self._ended_ns)
        missing = self._missing(now_ns)
        first = missing[0] if missing else None
        if self._failed:
            return LinkVerdict(LinkAnswer.NO_ANSWER, first)
        if self._wanted and not missing:
            return self._of_readings()
        if self._last_ns and now_ns - self._last_ns <= SILENT_NS:
            return self._of_bytes(first, now_ns)
        waited = self._opened_ns and now_ns - self._opened_ns > SILENT_NS
        return LinkVerdict(LinkAnswer.NO_ANSWER if waited else LinkAnswer.LISTENING, first, tried=self._tried)

    @property
    def _wanted(self) -> tuple[Stream, ...]:
        return self._carries or tuple(self._heard)

    def _missing(self, now_ns: int) -> list[Stream]:
        """Return the streams of which no reading came of late."""
        heard = self._heard
        return [each for each in self._wanted if each not in heard or now_ns - heard[each].last_ns > SILENT_NS]

    def _of_readings(self) -> LinkVerdict:
        for stream in self._wanted:
            heard = self._heard[stream]
            width = heard.last.shape[1]
            if stream is Stream.JOINTS and (width < self._widths.get(stream, 0) or self._is_skin(width, wanted=stream)):
                return self._of_width(stream, stream, width)
            if stream in self._noisy and heard.lifeless:
                return LinkVerdict(LinkAnswer.FROZEN, stream)
        skin = self._heard.get(Stream.SKIN)
        unchanged = skin is not None and skin.constant and not skin.changes
        return LinkVerdict(LinkAnswer.GOOD, tried=self._tried, unchanged=unchanged)

    def _of_bytes(self, wanted: Stream | None, now_ns: int) -> LinkVerdict:
        """Return what comes in place of the readings that are wanted."""
        if self._look is not None and self._instead and wanted is not None:
            (stream, width), count = self._instead.most_common(1)[0]
            if count >= ENOUGH and count > self._look.counts.total():
                return self._of_width(wanted, stream, width)
        if self._since_ns is None or now_ns - self._since_ns < JUDGE_NS:
            return LinkVerdict(LinkAnswer.LISTENING, wanted, tried=self._tried)
        return LinkVerdict(LinkAnswer.NO_READING, wanted, tried=self._tried)

    def _of_width(self, wanted: Stream, taken_for: Stream, width: int) -> LinkVerdict:
        """Return whose lines of so many values are; lines without names are taken for a skin's of any width."""
        found = Stream.WRENCH if taken_for is Stream.WRENCH else Stream.SKIN if self._is_skin(width, wanted) else wanted
        if found is not wanted:
            return LinkVerdict(LinkAnswer.OTHER_STREAM, wanted, found, width)
        return LinkVerdict(LinkAnswer.OTHER_WIDTH, wanted, width=width, expected=self._widths.get(wanted, 0))

    def _is_skin(self, width: int, wanted: Stream) -> bool:
        """Check whether lines of this width are a skin's. An arm may have any number of joints: an iCub's arm port sends 16."""
        return width == self._widths.get(Stream.SKIN) or (wanted is not Stream.JOINTS and width > MAX_WRENCH_VALUES)
