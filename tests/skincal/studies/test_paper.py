"""The paper study itself: small, whole, and what its JSON says."""

import numpy as np
import pytest

from skincal.simulation.poking_strategies import TABLE_I
from skincal.studies.paper import error_statistics, run_trial
from tests.skincal.studies.studies_support import small


def test_it_gives_what_is_asked_of_it():
    found, said = small("paper")
    assert set(found["mean_mm"]) == {"free", "surface", "modules", "modules_21", "modules_70"}
    assert set(found["good_rig_mm"]) == {"free", "surface", "modules"}
    assert set(found["per_pose_mm"]) == {"free", "surface", "modules"}
    assert all(list(poses) == list(TABLE_I) for poses in found["per_pose_mm"].values())
    assert all(len(course) == 7 for course in found["averaged_mm"].values())
    assert [row["landmark_pokes"] for row in found["landmarks"]] == [21, 70]
    assert len(said) == 2 + 3


def test_what_is_averaged_first_is_the_first_pose_alone():
    found, _ = small("paper")
    for method in ("free", "surface", "modules"):
        assert found["averaged_mm"][method][0]["mean"] == pytest.approx(found["per_pose_mm"][method]["1"]["mean"])


def test_landmarks_help_and_modules_do():
    found, _ = small("paper")
    assert found["mean_mm"]["modules_21"] < 0.5 * found["mean_mm"]["modules"]
    assert found["good_rig_mm"]["modules"] < 0.5 * found["good_rig_mm"]["surface"]
    assert all(row["held_out_after_mm"] < row["held_out_before_mm"] for row in found["landmarks"])


def test_more_pokes_of_a_good_rig_tell_more():
    course = small("paper")[0]["course_mm"]
    assert course["pokes"] == [42, 252]
    assert all(course[method][1] < course[method][0] for method in ("surface", "modules"))


def test_the_course_of_a_rig_ends_where_all_its_pokes_are_pooled():
    found, _ = small("paper")
    course = found["bad_course_mm"]
    assert course["pokes"] == [28, 84, found["pokes"]]
    for name in ("free", "surface", "modules", "modules_21"):
        assert course[name][-1] == pytest.approx(found["mean_mm"][name], abs=1e-6)
    assert course["modules_21"][-1] < course["modules_21"][0]
    assert course["modules_21"][-1] < 0.5 * course["modules"][-1], "pokes on the skin do not tell what landmarks do"
    assert course["rigs"] == 2


def test_a_trial_is_the_same_again_and_another_seed_is_another_rig():
    first, other = small("paper")[0]["trials"]
    assert run_trial(1, 0.1)["pooled"] == first["pooled"] != other["pooled"]
    assert first["pokes"] == sum(round(0.1 * minutes * 24) for minutes in TABLE_I.values())


def test_errors_are_summed_up_in_millimetres():
    assert error_statistics(np.array([0.001, 0.003, np.nan])) == pytest.approx(
        {"mean": 2.0, "sd": 1.0, "largest": 3.0, "missing": 1}
    )
