"""Positions of taxels as the guide believes them: the layout placed on the part, corrected by the estimates.

A skin deviates from its plan as a whole, then module by module, then taxel by taxel. Each step takes the mean offset of the
measured taxels, weighted by their precision, with a zero-mean prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.guide.progress import GuideSettings
from skincal.guide.taxel_statistics import solve_each
from skincal.mesh.lay import PlacedLayout
from skincal.mesh.search import nearest_pushed_points
from skincal.mesh.surface import Surface
from skincal.model.scene import NoiseSettings
from skincal.model.skin import Layout, SkinKind
from skincal.taxels.result import Estimate

DEFAULT_TAXEL_SPACING_M = 0.005
"""Distance of neighbouring taxels without a layout: the iCub's and most others'."""
SKIN_OFFSET_FROM_PLAN_SD_M = 0.006
"""Offset of the whole skin from its plan, each direction: by hand it is put on to a few millimetres."""
MODULE_OFFSET_FROM_SKIN_SD_M = 0.002
"""Offset of a module from where the whole skin puts it: turns of the skin, and its bend."""
TAXEL_OFFSET_FROM_MODULE_SD_M = 0.001
"""Offset of a taxel from where its module puts it: pads are printed more exactly; the mesh is not the part."""
RIG_SHIFT_SHARE_DIFFERING_BY_MODULE = 0.3
"""Part of a rig's shift that differs between modules: turns of an arm pose of 1 degree (`RigPrior`) move positions 0.1 m apart
by 2 mm against each other, and the skin 0.2 to 0.4 m from the sensor by 3 to 7 mm."""
MIN_ESTIMATE_SD_M = 0.0005
"""No estimate counts as more precise, so that one taxel does not outvote the rest."""


@dataclass(frozen=True, slots=True, eq=False)
class PlannedPlaces:
    """Positions of n taxels by the layout, link frame."""

    channels: IntArray
    """(n,)."""
    places: FloatArray
    """(n, 3) float, metres; NaN where the layout gives none."""
    normals: FloatArray
    """(n, 3) float, unit, outward; NaN without a position."""
    modules: IntArray
    """(n,) index of the module, from 0."""
    sheet: FloatArray | None = None
    """(n, 2) float, metres: positions in the plane of the layout if it is of soft sheets; `None` for boards."""
    spacing: float = DEFAULT_TAXEL_SPACING_M
    """m, usual distance of neighbours."""
    on_surface: bool = True
    """Whether a mesh gives the depth of the taxels; without one, modules need tilted pushes for it."""
    carrier: Surface | None = None
    """Mesh that carries soft sheets; `None` for boards, or without a mesh."""


def plan_from_layout(layout: Layout, laid: PlacedLayout, surface: Surface | None = None) -> PlannedPlaces | None:
    """Make the plan of the taxels that a layout `laid` on a surface gives a position; `None` if there are none."""
    channels = layout.channels
    channels = channels[np.isfinite(laid.places[channels]).all(axis=1)]
    if not len(channels):
        return None
    flat = layout.places[channels] if layout.kind is SkinKind.SHEET else None
    carrier = None if flat is None else surface
    return PlannedPlaces(
        channels,
        laid.places[channels],
        laid.normals[channels],
        layout.module_of[channels],
        flat,
        layout.spacing,
        carrier=carrier,
    )


def planned_sheet_pokes(plan: PlannedPlaces, noise: NoiseSettings, settings: GuideSettings) -> int | None:
    """Count the pokes that the soft sheets of a plan need; `None` for boards."""
    if plan.sheet is None:
        return None
    # Imported only for sheets.
    from skincal.modules.sheet_plan import count_sheet_pokes

    sheets = [plan.sheet[plan.modules == module] for module in np.unique(plan.modules)]
    return sum(max(count_sheet_pokes(flat, noise, settings.module_wanted), settings.module_pokes) for flat in sheets)


def plan_without_positions(channels: IntArray, modules: IntArray | None = None) -> PlannedPlaces:
    """Make planned places of `channels` (n,) that are all unknown; `modules` is (n,) their modules, `None` if unknown."""
    nowhere = np.full((len(channels), 3), np.nan)
    owners = np.zeros(len(channels), dtype=np.int64) if modules is None else modules
    return PlannedPlaces(channels, nowhere, nowhere.copy(), owners)


def measured_positions(estimates: Sequence[Estimate]) -> tuple[FloatArray, FloatArray]:
    """Collect (n, 3) positions, metres, NaN without an estimate, and compute (n, 3, 3) their precisions, 1/m^2, there 0."""
    measured, precision = np.full((len(estimates), 3), np.nan), np.zeros((len(estimates), 3, 3))
    known = [
        (row, estimate.position, estimate.covariance)
        for row, estimate in enumerate(estimates)
        if estimate.position is not None and estimate.covariance is not None
    ]
    if known:
        rows, positions, covariances = zip(*known, strict=True)
        measured[list(rows)] = positions
        precision[list(rows)] = np.linalg.inv(np.array(covariances) + MIN_ESTIMATE_SD_M**2 * np.eye(3))
        precision[np.isnan(measured[:, 0])] = 0.0
    return measured, precision


def believed_from_measured(plan: PlannedPlaces, measured: FloatArray, precision: FloatArray, rig: float) -> FloatArray:
    """Compute (n, 3) the believed positions, metres; NaN without plan and measurement.

    Errors of the rig shift all estimates nearly alike, as if the skin lay elsewhere. If the rig error is large, a common offset
    of the estimates is attributed to the rig, and the targets stay on the planned skin.

    Parameters
    ----------
    measured, precision : (n, 3) and (n, 3, 3), `measured_positions` of the taxels
    rig : m, sd of the rig's shift in each direction
    """
    off = np.where(np.isfinite(plan.places), measured - plan.places, np.nan)
    known, module = np.isfinite(off).all(axis=1), plan.modules
    everyone, rig_of_module = np.zeros(int(known.sum()), dtype=np.int64), RIG_SHIFT_SHARE_DIFFERING_BY_MODULE * rig
    whole = _group_offsets(off[known], precision[known], everyone, 1, float(np.hypot(SKIN_OFFSET_FROM_PLAN_SD_M, rig)))[0]
    count, rest = int(module.max(initial=-1)) + 1, off - whole
    sd = float(np.hypot(MODULE_OFFSET_FROM_SKIN_SD_M, rig_of_module))
    own = _group_offsets(rest[known], precision[known], module[known], count, sd)
    if not count:
        return _add_own_offset(plan.places.copy(), measured, precision, np.zeros(3))
    moved = whole + own
    skin = _skin_share(SKIN_OFFSET_FROM_PLAN_SD_M, rig) * whole + _skin_share(MODULE_OFFSET_FROM_SKIN_SD_M, rig_of_module) * own
    places = _add_own_offset(plan.places + skin[module], measured, precision, (moved - skin)[module])
    return places if plan.carrier is None else _on_carrier(plan.carrier, places, plan.normals)


def _on_carrier(carrier: Surface, places: FloatArray, normals: FloatArray) -> FloatArray:
    """Move positions (n, 3) to the mesh: a sheet that slid around a bend turned, and its offset is that of its middle."""
    known, found = np.isfinite(places).all(axis=1) & np.isfinite(normals).all(axis=1), places.copy()
    found[known] = nearest_pushed_points(carrier, places[known], -normals[known])[0]
    return found


def _skin_share(skin: float, rig: float) -> float:
    """Compute the part of a common offset that is the skin's, from the sd of both."""
    return skin**2 / (skin**2 + rig**2)


