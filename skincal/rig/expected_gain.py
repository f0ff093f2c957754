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
from dataclasses import dataclass, replace

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray
from skincal.model.scene import NoiseSettings
from skincal.pokes import LandmarkPokes, Pokes
from skincal.rig.correction import NO_NOISE, RigPrior, RigRows, RigState, UsedCorrection, rig_rows
from skincal.rig.correction_fit import (
    MIN_LANDMARK_POKES,
    MIN_LANDMARKS,
    LandmarkAgreement,
    qr_factor,
)
from skincal.taxels.result import Estimate

MAX_PREDICTED_ARM_POSES = 7
"""Arm poses of a prediction, those with most contacts: streamed joints make more."""
EXPECTED_LANDMARK_PRESS_FORCE_N = 10.0
"""N: hands press with 8 to 13 N on metal."""
MAX_PREDICTED_TAXELS = 40
"""Of more taxels only every n-th is used: neighbours move alike. On the forearm the mean over 28 is within a thousandth of that
over all 84."""


@dataclass(frozen=True, slots=True)
class Gain:
    """Expected movement of the taxels by the rig's errors, before and after planned landmark pokes."""

    now: float
    """m: expected rms distance over taxels and rigs, corrected by the landmark pokes that are made."""
    after: float
    """m: the same with the planned ones."""
    pokes: int
    """Number of planned pokes."""


def straight_pushes(places: FloatArray, normals: FloatArray, poses: Mapping[str, FloatArray]) -> LandmarkPokes:
    """Plan pushes of `EXPECTED_LANDMARK_PRESS_FORCE_N` straight into the part, as an exact rig reports them.

    Parameters
    ----------
    places, normals : (n, 3) float, metres and unit, outward, link frame: of landmarks or taxels
    poses : by name (4, 4) float, metres, link_from_sensor as reported

    Returns
    -------
    A push at each place in each arm pose, pose by pose.
    """
    count, many = len(places), len(poses)
    reported = np.repeat(np.array(list(poses.values())), count, axis=0)
    places, normals = np.tile(places, (many, 1)), np.tile(normals, (many, 1))
    turns = reported[:, :3, :3].transpose(0, 2, 1)
    force = (turns @ (-EXPECTED_LANDMARK_PRESS_FORCE_N * normals)[:, :, None])[:, :, 0]
    here = (turns @ (places - reported[:, :3, 3])[:, :, None])[:, :, 0]
    names, none = np.repeat(np.array(list(poses), dtype=np.str_), count), np.full(many * count, "")
    return LandmarkPokes(np.zeros(many * count, dtype=np.int64), force, np.cross(here, force), reported, names, none, places)


