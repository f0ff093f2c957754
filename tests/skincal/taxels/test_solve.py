from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.geometry import inverse_pose
from skincal.mesh.surface import Surface, make_surface
from skincal.methods import average_over_poses
from skincal.model.scene import NoiseSettings
from skincal.taxels.result import PER_TAXEL, Cause, Method, State
from skincal.taxels.solve import solve as solve_evidence
from tests.skincal.estimate_support import gather, solve

NOISE = NoiseSettings()
RADIUS = 0.04


def tube(around=48, along=30, length=0.2) -> Surface:
    """An open shell like a forearm's cover, outward normals."""
    angle, height = np.linspace(-1.8, 1.8, around + 1), np.linspace(0, length, along + 1)
    a, h = np.meshgrid(angle, height, indexing="ij")
    vertices = np.stack([RADIUS * np.cos(a), RADIUS * np.sin(a), h], axis=-1).reshape(-1, 3)
    i = (np.arange(around)[:, None] * (along + 1) + np.arange(along)).ravel()
    lower, upper = np.stack([i, i + along + 1, i + 1], axis=1), np.stack([i + 1, i + along + 1, i + along + 2], axis=1)
    return make_surface(vertices, np.concatenate([lower, upper]))


def random_pose(rng, reach=0.2):
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    pose[:3, 3] = rng.normal(0, reach, 3)
    return pose


def poke(number, point, force, pose=None, channels=(0,), responses=(50.0,), name=""):
    """Press `force` on `point`, both in the link frame: what the sensor at `pose` (link_from_sensor) then measures."""
    pose = np.eye(4) if pose is None else pose
    sensor_from_link = inverse_pose(pose)
    place = sensor_from_link[:3, :3] @ point + sensor_from_link[:3, 3]
    felt = sensor_from_link[:3, :3] @ force
    moment, answers = np.cross(place, felt), np.array(responses, dtype=float)
    return Contact(number, 0.0, 1.0, felt, moment, np.array(channels), answers, pose, name, 0.0, True)


def tilted(rng, normal, tilt_deg):
    push = -normal + np.tan(np.radians(tilt_deg)) * rng.uniform(0, 1) * across(rng, normal)
    return push / np.linalg.norm(push)


def across(rng, normal):
    v = np.cross(normal, rng.normal(size=3))
    return v / np.linalg.norm(v)


def on_tube(rng, count):
    """Points of the mesh, and their triangles' normals."""
    surface = tube()
    inner = np.flatnonzero((surface.centres[2] > 0.03) & (surface.centres[2] < 0.17))
    chosen = rng.choice(inner, count, replace=False)
    shares = rng.dirichlet([2, 2, 2], count)
    return np.einsum("ni,nij->nj", shares, surface.corners[chosen]), surface.normals[chosen]


def session(rng, taxels=12, pokes=60, poses=3, exact=True):
    """Pokes that each touch three taxels, centred on the one that answers most, over several poses."""
    points, normals = on_tube(rng, taxels)
    arm = [random_pose(rng) for _ in range(poses)]
    contacts = []
    for number in range(1, pokes + 1):
        main = number % taxels
        force = tilted(rng, normals[main], 30) * rng.uniform(5, 12)
        others = rng.choice([j for j in range(taxels) if j != main], 2, replace=False)
        channels = [main] if exact else sorted([main, *others])
        responses = [float(rng.uniform(80, 100) if j == main else rng.uniform(5, 30)) for j in channels]
        index = number % poses
        contacts.append(poke(number, points[main], force, arm[index], channels, responses, f"pose {index}"))
    return contacts, points, normals


@pytest.mark.parametrize("method", PER_TAXEL)
def test_taxels_are_recovered_without_noise_over_several_poses(method):
    contacts, points, normals = session(np.random.default_rng(1))
    surface = tube()
    found = solve(contacts, range(12), method, NOISE, surface)
    for channel, (point, normal) in enumerate(zip(points, normals, strict=True)):
        estimate = found[channel]
        assert estimate.state is State.TOUCHED
        assert estimate.contacts == 5
        np.testing.assert_allclose(estimate.position, point, atol=1e-12)
        assert estimate.normal @ normal > (0.85 if method is Method.FREE else 1 - 1e-12)
        assert (estimate.triangle is None) == (method is Method.FREE)


