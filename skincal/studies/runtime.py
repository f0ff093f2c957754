"""Error against run time of the shipped methods and of other solvers for the same equations, in one run on one machine.

A row for each method and problem size: a forearm of 84 taxels and a whole body of 4,200, meshes of 300 to 100,000 triangles,
1 to 100 pokes a taxel. Ratios are between times of the same run; `docs/benchmarks.md` states the limits. A slow method solves
random taxels or modules: its time is the median of one times their number, and its row says how many were solved.

The modules method is compared with scipy's Levenberg-Marquardt (MINPACK) with a differenced Jacobian, each module alone, from
the same start, with the method's own rows. It computes neither trust nor uncertainty, which favours it.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from itertools import chain, groupby, islice
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.following.session_guide import SessionGuide
from skincal.geometry import FloatArray
from skincal.mesh.surface import Surface
from skincal.methods import average_over_poses, estimate_from, estimate_taxels
from skincal.modules.pose import ModuleModel
from skincal.modules.pose_fit import find_starts, whitened_rows
from skincal.palette import BLACK, METHODS, ORANGE, PINK, SKY
from skincal.part.part import lay_part
from skincal.plotting import Axes, Figure, add_common_legend, label_twos_and_fives, set_log_scales
from skincal.session.session import Session
from skincal.simulation.example_parts import ExamplePart
from skincal.studies import baselines
from skincal.studies.baselines import ModuleProblem, TaxelProblem
from skincal.studies.benchmarking import CLOCK_NAME, quartiles, time_session_pokes, time_words, timed
from skincal.studies.harness import Bench, Findings, Limits, Row, Study
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import PER_TAXEL, Estimate, Method

WARMUP_TAXELS = 50
"""Contacts and taxels that are solved before the clock runs."""
LM_TOLERANCES = {"xtol": 1e-10, "ftol": 1e-12, "gtol": 1e-12}
"""Unknowns are metres: the last step is at most a hundredth of a micrometre of a pose some centimetres away."""
TAXELS_ANSWERING_A_POKE = 7
"""Largest reach of a tip of 4 mm between pads 5 mm apart."""
REFERENCE_EIGENVECTOR_MATRICES = 20_000
"""numpy finds the eigenvectors of these 3 x 3 matrices in about 17 ms, which measures the machine's current pace."""
ONE_SEED_FROM_POKES_PER_TAXEL = 30
"""Pokes a taxel from which on one seed suffices: the simulation takes longer than the measurement."""
AS_SHIPPED = (
    "As shipped: with uncertainty, trust and other places that fit, which the other methods do not give. Trust finds pokes "
    "that touched two places, and adds 1 to 2 % to the error where there are none."
)
LIVE_WARMUP_POKES, LIVE_TIMED_POKES = 10, 40
"""Pokes of a guided session before the clock runs, and pokes that are timed."""
LIVE_POKES = (100, 1_000, 10_000, 50_000)
"""Pokes of a guided session before one more is timed."""
SOLVE_ALL_TAXELS_MAX_MS = 125.0
"""ms of both threads: 105 to 111 were measured. The limit for one thread was 70 ms, its time 59 to 64."""
NUMPY_TIME_MS = 16.7
"""Time of numpy's part of the comparison on the machine where these limits were set."""
Say: TypeAlias = Callable[[str], None]
Positions: TypeAlias = Mapping[int, FloatArray]


class MethodLook(NamedTuple):
    """Mark and colour of a method in the figure, and its name in figure and tables."""

    mark: str
    colour: str
    label: str


METHOD_LOOKS: Mapping[str, MethodLook] = {
    "surface": MethodLook("*", METHODS["surface"], "surface, as shipped"),
    "free": MethodLook("*", METHODS["free"], "free, as shipped"),
    "brute": MethodLook("s", ORANGE, "surface: every triangle, closed form"),
    "compiled": MethodLook("X", ORANGE, "surface: every pushed triangle, compiled"),
    "quadprog": MethodLook("o", PINK, "surface: each triangle by quadprog (paper)"),
    "slsqp": MethodLook("o", BLACK, "surface: each triangle by SLSQP (paper)"),
    "modules": MethodLook("*", METHODS["modules"], "modules, as shipped"),
    "modules-general": MethodLook("d", METHODS["modules"], "modules: scipy's Levenberg-Marquardt"),
    "modules-per-pose": MethodLook("^", METHODS["modules"], "modules: each pose alone, averaged"),
    "surface-per-pose": MethodLook("^", METHODS["surface"], "surface: each pose alone, averaged"),
    "free-per-pose": MethodLook("^", METHODS["free"], "free: each pose alone, averaged"),
    "lstsq": MethodLook("v", SKY, "free: numpy's lstsq for each taxel"),
    "normal": MethodLook("P", SKY, "free: normal equations"),
}
"""By the method's name in JSON."""
SURFACE_SEARCHES: Mapping[str, Callable[[Surface, TaxelProblem], FloatArray]] = {
    "brute": baselines.by_every_triangle,
    "compiled": baselines.by_compiled_triangles,
    "slsqp": partial(baselines.by_quadratic_programmes, baselines.by_slsqp),
    "quadprog": partial(baselines.by_quadratic_programmes, baselines.by_quadprog),
}
"""Other ways to search the surface for one taxel."""
SLOW_SEARCHES = ("slsqp", "quadprog")
"""Slow ones, measured on the parts' own meshes and few others."""


