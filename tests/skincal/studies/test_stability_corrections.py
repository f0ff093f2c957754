"""The stability study of corrections, covariances, heights and distances: it holds, and it can fail."""

from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest

from skincal.modules import distances, estimate, off_surface
from skincal.modules.off_surface import ModuleErrors
from skincal.rig import correction, correction_fit
from skincal.studies.stability import added_cases, evaluate_added, find_added_truth
from skincal.studies.stability_cases import CaseSizes
from skincal.studies.stability_corrections import CorrectionInputs, correct_by_landmarks
from skincal.studies.stability_distances import shipped_distances

TINY = CaseSizes(contacts=8, grid=6, many=300)


@cache
def cases():
    return {case.name: case for case in added_cases(TINY)}


@cache
def truth_of(name):
    """The program's constants do not count in it."""
    return find_added_truth(cases()[name], 2, np.random.default_rng(1))


def judged(name):
    records = evaluate_added(cases()[name], truth_of(name))
    return {record["name"].rpartition(": ")[2]: record for record in records}


FEW = "correction, four landmarks, two pokes each"
MODULE, SHEET = "module, shared errors", "module on a sheet, arm poses that are not known"
HEIGHT, DISTANCES = "module 4 mm over its sheet", "distances between three modules known to 1e-6 m"
STIFF = "distances between three modules, pushes within 0.02 rad"


@pytest.mark.parametrize("name", [FEW, SHEET, HEIGHT, DISTANCES, STIFF, "distances between three modules"])
def test_the_programs_additions_hold(name):
    found = judged(name)
    assert ("height" in found) is (name == HEIGHT)
    for record in found.values():
        assert record["holds"], record
        assert record["bound"] < 1e-6 * record["size"], "a tolerance that proves something"


def test_corrections_are_of_a_linear_sensor_of_another_and_of_both():
    own = {name: case.inputs for name, case in cases().items() if isinstance(case.inputs, CorrectionInputs)}
    answers = {name: correct_by_landmarks(pokes) for name, pokes in own.items()}
    assert len(answers["correction, rig as modelled"].unknowns) == 36 + 12
    assert len(answers["correction, sensor not linear"].unknowns) == 162 + 12
    assert len(own) >= 8
    assert all(min(answer.trust.values()) == 1.0 for answer in answers.values())


def test_distances_count():
    joined = cases()[DISTANCES].inputs
    with pytest.raises(ValueError, match="do not all count"):
        shipped_distances(replace(joined, distances=(replace(joined.distances[0], length=1.0), *joined.distances[1:])))


def test_covariances_under_distances_have_all_their_digits():
    found = judged(STIFF)
    assert max(record["error_over_bound"] for record in found.values()) < 0.3


def test_a_covariance_that_is_not_symmetric_is_caught():
    case = cases()[STIFF]
    skew = np.triu(np.ones((6, 6)), 1) - np.tril(np.ones((6, 6)), -1)
    fitted = tuple(replace(own, covariance=own.covariance * (1.0 + 1e-12 * skew)) for own in case.inputs.fitted)
    bent = replace(case, inputs=replace(case.inputs, fitted=fitted))
    exact = find_added_truth(bent, 1, np.random.default_rng(1))
    found = {record["name"].rpartition(": ")[2]: record for record in evaluate_added(bent, exact)}
    assert not found["covariances"]["holds"]


def test_a_step_too_few_is_caught(monkeypatch):
    monkeypatch.setattr(correction_fit, "GAUSS_NEWTON_STEPS", 3)
    assert not judged(FEW)["unknowns"]["holds"]
    monkeypatch.setattr(distances, "GAUSS_NEWTON_STEPS", 2)
    assert not judged(DISTANCES)["places"]["holds"]


@pytest.mark.parametrize(("name", "parts"), [(MODULE, ["shared", "covariances"]), (HEIGHT, ["covariances"])])
def test_a_covariance_of_half_the_digits_is_caught(monkeypatch, name, parts):
    exactly = estimate.spread_over_modules

    def rounded(*asked, **options):
        found = exactly(*asked, **options)
        return ModuleErrors(*(getattr(found, each.name).astype(np.float32).astype(float) for each in fields(found)))

    monkeypatch.setattr(estimate, "spread_over_modules", rounded)
    found = judged(name)
    assert [found[part]["holds"] for part in parts] == [False] * len(parts)


def test_a_formula_that_is_another_is_caught(monkeypatch):
    monkeypatch.setattr(off_surface, "SIGNIFICANT_HEIGHT_MIN_SDS", 50.0)
    assert not judged(HEIGHT)["height"]["holds"]
    monkeypatch.setattr(correction, "_right_jacobians", lambda turns: np.tile(np.eye(3), (len(turns), 1, 1)))
    assert not judged(FEW)["unknowns"]["holds"]
