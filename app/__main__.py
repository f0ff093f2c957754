"""`skincal`: a command where one is named, else the window.

Commands import no Qt. The window is on the screen before anything heavy is imported or read.
"""

from __future__ import annotations

import os
import sys

if __name__ == "__main__" and not sys.flags.safe_path:
    # `python -m app` has put the working folder first on the path: a `typer.py` that lies there is not the program's.
    sys.path[:] = [*sys.path[1:], os.path.dirname(os.path.dirname(__file__))]  # noqa: PTH120 - a pathlib.py may lie there

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from app.preflight import no_display, objection
from app.scene3d.drawing_probe import PROBE_OPTION
from app.session.opening import DEMO_SCENES, PART_FILES
from skincal.model.errors import CTRL_C_EXIT_CODE, InputError

HELP = ("-h", "--help", "--version")
DEMO_COMMAND = "demo"
ROBOT_DEMO = "robot"  # `skincal demo robot`: the window with a simulated robot that pokes
DEMO_HELP = f"""usage: skincal {DEMO_COMMAND} {ROBOT_DEMO} [--sensor {"|".join(DEMO_SCENES)}]

Open the window while a simulated robot arm calibrates a part. S stops the arm.
--sensor is where the force/torque sensor is: below the part (default), in the arm's wrist, or none.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command or the window; return the exit code: 0 success, 2 wrong input, 1 fault of the program."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments[:1] == [PROBE_OPTION]:
        from app.scene3d.drawing_probe import draw_probe_picture

        return draw_probe_picture("".join(arguments[1:]))
    if arguments and not arguments[0].startswith("-") and arguments[0].lower().endswith(PART_FILES):
        # For example a file that is dropped onto the program.
        arguments.insert(0, "--scene")
    if arguments[:1] == [DEMO_COMMAND]:
        return _exit_code(lambda: _run_demo(arguments[1:]))
    if arguments and (arguments[0] in HELP or not arguments[0].startswith("-")):
        return _command(arguments)
    try:
        options = _parser().parse_args(arguments)
    except SystemExit as end:
        # argparse ends the program itself, after --help and after errors.
        return int(end.code or 0)
    return _exit_code(lambda: _run(options))


def _exit_code(run: Callable[[], int]) -> int:
    """Run the window; report wrong input in one sentence."""
    try:
        return run()
    except InputError as error:
        sys.stderr.write(f"skincal: {error}\n")
        return 2
    except OSError as error:  # a name that is too long, a folder without rights
        if error.filename is None:
            raise
        sys.stderr.write(f"skincal: {InputError(f'{error.filename}: cannot be used ({error.strerror}); check the path.')}\n")
        return 2


def _command(arguments: list[str]) -> int:
    """Run a command, or show help or version; the window's help follows that of the commands."""
    try:
        from skincal.cli import main as run_command

        code = run_command(arguments)
    except KeyboardInterrupt:  # while modules are imported; a running command handles it
        return CTRL_C_EXIT_CODE
    if arguments[0] in HELP[:2]:
        sys.stdout.write(f"\nThe window, without a command:\n\n{_parser().format_help()}")
    return code


def _run_demo(words: Sequence[str]) -> int:
    if set(words) & set(HELP[:2]):
        sys.stdout.write(DEMO_HELP)
        return 0
    sensor = words[2] if len(words) == 3 and words[1] == "--sensor" else "below" if len(words) == 1 else ""
    if list(words[:1]) != [ROBOT_DEMO] or sensor not in DEMO_SCENES:
        named, known = " ".join([DEMO_COMMAND, *words]), ", ".join(DEMO_SCENES)
        raise InputError(
            f"{named} is no demonstration; expected {DEMO_COMMAND} {ROBOT_DEMO}, alone or with --sensor and one of {known}."
        )
    reason = no_display() or objection()
    if reason:
        sys.stderr.write(reason + "\n")
        return 2
    from app.run import robot_demo, run_window

    return run_window(robot_demo(sensor))


def _run(options: argparse.Namespace) -> int:
    """Open the window; without a display and without devices, run the simulated session without it."""
    _check_session(options)
    devices = [f"--{name}" for name in ("wrench", "skin", "joints", "tip", "tool", "targets") if getattr(options, name)]
    if options.headless and devices:
        raise InputError(
            f"--headless was given together with {' and '.join(devices)}; it pokes a simulated rig alone: "
            "`skincal record` records devices without a window."
        )
    named = options.wrench or options.skin or options.joints or options.tip or options.tool or options.session
    no_window = "" if named else no_display()
    if options.headless or no_window:
        if options.scene is not None and options.scene.suffix.lower() in PART_FILES:
            raise InputError(f"{options.scene}: is no scene; expected a scene (*.toml), such as `skincal scene new` writes.")
        from app.headless import run_headless
        from app.session.opening import find_scene

        return run_headless(find_scene(options.scene), options.new, no_window)
    reason = objection()
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
        self.exit(2, f"skincal: {message}; `skincal --help` shows what is possible.\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        "skincal",
        description="Open the window: on a simulated forearm, if no option says otherwise. "
        f"`skincal {DEMO_COMMAND} {ROBOT_DEMO}`: a simulated robot arm calibrates it; with `--sensor tool` the arm is a cobot "
        "that has the force/torque sensor in its wrist, with `--sensor none` one without a sensor.",
    )
    parser.add_argument("--scene", type=Path, help="scene file (*.toml), the name of one that ships, a mesh or a URDF")
    parser.add_argument("--session", type=Path, help="folder of a recorded session to go on with")
    parser.add_argument("--wrench", default="", help="device of the force/torque sensor")
    parser.add_argument("--skin", default="", help="device of the skin")
    parser.add_argument("--joints", default="", help="device that streams the arm's joints")
    parser.add_argument("--tip", default="", help="device that streams the position of the tip, in a fixed frame")
    parser.add_argument("--tool", default="", help="device that streams the poses of the tool, for a scene with [tool]")
    parser.add_argument(
        "--targets",
        default="",
        metavar="[HOST:]PORT|ros2:",
        help="ask a robot to poke, by lines over TCP (docs/wire.md) or topics (docs/ros.md)",
    )
    parser.add_argument("--new", type=Path, help="folder of the new session")
    parser.add_argument("--headless", action="store_true", help="run the simulated session without a window, to files in --new")
    return parser


if __name__ == "__main__":
    if getattr(sys, "frozen", False):
        from multiprocessing import freeze_support

        freeze_support()  # a process of the frozen program starts here, too
    sys.exit(main())
