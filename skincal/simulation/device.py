"""The rig's devices as bytes on a time line.

For each block `DeviceTimeline` asks the operator, computes the readings of each device and encodes them; the links delay,
hold back, lose and damage the bytes. Its time is its own: `serve` (block by block in real time) and `virtual_session` (many
blocks at once) get the same bytes.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby, islice, pairwise

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

LARGEST_VECTOR_VALUE = 25.0
"""Largest value of a taxel of three axes, N: presses of 15 N give it less than 10."""


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
    tool_hz: float = 125.0
    """Hz. A CB3 robot's controller."""
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
        if rng.random() < errors.burst_rate * seconds:
            self._held_until = now + errors.burst_s
        delay = self._latency + (rng.exponential(errors.jitter) if errors.jitter else 0.0)
        # A link keeps its bytes in order, so none overtakes a slower one before it.
        self._last = max(self._last, now + delay, self._held_until)
        return self._last, self._damage(data)

    def _damage(self, data: bytes) -> bytes:
        flips = self._rng.binomial(len(data), self._errors.corrupted) if self._errors.corrupted else 0
        losses = self._rng.binomial(len(data), self._errors.dropped) if self._errors.dropped else 0
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

    def due(self, ends: Sequence[float]) -> tuple[FloatArray, list[int]]:
        """Return the times (n,) of the readings before the last of `ends`, s, and their number in each block; count them."""
        # Counted from the start, so that times do not depend on the block length. 1e-9: a rounded-up product adds no reading.
        until = [max(self.made, int(np.ceil(end * self.hz - 1e-9))) for end in ends]
        counts = [after - before for before, after in pairwise([self.made, *until])]
        times = np.arange(self.made, until[-1]) / self.hz
        self.made = until[-1]
        return times, counts


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Successive blocks during which the same actions go on."""

    rig: Rig
    actions: tuple[OperatorAction, ...]
    before: SimulatedArmPose
    """Pose of the arm from which the last movement began."""
    arm_pose: SimulatedArmPose
    begins: list[float]
    """s, of each block."""
    ends: list[float]

    def goes_on(self, following: Stretch) -> bool:
        """Whether the actions and poses of a later block are the same."""
        same = self.before is following.before and self.arm_pose is following.arm_pose
        return same and [*map(id, self.actions)] == [*map(id, following.actions)]

    def wrenches(self, times: FloatArray, blocks: slice) -> FloatArray:
        """Return true wrenches (blocks, n, 6), sensor frame, at `times` (blocks, n), s, of some of the blocks."""
        total = self._weight(times)
        for action in self.actions:
            if isinstance(action, HandPress):
                spans = enumerate(zip(self.begins[blocks], self.ends[blocks], strict=True))
                felt = [at for at, (begin, end) in spans if action.begin < end and action.end > begin]
                if felt:
                    part = slice(felt[0], felt[-1] + 1)
                    total[part] += self._press_wrench(action, times[part])
        return total

    def _press_wrench(self, press: HandPress, times: FloatArray) -> FloatArray:
        load, travel = press.load(times)[..., None], press.travel(times)
        total = np.zeros((*times.shape, 6))
        for point, direction, force in zip(press.pokes.points, press.pokes.directions, press.pokes.forces, strict=True):
            total += self.rig.true_wrenches(point + travel, load * force * direction, self.arm_pose)
        return total

    def answers(self, times: FloatArray) -> FloatArray:
        """Return the responses (n, taxels) at `times` (n,), s, or (n, taxels, 3); the foam responds with a delay."""
        felt = times - self.rig.foam.lag
        answers = np.zeros((len(times), len(self.rig.channels), *self.rig.values_shape))
        for action in self.actions:
            if not isinstance(action, HandPress):
                continue
            loads, travel = action.load(felt), action.travel(felt)
            frames = np.flatnonzero(loads > 0)
            if not len(frames):
                continue
            places = len(action.pokes)
            pressed = action.pokes.subset(np.tile(np.arange(places), len(frames)))
            slid = replace(pressed, points=pressed.points + np.repeat(travel[frames], places, axis=0))
            forces = (loads[frames, None] * action.pokes.forces).ravel()
            rows, values = self.rig.answers(slid, forces, places)
            np.add.at(answers, (np.repeat(frames, places)[:, None], rows), values)
        return answers

    def _share_moved(self, times: FloatArray) -> tuple[FloatArray, SimulatedArmPose]:
        """Return the arm's progress, 0 to 1, towards the next pose at each time, s, and that pose."""
        move = next((action for action in self.actions if isinstance(action, Move)), None)
        if move is None:
            return np.zeros(times.shape), self.arm_pose
        share = np.clip((times - move.begin) / (move.free - move.begin), 0.0, 1.0)
        return 0.5 - 0.5 * np.cos(np.pi * share), move.arm_pose

    def _weight(self, times: FloatArray) -> FloatArray:
        """Return the wrench (..., 6) without a press at `times` (...), s, ascending."""
        share, target = self._share_moved(times)
        return self.before.weight + share[..., None] * (target.weight - self.before.weight)

    def joints(self, times: FloatArray) -> FloatArray:
        """Return reported joint angles (n, columns), radians, at `times` (n,), s; joints outside the chain are 0."""
        arm = self.rig.scene.arm
        if arm is None:
            return np.zeros((len(times), 0))
        share, target = self._share_moved(times)
        angles = np.zeros((len(times), max(arm.arm.joints) + 1))
        angles[:, arm.arm.joints] = self.before.angles + share[:, None] * (target.angles - self.before.angles)
        return angles


