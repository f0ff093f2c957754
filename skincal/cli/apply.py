"""`apply`: positions to a running robot, and back."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.solve import Correct, Json, LayoutOption, MethodOption, Part, Replay
from skincal.cli.terminal import say
from skincal.model.errors import InputError

if TYPE_CHECKING:
    from skincal.robot.skin_manager import Positions

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
            help="File for the positions that the robot has now; default: before-PART.txt next to the applied "
            "file. An older file is kept as .bak, .bak-2, .... If that file itself is applied, -undone is added to its name.",
            show_default=False,
        ),
    ] = None,
    timeout: Annotated[float, typer.Option(min=0.1, max=60.0, help="Seconds to wait for each answer.")] = 2.0,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the messages that would be sent, and connect to nothing.")
    ] = False,
    layout: LayoutOption = None,
    correct: Correct = False,
    replay: Replay = False,
    as_json: Json = False,
) -> None:
    """Send positions to a running skinManager, one taxel after another, and show what it answers.

    Only taxels that have a position, and that the robot has elsewhere, are sent; the others stay as they are. The robot's own
    positions are read first and kept in a file; this command restores them from it. At the first refusal it stops.
    """
    from skincal.cli import output
    from skincal.interface.session import Session
    from skincal.robot.skin_manager import (
        apply_positions,
        calibrated_positions,
        check_port,
        file_positions,
        result_text,
    )

    check_port(to)
    verdict: str | None = None
    if source.is_file():
        if method is not None or layout is not None or correct or replay:
            raise InputError(f"{source} is a file of positions; expected --part alone with it, since only a session is solved.")
        positions = file_positions(source, part)
    else:
        results = Session.load(source, layout=layout, replayed=replay, correct=correct).results
        chosen = results.choose_method(method)
        positions = calibrated_positions(results.calibration(), chosen, part)
        verdict = output.verdict_words(results.verdict(chosen))
    lines = [] if verdict is None else [f"{verdict}."]
    if dry_run:
        asked = _would_be_sent(positions)
        result = {"part": positions.part, "would_send": asked, "verdict": verdict}
        output.print_result(result, [*lines, *asked, f"{len(positions.rows)} taxels; {DRY_RUN_NOTICE}"], as_json)
        return
    kept = _file_for_old_positions(source, before, positions.part)
    applied = apply_positions(to, positions, kept, timeout, (lambda _: None) if as_json else _say)
    answers = [{"asked": asked, "answered": answered} for asked, answered in applied.answers]
    result: dict[str, Any] = {"part": positions.part, "changed": applied.changed, "same": applied.same}
    result |= {"before": applied.backup, "verdict": verdict, "answers": answers}
    output.print_result(result, [*lines, result_text(applied, positions.part)], as_json)


def _would_be_sent(positions: Positions) -> list[str]:
    """Return the commands of all positions, as text, in the order of sending."""
    from skincal.robot.skin_manager import command_text

    return [
        command_text(command)
        for channel in positions.rows
        for command in (positions.set_pose_command(channel), positions.set_confidence_command(channel))
    ]


def _file_for_old_positions(source: Path, before: Path | None, part: str) -> Path:
    """Return the file for the positions that the robot has now; it is never the applied file itself."""
    kept = before or (source if source.is_dir() else source.parent) / f"before-{part}.txt"
    if kept.exists() and kept.samefile(source):
        # Going back may end half way; the same command again must find what it began with.
        return kept.with_stem(f"{kept.stem}-undone")
    return kept


def _say(line: str) -> None:
    say(line, err=True)
