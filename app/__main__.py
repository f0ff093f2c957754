"""`skincal`: runs the named command, or without one the window. Commands import no Qt."""

from __future__ import annotations

import os
import sys

if __name__ == "__main__" and not sys.flags.safe_path:
    # `python -m app` puts the working folder first on the path: a `typer.py` there would be imported.
    sys.path[:] = [*sys.path[1:], os.path.dirname(os.path.dirname(__file__))]  # noqa: PTH120 - a pathlib.py may lie there

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from app.preflight import no_display, window_problem
from app.scene3d.drawing_probe import PROBE_OPTION
from app.session.opening import MESHES
from skincal.model.errors import INTERRUPTED, InputError

HELP_OPTIONS = ("-h", "--help", "--version")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command or the window; return the exit code: 0 for success, 2 for wrong input, 1 for an error of the program."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments[:1] == [PROBE_OPTION]:
        from app.scene3d.drawing_probe import draw_probe_picture

        return draw_probe_picture("".join(arguments[1:]))
    if arguments and not arguments[0].startswith("-") and arguments[0].lower().endswith(MESHES):
        # As if the file is dropped onto the program.
        arguments.insert(0, "--scene")
    if arguments and (arguments[0] in HELP_OPTIONS or not arguments[0].startswith("-")):
        return _command(arguments)
    try:
        options = _parser().parse_args(arguments)
    except SystemExit as end:
        # argparse exits after --help and after an error.
        return int(end.code or 0)
    try:
        return _run(options)
    except InputError as error:
        sys.stderr.write(f"skincal: {error}\n")
        return 2
    except OSError as error:  # a name that is too long, a folder without rights
        if error.filename is None:
            raise
        sys.stderr.write(f"skincal: {InputError(f'{error.filename}: cannot be used ({error.strerror}); check the path.')}\n")
        return 2


def _command(arguments: list[str]) -> int:
    """Run a command, or show help or the version; the window's help follows that of the commands."""
    try:
        from skincal.cli import main as run_command

        code = run_command(arguments)
    except KeyboardInterrupt:  # during the imports; a running command handles it
        return INTERRUPTED
    if arguments[0] in HELP_OPTIONS[:2]:
        sys.stdout.write(f"\nThe window, without a command:\n\n{_parser().format_help()}")
    return code


def _run(options: argparse.Namespace) -> int:
    """Open the window, or without a display and devices run the simulated session."""
    _check_session(options)
    devices = [f"--{name}" for name in ("wrench", "skin", "joints", "targets") if getattr(options, name)]
    if options.headless and devices:
        raise InputError(
            f"--headless simulates its devices, so {' and '.join(devices)} cannot be used with it. "
            "`skincal record` records devices without a window."
        )
    named = options.wrench or options.skin or options.joints or options.session
    no_window = "" if named else no_display()
    if options.headless or no_window:
        if options.scene is not None and options.scene.suffix.lower() in MESHES:
            raise InputError(f"{options.scene}: is a mesh; only the window makes a scene of it. Expected a scene (*.toml).")
        from app.headless import run_headless
        from app.session.opening import find_scene

        return run_headless(find_scene(options.scene), options.new, no_window)
    reason = window_problem()
    if reason:
        sys.stderr.write(reason + "\n")
        return 2
    from app.run import request_of, run_window

    return run_window(request_of(options))


def _check_session(options: argparse.Namespace) -> None:
    """Refuse options that a recorded session would ignore."""
    seen = [f"--{name}" for name in ("scene", "new", "headless") if getattr(options, name)]
    if options.session is not None and seen:
        raise InputError(
            f"--session {options.session} was given together with {' and '.join(seen)}; expected --session without, "
            "since a recorded session has its own scene and folder, and opens in the window."
        )


class _Parser(argparse.ArgumentParser):
    """Reports wrong options in one sentence, as the commands do."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"skincal: {message}; `skincal --help` lists the options.\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser("skincal", description="Open the window, by default on a simulated forearm.")
    parser.add_argument("--scene", type=Path, help="scene file (*.toml), the name of one that ships, or a mesh")
    parser.add_argument("--session", type=Path, help="folder of a recorded session to continue")
    parser.add_argument("--wrench", default="", help="device of the force/torque sensor")
    parser.add_argument("--skin", default="", help="device of the skin")
    parser.add_argument("--joints", default="", help="device that streams the arm's joints")
    parser.add_argument(
        "--targets", default="", metavar="[HOST:]PORT", help="send poke targets to a robot, by lines over TCP (docs/wire.md)"
    )
    parser.add_argument("--new", type=Path, help="folder of the new session")
    parser.add_argument("--headless", action="store_true", help="run the simulated session without a window, to files in --new")
    return parser


if __name__ == "__main__":
    if getattr(sys, "frozen", False):
        from multiprocessing import freeze_support

        freeze_support()  # child processes of the frozen program start here
    sys.exit(main())