class ToolStretch(Stretch):
    """Successive blocks of a rig whose tool carries the sensor."""

    def _press_wrench(self, press: HandPress, times: FloatArray) -> FloatArray:
        # The weight of the tool alone is in `_weight`.
        load, travel, total = press.load(times).ravel(), press.travel(times).reshape(-1, 3), np.zeros((times.size, 6))
        still = self._tool_wrench(times, np.zeros(3), np.zeros(3))
        for point, direction, force in zip(press.pokes.points, press.pokes.directions, press.pokes.forces, strict=True):
            total += self._tool_wrench(times, load[:, None] * force * direction, point + travel) - still
        return total.reshape(*times.shape, 6)

    def _weight(self, times: FloatArray) -> FloatArray:
        return self._tool_wrench(times, np.zeros(3), np.zeros(3)).reshape(*times.shape, 6)

    def _tool_wrench(self, times: FloatArray, forces: FloatArray, points: FloatArray) -> FloatArray:
        assert self.rig.tool is not None
        shape = (times.size, 3)
        return self.rig.tool.wrenches(times.ravel(), np.broadcast_to(forces, shape), np.broadcast_to(points, shape))


class DeviceTimeline:
    """Runs rig, operator and devices along one time line; the joints of an arm or the poses of a tool are a link, too."""

    def __init__(self, rig: Rig, operator: Operator, rng: np.random.Generator, settings: DeviceSettings | None = None) -> None:
        # Streams of their own: a sensor that draws more changes nothing of the others.
        noise, boards, self._skin_rng, self._tool_rng = rng.spawn(4)
        self.rig, self.operator, self.settings = rig, operator, settings or DeviceSettings()
        self.block_s, self.emulated, self.channels = self.settings.block_s, self.settings.emulated, rig.scene.skin.channels
        self.now = 0.0
        """s, end of the computed time."""
        self.arm_pose = rig.arm_pose()
        self._noise = WrenchNoise(rig.errors, noise)
        self._boards = _boards(rig, self.settings, boards)
        self._actions: list[OperatorAction] = []
        self._free: float = self.settings.start_quiet_s
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
        return self.operator.is_finished and self.now >= self._free + QUIET_TIME_AFTER_LAST_ACTION_S

    def greeting(self, link: str) -> bytes:
        """Return the header that a board sends when a host connects or asks."""
        return next(board for board in self._boards if board.link == link).greeting(self.now)

    def advance(self) -> list[tuple[int, str, bytes]]:
        """Compute one block; return its arrivals (virtual nanoseconds, link, bytes), sorted by time."""
        return self._compute([self._next_block()])[0]

    def advance_many(self, count: int) -> list[tuple[float, list[tuple[int, str, bytes]]]]:
        """Compute up to `count` blocks at once, until `finished`; return the end of each, s, and its arrivals as `advance`."""
        blocks = [self._next_block()]
        while len(blocks) < count and not self.finished:
            blocks.append(self._next_block())
        return list(zip((block.ends[0] for block in blocks), self._compute(blocks), strict=True))

    def _next_block(self) -> Stretch:
        """Ask the operator what happens in the next block."""
        begin, end = self.now, (self._blocks + 1) * self.settings.block_s
        self._schedule(end)
        self._blocks += 1
        self.now = end
        made = Stretch if self.rig.tool is None else ToolStretch
        return made(self.rig, tuple(self._actions), self._from, self.arm_pose, [begin], [end])

    def _compute(self, blocks: Sequence[Stretch]) -> list[list[tuple[int, str, bytes]]]:
        """Compute the readings of successive blocks, and send them; return the arrivals of each block."""
        stretches: list[Stretch] = []
        for block in blocks:
            if stretches and stretches[-1].goes_on(block):
                stretches[-1].begins.extend(block.begins)
                stretches[-1].ends.extend(block.ends)
            else:
                stretches.append(replace(block, begins=list(block.begins), ends=list(block.ends)))
        data = [self._bytes(board, stretches) for board in self._boards]
        return [self._send(block, [each[at] for each in data]) for at, block in enumerate(blocks)]

    def _send(self, block: Stretch, data: Sequence[bytes]) -> list[tuple[int, str, bytes]]:
        """Send the bytes of each board; return what arrives until the end of the block."""
        begin, end = block.begins[0], block.ends[0]
        for board, sent in zip(self._boards, data, strict=True):
            if sent:
                at, arriving = board.line.send(sent, end, end - begin)
                # The count keeps the order of sending for equal times.
                heapq.heappush(self._arrivals, (round(at * NS_PER_S), self._sent, board.link, arriving))
                self._sent += 1
        arrived: list[tuple[int, str, bytes]] = []
        while self._arrivals and self._arrivals[0][0] <= round(end * NS_PER_S):
            at_ns, _, link, arriving = heapq.heappop(self._arrivals)
            arrived.append((at_ns, link, arriving))
        return arrived

    def _schedule(self, end: float) -> None:
        """Ask the operator for actions that begin in this block, and drop ended ones."""
        if not self.operator.is_finished:
            # After a pause the operator continues at the present time.
            self._free = max(self._free, self.now)
        while self._free < end:
            action = self.operator.next(self._free)
            if action is None:
                break
            if self.rig.tool is not None and isinstance(action, HandPress):
                self.rig.tool.plan_press(self._free, action, action.pokes.points[0], action.pokes.directions[0])
            self._free = action.free
            self._actions.append(action)
        for action in self._actions:
            if isinstance(action, Move) and action.free <= self.now:
                self._from = self.arm_pose = action.arm_pose
        self._actions = [action for action in self._actions if action.free > self.now]

    def _bytes(self, board: SimulatedDevice, stretches: Sequence[Stretch]) -> list[bytes]:
        """Return the bytes of a board in each block."""
        ends = [end for stretch in stretches for end in stretch.ends]
        times, counts = board.due(ends)
        parts = iter(np.split(times, np.cumsum(counts)[:-1]))
        by_stretch = [list(islice(parts, len(stretch.ends))) for stretch in stretches]
        if board.stream is Stream.WRENCH:
            values = self._wrenches(stretches, by_stretch)
        elif board.stream is Stream.SKIN:
            answers = [stretch.answers(np.concatenate(own)) for stretch, own in zip(stretches, by_stretch, strict=True)]
            values = self.rig.skin_frame(np.concatenate(answers), self._skin_rng)
        elif board.stream is Stream.TOOL:
            assert self.rig.tool is not None
            values = self.rig.tool.reported(times, self._tool_rng)
        else:
            angles = [stretch.joints(np.concatenate(own)) for stretch, own in zip(stretches, by_stretch, strict=True)]
            values = np.degrees(np.concatenate(angles))
        records = iter(board.encoder.encode(board.stream, board.clock.us(times), values) if len(times) else ())
        begins = (begin for stretch in stretches for begin in stretch.begins)
        return [
            self._header(board, begin) + b"".join(islice(records, count)) for begin, count in zip(begins, counts, strict=True)
        ]

    def _header(self, board: SimulatedDevice, begin: float) -> bytes:
        """Return the header of a board at `begin`, s, or nothing before the next one."""
        if begin < board.next_header:
            return b""
        board.next_header += self.settings.header_s
        return board.greeting(begin)

    def _wrenches(self, stretches: Sequence[Stretch], times: Sequence[Sequence[FloatArray]]) -> FloatArray:
        """Return readings (n, 6) of the force/torque device, with the sign of the scene's sensor; `times`, s, by block."""
        rig, read = self.rig, [np.empty((0, 6))]
        for stretch, blocks in zip(stretches, times, strict=True):
            first = 0
            # Also for blocks without a reading: the sensor's noise continues from block to block.
            for _, same in groupby(blocks, key=len):
                at = np.array(list(same))
                part = slice(first, first + len(at))
                noise = self._noise.blocks(at, stretch.begins[part], stretch.ends[part])
                readings = rig.read_wrenches(stretch.wrenches(at, part)) + rig.offset + noise
                readings[..., 5] += self.settings.flicker * np.sin(1000.0 * at)
                read.append((rig.scene.wrench_sign * readings).reshape(-1, 6))
                first += len(at)
        return np.concatenate(read)


def _boards(rig: Rig, settings: DeviceSettings, rng: np.random.Generator) -> list[SimulatedDevice]:
    errors = rig.errors
    top = rig.range[1] if rig.scene.skin.axes is None else LARGEST_VECTOR_VALUE
    rates = {
        Stream.WRENCH: settings.wrench_hz, Stream.SKIN: settings.skin_hz, Stream.JOINTS: settings.joints_hz,
        Stream.TOOL: settings.tool_hz,
    }  # fmt: skip
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
            if stream is Stream.SKIN:
                encoder.skin_factor = maker.skin_factor(rig.scene, top)
                axes = rig.scene.skin.axes
                encoder.skin_axes, encoder.skin_unit = (1, "") if axes is None else (3, axes.unit)
            encoder.joint_names = () if rig.scene.robot is None else rig.scene.robot.columns
        else:
            encoder = board_encoder(settings.format, stream, top if rig.scene.skin.axes is None else np.inf, header.width)
            link = LossyLink(latency, errors, own)
        boards.append(SimulatedDevice(stream.value, stream, hz, clock, encoder, link, header))
    return boards
