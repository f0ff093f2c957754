"""Pads that lie off the plan of their modules: the likelihood, what is found, and that the advice is right."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from skincal.guide.plan_check import COMMON_SD_M, MODULE_MOTION_SD_M, ModuleMisses, log_likelihood
from skincal.guide.verdict import Check, check, is_believed
from skincal.mesh.surface import make_surface
from skincal.methods import estimate_taxels
from skincal.modules.pose import ModuleModel
from skincal.rig.correction_fit import LandmarkAgreement
from skincal.session.snapshot import snapshot_of
from skincal.simulation.example_parts import forearm
from skincal.studies.error_numbers import error_numbers
from skincal.studies.independent_simulator import NOISY_RIG, simulate_session
from skincal.taxels.result import Method
from skincal.words.verdict_words import off_plan_sentence
from tests.approved import approved


def test_the_likelihood_is_that_of_a_normal_distribution_of_all_misses(rng):
    motions = [rng.normal(size=(6, 3)) for _ in range(3)]
    slopes = [1e3 * rng.normal(size=(rows, 6)) for rows in (5, 8, 11)]
    sides = [rng.normal(size=len(each)) for each in slopes]

    def by_sums(pad_sd, noise):
        pairs = zip(motions, slopes, sides, strict=True)
        return log_likelihood([ModuleMisses(r, a.T @ a, a.T @ b, b @ b, len(b)) for r, a, b in pairs], pad_sd, noise)

    def by_definition(pad_sd, noise):
        whole = np.concatenate(slopes)
        covariance = COMMON_SD_M**2 * whole @ whole.T + noise**2 * np.eye(len(whole))
        at = 0
        for r, a in zip(motions, slopes, strict=True):
            own = slice(at, at + len(a))
            covariance[own, own] += a @ (pad_sd**2 * np.eye(6) + MODULE_MOTION_SD_M**2 * r @ r.T) @ a.T
            at += len(a)
        return multivariate_normal(cov=covariance).logpdf(np.concatenate(sides))

    for pad_sd, noise in ((0.0, 0.7), (0.001, 1.0), (0.002, 1.3)):
        found = by_sums(pad_sd, noise) - by_sums(0.0, 1.0)
        assert found == pytest.approx(by_definition(pad_sd, noise) - by_definition(0.0, 1.0), rel=1e-9)


@cache
def judged(pads, seed):
    """Checks and error numbers of a rig that is only noisy, by method; `pads` is the sd of their distance from the plan, m."""
    scene, true = forearm().scene, forearm().surface
    poked = simulate_session(scene, true.vertices, true.triangles, replace(NOISY_RIG, pads=pads), seed)
    surface, channels = make_surface(poked.vertices, true.triangles), poked.channels.tolist()
    model = ModuleModel(scene.skin.layout, scene.skin.anchor, surface)
    found = estimate_taxels(poked.contacts, channels, tuple(Method), scene.noise, surface, model=model)
    own = {method: list(by_channel.values()) for method, by_channel in found.items()}
    moment = snapshot_of(poked.contacts, own)
    return {
        method: (check(moment, channels, method, scene.noise, surface, model),
                 error_numbers(estimates, poked.places))
        for method, estimates in own.items()
    }  # fmt: skip


SEEDS = range(301, 305)


def test_pads_off_their_plan_are_found_and_the_surface_method_is_right_as_said():
    landmarks = LandmarkAgreement(ratio=1.0, pokes=21, corrected=False)
    found = [judged(0.001, seed) for seed in SEEDS]
    off = [each[Method.MODULES][0].off_plan for each in found]
    assert sum(size is not None for size in off) >= 3
    assert all(size is None or 0.0006 <= size <= 0.0016 for size in off)
    for each in found:
        tried, errors = each[Method.MODULES]
        assert errors["inside"] < 0.8, "the prediction of the modules method is wrong"
        assert tried.off_plan is None or not is_believed(tried, landmarks)
        # The sentence says to use this method.
        assert each[Method.SURFACE][0].off_plan is None
        assert each[Method.SURFACE][1]["inside"] >= 0.85
    assert off_plan_sentence(0.001) == approved("verdict.off_plan", off_mm="1.0")


def test_pads_on_their_plan_are_not_doubted():
    assert [judged(0.0, seed)[Method.MODULES][0].off_plan for seed in SEEDS] == [None] * len(SEEDS)


def test_a_check_with_pads_off_their_plan_does_not_agree():
    assert Check(60, 58).agrees
    assert not Check(60, 58, off_plan=0.001).agrees
