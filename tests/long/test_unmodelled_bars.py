"""The bars of rigs that are wrong as nothing models, on rigs that no threshold was found by: `python3 -m pytest tests/long`.

How they are counted is in `tests/skincal/studies/test_unmodelled.py`.
"""

import pytest

from skincal.studies.harness import Bench, check_limits, processes
from skincal.studies.unmodelled import unmodelled, unmodelled_limits

CASES = ["nothing", "gaussian", "moderate", "wander"]
ASKED = {
    "inside_as_modelled", "inside", "inside_worst", "predicted_off_by_factor", "mean_over_audit", "wrongly_believed_share",
    "plain_inside_least", "plain_inside_most",
}  # fmt: skip


@pytest.mark.timeout(600)
def test_the_bars_hold_on_rigs_of_the_second_simulator():
    with processes() as pool:
        bars = check_limits(unmodelled_limits(unmodelled(12, CASES, 1001, Bench(print, pool))))
    assert {name.removeprefix("unmodelled_") for name in bars} == ASKED
    assert {name: bar for name, bar in bars.items() if not bar["holds"]} == {}
