"""Pokes at the landmarks of a scene, as a hand makes them: straight to what a session would hold of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.geometry.arrays import FloatArray
from skincal.model.scene import Landmark
from skincal.rig.correction_fit import LandmarkPoke
from skincal.session.known_points import landmark_normals
from skincal.simulate.contacts import pressed
from skincal.simulate.poke import Pokes, cone_tilts, push_directions, tangents
from skincal.simulate.rig import Rig


@dataclass(frozen=True, slots=True)
class LandmarkHabits:
    """How somebody pokes landmarks; SI units."""

    force: tuple[float, float] = (8.0, 13.0)
    """N, uniform: metal, so one presses harder than on foam."""
    cone: float = float(np.radians(28.0))
    """rad. Pushes lie within it about the inward normal, uniform in solid angle."""
    aim: float = 0.0007
    """m, sd of the place in each tangent direction: a tip in the slot of a screw. Assumed."""


def poke_landmarks(
    rig: Rig,
    landmarks: tuple[Landmark, ...],
    per_pose: int,
    rng: np.random.Generator,
    first_poke: int = 1,
    beside: FloatArray | None = None,
    habits: LandmarkHabits | None = None,
) -> list[LandmarkPoke]:
    """Return pokes at the landmarks in turn, so many in each arm pose of the rig.

    Parameters
    ----------
    landmarks : of the scene; one at least
    first_poke : number of the first
    beside : (n,) float, metres, how far each poke lies off its landmark by mistake; none for None
    """
    found: list[LandmarkPoke] = []
    for pose in rig.stances:
        wanted = [landmarks[(len(found) + i) % len(landmarks)] for i in range(per_pose)]
        number = first_poke + len(found)
        off = np.zeros(per_pose) if beside is None else beside[len(found) : len(found) + per_pose]
        pokes = _aimed(rig, wanted, off, rng, habits or LandmarkHabits())
        wrenches, stance = pressed(rig, pokes, rng, pose), rig.stance(pose)
        found += [
            LandmarkPoke(number + i, one.name, one.place, wrench[:3], wrench[3:], stance.told, stance.name)
            for i, (one, wrench) in enumerate(zip(wanted, wrenches, strict=True))
        ]
    return found


def _aimed(rig: Rig, wanted: list[Landmark], off: FloatArray, rng: np.random.Generator, habits: LandmarkHabits) -> Pokes:
    """Return one poke at each of `wanted`, `off` metres (n,) beside it and by the hand's aim."""
    count = len(wanted)
    places = np.array([one.place for one in wanted])
    up = np.array([0.0, 0.0, 1.0])
    normals = np.array([up if one is None else one for one in landmark_normals(wanted, rig.surface)])
    e1, e2 = tangents(normals)
    beside = habits.aim * rng.standard_normal((count, 2)) + np.column_stack([off, np.zeros(count)])
    tilts, azimuths = cone_tilts(count, habits.cone, rng), rng.uniform(-np.pi, np.pi, count)
    return Pokes(
        np.full(count, -1, dtype=np.int64), places + beside[:, :1] * e1 + beside[:, 1:] * e2, normals,
        push_directions(normals, tilts, azimuths), rng.uniform(*habits.force, count), np.zeros(count),
    )  # fmt: skip
