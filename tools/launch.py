"""The two commands of a checkout: prepare the environment, then start the program or run the checks."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed

from app.preflight import LIBRARIES, X_LIBRARIES
from tools import checkout, packages, system
from tools.checkout import StopError, say

INTERRUPTED = 130
"""Exit code of a program ended with Ctrl-C."""

PYTEST = ("-m", "pytest", "-p", "no:cacheprovider")
PIXELS = "tests/app/scene3d/test_pixels.py"
"""What the 3D view must show on any processor."""
PROCESSORS = ("sse2", "sse4.1", "avx")
"""As on which these tests run again."""
CAPABILITIES = "GALLIUM_OVERRIDE_CPU_CAPS"
"""Mesa's switch for what its software OpenGL may use of a processor."""
APART = ("tests/skincal/cli", "tests/skincal/guide", "tests/skincal/studies")
"""Tests of the core that take about as long as its others."""
CHECKS = {
    "ruff check": ("-m", "ruff", "check"),
    "ruff format --check": ("-m", "ruff", "format", "--check"),
    "pytest of the window": (*PYTEST, "-m", "not quiet", "tests/app"),
    "pytest of the core": (*PYTEST, "-m", "not quiet", "tests", *(f"--ignore={folder}" for folder in ("tests/app", *APART))),
    f"pytest {shlex.join(APART)}": (*PYTEST, "-m", "not quiet", *APART),
    "pyright": ("-m", "pyright"),
    **{f"pytest as on {caps}": (*PYTEST, "-m", "pixels", PIXELS) for caps in PROCESSORS},
    "lint-imports": ("-c", "from importlinter.cli import lint_imports_command as main; main()", "--no-cache"),
}
"""Name of each check, and the arguments for Python: long ones first, so that two cores are done at about the same time."""
AT_ONCE = 2
"""Checks that run beside each other: each takes one core, and more would lengthen what some tests measure."""
QUIET = {"pytest of what is measured": (*PYTEST, "-m", "quiet", "tests/app")}
"""Tests that nothing may run beside."""

PROBE = """
import ctypes, importlib, pathlib, sys
try:
    for module in ("PySide6.QtWidgets", "PySide6.QtOpenGLWidgets", "PySide6.QtSvg", "vtkmodules.vtkRenderingOpenGL2",
                   "matplotlib.font_manager", "pyvista.plotting", "scipy.optimize"):
        importlib.import_module(module)
    if sys.argv[1] == "show" and sys.platform.startswith("linux"):
        qt = pathlib.Path(sys.modules["PySide6"].__file__).parent / "Qt"
        ctypes.CDLL(str(qt / "plugins" / "platforms" / "libqxcb.so"))
except (ImportError, OSError) as error:
    sys.exit(str(error))
"""
"""Whether what the window is made of loads at all, found out in a process of its own. It leaves behind what a first start would
otherwise wait for: compiled modules, and matplotlib's list of fonts, which pyvista asks for."""

HELP = """\
usage: python3 start.py [OPTIONS | COMMAND ...]

Opens the skincal window on a simulated forearm that is being poked. What is missing is installed first: some hundred
megabytes, into .venv of this folder, and on Debian and Ubuntu missing system libraries. Where there is no display, it
runs the same session without a window, to a calibration file and a picture of it.

It takes the same words as `skincal`:

  start.py --scene NAME | FILE.toml       open the window on another part
  start.py --session DIR                  go on with a recorded session
  start.py --headless                     run the simulated session without a window
  start.py COMMAND ...                    a command: solve, export, record, simulate, import or study
  start.py --help                         this text; once it is installed, every option and command
  start.py COMMAND --help                 installs what is missing, and tells the options of a command

README.md says how a part is calibrated, docs/manual.md the rest.
"""


def start(arguments: Sequence[str]) -> int:
    """Install what is missing and become skincal; returns only where that fails."""
    return _telling(lambda: _start(arguments))


def check(arguments: Sequence[str]) -> int:
    """Install what the tests need, run the checks and the tests, and return 0 if all passed."""
    return _telling(lambda: _check(arguments))


