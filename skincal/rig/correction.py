"""Correction of a rig: the true wrench and arm pose, and the linear rows that landmark and skin pokes give for them.

A rig's errors shift whole groups of taxels, and pokes on a skin of unknown place cannot show them. Pokes at landmarks can:
known points of the part. With C near 0 (6 x 6), and for each arm pose a small rotation w and shift t, a poke with the measured
wrench (f, m) at the point P of the link frame has in the sensor's frame

    (f', m') = (I + C) (f, m),   c = exp(-S(w)) (R'(P - o) - t),   r = E (m' - c x f') / |f|.

(R, o) is the arm pose as reported and E two directions across the measured push. C may have more columns, for the products of
the wrench's components (a sensor that is not linear). P is known for a landmark, apart from the hand's aim. For a skin poke it
is the middle of the pads that answered (`skincal.modules.pose_fit`) and moves with its module. Every unknown of the rig has a
prior (`RigPrior`) and is counted in its standard deviations; what the pokes do not determine stays at zero.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from skincal.contacts.outcome import Contact, Rejection
from skincal.geometry import FloatArray, IntArray, cross_matrix, orthonormal_pair, rotations
from skincal.model.scene import NoiseSettings
from skincal.pokes import NameArray, Pokes
from skincal.rig.usual_errors import ARM_POSE_SHIFT_SD_M, ARM_POSE_TURN_SD_RAD, FORCE_TO_MOMENT_LENGTH_M, MATRIX_ERROR_SD

FRAME, RIG = "frame", "rig"
"""Kinds of corrections: of the sensor's frame, and of the rig's small errors."""
Poke = TypeVar("Poke", bound=Contact | Rejection)
SomePokes = TypeVar("SomePokes", bound=Pokes)


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """A linear map of the wrench and a small motion of the arm's poses."""

    matrix: FloatArray
    """(6, 6) float, SI: true wrench (force, then moment) = matrix @ reported wrench."""
    everywhere: FloatArray = field(default_factory=lambda: np.eye(4))
    """(4, 4) float, metres: in every arm pose link_from_sensor = reported @ everywhere..."""
    motions: Mapping[str, FloatArray] = field(default_factory=dict[str, FloatArray])
    """...and in some arm poses, by name, @ motion, (4, 4) float, metres."""
    root: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    """(n, n) float, SI, upper triangular: root root' is the covariance of the unknowns: the matrix with the quadratic's columns
    row by row, then rotation and shift of each of `motions` by name (of none with more than `MAX_ARM_POSES_WITH_UNCERTAINTY`).
    (0, 0) if the correction counts as exact."""
    quadratic: FloatArray = field(default_factory=lambda: np.empty((6, 0)))
    """(6, 21) float, SI: the true wrench has in addition quadratic @ `products`; (6, 0) for a linear sensor."""

    @property
    def exact(self) -> bool:
        """Whether the correction counts as exact, since its uncertainty was not recorded."""
        return not len(self.root)

    def pose(self, link_from_sensor: FloatArray, name: str) -> FloatArray:
        """Correct a reported link_from_sensor, (4, 4), of the arm pose of that name; an unknown one by `everywhere` alone."""
        there = link_from_sensor @ self.everywhere
        return there @ self.motions[name] if name in self.motions else there

    def wrench(self, force: FloatArray, moment: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Correct reported forces (..., 3), N, and moments (..., 3), N m, in the sensor's frame."""
        reported = np.concatenate([force, moment], axis=-1)
        true = (self.matrix @ reported[..., None])[..., 0]
        if self.quadratic.size:
            true = true + (self.quadratic @ products(reported)[..., None])[..., 0]
        return true[..., :3], true[..., 3:]

    def after(self, first: Correction) -> Correction:
        """Combine two corrections: `first`, which moves all arm poses equally, then this one."""
        return replace(self, matrix=self.matrix @ first.matrix, everywhere=first.everywhere @ self.everywhere)

    def corrected(self, poke: Poke) -> Poke:
        """Correct a poke; one without a force is not changed."""
        if poke.force is None or poke.moment is None or poke.link_from_sensor is None:
            return poke
        force, moment = self.wrench(poke.force, poke.moment)
        return replace(poke, force=force, moment=moment, link_from_sensor=self.pose(poke.link_from_sensor, poke.pose))

    def corrected_pokes(self, pokes: SomePokes) -> SomePokes:
        """Correct pokes, each as `corrected` does."""
        force, moment = self.wrench(pokes.force, pokes.moment)
        poses = pokes.link_from_sensor @ self.everywhere
        for name in set(pokes.pose.tolist()) & self.motions.keys():
            own = pokes.pose == name
            poses[own] = poses[own] @ self.motions[name]
        return replace(pokes, force=force, moment=moment, link_from_sensor=poses)


MAX_ARM_POSES_WITH_UNCERTAINTY = 24
"""With more arm poses than this their uncertainty is not kept. Streamed joints make hundreds of poses with a few pokes each,
which hardly tell more than the prior: 2 million numbers for 315 of them."""
TYPICAL_PRESS_FORCE_N = 10.0
"""N. At this force a nonlinear sensor errs by the share `RigPrior.quadratic`; hands press with 6 to 13 N."""
_FIRST, _SECOND = np.triu_indices(6)


def products(wrenches: FloatArray) -> FloatArray:
    """Multiply each two components of wrenches (..., 6): (..., 21)."""
    return wrenches[..., _FIRST] * wrenches[..., _SECOND]


def _features(wrenches: FloatArray, count: int) -> FloatArray:
    """Compute the (m, count) that C is multiplied with: wrenches (m, 6), and with a count of 27 their products."""
    return wrenches if count == 6 else np.concatenate([wrenches, products(wrenches)], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class UsedCorrection:
    """A correction in use, with its evidence."""

    of: str
    """`FRAME` or `RIG`."""
    correction: Correction
    before: float
    """m: rms distance of poke axes from their landmarks as reported."""
    after: float
    """m: the same with the correction; for `RIG` of held-out pokes."""
    pokes: int
    """Number of landmark pokes it was found from."""
    ratio: float = float("nan")
    """Misses of held-out landmark pokes over their prediction (`RigAnswer.ratio`); NaN if unknown."""
    noisier: float = 1.0
    """Factor on the scene's noise in that prediction (`RigAnswer.noisier`)."""


@dataclass(frozen=True, slots=True)
class RigPrior:
    """Standard deviations of a rig's errors before any poke; SI units."""

    matrix: float = MATRIX_ERROR_SD
    """sd of each entry of C: error and cross-talk of the F/T matrix, 2 % (`docs/noise.md`)."""
    arm: float = FORCE_TO_MOMENT_LENGTH_M
    """m: the entries between force and moment count a moment in units of force x this length."""
    pose_turn: float = ARM_POSE_TURN_SD_RAD
    """rad, sd of the rotation of each arm pose about each axis through the sensor."""
    pose_shift: float = ARM_POSE_SHIFT_SD_M
    """m, sd of the shift of each arm pose along each axis."""
    quadratic: float = 0.0
    """sd of each product's part in each component, as a share of that at `TYPICAL_PRESS_FORCE_N`; 0 for a linear sensor."""
    landmark: float = 0.0007
    """m, sd of the contact from the landmark in each direction: a tip on a screw head, by hand."""

    @property
    def columns(self) -> int:
        """Number of columns of C: the wrench's components, and their products for a nonlinear sensor."""
        return 6 + len(products(np.ones((1, 6)))[0]) if self.quadratic else 6

    def scales(self, poses: int) -> FloatArray:
        """Compute the sd (6 columns + 6 poses,) of the unknowns: C row by row, then rotation and shift of each pose."""
        units = TYPICAL_PRESS_FORCE_N * np.repeat([1.0, self.arm], 3)
        matrix = self.matrix * units[:, None] / units[None, :]
        if self.quadratic:
            matrix = np.concatenate([matrix, self.quadratic * units[:, None] / products(units[None])], axis=1)
        return np.concatenate([matrix.ravel(), np.tile(np.repeat([self.pose_turn, self.pose_shift], 3), poses)])


@dataclass(frozen=True, slots=True, eq=False)
class RigRows:
    """Whitened rows of m pokes, with their derivatives."""

    misses: FloatArray
    """(m, 2) float: r in standard deviations."""
    of_rig: FloatArray
    """(m, 2, n) float: derivative of r by the rig's unknowns in standard deviations of the prior."""
    of_place: FloatArray
    """(m, 2, 3) float, 1/m: derivative of r by P."""
    distances: FloatArray
    """(m,) float, metres: distance of the corrected axis from P."""


@dataclass(frozen=True, slots=True, eq=False)
class RigState:
    """Values of the rig's unknowns."""

    names: NameArray
    """(poses,) names of the arm poses, ascending."""
    matrix: FloatArray
    """(6, 6) float, C; (6, 27) for a nonlinear sensor."""
    turns: FloatArray
    """(poses, 3) float, radians, w."""
    shifts: FloatArray
    """(poses, 3) float, metres, t."""

    @classmethod
    def at_prior(cls, names: Sequence[str], columns: int = 6) -> RigState:
        """Make the state of an exact rig with arm poses of these names, ascending, and this number of columns of C."""
        return cls(np.array(names, dtype=np.str_), np.zeros((6, columns)), *np.zeros((2, len(names), 3)))

    def add_step(self, step: FloatArray, scales: FloatArray) -> RigState:
        """Add a step in standard deviations of the prior."""
        change = step * scales
        of_matrix = self.matrix.size
        of_poses = change[of_matrix:].reshape(-1, 2, 3)
        return RigState(
            self.names,
            self.matrix + change[:of_matrix].reshape(self.matrix.shape),
            self.turns + of_poses[:, 0],
            self.shifts + of_poses[:, 1],
        )

    def pose_rows(self, poses: NameArray) -> IntArray:
        """Find the rows (m,) of arm poses (m,) by their names; `KeyError` for a name that is not among them."""
        rows = np.searchsorted(self.names, poses)
        # `searchsorted` gives a row for unknown names too.
        is_known = np.concatenate([self.names, [""]])[rows] == poses
        if not (is_known & (rows < len(self.names))).all():
            raise KeyError(f"arm poses {set(poses.tolist()) - set(self.names.tolist())} are not of this state")
        return rows

    def unknowns(self, scales: FloatArray) -> FloatArray:
        """Compute the unknowns (n,) in standard deviations of the prior."""
        of_poses = np.concatenate([self.turns[:, None], self.shifts[:, None]], axis=1)
        return np.concatenate([self.matrix.ravel(), of_poses.ravel()]) / scales


NO_NOISE = NoiseSettings(force=0.0, moment=0.0)
"""For `rig_rows`, if the sensor's noise is part of the spread."""


def rig_rows(
    pokes: Pokes, state: RigState, places: FloatArray, spread: FloatArray, noise: NoiseSettings, scales: FloatArray
) -> RigRows:
    """Compute the rows of m pokes at `places`.

    Parameters
    ----------
    pokes : as measured; `state` has all their arm poses
    places : (m, 3) float, metres, link frame: P
    spread : (m, 3, 3) float, m^2: covariance of the contact about P, link frame
    scales : of the rig's unknowns (`RigPrior.scales`)
    """
    wrenches, reported, poses = pokes.wrench, pokes.link_from_sensor, state.pose_rows(pokes.pose)
    features = _features(wrenches, state.matrix.shape[1])
    corrected = wrenches + features @ state.matrix.T
    force, moment = corrected[:, :3], corrected[:, 3:]
    size = np.linalg.norm(wrenches[:, :3], axis=1)
    pairs = orthonormal_pair(wrenches[:, :3] / size[:, None]) / size[:, None, None]
    sensor_from_link = rotations(state.turns)[poses].transpose(0, 2, 1) @ reported[:, :3, :3].transpose(0, 2, 1)
    off = reported[:, :3, 3] + (reported[:, :3, :3] @ state.shifts[poses][:, :, None])[:, :, 0]
    here = (sensor_from_link @ (places - off)[:, :, None])[:, :, 0]
    residual = moment - np.cross(here, force)
    whiten = _whitening(pairs, here, force, sensor_from_link @ spread @ sensor_from_link.transpose(0, 2, 1), noise)
    rows = whiten @ pairs
    with_place = rows @ cross_matrix(force)
    of_rig = np.zeros((len(places), 2, len(scales)))
    matrix = np.concatenate([-rows @ cross_matrix(here), rows], axis=2)
    of_matrix = state.matrix.size
    of_rig[:, :, :of_matrix] = (matrix[:, :, :, None] * features[:, None, None, :]).reshape(len(places), 2, of_matrix)
    turned = with_place @ cross_matrix(here) @ _right_jacobians(state.turns)[poses]
    shifted = -with_place @ rotations(state.turns)[poses].transpose(0, 2, 1)
    at = of_matrix + 6 * poses[:, None] + np.arange(6)
    np.put_along_axis(of_rig, at[:, None, :].repeat(2, axis=1), np.concatenate([turned, shifted], axis=2), axis=2)
    return RigRows(
        misses=(rows @ residual[:, :, None])[:, :, 0],
        of_rig=of_rig * scales,
        of_place=with_place @ sensor_from_link,
        distances=np.linalg.norm(np.cross(force, residual), axis=1) / np.sum(force * force, axis=1),
    )


class CorrectionErrors:
    """Uncertainty of a rig's correction as `skincal.taxels.shared_errors.SharedRows`, to first order.

    An arm pose without a covariance in the correction's root has the prior's, independent of all others.

    Parameters
    ----------
    correction : with its `root`
    contact_of : gives a corrected poke by its number
    """

    def __init__(self, correction: Correction, contact_of: Callable[[int], Contact], prior: RigPrior | None = None) -> None:
        self._contact_of, self._of_pose = contact_of, (prior or RigPrior()).scales(1)[-6:]
        self._root, self._columns = correction.root, 6 + correction.quadratic.shape[1]
        known = sorted(correction.motions) if len(self._root) > 6 * self._columns else []
        self._poses = {name: index for index, name in enumerate(known)}

    def __call__(self, pokes: IntArray, places: FloatArray, pairs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute (m, 2, n) and (m, 2, 6), metres; see `SharedRows`."""
        numbers, row = np.unique(pokes, return_inverse=True)
        every = Pokes.collect(self._contact_of(poke) for poke in numbers.tolist())[row]
        poses = np.array([self._poses.get(name, -1) for name in every.pose.tolist()])
        wrenches, reported = every.wrench, every.link_from_sensor
        sensor_from_link = reported[:, :3, :3].transpose(0, 2, 1)
        force = wrenches[:, :3]
        here = cross_matrix((sensor_from_link @ (places - reported[:, :3, 3])[:, :, None])[:, :, 0])
        # The rows e_1, e_2 of `contact_table` are e_2 and -e_1 of the residual (f x p + m)/|f|.
        across_push = np.stack([pairs[:, 1], -pairs[:, 0]], axis=1) @ reported[:, :3, :3]
        across_push = across_push / np.linalg.norm(force, axis=1)[:, None, None]
        features = _features(wrenches, self._columns)[:, None, None, :]
        of_matrix = np.concatenate([-across_push @ here, across_push], axis=2)[:, :, :, None] * features
        pull = across_push @ cross_matrix(force)
        of_pose = np.concatenate([pull @ here, -pull], axis=2)
        size = 6 * self._columns
        alike = of_matrix.reshape(len(places), 2, size) @ self._root[:size]
        for pose in np.unique(poses[poses >= 0]).tolist():
            own = size + 6 * pose
            alike[poses == pose] += of_pose[poses == pose] @ self._root[own : own + 6]
        return alike, np.where((poses < 0)[:, None, None], of_pose * self._of_pose, 0.0)


def rigid_motion(turn: FloatArray, shift: FloatArray) -> FloatArray:
    """Make a (4, 4) motion from a rotation vector `turn` (3,), rad, and a shift (3,), m."""
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotations(turn[None])[0], shift
    return motion


def _whitening(pairs: FloatArray, here: FloatArray, force: FloatArray, spread: FloatArray, noise: NoiseSettings) -> FloatArray:
    """Compute the (m, 2, 2) L^-1 of the rows' covariance L L': noise of moment and force, and scatter of the contact."""
    lever = cross_matrix(here)
    pull = cross_matrix(force)
    total = noise.moment**2 * np.eye(3) + noise.force**2 * lever @ lever.transpose(0, 2, 1)
    total = total + pull @ spread @ pull.transpose(0, 2, 1)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(pairs @ total @ pairs.transpose(0, 2, 1))), dtype=np.float64)


def _right_jacobians(turns: FloatArray) -> FloatArray:
    """Compute the (n, 3, 3) J with exp(S(w + d)) = exp(S(w)) exp(S(J d)) to first order."""
    angles = np.sqrt(np.sum(turns * turns, axis=1))[:, None, None]
    small = angles < 1e-4
    safe = np.where(small, 1.0, angles)
    first = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    second = np.where(small, 1.0 / 6.0, (safe - np.sin(safe)) / safe**3)
    s = cross_matrix(turns)
    return np.eye(3) - first * s + second * (s @ s)
