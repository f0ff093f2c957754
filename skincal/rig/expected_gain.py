"""Expected gain of landmark pokes: how far a rig's errors move the taxels, now and after pokes that are only planned.

Everything is linear and Gaussian about a rig that is as it reports. The rig's unknowns x, in standard deviations of their
prior, have the covariance (I + A'A)^-1 after landmark pokes with the whitened rows A of `skincal.rig.correction`. A depends on
where pokes are and not on what they measure, so planned pokes count as made ones do. A straight push at a taxel is displaced
along the skin by B x, the change of its axis with the rig. A taxel is assumed to be poked equally in all arm poses in use, so
B is their mean. The predicted error is the root of the mean over taxels of

    trace B (I + A'A)^-1 B'.

It is the rig's part alone, along the skin alone. The noise of the pokes (0.5 mm for the modules of the forearm after 252) comes
on top. A landmark poke at a wrong point is left out, and so is what skin pokes tell of the rig: with 588 of them in seven poses
and 21 at landmarks 1.0 mm is predicted, and 0.7 to 0.8 mm comes out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray
from skincal.model.scene import NoiseSettings
from skincal.rig.correction import RigPrior, RigReadings, RigRows, RigState, UsedCorrection, rig_rows
from skincal.rig.correction_fit import (
    MIN_LANDMARK_POKES,
    MIN_LANDMARKS,
    LandmarkAgreement,
    LandmarkPoke,
    qr_factor,
    readings_of,
)
from skincal.taxels.result import Estimate

MAX_PREDICTED_ARM_POSES = 7
"""Arm poses of a prediction, those with most contacts: streamed joints make more."""
EXPECTED_LANDMARK_PRESS_FORCE_N = 10.0
"""N: hands press with 8 to 13 N on metal."""
MAX_PREDICTED_TAXELS = 40
"""Of more taxels only every n-th is used: neighbours move alike. On the forearm the mean over 28 is within a thousandth of that
over all 84."""
NO_NOISE = NoiseSettings(force=0.0, moment=0.0)


@dataclass(frozen=True, slots=True, eq=False)
class PlannedPoke:
    """A landmark poke that is only planned: `EXPECTED_LANDMARK_PRESS_FORCE_N` straight into the part."""

    place: FloatArray
    """(3,) float, metres, link frame: of the landmark."""
    normal: FloatArray
    """(3,) float, unit, outward."""
    link_from_sensor: FloatArray
    """(4, 4) float, metres: pose of the arm."""
    pose: str
    """Name of the arm pose."""


@dataclass(frozen=True, slots=True)
class Gain:
    """Expected movement of the taxels by the rig's errors, before and after planned landmark pokes."""

    now: float
    """m: expected rms distance over taxels and rigs, corrected by the landmark pokes that are made."""
    after: float
    """m: the same with the planned ones."""
    pokes: int
    """Number of planned pokes."""


def expected_error(
    prior: RigPrior,
    noise: NoiseSettings,
    pokes: Sequence[LandmarkPoke],
    planned: Sequence[PlannedPoke],
    places: FloatArray,
    normals: FloatArray,
    poses: Mapping[str, FloatArray],
) -> Gain:
    """Predict how far the rig's errors move the taxels, before and after planned landmark pokes.

    Fewer than `MIN_LANDMARK_POKES` pokes or `MIN_LANDMARKS` landmarks correct nothing. It takes a few milliseconds for any
    size.

    Parameters
    ----------
    pokes : those that are made
    places, normals : (n, 3) float, metres and unit, outward, link frame: of the taxels, estimated or planned
    poses : by name (4, 4) float, link_from_sensor as reported: those with pokes on the skin

    Raises
    ------
    ValueError
        There is no taxel or no pose.
    """
    if not len(places) or not poses:
        raise ValueError("there is no taxel, or no arm pose in which one is poked")
    every = (*pokes, *planned)
    names = sorted({*poses, *(poke.pose for poke in every)})
    order, scales = {name: index for index, name in enumerate(names)}, prior.scales(len(names))
    rows = [np.empty((0, len(scales)))]
    readings = [*([readings_of(pokes, order)] if pokes else []), *([_planned(planned, order)] if planned else [])]
    for own, some in zip(readings, filter(None, (pokes, planned)), strict=True):
        at = np.array([poke.place for poke in some])
        rows.append(_rows(own, at, prior.landmark, noise, prior, scales).of_rig.reshape(-1, len(scales)))
    moved, points = _taxel_moves(places, normals, poses, order, prior, scales), [poke.place for poke in every]
    whole = np.concatenate(rows)
    now, after = (_expected(whole[: 2 * n], points[:n], moved) for n in (len(pokes), len(points)))
    return Gain(now, after, len(planned))


def expected_miss(poke: LandmarkPoke, noise: NoiseSettings) -> float:
    """Predict the rms distance between a poke's axis and its landmark, metres, from `RigPrior`, sensor noise and hand."""
    prior, lever = RigPrior(), float(np.linalg.norm(poke.place - poke.link_from_sensor[:3, 3]))
    force = float(np.linalg.norm(poke.force))
    rows = rows_in_metres(readings_of([poke], {poke.pose: 0}), poke.place[None], prior, prior.scales(1))
    own = prior.landmark**2 + (noise.moment / force) ** 2 + (noise.force * lever / force) ** 2
    return float(np.sqrt(np.sum(rows.of_rig**2) + 2.0 * own))