def _telling(command: Callable[[], int]) -> int:
    try:
        return command()
    except StopError as stop:
        say(str(stop))
        return stop.code
    except KeyboardInterrupt:
        say("\nStopped. What is unfinished is done at the next start.")
        return INTERRUPTED


def _start(arguments: Sequence[str]) -> int:
    if arguments and arguments[0] in ("-h", "--help") and not packages.is_ready(checkout.RUN_LOCK):
        sys.stdout.write(HELP)
        return 0
    fresh = packages.ensure(checkout.RUN_LOCK)
    if _draws(arguments):
        _provide_drawing(fresh, shown=system.has_display() and "--headless" not in arguments)
    return _become([str(checkout.interpreter()), "-P", "-m", "app", *arguments], system.environment())


def _check(arguments: Sequence[str]) -> int:
    system.require_test_display()
    fresh = packages.ensure(checkout.TEST_LOCK)
    _provide_drawing(fresh, shown=True)
    system.provide_test_display()
    environment = system.environment()
    environment.pop("QT_QPA_PLATFORM", None)  # "offscreen" has no OpenGL; the tests look at real pixels
    environment.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the program: plugins of pytest import numpy before it
    if arguments:
        return 1 if _run("pytest", ("-m", "pytest", *arguments), environment) else 0
    failed = [*_run_beside_each_other(environment), *(name for name, words in QUIET.items() if _run(name, words, environment))]
    say(f"\nFailed: {', '.join(failed)}" if failed else "\nAll checks passed.")
    return 1 if failed else 0


def _draws(arguments: Sequence[str]) -> bool:
    """Whether skincal will draw: a command such as `solve`, and words on usage, do without Qt and VTK."""
    return not arguments or (arguments[0].startswith("-") and arguments[0] not in ("-h", "--help", "--version"))


def _provide_drawing(fresh: bool, *, shown: bool) -> None:
    wanted = {**LIBRARIES, **X_LIBRARIES} if shown else LIBRARIES
    if system.provide(wanted) or fresh:
        _probe("show" if shown else "draw")


def _probe(depth: str) -> None:
    probe = subprocess.run(
        [checkout.interpreter(), "-P", "-c", PROBE, depth],
        env=system.environment(),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    if probe.returncode:
        why = probe.stderr.strip() or f"it ended with {probe.returncode}"
        raise StopError(f"Everything is installed, but Qt or VTK does not load here: {why}")


def _run(name: str, words: Sequence[str], environment: Mapping[str, str]) -> int:
    say(f"\n$ {name}")
    return subprocess.call([checkout.interpreter(), *words], env=environment, cwd=checkout.CHECKOUT, stdin=subprocess.DEVNULL)


def _run_beside_each_other(environment: Mapping[str, str]) -> list[str]:
    """Run the checks, show what each said once it is done, and return the names of those that failed."""
    failed: list[str] = []
    with ThreadPoolExecutor(AT_ONCE) as pool:
        running = {pool.submit(_captured, name, words, environment): name for name, words in CHECKS.items()}
        say(f"\n{len(running)} checks, {AT_ONCE} at a time; what each says is shown at its end.")
        try:
            for done in as_completed(running):
                code, said = done.result()
                say(f"\n$ {running[done]}\n{said.rstrip()}")
                failed += [running[done]] if code else []
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return failed


def _captured(name: str, words: Sequence[str], environment: Mapping[str, str]) -> tuple[int, str]:
    """Return a check's exit code and what it said."""
    caps = name.removeprefix("pytest as on ")
    done = subprocess.run(
        [checkout.interpreter(), *words],
        env={**environment, CAPABILITIES: caps} if caps in PROCESSORS else environment,
        cwd=checkout.CHECKOUT,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        check=False,
    )
    return done.returncode, done.stdout.decode(errors="replace")


def _become(command: list[str], environment: Mapping[str, str]) -> int:
    sys.stderr.flush()
    if os.name != "nt":
        os.execve(command[0], command, environment)
    return subprocess.call(command, env=environment)  # Windows: exec would return to the shell before the program ends
