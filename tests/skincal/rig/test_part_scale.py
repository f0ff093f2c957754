"""The scale of a part's drawing from touches of it: truth chosen, and the answer of another optimiser."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from skincal.mesh.surface import make_surface
from skincal.rig.part_pose import fit_part_pose, start_at
from skincal.rig.part_scale import WRONG_LANDMARKS_PROBABILITY, DrawnThing, find_landmarks_off_mesh, find_scales
from skincal.rig.part_touches import LANDMARK_SD_M
from skincal.words.part_words import landmarks_off_mesh_sentence, wrong_scale_sentence
from tests.skincal.rig.test_part_pose import LANDMARKS, TIP_SD, TRUE, join, shaken, shape, touch_mesh, touches, wedge

MARKS = np.repeat(LANDMARKS, 3, axis=0)
SD = np.hypot(LANDMARK_SD_M, TIP_SD)


def drawn(seed, excess):
    """Touches of landmarks, in a drawing that is larger by `excess`."""
    measured = shaken(np.random.default_rng(seed), MARKS)
    return replace(measured, landmark=MARKS * (1.0 + excess))


def fitted(measured, surface=None):
    corners = {} if surface is None else {"corners": surface.vertices}
    return fit_part_pose(measured, shape(surface, **corners), start_at(TRUE))


def test_the_scale_is_that_which_another_optimiser_finds():
    measured = drawn(1, 0.03)

    def misses(values):
        turn = Rotation.from_rotvec(values[:3]).as_matrix()
        true = measured.landmark * (1.0 - values[6])
        return ((measured.place @ turn.T + values[3:6] - true) / SD).ravel()

    truth = np.concatenate([Rotation.from_matrix(TRUE[:3, :3]).as_rotvec(), TRUE[:3, 3], [0.03]])
    other = least_squares(misses, truth, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    sd = np.sqrt(np.linalg.inv(other.jac.T @ other.jac)[6, 6])
    found = fitted(measured).wrong_scale
    assert found.thing is DrawnThing.LANDMARKS
    # Large misses count less: Huber's weights of a right drawing.
    assert found.excess == pytest.approx(other.x[6], rel=0.1)
    assert found.sd == pytest.approx(sd, rel=0.3), "a misfit widens it"
    said = wrong_scale_sentence(found)
    assert f"the landmarks lie {found.excess:.1%} too far apart" in said
    assert f"{1.0 - found.excess:.3f} of the drawn length" in said
    assert "mesh" not in said, "the scene has none"


def test_right_drawings_are_not_doubted_and_their_predicted_errors_hardly_grow():
    named, grown = 0, []
    for seed in range(100):
        found = fitted(drawn(seed, 0.0))
        named += found.wrong_scale is not None
        grown.append(np.trace(found.scales.moment[3:6, 3:6]) / np.trace(found.with_tip[3:6, 3:6]))
    assert named <= 2
    assert np.median(grown) < 1.1


@pytest.mark.parametrize("excess", [-0.03, 0.005, 0.012, 0.03])
def test_the_predicted_error_contains_the_scale_whether_it_is_named_or_not(excess):
    squares = []
    for seed in range(40):
        found = fitted(drawn(seed, excess))
        off = TRUE @ np.linalg.inv(found.link_from_base)
        error = off[:3, :3] @ found.centre + off[:3, 3] - found.centre
        squares.append(error @ np.linalg.solve(found.scales.moment[3:6, 3:6], error))
    # 95 % of chi-square with three degrees of freedom: 7.8. Without the scale 3 % have a median of 80.
    assert np.median(squares) < 7.8


def test_the_error_of_the_pose_follows_that_of_the_scale():
    def shift_error(found):
        off = TRUE @ np.linalg.inv(found.link_from_base)
        return off[:3, :3] @ found.centre + off[:3, 3] - found.centre

    large, small = fitted(drawn(5, 0.02)), fitted(drawn(5, -0.02))
    moment = fitted(drawn(5, 0.0)).scales.moment
    by_scale = moment[3:6, 9] / moment[9, 9]
    assert np.linalg.norm(by_scale) > 0.02, "m: some of the landmarks' middle is far from the link's origin"
    np.testing.assert_allclose(by_scale, (shift_error(large) - shift_error(small)) / 0.04, atol=0.002)


def scales_of(size, excess, *, misfit=0.0, counts=(6, 0)):
    """Equations that tell each of the four errors with the weight `size`, and give it the value `excess`."""
    normal, gradient = np.eye(14), np.zeros(14)
    normal[10:, 10:] = np.diag(size)
    gradient[10:] = -np.array(size) * excess
    return find_scales(normal, gradient, (misfit, 100), counts)


@pytest.mark.parametrize(("sd", "excess"), [(0.01, 0.0), (0.01, 0.02), (0.02, -0.05), (0.04, 0.03)])
def test_the_second_moment_of_a_scale_is_that_of_its_posterior(sd, excess):
    """Against an integral over a grid: e is 0, or with a small probability from a normal distribution."""
    grid = np.linspace(-0.5, 0.5, 200_001)
    step, spread = grid[1] - grid[0], 0.03
    likelihood = np.exp(-0.5 * ((excess - grid) / sd) ** 2)
    drawn_wrong = WRONG_LANDMARKS_PROBABILITY * np.exp(-0.5 * (grid / spread) ** 2) / (spread * np.sqrt(2 * np.pi)) * likelihood
    right = np.exp(-0.5 * (excess / sd) ** 2)
    expected = np.sum(drawn_wrong * grid**2) * step / (right + np.sum(drawn_wrong) * step)
    assert scales_of([sd**-2.0] + [1.0] * 3, excess).moment[9, 9] == pytest.approx(expected, rel=1e-6)


def test_a_scale_is_named_with_all_that_fit_as_well_unless_the_touches_miss_by_more():
    size, both = [1e4, 2e4, 1e6, 1e4], (6, 80)
    found = scales_of(size, 0.05, counts=both).wrong
    assert found.thing is DrawnThing.DRAWING, "it has all of their evidence"
    assert {other for other, _ in found.others} == set(), "the next, the mesh, has 25 less"
    assert scales_of([1.0, 1e6, 1.0, 1.0], 0.05, counts=both).wrong.others, "width and mesh are one there"
    alone = {"size": [1e4] + [1.0] * 3, "excess": 0.06}
    assert scales_of(**alone).wrong.thing is DrawnThing.LANDMARKS
    assert scales_of(**alone, misfit=900.0).wrong is None, "something else is wrong, too"


def test_a_mesh_that_is_too_wide_is_named_with_what_looks_alike():
    surface, rng = wedge(), np.random.default_rng(3)
    measured = join(shaken(rng, MARKS), touch_mesh(rng, surface, 80))
    assert fitted(measured, surface).wrong_scale is None
    wide = make_surface(surface.vertices * [1.06, 1.0, 1.0], surface.triangles)
    found = fitted(measured, wide).wrong_scale
    likely = {found.thing: found.excess, **dict(found.others)}
    assert likely[DrawnThing.MESH_X] == pytest.approx(0.06, abs=0.02)
    assert "too wide along x" in wrong_scale_sentence(found)


def test_a_mesh_that_is_too_large_to_all_sides_is_in_the_predicted_errors():
    surface = wedge()
    marks = surface.vertices * 0.999
    assert find_landmarks_off_mesh(marks, surface) == 0.0
    large = make_surface(surface.vertices * 1.03, surface.triangles)
    near = np.array([[0.0, -0.03, 0.0], [0.0, 0.03, 0.0], [0.04, -0.03, 0.0], [-0.04, -0.03, 0.0], [0.0, 0.0, -0.06]])
    depth = find_landmarks_off_mesh(near, large)
    assert -0.0015 < depth < -0.0006
    assert f"lie {-depth * 1e3:.1f} mm inside its mesh" in landmarks_off_mesh_sentence(depth)
    found, normal = fitted(join(shaken(np.random.default_rng(2), MARKS)), None), np.array([[0.0, 0.0, 1.0]])
    found = replace(found, scales=replace(found.scales, landmarks_off_mesh=depth))
    without = replace(found, scales=replace(found.scales, landmarks_off_mesh=0.0))
    at, turns = np.array([[0.01, 0.0, 0.05]]), np.eye(3)[None]
    squares = [np.sum(each.error_shifts(at, turns, normal) ** 2) for each in (found, without)]
    assert squares[0] - squares[1] == pytest.approx(depth**2)
    bound, free = (np.sum(found.error_shifts(at, turns, way) ** 2) for way in (normal, 0.0 * normal))
    assert bound > free


def test_landmarks_far_from_the_mesh_are_not_on_it():
    surface = wedge()
    assert find_landmarks_off_mesh(surface.vertices * 1.2, surface) == 0.0
    assert find_landmarks_off_mesh(surface.vertices[:2] * 1.01, surface) == 0.0, "two say little"


def test_the_same_touches_give_the_same_scale_and_touches_without_landmarks_none():
    measured = drawn(5, 0.03)
    one, again = fitted(measured), fitted(measured)
    assert one.scales.moment.tobytes() == again.scales.moment.tobytes()
    assert fitted(touches(LANDMARKS)).wrong_scale is None