def stacked_system(contacts, channel, doubted):
    """The paper's (5) with K and (6), each symbol written out: sensor-frame rows, unknown in the link frame.

    What is `doubted` counts less: its share of the sum of squares is multiplied by its trust.
    """
    rows, right, weights = [], [], []
    for contact in contacts:
        if channel not in contact.channels:
            continue
        s_from_w = np.linalg.inv(contact.link_from_sensor)
        rotation, origin = s_from_w[:3, :3], s_from_w[:3, 3]
        f, m = contact.force, contact.moment
        skew = np.array([[0, -f[2], f[1]], [f[2], 0, -f[0]], [-f[1], f[0], 0]])
        rows.append(skew @ rotation / np.linalg.norm(f))
        right.append((-m - np.cross(f, origin)) / np.linalg.norm(f))
        k = contact.responses[list(contact.channels).index(channel)] / max(contact.responses)
        weights += [k * np.sqrt(doubted.get(contact.poke, 1.0))] * 3
    return np.concatenate(rows), np.concatenate(right), np.diag(weights)


def test_free_equals_the_papers_stacked_system_by_two_other_routes():
    contacts, _, _ = session(np.random.default_rng(2), exact=False)
    found = solve(contacts, range(12), Method.FREE, NOISE, None)
    for channel in range(12):
        f, m, k = stacked_system(contacts, channel, found[channel].doubted)
        by_lstsq = np.linalg.lstsq(k @ f, k @ m, rcond=None)[0]
        by_normal_equations = np.linalg.inv(f.T @ k @ k @ f) @ f.T @ k @ k @ m
        np.testing.assert_allclose(found[channel].position, by_lstsq, atol=1e-12)
        np.testing.assert_allclose(found[channel].position, by_normal_equations, atol=1e-12)


def test_surface_equals_the_best_of_all_triangles_of_the_stacked_system():
    rng = np.random.default_rng(3)
    contacts, _, _ = session(rng, exact=False)
    surface = tube(around=24, along=12)
    found = solve(contacts, range(4), Method.SURFACE, NOISE, surface)
    grid = np.array([[i, j, 25 - i - j] for i in range(26) for j in range(26 - i)]) / 25
    for channel in range(4):
        f, m, k = stacked_system(contacts, channel, found[channel].doubted)
        push = solve_evidence(gather(contacts, [channel]), [], NOISE, None).answer["push"][0]
        dense = np.einsum("gi,tij->tgj", grid, surface.corners[surface.normals @ push < 0])
        cost = ((dense @ (k @ f).T - k @ m) ** 2).sum(axis=-1)
        own = float(((k @ f @ found[channel].position - k @ m) ** 2).sum())
        assert own <= cost.min() * (1 + 1e-12)
        assert np.sqrt(own) > np.sqrt(cost.min()) - 0.01 / 25 * np.linalg.norm(k @ f, 2)


@pytest.mark.parametrize("method", PER_TAXEL)
def test_the_order_of_the_pokes_leaves_no_trace(method):
    rng = np.random.default_rng(4)
    contacts, _, _ = session(rng, exact=False)
    contacts += contacts[:7]
    surface = tube()
    plain = solve(contacts, range(12), method, NOISE, surface)
    for _ in range(4):
        shuffled = [contacts[i] for i in rng.permutation(len(contacts))]
        same(plain, solve(shuffled, range(12), method, NOISE, surface))


@pytest.mark.parametrize("method", PER_TAXEL)
def test_solving_a_few_taxels_gives_the_bits_of_solving_all(method):
    contacts, _, _ = session(np.random.default_rng(5), exact=False)
    surface = tube()
    everything = solve(contacts, range(12), method, NOISE, surface)
    for channels in ([3], [7, 2, 11], [0, 1]):
        some = solve(contacts, channels, method, NOISE, surface)
        assert list(some) == channels
        same({channel: everything[channel] for channel in channels}, some)
    fewer = [contact for contact in contacts if 3 in contact.channels]
    same({3: everything[3]}, solve(fewer, [3], method, NOISE, surface))


