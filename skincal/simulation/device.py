"""The rig's devices as bytes on a time line.

Each block, `DeviceTimeline` asks the operator, computes the readings of each device and encodes them; the links delay, hold
back, lose and damage the bytes. Its time is its own: `serve` (real time) and `virtual_session` get the same bytes.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.model.readings import Stream
from skincal.simulation.board_formats import Encoder
from skincal.simulation.boards import (
    BOARD_CLOCK_WRAP_US,
    BOARD_HEADER_PERIOD_S,
    US_PER_S,
    BoardHeader,
    board_encoder,
    board_headers,
    encode_header,
)
from skincal.simulation.emulated_devices import MAKERS
from skincal.simulation.operator import HandPress, Move, Operator, OperatorAction
from skincal.simulation.rig_errors import RigErrors, WrenchNoise
from skincal.simulation.simulated_rig import Rig, SimulatedArmPose

NS_PER_S = 1_000_000_000
QUIET_TIME_AFTER_LAST_ACTION_S = 0.5
"""s from the last action to the end: the quiet for the tare (0.2 s) and the slowest link's latency."""


@dataclass(frozen=True, slots=True)
class DeviceSettings:
    """Formats and rates of the devices."""

    format: str = "skb"
    """"skb", "skt" or "text"."""
    emulated: Mapping[Stream, str] = field(default_factory=dict[Stream, str])
    """Makers' devices that send a stream, by their names in `emulated_devices.MAKERS`."""
    wrench_hz: float = 1000.0
    """Hz. The rate that the program must bear; Bota's sensors reach 1004 Hz."""
    skin_hz: float = 50.0
    """Hz. The paper's taxels (section III-B)."""
    joints_hz: float = 100.0
    """Hz. The iCub's controllers."""
    flicker: float = 0.0
    """N m, change of the last moment from reading to reading: the last digit of a sensor without noise."""
    block_s: float = 0.010
    """s, readings computed and sent together: one USB poll."""
    header_s: float = BOARD_HEADER_PERIOD_S
    """s between a board's headers (SKT/1)."""
    start_quiet_s: float = 1.0
    """s before the operator's first action."""


class Clock:
    """A device's clock, with a random start and a small rate error."""

    def __init__(self, errors: RigErrors, rng: np.random.Generator) -> None:
        self._start = rng.uniform(1.0, BOARD_CLOCK_WRAP_US / US_PER_S)
        self._rate = 1.0 + errors.clock_skew * rng.standard_normal()

    def us(self, times: FloatArray) -> IntArray:
        """Return the clock at true times (n,), s: (n,) microseconds, wrapped."""
        total = np.round((self._start + self._rate * times) * US_PER_S).astype(np.int64)
        return total % BOARD_CLOCK_WRAP_US


class LossyLink:
    """A device's link to the host. It delays bytes by `latency`, s, and jitter; holds back, loses and damages them."""

    def __init__(self, latency: float, errors: RigErrors, rng: np.random.Generator) -> None:
        self._latency, self._errors, self._rng = latency, errors, rng
        self._last = 0.0
        self._held_until = 0.0

    def send(self, data: bytes, now: float, seconds: float) -> tuple[float, bytes]:
        """Return the arrival time and the bytes of a block of `seconds` that is sent at `now`, s."""
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
    """One device with its clock, encoder and link."""

    link: str
    stream: Stream
    hz: float
    clock: Clock
    encoder: Encoder
    line: LossyLink
    header: BoardHeader
    made: int = 0
    """Number of readings so far."""
    next_header: float = 0.0

    def greeting(self, now: float) -> bytes:
        """Return the header at `now`, s."""
        return encode_header(self.encoder, self.header, int(self.clock.us(np.array([now]))[0]))

    def due(self, end: float) -> FloatArray:
        """Return the times (n,) of the readings before `end`, s, and count them."""
        # Counted from the start, so that times do not depend on the block length. 1e-9: a rounded-up product adds no reading.
        until = int(np.ceil(end * self.hz - 1e-9))
        times = np.arange(self.made, until) / self.hz
        self.made = max(self.made, until)
        return times


