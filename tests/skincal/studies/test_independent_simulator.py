"""The second simulator against first principles, each by another route than its own, and what the program makes of it."""

from collections import defaultdict
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest

from skincal.mesh.lay import place_layout
from skincal.mesh.load import load_surface
from skincal.mesh.surface import make_surface
from skincal.methods import estimate_taxels
from skincal.model.scene import load_scene, resource
from skincal.modules.pose import ModuleModel
from skincal.pokes import Pokes
from skincal.simulation.example_parts import forearm
from skincal.studies.independent_simulator import (
    CASES,
    GUIDED_LANDMARK_POKES,
    LOAD_FOR_63_PERCENT_RESPONSE_N,
    MAX_TAXEL_RESPONSE_COUNTS,
    NOISY_RIG,
    SLOW_NOISE_CORRELATION_POKES,
    TAXEL_ELECTRODE_RADIUS_M,
    TYPICAL_LEVER_ARM_M,
    TYPICAL_PRESS_FORCE_N,
    Operator,
    Presses,
    RigModel,
    Sensor,
    Skin,
    SmoothSurface,
    forward_kinematics,
    motions,
    sensor_wrenches,
    simulate_session,
    slow_noise,
    taxels,
    turns,
)
from skincal.taxels.result import Method

MM = 1e-3
PERFECT = replace(NOISY_RIG, force_noise=0.0, scatter=0.0, beside=0.0, gains=0.0, aim=0.0)


def rng(seed=1):
    return np.random.default_rng(seed)


@cache
def poked(world=PERFECT, seed=1):
    scene, surface = forearm().scene, forearm().surface
    return simulate_session(scene, surface.vertices, surface.triangles, world, seed)


def readings(session):
    skin = Pokes.collect(session.contacts)
    numbers = np.concatenate([skin.number, session.known.number])
    return np.concatenate([skin.wrench, session.known.wrench])[numbers.argsort()]


def in_link(each, pose=None):
    """Force and moment about the link's origin of a poke, by the definition of a moment."""
    pose = each.link_from_sensor if pose is None else pose
    force = pose[:3, :3] @ each.force
    return force, pose[:3, :3] @ each.moment + np.cross(pose[:3, 3], force)


def miss(each, place):
    """How far a poke's axis passes a place: the moment about it over the force."""
    force, moment = in_link(each)
    return np.linalg.norm(moment - np.cross(place, force)) / np.linalg.norm(force)


def sheet(side=0.1, cells=20):
    """A flat part in the plane z = 0."""
    ticks = np.linspace(-side / 2, side / 2, cells + 1)
    x, y = np.meshgrid(ticks, ticks, indexing="ij")
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    along, beside = corner + cells + 1, corner + 1
    lower, upper = np.stack([corner, along, beside], 1), np.stack([beside, along, along + 1], 1)
    return SmoothSurface(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1), np.concatenate([lower, upper]))


# ---- geometry


def test_the_chain_is_the_arm_of_the_scene():
    scene = forearm().scene
    for name, pose in forward_kinematics(scene).items():
        np.testing.assert_allclose(pose, scene.arm.arm.link_from_sensor(scene.arm.poses[name]), atol=1e-15)


def test_a_turn_keeps_lengths_and_its_axis_and_turns_by_its_angle():
    vector = np.array([[0.3, -0.5, 0.2]])
    (turn,) = turns(vector)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(turn @ vector[0], vector[0], atol=1e-15)
    assert np.arccos((np.trace(turn) - 1) / 2) == pytest.approx(np.linalg.norm(vector))
    # Small turns move points by the cross product.
    small, point = 1e-6 * vector, np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(turns(small)[0] @ point, point + np.cross(small[0], point), atol=1e-11)


def test_a_straight_way_around_a_tube_is_a_helix():
    radius, ticks, heights = 0.03, 720, np.linspace(-0.05, 0.05, 101)
    angle = np.tile(np.arange(ticks) * 2 * np.pi / ticks, len(heights))
    corners = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.repeat(heights, ticks)], axis=1)
    row, column = (i.ravel() for i in np.meshgrid(np.arange(len(heights) - 1), np.arange(ticks), indexing="ij"))
    a, b = row * ticks + column, row * ticks + (column + 1) % ticks
    tube = SmoothSurface(corners, np.concatenate([np.stack([a, b, b + ticks], 1), np.stack([a, b + ticks, a + ticks], 1)]))
    (end,), (way,), (normal,) = tube.march(np.array([[radius, 0, 0]]), np.array([[0, 0.03, 0.02]]))
    turned = 0.03 / radius
    np.testing.assert_allclose(end, [radius * np.cos(turned), radius * np.sin(turned), 0.02], atol=0.005 * MM)
    np.testing.assert_allclose(way, [-0.03 * np.sin(turned), 0.03 * np.cos(turned), 0.02], atol=0.05 * MM)
    np.testing.assert_allclose(normal, [np.cos(turned), np.sin(turned), 0], atol=2e-3)


