"""Everything by keys: the menus, foot pedals, and dialogs that go on with the space bar."""

from __future__ import annotations

import pytest
from PySide6.QtCore import QEvent, QSettings, Qt
from PySide6.QtGui import QAction, QKeyEvent, QKeySequence
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QDialog

from app.commands import COMMANDS, key_words
from app.dialogs.export_dialog import ExportDialog
from app.dialogs.keys_dialog import KeysDialog
from app.dialogs.new_session import NewSessionDialog
from app.dialogs.pedals import MODIFIERS, PEDALS, USED_BY_WIDGETS, Pedals, PedalsDialog, key_name, objection
from app.session.opening import OpenRequest
from app.state.running import Running
from skincal.taxels.result import Method
from tests.app.whole_window import OPEN_MS, Bench
from tests.app.window_support import changed, pixels
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
    assert len(actions) == len(COMMANDS) + len(bench.window.session_view.workspace.panels)
    assert set(bench.window.commands.taken()) == {QKeySequence(key).toString() for key in keys}
    # Nothing can be done that is in no menu: the bar holds no other actions.
    elsewhere = [a for a in bench.window.findChildren(QAction) if a.shortcuts() and a not in actions]
    assert elsewhere == []
    for command in COMMANDS:
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


def learn(bench, key, modifier=Qt.KeyboardModifier.NoModifier) -> PedalsDialog:
    """Learn the first pedal by keys alone; the dialog stays open."""
    bench.key(Key.Key_F3)
    dialog = dialog_of(bench, PedalsDialog)
    tap(bench, Key.Key_Space)
    tap(bench, key, modifier)
    return dialog


