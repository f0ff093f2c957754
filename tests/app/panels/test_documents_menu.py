"""The Help menu: version and licence, and the pages that ship."""

from __future__ import annotations

from pathlib import Path

import pytest
from PySide6.QtCore import Qt, qVersion
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import QMessageBox

from app.panels import documents_menu
from app.panels.documents_menu import FOLDER, PAGES
from skincal import __version__
from tests.app.test_commands import dialog_of, gone, tap
from tests.approved import approved

Key = Qt.Key


@pytest.fixture
def opened(monkeypatch) -> list[Path]:
    """What the desktop was asked to open; it opens all but devices.md."""
    asked: list[Path] = []

    def open_url(url) -> bool:
        asked.append(Path(url.toLocalFile()))
        return asked[-1].name != "devices.md"

    monkeypatch.setattr(QDesktopServices, "openUrl", open_url)
    return asked


def test_a_page_is_opened_by_keys(bench, opened):
    menu = bench.window.commands.menus["Help"]
    bench.window.menuBar().setActiveAction(menu.menuAction())
    bench.until(menu.isVisible, 5000)
    bench.qtbot.keyClick(menu, Key.Key_D)
    bench.until(bench.window.documents.isVisible, 5000)
    bench.qtbot.keyClick(bench.window.documents, Key.Key_M)
    assert opened == [FOLDER / "manual.md"]
    assert not bench.window.messages.isVisible()


def test_each_page_is_there(bench, opened):
    for action in bench.window.documents.actions():
        action.trigger()
    assert [page.name for page in opened] == list(PAGES.values())
    assert all(page.is_file() for page in opened)
    assert bench.window.messages.isVisible(), "one of them was not opened"


def test_where_nothing_opens_a_page_it_is_said_where_it_is(bench, opened, monkeypatch, tmp_path):
    said: list[str] = []
    bench.window.documents.failed.connect(said.append)
    _manual, _scene, devices, *_ = bench.window.documents.actions()
    devices.trigger()
    assert said == [approved("help.not_opened", page=FOLDER / "devices.md")]
    monkeypatch.setattr(documents_menu, "FOLDER", tmp_path)
    bench.window.documents.actions()[0].trigger()
    assert said[1:] == [approved("help.no_documents")]
    assert len(opened) == 1


def test_version_and_licence_are_told(bench):
    bench.key(Key.Key_F2, Qt.KeyboardModifier.ShiftModifier)
    box = dialog_of(bench, QMessageBox)
    for words in (f"skincal {__version__}", "BSD 3-Clause", f"Qt {qVersion()}"):
        assert words in box.text()
    tap(bench, Key.Key_Space)
    gone(bench, QMessageBox)
