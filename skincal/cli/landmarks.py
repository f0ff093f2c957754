"""`landmarks`: name the landmark of recorded pokes, for sessions that were recorded without the window's requests."""

from __future__ import annotations

import csv
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer
from typer.core import TyperCommand

from skincal.cli.solve import Json, SessionArgument
from skincal.model.errors import InputError, plural
from skincal.model.given import MAX_TEXT_BYTES, read_regular

if TYPE_CHECKING:
    from skincal.contacts.outcome import Outcome
    from skincal.model.actions import Action, AddLandmark, AtLandmark
    from skincal.session.landmark_pokes import NearestLandmark
    from skincal.session.session import Session

NO_LANDMARK = "-"
"""Stands for no landmark, as an empty name does."""
TABLE_HEADERS = (["poke", "landmark"], ["start_s", "end_s", "landmark"])
Pair: TypeAlias = tuple[int, str]
"""Number of a poke, and the name of its landmark; empty for none."""
NewLandmark: TypeAlias = tuple[str, float, float, float]


class AddOnceCommand(TyperCommand):
    """Refuses a second `--add`: only the last would take effect."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments; InputError for a second `--add`."""
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
            help='Poke and landmark, such as 12="wrist, top"; may be repeated. 12= removes the name.', show_default=False
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
            help='Landmarks in the order in which they were poked, such as "elbow, outer;wrist, top;-": one for each poke '
            "without a taxel's answer, or for each before the first poke with one. - means no landmark.",
            show_default=False,
        ),
    ] = None,
    find: Annotated[
        bool,
        typer.Option(
            "--find",
            help="Find the landmarks: pokes without a taxel's answer whose force axis, or tip if it is known, is within 20 mm "
            "of one landmark, and at least twice as far from every other. While the place of a tool's part is unknown, the "
            "shape of the touched points names three or more.",
        ),
    ] = False,
    add: Annotated[
        NewLandmark | None,
        typer.Option(help="Name a landmark that the scene lacks: NAME X Y Z, mm, link frame.", show_default=False),
    ] = None,
    undo: Annotated[bool, typer.Option("--undo", help="Undo the last call.")] = False,
    as_json: Json = False,
) -> None:
    """Name the landmarks of recorded pokes, for `--correct` of `solve`, `export` and `report`.

    Without options all pokes are listed. The names are written into the session at once.
    """
    from skincal.cli import output
    from skincal.model.actions import AddLandmark, AtLandmark
    from skincal.session.replay import load

    given = {"--at": at, "--csv": csv_file, "--order": order, "--find": find, "--add": add}
    options = [option for option, value in given.items() if value]
    check_options(session, options, undo=undo, command="landmarks")
    pipeline = load(session)
    loaded, begin_s = pipeline.session, begin_s_of(session)
    changes: list[str] = []
    if undo:
        changes = undo_last_call(session, loaded, (AddLandmark, AtLandmark), "a landmark")
    elif options:
        pairs = [_parse_pair(pair) for pair in at or ()]
        pairs += [] if csv_file is None else _parse_table(loaded, begin_s, csv_file)
        pairs += [] if order is None else _parse_order(loaded, order)
        changes = _write(session, loaded, pairs, find=find, add=add)
    rows = _rows(loaded, begin_s)
    result = {
        "session": session,
        "landmarks": [{"name": mark.name, "place_mm": (mark.place * 1e3).tolist()} for mark in loaded.decisions.landmarks],
        "pokes": rows,
        "said": changes,
        "findings": list(pipeline.findings),
    }
    text = changes or [_landmark_line(loaded), *map(_row_line, rows)]
    output.print_result(result, [*text, *pipeline.findings], as_json)


def check_options(session: Path, options: Sequence[str], *, undo: bool, command: str) -> None:
    """Raise InputError: options exclude each other, or would change a session that is being recorded."""
    from skincal.journal.lock import describe_lock_holder

    if undo and options:
        raise InputError(f"--undo and {options[0]} exclude each other; call `skincal {command}` once for each.")
    if (undo or options) and (who := describe_lock_holder(session)):
        raise InputError(f"{session}: is being recorded by {who}; end that recording first.")


# ---- options to pairs of poke and landmark ----


def _parse_pair(pair: str) -> Pair:
    poke, equals, name = pair.partition("=")
    return _parse_number(poke if equals else "", f"--at {pair}"), name.strip()


def _parse_number(text: str, where: str) -> int:
    if not text.strip().isdecimal():
        raise InputError(f'{where}: expected the number of a poke and a landmark, such as --at 12="wrist, top".')
    return int(text)


