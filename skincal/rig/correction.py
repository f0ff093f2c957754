"""A rig's correction: what a wrench and an arm pose really are, and the rows that landmark and skin pokes give for it.

A rig's errors shift whole groups of taxels, and no poke on a skin whose place is unknown shows them: they are found from
pokes at points of the part that are known, the landmarks. With C near 0 (6 x 6) and for each arm pose a turn w and a shift t,
both small, a poke with the measured wrench (f, m) at the point P of the link frame has in the sensor's frame

    (f', m') = (I + C) (f, m),   c = exp(-S(w)) (R'(P - o) - t),   r = E (m' - c x f') / |f|,

where C may go on with columns for the products of the wrench's components (a sensor that is not linear), (R, o) is the arm's
pose as reported and E two directions across the measured push. For a landmark P is known but for the hand's aim; for a poke on
the skin it is the middle of the pads that answered (`skincal.modules.pose_fit`), and moves with its module. Every unknown of
the rig has a prior (`RigPrior`) and is counted in its standard deviations; what the pokes do not determine stays at zero.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from skincal.contacts.outcome import Contact, Rejection
from skincal.geometry import FloatArray, IntArray, cross_matrix
from skincal.model.scene import NoiseSettings
from skincal.modules.pose import rotations
from skincal.taxels.contact_table import orthonormal_pair

FRAME, RIG = "frame", "rig"
"""What a correction is of: the sensor's frame, or the rig's small errors."""
Poke = TypeVar("Poke", bound=Contact | Rejection)


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """A linear map of the wrench and a small motion of the arm's poses."""

    matrix: FloatArray
    """(6, 6) float, SI: the true wrench, force above moment, is this times the reported one."""
    everywhere: FloatArray = field(default_factory=lambda: np.eye(4))
    """(4, 4) float, metres: link_from_sensor is the reported one times this, in every arm pose."""
    motions: Mapping[str, FloatArray] = field(default_factory=dict[str, FloatArray])
    """For some arm poses (4, 4) float, metres: and times this."""
    root: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    """(n, n) float, SI, upper triangular: root root' is the covariance of the unknowns, the matrix with the quadratic's columns
    row by row, then turn and shift of each of `motions` by name, or of none of them where there are more than `POSES_KEPT`;
    (0, 0) of a correction that is taken for exact."""
    quadratic: FloatArray = field(default_factory=lambda: np.empty((6, 0)))
    """(6, 21) float, SI: the true wrench has besides this times its `products`; (6, 0) of a sensor that is taken for linear."""

    @property
    def exact(self) -> bool:
        """Whether it is taken for exact: what it does not know was not recorded, or nobody knows it."""
        return not len(self.root)

    def pose(self, link_from_sensor: FloatArray, name: str) -> FloatArray:
        """Return link_from_sensor, (4, 4), of the arm pose of that name; of one that is not known, by `everywhere` alone."""
        there = link_from_sensor @ self.everywhere
        return there @ self.motions[name] if name in self.motions else there

    def wrench(self, force: FloatArray, moment: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the true force (3,), N, and moment (3,), N m, of the reported ones, in the sensor's frame."""
        reported = np.concatenate([force, moment])
        true = self.matrix @ reported
        if self.quadratic.size:
            true = true + self.quadratic @ products(reported[None])[0]
        return true[:3], true[3:]

    def after(self, first: Correction) -> Correction:
        """Return the correction that is `first`, which moves all arm poses alike, and then this one."""
        return replace(self, matrix=self.matrix @ first.matrix, everywhere=first.everywhere @ self.everywhere)

    def corrected(self, poke: Poke) -> Poke:
        """Return a poke as a right rig would have reported it; a poke without a force stays as it is."""
        if poke.force is None or poke.moment is None or poke.link_from_sensor is None:
            return poke
        force, moment = self.wrench(poke.force, poke.moment)
        return replace(poke, force=force, moment=moment, link_from_sensor=self.pose(poke.link_from_sensor, poke.pose))


POSES_KEPT = 24
"""Arm poses up to which their uncertainty is kept, with how it goes together. Streamed joints make hundreds of names, each for
a few pokes, which hardly tell more of it than its prior: 2 million numbers for 315 of them."""
LOAD = 10.0
"""N: the force at which a sensor that is not linear is off by the share `RigPrior.quadratic`; hands press with 6 to 13 N."""
_FIRST, _SECOND = np.triu_indices(6)


def products(wrenches: FloatArray) -> FloatArray:
    """Return (m, 21) the products of each two components of wrenches (m, 6)."""
    return wrenches[:, _FIRST] * wrenches[:, _SECOND]


def _features(wrenches: FloatArray, count: int) -> FloatArray:
    """Return (m, count) what the matrix C is times: wrenches (m, 6), of 27 with their products."""
    return wrenches if count == 6 else np.concatenate([wrenches, products(wrenches)], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class UsedCorrection:
    """A correction that the operator uses, and what spoke for it."""

    of: str
    """`FRAME` or `RIG`."""
    correction: Correction
    before: float
    """m: at what distance pokes pass their landmarks as the rig reports them, root mean square."""
    after: float
    """m: the same under the correction; for the rig's errors of pokes that were held out."""
    pokes: int
    """How many landmark pokes it was found from."""
    ratio: float = float("nan")
    """Misses of held-out landmark pokes over what was predicted for them (`RigAnswer.ratio`); NaN where nobody knows."""
    noisier: float = 1.0
    """How many times the scene's noise was predicted for them (`RigAnswer.noisier`)."""


@dataclass(frozen=True, slots=True)
class RigPrior:
    """How wrong a rig may be before anything is known of it; SI units."""

    matrix: float = 0.02
    """sd of each entry of C: the F/T matrix with its cross-talk, 2 % (`docs/noise.md`)."""
    arm: float = 0.35
    """m: the entries between force and moment count a moment in units of force x this length."""
    pose_turn: float = float(np.radians(1.0))
    """rad, sd of the turn of each arm pose about each axis through the sensor."""
    pose_shift: float = 0.002
    """m, sd of the shift of each arm pose along each axis."""
    quadratic: float = 0.0
    """sd of each product's part in each component, as a share of that at `LOAD`; 0 takes the sensor for linear."""
    landmark: float = 0.0007
    """m, sd of the contact beside the landmark in each direction: a tip on a screw head, by hand."""

    @property
    def columns(self) -> int:
        """Columns of C: the wrench's components, and their products where the sensor is not linear."""
        return 6 + len(products(np.ones((1, 6)))[0]) if self.quadratic else 6

    def scales(self, poses: int) -> FloatArray:
        """Return (6 columns + 6 poses,) the sd of each unknown: C row by row, 6 or 27 columns, then turn and shift of each."""
        units = LOAD * np.repeat([1.0, self.arm], 3)
        matrix = self.matrix * units[:, None] / units[None, :]
        if self.quadratic:
            matrix = np.concatenate([matrix, self.quadratic * units[:, None] / products(units[None])], axis=1)
        return np.concatenate([matrix.ravel(), np.tile(np.repeat([self.pose_turn, self.pose_shift], 3), poses)])


@dataclass(frozen=True, slots=True, eq=False)
class RigReadings:
    """m pokes as the rig reports them."""

    wrenches: FloatArray
    """(m, 6) float, N and N m, sensor frame, as measured."""
    poses: IntArray
    """(m,) index of the arm pose."""
    reported: FloatArray
    """(m, 4, 4) float: link_from_sensor as reported."""


@dataclass(frozen=True, slots=True, eq=False)
class RigRows:
    """The whitened rows of m pokes, and how they change."""

    misses: FloatArray
    """(m, 2) float: r in standard deviations."""
    of_rig: FloatArray
    """(m, 2, n) float: change of r with the rig's unknowns, each in its prior's standard deviations."""
    of_place: FloatArray
    """(m, 2, 3) float, 1/m: change of r with P."""
    distances: FloatArray
    """(m,) float, metres: how far the corrected axis passes P."""


@dataclass(frozen=True, slots=True, eq=False)
class RigState:
    """Where the rig's unknowns stand."""

    matrix: FloatArray
    """(6, 6) float, C; (6, 27) of a sensor that is not linear."""
    turns: FloatArray
    """(poses, 3) float, radians, w."""
    shifts: FloatArray
    """(poses, 3) float, metres, t."""

    @classmethod
    def at_prior(cls, poses: int, columns: int = 6) -> RigState:
        """Return a rig that is as it reports, with so many columns of C."""
        return cls(np.zeros((6, columns)), np.zeros((poses, 3)), np.zeros((poses, 3)))

    def moved(self, step: FloatArray, scales: FloatArray) -> RigState:
        """Return the state after a step in standard deviations of the prior."""
        change = step * scales
        of_matrix = self.matrix.size
        of_poses = change[of_matrix:].reshape(-1, 2, 3)
        return RigState(
            self.matrix + change[:of_matrix].reshape(self.matrix.shape),
            self.turns + of_poses[:, 0],
            self.shifts + of_poses[:, 1],
        )

    def unknowns(self, scales: FloatArray) -> FloatArray:
        """Return (n,) the unknowns in standard deviations of the prior."""
        of_poses = np.concatenate([self.turns[:, None], self.shifts[:, None]], axis=1)
        return np.concatenate([self.matrix.ravel(), of_poses.ravel()]) / scales


def rig_rows(
    readings: RigReadings, state: RigState, places: FloatArray, spread: FloatArray, noise: NoiseSettings, scales: FloatArray
) -> RigRows:
    """Return the rows of pokes at `places`.

    Parameters
    ----------
    places : (m, 3) float, metres, link frame: P
    spread : (m, 3, 3) float, m^2: covariance of the contact about P, link frame
    scales : of the rig's unknowns (`RigPrior.scales`)
    """
    wrenches, reported = readings.wrenches, readings.reported
    features = _features(wrenches, state.matrix.shape[1])
    corrected = wrenches + features @ state.matrix.T
    force, moment = corrected[:, :3], corrected[:, 3:]
    size = np.linalg.norm(wrenches[:, :3], axis=1)
    pairs = orthonormal_pair(wrenches[:, :3] / size[:, None]) / size[:, None, None]
    sensor_from_link = rotations(state.turns)[readings.poses].transpose(0, 2, 1) @ reported[:, :3, :3].transpose(0, 2, 1)
    off = reported[:, :3, 3] + (reported[:, :3, :3] @ state.shifts[readings.poses][:, :, None])[:, :, 0]
    here = (sensor_from_link @ (places - off)[:, :, None])[:, :, 0]
    residual = moment - np.cross(here, force)
    whiten = _whitening(pairs, here, force, sensor_from_link @ spread @ sensor_from_link.transpose(0, 2, 1), noise)
    rows = whiten @ pairs
    with_place = rows @ cross_matrix(force)
    of_rig = np.zeros((len(places), 2, len(scales)))
    matrix = np.concatenate([-rows @ cross_matrix(here), rows], axis=2)
    of_matrix = state.matrix.size
    of_rig[:, :, :of_matrix] = (matrix[:, :, :, None] * features[:, None, None, :]).reshape(len(places), 2, of_matrix)
    turned = with_place @ cross_matrix(here) @ _right_jacobians(state.turns)[readings.poses]
    shifted = -with_place @ rotations(state.turns)[readings.poses].transpose(0, 2, 1)
    at = of_matrix + 6 * readings.poses[:, None] + np.arange(6)
    np.put_along_axis(of_rig, at[:, None, :].repeat(2, axis=1), np.concatenate([turned, shifted], axis=2), axis=2)
    return RigRows(
        misses=(rows @ residual[:, :, None])[:, :, 0],
        of_rig=of_rig * scales,
        of_place=with_place @ sensor_from_link,
        distances=np.linalg.norm(np.cross(force, residual), axis=1) / np.sum(force * force, axis=1),
    )


class CorrectionErrors:
    """What a correction of a rig does not know, as `skincal.taxels.shared_errors.SharedRows`.

    An arm pose that the correction's root does not know is as wrong as any may be before something is known of it, and by
    itself. All of it is to first order in the correction.

    Parameters
    ----------
    correction : with its `root`
    contact_of : gives a poke by its number, as corrected
    """

    def __init__(self, correction: Correction, contact_of: Callable[[int], Contact], prior: RigPrior | None = None) -> None:
        self._contact_of, self._of_pose = contact_of, (prior or RigPrior()).scales(1)[-6:]
        self._root, self._columns = correction.root, 6 + correction.quadratic.shape[1]
        known = sorted(correction.motions) if len(self._root) > 6 * self._columns else []
        self._poses = {name: index for index, name in enumerate(known)}

    def __call__(self, pokes: IntArray, places: FloatArray, pairs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (m, 2, n) and (m, 2, 6) metres; see `SharedRows`."""
        numbers, row = np.unique(pokes, return_inverse=True)
        contacts = [self._contact_of(poke) for poke in numbers.tolist()]
        poses = np.array([self._poses.get(contact.pose, -1) for contact in contacts])[row]
        wrenches = np.array([np.concatenate([contact.force, contact.moment]) for contact in contacts])[row]
        reported = np.array([contact.link_from_sensor for contact in contacts])[row]
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
    """Return (4, 4) the motion by a turn about `turn` (3,) by its length, rad, and a shift (3,), m."""
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotations(turn[None])[0], shift
    return motion


def _whitening(pairs: FloatArray, here: FloatArray, force: FloatArray, spread: FloatArray, noise: NoiseSettings) -> FloatArray:
    """Return (m, 2, 2) L^-1 of the rows' covariance L L': noise of moment and force, and the contact beside its place."""
    lever = cross_matrix(here)
    pull = cross_matrix(force)
    total = noise.moment**2 * np.eye(3) + noise.force**2 * lever @ lever.transpose(0, 2, 1)
    total = total + pull @ spread @ pull.transpose(0, 2, 1)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(pairs @ total @ pairs.transpose(0, 2, 1))), dtype=np.float64)


def _right_jacobians(turns: FloatArray) -> FloatArray:
    """Return (n, 3, 3) J with exp(S(w + d)) = exp(S(w)) exp(S(J d)) to first order."""
    angles = np.sqrt(np.sum(turns * turns, axis=1))[:, None, None]
    small = angles < 1e-4
    safe = np.where(small, 1.0, angles)
    first = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    second = np.where(small, 1.0 / 6.0, (safe - np.sin(safe)) / safe**3)
    s = cross_matrix(turns)
    return np.eye(3) - first * s + second * (s @ s)
