import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.estimate.evidence import Evidence, across, gather
from skincal.estimate.qr import factor
from skincal.estimate.result import Method, State
from skincal.estimate.solve import estimate_taxels
from skincal.estimate.surface import tangent_basis
from skincal.estimate.uncertainty import SD_MAX, propagate, row_noise
from skincal.scene import NoiseSettings
from skincal.surface.mesh import make_surface
from skincal.wrench import cross_matrix

NOISE = NoiseSettings()
TRIALS = 300
LIMIT = {3: 7.8147, 2: 5.9915}
"""95 % of a chi-square of as many degrees of freedom lie below."""


def sensor_pose():
    """A sensor 0.2 m away and turned: its noise has another lever than the link's origin would give."""
    rotation = np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, [0.05, -0.1, 0.15]
    return pose


def measured(rng, number, taxel, force, pose, noise):
    """A poke of the rig that `noise` describes: contact scattered across the push, wrench with the sensor's noise."""
    push = force / np.linalg.norm(force)
    scatter = tangent_basis(push) @ rng.normal(0, noise.contact, 2)
    place = pose[:3, :3].T @ (taxel + scatter - pose[:3, 3])
    felt = pose[:3, :3].T @ force
    moment = np.cross(place, felt) + rng.normal(0, noise.moment, 3)
    weight = rng.uniform(0.3, 1.0)
    return Contact(
        number, 0, 1, felt + rng.normal(0, noise.force, 3), moment, np.array([0, 1]), np.array([weight, 1.0]), pose, "", 0, True
    )


def pokes(rng, count, taxel, normal, pose, noise, tilt=0.5):
    contacts = []
    for number in range(1, count + 1):
        push = -normal + tilt * rng.uniform(-1, 1, 2) @ tangent_basis(normal).T
        contacts.append(measured(rng, number, taxel, push / np.linalg.norm(push) * rng.uniform(6, 12), pose, noise))
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
        one = estimate_taxels(pokes(rng, count, taxel, normal, sensor_pose(), NOISE), [0], method, NOISE, surface)[0]
        assert one.state is State.ESTIMATED
        off = basis.T @ (one.position - taxel)
        inside += off @ np.linalg.solve(basis.T @ one.covariance @ basis, off) <= LIMIT[len(off)]
        errors.append(np.linalg.norm(one.position - taxel))
        predicted.append(one.rms)
    assert 0.90 <= inside / TRIALS <= 0.99
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.sqrt(np.mean(np.square(predicted))), rel=0.2)


def test_the_lever_runs_from_the_sensor_and_not_from_the_links_origin():
    rng = np.random.default_rng(21)
    only_force = NoiseSettings(force=0.1, moment=1e-9, contact=1e-9)
    pose, normal = sensor_pose(), np.array([0.0, 0.0, 1.0])
    for taxel, quiet in ((pose[:3, 3] + [0, 0, 1e-4], True), (np.array([0.0, 0.0, 0.0]), False)):
        contacts = pokes(rng, 10, taxel, normal, pose, NoiseSettings(1e-12, 1e-12, 1e-12))
        one = estimate_taxels(contacts, [0], Method.FREE, only_force, None)[0]
        # At the sensor's own origin an error of the force turns the axis about the taxel and moves it nowhere.
        assert one.rms < 1e-5 if quiet else one.rms > 1e-3


def row_covariance(evidence, taxel):
    even, less = row_noise(evidence, taxel, NOISE)
    return even[0] * np.eye(2) - np.outer(less[0], less[0])


def test_the_rows_covariance_is_that_of_simulated_rows():
    rng = np.random.default_rng(22)
    pose, taxel = sensor_pose(), np.array([0.03, 0.02, 0.01])
    force = np.array([1.0, -4.0, -7.0])
    exact = gather([measured(rng, 1, taxel, force, pose, NoiseSettings(1e-15, 1e-15, 1e-15))], [0])[0]
    evidence = gather([measured(rng, i, taxel, force, pose, NOISE) for i in range(4000)], [0])[0]
    residuals = np.cross(evidence.directions, taxel) + evidence.moments
    first, second = exact.across[0]
    rows = np.stack([-residuals @ second, residuals @ first], axis=1)
    expected = row_covariance(exact, taxel)
    np.testing.assert_allclose(np.cov(rows.T), expected, atol=0.06 * np.abs(expected).max())


