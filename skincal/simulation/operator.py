"""Simulated people who poke: how they aim and press, and who decides what they poke.

`AutoOperator` pokes every taxel by itself. `ScriptedOperator` obeys lines of text (`read_order`). `GuidedOperator` receives
targets as a robot does (`skincal/robot/target_lines.py`), answers likewise, and sometimes pokes something else.
"""

from __future__ import annotations

import contextlib
import queue
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.mesh.search import nearest_pushed_points
from skincal.model.errors import InputError
from skincal.robot.target_lines import Answer, AnswerKind, AskedLine, GuidedByHand, NoTarget, PokeTarget
from skincal.simulation.simulated_rig import (
    PressedPlaces,
    Rig,
    SimulatedArmPose,
    add_hand_noise,
    cone_tilts,
    join,
    limit_tilt,
    push_directions,
    tangents,
)
from skincal.simulation.simulated_tool import APPROACH_S, MOVE_S, REST_S


@dataclass(frozen=True, slots=True)
class PokeOrder:
    """Order to poke a taxel; `None`: as the habits say."""

    channel: int
    tilt: float | None = None
    """rad, from the inward normal."""
    azimuth: float | None = None
    """rad, from e1 to e2 of `tangents`."""
    force: float | None = None
    """N."""


@dataclass(frozen=True, slots=True)
class PoseOrder:
    """Order to move the arm to a pose."""

    name: str


@dataclass(frozen=True, slots=True)
class PaceOrder:
    """Order to change the speed between pokes by a factor."""

    pace: float


Order: TypeAlias = PokeOrder | PoseOrder | PaceOrder

ORDER_HELP = "poke CHANNEL [TILT_DEG AZIMUTH_DEG FORCE_N], pose NAME or pace TIMES"
PACE_RANGE = (0.1, 4.0)
"""Allowed factors of the speed between pokes."""


def read_order(line: str) -> Order | None:
    """Read one line; `None` for an empty one. Raises InputError for any other line without an order."""
    order: Order | None = None
    with contextlib.suppress(ValueError):
        match line.split():
            case []:
                return None
            case ["poke", channel]:
                order = PokeOrder(int(channel))
            case ["poke", channel, *numbers] if len(numbers) == 3:
                tilt, azimuth, force = map(float, numbers)
                if 0 <= tilt < 90 and 0 < force < 1000 and np.isfinite(azimuth):
                    order = PokeOrder(int(channel), float(np.radians(tilt)), float(np.radians(azimuth)), force)
            case ["pose", name]:
                order = PoseOrder(name)
            case ["pace", pace] if PACE_RANGE[0] <= float(pace) <= PACE_RANGE[1]:
                order = PaceOrder(float(pace))
            case _:
                pass
    if order is None:
        raise InputError(f"{line.strip()!r} is not an order; expected {ORDER_HELP}, with 0 <= tilt < 90 and force above 0.")
    return order


