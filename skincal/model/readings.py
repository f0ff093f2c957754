"""Data of devices: bytes with their arrival, decoded readings, losses, and the state of a link.

All values are frozen and in SI units. A batch holds one or more readings of one stream as arrays, in the device's order.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    # The commands' help needs no arrays, and numpy takes a quarter of its time.
    import numpy as np
    from numpy.typing import NDArray

    from skincal.geometry import FloatArray, IntArray
    from skincal.model.pose_form import SentPose


class Stream(Enum):
    """Quantity of a stream of readings."""

    WRENCH = "wrench"
    SKIN = "skin"
    JOINTS = "joints"
    TIP = "tip"
    """Position of the poking tip in a fixed frame, such as a robot's base; optional."""
    TOOL = "tool"
    """Pose of the poking tool in a fixed frame; only if the sensor sits on the tool."""

    # An Enum hashes its name in Python, which takes as long as the rest of a lookup.
    __hash__ = object.__hash__


SESSION_START_TIME_NS = 1_000_000_000
"""ns of the host's clock at which a session without a real clock begins (simulated or imported); 0 would mean never."""
SENSOR_STREAMS = (Stream.WRENCH, Stream.SKIN, Stream.JOINTS)
"""Streams that can be recognized by their values. A tip needs a link of its own: its three numbers could be anything."""


class Loss(Enum):
    """Reason why a reading, or part of one, was not used; the value is shown to the operator."""

    BAD_CHECKSUM = "checksum does not fit"
    BAD_WIDTH = "wrong number of values"
    UNREADABLE = "not a record of this format"
    MISSING = "numbers missing in the sequence"
    NOT_A_NUMBER = "NaN or infinite"
    SATURATED = "sensor says saturated"
    INVALID = "sensor says invalid"
    REPEATED = "the sensor repeats its last reading"
    DEAD_BLOCK = "taxels all 0 below a sum that is not"
    LATE = "arrived too late to be paired"
    UNPAIRED = "no wrench at the time of the skin frame"
    OTHER_FRAME = "in another frame than the first reading"
    NO_POSE = "no pose: a lost or left-handed one, or of another unit"
    DROPPED = "bytes dropped, as they came faster than they could be read"


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes of one read: the unit of the journal."""

    link: str
    """Name of the link, unique in a session, such as `"wrench"`."""
    host_ns: int
    """Host's monotonic clock directly after the read, nanoseconds."""
    data: bytes


class LinkState(Enum):
    """State of a link."""

    OPEN = "open"
    LOST = "lost"
    FAILED = "failed"
    ENDED = "ended"


@dataclass(frozen=True, slots=True)
class LinkEvent:
    """A change of state of a link, in the same queue as its chunks."""

    link: str
    host_ns: int
    state: LinkState
    text: str = ""
    """Sentence for the operator: what happened and what to do."""
    dropped: int = 0
    """Bytes before it that were dropped, because they came faster than they could be processed."""
    tried: tuple[int, ...] = ()
    """Baud rates tried so far on a serial port, if they are searched."""


@dataclass(frozen=True, slots=True)
class Tick:
    """An instant between two items at which the journal writes its buffers if they are due."""

    host_ns: int
    """Host's monotonic clock, ns."""


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Readings of one stream, in the order in which the device sent them."""

    stream: Stream
    seq: IntArray
    """(n,) device's counter, unwrapped; -1 if the format has none."""
    device_s: FloatArray
    """(n,) device's clock, seconds, unwrapped; NaN if the format has none."""
    values: FloatArray
    """(n, width) float. Wrench: fx fy fz (N) mx my mz (N m), sensor frame. Skin: raw value of each channel, in the device's own
    unit; NaN: the device says that the channel is dead. Joints: radians. Tip: x y z, metres; further values are not used.
    Tool: the upper three rows of its 4 x 4 pose, metres; NaN for a reading that is no pose."""
    saturated: NDArray[np.bool_]
    """(n,) the device says that a wrench is beyond its range; such a reading is kept and never used."""
    invalid: NDArray[np.bool_]
    """(n,) the device says that a wrench is not valid; never used."""

    def rows(self, begin: int, end: int) -> Batch:
        """Return the readings from `begin` on and before `end`."""
        part = slice(begin, end)
        return Batch(
            self.stream, self.seq[part], self.device_s[part], self.values[part], self.saturated[part], self.invalid[part]
        )


