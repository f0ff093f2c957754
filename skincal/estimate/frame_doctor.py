"""Whether the sensor's frame is the one that the scene says, from a few pokes at landmarks.

Each mistake that is made with such frames is a hypothesis: an order of the axes with signs (48, among them the right one and
the reaction in place of the action), moments in another unit than newton metres beside the forces', and a sensor that sits
elsewhere on the arm than told. Under each the poke's axis passes its landmark at some distance across, in its two directions
with the standard deviation `TOLERANCE`; a push that comes from inside the part is as unlikely as three of these. A sensor
that sits elsewhere by a turn w and a shift t, of which only the sizes are known (`TURN`, `SHIFT`), is weighed by the same
likelihood, averaged over all w and t: residuals of the covariance I + J J', so that its freedom costs what it is worth.

What it says is an offer. Nothing is changed by it. It does not tell a small error of the mounting from one of the F/T matrix:
that is what the correction of the rig is for (`rig_fit.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import permutations, product

import numpy as np

from skincal.estimate.boards import rotations
from skincal.estimate.evidence import across
from skincal.estimate.rig_fit import LandmarkPoke
from skincal.readings import FloatArray
from skincal.wrench import cross_matrix, move_wrench

TOLERANCE = 0.005
"""m, sd of an axis from its landmark, each direction, on a rig whose frame is right: hand, landmark and rig errors together."""
TURN, SHIFT = float(np.radians(15.0)), 0.030
"""rad and m, sd of a wrong mounting, each axis: a bracket that was turned, a wrong length."""
INSIDE = 9.0
"""What a push from inside the part costs, as a sum of squares: three standard deviations."""
RIGHT = 2.0
"""By how much less likely any mistake is than none, as a difference of twice the logarithm: one session in four."""
SURE = 6.0
"""Twice the logarithm of how much likelier the best hypothesis must be than the next: 20 times."""
FEWEST = 3
"""Pokes below which nothing is said."""
FORCE_SIZE = (3.0, 25.0)
"""N: pokes of a hand lie between."""
GRAVITY = 9.80665
MOMENT_UNITS = {
    1.0: "",
    1e-3: "the moments are newton millimetres, not newton metres",
    1e-2: "the moments are newton centimetres, not newton metres",
    GRAVITY: "the moments are kilogram-force metres beside newtons",
    1.0 / GRAVITY: "the forces are kilogram-force beside newton metres",
}
"""What the moments are multiplied by, in words."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameCorrection:
    """What makes a told wrench and pose the right ones."""

    axes: FloatArray = field(default_factory=lambda: np.eye(3))
    """(3, 3) float, of noughts and one of 1 or -1 a row: the right axes are this times the told ones, of force and moment."""
    force_scale: float = 1.0
    moment_scale: float = 1.0
    motion: FloatArray = field(default_factory=lambda: np.eye(4))
    """(4, 4) float, metres: link_from_sensor is the one told times this."""

    def corrected(self, poke: LandmarkPoke) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return force (3,), N, moment (3,), N m, and link_from_sensor (4, 4) as they are under the correction."""
        force, moment = self.force_scale * self.axes @ poke.force, self.moment_scale * self.axes @ poke.moment
        return force, moment, poke.link_from_sensor @ self.motion


@dataclass(frozen=True, slots=True, eq=False)
class FrameDiagnosis:
    """What the pokes say of the frame."""

    words: str
    """A sentence for the operator, with the miss as told and as corrected."""
    right: bool
    """The frame is the one that the scene says."""
    sure: bool
    """No other hypothesis is nearly as likely."""
    miss: float
    """m: at what distance the axes pass the landmarks as told, root mean square."""
    corrected_miss: float
    """m: the same under the correction."""
    correction: FrameCorrection
    """Offered; nothing is changed by it."""


@dataclass(frozen=True, slots=True, eq=False)
class _Hypothesis:
    words: str
    correction: FrameCorrection
    cost: float
    """Minus twice the logarithm of the likelihood, but for what all have in common."""
    miss: float


def diagnose(pokes: Sequence[LandmarkPoke], normals: Sequence[FloatArray | None]) -> FrameDiagnosis | None:
    """Tell a wrong sensor frame from a right one; None from fewer than `FEWEST` pokes.

    Parameters
    ----------
    pokes : at landmarks that do not all lie on one line; of any arm poses
    normals : (3,) float, outward, at each of them; None where it is not known, and then no side is wrong
    """
    if len(pokes) < FEWEST:
        return None
    (told,) = _weighed([""], [FrameCorrection()], pokes, normals)
    found = sorted([*_discrete(pokes, normals), _elsewhere(pokes, normals)], key=lambda one: one.cost)
    others = [one for one in found if one.words]
    best = told if told.cost - RIGHT <= others[0].cost else others[0]
    rivals = [told.cost - RIGHT, *(one.cost for one in others)]
    second = sorted(rivals)[1]
    first = min(rivals)
    return FrameDiagnosis(
        words=_sentence(best, told),
        right=best is told,
        sure=second - first >= SURE,
        miss=told.miss,
        corrected_miss=best.miss,
        correction=best.correction,
    )


def _sentence(best: _Hypothesis, told: _Hypothesis) -> str:
    if best is told:
        return f"The sensor's frame is right: pokes pass their landmarks at {told.miss * 1e3:.0f} mm."
    return (
        f"The sensor's frame looks wrong: {best.words}. As told, pokes pass their landmarks at {told.miss * 1e3:.0f} mm; "
        f"so corrected, at {best.miss * 1e3:.0f} mm."
    )


def _discrete(pokes: Sequence[LandmarkPoke], normals: Sequence[FloatArray | None]) -> list[_Hypothesis]:
    """Weigh every order of the axes with signs, and every unit."""
    words: list[str] = []
    corrections: list[FrameCorrection] = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        axes = np.array(signs)[:, None] * np.eye(3)[list(order)]
        for factor, unit in MOMENT_UNITS.items():
            words.append("; ".join(part for part in (_axes_words(order, signs), unit) if part))
            corrections.append(FrameCorrection(axes, *((GRAVITY, 1.0) if factor == 1.0 / GRAVITY else (1.0, factor))))
    return _weighed(words, corrections, pokes, normals)


def _axes_words(order: tuple[int, ...], signs: tuple[float, ...]) -> str:
    """Return what an order of the axes is, in words; empty for the one told."""
    if order == (0, 1, 2) and min(signs) > 0:
        return ""
    if order == (0, 1, 2) and max(signs) < 0:
        return "it reports the reaction: all signs are turned"
    named = [f"{'-' if sign < 0 else ''}{'xyz'[axis]}" for axis, sign in zip(order, signs, strict=True)]
    if order == (0, 1, 2):
        turned = ", ".join("xyz"[axis] for axis, sign in enumerate(signs) if sign < 0)
        return f"the sign of {turned} is turned"
    return f"its axes are told in another order: x, y, z are {', '.join(named)}"


def _weighed(
    words: Sequence[str],
    corrections: Sequence[FrameCorrection],
    pokes: Sequence[LandmarkPoke],
    normals: Sequence[FloatArray | None],
) -> list[_Hypothesis]:
    """Weigh corrections of the wrench."""
    axes = np.array([one.axes for one in corrections])
    force = np.einsum("hij,nj->hni", axes, np.array([poke.force for poke in pokes]))
    moment = np.einsum("hij,nj->hni", axes, np.array([poke.moment for poke in pokes]))
    force *= np.array([one.force_scale for one in corrections])[:, None, None]
    moment *= np.array([one.moment_scale for one in corrections])[:, None, None]
    told = np.tile(np.array([poke.link_from_sensor for poke in pokes]), (len(corrections), 1, 1))
    places = np.tile(np.array([poke.place for poke in pokes]), (len(corrections), 1))
    off, _, pushes = _passing(force.reshape(-1, 3), moment.reshape(-1, 3), told, places)
    squares = np.sum(off.reshape(len(corrections), -1) ** 2, axis=1)
    forces = pushes.reshape(force.shape)
    return [
        _Hypothesis(said, one, float(square) / TOLERANCE**2 + _cost_of_force(own, normals), float(np.sqrt(square / len(pokes))))
        for said, one, square, own in zip(words, corrections, squares, forces, strict=True)
    ]


def _cost_of_force(forces: FloatArray, normals: Sequence[FloatArray | None]) -> float:
    """Return what pushes from inside the part and of a size that no hand makes cost."""
    cost = sum(INSIDE for force, normal in zip(forces, normals, strict=True) if normal is not None and force @ normal > 0)
    sizes = np.linalg.norm(forces, axis=1)
    return cost + INSIDE * float(np.sum((sizes < FORCE_SIZE[0]) | (sizes > FORCE_SIZE[1])))


def _passing(
    force: FloatArray, moment: FloatArray, told: FloatArray, places: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return how far the axes pass places across the push.

    Parameters
    ----------
    force, moment : (n, 3) float, sensor frame
    told : (n, 4, 4) float, link_from_sensor
    places : (n, 3) float, metres

    Returns
    -------
    off : (n, 3) float, metres, link frame
    lever : (n, 3) float, metres: from the sensor's origin to the place
    force : (n, 3) float, N, link frame
    """
    force, moment = move_wrench(told, force, moment)
    square = np.sum(force * force, axis=1, keepdims=True)
    along = np.sum(places * force, axis=1, keepdims=True) / square
    return np.cross(force, moment) / square - (places - along * force), places - told[:, :3, 3], force


