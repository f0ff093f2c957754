"""Installation of a checkout: `.venv` from a lock file with hashes, and the window's system libraries.

pip fetches uv, one wheel, and uv installs the rest. Where uv cannot be had or fails, pip installs it.

A stamp in `.venv` names its lock. It is removed before an installation and written at the end, so that an interrupted one is
repeated; after an interrupted unpacking `.venv` is emptied first.

On Linux, system libraries come from apt, as root or unpacked into `.venv`; the packages for Windows and macOS need none. They
are checked before the start, because Qt aborts without libxcb-cursor and VTK crashes without OpenGL.
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
from tools.lock import select_packages

STAMP_FILE = checkout.VENV / "skincal-installed.txt"
UNFINISHED_FILE = checkout.VENV / "skincal-unfinished.txt"
LOG = checkout.VENV / "install.log"
VERSION = f"{sys.version_info[0]}.{sys.version_info[1]}"
UV_VARIABLES = {
    "PIP_INDEX_URL": "UV_DEFAULT_INDEX",
    "PIP_EXTRA_INDEX_URL": "UV_INDEX",
    "PIP_FIND_LINKS": "UV_FIND_LINKS",
    "PIP_TRUSTED_HOST": "UV_INSECURE_HOST",
    "PIP_CERT": "SSL_CERT_FILE",
    "PIP_PROXY": "ALL_PROXY",
}
"""uv's name for each variable of pip that says from where packages come. Lists have spaces, uv's list of links commas."""
EXTRA_PACKAGES = {
    "--ros2": ("cyclonedds", "rosbags"),
    "--rosbag": ("rosbags", "ruamel-yaml"),
    "--robometry": ("h5py",),
    "--hdf5": ("h5py",),
    "--parquet": ("pyarrow",),
    "--excel": ("openpyxl",),
    "--physics": ("mujoco",),
    "--study": ("mpmath",),
}
"""Packages of an extra of `pyproject.toml`, by the option of `start.py` that installs it."""
XVFB_NEEDS = (Path("/usr/bin/xkbcomp"), Path("/usr/share/X11/xkb"))
"""An unpacked Xvfb needs these at their compiled-in paths. Every X desktop has them."""
NEVER_UNPACKED = frozenset({"libc6", "libc-bin", "libgcc-s1", "libstdc++6"})
"""Packages of the C library: a second C library crashes every program."""
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
    """Install the packages of `lock` into `.venv`; return whether any was missing. Raises StopError with the remedy."""
    if is_ready(lock):
        return False
    try:
        with _hold_lock():
            if not is_ready(lock):
                _install_packages(lock)
    except OSError as error:
        raise StopError(f"{checkout.VENV} could not be written: {error.strerror or error}.") from error
    return True


def ensure_extra(names: Sequence[str]) -> None:
    """Install packages of an extra into `.venv`, from the lock of the tests. Raises StopError with the remedy."""
    if _python("-c", f"from importlib.metadata import version\nfor name in {names}: version(name)").returncode == 0:
        return
    with _hold_lock():
        selected = checkout.VENV / "extra.lock"
        selected.write_text(select_packages(checkout.TEST_LOCK.read_text(encoding="utf-8"), names), encoding="utf-8")
        say(f"Installing {' and '.join(names)} into {checkout.VENV} (once) ...")
        _install_lock(selected)


def is_ready(lock: Path) -> bool:
    """Whether every package of `lock` is installed."""
    return _venv_is_right() and STAMP_FILE.exists() and _stamp_line(lock) in STAMP_FILE.read_text(encoding="utf-8").splitlines()


def _venv_is_right() -> bool:
    """Whether `.venv` is complete and of this Python version."""
    configuration = checkout.VENV / "pyvenv.cfg"
    if UNFINISHED_FILE.exists() or not checkout.interpreter().exists() or not configuration.exists():
        return False
    # Python's venv writes `version`, virtualenv and uv `version_info`.
    version = re.search(r"^version(?:_info)? *= *(\d+\.\d+)", configuration.read_text(encoding="utf-8"), re.MULTILINE)
    return version is not None and version[1] == VERSION


def _stamp_line(lock: Path) -> str:
    return f"{lock.name} {hashlib.sha256(lock.read_bytes()).hexdigest()} Python {VERSION}"


def _install_packages(lock: Path) -> None:
    if not _venv_is_right():
        import venv

        say(f"Making a Python {VERSION} environment in {checkout.VENV} ...")
        venv.EnvBuilder(clear=True, symlinks=os.name != "nt").create(checkout.VENV)
        # After `create`, which empties the folder.
        UNFINISHED_FILE.touch()
    STAMP_FILE.unlink(missing_ok=True)
    _provide_pip()
    say(f"Installing the Python packages of {lock.name} into {checkout.VENV} (once; a few hundred MB to fetch) ...")
    _install_lock(lock)
    _add_checkout()
    held = (checkout.RUN_LOCK, checkout.TEST_LOCK) if lock == checkout.TEST_LOCK else (lock,)
    STAMP_FILE.write_text("\n".join(_stamp_line(each) for each in held) + "\n", encoding="utf-8")


def _provide_pip() -> None:
    """Install pip into `.venv`, also for Debian's Python without ensurepip."""
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
        env=_installer_environment() | variables,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )


