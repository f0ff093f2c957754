"""The stability study of taxels: its reference answers, that it can fail, and that the shipped solvers hold."""

from dataclasses import replace

import matplotlib.figure
import mpmath
import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.mesh.surface import make_surface
from skincal.model.actions import Exclude, Restore, Undo
from skincal.session.session import Session
from skincal.studies import reference_80_digits as reference
from skincal.studies import stability
from skincal.studies.stability import TAXEL_ALTERNATIVES, evaluate, shipped_taxel
from skincal.studies.stability_cases import (
    CaseSizes,
    Readings,
    TaxelPresses,
    arm_poses,
    cone,
    perturbed,
    sheet,
    taxel_cases,
    unit,
)
from skincal.taxels.result import PER_TAXEL
from tests.skincal.poke_script import same_estimates, small_scene
from tests.skincal.studies.studies_support import STABILITY_CASES, small

TINY = CaseSizes(contacts=6, grid=4, many=300)
CASES = {case.name: case for case in taxel_cases(TINY)}


@pytest.fixture(autouse=True)
def digits():
    with mpmath.workdps(120):
        yield


def rows_of_the_paper(readings: Readings):
    """(5) with K and (6) row by row in mpmath: A (3n, 3) and b (3n)."""
    mp = mpmath.mpf
    rows, right = [], []
    for i in range(len(readings.forces)):
        pose = mpmath.matrix([[mp(float(x)) for x in row] for row in readings.poses[readings.pose_of[i]]])
        turn, shift = pose[:3, :3], pose[:3, 3]
        f = turn * mpmath.matrix([mp(float(x)) for x in readings.forces[i]])
        m = turn * mpmath.matrix([mp(float(x)) for x in readings.moments[i]]) + skew(shift) * f
        k = mp(float(readings.responses[i])) / mp(float(readings.strongest[i]))
        size = mpmath.norm(f)
        s = skew(f) * (k / size)
        # Not the first row first: mpmath divides by zero where the leading element is zero.
        rows += [[s[r, c] for c in range(3)] for r in (1, 2, 0)]
        right += [-k * m[r] / size for r in (1, 2, 0)]
    return mpmath.matrix(rows), mpmath.matrix(right)


