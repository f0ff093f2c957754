"""Simulated sessions of the shipped pad with three axes: bytes, decoder, gates, turns; and wrong scenes of it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from skincal.axes.module_axes import AxisMistakeKind
from skincal.axes.taxel_frames import FrameState
from skincal.files.reference import find_truth
from skincal.following.background import run_at_once
from skincal.following.setup_follower import SetupFollower
from skincal.geometry import rotation_vector
from skincal.model.errors import InputError
from skincal.model.scene import load_scene, resource
from skincal.model.skin_axes import ValueOrder
from skincal.part.part import lay_part
from skincal.simulation.device import DeviceSettings
from skincal.simulation.operator import Habits
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.rig_of_scene import make_rig
from skincal.simulation.simulated_rig import Rig
from skincal.simulation.virtual_session import simulate_session
from skincal.taxels.result import Method

SCENE = load_scene(resource("scenes/three-axis-pad/scene.toml"))
QUICK = DeviceSettings(wrench_hz=200.0)


def simulate(folder, pokes=20, errors=None, seen_as=None):
    how = {"habits": Habits.careful(), "settings": QUICK, "seen_as": seen_as}
    return simulate_session(SCENE, None, folder, pokes, 3, errors or RigErrors.noise(), **how)


def with_axes(**changes):
    assert SCENE.skin.axes is not None
    return replace(SCENE, skin=replace(SCENE.skin, axes=replace(SCENE.skin.axes, **changes)))


def mistakes(pipeline):
    return [(each.kind, each.axes) for each in pipeline.session.axis_results().findings(Method.MODULES).mistakes]


def test_the_turns_of_a_simulated_session_are_those_of_its_truth(tmp_path):
    pipeline = simulate(tmp_path / "s")
    found, channels = pipeline.session.axis_results(), list(pipeline.session.channels)
    truth = find_truth(tmp_path / "s", "pad", channels)
    for channel, frame in found.frames(Method.MODULES).items():
        assert frame.state is FrameState.BY_MODULE
        off = rotation_vector(frame.rotation.T @ truth.axes[channel])
        assert np.degrees(np.linalg.norm(off)) < 2.0
    assert mistakes(pipeline) == []
    order = pipeline.snapshot().value_order
    assert (order.counts.pokes, order.counts.on_z_by_taxel) == (20, 20)
    # The second pad is mounted a quarter turn further.
    quarter = rotation_vector(truth.axes[0].T @ truth.axes[12])
    assert np.degrees(quarter) == pytest.approx([0.0, 0.0, 90.0], abs=12.0)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"order": ValueOrder.BY_AXIS}, (AxisMistakeKind.ORDER, ())),
        ({"places": (1, 0, 2)}, (AxisMistakeKind.EXCHANGED, ("x", "y"))),
        ({"signs": (1, -1, -1)}, (AxisMistakeKind.OPPOSITE, ("y",))),
    ],
)
def test_a_wrong_scene_of_the_axes_is_named_and_gives_no_frame(changes, expected, tmp_path):
    pipeline = simulate(tmp_path / "s", seen_as=with_axes(**changes))
    assert mistakes(pipeline) == [expected]
    assert not any(frame.is_known for frame in pipeline.session.axis_results().frames(Method.MODULES).values())
    # The operator hears of it while the session goes on, once.
    follower, snapshot = SetupFollower(lay_part(pipeline.scene, None, ()), run_at_once), pipeline.snapshot()
    follower.check_skin(snapshot, pipeline.totals)
    (news,) = (each for each in follower.take_news() if "axes of the readings" in each or "no z" in each)
    assert "in [skin]" in news
    follower.check_skin(snapshot, pipeline.totals)
    assert follower.take_news() == []


def test_a_rig_of_one_axis_refuses_three_and_a_raw_skin_rests_in_the_middle_of_its_range():
    with pytest.raises(InputError, match="taxels of one axis; leave out axes = 3"):
        Rig(SCENE, None, RigErrors.none(), np.random.default_rng(1))
    scene = with_axes(unit="raw")
    scene = replace(scene, skin=replace(scene.skin, range=(0.0, 4095.0)))
    rig = make_rig(scene, None, RigErrors.none(), np.random.default_rng(1))
    readings = np.zeros((1, 24, 3))
    readings[0, 5] = [0.5, -0.2, -2.0]
    (frame,) = rig.skin_frame(readings, np.random.default_rng(2))
    # The values of z rise under a push; 100 raw units a newton.
    assert frame.reshape(24, 3)[5] == pytest.approx([2047.5 + 50, 2047.5 - 20, 2047.5 + 200])
    assert set(np.delete(frame, [15, 16, 17])) == {2047.5}
    assert len(json.loads(json.dumps(rig.truth()))["taxels"][0]["rotation"]) == 3
