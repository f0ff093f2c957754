"""The predicted uncertainty of a taxel: by another route, against the truth of many draws, and with what makes it grow."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.geometry import cross_matrix, orthonormal_pair
from skincal.mesh.surface import make_surface
from skincal.methods import estimate_from
from skincal.model.scene import NoiseSettings
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import POSITION_MAX_SD_M, Method, State
from skincal.taxels.solve import solve as solve_evidence
from tests.skincal.estimate_support import gather, least_squares, solve

NOISE = NoiseSettings(skin=0.0)
FLAT = replace(NOISE, radius=1e9)
EVEN = 0.4
"""Mean of sqrt(ln(1/k)) from which on all neighbours' offsets are one (`uncertainty.h`)."""
TRIALS = 200
LIMIT = {3: 7.8147, 2: 5.9915}
"""95 % of a chi-square of as many degrees of freedom lie below."""


def tangent_basis(normal):
    return np.linalg.svd(normal[None])[2][1:].T


def sensor_pose():
    """A sensor 0.2 m away and turned: its noise has another lever than the link's origin would give."""
    rotation = np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, [0.05, -0.1, 0.15]
    return pose


def measured(rng, number, taxel, force, normal, pose, noise, weight=1.0):
    """A poke of the rig that `noise` describes: contact scattered in the skin, wrench with the sensor's noise."""
    sd = np.sqrt(noise.contact**2 - noise.reach**2 * np.log(weight))
    scatter = tangent_basis(normal) @ rng.normal(0, sd, 2)
    place = pose[:3, :3].T @ (taxel + scatter - pose[:3, 3])
    felt = pose[:3, :3].T @ force
    moment = np.cross(place, felt) + rng.normal(0, noise.moment, 3)
    responses = np.array([weight, 1.0]) if weight < 1 else np.array([1.0, 0.5])
    return Contact(number, 0, 1, felt + rng.normal(0, noise.force, 3), moment, np.array([0, 1]), responses, pose, "", 0, True)


def pokes(rng, count, taxel, normal, pose, noise, tilt=0.5, weights=(1.0,)):
    contacts = []
    for number in range(1, count + 1):
        push = -normal + tilt * rng.uniform(-1, 1, 2) @ tangent_basis(normal).T
        force = push / np.linalg.norm(push) * rng.uniform(6, 12)
        contacts.append(measured(rng, number, taxel, force, normal, pose, noise, weights[number % len(weights)]))
    return contacts


@pytest.mark.parametrize(("method", "count"), [(Method.FREE, 10), (Method.SURFACE, 3), (Method.SURFACE, 1)])
def test_the_95_percent_ellipsoid_covers_the_truth(method, count):
    rng = np.random.default_rng(20)
    normal = np.array([0.6, 0.0, 0.8])
    taxel = np.array([0.03, 0.02, 0.01])
    plane = taxel + 0.2 * (tangent_basis(normal) @ np.array([[-1.0, -1], [1, -1], [0, 2]]).T).T
    surface = make_surface(plane, np.array([[0, 1, 2]]))
    surface = surface if surface.normals[0] @ normal > 0 else make_surface(plane, np.array([[0, 2, 1]]))
    inside, errors, predicted = 0, [], []
    basis = tangent_basis(normal) if method is Method.SURFACE else np.eye(3)
    for _ in range(TRIALS):
        estimate = solve(pokes(rng, count, taxel, normal, sensor_pose(), FLAT), [0], method, FLAT, surface)[0]
        assert estimate.state is State.TOUCHED
        off = basis.T @ (estimate.position - taxel)
        inside += off @ np.linalg.solve(basis.T @ estimate.covariance @ basis, off) <= LIMIT[len(off)]
        errors.append(np.linalg.norm(estimate.position - taxel))
        predicted.append(estimate.rms)
    assert 0.90 <= inside / TRIALS <= 0.99
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.sqrt(np.mean(np.square(predicted))), rel=0.2)


