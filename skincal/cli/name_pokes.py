"""`landmarks`: name the landmark of recorded pokes, for sessions that were recorded without the window's requests."""

from __future__ import annotations

import csv
import time
from collections.abc import Iterable, Iterator, Sequence
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer
from typer.core import TyperCommand

from skincal.cli.calibrate import Json, SessionArgument
from skincal.model.errors import InputError, plural
from skincal.model.given import MAX_TEXT_BYTES, read_regular

if TYPE_CHECKING:
    from skincal.contacts.outcome import Outcome
    from skincal.model.actions import Action, AddLandmark, AtLandmark
    from skincal.session.landmark_pokes import NearestLandmark
    from skincal.session.session import Session
    from skincal.session.undo import HistoryEntry

NO_LANDMARK = "-"
"""Stands for no landmark, as an empty name does."""
TABLE_HEADERS = (["poke", "landmark"], ["start_s", "end_s", "landmark"])
Names: TypeAlias = dict[int, str]
"""Number of a poke to the landmark that it was at; empty for none."""
NewLandmark: TypeAlias = tuple[str, float, float, float]


class AddOnceCommand(TyperCommand):
    """Refuses a second `--add`: only the last would take effect."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Take the arguments apart; InputError for a second `--add`."""
        if args.count("--add") > 1:
            raise InputError("--add names one landmark; call `skincal landmarks` again for each other one.")
        return super().parse_args(ctx, args)


def add_to(app: typer.Typer) -> None:
    """Add the command of this module."""
    example = 'skincal landmarks monday --at 12="wrist, top" --at 13="elbow, top", then skincal solve monday --correct'
    app.command(cls=AddOnceCommand, epilog=f"Example: {example}")(landmarks)


def landmarks(
    session: SessionArgument,
    at: Annotated[
        list[str] | None,
        typer.Option(
            help='Poke and landmark, such as 12="wrist, top"; may be repeated. 12= takes it back.', show_default=False
        ),
    ] = None,
    csv_file: Annotated[
        Path | None,
        typer.Option(
            "--csv",
            help="File with the columns poke,landmark, or start_s,end_s,landmark: all pokes from one time to another, in "
            "seconds since the recording began, as they are listed. Comma, semicolon or tab between them.",
            show_default=False,
        ),
    ] = None,
    order: Annotated[
        str | None,
        typer.Option(
            help='Landmarks in the order in which they were poked, such as "elbow, outer;wrist, top;-": one for each poke that '
            "no taxel answered, or for each before the first that one answered. - stands for none.",
            show_default=False,
        ),
    ] = None,
    find: Annotated[
        bool,
        typer.Option(
            "--find",
            help="Find them from the axes of force: where no taxel answered, and the axis passes one landmark within 20 mm and "
            "every other at least twice as far.",
        ),
    ] = False,
    add: Annotated[
        NewLandmark | None,
        typer.Option(help="Name a landmark that the scene lacks: NAME X Y Z, mm, link frame.", show_default=False),
    ] = None,
    undo: Annotated[bool, typer.Option("--undo", help="Take back what the last call wrote.")] = False,
    as_json: Json = False,
) -> None:
    """Say which poke of a session was at which landmark, for `--correct` of `solve`, `export` and `report`.

    Without options the pokes are listed with what is known of them. What is said is written into the session at once.
    """
    from skincal.cli import report
    from skincal.session.replay import load

    given = {"--at": at, "--csv": csv_file, "--order": order, "--find": find, "--add": add}
    named = [option for option, value in given.items() if value]
    _check_options(session, named, undo=undo)
    pipeline = load(session)
    known, begin_s = pipeline.session, _begin_s(session)
    text: list[str] = []
    if undo:
        text = _take_back(session, known)
    elif named:
        names = _said(known, begin_s, at or [], csv_file, order)
        text = _write(session, known, names, find=find, add=add)
    rows = _rows(known, begin_s)
    text = text or [_landmark_line(known), *map(_row_line, rows)]
    result = {
        "session": session,
        "landmarks": [{"name": mark.name, "place_mm": (mark.place * 1e3).tolist()} for mark in known.decisions.landmarks],
        "pokes": rows,
        "said": text if undo or named else [],
        "findings": list(pipeline.findings),
    }
    report.print_result({**result, "text": [*text, *pipeline.findings]}, as_json)


