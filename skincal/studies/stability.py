"""Compare every solver with an 80-digit reference on stiff and extreme cases.

The tolerance is ten times the largest change of the exact answer over 20 (quick: 8) perturbations of the inputs by one unit in
the last place, plus 1e-15 of the answer's norm. The error is the largest over several orders of the contacts. The shipped
solvers must give the same bits in all of them. A module's error is that of its worst pad, each with its own tolerance. The
solver must report exactly the unobservable pads as blind. Pads without a defined position are not compared.

Rig corrections (`stability_corrections`), covariances and heights (`stability_covariances`), and known distances
(`stability_distances`) have the same tolerance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray, cross_matrix, move_wrench, orthonormal_pair
from skincal.mesh.search import nearest_in_metric
from skincal.mesh.surface import Surface, make_surface, triangle_heights
from skincal.model.scene import NoiseSettings
from skincal.modules.estimate import estimate_modules
from skincal.modules.pose import Pads
from skincal.modules.pose_fit import fit_modules, whitened_rows
from skincal.palette import BLACK, BLUE, ORANGE, SKY, VERMILION
from skincal.plotting import Axes, Figure, add_common_legend
from skincal.studies import reference_80_digits as reference
from skincal.studies.baselines import ModuleProblem
from skincal.studies.harness import Bench, Findings, Study
from skincal.studies.reference_80_digits import ERROR_OF_FAILED_SOLVER_M, Truth, distance, error_of, find_truth
from skincal.studies.stability_cases import (
    FULL_SIZES,
    PADS_PER_MODULE,
    QUICK_SIZES,
    AddedCase,
    Case,
    CaseSizes,
    ModuleCase,
    Readings,
    cases_of,
    contacts_of,
    model_of,
    module_cases,
    perturbed,
    taxel_cases,
)
from skincal.studies.stability_corrections import correction_cases
from skincal.studies.stability_covariances import covariance_cases
from skincal.studies.stability_distances import distance_cases
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Method
from skincal.taxels.solve import solve

TOLERANCE_OVER_INPUT_ROUNDING = 10.0
RELATIVE_TOLERANCE = 1e-15
"""Share of the answer's norm: nine roundings of it."""
SOLVER_NAMES = ("free", "surface", "modules", "added")
STUDY_RANDOM_SEED = 20261121
ADDED_CASES_RANDOM_SEED = 20261123
ADDED_FAMILIES = {
    "corrections": correction_cases,
    "covariances and heights": covariance_cases,
    "known distances": distance_cases,
}
"""Cases of what the program adds to the paper's methods. Their order is part of the seed."""
Record: TypeAlias = dict[str, Any]
AddedTruth: TypeAlias = dict[str, tuple[reference.Exact, float]]
"""By name of the output: its numbers in 80 digits, and their largest change by the last digits of the inputs."""


def measure(bench: Bench, sizes: CaseSizes) -> Findings:
    """Measure every case, or those of `sizes.only`.

    Returns
    -------
    JSON: `cases` of the shipped solvers, `alternatives` of other ways to solve the same rows, names of cases in `misses`
    """
    records: list[Record] = []
    alternatives: list[Record] = []
    bench.say(
        f"tolerance: {TOLERANCE_OVER_INPUT_ROUNDING:g} times the effect of the inputs' last digit, plus "
        f"{RELATIVE_TOLERANCE:g} of the answer"
    )
    for own, others in bench.each(partial(_measure_case, draws=sizes.draws), enumerate(all_cases(sizes))):
        records += own
        alternatives += others
        bench.say(f"{records[-1]['name']}: {records[-1]['error_over_bound']:.2g} of the tolerance")
    return Findings({
        "digits": reference.PRECISION_DIGITS, "draws": sizes.draws,
        "factor": TOLERANCE_OVER_INPUT_ROUNDING, "of_size": RELATIVE_TOLERANCE, "held": sum(case["holds"] for case in records),
        "misses": [case["name"] for case in records if not case["holds"]],
        "cases": records, "alternatives": alternatives,
    })  # fmt: skip


