"""Decisions of the operator in a session as one frozen value, and the effect of each action on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from skincal.contacts.outcome import Contact, Outcome
from skincal.model.actions import (
    Action,
    AddLandmark,
    AskLandmark,
    AskPoke,
    AtLandmark,
    BeginClosing,
    Correct,
    DroveToLandmark,
    Exclude,
    FoundAtLandmark,
    MarkDead,
    MissedLandmark,
    Restore,
    Revive,
    SetPose,
    SetThresholds,
    SkipClosing,
    SkipLandmark,
    SkipPoke,
    Uncorrect,
    UseSkinUnit,
)
from skincal.model.errors import InputError
from skincal.model.scene import ContactSettings, Landmark, Scene, with_thresholds
from skincal.model.tables import MAX_LENGTH_M, require_plain
from skincal.rig.closing import ClosingPlace, ClosingPlaces
from skincal.rig.correction import UsedCorrection
from skincal.session.corrections import CORRECTED_THINGS, with_correction, without_correction
from skincal.session.landmark_pokes import can_be_at_landmark

MAX_ACTION_COORDINATE = 1e6
"""Largest coordinate of an action (m, or a direction): far beyond any part, and products of such numbers stay finite."""
Value = TypeVar("Value")


@dataclass(frozen=True, slots=True)
class ClosingRound:
    """One check at the end for movement of the part: its request and skips."""

    after: int
    """Number of the last poke before it began."""
    skipped: frozenset[ClosingPlace] = frozenset()
    ended: bool = False
    """The operator ended it."""


@dataclass(frozen=True, slots=True, eq=False)
class Decisions:
    """Everything that the operator decided, and what the pipeline found about landmark pokes."""

    landmarks: tuple[Landmark, ...] = ()
    """Known points of the part: those of the scene, then those that the operator added."""
    thresholds: ContactSettings = field(default_factory=ContactSettings)
    """Thresholds for pokes that begin from now on."""
    skin_response_min: float = 0.0
    """Default of `response_min` in the unit of the skin; 0 for that of the scene."""
    pose: str = ""
    """Name of the chosen arm pose; empty if the joint stream says it."""
    excluded: frozenset[int] = frozenset()
    """Numbers of the pokes that the operator took out."""
    marked: frozenset[int] = frozenset()
    """Channels that the operator marked as dead."""
    revived: frozenset[int] = frozenset()
    """Channels that stay in use although the detector found them dead."""
    landmark_of_poke: Mapping[int, str] = field(default_factory=dict[int, str])
    missed_landmarks: Mapping[int, MissedLandmark] = field(default_factory=dict[int, MissedLandmark])
    """Pokes that missed their requested landmark, by number."""
    named_by_hand: frozenset[int] = frozenset()
    """Numbers of the pokes whose landmark the operator named."""
    taken_from_landmarks: frozenset[int] = frozenset()
    """Numbers of the pokes that the operator took from their landmark, by undo too."""
    driven_to_landmarks: frozenset[int] = frozenset()
    """Numbers of the landmark pokes that a robot drove to by a pose of the part: they cannot check that pose."""
    corrections: Mapping[str, UsedCorrection] = field(default_factory=dict[str, UsedCorrection])
    """Corrections in use, by `FRAME` and `RIG`."""
    closings: tuple[ClosingRound, ...] = ()
    """The closing checks that began, the newest last."""
    skips: tuple[SkipPoke | SkipLandmark, ...] = ()

    @staticmethod
    def at_start(scene: Scene) -> Decisions:
        """Make the decisions of an empty session."""
        return Decisions(scene.landmarks, scene.contacts)

    def default_thresholds(self, scene: Scene) -> ContactSettings:
        """Return the scene's thresholds, with the default for the unit of the skin."""
        given = scene.contacts
        return replace(given, response_min=self.skin_response_min) if self.skin_response_min else given


def is_undoable(action: Action) -> bool:
    """Whether undo can revert an action. Not an automatic closing check, which would start again at once."""
    return ACTION_KINDS[type(action)].describe is not None and action != BeginClosing()


def apply_action(action: Action, now: Decisions, scene: Scene, reported: Mapping[int, Outcome]) -> Decisions:
    """Apply an action other than undo and redo to decisions.

    Parameters
    ----------
    reported : outcome of every poke as the rig reported it, by number

    Raises
    ------
    InputError
        There is no such poke, pose, landmark or channel, or its numbers make no sense.
    """
    return ACTION_KINDS[type(action)].apply(action, now, scene, reported)


