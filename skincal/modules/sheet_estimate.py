"""Estimates of the taxels of soft sheets, from the fits of `sheet_fit.py`, with the errors that all pokes share.

Errors that pokes share enter as for boards (`skincal.taxels.shared_errors`, `off_surface.py`), with the information of the
pokes and the prior of the sheet.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from skincal.geometry import FloatArray, IntArray, dots
from skincal.model.scene import NoiseSettings
from skincal.modules.contradictions import find_contradicted
from skincal.modules.off_surface import spread_over_modules
from skincal.modules.pose import ModuleModel
from skincal.modules.sheet_fit import SheetFit, fit_sheets
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
from skincal.taxels.shared_errors import SharedRows, add_covariances, variance_factors

SHEET_SEARCH_MAX_LAST_STEP_M = 2e-4
"""A sheet whose search still moves by more is not known."""


COMMON_AIM_SD_FACTOR = 0.4
"""sd of the mean offset of all pokes of a sheet from its taxels, in units of `NoiseSettings.contact`, each direction. Taxels
are poked at their believed positions, and those of a sheet are often too far apart for a neighbour to answer. So no number of
pokes shows this shift. In the study it is 0.6 mm for targets on the taxels, and 0.4 mm for targets all over their cells."""


def estimate_sheets(
    table: ContactTable,
    model: ModuleModel,
    channels: Sequence[int],
    noise: NoiseSettings,
    others: Sequence[Mapping[int, Estimate]],
    dead: Mapping[int, str],
    doubting: bool,
    shared: SharedRows | None,
) -> Iterator[Estimate]:
    """Yield the estimates of the taxels of all sheets that pokes touched; `channels` are those of whole sheets."""
    evidence = table.evidence([channel for channel in channels if channel not in dead])
    counts = dict(zip(evidence.channels.tolist(), evidence.counts.tolist(), strict=True))
    for fit in fit_sheets(evidence, table.totals(evidence.pokes), model, noise, others, doubting):
        estimates = [estimate for estimate in _estimates(fit, counts, model.layout.spacing) if estimate.channel not in dead]
        yield from _with_shared_errors(fit, estimates, len(model.layout.modules), noise, shared)


def _estimates(fit: SheetFit, counts: Mapping[int, int], spacing: float) -> Iterator[Estimate]:
    """Yield the estimates of the taxels of a sheet, without the errors that pokes share."""
    trouble = _trouble(fit)
    covariances = _of_pads(fit, fit.covariance)
    across = fit.pads.gradients[:, :, :2]
    covariances = covariances + fit.left_out[:, None, None] * (across @ across.transpose(0, 2, 1))
    values, axes = np.linalg.eigh(covariances)
    sds, rms = np.sqrt(values[:, 2]).tolist(), np.sqrt(np.trace(covariances, axis1=1, axis2=2)).tolist()
    doubted, none = _doubted(fit), dict[int, float]()
    of_sheet = np.zeros(len(fit.pads.points), dtype=np.int64)
    denied = find_contradicted(fit.touches, of_sheet, fit.pads.points, fit.trust, spacing)
    for pad, channel in enumerate(fit.touches.channels.tolist()):
        contacts, of_poke = counts.get(channel, 0), doubted.get(channel, none)
        reason = trouble
        if reason is None and sds[pad] > POSITION_MAX_SD_M:
            pokes = len(fit.trust)
            reason = StateReason(Cause.MODULE_ONE_POKE) if pokes == 1 else StateReason(Cause.MODULE_LOOSE, pokes, size=sds[pad])
        if reason is not None:
            yield Estimate(
                channel, Method.MODULES, State.BLIND, contacts, normal=fit.pads.normals[pad],
                worst_direction=axes[pad, :, 2], sd=sds[pad], reason=reason, doubted=of_poke,
            )  # fmt: skip
        else:
            state = placed_state(contacts, of_poke)
            estimate = Estimate(
                channel, Method.MODULES, state, contacts, position=fit.pads.points[pad],
                normal=fit.pads.normals[pad], covariance=covariances[pad], worst_direction=axes[pad, :, 2],
                sd=sds[pad], rms=rms[pad], triangle=int(fit.pads.triangles[pad]),
                reason=None if state is State.TOUCHED else StateReason(Cause.BY_MODULE), doubted=of_poke,
            )  # fmt: skip
            yield contradicted(estimate, denied[channel]) if channel in denied else estimate


def _of_pads(fit: SheetFit, covariance: FloatArray) -> FloatArray:
    """Compute (n, 3, 3) the covariances of the pads' positions by that of the unknowns, m^2."""
    gradients = fit.pads.gradients
    moved = (gradients.reshape(-1, len(covariance)) @ covariance).reshape(gradients.shape)
    return moved @ gradients.transpose(0, 2, 1)


