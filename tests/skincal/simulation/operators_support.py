"""Sessions that follow the guide by one method until nothing more is asked for, and what is wrong then."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from skincal.guide.guidance import GuidePhase
from skincal.guide.guide import Guide
from skincal.guide.surroundings import Surroundings
from skincal.session.session import Session
from skincal.simulation.example_parts import ExamplePart
from skincal.simulation.operator import OPERATORS
from skincal.simulation.poking_strategies import Conditions, Hand, MeantPokes, displaced_rig, errors_of
from skincal.studies.error_numbers import CHI2_95, in_known_directions
from skincal.taxels.result import Method

FAR = 0.003
"""m: farther off a taxel that is done is not as it was asked for."""
WRONG = 0.005
"""m: farther off it is falsely done."""


@cache
def part():
    return ExamplePart()


@dataclass(frozen=True)
class Ended:
    pokes: int
    enough: bool
    done: int
    far: int
    """Taxels that are done and farther off than `FAR`."""
    falsely: int
    """Farther off than `WRONG`."""
    beyond: int
    """Taxels that lie beyond twice their predicted 95 %."""


def followed(operator, seed, limit=200, method=Method.MODULES):
    """A session of one of `OPERATORS` on a good rig."""
    conditions = Conditions(habits=OPERATORS[operator])
    rig, rng = displaced_rig(part(), conditions, seed), np.random.default_rng([seed, 11])
    session = Session(part().scene, part().surface, set(Method))
    around = Surroundings(part().layout, part().plan.channels)
    guide = Guide(part().plan, part().scene.noise, method, surroundings=around)
    targets, pokes = {}, 0
    guidance = guide.update(session.snapshot(), targets.get)
    while guidance.phase is not GuidePhase.ENOUGH and pokes < limit:
        pokes += 1
        meant = MeantPokes(guidance.target.place[None], guidance.target.push[None])
        for contact in Hand(rig, conditions, rng).poke(meant, pokes)[0]:
            session.add(contact)
        targets[pokes] = guidance.target
        guidance = guide.update(session.snapshot(), targets.get)
    estimates = session.snapshot().estimates[method]
    done, errors = np.array([not needs for needs in guidance.needs]), errors_of(estimates, rig)
    far, falsely = (int((done & (errors > bar)).sum()) for bar in (FAR, WRONG))
    beyond = 0
    for estimate in estimates:
        if estimate.position is not None:
            off, variances = in_known_directions(
                estimate.position - rig.places[rig.row_of(estimate.channel)], estimate.covariance
            )
            beyond += int(np.sum(off**2 / variances) > 4.0 * CHI2_95[len(off)])
    return Ended(pokes, guidance.phase is GuidePhase.ENOUGH, int(done.sum()), far, falsely, beyond)
