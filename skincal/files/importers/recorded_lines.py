"""Recorded lines with their stamps, put on a common clock and merged, so that a recording plays as a live rig would.

Stamps of a recording jump: a clock is set back, messages come out of order, a program hangs. Each file is read twice: first
`RecordedTimes` finds its jumps and says what it found, then `merged` gives the lines, in the order of the files and of a common
clock that never runs backwards. Neither holds more than a few lines of each file: a block at a time.

- A stamp a little before the one before it (`OUT_OF_ORDER`) is a message that came late: it is placed at the time of the
  one before it, and its own stamp, which stands in its line, says when it was taken.
- A stamp far before it is a clock set back: from there on the file is shifted so that it goes on one interval later.
  Two files whose clocks were set back by the same amount share one shift, so that they stay paired.
- A clock that was set, and within `AWAY_S` by as much the other way, was wrong in between: only these lines are shifted.
- A stamp far off that is right again within `ASTRAY_LINES` was written wrong (a flipped bit): its lines are placed at the time
  of the one before, and nothing is shifted.
- A gap stays a gap.

Neighbouring lines of a file travel in one chunk, since a chunk costs more than a line. Their stamps stand in the lines, so a
chunk's time is only that of its last line.
"""

from __future__ import annotations

import heapq
import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from statistics import median
from typing import NamedTuple, TypeAlias

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError, plural
from skincal.model.readings import Chunk, Stream
from skincal.streams.links import LinkSpec

