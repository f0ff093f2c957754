"""Shared parts of decoders: splitters that cut bytes into frames, clocks and counters that wrap, readings put into batches.

A decoder takes bytes and returns readings. It knows no port, no clock and no thread. How the bytes were cut never matters.
"""

from __future__ import annotations

import math
import struct
from abc import ABC, abstractmethod
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray
from skincal.model.readings import Batch, Loss, SideReading, Stream
from skincal.model.wrench_frames import WrenchFrames

if TYPE_CHECKING:
    from skincal.model.pose_form import PoseForm, SentPose

SEQ_MODULUS = 1 << 16
"""The counters of SKT/1 and SKB/1 have 16 bits."""
CLOCK_MODULUS_US = 1 << 32
"""A 32-bit clock of microseconds wraps every 71.6 minutes."""
US_PER_S = 1e6
NO_SEQ = -1
SEQ_MAX = 1 << 62
"""Largest counter that a batch can hold."""
TIME_STAMP_MAX_S = 5e9
"""s. Times of any clock are nearer to 0 (the year 2128); a larger one has a wrong digit."""
CRC_CCITT_INITIAL_VALUE = 0xFFFF
SATURATED_READING_FLAG = 1
INVALID_READING_FLAG = 2
WRENCH_VALUES, TOOL_VALUES = 6, 12
NO_POSE_FORM = (
    "The form of the tool's poses is not known: set rotation and unit in [tool] of the scene; `skincal tool` finds the form"
)
DEFAULT_UNITS = {
    Stream.WRENCH: "Fx Fy Fz in N, Mx My Mz in N m",
    Stream.SKIN: "raw values",
    Stream.JOINTS: "joint angles in degrees",
    Stream.TIP: "x y z of the tip in m",
    Stream.TOOL: "poses of the tool",
}
UNIT_NAME_MAX_CHARS = 20
"""Characters kept of a unit that a device names."""
PERIOD_NEWEST_WEIGHT = 1 / 16
"""Weight of the newest interval in the mean interval of a record: settles within some 16 records."""
SEQUENCE_GAP_TOLERANCE_STEPS = 2.0
SEQUENCE_GAP_TOLERANCE_SHARE = 0.25
"""A gap of s numbers fits a time of s intervals to within `SEQUENCE_GAP_TOLERANCE_STEPS + SEQUENCE_GAP_TOLERANCE_SHARE * s`:
devices keep no exact pace. If numbers and time do not fit, the device restarted, and nothing is known to be missing."""
_WIDTH_ADVICE = {
    Stream.SKIN: "if each value is one channel, set [skin] channels of the scene, or the board's n, to the same number",
    Stream.WRENCH: "a wrench is fx fy fz mx my mz",
    Stream.JOINTS: "the number of joints changed",
    Stream.TIP: "a tip is x y z",
    Stream.TOOL: "rotation in [tool] of the scene names the form of a pose",
}
PACKET_HEAD = struct.Struct("<BI")
"""Kind and length of the payload."""


# ------------------------------------------------------------------ clocks and counters


class DeviceTime:
    """Unwraps a 32-bit clock of microseconds, shared by all records of one device.

    A record may be stamped a little earlier than the one before it, because a skin frame is stamped when its scan begins. So
    the shorter of the two possible steps is used.
    """

    def __init__(self) -> None:
        self._raw: int | None = None
        self._total_us = 0

    def unwrap(self, raw_us: int) -> float:
        """Return the device's clock, seconds; NaN for a device without a clock, which always sends 0."""
        last = self._raw
        self._raw = raw_us
        if last is None:
            self._total_us = raw_us
            return raw_us / US_PER_S if raw_us else math.nan
        # A running clock passes 0 once in 71 minutes. Two zeros in a row mean that there is no clock.
        if raw_us == 0 and last == 0:
            return math.nan
        half = CLOCK_MODULUS_US // 2
        self._total_us += (raw_us - last + half) % CLOCK_MODULUS_US - half
        return self._total_us / US_PER_S

    def unwrap_many(self, raw_us: IntArray) -> FloatArray:
        """Return the device's clock (n,), seconds, at n > 0 successive records: `unwrap` of each."""
        last = raw_us[0] if self._raw is None else self._raw
        before = np.concatenate([[last], raw_us[:-1]])
        self._total_us = int(last) if self._raw is None else self._total_us
        half = CLOCK_MODULUS_US // 2
        totals = self._total_us + np.cumsum((raw_us - before + half) % CLOCK_MODULUS_US - half)
        self._raw, self._total_us = int(raw_us[-1]), int(totals[-1])
        return np.where((raw_us == 0) & (before == 0), math.nan, totals / US_PER_S)


