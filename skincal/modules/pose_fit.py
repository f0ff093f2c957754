"""Fit of the modules' poses: least squares over all pokes of each module.

**Position of a poke.** It is not each taxel that answered, but the centre c = sum k_j P_j / sum k_j of the module's pads, with
a small offset in the skin (`offset_variances`). Its two rows are those of `skincal.taxels.contact_table` with c for the taxel:
e_1.(c - a), e_2.(c - a). So a module is drawn to positions that are poked often no more than to others. A poke counts for the
module that answers most.

**Its rows**, r = E (a - c), have the covariance

    D = E N E' + s^2 (I - o o'),   o = E n,

N the sensor's noise at the lever l of c (`uncertainty.h`), s the offset of a contact from the centre, in the skin with the
normal n. Written as sums, so that nothing cancels for a long lever or a grazing push: with J a quarter turn,

    D = q I + p p' + r r',   q = (moment/|f|)^2 + (force/|f|)^2 (u.l)^2 + s^2 (u.n)^2,   p = force/|f| E l,   r = s J o,

and its determinant is q^2 + q (|p|^2 + |r|^2) + (p x r)^2. The rows are L^-1 r with D = L L'.

**The start** of the search is the pose that fits the estimates of the module's taxels by other methods. With q_j the estimates,
b_j the pads in the module's plane and w_j = 1/(rms_j^2 + MIN_TAXEL_ESTIMATE_ERROR_M^2), the turn that minimises
sum w |q - R b - t|^2 in the plane across the mean normal is that of the complex number sum w conj(b - mean b)(q - mean q). If
its uncertainty, 1/sqrt(sum w |b - mean b|^2), is too large, the plan's turn is taken.

**The search** minimises the sum of squares of the whitened rows A, b over the module's unknowns, with the noise at the pose.
The Gauss-Newton step comes from QR of the rows (their condition is never squared); the singular values of the small factor give
the directions that the pokes determine. Alone it converges linearly, and oscillates by millimetres if pokes hardly determine
a module's tilt. So the change of the rows with the pose is used as well, B (`ModuleRows.bends`), of the remaining misses:

    step = R^-1 (I - R'^-1 B R^-1)^-1 Q'b,   A = Q R,

if that matrix is positive, else R^-1 Q'b. Both are zero at the same pose, where A'b is: B changes the speed, not the answer.

**Trust** is that of `trust.h` for the whole module: an outlier counts less, measured against the module's own spread. It is
judged among the pokes of the same arm pose if these are enough: a pose that is reported wrong shifts all its pokes.

Pokes, starts and thresholds are found here; rows, trust and search are in `skincal/solver/source/modules.h`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray, select_rows
from skincal.model.scene import NoiseSettings
from skincal.modules.pose import (
    MODULE_TURN_TO_LENGTH_RADIUS_M,
    ModuleGround,
    ModuleModel,
    ModulePoses,
    ModulesOnSurface,
    Pads,
    join_poses,
)
from skincal.solver.machine import Machine, Value, fill_in, shared
from skincal.solver.tables import SHARED_TABLES
from skincal.taxels.contact_table import Evidence
from skincal.taxels.noise import noise_in_solver
from skincal.taxels.result import Estimate

CONTACT_TO_PAD_CENTRE_SD_FACTOR = 1.6
"""sd of the offset of the centre of n pads from the contact, in units of `NoiseSettings.contact` / n, each direction: on the
simulated forearm 2.4, 1.5, 0.8 and 0.5 mm for one to four pads."""
EXTRA_SD_IF_TWO_MODULES_ANSWER_M = 0.001
"""More offset if another module answers too: the tip is on both."""
MODULE_MIN_SHARE_OF_ANSWERS = 0.5
"""A poke counts for a module with a larger share of the answers."""


@dataclass(frozen=True, slots=True, eq=False)
class Touches:
    """m pokes on b modules, ordered by module, then by the poke's number."""

    modules: IntArray
    """(b,) indices in the layout, ascending."""
    of: IntArray
    """(m,) touched module, index in `modules`."""
    rows: IntArray
    """(m,) an answer of each poke in `evidence`."""
    evidence: Evidence
    offsets: FloatArray
    """(m,) float, m^2: `offset_variances`."""
    answers: IntArray
    """(a,) pads that answered, indices into the pads of all `modules`, one module after another."""
    shares: FloatArray
    """(a,) float: weight in the centre of its poke; those of a poke sum to 1."""
    channels: IntArray
    """(n,) the channels of the pads of all `modules`, one module after another."""
    starts: IntArray
    """(m,) first answer of each poke."""

    def channels_of(self, touch: int) -> IntArray:
        """List the channels of its module that answered a poke."""
        end = self.starts[touch + 1] if touch + 1 < len(self.starts) else len(self.answers)
        return self.channels[self.answers[self.starts[touch] : end]]

    def contact_centres(self, pads: Pads) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute the positions (m, 3), metres, gradients (m, 3, d) and normals (m, 3), unit, of the pokes' centres."""
        shares = self.shares[:, None]
        each = (
            shares * pads.points[self.answers],
            shares[:, None] * pads.gradients[self.answers],
            shares * pads.normals[self.answers],
        )
        points, gradients, normals = (np.add.reduceat(values, self.starts, axis=0) for values in each)
        return points, gradients, normals / np.sqrt(np.sum(normals * normals, axis=1, keepdims=True))


