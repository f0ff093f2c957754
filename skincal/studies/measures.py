"""Each method and each alternative on one cell of the runtime study: its time, and its error against the truth.

What is too slow to run whole is run on a part of its triangles or taxels, drawn at random, and its time is that of a
piece times the number of pieces; its row says of what part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry.arrays import FloatArray, IntArray
from skincal.methods import average_over_poses, estimate_from, estimate_taxels
from skincal.modules.pose import ModuleModel
from skincal.studies import alternatives
from skincal.studies.alternatives import Problems, Systems, problems
from skincal.studies.benches import Bench
from skincal.studies.clock import Spread, sampled, timed
from skincal.surface.mesh import Surface
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Estimate, Method

CHUNK = 25
"""Triangles of one timed piece of the paper's way: 0.5 ms by quadprog, far above what a clock's reading costs."""
WARM = 50
"""Contacts, and taxels, that are solved before the clock runs."""
WHOLE = 100_000
"""Pairs of taxel and triangle. Where there are no more, all may be solved; else a sample of them."""
SPREAD_OVER = 24
"""Taxels over which a sample of triangles is spread, and whose answers are compared."""

LABELS = {
    "surface": "surface, as shipped",
    "free": "free, as shipped",
    "brute": "surface: every triangle, closed form",
    "facing": "surface: every triangle that is pushed, closed form",
    "compiled": "surface: every triangle that is pushed, compiled",
    "bounded": "surface: every triangle's bound, then closed form",
    "quadprog": "surface: each triangle by quadprog",
    "slsqp": "surface: each triangle by SLSQP",
    "modules": "modules, as shipped",
    "modules-general": "modules: scipy's Levenberg-Marquardt",
    "modules-per-pose": "modules: each pose alone, averaged",
    "surface-per-pose": "surface: each pose alone, averaged",
    "free-per-pose": "free: each pose alone, averaged",
    "lstsq": "free: numpy's lstsq for each taxel",
    "normal": "free: normal equations",
}
"""Name of each method in JSON, and in words."""

QUANTILES = ("median", "q1", "q3")
Positions = dict[int, FloatArray]
Row = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Cell:
    """One size of the problem: a part, its mesh and contacts."""

    bench: Bench
    surface: Surface
    per_taxel: int
    runs: Sequence[Sequence[Contact]]
    """Contacts, simulated anew for each seed."""
    channels: Sequence[int]
    repeats: int
    """How often what is fast is run on each seed's contacts."""
    budget_s: float
    """s. How long each slow alternative may run."""

    def row(
        self,
        method: str,
        seconds: Spread,
        found: Sequence[Positions],
        part: Mapping[str, Any] | None = None,
    ) -> Row:
        """Return a row of the table.

        Parameters
        ----------
        seconds : of a whole solve, from contacts to positions
        found : positions by channel, one a seed
        part : what the seconds were extrapolated from; None where nothing was left out
        """
        means = [1e3 * float(np.mean(errors)) for errors in map(self.bench.errors, found) if len(errors)]
        return {
            "part": self.bench.name,
            "taxels": len(self.channels),
            "triangles": len(self.surface.triangles),
            "pokes_per_taxel": self.per_taxel,
            "contacts": len(self.runs[0]),
            "method": method,
            "label": LABELS[method],
            "time_ms": seconds.times(1e3).json(),
            "error_mm": Spread.of(means).json() if means else None,
            "error_of_taxels": len(found[0]) if found else 0,
            "from_session_ms": None,
            "off_ours_m": None,
            "error_beside_ours_mm": None,
            "extrapolated_from": None if part is None else dict(part),
        }


def boards_of(cell: Cell) -> ModuleModel:
    """Return the boards of a cell's part on its mesh."""
    skin = cell.bench.scene.skin
    if skin.layout is None:
        raise ValueError(f"{cell.bench.name} has no layout")
    return ModuleModel(skin.layout, skin.anchor, cell.surface)


def positions_of(estimates: Mapping[int, Estimate]) -> Positions:
    """Return the positions of those that have one."""
    return {channel: one.position for channel, one in estimates.items() if one.position is not None}


