"""Stability cases of a module's covariances and height under shared errors, and the same in 80 digits.

A poke whose wrench and pose are off by x shifts its axis across the push by u x (dm - c x df)/|f|, and a module by
N^-1 sum A'D^-1 times that. A height z is one more unknown of the module, with n for its slope.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray
from skincal.mesh.surface import make_surface
from skincal.model.scene import NoiseSettings
from skincal.modules.estimate import FittedModule, estimate_modules
from skincal.modules.off_surface import HEIGHT_MAX_SD_M, SIGNIFICANT_HEIGHT_MIN_SDS, SUBTRACTED_SKIN_THICKNESS_SDS
from skincal.modules.pose import ModulePoses, ModulesOnSurface
from skincal.rig.correction import Correction, CorrectionErrors, RigPrior
from skincal.rig.correction_fit import (
    NONLINEAR_SENSOR_QUADRATIC_SHARE,
)
from skincal.studies.reference_80_digits import (
    MP,
    Exact,
    ExactPokes,
    dot,
    find_pose,
    inverse,
    pokes_of,
    product,
    residuals_and_jacobian,
    to_mp,
    true_pose,
)
from skincal.studies.stability_cases import (
    PADS_PER_MODULE,
    AddedCase,
    CaseSizes,
    ModuleCase,
    Outputs,
    arm_poses,
    contacts_of,
    in_space,
    model_of,
    module_case,
    on_sheet,
)
from skincal.studies.stability_corrections import ALL_COLUMNS, LINEAR_COLUMNS, axes_off
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Estimate

POKE_NUMBER_STEP_BETWEEN_CASES = 100
"""Pokes with numbers so far apart share no slow noise."""


@dataclass(frozen=True, slots=True, eq=False)
class CovarianceInputs:
    """A module's pokes, and the root of a correction's covariance."""

    case: ModuleCase
    root: FloatArray
    """(n, n) float, as in `Correction`."""
    columns: int
    """Of the matrix C."""
    known: int
    """Number of arm poses in the correction; the others are as wrong as the prior says."""


def renumber(contacts: Sequence[Contact]) -> dict[int, Contact]:
    """Renumber contacts so that they share no slow noise; return them by their numbers."""
    numbers = (1 + POKE_NUMBER_STEP_BETWEEN_CASES * at for at in range(len(contacts)))
    return {number: replace(contact, poke=number) for number, contact in zip(numbers, contacts, strict=True)}


def exact_covariances(shared: CovarianceInputs) -> Outputs:
    """Compute covariances of a module's pads, their part that all pokes share, and the variance of its height."""
    case = shared.case
    pokes = pokes_of(case.readings, case.noise)
    pose, _ = find_pose(pokes, true_pose(case))
    pads = pose.pads()
    misses, slopes, weight = residuals_and_jacobian(pokes, pads)
    unknowns = slopes.shape[2]
    places, _, normals = pokes.contact_centres(pads)
    weights = slopes.swapaxes(1, 2) @ weight
    back = inverse((weights @ slopes).sum(axis=0))
    alike, of_pose = _axes_of(shared, pokes, places)
    moves = back @ (weights @ alike).sum(axis=0)
    own = [(weights @ each).sum(axis=0) for each in of_pose]
    squares, free = dot(misses, (weight @ misses[:, :, None])[:, :, 0]).sum(), 2 * len(misses) - unknowns
    factor = _factor(squares, free)
    skin, out = to_mp(case.noise.skin), dot(pokes.pairs, normals[:, None])
    along = back @ (weights @ out[:, :, None]).sum(axis=0)
    total = factor * back + skin**2 * along @ along.T + sum(back @ each @ each.T @ back for each in own)
    height = MP.zero
    if unknowns == ModulesOnSurface.unknowns:
        # One unknown more: the misses' slope with the height, less what the module's own unknowns make of it.
        alone = ((out - (slopes @ along)[:, :, 0])[:, None] @ weight)[:, 0]
        told = dot(alone, out).sum()
        z = dot(alone, misses).sum() / told
        z = min(z, max(z - SUBTRACTED_SKIN_THICKNESS_SDS * skin, MP.zero))
        lifts = [(alone[:, None] @ each).sum(axis=0)[0] / told for each in (alike, *of_pose)]
        variance = factor / told + sum(dot(each, each) for each in lifts)
        height = (
            z**2 - variance
            if factor / told < HEIGHT_MAX_SD_M**2 and z**2 > SIGNIFICANT_HEIGHT_MIN_SDS**2 * variance
            else MP.zero
        )
    changes = pads.changes
    outward = height * pads.normals[:, :, None] * pads.normals[:, None]
    by_shared = changes @ (moves @ moves.T) @ changes.swapaxes(1, 2)
    covariances = changes @ total @ changes.swapaxes(1, 2) + by_shared + outward
    return _with_height({"covariances": covariances, "shared": by_shared}, np.array([height]))


def _factor(squares: Any, free: int) -> Any:
    """Return the factor by which misses exceed the scene's noise, as `variance_factors` defines it."""
    seen = squares / free - MP.sqrt(MP.mpf(2) / free)
    return seen * free / max(free - 2, 1) if seen > 1 else MP.one


