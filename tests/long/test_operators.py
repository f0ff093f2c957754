"""At *enough*, or when it is given up, hardly a taxel is falsely done, whoever pokes: `python3 -m pytest tests/long`."""

import pytest

from skincal.simulation.operator import OPERATORS
from skincal.taxels.result import Method
from tests.skincal.simulation.operators_support import followed

SEEDS = range(1, 25)
FEW = range(1, 4)
LONGEST = 700
"""Pokes on 84 taxels after which a hand that does not come to an end is stopped."""
LEAST_DONE = {"careful": 0.6, "biased": 0.3, "arc": 0.3}
"""Share of the taxels that the free method calls done by then; other hands hardly any."""


@pytest.mark.timeout(600)
@pytest.mark.parametrize("operator", OPERATORS)
def test_hardly_a_taxel_is_falsely_done_and_none_lies_far_beyond_what_is_predicted(operator):
    ended = [followed(operator, seed) for seed in SEEDS]
    assert all(each.enough and each.pokes <= 110 for each in ended)
    done = sum(each.done for each in ended)
    assert done >= 0.97 * 84 * len(ended)
    assert sum(each.far for each in ended) <= 0.02 * done
    assert sum(each.beyond for each in ended) == 0


@pytest.mark.timeout(600)
@pytest.mark.parametrize("operator", OPERATORS)
def test_by_the_free_method_hardly_a_taxel_that_is_done_is_falsely_so(operator):
    ended = [followed(operator, seed, LONGEST, Method.FREE) for seed in FEW]
    done = sum(each.done for each in ended)
    assert done >= LEAST_DONE.get(operator, 0.0) * 84 * len(ended)
    assert sum(each.falsely for each in ended) <= 0.02 * done
    assert sum(each.far for each in ended) <= 0.1 * done


@pytest.mark.timeout(600)
@pytest.mark.parametrize("operator", OPERATORS)
def test_by_the_surface_method_hardly_a_taxel_is_falsely_done(operator):
    ended = [followed(operator, seed, LONGEST, Method.SURFACE) for seed in FEW]
    done = sum(each.done for each in ended)
    assert done >= 0.6 * 84 * len(ended)
    assert sum(each.falsely for each in ended) <= 0.02 * done
    assert sum(each.far for each in ended) <= 0.02 * done