def take_back(action: Action, before: Decisions, now: Decisions) -> Decisions:
    """Take an action back.

    Parameters
    ----------
    before : the decisions that it was applied to
    """
    return ACTION_KINDS[type(action)].revert(action, before, now)


def describe_action(action: Action) -> str:
    """Describe an action that can be undone, for the operator."""
    describe = ACTION_KINDS[type(action)].describe
    assert describe is not None, "undo passes over this action"
    return describe(action)


def with_excluded(now: Decisions, poke: int, *, out: bool) -> Decisions:
    """Exclude a poke from the estimates, or include it again."""
    return replace(now, excluded=now.excluded | {poke} if out else now.excluded - {poke})


def _with_poke(action: Exclude | Restore, now: Decisions, _: Scene, reported: Mapping[int, Outcome]) -> Decisions:
    poke, out = action.poke, isinstance(action, Exclude)
    if not isinstance(reported.get(poke), Contact):
        raise InputError(f"Poke {poke} is not an accepted poke of this session; expected the number of one.")
    if (poke in now.excluded) == out:
        raise InputError(f"Poke {poke} {'is already excluded' if out else 'counts already'}.")
    return with_excluded(now, poke, out=out)


def _without_poke(action: Exclude | Restore, before: Decisions, now: Decisions) -> Decisions:
    return with_excluded(now, action.poke, out=action.poke in before.excluded)


def _with_pose(action: SetPose, now: Decisions, scene: Scene, _: object) -> Decisions:
    arm = scene.arm
    known = {} if arm is None else arm.poses
    if action.name and action.name not in known:
        expected = f"one of {', '.join(known)}" if known else "none, since the scene names no poses"
        raise InputError(f"Pose {action.name!r} is not in the scene; expected {expected}.")
    return replace(now, pose=action.name)


def _with_thresholds(action: SetThresholds, now: Decisions, scene: Scene, _: object) -> Decisions:
    if len(action.names) != len(action.values) or len(set(action.names)) != len(action.names):
        numbers = f"{len(action.names)} names and {len(action.values)} values"
        raise InputError(f"Thresholds of a poke with {numbers}; expected a value each, and each name once.")
    wanted = with_thresholds(now.default_thresholds(scene), dict(zip(action.names, action.values, strict=True)))
    if wanted == now.thresholds:
        raise InputError("These thresholds of a poke are in use already.")
    return replace(now, thresholds=wanted)


def _with_channel(action: MarkDead | Revive, now: Decisions, scene: Scene, _: object) -> Decisions:
    channel, this, width = action.channel, {action.channel}, scene.skin.channels
    if not 0 <= channel < width:
        raise InputError(f"Channel {channel} does not exist; expected 0 to {width - 1}.")
    if isinstance(action, MarkDead):
        return replace(now, marked=now.marked | this, revived=now.revived - this)
    return replace(now, marked=now.marked - this, revived=now.revived | this)


def _with_landmark(action: AddLandmark, now: Decisions, *_: object) -> Decisions:
    place = np.array([action.x, action.y, action.z])
    # As in scene files. An array of names would also drop NUL characters at their ends.
    require_plain(action.name, "The name of the landmark")
    if not action.name.strip() or any(action.name == landmark.name for landmark in now.landmarks):
        raise InputError(f"A landmark cannot be named {action.name!r}; expected a name that no other one has.")
    if not np.isfinite(place).all() or np.abs(place).max() > MAX_LENGTH_M:
        raise InputError(f"The landmark {action.name!r} lies at {place.tolist()}; expected metres up to {MAX_LENGTH_M:g}.")
    return replace(now, landmarks=(*now.landmarks, Landmark(action.name, place, None)))


def _with_landmark_poke(
    action: AtLandmark | FoundAtLandmark, now: Decisions, _: Scene, reported: Mapping[int, Outcome]
) -> Decisions:
    _check_landmark(now, action.name)
    poke, by_hand = action.poke, isinstance(action, AtLandmark)
    outcome = reported.get(poke)
    if outcome is None or (action.name and not can_be_at_landmark(outcome)):
        raise InputError(f"Poke {poke} cannot be at a landmark; expected a poke that was accepted, or that no taxel answered.")
    missed = None if by_hand else now.missed_landmarks.get(poke)
    return _name_poke(now, poke, action.name, missed, by_hand=by_hand or poke in now.named_by_hand)


