"""A taxel's position as part of its module, a rigid board: one pose a module from the pokes of all its taxels.

Six unknowns a module; three where there is a surface, onto which the board is bent (`boards.py`). What a poke tells is the
place of the middle of the pads that answered (`touches.py`), and the poses are found by least squares (`board_fit.py`).

A search begins at the pose that fits the module's own estimates by the surface method, or else the free one, each weighed by
how well it is known; where these do not tell the turn, at the plan's. So the answer depends on the contacts alone.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from skincal.estimate.board_fit import Fitted, fit_boards
from skincal.estimate.board_start import start_of
from skincal.estimate.boards import Boards, joined
from skincal.estimate.ledger import Ledger
from skincal.estimate.result import MISS_MAX, SD_MAX, Estimate, Method, State
from skincal.estimate.touches import Touches, find_touches
from skincal.readings import FloatArray
from skincal.scene import NoiseSettings

MOVING_MAX = 2e-4
"""m: a pose whose search still takes longer steps after its last is not known. Over an edge of a mesh it goes to and fro by
micrometres; without a surface, from few pokes, by up to centimetres."""
UNTOLD = 1e-6
"""Share of a direction that pokes do not determine above which a pad's place moves with it; below it is rounding."""


def estimate_modules(
    ledger: Ledger,
    boards: Boards,
    modules: Collection[int],
    noise: NoiseSettings,
    others: Sequence[Mapping[int, Estimate]],
    dead: Mapping[int, str],
    doubting: bool = True,
) -> dict[int, Estimate]:
    """Estimate all taxels of `modules`.

    Parameters
    ----------
    modules : indices of the layout's modules
    others : estimates of the taxels of these modules by other methods, the best method first
    dead : channels that are not used, with the reason
    doubting : whether pokes far off what a module's others say count less for it

    Returns
    -------
    Of each channel of the modules, one estimate; its numbers depend on the pokes of the module's own taxels alone.
    """
    channels = boards.channels_of(sorted(modules))
    evidence = ledger.evidence([channel for channel in channels if channel not in dead])
    counts = dict(zip(evidence.channels.tolist(), evidence.counts.tolist(), strict=True))
    found = {channel: _without(channel, counts.get(channel, 0), dead) for channel in channels}
    begun = {module: start_of(boards, module, others) for module in boards.modules_of(counts)}
    ready = {module: start for module, start in begun.items() if start is not None}
    touches = find_touches(evidence, ledger.totals(evidence.pokes), boards, noise, ready)
    if len(touches.boards):
        fitted = fit_boards(touches, boards, joined([ready[module] for module in touches.boards.tolist()]), noise, doubting)
        found.update((one.channel, one) for one in _estimates(touches, fitted, counts, dead))
    return found


def _without(channel: int, contacts: int, dead: Mapping[int, str]) -> Estimate:
    """Return what is said of a taxel whose module has no pose."""
    if channel in dead:
        return Estimate(channel, Method.MODULES, State.DEAD, 0, reason=dead[channel])
    if contacts:
        reason = "Its module answered only beside others, or the plan does not say where it is: poke its own taxels."
        return Estimate(channel, Method.MODULES, State.BLIND, contacts, reason=reason)
    return Estimate(channel, Method.MODULES, State.UNSEEN, 0, reason="No accepted poke touched its module.")


def _estimates(touches: Touches, fitted: Fitted, counts: Mapping[int, int], dead: Mapping[int, str]) -> Iterator[Estimate]:
    """Yield the estimates of the taxels of the boards that have a pose."""
    gradients = fitted.pads.gradients
    covariances = gradients @ fitted.covariances[fitted.of] @ gradients.transpose(0, 2, 1)
    values, axes = np.linalg.eigh(covariances)
    sds, rms = np.sqrt(values[:, 2]), np.sqrt(np.trace(covariances, axis1=1, axis2=2))
    troubles = [_trouble(touches, fitted, board) for board in range(len(touches.boards))]
    doubted, none = _doubted(touches, fitted), dict[int, float]()
    channels: list[int] = touches.channels.tolist()
    of: list[int] = fitted.of.tolist()
    for pad, (channel, board) in enumerate(zip(channels, of, strict=True)):
        contacts = counts.get(channel, 0)
        if channel in dead:
            continue
        dark = fitted.blind[board] @ gradients[pad].T
        unknown = bool((np.sum(dark * dark, axis=1) > UNTOLD**2).any())
        reason = troubles[board] or ("" if sds[pad] <= SD_MAX and not unknown else _why_blind(touches, board, unknown))
        if reason:
            yield Estimate(
                channel, Method.MODULES, State.BLIND, contacts, normal=fitted.pads.normals[pad],
                weakest=_worst(dark) if unknown else axes[pad, :, 2], sd=None if unknown else float(sds[pad]),
                reason=reason, doubted=doubted[board].get(channel, none),
            )  # fmt: skip
        else:
            triangle = int(fitted.pads.triangles[pad])
            yield Estimate(
                channel, Method.MODULES, State.ESTIMATED, contacts, position=fitted.pads.points[pad],
                normal=fitted.pads.normals[pad], covariance=covariances[pad], weakest=axes[pad, :, 2], sd=float(sds[pad]),
                rms=float(rms[pad]), triangle=None if triangle < 0 else triangle,
                reason="" if contacts else "Not poked itself; known by its module.", doubted=doubted[board].get(channel, none),
            )  # fmt: skip


def _worst(dark: FloatArray) -> FloatArray:
    """Return the unit direction in which a pad moves most by what is not determined."""
    return np.linalg.svd(dark)[2][0]


def _trouble(touches: Touches, fitted: Fitted, board: int) -> str:
    """Return why a board has no pose at all; empty if it has one."""
    if fitted.misses[board] > MISS_MAX:
        return (
            f"The axes pass its module at {fitted.misses[board] * 1e3:.0f} mm (limit {MISS_MAX * 1e3:.0f} mm): check the "
            "mesh's unit and pose, the arm poses, and which channels the module has."
        )
    if fitted.moving[board] > MOVING_MAX:
        return (
            f"Where its module lies does not settle (to {fitted.moving[board] * 1e3:.1f} mm): poke taxels farther apart, with "
            "other tilts."
        )
    own = touches.of == board
    push = np.sum(fitted.trust[own, None] * touches.evidence.directions[touches.rows[own]], axis=0)
    if push @ fitted.poses.normals[board] >= 0:
        return "The pokes push its module from behind: check the wrench's sign and the surface's normals."
    return ""


def _why_blind(touches: Touches, board: int, unknown: bool) -> str:
    count = int(np.sum(touches.of == board))
    if count == 1:
        return "One poke on its module does not tell how that is turned. Poke another of its taxels."
    known = "do not tell" if unknown else f"tell it to worse than {SD_MAX * 1e3:.0f} mm"
    return f"The {count} pokes on its module {known} how that lies: poke taxels farther apart, with other tilts."


def _doubted(touches: Touches, fitted: Fitted) -> list[dict[int, dict[int, float]]]:
    """Return for each board, of each channel, the pokes whose trust is below 1: number to trust."""
    doubted: list[dict[int, dict[int, float]]] = [{} for _ in touches.boards]
    evidence = touches.evidence
    for at in np.flatnonzero(fitted.trust < 1.0).tolist():
        poke = int(evidence.pokes[touches.rows[at]])
        for channel in touches.channels_of(at).tolist():
            doubted[int(touches.of[at])].setdefault(channel, {})[poke] = float(fitted.trust[at])
    return doubted
