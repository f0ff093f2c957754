"""Try in a child process whether VTK can draw here: without an OpenGL driver its first picture ends the process.

On Linux an off-screen picture needs EGL with a driver, or OSMesa. Windows and macOS bring what is needed. Imports no VTK.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys

from skincal.model.errors import InputError

PROBE_OPTION = "--probe-drawing"
"""Hidden option of the program: draw one small picture with the window class that follows, and end."""
WINDOW_CLASS_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"
"""VTK's own switch: the class that it makes for a window it is not given."""
PLOTTING_VARIABLE = "ALLOW_PLOTTING"
"""pyvista's switch: without it, its first plotter starts `xset` or another OpenGL context to see whether it can draw."""
EGL, OSMESA = "vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow"
DRAWING_PROBE_TIMEOUT_S = 60.0
"""s. A trial needs 0.5 s, on a busy machine some seconds; a driver that hangs would never answer."""
PROBE_PICTURE_SIZE_PX = 16
NOTHING_DRAWS = (
    "No picture can be drawn: neither EGL with a driver nor OSMesa draws here ({why}). "
    "Install them, on Debian or Ubuntu with: apt-get install --no-install-recommends libegl1 libgl1-mesa-dri"
)


class DrawingProbe:
    """Child process that draws one small picture with a class of VTK windows."""

    def __init__(self, window_class: str) -> None:
        # A frozen program takes the option itself. -P: nothing that lies in the working folder is imported.
        program = () if getattr(sys, "frozen", False) else ("-P", "-m", "app")
        command = (sys.executable, *program, PROBE_OPTION, window_class)
        self._window_class = window_class
        self._child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def failure(self) -> str:
        """Wait for the child and say why it did not draw; empty if it did."""
        try:
            code = self._child.wait(DRAWING_PROBE_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
            return f"{self._window_class} gave no picture in {DRAWING_PROBE_TIMEOUT_S:.0f} s"
        if not code:
            return ""
        return f"{self._window_class} {f'ended by {signal.Signals(-code).name}' if code < 0 else 'does not start'}"


def start_egl_probe() -> DrawingProbe | None:
    """Start the trial of EGL early, so that imports run meanwhile; `None` if there is nothing to try."""
    return DrawingProbe(EGL) if sys.platform.startswith("linux") and not os.environ.get(WINDOW_CLASS_VARIABLE) else None


def choose_offscreen(egl_probe: DrawingProbe | None = None) -> None:
    """Make VTK draw off-screen by what this machine has. A choice that the user made by the environment is kept.

    Raises InputError: nothing draws here; names the packages.
    """
    egl_probe = egl_probe or start_egl_probe()
    if egl_probe is None or os.environ.get(WINDOW_CLASS_VARIABLE):
        return
    failures: list[str] = []
    for window_class in (EGL, OSMESA):
        failure = (egl_probe if window_class == EGL else DrawingProbe(window_class)).failure()
        if not failure:
            os.environ[WINDOW_CLASS_VARIABLE] = window_class
            os.environ[PLOTTING_VARIABLE] = "true"
            return
        failures.append(failure)
    raise InputError(NOTHING_DRAWS.format(why=", ".join(failures)))


def draw_probe_picture(window_class: str) -> int:
    """Draw one small picture with a class of VTK windows; return the exit code. VTK may end the process instead."""
    from vtkmodules import vtkRenderingOpenGL2

    make_window = getattr(vtkRenderingOpenGL2, window_class, None)
    if window_class not in (EGL, OSMESA) or make_window is None:
        return 1
    os.environ[WINDOW_CLASS_VARIABLE] = window_class
    window = make_window()
    if not window.SupportsOpenGL():
        return 1
    window.SetOffScreenRendering(True)
    window.SetSize(PROBE_PICTURE_SIZE_PX, PROBE_PICTURE_SIZE_PX)
    window.Render()
    return 0
