"""The simulator of a tool on a still part against first principles, each by another route than its own."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.simulation.example_parts import forearm
from skincal.studies.tool_simulator import (
    LANDMARK_TOUCHES,
    NO_LANDMARK,
    TOOL_RIGS,
    SmoothError,
    random_part_pose,
    simulate_tool_session,
)

MM = 1e-3
IDEAL = TOOL_RIGS["ideal"]


def poked(model=IDEAL, seed=1, counts=(6, 84)):
    scene, surface = forearm().scene, forearm().surface
    return simulate_tool_session(scene, surface.vertices, surface.triangles, model, seed, counts)


def carried(poses, points):
    return np.einsum("...ij,...j->...i", poses[..., :3, :3], points) + poses[..., :3, 3]


def balls(session, radius):
    """Middle of the ball in the part, by the reported poses."""
    part_from_tool = np.linalg.inv(session.base_from_part) @ session.base_from_tool
    return carried(part_from_tool, session.tip - [0.0, 0.0, radius])


def forces(session):
    """Force and moment about the part's origin, by the reported poses."""
    poses = np.linalg.inv(session.base_from_part) @ session.base_from_tool @ session.tool_from_sensor
    force = np.einsum("nij,nj->ni", poses[:, :3, :3], session.wrench[:, :3])
    return force, np.einsum("nij,nj->ni", poses[:, :3, :3], session.wrench[:, 3:]) + np.cross(poses[:, :3, 3], force)


def test_without_errors_each_force_acts_at_the_contact_and_pushes_into_the_part():
    session = poked()
    force, moment = forces(session)
    np.testing.assert_allclose(moment, np.cross(session.contact, force), atol=1e-12)
    outward = balls(session, IDEAL.tip_radius) - session.contact
    assert (np.sum(force * outward, axis=1) < 0).all()


def test_without_errors_the_ball_touches_the_contact():
    session = poked()
    np.testing.assert_allclose(np.linalg.norm(balls(session, 2 * MM) - session.contact, axis=1), 2 * MM, atol=1e-12)


def test_landmarks_come_first_and_are_touched_where_they_are():
    session = poked()
    assert session.landmark[: 6 * LANDMARK_TOUCHES].tolist() == list(range(6)) * LANDMARK_TOUCHES
    assert (session.landmark[6 * LANDMARK_TOUCHES :] == NO_LANDMARK).all()
    known = np.array([each.place for each in forearm().scene.landmarks])
    np.testing.assert_allclose(session.contact[:6], known, atol=1e-12)
    assert len(poked(counts=(0, 20)).landmark) <= 20


def test_the_answering_taxel_lies_below_the_contact():
    session = poked()
    skin = session.landmark == NO_LANDMARK
    best = session.places[session.responses[skin].argmax(axis=1)]
    away = session.contact[skin] - best
    assert np.median(np.linalg.norm(away, axis=1)) < 3 * MM
    # Half a millimetre to a millimetre of compressed foam is left: 2.5 mm less 1.4 to 2.1 mm (3 mm tip, 6 to 12 N).
    outward = balls(session, IDEAL.tip_radius)[skin] - session.contact[skin]
    height = np.sum(away * outward, axis=1) / IDEAL.tip_radius
    assert 0.2 * MM < np.median(height) < 1.3 * MM


@pytest.mark.parametrize(
    ("change", "least", "most"),
    [
        ({"tip": 1 * MM}, 0.1, 3.0),
        ({"pose_noise": 0.3 * MM}, 0.25, 0.35),
        ({"creep": 3 * MM, "delay_s": (0.04, 0.04)}, 0.12 * 1.5, 0.12 * 2.0),
    ],
)
def test_one_error_alone_moves_the_ball_by_its_size(change, least, most):
    session = poked(replace(IDEAL, **change))
    off = np.linalg.norm(balls(session, 2 * MM) - session.contact, axis=1) - 2 * MM
    true = balls(poked(), 2 * MM)
    rms = np.sqrt(np.mean(np.sum((balls(session, 2 * MM) - true) ** 2, axis=1))) / MM
    assert np.abs(off).max() > 0.0
    assert least < rms < most


