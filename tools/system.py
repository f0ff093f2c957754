"""Which of the window's system libraries are missing, and where they come from: apt, as root or unpacked beside `.venv`.

Only Linux: the packages for Windows and macOS carry everything. What is not here could end the program without a word later
(Qt aborts without libxcb-cursor, VTK crashes without any OpenGL), so it is looked for first.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path

from app.preflight import loads
from tools.checkout import SYSTEM, StopError, say

KEYBOARDS = (Path("/usr/bin/xkbcomp"), Path("/usr/share/X11/xkb"))
"""An Xvfb that was unpacked runs only where these are, as on every X desktop: their places are compiled into it."""
NEVER_UNPACKED = frozenset({"libc6", "libc-bin", "libgcc-s1", "libstdc++6"})
"""A second C library beside the system's own crashes whatever loads it."""
DATA = (
    ("__EGL_VENDOR_LIBRARY_DIRS", "usr/share/glvnd/egl_vendor.d", "/usr/share/glvnd/egl_vendor.d"),
    ("XKB_CONFIG_ROOT", "usr/share/X11/xkb", "/usr/share/X11/xkb"),
    ("FONTCONFIG_FILE", "fonts.conf", "/etc/fonts/fonts.conf"),
)
"""Variable that says where a library's data lie, their place in a package, and the place where a system has them."""
FONT_LIST = """<?xml version="1.0"?>
<!DOCTYPE fontconfig SYSTEM "urn:fontconfig:fonts.dtd">
<fontconfig><dir>{fonts}</dir><dir>/usr/share/fonts</dir><cachedir prefix="xdg">fontconfig</cachedir></fontconfig>
"""


def has_display() -> bool:
    """Whether a window can be shown to somebody here."""
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def provide(libraries: Mapping[str, str]) -> bool:
    """Install or unpack the libraries (file name to Debian package) that are missing; return whether any was.

    Raises
    ------
    StopError
        Something is missing and could not be had; the sentence names it and the line that installs it.
    """
    missing = _missing(libraries) if sys.platform.startswith("linux") else []
    if missing and has_apt():
        apt_provide(sorted({libraries[name] for name in missing}))
        _list_fonts()
    lacking = _missing(missing)
    if lacking:
        raise StopError(
            f"This system lacks {', '.join(lacking)}, without which skincal's window cannot be drawn.\n"
            + _remedy(sorted({libraries[name] for name in lacking}))
        )
    return bool(missing)


def _missing(libraries: Iterable[str]) -> list[str]:
    folders = _library_folders()
    return [name for name in libraries if not loads(name) and not any((folder / name).exists() for folder in folders)]


def _library_folders() -> list[Path]:
    roots = (SYSTEM / "usr" / "lib", SYSTEM / "lib")
    return [folder for root in roots if root.is_dir() for folder in (root, *root.glob("*-linux-gnu*"))]


def _list_fonts() -> None:
    """Point fontconfig to unpacked fonts: the list in its own package knows the system's folders only."""
    fonts = SYSTEM / "usr" / "share" / "fonts"
    if fonts.is_dir():
        (SYSTEM / "fonts.conf").write_text(FONT_LIST.format(fonts=escape(str(fonts))), encoding="utf-8")


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
        apt_provide(["xvfb"])
    else:
        say("There is no Xvfb here: the tests open their windows on this display.")


def _can_provide_xvfb() -> bool:
    return has_apt() and (os.geteuid() == 0 or all(place.exists() for place in KEYBOARDS))


def environment() -> dict[str, str]:
    """Return the environment in which unpacked system packages are found: the present one where nothing was unpacked."""
    present = dict(os.environ)
    if not SYSTEM.is_dir():
        return present
    for name, folders in (("LD_LIBRARY_PATH", _library_folders()), ("PATH", [SYSTEM / "usr" / "bin"])):
        present[name] = os.pathsep.join(filter(None, [*map(str, folders), present.get(name)]))
    for name, inside, usual in DATA:
        if (SYSTEM / inside).exists() and not Path(usual).exists():
            present.setdefault(name, str(SYSTEM / inside))
    for drivers in (folder / "dri" for folder in _library_folders()):
        if drivers.is_dir():
            present.setdefault("LIBGL_DRIVERS_PATH", str(drivers))
    return present


def has_apt() -> bool:
    """Whether this system installs packages with apt."""
    return bool(shutil.which("apt-get") and shutil.which("dpkg-deb"))


def _remedy(packages: Sequence[str]) -> str:
    if has_apt():
        return f"Install it:  {_apt_line(packages)}"
    return "Install what provides it with your system's package manager, then run this again."


def _apt_line(packages: Sequence[str]) -> str:
    return f"sudo apt-get install --no-install-recommends {' '.join(packages)}"


def apt_provide(packages: Sequence[str]) -> None:
    """Make packages available: install them as root, otherwise unpack them and what they depend on under `SYSTEM`.

    Raises
    ------
    StopError
        The packages could not be had; the sentence has the line that installs them.
    """
    try:
        if os.geteuid() == 0:
            _install(packages)
        else:
            _unpack(packages)
    except subprocess.CalledProcessError as failed:
        said = (failed.stderr or failed.stdout).strip().splitlines()
        raise StopError(
            "System packages are missing and apt-get could not provide them: "
            f"{said[-1] if said else f'exit code {failed.returncode}'}\n"
            f"Check the network, or install them by hand:  {_apt_line(packages)}"
        ) from None


def _install(packages: Sequence[str]) -> None:
    say(f"Installing system packages (apt-get install): {' '.join(packages)}")
    # Its failure is not final: one unreachable source among many is common. The install shows it.
    _run("apt-get", "update", "-qq", check=False)
    _run("apt-get", "install", "-y", "-qq", "--no-install-recommends", "-o", "DPkg::Lock::Timeout=300", *packages)


def _unpack(packages: Sequence[str]) -> None:
    say(f"Unpacking system packages into {SYSTEM} (no root needed): {' '.join(packages)}")
    apt, archives = SYSTEM / "apt", SYSTEM / "apt" / "archives"
    for part in (apt / "lists" / "partial", archives / "partial"):
        part.mkdir(parents=True, exist_ok=True)
    # Keeps apt's lists and downloads out of the system's folders, which only root may write.
    own = ("-o", f"Dir::State::lists={apt}/lists", "-o", f"Dir::Cache={apt}", "-o", "Debug::NoLocking=true")
    _run("apt-get", *own, "update", "-qq", check=False)
    plan = _run("apt-get", *own, "install", "--simulate", "--no-install-recommends", *packages)
    for name, version in re.findall(r"^Inst (\S+) (?:\[\S+\] )?\((\S+)", plan, re.MULTILINE):
        if name.partition(":")[0] not in NEVER_UNPACKED:
            _run("apt-get", *own, "download", f"{name}={version}", folder=archives)
    for archive in sorted(archives.glob("*.deb")):
        _run("dpkg-deb", "-x", str(archive), str(SYSTEM))
    shutil.rmtree(apt)


def _run(*command: str, folder: Path | None = None, check: bool = True) -> str:
    """Return what a command says on its standard output."""
    english = os.environ | {"LC_ALL": "C", "DEBIAN_FRONTEND": "noninteractive"}
    return subprocess.run(
        command, env=english, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=check
    ).stdout
