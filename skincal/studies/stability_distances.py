"""Stability cases of known distances between modules, and the same in 80 digits: rows next to the inverse of P."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.scene import KnownDistance, NoiseSettings
from skincal.modules.distances import GAUSS_NEWTON_STEPS as DISTANCE_STEPS
from skincal.modules.distances import apply_distances
from skincal.modules.estimate import FittedModule, estimate_modules
from skincal.modules.pose import MODULE_TURN_TO_LENGTH_RADIUS_M
from skincal.rig.correction import Correction, CorrectionErrors
from skincal.studies.reference_80_digits import (
    MP,
    Exact,
    ExactPads,
    InPlane,
    dot,
    inverse,
    rotate,
    to_mp,
)
from skincal.studies.stability_cases import (
    PADS_PER_MODULE,
    AddedCase,
    CaseSizes,
    ModuleCase,
    Outputs,
    contacts_of,
    in_space,
    model_of,
    module_case,
    unit,
)
from skincal.studies.stability_corrections import LINEAR_COLUMNS
from skincal.studies.stability_covariances import correction_root, renumber
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Estimate, Method, State

_np: Any = np


@dataclass(frozen=True, slots=True, eq=False)
class DistanceInputs:
    """Modules as their own pokes place them, without a surface, and known distances between them."""

    cases: tuple[ModuleCase, ...]
    fitted: tuple[FittedModule, ...]
    distances: tuple[KnownDistance, ...]
    lengths: FloatArray
    """(d,) float, m."""
    noise: NoiseSettings


def fit_modules_with_distances(
    cases: Sequence[ModuleCase], distances: Sequence[KnownDistance], root: FloatArray
) -> DistanceInputs:
    """Fit the modules of cases by the program, with correction errors of this root."""
    contacts = [
        replace(contact, channels=contact.channels + number * PADS_PER_MODULE, pose=f"pose {number}")
        for number, case in enumerate(cases)
        for contact in contacts_of(case, np.arange(len(case.readings.forces)))
    ]
    by_poke, kept, noise = renumber(contacts), dict[int, FittedModule](), cases[0].noise
    errors = CorrectionErrors(Correction(np.eye(6), root=root), by_poke.__getitem__)
    table, modules = ContactTable(list(by_poke.values())), range(len(cases))
    estimate_modules(table, model_of(cases, None), modules, noise, [], {}, False, errors, kept)
    lengths = np.array([each.length for each in distances])
    return DistanceInputs(tuple(cases), tuple(kept[module] for module in modules), tuple(distances), lengths, noise)


def shipped_distances(joined: DistanceInputs) -> Outputs:
    """Compute the pads' positions and covariances by the program."""
    model = model_of(joined.cases, None, joined.distances)
    before = {
        channel: Estimate(channel, Method.MODULES, State.TOUCHED, 1, position=np.zeros(3), covariance=np.eye(3))
        for channel in range(len(joined.cases) * PADS_PER_MODULE)
    }
    found, tried = apply_distances(model, dict(enumerate(joined.fitted)), before, joined.noise)
    if not all(each.used for each in tried):
        raise ValueError("a case whose distances do not all count")
    every = [found[channel] for channel in before]
    places, covariances = ([getattr(each, name) for each in every] for name in ("position", "covariance"))
    return {"places": np.array(places), "covariances": np.array(covariances)}


def exact_distances(joined: DistanceInputs) -> Outputs:
    """Compute the same by Gauss-Newton steps with the inverse of P and the distances' rows."""
    count, own = len(joined.fitted), joined.fitted
    size = 6 * count
    prior = _np.full((size, size), MP.zero)
    for at, module in enumerate(own):
        prior[6 * at : 6 * at + 6, 6 * at : 6 * at + 6] = to_mp(module.covariance)
    moves = to_mp(np.concatenate([module.moves for module in own]))
    held = inverse(prior + moves @ moves.T)
    ends = [[_end_of(joined, told, side) for side in (0, 1)] for told in joined.distances]
    x, covariance = to_mp(np.zeros(size)), held
    for _ in range(DISTANCE_STEPS):
        rows, left, weights = zip(
            *(_distance(joined, x, *each) for each in zip(joined.distances, joined.lengths, ends, strict=True)), strict=True
        )
        slopes, weighing = np.array(rows), np.array(weights)[:, None]
        covariance = inverse(held + slopes.T @ (weighing * slopes))
        x = covariance @ (slopes.T @ (weighing[:, 0] * np.array(left)))
    laid = [_place_points(joined, at, x, joined.cases[at].module.flat) for at in range(count)]
    covariances = [
        each.changes @ covariance[6 * at : 6 * at + 6, 6 * at : 6 * at + 6] @ each.changes.swapaxes(1, 2)
        for at, each in enumerate(laid)
    ]
    return {"places": np.concatenate([each.points for each in laid]), "covariances": np.concatenate(covariances)}


