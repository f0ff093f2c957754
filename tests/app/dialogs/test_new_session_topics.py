"""Topics of a running ROS 2 robot in the dialog for a new session: found, proposed, previewed."""

import sys

import pytest

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")

from app.dialogs.new_session import NewSessionDialog
from app.session.opening import Addresses, OpenRequest
from app.session.previews import list_topics
from skincal.model.readings import SENSOR_STREAMS, LinkAnswer, Stream
from skincal.model.scene import resource
from skincal.ros import dds
from tests.skincal.ros.dds_peer import DOMAIN, process

WAIT_MS = 60_000


def test_topics_of_a_robot_are_proposed_and_previewed_with_one_click(qtbot, tmp_path, monkeypatch):
    monkeypatch.setattr("app.dialogs.new_session.list_topics", list_topics)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    with process("/ft=wrench", "/taxels=skin64", "/few=skin", "/joint_states=joints", hz=100):
        dialog = NewSessionDialog(OpenRequest(scene=resource("scenes/flat-patch/scene.toml"), folder=tmp_path / "new"))
        qtbot.addWidget(dialog)
        with qtbot.waitExposed(dialog):
            dialog.open()
        qtbot.waitUntil(dialog.proposal.isVisible, timeout=WAIT_MS)
        assert dialog.proposal.text().endswith("topics /ft, /taxels, /joint_states")
        first = {stream: dialog.rows[stream].box.itemData(0) for stream in SENSOR_STREAMS}
        assert first == {Stream.WRENCH: "ros2:/ft", Stream.SKIN: "ros2:/few", Stream.JOINTS: "ros2:/joint_states"}
        assert not any(row.address for row in dialog.rows.values())
        dialog.proposal.click()
        rows = dialog.rows

        def are_good():
            found = dialog._previews.update()
            return len(found) == 3 and all(each.health.verdict.answer is LinkAnswer.GOOD for each in found.values())

        qtbot.waitUntil(are_good, timeout=WAIT_MS)
        rows[Stream.TIP].set_address("targets:/tip", agreed=True)
        assert dialog.addresses() == Addresses("ros2:/ft", "ros2:/taxels", "ros2:/joint_states", "targets:/tip")
        dialog.reject()


def test_a_missing_package_is_said_where_the_proposal_stands(qtbot, tmp_path, monkeypatch):
    monkeypatch.setattr("app.dialogs.new_session.list_topics", list_topics)
    monkeypatch.setitem(sys.modules, "cyclonedds", None)
    dds._module.cache_clear()
    dialog = NewSessionDialog(OpenRequest(scene=resource("scenes/flat-patch/scene.toml"), folder=tmp_path / "new"))
    qtbot.addWidget(dialog)
    with qtbot.waitExposed(dialog):
        dialog.open()
    qtbot.waitUntil(dialog.topics_note.isVisible, timeout=WAIT_MS)
    assert "pip install 'skincal[ros2]'" in dialog.topics_note.text()
    assert not dialog.proposal.isVisible()
    dialog.reject()
