"""How well the contacts determine a position, from the rig's noise and never from the residuals.

Residuals of nearly parallel axes agree beautifully and are wrong, so the noise model speaks. In the sensor frame a
contact's residual is f x p + m; noise df and dm and a contact at p + c instead of p change it by dm - p x df + f x c.
With isotropic df and dm and c in the plane of the skin, unit normal n, its covariance is

    C = sigma_m^2 I + sigma_f^2 S(q) S(q)' + |f|^2 s^2 S(u) (I - n n') S(u)',

where the lever q = p - o runs from the sensor's origin o, about which the moment was measured. Eq. (6) turns the residual
into the link frame and no more, so C is turned with it: q, u and n are just written in the link frame.

**Offsets.** A contact in which the taxel answers less than its neighbour is a poke on the neighbour. If answers fall like a
bell of width `reach` about the tip, an answer of share k is off by s^2 = contact^2 + reach^2 ln(1/k) in each direction.
Neighbours' offsets do not average out: pokes on one neighbour share theirs. Where the taxel has pokes of its own, the
neighbours lie round it and nearly cancel; the more of its evidence is theirs, the fewer they are and the more one-sided.
So of the reach's part a share lambda^2 is taken as one offset common to all, lambda = min(1, mean of sqrt(ln(1/k)) / `EVEN`).

**Bend.** Beside a taxel on a convex part the normal leans outward by c/radius, and the pokes lean with it: the axes converge
below the skin. So offsets and directions are correlated, E[c] = -s^2/(2 radius) u_t/v, with u_t the direction's part along
the skin and v its weighted mean square in each direction; half, since a limb bends one way. The free method's depth is off by
what these offsets make of it, beta; it is taken as a standard deviation, not taken off, since it says nothing of hollows.

The two rows e_i.(p - a) of a contact are T (f x p + m)/|f| with T = [-e_2; e_1], since e_i.(u x v) = (e_i x u).v, so their
covariance is D = T C T'/|f|^2. The estimate is linear in the rows, p = G b with G = (A'A)^-1 A', so its covariance is
Sigma = G (K D K) G' + what is common: the estimator's own weights k, the rig's own noise. Confined to directions B (3, d),
as on a triangle, A becomes A B and Sigma becomes B (...) B'.

**It leaves out what all contacts share: wrong frames, a wrong mesh, errors of the F/T matrix; and errors of the arm's poses
unless `[noise]` says how large they are.**
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.estimate.evidence import Evidence, across
from skincal.estimate.qr import NO_RANK, Factors
from skincal.estimate.segments import dot, product, spread, total
from skincal.readings import FloatArray, IntArray
from skincal.scene import NoiseSettings

SD_MAX = 0.030
"""m. A position whose standard deviation in its worst direction exceeds this is none: it is the side of a whole module."""
EVEN = 0.4
"""Mean of sqrt(ln(1/k)) from which on all neighbours' offsets are one. Measured on the simulated forearm: 0.19 where every
taxel is poked as often, with 0.2 mm left in common; 0.39 and 0.47 at taxels never poked while two or one in three are, with
1.1 and 1.6 mm: the common part grows as the square of the mean."""


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """The covariance of t positions and their worst directions."""

    covariances: FloatArray
    """(t, 3, 3) float, m^2; without meaning where `sds` is infinite."""
    weakest: FloatArray
    """(t, 3) float, unit: the direction known worst."""
    sds: FloatArray
    """(t,) float, metres, along `weakest`; infinite where a direction is not determined at all."""


@dataclass(frozen=True, slots=True, eq=False)
class Offsets:
    """How far n contacts are beside their taxels, in each direction in the skin's plane."""

    squares: FloatArray
    """(n,) float, m^2: s^2, all of it."""
    common: FloatArray
    """(n,) float, metres: what is common to all contacts of a taxel, but for this factor."""


