"""How far the solvers are from the exact answer on hard readings, beside what the readings' own last digit does to it.

The bar of a case is ten times the largest change of the exact answer over many draws, in which every input number moves
by one unit in its last place, up or down, plus 1e-15 of the answer's norm. The error is the largest over the orders in
which the contacts come; the shipped solvers must give the same bits in all of them.

The modules method, which places boards and not points, is judged by the same bar in `board_stability`.

Exact is 80 digits (`exact`, `board_exact`). With a million readings, and for boards, the draws take the exact answer's
derivative instead of 200 exact answers: the error of that is of the second order, 1e-16 of the change.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry.arrays import FloatArray, IntArray
from skincal.geometry.wrench import cross_matrix, move_wrench
from skincal.model.scene import NoiseSettings
from skincal.studies import exact
from skincal.studies.bar import FACTOR, OF_SIZE, bar, over_bar
from skincal.studies.board_cases import all_board_cases
from skincal.studies.board_exact import find_board_truth
from skincal.studies.board_stability import BOARD_ALTERNATIVES, compare_board, judge_board, shipped_board
from skincal.studies.cases import FULL, QUICK, Case, Mesh, Readings, all_cases
from skincal.studies.exact import NO_NUMBER, Truth, Vector
from skincal.surface.clean import heights
from skincal.surface.mesh import Surface, make_surface
from skincal.surface.nearest import nearest_to_rows
from skincal.taxels.contact_table import ContactTable, across
from skincal.taxels.least_squares import factor
from skincal.taxels.result import Method
from skincal.taxels.solve import solve

if TYPE_CHECKING:
    from skincal.studies.figure import Axes, Figure

DRAWS = 200
DRAWS_QUICK = 40
"""Of a taxel; a quarter of them of a module, which has as many answers as pads."""
SOLVERS = ("free", "surface", "modules")
_SEED = 20261121
_FLOOR = 1e-4
"""Shares of the bar below this are drawn at this."""


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a solver says."""

    point: FloatArray
    """(3,) float, metres."""
    rank: int = 3
    blind: FloatArray | None = None
    """(3,) float, unit, where the rank is 2."""


Solver: TypeAlias = Callable[[Sequence[Contact], Surface | None], Found]


def shipped(contacts: Sequence[Contact], surface: Surface | None) -> Found:
    """Solve taxel 0 as the program does: free without a surface, else on it."""
    # Each reading counts as it is: what is doubted is not a question of digits.
    method = Method.FREE if surface is None else Method.SURFACE
    found = solve(ContactTable(contacts).evidence([0]), [method], NoiseSettings(), surface, doubting=False)
    if found.surface is not None:
        return Found(found.surface.points[0])
    return Found(found.factors.solutions[0], int(found.factors.ranks[0]), found.factors.blind[0])