def same(here, other):
    for channel, estimate in here.items():
        twin = other[channel]
        assert (estimate.state, estimate.contacts, estimate.triangle) == (twin.state, twin.contacts, twin.triangle)
        for name in ("position", "normal", "covariance", "worst_direction"):
            np.testing.assert_array_equal(getattr(estimate, name), getattr(twin, name))


@pytest.mark.parametrize("method", PER_TAXEL)
def test_estimates_turn_with_a_rigid_motion_of_everything(method):
    rng = np.random.default_rng(6)
    contacts, _, _ = session(rng, exact=False)
    surface = tube()
    motion = random_pose(rng, reach=0.5)
    rotation, shift = motion[:3, :3], motion[:3, 3]
    moved_surface = make_surface(surface.vertices @ rotation.T + shift, surface.triangles)
    moved = [replace(contact, link_from_sensor=motion @ contact.link_from_sensor) for contact in contacts]
    plain = solve(contacts, range(12), method, NOISE, surface)
    two = solve(moved, range(12), method, NOISE, moved_surface)
    for channel in range(12):
        a, b = plain[channel], two[channel]
        np.testing.assert_allclose(rotation @ a.position + shift, b.position, atol=1e-10)
        np.testing.assert_allclose(rotation @ a.normal, b.normal, atol=1e-9)
        np.testing.assert_allclose(rotation @ a.covariance @ rotation.T, b.covariance, atol=1e-13)
        assert abs(rotation @ a.worst_direction @ b.worst_direction) > 1 - 1e-9


def test_units_of_force_do_not_move_the_free_estimate():
    contacts, points, _ = session(np.random.default_rng(7))
    for factor_ in (1e-3, 1e4):
        scaled = [replace(c, force=factor_ * c.force, moment=factor_ * c.moment) for c in contacts]
        solved = solve_evidence(gather(scaled, [0]), [], NOISE, None)
        np.testing.assert_allclose(solved.answer["solution"][0], points[0], atol=1e-12)


def test_one_axis():
    surface = tube()
    point = np.array([RADIUS, 0.0, 0.1])
    push = np.array([-1.0, 0.1, 0.2])
    contacts = [poke(1, point, 8 * push)]
    free = solve(contacts, [0], Method.FREE, NOISE, None)[0]
    assert free.state is State.BLIND
    assert free.position is None
    assert free.sd is None
    assert abs(free.worst_direction @ push) / np.linalg.norm(push) > 1 - 1e-9
    assert free.reason.cause is Cause.ONE_AXIS
    np.testing.assert_allclose(free.normal, -push / np.linalg.norm(push))
    on_surface = solve(contacts, [0], Method.SURFACE, NOISE, surface)[0]
    assert on_surface.state is State.TOUCHED
    assert np.linalg.norm(np.cross(on_surface.position - point, push)) < 1e-12, "it lies on the axis"
    assert on_surface.position[0] > 0, "where the poke enters and not where its axis leaves"
    assert on_surface.contacts == 1


@pytest.mark.parametrize("angle_deg", [0.0, 1e-7, 0.01, 1.2])
def test_parallel_axes_are_blind_along_them(angle_deg):
    point = np.array([RADIUS, 0.0, 0.1])
    tilt = np.tan(np.radians(angle_deg))
    contacts = [poke(i, point, 8 * np.array([-1.0, tilt * s, 0.0])) for i, s in enumerate((-1, 0, 1), start=1)]
    free = solve(contacts, [0], Method.FREE, NOISE, None)[0]
    assert free.state is State.BLIND
    assert abs(free.worst_direction[0]) > 1 - 1e-6
    assert (free.reason.cause, free.reason.count) == (Cause.ALIKE_AXES, 3)
    assert np.degrees(free.reason.angle) == pytest.approx(angle_deg, abs=0.05)
    on_surface = solve(contacts, [0], Method.SURFACE, NOISE, tube())[0]
    assert on_surface.state is State.TOUCHED
    np.testing.assert_allclose(on_surface.position[1:], point[1:], atol=1e-9)


