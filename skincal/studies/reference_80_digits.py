"""Reference answers of the stability study in 80 digits, from the numbers that the solvers get.

**A taxel.** A contact's wrench (f, m), in the link frame by eq. (6), gives the three rows of (5), k S(u) p = -k m/|f| with
u = f/|f|. Their normal equations need no root, since k/|f| enters squared:

    N = sum w S(f)'S(f),  h = sum w f x m,  w = k^2/|f|^2,  |rows p - right|^2 = p'N p - 2 h'p + c.

Squaring costs half of the digits. Enough are left: angles of 1e-9 rad and weights of 1e-12 together take 42.

**A module.** A poke is a line along u through a = u x m/|f|. It passes the middle c of the answering pads by E (a - c), with E
any two orthonormal directions across u. By the definition in `pose_fit.py` this has the covariance
D = E N E' + s^2 (I - o o'), o = E n. For each e of E, E (c - a) is v.rho with v = u x e and rho = u x (c - a), so

    D_ij = v_i' ((sm/|f|)^2 I + (sf/|f|)^2 S(l) S(l)') v_j + s^2 (e_i.e_j - (e_i.n) (e_j.n)),   l = c - the sensor's origin.

The pose is the one with g = sum (E dc/dp)' D^-1 E (a - c) = 0, D as it is there. Newton's method finds it from the true pose,
with differences of g in 80 digits as its matrix. A perturbed answer is one such step from the exact pose (error 1e-16 of it).

Nothing is taken from the solvers except the definition of a poke's weight. mpmath computes on numpy's arrays of its numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.model.scene import NoiseSettings
from skincal.modules.pose_fit import CONTACT_TO_PAD_CENTRE_SD_FACTOR, EXTRA_SD_IF_TWO_MODULES_ANSWER_M
from skincal.solver.tables import PUSHED_FACE_MIN_COSINE
from skincal.studies.stability_cases import Case, ModuleCase, RawMesh, Readings, perturbed
from skincal.taxels.result import FORCE_AXIS_MAX_MISS_M, POSITION_MAX_SD_M

PRECISION_DIGITS = 80
_mpmath: Any = import_module("mpmath")
MP: Any = _mpmath.mp.clone()
"""Arithmetic with its own precision."""
MP.dps = PRECISION_DIGITS
ERROR_OF_FAILED_SOLVER_M = 1e300
"""Error of a solver that gave no number: JSON has no infinity."""
Exact: TypeAlias = Any
"""An array of numbers of `MP`; numpy has no type for it."""
_np: Any = np
"""numpy on such arrays."""
_number: Any = _np.frompyfunc(MP.convert, 1, 1)


def to_mp(values: Any) -> Exact:
    """Convert floats without rounding."""
    return _number(np.asarray(values, dtype=float))


def to_float(numbers: Any) -> FloatArray:
    """Round exact numbers to floats."""
    return np.asarray(numbers).astype(float)


def cross(p: Exact, q: Exact) -> Exact:
    """Return p x q along the last axis."""
    return p[..., [1, 2, 0]] * q[..., [2, 0, 1]] - p[..., [2, 0, 1]] * q[..., [1, 2, 0]]


def dot(p: Exact, q: Exact) -> Any:
    """Return p . q along the last axis."""
    return (p * q).sum(axis=-1)


def unit(v: Exact) -> Exact:
    """Scale `v` (..., 3) to length 1."""
    return v / np.sqrt((v * v).sum(axis=-1, keepdims=True))


def _sinc(angle: Any) -> Any:
    return MP.sin(angle) / angle if angle else MP.one


_sincs: Any = _np.frompyfunc(_sinc, 1, 1)


def rotate(v: Exact, by: Exact) -> Exact:
    """Rotate `v` (..., 3) about `by` (..., 3) by its length, rad: v + sinc b x v + (1 - cos)/b^2 b x (b x v)."""
    angle = np.sqrt((by * by).sum(axis=-1, keepdims=True))
    once = cross(by, v)
    return v + _sincs(angle) * once + _sincs(angle / 2) ** 2 / 2 * cross(by, once)


def product(rows: Exact, matrix: Exact) -> Exact:
    """Return rows (..., k) times a matrix (k, n). Each number is rounded once, which takes a third of the time of `@`."""
    columns = matrix.T.tolist()
    found = [[MP.fdot(row, column) for column in columns] for row in rows.reshape(-1, len(matrix)).tolist()]
    return _np.array(found, dtype=object).reshape(*rows.shape[:-1], len(columns))


def distance(p: Exact, q: Any = 0) -> float:
    """Return |p - q|; without `q` the length of p."""
    return float(MP.sqrt(dot(p - q, p - q)))


def error_of(found: FloatArray, answer: Exact) -> float:
    """Return |found - answer|, or `ERROR_OF_FAILED_SOLVER_M` if a solver gave no finite numbers."""
    return distance(to_mp(found), answer) if np.isfinite(found).all() else ERROR_OF_FAILED_SOLVER_M


def solve_positive(matrix: Exact, right: Exact) -> tuple[Exact, Any]:
    """Solve equations with a symmetric positive matrix, in exact numbers or floats. Also return its log determinant."""
    if matrix.dtype == float:
        return _np.linalg.solve(matrix, right), _np.linalg.slogdet(matrix)[1]
    # Rows of L and columns of U, by dot products as in `product`. Both halves of the matrix count.
    lower, upper, rows = list[list[Any]](), list[list[Any]](), _np.asarray(matrix).tolist()
    for k, row in enumerate(rows):
        lower.append([])
        for number, column in zip(row, upper, strict=False):
            lower[k].append((number - MP.fdot(lower[k], column)) / column[-1])
        upper.append([])
        for each, own in zip(rows, lower, strict=False):
            upper[k].append(each[k] - MP.fdot(own, upper[k]))
    after = [[column[k] for column in upper[k + 1 :]] for k in range(len(rows))]
    solved = list[list[Any]]()
    for column in _np.reshape(right, (len(rows), -1)).T.tolist():
        found = list[Any]()
        for number, own in zip(column, lower, strict=True):
            found.append(number - MP.fdot(own, found))
        for k in reversed(range(len(rows))):
            found[k] = (found[k] - MP.fdot(after[k], found[k + 1 :])) / upper[k][k]
        solved.append(found)
    log = sum((MP.log(column[-1]) for column in upper), MP.zero)
    return _np.array(solved, dtype=object).T.reshape(np.shape(right)), log


def inverse(matrix: Exact) -> Exact:
    """Invert a symmetric positive matrix."""
    return solve_positive(matrix, to_mp(np.eye(len(matrix))))[0]


RANK_MIN = MP.mpf("1e-26")
"""Share of the largest singular value below which differences leave only noise."""


def pseudo_inverse(matrix: Exact) -> Exact:
    """Invert a matrix of any rank by singular values. What equations do not determine is zero in their solution."""
    u, values, v = (np.array(part.tolist(), dtype=object) for part in MP.svd_r(MP.matrix(matrix.tolist())))
    known = np.flatnonzero(values[:, 0] > RANK_MIN * values[0, 0])
    return (v[known].T / values[known, 0]) @ u[:, known].T


# ---- a taxel ----


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Exact positions, and their sensitivity to the last digits of the inputs."""

    points: Exact
    """(k, 3) of a taxel, or of a module's k pads. The second one of a blind taxel is its blind direction."""
    sensitivity_m: tuple[float, ...]
    """Largest change of each in the perturbations."""
    observable: tuple[bool, ...]
    """Whether the position is defined by the contacts. Undefined positions are not compared."""
    must_be_blind: tuple[bool, ...]
    """Pads known worse than `POSITION_MAX_SD_M`, or missed by the axes by more than `FORCE_AXIS_MAX_MISS_M`."""


