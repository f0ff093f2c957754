"""Pokes as geometry: where a tip presses, which way and how hard."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class PressedPlaces:
    """n places pressed, link frame."""

    targets: IntArray
    """(n,) channel that was aimed at."""
    points: FloatArray
    """(n, 3) float, metres: the middle of the tip, on the skin."""
    normals: FloatArray
    """(n, 3) float, unit, outward, of the skin at the point."""
    directions: FloatArray
    """(n, 3) float, unit: which way the tip pushes the part."""
    forces: FloatArray
    """(n,) float, N, while held."""
    turns: FloatArray
    """(n,) float, radians: how the square tip is turned about the normal."""

    def __len__(self) -> int:
        """Return the number of places."""
        return len(self.targets)

    def take(self, rows: slice | IntArray) -> PressedPlaces:
        """Return some of the places."""
        return PressedPlaces(
            targets=self.targets[rows],
            points=self.points[rows],
            normals=self.normals[rows],
            directions=self.directions[rows],
            forces=self.forces[rows],
            turns=self.turns[rows],
        )


def join(parts: list[PressedPlaces]) -> PressedPlaces:
    """Return all places of several as one."""
    return PressedPlaces(
        np.concatenate([p.targets for p in parts]),
        np.concatenate([p.points for p in parts]),
        np.concatenate([p.normals for p in parts]),
        np.concatenate([p.directions for p in parts]),
        np.concatenate([p.forces for p in parts]),
        np.concatenate([p.turns for p in parts]),
    )


def tangents(normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit directions in the plane of the skin: e1 along the link's x where that is in the plane, e2 = n x e1.

    Where the normal lies within 26 degrees of x, y takes its place.

    Parameters
    ----------
    normals : (n, 3) float, unit, outward
    """
    steep = np.abs(normals[:, 0]) > 0.9
    axes = np.where(steep[:, None], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0])
    e1: FloatArray = axes - np.sum(axes * normals, axis=1, keepdims=True) * normals
    e1 /= np.linalg.norm(e1, axis=1, keepdims=True)
    return e1, np.asarray(np.cross(normals, e1), dtype=np.float64)


def push_directions(normals: FloatArray, tilts: FloatArray, azimuths: FloatArray) -> FloatArray:
    """Return unit pushes that lean from the inward normal by `tilts`, towards `azimuths` counted from e1 to e2.

    Parameters
    ----------
    normals : (n, 3) float, unit, outward
    tilts, azimuths : (n,) float, radians
    """
    e1, e2 = tangents(normals)
    sideways = np.cos(azimuths)[:, None] * e1 + np.sin(azimuths)[:, None] * e2
    return np.sin(tilts)[:, None] * sideways - np.cos(tilts)[:, None] * normals


def cone_tilts(count: int, cone: float, rng: np.random.Generator) -> FloatArray:
    """Return (count,) tilts, radians, of directions that are uniform in solid angle within `cone` of the normal."""
    return np.arccos(rng.uniform(np.cos(cone), 1.0, count))


def tip_axes(pokes: PressedPlaces) -> tuple[FloatArray, FloatArray]:
    """Return the (n, 3) unit sides of the square tips, in the plane of the skin."""
    e1, e2 = tangents(pokes.normals)
    c, s = np.cos(pokes.turns)[:, None], np.sin(pokes.turns)[:, None]
    return c * e1 + s * e2, c * e2 - s * e1


def by_hand(pushes: FloatArray, sd: float, rng: np.random.Generator) -> FloatArray:
    """Return the pushes that a hand makes of those it means.

    Parameters
    ----------
    pushes : (n, 3) float, unit
    sd : rad, about the push that is meant, in each direction
    """
    one, two = tangents(pushes)
    lean = np.tan(sd * rng.standard_normal((len(pushes), 2)))
    off = pushes + lean[:, :1] * one + lean[:, 1:] * two
    return off / np.linalg.norm(off, axis=1, keepdims=True)


def held(pushes: FloatArray, normals: FloatArray, usable: float) -> FloatArray:
    """Return the pushes, each that leans more taken back to `usable` from its inward normal: it would slide off.

    Parameters
    ----------
    pushes : (n, 3) float, unit
    normals : (n, 3) float, unit, outward
    usable : rad
    """
    inward = -np.sum(pushes * normals, axis=1, keepdims=True)
    aside = pushes + inward * normals
    length = np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-12)
    leaning = np.sin(usable) * aside / length - np.cos(usable) * normals
    return np.where(inward < np.cos(usable), leaning, pushes)
