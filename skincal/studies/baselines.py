"""Other solvers for the same equations, to compare the program's solvers with.

Free method: the paper's stacked system (5), three rows a contact, by `numpy.linalg.lstsq` for each taxel or by normal equations
for all taxels at once. Surface method (II-B): the best point over all triangles that face the pokes, by a closed form (brute
force), by the program's compiled solver without its search tree, and the paper's way, each triangle a constrained least squares
by quadprog or by scipy's SLSQP. Modules method: scipy's Levenberg-Marquardt.

Every baseline begins with the taxel's 3 x 3 factor instead of its hundreds of rows, and none computes an uncertainty. Both
favour the baseline. Each begins at a start of its own, never at the program's answer, so that its error can be measured.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module, util
from typing import Any, NamedTuple

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray, cross_matrix, move_wrench
from skincal.mesh.search import nearest_in_metric
from skincal.mesh.surface import Surface
from skincal.model.scene import NoiseSettings
from skincal.modules.pose import ModuleModel, ModulePoses, Pads
from skincal.modules.pose_fit import Touches, assign_pokes
from skincal.solver.tables import PUSHED_FACE_MIN_COSINE
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.solve import solve

SLSQP_OPTIONS: dict[str, Any] = {"method": "SLSQP", "bounds": ((0, 1), (0, 1)), "options": {"ftol": 1e-9, "maxiter": 100}}
"""The objective is in mm^2, so that SLSQP's absolute tolerance means 3e-5 mm where a metric is near 1."""
MM2_PER_M2 = 1e6
QUADPROG_PACKAGE = "quadprog"
"""Package under the GPL; no part of the program."""


# ---- surface ----


class TaxelProblem(NamedTuple):
    """One taxel on a surface: minimise |root p - offset| over the points p of triangles that face `push`."""

    root: FloatArray
    """(3, 3)."""
    offset: FloatArray
    """(3,)."""
    push: FloatArray
    """(3,), link frame."""


def taxel_problems(contacts: Sequence[Contact], channels: Iterable[int], noise: NoiseSettings) -> dict[int, TaxelProblem]:
    """Set up the problem of each of `channels` that answered: every baseline for the surface begins with it."""
    found = solve(ContactTable(contacts).evidence(list(channels)), [], noise, None)
    parts = zip(*(found.answer[name] for name in ("root", "offset", "push")), strict=True)
    return dict(zip(found.evidence.channels.tolist(), (TaxelProblem(*part) for part in parts), strict=True))


def facing_triangles(surface: Surface, push: FloatArray) -> IntArray:
    """List the triangles that `push` (3,) can act on."""
    return np.flatnonzero(surface.normals @ (push / np.linalg.norm(push)) < -PUSHED_FACE_MIN_COSINE)


def by_every_triangle(surface: Surface, problem: TaxelProblem) -> FloatArray:
    """Find the best point (3,) by the closed form of every triangle; NaN if no triangle faces the push."""
    shares, squared = closest_in_triangles(surface.corners @ problem.root.T - problem.offset)
    facing = facing_triangles(surface, problem.push)
    if not len(facing):
        return np.full(3, np.nan)
    best = facing[squared[facing].argmin()]
    return shares[best] @ surface.corners[best]


def by_compiled_triangles(surface: Surface, problem: TaxelProblem) -> FloatArray:
    """Find the same point by the program's compiled solver, every facing triangle tried."""
    root, offset, push = (part[None] for part in problem)
    return nearest_in_metric(surface, root, offset, push, every=True).points[0]


def by_quadratic_programmes(solver: Callable[[Programmes], FloatArray], surface: Surface, problem: TaxelProblem) -> FloatArray:
    """Find the best point (3,) as the paper does: `solver` runs on every facing triangle from its own start."""
    corners = surface.corners[facing_triangles(surface, problem.push)]
    if not len(corners):
        return np.full(3, np.nan)
    shares = solver(programmes(corners, problem.root, problem.offset))
    points = (np.column_stack([1.0 - shares.sum(axis=1), shares])[:, :, None] * corners).sum(axis=1)
    return points[np.linalg.norm(points @ problem.root.T - problem.offset, axis=1).argmin()]


