"""`skincal compare`: sessions, their plan and truth, and files beside each other."""

import json
from pathlib import Path

import pytest

from skincal.cli import main
from skincal.model.scene import resource
from tests.approved import approved

SAMPLE = resource("sessions/sample")


def compared(capsys, *arguments: str) -> dict:
    assert main(["compare", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_error_against_the_truth_is_the_one_that_solve_tells(capsys):
    found = compared(capsys, str(SAMPLE), f"{SAMPLE}:truth")
    assert main(["solve", str(SAMPLE), "--reference", str(SAMPLE / "truth.json"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["methods"]["modules"]["error_mm"]
    assert found["error_mm"]["mean"] == pytest.approx(told["mean"], rel=1e-12)
    assert (found["error_mm"]["worst_channel"], found["taxels"]) == (told["worst_channel"], told["taxels"])
    assert [each["module"] for each in found["modules"]] == [17, 21, 24, 25, 26, 28, 29]
    assert found["first"] == "sample, modules method"
    assert max(found["apart_mm"].values()) == found["error_mm"]["worst"]


def test_a_file_of_a_session_repeats_it_and_its_plan_does_not(capsys, tmp_path: Path):
    path = tmp_path / "positions.csv"
    assert main(["export", str(SAMPLE), "--format", "csv", "--out", str(path)]) == 0
    capsys.readouterr()
    for which in ("free", "surface", "modules"):
        assert compared(capsys, f"{SAMPLE}:{which}", f"{path}:{which}")["error_mm"]["worst"] == 0.0
    plan = compared(capsys, str(path), f"{SAMPLE}:plan")
    motion = plan["common_motion"]
    assert motion["left_mean_mm"] < plan["error_mm"]["mean"]
    assert main(["compare", str(path), f"{SAMPLE}:plan"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == approved("places.pair", first="positions.csv, modules method", second="sample, plan")
    assert f"{motion['turn_deg']:.2f} degrees" in lines[2]
    assert len(lines) == 3 + 7


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            (f"{SAMPLE}:foo", str(SAMPLE)),
            approved("places.not_named", named=f"{SAMPLE}:foo", which="foo", head=SAMPLE),
        ),
        ((str(Path(__file__)), str(SAMPLE)), approved("places.forms")),
        (("nowhere", str(SAMPLE)), approved("places.nowhere", named="nowhere")),
        ((f"{SAMPLE}/truth.json:plan", str(SAMPLE)), "only the folder of a session has a plan"),
        ((str(SAMPLE), f"{SAMPLE}/truth.json:free"), "has no places of the free method"),
    ],
)
def test_what_is_not_there_is_said_in_a_sentence(capsys, arguments, words):
    assert main(["compare", *arguments]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert "Traceback" not in said


def test_a_method_that_a_session_lacks_is_answered_with_what_can_be_typed(capsys, tmp_path):
    assert main(["simulate", "--scene", "flat-patch", "--pokes", "12", "--careful", "--out", str(tmp_path / "s")]) == 0
    capsys.readouterr()
    assert main(["compare", f"{tmp_path / 's'}:surface", str(SAMPLE)]) == 2
    assert approved("places.no_such_method", folder=tmp_path / "s", which="surface") in capsys.readouterr().err