def _check_options(session: Path, named: Sequence[str], *, undo: bool) -> None:
    """Refuse options that exclude each other, and changes to a session that is being recorded."""
    from skincal.journal.lock import describe_lock_holder

    if undo and named:
        raise InputError(f"--undo and {named[0]} exclude each other; call `skincal landmarks` once for each.")
    if (undo or named) and (who := describe_lock_holder(session)):
        raise InputError(f"{session}: is being recorded by {who}; end that recording first.")


# ---- options to landmarks of pokes ----


def _said(known: Session, begin_s: float, at: Sequence[str], csv_file: Path | None, order: str | None) -> list[Names]:
    """Parse the options to a landmark by poke. Raises InputError: one cannot be read or does not fit the pokes."""
    said = [_of_pair(pair) for pair in at]
    if csv_file is not None:
        said += _of_csv(known, begin_s, csv_file)
    if order is not None:
        said.append(_in_order(known, order))
    return said


def _of_pair(pair: str) -> Names:
    poke, equals, name = pair.partition("=")
    return {_number(poke if equals else "", f"--at {pair}"): name.strip()}


def _number(text: str, where: str) -> int:
    if not text.strip().isdecimal():
        raise InputError(f'{where}: expected the number of a poke and a landmark, such as --at 12="wrist, top".')
    return int(text)


def _of_csv(known: Session, begin_s: float, path: Path) -> list[Names]:
    """Parse each row of a file to a poke and its landmark."""
    from skincal.files.importers.csv_log import COLUMN_SEPARATORS

    try:
        content = read_regular(path, MAX_TEXT_BYTES).decode("utf-8-sig")
        first = next(filter(str.strip, content.splitlines()), "")
        mark = next((mark for mark in COLUMN_SEPARATORS if mark in first), ",")
        rows = csv.reader(StringIO(content, newline=""), delimiter=mark)
        lines = [(number, [field.strip() for field in row]) for number, row in enumerate(rows, 1) if any(row)]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read ({error}); expected a CSV file.") from None
    header = lines[0][1] if lines else []
    if header not in TABLE_HEADERS:
        seen = ",".join(header) or "nothing"
        raise InputError(
            f"{path}: begins with {seen}; expected the line {' or '.join(','.join(names) for names in TABLE_HEADERS)}."
        )
    names: list[Names] = []
    for number, row in lines[1:]:
        where = f"{path}, line {number}"
        if len(row) != len(header):
            raise InputError(
                f"{where}: has {plural(len(row), 'field')}; expected {len(header)}: a name with a {COLUMN_SEPARATORS[mark]} "
                "in quotes."
            )
        names.append({_number(row[0], where): row[1]} if len(header) == 2 else _between(known, begin_s, row, where))
    return names


def _between(known: Session, begin_s: float, row: Sequence[str], where: str) -> Names:
    """Return the pokes from one time to another that can be at a landmark."""
    from skincal.session.landmark_pokes import can_be_at_landmark

    try:
        # A comma is the decimal point where semicolons part the columns.
        start_s, end_s = (float(field.replace(",", ".")) for field in row[:2])
    except ValueError:
        raise InputError(f"{where}: {row[0]} to {row[1]} are no times; expected seconds since the recording began.") from None
    within = [poke for poke in _outcomes(known) if start_s <= (poke.start_s + poke.end_s) / 2 - begin_s <= end_s]
    names = {poke.poke: row[2] for poke in within if can_be_at_landmark(poke)}
    if not names:
        raise InputError(
            f"{where}: no poke from {start_s:g} to {end_s:g} s can be at a landmark; without options all are listed."
        )
    return names


def _in_order(known: Session, order: str) -> Names:
    """Return the pokes that no taxel answered, or those of them before the first that one answered, with their landmarks."""
    from skincal.contacts.outcome import Contact, Rejection
    from skincal.session.landmark_pokes import can_be_at_landmark

    names = [name.strip() for name in order.split(";")]
    first = next((poke.poke for poke in _outcomes(known) if isinstance(poke, Contact)), known.last_poke + 1)
    silent = [poke.poke for poke in _outcomes(known) if isinstance(poke, Rejection) and can_be_at_landmark(poke)]
    before = [poke for poke in silent if poke < first]
    for pokes in (silent, before):
        if len(pokes) == len(names):
            return dict(zip(pokes, ["" if name == NO_LANDMARK else name for name in names], strict=True))
    raise InputError(
        f"--order names {plural(len(names), 'landmark')}, but no taxel answered {plural(len(silent), 'poke')}, {len(before)} "
        f"of them before the first that one answered; expected a landmark for each, or {NO_LANDMARK} for a poke at none."
    )