def offset_variances(answering: IntArray, across: FloatArray, noise: NoiseSettings) -> FloatArray:
    """Compute (m,) the variance of a contact about the centre of the pads that answered, each direction, m^2.

    Parameters
    ----------
    answering : (m,) number of the module's pads that answered
    across : (m,) float, 0 to 1: other modules' share of the answers
    """
    own = (CONTACT_TO_PAD_CENTRE_SD_FACTOR * noise.contact / answering) ** 2
    return np.asarray(own + np.where(across > 1e-9, EXTRA_SD_IF_TWO_MODULES_ANSWER_M**2, 0.0))


def assign_pokes(
    evidence: Evidence, totals: FloatArray, model: ModuleModel, noise: NoiseSettings, wanted: Collection[int]
) -> Touches:
    """Assign pokes to the modules `wanted`; one that touches several modules counts for the one that answers most.

    Parameters
    ----------
    evidence : rows of the layout's channels: all used ones of a module, or none of it
    totals : (n,) float, sum of the weights of all answers of an answer's poke, of other channels too
    wanted : indices of modules
    """
    channels = evidence.channels[evidence.taxels]
    owners = model.layout.module_of[channels]
    order = np.lexsort((channels, evidence.pokes, owners))
    ordered, pokes = owners[order], evidence.pokes[order]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (ordered[1:] != ordered[:-1]) | (pokes[1:] != pokes[:-1])
    firsts = np.flatnonzero(new)
    sums = np.add.reduceat(evidence.weights[order], firsts) if len(firsts) else np.empty(0)
    share = sums / totals[order[firsts]]
    sizes = np.diff(np.append(firsts, len(order)))
    # `np.isin` and `np.unique` take ten times as long for the few modules of a poke.
    is_wanted = np.zeros(len(model.pads), dtype=bool)
    is_wanted[list(wanted)] = True
    kept = (share > MODULE_MIN_SHARE_OF_ANSWERS) & is_wanted[ordered[firsts]]
    answers = order[np.repeat(kept, sizes)]
    rows, sizes, sums, share = order[firsts[kept]], sizes[kept], sums[kept], share[kept]
    touched = owners[rows]
    is_first = np.ones(len(touched), dtype=bool)
    is_first[1:] = touched[1:] != touched[:-1]
    modules = touched[is_first]
    indices: list[int] = modules.tolist()
    begins = np.cumsum([0, *(len(model.pads[module]) for module in indices)])
    return Touches(
        modules=modules,
        of=np.searchsorted(modules, touched),
        rows=rows,
        evidence=evidence,
        offsets=offset_variances(sizes, 1.0 - share, noise),
        answers=begins[np.searchsorted(modules, owners[answers])] + model.place_of[channels[answers]],
        shares=evidence.weights[answers] / np.repeat(sums, sizes),
        channels=np.array(model.channels_of(indices), dtype=np.int64),
        starts=np.cumsum(np.append(0, sizes))[:-1],
    )