class Programmes(NamedTuple):
    """n triangles as quadratic programmes of two shares x: minimise x'G x/2 + g'x, x >= 0, x_1 + x_2 <= 1; in mm^2."""

    grams: FloatArray
    """G, (n, 2, 2)."""
    slopes: FloatArray
    """g, (n, 2)."""


def programmes(corners: FloatArray, root: FloatArray, offset: FloatArray) -> Programmes:
    """Write triangles `corners` (n, 3, 3), metres, as quadratic programmes of one taxel."""
    images = corners @ root.T - offset
    edges = images[:, 1:] - images[:, :1]
    return Programmes(MM2_PER_M2 * edges @ edges.swapaxes(1, 2), MM2_PER_M2 * (edges @ images[:, 0, :, None])[:, :, 0])


_SIDE_NORMALS = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, -1.0]])
_SIDE_LIMITS = np.array([0.0, 0.0, -1.0])
_THIRD_SIDE_GRADIENT = np.array([-1.0, -1.0])
_THIRD_SIDE: dict[str, str | Callable[[FloatArray], Any]] = {
    "type": "ineq", "fun": lambda x: 1.0 - x[0] - x[1], "jac": lambda _: _THIRD_SIDE_GRADIENT,
}  # fmt: skip


def has_quadprog() -> bool:
    """Whether quadprog is installed."""
    return util.find_spec(QUADPROG_PACKAGE) is not None


def by_quadprog(some: Programmes) -> FloatArray:
    """Solve each programme by Goldfarb and Idnani's dual method; returns shares (n, 2)."""
    solver: Any = import_module(QUADPROG_PACKAGE)
    solved = [
        solver.solve_qp(gram, -slope, _SIDE_NORMALS, _SIDE_LIMITS)[0]
        for gram, slope in zip(some.grams, some.slopes, strict=True)
    ]
    return np.array(solved).reshape(-1, 2)


def by_slsqp(some: Programmes) -> FloatArray:
    """Solve each programme by sequential least squares from the triangle's middle, with gradients; returns shares (n, 2)."""
    optimize: Any = import_module("scipy.optimize")
    solved: list[FloatArray] = []
    for gram, slope in zip(some.grams, some.slopes, strict=True):

        def objective(x: FloatArray, gram: FloatArray = gram, slope: FloatArray = slope) -> tuple[float, FloatArray]:
            gradient = gram @ x
            return 0.5 * float(x @ gradient) + float(slope @ x), gradient + slope

        found = optimize.minimize(objective, (1 / 3, 1 / 3), jac=True, constraints=_THIRD_SIDE, **SLSQP_OPTIONS)
        solved.append(found.x)
    return np.array(solved).reshape(-1, 2)