class DeviceTimeline:
    """Runs rig, operator and devices along one time line; the joints of an arm in the scene are a link, too."""

    def __init__(self, rig: Rig, operator: Operator, rng: np.random.Generator, settings: DeviceSettings | None = None) -> None:
        # Streams of their own: a sensor that draws more changes nothing of the others.
        noise, boards, self._skin_rng = rng.spawn(3)
        self.rig, self.operator, self.settings = rig, operator, settings or DeviceSettings()
        self.block_s, self.emulated, self.channels = self.settings.block_s, self.settings.emulated, rig.scene.skin.channels
        self.now = 0.0
        """s, end of the computed time."""
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
        """Name of each link and its stream."""
        return {board.link: board.stream for board in self._boards}

    @property
    def finished(self) -> bool:
        """Whether the operator has ended, and the quiet time after the last poke has passed."""
        return self.operator.done and self.now >= self._free + QUIET_TIME_AFTER_LAST_ACTION_S

    def greeting(self, link: str) -> bytes:
        """Return the header that a board sends when a host connects or asks."""
        return next(board for board in self._boards if board.link == link).greeting(self.now)

    def advance(self) -> list[tuple[int, str, bytes]]:
        """Compute one block; return its arrivals (virtual nanoseconds, link, bytes), sorted by time."""
        begin, end = self.now, (self._blocks + 1) * self.settings.block_s
        self._schedule(end)
        for board in self._boards:
            data = self._bytes(board, begin, end)
            if data:
                at, data = board.line.send(data, end, end - begin)
                # The count keeps the order of sending for equal times.
                heapq.heappush(self._arrivals, (round(at * NS_PER_S), self._sent, board.link, data))
                self._sent += 1
        self._blocks += 1
        self.now = end
        arrived: list[tuple[int, str, bytes]] = []
        while self._arrivals and self._arrivals[0][0] <= round(end * NS_PER_S):
            at_ns, _, link, data = heapq.heappop(self._arrivals)
            arrived.append((at_ns, link, data))
        return arrived

    def _schedule(self, end: float) -> None:
        """Ask the operator for actions that begin in this block, and drop ended ones."""
        if not self.operator.done:
            # After a pause the operator continues at the present time.
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
            # Also in a block without a reading: the sensor's noise continues from block to block.
            values = self._wrenches(times, begin, end)
        elif not len(times):
            return data
        else:
            values = self._skin(times) if board.stream is Stream.SKIN else np.degrees(self._joints(times))
        return data + board.encoder.encode(board.stream, board.clock.us(times), values)

    def _wrenches(self, times: FloatArray, begin: float, end: float) -> FloatArray:
        """Return readings (n, 6) of the force/torque device, with the sign of the scene's sensor."""
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
        """Return raw frames (n, width); the foam responds with a delay."""
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
        """Return the arm's progress (n,), 0 to 1, towards the next pose, and that pose."""
        move = next((action for action in self._actions if isinstance(action, Move)), None)
        if move is None:
            return np.zeros(len(times)), self.arm_pose
        share = np.clip((times - move.begin) / (move.free - move.begin), 0.0, 1.0)
        return 0.5 - 0.5 * np.cos(np.pi * share), move.arm_pose

    def _weight(self, times: FloatArray) -> FloatArray:
        share, target = self._share_moved(times)
        return self._from.weight + share[:, None] * (target.weight - self._from.weight)

    def _joints(self, times: FloatArray) -> FloatArray:
        """Return reported joint angles (n, columns), radians; joints outside the chain are 0."""
        arm = self.rig.scene.arm
        if arm is None:
            return np.zeros((len(times), 0))
        share, target = self._share_moved(times)
        angles = np.zeros((len(times), max(arm.arm.joints) + 1))
        angles[:, arm.arm.joints] = self._from.angles + share[:, None] * (target.angles - self._from.angles)
        return angles


def _boards(rig: Rig, settings: DeviceSettings, rng: np.random.Generator) -> list[SimulatedDevice]:
    errors, top = rig.errors, rig.range[1]
    rates = {Stream.WRENCH: settings.wrench_hz, Stream.SKIN: settings.skin_hz, Stream.JOINTS: settings.joints_hz}
    headers = board_headers(rig.scene, rates, top, rises=rig.polarity > 0)
    boards: list[SimulatedDevice] = []
    # Always three random streams, so that the others do not change with the arm.
    for (stream, header), own in zip(headers.items(), rng.spawn(3), strict=False):
        clock, hz = Clock(errors, own), rates[stream]
        latency = errors.wrench_latency if stream is Stream.WRENCH else errors.skin_latency
        if stream in settings.emulated:
            maker = MAKERS[settings.emulated[stream]]
            # TCP damages nothing, and UDP no delivered datagram.
            damage = errors if maker.serial else replace(errors, corrupted=0.0, dropped=0.0)
            encoder, link, hz = maker.encoder(), LossyLink(latency, damage, own), maker.hz or hz
            encoder.joint_names = () if rig.scene.robot is None else rig.scene.robot.columns
        else:
            encoder = board_encoder(settings.format, stream, top, header.width)
            link = LossyLink(latency, errors, own)
        boards.append(SimulatedDevice(stream.value, stream, hz, clock, encoder, link, header))
    return boards
