"""Sentences of the Errors tab: its reference, its axes and the newest figures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum

import numpy as np

from skincal.files.reference import Origin, TaxelPositions
from skincal.following.error_history import MAX, MEAN, P95, TAXELS, ErrorSeries
from skincal.taxels.result import Method
from skincal.words.units import cell, count

SYMBOL_OF_METHOD: Mapping[Method, str] = {
    Method.FREE: "\N{BLACK CIRCLE}",
    Method.SURFACE: "\N{BLACK DIAMOND}",
    Method.MODULES: "\N{BLACK UP-POINTING TRIANGLE}",
}
"""Sign of a method, in texts as in the plot."""
LEGEND_OF_STATISTIC = {
    MEAN: "\N{EM DASH} mean",
    P95: "\N{EN DASH} \N{EN DASH} p95",
    MAX: "\N{MIDDLE DOT}\N{MIDDLE DOT}\N{MIDDLE DOT} worst",
}
"""Names of the statistics, with their line styles."""


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
    figures = "   ".join(f"{name} {cell(float(values[at]), 'm')}" for at, name in LEGEND_OF_STATISTIC.items())
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
