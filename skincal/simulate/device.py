"""The rig's devices as bytes on a time line.

`DeviceTimeline` is the shared core: block after block it asks the operator, computes what each device reads, encodes it,
and lets each link delay, hold back, lose and damage the bytes. It knows no clock but its own, so it runs in real time
(`serve`) and as fast as it goes (`virtual_session`) with the same bytes. Readings become bytes as makers' boards send them:
SKB/1, SKT/1 and, for skins too wide for either, delimited text. The formats are those of `skincal.streams.decoders`; nothing is
shared with the decoders, so each checks the other.
"""

from __future__ import annotations

import binascii
import heapq
import struct
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.model.readings import Stream
from skincal.simulate.operator import HandPress, Move, Operator, OperatorAction
from skincal.simulate.rig_errors import RigErrors, WrenchNoise
from skincal.simulate.simulated_rig import Rig, SimulatedArmPose

if TYPE_CHECKING:
    from skincal.simulate.emulated_devices import Maker, MakerEncoder

MICROSECONDS = 1_000_000
NANOSECONDS = 1_000_000_000
CLOCK_WRAP_S = 2**32 / MICROSECONDS
"""s, after which a device's clock starts again."""

TAIL_S = 0.5
"""s that a finite time line goes on after the last action: the quiet for the tare after it (0.2 s) and the slowest link's
latency."""


@dataclass(frozen=True, slots=True)
class DeviceSettings:
    """How the devices speak."""

    format: str = "skb"
    """"skb", "skt" or "text"."""
    speakers: Mapping[Stream, str] = field(default_factory=dict[Stream, str])
    """Makers' devices that send a stream instead, by their names in `makers.MAKERS`."""
    wrench_hz: float = 1000.0
    """Hz. The rate that the program must bear; Bota's sensors reach 1004 Hz."""
    skin_hz: float = 50.0
    """Hz. The paper's taxels (section III-B)."""
    joints_hz: float = 100.0
    """Hz. The iCub's controllers."""
    flicker: float = 0.0
    """N m, by which the last moment comes and goes: the last digit of a sensor without noise."""
    block_s: float = 0.010
    """s. Readings computed and sent together: a USB poll's worth."""
    header_s: float = 2.0
    """s. A board says what it is at its start and this often (SKT/1)."""
    start_quiet_s: float = 1.0
    """s before the operator sets out."""


class Clock:
    """A device's clock: somewhere in its range at the start, and a little fast or slow."""

    def __init__(self, errors: RigErrors, rng: np.random.Generator) -> None:
        self._start = rng.uniform(1.0, CLOCK_WRAP_S)
        self._rate = 1.0 + errors.clock_skew * rng.standard_normal()

    def us(self, times: FloatArray) -> IntArray:
        """Return (n,) microseconds of the device's clock, wrapped, at true times in seconds."""
        total = np.round((self._start + self._rate * times) * MICROSECONDS).astype(np.int64)
        return total % 2**32


class LossyLink:
    """The way from a device to the host: delays bytes by `latency`, s, and more, holds back, loses and damages them."""

    def __init__(self, latency: float, errors: RigErrors, rng: np.random.Generator) -> None:
        self._latency, self._errors, self._rng = latency, errors, rng
        self._last = 0.0
        self._held_until = 0.0

    def send(self, data: bytes, now: float, seconds: float) -> tuple[float, bytes]:
        """Return when a block of so many seconds, sent at `now`, arrives, and what arrives."""
        errors, rng = self._errors, self._rng
        if rng.uniform() < errors.burst_rate * seconds:
            self._held_until = now + errors.burst_s
        delay = self._latency + (rng.exponential(errors.jitter) if errors.jitter else 0.0)
        # A link keeps its bytes in order, so none overtakes a slower one before it.
        self._last = max(self._last, now + delay, self._held_until)
        return self._last, self._damage(data)

    def _damage(self, data: bytes) -> bytes:
        flips = self._rng.binomial(len(data), self._errors.corrupted)
        losses = self._rng.binomial(len(data), self._errors.dropped)
        if not flips and not losses:
            return data
        raw = np.frombuffer(data, dtype=np.uint8).copy()
        places = self._rng.integers(0, len(raw), flips)
        raw[places] ^= np.left_shift(1, self._rng.integers(0, 8, flips)).astype(np.uint8)
        return np.delete(raw, self._rng.integers(0, len(raw), losses)).tobytes()


