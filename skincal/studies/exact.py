"""The right answers of the stability study in 80 digits, from the numbers as they were read.

**A taxel.** A contact's wrench (f, m) is carried into the link frame by eq. (6) and gives the three rows of (5),
k S(u) p = -k m/|f| with u = f/|f|. Their normal equations need no root, since k/|f| enters squared:

    N = sum w S(f)'S(f),  h = -sum w S(f)'m = sum w f x m,  w = k^2/|f|^2,  |rows p - right|^2 = p'N p - 2 h'p + c.

Squaring costs half of the digits; of 80 enough are left: angles of 1e-9 rad and weights of 1e-12 together take 42.

**A module.** A poke is a line along u through a = u x m/|f|; it passes the middle c of the pads that answered by E (a - c),
with E any two orthonormal directions across u. By the definition in `pose_fit.py` that has the covariance
D = E N E' + s^2 (I - o o'), o = E n: since E (c - a) is v.rho for each e of E, v = u x e and rho = u x (c - a),

    D_ij = v_i' ((sm/|f|)^2 I + (sf/|f|)^2 S(l) S(l)') v_j + s^2 (e_i.e_j - (e_i.n) (e_j.n)),   l = c - the sensor's origin.

The pose is the one with g = sum (E dc/dp)' D^-1 E (a - c) = 0, D as it is there. It is found by Newton's method from where
the pokes were made, its matrix from differences of g in 80 digits, so that no second derivative is worked out by hand. The
draws take one such step from the exact pose, with the moved inputs: first order, 1e-16 of the change is left out.

Nothing here is taken from the solvers: not the two rows a contact, not the order, not the closed form for triangles; only what
`pose_fit.py` counts a poke for. mpmath does the arithmetic, on numpy's arrays of its numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.mesh.search import GRAZING
from skincal.model.scene import NoiseSettings
from skincal.modules.pose import ModulePoses
from skincal.modules.pose_fit import CENTRE_OFFSET_FACTOR, TWO_MODULES_SD_M
from skincal.studies.stability_cases import Case, ModuleCase, RawMesh, Readings, moved
from skincal.taxels.result import MISS_MAX, SD_MAX

DIGITS = 80
_mpmath: Any = import_module("mpmath")
MP: Any = _mpmath.mp.clone()
"""Arithmetic with as many digits, whatever others of the process set theirs to."""
MP.dps = DIGITS
NO_NUMBER = 1e300
"""m. The error of a solver that gave no number: JSON has no infinity."""
Exact: TypeAlias = Any
"""An array of numbers of `MP`; numpy has no type for it."""

_CROSSINGS_MAX = 1000
"""Of edges by a way over a mesh."""
_AT_ONCE = 1 << 14
"""Contacts of which the exact numbers are held at once: some 100 MB."""
_DRAWN_AT_ONCE = 1 << 16
"""Effects added at once in all draws: 50 MB."""
_MARGIN = 64 * float(np.finfo(float).eps)
"""Share of the reach by which the root of a sum of squares moves at most when every input moves by a unit: about ten
roundings a row. A triangle that is further from the best than twice that is the best in no draw."""
_np: Any = np
"""numpy on such arrays; its own types know numbers only."""
_number: Any = _np.frompyfunc(MP.convert, 1, 1)


def exactly(values: Any) -> Exact:
    """Return floats as they are, to the last digit, in an array of their shape."""
    return _number(np.asarray(values, dtype=float))


def floats(numbers: Any) -> FloatArray:
    """Return exact numbers rounded."""
    return np.asarray(numbers).astype(float)


def cross(p: Exact, q: Exact) -> Exact:
    """Return p x q along the last axis."""
    return p[..., [1, 2, 0]] * q[..., [2, 0, 1]] - p[..., [2, 0, 1]] * q[..., [1, 2, 0]]


def dot(p: Exact, q: Exact) -> Any:
    """Return p . q along the last axis."""
    return (p * q).sum(axis=-1)


def unit(v: Exact) -> Exact:
    """Return `v` (..., 3) at length 1."""
    return v / np.sqrt((v * v).sum(axis=-1, keepdims=True))


def distance(p: Exact, q: Any = 0) -> float:
    """Return |p - q|; without `q` the length of p."""
    return float(MP.sqrt(dot(p - q, p - q)))


def distance_to(found: FloatArray, answer: Exact) -> float:
    """Return |found - answer|; `NO_NUMBER` where a solver gave none."""
    return distance(exactly(found), answer) if np.isfinite(found).all() else NO_NUMBER


def between(p: Exact, q: Exact) -> float:
    """Return the sine of the angle between two unit directions that have no sign: the angle itself, rad, where small."""
    return distance(cross(p, q))


# ---- a taxel ----


class NormalEquations(NamedTuple):
    """N (3, 3), h (3,) and c of one taxel."""

    n: Exact
    h: Exact
    c: Any


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The exact places of a taxel, or of a module's k pads, and how far they move when the inputs' last digits do."""

    points: Exact
    """(k, 3)."""
    changes: tuple[float, ...]
    """m, of each the largest over the draws."""
    determined: tuple[bool, ...] = (True,)
    """Whether the contacts determine the place at all, however badly, so that it is compared."""
    blind: tuple[bool, ...] = (False,)
    """Whether a pad must be called blind: known worse than `SD_MAX`, or missed by the axes by more than `MISS_MAX`."""
    direction: Exact | None = None
    """The direction that a taxel's readings say nothing of."""
    turn: float = 0.0
    """rad, the largest change of that over the draws."""