@dataclass(frozen=True, slots=True, eq=False)
class Freedom:
    """The directions in which t positions are free, and how the rows hold them there."""

    basis: FloatArray
    """(3, d, t) float: B, orthonormal columns."""
    inverse: FloatArray
    """(d, d, t) float: R^-1, where A B = Q R, so that G = B R^-1 Q' without a squared condition."""
    flattest: FloatArray
    """(3, t) float, unit: the direction along which the rows change least, where they do not determine all."""
    determined: NDArray[np.bool_]
    """(t,)."""


def in_space(factors: Factors) -> Freedom:
    """Return the freedom of positions that may lie anywhere."""
    order, systems = factors.order.T, np.arange(len(factors.order))
    r = factors.roots.transpose(1, 2, 0)[:, order, systems]
    basis, inverse = np.zeros_like(r), np.zeros_like(r)
    basis[order, np.array([[0], [1], [2]]), systems] = 1.0
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        inverse[0, 0], inverse[1, 1], inverse[2, 2] = 1.0 / r[0, 0], 1.0 / r[1, 1], 1.0 / r[2, 2]
        inverse[0, 1] = -r[0, 1] * inverse[0, 0] * inverse[1, 1]
        inverse[1, 2] = -r[1, 2] * inverse[1, 1] * inverse[2, 2]
        inverse[0, 2] = -(r[0, 1] * inverse[1, 2] + r[0, 2] * inverse[2, 2]) * inverse[0, 0]
    return Freedom(basis, inverse, factors.blind.T, factors.ranks == 3)


def in_planes(factors: Factors, normals: FloatArray) -> Freedom:
    """Return the freedom of positions that lie in planes with unit `normals` (t, 3)."""
    basis = across(normals).transpose(2, 1, 0)
    columns = product(factors.roots.transpose(1, 2, 0), basis)
    # The longer column first, as in `qr`.
    squares = np.stack([dot(columns[:, 0], columns[:, 0]), dot(columns[:, 1], columns[:, 1])])
    swap = squares[0] < squares[1]
    basis = np.where(swap, basis[:, ::-1], basis)
    first, second = np.where(swap, columns[:, 1], columns[:, 0]), np.where(swap, columns[:, 0], columns[:, 1])
    inverse = np.zeros((2, 2, len(swap)))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        long = np.sqrt(squares.max(axis=0))
        along = dot(first, second) / long
        rest = second - along / long * first
        short = np.sqrt(dot(rest, rest))
        inverse[0, 0], inverse[1, 1] = 1.0 / long, 1.0 / short
        inverse[0, 1] = -along * inverse[0, 0] * inverse[1, 1]
        flattest = basis[:, 1] - along / long * basis[:, 0]
        flattest = flattest / np.sqrt(dot(flattest, flattest))
    return Freedom(basis, inverse, flattest, short > NO_RANK * long)


def offset_squares(evidence: Evidence, noise: NoiseSettings) -> FloatArray:
    """Return s^2 (n,), m^2: how far each contact is beside its taxel, in each direction in the skin's plane."""
    return noise.contact**2 - noise.reach**2 * np.minimum(np.log(evidence.weights), 0.0)


def offsets(evidence: Evidence, noise: NoiseSettings) -> Offsets:
    """Return how far the contacts are beside their taxels."""
    less = np.sqrt(np.maximum(-np.log(evidence.weights), 0.0))
    squares = evidence.scales**2
    share = np.minimum(total(squares * less, evidence.starts) / total(squares, evidence.starts) / EVEN, 1.0)
    beside = noise.reach * less
    common = beside * spread(share, evidence.taxels)
    return Offsets(noise.contact**2 + beside * beside, common)


def sensor_noise(evidence: Evidence, points: FloatArray, noise: NoiseSettings) -> tuple[FloatArray, FloatArray]:
    """Return what the sensor adds to each contact's two rows, before weighting, for taxels at `points` (t, 3).

    Returns
    -------
    even : (n,) float, m^2
    less : (2, n) float, metres; the covariance is even I - less less', the variance of the pitch (sigma_m/|f|)^2 + |less|^2
    """
    q = spread(points.T, evidence.taxels) - evidence.columns[8:11]
    # S(q) S(q)' = |q|^2 I - q q', and T turns q into (-e_2.q, e_1.q).
    relative = noise.force / evidence.forces
    less = relative * (evidence.columns[11:17].reshape(2, 3, -1)[::-1] * q).sum(axis=1)
    np.negative(less[0], out=less[0])
    return (noise.moment / evidence.forces) ** 2 + relative * relative * dot(q, q), less


