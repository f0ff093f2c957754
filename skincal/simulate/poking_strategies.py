"""Ways to poke a part, and a hand that pokes what is asked for as well as a hand can.

The part is the forearm that ships, whose skin lies 4 mm beside its plan as a whole. Nobody knows that: all aim at where the
plan, laid on the surface, puts a taxel; only the guide learns from what is measured. The rig is a good one: 0.10 N and
10 N mm a poke, 6 to 12 N, tared around every poke, in the arm pose with the sensor 0.18 m from the skin.

How the error of a session falls with its pokes: one course for each way to poke, method, conditions and seed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray
from skincal.guide.guidance import Guidance, GuidePhase, Target
from skincal.guide.guide import Guide
from skincal.guide.progress import GuideSettings
from skincal.mesh.search import nearest_points
from skincal.session.session import Session
from skincal.simulate.contacts import CYCLE_S, RECIPE_TILT, RECIPE_TURN, simulate_contacts
from skincal.simulate.example_parts import ExamplePart
from skincal.simulate.operator import OPERATORS, Habits, apply_bias, unguided_presses
from skincal.simulate.rig_errors import RigErrors
from skincal.simulate.simulated_rig import PressedPlaces, Rig, add_hand_noise, limit_tilt, push_directions, tangents
from skincal.taxels.result import Estimate, Method

POSE = "2"
"""Of the scene's arm poses the one whose lever is 0.18 m."""
BESIDE = 0.004
"""m: the skin beside its plan, as a whole; this much in two directions together."""
FORCE = (6.0, 12.0)
"""N, of a hand."""
CAREFUL = OPERATORS["careful"]
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
    habits: Habits = CAREFUL
    """Of the hand, beside these."""

    @property
    def errors(self) -> RigErrors:
        """The rig's."""
        beside = replace(RigErrors.noise(), mount_shift=BESIDE / float(np.sqrt(2.0)), mount_turn=0.0)
        # N m to N as the ranges of the FT45, 35 N m to 1500 N.
        return replace(beside, drift_force=self.drift, drift_moment=self.drift * 0.024)


def displaced_rig(part: ExamplePart, conditions: Conditions, seed: int) -> Rig:
    """Return a rig whose skin lies beside its plan its own way."""
    return Rig(part.scene, part.surface, conditions.errors, np.random.default_rng([seed, 7]))


@dataclass(frozen=True, slots=True, eq=False)
class MeantPokes:
    """n pokes that somebody means to make."""

    places: FloatArray
    """(n, 3) float, metres."""
    pushes: FloatArray
    """(n, 3) float, unit."""


def poke_by_hand(
    part: ExamplePart, rig: Rig, meant: MeantPokes, conditions: Conditions, rng: np.random.Generator, first: int
) -> tuple[list[Contact], PressedPlaces]:
    """Return the contacts that a hand makes of the pokes it means, and where they were; the first has the number `first`."""
    count = len(meant.places)
    on, triangles = nearest_points(part.surface, meant.places)
    e1, e2 = tangents(part.surface.normals[triangles])
    beside = conditions.aim * rng.standard_normal((count, 2))
    points, triangles = nearest_points(part.surface, on + beside[:, :1] * e1 + beside[:, 1:] * e2)
    normals = part.surface.normals[triangles]
    meant_pushes = apply_bias(meant.pushes, normals, conditions.habits)
    pushes = limit_tilt(add_hand_noise(meant_pushes, conditions.hand, rng), normals, conditions.usable)
    pokes = PressedPlaces(
        np.zeros(count, dtype=np.int64), points, normals, pushes, rng.uniform(*FORCE, count), rng.uniform(0, np.pi / 2, count)
    )
    habits = replace(conditions.habits, double_rate=max(conditions.doubled, conditions.habits.double_rate))
    return simulate_contacts(rig, pokes, rng, POSE, first, habits), pokes


PokingWay: TypeAlias = Callable[[ExamplePart, Conditions, int, np.random.Generator], MeantPokes]
"""Gives so many pokes."""


def _at(part: ExamplePart, rows: IntArray, tilts: FloatArray, azimuths: FloatArray) -> MeantPokes:
    normals = part.plan.normals[rows]
    return MeantPokes(part.plan.places[rows], push_directions(normals, tilts, azimuths))


def _straight(part: ExamplePart, rows: IntArray) -> MeantPokes:
    return _at(part, rows, np.zeros(len(rows)), np.zeros(len(rows)))


