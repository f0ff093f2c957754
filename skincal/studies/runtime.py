"""Error against run time: the methods as shipped beside every honest alternative, in one run on one machine.

The table has a row for each method on each size of the problem: a forearm of 84 taxels and a torso of 4,200, on meshes of
300 to 100,000 triangles, with 1 to 100 pokes a taxel. Ratios are between times of the same run. The bars are those that
`docs/benchmarks.md` states. What is too slow to run whole is run on a part of its triangles, taxels or modules, drawn at
random, and its time is that of a piece times the number of pieces; its row says of what part.

The modules method is compared with scipy's Levenberg-Marquardt (`least_squares`, MINPACK) with a differenced Jacobian, each
module by itself, from the same start. It gets the method's own rows, whitened anew at each pose, and computes neither trust nor
uncertainty: both favour it.
"""

from __future__ import annotations

import copy
import os
import platform
import time
import tracemalloc
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from itertools import chain, groupby
from typing import Any, TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray
from skincal.mesh.search import build_tree
from skincal.mesh.surface import Surface, make_surface
from skincal.methods import average_over_poses, estimate_from, estimate_taxels
from skincal.modules.pose import ModuleModel
from skincal.modules.pose_fit import start_of, whitened
from skincal.session.session import Session
from skincal.simulate.benches import Bench
from skincal.studies import alternatives
from skincal.studies.alternatives import ModuleProblem, Problems, problems
from skincal.studies.figures import LOOKS, Figure, draw_runtime
from skincal.studies.measuring import CLOCK, bar_lines, bars_of, poke_seconds, quartiles, time_words, timed
from skincal.studies.waiting import help_time, import_time
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import PER_TAXEL, Estimate, Method

SEARCHES: Mapping[str, Callable[..., FloatArray]] = {
    "brute": alternatives.every_triangle,
    "facing": alternatives.facing_triangles,
    "compiled": alternatives.compiled_triangles,
    "bounded": alternatives.bounded_triangles,
}
"""Ways that go through a taxel's triangles by themselves."""
CHUNK = 25
"""Triangles of one timed piece of the paper's way: 0.5 ms by quadprog, far above what a clock's reading costs."""
WARM = 50
"""Contacts, and taxels, that are solved before the clock runs."""
WHOLE = 100_000
"""Pairs of taxel and triangle. Where there are no more, all may be solved; else a sample of them."""
SPREAD_OVER = 24
"""Taxels over which a sample of triangles is spread, and whose answers are compared."""
GENERAL = {"xtol": 1e-10, "ftol": 1e-12, "gtol": 1e-12}
"""Unknowns are metres: it stops where a step is a hundredth of a micrometre of a pose some centimetres away."""
TOUCHED = 7
"""Taxels that a timed poke touches: what a tip of 4 mm between pads 5 mm apart reaches at most."""
PACE = 20_000
"""Matrices whose axes numpy finds in some 17 ms."""
SLOW_TO_POKE = 30
"""Pokes a taxel from which on one seed does: the simulation takes longer than all that is measured on it."""
AS_SHIPPED = (
    "As shipped: with uncertainty, trust and rivals, which the other ways do not give. Trust finds pokes that touched two "
    "places, and adds 1 to 2 % to the error where there are none."
)
Say: TypeAlias = Callable[[str], None]
Positions: TypeAlias = dict[int, FloatArray]
Row: TypeAlias = dict[str, Any]


@dataclass(frozen=True, slots=True)
class PartSizes:
    """What is measured on one part, around a cell on which everything is: its own mesh, all its taxels."""

    scene: str
    seeds: int
    repeats: int
    meshes: tuple[int, ...]
    """Triangles, beside the mesh that ships."""
    pokes: tuple[int, ...]
    """Pokes a taxel, beside `RuntimeSizes.per_taxel`."""
    taxels: tuple[int, ...] = ()
    """Taxels, beside all."""
    budget_s: float = 5.0
    """s. How long each slow alternative runs where everything is measured; a fifth of it elsewhere."""