def test_the_plan_lies_where_the_program_lays_it_too():
    scene, surface = forearm().scene, forearm().surface
    own = replace(NOISY_RIG, mount_shift=0.0, mount_turn=0.0)
    channels, places = taxels(scene, SmoothSurface(surface.vertices, surface.triangles), own, rng())
    laid = place_layout(scene.skin.layout, scene.skin.anchor, surface)
    assert np.linalg.norm(laid.places[channels] - places, axis=1).max() < 0.15 * MM


def test_a_skin_is_stuck_on_beside_its_plan_and_pads_off_it_by_what_is_told():
    scene, surface = forearm().scene, forearm().surface
    on = SmoothSurface(surface.vertices, surface.triangles)
    plan, beside, off = (
        np.array([taxels(scene, on, replace(NOISY_RIG, **sizes), rng(seed))[1] for seed in range(12)])
        for sizes in ({"mount_shift": 0.0, "mount_turn": 0.0}, {"mount_turn": 0.0}, {"pads": 0.3 * MM})
    )
    mean = np.linalg.norm((beside - plan).mean(axis=1), axis=1)
    assert np.sqrt(np.mean(mean**2)) == pytest.approx(3 * MM * np.sqrt(2), rel=0.4)
    again = np.array([taxels(scene, on, NOISY_RIG, rng(seed))[1] for seed in range(12)])
    assert np.sqrt(np.mean(np.sum((off - again) ** 2, axis=2))) == pytest.approx(0.3 * MM * np.sqrt(2), rel=0.05)


# ---- contact


def test_a_perfect_rig_reads_axes_through_the_places_that_were_pressed():
    session = poked()
    place = dict(zip(session.channels.tolist(), session.places, strict=True))
    assert len(session.contacts) == 504
    assert max(miss(each, place[int(each.channels[each.responses.argmax()])]) for each in session.contacts) < 1e-12
    assert max(miss(each, each.place) for each in session.known) < 1e-12


def test_the_program_finds_the_skin_of_a_perfect_rig():
    scene, surface = forearm().scene, forearm().surface
    session = poked()
    model = ModuleModel(scene.skin.layout, scene.skin.anchor, surface)
    for method, limit in ((Method.FREE, 0.3), (Method.SURFACE, 0.2), (Method.MODULES, 0.1)):
        found = estimate_taxels(session.contacts, session.channels, [method], scene.noise, surface, model=model)[method]
        off = np.array([each.position for each in found.values()]) - session.places
        assert np.linalg.norm(off, axis=1).mean() < limit * MM, method


def test_a_push_leans_within_its_cone_and_never_slides():
    normals = np.tile([0.0, 0.0, 1.0], (4000, 1))
    leaning = RigModel(cone=0.9, friction=0.7)
    push = Operator(leaning, normals[0], rng()).pushes(normals, leaning.cone, rng(2))
    aside = np.linalg.norm(push[:, :2], axis=1) / -push[:, 2]
    assert aside.max() == pytest.approx(0.7)
    narrow = Operator(RigModel(), normals[0], rng()).pushes(normals, 0.3, rng(2))
    # Even in solid angle: the cosine's mean is the middle of its range.
    assert -narrow[:, 2].mean() == pytest.approx((1 + np.cos(0.3)) / 2, abs=0.001)
    assert np.abs(narrow[:, :2].mean(axis=0)).max() < 0.01


def test_a_lean_and_an_arc_push_to_one_side():
    normals = np.tile([0.0, 0.0, 1.0], (4000, 1))
    for world, least in ((RigModel(lean=0.3), 0.0), (RigModel(arc=np.pi / 2), np.cos(np.pi / 4))):
        who = Operator(world, normals[0], rng())
        push = who.pushes(normals, 0.2, rng(2))
        mean = push.mean(axis=0)[:2]
        assert mean @ who.side[:2] > 0.99 * np.linalg.norm(mean) > 0
        if least:
            assert (push @ who.side / np.linalg.norm(push[:, :2], axis=1)).min() >= least - 1e-9
        else:
            assert mean @ who.side[:2] == pytest.approx(np.sin(0.3), rel=0.04)


