"""The paper's least squares in 80 digits, from the numbers as they were read: the answer the solvers are compared with.

A contact's wrench (f, m) is carried into the link frame by eq. (6) and gives the three rows of (5), k S(u) p = -k m/|f|
with u = f/|f|. Their normal equations need no root, since k/|f| enters squared:

    N = sum w S(f)'S(f),  h = -sum w S(f)'m,  w = k^2/|f|^2,  |rows p - right|^2 = p'N p - 2 h'p + c.

Squaring costs half of the digits; of 80 enough are left: angles of 1e-9 rad and weights of 1e-12 together take 42.
Nothing here is taken from the solvers: not the two rows a contact, not the order, not the closed form for triangles.

`decimal` of the standard library does the arithmetic, several times as fast as mpmath, which checks it in the tests.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from decimal import Context, Decimal, localcontext
from typing import TypeAlias

import numpy as np

from skincal.geometry.arrays import FloatArray, IntArray
from skincal.mesh.search import GRAZING
from skincal.studies.cases import Case, Mesh, Readings, moved

DIGITS = 80
CONTEXT = Context(prec=DIGITS, Emin=-999999, Emax=999999)
NO_NUMBER = 1e300
"""m. The error of a solver that gave no number: JSON has no infinity."""
Vector: TypeAlias = tuple[Decimal, Decimal, Decimal]
Triangle: TypeAlias = tuple[Vector, Vector, Vector]

_ZERO, _ONE = Decimal(0), Decimal(1)
_NOWHERE: Vector = (_ZERO, _ZERO, _ZERO)
_TURNS = 5
"""Steps of inverse iteration towards a direction that is blind to 1e-13 at least: each leaves 1e-26 of the error."""
_SURE = 1e-6
"""A triangle whose push . normal is nearer to zero than this is looked at in 80 digits."""
_AT_ONCE = 1 << 16
"""Effects added at once in all draws: 50 MB."""
_MARGIN = 64 * float(np.finfo(float).eps)
"""Share of the reach by which the root of a sum of squares moves at most when every input moves by a unit: about ten
roundings a row. A triangle that is further from the best than twice that is the best in no draw."""


@dataclass(frozen=True, slots=True)
class System:
    """The normal equations of one taxel."""

    n: tuple[Decimal, Decimal, Decimal, Decimal, Decimal, Decimal]
    """N, symmetric: xx, xy, xz, yy, yz, zz."""
    h: Vector
    c: Decimal

    def times(self, p: Vector) -> Vector:
        """Return N p."""
        xx, xy, xz, yy, yz, zz = self.n
        x, y, z = p
        return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z

    def value(self, p: Vector) -> Decimal:
        """Return the sum of squares of (5) at `p`."""
        return dot(p, self.times(p)) - 2 * dot(self.h, p) + self.c


@dataclass(frozen=True, slots=True)
class Truth:
    """The exact answer of a case and how far it moves when the inputs' last digits do."""

    answer: Vector
    change: float
    """m, the largest over the draws."""
    blind: Vector | None = None
    """The direction that the readings say nothing of."""
    turn: float = 0.0
    """rad, the largest change of the blind direction over the draws."""


def find_truth(case: Case, draws: int, rng: np.random.Generator) -> Truth:
    """Return the exact answer of a case and its largest change over `draws` draws of the inputs' last digits."""
    equations = system(case.readings)
    if case.many:
        answer = solve(equations)
        return Truth(answer, _first_order(case.readings, equations, answer, draws, rng))
    if case.blind:
        answer, blind = solve_blind(equations)
        others = [solve_blind(system(case.readings.moved(rng))) for _ in range(draws)]
        change = max(distance(answer, other) for other, _ in others)
        return Truth(answer, change, blind, max(between(blind, turned) for _, turned in others))
    if case.mesh is not None:
        return _on_mesh(case.readings, case.mesh, equations, draws, rng)
    answer = solve(equations)
    return Truth(answer, max(distance(answer, solve(system(case.readings.moved(rng)))) for _ in range(draws)))