class SequenceCounter:
    """Unwraps a 16-bit counter of one kind of record and counts missing numbers."""

    def __init__(self) -> None:
        self._raw = NO_SEQ
        self._total = 0
        self._device_s = math.nan
        self._period_s = math.nan

    def unwrap(self, raw: int, device_s: float) -> tuple[int, int]:
        """Return the unwrapped number and how many numbers are missing before it."""
        last, elapsed_s = self._raw, device_s - self._device_s
        self._raw, self._device_s = raw, device_s
        if last == NO_SEQ:
            self._total = raw
            return raw, 0
        step = (raw - last) % SEQ_MODULUS
        if step == 1:
            if elapsed_s > 0:
                known_s = elapsed_s if math.isnan(self._period_s) else self._period_s
                self._period_s = known_s + (elapsed_s - known_s) * PERIOD_NEWEST_WEIGHT
        # A counter that restarted looks like a great loss. If the elapsed time does not fit the numbers, nothing is known to be
        # missing, and the device may have another pace now.
        elif step > 1 and not self._fits(step, elapsed_s):
            self._period_s = math.nan
            step = 1
        self._total += step
        return self._total, max(step - 1, 0)

    def follows(self, raw: IntArray) -> bool:
        """Whether no number is missing before or among n > 0 successive numbers (n,)."""
        is_next = self._raw == NO_SEQ or (int(raw[0]) - self._raw) % SEQ_MODULUS == 1
        return is_next and bool(((raw[1:] - raw[:-1]) % SEQ_MODULUS == 1).all())

    def step_many(self, raw: IntArray, device_s: FloatArray) -> IntArray:
        """Return the unwrapped numbers (n,) of n > 0 records that follow (`follows`), as `step` of each does."""
        is_first = self._raw == NO_SEQ
        first = int(raw[0]) if is_first else self._total + 1
        elapsed = np.diff(device_s, prepend=math.nan if is_first else self._device_s)
        period = self._period_s
        for step_s in elapsed[elapsed > 0].tolist():  # NaN is not above 0
            known_s = step_s if math.isnan(period) else period
            period = known_s + (step_s - known_s) * PERIOD_NEWEST_WEIGHT
        self._period_s = period
        self._raw, self._device_s, self._total = int(raw[-1]), float(device_s[-1]), first + len(raw) - 1
        return np.arange(first, first + len(raw))

    def _fits(self, step: int, elapsed_s: float) -> bool:
        # Half the circle ahead is as near behind: the counter went back.
        if step >= SEQ_MODULUS // 2:
            return False
        if math.isnan(self._period_s) or math.isnan(elapsed_s):
            return True
        return abs(elapsed_s / self._period_s - step) <= SEQUENCE_GAP_TOLERANCE_STEPS + SEQUENCE_GAP_TOLERANCE_SHARE * step


class GapCounter:
    """Counts missing numbers of a sequence. Its usual step is not 1 if the sender publishes on several ports."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._step = 0
        self._usual = 0

    def missing_before(self, seq: int) -> int:
        """Count the numbers missing before `seq`. The usual step is the last one that came twice in a row."""
        step = 0 if self._last is None or seq < 0 else seq - self._last
        # A message without an envelope has the number -1; how many of them were lost is unknown.
        self._last = seq if seq >= 0 else None
        if step > 0 and step == self._step:
            self._usual = step
        self._step = step
        if self._usual and step > self._usual and step % self._usual == 0:
            return step // self._usual - 1
        return 0

    def is_continued_by(self, numbers: IntArray) -> bool:
        """Check whether `numbers` (n,) go on in the usual step. The question changes nothing."""
        step, last = self._usual, self._last
        if not step or step != self._step or last is None or (len(numbers) and int(numbers[0]) - last != step):
            return False
        return bool((numbers[1:] - numbers[:-1] == step).all())

    def missing_among(self, numbers: IntArray) -> int:
        """Count the numbers missing before and among `numbers` (n,)."""
        if self.is_continued_by(numbers):
            self._last = int(numbers[-1])
            return 0
        return sum(map(self.missing_before, numbers.tolist()))


# ------------------------------------------------------------------ splitters


class ProtocolError(ValueError):
    """Bytes break the protocol; the message is a sentence without the device's address."""


