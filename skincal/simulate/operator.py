"""Simulated people who poke: how they aim and press, and who decides what they poke.

`AutoOperator` pokes every taxel by itself. `ScriptedOperator` obeys lines of text (`read_order`). `GuidedOperator` receives
targets as a robot does (`skincal/robot/target_lines.py`), answers likewise, and sometimes pokes something else.
"""

from __future__ import annotations

import queue
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.mesh.search import nearest_points
from skincal.model.errors import InputError
from skincal.robot.target_lines import Answer, AnswerKind, AskedLine, NoTarget, PokeTarget
from skincal.simulate.simulated_rig import (
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


@dataclass(frozen=True, slots=True)
class PokeOrder:
    """Poke this taxel; what is None is as the habits have it."""

    channel: int
    tilt: float | None = None
    """rad, from the inward normal."""
    azimuth: float | None = None
    """rad, from e1 to e2 of `tangents`."""
    force: float | None = None
    """N."""


@dataclass(frozen=True, slots=True)
class PoseOrder:
    """Bring the arm to this pose."""

    name: str


@dataclass(frozen=True, slots=True)
class PaceOrder:
    """Be so many times as quick between pokes as by habit."""

    pace: float

    @classmethod
    def of(cls, pace: float) -> PaceOrder:
        """Return the order; ValueError where no hand is as quick or as slow."""
        if not PACES[0] <= pace <= PACES[1]:
            raise ValueError(pace)
        return cls(pace)


Order: TypeAlias = PokeOrder | PoseOrder | PaceOrder

ORDER_HELP = "poke CHANNEL [TILT_DEG AZIMUTH_DEG FORCE_N], pose NAME or pace TIMES"
PACES = (0.1, 4.0)
"""How many times as quick as by habit a hand may be between pokes."""


def read_order(line: str) -> Order | None:
    """Read one line; None for an empty one.

    Raises
    ------
    InputError
        The line is no order.
    """
    words = line.split()
    if not words:
        return None
    try:
        order = _order_of(words)
    except ValueError:
        order = None
    if order is None:
        raise InputError(f"{line.strip()!r} is not an order; expected {ORDER_HELP}, with 0 <= tilt < 90 and force above 0.")
    return order


def _order_of(words: list[str]) -> Order | None:
    match words:
        case ["poke", channel]:
            return PokeOrder(int(channel))
        case ["poke", channel, *numbers] if len(numbers) == 3:
            tilt, azimuth, force = map(float, numbers)
            if 0 <= tilt < 90 and 0 < force < 1000 and np.isfinite(azimuth):
                return PokeOrder(int(channel), float(np.radians(tilt)), float(np.radians(azimuth)), force)
        case ["pose" | "pace" as what, value]:
            return PoseOrder(value) if what == "pose" else PaceOrder.of(float(value))
        case _:
            pass
    return None


@dataclass(frozen=True, slots=True)
class Habits:
    """How somebody pokes; SI units."""

    force: tuple[float, float] = (6.0, 12.0)
    """N, uniform: well inside the force window of 4 to 15 N."""
    cone: float = float(np.radians(30.0))
    """rad. Pushes lie within it about the inward normal, uniform in solid angle: the friction of a tip on foam."""
    aim: float = 0.002
    """m, sd of the place in each tangent direction. Half the side of the 4 mm tip. Assumed."""
    approach_s: tuple[float, float] = (0.4, 0.9)
    """s, hand on its way, nothing touched. With the rest, about 2.2 s a poke: brisk. Assumed."""
    ramp_s: tuple[float, float] = (0.15, 0.30)
    """s, from touch to full force."""
    hold_s: tuple[float, float] = (0.4, 0.8)
    """s, held: longer than the still window of 0.3 s. Assumed."""
    release_s: tuple[float, float] = (0.10, 0.20)
    """s, from full force to none."""
    rest_s: tuple[float, float] = (0.3, 0.6)
    """s, quiet after the release, before the hand moves on."""
    tremor: float = 0.015
    """Amplitude of the tremor as a share of the force: well inside the 5 % that a still window allows."""
    tremor_hz: tuple[float, float] = (8.0, 12.0)
    """Hz. Physiological tremor of the hand."""
    slide_rate: float = 0.03
    """Share of the pokes that slide while held. Assumed."""
    slide: tuple[float, float] = (0.003, 0.006)
    """m, how far they slide."""
    double_rate: float = 0.03
    """Share of the pokes that touch a second place. Assumed."""
    double_share: tuple[float, float] = (0.2, 0.5)
    """Force at the second place, as a share of the first."""
    double_away: tuple[float, float] = (0.015, 0.060)
    """m, uniform: how far beside the first place another finger or a sleeve touches (`touches_beside`). Assumed."""
    move_s: float = 2.0
    """s, for the arm to go to another pose."""
    hand: float = float(np.radians(6.0))
    """rad, sd of the push about the one that is asked for, in each direction. Assumed."""
    side: float = 0.0
    """rad, from e1 to e2 of `tangents`: the side of the hand, for the two below."""
    bias: float = 0.0
    """rad: every push leans so much more towards that side."""
    arc: float = 2.0 * float(np.pi)
    """rad: pushes lean towards an arc of this breadth about that side alone; 0 for always the same."""
    ignores: float = 1.0 / 12.0
    """Share of the pokes in which somebody who is shown a target pokes a taxel of their own choice. Assumed."""
    reaction_s: float = 0.25
    """s before the touch: another target that is shown later comes too late. A simple visual reaction."""

    @property
    def leans(self) -> bool:
        """Whether pushes are not just as they are meant, but for the hand's error."""
        return self.bias != 0.0 or self.arc < 2.0 * np.pi

    @classmethod
    def careful(cls) -> Habits:
        """Return the habits of somebody who never slides and never touches twice."""
        return cls(slide_rate=0.0, double_rate=0.0)

    def at_pace(self, pace: float) -> Habits:
        """Return the habits of somebody whose hand is `pace` times as quick between pokes; presses take as long as they do."""
        approach, rest = (tuple(s / pace for s in times) for times in (self.approach_s, self.rest_s))
        return replace(self, approach_s=approach, rest_s=rest, reaction_s=self.reaction_s / pace)


OPERATORS: Mapping[str, Habits] = {
    "careful": Habits.careful(),
    "two_taxels": replace(Habits.careful(), double_rate=1.0, double_share=(0.4, 1.0), double_away=(0.005, 0.008)),
    "biased": replace(Habits.careful(), bias=float(np.radians(15.0)), side=float(np.radians(-60.0))),
    "left_handed": replace(Habits.careful(), bias=float(np.radians(15.0)), side=float(np.radians(120.0))),
    "arc": replace(Habits.careful(), arc=float(np.radians(120.0)), side=float(np.radians(-90.0))),
    "one_side": replace(Habits.careful(), arc=0.0, bias=float(np.radians(20.0)), side=float(np.radians(-90.0))),
}
"""Hands unlike the one that the guide's thresholds were found with: a finger that covers two taxels in every poke, hands that
lean to one side, that reach the part from a third of its sides, or from one only."""


def apply_bias(pushes: FloatArray, normals: FloatArray, habits: Habits) -> FloatArray:
    """Return the pushes (n, 3) that somebody makes of those meant, on skin with the outward `normals`: see `Habits.side`."""
    if not habits.leans:
        return pushes
    # A push that grazes leans as far as one can.
    inward = np.maximum(-np.sum(pushes * normals, axis=1, keepdims=True), 1e-3)
    e1, e2 = tangents(normals)
    # Slopes beside the normal, as seen from the hand's side.
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
    """How somebody pokes landmarks; SI units."""

    force: tuple[float, float] = (8.0, 13.0)
    """N, uniform: metal, so one presses harder than on foam."""
    cone: float = float(np.radians(28.0))
    """rad. Pushes lie within it about the inward normal, uniform in solid angle."""
    aim: float = 0.0007
    """m, sd of the place in each tangent direction: a tip in the slot of a screw. Assumed."""


@dataclass(frozen=True, slots=True, eq=False)
class HandPress:
    """One press over time: nothing, ramp, hold, release, nothing."""

    begin: float
    """s, first touch."""
    ramp: float
    hold: float
    release: float
    free: float
    """s, when the operator is ready for the next."""
    pokes: PressedPlaces
    """One place; two where something else touches too."""
    slide: FloatArray
    """(3,) float, metres, link frame: travel during the hold."""
    tremor: float
    tremor_hz: float
    tremor_phase: float

    @property
    def end(self) -> float:
        """When the tip has left, seconds."""
        return self.begin + self.ramp + self.hold + self.release

    def load(self, times: FloatArray) -> FloatArray:
        """Return (n,) the force as a share of the force while held."""
        since = times - self.begin
        rise = _smooth_step(since / self.ramp)
        fall = _smooth_step((since - self.ramp - self.hold) / self.release)
        shake = 1.0 + self.tremor * np.sin(2 * np.pi * self.tremor_hz * since + self.tremor_phase)
        return rise * (1.0 - fall) * shake

    def travel(self, times: FloatArray) -> FloatArray:
        """Return (n, 3) how far the tip has slid, metres."""
        return np.clip((times - self.begin - self.ramp) / self.hold, 0.0, 1.0)[:, None] * self.slide


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """The arm goes to another pose."""

    begin: float
    free: float
    arm_pose: SimulatedArmPose


OperatorAction: TypeAlias = HandPress | Move


def _smooth_step(share: FloatArray) -> FloatArray:
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(share, 0.0, 1.0))


