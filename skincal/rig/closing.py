"""Closing check: whether anything moved between the first pokes of a session and those that are made once more at its end.

A poke's axis passes its place P at r, two numbers across its push; E are these two directions. With x the rig's unknowns in
standard deviations of their prior and J the change of r with them (`skincal.rig.correction`), q how far the place lies off P,
and n the sensor's noise and the hand,

    r = J x + E q + n            of the pokes before,
    r = J x + E q + E s + n      of those at the end, if the part moved by s against what the sensor and the arm report.

x, q and n have known spreads, so r has a known covariance C; s follows by generalized least squares, and s' S^-1 s with
S = (X' C^-1 X)^-1 is a chi-squared of three degrees of freedom where nothing moved. A rig that is wrong all along is no
movement: x is the same in all pokes.

Pokes tell nothing of a movement along their own push. Where all push nearly the same way, as on a flat patch, s is so uncertain
along it that its length would say nothing: only the directions known to `SEEN` are told, by as many degrees of freedom.

A poke that slips, or a tool that touches twice, is off by more than noise, and of nine pokes it may decide alone. So each poke
is left out in turn, and a movement is told only where the others show it, too. To leave poke i out is to give its two numbers a
shift of their own: with K = C^-1, X the columns of s, y the misses, and K_i the two columns of K of poke i

    S^-1 = X' K X - X' K_i K_ii^-1 K_i' X,        S^-1 s = X' K y - X' K_i K_ii^-1 K_i' y.

Landmarks do not move on the part: a movement there is the sensor's or the arm's. Taxels do: there it may be the skin's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from math import erfc, exp, pi, sqrt
from typing import NamedTuple

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.scene import NoiseSettings
from skincal.rig.correction import RigPrior, RigState, rig_rows
from skincal.rig.correction_fit import LandmarkPoke, readings_of
from skincal.rig.expected_gain import EXACT

PLACES = 3
"""Places that are poked once more: one may be missed, and two still say it."""
FEWEST = 2
"""Places below which nothing is said: a single poke may have been anywhere."""
CHANCE = 0.01
"""Chance, below which a movement is no accident."""
WITHOUT = 0.05
"""The same with any one poke left out. It need not be as rare: with all pokes it is, and a poke that is far off is rare itself.
With 0.01 movements of 8 mm are told in 53 to 67 of 100 rigs, with 0.05 in 68 to 81."""
INSIDE = (0.0, 6.635, 9.210, 11.345)
"""Chi-squared of none to three degrees of freedom that all but `CHANCE` stay below."""
SEEN = 0.010
"""m, sd of a movement in a direction, up to which it is told: a movement that matters is seen, at half a finger's width."""


class ClosingPlaces(Enum):
    """What was poked once more; the value is the word for it."""

    LANDMARKS = "landmarks"
    TAXELS = "taxels"


@dataclass(frozen=True, slots=True)
class ClosingPlace:
    """A place of the closing check."""

    at: ClosingPlaces
    name: str
    """Of the landmark; of a taxel its channel."""


_OFF = {ClosingPlaces.LANDMARKS: 0.002, ClosingPlaces.TAXELS: 0.020}
"""m, sd of how far a place lies off what is believed, each direction: a drawing, and a taxel before anything is known."""


@dataclass(frozen=True, slots=True)
class Closing:
    """What the closing check found."""

    at: ClosingPlaces
    names: tuple[str, ...]
    """Of the landmarks that were poked once more; of taxels their channels."""
    shift: float
    """m, how far the part moved against what the sensor and the arm report, by these pokes, in the directions they see."""
    limit: float
    """m, how far it seems to, in that direction, where nothing moved: 99 times of 100 less."""
    chance: float
    """Of so large a shift where nothing moved, 0 to 1."""
    seen: int = 3
    """Directions that the pokes see, each across the others: two where all push nearly the same way, which hides that way."""
    after: int = 0
    """Number of the last poke before the check."""
    without: float = 0.0
    """The chance with one poke left out: the one that speaks most for a movement."""
    poke: int = 0
    """Number of that poke..."""
    place: str = ""
    """...and at which place it was."""

    @property
    def moved(self) -> bool:
        """Whether something moved: no poke says so alone."""
        return self.chance < CHANCE and self.without < WITHOUT

    @property
    def hangs_on_one(self) -> bool:
        """Whether one poke alone says that something moved."""
        return self.chance < CHANCE and self.without >= WITHOUT