@dataclass(frozen=True, slots=True)
class RuntimeSizes:
    """What is measured."""

    small: PartSizes = PartSizes("icub-forearm", 5, 5, (300, 1_000, 3_000, 30_000, 100_000), (1, 3, 30, 100))
    large: PartSizes = PartSizes("whole-body", 3, 3, (300, 1_000, 10_000, 30_000), (1, 3, 36), (84, 420, 1_260))
    """The ratios are of this one."""
    per_taxel: int = 12
    """Pokes a taxel wherever only meshes or taxels differ."""
    everywhere: bool = True
    """All alternatives on all cells."""
    growth_until_s: float = float("inf")
    """s. No further size of the problem is begun after this time."""
    live_pokes: int = 200
    live_per_taxel: tuple[int, ...] = (12, 100)
    resolved: int = 10_000
    memory_pokes: int = 4_000
    log_pokes: int = 60
    """Pokes of the log that is imported, some two seconds each."""


FULL = RuntimeSizes()
QUICK = RuntimeSizes(
    small=PartSizes("icub-forearm", 2, 2, (1_000, 100_000), (1, 30), budget_s=0.3),
    large=PartSizes("whole-body", 1, 2, (1_000,), (), (84, 420), budget_s=0.8),
    everywhere=False, growth_until_s=20.0, live_pokes=60, live_per_taxel=(12,), memory_pokes=1_000, log_pokes=12,
)  # fmt: skip


