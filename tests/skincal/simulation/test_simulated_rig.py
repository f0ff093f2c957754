from dataclasses import replace

import numpy as np
import pytest

from skincal.geometry import axis_point, move_wrench, pitch
from skincal.mesh.lay import place_layout
from skincal.mesh.search import nearest_points
from skincal.model.errors import InputError
from skincal.model.skin import Anchor
from skincal.simulation.contacts import simulate_contacts, unguided
from skincal.simulation.operator import Habits, presses_at, unguided_presses
from skincal.simulation.rig_errors import RigErrors, WrenchNoise
from skincal.simulation.simulated_rig import Foam, Rig, answer, felt_share
from tests.approved import approved_pattern
from tests.skincal.sim_support import make_rig, scene_and_surface

POSES = tuple("1234567")


def plane_rig(errors, seed):
    """The forearm's scene with its skin laid in a plane: quick to make."""
    return Rig(scene_and_surface()[0], None, errors, np.random.default_rng(seed))


@pytest.mark.parametrize("pose", POSES)
def test_noiseless_contacts_are_pure_forces_whose_axes_pass_through_the_contact(pose, rng):
    rig = make_rig(RigErrors.none())
    pokes = unguided(rig, 1, rng)
    contacts = simulate_contacts(rig, pokes, rng, pose)
    assert len(contacts) > 80
    for contact in contacts:
        poke = contact.poke - 1
        assert abs(pitch(contact.force, contact.moment)) < 1e-15
        force, moment = move_wrench(contact.link_from_sensor, contact.force, contact.moment)
        np.testing.assert_allclose(force, pokes.forces[poke] * pokes.directions[poke], atol=1e-12)
        point = axis_point(force, moment)
        gap = np.cross(pokes.points[poke] - point, pokes.directions[poke])
        assert np.linalg.norm(gap) < 1e-12


def test_sensor_moment_is_lever_times_force_by_hand():
    # The flat patch: the sensor 45 mm below, axes parallel. A push straight down at (10, -5, 0) mm.
    rig = make_rig(RigErrors.none(), name="flat-patch")
    wrench = rig.true_wrenches(np.array([[0.010, -0.005, 0.0]]), np.array([[0.0, 0.0, -10.0]]), rig.arm_pose())
    # c = (0.010, -0.005, 0.045); c x f = (cy fz, -cx fz, 0).
    np.testing.assert_allclose(wrench, [[0, 0, -10, 0.05, 0.1, 0]], atol=1e-15)


def test_unguided_pushes_are_uniform_in_the_cone_and_point_inward(rng):
    rig = make_rig(RigErrors.none())
    pokes = unguided_presses(rig, np.tile(rig.channels, 60), Habits(), rng)
    cosines = -np.sum(pokes.directions * pokes.normals, axis=1)
    floor = np.cos(np.radians(30.0))
    assert cosines.min() >= floor - 1e-12
    # Uniform in solid angle is uniform in the cosine: Kolmogorov-Smirnov distance of 5,040 draws.
    shares = np.sort((cosines - floor) / (1 - floor))
    distance = np.abs(shares - (np.arange(len(shares)) + 0.5) / len(shares)).max()
    assert distance < 1.95 / np.sqrt(len(shares))
    np.testing.assert_allclose(np.linalg.norm(pokes.directions, axis=1), 1.0, atol=1e-12)


def test_pokes_lie_on_the_surface_beside_their_taxels(rng):
    rig = make_rig(RigErrors.none())
    pokes = unguided_presses(rig, np.tile(rig.channels, 20), Habits(), rng)
    assert rig.surface is not None
    nearest, _ = nearest_points(rig.surface, pokes.points)
    assert np.linalg.norm(nearest - pokes.points, axis=1).max() < 1e-9
    rows = [rig.row_of(int(c)) for c in pokes.targets]
    beside = np.linalg.norm(pokes.points - rig.places[rows], axis=1)
    # Two directions of 2 mm each: root mean square 2.83 mm.
    assert np.sqrt(np.mean(beside**2)) == pytest.approx(0.002 * np.sqrt(2), rel=0.1)


