"""Other honest ways to the same answers, most in numpy, vectorised and in blocks that fit the cache.

For the free method: the paper's stacked system (5) as it stands, three rows a contact, by `numpy.linalg.lstsq` for each
taxel; and its normal equations, all taxels at once. For the surface method (II-B), where the answer is the best over all
triangles that face the pokes: every triangle by a closed form (brute force); only those that face the pokes, in numpy and
compiled; only those of them that a bound on their balls does not rule out; and the paper's way, each triangle a constrained
least squares, by quadprog and by scipy's SLSQP, only on the side that is pushed. All get the taxel's 3 x 3 factor, not its
hundreds of rows, and none computes an uncertainty. Both favour the alternative. For the modules method: scipy's general solver.

**The closed form** is the point of a triangle nearest to the origin. It holds for needles and for triangles without area, which
a metric that does not see one direction makes of good ones. The interior point comes from an orthogonalised pair of edges,
longest first (error: rounding times length over height, where the usual determinant formula squares the ratio); each edge's
point from a clamped projection. The best of the four is taken by its true distance, so a badly determined interior point can
never win wrongly. Every product is written out, component by component: a triangle's answer has the same bits whatever is
solved beside it, and arrays of one component each are what numpy goes through fastest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module, util
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray, cross_matrix, move_wrench
from skincal.mesh.search import GRAZING, nearest_to_rows
from skincal.mesh.surface import Surface
from skincal.model.scene import NoiseSettings
from skincal.modules.pose import ModuleModel, ModulePoses, Pads
from skincal.modules.pose_fit import Touches, find_touches
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.solve import solve

SLSQP: dict[str, Any] = {"method": "SLSQP", "bounds": ((0, 1), (0, 1)), "options": {"ftol": 1e-9, "maxiter": 100}}
"""mm^2: the objective is in mm^2, so that SLSQP's limit, which is absolute, means 3e-5 mm where a metric is near 1."""
_PER_M2 = 1e6
AT_ONCE = 1 << 11
"""Triangles solved at once: their intermediate numbers, 1 MB, stay in a core's cache. Measured: 1,000 and 16,000 are slower."""


class Systems(NamedTuple):
    """For each of t taxels |root p - offset|^2, roots (t, 3, 3) and offsets (t, 3), and from where it is pushed, (t, 3)."""

    channels: list[int]
    roots: FloatArray
    offsets: FloatArray
    pushes: FloatArray


def systems(contacts: Sequence[Contact], channels: Iterable[int], noise: NoiseSettings) -> Systems:
    """Return the systems of those of `channels` that answered: what every alternative for the surface begins with."""
    found = solve(ContactTable(contacts).evidence(list(channels)), [], noise, None)
    return Systems(found.evidence.channels.tolist(), found.factors.roots, found.factors.offsets, found.pushes)


def facing(surface: Surface, push: FloatArray) -> IntArray:
    """Return the triangles that `push` (3,) can act on."""
    return np.flatnonzero(surface.normals @ (push / np.linalg.norm(push)) < -GRAZING)


def every_triangle(surface: Surface, root: FloatArray, offset: FloatArray, push: FloatArray) -> FloatArray:
    """Return the best point, (3,), of every triangle by the closed form, among those that face the push."""
    faces = surface.normals @ (push / np.linalg.norm(push)) < -GRAZING
    return _best(surface, root, offset, np.arange(len(faces)), faces)


def facing_triangles(surface: Surface, root: FloatArray, offset: FloatArray, push: FloatArray) -> FloatArray:
    """Return the same; a triangle that does not face the push is not solved."""
    which = facing(surface, push)
    return _best(surface, root, offset, which, np.ones(len(which), dtype=bool))


def compiled_triangles(surface: Surface, root: FloatArray, offset: FloatArray, push: FloatArray) -> FloatArray:
    """Return the same, by the program's own compiled solver with nothing left out by bounds."""
    return nearest_to_rows(surface, root[None], offset[None], push[None], every=True).points[0]