class Shipped:
    """A method of the program on a cell, from contacts to estimates with their uncertainty.

    It may be run again after what it is compared with, so that a machine that slows down meanwhile slows both.
    """

    def __init__(self, cell: Cell, method: Method) -> None:
        self.cell, self.method = cell, method
        self._seconds: list[float] = []
        self._results: list[dict[int, Estimate]] = []
        self._boards = boards_of(cell) if method is Method.MODULES else None
        # Builds the surface's tree, once for all solves (`tree_build_ms` of the JSON), and loads what is loaded once.
        self._solve(cell.runs[0][:WARM], cell.channels[:WARM])

    def _solve(self, contacts: Sequence[Contact], channels: Sequence[int]) -> dict[int, Estimate]:
        noise = self.cell.bench.scene.noise
        return estimate_taxels(contacts, channels, [self.method], noise, self.cell.surface, model=self._boards)[self.method]

    def run(self) -> dict[int, Estimate]:
        """Measure, and return the first seed's estimates."""
        seconds, self._results = _each_run(
            self.cell, lambda contacts: self._solve(contacts, self.cell.channels), self.cell.repeats
        )
        self._seconds += seconds
        return self._results[0]

    def row(self) -> Row:
        """Return the row of all that was measured."""
        found = [positions_of(one) for one in self._results]
        row = self.cell.row(self.method.value, Spread.of(self._seconds), found)
        if self.method is Method.SURFACE:
            row["from_session_ms"] = _from_session(self.cell, self.method).times(1e3).json()
        return row


def beside(row: Row, ours: Row) -> Row:
    """Return the row of an alternative that solved some taxels: its error is ours plus what differs on these."""
    more = row["error_beside_ours_mm"]
    if more is None or ours["error_mm"] is None:
        return row
    return {**row, "error_mm": {**ours["error_mm"], **{key: ours["error_mm"][key] + more for key in QUANTILES}}}


def shipped(cell: Cell, method: Method) -> Row:
    """Measure a method of the program."""
    measured = Shipped(cell, method)
    measured.run()
    return measured.row()


def _from_session(cell: Cell, method: Method) -> Spread:
    """Return the seconds of the same solve from what a session keeps of its contacts, without their way into it."""
    ledger, noise = ContactTable(cell.runs[0]), cell.bench.scene.noise
    return Spread.of(timed(lambda: estimate_from(ledger, cell.channels, [method], noise, cell.surface), cell.repeats)[0])


def per_pose(cell: Cell, method: Method) -> Row:
    """Measure the paper's averaging over arm poses (IV-B)."""
    boards = boards_of(cell) if method is Method.MODULES else None

    def solve(contacts: Sequence[Contact]) -> Positions:
        noise = cell.bench.scene.noise
        return positions_of(average_over_poses(contacts, cell.channels, method, noise, cell.surface, model=boards))

    timings, found = _each_run(cell, solve, cell.repeats)
    return cell.row(f"{method.value}-per-pose", Spread.of(timings), found)