def _on_mesh(readings: Readings, mesh: Mesh, equations: System, draws: int, rng: np.random.Generator) -> Truth:
    triangles = mesh.triangles[_facing(mesh, mean_push(readings))]
    found = [nearest(equations, exactly(corners)) for corners in mesh.vertices[triangles]]
    answer = min(found, key=lambda one: one[0])[1]
    # Only these can be the best in a draw.
    left = triangles[_near_best([value for value, _ in found], _margin(readings, mesh))]
    changes: list[float] = []
    for _ in range(draws):
        corners = moved(mesh.vertices, rng)[left]
        other = best(system(readings.moved(rng)), [exactly(one) for one in corners])
        changes.append(distance(answer, other))
    return Truth(answer, max(changes))


def vector(values: Iterable[float]) -> Vector:
    """Return three floats as they are, to the last digit."""
    x, y, z = map(Decimal, values)
    return x, y, z


def exactly(corners: FloatArray) -> Triangle:
    """Return a triangle's corners (3, 3) as they are."""
    first, second, third = (vector(corner) for corner in corners)
    return first, second, third


def dot(p: Vector, q: Vector) -> Decimal:
    """Return p . q."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


def cross(p: Vector, q: Vector) -> Vector:
    """Return p x q."""
    return p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]


def minus(p: Vector, q: Vector) -> Vector:
    """Return p - q."""
    return p[0] - q[0], p[1] - q[1], p[2] - q[2]


def along(p: Vector, share: Decimal, q: Vector) -> Vector:
    """Return p + share q."""
    return p[0] + share * q[0], p[1] + share * q[1], p[2] + share * q[2]


def times(share: Decimal, p: Vector) -> Vector:
    """Return share p."""
    return share * p[0], share * p[1], share * p[2]


def distance(p: Vector, q: Vector = _NOWHERE) -> float:
    """Return |p - q|; without `q` the length of p."""
    with localcontext(CONTEXT):
        away = minus(p, q)
        return float(dot(away, away).sqrt())


def distance_to(found: FloatArray, answer: Vector) -> float:
    """Return |found - answer|; `NO_NUMBER` where a solver gave none."""
    return distance(vector(found), answer) if np.isfinite(found).all() else NO_NUMBER


def between(p: Vector, q: Vector) -> float:
    """Return the sine of the angle between two unit directions that have no sign: the angle itself, rad, where small."""
    with localcontext(CONTEXT):
        return distance(cross(p, q))


def system(readings: Readings) -> System:
    """Return the normal equations of (5), all three rows of every contact, each carried by eq. (6)."""
    with localcontext(CONTEXT):
        sums = [_ZERO] * 10
        for f, m, k in _carried(readings):
            sums = [total + part for total, part in zip(sums, _parts(f, m, k), strict=True)]
        xx, xy, xz, yy, yz, zz, hx, hy, hz, c = sums
        return System((xx, xy, xz, yy, yz, zz), (hx, hy, hz), c)


def _carried(readings: Readings) -> Iterable[tuple[Vector, Vector, Decimal]]:
    """Yield f, m in the link frame and k: f_w = R f_s and m_w = R m_s + t x f_w with p_w = R p_s + t, eq. (6) turned."""
    poses = [_pose(readings.poses[number]) for number in range(len(readings.poses))]
    wrenches: list[list[float]] = np.concatenate([readings.forces, readings.moments], axis=1).tolist()
    responses: list[list[float]] = np.stack([readings.responses, readings.strongest], axis=1).tolist()
    pose_of: list[int] = readings.pose_of.tolist()
    for wrench, (response, strongest), number in zip(wrenches, responses, pose_of, strict=True):
        k = _ONE if response == strongest else Decimal(response) / Decimal(strongest)
        f, m, pose = vector(wrench[:3]), vector(wrench[3:]), poses[number]
        if pose is not None:
            x, y, z, shift = pose
            f, m = (dot(x, f), dot(y, f), dot(z, f)), (dot(x, m), dot(y, m), dot(z, m))
            m = along(cross(shift, f), _ONE, m)
        yield f, m, k


def _pose(pose: FloatArray) -> tuple[Vector, Vector, Vector, Vector] | None:
    """Return the rows of R and t; None where the sensor is in the link frame."""
    if np.array_equal(pose, np.eye(4)):
        return None
    return vector(pose[0, :3]), vector(pose[1, :3]), vector(pose[2, :3]), vector(pose[:3, 3])


def _parts(f: Vector, m: Vector, k: Decimal) -> tuple[Decimal, ...]:
    """Return what one contact adds to N (6), h (3) and c."""
    x, y, z = f
    xx, yy, zz = x * x, y * y, z * z
    w = k * k / (xx + yy + zz)
    wx, wy = w * x, w * y
    # S(f)'S(f) of the three rows (0, -z, y), (z, 0, -x), (-y, x, 0); and -S(f)'m = f x m.
    hx, hy, hz = cross(f, m)
    return (
        w * (yy + zz), -wx * y, -wx * z, w * (xx + zz), -wy * z, w * (xx + yy), w * hx, w * hy, w * hz, w * dot(m, m),
    )  # fmt: skip


def mean_push(readings: Readings) -> Vector:
    """Return the sum of k u: the mean push but for its length."""
    with localcontext(CONTEXT):
        push = _NOWHERE
        for f, _, k in _carried(readings):
            push = along(push, k / dot(f, f).sqrt(), f)
        return push


def _adjugate(n: tuple[Decimal, ...]) -> tuple[Vector, Vector, Vector]:
    xx, xy, xz, yy, yz, zz = n
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    return (a, b, c), (b, d, e), (c, e, f)


def solve(equations: System) -> Vector:
    """Return the p with N p = h; the axes determine all three directions."""
    with localcontext(CONTEXT):
        rows = _adjugate(equations.n)
        xx, xy, xz = equations.n[:3]
        determinant = dot((xx, xy, xz), rows[0])
        x, y, z = (dot(row, equations.h) / determinant for row in rows)
        return x, y, z


def solve_blind(equations: System) -> tuple[Vector, Vector]:
    """Return the p of smallest norm of axes that are parallel to the last digit, and their direction, unit.

    The direction is the eigenvector of N with the smallest eigenvalue; p minimises the sum of squares across it.
    """
    with localcontext(CONTEXT):
        rows = _adjugate(equations.n)
        # Where N is singular, its adjugate is v v' times a number; else inverse iteration by the adjugate finds v.
        v = max(rows, key=lambda row: dot(row, row))
        for _ in range(_TURNS):
            v = (dot(rows[0], v), dot(rows[1], v), dot(rows[2], v))
            length = dot(v, v).sqrt()
            v = (v[0] / length, v[1] / length, v[2] / length)
        # N + s v v' is as good as N across v, and along v the right side is made nought.
        s = equations.n[0] + equations.n[3] + equations.n[5]
        x, y, z = v
        squares = (x * x, x * y, x * z, y * y, y * z, z * z)
        xx, xy, xz, yy, yz, zz = (own + s * more for own, more in zip(equations.n, squares, strict=True))
        across = along(equations.h, -dot(v, equations.h), v)
        return solve(replace(equations, n=(xx, xy, xz, yy, yz, zz), h=across)), v


def nearest(equations: System, triangle: Triangle) -> tuple[Decimal, Vector]:
    """Minimise the sum of squares over a triangle: the stationary point of its plane, else the best of its edges.

    The sum is convex, so a stationary point inside is the minimum; else it lies on the rim.
    """
    with localcontext(CONTEXT):
        corner, second, third = triangle
        e, g = minus(second, corner), minus(third, corner)
        ne, ng = equations.times(e), equations.times(g)
        slope = minus(equations.times(corner), equations.h)
        ee, eg, gg, e0, g0 = dot(e, ne), dot(e, ng), dot(g, ng), dot(e, slope), dot(g, slope)
        determinant = ee * gg - eg * eg
        if determinant > 0:
            s, t = (eg * g0 - gg * e0) / determinant, (eg * e0 - ee * g0) / determinant
            if s >= 0 and t >= 0 and s + t <= 1:
                point = along(along(corner, s, e), t, g)
                return equations.value(point), point
        points = (_on_edge(equations, one, two) for one, two in ((corner, second), (second, third), (third, corner)))
        return min(((equations.value(point), point) for point in points), key=lambda found: found[0])


def _on_edge(equations: System, one: Vector, two: Vector) -> Vector:
    edge = minus(two, one)
    stretched = equations.times(edge)
    curvature = dot(edge, stretched)
    slope = dot(stretched, one) - dot(edge, equations.h)
    share = min(max(-slope / curvature, _ZERO), _ONE) if curvature > 0 else _ZERO
    return along(one, share, edge)


def best(equations: System, triangles: Sequence[Triangle]) -> Vector:
    """Return the point with the smallest sum of squares on any of `triangles`."""
    return min((nearest(equations, triangle) for triangle in triangles), key=lambda found: found[0])[1]


def _near_best(values: Sequence[Decimal], margin: float) -> list[int]:
    """Return the places of the `values` whose root is within twice `margin` of the smallest one's."""
    with localcontext(CONTEXT):
        roots = [max(value, _ZERO).sqrt() for value in values]
        limit = min(roots) + 2 * Decimal(margin)
        return [place for place, root in enumerate(roots) if root <= limit]