def run(quick: bool, progress: Say, sizes: RuntimeSizes | None = None) -> dict[str, Any]:
    """Measure everything; see `docs/benchmarks.md` for what the JSON holds."""
    began = time.perf_counter()
    sizes = sizes or (QUICK if quick else FULL)
    small, large = Bench(sizes.small.scene), Bench(sizes.large.scene)
    left_out: list[str] = []

    def leave_out(sentence: str) -> None:
        left_out.append(sentence)
        progress(sentence)

    if not alternatives.has_quadprog():
        leave_out("quadprog is not installed; left out")
    rows: list[Row] = []
    off: dict[str, float] = {}
    for row in _table([(small, sizes.small), (large, sizes.large)], sizes, progress, leave_out):
        rows.append(row)
        if row["off_ours_m"] is not None:
            off[row["method"]] = max(off.get(row["method"], 0.0), row["off_ours_m"])
        progress(_in_words(row))
    progress("pokes one by one, a whole session at once, memory, the import of a log, the help")
    lively = {
        "poke": [poke_time(small, per_taxel, sizes.live_pokes) for per_taxel in sizes.live_per_taxel],
        "resolve": resolve_time(small, sizes.resolved, sizes.small.repeats // 2),
        "whole": whole_time(large, sizes.per_taxel, sizes.large.repeats),
        "memory": memory(small, sizes.memory_pokes),
        "import": import_time(small, sizes.log_pokes),
        "help": help_time(sizes.small.repeats),
    }
    ratios = ratios_of(rows, large.name, sizes.per_taxel) | waiting_ratios(lively)
    fresh = {bench.name: make_surface(bench.surface.vertices, bench.surface.triangles) for bench in (small, large)}
    return {
        "study": "runtime",
        "quick": quick,
        "machine": _machine(),
        "table": rows,
        "growth": growth_of(rows, sizes.per_taxel),
        "agreement_m": off,
        **lively,
        "tree_build_ms": {name: 1e3 * timed([partial(build_tree, mesh)])[0][0] for name, mesh in fresh.items()},
        "ratios": ratios,
        "bars": runtime_bars(ratios, off, lively),
        "left_out": left_out,
        "seconds": time.perf_counter() - began,
    }


def _machine() -> dict[str, Any]:
    packages = ("numpy", "scipy", *(("quadprog",) if alternatives.has_quadprog() else ()))
    return {
        "platform": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
        "cpus": os.cpu_count(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "clock": CLOCK,
    }


# ---- which sizes are measured ----


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

    def row(self, method: str, seconds: Sequence[float], found: Sequence[Positions], **more: Any) -> Row:
        """Return a row of the table.

        Parameters
        ----------
        seconds : of whole solves, from contacts to positions
        found : positions by channel, one a seed
        """
        means = [1e3 * float(np.mean(errors)) for errors in map(self.bench.errors, found) if len(errors)]
        return {
            "part": self.bench.name, "taxels": len(self.channels), "triangles": len(self.surface.triangles),
            "pokes_per_taxel": self.per_taxel, "contacts": len(self.runs[0]), "method": method, "label": LOOKS[method].label,
            "time_ms": ms_of(seconds), "error_mm": quartiles(means) if means else None,
            "error_of_taxels": len(found[0]) if found else 0, "from_session_ms": None, "off_ours_m": None,
            "error_beside_ours_mm": None, "extrapolated_from": None, **more,
        }  # fmt: skip

    def measured(self, method: str, solve: Callable[[Sequence[Contact]], Positions], repeats: int, **more: Any) -> Row:
        """Return the row of what is fast enough to be run whole, `repeats` times on each seed's contacts."""
        both = [timed([partial(solve, contacts)] * repeats) for contacts in self.runs]
        return self.row(method, [second for seconds, _ in both for second in seconds], [found[-1] for _, found in both], **more)

    def sampled(
        self,
        method: str,
        ours: Row,
        pieces: Iterable[tuple[Callable[[], object], int]],
        whole: tuple[int, str, float],
        seeds: int = 1,
    ) -> Callable[..., Row]:
        """Do pieces of a slow solve as far as the budget goes; return what makes the row of the positions that they gave.

        Parameters
        ----------
        ours : row of the method that it is compared with
        pieces : what is done, and how many of `whole` it is
        whole : how many there are on one seed, what they are, and the seconds from contacts to what each of them begins from
        seeds : on how many of them the pieces are; the row takes a sequence of positions, one a seed
        """
        works, sizes = zip(*pieces, strict=True)
        seconds, _ = timed(works, self.budget_s)
        (count, what, front), done = whole, sum(sizes[: len(seconds)])
        part = None if done >= count * seeds else {what: done, f"of_{what}": count * seeds, "seconds": float(np.sum(seconds))}
        spent = [second / size * count + front for second, size in zip(seconds, sizes, strict=False)]

        def row(found: Sequence[Positions], near: Sequence[Positions], beside: Sequence[Positions]) -> Row:
            # How far the answers lie from ours, and what they err more: the row's error is our row's plus that.
            off = [
                float(np.linalg.norm(theirs[channel] - point))
                for theirs, points in zip(found, near, strict=True)
                for channel, point in points.items()
            ]
            made = self.row(method, spent, found, off_ours_m=max(off, default=None), extrapolated_from=part)
            both = [(theirs, points) for theirs, points in zip(found, beside, strict=True) if points]
            if both:
                errors, error = self.bench.errors, ours["error_mm"]
                theirs = [np.mean(errors({channel: other[channel] for channel in points})) for other, points in both]
                more = 1e3 * float(np.mean(theirs) - np.mean([np.mean(errors(points)) for _, points in both]))
                made["error_beside_ours_mm"] = more
                if error is not None:
                    made["error_mm"] = {**error, **{key: error[key] + more for key in ("median", "q1", "q3")}}
            return made

        return row


def ms_of(seconds: Sequence[float]) -> dict[str, Any]:
    """Return quartiles, ms."""
    return quartiles([1e3 * second for second in seconds])


def _table(benches: Sequence[tuple[Bench, PartSizes]], sizes: RuntimeSizes, progress: Say, leave_out: Say) -> Iterator[Row]:
    """Measure what the ratios need, then how cost grows, as far as there is time."""
    began = time.perf_counter()
    growths: list[Iterator[Iterator[Row]]] = []
    for bench, part in benches:
        progress(f"poking {part.scene}: {len(bench.channels)} taxels, {sizes.per_taxel} pokes each")
        runs = [bench.contacts(sizes.per_taxel, seed) for seed in range(1, part.seeds + 1)]
        main = Cell(bench, bench.surface, sizes.per_taxel, runs, bench.channels, part.repeats, part.budget_s)
        yield from _free(main)
        yield from _surface(main, True)
        yield from _modules(replace(main, repeats=max(1, part.repeats // 2)))
        growths.insert(0, _growth(main, part, sizes))
    for number, on_size in enumerate(chain(*growths)):
        if number > 0 and time.perf_counter() - began > sizes.growth_until_s:
            leave_out("the machine is slow: some sizes of the problem are left out")
            return
        yield from on_size


def _growth(main: Cell, part: PartSizes, sizes: RuntimeSizes) -> Iterator[Iterator[Row]]:
    """Give the cells on which one size differs; the first of the large part is needed for the ratios."""
    short = replace(main, runs=main.runs[:1], repeats=max(1, part.repeats // 2), budget_s=part.budget_s / 5)
    for triangles in part.meshes:
        cell = replace(short, surface=main.bench.mesh(triangles))
        yield chain(_surface(cell, sizes.everywhere), _shipped(cell, [Method.MODULES] if sizes.everywhere else []))
    for taxels in part.taxels:
        channels = main.channels[:taxels]
        answered = [contact for contact in main.runs[0] if not set(channels).isdisjoint(contact.channels.tolist())]
        yield _shipped(replace(short, channels=channels, runs=[answered]))
    for per_taxel in part.pokes:
        seeds = part.seeds if per_taxel < SLOW_TO_POKE else 1
        runs = [main.bench.contacts(per_taxel, seed) for seed in range(1, seeds + 1)]
        cell = replace(short, runs=runs, per_taxel=per_taxel)
        yield chain(_shipped(cell, [Method.SURFACE, Method.MODULES]), _free(cell)) if sizes.everywhere else _shipped(cell)


# ---- the methods as shipped, and each pose alone ----


def positions_of(estimates: Mapping[int, Estimate]) -> Positions:
    """Return the positions of those that have one."""
    return {channel: found.position for channel, found in estimates.items() if found.position is not None}


def shipped(cell: Cell, method: Method, repeats: int) -> Row:
    """Measure a method of the program, from contacts to estimates with their uncertainty."""
    model, noise, more = cell.bench.modules_on(cell.surface) if method is Method.MODULES else None, cell.bench.scene.noise, {}

    def solve(contacts: Sequence[Contact], channels: Sequence[int] = cell.channels) -> Positions:
        return positions_of(estimate_taxels(contacts, channels, [method], noise, cell.surface, model=model)[method])

    # Builds the surface's tree, once for all solves (`tree_build_ms` of the JSON), and loads what is loaded once.
    solve(cell.runs[0][:WARM], cell.channels[:WARM])
    if method is Method.SURFACE:
        # The same from what a session keeps of its contacts.
        again = partial(estimate_from, ContactTable(cell.runs[0]), cell.channels, [method], noise, cell.surface)
        more["from_session_ms"] = ms_of(timed([again] * cell.repeats)[0])
    return cell.measured(method.value, solve, repeats, **more)


def _shipped(cell: Cell, methods: Iterable[Method] = Method) -> Iterator[Row]:
    return (shipped(cell, method, cell.repeats) for method in methods)


def _per_pose(cell: Cell, methods: Iterable[Method]) -> Iterator[Row]:
    """Measure the paper's averaging over arm poses (IV-B), where there are some."""
    for method in methods if len(cell.bench.rig.stances) > 1 else ():
        model = cell.bench.modules_on(cell.surface) if method is Method.MODULES else None

        def solve(contacts: Sequence[Contact], method: Method = method, model: ModuleModel | None = model) -> Positions:
            noise = cell.bench.scene.noise
            return positions_of(average_over_poses(contacts, cell.channels, method, noise, cell.surface, model=model))

        yield cell.measured(f"{method.value}-per-pose", solve, cell.repeats)


# ---- the free method beside its alternatives ----


def _free(cell: Cell) -> Iterator[Row]:
    """Measure the free method beside its alternatives, and both methods with each pose alone."""
    yield from _shipped(cell, [Method.FREE])
    for name, way in {"lstsq": alternatives.by_lstsq, "normal": alternatives.by_normal_equations}.items():

        def solve(contacts: Sequence[Contact], way: Callable[..., FloatArray] = way) -> Positions:
            system = alternatives.stacked(contacts, cell.channels)
            # Two contacts or more: one axis is a line and no position.
            pairs = zip(system.channels, way(system), np.diff(system.starts) > 3, strict=True)
            return {channel: p for channel, p, enough in pairs if enough and np.isfinite(p).all()}

        yield cell.measured(name, solve, max(1, cell.repeats // 2))
    yield from _per_pose(cell, PER_TAXEL)


# ---- the surface method beside other searches ----


def _surface(cell: Cell, all_ways: bool) -> Iterator[Row]:
    """Measure the surface method beside the other ways to search the surface."""
    row = shipped(cell, Method.SURFACE, 2 * cell.repeats)
    yield row
    searches = Searches(cell, row)
    for name, way in SEARCHES.items():
        yield searches.over_triangles(name, way)
    if all_ways:
        yield searches.each_triangle("slsqp", alternatives.by_slsqp)
    if all_ways and alternatives.has_quadprog():
        yield searches.each_triangle("quadprog", alternatives.by_quadprog)


class Searches:
    """The other ways to search the surface on one cell, from the contacts of the first seed; `row` is the shipped method's."""

    def __init__(self, cell: Cell, row: Row) -> None:
        self.cell, self.row = cell, row
        contacts, noise, method = cell.runs[0], cell.bench.scene.noise, Method.SURFACE
        seconds, begun = timed([lambda: alternatives.systems(contacts, cell.channels, noise)] * cell.repeats)
        # From contacts to the taxels' factors, which every alternative needs too.
        self.systems, self.front = begun[0], float(np.median(seconds))
        self.ours = estimate_taxels(contacts, cell.channels, [method], noise, cell.surface)[method]
        self.order: list[int] = np.random.default_rng(1).permutation(len(self.systems.channels)).tolist()

    def over_triangles(self, name: str, way: Callable[..., FloatArray]) -> Row:
        """Measure a way that goes through a taxel's triangles by itself."""
        found: Positions = {}

        def solve(taxel: int) -> None:
            found[self.systems.channels[taxel]] = way(self.cell.surface, *self._system(taxel))

        solve(self.order[0])
        pieces = [(partial(solve, taxel), 1) for taxel in self.order]
        return self._row(found, self.cell.sampled(name, self.row, pieces, (len(self.order), "taxels", self.front)))

    def each_triangle(self, name: str, solver: Callable[[Problems], FloatArray]) -> Row:
        """Measure the paper's way: each triangle a constrained least squares."""
        few = self.order[:SPREAD_OVER]
        total = round(float(np.mean([len(self._facing(taxel)) for taxel in few])) * len(self.order))

        def solve(taxel: int, triangles: IntArray) -> None:
            solver(self._problems(taxel, triangles))

        solve(few[0], self._facing(few[0])[:CHUNK])
        pieces = [(partial(solve, *piece), len(piece[1])) for piece in self._pieces(self.order if total <= WHOLE else few)]
        row = self.cell.sampled(name, self.row, pieces, (total, "triangles", self.front))
        return self._row({self.systems.channels[taxel]: self._winner(taxel, solver) for taxel in few}, row)

    def _row(self, found: Positions, row: Callable[..., Row]) -> Row:
        ours = {channel: point for channel, point in positions_of(self.ours).items() if channel in found}
        return row([found], [ours], [ours])

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
            facing = facing[np.isin(surface.triangles[facing], surface.triangles[triangle]).any(axis=1)]
        some = self._problems(taxel, facing)
        points = some.points(solver(some))
        root, offset, _ = self._system(taxel)
        return points[np.linalg.norm(points @ root.T - offset, axis=1).argmin()]


# ---- the modules method beside a general solver ----


def _modules(cell: Cell) -> Iterator[Row]:
    """Measure the modules method from contacts, with the surface method that it begins from; then what it is compared with."""
    row = shipped(cell, Method.MODULES, cell.repeats)
    yield row
    yield from _per_pose(cell, [Method.MODULES])
    model, noise = cell.bench.modules_on(cell.surface), cell.bench.scene.noise
    found = [Positions() for _ in cell.runs]
    fronts, starts = timed([partial(_begin, cell, contacts, model) for contacts in cell.runs])

    def solve(seed: int, module: int) -> None:
        begun = starts[seed][module]
        places = begun.by_least_squares(lambda pads: whitened(begun.touches, pads, noise).misses, **GENERAL)
        found[seed].update(zip(model.channels_of([module]), places, strict=True))

    # The seeds in turn: where the time does not suffice for all, each has its share.
    drawn = np.random.default_rng(3).permutation(model.modules_of(cell.channels)).tolist()
    pieces = [(partial(solve, seed, module), 1) for module in drawn for seed, start in enumerate(starts) if module in start]
    whole = (round(len(pieces) / len(starts)), "modules", float(np.mean(fronts)))
    general = cell.sampled("modules-general", row, pieces, whole, len(starts))

    def ours(doubting: bool) -> list[Positions]:
        solved = [
            estimate_taxels(contacts, sorted(own), [Method.MODULES], noise, cell.surface, {}, doubting, model)[Method.MODULES]
            for contacts, own in zip(cell.runs, found, strict=True)
        ]
        return [positions_of(estimates) for estimates in solved]

    # Near to ours, every poke counting fully; the errors beside ours as shipped.
    yield general(found, ours(doubting=False), ours(doubting=True))


def _begin(cell: Cell, contacts: Sequence[Contact], model: ModuleModel) -> dict[int, ModuleProblem]:
    """Solve by the surface method, and return pokes and start of each module that can be solved."""
    table, noise = ContactTable(contacts), cell.bench.scene.noise
    others = [estimate_from(table, cell.channels, [Method.SURFACE], noise, cell.surface)[Method.SURFACE]]
    starts = {module: start_of(model, module, others) for module in model.modules_of(cell.channels)}
    begun = [ModuleProblem(model, module, table, start, noise) for module, start in starts.items() if start is not None]
    return {problem.module: problem for problem in begun if len(problem.touches.of) > 1}


# ---- what the window waits for ----


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
    JSON: `time_ms` by the two methods of the paper, `with_modules_ms` by all that the scene has; with `p95`, what one poke in
    twenty takes longer than
    """
    ways = {"time_ms": PER_TAXEL, "with_modules_ms": None}
    seconds = {key: _poke_seconds(bench, per_taxel, pokes, methods) for key, methods in ways.items()}
    times = {key: {**ms_of(own), "p95": 1e3 * float(np.percentile(own, 95))} for key, own in seconds.items()}
    return {"pokes_per_taxel": per_taxel, "taxels_touched": TOUCHED, **times}


def _poke_seconds(bench: Bench, per_taxel: int, pokes: int, methods: Collection[Method] | None) -> list[float]:
    session = solved_session(bench, bench.contacts(per_taxel, seed=1), methods)
    others = bench.contacts(-(-2 * pokes // len(bench.channels)), seed=2)[: 2 * pokes]
    fresh = [replace(touching(bench, contact), poke=session.last_poke + 1 + i) for i, contact in enumerate(others)]
    return poke_seconds(session, fresh)[pokes:]


def touching(bench: Bench, contact: Contact) -> Contact:
    """Return the contact as if the seven taxels nearest to the strongest one's place had answered."""
    places = bench.rig.places
    strongest = bench.rig.row_of(contact.strongest_channel)
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
    works = {"time_ms": solve, "session_ms": lambda: solved_session(bench, contacts)}
    times = {name: ms_of(timed([work] * max(1, repeats))[0]) for name, work in works.items()}
    return {"contacts": len(contacts), **times}


def whole_time(bench: Bench, per_taxel: int, repeats: int) -> dict[str, Any]:
    """Time a warm solve of every taxel of a part: from a session's table, and by the modules method from contacts.

    Returns
    -------
    JSON: `time_ms` by the two methods of the paper, of the thread that ends last; `modules_ms`; `numpy_ms`, what numpy takes
    for the axes of 20,000 matrices (3, 3), in turn with them: the pace of the machine at that minute
    """
    contacts, noise, surface = bench.contacts(per_taxel, seed=1), bench.scene.noise, bench.surface
    table, model = ContactTable(contacts), bench.modules_on(surface)
    roots = np.random.default_rng(1).normal(size=(PACE, 3, 3))
    works: dict[str, Callable[[], object]] = {
        "time_ms": partial(estimate_from, table, bench.channels, PER_TAXEL, noise, surface),
        "modules_ms": partial(estimate_taxels, contacts, bench.channels, [Method.MODULES], noise, surface, model=model),
        "numpy_ms": partial(np.linalg.eigh, roots @ roots.swapaxes(1, 2)),
    }
    rounds = [timed(works.values())[0] for _ in range(1 + max(1, repeats))]
    of_works = zip(*rounds[1:], strict=True)
    return {"taxels": len(bench.channels), **{name: ms_of(seconds) for name, seconds in zip(works, of_works, strict=True)}}


def memory(bench: Bench, pokes: int) -> dict[str, Any]:
    """Measure the memory that pokes take: contacts with arrays of their own, estimates and a snapshot.

    It is the difference between a session of that many and one of a quarter of them, both after a warm-up: what is loaded once,
    and what a session keeps however many pokes it has, is no poke's.
    """
    contacts = bench.contacts(-(-pokes // len(bench.channels)), seed=4)[:pokes]
    few = contacts[: pokes // 4]
    solved_session(bench, few)
    before, after = _megabytes(bench, few), _megabytes(bench, contacts)
    counted = len(contacts) - len(few)
    return {"pokes": counted, "megabytes": after - before, "megabytes_per_1000": (after - before) / counted * 1000}


def _megabytes(bench: Bench, contacts: Sequence[Contact]) -> float:
    """Return what a session of contacts takes, 10^6 bytes."""
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        session = solved_session(bench, [copy.deepcopy(contact) for contact in contacts])
        taken = tracemalloc.get_traced_memory()[0] - before
        # It lives until it is counted.
        del session
        return taken / 1e6
    finally:
        tracemalloc.stop()


# ---- what the table says ----


def ratios_of(rows: Sequence[Row], part: str, per_taxel: int) -> dict[str, float]:
    """Return the ratios of median times on the whole large part's own mesh, and the growth with its triangles."""
    whole = [row for row in rows if (row["part"], row["pokes_per_taxel"]) == (part, per_taxel)]
    taxels = max(row["taxels"] for row in whole)
    # Its own mesh comes first.
    own = {row["method"]: row for row in reversed(whole) if row["taxels"] == taxels}
    ms = {name: row["time_ms"]["median"] for name, row in own.items()}
    sizes = [row for row in whole if (row["taxels"], row["method"]) == (taxels, "surface")]
    coarse = min(sizes, key=lambda row: abs(row["triangles"] - 1_000))["time_ms"]["median"]
    # A re-solve begins from what a session keeps of its contacts.
    again = own["surface"]["from_session_ms"]["median"]
    ratios = {f"{name}_over_surface": ms[name] / again for name in (*SEARCHES, "slsqp", "quadprog") if name in ms}
    ratios |= {f"{name}_over_free": ms[name] / ms["free"] for name in ("lstsq", "normal")}
    ratios["brute_over_surface_from_contacts"] = ms["brute"] / ms["surface"]
    ratios |= {"contacts_over_session": ms["surface"] / again, "modules_over_surface": ms["modules"] / ms["surface"]}
    return {**ratios, "per_taxel_100k_over_1k": ms["surface"] / coarse}


def waiting_ratios(lively: Mapping[str, Any]) -> dict[str, float]:
    """Return the ratios of what an operator waits for to what could not be done without."""
    poke, read, said, whole = lively["poke"][0], lively["import"], lively["help"], lively["whole"]
    pace = whole["numpy_ms"]["median"]
    return {
        "resolve_whole_over_numpy": whole["time_ms"]["median"] / pace,
        "modules_whole_over_numpy": whole["modules_ms"]["median"] / pace,
        "poke_modules_over_poke": poke["with_modules_ms"]["median"] / poke["time_ms"]["median"],
        "import_over_words": read["time_ms"] / read["words_ms"],
        "help_over_python": said["time_ms"]["median"] / said["python_ms"]["median"],
    }


def runtime_bars(ratios: Mapping[str, float], off: Mapping[str, float], lively: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return each bar: its value, on which side of its limit it must be, and whether it is."""
    return bars_of({
        # How many times faster than brute force, and than the paper's way, a whole re-solve is on the large part.
        "brute_over_surface": (ratios["brute_over_surface"], ">=", 300.0),
        "slsqp_over_surface": (ratios["slsqp_over_surface"], ">=", 10_000.0),
        # m. Every triangle tried one by one gives the same point.
        "brute_equal_m": (off["brute"], "<=", 1e-12),
        # How much a taxel may cost more on 100,000 triangles than on 1,000.
        "per_taxel_100k_over_1k": (ratios["per_taxel_100k_over_1k"], "<=", 2.0),
        "poke_ms": (lively["poke"][0]["time_ms"]["median"], "<=", 2.0),
        # The same by all three methods.
        "poke_modules_ms": (lively["poke"][0]["with_modules_ms"]["median"], "<=", 5.0),
        "poke_modules_over_poke": (ratios["poke_modules_over_poke"], "<=", 4.0),
        # On the whole large part, from contacts: over a re-solve from a session's tables, and over the surface method alone.
        "contacts_over_session": (ratios["contacts_over_session"], "<=", 6.0),
        "modules_over_surface": (ratios["modules_over_surface"], "<=", 5.0),
        # The whole large part: from a session's table by both methods of the paper, and from contacts by the modules method.
        # A machine's pace varies, so each also beside what numpy takes in the same minute: 70 ms and 0.9 s at 17 ms.
        "resolve_whole_ms": (lively["whole"]["time_ms"]["median"], "<=", 70.0),
        "resolve_whole_over_numpy": (ratios["resolve_whole_over_numpy"], "<=", 4.2),
        "modules_whole_s": (lively["whole"]["modules_ms"]["median"] / 1e3, "<=", 1.0),
        "modules_whole_over_numpy": (ratios["modules_whole_over_numpy"], "<=", 50.0),
        "import_over_words": (ratios["import_over_words"], "<=", 5.5),
        "help_s": (lively["help"]["time_ms"]["median"] / 1e3, "<=", 0.4),
        "resolve_s": (lively["resolve"]["time_ms"]["median"] / 1e3, "<=", 2.0),
        "memory_mb_per_1000": (lively["memory"]["megabytes_per_1000"], "<=", 2.0),
    })  # fmt: skip


def growth_of(rows: Sequence[Row], per_taxel: int) -> dict[str, list[dict[str, Any]]]:
    """Return what a taxel costs against triangles, taxels and pokes, the other two held as on the part's first row."""
    first = {row["part"]: {**row, "pokes_per_taxel": per_taxel} for row in reversed(rows)}
    growth: dict[str, list[dict[str, Any]]] = {name: [] for name in ("triangles", "taxels", "pokes_per_taxel")}
    for row in rows:
        cost = {key: row["time_ms"][key] * 1e3 / row["taxels"] for key in ("median", "q1", "q3")}
        for name, points in growth.items():
            if all(row[other] == first[row["part"]][other] for other in growth if other != name):
                points.append({"part": row["part"], "method": row["method"], name: row[name], "us_per_taxel": cost})
    return {name: sorted(points, key=lambda point: point[name]) for name, points in growth.items()}


def _in_words(row: Row) -> str:
    error = row["error_mm"]
    return (
        f"{row['part']}, {row['taxels']} taxels, {row['triangles']} triangles, {row['pokes_per_taxel']} pokes: "
        f"{row['label']}: {time_words(row['time_ms']['median'])}"
        + (" (extrapolated)" if row["extrapolated_from"] else "")
        + ("" if error is None else f", {error['median']:.2f} mm")
        + ("" if row["off_ours_m"] is None else f", at most {row['off_ours_m']:.1e} m from ours")
    )


def summary(result: dict[str, Any]) -> list[str]:
    """Return the two cells on which everything is measured, the bars, and what was left out."""
    lines: list[str] = []
    for size, rows in groupby(main_rows(result), key=lambda row: (row["part"], *_size(row))):
        lines.append("{}: {} taxels, {} triangles, {} pokes a taxel".format(*size))
        for row in rows:
            error = "" if row["error_mm"] is None else f"{row['error_mm']['median']:6.2f} mm"
            part = "  extrapolated" if row["extrapolated_from"] else ""
            lines.append(f"  {row['label']:52s}{time_words(row['time_ms']['median']):>10s} {error}{part}")
    lines += [
        f"a poke, {poke['pokes_per_taxel']} pokes a taxel{by}: one in twenty takes longer than {time_words(poke[key]['p95'])}"
        for poke in result["poke"]
        for key, by in (("time_ms", ""), ("with_modules_ms", ", all three methods"))
    ]
    return [*lines, *bar_lines(result["bars"], digits=4), AS_SHIPPED, *result["left_out"]]


def main_rows(result: dict[str, Any]) -> list[Row]:
    """Return the rows of the cells on which everything is measured: those of the lstsq rows' size, one a part."""
    sizes = {row["part"]: _size(row) for row in reversed(result["table"]) if row["method"] == "lstsq"}
    return [row for row in result["table"] if _size(row) == sizes.get(row["part"])]


def _size(row: Row) -> tuple[Any, ...]:
    return row["taxels"], row["triangles"], row["pokes_per_taxel"]


def draw(result: dict[str, Any], figure: Figure) -> None:
    """Draw error against run time on both parts, and what a taxel costs as the problem grows."""
    draw_runtime(result, main_rows(result), figure)
