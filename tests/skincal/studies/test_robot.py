"""The study of a robot that pokes: its limits from known rows, and one short session."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from skincal.model.errors import InputError
from skincal.studies import robot


@cache
def short_session(rig: str) -> dict[str, Any]:
    pytest.importorskip("mujoco")
    return robot.run_session(robot.Task(rig, "all", 3, 5))


def test_a_robot_with_all_imperfections_pokes_and_its_pokes_count() -> None:
    session = short_session("arm")
    assert session["pokes"] > 0
    assert session["accepted"] >= 0.6
    assert session["taxels"] == 84
    assert set(session["methods"]) == {"free", "surface", "modules"}


def test_equal_seeds_give_equal_sessions() -> None:
    again = robot.run_session(robot.Task("arm", "all", 3, 5))
    np.testing.assert_equal(again, short_session("arm"))


def rows(*, mean: float = 0.8, inside: float = 0.9, predicted: float = 1.0, accepted: float = 0.95) -> list[dict[str, Any]]:
    methods = {"modules": {"mean_mm": mean, "inside": inside, "predicted_mm": predicted, "true_rms_mm": 1.0, "missing": 0}}
    return [{"rig": "arm", "case": case, "accepted": accepted, "methods": methods} for case in ("none", "all")]


@pytest.mark.parametrize(
    ("wrong", "failing"),
    [
        ({}, set()),
        ({"mean": 1.2}, {"robot_mean_mm"}),
        ({"inside": 0.8}, {"robot_inside_all"}),
        ({"predicted": 1.6}, {"robot_predicted_over_true_most"}),
        ({"predicted": 0.6}, {"robot_predicted_over_true_least"}),
        ({"accepted": 0.8}, {"robot_accepted"}),
    ],
)
def test_limits_fail_where_a_number_is_wrong(wrong: dict[str, float], failing: set[str]) -> None:
    bars = robot.check_limits(robot.robot_limits(rows(**wrong)))
    assert {name for name, bar in bars.items() if not bar["holds"]} == failing


def test_without_mujoco_the_study_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Any:
        raise ImportError(name)

    monkeypatch.setattr("skincal.physics.engine.import_module", missing)
    with pytest.raises(InputError, match=r"pip install 'skincal\[physics\]'"):
        robot.run(True, print)