@dataclass(frozen=True, slots=True, eq=False)
class ModuleRows:
    """Whitened rows of m pokes."""

    slopes: FloatArray
    """(m, 2, d) float, 1/m: derivative of the centre across the push by the module's unknowns, in standard deviations."""
    misses: FloatArray
    """(m, 2) float: distance of the axis from the centre, in standard deviations."""
    whiten: FloatArray
    """(m, 2, 2) float, 1/m: L^-1."""
    normals: FloatArray
    """(m, 3) float, unit, outward, of the skin at the centre."""
    bends: FloatArray
    """(m, d, d) float: derivative of A'b of each poke by the unknowns without -A'A, A its slopes and b its misses."""

    def select(self, rows: IntArray) -> ModuleRows:
        """Keep the pokes in the given rows."""
        return select_rows(self, rows)


def whitened_rows(touches: Touches, pads: Pads, noise: NoiseSettings) -> ModuleRows:
    """Compute the rows of pokes whose modules have their pads at `pads`."""
    count, unknowns = len(touches.of), pads.gradients.shape[2]
    found = shared().run(
        "module_rows",
        touches=_touches_in_solver(touches, noise, unknowns, pads.points, pads.gradients, pads.normals),
        **_room_for_rows(count, unknowns),
    )
    return _rows_found(found)


def _room_for_rows(count: int, unknowns: int) -> dict[str, Value]:
    shapes = ((count, 2, unknowns), (count, 2), (count, 2, 2), (count, 3), (count, unknowns, unknowns))
    return dict(zip(SHARED_TABLES["RowTable"].fields, shapes, strict=True))


def _rows_found(found: Mapping[str, NDArray[Any]]) -> ModuleRows:
    return ModuleRows(*(found[name] for name in SHARED_TABLES["RowTable"].fields))


def _touches_in_solver(
    touches: Touches, noise: NoiseSettings, unknowns: int, pads: Value, changes: Value, outward: Value
) -> dict[str, Value]:
    """Describe pokes as `Touches` of `skincal/solver/tables.py`; the last three are the pads, or room for them."""
    evidence, at = touches.evidence, touches.rows
    return {
        "pokes": len(at),
        "unknowns": unknowns,
        "starts": np.append(touches.starts, len(touches.answers)),
        "answers": touches.answers,
        "shares": touches.shares,
        "columns": evidence.columns.take(at, axis=1),
        "poses": evidence.poses[at],
        "offsets": touches.offsets,
        "noise": noise_in_solver(noise),
        "rules": _rules_in_solver(),
        "pads": pads,
        "changes": changes,
        "outward": outward,
    }


@cache
def _rules_in_solver() -> NDArray[Any]:
    rules = {
        "turn_to_length_radius": MODULE_TURN_TO_LENGTH_RADIUS_M,
        "min_pokes_per_arm_pose": MIN_POKES_PER_ARM_POSE,
        "robust_search_steps": ROBUST_SEARCH_STEPS,
        "max_step": POSE_SEARCH_MAX_STEP_M,
        "rounding_max_step": ROUNDING_MAX_STEP_M,
        "converged_step": POSE_SEARCH_CONVERGED_STEP_M,
        "min_curvature": MIN_CURVATURE_OVER_GAUSS_NEWTON,
        "min_reversal_share": HALVED_STEP_MIN_REVERSAL_SHARE,
        "max_steps": POSE_SEARCH_MAX_STEPS,
        "min_singular_value_ratio": MIN_SINGULAR_VALUE_RATIO,
        "turn_max_sd": MODULE_TURN_MAX_SD_RAD,
        "residual_scale": ROBUST_RESIDUAL_SCALE_M,
        "reweighting_steps": REWEIGHTING_STEPS,
        "min_direction": MIN_LENGTH_OF_A_DIRECTION,
    }
    return fill_in("Rules", rules)


MIN_TAXEL_ESTIMATE_ERROR_M = 0.002
"""No estimate counts as more precise, so that one does not outvote the rest."""
MODULE_TURN_MAX_SD_RAD = 0.35
"""If the estimates determine the turn worse, the plan's is taken; a search finds its way back from 60 degrees."""
ROBUST_RESIDUAL_SCALE_M = 0.004
"""Estimates with a larger residual count less."""
REWEIGHTING_STEPS = 3
MIN_LENGTH_OF_A_DIRECTION = 0.1
"""Length of a unit vector's part in a plane below which it gives no direction there."""