def _rounds(part: ExamplePart, count: int, rng: np.random.Generator) -> IntArray:
    taxels = len(part.plan.channels)
    return np.concatenate([rng.permutation(taxels) for _ in range(-(-count // taxels))])[:count]


def clumped(part: ExamplePart, conditions: Conditions, count: int, rng: np.random.Generator) -> MeantPokes:
    """Poke as people do who are asked for nothing: favourite places again and again, along the normal."""
    del conditions
    liked = np.exp(1.5 * rng.standard_normal(len(part.plan.channels)))
    return _straight(part, rng.choice(len(liked), count, p=liked / liked.sum()))


def random(part: ExamplePart, conditions: Conditions, count: int, rng: np.random.Generator) -> MeantPokes:
    """Poke anywhere, along the normal."""
    del conditions
    return _straight(part, rng.integers(len(part.plan.channels), size=count))


def round_robin(part: ExamplePart, conditions: Conditions, count: int, rng: np.random.Generator) -> MeantPokes:
    """Poke each taxel once a round, along the normal."""
    del conditions
    return _straight(part, _rounds(part, count, rng))


def tilt_recipe(part: ExamplePart, conditions: Conditions, count: int, rng: np.random.Generator) -> MeantPokes:
    """Poke each taxel once a round, tilted, the tilt turned with each round: what can be printed on a card."""
    rows = _rounds(part, count, rng)
    turns = np.asarray(RECIPE_TURN * (np.arange(count) // len(part.plan.channels)), dtype=np.float64)
    return _at(part, rows, np.full(count, min(RECIPE_TILT, conditions.usable)), turns)


WAYS: dict[str, PokingWay] = {way.__name__: way for way in (clumped, random, round_robin, tilt_recipe)}
"""By the name in JSON."""

LOOKED_AT = 1.03
"""A course is looked at after so many times as many pokes as before, and after every second one up to `DENSE`."""
DENSE = 260
ALONE = (Method.FREE, Method.SURFACE)
"""Methods that are solved whichever is followed: the guide takes places from the surface method."""
FALSE = 5.0 / 3.0
"""A taxel is falsely done where its true error exceeds the wanted one this many times."""


@dataclass(frozen=True, slots=True, eq=False)
class ErrorCourse:
    """One session's errors."""

    pokes: IntArray
    """(n,) ascending."""
    mean: FloatArray
    """(n,) float, metres, over all taxels; one without an estimate counts `UNKNOWN`."""
    p95: FloatArray
    """(n,) float, metres."""
    seconds: FloatArray
    """(n,) float, modelled: pokes, and the hand's way between them."""
    done: int
    """Taxels that the guide calls done at the end."""
    falsely: int
    """Of these, how many are not."""
    enough: float
    """After how many pokes the guide had nothing more to ask for; infinite if it always had, or nobody followed it."""
    given_up: int
    """Taxels that it had given up by then, or by the end."""

    def mean_at(self, pokes: float) -> float:
        """Return the mean error after so many pokes, metres, between two looks along a line."""
        return float(np.interp(pokes, self.pokes, self.mean))

    def pokes_to(self, error: float, of_p95: bool = False) -> float:
        """Return how many pokes it takes until the error is and stays at most `error`, metres; infinite if it never does."""
        above = np.flatnonzero((self.p95 if of_p95 else self.mean) > error)
        if not len(above):
            return float(self.pokes[0])
        return float(self.pokes[above[-1] + 1]) if above[-1] + 1 < len(self.pokes) else float("inf")


def evaluation_counts(limit: int) -> IntArray:
    """Return after which pokes a course of `limit` pokes is looked at."""
    first = list(range(10, min(limit, DENSE) + 1, 2))
    while first[-1] < limit:
        first.append(min(limit, round(first[-1] * LOOKED_AT)))
    return np.array(first)


def run_course(part: ExamplePart, way: str, method: Method, conditions: Conditions, seed: int, limit: int) -> ErrorCourse:
    """Poke `limit` times, and look at the errors now and then."""
    rig = displaced_rig(part, conditions, seed)
    # Another stream than the rig's: every way to poke meets the same rig of a seed.
    rng = np.random.default_rng([seed, 11])
    own = part, rig, method, conditions, rng, limit
    steps = _guided(*own) if way == "guided" else _unguided(way, *own)
    at = set(evaluation_counts(limit).tolist())
    rows: list[tuple[int, float, float, float]] = []
    last: tuple[Session, Guidance | None] | None = None
    enough, given_up = float("inf"), 0
    for count, seconds, session, guidance in steps:
        last = session, guidance
        if guidance is not None and not np.isfinite(enough):
            given_up = len(guidance.given_up)
            enough = float(count) if guidance.phase is GuidePhase.ENOUGH else enough
        if count in at:
            errors = errors_of(session.snapshot().estimates[method], rig)
            rows.append((count, float(errors.mean()), float(np.percentile(errors, 95)), seconds))
    if last is None:
        raise ValueError("a course needs a poke")
    session, guidance = last
    if guidance is None:
        contacts = {contact.poke: contact for contact in session.contacts}
        guidance = _guide(part, method).update(contacts, session.snapshot().estimates, session.evidence, lambda _: None)
    done, falsely = _judged(guidance, session.snapshot().estimates[method], rig)
    pokes, mean, p95, spent = (np.array(column) for column in zip(*rows, strict=True))
    return ErrorCourse(pokes.astype(np.int64), mean, p95, spent, done, falsely, enough, given_up)


TABLE_I: Mapping[str, float] = {"1": 13, "2": 5, "3": 4, "4": 7, "5": 7, "6": 7, "7": 7}
"""Minutes for which the paper poked each arm pose (Table I)."""


def poke_rounds(rig: Rig, pose: str, count: int, rng: np.random.Generator, first: int) -> list[Contact]:
    """Return the contacts of so many unguided pokes in an arm pose, round by round, from random sides."""
    rounds = -(-count // len(rig.channels))
    targets = np.concatenate([rng.permutation(rig.channels) for _ in range(rounds)])[:count]
    return simulate_contacts(rig, unguided_presses(rig, targets, Habits.careful(), rng), rng, pose, first)


def poke_table(rig: Rig, share: float, rng: np.random.Generator) -> dict[str, list[Contact]]:
    """Return the contacts of each arm pose of `TABLE_I`, poked for `share` of its minutes."""
    found: dict[str, list[Contact]] = {}
    first = 1
    for pose, minutes in TABLE_I.items():
        count = round(share * minutes * 60.0 / CYCLE_S)
        found[pose] = poke_rounds(rig, pose, count, rng, first)
        first += count
    return found


def errors_of(estimates: tuple[Estimate, ...], rig: Rig) -> FloatArray:
    """Return (n,) the taxels' errors, metres."""
    truth = [rig.places[rig.row_of(estimate.channel)] for estimate in estimates]
    found = zip((estimate.position for estimate in estimates), truth, strict=True)
    return np.array([UNKNOWN if position is None else np.linalg.norm(position - place) for position, place in found])


Step = tuple[int, float, Session, Guidance | None]


def _unguided(
    way: str, part: ExamplePart, rig: Rig, method: Method, conditions: Conditions, rng: np.random.Generator, limit: int
) -> Iterator[Step]:
    """Poke as planned before the first poke."""
    meant = WAYS[way](part, conditions, limit, rng)
    contacts, pokes = poke_by_hand(part, rig, meant, conditions, rng, 1)
    session, added = _session(part, method), 0
    times = np.cumsum(_seconds(np.linalg.norm(np.diff(pokes.points, axis=0, prepend=pokes.points[:1]), axis=1)))
    for count in evaluation_counts(limit).tolist():
        while added < len(contacts) and contacts[added].poke <= count:
            session.add(contacts[added])
            added += 1
        yield count, float(times[count - 1]), session, None


def _guided(
    part: ExamplePart, rig: Rig, method: Method, conditions: Conditions, rng: np.random.Generator, limit: int
) -> Iterator[Step]:
    """Poke as a guide says, one after another."""
    session, seconds, hand = _session(part, method), 0.0, None
    guide = _guide(part, method)
    contacts: dict[int, Contact] = {}
    targets: dict[int, Target | None] = {}
    guidance = guide.update(contacts, session.snapshot().estimates, session.evidence, targets.get)
    for count in range(1, limit + 1):
        if guidance.target is not None:
            meant = MeantPokes(guidance.target.place[None], guidance.target.push[None])
        else:
            # Enough, says the guide: who goes on all the same pokes what is known worst.
            worst = int(np.nan_to_num(guidance.rms, posinf=1e3).argmax())
            meant = MeantPokes(guidance.places[worst][None], -part.plan.normals[worst][None])
        made, pokes = poke_by_hand(part, rig, meant, conditions, rng, count)
        seconds += float(_seconds(np.array([0.0 if hand is None else np.linalg.norm(pokes.points[0] - hand)]))[0])
        hand = pokes.points[0]
        for contact in made:
            session.add(contact)
            contacts[contact.poke] = contact
        targets[count] = guidance.target
        guidance = guide.update(contacts, session.snapshot().estimates, session.evidence, targets.get)
        yield count, seconds, session, guidance


def _session(part: ExamplePart, method: Method) -> Session:
    return Session(part.scene, part.surface, {*ALONE, method})


def _guide(part: ExamplePart, method: Method) -> Guide:
    return Guide(part.plan, part.scene.noise, method, part.spacing, GuideSettings())


def _seconds(ways: FloatArray) -> FloatArray:
    settings = GuideSettings()
    return settings.poke_s + ways / settings.hand_speed


def _judged(guidance: Guidance, estimates: tuple[Estimate, ...], rig: Rig) -> tuple[int, int]:
    """Return how many taxels are called done, and how many of them wrongly."""
    wanted = GuideSettings().wanted
    errors = errors_of(estimates, rig)
    done = np.array([not missing for missing in guidance.needs])
    return int(done.sum()), int((done & (errors > FALSE * wanted)).sum())
