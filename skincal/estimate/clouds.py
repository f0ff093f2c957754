"""What moves with the taxels while a rig is fitted: boards where there is a layout, else each taxel alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from skincal.estimate.board_fit import fit_boards
from skincal.estimate.board_start import start_of
from skincal.estimate.boards import Boards, Poses, joined
from skincal.estimate.ledger import Ledger
from skincal.estimate.result import Estimate
from skincal.estimate.touches import Touches, find_touches
from skincal.readings import FloatArray, IntArray
from skincal.scene import NoiseSettings


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Where the m pokes on the skin are, as their clouds lie."""

    places: FloatArray
    """(m, 3) float, metres, link frame."""
    gradients: FloatArray
    """(m, 3, d) float: change of a place with its cloud's unknowns."""
    spread: FloatArray
    """(m, 3, 3) float, m^2: covariance of the contact about its place."""


@dataclass(frozen=True, slots=True, eq=False)
class BoardClouds:
    """The modules that were poked, each rigid."""

    boards: Boards
    touches: Touches
    poses: Poses
    trust: FloatArray
    """(m,) of each poke, from the fit of the boards alone."""

    @property
    def pokes(self) -> IntArray:
        """(m,) numbers of the pokes."""
        return self.touches.evidence.pokes[self.touches.rows]

    @property
    def of(self) -> IntArray:
        """(m,) cloud of each poke, 0 to `count` - 1."""
        return self.touches.of

    @property
    def count(self) -> int:
        """How many clouds there are."""
        return len(self.touches.boards)

    def placed(self) -> Placed:
        """Return where the pokes are."""
        modules: list[int] = self.touches.boards.tolist()
        own = [self.boards.pads[module] for module in modules]
        of = np.repeat(np.arange(len(own)), [len(pads) for pads in own])
        pads = self.boards.ground.laid(self.poses.take(of), np.concatenate(own))
        places, gradients, normals = self.touches.middles(pads)
        across = np.eye(3) - normals[:, :, None] * normals[:, None]
        return Placed(places, gradients, self.touches.offsets[:, None, None] * across)

    def moved(self, moves: FloatArray) -> BoardClouds:
        """Return them moved by `moves` (count, d)."""
        return BoardClouds(self.boards, self.touches, self.boards.ground.moved(self.poses, moves), self.trust)


@dataclass(frozen=True, slots=True, eq=False)
class TaxelClouds:
    """The taxels that were poked, each by itself."""

    pokes: IntArray
    of: IntArray
    count: int
    points: FloatArray
    """(count, 3) float, metres."""
    offsets: FloatArray
    """(m,) float, m^2: variance of the contact beside its taxel, each direction."""
    trust: FloatArray

    def placed(self) -> Placed:
        """Return where the pokes are: at their taxels."""
        eye = np.tile(np.eye(3), (len(self.of), 1, 1))
        return Placed(self.points[self.of], eye, self.offsets[:, None, None] * eye)

    def moved(self, moves: FloatArray) -> TaxelClouds:
        """Return them moved by `moves` (count, 3)."""
        return TaxelClouds(self.pokes, self.of, self.count, self.points + moves, self.offsets, self.trust)


Clouds: TypeAlias = BoardClouds | TaxelClouds


def board_clouds(
    ledger: Ledger, boards: Boards, estimates: Mapping[int, Estimate], noise: NoiseSettings, channels: list[int]
) -> BoardClouds | None:
    """Return the modules that were poked, where the rig as it tells itself puts them; None where none was.

    Parameters
    ----------
    estimates : of taxels, where the search for a board begins
    channels : those that are used
    """
    evidence = ledger.evidence(channels)
    begun = {module: start_of(boards, module, [estimates]) for module in boards.modules_of(evidence.channels.tolist())}
    ready = {module: start for module, start in begun.items() if start is not None}
    touches = find_touches(evidence, ledger.totals(evidence.pokes), boards, noise, ready)
    if not len(touches.boards):
        return None
    fitted = fit_boards(touches, boards, joined([ready[module] for module in touches.boards.tolist()]), noise)
    return BoardClouds(boards, touches, fitted.poses, fitted.trust)


def taxel_clouds(
    ledger: Ledger, estimates: Mapping[int, Estimate], noise: NoiseSettings, channels: list[int]
) -> TaxelClouds | None:
    """Return the taxels that have an estimate and were poked; None where none was."""
    placed = {channel: estimates[channel] for channel in channels if channel in estimates}
    known = {channel: one.position for channel, one in placed.items() if one.position is not None}
    evidence = ledger.evidence(known)
    if not len(evidence.channels):
        return None
    answered: list[int] = evidence.channels.tolist()
    doubted = [placed[channel].doubted for channel in answered]
    taxels: list[int] = evidence.taxels.tolist()
    pairs = zip(taxels, evidence.pokes.tolist(), strict=True)
    return TaxelClouds(
        pokes=evidence.pokes,
        of=evidence.taxels,
        count=len(evidence.channels),
        points=np.array([known[channel] for channel in answered]),
        offsets=noise.contact**2 - noise.reach**2 * np.log(evidence.weights),
        trust=np.array([doubted[taxel].get(poke, 1.0) for taxel, poke in pairs]),
    )
