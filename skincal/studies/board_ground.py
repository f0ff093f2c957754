"""Where a board's pads lie, in 80 digits: in its own plane, or at the ends of straight ways over a mesh.

A way is walked in space: at an edge its direction keeps its share along the edge, and its share across the edge is carried from
the one triangle's plane into the other's. Past the rim it goes on in the last triangle's plane. Turns are in radians.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from typing import Protocol, TypeAlias

from skincal.geometry.arrays import FloatArray
from skincal.modules.pose import ModulePoses
from skincal.studies.cases import Mesh
from skincal.studies.exact import Triangle, Vector, along, cross, dot, minus, times, vector

Row: TypeAlias = list[Decimal]
_ZERO, _ONE = Decimal(0), Decimal(1)
_CROSSINGS_MAX = 1000


@dataclass(frozen=True, slots=True)
class ExactPads:
    """Where pads lie."""

    points: tuple[Vector, ...]
    changes: tuple[tuple[Vector, ...], ...]
    """Of each pad, with each unknown."""
    normals: tuple[Vector, ...]


class ExactGround(Protocol):
    """A board's pose, and what it lies on."""

    def pads(self) -> ExactPads:
        """Return where its pads lie."""
        ...

    def moved(self, step: Row) -> ExactGround:
        """Return the pose after a step of the unknowns; any way to take it is right, since only its end is asked for."""
        ...

    def given(self, flat: FloatArray, vertices: FloatArray | None) -> ExactGround:
        """Return the same pose of a board with its pads elsewhere, on a mesh with its vertices elsewhere."""
        ...


@dataclass(frozen=True, slots=True)
class InPlane:
    """A flat board anywhere: a shift and a turn about its origin."""

    origin: Vector
    x: Vector
    normal: Vector
    flat: tuple[tuple[Decimal, Decimal], ...]

    @classmethod
    def begin(cls, at: ModulePoses, flat: FloatArray) -> InPlane:
        """Return the board at one pose, its directions made orthonormal."""
        normal = unit(vector(at.normals[0]))
        return cls(vector(at.points[0]), unit(_beside(vector(at.x[0]), normal)), normal, _exact(flat))

    def pads(self) -> ExactPads:
        """Return where its pads lie: dP = dt + w x arm."""
        y = cross(self.normal, self.x)
        arms = [along(times(a, self.x), b, y) for a, b in self.flat]
        axes = [vector([float(i == j) for i in range(3)]) for j in range(3)]
        return ExactPads(
            tuple(along(self.origin, _ONE, arm) for arm in arms),
            tuple((*axes, *(cross(axis, arm) for axis in axes)) for arm in arms),
            (self.normal,) * len(arms),
        )

    def moved(self, step: Row) -> InPlane:
        """Return the board, shifted and turned by the quaternion 1, w/2."""
        shift, turn = _three(step[:3]), _three([one / 2 for one in step[3:]])
        x, normal = (_turned(v, turn) for v in (self.x, self.normal))
        return replace(self, origin=along(self.origin, _ONE, shift), x=x, normal=normal)

    def given(self, flat: FloatArray, vertices: FloatArray | None) -> InPlane:
        """Return the same pose with other pads."""
        assert vertices is None
        return replace(self, flat=_exact(flat))


def _three(row: Sequence[Decimal]) -> Vector:
    x, y, z = row
    return x, y, z


def _turned(v: Vector, q: Vector) -> Vector:
    """Return v turned by the quaternion 1, q, whatever its length."""
    # v + 2 (q x v + q x (q x v))/(1 + q.q)
    once = cross(q, v)
    return along(v, 2 / (1 + dot(q, q)), along(once, _ONE, cross(q, once)))


def unit(v: Vector) -> Vector:
    """Return `v` at length 1."""
    return times(_ONE / dot(v, v).sqrt(), v)


def _beside(v: Vector, normal: Vector) -> Vector:
    return along(v, -dot(v, normal), normal)


def _exact(flat: FloatArray) -> tuple[tuple[Decimal, Decimal], ...]:
    return tuple((Decimal(a), Decimal(b)) for a, b in flat.tolist())


@dataclass(slots=True)
class ExactMesh:
    """A mesh to walk on; triangles are worked out as they are reached, with one root each."""

    mesh: Mesh
    over: dict[tuple[int, int], int]
    """The triangle that has an edge in this sense."""
    known: dict[int, tuple[Triangle, Vector, tuple[Vector, ...]]] = field(
        default_factory=dict[int, tuple[Triangle, Vector, tuple[Vector, ...]]]
    )

    def triangle(self, at: int) -> tuple[Triangle, Vector, tuple[Vector, ...]]:
        """Return a triangle's corners, its normal, and of each side a vector out of it in its plane, as long as the side."""
        if at not in self.known:
            a, b, c = (vector(corner) for corner in self.mesh.vertices[self.mesh.triangles[at]])
            normal = unit(cross(minus(b, a), minus(c, a)))
            out = tuple(cross(minus(q, p), normal) for p, q in ((a, b), (b, c), (c, a)))
            self.known[at] = (a, b, c), normal, out
        return self.known[at]

    def behind(self, at: int, side: int) -> int | None:
        """Return the triangle behind a side; None at the rim."""
        corners = self.mesh.triangles[at].tolist()
        return self.over.get((corners[(side + 1) % 3], corners[side]))

    def side_with(self, there: int, here: int, side: int) -> int:
        """Return which side of the triangle `there` is a side of `here`."""
        corners: list[int] = self.mesh.triangles[there].tolist()
        return corners.index(int(self.mesh.triangles[here][(side + 1) % 3]))


