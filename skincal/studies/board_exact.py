"""A module's pose in 80 digits, from the numbers as they were read: where a search by Gauss and Newton's steps must end.

A poke (f, m), carried into the link frame, is a line along u = f/|f| through a = u x m/|f|; it passes the middle c of the pads
that answered by E (a - c), with E any two orthonormal directions across u. By the definition in `pose_fit.py` that has the
covariance D = E N E' + s^2 (I - o o'), o = E n: since E (c - a) is v.rho for each e of E, v = u x e and rho = u x (c - a),

    D_ij = v_i' ((sm/|f|)^2 I + (sf/|f|)^2 S(l) S(l)') v_j + s^2 (e_i.e_j - (e_i.n) (e_j.n)),   l = c - the sensor's origin.

The pose p is the one with g(p) = sum (E dc/dp)' D^-1 E (a - c) = 0, D as it is there. It is found by Newton's method from
where the pokes were made, its matrix from differences of g in 80 digits, so that no second derivative is worked out by hand.
Nothing is taken from the solvers but what `touches.py` counts a poke for. Where pads lie on a mesh: `board_ground.py`.

The draws take one such step from the exact pose, with the moved inputs: first order, 1e-16 of the change is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Context, Decimal, localcontext

import numpy as np

from skincal.model.scene import NoiseSettings
from skincal.modules.pose_fit import ACROSS, MIDDLE
from skincal.studies.board_cases import BoardCase, BoardReadings
from skincal.studies.board_ground import ExactGround, ExactPads, InPlane, OnMesh, Row
from skincal.studies.cases import moved
from skincal.studies.exact import CONTEXT, Vector, along, cross, distance, dot, minus, times, vector
from skincal.taxels.result import MISS_MAX, SD_MAX

_ZERO, _ONE = Decimal(0), Decimal(1)
_OF_DRAWS = Context(prec=48, Emin=-999999, Emax=999999)
"""Of a change by the inputs' last digit, 1e-16, ten digits are left where axes lie within 1e-6 rad."""
_STEP = Decimal("1e-30")
"""Of a difference: 50 digits of a derivative are left."""
_NONE = Decimal("1e-26")
"""Share of the largest curvature below which there is none: what is left of it by differences."""
_TRACE = Decimal("1e-32")
"""Share of the largest information that is added to all, so that what is not determined has a variance: an immense one."""
_FOUND = Decimal("1e-34")
"""m: a step below it leaves 1e-60."""
_FAR = Decimal("0.02")
"""m, or rad: of one step."""
_STEPS_MAX = 60
_KNOWN = 1e5
"""m: a pad whose place is known worse than this is not known at all."""


@dataclass(frozen=True, slots=True)
class Poke:
    """What one poke says of its module, whatever its pose."""

    answers: tuple[tuple[int, Decimal], ...]
    """Pads that answered, and their shares of the middle."""
    u: Vector
    a: Vector
    pair: tuple[Vector, Vector]
    sensor: Vector
    moment: Decimal
    """m^2: (sm/|f|)^2."""
    force: Decimal
    """(sf/|f|)^2."""
    offset: Decimal
    """m^2: s^2."""


@dataclass(frozen=True, slots=True)
class BoardTruth:
    """The exact places of a module's pads, and how far they move when the inputs' last digits do."""

    pads: tuple[Vector, ...]
    changes: tuple[float, ...]
    """m, of each pad the largest over the draws."""
    determined: tuple[bool, ...]
    """Whether the pokes determine the pad's place at all, however badly."""
    blind: tuple[bool, ...]
    """Whether it must be called blind: known worse than `SD_MAX`, or missed by the axes by more than `MISS_MAX`."""


def pokes_of(readings: BoardReadings, noise: NoiseSettings) -> list[Poke]:
    """Return the pokes in 80 digits."""
    poses = [(tuple(map(vector, pose[:3, :3])), vector(pose[:3, 3])) for pose in readings.poses]
    pose_of: list[int] = readings.pose_of.tolist()
    forces: list[list[float]] = readings.forces.tolist()
    moments: list[list[float]] = readings.moments.tolist()
    responses: list[list[float]] = readings.responses.tolist()
    beside: list[float] = readings.beside.tolist()
    rows = zip(forces, moments, responses, beside, pose_of, strict=True)
    return [_poke(vector(f), vector(m), answers, other, *poses[pose], noise) for f, m, answers, other, pose in rows]


