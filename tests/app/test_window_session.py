"""A whole guided session in the real window, by keys alone: from the first target to the verdict and the file.

A real process simulates the rig over TCP; its operator follows the target that the window shows, and sometimes ignores it.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import QSettings, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QDialog, QFileDialog

from app.commands import WINDOW_COMMANDS
from app.dialogs.export_dialog import ExportDialog
from app.dialogs.pedals import PedalsDialog
from app.dialogs.verdict_dialog import VerdictDialog
from app.session.opening import OpenRequest, server_command
from app.state.running import Running
from skincal.contacts.outcome import Contact
from skincal.files.reference import load_reference
from skincal.guide.guidance import GuidePhase
from skincal.session.replay import replay
from skincal.taxels.poke_figures import peak_channel
from skincal.taxels.result import Method, State
from tests.app.whole_window import OPEN_MS
from tests.app.window_support import changed, pixels
from tests.approved import approved

Key = Qt.Key
ENOUGH_MS = 240_000  # On an idle machine it takes a minute

SCENE = """
name = "little-plate"
link = "plate"
[skin]
channels = 4
polarity = "up"
range = [0, 4095]
modules = "modules.toml"
[skin.anchor]
at_mm = [0.0, 0.0]
point_mm = [0.0, 0.0, 0.0]
x = [1.0, 0.0, 0.0]
normal = [0.0, 0.0, 1.0]
[surface]
mesh = "plate.obj"
unit = "mm"
[sensor]
pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -0.045], [0, 0, 0, 1]]
[contacts]
response_min = 160.0
[noise]
radius = 1.0
"""
MODULES = """
[kinds.square_4]
pads_mm = [[-3.0, -3.0], [3.0, -3.0], [-3.0, 3.0], [3.0, 3.0]]
outline_mm = [[-6.0, -6.0], [6.0, -6.0], [6.0, 6.0], [-6.0, 6.0]]
centre_pad = 0
[[modules]]
id = 1
kind = "square_4"
first_channel = 0
place_mm = [0.0, 0.0]
"""


@pytest.fixture
def plate(tmp_path) -> Path:
    """Four taxels on a flat plate above a sensor."""
    folder = tmp_path / "plate"
    folder.mkdir()
    (folder / "scene.toml").write_text(SCENE)
    (folder / "modules.toml").write_text(MODULES)
    corners = [(x, y) for y in (-25, 25) for x in (-25, 25)]
    lines = [f"v {x} {y} 0" for x, y in corners] + ["f 1 2 4", "f 1 4 3"]
    (folder / "plate.obj").write_text("\n".join(lines) + "\n")
    return folder / "scene.toml"


class Keys:
    """Somebody who has a keyboard and eyes, and no mouse."""

    def __init__(self, bench, plate: Path, recording: Path) -> None:
        self.bench, self.qtbot = bench, bench.qtbot
        careful = ("--careful", "--seed", "3")
        bench.open(OpenRequest(scene=plate, server=(*server_command(plate), *careful), folder=recording, demo=True))
        bench.until_all_is_there()
        self.session_view = bench.window.session_view
        self.workspace = self.session_view.workspace
        self.back_in_the_window()

    @property
    def guidance(self):
        return self.session_view.state.guidance

    @property
    def headline(self) -> str:
        return self.workspace.now.headline.text()

    def tap(self, *keys) -> None:
        """Press keys as the desktop brings them: to whatever window has them now."""
        for key in keys:
            QTest.keyClick(QApplication.activeWindow().windowHandle(), key)
            self.qtbot.wait(40)

    def dialog(self, kind: type[QDialog]):
        """Wait for a dialog to have the keys."""
        self.bench.until(lambda: isinstance(QApplication.activeWindow(), kind), 5000)
        return QApplication.activeWindow()

    def back_in_the_window(self) -> None:
        """Wait until the window has the keys again; the test's display has no window manager to hand them on."""
        self.bench.window.activateWindow()
        self.bench.until(self.bench.window.isActiveWindow, 5000)


