"""Letters with Alt in a window: what each does, and whether the labels that have one lead to a field."""

from __future__ import annotations

import re
from collections import defaultdict

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QAbstractButton, QGroupBox, QLabel, QMenuBar, QTabBar, QWidget

from app.builder.step import Step

LETTER = re.compile(r"&([^&\s])")
RICH = re.compile(r"<|&\w+;")
WITH_LETTERS = (QMenuBar, QTabBar, QGroupBox, QAbstractButton, QLabel)


def letters(window: QWidget, *, also_hidden: bool = False) -> dict[str, list[str]]:
    """What each letter does with Alt in a window; `also_hidden` counts what is shown for other parts, too."""
    found = defaultdict(list)

    def add(text: str) -> None:
        for letter in LETTER.findall(text.replace("&&", "")):
            found[letter.upper()].append(text)

    steps = window.findChildren(Step)
    for each in window.findChildren(QWidget):
        if not isinstance(each, WITH_LETTERS):
            continue
        step = each if isinstance(each, Step) else next((s for s in steps if s.isAncestorOf(each)), None)
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