class NormalEquations(NamedTuple):
    """N (3, 3), h (3,) and c of one taxel."""

    n: Exact
    h: Exact
    c: Any


def find_truth(case: Case, draws: int, rng: np.random.Generator) -> Truth:
    """Find the exact answer of a case, and its largest change over `draws` perturbations of the inputs' last digits."""
    if isinstance(case, ModuleCase):
        return _module_truth(case, draws, rng)
    triangles = None if case.mesh is None else _candidates(case.readings, case.mesh)

    def answer(case: Case) -> Exact:
        equations = normal_equations(case.readings)
        if case.mesh is not None:
            return best(equations, to_mp(case.mesh.vertices[triangles]))[None]
        return np.stack(solve_blind(equations)) if case.blind else solve_positive(equations.n, equations.h)[0][None]

    here, changes = answer(case), [[0.0] * (2 if case.blind else 1)]
    for _ in range(draws):
        there = answer(perturbed(case, rng))
        if case.blind and dot(here[1], there[1]) < 0:
            there[1] = -there[1]
        changes.append([distance(p, q) for p, q in zip(here, there, strict=True)])
    count = len(here)
    return Truth(here, tuple(np.max(changes, axis=0).tolist()), (True,) * count, (False,) * count)


def normal_equations(readings: Readings) -> NormalEquations:
    """Sum the normal equations of (5), all three rows of every contact."""
    f, m = link_wrenches(readings)
    squares, k = dot(f, f), _weights(readings)
    w = k * k / squares
    # S(f)'S(f) = |f|^2 I - f f'.
    return NormalEquations(_np.diag([dot(w, squares)] * 3) - (w[:, None] * f).T @ f, w @ cross(f, m), dot(w, dot(m, m)))


