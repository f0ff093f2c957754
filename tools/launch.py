"""The two commands of a checkout: prepare the environment, then start the program or run the checks."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed

from app.preflight import QT_LIBRARIES, X_LIBRARIES
from tools import checkout, install
from tools.checkout import StopError, say

INTERRUPTED_EXIT_CODE = 130
"""Exit code of a program ended with Ctrl-C."""

PYTEST_ARGUMENTS = ("-m", "pytest", "-p", "no:cacheprovider")
TESTED_PROCESSORS = ("sse2", "sse4.1", "avx")
"""As on which the tests of what the 3D view must show run again."""
PROCESSOR_VARIABLE = "GALLIUM_OVERRIDE_CPU_CAPS"
"""Mesa's switch for what its software OpenGL may use of a processor."""
SLOW_CORE_TESTS = ("tests/skincal/cli", "tests/skincal/guide", "tests/skincal/studies")
"""Tests of the core that take about as long as its others."""
WINDOW_PARTS = tuple(
    f"tests/app/{room}" for room in ("dialogs", "panels", "scene3d", "session", "sound", "state", "text", "workers")
)
"""Tests of the window that take about as long as those of whole windows."""
CHECK_ARGUMENTS = {
    "ruff check": ("-m", "ruff", "check"),
    "ruff format --check": ("-m", "ruff", "format", "--check"),
    "pytest of the window": (
        *PYTEST_ARGUMENTS,
        "-m",
        "not quiet",
        "tests/app",
        *(f"--ignore={folder}" for folder in WINDOW_PARTS),
    ),
    "pytest of the window's parts": (*PYTEST_ARGUMENTS, "-m", "not quiet", *WINDOW_PARTS),
    "pytest of the core": (
        *PYTEST_ARGUMENTS,
        "-m",
        "not quiet",
        "tests",
        *(f"--ignore={folder}" for folder in ("tests/app", *SLOW_CORE_TESTS)),
    ),
    f"pytest {' '.join(SLOW_CORE_TESTS)}": (*PYTEST_ARGUMENTS, "-m", "not quiet", *SLOW_CORE_TESTS),
    "pyright": ("-m", "pyright"),
    **{
        f"pytest as on {caps}": (*PYTEST_ARGUMENTS, "-m", "pixels", "tests/app/scene3d/test_pixels.py")
        for caps in TESTED_PROCESSORS
    },
    "lint-imports": ("-c", "from importlinter.cli import lint_imports_command as main; main()", "--no-cache"),
}
"""Name of each check, and the arguments for Python: long ones first, so that two cores are done at about the same time."""
PARALLEL_CHECKS = 3
"""Checks that run beside each other on two cores: tests of devices and windows wait a quarter of their time. What measures
time is among `TIMING_TESTS`."""
TIMING_TESTS = {"pytest of what is measured": (*PYTEST_ARGUMENTS, "-m", "quiet", "tests/app")}
"""Tests that nothing may run beside."""

IMPORT_CHECK = """
import PySide6.QtWidgets, PySide6.QtOpenGLWidgets, PySide6.QtSvg, vtkmodules.vtkRenderingOpenGL2
import ctypes, matplotlib.font_manager, pyvista.plotting, scipy.optimize, sys
for plugin in sys.argv[1:]:
    ctypes.CDLL(plugin)
"""
"""Whether what the window is made of loads at all, found out in a process of its own. It leaves behind what a first start would
otherwise wait for: compiled modules, and matplotlib's list of fonts, which pyvista asks for."""


def run(command: Callable[[Sequence[str]], int]) -> int:
    """Run one of the two commands, and say in a sentence what stops it."""
    try:
        return command(sys.argv[1:])
    except StopError as stop:
        say(str(stop))
        return checkout.USER_CAN_HELP
    except KeyboardInterrupt:
        say("\nStopped. What is unfinished is done at the next start.")
        return INTERRUPTED_EXIT_CODE


def start(arguments: Sequence[str]) -> int:
    """Install missing packages and replace this process by skincal; returns only on failure."""
    asked = arguments[0] if arguments else ""
    if asked in ("-h", "--help") and not install.is_ready(checkout.RUN_LOCK):
        import start as command

        print(command.__doc__)
        return 0
    fresh = install.ensure(checkout.RUN_LOCK)
    # A command such as `solve`, and words on usage, do without Qt and VTK.
    if not asked or (asked.startswith("-") and asked not in ("-h", "--help", "--version")):
        _provide_drawing(fresh, shown=install.has_display() and "--headless" not in arguments)
    program = [str(checkout.interpreter()), "-P", "-m", "app", *arguments]
    # What is still buffered goes with the program that is replaced.
    sys.stderr.flush()
    if os.name != "nt":
        os.execve(program[0], program, install.environment())
    # Windows: exec would return to the shell before the program ends.
    return subprocess.call(program, env=install.environment())


def check(arguments: Sequence[str]) -> int:
    """Install what the tests need, run the checks and the tests, and return 0 if all passed."""
    install.require_test_display()
    fresh = install.ensure(checkout.TEST_LOCK)
    _provide_drawing(fresh, shown=True)
    install.provide_test_display()
    environment = install.environment()
    environment.pop("QT_QPA_PLATFORM", None)  # "offscreen" has no OpenGL; the tests look at real pixels
    environment.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the program: plugins of pytest import numpy before it
    if arguments:
        return 1 if _python(("-m", "pytest", *arguments), environment).returncode else 0
    failed = _run_beside_each_other(environment)
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


def _run_beside_each_other(environment: Mapping[str, str]) -> list[str]:
    """Run the checks, show what each said once it is done, and return the names of those that failed."""
    failed: list[str] = []
    with ThreadPoolExecutor(PARALLEL_CHECKS) as pool:
        running = {}
        for name, words in CHECK_ARGUMENTS.items():
            caps = name.removeprefix("pytest as on ")
            own = {**environment, PROCESSOR_VARIABLE: caps} if caps in TESTED_PROCESSORS else environment
            running[pool.submit(_python, words, own, subprocess.PIPE)] = name
        say(f"\n{len(running)} checks, {PARALLEL_CHECKS} at a time; what each says is shown at its end.")
        try:
            for done in as_completed(running):
                say(f"\n$ {running[done]}\n{done.result().stdout.decode(errors='replace').rstrip()}")
                failed += [running[done]] if done.result().returncode else []
        except KeyboardInterrupt:
            # Or every check that still waits would be run first.
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return failed


def _python(
    words: Sequence[str], environment: Mapping[str, str], said: int | None = None
) -> subprocess.CompletedProcess[bytes]:
    """Run the Python of `.venv` in the checkout; `said` receives its output."""
    return subprocess.run(
        [checkout.interpreter(), *words],
        env=environment,
        cwd=checkout.CHECKOUT,
        stdin=subprocess.DEVNULL,
        stdout=said,
        stderr=None if said is None else subprocess.STDOUT,
        check=False,
    )
