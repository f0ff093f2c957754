"""The study of a robot that pokes: its limits from known rows, and one short session."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skincal.mesh.load import load_surface
from skincal.model.errors import InputError
from skincal.physics.effects import Effects
from skincal.physics.engine import Touch
from skincal.physics.robots import make_robot
from skincal.physics.session import RobotSession, make_client
from skincal.robot.target_lines import Judged, PokeTarget
from skincal.studies import robot
from skincal.studies.error_numbers import mean_over_seeds
from skincal.studies.harness import check_limits
from skincal.taxels.result import Method
from tests.skincal.studies.studies_support import SIZES, small


def test_a_robot_with_all_imperfections_pokes_and_its_pokes_count() -> None:
    pytest.importorskip("mujoco")
    (session,) = small("robot")[0]["robot"]
    assert session["pokes"] > 0
    assert session["accepted"] >= 0.6
    assert session["taxels"] == 84
    assert set(session["methods"]) == {"free", "surface", "modules"}
    assert all(own["solve_ms"] > 0.0 for own in session["methods"].values())


def test_equal_seeds_give_equal_sessions() -> None:
    pytest.importorskip("mujoco")
    (row,) = small("robot")[0]["robot"]
    session = robot.run_session(robot.Task("arm", "all", 1, SIZES["robot"].max_pokes))
    for name in ("pokes", "accepted", "no_taxel", "minutes"):
        assert session[name] == row[name]
    for method, own in session["methods"].items():
        means = mean_over_seeds([own])
        for name in ("mean_mm", "inside", "predicted_mm", "missing"):
            assert means[name] == row["methods"][method][name]


def rows(
    *, mean: float = 0.8, inside: float = 0.9, predicted: float = 1.0, accepted: float = 0.95, enough: float = 1.0
) -> list[dict[str, Any]]:
    methods = {"modules": {"mean_mm": mean, "inside": inside, "predicted_mm": predicted, "true_rms_mm": 1.0, "missing": 0}}
    return [
        {"rig": "arm", "case": case, "accepted": accepted, "enough": enough, "methods": methods} for case in ("none", "all")
    ]


@pytest.mark.parametrize(
    ("wrong", "failing"),
    [
        ({}, set()),
        ({"mean": 1.2}, {"robot_mean_mm"}),
        ({"inside": 0.8}, {"robot_inside_all"}),
        ({"predicted": 1.6}, {"robot_predicted_over_true_most"}),
        ({"predicted": 0.6}, {"robot_predicted_over_true_least"}),
        ({"accepted": 0.8}, {"robot_accepted"}),
        ({"enough": 0.9}, {"robot_enough"}),
    ],
)
def test_limits_fail_where_a_number_is_wrong(wrong: dict[str, float], failing: set[str]) -> None:
    bars = check_limits(robot.robot_limits(rows(**wrong)))
    assert {name for name, bar in bars.items() if not bar["holds"]} == failing


def test_without_mujoco_the_study_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Any:
        raise ImportError(name)

    monkeypatch.setattr("skincal.physics.engine.import_module", missing)
    with pytest.raises(InputError, match=r"pip install 'skincal\[physics\]'"):
        replace(robot.THIS_STUDY, in_processes=False).run(True, print)


def test_a_part_that_is_pressed_onto_a_fixed_tip_is_calibrated(tmp_path: Path) -> None:
    """The arm's pose changes on the way to each target: each is asked for once, and the force axis meets the true contact."""
    pytest.importorskip("mujoco")
    scene = robot.scene_of("moving part", tmp_path)
    assert scene.surface is not None
    surface = load_surface(scene.surface)[0]
    arm = make_robot(scene, surface, Effects.none(), 1)
    session = RobotSession(scene, surface, arm, method=Method.MODULES)
    client = make_client(arm, surface, session.targets.answer)
    asked: list[int] = []
    judged: list[str] = []
    touches: list[Touch] = []
    while len(judged) < 2 and arm.time_s < 60.0:
        while (line := session.targets.poll()) is not None:
            asked += [line.number] if isinstance(line, PokeTarget) else []
            judged += [line.reason] if isinstance(line, Judged) else []
            client.receive_line(line)
        client.run_period()
        touches += [touch] if (touch := arm.engine.touch()) is not None else []
    outcomes = [record.outcome for record in session.pipeline.snapshot().pokes]
    assert len({outcome.pose for outcome in outcomes}) > 1
    assert judged == [""] * 2
    assert len(asked) <= 3, "no target is asked for twice"
    for outcome in outcomes:
        assert outcome.link_from_sensor is not None
        assert outcome.force is not None
        assert outcome.moment is not None
        force, moment = (outcome.link_from_sensor[:3, :3] @ each for each in (outcome.force, outcome.moment))
        near = min(touches, key=lambda touch: float(np.linalg.norm(touch.force - force)))
        # Lever of the contact point: the moment about it is 0.
        lever = near.point - outcome.link_from_sensor[:3, 3]
        assert np.linalg.norm(moment - np.cross(lever, force)) / np.linalg.norm(force) < 5e-4