def find_truth(case: Case, draws: int, rng: np.random.Generator) -> Truth:
    """Return the exact answer of a case and its largest change over `draws` draws of the inputs' last digits."""
    if isinstance(case, ModuleCase):
        return _module_truth(case, draws, rng)
    readings, equations = case.readings, normal_equations(case.readings)
    if case.mesh is not None:
        answer, change = _on_mesh(readings, case.mesh, equations, draws, rng)
        return Truth(answer[None], (change,))
    if case.many:
        answer = solve(equations)
        return Truth(answer[None], (_first_order(readings, equations, answer, draws, rng),))
    every = [equations, *(normal_equations(readings.moved(rng)) for _ in range(draws))]
    (answer, direction), *drawn = [solve_blind(some) if case.blind else (solve(some), None) for some in every]
    turn = max(between(direction, turned) for _, turned in drawn) if case.blind else 0.0
    return Truth(answer[None], (max(distance(answer, p) for p, _ in drawn),), direction=direction, turn=turn)


def normal_equations(readings: Readings) -> NormalEquations:
    """Return the normal equations of (5), all three rows of every contact, each carried by eq. (6)."""
    n, h, c = exactly(np.zeros((3, 3))), exactly(np.zeros(3)), MP.mpf(0)
    for first in range(0, len(readings.forces), _AT_ONCE):
        some = np.arange(first, min(first + _AT_ONCE, len(readings.forces)))
        f, m = _carried(readings.ordered(some))
        squares = dot(f, f)
        k = _weights(readings.ordered(some))
        w = k * k / squares
        # S(f)'S(f) = |f|^2 I - f f'.
        n = n + _np.diag([dot(w, squares)] * 3) - (w[:, None] * f).T @ f
        h, c = h + w @ cross(f, m), c + dot(w, dot(m, m))
    return NormalEquations(n, h, c)


def _carried(readings: Readings) -> tuple[Exact, Exact]:
    """Return f and m (n, 3) in the link frame: f_w = R f_s and m_w = R m_s + t x f_w with p_w = R p_s + t, eq. (6) turned."""
    f, m = exactly(readings.forces), exactly(readings.moments)
    for number, pose in enumerate(readings.poses):
        own = readings.pose_of == number
        if not np.array_equal(pose, np.eye(4)):
            turn, shift = exactly(pose[:3, :3]), exactly(pose[:3, 3])
            f[own] = f[own] @ turn.T
            m[own] = m[own] @ turn.T + cross(shift, f[own])
    return f, m