def test_the_lever_runs_from_the_sensor_and_not_from_the_links_origin():
    rng = np.random.default_rng(21)
    only_force = NoiseSettings(force=0.1, moment=1e-9, contact=1e-9, reach=1e-9, radius=1e9, skin=0.0)
    quiet = NoiseSettings(1e-12, 1e-12, 1e-12, 1e-12, skin=0.0)
    pose, normal = sensor_pose(), np.array([0.0, 0.0, 1.0])
    for taxel, exact in ((pose[:3, 3] + [0, 0, 1e-4], True), (np.array([0.0, 0.0, 0.0]), False)):
        contacts = pokes(rng, 10, taxel, normal, pose, quiet)
        estimate = solve(contacts, [0], Method.FREE, only_force, None)[0]
        # At the sensor's own origin an error of the force turns the axis about the taxel and moves it nowhere.
        assert estimate.rms < 1e-5 if exact else estimate.rms > 1e-3


def written_out(evidence, taxel, normal, pose, noise):
    """The covariance with each symbol of the model over the system (5), 3n rows; the code carries 2n."""
    directions, k, sizes = evidence.directions, evidence.weights, evidence.forces
    skin = np.eye(3) - np.outer(normal, normal)
    low = np.sqrt(-np.log(k))
    share = min(1.0, (k**2 @ low) / (k**2).sum() / EVEN)
    common = share * noise.reach * low
    square = noise.contact**2 + (noise.reach * low) ** 2
    f = np.concatenate([cross_matrix(u) for u in directions])
    k3 = np.repeat(k, 3)
    gain = np.linalg.inv(f.T @ np.diag(k3**2) @ f) @ f.T @ np.diag(k3**2)
    q = cross_matrix(taxel - pose[:3, 3])
    middle = np.zeros((len(k3), len(k3)))
    for i, (u, size) in enumerate(zip(directions, sizes, strict=True)):
        scatter = (square[i] - common[i] ** 2) * cross_matrix(u) @ skin @ cross_matrix(u).T
        c = (noise.moment**2 * np.eye(3) + noise.force**2 * q @ q.T) / size**2 + scatter
        middle[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = c
    moved = np.concatenate([cross_matrix(u) * s for u, s in zip(directions, common, strict=True)])
    along = directions - np.outer(directions @ normal, normal)
    lean = k**2 @ ((along**2).sum(axis=1) / 2 + (noise.force / sizes) ** 2) / (k**2).sum()
    offset = square[:, None] / (2 * noise.radius) * along / lean
    beta = gain @ np.cross(directions, offset).ravel()
    return gain @ (middle + moved @ skin @ moved.T) @ gain.T + np.outer(beta, beta)


def test_the_covariance_equals_the_sandwich_of_the_papers_three_rows():
    rng = np.random.default_rng(23)
    taxel, pose, normal = np.array([0.03, 0.02, 0.01]), sensor_pose(), np.array([0.0, 0.6, 0.8])
    evidence = gather(pokes(rng, 8, taxel, normal, pose, NOISE, weights=(1.0, 0.9, 0.3)), [0])
    own = solve_evidence(evidence, [Method.FREE], NOISE, None, doubting=False)
    push, point = own.answer["push"][0], own.answer["solution"][0]
    assert np.linalg.norm(point - taxel) < 0.005
    expected = written_out(evidence, point, push / np.linalg.norm(push), pose, NOISE)
    np.testing.assert_allclose(own.answer["free"]["covariance"][0], expected, rtol=1e-9)
    values, axes = np.linalg.eigh(expected)
    assert own.answer["free"]["sd"][0] == pytest.approx(np.sqrt(values[-1]))
    assert own.answer["free"]["rms"][0] == pytest.approx(np.sqrt(np.trace(expected)))
    assert abs(own.answer["free"]["worst_direction"][0] @ axes[:, -1]) == pytest.approx(1)


def test_on_a_plane_it_equals_the_sandwich_confined_to_the_plane():
    """By numbers: noise put into the rows by hand, the weighted least squares solved in the plane."""
    rng = np.random.default_rng(27)
    taxel, pose, normal = np.array([0.03, 0.02, 0.01]), sensor_pose(), np.array([0.0, 0.6, 0.8])
    evidence = gather(pokes(rng, 5, taxel, normal, pose, NOISE, weights=(1.0, 0.8, 0.4)), [0])
    plane = taxel + 0.2 * (tangent_basis(normal) @ np.array([[-1.0, -1], [1, -1], [0, 2]]).T).T
    surface = make_surface(plane, np.array([[0, 1, 2]]))
    surface = surface if surface.normals[0] @ normal > 0 else make_surface(plane, np.array([[0, 2, 1]]))
    found = solve_evidence(evidence, [Method.SURFACE], NOISE, surface, doubting=False).answer[0]
    own, taxel = found["on_surface"]["covariance"], found["point"]
    basis = tangent_basis(normal)
    squares, ends = [], 20_000
    k, sizes = evidence.weights, evidence.forces
    low = np.sqrt(-np.log(k))
    common = NOISE.reach * low * min(1.0, (k**2 @ low) / (k**2).sum() / EVEN)
    spread = NOISE.contact**2 + (NOISE.reach * low) ** 2
    df, dm = rng.normal(0, NOISE.force, (ends, 5, 3)), rng.normal(0, NOISE.moment, (ends, 5, 3))
    alone = np.sqrt(spread - common**2)[:, None] * rng.normal(size=(ends, 5, 2))
    shared = common[:, None] * rng.normal(size=(ends, 1, 2))
    off = (alone + shared) @ basis.T
    # The residual (f x p + m)/|f| at the taxel; its part across u is the row's.
    moved = (np.cross(df, pose[:3, 3] - taxel) * -1.0 + dm) / sizes[:, None] + np.cross(off, evidence.directions)
    moved = np.cross(evidence.directions, moved)
    projections = np.eye(3) - evidence.directions[:, :, None] * evidence.directions[:, None]
    metric = basis.T @ np.einsum("n,nij->ij", k**2, projections) @ basis
    squares = np.linalg.solve(metric, basis.T @ np.einsum("n,sni->is", k**2, moved))
    expected = basis @ np.cov(squares) @ basis.T
    np.testing.assert_allclose(own, expected, atol=0.04 * np.abs(expected).max())
    assert own @ normal == pytest.approx(np.zeros(3), abs=1e-18)


def test_weak_answers_share_their_offset_and_own_pokes_do_not():
    rng = np.random.default_rng(28)
    taxel, normal = np.array([0.03, 0.02, 0.01]), np.array([0.0, 0.0, 1.0])

    def rms(count, weights):
        contacts = pokes(rng, count, taxel, normal, sensor_pose(), FLAT, weights=weights)
        plane = make_surface(taxel + 0.2 * np.array([[-1.0, -1, 0], [1, -1, 0], [0, 2, 0]]), np.array([[0, 1, 2]]))
        return solve(contacts, [0], Method.SURFACE, FLAT, plane)[0].rms

    # A hundred times the pokes make own ones ten times better; pokes on neighbours stay as far off as they are.
    assert rms(400, (1.0,)) < 0.12 * rms(4, (1.0,))
    assert rms(400, (0.3,)) > 0.6 * rms(4, (0.3,))
    assert rms(400, (0.3,)) > np.sqrt(2) * NOISE.reach


def test_the_depth_below_a_bent_skin_is_not_known_better_than_its_bend():
    """Pokes lean with the skin beside the taxel: the more they lean by themselves, the less that matters."""
    rng = np.random.default_rng(29)
    taxel, normal = np.array([0.03, 0.02, 0.01]), np.array([0.0, 0.0, 1.0])

    for tilt in (0.3, 0.6):
        contacts = pokes(rng, 300, taxel, normal, sensor_pose(), FLAT, tilt)
        bent, flat = (solve(contacts, [0], Method.FREE, noise, None)[0].covariance for noise in (NOISE, FLAT))
        # E[c] = -s^2/(2 R) u_t/v for a lean u_t of variance v = tilt^2/3: axes that meet this far below the skin.
        depth = NOISE.contact**2 / (2 * NOISE.radius) / (tilt**2 / 3)
        assert np.sqrt(normal @ (bent - flat) @ normal) == pytest.approx(depth, rel=0.2)


def test_errors_of_the_arms_poses_do_not_average_out_within_a_pose():
    rng = np.random.default_rng(30)
    taxel, normal = np.array([0.03, 0.02, 0.01]), np.array([0.0, 0.0, 1.0])
    contacts = pokes(rng, 400, taxel, normal, sensor_pose(), FLAT)
    known = replace(FLAT, pose_shift=0.002)
    alone = solve(contacts, [0], Method.FREE, FLAT, None)[0].covariance
    wider = solve(contacts, [0], Method.FREE, known, None)[0].covariance
    np.testing.assert_allclose(wider - alone, 0.002**2 * np.eye(3), atol=1e-9)
    turned = replace(FLAT, pose_turn=0.01)
    q = cross_matrix(solve(contacts, [0], Method.FREE, FLAT, None)[0].position - sensor_pose()[:3, 3])
    wider = solve(contacts, [0], Method.FREE, turned, None)[0].covariance
    np.testing.assert_allclose(wider - alone, 1e-4 * q @ q.T, atol=1e-8)
    four = [replace(contact, pose=f"{contact.poke % 4}") for contact in contacts]
    wider = solve(four, [0], Method.FREE, known, None)[0].covariance
    assert np.trace(wider - alone) == pytest.approx(3 * 0.002**2 / 4, rel=0.1)
    assert (solve(four[::-1], [0], Method.FREE, known, None)[0].covariance == wider).all()


def test_uncertainty_grows_with_noise_and_shrinks_with_pokes():
    rng = np.random.default_rng(24)
    normal, taxel = np.array([0.0, 0.0, 1.0]), np.array([0.03, 0.02, 0.01])
    contacts = pokes(rng, 40, taxel, normal, sensor_pose(), NOISE)
    few, many = (solve(contacts[:n], [0], Method.FREE, FLAT, None)[0] for n in (10, 40))
    assert 0.35 < many.rms / few.rms < 0.7
    # Not to the last digit: what is doubted differs. Without what pokes share, whose part does not grow alike.
    louder = NoiseSettings(*(2 * value for value in (NOISE.force, NOISE.moment, NOISE.contact, NOISE.reach)), radius=1e9)
    table = ContactTable(contacts)
    soft, loud = (estimate_from(table, [0], [Method.FREE], noise, None)[Method.FREE][0] for noise in (FLAT, louder))
    assert loud.rms == pytest.approx(2 * soft.rms, rel=0.02)


def test_beyond_the_limit_the_state_is_blind_and_below_it_is_not():
    taxel, pose = np.array([0.0, 0.0, 0.3]), np.eye(4)
    sds = []
    for tilt in np.geomspace(0.02, 0.5, 12):
        contacts = []
        for number, side in enumerate((-1.0, 1.0), start=1):
            force = 8 * np.array([tilt * side, 0.0, -1.0])
            contacts.append(
                Contact(number, 0, 1, force, np.cross(taxel, force), np.array([0]), np.array([9.0]), pose, "", 0, True)
            )
        estimate = solve(contacts, [0], Method.FREE, NOISE, None)[0]
        sds.append(estimate.sd)
        assert (estimate.state is State.BLIND) == (estimate.sd > POSITION_MAX_SD_M)
        assert abs(estimate.worst_direction[2]) > 0.9
    assert sds == sorted(sds, reverse=True)
    assert sds[0] > POSITION_MAX_SD_M > sds[-1]


def axes_near(rng, point, spread, weights):
    """Axes within `spread` of each other that miss `point` by about a millimetre and have pitch."""
    directions = np.array([0.2, -0.3, -1]) + spread * rng.normal(size=(len(weights), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    moments = np.cross(point, directions) + 1e-3 * rng.normal(size=(len(weights), 3))
    return made(directions, moments, weights)


def made(directions, moments, weights):
    """Directions, m/|f|, weights and the weighted rows of (5)."""
    rows = weights[:, None, None] * orthonormal_pair(directions)
    nearest = np.cross(directions, moments)
    return directions, moments, weights, rows.reshape(-1, 3), np.einsum("nij,nj->ni", rows, nearest).ravel()


def solution(a, b):
    return least_squares(a, b)


def last_digit(rng, values):
    return np.nextafter(values, np.where(rng.random(values.shape) < 0.5, -np.inf, np.inf))


@pytest.mark.parametrize(
    "case", ["parallel 1e-6", "parallel 1e-8", "one heavy", "two heavy", "heavy along x", "mixed", "mixed and parallel 1e-4"]
)
def test_the_solver_loses_no_more_than_its_inputs_last_digit(case):
    """Against 80 digits; the bar is ten times what moving every input by its last digit does to the exact answer."""
    mpmath = pytest.importorskip("mpmath")
    rng = np.random.default_rng(25)
    weights = np.ones(10)
    if "heavy" in case:
        weights[2 if "two" in case else 1 :] = 1e-12
    if "mixed" in case:
        weights = 10.0 ** rng.uniform(-12, 0, 10)
    spread = float(case.split()[-1]) if "parallel" in case else 0.3
    evidence = axes_near(rng, np.array([0.03, 0.02, 0.1]), spread, weights)
    if case == "heavy along x":
        # Its rows are almost zero in the first column, which must then not be taken first.
        along_x = np.array([1.0, 1e-7, -2e-7])
        evidence[0][0] = along_x / np.linalg.norm(along_x)
        evidence = made(*evidence[:3])
    with mpmath.workdps(80):
        exact = by_80_digits(mpmath, evidence)
        moves = []
        for _ in range(10):
            moved = made(*(last_digit(rng, column) for column in evidence[:3]))
            moves.append(np.linalg.norm(by_80_digits(mpmath, moved) - exact))
    for order in (np.arange(10), np.arange(10)[::-1], rng.permutation(10)):
        again = made(*(part[order] for part in evidence[:3]))
        error = np.linalg.norm(solution(*again[3:])[1] - exact)
        assert error <= 10 * max(moves) + 1e-15 * np.linalg.norm(exact)


def by_80_digits(mpmath, evidence):
    """Solve the paper's normal equations of (5) with K^2, where 80 digits make them harmless."""
    left, right = mpmath.zeros(3), mpmath.zeros(3, 1)
    for u, m, k in zip(*(part.tolist() for part in evidence[:3]), strict=True):
        x, y, z = (mpmath.mpf(value) for value in u)
        s = mpmath.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        left += mpmath.mpf(k) ** 2 * s.T * s
        right -= mpmath.mpf(k) ** 2 * s.T * mpmath.matrix(m)
    return np.array([float(value) for value in mpmath.lu_solve(left, right)])


def test_the_triangular_factor_keeps_the_sum_of_squares():
    rng = np.random.default_rng(26)
    a, b = axes_near(rng, np.array([0.03, 0.02, 0.1]), 0.4, rng.uniform(0.1, 1, 9))[3:]
    found = solution(a, b)
    (root, offset), point = found
    least = np.sum((a @ point - b) ** 2)
    for p in rng.normal(0, 0.1, (5, 3)):
        full = np.sum((a @ p - b) ** 2)
        assert np.sum((root @ p - offset) ** 2) == pytest.approx(full - least, rel=1e-9)
    np.testing.assert_allclose(root.T @ root, a.T @ a, atol=1e-13)
