"""What the contacts say about each taxel: the rows of the paper's system (5), in the link frame.

For a contact with wrench (f, m), carried into the link frame by eq. (6), a taxel at p has the residual
(f x p + m)/|f| = u x p + m/|f| with u = f/|f|. Its weight is k = t_j / max_y t_y, its three rows in (5) are
k S(u) p = -k m/|f|. Along u they say nothing of p: there stands the pitch (eq. 3) on one side and nought on the other.
So two rows do: with a = u x m/|f| the axis's point nearest to the origin and e_1, e_2 orthonormal across u,

    |u x p + m/|f||^2 = (e_1.(p - a))^2 + (e_2.(p - a))^2 + pitch^2.

The minimum is that of (5). What is gained is digits: a heavy contact's pitch can no longer leak, through the rounding of
a row that should be nought, into a direction that only light contacts determine.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.readings import FloatArray, IntArray
from skincal.wrench import move_wrench

MISS_MAX = 0.050
"""m. Axes that pass a taxel at more than this (weighted rms) are of another part, frame or unit: no error of a rig is as
large."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """The contacts in which one taxel answered, in an order that depends on their numbers alone."""

    directions: FloatArray
    """(n, 3) float: u = f/|f|, link frame."""
    moments: FloatArray
    """(n, 3) float, metres: m/|f| about the link's origin."""
    forces: FloatArray
    """(n,) float, N: |f|."""
    weights: FloatArray
    """(n,) float, 0 < k <= 1."""
    sensors: FloatArray
    """(n, 3) float, metres: the sensor's origin in the link frame; the lever p - sensors carries the force's noise."""
    across: FloatArray
    """(n, 2, 3) float: e_1 and e_2 of each contact, with e_1 x e_2 = u."""

    @property
    def contacts(self) -> int:
        """Number of contacts."""
        return len(self.forces)

    def rows(self) -> tuple[FloatArray, FloatArray]:
        """Return the weighted system: A (2n, 3) and b (2n,); the least squares of A p = b are those of (5)."""
        weighted = self.weights[:, None, None] * self.across
        nearest = np.cross(self.directions, self.moments)
        return weighted.reshape(-1, 3), np.einsum("nij,nj->ni", weighted, nearest).ravel()

    def push(self) -> FloatArray:
        """Return the weighted mean of the directions, (3,); shorter than 1 the more they differ."""
        return self.weights @ self.directions / self.weights.sum()

    def miss(self, point: FloatArray) -> float:
        """Return at what distance the axes pass `point` (3,), metres: the weighted root mean square."""
        a, b = self.rows()
        return float(np.linalg.norm(a @ point - b) / np.linalg.norm(self.weights))


def across(u: FloatArray) -> FloatArray:
    """Return (n, 2, 3): two directions e_1, e_2 with e_1 x e_2 = u, orthonormal, for each of `u` (n, 3), unit."""
    # Duff et al., "Building an orthonormal basis, revisited", 2017: no branch on nearly parallel helpers.
    x, y, z = u.T
    sign = np.copysign(1.0, z)
    k = -1.0 / (sign + z)
    xy = x * y * k
    first = np.stack([1.0 + sign * x * x * k, sign * xy, -sign * x], axis=1)
    return np.stack([first, np.stack([xy, sign + y * y * k, -y], axis=1)], axis=1)


def gather(contacts: Sequence[Contact], channels: Collection[int]) -> dict[int, Evidence]:
    """Return the evidence of each of `channels` that answered in a contact; the others have no entry.

    Raises
    ------
    ValueError
        A contact of these channels has a number that is not finite, no force, or a response that is not above zero.
    """
    touched = _touched(contacts, channels)
    if not touched:
        return {}
    which, channel, weight = _answers(touched, channels)
    table = _carried(touched)
    # Sorted by content, so that the order in which the pokes came leaves no trace, not even in the last digit.
    order = np.lexsort((*table.T[:, which], weight, channel))
    channel, weight, rows = channel[order], weight[order], table[which[order]]
    frames = across(table[:, :3])[which[order]]
    starts = np.flatnonzero(np.r_[True, channel[1:] != channel[:-1]])
    parts = zip(starts, np.r_[starts[1:], len(channel)], strict=True)
    return {int(channel[a]): _evidence(rows[a:b], weight[a:b], frames[a:b]) for a, b in parts}


def _evidence(rows: FloatArray, weights: FloatArray, frames: FloatArray) -> Evidence:
    # Copies, so that sums run over the same memory layout whichever other taxels were asked for.
    u, moments, sensors = rows[:, 0:3].copy(), rows[:, 3:6].copy(), rows[:, 7:10].copy()
    return Evidence(u, moments, rows[:, 6].copy(), weights.copy(), sensors, frames.copy())


def _touched(contacts: Sequence[Contact], channels: Collection[int]) -> list[Contact]:
    """Return the contacts in which one of `channels` answered."""
    if not contacts or not channels:
        return []
    answered = np.concatenate([contact.channels for contact in contacts])
    owner = np.repeat(np.arange(len(contacts)), [len(contact.channels) for contact in contacts])
    return [contacts[index] for index in dict.fromkeys(owner[_among(answered, channels)].tolist())]


def _among(answered: IntArray, channels: Collection[int]) -> IntArray:
    """Return the places in `answered` that hold one of `channels`."""
    wanted = np.zeros(max(int(answered.max(initial=0)), max(channels)) + 1, dtype=bool)
    wanted[list(channels)] = True
    return np.flatnonzero(wanted[answered])


def _answers(contacts: list[Contact], channels: Collection[int]) -> tuple[IntArray, IntArray, FloatArray]:
    """Return for each answer of one of `channels`: index of the contact, channel, weight k."""
    sizes = np.array([len(contact.channels) for contact in contacts])
    answered = np.concatenate([contact.channels for contact in contacts])
    responses = np.concatenate([contact.responses for contact in contacts])
    strongest = np.maximum.reduceat(responses, np.cumsum(sizes) - sizes)
    chosen = _among(answered, channels)
    which = np.repeat(np.arange(len(contacts)), sizes)[chosen]
    with np.errstate(invalid="ignore", divide="ignore"):
        weight = responses[chosen] / strongest[which]
    good = np.isfinite(weight) & (weight > 0)
    if not good.all():
        poke = contacts[int(which[(~good).argmax()])].poke
        raise ValueError(f"poke {poke}: a taxel's response is not a number above zero")
    return which, answered[chosen].astype(np.int64), weight


def _carried(contacts: Sequence[Contact]) -> FloatArray:
    """Return (n, 10): u, m/|f|, |f| and the sensor's origin of each contact, link frame."""
    poses = np.array([contact.link_from_sensor for contact in contacts], dtype=float)
    force, moment = move_wrench(
        poses,
        np.array([contact.force for contact in contacts], dtype=float),
        np.array([contact.moment for contact in contacts], dtype=float),
    )
    size = np.sqrt(force[:, 0] * force[:, 0] + force[:, 1] * force[:, 1] + force[:, 2] * force[:, 2])
    good = np.isfinite(poses).all(axis=(1, 2)) & np.isfinite(moment).all(axis=1) & np.isfinite(size) & (size > 0)
    if not good.all():
        poke = contacts[int((~good).argmax())].poke
        raise ValueError(f"poke {poke}: its wrench or pose is not finite, or it has no force")
    return np.concatenate([force / size[:, None], moment / size[:, None], size[:, None], poses[:, :3, 3]], axis=1)