def _weights(readings: Readings) -> Exact:
    return exactly(readings.responses) / exactly(readings.strongest)


def mean_push(readings: Readings) -> Exact:
    """Return the sum of k u: the mean push but for its length."""
    return _weights(readings) @ unit(_carried(readings)[0])


def solve(equations: NormalEquations) -> Exact:
    """Return the p with N p = h; the axes determine all three directions."""
    return np.array(list(MP.lu_solve(MP.matrix(equations.n.tolist()), MP.matrix(equations.h.tolist()))), dtype=object)


def solve_blind(equations: NormalEquations) -> tuple[Exact, Exact]:
    """Return the p of smallest norm of axes that are parallel to the last digit, and their direction, unit.

    The direction is the eigenvector of N with the smallest eigenvalue; p minimises the sum of squares across it.
    """
    values, columns = MP.eigsy(MP.matrix(equations.n.tolist()))
    axes = np.array(columns.T.tolist(), dtype=object)
    return sum(axis * (dot(axis, equations.h) / value) for axis, value in zip(axes[1:], values[1:], strict=True)), axes[0]


def nearest(equations: NormalEquations, corners: Exact) -> tuple[Exact, Exact]:
    """Minimise the sum of squares over each of `corners` (t, 3, 3): the least values (t,), and where (t, 3).

    In shares (s, t) of two sides e and g the sum is convex: a stationary point inside is the minimum; else it lies on the rim.
    """
    corner = corners[:, 0]
    e, g = corners[:, 1] - corner, corners[:, 2] - corner
    ne, there = e @ equations.n, corner @ equations.n - equations.h
    ee, eg, gg, e0, g0 = dot(e, ne), dot(g, ne), dot(g, g @ equations.n), dot(e, there), dot(g, there)
    determinant = ee * gg - eg * eg
    flat = _np.where(determinant > 0, determinant, MP.one)
    s, t = (eg * g0 - gg * e0) / flat, (eg * e0 - ee * g0) / flat
    inside = (determinant > 0) & (s >= 0) & (t >= 0) & (s + t <= 1)
    none, across = _np.full(len(corners), MP.zero), _share(ee - eg + e0 - g0, ee - 2 * eg + gg)
    sides = [(_share(-e0, ee), none), (none, _share(-g0, gg)), (1 - across, across)]
    tries = [*sides, (_np.where(inside, s, none), _np.where(inside, t, none))]
    values = np.array([ee * a * a + gg * b * b + 2 * (eg * a * b + e0 * a + g0 * b) for a, b in tries], dtype=object)
    winner, row = values.argmin(axis=0), np.arange(len(corners))
    s, t = (np.array(shares, dtype=object)[winner, row] for shares in zip(*tries, strict=True))
    least = values[winner, row] + dot(corner, there - equations.h) + equations.c
    return least, corner + s[:, None] * e + t[:, None] * g


def _share(slope: Exact, curvature: Exact) -> Exact:
    """Return where on a side a sum is least: 0 to 1."""
    bent = curvature > 0
    return _np.where(bent, _np.clip(slope / _np.where(bent, curvature, MP.one), MP.zero, MP.one), MP.zero)


def best(equations: NormalEquations, corners: Exact) -> Exact:
    """Return the point with the smallest sum of squares on any of `corners` (t, 3, 3)."""
    values, points = nearest(equations, corners)
    return points[values.argmin()]


def _on_mesh(
    readings: Readings, mesh: RawMesh, equations: NormalEquations, draws: int, rng: np.random.Generator
) -> tuple[Exact, float]:
    triangles = mesh.triangles[_facing(mesh, mean_push(readings))]
    values, points = nearest(equations, exactly(mesh.vertices[triangles]))
    roots = np.sqrt(np.maximum(values, MP.zero))
    answer = points[values.argmin()]
    # Only these can be the best in a draw.
    left = triangles[roots <= roots.min() + 2 * _margin(readings, mesh)]
    changes = [0.0]
    for _ in range(draws):
        corners = exactly(moved(mesh.vertices, rng)[left])
        changes.append(distance(answer, best(normal_equations(readings.moved(rng)), corners)))
    return answer, max(changes)


