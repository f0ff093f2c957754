"""Every small case of the stability study, in the processes that it uses: `python3 -m pytest tests/long`.

Some of them are in `tests/skincal/studies/test_stability.py` and next to it.
"""

import json

import pytest

from skincal.studies import stability
from skincal.studies.stability_cases import module_cases, taxel_cases
from skincal.studies.stability_corrections import added_cases
from tests.skincal.studies.test_stability import TINY


@pytest.fixture(scope="module")
def result():
    said = []
    result = stability.run(quick=True, progress=said.append, sizes=TINY)
    assert len(said) == 1 + sum(len(list(cases(TINY))) for cases in (taxel_cases, module_cases, added_cases))
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
