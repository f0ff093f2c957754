"""Where the search for a board's pose begins: at the pose that fits the estimates of its taxels, by other methods.

With q_j the estimates, b_j the pads in the board's plane and w_j = 1/(rms_j^2 + FLOOR^2), the turn that makes
sum w |q - R b - t|^2 least in the plane across the mean normal is that of the complex number sum w conj(b - mean b)(q - mean
q). Where its own uncertainty, 1/sqrt(sum w |b - mean b|^2), is too large, the plan's turn is taken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from skincal.estimate.boards import Boards, OnSurface, Poses
from skincal.estimate.evidence import across
from skincal.estimate.result import Estimate
from skincal.readings import FloatArray

FLOOR = 0.002
"""m: no estimate is taken for better known than this, so that one does not outvote the rest."""
TURN_SD_MAX = 0.35
"""rad: estimates that tell the turn worse are left aside for the plan's; a search finds its way back from 60 degrees."""
FAR = 0.004
"""m: estimates farther than this from where the others put them count less."""
ROUNDS = 3


def start_of(boards: Boards, module: int, others: Sequence[Mapping[int, Estimate]]) -> Poses | None:
    """Return where the search for a module's pose begins, one pose; None where neither estimates nor plan tell.

    Parameters
    ----------
    others : estimates by channel, the best method first
    """
    plan = boards.plan(module)
    for estimates in others:
        begun = _from_estimates(boards, module, estimates, plan)
        if begun is not None:
            return begun
    return plan


def _from_estimates(boards: Boards, module: int, estimates: Mapping[int, Estimate], plan: Poses | None) -> Poses | None:
    channels = boards.layout.modules[module].channels.tolist()
    known = [(pad, estimates[channel]) for pad, channel in enumerate(channels) if channel in estimates]
    known = [(pad, one) for pad, one in known if one.position is not None and one.normal is not None and one.rms is not None]
    if not known:
        return None
    pads = boards.pads[module][[pad for pad, _ in known]]
    places = np.array([one.position for _, one in known])
    weights = np.array([1.0 / ((one.rms or 0.0) ** 2 + FLOOR**2) for _, one in known])
    normal = np.sum(weights[:, None] * np.array([one.normal for _, one in known]), axis=0)
    if plan is not None and (not np.any(normal) or not isinstance(boards.ground, OnSurface)):
        # Against the pushes is worse known than the plan where there is no surface.
        normal = plan.normals[0]
    length = float(np.sqrt(normal @ normal))
    return None if length == 0 else _fitting(boards, pads, places, weights, normal / length, plan)


def _fitting(
    boards: Boards, pads: FloatArray, places: FloatArray, weights: FloatArray, normal: FloatArray, plan: Poses | None
) -> Poses | None:
    """Return the pose that fits places (n, 3) of pads (n, 2), seen along `normal`."""
    x, y = _axes(normal, plan)
    flat, board = places @ (x + 1j * y), pads @ np.array([1.0, 1j])
    own, turn, shift = weights, 1.0 + 0.0j, 0.0j
    for _ in range(ROUNDS):
        middle, centre = own @ board / own.sum(), own @ flat / own.sum()
        product = np.sum(own * np.conj(board - middle) * (flat - centre))
        told = np.sum(own * np.abs(board - middle) ** 2) * TURN_SD_MAX**2 > 1.0 and abs(product) > 0
        if not told and plan is None:
            return None
        turn = product / abs(product) if told else 1.0 + 0.0j
        shift = centre - turn * middle
        own = weights / (1.0 + np.abs(flat - turn * board - shift) ** 2 / FAR**2)
    height = float(own @ (places @ normal) / own.sum())
    origin = shift.real * x + shift.imag * y + height * normal
    return _on_ground(boards, origin, turn.real * x + turn.imag * y, normal)


def _axes(normal: FloatArray, plan: Poses | None) -> tuple[FloatArray, FloatArray]:
    """Return two directions across `normal`, the plan's x as far as it is across."""
    x = across(normal[None])[0, 0] if plan is None else plan.x[0] - (plan.x[0] @ normal) * normal
    length = float(np.sqrt(x @ x))
    x = x / length if length > 0.1 else across(normal[None])[0, 0]
    return x, np.asarray(np.cross(normal, x), dtype=np.float64)


def _on_ground(boards: Boards, origin: FloatArray, x: FloatArray, normal: FloatArray) -> Poses | None:
    if not isinstance(boards.ground, OnSurface):
        return Poses(origin[None], x[None], normal[None], np.full(1, -1, dtype=np.int64))
    from skincal.surface.nearest import nearest_points

    point, triangle = nearest_points(boards.ground.surface, origin[None])
    facing = boards.ground.surface.normals[triangle]
    x = x - (x @ facing[0]) * facing[0]
    length = float(np.sqrt(x @ x))
    if facing[0] @ normal <= 0 or length < 0.1:
        return None
    return Poses(point, (x / length)[None], facing, triangle)