def link_wrenches(readings: Readings) -> tuple[Exact, Exact]:
    """Return f and m (n, 3) in the link frame: f_w = R f_s and m_w = R m_s + t x f_w with p_w = R p_s + t, eq. (6)."""
    f, m = to_mp(readings.forces), to_mp(readings.moments)
    for number, pose in enumerate(readings.poses):
        own = readings.pose_of == number
        if not np.array_equal(pose, np.eye(4)):
            turn, shift = to_mp(pose[:3, :3]), to_mp(pose[:3, 3])
            f[own] = f[own] @ turn.T
            m[own] = m[own] @ turn.T + cross(shift, f[own])
    return f, m


def _weights(readings: Readings) -> Exact:
    return to_mp(readings.responses) / to_mp(readings.strongest)


def mean_push(readings: Readings) -> Exact:
    """Return the sum of k u, which has the direction of the mean push."""
    return _weights(readings) @ unit(link_wrenches(readings)[0])


def solve_blind(equations: NormalEquations) -> tuple[Exact, Exact]:
    """Solve for axes that are parallel to the last digit: the p of smallest norm, and the blind direction, unit.

    The direction is the eigenvector of N with the smallest eigenvalue; p minimises the sum of squares across it.
    """
    values, columns = MP.eigsy(MP.matrix(equations.n.tolist()))
    axes = np.array(columns.T.tolist(), dtype=object)
    return sum(axis * (dot(axis, equations.h) / value) for axis, value in zip(axes[1:], values[1:], strict=True)), axes[0]


def nearest(equations: NormalEquations, corners: Exact) -> tuple[Exact, Exact]:
    """Minimise the sum of squares over each triangle of `corners` (t, 3, 3): the least values (t,), and their points (t, 3).

    In shares (s, t) of two sides e and g the sum is convex: a stationary point inside is the minimum; else it lies on the rim.
    """
    corner = corners[:, 0]
    e, g = corners[:, 1] - corner, corners[:, 2] - corner
    ne, slope = e @ equations.n, corner @ equations.n - equations.h
    ee, eg, gg, e0, g0 = dot(e, ne), dot(g, ne), dot(g, g @ equations.n), dot(e, slope), dot(g, slope)
    determinant = ee * gg - eg * eg
    flat = _np.where(determinant > 0, determinant, MP.one)
    s, t = (eg * g0 - gg * e0) / flat, (eg * e0 - ee * g0) / flat
    inside = (determinant > 0) & (s >= 0) & (t >= 0) & (s + t <= 1)
    none, across = _np.full(len(corners), MP.zero), _clamped(ee - eg + e0 - g0, ee - 2 * eg + gg)
    tries = [(_clamped(-e0, ee), none), (none, _clamped(-g0, gg)), (1 - across, across),
             (_np.where(inside, s, none), _np.where(inside, t, none))]  # fmt: skip
    values = np.array([ee * a * a + gg * b * b + 2 * (eg * a * b + e0 * a + g0 * b) for a, b in tries], dtype=object)
    winner, row = values.argmin(axis=0), np.arange(len(corners))
    s, t = (np.array(shares, dtype=object)[winner, row] for shares in zip(*tries, strict=True))
    return values[winner, row] + dot(corner, slope - equations.h) + equations.c, corner + s[:, None] * e + t[:, None] * g


