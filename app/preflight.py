"""Checks for a missing display or system library, before Qt aborts the process without a sentence. Imports no Qt."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

LIBRARY_PACKAGES: Mapping[str, str] = {
    "libglib-2.0.so.0": "libglib2.0-0",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libdbus-1.so.3": "libdbus-1-3",
    "libfontconfig.so.1": "libfontconfig1",
    "libxkbcommon.so.0": "libxkbcommon0",
}
"""Shared libraries that Qt and VTK load, with their Debian and Ubuntu packages."""
X_LIBRARY_PACKAGES: Mapping[str, str] = {
    "libxcb-cursor.so.0": "libxcb-cursor0",
    "libxcb-icccm.so.4": "libxcb-icccm4",
    "libxcb-keysyms.so.1": "libxcb-keysyms1",
    "libxcb-shape.so.0": "libxcb-shape0",
    "libxkbcommon-x11.so.0": "libxkbcommon-x11-0",
}
"""The same for an X server."""
DISPLAY_FREE_PLATFORMS = ("offscreen", "minimal", "vnc", "linuxfb", "eglfs")
"""Platforms of Qt without a display, chosen by `QT_QPA_PLATFORM`."""
COMMANDS_HINT = "Without one, `skincal simulate`, `skincal record` and `skincal solve` do the same work (see `skincal --help`)."


def loads(name: str) -> bool:
    """Check whether a shared library can be loaded."""
    try:
        ctypes.CDLL(name)
    except OSError:
        return False
    return True


@cache
def x_answers() -> bool:
    """Check whether the X server named by `DISPLAY` accepts a connection of this user.

    Only once: a server without other clients restarts after a connection ends, and refuses for a moment.
    """
    try:
        xcb = ctypes.CDLL("libxcb.so.1")
    except OSError:
        return True  # The missing library is reported instead.
    # Without these ctypes would truncate 64-bit pointers.
    xcb.xcb_connect.restype = ctypes.c_void_p
    xcb.xcb_connection_has_error.argtypes = [ctypes.c_void_p]
    xcb.xcb_disconnect.argtypes = [ctypes.c_void_p]
    connection = xcb.xcb_connect(None, None)
    failed = bool(xcb.xcb_connection_has_error(connection))
    xcb.xcb_disconnect(connection)
    return not failed


def wayland_answers(environment: Mapping[str, str]) -> bool:
    """Check whether the socket named by `WAYLAND_DISPLAY` exists."""
    folder = environment.get("XDG_RUNTIME_DIR", "")
    # The variable may hold an absolute path, which pathlib accepts here.
    return bool(folder) and (Path(folder) / environment["WAYLAND_DISPLAY"]).exists()


def window_problem(
    environment: Mapping[str, str] = os.environ,
    platform: str = sys.platform,
    can_load: Callable[[str], bool] = loads,
    x_is_there: Callable[[], bool] = x_answers,
) -> str:
    """Say why no window can be opened, and what to do; empty if it can."""
    # On other systems the Python packages include everything.
    if not platform.startswith("linux"):
        return ""
    reason = no_display(environment, platform, x_is_there)
    if reason:
        return f"{reason} {COMMANDS_HINT}"
    x = bool(environment.get("DISPLAY")) and not _needs_no_display(environment)
    wanted = {**LIBRARY_PACKAGES, **X_LIBRARY_PACKAGES} if x else LIBRARY_PACKAGES
    packages = [package for name, package in wanted.items() if not can_load(name)]
    if not packages:
        return ""
    return (
        "skincal: the window needs system libraries that are missing. On Debian or Ubuntu this installs them:\n"
        f"    sudo apt-get install -y --no-install-recommends {' '.join(packages)}"
    )


def no_display(
    environment: Mapping[str, str] = os.environ,
    platform: str = sys.platform,
    x_is_there: Callable[[], bool] = x_answers,
) -> str:
    """Say that there is no display; empty if there is one."""
    if not platform.startswith("linux") or _needs_no_display(environment):
        return ""
    if environment.get("WAYLAND_DISPLAY") and wayland_answers(environment):
        return ""
    if not environment.get("DISPLAY"):
        return "skincal: there is no display (neither DISPLAY nor WAYLAND_DISPLAY is set), so no window can be opened."
    if x_is_there():
        return ""
    return f"skincal: the display {environment['DISPLAY']} does not answer, so no window can be opened."


def _needs_no_display(environment: Mapping[str, str]) -> bool:
    return environment.get("QT_QPA_PLATFORM", "").split(":")[0] in DISPLAY_FREE_PLATFORMS
