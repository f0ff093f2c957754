"""One method at a time, as most tests want it, and the evidence of some contacts."""

from skincal.methods import estimate_taxels
from skincal.taxels.contact_table import ContactTable


def solve(contacts, channels, method, noise, surface, dead=None, model=None):
    """Return the estimates of one method by channel."""
    return estimate_taxels(contacts, channels, [method], noise, surface, dead or {}, model=model)[method]


def gather(contacts, channels):
    """Return the evidence of those of `channels` that answered in one of `contacts`."""
    return ContactTable(contacts).evidence(list(channels))