def _clamped(slope: Exact, curvature: Exact) -> Exact:
    """Minimise a parabola along a triangle's side; return the share of the side, 0 to 1."""
    bent = curvature > 0
    return _np.where(bent, _np.clip(slope / _np.where(bent, curvature, MP.one), MP.zero, MP.one), MP.zero)


def best(equations: NormalEquations, corners: Exact) -> Exact:
    """Return the point (3,) with the smallest sum of squares on any of `corners` (t, 3, 3)."""
    values, points = nearest(equations, corners)
    return points[values.argmin()]


ROUNDING_OF_ROWS = 64 * float(np.finfo(float).eps)
"""Largest change of the root of a sum of squares in a perturbation, over the reach: about ten roundings a row."""


def _candidates(readings: Readings, mesh: RawMesh) -> IntArray:
    """Select the triangles (t, 3) that face the push and can be the best one in a perturbation."""
    push, corners = mean_push(readings), to_mp(mesh.corners)
    normals = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # As the program defines it: push . normal < -`PUSHED_FACE_MIN_COSINE`, both unit. A triangle without area is not pushed.
    facing = np.flatnonzero(normals @ push < -PUSHED_FACE_MIN_COSINE * np.sqrt(dot(normals, normals) * dot(push, push)))
    roots = np.sqrt(np.maximum(nearest(normal_equations(readings), corners[facing])[0], MP.zero))
    levers = np.linalg.norm(readings.moments, axis=1) / np.linalg.norm(readings.forces, axis=1)
    reach = float(np.abs(mesh.vertices).max() + np.abs(readings.poses[:, :3, 3]).max() + levers.max())
    weight = float(np.linalg.norm(readings.responses / readings.strongest))
    return mesh.triangles[facing[roots <= roots.min() + 2 * ROUNDING_OF_ROWS * reach * weight]]


# ---- positions of a module's pads ----


class ExactPads(NamedTuple):
    """Positions of k pads (k, 3), their change with each unknown (k, 3, d), and the normals there (k, 3)."""

    points: Exact
    changes: Exact
    normals: Exact


@dataclass(frozen=True, slots=True, eq=False)
class InPlane:
    """A flat module with pads (k, 2) in space: a shift and a turn about its origin."""

    origin: Exact
    x: Exact
    normal: Exact
    flat: Exact

    def pads(self) -> ExactPads:
        """Lay the pads flat: dP = dt + w x arm."""
        arms = self.flat @ np.stack([self.x, cross(self.normal, self.x)])
        axes = to_mp(np.eye(3))
        turned = cross(axes, arms[:, None]).swapaxes(1, 2)
        changes = np.concatenate([np.broadcast_to(axes, turned.shape), turned], axis=2)
        return ExactPads(self.origin + arms, changes, np.broadcast_to(self.normal, arms.shape))

    def displaced(self, step: Exact) -> InPlane:
        """Shift, and turn by the quaternion 1, w/2. Newton's method needs no exact turn, only its end counts."""
        q = step[3:] / 2
        # v + 2 (q x v + q x (q x v))/(1 + q.q)
        x, normal = (v + (cross(q, v) + cross(q, cross(q, v))) * 2 / (1 + dot(q, q)) for v in (self.x, self.normal))
        return replace(self, origin=self.origin + step[:3], x=x, normal=normal)


class ExactMesh:
    """A mesh to walk on. Triangles are computed when they are reached."""

    def __init__(self, mesh: RawMesh) -> None:
        self.mesh = mesh
        around = enumerate(mesh.triangles.tolist())
        self._triangle_of = {(corners[i], corners[(i + 1) % 3]): at for at, corners in around for i in range(3)}
        self._known: dict[int, tuple[Exact, Exact, Exact]] = {}

    def triangle(self, at: int) -> tuple[Exact, Exact, Exact]:
        """Return a triangle's corners, its normal, and of each side a vector out of it in its plane, as long as the side."""
        if at not in self._known:
            corners = to_mp(self.mesh.vertices[self.mesh.triangles[at]])
            normal = unit(cross(corners[1] - corners[0], corners[2] - corners[0]))
            self._known[at] = corners, normal, cross(corners[[1, 2, 0]] - corners, normal)
        return self._known[at]

    def across(self, at: int, side: int) -> tuple[int, int] | None:
        """Return the triangle behind a side and that side's number there; `None` at the rim."""
        corners: list[int] = self.mesh.triangles[at].tolist()
        there = self._triangle_of.get((corners[(side + 1) % 3], corners[side]))
        return None if there is None else (there, self.mesh.triangles[there].tolist().index(corners[(side + 1) % 3]))