def test_axes_far_enough_apart_are_estimated():
    point = np.array([RADIUS, 0.0, 0.1])
    contacts = [poke(i, point, 8 * np.array([-1.0, 0.3 * s, 0.0])) for i, s in enumerate((-1, 0, 1), start=1)]
    free = solve(contacts, [0], Method.FREE, NOISE, None)[0]
    assert free.state is State.TOUCHED
    np.testing.assert_allclose(free.position, point, atol=1e-14)
    assert free.sd < 0.03
    assert abs(free.worst_direction[0]) > 0.99, "depth is the worst"


def test_no_contact_and_dead():
    contacts, _, _ = session(np.random.default_rng(8))
    for method in PER_TAXEL:
        found = solve(contacts, [3, 400], method, NOISE, tube(), {3: "always on"})
        assert found[3].state is State.DEAD
        assert (found[3].reason.cause, found[3].reason.text) == (Cause.EXTERNAL_TEXT, "always on")
        assert found[400].state is State.UNSEEN
        assert found[400].position is None
        assert solve([], [5], method, NOISE, tube())[5].state is State.UNSEEN


def flat():
    return make_surface(np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))


def lifted(height):
    return make_surface(tube().vertices + height * UP, tube().triangles)


def inside_out():
    return make_surface(tube().vertices, tube().triangles[:, ::-1])


UP, EDGE = np.array([0.0, 0.0, 1.0]), np.array([RADIUS, 0.0, 0.1])
BLIND = {
    "outside in": ([(EDGE, (0.0, 0.0, -8.0))], tube, Cause.NO_TRIANGLE, 0, None),
    "inside out": ([(EDGE, (0.0, 0.0, -8.0))], inside_out, Cause.NO_TRIANGLE, 0, None),
    "opposed": ([(EDGE, (8.0, 0.1, 0.0)), (EDGE, (-8.0, 0.1, 0.0))], tube, Cause.OPPOSED, 2, None),
    "grazing": ([(np.zeros(3), (8.0, 0.0, -0.1))], flat, Cause.GRAZING, 0, None),
    "mesh far off": ([(EDGE, (-8.0, 0.0, 0.0))], lambda: lifted(0.4), Cause.OFF_SURFACE, 0, 0.3),
    "axes far apart": ([(EDGE, (-8.0, 0, 0)), (EDGE + 0.3 * UP, (-6.0, 4.0, 0))], None, Cause.AXES_APART, 0, 0.15),
}


@pytest.mark.parametrize("case", BLIND)
def test_pokes_that_fit_no_position_are_blind_with_the_cause(case):
    pushes, mesh, cause, count, size = BLIND[case]
    contacts = [poke(i, point, np.array(force)) for i, (point, force) in enumerate(pushes, start=1)]
    method = Method.FREE if mesh is None else Method.SURFACE
    estimate = solve(contacts, [0], method, NOISE, None if mesh is None else mesh())[0]
    assert (estimate.state, estimate.position) == (State.BLIND, None)
    assert (estimate.reason.cause, estimate.reason.count) == (cause, count)
    assert estimate.reason.size == (size if size is None else pytest.approx(size, abs=5e-4))
    if cause is Cause.GRAZING:
        assert abs(estimate.worst_direction[0]) > 0.99
        assert estimate.sd > 0.03


def test_axes_and_meshes_that_miss_by_the_errors_of_a_rig_are_estimated():
    pushes = [poke(1, EDGE, np.array([-8.0, 0, 0])), poke(2, EDGE + 0.08 * UP, np.array([-6.0, 4.0, 0]))]
    assert solve(pushes, [0], Method.FREE, NOISE, None)[0].state is State.TOUCHED
    assert solve(pushes[:1], [0], Method.SURFACE, NOISE, lifted(0.14))[0].state is State.TOUCHED


