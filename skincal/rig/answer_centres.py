"""Taxels of the surface method by the centre of the answers to each poke, where a tool's tip places the pokes.

The surface method places each taxel by its own answers alone. But a poke that several taxels answer was between them: the
centre of the answering taxels, weighted by their answers, lies at the poke. The modules method rests on the same
(`skincal.modules.pose_fit`); here each taxel has a place of its own. With S_j the estimate of taxel j, B_j two directions in
its triangle, d_j its shift there, y_i the touched point of poke i and s_ij the share of taxel j in its answers,

    B_j'(y_i - S_j) = d_j + noise of variance t^2 + contact^2 + reach^2 ln(1/k_ij),       each answer,
    B_i'(y_i - sum_j s_ij S_j) = sum_j s_ij B_i'B_j d_j + noise of variance t^2 + c_n^2,   each poke with n > 1 answers,

with B_i two directions in the skin there, t the error of a tip's place, and c_n that of the centre of n answers. Linear least
squares gives all d at once. The first kind alone has the weights of the noise in place of k^2. The noise of answers to one
poke is not independent, so covariances are `DEPENDENT_ANSWERS_FACTOR` times those of the equations.

Nothing is assumed of the shape of a taxel's answer. Where answers fall off as those of a half-space (`skincal.physics.skin`),
the centre gains about as much as where they fall off as a bell.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skincal.geometry import FloatArray, IntArray, orthonormal_pair
from skincal.mesh.search import nearest_points
from skincal.mesh.surface import Surface
from skincal.model.scene import NoiseSettings
from skincal.modules.pose_fit import CONTACT_TO_PAD_CENTRE_SD_FACTOR
from skincal.taxels.contact_table import Evidence
from skincal.taxels.noise import offset_square
from skincal.taxels.result import POSITION_MAX_SD_M, Estimate, State
from skincal.taxels.shared_errors import variance_factors

DEPENDENT_ANSWERS_FACTOR = 1.2
"""Variance over that of independent answers. With neither this nor `variance_factors` predicted errors are 0.87 of the true
ones by the bell of the independent simulator, and 0.89 on a half-space, with gains of 20 %."""
JOINED_TAXELS_MAX = 600
"""Taxels that are solved together; of more each keeps its own estimate: their equations would take seconds after each poke."""


def join_by_centres(
    estimates: Sequence[Estimate], evidence: Evidence, surface: Surface, noise: NoiseSettings, place_sd: float
) -> list[Estimate]:
    """Estimate taxels of the surface method again by the centres of the answers; those without a sure place are not changed.

    Parameters
    ----------
    estimates : of the surface method
    evidence : of pokes that the tip places: their sensors' origins are the touched points
    place_sd : m, sd of a touched point, each direction
    """
    found, answers = list(estimates), _SureAnswers.select(estimates, evidence)
    if not 0 < len(answers.rows) <= JOINED_TAXELS_MAX:
        return found
    count, of = len(answers.rows), answers.of
    own = answers.trust / (offset_square(answers.weights, noise) + place_sd**2)
    normal, pull = np.zeros((count, 2, count, 2)), np.zeros((count, 2))
    off = (answers.pairs[of] @ answers.off[:, :, None])[:, :, 0]
    np.add.at(normal.transpose(0, 2, 1, 3), (of, of), own[:, None, None] * np.eye(2))
    np.add.at(pull, of, own[:, None] * off)
    for chosen in answers.groups:
        size = chosen.shape[1]
        variance = (CONTACT_TO_PAD_CENTRE_SD_FACTOR * noise.contact / size) ** 2 + place_sd**2
        _add_centres(normal, pull, answers, chosen, variance)
    determined = np.flatnonzero(np.bincount(of, own, count) > POSITION_MAX_SD_M**-2)
    if not len(determined):
        return found
    matrix = normal[determined][:, :, determined].reshape(2 * len(determined), -1)
    inverse = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    shifts = np.zeros((count, 2))
    shifts[determined] = (inverse @ pull[determined].ravel()).reshape(-1, 2)
    blocks = inverse.reshape(len(determined), 2, len(determined), 2)
    at = np.arange(len(determined))
    squares, order = own * np.sum((off - shifts[of]) ** 2, axis=1), np.argsort(of, kind="stable")
    starts = np.searchsorted(of[order], np.arange(count))
    factors = variance_factors(squares[order], np.ones(len(order)), starts, 2)[determined]
    covariances = (DEPENDENT_ANSWERS_FACTOR * factors)[:, None, None] * blocks[at, :, at]
    pairs = answers.pairs[determined]
    moved = answers.places[determined] + (shifts[determined][:, None] @ pairs)[:, 0]
    new = _bound_to_mesh(moved, pairs.transpose(0, 2, 1) @ covariances @ pairs, surface)
    rows: list[int] = answers.rows[determined].tolist()
    for row, values in zip(rows, new, strict=True):
        found[row] = replace(found[row], **values)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _SureAnswers:
    """n answers of c taxels with a sure place."""

    rows: IntArray
    """(c,) of the taxels in the estimates."""
    places: FloatArray
    """(c, 3) float, metres: S."""
    pairs: FloatArray
    """(c, 2, 3) float: B, two directions in the triangle."""
    normals: FloatArray
    """(c, 3) float, unit."""
    of: IntArray
    """(n,) index of each answer's taxel."""
    weights: FloatArray
    """(n,) float: k."""
    trust: FloatArray
    """(n,) float, 0 to 1; 0 for a poke that is too far away."""
    off: FloatArray
    """(n, 3) float, metres: from S to the touched point."""
    groups: tuple[IntArray, ...]
    """(g, k) rows of the answers of pokes that k of these taxels answered, and no other one, for each k > 1."""

    @classmethod
    def select(cls, estimates: Sequence[Estimate], evidence: Evidence) -> _SureAnswers:
        """Select the answers of the taxels whose place on the mesh is sure."""
        row_of = {each.channel: row for row, each in enumerate(estimates) if _is_sure(each)}
        of_channel = np.array([row_of.get(channel, -1) for channel in evidence.channels.tolist()], dtype=np.int64)
        is_ranked = np.bincount(evidence.taxels, evidence.unranked, len(evidence.channels)) == 0
        row = np.where(is_ranked, of_channel, -1)[evidence.taxels]
        known = np.flatnonzero(row >= 0)
        rows, of = np.unique(row[known], return_inverse=True)
        chosen_rows: list[int] = rows.tolist()
        some = [estimates[each] for each in chosen_rows]
        places = np.array([each.position for each in some], dtype=np.float64).reshape(-1, 3)
        normals = np.array([each.normal for each in some], dtype=np.float64).reshape(-1, 3)
        off, pokes = evidence.sensors[known] - places[of], evidence.pokes[known]
        owners: list[int] = of.tolist()
        trust = [some[owner].doubted.get(poke, 1.0) for owner, poke in zip(owners, pokes.tolist(), strict=True)]
        near = np.linalg.norm(off, axis=1) < POSITION_MAX_SD_M
        numbers, every = np.unique(evidence.pokes, return_inverse=True)
        answers, sure = (np.bincount(each, minlength=len(numbers)) for each in (every, every[known]))
        groups: list[IntArray] = []
        for size in np.unique(answers[(answers == sure) & (answers > 1)]).tolist():
            whole = ((answers == size) & (sure == size))[every[known]]
            chosen = np.flatnonzero(whole)
            groups.append(chosen[np.argsort(every[known][chosen], kind="stable")].reshape(-1, size))
        pairs = orthonormal_pair(normals)
        return cls(rows, places, pairs, normals, of, evidence.weights[known], np.where(near, trust, 0.0), off, tuple(groups))


