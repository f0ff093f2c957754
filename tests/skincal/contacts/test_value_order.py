"""The order of the values of a frame, from its strongest value in each poke."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.detector import ContactDetector
from skincal.contacts.skin_condition import SkinCondition
from skincal.contacts.value_order import OrderOfValues, ValueOrderCounts, count_strongest
from skincal.model.codec import from_json, to_json
from skincal.model.skin_axes import ResponseRule, SkinAxes, ValueOrder
from tests.skincal.contacts.three_axis_support import VectorScript
from tests.skincal.poke_script import small_scene

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


def test_pokes_without_a_z_in_the_order_of_the_scene_are_counted():
    assert ValueOrderCounts(6, 2, 2).has_no_z(ValueOrder.BY_TAXEL)
    assert not ValueOrderCounts(5, 0, 5).has_no_z(ValueOrder.BY_TAXEL)
    assert not ValueOrderCounts(6, 3, 0).has_no_z(ValueOrder.BY_TAXEL)


def test_another_order_is_open_only_if_most_pokes_are_on_its_z():
    found = [OrderOfValues(ValueOrderCounts(20, 0, on_z), ValueOrder.BY_TAXEL) for on_z in (6, 9, 10)]
    assert [each.log_odds_wrong > 0 for each in found] == [True] * 3
    assert [each.is_open for each in found] == [False, False, True], "axes that are exchanged have no z in either"


def test_counts_add_up():
    assert ValueOrderCounts(3, 2, 1).plus(ValueOrderCounts(4, 0, 4)) == ValueOrderCounts(7, 2, 5)


def scene_with(order):
    scene = small_scene()
    return replace(scene, skin=replace(scene.skin, axes=SkinAxes(order, (1, 1, -1), (0, 1, 2), ResponseRule.PUSH, "raw")))


def test_the_detector_counts_pokes_on_the_skin_also_rejected_ones_and_no_others():
    """Frames come grouped by axis; the scene says by taxel. The last press misses the skin, whose noise says nothing."""
    script = VectorScript(scene_with(ValueOrder.BY_AXIS), skin_noise=0.8).quiet()
    for taxel in (3, 7, 8, 12, 17, 4):
        script.press(np.array([0.5, 0.0, -8.0]), np.array([0.0, 0.0, 0.1]), {taxel: (9.0, -4.0, -80.0)}).quiet()
    script.press(np.array([0.5, 0.0, -8.0]), np.array([0.0, 0.0, 0.1]), {}).quiet()
    detector = ContactDetector(scene_with(ValueOrder.BY_TAXEL))
    script.run(detector)
    assert detector.value_order is not None
    assert (detector.value_order.pokes, detector.value_order.on_z_by_axis) == (6, 6)
    assert detector.value_order.is_wrong(ValueOrder.BY_TAXEL)
    # Their z is the y or x of other taxels as often as it is a z.
    assert detector.value_order.on_z_by_taxel < 4
    stored = to_json(detector.condition)
    assert from_json(SkinCondition, stored).value_order == detector.value_order
    assert "value_order" not in to_json(ContactDetector(small_scene()).condition)