def find_starts(
    model: ModuleModel, modules: Collection[int], others: Sequence[Mapping[int, Estimate]]
) -> dict[int, ModulePoses]:
    """Find the poses where the searches for some modules begin, by module; none for one without estimates and plan.

    `others` are estimates by channel, the best method first.
    """
    found: dict[int, ModulePoses] = {}
    for estimates in others:
        rest = [module for module in modules if module not in found]
        found |= _fit_estimates(model, rest, estimates) if rest else {}
    for module in modules:
        plan = None if module in found else model.plan(module)
        if plan is not None:
            found[module] = plan
    return found


def _fit_estimates(model: ModuleModel, modules: Sequence[int], estimates: Mapping[int, Estimate]) -> dict[int, ModulePoses]:
    """Fit poses of modules to the estimates of their taxels by one method, by module; none if these do not determine one."""
    known: list[Estimate] = []
    pads: list[FloatArray] = []
    weights: list[float] = []
    spans = [0]
    for module in modules:
        for channel, pad in zip(model.channels[module], model.pads[module], strict=True):
            estimate = estimates.get(channel)
            if estimate is None or estimate.position is None or estimate.normal is None or estimate.rms is None:
                continue
            known.append(estimate)
            pads.append(pad)
            weights.append(1.0 / (estimate.rms**2 + MIN_TAXEL_ESTIMATE_ERROR_M**2))
        spans.append(len(known))
    if not known:
        return {}
    plans, nothing, count = [model.plan(module) for module in modules], np.zeros(3), len(modules)
    machine, ground = _machine(model.ground)
    found = machine.run(
        "start_modules",
        modules=count,
        rules=_rules_in_solver(),
        ground=ground,
        spans=np.array(spans),
        flat=np.array(pads),
        places=np.array([estimate.position for estimate in known]),
        outward=np.array([estimate.normal for estimate in known]),
        weights=np.array(weights),
        planned=np.array([plan is not None for plan in plans]),
        planned_x=np.array([nothing if plan is None else plan.x[0] for plan in plans]),
        planned_normals=np.array([nothing if plan is None else plan.normals[0] for plan in plans]),
        points=(count, 3),
        x=(count, 3),
        normals=(count, 3),
        triangles=(count,),
        known=(count,),
    )
    poses = ModulePoses(found["points"], found["x"], found["normals"], found["triangles"].astype(np.int64))
    there = enumerate(zip(modules, found["known"].tolist(), strict=True))
    return {module: poses.select(slice(row, row + 1)) for row, (module, is_there) in there if is_there}


MIN_POKES_PER_ARM_POSE = 8
"""From this number of pokes on, those of one arm pose are compared with each other."""
ROBUST_SEARCH_STEPS = 4
"""Steps of that search before trust is given."""
POSE_SEARCH_MAX_STEP_M = 0.015
"""Half a module, in each direction: farther off, the rows say little about the minimum."""
ROUNDING_MAX_STEP_M = 1e-7
"""Steps below it that no longer shrink to half are rounding."""
POSE_SEARCH_CONVERGED_STEP_M = 2e-17
"""The search ends if the next step would be smaller: the last digit of a position 0.2 m away."""
MIN_CURVATURE_OVER_GAUSS_NEWTON = 0.25
"""Least curvature, over that of the rows alone, at which B is used: below, a saddle is near."""
HALVED_STEP_MIN_REVERSAL_SHARE = 0.25
"""A step that reverses this share of the one before is halved: both go too far."""
POSE_SEARCH_MAX_STEPS = 20
"""A pose that still moves goes to and fro over an edge of the surface, by micrometres; or, without a surface, runs off because
few pokes hardly determine the module's tilt."""
MIN_SINGULAR_VALUE_RATIO = 1e-9
"""Directions with smaller singular values, relative to the largest, are not determined by the pokes."""