def closing_check(
    before: Sequence[LandmarkPoke], after: Sequence[LandmarkPoke], at: ClosingPlaces, noise: NoiseSettings
) -> Closing | None:
    """Compare pokes that were made once more with those before; None where they are at too few places, or see no movement.

    Parameters
    ----------
    before, after : at landmarks or taxels, in the right frame; those before may be at other places, too
    """
    names = sorted({poke.name for poke in after} & {poke.name for poke in before})
    after = [poke for poke in after if poke.name in names]
    if len(names) < FEWEST:
        return None
    pokes = [*before, *after]
    across, miss, covariance = _passings(pokes, at, noise)
    moves = np.concatenate([np.zeros((2 * len(before), 3)), across[len(before) :].reshape(-1, 3)])
    inverse = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    weighed: FloatArray = inverse @ moves
    found = _movement(moves.T @ weighed, weighed.T @ miss)
    if found is None:
        return None
    without = _without_each(inverse, moves, miss)
    most = int(np.argmax(without))
    name, poke = pokes[most].name, pokes[most].poke
    return Closing(at, tuple(names), found.size, found.limit, found.chance, found.seen, 0, without[most], poke, name)


class _Movement(NamedTuple):
    """As in `Closing`."""

    size: float
    limit: float
    chance: float
    seen: int


def _movement(precision: FloatArray, sums: FloatArray) -> _Movement | None:
    """Return the movement s of which S^-1 (3, 3), 1/m^2, and S^-1 s (3,), 1/m, are given; None where no direction is known."""
    # Along each of these axes the movement is known apart from the others.
    weights, axes = np.linalg.eigh(precision)
    seen = weights >= SEEN**-2
    if not seen.any():
        return None
    along = np.asarray((axes.T @ sums)[seen] / weights[seen], dtype=np.float64)
    square, size = float(weights[seen] @ along**2), float(np.sqrt(along @ along))
    limit = size * sqrt(INSIDE[len(along)] / square) if square > 0 else 0.0
    return _Movement(size, limit, _beyond(square, len(along)), len(along))


def _without_each(inverse: FloatArray, moves: FloatArray, miss: FloatArray) -> list[float]:
    """Return the chance with each of the m pokes left out, 1 where the others know no direction.

    Parameters
    ----------
    inverse, moves, miss : K (2 m, 2 m), X (2 m, 3) and y (2 m,)
    """
    count, weighed = len(miss) // 2, inverse @ moves
    rows = weighed.reshape(count, 2, 3)
    blocks: FloatArray = np.einsum("iaib->iab", inverse.reshape(count, 2, count, 2))
    own = np.asarray(np.linalg.solve(blocks, rows), dtype=np.float64).transpose(0, 2, 1)
    precisions: FloatArray = moves.T @ weighed - own @ rows
    sums: FloatArray = weighed.T @ miss - (own @ (inverse @ miss).reshape(count, 2, 1))[..., 0]
    found = [_movement(precisions[poke], sums[poke]) for poke in range(count)]
    return [1.0 if each is None else each.chance for each in found]


def _passings(
    pokes: Sequence[LandmarkPoke], at: ClosingPlaces, noise: NoiseSettings
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return E (m, 2, 3), and of how m pokes pass their places (2 m,), metres, the covariance (2 m, 2 m)."""
    prior, poses = RigPrior(), sorted({poke.pose for poke in pokes})
    order = {name: index for index, name in enumerate(poses)}
    places, readings, scales = np.array([poke.place for poke in pokes]), readings_of(pokes, order), prior.scales(len(poses))
    # Whitened by a spread of one metre the rows are in metres, and their change with the place has orthonormal rows.
    spread = np.broadcast_to(np.eye(3), (len(pokes), 3, 3))
    rows = rig_rows(readings, RigState.at_prior(len(poses)), places, spread, EXACT, scales)
    of_rig = rows.of_rig.reshape(2 * len(pokes), -1)
    force = np.linalg.norm(readings.wrenches[:, :3], axis=1)
    lever = np.linalg.norm(places - readings.reported[:, :3, 3], axis=1)
    aim = prior.landmark if at is ClosingPlaces.LANDMARKS else noise.contact
    own = aim**2 + (noise.moment / force) ** 2 + (noise.force * lever / force) ** 2
    same = np.array([[one.name == other.name for other in pokes] for one in pokes], dtype=np.float64)
    flat = rows.of_place.reshape(-1, 3)
    off = _OFF[at] ** 2 * np.kron(same, np.ones((2, 2))) * (flat @ flat.T)
    return rows.of_place, rows.misses.ravel(), of_rig @ of_rig.T + np.diag(np.repeat(own, 2)) + off


def _beyond(square: float, freedom: int) -> float:
    """Return the chance that a chi-squared of one to three degrees of freedom is larger."""
    if freedom == 2:
        return exp(-square / 2.0)
    outside = erfc(sqrt(square / 2.0))
    return outside if freedom == 1 else outside + sqrt(2.0 * square / pi) * exp(-square / 2.0)