MAX_EDGE_CROSSINGS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class OnMesh:
    """A module with pads (k, 2) on a mesh: a point of it, and a turn in its plane.

    A way to a pad is straight: at an edge its direction keeps its share along the edge, and its share across is carried into
    the other triangle's plane. Past the rim it goes on in the last triangle's plane.
    """

    mesh: ExactMesh
    at: int
    origin: Exact
    x: Exact
    flat: Exact

    @classmethod
    def project(cls, mesh: RawMesh, at: int, origin: Exact, x: Exact, flat: FloatArray) -> OnMesh:
        """Make a pose, projected into the plane of triangle `at`."""
        exact = ExactMesh(mesh)
        corners, normal, _ = exact.triangle(at)
        return cls(exact, at, corners[0] + _without(origin - corners[0], normal), unit(_without(x, normal)), to_mp(flat))

    def pads(self) -> ExactPads:
        """Lay the pads: dP = da x + db y + dtheta (bx y - by x), with x, y as carried there."""
        ends = [self._walk(way) for way in self.flat]
        normals = np.array([self.mesh.triangle(at)[1] for at, _, _ in ends])
        points, x = (np.array(part) for part in list(zip(*ends, strict=True))[1:])
        y = cross(normals, x)
        return ExactPads(points, np.stack([x, y, self.flat[:, :1] * y - self.flat[:, 1:] * x], axis=2), normals)

    def displaced(self, step: Exact) -> OnMesh:
        """Walk, and turn by the angle whose tangent is the last unknown."""
        at, point, x = self._walk(step[:2])
        return replace(self, at=at, origin=point, x=unit(x + cross(self.mesh.triangle(at)[1], x) * step[2]))

    def _walk(self, way: Exact) -> tuple[int, Exact, Exact]:
        """Return triangle, point and carried x at the end of a way."""
        at, point, x, came = self.at, self.origin, self.x, -1
        left = MP.sqrt(dot(way, way))
        if not left:
            return at, point, x
        ahead = (x * way[0] + cross(self.mesh.triangle(at)[1], x) * way[1]) / left
        for _ in range(MAX_EDGE_CROSSINGS):
            corners, _, out = self.mesh.triangle(at)
            rates, room = out @ ahead, dot(out, corners - point)
            far, side = min((room[i] / rates[i], i) for i in range(3) if i != came and rates[i] > 0)
            over = self.mesh.across(at, side)
            if far >= left or over is None:
                return at, point + ahead * left, x
            point, left = point + ahead * far, left - far
            edge = corners[(side + 1) % 3] - corners[side]
            inward = -self.mesh.triangle(over[0])[2][over[1]]
            both = np.stack([ahead, x])
            ahead, x = ((both @ edge)[:, None] * edge + (both @ out[side])[:, None] * inward) / dot(edge, edge)
            at, came = over
        raise ArithmeticError("A way over the mesh goes round in circles.")


def _without(v: Exact, normal: Exact) -> Exact:
    return v - normal * dot(v, normal)


ExactPose: TypeAlias = InPlane | OnMesh
"""A module's pose in space or on a mesh."""


def pose_at(pose: Any, flat: FloatArray, mesh: RawMesh | None) -> ExactPose:
    """Make an exact pose from a pose of one module (`ModulePoses`)."""
    origin, x, normal = (to_mp(part[0]) for part in (pose.points, pose.x, pose.normals))
    if mesh is not None:
        return OnMesh.project(mesh, int(pose.triangles[0]), origin, x, flat)
    normal = unit(normal)
    return InPlane(origin, unit(_without(x, normal)), normal, to_mp(flat))


def true_pose(case: ModuleCase) -> ExactPose:
    """Return the pose from which the pokes of a case were simulated."""
    return pose_at(case.module.at, case.module.flat, case.module.mesh)


