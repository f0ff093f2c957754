"""What decoders share: bytes cut at a mark, counters and clocks that wrap, a device's header, readings put into batches."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray
from skincal.model.readings import Batch, JointsBatch, Loss, SideReading, SkinBatch, Stream, WrenchBatch

SEQ_MODULUS = 1 << 16
"""The counters of SKT/1 and SKB/1 are 16 bits wide."""
TIME_MODULUS_US = 1 << 32
"""Their clocks are 32 bits of microseconds: they wrap every 71.6 minutes."""
MICROSECONDS = 1e6
"""In a second."""
NO_SEQ = -1
SATURATED_BIT = 1
INVALID_BIT = 2
WRENCH_WIDTH = 6
UNITS = {
    Stream.WRENCH: "Fx Fy Fz in N, Mx My Mz in N m",
    Stream.SKIN: "raw values",
    Stream.JOINTS: "joint angles in degrees",
}
"""What the values of a reading are, where the device says no more."""
UNIT_MAX = 20
"""Characters of a unit that a device names."""
PERIOD_WEIGHT = 1 / 16
"""Weight of the newest interval in the mean interval of a record: settles within some 16 records."""
GAP_SLACK = 2.0
GAP_SLACK_SHARE = 0.25
"""A gap of s numbers fits a time of s intervals to within `GAP_SLACK + GAP_SLACK_SHARE * s`: devices keep no exact pace.
Numbers and time that do not fit mean that the device started anew, and then nothing is known to be missing."""
_MEND = {
    Stream.SKIN: "set [skin] channels of the scene, or the board's n, to the same number",
    Stream.WRENCH: "a wrench is fx fy fz mx my mz",
    Stream.JOINTS: "the number of joints changed",
}


class DeviceTime:
    """Unwraps a 32-bit clock of microseconds, shared by all records of one device.

    A record may be stamped a little earlier than the one before it (a skin frame is stamped when its scan begins), so
    the step from one stamp to the next is taken as the nearer way round the circle.
    """

    def __init__(self) -> None:
        self._raw: int | None = None
        self._total_us = 0

    def unwrap(self, raw_us: int) -> float:
        """Return the device's clock, seconds; NaN from a device without a clock, which sends 0 always."""
        last = self._raw
        self._raw = raw_us
        if last is None:
            self._total_us = raw_us
            return raw_us / MICROSECONDS if raw_us else math.nan
        # A running clock passes 0 once in 71 minutes and does not stand there: two in a row are no clock.
        if raw_us == 0 and last == 0:
            return math.nan
        half = TIME_MODULUS_US // 2
        self._total_us += (raw_us - last + half) % TIME_MODULUS_US - half
        return self._total_us / MICROSECONDS


class SequenceCounter:
    """Unwraps a 16-bit counter of one kind of record and counts the numbers that are missing."""

    def __init__(self) -> None:
        self._raw = NO_SEQ
        self._total = 0
        self._device_s = math.nan
        self._period = math.nan

    def step(self, raw: int, device_s: float) -> tuple[int, int]:
        """Return the unwrapped number and how many numbers are missing before it."""
        last, elapsed = self._raw, device_s - self._device_s
        self._raw, self._device_s = raw, device_s
        if last == NO_SEQ:
            self._total = raw
            return raw, 0
        step = (raw - last) % SEQ_MODULUS
        if step == 1:
            self._note_period(elapsed)
        # A counter that began anew looks like a great loss. Where the time that passed does not fit the numbers, nothing is
        # known to be missing, and the device may have another pace now.
        elif step > 1 and not self._fits(step, elapsed):
            self._period = math.nan
            step = 1
        self._total += step
        return self._total, max(step - 1, 0)

    def _note_period(self, elapsed: float) -> None:
        if elapsed > 0:
            known = elapsed if math.isnan(self._period) else self._period
            self._period = known + (elapsed - known) * PERIOD_WEIGHT

    def _fits(self, step: int, elapsed: float) -> bool:
        # Half the circle ahead is as near behind: the counter went back.
        if step >= SEQ_MODULUS // 2:
            return False
        if math.isnan(self._period) or math.isnan(elapsed):
            return True
        return abs(elapsed / self._period - step) <= GAP_SLACK + GAP_SLACK_SHARE * step