@dataclass(slots=True)
class SimulatedDevice:
    """One device: its link, clock, encoder, way to the host and pace."""

    link: str
    stream: Stream
    hz: float
    clock: Clock
    encoder: Encoder
    line: LossyLink
    header: str
    width: int
    made: int = 0
    """Readings made so far."""
    next_header: float = 0.0

    def greeting(self, now: float) -> bytes:
        """Return the header that it sends at `now`, seconds."""
        return self.encoder.header(int(self.clock.us(np.array([now]))[0]), self.header, self.width)

    def due(self, end: float) -> FloatArray:
        """Return (n,) the times of the readings that fall before `end`, and count them as made."""
        # Counted from the start, not from the last block: so the times of readings do not depend on how blocks are cut.
        # The 1e-9 keeps a product that rounding made too large from being one reading more.
        until = int(np.ceil(end * self.hz - 1e-9))
        times = np.arange(self.made, until) / self.hz
        self.made = max(self.made, until)
        return times


class DeviceTimeline:
    """Runs rig, operator and devices along one time line; where the scene has an arm, its joints are a link, too."""

    def __init__(self, rig: Rig, operator: Operator, rng: np.random.Generator, settings: DeviceSettings | None = None) -> None:
        # Streams of their own: a sensor that draws more changes nothing of the others.
        noise, boards, self._skin_rng = rng.spawn(3)
        self.rig, self.operator, self.settings = rig, operator, settings or DeviceSettings()
        self.now = 0.0
        """s, end of what is computed."""
        self.arm_pose = rig.arm_pose()
        self._noise = WrenchNoise(rig.errors, noise)
        self._boards = _boards(rig, self.settings, boards)
        self._actions: list[OperatorAction] = []
        self._free = self.settings.start_quiet_s
        self._from = self.arm_pose
        self._arrivals: list[tuple[int, int, str, bytes]] = []
        self._sent = 0
        self._blocks = 0

    @property
    def links(self) -> dict[str, Stream]:
        """Name of each link to what it carries."""
        return {board.link: board.stream for board in self._boards}

    @property
    def finished(self) -> bool:
        """The operator is done, and the quiet after the last poke has arrived."""
        return self.operator.done and self.now >= self._free + TAIL_S

    def greeting(self, link: str) -> bytes:
        """Return the header that a board sends when somebody opens its port or asks for it."""
        return next(board for board in self._boards if board.link == link).greeting(self.now)

    def step(self) -> list[tuple[int, str, bytes]]:
        """Compute one block; return what arrives in it as (virtual nanoseconds, link, bytes), in that order."""
        begin, end = self.now, (self._blocks + 1) * self.settings.block_s
        self._schedule(end)
        for board in self._boards:
            data = self._bytes(board, begin, end)
            if data:
                at, data = board.line.send(data, end, end - begin)
                # The count stands before the bytes: of two that arrive at once the one that was sent first comes first.
                heapq.heappush(self._arrivals, (round(at * NANOSECONDS), self._sent, board.link, data))
                self._sent += 1
        self._blocks += 1
        self.now = end
        arrived: list[tuple[int, str, bytes]] = []
        while self._arrivals and self._arrivals[0][0] <= round(end * NANOSECONDS):
            at_ns, _, link, data = heapq.heappop(self._arrivals)
            arrived.append((at_ns, link, data))
        return arrived

    def _schedule(self, end: float) -> None:
        """Ask the operator for what begins in this block, and forget what is over."""
        if not self.operator.done:
            # An operator who had nothing to do is asked about now, not about the time that passed.
            self._free = max(self._free, self.now)
        while self._free < end:
            action = self.operator.next(self._free)
            if action is None:
                break
            self._free = action.free
            self._actions.append(action)
        for action in self._actions:
            if isinstance(action, Move) and action.free <= self.now:
                self._from = self.arm_pose = action.arm_pose
        self._actions = [action for action in self._actions if action.free > self.now]

    def _bytes(self, board: SimulatedDevice, begin: float, end: float) -> bytes:
        data = b""
        if begin >= board.next_header:
            data = board.greeting(begin)
            board.next_header += self.settings.header_s
        times = board.due(end)
        if board.stream is Stream.WRENCH:
            stamps = board.clock.us(times)
            # Also in a block without a reading: the sensor's noise goes on from block to block.
            return data + board.encoder.wrenches(stamps, self._wrenches(times, begin, end))
        if not len(times):
            return data
        stamps = board.clock.us(times).tolist()
        if board.stream is Stream.SKIN:
            frames = self._skin(times)
            return data + b"".join(board.encoder.skin(t, v) for t, v in zip(stamps, frames, strict=True))
        angles = np.degrees(self._joints(times))
        return data + b"".join(board.encoder.joints(t, v) for t, v in zip(stamps, angles, strict=True))

    def _wrenches(self, times: FloatArray, begin: float, end: float) -> FloatArray:
        """Return (n, 6) what the force/torque device sends, with the sign of the scene's sensor."""
        rig = self.rig
        total = self._weight(times)
        for action in self._actions:
            if isinstance(action, HandPress) and action.begin < end and action.end > begin:
                total += self._press_wrench(action, times)
        read = rig.read_wrenches(total) + rig.offset + self._noise.block(times, begin, end)
        read[:, 5] += self.settings.flicker * np.sin(1000.0 * times)
        return rig.scene.wrench_sign * read

    def _press_wrench(self, press: HandPress, times: FloatArray) -> FloatArray:
        load, travel = press.load(times)[:, None], press.travel(times)
        total = np.zeros((len(times), 6))
        for point, direction, force in zip(press.pokes.points, press.pokes.directions, press.pokes.forces, strict=True):
            total += self.rig.true_wrenches(point + travel, load * force * direction, self.arm_pose)
        return total

    def _skin(self, times: FloatArray) -> FloatArray:
        """Return (n, width) raw frames; the foam answers to the load of a moment ago."""
        felt = times - self.rig.foam.lag
        answers = np.zeros((len(times), len(self.rig.channels)))
        for action in self._actions:
            if not isinstance(action, HandPress) or action.begin > times[-1]:
                continue
            loads, travel = action.load(felt), action.travel(felt)
            for i in np.flatnonzero(loads > 0):
                slid = replace(action.pokes, points=action.pokes.points + travel[i])
                rows, values = self.rig.answers(slid, loads[i] * action.pokes.forces)
                np.add.at(answers[i], rows.ravel(), values.ravel())
        return self.rig.skin_frame(answers, self._skin_rng)

    def _share_moved(self, times: FloatArray) -> tuple[FloatArray, SimulatedArmPose]:
        """Return (n,) how far the arm is on its way, 0 to 1, and where to."""
        move = next((action for action in self._actions if isinstance(action, Move)), None)
        if move is None:
            return np.zeros(len(times)), self.arm_pose
        share = np.clip((times - move.begin) / (move.free - move.begin), 0.0, 1.0)
        return 0.5 - 0.5 * np.cos(np.pi * share), move.arm_pose

    def _weight(self, times: FloatArray) -> FloatArray:
        share, target = self._share_moved(times)
        return self._from.weight + share[:, None] * (target.weight - self._from.weight)

    def _joints(self, times: FloatArray) -> FloatArray:
        """Return (n, columns) joint angles as reported, radians; joints that are no part of the chain are 0."""
        arm = self.rig.scene.arm
        if arm is None:
            return np.zeros((len(times), 0))
        share, target = self._share_moved(times)
        angles = np.zeros((len(times), max(arm.arm.joints) + 1))
        angles[:, arm.arm.joints] = self._from.angles + share[:, None] * (target.angles - self._from.angles)
        return angles


