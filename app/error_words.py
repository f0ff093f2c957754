"""What the panel of errors says and over what range it draws: pure functions, without Qt."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import Enum

import numpy as np

from app.display_units import count, in_millimetres, number
from skincal.files.reference import Origin, Reference
from skincal.geometry.arrays import FloatArray
from skincal.session.error_history import MAX, MEAN, P95, TAXELS, ErrorSeries
from skincal.taxels.result import Method

PAPER = {Method.FREE: 7.2e-3, Method.SURFACE: 6.6e-3}
"""m. Mean error of Del Prete et al. 2011 on their forearm, seven arm poses averaged (section V)."""
SYMBOLS: Mapping[Method, str] = {
    Method.FREE: "\N{BLACK CIRCLE}",
    Method.SURFACE: "\N{BLACK DIAMOND}",
    Method.MODULES: "\N{BLACK UP-POINTING TRIANGLE}",
}
"""What tells a method's line, in words as in the plot."""
STATISTICS = {
    MEAN: "\N{EM DASH} mean",
    P95: "\N{EN DASH} \N{EN DASH} p95",
    MAX: "\N{MIDDLE DOT}\N{MIDDLE DOT}\N{MIDDLE DOT} max",
}
"""Each after the line that it is drawn with."""
STEPS = (1.0, 2.0, 5.0)


class Axis(Enum):
    """What errors are drawn against; the value is the word on the button."""

    POKES = "pokes"
    TIME = "time"
    MODULES = "modules"


AXIS_TITLES = {Axis.POKES: "accepted pokes", Axis.TIME: "minutes of poking", Axis.MODULES: "module"}


def source_words(source: Reference | None) -> str:
    """Return what errors are measured against; a plan is never called a truth."""
    if source is None:
        return "Predicted error (rms); compared with no reference"
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
    """Return a method's newest figures.

    Parameters
    ----------
    row : 0 for all taxels, else 1 + index of the module
    """
    course = series.spreads.get(method)
    values = np.full(4, np.nan) if course is None or not len(course) else course[-1, row]
    told = "   ".join(f"{name} {number(in_millimetres(float(values[at])), 1)}" for at, name in STATISTICS.items())
    taxels = 0 if math.isnan(values[TAXELS]) else int(values[TAXELS])
    return f"{told} mm, {count(taxels, 'taxel')}"


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