def test_a_tool_bends_across_its_axis_by_the_force_there():
    session = poked(replace(IDEAL, bend=0.05 * MM, aside=0.2))
    force = forces(poked(replace(IDEAL, aside=0.2)))[0]
    axis = (np.linalg.inv(session.base_from_part) @ session.base_from_tool)[:, :3, 2]
    along = np.sum(force * axis, axis=1)
    across = force - along[:, None] * axis
    # The unbent tool reports the ball farther along the force on the part than it is.
    off = balls(session, 2 * MM) - balls(poked(replace(IDEAL, aside=0.2)), 2 * MM)
    np.testing.assert_allclose(off, 0.05 * MM * across, atol=1e-12)
    assert np.linalg.norm(off, axis=1).max() > 0.1 * MM


def test_a_scale_moves_poses_from_the_base():
    plain, scaled = poked(), poked(replace(IDEAL, scale=0.002))
    ratio = np.linalg.norm(scaled.base_from_tool[:, :3, 3], axis=1) / np.linalg.norm(plain.base_from_tool[:, :3, 3], axis=1)
    assert np.ptp(ratio) < 1e-12
    assert 0.0 < abs(ratio[0] - 1.0) < 0.008


def test_the_smooth_error_has_its_size_and_changes_slowly():
    rng = np.random.default_rng(2)
    poses = np.array([random_part_pose(rng) for _ in range(400)])
    near = poses.copy()
    near[:, :3, 3] += 0.01
    sizes, steps = [], []
    for seed in range(20):
        error = SmoothError(0.5 * MM, np.random.default_rng(seed))
        sizes.append(np.mean(error.at(poses) ** 2) * 3)
        steps.append(np.mean((error.at(near) - error.at(poses)) ** 2) * 3)
    assert np.sqrt(np.mean(sizes)) == pytest.approx(0.5 * MM, rel=0.1)
    # Correlation exp(-r^2/2 l^2) of a smooth field: steps of size sigma r/l, with l = 0.3 m and r = 17 mm.
    assert np.sqrt(np.mean(steps)) == pytest.approx(0.5 * MM * 0.0173 / 0.3, rel=0.15)


def test_parts_lie_in_all_directions_within_reach():
    rng = np.random.default_rng(3)
    poses = np.array([random_part_pose(rng) for _ in range(2000)])
    np.testing.assert_allclose(
        poses[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1), np.tile(np.eye(3), (2000, 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(poses[:, :3, :3]), 1.0)
    assert np.abs(poses[:, :3, :3].mean(axis=0)).max() < 0.05
    far = np.linalg.norm(poses[:, :2, 3], axis=1)
    assert 0.35 <= far.min() < far.max() <= 0.65


def test_a_tools_weight_leaves_a_trace_only_if_the_tool_sways():
    swaying = poked(replace(IDEAL, sway=0.01))
    change = np.linalg.norm(swaying.wrench[:, :3] - poked().wrench[:, :3], axis=1)
    # 0.5 kg turned by 0.01 rad about two axes: 0.049 N in each of two directions.
    assert np.sqrt(np.mean(change**2)) == pytest.approx(0.5 * 9.81 * 0.01 * np.sqrt(2.0), rel=0.2)


def test_equal_seeds_give_equal_sessions_and_others_other_ones():
    one, same, other = poked(TOOL_RIGS["wrist"]), poked(TOOL_RIGS["wrist"]), poked(TOOL_RIGS["wrist"], seed=2)
    assert (one.wrench == same.wrench).all()
    assert (one.base_from_tool == same.base_from_tool).all()
    assert np.linalg.norm(one.base_from_part - other.base_from_part) > 0.01
