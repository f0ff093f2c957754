"""Chunks and events of all links in, paired samples out: the one facade of the streams.

*When was a reading made?* Reading i is stamped x_i by the device and arrives at y_i = f(x_i) + d_i on the host's clock. f is a
straight line over a minute (two crystals differ by a constant factor), and the delay d_i of sensor, wire, adapter and program
is never less than a constant d. So the line that is wanted, f + d, lies under all points and touches some. Of all lines a + b x
under all points the one with the least sum of y_i - a - b x_i is taken: with n points that sum is sum(y_i) - n (a + b m), m the
mean of x_i, so it is the line that is highest at m, the edge of the lower convex hull above m. Queueing (a timer of 16 ms in a
serial adapter, bursts, a busy program) makes delays longer, never shorter, and drops out; what is left is the constant d, which
no stamp of arrival can show. A least-squares line would keep the mean delay instead.

Live, the points of the last minute count, and the line is carried on to the newest one. To keep the work per reading
constant, readings are gathered in buckets of a quarter second, of which only the point lowest above the present line is
kept: at most 240 points for the hull, which is made anew when a bucket ends. What a bucket drops could only matter when
the line turns: a change of slope of 100 parts in a million moves it by 25 microseconds within a bucket. A point below the
line pushes the line down at once, so no reading is ever dated after its arrival.

A device without a clock is dated by its count times its period, where it keeps a constant pace (`IndexClock`); by its own
numbers, where it sends them.

*Which wrench acted while a skin frame was taken?* A frame's stamp ends its interval: the wrench of a frame is the mean of the
readings in the interval of one frame period up to the stamp, so no reading from after the frame is needed and the means of
neighbouring frames share no reading. Where the wrench is slower than the skin and no reading falls into an interval, the
wrench at its middle is interpolated. A frame waits until the wrench stream has passed its stamp; a frame that waited too
long is counted and left out.

What comes out depends on the items fed and nothing else: no wall clock, no thread. So a journal of the items, fed again,
gives the same samples bit for bit.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict, deque
from collections.abc import Mapping, Sequence
from itertools import islice, pairwise
from statistics import median
from types import MappingProxyType
from typing import NamedTuple, TypeAlias, assert_never

import numpy as np
from numpy.typing import NDArray

from skincal.devices.decoding import NO_SEQ, WRENCH_WIDTH
from skincal.devices.family import AUTO
from skincal.geometry import FloatArray, IntArray, mean_rows
from skincal.model.errors import InputError
from skincal.model.readings import (
    Batch,
    Chunk,
    JointsBatch,
    LinkEvent,
    LinkHealth,
    LinkState,
    Loss,
    Sample,
    SideReading,
    SkinBatch,
    Stream,
    WrenchBatch,
    cut,
    joined,
)
from skincal.streams.decoders.auto_detect import LinkDecoder, decoder_class
from skincal.streams.link_diagnosis import Differences, LinkMonitor, values_of
from skincal.streams.links import LinkSpec, format_of

WINDOW_S = 60.0
"""s. Points older than this no longer count: crystals wander with temperature over minutes."""
BUCKET_S = 0.25
"""s. Time in which one point is kept: see the theory above."""
SLOPE_CHANGE_MAX = 0.02
"""Largest difference of the two clocks' speeds: a factory-trimmed RC oscillator is within 2 %, a resonator within 0.5 %."""
JUMP_S = 0.5
"""s. A clock that is off by more started anew: no stall of a running program or adapter is as long."""
BEHIND_S = 3.0
"""s. A device that stays `JUMP_S` behind for this long lost its time for good; a stall ends sooner."""
STEP_S = 1e-6
"""s. Least step from one stamp to the next of a stream: stamps never go back when the line is pushed down."""

LEARN_S = 2.0
LEARN_READINGS = 20
"""The pace of a device without a clock is learnt over so long and so many: within 1 % under a jitter of 16 ms."""
PACE_ERROR_MAX = 0.2
"""Largest relative error of the pace as first learnt: a stall of 0.4 s among the first two seconds."""
LOST_PERIODS = 0.7
LOST_S = 0.005
"""s. A device without a clock that is late by more than this and by `LOST_PERIODS` for a whole bucket lost a reading."""
RESTARTS_MAX = 3
RESTARTS_S = 60.0
"""s. More restarts than `RESTARTS_MAX` in this time mean that the device keeps no pace."""


Point: TypeAlias = tuple[float, float]
"""A reading's time by the device's clock and its arrival, seconds."""


