"""Reason why most pokes are answered by too many taxels: ghosts of a matrix without diodes, or a press that spreads.

In a matrix of rows and columns without diodes, current takes other ways through the pressed taxel: all taxels of its row and
of its column answer, too. A press that spreads is answered by a disc of taxels, so few of them are in that row or column.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from skincal.contacts.outcome import CROWDED_REASONS, Outcome, Rejection
from skincal.contacts.press import FinishedPress
from skincal.geometry import FloatArray, IntArray
from skincal.model.scene import Scene

MIN_CROWDED_POKES = 6
MIN_SHARE_OF_POKES = 0.2
"""Share of crowded pokes from which they are named: the others are mostly at the edge of the skin."""
MIN_MATRIX_SIDE = 3
GHOST_MIN_SHARE_OF_STRONGEST = 0.5
"""Answers with this share of the strongest other one are judged. Of a press that spreads, diagonal neighbours are among them if
taxels two steps away are."""
GHOSTS_MIN_SHARE_IN_CROSS = 0.9
"""Median share of these answers that are in the row or column of the poke's strongest taxel."""
GHOSTS_MIN_SHARE_OF_CROSS = 0.5
"""Median share of the taxels of this row and column, two steps away and more, that are among them."""
ADVICE_MIN_SHARE_OF_POKES = 0.8
"""A changed threshold is named if this share of the pokes would pass it."""
GHOST_MARGIN = 0.5
"""Position of the threshold between the ghosts' share of the strongest answer and that answer itself."""
MAX_GHOST_SHARE_TO_SEPARATE = 0.85
"""Ghosts with more than this share of the strongest answer cannot be told from it."""


class CrowdKind(Enum):
    """Kind of a crowd; the value is a word for it."""

    GHOSTS = "ghosts"
    SPREAD = "spread"


@dataclass(frozen=True, slots=True)
class Crowd:
    """Pokes that too many taxels answered."""

    kind: CrowdKind
    crowded: int
    """Pokes rejected for it."""
    pokes: int
    """All pokes that taxels answered."""
    answers: int
    """Median number of answers of these pokes."""
    limit: int
    """Threshold `taxels_max`."""
    rows: int = 0
    """`GHOSTS`: rows of the matrix."""
    columns: int = 0
    ghost_share: float = 0.0
    """`GHOSTS`: median over pokes of the strongest ghost over the strongest answer."""
    response_share: float = 0.0
    """`GHOSTS`: value of that threshold with which pokes pass; 0 if none helps."""
    passing: int = 0
    """Crowded pokes that pass with it, or with `taxels_max`."""
    taxels_max: int = 0
    """`SPREAD`: value of that threshold with which pokes pass."""


def find_crowd(outcomes: Iterable[Outcome], scene: Scene) -> Crowd | None:
    """Look for the reason why many pokes have too many answers; `None` if there are few of them."""
    answered = [each for each in outcomes if len(each.channels)]
    presses = [
        each.press
        for each in answered
        if isinstance(each, Rejection) and each.reason in CROWDED_REASONS and each.press is not None
    ]
    if len(presses) < max(MIN_CROWDED_POKES, MIN_SHARE_OF_POKES * len(answered)):
        return None
    limit = (presses[-1].thresholds or scene.contacts).taxels_max
    counts = np.array([len(press.channels) for press in presses])
    answers = int(np.median(counts))
    for rows, columns, row, column in _matrices(scene):
        if (share := _ghost_share(presses, row, column)) is not None:
            threshold, passing = _separating_share(presses, share, limit)
            return Crowd(
                CrowdKind.GHOSTS, len(presses), len(answered), answers, limit, rows, columns, share, threshold, passing
            )
    if not any(each.reason is CROWDED_REASONS[0] for each in answered if isinstance(each, Rejection)):
        return None  # far apart: something else touches the skin
    most = int(np.ceil(np.quantile(counts, 0.98)))
    return Crowd(
        CrowdKind.SPREAD, len(presses), len(answered), answers, limit, taxels_max=most,
        passing=int(np.count_nonzero(counts <= most)),
    )  # fmt: skip


def _matrices(scene: Scene) -> Iterable[tuple[int, int, IntArray, IntArray]]:
    """Yield the matrices that the skin may be: rows, columns, and the (channels,) row and column of each channel.

    With a layout it is the grid of its taxels, -1 for channels without a taxel. Without one it is each product that gives the
    number of channels.
    """
    channels, layout = scene.skin.channels, scene.skin.layout
    if layout is not None:
        row, column = (_lines(layout.places[:, axis], layout.spacing) for axis in (1, 0))
        rows, columns = int(row.max()) + 1, int(column.max()) + 1
        # A strip, or modules whose taxels are on no common lines, is no matrix: all its taxels are in one row.
        if min(rows, columns) > 1:
            yield rows, columns, row, column
    for rows in range(MIN_MATRIX_SIDE, channels // MIN_MATRIX_SIDE + 1):
        if channels % rows == 0:
            row, column = np.divmod(np.arange(channels), channels // rows)
            yield rows, channels // rows, row, column


def _lines(places: FloatArray, spacing: float) -> IntArray:
    """Find the number of the grid line of each coordinate (n,), -1 for NaN."""
    known = np.flatnonzero(np.isfinite(places))
    order = known[np.argsort(places[known], kind="stable")]
    found = np.full(len(places), -1, dtype=np.int64)
    found[order] = np.concatenate([[0], np.cumsum(np.diff(places[order]) > spacing / 2)])
    return found


def _ghost_share(presses: Sequence[FinishedPress], row: IntArray, column: IntArray) -> float | None:
    """Compute the median share of the strongest ghost of the strongest answer; `None` if answers are in no cross."""
    inside, covered, shares = list[float](), list[float](), list[float]()
    for press in presses:
        at = int(np.argmax(press.responses))
        peak, others, responses = press.channels[at], np.delete(press.channels, at), np.delete(press.responses, at)
        strong = others[responses >= GHOST_MIN_SHARE_OF_STRONGEST * responses.max()]
        steps = np.abs(row - row[peak]), np.abs(column - column[peak])
        in_cross = np.minimum(*steps) == 0
        is_far = in_cross & (np.maximum(*steps) >= 2) & (row >= 0)
        inside.append(float(in_cross[strong].mean()))
        covered.append(np.count_nonzero(is_far[strong]) / max(np.count_nonzero(is_far), 1))
        shares.append(float(responses.max() / press.responses[at]))
    if np.median(inside) < GHOSTS_MIN_SHARE_IN_CROSS or np.median(covered) < GHOSTS_MIN_SHARE_OF_CROSS:
        return None
    return float(np.median(shares))


def _separating_share(presses: Sequence[FinishedPress], ghost: float, limit: int) -> tuple[float, int]:
    """Choose `response_share` above the ghosts' share, and count the presses that pass with it; 0 if too few pass."""
    if ghost > MAX_GHOST_SHARE_TO_SEPARATE:
        return 0.0, 0
    share = round(ghost + GHOST_MARGIN * (1.0 - ghost), 2)
    passing = sum(int(np.count_nonzero(each.responses >= share * each.responses.max())) <= limit for each in presses)
    return (share, passing) if passing >= ADVICE_MIN_SHARE_OF_POKES * len(presses) else (0.0, 0)
