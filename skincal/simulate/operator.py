"""A person who pokes: where, which way, how hard and for how long.

Two operators: `Auto` goes round the taxels by itself, unguided; `Told` does what a queue says. A third one follows a target:
`skincal/simulate/follow.py`.
"""

from __future__ import annotations

import queue
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias

import numpy as np

from skincal.geometry.arrays import FloatArray, IntArray
from skincal.mesh.search import nearest_points
from skincal.model.errors import InputError
from skincal.simulate.orders import Order, PokeOrder, PoseOrder
from skincal.simulate.poke import Pokes, cone_tilts, join, push_directions, tangents
from skincal.simulate.rig import Rig, Stance


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
    ignores: float = 1.0 / 12.0
    """Share of the pokes in which somebody who is shown a target pokes a taxel of their own choice. Assumed."""
    reaction_s: float = 0.25
    """s before the touch: another target that is shown later comes too late. A simple visual reaction."""

    @classmethod
    def careful(cls) -> Habits:
        """Return the habits of somebody who never slides and never touches twice."""
        return cls(slide_rate=0.0, double_rate=0.0)

    def at_pace(self, pace: float) -> Habits:
        """Return the habits of somebody whose hand is `pace` times as quick between pokes; presses take as long as they do."""
        approach, rest = (tuple(s / pace for s in times) for times in (self.approach_s, self.rest_s))
        return replace(self, approach_s=approach, rest_s=rest, reaction_s=self.reaction_s / pace)


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """One press over time: nothing, ramp, hold, release, nothing."""

    begin: float
    """s, first touch."""
    ramp: float
    hold: float
    release: float
    free: float
    """s, when the operator is ready for the next."""
    pokes: Pokes
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

    def moved(self, travel: FloatArray) -> Pokes:
        """Return the places, slid by (3,) `travel`."""
        return replace(self.pokes, points=self.pokes.points + travel)

    def travel(self, times: FloatArray) -> FloatArray:
        """Return (n, 3) how far the tip has slid, metres."""
        return np.clip((times - self.begin - self.ramp) / self.hold, 0.0, 1.0)[:, None] * self.slide


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """The arm goes to another pose."""

    begin: float
    free: float
    stance: Stance


Action: TypeAlias = Press | Move


class Operator(Protocol):
    """Somebody who acts on the rig."""

    @property
    def done(self) -> bool:
        """Nothing more will come."""
        ...

    def next(self, now: float) -> Action | None:
        """Return what begins at or after `now` seconds; None where there is nothing to do yet."""
        ...


def _smooth_step(share: FloatArray) -> FloatArray:
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(share, 0.0, 1.0))


def aim(rig: Rig, targets: IntArray, habits: Habits, rng: np.random.Generator) -> Pokes:
    """Return unguided pokes at taxels: beside them by the aim error, from a random side within the cone.

    Parameters
    ----------
    targets : (n,) channels
    """
    count = len(targets)
    tilts = cone_tilts(count, habits.cone, rng)
    azimuths = rng.uniform(-np.pi, np.pi, count)
    forces = rng.uniform(*habits.force, count)
    return place(rig, targets, habits.aim * rng.standard_normal((count, 2)), tilts, azimuths, forces, rng)


def place(
    rig: Rig,
    targets: IntArray,
    beside: FloatArray,
    tilts: FloatArray,
    azimuths: FloatArray,
    forces: FloatArray,
    rng: np.random.Generator,
) -> Pokes:
    """Return pokes at given places.

    Parameters
    ----------
    targets : (n,) channels
    beside : (n, 2) float, metres, from the taxel in its plane
    tilts, azimuths : (n,) float, radians, of the push; see `push_directions`
    forces : (n,) float, N
    """
    rows = np.array([rig.row_of(int(channel)) for channel in targets], dtype=np.int64)
    e1, e2 = tangents(rig.normals[rows])
    points, normals = _on_skin(rig, rows, rig.places[rows] + beside[:, :1] * e1 + beside[:, 1:] * e2)
    directions = push_directions(normals, tilts, azimuths)
    return Pokes(targets, points, normals, directions, forces, rng.uniform(0.0, np.pi / 2, len(rows)))