def test_a_leaning_axis_crosses_the_taxels_beside_the_tip_by_thickness_and_shear():
    world = RigModel(thickness=2.5 * MM, shear=0.1 * MM, scatter=0.0, beside=0.0, cone=0.4)
    places = np.zeros((200, 3))
    presses = Operator(world, np.array([0.0, 0.0, 1.0]), rng()).press(sheet(), places, rng(3))
    point, force = presses.points[0], presses.forces[0]
    crossing = point - point[:, 2:] / force[:, 2:] * force
    # The way from the outer face down to the layer, and the spring that shear is.
    aside = force[:, :2] / -force[:, 2:]
    np.testing.assert_allclose(crossing[:, :2], world.thickness * aside + world.shear * force[:, :2], atol=1e-12)
    np.testing.assert_allclose(presses.feet[0], places, atol=1e-12)
    np.testing.assert_allclose(presses.normal_loads[0], -force[:, 2])


def test_the_pads_of_a_whole_plane_bear_the_whole_load():
    ticks = np.arange(-15, 16) * MM
    places = np.stack([*np.meshgrid(ticks, ticks), np.zeros((31, 31))], axis=-1).reshape(-1, 3)
    load = np.array([[4.0, 11.0], [0.0, 0.0]])
    presses = Presses(np.zeros((2, 2, 3)), np.zeros((2, 2, 3)), np.zeros((2, 2, 3)), load)
    for spread in (1.0, 2.0):
        found = Skin(RigModel(spread=spread), places, np.ones(len(places))).responses(presses, rng())
        on_pads = -LOAD_FOR_63_PERCENT_RESPONSE_N * np.log1p(-found / MAX_TAXEL_RESPONSE_COUNTS)
        # Each pad covers pi TAXEL_ELECTRODE_RADIUS_M^2 of the plane, and there is one on every square millimetre.
        np.testing.assert_allclose(on_pads.sum(axis=1) * MM**2 / (np.pi * TAXEL_ELECTRODE_RADIUS_M**2), load[0], rtol=0.02)


def test_a_wide_foam_lets_more_taxels_answer_and_gains_change_no_wrench():
    few, many = (np.mean([len(each.channels) for each in poked(world).contacts]) for world in (NOISY_RIG, CASES["wide_foam"]))
    assert 2 < few < 3.5 < many
    plain, uneven = poked(PERFECT), poked(replace(PERFECT, gains=0.4))
    np.testing.assert_array_equal(readings(plain), readings(uneven))
    ratios = [np.log(b.responses.max() / a.responses.max()) for a, b in zip(plain.contacts, uneven.contacts, strict=True)]
    assert 0.1 < np.std(ratios) < 0.4


def test_a_finger_touches_two_places_and_its_axis_is_that_of_the_sum():
    both = poked(replace(PERFECT, two=1.0))
    assert np.mean([len(each.channels) for each in both.contacts]) > 3
    place = dict(zip(both.channels.tolist(), both.places, strict=True))
    off = [miss(each, place[int(each.channels[each.responses.argmax()])]) for each in both.contacts]
    assert 1 * MM < np.median(off) < 5 * MM


# ---- sensor and arm


def test_a_wrench_does_the_work_of_its_force():
    poses = motions(rng(1).normal(size=(50, 3)), rng(2).normal(size=(50, 3)))
    points, forces = rng(3).normal(size=(2, 50, 3)), rng(4).normal(size=(2, 50, 3))
    wrenches = sensor_wrenches(poses, points, forces, 0.0)
    # A small motion of the part, in the sensor's frame: the forces' work in the link's frame is the wrench's in the sensor's.
    turn, shift, step = rng(5).normal(size=(50, 3)), rng(6).normal(size=(50, 3)), 1e-6
    moved = poses @ motions(step * turn, step * shift) @ np.linalg.inv(poses)
    ways = np.einsum("nij,knj->kni", moved[:, :3, :3], points) + moved[:, :3, 3] - points
    work = np.sum(ways * forces, axis=(0, 2)) / step
    np.testing.assert_allclose(np.sum(wrenches * np.hstack([shift, turn]), axis=1), work, atol=1e-4)


def test_an_arm_that_bends_turns_the_part_about_the_sensor_by_its_moment():
    pose, point, force = np.eye(4)[None], np.array([[[0.1, 0.0, 0.2]]]), np.array([[[0.0, 8.0, -6.0]]])
    stiff, soft = sensor_wrenches(pose, point, force, 0.0), sensor_wrenches(pose, point, force, 1e-3)
    turn = 1e-3 * stiff[0, 3:]
    np.testing.assert_allclose((soft - stiff)[0, :3], np.cross(turn, stiff[0, :3]), atol=1e-4)
    np.testing.assert_allclose((soft - stiff)[0, 3:], np.cross(turn, stiff[0, 3:]), atol=1e-5)
    assert np.linalg.norm(soft[0, :3]) == pytest.approx(10.0)