def _margin(readings: Readings, mesh: Mesh) -> float:
    """Return by how much the root of a sum of squares may move in a draw."""
    levers = np.linalg.norm(readings.moments, axis=1) / np.linalg.norm(readings.forces, axis=1)
    reach = float(np.abs(mesh.vertices).max() + np.abs(readings.poses[:, :3, 3]).max() + levers.max())
    weights = readings.responses / readings.strongest
    return _MARGIN * reach * float(np.sqrt(weights @ weights))


def _facing(mesh: Mesh, push: Vector) -> IntArray:
    """Return the triangles that the push can act on, as the program defines it: push . normal < -`GRAZING`."""
    rough = np.array([float(one) for one in push])
    corners = mesh.corners
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1) * np.linalg.norm(rough)
    cosines = np.divide(normals @ rough, lengths, out=np.zeros(len(normals)), where=lengths > 0)
    for triangle in np.flatnonzero(np.abs(cosines) < _SURE):
        cosines[triangle] = _faces(push, exactly(corners[triangle]))
    return np.flatnonzero(cosines < -GRAZING)


def _faces(push: Vector, triangle: Triangle) -> float:
    """Return push . normal of a triangle, both unit; zero for one without area."""
    with localcontext(CONTEXT):
        corner, second, third = triangle
        normal = cross(minus(second, corner), minus(third, corner))
        lengths = dot(normal, normal) * dot(push, push)
        return float(dot(normal, push) / lengths.sqrt()) if lengths > 0 else 0.0