def _with_drive(action: DroveToLandmark, now: Decisions, *_: object) -> Decisions:
    _check_landmark(now, action.name)
    there = [poke for poke, name in now.landmark_of_poke.items() if name == action.name]
    return replace(now, driven_to_landmarks=now.driven_to_landmarks | {max(there)}) if there else now


def _without_landmark_poke(action: AtLandmark | FoundAtLandmark, before: Decisions, now: Decisions) -> Decisions:
    # Of this poke alone, and the pipeline may have found since that it missed its landmark.
    poke, missed = action.poke, now.missed_landmarks.get(action.poke)
    name = before.landmark_of_poke.get(poke) if missed is None else None
    missed = missed or before.missed_landmarks.get(poke)
    return _name_poke(now, poke, name, missed, by_hand=poke in before.named_by_hand)


def _name_poke(now: Decisions, poke: int, name: str | None, missed: MissedLandmark | None, *, by_hand: bool) -> Decisions:
    taken = now.taken_from_landmarks - {poke}
    if not name and missed is None and (poke in now.landmark_of_poke or poke in now.taken_from_landmarks):
        taken |= {poke}
    return replace(
        now,
        taken_from_landmarks=taken,
        landmark_of_poke=_with_key(now.landmark_of_poke, poke, name or None),
        missed_landmarks=_with_key(now.missed_landmarks, poke, missed),
        named_by_hand=now.named_by_hand | {poke} if by_hand else now.named_by_hand - {poke},
    )


def _with_key(of: Mapping[int, Value], poke: int, value: Value | None) -> dict[int, Value]:
    rest = {each: kept for each, kept in of.items() if each != poke}
    return rest if value is None else {**rest, poke: value}


def _check_landmark(now: Decisions, name: str) -> None:
    """Refuse the name of a landmark that does not exist; an empty name stands for none."""
    if name and all(name != landmark.name for landmark in now.landmarks):
        # In quotes: there are commas in names.
        known = ", ".join(repr(landmark.name) for landmark in now.landmarks)
        expected = f"expected one of {known}" if known else "the scene has none: add one first"
        raise InputError(f"There is no landmark {name!r}; {expected}.")


def _without_closing(_action: BeginClosing, before: Decisions, now: Decisions) -> Decisions:
    at = len(before.closings)
    return replace(now, closings=(*now.closings[:at], *now.closings[at + 1 :]))


def _new_round(reported: Mapping[int, Outcome]) -> ClosingRound:
    """Begin a closing check after the newest poke."""
    return ClosingRound(max(reported, default=0))


def _with_closing_skip(action: SkipClosing, now: Decisions, _: Scene, reported: Mapping[int, Outcome]) -> Decisions:
    if action.at and action.at not in (places.value for places in ClosingPlaces):
        expected = " or ".join(places.value for places in ClosingPlaces)
        raise InputError(f"The closing check has no places {action.at!r}; expected {expected}.")
    *before, newest = now.closings or (_new_round(reported),)
    skipped = newest.skipped | {ClosingPlace(ClosingPlaces(action.at), action.name)} if action.at else newest.skipped
    return replace(now, closings=(*before, replace(newest, skipped=skipped, ended=newest.ended or not action.at)))


def _check_numbers(action: Action, sizes: set[int], *values: Sequence[float]) -> None:
    """Refuse a place or a direction of an action with a wrong number of coordinates, or too large ones."""
    # NaN fails every comparison.
    if any(len(each) not in sizes or not all(abs(value) <= MAX_ACTION_COORDINATE for value in each) for each in values):
        expected = f"{' or '.join(map(str, sorted(sizes)))} numbers up to {MAX_ACTION_COORDINATE:g}"
        raise InputError(f"{type(action).__name__} has {[list(each) for each in values]}; expected {expected}.")


def _with_request(action: AskLandmark | AskPoke | SkipPoke | SkipLandmark, now: Decisions, *_: object) -> Decisions:
    match action:
        case AskLandmark():
            _check_landmark(now, action.name)
        case AskPoke():
            _check_numbers(action, {0, 3}, action.place, action.normal, action.push)
        case SkipPoke():
            _check_numbers(action, {3}, action.place, action.push)
        case SkipLandmark():
            _check_numbers(action, {0, 16}, action.link_from_sensor)
    return replace(now, skips=(*now.skips, action)) if isinstance(action, SkipPoke | SkipLandmark) else now


