"""How far the solvers are from the exact answer on hard readings, beside what the readings' own last digit does to it.

The bar of a case is ten times the largest change of the exact answer over many draws, in which every input number moves
by one unit in its last place, up or down, plus 1e-15 of the answer's norm. The error is the largest over the orders in
which the contacts come; the shipped solvers must give the same bits in all of them. A module's error is that of its worst pad,
each against its own bar; pads that must be called blind are to be called so, and no others. Pads whose place the pokes do not
determine at all have none that could be compared.

Exact is 80 digits (`exact`). With a million readings, and for modules, the draws take the exact answer's derivative instead of
200 exact answers: the error of that is of the second order, 1e-16 of the change.

What the program adds to the methods (`stability_terms`) is held to the same bar, each number that it gives by itself: draws are
exact answers again, 20 a case.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, count
from typing import Any, TypeAlias

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
from skincal.studies import exact
from skincal.studies.baselines import ModuleProblem
from skincal.studies.benchmarking import processes
from skincal.studies.exact import NO_NUMBER, Truth, distance, distance_to
from skincal.studies.stability_cases import (
    FULL,
    PADS,
    QUICK,
    Case,
    CaseSizes,
    ModuleCase,
    RawMesh,
    Readings,
    all_cases,
    all_module_cases,
    contacts_of,
    model_of,
)
from skincal.studies.stability_terms import TermCase, term_cases
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Method
from skincal.taxels.solve import solve

FACTOR = 10.0
"""The error may be that many times what the inputs' last digit does."""
OF_SIZE = 1e-15
"""And that share of the answer's norm: nine roundings of it. Nothing is added where the answer is zero."""
SOLVERS = ("free", "surface", "modules", "added")
DRAWS_OF_ADDED = 20
"""Perturbations of a corrections case: two of them give only 0.2 to 0.5 of the largest change that many would."""
STEPS = 15
"""Of an alternative for modules: more than the worst case needs."""
_SEED = 20261121
Record: TypeAlias = dict[str, Any]


