"""What a scene says of the values in its streams decides which readings are usable."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.model.readings import Batch, Stream
from skincal.model.scene import load_scene, resource
from skincal.streams.expected_readings import ExpectedReadings

NAN = np.nan


def batch(stream, values):
    n = len(values)
    return Batch(stream, np.arange(n), np.arange(n) * 0.01, np.array(values), np.zeros(n, bool), np.zeros(n, bool))


def test_a_scene_names_its_columns_of_joints():
    scene = load_scene(resource("scenes/icub-forearm/scene.toml"))
    expected = ExpectedReadings.of_scene(scene)
    assert expected.channels == scene.skin.channels
    assert expected.used_joints == tuple(scene.arm.arm.joints)
    assert expected.widths[Stream.JOINTS] == expected.joints == max(scene.arm.arm.joints) + 1
    assert ExpectedReadings.of_scene(replace(scene, arm=None)).joints == 0


@pytest.mark.parametrize(
    ("used", "values", "is_usable"),
    [
        ((0, 2), [0.1, NAN, 0.3], True),
        ((0, 2), [0.1, 0.2, NAN], False),
        ((0, 2), [0.1, 0.2], False),
        ((), [0.1, 0.2, 0.3], True),
        ((), [0.1, NAN, 0.3], False),
    ],
)
def test_joints_that_the_scene_does_not_use_may_lack_a_number(used, values, is_usable):
    expected = ExpectedReadings(4, 3, used_joints=used)
    assert expected.has_angles(np.array(values)) is is_usable
    if len(values) == 3:
        assert expected.count_numberless(batch(Stream.JOINTS, [values, [0.0] * 3])) == (not is_usable)


def test_a_skin_frame_is_useless_without_any_number_and_a_wrench_with_one_missing():
    expected = ExpectedReadings(2)
    assert expected.count_numberless(batch(Stream.SKIN, [[NAN, 1.0], [NAN, NAN], [1.0, 2.0]])) == 1
    assert expected.count_numberless(batch(Stream.WRENCH, [[0.0] * 5 + [NAN], [0.0] * 6])) == 1
