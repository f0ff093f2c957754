"""Error against run time: the methods as shipped beside every honest alternative, in one run on one machine.

The table has a row for each method on each size of the problem: a forearm of 84 taxels and a torso of 4,200, on meshes of
300 to 100,000 triangles, with 1 to 100 pokes a taxel. Ratios are between times of the same run. The bars are those that
`docs/benchmarks.md` states.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from skincal.contacts.outcome import Contact
from skincal.mesh.search import build_tree
from skincal.mesh.surface import Surface, make_surface
from skincal.studies import alternatives, board_measures, live, measures
from skincal.studies.benches import Bench
from skincal.studies.clock import CLOCK, timed
from skincal.studies.measures import Cell, Row, Searches
from skincal.studies.runtime_results import bars_of, growth_of, ratios_of, summary, told
from skincal.taxels.result import PER_TAXEL, Method

if TYPE_CHECKING:
    from skincal.studies.figure import Figure

__all__ = ["draw", "run", "summary"]

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class PartSizes:
    """What is measured on one part, around a cell on which everything is: its own mesh, all its taxels."""

    scene: str
    seeds: int
    repeats: int
    meshes: tuple[int, ...]
    """Triangles, beside the mesh that ships."""
    pokes: tuple[int, ...]
    """Pokes a taxel, beside `Sizes.per_taxel`."""
    taxels: tuple[int, ...] = ()
    """Taxels, beside all."""
    budget_s: float = 5.0
    """s. How long each slow alternative runs where everything is measured; a fifth of it elsewhere."""


@dataclass(frozen=True, slots=True)
class Sizes:
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


SLOW_TO_POKE = 30
"""Pokes a taxel from which on one seed does: the simulation takes longer than all that is measured on it."""
FULL = Sizes()
QUICK = Sizes(
    small=PartSizes("icub-forearm", 2, 2, (1_000, 100_000), (1, 30), budget_s=0.3),
    large=PartSizes("whole-body", 1, 2, (1_000,), (), (84, 420), budget_s=0.8),
    everywhere=False,
    growth_until_s=20.0,
    live_pokes=60,
    live_per_taxel=(12,),
    memory_pokes=1_000,
)


def run(quick: bool, progress: Progress, sizes: Sizes | None = None) -> dict[str, Any]:
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
        progress(told(row))
    lively = _live(small, sizes, progress)
    ratios = ratios_of(rows, large.name, sizes.per_taxel)
    return {
        "study": "runtime",
        "quick": quick,
        "machine": _machine(),
        "table": rows,
        "growth": growth_of(rows, sizes.per_taxel),
        "agreement_m": off,
        **lively,
        "tree_build_ms": {bench.name: _tree_build_ms(bench.surface) for bench in (small, large)},
        "ratios": ratios,
        "bars": bars_of(ratios, off, lively),
        "left_out": left_out,
        "seconds": time.perf_counter() - began,
    }


def _table(benches: Sequence[tuple[Bench, PartSizes]], sizes: Sizes, progress: Progress, leave_out: Progress) -> Iterator[Row]:
    """Measure what the ratios need, then how cost grows, as far as there is time."""
    began = time.perf_counter()
    mains: list[Cell] = []
    for bench, part in benches:
        progress(f"poking {part.scene}: {len(bench.channels)} taxels, {sizes.per_taxel} pokes each")
        runs = [bench.contacts(sizes.per_taxel, seed) for seed in range(1, part.seeds + 1)]
        mains.append(Cell(bench, bench.surface, sizes.per_taxel, runs, bench.channels, part.repeats, part.budget_s))
        yield from _free(mains[-1])
        yield from _surface(mains[-1], True)
        yield from board_measures.modules(replace(mains[-1], repeats=max(1, part.repeats // 2)))
    pairs = list(zip(mains, (part for _, part in benches), strict=True))
    growth = (on_size for main, part in reversed(pairs) for on_size in _growth(main, part, sizes))
    for number, on_size in enumerate(growth):
        if number > 0 and time.perf_counter() - began > sizes.growth_until_s:
            leave_out("the machine is slow: some sizes of the problem are left out")
            return
        yield from on_size


def _growth(main: Cell, part: PartSizes, sizes: Sizes) -> Iterator[Iterator[Row]]:
    """Give the cells on which one size differs; the first of the large part is needed for the ratios."""
    short = replace(main, runs=main.runs[:1], repeats=max(1, part.repeats // 2), budget_s=part.budget_s / 5)
    for triangles in part.meshes:
        yield _on_mesh(replace(short, surface=main.bench.mesh(triangles)), sizes.everywhere)
    for taxels in part.taxels:
        channels = main.channels[:taxels]
        yield _shipped(replace(short, channels=channels, runs=[_answered(main.runs[0], channels)]))
    for per_taxel in part.pokes:
        seeds = part.seeds if per_taxel < SLOW_TO_POKE else 1
        yield _poked(short, per_taxel, seeds, sizes.everywhere)


def _poked(cell: Cell, per_taxel: int, seeds: int, everything: bool) -> Iterator[Row]:
    runs = [cell.bench.contacts(per_taxel, seed) for seed in range(1, seeds + 1)]
    cell = replace(cell, runs=runs, per_taxel=per_taxel)
    if not everything:
        yield from _shipped(cell)
        return
    yield measures.shipped(cell, Method.SURFACE)
    yield measures.shipped(cell, Method.MODULES)
    yield from _free(cell)


def _on_mesh(cell: Cell, everything: bool) -> Iterator[Row]:
    yield from _surface(cell, everything)
    if everything:
        yield measures.shipped(cell, Method.MODULES)


def _shipped(cell: Cell) -> Iterator[Row]:
    for method in Method:
        yield measures.shipped(cell, method)


def _answered(contacts: Sequence[Contact], channels: Sequence[int]) -> list[Contact]:
    """Return the contacts in which one of `channels` answered."""
    wanted = set(channels)
    return [contact for contact in contacts if not wanted.isdisjoint(contact.channels.tolist())]


def _free(cell: Cell) -> Iterator[Row]:
    """Measure the free method beside its alternatives, and both methods with each pose alone."""
    yield measures.shipped(cell, Method.FREE)
    yield from measures.free_alternatives(cell)
    if len(cell.bench.rig.stances) > 1:
        for method in PER_TAXEL:
            yield measures.per_pose(cell, method)


def _surface(cell: Cell, all_ways: bool) -> Iterator[Row]:
    """Measure the surface method beside the other ways to search the surface."""
    ours = measures.Shipped(cell, Method.SURFACE)
    searches = Searches.of(cell, ours.run())
    found = [searches.over_triangles("brute", alternatives.every_triangle)]
    ours.run()
    row = ours.row()
    yield row
    found.append(searches.over_triangles("facing", alternatives.facing_triangles))
    found.append(searches.over_triangles("compiled", alternatives.compiled_triangles))
    found.append(searches.over_triangles("bounded", alternatives.bounded_triangles))
    if all_ways:
        found.append(searches.each_triangle("slsqp", alternatives.by_slsqp))
    if all_ways and alternatives.has_quadprog():
        found.append(searches.each_triangle("quadprog", alternatives.by_quadprog))
    yield from (measures.beside(other, row) for other in found)


def _live(bench: Bench, sizes: Sizes, progress: Progress) -> dict[str, Any]:
    progress("pokes one by one, a whole session at once, memory")
    return {
        "poke": [live.poke_time(bench, per_taxel, sizes.live_pokes) for per_taxel in sizes.live_per_taxel],
        "resolve": live.resolve_time(bench, sizes.resolved, sizes.small.repeats // 2),
        "memory": live.memory(bench, sizes.memory_pokes),
    }


def _tree_build_ms(surface: Surface) -> float:
    fresh = make_surface(surface.vertices, surface.triangles)
    return 1e3 * timed(lambda: build_tree(fresh), 1)[0][0]


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


def draw(result: dict[str, Any], figure: Figure) -> None:
    """Draw error against run time on both parts, and what a taxel costs as the problem grows."""
    from skincal.studies.runtime_figure import draw_runtime

    draw_runtime(result, figure)
