"""How fast a rig with the paper's errors is known: by pokes, and by the processor's time that the methods take as they come.

The pokes are those of `paper_trials.run_trial`, in an order that mixes the arm poses, so that the first ones already are of all
of them; the last point of a course is what is pooled there. Errors are seeded, times are measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.session.session import Session
from skincal.simulate.landmarks import poke_landmarks
from skincal.studies.clock import at_rest, clock
from skincal.studies.paper_trials import FIRST_LANDMARK, LANDMARKS, Corrected, corrected, paper_session, part, solved, spread
from skincal.taxels.result import Method

CORRECTED = "modules_21"
"""Name of the modules method on a rig that 21 landmark pokes correct."""
NAMES = (*(method.value for method in Method), CORRECTED)
TOGETHER: Mapping[Method, tuple[Method, ...]] = {
    Method.FREE: (Method.FREE,),
    Method.SURFACE: (Method.SURFACE,),
    Method.MODULES: (Method.SURFACE, Method.MODULES),
}
"""What a session solves for a method: the modules begin at the surface method's estimates."""


@dataclass(frozen=True, slots=True)
class Course:
    """One rig after more and more pokes; numbers by method, and `CORRECTED`."""

    seed: int
    counts: tuple[int, ...]
    errors: Mapping[str, tuple[float, ...]]
    """mm: mean of the taxels that have an estimate, after so many pokes; NaN where none has."""
    seconds: Mapping[str, tuple[float, ...]]
    """s of processor time until then, each poke solved as it came; NaN beyond the pokes that are timed. A correction of the rig
    is made once, then."""


def run_course(seed: int, counts: Sequence[int], share: float, timed: int) -> Course:
    """Solve a rig with the paper's errors after each of `counts` pokes, and after all of them.

    Parameters
    ----------
    share : of the paper's minutes
    timed : pokes that are solved one by one as well, with the time that takes; 0 for none
    """
    scene, _, _ = part()
    rig, of_pose, rng = paper_session(seed, share)
    every = [contact for some in of_pose.values() for contact in some]
    known = poke_landmarks(rig, scene.landmarks, LANDMARKS[0], rng, FIRST_LANDMARK)
    order: list[int] = np.random.default_rng([seed, 2014]).permutation(len(every)).tolist()
    mixed = [every[i] for i in order]
    steps = (*(count for count in counts if count < len(mixed)), len(mixed))
    errors: dict[str, list[float]] = {name: [] for name in NAMES}
    corrections: list[Corrected] = []
    for count in steps:
        for method, found in solved(mixed[:count], rig).items():
            errors[method.value].append(spread(found, rig).mean)
        corrections.append(corrected(rig, mixed[:count], known, [Method.MODULES]))
        errors[CORRECTED].append(corrections[-1].errors[Method.MODULES.value].mean)
    seconds = {method.value: _seconds(mixed[:timed], together, steps) for method, together in TOGETHER.items()}
    with_them = zip(seconds[Method.MODULES.value], corrections, strict=True)
    seconds[CORRECTED] = tuple(until + one.seconds for until, one in with_them)
    return Course(seed, steps, {name: tuple(some) for name, some in errors.items()}, seconds)


def _seconds(contacts: Sequence[Contact], methods: Sequence[Method], steps: Sequence[int]) -> tuple[float, ...]:
    """Return the processor time, s, until each step of a session that solves each contact as it comes."""
    scene, surface, _ = part()
    session, total, at = Session(scene, surface, methods), 0.0, dict[int, float]()
    with at_rest():
        for count, contact in enumerate(contacts, start=1):
            start = clock()
            session.add(replace(contact, poke=count))
            session.snapshot()
            total += clock() - start
            at[count] = total
    return tuple(at.get(step, float("nan")) for step in steps)


def errors_of(courses: Sequence[Course]) -> dict[str, Any]:
    """Return as JSON the mean errors, mm, of rigs after so many pokes; None where a rig has no estimate."""
    return {"rigs": len(courses), **_means(courses, [one.errors for one in courses], 1.0)}


def times_of(courses: Sequence[Course]) -> dict[str, Any]:
    """Return as JSON the mean processor times, ms, of the rigs that are timed; None beyond the pokes that are."""
    timed = [one for one in courses if np.isfinite(one.seconds[Method.FREE.value]).any()]
    return {"rigs": len(timed), **_means(courses, [one.seconds for one in timed], 1e3)}


def _means(courses: Sequence[Course], numbers: Sequence[Mapping[str, tuple[float, ...]]], unit: float) -> dict[str, Any]:
    means = {name: np.mean([one[name] for one in numbers], axis=0).tolist() for name in NAMES} if numbers else {}
    told = {name: [unit * value if np.isfinite(value) else None for value in some] for name, some in means.items()}
    return {"pokes": list(courses[0].counts), **told}
