"""Closing check: whether anything moved between the first pokes of a session and repeated pokes at its end.

A poke's axis passes its place P at r, two numbers across its push; E are these two directions. With x the rig's unknowns in
standard deviations of their prior, J the change of r with them (`skincal.rig.correction`), q the distance of the place from P
and n the noise of sensor and hand,

    r = J x + E q + n            for the first pokes,
    r = J x + E q + E s + n      for the repeated ones, if the part moved by s relative to what sensor and arm report.

x, q and n have known spreads, so r has a known covariance C. Generalized least squares gives s, and s' S^-1 s with S = (X'
C^-1 X)^-1 is chi-square with three degrees of freedom if nothing moved. A constant error of the rig is no movement: x is the
same in all pokes. A push shows no movement along itself. If all pushes are nearly parallel, as on a flat patch, only the
directions known to `TESTED_DIRECTION_MAX_SD_M` are tested, with as many degrees of freedom.

A single poke that slips may decide alone, so each poke is left out in turn: a movement counts only if the others show it, too.
Leaving poke i out means giving its two numbers a shift of their own. With K = C^-1, X the columns of s, y the misses and K_i
the two columns of K of poke i,

    S^-1 = X' K X - X' K_i K_ii^-1 K_i' X,        S^-1 s = X' K y - X' K_i K_ii^-1 K_i' y.

Landmarks do not move on the part: there a movement is that of the sensor or the arm. Taxels may move with the skin.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import erfc, exp, pi, sqrt
from typing import NamedTuple

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.scene import NoiseSettings
from skincal.pokes import LandmarkPokes
from skincal.rig.correction import RigPrior
from skincal.rig.expected_gain import rows_in_metres

CLOSING_CHECK_PLACES = 3
"""Places that are repeated: one may be missed, and two still tell."""
CLOSING_CHECK_MIN_PLACES = 2
"""With fewer places there is no result: a single poke may have been anywhere."""
MOVEMENT_MAX_P_VALUE = 0.01
"""A movement is reported if its chance without one is smaller."""
MOVEMENT_MAX_P_VALUE_WITHOUT_ONE_POKE = 0.05
"""The same with any one poke left out. It is less strict, since the chance with all pokes is small already. With 0.01 movements
of 8 mm are reported on 53 to 67 of 100 rigs, with 0.05 on 68 to 81."""
CHI2_QUANTILES = (0.0, 6.635, 9.210, 11.345)
"""Chi-square with none to three degrees of freedom, exceeded with `MOVEMENT_MAX_P_VALUE`."""
TESTED_DIRECTION_MAX_SD_M = 0.010
"""m. A direction is tested if the sd of a movement along it is smaller: a movement that matters shows at half a finger's
width."""


class ClosingPlaces(Enum):
    """Kind of the repeated places; the value is the word for it."""

    LANDMARKS = "landmarks"
    TAXELS = "taxels"


@dataclass(frozen=True, slots=True)
class ClosingPlace:
    """A place of the closing check."""

    at: ClosingPlaces
    name: str
    """Name of the landmark, or channel of the taxel."""


_PLACE_OFFSET_SD_M = {ClosingPlaces.LANDMARKS: 0.002, ClosingPlaces.TAXELS: 0.020}
"""m, sd of a place's error in each direction: of a drawing, and of a taxel before anything is known."""


@dataclass(frozen=True, slots=True)
class Closing:
    """Result of the closing check."""

    at: ClosingPlaces
    names: tuple[str, ...]
    """Repeated landmarks, or channels of the repeated taxels."""
    shift: float
    """m, estimated movement of the part relative to sensor and arm, in the observable directions."""
    limit: float
    """m: in that direction the estimate stays below this in 99 of 100 sessions without a movement."""
    chance: float
    """Probability of so large a shift without a movement, 0 to 1."""
    observable_directions: int = 3
    """Number of orthogonal directions that the pokes show: two if all push nearly the same way."""
    after: int = 0
    """Number of the last poke before the check."""
    chance_without_worst: float = 0.0
    """The chance without the poke that speaks most for a movement."""
    poke: int = 0
    """Number of that poke..."""
    place: str = ""
    """...and its place."""

    @property
    def has_moved(self) -> bool:
        """Whether something moved, by more than one poke."""
        return self.chance < MOVEMENT_MAX_P_VALUE and self.chance_without_worst < MOVEMENT_MAX_P_VALUE_WITHOUT_ONE_POKE

    @property
    def single_poke_decides(self) -> bool:
        """Whether only one poke shows a movement."""
        return self.chance < MOVEMENT_MAX_P_VALUE and self.chance_without_worst >= MOVEMENT_MAX_P_VALUE_WITHOUT_ONE_POKE