def _on_skin(rig: Rig, rows: IntArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bring points back onto the surface; where there is none they lie in their taxel's plane already."""
    if rig.surface is None:
        return points, rig.normals[rows]
    on_surface, triangles = nearest_points(rig.surface, points)
    return on_surface, rig.surface.normals[triangles]


def press(rig: Rig, pokes: Pokes, now: float, habits: Habits, rng: np.random.Generator) -> Press:
    """Return one press of the first place in `pokes`, with the habits' accidents.

    Parameters
    ----------
    pokes : at least one place
    now : s, when the hand sets out
    """
    begin = now + rng.uniform(*habits.approach_s)
    ramp, hold, release = rng.uniform(*habits.ramp_s), rng.uniform(*habits.hold_s), rng.uniform(*habits.release_s)
    free = begin + ramp + hold + release + rng.uniform(*habits.rest_s)
    slides, doubles = rng.uniform(size=2) < (habits.slide_rate, habits.double_rate)
    first = pokes.take(slice(0, 1))
    both = join([first, _second(rig, first, habits, rng)]) if doubles else first
    slide = _slide(first, habits, rng) if slides else np.zeros(3)
    hz, phase = rng.uniform(*habits.tremor_hz), rng.uniform(0.0, 2 * np.pi)
    return Press(begin, ramp, hold, release, free, both, slide, habits.tremor, hz, phase)


def _slide(poke: Pokes, habits: Habits, rng: np.random.Generator) -> FloatArray:
    e1, e2 = tangents(poke.normals)
    angle = rng.uniform(0.0, 2 * np.pi)
    return rng.uniform(*habits.slide) * (np.cos(angle) * e1[0] + np.sin(angle) * e2[0])


def _second(rig: Rig, first: Pokes, habits: Habits, rng: np.random.Generator) -> Pokes:
    """Return the second place of a double touch: another taxel's, pushed at another angle."""
    target = rng.choice(rig.channels, 1)
    second = aim(rig, target, habits, rng)
    forces = first.forces * rng.uniform(*habits.double_share)
    return Pokes(target, second.points, second.normals, second.directions, forces, second.turns)


def touches_beside(rig: Rig, pokes: Pokes, habits: Habits, rng: np.random.Generator) -> tuple[IntArray, Pokes]:
    """Return which of the pokes touch a second place, and these places: on the skin, or on the part beside it.

    Parameters
    ----------
    pokes : n places; `habits.double_rate` of them are touched twice

    Returns
    -------
    rows : (m,) ascending, of `pokes`
    seconds : m places, pressed by `habits.double_share` of the poke's force; their targets are those of the pokes
    """
    rows = np.flatnonzero(rng.uniform(size=len(pokes)) < habits.double_rate)
    count, first = len(rows), pokes.take(rows)
    e1, e2 = tangents(first.normals)
    azimuths, away = rng.uniform(-np.pi, np.pi, count)[:, None], rng.uniform(*habits.double_away, count)[:, None]
    beside = first.points + away * (np.cos(azimuths) * e1 + np.sin(azimuths) * e2)
    normals = first.normals
    if rig.surface is not None:
        beside, triangles = nearest_points(rig.surface, beside)
        normals = rig.surface.normals[triangles]
    directions = push_directions(normals, cone_tilts(count, habits.cone, rng), rng.uniform(-np.pi, np.pi, count))
    forces = first.forces * rng.uniform(*habits.double_share, count)
    return rows, Pokes(first.targets, beside, normals, directions, forces, rng.uniform(0.0, np.pi / 2, count))


class Auto:
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
        self._stances = [rig.stance(name) for name in poses] or [rig.stance()]
        self._channels = rig.channels if channels is None else np.array(channels, dtype=np.int64)
        self._each = self.ROUND if pokes is None else max(1, -(-pokes // len(self._stances)))
        self._round: list[Pokes] = []
        self.begun = 0
        """Pokes begun so far."""
        self._stance = rig.stance()

    @property
    def done(self) -> bool:
        """All pokes are done."""
        return self._pokes is not None and self.begun >= self._pokes

    def next(self, now: float) -> Action | None:
        """Return the next poke, or the way to the next arm pose."""
        if self.done:
            return None
        wanted = self._stances[self.begun // self._each % len(self._stances)]
        if wanted is not self._stance:
            self._stance = wanted
            return Move(now, now + self._habits.move_s, wanted)
        return self._poke(now)

    def _poke(self, now: float) -> Press | None:
        """Return the next poke; None where there is none yet."""
        if not self._round:
            order = self._rng.permutation(self._channels)
            pokes = aim(self._rig, order, self._habits, self._rng)
            self._round = [pokes.take(slice(i, i + 1)) for i in range(len(order) - 1, -1, -1)]
        self.begun += 1
        return press(self._rig, self._round.pop(), now, self._habits, self._rng)


class Told:
    """Does what a queue says, one after another; None in the queue ends it.

    Orders are checked when they are put in: see `accept`.
    """

    def __init__(self, rig: Rig, habits: Habits, rng: np.random.Generator) -> None:
        self._rig, self._habits, self._rng = rig, habits, rng
        self._orders: queue.SimpleQueue[PokeOrder | PoseOrder | None] = queue.SimpleQueue()
        self.done = False

    def accept(self, order: Order | None) -> None:
        """Queue an order, from any thread; None for the last.

        Raises
        ------
        InputError
            There is no such taxel or pose, or the order is a guide's.
        """
        if isinstance(order, PokeOrder):
            self._rig.row_of(order.channel)
        elif isinstance(order, PoseOrder):
            self._rig.stance(order.name)
        elif order is not None:
            raise InputError("target, any and wait are for --operator guided; expected poke or pose.")
        self._orders.put(order)

    def next(self, now: float) -> Action | None:
        """Return the next order as an action; None while there is none."""
        if self.done:
            return None
        try:
            order = self._orders.get_nowait()
        except queue.Empty:
            return None
        if order is None:
            self.done = True
            return None
        if isinstance(order, PoseOrder):
            return Move(now, now + self._habits.move_s, self._rig.stance(order.name))
        return press(self._rig, self._aimed(order), now, self._habits, self._rng)

    def _aimed(self, order: PokeOrder) -> Pokes:
        habits, rng = self._habits, self._rng
        tilt = cone_tilts(1, habits.cone, rng)[0] if order.tilt is None else order.tilt
        azimuth = rng.uniform(-np.pi, np.pi) if order.azimuth is None else order.azimuth
        force = rng.uniform(*habits.force) if order.force is None else order.force
        beside = habits.aim * rng.standard_normal((1, 2))
        target = np.array([order.channel], dtype=np.int64)
        return place(self._rig, target, beside, np.array([tilt]), np.array([azimuth]), np.array([force]), rng)