def added_cases(sizes: CaseSizes) -> Iterator[AddedCase]:
    """Yield the cases of what the program adds to the paper's methods."""
    return cases_of(ADDED_FAMILIES, ADDED_CASES_RANDOM_SEED, sizes)


def all_cases(sizes: CaseSizes) -> Iterator[Case | AddedCase]:
    """Yield every case, or those that `sizes` names."""
    every = chain(taxel_cases(sizes), module_cases(sizes), added_cases(sizes))
    return (case for case in every if not sizes.only or case.name in sizes.only)


def _measure_case(numbered: tuple[int, Case | AddedCase], draws: int) -> tuple[list[Record], list[Record]]:
    """Measure the shipped solver of a case, and its alternatives."""
    number, case = numbered
    rng = np.random.default_rng([STUDY_RANDOM_SEED, number])
    if isinstance(case, AddedCase):
        found: tuple[list[Record], list[Record]] = evaluate_added(case, find_added_truth(case, draws, rng)), []
    else:
        truth = find_truth(case, draws, rng)
        found = evaluate(case, truth), evaluate_alternatives(case, truth)
    for record in chain(*found):
        record["family"] = case.family
    return found


def tolerance(change: float, size: float) -> float:
    """Return the largest accepted error of an answer of norm `size` that perturbations of the inputs move by `change`."""
    return TOLERANCE_OVER_INPUT_ROUNDING * change + RELATIVE_TOLERANCE * size


class SolverError(NamedTuple):
    """Error of an answer, the largest accepted one, and the answer's norm."""

    error: float
    bound: float
    size: float

    @property
    def over_bound(self) -> float:
        """Error over the tolerance."""
        return ERROR_OF_FAILED_SOLVER_M if self.error >= ERROR_OF_FAILED_SOLVER_M else self.error / self.bound

    def record(self, name: str, solver: str, *, same: bool, **more: Any) -> Record:
        """Make the JSON of a case; `same` says whether all orders of the contacts gave the same bits."""
        return {
            "name": name, "solver": solver, "error": self.error, "bound": self.bound, "error_over_bound": self.over_bound,
            "holds": bool(self.error <= self.bound and same), "same_bits": same, "size": self.size, **more,
        }  # fmt: skip


def find_added_truth(case: AddedCase, draws: int, rng: np.random.Generator) -> AddedTruth:
    """Find each output of a case in 80 digits, and its largest change over `draws` perturbations of the inputs."""
    answer = case.exact(case.inputs)
    drawn = [case.exact(perturbed(case.inputs, rng)) for _ in range(draws)]
    return {
        name: (exact, max(distance(exact.ravel(), other[name].ravel()) for other in drawn)) for name, exact in answer.items()
    }


def evaluate_added(case: AddedCase, truth: AddedTruth) -> list[Record]:
    """Measure each output that the program adds in a case: the error over all its numbers."""
    shipped = case.shipped(case.inputs)
    records: list[Record] = []
    for name, (numbers, change) in truth.items():
        exact: reference.Exact = numbers.ravel()
        size = distance(exact)
        fits = name in shipped and shipped[name].shape == numbers.shape
        error = error_of(shipped[name].ravel(), exact) if fits else ERROR_OF_FAILED_SOLVER_M
        found = SolverError(error, tolerance(change, size), size)
        records.append(found.record(f"{case.name}: {name}", "added", same=True, readings=case.pokes, draws_by="digits"))
    return records


def _surface(case: Case) -> Surface | None:
    # As in loading, triangles without area are left out.
    mesh = case.mesh
    return None if mesh is None else make_surface(mesh.vertices, mesh.triangles[triangle_heights(mesh.corners)[0] > 0])


def _orders(case: Case) -> Iterator[IntArray]:
    """Yield orders of the contacts: original, reversed, shuffled; for a taxel also by weight, both ways."""
    contacts = len(case.readings.forces)
    own = np.tile(np.arange(contacts), case.repeats)
    yield own
    yield own[::-1]
    if contacts > 1:
        yield np.random.default_rng(contacts).permutation(own)
    if contacts > 1 and not isinstance(case, ModuleCase):
        by_weight = np.argsort(case.readings.responses / case.readings.strongest, kind="stable")
        yield np.tile(by_weight[::-1], case.repeats)
        yield np.tile(by_weight, case.repeats)