def skew(v):
    return mpmath.matrix([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def difference(ours, theirs):
    return float(max(abs(mpmath.mpf(str(a)) - b) for a, b in zip(ours, theirs, strict=True)))


@pytest.mark.parametrize(
    "name",
    [
        "axes within 1e-9 rad",
        "weights 1 to 1e-12, 5 arm poses",
        "heavy axes within 1e-9 rad, light ones of 1e-12 fix the depth",
        "levers of 10000 m",
        "forces 1e-6 to 1e4 N",
    ],
)
def test_the_exact_answer_is_that_of_a_qr_of_the_papers_rows(name):
    readings = CASES[name].readings
    a, b = rows_of_the_paper(readings)
    theirs, _ = mpmath.qr_solve(a, b)
    equations = reference.normal_equations(readings)
    assert difference(reference.solve_positive(equations.n, equations.h)[0], theirs) < 1e-30


@pytest.mark.parametrize("name", ["one axis, many forces", "one axis, far sensor, general pose"])
def test_the_blind_answer_is_least_across_the_direction_that_the_papers_rows_say_least_of(name):
    readings = CASES[name].readings
    a, b = rows_of_the_paper(readings)
    ours, blind = (
        mpmath.matrix([mpmath.mpf(number) for number in v]) for v in reference.solve_blind(reference.normal_equations(readings))
    )
    n, h = a.T * a, a.T * b
    value = (blind.T * n * blind)[0]
    assert mpmath.norm(blind) == pytest.approx(1.0)
    assert value < 1e-25 * (n[0, 0] + n[1, 1] + n[2, 2]), "the smallest of the eigenvalues"
    assert mpmath.norm(n * blind - blind * value) < 1e-60
    pull = n * ours - h
    assert abs((ours.T * blind)[0]) < 1e-50
    assert mpmath.norm(pull - blind * (blind.T * pull)[0]) < 1e-50


def least_on_triangle(a, b, corners):
    """Minimise |A p - b| over a triangle in mpmath, by QR in its plane and along its edges: the value and the point."""
    places = [mpmath.matrix([mpmath.mpf(float(x)) for x in corner]) for corner in corners]
    found = []
    edges = [places[1] - places[0], places[2] - places[0]]
    plane = mpmath.matrix(3, 2)
    for column in range(2):
        plane[:, column] = edges[column]
    s, t = mpmath.qr_solve(a * plane, b - a * places[0])[0]
    if s >= 0 and t >= 0 and s + t <= 1:
        found.append(places[0] + edges[0] * s + edges[1] * t)
    for i in range(3):
        one, edge = places[i], places[(i + 1) % 3] - places[i]
        along = a * edge
        share = (along.T * (b - a * one))[0] / (along.T * along)[0]
        found.append(one + edge * min(max(share, 0), 1))
    return min(((mpmath.norm(a * p - b), p) for p in found), key=lambda pair: pair[0])


@pytest.mark.parametrize(
    "name",
    [
        "a bent sheet, inside a triangle",
        "a flat sheet, 0.3 mm over an edge",
        "a bent sheet, 0.3 mm over a vertex",
        "heavy axis 1e-09 rad from the surface, the rest weigh 1e-06",
        "at the rim",
        "needles 1e+04 times as long as wide",
    ],
)
def test_the_exact_answer_on_a_surface_is_that_of_qr_over_all_triangles(name):
    case = CASES[name]
    a, b = rows_of_the_paper(case.readings)
    push = np.array([float(x) for x in reference.mean_push(case.readings)])
    surface = make_surface(case.mesh.vertices, case.mesh.triangles)
    facing = case.mesh.corners[surface.normals @ unit(push) < 0]
    _, theirs = min((least_on_triangle(a, b, corners) for corners in facing), key=lambda pair: pair[0])
    ours = reference.best(reference.normal_equations(case.readings), reference.to_mp(facing))
    assert difference(ours, theirs) < 1e-30


def test_triangles_left_out_of_the_draws_are_the_best_in_none():
    case = CASES["heavy axis 1e-11 rad from the surface, the rest weigh 1e-09"]
    truth = reference.find_truth(case, 5, np.random.default_rng(1))
    rng = np.random.default_rng(1)
    push = np.array([float(x) for x in reference.mean_push(case.readings)])
    facing = make_surface(case.mesh.vertices, case.mesh.triangles).normals @ unit(push) < 0
    changes = []
    for _ in range(5):
        drawn = perturbed(case, rng)
        other = reference.best(reference.normal_equations(drawn.readings), reference.to_mp(drawn.mesh.corners[facing]))
        changes.append(reference.distance(truth.points[0], other))
    assert truth.sensitivity_m == (max(changes),)
    assert max(changes) > 0


def test_a_perturbation_moves_every_number_by_one_unit_in_its_last_place():
    readings = CASES["weights 1 to 1e-12, 5 arm poses"].readings
    other = perturbed(readings, np.random.default_rng(1))
    for name in ("forces", "moments", "strongest"):
        before, after = getattr(readings, name), getattr(other, name)
        assert (np.nextafter(before, after) == after).all()
        assert len(np.unique(np.sign(after - before))) == 2, "up and down"
    np.testing.assert_array_equal(readings.responses == readings.strongest, other.responses == other.strongest)
    np.testing.assert_array_equal(readings.poses[:, 3], other.poses[:, 3])
    assert (readings.poses[:, :3] != other.poses[:, :3]).all()
    assert (perturbed(np.array([0.0, -0.0]), np.random.default_rng(1)) == 0).all()


def truth_of(name, draws=8):
    return reference.find_truth(CASES[name], draws, np.random.default_rng(list(CASES).index(name)))


SOME = [
    "axes within 1e-3 rad",
    "axes within 1e-9 rad",
    "one axis, many forces",
    "one heavy axis, the rest weigh 1e-09",
    "one heavy axis, 1e-12 within 1e-4 rad of it",
    "levers of 10000 m",
    "300 readings",
    "a bent sheet, on a vertex",
    "surface, axes within 1e-9 rad",
    "heavy axis 1e-09 rad from the surface, the rest weigh 1e-06",
    "two sheets, the axes tell which",
    "a triangle 1e-09 m high",
]


@pytest.mark.parametrize("name", SOME)
def test_the_shipped_solvers_hold(name):
    for record in evaluate(CASES[name], truth_of(name)):
        assert record["holds"], record


def unsorted(case, order, _surface):
    """QR of the rows in their order."""
    return stability.by_qr(*stability.two_rows(case.readings.ordered(order)))[0][None], np.zeros(1, bool)


def by_order(case, order, surface):
    points, blind = shipped_taxel(case, order, surface)
    return points + 1e-17 * order[0], blind


def without_direction(case, order, surface):
    points, blind = shipped_taxel(case, order, surface)
    return np.stack([points[0], np.full(3, np.nan)]), blind


def without_a_number(*_):
    return np.full((1, 3), np.nan), np.zeros(1, bool)


@pytest.mark.parametrize(
    ("solver", "name", "low", "high", "same_bits"),
    [
        (unsorted, "one heavy axis, the rest weigh 1e-09", 100, 1e20, False),
        (by_order, "a bent sheet, inside a triangle", 0, 1, False),
        (without_direction, "one axis, read many times", 1e300, 1e300, True),
        (without_a_number, "two axes that cross", 1e300, 1e300, True),
    ],
)
def test_a_wrong_solver_is_caught(solver, name, low, high, same_bits):
    record = evaluate(CASES[name], truth_of(name), solver)[-1]
    assert not record["holds"]
    assert low <= record["error_over_bound"] <= high
    assert record["same_bits"] is same_bits


def test_normal_equations_fail_on_near_parallel_axes():
    name = "axes within 1e-6 rad"
    records = stability.evaluate_alternatives(CASES[name], truth_of(name))
    shares = {record["method"]: record["error_over_bound"] for record in records}
    assert set(shares) == set(TAXEL_ALTERNATIVES)
    assert shares["normal equations"] > 100 > 1 > shares["QR, rows as they come"]


@pytest.fixture(name="result")
def result_of_a_few_cases():
    """A study of a few cases; `tests/long` has it of all."""
    result, said = small("stability")
    assert said[0].startswith("tolerance")
    assert len(said) == 1 + len(STABILITY_CASES)
    return result


def test_the_result_agrees_with_itself(result):
    cases = result["cases"]
    assert len({case["name"] for case in cases}) == len(cases)
    assert {case["solver"] for case in cases} == {"free", "surface", "modules", "added"}
    assert [case["name"] for case in cases if not case["holds"]] == []
    assert (result["held"], result["misses"]) == (len(cases), [])
    for case in cases:
        assert case["holds"] == (case["error"] <= case["bound"] and case["same_bits"])
        assert case["error_over_bound"] == pytest.approx(case["error"] / case["bound"])


def test_a_study_names_the_cases_that_miss_their_bound(monkeypatch):
    name = "distances between three modules"
    monkeypatch.setattr(stability, "tolerance", lambda change, _: 1e-9 * change)
    study = replace(stability.THIS_STUDY, in_processes=False)
    result = study.run(True, lambda _: None, replace(TINY, draws=1, only=frozenset([name])))
    assert f"{name}: places" in result["misses"]
    assert result["held"] + len(result["misses"]) == len(result["cases"])


def test_the_summary_names_misses_and_the_figure_every_family(result):
    broken = list(result["cases"])
    broken[3] = {**broken[3], "holds": False, "error_over_bound": reference.ERROR_OF_FAILED_SOLVER_M}
    result = {**result, "cases": broken, "held": len(broken) - 1}
    lines = stability.describe(result)
    assert lines[0].startswith(f"{len(broken) - 1} of {len(broken)} cases hold")
    assert next(line for line in lines if line.startswith("MISSES")).startswith(f"MISSES: {broken[3]['name']}")
    figure = matplotlib.figure.Figure(layout="constrained")
    stability.draw(result, figure)
    figure.draw_without_rendering()
    drawn = {label.get_text() for panel in figure.axes for label in panel.get_yticklabels()}
    assert drawn >= {case["family"] for case in broken}


def test_a_summary_needs_no_case_of_every_solver(result):
    some = {**result, "cases": [case for case in result["cases"] if case["solver"] == "free"], "alternatives": []}
    assert any(line.startswith("free: ") for line in stability.describe(some))


def stiff_pokes(first, count, weights, rng, mesh):
    """Pokes of two taxels on a sheet over two arm poses; channel 3 answers by `weights`."""
    corners = mesh.corners[len(mesh.triangles) // 2]
    push = -unit(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    directions = cone(rng, count, 0.4, push)
    readings = TaxelPresses(directions, weights=weights, poses=arm_poses(rng, 2, 0.3)).simulate(rng)
    return [
        Contact(
            first + i, 0.0, 1.0, readings.forces[i], readings.moments[i], np.array([3, 5]),
            np.array([readings.responses[i], readings.strongest[i]]), readings.poses[readings.pose_of[i]],
            f"pose {readings.pose_of[i]}", 0.0, True,
        )
        for i in range(count)
    ]  # fmt: skip


@pytest.mark.parametrize("away", [Exclude, Undo], ids=["excluded", "undone"])
def test_pokes_added_and_taken_away_leave_every_estimate_where_it_was(away):
    rng = np.random.default_rng(9)
    mesh = sheet(rng, 8)
    surface = make_surface(mesh.vertices, mesh.triangles)
    light = stiff_pokes(1, 8, np.geomspace(1e-2, 1e-9, 8), rng, mesh)
    heavy = stiff_pokes(9, 6, 1.0, rng, mesh)
    never, session = Session(small_scene(), surface), Session(small_scene(), surface)
    for poke in light:
        never.add(poke)
    for poke in light + heavy:
        session.add(poke)
    assert not same_estimates(session.snapshot(), never.snapshot()), "the heavy pokes move the estimates"
    for poke in reversed(heavy):
        session.act(Undo() if away is Undo else Exclude(poke.poke))
        session.snapshot()
    np.testing.assert_allclose(positions(session), positions(never), rtol=0, atol=1e-12)
    assert same_estimates(session.snapshot(), never.snapshot()), "and not by a bit"


def test_pokes_taken_away_and_brought_back_leave_every_estimate_where_it_was():
    rng = np.random.default_rng(10)
    mesh = sheet(rng, 8)
    session = Session(small_scene(), make_surface(mesh.vertices, mesh.triangles))
    for poke in stiff_pokes(1, 12, np.geomspace(1, 1e-9, 12), rng, mesh):
        session.add(poke)
    before, there = session.snapshot(), positions(session)
    for poke in (1, 7, 12):
        session.act(Exclude(poke))
    assert not same_estimates(session.snapshot(), before)
    for poke in (7, 12, 1):
        session.act(Restore(poke))
    np.testing.assert_allclose(positions(session), there, rtol=0, atol=1e-12)
    assert same_estimates(session.snapshot(), before)


def positions(session):
    """Every position of every method, at least one taxel by each that knows taxels alone."""
    estimates = session.snapshot().estimates
    placed = {
        method: [estimate.position for estimate in estimates[method] if estimate.position is not None] for method in estimates
    }
    assert all(placed[method] for method in PER_TAXEL)
    placed = {method: found for method, found in placed.items() if found}
    return np.concatenate(list(placed.values()))