@dataclass(frozen=True, slots=True, eq=False)
class ToolReading:
    """Pose of the tool, as used for a skin frame."""

    host_s: float
    """Host's clock at its reading, seconds."""
    base_from_tool: FloatArray
    """(4, 4) float, metres, in the fixed frame of the stream."""
    max_age_s: float
    """s. Several periods of the stream: the tool may have moved since an older pose."""
    delay_s: float = 0.0
    """s, delay of the stream that `host_s` is corrected for."""


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """One skin frame with the wrench of the same time."""

    host_s: float
    """Host's monotonic clock at the frame, seconds, by the device's mapped clock."""
    skin: FloatArray
    """(channels,) float, raw; NaN if the channel gave no usable number."""
    wrench: FloatArray
    """(6,) float, N and N m, mean over the frame's interval, sensor frame."""
    readings: int
    """Number of wrench readings in the mean."""
    saturated: bool
    """A wrench reading of the interval was saturated or invalid."""
    angles: FloatArray | None = None
    """(joints,) float, radians, last streamed joint angles; `None` without a joint stream."""
    tip: FloatArray | None = None
    """(3,) float, metres, last position of the tip in its fixed frame; `None` without a recent one."""
    angles_s: float = math.inf
    """Host's clock at the reading of `angles`, seconds."""
    angles_max_age_s: float = math.inf
    """s. Several periods of the joint stream: the arm may have moved since older angles."""
    tool: ToolReading | None = None
    """Last pose of the tool; `None` without a stream of its poses, or before its first."""

    @property
    def angles_age_s(self) -> float:
        """Age of the angles at the frame, seconds; never positive without angles."""
        return self.host_s - self.angles_s

    @property
    def has_late_angles(self) -> bool:
        """Whether the stream of the joints has paused, so that the arm may have moved since its last angles."""
        return self.host_s - self.angles_s > self.angles_max_age_s

    @property
    def has_late_tool(self) -> bool:
        """Whether the stream of the tool's poses has paused, so that the tool may have moved since its last pose."""
        return self.tool is not None and self.host_s - self.tool.host_s > self.tool.max_age_s


TEMPERATURE_NAME = "temperature, degC"


@dataclass(frozen=True, slots=True)
class SideReading:
    """Another quantity of a device, such as its temperature; its name includes the unit."""

    least: float
    most: float
    now: float

    def then(self, later: SideReading) -> SideReading:
        """Merge with later readings of the same quantity."""
        return SideReading(min(self.least, later.least), max(self.most, later.most), later.now)


LINK_SILENT_AFTER_S = 2.0
"""s without data after which a link is silent. Joints at 1 Hz are slow, not silent."""


def is_silent(last_s: float, now_s: float) -> bool:
    """Whether a link or a skin is silent at `now_s`; its newest data came at `last_s` of the same clock."""
    return now_s - last_s > LINK_SILENT_AFTER_S


class LinkAnswer(Enum):
    """Diagnosis of the data of a link."""

    LISTENING = "listening"
    GOOD = "good"
    NO_ANSWER = "no answer"
    NO_READING = "no reading"
    OTHER_STREAM = "another stream"
    OTHER_WIDTH = "another number of values"
    FROZEN = "frozen"