Found: TypeAlias = tuple[FloatArray, NDArray[np.bool_]]
"""Positions (k, 3), metres, as in `Truth.points`, and whether each is reported as blind (k,)."""
Solver: TypeAlias = Callable[[Case, IntArray, Surface | None], Found]
Alternative: TypeAlias = Callable[[Case, IntArray, Surface | None], FloatArray]


def evaluate(case: Case, truth: Truth, solver: Solver | None = None) -> list[Record]:
    """Measure the position, and the blind direction if there is one."""
    surface, solver = _surface(case), solver or (shipped_module if isinstance(case, ModuleCase) else shipped_taxel)
    found = [solver(case, order, surface) for order in _orders(case)]
    points = [points for points, _ in found]
    same = all(np.array_equal(each, points[0], equal_nan=True) for each in points)
    readings = len(case.readings.forces) * case.repeats
    if isinstance(case, ModuleCase):
        right = all(np.array_equal(blind, truth.must_be_blind) for _, blind in found)
        worst = worst_point(truth, points)
        more = {"readings": readings, "draws_by": "step", "blind_right": right, "compared": sum(truth.observable)}
        worst = worst if right else worst._replace(error=ERROR_OF_FAILED_SOLVER_M)
        return [worst.record(case.name, case.solver, same=same, **more)]
    return [
        own.record(case.name + name, case.solver, same=same, readings=readings, draws_by="digits")
        for name, own in zip(("", ": blind direction"), point_errors(truth, points), strict=False)
    ]


def point_errors(truth: Truth, found: Sequence[FloatArray]) -> list[SolverError]:
    """Return the largest error of each observable point."""
    sizes = [distance(point) for point in truth.points]
    return [
        SolverError(
            max(error_of(points[at], truth.points[at]) for points in found),
            tolerance(truth.sensitivity_m[at], sizes[at]),
            sizes[at],
        )
        for at in np.flatnonzero(truth.observable).tolist()
    ]


def worst_point(truth: Truth, found: Sequence[FloatArray]) -> SolverError:
    """Return the largest error over its tolerance."""
    least = min(distance(point) for point in truth.points)
    return max(
        point_errors(truth, found),
        key=lambda own: own.error / own.bound,
        default=SolverError(0.0, RELATIVE_TOLERANCE * least, least),
    )


def evaluate_alternatives(case: Case, truth: Truth) -> list[Record]:
    """Measure the alternatives, if the contacts determine every point: none of them reports blind ones."""
    module = isinstance(case, ModuleCase)
    if case.blind or not all(truth.observable):
        return []
    surface, orders = _surface(case), list(_orders(case))[: 1 if module else None]
    records: list[Record] = []
    for name, alternative in (MODULE_ALTERNATIVES if module else TAXEL_ALTERNATIVES).items():
        worst = worst_point(truth, [alternative(case, order, surface) for order in orders])
        more = {"error": worst.error, "error_over_bound": worst.over_bound}
        records.append({"name": case.name, "solver": case.solver, "method": name, **more})
    return records


# ---- taxels ----


def shipped_taxel(case: Case, order: IntArray, surface: Surface | None) -> Found:
    """Solve a taxel by the program; every contact counts fully."""
    method = Method.FREE if surface is None else Method.SURFACE
    found = solve(ContactTable(contacts_of(case, order)).evidence([0]), [method], NoiseSettings(), surface, doubting=False)
    answer = found.answer[0]
    points = answer["point" if found.has_surface else "solution"][None]
    if case.blind:
        direction = answer["blind"] if answer["rank"] == 2 else np.full(3, np.nan)
        # It has no sign: that of the exact one.
        exact = reference.to_float(reference.solve_blind(reference.normal_equations(case.readings))[1])
        points = np.stack([points[0], direction * np.sign(direction @ exact)])
    return points, np.zeros(len(points), np.bool_)