def drawn_loads(count=400):
    """Wrenches of `TYPICAL_PRESS_FORCE_N` and its moment, in all directions."""
    unit = rng(7).normal(size=(count, 2, 3))
    return (
        unit
        / np.linalg.norm(unit, axis=2, keepdims=True)
        * np.array([TYPICAL_PRESS_FORCE_N, TYPICAL_PRESS_FORCE_N * TYPICAL_LEVER_ARM_M])[:, None]
    ).reshape(-1, 6)


def test_each_error_of_the_sensor_has_its_law_and_its_size():
    loads, quiet = drawn_loads(), RigModel(matrix=0.0, force_noise=0.0)
    scale = np.repeat([TYPICAL_PRESS_FORCE_N, TYPICAL_PRESS_FORCE_N * TYPICAL_LEVER_ARM_M], 3)

    def read(wrenches, seed=1, **sizes):
        return Sensor(replace(quiet, **sizes), rng(seed)).read(wrenches, rng(99))

    np.testing.assert_array_equal(read(loads), loads)
    np.testing.assert_allclose(read(2 * loads, matrix=0.02), 2 * read(loads, matrix=0.02))
    off = [np.diag(Sensor(RigModel(), rng(seed)).matrix) - 1 for seed in range(50)]
    assert np.std(off) == pytest.approx(0.02, rel=0.15)
    bent = read(loads, quadratic=0.02) - loads
    np.testing.assert_allclose(read(-loads, quadratic=0.02) + loads, bent, atol=1e-12)
    np.testing.assert_allclose(read(2 * loads, quadratic=0.02) - 2 * loads, 4 * bent, atol=1e-12)
    of_rigs = [(read(loads, seed, quadratic=0.02) - loads) / scale for seed in range(30)]
    assert np.sqrt(np.mean(np.sum(np.square(of_rigs), axis=2)) / 2) == pytest.approx(0.02, rel=0.15)
    kept = read(np.tile(loads[:1], (3, 1)), hysteresis=0.01) / loads[0] - 1
    assert (kept[0] > -0.015 / 2).all()
    assert (kept[0] < -0.005 / 2).all()
    np.testing.assert_allclose(kept[1:], np.stack([2 * kept[0]] * 2), rtol=1e-9)


def test_slow_noise_is_as_large_as_told_and_forgets():
    noise = slow_noise(60_000, 1, rng())[:, 0]
    assert noise.std() == pytest.approx(1.0, abs=0.05)
    assert np.mean(noise[: -int(SLOW_NOISE_CORRELATION_POKES)] * noise[int(SLOW_NOISE_CORRELATION_POKES) :]) == pytest.approx(
        np.exp(-1), abs=0.07
    )
    slow = readings(poked(replace(PERFECT, slow_force=0.2))) - readings(poked())
    assert slow[:, :3].std() == pytest.approx(0.2, rel=0.25)
    assert slow[:, 3:].std() == pytest.approx(0.02, rel=0.25)
    white = readings(poked(replace(PERFECT, force_noise=0.1))) - readings(poked())
    assert white[:, :3].std() == pytest.approx(0.1, rel=0.05)


def landmark_shifts(world, seed):
    """Of the landmark pokes of each arm pose: the mean miss as a vector, and how much they differ, metres."""
    means = defaultdict(list)
    for each in poked(world, seed).known:
        force, moment = in_link(each)
        across = np.cross(force, moment - np.cross(each.place, force)) / (force @ force)
        means[each.pose].append(across)
    return [np.array(own) for own in means.values()]


def test_an_arm_pose_is_wrong_for_all_its_pokes_and_a_wandering_arm_more_and_more():
    off = landmark_shifts(replace(PERFECT, pose_shift=2 * MM), 1)
    # Only what is across a push shows of a shift: two of three directions.
    assert np.sqrt(np.mean(np.concatenate(off) ** 2)) == pytest.approx(2 * MM * np.sqrt(2 / 3), rel=0.35)
    assert len({tuple(np.round(each.link_from_sensor.ravel(), 12)) for each in poked().known}) > 1
    wander = replace(PERFECT, wander_shift=2 * MM)
    place = dict(zip(poked().channels.tolist(), poked().places, strict=True))
    last = defaultdict(list)
    for each in poked(wander).contacts:
        last[each.pose].append(miss(each, place[int(each.channels[each.responses.argmax()])]))
    first = [own[0] for own in landmark_shifts(wander, 1)]
    assert np.abs(first).max() < 1e-12
    early, late = (np.mean([np.mean(own[part]) for own in last.values()]) for part in (slice(0, 20), slice(-20, None)))
    assert late > 1.5 * early > 0
    assert np.sqrt(np.mean(np.square(list(last.values())))) == pytest.approx(2 * MM * np.sqrt(2), rel=0.35)