def bounded_triangles(surface: Surface, root: FloatArray, offset: FloatArray, push: FloatArray) -> FloatArray:
    """Return the same; a triangle in a ball that lies too far off for it to be the best is not solved."""
    which = facing(surface, push)
    centres = root @ surface.centres[:, which] - offset[:, None]
    distance = np.sqrt(centres[0] ** 2 + centres[1] ** 2 + centres[2] ** 2)
    lower = distance - float(np.linalg.norm(root, 2)) * surface.radii[which]
    left = which[lower <= distance.min()]
    images = (surface.corners[left] @ root.T - offset).transpose(2, 1, 0)
    winner = int(left[closest_in_columns(np.ascontiguousarray(images))[0].argmin()])
    return _point(surface, root, offset, winner)


def _best(surface: Surface, root: FloatArray, offset: FloatArray, which: IntArray, counts: NDArray[np.bool_]) -> FloatArray:
    """Solve the triangles `which` (n,) and return the best point of those that count (n,)."""
    images = root @ surface.vertices.T - offset[:, None]
    least, winner = np.inf, -1
    for first in range(0, len(which), AT_ONCE):
        some = which[first : first + AT_ONCE]
        squared = closest_in_columns(images[:, surface.triangles[some].T])[0]
        squared[~counts[first : first + AT_ONCE]] = np.inf
        best = int(squared.argmin())
        if squared[best] < least:
            least, winner = float(squared[best]), int(some[best])
    return _point(surface, root, offset, winner)


def _point(surface: Surface, root: FloatArray, offset: FloatArray, triangle: int) -> FloatArray:
    corners = surface.corners[triangle]
    shares, _ = closest_in_triangles((corners @ root.T - offset)[None])
    return shares[0] @ corners


class Problems(NamedTuple):
    """Triangles as quadratic programmes of two shares x: minimise x'G x/2 + g'x, x >= 0, x_1 + x_2 <= 1; in mm^2.

    `grams` (n, 2, 2) are G, `slopes` (n, 2) g; `corners` (n, 3, 3), metres, those of the triangles themselves.
    """

    grams: FloatArray
    slopes: FloatArray
    corners: FloatArray

    def points(self, shares: FloatArray) -> FloatArray:
        """Return the points (n, 3) of `shares` (n, 2), metres."""
        whole = np.concatenate([1.0 - shares.sum(axis=1, keepdims=True), shares], axis=1)
        return (whole[:, :, None] * self.corners).sum(axis=1)


def problems(corners: FloatArray, roots: FloatArray, offsets: FloatArray) -> Problems:
    """Return the programmes of triangles `corners` (n, 3, 3), metres, each in its own metric (n, 3, 3) and (n, 3)."""
    images = corners @ roots.swapaxes(1, 2) - offsets[:, None]
    along = images[:, 1:] - images[:, :1]
    grams = _PER_M2 * along @ along.swapaxes(1, 2)
    return Problems(grams, _PER_M2 * (along @ images[:, 0, :, None])[:, :, 0], corners)


_SIDES = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, -1.0]])
_LIMITS = np.array([0.0, 0.0, -1.0])
_INWARD = np.array([-1.0, -1.0])
_THIRD_SIDE: dict[str, str | Callable[[FloatArray], Any]] = {
    "type": "ineq", "fun": lambda x: 1.0 - x[0] - x[1], "jac": lambda _: _INWARD,
}  # fmt: skip
_QUADPROG = "quadprog"


def has_quadprog() -> bool:
    """Whether quadprog is installed; it is no part of the program."""
    return util.find_spec(_QUADPROG) is not None


def by_quadprog(some: Problems) -> FloatArray:
    """Solve each programme by Goldfarb and Idnani's dual method; returns shares (n, 2)."""
    solver: Any = import_module(_QUADPROG)
    solved = [solver.solve_qp(gram, -slope, _SIDES, _LIMITS)[0] for gram, slope in zip(some.grams, some.slopes, strict=True)]
    return np.array(solved).reshape(-1, 2)