RowsOf: TypeAlias = Callable[[Readings], tuple[FloatArray, FloatArray]]
RowSolver: TypeAlias = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
"""Solver of A p = b: the point, and a root and an offset with |A p - b|^2 = |root p - offset|^2 + a constant."""


def _by_rows(rows: RowsOf, solver: RowSolver, case: Case, order: IntArray, surface: Surface | None) -> FloatArray:
    point, root, offset = solver(*rows(case.readings.ordered(order)))
    if surface is None:
        return point[None]
    push = reference.to_float(reference.mean_push(case.readings))
    return nearest_in_metric(surface, root[None], offset[None], push[None]).points


def _link_frame(readings: Readings) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return u and m/|f| (n, 3) in the link frame, and k (n,)."""
    force, moment = move_wrench(readings.poses[readings.pose_of], readings.forces, readings.moments)
    size = np.sqrt(np.sum(force * force, axis=1, keepdims=True))
    return force / size, moment / size, readings.responses / readings.strongest


def three_rows(readings: Readings) -> tuple[FloatArray, FloatArray]:
    """Make the rows of (5): A (3n, 3) and b (3n,)."""
    u, m, k = _link_frame(readings)
    return (k[:, None, None] * cross_matrix(u)).reshape(-1, 3), (-k[:, None] * m).ravel()


def two_rows(readings: Readings) -> tuple[FloatArray, FloatArray]:
    """Make two rows a contact: A (2n, 3) and b (2n,)."""
    u, m, k = _link_frame(readings)
    rows = k[:, None, None] * orthonormal_pair(u)
    return rows.reshape(-1, 3), np.einsum("nij,nj->ni", rows, np.cross(u, m)).ravel()


def _solve_or_nan(matrix: FloatArray, right: FloatArray) -> FloatArray:
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=float)
    except np.linalg.LinAlgError:
        return np.full(len(right), np.nan)


def by_normal_equations(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve A'A p = A'b."""
    matrix, right = a.T @ a, a.T @ b
    values, axes = (np.asarray(part, dtype=float) for part in np.linalg.eigh(matrix))
    with np.errstate(divide="ignore"):
        inverse = np.where(values > np.finfo(float).eps * values[-1], 1.0 / np.sqrt(np.abs(values)), 0.0)
    root = np.where(inverse > 0, np.sqrt(np.abs(values)), 0.0)[:, None] * axes.T
    return _solve_or_nan(matrix, right), root, inverse * (axes.T @ right)


