"""The texts that a picture of a window shows, and those that the tool waits for."""

import re

from PySide6.QtWidgets import QComboBox, QLabel, QLineEdit, QPushButton, QTableWidget, QTabWidget, QVBoxLayout, QWidget

from tools.picture_sentences import CHECKOUT_FOLDER
from tools.pictures import list_texts


def test_the_texts_of_a_window_are_those_that_are_seen(qtbot):
    window, tabs, combo, name, hint = QWidget(), QTabWidget(), QComboBox(), QLineEdit("typed"), QLineEdit()
    qtbot.addWidget(window)
    column, hidden, table = QVBoxLayout(window), QLabel("hidden"), QTableWidget(1, 2)
    hint.setPlaceholderText("a hint")
    combo.addItems(["chosen", "another"])
    table.setHorizontalHeaderLabels(["Taxel", "Error"])
    tabs.addTab(QLabel("in front"), "First")
    tabs.addTab(QLabel("behind"), "Second")
    for widget in (QLabel("a <b>label</b>"), hidden, QPushButton("&Next"), combo, name, hint, table, tabs):
        column.addWidget(widget)
    window.show()
    hidden.hide()
    qtbot.waitExposed(window)
    assert sorted(filter(None, list_texts(window))) == sorted(
        ["a <b>label</b>", "&Next", "chosen", "a hint", "Taxel", "Error", "in front", "First", "Second"]
    )


def test_the_texts_that_the_tool_waits_for_are_those_of_the_program():
    """Else it would wait for a quarter of an hour, and make no picture."""
    tool = (CHECKOUT_FOLDER / "tools" / "pictures.py").read_text(encoding="utf-8")
    awaited = {words for pair in re.findall(r'until_text\("([^"]+)", "([^"]*)"', tool) for words in pair if words}
    assert len(awaited) >= 3
    rooms = (CHECKOUT_FOLDER / "app" / "text", CHECKOUT_FOLDER / "skincal" / "words")
    program = "".join(path.read_text(encoding="utf-8") for room in rooms for path in room.glob("*.py"))
    assert {words for words in awaited if words not in program} == set()