class ConvexHullClock:
    """Maps a device's time to the host's: the supporting line of the module's theory, for points as they come."""

    def __init__(self, slope_change_max: float = SLOPE_CHANGE_MAX) -> None:
        self._slope_change_max = slope_change_max
        self.reset()

    def reset(self) -> None:
        """Forget everything: the device or its clock started anew."""
        self.jumps = 0
        self._origin: tuple[float, float] | None = None
        self._offset, self._slope = 0.0, 1.0
        self._last_x = -math.inf
        self._behind_since: float | None = None
        self._lowest = (0.0, 0.0)
        self._bucket_start = 0.0
        self._points: deque[Point] = deque()
        # The points in order, and their hull, as the last bucket left them.
        self._ordered: list[Point] = []
        self._hull: list[Point] = []

    def map(self, device_s: float, arrival_s: float) -> float:
        """Return when the reading was made, up to the constant least delay, on the host's clock.

        The device's stamp, seconds, may step back a little, not by `JUMP_S`; `arrival_s` is the host's clock, seconds.
        """
        if self._origin is None:
            self._begin(device_s, arrival_s)
        x, y, late = self._place(device_s, arrival_s)
        if self._jumped(device_s, y, late):
            jumps = self.jumps + 1
            self._begin(device_s, arrival_s)
            self.jumps = jumps
            x, y, late = 0.0, 0.0, 0.0
        # Nothing is dated after its arrival: a point below the line pushes it down at once, not at the bucket's end.
        if late < 0.0:
            self._offset += late
            late = 0.0
        if late <= self._lowest[1] - self._offset - self._slope * self._lowest[0]:
            self._lowest = x, y
        self._last_x = max(self._last_x, device_s)
        if x - self._bucket_start >= BUCKET_S:
            self._end_bucket(x, y)
        return arrival_s - (y - self._offset - self._slope * x)

    def map_steady(self, device_s: Sequence[float], arrivals_s: Sequence[float], begin: int = 0) -> list[float]:
        """Return what `map` returns for readings from `begin` on; only as many as need none but the usual steps."""
        if self._origin is None or self._behind_since is not None:
            return []
        made: list[float] = []
        first_x, first_y = self._origin
        (low_x, low_y), last_x = self._lowest, self._last_x
        offset, slope = self._offset, self._slope
        low_late = low_y - offset - slope * low_x
        end = self._bucket_start + BUCKET_S
        for stamp, arrival_s in zip(islice(device_s, begin, None), islice(arrivals_s, begin, None), strict=True):
            x, y = stamp - first_x, arrival_s - first_y
            late = y - offset - slope * x
            # The same sums as in `map`, in the same order; a bucket ends where x - start says so.
            if stamp < last_x - JUMP_S or not -JUMP_S <= late <= JUMP_S or x >= end - STEP_S:
                break
            if late < 0.0:
                offset += late
                late = 0.0
                low_late = low_y - offset - slope * low_x
            if late <= low_late:
                low_x, low_y = x, y
                low_late = y - offset - slope * x
            if stamp > last_x:
                last_x = stamp
            made.append(arrival_s - (y - offset - slope * x))
        self._lowest, self._last_x, self._offset = (low_x, low_y), last_x, offset
        return made

    def _begin(self, device_s: float, arrival_s: float) -> None:
        self.reset()
        self._origin = device_s, arrival_s
        self._last_x = device_s

    def _place(self, device_s: float, arrival_s: float) -> tuple[float, float, float]:
        """Return the point measured from the first one, so that products keep their digits for days, and its delay."""
        first_x, first_y = self._origin or (device_s, arrival_s)
        x, y = device_s - first_x, arrival_s - first_y
        return x, y, y - self._offset - self._slope * x

    def _jumped(self, device_s: float, y: float, late: float) -> bool:
        """Say whether the device's clock is no longer the one that the line was made for."""
        if device_s < self._last_x - JUMP_S or late < -JUMP_S:
            return True
        if late <= JUMP_S:
            self._behind_since = None
        elif self._behind_since is None:
            self._behind_since = y
        return self._behind_since is not None and y - self._behind_since > BEHIND_S

    def _end_bucket(self, x: float, y: float) -> None:
        self._points.append(self._lowest)
        while self._points[0][0] < x - WINDOW_S:
            self._points.popleft()
            if not self._points:
                # The device was silent for the whole window: the reading that ends the pause is all that counts.
                self._points.append((x, y))
        self._bucket_start, self._lowest = x, (x, y)
        # Sorted: a skin frame may be stamped a little before the wrench that was sent ahead of it: one line serves all
        # streams of a device.
        ordered = sorted(self._points)
        # The usual bucket: one point came at the right, and some went at the left.
        goes_on = ordered[:-1] == self._ordered[len(self._ordered) + 1 - len(ordered) :]
        self._hull = lower_hull(ordered, self._hull if goes_on else ())
        self._ordered = ordered
        self._offset, self._slope = supporting_line(ordered, self._hull, self._slope_change_max)
        # The reading that ends the bucket is not among the points yet, and the line may not lie above it either.
        self._offset += min(y - self._offset - self._slope * x, 0.0)


