"""Calibration files that the window writes, and those without a display, say what was checked and what could not be."""

import json
import re
import shutil
from pathlib import Path

import pytest

from app import headless
from app.dialogs.export_dialog import ExportDialog
from app.dialogs.verdict_dialog import VerdictDialog
from app.session.opening import OpenRequest
from app.text.message import NO_SESSION
from skincal.cli import main
from skincal.model.errors import InputError
from skincal.model.scene import resource
from skincal.taxels.result import Method

OPEN_MS = 60_000


def verdicts(path: Path) -> dict[str, str]:
    return json.loads(path.read_text(encoding="utf-8"))["verdicts"]


def export_json(bench, path: Path) -> None:
    bench.window.session_view.ask_export()
    dialog = bench.window.findChild(ExportDialog)
    dialog.path.setText(str(path))
    dialog.format.setCurrentIndex(next(i for i in range(dialog.format.count()) if dialog.format.itemData(i).value == "json"))
    dialog.path.setText(str(path))
    dialog.start.click()
    bench.until(lambda: "Written" in dialog.outcome.text(), OPEN_MS)
    dialog.reject()


def test_the_windows_file_says_what_the_verdict_and_the_command_say(bench, recorded, tmp_path, capsys):
    folder = shutil.copytree(recorded, tmp_path / "mine")
    bench.open(OpenRequest(session=folder))
    bench.until_all_is_there()
    view = bench.window.session_view
    target = view.state.guidance.target
    export_json(bench, tmp_path / "w.json")
    assert view.state.guidance.target == target, "what is asked for stays"
    view.ask_verdict()
    dialog = bench.window.findChild(VerdictDialog)
    said = verdicts(tmp_path / "w.json")
    assert set(said) == {method.value for method in view.workspace.methods}
    assert f"{dialog.sentence.text()} {dialog.details.text()}" == f"{said[view.method.value]}."
    dialog.reject()
    assert main(["export", str(folder), "--format", "json", "--out", str(tmp_path / "c.json")]) == 0
    capsys.readouterr()
    assert verdicts(tmp_path / "c.json") == said


def test_a_fault_while_a_file_is_written_reaches_its_dialog(bench, tmp_path, monkeypatch):
    def fail(*_):
        raise ZeroDivisionError("ours")

    bench.open(OpenRequest(session=resource("sessions/sample")))
    monkeypatch.setattr("skincal.files.export.write_calibration", fail)
    said, ended = [], []
    work = bench.controller.export_work("csv", tmp_path / "c.csv", Method.FREE, None)
    bench.controller.compute(work, said.append, said.append, ended=lambda: ended.append(1))
    bench.until(lambda: ended == [1])
    assert "ZeroDivisionError" in said[0]
    bench.window.controller._end_recording()
    with pytest.raises(InputError, match=re.escape(NO_SESSION)):
        bench.controller.export_work("csv", tmp_path / "c.csv", Method.FREE, None)


def test_without_a_display_the_file_and_the_output_say_it_too(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(headless, "SIMULATED_POKE_COUNT", 12)
    monkeypatch.setattr(headless, "_draw", lambda *asked: asked[-1])
    scene = resource("scenes/flat-patch/scene.toml")
    assert headless.run_headless(scene, tmp_path / "s", "no display") == 0
    lines = capsys.readouterr().out.splitlines()
    (words,) = [line for line in lines if line.startswith("Not finished")]
    assert words.rstrip(".") in (tmp_path / "s" / "positions.txt").read_text(encoding="utf-8")


def test_the_dialog_writes_the_whole_robot_with_a_prefix(bench, tmp_path):
    """The same options as in the command; those that a format does not know are hidden and have no effect."""
    bench.open(OpenRequest(session=resource("sessions/sample")))
    bench.until_all_is_there()
    link = bench.window.session_view.workspace.part.scene.link
    (tmp_path / "robot.urdf").write_text(f'<robot name="r"><link name="{link}"/></robot>')
    bench.window.session_view.ask_export()
    dialog = bench.window.findChild(ExportDialog)

    def choose(name: str) -> None:
        dialog.format.setCurrentIndex(next(i for i in range(dialog.format.count()) if dialog.format.itemData(i).value == name))

    choose("urdf")
    assert dialog.prefix.isVisible()
    assert dialog.into.isVisible()
    assert dialog.inertia.isVisible()
    dialog.prefix.setText("left_")
    dialog.into.setText(str(tmp_path / "robot.urdf"))
    dialog.inertia.setChecked(True)
    dialog.path.setText(str(tmp_path / "out.urdf"))
    dialog.start.click()
    bench.until(lambda: "Written" in dialog.outcome.text(), OPEN_MS)
    text = (tmp_path / "out.urdf").read_text(encoding="utf-8")
    assert '<link name="left_taxel_204">' in text
    assert text.count("<mass ") == text.count('<link name="left_taxel_') > 0
    remarks = [dialog.remarks.item(row).text() for row in range(dialog.remarks.count())]
    assert any("added to robot.urdf" in remark for remark in remarks)
    dialog.path.setText(str(tmp_path / "robot.urdf"))
    dialog.start.click()
    bench.until(lambda: "is the robot's own file" in dialog.outcome.text(), OPEN_MS)
    choose("csv")
    assert not dialog.prefix.isVisible()
    dialog.path.setText(str(tmp_path / "out.csv"))
    dialog.start.click()
    bench.until(lambda: "Written" in dialog.outcome.text(), OPEN_MS)
    dialog.reject()