@pytest.mark.timeout(400)
def test_a_guided_session_by_keys_alone_to_the_verdict_and_the_file(bench, plate, tmp_path, said, reached):
    keys = Keys(bench, plate, tmp_path / "recording")
    first_look(keys)
    follow_until_enough(keys)
    verdict = keys.dialog(VerdictDialog)
    assert verdict.sentence.text().startswith("All 4 taxels are finished"), "a demo shows its verdict by itself"
    keys.tap(Key.Key_Escape)
    keys.back_in_the_window()
    # The poke that was under way may ask for one more, before it is enough for good; that is said once it is judged.
    bench.until(lambda: keys.headline == approved("guide.enough", count=4), 20_000)
    bench.until(lambda: said[-1] == "enough", 5000)
    meant = asked_and_answered(keys, said, reached)
    hits = sum(peak == asked for asked, peak in meant)
    assert hits >= 0.6 * len(meant), "it ignores one target in twelve; by chance a quarter would be right"
    pokes = len(bench.snapshot.pokes)
    keys.qtbot.wait(2500)
    assert len(bench.snapshot.pokes) <= pokes + 1, "who sees that it is enough stops"
    assert QApplication.activeModalWidget() is None, "the verdict comes once"
    path = to_the_file(keys)
    the_file_is_right(keys, path, tmp_path / "recording")


def first_look(keys: Keys) -> None:
    """Pause, another target, undo, the other method, a look at the verdict, a pedal."""
    bench = keys.bench
    bench.until(lambda: len(bench.accepted()) >= 3 and all(p.outcome.final for p in bench.snapshot.pokes))
    keys.tap(Key.Key_Space)
    assert bench.controller.running is Running.PAUSED
    assert keys.headline == "Paused"
    assert keys.workspace.panels["Rig"].arm is None, "this part has no arm"
    shown = pixels(keys.workspace.map)
    target = keys.guidance.target.channel
    keys.tap(Key.Key_N)
    assert keys.guidance.target.channel != target
    assert changed(shown, pixels(keys.workspace.map)) > 60

    counted, last, shown = len(bench.accepted()), bench.accepted()[-1].poke, pixels(keys.workspace.map)
    keys.tap(Key.Key_Backspace)
    assert last not in [contact.poke for contact in bench.accepted()]
    assert len(bench.accepted()) == counted - 1
    now = pixels(keys.workspace.map)
    assert now.shape != shown.shape or changed(shown, now) > 20, "with fewer kinds of taxels its legend takes a line less"

    method = keys.guidance.method
    keys.tap(Key.Key_V)
    assert keys.guidance.method is not method
    for _ in range(len(keys.workspace.methods) - 1):
        keys.tap(Key.Key_V)
    assert keys.guidance.method is method is Method.MODULES, "what takes the fewest pokes is shown first"

    keys.tap(Key.Key_F)
    dialog = keys.dialog(VerdictDialog)
    assert dialog.sentence.text().startswith("Not finished: 0 of 4 taxels")
    keys.tap(Key.Key_Escape)
    keys.back_in_the_window()

    keys.tap(Key.Key_F3)
    keys.dialog(PedalsDialog)
    keys.tap(Key.Key_F13, Key.Key_Space)
    keys.back_in_the_window()
    keys.tap(Key.Key_F13)
    assert bench.controller.running is Running.STREAMING
    if any(command.keys == "M" for command in WINDOW_COMMANDS):
        keys.tap(Key.Key_M)


def follow_until_enough(keys: Keys) -> None:
    """Wait until the guide says enough."""
    bench = keys.bench
    empty = pixels(keys.workspace.view)
    bench.until(lambda: keys.guidance.phase is GuidePhase.ENOUGH, ENOUGH_MS)
    assert keys.guidance.finished == 4
    assert changed(empty, pixels(keys.workspace.view)) > 100


def asked_and_answered(keys: Keys, said: list[str], reached: list[int]) -> list[tuple[int, int]]:
    """Return which taxel was asked for and which answered most, for each target that the hand pressed: once, in order."""
    words = [line.split() for line in said]
    asked = {int(each[1]): int(each[2]) for each in words if each[0] == "target"}
    last = max(int(each[1]) for each in words if each[0] in ("accepted", "rejected"))
    # Its answer comes when the hand is back, after the verdict.
    keys.bench.until(lambda: last in reached)

    # A press before the hand knew the guide has no number. At the end a poke may be there before its answer, or after it.
    pokes = keys.bench.snapshot.pokes
    ends = [(len(reached) - max(0, late), len(pokes) - max(0, -late)) for late in (0, -1, 1, -2, 2)]
    aligned = [list(zip(reversed(reached[:answers]), reversed(pokes[:made]), strict=False)) for answers, made in ends]
    found = [[(asked[n], peak_channel(p.outcome)) for n, p in pairs if isinstance(p.outcome, Contact)] for pairs in aligned]
    return max(found, key=lambda meant: sum(peak == wanted for wanted, peak in meant))


