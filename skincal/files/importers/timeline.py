"""Timelines of recorded files, corrected for clock jumps, and their lines merged into the chunks of a session.

A recording must play as a live rig would, but stamps jump: a clock is set back, messages overtake each other, a program hangs.
`Timeline` finds the jumps of one file, `OpenRecording.chunks` merges all files on a common clock that never runs backwards.

- A stamp a little before the one before it (`MAX_TIME_STEP_BACK_S`) is a late message. It gets the time of the line before.
- A stamp far before it is a clock set back. The rest of the file is shifted, so that it goes on one interval later. Two files
  whose clocks were set back by the same amount share one shift, so that they stay paired.
- If a clock jumps and jumps back by the same amount within `BRIEF_CLOCK_JUMP_MAX_S`, the lines in between are shifted.
- If a stamp is wrong for at most `MAX_LINES_WITH_WRONG_STAMP` lines (a flipped bit), they get the time of the line before.
- A gap stays a gap.

Neighbouring lines of a file share a chunk, since a chunk costs more than a line. A chunk has the time of its last line.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice, pairwise
from typing import TypeAlias

import numpy as np

from skincal.devices.pose_names import NO_POSE_NAMES, PoseNames
from skincal.files.importers.tape import BLOCK_NUMBERS, NumberFile
from skincal.geometry import FloatArray, IntArray
from skincal.model.errors import InputError, plural
from skincal.model.readings import SESSION_START_TIME_NS, Chunk, Stream
from skincal.model.skin_axes import ValueOrder
from skincal.streams.links import LinkSpec

MAX_TIME_STEP_BACK_S = 0.5
"""A message on a network is not later than this; a clock that is set back usually goes farther."""
GAP_MIN_INTERVALS = 5.0
"""A pause of more than this many intervals is a gap..."""
GAP_MIN_TIME_S = 0.1
"""...if it is also longer than this: a poke is held still for 0.3 s."""
SAME_CLOCK_JUMP_MAX_DIFFERENCE_S = 0.2
"""Jumps of two clocks are the same if they differ by less: each is known to an interval of its file."""
MAX_LINES_WITH_WRONG_STAMP = 3
"""A clock that was set stays set; a wrong stamp is right again after at most this many lines."""
BRIEF_CLOCK_JUMP_MAX_S = 60.0
"""A clock that is right again after no more than this was wrong meanwhile: time servers correct it every minute or so."""
RECORDING_MAX_S = 1e8
"""Three years: in a longer recording the clock jumped."""
CHUNK_MAX_TIME_NS = 100_000_000
"""A chunk spans at most this time: two fifths of the time that a skin frame waits for its wrench."""
CHUNK_MAX_LINES = 128
"""Bounds the memory of a chunk."""
STEPS_IN_MEDIAN_INTERVAL = 500
"""Number of steps in the median for the usual interval: 5 s at 100 Hz."""
MAX_ROW_INTERVAL_S = 0.2
"""A tool holds still for 0.3 s in a poke: rows further apart, if their time has no unit, are not seconds."""
MIN_ROW_INTERVAL_S = 1e-5
"""No sensor of a rig is read faster than 100,000 times a second."""
COARSE_STEP_MIN_S = 0.05
"""If most lines repeat the time of the line before and the others go on by more than this, the times have too few digits: a
poke is held still for 0.3 s."""
REPORT_REPEATED_FROM_SHARE = 0.05
"""Share of lines with a repeated time that is reported."""
CHUNKS_CONVERTED_AT_ONCE = 1 << 12
"""Chunks that are made Python numbers at once: these take ten times the memory."""
MAX_LISTED_JUMPS = 3
REPORT_LATE_START_OR_EARLY_END_FROM_S = 2.0
"""A stream that starts or ends by more than this after or before the others is reported."""
FINER_TIMES = "Export times with fractions of a second."
"""Advice for times with too few digits."""

Lines: TypeAlias = Callable[[], Iterable[Sequence[bytes]]]
"""Opens a file and gives its lines in blocks, each line as the decoder takes it, with its line end."""


@dataclass(frozen=True, slots=True)
class _Jump:
    """A stamp far from those before it. Later lines decide whether the clock was set or the stamp is an outlier."""

    line: int
    highest: float
    """Highest stamp before it, s."""
    shift: float
    """Shift of the lines before it, s."""
    step: float
    """From `highest` to the stamp, s."""
    error: float
    """How far the clock is ahead after it, if it was set: `step` less the usual interval, s."""


class Timeline:
    """Stamps of one file and the clock jumps in them.

    Parameters
    ----------
    name : of the file's link
    stamps : blocks of the lines' stamps, (n,) float, seconds of any clock
    """

    def __init__(self, name: str, stamps: Iterable[FloatArray]) -> None:
        self.name = name
        self.stamps = NumberFile()
        self.earlier = 0
        """Lines with a stamp before that of the line before."""
        self.repeated = 0
        """Lines with the time of the line before, where the times have too few digits."""
        forward, last = np.empty(0), np.empty(0)
        for block in stamps:
            steps = np.diff(np.append(last, block))
            self.earlier += int(np.count_nonzero(steps < 0))
            self.repeated += count_repeated(steps)
            forward = np.append(forward, steps[steps >= 0][: STEPS_IN_MEDIAN_INTERVAL - len(forward)])
            last = np.append(last, block)[-1:]
            self.stamps.extend(block)
        self.lines = len(self.stamps)
        self.interval = float(np.median(forward)) if len(forward) else 0.0
        """Usual time from line to line, s; 0 if there is none."""
        self.out_of_order = 0
        self.jumps: dict[int, float] = {}
        """First line after each clock jump, and the shift in seconds that its stamp and all later ones need."""
        self.outliers: set[int] = set()
        """Lines with a wrong stamp."""
        self._shift = 0.0
        self._highest = 0.0
        self._undecided: _Jump | None = None
        # The last accepted jump, while the clock may still jump back.
        self._accepted: _Jump | None = None
        # (error, duration) in seconds of each brief jump, and the lines where they begin and end.
        self._brief: list[tuple[float, float]] = []
        self._brief_lines: set[int] = set()
        self._pauses: list[float] = []
        if self.lines:
            self._find_jumps()
        limit = max(GAP_MIN_TIME_S, GAP_MIN_INTERVALS * self.interval)
        gaps = [pause for pause in self._pauses if pause > limit]
        self.gaps, self.longest_gap = len(gaps), max(gaps, default=0.0)
        self.first = float(self.stamps.read(0, 1)[0]) if self.lines else 0.0
        """First stamp, s."""
        self.last = self._highest + self._shift
        """Highest stamp, shifted, s."""

    @property
    def is_coarse(self) -> bool:
        """Whether most lines have the time of the line before, since the times have too few digits."""
        return self.lines > 1 and 2 * self.repeated > self.lines

    def _find_jumps(self) -> None:
        self._highest = float(self.stamps.read(0, 1)[0])
        at, size = 1, 1
        while at < self.lines:
            limit = self.lines if self._undecided is None else self._undecided.line + MAX_LINES_WITH_WRONG_STAMP + 1
            block = self.stamps.read(at, min(at + size, limit))
            highest = np.maximum.accumulate(np.concatenate([[self._highest], block]))
            steps = block - highest[:-1]
            far = np.flatnonzero(np.abs(steps) > MAX_TIME_STEP_BACK_S)
            steady = int(far[0]) if len(far) else len(block)
            self.out_of_order += int(np.count_nonzero(steps[:steady] < 0))
            self._pauses += steps[:steady][steps[:steady] > GAP_MIN_TIME_S].tolist()
            self._highest = float(highest[steady])
            at += steady
            # After a jump the next one may be near; a steady clock is read in ever larger blocks.
            size = min(2 * size, BLOCK_NUMBERS)
            if len(far):
                self._begin_jump(at, float(block[steady]))
                at, size = at + 1, 16
            if self._undecided is not None and at > self._undecided.line + MAX_LINES_WITH_WRONG_STAMP:
                self._decide()
        jump = self._undecided
        if jump is not None and jump.step > RECORDING_MAX_S:
            # No later line decides about the last ones, but no recording pauses for years.
            self._drop_outliers(jump, self.lines, jump.highest)
        self._decide()
        self._end_accepted()

    def _begin_jump(self, line: int, stamp: float) -> None:
        jump = self._undecided
        if jump is not None and abs(stamp - jump.highest) <= MAX_TIME_STEP_BACK_S:
            self._drop_outliers(jump, line, stamp)
            return
        self._decide()
        step = stamp - self._highest
        self._undecided = _Jump(line, self._highest, self._shift, step, step - self.interval)
        self._highest = stamp
        if step < 0:
            self._shift += self.interval - step

    def _drop_outliers(self, jump: _Jump, end: int, stamp: float) -> None:
        """Mark the lines from a jump to `end` as outliers; the clock goes on at `stamp`."""
        self.outliers.update(range(jump.line, end))
        self._highest, self._shift, self._undecided = max(jump.highest, stamp), jump.shift, None

    def _decide(self) -> None:
        """Accept the undecided jump as a clock that was set, if there is one."""
        jump, self._undecided = self._undecided, None
        if jump is None or self._undoes_accepted(jump):
            return
        self._end_accepted()
        self._accepted = jump
        if jump.step < 0:
            self.jumps[jump.line] = -jump.error

    def _undoes_accepted(self, jump: _Jump) -> bool:
        """Shift only the lines in between if a jump undoes the one before it; return whether it does."""
        before = self._accepted
        # Slow streams have a step over the limit in every line: an error of zero.
        if (
            before is None
            or abs(before.error) <= SAME_CLOCK_JUMP_MAX_DIFFERENCE_S
            or abs(before.error + jump.error) > SAME_CLOCK_JUMP_MAX_DIFFERENCE_S
        ):
            return False
        seconds = jump.highest - before.highest - before.error
        if seconds > BRIEF_CLOCK_JUMP_MAX_S:
            return False
        self.jumps |= {before.line: -before.error, jump.line: before.error}
        self._brief_lines |= {before.line, jump.line}
        self._brief.append((before.error, seconds))
        self._accepted, self._shift = None, before.shift
        return True

    def _end_accepted(self) -> None:
        if self._accepted is not None and self._accepted.step > 0:
            self._pauses.append(self._accepted.step)
        self._accepted = None

    def sentences(self) -> list[str]:
        """List the findings: the size of the file first, then gaps, wrong stamps and clock jumps."""
        rate = f", {1 / self.interval:.4g} a second" if self.interval else ""
        found = [f"{plural(self.lines, 'line')} in {self.last - self.first:.1f} s{rate}."]
        if self.gaps:
            found.append(f"{plural(self.gaps, 'gap')} in time, the longest {self.longest_gap:.2f} s.")
        if self.repeated > REPORT_REPEATED_FROM_SHARE * self.lines:
            found.append(
                f"{plural(self.repeated, 'line')} with the time of the line before, since the times have too few digits; "
                f"a poke there may be wrong. {FINER_TIMES}"
            )
        if self.out_of_order:
            found.append(f"{plural(self.out_of_order, 'stamp')} before the one before it; kept in the file's order.")
        if self.outliers:
            found.append(f"{plural(len(self.outliers), 'stamp')} far from those around; placed with the line before.")
        placed = "the lines meanwhile are placed without it."
        for error, seconds in self._brief[:MAX_LISTED_JUMPS]:
            found.append(f"the clock was wrong by {error:+.3f} s for {seconds:.1f} s; {placed}")
        if more := self._brief[MAX_LISTED_JUMPS:]:
            seconds = sum(seconds for _, seconds in more)
            found.append(f"the clock was wrong {plural(len(more), 'more time')}, for {seconds:.1f} s in all; {placed}")
        backs = [f"{back:.3f} s" for line, back in self.jumps.items() if line not in self._brief_lines]
        if backs:
            amounts = ", ".join([*backs[:MAX_LISTED_JUMPS], *["..."][: len(backs) > MAX_LISTED_JUMPS]])
            found.append(
                f"the clock was set back {plural(len(backs), 'time')} ({amounts}); "
                "the lines after it follow on without a break, but a poke that it cuts may be wrong."
            )
        return [f"{self.name}: {sentence}" for sentence in found]

    def place_lines(self, origin: float) -> Iterator[tuple[FloatArray, IntArray]]:
        """Place the lines on the host's clock, never backwards; `origin` (s) becomes `SESSION_START_TIME_NS`.

        Yields blocks of (n,) stamps, s, and times of the host's clock, ns.
        """
        shift, last_ns, begin = 0.0, SESSION_START_TIME_NS, 0
        outliers = np.sort(np.fromiter(self.outliers, np.int64))
        for stamps in self.stamps.blocks():
            end = begin + len(stamps)
            shifts = np.zeros(len(stamps))
            shifts[0] = shift
            for line, more in self.jumps.items():
                if begin <= line < end:
                    shifts[line - begin] += more
            shifts = np.cumsum(shifts)
            shift = float(shifts[-1])
            # Stamps have microseconds; more digits would be those of the double.
            times = SESSION_START_TIME_NS + np.rint((stamps + shifts - origin) * 1e6).astype(np.int64) * 1000
            times[outliers[np.searchsorted(outliers, begin) : np.searchsorted(outliers, end)] - begin] = SESSION_START_TIME_NS
            times[0] = max(times[0], last_ns)
            np.maximum.accumulate(times, out=times)
            last_ns, begin = int(times[-1]), end
            yield stamps, times


def count_repeated(steps: FloatArray) -> int:
    """Count the zeros among (n,) steps of the times, s, if most are zero and the others are long."""
    repeated, positive = int(np.count_nonzero(steps == 0)), steps[steps > 0]
    return repeated if 2 * repeated > len(steps) and not (len(positive) and np.median(positive) <= COARSE_STEP_MIN_S) else 0


def share_clock_jumps(timelines: Sequence[Timeline]) -> None:
    """Give jumps of nearly the same amount in several files the same shift, that of the first file."""
    known: list[float] = []
    for timeline in timelines:
        for line, shift in timeline.jumps.items():
            best = min(known, key=lambda other: abs(other - shift), default=shift)
            timeline.jumps[line] = best if abs(best - shift) <= SAME_CLOCK_JUMP_MAX_DIFFERENCE_S else shift
        known += [shift for shift in timeline.jumps.values() if shift not in known]


def check_overlap(timelines: Sequence[Timeline]) -> None:
    """Check that every file goes on in time and shares time with the first.

    Raises InputError: the times of a file have too few digits, run backwards or span years, or two files have no time in
    common, so that nothing can be paired.
    """
    for timeline in timelines:
        if timeline.is_coarse:
            raise InputError(
                f"{timeline.name}: most of its lines have the same time as the line before, such as "
                f"{timeline.first:.3f} s. {FINER_TIMES}"
            )
        if timeline.earlier * 2 > timeline.lines:
            raise InputError(
                f"{timeline.name}: its times run backwards: {timeline.earlier} of {timeline.lines} lines are earlier than the "
                "line before; expected the oldest first: sort the lines by their time, or check which column is the time."
            )
        if timeline.last - timeline.first > RECORDING_MAX_S:
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


def check_assumed_seconds(path: object, stream: Stream, interval: float, advice: str) -> None:
    """Check times that were read as seconds, since nothing names their unit.

    Parameters
    ----------
    interval : usual time from row to row, s
    advice : how to state the unit

    Raises InputError: the rows are so near or so far apart that they hardly are seconds.
    """
    if 0 < interval < MIN_ROW_INTERVAL_S:
        raise InputError(
            f"{path}: its rows lie {interval:.2g} s apart, since its time names no unit and was read as seconds; expected at "
            f"least {MIN_ROW_INTERVAL_S:g} s. Spreadsheets may write days: write seconds as t_s."
        )
    if stream is not Stream.JOINTS and interval > MAX_ROW_INTERVAL_S:
        raise InputError(
            f"{path}: its rows lie {interval:.4g} s apart, since its time names no unit and was read as seconds; expected no "
            f"more than {MAX_ROW_INTERVAL_S:g} s: {advice}."
        )


def late_streams(timelines: Sequence[Timeline]) -> list[str]:
    """Report streams that start later or end earlier than the others: nothing is paired there."""
    first, last = min(each.first for each in timelines), max(each.last for each in timelines)
    found: list[str] = []
    for each in timelines:
        late, early = each.first - first, last - each.last
        if late > REPORT_LATE_START_OR_EARLY_END_FROM_S:
            found.append(f"{each.name}: starts {late:.1f} s after the first stream; {_lost_pokes(each.name, 'before')}.")
        if early > REPORT_LATE_START_OR_EARLY_END_FROM_S:
            found.append(f"{each.name}: ends {early:.1f} s before the last stream; {_lost_pokes(each.name, 'after')}.")
    return found


def _lost_pokes(name: str, side: str) -> str:
    if name == Stream.JOINTS.value:
        return f"the arm pose of pokes {side} it is unknown, and they do not count"
    return f"pokes {side} it are not found"


@dataclass(frozen=True, slots=True, eq=False)
class OpenRecording:
    """A recording that was read through once, one link, timeline and source of lines for each stream."""

    links: tuple[LinkSpec, ...]
    timelines: tuple[Timeline, ...]
    sources: tuple[Lines, ...]
    findings: tuple[str, ...]
    """Sentences."""
    frame_shape: tuple[int, ...] = ()
    """Rows and columns of a frame of the skin; empty if the recording does not state them."""
    pose_names: PoseNames = NO_POSE_NAMES
    """What the recording states on the numbers of the tool's poses."""
    value_order: ValueOrder | None = None
    """Order of the values of taxels of three axes that the recording states; `None` if it does not."""

    @property
    def span_ns(self) -> int:
        """Nanoseconds from the first line of any stream to the last."""
        first, last = min(each.first for each in self.timelines), max(each.last for each in self.timelines)
        return round((last - first) * 1e9)

    def chunks(self) -> Iterator[Chunk]:
        """Yield the lines of all streams as chunks in the order of time; lazily."""
        # A frame gets the last angles or pose before it, so these must not come later; a wrench may, since frames wait for it.
        return merged_chunks(self.timelines, self.sources, (Stream.JOINTS.value, Stream.TOOL.value))


