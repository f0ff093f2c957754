"""What the window waits for: a poke's solve, a whole session's, and how much memory pokes take."""

from __future__ import annotations

import copy
import tracemalloc
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.methods import estimate_taxels
from skincal.session.session import Session
from skincal.studies.benches import Bench
from skincal.studies.clock import Spread, at_rest, clock, timed
from skincal.taxels.result import PER_TAXEL, Method

TOUCHED = 7
"""Taxels that a poke touches: what a tip of 4 mm between pads 5 mm apart reaches at most."""
_MB = 1e6


def solved_session(bench: Bench, contacts: Sequence[Contact], methods: Collection[Method] | None = None) -> Session:
    """Return a session with these contacts, solved by these methods, for None by every method of its scene."""
    session = Session(bench.scene, bench.surface, methods)
    for contact in contacts:
        session.add(contact)
    session.snapshot()
    return session


def poke_time(bench: Bench, per_taxel: int, pokes: int) -> dict[str, Any]:
    """Time a poke that touches seven taxels, in a session in which every taxel has been poked: taken in, solved, shown.

    Parameters
    ----------
    per_taxel : pokes that each taxel has had
    pokes : how many are timed; as many before them are not

    Returns
    -------
    JSON: `time_ms` by the two methods of the paper, `with_modules_ms` by all that the scene has
    """
    ways = {"time_ms": PER_TAXEL, "with_modules_ms": None}
    spent = {key: Spread.of(_poked(bench, per_taxel, pokes, methods)) for key, methods in ways.items()}
    times = {key: spread.times(1e3).json() for key, spread in spent.items()}
    return {"pokes_per_taxel": per_taxel, "taxels_touched": TOUCHED, **times}


def _poked(bench: Bench, per_taxel: int, pokes: int, methods: Collection[Method] | None) -> list[float]:
    contacts = bench.contacts(per_taxel, seed=1)
    session = solved_session(bench, contacts, methods)
    others = bench.contacts(-(-2 * pokes // len(bench.channels)), seed=2)[: 2 * pokes]
    fresh = [replace(touching(bench, contact), poke=session.last_poke + 1 + i) for i, contact in enumerate(others)]
    seconds: list[float] = []
    with at_rest():
        for contact in fresh:
            start = clock()
            session.add(contact)
            session.snapshot()
            seconds.append(clock() - start)
    return seconds[pokes:]


def touching(bench: Bench, contact: Contact) -> Contact:
    """Return the contact as if the seven taxels nearest to the strongest one's place had answered."""
    places = bench.rig.places
    strongest = bench.rig.row_of(int(contact.channels[contact.responses.argmax()]))
    rows = np.argsort(np.linalg.norm(places - places[strongest], axis=1))[:TOUCHED]
    order = np.argsort(bench.rig.channels[rows])
    responses = np.linspace(1.0, 0.2, TOUCHED) * float(contact.responses.max())
    return replace(contact, channels=bench.rig.channels[rows][order], responses=responses[order])


def resolve_time(bench: Bench, pokes: int, repeats: int) -> dict[str, Any]:
    """Time a solve of every taxel by the two methods of the paper, and a session filled anew, from so many contacts."""
    contacts = bench.contacts(-(-pokes // len(bench.channels)), seed=3)[:pokes]
    methods = [method for method in Session(bench.scene, bench.surface).methods if method in PER_TAXEL]

    def solve() -> object:
        return estimate_taxels(contacts, bench.channels, methods, bench.scene.noise, bench.surface)

    solve()
    seconds, _ = timed(solve, repeats)
    filled, _ = timed(lambda: solved_session(bench, contacts), repeats)
    return {
        "contacts": len(contacts),
        "time_ms": Spread.of(seconds).times(1e3).json(),
        "session_ms": Spread.of(filled).times(1e3).json(),
    }


def memory(bench: Bench, pokes: int) -> dict[str, Any]:
    """Measure the memory that pokes take: contacts with arrays of their own, estimates and a snapshot."""
    contacts = bench.contacts(-(-pokes // len(bench.channels)), seed=4)[:pokes]
    # What is loaded once is no poke's.
    solved_session(bench, contacts[:10])
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        session = solved_session(bench, [copy.deepcopy(contact) for contact in contacts])
        after = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    counted = len(session.contacts)
    return {
        "pokes": counted,
        "megabytes": (after - before) / _MB,
        "megabytes_per_1000": (after - before) / _MB / counted * 1000,
    }