@dataclass(frozen=True, slots=True)
class PartPlan:
    """Sizes to measure on one part, in addition to its own mesh with all its taxels."""

    scene: str
    seeds: int
    repeats: int
    meshes: tuple[int, ...]
    """Triangles."""
    pokes: tuple[int, ...]
    """Pokes a taxel."""
    taxels: tuple[int, ...] = ()
    budget_s: float = 5.0
    """For each slow method on the part's own mesh; a fifth of it elsewhere."""


@dataclass(frozen=True, slots=True)
class RuntimeSizes:
    """Sizes of the study."""

    small: PartPlan = PartPlan("icub-forearm", 5, 5, (300, 1_000, 3_000, 30_000, 100_000), (1, 3, 30, 100))
    large: PartPlan = PartPlan("whole-body", 3, 3, (300, 1_000, 10_000, 30_000), (1, 3, 36), (84, 420, 1_260))
    """The ratios are of this one."""
    per_taxel: int = 12
    """Pokes a taxel where meshes or taxels differ."""
    everywhere: bool = True
    """Whether all methods run on all sizes."""
    growth_until_s: float = float("inf")
    """No further size begins after this time."""
    live_pokes: int = 200
    live_per_taxel: tuple[int, ...] = (12, 100)
    session_pokes: tuple[tuple[int, ...], tuple[int, ...]] = (LIVE_POKES, LIVE_POKES)
    """Pokes of a session before one more is timed, on the small and on the large part."""


FULL_SIZES = RuntimeSizes()
QUICK_SIZES = RuntimeSizes(
    small=PartPlan("icub-forearm", 2, 2, (1_000, 100_000), (1, 30), budget_s=0.3),
    large=PartPlan("whole-body", 1, 2, (1_000,), (), (84, 420), budget_s=0.8),
    everywhere=False, growth_until_s=20.0, live_pokes=60, live_per_taxel=(12,), session_pokes=((100,), (100, 1_000)),
)  # fmt: skip


def measure(bench: Bench, sizes: RuntimeSizes) -> Findings:
    """Measure everything. `docs/benchmarks.md` describes the JSON."""
    began = time.perf_counter()
    small, large = ExamplePart(sizes.small.scene), ExamplePart(sizes.large.scene)
    left_out: list[str] = []

    def leave_out(sentence: str) -> None:
        left_out.append(sentence)
        bench.say(sentence)

    if not baselines.has_quadprog():
        leave_out("quadprog is not installed; left out")
    rows: list[Row] = []
    for row in _table([(small, sizes.small), (large, sizes.large)], sizes, bench.say, leave_out):
        rows.append(row)
        bench.say(_row_text(row))
    bench.say("single pokes, and a whole session at once")
    latency = {
        "poke": [poke_time(small, per_taxel, sizes.live_pokes) for per_taxel in sizes.live_per_taxel],
        "whole": whole_time(large, sizes.per_taxel, sizes.large.repeats),
        "live": [
            row for part, pokes in zip((small, large), sizes.session_pokes, strict=True) for row in live_times(part, pokes)
        ],
    }
    agreement: dict[str, float] = {}
    for row in rows:
        if row["off_ours_m"] is not None:
            agreement[row["method"]] = max(agreement.get(row["method"], 0.0), row["off_ours_m"])
    ratios = time_ratios(rows, latency, large.name, sizes.per_taxel)
    numbers = {
        "machine": _machine(), "table": rows, "growth": growth_of(rows, sizes.per_taxel), "agreement_m": agreement, **latency,
        "ratios": ratios, "left_out": left_out, "seconds": time.perf_counter() - began,
    }  # fmt: skip
    return Findings(numbers, runtime_limits(ratios, agreement, latency))