# ---- a module ----

DIFFERENCE_STEP = MP.mpf("1e-30")
"""50 digits of a derivative are left."""
REGULARISATION_SHARE = MP.mpf("1e-32")
"""Share of the largest information added to all, so that undetermined unknowns have a variance: an immense one."""
STEP_CONVERGED_M = MP.mpf("1e-34")
"""A step below it leaves 1e-60."""
STEP_JACOBIAN_OK_M = MP.mpf("1e-6")
"""From there on the matrix is exact enough: each step gains six digits."""
STEP_MAX = MP.mpf("0.02")
"""m or rad."""
MAX_NEWTON_STEPS = 60
DETERMINED_PAD_MAX_SD_M = 1e5
"""A pad known worse than this is not determined at all."""


class ExactPokes(NamedTuple):
    """Measurements of n pokes, independent of the module's pose.

    `answered` (n, m) are the pads that answered, `shares` (n, m) of the middle; missing ones are the first pad with share zero.
    `pairs` (n, 2, 3) are two orthonormal directions across u. `moment` and `offset` (n,) are (sm/|f|)^2 and s^2 in m^2; `force`
    (n,) is (sf/|f|)^2.
    """

    answered: IntArray
    shares: Exact
    u: Exact
    a: Exact
    pairs: Exact
    sensor: Exact
    moment: Exact
    force: Exact
    offset: Exact

    def contact_centres(self, pads: ExactPads) -> tuple[Exact, Exact, Exact]:
        """Return the middles of the pads that answered, their change with each unknown (n, 3, d), and the normals there."""
        points = (self.shares[:, :, None] * pads.points[self.answered]).sum(axis=1)
        normals = (self.shares[:, :, None] * pads.normals[self.answered]).sum(axis=1)
        changes = (self.shares[:, :, None, None] * pads.changes[self.answered]).sum(axis=1)
        return points, changes, unit(normals)


def pokes_of(readings: Readings, noise: NoiseSettings) -> ExactPokes:
    """Convert readings of a module."""
    f, m = link_wrenches(readings)
    size = np.sqrt(dot(f, f))
    u = f / size[:, None]
    answering = readings.responses > 0
    # The pads that answered first, in their order.
    answered = np.argsort(~answering, axis=1, kind="stable")[:, : answering.sum(axis=1).max()]
    answers = to_mp(np.take_along_axis(readings.responses, answered, axis=1))
    missed = (to_mp(CONTACT_TO_PAD_CENTRE_SD_FACTOR) * to_mp(noise.contact)) / to_mp(answering.sum(axis=1))
    other = _np.where(readings.other_response > 0, to_mp(EXTRA_SD_IF_TWO_MODULES_ANSWER_M), MP.zero)
    return ExactPokes(
        answered, answers / answers.sum(axis=1, keepdims=True), u, cross(u, m) / size[:, None], two_across(u),
        to_mp(readings.poses[readings.pose_of, :3, 3]), (to_mp(noise.moment) / size) ** 2,
        (to_mp(noise.force) / size) ** 2, missed**2 + other**2,
    )  # fmt: skip


def two_across(u: Exact) -> Exact:
    """Return two orthonormal directions (n, 2, 3) across u (n, 3)."""
    first = unit(cross(u, to_mp(np.eye(3))[abs(u).argmin(axis=1)]))
    return np.stack([first, cross(u, first)], axis=1)


def residuals_and_jacobian(pokes: ExactPokes, pads: ExactPads) -> tuple[Exact, Exact, Exact]:
    """Return of each poke the misses E (a - c) (n, 2), their slopes E dc/dp (n, 2, d), and D^-1 (n, 2, 2)."""
    points, changes, normals = pokes.contact_centres(pads)
    levers = points - pokes.sensor
    swing, out = dot(cross(pokes.u[:, None], pokes.pairs), levers[:, None]), dot(pokes.pairs, normals[:, None])
    even = pokes.moment + pokes.force * dot(levers, levers) + pokes.offset
    tilt = pokes.force[:, None] * swing, pokes.offset[:, None] * out
    xx, yy = (even - tilt[0][:, i] * swing[:, i] - tilt[1][:, i] * out[:, i] for i in range(2))
    xy = -tilt[0][:, 0] * swing[:, 1] - tilt[1][:, 0] * out[:, 1]
    weight = np.array([[yy, -xy], [-xy, xx]]).transpose(2, 0, 1) / (xx * yy - xy * xy)[:, None, None]
    return dot(pokes.pairs, (pokes.a - points)[:, None]), pokes.pairs @ changes, weight