def row_noise(evidence: Evidence, points: FloatArray, noise: NoiseSettings) -> tuple[FloatArray, FloatArray]:
    """Return a bound of the noise of each contact's two rows, before weighting, for taxels at `points` (t, 3).

    D <= even I - less less': the contact's offset counts in every direction here, not in the skin's plane alone.

    Returns
    -------
    even : (n,) float, m^2
    less : (2, n) float, metres
    """
    even, less = sensor_noise(evidence, points, noise)
    return even + offset_squares(evidence, noise), less


def rows_in_skin(evidence: Evidence, normals: FloatArray) -> FloatArray:
    """Return (2, n) e_i.n for normals (3, t) of either sign."""
    return (evidence.columns[11:17].reshape(2, 3, -1) * spread(normals, evidence.taxels)).sum(axis=1)


def along_pushes(evidence: Evidence) -> FloatArray:
    """Return (3, t) the unit vectors along the mean pushes; 0 where pushes cancel."""
    pushes = evidence.pushes().T
    lengths = np.sqrt(dot(pushes, pushes))
    return np.where(lengths > 0, pushes / lengths, 0.0)


def propagate(evidence: Evidence, freedom: Freedom, points: FloatArray, noise: NoiseSettings) -> Uncertainty:
    """Carry the rig's noise through the weighted least squares to the positions.

    Parameters
    ----------
    freedom : of the t positions
    points : (t, 3) float, metres, where the noise is evaluated
    """
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        held = spread(product(freedom.basis, freedom.inverse), evidence.taxels)
        # Q = A B R^-1, its rows multiplied by the estimator's weights once more.
        squares = evidence.scales**2
        rows = _Rows(squares * dot(evidence.columns[11:14, None], held), squares * dot(evidence.columns[14:17, None], held))
        middle = _contacts(evidence, rows, freedom, points, noise)
        if noise.pose_turn > 0 or noise.pose_shift > 0:
            middle += _poses(evidence, rows, points, noise)
        small = product(product(freedom.inverse, middle), freedom.inverse.transpose(1, 0, 2))
        covariances = product(product(freedom.basis, small), freedom.basis.transpose(1, 0, 2))
    finite = freedom.determined & np.isfinite(covariances).all(axis=(0, 1))
    small[:, :, ~finite] = 0.0
    values, directions = _largest(small)
    weakest = np.where(finite, product(freedom.basis, directions[:, None])[:, 0], freedom.flattest)
    return Uncertainty(covariances.transpose(2, 0, 1), unsigned(weakest.T), np.where(finite, np.sqrt(values), np.inf))


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """How far each contact's two rows move the d coordinates of Q, (d, n) each."""

    first: FloatArray
    second: FloatArray


def _contacts(evidence: Evidence, rows: _Rows, freedom: Freedom, points: FloatArray, noise: NoiseSettings) -> FloatArray:
    """Return (d, d, t) what sensor and offsets add."""
    normals = _normals(evidence, freedom)
    out = rows_in_skin(evidence, normals)
    beside = offsets(evidence, noise)
    own = beside.squares - beside.common * beside.common
    even, less = sensor_noise(evidence, points, noise)
    even = even + own
    within, between = even - less * less - own * out * out, less[0] * less[1] + own * out[0] * out[1]
    q1, q2 = rows.first, rows.second
    d1, d2 = within[0] * q1 - between * q2, within[1] * q2 - between * q1
    middle = total(q1[:, None] * d1 + q2[:, None] * d2, evidence.starts)
    along = beside.common * evidence.columns[11:17]
    moved = total(q1[:, None] * along[:3] + q2[:, None] * along[3:], evidence.starts)
    moved = moved - product(moved, normals[:, None]) * normals
    middle += product(moved, moved.transpose(1, 0, 2))
    return middle + _bend(evidence, rows, normals, out, beside, noise) if len(q1) == 3 else middle


