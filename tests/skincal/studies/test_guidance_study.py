"""The guidance study itself: small, whole, and what its JSON says."""

import numpy as np
import pytest

from skincal.simulation.example_parts import forearm
from skincal.simulation.poking_strategies import Conditions
from skincal.studies import guidance_study
from tests.skincal.studies.studies_support import small


def test_it_says_what_each_way_takes():
    found, said = small("guidance")
    assert set(found["pokes_to_5mm"]) == {"guided", *guidance_study.STRATEGIES} == set(found["pokes_to_3mm"])
    assert len(said) == len(found["table"])
    for row in found["table"]:
        assert len(row["pokes"]) == len(row["mean_mm"]) == len(row["p95_mm"])
        assert row["pokes"][-1] == row["limit"]
        assert row["mean_mm"][-1] <= row["mean_mm"][0]
    assert {row["method"] for row in found["table"] if row["case"] == guidance_study.STANDARD_CASE} == {
        "free",
        "surface",
        "modules",
    }
    # Nobody gets to 5 mm within 40 pokes: null, and no number that was not measured.
    assert found["pokes_to_5mm"]["random"] is None
    assert not found["bars"]["guided_pokes_to_5mm"]["holds"]
    assert any("not reached" in line for line in guidance_study.THIS_STUDY.summary(found))


def test_a_process_makes_its_part_once():
    assert forearm() is forearm()


def test_an_interval_holds_the_median_and_is_null_where_it_is_not_reached():
    interval = guidance_study._interval([70.0, 80.0, 90.0, 100.0, float("inf")])
    assert interval["low"] <= interval["median"] == 90.0
    assert interval["high"] is None
    assert guidance_study._interval([float("inf")] * 3)["median"] is None
    many = guidance_study._interval(np.random.default_rng(1).normal(100, 10, 400).tolist())
    assert many["low"] < many["median"] < many["high"]
    assert many["high"] - many["low"] < 4.0


@pytest.mark.parametrize("drift", [0.0, 0.25])
def test_conditions_change_the_rig_alone_where_they_say_so(drift):
    errors = Conditions(drift=drift).errors
    assert errors.drift_force == drift
    assert errors.matrix == 0.0
    assert errors.mount_shift == pytest.approx(0.004 / np.sqrt(2))