class Collector:
    """Readings of one link on their way into batches.

    Readings of a stream that the link does not carry are left out without a count: they were not asked for.
    """

    def __init__(self, channels: int | None, carries: tuple[Stream, ...], counts: Counter[Loss]) -> None:
        self.note = ""
        """What was last wrong with the device's records, a sentence; empty if nothing was."""
        self._counts = counts
        widths = {Stream.SKIN: channels, Stream.WRENCH: WRENCH_WIDTH, Stream.JOINTS: None}
        self._widths = {stream: widths[stream] for stream in Stream if stream in carries}
        # Of each stream since the last batch: number, device's clock, values, status.
        self._readings: dict[Stream, list[tuple[int, float, list[float] | NDArray[Any], int]]] = defaultdict(list)

    def width(self, stream: Stream) -> int | None:
        """Return the number of values of a reading; None while unknown, and for a stream that is not carried."""
        return self._widths.get(stream)

    def add(
        self, stream: Stream, seq: int, device_s: float, values: list[float] | NDArray[Any], status: int = 0
    ) -> Loss | None:
        """Take one reading; return what is wrong with its width.

        Parameters
        ----------
        seq : unwrapped number, or `NO_SEQ`
        device_s : device's clock, seconds, or NaN
        values : one reading, in the units of `skincal.model.readings`, but joint angles in degrees
        status : `SATURATED_BIT` and `INVALID_BIT`
        """
        if stream not in self._widths:
            return None
        if not self.fits(stream, len(values)):
            width = self._widths[stream]
            self.note = f"{stream.value} readings of {len(values)} values arrive where {width} are expected; {_MEND[stream]}"
            return Loss.BAD_WIDTH
        # The other bits of a status mean nothing here.
        self._readings[stream].append((seq, device_s, values, status & (SATURATED_BIT | INVALID_BIT)))
        return None

    def fits(self, stream: Stream, width: int) -> bool:
        """Return whether readings of a stream that the link carries have this width; where it is unknown the first say it."""
        if self._widths[stream] is None:
            self._widths[stream] = width
        return self._widths[stream] == width

    def take(self) -> list[Batch]:
        """Return the readings since the last call, one batch a stream; count those that are not numbers."""
        return [self._batch(stream, self._readings.pop(stream)) for stream in self._widths if stream in self._readings]

    def _batch(self, stream: Stream, readings: list[tuple[int, float, list[float] | NDArray[Any], int]]) -> Batch:
        numbers, clocks, rows, status = zip(*readings, strict=True)
        seq, device_s, values = np.array(numbers, np.int64), np.array(clocks, np.float64), np.array(rows, np.float64)
        return self.batch(stream, seq, device_s, values, np.array(status))

    def batch(
        self, stream: Stream, seq: IntArray, device_s: FloatArray, values: FloatArray, status: IntArray | None = None
    ) -> Batch:
        """Return n readings, their values (n, width), as a batch; count those that are not numbers. For the rest see `add`."""
        finite = np.isfinite(values)
        if not finite.all():
            self._counts[Loss.NOT_A_NUMBER] += int(np.count_nonzero(~finite.all(axis=1)))
            values = np.where(finite, values, np.nan) if stream is Stream.SKIN else values
        if stream is Stream.SKIN:
            return SkinBatch(seq, device_s, values)
        if stream is Stream.JOINTS:
            return JointsBatch(seq, device_s, np.radians(values))  # every format has degrees
        bits = np.zeros(len(seq), np.int64) if status is None else status
        saturated, invalid = (bits & SATURATED_BIT) != 0, (bits & INVALID_BIT) != 0
        for loss, flags in ((Loss.SATURATED, saturated), (Loss.INVALID, invalid)):
            if flags.any():
                self._counts[loss] += int(np.count_nonzero(flags))
        return WrenchBatch(seq, device_s, values, saturated, invalid)


class Pieces(Protocol):
    """Cuts bytes into pieces; how the bytes came makes no difference."""

    @property
    def holds(self) -> bool:
        """Whether bytes of a piece that is not whole are kept, or left out."""
        ...

    def split(self, data: bytes) -> list[bytes | None]:
        """Return the pieces that `data` completes; None stands for bytes that are no piece."""
        ...


