"""Everything by keys: the menus, foot pedals, and dialogs that go on with the space bar."""

from __future__ import annotations

import pytest
from PySide6.QtCore import QEvent, QSettings, Qt
from PySide6.QtGui import QAction, QKeyEvent, QKeySequence
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QDialog

from app.commands import WINDOW_COMMANDS, key_words
from app.dialogs.export_dialog import ExportDialog
from app.dialogs.keys_dialog import KeysDialog
from app.dialogs.new_session import NewSessionDialog
from app.dialogs.pedals import USED_BY_WIDGETS, PedalsDialog, key_name, key_problem
from app.session.opening import OpenRequest
from app.state.running import Running
from skincal.taxels.result import Method
from tests.app.whole_window import OPEN_MS, Bench
from tests.approved import approved

Key = Qt.Key


def entries(window) -> list[QAction]:
    """What the menus do; a menu within one is opened by its letter."""
    there = [action for menu in window.commands.menus.values() for action in menu.actions()]
    return [action for action in there if not action.isSeparator() and action.menu() is None]


def test_every_entry_of_every_menu_has_a_key_of_its_own(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    actions = entries(bench.window)
    assert {action.text() for action in actions if not action.shortcuts()} == set()
    keys = [key.toString() for action in actions for key in action.shortcuts()]
    assert sorted(set(keys)) == sorted(keys), "a key that is there twice does nothing"
    assert len(actions) == len(WINDOW_COMMANDS) + len(bench.window.session_view.workspace.panels)
    assert set(bench.window.commands.meaning_of_keys()) == {QKeySequence(key).toString() for key in keys}
    # Nothing can be done that is in no menu: the bar holds no other actions.
    elsewhere = [a for a in bench.window.findChildren(QAction) if a.shortcuts() and a not in actions]
    assert elsewhere == []
    for command in WINDOW_COMMANDS:
        assert all(f"<b>{key}" in key_words(2) or f"or {key}<" in key_words(2) for key in command.keys.split())


def dialog_of(bench, kind: type[QDialog]):
    """The dialog that is open, on the screen and with the keys."""
    bench.until(lambda: any(isinstance(w, kind) and w.isVisible() for w in QApplication.topLevelWidgets()), 5000)
    dialog = next(w for w in QApplication.topLevelWidgets() if isinstance(w, kind) and w.isVisible())
    dialog.activateWindow()
    bench.until(lambda: dialog.isActiveWindow() and dialog.focusWidget() is not None, 5000)
    return dialog


def gone(bench, kind: type[QDialog]) -> None:
    """Wait until no such dialog is on the screen."""
    bench.until(lambda: not any(isinstance(w, kind) and w.isVisible() for w in QApplication.topLevelWidgets()), 5000)


def tap(bench, key, modifier=Qt.KeyboardModifier.NoModifier) -> None:
    """Press and let go, as the desktop brings it: to the window that has the keys, and through every filter."""
    QTest.keyClick(QApplication.activeWindow().windowHandle(), key, modifier)
    bench.qtbot.wait(30)


def set_pedal(bench, key, modifier=Qt.KeyboardModifier.NoModifier) -> PedalsDialog:
    """Set the first pedal by keys alone; the dialog stays open."""
    bench.key(Key.Key_F3)
    dialog = dialog_of(bench, PedalsDialog)
    tap(bench, key, modifier)
    return dialog


def presses(bench, name: str) -> list[int]:
    pressed: list[int] = []
    bench.window.commands.actions[name].triggered.connect(lambda: pressed.append(1))
    return pressed


def test_a_pedal_is_set_by_keys_acts_as_the_space_bar_and_is_forgotten(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    # The space bar connects its devices, and would ask first.
    bench.window._remember(link.address for link in bench.controller.links)
    dialog = set_pedal(bench, Key.Key_F13)
    assert approved("commands.pedal_set", key="F13") in dialog.outcome.text()
    assert QSettings("skincal", "test").value("pedal/space") == "F13"
    tap(bench, Key.Key_F13)  # the focused button is Close
    gone(bench, PedalsDialog)
    pressed = presses(bench, "space")
    bench.key(Key.Key_F13)
    assert len(pressed) == 1
    bench.key(Key.Key_F2)
    dialog_of(bench, KeysDialog)
    tap(bench, Key.Key_F13)
    gone(bench, KeysDialog)
    assert len(pressed) == 1

    bench.key(Key.Key_F3)
    dialog = dialog_of(bench, PedalsDialog)
    assert dialog.fields["space"].keySequence().toString() == "F13"
    dialog.forget["space"].setFocus()
    tap(bench, Key.Key_Space)
    assert not dialog.forget["space"].isEnabled()
    tap(bench, Key.Key_Escape)
    gone(bench, PedalsDialog)
    bench.key(Key.Key_F13)
    assert len(pressed) == 1
    assert not QSettings("skincal", "test").contains("pedal/space")
    assert not bench.window.pedals._is_installed, "without a pedal no event is filtered"
    a_key_with_a_use_is_refused(bench)
    a_pedal_that_is_held_down_is_one_press(bench)
    in_a_text_field_a_letter_is_a_letter_and_a_pedal_types_nothing(bench)


def a_pedal_that_is_held_down_is_one_press(bench):
    assert bench.window.pedals.set_key("another", "F15") == ""
    pressed = presses(bench, "another")
    target = bench.window.session_view.state.target
    bench.key(Key.Key_F15)
    now = bench.window.session_view.state.target
    assert (now.channel, now.landmark) != (target.channel, target.landmark)
    again = QKeyEvent(QEvent.Type.KeyPress, Key.Key_F15, Qt.KeyboardModifier.NoModifier, "", True)
    for _ in range(5):
        QApplication.sendEvent(bench.window, again)
    bench.window.commands.actions["another"].setEnabled(False)
    bench.key(Key.Key_F15)
    assert len(pressed) == 1


def a_key_with_a_use_is_refused(bench):
    method = bench.window.session_view.state.method
    dialog = set_pedal(bench, Key.Key_V)
    assert approved("commands.key_taken", key="V", command="Next method") in dialog.outcome.text()
    assert bench.window.session_view.state.method is method, "only the field gets the key"
    tap(bench, Key.Key_B, Qt.KeyboardModifier.ControlModifier)
    assert bench.window.pedals.keys == {"space": "Ctrl+B"}
    dialog.fields["undo"].setFocus()
    tap(bench, Key.Key_B, Qt.KeyboardModifier.ControlModifier)
    assert approved("commands.pedal_already") in dialog.outcome.text()
    assert bench.window.pedals.keys == {"space": "Ctrl+B"}
    tap(bench, Key.Key_Escape)
    gone(bench, PedalsDialog)


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("Alt+B", "may open a menu"),
        *((key, "has a use already") for key in (*USED_BY_WIDGETS, "Space", "N")),
        *((key, "") for key in ("F13", "B", "Ctrl+B", "Shift+F1", "Media Play", "Pause", "ScrollLock")),
    ],
)
def test_which_keys_a_pedal_may_have(key, said):
    problem = key_problem(key, {"Space": "Pause", "N": "Another target", "F1": "What is this?"})
    assert said in problem
    assert bool(problem) == bool(said)


