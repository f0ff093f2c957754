"""What every study has: JSON, a line for each limit and a figure; and the harness that runs their cases."""

import json
import math

import matplotlib.figure
import pytest

from skincal.studies import STUDIES, load_study
from skincal.studies.harness import Bench, Findings, Study, check_limits, limit_lines, processes, usable_cores
from tests.skincal.studies.studies_support import small


def half(number):
    return number / 2


@pytest.mark.parametrize("name", STUDIES)
def test_a_study_gives_json_a_line_for_each_limit_and_a_figure(name):
    if name == "robot":
        pytest.importorskip("mujoco")
    study, (result, said) = load_study(name), small(name)
    assert (result["study"], result["quick"]) == (name, True)
    text = json.dumps(result, allow_nan=False)
    assert json.dumps(json.loads(text)) == text
    assert said
    assert len(study.summary(result)) == len(study.lines(result)) + len(result.get("bars", ())) > 1
    figure = matplotlib.figure.Figure(layout="constrained")
    study.draw(result, figure)
    figure.draw_without_rendering()
    assert all(panel.has_data() for panel in figure.axes)


def test_runs_of_a_case_become_a_row_and_processes_give_the_same():
    def row(name, found):
        return {"case": name, "sum": sum(found)}

    cases = [("odd", [1.0, 9.0]), ("even", [4.0])]
    for pool in (None, processes()):
        said = []
        # The processes load nothing for a function of Python itself.
        rows = Bench(said.append, pool).rows(iter(cases), math.sqrt, row, lambda row: f"  {row['case']}: {row['sum']:g}")
        assert rows == [{"case": "odd", "sum": 4.0}, {"case": "even", "sum": 2.0}]
        assert said == ["odd: 4", "even: 2"]
    pool.shutdown()


def test_a_study_takes_its_own_sizes_or_those_that_are_given_and_checks_its_limits():
    study = Study(
        "halves", 2.0, 8.0, lambda _, size: Findings({"half": half(size)}, {"small": (half(size), "<=", 3.0)}),
        lambda result: [f"half: {result['half']}"], lambda *_: None, in_processes=False,
    )  # fmt: skip
    assert [study.run(*options)["half"] for options in ((True, print), (False, print), (False, print, 10.0))] == [1.0, 4.0, 5.0]
    result = study.run(False, print)
    assert result["bars"]["small"] == {"value": 4.0, "sign": "<=", "limit": 3.0, "holds": False}
    assert study.summary(result) == ["half: 4.0", "small: 4, limit <= 3: DOES NOT HOLD"]


def test_a_limit_holds_on_its_own_side_and_may_not_be_reached():
    bars = check_limits({"most": (2.0, "<=", 2.0), "least": (1.9, ">=", 2.0), "never": (float("inf"), "<=", 2.0)})
    assert [bar["holds"] for bar in bars.values()] == [True, False, False]
    assert limit_lines(bars)[2] == "never: not reached, limit <= 2: DOES NOT HOLD"


def test_processes_are_as_many_as_cores_may_be_used(monkeypatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {5}, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    assert usable_cores() == 1
