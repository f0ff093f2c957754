"""The turn of a module's plan that estimates place: its error follows from theirs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skincal.axes.axis_results import fit_plan, place_plan
from skincal.axes.module_axes import PUSH_TOLERANCE
from skincal.axes.turn_fit import AxisPokes
from skincal.geometry import rotation_by, rotation_vector
from skincal.model.scene import load_scene, scene_file
from skincal.taxels.result import Estimate, Method, State

SD_M = 0.0004
OWN_POKES, ONE_POKE = (
    {channel: AxisPokes(np.ones((1, 3)), np.ones((1, 3)), np.array([poke])) for channel, poke in enumerate(pokes)}
    for pokes in (range(100), np.zeros(100, dtype=int))
)


@pytest.fixture(scope="module")
def placed():
    """A module, its true turn, and exact estimates of its taxels by channel."""
    layout = load_scene(scene_file(Path("three-axis-pad"))).skin.layout
    module, turn = layout.modules[0], rotation_by(np.array([0.4, -0.7, 1.1]))
    flat = np.column_stack([module.kind.pads, np.zeros(len(module.kind.pads))])
    estimates = {
        channel: Estimate(channel, Method.FREE, State.TOUCHED, 1, place, turn[:, 2], SD_M**2 * np.eye(3), normal_sd=0.0)
        for channel, place in zip(module.channels.tolist(), flat @ turn.T, strict=True)
    }
    return module, turn, estimates


def shifted(module, estimates, shifts):
    """Fit the rotation with shifted estimates."""
    moved = zip(estimates.values(), shifts, strict=True)
    return fit_plan(module, {each.channel: (each.position + shift, each.normal) for each, shift in moved})[0]


def test_exact_estimates_place_the_plan(placed):
    module, turn, estimates = placed
    assert place_plan(module, estimates, OWN_POKES).rotation == pytest.approx(turn, abs=1e-12)


def test_errors_of_their_own_have_the_predicted_size(placed):
    """Taxels that a poke presses together may have alike errors: then the prediction grows by the root of their number."""
    module, turn, estimates = placed
    rng = np.random.default_rng(0)
    turns = [
        rotation_vector(shifted(module, estimates, SD_M * rng.normal(size=(len(estimates), 3))) @ turn.T) for _ in range(400)
    ]
    found = np.sqrt(np.diag(place_plan(module, estimates, OWN_POKES).covariance))
    assert np.std(turns, axis=0) == pytest.approx(found, rel=0.1)
    together = np.sqrt(np.diag(place_plan(module, estimates, ONE_POKE).covariance))
    assert together == pytest.approx(found * np.sqrt(len(estimates)), rel=1e-9)
    by_pose = {channel: replace(each, method=Method.MODULES) for channel, each in estimates.items()}
    assert np.sqrt(np.diag(place_plan(module, by_pose, OWN_POKES).covariance)) == pytest.approx(together, rel=1e-9)


def test_the_error_that_all_taxels_share_is_exact(placed):
    """One shared error turns the skin by its positions, another one shifts it and turns nothing."""
    module, turn, estimates = placed
    about = np.array([3e-3, -1e-3, 2e-3])
    common = np.array([0.004, 0.001, -0.002])
    every = {
        channel: replace(each, moved=(moved := np.stack([np.cross(about, each.position), common], axis=1)),
                         covariance=moved @ moved.T)
        for channel, each in estimates.items()
    }  # fmt: skip
    turned = rotation_vector(shifted(module, estimates, [each.moved[:, 0] for each in every.values()]) @ turn.T)
    assert place_plan(module, every, OWN_POKES).covariance == pytest.approx(
        np.outer(turned, turned), abs=1e-3 * turned @ turned
    )


def test_the_error_of_normals_leans_the_plan(placed):
    module, _, estimates = placed
    every = {channel: replace(each, covariance=np.zeros((3, 3)), normal_sd=0.1) for channel, each in estimates.items()}
    plan = place_plan(module, every, OWN_POKES)
    in_plan = plan.rotation.T @ plan.covariance @ plan.rotation
    # The taxels hold the plane, too: the normal counts by its share.
    assert 0.0 < in_plan[0, 0] < 0.1**2
    assert 0.0 < in_plan[1, 1] < 0.1**2
    assert in_plan[2, 2] == pytest.approx(0.0, abs=1e-12)


def test_a_normal_by_pushes_is_as_uncertain_as_pokes_lean(placed):
    """The free method has no error of its normal; another method has the normal of a pose or a triangle."""
    module, _, estimates = placed

    def covariance(normal_sd, method):
        every = {channel: replace(each, normal_sd=normal_sd, method=method) for channel, each in estimates.items()}
        return place_plan(module, every, OWN_POKES).covariance

    unknown = covariance(None, Method.FREE)
    assert unknown == pytest.approx(covariance(PUSH_TOLERANCE, Method.FREE))
    assert np.trace(unknown) > 2.0 * np.trace(covariance(0.0, Method.FREE))
    assert covariance(None, Method.MODULES) == pytest.approx(covariance(0.0, Method.MODULES))