def _poke(
    f: Vector, m: Vector, answers: Sequence[float], beside: float, turn: tuple[Vector, ...], shift: Vector, noise: NoiseSettings
) -> Poke:
    x, y, z = turn
    f, m = (dot(x, f), dot(y, f), dot(z, f)), (dot(x, m), dot(y, m), dot(z, m))
    # About the link's origin, eq. (6).
    m = along(cross(shift, f), _ONE, m)
    size = dot(f, f).sqrt()
    u = times(_ONE / size, f)
    own = {pad: Decimal(answer) for pad, answer in enumerate(answers) if answer}
    total = sum(own.values(), _ZERO)
    offset = (Decimal(MIDDLE) * Decimal(noise.contact) / len(own)) ** 2 + (Decimal(ACROSS) ** 2 if beside else _ZERO)
    return Poke(
        tuple((pad, answer / total) for pad, answer in own.items()), u, times(_ONE / size, cross(u, m)), _across(u), shift,
        (Decimal(noise.moment) / size) ** 2, (Decimal(noise.force) / size) ** 2, offset,
    )  # fmt: skip


def _across(u: Vector) -> tuple[Vector, Vector]:
    """Return two orthonormal directions across u."""
    least = min(range(3), key=lambda i: abs(u[i]))
    axis = vector([float(i == least) for i in range(3)])
    first = cross(u, axis)
    first = times(_ONE / dot(first, first).sqrt(), first)
    return first, cross(u, first)


def _two(poke: Poke, v: Vector) -> tuple[Decimal, Decimal]:
    return dot(poke.pair[0], v), dot(poke.pair[1], v)


def _middle(poke: Poke, pads: ExactPads) -> tuple[Vector, tuple[Vector, ...], Vector]:
    """Return the middle of the pads that answered, its change with each unknown, and the normal there."""
    zero = (_ZERO, _ZERO, _ZERO)
    place, normal, changes = zero, zero, [zero] * len(pads.changes[0])
    for pad, share in poke.answers:
        place, normal = along(place, share, pads.points[pad]), along(normal, share, pads.normals[pad])
        changes = [along(sum_, share, one) for sum_, one in zip(changes, pads.changes[pad], strict=True)]
    return place, tuple(changes), times(_ONE / dot(normal, normal).sqrt(), normal)


def _weight(poke: Poke, place: Vector, normal: Vector) -> tuple[Decimal, Decimal, Decimal]:
    """Return D^-1, its entries xx, xy, yy."""
    lever = minus(place, poke.sensor)
    square = dot(lever, lever)
    v = [cross(poke.u, one) for one in poke.pair]
    swing, out = [dot(lever, one) for one in v], _two(poke, normal)
    even = poke.moment + poke.force * square + poke.offset
    xx, yy = (even - poke.force * swing[i] ** 2 - poke.offset * out[i] ** 2 for i in range(2))
    xy = -poke.force * swing[0] * swing[1] - poke.offset * out[0] * out[1]
    determinant = xx * yy - xy * xy
    return yy / determinant, -xy / determinant, xx / determinant


def pull(pokes: Sequence[Poke], pads: ExactPads) -> Row:
    """Return g: how the pokes pull at each unknown."""
    total = [_ZERO] * len(pads.changes[0])
    for poke in pokes:
        place, changes, normal = _middle(poke, pads)
        xx, xy, yy = _weight(poke, place, normal)
        off = _two(poke, minus(poke.a, place))
        one, two = xx * off[0] + xy * off[1], xy * off[0] + yy * off[1]
        force = along(times(one, poke.pair[0]), two, poke.pair[1])
        total = [sum_ + dot(force, change) for sum_, change in zip(total, changes, strict=True)]
    return total


def information(pokes: Sequence[Poke], pads: ExactPads) -> list[Row]:
    """Return sum (E dc/dp)' D^-1 E dc/dp, the inverse of the unknowns' covariance."""
    count = len(pads.changes[0])
    total = [[_ZERO] * count for _ in range(count)]
    for poke in pokes:
        place, changes, normal = _middle(poke, pads)
        xx, xy, yy = _weight(poke, place, normal)
        rows = [_two(poke, change) for change in changes]
        for i, (a, b) in enumerate(rows):
            for j, (c, d) in enumerate(rows):
                total[i][j] += a * (xx * c + xy * d) + b * (xy * c + yy * d)
    return total


def solved(matrix: Sequence[Row], right: Row, none: Decimal = _NONE) -> Row:
    """Return a solution of the linear equations, by elimination with full pivots; nought of what they do not determine.

    Parameters
    ----------
    none : share of the largest number below which a pivot determines nothing
    """
    rows = [[*row, number] for row, number in zip(matrix, right, strict=True)]
    count = len(rows)
    order: list[int] = []
    least = none * max(abs(number) for row in matrix for number in row)
    for k in range(count):
        places = ((i, j) for i in range(k, count) for j in range(count) if j not in order)
        top, pivot = max(places, key=lambda at: abs(rows[at[0]][at[1]]))
        if abs(rows[top][pivot]) <= least:
            break
        rows[k], rows[top] = rows[top], rows[k]
        order.append(pivot)
        for i in range(k + 1, count):
            share = rows[i][pivot] / rows[k][pivot]
            rows[i] = [a - share * b for a, b in zip(rows[i], rows[k], strict=True)]
    found = [_ZERO] * count
    for k, pivot in reversed(list(enumerate(order))):
        rest = sum((rows[k][j] * found[j] for j in order[k + 1 :]), _ZERO)
        found[pivot] = (rows[k][count] - rest) / rows[k][pivot]
    return found


