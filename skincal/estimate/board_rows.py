"""What pokes say of a board's unknowns: two rows each, in standard deviations.

A poke's middle c (`touches.py`) has two rows, r = E (a - c), with the covariance

    D = E N E' + s^2 (I - o o'),   o = E n,

N the sensor's noise at the lever l of c (`uncertainty.h`), s how far a contact lies beside the middle, in the skin with the
normal n. Written as sums, so that nothing cancels where a lever is long or a push grazes the skin: with J a quarter turn,

    D = q I + p p' + r r',   q = (moment/|f|)^2 + (force/|f|)^2 (u.l)^2 + s^2 (u.n)^2,   p = force/|f| E l,   r = s J o,

and its determinant is q^2 + q (|p|^2 + |r|^2) + (p x r)^2. The rows are L^-1 r with D = L L'.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.estimate.boards import LEVER, Ground, Pads, crossed
from skincal.estimate.touches import Touches
from skincal.readings import FloatArray
from skincal.scene import NoiseSettings


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """The covariance D of each of m pokes: even I + swing swing' + skin skin'."""

    even: FloatArray
    """(m,) float, m^2: q."""
    swing: FloatArray
    """(m, 2) float, metres: p, of the force's noise at the lever."""
    skin: FloatArray
    """(m, 2) float, metres: r, of the contact's place in the skin."""
    push: FloatArray
    """(m, 2) float, metres: the roots of q's parts that turn with the board, force/|f| u.l and s u.n."""
    share: FloatArray
    """(m,) float: force/|f|."""


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The whitened rows of m pokes."""

    slopes: FloatArray
    """(m, 2, d) float, 1/m: change of the middle across the push with the board's unknowns, in standard deviations."""
    misses: FloatArray
    """(m, 2) float: how far the axis passes the middle, in standard deviations."""
    pitches: FloatArray
    """(m,) float: squared pitch, in standard deviations."""
    whiten: FloatArray
    """(m, 2, 2) float, 1/m: L^-1."""
    distances: FloatArray
    """(m,) float, metres: how far the axis passes the middle."""
    levers: FloatArray
    """(m, 3) float, metres: from the sensor to the middle."""
    gradients: FloatArray
    """(m, 3, d) float: change of the middle with the board's unknowns."""
    normals: FloatArray
    """(m, 3) float, unit, outward: of the skin at the middle."""
    spread: Spread


def whitened(touches: Touches, pads: Pads, noise: NoiseSettings) -> Rows:
    """Return the rows of pokes whose boards have their pads at `pads`."""
    evidence, at = touches.evidence, touches.rows
    places, gradients, normals = touches.middles(pads)
    pairs, pushes, forces = evidence.pairs[at], evidence.directions[at], evidence.forces[at]
    lever, share, beside = places - evidence.sensors[at], noise.force / forces, np.sqrt(touches.offsets)
    moment = (noise.moment / forces) ** 2
    swing, out = (np.sum(pairs * v[:, None], axis=2) for v in (share[:, None] * lever, beside[:, None] * normals))
    push = np.stack([share * np.sum(pushes * lever, axis=1), beside * np.sum(pushes * normals, axis=1)], axis=1)
    skin = np.stack([-out[:, 1], out[:, 0]], axis=1)
    spread = Spread(moment + np.sum(push * push, axis=1), swing, skin, push, share)
    whiten = _inverse_root(spread)
    off = np.sum(pairs * (evidence.nearest[at] - places)[:, None], axis=2)
    slopes = np.sum(pairs[:, :, :, None] * gradients[:, None], axis=2)
    return Rows(
        slopes=np.sum(whiten[:, :, :, None] * slopes[:, None], axis=2),
        misses=np.sum(whiten * off[:, None], axis=2),
        pitches=evidence.pitches[at] ** 2 / (moment + np.sum(swing * swing, axis=1)),
        whiten=whiten,
        distances=np.sqrt(np.sum(off * off, axis=1)),
        levers=lever,
        gradients=gradients,
        normals=normals,
        spread=spread,
    )


def _inverse_root(spread: Spread) -> FloatArray:
    """Return (m, 2, 2) L^-1 of D = L L', L lower triangular."""
    even, p, r = spread.even, spread.swing, spread.skin
    xx = even + p[:, 0] ** 2 + r[:, 0] ** 2
    xy = p[:, 0] * p[:, 1] + r[:, 0] * r[:, 1]
    cross = p[:, 0] * r[:, 1] - p[:, 1] * r[:, 0]
    determinant = even * (even + np.sum(p * p + r * r, axis=1)) + cross * cross
    l11 = np.sqrt(xx)
    l22 = np.sqrt(determinant) / l11
    inverse = np.zeros((len(xx), 2, 2))
    inverse[:, 0, 0], inverse[:, 1, 0], inverse[:, 1, 1] = 1.0 / l11, -xy / (xx * l22), 1.0 / l22
    return inverse


def bends_of(touches: Touches, rows: Rows, ground: Ground) -> FloatArray:
    """Return (m, d, d): how A'b of each poke changes with the unknowns but for -A'A, A its slopes and b its misses.

    With w = D^-1 E (a - c) that is w'E d2c - (D^-1 E dc)' dD w; a turn about an axis changes dc by axis x dc, n by axis x n.
    """
    spread, at = rows.spread, touches.rows
    pairs, pushes = touches.evidence.pairs[at], touches.evidence.directions[at]
    back = rows.whiten.transpose(0, 2, 1)
    slopes, w = back @ rows.slopes, back @ rows.misses[:, :, None]
    axes = ground.axes(rows.normals) / LEVER
    turns = axes.shape[1]
    swing = spread.share[:, None, None] * rows.gradients
    pushed, parts = spread.push[:, 0, None, None] * swing, [(spread.swing, pairs @ swing)]
    if turns > 1:
        # Without a surface the board's normal turns, too.
        skin = np.zeros_like(rows.gradients)
        tilted = crossed(axes, rows.normals[:, None]).transpose(0, 2, 1)
        skin[:, :, -turns:] = np.sqrt(touches.offsets)[:, None, None] * tilted
        out = pairs @ skin
        pushed = pushed + spread.push[:, 1, None, None] * skin
        parts.append((spread.skin, np.stack([-out[:, 1], out[:, 0]], axis=1)))
    bent = -2.0 * (slopes.transpose(0, 2, 1) @ w) @ (pushes[:, None] @ pushed)
    for part, change in parts:
        row = part[:, None]
        bent -= slopes.transpose(0, 2, 1) @ change * (row @ w)
        bent -= (row @ slopes).transpose(0, 2, 1) @ (w.transpose(0, 2, 1) @ change)
    # w'E . (axis x dc) = (w'E x axis) . dc
    pull = crossed(w.transpose(0, 2, 1) @ pairs, axes)
    bent[:, -turns:, -turns:] += pull @ rows.gradients[:, :, -turns:]
    return bent