def _group_offsets(off: FloatArray, precision: FloatArray, groups: IntArray, count: int, sd: float) -> FloatArray:
    """Compute (count, 3) the weighted mean of `off` (m, 3) in each group, with a zero-mean prior of `sd`."""
    total = _add_to_groups(np.tile((np.eye(3) / sd**2).ravel(), (count, 1)), groups, precision.reshape(-1, 9))
    pull = _add_to_groups(np.zeros((count, 3)), groups, (precision @ off[:, :, None])[:, :, 0])
    return solve_each(total.reshape(-1, 3, 3), pull)


def _add_to_groups(begin: FloatArray, groups: IntArray, values: FloatArray) -> FloatArray:
    """Add rows of `values` (m, k) to those of `begin` (count, k), in their order: as `np.add.at`, in a tenth of its time."""
    where, rows = np.concatenate([np.arange(len(begin)), groups]), np.concatenate([begin, values])
    columns = [np.bincount(where, column, minlength=len(begin)) for column in np.ascontiguousarray(rows.T)]
    return np.array(columns, dtype=np.float64).T


def _add_own_offset(places: FloatArray, measured: FloatArray, precision: FloatArray, rig: FloatArray) -> FloatArray:
    """Shift positions towards each taxel's own estimate, less the rig's share, by how precise that is."""
    # On a large skin most have none yet, and stay.
    rows = np.flatnonzero(precision.any(axis=(1, 2)))
    off, known, own = np.nan_to_num(measured - places - rig)[rows], precision[rows], np.zeros(places.shape)
    own[rows] = solve_each(known + np.eye(3) / TAXEL_OFFSET_FROM_MODULE_SD_M**2, (known @ off[:, :, None])[:, :, 0])
    return np.where(np.isfinite(places), places + own, measured)