def by_slsqp(some: Problems) -> FloatArray:
    """Solve each programme by sequential least squares from the triangle's middle, gradients given; returns shares (n, 2)."""
    optimize: Any = import_module("scipy.optimize")
    solved: list[FloatArray] = []
    for gram, slope in zip(some.grams, some.slopes, strict=True):

        def objective(x: FloatArray, gram: FloatArray = gram, slope: FloatArray = slope) -> tuple[float, FloatArray]:
            pull = gram @ x
            return 0.5 * float(x @ pull) + float(slope @ x), pull + slope

        found = optimize.minimize(objective, (1 / 3, 1 / 3), jac=True, constraints=_THIRD_SIDE, **SLSQP)
        solved.append(found.x)
    return np.array(solved).reshape(-1, 2)


class Stacked(NamedTuple):
    """The paper's system (5) of each of t taxels, three rows an answer, one taxel after another.

    `a` (3n, 3) is k S(u), `b` (3n,) is -k m/|f|; taxel i has the rows starts[i] to starts[i + 1] of `starts` (t + 1,).
    """

    channels: list[int]
    a: FloatArray
    b: FloatArray
    starts: IntArray


def stacked(contacts: Sequence[Contact], channels: Iterable[int]) -> Stacked:
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
    return Stacked(channel[begins[:-1]].tolist(), a.reshape(-1, 3), (k[:, None] * right[owner]).ravel(), 3 * begins)


def by_lstsq(rows: Stacked) -> FloatArray:
    """Solve each taxel's rows by `numpy.linalg.lstsq`; returns positions (t, 3), metres."""
    ends = zip(rows.starts[:-1].tolist(), rows.starts[1:].tolist(), strict=True)
    solved = [np.linalg.lstsq(rows.a[first:last], rows.b[first:last])[0] for first, last in ends]
    return np.array(solved, dtype=float).reshape(-1, 3)


def by_normal_equations(rows: Stacked) -> FloatArray:
    """Solve (A'A) p = A'b for all taxels at once; returns positions (t, 3), metres. NaN where A'A has no inverse."""
    products = rows.a[:, :, None] * np.concatenate([rows.a, rows.b[:, None]], axis=1)[:, None]
    sums = np.add.reduceat(products, rows.starts[:-1], axis=0)
    normal, right = sums[:, :, :3], sums[:, :, 3]
    positions = np.full(right.shape, np.nan)
    # One axis alone, and no solve: numpy would refuse the lot.
    sure = np.abs(np.linalg.det(normal)) > 0
    positions[sure] = np.linalg.solve(normal[sure], right[sure][:, :, None])[:, :, 0]
    return positions


@dataclass(frozen=True, eq=False)
class ModuleProblem:
    """One module to be placed, from what the program begins with."""

    model: ModuleModel
    module: int
    table: ContactTable
    start: ModulePoses
    noise: NoiseSettings

    @cached_property
    def touches(self) -> Touches:
        """Its pokes."""
        evidence = self.table.evidence(self.model.channels_of([self.module]))
        return find_touches(evidence, self.table.totals(evidence.pokes), self.model, self.noise, [self.module])

    def laid(self, pose: ModulePoses) -> Pads:
        """Return where its pads lie at one pose."""
        flat = self.model.pads[self.module]
        return self.model.ground.laid(pose.take(np.zeros(len(flat), dtype=np.int64)), flat)

    def by_least_squares(self, misses: Callable[[Pads], FloatArray], **settings: float) -> FloatArray:
        """Return the pads (k, 3), metres, of least `misses`, by scipy's Levenberg-Marquardt with its differenced Jacobian."""
        optimize: Any = import_module("scipy.optimize")

        def reached(move: FloatArray) -> Pads:
            return self.laid(self.model.ground.moved(self.start, move[None]))

        def off(move: FloatArray) -> FloatArray:
            return misses(reached(move)).ravel()

        found = optimize.least_squares(off, np.zeros(self.model.ground.unknowns), method="lm", **settings)
        return reached(np.asarray(found.x, dtype=np.float64)).points


# ---- the closed form ----

_ZERO = 1e-300
"""A squared length below this counts as zero, as does whatever is divided by it."""


