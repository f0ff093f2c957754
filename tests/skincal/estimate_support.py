"""One method at a time, as most tests want it."""

from skincal.methods import estimate_taxels


def solve(contacts, channels, method, noise, surface, dead=None, boards=None):
    """Return the estimates of one method by channel."""
    return estimate_taxels(contacts, channels, [method], noise, surface, dead or {}, boards=boards)[method]