def free_alternatives(cell: Cell) -> list[Row]:
    """Measure the other ways to solve the free method."""
    rows: list[Row] = []
    ways = {"lstsq": alternatives.by_lstsq, "normal": alternatives.by_normal_equations}
    for name, way in ways.items():

        def solve(contacts: Sequence[Contact], way: Callable[..., FloatArray] = way) -> Positions:
            system = alternatives.stacked(contacts, cell.channels)
            # Two contacts or more: one axis is a line and no position.
            pairs = zip(system.channels, way(system), np.diff(system.starts) > 3, strict=True)
            return {channel: p for channel, p, enough in pairs if enough and np.isfinite(p).all()}

        timings, found = _each_run(cell, solve, max(1, cell.repeats // 2))
        rows.append(cell.row(name, Spread.of(timings), found))
    return rows


def _each_run(cell: Cell, solve: Callable[[Sequence[Contact]], Any], repeats: int) -> tuple[list[float], list[Any]]:
    timings: list[float] = []
    results: list[Any] = []
    for contacts in cell.runs:
        seconds, result = timed(partial(solve, contacts), repeats)
        timings += seconds
        results.append(result)
    return timings, results


@dataclass(frozen=True, eq=False)
class Searches:
    """The other ways to search the surface on one cell, with what they begin from."""

    cell: Cell
    systems: Systems
    front: Spread
    """s. From contacts to the taxels' factors, which every alternative needs too."""
    ours: Mapping[int, Estimate]
    """The shipped method's answers."""
    order: IntArray
    """Taxels in random order."""

    @classmethod
    def of(cls, cell: Cell, ours: Mapping[int, Estimate]) -> Searches:
        """Prepare the first seed's contacts."""
        contacts, noise = cell.runs[0], cell.bench.scene.noise
        seconds, begun = timed(lambda: alternatives.systems(contacts, cell.channels, noise), cell.repeats)
        order = np.random.default_rng(1).permutation(len(begun.channels))
        return cls(cell, begun, Spread.of(seconds), ours, order)

    def over_triangles(self, name: str, way: Callable[..., FloatArray]) -> Row:
        """Measure a way that goes through a taxel's triangles by itself."""
        found: Positions = {}

        def solve(taxel: int) -> None:
            point = way(self.cell.surface, *self._system(taxel))
            found[self.systems.channels[taxel]] = point

        solve(int(self.order[0]))
        seconds = sampled((partial(solve, taxel) for taxel in self.order.tolist()), self.cell.budget_s)
        total = Spread.of(seconds).times(len(self.order)).plus(self.front.median)
        part = None
        if len(seconds) < len(self.order):
            part = {"taxels": len(seconds), "of_taxels": len(self.order), "seconds": float(np.sum(seconds))}
        return self._row(name, total, found, part)

    def each_triangle(self, name: str, solver: Callable[[Problems], FloatArray]) -> Row:
        """Measure the paper's way: each triangle a constrained least squares."""
        few = self.order[:SPREAD_OVER].tolist()
        total = round(float(np.mean([len(self._facing(taxel)) for taxel in few])) * len(self.order))
        taxels = self.order.tolist() if total <= WHOLE else few
        sizes: list[int] = []

        def solve(taxel: int, triangles: IntArray) -> None:
            solver(self._problems(taxel, triangles))
            sizes.append(len(triangles))

        solve(few[0], self._facing(few[0])[:CHUNK])
        sizes.clear()
        seconds = sampled((partial(solve, *piece) for piece in self._pieces(taxels)), self.cell.budget_s)
        rates = Spread.of([spent / size for spent, size in zip(seconds, sizes, strict=True)])
        found: Positions = {self.systems.channels[taxel]: self._winner(taxel, solver) for taxel in few}
        part = None
        if sum(sizes) < total:
            part = {"triangles": sum(sizes), "of_triangles": total, "seconds": float(np.sum(seconds))}
        return self._row(name, rates.times(total).plus(self.front.median), found, part)

    def _row(self, name: str, seconds: Spread, found: Positions, part: Mapping[str, Any] | None) -> Row:
        ours = {channel: point for channel, point in positions_of(self.ours).items() if channel in found}
        off = [float(np.linalg.norm(found[channel] - point)) for channel, point in ours.items()]
        row = {**self.cell.row(name, seconds, [found], part), "off_ours_m": max(off, default=None)}
        if ours:
            both = {channel: found[channel] for channel in ours}
            errors = self.cell.bench.errors
            row["error_beside_ours_mm"] = 1e3 * float(np.mean(errors(both)) - np.mean(errors(ours)))
        return row

    def _system(self, taxel: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.systems.roots[taxel], self.systems.offsets[taxel], self.systems.pushes[taxel]

    def _facing(self, taxel: int) -> IntArray:
        return alternatives.facing(self.cell.surface, self.systems.pushes[taxel])

    def _pieces(self, taxels: Sequence[int]) -> Iterator[tuple[int, IntArray]]:
        """Give taxels with `CHUNK` triangles that their pokes push on, each pair once: one of each taxel in turn, at random."""
        rng = np.random.default_rng(2)
        facing = {taxel: rng.permutation(self._facing(taxel)) for taxel in taxels}
        for first in range(0, max(map(len, facing.values())), CHUNK):
            for taxel, triangles in facing.items():
                if first < len(triangles):
                    yield taxel, triangles[first : first + CHUNK]

    def _problems(self, taxel: int, triangles: IntArray) -> Problems:
        root, offset, _ = self._system(taxel)
        count = len(triangles)
        roots, offsets = np.broadcast_to(root, (count, 3, 3)), np.broadcast_to(offset, (count, 3))
        return problems(self.cell.surface.corners[triangles], roots, offsets)

    def _winner(self, taxel: int, solver: Callable[[Problems], FloatArray]) -> FloatArray:
        """Return the best point over the triangle of our answer and those that touch it, by another solver."""
        triangle = self.ours[self.systems.channels[taxel]].triangle
        surface, facing = self.cell.surface, self._facing(taxel)
        if triangle is not None:
            near = np.isin(surface.triangles[facing], surface.triangles[triangle]).any(axis=1)
            facing = facing[near]
        some = self._problems(taxel, facing)
        points = some.points(solver(some))
        root, offset, _ = self._system(taxel)
        return points[np.linalg.norm(points @ root.T - offset, axis=1).argmin()]
