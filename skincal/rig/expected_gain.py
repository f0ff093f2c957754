"""Expected gain of landmark pokes: by how much a rig's errors move the taxels, now and after pokes that are not made yet.

All of it is linear and Gaussian about a rig that is as it reports. The rig's unknowns x, in standard deviations of their
prior, have the covariance (I + A'A)^-1 after landmark pokes with the whitened rows A of `skincal.rig.correction`. A depends on
where pokes are and not on what they measure, so planned ones count as made ones do. A straight push at a taxel is read beside
it, along the skin, by B x: the change of its axis with the rig. A taxel is taken to be poked alike in all arm poses in use,
and to lie at the mean of what they say, so B is the mean of theirs. The error predicted is the root of the mean over taxels of

    trace B (I + A'A)^-1 B'.

It is the rig's part alone and along the skin alone. Noise of the pokes, which falls with their number, comes on top of it
(0.5 mm for the modules of the forearm after 252), and the free method is off in depth too. That a landmark poke may be of
another point is left out, and so is what pokes on the skin say of the rig (`correction_fit.SKIN`): with 588 of them in seven
poses and 21 at landmarks 1.0 mm is predicted, and 0.7 to 0.8 mm comes out.
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
from skincal.rig.correction_fit import FEWEST, FEWEST_POINTS, LandmarkAgreement, LandmarkPoke, qr_factor, readings_of
from skincal.taxels.result import Estimate

POSES = 7
"""Arm poses that an error is predicted for, those with most contacts: streamed joints make more."""
PUSH = 10.0
"""N, of a planned poke: the middle of what a hand presses with on metal, 8 to 13 N."""
TAXELS = 40
"""Taxels that the mean is taken over, of more every n-th: neighbours are moved alike. On the forearm the mean over 28 is
within a thousandth of that over all 84."""
EXACT = NoiseSettings(force=0.0, moment=0.0)
"""Of a push that is read without noise: what is left is the rig's."""


@dataclass(frozen=True, slots=True, eq=False)
class PlannedPoke:
    """A poke at a landmark that is not made yet: `PUSH` straight into the part."""

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
    """By how much the rig's errors move the taxels."""

    now: float
    """m: expected distance, root mean square over taxels and rigs, corrected by the landmark pokes that are made."""
    after: float
    """m: the same with the planned ones."""
    pokes: int
    """How many are planned."""


