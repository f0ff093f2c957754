"""The history of a session in lines, and the dialog that shows it."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from app.dialogs.history_dialog import HistoryDialog
from app.text.history_text import EARLIER_TIME, HistoryLine, history_lines
from skincal.journal.documents import WallClock
from skincal.journal.writer import create_session
from skincal.model.actions import MarkDead
from skincal.session.decisions import Decisions
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay
from skincal.session.undo import ActionEntry, History
from tests.app.window_support import frame, session, touch
from tests.skincal.poke_script import LINKS, write_scene

NOON = time.mktime((2026, 5, 4, 12, 0, 0, 0, 0, -1))
MARK = ActionEntry(MarkDead(7), Decisions(), NOON + 100.0)


def known():
    """Three pokes, of which the second was taken out by hand, a mark, and the third poke taken back."""
    pokes = [replace(touch(poke), end_s=10.0 * poke) for poke in (1, 2, 3)]
    clocks = ((0, WallClock(5.0, NOON + 5.0)),)
    return replace(session(2, pokes=pokes, excluded=[2, 3]), history=History((1, 2, MARK), (3,)), clocks=clocks)


def test_the_newest_stands_first_with_how_far_back_it_is():
    assert history_lines(known(), NOON + 200.0) == [
        HistoryLine("12:00:30", "poke 3 (undone)", 0, 1),
        HistoryLine("12:01:40", "mark of channel 7", 1, 0),
        HistoryLine("12:00:10", "poke 1", 2, 0),
    ], "poke 2 is out already: undo passes it over"


def test_each_part_of_a_session_has_its_clock_and_another_day_is_told():
    """The machine was started again between poke 1 and the others: its monotonic clock began anew."""
    there = replace(known(), clocks=((0, WallClock(2.0, NOON - 86400.0)), (1, WallClock(25.0, NOON))))
    whens = [line.when for line in history_lines(there, NOON + 200.0)]
    assert whens == ["12:00:05", "12:01:40", "2026-05-03 12:00"]


def test_what_no_clock_tells_is_not_dated():
    for clocks in ((), ((0, None),), ((0, WallClock(50.0, NOON)),), ((0, WallClock(1.0, NOON + 1e6)),)):
        whens = [line.when for line in history_lines(replace(known(), clocks=clocks), NOON + 200.0)]
        assert whens == [EARLIER_TIME, "12:01:40", EARLIER_TIME], clocks


@pytest.mark.parametrize("again", [load, replay])
def test_a_session_from_the_disk_tells_the_times_of_its_recording(tmp_path, again):
    clock = WallClock(1000.0, NOON)
    scene = write_scene(tmp_path / "source")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time, "monotonic_ns", lambda: 1000 * 10**9)
        patch.setattr(time, "time_ns", lambda: round(NOON * 1e9))
        pipeline = Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
        pipeline.act(MarkDead(1), 1007 * 10**9)
        pipeline.close()
    snapshot = again(tmp_path / "s").snapshot()
    assert snapshot.clocks[-1] == (0, clock)
    assert history_lines(snapshot, NOON + 60.0)[0].when == "12:00:07"


def test_enter_takes_back_down_to_a_line_or_brings_again(qtbot):
    dialog = HistoryDialog()
    qtbot.addWidget(dialog)
    dialog.show_state(frame(known()))
    with qtbot.waitExposed(dialog):
        dialog.show()
    assert [dialog.list.topLevelItem(row).text(1) for row in range(3)] == ["poke 3 (undone)", "mark of channel 7", "poke 1"]
    back, again = [], []
    dialog.undo_wanted.connect(back.append)
    dialog.redo_wanted.connect(again.append)
    dialog.activateWindow()
    qtbot.waitUntil(dialog.isActiveWindow)
    for key in (Qt.Key.Key_Return, Qt.Key.Key_Down, Qt.Key.Key_Down, Qt.Key.Key_Return):
        QTest.keyClick(dialog.list, key)
    assert (again, back) == ([1], [2])
    assert dialog.isVisible()
