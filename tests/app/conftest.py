"""What the tests of the window share: settings of their own, and nothing left behind."""

from __future__ import annotations

import gc
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from PySide6.QtCore import QCoreApplication, QEvent, QSettings, QThread, QTimer
from PySide6.QtWidgets import QApplication

from skincal.model.scene import resource
from skincal.robot.target_lines import Answer, AnswerKind, write_line
from skincal.robot.target_server import TargetServer

WAIT_S = 5.0  # s. A thread that was told to stop has so long on a busy machine.
ENDING = ("reader ", "skincal-")  # Names of the program's threads that must end with the window


@pytest.fixture(autouse=True, scope="session")
def _garbage_in_this_thread() -> Iterator[None]:
    """As in the program, cyclic garbage is ended in this thread alone: a worker would end widgets that Qt still uses."""
    gc.disable()
    yield
    gc.enable()


@pytest.fixture(autouse=True)
def _own_settings(tmp_path: Path) -> Iterator[None]:
    """Keep the operator's settings out of the tests, and the tests' out of the operator's."""
    before = QSettings.defaultFormat()
    QSettings.setDefaultFormat(QSettings.Format.IniFormat)
    # Settings of a named program are native ones whatever the default is; on Unix these are INI files, too.
    for kind in (QSettings.Format.IniFormat, QSettings.Format.NativeFormat):
        QSettings.setPath(kind, QSettings.Scope.UserScope, str(tmp_path / "settings"))
    yield
    QSettings.setDefaultFormat(before)


@pytest.fixture(autouse=True)
def _no_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    """The dialog for a new session looks for ROS topics for two seconds: only in its own test."""
    monkeypatch.setattr("app.dialogs.new_session.list_topics", lambda: ([], ""))
    monkeypatch.setattr("app.dialogs.new_session.list_trackers", list)


def _left() -> list[str]:
    """Return what of Qt is alive: windows, timers that run, threads that run."""
    found = [f"window {w!r}" for w in QApplication.topLevelWidgets() if w.isVisible()]
    for thing in gc.get_objects():
        try:
            if isinstance(thing, QTimer) and thing.isActive():
                found.append(f"timer {thing!r} of {thing.parent()!r}")
            elif isinstance(thing, QThread) and thing.isRunning() and thing is not QThread.currentThread():
                found.append(f"QThread {thing!r}")
        except (RuntimeError, ReferenceError):
            continue  # Qt's side of it is gone.
    return found


@pytest.fixture(autouse=True)
def _nothing_left() -> Iterator[None]:
    """Fail a test that leaves a window, a running timer or a thread behind; qtbot closes its own windows before.

    Objects of earlier tests are frozen: a look at all of them takes half a second, at those of this test a millisecond.
    """
    before = set(threading.enumerate())
    gc.freeze()
    yield
    if QCoreApplication.instance() is None:
        return
    QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
    threads = [t for t in threading.enumerate() if t not in before and t.name.startswith(ENDING)]
    for thread in threads:
        thread.join(WAIT_S)
    gc.collect()
    left = _left() + [f"thread {t.name}" for t in threads if t.is_alive()]
    assert not left, f"left behind: {left}"


@pytest.fixture(autouse=True)
def _own_theme() -> Iterator[None]:
    """Give the next test the theme that this one found."""
    app = QApplication.instance()
    before = None if app is None else (app.palette(), app.styleSheet(), app.font())
    yield
    app = QApplication.instance()
    if before is not None and (app.palette(), app.styleSheet(), app.font()) != before:
        app.setPalette(before[0])
        app.setStyleSheet(before[1])
        app.setFont(before[2])


@pytest.fixture
def bench(qtbot, tmp_path):
    from tests.app.whole_window import Bench  # tests of one widget or picture need not wait for the whole window

    made = Bench(qtbot, tmp_path)
    yield made
    made.window.close()


@pytest.fixture(scope="session")
def recorded_once(tmp_path_factory):
    """A short session on the forearm, recorded without a window; opening it would write into it."""
    from skincal.mesh.load import load_surface
    from skincal.model.scene import load_scene
    from skincal.simulation.rig_errors import RigErrors
    from skincal.simulation.virtual_session import simulate_session

    scene = load_scene(resource("scenes/icub-forearm/scene.toml"))
    folder = tmp_path_factory.mktemp("recorded") / "session"
    simulate_session(scene, load_surface(scene.surface)[0], folder, 3, 3, RigErrors.none())
    return folder


@pytest.fixture
def recorded(recorded_once, tmp_path):
    """A session on the forearm, this test's own: what a window does to it, no other test finds."""
    return shutil.copytree(recorded_once, tmp_path / "recorded" / "session")


@pytest.fixture
def said():
    """What the window asked its simulated operator, as lines in order."""
    lines: list[str] = []
    send = TargetServer.send

    def record(server, asked):
        lines.extend(write_line(line) for line in asked)
        send(server, asked)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(TargetServer, "send", record)
        yield lines


@pytest.fixture
def reached():
    """Numbers of the targets that the simulated operator pressed, in order."""
    numbers: list[int] = []
    read = TargetServer.read_answers

    def note(server):
        answers = read(server)
        numbers.extend(each.number for each in answers if isinstance(each, Answer) and each.kind is AnswerKind.REACHED)
        return answers

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(TargetServer, "read_answers", note)
        yield numbers
