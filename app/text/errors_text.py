"""Sentences of the Errors tab, and on pokes and positions in doubt."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import islice

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.files.reference import Origin, TaxelPositions
from skincal.following.error_history import MAX, MEAN, P95, TAXELS, ErrorSeries
from skincal.pokes import Pokes
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Estimate, Method, State
from skincal.words.units import ChannelNames, cell, count, millimetres, number

SYMBOLS: Mapping[Method, str] = {
    Method.FREE: "\N{BLACK CIRCLE}",
    Method.SURFACE: "\N{BLACK DIAMOND}",
    Method.MODULES: "\N{BLACK UP-POINTING TRIANGLE}",
}
"""Sign of a method, in texts as in the plot."""
STATISTICS = {
    MEAN: "\N{EM DASH} mean",
    P95: "\N{EN DASH} \N{EN DASH} p95",
    MAX: "\N{MIDDLE DOT}\N{MIDDLE DOT}\N{MIDDLE DOT} worst",
}
"""Names of the statistics, with their line styles."""
MARK_POKES_WITH_TRUST_BELOW = 0.5  # Weight below which the list marks a poke; 99 of 100 good pokes have more
MIN_TRUST_SHOWN_AS_FULL = 0.995  # Weight from which a poke counts fully, to two decimals
MAX_LISTED_POKES_PER_TAXEL = 100  # Longest list of a taxel's pokes, the newest ones


class Axis(Enum):
    """Horizontal axis of the errors; the value is the word on the button."""

    POKES = "pokes"
    TIME = "time"
    MODULES = "modules"


AXIS_TITLES = {Axis.POKES: "accepted pokes", Axis.TIME: "minutes of poking", Axis.MODULES: "module"}


def source_words(source: TaxelPositions | None) -> str:
    """Name the reference of the errors; a plan is not called a truth."""
    if source is None:
        return "Expected error, without a reference"
    if source.origin is Origin.PLAN:
        return "Error against the plan, which may be a few mm off"
    if source.origin is Origin.TRUTH:
        return f"Error against the truth ({source.name})"
    return f"Error against {source.name}"


def quantity_words(source: TaxelPositions | None) -> str:
    """Title of the vertical axis."""
    return "expected error, mm" if source is None else "error, mm"


def newest_words(series: ErrorSeries, method: Method, row: int) -> str:
    """Newest figures of a method: of all taxels if `row` is 0, else of the module with index `row` - 1."""
    course = series.spreads.get(method)
    values = np.full(4, np.nan) if course is None or not len(course) else course[-1, row]
    figures = "   ".join(f"{name} {cell(float(values[at]), 'm')}" for at, name in STATISTICS.items())
    taxels = 0 if math.isnan(values[TAXELS]) else int(values[TAXELS])
    return f"{figures} mm, {count(taxels, 'taxel')}"


def progress_words(series: ErrorSeries) -> str:
    """Count missing points, or give the spacing of the shown ones; may be empty."""
    if series.missing:
        return f"computing {count(series.missing, 'earlier point')}"
    if not len(series.counts):
        return "none yet"
    return f"one point for every {series.stride} pokes" if series.stride > 1 else ""


def axis_words(series: ErrorSeries, axis: Axis) -> str:
    """Title of the horizontal axis."""
    return ": ".join(filter(None, (AXIS_TITLES[axis], progress_words(series))))


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


def taxel_pokes(snapshot: Snapshot, estimate: Estimate) -> tuple[TaxelPoke, ...]:
    """List the counting pokes of a taxel, newest first; none for a disabled taxel."""
    if estimate.state is State.DEAD:
        return ()
    touching = (
        record.outcome
        for record in reversed(snapshot.pokes)
        if not record.excluded and isinstance(record.outcome, Contact) and estimate.channel in record.outcome.channels.tolist()
    )
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


def doubt_mark(poke: int, doubters: Sequence[Estimate], names: ChannelNames) -> str:
    """Mark of a doubted poke in the list: `"weight 0.2 for taxel 205"`; may be empty."""
    marked = [e for e in doubters if e.doubted[poke] < MARK_POKES_WITH_TRUST_BELOW]
    if not marked:
        return ""
    more = f" +{len(marked) - 1}" if len(marked) > 1 else ""
    return f"weight {number(marked[0].doubted[poke], 1)} for {names.taxel(marked[0].channel)}{more}"


def doubt_words(contact: Contact, estimate: Estimate, names: ChannelNames) -> str:
    """Give the trust in a poke for a taxel, and the reason."""
    words = f"weight {number(estimate.doubted[contact.poke], 2)} for {names.taxel(estimate.channel)}"
    miss = miss_of(contact, estimate)
    return words if miss is None else f"{words}: its force axis is {millimetres(miss)} from the position by the other pokes"


def rival_words(estimate: Estimate | None) -> str:
    """Describe a second possible position of a taxel and what to do; empty if there is none."""
    if estimate is None or estimate.rival is None or estimate.position is None:
        return ""
    away = millimetres(float(np.linalg.norm(estimate.rival.position - estimate.position)), 0)
    odds = number(estimate.rival.odds, 0)
    return f"A second position {away} away fits almost as well (odds {odds} to 1). Press from another side."
