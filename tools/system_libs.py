"""Which of the window's system libraries are missing, and where they come from.

Only Linux: the packages for Windows and macOS carry everything. What is not here could end the program without a word later
(Qt aborts without libxcb-cursor, VTK crashes without any OpenGL), so it is looked for first.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path

from app.preflight import loads
from tools import apt
from tools.places import SYSTEM
from tools.words import StopError, say

KEYBOARDS = (Path("/usr/bin/xkbcomp"), Path("/usr/share/X11/xkb"))
"""An Xvfb that was unpacked runs only where these are, as on every X desktop: their places are compiled into it."""


def has_display() -> bool:
    """Whether a window can be shown to somebody here."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def provide(libraries: Mapping[str, str]) -> bool:
    """Install or unpack the libraries (file name to Debian package) that are missing; return whether any was.

    Raises
    ------
    StopError
        Something is missing and could not be had; the sentence names it and the line that installs it.
    """
    if not sys.platform.startswith("linux"):
        return False
    missing = _missing(libraries)
    if not missing:
        return False
    if apt.is_here():
        apt.provide(_packages(missing, libraries), SYSTEM)
        _list_fonts()
    still_missing = _missing(libraries)
    if still_missing:
        raise StopError(_sentence(still_missing, libraries))
    return True


def require_test_display() -> None:
    """See that the tests will have a display, before anything is installed for them.

    Raises
    ------
    StopError
        There is none, and none can be had without root.
    """
    if not (has_display() or shutil.which("Xvfb") or _can_provide_xvfb()):
        raise StopError(
            "The tests draw on a display of their own; this system lacks Xvfb, which makes one.\n" + _remedy(["xvfb"])
        )


def provide_test_display() -> None:
    """Install or unpack Xvfb where that is possible; the tests fall back on the person's own display."""
    if not sys.platform.startswith("linux") or shutil.which("Xvfb", path=environment().get("PATH")):
        return
    if _can_provide_xvfb():
        apt.provide(["xvfb"], SYSTEM)
    else:
        say("There is no Xvfb here: the tests open their windows on this display.")


def _can_provide_xvfb() -> bool:
    return apt.is_here() and (os.geteuid() == 0 or all(place.exists() for place in KEYBOARDS))


def environment() -> dict[str, str]:
    """Return the environment in which unpacked system packages are found: the present one where nothing was unpacked."""
    present = dict(os.environ)
    if not SYSTEM.is_dir():
        return present
    _put_first(present, "LD_LIBRARY_PATH", _library_folders())
    _put_first(present, "PATH", [SYSTEM / "usr" / "bin"])
    for name, inside, usual in DATA:
        if (SYSTEM / inside).exists() and not Path(usual).exists():
            present.setdefault(name, str(SYSTEM / inside))
    for drivers in (folder / "dri" for folder in _library_folders()):
        if drivers.is_dir():
            present.setdefault("LIBGL_DRIVERS_PATH", str(drivers))
    return present


DATA = (
    ("__EGL_VENDOR_LIBRARY_DIRS", "usr/share/glvnd/egl_vendor.d", "/usr/share/glvnd/egl_vendor.d"),
    ("XKB_CONFIG_ROOT", "usr/share/X11/xkb", "/usr/share/X11/xkb"),
    ("FONTCONFIG_FILE", "fonts.conf", "/etc/fonts/fonts.conf"),
)
"""Variable that says where a library's data lie, their place in a package, and the place where a system has them."""


def _list_fonts() -> None:
    """Tell fontconfig of unpacked fonts: the list in its own package knows the system's folders only."""
    fonts = SYSTEM / "usr" / "share" / "fonts"
    if fonts.is_dir():
        (SYSTEM / "fonts.conf").write_text(FONT_LIST.format(fonts=escape(str(fonts))), encoding="utf-8")


FONT_LIST = """<?xml version="1.0"?>
<!DOCTYPE fontconfig SYSTEM "urn:fontconfig:fonts.dtd">
<fontconfig>
  <dir>{fonts}</dir>
  <dir>/usr/share/fonts</dir>
  <dir prefix="xdg">fonts</dir>
  <cachedir prefix="xdg">fontconfig</cachedir>
</fontconfig>
"""


def _missing(libraries: Iterable[str]) -> list[str]:
    folders = _library_folders()
    return [name for name in libraries if not loads(name) and not any((folder / name).exists() for folder in folders)]


def _library_folders() -> list[Path]:
    roots = (SYSTEM / "usr" / "lib", SYSTEM / "lib")
    return [folder for root in roots if root.is_dir() for folder in (root, *root.glob("*-linux-gnu*"))]


def _put_first(variables: dict[str, str], name: str, folders: Iterable[Path]) -> None:
    parts = [str(folder) for folder in folders]
    if variables.get(name):
        parts.append(variables[name])
    variables[name] = os.pathsep.join(parts)


def _packages(missing: Iterable[str], wanted: Mapping[str, str]) -> list[str]:
    return sorted({wanted[name] for name in missing})


def _sentence(missing: list[str], wanted: Mapping[str, str]) -> str:
    lack = f"This system lacks {', '.join(missing)}, without which skincal's window cannot be drawn.\n"
    return lack + _remedy(_packages(missing, wanted))


def _remedy(packages: list[str]) -> str:
    if apt.is_here():
        return f"Install it:  {apt.line_for(packages)}"
    return "Install what provides it with your system's package manager, then run this again."