def _is_sure(estimate: Estimate) -> bool:
    is_placed = estimate.position is not None and estimate.normal is not None
    return is_placed and estimate.state is State.TOUCHED and estimate.rival is None


def _add_centres(normal: FloatArray, pull: FloatArray, answers: _SureAnswers, chosen: IntArray, variance: float) -> None:
    """Add the equations of pokes whose answers are `chosen` (g, k), with the variance of a centre, m^2."""
    weights, of = answers.weights[chosen], answers.of[chosen]
    shares = weights / weights.sum(axis=1, keepdims=True)
    mean = np.sum(shares[:, :, None] * answers.normals[of], axis=1)
    across = orthonormal_pair(mean / np.linalg.norm(mean, axis=1, keepdims=True))
    centre = np.sum(shares[:, :, None] * answers.off[chosen], axis=1)
    slopes = shares[:, :, None, None] * (across[:, None] @ answers.pairs[of].transpose(0, 1, 3, 2))
    weighted = (answers.trust[chosen].min(axis=1) / variance)[:, None, None, None] * slopes.transpose(0, 1, 3, 2)
    np.add.at(pull, of, (weighted @ (across @ centre[:, :, None])[:, None])[..., 0])
    blocks = np.einsum("gaxy,gbyz->gabxz", weighted, slopes)
    np.add.at(normal.transpose(0, 2, 1, 3), (of[:, :, None], of[:, None]), blocks)


def _bound_to_mesh(places: FloatArray, covariances: FloatArray, surface: Surface) -> Iterator[dict[str, Any]]:
    """Yield the values of estimates at the points of the mesh next to `places` (n, 3), metres, with covariances (n, 3, 3)."""
    near, triangles = nearest_points(surface, places)
    normals = surface.normals[triangles]
    flat = np.eye(3) - normals[:, :, None] * normals[:, None]
    covariances = flat @ covariances @ flat
    values, axes = np.linalg.eigh(covariances)
    worst = axes[:, :, -1]
    signs = np.copysign(1.0, np.take_along_axis(worst, np.abs(worst).argmax(axis=1)[:, None], axis=1))
    for row, triangle in enumerate(triangles.tolist()):
        yield {
            "position": near[row], "normal": normals[row], "triangle": triangle, "covariance": covariances[row],
            "worst_direction": worst[row] * signs[row], "sd": float(np.sqrt(values[row, -1])),
            "rms": float(np.sqrt(np.trace(covariances[row]))),
        }  # fmt: skip
