"""The size of the text: the whole window's at once, by keys, remembered, and nothing is cut off."""

from __future__ import annotations

import pytest
from PySide6.QtCore import QSettings, Qt
from PySide6.QtWidgets import QApplication, QDialog, QLabel, QPushButton

from app.dialogs.keys_dialog import KeysDialog
from app.panels.widgets import ElidedLabel
from app.session.opening import OpenRequest
from app.text.now_text import Now, Tone
from app.text_size import SETTING, STEPS
from app.theme import HEADLINE_PT, RESULT_PT
from tests.app.test_commands import dialog_of, gone, tap
from tests.app.whole_window import Bench
from tests.app.window_support import is_elided
from tests.approved import approved

Key = Qt.Key
CONTROL = Qt.KeyboardModifier.ControlModifier


def sizes(window) -> dict[str, float]:
    """Points of a font of each kind: the usual, those of their own, and those below a rule of the style sheet."""
    workspace = window.session_view.workspace
    workspace.show_tab("Devices")
    widgets = {
        "window": window,
        "menu": window.menuBar(),
        "tabs": workspace.tabs.tabBar(),
        "pokes": workspace.pokes.table,
        "chips": window.session_view.chips,
        "headline": workspace.now.headline,
        "result": workspace.now.result,
        "rate": workspace.devices.cards["wrench"].rate,
    }
    return {name: widget.font().pointSizeF() for name, widget in widgets.items()}


def test_keys_make_all_text_larger_and_smaller_and_as_it_was(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    before = sizes(bench.window)
    assert (before["headline"], before["result"]) == (HEADLINE_PT, RESULT_PT)
    actions = bench.window.commands.actions
    reached = []
    for _ in STEPS:
        bench.key(Key.Key_Plus, CONTROL)
        reached.append(bench.window.text_size.percent)
        assert f"{reached[-1]} %" in actions["usual"].text()
        assert sizes(bench.window) == pytest.approx({name: at * reached[-1] / 100 for name, at in before.items()})
    assert reached == [125, 150, 200, 200, 200]
    assert not actions["larger"].isEnabled()
    bench.key(Key.Key_0, CONTROL)
    assert sizes(bench.window) == pytest.approx(before)
    for _ in STEPS:
        bench.key(Key.Key_Minus, CONTROL)
    assert bench.window.text_size.percent == STEPS[0]
    assert not actions["smaller"].isEnabled()


def test_the_size_is_remembered_and_what_is_made_later_has_it(bench, qtbot, tmp_path, recorded):
    bench.key(Key.Key_Plus, CONTROL)
    bench.window.close()
    other = Bench(qtbot, tmp_path / "again")
    assert other.window.text_size.percent == 125
    other.open(OpenRequest(session=recorded))
    assert sizes(other.window)["headline"] == pytest.approx(1.25 * HEADLINE_PT)
    other.key(Key.Key_N, CONTROL)
    dialog = dialog_of(other, QDialog)
    assert dialog.findChild(QLabel).font().pointSizeF() == QApplication.font().pointSizeF()
    dialog.reject()
    other.window.close()


@pytest.mark.parametrize("kept", ["130", "0", "large"])
def test_a_size_that_there_is_not_is_the_usual_one(qtbot, tmp_path, kept):
    QSettings("skincal", "test").setValue(SETTING, kept)
    made = Bench(qtbot, tmp_path)
    assert made.window.text_size.percent == 100
    made.window.close()


def test_at_1280_by_720_and_125_per_cent_nothing_is_cut_off(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    bench.key(Key.Key_Plus, CONTROL)
    bench.qtbot.wait(100)
    window, workspace = bench.window, bench.window.session_view.workspace
    assert (window.width(), window.height()) == (1280, 720)
    # What is said of a forearm's high map stands beside it.
    assert workspace.map.height() > 0.8 * (workspace.card.height() - workspace.card.progress.height())
    wide = workspace.map.width()
    workspace.card.errors.setText("predicted error 1234.5 mm mean, 2345.6 mm worst of all taxels")
    bench.qtbot.wait(50)
    assert workspace.map.width() == wide
    bar = workspace.tabs.tabBar()
    assert all(bar.tabRect(at).right() <= workspace.tabs.width() for at in range(bar.count()))
    assert sum(bar.tabRect(at).width() for at in range(bar.count())) >= bar.sizeHint().width()
    workspace.show_tab("Pokes")
    table = workspace.pokes.table
    assert table.columnWidth(1) > table.fontMetrics().horizontalAdvance("\N{CHECK MARK} accepted")
    assert table.rowHeight(0) > table.fontMetrics().height()
    assert not any(is_elided(label) for label in (workspace.now.headline, workspace.card.progress))
    for label in window.findChildren(ElidedLabel):
        if label.isVisible():
            assert label.height() >= label.fontMetrics().height(), label.text()


def test_at_200_per_cent_the_window_stays_on_a_screen_of_720_pixels_with_every_tab(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    for _ in range(8):
        bench.key(Key.Key_Plus, CONTROL)
    window, workspace = bench.window, bench.window.session_view.workspace
    for title in workspace.panels:
        workspace.show_tab(title)
        bench.qtbot.wait(50)
        if title in ("Readings", "Errors"):
            bench.until(lambda title=title: workspace.panels[title].ready)
        bench.qtbot.wait(50)
        assert window.minimumSizeHint().height() <= 720, title
    assert window.height() == 720
    assert workspace.now.geometry().bottom() <= workspace.height()
    # The name at its end is what the operator needs.
    workspace.now.simulated.setText("SIMULATED  1\N{MULTIPLICATION SIGN}")
    workspace.now.say(Now(Tone.CALM, approved("landmark.ask", name="elbow, inner")))
    bench.qtbot.wait(50)
    assert not is_elided(workspace.now.headline)
    assert workspace.now.headline.fitted().pointSizeF() > RESULT_PT


def test_every_key_is_on_a_screen_of_1280_by_720_at_125_per_cent(bench):
    bench.key(Key.Key_Plus, CONTROL)
    bench.key(Key.Key_F2)
    box = dialog_of(bench, KeysDialog)
    assert box.width() <= 1280
    assert box.height() <= 680, "with the frame of the desktop"
    assert box.area.verticalScrollBar().maximum() == box.area.horizontalScrollBar().maximum() == 0
    box.reject()


def test_at_200_per_cent_the_keys_are_scrolled_on_a_screen_of_720_pixels_and_in_one_direction(bench):
    for _ in STEPS:
        bench.key(Key.Key_Plus, CONTROL)
    bench.key(Key.Key_F2)
    box = dialog_of(bench, KeysDialog)
    assert (box.width() <= 1280, box.height() <= 680) == (True, True)
    down = box.area.verticalScrollBar()
    assert down.maximum() + box.area.viewport().height() >= box.list.sizeHint().height() > 680
    assert box.area.horizontalScrollBar().maximum() == 0
    assert isinstance(box.focusWidget(), QPushButton)
    tap(bench, Key.Key_Tab)
    tap(bench, Key.Key_PageDown)
    assert down.value() > 0
    tap(bench, Key.Key_Escape)
    gone(bench, KeysDialog)