def to_the_file(keys: Keys) -> Path:
    """Press the pedal, which is the space bar, until there is a file."""
    bench = keys.bench
    keys.tap(Key.Key_F13)
    verdict = keys.dialog(VerdictDialog)
    assert verdict.sentence.text().startswith(approved("verdict.all_done", count=4))
    assert bench.controller.running is Running.STREAMING, "the verdict did not pause"
    keys.tap(Key.Key_Space)
    export = keys.dialog(ExportDialog)
    keys.tap(Key.Key_Space)
    bench.until(lambda: "Written" in export.outcome.text(), OPEN_MS)
    path = Path(export.path.text())
    keys.tap(Key.Key_Space)
    keys.back_in_the_window()
    keys.tap(Key.Key_P)
    assert bench.controller.running is Running.PAUSED, "P pauses, whatever the guide says"
    return path


def the_file_is_right(keys: Keys, path: Path, recording: Path) -> None:
    """The file says what the window shows, near the truth; the recording says the same once more."""
    estimates = keys.bench.snapshot.estimates[Method.MODULES]
    written = load_reference(path, "plate", list(range(4)))
    truth = {each["channel"]: each["position_m"] for each in json.loads((recording / "truth.json").read_text())["taxels"]}
    off = []
    for estimate in estimates:
        assert estimate.state is State.TOUCHED
        np.testing.assert_allclose(written.places[estimate.channel], estimate.position, atol=2e-6)
        off.append(np.linalg.norm(estimate.position - truth[estimate.channel]))
    assert np.mean(off) < 0.003, "what was wanted"
    assert max(off) < 0.005
    bench = keys.bench
    pokes = len(bench.snapshot.pokes)
    bench.key(Key.Key_Q, Qt.KeyboardModifier.ControlModifier)
    assert len(list(recording.glob("segment-*.mcap"))) == 2, "a pause ends a segment"
    again = replay(recording).snapshot()
    assert len(again.pokes) == pokes
    for before, after in zip(estimates, again.estimates[Method.MODULES], strict=True):
        np.testing.assert_array_equal(before.position, after.position)


def test_a_tab_is_found_by_its_place_and_files_are_proposed_in_a_folder_that_exists(bench, recorded, tmp_path, monkeypatch):
    (recorded / "truth.json").unlink()
    bench.open(OpenRequest(session=recorded))
    assert bench.window.session_view.workspace.now.simulated.text() == "", "of a real rig"
    assert not bench.window.commands.actions["pace"].isEnabled()
    tabs = bench.window.session_view.workspace.tabs
    for index in range(tabs.count()):
        tabs.setTabText(index, f"&{tabs.tabText(index)}")
    bench.key(Qt.Key.Key_3)
    bench.window.session_view.show()
    bench.window.session_view.save()
    assert QSettings("skincal", "test").value("window/tab") == "Taxel"
    bench.until_all_is_there()
    assert bench.snapshot.pokes
    assert bench.player.played == [], "old pokes are not heard"
    proposed = []
    monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *given: proposed.append(given[2]) or (str(tmp_path / "a"), ""))
    bench.key(Qt.Key.Key_P, Qt.KeyboardModifier.ControlModifier)
    assert Path(proposed[0]).parent == recorded, "next to the session"
    assert (tmp_path / "a.png").is_file()


@pytest.mark.parametrize("minutes", [0, 6])
def test_a_session_without_a_poke_that_ends_at_once_leaves_no_folder(bench, tmp_path, minutes):
    folder = tmp_path / "made" / "empty"
    bench.open_served("flat-patch", folder=folder)
    assert folder.is_dir()
    if bench.snapshot.pokes:
        pytest.skip("the simulated hand was faster")
    bench.controller._opened_s -= 60.0 * minutes
    bench.controller.leave()
    bench.controller._endings.wait()
    assert folder.exists() is (minutes > 0)
    said = approved("message.empty", folder=folder)
    assert any(message.text == said for message in bench.messages) is (minutes == 0)