@dataclass(frozen=True, slots=True)
class LinkVerdict:
    """Diagnosis of a link in numbers and states; its words are in `skincal.words`."""

    answer: LinkAnswer
    stream: Stream | None = None
    """The expected stream that is missing or wrong; `None` if all are right."""
    found: Stream | None = None
    """Stream that arrives instead; `OTHER_STREAM` only."""
    width: int = 0
    """Number of values that arrive; `OTHER_STREAM` and `OTHER_WIDTH` only."""
    expected: int = 0
    """Number of values expected; `OTHER_WIDTH` only."""
    tried: tuple[int, ...] = ()
    """Baud rates tried, if they are searched."""
    line: str = ""
    """Last line that arrived, if it is clean text that gives no wanted reading; empty otherwise."""
    nearest: str = ""
    """Example of the form of lines that is read and is the nearest to `line`; `NO_READING` only."""
    unchanged: bool = False
    """A good skin has not changed a value yet, as thresholded skins do until something touches them."""


@dataclass(frozen=True, slots=True)
class Freeze:
    """Span of one repeated reading in a stream with noise: its sensor or program had stopped."""

    stream: Stream
    from_ns: int
    until_ns: int | None
    """Host's monotonic clock, nanoseconds; `None` if it lasts."""


MIXTURE_MIN_READINGS = 100
"""Wrenches that alternate, from which two series lie over each other."""


@dataclass(frozen=True, slots=True)
class Outages:
    """Breaks of a connection that gave readings before."""

    count: int = 0
    seconds: float = 0.0
    """Without readings, all together."""

    def plus(self, other: Outages) -> Outages:
        """Add the outages of another part of a session."""
        return Outages(self.count + other.count, self.seconds + other.seconds)


@dataclass(frozen=True, slots=True)
class LinkHealth:
    """State of a link, for the devices panel."""

    link: str
    state: LinkState
    text: str
    carries: tuple[Stream, ...]
    format: str
    """Name of the format found, such as `"SKB/1"`; empty while unknown."""
    readings: int
    """Good readings so far."""
    rate: float
    """Readings per second over the last seconds; 0 while unknown."""
    last_host_ns: int
    """Arrival of the last bytes; 0 before the first."""
    losses: Mapping[Loss, int] = field(default_factory=dict[Loss, int])
    """Counted losses by reason."""
    beside: Mapping[str, SideReading] = field(default_factory=dict[str, SideReading])
    """Other quantities of the device so far, by name and unit."""
    units: str = ""
    """Units of its readings; empty while unknown."""
    skin_unit: str = ""
    """Unit that the device names for the skin's values, such as `N`; empty for raw values."""
    frames: tuple[str, ...] = ()
    """Frames that its messages name for the wrench, in their order."""
    verdict: LinkVerdict = LinkVerdict(LinkAnswer.LISTENING)
    address: str = ""
    warning: str = ""
    """What is suspicious about good readings, such as a joint outside its limits; empty for nothing."""
    pose_delay: str = ""
    """Sentence on the delay of a tool's poses; empty while it is unknown, and for other streams."""
    freezes: tuple[Freeze, ...] = ()
    """In order of time, without short ones."""
    levels: tuple[float, ...] = ()
    """The two values that all channels of the skin ever had; empty if they had one, or more."""
    numberless: int = 0
    """Readings without usable numbers: wrenches and angles with NaN, skin frames of NaN alone."""

    sent_pose: SentPose | None = None
    """Numbers of the newest pose of the tool; `None` before the first."""
    mixed: int = 0
    """Wrenches that alternate between two series: two runs or two senders."""
    outages: Outages = Outages()

    @property
    def is_mixture(self) -> bool:
        """Whether two series lie over each other."""
        return self.mixed >= MIXTURE_MIN_READINGS

    @property
    def has_usable(self) -> bool:
        """Whether a reading came with usable numbers, of one series."""
        return self.readings > self.numberless and not self.is_mixture


def merge_side_readings(before: Mapping[str, SideReading], later: Mapping[str, SideReading]) -> dict[str, SideReading]:
    """Merge the other quantities of a device, earlier and later."""
    return {**before, **{name: before[name].then(found) if name in before else found for name, found in later.items()}}