class FrameSplitter(ABC):
    """Cuts bytes into frames. How the bytes were cut on the way makes no difference."""

    fault: str = ""
    """What breaks the protocol, a sentence; then nothing more is a frame. Empty while nothing does."""
    _rest: bytes = b""
    """Bytes of an unfinished frame."""
    _lost: bool = False
    """Whether the last bytes were no frame: a run of them counts once."""

    @abstractmethod
    def split(self, data: bytes) -> list[bytes | None]:
        """Return the frames that `data` completes; `None` stands for a run of bytes that is no frame."""


class MarkSplitter(FrameSplitter):
    """Cuts bytes at `mark`, which no frame keeps. A frame longer than `limit` bytes is `None`."""

    def __init__(self, mark: bytes, limit: int) -> None:
        self._mark = mark
        self._limit = limit

    @property
    def has_partial_frame(self) -> bool:
        """Whether bytes of an unfinished frame are kept or skipped."""
        return bool(self._rest) or self._lost

    def split(self, data: bytes) -> list[bytes | None]:
        cut = (self._rest + data).split(self._mark)
        self._rest = cut.pop()
        # The rest of a frame that was counted as too long when it was dropped.
        if cut and self._lost:
            del cut[0]
            self._lost = False
        frames: list[bytes | None] = [frame if len(frame) <= self._limit else None for frame in cut]
        if len(self._rest) > self._limit:
            self._rest = b""
            if not self._lost:
                frames.append(None)
            self._lost = True
        return frames


class LengthSplitter(FrameSplitter):
    """Cuts bytes into frames whose header has their length. After bytes that break the protocol there are no more frames.

    `next_frame` returns the frame that begins at a place of a buffer and the place of its end, or `None` while it is
    incomplete. It raises ProtocolError.
    """

    def __init__(self, next_frame: Callable[[bytes, int], tuple[bytes, int] | None]) -> None:
        self._next_frame = next_frame

    @property
    def has_partial_frame(self) -> bool:
        """Whether bytes of an unfinished frame are kept, or nothing more is a frame."""
        return bool(self._rest or self.fault)

    def split(self, data: bytes) -> list[bytes | None]:
        frames: list[bytes | None] = []
        if self.fault:
            return frames
        rest, at = self._rest + data, 0
        try:
            while (found := self._next_frame(rest, at)) is not None:
                frame, at = found
                frames.append(frame)
            self._rest = rest[at:]
        except ProtocolError as error:
            self.fault, self._rest = str(error), b""
            frames.append(None)
        return frames


def pack(kind: int, payload: bytes) -> bytes:
    """Return a message with its kind (0 to 255) and length.

    UDP and websockets keep messages apart. The journal keeps bytes alone, so the message boundaries are written into them.
    """
    return PACKET_HEAD.pack(kind, len(payload)) + payload


def pack_all(kind: int, payloads: Sequence[bytes]) -> bytes:
    """Return messages one after another, each as `pack` makes it."""
    if len({len(payload) for payload in payloads}) != 1:
        return b"".join(pack(kind, payload) for payload in payloads)
    # Those of a sensor have one length, so one head.
    head = PACKET_HEAD.pack(kind, len(payloads[0]))
    return head + head.join(payloads)


def packet_splitter(limit: int) -> LengthSplitter:
    """Return a splitter for messages made by `pack`, at most `limit` bytes; a frame is the kind and the payload."""

    def next_packet(data: bytes, at: int) -> tuple[bytes, int] | None:
        if len(data) - at < PACKET_HEAD.size:
            return None
        kind, length = PACKET_HEAD.unpack_from(data, at)
        if length > limit:
            raise ProtocolError(f"it announces a packet of {length} bytes; at most {limit} are taken")
        begin = at + PACKET_HEAD.size
        return (bytes([kind]) + data[begin : begin + length], begin + length) if len(data) >= begin + length else None

    return LengthSplitter(next_packet)