def _old_values(*names: str) -> Callable[[Any, Decisions, Decisions], Decisions]:
    """Make the function that puts back fields of the decisions that no action changes without undo."""
    return lambda _, before, now: replace(now, **{name: getattr(before, name) for name in names})


def keep_decisions(_action: Action, _before: Decisions, now: Decisions) -> Decisions:
    """Change nothing: of actions that undo passes over."""
    return now


@dataclass(frozen=True, slots=True)
class ActionKind:
    """A kind of action: all that a session knows of it."""

    apply: Callable[[Any, Decisions, Scene, Mapping[int, Outcome]], Decisions]
    """Gives the decisions after an action. Raises InputError."""
    describe: Callable[[Any], str] | None = None
    """Describes an action for undo; `None` if undo passes over it: a request of the guide, a finding of the pipeline."""
    revert: Callable[[Any, Decisions, Decisions], Decisions] = keep_decisions
    """Gives the present decisions without the action, from those before it and the present ones."""


def _with_skin_unit(action: UseSkinUnit, now: Decisions, scene: Scene, _: object) -> Decisions:
    # A scene that was changed after the recording may state it.
    if scene.states_response_min:
        return now
    thresholds = with_thresholds(now.thresholds, {"response_min": action.response_min})
    return replace(now, thresholds=thresholds, skin_response_min=action.response_min)


def _describe_landmark_poke(action: AtLandmark | FoundAtLandmark) -> str:
    return f"poke {action.poke} at {action.name or 'no landmark'}"


ACTION_KINDS: dict[type[Action], ActionKind] = {
    Exclude: ActionKind(_with_poke, lambda action: f"exclusion of poke {action.poke}", _without_poke),
    Restore: ActionKind(_with_poke, lambda action: f"return of poke {action.poke}", _without_poke),
    SetPose: ActionKind(
        _with_pose,
        lambda action: f"choice of pose {action.name}" if action.name else "choice of the streamed pose",
        _old_values("pose"),
    ),
    SetThresholds: ActionKind(
        _with_thresholds,
        lambda action: "change of thresholds" if action.names else "return to the scene's thresholds",
        _old_values("thresholds"),
    ),
    UseSkinUnit: ActionKind(_with_skin_unit),
    MarkDead: ActionKind(_with_channel, lambda action: f"mark of channel {action.channel}", _old_values("marked", "revived")),
    Revive: ActionKind(_with_channel, lambda action: f"return of channel {action.channel}", _old_values("marked", "revived")),
    AddLandmark: ActionKind(_with_landmark, lambda action: f"landmark {action.name}", _old_values("landmarks")),
    AtLandmark: ActionKind(_with_landmark_poke, _describe_landmark_poke, _without_landmark_poke),
    FoundAtLandmark: ActionKind(_with_landmark_poke, _describe_landmark_poke, _without_landmark_poke),
    MissedLandmark: ActionKind(
        lambda action, now, _scene, _reported: _name_poke(
            now, action.poke, None, action, by_hand=action.poke in now.named_by_hand
        )
    ),
    DroveToLandmark: ActionKind(_with_drive),
    AskLandmark: ActionKind(_with_request),
    AskPoke: ActionKind(_with_request),
    SkipPoke: ActionKind(_with_request),
    SkipLandmark: ActionKind(_with_request),
    BeginClosing: ActionKind(
        lambda _, now, _scene, reported: replace(now, closings=(*now.closings, _new_round(reported))),
        lambda _: "closing check",
        _without_closing,
    ),
    SkipClosing: ActionKind(_with_closing_skip),
    Correct: ActionKind(
        lambda action, now, _scene, _reported: replace(now, corrections=with_correction(now.corrections, action)),
        lambda action: f"correction of {CORRECTED_THINGS[action.of]}",
        _old_values("corrections"),
    ),
    Uncorrect: ActionKind(
        lambda action, now, _scene, _reported: replace(now, corrections=without_correction(now.corrections, action)),
        lambda action: f"end of the correction of {CORRECTED_THINGS[action.of]}",
        _old_values("corrections"),
    ),
}
"""Every kind of action but undo and redo. A new one is a class of `model/actions.py` and a row here."""
