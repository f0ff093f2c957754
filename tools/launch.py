"""The two commands of a checkout: prepare the environment, then start the program or run the checks."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed

from app.preflight import QT_LIBRARIES, X_LIBRARIES
from tools import checkout, install
from tools.checkout import StopError, say

INTERRUPTED_EXIT_CODE = 130
"""Exit code of a program ended with Ctrl-C."""

PYTEST_ARGUMENTS = ("-m", "pytest", "-p", "no:cacheprovider")
TESTED_PROCESSORS = ("sse2", "sse4.1", "avx")
"""Older processors, for which the tests of the 3D view's pixels run again."""
PROCESSOR_VARIABLE = "GALLIUM_OVERRIDE_CPU_CAPS"
"""Mesa's variable that limits the processor features of its software OpenGL."""
SESSION_TESTS = ("tests/skincal/session", "tests/skincal/simulation")
"""Tests of recorded and simulated sessions."""
SLOW_CORE_TESTS = tuple(f"tests/skincal/{room}" for room in ("cli", "following", "guide", "journal", "part", "studies"))
"""Other tests of the core that take long."""
READER_TESTS = tuple(f"tests/skincal/{room}" for room in ("files", "mesh", "model", "ros", "streams"))
"""Tests of what reads files and devices."""
WINDOW_PARTS = tuple(
    f"tests/app/{room}" for room in ("builder", "dialogs", "panels", "scene3d", "session", "sound", "state", "text", "workers")
)
"""Tests of the window that take as long as those of whole windows."""
ESTIMATE_TESTS = tuple(f"tests/skincal/{room}" for room in ("axes", "modules", "rig", "taxels"))
"""Tests of what is computed from pokes."""
_OTHER_GROUPS = ("tests/app", *SESSION_TESTS, *SLOW_CORE_TESTS, *READER_TESTS, *ESTIMATE_TESTS)
OTHER_CORE_TESTS = ("tests", *(f"--ignore={tests}" for tests in _OTHER_GROUPS))
CHECK_ARGUMENTS = {
    "ruff check": ("-m", "ruff", "check"),
    "ruff format --check": ("-m", "ruff", "format", "--check"),
    **{
        f"pytest of {name}": (*PYTEST_ARGUMENTS, "-m", "not quiet", *arguments)
        for name, arguments in {
            "the window": ("tests/app", *(f"--ignore={folder}" for folder in WINDOW_PARTS)),
            "estimates": ESTIMATE_TESTS,
            " ".join(SLOW_CORE_TESTS): SLOW_CORE_TESTS,
            "the window's parts": WINDOW_PARTS,
            "sessions": SESSION_TESTS,
            "the core": OTHER_CORE_TESTS,
            "the readers": READER_TESTS,
        }.items()
    },
    "pyright": ("-m", "pyright"),
    **{
        f"pytest as on {caps}": (*PYTEST_ARGUMENTS, "-m", "pixels", "tests/app/scene3d/test_pixels.py")
        for caps in TESTED_PROCESSORS
    },
    "lint-imports": ("-c", "from importlinter.cli import lint_imports_command as main; main()", "--no-cache"),
}
"""Arguments for Python of each check; after the two quick ones the longest first, for an even load to the end."""
PARALLEL_CHECKS = 4
"""For two cores: tests of devices and windows wait for a part of their time."""
TIMING_FILES = ("tests/app/test_window_live.py", "tests/skincal/cli/test_cli_record.py")
TIMING_TESTS = {"pytest of what is measured": (*PYTEST_ARGUMENTS, "-m", "quiet", *TIMING_FILES)}
"""Tests that must run alone, because they measure time."""

IMPORT_CHECK = """
import PySide6.QtWidgets, PySide6.QtOpenGLWidgets, PySide6.QtSvg, vtkmodules.vtkRenderingOpenGL2
import ctypes, matplotlib.font_manager, pyvista.plotting, scipy.optimize, sys
for plugin in sys.argv[1:]:
    ctypes.CDLL(plugin)
"""
"""Program that loads the window's libraries in a separate process. It also prepares a quick first start: compiled modules, and
matplotlib's list of fonts for pyvista."""


def run(command: Callable[[Sequence[str]], int]) -> int:
    """Run one of the two commands and return its exit code; print the text of a StopError."""
    try:
        return command(sys.argv[1:])
    except StopError as stop:
        say(str(stop))
        return checkout.EXIT_CODE_USER_CAN_MEND
    except KeyboardInterrupt:
        say("\nStopped. What is unfinished is done at the next start.")
        return INTERRUPTED_EXIT_CODE