def _installer_environment() -> dict[str, str]:
    # Keeps the user's index, certificates and proxies, but not `--user`, which would miss .venv. Child processes of ensurepip
    # need the variable of -P, otherwise they run a `pickle.py` of the working folder.
    safe = {"PYTHONPATH": "", "PYTHONSAFEPATH": "1", "PIP_USER": "0", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    same = {theirs: os.environ[ours].strip() for ours, theirs in UV_VARIABLES.items() if os.environ.get(ours)}
    if "UV_FIND_LINKS" in same:
        same["UV_FIND_LINKS"] = ",".join(same["UV_FIND_LINKS"].split())
    return os.environ | safe | same | {"UV_INDEX_STRATEGY": "unsafe-best-match"}  # any index may have the locked version


def _install_lock(lock: Path) -> None:
    """Install a lock with uv, which pip fetches, or else with pip; their progress is on the terminal."""
    safely = ("--require-hashes", "--only-binary", ":all:")
    pip = [checkout.interpreter(), "-P", "-m", "pip", "install", *safely, "--no-input", "--retries", "2"]
    program = checkout.interpreter().with_name("uv.exe" if os.name == "nt" else "uv")
    no_index = os.environ.get("PIP_NO_INDEX", "").lower() in {"1", "y", "yes", "t", "true", "on"}  # uv has no variable for it
    uv = [program, "pip", "install", *safely, "--python", checkout.interpreter(), *(["--no-index"] if no_index else [])]
    uv_lock = checkout.CHECKOUT / "requirements-uv.lock"
    has_uv = uv_lock.exists() and _call(*pip, "--quiet", "-r", uv_lock)
    before, done = _installed(), False
    UNFINISHED_FILE.touch()
    try:
        done = (has_uv and _call(*uv, "-r", lock)) or _call(*pip, "--log", LOG, "-r", lock)
    finally:
        if done or _installed() == before:
            UNFINISHED_FILE.unlink()
    if not done:
        raise StopError(INSTALL_FAILED.format(venv=checkout.VENV, log=LOG))


def _call(*command: str | Path) -> bool:
    """Run an installer with its output on the terminal; return whether it could be run and succeeded."""
    try:
        # It inherits the lock of the checkout and keeps it if it outlives this process.
        code = subprocess.call(
            command, env=_installer_environment(), stdin=subprocess.DEVNULL, stdout=sys.stderr, close_fds=False
        )
    except OSError:  # as where the system has not the loader that uv's program needs
        return False
    return not code


def _installed() -> list[str]:
    return sorted(entry.name for entry in _site_packages().iterdir())


def _site_packages() -> Path:
    return checkout.VENV / ("Lib" if os.name == "nt" else f"lib/python{VERSION}") / "site-packages"


INSTALL_FAILED = """\
The Python packages could not be installed; see pip's messages above, and all of them in {log}.
- If it could not reach the package index: connect this machine to the network (or set PIP_INDEX_URL, PIP_FIND_LINKS or a
  proxy) and run this again.
- If the disk is full: {venv} needs about 1.3 GB.
- If it found no matching distribution: the packages need glibc 2.34 or later (Debian 12, Ubuntu 22.04, Fedora 35), or
  Windows or macOS, on a 64-bit processor; or the network is filtered."""


def _add_checkout() -> None:
    """Add `app` and `skincal` to the environment, and make a command `skincal` that runs `start.py`."""
    relative = os.path.relpath(checkout.CHECKOUT, _site_packages())  # survives a move of the whole checkout
    (_site_packages() / "skincal-checkout.pth").write_text(relative + "\n", encoding="utf-8")
    command = checkout.interpreter().with_name("skincal.cmd" if os.name == "nt" else "skincal")
    command.write_text(WINDOWS_COMMAND if os.name == "nt" else START_SCRIPT, encoding="utf-8")
    command.chmod(0o755)


START_SCRIPT = """#!/bin/sh
here=$(dirname "$(readlink -f "$0")")
exec "$here/python" "$here/../../start.py" "$@"
"""
WINDOWS_COMMAND = '@"%~dp0python.exe" "%~dp0..\\..\\start.py" %*\n'


@contextmanager
def _hold_lock() -> Iterator[None]:
    """Hold the lock of the checkout; wait while another process installs."""
    with (checkout.CHECKOUT / ".venv.lock").open("w", encoding="utf-8") as handle:
        os.set_inheritable(handle.fileno(), True)
        waiting = False
        while not _try_lock(handle.fileno()):
            if not waiting:
                say("Another start of this checkout is installing; waiting for it ...")
            waiting = True
            time.sleep(0.5)
        yield


def _try_lock(descriptor: int) -> bool:
    """Try to take the lock, which the system releases at the end of the process."""
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
    """Whether there is a display for a window."""
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def provide(libraries: Mapping[str, str]) -> bool:
    """Install or unpack missing libraries (file name to Debian package); return whether any was missing.

    Raises StopError with the command that installs the rest.
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
    """Point fontconfig to unpacked fonts; its own list has the system's folders only."""
    fonts = SYSTEM / "usr" / "share" / "fonts"
    if fonts.is_dir():
        (SYSTEM / "fonts.conf").write_text(FONT_LIST.format(fonts=escape(str(fonts))), encoding="utf-8")


def require_test_display() -> None:
    """Raise StopError if the tests have no display and none can be provided without root."""
    if not (has_display() or shutil.which("Xvfb") or _can_provide_xvfb()):
        raise StopError(
            "The tests draw on a display of their own; this system lacks Xvfb, which makes one.\n" + _remedy(["xvfb"])
        )


def provide_test_display() -> None:
    """Install or unpack Xvfb if possible; otherwise the tests use the user's display."""
    if not sys.platform.startswith("linux") or shutil.which("Xvfb", path=environment().get("PATH")):
        return
    if _can_provide_xvfb():
        apt_provide(["xvfb"])
    else:
        say("There is no Xvfb here: the tests open their windows on this display.")


def _can_provide_xvfb() -> bool:
    return has_apt() and (os.geteuid() == 0 or all(place.exists() for place in XVFB_NEEDS))


def environment() -> dict[str, str]:
    """Return the environment variables, with paths of unpacked system packages."""
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
    """Install packages as root, or unpack them and their dependencies under `SYSTEM`. Raises StopError with the remedy."""
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
    # A failed update is common (one unreachable source among many); the install shows real failures.
    _run("apt-get", "update", "-qq", check=False)
    _run("apt-get", "install", "-y", "-qq", "--no-install-recommends", "-o", "DPkg::Lock::Timeout=300", *packages)


def _unpack(packages: Sequence[str]) -> None:
    say(f"Unpacking system packages into {SYSTEM} (no root needed): {' '.join(packages)}")
    apt, archives = SYSTEM / "apt", SYSTEM / "apt" / "archives"
    for part in (apt / "lists" / "partial", archives / "partial"):
        part.mkdir(parents=True, exist_ok=True)
    # apt's lists and downloads in a folder that needs no root.
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
    # apt's output is parsed, so it must be English.
    english = os.environ | {"LC_ALL": "C", "DEBIAN_FRONTEND": "noninteractive"}
    return subprocess.run(
        command, env=english, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=check
    ).stdout