def run(quick: bool, progress: Callable[[str], None]) -> dict[str, Any]:
    """Measure every case; quick with fewer readings, smaller meshes and fewer draws.

    Returns
    -------
    JSON: `cases` of the shipped solvers, `alternatives` of other ways to solve the same rows
    """
    draws, sizes = (DRAWS_QUICK, QUICK) if quick else (DRAWS, FULL)
    cases: list[dict[str, Any]] = []
    alternatives: list[dict[str, Any]] = []
    progress(f"the bar: {FACTOR:g} times what the inputs' last digit does to the exact answer, plus {OF_SIZE:g} of its size")
    for number, case in enumerate(all_cases(sizes)):
        truth = exact.find_truth(case, draws, np.random.default_rng([_SEED, number]))
        cases += judge(case, truth, shipped)
        alternatives += compare(case, truth)
        progress(f"{case.name}: {cases[-1]['error_over_bound']:.2g} of the bar")
    for number, board in enumerate(all_board_cases(sizes)):
        placed = find_board_truth(board, draws // 4, np.random.default_rng([_SEED, 1, number]))
        cases.append(judge_board(board, placed, shipped_board))
        alternatives += compare_board(board, placed)
        progress(f"{board.name}: {cases[-1]['error_over_bound']:.2g} of the bar")
    held = sum(one["holds"] for one in cases)
    return {
        "study": "stability", "quick": quick, "digits": exact.DIGITS, "draws": draws, "factor": FACTOR, "of_size": OF_SIZE,
        "held": held, "cases": cases, "alternatives": alternatives,
    }  # fmt: skip


def judge(case: Case, truth: Truth, solver: Solver) -> list[dict[str, Any]]:
    """Return the records of a case: of the position, and of the blind direction where there is one."""
    surface = None if case.mesh is None else _surface(case.mesh)
    contacts = _contacts(case.readings)
    found = [solver([contacts[int(place)] for place in order], surface) for order in _orders(case)]
    same = all(np.array_equal(one.point, found[0].point, equal_nan=True) for one in found)
    error = max(exact.distance_to(one.point, truth.answer) for one in found)
    size = exact.distance(truth.answer)
    records = [_record(case, case.name, error, size, bar(truth.change, size), same)]
    if truth.blind is not None:
        angle = max(_blindness(one, truth.blind) for one in found)
        records.append(_record(case, f"{case.name}: blind direction", angle, 1.0, bar(truth.turn, 1.0), same))
    return records


def _blindness(found: Found, blind: Vector) -> float:
    """Return the angle between the direction reported and the right one, rad; `NO_NUMBER` where none is reported."""
    if found.rank != 2 or found.blind is None:
        return NO_NUMBER
    return exact.between(exact.vector(found.blind), blind)


def _record(case: Case, name: str, error: float, size: float, bound: float, same: bool) -> dict[str, Any]:
    return {
        "name": name, "solver": _method(case), "error": error, "bound": bound,
        "error_over_bound": over_bar(error, bound), "holds": bool(error <= bound and same), "same_bits": same, "size": size,
        "readings": len(case.readings.forces) * case.copies, "draws_by": "derivative" if case.many else "digits",
    }  # fmt: skip


def _method(case: Case) -> str:
    return "free" if case.mesh is None else "surface"


def _surface(mesh: Mesh) -> Surface:
    """Return the surface; triangles without area are left out, as in loading, but none that has any."""
    return make_surface(mesh.vertices, mesh.triangles[heights(mesh.corners)[0] > 0])


def _orders(case: Case) -> Iterator[IntArray]:
    """Yield the orders in which the contacts come: as they are, reversed, shuffled, heavy first, light first."""
    count = len(case.readings.forces)
    own = np.tile(np.arange(count), case.copies)
    yield own
    yield own[::-1]
    if count == 1:
        return
    yield np.random.default_rng(count).permutation(own)
    if not case.many:
        by_weight = np.argsort(case.readings.responses / case.readings.strongest, kind="stable")
        yield np.tile(by_weight[::-1], case.copies)
        yield np.tile(by_weight, case.copies)


def _contacts(readings: Readings) -> list[Contact]:
    """Return the contacts: channel 0 is the taxel, channel 1 the one that answered most."""
    alone, two = np.array([0]), np.array([0, 1])
    own = readings.responses == readings.strongest
    # The same array for all contacts of a pose: a million of them need no copies.
    poses: dict[int, FloatArray] = dict(enumerate(readings.poses))
    pose_of: list[int] = readings.pose_of.tolist()
    responses = np.stack([readings.responses, readings.strongest], axis=1)
    return [
        Contact(
            number + 1, 0.0, 1.0, readings.forces[number], readings.moments[number], alone if own[number] else two,
            responses[number, :1] if own[number] else responses[number], poses[pose], f"pose {pose}", 0.0, True,
        )
        for number, pose in enumerate(pose_of)
    ]  # fmt: skip


Rows: TypeAlias = Callable[[Readings], tuple[FloatArray, FloatArray]]
Way: TypeAlias = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
"""A way to solve A p = b: the point, and a root and an offset with |A p - b|^2 = |root p - offset|^2 + a constant."""


def compare(case: Case, truth: Truth) -> list[dict[str, Any]]:
    """Return how other ways do on the case, rows in the order of the contacts; none reports a blind direction."""
    if case.blind:
        return []
    surface = None if case.mesh is None else _surface(case.mesh)
    push = np.array([[float(one) for one in exact.mean_push(case.readings)]]) if surface is not None else None
    orders = list(_orders(case))[: 1 if case.many else None]
    records: list[dict[str, Any]] = []
    for name, (rows, way) in ALTERNATIVES.items():
        found = [_other(rows, way, case.readings.ordered(order), surface, push) for order in orders]
        error = max(exact.distance_to(point, truth.answer) for point in found)
        share = over_bar(error, bar(truth.change, exact.distance(truth.answer)))
        records.append({"name": case.name, "solver": _method(case), "method": name, "error": error, "error_over_bound": share})
    return records


def _other(rows: Rows, way: Way, readings: Readings, surface: Surface | None, push: FloatArray | None) -> FloatArray:
    point, root, offset = way(*rows(readings))
    if surface is None:
        return point
    return nearest_to_rows(surface, root[None], offset[None], push).points[0]


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
    rows = k[:, None, None] * across(u)
    return rows.reshape(-1, 3), np.einsum("nij,nj->ni", rows, np.cross(u, m)).ravel()


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Return the solution, NaN where the matrix is singular to the last bit."""
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=float)
    except np.linalg.LinAlgError:
        return np.full(3, np.nan)


def by_normal_equations(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve A'A p = A'b."""
    matrix, right = a.T @ a, a.T @ b
    values, axes = (np.asarray(part, dtype=float) for part in np.linalg.eigh(matrix))
    with np.errstate(divide="ignore"):
        inverse = np.where(values > np.finfo(float).eps * values[-1], 1.0 / np.sqrt(np.abs(values)), 0.0)
    root = np.where(inverse > 0, np.sqrt(np.abs(values)), 0.0)[:, None] * axes.T
    point = _solved(matrix, right)
    return point, root, inverse * (axes.T @ right)


def by_qr(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve by LAPACK's Householder QR, rows and columns as they come."""
    # Rows of noughts, so that the root of a single axis has three rows too.
    padded = np.concatenate([a, np.zeros((3, 3))])
    q, root = (np.asarray(part, dtype=float) for part in np.linalg.qr(padded))
    offset = q[: len(b)].T @ b
    point = _solved(root, offset)
    return point, root, offset


def by_svd(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve as `numpy.linalg.lstsq` does."""
    u, values, axes = (np.asarray(part, dtype=float) for part in np.linalg.svd(a, full_matrices=False))
    point = np.asarray(np.linalg.lstsq(a, b, rcond=None)[0], dtype=float)
    return point, values[:, None] * axes, u.T @ b


def by_sorted_qr(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve as the program does: rows sorted by size, columns pivoted."""
    factors = factor(a, b, np.array([0, len(b)]))
    return factors.solutions[0], factors.roots[0], factors.offsets[0]


ALTERNATIVES: dict[str, tuple[Rows, Way]] = {
    "normal equations": (two_rows, by_normal_equations),
    "QR, rows as they come": (two_rows, by_qr),
    "QR, three rows a contact, as they come": (three_rows, by_qr),
    "lstsq, three rows a contact": (three_rows, by_svd),
    "sorted and pivoted QR, three rows a contact": (three_rows, by_sorted_qr),
}


def summary(result: dict[str, Any]) -> list[str]:
    """Return how many cases hold, the worst of each solver, each miss, and how the other ways do."""
    cases = result["cases"]
    lines = [
        f"{result['held']} of {len(cases)} cases hold: error at most {FACTOR:g} times what the inputs' last digit does "
        f"({result['draws']} draws, {result['digits']} digits) plus {OF_SIZE:g} of the answer; the same bits in every order."
    ]
    for solver in SOLVERS:
        own = [one for one in cases if one["solver"] == solver]
        worst = max(own, key=lambda one: one["error_over_bound"])
        lines.append(f"{solver}: at worst {worst['error_over_bound']:.2g} of the bar ({worst['name']}), {len(own)} cases")
    lines += [
        f"MISSES: {one['name']} ({one['solver']}): error {one['error']:.2g}, bar {one['bound']:.2g}"
        + ("" if one["same_bits"] else "; the order of the contacts matters")
        for one in cases
        if not one["holds"]
    ]
    for whose, ways in (("", ALTERNATIVES), ("modules, ", BOARD_ALTERNATIVES)):
        of = [one for one in result["alternatives"] if (one["solver"] == "modules") == bool(whose)]
        lines += [whose + _of_alternative(method, [one for one in of if one["method"] == method]) for method in ways]
    return lines


def _of_alternative(method: str, own: list[dict[str, Any]]) -> str:
    misses = [one for one in own if one["error_over_bound"] > 1]
    worst = max(own, key=lambda one: one["error_over_bound"])
    far = "no number" if worst["error"] >= NO_NUMBER else f"{worst['error_over_bound']:.1g} times the bar"
    return f"{method}: misses {len(misses)} of {len(own)}, at worst {far} ({worst['name']})"


def draw(result: dict[str, Any], figure: Figure) -> None:
    """Draw each case's share of the bar, shipped and other ways, one panel a solver."""
    rows = max(sum(one["solver"] == solver for one in result["cases"]) for solver in SOLVERS)
    figure.set_size_inches(22.0, 2.0 + 0.19 * rows)
    for panel, solver in zip(figure.subplots(1, len(SOLVERS), squeeze=False)[0], SOLVERS, strict=True):
        _draw_solver(result, solver, panel)
    found = [panel.get_legend_handles_labels() for panel in figure.axes]
    marks = {label: handle for handles, labels in found for handle, label in zip(handles, labels, strict=True)}
    figure.legend(marks.values(), marks.keys(), loc="outside lower center", ncols=4)
    figure.suptitle(
        f"Error over the bar. Bar: {FACTOR:g} times what the inputs' last digit does ({result['draws']} draws, "
        f"{result['digits']} digits) + {OF_SIZE:g} of the answer. Right of the line digits are lost that the readings have."
    )


def _draw_solver(result: dict[str, Any], solver: str, panel: Axes) -> None:
    # Only now: the numbers need no drawing library.
    from skincal.studies.figure import BLACK, BLUE, GREEN, ORANGE, PINK, SKY, VERMILION

    cases = [one for one in result["cases"] if one["solver"] == solver]
    others = [one for one in result["alternatives"] if one["solver"] == solver]
    place = {one["name"]: -row for row, one in enumerate(cases)}
    numbers = [one["error_over_bound"] for one in cases + others if one["error_over_bound"] < NO_NUMBER]
    right = max(10.0, *numbers) * 3.0

    def put(records: list[dict[str, Any]], **look: Any) -> None:
        shares = [min(max(one["error_over_bound"], _FLOOR), right) for one in records]
        panel.scatter(shares, [place[one["name"]] for one in records], **look)

    looks = dict(zip(ALTERNATIVES, zip("xv^sD", (VERMILION, ORANGE, PINK, SKY, GREEN), strict=True), strict=True))
    looks |= dict(zip(BOARD_ALTERNATIVES, (("x", VERMILION), ("v", BLACK)), strict=True))
    for method in BOARD_ALTERNATIVES if solver == "modules" else ALTERNATIVES:
        mark, colour = looks[method]
        look = {"color": colour} if mark == "x" else {"facecolors": "none", "edgecolors": colour}
        put([one for one in others if one["method"] == method], s=22, marker=mark, label=method, linewidths=1.0, **look)
    put(cases, s=26, color=BLUE, label="shipped", zorder=3)
    panel.axvline(1.0, color=BLACK, linewidth=1.2)
    panel.set_xscale("log")
    panel.set_xlim(_FLOOR / 2, right * 2)
    panel.set_yticks(list(place.values()), list(place), fontsize=7.5)
    panel.set_ylim(-len(cases), 1)
    panel.grid(visible=True)
    panel.set_title(f"{solver}: {len(cases)} cases")
    panel.set_xlabel(f"error over the bar\n(least {_FLOOR:g}; no number at the right end)")