def test_a_pedal_is_learnt_by_keys_and_acts_as_the_space_bar(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    # The space bar connects its devices, and would ask first.
    bench.window._remember(link.address for link in bench.controller.links)
    dialog = learn(bench, Key.Key_F13)
    assert dialog.keys["space"].text() == "F13"
    assert approved("commands.pedal_set", key="F13") in dialog.outcome.text()
    assert QSettings("skincal", "test").value("pedal/space") == "F13"
    tap(bench, Key.Key_F13)  # the focused button is Close
    gone(bench, PedalsDialog)
    pressed: list[int] = []
    bench.window.commands.actions["space"].triggered.connect(lambda: pressed.append(1))
    bench.window.activateWindow()
    bench.until(bench.window.isActiveWindow, 5000)
    tap(bench, Key.Key_F13)
    assert len(pressed) == 1
    bench.key(Key.Key_F13)
    assert len(pressed) == 2

    bench.key(Key.Key_F2)
    dialog_of(bench, KeysDialog)
    tap(bench, Key.Key_F13)
    gone(bench, KeysDialog)
    assert len(pressed) == 2


def test_a_pedal_that_is_held_down_is_one_press(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    assert bench.window.pedals.learn("another", "F15") == ""
    pressed: list[int] = []
    bench.window.commands.actions["another"].triggered.connect(lambda: pressed.append(1))
    target = bench.window.session_view.state.target
    bench.key(Key.Key_F15)
    now = bench.window.session_view.state.target
    assert (now.channel, now.landmark) != (target.channel, target.landmark)
    again = QKeyEvent(QEvent.Type.KeyPress, Key.Key_F15, Qt.KeyboardModifier.NoModifier, "", True)
    for _ in range(5):
        QApplication.sendEvent(bench.window, again)
    assert len(pressed) == 1
    bench.window.commands.actions["another"].setEnabled(False)
    bench.key(Key.Key_F15)
    assert len(pressed) == 1


def test_what_a_pedal_does_is_undone_by_forgetting_it(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    dialog = learn(bench, Key.Key_F13)
    for _ in range(20):
        if dialog.focusWidget() is dialog.forget["space"]:
            break
        tap(bench, Key.Key_Tab)
    before = pixels(dialog)
    tap(bench, Key.Key_Space)
    assert changed(before, pixels(dialog)) > 50
    assert dialog.keys["space"].text() == "no pedal"
    assert not dialog.forget["space"].isEnabled()
    tap(bench, Key.Key_Escape)
    pressed: list[int] = []
    bench.window.commands.actions["space"].triggered.connect(lambda: pressed.append(1))
    bench.key(Key.Key_F13)
    assert pressed == []
    assert not QSettings("skincal", "test").contains("pedal/space")
    assert not bench.window.pedals._installed, "without a pedal no event is looked at"


def test_a_key_that_means_something_is_refused_and_the_next_one_is_waited_for(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    dialog = learn(bench, Key.Key_V)
    assert approved("commands.key_taken", key="V", command="Next method") in dialog.outcome.text()
    assert bench.window.session_view.state.method is Method.MODULES, "the key went to nobody else"
    tap(bench, Key.Key_Control)
    assert approved("commands.key_modifies", key="Ctrl") in dialog.outcome.text()
    tap(bench, Key.Key_B, Qt.KeyboardModifier.ControlModifier)
    assert dialog.keys["space"].text() == "Ctrl+B"
    dialog.learn["undo"].click()
    tap(bench, Key.Key_B, Qt.KeyboardModifier.ControlModifier)
    assert approved("commands.pedal_already") in dialog.outcome.text()
    tap(bench, Key.Key_Escape)
    assert dialog.isVisible(), "Escape leaves the pedal as it is"
    assert "undo" not in bench.window.pedals.keys
    tap(bench, Key.Key_Escape)
    gone(bench, PedalsDialog)
    bench.key(Key.Key_V)
    assert bench.window.session_view.state.method is not Method.MODULES, "keys go to the window again"


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("", "no name"),
        *((m, approved("commands.modifies_clause")) for m in MODIFIERS.values()),
        ("Alt+B", approved("commands.opens_menu")),
    ]
    + [(k, "means something already") for k in (*USED_BY_WIDGETS, "Space", "N")],
)
def test_why_a_key_is_no_pedal(key, said):
    assert said in objection(key, {"Space": "Pause", "N": "Another target"})


@pytest.mark.parametrize("key", ["F13", "B", "Ctrl+B", "Shift+F1", "Media Play", "Pause", "ScrollLock"])
def test_any_other_key_may_be_one(key):
    assert objection(key, {"Space": "Pause", "F1": "What is this?"}) == ""


@pytest.mark.parametrize(
    ("key", "modifiers", "name"),
    [
        (Key.Key_F13, Qt.KeyboardModifier.NoModifier, "F13"),
        (Key.Key_5, Qt.KeyboardModifier.KeypadModifier, "5"),
        (Key.Key_B, Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier, "Ctrl+Shift+B"),
        (Key.Key_Shift, Qt.KeyboardModifier.ShiftModifier, "Shift"),
        (Key.Key_Escape, Qt.KeyboardModifier.NoModifier, "Esc"),
        (Key.Key_Delete, Qt.KeyboardModifier.NoModifier, "Del"),
        (Key.Key_Backtab, Qt.KeyboardModifier.ShiftModifier, "Shift+Backtab"),
        (Key.Key_PageUp, Qt.KeyboardModifier.NoModifier, "PgUp"),
        (Key.Key_unknown, Qt.KeyboardModifier.NoModifier, ""),
    ],
)
def test_a_key_is_called_as_the_menus_call_it(key, modifiers, name):
    assert key_name(QKeyEvent(QEvent.Type.KeyPress, key, modifiers)) == name


def test_pedals_are_kept_and_one_that_got_a_meaning_is_not(qtbot, tmp_path):
    settings = QSettings("skincal", "test")
    for name, key in (("space", "F13"), ("undo", "V"), ("another", "F13")):
        settings.setValue(f"pedal/{name}", key)
    other = Bench(qtbot, tmp_path / "again")
    assert other.window.pedals.keys == {"space": "F13"}
    other.window.close()
    assert not other.window.pedals._installed


def test_in_a_field_for_text_a_letter_is_a_letter_and_a_pedal_types_nothing(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    bench.window.pedals.learn("space", "B")
    bench.window.pedals.learn("another", "F15")
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
    assert export.focusWidget() is export.write
    tap(bench, Key.Key_Space)
    path = bench.documents / "icub-right-forearm-v1-modules.txt"
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


@pytest.mark.usefixtures("qapp")
def test_pedals_need_no_window_to_be_told_off():
    actions = {pedal.name: QAction() for pedal in PEDALS}
    pedals = Pedals(actions, dict, QSettings("skincal", "test"))
    assert pedals.learn("space", "F13") == ""
    pedals.stop()
    assert pedals.keys == {}
    assert QSettings("skincal", "test").value("pedal/space") == "F13", "stopped, not forgotten"