def _parse_table(session: Session, begin_s: float, path: Path) -> list[Pair]:
    from skincal.files.importers.table_form import COLUMN_SEPARATORS

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
    pairs: list[Pair] = []
    for number, row in lines[1:]:
        where = f"{path}, line {number}"
        if len(row) != len(header):
            raise InputError(
                f"{where}: has {plural(len(row), 'field')}; expected {len(header)}: a name with a {COLUMN_SEPARATORS[mark]} "
                "in quotes."
            )
        name = row[-1]
        pokes = [_parse_number(row[0], where)] if len(header) == 2 else _pokes_between(session, begin_s, row, where)
        pairs += [(poke, name) for poke in pokes]
    return pairs


def _pokes_between(session: Session, begin_s: float, row: Sequence[str], where: str) -> list[int]:
    """List the pokes from one time to another that can be at a landmark."""
    from skincal.session.landmark_pokes import can_be_at_landmark

    try:
        # A comma is the decimal point if semicolons separate the columns.
        start_s, end_s = (float(field.replace(",", ".")) for field in row[:2])
    except ValueError:
        raise InputError(f"{where}: {row[0]} to {row[1]} are no times; expected seconds since the recording began.") from None
    within = [poke for poke in _outcomes(session) if start_s <= (poke.start_s + poke.end_s) / 2 - begin_s <= end_s]
    found = [poke.poke for poke in within if can_be_at_landmark(poke)]
    if not found:
        raise InputError(
            f"{where}: no poke from {start_s:g} to {end_s:g} s can be at a landmark; without options all are listed."
        )
    return found


def _parse_order(session: Session, order: str) -> list[Pair]:
    """Assign the names to the pokes that no taxel answered, or to those of them before the first answered one."""
    from skincal.contacts.outcome import Contact

    names = [name.strip() for name in order.split(";")]
    first = next((poke.poke for poke in _outcomes(session) if isinstance(poke, Contact)), session.last_poke + 1)
    unanswered = _unanswered(session)
    before = [poke for poke in unanswered if poke < first]
    for pokes in (unanswered, before):
        if len(pokes) == len(names):
            return list(zip(pokes, ["" if name == NO_LANDMARK else name for name in names], strict=True))
    raise InputError(
        f"--order names {plural(len(names), 'landmark')}, but no taxel answered {plural(len(unanswered), 'poke')}, "
        f"{len(before)} of them before the first that one answered; expected a landmark for each, or {NO_LANDMARK} for a poke "
        "at none."
    )


def _unanswered(session: Session) -> list[int]:
    """List the pokes that no taxel answered and that can be at a landmark."""
    from skincal.contacts.outcome import Rejection
    from skincal.session.landmark_pokes import can_be_at_landmark

    return [poke.poke for poke in _outcomes(session) if isinstance(poke, Rejection) and can_be_at_landmark(poke)]


# ---- changes of the session ----


def _write(folder: Path, session: Session, pairs: Iterable[Pair], *, find: bool, add: NewLandmark | None) -> list[str]:
    """Write the pairs, and with `find` those found from the force axes, into a session; return the changes as lines.

    Each action is tried on the loaded `session` first; nothing is written if one is refused.
    """
    from skincal.model.actions import AddLandmark

    actions: list[AddLandmark | AtLandmark] = []
    if add is not None:
        actions.append(AddLandmark(add[0], *(length * 1e-3 for length in add[1:])))
        session.act(actions[0])
    names: dict[int, str] = {}
    for poke, name in pairs:
        if names.setdefault(poke, name) != name:
            both = f"{names[poke] or 'none'} and at {name or 'none'}"
            raise InputError(f"Poke {poke} is said to be at {both}; leave out one of them.")
    by_shape: list[str] = []
    if find and not session.snapshot().is_placed:
        found, by_shape = _names_by_shape(session, names)
        names |= found
        actions += _name_pokes(session, names)
    nearest, before = session.nearest_landmarks(), session.snapshot().at_landmarks
    unsure: list[str] = []
    if find and session.snapshot().is_placed:
        names |= {poke: name for poke, name in session.sure_landmarks().items() if poke not in names}
        unsure = [
            f"poke {poke}: not sure, {_near_words(nearest.get(poke), has_axis=not session.has_used_tip)}"
            for poke in _unanswered(session)
            if poke not in {**names, **before} and poke not in session.decisions.taken_from_landmarks
        ]
    actions += _name_pokes(session, names)
    if actions:
        append_actions(folder, actions)
    return [*_written_lines(folder, session, actions), *by_shape, *unsure]


