"""Letters with Alt are found where two things share one, menus have lines, and the keyboard comes back after a dialog.

Every page is looked at in `test_sizes.py`.
"""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QMenu, QMenuBar, QPushButton, QWidget

from tests.app.every_page import open_dialogs
from tests.app.letters import collisions


def test_a_collision_is_found(qtbot):
    window = QWidget()
    qtbot.addWidget(window)
    menu = QMenuBar(window)
    menu.addMenu(QMenu("&Poke", menu))
    QPushButton("&Position", window)
    QPushButton("Save && &stop", window)
    window.show()
    assert collisions(window) == {"P": ["&Poke", "&Position"]}


def test_menus_have_no_long_run_of_entries_without_a_line(bench):
    assert len(bench.window.commands.menus) > 4
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