def supporting_line(points: Sequence[Point], hull: Sequence[Point], slope_change_max: float) -> tuple[float, float]:
    """Find offset and slope of the line under all `points` (x, y), seconds, ascending in x, that is highest at their mean x.

    `hull` is their lower hull. The slope is held within `slope_change_max` of 1.
    """
    mean = math.fsum([x for x, _ in points]) / len(points)
    slope = 1.0
    for (x0, y0), (x1, y1) in pairwise(hull):
        if x0 <= mean <= x1 and x1 > x0:
            slope = (y1 - y0) / (x1 - x0)
            break
    slope = min(max(slope, 1.0 - slope_change_max), 1.0 + slope_change_max)
    # Found anew: a line through the edge whose slope was then held back would cut through other points.
    return min(y - slope * x for x, y in hull), slope


def lower_hull(points: Sequence[Point], known: Sequence[Point] = ()) -> list[Point]:
    """Return the lower convex hull, left to right (Andrew's monotone chain).

    `known` is that of all but the last of the points, and of others left of them. Where the chain comes to a corner of it by
    the edge that it had there, it goes on as it did, since nothing is asked any more about what lies before that edge.
    """
    places = {id(corner): place for place, corner in enumerate(known)}
    hull: list[Point] = []
    for point in points:
        _add_corner(hull, point)
        place = places.get(id(point))
        if place and len(hull) > 1 and hull[-2] is known[place - 1]:
            hull += known[place + 1 :]
            _add_corner(hull, points[-1])
            break
    return hull


def _add_corner(hull: list[Point], point: Point) -> None:
    x, y = point
    while len(hull) > 1:
        x1, y1 = hull[-1]
        x0, y0 = hull[-2]
        if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):
            break
        del hull[-1]
    hull.append(point)


class IndexClock:
    """Dates the readings of a device that has no clock by their count, where it keeps a constant pace.

    The pace is learnt first; until then, and for a device that keeps none, the arrival is the best that is known.

    A device that numbers its readings is dated by these numbers as by a clock: they tell a lost reading from a late one. Where
    readings are only counted here, a lost one makes all later ones late by a period: the line then starts anew at the present
    one. So does a queue that lasts, and then the line lies too late until the queue is gone.
    """

    def __init__(self) -> None:
        self._hull = ConvexHullClock(PACE_ERROR_MAX)
        self._restarts: deque[float] = deque()
        self._number, self._numbered = 0, False
        self._learn_anew()

    def map(self, arrival_s: float, number: int = NO_SEQ) -> float:
        """Return when the next reading was made, up to the constant least delay, on the host's clock, seconds.

        `number` is the device's own, `NO_SEQ` where it has none.
        """
        self._numbered = number >= 0
        if self._numbered and number < self._number:
            # The device began anew.
            self._learn_anew()
        self._number = number if self._numbered else self._number + 1
        if self._period is None:
            self._learn(arrival_s)
            return arrival_s
        made_s = self._hull.map(self._number * self._period, arrival_s)
        if not self._numbered:
            self._watch(arrival_s, arrival_s - made_s, self._period)
        elif self._hull.jumps:
            self._restart_late(arrival_s)
        return made_s

    def lost(self) -> None:
        """Start the line anew: a reading is known to be missing before the next one, which a device's numbers tell, too."""
        if self._numbered:
            return
        if self._period is None:
            self._learn_anew()
        self._hull.reset()

    def _watch(self, arrival_s: float, late_s: float, period_s: float) -> None:
        # By the least of a bucket: queueing makes single readings late, a lost reading makes all of them late. Of readings that
        # arrived together, as after a stall, the last alone is on time: so a bucket ends between two arrivals.
        if arrival_s > self._arrival_s and self._arrival_s - self._bucket_s >= BUCKET_S:
            if self._least_late > max(LOST_PERIODS * period_s, LOST_S):
                self._restart_late(arrival_s)
            self._bucket_s, self._least_late = self._arrival_s, math.inf
        self._arrival_s, self._least_late = arrival_s, min(self._least_late, late_s)

    def _restart_late(self, arrival_s: float) -> None:
        """Start the line anew after what only the delay shows; too often means another pace than was learnt, or none."""
        self._hull.reset()
        self._restarts.append(arrival_s)
        while self._restarts[0] < arrival_s - RESTARTS_S:
            self._restarts.popleft()
        if len(self._restarts) > RESTARTS_MAX:
            self._restarts.clear()
            self._learn_anew()

    def _learn_anew(self) -> None:
        self._period: float | None = None
        self._first: tuple[int, float] | None = None
        self._bucket_s, self._arrival_s, self._least_late = -math.inf, -math.inf, math.inf

    def _learn(self, arrival_s: float) -> None:
        if self._first is None:
            self._first = self._number, arrival_s
        count, elapsed = self._number - self._first[0], arrival_s - self._first[1]
        if elapsed >= LEARN_S and count + 1 >= LEARN_READINGS:
            self._period = elapsed / count
            self._hull.reset()
            self._bucket_s = arrival_s