OUT_OF_ORDER = 0.5
"""s. A message on a network is not later than this; a clock that is set back usually goes farther."""
GAP_INTERVALS = 5.0
"""A pause of more than this many intervals is a gap..."""
GAP_MIN = 0.1
"""s. ...if it is also longer than this: a poke's still window is 0.3 s."""
SHARED_JUMP = 0.2
"""s. Two clocks set back by amounts this near were the same clock: the amount is known to within an interval of each file."""
ASTRAY_LINES = 3
"""Lines. A clock that was set stays set; a wrong stamp is right again within this many lines."""
AWAY_S = 60.0
"""s. A clock that is right again after no more than this was wrong meanwhile: time servers look every minute or so."""
SPAN_MAX = 1e8
"""s. Three years: a recording that is longer has a clock that leapt."""
TOGETHER_NS = 100_000_000
"""ns. Lines of so long travel in one chunk: two fifths of the time that a skin frame waits for its wrench."""
TOGETHER_LINES = 128
"""Maximum lines of one chunk, to bound memory."""
FIRST_INTERVALS = 500
"""Intervals from which the usual interval is taken: 5 s at 100 Hz."""
MAX_CLOCK_SENTENCES = 3
"""Clock jumps that get a sentence of their own."""
START_NS = 1_000_000_000
"""ns. Where a recording begins on the host's clock; 0 means never there."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedLines:
    """A block of n > 0 lines that follow one another in a recording."""

    stamps: FloatArray
    """(n,) float, seconds, of any clock."""
    data: Sequence[bytes]
    """n lines, each as the decoder takes it, with its line end."""


Lines: TypeAlias = Callable[[], Iterator[RecordedLines]]
"""Opens a file and gives its lines; it is called twice."""


@dataclass(frozen=True, slots=True)
class _Leap:
    """A stamp far from the one before it, until it is clear whether the clock was set or the stamp written wrong."""

    line: int
    highest: float
    shift: float
    # s. What passed if the clock is right; 0 where it went back.
    pause: float
    # s. How far the clock was set back; None where it went on.
    back: float | None
    # s. How far the clock is ahead of itself before, if it was set.
    off: float


class RecordedTimes:
    """What a first reading of a file's stamps, blocks of seconds, finds; `name` is that of the file's link."""

    def __init__(self, name: str, blocks: Iterable[FloatArray]) -> None:
        self.name = name
        self.lines = 0
        self.first = self.last = 0.0
        """s. First stamp and highest, shifted."""
        self.gaps, self.longest_gap = 0, 0.0
        self.out_of_order = 0
        self.earlier = 0
        """Lines whose stamp is before that of the line before."""
        self.jumps: dict[int, float] = {}
        """The first line after each time that the clock was set, and how far the stamps from there on are shifted, s."""
        self.astray: set[int] = set()
        """Indices of lines whose stamps were written wrong."""
        self._shift = 0.0
        # Highest stamp since the clock was set back last.
        self._highest = 0.0
        self._leap: _Leap | None = None
        # The last leap that is believed, as long as the clock may still be set again the other way.
        self._away: _Leap | None = None
        # Of times when the clock was wrong for a while: by how much, s; for how long, s; and the lines where it was set.
        self._errors: list[tuple[float, float]] = []
        self._error_lines: set[int] = set()
        self._intervals: list[float] = []
        # Long ones, kept back until the usual interval is known.
        self._pauses: list[float] = []
        self._gap_limit = GAP_MIN
        before = -math.inf
        for stamps in blocks:
            self.earlier += int(np.count_nonzero(_steps(before, stamps) < 0))
            before = float(stamps[-1])
            if not self._add_steady(stamps):
                for stamp in stamps.tolist():
                    self._add(stamp)
        self._end()

    @property
    def interval(self) -> float:
        """Usual time from line to line, s; 0 where there is none."""
        return median(self._intervals) if self._intervals else 0.0

    def sentences(self) -> list[str]:
        """List the findings."""
        rate = f", {1 / self.interval:.4g} a second" if self.interval else ""
        found = [f"{self.name}: {plural(self.lines, 'line')} in {self.last - self.first:.1f} s{rate}."]
        if self.gaps:
            found.append(f"{self.name}: {plural(self.gaps, 'gap')} in time, the longest {self.longest_gap:.2f} s.")
        if self.out_of_order:
            found.append(
                f"{self.name}: {plural(self.out_of_order, 'stamp')} before the one before it; kept in the file's order."
            )
        if self.astray:
            found.append(
                f"{self.name}: {plural(len(self.astray), 'stamp')} far from those around; placed with the line before."
            )
        found += [
            f"{self.name}: the clock was wrong by {off:+.3f} s for {seconds:.1f} s; the lines meanwhile are placed without it."
            for off, seconds in self._errors[:MAX_CLOCK_SENTENCES]
        ]
        if more := self._errors[MAX_CLOCK_SENTENCES:]:
            seconds = sum(seconds for _, seconds in more)
            found.append(
                f"{self.name}: the clock was wrong {plural(len(more), 'more time')}, for {seconds:.1f} s in all; "
                "the lines meanwhile are placed without it."
            )
        backs = [back for line, back in self.jumps.items() if line not in self._error_lines]
        if backs:
            amounts = ", ".join(
                [*(f"{back:.3f} s" for back in backs[:MAX_CLOCK_SENTENCES]), *["..."][: len(backs) > MAX_CLOCK_SENTENCES]]
            )
            found.append(
                f"{self.name}: the clock was set back {plural(len(backs), 'time')} ({amounts}); "
                "the lines after it follow on without a break, but a poke that it cuts may be wrong."
            )
        return found

    def _add_steady(self, stamps: FloatArray) -> bool:
        """Take stamps that go on as they should, once the usual interval is known; else return False, and take none."""
        if self._leap is not None or len(self._intervals) < FIRST_INTERVALS:
            return False
        pauses = _steps(self._highest, stamps)
        if pauses.min() < 0 or pauses.max() > OUT_OF_ORDER:
            return False
        self._count_gaps(pauses[pauses > self._gap_limit].tolist())
        self._highest = float(stamps[-1])
        self.last = self._highest + self._shift
        self.lines += len(stamps)
        return True

    def _add(self, stamp: float) -> None:
        if self.lines == 0:
            self.first = self._highest = stamp
        elif abs(stamp - self._highest) > OUT_OF_ORDER:
            self._far(stamp)
        elif stamp < self._highest:
            self.out_of_order += 1
        else:
            self._pause(stamp - self._highest)
            self._highest = stamp
        self.last = self._highest + self._shift
        self.lines += 1
        if self._leap is not None and self.lines - self._leap.line > ASTRAY_LINES:
            self._settle()

    def _far(self, stamp: float) -> None:
        """Note a stamp far from the one before it: back where the clock was before a leap, or a new leap."""
        leap = self._leap
        if leap is not None and abs(stamp - leap.highest) <= OUT_OF_ORDER:
            self.astray.update(range(leap.line, self.lines))
            self._highest, self._shift, self._leap = max(leap.highest, stamp), leap.shift, None
            return
        self._settle()
        pause = max(stamp - self._highest, 0.0)
        back = None if pause else self.last + self.interval - (stamp + self._shift)
        off = stamp - self._highest - self.interval
        self._leap = _Leap(self.lines, self._highest, self._shift, pause, back, off)
        self._highest = stamp
        self._shift += back or 0.0

    def _settle(self) -> None:
        """Believe the leap, if there is one."""
        leap, self._leap = self._leap, None
        if leap is None or self._came_back(leap):
            return
        self._stay_away()
        self._away = leap
        if leap.back is not None:
            self.jumps[leap.line] = leap.back

    def _came_back(self, leap: _Leap) -> bool:
        """Tell whether a jump undoes the one before it; then only the lines in between are shifted."""
        away = self._away
        # Rows that come slowly leap by their interval alone.
        if away is None or abs(away.off) <= SHARED_JUMP or abs(away.off + leap.off) > SHARED_JUMP:
            return False
        seconds = leap.highest - away.highest - away.off
        if seconds > AWAY_S:
            return False
        self.jumps |= {away.line: -away.off, leap.line: away.off}
        self._error_lines |= {away.line, leap.line}
        self._errors.append((away.off, seconds))
        self._away, self._shift = None, away.shift
        self.last = self._highest + self._shift
        return True

    def _stay_away(self) -> None:
        """Take the last leap for what it looks like: the clock goes on from there."""
        away, self._away = self._away, None
        if away is not None and away.back is None:
            self._pause(away.pause)

    def _pause(self, pause: float) -> None:
        # Until the usual interval is known, long pauses are kept and judged at the end.
        if len(self._intervals) < FIRST_INTERVALS:
            self._intervals.append(pause)
            if len(self._intervals) == FIRST_INTERVALS:
                self._gap_limit = max(GAP_MIN, GAP_INTERVALS * self.interval)
            if pause > GAP_MIN:
                self._pauses.append(pause)
        else:
            self._count_gaps([pause])

    def _count_gaps(self, pauses: Sequence[float]) -> None:
        gaps = [pause for pause in pauses if pause > self._gap_limit]
        self.gaps += len(gaps)
        self.longest_gap = max([self.longest_gap, *gaps])

    def _end(self) -> None:
        leap = self._leap
        if leap is not None and leap.pause > SPAN_MAX:
            # The last lines of the file: no line after them decides it, but no recording pauses for years.
            self.astray.update(range(leap.line, self.lines))
            self.last, self._leap = leap.highest + leap.shift, None
        self._settle()
        self._stay_away()
        self._gap_limit = max(GAP_MIN, GAP_INTERVALS * self.interval)
        self._count_gaps(self._pauses)


def _steps(before: float, stamps: FloatArray) -> FloatArray:
    """Return (n,) how far each stamp lies behind that before it."""
    steps = stamps.copy()
    steps[0] -= before
    steps[1:] -= stamps[:-1]
    return steps


def share_clock_jumps(timelines: Sequence[RecordedTimes]) -> None:
    """Give jumps of the same amount in several files the same shift, that of the first file."""
    known: list[float] = []
    for timeline in timelines:
        # The amount that the first file saw holds for all that saw nearly the same.
        timeline.jumps = {line: _nearest(back, known) for line, back in timeline.jumps.items()}
        known += [back for back in timeline.jumps.values() if back not in known]


def _nearest(back: float, known: Sequence[float]) -> float:
    best = min(known, key=lambda other: abs(other - back), default=back)
    return best if abs(best - back) <= SHARED_JUMP else back


def check_overlap(timelines: Sequence[RecordedTimes]) -> None:
    """Check that every file goes on in time and shares time with the first.

    Raises InputError: a file runs backwards or spans years, or two have no time in common, so that nothing can be paired.
    """
    for timeline in timelines:
        if timeline.earlier * 2 > timeline.lines:
            raise InputError(
                f"{timeline.name}: its times run backwards: {timeline.earlier} of {timeline.lines} lines are earlier than the "
                "line before; expected the oldest first: sort the lines by their time, or check which column is the time."
            )
        if timeline.last - timeline.first > SPAN_MAX:
            raise InputError(
                f"{timeline.name}: its stamps run from {timeline.first:.3f} to {timeline.last:.3f} s, over years; expected one "
                "recording, its times in seconds: cut the file where its clock leaps."
            )
    first = timelines[0]
    for other in timelines[1:]:
        if other.first > first.last or other.last < first.first:
            raise InputError(
                f"{first.name} was recorded from {first.first:.3f} to {first.last:.3f} s and {other.name} from "
                f"{other.first:.3f} to {other.last:.3f} s; expected recordings of the same time: choose logs of one run, with "
                "clocks that agree."
            )


def merged(timelines: Sequence[RecordedTimes], sources: Sequence[Lines], alone: Collection[str] = ()) -> Iterator[Chunk]:
    """Yield the lines of all files, of one time each, in the order of their time, neighbours of one file in one chunk; lazily.

    Of the files named in `alone` a chunk holds no more than the lines before the next chunk of another file, so that each comes
    before all later lines of the others.
    """
    share_clock_jumps(timelines)
    origin = min(timeline.first for timeline in timelines)
    placed = [
        _pieces(file, _placed(timeline, lines(), origin), together=timeline.name not in alone)
        for file, (timeline, lines) in enumerate(zip(timelines, sources, strict=True))
    ]
    # In the order of their times, and of the files where these are the same.
    return _joined(heapq.merge(*placed), [timeline.name for timeline in timelines])


class _Piece(NamedTuple):
    """What becomes a chunk, or a part of one."""

    host_ns: int
    file: int
    data: bytes
    # Whether it may be joined with its neighbours of the same file.
    joins: bool


def _joined(pieces: Iterable[_Piece], names: Sequence[str]) -> Iterator[Chunk]:
    """Yield pieces as chunks of the named files; neighbours that may be joined are one, at the time of the last."""
    held: list[bytes] = []
    first_ns = last_ns = 0
    last_file = -1
    for host_ns, file, data, joins in pieces:
        fits = joins and file == last_file and host_ns - first_ns <= TOGETHER_NS and len(held) < TOGETHER_LINES
        if held and not fits:
            yield Chunk(names[last_file], last_ns, b"".join(held))
            held = []
        if joins:
            first_ns = first_ns if held else host_ns
            held.append(data)
            last_ns, last_file = host_ns, file
        else:
            yield Chunk(names[file], host_ns, data)
    if held:
        yield Chunk(names[last_file], last_ns, b"".join(held))


@dataclass(frozen=True, slots=True, eq=False)
class OpenRecording:
    """A recording of several files that was read through once."""

    links: tuple[LinkSpec, ...]
    """Of each file one, in the order of `timelines` and `sources`."""
    timelines: tuple[RecordedTimes, ...]
    sources: tuple[Lines, ...]
    findings: tuple[str, ...]
    """Findings, in sentences."""

    @property
    def span_ns(self) -> int:
        """Nanoseconds from the first line of any file to the last."""
        first, last = min(each.first for each in self.timelines), max(each.last for each in self.timelines)
        return round((last - first) * 1e9)

    def chunks(self) -> Iterator[Chunk]:
        """Give the lines of all files as chunks merged by time; lazily."""
        # A frame gets the last angles before it, so these must not come later; a wrench may, since frames wait for it.
        return merged(self.timelines, self.sources, (Stream.JOINTS.value,))


@dataclass(frozen=True, slots=True)
class _Placed:
    """n lines and their times."""

    host_ns: list[int]
    data: Sequence[bytes]
    # Whether a line's stamp follows on the one before; else the decoder's clock starts anew with it.
    steady: list[bool]


def _placed(timeline: RecordedTimes, blocks: Iterator[RecordedLines], origin: float) -> Iterator[_Placed]:
    shift, latest, before, index = 0.0, START_NS, -math.inf, 0
    jumps, astray = sorted(timeline.jumps), sorted(timeline.astray)
    for block in blocks:
        stamps, end = block.stamps, index + len(block.stamps)
        shifts = np.full(len(stamps), shift)
        for line in jumps[bisect_left(jumps, index) : bisect_left(jumps, end)]:
            shift += timeline.jumps[line]
            shifts[line - index :] = shift
        # Stamps have microseconds; more digits would be those of the double.
        times = START_NS + np.rint((stamps + shifts - origin) * 1e6).astype(np.int64) * 1000
        times[[line - index for line in astray[bisect_left(astray, index) : bisect_left(astray, end)]]] = START_NS
        times = np.maximum.accumulate(np.maximum(times, latest))
        steady = np.abs(_steps(before, stamps)) <= OUT_OF_ORDER
        yield _Placed(times.tolist(), block.data, steady.tolist())
        latest, before, index = int(times[-1]), float(stamps[-1]), end


def _pieces(file: int, blocks: Iterator[_Placed], *, together: bool) -> Iterator[_Piece]:
    """Yield neighbouring lines as one piece at the time of the last; a line that starts a clock anew is a piece alone.

    Where lines do not go `together` each is a piece, which may be joined with others.

    The clock of a decoder takes a chunk's time for the arrival of each of its lines, and the least delay for the true one: the
    last line's is right, the others only look late. A clock's first line has no other to be measured by.
    """
    held: list[bytes] = []
    first_ns = last_ns = 0
    for block in blocks:
        times, steady, at = block.host_ns, block.steady, 0
        while at < len(times):
            if held and (not steady[at] or times[at] - first_ns > TOGETHER_NS or len(held) >= TOGETHER_LINES):
                yield _Piece(last_ns, file, b"".join(held), joins=False)
                held = []
            if not (steady[at] and together):
                yield _Piece(times[at], file, block.data[at], steady[at] and not together)
                at += 1
                continue
            first_ns = first_ns if held else times[at]
            end = bisect_right(times, first_ns + TOGETHER_NS, at, min(at + TOGETHER_LINES - len(held), len(times)))
            if False in steady[at:end]:
                end = steady.index(False, at)
            held += block.data[at:end]
            last_ns, at = times[end - 1], end
    if held:
        yield _Piece(last_ns, file, b"".join(held), joins=False)
