"""What a checkout needs: `.venv`, made from a lock file with hashes, and the window's system libraries.

A stamp in `.venv` names the lock it was made from. An installation removes the stamp first and writes it last, so one that was
interrupted is done again; one that was interrupted while packages were being unpacked starts from an empty `.venv`.

System libraries come from apt, as root or unpacked into `.venv`. Only Linux: the packages for Windows and macOS carry all they
need. What is not here could end the program without a word later (Qt aborts without libxcb-cursor, VTK crashes without any
OpenGL), so it is looked for first.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from html import escape
from pathlib import Path

from app.preflight import loads
from tools import checkout
from tools.checkout import SYSTEM, StopError, say

STAMP_FILE = checkout.VENV / "skincal-installed.txt"
UNFINISHED_FILE = checkout.VENV / "skincal-unfinished.txt"
LOG = checkout.VENV / "install.log"
VERSION = f"{sys.version_info[0]}.{sys.version_info[1]}"
XVFB_NEEDS = (Path("/usr/bin/xkbcomp"), Path("/usr/share/X11/xkb"))
"""An Xvfb that was unpacked runs only where these are, as on every X desktop: their places are compiled into it."""
NEVER_UNPACKED = frozenset({"libc6", "libc-bin", "libgcc-s1", "libstdc++6"})
"""Packages of the C library: a second one next to the system's crashes every program that loads it."""
DATA_VARIABLES = (
    ("__EGL_VENDOR_LIBRARY_DIRS", "usr/share/glvnd/egl_vendor.d", "/usr/share/glvnd/egl_vendor.d"),
    ("XKB_CONFIG_ROOT", "usr/share/X11/xkb", "/usr/share/X11/xkb"),
    ("FONTCONFIG_FILE", "fonts.conf", "/etc/fonts/fonts.conf"),
)
"""Environment variable of a library's data folder, its path in the package, and its path on the system."""
FONT_LIST = """<?xml version="1.0"?>
<!DOCTYPE fontconfig SYSTEM "urn:fontconfig:fonts.dtd">
<fontconfig><dir>{fonts}</dir><dir>/usr/share/fonts</dir><cachedir prefix="xdg">fontconfig</cachedir></fontconfig>
"""


def ensure(lock: Path) -> bool:
    """Make `.venv` hold what `lock` lists; return whether anything had to be done.

    Raises
    ------
    StopError
        It could not be made; the sentence says why and what to do.
    """
    if is_ready(lock):
        return False
    try:
        with _alone():
            if not is_ready(lock):
                _install_packages(lock)
    except OSError as error:
        raise StopError(f"{checkout.VENV} could not be written: {error.strerror or error}.") from error
    return True


def is_ready(lock: Path) -> bool:
    """Whether everything that a lock names is installed."""
    return _venv_is_right() and STAMP_FILE.exists() and _stamp_line(lock) in STAMP_FILE.read_text(encoding="utf-8").splitlines()


def _venv_is_right() -> bool:
    """Whether `.venv` is whole and of the Python that runs this."""
    configuration = checkout.VENV / "pyvenv.cfg"
    if UNFINISHED_FILE.exists() or not checkout.interpreter().exists() or not configuration.exists():
        return False
    # Python's own venv writes `version`, other makers of environments `version_info`.
    version = re.search(r"^version(?:_info)? *= *(\d+\.\d+)", configuration.read_text(encoding="utf-8"), re.MULTILINE)
    return version is not None and version[1] == VERSION


def _stamp_line(lock: Path) -> str:
    return f"{lock.name} {hashlib.sha256(lock.read_bytes()).hexdigest()} Python {VERSION}"


def _install_packages(lock: Path) -> None:
    if not _venv_is_right():
        import venv

        say(f"Making a Python {VERSION} environment in {checkout.VENV} ...")
        venv.EnvBuilder(clear=True, symlinks=os.name != "nt").create(checkout.VENV)
        # Only now: making the environment empties the folder.
        UNFINISHED_FILE.touch()
    STAMP_FILE.unlink(missing_ok=True)
    _provide_pip()
    say(f"Installing the Python packages of {lock.name} into {checkout.VENV} (once; a few hundred MB to fetch) ...")
    _pip_install(lock)
    _add_checkout()
    held = (checkout.RUN_LOCK, checkout.TEST_LOCK) if lock == checkout.TEST_LOCK else (lock,)
    STAMP_FILE.write_text("\n".join(_stamp_line(each) for each in held) + "\n", encoding="utf-8")


def _provide_pip() -> None:
    """Put pip into `.venv`, also where Debian's Python came without it."""
    if _python("-c", "import pip").returncode == 0 or _python("-m", "ensurepip").returncode == 0:
        return
    if not has_apt():
        raise StopError("This Python comes without pip (module ensurepip). Install your system's package for pip and venv.")
    apt_provide(["python3-pip-whl"])
    folders = (root / "usr/share/python-wheels" for root in (SYSTEM, Path("/")))
    wheel = next(str(path) for folder in folders for path in folder.glob("pip-*.whl"))
    done = _python("-m", "pip", "install", "--quiet", "--no-index", wheel, PYTHONPATH=wheel)
    if done.returncode:
        raise StopError(f"pip could not be put into {checkout.VENV}:\n{done.stdout}{done.stderr}")