def trust_from_squares(squares: FloatArray) -> FloatArray:
    """Compute the trust (n,) of pokes, 0 to 1, from their squared misses (n,) in standard deviations (`trust.h`)."""
    return shared().run("trusts", pokes=len(squares), squares=squares, trust=squares.shape)["trust"]


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """Poses of b modules."""

    poses: ModulePoses
    pads: Pads
    """Of all modules, one after another."""
    of: IntArray
    """(n,) the module of each pad, 0 to b - 1."""
    covariances: FloatArray
    """(b, d, d) float, m^2, of the unknowns (turns at `MODULE_TURN_TO_LENGTH_RADIUS_M`); without meaning along `blind`."""
    blind: FloatArray
    """(b, d, d) float: rows of each are the directions of its unknowns that the pokes do not determine, the others zero."""
    misses: FloatArray
    """(b,) float, metres: rms distance of the axes from the centres, weighted by trust."""
    trust: FloatArray
    """(m,) float, 0 to 1, of each poke."""
    moving: FloatArray
    """(b,) float, metres: last step of a search that did not converge, else 0."""
    rows: ModuleRows
    """Of the m pokes, with the pads where they are."""


def fit_modules_from_pokes(
    evidence: Evidence,
    totals: FloatArray,
    model: ModuleModel,
    noise: NoiseSettings,
    others: Sequence[Mapping[int, Estimate]],
    doubting: bool = True,
) -> tuple[Touches, Fitted] | None:
    """Find the poses of all modules that pokes touched and that have a start; `None` if there are none.

    Parameters
    ----------
    evidence, totals : as for `assign_pokes`
    others : estimates by channel, the best method first
    doubting : whether outliers count less
    """
    starts = find_starts(model, model.modules_of(evidence.channels.tolist()), others)
    touches = assign_pokes(evidence, totals, model, noise, starts)
    if not len(touches.modules):
        return None
    start = join_poses([starts[module] for module in touches.modules.tolist()])
    return touches, fit_modules(touches, model, start, noise, doubting)


def fit_modules(
    touches: Touches, model: ModuleModel, start: ModulePoses, noise: NoiseSettings, doubting: bool = True
) -> Fitted:
    """Find the poses of the modules of `touches`.

    Parameters
    ----------
    start : of each module; within half a module and 60 degrees
    doubting : whether outliers count less
    """
    modules: list[int] = touches.modules.tolist()
    own = [model.pads[module] for module in modules]
    sizes, count, unknowns = [len(pads) for pads in own], len(own), model.ground.unknowns
    machine, ground = _machine(model.ground)
    of_pads, of_unknowns = (sum(sizes), 3), (count, unknowns, unknowns)
    found = machine.run(
        "place_modules",
        touches=_touches_in_solver(touches, noise, unknowns, of_pads, (sum(sizes), 3, unknowns), of_pads),
        modules=count,
        doubting=doubting,
        spans=np.searchsorted(touches.of, np.arange(count + 1)),
        boards=np.cumsum([0, *sizes]),
        flat=np.concatenate(own),
        ground=ground,
        trust=np.ones(len(touches.of)),
        points=start.points,
        x=start.x,
        normals=start.normals,
        triangles=start.triangles,
        under=(sum(sizes),),
        covariances=of_unknowns,
        blind=of_unknowns,
        misses=(count,),
        moving=(count,),
        rows=_room_for_rows(len(touches.of), unknowns),
    )
    return Fitted(
        poses=ModulePoses(found["points"], found["x"], found["normals"], found["triangles"].astype(np.int64)),
        pads=Pads(found["pads"], found["changes"], found["outward"], found["under"].astype(np.int64)),
        of=np.repeat(np.arange(count), sizes),
        covariances=found["covariances"],
        blind=found["blind"],
        misses=found["misses"],
        trust=found["trust"],
        moving=found["moving"],
        rows=_rows_found(found),
    )


def _machine(ground: ModuleGround) -> tuple[Machine, int]:
    """Get the machine that fits modules, and the place of the surface in it; 0 without a surface."""
    if not isinstance(ground, ModulesOnSurface):
        return shared(), 0
    # Imported only now: a scene without a mesh does not need it.
    from skincal.mesh.geodesics import geodesics_of

    known = geodesics_of(ground.surface)
    return known.machine, known.ground