def _name_pokes(session: Session, names: Mapping[int, str]) -> list[AtLandmark]:
    """Name pokes in the loaded session, and return the actions that change anything."""
    from skincal.model.actions import AtLandmark

    before = session.snapshot().at_landmarks
    actions = [AtLandmark(poke, name) for poke, name in sorted(names.items()) if before.get(poke, "") != name]
    for action in actions:
        session.act(action)
    return actions


def _names_by_shape(session: Session, known: Mapping[int, str]) -> tuple[dict[int, str], list[str]]:
    """Name pokes by the shape of the touched points, and say how sure that is; none if several namings fit."""
    from skincal.words.units import millimetres

    first = "The part's pose is not known yet"
    if not session.has_used_tip:
        return {}, [f"{first}, and neither is the tip, so --find finds no landmark: name three by --at or --order first."]
    found = session.landmarks_by_shape(known)
    if found is None:
        return {}, [
            f"{first}, and no three touches have the shape of three landmarks: name three by --at or --order first. Check "
            "the places of the landmarks and tip_mm, too."
        ]
    if found.rival is not None:
        either = ", ".join(
            f"poke {poke} at {name or 'none'} or {found.rival.get(poke) or 'none'}"
            for poke, name in sorted({**dict.fromkeys(found.rival, ""), **found.names}.items())
            if found.rival.get(poke, "") != name
        )
        return {}, [
            f"{first}, and the touched points have the shape of the landmarks in more than one way: {either}. Name one of them "
            "by --at, in the same call."
        ]
    count = len({*found.names.values()})
    sure = "No other naming fits." if count > 3 else "No other naming fits; a touch of a fourth landmark would confirm it."
    shape = f"The touched points have the shape of {plural(count, 'landmark')}, to {millimetres(found.miss)} rms."
    return dict(found.names), [f"{shape} {sure}"]


def append_actions(folder: Path, actions: Iterable[Action]) -> None:
    """Write actions into a new segment of a session, with one time stamp, so that `undo_last_call` finds them."""
    from skincal.session.replay import resume

    pipeline = resume(folder)
    # A time within the new segment: earlier ones have no time of day.
    now_ns = time.monotonic_ns()
    try:
        for action in actions:
            pipeline.act(action, now_ns)
    finally:
        pipeline.close()
    if pipeline.journal_failure:
        raise InputError(pipeline.journal_failure)


def _written_lines(folder: Path, session: Session, actions: Iterable[AddLandmark | AtLandmark]) -> list[str]:
    from skincal.model.actions import AddLandmark
    from skincal.rig.correction_fit import MIN_LANDMARK_POKES, MIN_LANDMARKS
    from skincal.words.units import millimetres

    pokes = session.landmark_pokes
    is_placed = session.snapshot().is_placed
    misses = _misses(session)
    lines: list[str] = []
    for action in actions:
        if isinstance(action, AddLandmark):
            lines.append(f"wrote landmark {action.name}")
        else:
            miss = millimetres(misses.get(action.poke, 0.0))
            passed = f", {_miss_words(miss, has_axis=not session.has_used_tip)}" if action.poke in misses else ""
            lines.append(f"wrote poke {action.poke} at {action.name or 'no landmark'}{passed}")
    nothing = ["nothing new, nothing was written"] if session.decisions.landmarks else [_landmark_line(session)]
    points = max(MIN_LANDMARKS - len(set(pokes.name.tolist())), 0)
    more = max(MIN_LANDMARK_POKES - len(pokes), points)
    others = f", {points} of them at {'another' if points == 1 else 'others'}" if points and len(pokes) else ""
    use = f"a correction of the rig needs {MIN_LANDMARK_POKES} at {MIN_LANDMARKS} landmarks: {more} more{others}"
    use = use if more else f"`skincal solve {folder} --correct` uses them"
    if not session.scene.has_sensor:
        shown = "they show" if is_placed else "they do not show yet"
        use = f"{shown} the part's pose in the base of the tool's poses"
    return [*(lines or nothing), f"{plural(len(pokes), 'poke')} at landmarks; {use}"]


