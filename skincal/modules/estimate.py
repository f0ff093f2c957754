"""Estimates of taxels as parts of their modules: one pose a rigid module from the pokes of all its taxels.

A module has six unknowns, or three on a surface, onto which it is bent (`skincal.modules.pose`). A poke gives the centre of the
pads that answered, and the poses are found by least squares (`skincal.modules.pose_fit`).

A search begins at the pose that fits the module's own estimates by the surface method, or else the free one, each weighted by
its precision; if these do not determine the turn, at the plan's. So the answer depends on the contacts alone.

**Leave-one-out prediction** (`predict_pokes`): how far each poke lies from the prediction of the other pokes of its module,
in closed form. At the minimum the gradients cancel, sum t A'r = 0 with A and r the slopes and misses of a poke in standard
deviations and t its trust. Without poke i the information is N_i = sum t A'A - t_i A_i'A_i, and the minimum moves so that

    r_i becomes r_i + t_i A_i N_i^-1 A_i' r_i,   with the covariance I + A_i N_i^-1 A_i',

exactly if the centre is linear in the module's unknowns, as it nearly is over a millimetre. The offset of the contact from the
centre is part of the noise. The trust of the other pokes is not changed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.model.scene import NoiseSettings
from skincal.model.skin import SkinKind
from skincal.modules.contradictions import find_contradicted
from skincal.modules.off_surface import spread_over_modules
from skincal.modules.pose import ModuleModel, ModulePoses, ModulesOnSurface
from skincal.modules.pose_fit import MIN_SINGULAR_VALUE_RATIO, Fitted, Touches, fit_modules_from_pokes
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.exchanged import contradicted
from skincal.taxels.predictions import MIN_OTHER_POKES_TO_PREDICT, PokePredictions
from skincal.taxels.result import (
    FORCE_AXIS_MAX_MISS_M,
    POSITION_MAX_SD_M,
    Cause,
    Estimate,
    Method,
    State,
    StateReason,
    placed_state,
)
from skincal.taxels.shared_errors import SharedRows, add_covariances

POSE_SEARCH_CONVERGENCE_STEP_M = 2e-4
"""A pose whose last step is longer is not known. Over an edge of a mesh a search goes to and fro by micrometres; without a
surface, from few pokes, by up to centimetres."""
MIN_UNDETERMINED_MOTION_SHARE = 1e-6
"""Smallest part of an undetermined direction in a pad's motion; below it is rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedModule:
    """A module with d unknowns as its m pokes place it, and n errors that all pokes share: `skincal.modules.distances`."""

    pose: ModulePoses
    """One."""
    covariance: FloatArray
    """(d, d) float, m^2, symmetric, of its unknowns, without the errors that all pokes share."""
    moves: FloatArray
    """(d, n) float, metres: shifts of the unknowns by the shared errors."""
    height: float
    """m^2, variance of its height over the surface."""
    factor: float
    """Of `variance_factors`."""
    slopes: FloatArray
    """(m, 2, d) float, 1/m: as in `ModuleRows`, as are the misses."""
    misses: FloatArray
    """(m, 2) float, in standard deviations."""
    trust: FloatArray
    """(m,) float, 0 to 1."""
    shared: FloatArray
    """(m, 2, n) float: changes of the misses by the shared errors, in standard deviations."""


def estimate_modules(
    table: ContactTable,
    model: ModuleModel,
    modules: Collection[int],
    noise: NoiseSettings,
    others: Sequence[Mapping[int, Estimate]],
    dead: Mapping[int, str],
    doubting: bool = True,
    shared: SharedRows | None = None,
    fitted_modules: MutableMapping[int, FittedModule] | None = None,
) -> dict[int, Estimate]:
    """Estimate all taxels of `modules`, by channel; each module from the pokes of its own taxels alone.

    Parameters
    ----------
    modules : indices in the layout
    others : estimates of these taxels by other methods, the best method first
    dead : channels that are not used, with the reason
    doubting : whether outliers of a module count less
    shared : errors that all pokes share, added to the covariances
    fitted_modules : receives the modules that have a pose, by index, and loses the others
    """
    channels = model.channels_of(sorted(modules))
    if model.layout.kind is SkinKind.SHEET:
        # Imported only for sheets: boards do not need them.
        from skincal.modules.sheet_estimate import estimate_sheets

        contacts = table.evidence(channels)
        answered = dict(zip(contacts.channels.tolist(), contacts.counts.tolist(), strict=True))
        found = {channel: _without_pose(channel, answered.get(channel, 0), dead) for channel in channels}
        laid = estimate_sheets(table, model, channels, noise, others, dead, doubting, shared)
        return found | {estimate.channel: estimate for estimate in laid}
    evidence = table.evidence([channel for channel in channels if channel not in dead])
    counts = dict(zip(evidence.channels.tolist(), evidence.counts.tolist(), strict=True))
    placed: dict[int, Estimate] = {}
    fit = fit_modules_from_pokes(evidence, table.totals(evidence.pokes), model, noise, others, doubting)
    if fitted_modules is not None:
        for module in modules:
            fitted_modules.pop(module, None)
    if fit is not None:
        estimates = list(_estimates(*fit, counts, dead, model.layout.spacing))
        every = _add_shared_errors(*fit, model, noise, estimates, shared, fitted_modules)
        placed = {estimate.channel: estimate for estimate in every}
    return {channel: placed.get(channel) or _without_pose(channel, counts.get(channel, 0), dead) for channel in channels}