def _margin(readings: Readings, mesh: RawMesh) -> float:
    """Return by how much the root of a sum of squares may move in a draw."""
    levers = np.linalg.norm(readings.moments, axis=1) / np.linalg.norm(readings.forces, axis=1)
    reach = float(np.abs(mesh.vertices).max() + np.abs(readings.poses[:, :3, 3]).max() + levers.max())
    weights = readings.responses / readings.strongest
    return _MARGIN * reach * float(np.sqrt(weights @ weights))


def _facing(mesh: RawMesh, push: Exact) -> IntArray:
    """Return the triangles that the push can act on, as the program defines it: push . normal < -`GRAZING`, both unit."""
    corners = exactly(mesh.corners)
    normals = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # One without area is not pushed.
    lengths = np.sqrt(dot(normals, normals) * dot(push, push))
    return np.flatnonzero(normals @ push < -GRAZING * lengths)


def _first_order(readings: Readings, equations: NormalEquations, answer: Exact, draws: int, rng: np.random.Generator) -> float:
    """Return the largest change of the exact answer over the draws by its derivative.

    For a sensor in the link frame and weights of 1: the answer has sum w f x r = 0 with r = f x p + m and w = 1/|f|^2, so
    it changes by N^-1 times the change of that sum. What is left out is of the second order: 1e-16 of the change.
    """
    p, inverse = floats(answer), np.linalg.inv(floats(equations.n))
    f, m = readings.forces, readings.moments
    w = 1.0 / np.sum(f * f, axis=1, keepdims=True)
    r = np.cross(f, p) + m
    effects: list[FloatArray] = []
    for axis in np.eye(3):
        df = np.spacing(np.abs(f @ axis))[:, None] * axis
        dm = np.spacing(np.abs(m @ axis))[:, None] * axis
        dw = -2.0 * w * w * np.sum(f * df, axis=1, keepdims=True)
        effects.append((dw * np.cross(f, r) + w * (np.cross(df, r) + np.cross(f, np.cross(df, p)))) @ inverse)
        effects.append(w * np.cross(f, dm) @ inverse)
    return _drawn_sum(np.concatenate(effects), draws, rng)


