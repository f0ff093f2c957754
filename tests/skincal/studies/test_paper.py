"""The paper study itself: small, whole, and what its JSON says."""

import json
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from skincal.plotting import render
from skincal.simulation.poking_strategies import TABLE_I
from skincal.studies import paper
from skincal.studies.paper import QUICK_SIZES, error_statistics, run_good, run_trial

TINY = replace(
    QUICK_SIZES, seeds=2, share=0.15, safety=2, good=1, counts=(28, 252), courses=2, steps=(28, 84)
)  # fmt: skip


@cache
def result():
    said = []
    return paper.run(True, said.append, TINY), said


def test_it_gives_what_is_asked_of_it():
    found, said = result()
    json.dumps(found, allow_nan=False)
    assert set(found["mean_mm"]) == {"free", "surface", "modules", "modules_21", "modules_70"}
    assert set(found["good_rig_mm"]) == {"free", "surface", "modules"}
    assert set(found["per_pose_mm"]) == {"free", "surface", "modules"}
    assert all(list(poses) == list(TABLE_I) for poses in found["per_pose_mm"].values())
    assert all(len(course) == 7 for course in found["averaged_mm"].values())
    assert [row["landmark_pokes"] for row in found["landmarks"]] == [21, 70]
    assert len(said) == 2 + 3
    assert sum("limit " in line for line in paper.summary(found)) == len(found["bars"])


def test_what_is_averaged_first_is_the_first_pose_alone():
    found, _ = result()
    for method in ("free", "surface", "modules"):
        assert found["averaged_mm"][method][0]["mean"] == pytest.approx(found["per_pose_mm"][method]["1"]["mean"])


def test_landmarks_help_and_modules_do():
    found, _ = result()
    assert found["mean_mm"]["modules_21"] < 0.5 * found["mean_mm"]["modules"]
    assert found["good_rig_mm"]["modules"] < 0.5 * found["good_rig_mm"]["surface"]
    assert all(row["held_out_after_mm"] < row["held_out_before_mm"] for row in found["landmarks"])


def test_the_course_of_a_rig_ends_where_all_its_pokes_are_pooled():
    found, _ = result()
    course = found["bad_course_mm"]
    assert course["pokes"] == [28, 84, found["pokes"]]
    for name in ("free", "surface", "modules", "modules_21"):
        assert course[name][-1] == pytest.approx(found["mean_mm"][name], abs=1e-6)
    assert course["modules_21"][-1] < course["modules_21"][0]
    assert course["modules_21"][-1] < 0.5 * course["modules"][-1], "pokes on the skin do not tell what landmarks do"
    assert course["rigs"] == 2


def test_a_trial_is_the_same_again_and_another_seed_is_another_rig():
    first, again, other = run_trial(1, 0.1), run_trial(1, 0.1), run_trial(2, 0.1)
    assert first["pooled"] == again["pooled"]
    assert first["pooled"] != other["pooled"]
    assert first["pokes"] == sum(round(0.1 * minutes * 24) for minutes in TABLE_I.values())


def test_more_pokes_of_a_good_rig_tell_more():
    good = run_good(3, (42, 252))
    assert all(good["course"][252][method]["mean"] < good["course"][42][method]["mean"] for method in ("surface", "modules"))


def test_errors_are_summed_up_in_millimetres():
    assert error_statistics(np.array([0.001, 0.003, np.nan])) == pytest.approx(
        {"mean": 2.0, "sd": 1.0, "largest": 3.0, "missing": 1}
    )


def test_the_figure_is_drawn():
    found, _ = result()
    assert all(len(data) > 10_000 for data in render(partial(paper.draw, found), (12.0, 7.0), ("svg", "png"), 100))
