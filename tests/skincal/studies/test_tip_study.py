"""The study of tip positions, on few pokes."""

from skincal.studies.tip_study import THIS_STUDY
from tests.skincal.studies.studies_support import small


def test_a_tip_shows_the_depth_that_one_poke_a_taxel_does_not():
    result, _ = small("tip")
    alone, both, corrected = (row["methods"]["free"]["mean_mm"] for row in result["tip"])
    assert alone == [None, None]
    assert both[1] < 3.0
    assert corrected[1] < 3.0
    assert result["bars"]["tip_inside"]["holds"]
    assert result["tip"][1]["methods"]["tip"]["mean_mm"][1] > both[1]
    assert any("3 mm after 84 pokes" in line for line in THIS_STUDY.summary(result))
