"""Poking strategies and their learning curves: the error of a session after each poke.

The part is the shipped forearm. Its skin is 4 mm off its plan, and strategies aim at the planned taxels; only the guide learns
from measurements. The rig is good: noise of 0.10 N and 10 N mm a poke, 6 to 12 N, tared around every poke.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray
from skincal.guide.guidance import Guidance, GuidePhase, Target
from skincal.guide.guide import Guide
from skincal.guide.progress import GuideSettings
from skincal.guide.surroundings import Surroundings
from skincal.session.session import Session
from skincal.simulation.contacts import POKE_CYCLE_S, RECIPE_TILT, RECIPE_TURN, simulate_contacts
from skincal.simulation.example_parts import ExamplePart
from skincal.simulation.operator import OPERATORS, Habits, aimed_presses, unguided_presses
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import PressedPlaces, Rig, push_directions
from skincal.taxels.result import Estimate, Method

SHORT_LEVER_POSE = "2"
"""Arm pose of the scene with a lever of 0.18 m."""
SKIN_OFFSET_RMS_M = 0.004
"""m, rms offset of the skin from its plan, both directions together."""
CAREFUL_HABITS = OPERATORS["careful"]
ERROR_OF_UNKNOWN_TAXEL_M = 0.060
"""m, error of a taxel without an estimate: the size of the patch."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """Hand and rig of a session."""

    habits: Habits = CAREFUL_HABITS
    drift: float = 0.0
    """N rms of force drift in half an hour."""

    @property
    def errors(self) -> RigErrors:
        """Errors of the rig."""
        displaced = replace(RigErrors.noise(), mount_shift=SKIN_OFFSET_RMS_M / float(np.sqrt(2.0)), mount_turn=0.0)
        # N m to N as the ranges of the FT45, 35 N m to 1500 N.
        return replace(displaced, drift_force=self.drift, drift_moment=self.drift * 0.024)


def displaced_rig(part: ExamplePart, conditions: Conditions, seed: int) -> Rig:
    """Return a rig whose skin has a random offset from its plan."""
    return Rig(part.scene, part.surface, conditions.errors, np.random.default_rng([seed, 7]))


@dataclass(frozen=True, slots=True, eq=False)
class MeantPokes:
    """n intended pokes, link frame."""

    places: FloatArray
    """(n, 3) float, metres."""
    pushes: FloatArray
    """(n, 3) float, unit."""


@dataclass(frozen=True, slots=True, eq=False)
class Hand:
    """A hand with habits that pokes a rig."""

    rig: Rig
    conditions: Conditions
    rng: np.random.Generator

    def poke(self, meant: MeantPokes, first: int) -> tuple[list[Contact], PressedPlaces]:
        """Make the intended pokes, the first with the number `first`; return contacts and true presses."""
        habits, rows = self.conditions.habits, np.zeros(len(meant.places), dtype=np.int64)
        pokes = aimed_presses(self.rig, rows, meant.places, meant.pushes, habits, self.rng)
        return simulate_contacts(self.rig, pokes, self.rng, SHORT_LEVER_POSE, first, habits), pokes


STRATEGIES = ("clumped", "random", "round_robin", "tilt_recipe")
"""Strategies without measurements, by their names in JSON."""


def plan_pokes(way: str, part: ExamplePart, conditions: Conditions, count: int, rng: np.random.Generator) -> MeantPokes:
    """Plan pokes of one of `STRATEGIES`: at favourite places as unguided people do, anywhere, or each taxel once a round.

    Pokes are along the normal. Those of the recipe are tilted: the direction turns each round, as a printed card can say.
    """
    taxels = len(part.plan.channels)
    if way == "clumped":
        liked = np.exp(1.5 * rng.standard_normal(taxels))
        rows = rng.choice(taxels, count, p=liked / liked.sum())
    elif way == "random":
        rows = rng.integers(taxels, size=count)
    else:
        rows = in_rounds(np.arange(taxels), count, rng)
    tilt = min(RECIPE_TILT, conditions.habits.cone) if way == "tilt_recipe" else 0.0
    turns = np.asarray(RECIPE_TURN * (np.arange(count) // taxels), dtype=np.float64)
    return MeantPokes(part.plan.places[rows], push_directions(part.plan.normals[rows], np.full(count, tilt), turns))


def in_rounds(items: IntArray, count: int, rng: np.random.Generator) -> IntArray:
    """Repeat items in rounds, each in a new random order."""
    return np.concatenate([rng.permutation(items) for _ in range(-(-count // len(items)))])[:count]


NEXT_EVALUATION_POKE_COUNT_RATIO = 1.03
"""Of successive evaluations; up to `EVALUATE_EVERY_SECOND_POKE_UNTIL` pokes every second one is evaluated."""
EVALUATE_EVERY_SECOND_POKE_UNTIL = 260
BASE_METHODS = (Method.FREE, Method.SURFACE)
"""Methods that are always solved: the guide uses positions of the surface method."""
FALSE_DONE_RATIO = 5.0 / 3.0
"""A taxel is falsely done if its error exceeds the wanted error by this factor."""


@dataclass(frozen=True, slots=True, eq=False)
class ErrorCourse:
    """Errors of one simulated session after growing numbers of pokes."""

    pokes: IntArray
    """(n,) ascending."""
    mean: FloatArray
    """(n,) float, metres, over all taxels; one without an estimate counts `ERROR_OF_UNKNOWN_TAXEL_M`."""
    p95: FloatArray
    """(n,) float, metres."""
    seconds: FloatArray
    """(n,) float, model of the time for pokes and hand movements."""
    done: int
    """Taxels that the guide calls done at the end."""
    falsely: int
    """Number of these whose error is too large."""
    enough: float
    """Poke after which the guide had no target; infinite if it always had one, or without a guide."""
    given_up: int
    """Taxels that the guide had given up by then."""

    def mean_at(self, pokes: float) -> float:
        """Return the mean error after `pokes`, metres, interpolated."""
        return float(np.interp(pokes, self.pokes, self.mean))

    def pokes_to(self, error: float, of_p95: bool = False) -> float:
        """Return the poke from which the mean (or p95) error stays at most `error`, metres; infinite if there is none."""
        above = np.flatnonzero((self.p95 if of_p95 else self.mean) > error)
        if not len(above):
            return float(self.pokes[0])
        return float(self.pokes[above[-1] + 1]) if above[-1] + 1 < len(self.pokes) else float("inf")


def evaluation_counts(limit: int) -> IntArray:
    """Return the poke numbers at which a session of `limit` pokes is evaluated."""
    first = list(range(10, min(limit, EVALUATE_EVERY_SECOND_POKE_UNTIL) + 1, 2))
    while first[-1] < limit:
        first.append(min(limit, round(first[-1] * NEXT_EVALUATION_POKE_COUNT_RATIO)))
    return np.array(first)


def run_course(part: ExamplePart, way: str, method: Method, conditions: Conditions, seed: int, limit: int) -> ErrorCourse:
    """Poke `limit` times and evaluate the errors."""
    rig = displaced_rig(part, conditions, seed)
    # A separate random stream, so that every strategy gets the same rig.
    hand = Hand(rig, conditions, np.random.default_rng([seed, 11]))
    steps = _guided(part, hand, method, limit) if way == "guided" else _unguided(way, part, hand, method, limit)
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
        guidance = _guide(part, method).update(session.snapshot(), lambda _: None)
    done, falsely = _judged(guidance, session.snapshot().estimates[method], rig)
    pokes, mean, p95, spent = (np.array(column) for column in zip(*rows, strict=True))
    return ErrorCourse(pokes.astype(np.int64), mean, p95, spent, done, falsely, enough, given_up)


TABLE_I: Mapping[str, float] = {"1": 13, "2": 5, "3": 4, "4": 7, "5": 7, "6": 7, "7": 7}
"""Minutes of poking in each arm pose in the paper (Table I)."""


def poke_rounds(rig: Rig, pose: str, count: int, rng: np.random.Generator, first: int) -> list[Contact]:
    """Simulate `count` unguided pokes in an arm pose: each taxel once a round, from random sides."""
    pokes = unguided_presses(rig, in_rounds(rig.channels, count, rng), Habits.careful(), rng)
    return simulate_contacts(rig, pokes, rng, pose, first)


def poke_table(rig: Rig, share: float, rng: np.random.Generator) -> dict[str, list[Contact]]:
    """Simulate `share` of the pokes of each arm pose of `TABLE_I`; return their contacts."""
    found: dict[str, list[Contact]] = {}
    first = 1
    for pose, minutes in TABLE_I.items():
        count = round(share * minutes * 60.0 / POKE_CYCLE_S)
        found[pose] = poke_rounds(rig, pose, count, rng, first)
        first += count
    return found


def errors_of(estimates: tuple[Estimate, ...], rig: Rig) -> FloatArray:
    """Return the errors (n,) of the taxels, metres."""
    truth = [rig.places[rig.row_of(estimate.channel)] for estimate in estimates]
    found = zip((estimate.position for estimate in estimates), truth, strict=True)
    return np.array(
        [ERROR_OF_UNKNOWN_TAXEL_M if position is None else np.linalg.norm(position - place) for position, place in found]
    )


Step = tuple[int, float, Session, Guidance | None]


def _unguided(way: str, part: ExamplePart, hand: Hand, method: Method, limit: int) -> Iterator[Step]:
    """Poke a plan that is fixed before the first poke."""
    contacts, pokes = hand.poke(plan_pokes(way, part, hand.conditions, limit, hand.rng), 1)
    session, added = _session(part, method), 0
    times = np.cumsum(_seconds(np.linalg.norm(np.diff(pokes.points, axis=0, prepend=pokes.points[:1]), axis=1)))
    for count in evaluation_counts(limit).tolist():
        while added < len(contacts) and contacts[added].poke <= count:
            session.add(contacts[added])
            added += 1
        yield count, float(times[count - 1]), session, None


def _guided(part: ExamplePart, hand: Hand, method: Method, limit: int) -> Iterator[Step]:
    """Poke the targets of a guide."""
    session, seconds, last = _session(part, method), 0.0, None
    guide = _guide(part, method)
    targets: dict[int, Target | None] = {}
    guidance = guide.update(session.snapshot(), targets.get)
    for count in range(1, limit + 1):
        if guidance.target is not None:
            meant = MeantPokes(guidance.target.place[None], guidance.target.push[None])
        else:
            # After the guide's end: the least certain taxel.
            worst = int(np.nan_to_num(guidance.rms, posinf=1e3).argmax())
            meant = MeantPokes(guidance.places[worst][None], -part.plan.normals[worst][None])
        made, pokes = hand.poke(meant, count)
        seconds += float(_seconds(np.array([0.0 if last is None else np.linalg.norm(pokes.points[0] - last)]))[0])
        last = pokes.points[0]
        for contact in made:
            session.add(contact)
        targets[count] = guidance.target
        guidance = guide.update(session.snapshot(), targets.get)
        yield count, seconds, session, guidance


def _session(part: ExamplePart, method: Method) -> Session:
    return Session(part.scene, part.surface, {*BASE_METHODS, method})


def _guide(part: ExamplePart, method: Method) -> Guide:
    around = Surroundings(part.layout, part.plan.channels)
    return Guide(part.plan, part.scene.noise, method, surroundings=around)


def _seconds(ways: FloatArray) -> FloatArray:
    settings = GuideSettings()
    return settings.poke_s + ways / settings.hand_speed


def _judged(guidance: Guidance, estimates: tuple[Estimate, ...], rig: Rig) -> tuple[int, int]:
    """Return the number of taxels that the guide calls done, and of those with a too large error."""
    wanted = GuideSettings().wanted
    errors = errors_of(estimates, rig)
    done = np.array([not missing for missing in guidance.needs])
    return int(done.sum()), int((done & (errors > FALSE_DONE_RATIO * wanted)).sum())