class Timestamper:
    """Dates the readings of one link: one line for the device's clock, which its streams share, and counts without one."""

    def __init__(self) -> None:
        self._device = ConvexHullClock()
        self._index = defaultdict[Stream, IndexClock](IndexClock)
        self._last: dict[Stream, float] = {}

    def reopened(self) -> None:
        """Start the clocks anew, not the order: the link was away."""
        self._device.reset()
        self._index.clear()

    def lost(self) -> None:
        """Say that readings were lost, which a count does not see."""
        for index in self._index.values():
            index.lost()

    def stamp(
        self, stream: Stream, device_s: FloatArray, arrival_s: float | FloatArray, seq: IntArray | None = None
    ) -> FloatArray:
        """Return the host's clock at each reading, (n,) seconds, strictly ascending from call to call.

        Parameters
        ----------
        device_s : (n,), seconds, NaN where the device has no clock
        arrival_s : when the last of them arrived, or (n,) when the last of those arrived that came with each
        seq : (n,), the device's numbers, `NO_SEQ` where it has none
        """
        readings, arrivals = device_s.tolist(), np.broadcast_to(arrival_s, device_s.shape).tolist()
        clocked = not np.isnan(device_s).any()
        made: list[float] = []
        while (at := len(made)) < len(readings):
            steady = self._device.map_steady(readings, arrivals, at) if clocked else []
            if steady:
                made += steady
            elif math.isnan(readings[at]):
                made.append(self._index[stream].map(arrivals[at], NO_SEQ if seq is None else int(seq[at])))
            else:
                made.append(self._device.map(readings[at], arrivals[at]))
        stamps = _ascending(np.array(made), self._last.get(stream, -math.inf))
        self._last[stream] = float(stamps[-1])
        return stamps


def _ascending(stamps: FloatArray, last: float) -> FloatArray:
    """Return stamps (n,), seconds, n > 0, each moved to `STEP_S` behind the one before it where it is earlier."""
    if stamps[0] >= last + STEP_S and (stamps[1:] >= stamps[:-1] + STEP_S).all():
        return stamps
    moved: list[float] = []
    for stamp in stamps.tolist():
        last = max(stamp, last + STEP_S)
        moved.append(last)
    return np.array(moved)


WAIT_S = 0.25
"""s. How long a frame waits for the wrench: longer than any adapter holds bytes back, short enough for a live picture."""
PERIOD_FRAMES = 15
"""The frame period is the median of this many intervals: lost frames and a jumpy clock do not move it."""
FIRST_PERIOD_S = 0.02
"""s. Period of the first frame, when no interval is known: skins send 50 frames a second."""
INTERPOLATE_S = 0.05
"""s. Readings further apart are not interpolated: twice the period of a sensor at 50 Hz with one reading lost, and a bit."""
EDGE_S = 1e-6
"""s. A reading this little after an edge counts as on it: stamps are rounded to the microsecond by the devices."""
WAITING_MAX = 4096
"""Frames that may wait, whatever their stamps say: a bound for memory."""
JOINTS_KEPT = 512
RING_READINGS = 16384
"""Readings kept: 10 s at 1.6 kHz."""
RECENT_S = 10.0
"""s. What the live curves show."""
RATE_NS = 2_000_000_000
"""Nanoseconds over which a rate is counted."""
RATE_STEP_NS = 100_000_000
"""Nanoseconds of readings counted together for the rate."""
LOSSES_THAT_BREAK_COUNTING = (Loss.BAD_WIDTH, Loss.UNREADABLE, Loss.BAD_CHECKSUM, Loss.MISSING)
"""Losses after which a count of readings no longer gives the time."""