def _residuals(correction: FrameCorrection, pokes: Sequence[LandmarkPoke]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the rows of a correction.

    Returns
    -------
    residuals : (n, 2) float, metres: how far the axes pass the landmarks, across the push
    slopes : (n, 2, 6) float: their change with a wrong mounting, its turn and shift in the sensor's axes
    force : (n, 3) float, N, link frame
    """
    corrected = [correction.corrected(poke) for poke in pokes]
    told = np.array([pose for _, _, pose in corrected])
    wrenches = (np.array([one for one, _, _ in corrected]), np.array([one for _, one, _ in corrected]))
    off, lever, force = _passing(*wrenches, told, np.array([poke.place for poke in pokes]))
    pairs, turn = across(force / np.linalg.norm(force, axis=1)[:, None]), told[:, :3, :3]
    slopes = np.concatenate([-pairs @ cross_matrix(lever) @ turn, pairs @ turn], axis=2)
    return np.sum(pairs * off[:, None], axis=2), slopes, force


def _elsewhere(pokes: Sequence[LandmarkPoke], normals: Sequence[FloatArray | None]) -> _Hypothesis:
    """Weigh a sensor that sits elsewhere on the arm than told."""
    scales = np.repeat([TURN, SHIFT], 3)
    correction, step, cost = FrameCorrection(), np.zeros(6), 0.0
    for turn in range(3):
        residuals, slopes, _ = _residuals(correction, pokes)
        rows = (slopes * scales).reshape(-1, 6) / TOLERANCE
        # From nought of the prior: the rows as they are here, seen from there.
        sides = residuals.ravel() / TOLERANCE - rows @ step
        if turn == 0:
            total = np.eye(len(sides)) + rows @ rows.T
            cost = float(sides @ np.linalg.solve(total, sides)) + float(np.linalg.slogdet(total)[1])
        step = -np.linalg.lstsq(np.concatenate([rows, np.eye(6)]), np.concatenate([sides, np.zeros(6)]), rcond=None)[0]
        motion = np.eye(4)
        unknowns: FloatArray = np.asarray(scales * step, dtype=np.float64)
        motion[:3, :3], motion[:3, 3] = rotations(unknowns[None, :3])[0], unknowns[3:]
        correction = FrameCorrection(motion=motion)
    residuals, _, force = _residuals(correction, pokes)
    angle, shift = np.degrees(np.linalg.norm((scales * step)[:3])), 1e3 * float(np.linalg.norm((scales * step)[3:]))
    words = (
        f"the sensor sits elsewhere on the arm than told, by about {angle:.0f} degrees and {shift:.0f} mm, or its matrix is "
        "far off"
    )
    cost += _cost_of_force(force, normals)
    return _Hypothesis(words, correction, cost, float(np.sqrt(np.sum(residuals**2) / len(pokes))))
