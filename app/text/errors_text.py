"""What is said of errors and of doubt: pure functions, without Qt.

First what the panel of errors says, and over what range it draws; then what each poke counts for a taxel, and where else the
taxel might lie.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import islice

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.files.reference import Origin, Reference
from skincal.geometry import FloatArray, axis_point, move_wrench
from skincal.session.error_history import MAX, MEAN, P95, TAXELS, ErrorSeries
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Estimate, Method, State
from skincal.words.units import ChannelNames, count, in_millimetres, millimetres, number

PAPER = {Method.FREE: 7.2e-3, Method.SURFACE: 6.6e-3}
"""m. Mean error of Del Prete et al. 2011 on their forearm, seven arm poses averaged (section V)."""
SYMBOLS: Mapping[Method, str] = {
    Method.FREE: "\N{BLACK CIRCLE}",
    Method.SURFACE: "\N{BLACK DIAMOND}",
    Method.MODULES: "\N{BLACK UP-POINTING TRIANGLE}",
}
"""Marks a method's line, in words as in the plot."""
STATISTICS = {
    MEAN: "\N{EM DASH} mean",
    P95: "\N{EN DASH} \N{EN DASH} p95",
    MAX: "\N{MIDDLE DOT}\N{MIDDLE DOT}\N{MIDDLE DOT} worst",
}
"""Each after the line that it is drawn with."""
STEPS = (1.0, 2.0, 5.0)
"""Marks of a logarithmic axis in each decade."""
DOUBT_MARKED = 0.5
"""Trust below which a poke is marked in the list: 99 of 100 good pokes stay above it."""
FULL = 0.995
"""Trust from which a poke counts fully, to two decimals."""
LISTED = 100
"""Pokes of one taxel in the list, the newest: more are not read."""


class Axis(Enum):
    """What errors are drawn against; the value is the word on the button."""

    POKES = "pokes"
    TIME = "time"
    MODULES = "modules"


AXIS_TITLES = {Axis.POKES: "accepted pokes", Axis.TIME: "minutes of poking", Axis.MODULES: "module"}


def source_words(source: Reference | None) -> str:
    """Return what errors are measured against; a plan is never called a truth."""
    if source is None:
        return "Predicted error; compared with no reference"
    if source.origin is Origin.PLAN:
        return "Error against the plan, which may lie a few mm off"
    if source.origin is Origin.TRUTH:
        return f"Error against the truth ({source.name})"
    return f"Error against {source.name}"


def quantity_words(source: Reference | None) -> str:
    """Return what the vertical axis shows."""
    return "predicted error, mm" if source is None else "error, mm"


def paper_words(method: Method) -> str:
    """Return the label of the paper's figure, short enough for the rim of the plot."""
    return f"{SYMBOLS[method]} paper {number(in_millimetres(PAPER[method]), 1)}"


def newest_words(series: ErrorSeries, method: Method, row: int) -> str:
    """Return a method's newest figures: of all taxels where `row` is 0, else of the module with index `row` - 1."""
    course = series.spreads.get(method)
    values = np.full(4, np.nan) if course is None or not len(course) else course[-1, row]
    figures = "   ".join(f"{name} {number(in_millimetres(float(values[at])), 1)}" for at, name in STATISTICS.items())
    taxels = 0 if math.isnan(values[TAXELS]) else int(values[TAXELS])
    return f"{figures} mm, {count(taxels, 'taxel')}"


def progress_words(series: ErrorSeries) -> str:
    """Return what is not worked out yet, or how the course was thinned; empty where there is nothing to say."""
    if series.missing:
        return f"working out {count(series.missing, 'point')} of the past"
    if not len(series.counts):
        return "none yet"
    return f"a point every {series.stride} pokes" if series.stride > 1 else ""


def axis_words(series: ErrorSeries, axis: Axis) -> str:
    """Return the title of the horizontal axis."""
    return ": ".join(filter(None, (AXIS_TITLES[axis], progress_words(series))))


def log_range(low: float, high: float) -> tuple[float, float]:
    """Return the next steps of 1, 2, 5 x 10^n at or below `low` and at or above `high`, both positive, any unit."""
    below, above = 10.0 ** math.floor(math.log10(low)), 10.0 ** math.floor(math.log10(high))
    # The slack takes a value that is a step but for its rounding for that step.
    bottom = max(step * below for step in STEPS if step * below <= low * (1 + 1e-9))
    top = min(step * above for step in (*STEPS, 10.0) if step * above >= high * (1 - 1e-9))
    return (bottom, top) if top > bottom else (bottom, 2.0 * bottom)


def log_ticks(low: float, high: float) -> list[tuple[float, str]]:
    """Return the marks of a logarithmic axis: log10 of the value, and its text."""
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    values = [step * 10.0**decade for decade in decades for step in STEPS]
    return [(math.log10(v), f"{v:g}") for v in values if low * (1 - 1e-9) <= v <= high * (1 + 1e-9)]


def shown_range(values: Sequence[FloatArray], least: float, most: float) -> tuple[float, float]:
    """Return the range of a logarithmic axis that shows all positive `values` and from `least` to `most`, all in mm."""
    found = [v[np.isfinite(v) & (v > 0.0)] for v in values]
    low = min([least, *(float(v.min()) for v in found if len(v))])
    high = max([most, *(float(v.max()) for v in found if len(v))])
    return log_range(low, high)


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
    return float((contact.responses[contact.channels == channel] / contact.responses.max())[0])


def miss_of(contact: Contact, estimate: Estimate) -> float | None:
    """Return the distance of a contact's axis from an estimate, metres; None where there is no position."""
    return _misses([contact], estimate)[0]


def _misses(contacts: Sequence[Contact], estimate: Estimate) -> list[float] | list[None]:
    # Together, since each by itself takes 0.3 ms of the window's time.
    if estimate.position is None or not contacts:
        return [None] * len(contacts)
    poses = np.array([contact.link_from_sensor for contact in contacts])
    forces, moments = (np.array([getattr(contact, name) for contact in contacts]) for name in ("force", "moment"))
    force, moment = move_wrench(poses, forces, moments)
    off = estimate.position - axis_point(force, moment)
    return (np.linalg.norm(np.cross(force, off), axis=1) / np.linalg.norm(force, axis=1)).tolist()


def taxel_pokes(snapshot: Snapshot, estimate: Estimate) -> tuple[TaxelPoke, ...]:
    """Return what pokes count for a taxel, newest first: those that touched it and are not excluded; none for a dead one."""
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
    words = f"counts {number(estimate.doubted[contact.poke], 2)} for {names.short(estimate.channel)}"
    miss = miss_of(contact, estimate)
    return words if miss is None else f"{words}: its axis passes {millimetres(miss)} from where the other pokes put the taxel"


def rival_words(estimate: Estimate | None) -> str:
    """Return where else a taxel may lie and what to do about it; empty where its place is the only one."""
    if estimate is None or estimate.rival is None or estimate.position is None:
        return ""
    away = millimetres(float(np.linalg.norm(estimate.rival.position - estimate.position)), 0)
    return f"Fits nearly as well {away} away (odds {number(estimate.rival.odds, 0)} to 1): poke it from another side."