@pytest.mark.parametrize("name", ["icub-forearm", "flat-patch"])
def test_about_three_taxels_answer_a_poke(name, rng):
    rig = make_rig(RigErrors.noise(), name=name)
    contacts = simulate_contacts(rig, unguided(rig, 12, rng), rng)
    counts = [len(contact.channels) for contact in contacts]
    assert 2.5 < np.mean(counts) < 4.0
    assert len(contacts) > 0.99 * 12 * len(rig.channels)


def test_answers_fall_off_smoothly_with_distance():
    foam = Foam()
    x = np.linspace(0.0, 0.012, 241)
    offsets = np.stack([x, 0 * x, 0 * x], axis=1)[None]
    share = felt_share(foam, offsets, np.array([[1.0, 0, 0]]), np.array([[0, 1.0, 0]]))[0]
    assert share[0] == pytest.approx(1.0)
    assert (np.diff(share) < 0).all()
    assert np.abs(np.diff(share, 2)).max() < 0.002  # no corner: 0.05 mm steps
    assert share[np.searchsorted(x, 0.002)] > 0.5 > share[np.searchsorted(x, 0.004)]
    far = felt_share(foam, np.array([[[0.0, 0.0, 0.06]]]), np.array([[1.0, 0, 0]]), np.array([[0, 1.0, 0]]))
    assert far.item() == 0.0  # the other side of the arm


def test_answers_rise_with_force_and_saturate_mildly():
    foam = Foam()
    soft, hard = answer(foam, np.array([0.5, 1.0]), np.array(0.5))
    assert hard / soft == pytest.approx(2.0, rel=0.05)  # proportional where soft
    middle, double = answer(foam, np.array([6.0, 12.0]), np.array(1.0))
    assert 1.2 < double / middle < 1.8
    assert answer(foam, np.array(-3.0), np.array(1.0)) == 0.0


def test_raw_values_fall_under_pressure_and_are_whole_bytes(rng):
    rig = make_rig(RigErrors.noise())
    poke = presses_at(rig, rig.channels[:1], np.zeros((1, 2)), np.zeros((1, 2)), np.array([9.0]), rng)
    rows, values = rig.answers(poke, poke.forces)
    answers = np.zeros((200, len(rig.channels)))
    answers[100:, rows[0]] = values[0]
    frames = rig.skin_frame(answers, rng)
    assert frames.shape == (200, 384)
    np.testing.assert_array_equal(frames, np.rint(frames))
    assert frames.min() >= 0
    assert frames.max() <= 255
    quiet = frames[:100][:, rig.channels]
    assert quiet.mean() == pytest.approx(240, abs=1.5)
    # One count of noise and the rounding: sqrt(1 + 1/12).
    assert quiet.std(axis=0).mean() == pytest.approx(1.04, abs=0.06)
    assert quiet.mean(axis=0).std() > 1.5  # baselines differ
    assert frames[100:, rig.channels[0]].mean() < quiet[:, 0].mean() - 60


def test_values_rise_where_the_scene_says_up(rng):
    rig = make_rig(RigErrors.none(), name="flat-patch")
    poke = presses_at(rig, rig.channels[:1], np.zeros((1, 2)), np.zeros((1, 2)), np.array([9.0]), rng)
    rows, values = rig.answers(poke, poke.forces)
    answers = np.zeros((1, len(rig.channels)))
    answers[0, rows[0]] = values[0]
    frame = rig.skin_frame(answers, rng)[0]
    assert frame[0] > 1500
    assert np.median(frame) == pytest.approx(4095 * 15 / 255, abs=1)
    assert frame.max() <= 4095


