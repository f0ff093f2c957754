"""How the program starts: commands without Qt, a sentence where no window can be opened, and the window as a process."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from PySide6.QtCore import QStandardPaths

from app import run
from app.__main__ import main
from app.preflight import QT_LIBRARIES, X_LIBRARIES, objection
from app.session.opening import OpenRequest, begin_session
from app.state.running import Running
from app.workers.device_process import DeviceProcess
from skincal.following.session_guide import SessionGuide
from skincal.model.readings import Stream
from skincal.model.scene import resource
from skincal.streams.links import LinkSpec
from tests.approved import approved

ROOT = Path(__file__).resolve().parents[2]
LIMIT_S = 60


def python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")}
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=env | environment,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )


@pytest.mark.parametrize("arguments", ['["--version"]', '["solve", "--help"]', '["no-such-command"]'])
def test_a_command_imports_no_qt(arguments):
    done = python(
        f"import sys; from app.__main__ import main; code = main({arguments});"
        "assert not [m for m in sys.modules if m.startswith(('PySide6', 'vtk', 'pyvista'))], 'Qt or VTK'; sys.exit(code)"
    )
    assert done.returncode == (2 if "no-such" in arguments else 0), done.stderr
    assert "Traceback" not in done.stderr


def test_an_interrupt_while_a_command_is_imported_is_no_traceback():
    done = python(
        "import sys, builtins; from app.__main__ import main; real = __import__\n"
        "def stop(name, *rest):\n    if name == 'skincal.cli': raise KeyboardInterrupt\n    return real(name, *rest)\n"
        "builtins.__import__ = stop; sys.exit(main(['solve', 'x']))"
    )
    assert (done.returncode, done.stderr) == (130, "")


def test_the_window_is_on_the_screen_before_anything_heavy_is_imported():
    heavy = ("numpy", "wasmtime", "vtkmodules", "pyqtgraph", "skincal.session.session")
    done = python(f"import sys, app.run; sys.exit(', '.join(name for name in {heavy} if name in sys.modules) or 0)")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("arguments", [["--help"], ["-h"], ["--scene", "flat-patch", "--help"]])
def test_help_lists_the_options_of_the_window(arguments, capsys):
    assert main(arguments) == 0
    said = capsys.readouterr().out
    options = ("--scene", "--session", "--wrench", "--skin", "--joints", "--new", "--headless")
    assert all(f"\n  {option}" in said for option in options)
    assert ("Write the calibration" in said) is (len(arguments) == 1), (
        "commands are listed where help of everything is asked for"
    )


@pytest.mark.parametrize("arguments", [["--scnee", "flat-patch"], ["--session"], ["--targets"]])
def test_a_wrong_option_of_the_window_is_one_sentence(arguments, capsys):
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith("skincal: ")
    assert arguments[0] in said
    assert said.endswith("; `skincal --help` shows what is possible.\n")
    assert said.count("\n") == 1


def test_devices_without_a_display_end_in_a_sentence_and_code_2():
    done = python("import sys; from app.__main__ import main; sys.exit(main(['--wrench', 'a', '--skin', 'b']))")
    assert done.returncode == 2
    assert approved("start.no_display") in done.stderr
    assert "skincal record" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("['--wrench', 'a']", approved("start.no_skin_named")),
        ("['--wrench', 'spy:///dev/null?file=x', '--skin', 'b']", approved("links.refused_scheme_clause", scheme="spy")),
        ("['--scene', 'nowhere/scene.toml']", "nowhere"),
        ("['--session', 'nowhere']", "nowhere"),
        ("['--session', 'README.md']", "README.md: not a session (it is no folder)"),
        ("['--session', 'docs']", "docs: not a session (no segment-0001.mcap in it)"),
        ("['--scene', 'README.md']", "README.md: "),
        ("['--scene', 'docs']", "docs: is a folder"),
        ("['--colour']", "--colour"),
    ],
)
def test_wrong_options_end_in_a_sentence_and_code_2(arguments, said):
    display = os.environ.get("DISPLAY")
    if not display:
        pytest.skip("there is no display here")
    done = python(f"import sys; from app.__main__ import main; sys.exit(main({arguments}))", DISPLAY=display)
    assert done.returncode == 2, done.stderr
    assert said in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("other", [["--scene", "no-such"], ["--scene", "icub-forearm"], ["--new", "x"], ["--headless"]])
def test_what_a_recorded_session_would_ignore_is_refused(other, tmp_path, capsys):
    assert main(["--session", str(tmp_path), *other]) == 2
    said = capsys.readouterr().err
    assert approved("start.session_with_other", folder=tmp_path, other=other[0]) in said


def test_a_missing_library_is_named_with_the_line_that_installs_it():
    lacking = {"libEGL.so.1", "libxcb-cursor.so.0"}
    said = objection({"DISPLAY": ":7"}, "linux", lambda name: name not in lacking, lambda: True)
    assert said.endswith(approved("start.install", packages="libegl1 libxcb-cursor0"))


def test_only_a_window_on_x_needs_the_libraries_of_x():
    said = objection({"QT_QPA_PLATFORM": "offscreen"}, "linux", lambda name: name not in X_LIBRARIES, lambda: False)
    assert said == ""
    said = objection({"DISPLAY": ":7"}, "linux", lambda name: name not in X_LIBRARIES, lambda: True)
    assert all(package in said for package in X_LIBRARIES.values())
    assert not any(package in said.split() for package in QT_LIBRARIES.values())


def test_a_display_that_does_not_answer_is_not_a_display():
    assert "does not answer" in objection({"DISPLAY": ":7"}, "linux", lambda _: True, lambda: False)
    assert "no display" in objection({}, "linux", lambda _: True, lambda: False)


def test_wayland_is_a_display_where_its_socket_is(tmp_path):
    env = {"WAYLAND_DISPLAY": "wayland-0", "XDG_RUNTIME_DIR": str(tmp_path)}
    assert approved("start.no_window") in objection(env, "linux", lambda _: True, lambda: False)
    (tmp_path / "wayland-0").touch()
    assert objection(env, "linux", lambda _: True, lambda: False) == ""


@pytest.mark.parametrize("platform", ["win32", "darwin"])
def test_other_systems_bring_what_is_needed(platform):
    assert objection({}, platform, lambda _: False, lambda: False) == ""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="signals as on Linux and macOS")
def test_the_window_as_a_process_ends_clean_when_it_is_told_to(tmp_path):
    display = os.environ.get("DISPLAY")
    if not display:
        pytest.skip("there is no display here")
    env = os.environ | {"HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path / "c"), "TMPDIR": str(tmp_path)}
    window = subprocess.Popen(
        [sys.executable, "-m", "app", "--scene", "flat-patch"], cwd=ROOT, env=env, stderr=subprocess.PIPE, text=True
    )
    end = time.monotonic() + LIMIT_S
    while not list(tmp_path.glob("Documents/skincal/*/segment-*.mcap")) and time.monotonic() < end:
        time.sleep(0.1)
    assert list(tmp_path.glob("Documents/skincal/*/segment-*.mcap")), "no recording began"
    window.terminate()
    _, said = window.communicate(timeout=LIMIT_S)
    assert window.returncode == 0, said
    assert "Traceback" not in said


def test_a_log_that_cannot_be_written_leaves_the_window_at_work(bench, tmp_path, monkeypatch):
    (tmp_path / "data").write_text("a file where the folder should be")
    monkeypatch.setattr(QStandardPaths, "writableLocation", lambda _: str(tmp_path / "data" / "skincal"))
    said = []
    monkeypatch.setattr(bench.window, "tell", said.append)
    run.start_log_and_open(bench.window, OpenRequest(session=tmp_path / "none"))
    bench.until(lambda: bench.controller.running is Running.OFFLINE, 20_000)
    assert any("the log cannot be written" in message.text for message in said)


def test_a_session_begins_once_when_its_devices_are_ready_before_its_panels(bench, monkeypatch):
    begun = []
    links = (LinkSpec("wrench", "tcp://127.0.0.1:1", (Stream.WRENCH,)), LinkSpec("skin", "tcp://127.0.0.1:2", (Stream.SKIN,)))
    monkeypatch.setattr(DeviceProcess, "start", lambda *_: None)
    monkeypatch.setattr(DeviceProcess, "listen", lambda process: process.served.emit(links))
    monkeypatch.setattr("app.session.controller.begin_session", lambda *given: begun.append(given) or begin_session(*given))
    bench.open(OpenRequest(scene=resource("scenes/flat-patch/scene.toml"), server=("served",)))
    bench.controller._threads.wait()
    assert len(begun) == 1


def test_a_device_that_fails_before_the_panels_are_there_leaves_no_line_that_something_opens(bench, monkeypatch):
    monkeypatch.setattr(DeviceProcess, "start", lambda process, _: process.failed.emit("The devices failed."))
    bench.window.open(OpenRequest(scene=resource("scenes/flat-patch/scene.toml"), server=("served",)))
    bench.until(lambda: bench.window.session_view is not None)
    assert bench.controller.running is Running.OFFLINE
    assert bench.window.workspace.now.headline.text() == "Nothing to show"


def test_a_session_begins_also_where_nothing_draws(bench, monkeypatch):
    """It waits for the picture of the part, or for the reason why there is none."""

    def refuse(*_):
        raise OSError("there is no driver")

    monkeypatch.setattr("app.scene3d.view.load", refuse)
    bench.open_served("flat-patch")
    assert bench.window.workspace.view.list_layers() == ()
    assert bench.controller.running is Running.STREAMING


def test_a_session_begins_also_while_a_driver_hangs(bench, monkeypatch):
    may_end = threading.Event()

    def hang(*_):
        may_end.wait()
        raise OSError("there is no driver")

    monkeypatch.setattr("app.scene3d.view.load", hang)
    monkeypatch.setattr("app.scene3d.view.SETTLED_AFTER_MS", 300)
    try:
        bench.open_served("flat-patch")
        assert bench.controller.running is Running.STREAMING
    finally:
        may_end.set()


def test_the_guide_of_a_new_session_is_made_beside_the_windows_thread(bench, monkeypatch):
    makers: list[threading.Thread] = []
    make = SessionGuide._new_guide

    def noted(guide: SessionGuide, *arguments, **options):
        makers.append(threading.current_thread())
        return make(guide, *arguments, **options)

    monkeypatch.setattr(SessionGuide, "_new_guide", noted)
    bench.open_served()
    assert bench.window.session_view.state.target is not None
    assert makers
    assert threading.main_thread() not in makers


PICTURE_FIRST = """
import linecache
import sys
from pathlib import Path
from PySide6 import QtCore, QtGui, QtWidgets
from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QApplication
from app.run import run_window
from app.session.opening import OpenRequest, find_scene, server_command
from app.sound.player import Player
from app.window import Window

