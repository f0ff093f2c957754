"""The runtime study in small sizes: its baselines solve the same problem, its table and limits, its clock."""

import gc
import math
import threading
import time
from dataclasses import replace
from functools import lru_cache, partial

import matplotlib.figure
import numpy as np
import pytest

from skincal.mesh.search import nearest_points
from skincal.mesh.surface import make_surface
from skincal.methods import estimate_taxels
from skincal.simulation.example_parts import SHAPE_OF_PART, forearm
from skincal.studies import baselines, runtime
from skincal.studies.benchmarking import gc_disabled, quartiles, time_words, timed
from skincal.studies.harness import check_limits
from skincal.studies.runtime import SURFACE_SEARCHES, THIS_STUDY, known_positions, main_rows, runtime_limits
from skincal.taxels.result import Method
from tests.approved import approved
from tests.skincal.studies.studies_support import COARSE_TRIANGLES, SIZES, small


@lru_cache
def poked():
    return forearm().contacts(6, seed=1)


@lru_cache
def shipped(method, triangles=None):
    part = forearm()
    return estimate_taxels(poked(), part.channels, [method], part.scene.noise, part.mesh(triangles))[method]


@pytest.mark.parametrize(("name", "off"), [("brute", 1e-12), ("compiled", 1e-12), ("quadprog", 1e-12), ("slsqp", 1e-5)])
def test_other_searches_give_the_shipped_answer_from_their_own_start(name, off):
    problems = baselines.taxel_problems(poked(), forearm().channels, forearm().scene.noise)
    surface, ours = forearm().mesh(1_000), known_positions(shipped(Method.SURFACE, 1_000))
    assert len(ours) > 40
    for channel in list(ours)[:: 20 if name in runtime.SLOW_SEARCHES else 1]:
        assert np.linalg.norm(SURFACE_SEARCHES[name](surface, problems[channel]) - ours[channel]) < off


def test_without_a_facing_triangle_there_is_no_point():
    problems = baselines.taxel_problems(poked(), forearm().channels, forearm().scene.noise)
    surface, problem = forearm().mesh(300), next(iter(problems.values()))
    only = make_surface(surface.vertices, surface.triangles[:1])
    away = problem._replace(push=only.normals[0])
    assert np.isnan(baselines.by_every_triangle(only, away)).all()
    assert np.isnan(SURFACE_SEARCHES["slsqp"](only, away)).all()


def test_the_error_of_a_wrong_baseline_is_measured(monkeypatch):
    monkeypatch.setitem(runtime.SURFACE_SEARCHES, "slsqp", lambda surface, _: surface.vertices[0])
    size = runtime.ProblemSize(forearm(), forearm().mesh(300), 6, [poked()], forearm().channels, 1, 0.0)
    (row,) = (row for row in runtime._surface_rows(size, quadratic=True) if row["method"] == "slsqp")
    assert row["off_ours_m"] > 0.01
    assert row["error_beside_ours_mm"] > 5.0
    assert row["error_mm"]["median"] > 5.0
    assert row["extrapolated_from"]["taxels"] == 1


@pytest.mark.parametrize("way", [baselines.by_lstsq, baselines.by_normal_equations])
def test_the_papers_rows_give_the_shipped_free_answer(way):
    rows = baselines.stack_rows(poked(), forearm().channels)
    ours = known_positions(shipped(Method.FREE))
    doubted = {channel for channel, estimate in shipped(Method.FREE).items() if estimate.doubted}
    pairs = {
        channel: p for channel, p in zip(rows.channels, way(rows), strict=True) if channel in ours and channel not in doubted
    }
    assert len(pairs) > 40
    assert max(np.linalg.norm(p - ours[channel]) for channel, p in pairs.items()) < 1e-10


@pytest.mark.parametrize("name", SHAPE_OF_PART)
@pytest.mark.parametrize("triangles", [300, 1_000, 10_000])
def test_a_generated_mesh_has_the_parts_shape_and_about_the_triangles_wanted(name, triangles):
    mesh, own = SHAPE_OF_PART[name].mesh(triangles), SHAPE_OF_PART[name].mesh(100_000)
    assert abs(len(mesh.triangles) / triangles - 1) < 0.1
    nearest, touched = nearest_points(own, mesh.vertices)
    assert np.abs(nearest - mesh.vertices).max() < 1e-3
    middles = nearest_points(own, mesh.centres.T)[1]
    assert len(touched) == len(mesh.vertices)
    assert (mesh.normals * own.normals[middles]).sum(axis=1).min() > 0.8


def test_contacts_go_through_the_poses_and_are_the_same_again():
    poses = [contact.pose for contact in forearm().contacts(3, seed=5)]
    assert set(poses) == {"1", "2", "3"}
    again = forearm().contacts(3, seed=5)
    assert all(np.array_equal(a.force, b.force) for a, b in zip(forearm().contacts(3, seed=5), again, strict=True))
    assert not np.array_equal(forearm().contacts(3, seed=6)[0].force, again[0].force)