class Splitter:
    """Cuts bytes at `mark`; what has no mark yet is kept, never more than `limit` bytes."""

    def __init__(self, mark: bytes, limit: int) -> None:
        self._mark = mark
        self._limit = limit
        self._rest = b""
        self._skipping = False

    @property
    def holds(self) -> bool:
        """Whether bytes without a mark are kept, or left out up to the next mark."""
        return bool(self._rest) or self._skipping

    def split(self, data: bytes) -> list[bytes | None]:
        """Return the pieces that `data` completes, without the mark; None stands for one that was too long."""
        cut = (self._rest + data).split(self._mark)
        self._rest = cut.pop()
        # The rest of a piece that was counted as too long when it was dropped.
        if cut and self._skipping:
            del cut[0]
            self._skipping = False
        pieces: list[bytes | None] = [piece if len(piece) <= self._limit else None for piece in cut]
        if len(self._rest) > self._limit:
            self._rest = b""
            # Counted once, however many chunks the piece goes on for.
            if not self._skipping:
                pieces.append(None)
            self._skipping = True
        return pieces


class PieceDecoder(ABC):
    """A decoder of pieces, which end with a mark unless it cuts them otherwise.

    The first piece after opening may have lost its beginning: it counts as nothing, unless it is good.
    """

    name: ClassVar[str]
    mark: ClassVar[bytes]
    limit: ClassVar[int]
    """Bytes. A piece beyond it is dropped whole."""
    no_piece: ClassVar[Loss] = Loss.UNREADABLE
    """As what bytes are counted that are no piece."""

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        self.counts: Counter[Loss] = Counter()
        self.good: int = 0
        """Records that are surely of this format."""
        self._collector = Collector(channels, carries, self.counts)
        self._splitter = self._make_splitter()
        self._first = True
        self.units = dict(UNITS)
        """What the values of a reading are: names and unit."""
        self.beside: dict[str, SideReading] = {}
        """What else the device measured, by name and unit, such as its temperature."""

    def _make_splitter(self) -> Pieces:
        return Splitter(self.mark, self.limit)

    @property
    def note(self) -> str:
        """What the device got wrong or said last, a sentence; empty if nothing."""
        return self._collector.note

    def feed(self, data: bytes) -> list[Batch]:
        """Take the next bytes of the link and return the readings that they complete."""
        for piece in self._splitter.split(data):
            problem = self.no_piece if piece is None else self._decode(piece)
            if problem is not None and not self._first:
                self.counts[problem] += 1
            self._first = False
        return self._collector.take()

    def feed_many(self, pieces: Sequence[bytes]) -> tuple[Batch, list[int]] | None:  # noqa: ARG002 - a decoder of text may
        """Return the readings of the next pieces as one batch, and where those of each end; None, nothing taken, if not."""
        return None

    def _measure(self, name: str, value: float) -> None:
        """Keep what was measured beside a reading."""
        new = SideReading(value, value, value)
        self.beside[name] = self.beside[name].then(new) if name in self.beside else new

    def _name_unit(self, header: dict[str, str]) -> None:
        """Keep what a board's header says of the values of its skin."""
        unit = header.get("unit", "raw")[:UNIT_MAX]
        if header.get("kind") == "taxel" and unit != "raw":
            self.units[Stream.SKIN] = f"values in {unit}"

    @abstractmethod
    def _decode(self, piece: bytes) -> Loss | None:
        """Hand the readings of a piece to the collector; return why it cannot be used."""


def parse_header(text: str) -> dict[str, str]:
    """Read `key=value,key=value`; a field without `=` is left out."""
    pairs = (field.partition("=") for field in text.split(","))
    return {key.strip(): value.strip() for key, equals, value in pairs if equals}


def header_problem(header: dict[str, str], channels: int | None) -> str:
    """Return the sentence for a device whose width is not that of the scene; empty if they agree or one is unknown."""
    n = header.get("n", "")
    if channels is None or not n.isdigit() or int(n) == channels or header.get("kind") == "ft":
        return ""
    board = header.get("board", "")
    return (
        f"The board{' ' + board if board else ''} says that it sends n={n} taxels where {channels} are expected; "
        "set [skin] channels of the scene, or the board's n, to the same number"
    )
