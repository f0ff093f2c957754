"""Positions go to a running robot from the window: it asks first, says what the session has come to, and shows the answers."""

import shutil
import socket

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from app.dialogs.apply_dialog import DEFAULT_PORT, ApplyDialog, offered_port
from app.dialogs.export_dialog import ExportDialog
from app.session.opening import OpenRequest
from app.session.recording import SessionFolder
from app.text.message import NO_SESSION
from skincal.following.results import verdicts_of
from skincal.model.actions import Exclude
from skincal.model.scene import resource
from skincal.simulation.emulated_transports import SkinManagerOutlet
from skincal.taxels.result import Method
from skincal.words.verdict_words import verdict_sentence
from tests.app.whole_window import OPEN_MS
from tests.approved import approved
from tests.skincal.robot.robot_support import robot

CTRL_SHIFT = Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier


def asked(bench) -> ApplyDialog:
    bench.key(Qt.Key.Key_A, CTRL_SHIFT)
    dialog = bench.window.findChild(ApplyDialog)
    assert dialog is not None
    return dialog


def ended(bench, dialog) -> str:
    bench.until(dialog.start.isEnabled, OPEN_MS)
    return dialog.outcome.text()


def test_it_asks_first_sends_beside_the_window_and_shows_what_was_answered(bench, tmp_path):
    folder = shutil.copytree(resource("sessions/sample"), tmp_path / "mine")
    bench.open(OpenRequest(session=folder))
    bench.until_all_is_there()
    manager = SkinManagerOutlet(384)
    with robot(manager) as address:
        dialog = asked(bench)
        assert dialog.verdict.text().startswith(approved("verdict.not_enough", done=78, count=84))
        dialog.address.setText(address)
        QTest.keyClick(dialog, Qt.Key.Key_Space)
        QTest.keyClick(dialog, Qt.Key.Key_Return)
        bench.until(lambda: not bench.window.findChildren(ApplyDialog), OPEN_MS)
        assert not manager.poses.any(), "a key that goes on elsewhere does not change a robot"

        dialog = asked(bench)
        dialog.address.setFocus()
        dialog.address.selectAll()
        QTest.keyClicks(dialog.address, address)
        QTest.keyClick(dialog.address, Qt.Key.Key_Return)
        assert dialog.isVisible(), "Enter after the address closes nothing"
        assert dialog.focusWidget() is dialog.start
        dialog.reject()
        dialog = asked(bench)
        assert dialog.address.text() == address, "what was typed is remembered"
        assert not manager.poses.any()
        dialog.start.click()
        assert not dialog.start.isEnabled()
        dialog.reject()
        assert approved("apply.changed", count=84, part="r_forearm") in ended(bench, dialog)
        lines = [dialog.remarks.item(row).text() for row in range(dialog.remarks.count())]
        assert sum(line.startswith("set pose 5 ") and line.endswith(": 0") for line in lines) == 84
        assert any(f"{folder / 'before-r_forearm.txt'}: `skincal apply " in line for line in lines)
        estimates = bench.snapshot.estimates[bench.window.session_view.method]
        for each in estimates:
            np.testing.assert_allclose(manager.poses[each.channel, :3], each.position, atol=1e-6)

    # The robot is gone: the address is remembered, the sentence shown, the window lives.
    dialog.start.click()
    assert ended(bench, dialog).endswith(approved("apply.unchanged"))
    dialog.reject()
    again = asked(bench)
    assert again.address.text() == address
    again.reject()