def test_a_landmark_is_told_wrong_by_the_same_for_all_its_pokes():
    scene = forearm().scene
    true = {mark.name: mark.place for mark in scene.landmarks}
    wrong = [
        {each.name: each.place - true[each.name] for each in poked(replace(PERFECT, landmarks=1.5 * MM), seed).known}
        for seed in range(1, 5)
    ]
    assert np.std([list(own.values()) for own in wrong]) == pytest.approx(1.5 * MM, rel=0.3)
    assert all(np.linalg.matrix_rank(list(own.values())) == 3 for own in wrong)
    session = poked(replace(PERFECT, landmarks=1.5 * MM))
    assert len({(each.name, *each.place) for each in session.known}) == len(true)
    np.testing.assert_array_equal(readings(session), readings(poked()))


def test_the_guide_asks_for_21_of_70_landmark_pokes_well_spread():
    known = poked().known
    asked = known[poked().planned]
    assert (len(known), len(asked)) == (70, 21)
    poses = list(dict.fromkeys(each.pose for each in known))
    names = [[each.name for each in asked if each.pose == pose] for pose in poses]
    assert tuple(len(own) for own in names) == GUIDED_LANDMARK_POKES
    assert all(len(set(own)) == len(own) for own in names)
    assert {len([name for own in names for name in own if name == mark]) for mark in names[0]} == {3, 4}


def test_a_wrong_mesh_is_given_and_the_taxels_stay_on_the_true_one():
    surface = forearm().surface
    on = SmoothSurface(surface.vertices, surface.triangles)
    shifted, inflated, bumpy = (
        on.wrong(replace(NOISY_RIG, **{size: 1.5 * MM}), rng(4)) - surface.vertices
        for size in ("mesh_shift", "mesh_inflate", "mesh_bumps")
    )
    np.testing.assert_allclose(shifted, np.tile(shifted[0], (len(shifted), 1)), atol=1e-15)
    assert np.linalg.norm(shifted[0]) == pytest.approx(1.5 * MM)
    blown = make_surface(surface.vertices + inflated, surface.triangles)
    # A body grows by its skin times the way outward.
    grown = np.sum((blown.centres - surface.centres).T * surface.normals, axis=1)
    np.testing.assert_allclose(grown, 1.5 * MM, atol=0.01 * MM)
    assert np.sqrt(np.mean(np.sum(bumpy**2, axis=1))) == pytest.approx(1.5 * MM, rel=0.3)
    for name in ("mesh_shifted", "mesh_bumpy"):
        wrong, right = poked(CASES[name]), poked(CASES["nothing"])
        np.testing.assert_array_equal(wrong.places, right.places)
        np.testing.assert_array_equal(readings(wrong), readings(right))
        assert not np.array_equal(wrong.vertices, right.vertices)


def test_another_scene_with_mesh_and_layout_is_poked_too():
    scene = load_scene(resource("scenes/whole-body/scene.toml"))
    surface = load_surface(scene.surface)[0]
    session = simulate_session(scene, surface.vertices, surface.triangles, PERFECT, 1, per_pose=40)
    place = dict(zip(session.channels.tolist(), session.places, strict=True))
    assert (len(session.contacts), len(session.known), len(place)) == (40, 0, 4200)
    assert max(miss(each, place[int(each.channels[each.responses.argmax()])]) for each in session.contacts) < 1e-12


def test_no_truth_is_made_with_what_the_types_of_pokes_compute(monkeypatch):
    for name in ("axis_point", "crossed", "move_wrench", "pitch", "_lengths"):
        monkeypatch.delattr(f"skincal.pokes.{name}")
    scene, surface = forearm().scene, forearm().surface
    session = simulate_session(scene, surface.vertices, surface.triangles, CASES["bad"], 1)
    assert len(session.contacts)
    assert vars(session.known).keys() == {each.name for each in fields(session.known)}


def test_a_seed_says_everything():
    scene, surface = forearm().scene, forearm().surface
    again, other = (simulate_session(scene, surface.vertices, surface.triangles, CASES["bad"], seed) for seed in (1, 2))
    np.testing.assert_array_equal(readings(poked(CASES["bad"])), readings(again))
    assert np.abs(again.places - other.places).max() > 0.5 * MM