def run(quick: bool, progress: Callable[[str], None], sizes: CaseSizes | None = None) -> dict[str, Any]:
    """Measure every case, as many side by side as the machine has cores; quick with fewer readings and draws, smaller meshes.

    Returns
    -------
    JSON: `cases` of the shipped solvers, `alternatives` of other ways to solve the same rows
    """
    sizes = sizes or (QUICK if quick else FULL)
    cases: list[Record] = []
    alternatives: list[Record] = []
    progress(f"the bar: {FACTOR:g} times what the inputs' last digit does to the exact answer, plus {OF_SIZE:g} of its size")
    with processes() as pool:
        taxels = pool.map(partial(_measured, draws=sizes.draws), count(), all_cases(sizes))
        modules = pool.map(partial(_measured, draws=sizes.draws // 4), count(), all_module_cases(sizes))
        added = pool.map(partial(judge_term, draws=min(DRAWS_OF_ADDED, sizes.draws)), term_cases(sizes))
        for own, others in chain(taxels, modules, ((own, []) for own in added)):
            cases += own
            alternatives += others
            progress(f"{cases[-1]['name']}: {cases[-1]['error_over_bound']:.2g} of the bar")
    return {
        "study": "stability", "quick": quick, "digits": exact.DIGITS, "draws": sizes.draws, "factor": FACTOR,
        "of_size": OF_SIZE, "held": sum(case["holds"] for case in cases), "cases": cases, "alternatives": alternatives,
    }  # fmt: skip


def _measured(number: int, case: Case, draws: int) -> tuple[list[Record], list[Record]]:
    seed = [_SEED, 1, number] if isinstance(case, ModuleCase) else [_SEED, number]
    truth = exact.find_truth(case, draws, np.random.default_rng(seed))
    return judge(case, truth), compare(case, truth)


def judge_term(case: TermCase, draws: int) -> list[Record]:
    """Return a record for each number that the program adds in a case: the error over all of it."""
    said, answer, rng = case.said(), case.exactly_said(), np.random.default_rng([_SEED, 2])
    drawn = [case.exactly_said(rng) for _ in range(draws)]
    records: list[Record] = []
    for what, numbers in answer.items():
        flat = numbers.ravel()
        size = distance(flat)
        bound = bar(max(distance(flat, other[what].ravel()) for other in drawn), size)
        numbered = what in said and said[what].shape == numbers.shape
        error = distance_to(said[what].ravel(), flat) if numbered else NO_NUMBER
        records.append({
            "name": f"{case.name}: {what}", "solver": SOLVERS[-1], "error": error, "bound": bound,
            "error_over_bound": over_bar(error, bound), "holds": bool(error <= bound), "same_bits": True, "size": size,
            "readings": case.pokes, "draws_by": "digits",
        })  # fmt: skip
    return records


def bar(change: float, size: float) -> float:
    """Return the largest error that holds, for an answer of norm `size` that the inputs' last digit moves by `change`."""
    return FACTOR * change + OF_SIZE * size


def over_bar(error: float, bound: float) -> float:
    """Return an error's share of its bar; `NO_NUMBER` where there is none."""
    return NO_NUMBER if error >= NO_NUMBER else error / bound


def _surface(mesh: RawMesh | None) -> Surface | None:
    """Return the surface; triangles without area are left out, as in loading, but none that has any."""
    return None if mesh is None else make_surface(mesh.vertices, mesh.triangles[triangle_heights(mesh.corners)[0] > 0])


def _orders(case: Case) -> Iterator[IntArray]:
    """Yield the orders in which the contacts come: as they are, reversed, shuffled; of a taxel heavy and light ones first."""
    contacts = len(case.readings.forces)
    own = np.tile(np.arange(contacts), case.copies)
    yield own
    yield own[::-1]
    if contacts > 1:
        yield np.random.default_rng(contacts).permutation(own)
    if contacts > 1 and not case.many and not isinstance(case, ModuleCase):
        by_weight = np.argsort(case.readings.responses / case.readings.strongest, kind="stable")
        yield np.tile(by_weight[::-1], case.copies)
        yield np.tile(by_weight, case.copies)


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a solver says of a taxel, or of a module's k pads."""

    points: FloatArray
    """(k, 3) float, metres; wherever it is, of pads that are not known."""
    blind: NDArray[np.bool_] = field(default_factory=partial(np.zeros, 1, np.bool_))
    """(k,) whether no estimate is given."""
    direction: FloatArray | None = None
    """(3,) float, unit: that of a taxel of which the readings say nothing, where the rank is 2."""


Solver: TypeAlias = Callable[[Case, IntArray, Surface | None], Found]
Way: TypeAlias = Callable[[Case, IntArray, Surface | None], FloatArray]
"""Returns the points alone."""


def judge(case: Case, truth: Truth, solver: Solver | None = None) -> list[Record]:
    """Return the records of a case: of the position, and of the blind direction where there is one."""
    surface = _surface(case.mesh)
    found = [(solver or SHIPPED[case.solver])(case, order, surface) for order in _orders(case)]
    same = all(np.array_equal(answer.points, found[0].points, equal_nan=True) for answer in found)
    right = all(np.array_equal(answer.blind, truth.blind) for answer in found)
    error, bound, size = _worst(truth, [answer.points for answer in found])
    more: Record = {"draws_by": "derivative" if case.many else "digits"}
    if isinstance(case, ModuleCase):
        more = {"draws_by": "step", "blind_right": right, "compared": sum(truth.determined)}
    measured = [("", error if right else NO_NUMBER, bound, size)]
    if truth.direction is not None:
        turned = max(_turned(answer, truth.direction) for answer in found)
        measured.append((": blind direction", turned, bar(truth.turn, 1.0), 1.0))
    return [
        {
            "name": case.name + what, "solver": case.solver, "error": error, "bound": bound,
            "error_over_bound": over_bar(error, bound), "holds": bool(error <= bound and same), "same_bits": same, "size": size,
            "readings": len(case.readings.forces) * case.copies, **more,
        }
        for what, error, bound, size in measured
    ]  # fmt: skip


def _turned(answer: Found, blind: exact.Exact) -> float:
    return NO_NUMBER if answer.direction is None else exact.between(exact.exactly(answer.direction), blind)


def _worst(truth: Truth, found: Sequence[FloatArray]) -> tuple[float, float, float]:
    """Return error, bar and norm of the point with the largest error over its bar, of those that are compared."""
    sizes = [distance(place) for place in truth.points]
    worst = 0.0, bar(0.0, min(sizes)), min(sizes)
    errors = [
        (max(distance_to(points[at], truth.points[at]) for points in found), bar(truth.changes[at], sizes[at]), sizes[at])
        for at in np.flatnonzero(truth.determined).tolist()
    ]
    return max(errors, key=lambda error: error[0] / error[1], default=worst)


def compare(case: Case, truth: Truth) -> list[Record]:
    """Return how other ways do on the case, if the contacts determine every point: none of them says what is blind."""
    module = isinstance(case, ModuleCase)
    if truth.direction is not None or not all(truth.determined):
        return []
    surface, orders = _surface(case.mesh), list(_orders(case))[: 1 if case.many or module else None]
    records: list[Record] = []
    for name, way in (MODULE_ALTERNATIVES if module else ALTERNATIVES).items():
        found = [way(case, order, surface) for order in orders]
        error, bound, _ = _worst(truth, found)
        share = over_bar(error, bound)
        records.append({"name": case.name, "solver": case.solver, "method": name, "error": error, "error_over_bound": share})
    return records


# ---- taxels ----


def shipped_taxel(case: Case, order: IntArray, surface: Surface | None) -> Found:
    """Solve a taxel as the program does: free without a surface, else on it."""
    # Each reading counts as it is: what is doubted is not a question of digits.
    method = Method.FREE if surface is None else Method.SURFACE
    found = solve(ContactTable(contacts_of(case, order)).evidence([0]), [method], NoiseSettings(), surface, doubting=False)
    answer = found.answer[0]
    if found.has_surface:
        return Found(answer["point"][None])
    return Found(answer["solution"][None], direction=answer["blind"] if answer["rank"] == 2 else None)


RowsOf: TypeAlias = Callable[[Readings], tuple[FloatArray, FloatArray]]
RowSolver: TypeAlias = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
"""A way to solve A p = b: the point, and a root and an offset with |A p - b|^2 = |root p - offset|^2 + a constant."""


def _by_rows(rows: RowsOf, way: RowSolver, case: Case, order: IntArray, surface: Surface | None) -> FloatArray:
    point, root, offset = way(*rows(case.readings.ordered(order)))
    if surface is None:
        return point[None]
    return nearest_in_metric(surface, root[None], offset[None], exact.floats(exact.mean_push(case.readings))[None]).points


def _link_frame(readings: Readings) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return u and m/|f| (n, 3) in the link frame, and k (n,)."""
    force, moment = move_wrench(readings.poses[readings.pose_of], readings.forces, readings.moments)
    size = np.sqrt(np.sum(force * force, axis=1, keepdims=True))
    return force / size, moment / size, readings.responses / readings.strongest


def three_rows(readings: Readings) -> tuple[FloatArray, FloatArray]:
    """Return the rows of (5): A (3n, 3) and b (3n,)."""
    u, m, k = _link_frame(readings)
    return (k[:, None, None] * cross_matrix(u)).reshape(-1, 3), (-k[:, None] * m).ravel()


def two_rows(readings: Readings) -> tuple[FloatArray, FloatArray]:
    """Return two rows a contact: A (2n, 3) and b (2n,)."""
    u, m, k = _link_frame(readings)
    rows = k[:, None, None] * orthonormal_pair(u)
    return rows.reshape(-1, 3), np.einsum("nij,nj->ni", rows, np.cross(u, m)).ravel()


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Return the solution, NaN where the matrix is singular to the last bit."""
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
    return _solved(matrix, right), root, inverse * (axes.T @ right)


def by_qr(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve by LAPACK's Householder QR, rows and columns as they come."""
    # Rows of zeros, so that the root of a single axis has three rows too.
    q, root = (np.asarray(part, dtype=float) for part in np.linalg.qr(np.concatenate([a, np.zeros((3, 3))])))
    offset = q[: len(b)].T @ b
    return _solved(root, offset), root, offset


def by_svd(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve as `numpy.linalg.lstsq` does."""
    u, values, axes = (np.asarray(part, dtype=float) for part in np.linalg.svd(a, full_matrices=False))
    return np.asarray(np.linalg.lstsq(a, b, rcond=None)[0], dtype=float), values[:, None] * axes, u.T @ b


ALTERNATIVES: dict[str, Way] = {
    "normal equations": partial(_by_rows, two_rows, by_normal_equations),
    "QR, rows as they come": partial(_by_rows, two_rows, by_qr),
    "lstsq, three rows a contact": partial(_by_rows, three_rows, by_svd),
}


# ---- modules ----


def problem_of(case: Case, order: IntArray, surface: Surface | None) -> ModuleProblem:
    """Return pokes as the program gets them, the module's start as its plan."""
    assert isinstance(case, ModuleCase)
    model = model_of([case], surface)
    start = model.plan(0)
    if start is None:
        raise ValueError(f"{case.name}: the search begins off the mesh")
    return ModuleProblem(model, 0, ContactTable(contacts_of(case, order)), start, case.noise)


def shipped_module(case: Case, order: IntArray, surface: Surface | None) -> Found:
    """Place the module as the program does; every poke counts fully."""
    problem = problem_of(case, order, surface)
    said = estimate_modules(problem.table, problem.model, [0], problem.noise, [], {}, doubting=False)
    return Found(_fitted(problem).points, np.array([said[channel].position is None for channel in range(PADS)]))


def _fitted(problem: ModuleProblem) -> Pads:
    return fit_modules(problem.touches, problem.model, problem.start, problem.noise, doubting=False).pads


SHIPPED: dict[str, Solver] = {"free": shipped_taxel, "surface": shipped_taxel, "modules": shipped_module}


def modules_by_normal_equations(case: Case, order: IntArray, surface: Surface | None) -> FloatArray:
    """Take the program's own steps from its own rows, by A'A - B and A'b."""
    problem = problem_of(case, order, surface)
    pose = problem.start
    for _ in range(STEPS):
        rows = whitened_rows(problem.touches, problem.laid(pose), problem.noise)
        a = rows.slopes.reshape(-1, rows.slopes.shape[2])
        right, plain = a.T @ rows.misses.ravel(), a.T @ a
        matrix = plain - np.sum(rows.bends, axis=0)
        bent = bool(np.linalg.eigvalsh(matrix + matrix.T)[0] > 0.0)
        step = _solved(matrix if bent else plain, right)
        if not np.isfinite(step).all():
            return np.full((PADS, 3), np.nan)
        step = step / max(1.0, float(np.abs(step).max()) / 0.015)
        pose = problem.model.ground.move(pose, step[None])
        if float(np.abs(step).max()) < 1e-16:
            break
    return problem.laid(pose).points


def modules_by_differences(case: Case, order: IntArray, surface: Surface | None) -> FloatArray:
    """Minimise by `scipy.optimize.least_squares` with its differenced Jacobian.

    The noise is held as it is at the answer, so that the minimum is where the program looks for it.
    """
    problem = problem_of(case, order, surface)
    rows = whitened_rows(problem.touches, _fitted(problem), problem.noise)
    at, pairs = problem.touches.rows, problem.touches.evidence.pairs[problem.touches.rows]

    def misses(pads: Pads) -> FloatArray:
        off = np.sum(pairs * (problem.touches.evidence.nearest[at] - problem.touches.contact_centres(pads)[0])[:, None], axis=2)
        return np.sum(rows.whiten * off[:, None], axis=2)

    return problem.by_least_squares(misses, xtol=1e-15, ftol=1e-15, gtol=1e-15)


MODULE_ALTERNATIVES: dict[str, Way] = {
    "normal equations": modules_by_normal_equations,
    "least_squares, differenced": modules_by_differences,
}


# ---- what is said of it ----


def summary(result: dict[str, Any]) -> list[str]:
    """Return how many cases hold, the worst of each solver, each miss, and how the other ways do."""
    cases = result["cases"]
    lines = [
        f"{result['held']} of {len(cases)} cases hold: error at most {FACTOR:g} times what the inputs' last digit does "
        f"({result['draws']} draws, {result['digits']} digits) plus {OF_SIZE:g} of the answer; "
        "methods give the same bits in every order."
    ]
    for solver in SOLVERS:
        own = [record for record in cases if record["solver"] == solver]
        if not own:
            continue
        worst = max(own, key=lambda record: record["error_over_bound"])
        lines.append(f"{solver}: at worst {worst['error_over_bound']:.2g} of the bar ({worst['name']}), {len(own)} cases")
    lines += [
        f"MISSES: {record['name']} ({record['solver']}): error {record['error']:.2g}, bar {record['bound']:.2g}"
        + ("" if record["same_bits"] else "; the order of the contacts matters")
        for record in cases
        if not record["holds"]
    ]
    for whose, ways in (("", ALTERNATIVES), ("modules, ", MODULE_ALTERNATIVES)):
        of = [record for record in result["alternatives"] if (record["solver"] == "modules") == bool(whose)]
        lines += [
            whose + _of_alternative(method, [record for record in of if record["method"] == method])
            for method in ways
            if any(record["method"] == method for record in of)
        ]
    return lines


def _of_alternative(method: str, own: list[Record]) -> str:
    misses = [record for record in own if record["error_over_bound"] > 1]
    worst = max(own, key=lambda record: record["error_over_bound"])
    far = "no number" if worst["error"] >= NO_NUMBER else f"{worst['error_over_bound']:.1g} times the bar"
    return f"{method}: misses {len(misses)} of {len(own)}, at worst {far} ({worst['name']})"


# ---- figure ----

TRY_LOOKS = {
    "normal equations": ("x", VERMILION), "QR, rows as they come": ("v", ORANGE),
    "lstsq, three rows a contact": ("s", SKY), "least_squares, differenced": ("v", BLACK),
}  # fmt: skip
"""Mark and colour of each other way."""
SHARE_MIN, SHARE_MAX = 1e-4, 1e300
"""Shares of the bar below the one are drawn at it; one as large as the other is no number."""


def draw(result: dict[str, Any], figure: Figure) -> None:
    """Draw each case's share of the bar, shipped and other ways, one panel a solver."""
    solvers = list(dict.fromkeys(case["solver"] for case in result["cases"]))
    rows = max(sum(case["solver"] == solver for case in result["cases"]) for solver in solvers)
    figure.set_size_inches(24.0, 2.0 + 0.19 * rows)
    for panel, solver in zip(figure.subplots(1, len(solvers), squeeze=False)[0], solvers, strict=True):
        of = ([record for record in result[kind] if record["solver"] == solver] for kind in ("cases", "alternatives"))
        _draw_solver(panel, solver, *of)
    add_common_legend(figure, figure, columns=4)
    figure.suptitle(
        f"Error over the bar. Bar: {result['factor']:g} times what the inputs' last digit does ({result['draws']} draws, "
        f"{result['digits']} digits) + {result['of_size']:g} of the answer. "
        "Right of the line the solver loses digits that the data contain."
    )


def _draw_solver(panel: Axes, solver: str, cases: Sequence[Mapping[str, Any]], others: Sequence[Mapping[str, Any]]) -> None:
    place = {case["name"]: -row for row, case in enumerate(cases)}
    every = [record["error_over_bound"] for record in (*cases, *others)]
    right = max(10.0, *(share for share in every if share < SHARE_MAX)) * 3.0

    def put(records: Sequence[Mapping[str, Any]], **look: Any) -> None:
        shares = [min(max(record["error_over_bound"], SHARE_MIN), right) for record in records]
        panel.scatter(shares, [place[record["name"]] for record in records], **look)

    for method, (mark, colour) in TRY_LOOKS.items():
        look = {"color": colour} if mark == "x" else {"facecolors": "none", "edgecolors": colour}
        if own := [record for record in others if record["method"] == method]:
            put(own, s=22, marker=mark, label=method, linewidths=1.0, **look)
    put(cases, s=26, color=BLUE, label="shipped", zorder=3)
    panel.axvline(1.0, color=BLACK, linewidth=1.2)
    panel.set_yticks(list(place.values()), list(place), fontsize=7.5)
    panel.grid(visible=True)
    panel.set(
        xscale="log", xlim=(SHARE_MIN / 2, right * 2), ylim=(-len(cases), 1), title=f"{solver}: {len(cases)} cases",
        xlabel=f"error over the bar\n(least {SHARE_MIN:g};\nno number at the right end)",
    )  # fmt: skip