@dataclass(frozen=True, slots=True)
class Habits:
    """How a person pokes; SI units."""

    force: tuple[float, float] = (6.0, 12.0)
    """N, uniform: well inside the force window of 4 to 15 N."""
    cone: float = float(np.radians(30.0))
    """rad, maximum tilt of a push from the inward normal: the friction of a tip on foam. Uniform in solid angle."""
    aim: float = 0.002
    """m, sd of the position in each tangent direction. Half the side of the 4 mm tip. Assumed."""
    approach_s: tuple[float, float] = (0.4, 0.9)
    """s, movement of the hand before the touch. A poke takes about 2.2 s in all. Assumed."""
    ramp_s: tuple[float, float] = (0.15, 0.30)
    """s, from touch to full force."""
    hold_s: tuple[float, float] = (0.4, 0.8)
    """s at full force, longer than the still window of 0.3 s. Assumed."""
    release_s: tuple[float, float] = (0.10, 0.20)
    """s, from full force to zero."""
    rest_s: tuple[float, float] = (0.3, 0.6)
    """s, quiet after the release, before the hand moves on."""
    tremor: float = 0.015
    """Amplitude of the tremor relative to the force. A still window allows 5 %."""
    tremor_hz: tuple[float, float] = (8.0, 12.0)
    """Hz. Physiological tremor of the hand."""
    slide_rate: float = 0.03
    """Share of the pokes that slide at full force. Assumed."""
    slide: tuple[float, float] = (0.003, 0.006)
    """m, length of the slide."""
    double_rate: float = 0.03
    """Share of the pokes that touch a second place. Assumed."""
    double_share: tuple[float, float] = (0.2, 0.5)
    """Force at the second place, as a share of the first."""
    double_away: tuple[float, float] = (0.015, 0.060)
    """m, uniform distance of the second place from the first: another finger or a sleeve (`second_touches`). Assumed."""
    move_s: float = 2.0
    """s, for the arm to go to another pose."""
    hand: float = float(np.radians(6.0))
    """rad, sd of the push about the requested one, in each direction. Assumed."""
    side: float = 0.0
    """rad, from e1 to e2 of `tangents`: direction of the hand, for `bias` and `arc`."""
    bias: float = 0.0
    """rad, additional tilt of every push towards `side`."""
    arc: float = 2.0 * float(np.pi)
    """rad, range of tilt directions about `side`; 0 for always the same one."""
    ignores: float = 1.0 / 12.0
    """Share of the pokes at a taxel of the person's own choice instead of the target. Assumed."""
    reaction_s: float = 0.25
    """s before the touch. A later target is used for the next poke. A simple visual reaction."""
    tool_s: float = 0.0
    """s, least from the choice of a place to the touch: a robot turns its tool, and rests above the skin."""

    @property
    def leans(self) -> bool:
        """Whether `bias` or `arc` change pushes."""
        return self.bias != 0.0 or self.arc < 2.0 * np.pi

    @classmethod
    def careful(cls) -> Habits:
        """Return habits without slides and double touches."""
        return cls(slide_rate=0.0, double_rate=0.0)

    def with_tool(self) -> Habits:
        """Return the habits of a robot that holds a tool: it first goes above the place, and rests there."""
        needed = MOVE_S + REST_S + APPROACH_S
        return replace(self, approach_s=(needed, needed + 0.2), reaction_s=needed, tool_s=needed)

    def at_pace(self, pace: float) -> Habits:
        """Return habits with `pace` times the speed between pokes; presses take the same time."""
        approach = tuple(max(s / pace, self.tool_s) for s in self.approach_s)
        rest, reaction = tuple(s / pace for s in self.rest_s), max(self.reaction_s / pace, self.tool_s)
        return replace(self, approach_s=approach, rest_s=rest, reaction_s=reaction)


OPERATORS: Mapping[str, Habits] = {
    "careful": Habits.careful(),
    "two_taxels": replace(Habits.careful(), double_rate=1.0, double_share=(0.4, 1.0), double_away=(0.005, 0.008)),
    "biased": replace(Habits.careful(), bias=float(np.radians(15.0)), side=float(np.radians(-60.0))),
    "left_handed": replace(Habits.careful(), bias=float(np.radians(15.0)), side=float(np.radians(120.0))),
    "arc": replace(Habits.careful(), arc=float(np.radians(120.0)), side=float(np.radians(-90.0))),
    "one_side": replace(Habits.careful(), arc=0.0, bias=float(np.radians(20.0)), side=float(np.radians(-90.0))),
}
"""Operator profiles for robustness tests. The guide's thresholds were tuned with `careful` only."""


def apply_bias(pushes: FloatArray, normals: FloatArray, habits: Habits) -> FloatArray:
    """Apply the directional habits `Habits.bias` and `arc` to pushes (n, 3) on skin with outward normals (n, 3)."""
    if not habits.leans:
        return pushes
    # Limits the slope of grazing pushes.
    inward = np.maximum(-np.sum(pushes * normals, axis=1, keepdims=True), 1e-3)
    e1, e2 = tangents(normals)
    # Slopes along e1 and e2.
    x, y = (np.sum(pushes * e, axis=1) / inward[:, 0] for e in (e1, e2))
    half = habits.arc / 2.0
    turned = np.arctan2(y, x) - habits.side
    turned = np.clip(np.arctan2(np.sin(turned), np.cos(turned)), -half, half) + habits.side
    steep = np.hypot(x, y)
    x = steep * np.cos(turned) + np.tan(habits.bias) * np.cos(habits.side)
    y = steep * np.sin(turned) + np.tan(habits.bias) * np.sin(habits.side)
    made = x[:, None] * e1 + y[:, None] * e2 - normals
    return made / np.linalg.norm(made, axis=1, keepdims=True)