def closing_check(before: LandmarkPokes, after: LandmarkPokes, at: ClosingPlaces, noise: NoiseSettings) -> Closing | None:
    """Compare repeated pokes with the first ones; `None` with too few places or no observable direction.

    Parameters
    ----------
    before, after : at landmarks or taxels, after the frame's correction; those before may be at other places, too
    """
    names: list[str] = np.intersect1d(after.name, before.name).tolist()
    if len(names) < CLOSING_CHECK_MIN_PLACES:
        return None
    pokes = LandmarkPokes.concatenate([before, after[np.isin(after.name, names)]])
    across, miss, covariance = _passings(pokes, at, noise)
    moves = np.concatenate([np.zeros((2 * len(before), 3)), across[len(before) :].reshape(-1, 3)])
    inverse = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    weighed: FloatArray = inverse @ moves
    found = _movement(moves.T @ weighed, weighed.T @ miss)
    if found is None:
        return None
    without = _without_each(inverse, moves, miss)
    most = int(np.argmax(without))
    return Closing(at, tuple(names), *found, 0, without[most], int(pokes.number[most]), str(pokes.name[most]))


class _Movement(NamedTuple):
    """As in `Closing`."""

    shift: float
    limit: float
    chance: float
    observable_directions: int


def _movement(precision: FloatArray, sums: FloatArray) -> _Movement | None:
    """Solve for the movement s from S^-1 (3, 3), 1/m^2, and S^-1 s (3,), 1/m; `None` without an observable direction."""
    # Along each of these axes the movement is known independently of the others.
    weights, axes = np.linalg.eigh(precision)
    seen = weights >= TESTED_DIRECTION_MAX_SD_M**-2
    if not seen.any():
        return None
    along = np.asarray((axes.T @ sums)[seen] / weights[seen], dtype=np.float64)
    square, size = float(weights[seen] @ along**2), float(np.sqrt(along @ along))
    limit = size * sqrt(CHI2_QUANTILES[len(along)] / square) if square > 0 else 0.0
    return _Movement(size, limit, _chi2_exceedance(square, len(along)), len(along))


def _without_each(inverse: FloatArray, moves: FloatArray, miss: FloatArray) -> list[float]:
    """Compute the chance without each of the m pokes; 1 if the others show no direction.

    `inverse`, `moves` and `miss` are K (2 m, 2 m), X (2 m, 3) and y (2 m,).
    """
    count, weighed = len(miss) // 2, inverse @ moves
    rows = weighed.reshape(count, 2, 3)
    blocks: FloatArray = np.einsum("iaib->iab", inverse.reshape(count, 2, count, 2))
    own = np.asarray(np.linalg.solve(blocks, rows), dtype=np.float64).transpose(0, 2, 1)
    precisions: FloatArray = moves.T @ weighed - own @ rows
    sums: FloatArray = weighed.T @ miss - (own @ (inverse @ miss).reshape(count, 2, 1))[..., 0]
    found = [_movement(precisions[poke], sums[poke]) for poke in range(count)]
    return [1.0 if each is None else each.chance for each in found]


def _passings(pokes: LandmarkPokes, at: ClosingPlaces, noise: NoiseSettings) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute E (m, 2, 3), the misses (2 m,), metres, and their covariance (2 m, 2 m) for m pokes."""
    prior = RigPrior()
    rows = rows_in_metres(pokes, pokes.place, prior, np.unique(pokes.pose).tolist())
    of_rig = rows.of_rig.reshape(2 * len(pokes), -1)
    force = np.linalg.norm(pokes.force, axis=1)
    lever = np.linalg.norm(pokes.place - pokes.sensor, axis=1)
    aim = prior.landmark if at is ClosingPlaces.LANDMARKS else noise.contact
    own = aim**2 + (noise.moment / force) ** 2 + (noise.force * lever / force) ** 2
    same: FloatArray = (pokes.name[:, None] == pokes.name).astype(np.float64)
    flat = rows.of_place.reshape(-1, 3)
    off: FloatArray = _PLACE_OFFSET_SD_M[at] ** 2 * np.kron(same, np.ones((2, 2))) * (flat @ flat.T)
    return rows.of_place, rows.misses.ravel(), of_rig @ of_rig.T + np.diag(np.repeat(own, 2)) + off


def _chi2_exceedance(square: float, freedom: int) -> float:
    """Probability that chi-square with one to three degrees of freedom is larger."""
    if freedom == 2:
        return exp(-square / 2.0)
    outside = erfc(sqrt(square / 2.0))
    return outside if freedom == 1 else outside + sqrt(2.0 * square / pi) * exp(-square / 2.0)
