"""Ways to poke a part, and a hand that pokes what is asked for as well as a hand can.

The part is the forearm that ships, whose skin lies 4 mm beside its plan as a whole. Nobody knows that: all aim at where the
plan, laid on the surface, puts a taxel; only the guide learns from what is measured. The rig is a good one: 0.10 N and
10 N mm a poke, 6 to 12 N, tared around every poke, in the arm pose with the sensor 0.18 m from the skin.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry.arrays import FloatArray, IntArray
from skincal.mesh.search import nearest_points
from skincal.simulate.benches import Bench
from skincal.simulate.contacts import RECIPE_TILT, RECIPE_TURN, TareTiming, simulate_contacts
from skincal.simulate.faults import RigErrors
from skincal.simulate.operator import Habits
from skincal.simulate.poke import PressedPlaces, by_hand, cone_tilts, held, push_directions, tangents
from skincal.simulate.simulated_rig import Rig

POSE = "2"
"""Of the scene's arm poses the one whose lever is 0.18 m."""
BESIDE = 0.004
"""m: the skin beside its plan, as a whole; this much in two directions together."""
FORCE = (6.0, 12.0)
"""N, of a hand."""
UNKNOWN = 0.060
"""m: what a taxel without an estimate counts: the size of the patch."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """How well somebody pokes on which rig."""

    aim: float = 0.002
    """m, sd of the place in each direction."""
    hand: float = float(np.radians(6.0))
    """rad, sd of the push about the one meant, in each direction."""
    usable: float = float(np.radians(30.0))
    """rad: a push that leans more slides off, so the hand takes it back to this."""
    drift: float = 0.0
    """N rms of drift in half an hour."""
    doubled: float = 0.0
    """Share of the pokes that touch a second place too."""

    @property
    def errors(self) -> RigErrors:
        """The rig's."""
        good = RigErrors.noise()
        moment = good.drift_moment / good.drift_force if good.drift_force else 0.024
        return replace(
            good, mount_shift=BESIDE / float(np.sqrt(2.0)), mount_turn=0.0, drift_force=self.drift,
            drift_moment=self.drift * moment,
        )  # fmt: skip


def rig_beside(part: Bench, conditions: Conditions, seed: int) -> Rig:
    """Return a rig whose skin lies beside its plan its own way."""
    return Rig(part.scene, part.surface, conditions.errors, np.random.default_rng([seed, 7]))


@dataclass(frozen=True, slots=True, eq=False)
class MeantPokes:
    """n pokes that somebody means to make."""

    places: FloatArray
    """(n, 3) float, metres."""
    pushes: FloatArray
    """(n, 3) float, unit."""


def poked(
    part: Bench, rig: Rig, wish: MeantPokes, conditions: Conditions, rng: np.random.Generator, first: int
) -> tuple[list[Contact], PressedPlaces]:
    """Return the contacts that a hand makes of a wish, and where they were; the first has the number `first`."""
    count = len(wish.places)
    on, triangles = nearest_points(part.surface, wish.places)
    e1, e2 = tangents(part.surface.normals[triangles])
    beside = conditions.aim * rng.standard_normal((count, 2))
    points, triangles = nearest_points(part.surface, on + beside[:, :1] * e1 + beside[:, 1:] * e2)
    normals = part.surface.normals[triangles]
    pushes = held(by_hand(wish.pushes, conditions.hand, rng), normals, conditions.usable)
    pokes = PressedPlaces(
        np.zeros(count, dtype=np.int64), points, normals, pushes, rng.uniform(*FORCE, count), rng.uniform(0, np.pi / 2, count)
    )
    habits = replace(Habits.careful(), double_rate=conditions.doubled)
    return simulate_contacts(rig, pokes, rng, POSE, first, TareTiming.POKE, habits), pokes


# ---- ways that follow no measurement ----

PokingWay: TypeAlias = Callable[[Bench, Conditions, int, np.random.Generator], MeantPokes]
"""Gives so many pokes."""


def _at(part: Bench, rows: IntArray, tilts: FloatArray, azimuths: FloatArray) -> MeantPokes:
    normals = part.plan.normals[rows]
    return MeantPokes(part.plan.places[rows], push_directions(normals, tilts, azimuths))


def _straight(part: Bench, rows: IntArray) -> MeantPokes:
    return _at(part, rows, np.zeros(len(rows)), np.zeros(len(rows)))


def _rounds(part: Bench, count: int, rng: np.random.Generator) -> IntArray:
    taxels = len(part.plan.channels)
    return np.concatenate([rng.permutation(taxels) for _ in range(-(-count // taxels))])[:count]


def clumped(part: Bench, conditions: Conditions, count: int, rng: np.random.Generator) -> MeantPokes:
    """Poke as people do who are told nothing: favourite places again and again, along the normal."""
    del conditions
    liked = np.exp(1.5 * rng.standard_normal(len(part.plan.channels)))
    return _straight(part, rng.choice(len(liked), count, p=liked / liked.sum()))


def random(part: Bench, conditions: Conditions, count: int, rng: np.random.Generator) -> MeantPokes:
    """Poke anywhere, along the normal."""
    del conditions
    return _straight(part, rng.integers(len(part.plan.channels), size=count))


def random_sides(part: Bench, conditions: Conditions, count: int, rng: np.random.Generator) -> MeantPokes:
    """Poke anywhere from any side that friction holds."""
    rows = rng.integers(len(part.plan.channels), size=count)
    return _at(part, rows, cone_tilts(count, conditions.usable, rng), rng.uniform(-np.pi, np.pi, count))


def round_robin(part: Bench, conditions: Conditions, count: int, rng: np.random.Generator) -> MeantPokes:
    """Poke each taxel once a round, along the normal."""
    del conditions
    return _straight(part, _rounds(part, count, rng))


def tilt_recipe(part: Bench, conditions: Conditions, count: int, rng: np.random.Generator) -> MeantPokes:
    """Poke each taxel once a round, tilted, the tilt turned with each round: what can be printed on a card."""
    rows = _rounds(part, count, rng)
    turns = np.asarray(RECIPE_TURN * (np.arange(count) // len(part.plan.channels)), dtype=np.float64)
    return _at(part, rows, np.full(count, min(RECIPE_TILT, conditions.usable)), turns)


WAYS: dict[str, PokingWay] = {
    "clumped": clumped,
    "random": random,
    "random_sides": random_sides,
    "round_robin": round_robin,
    "tilt_recipe": tilt_recipe,
}
"""By the name in JSON."""