@dataclass(frozen=True, slots=True)
class LandmarkHabits:
    """How a person pokes landmarks; SI units."""

    force: tuple[float, float] = (8.0, 13.0)
    """N, uniform, higher than on foam."""
    cone: float = float(np.radians(28.0))
    """rad, maximum tilt of a push from the inward normal. Uniform in solid angle."""
    aim: float = 0.0007
    """m, sd of the position in each tangent direction: a tip in the slot of a screw. Assumed."""


@dataclass(frozen=True, slots=True, eq=False)
class HandPress:
    """One press over time: ramp, hold, release."""

    begin: float
    """s, first touch."""
    ramp: float
    hold: float
    release: float
    free: float
    """s, time at which the operator is ready for the next action."""
    pokes: PressedPlaces
    """One place, or two for a double touch."""
    slide: FloatArray
    """(3,) float, metres, link frame: slide during the hold."""
    tremor: float
    tremor_hz: float
    tremor_phase: float

    @property
    def end(self) -> float:
        """s, end of contact."""
        return self.begin + self.ramp + self.hold + self.release

    def load(self, times: FloatArray) -> FloatArray:
        """Return the force relative to the full force at each time, s."""
        since = times - self.begin
        rise = _smooth_step(since / self.ramp)
        fall = _smooth_step((since - self.ramp - self.hold) / self.release)
        shake = 1.0 + self.tremor * np.sin(2 * np.pi * self.tremor_hz * since + self.tremor_phase)
        return rise * (1.0 - fall) * shake

    def travel(self, times: FloatArray) -> FloatArray:
        """Compute how far the tip has slid (..., 3) on the skin, metres, at `times` (...), s."""
        return np.clip((times - self.begin - self.ramp) / self.hold, 0.0, 1.0)[..., None] * self.slide


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """Movement of the arm to another pose."""

    begin: float
    free: float
    arm_pose: SimulatedArmPose


OperatorAction: TypeAlias = HandPress | Move


def _smooth_step(share: FloatArray) -> FloatArray:
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(share, 0.0, 1.0))


def unguided_presses(rig: Rig, targets: IntArray, habits: Habits, rng: np.random.Generator) -> PressedPlaces:
    """Return unguided presses at taxels (n,), with the aim error and a random tilt within the cone."""
    count = len(targets)
    tilts = cone_tilts(count, habits.cone, rng)
    azimuths = rng.uniform(-np.pi, np.pi, count)
    forces = rng.uniform(*habits.force, count)
    beside, leans = habits.aim * rng.standard_normal((count, 2)), np.column_stack([tilts, azimuths])
    meant = presses_at(rig, targets, beside, leans, forces, rng)
    if not habits.leans:
        return meant
    return replace(
        meant, directions=limit_tilt(apply_bias(meant.directions, meant.normals, habits), meant.normals, habits.cone)
    )


def presses_at(
    rig: Rig,
    targets: IntArray,
    beside: FloatArray,
    leans: FloatArray,
    forces: FloatArray,
    rng: np.random.Generator,
) -> PressedPlaces:
    """Return presses at targets with offsets `beside` (n, 2), metres, in their planes; `leans` (n, 2): tilt, azimuth, rad."""
    rows = np.array([rig.row_of(int(channel)) for channel in targets], dtype=np.int64)
    e1, e2 = tangents(rig.normals[rows])
    points, normals = _on_skin(rig, rig.places[rows] + beside[:, :1] * e1 + beside[:, 1:] * e2, rig.normals[rows])
    directions = push_directions(normals, leans[:, 0], leans[:, 1])
    return PressedPlaces(targets, points, normals, directions, forces, rng.uniform(0.0, np.pi / 2, len(rows)))


