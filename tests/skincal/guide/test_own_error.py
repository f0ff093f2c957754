"""What more pokes can make smaller of a predicted error: what taxels share and the part of the mesh are taken off once."""

import numpy as np
import pytest

from skincal.guide.progress import improvable_error
from skincal.taxels.result import Estimate, Method, State

NORMAL = np.array([0.0, 0.0, 1.0])


def estimate(own, moved=None, triangle=None):
    shared = np.zeros((3, 3)) if moved is None else moved @ moved.T
    covariance = np.diag(np.square(own)) + shared
    return Estimate(
        3, Method.MODULES, State.ESTIMATED, 9, position=np.zeros(3), normal=NORMAL, covariance=covariance,
        rms=float(np.sqrt(np.trace(covariance))), triangle=triangle, moved=moved,
    )  # fmt: skip


@pytest.mark.parametrize("moved", [None, np.diag([0.4e-3, 0.0, 0.6e-3]), np.array([[0.0], [0.3e-3], [2e-3]])])
def test_what_is_shared_and_what_is_the_mesh_s_are_taken_off_once(moved):
    own = (1.1e-3, 1.0e-3, 0.7e-3)
    assert improvable_error(estimate(own, moved), 0.0) == pytest.approx(np.linalg.norm(own))
    assert improvable_error(estimate(own, moved, triangle=5), 0.0015) == pytest.approx(np.hypot(own[0], own[1]))


def test_without_a_mesh_the_thickness_of_the_skin_is_taken_off_that_no_poke_sees():
    own = (0.5e-3, 0.4e-3, 2.0e-3)
    assert improvable_error(estimate(own), 0.0015) == pytest.approx(np.sqrt(np.sum(np.square(own)) - 0.0015**2))
    assert improvable_error(estimate(own), 0.003) == pytest.approx(np.hypot(own[0], own[1]))


def test_nothing_known_is_infinite():
    assert improvable_error(Estimate(3, Method.MODULES, State.UNSEEN, 0), 0.0015) == float("inf")
