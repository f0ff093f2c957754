"""Requirements of a window that this machine lacks, checked before Qt or OpenGL can crash.

Qt aborts the process where its display or a shared library is missing, and VTK's first picture without OpenGL ends in a
segmentation fault; both leave the user without a sentence. Nothing here imports Qt.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

QT_LIBRARIES: Mapping[str, str] = {
    "libglib-2.0.so.0": "libglib2.0-0",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libdbus-1.so.3": "libdbus-1-3",
    "libfontconfig.so.1": "libfontconfig1",
    "libxkbcommon.so.0": "libxkbcommon0",
}
"""Shared libraries that Qt's widgets and VTK load, and the Debian and Ubuntu packages that hold them."""
X_LIBRARIES: Mapping[str, str] = {
    "libxcb-cursor.so.0": "libxcb-cursor0",
    "libxcb-icccm.so.4": "libxcb-icccm4",
    "libxcb-keysyms.so.1": "libxcb-keysyms1",
    "libxcb-shape.so.0": "libxcb-shape0",
    "libxkbcommon-x11.so.0": "libxkbcommon-x11-0",
}
"""The same for a window on an X server."""
WITHOUT_DISPLAY = ("offscreen", "minimal", "vnc", "linuxfb", "eglfs")
"""Platforms of Qt that need no display; the user asks for them by `QT_QPA_PLATFORM`."""
HEADLESS_ADVICE = (
    "Without one, `skincal simulate`, `skincal record` and `skincal solve` do the same work (see `skincal --help`)."
)


def loads(name: str) -> bool:
    """Return whether a shared library can be loaded."""
    try:
        ctypes.CDLL(name)
    except OSError:
        return False
    return True


@cache
def x_answers() -> bool:
    """Return whether the X server that `DISPLAY` names takes a connection, with this user's rights.

    Cached: a server without other clients restarts after the connection, and refuses for a moment.
    """
    try:
        xcb = ctypes.CDLL("libxcb.so.1")
    except OSError:
        return True  # Cannot be asked; the missing library is named instead.
    # Without these ctypes takes a pointer for a C int and cuts it off on 64 bits.
    xcb.xcb_connect.restype = ctypes.c_void_p
    xcb.xcb_connection_has_error.argtypes = [ctypes.c_void_p]
    xcb.xcb_disconnect.argtypes = [ctypes.c_void_p]
    connection = xcb.xcb_connect(None, None)
    failed = bool(xcb.xcb_connection_has_error(connection))
    xcb.xcb_disconnect(connection)
    return not failed


def wayland_answers(environment: Mapping[str, str]) -> bool:
    """Whether the socket that `WAYLAND_DISPLAY` names exists."""
    folder = environment.get("XDG_RUNTIME_DIR", "")
    # The variable may hold a whole path: pathlib drops what stands before that.
    return bool(folder) and (Path(folder) / environment["WAYLAND_DISPLAY"]).exists()


def objection(
    environment: Mapping[str, str] = os.environ,
    platform: str = sys.platform,
    can_load: Callable[[str], bool] = loads,
    x_is_there: Callable[[], bool] = x_answers,
) -> str:
    """Return why no window can be opened here and what to do, or an empty text."""
    # On other systems pip installs everything.
    if not platform.startswith("linux"):
        return ""
    reason = no_display(environment, platform, x_is_there)
    if reason:
        return f"{reason} {HEADLESS_ADVICE}"
    x = bool(environment.get("DISPLAY")) and not _asked_without(environment)
    wanted = {**QT_LIBRARIES, **X_LIBRARIES} if x else QT_LIBRARIES
    packages = [package for name, package in wanted.items() if not can_load(name)]
    if not packages:
        return ""
    return (
        "skincal: the window needs system libraries that are missing. On Debian or Ubuntu this installs them:\n"
        f"    sudo apt-get install -y --no-install-recommends {' '.join(packages)}"
    )


def no_display(
    environment: Mapping[str, str] = os.environ, platform: str = sys.platform, x_is_there: Callable[[], bool] = x_answers
) -> str:
    """Explain that there is no display, in a sentence; empty if there is one."""
    if not platform.startswith("linux") or _asked_without(environment):
        return ""
    if environment.get("WAYLAND_DISPLAY") and wayland_answers(environment):
        return ""
    if not environment.get("DISPLAY"):
        return "skincal: there is no display (neither DISPLAY nor WAYLAND_DISPLAY is set), so no window can be opened."
    if x_is_there():
        return ""
    return f"skincal: the display {environment['DISPLAY']} does not answer, so no window can be opened."


def _asked_without(environment: Mapping[str, str]) -> bool:
    return environment.get("QT_QPA_PLATFORM", "").split(":")[0] in WITHOUT_DISPLAY