def _axes_of(shared: CovarianceInputs, pokes: ExactPokes, places: Exact) -> tuple[Exact, list[Exact]]:
    """Return the shifts E da of the axes: (m, 2, n) by shared errors, and (m, 2, 6) by those of each unknown pose."""
    readings = shared.case.readings
    wrenches = to_mp(np.concatenate([readings.forces, readings.moments], axis=1))
    first, second = np.triu_indices(6)
    features = np.concatenate([wrenches, wrenches[:, first] * wrenches[:, second]], axis=1)[:, : shared.columns]
    of_wrench, of_pose = axes_off(wrenches, to_mp(readings.poses)[readings.pose_of], places)
    rows = (pokes.pairs @ of_wrench)[:, :, :, None] * features[:, None, None]
    size, root = 6 * shared.columns, to_mp(shared.root)
    alike, own = product(rows.reshape(len(rows), 2, size), root[:size]), pokes.pairs @ of_pose
    prior = RigPrior()
    scales, others = to_mp(np.repeat([prior.pose_turn, prior.pose_shift], 3)), list[Exact]()
    for pose in range(len(readings.poses)):
        here = readings.pose_of == pose
        if pose < shared.known:
            alike[here] = alike[here] + product(own[here], root[size + 6 * pose : size + 6 * pose + 6])
        else:
            others.append(here.astype(int)[:, None, None] * own * scales)
    return alike, others


def shipped_covariances(shared: CovarianceInputs) -> Outputs:
    """Compute the covariances by the program. It starts at its result: else its last step, up to 1e-7 m, is in the slopes."""
    case = shared.case
    surface = None if case.mesh is None else make_surface(case.mesh.vertices, case.mesh.triangles)
    contacts = renumber(contacts_of(case, np.arange(len(case.readings.forces))))
    quadratic = np.zeros((6, shared.columns - LINEAR_COLUMNS))
    motions = {f"pose {pose}": np.eye(4) for pose in range(shared.known)}
    correction = Correction(np.eye(6), motions=motions, root=shared.root, quadratic=quadratic)
    table, errors = ContactTable(list(contacts.values())), CorrectionErrors(correction, contacts.__getitem__)

    def placed_from(start: ModulePoses) -> tuple[list[Estimate], FittedModule]:
        kept, model = dict[int, FittedModule](), model_of([replace(case, start=start)], surface)
        found = estimate_modules(table, model, [0], case.noise, [], {}, False, errors, kept)
        return [found[channel] for channel in range(PADS_PER_MODULE)], kept[0]

    pads, module = placed_from(placed_from(case.start)[1].pose)
    moves = np.array([pad.moved for pad in pads])
    covariances = np.array([pad.covariance for pad in pads])
    by_shared = moves @ moves.transpose(0, 2, 1)
    return _with_height({"covariances": covariances, "shared": by_shared}, np.array([module.height]))


def _with_height(outputs: Outputs, height: Any) -> Outputs:
    """Add the variance of a height unless it is zero, which would have no tolerance."""
    return {**outputs, "height": height} if height[0] else outputs


# ---- cases ----


def correction_root(rng: np.random.Generator, columns: int, poses: int, share: float = 0.2) -> FloatArray:
    """Make a root of a correction's covariance: fully correlated, a share of the prior's size."""
    quadratic = NONLINEAR_SENSOR_QUADRATIC_SHARE if columns > LINEAR_COLUMNS else 0.0
    scales = replace(RigPrior(), quadratic=quadratic).scales(poses)
    return np.triu(scales[:, None] * share * (np.eye(len(scales)) + 0.1 * rng.normal(size=(len(scales),) * 2)))


def covariance_cases(rng: np.random.Generator, sizes: CaseSizes) -> Iterator[AddedCase]:
    """Yield covariances and heights of a module in space and on a sheet."""
    n, poses = max(sizes.contacts, 10), arm_poses(rng, 2, 0.3)
    grounds = {"module": in_space(rng), "module on a sheet": on_sheet(rng, sizes, 8.0)}

    def case(name: str, module: ModuleCase, share: float = 0.2, columns: int = LINEAR_COLUMNS, known: int = 2) -> AddedCase:
        inputs = CovarianceInputs(module, correction_root(rng, columns, known, share), columns, known)
        return AddedCase(name, inputs, shipped_covariances, exact_covariances, len(module.readings.forces))

    for (name, ground), tilt in zip(grounds.items(), (0.2, 0.001), strict=True):
        how: dict[str, Any] = {"rng": rng, "module": ground, "pokes": n, "poses": poses}
        yield case(f"{name}, shared errors", module_case(name, **how))
        yield case(f"{name}, shared errors of products too", module_case(name, **how), columns=ALL_COLUMNS)
        yield case(f"{name}, arm poses that are not known", module_case(name, **how), known=0)
        yield case(f"{name}, shared errors, pushes within {tilt} rad", module_case(name, tilt=tilt, **how))
        loud = NoiseSettings(force=0.2, moment=0.02)
        yield case(f"{name}, shared errors, twice the noise", module_case(name, noise=loud, **how))
        yield case(f"{name}, shared errors, misses of 6 mm", module_case(name, scatter=0.006, **how))
    flat = grounds["module on a sheet"]
    for far in (0.004, -0.003):
        usual = module_case(
            "", rng, flat, 2 * n, NoiseSettings(contact=0.0005, skin=0.0005), poses=poses, tilt=0.8, scatter=1e-4
        )
        assert flat.mesh is not None
        mesh = replace(flat.mesh, vertices=flat.mesh.vertices - far * flat.at.normals[0])
        lowered = replace(flat, mesh=mesh, at=replace(flat.at, points=flat.at.points - far * flat.at.normals[0]))
        start = replace(usual.start, points=usual.start.points - far * flat.at.normals[0])
        yield case(f"module {1e3 * far:g} mm over its sheet", replace(usual, mesh=mesh, module=lowered, start=start), 0.02)
