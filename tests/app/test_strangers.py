"""The window and a stranger's session: every text is plain, devices are asked about, and another's recording is looked at."""

import ast
import os
from dataclasses import replace
from pathlib import Path

import pytest
from PySide6.QtCore import QSettings, Qt
from PySide6.QtGui import QTextDocument
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QLabel, QMessageBox

import app
from app import run
from app.panels.pokes_panel import PokeTable
from app.panels.widgets import ElidedLabel, escape_tooltip
from app.session.controller import Controller
from app.session.opening import Addresses, OpenRequest
from app.state.running import Running
from app.theme import Choice
from app.window import MAX_REMEMBERED_ADDRESSES, Theme, Window
from app.workers.device_process import DeviceProcess
from skincal.journal.writer import create_session
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load
from skincal.streams.links import LinkSpec
from skincal.words.units import ChannelNames
from tests.app.whole_window import Bench, Listener
from tests.skincal.poke_script import LINKS, as_chunks, some_pokes, write_scene

TRAP = '<img src="/nothing/there">'


def test_no_label_and_no_tooltip_takes_a_text_for_html(qtbot):
    Theme(Choice.DARK)
    label, rich = QLabel(TRAP), QLabel("<b>ours</b>")
    rich.setProperty("rich", True)
    for widget in (label, rich):
        qtbot.addWidget(widget)
        widget.show()
    assert label.textFormat() is Qt.TextFormat.PlainText
    assert rich.textFormat() is Qt.TextFormat.RichText
    elided = ElidedLabel()
    qtbot.addWidget(elided)
    elided.setText(TRAP)
    assert "<img" not in elided.toolTip()
    elided.setText("as it is")
    assert elided.toolTip() == "as it is"


def test_a_tip_keeps_its_lines_and_shows_what_looks_like_html():
    document = QTextDocument()
    document.setHtml(escape_tooltip(f"two\nlines of {TRAP} & more"))
    assert document.toPlainText().replace("\u2028", "\n") == f"two\nlines of {TRAP} & more"
    assert escape_tooltip("two\nlines & more") == "two\nlines & more"


def tips(tree):
    """What a file gives for tooltips: the text of each call that sets or shows one."""
    for call in ast.walk(tree):
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute):
            if call.func.attr in ("setToolTip", "setTabToolTip", "setToolTipText"):
                yield call.args[-1]
            elif call.func.attr == "showText":
                yield call.args[1]


def is_plain(text):
    match text:
        case ast.Constant() | ast.Call(func=ast.Name("escape_tooltip" | "link_tooltip")):
            return True
        case ast.Name(name) | ast.Subscript(value=ast.Name(name)):
            return name.isupper()  # a constant of a file, or a table of texts
        case ast.IfExp():
            return is_plain(text.body) and is_plain(text.orelse)
    return False


def test_every_tooltip_is_a_text_of_ours_or_made_plain():
    found = [(path, tip) for path in Path(app.__file__).parent.rglob("*.py") for tip in tips(ast.parse(path.read_bytes()))]
    assert len(found) > 10
    assert [f"{path.name}:{tip.lineno}" for path, tip in found if not is_plain(tip)] == []


def test_the_tip_of_a_poke_shows_the_pose_of_a_stranger_as_it_is(folder):
    pipeline = load(folder)
    snapshot = pipeline.snapshot()
    (first, *_) = snapshot.pokes
    table = PokeTable(ChannelNames(pipeline.scene.skin.layout))
    table.show(replace(snapshot, pokes=(replace(first, outcome=replace(first.outcome, pose=TRAP)),)), {})
    tip = table.data(table.index(0, 0), Qt.ItemDataRole.ToolTipRole)
    assert "/nothing/there" in tip
    assert "<img" not in tip


def strangers_links(tmp_path):
    """Links whose devices no operator has named."""
    return tuple(LinkSpec(link.name, f"file:{tmp_path}/{link.name}.none", link.carries, "skt") for link in LINKS)


@pytest.fixture
def folder(tmp_path):
    """A session whose device is a stranger's, with two pokes."""
    scene = write_scene(tmp_path / "source")
    links = strangers_links(tmp_path)
    pipeline = Pipeline(scene, links, None, create_session(tmp_path / "s", scene, links))
    for item in as_chunks(some_pokes(scene, 2).samples):
        pipeline.feed(item)
    pipeline.close()
    return tmp_path / "s"


