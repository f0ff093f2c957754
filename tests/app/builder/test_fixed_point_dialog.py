"""The fixed-point test in the window: touches of a stream give the tip, a wrong form is named, and the draft gets both."""

import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.builder.fixed_point_dialog import FixedPointDialog
from app.dialogs.dialog import StandardButton
from skincal.model.errors import InputError
from skincal.model.pose_form import PoseForm, RotationForm, SentPose
from skincal.model.tool_pose import write_poses
from skincal.part.tool_draft import ToolDraft
from skincal.rig.touch_series import REST_S, RestWindow, TouchSeries

TIP = np.array([0.010, 0.0, 0.120])
POINT = np.array([0.4, -0.2, 0.1])
VECTOR = PoseForm(RotationForm.ROTATION_VECTOR)
LEANS = np.array([(0.1, 3.0, 0.0), (0.5, 2.6, 0.3), (-0.4, 2.9, 0.2), (0.2, 2.5, -0.6), (0.0, -2.8, 0.5), (2.1, -2.0, 0.2)])
"""(6, 3) rad: rotation vectors of a tool that points down."""


def touching(leans=LEANS, noise=0.0002, seed=1) -> np.ndarray:
    """Poses (n, 4, 4) of a tool whose tip is at the point."""
    poses = np.tile(np.eye(4), (len(leans), 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(leans).as_matrix()
    poses[:, :3, 3] = POINT - poses[:, :3, :3] @ TIP + noise * np.random.default_rng(seed).standard_normal((len(leans), 3))
    return poses


def touch(dialog, pose, form=VECTOR) -> None:
    """Hold the tool still at a pose, and press the key: the numbers are those of `form`, as the device sends them."""
    (numbers,) = write_poses(pose[None], form)
    dialog.live.sent_pose = SentPose(tuple(numbers.tolist()), form, 1.0)
    dialog._rest = RestWindow()
    dialog._rest.add(time.monotonic() - REST_S, [pose[:3].ravel()])
    dialog.live.read.emit([pose[:3].ravel()] * 3)
    dialog.take_touch()


@pytest.fixture
def made(qtbot):
    def make(**tool):
        dialog = FixedPointDialog(ToolDraft(**tool))
        qtbot.addWidget(dialog)
        return dialog

    return make


def test_four_touches_give_the_tip_and_the_draft_gets_it(made, qtbot):
    dialog = made(rotation="vector", unit="m", degrees=False)
    ok = dialog.button(StandardButton.Ok)
    for number, pose in enumerate(touching(LEANS[:4])):
        assert not ok.isEnabled()
        assert dialog.list.count() == number
        touch(dialog, pose)
    assert "Tip in the tool's frame" in dialog.said.text()
    assert dialog.count.text() == "4 touches"
    assert "misses the point by" in dialog.list.item(0).text()
    with qtbot.waitSignal(dialog.found) as caught:
        ok.click()
    (tool,) = caught.args
    assert np.array(tool.tip_mm) == pytest.approx(TIP * 1e3, abs=1.5)
    assert tool.rotation == "vector"


def test_a_wrong_form_is_named_and_taken_over(made):
    dialog = made(rotation="rpy", unit="m", degrees=False)
    for pose in touching():
        touch(dialog, pose)
    assert "read as rotation vector in radians" in dialog.said.text()
    assert not dialog.button(StandardButton.Ok).isEnabled()
    assert dialog.use_form.isVisibleTo(dialog)
    dialog.use_form.click()
    assert "Tip in the tool's frame" in dialog.said.text()
    dialog.found.connect(lambda tool: setattr(dialog, "got", tool))
    dialog.button(StandardButton.Ok).click()
    assert (dialog.got.rotation, dialog.got.degrees) == ("vector", False)


def test_a_touch_that_is_off_is_seen_in_the_list_and_removed(made):
    dialog = made(rotation="vector", unit="m", degrees=False)
    poses = touching()
    poses[2, :3, 3] += (0.0, 0.008, 0.0)
    for pose in poses:
        touch(dialog, pose)
    assert "no other reading fits" in dialog.said.text()
    assert "Touch 3 misses most" in dialog.said.text()
    dialog.list.setCurrentRow(2)
    dialog.remove.click()
    assert dialog.list.count() == 5
    assert "Tip in the tool's frame" in dialog.said.text()


def test_a_moving_tool_and_a_silent_stream_are_no_touch(made):
    dialog = made()
    dialog.take_touch()
    assert "No pose of the tool came yet" in dialog.said.text()
    dialog.live.sent_pose = SentPose((0.0,) * 6 + (1.0,), PoseForm(RotationForm.QUATERNION_XYZW), 1.0)
    first, second = touching(LEANS[:2])
    dialog.live.read.emit([second[:3].ravel()] * 3)
    dialog.take_touch()
    assert "has just begun" in dialog.said.text()
    dialog._rest = RestWindow()
    dialog._rest.add(time.monotonic() - REST_S, [first[:3].ravel()])
    dialog.live.read.emit([second[:3].ravel()] * 3)
    dialog.take_touch()
    assert "hold it still" in dialog.said.text()
    assert dialog.list.count() == 0
    rest = RestWindow()
    rest.add(0.0, [second[:3].ravel()] * 3)
    for at in (0.2, 0.4, 0.6):
        rest.add(at, [first[:3].ravel()])
    with pytest.raises(InputError, match="hold it still"):
        rest.require_rest(0.6)
    rest.add(0.8, [first[:3].ravel()])
    rest.require_rest(0.8)
    rest.add(2.0, [np.full(12, np.nan)])
    with pytest.raises(InputError, match="0 poses came"):
        rest.require_rest(2.0)
    # Of a stream that fell silent nothing is added.
    rest = RestWindow()
    for at in (0.0, 0.2, 0.4, 0.6):
        rest.add(at, [first[:3].ravel()])
    rest.require_rest(0.6)
    with pytest.raises(InputError, match="1 pose came"):
        rest.require_rest(1.0)


def test_touches_in_another_number_of_values_begin_again():
    six, seven = SentPose((0.0,) * 6, VECTOR, 1.0), SentPose((0.0,) * 7, PoseForm(RotationForm.QUATERNION_XYZW), 1.0)
    assert TouchSeries((six, six)).added(seven).touches == (seven,)
    assert TouchSeries((six, seven)).removed([0]).missing == 3
