"""A checkout's Python environment: `.venv`, made from a lock file with hashes, and left alone while it is right.

A stamp in it names the lock it was made from. An installation removes the stamp first and writes it last, so an interrupted
one is done again; one that was interrupted while packages were being unpacked starts from an empty `.venv`.
"""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tools import checkout, system
from tools.checkout import StopError, say

STAMP = checkout.VENV / "skincal-installed.txt"
UNFINISHED = checkout.VENV / "skincal-unfinished.txt"
LOG = checkout.VENV / "install.log"
VERSION = f"{sys.version_info[0]}.{sys.version_info[1]}"


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
                _install(lock)
    except OSError as error:
        raise StopError(f"{checkout.VENV} could not be written: {error.strerror or error}.") from error
    return True


def is_ready(lock: Path) -> bool:
    """Whether everything that a lock names is installed."""
    return _venv_is_right() and STAMP.exists() and _stamp_line(lock) in STAMP.read_text(encoding="utf-8").splitlines()


def _venv_is_right() -> bool:
    """Whether `.venv` is whole and of the Python that runs this."""
    configuration = checkout.VENV / "pyvenv.cfg"
    if UNFINISHED.exists() or not checkout.interpreter().exists() or not configuration.exists():
        return False
    version = re.search(r"^version(?:_info)? *= *(\d+\.\d+)", configuration.read_text(encoding="utf-8"), re.MULTILINE)
    return version is not None and version[1] == VERSION


def _stamp_line(lock: Path) -> str:
    return f"{lock.name} {hashlib.sha256(lock.read_bytes()).hexdigest()} Python {VERSION}"


def _install(lock: Path) -> None:
    if not _venv_is_right():
        import venv

        say(f"Making a Python {VERSION} environment in {checkout.VENV} ...")
        venv.EnvBuilder(clear=True, symlinks=os.name != "nt").create(checkout.VENV)
        UNFINISHED.touch()
    STAMP.unlink(missing_ok=True)
    _provide_pip()
    say(f"Installing the Python packages of {lock.name} into {checkout.VENV} (once; a few hundred MB to fetch) ...")
    _pip_install(lock)
    _add_checkout()
    held = (checkout.RUN_LOCK, checkout.TEST_LOCK) if lock == checkout.TEST_LOCK else (lock,)
    STAMP.write_text("\n".join(_stamp_line(each) for each in held) + "\n", encoding="utf-8")


def _provide_pip() -> None:
    """Put pip into `.venv`, also where Debian's Python came without it."""
    if _python("-c", "import pip").returncode == 0 or _python("-m", "ensurepip").returncode == 0:
        return
    if not system.has_apt():
        raise StopError("This Python comes without pip (module ensurepip). Install your system's package for pip and venv.")
    system.apt_provide(["python3-pip-whl"])
    folders = (root / "usr/share/python-wheels" for root in (checkout.SYSTEM, Path("/")))
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
    # The person's own index, certificates and proxies stay; their own `--user` would miss .venv.
    return os.environ | {"PIP_USER": "0", "PIP_DISABLE_PIP_VERSION_CHECK": "1", "PYTHONPATH": ""}


def _pip_install(lock: Path) -> None:
    """Let pip say on the terminal how far it is, and in the log all that it has to say."""
    LOG.unlink(missing_ok=True)
    UNFINISHED.touch()
    command = [checkout.interpreter(), "-P", "-m", "pip", "install", "--require-hashes", "--only-binary", ":all:", "--no-input"]
    command += ["--retries", "2", "--log", LOG, "-r", lock]
    failed = 1
    try:
        # pip holds the lock of the checkout, too, should it outlive this process.
        failed = subprocess.call(command, env=_pip_environment(), stdin=subprocess.DEVNULL, stdout=sys.stderr, close_fds=False)
    finally:
        log = LOG.read_text(encoding="utf-8", errors="replace") if LOG.exists() else ""
        if not failed or "Installing collected packages" not in log:
            UNFINISHED.unlink()  # up to there it changes nothing
    if failed:
        raise StopError(FAILED.format(venv=checkout.VENV, log=LOG))


FAILED = """\
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
    packages = checkout.VENV / ("Lib" if os.name == "nt" else f"lib/python{VERSION}") / "site-packages"
    relative = os.path.relpath(checkout.CHECKOUT, packages)  # survives a move of the whole checkout
    (packages / "skincal-checkout.pth").write_text(relative + "\n", encoding="utf-8")
    command = checkout.interpreter().with_name("skincal.cmd" if os.name == "nt" else "skincal")
    command.write_text(WINDOWS_COMMAND if os.name == "nt" else COMMAND, encoding="utf-8")
    command.chmod(0o755)
    _python("-m", "compileall", "-q", *(str(checkout.CHECKOUT / name) for name in ("app", "skincal")))


COMMAND = """#!/bin/sh
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
