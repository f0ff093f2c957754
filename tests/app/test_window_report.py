"""The report and comparisons with other sources in the whole window: by keys, beside the window, and with its words."""

from __future__ import annotations

import json
import os
from multiprocessing import active_children
from pathlib import Path

import pytest
from PySide6.QtCore import Qt
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import QFileDialog

from app.dialogs.verdict_dialog import VerdictDialog
from app.panels.compare_panel import ComparePanel
from app.session.opening import OpenRequest
from app.text.message import REPORT_IN_PROGRESS
from app.workers.processes import WorkerProcess
from skincal.cli import main
from skincal.files.reference import compare_sets
from skincal.following.named_places import find_places
from tests.app.whole_window import OPEN_MS, Bench
from tests.approved import approved


@pytest.fixture
def processes(monkeypatch) -> list[int | None]:
    """The numbers of the processes that were asked."""
    pids, ask = [], WorkerProcess.ask

    def noted(self, *arguments, **watch):
        try:
            return ask(self, *arguments, **watch)
        finally:
            pids.append(self.pid)

    monkeypatch.setattr(WorkerProcess, "ask", noted)
    return pids


def said(bench: Bench) -> str:
    return bench.window.messages.text.text()


def write_a_report(bench: Bench, path: Path, monkeypatch) -> None:
    monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_: (str(path), ""))
    bench.key(Qt.Key.Key_E, Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier)


def test_a_report_is_written_beside_the_window_also_from_the_verdict_or_it_is_said_why_not(
    bench, recorded, tmp_path, monkeypatch, processes
):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    write_a_report(bench, tmp_path / "none" / "report.html", monkeypatch)
    bench.until(lambda: "does not exist" in said(bench), OPEN_MS)
    bench.window.messages.dismiss()
    assert not (bench.window.messages.isVisible() and REPORT_IN_PROGRESS in said(bench)), "nothing is being written any more"
    bench.key(Qt.Key.Key_F)
    dialog = bench.window.findChild(VerdictDialog)
    path = tmp_path / "monday.html"
    monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_: (str(tmp_path / "monday"), ""))
    dialog.report.click()
    assert dialog.isVisible(), "the verdict leads to the report, and stays"
    bench.until(path.exists, OPEN_MS)
    assert dialog.sentence.text() in path.read_text(encoding="utf-8")
    dialog.reject()
    bench.until(lambda: str(path) in said(bench), OPEN_MS)
    told = said(bench).partition(approved("report.written", path=path))[2]
    opened = []
    monkeypatch.setattr(QDesktopServices, "openUrl", lambda url: opened.append(url.toLocalFile()) or True)
    assert bench.window.messages.open_button.isVisible()
    bench.window.messages.open_button.click()
    assert opened == [str(path)]
    text = path.read_text(encoding="utf-8")
    assert told
    assert told in text
    # In a process of its own, and on what the window shows: by its method.
    assert processes
    assert os.getpid() not in processes
    assert f"{bench.window.session_view.method.value} method" in text


def test_closing_the_window_ends_a_report_that_is_being_written(bench, recorded, tmp_path, monkeypatch):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    others = set(active_children())
    write_a_report(bench, tmp_path / "report.html", monkeypatch)
    bench.until(lambda: bool(set(active_children()) - others), OPEN_MS)
    bench.window.close()
    assert not set(active_children()) - others
    assert not (tmp_path / "report.html").exists()


def chosen(panel: ComparePanel) -> list[str]:
    return [box.currentText() for box in panel.boxes]


def test_files_sessions_and_the_truth_are_compared_as_the_command_does(bench, recorded, tmp_path, monkeypatch, capsys):
    file = tmp_path / "places.csv"
    assert main(["export", str(recorded), "--format", "csv", "--out", str(file)]) == 0
    capsys.readouterr()
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    bench.key(Qt.Key.Key_4)
    panel = bench.window.session_view.workspace.panels["Compare"]
    listed = [panel.boxes[1].itemText(row) for row in range(panel.boxes[1].count())]
    assert "Truth" in listed
    monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *_: (str(file), ""))
    panel.add_file.click()
    bench.until(lambda: chosen(panel)[1].startswith("places.csv"), OPEN_MS)
    monkeypatch.setattr(QFileDialog, "getExistingDirectory", lambda *_: str(recorded))
    panel.add_session.click()
    bench.until(lambda: chosen(panel)[1].startswith(recorded.name), OPEN_MS)
    name = chosen(panel)[1]
    # Each method of the other session can be chosen; the one that leads is.
    listed = [panel.boxes[1].itemText(row) for row in range(panel.boxes[1].count())]
    methods = [words for words in listed if words.startswith(f"{recorded.name}, ")]
    estimates = bench.snapshot.estimates
    assert len(methods) == sum(any(each.position is not None for each in found) for found in estimates.values()) > 0
    # The same method from both is the same.
    select(panel, 0, next(words for words in listed if words == f"places.csv, {name.partition(', ')[2]}"))
    assert approved("compare.no_difference") in panel.summary.text()
    select(panel, 1, "Truth")
    found = compare_sets(find_places(str(file)), find_places(f"{recorded}:truth"))
    assert f"{found.mean * 1e3:.1f} mm" in panel.summary.text()
    assert f"{found.motion.mean * 1e3:.1f} mm" in panel.motion.text()
    assert panel.motion.isVisible()
    other = tmp_path / "truth.json"
    other.write_text(json.dumps({"link": "moon", "taxels": [{"channel": 3, "position_m": [0, 0, 1]}]}))
    before = chosen(panel)
    monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *_: (str(other), ""))
    panel.add_file.click()
    bench.until(lambda: "moon" in said(bench), OPEN_MS)
    assert chosen(panel) == before, "positions of another part are refused"


def select(panel: ComparePanel, which: int, words: str) -> None:
    box = panel.boxes[which]
    box.setCurrentIndex(box.findText(words))
    box.activated.emit(box.currentIndex())
