"""The stability study of modules: reference poses checked another way, that it can fail, and that the shipped method holds."""

from dataclasses import replace

import mpmath
import numpy as np
import pytest

from skincal.mesh.geodesics import MeshPoints, geodesics_of
from skincal.mesh.search import nearest_points
from skincal.mesh.surface import make_surface
from skincal.modules import pose_fit
from skincal.modules.pose_fit import whitened_rows
from skincal.studies import reference_80_digits as reference
from skincal.studies import stability
from skincal.studies.reference_80_digits import find_truth, pose_at, true_pose
from skincal.studies.stability import evaluate, evaluate_alternatives, problem_of, shipped_module
from skincal.studies.stability_cases import PADS_PER_MODULE, CaseSizes, module_cases, on_sheet

TINY = CaseSizes(contacts=7, grid=6, many=300)
CASES = {case.name: case for case in module_cases(TINY)}


def truth_of(name, draws=8):
    return find_truth(CASES[name], draws, np.random.default_rng(list(CASES).index(name)))


def contacts(case):
    """What solvers get: the case, its contacts as they come, and the surface."""
    surface = None if case.mesh is None else make_surface(case.mesh.vertices, case.mesh.triangles)
    return case, np.arange(len(case.readings.forces)), surface


@pytest.mark.parametrize(
    "name", ["module, axes within 1e-1 rad", "module on a sheet, pokes of 1e4 N on one pad, of 1e-4 N elsewhere"]
)
def test_pokes_at_the_very_middles_give_the_pose_they_were_made_of(name):
    np.testing.assert_allclose(
        reference.to_float(truth_of(name, 0).points), CASES[name].module.pad_positions(), rtol=0, atol=1e-15
    )


def matrix(rows):
    return mpmath.matrix([[mpmath.mpf(number) for number in row] for row in rows])


