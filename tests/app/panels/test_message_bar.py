"""Messages over the edge of a view: nothing moves below them, nobody is interrupted, and none is lost."""

from __future__ import annotations

import pytest
from PySide6.QtCore import QPoint, Qt, QTimer
from PySide6.QtGui import QCursor
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QLabel, QPlainTextEdit, QWidget

from app.dialogs.landmark_dialog import CLICK_REQUEST
from app.panels.layouts import make_row
from app.panels.message_bar import MessageBar
from app.session.opening import OpenRequest
from app.text.message import Message
from tests.app.every_page import open_dialogs
from tests.app.whole_window import OPEN_MS

LONG = "A sentence that needs more room than one line of the view has. " * 6


class Page(QWidget):
    """A page with a view at its left, as all pages of the window have it."""

    def __init__(self) -> None:
        super().__init__()
        self.view, self.side = QLabel("view"), QLabel("side")
        make_row((self.view, 2), (self.side, 1), within=self, margins=0)
        self.bar = MessageBar(lambda: self.view)
        self.bar.setParent(self)
        self.resize(900, 600)


@pytest.fixture
def page(qtbot):
    page = Page()
    qtbot.addWidget(page)
    with qtbot.waitExposed(page):
        page.show()
    # Far from the upper part of the window.
    QCursor.setPos(page.mapToGlobal(QPoint(450, 590)))
    yield page
    page.bar.stop()


def timer_of(page) -> QTimer:
    return page.bar.findChild(QTimer)


def test_what_is_asked_stays_until_it_is_done(page):
    bar, timer = page.bar, timer_of(page)
    bar.tell(CLICK_REQUEST)
    assert not timer.isActive()
    bar.tell(Message("Written."))
    timer.timeout.emit()
    assert CLICK_REQUEST.text in bar.text.text()
    assert "\N{CHECK MARK}" not in bar.text.text(), "nothing is done yet"
    timer.timeout.emit()
    assert CLICK_REQUEST.text in bar.text.text()
    bar.withdraw(CLICK_REQUEST)
    bar.withdraw(CLICK_REQUEST)
    assert not bar.isVisible()


def test_a_result_takes_the_place_of_the_progress_of_its_work_alone(page):
    bar = page.bar
    bar.tell(Message("Device lost.", error=True))
    bar.tell(Message("Writing.", found=True, work="report"))
    bar.tell(Message("Written.", work="report"))
    bar.dismiss()
    assert "Device lost." in bar.text.text()
    bar.tell(Message("Writing.", found=True, work="report"))
    bar.tell(Message("No room.", error=True, work="report"))
    bar.dismiss()
    assert "Device lost." in bar.text.text()


def test_errors_stay_until_they_are_read_and_news_disappears(page):
    bar, timer = page.bar, timer_of(page)
    bar.show_newest()
    assert not bar.isVisible()
    bar.tell(Message("The disk is full.", error=True))
    bar.tell(Message("Written."))
    assert "Written." in bar.text.text()
    timer.timeout.emit()
    assert "The disk is full." in bar.text.text()
    timer.timeout.emit()
    assert bar.isVisible()
    QTest.mouseClick(bar.close_button, Qt.MouseButton.LeftButton)
    assert not bar.isVisible()
    signs = []
    for kind in ({"error": True}, {"asks": True}, {"found": True}, {}):
        bar.tell(Message("It is so.", **kind))
        signs.append(bar.text.text().split()[0])
    assert signs == ["\N{BALLOT X}", "\N{RIGHTWARDS ARROW}", "\N{BULLET}", "\N{CHECK MARK}"]


def test_a_message_moves_nothing_and_lies_within_the_view(page, qtbot):
    places = page.view.geometry(), page.side.geometry()
    page.bar.tell(Message(LONG))
    qtbot.wait(20)
    assert (page.view.geometry(), page.side.geometry()) == places
    assert page.view.geometry().contains(page.bar.geometry())
    assert page.bar.text.height() >= page.bar.text.heightForWidth(page.bar.text.width())
    page.resize(820, 500)
    qtbot.wait(20)
    assert page.view.geometry().contains(page.bar.geometry()), "it follows the view"
    page.bar.dismiss()
    qtbot.wait(20)
    assert not page.bar.isVisible()


@pytest.mark.parametrize("what", ["upper part", "message", "marked text", "list"])
def test_a_message_stays_while_somebody_is_there(page, qtbot, what):
    bar, timer = page.bar, timer_of(page)
    bar.tell(Message("Written."))
    if what == "upper part":
        QCursor.setPos(page.mapToGlobal(QPoint(800, 150)))
    elif what == "message":
        page.resize(900, 100)
        qtbot.wait(20)
        QCursor.setPos(bar.mapToGlobal(bar.rect().center()))
    elif what == "marked text":
        bar.text.setSelection(0, 4)
    else:
        bar.is_list_open = True
    for _ in range(3):
        timer.timeout.emit()
        assert bar.isVisible()
        assert timer.isActive(), "it is tried again"
    QCursor.setPos(page.mapToGlobal(QPoint(450, page.height() + 50)))
    bar.text.setSelection(0, 0)
    bar.is_list_open = False
    timer.timeout.emit()
    assert not bar.isVisible()


def test_a_long_message_has_the_time_of_a_slow_reader(page):
    page.bar.tell(Message("Short."))
    assert timer_of(page).interval() == 8000
    page.bar.tell(Message("x" * 400))
    assert timer_of(page).interval() == 24_000


def test_every_message_is_in_the_list_and_esc_closes_the_newest(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    bench.until(lambda: bench.window.session_view.workspace.view.list_layers() != (), OPEN_MS)
    window, workspace = bench.window, bench.window.session_view.workspace
    while window.messages.isVisible():
        window.messages.dismiss()
    before = workspace.geometry(), workspace.now.mapTo(window, QPoint(0, 0)), workspace.tabs.mapTo(window, QPoint(0, 0))
    window.tell(Message("The first is written."))
    window.tell(Message("The second fails.", error=True))
    bench.qtbot.wait(50)
    assert window.messages.isVisible()
    assert (
        workspace.geometry(),
        workspace.now.mapTo(window, QPoint(0, 0)),
        workspace.tabs.mapTo(window, QPoint(0, 0)),
    ) == before
    bench.key(Qt.Key.Key_Escape)
    assert "The first is written." in window.messages.text.text()
    bench.key(Qt.Key.Key_Escape)
    assert not window.messages.isVisible()
    bench.key(Qt.Key.Key_F4)
    text = open_dialogs()[0].findChild(QPlainTextEdit)
    assert text is not None
    lines = [line.split("  ", 1)[1] for line in text.toPlainText().split("\n\n")]
    assert lines[:2] == ["\N{BALLOT X}  The second fails.", "\N{CHECK MARK}  The first is written."]
    window.tell(Message("<b>third</b>"))
    assert text.toPlainText().split("\n\n")[0].endswith("<b>third</b>")
    open_dialogs()[0].reject()
