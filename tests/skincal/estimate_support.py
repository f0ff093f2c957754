"""One method at a time, as most tests want it, and the evidence of some contacts."""

import numpy as np

from skincal.methods import estimate_taxels
from skincal.solver.machine import INTEGER, shared
from skincal.taxels.contact_table import ContactTable


def solve(contacts, channels, method, noise, surface, dead=None, model=None):
    """Return the estimates of one method by channel."""
    return estimate_taxels(contacts, channels, [method], noise, surface, dead or {}, model=model)[method]


def gather(contacts, channels):
    """Return the evidence of those of `channels` that answered in one of `contacts`."""
    return ContactTable(contacts).evidence(list(channels))


def least_squares(a, b):
    """Solve rows a (n, 3), b (n,) by the solver's QR: triangular factor, its right side, and the solution."""
    with shared().call() as call:
        asked = [1, len(b), call.put(np.array([0, len(b)]), INTEGER), call.put(np.concatenate([a.T, b[None]]))]
        root, (offset, solution, blind), rank = (
            call.reserve((3, 3)),
            [call.reserve((3,)) for _ in range(3)],
            call.reserve((1,), INTEGER),
        )
        call.run("factor", [*asked, root, offset, solution, blind, rank])
        return (call.get(root), call.get(offset)), call.get(solution)
