"""`apply`: positions to a running robot, and back."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.calibrate import Correct, Json, LayoutFile, MethodOption, Part, Replay, calibration_of
from skincal.cli.terminal import say
from skincal.model.errors import InputError

if TYPE_CHECKING:
    from skincal.robot.skin_manager import Positions
    from skincal.taxels.result import Method


DRY_RUN_NOTICE = "dry run: nothing was sent. A real run skips taxels whose position on the robot is already the same"


def add_to(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(
        epilog="Examples: skincal apply my-session --to yarp:/skinManager/rpc --dry-run; "
        "skincal apply my-session/before-r_forearm.txt --to yarp:/skinManager/rpc brings the old positions again"
    )(apply)


def apply(
    source: Annotated[
        Path,
        typer.Argument(metavar="SESSION|FILE", help="Folder of a session, or a position file of the iCub.", show_default=False),
    ],
    to: Annotated[
        str,
        typer.Option(help="RPC port of a running skinManager: yarp:/skinManager/rpc, or yarp://SERVER:PORT/skinManager/rpc."),
    ],
    method: MethodOption = None,
    part: Part = None,
    before: Annotated[
        Path | None,
        typer.Option(
            help="File for the positions that the robot has now; else before-PART.txt beside what is applied. An older one is "
            "kept as .bak, .bak-2, ...; where that file is applied itself, -undone is added to its name.",
            show_default=False,
        ),
    ] = None,
    timeout: Annotated[float, typer.Option(min=0.1, max=60.0, help="Seconds to wait for each answer.")] = 2.0,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print all that may be sent; nothing is opened.")] = False,
    layout: LayoutFile = None,
    correct: Correct = False,
    replay: Replay = False,
    as_json: Json = False,
) -> None:
    """Send positions to a running skinManager, one taxel after another, and show what it answers.

    Only taxels that have a position, and that the robot has elsewhere, are sent; the others stay as they are. The robot's own
    positions are read first and kept in a file, by which this command brings them again, with what had none. At the first
    refusal it stops.
    """
    from skincal.cli import report
    from skincal.robot.skin_manager import apply_positions, check_port, command_text, result_text

    check_port(to)
    positions, verdict = _positions(source, (method, part), layout, (correct, replay))
    lines = [] if verdict is None else [f"{verdict}."]
    if dry_run:
        asked = [
            command_text(command)
            for channel in positions.rows
            for command in (positions.set_pose_command(channel), positions.set_confidence_command(channel))
        ]
        result = {"part": positions.part, "would_send": asked, "verdict": verdict}
        report.print_result({**result, "text": [*lines, *asked, f"{len(positions.rows)} taxels; {DRY_RUN_NOTICE}"]}, as_json)
        return
    kept = before or (source if source.is_dir() else source.parent) / f"before-{positions.part}.txt"
    if kept.exists() and kept.samefile(source):
        # Going back may end half way; the same command again must find what it began with.
        kept = kept.with_stem(f"{kept.stem}-undone")
    applied = apply_positions(to, positions, kept, timeout, (lambda _: None) if as_json else _say)
    answers = [{"asked": asked, "answered": answered} for asked, answered in applied.answers]
    result: dict[str, Any] = {"part": positions.part, "changed": applied.changed, "same": applied.same}
    result |= {"before": applied.backup, "verdict": verdict, "answers": answers}
    report.print_result({**result, "text": [*lines, result_text(applied, positions.part)]}, as_json)


def _say(line: str) -> None:
    say(line, err=True)


def _positions(
    source: Path, of: tuple[Method | None, str | None], layout: Path | None, ways: tuple[bool, bool]
) -> tuple[Positions, str | None]:
    """Choose the positions to send and their verdict; `of` is method and part, `ways` is (correct, replay)."""
    from skincal.robot.skin_manager import calibrated_positions, file_positions

    method, part = of
    correct, replay = ways
    if not source.is_file():
        _, calibration, chosen = calibration_of(source, replay, layout, correct, method)
        return calibrated_positions(calibration, chosen, part), calibration.verdicts[chosen]
    if method is not None or layout is not None or correct or replay:
        raise InputError(f"{source} is a file of positions; expected --part alone with it, since only a session is solved.")
    return file_positions(source, part), None