def test_whatever_becomes_of_it_the_dialog_says_so_and_the_rest_of_the_window_works_on(bench, tmp_path, monkeypatch):
    folder = shutil.copytree(resource("sessions/sample"), tmp_path / "mine")
    bench.open(OpenRequest(session=folder))
    dialog = asked(bench)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        dialog.address.setText(f"yarp://127.0.0.1:{silent.getsockname()[1]}/skinManager/rpc")
        dialog.start.click()
        beside: list[int] = []
        bench.controller.compute(lambda: 1, beside.append)
        bench.until(lambda: beside == [1])
        assert not dialog.start.isEnabled(), "a robot that does not answer holds up nothing else"
        assert ended(bench, dialog).endswith(approved("apply.unchanged"))
    (tmp_path / "file").touch()
    monkeypatch.setattr(SessionFolder, "folder", tmp_path / "file" / "mine")
    dialog.start.click()
    assert approved("apply.no_folder") in ended(bench, dialog)
    monkeypatch.setattr(bench.controller, "_recording", None)
    dialog.start.click()
    assert NO_SESSION in ended(bench, dialog)
    monkeypatch.undo()
    dialog.reject()
    bench.until(lambda: not bench.window.findChildren(ApplyDialog), OPEN_MS)


def test_the_verdict_is_that_of_the_pokes_at_the_moment_it_is_asked_for(bench, tmp_path):
    bench.open(OpenRequest(session=shutil.copytree(resource("sessions/sample"), tmp_path / "mine")))
    bench.until_all_is_there()
    dialog = asked(bench)
    last = bench.accepted()[-1].poke
    bench.controller.act(Exclude(last))
    bench.until(lambda: last not in {contact.poke for contact in bench.accepted()})
    for method in (Method.FREE, Method.MODULES):
        dialog.method.setCurrentIndex(dialog.method.findData(method))
        view = bench.window.session_view
        (verdict,) = verdicts_of(view.workspace.part, bench.snapshot, (method,), None).values()
        assert dialog.verdict.text() == verdict_sentence(verdict)
    dialog.reject()


def test_the_port_is_asked_for_at_the_name_server_of_the_session():
    assert offered_port(["/dev/ttyUSB0", "yarp:/icub/skin"]) == DEFAULT_PORT
    assert offered_port(["/dev/ttyUSB0", "yarp://10.0.0.1:10000/icub/skin"]) == "yarp://10.0.0.1:10000/skinManager/rpc"


@pytest.mark.parametrize("kind", ["export", "apply"])
def test_a_dialog_whose_task_ends_without_an_answer_can_be_closed(qtbot, tmp_path, kind):
    methods = (Method.FREE,)
    dialog = (
        ExportDialog(methods, Method.FREE, tmp_path / "part")
        if kind == "export"
        else ApplyDialog(methods, Method.FREE, lambda _method: "", DEFAULT_PORT)
    )
    dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose, on=False)
    qtbot.addWidget(dialog)
    dialog.open()
    dialog.start.click()
    dialog.reject()
    assert dialog.isVisible(), "the outcome is not known yet"
    dialog.end_task()
    dialog.reject()
    assert not dialog.isVisible()


def test_the_buttons_of_the_export_stay_in_their_place(qtbot, tmp_path):
    dialog = ExportDialog((Method.FREE, Method.MODULES), Method.FREE, tmp_path / "part")
    dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose, on=False)
    qtbot.addWidget(dialog)
    with qtbot.waitExposed(dialog):
        dialog.show()
    places = set()

    def note_place():
        qtbot.wait(20)
        places.add((dialog.height(), dialog.start.mapTo(dialog, dialog.start.rect().topLeft()).toTuple()))

    for index in range(dialog.format.count()):
        dialog.format.setCurrentIndex(index)
        note_place()
    dialog.start.click()
    note_place()
    dialog.show_written(("Three taxels are not finished.", "The frame is that of the link."))
    note_place()
    assert len(places) == 1


def test_the_window_ends_each_task_of_a_dialog(bench, monkeypatch):
    """Also where the controller calls neither `done` nor `failed`."""
    bench.open(OpenRequest(session=resource("sessions/sample")))
    monkeypatch.setattr(bench.controller, "compute", lambda *_, ended: ended())
    monkeypatch.setattr(bench.controller, "apply", lambda *given: given[-1]())
    for kind, shown in (("export", ExportDialog), ("apply", ApplyDialog)):
        bench.window.commands.actions[kind].trigger()
        dialog = bench.window.findChild(shown)
        dialog.start.click()
        dialog.reject()
        assert not dialog.isVisible()