def _boards(rig: Rig, settings: DeviceSettings, rng: np.random.Generator) -> list[SimulatedDevice]:
    errors, top, skin, arm = rig.errors, rig.range[1], rig.scene.skin, rig.scene.arm
    about_skin = (
        f"board={rig.scene.name},n={skin.channels},rate={settings.skin_hz:g},unit=raw,bits={int(np.ceil(np.log2(top + 1)))},"
        f"kind=taxel,polarity={'up' if rig.polarity > 0 else 'down'},fw=1"
    )
    about_ft = f"board=ft,rate={settings.wrench_hz:g},unit=N,kind=ft,fw=1"
    about_arm = f"board=arm,rate={settings.joints_hz:g},unit=deg,kind=joints,fw=1"
    wanted = [
        (Stream.WRENCH, settings.wrench_hz, errors.wrench_latency, 6, about_ft),
        (Stream.SKIN, settings.skin_hz, errors.skin_latency, skin.channels, about_skin),
    ]
    if arm is not None:
        wanted.append((Stream.JOINTS, settings.joints_hz, errors.skin_latency, max(arm.arm.joints) + 1, about_arm))
    boards: list[SimulatedDevice] = []
    # Three streams also without an arm, so that no board draws otherwise because of it.
    for (stream, hz, latency, width, about), own in zip(wanted, rng.spawn(3), strict=False):
        clock = Clock(errors, own)
        encoder: Encoder
        if stream in settings.speakers:
            maker = _maker(settings.speakers[stream])
            # TCP damages nothing, and UDP nothing that is still taken.
            damaging = errors if maker.serial else replace(errors, corrupted=0.0, dropped=0.0)
            encoder, line, pace = maker.encoder(), LossyLink(latency, damaging, own), maker.hz or hz
        else:
            encoder, line, pace = (
                make_encoder(settings.format, top, width if stream is Stream.SKIN else 0),
                LossyLink(latency, errors, own),
                hz,
            )
        boards.append(SimulatedDevice(stream.value, stream, pace, clock, encoder, line, about, width))
    return boards