def test_the_table_has_every_method_on_both_parts_and_says_what_was_extrapolated():
    result, _ = small("runtime")
    rows = main_rows(result)
    methods = {row["method"] for row in rows}
    others = {"brute", "compiled", "slsqp", "quadprog", "lstsq", "normal", "surface-per-pose"}
    assert methods >= {"free", "surface", "modules", "modules-general", "modules-per-pose"} | others
    for row in result["table"]:
        assert row["time_ms"]["q1"] <= row["time_ms"]["median"] <= row["time_ms"]["q3"]
        assert row["time_ms"]["median"] > 0
        assert row["error_mm"]["median"] > 0
        part = row["extrapolated_from"]
        if part is not None:
            (kind,) = {"taxels", "modules"} & part.keys()
            assert 0 < part[kind] < part[f"of_{kind}"]
    slsqp = next(row for row in rows if row["method"] == "slsqp")
    assert slsqp["extrapolated_from"] is not None
    assert slsqp["off_ours_m"] < 1e-5


def test_a_general_solver_finds_the_modules_where_the_program_does():
    rows = [row for row in main_rows(small("runtime")[0]) if row["method"] == "modules-general"]
    assert rows
    # It also takes into account how the weights change with the pose, which moves the answer by some hundredths of a mm.
    assert all(0 < row["off_ours_m"] < 3e-4 for row in rows)
    assert all(abs(row["error_beside_ours_mm"]) < 0.5 for row in rows)


def test_a_general_solver_is_measured_on_every_seed():
    """Which seed comes first does not matter, as it would if the others were left out."""
    part = forearm()
    runs = [part.contacts(2, seed) for seed in (1, 2)]
    size = runtime.ProblemSize(part, part.surface, 2, runs, part.channels, 1, math.inf)
    found = []
    for order in (runs, runs[::-1]):
        rows = [
            row for row in runtime._module_rows(replace(size, runs=order)) if row["method"] in ("modules", "modules-general")
        ]
        found.append([row["error_mm"]["median"] for row in rows])
        assert rows[1]["extrapolated_from"] is None
    assert found[0] == pytest.approx(found[1], rel=1e-9)


def test_latency_of_pokes_and_of_a_whole_solve():
    result, _ = small("runtime")
    for poke in result["poke"]:
        assert poke["with_modules_ms"]["median"] > 1.2 * poke["time_ms"]["median"]
        assert poke["time_ms"]["p95"] >= poke["time_ms"]["q3"]
    assert not [name for name in result["bars"] if "p95" in name]
    lines = THIS_STUDY.summary(result)
    assert any("one in twenty" in line for line in lines)
    assert any("extrapolated" in line for line in lines)
    whole = result["whole"]
    assert whole["taxels"] == 84
    for name, ratio in (("time_ms", "resolve_whole_over_numpy"), ("modules_ms", "modules_whole_over_numpy")):
        assert result["ratios"][ratio] == pytest.approx(whole[name]["median"] / whole["numpy_ms"]["median"])


def test_the_ratios_are_those_of_the_table():
    result, _ = small("runtime")
    rows = {row["method"]: row["time_ms"]["median"] for row in main_rows(result)[::-1] if row["pokes_per_taxel"] == 2}
    assert set(rows) >= {"brute", "surface"}
    assert result["ratios"]["brute_over_surface"] > 1
    assert result["ratios"]["slsqp_over_surface"] > result["ratios"]["quadprog_over_surface"] > 1
    assert result["bars"]["brute_equal_m"]["holds"]
    assert {"brute_over_surface", "slsqp_over_surface", "per_taxel_100k_over_1k", "poke_ms"} < set(result["bars"])


def test_growth_holds_two_sizes_and_varies_the_third():
    growth = small("runtime")[0]["growth"]
    assert {round(point["triangles"], -2) for point in growth["triangles"]} == {300, 1000, COARSE_TRIANGLES}
    assert {point["pokes_per_taxel"] for point in growth["pokes_per_taxel"]} == {1, 2}
    assert {point["taxels"] for point in growth["taxels"]} == {24, 84}


def test_a_limit_is_met_on_its_own_side_only():
    ratios = {
        "brute_over_surface": 299.0, "slsqp_over_surface": 10_000.0, "per_taxel_100k_over_1k": 2.1,
        "contacts_over_session": 6.1, "modules_over_surface": 4.9, "poke_modules_over_poke": 4.1,
        "resolve_whole_over_numpy": 7.6, "modules_whole_over_numpy": 50.0,
    }  # fmt: skip
    poke = {"time_ms": {"median": 1.9}, "with_modules_ms": {"median": 5.1}}
    latency = {"poke": [poke], "whole": {"time_ms": {"median": 124.0}, "modules_ms": {"median": 999.0}}}
    limits = check_limits(runtime_limits(ratios, {"brute": 1e-13}, latency))
    assert {name for name, limit in limits.items() if not limit["holds"]} == {
        "brute_over_surface", "per_taxel_100k_over_1k", "poke_modules_ms", "poke_modules_over_poke", "contacts_over_session",
        "resolve_whole_over_numpy",
    }  # fmt: skip
    assert len(limits) == 13