def aimed_presses(
    rig: Rig, rows: IntArray, places: FloatArray, pushes: FloatArray, habits: Habits, rng: np.random.Generator
) -> PressedPlaces:
    """Simulate a hand that aims at shown places (n, 3), metres, with unit pushes (n, 3).

    Places move to the surface that faces the push, or without a surface to the plane of the taxels in `rows` (n,).
    """
    count = len(places)
    places, normals = _on_part(rig, rows, places, -pushes)
    e1, e2 = tangents(normals)
    offset = habits.aim * rng.standard_normal((count, 2))
    points, normals = _on_part(rig, rows, places + offset[:, :1] * e1 + offset[:, 1:] * e2, normals)
    pushes = limit_tilt(add_hand_noise(apply_bias(pushes, normals, habits), habits.hand, rng), normals, habits.cone)
    forces, turns = rng.uniform(*habits.force, count), rng.uniform(0.0, np.pi / 2, count)
    return PressedPlaces(rig.channels[rows], points, normals, pushes, forces, turns)


def _on_part(rig: Rig, rows: IntArray, places: FloatArray, outward: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Move places (n, 3) onto the surface, or without one into the planes of their taxels; return also the normals.

    `outward` (n, 3) points out of the part: a hand does not press the inner face of a thin wall.
    """
    if rig.surface is not None:
        return _on_skin(rig, places, outward)
    normals = rig.normals[rows]
    return places - np.sum((places - rig.places[rows]) * normals, axis=1, keepdims=True) * normals, normals


def _on_skin(rig: Rig, points: FloatArray, normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Project points onto the surface that faces as `normals` do; return them and its normals. Without one: the input."""
    if rig.surface is None:
        return points, normals
    on_surface, triangles = nearest_pushed_points(rig.surface, points, -normals)
    return on_surface, rig.surface.normals[triangles]


def press(rig: Rig, pokes: PressedPlaces, now: float, habits: Habits, rng: np.random.Generator) -> HandPress:
    """Return one press of the first place in `pokes`, with random slides and double touches. The hand starts at `now`, s."""
    begin = now + rng.uniform(*habits.approach_s)
    ramp, hold, release = rng.uniform(*habits.ramp_s), rng.uniform(*habits.hold_s), rng.uniform(*habits.release_s)
    free = begin + ramp + hold + release + rng.uniform(*habits.rest_s)
    # Drawn together, so that a slide does not change the random numbers of a double touch.
    slides, doubles = rng.uniform(size=2) < (habits.slide_rate, habits.double_rate)
    first = pokes.subset(slice(0, 1))
    both = join([first, _second(rig, first, habits, rng)]) if doubles else first
    slide = np.zeros(3)
    if slides:
        (e1,), (e2,) = tangents(first.normals)
        angle = rng.uniform(0.0, 2 * np.pi)
        slide = rng.uniform(*habits.slide) * (np.cos(angle) * e1 + np.sin(angle) * e2)
    hz, phase = rng.uniform(*habits.tremor_hz), rng.uniform(0.0, 2 * np.pi)
    return HandPress(begin, ramp, hold, release, free, both, slide, habits.tremor, hz, phase)


def _second(rig: Rig, first: PressedPlaces, habits: Habits, rng: np.random.Generator) -> PressedPlaces:
    """Return the second place of a double touch: at another taxel, with another push."""
    target = rng.choice(rig.channels, 1)
    second = unguided_presses(rig, target, habits, rng)
    forces = first.forces * rng.uniform(*habits.double_share)
    return PressedPlaces(target, second.points, second.normals, second.directions, forces, second.turns)


def second_touches(rig: Rig, pokes: PressedPlaces, habits: Habits, rng: np.random.Generator) -> tuple[IntArray, PressedPlaces]:
    """Choose pokes with a second touch; return their rows (m,) and the second places, on the skin or the part around it."""
    rows = np.flatnonzero(rng.uniform(size=len(pokes)) < habits.double_rate)
    count, first = len(rows), pokes.subset(rows)
    e1, e2 = tangents(first.normals)
    azimuths, away = rng.uniform(-np.pi, np.pi, count)[:, None], rng.uniform(*habits.double_away, count)[:, None]
    beside = first.points + away * (np.cos(azimuths) * e1 + np.sin(azimuths) * e2)
    beside, normals = _on_skin(rig, beside, first.normals)
    directions = push_directions(normals, cone_tilts(count, habits.cone, rng), rng.uniform(-np.pi, np.pi, count))
    forces = first.forces * rng.uniform(*habits.double_share, count)
    return rows, PressedPlaces(first.targets, beside, normals, directions, forces, rng.uniform(0.0, np.pi / 2, count))


class AutoOperator:
    """Pokes every taxel once a round, in a random order, in one arm pose after another.

    Parameters
    ----------
    pokes : their number; `None`: no end
    poses : names of arm poses with equal shares of the pokes; without an end each gets `POKES_PER_POSE` in turn
    channels : taxels to poke; `None`: all
    """

    POKES_PER_POSE = 84
    """One for each taxel of the paper's forearm."""

    def __init__(
        self,
        rig: Rig,
        habits: Habits,
        rng: np.random.Generator,
        pokes: int | None = None,
        poses: Sequence[str] = (),
        channels: Sequence[int] | None = None,
    ) -> None:
        self._rig, self._habits, self._rng, self._pokes = rig, habits, rng, pokes
        self._arm_poses = [rig.arm_pose(name) for name in poses] or [rig.arm_pose()]
        self._channels = rig.channels if channels is None else np.array(channels, dtype=np.int64)
        self._each = self.POKES_PER_POSE if pokes is None else max(1, -(-pokes // len(self._arm_poses)))
        self._round: list[PressedPlaces] = []
        self.begun = 0
        """Number of pokes so far."""
        self._arm_pose = rig.arm_pose()

    @property
    def is_finished(self) -> bool:
        return self._pokes is not None and self.begun >= self._pokes

    def next(self, now: float) -> OperatorAction | None:
        """Return the next action at time `now`, s; `None` if there is none yet."""
        if self.is_finished:
            return None
        wanted = self._arm_poses[self.begun // self._each % len(self._arm_poses)]
        if wanted is not self._arm_pose:
            self._arm_pose = wanted
            return Move(now, now + self._habits.move_s, wanted)
        return self._poke(now)

    def _poke(self, now: float) -> HandPress | None:
        if not self._round:
            order = self._rng.permutation(self._channels)
            pokes = unguided_presses(self._rig, order, self._habits, self._rng)
            # Reversed for `pop`.
            self._round = [pokes.subset(slice(i, i + 1)) for i in range(len(order) - 1, -1, -1)]
        self.begun += 1
        return press(self._rig, self._round.pop(), now, self._habits, self._rng)


class ScriptedOperator:
    """Obeys a queue of orders."""

    is_finished = False

    def __init__(self, rig: Rig, habits: Habits, rng: np.random.Generator) -> None:
        self._rig, self._habits, self._rng = rig, habits, rng
        self._orders: queue.SimpleQueue[PokeOrder | PoseOrder] = queue.SimpleQueue()
        self.begun = 0
        """Number of pokes so far."""

    def accept(self, order: Order) -> None:
        """Queue an order, from any thread. Raises InputError for an unknown taxel or pose, and for `PaceOrder`."""
        if isinstance(order, PokeOrder):
            self._rig.row_of(order.channel)
        elif isinstance(order, PoseOrder):
            self._rig.arm_pose(order.name)
        else:
            raise InputError("pace is for --operator guided; expected poke or pose.")
        self._orders.put(order)

    def next(self, now: float) -> OperatorAction | None:
        try:
            order = self._orders.get_nowait()
        except queue.Empty:
            return None
        if isinstance(order, PoseOrder):
            return Move(now, now + self._habits.move_s, self._rig.arm_pose(order.name))
        self.begun += 1
        return press(self._rig, self._aimed(order), now, self._habits, self._rng)

    def _aimed(self, order: PokeOrder) -> PressedPlaces:
        habits, rng = self._habits, self._rng
        tilt = cone_tilts(1, habits.cone, rng)[0] if order.tilt is None else order.tilt
        azimuth = rng.uniform(-np.pi, np.pi) if order.azimuth is None else order.azimuth
        force = rng.uniform(*habits.force) if order.force is None else order.force
        beside = habits.aim * rng.standard_normal((1, 2))
        target = np.array([order.channel], dtype=np.int64)
        return presses_at(self._rig, target, beside, np.array([[tilt, azimuth]]), np.array([force]), rng)


class GuidedOperator(AutoOperator):
    """Pokes the shown target; without a guide it pokes like `AutoOperator`.

    The hand aims at the shown ring, not at the true taxel. A new target is used until `Habits.reaction_s` before the touch. A
    known point, such as a screw head, is poked more accurately, without slides and never ignored. Each target number is poked
    once, and answered with REACHED when the hand is back. Equal seeds and targets at equal times give equal pokes.
    """

    _newest: PokeTarget | NoTarget = NoTarget.ANY
    """Target for the next poke, set by any thread."""
    _seen: PokeTarget | NoTarget = NoTarget.ANY
    """Target of the present poke."""
    _natural: Habits | None = None
    """Habits before the first change of pace."""
    _touch: float | None = None
    """s, time of the next touch; `None` while the hand rests."""
    _poked: int = 0
    """Number of the last poked target."""
    _unanswered: int = 0
    """Target number without an answer, or 0."""
    answered: Callable[[Answer | GuidedByHand], object] | None = None
    """Receives the answers."""

    def accept(self, order: Order) -> None:
        """Change the pace, from any thread. Raises InputError for other orders."""
        if not isinstance(order, PaceOrder):
            raise InputError("poke and pose are for --operator told; expected pace, and targets over --targets.")
        self._natural = self._natural or self._habits
        self._habits = self._natural.at_pace(order.pace)

    def show(self, line: AskedLine) -> None:
        """Set the target, from any thread. Raises InputError for an unknown taxel."""
        if isinstance(line, PokeTarget) and line.channel is not None:
            self._rig.row_of(line.channel)
        # No lock: an assignment is atomic in Python.
        if isinstance(line, PokeTarget | NoTarget):
            self._newest = line

    def next(self, now: float) -> OperatorAction | None:
        self._seen, number, self._unanswered = self._newest, self._unanswered, 0
        if number and self.answered is not None:
            self.answered(Answer(AnswerKind.REACHED, number))
        if self._seen in (NoTarget.WAIT, NoTarget.STOP, NoTarget.ENOUGH):
            self._touch = None
            return None
        return super().next(now)

    def _poke(self, now: float) -> HandPress | None:
        if not isinstance(self._seen, PokeTarget):
            self._touch = None
            return super()._poke(now)
        if self._touch is None:
            self._touch = now + self._rng.uniform(*self._habits.approach_s)
        if now < self._touch - self._habits.reaction_s or self._seen.number == self._poked:
            return None
        self._poked = self._unanswered = self._seen.number
        # Other rigs find no pose of the part.
        if self._seen.known and self.answered is not None and self._rig.scene.tool is not None:
            self.answered(GuidedByHand(self._poked))
        # After a wait the touch is now, or as soon as a tool is there.
        touch, self._touch = max(self._touch, now + self._habits.tool_s), None
        self.begun += 1
        # The hand has approached while it waited for the target.
        at_once = replace(self._habits, approach_s=(0.0, 0.0))
        if self._seen.known:
            return press(self._rig, self._at_point(self._seen), touch, replace(at_once, slide_rate=0.0), self._rng)
        return press(self._rig, self._aimed(self._seen), touch, at_once, self._rng)

    def _aimed(self, target: PokeTarget) -> PressedPlaces:
        """Press at a shown target, or at a taxel of the hand's own choice."""
        habits, rng = self._habits, self._rng
        if rng.uniform() < habits.ignores:
            return unguided_presses(self._rig, rng.choice(self._channels, 1), habits, rng)
        if target.channel is not None:
            row = self._rig.row_of(target.channel)
        else:
            row = int(np.sum((self._rig.places - target.place) ** 2, axis=1).argmin())
        return aimed_presses(self._rig, np.array([row]), target.place[None], target.push[None], habits, rng)

    def _at_point(self, target: PokeTarget) -> PressedPlaces:
        """Press at a known point, which need not lie on the surface."""
        firm, rng = LandmarkHabits(), self._rng
        # Without a surface the normal is against the push.
        normal = _on_skin(self._rig, target.place[None], -target.push[None])[1]
        e1, e2 = tangents(normal)
        beside = firm.aim * rng.standard_normal(2)
        place = target.place + beside[0] * e1 + beside[1] * e2
        meant = apply_bias(target.push[None], normal, self._habits)
        push = limit_tilt(add_hand_noise(meant, self._habits.hand, rng), normal, firm.cone)
        no_taxel = np.array([-1], dtype=np.int64)
        return PressedPlaces(no_taxel, place, normal, push, rng.uniform(*firm.force, 1), np.zeros(1))


Operator: TypeAlias = AutoOperator | ScriptedOperator