def test_truth_is_the_plan_displaced_as_a_patch():
    scene, surface = scene_and_surface()
    laid = place_layout(scene.skin.layout, scene.skin.anchor, surface)
    shifts = []
    for seed in range(6):
        rig = make_rig(RigErrors.none(), seed)
        planned = laid.places[rig.channels]
        shifts.append(np.linalg.norm(rig.places - planned, axis=1).mean())
        module = slice(0, 12)
        own = np.linalg.norm(rig.places[module, None] - rig.places[None, module], axis=-1)
        plan = np.linalg.norm(planned[module, None] - planned[None, module], axis=-1)
        assert np.abs(own - plan).max() < 2e-4  # a patch, not single taxels
        nearest, _ = nearest_points(surface, rig.places)
        assert np.linalg.norm(nearest - rig.places, axis=1).max() < 1e-9
    assert 0.002 < np.mean(shifts) < 0.008


def test_pose_error_has_the_stated_size():
    turns, shifts = [], []
    for seed in range(60):
        for arm_pose in plane_rig(RigErrors.paper(), seed).arm_poses.values():
            error = np.linalg.inv(arm_pose.reported) @ arm_pose.true
            turns.append(np.arccos(np.clip((np.trace(error[:3, :3]) - 1) / 2, -1, 1)))
            shifts.append(np.linalg.norm(error[:3, 3]))
    assert np.degrees(np.sqrt(np.mean(np.square(turns)) / 3)) == pytest.approx(1.0, rel=0.08)
    assert np.sqrt(np.mean(np.square(shifts)) / 3) == pytest.approx(0.002, rel=0.08)
    for arm_pose in make_rig(RigErrors.noise()).arm_poses.values():
        np.testing.assert_allclose(arm_pose.true, arm_pose.reported, atol=1e-15)


def test_matrix_error_has_the_stated_size_and_crosstalk():
    errors = RigErrors.paper()
    matrices = np.array([plane_rig(errors, seed).matrix - np.eye(6) for seed in range(80)])
    sd = matrices.std(axis=0)
    arm = errors.matrix_arm
    np.testing.assert_allclose(sd[:3, :3], 0.02, rtol=0.35)
    np.testing.assert_allclose(sd[3:, 3:], 0.02, rtol=0.35)
    np.testing.assert_allclose(sd[3:, :3], 0.02 * arm, rtol=0.35)
    np.testing.assert_allclose(sd[:3, 3:], 0.02 / arm, rtol=0.35)
    rig = plane_rig(errors, 3)
    np.testing.assert_allclose(rig.read_wrenches(np.array([[1.0, 0, 0, 0, 0, 0]]))[0], rig.matrix[:, 0])


def test_drift_over_a_session_has_the_stated_size():
    errors = replace(RigErrors.none(), drift_force=0.5, drift_moment=0.012)
    squares = []
    for seed in range(100):
        noise = WrenchNoise(errors, np.random.default_rng(seed))
        ends = np.arange(20.0, 1801.0, 20.0)
        walk = [noise.block(np.array([end - 1e-9]), end - 20.0, end)[0] for end in ends]
        squares.append(np.mean(np.square(walk), axis=0))
    rms = np.sqrt(np.mean(squares, axis=0))
    np.testing.assert_allclose(rms[:3], 0.5, rtol=0.15)
    np.testing.assert_allclose(rms[3:], 0.012, rtol=0.15)


def test_white_and_slow_noise_have_the_stated_sizes(rng):
    errors = RigErrors.noise()
    noise = WrenchNoise(errors, rng)
    times = np.arange(10) / 1000.0
    blocks = np.concatenate([noise.block(times + 0.01 * i, 0.01 * i, 0.01 * (i + 1)) for i in range(20_000)])
    differences = np.diff(blocks, axis=0)
    np.testing.assert_allclose(differences[:, :3].std(axis=0) / np.sqrt(2), errors.force_noise, rtol=0.03)
    np.testing.assert_allclose(differences[:, 3:].std(axis=0) / np.sqrt(2), errors.moment_noise, rtol=0.03)
    means = blocks.reshape(-1, 100, 6).mean(axis=1)  # over 0.1 s: the slow part is left
    np.testing.assert_allclose(means[:, :3].std(axis=0), errors.slow_force, rtol=0.12)


