"""`pokes`: list the pokes of a session, and exclude some of them, as key E does in the window."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.landmarks import append_actions, begin_s_of, check_options, undo_last_call
from skincal.cli.solve import Json, SessionArgument
from skincal.model.errors import InputError, plural

if TYPE_CHECKING:
    from skincal.model.actions import Action
    from skincal.session.session import Session

RANGE_RE = re.compile(r"([0-9]{1,9})(?:\s*-\s*([0-9]{1,9}))?")
MOST_NAMED_POKES = 12


def add_to(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(epilog="Example: skincal pokes monday --exclude 1-12, then skincal solve monday")(pokes)


def pokes(
    session: SessionArgument,
    exclude: Annotated[
        str, typer.Option(help="Pokes that are not used, such as 1-12 or 3,7-9. They stay in the session.", show_default=False)
    ] = "",
    restore: Annotated[str, typer.Option(help="Excluded pokes that are used again, as --exclude.", show_default=False)] = "",
    undo: Annotated[bool, typer.Option("--undo", help="Undo the last call.")] = False,
    as_json: Json = False,
) -> None:
    """List the pokes of a session; exclude pokes, or use them again.

    A rejected poke counts only at a landmark: excluded, it is at none. The change is written into the session at once.
    """
    from skincal.cli import output
    from skincal.model.actions import AtLandmark, Exclude, Restore
    from skincal.session.replay import load

    options = [option for option, value in {"--exclude": exclude, "--restore": restore}.items() if value]
    check_options(session, options, undo=undo, command="pokes")
    pipeline = load(session)
    loaded, changes = pipeline.session, list[str]()
    if undo:
        changes = undo_last_call(session, loaded, (Exclude, Restore, AtLandmark), "an exclusion")
    elif options:
        changes = _write(session, loaded, exclude, restore)
    rows = _rows(loaded, begin_s_of(session))
    result = {"session": session, "pokes": rows, "said": changes, "findings": list(pipeline.findings)}
    output.print_result(result, [*(changes or map(_row_line, rows)), *pipeline.findings], as_json)


def _parse_numbers(text: str, option: str, last: int) -> list[int]:
    """Read `3,7-9`. Raises InputError: it is no list, or the session ends at poke `last`."""
    found: list[int] = []
    for part in text.split(","):
        match = RANGE_RE.fullmatch(part.strip())
        if match is None:
            raise InputError(f"{option} {text}: expected numbers of pokes, such as 1-12 or 3,7-9.")
        first, end = int(match[1]), int(match[2] or match[1])
        if not 1 <= first <= end <= last:
            has = f"the session has the pokes 1 to {last}" if last else "the session has no poke"
            raise InputError(f"{option} {text}: {part.strip()} does not fit; {has}.")
        found += range(first, end + 1)
    return found


def _write(folder: Path, session: Session, exclude: str, restore: str) -> list[str]:
    """Write the actions into the session, each tried on the loaded one first; return the changes as lines."""
    snapshot = session.snapshot()
    wanted = {
        option: _parse_numbers(text, option, session.last_poke)
        for option, text in (("--exclude", exclude), ("--restore", restore))
        if text
    }
    both = sorted(set(wanted.get("--exclude", ())) & set(wanted.get("--restore", ())))
    if both:
        raise InputError(f"Poke {both[0]} is named by --exclude and by --restore; leave out one of them.")
    of_option: dict[str, Sequence[Action]] = {
        "excluded": snapshot.actions_to_exclude(wanted.get("--exclude", ())),
        "used again": snapshot.actions_to_restore(wanted.get("--restore", ())),
    }
    actions = [action for each in of_option.values() for action in each]
    for action in actions:
        session.act(action)
    if actions:
        append_actions(folder, actions)
    lines = [f"{words}: {_named(each)}" for words, each in of_option.items() if each]
    left = session.snapshot().poke_counts
    counted = f"{plural(left.accepted, 'accepted poke')} and {left.at_landmarks + left.on_both} at landmarks are used"
    return [*(lines or ["nothing new, nothing was written"]), f"{counted}; `skincal solve {folder}` estimates with them"]


def _named(actions: Sequence[Any]) -> str:
    numbers = [str(action.poke) for action in actions]
    more = f" and {len(numbers) - MOST_NAMED_POKES} more" if len(numbers) > MOST_NAMED_POKES else ""
    return f"{plural(len(numbers), 'poke')}, {', '.join(numbers[:MOST_NAMED_POKES])}{more}"


def _rows(session: Session, begin_s: float) -> list[dict[str, Any]]:
    """Convert each poke to JSON."""
    from skincal.contacts.outcome import Contact

    snapshot = session.snapshot()
    return [
        {
            "poke": record.outcome.poke,
            "start_s": record.outcome.start_s - begin_s,
            "outcome": "accepted" if isinstance(record.outcome, Contact) else record.outcome.reason.value,
            "excluded": snapshot.is_taken_out(record),
            "taxels": record.outcome.channels.tolist(),
            "pose": record.outcome.pose,
            "landmark": snapshot.at_landmarks.get(record.outcome.poke),
        }
        for record in snapshot.pokes
    ]


def _row_line(row: dict[str, Any]) -> str:
    from skincal.contacts.outcome import Reason
    from skincal.words.poke_words import words_of_reason

    outcome = "accepted" if row["outcome"] == "accepted" else words_of_reason(Reason(row["outcome"]), row["pose"])
    taxels = f", taxels {', '.join(map(str, row['taxels']))}" if row["taxels"] and row["outcome"] == "accepted" else ""
    at = f"; at {row['landmark']}" if row["landmark"] else ""
    return f"poke {row['poke']}, {row['start_s']:.1f} s: {outcome}{taxels}{at}{'; excluded' if row['excluded'] else ''}"