def _machine() -> dict[str, Any]:
    packages = ("numpy", "scipy", *(("quadprog",) if baselines.has_quadprog() else ()))
    return {
        "platform": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
        "cpus": os.cpu_count(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "clock": CLOCK_NAME,
    }


# ---- sizes ----


@dataclass(frozen=True, eq=False)
class ProblemSize:
    """A part with its mesh and contacts."""

    bench: ExamplePart
    surface: Surface
    per_taxel: int
    runs: Sequence[Sequence[Contact]]
    """Contacts of each seed."""
    channels: Sequence[int]
    repeats: int
    """Runs of a fast method on each seed's contacts."""
    budget_s: float
    """For each slow method."""


def _table(
    benches: Sequence[tuple[ExamplePart, PartPlan]], sizes: RuntimeSizes, progress: Say, leave_out: Say
) -> Iterator[Row]:
    """Measure the sizes of the ratios, then the growth of cost, until the time is used."""
    began = time.perf_counter()
    growths: list[Iterator[Iterator[Row]]] = []
    for bench, part in benches:
        progress(f"poking {part.scene}: {len(bench.channels)} taxels, {sizes.per_taxel} pokes each")
        runs = [bench.contacts(sizes.per_taxel, seed) for seed in range(1, part.seeds + 1)]
        main = ProblemSize(bench, bench.surface, sizes.per_taxel, runs, bench.channels, part.repeats, part.budget_s)
        yield from _free_rows(main)
        yield from _surface_rows(main, quadratic=True)
        yield from _module_rows(replace(main, repeats=max(1, part.repeats // 2)))
        growths.insert(0, _growth_rows(main, part, sizes))
    for number, rows in enumerate(chain(*growths)):
        if number > 0 and time.perf_counter() - began > sizes.growth_until_s:
            leave_out("the machine is slow: some sizes of the problem are left out")
            return
        yield from rows


def _growth_rows(main: ProblemSize, part: PartPlan, sizes: RuntimeSizes) -> Iterator[Iterator[Row]]:
    """Yield the rows of each size in turn. The first size of the large part is needed for the ratios."""
    short = replace(main, runs=main.runs[:1], repeats=max(1, part.repeats // 2), budget_s=part.budget_s / 5)
    for triangles in part.meshes:
        size = replace(short, surface=main.bench.mesh(triangles))
        yield chain(_surface_rows(size, sizes.everywhere), _shipped_rows(size, [Method.MODULES] if sizes.everywhere else []))
    for taxels in part.taxels:
        channels = main.channels[:taxels]
        answered = [contact for contact in main.runs[0] if not set(channels).isdisjoint(contact.channels.tolist())]
        yield _shipped_rows(replace(short, channels=channels, runs=[answered]))
    for per_taxel in part.pokes:
        seeds = part.seeds if per_taxel < ONE_SEED_FROM_POKES_PER_TAXEL else 1
        runs = [main.bench.contacts(per_taxel, seed) for seed in range(1, seeds + 1)]
        size = replace(short, runs=runs, per_taxel=per_taxel)
        shipped = [Method.SURFACE, Method.MODULES] if sizes.everywhere else list(Method)
        yield chain(_shipped_rows(size, shipped), _free_rows(size) if sizes.everywhere else ())


# ---- rows ----


def _row(size: ProblemSize, method: str, seconds: Sequence[float], found: Sequence[Positions], **more: Any) -> Row:
    """Make a row from times of whole solves and the positions of each seed."""
    means = [1e3 * float(np.mean(errors)) for errors in map(size.bench.errors, map(dict, found)) if len(errors)]
    return {
        "part": size.bench.name, "taxels": len(size.channels), "triangles": len(size.surface.triangles),
        "pokes_per_taxel": size.per_taxel, "contacts": len(size.runs[0]), "method": method, "label": METHOD_LOOKS[method].label,
        "time_ms": quartiles_ms(seconds), "error_mm": quartiles(means) if means else None,
        "error_of_taxels": len(found[0]) if found else 0, "from_session_ms": None, "off_ours_m": None,
        "error_beside_ours_mm": None, "extrapolated_from": None, **more,
    }  # fmt: skip


def quartiles_ms(seconds: Sequence[float]) -> dict[str, Any]:
    """Summarise times, ms."""
    return quartiles([1e3 * second for second in seconds])


def _whole_row(
    size: ProblemSize, method: str, solve: Callable[[Sequence[Contact]], Positions], repeats: int, **more: Any
) -> Row:
    """Measure a method that is fast enough for all taxels, `repeats` times on each seed's contacts."""
    both = [timed([partial(solve, contacts)] * repeats) for contacts in size.runs]
    return _row(size, method, [s for seconds, _ in both for s in seconds], [found[-1] for _, found in both], **more)


Piece: TypeAlias = tuple[int, Callable[[], Positions]]
"""Index of a seed, and the solve of one of its taxels or modules."""


@dataclass(frozen=True, slots=True, eq=False)
class ShippedAnswer:
    """Answer of a method of the program, to compare those of slow methods with."""

    row: Row
    positions: Sequence[Positions]
    """Of each seed, for errors."""
    near: Sequence[Positions]
    """Of each seed, every poke counting fully, for positions."""

    def compare(self, bench: ExamplePart, found: Sequence[Positions]) -> Row:
        """Compare the positions that another method found of each seed; return entries of its row."""
        apart: list[float] = []
        differences: list[float] = []
        for theirs, close, ours in zip(found, self.near, self.positions, strict=True):
            apart += [float(np.linalg.norm(theirs[channel] - close[channel])) for channel in close if channel in theirs]
            both = [
                bench.errors({channel: each[channel] for channel in theirs.keys() & ours.keys()}) for each in (theirs, ours)
            ]
            differences += [1e3 * float(both[0].mean() - both[1].mean())] if len(both[0]) else []
        entries: Row = {"off_ours_m": max(apart, default=None)}
        # A sample is too small for an error of its own: the row's error is ours plus the difference on the same taxels.
        error = self.row["error_mm"]
        if differences and error is not None:
            entries["error_beside_ours_mm"] = more = float(np.mean(differences))
            entries["error_mm"] = error | {key: error[key] + more for key in ("median", "q1", "q3")}
        return entries


def _sampled_row(
    size: ProblemSize, method: str, pieces: Sequence[Piece], unit: str, setup_s: float, ours: ShippedAnswer
) -> Row:
    """Measure a slow method on pieces until the budget is used, at least on one.

    Parameters
    ----------
    pieces : all `unit` of all seeds, in random order
    setup_s : s before the first piece
    """
    seconds, solved = timed([piece for _, piece in pieces], size.budget_s)
    found: list[dict[int, FloatArray]] = [{} for _ in size.runs]
    for (seed, _), positions in zip(pieces, solved, strict=False):
        found[seed].update(positions)
    whole = [second * len(pieces) / len(size.runs) + setup_s for second in seconds]
    row = _row(size, method, whole, found)
    if len(seconds) < len(pieces):
        row["extrapolated_from"] = {unit: len(seconds), f"of_{unit}": len(pieces), "seconds": float(np.sum(seconds))}
    return row | ours.compare(size.bench, found)


def known_positions(estimates: Mapping[int, Estimate]) -> dict[int, FloatArray]:
    """Select the positions of the taxels that have one."""
    return {channel: found.position for channel, found in estimates.items() if found.position is not None}


# ---- methods ----


def shipped_row(size: ProblemSize, method: Method, repeats: int) -> Row:
    """Measure a method of the program, from contacts to estimates with their uncertainty."""
    model, noise, more = size.bench.modules_on(size.surface) if method is Method.MODULES else None, size.bench.scene.noise, {}

    def solve(contacts: Sequence[Contact], channels: Sequence[int] = size.channels) -> Positions:
        return known_positions(estimate_taxels(contacts, channels, [method], noise, size.surface, model=model)[method])

    # Builds the surface's search tree, once for all solves.
    solve(size.runs[0][:WARMUP_TAXELS], size.channels[:WARMUP_TAXELS])
    if method is Method.SURFACE:
        # The same from the table that a session keeps of its contacts.
        again = partial(estimate_from, ContactTable(size.runs[0]), size.channels, [method], noise, size.surface)
        more["from_session_ms"] = quartiles_ms(timed([again] * size.repeats)[0])
    return _whole_row(size, method.value, solve, repeats, **more)


def _shipped_rows(size: ProblemSize, methods: Iterable[Method] = Method) -> Iterator[Row]:
    return (shipped_row(size, method, size.repeats) for method in methods)


def _per_pose_rows(size: ProblemSize, methods: Iterable[Method]) -> Iterator[Row]:
    """Measure the paper's averaging over arm poses (IV-B) on a part that has several."""
    for method in methods if len(size.bench.rig.arm_poses) > 1 else ():
        model = size.bench.modules_on(size.surface) if method is Method.MODULES else None

        def solve(contacts: Sequence[Contact], method: Method = method, model: ModuleModel | None = model) -> Positions:
            noise = size.bench.scene.noise
            return known_positions(average_over_poses(contacts, size.channels, method, noise, size.surface, model=model))

        yield _whole_row(size, f"{method.value}-per-pose", solve, size.repeats)


def _free_rows(size: ProblemSize) -> Iterator[Row]:
    yield from _shipped_rows(size, [Method.FREE])
    for name, solver in {"lstsq": baselines.by_lstsq, "normal": baselines.by_normal_equations}.items():

        def solve(contacts: Sequence[Contact], solver: Callable[..., FloatArray] = solver) -> Positions:
            system = baselines.stack_rows(contacts, size.channels)
            # One contact gives a line and no position.
            pairs = zip(system.channels, solver(system), np.diff(system.starts) > 3, strict=True)
            return {channel: p for channel, p, enough in pairs if enough and np.isfinite(p).all()}

        yield _whole_row(size, name, solve, max(1, size.repeats // 2))
    yield from _per_pose_rows(size, PER_TAXEL)


def _surface_rows(size: ProblemSize, quadratic: bool) -> Iterator[Row]:
    """Measure the surface method and its baselines, with `quadratic` also the slow ones."""
    ours = shipped_row(size, Method.SURFACE, 2 * size.repeats)
    yield ours
    contacts, noise = size.runs[0], size.bench.scene.noise
    seconds, (problems, *_) = timed([partial(baselines.taxel_problems, contacts, size.channels, noise)] * size.repeats)
    estimates = estimate_taxels(contacts, size.channels, [Method.SURFACE], noise, size.surface)[Method.SURFACE]
    known = known_positions(estimates)
    answer = ShippedAnswer(ours, [known], [known])
    drawn: list[int] = np.random.default_rng(1).permutation(list(problems)).tolist()
    for name, search in SURFACE_SEARCHES.items():
        if (name in SLOW_SEARCHES and not quadratic) or (name == "quadprog" and not baselines.has_quadprog()):
            continue

        def solve(channel: int, search: Callable[[Surface, TaxelProblem], FloatArray] = search) -> Positions:
            point = search(size.surface, problems[channel])
            return {channel: point} if np.isfinite(point).all() else {}

        pieces = [(0, partial(solve, channel)) for channel in drawn]
        if name not in SLOW_SEARCHES:
            solve(drawn[0])
        one = replace(size, runs=size.runs[:1])
        yield _sampled_row(one, name, pieces, "taxels", float(np.median(seconds)), answer)


def _module_rows(size: ProblemSize) -> Iterator[Row]:
    """Measure the modules method, with the surface method that it starts from, and a general solver."""
    ours = shipped_row(size, Method.MODULES, size.repeats)
    yield ours
    yield from _per_pose_rows(size, [Method.MODULES])
    model, noise = size.bench.modules_on(size.surface), size.bench.scene.noise
    setups, starts = timed([partial(_module_problems, size, contacts, model) for contacts in size.runs])

    def solve(seed: int, module: int) -> Positions:
        problem = starts[seed][module]
        places = problem.by_least_squares(lambda pads: whitened_rows(problem.touches, pads, noise).misses, **LM_TOLERANCES)
        return dict(zip(model.channels_of([module]), places, strict=True))

    def solve_by_modules(doubting: bool) -> list[Positions]:
        every = (
            estimate_taxels(contacts, size.channels, [Method.MODULES], noise, size.surface, {}, doubting, model)
            for contacts in size.runs
        )
        return [known_positions(estimates[Method.MODULES]) for estimates in every]

    # The seeds in turn: where the time does not suffice for all, each has its share.
    drawn = np.random.default_rng(3).permutation(model.modules_of(size.channels)).tolist()
    pieces = [(seed, partial(solve, seed, module)) for module in drawn for seed, own in enumerate(starts) if module in own]
    # Places are compared with every poke counting fully, as for the general solver; errors with the method as shipped.
    answer = ShippedAnswer(ours, positions=solve_by_modules(doubting=True), near=solve_by_modules(doubting=False))
    yield _sampled_row(size, "modules-general", pieces, "modules", float(np.mean(setups)), answer)


def _module_problems(size: ProblemSize, contacts: Sequence[Contact], model: ModuleModel) -> dict[int, ModuleProblem]:
    table, noise = ContactTable(contacts), size.bench.scene.noise
    others = [estimate_from(table, size.channels, [Method.SURFACE], noise, size.surface)[Method.SURFACE]]
    starts = find_starts(model, model.modules_of(size.channels), others)
    problems = [ModuleProblem(model, module, table, start, noise) for module, start in starts.items()]
    return {problem.module: problem for problem in problems if len(problem.touches.of) > 1}


# ---- latency ----


def solved_session(bench: ExamplePart, contacts: Sequence[Contact], methods: Collection[Method] | None = None) -> Session:
    """Make a session with these contacts, solved by `methods`; `None` for every method of its scene."""
    session = Session(bench.scene, bench.surface, methods)
    for contact in contacts:
        session.add(contact)
    session.snapshot()
    return session


def poke_time(bench: ExamplePart, per_taxel: int, pokes: int) -> dict[str, Any]:
    """Time a poke of seven taxels: added, solved, in a snapshot. Before it, each taxel has `per_taxel` pokes.

    Returns
    -------
    JSON: `time_ms` by the two methods of the paper, `with_modules_ms` by all methods of the scene; `p95` is the 95 % quantile
    """
    methods: dict[str, Collection[Method] | None] = {"time_ms": PER_TAXEL, "with_modules_ms": None}
    times: dict[str, Any] = {}
    for key, solved_by in methods.items():
        session = solved_session(bench, bench.contacts(per_taxel, seed=1), solved_by)
        others = bench.contacts(-(-2 * pokes // len(bench.channels)), seed=2)[: 2 * pokes]
        fresh = [replace(with_neighbours(bench, contact), poke=session.last_poke + 1 + i) for i, contact in enumerate(others)]
        seconds = time_session_pokes(session, fresh)[pokes:]
        times[key] = {**quartiles_ms(seconds), "p95": 1e3 * float(np.percentile(seconds, 95))}
    return {"pokes_per_taxel": per_taxel, "taxels_touched": TAXELS_ANSWERING_A_POKE, **times}


def with_neighbours(bench: ExamplePart, contact: Contact) -> Contact:
    """Return the contact with answers of the seven taxels nearest to its strongest one."""
    places = bench.rig.places
    strongest = bench.rig.row_of(contact.strongest_channel)
    rows = np.argsort(np.linalg.norm(places - places[strongest], axis=1))[:TAXELS_ANSWERING_A_POKE]
    order = np.argsort(bench.rig.channels[rows])
    responses = np.linspace(1.0, 0.2, TAXELS_ANSWERING_A_POKE) * float(contact.responses.max())
    return replace(contact, channels=bench.rig.channels[rows][order], responses=responses[order])


def live_times(bench: ExamplePart, sizes: Sequence[int]) -> Iterator[Row]:
    """Time one more poke of a guided session: added, solved by all methods, in a snapshot, and the guide's next target.

    `sizes` are the pokes before it, ascending.
    """
    session, guide = Session(bench.scene, bench.surface), SessionGuide(lay_part(bench.scene, bench.surface, ()))
    # Each size needs its warm-up, and the pokes that are timed.
    count = sizes[-1] + LIVE_WARMUP_POKES + LIVE_TIMED_POKES
    every = bench.contacts(-(-count // len(bench.channels)) + 1, seed=3)
    order = np.random.default_rng(0).permutation(len(every))
    indices: list[int] = order.tolist()
    waiting = (replace(every[index], poke=number) for number, index in enumerate(indices, start=1))
    for size in sizes:
        for contact in islice(waiting, size - session.last_poke):
            session.add(contact)
        seconds: dict[str, list[float]] = {"snapshot_ms": [], "guide_ms": []}
        for contact in islice(waiting, LIVE_WARMUP_POKES + LIVE_TIMED_POKES):
            seconds["snapshot_ms"] += time_session_pokes(session, [contact])
            look = partial(guide.next_target, session.snapshot(), (contact.pose, contact.link_from_sensor), Method.MODULES, 0.0)
            seconds["guide_ms"] += timed([look])[0]
        times = {key: quartiles_ms(each[LIVE_WARMUP_POKES:]) for key, each in seconds.items()}
        yield {"part": bench.name, "taxels": len(bench.channels), "pokes": size, **times}


def whole_time(bench: ExamplePart, per_taxel: int, repeats: int) -> dict[str, Any]:
    """Time a warm solve of all taxels.

    Returns
    -------
    JSON: `time_ms` by the two methods of the paper from a session's table; `modules_ms` from contacts; `numpy_ms` of
    eigenvectors of `REFERENCE_EIGENVECTOR_MATRICES`
    """
    contacts, noise, surface = bench.contacts(per_taxel, seed=1), bench.scene.noise, bench.surface
    table, model = ContactTable(contacts), bench.modules_on(surface)
    roots = np.random.default_rng(1).normal(size=(REFERENCE_EIGENVECTOR_MATRICES, 3, 3))
    works: dict[str, Callable[[], object]] = {
        "time_ms": partial(estimate_from, table, bench.channels, PER_TAXEL, noise, surface),
        "modules_ms": partial(estimate_taxels, contacts, bench.channels, [Method.MODULES], noise, surface, model=model),
        "numpy_ms": partial(np.linalg.eigh, roots @ roots.swapaxes(1, 2)),
    }
    rounds = [timed(works.values())[0] for _ in range(1 + max(1, repeats))]
    of_works = zip(*rounds[1:], strict=True)
    return {"taxels": len(bench.channels), **{name: quartiles_ms(own) for name, own in zip(works, of_works, strict=True)}}


# ---- ratios and limits ----


def time_ratios(rows: Sequence[Row], latency: Mapping[str, Any], part: str, per_taxel: int) -> dict[str, float]:
    """Compare median times on the whole large part's own mesh, and the growth with its triangles."""
    whole = [row for row in rows if (row["part"], row["pokes_per_taxel"]) == (part, per_taxel)]
    taxels = max(row["taxels"] for row in whole)
    # Its own mesh comes first.
    own = {row["method"]: row for row in reversed(whole) if row["taxels"] == taxels}
    ms = {name: row["time_ms"]["median"] for name, row in own.items()}
    sizes = [row for row in whole if (row["taxels"], row["method"]) == (taxels, "surface")]
    coarse = min(sizes, key=lambda row: abs(row["triangles"] - 1_000))["time_ms"]["median"]
    # A session solves again from the table that it keeps of its contacts.
    again = own["surface"]["from_session_ms"]["median"]
    poke, all_taxels = latency["poke"][0], latency["whole"]
    pace = all_taxels["numpy_ms"]["median"]
    return {
        **{f"{name}_over_surface": ms[name] / again for name in SURFACE_SEARCHES if name in ms},
        **{f"{name}_over_free": ms[name] / ms["free"] for name in ("lstsq", "normal")},
        "contacts_over_session": ms["surface"] / again,
        "modules_over_surface": ms["modules"] / ms["surface"],
        "per_taxel_100k_over_1k": ms["surface"] / coarse,
        "resolve_whole_over_numpy": all_taxels["time_ms"]["median"] / pace,
        "modules_whole_over_numpy": all_taxels["modules_ms"]["median"] / pace,
        "poke_modules_over_poke": poke["with_modules_ms"]["median"] / poke["time_ms"]["median"],
    }


def runtime_limits(ratios: Mapping[str, float], off: Mapping[str, float], latency: Mapping[str, Any]) -> Limits:
    """List each limit of `docs/benchmarks.md`."""
    poke, whole = latency["poke"][0], latency["whole"]
    return {
        # A whole re-solve on the large part, over brute force and the paper's solvers.
        "brute_over_surface": (ratios["brute_over_surface"], ">=", 300.0),
        "slsqp_over_surface": (ratios["slsqp_over_surface"], ">=", 10_000.0),
        # m. Every triangle tried gives the same point.
        "brute_equal_m": (off["brute"], "<=", 1e-12),
        # A taxel on 100,000 triangles over one on 1,000.
        "per_taxel_100k_over_1k": (ratios["per_taxel_100k_over_1k"], "<=", 2.0),
        "poke_ms": (poke["time_ms"]["median"], "<=", 2.0),
        # The same by all three methods.
        "poke_modules_ms": (poke["with_modules_ms"]["median"], "<=", 5.0),
        "poke_modules_over_poke": (ratios["poke_modules_over_poke"], "<=", 4.0),
        # On the whole large part, from contacts: over a re-solve from a session's tables, and over the surface method alone.
        "contacts_over_session": (ratios["contacts_over_session"], "<=", 6.0),
        "modules_over_surface": (ratios["modules_over_surface"], "<=", 5.0),
        # The whole large part, the work of both threads. A machine's pace varies: each also over numpy's time in that minute.
        "resolve_whole_ms": (whole["time_ms"]["median"], "<=", SOLVE_ALL_TAXELS_MAX_MS),
        "resolve_whole_over_numpy": (ratios["resolve_whole_over_numpy"], "<=", SOLVE_ALL_TAXELS_MAX_MS / NUMPY_TIME_MS),
        "modules_whole_s": (whole["modules_ms"]["median"] / 1e3, "<=", 1.0),
        "modules_whole_over_numpy": (ratios["modules_whole_over_numpy"], "<=", 50.0),
    }  # fmt: skip


def growth_of(rows: Sequence[Row], per_taxel: int) -> dict[str, list[dict[str, Any]]]:
    """List the cost of a taxel against triangles, taxels and pokes, the other two held as on the part's first row."""
    first = {row["part"]: {**row, "pokes_per_taxel": per_taxel} for row in reversed(rows)}
    growth: dict[str, list[dict[str, Any]]] = {name: [] for name in GROWTH_AXES}
    for row in rows:
        cost = {key: row["time_ms"][key] * 1e3 / row["taxels"] for key in ("median", "q1", "q3")}
        for name, points in growth.items():
            if all(row[other] == first[row["part"]][other] for other in growth if other != name):
                points.append({"part": row["part"], "method": row["method"], name: row[name], "us_per_taxel": cost})
    return {name: sorted(points, key=lambda point: point[name]) for name, points in growth.items()}


# ---- text and figure ----


def _row_text(row: Row) -> str:
    error = row["error_mm"]
    return (
        f"{row['part']}, {row['taxels']} taxels, {row['triangles']} triangles, {row['pokes_per_taxel']} pokes: "
        f"{row['label']}: {time_words(row['time_ms']['median'])}"
        + (" (extrapolated)" if row["extrapolated_from"] else "")
        + ("" if error is None else f", {error['median']:.2f} mm")
        + ("" if row["off_ours_m"] is None else f", at most {row['off_ours_m']:.1e} m from ours")
    )


def describe(result: Mapping[str, Any]) -> list[str]:
    """List the measured times of the largest problem of each part, and what was not measured."""
    lines: list[str] = []
    for size, rows in groupby(main_rows(result), key=lambda row: (row["part"], *_size(row))):
        lines.append("{}: {} taxels, {} triangles, {} pokes a taxel".format(*size))
        for row in rows:
            error = "" if row["error_mm"] is None else f"{row['error_mm']['median']:6.2f} mm"
            sampled = "  extrapolated" if row["extrapolated_from"] else ""
            lines.append(f"  {row['label']:52s}{time_words(row['time_ms']['median']):>10s} {error}{sampled}")
    lines += [
        f"a poke, {poke['pokes_per_taxel']} pokes a taxel{by}: one in twenty takes longer than {time_words(poke[key]['p95'])}"
        for poke in result["poke"]
        for key, by in (("time_ms", ""), ("with_modules_ms", ", all three methods"))
    ]
    lines += [
        "{part}, after {pokes:,} pokes: one more takes {snapshot} for the snapshot and {guide} for the guide".format(
            snapshot=time_words(row["snapshot_ms"]["median"]), guide=time_words(row["guide_ms"]["median"]), **row
        )
        for row in result["live"]
    ]
    return [*lines, AS_SHIPPED, *result["left_out"]]


def main_rows(result: Mapping[str, Any]) -> list[Row]:
    """Select the rows of the sizes on which everything is measured: those of the lstsq rows, one size a part."""
    sizes = {row["part"]: _size(row) for row in reversed(result["table"]) if row["method"] == "lstsq"}
    return [row for row in result["table"] if _size(row) == sizes.get(row["part"])]


def _size(row: Row) -> tuple[Any, ...]:
    return row["taxels"], row["triangles"], row["pokes_per_taxel"]


PART_LABELS = {"icub-forearm": "forearm", "whole-body": "whole body"}
GROWTH_AXES = {"triangles": "triangles of the mesh", "taxels": "taxels", "pokes_per_taxel": "pokes per taxel"}
ROUND_TIMES_S = {
    1e-3: "1 ms", 1e-2: "10 ms", 0.1: "100 ms", 1.0: "1 s", 10.0: "10 s", 60.0: "1 min", 600.0: "10 min", 3_600.0: "1 h",
    36_000.0: "10 h",
}  # fmt: skip
"""Ticks of an axis from milliseconds to hours."""
FIGURE_KEY = (
    "Stars: as shipped. Hollow: extrapolated from a sample. Bars: quartiles. Lower row: forearm dashed, whole body solid."
)


def draw(result: Mapping[str, Any], figure: Figure) -> None:
    """Draw error against run time on both parts, the cost of a taxel as the problem grows, and the live cost of a poke."""
    figure.set_size_inches(14.0, 12.0)
    figure.suptitle(f"Error against run time: lower is more exact, further left is faster\n{FIGURE_KEY}")
    above, below = figure.subfigures(2, 1, height_ratios=[1.3, 1.0])
    rows = main_rows(result)
    parts = list(dict.fromkeys(row["part"] for row in rows))[:2]
    for part, axes in zip(parts, above.subplots(1, len(parts), squeeze=False)[0], strict=True):
        _draw_errors(axes, [row for row in rows if row["part"] == part and row["error_mm"] is not None])
    *growths, live = below.subplots(1, 1 + len(GROWTH_AXES))
    for (name, label), axes in zip(GROWTH_AXES.items(), growths, strict=True):
        _draw_growth(axes, result["growth"][name], name, label)
    _draw_live(live, result["live"])
    add_common_legend(figure, above, columns=4)


def _draw_errors(axes: Axes, rows: Sequence[Row]) -> None:
    for row in rows:
        mark, colour, label = METHOD_LOOKS[row["method"]]
        (x, across), (y, along) = _error_bars([row["time_ms"]], 1e-3), _error_bars([row["error_mm"]])
        axes.errorbar(
            x, y, along, across, color=colour, fmt=mark, label=label, linewidth=1.6, capsize=2.5,
            markersize=16 if mark == "*" else 8, markerfacecolor="white" if row["extrapolated_from"] is not None else colour,
        )  # fmt: skip
    set_log_scales(axes)
    low, high = axes.get_xlim()
    set_log_scales(axes, {seconds: label for seconds, label in ROUND_TIMES_S.items() if low <= seconds <= high})
    label_twos_and_fives(axes.yaxis)
    part = PART_LABELS.get(rows[0]["part"], rows[0]["part"])
    size = "{taxels:,} taxels, {triangles:,} triangles, {pokes_per_taxel} pokes a taxel".format_map(rows[0])
    axes.set(xlabel="processor time to solve all taxels from their contacts", ylabel="mean error against the truth (mm)")
    axes.set_title(f"{part}: {size}")


def _error_bars(spreads: Sequence[Mapping[str, float]], unit: float = 1.0) -> tuple[list[float], list[list[float]]]:
    """Return medians and their distances to both quartiles, for `errorbar`."""
    medians = [unit * spread["median"] for spread in spreads]
    low, high = ([unit * abs(spread[key] - spread["median"]) for spread in spreads] for key in ("q1", "q3"))
    return medians, [low, high]


def _seconds_tick(seconds: float) -> str:
    return time_words(1e3 * seconds) if seconds >= 1e-3 else f"{1e6 * seconds:g} \N{MICRO SIGN}s"


def _draw_growth(axes: Axes, points: Sequence[Mapping[str, Any]], name: str, label: str) -> None:
    series: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for point in points:
        series.setdefault((point["part"], point["method"]), []).append(point)
    for (part, method), own in series.items():
        mark, colour, _ = METHOD_LOOKS[method]
        if len(own) > 1:
            costs, bars = _error_bars([point["us_per_taxel"] for point in own], 1e-6)
            axes.errorbar(
                [point[name] for point in own], costs, bars, color=colour, marker=mark, markersize=9 if mark == "*" else 4.5,
                linewidth=1.4, capsize=2, linestyle="--" if part == "icub-forearm" else "-",
            )  # fmt: skip
    set_log_scales(axes)
    _show_a_decade(axes)
    label_twos_and_fives(axes.yaxis, _seconds_tick)
    axes.xaxis.set_major_formatter("{x:,.0f}")
    axes.set(xlabel=label, ylabel="processor time per taxel")
    axes.set_title("Cost of a taxel", fontsize=10)


def _show_a_decade(axes: Axes) -> None:
    """Let a logarithmic y axis show a decade at least: small differences look small, and some ticks have labels."""
    low, high = axes.get_ylim()
    if high < 10.0 * low:
        middle = (low * high) ** 0.5
        axes.set_ylim(middle / 10.0**0.5, middle * 10.0**0.5)


def _draw_live(axes: Axes, rows: Sequence[Row]) -> None:
    for part, own in groupby(rows, key=lambda row: row["part"]):
        points = list(own)
        for key, colour, label in (("snapshot_ms", BLACK, "snapshot"), ("guide_ms", ORANGE, "guide")):
            costs, bars = _error_bars([point[key] for point in points], 1e-3)
            is_small = part == "icub-forearm"
            axes.errorbar(
                [point["pokes"] for point in points], costs, bars, color=colour, marker="o", markersize=4.5, linewidth=1.4,
                capsize=2, linestyle="--" if is_small else "-", label=f"{label}, {points[0]['taxels']:,} taxels",
            )  # fmt: skip
    set_log_scales(axes)
    label_twos_and_fives(axes.yaxis, _seconds_tick)
    axes.xaxis.set_major_formatter("{x:,.0f}")
    axes.set(xlabel="pokes of the session", ylabel="processor time of one more poke")
    axes.set_title("Live cost of a poke", fontsize=10)
    axes.legend(fontsize=8)


THIS_STUDY = Study(
    "runtime", quick=QUICK_SIZES, full=FULL_SIZES, measure=measure, lines=describe, draw=draw, in_processes=False
)