LATE = {late}

def follow():
    window = next(widget for widget in QApplication.topLevelWidgets() if isinstance(widget, Window))
    window.view_ready.connect(lambda: look(window))
    window.controller.session_opened.connect(lambda _: end(window))
    prepare = window.controller.prepare
    window.controller.prepare = lambda: count_types() or prepare()

def count_types():
    unnamed = [name for module in (QtCore, QtGui, QtWidgets) for name in dir(module) if name not in vars(module)]
    print("imports begin with", len(unnamed), "types to make", flush=True)

def look(window):
    early = [name for name in LATE if name in sys.modules]
    print("picture", "3D" if window.workspace.view.list_layers() else "none", "after", early, flush=True)
    print("sources read:", [name for name in linecache.cache if name.endswith("plotter.py")], flush=True)

def end(window):
    print("then", sorted(set(LATE) - sys.modules.keys()), flush=True)
    window.leave()
    QApplication.quit()

application = QApplication([])
QTimer.singleShot(0, follow)
scene = find_scene(Path("flat-patch"))
sys.exit(run_window(OpenRequest(scene=scene, server=server_command(scene)), Player(speech=("true",))))
"""
AFTER_THE_PICTURE = (
    "app.session_view", "app.panels.panel", "app.state.policies", "pyqtgraph", "skincal.following", "skincal.guide",
    "skincal.methods", "skincal.robot.targets", "skincal.session", "skincal.streams.links", "numpy.ma",
)  # fmt: skip
"""What panels, guide, recording and links need, and the picture of the part does not."""


def test_the_picture_of_the_part_waits_for_nothing_that_it_does_not_show(tmp_path):
    display = os.environ.get("DISPLAY")
    if not display:
        pytest.skip("there is no display here")
    folders = {"HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path / "c"), "XDG_DATA_HOME": str(tmp_path / "d")}
    done = python(PICTURE_FIRST.format(late=AFTER_THE_PICTURE), DISPLAY=display, **folders)
    said = ["picture 3D after []", "sources read: []", "imports begin with 0 types to make", "then []"]
    assert done.stdout.splitlines() == said, done.stderr
    assert done.returncode == 0, done.stderr