def _maker(name: str) -> Maker:
    from skincal.simulate.emulated_devices import MAKERS

    return MAKERS[name]


CRC_START = 0xFFFF
COBS_RUN = 254
"""Most bytes other than 0 in one block of COBS."""
SKB_BODY_MAX = 1024
SKB_HEAD = struct.Struct("<BBHI")
WRENCH_TYPE, JOINTS_TYPE, HEADER_TYPE = 2, 5, 16
SKIN_TYPES = {"u16": (1, "<u2"), "u8": (3, "u1"), "f32": (4, "<f4")}
SKT_LINE_MAX = 4096


def cobs(data: bytes) -> bytes:
    """Return `data` without zero bytes (consistent overhead byte stuffing), without the closing 0."""
    out = bytearray()
    pieces = data.split(b"\x00")
    for index, piece in enumerate(pieces):
        rest = piece
        while len(rest) >= COBS_RUN:
            out.append(0xFF)
            out += rest[:COBS_RUN]
            rest = rest[COBS_RUN:]
            # A full run at the very end: no block stands for the zero that does not follow.
            if not rest and index == len(pieces) - 1:
                return bytes(out)
        out.append(len(rest) + 1)
        out += rest
    return bytes(out)


class SkbEncoder:
    """Makes one board's bytes in SKB/1, skin values as "u8", "u16" or "f32", and counts its records."""

    def __init__(self, values: str = "u8") -> None:
        self._skin_type, self._dtype = SKIN_TYPES[values]
        self._count = {WRENCH_TYPE: 0, JOINTS_TYPE: 0, HEADER_TYPE: 0, self._skin_type: 0}

    def header(self, t_us: int, fields: str, width: int) -> bytes:
        """Return what a board says of itself: `key=value,...`, and how many values a reading has."""
        del width
        return self._frame(HEADER_TYPE, t_us, fields.encode())

    def wrenches(self, t_us: IntArray, wrenches: FloatArray) -> bytes:
        """Return (n, 6) wrenches, N and N m, stamped (n,) microseconds; status 0."""
        # The seventh is the status, an integer: 0 has the same bytes as a float.
        payloads = np.zeros((len(wrenches), 7), dtype="<f4")
        payloads[:, :6] = wrenches
        raw = payloads.tobytes()
        return b"".join(self._frame(WRENCH_TYPE, t, raw[28 * i : 28 * i + 28]) for i, t in enumerate(t_us.tolist()))

    def skin(self, t_us: int, values: FloatArray) -> bytes:
        """Return one frame of (width,) raw values."""
        return self._frame(self._skin_type, t_us, values.astype(self._dtype).tobytes())

    def joints(self, t_us: int, degrees: FloatArray) -> bytes:
        """Return (joints,) angles, degrees."""
        return self._frame(JOINTS_TYPE, t_us, degrees.astype("<f4").tobytes())

    def _frame(self, kind: int, t_us: int, payload: bytes) -> bytes:
        seq = self._count[kind]
        # Python adds before it masks.
        self._count[kind] = seq + 1 & 0xFFFF
        body = SKB_HEAD.pack(kind, 0, seq, t_us & 0xFFFFFFFF) + payload
        return cobs(body + binascii.crc_hqx(body, CRC_START).to_bytes(2, "little")) + b"\x00"


