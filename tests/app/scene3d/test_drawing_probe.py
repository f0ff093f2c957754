"""Whether VTK draws here is found out in a child process, which a missing driver may end."""

import os
import signal
import sys
from types import SimpleNamespace

import pytest

from app import headless
from app.__main__ import main
from app.scene3d import canvas, drawing_probe
from app.scene3d.canvas import Canvas
from app.scene3d.drawing_probe import (
    EGL,
    OSMESA,
    PLOTTING_VARIABLE,
    PROBE_OPTION,
    WINDOW_CLASS_VARIABLE,
    DrawingProbe,
    choose_offscreen,
)
from app.scene3d.scene_state import DARK
from skincal.model.errors import InputError
from skincal.model.scene import resource

CRASH = f"import os; os.kill(os.getpid(), {int(signal.SIGSEGV)})"

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere the system brings what draws")


@pytest.fixture
def trials(monkeypatch):
    """Let each trial run a piece of Python in place of VTK, by window class; the default crashes."""
    programs = {}
    start = drawing_probe.subprocess.Popen

    def popen(command, **options):
        assert command[-2] == PROBE_OPTION
        return start([sys.executable, "-c", programs.get(command[-1], CRASH)], **options)

    monkeypatch.setattr(drawing_probe.subprocess, "Popen", popen)
    monkeypatch.setenv(WINDOW_CLASS_VARIABLE, "")
    monkeypatch.setenv(PLOTTING_VARIABLE, "")
    return programs


@pytest.mark.parametrize(
    ("programs", "chosen"),
    [({EGL: "", OSMESA: ""}, EGL), ({OSMESA: ""}, OSMESA), ({EGL: "raise SystemExit(1)", OSMESA: ""}, OSMESA)],
)
def test_the_first_window_class_that_draws_is_used(trials, programs, chosen):
    trials.update(programs)
    choose_offscreen()
    assert os.environ[WINDOW_CLASS_VARIABLE] == chosen
    assert os.environ[PLOTTING_VARIABLE] == "true", "pyvista need not try it again"


def test_a_crash_of_every_trial_names_the_packages(trials):
    trials[OSMESA] = "raise SystemExit(1)"
    with pytest.raises(InputError, match=r"SIGSEGV.*not start.*apt-get install .*libegl1 libgl1-mesa-dri"):
        choose_offscreen()
    assert not os.environ[WINDOW_CLASS_VARIABLE]


def test_a_trial_that_hangs_is_ended(trials, monkeypatch):
    monkeypatch.setattr(drawing_probe, "DRAWING_PROBE_TIMEOUT_S", 0.3)
    trials.update(dict.fromkeys((EGL, OSMESA), "import time; time.sleep(60)"))
    with pytest.raises(InputError, match="gave no picture"):
        choose_offscreen()


@pytest.mark.usefixtures("trials")
def test_a_choice_of_the_user_is_kept(monkeypatch):
    monkeypatch.setenv(WINDOW_CLASS_VARIABLE, OSMESA)
    choose_offscreen()
    assert os.environ[WINDOW_CLASS_VARIABLE] == OSMESA


def test_the_first_picture_waits_for_the_trial_that_began_with_the_window(trials, monkeypatch):
    trials[EGL] = ""
    started = []
    monkeypatch.setattr(canvas, "start_egl_probe", lambda: started.append(DrawingProbe(EGL)) or started[0])
    canvas.early_egl_probe.cache_clear()
    # As `run_window` does.
    canvas.early_egl_probe()
    probe = canvas.early_egl_probe()
    assert started == [probe]
    choose_offscreen(probe)
    assert os.environ[WINDOW_CLASS_VARIABLE] == EGL
    canvas.early_egl_probe.cache_clear()


def test_a_trial_that_failed_is_made_again_for_the_next_scene(trials):
    """The operator may have installed what was missing."""
    canvas.early_egl_probe.cache_clear()
    with pytest.raises(InputError, match="apt-get install"):
        canvas.load(Canvas.RASTER, SimpleNamespace(surface=None), DARK, (1, 1), None)
    trials[EGL] = ""
    choose_offscreen(canvas.early_egl_probe())
    assert os.environ[WINDOW_CLASS_VARIABLE] == EGL
    canvas.early_egl_probe.cache_clear()


@pytest.mark.usefixtures("trials")
def test_headless_without_graphics_leaves_the_calibration_and_says_what_is_missing(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(headless, "SIMULATED_POKE_COUNT", 6)
    scene = resource("scenes/flat-patch/scene.toml")
    assert main(["--headless", "--scene", str(scene), "--new", str(tmp_path / "new")]) == 2
    said = capsys.readouterr()
    assert (tmp_path / "new" / "positions.txt").is_file()
    assert "calibration file:" in said.out
    assert "SIGSEGV" in said.err
    assert "apt-get install" in said.err
    assert not (tmp_path / "new" / "picture.png").exists()


def test_the_real_trial_answers_by_its_exit_code():
    assert not drawing_probe.DrawingProbe(EGL).failure()
    assert "does not start" in drawing_probe.DrawingProbe("vtkNoSuchWindow").failure()