def merged_chunks(timelines: Sequence[Timeline], sources: Sequence[Lines], early: Sequence[str] = ()) -> Iterator[Chunk]:
    """Yield the lines of all files in the order of time, each with the files that share it in the order given; lazily.

    Every line of the files named in `early` comes before the later lines of all other files, although these share chunks.
    """
    share_clock_jumps(timelines)
    origin = min(timeline.first for timeline in timelines)
    found = [_find_chunks(timeline, origin) for timeline in timelines]
    for file, timeline in enumerate(timelines):
        if timeline.name in early and len(timelines) > 1:
            others = np.sort(np.concatenate([ends_ns for other, (_, ends_ns) in enumerate(found) if other != file]))
            found[file] = _find_chunks(timeline, origin, others)
    files = np.repeat(np.arange(len(found)), [len(ends_ns) for _, ends_ns in found])
    counts = np.concatenate([np.diff(starts, append=line.lines) for line, (starts, _) in zip(timelines, found, strict=True)])
    host_ns = np.concatenate([ends_ns for _, ends_ns in found])
    lines = [chain.from_iterable(source()) for source in sources]
    order = np.lexsort((files, host_ns))
    chunks = np.stack([files, host_ns, counts], axis=1)[order]
    del found, files, counts, host_ns, order
    for begin in range(0, len(chunks), CHUNKS_CONVERTED_AT_ONCE):
        part: list[tuple[int, int, int]] = chunks[begin : begin + CHUNKS_CONVERTED_AT_ONCE].tolist()
        for file, end_ns, count in part:
            yield Chunk(timelines[file].name, end_ns, b"".join(islice(lines[file], count)))


