"""What the contacts say about each taxel: the rows of the paper's system (5), in the link frame.

For a contact with wrench (f, m), carried into the link frame by eq. (6), a taxel at p has the residual
(f x p + m)/|f| = u x p + m/|f| with u = f/|f|. Its weight is k = t_j / max_y t_y, its three rows in (5) are
k S(u) p = -k m/|f|. Along u they say nothing of p: there stands the pitch (eq. 3) on one side and nought on the other.
So two rows do: with a = u x m/|f| the axis's point nearest to the origin and e_1, e_2 orthonormal across u,

    |u x p + m/|f||^2 = (e_1.(p - a))^2 + (e_2.(p - a))^2 + pitch^2.

The minimum is that of (5). What is gained is digits: a heavy contact's pitch can no longer leak, through the rounding of
a row that should be nought, into a direction that only light contacts determine.

Answers of many taxels lie one after another in the same arrays, cut by `starts`. Beside k stands the trust, 0 to 1, a
factor of the contact's share of the sum of squares (`skincal/solver/source/trust.h`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skincal.readings import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """The n answers of t taxels, each taxel's in an order that depends on their numbers alone: heaviest first."""

    channels: IntArray
    """(t,) ascending."""
    starts: IntArray
    """(t + 1,): taxel i has the answers starts[i] to starts[i + 1], at least one."""
    taxels: IntArray
    """(n,) index of the taxel that answered, 0 to t - 1."""
    pokes: IntArray
    """(n,) number of the poke."""
    poses: IntArray
    """(n,) equal where the arm's pose has the same name."""
    columns: FloatArray
    """(17, n): u, nearest, |f|, pitch, sensor, e_1, e_2; read by the properties below."""
    weights: FloatArray
    """(n,) float, 0 < k <= 1."""
    trust: FloatArray
    """(n,) float, 0 to 1: how far the contact counts for the taxel; 1 but for outliers."""

    @property
    def directions(self) -> FloatArray:
        """(n, 3) float: u = f/|f|, link frame."""
        return self.columns[0:3].T

    @property
    def nearest(self) -> FloatArray:
        """(n, 3) float, metres: a = u x m/|f|, the axis's point nearest to the link's origin."""
        return self.columns[3:6].T

    @property
    def forces(self) -> FloatArray:
        """(n,) float, N: |f|."""
        return self.columns[6]

    @property
    def pitches(self) -> FloatArray:
        """(n,) float, metres: f . m/|f|^2 about the link's origin, the same about any point."""
        return self.columns[7]

    @property
    def sensors(self) -> FloatArray:
        """(n, 3) float, metres: the sensor's origin in the link frame; the lever p - sensors carries the force's noise."""
        return self.columns[8:11].T

    @property
    def pairs(self) -> FloatArray:
        """(n, 2, 3) float: e_1 and e_2 of each contact, with e_1 x e_2 = u."""
        return self.columns[11:17].reshape(2, 3, -1).transpose(2, 0, 1)

    @property
    def counts(self) -> IntArray:
        """(t,) contacts of each taxel."""
        return self.starts[1:] - self.starts[:-1]

    def doubted(self) -> list[dict[int, float]]:
        """Return for each taxel the pokes whose trust is below 1: number to trust."""
        doubted: list[dict[int, float]] = [{} for _ in range(len(self.channels))]
        for place in (self.trust < 1.0).nonzero()[0].tolist():
            doubted[int(self.taxels[place])][int(self.pokes[place])] = float(self.trust[place])
        return doubted

    def trusted(self, trust: FloatArray) -> Evidence:
        """Return the same evidence with another trust (n,)."""
        return replace(self, trust=trust)

    def part(self, first: int, last: int) -> Evidence:
        """Return the evidence of taxels `first` to `last` (excluded) alone."""
        begin, end = self.starts[first], self.starts[last]
        return Evidence(
            channels=self.channels[first:last],
            starts=self.starts[first : last + 1] - begin,
            taxels=self.taxels[begin:end] - first,
            pokes=self.pokes[begin:end],
            poses=self.poses[begin:end],
            columns=self.columns[:, begin:end],
            weights=self.weights[begin:end],
            trust=self.trust[begin:end],
        )


def across(u: FloatArray) -> FloatArray:
    """Return (n, 2, 3): two directions e_1, e_2 with e_1 x e_2 = u, orthonormal, for each of `u` (n, 3), unit."""
    # Duff et al., "Building an orthonormal basis, revisited", 2017: no branch on nearly parallel helpers.
    x, y, z = u.T
    sign = np.copysign(1.0, z)
    k = -1.0 / (sign + z)
    xy = x * y * k
    both = np.empty((len(u), 2, 3))
    both[:, 0, 0], both[:, 0, 1], both[:, 0, 2] = 1.0 + sign * x * x * k, sign * xy, -sign * x
    both[:, 1, 0], both[:, 1, 1], both[:, 1, 2] = xy, sign + y * y * k, -y
    return both
