"""A taxel's position as part of its module, a rigid body: one pose a module from the pokes of all its taxels.

Six unknowns a module; three where there is a surface, onto which the module is bent (`skincal.modules.pose`). What a poke
says is the place of the middle of the pads that answered, and the poses are found by least squares
(`skincal.modules.pose_fit`).

A search begins at the pose that fits the module's own estimates by the surface method, or else the free one, each weighed by
how well it is known; where these do not determine the turn, at the plan's. So the answer depends on the contacts alone.

**Left out in turn** (`predicted_squares`): how far a poke lies from where its module's other pokes predict it, each poke left
out without a new search. At the minimum the rows' gradients cancel, sum t A'r = 0 with A and r the slopes and misses of a poke
in standard deviations of its own noise and t its trust. Without poke i the information is N_i = sum t A'A - t_i A_i'A_i, and
the minimum moves so that

    r_i becomes r_i + t_i A_i N_i^-1 A_i' r_i,   with the covariance I + A_i N_i^-1 A_i',

exactly where the middle is linear in the module's unknowns, as it nearly is over a millimetre. How far the contact lies
beside the middle of its pads is in the noise. The others' trust is what it is with the poke.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, IntArray, dots
from skincal.model.scene import NoiseSettings
from skincal.modules.off_surface import off_surface_variances
from skincal.modules.pose import ModuleModel, ModulePoses, ModulesOnSurface
from skincal.modules.pose_fit import NO_RANK, Fitted, ModuleRows, Touches, fit_modules_from_pokes, whitened_rows
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import MISS_MAX, SD_MAX, Cause, Estimate, Method, State, StateReason
from skincal.taxels.shared_errors import NormalEquations, SharedRows, add_covariances, variance_factors

MOVING_MAX = 2e-4
"""m: a pose whose search still takes longer steps after its last is not known. Over an edge of a mesh it goes to and fro by
micrometres; without a surface, from few pokes, by up to centimetres."""
UNDETERMINED = 1e-6
"""Share of a direction that pokes do not determine above which a pad's place moves with it; below it is rounding."""
OTHERS = 2
"""Other pokes of its module that a poke needs: one predicts nothing of how a module is turned."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedModule:
    """A module as its m pokes put it, with d unknowns, and n errors that all pokes share: `skincal.modules.distances`."""

    pose: ModulePoses
    """One."""
    covariance: FloatArray
    """(d, d) float, m^2, of its unknowns, without what all pokes share."""
    moves: FloatArray
    """(d, n) float, metres: how the shared errors move them."""
    height: float
    """m^2, variance of how far it lies off its surface."""
    factor: float
    """Of `variance_factors`."""
    slopes: FloatArray
    """(m, 2, d) float, 1/m: as in `ModuleRows`, as are the misses."""
    misses: FloatArray
    """(m, 2) float, in standard deviations."""
    trust: FloatArray
    """(m,) float, 0 to 1."""
    shared: FloatArray
    """(m, 2, n) float: how the shared errors change the misses, in standard deviations."""


def estimate_modules(
    table: ContactTable,
    model: ModuleModel,
    modules: Collection[int],
    noise: NoiseSettings,
    others: Sequence[Mapping[int, Estimate]],
    dead: Mapping[int, str],
    doubting: bool = True,
    shared: SharedRows | None = None,
    kept: MutableMapping[int, FittedModule] | None = None,
) -> dict[int, Estimate]:
    """Estimate all taxels of `modules`, each from its own pokes.

    Parameters
    ----------
    modules : indices of the layout's modules
    others : estimates of the taxels of these modules by other methods, the best method first
    dead : channels that are not used, with the reason
    doubting : whether pokes far off what a module's others say count less for it
    shared : errors that all pokes share, to be carried into the covariances
    kept : takes the modules that are placed, by index, and loses those that are not

    Returns
    -------
    Of each channel of the modules, one estimate; its numbers depend on the pokes of the module's own taxels alone.
    """
    channels = model.channels_of(sorted(modules))
    evidence = table.evidence([channel for channel in channels if channel not in dead])
    counts = dict(zip(evidence.channels.tolist(), evidence.counts.tolist(), strict=True))
    found = {channel: _without(channel, counts.get(channel, 0), dead) for channel in channels}
    fit = fit_modules_from_pokes(evidence, table.totals(evidence.pokes), model, noise, others, doubting)
    if kept is not None:
        for module in modules:
            kept.pop(module, None)
    if fit is not None:
        estimates = list(_estimates(*fit, counts, dead))
        found.update((estimate.channel, estimate) for estimate in _carried(*fit, model, noise, estimates, shared, kept))
    return found


def _without(channel: int, contacts: int, dead: Mapping[int, str]) -> Estimate:
    """Return the estimate of a taxel whose module has no pose."""
    if channel in dead:
        return Estimate(channel, Method.MODULES, State.DEAD, 0, reason=StateReason(Cause.GIVEN, text=dead[channel]))
    if contacts:
        return Estimate(channel, Method.MODULES, State.BLIND, contacts, reason=StateReason(Cause.MODULE_UNPLACED))
    return Estimate(channel, Method.MODULES, State.UNSEEN, 0, reason=StateReason(Cause.MODULE_UNPOKED))


def _estimates(touches: Touches, fitted: Fitted, counts: Mapping[int, int], dead: Mapping[int, str]) -> Iterator[Estimate]:
    """Yield the estimates of the taxels of the modules that have a pose."""
    gradients = fitted.pads.gradients
    covariances = gradients @ fitted.covariances[fitted.of] @ gradients.transpose(0, 2, 1)
    values, axes = np.linalg.eigh(covariances)
    sds, rms = np.sqrt(values[:, 2]), np.sqrt(np.trace(covariances, axis1=1, axis2=2))
    troubles = [_trouble(touches, fitted, module) for module in range(len(touches.modules))]
    doubted, none = _doubted(touches, fitted), dict[int, float]()
    pads: list[tuple[int, int]] = list(zip(touches.channels.tolist(), fitted.of.tolist(), strict=True))
    for pad, (channel, module) in enumerate(pads):
        contacts = counts.get(channel, 0)
        if channel in dead:
            continue
        dark = fitted.blind[module] @ gradients[pad].T
        unknown = bool((np.sum(dark * dark, axis=1) > UNDETERMINED**2).any())
        known = sds[pad] <= SD_MAX and not unknown
        reason = troubles[module] or (None if known else _why_blind(touches, module, float(sds[pad]), unknown))
        if reason is not None:
            yield Estimate(
                channel, Method.MODULES, State.BLIND, contacts, normal=fitted.pads.normals[pad],
                worst_direction=_worst(dark) if unknown else axes[pad, :, 2], sd=None if unknown else float(sds[pad]),
                reason=reason, doubted=doubted[module].get(channel, none),
            )  # fmt: skip
        else:
            triangle = int(fitted.pads.triangles[pad])
            yield Estimate(
                channel, Method.MODULES, State.ESTIMATED, contacts, position=fitted.pads.points[pad],
                normal=fitted.pads.normals[pad], covariance=covariances[pad], worst_direction=axes[pad, :, 2],
                sd=float(sds[pad]), rms=float(rms[pad]), triangle=None if triangle < 0 else triangle,
                reason=None if contacts else StateReason(Cause.BY_MODULE), doubted=doubted[module].get(channel, none),
            )  # fmt: skip


def _worst(dark: FloatArray) -> FloatArray:
    """Return the unit direction in which a pad moves most by what is not determined."""
    return np.linalg.svd(dark)[2][0]


def _trouble(touches: Touches, fitted: Fitted, module: int) -> StateReason | None:
    """Return why a module has no pose at all; None if it has one."""
    if fitted.misses[module] > MISS_MAX:
        return StateReason(Cause.MODULE_OFF, size=float(fitted.misses[module]))
    if fitted.moving[module] > MOVING_MAX:
        return StateReason(Cause.MODULE_MOVING, size=float(fitted.moving[module]))
    own = touches.of == module
    push = np.sum(fitted.trust[own, None] * touches.evidence.directions[touches.rows[own]], axis=0)
    return StateReason(Cause.MODULE_BEHIND) if push @ fitted.poses.normals[module] >= 0 else None


def _why_blind(touches: Touches, module: int, sd: float, unknown: bool) -> StateReason:
    count = int(np.sum(touches.of == module))
    if count == 1:
        return StateReason(Cause.MODULE_ONE_POKE)
    return StateReason(Cause.MODULE_LOOSE, count, size=None if unknown else sd)


def _doubted(touches: Touches, fitted: Fitted) -> list[dict[int, dict[int, float]]]:
    """Return for each module, of each channel, the pokes whose trust is below 1: number to trust."""
    doubted: list[dict[int, dict[int, float]]] = [{} for _ in touches.modules]
    evidence = touches.evidence
    for at in np.flatnonzero(fitted.trust < 1.0).tolist():
        poke = int(evidence.pokes[touches.rows[at]])
        for channel in touches.channels_of(at).tolist():
            doubted[int(touches.of[at])].setdefault(channel, {})[poke] = float(fitted.trust[at])
    return doubted


def _carried(
    touches: Touches,
    fitted: Fitted,
    model: ModuleModel,
    noise: NoiseSettings,
    estimates: Sequence[Estimate],
    shared: SharedRows | None,
    kept: MutableMapping[int, FittedModule] | None,
) -> list[Estimate]:
    """Return the estimates with what shared errors add: `shared_errors`, with the unknowns of a module for those of a place.

    `kept` is as for `estimate_modules`.
    """
    order = np.lexsort((touches.evidence.pokes[touches.rows], touches.of))
    rows, trust = whitened_rows(touches, fitted.pads, noise), fitted.trust[order]
    ordered, places = _pulls(touches, fitted, rows, order, shared is not None)
    squares, gradients = np.sum(rows.misses[order] ** 2, axis=1), fitted.pads.gradients
    factors = variance_factors(squares, trust, ordered.starts, gradients.shape[2])
    added = ordered.covariances(noise.skin)
    errors = None if shared is None else shared(ordered.pokes, places, ordered.pairs)
    moves: FloatArray | None = None
    if errors is not None:
        moves, of_poses = ordered.moves(*errors)
        added = added + of_poses
    pad_of = {channel: pad for pad, channel in enumerate(touches.channels.tolist())}
    known = [estimate for estimate in estimates if estimate.position is not None]
    pads = np.array([pad_of[estimate.channel] for estimate in known], dtype=np.int64)
    of, gradient = fitted.of[pads], gradients[pads]
    more = gradient @ added[of] @ gradient.transpose(0, 2, 1)
    heights = np.zeros(len(factors))
    if isinstance(model.ground, ModulesOnSurface):  # a bent module may lie off the mesh
        heights = off_surface_variances(ordered, rows, order, trust, factors, noise.skin, errors)
        outward = fitted.pads.normals[pads]
        more = more + heights[of, None, None] * outward[:, :, None] * outward[:, None]
    if kept is not None:
        of_shared = None if errors is None else rows.whiten[order] @ errors[0]
        own = factors[:, None, None] * fitted.covariances + added, moves, heights, factors
        kept.update(_fitted_modules(touches, fitted, rows, order, own, of_shared))
    found = add_covariances(known, factors[of], more, None if moves is None else gradient @ moves[of]) if known else []
    return [*found, *(estimate for estimate in estimates if estimate.position is None)]


def _pulls(
    touches: Touches, fitted: Fitted, rows: ModuleRows, order: IntArray, corrected: bool
) -> tuple[NormalEquations, FloatArray]:
    """Return how the pokes, in this order, hold their modules, and the places (m, 3), metres, that they touched."""
    evidence, at, trust = touches.evidence, touches.rows[order], fitted.trust[order]
    pairs, places, slopes = evidence.pairs[at], touches.contact_centres(fitted.pads)[0][order], rows.slopes[order]
    weighted = trust[:, None, None] * slopes.transpose(0, 2, 1)
    begins, pulls = np.searchsorted(touches.of, np.arange(len(touches.modules))), weighted @ rows.whiten[order]
    held = np.add.reduceat(weighted @ slopes, begins)
    misses = trust[:, None] * dots(pairs, (evidence.nearest[at] - places)[:, None])
    of_pokes = evidence.pokes[at], evidence.poses[at], pairs, misses, pulls
    return NormalEquations(begins, *of_pokes, held, rows.normals[order], corrected), places


def _fitted_modules(
    touches: Touches,
    fitted: Fitted,
    rows: ModuleRows,
    order: IntArray,
    found: tuple[FloatArray, FloatArray | None, FloatArray, FloatArray],
    of_shared: FloatArray | None,
) -> Iterator[tuple[int, FittedModule]]:
    """Yield the modules that have a pose, by their index.

    Parameters
    ----------
    order : of the pokes, by module
    found : covariances, moves, heights and factors of all modules
    of_shared : `FittedModule.shared` of the pokes in that order
    """
    covariances, moves, heights, factors = found
    for b, module in enumerate(touches.modules.tolist()):
        if _trouble(touches, fitted, b) is not None or fitted.blind[b].any():
            continue
        here = touches.of[order] == b
        own = order[here]
        yield (
            module,
            FittedModule(
                pose=fitted.poses.take(np.array([b])),
                covariance=covariances[b],
                moves=np.zeros((len(covariances[b]), 0)) if moves is None else moves[b],
                height=float(heights[b]),
                factor=float(factors[b]),
                slopes=rows.slopes[own],
                misses=rows.misses[own],
                trust=fitted.trust[own],
                shared=np.zeros((len(own), 2, 0)) if of_shared is None else of_shared[here],
            ),
        )


def predicted_misses(touches: Touches, fitted: Fitted, noise: NoiseSettings, at: IntArray) -> tuple[FloatArray, ...]:
    """Predict pokes from the other pokes of their module.

    Parameters
    ----------
    touches, fitted : all pokes, and the modules as these put them
    at : (n,) indices of the touches

    Returns
    -------
    misses : (n, 2) float, metres, along the pairs of the pokes; NaN where the others predict nothing: too few, or worse than
        `SD_MAX`
    covariances : (n, 2, 2) float, m^2, of the misses: the module's and the poke's own
    own : (n, 2, 2) float, m^2, of the poke's own noise
    """
    if not len(at):
        return np.empty((0, 2)), np.empty((0, 2, 2)), np.empty((0, 2, 2))
    rows, gradients = whitened_rows(touches, fitted.pads, noise), touches.contact_centres(fitted.pads)[1][at]
    slopes, misses, trust = rows.slopes[at], rows.misses[at], fitted.trust[at, None, None]
    every = fitted.trust[:, None, None] * (rows.slopes.transpose(0, 2, 1) @ rows.slopes)
    whole = np.add.reduceat(every, np.searchsorted(touches.of, np.arange(len(touches.modules))), axis=0)
    others = whole[touches.of[at]] - trust * (slopes.transpose(0, 2, 1) @ slopes)
    values, axes = np.linalg.eigh(others)
    # A direction that the others do not determine is nothing but rounding, of either sign.
    known = (values[:, 0] > NO_RANK * values[:, -1]) & (np.bincount(touches.of)[touches.of[at]] > OTHERS)
    values = np.where(known[:, None], values, 1.0)
    roots = axes / np.sqrt(values)[:, None]
    spread = gradients @ roots
    sds = np.sqrt(np.linalg.eigvalsh(spread @ spread.transpose(0, 2, 1))[:, -1])
    seen = slopes @ roots
    leverage = seen @ seen.transpose(0, 2, 1)
    off = misses[:, :, None] + trust * (leverage @ misses[:, :, None])
    scale = np.asarray(np.linalg.inv(rows.whiten[at]), dtype=np.float64)
    there = (known & (sds <= SD_MAX))[:, None]
    to_metres = scale.transpose(0, 2, 1)
    return (
        np.where(there, (scale @ off)[:, :, 0], np.nan),
        scale @ (np.eye(2) + leverage) @ to_metres,
        scale @ to_metres,
    )


def predicted_squares(touches: Touches, fitted: Fitted, noise: NoiseSettings, at: IntArray) -> FloatArray:
    """Compute (n,) squared misses of `predicted_misses` in standard deviations: chi-squared of two degrees of freedom."""
    misses, covariances, _ = predicted_misses(touches, fitted, noise, at)
    return np.asarray(np.sum(misses * np.linalg.solve(covariances, misses[:, :, None])[:, :, 0], axis=1))
