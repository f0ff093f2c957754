"""One rig poked as the paper's was: Table I's poses and durations, alone, averaged, pooled, and with landmarks."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry.arrays import FloatArray
from skincal.methods import estimate_taxels
from skincal.model.scene import Scene, load_scene, resource
from skincal.modules.pose import ModuleModel
from skincal.rig.correction_fit import DOUBTED, LandmarkPoke, RigRequest, correct_rig
from skincal.simulate.contacts import CYCLE_S, simulate_contacts
from skincal.simulate.faults import RigErrors
from skincal.simulate.landmarks import poke_landmarks
from skincal.simulate.operator import Habits, aim
from skincal.simulate.rig import Rig
from skincal.surface.mesh import Surface, load_surface
from skincal.taxels.result import Estimate, Method

SCENE = "icub-forearm"
MINUTES: Mapping[str, float] = {"1": 13, "2": 5, "3": 4, "4": 7, "5": 7, "6": 7, "7": 7}
"""Table I: how long each arm pose was poked."""
METHODS = tuple(Method)
LANDMARKS = (3, 10)
"""Landmark pokes in each of the seven arm poses: 21 and 70."""
OFF = 0.010
"""m: a landmark poke that is of another point."""
FIRST_LANDMARK = 100_001
"""Number of the first landmark poke."""
GOOD_POKES = 252
"""Of a good rig: three a taxel."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Errors of the taxels that have an estimate, millimetres."""

    mean: float
    sd: float
    largest: float
    missing: int

    @classmethod
    def of(cls, off: FloatArray) -> Spread:
        """Return that of errors (n,), metres, NaN where there is no estimate."""
        known = 1e3 * off[np.isfinite(off)]
        missing = len(off) - len(known)
        if not len(known):
            return cls(float("nan"), float("nan"), float("nan"), missing)
        return cls(float(known.mean()), float(known.std()), float(known.max()), missing)


@lru_cache(maxsize=1)
def part() -> tuple[Scene, Surface, ModuleModel]:
    """Return the forearm, its mesh and its modules."""
    scene = load_scene(resource(f"scenes/{SCENE}/scene.toml"))
    layout = scene.skin.layout
    if scene.surface is None or layout is None:
        raise ValueError(f"{SCENE} has no surface or no layout")
    surface, _ = load_surface(scene.surface)
    return scene, surface, ModuleModel(layout, scene.skin.anchor, surface)


def solved(contacts: Sequence[Contact], rig: Rig, methods: Sequence[Method] = METHODS) -> dict[Method, FloatArray]:
    """Return of each method the positions (n, 3) of the rig's taxels, metres, NaN where there is no estimate."""
    scene, surface, boards = part()
    found = estimate_taxels(contacts, rig.channels.tolist(), methods, scene.noise, surface, model=boards)
    return {method: _positions(list(estimates.values())) for method, estimates in found.items()}


def _positions(estimates: Sequence[Estimate]) -> FloatArray:
    nowhere = np.full(3, np.nan)
    return np.array([nowhere if one.position is None else one.position for one in estimates])


def spread(positions: FloatArray, rig: Rig) -> Spread:
    """Return the errors of positions (n, 3)."""
    return Spread.of(np.linalg.norm(positions - rig.places, axis=1))