def closest_in_triangles(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find for each triangle of `corners` (n, 3, 3) its point nearest to the origin.

    Returns
    -------
    shares : (n, 3) float, barycentric: the point is `shares @ corners`
    squared : (n,) float, its squared distance
    """
    squared, within, side, along, longest, u, v = closest_in_columns(np.ascontiguousarray(corners.transpose(2, 1, 0)))
    inside = within <= squared
    first, u, v = np.where(inside, longest, side), np.where(inside, u, along), np.where(inside, v, 0.0)
    shares, row = np.empty((len(u), 3)), np.arange(len(u))
    shares[row, first], shares[row, _AFTER[first]], shares[row, _BEFORE[first]] = 1.0 - u - v, u, v
    return shares, squared


_AFTER = np.array([1, 2, 0])
_BEFORE = np.array([2, 0, 1])


def closest_in_columns(
    corners: FloatArray,
) -> tuple[FloatArray, FloatArray, IntArray, FloatArray, IntArray, FloatArray, FloatArray]:
    """Find the nearest points of triangles `corners` (3, 3, n): component, corner, triangle.

    Returns
    -------
    squared distance (n,); that of the plane's nearest point, infinite where it is outside; the side, from corner s to corner
    (s + 1) mod 3, with the outline's nearest point, and where on it, 0 to 1; the longest side, and from it the shares u, v of
    the plane's nearest point
    """
    count = int(corners.shape[2])
    column = np.arange(count)
    edges = np.empty_like(corners)
    np.subtract(corners[:, 1:], corners[:, :2], out=edges[:, :2])
    np.subtract(corners[:, 0], corners[:, 2], out=edges[:, 2])
    lengths = _dot(edges, edges)
    starts = -_dot(corners, edges)
    starts /= lengths.clip(_ZERO)
    along = starts.clip(0.0, 1.0)
    on_edges = edges * along
    on_edges += corners
    squared = _dot(on_edges, on_edges)
    longest = _second_or_third(lengths[1] > lengths[0], lengths[2] > np.maximum(lengths[0], lengths[1]))
    best = np.minimum(squared[0], squared[1])
    side = _second_or_third(squared[1] < squared[0], squared[2] < best)
    np.minimum(best, squared[2], out=best)
    at = longest * count + column
    flat = corners.reshape(3, -1), edges.reshape(3, -1)
    u, v, within = _interior(
        flat[0].take(at, axis=1, mode="clip"),
        flat[1].take(at, axis=1, mode="clip"),
        -flat[1].take(_BEFORE[longest] * count + column, axis=1, mode="clip"),
        lengths.ravel().take(at, mode="clip"),
        starts.ravel().take(at, mode="clip"),
    )
    along = along.ravel().take(side * count + column, mode="clip")
    return np.minimum(best, within), within, side, along, longest, u, v


def _second_or_third(second: NDArray[np.bool_], third: NDArray[np.bool_]) -> IntArray:
    """Return 2 where `third`, else 1 where `second`, else 0."""
    return np.maximum(second.view(np.int8), third.view(np.int8) * np.int8(2)).astype(np.intp)


def _dot(p: FloatArray, q: FloatArray) -> FloatArray:
    sums = p[0] * q[0]
    sums += p[1] * q[1]
    sums += p[2] * q[2]
    return sums


def _interior(
    a: FloatArray, along: FloatArray, across: FloatArray, length: FloatArray, start: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the shares u, v (n,) of the plane's nearest point and its squared distance; infinite where it is outside.

    Parameters
    ----------
    a : (3, n) float: the corner from which the longest side leaves
    along, across : (3, n) float: the sides that leave it, the longest first
    length, start : (n,) float: the longest side's squared length, and where on it its line is nearest
    """
    length = length.clip(_ZERO)
    tilt = _dot(across, along)
    tilt /= length
    across -= tilt * along
    # Once more, since the first pass leaves rounding of the long edge's size.
    again = _dot(across, along)
    again /= length
    across -= again * along
    tilt += again
    height = _dot(across, across)
    aside = start * along
    aside += a
    v = -_dot(aside, across)
    v /= height.clip(_ZERO)
    u = start - v * tilt
    across *= v
    across += aside
    within = _dot(across, across)
    outside = (u < 0) | (v < 0) | (u + v > 1) | (height <= 0)
    within[outside] = np.inf
    return u, v, within