def _without_pose(channel: int, contacts: int, dead: Mapping[int, str]) -> Estimate:
    """Make the estimate of a taxel whose module has no pose."""
    if channel in dead:
        return Estimate(channel, Method.MODULES, State.DEAD, 0, reason=StateReason(Cause.EXTERNAL_TEXT, text=dead[channel]))
    if contacts:
        return Estimate(channel, Method.MODULES, State.BLIND, contacts, reason=StateReason(Cause.MODULE_UNPLACED))
    return Estimate(channel, Method.MODULES, State.UNSEEN, 0, reason=StateReason(Cause.MODULE_UNPOKED))


def _estimates(
    touches: Touches, fitted: Fitted, counts: Mapping[int, int], dead: Mapping[int, str], spacing: float
) -> Iterator[Estimate]:
    """Yield the estimates of the taxels of the modules that have a pose."""
    gradients = fitted.pads.gradients
    covariances = gradients @ fitted.covariances[fitted.of] @ gradients.transpose(0, 2, 1)
    values, axes = np.linalg.eigh(covariances)
    sds, rms = np.sqrt(values[:, 2]), np.sqrt(np.trace(covariances, axis1=1, axis2=2))
    troubles = [_trouble(touches, fitted, module) for module in range(len(touches.modules))]
    doubted, none = _doubted(touches, fitted), dict[int, float]()
    denied = find_contradicted(touches, fitted.of, fitted.pads.points, fitted.trust, spacing)
    is_loose: list[bool] = np.any(fitted.blind, axis=(1, 2)).tolist()
    pads: list[tuple[int, int]] = list(zip(touches.channels.tolist(), fitted.of.tolist(), strict=True))
    for pad, (channel, module) in enumerate(pads):
        contacts = counts.get(channel, 0)
        if channel in dead:
            continue
        dark = fitted.blind[module] @ gradients[pad].T if is_loose[module] else None
        unknown = dark is not None and bool((np.sum(dark * dark, axis=1) > MIN_UNDETERMINED_MOTION_SHARE**2).any())
        known = sds[pad] <= POSITION_MAX_SD_M and not unknown
        reason = troubles[module] or (None if known else _why_blind(touches, module, float(sds[pad]), unknown))
        if reason is not None:
            yield Estimate(
                channel, Method.MODULES, State.BLIND, contacts, normal=fitted.pads.normals[pad],
                worst_direction=axes[pad, :, 2] if dark is None or not unknown else np.linalg.svd(dark)[2][0],
                sd=None if unknown else float(sds[pad]), reason=reason, doubted=doubted[module].get(channel, none),
            )  # fmt: skip
        else:
            triangle, of_poke = int(fitted.pads.triangles[pad]), doubted[module].get(channel, none)
            state = placed_state(contacts, of_poke)
            estimate = Estimate(
                channel, Method.MODULES, state, contacts, position=fitted.pads.points[pad],
                normal=fitted.pads.normals[pad], covariance=covariances[pad], worst_direction=axes[pad, :, 2],
                sd=float(sds[pad]), rms=float(rms[pad]), triangle=None if triangle < 0 else triangle,
                reason=None if state is State.TOUCHED else StateReason(Cause.BY_MODULE), doubted=of_poke,
            )  # fmt: skip
            yield contradicted(estimate, denied[channel]) if channel in denied else estimate


def _trouble(touches: Touches, fitted: Fitted, module: int) -> StateReason | None:
    """Find the reason why a module has no pose; `None` if it has one."""
    if fitted.misses[module] > FORCE_AXIS_MAX_MISS_M:
        return StateReason(Cause.MODULE_OFF, size=float(fitted.misses[module]))
    if fitted.moving[module] > POSE_SEARCH_CONVERGENCE_STEP_M:
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
    """List for each module, by channel, the pokes whose trust is below 1: number to trust."""
    doubted: list[dict[int, dict[int, float]]] = [{} for _ in touches.modules]
    for at in np.flatnonzero(fitted.trust < 1.0).tolist():
        poke = int(touches.evidence.pokes[touches.rows[at]])
        for channel in touches.channels_of(at).tolist():
            doubted[int(touches.of[at])].setdefault(channel, {})[poke] = float(fitted.trust[at])
    return doubted