def unchecked_of(
    used: UsedCorrection | None,
    landmarks: LandmarkAgreement | None,
    estimates: Sequence[Estimate],
    contacts: Sequence[Contact],
    pokes: Sequence[LandmarkPoke],
    noise: NoiseSettings,
) -> float | None:
    """Predict the rms movement of the taxels by the rig's errors that no covariance contains, metres.

    Parameters
    ----------
    used : the rig's correction in use
    landmarks : agreement of the landmark pokes. If it is bad or unknown, the rig may be as wrong as any
    estimates : of one method; those without a position or a normal are left out
    contacts : pokes on the skin; their arm poses count
    pokes : landmark pokes

    Returns
    -------
    `None` if the covariances contain everything, or no taxel is known.
    """
    if used is not None and not used.correction.exact:
        return None
    known = [(estimate.position, estimate.normal) for estimate in estimates if estimate.position is not None]
    pairs = [(place, normal) for place, normal in known if normal is not None]
    often = {name for name, _ in Counter(contact.pose for contact in contacts).most_common(MAX_PREDICTED_ARM_POSES)}
    poses = {contact.pose: contact.link_from_sensor for contact in contacts if contact.pose in often}
    if not pairs or not poses:
        return None
    is_checked = used is not None or (landmarks is not None and landmarks.agrees)
    made = [poke for poke in pokes if poke.pose in poses] if is_checked else []
    places, normals = (np.array(values) for values in zip(*pairs, strict=True))
    return expected_error(RigPrior(), noise, made, [], places, normals, poses).now


def _planned(pokes: Sequence[PlannedPoke], order: Mapping[str, int]) -> RigReadings:
    places, normals = np.array([poke.place for poke in pokes]), np.array([poke.normal for poke in pokes])
    reported, of = np.array([poke.link_from_sensor for poke in pokes]), np.array([order[poke.pose] for poke in pokes])
    return _pushed(places, normals, reported, of)


def _taxel_moves(
    places: FloatArray,
    normals: FloatArray,
    poses: Mapping[str, FloatArray],
    order: Mapping[str, int],
    prior: RigPrior,
    scales: FloatArray,
) -> FloatArray:
    """Compute (n, 3, k) metres: movement of places along the skin by each unknown of the rig, mean of the poses."""
    step = -(-len(places) // MAX_PREDICTED_TAXELS)
    some, out, many = places[::step], normals[::step], len(poses)
    count = len(some)
    reported = np.repeat(np.array(list(poses.values())), count, axis=0)
    of = np.repeat(np.array([order[name] for name in poses]), count)
    some, out = np.tile(some, (many, 1)), np.tile(out, (many, 1))
    rows = rows_in_metres(_pushed(some, out, reported, of), some, prior, scales)
    shifts = rows.of_place.transpose(0, 2, 1) @ rows.of_rig
    return shifts.reshape(many, count, 3, -1).mean(axis=0)


def _pushed(places: FloatArray, normals: FloatArray, reported: FloatArray, of: IntArray) -> RigReadings:
    """Make the readings of straight pushes at places (m, 3), in arm poses (m, 4, 4), of an exact rig."""
    turns = reported[:, :3, :3].transpose(0, 2, 1)
    force = (turns @ (-EXPECTED_LANDMARK_PRESS_FORCE_N * normals)[:, :, None])[:, :, 0]
    here = (turns @ (places - reported[:, :3, 3])[:, :, None])[:, :, 0]
    return RigReadings(np.concatenate([force, np.cross(here, force)], axis=1), of, reported)


def rows_in_metres(readings: RigReadings, places: FloatArray, prior: RigPrior, scales: FloatArray) -> RigRows:
    """Compute the rows of noiseless pokes at places (m, 3), in metres: they are whitened by a spread of one metre.

    Their change with the place has orthonormal rows.
    """
    return _rows(readings, places, 1.0, NO_NOISE, prior, scales)


def _rows(
    readings: RigReadings, places: FloatArray, spread: float, noise: NoiseSettings, prior: RigPrior, scales: FloatArray
) -> RigRows:
    """Compute the rows of pokes whose contacts scatter about places (m, 3) with the sd `spread`, metres, per axis."""
    around = np.broadcast_to(spread**2 * np.eye(3), (len(places), 3, 3))
    return rig_rows(
        readings, RigState.at_prior((len(scales) - 6 * prior.columns) // 6, prior.columns), places, around, noise, scales
    )


def _expected(rows: FloatArray, points: Sequence[FloatArray], moved: FloatArray) -> float:
    """Compute the rms movement (n, 3, k) of places by unknowns that rows (2 m, k) of pokes at m points determine."""
    size = moved.shape[2]
    if len(points) < MIN_LANDMARK_POKES or len({point.tobytes() for point in points}) < MIN_LANDMARKS:
        rows = rows[:0]
    root = qr_factor(np.concatenate([np.eye(size), rows]))
    spread = np.asarray(np.linalg.solve(root.T, moved.reshape(-1, size).T), dtype=np.float64)
    return float(np.sqrt(np.sum(spread**2) / len(moved)))