def skew(v):
    return mpmath.matrix([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def misfit(case, poke, place, weights_at):
    """Squared miss of one poke in standard deviations as they are at `weights_at`, place and normal, by another E."""
    mp, noise = mpmath.mpf, case.noise
    pose = matrix(case.readings.poses[case.readings.pose_of[poke]])
    turn, shift = pose[:3, :3], pose[:3, 3]
    f = turn * matrix([[number] for number in case.readings.forces[poke]])
    m = turn * matrix([[number] for number in case.readings.moments[poke]]) + skew(shift) * f
    size = mpmath.norm(f)
    u = f / size
    q = mpmath.qr(mpmath.matrix([[u[0], 1, 2], [u[1], -3, 1], [u[2], 1, 5]]))[0]
    e = q[:, 1:].T
    lever = skew(weights_at[0] - shift)
    torque = (mp(noise.moment) / size) ** 2 * mpmath.eye(3) + (mp(noise.force) / size) ** 2 * lever * lever.T
    s = mp(1.6) * mp(noise.contact) / int((case.readings.responses[poke] > 0).sum())
    o = e * weights_at[1]
    d = e * skew(u) * torque * skew(u).T * e.T + s**2 * (mpmath.eye(2) - o * o.T)
    off = e * (skew(u) * m / size - place)
    return (off.T * mpmath.inverse(d) * off)[0]


def middle(case, poke, origin, x, y):
    answers = [mpmath.mpf(float(number)) for number in case.readings.responses[poke]]
    flat = [[mpmath.mpf(float(number)) for number in pad] for pad in case.module.flat]
    total = sum(answers)
    return origin + sum((x * p[0] + y * p[1]) * (k / total) for k, p in zip(answers, flat, strict=True))


@pytest.mark.parametrize("name", ["module, mirrored, 7 arm poses", "module, contacts known to 1e-6 m"])
def test_at_the_exact_pose_no_small_motion_lessens_the_misfit(name):
    case = CASES[name]
    pokes = reference.pokes_of(case.readings, case.noise)
    ground, _ = reference.find_pose(pokes, true_pose(case))
    with mpmath.workdps(100):
        origin, x, normal = (matrix([[number] for number in v]) for v in (ground.origin, ground.x, ground.normal))
        pokes = range(len(case.readings.forces))
        still = [(middle(case, poke, origin, x, skew(normal) * x), normal) for poke in pokes]

        def total(shift, turn):
            moved = mpmath.expm(skew(turn))
            own = moved * x, moved * skew(normal) * x
            return sum(misfit(case, poke, middle(case, poke, origin + shift, *own), still[poke]) for poke in pokes)

        here, step, none = total(mpmath.zeros(3, 1), mpmath.zeros(3, 1)), mpmath.mpf("1e-20"), mpmath.zeros(3, 1)
        for unknown in range(6):
            way = mpmath.zeros(3, 1)
            way[unknown % 3] = step
            one, other = (total(s * way, none) if unknown < 3 else total(none, s * way) for s in (1, -1))
            # The slope, by central differences, against the curvature times a femtometre.
            assert abs(one - other) / (2 * step) < (one + other - 2 * here) / step**2 * mpmath.mpf("1e-30")


def test_ways_over_a_flat_sheet_are_straight_and_over_a_bent_one_those_that_unfold_it():
    rng = np.random.default_rng(4)
    for bend, limit in ((0.0, 1e-15), (8.0, 1e-16)):
        module = on_sheet(rng, TINY, bend)
        pads = reference.to_float(pose_at(module.at, module.flat, module.mesh).pads().points)
        plane = reference.to_float(pose_at(module.at, module.flat, None).pads().points)
        crossed = np.unique(
            module.ground.place_pads(module.at.select(np.zeros(PADS_PER_MODULE, dtype=np.int64)), module.flat).triangles
        )
        assert len(crossed) > 3
        np.testing.assert_allclose(pads, module.pad_positions(), rtol=0, atol=1e-16)
        if bend == 0:
            np.testing.assert_allclose(pads, plane, rtol=0, atol=limit)


def test_a_walk_from_past_the_rim_and_one_through_a_vertex_come_to_an_end():
    module = on_sheet(np.random.default_rng(1), TINY, aside=0.06)
    ground, walks = module.ground, ground_walks(module)
    past = np.linalg.norm(nearest_points(ground.surface, walks.points)[0] - walks.points, axis=1) > 1e-9
    assert past.all(), "the module stands past the rim"
    beyond = ground.move(module.at, np.array([[0.01, 0.003, 0.0]]))
    np.testing.assert_allclose(np.linalg.norm(beyond.points - module.at.points), np.hypot(0.01, 0.003), rtol=1e-12)
    corner = ground.surface.vertices[ground.surface.triangles[module.at.triangles[0], 0]]
    way = corner - module.at.points[0]
    y = np.cross(module.at.normals[0], module.at.x[0])
    through = ground.move(module.at, 1.5 * np.array([[way @ module.at.x[0], way @ y, 0.0]]))
    np.testing.assert_allclose(through.points[0], module.at.points[0] + 1.5 * way, rtol=0, atol=1e-10)


def ground_walks(module):
    """The walks to a module's pads; none may take long, wherever it begins."""
    footing = MeshPoints(module.at.triangles, module.at.points, module.at.x).select(np.zeros(PADS_PER_MODULE, dtype=np.int64))
    return geodesics_of(module.ground.surface).walk(footing, module.flat)


def test_the_bends_are_how_the_slopes_times_misses_change_beside_the_slopes_themselves():
    for name in ("module, 7 arm poses", "module on a sheet, 7 arm poses"):
        one = problem_of(*contacts(CASES[name]))
        pose = pose_fit.fit_modules(one.touches, one.model, one.start, one.noise, doubting=False).poses
        ground = one.model.ground

        def pull(move, one=one, ground=ground, pose=pose):
            rows = whitened_rows(one.touches, one.place_pads(ground.move(pose, move[None])), one.noise)
            return np.einsum("mid,mi->d", rows.slopes, rows.misses)

        rows = whitened_rows(one.touches, one.place_pads(pose), one.noise)
        predicted = np.sum(rows.bends, axis=0) - np.einsum("mid,mie->de", rows.slopes, rows.slopes)
        step = 1e-7 * np.eye(ground.unknowns)
        measured = np.stack([(pull(way) - pull(-way)) / 2e-7 for way in step], axis=1)
        np.testing.assert_allclose(predicted, measured, rtol=0, atol=1e-6 * np.abs(measured).max())
        without = -np.einsum("mid,mie->de", rows.slopes, rows.slopes)
        assert np.abs(without - measured).max() > 1e-4 * np.abs(measured).max(), "the bends matter"


SOME = [
    "module, axes within 1e-6 rad",
    "module, two pokes",
    "module on a sheet, one poke",
    "module on a sheet, forces 1e-6 to 1e4 N",
    "module on a sheet, pokes of 1e4 N on one pad, of 1e-4 N elsewhere",
    "module on a sheet, levers of 100 m across the push",
    "module on a bent sheet, 7 arm poses",
    "module over the rim of a sheet, 7 arm poses",
    "module, begun 50 degrees and 7.5 mm off",
    "module, every poke there 10 times",
]


@pytest.mark.parametrize("name", SOME)
def test_the_shipped_method_holds(name):
    (record,) = evaluate(CASES[name], truth_of(name))
    assert record["holds"], record


def test_what_pokes_do_not_determine_is_told():
    """One poke on a surface: the pad that answered, no other."""
    truth = truth_of("module on a sheet, one poke", 1)
    assert [pad for pad, known in enumerate(truth.observable) if known] == [4]
    assert sum(truth.must_be_blind) == PADS_PER_MODULE - 1
    assert not any(truth_of("module, two pokes", 1).observable)
    assert all(truth_of("module, newton millimetres by mistake", 1).must_be_blind)


def test_an_unknown_below_the_noise_of_differences_is_zero():
    """Rounding leaves a curvature of 1e-50 for an unknown without evidence, which would give a step of 1e50 m."""
    rows = reference.to_mp([[3.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 0.0]])
    rows[2, 2] = reference.MP.mpf("1e-50")
    found = reference.pseudo_inverse(rows) @ reference.to_mp([5.0, 5.0, 1.0])
    np.testing.assert_array_equal(reference.to_float(found), [1.0, 2.0, 0.0])


NAME = "module on a sheet, 7 arm poses"


@pytest.mark.parametrize(("share", "holds"), [(0.5, True), (2.0, False)])
def test_an_answer_off_by_more_than_the_bar_is_caught(share, holds):
    truth = truth_of(NAME)

    def off(*one):
        at = reference.to_float(truth.points)
        at[3] += share * (10 * truth.sensitivity_m[3] + 1e-15 * np.linalg.norm(at[3])) / np.sqrt(3)
        return at, shipped_module(*one)[1]

    assert evaluate(CASES[NAME], truth, off)[0]["holds"] is holds


def test_a_pad_that_is_called_known_and_is_not_is_caught():
    name = "module on a sheet, one poke"
    known = np.zeros(PADS_PER_MODULE, dtype=bool)
    (sure,) = evaluate(CASES[name], truth_of(name), lambda *parts: (shipped_module(*parts)[0], known))
    assert not sure["holds"]
    assert sure["error"] == reference.ERROR_OF_FAILED_SOLVER_M


def test_a_method_that_follows_the_numbers_of_the_pokes_is_caught():
    def by_number(case, order, surface):
        points, blind = shipped_module(case, order, surface)
        return points + 1e-17 * order[0], blind

    (record,) = evaluate(CASES[NAME], truth_of(NAME), by_number)
    assert record["error"] <= record["bound"]
    assert not record["same_bits"]
    assert not record["holds"]


def test_a_search_that_ends_at_a_nanometre_is_caught(monkeypatch):
    monkeypatch.setattr(pose_fit, "POSE_SEARCH_CONVERGED_STEP_M", 1e-9)
    monkeypatch.setattr(pose_fit, "_rules_in_solver", pose_fit._rules_in_solver.__wrapped__)
    name = "module, 7 arm poses"
    (record,) = evaluate(CASES[name], truth_of(name))
    assert record["error_over_bound"] > 10


def test_a_differenced_jacobian_is_caught():
    shares = {record["method"]: record["error_over_bound"] for record in evaluate_alternatives(CASES[NAME], truth_of(NAME))}
    assert set(shares) == set(stability.MODULE_ALTERNATIVES)
    assert shares["least_squares, differenced"] > 100


def test_a_search_from_anywhere_near_ends_at_the_same_place():
    case = CASES["module, 7 arm poses"]
    ends = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        start = case.module.ground.move(case.module.at, 0.002 * rng.normal(size=(1, 6)))
        ends.append(shipped_module(*contacts(replace(case, start=start)))[0])
    for end in ends[1:]:
        np.testing.assert_allclose(end, ends[0], rtol=0, atol=1e-14)