class HeadSplitter(FrameSplitter):
    """Searches for frames that begin with `head`. A run of other bytes is one `None`.

    After bytes that are no frame the search goes on at the next byte, since a head may also stand inside a frame.

    Parameters
    ----------
    bytes_min : shortest frame
    frame_end : returns the end of the frame that begins at a place of a buffer, 0 if none does, `None` if more bytes are needed
    between : ignored bytes that the device may send between two frames; shorter than a frame
    """

    def __init__(
        self, head: bytes, bytes_min: int, frame_end: Callable[[bytes, int], int | None], between: bytes = b""
    ) -> None:
        self._head, self._bytes_min, self._frame_end, self._between = head, bytes_min, frame_end, between

    def split(self, data: bytes) -> list[bytes | None]:
        frames: list[bytes | None] = []
        rest, at = self._rest + data, 0
        while len(rest) - at >= self._bytes_min:
            end = self._frame_end(rest, at) if rest.startswith(self._head, at) else 0
            if end is None:
                break
            if end:
                frames.append(rest[at:end])
                at, self._lost = end, False
            elif self._between and not self._lost and rest.startswith(self._between, at):
                at += len(self._between)
            else:
                if not self._lost:
                    frames.append(None)
                self._lost = True
                found = rest.find(self._head, at + 1)
                at = found if found >= 0 else max(len(rest) - len(self._head) + 1, at + 1)
        self._rest = rest[at:]
        return frames


# ------------------------------------------------------------------ decoders