def poked(rig: Rig, pose: str, count: int, rng: np.random.Generator, first: int) -> list[Contact]:
    """Return the contacts of so many unguided pokes in an arm pose, round by round, from random sides."""
    rounds = -(-count // len(rig.channels))
    targets = np.concatenate([rng.permutation(rig.channels) for _ in range(rounds)])[:count]
    return simulate_contacts(rig, aim(rig, targets, Habits.careful(), rng), rng, pose, first)


def session(rig: Rig, minutes: Mapping[str, float], rng: np.random.Generator) -> dict[str, list[Contact]]:
    """Return the contacts of each arm pose, poked for so many minutes."""
    found: dict[str, list[Contact]] = {}
    first = 1
    for pose, long in minutes.items():
        count = round(long * 60.0 / CYCLE_S)
        found[pose] = poked(rig, pose, count, rng, first)
        first += count
    return found


@dataclass(frozen=True, slots=True)
class Corrected:
    """What landmark pokes did."""

    landmarks: int
    used: bool
    held_before: float
    """mm: at what distance the axes pass the landmarks as the rig tells."""
    held_after: float
    """mm: the same of held-out pokes, corrected."""
    doubted: tuple[int, ...]
    """Landmark pokes that are named as off."""
    errors: Mapping[str, Spread]
    """By method, pooled; those without a correction where it is not used."""
    seconds: float
    """s of processor time, of the correction alone."""


def corrected(
    rig: Rig, contacts: Sequence[Contact], known: Sequence[LandmarkPoke], methods: Sequence[Method] = METHODS
) -> Corrected:
    """Correct a rig by landmark pokes, and solve what was poked on its skin."""
    scene, surface, _ = part()
    begin = time.process_time()
    answer = correct_rig(RigRequest(scene, surface, contacts, known))
    seconds = time.process_time() - begin
    right = contacts
    if answer.used and answer.correction is not None:
        right = [answer.correction.corrected(contact) for contact in contacts]
    return Corrected(
        landmarks=len(known),
        used=answer.used,
        held_before=1e3 * answer.before,
        held_after=1e3 * answer.after,
        doubted=tuple(poke for poke, trust in answer.trust.items() if trust < DOUBTED),
        errors={method.value: spread(places, rig) for method, places in solved(right, rig, methods).items()},
        seconds=seconds,
    )


@dataclass(frozen=True, slots=True)
class Trial:
    """What came of one rig with the paper's errors; errors by method."""

    seed: int
    pokes: int
    alone: Mapping[str, Mapping[str, Spread]]
    """For each method, of each arm pose."""
    averaged: Mapping[str, tuple[Spread, ...]]
    """For each method after each arm pose (IV-B)."""
    pooled: Mapping[str, Spread]
    landmarks: tuple[Corrected, ...]
    seconds: Mapping[str, float]
    """s of processor time, of a solve of all contacts, by method."""


def paper_session(seed: int, share: float) -> tuple[Rig, dict[str, list[Contact]], np.random.Generator]:
    """Return a rig with the paper's errors, its contacts in each arm pose, and what its landmark pokes are drawn from.

    Parameters
    ----------
    share : of the paper's minutes
    """
    scene, surface, _ = part()
    rng = np.random.default_rng([seed, 2011])
    rig = Rig(scene, surface, RigErrors.paper(), np.random.default_rng([seed, 11]))
    return rig, session(rig, {pose: share * minutes for pose, minutes in MINUTES.items()}, rng), rng


def run_trial(seed: int, share: float = 1.0) -> Trial:
    """Poke a rig with the paper's errors for `share` of the paper's minutes."""
    scene, _, _ = part()
    rig, of_pose, rng = paper_session(seed, share)
    places = {pose: solved(contacts, rig) for pose, contacts in of_pose.items()}
    every = [contact for contacts in of_pose.values() for contact in contacts]
    pooled, seconds = dict[str, Spread](), dict[str, float]()
    for method in METHODS:
        begin = time.process_time()
        found = solved(every, rig, [method])[method]
        seconds[method.value] = time.process_time() - begin
        pooled[method.value] = spread(found, rig)
    known = [poke_landmarks(rig, scene.landmarks, count, rng, FIRST_LANDMARK) for count in LANDMARKS]
    return Trial(
        seed=seed,
        pokes=len(every),
        alone={m.value: {pose: spread(found[m], rig) for pose, found in places.items()} for m in METHODS},
        averaged={m.value: _averaged([found[m] for found in places.values()], rig) for m in METHODS},
        pooled=pooled,
        landmarks=tuple(corrected(rig, every, some) for some in known),
        seconds=seconds,
    )


def _averaged(places: Sequence[FloatArray], rig: Rig) -> tuple[Spread, ...]:
    """Return the errors after each arm pose, the positions of all so far averaged; a taxel's poses without one left out."""
    sums, counts = np.zeros_like(rig.places), np.zeros((len(rig.places), 1))
    course: list[Spread] = []
    for found in places:
        known = np.isfinite(found).all(axis=1, keepdims=True)
        sums, counts = sums + np.where(known, found, 0.0), counts + known
        with np.errstate(invalid="ignore"):
            course.append(spread(sums / np.where(counts > 0, counts, np.nan), rig))
    return tuple(course)


@dataclass(frozen=True, slots=True)
class Safety:
    """Whether a correction did harm, by the modules' mean error, mm."""

    seed: int
    before: float
    after: float
    """With 21 landmark pokes."""
    after_wrong: float
    """One of which lies `OFF` beside its landmark."""
    wrong_told: bool
    """That poke is named."""
    others_told: int
    """Right ones that are named, of both."""


def run_safety(seed: int, pokes: int = 84) -> Safety:
    """Correct a rig with the paper's errors by 21 landmark pokes, all right and one wrong."""
    scene, surface, _ = part()
    rng = np.random.default_rng([seed, 2012])
    rig = Rig(scene, surface, RigErrors.paper(), np.random.default_rng([seed, 12]))
    contacts = [one for k, pose in enumerate(MINUTES) for one in poked(rig, pose, pokes, rng, 1 + k * pokes)]
    wrong = np.zeros(7 * LANDMARKS[0])
    bad = int(rng.integers(len(wrong)))
    wrong[bad] = OFF
    before = spread(solved(contacts, rig, [Method.MODULES])[Method.MODULES], rig).mean
    clean, mixed = (
        corrected(rig, contacts, poke_landmarks(rig, scene.landmarks, LANDMARKS[0], rng, FIRST_LANDMARK, off), [Method.MODULES])
        for off in (None, wrong)
    )
    others = len(clean.doubted) + len(set(mixed.doubted) - {FIRST_LANDMARK + bad})
    after, after_wrong = (one.errors["modules"].mean for one in (clean, mixed))
    return Safety(seed, before, after, after_wrong, FIRST_LANDMARK + bad in mixed.doubted, others)


@dataclass(frozen=True, slots=True)
class Good:
    """A rig that is only noisy; errors by method."""

    seed: int
    course: Mapping[int, Mapping[str, Spread]]
    """After so many pokes."""
    before: float
    """mm: the modules' mean error over seven arm poses, as the rig tells."""
    after: float
    """mm: with 21 landmark pokes."""


def run_good(seed: int, counts: Sequence[int]) -> Good:
    """Poke a rig with sensor noise alone in one arm pose; then in all of them with landmarks, though nothing is wrong."""
    scene, surface, _ = part()
    rng = np.random.default_rng([seed, 2013])
    rig = Rig(scene, surface, RigErrors.noise(), np.random.default_rng([seed, 13]))
    contacts = poked(rig, "2", max(*counts, GOOD_POKES), rng, 1)
    course = {
        count: {method.value: spread(found, rig) for method, found in solved(contacts[:count], rig).items()} for count in counts
    }
    each = GOOD_POKES // len(MINUTES)
    every = [one for k, pose in enumerate(MINUTES) for one in poked(rig, pose, each, rng, 1 + k * each)]
    before = spread(solved(every, rig, [Method.MODULES])[Method.MODULES], rig).mean
    known = poke_landmarks(rig, scene.landmarks, LANDMARKS[0], rng, FIRST_LANDMARK)
    return Good(seed, course, before, corrected(rig, every, known, [Method.MODULES]).errors["modules"].mean)
