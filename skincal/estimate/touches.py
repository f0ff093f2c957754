"""What pokes say of the boards they touched: one place a poke, the middle of the pads that answered.

A poke lies where the answers say, not at each of the taxels that answered: at the middle c = sum k_j P_j / sum k_j of the
board's pads, off by a little in the skin (`offset_squares`). Its two rows are those of `evidence.py`, with c in the
taxel's place: e_1.(c - a), e_2.(c - a). So a board is drawn to places that are poked often no more than to others. A poke
counts for the board that answers most.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from skincal.estimate.boards import Boards, Pads
from skincal.estimate.evidence import Evidence
from skincal.readings import FloatArray, IntArray
from skincal.scene import NoiseSettings

MIDDLE = 1.6
"""The middle of n pads is off the contact by this many `NoiseSettings.contact` over n, each direction: measured on the
simulated forearm, 2.4, 1.5, 0.8 and 0.5 mm for one to four pads."""
ACROSS = 0.001
"""m: by how much more where another module answers too: the tip stands on both."""
SHARE_MIN = 0.5
"""A poke counts for a board that has at least this share of the answers."""


@dataclass(frozen=True, slots=True, eq=False)
class Touches:
    """m pokes on b boards, ordered by board, then by the poke's number."""

    boards: IntArray
    """(b,) indices of the modules, ascending."""
    of: IntArray
    """(m,) which of `boards` was touched, 0 to b - 1."""
    rows: IntArray
    """(m,) an answer of each poke in `evidence`."""
    evidence: Evidence
    offsets: FloatArray
    """(m,) float, m^2: `offset_squares`."""
    answers: IntArray
    """(a,) pads that answered, indices into the pads of all `boards`, one board after another."""
    shares: FloatArray
    """(a,) float: of its poke's middle; those of a poke sum to 1."""
    channels: IntArray
    """(n,) the channels of the pads of all `boards`, one board after another."""
    starts: IntArray
    """(m,) where the answers of each poke begin."""

    def channels_of(self, touch: int) -> IntArray:
        """Return the channels that answered a poke, those of its board."""
        end = self.starts[touch + 1] if touch + 1 < len(self.starts) else len(self.answers)
        return self.channels[self.answers[self.starts[touch] : end]]

    def middles(self, pads: Pads) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the places (m, 3), metres, gradients (m, 3, d) and normals (m, 3), unit, of the pokes' middles."""
        shares = self.shares[:, None]
        points = np.add.reduceat(shares * pads.points[self.answers], self.starts, axis=0)
        gradients = np.add.reduceat(shares[:, None] * pads.gradients[self.answers], self.starts, axis=0)
        normals = np.add.reduceat(shares * pads.normals[self.answers], self.starts, axis=0)
        return points, gradients, normals / np.sqrt(np.sum(normals * normals, axis=1, keepdims=True))


def offset_squares(answering: IntArray, across: FloatArray, noise: NoiseSettings) -> FloatArray:
    """Return (m,) the variance of a contact about the middle of the pads that answered, each direction, m^2.

    Parameters
    ----------
    answering : (m,) pads of the board that answered
    across : (m,) float, 0 to 1: share of the answers that other boards gave
    """
    return np.asarray((MIDDLE * noise.contact / answering) ** 2 + np.where(across > 1e-9, ACROSS**2, 0.0))


def find_touches(
    evidence: Evidence, totals: FloatArray, boards: Boards, noise: NoiseSettings, wanted: Collection[int]
) -> Touches:
    """Return the pokes on the modules `wanted`; one that touches several modules counts where most answered.

    Parameters
    ----------
    evidence : of channels of the layout, all of a module's that are used or none
    totals : (n,) float, the sum of the weights of all answers of an answer's poke, of other channels too
    wanted : indices of modules
    """
    channels = evidence.channels[evidence.taxels]
    modules = boards.layout.module_of[channels]
    order = np.lexsort((channels, evidence.pokes, modules))
    ordered, pokes = modules[order], evidence.pokes[order]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (ordered[1:] != ordered[:-1]) | (pokes[1:] != pokes[:-1])
    firsts = np.flatnonzero(new)
    sums = np.add.reduceat(evidence.weights[order], firsts) if len(firsts) else np.empty(0)
    share = sums / totals[order[firsts]]
    sizes = np.diff(np.append(firsts, len(order)))
    kept = (share > SHARE_MIN) & np.isin(ordered[firsts], list(wanted))
    answers = order[np.repeat(kept, sizes)]
    rows, sizes, sums, share = order[firsts[kept]], sizes[kept], sums[kept], share[kept]
    used = np.unique(modules[rows])
    ids: list[int] = used.tolist()
    begins = np.cumsum([0, *(len(boards.pads[module]) for module in ids)])
    return Touches(
        boards=used,
        of=np.searchsorted(used, modules[rows]),
        rows=rows,
        evidence=evidence,
        offsets=offset_squares(sizes, 1.0 - share, noise),
        answers=begins[np.searchsorted(used, modules[answers])] + boards.place_of[channels[answers]],
        shares=evidence.weights[answers] / np.repeat(sums, sizes),
        channels=np.array(boards.channels_of(ids), dtype=np.int64),
        starts=np.cumsum(np.append(0, sizes))[:-1],
    )