class FrameDecoder(ABC):
    """Decodes frames into batches of readings, for the streams that a link carries.

    Readings of other streams are dropped without a count.
    """

    name: ClassVar[str] = ""
    mark: ClassVar[bytes]
    """End of a frame, unless `_make_splitter` is overridden."""
    limit: ClassVar[int]
    """Bytes. A longer frame is dropped whole."""
    loss_of_garbage: ClassVar[Loss] = Loss.UNREADABLE
    """Loss that is counted for bytes that are no frame."""
    starts_whole: ClassVar[bool] = False
    """Whether a connection begins with a whole frame. Else the first frame is not counted as lost if it cannot be read."""
    single_stream: ClassVar[bool] = False
    """Whether a file of this format carries one stream only."""
    names_frames: ClassVar[bool] = False
    """Whether its records may name the frame of a wrench; then it converts wrenches itself, each from its own frame."""
    defined_pose: ClassVar[PoseForm | None] = None
    """Form of a tool's pose, in metres, if the format defines it; else the scene must."""
    needs_recipe: ClassVar[bool] = False
    """Whether a frame does not say which streams it holds: only a decoder of the requested streams can read it."""

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        self.counts: Counter[Loss] = Counter()
        self.valid_records: int = 0
        """Records that are surely of this format."""
        self._problem = ""
        """What was last wrong with the device's records, a sentence; empty if nothing was."""
        self._status = ""
        """What the device reports of itself now, a sentence; empty if nothing."""
        self._carries = carries
        widths = {Stream.SKIN: channels, Stream.WRENCH: WRENCH_VALUES, Stream.JOINTS: None, Stream.TIP: None, Stream.TOOL: None}
        self._widths = {stream: widths[stream] for stream in Stream if stream in carries}
        # Readings of each stream since the last batch: number, device's clock, values, status.
        self._readings: dict[Stream, list[tuple[int, float, list[float] | NDArray[Any], int]]] = defaultdict(list)
        self._splitter = self._make_splitter()
        self._gaps = GapCounter()
        self._first = not self.starts_whole
        self.joint_names: tuple[str, ...] = ()
        """Names of the scene's columns of joint angles; empty if it has none. For formats that name their joints."""
        self.wrench_frames = WrenchFrames()
        """Frames of the wrenches; of the link, so that they stay when it is opened again."""
        self._pose_form: tuple[PoseForm, float] | None = None
        """Form of the numbers of a tool's pose, and metres per unit of its lengths; `None` while unknown."""
        self._has_far_pose = False
        """A pose of the tool lay away from the origin, as it does unless the unit of the lengths is wrong."""
        self.sent_pose: SentPose | None = None
        """Numbers of the newest pose of the tool; `None` before the first."""
        if self.defined_pose is not None:
            self.set_pose_form(self.defined_pose, 1.0)
        self.units = dict(DEFAULT_UNITS)
        """Names and unit of the values of a reading."""
        self.skin_unit = ""
        """Unit of the skin's values if the device names one, such as `N`; empty for raw values."""
        self.side_readings: dict[str, SideReading] = {}
        """Other quantities that the device measures, such as its temperature, by name and unit."""

    def _make_splitter(self) -> FrameSplitter:
        return MarkSplitter(self.mark, self.limit)

    def define_pose_form(self, form: PoseForm, metres_per_unit: float) -> None:
        """Use the form of a tool's poses that the records themselves define, in place of the scene's."""
        self._pose_form = form, metres_per_unit
        self._widths[Stream.TOOL] = form.rotation.width

    def set_pose_form(self, form: PoseForm, metres_per_unit: float) -> None:
        """Use the form of a tool's poses that the scene names, unless the format defines one."""
        if Stream.TOOL in self._widths and self._pose_form is None:
            self._pose_form = form, metres_per_unit
            self._widths[Stream.TOOL] = form.rotation.width

    @property
    def device_message(self) -> str:
        """Last fault or report of the device, as a sentence; empty if there is none."""
        fault = self._splitter.fault
        return f"{fault[:1].upper()}{fault[1:]}" or self._status or self._problem

    def report_problem(self, sentence: str) -> None:
        """Keep a sentence on wrong readings for the operator."""
        self._problem = sentence

    def feed(self, data: bytes) -> list[Batch]:
        """Decode the next bytes of the link; return the completed readings, one batch a stream."""
        self._decode_frames(self._splitter.split(data))
        return [self._batch_of(stream, self._readings.pop(stream)) for stream in self._widths if stream in self._readings]

    def _decode_frames(self, frames: Sequence[bytes | None]) -> None:
        """Decode frames, and count those that cannot be used."""
        for frame in frames:
            problem = self.loss_of_garbage if frame is None else self._decode(frame)
            if problem is not None and not self._first:
                self.counts[problem] += 1
            self._first = False

    def feed_many(self, chunks: Sequence[bytes]) -> tuple[Batch, list[int]] | None:  # noqa: ARG002 - text decoders use it
        """Decode several chunks at once. Return one batch and the end of each chunk's readings, or `None` if not possible."""
        return None

    @abstractmethod
    def _decode(self, frame: bytes) -> Loss | None:
        """Add the readings of a frame; return why it cannot be used, or `None`."""

    def _width(self, stream: Stream) -> int | None:
        """Return the number of values of a reading; `None` while it is unknown, and for a stream that is not carried."""
        return self._widths.get(stream)

    def _has_width(self, stream: Stream, width: int) -> bool:
        """Check the width of a reading of a carried stream. An unknown width fits everything."""
        return self._widths[stream] in (None, width)

    def _count_missing(self, missing: int) -> None:
        if missing:
            self.counts[Loss.MISSING] += missing

    def _add(
        self, stream: Stream, seq: int, device_s: float, values: list[float] | NDArray[Any], status: int = 0
    ) -> Loss | None:
        """Add one reading; return what is wrong with its width. The first reading fixes an unknown width.

        Parameters
        ----------
        seq : unwrapped number, or `NO_SEQ`
        device_s : device's clock, seconds, or NaN
        values : one reading, in the units of `skincal.model.readings`, but joint angles in degrees
        status : `SATURATED_READING_FLAG` and `INVALID_READING_FLAG`; other bits are ignored
        """
        if stream not in self._widths:
            return None
        if not self._has_width(stream, len(values)):
            expected, advice = self._widths[stream], _WIDTH_ADVICE[stream]
            self._problem = f"{stream.value} readings of {len(values)} values arrive where {expected} are expected; {advice}"
            return Loss.BAD_WIDTH
        self._widths[stream] = len(values)
        self._readings[stream].append((seq, device_s, values, status & (SATURATED_READING_FLAG | INVALID_READING_FLAG)))
        return None

    def _batch_of(self, stream: Stream, readings: list[tuple[int, float, list[float] | NDArray[Any], int]]) -> Batch:
        numbers, clocks, rows, status = zip(*readings, strict=True)
        seq, device_s, values = np.array(numbers, np.int64), np.array(clocks, np.float64), np.array(rows, np.float64)
        return self._batch(stream, seq, device_s, values, np.array(status))

    def _batch(
        self, stream: Stream, seq: IntArray, device_s: FloatArray, values: FloatArray, status: IntArray | None = None
    ) -> Batch:
        """Return n readings, their values (n, width), as a batch; count values that are not finite. For the rest see `_add`."""
        if stream is Stream.WRENCH and not self.names_frames:
            known = self.wrench_frames.to_sensor("", values)
            values = values if known is None else known
        finite = np.isfinite(values)
        if not finite.all():
            self.counts[Loss.NOT_A_NUMBER] += int(np.count_nonzero(~finite.all(axis=1)))
            values = np.where(finite, values, np.nan) if stream is Stream.SKIN else values
        if stream is Stream.JOINTS:
            values = np.radians(values)  # every format has degrees
        if stream is Stream.TOOL:
            values = self._read_tool_poses(values)
        bits = np.zeros(len(seq), np.int64) if status is None or stream is not Stream.WRENCH else status
        saturated, invalid = (bits & SATURATED_READING_FLAG) != 0, (bits & INVALID_READING_FLAG) != 0
        for loss, flags in ((Loss.SATURATED, saturated), (Loss.INVALID, invalid)):
            if flags.any():
                self.counts[loss] += int(np.count_nonzero(flags))
        return Batch(stream, seq, device_s, values, saturated, invalid)

    def _read_tool_poses(self, values: FloatArray) -> FloatArray:
        """Convert poses (n, width) as sent to the upper rows of 4 x 4 poses, (n, 12), metres; NaN for one that is none."""
        from skincal.model.pose_form import SentPose
        from skincal.model.tool_pose import MIN_LENGTH_M, PoseFault, convert_poses

        if self._pose_form is None:
            self._problem = NO_POSE_FORM
            self.counts[Loss.NO_POSE] += len(values)
            return np.full((len(values), TOOL_VALUES), np.nan)
        if len(values):
            self.sent_pose = SentPose(tuple(values[-1].tolist()), *self._pose_form)
        poses, faults = convert_poses(values, *self._pose_form)
        for row in range(len(poses)):
            # Metres that are read as millimetres make every pose one near the origin.
            if faults[row] is None and not self._has_far_pose:
                self._has_far_pose = bool(np.abs(poses[row, :3, 3]).max() >= MIN_LENGTH_M)
                if not self._has_far_pose:
                    poses[row], faults[row] = np.nan, PoseFault.TOO_NEAR
        found = [fault for fault in faults if fault is not None]
        # Numbers that are not finite are counted already.
        lost = [fault for fault in found if fault is not PoseFault.NOT_FINITE]
        if lost:
            self.counts[Loss.NO_POSE] += len(lost)
            self._problem = f"A pose of the tool {lost[-1].value.format(found=values.shape[1], expected='', form='')}"
        return poses[:, :3].reshape(-1, TOOL_VALUES)

    def _wrenches_from(self, frame: str, wrenches: FloatArray) -> FloatArray | None:
        """Convert wrenches (n, 6) of a named frame into the sensor's; if that is not possible, count them and return `None`."""
        known = self.wrench_frames.to_sensor(frame, wrenches)
        if known is None:
            self.counts[Loss.OTHER_FRAME] += len(wrenches)
        names = self.wrench_frames.names
        self.units[Stream.WRENCH] = DEFAULT_UNITS[Stream.WRENCH] + (f", in the frame {' and '.join(names)}" if names else "")
        return known

    def _count_gap(self, seq: int) -> None:
        """Count the numbers that are missing before the device's own number of a record."""
        self._count_missing(self._gaps.missing_before(seq))

    def _add_side_reading(self, name: str, value: float) -> None:
        new = SideReading(value, value, value)
        self.side_readings[name] = self.side_readings[name].then(new) if name in self.side_readings else new

    def _read_header(self, text: str) -> None:
        """Read a board's header, `key=value,...`: compare its width with the scene's, keep the unit of its skin."""
        header = _header_fields(text)
        n, channels, kind = header.get("n", ""), self._widths.get(Stream.SKIN), header.get("kind")
        # A header that agrees does not clear another problem.
        if channels is not None and n.isdigit() and int(n) != channels and kind != "ft":
            board = f"The board {header.get('board', '')}".rstrip()
            self._problem = (
                f"{board} says that it sends n={n} taxels where {channels} are expected; {_WIDTH_ADVICE[Stream.SKIN]}"
            )
        if unit := unit_of_header(text):
            self.units[Stream.SKIN], self.skin_unit = f"values in {unit}", unit


def _header_fields(text: str) -> dict[str, str]:
    pairs = (field.partition("=") for field in text.split(","))
    return {key.strip(): value.strip() for key, equals, value in pairs if equals}


def unit_of_header(text: str) -> str:
    """Read the unit of the skin from a board's header; empty for raw values and other boards."""
    header = _header_fields(text)
    unit = header.get("unit", "raw")[:UNIT_NAME_MAX_CHARS]
    return unit if header.get("kind") == "taxel" and unit != "raw" else ""
