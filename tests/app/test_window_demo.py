"""The first window: what a newcomer is told, that the rig is simulated, the end; and nothing is lost without a question."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import pytest
from PySide6.QtCore import QSettings, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QMessageBox

from app import session_view
from app.dialogs.history_dialog import HistoryDialog
from app.dialogs.new_session import NEEDS_CONFIRMATION, NewSessionDialog
from app.dialogs.verdict_dialog import VerdictDialog
from app.panels.first_minute import FirstMinute
from app.session.controller import DEMO_SPEED_FACTOR
from app.session.opening import OpenRequest, server_command
from app.state.running import Running
from app.text.demo_text import FIRST_MINUTE, OTHER_RIG, UNKNOWN_RIG, pace_words, simulated_words
from app.text.message import Message, closed_words, kept_words
from skincal.model.scene import resource
from skincal.session.replay import replay
from tests.app.whole_window import HAND, OPEN_MS, Bench

Key = Qt.Key


def demo(scene: str = "flat-patch") -> OpenRequest:
    path = resource(f"scenes/{scene}/scene.toml")
    return OpenRequest(scene=path, server=(*server_command(path), *HAND), demo=True)


def card_of(bench) -> FirstMinute:
    (card,) = bench.window.findChildren(FirstMinute)
    return card


def test_a_newcomer_is_told_four_things_once(bench, qtbot, tmp_path):
    bench.open(demo())
    card = card_of(bench)
    assert card.isVisible()
    assert QSettings("skincal", "test").value("window/told", type=bool), "also where the window closes within the minute"
    assert len(FIRST_MINUTE) == 4
    bench.until_all_is_there()
    view = bench.window.session_view.workspace.view
    narrow = view.width()
    assert narrow >= 420
    bench.key(Key.Key_Escape)
    assert not card.isVisible()
    bench.qtbot.waitUntil(lambda: view.width() > narrow + card.width() / 2)
    bench.window.leave()
    other = Bench(qtbot, tmp_path / "again")
    other.open(demo())
    assert other.window.findChildren(FirstMinute) == []


def test_it_says_how_quick_it_is_shift_p_changes_that_and_a_line_of_the_history_takes_back(bench):
    bench.open(demo())
    line, action = bench.window.session_view.workspace.now.simulated, bench.window.commands.actions["pace"]
    assert line.text() == simulated_words(DEMO_SPEED_FACTOR, Running.STREAMING)
    for pace in (4, 1, 2):
        bench.key(Key.Key_P, Qt.KeyboardModifier.ShiftModifier)
        assert bench.controller.pace == pace
        assert line.text() == simulated_words(pace, Running.STREAMING)
        assert action.text() == pace_words(pace)
    assert line.isVisible()
    the_history_takes_back_down_to_a_line(bench)


def answer(bench, button: str) -> None:
    """Press a button of the question, by its name; Enter where none is named."""
    bench.until(lambda: isinstance(QApplication.activeWindow(), QMessageBox), 5000)
    box = QApplication.activeWindow()
    if not button:
        QTest.keyClick(box, Key.Key_Return)
        return
    next(each for each in box.buttons() if each.text().replace("&", "") == button).click()


def poked(bench) -> int:
    bench.open(demo())
    bench.until(lambda: len(bench.accepted()) >= 1)
    bench.key(Key.Key_Space)
    bench.until_all_is_taken_in()
    return len(bench.snapshot.pokes)


@pytest.mark.parametrize("kept_before", [False, True], ids=["once", "by Ctrl+S before the answer"])
def test_enter_keeps_a_provisional_session(bench, kept_before):
    assert poked(bench) >= 1
    pipeline = bench.recording.pipeline
    bench.window.close()
    if kept_before:
        bench.controller.keep()
    assert bench.window.isVisible(), "it waits for the answer"
    answer(bench, "")
    bench.until(lambda: not bench.window.isVisible(), OPEN_MS)
    (kept,) = bench.documents.iterdir()
    # With a press that was in progress at the pause.
    assert len(replay(kept).snapshot().pokes) == len(pipeline.snapshot().pokes)


def test_a_provisional_session_is_asked_about_before_it_goes(bench, recorded):
    pokes = poked(bench)
    the_verdict_that_is_due_waits_until_the_question_is_answered(bench)
    the_question_counts_the_pokes_that_come_meanwhile(bench, pokes)
    nothing_happens_until_the_answer(bench, recorded, pokes)


def the_verdict_that_is_due_waits_until_the_question_is_answered(bench):
    view = bench.window.session_view
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(session_view, "DEMO_VERDICT_DELAY_MS", 0)
        bench.window.close()
        bench.until(lambda: isinstance(QApplication.activeWindow(), QMessageBox), 5000)
        may = replace(view.state.may, ends=True)
        patch.setattr(view, "_completed", lambda moment: replace(moment, may=may))
        view.show()
        bench.qtbot.wait(50)
        assert isinstance(QApplication.activeModalWidget(), QMessageBox)
        assert not bench.window.findChildren(VerdictDialog)
        answer(bench, "Cancel")
        bench.until(lambda: bool(bench.window.findChildren(VerdictDialog)), 5000)
    bench.window.findChildren(VerdictDialog)[0].reject()


def the_question_counts_the_pokes_that_come_meanwhile(bench, pokes):
    bench.window.open(OpenRequest(scene=resource("scenes/flat-patch/scene.toml")))
    assert str(pokes) in bench.window._question.text()
    more = replace(bench.recording.pipeline.snapshot(), pokes=bench.snapshot.pokes * 2)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench.recording.pipeline, "snapshot", lambda *_: more)
        bench.until(lambda: f" {len(more.pokes)} poke" in bench.window._question.text(), 5000)
    answer(bench, "Cancel")
    bench.until(lambda: len(bench.snapshot.pokes) == pokes, 5000)


def nothing_happens_until_the_answer(bench, recorded, pokes):
    bench.window.tell(Message("It is so with the first session.", error=True))
    bench.window.open(OpenRequest(session=recorded))
    answer(bench, "Cancel")
    assert len(bench.snapshot.pokes) == pokes
    assert "It is so with the first session." in told(bench)
    bench.window.open(OpenRequest(session=recorded))
    with bench.qtbot.waitSignal(bench.controller.session_opened, timeout=OPEN_MS):
        answer(bench, "Do not keep")
    assert "It is so with the first session." not in told(bench), "the list is about the open session"
    assert "It is so" not in bench.window.messages.text.text() or not bench.window.messages.isVisible()
    assert not bench.documents.exists()
    assert bench.controller.unsaved_pokes == 0
    bench.window.close()
    assert not bench.window.isVisible(), "a recording in its own folder is not asked about"


def test_the_next_session_says_where_the_one_before_is_kept(bench, recorded):
    poked(bench)
    bench.window.open(OpenRequest(session=recorded))
    with bench.qtbot.waitSignal(bench.controller.session_opened, timeout=OPEN_MS):
        answer(bench, "Keep")
    (kept,) = bench.documents.iterdir()
    assert closed_words(kept) in told(bench)
    assert kept_words(kept) not in told(bench), "it is no longer this session"


def told(bench) -> str:
    return "\n".join(message.text for _, message in bench.window.messages.kept)


def test_a_kept_simulated_session_is_marked_and_asks_before_it_connects(bench):
    bench.open(demo())
    bench.until(lambda: len(bench.accepted()) >= 2)
    bench.controller.keep()
    (kept,) = bench.documents.iterdir()
    bench.open(OpenRequest(session=kept))
    assert len(bench.accepted()) >= 2
    assert bench.controller.running is Running.OFFLINE
    simulated = bench.window.session_view.workspace.now.simulated
    bench.until(lambda: simulated.text() == simulated_words(1, Running.OFFLINE), 5000)
    bench.key(Key.Key_Space)
    answer(bench, "Cancel")
    assert bench.controller.running is Running.OFFLINE
    before = len(bench.accepted())
    truth = (kept / "truth.json").read_bytes()
    moved = json.loads(truth)
    moved["taxels"][3]["position_m"][0] += 0.002
    (kept / "truth.json").write_text(json.dumps(moved))
    bench.key(Key.Key_Space)
    answer(bench, "Go on")
    bench.until(lambda: told(bench).endswith(OTHER_RIG), OPEN_MS)
    assert bench.controller.running is Running.OFFLINE
    (kept / "truth.json").write_bytes(truth)
    bench.key(Key.Key_Space)
    answer(bench, "Go on")
    bench.until(lambda: bench.controller.running is Running.STREAMING, OPEN_MS)
    bench.until(lambda: len(bench.accepted()) > before)
    assert bench.controller.has_simulator
    assert (kept / "truth.json").read_bytes() == truth
    bench.window.leave()


def test_a_session_of_an_unnamed_simulated_rig_says_how_to_go_on(bench, tmp_path):
    folder = shutil.copytree(resource("sessions/sample"), tmp_path / "s")
    bench.open(OpenRequest(session=folder))
    bench.key(Key.Key_Space)
    assert told(bench).endswith(UNKNOWN_RIG)
    assert bench.controller.running is Running.OFFLINE
    bench.window.leave()


def test_a_simulated_session_proposes_no_address_that_nothing_answers(bench, tmp_path):
    """Its links are named `simulated:wrench` and the like: A asks for devices, and shows none."""
    folder = shutil.copytree(resource("sessions/sample"), tmp_path / "s")
    (folder / "truth.json").unlink()
    bench.open(OpenRequest(session=folder))
    assert "simulated:skin" in {link.address for link in bench.controller.links}
    bench.key(Key.Key_Space)
    assert told(bench).endswith(UNKNOWN_RIG)
    bench.key(Key.Key_A)
    bench.until(lambda: isinstance(QApplication.activeWindow(), NewSessionDialog), OPEN_MS)
    dialog = QApplication.activeWindow()
    assert {row.address for row in dialog.rows.values()} == {""}
    assert not any(NEEDS_CONFIRMATION in row.verdict.text() for row in dialog.rows.values())
    dialog.reject()
    bench.window.leave()


def the_history_takes_back_down_to_a_line(bench):
    bench.until(lambda: len(bench.accepted()) >= 2)
    bench.key(Key.Key_Space)
    bench.until_all_is_taken_in()
    count = len(bench.accepted())
    bench.key(Key.Key_H)
    bench.until(lambda: isinstance(QApplication.activeWindow(), HistoryDialog), 5000)
    dialog = QApplication.activeWindow()
    QTest.keyClick(dialog.list, Key.Key_Down)
    QTest.keyClick(dialog.list, Key.Key_Return)
    assert len(bench.accepted()) == count - 2
    for left in (1, 0):
        bench.key(Key.Key_Y, Qt.KeyboardModifier.ControlModifier)
        assert len(bench.accepted()) == count - left
    assert not bench.window.commands.actions["redo"].isEnabled()
    # A key that is held down takes back one poke.
    assert not any(action.autoRepeat() for action in bench.window.commands.actions.values())