def expected_error(
    prior: RigPrior,
    noise: NoiseSettings,
    pokes: Sequence[LandmarkPoke],
    planned: Sequence[PlannedPoke],
    places: FloatArray,
    normals: FloatArray,
    poses: Mapping[str, FloatArray],
) -> Gain:
    """Predict by how much the rig's errors move the taxels, before and after planned pokes at landmarks.

    Fewer than `FEWEST` landmark pokes, or `FEWEST_POINTS` landmarks, correct nothing. 84 or 4,200 taxels in seven poses: a few
    milliseconds.

    Parameters
    ----------
    pokes : that are made
    places, normals : (n, 3) float, metres and unit, outward, link frame: of the taxels, estimated or planned
    poses : by name (4, 4) float, link_from_sensor as reported: those in which the skin is poked

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
    if pokes:
        rows.append(_landmark_rows(pokes, readings_of(pokes, order), prior, noise, scales))
    if planned:
        rows.append(_landmark_rows(planned, _planned(planned, order), prior, noise, scales))
    moved, points = _moved(places, normals, poses, order, prior, scales), [poke.place for poke in every]
    whole = np.concatenate(rows)
    now, after = (_expected(whole[: 2 * n], points[:n], moved) for n in (len(pokes), len(points)))
    return Gain(now, after, len(planned))


def expected_miss(poke: LandmarkPoke, noise: NoiseSettings) -> float:
    """Return how far the axis of a poke may be expected to pass its landmark, root mean square, metres.

    By a rig that is wrong as `RigPrior` has it, by the sensor's noise, and by the hand.
    """
    prior, lever = RigPrior(), float(np.linalg.norm(poke.place - poke.link_from_sensor[:3, 3]))
    force = float(np.linalg.norm(poke.force))
    # Whitened by a spread of one metre the rows are in metres.
    rows = _rows(readings_of([poke], {poke.pose: 0}), poke.place[None], 1.0, EXACT, prior, prior.scales(1))
    own = prior.landmark**2 + (noise.moment / force) ** 2 + (noise.force * lever / force) ** 2
    return float(np.sqrt(np.sum(rows.of_rig**2) + 2.0 * own))


def unchecked_error(
    estimates: Sequence[Estimate], contacts: Sequence[Contact], pokes: Sequence[LandmarkPoke], noise: NoiseSettings
) -> float | None:
    """Return by how much a rig's errors may move the taxels that are in no covariance, root mean square, metres.

    Parameters
    ----------
    estimates : of one method; those without a position or a normal tell nothing
    contacts : in whose arm poses they were poked
    pokes : at landmarks, where the rig passes them as predicted or is corrected by them; else they do not make it better

    Returns
    -------
    None where no taxel is known.
    """
    known = [(estimate.position, estimate.normal) for estimate in estimates if estimate.position is not None]
    pairs = [(place, normal) for place, normal in known if normal is not None]
    often = {name for name, _ in Counter(contact.pose for contact in contacts).most_common(POSES)}
    poses = {contact.pose: contact.link_from_sensor for contact in contacts if contact.pose in often}
    if not pairs or not poses:
        return None
    places, normals = (np.array(values) for values in zip(*pairs, strict=True))
    return expected_error(RigPrior(), noise, [poke for poke in pokes if poke.pose in poses], [], places, normals, poses).now


def unchecked_of(
    used: UsedCorrection | None,
    landmarks: LandmarkAgreement | None,
    estimates: Sequence[Estimate],
    contacts: Sequence[Contact],
    pokes: Sequence[LandmarkPoke],
    noise: NoiseSettings,
) -> float | None:
    """Return by how much the rig's errors may move the taxels beside what is predicted, metres; None where all is predicted.

    Parameters
    ----------
    used : the correction of the rig that is in use
    landmarks : how the rig passes them: where it does not as predicted, or nobody knows, it may be as wrong as any
    estimates, contacts, pokes, noise : see `unchecked_error`
    """
    if used is not None and not used.correction.exact:
        return None
    known = used is not None or (landmarks is not None and landmarks.agrees)
    return unchecked_error(estimates, contacts, pokes if known else (), noise)


def _landmark_rows(
    pokes: Sequence[LandmarkPoke | PlannedPoke],
    readings: RigReadings,
    prior: RigPrior,
    noise: NoiseSettings,
    scales: FloatArray,
) -> FloatArray:
    """Return (2 m, k) the whitened rows of pokes at landmarks, made or planned."""
    places = np.array([poke.place for poke in pokes])
    return _rows(readings, places, prior.landmark, noise, prior, scales).of_rig.reshape(-1, len(scales))


def _planned(pokes: Sequence[PlannedPoke], order: Mapping[str, int]) -> RigReadings:
    places, normals = np.array([poke.place for poke in pokes]), np.array([poke.normal for poke in pokes])
    reported, of = np.array([poke.link_from_sensor for poke in pokes]), np.array([order[poke.pose] for poke in pokes])
    return _pushed(places, normals, reported, of)


def _moved(
    places: FloatArray,
    normals: FloatArray,
    poses: Mapping[str, FloatArray],
    order: Mapping[str, int],
    prior: RigPrior,
    scales: FloatArray,
) -> FloatArray:
    """Return (n, 3, k) metres: how places are moved along the skin by each unknown of the rig, the mean of the poses."""
    step = -(-len(places) // TAXELS)
    some, out, many = places[::step], normals[::step], len(poses)
    count = len(some)
    reported = np.repeat(np.array(list(poses.values())), count, axis=0)
    of = np.repeat(np.array([order[name] for name in poses]), count)
    some, out = np.tile(some, (many, 1)), np.tile(out, (many, 1))
    # Whitened by a spread of one metre the rows are in metres, and their change with the place has orthonormal rows.
    rows = _rows(_pushed(some, out, reported, of), some, 1.0, EXACT, prior, scales)
    shifts = rows.of_place.transpose(0, 2, 1) @ rows.of_rig
    return shifts.reshape(many, count, 3, -1).mean(axis=0)


def _pushed(places: FloatArray, normals: FloatArray, reported: FloatArray, of: IntArray) -> RigReadings:
    """Return straight pushes at places (m, 3), in arm poses (m, 4, 4), as a rig that is as it reports reads them."""
    turns = reported[:, :3, :3].transpose(0, 2, 1)
    force = (turns @ (-PUSH * normals)[:, :, None])[:, :, 0]
    here = (turns @ (places - reported[:, :3, 3])[:, :, None])[:, :, 0]
    return RigReadings(np.concatenate([force, np.cross(here, force)], axis=1), of, reported)


def _rows(
    readings: RigReadings, places: FloatArray, spread: float, noise: NoiseSettings, prior: RigPrior, scales: FloatArray
) -> RigRows:
    """Return the rows of pokes that lie beside their places (m, 3) by an sd of `spread`, metres, in each direction."""
    around = np.broadcast_to(spread**2 * np.eye(3), (len(places), 3, 3))
    return rig_rows(
        readings, RigState.at_prior((len(scales) - 6 * prior.columns) // 6, prior.columns), places, around, noise, scales
    )


def _expected(rows: FloatArray, points: Sequence[FloatArray], moved: FloatArray) -> float:
    """Return the rms over places of a movement (n, 3, k) by unknowns that rows (2 m, k) of pokes at m points determine."""
    size = moved.shape[2]
    if len(points) < FEWEST or len({point.tobytes() for point in points}) < FEWEST_POINTS:
        rows = rows[:0]
    root = qr_factor(np.concatenate([np.eye(size), rows]))
    spread = np.asarray(np.linalg.solve(root.T, moved.reshape(-1, size).T), dtype=np.float64)
    return float(np.sqrt(np.sum(spread**2) / len(moved)))