def _end_of(joined: DistanceInputs, told: KnownDistance, side: int) -> tuple[int, FloatArray]:
    """Return the module at an end of a distance, and that point in its plane."""
    end = told.ends[side]
    return (
        (end // PADS_PER_MODULE, joined.cases[end // PADS_PER_MODULE].module.flat[end % PADS_PER_MODULE])
        if told.of_taxels
        else (end, np.zeros(2))
    )


def _place_points(joined: DistanceInputs, at: int, x: Exact, flat: FloatArray) -> ExactPads:
    """Lay points of a module's plane after the move x, whose turns are lengths at `MODULE_TURN_TO_LENGTH_RADIUS_M`."""
    pose, step = joined.fitted[at].pose, x[6 * at : 6 * at + 6]
    by = step[3:] / to_mp(MODULE_TURN_TO_LENGTH_RADIUS_M)
    place = to_mp(pose.points[0]) + step[:3]
    pads = InPlane(place, rotate(to_mp(pose.x[0]), by), rotate(to_mp(pose.normals[0]), by), to_mp(flat)).pads()
    turns = pads.changes[:, :, 3:] / to_mp(MODULE_TURN_TO_LENGTH_RADIUS_M)
    return pads._replace(changes=np.concatenate([pads.changes[:, :, :3], turns], axis=2))


def _distance(
    joined: DistanceInputs, x: Exact, told: KnownDistance, known: float, ends: Sequence[tuple[int, FloatArray]]
) -> tuple[Exact, Any, Any]:
    """Return a distance's row J, the wanted J x, and 1/R."""
    one, other = (_place_points(joined, at, x, flat[None]) for at, flat in ends)
    way = (one.points - other.points)[0]
    length = MP.sqrt(dot(way, way))
    variance, row = to_mp(told.sd) ** 2, to_mp(np.zeros(len(x)))
    for sign, pads, (at, flat) in ((1, one, ends[0]), (-1, other, ends[1])):
        row[6 * at : 6 * at + 6] = sign * (way / length) @ pads.changes[0]
        every, here = to_mp(joined.cases[at].module.flat), to_mp(flat)
        middle = every.sum(axis=0) / len(every)
        square = dot(every - middle, every - middle).sum() / len(every) - dot(here - middle, here - middle)
        lean = dot(pads.normals[0], way / length)
        variance = variance + (square / (2 * to_mp(joined.noise.radius)) * lean) ** 2
    return row, to_mp(known) - length + dot(row, x), 1 / variance


# ---- cases ----


def distance_cases(rng: np.random.Generator, sizes: CaseSizes) -> Iterator[AddedCase]:
    """Yield three modules with four known distances."""
    n, root = max(sizes.contacts, 10), correction_root(rng, LINEAR_COLUMNS, 0)
    for name, sd, tilt in (("", 0.0005, 0.5), (" known to 1e-6 m", 1e-6, 0.5), (", pushes within 0.02 rad", 0.0005, 0.02)):
        cases: list[ModuleCase] = []
        for number in range(3):
            module = in_space(rng, at=unit(rng.normal(size=3)) * 0.05 + np.array([0.05 * number, 0.0, 0.1]))
            cases.append(module_case("", rng, module, n, tilt=tilt))
        pads = [case.module.pad_positions() for case in cases]
        ends_of = (
            ((0, 1), False),
            ((1, 2), False),
            ((3, PADS_PER_MODULE + 7), True),
            ((PADS_PER_MODULE + 2, 2 * PADS_PER_MODULE + 9), True),
        )
        told: list[KnownDistance] = []
        for ends, taxels in ends_of:
            one, other = (_where(cases, pads, end, taxels) for end in ends)
            told.append(KnownDistance(ends, taxels, float(np.linalg.norm(one - other)), sd))
        inputs = fit_modules_with_distances(cases, told, root)
        yield AddedCase(f"distances between three modules{name}", inputs, shipped_distances, exact_distances, 3 * n)


def _where(cases: Sequence[ModuleCase], pads: Sequence[FloatArray], end: int, of_taxels: bool) -> FloatArray:
    return pads[end // PADS_PER_MODULE][end % PADS_PER_MODULE] if of_taxels else cases[end].module.at.points[0]
