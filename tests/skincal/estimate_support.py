"""One method at a time, as most tests want it, and the evidence of some contacts."""

import numpy as np

from skincal.guide.believed_positions import believed_from_measured, measured_positions
from skincal.methods import estimate_taxels
from skincal.solver import tables
from skincal.solver.machine import shared
from skincal.taxels.contact_table import ContactTable


def solve(contacts, channels, method, noise, surface, dead=None, model=None):
    """Return the estimates of one method by channel."""
    return estimate_taxels(contacts, channels, [method], noise, surface, dead or {}, model=model)[method]


def gather(contacts, channels):
    """Return the evidence of those of `channels` that answered in one of `contacts`."""
    return ContactTable(contacts).evidence(list(channels))


def believed_positions(plan, estimates, rig=0.0):
    """Return (n, 3) the believed positions, metres, by estimates in the plan's order."""
    return believed_from_measured(plan, *measured_positions(estimates), rig)


def least_squares(a, b):
    """Solve rows a (n, 3), b (n,) by the solver's QR: triangular factor, its right side, and the solution."""
    found = shared().run(
        "factor",
        systems=1,
        rows=len(b),
        starts=np.array([0, len(b)]),
        columns=np.concatenate([a.T, b[None]]),
        roots=(3, 3),
        offsets=(3,),
        solutions=(3,),
        blind=(3,),
        ranks=(1,),
    )
    return (found["roots"], found["offsets"]), found["solutions"]


def trust_by_definition(squares):
    """The trust of squared misses by the smooth step of `trust.h`, in numpy: the oracle of the solver's."""
    full, zero = tables.FULL_TRUST_SDS, tables.ZERO_TRUST_SDS
    rest = np.clip((zero - np.sqrt(squares)) / (zero - full), 0.0, 1.0)
    return np.where(squares > full**2, rest * rest * (3.0 - 2.0 * rest), 1.0)
