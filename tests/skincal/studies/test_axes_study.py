"""The study of axes: its limits, its words, and that it is of no use with wrong readings."""

import numpy as np

from skincal.studies import axes_study
from skincal.studies.axes_study import THIS_STUDY, Task, collect, run_session
from tests.skincal.studies.studies_support import small


def test_the_goals_hold_and_each_case_has_a_line():
    result, said = small("axes")
    held = {name: bar["holds"] for name, bar in result["bars"].items()}
    assert held["axes_normal_deg"]
    assert held["axes_plane_deg"]
    assert held["axes_mistakes_named"]
    assert held["axes_other_mistakes_named"]
    text = "\n".join(THIS_STUDY.summary(result))
    assert "leans up to 15 deg, 20 pokes a taxel" in text
    assert "z negated: named in 1.00" in text
    assert len(said) == len(result["turns"]) + len(result["mistakes"])


def test_readings_of_another_taxel_miss_the_goals(monkeypatch):
    task = Task("noise", 15.0, 8, True, 1)
    right = np.median(run_session(task)["normal"])
    monkeypatch.setattr(axes_study, "collect", lambda forces, readings: collect(forces, readings[:, :, [2, 0, 1]]))
    assert right < 1.0 < 60.0 < np.median(run_session(task)["normal"])