# ---- what is written ----


def _write(folder: Path, known: Session, said: Iterable[Names], *, find: bool, add: NewLandmark | None) -> list[str]:
    """Write what was said, and what is found from the axes, into a session; return it in lines.

    Parameters
    ----------
    known : the session, loaded: each action is tried on it first, and nothing is written where one is refused
    """
    from skincal.model.actions import AddLandmark, AtLandmark

    actions: list[AddLandmark | AtLandmark] = []
    if add is not None:
        actions.append(AddLandmark(add[0], *(length * 1e-3 for length in add[1:])))
        known.act(actions[0])
    names: Names = {}
    for poke, name in (pair for part in said for pair in part.items()):
        if names.setdefault(poke, name) != name:
            both = f"{names[poke] or 'none'} and at {name or 'none'}"
            raise InputError(f"Poke {poke} is said to be at {both}; leave out one of them.")
    nearest, before = _nearest(known), known.snapshot().at_landmarks
    unsure: list[str] = []
    if find:
        names |= {poke: near.name for poke, near in nearest.items() if near.sure and poke not in {**names, **before}}
        unsure = _unsure_lines(known, nearest, {**names, **before})
    changed = {poke: name for poke, name in sorted(names.items()) if before.get(poke, "") != name}
    for poke, name in changed.items():
        actions.append(AtLandmark(poke, name))
        known.act(actions[-1])
    if actions:
        _append(folder, actions)
    return [*_written_lines(folder, known, actions), *unsure]


def _append(folder: Path, actions: Iterable[Action]) -> None:
    """Write actions into a session, in a segment of their own, all at one moment: by that `_last_call` knows them together."""
    from skincal.session.replay import resume

    pipeline = resume(folder)
    # Of the new segment's time: what lies before it has no time of day, and then no moment of its own.
    now_ns = time.monotonic_ns()
    try:
        for action in actions:
            pipeline.act(action, now_ns)
    finally:
        pipeline.close()
    if pipeline.journal_failure:
        raise InputError(pipeline.journal_failure)


def _written_lines(folder: Path, known: Session, actions: Iterable[AddLandmark | AtLandmark]) -> list[str]:
    from skincal.model.actions import AddLandmark

    misses = {poke.poke: poke.miss for poke in known.landmark_pokes}
    lines: list[str] = []
    for action in actions:
        if isinstance(action, AddLandmark):
            lines.append(f"wrote landmark {action.name}")
        else:
            passed = f", which its axis passes at {misses[action.poke] * 1e3:.1f} mm" if action.poke in misses else ""
            lines.append(f"wrote poke {action.poke} at {action.name or 'no landmark'}{passed}")
    nothing = ["nothing new, nothing was written"] if known.decisions.landmarks else [_landmark_line(known)]
    return [*(lines or nothing), f"{plural(len(known.landmark_pokes), 'poke')} at landmarks; {_use_words(folder, known)}"]


def _use_words(folder: Path, known: Session) -> str:
    """Say which commands use the landmark pokes, or how many a rig correction still needs."""
    from skincal.rig.correction_fit import MIN_LANDMARK_POKES, MIN_LANDMARKS

    points = max(MIN_LANDMARKS - len({poke.name for poke in known.landmark_pokes}), 0)
    more = max(MIN_LANDMARK_POKES - len(known.landmark_pokes), points)
    if not more:
        return f"`skincal solve {folder} --correct` uses them"
    others = f", {points} of them at {'another' if points == 1 else 'others'}" if points and known.landmark_pokes else ""
    return f"a correction of the rig needs {MIN_LANDMARK_POKES} at {MIN_LANDMARKS} landmarks: {more} more{others}"


def _unsure_lines(known: Session, nearest: dict[int, NearestLandmark], named: Names) -> list[str]:
    """Return a line for each poke that no taxel answered and that is at no landmark for sure."""
    from skincal.contacts.outcome import Rejection
    from skincal.session.landmark_pokes import can_be_at_landmark

    silent = [poke.poke for poke in _outcomes(known) if isinstance(poke, Rejection) and can_be_at_landmark(poke)]
    return [f"poke {poke}: not sure, {_near_words(nearest.get(poke))}" for poke in silent if poke not in named]