def _python(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [checkout.interpreter(), "-P", *arguments],
        env=_pip_environment() | variables,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )


def _pip_environment() -> dict[str, str]:
    # The person's own index, certificates and proxies stay; their own `--user` would miss .venv. -P holds for one process: what
    # ensurepip starts in its turn needs the variable, or a `pickle.py` of the working folder is run.
    safe = {"PYTHONPATH": "", "PYTHONSAFEPATH": "1"}
    return os.environ | {"PIP_USER": "0", "PIP_DISABLE_PIP_VERSION_CHECK": "1", **safe}


def _pip_install(lock: Path) -> None:
    """Run pip with its progress on the terminal and its whole output in the log."""
    LOG.unlink(missing_ok=True)
    UNFINISHED_FILE.touch()
    command = [checkout.interpreter(), "-P", "-m", "pip", "install", "--require-hashes", "--only-binary", ":all:", "--no-input"]
    command += ["--retries", "2", "--log", LOG, "-r", lock]
    failed = 1
    try:
        # pip holds the lock of the checkout, too, should it outlive this process.
        failed = subprocess.call(command, env=_pip_environment(), stdin=subprocess.DEVNULL, stdout=sys.stderr, close_fds=False)
    finally:
        log = LOG.read_text(encoding="utf-8", errors="replace") if LOG.exists() else ""
        if not failed or "Installing collected packages" not in log:
            UNFINISHED_FILE.unlink()  # up to there it changes nothing
    if failed:
        raise StopError(INSTALL_FAILED.format(venv=checkout.VENV, log=LOG))


INSTALL_FAILED = """\
The Python packages could not be installed; pip's own words stand above, and all of them in {log}.
- Where it could not reach the package index: connect this machine to the network (or set PIP_INDEX_URL, PIP_FIND_LINKS or a
  proxy) and run this again.
- Where the disk is full: {venv} needs about 1.3 GB.
- Where it found no matching distribution: the packages need glibc 2.34 or later (Debian 12, Ubuntu 22.04, Fedora 35), or
  Windows or macOS, on a 64-bit processor; or the network is filtered."""


def _add_checkout() -> None:
    """Let this environment find `app` and `skincal`, also from other folders and in child processes; compile them.

    Its command `skincal` is `start.py`, so that it finds unpacked system libraries and follows a new lock.
    """
    site = checkout.VENV / ("Lib" if os.name == "nt" else f"lib/python{VERSION}") / "site-packages"
    relative = os.path.relpath(checkout.CHECKOUT, site)  # survives a move of the whole checkout
    (site / "skincal-checkout.pth").write_text(relative + "\n", encoding="utf-8")
    command = checkout.interpreter().with_name("skincal.cmd" if os.name == "nt" else "skincal")
    command.write_text(WINDOWS_COMMAND if os.name == "nt" else START_SCRIPT, encoding="utf-8")
    command.chmod(0o755)
    _python("-m", "compileall", "-q", *(str(checkout.CHECKOUT / name) for name in ("app", "skincal")))


START_SCRIPT = """#!/bin/sh
here=$(dirname "$(readlink -f "$0")")
exec "$here/python" "$here/../../start.py" "$@"
"""
WINDOWS_COMMAND = '@"%~dp0python.exe" "%~dp0..\\..\\start.py" %*\n'


@contextmanager
def _alone() -> Iterator[None]:
    """Wait while another start of the same checkout installs."""
    with (checkout.CHECKOUT / ".venv.lock").open("w", encoding="utf-8") as handle:
        os.set_inheritable(handle.fileno(), True)
        waiting = False
        while not _held(handle.fileno()):
            if not waiting:
                say("Another start of this checkout is installing; waiting for it ...")
            waiting = True
            time.sleep(0.5)
        yield


def _held(descriptor: int) -> bool:
    """Take the lock unless somebody has it; it ends with the process, however that ends."""
    try:
        if os.name == "nt":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


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
    return has_apt() and (os.geteuid() == 0 or all(place.exists() for place in XVFB_NEEDS))


def environment() -> dict[str, str]:
    """Environment variables that lead to the unpacked system packages; unchanged if there are none."""
    present = dict(os.environ)
    if not SYSTEM.is_dir():
        return present
    for name, folders in (("LD_LIBRARY_PATH", _library_folders()), ("PATH", [SYSTEM / "usr" / "bin"])):
        present[name] = os.pathsep.join(filter(None, [*map(str, folders), present.get(name)]))
    for name, inside, usual in DATA_VARIABLES:
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
    """Run a command and return its standard output."""
    # In English: what apt says is read.
    english = os.environ | {"LC_ALL": "C", "DEBIAN_FRONTEND": "noninteractive"}
    return subprocess.run(
        command, env=english, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=check
    ).stdout
