"""At *enough* by the modules method hardly a taxel is falsely done, whoever pokes: `python3 -m pytest tests/long`."""

import pytest

from skincal.simulate.operator import OPERATORS
from tests.skincal.simulate.operators_support import followed

SEEDS = range(1, 25)


@pytest.mark.timeout(600)
@pytest.mark.parametrize("operator", OPERATORS)
def test_hardly_a_taxel_is_falsely_done_and_none_lies_far_beyond_what_is_predicted(operator):
    ended = [followed(operator, seed) for seed in SEEDS]
    assert all(each.enough and each.pokes <= 110 for each in ended)
    done = sum(each.done for each in ended)
    assert done >= 0.97 * 84 * len(ended)
    assert sum(each.falsely for each in ended) <= 0.02 * done
    assert sum(each.beyond for each in ended) == 0
