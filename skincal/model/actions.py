"""What an operator does to a session, as values that go to the journal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, fields
from typing import Any, TypeAlias, cast

from skincal.model.errors import InputError
from skincal.model.tables import shown


@dataclass(frozen=True, slots=True)
class Exclude:
    """Take a poke out of the estimates; it stays in the session."""

    poke: int


@dataclass(frozen=True, slots=True)
class Restore:
    """Take an excluded poke in again."""

    poke: int


@dataclass(frozen=True, slots=True)
class Undo:
    """Take back the last action, or exclude the last accepted poke, whichever came later."""


@dataclass(frozen=True, slots=True)
class Redo:
    """Bring again what undo took back last."""


@dataclass(frozen=True, slots=True)
class SetPose:
    """Choose the arm pose by its name in the scene; an empty name leaves it to the joint stream."""

    name: str


@dataclass(frozen=True, slots=True)
class MarkDead:
    """Leave a channel out: the operator knows that it is dead."""

    channel: int


@dataclass(frozen=True, slots=True)
class Revive:
    """Use a channel again that was marked or found to be dead; it is not found dead again."""

    channel: int


@dataclass(frozen=True, slots=True)
class AddLandmark:
    """Name a point of the part that is known, beside those of the scene: picked on the surface, say."""

    name: str
    x: float
    y: float
    z: float
    """m, link frame."""


@dataclass(frozen=True, slots=True)
class AtLandmark:
    """Say at which landmark a poke was; an empty name takes it back. No taxel need have answered."""

    poke: int
    name: str


@dataclass(frozen=True, slots=True)
class FoundAtLandmark:
    """The pipeline found that a poke was at the landmark that was asked for; see `skincal.session.pipeline`.

    It follows from the bytes and from `AskLandmark`, so a session that is played again from its bytes finds it anew.
    """

    poke: int
    name: str


@dataclass(frozen=True, slots=True)
class MissedLandmark:
    """The pipeline found that a poke which a landmark was asked for passed it too far to have been there.

    It follows from the bytes and from `AskLandmark` as `FoundAtLandmark` does. It takes the poke from a landmark that it was
    found to be at; it is no step that undo takes back.
    """

    poke: int
    name: str
    miss: float
    """m, how far its axis passes the landmark..."""
    limit: float
    """m, ...and how far it may."""
    behind: bool = False
    """It pushed from another side of the part than the one on which the landmark is, however near its axis passes."""


@dataclass(frozen=True, slots=True)
class AskLandmark:
    """Ask the operator for pokes at a landmark from now on; an empty name asks for none."""

    name: str


@dataclass(frozen=True, slots=True)
class AskPoke:
    """Ask the operator for this poke on the skin from now on; without a place, for none. SI units, link frame."""

    channel: int
    """-1 for a place where a taxel may be."""
    place: tuple[float, ...]
    normal: tuple[float, ...]
    push: tuple[float, ...]
    """Three each, or none."""


@dataclass(frozen=True, slots=True)
class SkipPoke:
    """Ask for another poke on the skin than this: a side of a taxel that is skipped twice is left out, a place at once."""

    method: str
    """A value of `Method`: whose guide asked for it."""
    channel: int
    """As in `AskPoke`."""
    place: tuple[float, ...]
    push: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class SkipLandmark:
    """Ask for a landmark no more in an arm pose; an empty name means all of them."""

    name: str
    pose: str
    link_from_sensor: tuple[float, ...]
    """16, row by row; none where it is unknown."""


@dataclass(frozen=True, slots=True)
class BeginClosing:
    """Ask for some of the first places once more: pokes from now on show whether anything moved (`skincal.rig.closing`)."""

    wanted: bool = False
    """The operator wants it, who can take that back; else it began by itself."""


@dataclass(frozen=True, slots=True)
class SkipClosing:
    """Ask for a place of the closing check no more, or end the check."""

    at: str
    """A value of `ClosingPlaces`; empty to end it."""
    name: str


@dataclass(frozen=True, slots=True)
class SetThresholds:
    """Judge pokes that begin from now on by these thresholds in place of the scene's; all others are the scene's."""

    names: tuple[str, ...] = ()
    """Fields of `ContactSettings`..."""
    values: tuple[float, ...] = ()
    """...and their values, SI units."""


@dataclass(frozen=True, slots=True)
class Correct:
    """Use a correction of what the rig reports, in place of one of its kind; the numbers travel with it, SI units."""

    of: str
    """`FRAME` or `RIG` of `skincal.rig.correction`, where the rest is described, too."""
    matrix: tuple[float, ...]
    """36, row by row."""
    everywhere: tuple[float, ...]
    """16, row by row."""
    poses: tuple[str, ...]
    """Names of the arm poses that are moved."""
    motions: tuple[float, ...]
    """16 a pose, row by row."""
    before: float
    after: float
    """m."""
    pokes: int
    spread: tuple[float, ...] = ()
    """Upper triangle of `Correction.root`, row by row; empty of one that is taken for exact, as in sessions of old."""
    quadratic: tuple[float, ...] = ()
    """126, row by row; empty of a sensor that is taken for linear."""
    ratio: float = 0.0
    """0 where nobody knows it."""
    noisier: float = 1.0
    """As in `UsedCorrection`; 1 in sessions of old, which do not say."""


@dataclass(frozen=True, slots=True)
class Uncorrect:
    """Use the correction of that kind no more."""

    of: str


Action: TypeAlias = (
    Exclude
    | Restore
    | Undo
    | Redo
    | SetPose
    | MarkDead
    | Revive
    | AddLandmark
    | AtLandmark
    | FoundAtLandmark
    | MissedLandmark
    | AskLandmark
    | AskPoke
    | SkipPoke
    | SkipLandmark
    | BeginClosing
    | SetThresholds
    | SkipClosing
    | Correct
    | Uncorrect
)


@dataclass(frozen=True, slots=True)
class Stamped:
    """An action with the host's monotonic clock at which it was done, nanoseconds."""

    host_ns: int
    action: Action