def unguided_presses(rig: Rig, targets: IntArray, habits: Habits, rng: np.random.Generator) -> PressedPlaces:
    """Return unguided pokes at taxels (n,): beside them by the aim error, from a random side within the cone."""
    count = len(targets)
    tilts = cone_tilts(count, habits.cone, rng)
    azimuths = rng.uniform(-np.pi, np.pi, count)
    forces = rng.uniform(*habits.force, count)
    meant = presses_at(rig, targets, habits.aim * rng.standard_normal((count, 2)), tilts, azimuths, forces, rng)
    if not habits.leans:
        return meant
    return replace(
        meant, directions=limit_tilt(apply_bias(meant.directions, meant.normals, habits), meant.normals, habits.cone)
    )


def presses_at(
    rig: Rig,
    targets: IntArray,
    beside: FloatArray,
    tilts: FloatArray,
    azimuths: FloatArray,
    forces: FloatArray,
    rng: np.random.Generator,
) -> PressedPlaces:
    """Return n pokes, each `beside` (n, 2), metres, a target in its plane; `tilts` and `azimuths` as for `push_directions`."""
    rows = np.array([rig.row_of(int(channel)) for channel in targets], dtype=np.int64)
    e1, e2 = tangents(rig.normals[rows])
    points, normals = _on_skin(rig, rig.places[rows] + beside[:, :1] * e1 + beside[:, 1:] * e2, rig.normals[rows])
    directions = push_directions(normals, tilts, azimuths)
    return PressedPlaces(targets, points, normals, directions, forces, rng.uniform(0.0, np.pi / 2, len(rows)))


