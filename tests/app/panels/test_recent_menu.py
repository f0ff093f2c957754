"""The menu of recent sessions: what was open and is still there, by plain names, opened by its number."""

from __future__ import annotations

import shutil
import sys

import pytest
from PySide6.QtCore import QSettings, Qt

from app.panels.recent_menu import MOST, SETTING, RecentMenu
from app.session.opening import OpenRequest, server_command
from skincal.model.scene import resource
from tests.app.whole_window import OPEN_MS, Bench

Key = Qt.Key


def names(menu: RecentMenu) -> list[str]:
    menu.fill()
    return [action.text() for action in menu.actions()]


def test_what_was_open_is_opened_again_by_keys(bench, qtbot, tmp_path, recorded):
    other = shutil.copytree(recorded, tmp_path / "other")
    assert names(bench.window.recent) == ["None yet"]
    for folder in (recorded, other, recorded):
        bench.open(OpenRequest(session=folder))
    assert names(bench.window.recent) == ["&1  session", "&2  other"]
    assert [action.toolTip() for action in bench.window.recent.actions()] == [str(recorded), str(other)]
    bench.window.close()

    again = Bench(qtbot, tmp_path / "again")
    menu = again.window.commands.menus["Session"]
    again.window.menuBar().setActiveAction(menu.menuAction())
    again.until(menu.isVisible, 5000)
    qtbot.keyClick(menu, Key.Key_R)
    again.until(again.window.recent.isVisible, 5000)
    with qtbot.waitSignal(again.controller.session_opened, timeout=OPEN_MS):
        qtbot.keyClick(again.window.recent, Key.Key_2)
    assert again.controller.folder == other
    again.window.close()


def test_a_recording_that_goes_with_the_window_is_not_listed_until_it_is_kept(bench):
    scene = resource("scenes/flat-patch/scene.toml")
    bench.open(OpenRequest(scene=scene, server=server_command(scene)))
    assert names(bench.window.recent) == ["None yet"]
    bench.controller.keep()
    bench.until(lambda: bench.controller.folder is not None and names(bench.window.recent) != ["None yet"], OPEN_MS)
    (kept,) = bench.documents.iterdir()
    assert names(bench.window.recent) == [f"&1  {kept.name}"]


@pytest.mark.usefixtures("qapp")
def test_ten_are_kept_and_those_that_are_gone_are_dropped(tmp_path):
    settings = QSettings("skincal", "test")
    menu = RecentMenu(settings)
    folders = [tmp_path / f"s{number}" for number in range(MOST + 2)]
    for folder in folders:
        folder.mkdir()
        menu.remember(folder)
    assert names(menu) == [f"&{n % 10}  s{MOST + 2 - n}" for n in range(1, MOST + 1)]
    folders[5].rmdir()
    assert "s5" not in "".join(names(menu))
    assert len(settings.value(SETTING)) == MOST - 1
    for folder in folders[2:]:
        if folder.exists():
            folder.rmdir()
    assert names(menu) == ["None yet"]


@pytest.mark.usefixtures("qapp")
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such names")
def test_a_strangers_name_is_a_name(tmp_path):
    folder = tmp_path / "<b>R&D\tCtrl+Q"
    folder.mkdir()
    menu = RecentMenu(QSettings("skincal", "test"))
    menu.remember(folder)
    assert names(menu) == ["&1  <b>R&&D?Ctrl+Q"]
    (action,) = menu.actions()
    assert "&lt;b&gt;" in action.toolTip()
    assert "<b>" not in action.toolTip()
