"""What the studies share: processes for their cases, rows, limits, and the result with its lines and its picture.

A study declares its cases and draws its figure. A case has one or more runs, such as seeds. `Bench.rows` measures the runs in
processes and makes a row of each case; `Study.run` checks the limits and returns the JSON.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar, cast

import numpy as np

from skincal.plotting import Figure, render

FIGURE_DOTS_PER_INCH = 130
FIGURE_INCHES = (12.0, 7.0)
"""Width and height, unless a study sets its own."""
Row: TypeAlias = dict[str, Any]
"""JSON of a case."""
Limits: TypeAlias = Mapping[str, tuple[float, str, float]]
"""By name: value, ">=" or "<=", limit."""
AboutT = TypeVar("AboutT")
RunT = TypeVar("RunT")
FoundT = TypeVar("FoundT")
SizesT = TypeVar("SizesT")


def processes() -> ProcessPoolExecutor:
    """Start one process for each core that this process may use. Results do not depend on their number."""
    return ProcessPoolExecutor(usable_cores(), mp_context=multiprocessing.get_context("spawn"))


def usable_cores() -> int:
    """Count the cores that this process may use: a container or a scheduler may allow fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


class Bench:
    """Runs the cases of a study, and reports progress.

    Parameters
    ----------
    say : gets sentences
    pool : processes for the runs; `None` to run in this process
    """

    def __init__(self, say: Callable[[str], None], pool: ProcessPoolExecutor | None = None) -> None:
        self.say, self._pool = say, pool

    def each(self, work: Callable[[RunT], FoundT], runs: Iterable[RunT]) -> Iterator[FoundT]:
        """Measure runs, in parallel; yield the results in the order of the runs."""
        return map(work, runs) if self._pool is None else self._pool.map(work, runs)

    def rows(
        self,
        cases: Iterable[tuple[AboutT, Sequence[RunT]]],
        work: Callable[[RunT], FoundT],
        row: Callable[[AboutT, list[FoundT]], Row],
        text: Callable[[Row], str],
    ) -> list[Row]:
        """Measure cases, each with its runs. Make a `row` of the results of each case, and say its `text`."""
        every = list(cases)
        found = self.each(work, [run for _, runs in every for run in runs])
        rows: list[Row] = []
        for about, runs in every:
            rows.append(row(about, list(islice(found, len(runs)))))
            self.say(text(rows[-1]).strip())
        return rows


SILENT_BENCH = Bench(lambda _: None)
"""Runs cases in this process, and says nothing."""


class Findings(NamedTuple):
    """Numbers of a study, JSON without NaN, and the limits that they must keep; `None` if it has no limits."""

    numbers: dict[str, Any]
    limits: Limits | None = None


@dataclass(frozen=True, slots=True)
class Study(Generic[SizesT]):
    """One study: its cases in two sizes, their measurement, lines of text and a figure."""

    name: str
    quick: SizesT
    """At most 90 s on two idle cores."""
    full: SizesT
    measure: Callable[[Bench, SizesT], Findings]
    lines: Callable[[Mapping[str, Any]], list[str]]
    """Lines of text that describe a result; those of the limits follow."""
    draw: Callable[[Mapping[str, Any], Figure], None]
    """Draws a result into an empty figure."""
    in_processes: bool = True
    """Whether its cases run in parallel. Times must not."""

    def run(self, quick: bool, say: Callable[[str], None], sizes: SizesT | None = None) -> dict[str, Any]:
        """Measure; `sizes` replaces those of the quick or the full study. `say` gets sentences.

        Returns
        -------
        JSON without NaN. A list `misses` in it names faults of the program: unless it is empty, the command ends with exit
        code 1
        """
        sizes = sizes or (self.quick if quick else self.full)
        if self.in_processes:
            with processes() as pool:
                found = self.measure(Bench(say, pool), sizes)
        else:
            found = self.measure(Bench(say), sizes)
        bars = {} if found.limits is None else {"bars": check_limits(found.limits)}
        return {"study": self.name, "quick": quick, **found.numbers, **bars}

    def summary(self, result: Mapping[str, Any]) -> list[str]:
        """Describe a result and its limits in lines of text."""
        return [*self.lines(result), *limit_lines(result.get("bars", {}))]

    def pictures(self, result: Mapping[str, Any], kinds: Sequence[str]) -> list[bytes]:
        """Draw a result and encode the figure as each of `kinds` ("svg", "png")."""
        return render(partial(self.draw, result), FIGURE_INCHES, kinds, FIGURE_DOTS_PER_INCH)


# ---- numbers ----


def finite(number: float) -> float | None:
    """Convert a number for JSON, which has no infinity: `None` if it is not finite."""
    return float(number) if np.isfinite(number) else None


def side_by_side(trees: Sequence[Any]) -> Any:
    """Combine equally shaped trees into one tree whose leaves are lists."""
    first = trees[0]
    if isinstance(first, dict):
        shape = cast("dict[Any, Any]", first)
        return {name: side_by_side([tree[name] for tree in trees]) for name in shape}
    return [side_by_side(some) for some in zip(*trees, strict=True)] if isinstance(first, list) else list(trees)


def check_limits(limits: Limits) -> dict[str, dict[str, Any]]:
    """Check each limit of a study.

    Returns
    -------
    JSON by name: `value` (`None` if it is not finite), `sign`, `limit` and `holds`
    """
    return {
        name: {
            "value": finite(value), "sign": sign, "limit": limit,
            "holds": bool(value >= limit if sign == ">=" else value <= limit),
        }
        for name, (value, sign, limit) in limits.items()
    }  # fmt: skip


def limit_lines(limits: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Describe each limit in a line."""
    lines: list[str] = []
    for name, one in limits.items():
        value = "not reached" if one["value"] is None else f"{one['value']:.4g}"
        holds = "holds" if one["holds"] else "DOES NOT HOLD"
        lines.append(f"{name}: {value}, limit {one['sign']} {one['limit']:g}: {holds}")
    return lines