def start(help_text: str | None, arguments: Sequence[str]) -> int:
    """Install missing packages and replace this process by skincal.

    `help_text` is printed for `--help` as long as skincal is not installed.
    """
    extra = install.EXTRA_PACKAGES.get(arguments[0], ()) if arguments else ()
    arguments = arguments[1:] if extra else arguments
    asked = arguments[0] if arguments else ""
    if asked in ("-h", "--help") and not install.is_ready(checkout.RUN_LOCK):
        print(help_text)
        return 0
    fresh = install.ensure(checkout.RUN_LOCK)
    if extra:
        install.ensure_extra(extra)
    # Commands such as `solve`, and help, need neither Qt nor VTK.
    if not asked or (asked.startswith("-") and asked not in ("-h", "--help", "--version")):
        _provide_drawing(fresh, shown=install.has_display() and "--headless" not in arguments)
    program = [str(checkout.interpreter()), "-P", "-m", "app", *arguments]
    # exec discards buffered output.
    sys.stderr.flush()
    if os.name != "nt":
        os.execve(program[0], program, install.environment())
    # Windows: exec would return to the shell before the program ends.
    return subprocess.call(program, env=install.environment())


def check(arguments: Sequence[str]) -> int:
    """Install the packages of the tests, run all checks, and return 0 if all passed."""
    install.require_test_display()
    fresh = install.ensure(checkout.TEST_LOCK)
    _provide_drawing(fresh, shown=True)
    install.provide_test_display()
    environment = install.environment()
    environment.pop("QT_QPA_PLATFORM", None)  # "offscreen" has no OpenGL; the tests look at real pixels
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # hundreds of processes would each compile the same modules
    environment.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the program: plugins of pytest import numpy before it
    if arguments:
        return 1 if _python(("-m", "pytest", *arguments), environment).returncode else 0
    failed = _run_in_parallel(environment)
    for name, words in TIMING_TESTS.items():
        say(f"\n$ {name}")
        failed += [name] if _python(words, environment).returncode else []
    say(f"\nFailed: {', '.join(failed)}" if failed else "\nAll checks passed.")
    return 1 if failed else 0


def _provide_drawing(fresh: bool, *, shown: bool) -> None:
    if not (install.provide({**QT_LIBRARIES, **X_LIBRARIES} if shown else QT_LIBRARIES) or fresh):
        return
    plugins = checkout.VENV.glob("lib/*/site-packages/PySide6/Qt/plugins/platforms/libqxcb.so") if shown else ()
    probe = _python(("-P", "-c", IMPORT_CHECK, *map(str, plugins)), install.environment(), subprocess.PIPE)
    if probe.returncode:
        why = probe.stdout.decode(errors="replace").strip().rpartition("\n")[2] or f"it ended with {probe.returncode}"
        raise StopError(f"Everything is installed, but Qt or VTK does not load here: {why}")


def _run_in_parallel(environment: Mapping[str, str]) -> list[str]:
    """Run the checks in parallel, print the output of each, and return the names of failed ones."""
    failed: list[str] = []
    with ThreadPoolExecutor(PARALLEL_CHECKS) as pool:
        running = {}
        for name, words in CHECK_ARGUMENTS.items():
            caps = name.removeprefix("pytest as on ")
            own = {**environment, PROCESSOR_VARIABLE: caps} if caps in TESTED_PROCESSORS else environment
            running[pool.submit(_timed, words, own)] = name
        say(f"\n{len(running)} checks, {PARALLEL_CHECKS} at a time; the output of each follows at its end.")
        try:
            for done in as_completed(running):
                ended, taken_s = done.result()
                say(f"\n$ {running[done]} ({taken_s:.0f} s)\n{ended.stdout.decode(errors='replace').rstrip()}")
                failed += [running[done]] if ended.returncode else []
        except KeyboardInterrupt:
            # Otherwise the waiting checks would still run.
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return failed


def _timed(words: Sequence[str], environment: Mapping[str, str]) -> tuple[subprocess.CompletedProcess[bytes], float]:
    """Run a check; return its end with its output, and how many seconds it took."""
    begin_s = time.monotonic()
    return _python(words, environment, subprocess.PIPE), time.monotonic() - begin_s


def _python(
    words: Sequence[str], environment: Mapping[str, str], output: int | None = None
) -> subprocess.CompletedProcess[bytes]:
    """Run the Python of `.venv` in the checkout; `output` is its stdout."""
    return subprocess.run(
        [checkout.interpreter(), *words],
        env=environment,
        cwd=checkout.CHECKOUT,
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=None if output is None else subprocess.STDOUT,
        check=False,
    )