def closest_in_triangles(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find for each triangle of `corners` (n, 3, 3) its point nearest to the origin: the interior one, or the best on an edge.

    Returns
    -------
    shares : (n, 3) float, barycentric: the point is `shares @ corners`
    squared : (n,) float, its squared distance
    """
    row = np.arange(len(corners))
    edges = np.roll(corners, -1, axis=1) - corners
    along = np.clip(-(corners * edges).sum(axis=2) / (edges * edges).sum(axis=2), 0.0, 1.0)
    squared = ((corners + along[:, :, None] * edges) ** 2).sum(axis=2)
    side = squared.argmin(axis=1)
    shares = np.zeros((len(corners), 3))
    shares[row, side], shares[row, (side + 1) % 3] = 1.0 - along[row, side], along[row, side]
    first, e, g = corners[:, 0], edges[:, 0], -edges[:, 2]
    ee, eg, gg, fe, fg = ((p * q).sum(axis=1) for p, q in ((e, e), (e, g), (g, g), (first, e), (first, g)))
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = np.array([eg * fg - gg * fe, eg * fe - ee * fg]) / (ee * gg - eg * eg)
    inside = (s > 0) & (t > 0) & (s + t < 1)
    shares[inside] = np.column_stack([1.0 - s - t, s, t])[inside]
    return shares, ((shares[:, :, None] * corners).sum(axis=1) ** 2).sum(axis=1)


# ---- free ----


class StackedRows(NamedTuple):
    """The paper's system (5) of each of t taxels, three rows an answer, one taxel after another.

    `a` (3n, 3) is k S(u), `b` (3n,) is -k m/|f|; taxel i has the rows starts[i] to starts[i + 1] of `starts` (t + 1,).
    """

    channels: list[int]
    a: FloatArray
    b: FloatArray
    starts: IntArray


def stack_rows(contacts: Sequence[Contact], channels: Iterable[int]) -> StackedRows:
    """Stack the system (5) of those of `channels` that answered, in the link frame (eq. 6)."""
    force, moment = move_wrench(
        np.array([contact.link_from_sensor for contact in contacts]),
        np.array([contact.force for contact in contacts]),
        np.array([contact.moment for contact in contacts]),
    )
    size = np.linalg.norm(force, axis=1, keepdims=True)
    u, right = force / size, -moment / size
    owner = np.repeat(np.arange(len(contacts)), [len(contact.channels) for contact in contacts])
    channel = np.concatenate([contact.channels for contact in contacts])
    k = np.concatenate([contact.responses / contact.responses.max() for contact in contacts])
    wanted = np.isin(channel, list(channels))
    owner, channel, k = owner[wanted], channel[wanted], k[wanted]
    order = np.argsort(channel, kind="stable")
    owner, channel, k = owner[order], channel[order], k[order]
    begins = np.flatnonzero(np.r_[True, channel[1:] != channel[:-1], True])
    a = k[:, None, None] * cross_matrix(u)[owner]
    return StackedRows(channel[begins[:-1]].tolist(), a.reshape(-1, 3), (k[:, None] * right[owner]).ravel(), 3 * begins)


def by_lstsq(rows: StackedRows) -> FloatArray:
    """Solve each taxel's rows by `numpy.linalg.lstsq`; returns positions (t, 3), metres."""
    ends = zip(rows.starts[:-1].tolist(), rows.starts[1:].tolist(), strict=True)
    solved = [np.linalg.lstsq(rows.a[first:last], rows.b[first:last])[0] for first, last in ends]
    return np.array(solved, dtype=float).reshape(-1, 3)


def by_normal_equations(rows: StackedRows) -> FloatArray:
    """Solve (A'A) p = A'b for all taxels at once; returns positions (t, 3), metres. NaN where A'A has no inverse."""
    products = rows.a[:, :, None] * np.concatenate([rows.a, rows.b[:, None]], axis=1)[:, None]
    sums = np.add.reduceat(products, rows.starts[:-1], axis=0)
    normal, right = sums[:, :, :3], sums[:, :, 3]
    positions = np.full(right.shape, np.nan)
    # numpy refuses all matrices where one of them has no inverse.
    invertible = np.abs(np.linalg.det(normal)) > 0
    positions[invertible] = np.linalg.solve(normal[invertible], right[invertible][:, :, None])[:, :, 0]
    return positions


# ---- modules ----


@dataclass(frozen=True, eq=False)
class ModuleProblem:
    """One module to be placed, with the start pose that the program uses."""

    model: ModuleModel
    module: int
    table: ContactTable
    start: ModulePoses
    noise: NoiseSettings

    @cached_property
    def touches(self) -> Touches:
        """Pokes of the module."""
        evidence = self.table.evidence(self.model.channels_of([self.module]))
        return assign_pokes(evidence, self.table.totals(evidence.pokes), self.model, self.noise, [self.module])

    def place_pads(self, pose: ModulePoses) -> Pads:
        """Compute the positions of the module's pads at one pose."""
        flat = self.model.pads[self.module]
        return self.model.ground.place_pads(pose.select(np.zeros(len(flat), dtype=np.int64)), flat)

    def by_least_squares(self, misses: Callable[[Pads], FloatArray], **tolerances: float) -> FloatArray:
        """Find the pads (k, 3), metres, of least `misses` by scipy's Levenberg-Marquardt with a differenced Jacobian."""
        optimize: Any = import_module("scipy.optimize")

        def displaced_pads(step: FloatArray) -> Pads:
            return self.place_pads(self.model.ground.move(self.start, step[None]))

        def residuals(step: FloatArray) -> FloatArray:
            return misses(displaced_pads(step)).ravel()

        found = optimize.least_squares(residuals, np.zeros(self.model.ground.unknowns), method="lm", **tolerances)
        return displaced_pads(np.asarray(found.x, dtype=np.float64)).points
