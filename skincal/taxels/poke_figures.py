"""Figures of single pokes, and of each poke for one taxel: weight, trust and distance of its force axis."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from skincal.contacts.outcome import Contact, Outcome
from skincal.model.tool_rig import TIP_ARM_POSE
from skincal.pokes import Pokes
from skincal.taxels.result import Estimate, State

MIN_TRUST_SHOWN_AS_FULL = 0.995  # Weight from which a poke counts fully, to two decimals
MAX_LISTED_POKES_PER_TAXEL = 100  # Longest list of a taxel's pokes, the newest ones


def peak_channel(outcome: Outcome) -> int | None:
    """Give the channel with the strongest response, for a rejected poke the first; `None` if none answered."""
    if not len(outcome.channels):
        return None
    if isinstance(outcome, Contact):
        return int(outcome.channels[int(np.argmax(outcome.responses))])
    return int(outcome.channels[0])


def force_of(contact: Contact) -> float | None:
    """Magnitude of the contact force, N; `None` of a rig without a force sensor."""
    return None if contact.pose == TIP_ARM_POSE else float(np.linalg.norm(contact.force))


def pitch_of(contact: Contact) -> float:
    """Magnitude of the wrench pitch (eq. 3), metres."""
    return abs(float(Pokes.collect([contact]).pitch[0]))


def tilt_of(contact: Contact, estimates: Mapping[int, Estimate]) -> float | None:
    """Compute the angle between the force and the inward normal of the strongest taxel, rad; `None` if it is not estimated.

    `estimates` are by channel.
    """
    peak = peak_channel(contact)
    estimate = None if peak is None else estimates.get(peak)
    if estimate is None or estimate.normal is None:
        return None
    return float(Pokes.collect([contact]).tilt(estimate.normal)[0])


@dataclass(frozen=True, slots=True)
class TaxelPoke:
    """Weight and trust of one poke for one taxel."""

    poke: int
    weight: float
    """k: response of the taxel divided by the strongest response of the poke, above 0 to 1."""
    trust: float
    """Robust weight of the poke for this taxel, 0 to 1."""
    miss: float | None
    """m, distance of the force axis from the estimate; `None` without an estimate."""


def weight_of(contact: Contact, channel: int) -> float:
    """Compute k = t_j / max t: response of a taxel divided by the strongest one."""
    return float((contact.responses[contact.channels == channel] / contact.responses.max())[0])


def miss_of(contact: Contact, estimate: Estimate) -> float | None:
    """Compute the distance of a force axis from an estimate, m; `None` without a position."""
    return _misses([contact], estimate)[0]


def _misses(contacts: Sequence[Contact], estimate: Estimate) -> list[float] | list[None]:
    # All at once: one by one each takes 0.3 ms of the window's thread.
    if estimate.position is None or not contacts:
        return [None] * len(contacts)
    return Pokes.collect(contacts).miss(estimate.position).tolist()


def taxel_pokes(newest_first: Iterable[Contact], estimate: Estimate) -> tuple[TaxelPoke, ...]:
    """List the contacts of a taxel in their given order, the first `MAX_LISTED_POKES_PER_TAXEL`; none for a disabled taxel."""
    if estimate.state is State.DEAD:
        return ()
    touching = (contact for contact in newest_first if estimate.channel in contact.channels.tolist())
    listed = list(islice(touching, MAX_LISTED_POKES_PER_TAXEL))
    return tuple(
        TaxelPoke(c.poke, weight_of(c, estimate.channel), estimate.doubted.get(c.poke, 1.0), miss)
        for c, miss in zip(listed, _misses(listed, estimate), strict=True)
    )


def doubting(estimates: Iterable[Estimate]) -> Mapping[int, Sequence[Estimate]]:
    """Map each poke that does not count fully to the estimates that doubt it, the strongest doubt first."""
    found: dict[int, list[Estimate]] = {}
    for estimate in estimates:
        for poke, trust in estimate.doubted.items():
            if trust < MIN_TRUST_SHOWN_AS_FULL:
                found.setdefault(poke, []).append(estimate)
    return {poke: sorted(those, key=lambda e: e.doubted[poke]) for poke, those in found.items()}
