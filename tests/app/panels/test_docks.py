"""Panels that are moved, detached and enlarged: they stay alive, come back by one key, and are remembered."""

from __future__ import annotations

import pytest
from PySide6.QtCore import QSettings, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QTabBar

from app.panels.docks import DOCKS_SETTING
from app.session.opening import OpenRequest
from tests.app.whole_window import Bench

NO = Qt.KeyboardModifier.NoModifier
SHIFT, CONTROL = Qt.KeyboardModifier.ShiftModifier, Qt.KeyboardModifier.ControlModifier
RIGHT, BOTTOM = Qt.DockWidgetArea.RightDockWidgetArea, Qt.DockWidgetArea.BottomDockWidgetArea


@pytest.fixture
def opened(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    return bench


def workspace_of(bench):
    return bench.window.session_view.workspace


def titles(workspace) -> list[str]:
    return [workspace.tabs.tabText(at) for at in range(workspace.tabs.count())]


def places(workspace):
    """Sizes and places of view, map and tabs."""
    return [
        (each.mapTo(workspace, each.rect().topLeft()), each.size()) for each in (workspace.view, workspace.map, workspace.tabs)
    ]


def test_a_tab_gets_a_window_of_its_own_and_follows_the_session(opened):
    workspace = workspace_of(opened)
    order = titles(workspace)
    pokes = workspace.panels["Pokes"]
    bar = workspace.tabs.tabBar()
    assert isinstance(bar, QTabBar)
    QTest.mouseDClick(bar, Qt.MouseButton.LeftButton, NO, bar.tabRect(order.index("Pokes")).center())
    opened.qtbot.wait(50)
    dock = workspace.docks.detached["Pokes"]
    assert dock.isFloating()
    assert dock.isVisible()
    assert pokes.isVisible()
    assert titles(workspace) == [title for title in order if title != "Pokes"]
    opened.until(lambda: pokes.model.rowCount() == len(opened.snapshot.pokes), 5000)
    # The number keys mean the same tabs as before.
    opened.key(Qt.Key.Key_3)
    assert workspace.tabs.currentWidget() is workspace.panels[order[2]]
    opened.window.session_view.select_poke(2)
    assert pokes.selected() == (2,) or list(pokes.selected()) == [2]
    dock.close()
    opened.qtbot.wait(50)
    assert titles(workspace) == order
    assert workspace.docks.detached == {}
    workspace.show_tab("Pokes")
    assert pokes.isVisible()


def test_the_last_tab_stays(opened):
    workspace = workspace_of(opened)
    for _ in range(20):
        opened.window.commands.actions["detach"].trigger()
    assert workspace.tabs.count() == 1
    opened.window.commands.actions["arrange"].trigger()
    assert titles(workspace) == list(workspace.panels)


def test_the_tabs_are_enlarged_and_come_back(opened):
    workspace = workspace_of(opened)
    before, width = places(workspace), workspace.tabs.width()
    opened.key(Qt.Key.Key_F12)
    opened.qtbot.wait(50)
    assert workspace.tabs.width() > 0.55 * workspace.width()
    assert workspace.tabs.height() > 0.9 * workspace.docks.height()
    assert workspace.tabs.width() > 1.4 * width
    assert workspace.view.width() >= 240
    opened.key(Qt.Key.Key_F12)
    opened.qtbot.wait(50)
    assert places(workspace) == before


def test_one_key_brings_the_first_arrangement_back(opened):
    workspace = workspace_of(opened)
    docks, before, order = workspace.docks, places(workspace), titles(workspace)
    docks.addDockWidget(BOTTOM, docks.map)
    docks.panels.setFloating(True)
    opened.key(Qt.Key.Key_F12, SHIFT)
    docks.detach("Errors")
    opened.qtbot.wait(50)
    assert docks.dockWidgetArea(docks.map) is BOTTOM
    assert places(workspace) != before
    opened.key(Qt.Key.Key_F12, CONTROL)
    opened.qtbot.wait(100)
    assert docks.dockWidgetArea(docks.map) is RIGHT
    assert not docks.panels.isFloating()
    assert titles(workspace) == order
    assert places(workspace) == before


def test_the_arrangement_is_remembered(opened, qtbot, tmp_path, recorded):
    docks = workspace_of(opened).docks
    docks.addDockWidget(BOTTOM, docks.map)
    docks.detach("Devices")
    opened.qtbot.wait(50)
    opened.window.leave()
    other = Bench(qtbot, tmp_path / "again")
    other.open(OpenRequest(session=recorded))
    again = workspace_of(other)
    other.qtbot.wait(50)
    assert again.docks.dockWidgetArea(again.docks.map) is BOTTOM
    assert list(again.docks.detached) == ["Devices"]
    assert again.docks.detached["Devices"].isFloating()
    assert again.panels["Devices"].isVisible()
    other.window.close()


def test_an_arrangement_that_cannot_be_read_becomes_the_first(opened, qtbot, tmp_path, recorded):
    opened.window.leave()
    QSettings("skincal", "test").setValue(DOCKS_SETTING, b"nothing")
    other = Bench(qtbot, tmp_path / "again")
    other.open(OpenRequest(session=recorded))
    docks = workspace_of(other).docks
    assert docks.dockWidgetArea(docks.map) is RIGHT
    assert docks.map.isVisible()
    other.window.close()