class Intake:
    """Decodes, dates and pairs what the links of one session send: skin frames of `channels` values, at least `joints` angles.

    The constructor raises InputError: a format is not known, or two links have one name; for `feed` see `check`.
    """

    def __init__(self, channels: int, links: Sequence[LinkSpec], joints: int = 0) -> None:
        self._links = {spec.name: LinkIntake(channels, spec, joints) for spec in links}
        if len(self._links) < len(links):
            raise InputError("Two links have the same name; expected a name of its own for each.")
        self.frozen: frozenset[str] = frozenset()
        """Names of the links on which a stream that always has noise repeats one reading."""
        self._joints = joints
        self._pairing = Pairing()
        self._now_s = -np.inf

    @property
    def down(self) -> frozenset[str]:
        """Names of the links that are not open, or bring nothing that is measured."""
        return frozenset(name for name, link in self._links.items() if link.state is not LinkState.OPEN or link.ear.lifeless)

    @property
    def unpaired(self) -> int:
        """Skin frames that found no wrench, LATE or UNPAIRED; the losses of the skin's link count them by reason."""
        return self._pairing.counts.total()

    def check(self, item: Chunk | LinkEvent) -> None:
        """Refuse an item of a link that was not described, with an InputError; nothing is taken."""
        if item.link not in self._links:
            raise InputError(f"Bytes of a link named {item.link!r} came; expected one of {', '.join(self._links) or 'none'}.")

    def feed(self, item: Chunk | LinkEvent) -> list[Sample]:
        """Take the next item of the queue or the journal and return the samples that it completes, in order."""
        self.check(item)
        link = self._links[item.link]
        arrived = link.take_chunk(item) if isinstance(item, Chunk) else link.take_event(item)
        for dated in arrived:
            self._take(dated)
        if link.ear.frozen != (item.link in self.frozen):
            self.frozen ^= {item.link}
        # Two readers stamp their bytes before they queue them, so items may be out of order by a little.
        self._now_s = max(self._now_s, item.host_ns * 1e-9)
        return self._pairing.advance(self._now_s)

    def read_ahead(self, chunks: Sequence[Chunk]) -> None:
        """Decode the chunks that are fed next, in this order, many at a time; what comes out stays the same."""
        for name, link in self._links.items():
            link.read_ahead([chunk for chunk in chunks if chunk.link == name])

    def _take(self, dated: Dated) -> None:
        batch, stamps = dated.batch, dated.stamps
        match batch:
            case WrenchBatch():
                self._pairing.add_wrench(stamps, batch)
            case SkinBatch():
                for stamp, values in zip(stamps.tolist(), batch.values, strict=True):
                    self._pairing.add_frame(stamp, dated.arrival_s, values)
            case JointsBatch():
                if batch.angles.shape[1] >= self._joints:
                    for stamp, angles in zip(stamps.tolist(), batch.angles, strict=True):
                        if all(map(math.isfinite, angles.tolist())):
                            self._pairing.add_joints(stamp, angles)
            case _:
                assert_never(batch)

    def wrench_after(self, host_s: float) -> tuple[FloatArray, FloatArray]:
        """Return stamps (n,), seconds, and wrenches (n, 6) of the last ten seconds that are later than `host_s`."""
        ring = self._pairing.ring
        return ring.since(max(ring.newest_s - RECENT_S, math.nextafter(host_s, math.inf)))

    def recent_wrench(self) -> tuple[FloatArray, FloatArray]:
        """Return stamps (n,), seconds, and wrenches (n, 6) of the last ten seconds, as the device says them."""
        return self._pairing.ring.since(self._pairing.ring.newest_s - RECENT_S)

    def beside(self) -> dict[str, Mapping[str, SideReading]]:
        """Return what each link's device measured beside its readings."""
        return {name: link.beside() for name, link in self._links.items()}

    def health(self, now_ns: int) -> tuple[LinkHealth, ...]:
        """Say how each link does; the rate counts the two seconds before `now_ns` of the host's monotonic clock."""
        none: Counter[Loss] = Counter()
        return tuple(
            link.health(now_ns, self._pairing.counts if Stream.SKIN in link.spec.carries else none)
            for link in self._links.values()
        )


class Dated(NamedTuple):
    """Readings of one stream that arrived together."""

    batch: Batch
    stamps: FloatArray
    """(n,) host's clock at each reading, seconds."""
    arrival_s: float
    change: Differences | None = None
    """How they differ, where they were decoded before their turn."""


