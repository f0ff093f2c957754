"""The study of tip positions, on few pokes."""

import json

import pytest

from skincal.plotting import render
from skincal.studies import tip_study


@pytest.fixture(scope="module")
def result():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tip_study, "POKE_COUNTS", (42, 84))
        patch.setattr(tip_study, "POKES_PER_TAXEL", 1)
        rows = [
            tip_study._row(rig, sd, [tip_study.run_session(rig, sd, 1)])
            for rig, sd in (("good", None), ("good", 1.0), ("corrected", 1.0))
        ]
    return {"seeds": 1, "tip": rows, "bars": tip_study.check_limits(tip_study.tip_limits(rows))}


def test_a_tip_shows_the_depth_that_one_poke_a_taxel_does_not(result):
    alone, both, corrected = (row["methods"]["free"]["mean_mm"] for row in result["tip"])
    assert alone == [None, None]
    assert both[1] < 3.0
    assert corrected[1] < 3.0
    assert result["bars"]["tip_inside"]["holds"]
    assert result["tip"][1]["methods"]["tip"]["mean_mm"][1] > both[1]


def test_it_is_described_drawn_and_written(result):
    json.dumps(result, allow_nan=False)
    assert any("3 mm after 84 pokes" in line for line in tip_study.summary(result))
    (picture,) = render(lambda figure: tip_study.draw(result, figure), (8.0, 4.0), ("svg",), 100)
    assert b"with a tip of 1 mm" in picture