def test_a_poke_has_the_noise_of_the_guidance_study(rng):
    rig = make_rig(RigErrors.noise())
    pokes = unguided(rig, 12, rng)
    contacts = simulate_contacts(rig, pokes, rng)
    rows = [c.poke - 1 for c in contacts]
    truth = rig.true_wrenches(pokes.points[rows], pokes.forces[rows, None] * pokes.directions[rows], rig.arm_pose())
    error = np.array([np.append(c.force, c.moment) for c in contacts]) - truth
    np.testing.assert_allclose(error[:, :3].std(axis=0), 0.10, rtol=0.12)
    np.testing.assert_allclose(error[:, 3:].std(axis=0), 0.010, rtol=0.12)
    assert np.abs(error.mean(axis=0)[:3]).max() < 0.02


def test_a_tare_around_every_poke_leaves_little_of_the_drift(rng):
    rig = make_rig(RigErrors.paper())
    pokes = unguided(rig, 12, rng)
    contacts = simulate_contacts(rig, pokes, np.random.default_rng(5))
    rows = [c.poke - 1 for c in contacts]
    loads = rig.true_wrenches(pokes.points[rows], pokes.forces[rows, None] * pokes.directions[rows], rig.arm_pose())
    error = np.array([c.force for c in contacts]) - rig.read_wrenches(loads)[:, :3]
    assert np.sqrt(np.mean(error**2)) < 0.12


def test_same_seed_same_contacts():
    def run(seed):
        rng = np.random.default_rng(seed)
        rig = Rig(*scene_and_surface(), RigErrors.paper(), rng)
        return simulate_contacts(rig, unguided(rig, 1, rng), rng)

    one, two, other = run(3), run(3), run(4)
    for a, b in zip(one, two, strict=True):
        assert a.force.tobytes() == b.force.tobytes()
        assert a.responses.tobytes() == b.responses.tobytes()
        assert a.channels.tolist() == b.channels.tolist()
    assert one[0].force.tobytes() != other[0].force.tobytes()


def test_a_scene_without_an_anchor_is_named(rng):
    scene, surface = scene_and_surface()
    bare = replace(scene, skin=replace(scene.skin, anchor=None))
    with pytest.raises(InputError, match="anchor"):
        Rig(bare, surface, RigErrors.none(), rng)
    rig = make_rig(RigErrors.none())
    with pytest.raises(InputError, match=approved_pattern("operator.no_taxel", channel=5)):
        rig.row_of(5)
    with pytest.raises(InputError, match="'8'"):
        rig.arm_pose("8")


def test_everything_turns_with_the_part(rng):
    # The flat patch turned and moved in the link frame, its sensor with it: sensor readings are the same.
    scene, _ = scene_and_surface("flat-patch")
    turn = np.eye(4)
    turn[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    turn[:3, 3] = [0.1, -0.2, 0.05]
    anchor = scene.skin.anchor
    moved_anchor = Anchor(
        anchor.at, turn[:3, :3] @ anchor.point + turn[:3, 3], turn[:3, :3] @ anchor.x, turn[:3, :3] @ anchor.normal
    )
    moved_scene = replace(scene, sensor_pose=turn @ scene.sensor_pose, skin=replace(scene.skin, anchor=moved_anchor))
    here = Rig(scene, None, RigErrors.none(), np.random.default_rng(2))
    there = Rig(moved_scene, None, RigErrors.none(), np.random.default_rng(2))
    np.testing.assert_allclose(there.places, here.places @ turn[:3, :3].T + turn[:3, 3], atol=1e-15)
    points, forces = here.places[:5], rng.standard_normal((5, 3))
    ours = here.true_wrenches(points, forces, here.arm_pose())
    theirs = there.true_wrenches(points @ turn[:3, :3].T + turn[:3, 3], forces @ turn[:3, :3].T, there.arm_pose())
    np.testing.assert_allclose(ours, theirs, atol=1e-14)
