"""The history of a session in lines, and the dialog that shows it."""

from __future__ import annotations

import time
from dataclasses import replace

from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from app.dialogs.history_dialog import HistoryDialog
from app.text.history_text import EARLIER, HistoryLine, history_lines
from skincal.model.actions import MarkDead
from skincal.session.undo import ActionEntry, Step
from tests.app.window_support import frame, session, touch

MARK = ActionEntry(Step("mark of channel 7", lambda: None), MarkDead(7), 100.0)


def known():
    """Three pokes, of which the second was taken out by hand, a mark, and the third poke taken back."""
    pokes = [replace(touch(poke), end_s=10.0 * poke) for poke in (1, 2, 3)]
    return replace(session(2, pokes=pokes, excluded=[2, 3]), history=(1, 2, MARK), undone=(3,))


def test_the_newest_stands_first_with_how_far_back_it_is():
    offset = time.mktime((2026, 5, 4, 12, 0, 0, 0, 0, -1))
    assert history_lines(known(), offset, 5.0) == [
        HistoryLine("12:00:30", "poke 3 (taken back)", 0, 1),
        HistoryLine("12:01:40", "mark of channel 7", 1, 0),
        HistoryLine("12:00:10", "poke 1", 2, 0),
    ], "poke 2 is out already: undo passes it over"
    assert history_lines(known(), offset, 50.0)[-1].when == EARLIER


def test_enter_takes_back_down_to_a_line_or_brings_again(qtbot):
    dialog = HistoryDialog()
    qtbot.addWidget(dialog)
    dialog.show_state(frame(known()))
    with qtbot.waitExposed(dialog):
        dialog.show()
    assert [dialog.list.topLevelItem(row).text(1) for row in range(3)] == ["poke 3 (taken back)", "mark of channel 7", "poke 1"]
    back, again = [], []
    dialog.taken_back.connect(back.append)
    dialog.brought_again.connect(again.append)
    dialog.activateWindow()
    qtbot.waitUntil(dialog.isActiveWindow)
    for key in (Qt.Key.Key_Return, Qt.Key.Key_Down, Qt.Key.Key_Down, Qt.Key.Key_Return):
        QTest.keyClick(dialog.list, key)
    assert (again, back) == ([1], [2])
    assert dialog.isVisible()
