"""Actions of the operator on a session, as values that the journal stores."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, TypeAlias, get_args

from skincal.model.codec import PARSE_ERRORS, from_json
from skincal.model.errors import InputError
from skincal.model.tables import quoted


@dataclass(frozen=True, slots=True)
class Exclude:
    """Leave a poke out of the estimates; it stays in the session."""

    poke: int


@dataclass(frozen=True, slots=True)
class Restore:
    """Use an excluded poke again."""

    poke: int


@dataclass(frozen=True, slots=True)
class Undo:
    """Undo the last action, or exclude the last accepted poke, the later of both."""


@dataclass(frozen=True, slots=True)
class Redo:
    """Redo the last undone action."""


@dataclass(frozen=True, slots=True)
class SetPose:
    """Choose the arm pose by its name in the scene; an empty name means the joint stream."""

    name: str


@dataclass(frozen=True, slots=True)
class MarkDead:
    """Ignore a channel that the operator knows to be dead."""

    channel: int


@dataclass(frozen=True, slots=True)
class Revive:
    """Use a dead channel again; it is not found dead a second time."""

    channel: int


@dataclass(frozen=True, slots=True)
class AddLandmark:
    """Add a known point of the part to those of the scene, for example picked on the surface."""

    name: str
    x: float
    y: float
    z: float
    """m, link frame."""


@dataclass(frozen=True, slots=True)
class AtLandmark:
    """Assign a poke to a landmark; an empty name removes the assignment. No taxel needs to answer."""

    poke: int
    name: str


@dataclass(frozen=True, slots=True)
class FoundAtLandmark:
    """The pipeline found a poke at the requested landmark; see `skincal.session.pipeline`.

    It follows from the bytes and from `AskLandmark`, so a replay finds it again.
    """

    poke: int
    name: str


@dataclass(frozen=True, slots=True)
class MissedLandmark:
    """The pipeline found that the axis of a poke passes the requested landmark too far away.

    It follows from the bytes and from `AskLandmark` as `FoundAtLandmark` does. It removes an earlier assignment of the
    poke, and cannot be undone.
    """

    poke: int
    name: str
    miss: float
    """m, distance of its axis from the landmark."""
    limit: float
    """m, largest accepted distance."""
    behind: bool = False
    """It pushed from another side of the part than the one with the landmark, at any distance."""


@dataclass(frozen=True, slots=True)
class DroveToLandmark:
    """A robot drove to the landmark by a pose of the part, and no hand guided it: the newest poke there is meant."""

    name: str


@dataclass(frozen=True, slots=True)
class AskLandmark:
    """Request pokes at a landmark from now on; an empty name requests none."""

    name: str


@dataclass(frozen=True, slots=True)
class AskPoke:
    """Request this poke on the skin from now on; without a position, none. SI units, link frame."""

    channel: int
    """-1 for a position where a taxel may be."""
    place: tuple[float, ...]
    normal: tuple[float, ...]
    push: tuple[float, ...]
    """Three each, or none."""


@dataclass(frozen=True, slots=True)
class SkipPoke:
    """Skip the requested poke; the guide requests another one.

    A side of a taxel is left out after two skips, or after one with a reason; a position after one.
    """

    method: str
    """A value of `Method`: its guide requested the poke."""
    channel: int
    """As in `AskPoke`."""
    place: tuple[float, ...]
    push: tuple[float, ...]
    reason: str = ""
    """Why a robot can never do it; empty if the operator skipped it, or the robot gave no reason."""


@dataclass(frozen=True, slots=True)
class SkipLandmark:
    """Stop requesting a landmark in an arm pose; an empty name means all landmarks."""

    name: str
    pose: str
    link_from_sensor: tuple[float, ...]
    """16 numbers, row by row; empty if unknown."""


@dataclass(frozen=True, slots=True)
class BeginClosing:
    """Start the closing check: some of the first positions are poked again and show whether anything moved."""

    wanted: bool = False
    """The operator started it, and can undo that; otherwise it started automatically."""


@dataclass(frozen=True, slots=True)
class SkipClosing:
    """Stop requesting a position of the closing check, or end the check."""

    at: str
    """A value of `ClosingPlaces`; empty to end it."""
    name: str


@dataclass(frozen=True, slots=True)
class SetThresholds:
    """Replace thresholds of the scene for pokes that begin from now on; all others are the scene's."""

    names: tuple[str, ...] = ()
    """Fields of `ContactSettings`."""
    values: tuple[float, ...] = ()
    """Their values, SI units."""


@dataclass(frozen=True, slots=True)
class UseSkinUnit:
    """Use the threshold of a taxel's answer that fits the unit of the skin; of the pipeline, for a scene that states none."""

    unit: str
    """Unit that the skin's device names."""
    response_min: float
    """In that unit."""


@dataclass(frozen=True, slots=True)
class Correct:
    """Use a correction of the rig, in place of one of the same kind; SI units."""

    of: str
    """`FRAME` or `RIG` of `skincal.rig.correction`, which describes the other fields, too."""
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
    """Upper triangle of `Correction.root`, row by row; empty for an exact correction, as in older sessions."""
    quadratic: tuple[float, ...] = ()
    """126, row by row; empty for a linear sensor."""
    ratio: float = 0.0
    """0 if unknown."""
    noisier: float = 1.0
    """As in `UsedCorrection`; 1 in older sessions."""


@dataclass(frozen=True, slots=True)
class Uncorrect:
    """Stop using the correction of that kind."""

    of: str


# fmt: off
Action: TypeAlias = (
    Exclude | Restore | Undo | Redo | SetPose | MarkDead | Revive | AddLandmark | AtLandmark | FoundAtLandmark | MissedLandmark
    | AskLandmark | AskPoke | SkipPoke | SkipLandmark | BeginClosing | SetThresholds | UseSkinUnit | SkipClosing | Correct
    | Uncorrect | DroveToLandmark
)
# fmt: on


@dataclass(frozen=True, slots=True)
class TimedAction:
    """An action with its time, host's monotonic clock, nanoseconds."""

    host_ns: int
    action: Action


ACTION_NAMES: dict[str, type[Action]] = {
    re.sub("(?<!^)(?=[A-Z])", "_", kind.__name__).lower(): kind for kind in get_args(Action)
}
"""Actions by their name in a journal, such as `set_pose`: a class must keep its name."""


def action_to_json(action: Action) -> dict[str, Any]:
    """Convert an action to a JSON object: `do`, and its fields."""
    name = next(name for name, kind in ACTION_NAMES.items() if kind is type(action))
    return {"do": name, **asdict(action)}


def action_from_json(document: Mapping[str, Any]) -> Action:
    """Read the action of a JSON object.

    Raises InputError: it is not one that this version knows.
    """
    name = document.get("do")
    kind = ACTION_NAMES.get(str(name))
    if kind is None:
        raise InputError(f"action {quoted(name)}: expected one of {', '.join(ACTION_NAMES)}; a newer skincal may know it.")
    try:
        action = from_json(kind, {key: value for key, value in document.items() if key != "do"})
        json.dumps(asdict(action), allow_nan=False)
    except PARSE_ERRORS as error:
        expected = ", ".join(f"{item.name} ({item.type})" for item in fields(kind)) or "no values"
        raise InputError(f"action {name!r} does not fit ({error}); expected {expected}.") from None
    return action
