"""The order of the values of a frame, from its strongest value in each poke."""

import numpy as np
import pytest

from skincal.contacts.value_order import OrderOfValues, ValueOrderCounts, count_strongest
from skincal.model.skin_axes import ResponseRule, SkinAxes, ValueOrder

TAXELS = 7


def counts_of(sent, read, pokes, seed=1):
    rng, counts = np.random.default_rng(seed), ValueOrderCounts()
    device = SkinAxes(sent, (1, 1, -1), (0, 1, 2), ResponseRule.PUSH, "raw")
    scene = SkinAxes(read, (1, 1, -1), (0, 1, 2), ResponseRule.PUSH, "raw")
    for _ in range(pokes):
        vectors = rng.normal(size=(TAXELS, 3))
        vectors[rng.integers(0, TAXELS)] = [*rng.uniform(-30, 30, 2), -80.0]
        counts = counts.plus(count_strongest(scene, device.as_frames(vectors)))
    return counts


@pytest.mark.parametrize("sent", ValueOrder)
@pytest.mark.parametrize("read", ValueOrder)
def test_a_wrong_order_is_certain_within_20_pokes_and_a_right_one_never_doubted(sent, read):
    found = OrderOfValues(counts_of(sent, read, 20), read)
    assert found.is_wrong == (sent is not read)
    assert found.counts.on_z(sent) == 20
    assert (found.log_odds_wrong > 0) == (sent is not read)


def test_few_pokes_are_not_enough():
    assert not any(
        OrderOfValues(counts_of(ValueOrder.BY_AXIS, ValueOrder.BY_TAXEL, 2, seed), ValueOrder.BY_TAXEL).is_wrong
        for seed in range(9)
    )


def test_a_frame_without_a_change_counts_for_nothing():
    axes = SkinAxes(ValueOrder.BY_TAXEL, (1, 1, -1), (0, 1, 2), ResponseRule.PUSH, "raw")
    assert count_strongest(axes, np.zeros(9)) == count_strongest(axes, np.full(9, np.nan)) == ValueOrderCounts()


def test_counts_add_up():
    assert ValueOrderCounts(3, 2, 1).plus(ValueOrderCounts(4, 0, 4)) == ValueOrderCounts(7, 2, 5)
