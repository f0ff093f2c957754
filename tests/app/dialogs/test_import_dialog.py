"""A recording becomes a session from the menu: real files, what is seen of them first, the import, and how it is stopped."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QLineEdit, QPushButton, QWidget

from app.dialogs import form_widgets, import_dialog
from app.dialogs.import_dialog import ImportDialog
from app.session.opening import OpenRequest
from app.text.import_text import HOLDS_SESSION, NO_FOLDER, NO_RECORDING, READING_TEXT, imported_words, stream_row
from app.text_size import TEXT_SIZES_PERCENT
from skincal.files.importers.preview import StreamPreview
from skincal.model.readings import Stream
from skincal.session.importing import Imported
from skincal.session.replay import load
from tests.app.test_commands import dialog_of, gone, tap
from tests.app.test_window_drop import drop, of
from tests.app.whole_window import OPEN_MS
from tests.app.window_support import changed, pixels
from tests.app.workers import process_support
from tests.approved import approved
from tests.skincal.import_support import write_csv, write_yarp
from tests.skincal.poke_script import some_pokes, write_scene

Key = Qt.Key
CONTROL = Qt.KeyboardModifier.ControlModifier
POKES = 3


@pytest.fixture
def scene(tmp_path) -> Path:
    return write_scene(tmp_path / "source").path


@pytest.fixture
def samples(scene):
    from skincal.model.scene import load_scene

    return some_pokes(load_scene(scene), POKES).samples


def asked(bench) -> ImportDialog:
    bench.key(Key.Key_I, CONTROL)
    return dialog_of(bench, ImportDialog)


def until_seen(bench, dialog) -> None:
    bench.until(lambda: dialog._preview is not None or bool(dialog._trouble), OPEN_MS)
    bench.until(lambda: dialog._scene is not None, OPEN_MS)


def made(bench, scene, paths) -> ImportDialog:
    dialog = asked(bench)
    dialog.scene.setEditText(str(scene))
    dialog.assign_files(paths)
    until_seen(bench, dialog)
    return dialog


def files_under(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()] if folder.exists() else []


def test_a_recording_is_imported_by_keys_and_opens(bench, scene, samples, tmp_path):
    dialog = asked(bench)
    folder = write_yarp(tmp_path / "log", samples)
    assert not dialog.start.isEnabled()
    for field, text in (
        (dialog.fields[Stream.WRENCH], folder / "left_ft"),
        (dialog.fields[Stream.SKIN], folder / "left_forearm_skin"),
        (dialog.scene, scene),
    ):
        while dialog.focusWidget() is not field:
            tap(bench, Key.Key_Tab)
        line = field if isinstance(field, QLineEdit) else field.lineEdit()
        line.selectAll()
        QTest.keyClicks(field, str(text))
    until_seen(bench, dialog)
    assert dialog.objection.isVisible() is False
    assert dialog.kind.text().startswith("Logs of yarpdatadumper: force/torque sensor, skin.")
    rows = [[dialog.streams.topLevelItem(k).text(column) for column in (0, 4)] for k in range(2)]
    assert rows == [["Force/torque sensor", "6"], ["Skin", "24"]]
    assert "up to" in dialog.curve.accessibleDescription()
    assert "channels in a row" in dialog.frame_words.text()
    assert files_under(bench.documents) == [], "nothing is written before it is asked for"
    with bench.qtbot.waitSignal(bench.controller.session_opened, timeout=OPEN_MS):
        while dialog.focusWidget() is not dialog.start:
            tap(bench, Key.Key_Tab)
        tap(bench, Key.Key_Space)
    gone(bench, ImportDialog)
    where = bench.controller.folder
    assert where.parent == bench.documents
    assert len(load(where).snapshot().contacts) == POKES
    bench.until(lambda: bench.window.session_view.state is not None, 5000)
    assert len(bench.snapshot.pokes) == POKES
    assert bench.window._import is None
    # The next one begins with this scene.
    bench.window._drop_session()
    assert asked(bench).scene.currentText() == str(scene)


def test_tables_that_are_dropped_lead_to_the_same(bench, scene, samples, tmp_path):
    folder = write_csv(tmp_path / "tables", samples)
    assert drop(bench.window, of(folder / "b.csv"), of(folder / "a.csv"))
    dialog = dialog_of(bench, ImportDialog)
    dialog.scene.setEditText(str(scene))
    until_seen(bench, dialog)
    assert [field.text() for field in dialog.fields.values()] == [str(folder / "a.csv"), str(folder / "b.csv"), "", ""]
    assert dialog.start.isEnabled()
    # A part of a name is completed to a place of the recording.
    skin = dialog.fields[Stream.SKIN]
    skin.setFocus()
    skin.selectAll()
    QTest.keyClicks(skin, "a.c")
    popup = skin.completer().popup()
    bench.until(popup.isVisible, 5000)
    QTest.keyClick(popup, Key.Key_Down)
    QTest.keyClick(popup, Key.Key_Return)
    assert skin.text() == str(folder / "a.csv")
    # Onto the dialog, too.
    other = write_yarp(tmp_path / "log", samples)
    assert drop(dialog, of(other))
    bench.until(lambda: dialog.fields[Stream.SKIN].text() == str(other / "left_forearm_skin"), 5000)
    assert drop(dialog, of(scene))
    assert NO_RECORDING in dialog.objection.text()


def test_what_is_wrong_is_one_sentence_and_nothing_can_be_imported(bench, scene, samples, tmp_path, recorded):
    bench.open(OpenRequest(session=recorded))
    dialog = asked(bench)
    assert dialog.scene.currentText() == str(bench.window.session_view.workspace.part.scene.path), "of the open session"
    tap(bench, Key.Key_Escape)
    gone(bench, ImportDialog)
    folder = write_yarp(tmp_path / "log", samples)
    dialog = made(bench, scene, [folder])
    assert dialog.start.isEnabled()
    dialog.scene.setCurrentText("flat-patch")
    words = approved("overview.width", found=24, scene="flat-patch", wanted=64)
    bench.until(lambda: words in dialog.objection.text(), 5000)
    assert not dialog.start.isEnabled()
    dialog.scene.setEditText(str(tmp_path / "gone.toml"))
    bench.until(lambda: "gone.toml" in dialog.objection.text(), 5000)
    dialog.scene.setEditText(str(scene))
    bench.until(dialog.start.isEnabled, 5000)
    for place, said in ((recorded, HOLDS_SESSION), (" ", NO_FOLDER), (tmp_path / ("n" * 300), "cannot be read")):
        dialog.folder.setText(str(place))
        bench.until(lambda said=said: said in dialog.objection.text(), 5000)
        assert not dialog.start.isEnabled()
    dialog.folder.setText(str(tmp_path / "new"))
    bench.until(dialog.start.isEnabled, 5000)
    (folder / "left_ft" / "data.log").write_text("nothing of a log\n")
    dialog.assign_files([folder / "left_forearm_skin"])
    bench.until(lambda: not dialog.start.isEnabled(), 5000)
    dialog.fields[Stream.WRENCH].setText(str(folder / "left_ft"))
    bench.until(lambda: "left_ft" in dialog.objection.text(), OPEN_MS)
    assert not dialog.start.isEnabled()
    dialog.assign_files([tmp_path / "nowhere"])
    bench.until(lambda: "no recording was found" in dialog.objection.text(), 5000)


def test_a_slow_disk_never_holds_the_page(bench, scene, samples, tmp_path, monkeypatch):
    dialog = made(bench, scene, [write_yarp(tmp_path / "log", samples)])
    threads = []
    for module, name in ((form_widgets, "load_scene"), (import_dialog, "guess_streams"), (import_dialog, "missing_folders")):
        real = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *given, real=real: threads.append(threading.current_thread()) or real(*given))
    dialog.folder.setText(str(tmp_path / "elsewhere"))
    dialog.scene.setEditText("flat-patch")
    dialog.assign_files([tmp_path / "log"])
    bench.until(lambda: len(threads) == 3, 5000)
    bench.qtbot.wait(100)
    assert len(threads) == 3, "a letter of the folder reads no scene"
    assert threading.main_thread() not in threads
    until_seen(bench, dialog)


def test_an_arm_needs_its_joints_or_a_pose(bench, samples, tmp_path):
    dialog = asked(bench)
    dialog.scene.setCurrentText("icub-forearm")
    bench.until(lambda: dialog.pose.count() > 2, OPEN_MS)
    dialog.assign_files([write_yarp(tmp_path / "log", samples)])
    until_seen(bench, dialog)
    assert approved("overview.pose") in dialog.objection.text()
    dialog.pose.setCurrentIndex(1)
    assert approved("overview.pose") not in dialog.objection.text()
    dialog.fields[Stream.JOINTS].setText("anything")
    assert not dialog.pose.isEnabled()


def long_import(bench, scene, tmp_path) -> tuple[ImportDialog, Path]:
    """One that takes some seconds, begun."""
    from skincal.model.scene import load_scene

    dialog = made(bench, scene, [write_yarp(tmp_path / "log", some_pokes(load_scene(scene), 60).samples, 8)])
    where = tmp_path / "deep" / "session"
    dialog.folder.setText(str(where))
    dialog.start.setFocus()
    tap(bench, Key.Key_Space)
    bench.until(lambda: dialog.importing, 5000)
    bench.until(lambda: dialog.progress.value() > 0, OPEN_MS)
    assert where.exists()
    return dialog, where


def test_an_import_that_is_stopped_leaves_nothing_behind(bench, scene, tmp_path):
    dialog, _ = long_import(bench, scene, tmp_path)
    assert not dialog.form.isEnabled()
    assert dialog.focusWidget() is dialog.stop
    tap(bench, Key.Key_Escape)
    assert dialog.isVisible()
    bench.until(lambda: not dialog.importing, OPEN_MS)
    assert approved("import.stopped") in dialog.objection.text()
    assert not (tmp_path / "deep").exists()
    assert dialog.start.isEnabled()
    tap(bench, Key.Key_Escape)
    gone(bench, ImportDialog)


def test_an_import_that_hears_nothing_is_stopped_within_a_second(bench, scene, samples, tmp_path, monkeypatch):
    dialog = made(bench, scene, [write_yarp(tmp_path / "log", samples)])
    dialog.folder.setText(str(tmp_path / "deep" / "session"))
    monkeypatch.setattr(import_dialog, "import_job", process_support.deaf_import)
    dialog._start_import()
    bench.until((tmp_path / "deep" / "session" / "segment-0001.mcap").exists, OPEN_MS)
    tap(bench, Key.Key_Escape)
    bench.until(lambda: not dialog.importing, 1000)
    assert approved("import.stopped") in dialog.objection.text()
    bench.until(lambda: not (tmp_path / "deep").exists(), 5000)
    bench.until(dialog.start.isEnabled, 5000)


def test_a_page_that_looks_at_a_large_log_closes_without_waiting_for_it(bench, scene, samples, tmp_path, monkeypatch):
    dialog = made(bench, scene, [write_yarp(tmp_path / "log", samples)])
    monkeypatch.setattr(import_dialog, "preview_job", process_support.deaf_look)
    dialog.assign_files([tmp_path / "log"])
    bench.until(lambda: bool(dialog._jobs.waiting) and dialog._jobs.waiting[0].pid is not None, 5000)
    assert dialog.kind.text() == READING_TEXT
    began = time.monotonic()
    tap(bench, Key.Key_Escape)
    assert time.monotonic() - began < 20.0, "the look takes a minute"
    gone(bench, ImportDialog)


def test_a_process_that_is_killed_leaves_nothing_behind_and_another_takes_its_place(bench, scene, tmp_path):
    dialog, where = long_import(bench, scene, tmp_path)
    (process,) = dialog._jobs.waiting
    os.kill(process.pid, signal.SIGTERM)
    with bench.qtbot.waitSignal(bench.controller.session_opened, timeout=OPEN_MS):
        pass
    assert bench.controller.folder == where
    assert len(load(where).snapshot().pokes) == 60


def test_a_window_that_closes_meanwhile_leaves_nothing_behind(bench, scene, tmp_path):
    long_import(bench, scene, tmp_path)
    bench.window.leave()
    bench.until(lambda: not (tmp_path / "deep").exists(), 5000)


def test_every_control_has_a_name_and_is_reached_by_the_tab_key(bench, scene, samples, tmp_path):
    dialog = made(bench, scene, [write_yarp(tmp_path / "log", samples)])
    reached: list[QWidget] = []
    while (widget := dialog.focusWidget()) not in reached:
        reached.append(widget)
        tap(bench, Key.Key_Tab)
    wanted = [
        *(each for each in dialog.fields.values() if each.isVisible()),
        dialog.take_folder,
        dialog.take_files,
        dialog.scene,
        dialog.folder,
        dialog.streams,
    ]
    assert {*wanted, dialog.start, dialog.stop} <= set(reached)
    for widget in reached:
        assert widget.accessibleName() or (isinstance(widget, QPushButton) and widget.text()), widget
    names = [button.accessibleName() for button in dialog.findChildren(QPushButton) if button.accessibleName()]
    assert len(set(names)) == len(names) == 6
    with_curve = pixels(dialog.curve)
    with_frame = pixels(dialog.frame)
    dialog.frame.show_frame(np.empty((0, 0)), "")
    assert changed(with_frame, pixels(dialog.frame)) > 100
    dialog.curve.show_curve(np.empty((0, 2)), "")
    assert changed(with_curve, pixels(dialog.curve)) > 100


@pytest.mark.parametrize("percent", [TEXT_SIZES_PERCENT[0], TEXT_SIZES_PERCENT[-1]])
def test_it_fits_the_screen_in_every_size_of_the_text(bench, scene, samples, tmp_path, percent):
    bench.window.text_size.choose(percent)
    dialog = made(bench, scene, [write_yarp(tmp_path / "log", samples)])
    assert dialog.screen().availableGeometry().contains(dialog.geometry())
    assert dialog.form.sizeHint().width() <= dialog.width()
    for button in (dialog.start, dialog.stop):
        assert dialog.rect().contains(button.geometry())
    assert dialog.curve.height() >= 60


def test_what_is_said_of_a_stream():
    skin = StreamPreview(Stream.SKIN, "f", 12_000, 50.0, 240.04, 24, (255.0, 12.25))
    assert stream_row(skin) == (
        "Skin", "12\N{NARROW NO-BREAK SPACE}000", "50 Hz", "240.0", "24", "255.0  12.2  \N{HORIZONTAL ELLIPSIS}  raw"
    )  # fmt: skip
    empty = StreamPreview(Stream.JOINTS, "f", 1, 0.0, 0.0, 0, ())
    assert stream_row(empty)[2:] == ("\N{EN DASH}", "0.0", "\N{EN DASH}", "\N{EN DASH}")
    assert imported_words(Imported(Path("s"), 3, 2)) == "The recording is the session s: 3 pokes, 2 accepted."
    assert imported_words(Imported(Path("s"), 0, 0, "Nothing pressed.")) == "Nothing pressed. The recording is the session s."