def _curvature(pokes: Sequence[Poke], ground: ExactGround) -> list[Row]:
    """Return -dg/dp by differences."""
    here = pull(pokes, ground.pads())
    count = len(here)
    columns: list[Row] = []
    for unknown in range(count):
        there = pull(pokes, ground.moved([_STEP if i == unknown else _ZERO for i in range(count)]).pads())
        columns.append([(a - b) / _STEP for a, b in zip(here, there, strict=True)])
    return [[columns[j][i] for j in range(count)] for i in range(count)]


def find(pokes: Sequence[Poke], ground: ExactGround) -> tuple[ExactGround, list[Row]]:
    """Return the pose where the pokes' pulls cancel, nearest to `ground` as Newton goes, and -dg/dp there."""
    matrix, last = information(pokes, ground.pads()), Decimal(1)
    for _ in range(_STEPS_MAX):
        step = solved(matrix, pull(pokes, ground.pads()))
        size = max(abs(one) for one in step)
        if size > _FAR:
            step = [one * _FAR / size for one in step]
        ground = ground.moved(step)
        if size < _FOUND:
            return ground, matrix
        # Once its differences are told to a millionth, the matrix serves to the end: each step gains as many digits.
        if last > Decimal("1e-6"):
            matrix = _curvature(pokes, ground)
        last = size
    raise ArithmeticError("Newton's method does not converge from where the pokes were made.")


def find_board_truth(case: BoardCase, draws: int, rng: np.random.Generator) -> BoardTruth:
    """Return the exact answer of a case and how far its pads move over draws of the inputs' last digits."""
    with localcontext(CONTEXT):
        pokes = pokes_of(case.readings, case.noise)
        ground = _ground(case)
        if case.lost:
            return _said(pokes, ground, [0.0] * len(case.board.flat))
        ground, matrix = find(pokes, ground)
        changes = [0.0] * len(case.board.flat)
        with localcontext(_OF_DRAWS):
            pads = ground.pads()
            for _ in range(draws):
                changes = [max(pair) for pair in zip(changes, _drawn(case, ground, matrix, pads, rng), strict=True)]
        return _said(pokes, ground, changes)


def _ground(case: BoardCase) -> ExactGround:
    if case.board.mesh is None:
        return InPlane.begin(case.board.at, case.board.flat)
    return OnMesh.begin(case.board.at, case.board.flat, case.board.mesh)


def _drawn(
    case: BoardCase, ground: ExactGround, matrix: Sequence[Row], pads: ExactPads, rng: np.random.Generator
) -> list[float]:
    """Return how far each pad moves in one draw."""
    mesh = case.board.mesh
    other = ground.given(moved(case.board.flat, rng), None if mesh is None else moved(mesh.vertices, rng))
    there = other.pads()
    step = solved(matrix, pull(pokes_of(case.readings.moved(rng), case.noise), there))
    changes: list[float] = []
    for old, new, slopes in zip(pads.points, there.points, there.changes, strict=True):
        for share, slope in zip(step, slopes, strict=True):
            new = along(new, share, slope)
        changes.append(distance(old, new))
    return changes


def _said(pokes: Sequence[Poke], ground: ExactGround, changes: Sequence[float]) -> BoardTruth:
    pads = ground.pads()
    matrix = information(pokes, pads)
    count = len(matrix)
    trace = _TRACE * max(abs(matrix[i][i]) for i in range(count))
    matrix = [[number + (trace if i == j else _ZERO) for j, number in enumerate(row)] for i, row in enumerate(matrix)]
    inverse = [solved(matrix, [_ONE if i == j else _ZERO for i in range(count)], _ZERO) for j in range(count)]
    sds = [_sd(slopes, inverse) for slopes in pads.changes]
    squares = [dot(off, off) for off in (_off(poke, pads) for poke in pokes)]
    missed = float((sum(squares, _ZERO) / len(squares)).sqrt()) > MISS_MAX
    return BoardTruth(pads.points, tuple(changes), tuple(sd < _KNOWN for sd in sds), tuple(missed or sd > SD_MAX for sd in sds))


def _off(poke: Poke, pads: ExactPads) -> Vector:
    """Return from the middle straight to the axis."""
    away = minus(poke.a, _middle(poke, pads)[0])
    return along(away, -dot(away, poke.u), poke.u)


def _sd(slopes: Sequence[Vector], inverse: Sequence[Row]) -> float:
    """Return the standard deviation of a pad's place in its worst direction, m."""
    covariance = np.array(
        [
            [
                float(sum(a[i] * inverse[k][j] * b[m] for k, a in enumerate(slopes) for j, b in enumerate(slopes)))
                for m in range(3)
            ]
            for i in range(3)
        ]
    )
    return float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