def _add_shared_errors(
    touches: Touches,
    fitted: Fitted,
    model: ModuleModel,
    noise: NoiseSettings,
    estimates: Sequence[Estimate],
    shared: SharedRows | None,
    fitted_modules: MutableMapping[int, FittedModule] | None,
) -> list[Estimate]:
    """Add shared errors to the covariances as `shared_errors` does, with the unknowns of modules for those of taxels."""
    at, evidence, errors = touches.rows, touches.evidence, None
    if shared is not None:
        errors = shared(evidence.pokes[at], touches.contact_centres(fitted.pads)[0], evidence.pairs[at])
    spread = spread_over_modules(touches, fitted.rows, fitted.trust, noise, errors)
    pad_of = {channel: pad for pad, channel in enumerate(touches.channels.tolist())}
    known = [estimate for estimate in estimates if estimate.position is not None]
    pads = np.array([pad_of[estimate.channel] for estimate in known], dtype=np.int64)
    of, gradient = fitted.of[pads], fitted.pads.gradients[pads]
    more = gradient @ spread.added[of] @ gradient.transpose(0, 2, 1)
    if isinstance(model.ground, ModulesOnSurface):
        outward = fitted.pads.normals[pads]
        more = more + spread.heights[of, None, None] * outward[:, :, None] * outward[:, None]
    if fitted_modules is not None:
        own = spread.factors[:, None, None] * fitted.covariances + spread.added
        of_shared = np.zeros((len(at), 2, 0)) if errors is None else fitted.rows.whiten @ errors[0]
        for b, module in enumerate(touches.modules.tolist()):
            if _trouble(touches, fitted, b) is not None or fitted.blind[b].any():
                continue
            here = touches.of == b
            fitted_modules[module] = FittedModule(
                pose=fitted.poses.select(np.array([b])),
                # `added` is N^-1 X N^-1: its two triangles differ by rounding.
                covariance=(own[b] + own[b].T) / 2.0,
                moves=spread.moves[b],
                height=float(spread.heights[b]),
                factor=float(spread.factors[b]),
                slopes=fitted.rows.slopes[here],
                misses=fitted.rows.misses[here],
                trust=fitted.trust[here],
                shared=of_shared[here],
            )
    moves = None if shared is None else gradient @ spread.moves[of]
    found = add_covariances(known, spread.factors[of], more, moves) if known else []
    return [*found, *(estimate for estimate in estimates if estimate.position is None)]


def predict_pokes(touches: Touches, fitted: Fitted, at: IntArray) -> PokePredictions:
    """Predict pokes from the other pokes of their module.

    Parameters
    ----------
    touches, fitted : all pokes, and the modules as they place them
    at : (n,) indices of the touches
    """
    if not len(at):
        return PokePredictions.none()
    centres, gradients = (each[at] for each in touches.contact_centres(fitted.pads)[:2])
    rows, answers = fitted.rows, touches.rows[at]
    slopes, misses, trust = rows.slopes[at], rows.misses[at], fitted.trust[at, None, None]
    every = fitted.trust[:, None, None] * (rows.slopes.transpose(0, 2, 1) @ rows.slopes)
    whole = np.add.reduceat(every, np.searchsorted(touches.of, np.arange(len(touches.modules))), axis=0)
    others = whole[touches.of[at]] - trust * (slopes.transpose(0, 2, 1) @ slopes)
    values, axes = np.linalg.eigh(others)
    # A direction that the others do not determine is rounding of either sign.
    known = (values[:, 0] > MIN_SINGULAR_VALUE_RATIO * values[:, -1]) & (
        np.bincount(touches.of)[touches.of[at]] > MIN_OTHER_POKES_TO_PREDICT
    )
    values = np.where(known[:, None], values, 1.0)
    roots = axes / np.sqrt(values)[:, None]
    spread = gradients @ roots
    sds = np.sqrt(np.linalg.eigvalsh(spread @ spread.transpose(0, 2, 1))[:, -1])
    seen = slopes @ roots
    leverage = seen @ seen.transpose(0, 2, 1)
    off = misses[:, :, None] + trust * (leverage @ misses[:, :, None])
    scale = np.asarray(np.linalg.inv(rows.whiten[at]), dtype=np.float64)
    there = (known & (sds <= POSITION_MAX_SD_M))[:, None]
    to_metres = scale.transpose(0, 2, 1)
    return PokePredictions(
        rows=answers,
        levers=centres - touches.evidence.sensors[answers],
        misses=np.where(there, (scale @ off)[:, :, 0], np.nan),
        covariances=scale @ (np.eye(2) + leverage) @ to_metres,
        own=scale @ to_metres,
    )
