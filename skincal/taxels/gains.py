"""How much a taxel answers to a newton, from the pokes that found its place.

A poke tells of a taxel's gain where that answered most: then the tip was nearer to it than to any other. Its part is the
answer over the force along the taxel's inward normal,

    g = t / (-f . n),

and the gain is the mean of these, its spread their standard deviation. The spread holds how far off the middle the tip came
down and how much softer foam answers to a large force, so it tells how one poke's answer is to be taken, not how exact the
mean is. Taxels that answer few pokes, or whose normal is not known, have no gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.taxels.result import Estimate

FEWEST_GAINS = 3
"""Pokes that a gain is told from: from two a spread says nothing."""
LOAD_MIN = 1.0
"""N along the inward normal. A push that grazes the skin divides its answer by nearly nothing."""


@dataclass(frozen=True, slots=True)
class TaxelGain:
    """How much one taxel answers."""

    pokes: int
    """In which it answered most; the gain is of these."""
    mean: float | None
    """Raw units a newton; None from fewer than `FEWEST_GAINS` pokes, or without a normal."""
    spread: float | None
    """Raw units a newton, standard deviation over the pokes; None as `mean`."""


def taxel_gains(contacts: Sequence[Contact], estimates: Sequence[Estimate]) -> tuple[TaxelGain, ...]:
    """Return the gain of each estimate's taxel, in their order.

    Parameters
    ----------
    contacts : those that count, as they are corrected
    estimates : of one method; their normals say which way a push counts. Pokes that an estimate doubts are left out
    """
    strongest: dict[int, list[Contact]] = {}
    for contact in contacts:
        strongest.setdefault(contact.strongest_channel, []).append(contact)
    return tuple(_gain(strongest.get(estimate.channel, ()), estimate) for estimate in estimates)


def _gain(contacts: Sequence[Contact], estimate: Estimate) -> TaxelGain:
    own = [contact for contact in contacts if contact.poke not in estimate.doubted]
    if estimate.normal is None or not own:
        return TaxelGain(len(own), None, None)
    forces = np.array([contact.link_from_sensor[:3, :3] @ contact.force for contact in own])
    answers = np.array([contact.responses.max() for contact in own])
    loads = -(forces @ estimate.normal)
    pressed = loads >= LOAD_MIN
    count = int(pressed.sum())
    if count < FEWEST_GAINS:
        return TaxelGain(count, None, None)
    each = answers[pressed] / loads[pressed]
    return TaxelGain(count, float(each.mean()), float(each.std(ddof=1)))