def undo_last_call(folder: Path, session: Session, kinds: tuple[type[Action], ...], name: str) -> list[str]:
    """Undo the last actions, if they are of these kinds, named `name`, and share one time stamp; list the changes."""
    from skincal.model.actions import Undo
    from skincal.session.undo import ActionEntry

    moment, count = None, 0
    for entry in reversed(session.history.entries):
        if not isinstance(entry, ActionEntry) or not isinstance(entry.action, kinds):
            break
        if moment not in (None, entry.at_s):
            break
        moment, count = entry.at_s, count + 1
    if not count:
        last = session.snapshot().can_undo or "nothing"
        raise InputError(f"{folder}: the last action is {last}, not {name}; there is nothing to undo.")
    lines: list[str] = []
    for _ in range(count):
        lines.append(f"took back {session.snapshot().can_undo}")
        session.act(Undo())
    append_actions(folder, [Undo()] * count)
    return lines


# ---- listing of pokes ----


def _outcomes(session: Session) -> Iterator[Outcome]:
    """List every poke that is not excluded, in order."""
    excluded = session.decisions.excluded
    yield from session.frame_corrected(
        record.outcome.poke for record in session.snapshot().pokes if record.outcome.poke not in excluded
    )


def _misses(session: Session) -> dict[int, float]:
    """Compute the distance of each landmark poke from its landmark, m, by poke: `misses_of_landmarks`."""
    from skincal.session.landmark_pokes import misses_of_landmarks

    if not session.snapshot().is_placed:
        return {}
    pokes = session.landmark_pokes
    return dict(zip(pokes.number.tolist(), misses_of_landmarks(pokes, session.contact_at).tolist(), strict=True))


def begin_s_of(folder: Path) -> float:
    """Return when the first bytes of a session arrived, s of the host's clock."""
    from skincal.journal.reader import SessionLog
    from skincal.model.readings import Chunk

    first = next((item for item in SessionLog(folder).items() if isinstance(item, Chunk)), None)
    return 0.0 if first is None else first.host_ns * 1e-9


def _rows(session: Session, begin_s: float) -> list[dict[str, Any]]:
    """Convert each poke, its landmark and its rejection to JSON."""
    from skincal.contacts.outcome import Contact

    nearest, names = session.nearest_landmarks(), session.snapshot().at_landmarks
    misses = {poke: miss * 1e3 for poke, miss in _misses(session).items()}
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
            "miss_of": "tip" if session.has_used_tip else "axis",
            "nearest": _near_json(nearest.get(poke.poke)),
        }
        for poke in _outcomes(session)
    ]


def _near_json(near: NearestLandmark | None) -> dict[str, Any] | None:
    if near is None:
        return None
    other = None if near.other == float("inf") else near.other * 1e3
    return {"landmark": near.name, "miss_mm": near.miss * 1e3, "next_mm": other, "sure": near.sure}


def _near_words(near: NearestLandmark | None, *, has_axis: bool) -> str:
    from skincal.words.units import millimetres

    if near is None:
        return "it pushes at no landmark"
    beside = "" if near.other == float("inf") else f", the next at {millimetres(near.other, 0)}"
    touched = f"its axis passes {near.name} at" if has_axis else f"its tip is nearest to {near.name}, at"
    return f"{touched} {millimetres(near.miss, 0)}{beside}"


def _landmark_line(session: Session) -> str:
    places = [
        f"{mark.name} ({', '.join(f'{length * 1e3:.1f}' for length in mark.place)})" for mark in session.decisions.landmarks
    ]
    return f"landmarks, mm: {'; '.join(places)}" if places else "the scene has no landmarks; --add NAME X Y Z names one"


def _miss_words(miss: str, *, has_axis: bool) -> str:
    """Describe the distance of a poke from its landmark: of its force axis, or of the tip if that is known."""
    return f"which its axis passes at {miss}" if has_axis else f"{miss} from it"


def _row_line(row: dict[str, Any]) -> str:
    from skincal.contacts.outcome import Reason
    from skincal.words.poke_words import words_of_reason

    reason = None if row["outcome"] == "accepted" else Reason(row["outcome"])
    outcome = "accepted" if reason is None else words_of_reason(reason, row["pose"])
    pose = f", pose {row['pose']}" if row["pose"] else ""
    words = f"poke {row['poke']}, {row['start_s']:.1f} s{pose}: {outcome}"
    if row["landmark"] and row["miss_mm"] is None:
        return f"{words}; at {row['landmark']}"
    if row["landmark"]:
        passed = _miss_words(f"{row['miss_mm']:.1f} mm", has_axis=row["miss_of"] == "axis")
        return f"{words}; at {row['landmark']}, {passed}"
    near = row["nearest"]
    if reason is Reason.NO_TAXEL and near is not None:
        return f"{words}; nearest is {near['landmark']}, at {near['miss_mm']:.0f} mm"
    return words