def _find_chunks(timeline: Timeline, origin: float, cuts_ns: IntArray | None = None) -> tuple[IntArray, IntArray]:
    """Find the first line of each chunk, and the time of its last line on the host's clock, ns.

    The decoder dates every line of a chunk by the chunk's arrival and keeps the smallest delay. A chunk has the time of its
    last line, so only earlier lines look late. The first line after a clock change gets a chunk of its own.

    Parameters
    ----------
    cuts_ns : ascending times of the host's clock that no chunk has lines on both sides of
    """
    starts, ends_ns = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    begin, open_chunk, last_ns = 0, 0, SESSION_START_TIME_NS
    # The first line has no step before it; the second comes after a change.
    last_stamp, has_jumped = -np.inf, True
    for stamps, times in timeline.place_lines(origin):
        end, before_ns = begin + len(stamps), np.append(last_ns, times[:-1])
        jumped = np.abs(np.diff(stamps, prepend=last_stamp)) > MAX_TIME_STEP_BACK_S
        ticks = (
            np.diff(
                (times - SESSION_START_TIME_NS) // CHUNK_MAX_TIME_NS,
                prepend=(last_ns - SESSION_START_TIME_NS) // CHUNK_MAX_TIME_NS,
            )
            > 0
        )
        is_start = jumped | np.append(has_jumped, jumped[:-1]) | ticks
        bounds = [open_chunk, *(begin + np.flatnonzero(is_start)).tolist(), end]
        for first, after in pairwise(bounds):
            if after - first > CHUNK_MAX_LINES:
                split = np.arange(first, after, CHUNK_MAX_LINES)
                is_start[split[split >= begin] - begin] = True
        if cuts_ns is not None:
            place = np.searchsorted(cuts_ns, times, "right")
            is_start |= np.diff(place, prepend=np.searchsorted(cuts_ns, last_ns, "right")) > 0
        at = np.flatnonzero(is_start)
        starts.append(begin + at)
        ends_ns.append(before_ns[at])
        begin, open_chunk, last_ns = end, bounds[-2], int(times[-1])
        last_stamp, has_jumped = float(stamps[-1]), bool(jumped[-1])
    return np.concatenate(starts), np.append(np.concatenate(ends_ns)[1:], last_ns)