def gradient(pokes: ExactPokes, pads: ExactPads) -> Exact:
    """Return g (d,)."""
    misses, slopes, weight = residuals_and_jacobian(pokes, pads)
    return (slopes * (weight @ misses[:, :, None])).sum(axis=(0, 1))


def normal_matrix(pokes: ExactPokes, pads: ExactPads) -> Exact:
    """Return sum (E dc/dp)' D^-1 E dc/dp (d, d), the inverse of the unknowns' covariance."""
    _, slopes, weight = residuals_and_jacobian(pokes, pads)
    return (slopes.swapaxes(1, 2) @ (weight @ slopes)).sum(axis=0)


def find_pose(pokes: ExactPokes, pose: ExactPose) -> tuple[ExactPose, Exact]:
    """Find the pose with g = 0 by Newton's method from `pose`. Return it, and the inverse of -dg/dp there."""
    pads, last = pose.pads(), MP.one
    back, slope = pseudo_inverse(normal_matrix(pokes, pads)), gradient(pokes, pads)
    for _ in range(MAX_NEWTON_STEPS):
        step = back @ slope
        size = abs(step).max()
        pose = pose.displaced(step * min(MP.one, STEP_MAX / size) if size else step)
        if size < STEP_CONVERGED_M:
            return pose, back
        slope = gradient(pokes, pose.pads())
        if last > STEP_JACOBIAN_OK_M:
            near = [gradient(pokes, pose.displaced(way).pads()) for way in to_mp(np.eye(len(step))) * DIFFERENCE_STEP]
            back = pseudo_inverse(np.stack([(slope - there) / DIFFERENCE_STEP for there in near], axis=1))
        last = size
    raise ArithmeticError("Newton's method does not converge from the true pose.")


def _module_truth(case: ModuleCase, draws: int, rng: np.random.Generator) -> Truth:
    pokes, pose = pokes_of(case.readings, case.noise), true_pose(case)
    changes = [[0.0] * len(case.module.flat)]
    if not case.out_of_reach:
        pose, back = find_pose(pokes, pose)
        here = pose.pads().points
        for _ in range(draws):
            there = _perturbed_points(case, pose, back, rng)
            changes.append([distance(old, new) for old, new in zip(here, there, strict=True)])
    pads = pose.pads()
    matrix = normal_matrix(pokes, pads)
    least = REGULARISATION_SHARE * abs(_np.diag(matrix)).max()
    covariances = to_float(pads.changes @ inverse(matrix + least * to_mp(np.eye(len(matrix)))) @ pads.changes.swapaxes(1, 2))
    sds = np.sqrt(np.linalg.eigvalsh(covariances)[:, -1]).tolist()
    away = pokes.a - pokes.contact_centres(pads)[0]
    off = away - dot(away, pokes.u)[:, None] * pokes.u
    missed = bool(MP.sqrt(dot(off, off).mean()) > FORCE_AXIS_MAX_MISS_M)
    return Truth(
        pads.points, tuple(np.max(changes, axis=0).tolist()),
        tuple(sd < DETERMINED_PAD_MAX_SD_M and not case.out_of_reach for sd in sds),
        tuple(missed or sd > POSITION_MAX_SD_M for sd in sds),
    )  # fmt: skip


def _perturbed_points(case: ModuleCase, pose: ExactPose, back: Exact, rng: np.random.Generator) -> Exact:
    """Compute the positions (k, 3) of a module's taxels after one Newton step with perturbed inputs."""
    other, flat = perturbed(case, rng), perturbed(case.module.flat, rng)
    if isinstance(pose, OnMesh):
        pads = OnMesh.project(other.module.mesh, pose.at, pose.origin, pose.x, flat).pads()
    else:
        pads = replace(pose, flat=to_mp(flat)).pads()
    step = back @ gradient(pokes_of(other.readings, case.noise), pads)
    return pads.points + pads.changes @ step
