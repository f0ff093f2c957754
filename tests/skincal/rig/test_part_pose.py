"""The pose of a part from touches of it: truth chosen, touches made by hand, and the answer of another optimiser."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from skincal.mesh.surface import make_surface
from skincal.model.scene import NoiseSettings
from skincal.rig.part_agreement import agreement_with_part
from skincal.rig.part_pose import MISFIT_MIN_RATIO, PartPoseState, fit_part_pose
from skincal.rig.part_touches import LANDMARK_SD_M, PartShape, PartTouches
from skincal.words.part_words import RIVAL_DOUBTED_ABOVE_RATIO, part_pose_sentence
from skincal.words.verdict_words import agreement_words

NOISE = NoiseSettings()
TIP_SD = 0.0003
CORNERS = np.array([[x, y, z] for x in (-0.04, 0.04) for y in (-0.03, 0.03) for z in (0.0, 0.12)])
LANDMARKS = np.array([[0.04, 0.0, 0.01], [-0.03, 0.02, 0.0], [0.0, 0.03, 0.11], [-0.035, -0.01, 0.1], [0.02, -0.03, 0.06]])
TRUE = np.eye(4)
"""link_from_base."""
TRUE[:3, :3] = Rotation.from_rotvec([0.7, -1.9, 0.8]).as_matrix()
TRUE[:3, 3] = [0.2, 0.5, -0.3]


def in_base(points, pose=TRUE):
    return (np.asarray(points) - pose[:3, 3]) @ pose[:3, :3]


def touches(places, *, landmark=None, planned=None, normal=None, push=None, precision=None, module=None):
    """Touches at places of the link."""
    count, nowhere = len(places), np.full((len(places), 3), np.nan)
    return PartTouches(
        np.arange(1, count + 1),
        in_base(places),
        np.tile(np.eye(3) / TIP_SD**2, (count, 1, 1)) if precision is None else precision,
        np.tile([0.0, 0.0, -1.0], (count, 1)) if push is None else push @ TRUE[:3, :3],
        np.tile(np.eye(3), (count, 1, 1)),
        nowhere if landmark is None else landmark,
        nowhere if planned is None else planned,
        nowhere if normal is None else normal,
        np.full(count, -1) if module is None else module,
    )


def shape(surface=None, noise=NOISE, corners=CORNERS):
    return PartShape(surface, corners, noise)


def shaken(rng, marks=LANDMARKS, **more):
    return touches(marks + rng.normal(0.0, np.hypot(LANDMARK_SD_M, TIP_SD), marks.shape), landmark=marks, **more)


def error_of(pose):
    """(6,) of the found motion about its centre: what the pose must turn and shift by to be true."""
    off = TRUE @ np.linalg.inv(pose.link_from_base)
    return np.concatenate([Rotation.from_matrix(off[:3, :3]).as_rotvec(), off[:3, :3] @ pose.centre + off[:3, 3] - pose.centre])


def farthest(pose, corners=CORNERS):
    there = in_base(corners) @ pose.link_from_base[:3, :3].T + pose.link_from_base[:3, 3]
    return float(np.linalg.norm(there - corners, axis=1).max())


def test_exact_landmarks_give_the_pose():
    found = fit_part_pose(touches(LANDMARKS, landmark=LANDMARKS), shape())
    assert found.state is PartPoseState.KNOWN
    np.testing.assert_allclose(found.link_from_base, TRUE, atol=1e-9)
    np.testing.assert_allclose(found.base_from_link, np.linalg.inv(TRUE), atol=1e-9)


def test_landmarks_give_the_pose_that_another_optimiser_finds():
    measured = shaken(np.random.default_rng(1))

    def misses(values):
        turn, shift = Rotation.from_rotvec(values[:3]).as_matrix(), values[3:]
        return ((measured.place @ turn.T + shift - LANDMARKS) / np.hypot(LANDMARK_SD_M, TIP_SD)).ravel()

    truth = np.concatenate([Rotation.from_matrix(TRUE[:3, :3]).as_rotvec(), TRUE[:3, 3]])
    other = least_squares(misses, truth, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    found = fit_part_pose(measured, shape())
    np.testing.assert_allclose(found.link_from_base[:3, :3], Rotation.from_rotvec(other.x[:3]).as_matrix(), atol=2e-4)
    np.testing.assert_allclose(found.link_from_base[:3, 3], other.x[3:], atol=2e-4)


def test_the_covariance_of_landmarks_is_that_of_many_trials():
    errors, covariances = [], []
    for seed in range(150):
        found = fit_part_pose(shaken(np.random.default_rng(seed)), shape())
        errors.append(error_of(found))
        covariances.append(found.covariance / max(1.0, found.ratio) ** 2)
    seen, predicted = np.cov(np.array(errors).T), np.mean(covariances, axis=0)
    # 150 trials give a sd to 6 %.
    np.testing.assert_allclose(np.sqrt(np.diag(seen)), np.sqrt(np.diag(predicted)), rtol=0.2)


def test_held_out_landmarks_are_those_that_a_fit_without_them_predicts():
    marks = np.repeat(LANDMARKS, 2, axis=0)
    measured = shaken(np.random.default_rng(3), marks)
    # The root of the covariance without a factor by the misses, which the held-out ones do not have.
    found, squares, sd = fit_part_pose(measured, shape()), 0.0, np.hypot(LANDMARK_SD_M, TIP_SD)
    for place in LANDMARKS:
        out = np.flatnonzero((marks == place).all(axis=1))
        other = fit_part_pose(measured.rows(np.setdiff1d(np.arange(len(marks)), out)), shape())
        turn, shift = other.link_from_base[:3, :3], other.link_from_base[:3, 3]
        off = (measured.place[out] @ turn.T + shift - place).ravel()
        lever = place - other.centre
        rows = np.concatenate([np.cross(np.eye(3), lever), np.eye(3)], axis=1)
        covariance = np.tile(rows @ other.covariance / max(1.0, other.ratio) ** 2 @ rows.T, (2, 2)) + sd**2 * np.eye(6)
        squares += off @ np.linalg.solve(covariance, off)
    assert found.held_out_ratio == pytest.approx(np.sqrt(squares / 30), rel=0.02)
    assert found.landmark_places == 5


def test_a_landmark_at_a_wrong_place_shows_when_it_is_held_out_also_among_many_other_touches():
    rng, marks = np.random.default_rng(3), np.repeat(LANDMARKS, 3, axis=0)
    places = rng.uniform(CORNERS.min(axis=0), CORNERS.max(axis=0), (120, 3))
    measured = shaken(rng, np.concatenate([marks, places]))
    taxels = np.concatenate([np.full(marks.shape, np.nan), places])
    landmark = np.concatenate([marks, np.full(places.shape, np.nan)])

    def agreement(mark):
        return agreement_with_part(
            fit_part_pose(replace(measured, landmark=mark, planned=taxels, normal=0.0 * taxels), shape())
        )

    assert agreement(landmark).agrees
    landmark[:3] += [0.006, 0.0, -0.004]
    found = agreement(landmark)
    assert not found.agrees
    said = agreement_words(found, has_arm=False)
    assert "each predicted from all other touches" in said
    assert "sensor" not in said, "the rig may have none"


def lines(rng, marks, pushes, sd):
    """Force axes past the marks: points far along each push, and a precision of rank 2."""
    along = rng.uniform(-0.3, 0.3, len(marks))
    off = rng.normal(0.0, sd, marks.shape)
    points = marks + off - pushes * np.sum(off * pushes, axis=1, keepdims=True) + along[:, None] * pushes
    turned = pushes @ TRUE[:3, :3]
    precision = (np.eye(3) - turned[:, :, None] * turned[:, None]) / sd**2
    return touches(points, landmark=marks, push=pushes, precision=precision)


def test_force_axes_at_landmarks_give_the_pose():
    rng = np.random.default_rng(4)
    pushes = rng.normal(size=LANDMARKS.shape)
    pushes /= np.linalg.norm(pushes, axis=1, keepdims=True)
    found = fit_part_pose(lines(rng, LANDMARKS, pushes, 1e-6), shape())
    assert found.state is PartPoseState.KNOWN
    np.testing.assert_allclose(found.link_from_base, TRUE, atol=1e-4)
    errors = []
    for seed in range(30):
        found = fit_part_pose(lines(np.random.default_rng(seed), LANDMARKS, pushes, 0.001), shape())
        errors.append(error_of(found) @ np.linalg.solve(found.covariance, error_of(found)))
    assert 3.0 < np.median(errors) < 8.0  # chi-square with 6 degrees of freedom: 5.3


def box(size):
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * np.array(size) / 2.0
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    triangles = [each for a, b, c, d in faces for each in ([a, b, c], [a, c, d])]
    return make_surface(corners, np.array(triangles))


def cylinder(radius=0.03, height=0.12, sides=48, taper=0.0):
    around = np.arange(sides) * 2.0 * np.pi / sides
    ring = np.stack([np.cos(around), np.sin(around), 0.0 * around], axis=1)
    vertices = np.concatenate([radius * ring, radius * (1.0 + taper) * ring + [0.0, 0.0, height]])
    nxt = (np.arange(sides) + 1) % sides
    low = np.stack([np.arange(sides), nxt, nxt + sides], axis=1)
    high = np.stack([np.arange(sides), nxt + sides, np.arange(sides) + sides], axis=1)
    return make_surface(vertices, np.concatenate([low, high]))


def touch_mesh(rng, surface, count, height=0.001, sd=TIP_SD):
    """Touches all over a mesh, above it by a height."""
    first, second, third = surface.corners.transpose(1, 0, 2)
    areas = np.linalg.norm(np.cross(second - first, third - first), axis=1)
    rows = rng.choice(len(areas), count, p=areas / areas.sum())
    shares = rng.dirichlet([1.0, 1.0, 1.0], count)
    places = np.einsum("nk,nkj->nj", shares, surface.corners[rows])
    normals = surface.normals[rows]
    pushes = -normals + 0.3 * rng.normal(size=normals.shape)
    pushes /= np.linalg.norm(pushes, axis=1, keepdims=True)
    return touches(places + height * normals + rng.normal(0.0, sd, places.shape), push=pushes)


def join(*parts):
    fields = ("number", "place", "precision", "push", "tool_turn", "landmark", "planned", "normal", "module")
    joined = PartTouches(*(np.concatenate([getattr(part, name) for part in parts]) for name in fields))
    return replace(joined, number=np.arange(1, len(joined) + 1))


def wedge():
    """A box with a slanted top: no motion carries it into itself."""
    surface = box([0.08, 0.06, 0.12])
    vertices = surface.vertices.copy()
    vertices[:, 2] += np.where(vertices[:, 2] > 0, 0.5 * vertices[:, 0] + 0.3 * vertices[:, 1], 0.0)
    vertices[:, 0] *= np.where(vertices[:, 1] > 0, 0.7, 1.0)
    return make_surface(vertices, surface.triangles)


@pytest.mark.parametrize("seed", range(6))
def test_a_mesh_alone_gives_the_pose_of_a_part_without_symmetry(seed):
    surface = wedge()
    found = fit_part_pose(touch_mesh(np.random.default_rng(seed), surface, 60), shape(surface, corners=surface.vertices))
    assert found.state is PartPoseState.KNOWN
    assert farthest(found, surface.vertices) < 0.004
    assert error_of(found) @ np.linalg.solve(found.covariance, error_of(found)) < 22.5  # 99.9 % of chi-square, 6


def test_a_box_that_its_mesh_alone_places_has_a_rival():
    surface = box([0.08, 0.06, 0.12])
    found = fit_part_pose(touch_mesh(np.random.default_rng(2), surface, 60), shape(surface, corners=surface.vertices))
    assert found.state is PartPoseState.AMBIGUOUS
    between = found.link_from_base @ np.linalg.inv(found.rival)
    np.testing.assert_allclose(np.degrees(Rotation.from_matrix(between[:3, :3]).magnitude()), 180.0, atol=3.0)


def test_a_landmark_decides_between_the_poses_of_a_box():
    surface = box([0.08, 0.06, 0.12])
    mark = np.array([[0.04, 0.02, 0.05]])
    rng = np.random.default_rng(2)
    marked = touches(mark + rng.normal(0.0, 0.0005, (1, 3)), landmark=mark)
    found = fit_part_pose(join(marked, touch_mesh(rng, surface, 60)), shape(surface, corners=surface.vertices))
    assert found.state is PartPoseState.KNOWN
    assert farthest(found, surface.vertices) < 0.004


def test_a_cylinder_stays_open_along_and_about_its_axis():
    surface = cylinder()
    found = fit_part_pose(touch_mesh(np.random.default_rng(3), surface, 60), shape(surface, corners=surface.vertices))
    assert found.state is PartPoseState.OPEN
    along = [each for each in found.open_motions if each.is_shift]
    turns = [each for each in found.open_motions if not each.is_shift]
    # The axis of the cylinder is z of the link, up to the turn that is open.
    assert any(abs(each.shift[2]) > 0.99 * np.linalg.norm(each.shift) for each in along)
    assert any(abs(each.turn[2]) > 0.99 * np.linalg.norm(each.turn) for each in turns)


def test_two_landmarks_close_a_cylinder():
    surface = cylinder()
    marks = np.array([[0.03, 0.0, 0.1], [0.0, 0.03, 0.02]])
    rng = np.random.default_rng(5)
    marked = touches(marks + rng.normal(0.0, 0.0005, marks.shape), landmark=marks)
    found = fit_part_pose(join(marked, touch_mesh(rng, surface, 40)), shape(surface, corners=surface.vertices))
    assert found.state is PartPoseState.KNOWN
    assert farthest(found, surface.vertices) < 0.004


def taxels_of(surface, rng, count):
    made = touch_mesh(rng, surface, count, height=0.0, sd=0.0)
    return made.place @ TRUE[:3, :3].T + TRUE[:3, 3], -made.push @ TRUE[:3, :3].T


def test_the_layout_gives_the_pose_to_the_error_of_its_plan():
    surface = cylinder(taper=0.3)
    misses, squares = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        planned, normal = taxels_of(surface, rng, 40)
        laid = planned + rng.normal(0.0, 0.008, 3) + rng.normal(0.0, NOISE.contact, planned.shape)
        made = touches(laid, planned=planned, normal=normal, push=-normal, module=np.zeros(40, np.int64))
        found = fit_part_pose(made, shape(corners=CORNERS))
        error = error_of(found)
        misses.append(np.linalg.norm(error[3:]))
        squares.append(error @ np.linalg.solve(found.covariance, error))
    assert 0.004 < np.mean(misses) < 0.03
    assert 2.0 < np.median(squares) < 9.0


def test_a_wrongly_named_landmark_is_named():
    marks = LANDMARKS.copy()
    marks[[0, 3]] = marks[[3, 0]]
    found = fit_part_pose(touches(LANDMARKS, landmark=marks), shape())
    assert found.state is PartPoseState.DISAGREES
    assert found.worst_miss > 0.01


def test_few_touches_give_no_pose():
    found = fit_part_pose(touches(LANDMARKS[:2], landmark=LANDMARKS[:2]), shape())
    assert found.state is PartPoseState.FEW_TOUCHES
    assert (found.landmarks, found.taxels, found.points) == (2, 0, 0)


def test_landmarks_on_a_line_leave_a_turn_open():
    marks = np.array([[0.04, 0.0, z] for z in (0.0, 0.03, 0.06, 0.12)])
    found = fit_part_pose(touches(marks, landmark=marks), shape())
    assert found.state is PartPoseState.OPEN
    first = found.open_motions[0]
    assert not first.is_shift or np.linalg.norm(first.turn) > 0.1
    assert abs(first.turn[2]) > 0.99 * np.linalg.norm(first.turn)


def test_another_base_changes_the_pose_by_its_motion_alone():
    rng = np.random.default_rng(8)
    made = join(shaken(rng), touch_mesh(rng, wedge(), 20))
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = Rotation.from_rotvec([0.4, 0.2, -2.0]).as_matrix(), [1.0, -2.0, 0.5]
    turn = motion[:3, :3]
    moved = replace(
        made,
        place=made.place @ turn.T + motion[:3, 3],
        push=made.push @ turn.T,
        precision=turn @ made.precision @ turn.T,
        tool_turn=turn @ made.tool_turn,
    )
    one, other = (fit_part_pose(each, shape(wedge())) for each in (made, moved))
    np.testing.assert_allclose(other.link_from_base @ motion, one.link_from_base, atol=1e-7)
    np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-4, atol=1e-12)
    again = fit_part_pose(made, shape(wedge()))
    assert again.link_from_base.tobytes() == one.link_from_base.tobytes()


def with_wrong_tip(off, count=3, seed=1):
    """Touches of landmarks by a tool that leans, with a tip that lies `off` (3,) metres from the given one."""
    rng, marks = np.random.default_rng(seed), LANDMARKS[:count]
    turns = Rotation.from_rotvec(rng.uniform(-0.6, 0.6, (count, 3))).as_matrix()
    made = shaken(rng, marks)
    return fit_part_pose(
        replace(made, place=made.place + turns @ off, tool_turn=turns, landmark=marks),
        PartShape(None, CORNERS, NOISE, 0.001**2 * np.eye(3)),
    )


def test_a_wrong_tip_at_three_landmarks_is_no_part_that_lies_elsewhere():
    """One landmark more would not decide between poses: the sentence names the causes, and the test that finds the tip."""
    found = with_wrong_tip(np.array([0.0, 0.01, 0.04]))
    assert found.state is not PartPoseState.FEW_TOUCHES
    assert found.ratio > MISFIT_MIN_RATIO
    turned = TRUE @ np.diag([-1.0, -1.0, 1.0, 1.0])
    for state in (PartPoseState.KNOWN, PartPoseState.OPEN, PartPoseState.AMBIGUOUS):
        said = part_pose_sentence(replace(found, state=state, rival=turned))
        assert "miss by" in said
        assert "The cause may be the tip" in said
        assert "`skincal tool`" in said
        assert "touch one landmark" not in said
    right = with_wrong_tip(np.zeros(3))
    assert right.ratio < RIVAL_DOUBTED_ABOVE_RATIO
    assert "fits as well turned by" in part_pose_sentence(replace(right, state=PartPoseState.AMBIGUOUS, rival=turned))
    assert "miss by" not in part_pose_sentence(right)