class TextEncoder:
    """The same in comma-separated lines without a checksum, each with its number and clock; the header names the columns."""

    WRENCH = "%.6f,%.6f,%.6f,%.6f,%.6f,%.6f"

    def __init__(self, values: str = "u8") -> None:
        self._skin = "%.6g" if values == "f32" else "%d"
        self._count = Counter[str]()

    def header(self, t_us: int, fields: str, width: int) -> bytes:
        """Return the line that names the columns."""
        del t_us, fields
        return ("seq,t_us," + ",".join(f"c{i}" for i in range(width)) + "\n").encode()

    def wrenches(self, t_us: IntArray, wrenches: FloatArray) -> bytes:
        """Return (n, 6) wrenches, to 0.1 mN and 1 uN m or finer."""
        rows = zip(t_us.tolist(), wrenches.tolist(), strict=True)
        return b"".join(self._record("F", t, self.WRENCH % tuple(wrench)) for t, wrench in rows)

    def skin(self, t_us: int, values: FloatArray) -> bytes:
        """Return one skin frame."""
        return self._record("T", t_us, ",".join(self._skin % value for value in values.tolist()))

    def joints(self, t_us: int, degrees: FloatArray) -> bytes:
        """Return one set of joint angles, to 0.0001 degrees."""
        return self._record("J", t_us, ",".join(f"{v:.4f}" for v in degrees.tolist()))

    def _record(self, letter: str, t_us: int, values: str) -> bytes:
        seq = self._count[letter]
        self._count[letter] += 1
        return self._line(letter, seq, f"{t_us & 0xFFFFFFFF},{values}")

    def _line(self, letter: str, seq: int, rest: str) -> bytes:  # noqa: ARG002 - for SKT/1
        return f"{seq},{rest}\n".encode()


class SktEncoder(TextEncoder):
    """SKT/1: lines with a letter, a checksum, and a status after each wrench; the header has no time."""

    WRENCH = "%.4f,%.4f,%.4f,%.6f,%.6f,%.6f,0"

    def header(self, t_us: int, fields: str, width: int) -> bytes:
        """Return the header record."""
        del t_us, width
        return _checked(f"H,skt1,{fields}")

    def _line(self, letter: str, seq: int, rest: str) -> bytes:
        return _checked(f"{letter},{seq & 0xFFFF},{rest}")


def _checked(text: str) -> bytes:
    raw = text.encode("ascii")
    return raw + b"*%04X\n" % binascii.crc_hqx(raw, CRC_START)


Encoder: TypeAlias = "SkbEncoder | TextEncoder | MakerEncoder"
ENCODERS: dict[str, type[SkbEncoder | TextEncoder]] = {"skb": SkbEncoder, "skt": SktEncoder, "text": TextEncoder}


def _fits(name: str, values: str, width: int) -> bool:
    """Return whether a skin frame of this width fits a record of the format."""
    if name == "skb":
        return SKB_HEAD.size + width * np.dtype(SKIN_TYPES[values][1]).itemsize <= SKB_BODY_MAX
    if name == "skt":
        digits = {"u8": 4, "u16": 6, "f32": 13}[values]
        return 24 + width * digits + 5 <= SKT_LINE_MAX
    return True


def make_encoder(name: str, top: float, width: int) -> Encoder:
    """Return a new board's encoder; a skin too wide for its format speaks delimited text instead.

    Raw values reach up to `top`; `width` is 0 for a board without skin.
    """
    # The narrowest whole number that holds them.
    values = "u8" if top <= 255 else "u16" if top <= 65535 else "f32"
    return ENCODERS[name if _fits(name, values, width) else "text"](values)