@pytest.mark.parametrize(
    ("key", "modifiers", "name"),
    [
        (Key.Key_F13, Qt.KeyboardModifier.NoModifier, "F13"),
        (Key.Key_5, Qt.KeyboardModifier.KeypadModifier, "5"),
        (Key.Key_B, Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier, "Ctrl+Shift+B"),
        (Key.Key_PageUp, Qt.KeyboardModifier.NoModifier, "PgUp"),
        (Key.Key_unknown, Qt.KeyboardModifier.NoModifier, ""),
    ],
)
def test_a_key_has_the_name_that_menus_show(key, modifiers, name):
    assert key_name(QKeyEvent(QEvent.Type.KeyPress, key, modifiers)) == name


def test_pedals_are_saved_and_one_that_got_another_use_is_dropped(qtbot, tmp_path):
    settings = QSettings("skincal", "test")
    for name, key in (("space", "F13"), ("undo", "V"), ("another", "F13")):
        settings.setValue(f"pedal/{name}", key)
    other = Bench(qtbot, tmp_path / "again")
    assert other.window.pedals.keys == {"space": "F13"}
    other.window.close()
    assert not other.window.pedals._is_installed
    assert settings.value("pedal/space") == "F13", "stopped, not forgotten"


def in_a_text_field_a_letter_is_a_letter_and_a_pedal_types_nothing(bench):
    bench.window.pedals.set_key("space", "B")
    bench.key(Key.Key_N, Qt.KeyboardModifier.ControlModifier)
    dialog = dialog_of(bench, NewSessionDialog)
    dialog.fields["wrench"].setFocus()
    for key in (Key.Key_B, Key.Key_F15, Key.Key_Space):
        tap(bench, key)
    assert dialog.fields["wrench"].text() == "b "
    tap(bench, Key.Key_Escape)
    gone(bench, NewSessionDialog)


def test_a_new_session_starts_and_its_calibration_is_written_by_the_space_bar(bench, qtbot, recorded):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    bench.key(Key.Key_E, Qt.KeyboardModifier.ControlModifier)
    export = dialog_of(bench, ExportDialog)
    assert export.focusWidget() is export.start
    tap(bench, Key.Key_Space)
    path = recorded / "icub-right-forearm-v1-modules.txt"
    bench.until(lambda: path.exists() and "Written" in export.outcome.text(), OPEN_MS)
    assert path.read_text().startswith("name ")
    tap(bench, Key.Key_Space)
    gone(bench, ExportDialog)

    bench.key(Key.Key_N, Qt.KeyboardModifier.ControlModifier)
    dialog = dialog_of(bench, NewSessionDialog)
    with qtbot.waitSignal(bench.controller.session_opened, timeout=OPEN_MS):
        tap(bench, Key.Key_Space)
    assert bench.controller.running is Running.STREAMING
    assert dialog is not None


def test_the_dialog_stays_until_the_file_is_written(qtbot, tmp_path):
    dialog = ExportDialog((Method.SURFACE,), Method.SURFACE, tmp_path / "part")
    dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose, on=False)
    qtbot.addWidget(dialog)
    with qtbot.waitExposed(dialog):
        dialog.show()
    QTest.keyClick(dialog.start, Key.Key_Space)
    dialog.reject()
    assert dialog.isVisible()
    dialog.show_written(())
    dialog.reject()
    assert not dialog.isVisible()
