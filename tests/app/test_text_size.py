"""The size of the text: the whole window's at once, by keys, kept, and nothing is cut off."""

from __future__ import annotations

import pytest
from PySide6.QtCore import QSettings, Qt
from PySide6.QtWidgets import QApplication, QDialog, QLabel, QPushButton

from app.dialogs.keys_dialog import KeysDialog
from app.panels.widgets import ElidedLabel
from app.session.opening import OpenRequest
from app.text.now_text import Now, Tone
from app.text_size import TEXT_SETTING, TEXT_SIZES_PERCENT
from app.theme import HEADLINE_FONT_SIZE_PT, RESULT_FONT_SIZE_PT
from tests.app.test_commands import dialog_of, gone, tap
from tests.app.whole_window import Bench
from tests.app.window_support import is_elided
from tests.approved import approved

Key = Qt.Key
CONTROL = Qt.KeyboardModifier.ControlModifier


def sizes(window) -> dict[str, float]:
    """Font sizes of each kind of widget, points: without a size of its own, with one, and below a rule of the style sheet."""
    workspace = window.session_view.workspace
    workspace.show_tab("Devices")
    devices = workspace.panels["Devices"]
    widgets = {
        "window": window,
        "menu": window.menuBar(),
        "tabs": workspace.tabs.tabBar(),
        "pokes": workspace.panels["Pokes"].table,
        "chips": window.session_view.chips,
        "headline": workspace.now.headline,
        "result": workspace.now.result,
        "rate": next(iter(devices.cards.values())).rate,
    }
    return {name: widget.font().pointSizeF() for name, widget in widgets.items()}


def test_keys_change_all_text_and_the_size_is_kept(bench, qtbot, tmp_path, recorded):
    bench.open(OpenRequest(session=recorded))
    before = sizes(bench.window)
    assert (before["headline"], before["result"]) == (HEADLINE_FONT_SIZE_PT, RESULT_FONT_SIZE_PT)
    actions = bench.window.commands.actions
    reached = []
    for _ in TEXT_SIZES_PERCENT:
        bench.key(Key.Key_Plus, CONTROL)
        reached.append(bench.window.text_size.percent)
        assert f"{reached[-1]} %" in actions["usual"].text()
        assert sizes(bench.window) == pytest.approx({name: at * reached[-1] / 100 for name, at in before.items()})
    assert reached == [125, 150, 200, 200, 200]
    assert not actions["larger"].isEnabled()
    bench.key(Key.Key_0, CONTROL)
    assert sizes(bench.window) == pytest.approx(before)
    for _ in TEXT_SIZES_PERCENT:
        bench.key(Key.Key_Minus, CONTROL)
    assert bench.window.text_size.percent == TEXT_SIZES_PERCENT[0]
    assert not actions["smaller"].isEnabled()
    bench.window.close()
    other = Bench(qtbot, tmp_path / "again")
    assert other.window.text_size.percent == TEXT_SIZES_PERCENT[0]
    other.key(Key.Key_N, CONTROL)
    dialog = dialog_of(other, QDialog)
    assert dialog.findChild(QLabel).font().pointSizeF() == QApplication.font().pointSizeF()
    dialog.reject()
    other.window.close()


@pytest.mark.parametrize("kept", ["130", "0", "large"])
def test_an_unknown_size_in_the_settings_becomes_the_default(qtbot, tmp_path, kept):
    QSettings("skincal", "test").setValue(TEXT_SETTING, kept)
    made = Bench(qtbot, tmp_path)
    assert made.window.text_size.percent == 100
    made.window.close()


def test_at_1280_by_720_nothing_is_cut_off_at_125_per_cent_and_every_tab_fits_at_200(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    bench.key(Key.Key_Plus, CONTROL)
    bench.qtbot.wait(100)
    window, workspace = bench.window, bench.window.session_view.workspace
    assert (window.width(), window.height()) == (1280, 720)
    bar = workspace.tabs.tabBar()
    assert all(bar.tabRect(at).right() <= workspace.tabs.width() for at in range(bar.count()))
    assert sum(bar.tabRect(at).width() for at in range(bar.count())) >= bar.sizeHint().width()
    workspace.show_tab("Pokes")
    table = workspace.panels["Pokes"].table
    assert table.columnWidth(1) > table.fontMetrics().horizontalAdvance("\N{CHECK MARK} accepted")
    assert table.rowHeight(0) > table.fontMetrics().height()
    assert not any(is_elided(label) for label in (workspace.now.headline, workspace.card.progress))
    for label in window.findChildren(ElidedLabel):
        if label.isVisible():
            assert label.height() >= label.fontMetrics().height(), label.text()
    for _ in range(8):
        bench.key(Key.Key_Plus, CONTROL)
    for title in workspace.panels:
        workspace.show_tab(title)
        bench.qtbot.wait(50)
        assert window.minimumSizeHint().height() <= 720, title
    assert window.height() == 720
    assert workspace.now.geometry().bottom() <= workspace.height()
    workspace.now.simulated.setText("SIMULATED  1\N{MULTIPLICATION SIGN}")
    workspace.now.say(Now(Tone.CALM, approved("landmark.ask", name="elbow, inner")))
    bench.qtbot.wait(50)
    assert not is_elided(workspace.now.headline), "the name is at its end"
    assert workspace.now.headline.fitted().pointSizeF() > RESULT_FONT_SIZE_PT


def test_the_list_of_keys_fits_into_1280_by_720_or_scrolls_in_one_direction(bench):
    bench.key(Key.Key_Plus, CONTROL)
    for percent in (125, 200):
        bench.window.text_size.choose(percent)
        bench.key(Key.Key_F2)
        box = dialog_of(bench, KeysDialog)
        assert box.width() <= 1280
        assert box.height() <= 680, "with the frame of the desktop"
        assert box.area.horizontalScrollBar().maximum() == 0
        down = box.area.verticalScrollBar()
        hidden = down.maximum()
        assert hidden + box.area.viewport().height() >= box.list.sizeHint().height()
        assert isinstance(box.focusWidget(), QPushButton)
        if hidden:
            tap(bench, Key.Key_Tab)
            tap(bench, Key.Key_PageDown)
            assert down.value() > 0
        tap(bench, Key.Key_Escape)
        gone(bench, KeysDialog)
    assert hidden > 0
