"""Every small case of the stability study, in the processes that it uses: `python3 -m pytest tests/long`.

Some of them are in `tests/skincal/studies/test_stability.py` and next to it.
"""

import json

import pytest

from skincal.studies import stability
from tests.skincal.studies.test_stability import TINY


@pytest.fixture(scope="module")
def result():
    said = []
    result = stability.THIS_STUDY.run(True, said.append, TINY)
    assert len(said) == 1 + len(list(stability.all_cases(TINY)))
    return result


@pytest.mark.timeout(600)
def test_the_study_has_at_least_forty_cases_and_all_hold(result):
    cases = result["cases"]
    assert len(cases) >= 40
    assert len({case["name"] for case in cases}) == len(cases)
    assert [case["name"] for case in cases if not case["holds"]] == []
    assert result["held"] == len(cases)
    assert json.loads(json.dumps(result, allow_nan=False)) == result


def test_no_bar_is_so_high_that_it_proves_nothing(result):
    loose = [case["name"] for case in result["cases"] if case["bound"] > 1e-3 * case["size"]]
    assert loose == []
