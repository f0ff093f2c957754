"""Pokes as lines in space: the wrench and the arm pose of each poke, and its force axis in the link frame.

The sensor's frame may lie elsewhere in the link frame at each poke: an arm moves it, and so would a sensor on the tool. So each
poke has its own `link_from_sensor`, and what depends on it is computed once.

Shapes are written for n pokes. `pokes[rows]` selects some of them, by a slice, indices or a mask. `pokes[i]` is a single one:
its arrays lack the first axis, and all that is computed from them does, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Protocol, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray, axis_point, crossed, move_wrench, pitch, select_rows

NameArray: TypeAlias = NDArray[np.str_]


class MeasuredPoke(Protocol):
    """A poke with a wrench, if it was still and the arm pose is known: an outcome of the detector."""

    @property
    def poke(self) -> int: ...
    @property
    def force(self) -> FloatArray | None: ...
    @property
    def moment(self) -> FloatArray | None: ...
    @property
    def link_from_sensor(self) -> FloatArray | None: ...
    @property
    def pose(self) -> str: ...


def _lengths(vectors: FloatArray) -> FloatArray:
    """Compute the lengths (...) of vectors (..., 3): those of `np.linalg.norm` for one vector, to the last bit."""
    return np.sqrt(np.vecdot(vectors, vectors))


@dataclass(frozen=True, eq=False)
class Pokes:
    """n pokes as the rig reports them, or as a correction changes them."""

    number: IntArray
    """(n,) numbers in the session."""
    force: FloatArray
    """(n, 3) float, N, tared, sensor frame, force on the part."""
    moment: FloatArray
    """(n, 3) float, N m, tared, about the sensor's origin."""
    link_from_sensor: FloatArray
    """(n, 4, 4) float, metres: pose of the sensor in the link frame at each poke."""
    pose: NameArray
    """(n,) names of the arm poses."""

    def __post_init__(self) -> None:
        # Sums over contiguous rows have the same bits in every process.
        for each in fields(self):
            value: Any = getattr(self, each.name)
            if np.ndim(value):
                frozen: NDArray[Any] = np.asarray(value, order="C").view()
                frozen.flags.writeable = False
                object.__setattr__(self, each.name, frozen)

    def __reduce__(self) -> tuple[type[Self], tuple[Any, ...]]:
        """Pickle the given arrays: they are read-only in another process too, and nothing computed travels."""
        return type(self), tuple(getattr(self, each.name) for each in fields(self))

    @staticmethod
    def collect(measured: Iterable[MeasuredPoke]) -> Pokes:
        """Collect pokes; those without a wrench are left out."""
        known = [
            (each.poke, each.force, each.moment, each.link_from_sensor, each.pose)
            for each in measured
            if each.force is not None and each.moment is not None and each.link_from_sensor is not None
        ]
        number, force, moment, pose, name = zip(*known, strict=True) if known else ((),) * 5
        return Pokes(
            np.array(number, dtype=np.int64),
            np.array(force, dtype=np.float64).reshape(-1, 3),
            np.array(moment, dtype=np.float64).reshape(-1, 3),
            np.array(pose, dtype=np.float64).reshape(-1, 4, 4),
            np.array(name, dtype=np.str_),
        )

    @classmethod
    def concatenate(cls, parts: Sequence[Self]) -> Self:
        """Join one or more groups of pokes."""
        return cls(*(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(cls)))

    def __len__(self) -> int:
        return len(self.number)

    def __getitem__(self, rows: int | slice | Sequence[int] | NDArray[Any]) -> Self:
        """Select pokes; an index gives a single poke, without the first axis."""
        return select_rows(self, rows)

    def __iter__(self) -> Iterator[Self]:
        return (self[row] for row in range(len(self)))

    @cached_property
    def wrench(self) -> FloatArray:
        """(n, 6) float, N and N m, sensor frame: force, then moment."""
        return np.concatenate([self.force, self.moment], axis=-1)

    @cached_property
    def force_size(self) -> FloatArray:
        """(n,) float, N: |f|."""
        return _lengths(self.force)

    @cached_property
    def _in_link(self) -> tuple[FloatArray, FloatArray]:
        return move_wrench(self.link_from_sensor, self.force, self.moment)

    @property
    def link_force(self) -> FloatArray:
        """(n, 3) float, N, link frame."""
        return self._in_link[0]

    @property
    def sensor(self) -> FloatArray:
        """(n, 3) float, metres, link frame: the sensor's origin."""
        return self.link_from_sensor[..., :3, 3]

    @cached_property
    def direction(self) -> FloatArray:
        """(n, 3) float, unit, link frame: along the push. The force is not zero."""
        return self.link_force / _lengths(self.link_force)[..., None]

    @cached_property
    def axis_point(self) -> FloatArray:
        """(n, 3) float, metres, link frame: the force axis's point nearest to the origin. The force is not zero."""
        return axis_point(*self._in_link)

    @cached_property
    def pitch(self) -> FloatArray:
        """(n,) float, metres: f . m/|f|^2, zero for a single contact without torque (eq. 3)."""
        return pitch(self.force, self.moment)

    def miss(self, points: FloatArray) -> FloatArray:
        """Compute the distance (n,) of each force axis from `points` (n, 3) or (3,), metres, link frame."""
        return _lengths(crossed(points - self.axis_point, self.direction))

    def tilt(self, normals: FloatArray) -> FloatArray:
        """Compute the angle (n,) between each push and the inward normal, rad; `normals` is (n, 3) or (3,), unit, outward."""
        return np.arccos(np.clip(-np.vecdot(self.direction, normals), -1.0, 1.0))


@dataclass(frozen=True, eq=False)
class LandmarkPokes(Pokes):
    """Pokes at known points of the part: at its landmarks. No taxel needs to answer."""

    name: NameArray
    """(n,) names of the landmarks."""
    place: FloatArray
    """(n, 3) float, metres, link frame: of the landmarks."""

    @staticmethod
    def at(pokes: Pokes, names: Sequence[str], places: Sequence[FloatArray]) -> LandmarkPokes:
        """Tell pokes the landmark of each, (3,) float, metres, link frame."""
        return LandmarkPokes(
            pokes.number,
            pokes.force,
            pokes.moment,
            pokes.link_from_sensor,
            pokes.pose,
            np.array(names, dtype=np.str_),
            np.array(places, dtype=np.float64).reshape(-1, 3),
        )

    @cached_property
    def landmark_miss(self) -> FloatArray:
        """(n,) float, metres: distance of each force axis from its landmark."""
        return self.miss(self.place)


NO_LANDMARK_POKES = LandmarkPokes.at(Pokes.collect(()), (), ())