def _trouble(fit: SheetFit) -> StateReason | None:
    """Find the reason why a sheet has no place; `None` if it has one."""
    if fit.miss > FORCE_AXIS_MAX_MISS_M:
        return StateReason(Cause.MODULE_OFF, size=fit.miss)
    if fit.moving > SHEET_SEARCH_MAX_LAST_STEP_M:
        return StateReason(Cause.MODULE_MOVING, size=fit.moving)
    pushes = fit.touches.evidence.directions[fit.touches.rows]
    # A sheet may go round the part: each push is compared with the skin where it lands.
    inward = float(fit.trust @ dots(pushes, fit.rows.normals))
    return StateReason(Cause.MODULE_BEHIND) if inward >= 0 else None


def _misfit(fit: SheetFit) -> float:
    """Ratio of the pokes' variance to that by the learned noise, at least 1: larger only for a wrong layout or wrong axes."""
    starts, slopes = np.zeros(1, dtype=np.int64), fit.rows.slopes
    seen = (slopes.reshape(-1, len(fit.covariance)) @ fit.covariance).reshape(slopes.shape)
    freedom = float(fit.trust @ np.sum(seen * slopes, axis=(1, 2)))
    return float(variance_factors(np.sum(fit.rows.misses**2, axis=1), fit.trust, starts, freedom)[0])


def _doubted(fit: SheetFit) -> dict[int, dict[int, float]]:
    """List by channel the pokes whose trust is below 1: number to trust."""
    doubted: dict[int, dict[int, float]] = {}
    for at in np.flatnonzero(fit.trust < 1.0).tolist():
        poke = int(fit.touches.evidence.pokes[fit.touches.rows[at]])
        for channel in fit.touches.channels_of(at).tolist():
            doubted.setdefault(channel, {})[poke] = float(fit.trust[at])
    return doubted


def _with_shared_errors(
    fit: SheetFit, estimates: Sequence[Estimate], sheets: int, noise: NoiseSettings, shared: SharedRows | None
) -> list[Estimate]:
    """Add the errors that all pokes share to the covariances."""
    known = [estimate for estimate in estimates if estimate.position is not None]
    if not known:
        return list(estimates)
    evidence, at, trust, rows = fit.touches.evidence, fit.touches.rows, fit.trust, fit.rows
    errors = None
    if shared is not None:
        errors = shared(evidence.pokes[at], fit.touches.contact_centres(fit.pads)[0], evidence.pairs[at])
    # The prior leaves no direction of the information undetermined.
    inverse = np.asarray(np.linalg.inv(fit.information), dtype=np.float64)[None]
    spread = spread_over_modules(fit.touches, rows, trust, noise, errors, inverse)
    # A shift of the whole sheet is the same in its first two unknowns, and an error of this sheet alone.
    moves = np.zeros((fit.information.shape[0], 2 * sheets))
    moves[:2, 2 * fit.module : 2 * fit.module + 2] = COMMON_AIM_SD_FACTOR * noise.contact * np.eye(2)
    moves = np.concatenate([moves, spread.moves[0]], axis=1)
    pad_of = {channel: pad for pad, channel in enumerate(fit.touches.channels.tolist())}
    pads = np.array([pad_of[estimate.channel] for estimate in known], dtype=np.int64)
    outward = fit.pads.normals[pads]
    more = _of_pads(fit, spread.added[0])[pads] + spread.heights[0] * outward[:, :, None] * outward[:, None]
    found = add_covariances(known, np.full(len(known), _misfit(fit)), more, fit.pads.gradients[pads] @ moves)
    return [*found, *(estimate for estimate in estimates if estimate.position is None)]


def predict_sheet_pokes(fits: Sequence[SheetFit]) -> PokePredictions:
    """Predict each poke on sheets from the other pokes of its sheet."""
    found: list[tuple[IntArray, FloatArray, FloatArray, FloatArray, FloatArray]] = []
    for fit in fits:
        if fit.miss > FORCE_AXIS_MAX_MISS_M or len(fit.trust) <= MIN_OTHER_POKES_TO_PREDICT:
            continue
        at = fit.touches.rows
        misses, covariances = fit.without_each()
        scale = np.asarray(np.linalg.inv(fit.rows.whiten), dtype=np.float64)
        to_metres = scale.transpose(0, 2, 1)
        predicted = scale @ (covariances - np.eye(2)) @ to_metres
        known = np.linalg.eigvalsh(predicted)[:, -1] <= POSITION_MAX_SD_M**2
        # The scene's noise, not the learned one: a wrong layout looks like noise, and is to be contradicted.
        own = scale @ to_metres / fit.scales[2]
        levers = fit.touches.contact_centres(fit.pads)[0] - fit.touches.evidence.sensors[at]
        off = np.where(known[:, None], (scale @ misses[:, :, None])[:, :, 0], np.nan)
        found.append((at, levers, off, predicted + own, own))
    if not found:
        return PokePredictions.none()
    return PokePredictions(*(np.concatenate(each) for each in zip(*found, strict=True)))