def neighbours_of(mesh: Mesh) -> dict[tuple[int, int], int]:
    """Return for each edge, as it runs round its triangle, that triangle."""
    return {(corners[i], corners[(i + 1) % 3]): at for at, corners in enumerate(mesh.triangles.tolist()) for i in range(3)}


@dataclass(frozen=True, slots=True)
class OnMesh:
    """A board on a mesh: a place on it, and a turn in its plane."""

    mesh: ExactMesh
    at: int
    origin: Vector
    x: Vector
    flat: tuple[tuple[Decimal, Decimal], ...]

    @classmethod
    def begin(cls, at: ModulePoses, flat: FloatArray, mesh: Mesh) -> OnMesh:
        """Return the board at one pose, brought into the plane of its triangle."""
        exact, number = ExactMesh(mesh, neighbours_of(mesh)), int(at.triangles[0])
        (corner, _, _), normal, _ = exact.triangle(number)
        origin = along(corner, _ONE, _beside(minus(vector(at.points[0]), corner), normal))
        return cls(exact, number, origin, unit(_beside(vector(at.x[0]), normal)), _exact(flat))

    def pads(self) -> ExactPads:
        """Return the ends of the ways: dP = da x + db y + dtheta (bx y - by x), with x, y as carried there."""
        points: list[Vector] = []
        changes: list[tuple[Vector, ...]] = []
        normals: list[Vector] = []
        for a, b in self.flat:
            at, point, x = self._walked(a, b)
            normal = self.mesh.triangle(at)[1]
            y = cross(normal, x)
            points.append(point)
            changes.append((x, y, along(times(a, y), -b, x)))
            normals.append(normal)
        return ExactPads(tuple(points), tuple(changes), tuple(normals))

    def moved(self, step: Row) -> OnMesh:
        """Return the board after its way, turned by the angle whose tangent is the last unknown."""
        at, point, x = self._walked(step[0], step[1])
        y = cross(self.mesh.triangle(at)[1], x)
        return replace(self, at=at, origin=point, x=unit(along(x, step[2], y)))

    def given(self, flat: FloatArray, vertices: FloatArray | None) -> OnMesh:
        """Return the board at the same shares of its triangle's sides, which moved."""
        assert vertices is not None
        mesh = ExactMesh(replace(self.mesh.mesh, vertices=vertices), self.mesh.over)
        old, new = self.mesh.triangle(self.at)[0], mesh.triangle(self.at)[0]
        origin = along(new[0], _ONE, _carried(minus(self.origin, old[0]), old, new))
        return OnMesh(mesh, self.at, origin, unit(_carried(self.x, old, new)), _exact(flat))

    def _walked(self, a: Decimal, b: Decimal) -> tuple[int, Vector, Vector]:
        """Return the triangle, the place and the carried x at the end of a way."""
        at, place, x, came = self.at, self.origin, self.x, None
        left = (a * a + b * b).sqrt()
        if not left:
            return at, place, x
        ahead = along(times(a / left, x), b / left, cross(self.mesh.triangle(at)[1], x))
        for _ in range(_CROSSINGS_MAX):
            corners, _, out = self.mesh.triangle(at)
            way, side = _exit(corners, out, place, ahead, came)
            over = self.mesh.behind(at, side)
            if way >= left or over is None:
                return at, along(place, left, ahead), x
            place, left = along(place, way, ahead), left - way
            edge = minus(corners[(side + 1) % 3], corners[side])
            square = dot(edge, edge)
            came = self.mesh.side_with(over, at, side)
            inward = times(-_ONE, self.mesh.triangle(over)[2][came])
            ahead, x = (along(times(dot(v, edge) / square, edge), dot(v, out[side]) / square, inward) for v in (ahead, x))
            at = over
        raise ArithmeticError("A way over the mesh goes round in circles.")


def _carried(v: Vector, old: Triangle, new: Triangle) -> Vector:
    """Return a vector in the plane of a triangle, carried along as its sides move."""
    e, g = minus(old[1], old[0]), minus(old[2], old[0])
    ee, eg, gg, ev, gv = dot(e, e), dot(e, g), dot(g, g), dot(e, v), dot(g, v)
    determinant = ee * gg - eg * eg
    s, t = (gg * ev - eg * gv) / determinant, (ee * gv - eg * ev) / determinant
    return along(times(s, minus(new[1], new[0])), t, minus(new[2], new[0]))


def _exit(corners: Triangle, out: Sequence[Vector], place: Vector, ahead: Vector, came: int | None) -> tuple[Decimal, int]:
    """Return how far it is to the side by which a way leaves a triangle, and which."""
    found: list[tuple[Decimal, int]] = []
    for side in range(3):
        rate = dot(out[side], ahead)
        if side != came and rate > 0:
            found.append((dot(out[side], minus(corners[side], place)) / rate, side))
    return min(found)