def aimed_presses(
    rig: Rig, rows: IntArray, places: FloatArray, pushes: FloatArray, habits: Habits, rng: np.random.Generator
) -> PressedPlaces:
    """Simulate a hand that aims at shown places (n, 3), metres, with unit pushes (n, 3).

    Places move to the surface, or without a surface to the plane of the taxels in `rows` (n,).
    """
    count = len(places)
    places, normals = _on_part(rig, rows, places)
    e1, e2 = tangents(normals)
    offset = habits.aim * rng.standard_normal((count, 2))
    points, normals = _on_part(rig, rows, places + offset[:, :1] * e1 + offset[:, 1:] * e2)
    pushes = limit_tilt(add_hand_noise(apply_bias(pushes, normals, habits), habits.hand, rng), normals, habits.cone)
    forces, turns = rng.uniform(*habits.force, count), rng.uniform(0.0, np.pi / 2, count)
    return PressedPlaces(rig.channels[rows], points, normals, pushes, forces, turns)


def _on_part(rig: Rig, rows: IntArray, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the nearest places on the surface, or without one in the planes of taxels; and the normals there."""
    if rig.surface is not None:
        return _on_skin(rig, places, places)
    normals = rig.normals[rows]
    return places - np.sum((places - rig.places[rows]) * normals, axis=1, keepdims=True) * normals, normals


def _on_skin(rig: Rig, points: FloatArray, normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return points brought back onto the surface, and its normals there; where there is none, what is given."""
    if rig.surface is None:
        return points, normals
    on_surface, triangles = nearest_points(rig.surface, points)
    return on_surface, rig.surface.normals[triangles]


def press(rig: Rig, pokes: PressedPlaces, now: float, habits: Habits, rng: np.random.Generator) -> HandPress:
    """Return one press of the first place in `pokes`, by a hand that sets out at `now`, s, with the habits' accidents."""
    begin = now + rng.uniform(*habits.approach_s)
    ramp, hold, release = rng.uniform(*habits.ramp_s), rng.uniform(*habits.hold_s), rng.uniform(*habits.release_s)
    free = begin + ramp + hold + release + rng.uniform(*habits.rest_s)
    # Drawn together for every press: whether it slides does not change what the other accident draws.
    slides, doubles = rng.uniform(size=2) < (habits.slide_rate, habits.double_rate)
    first = pokes.take(slice(0, 1))
    both = join([first, _second(rig, first, habits, rng)]) if doubles else first
    slide = np.zeros(3)
    if slides:
        (e1,), (e2,) = tangents(first.normals)
        angle = rng.uniform(0.0, 2 * np.pi)
        slide = rng.uniform(*habits.slide) * (np.cos(angle) * e1 + np.sin(angle) * e2)
    hz, phase = rng.uniform(*habits.tremor_hz), rng.uniform(0.0, 2 * np.pi)
    return HandPress(begin, ramp, hold, release, free, both, slide, habits.tremor, hz, phase)


def _second(rig: Rig, first: PressedPlaces, habits: Habits, rng: np.random.Generator) -> PressedPlaces:
    """Return the second place of a double touch: another taxel's, pushed at another angle."""
    target = rng.choice(rig.channels, 1)
    second = unguided_presses(rig, target, habits, rng)
    forces = first.forces * rng.uniform(*habits.double_share)
    return PressedPlaces(target, second.points, second.normals, second.directions, forces, second.turns)


def touches_beside(rig: Rig, pokes: PressedPlaces, habits: Habits, rng: np.random.Generator) -> tuple[IntArray, PressedPlaces]:
    """Return which of the pokes touch a second place, rows (m,), and these m places: on the skin, or on the part beside it."""
    rows = np.flatnonzero(rng.uniform(size=len(pokes)) < habits.double_rate)
    count, first = len(rows), pokes.take(rows)
    e1, e2 = tangents(first.normals)
    azimuths, away = rng.uniform(-np.pi, np.pi, count)[:, None], rng.uniform(*habits.double_away, count)[:, None]
    beside = first.points + away * (np.cos(azimuths) * e1 + np.sin(azimuths) * e2)
    beside, normals = _on_skin(rig, beside, first.normals)
    directions = push_directions(normals, cone_tilts(count, habits.cone, rng), rng.uniform(-np.pi, np.pi, count))
    forces = first.forces * rng.uniform(*habits.double_share, count)
    return rows, PressedPlaces(first.targets, beside, normals, directions, forces, rng.uniform(0.0, np.pi / 2, count))


class AutoOperator:
    """Pokes by itself: every taxel once in a random order, then again; arm poses one after another.

    Parameters
    ----------
    pokes : how many to do; None never ends
    poses : names of arm poses, an equal share of the pokes each; with `pokes` None each gets `ROUND` pokes
    channels : taxels to poke; all where None
    """

    ROUND = 84
    """Pokes before the arm moves on, where the number of pokes is open: one for each taxel of the paper's forearm."""

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
        self._each = self.ROUND if pokes is None else max(1, -(-pokes // len(self._arm_poses)))
        self._round: list[PressedPlaces] = []
        self.begun = 0
        """Pokes begun so far."""
        self._arm_pose = rig.arm_pose()

    @property
    def done(self) -> bool:
        """All pokes are done."""
        return self._pokes is not None and self.begun >= self._pokes

    def next(self, now: float) -> OperatorAction | None:
        """Return the next poke, or the way to the next arm pose."""
        if self.done:
            return None
        wanted = self._arm_poses[self.begun // self._each % len(self._arm_poses)]
        if wanted is not self._arm_pose:
            self._arm_pose = wanted
            return Move(now, now + self._habits.move_s, wanted)
        return self._poke(now)

    def _poke(self, now: float) -> HandPress | None:
        """Return the next poke; None where there is none yet."""
        if not self._round:
            order = self._rng.permutation(self._channels)
            pokes = unguided_presses(self._rig, order, self._habits, self._rng)
            # Backwards, since `pop` takes from the end.
            self._round = [pokes.take(slice(i, i + 1)) for i in range(len(order) - 1, -1, -1)]
        self.begun += 1
        return press(self._rig, self._round.pop(), now, self._habits, self._rng)


class ScriptedOperator:
    """Does what a queue says, one after another. Orders are checked when they are put in: see `accept`."""

    done = False

    def __init__(self, rig: Rig, habits: Habits, rng: np.random.Generator) -> None:
        self._rig, self._habits, self._rng = rig, habits, rng
        self._orders: queue.SimpleQueue[PokeOrder | PoseOrder] = queue.SimpleQueue()
        self.begun = 0
        """Pokes begun so far."""

    def accept(self, order: Order) -> None:
        """Queue an order, from any thread.

        Raises
        ------
        InputError
            There is no such taxel or pose, or the order is a guide's.
        """
        if isinstance(order, PokeOrder):
            self._rig.row_of(order.channel)
        elif isinstance(order, PoseOrder):
            self._rig.arm_pose(order.name)
        else:
            raise InputError("pace is for --operator guided; expected poke or pose.")
        self._orders.put(order)

    def next(self, now: float) -> OperatorAction | None:
        """Return the next order as an action; None while there is none."""
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
        return presses_at(self._rig, target, beside, np.array([tilt]), np.array([azimuth]), np.array([force]), rng)


class GuidedOperator(AutoOperator):
    """Pokes the target that is shown; by itself, as `AutoOperator`, as long as nobody guides.

    The guide's ring is drawn where it believes the taxel to be, on the part; that is where the hand goes, beside the true
    taxel if need be. The person looks at the screen until the hand goes down: a target that comes earlier than a reaction
    before the touch still counts, a later one is for the next poke. A known point of the part, such as a screw head, is
    seen and felt: the hand goes to it more exactly, and neither slides off nor pokes something else instead.

    Each number that is asked for is poked once, and said to be reached when the hand is back.

    The same seed and the same targets at the same times give the same pokes. `channels` are for pokes of its own choice.
    """

    _newest: PokeTarget | NoTarget = NoTarget.ANY
    """From any thread."""
    _seen: PokeTarget | NoTarget = NoTarget.ANY
    """What is on the screen now."""
    _natural: Habits | None = None
    """Those that it began with, once its pace was changed."""
    _touch: float | None = None
    """s, when the hand that is on its way will touch."""
    _poked: int = 0
    """Number of the target that was poked last."""
    _to_say: int = 0
    """The same until it is said to be reached, else 0."""
    answered: Callable[[Answer], object] | None = None
    """Is told what a robot would answer."""

    def accept(self, order: Order) -> None:
        """Be so quick from now on, from any thread; InputError where the order is another one."""
        if not isinstance(order, PaceOrder):
            raise InputError("poke and pose are for --operator told; expected pace, and targets over --targets.")
        self._natural = self._natural or self._habits
        self._habits = self._natural.at_pace(order.pace)

    def show(self, line: AskedLine) -> None:
        """Take what the guide asks for now, from any thread; InputError where there is no such taxel."""
        if isinstance(line, PokeTarget) and line.channel is not None:
            self._rig.row_of(line.channel)
        # Without a lock: in Python one assignment is seen whole by every thread.
        if isinstance(line, PokeTarget | NoTarget):
            self._newest = line

    def next(self, now: float) -> OperatorAction | None:
        """Return the next poke, or the way to the next arm pose; None while the hand is on its way, or has to wait."""
        self._seen, said, self._to_say = self._newest, self._to_say, 0
        if said and self.answered is not None:
            self.answered(Answer(AnswerKind.REACHED, said))
        if self._seen in (NoTarget.WAIT, NoTarget.ENOUGH):
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
        self._poked = self._to_say = self._seen.number
        # A hand that had to wait touches now, not in the past.
        touch, self._touch = max(self._touch, now), None
        self.begun += 1
        # Its approach is over: the hand has been on its way since it saw a target.
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
        """Return how the hand pokes a known point: there, whether or not the surface and the skin pass through it."""
        firm, rng = LandmarkHabits(), self._rng
        # Without a surface the push itself says which way is outward.
        normal = _on_skin(self._rig, target.place[None], -target.push[None])[1]
        e1, e2 = tangents(normal)
        beside = firm.aim * rng.standard_normal(2)
        place = target.place + beside[0] * e1 + beside[1] * e2
        meant = apply_bias(target.push[None], normal, self._habits)
        push = limit_tilt(add_hand_noise(meant, self._habits.hand, rng), normal, firm.cone)
        nobody = np.array([-1], dtype=np.int64)
        return PressedPlaces(nobody, place, normal, push, rng.uniform(*firm.force, 1), np.zeros(1))


Operator: TypeAlias = AutoOperator | ScriptedOperator
