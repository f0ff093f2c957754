"""What the program makes of rigs that are wrong in ways it does not model, as the second simulator pokes them (`physics.py`).

Each case is a rig with the paper's errors and one more, poked 504 times in seven arm poses; solved as it reports itself, and
corrected by 21 and by 70 pokes at landmarks. What counts is the error beside the error that is predicted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray
from skincal.guide.verdict import check
from skincal.mesh.load import load_surface
from skincal.mesh.surface import Surface, make_surface
from skincal.methods import estimate_taxels
from skincal.model.scene import Scene, load_scene, resource
from skincal.modules.pose import ModuleModel
from skincal.rig.correction_fit import LandmarkPoke, RigRequest, correct_rig
from skincal.studies.measuring import processes
from skincal.studies.physics import CASES, Poked, poke
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Estimate, Method

LANDMARKS = (0, 21, 70)
"""Landmark pokes: none, those that the guide asks for, and ten in each arm pose."""
SEEDS = 12
FLAT = 1e-6
"""A covariance whose smallest variance is below this share of its largest is one on a surface."""
SQUARES = {1: 3.841, 2: 5.991, 3: 7.815}
"""By degrees of freedom, the chi-squared that 95 % stay below."""


@dataclass(frozen=True, slots=True)
class Found:
    """What a method makes of one session."""

    mean: float
    """mm, error over the taxels that have an estimate."""
    inside: float
    """Share of these taxels that lie inside their 95 % ellipsoid."""
    predicted: float
    """mm, rms."""
    true_rms: float
    """mm, rms."""
    missing: int
    """Taxels without an estimate."""
    believed: bool
    """Whether held-out pokes speak for the predicted error, as the verdict has it."""
    used: bool
    """Whether the rig was corrected."""


@lru_cache(maxsize=1)
def part() -> tuple[Scene, Surface]:
    """Return the forearm that ships, and its mesh."""
    scene = load_scene(resource("scenes/icub-forearm/scene.toml"))
    assert scene.surface is not None
    return scene, load_surface(scene.surface)[0]


def inside(off: FloatArray, covariance: FloatArray) -> bool:
    """Return whether an error (3,) lies inside the 95 % ellipsoid of a covariance (3, 3): its ellipse, if it has no depth."""
    values, axes = np.linalg.eigh(covariance)
    told = values > FLAT * values[-1]
    square = float(np.sum((axes[:, told].T @ off) ** 2 / values[told]))
    return square < SQUARES[int(told.sum())]


def run_one(case: str, seed: int) -> dict[int, dict[str, Found]]:
    """Return what came of a session, by the number of landmark pokes and the method."""
    scene, true = part()
    poked = poke(scene, true.vertices, true.triangles, CASES[case], seed)
    surface = make_surface(poked.vertices, true.triangles)
    found = {0: _solved(scene, surface, poked, poked.contacts, used=False)}
    for count in LANDMARKS[1:]:
        known = [
            LandmarkPoke(one.poke, one.name, one.place, one.force, one.moment, one.link_from_sensor, one.pose)
            for one in poked.known
            if one.planned or count == LANDMARKS[-1]
        ]
        answer = correct_rig(RigRequest(scene, surface, poked.contacts, known))
        if answer.used and answer.correction is not None:
            right = [answer.correction.corrected(contact) for contact in poked.contacts]
            found[count] = _solved(scene, surface, poked, right, used=True)
        else:
            found[count] = found[0]
    return found


def _solved(scene: Scene, surface: Surface, poked: Poked, contacts: Sequence[Contact], used: bool) -> dict[str, Found]:
    layout = scene.skin.layout
    assert layout is not None
    model, channels = ModuleModel(layout, scene.skin.anchor, surface), poked.channels.tolist()
    table = ContactTable(contacts)
    estimates = estimate_taxels(contacts, channels, tuple(Method), scene.noise, surface, model=model)
    found: dict[str, Found] = {}
    for method, own in estimates.items():
        of = list(own.values())
        tried = check(contacts, channels, table.evidence, method, scene.noise, surface, model, of)
        found[method.value] = _found(of, poked.places, tried.believed, used)
    return found


def _found(estimates: Sequence[Estimate], places: FloatArray, believed: bool, used: bool) -> Found:
    both: list[tuple[FloatArray, FloatArray]] = [
        (estimate.position - place, estimate.covariance)
        for estimate, place in zip(estimates, places, strict=True)
        if estimate.position is not None and estimate.covariance is not None
    ]
    off: FloatArray = np.sqrt(np.sum(np.array([error for error, _ in both]) ** 2, axis=1))
    return Found(
        mean=1e3 * float(off.mean()),
        inside=float(np.mean([inside(error, covariance) for error, covariance in both])),
        predicted=1e3 * float(np.sqrt(np.mean([float(covariance.trace()) for _, covariance in both]))),
        true_rms=1e3 * float(np.sqrt(np.mean(off**2))),
        missing=len(estimates) - len(both),
        believed=believed,
        used=used,
    )


def unmodelled(seeds: int = SEEDS, cases: Sequence[str] = tuple(CASES)) -> list[dict[str, Any]]:
    """Try the program on rigs of each case.

    Returns
    -------
    a row for each case: `case`; mean errors, mm, `uncorrected`, `21` and `70` by the modules method, with `inside_0`,
    `inside_21`, `inside_70`, `predicted` (mm, rms, after 21) and `true_rms`; and `methods`: the same and more for each number
    of landmark pokes and each method, means over seeds
    """
    jobs = [(case, seed) for case in cases for seed in range(1, seeds + 1)]
    with processes() as pool:
        found = list(pool.map(run_one, *zip(*jobs, strict=True)))
    return [_row(case, found[i * seeds : (i + 1) * seeds]) for i, case in enumerate(cases)]


def _row(case: str, found: Sequence[dict[int, dict[str, Found]]]) -> dict[str, Any]:
    means = {
        count: {method.value: _over([each[count][method.value] for each in found]) for method in Method} for count in LANDMARKS
    }
    lead = {count: own[Method.MODULES.value] for count, own in means.items()}
    none, few, many = (lead[count] for count in LANDMARKS)
    return {
        "case": case, "uncorrected": none["mean"], "21": few["mean"], "70": many["mean"],
        "inside_0": none["inside"], "inside_21": few["inside"], "inside_70": many["inside"],
        "predicted": few["predicted"], "true_rms": few["true_rms"], "methods": means,
    }  # fmt: skip


def _over(found: Sequence[Found]) -> dict[str, float]:
    """Return the means over seeds; of predicted and true errors their root mean square."""
    columns = {name: np.array([asdict(one)[name] for one in found], dtype=float) for name in asdict(found[0])}
    squares = ("predicted", "true_rms")
    return {name: float(np.sqrt(np.mean(own**2)) if name in squares else own.mean()) for name, own in columns.items()}
