"""What each poke counts for a taxel, and where else the taxel might lie: pure functions, without Qt."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from app.display_units import ChannelNames, millimetres, number
from skincal.contacts.outcome import Contact
from skincal.geometry.wrench import axis_point, move_wrench
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Estimate, State

DOUBT_MARKED = 0.5
"""Trust below which a poke is marked in the list: 99 of 100 good pokes stay above it."""
FULL = 0.995
"""Trust from which a poke counts fully, to two decimals."""
LISTED = 100
"""Pokes of one taxel in the list, the newest: more are not read."""


@dataclass(frozen=True, slots=True)
class TaxelPoke:
    """What one poke counts for one taxel."""

    poke: int
    weight: float
    """k: the taxel's answer in shares of the strongest in this poke, above 0 to 1."""
    trust: float
    """0 to 1: how far the method believes the poke for this taxel."""
    miss: float | None
    """m, distance of the poke's axis from the estimate; None where there is none."""


def weight_of(contact: Contact, channel: int) -> float:
    """Return k = t_j / max t, the share of a taxel's answer in the strongest of a contact."""
    at = int(np.flatnonzero(contact.channels == channel)[0])
    return float(contact.responses[at] / contact.responses.max())


def miss_of(contact: Contact, estimate: Estimate) -> float | None:
    """Return the distance of a contact's axis from an estimate, metres; None where there is no position."""
    return _misses([contact], estimate)[0]


def _misses(contacts: Sequence[Contact], estimate: Estimate) -> list[float] | list[None]:
    """Return that of each: together, since each by itself takes 0.3 ms of the window's time."""
    if estimate.position is None or not contacts:
        return [None] * len(contacts)
    poses = np.array([contact.link_from_sensor for contact in contacts])
    forces, moments = (np.array([getattr(contact, name) for contact in contacts]) for name in ("force", "moment"))
    force, moment = move_wrench(poses, forces, moments)
    off = estimate.position - axis_point(force, moment)
    return (np.linalg.norm(np.cross(force, off), axis=1) / np.linalg.norm(force, axis=1)).tolist()


def taxel_pokes(snapshot: Snapshot, estimate: Estimate) -> tuple[TaxelPoke, ...]:
    """Return what the pokes count for a taxel, newest first: those that touched it and are not excluded.

    For a dead one none counts.
    """
    if estimate.state is State.DEAD:
        return ()
    touching = (
        record.outcome
        for record in reversed(snapshot.pokes)
        if not record.excluded and isinstance(record.outcome, Contact) and estimate.channel in record.outcome.channels.tolist()
    )
    listed = list(islice(touching, LISTED))
    return tuple(
        TaxelPoke(c.poke, weight_of(c, estimate.channel), estimate.doubted.get(c.poke, 1.0), miss)
        for c, miss in zip(listed, _misses(listed, estimate), strict=True)
    )


def doubting(estimates: Iterable[Estimate]) -> Mapping[int, Sequence[Estimate]]:
    """Return for each poke that does not count fully the estimates that doubt it, the one that doubts it most first."""
    found: dict[int, list[Estimate]] = {}
    for estimate in estimates:
        for poke, trust in estimate.doubted.items():
            if trust < FULL:
                found.setdefault(poke, []).append(estimate)
    return {poke: sorted(those, key=lambda e: e.doubted[poke]) for poke, those in found.items()}


def doubt_mark(poke: int, doubters: Sequence[Estimate], names: ChannelNames) -> str:
    """Return the words that mark a poke in the list: `"counts 0.2 for 17-05"`; empty where no taxel doubts it much."""
    marked = [e for e in doubters if e.doubted[poke] < DOUBT_MARKED]
    if not marked:
        return ""
    more = f" +{len(marked) - 1}" if len(marked) > 1 else ""
    return f"counts {number(marked[0].doubted[poke], 1)} for {names.short(marked[0].channel)}{more}"


def doubt_words(contact: Contact, estimate: Estimate, names: ChannelNames) -> str:
    """Return how far a poke counts for a taxel, and why."""
    told = f"counts {number(estimate.doubted[contact.poke], 2)} for {names.short(estimate.channel)}"
    miss = miss_of(contact, estimate)
    return told if miss is None else f"{told}: its axis passes {millimetres(miss)} from where the other pokes put the taxel"


def rival_words(estimate: Estimate | None) -> str:
    """Return where else a taxel may lie and what to do about it; empty where its place is the only one."""
    if estimate is None or estimate.rival is None or estimate.position is None:
        return ""
    away = millimetres(float(np.linalg.norm(estimate.rival.position - estimate.position)), 0)
    return f"Fits nearly as well {away} away (odds {number(estimate.rival.odds, 0)} to 1): poke it from another side."