def taxel_pushes(places: FloatArray, normals: FloatArray, poses: Mapping[str, FloatArray]) -> LandmarkPokes:
    """Plan `straight_pushes` at taxels, at most `MAX_PREDICTED_TAXELS` of them in each arm pose."""
    step = max(1, -(-len(places) // MAX_PREDICTED_TAXELS))
    return straight_pushes(places[::step], normals[::step], poses)


def expected_error(
    pokes: LandmarkPokes, planned: LandmarkPokes, pushes: LandmarkPokes, noise: NoiseSettings, prior: RigPrior | None = None
) -> Gain:
    """Predict how far the rig's errors move the taxels, before and after planned landmark pokes.

    Fewer than `MIN_LANDMARK_POKES` pokes or `MIN_LANDMARKS` landmarks correct nothing. It takes a few milliseconds for any
    size.

    Parameters
    ----------
    pokes : those that are made
    planned : `straight_pushes` at landmarks
    pushes : `taxel_pushes` at the taxels, estimated or planned, in the arm poses with pokes on the skin
    noise : of the scene
    prior : usual errors of a rig; `RigPrior()` for `None`

    Raises
    ------
    ValueError
        There is no taxel or no pose.
    """
    if not len(pushes):
        raise ValueError("there is no taxel, or no arm pose in which one is poked")
    prior, every = prior or RigPrior(), LandmarkPokes.concatenate([pokes, planned])
    names: list[str] = np.unique(np.concatenate([pushes.pose, every.pose])).tolist()
    own = [_rows(some, some.place, prior.landmark, noise, prior, names).of_rig for some in (pokes, planned) if len(some)]
    whole, moved = np.concatenate([np.empty((0, 2, len(prior.scales(len(names))))), *own]), _taxel_moves(pushes, prior, names)
    now, after = (_expected(whole[:n], every.place[:n], moved) for n in (len(pokes), len(every)))
    return Gain(now, after, len(planned))


def expected_miss(pokes: LandmarkPokes, noise: NoiseSettings) -> FloatArray:
    """Predict the rms distance (n,) between each axis and its landmark, metres, from `RigPrior`, sensor noise and hand."""
    prior, off = RigPrior(), pokes.place - pokes.sensor
    lever, force = np.sqrt(np.vecdot(off, off)), pokes.force_size
    alone = replace(pokes, pose=np.full(len(pokes), ""))
    of_rig = rows_in_metres(alone, pokes.place, prior, [""]).of_rig
    own = prior.landmark**2 + (noise.moment / force) ** 2 + (noise.force * lever / force) ** 2
    return np.sqrt(np.sum((of_rig**2).reshape(len(pokes), 2 * of_rig.shape[2]), axis=1) + 2.0 * own)


def unchecked_of(
    used: UsedCorrection | None,
    landmarks: LandmarkAgreement | None,
    estimates: Sequence[Estimate],
    contacts: Sequence[Contact],
    pokes: LandmarkPokes,
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
    made = pokes[np.isin(pokes.pose, list(poses))] if is_checked else pokes[:0]
    places, normals = (np.array(values) for values in zip(*pairs, strict=True))
    return expected_error(made, pokes[:0], taxel_pushes(places, normals, poses), noise).now


def _taxel_moves(pushes: LandmarkPokes, prior: RigPrior, names: Sequence[str]) -> FloatArray:
    """Compute (n, 3, k) metres: movement of places along the skin by each unknown of the rig, mean of the poses."""
    rows = rows_in_metres(pushes, pushes.place, prior, names)
    shifts = rows.of_place.transpose(0, 2, 1) @ rows.of_rig
    return shifts.reshape(len(np.unique(pushes.pose)), -1, 3, shifts.shape[2]).mean(axis=0)


def rows_in_metres(pokes: Pokes, places: FloatArray, prior: RigPrior, names: Sequence[str]) -> RigRows:
    """Compute the rows of noiseless pokes at places (m, 3), in metres: they are whitened by a spread of one metre.

    Their change with the place has orthonormal rows. `names` are those of the arm poses, ascending.
    """
    return _rows(pokes, places, 1.0, NO_NOISE, prior, names)


def _rows(
    pokes: Pokes, places: FloatArray, spread: float, noise: NoiseSettings, prior: RigPrior, names: Sequence[str]
) -> RigRows:
    """Compute the rows of pokes whose contacts scatter about places (m, 3) with the sd `spread`, metres, per axis."""
    around = np.broadcast_to(spread**2 * np.eye(3), (len(places), 3, 3))
    return rig_rows(pokes, RigState.at_prior(names, prior.columns), places, around, noise, prior.scales(len(names)))


def _expected(rows: FloatArray, points: FloatArray, moved: FloatArray) -> float:
    """Compute the rms movement (n, 3, k) of places by unknowns that rows (m, 2, k) of pokes at points (m, 3) determine."""
    size = moved.shape[2]
    if len(points) < MIN_LANDMARK_POKES or len({point.tobytes() for point in points}) < MIN_LANDMARKS:
        rows = rows[:0]
    root = qr_factor(np.concatenate([np.eye(size), rows.reshape(-1, size)]))
    spread = np.asarray(np.linalg.solve(root.T, moved.reshape(-1, size).T), dtype=np.float64)
    return float(np.sqrt(np.sum(spread**2) / len(moved)))