@pytest.fixture
def bench(qtbot, tmp_path):
    QSettings("skincal", "test").remove("addresses")
    made = Bench(qtbot, tmp_path / "bench")
    yield made
    made.window.close()
    QSettings("skincal", "test").remove("addresses")


def asked(window):
    """The question that is open, if there is one."""
    return next((box for box in window.findChildren(QMessageBox) if box.isVisible()), None)


def answer(window, words):
    box = asked(window)
    next(button for button in box.buttons() if button.text() == words).click()


def test_the_devices_of_a_recorded_session_are_shown_and_asked_about_once(bench, folder):
    bench.open(OpenRequest(session=folder))
    bench.controller.toggle()
    assert bench.controller.running is Running.OFFLINE
    assert all(link.address in asked(bench.window).text() for link in bench.controller.links)
    QTest.keyClick(asked(bench.window).focusWidget(), Qt.Key.Key_Space)
    assert asked(bench.window) is None
    assert bench.controller.running is Running.OFFLINE, "pressed twice, it connects nothing"
    bench.controller.toggle()
    answer(bench.window, "Connect")
    assert bench.controller.running is Running.STREAMING
    bench.controller.pause()
    bench.controller.toggle()
    assert bench.controller.running is Running.STREAMING
    bench.open(OpenRequest(session=folder))
    bench.controller.toggle()
    assert bench.controller.running is Running.STREAMING, "agreed to before"


def test_addresses_that_the_operator_names_are_not_asked_about(qtbot, tmp_path):
    settings = QSettings(str(tmp_path / "settings.ini"), QSettings.Format.IniFormat)
    window = Window(Controller(tmp_path), Theme(Choice.DARK), settings, tmp_path, Listener())
    qtbot.addWidget(window)
    window._remember({"/dev/ttyUSB0", "COM3"})
    seen = []
    for address in ("COM3", "/dev/ttyUSB0", "COM4"):
        window._confirm_addresses((address,), lambda address=address: seen.append(address))
    assert seen == ["COM3", "/dev/ttyUSB0"]
    # The oldest are forgotten first.
    for number in range(MAX_REMEMBERED_ADDRESSES):
        window._remember([f"tcp:10.0.0.{number}"])
    window._remember(["/dev/ttyUSB0"])
    known = window._known_addresses()
    assert len(known) == MAX_REMEMBERED_ADDRESSES
    assert known[0] == "tcp:10.0.0.1"
    assert known[-1] == "/dev/ttyUSB0"
    window.close()


def test_addresses_of_the_command_line_are_named_by_the_operator(bench, folder, tmp_path, monkeypatch):
    monkeypatch.setattr(run, "start_log", lambda: "")
    named = Addresses(*(f"file:{tmp_path}/{stream}.none" for stream in ("wrench", "skin")))
    with bench.qtbot.waitSignal(bench.controller.session_opened, timeout=40_000):
        run.start_log_and_open(bench.window, OpenRequest(session=folder, addresses=named))
    bench.open(OpenRequest(session=folder))
    assert {link.address for link in bench.controller.links} == {named.wrench, named.skin}
    bench.controller.toggle()
    assert asked(bench.window) is None
    assert bench.controller.running is Running.STREAMING


def test_a_session_that_is_being_recorded_is_looked_at_and_not_touched(bench, tmp_path):
    scene = write_scene(tmp_path / "source")
    pipeline = Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
    items = as_chunks(some_pokes(scene, 3).samples)
    for item in items[: len(items) * 3 // 4]:
        pipeline.feed(item)
    before = {path.name: path.read_bytes() for path in (tmp_path / "s").iterdir() if path.is_file()}
    bench.window.open(OpenRequest(session=tmp_path / "s"))
    bench.until(lambda: asked(bench.window) is not None, 20_000)
    assert f"is being recorded by process {os.getpid()}" in asked(bench.window).text()
    with bench.qtbot.waitSignal(bench.controller.session_opened, timeout=40_000):
        answer(bench.window, "View")
    assert len(bench.recording.pipeline.session.contacts) >= 1
    assert not bench.controller.has_simulator
    bench.controller.toggle()
    assert bench.controller.findChild(DeviceProcess) is None, "its rig is another's"
    assert asked(bench.window) is None, "nothing is to be connected"
    assert bench.controller.running is Running.OFFLINE
    assert any("read-only" in message.text for message in bench.messages)
    assert {path.name: path.read_bytes() for path in (tmp_path / "s").iterdir() if path.is_file()} == before
    for item in items[len(items) * 3 // 4 :]:
        pipeline.feed(item)
    pipeline.close()
    assert not pipeline.journal_failure
