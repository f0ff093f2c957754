"""Order of the values of a skin of three axes: grouped by taxel or by axis, as the pokes show it.

A push is mostly along z, so the strongest value of a frame is the z of a pressed taxel. If values that are grouped by axis are
read as grouped by taxel, it falls on x, y and z alike. With k of n pokes on z, the log odds of the right order over a wrong
one are k ln(3 p) + (n - k) ln(3 (1 - p)/2), with p = `SHARE_ON_Z`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from skincal.geometry import BoolArray, FloatArray
from skincal.model.codec import OPTIONAL_FIELD

if TYPE_CHECKING:  # a skin of one axis loads no such module
    from skincal.model.skin_axes import SkinAxes, ValueOrder

SHARE_ON_Z = 0.95
"""Share of pokes with a z as the strongest value. The rest lean by more than 45 degrees, or miss the taxels."""
OPEN_MIN_SHARE_ON_Z = 0.5
"""Least share in the other order that makes it likely: by chance a third of the pokes are on z."""
MIN_POKES_WITHOUT_Z = 6
LOG_PRIOR_OF_WRONG_ORDER = float(np.log(0.01))
CERTAIN_LOG_ODDS = float(np.log(20.0))


@dataclass(frozen=True, slots=True)
class ValueOrderCounts:
    """Pokes by the axis of their strongest value, in both orders."""

    pokes: int = 0
    on_z_by_taxel: int = 0
    """Pokes whose strongest value is a z if values are grouped by taxel."""
    on_z_by_axis: int = 0
    pushed: tuple[int, ...] | None = field(default=None, metadata=OPTIONAL_FIELD)
    """For each taxel the pokes that its z answered, in the scene's order; `None` without pokes."""
    sheared: tuple[int, ...] | None = field(default=None, metadata=OPTIONAL_FIELD)
    """The same of pokes that its x and y answered, and its z did not."""

    def plus(self, newer: ValueOrderCounts | None) -> ValueOrderCounts:
        """Add the counts of a later part of the session."""
        if newer is None:
            return self
        return ValueOrderCounts(
            self.pokes + newer.pokes,
            self.on_z_by_taxel + newer.on_z_by_taxel,
            self.on_z_by_axis + newer.on_z_by_axis,
            _sum_by_taxel(self.pushed, newer.pushed),
            _sum_by_taxel(self.sheared, newer.sheared),
        )

    def on_z(self, order: ValueOrder) -> int:
        """Count the pokes whose strongest value is a z in an order."""
        return self.on_z_by_taxel if order.is_by_taxel else self.on_z_by_axis

    def log_odds_wrong(self, order: ValueOrder) -> float:
        """Natural logarithm of the odds that the values have the other order than this one."""
        gain, loss = np.log(3.0 * SHARE_ON_Z), np.log(1.5 * (1.0 - SHARE_ON_Z))
        right, wrong = self.on_z(order), self.on_z(order.other)
        return float((wrong - right) * (gain - loss) + LOG_PRIOR_OF_WRONG_ORDER)

    def has_no_z(self, order: ValueOrder) -> bool:
        """Whether the strongest value of most pokes is no z: axes or order of the scene are wrong."""
        return self.pokes >= MIN_POKES_WITHOUT_Z and self.on_z(order) < 0.5 * self.pokes

    def is_wrong(self, order: ValueOrder) -> bool:
        """Whether the values have the other order for certain."""
        return self.log_odds_wrong(order) > CERTAIN_LOG_ODDS and self.on_z(order.other) >= 0.75 * self.pokes


@dataclass(frozen=True, slots=True)
class OrderOfValues:
    """What the pokes say of the order that a scene names."""

    counts: ValueOrderCounts
    order: ValueOrder

    @property
    def log_odds_wrong(self) -> float:
        """Natural logarithm of the odds that the values have the other order."""
        return self.counts.log_odds_wrong(self.order)

    @property
    def is_wrong(self) -> bool:
        """Whether the values have the other order for certain."""
        return self.counts.is_wrong(self.order)

    @property
    def is_open(self) -> bool:
        """Whether the other order is likelier. Pokes whose strongest value is no z in either order show exchanged axes."""
        other = self.counts.on_z(self.order.other)
        return self.log_odds_wrong > LOG_PRIOR_OF_WRONG_ORDER and other >= OPEN_MIN_SHARE_ON_Z * self.counts.pokes


def _sum_by_taxel(first: tuple[int, ...] | None, second: tuple[int, ...] | None) -> tuple[int, ...] | None:
    if first is None or second is None:
        return second if first is None else first
    return tuple(map(int.__add__, first, second))


def sum_of_counts(counts: Iterable[ValueOrderCounts]) -> ValueOrderCounts:
    """Add up the counts of pokes."""
    total = ValueOrderCounts()
    for each in counts:
        total = total.plus(each)
    return total


def count_strongest(axes: SkinAxes, change: FloatArray, least: float = 0.0) -> ValueOrderCounts:
    """Count one poke, by how far the values of a frame are from their rest, (3 n,) raw units.

    A poke whose strongest value is not above `least` says nothing: it missed the skin.
    """
    sizes = np.abs(np.where(np.isfinite(change), change, 0.0))
    strongest, axes_per_taxel, z = int(sizes.argmax()), len(axes.places), axes.places[2]
    if not sizes[strongest] > least:
        return ValueOrderCounts()
    vectors = np.abs(axes.sort_values(np.where(np.isfinite(change), change, 0.0)))
    pushed: BoolArray = vectors[:, 2] > least
    sheared: BoolArray = (np.hypot(vectors[:, 0], vectors[:, 1]) > least) & ~pushed
    return ValueOrderCounts(
        1,
        int(strongest % axes_per_taxel == z),
        int(strongest // (len(change) // axes_per_taxel) == z),
        tuple(pushed.astype(int).tolist()),
        tuple(sheared.astype(int).tolist()),
    )