def _normals(evidence: Evidence, freedom: Freedom) -> FloatArray:
    """Return (3, t) the unit normals of the skin, of either sign: of the plane, or along the mean push."""
    if freedom.basis.shape[1] == 3:
        return along_pushes(evidence)
    (ax, ay, az), (bx, by, bz) = freedom.basis.transpose(1, 0, 2)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _bend(
    evidence: Evidence, rows: _Rows, normals: FloatArray, out: FloatArray, beside: Offsets, noise: NoiseSettings
) -> FloatArray:
    """Return (3, 3, t) what the skin's bend adds: beta beta', since offsets go with the push's lean."""
    squares = evidence.scales**2
    # The lean's squared sine; no lean is known better than the force's direction.
    lean = (out[0] * out[0] + out[1] * out[1]) / 2.0 + (noise.force / evidence.forces) ** 2
    size = total(squares, evidence.starts) / total(squares * lean, evidence.starts) / (2.0 * noise.radius)
    # e_i.u_t = e_i.(u - (n.u) n) = -(n.u) (e_i.n).
    far = beside.squares * dot(evidence.columns[0:3], spread(normals, evidence.taxels))
    beta = size * total(far * (out[0] * rows.first + out[1] * rows.second), evidence.starts)
    return beta[:, None] * beta


def _poses(evidence: Evidence, rows: _Rows, points: FloatArray, noise: NoiseSettings) -> FloatArray:
    """Return (d, d, t) what the arm's poses add: each moves all contacts in it by dtheta x q + dt."""
    taxels = evidence.taxels
    _, first, group = np.unique(taxels * (1 + evidence.poses.max()) + evidence.poses, return_index=True, return_inverse=True)
    # Poses in the order of the evidence, which depends on its numbers alone; their own numbers tell which came first.
    order = np.argsort(first[group], kind="stable")
    heads: IntArray = np.sort(first)
    begins: IntArray = np.append(np.searchsorted(first[group][order], heads), len(order))
    moves = rows.first[:, None] * evidence.columns[11:14] + rows.second[:, None] * evidence.columns[14:17]
    moved = total(np.take(moves, order, axis=2), begins)
    lever: FloatArray = noise.pose_turn * (points.T[:, taxels[heads]] - evidence.sensors.T[:, heads])
    x, y, z = lever
    none = np.zeros(len(heads))
    turned = product(moved, np.stack([[none, -z, y], [z, none, -x], [-y, x, none]]))
    each = product(turned, turned.transpose(1, 0, 2)) + noise.pose_shift**2 * product(moved, moved.transpose(1, 0, 2))
    return total(each, np.searchsorted(heads, evidence.starts))


def _largest(matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the largest eigenvalue (t,) of symmetric `matrices` (d, d, t), d 2 or 3, and its unit eigenvector (d, t)."""
    if len(matrices) == 3:
        values, axes = np.linalg.eigh(matrices.transpose(2, 0, 1))
        return values[:, -1], axes[:, :, -1].T
    a, b, c = matrices[0, 0], matrices[0, 1], matrices[1, 1]
    half = (a - c) / 2.0
    radius = np.sqrt(half * half + b * b)
    axes = np.stack([half + radius, b])
    # The other row of the matrix less its eigenvalue, where this one cancels.
    cancels = half < 0
    axes[:, cancels] = np.stack([b, radius - half])[:, cancels]
    axes[0, radius == 0.0] = 1.0
    return (a + c) / 2.0 + radius, axes / np.sqrt(axes[0] * axes[0] + axes[1] * axes[1])


def unsigned(directions: FloatArray) -> FloatArray:
    """Return unit vectors along `directions` (t, 3) whose largest component is positive: a line has no sign."""
    x = directions.T
    largest = x[np.abs(x).argmax(axis=0), np.arange(x.shape[1])]
    with np.errstate(invalid="ignore"):
        return (x / (np.copysign(1.0, largest) * np.sqrt(dot(x, x)))).T
