"""`skincal compare`: sessions, their plan and truth, and files beside each other."""

from pathlib import Path

import pytest

from skincal.model.scene import resource
from tests.approved import approved

SAMPLE = resource("sessions/sample")


def test_the_error_against_the_truth_is_the_one_that_solve_tells(answered):
    found = answered("compare", str(SAMPLE), f"{SAMPLE}:truth")
    told = answered("solve", SAMPLE, "--reference", SAMPLE / "truth.json")["methods"]["modules"]["error_mm"]
    assert found["error_mm"]["mean"] == pytest.approx(told["mean"], rel=1e-12)
    assert (found["error_mm"]["worst_channel"], found["taxels"]) == (told["worst_channel"], told["taxels"])
    assert [each["module"] for each in found["modules"]] == [17, 21, 24, 25, 26, 28, 29]
    assert found["first"] == "sample, modules method"
    assert max(found["apart_mm"].values()) == found["error_mm"]["worst"]


def test_a_file_of_a_session_repeats_it_and_its_plan_does_not(run, answered, tmp_path: Path):
    path = tmp_path / "positions.csv"
    assert run("export", SAMPLE, "--format", "csv", "--out", path)[0] == 0
    for which in ("free", "surface", "modules"):
        assert answered("compare", f"{SAMPLE}:{which}", f"{path}:{which}")["error_mm"]["worst"] == 0.0
    plan = answered("compare", str(path), f"{SAMPLE}:plan")
    motion = plan["common_motion"]
    assert motion["left_mean_mm"] < plan["error_mm"]["mean"]
    lines = run("compare", path, f"{SAMPLE}:plan")[1].splitlines()
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
        (("notes.txt", str(SAMPLE)), approved("places.forms")),
        (("nowhere", str(SAMPLE)), approved("places.nowhere", named="nowhere")),
        ((f"{SAMPLE}/truth.json:plan", str(SAMPLE)), "only the folder of a session has a plan"),
        ((str(SAMPLE), f"{SAMPLE}/truth.json:free"), "has no places of the free method"),
    ],
)
def test_what_is_not_there_is_said_in_a_sentence(run, arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("notes.txt").write_text("no places\n")
    code, _, err = run("compare", *arguments)
    assert (code, words in err) == (2, True), err


def test_a_method_that_a_session_lacks_is_answered_with_what_can_be_typed(run, tmp_path):
    assert run("simulate", "--scene", "flat-patch", "--pokes", "12", "--careful", "--out", tmp_path / "s")[0] == 0
    code, _, err = run("compare", f"{tmp_path / 's'}:surface", SAMPLE)
    assert code == 2
    assert approved("places.no_such_method", folder=tmp_path / "s", which="surface") in err