def _take_back(folder: Path, known: Session) -> list[str]:
    """Undo what the last call wrote; return it in lines."""
    from skincal.model.actions import Undo

    count = _last_call(known.history.entries)
    if not count:
        raise InputError(
            f"{folder}: what was done last is {known.snapshot().can_undo or 'nothing'}, not a landmark; nothing to take back."
        )
    lines: list[str] = []
    for _ in range(count):
        lines.append(f"took back {known.snapshot().can_undo}")
        known.act(Undo())
    _append(folder, [Undo()] * count)
    return lines


def _last_call(history: Sequence[HistoryEntry]) -> int:
    """Count the last entries of a session's history that name landmarks and share one time stamp."""
    from skincal.model.actions import AddLandmark, AtLandmark
    from skincal.session.undo import ActionEntry

    moment, count = None, 0
    for entry in reversed(history):
        if not isinstance(entry, ActionEntry) or not isinstance(entry.action, AddLandmark | AtLandmark):
            break
        if moment not in (None, entry.at_s):
            break
        moment, count = entry.at_s, count + 1
    return count


# ---- listing of pokes ----


def _outcomes(known: Session) -> Iterator[Outcome]:
    """Give every poke that was not taken out, in order."""
    excluded = known.decisions.excluded
    yield from known.frame_corrected(
        record.outcome.poke for record in known.snapshot().pokes if record.outcome.poke not in excluded
    )


def _nearest(known: Session) -> dict[int, NearestLandmark]:
    from skincal.session.landmark_pokes import nearest_landmarks

    return nearest_landmarks(_outcomes(known), known.decisions.landmarks, known.surface)


def _begin_s(folder: Path) -> float:
    """Return when the first bytes of a session arrived, s of the host's clock."""
    from skincal.journal.reader import SessionLog
    from skincal.model.readings import Chunk

    first = next((item for item in SessionLog(folder).items() if isinstance(item, Chunk)), None)
    return 0.0 if first is None else first.host_ns * 1e-9


def _rows(known: Session, begin_s: float) -> list[dict[str, Any]]:
    """Convert each poke, its landmark and its rejection to JSON."""
    from skincal.contacts.outcome import Contact

    nearest, names = _nearest(known), known.snapshot().at_landmarks
    misses = {poke.poke: poke.miss * 1e3 for poke in known.landmark_pokes}
    return [
        {
            "poke": poke.poke,
            "start_s": poke.start_s - begin_s,
            "end_s": poke.end_s - begin_s,
            "outcome": "accepted" if isinstance(poke, Contact) else poke.reason.value,
            "taxels": poke.channels.tolist(),
            "pose": poke.pose,
            "landmark": names.get(poke.poke),
            "miss_mm": misses.get(poke.poke),
            "nearest": _near_json(nearest.get(poke.poke)),
        }
        for poke in _outcomes(known)
    ]


def _near_json(near: NearestLandmark | None) -> dict[str, Any] | None:
    if near is None:
        return None
    other = None if near.other == float("inf") else near.other * 1e3
    return {"landmark": near.name, "miss_mm": near.miss * 1e3, "next_mm": other, "sure": near.sure}


def _near_words(near: NearestLandmark | None) -> str:
    if near is None:
        return "it pushes at no landmark"
    beside = "" if near.other == float("inf") else f", the next at {near.other * 1e3:.0f} mm"
    return f"its axis passes {near.name} at {near.miss * 1e3:.0f} mm{beside}"


def _landmark_line(known: Session) -> str:
    places = [
        f"{mark.name} ({', '.join(f'{length * 1e3:.1f}' for length in mark.place)})" for mark in known.decisions.landmarks
    ]
    return f"landmarks, mm: {'; '.join(places)}" if places else "the scene has no landmarks; --add NAME X Y Z names one"


def _row_line(row: dict[str, Any]) -> str:
    from skincal.contacts.outcome import Reason

    pose = f", pose {row['pose']}" if row["pose"] else ""
    words = f"poke {row['poke']}, {row['start_s']:.1f} s{pose}: {row['outcome']}"
    if row["landmark"]:
        return f"{words}; at {row['landmark']}, which its axis passes at {row['miss_mm']:.1f} mm"
    near = row["nearest"]
    if row["outcome"] == Reason.NO_TAXEL.value and near is not None:
        return f"{words}; nearest is {near['landmark']}, at {near['miss_mm']:.0f} mm"
    return words