def test_the_study_works_without_quadprog_and_reports_it(monkeypatch):
    monkeypatch.setattr(baselines, "QUADPROG_PACKAGE", "no_such_package")
    monkeypatch.setitem(runtime.SURFACE_SEARCHES, "slsqp", lambda surface, _: surface.vertices[0])
    sizes = SIZES["runtime"]
    small_part = replace(sizes.small, seeds=1, repeats=1, meshes=(), pokes=())
    sizes = replace(sizes, small=small_part, large=replace(sizes.large, budget_s=0.0), growth_until_s=0.0)
    said = []
    result = THIS_STUDY.run(True, said.append, sizes)
    assert approved("study.no_quadprog") in result["left_out"]
    assert approved("study.no_quadprog") in said
    assert "quadprog" not in {row["method"] for row in result["table"]}
    assert "quadprog_over_surface" not in result["ratios"]
    # No time for growth either: this is reported, and the sizes of the ratios are measured.
    assert any("left out" in sentence for sentence in result["left_out"][1:])
    assert "per_taxel_100k_over_1k" in result["ratios"]


def test_the_figure_is_drawn_with_a_name_for_every_method():
    figure = matplotlib.figure.Figure(layout="constrained")
    runtime.draw(small("runtime")[0], figure)
    names = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert sum("as shipped" in name for name in names) >= 2
    assert sum("SLSQP" in name for name in names) >= 1


def test_the_figure_shows_the_live_cost_of_a_poke_against_pokes_and_taxels():
    """On logarithmic axes, with times at its ticks instead of powers of ten."""
    spreads = {
        ("icub-forearm", 84): {100: (1.0, 2.0), 50_000: (45.0, 14.0)},
        ("whole-body", 4_200): {100: (2.0, 3.0), 50_000: (4.0, 6.0)},
    }
    rows = [
        {
            "part": part, "taxels": taxels, "pokes": pokes,
            **{key: quartiles([ms]) for key, ms in zip(("snapshot_ms", "guide_ms"), both, strict=True)},
        }
        for (part, taxels), course in spreads.items()
        for pokes, both in course.items()
    ]  # fmt: skip
    figure = matplotlib.figure.Figure(layout="constrained")
    runtime.draw({**small("runtime")[0], "live": rows}, figure)
    live = figure.subfigs[1].axes[-1]
    drawn = {bars.get_label(): bars[0].get_xydata().tolist() for bars in live.containers}
    assert drawn == {
        "snapshot, 84 taxels": [[100, 0.001], [50_000, 0.045]],
        "guide, 84 taxels": [[100, 0.002], [50_000, 0.014]],
        "snapshot, 4,200 taxels": [[100, 0.002], [50_000, 0.004]],
        "guide, 4,200 taxels": [[100, 0.003], [50_000, 0.006]],
    }
    assert (live.get_xscale(), live.get_yscale()) == ("log", "log")
    figure.draw_without_rendering()
    ticks = {label.get_text() for label in (*live.get_yticklabels(), *live.get_yticklabels(minor=True))}
    assert ticks >= {"1 ms", "2 ms", "5 ms", "10 ms", "20 ms", "50 ms"}
    assert not any("times" in tick for tick in ticks)


def test_a_sample_stops_when_its_time_is_spent_and_never_before_its_first_piece():
    done = []
    works = [partial(lambda k: (done.append(k), time.sleep(0.02)), k) for k in range(100)]
    assert len(timed(works, 0.05)[0]) == len(done) < 20
    assert len(timed(works[:1], 0.0)[0]) == 1
    assert len(timed(iter(works[:2]), 10.0)[0]) == 2


def test_the_work_of_every_thread_counts():
    """The solver shares large problems between two threads: the clock of one of them would count half of the work."""

    def in_two_threads():
        both = [threading.Thread(target=lambda: sum(range(2_000_000))) for _ in range(2)]
        for thread in both:
            thread.start()
        for thread in both:
            thread.join()

    (alone,), _ = timed([lambda: sum(range(2_000_000))])
    (shared,), _ = timed([in_two_threads])
    assert shared > alone


def test_garbage_is_not_collected_while_the_clock_runs():
    assert timed([gc.isenabled] * 2)[1] == [False, False]
    assert gc.isenabled()
    with pytest.raises(ValueError, match="inside"), gc_disabled():
        raise ValueError("inside")
    assert gc.isenabled()


def test_quartiles_and_words_of_times():
    assert quartiles([4.0, 1.0, 2.0, 3.0, 5.0]) == {"median": 3.0, "q1": 2.0, "q3": 4.0, "count": 5}
    words = {0.123: "0.123 ms", 1000.0: "1 s", 90e3: "90 s", 240e3: "4 min", 3.6e7: "10 h"}
    assert {ms: time_words(ms) for ms in words} == words