_KINDS: dict[str, type[Action]] = {
    "exclude": Exclude,
    "restore": Restore,
    "undo": Undo,
    "redo": Redo,
    "set_pose": SetPose,
    "mark_dead": MarkDead,
    "revive": Revive,
    "add_landmark": AddLandmark,
    "at_landmark": AtLandmark,
    "found_at_landmark": FoundAtLandmark,
    "missed_landmark": MissedLandmark,
    "ask_landmark": AskLandmark,
    "ask_poke": AskPoke,
    "skip_poke": SkipPoke,
    "skip_landmark": SkipLandmark,
    "begin_closing": BeginClosing,
    "set_thresholds": SetThresholds,
    "skip_closing": SkipClosing,
    "correct": Correct,
    "uncorrect": Uncorrect,
}
_TYPES = {"str": str, "int": int, "float": float, "bool": bool}
_LISTS = {f"tuple[{name}, ...]": kind for name, kind in _TYPES.items()}
_NAMES = {kind: name for name, kind in _KINDS.items()}


def to_json(action: Action) -> dict[str, Any]:
    """Return an action as a JSON object: `do`, and its fields."""
    return {"do": _NAMES[type(action)], **asdict(action)}


def from_json(document: Mapping[str, Any]) -> Action:
    """Return the action of a JSON object.

    Raises InputError: it is not one that this version knows.
    """
    kind = _KINDS.get(str(document.get("do")))
    if kind is None:
        raise InputError(f"action {document.get('do')!r}: expected one of {', '.join(_KINDS)}; a newer skincal may know it.")
    values = {key: _frozen(value) for key, value in document.items() if key != "do"}
    # Types as they are written: in this module annotations stay text.
    wanted = {item.name: str(item.type) for item in fields(kind)}
    # What was added to an action since has a default: sessions of old lack it.
    values = {item.name: item.default for item in fields(kind) if item.default is not MISSING} | values
    wrong = [key for key in wanted | values if not _is(values.get(key), wanted.get(key, ""))]
    if wrong:
        found = shown({key: values[key] for key in wrong if key in values})
        expected = ", ".join(f"{key} ({wanted[key]})" for key in wrong if key in wanted) or "no such value"
        raise InputError(f"action {document['do']!r} has {found}; expected {expected}.")
    return kind(**values)


def _frozen(value: Any) -> Any:
    """Return a JSON list as a tuple."""
    return tuple(cast("list[Any]", value)) if isinstance(value, list) else value


def _is(value: object, type_: str) -> bool:
    """Return whether a value is of a field's type, as its annotation has it."""
    if isinstance(value, tuple):
        return type_ in _LISTS and all(type(each) is _LISTS[type_] for each in cast("tuple[object, ...]", value))
    # The very type, since true and false are whole numbers to Python.
    return type(value) is _TYPES.get(type_)