def _first_order(readings: Readings, equations: System, answer: Vector, draws: int, rng: np.random.Generator) -> float:
    """Return the largest change of the exact answer over the draws by its derivative.

    For a sensor in the link frame and weights of 1: the answer has sum w f x r = 0 with r = f x p + m and w = 1/|f|^2, so
    it changes by N^-1 times the change of that sum. What is left out is of the second order: 1e-16 of the change.
    """
    p = np.array([float(one) for one in answer])
    xx, xy, xz, yy, yz, zz = (float(one) for one in equations.n)
    inverse = np.linalg.inv(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    f, m = readings.forces, readings.moments
    w = 1.0 / np.sum(f * f, axis=1, keepdims=True)
    r = np.cross(f, p) + m
    effects: list[FloatArray] = []
    for unit in np.eye(3):
        df = np.spacing(np.abs(f @ unit))[:, None] * unit
        dm = np.spacing(np.abs(m @ unit))[:, None] * unit
        dw = -2.0 * w * w * np.sum(f * df, axis=1, keepdims=True)
        effects.append((dw * np.cross(f, r) + w * (np.cross(df, r) + np.cross(f, np.cross(df, p)))) @ inverse)
        effects.append(w * np.cross(f, dm) @ inverse)
    return _drawn(np.concatenate(effects), draws, rng)


def _drawn(effects: FloatArray, draws: int, rng: np.random.Generator) -> float:
    """Return the largest length over `draws` of the sum of `effects` (n, 3), each up or down."""
    scale = float(np.abs(effects).max())
    # Seven digits of a change are plenty, and twice as fast.
    scaled = (effects / scale).astype(np.float32)
    up = np.zeros((draws, 3))
    for first in range(0, len(scaled), _AT_ONCE):
        part = scaled[first : first + _AT_ONCE]
        bits = np.unpackbits(np.frombuffer(rng.bytes(draws * -(-len(part) // 8)), dtype=np.uint8).reshape(draws, -1), axis=1)
        up += bits[:, : len(part)].astype(np.float32) @ part
    # Those up less those down are twice those up less all.
    return scale * float(np.linalg.norm(2.0 * up - np.sum(effects / scale, axis=0), axis=1).max())
