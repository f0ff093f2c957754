"""The corrected layout in the Compare tab: offered while there is one, saved by keys, and what became of it is said."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QFileDialog

from app.panels.compare_panel import ComparePanel
from skincal.model.scene import resource
from skincal.model.skin import load_layout
from tests.app.panels.test_compare_panel import Queue, anchored, at, judged_and_shown, known, make_panel, open_compare
from tests.app.whole_window import OPEN_MS, Bench
from tests.approved import approved
from tests.skincal.sim_support import recorded_anew


def test_the_corrected_layout_can_be_saved_only_while_there_is_one(qtbot):
    of, queue = anchored(mirror=True), Queue()
    panel = make_panel(qtbot, of)
    show = judged_and_shown(panel, of, queue)
    show(at(known()))
    assert not panel.save.isVisible()
    queue.finish()
    show(at(known()))
    assert panel.save.isVisible()
    assert "module 10: mirror = false" in panel.save.toolTip()
    with qtbot.waitSignal(panel.layout_wanted) as wanted:
        QTest.keyClick(panel.save, Qt.Key.Key_Return)
    (mend,) = wanted.args
    assert [module.mirror for module in mend.layout.modules] == [False, False]
    # Taxels that lie otherwise: with too few of module 10 nothing is said of it.
    for _ in range(2):
        show(at(known(rows=range(9, 24)), generation=2))
        queue.finish()
    assert not panel.save.isVisible()


@pytest.fixture(scope="module")
def mirrored_once(tmp_path_factory):
    """The sample session, which has a poke on each taxel, recorded with its first module mirrored in the layout."""
    made = tmp_path_factory.mktemp("mirrored")
    folder = shutil.copytree(resource("sessions/sample"), made / "sample")
    layout = folder / "scene" / "modules.toml"
    text = layout.read_text(encoding="utf-8")
    layout.write_text(text.replace("mirror = false", "mirror = true  # so", 1), encoding="utf-8")
    return recorded_anew(folder, made / "session")


@pytest.fixture
def mirrored_pokes(mirrored_once, tmp_path):
    """That session, this test's own."""
    return shutil.copytree(mirrored_once, tmp_path / "session")


def until_offered(bench: Bench, folder) -> ComparePanel:
    panel = open_compare(bench, folder)
    workspace = bench.window.session_view.workspace

    def offered() -> bool:
        bench.window.session_view.follow_again()
        return panel.save.isVisible()

    bench.until(offered, OPEN_MS)
    assert approved("modules_check.mirrored_clause", module=17) in panel.health.text()
    assert workspace.tabs.currentWidget() is panel
    return panel


def test_in_the_window_the_corrected_layout_is_saved_by_keys_and_said(bench, mirrored_pokes, tmp_path, monkeypatch):
    panel = until_offered(bench, mirrored_pokes)
    asked, path = [], tmp_path / "corrected.toml"

    def answer(_parent, title, name, _kinds):
        asked.append((title, name))
        return str(path), ""

    monkeypatch.setattr(QFileDialog, "getSaveFileName", answer)
    bench.window.activateWindow()
    bench.until(bench.window.isActiveWindow, 5000)
    panel.scale.setFocus()
    QTest.keyClick(panel.scale, Qt.Key.Key_Tab)
    bench.until(panel.save.hasFocus, 2000)
    QTest.keyClick(panel.save, Qt.Key.Key_Return)
    bench.until(lambda: str(path) in bench.window.messages.text.text(), OPEN_MS)
    (title, name), *more = asked
    assert (title, more) == (approved("modules_check.save"), [])
    assert Path(name) == Path.home() / "icub-right-forearm-v1-corrected.modules.toml"
    layout = bench.window.session_view.workspace.part.scene.skin.layout
    assert "mirror = false  # so" in path.read_text(encoding="utf-8")
    assert load_layout(path, layout.width).modules[0].mirror is False
    assert layout.modules[0].mirror is True, "nothing is changed by itself"


def test_a_layout_that_cannot_be_saved_is_said(bench, mirrored_pokes, tmp_path, monkeypatch):
    panel = until_offered(bench, mirrored_pokes)
    for path, why in (
        (tmp_path / "none" / "new.toml", "does not exist"),
        (mirrored_pokes / "scene" / "modules.toml", approved("layout_file.the_same_clause")),
    ):
        monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_, path=path: (str(path), ""))
        panel.save.click()
        bench.until(lambda why=why: why in bench.window.messages.text.text(), OPEN_MS)
    monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_: ("", ""))
    before = bench.window.messages.text.text()
    panel.save.click()
    bench.qtbot.wait(50)
    assert bench.window.messages.text.text() == before
    assert "mirror = true  # so" in (mirrored_pokes / "scene" / "modules.toml").read_text(encoding="utf-8")