def _drawn_sum(effects: FloatArray, draws: int, rng: np.random.Generator) -> float:
    """Return the largest length over `draws` of the sum of `effects` (n, 3), each up or down."""
    scale = float(np.abs(effects).max())
    # Seven digits of a change are plenty, and twice as fast.
    scaled = (effects / scale).astype(np.float32)
    up = np.zeros((draws, 3))
    for first in range(0, len(scaled), _DRAWN_AT_ONCE):
        part = scaled[first : first + _DRAWN_AT_ONCE]
        bits = np.unpackbits(np.frombuffer(rng.bytes(draws * -(-len(part) // 8)), dtype=np.uint8).reshape(draws, -1), axis=1)
        up += bits[:, : len(part)].astype(np.float32) @ part
    # Those up less those down are twice those up less all.
    return scale * float(np.linalg.norm(2.0 * up - np.sum(effects / scale, axis=0), axis=1).max())


# ---- where a module's pads lie ----


class ExactPads(NamedTuple):
    """Where k pads lie (k, 3), how that changes with each unknown (k, 3, d), and the normals there (k, 3)."""

    points: Exact
    changes: Exact
    normals: Exact


@dataclass(frozen=True, slots=True, eq=False)
class InPlane:
    """A flat module with pads (k, 2) anywhere: a shift and a turn about its origin."""

    origin: Exact
    x: Exact
    normal: Exact
    flat: Exact

    @classmethod
    def begin(cls, at: ModulePoses, flat: FloatArray) -> InPlane:
        """Return the module at one pose, its directions made orthonormal."""
        normal = unit(exactly(at.normals[0]))
        return cls(exactly(at.points[0]), unit(_beside(exactly(at.x[0]), normal)), normal, exactly(flat))

    def pads(self) -> ExactPads:
        """Return where its pads lie: dP = dt + w x arm."""
        arms = self.flat @ np.stack([self.x, cross(self.normal, self.x)])
        axes = exactly(np.eye(3))
        turned = cross(axes, arms[:, None]).swapaxes(1, 2)
        changes = np.concatenate([np.broadcast_to(axes, turned.shape), turned], axis=2)
        return ExactPads(self.origin + arms, changes, np.broadcast_to(self.normal, arms.shape))

    def moved(self, step: Exact) -> InPlane:
        """Return the module, shifted and turned by the quaternion 1, w/2: any way to take a step is right, its end counts."""
        q = step[3:] / 2
        # v + 2 (q x v + q x (q x v))/(1 + q.q)
        x, normal = (v + (cross(q, v) + cross(q, cross(q, v))) * 2 / (1 + dot(q, q)) for v in (self.x, self.normal))
        return replace(self, origin=self.origin + step[:3], x=x, normal=normal)

    def given(self, flat: FloatArray, vertices: FloatArray | None) -> InPlane:
        """Return the same pose with other pads."""
        assert vertices is None
        return replace(self, flat=exactly(flat))


def _beside(v: Exact, normal: Exact) -> Exact:
    return v - normal * dot(v, normal)


class ExactMesh:
    """A mesh to walk on; triangles are worked out as they are reached, with one root each."""

    def __init__(self, mesh: RawMesh) -> None:
        self.mesh = mesh
        # The triangle that has an edge in this sense.
        around = enumerate(mesh.triangles.tolist())
        self._over = {(corners[i], corners[(i + 1) % 3]): at for at, corners in around for i in range(3)}
        self._known: dict[int, tuple[Exact, Exact, Exact]] = {}

    def triangle(self, at: int) -> tuple[Exact, Exact, Exact]:
        """Return a triangle's corners, its normal, and of each side a vector out of it in its plane, as long as the side."""
        if at not in self._known:
            corners = exactly(self.mesh.vertices[self.mesh.triangles[at]])
            normal = unit(cross(corners[1] - corners[0], corners[2] - corners[0]))
            self._known[at] = corners, normal, cross(corners[[1, 2, 0]] - corners, normal)
        return self._known[at]

    def behind(self, at: int, side: int) -> tuple[int, int] | None:
        """Return the triangle behind a side, and which of its sides that is; None at the rim."""
        corners: list[int] = self.mesh.triangles[at].tolist()
        there = self._over.get((corners[(side + 1) % 3], corners[side]))
        return None if there is None else (there, self.mesh.triangles[there].tolist().index(corners[(side + 1) % 3]))


@dataclass(frozen=True, slots=True, eq=False)
class OnMesh:
    """A module with pads (k, 2) on a mesh: a place on it, and a turn in its plane.

    A way to a pad is straight in space: at an edge its direction keeps its share along the edge, and its share across the edge
    is carried from the one triangle's plane into the other's. Past the rim it goes on in the last triangle's plane.
    """

    mesh: ExactMesh
    at: int
    origin: Exact
    x: Exact
    flat: Exact

    @classmethod
    def begin(cls, at: ModulePoses, flat: FloatArray, mesh: RawMesh) -> OnMesh:
        """Return the module at one pose, brought into the plane of its triangle."""
        exact, number = ExactMesh(mesh), int(at.triangles[0])
        corners, normal, _ = exact.triangle(number)
        origin = corners[0] + _beside(exactly(at.points[0]) - corners[0], normal)
        return cls(exact, number, origin, unit(_beside(exactly(at.x[0]), normal)), exactly(flat))

    def pads(self) -> ExactPads:
        """Return the ends of the ways: dP = da x + db y + dtheta (bx y - by x), with x, y as carried there."""
        ends = [(way, *self._walked(way)) for way in self.flat]
        normals = np.array([self.mesh.triangle(at)[1] for _, at, _, _ in ends])
        x = np.array([x for _, _, _, x in ends])
        y = cross(normals, x)
        changes = np.stack([x, y, self.flat[:, :1] * y - self.flat[:, 1:] * x], axis=2)
        return ExactPads(np.array([point for _, _, point, _ in ends]), changes, normals)

    def moved(self, step: Exact) -> OnMesh:
        """Return the module after its way, turned by the angle whose tangent is the last unknown."""
        at, point, x = self._walked(step[:2])
        return replace(self, at=at, origin=point, x=unit(x + cross(self.mesh.triangle(at)[1], x) * step[2]))

    def given(self, flat: FloatArray, vertices: FloatArray | None) -> OnMesh:
        """Return the module at the same shares of its triangle's sides, which moved."""
        assert vertices is not None
        mesh = ExactMesh(replace(self.mesh.mesh, vertices=vertices))
        old, new = (each.triangle(self.at)[0] for each in (self.mesh, mesh))
        origin = new[0] + _carried_along(self.origin - old[0], old, new)
        return OnMesh(mesh, self.at, origin, unit(_carried_along(self.x, old, new)), exactly(flat))

    def _walked(self, way: Exact) -> tuple[int, Exact, Exact]:
        """Return the triangle, the place and the carried x at the end of a way."""
        at, place, x, came = self.at, self.origin, self.x, -1
        left = MP.sqrt(dot(way, way))
        if not left:
            return at, place, x
        ahead = (x * way[0] + cross(self.mesh.triangle(at)[1], x) * way[1]) / left
        for _ in range(_CROSSINGS_MAX):
            corners, _, out = self.mesh.triangle(at)
            rates, room = out @ ahead, dot(out, corners - place)
            far, side = min((room[i] / rates[i], i) for i in range(3) if i != came and rates[i] > 0)
            over = self.mesh.behind(at, side)
            if far >= left or over is None:
                return at, place + ahead * left, x
            place, left = place + ahead * far, left - far
            edge = corners[(side + 1) % 3] - corners[side]
            inward = -self.mesh.triangle(over[0])[2][over[1]]
            both = np.stack([ahead, x])
            ahead, x = ((both @ edge)[:, None] * edge + (both @ out[side])[:, None] * inward) / dot(edge, edge)
            at, came = over
        raise ArithmeticError("A way over the mesh goes round in circles.")


def _carried_along(v: Exact, old: Exact, new: Exact) -> Exact:
    """Return a vector in the plane of a triangle, carried along as its sides move."""
    sides = old[1:] - old[0]
    return solved(sides @ sides.T, sides @ v) @ (new[1:] - new[0])


ExactPose: TypeAlias = InPlane | OnMesh
"""A module's pose, and what it lies on."""

# ---- a module ----

_STEP = MP.mpf("1e-30")
"""Of a difference: 50 digits of a derivative are left."""
_NONE = MP.mpf("1e-26")
"""Share of the largest curvature below which there is none: what is left of it by differences."""
_TRACE = MP.mpf("1e-32")
"""Share of the largest information that is added to all, so that what is not determined has a variance: an immense one."""
_FOUND = MP.mpf("1e-34")
"""m: a step below it leaves 1e-60."""
_ROUGH = MP.mpf("1e-6")
"""m: steps of differences that are known to that share."""
_FAR = MP.mpf("0.02")
"""m, or rad: of one step."""
_STEPS_MAX = 60
_KNOWN = 1e5
"""m: a pad whose place is known worse than this is not known at all."""


class ExactPokes(NamedTuple):
    """What n pokes say of their module, whatever its pose.

    `answered` (n, m) are the pads that answered, `shares` (n, m) of the middle; where a poke has fewer, the first pad with a
    share of zero. `pairs` (n, 2, 3) are two orthonormal directions across u. `moment` and `offset` (n,) are in m^2:
    (sm/|f|)^2 and s^2; `force` (n,) is (sf/|f|)^2.
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
        places = (self.shares[:, :, None] * pads.points[self.answered]).sum(axis=1)
        normals = (self.shares[:, :, None] * pads.normals[self.answered]).sum(axis=1)
        changes = (self.shares[:, :, None, None] * pads.changes[self.answered]).sum(axis=1)
        return places, changes, unit(normals)


def pokes_of(readings: Readings, noise: NoiseSettings) -> ExactPokes:
    """Return the pokes in 80 digits."""
    f, m = _carried(readings)
    size = np.sqrt(dot(f, f))
    u = f / size[:, None]
    answering = readings.responses > 0
    # Those that answered first, in their order.
    answered = np.argsort(~answering, axis=1, kind="stable")[:, : answering.sum(axis=1).max()]
    answers = exactly(np.take_along_axis(readings.responses, answered, axis=1))
    missed = (exactly(CENTRE_OFFSET_FACTOR) * exactly(noise.contact)) / exactly(answering.sum(axis=1))
    beside = _np.where(readings.beside > 0, exactly(TWO_MODULES_SD_M), MP.zero)
    return ExactPokes(
        answered, answers / answers.sum(axis=1, keepdims=True), u, cross(u, m) / size[:, None], two_across(u),
        exactly(readings.poses[readings.pose_of, :3, 3]), (exactly(noise.moment) / size) ** 2,
        (exactly(noise.force) / size) ** 2, missed**2 + beside**2,
    )  # fmt: skip


def two_across(u: Exact) -> Exact:
    """Return two orthonormal directions (n, 2, 3) across u (n, 3)."""
    first = unit(cross(u, exactly(np.eye(3))[abs(u).argmin(axis=1)]))
    return np.stack([first, cross(u, first)], axis=1)


def weighed(pokes: ExactPokes, pads: ExactPads) -> tuple[Exact, Exact, Exact]:
    """Return of each poke the misses E (a - c) (n, 2), their slopes E dc/dp (n, 2, d), and D^-1 (n, 2, 2)."""
    places, changes, normals = pokes.contact_centres(pads)
    levers = places - pokes.sensor
    swing, out = dot(cross(pokes.u[:, None], pokes.pairs), levers[:, None]), dot(pokes.pairs, normals[:, None])
    even = pokes.moment + pokes.force * dot(levers, levers) + pokes.offset
    tilt = pokes.force[:, None] * swing, pokes.offset[:, None] * out
    xx, yy = (even - tilt[0][:, i] * swing[:, i] - tilt[1][:, i] * out[:, i] for i in range(2))
    xy = -tilt[0][:, 0] * swing[:, 1] - tilt[1][:, 0] * out[:, 1]
    inverse = np.array([[yy, -xy], [-xy, xx]]).transpose(2, 0, 1) / (xx * yy - xy * xy)[:, None, None]
    return dot(pokes.pairs, (pokes.a - places)[:, None]), pokes.pairs @ changes, inverse


def pull(pokes: ExactPokes, pads: ExactPads) -> Exact:
    """Return g: how the pokes pull at each unknown."""
    misses, slopes, inverse = weighed(pokes, pads)
    return (slopes * (inverse @ misses[:, :, None])).sum(axis=(0, 1))


def information(pokes: ExactPokes, pads: ExactPads) -> Exact:
    """Return sum (E dc/dp)' D^-1 E dc/dp, the inverse of the unknowns' covariance."""
    _, slopes, inverse = weighed(pokes, pads)
    return (slopes.swapaxes(1, 2) @ (inverse @ slopes)).sum(axis=0)


def solved(matrix: Exact, right: Exact, none: Any = _NONE) -> Exact:
    """Return a solution of the linear equations, by elimination with full pivots; zero of what they do not determine.

    Parameters
    ----------
    none : share of the largest number below which a pivot determines nothing
    """
    count = len(matrix)
    rows = _np.column_stack([matrix, right])
    found = _np.full((count, rows.shape[1] - count), MP.zero)
    left, pivots, least = list(range(count)), list[int](), none * abs(matrix).max()
    for k in range(count):
        sizes = abs(rows[k:, left])
        top, place = divmod(int(sizes.argmax()), len(left))
        if sizes[top, place] <= least:
            break
        pivots.append(left.pop(place))
        rows[[k, k + top]] = rows[[k + top, k]]
        rows[k] = rows[k] / rows[k, pivots[k]]
        others = np.arange(count) != k
        rows[others] = rows[others] - rows[others, pivots[k]][:, None] * rows[k]
    found[pivots] = rows[: len(pivots), count:]
    return found.reshape(right.shape)


def find(pokes: ExactPokes, pose: ExactPose) -> tuple[ExactPose, Exact]:
    """Return the pose where the pokes' pulls cancel, nearest to `pose` as Newton goes, and -dg/dp there."""
    pads, last = pose.pads(), MP.one
    matrix, pulled = information(pokes, pads), pull(pokes, pads)
    for _ in range(_STEPS_MAX):
        step = solved(matrix, pulled)
        size = abs(step).max()
        pose = pose.moved(step * min(MP.one, _FAR / size) if size else step)
        if size < _FOUND:
            return pose, matrix
        pulled = pull(pokes, pose.pads())
        # Once its differences are known to a millionth, the matrix serves to the end: each step gains as many digits.
        if last > _ROUGH:
            near = [pull(pokes, pose.moved(way).pads()) for way in exactly(np.eye(len(step))) * _STEP]
            matrix = np.stack([(pulled - there) / _STEP for there in near], axis=1)
        last = size
    raise ArithmeticError("Newton's method does not converge from where the pokes were made.")


def _module_truth(case: ModuleCase, draws: int, rng: np.random.Generator) -> Truth:
    """Return the exact answer of a case and how far its pads move over draws of the inputs' last digits."""
    pokes, pose = pokes_of(case.readings, case.noise), begin_of(case)
    changes = [[0.0] * len(case.module.flat)]
    if not case.lost:
        pose, matrix = find(pokes, pose)
        here = pose.pads().points
        changes += [_drawn(case, pose, here, matrix, rng) for _ in range(draws)]
    pads = pose.pads()
    matrix, one = information(pokes, pads), exactly(np.eye(len(pads.changes[0, 0])))
    inverse = solved(matrix + _TRACE * abs(_np.diag(matrix)).max() * one, one, MP.zero)
    covariances = floats(pads.changes @ inverse @ pads.changes.swapaxes(1, 2))
    sds = np.sqrt(np.linalg.eigvalsh(covariances)[:, -1]).tolist()
    away = pokes.a - pokes.contact_centres(pads)[0]
    off = away - dot(away, pokes.u)[:, None] * pokes.u
    missed = bool(MP.sqrt(dot(off, off).mean()) > MISS_MAX)
    return Truth(
        pads.points, tuple(np.max(changes, axis=0).tolist()), tuple(sd < _KNOWN and not case.lost for sd in sds),
        tuple(missed or sd > SD_MAX for sd in sds),
    )  # fmt: skip


def begin_of(case: ModuleCase) -> ExactPose:
    """Return where the pokes of a case were made."""
    at, mesh, flat = case.module.at, case.module.mesh, case.module.flat
    return InPlane.begin(at, flat) if mesh is None else OnMesh.begin(at, flat, mesh)


def _drawn(case: ModuleCase, pose: ExactPose, here: Exact, matrix: Exact, rng: np.random.Generator) -> list[float]:
    """Return how far each pad moves in one draw."""
    mesh = case.module.mesh
    there = pose.given(moved(case.module.flat, rng), None if mesh is None else moved(mesh.vertices, rng)).pads()
    step = solved(matrix, pull(pokes_of(case.readings.moved(rng), case.noise), there))
    return [distance(old, new) for old, new in zip(here, there.points + there.changes @ step, strict=True)]