@pytest.mark.parametrize("what", ["force", "moment", "link_from_sensor", "responses", "no force", "negative response"])
def test_numbers_that_are_not_finite_are_refused(what):
    good = poke(4, np.array([RADIUS, 0, 0.1]), np.array([-8.0, 0, 0]), channels=(0, 1), responses=(5.0, 9.0))
    values = {name: np.array(getattr(good, name)) for name in ("force", "moment", "link_from_sensor", "responses")}
    if what == "no force":
        values["force"][:] = 0
    elif what == "negative response":
        values["responses"][0] = -3.0
    else:
        values[what].flat[1] = np.nan
    bad = replace(good, **values)
    for method in PER_TAXEL:
        with pytest.raises(ValueError, match="poke 4"):
            solve([good, bad], [0], method, NOISE, tube())


def test_the_surface_method_needs_a_surface():
    with pytest.raises(ValueError, match="surface"):
        solve([], [0], Method.SURFACE, NOISE, None)


def test_nothing_is_ever_nan_however_extreme_the_numbers():
    rng = np.random.default_rng(9)
    surface = tube()
    for _ in range(60):
        size = 10.0 ** rng.uniform(-6, 4)
        point = rng.normal(size=3) * 10.0 ** rng.uniform(-3, 4)
        spread = 10.0 ** rng.uniform(-12, 0)
        contacts = []
        for i in range(1, int(rng.integers(2, 6))):
            force = size * (np.array([-1.0, 0, 0]) + spread * rng.normal(size=3))
            contacts.append(poke(i, point, force, responses=(10.0 ** rng.uniform(-10, 2),)))
        for method in PER_TAXEL:
            estimate = solve(contacts, [0], method, NOISE, surface)[0]
            for name in ("position", "normal", "covariance", "worst_direction", "sd", "rms"):
                value = getattr(estimate, name)
                assert value is None or np.isfinite(value).all()
            assert (estimate.position is None) == (estimate.state is not State.TOUCHED)
            assert estimate.reason or estimate.state is State.TOUCHED


def test_poses_averaged_as_in_the_paper():
    rng = np.random.default_rng(10)
    contacts, _, _ = session(rng, taxels=6, pokes=90, exact=False)
    shaken = [replace(contact, moment=contact.moment + rng.normal(0, 0.01, 3)) for contact in contacts]
    surface = tube()
    for method in PER_TAXEL:
        found = average_over_poses(shaken, range(6), method, NOISE, surface)
        of_poses = [solve([c for c in shaken if c.pose == f"pose {i}"], range(6), method, NOISE, surface) for i in range(3)]
        for channel in range(6):
            seen = [pose[channel] for pose in of_poses if pose[channel].position is not None]
            assert len(seen) == 3
            mean, spread = np.mean([each.position for each in seen], axis=0), np.sum([each.covariance for each in seen], axis=0)
            np.testing.assert_allclose(found[channel].position, mean, atol=1e-15)
            np.testing.assert_allclose(found[channel].covariance, spread / 9)
            assert found[channel].contacts == sum(pose[channel].contacts for pose in of_poses)
            assert (found[channel].reason.cause, found[channel].reason.count) == (Cause.MEAN_OF_POSES, 3)
        same(found, average_over_poses(shaken[::-1], range(6), method, NOISE, surface))


def test_a_pose_in_which_a_taxel_is_blind_does_not_count():
    point = np.array([RADIUS, 0.0, 0.1])
    good = [poke(i, point, 8 * np.array([-1.0, 0.3 * s, 0.0]), name="a") for i, s in enumerate((-1, 0, 1), start=1)]
    lone = poke(4, point + 0.01, np.array([-8.0, 0, 0]), name="b")
    estimate = average_over_poses([lone, *good], [0], Method.FREE, NOISE, None)[0]
    np.testing.assert_allclose(estimate.position, point, atol=1e-14)
    assert (estimate.reason.count, estimate.reason.blind) == (1, 1)
    blind = average_over_poses([lone], [0, 1], Method.FREE, NOISE, None)
    assert blind[0].state is State.BLIND
    assert (blind[0].reason.cause, blind[0].reason.inner.cause) == (Cause.BLIND_IN_POSES, Cause.ONE_AXIS)
    assert blind[1].state is State.UNSEEN
    assert average_over_poses([], [0], Method.FREE, NOISE, None)[0].state is State.UNSEEN