class LinkIntake:
    """One link: its decoder, its clocks and its figures."""

    def __init__(self, channels: int, spec: LinkSpec, joints: int = 0) -> None:
        self.spec = spec
        self.stamper = Timestamper()
        name = format_of(spec.address, spec.format)
        # Frames that need a recipe do not say what they hold, so no other decoder can read them.
        kind = None if name == AUTO else decoder_class(name)
        streams = spec.carries if kind is not None and kind.single_stream else tuple(Stream)
        look = None if kind is not None and kind.needs_recipe else lambda: LinkDecoder(name, None, streams)
        self.ear = LinkMonitor(spec.carries, {Stream.WRENCH: WRENCH_WIDTH, Stream.SKIN: channels, Stream.JOINTS: joints}, look)
        self._channels = channels
        self._decoder = self._new_decoder()
        self._ahead: deque[tuple[Chunk, Dated]] = deque()
        """Chunks that are decoded and dated already."""
        self._before: Counter[Loss] = Counter()
        """What the decoders lost that the link had before it was opened anew."""
        self._beside_before: Mapping[str, SideReading] = {}
        self.state, self._text = LinkState.LOST, "not opened yet"
        self._readings = 0
        self._last_ns = 0
        self._rate: deque[tuple[int, int]] = deque(maxlen=RATE_NS // RATE_STEP_NS + 1)

    def _new_decoder(self) -> LinkDecoder:
        return LinkDecoder(format_of(self.spec.address, self.spec.format), self._channels, self.spec.carries)

    def read_ahead(self, chunks: Sequence[Chunk]) -> None:
        """Decode and date the chunks of this link that come next at once, where that can be done."""
        found = self._decoder.feed_many([chunk.data for chunk in chunks])
        if found is None:
            return
        whole, ends = found
        arrivals = [chunk.host_ns * 1e-9 for chunk in chunks]
        each = np.repeat(arrivals, np.diff(ends, prepend=0))
        stamps = self.stamper.stamp(values_of(whole)[0], whole.device_s, each, whole.seq)
        parts = (stamps[begin:end] for begin, end in pairwise([0, *ends]))
        dated = map(Dated, cut(whole, ends), parts, arrivals, self.ear.compare(whole, ends))
        self._ahead.extend(zip(chunks, dated, strict=True))

    def take_chunk(self, chunk: Chunk) -> list[Dated]:
        """Return the readings that bytes complete."""
        if self._last_ns == 0 and self.state is LinkState.LOST:
            self.state, self._text = LinkState.OPEN, ""
        self._last_ns = chunk.host_ns
        if self._ahead:
            ahead, dated = self._ahead.popleft()
            assert ahead is chunk, "chunks come in the order in which they were read ahead"
            self._count([(chunk.host_ns, dated.batch)])
            self.ear.hear(chunk.data, chunk.host_ns, [dated.batch], dated.change)
            return [dated]
        # Found before the batches are dated: after a loss a count of readings no longer tells the time.
        before = self._broken()
        batches = self._decoder.feed(chunk.data, chunk.host_ns)
        if self._broken() > before:
            self.stamper.lost()
        self._count(batches)
        self.ear.hear(chunk.data, chunk.host_ns, [batch for _, batch in batches])
        return self._dated(batches)

    def take_event(self, event: LinkEvent) -> list[Dated]:
        """Follow the link's state; what was held back until the format was sure is let through at the end."""
        batches: list[tuple[int, Batch]] = []
        self.ear.follow(event)
        if event.state is LinkState.ENDED:
            batches = self._decoder.finish()
            self._count(batches)
        elif event.state is LinkState.OPEN and self._last_ns:
            # A new decoder: half a record from before the break must not run into the first one after it.
            self._before += self._decoder.counts
            self._beside_before = self.beside()
            self._decoder = self._new_decoder()
            self.stamper.reopened()
        self._before[Loss.DROPPED] += event.dropped
        self.state, self._text = event.state, event.text
        return self._dated(batches)

    def _dated(self, batches: Sequence[tuple[int, Batch]]) -> list[Dated]:
        arrived = [(batch, host_ns * 1e-9) for host_ns, batch in batches]
        return [
            Dated(batch, self.stamper.stamp(values_of(batch)[0], batch.device_s, arrival_s, batch.seq), arrival_s)
            for batch, arrival_s in arrived
        ]

    def _broken(self) -> int:
        counts = self._decoder.counts
        return sum(counts[loss] for loss in LOSSES_THAT_BREAK_COUNTING) if counts else 0

    def _count(self, batches: list[tuple[int, Batch]]) -> None:
        for arrival_ns, batch in batches:
            self._readings += len(batch.seq)
            step_ns = arrival_ns - arrival_ns % RATE_STEP_NS
            if self._rate and self._rate[-1][0] == step_ns:
                step_ns, count = self._rate.pop()
                self._rate.append((step_ns, count + len(batch.seq)))
            else:
                self._rate.append((step_ns, len(batch.seq)))

    def health(self, now_ns: int, pairing: Mapping[Loss, int] = MappingProxyType({})) -> LinkHealth:
        """Return the figures of the link; `pairing` holds the losses of the pairing, which count for the skin's link."""
        text = self._text or (self._decoder.device_message if self.state is LinkState.OPEN else "")
        losses = self._before + self._decoder.counts + Counter(pairing)
        spec, rate, verdict = self.spec, self._rate_until(now_ns), self.ear.judge(now_ns)
        units = "; ".join(words for stream, words in self._decoder.units.items() if stream in spec.carries)
        return LinkHealth(
            spec.name,
            self.state,
            text,
            spec.carries,
            self._decoder.name,
            self._readings,
            rate,
            self._last_ns,
            losses,
            self.beside(),
            units,
            verdict,
            spec.address,
        )

    def beside(self) -> Mapping[str, SideReading]:
        """Return what the device measured beside its readings."""
        return joined(self._beside_before, self._decoder.side_readings)

    def _rate_until(self, now_ns: int) -> float:
        """Return readings per second over the last two seconds, or since the first reading where that is less."""
        now_step_ns = now_ns - now_ns % RATE_STEP_NS
        # The step in progress is not full yet: with it the rate would flicker.
        counted = [(step_ns, count) for step_ns, count in self._rate if now_step_ns - RATE_NS <= step_ns < now_step_ns]
        if not counted:
            return 0.0
        return sum(count for _, count in counted) / ((now_step_ns - counted[0][0]) * 1e-9)


class _Frame(NamedTuple):
    host_s: float
    arrival_s: float
    period_s: float
    values: FloatArray


class Pairing:
    """Brings wrench and joint angles to the instants of the skin frames. Stamps of each stream must ascend."""

    def __init__(self) -> None:
        self.ring = WrenchRing(RING_READINGS)
        self.counts: Counter[Loss] = Counter()
        """Frames left out: LATE and UNPAIRED."""
        self._waiting: deque[_Frame] = deque()
        self._intervals: deque[float] = deque(maxlen=PERIOD_FRAMES)
        self._last_frame_s: float | None = None
        self._joints: deque[tuple[float, FloatArray]] = deque(maxlen=JOINTS_KEPT)

    def add_wrench(self, host_s: FloatArray, batch: WrenchBatch) -> None:
        """Take wrench readings; those that are not finite or not valid are kept out of every mean."""
        usable = np.isfinite(batch.wrench).all(axis=1) & ~batch.invalid
        self.ring.append(host_s, batch.wrench, usable, batch.saturated | batch.invalid)

    def add_joints(self, host_s: float, angles: FloatArray) -> None:
        """Take joint angles, radians."""
        self._joints.append((host_s, angles))

    def add_frame(self, host_s: float, arrival_s: float, values: FloatArray) -> None:
        """Take a skin frame; it is returned by `advance` when its wrench is known."""
        if self._last_frame_s is not None:
            self._intervals.append(host_s - self._last_frame_s)
        self._last_frame_s = host_s
        period_s = median(self._intervals) if self._intervals else FIRST_PERIOD_S
        self._waiting.append(_Frame(host_s, arrival_s, period_s, values))
        if len(self._waiting) > WAITING_MAX:
            self._waiting.popleft()
            self.counts[Loss.UNPAIRED] += 1

    def advance(self, now_s: float) -> list[Sample]:
        """Return the frames whose wrench is known when bytes came at `now_s`, in order; count those that waited too long."""
        samples: list[Sample] = []
        while self._waiting:
            frame = self._waiting[0]
            sample = self._pair(frame) if self.ring.newest_s >= frame.host_s else None
            if sample is not None:
                samples.append(sample)
            elif self.ring.forgot(frame.host_s - frame.period_s):
                self.counts[Loss.LATE] += 1
            elif now_s - max(frame.host_s, frame.arrival_s) > WAIT_S:
                self.counts[Loss.UNPAIRED] += 1
            else:
                break
            self._waiting.popleft()
        return samples

    def _pair(self, frame: _Frame) -> Sample | None:
        if self.ring.forgot(frame.host_s - frame.period_s):
            return None
        among = self.ring.between(frame.host_s - frame.period_s + EDGE_S, frame.host_s + EDGE_S)
        wrench, readings = self.ring.mean(among)
        if not readings:
            between = self.ring.interpolate(frame.host_s - frame.period_s / 2, INTERPOLATE_S)
            if between is None:
                return None
            (wrench, among), readings = between, 2
        return Sample(frame.host_s, frame.values, wrench, readings, self.ring.flagged(among), self._angles_at(frame.host_s))

    def _angles_at(self, host_s: float) -> FloatArray | None:
        """Return the last joint angles at or before an instant; older ones are dropped, as frames come in order."""
        while len(self._joints) > 1 and self._joints[1][0] <= host_s:
            self._joints.popleft()
        return self._joints[0][1] if self._joints and self._joints[0][0] <= host_s else None


class WrenchRing:
    """Keeps the last `capacity` readings in order of their stamps, as plain slices.

    The arrays are twice as long as needed: readings are written forward, and when the end is reached the newest half moves
    to the front. So what is kept is always one contiguous slice, and a reading costs the same however long it runs.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._host_s = np.zeros(2 * capacity)
        self._wrench = np.zeros((2 * capacity, WRENCH_WIDTH))
        self._usable = np.zeros(2 * capacity, np.bool_)
        self._flagged = np.zeros(2 * capacity, np.bool_)
        self._end = 0
        self._dropped = False

    def append(self, host_s: FloatArray, wrench: FloatArray, usable: NDArray[np.bool_], flagged: NDArray[np.bool_]) -> None:
        """Add n readings that are newer than all before, N and N m, their stamps ascending, seconds.

        `usable` ones may be averaged; of `flagged` ones the device says that they are saturated or invalid.
        """
        kept = slice(max(len(host_s) - self._capacity, 0), None)
        count = len(host_s[kept])
        if count < len(host_s):
            # What was kept is older than what is left out: together they would have a hole.
            self._dropped = True
            self._end = 0
        if self._end + count > len(self._host_s):
            self._move_to_front()
        into = slice(self._end, self._end + count)
        self._host_s[into] = host_s[kept]
        self._wrench[into] = wrench[kept]
        self._usable[into] = usable[kept]
        self._flagged[into] = flagged[kept]
        self._end += count

    def _move_to_front(self) -> None:
        count = min(self._capacity, self._end)
        newest = slice(self._end - count, self._end)
        for array in (self._host_s, self._wrench, self._usable, self._flagged):
            array[:count] = array[newest].copy()
        self._dropped |= count < self._end
        self._end = count

    @property
    def newest_s(self) -> float:
        """Stamp of the last reading, seconds; minus infinity before the first."""
        return float(self._host_s[self._end - 1]) if self._end else -np.inf

    def forgot(self, host_s: float) -> bool:
        """Say whether readings from before the oldest kept were dropped and `host_s` lies among them."""
        return self._dropped and host_s < self._host_s[0]

    def between(self, after_s: float, until_s: float) -> slice:
        """Return where the readings with `after_s < stamp <= until_s` lie."""
        known = self._host_s[: self._end]
        return slice(int(known.searchsorted(after_s, side="right")), int(known.searchsorted(until_s, side="right")))

    def mean(self, among: slice) -> tuple[FloatArray, int]:
        """Return the mean of the usable readings of a slice, and their number; NaN if there are none."""
        usable = self._usable[among]
        wrench = self._wrench[among]
        if np.count_nonzero(usable) < len(usable):
            wrench = wrench[usable]
        if not len(wrench):
            return np.full(WRENCH_WIDTH, np.nan), 0
        return mean_rows(wrench), len(wrench)

    def flagged(self, among: slice) -> bool:
        """Say whether the device flagged a reading of a slice."""
        return bool(np.count_nonzero(self._flagged[among]))

    def interpolate(self, host_s: float, apart_s: float) -> tuple[FloatArray, slice] | None:
        """Return the wrench on the straight line between the usable readings around `host_s`, and where these lie.

        None where one of them is missing, or where they are `apart_s` seconds apart or more.
        """
        near = self.between(host_s - apart_s, host_s + apart_s)
        usable = near.start + np.flatnonzero(self._usable[near])
        right = int(np.searchsorted(self._host_s[usable], host_s))
        if right in (0, len(usable)):
            return None
        pair = usable[right - 1 : right + 1]
        (first_s, second_s), (first, second) = self._host_s[pair], self._wrench[pair]
        if second_s - first_s >= apart_s:
            return None
        return first + (second - first) * ((host_s - first_s) / (second_s - first_s)), slice(int(pair[0]), int(pair[1]) + 1)

    def since(self, host_s: float) -> tuple[FloatArray, FloatArray]:
        """Return copies of the stamps (n,) and wrenches (n, 6) from `host_s` on, usable or not."""
        first = int(np.searchsorted(self._host_s[: self._end], host_s))
        return self._host_s[first : self._end].copy(), self._wrench[first : self._end].copy()
