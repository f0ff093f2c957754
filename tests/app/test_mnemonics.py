"""Letters with Alt: none stands for two things in one window, on any page and in any dialog."""

from __future__ import annotations

import re
from collections import defaultdict

import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QAbstractButton, QGroupBox, QLabel, QMenu, QMenuBar, QPushButton, QTabBar, QWidget

from app.builder.step import Step
from tests.app.every_page import every_page, open_dialogs

LETTER = re.compile(r"&([^&\s])")
RICH = re.compile(r"<|&\w+;")


def letters(window: QWidget, *, also_hidden: bool = False) -> dict[str, list[str]]:
    """What each letter does with Alt in a window; `also_hidden` counts what is shown for other parts, too."""
    found = defaultdict(list)

    def add(text: str) -> None:
        for letter in LETTER.findall(text.replace("&&", "")):
            found[letter.upper()].append(text)

    for each in window.findChildren(QWidget):
        step = each if isinstance(each, Step) else next((s for s in window.findChildren(Step) if s.isAncestorOf(each)), None)
        is_there = each.isVisibleTo(window) or (also_hidden and step is not None and step.isVisible())
        if not is_there or each.window() is not window:
            continue
        if isinstance(each, QMenuBar):
            for action in each.actions():
                add(action.text())
        elif isinstance(each, QTabBar):
            for index in range(each.count()):
                add(each.tabText(index))
        elif isinstance(each, QGroupBox):
            add(each.title())
        elif isinstance(each, QAbstractButton) or (isinstance(each, QLabel) and each.buddy() is not None):
            add(each.text())
    return found


def collisions(window: QWidget) -> dict[str, list[str]]:
    return {letter: texts for letter, texts in letters(window, also_hidden=True).items() if len(texts) > 1}


def test_a_collision_is_found(qtbot):
    window = QWidget()
    qtbot.addWidget(window)
    menu = QMenuBar(window)
    menu.addMenu(QMenu("&Poke", menu))
    QPushButton("&Position", window)
    QPushButton("Save && &stop", window)
    window.show()
    assert collisions(window) == {"P": ["&Poke", "&Position"]}


def labels_that_lead_nowhere(window: QWidget) -> list[str]:
    """Labels with a letter whose buddy the Tab key does not reach, or that have none."""
    found = []
    for label in window.findChildren(QLabel):
        text, buddy = label.text(), label.buddy()
        is_shown = label.isVisibleTo(window) and label.window() is window and not RICH.search(text)
        leads = buddy is not None and bool(buddy.focusPolicy() & Qt.FocusPolicy.TabFocus)
        if is_shown and not leads and LETTER.search(text.replace("&&", "")):
            found.append(text)
    return found


@pytest.mark.timeout(300)
def test_no_letter_stands_for_two_things_and_that_of_each_label_leads_to_a_field_in_any_window(bench, recorded, monkeypatch):
    found = {
        name: (collisions(window), labels_that_lead_nowhere(window))
        for name, window in every_page(bench, recorded, monkeypatch)
    }
    assert {name: texts for name, texts in found.items() if any(texts)} == {}
    assert len(found) > 25


def test_menus_have_no_long_run_of_entries_without_a_line(bench):
    for name, menu in bench.window.commands.menus.items():
        run = 0
        for action in menu.actions():
            run = 0 if action.isSeparator() else run + 1
            assert run <= 6, f"{name}: {action.text()}"


def test_the_keyboard_comes_back_after_a_dialog_without_a_window_manager(bench):
    for key in (Qt.Key.Key_F2, Qt.Key.Key_F3, Qt.Key.Key_F4):
        bench.key(key)
        bench.until(lambda: open_dialogs() and open_dialogs()[0].isActiveWindow(), 5000)
        open_dialogs()[0].reject()
        # The display of the tests has no window manager, and nobody else asks for the focus.
        bench.until(bench.window.isActiveWindow, 5000)