def by_qr(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve by LAPACK's Householder QR, rows and columns in their order."""
    # Rows of zeros, so that the root of a single axis has three rows, too.
    q, root = (np.asarray(part, dtype=float) for part in np.linalg.qr(np.concatenate([a, np.zeros((3, 3))])))
    offset = q[: len(b)].T @ b
    return _solve_or_nan(root, offset), root, offset


def by_svd(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve by `numpy.linalg.lstsq`."""
    u, values, axes = (np.asarray(part, dtype=float) for part in np.linalg.svd(a, full_matrices=False))
    return np.asarray(np.linalg.lstsq(a, b, rcond=None)[0], dtype=float), values[:, None] * axes, u.T @ b


TAXEL_ALTERNATIVES: dict[str, Alternative] = {
    "normal equations": partial(_by_rows, two_rows, by_normal_equations),
    "QR, rows as they come": partial(_by_rows, two_rows, by_qr),
    "lstsq, three rows a contact": partial(_by_rows, three_rows, by_svd),
}


# ---- modules ----


def problem_of(case: Case, order: IntArray, surface: Surface | None) -> ModuleProblem:
    """Make the problem that the program solves, with the module's start as its plan."""
    assert isinstance(case, ModuleCase)
    model = model_of([case], surface)
    start = model.plan(0)
    if start is None:
        raise ValueError(f"{case.name}: the search begins off the mesh")
    return ModuleProblem(model, 0, ContactTable(contacts_of(case, order)), start, case.noise)


def shipped_module(case: Case, order: IntArray, surface: Surface | None) -> Found:
    """Place the module by the program; every poke counts fully."""
    problem = problem_of(case, order, surface)
    found = estimate_modules(problem.table, problem.model, [0], problem.noise, [], {}, doubting=False)
    return _fitted(problem).points, np.array([found[channel].position is None for channel in range(PADS_PER_MODULE)])


def _fitted(problem: ModuleProblem) -> Pads:
    return fit_modules(problem.touches, problem.model, problem.start, problem.noise, doubting=False).pads


GAUSS_NEWTON_STEPS = 15
"""More than the worst case needs."""


def modules_by_normal_equations(case: Case, order: IntArray, surface: Surface | None) -> FloatArray:
    """Take the program's own steps from its own rows, by A'A - B and A'b."""
    problem = problem_of(case, order, surface)
    pose = problem.start
    for _ in range(GAUSS_NEWTON_STEPS):
        rows = whitened_rows(problem.touches, problem.place_pads(pose), problem.noise)
        a = rows.slopes.reshape(-1, rows.slopes.shape[2])
        right, plain = a.T @ rows.misses.ravel(), a.T @ a
        matrix = plain - np.sum(rows.bends, axis=0)
        positive = bool(np.linalg.eigvalsh(matrix + matrix.T)[0] > 0.0)
        step = _solve_or_nan(matrix if positive else plain, right)
        if not np.isfinite(step).all():
            return np.full((PADS_PER_MODULE, 3), np.nan)
        step = step / max(1.0, float(np.abs(step).max()) / 0.015)
        pose = problem.model.ground.move(pose, step[None])
        if float(np.abs(step).max()) < 1e-16:
            break
    return problem.place_pads(pose).points


def modules_by_differences(case: Case, order: IntArray, surface: Surface | None) -> FloatArray:
    """Minimise by `scipy.optimize.least_squares` with its differenced Jacobian.

    The noise is that at the answer, so that the minimum is where the program looks for it.
    """
    problem = problem_of(case, order, surface)
    rows = whitened_rows(problem.touches, _fitted(problem), problem.noise)
    at, pairs = problem.touches.rows, problem.touches.evidence.pairs[problem.touches.rows]

    def misses(pads: Pads) -> FloatArray:
        off = np.sum(pairs * (problem.touches.evidence.nearest[at] - problem.touches.contact_centres(pads)[0])[:, None], axis=2)
        return np.sum(rows.whiten * off[:, None], axis=2)

    return problem.by_least_squares(misses, xtol=1e-15, ftol=1e-15, gtol=1e-15)


MODULE_ALTERNATIVES: dict[str, Alternative] = {
    "normal equations": modules_by_normal_equations,
    "least_squares, differenced": modules_by_differences,
}


# ---- text ----


def describe(result: Mapping[str, Any]) -> list[str]:
    """List how many cases stay within the tolerance, the worst case of each solver, each failure, and the other solvers."""
    cases = result["cases"]
    lines = [
        f"{result['held']} of {len(cases)} cases hold: the error is at most {TOLERANCE_OVER_INPUT_ROUNDING:g} times "
        f"the effect of the inputs' last digit ({result['draws']} draws, {result['digits']} digits) plus "
        f"{RELATIVE_TOLERANCE:g} of the answer, and methods give the same bits in every order."
    ]
    for solver in SOLVER_NAMES:
        own = [record for record in cases if record["solver"] == solver]
        if own:
            worst = _worst(own)
            share = worst["error_over_bound"]
            lines.append(f"{solver}: at worst {share:.2g} of the tolerance ({worst['name']}), {len(own)} cases")
    lines += [
        f"MISSES: {record['name']} ({record['solver']}): error {record['error']:.2g}, tolerance {record['bound']:.2g}"
        + ("" if record["same_bits"] else "; the order of the contacts matters")
        for record in cases
        if not record["holds"]
    ]
    for whose, methods in (("", TAXEL_ALTERNATIVES), ("modules, ", MODULE_ALTERNATIVES)):
        for method in methods:
            own = [
                each
                for each in result["alternatives"]
                if (each["method"], each["solver"] == "modules") == (method, bool(whose))
            ]
            if own:
                worst, misses = _worst(own), sum(record["error_over_bound"] > 1 for record in own)
                failed = worst["error"] >= ERROR_OF_FAILED_SOLVER_M
                far = "no number" if failed else f"{worst['error_over_bound']:.1g} times the tolerance"
                lines.append(f"{whose}{method}: misses {misses} of {len(own)}, at worst {far} ({worst['name']})")
    return lines


def _worst(records: Sequence[Record]) -> Record:
    return max(records, key=lambda record: record["error_over_bound"])


# ---- figure ----

ALTERNATIVE_LOOKS = {
    "normal equations": ("x", VERMILION), "QR, rows as they come": ("v", ORANGE),
    "lstsq, three rows a contact": ("s", SKY), "least_squares, differenced": ("v", BLACK),
}  # fmt: skip
"""Mark and colour of each alternative."""
MAX_PLOTTED_TOLERANCE_SHARE = 1e15
"""Largest share that the figure tells apart: beyond it no digit is right."""
MIN_PLOTTED_TOLERANCE_SHARE = 1e-4
"""Smaller shares of the tolerance are drawn at this one."""


def draw(result: Mapping[str, Any], figure: Figure) -> None:
    """Draw the worst share of the tolerance in each family of cases, one panel a solver."""
    solvers = list(dict.fromkeys(case["solver"] for case in result["cases"]))
    figure.set_size_inches(17.0, 9.0)
    for panel, solver in zip(figure.subplots(2, 2).ravel(), solvers, strict=False):
        of = ([record for record in result[kind] if record["solver"] == solver] for kind in ("cases", "alternatives"))
        _draw_solver(panel, solver, *of)
    add_common_legend(figure, figure, columns=5)
    figure.suptitle(
        f"Worst error over tolerance. Tolerance: {result['factor']:g} times the effect of the inputs' last digit "
        f"({result['draws']} draws, {result['digits']} digits) + {result['of_size']:g} of the answer.\n"
        "Right of the line the solver loses digits that the data contain."
    )


def _draw_solver(panel: Axes, solver: str, cases: Sequence[Record], others: Sequence[Record]) -> None:
    row = {family: -at for at, family in enumerate(dict.fromkeys(case["family"] for case in cases))}
    shares = [each["error_over_bound"] for each in (*cases, *others) if each["error"] < ERROR_OF_FAILED_SOLVER_M]
    right = min(max(10.0, *shares) * 3.0, MAX_PLOTTED_TOLERANCE_SHARE)

    def scatter(records: Sequence[Record], **look: Any) -> None:
        worst: dict[str, float] = {}
        for record in records:
            worst[record["family"]] = max(
                worst.get(record["family"], MIN_PLOTTED_TOLERANCE_SHARE), min(record["error_over_bound"], right)
            )
        panel.scatter(list(worst.values()), [row[family] for family in worst], **look)

    for method, (mark, colour) in ALTERNATIVE_LOOKS.items():
        look = {"color": colour} if mark == "x" else {"facecolors": "none", "edgecolors": colour}
        if own := [record for record in others if record["method"] == method]:
            scatter(own, s=40, marker=mark, label=method, linewidths=1.2, **look)
    scatter(cases, s=40, color=BLUE, label="shipped", zorder=3)
    panel.axvline(1.0, color=BLACK, linewidth=1.2)
    panel.set_yticks(list(row.values()), list(row))
    panel.grid(visible=True)
    panel.set(
        xscale="log", xlim=(MIN_PLOTTED_TOLERANCE_SHARE / 2, right * 2), ylim=(0.6 - len(row), 0.6),
        title=f"{solver}: {len(cases)} cases",
        xlabel=f"error over tolerance (least {MIN_PLOTTED_TOLERANCE_SHARE:g}; no number at the right end)",
    )  # fmt: skip


THIS_STUDY = Study("stability", quick=QUICK_SIZES, full=FULL_SIZES, measure=measure, lines=describe, draw=draw)