def test_the_covariance_equals_the_sandwich_of_the_papers_three_rows():
    """Each symbol of the model written out over the system (5), 3n rows; the code carries 2n."""
    rng = np.random.default_rng(23)
    taxel, pose = np.array([0.03, 0.02, 0.01]), sensor_pose()
    contacts = pokes(rng, 6, taxel, np.array([0.0, 0.6, 0.8]), pose, NOISE)
    evidence = gather(contacts, [0])[0]
    a, b = evidence.rows()
    own = propagate(evidence, a, factor(a, b).root, taxel, NOISE, np.eye(3))
    k = np.repeat(evidence.weights, 3)
    f = np.concatenate([cross_matrix(u) for u in evidence.directions])
    gain = np.linalg.inv(f.T @ np.diag(k**2) @ f) @ f.T @ np.diag(k**2)
    q = cross_matrix(taxel - pose[:3, 3])
    middle = np.zeros((18, 18))
    for i, (u, size) in enumerate(zip(evidence.directions, evidence.forces, strict=True)):
        c = NOISE.moment**2 * np.eye(3) + NOISE.force**2 * q @ q.T + (size * NOISE.contact) ** 2 * (np.eye(3) - np.outer(u, u))
        middle[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = c / size**2
    np.testing.assert_allclose(own.covariance, gain @ middle @ gain.T, rtol=1e-9)
    values, axes = np.linalg.eigh(gain @ middle @ gain.T)
    assert own.sd == pytest.approx(np.sqrt(values[-1]))
    assert abs(own.weakest @ axes[:, -1]) == pytest.approx(1)


def test_uncertainty_grows_with_noise_and_shrinks_with_pokes():
    rng = np.random.default_rng(24)
    normal, taxel = np.array([0.0, 0.0, 1.0]), np.array([0.03, 0.02, 0.01])
    contacts = pokes(rng, 40, taxel, normal, sensor_pose(), NOISE)
    few, many = (estimate_taxels(contacts[:n], [0], Method.FREE, NOISE, None)[0] for n in (10, 40))
    assert 0.35 < many.rms / few.rms < 0.7
    louder = NoiseSettings(*(2 * value for value in (NOISE.force, NOISE.moment, NOISE.contact)))
    assert estimate_taxels(contacts, [0], Method.FREE, louder, None)[0].rms == pytest.approx(2 * many.rms)


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
        one = estimate_taxels(contacts, [0], Method.FREE, NOISE, None)[0]
        sds.append(one.sd)
        assert (one.state is State.BLIND) == (one.sd > SD_MAX)
        assert abs(one.weakest[2]) > 0.9
    assert sds == sorted(sds, reverse=True)
    assert sds[0] > SD_MAX > sds[-1]


def axes_near(rng, point, spread, weights) -> Evidence:
    """Axes within `spread` of each other that miss `point` by about a millimetre and have pitch."""
    directions = np.array([0.2, -0.3, -1]) + spread * rng.normal(size=(len(weights), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    moments = np.cross(point, directions) + 1e-3 * rng.normal(size=(len(weights), 3))
    return made(directions, moments, weights)


def made(directions, moments, weights):
    count = len(weights)
    return Evidence(directions, moments, np.full(count, 8.0), weights, np.zeros((count, 3)), across(directions))


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
        # Its rows are almost nought in the first column, which must then not be taken first.
        along_x = np.array([1.0, 1e-7, -2e-7])
        evidence.directions[0] = along_x / np.linalg.norm(along_x)
        evidence = made(evidence.directions, evidence.moments, weights)
    with mpmath.workdps(80):
        exact = by_80_digits(mpmath, evidence)
        moves = []
        for _ in range(10):
            directions, moments = last_digit(rng, evidence.directions), last_digit(rng, evidence.moments)
            moved = made(directions, moments, last_digit(rng, weights))
            moves.append(np.linalg.norm(by_80_digits(mpmath, moved) - exact))
    for order in (np.arange(10), np.arange(10)[::-1], rng.permutation(10)):
        one = made(evidence.directions[order], evidence.moments[order], weights[order])
        error = np.linalg.norm(factor(*one.rows()).solution - exact)
        assert error <= 10 * max(moves) + 1e-15 * np.linalg.norm(exact)


def by_80_digits(mpmath, evidence):
    """Solve the paper's normal equations of (5) with K^2, where 80 digits make them harmless."""
    left, right = mpmath.zeros(3), mpmath.zeros(3, 1)
    for u, m, k in zip(evidence.directions.tolist(), evidence.moments.tolist(), evidence.weights.tolist(), strict=True):
        x, y, z = (mpmath.mpf(value) for value in u)
        s = mpmath.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        left += mpmath.mpf(k) ** 2 * s.T * s
        right -= mpmath.mpf(k) ** 2 * s.T * mpmath.matrix(m)
    return np.array([float(value) for value in mpmath.lu_solve(left, right)])


def test_the_triangular_factor_keeps_the_sum_of_squares():
    rng = np.random.default_rng(26)
    a, b = axes_near(rng, np.array([0.03, 0.02, 0.1]), 0.4, rng.uniform(0.1, 1, 9)).rows()
    found = factor(a, b)
    least = np.sum((a @ found.solution - b) ** 2)
    for p in rng.normal(0, 0.1, (5, 3)):
        full = np.sum((a @ p - b) ** 2)
        assert np.sum((found.root @ p - found.offset) ** 2) == pytest.approx(full - least, rel=1e-9)
    np.testing.assert_allclose(found.root.T @ found.root, a.T @ a, atol=1e-13)
