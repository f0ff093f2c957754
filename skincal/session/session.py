"""What is known of one calibration: pokes, what the operator decided, and the estimates that follow.

The contacts are the truth. Estimates are a cache of them: a taxel is solved from the kept contacts in the order of their
numbers, and nothing else, so that taking a poke out and in again gives the same numbers to the last bit.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from skincal import __version__
from skincal.contacts.outcome import Contact, Outcome, Progress
from skincal.geometry import FloatArray, IntArray
from skincal.journal.documents import WallClock
from skincal.model.actions import (
    Action,
    AddLandmark,
    AskLandmark,
    AskPoke,
    AtLandmark,
    BeginClosing,
    Correct,
    Exclude,
    FoundAtLandmark,
    MarkDead,
    MissedLandmark,
    Redo,
    Restore,
    Revive,
    SetPose,
    SetThresholds,
    SkipClosing,
    SkipLandmark,
    SkipPoke,
    Uncorrect,
    Undo,
)
from skincal.model.errors import InputError
from skincal.model.scene import ContactSettings, Landmark, Scene, with_thresholds
from skincal.rig.closing import ClosingPlace, ClosingPlaces
from skincal.rig.correction import RIG, Correction, CorrectionErrors, UsedCorrection
from skincal.rig.correction_fit import LandmarkPoke, RigRequest
from skincal.session.corrections import Corrections
from skincal.session.landmark_pokes import LandmarkTries, SessionLandmarks
from skincal.session.snapshot import ClosingRound, PokeRecord, Snapshot
from skincal.session.solving import Solving
from skincal.session.undo import Entry, History, Step
from skincal.taxels.result import Method
from skincal.taxels.shared_errors import SharedRows

if TYPE_CHECKING:
    from skincal.files.calibration import Calibration
    from skincal.mesh.surface import Surface
    from skincal.taxels.contact_table import Evidence

MARKED = "marked by the operator"
"""Reason of a channel that the operator left out."""

NUMBER_MOST = 1e6
"""Of places (m), directions and poses in actions: far beyond any, and products of them are numbers."""
NOTES = (AskLandmark, AskPoke, MissedLandmark, SkipClosing, SkipLandmark, SkipPoke)
"""Actions that say what was asked for, or found: no steps of the operator's, so that undo passes them over."""


class Session:
    """Pokes and decisions, and the estimates of every method that the scene has.

    Parameters
    ----------
    surface : the scene's mesh; None leaves out the surface method, and modules lie free in space
    methods : those that are solved; None for all that the scene has
    """

    asked: AskPoke | None = None
    """The poke on the skin that the operator is asked for; None before anything was."""
    _clocks: tuple[tuple[int, WallClock | None], ...] = ()
    _closings: tuple[ClosingRound, ...] = ()
    _skips: tuple[SkipPoke | SkipLandmark, ...] = ()
    _assumed: Correction | None = None
    _generation = 0
    _last: Snapshot | None = None
    _snapshot: Snapshot | None = None
    """The last one, where nothing changed since; else None."""

    def __init__(self, scene: Scene, surface: Surface | None, methods: Collection[Method] | None = None) -> None:
        self.scene = scene
        self.surface = surface
        self._solving = Solving(scene, surface, methods)
        self.methods = self._solving.methods
        self.module_model = self._solving.module_model
        """The modules; None where their method is not solved."""
        self.pose = ""
        """Name of the chosen arm pose; empty where none was chosen: the joint stream says it, if there is one."""
        self.thresholds = scene.contacts
        """Those by which pokes that begin now are judged."""
        # In the order of their numbers, so that a snapshot copies them and makes nothing anew.
        self._records: dict[int, PokeRecord] = {}
        self._corrections = Corrections(self._correct_all)
        self._excluded, self._marked, self._revived = set[int](), set[int](), set[int]()
        self.found_dead: Mapping[int, str] = {}
        """Channels that the detector found to be dead, whatever the operator thinks of them."""
        self._known = SessionLandmarks(scene.landmarks)
        self._history = History(self._excluded.__contains__, self._set_excluded, self._done)
        self._answers: Counter[int] = Counter()
        """How many contacts that count each channel answered in."""
        layout = scene.skin.layout
        self._layout = None if layout is None else tuple(int(channel) for channel in layout.channels)
        self._solving.taxels_changed(self.channels)
        self._touched: IntArray = np.empty(0, dtype=np.int64)
        self._current_pose: tuple[str, FloatArray | None] = (self.pose, None)

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """The contacts that count, as they are corrected: accepted and not excluded, in the order of their numbers."""
        return tuple(self._kept(self._records))

    @property
    def excluded(self) -> tuple[int, ...]:
        """Numbers of the pokes that the operator took out."""
        return tuple(sorted(self._excluded))

    @property
    def channels(self) -> tuple[int, ...]:
        """The taxels: those of the layout, or without one those that answered in a contact that counts."""
        if self._layout is not None:
            return self._layout
        return tuple(sorted(channel for channel, count in self._answers.items() if count))

    @property
    def last_poke(self) -> int:
        """Number of the last poke, whatever it ended as; 0 before the first."""
        return next(reversed(self._records), 0)

    @property
    def dead(self) -> dict[int, str]:
        """Channels that are not used, with the reason."""
        dead = {channel: why for channel, why in self.found_dead.items() if channel not in self._revived}
        dead |= dict.fromkeys(self._marked, MARKED)
        return {channel: dead[channel] for channel in sorted(dead)}

    @property
    def landmarks(self) -> tuple[Landmark, ...]:
        """Known points of the part: those of the scene, then those that the operator added."""
        return self._known.landmarks

    @property
    def landmark_pokes(self) -> tuple[LandmarkPoke, ...]:
        """The pokes that were at a landmark and count, in the order of their numbers, in the right frame."""
        return self._known.pokes(self.framed().values())

    def landmark_tries(self, new: Collection[int]) -> LandmarkTries:
        """Return how pokes passed the landmarks that were asked for, those of `new` numbers in the right frame."""
        framed = self._corrections.framed
        return LandmarkTries([framed[poke] for poke in new], self.landmark_pokes, self._known.missed, self._known.by_hand)

    @property
    def shared_errors(self) -> SharedRows | None:
        """What the correction of the rig that is in use does not know; None without one, or where that was not recorded."""
        return self._solving.shared

    @property
    def at_landmarks(self) -> Mapping[int, str]:
        """The number of each poke that was at a landmark, and the landmark's name."""
        return self._known.named(self.outcome)

    @property
    def can_undo(self) -> str:
        """What undo would take back, in words; empty where there is nothing."""
        return self._history.can_undo

    @property
    def closings(self) -> tuple[ClosingRound, ...]:
        """The closing checks that began, the newest last."""
        return self._closings

    @property
    def history(self) -> tuple[Entry, ...]:
        """What can be taken back, the newest last."""
        return self._history.entries

    @property
    def corrections(self) -> Mapping[str, UsedCorrection]:
        """The corrections in use, by what they are of."""
        return self._corrections.used

    def rig_request(self) -> RigRequest:
        """Return what a correction of the rig is worked out from."""
        contacts = [outcome for outcome in self.framed().values() if isinstance(outcome, Contact)]
        return RigRequest(self.scene, self.surface, contacts, self.landmark_pokes, self.dead)

    def framed(self) -> dict[int, Outcome]:
        """Return the pokes that were not taken out, in the right frame, without what corrects the rig, by their number.

        What did not change is the same object as in the last answer.
        """
        return {poke: self._corrections.framed[poke] for poke, record in self._records.items() if not record.excluded}

    def corrected_progress(self, progress: Progress, link_from_sensor: FloatArray | None, pose: str) -> Progress:
        """Return a poke in progress as the corrections in use have it; see `Corrections.of_progress`."""
        force, point = self._corrections.of_progress(progress, link_from_sensor, pose)
        return progress if force is progress.force else replace(progress, force=force, axis_point=point)

    def add(self, outcome: Outcome) -> None:
        """Take a poke's outcome, in place of an earlier one with its number."""
        before = self._records.get(outcome.poke)
        was, now = before is not None and isinstance(before.outcome, Contact), isinstance(outcome, Contact)
        asked = self.asked if before is None else before.asked
        self._put(PokeRecord(self._corrections.take(outcome), outcome.poke in self._excluded, asked))
        # What comes next can make a rejection of an accepted poke, which is then no step of the operator's any more.
        if now and not was:
            self._history.add_poke(outcome.poke)
        if was and not now:
            self._history.forget_poke(outcome.poke)

    def set_clock(self, clock: WallClock | None) -> None:
        """Take the clock by which pokes and actions from now on are dated; None where nobody knows it."""
        self._clocks = (*self._clocks, (self.last_poke, clock))

    def settle(self) -> None:
        """Make every outcome final as it stands: what could have changed it will not come."""
        for outcome in [outcome for outcome in self._corrections.reported.values() if not outcome.final]:
            self.add(replace(outcome, final=True))

    def outcome(self, poke: int) -> Outcome | None:
        """Return how a poke ended, as the rig reported it; None where there is no such poke."""
        return self._corrections.reported.get(poke)

    def set_detected_dead(self, found: Mapping[int, str]) -> None:
        """Take the channels that the detector found to be dead, in place of those before."""
        if found is self.found_dead or dict(found) == dict(self.found_dead):
            return
        before = self.dead
        self.found_dead = dict(found)
        now = self.dead
        known = before.keys() | now.keys()
        self._solving.taxels_changed(channel for channel in known if before.get(channel) != now.get(channel))
        self._changed()

    def set_current_pose(self, name: str, link_from_sensor: FloatArray | None) -> None:
        """Take the arm pose that holds now, chosen or streamed; it is shown and nothing else."""
        before_name, before = self._current_pose
        if name == before_name and link_from_sensor is before:
            return
        same = before is not None and link_from_sensor is not None and np.array_equal(before, link_from_sensor)
        self._current_pose = name, link_from_sensor
        if name != before_name or not same:
            self._changed()

    def act(self, action: Action, at_s: float = math.nan) -> None:
        """Do what the operator wants.

        Parameters
        ----------
        at_s : host's monotonic clock, seconds, for the history

        Raises
        ------
        InputError
            There is no such poke, pose, landmark or channel, or nothing to undo or redo; the session is as it was.
        """
        # A closing check that the operator wants is a step; one that began by itself would begin again once taken back.
        if isinstance(action, NOTES) or action == BeginClosing():
            self._take_note(action)
            return
        if isinstance(action, Undo):
            if not self._history.undo():
                raise InputError("There is nothing to undo: no poke was accepted and nothing was changed.")
        elif isinstance(action, Redo):
            if not self._history.redo():
                raise InputError("There is nothing to redo: nothing was taken back, or something else was done since.")
        else:
            self._history.do(action, self._wall_s(at_s), found=isinstance(action, FoundAtLandmark))
        self._changed()

    def _wall_s(self, at_s: float) -> float:
        clock = self._clocks[-1][1] if self._clocks else None
        return math.nan if clock is None else clock.at(at_s)

    def _take_note(self, action: Action) -> None:
        """Take what was asked for, or found as an outcome is: it is no step of the operator's, and is not taken back."""
        if isinstance(action, AskLandmark):
            # It changes nothing of what is known.
            self._known.check_name(action.name)
            return
        if isinstance(action, AskPoke):
            # Nor does this, before there is a poke.
            _check_numbers(action, {0, 3}, action.place, action.normal, action.push)
            self.asked = action
            return
        if isinstance(action, MissedLandmark):
            self._known.miss(action)
        elif isinstance(action, SkipPoke | SkipLandmark):
            self._skip(action)
        elif isinstance(action, SkipClosing):
            self._skip_closing(action)
        else:
            self._begin_closing()
        self._changed()

    def _skip(self, action: SkipPoke | SkipLandmark) -> None:
        if isinstance(action, SkipPoke):
            _check_numbers(action, {3}, action.place, action.push)
        else:
            _check_numbers(action, {0, 16}, action.link_from_sensor)
        self._skips = (*self._skips, action)

    def _begin_closing(self) -> Step:
        at = len(self._closings)
        self._closings = (*self._closings, ClosingRound(self.last_poke))

        def take_back() -> None:
            self._closings = (*self._closings[:at], *self._closings[at + 1 :])

        return Step("closing check", take_back)

    def _skip_closing(self, action: SkipClosing) -> None:
        if action.at and action.at not in (places.value for places in ClosingPlaces):
            expected = " or ".join(places.value for places in ClosingPlaces)
            raise InputError(f"The closing check has no places {action.at!r}; expected {expected}.")
        if not self._closings:
            self._begin_closing()
        *before, now = self._closings
        skipped = now.skipped | {ClosingPlace(ClosingPlaces(action.at), action.name)} if action.at else now.skipped
        self._closings = (*before, replace(now, skipped=skipped, ended=now.ended or not action.at))

    def _done(self, action: Action) -> Step:
        """Do an action; return how it is taken back."""
        match action:
            case Exclude() | Restore():
                return self._choose_poke(action)
            case SetPose():
                return self._choose_pose(action.name)
            case AddLandmark() | AtLandmark() | FoundAtLandmark():
                added = isinstance(action, AddLandmark)
                return self._known.add(action) if added else self._known.put(action, self.outcome(action.poke))
            case Correct() | Uncorrect():
                return self._corrections.act(action)
            case MarkDead() | Revive():
                return self._choose_channel(action)
            case SetThresholds():
                return self._choose_thresholds(action)
            case BeginClosing():
                return self._begin_closing()
            case _:
                raise TypeError(action)

    @property
    def unsolved(self) -> int:
        """How many taxels are to be solved before there is a new snapshot."""
        return self._solving.waiting

    def snapshot(self, within_s: float = math.inf) -> Snapshot:
        """Return everything a view may show; the same object until something changes. Taxels that changed are solved.

        Parameters
        ----------
        within_s : s. Solving pauses after so long, or little later, and goes on with the next call; meanwhile the last
            snapshot is returned. The estimates are the same, to the bit. There must be a first one: that takes its time.
        """
        if self._snapshot is not None:
            return self._snapshot
        channels = self.channels
        self._solving.solve(channels, self._records.keys(), self._kept, self.dead, math.inf if self._last is None else within_s)
        if self.unsolved and self._last is not None:
            return self._last
        fresh = self._solving.take_fresh()
        # The first snapshot solves every taxel, which is no poke's doing: a session that is opened again shows none as new.
        if len(fresh) and self._generation:
            self._touched = fresh
        self._last = self._snapshot = Snapshot(
            generation=self._generation,
            pokes=tuple(self._records.values()),
            estimates=self._solving.estimates(channels),
            touched=self._touched,
            pose=self._current_pose[0],
            link_from_sensor=self._current_pose[1],
            dead=self.dead,
            can_undo=self.can_undo,
            can_redo=self._history.can_redo,
            history=self._history.entries,
            undone=self._history.undone,
            deed=self._history.deed,
            landmarks=self.landmarks,
            at_landmarks=self.at_landmarks,
            missed_landmarks=self._known.missed,
            corrections=self.corrections,
            thresholds=self.thresholds,
            closings=self._closings,
            distances=self._solving.tried_distances,
            skips=self._skips,
            clocks=self._clocks,
        )
        return self._snapshot

    def evidence(self, channels: Collection[int]) -> Evidence:
        """Return what the contacts of the last snapshot say of those of `channels` that answered; all of them count fully."""
        return self._solving.evidence(channels)

    def calibration(self) -> Calibration:
        """Return what the calibration files are written from."""
        from skincal.files.calibration import Calibration
        from skincal.session.closing_pokes import closings_of

        snapshot = self.snapshot()
        estimates = snapshot.estimates
        outcomes = [self._corrections.reported[poke] for poke in self._records]
        return Calibration(
            scene=replace(self.scene, contacts=self.thresholds),
            channels=self.channels,
            estimates=estimates,
            contacts=tuple(outcome for outcome in outcomes if isinstance(outcome, Contact)),
            mesh_sha256=None if self.surface is None else self.surface.sha256,
            version=__version__,
            excluded=self.excluded,
            dead=self.dead,
            corrections=tuple(self.corrections.values()),
            landmark_pokes=self._known.pokes(outcomes),
            closings=closings_of(snapshot, self.scene.noise),
        )

    def _kept(self, pokes: Iterable[int]) -> list[Contact]:
        """Return those of `pokes` that count, in the order of their numbers."""
        records = (self._records[poke] for poke in sorted(pokes))
        return [record.outcome for record in records if isinstance(record.outcome, Contact) and not record.excluded]

    def _correct_all(self) -> None:
        """Correct every poke anew, from what the rig reported."""
        for poke, record in self._records.items():
            outcome = self._corrections.corrected(poke)
            # A value under a key that is there may be changed while the items are walked.
            self._records[poke] = replace(record, outcome=outcome)
            if isinstance(outcome, Contact):
                self._solving.poke_changed(poke, ())
        used = self.corrections.get(RIG)
        self._share_errors(None if used is None else used.correction)

    def assume_corrected(self, correction: Correction | None) -> None:
        """Take all contacts as corrected already: estimates carry the uncertainty of `correction`."""
        if correction is not self._assumed:
            self._assumed = correction
            self._share_errors(correction)
            self._changed()

    def _share_errors(self, correction: Correction | None) -> None:
        self._solving.shared = None
        if correction is not None and not correction.exact:
            self._solving.shared = CorrectionErrors(correction, self._contact)
        self._solving.taxels_changed(self.channels)

    def _contact(self, poke: int) -> Contact:
        outcome = self._records[poke].outcome
        assert isinstance(outcome, Contact)
        return outcome

    def _put(self, record: PokeRecord) -> None:
        """Take a poke as it stands now, in place of what it was."""
        poke = record.outcome.poke
        before, late = self._records.get(poke), poke < self.last_poke
        self._records[poke] = record
        if before is None and late:
            self._records = dict(sorted(self._records.items()))
        if before is not None:
            self._count(before, -1)
        self._count(record, 1)
        self._changed()

    def _count(self, record: PokeRecord, by: int) -> None:
        """Take the taxels of a poke up or down, and mark them as dirty."""
        outcome = record.outcome
        if isinstance(outcome, Contact):
            channels = outcome.channels.tolist()
            self._solving.poke_changed(outcome.poke, channels)
            if not record.excluded:
                for channel in channels:
                    self._answers[channel] += by

    def _changed(self) -> None:
        # What changes between two snapshots is one generation: nobody saw it apart.
        if self._snapshot is not None:
            self._generation += 1
            self._snapshot = None

    def _choose_poke(self, action: Exclude | Restore) -> Step:
        poke, out = action.poke, isinstance(action, Exclude)
        if not isinstance(self.outcome(poke), Contact):
            raise InputError(f"Poke {poke} is not an accepted poke of this session; expected the number of one.")
        if (poke in self._excluded) == out:
            raise InputError(f"Poke {poke} {'is already excluded' if out else 'counts already'}.")
        self._set_excluded(poke, out)
        words = f"exclusion of poke {poke}" if out else f"return of poke {poke}"
        return Step(words, lambda: self._set_excluded(poke, not out))

    def _set_excluded(self, poke: int, out: bool) -> None:
        (self._excluded.add if out else self._excluded.discard)(poke)
        self._put(replace(self._records[poke], excluded=out))

    def _choose_pose(self, name: str) -> Step:
        known = {} if self.scene.arm is None else self.scene.arm.poses
        if name and name not in known:
            expected = f"one of {', '.join(known)}" if known else "none, since the scene names no poses"
            raise InputError(f"Pose {name!r} is not in the scene; expected {expected}.")
        before, self.pose = self.pose, name

        def take_back() -> None:
            self.pose = before

        return Step(f"choice of pose {name}" if name else "choice of the streamed pose", take_back)

    def _choose_thresholds(self, action: SetThresholds) -> Step:
        if len(action.names) != len(action.values) or len(set(action.names)) != len(action.names):
            numbers = f"{len(action.names)} names and {len(action.values)} values"
            raise InputError(f"Thresholds of a poke with {numbers}; expected a value each, and each name once.")
        before = self.thresholds
        wanted = with_thresholds(self.scene.contacts, dict(zip(action.names, action.values, strict=True)))
        if wanted == before:
            raise InputError("These thresholds of a poke are in use already.")

        def put(thresholds: ContactSettings) -> None:
            self.thresholds = thresholds

        put(wanted)
        return Step("change of thresholds" if action.names else "return to the scene's thresholds", lambda: put(before))

    def _choose_channel(self, action: MarkDead | Revive) -> Step:
        channel, mark = action.channel, isinstance(action, MarkDead)
        if not 0 <= channel < self.scene.skin.channels:
            raise InputError(f"Channel {channel} does not exist; expected 0 to {self.scene.skin.channels - 1}.")

        def put(marked: set[int], revived: set[int]) -> None:
            self._marked, self._revived = marked, revived
            self._solving.taxels_changed([channel])

        # New sets, none changed in place: the step keeps those before to put them back.
        marked, revived, this = self._marked, self._revived, {channel}
        put(marked | this if mark else marked - this, revived - this if mark else revived | this)
        words = f"mark of channel {channel}" if mark else f"return of channel {channel}"
        return Step(words, lambda: put(marked, revived))


def _check_numbers(action: Action, sizes: Collection[int], *values: Sequence[float]) -> None:
    """Raise InputError where a place or a direction of an action has another number of coordinates, or larger ones."""
    # NaN fails every comparison.
    if any(len(each) not in sizes or not all(abs(value) <= NUMBER_MOST for value in each) for each in values):
        expected = f"{' or '.join(map(str, sorted(sizes)))} numbers up to {NUMBER_MOST:g}"
        raise InputError(f"{type(action).__name__} has {[list(each) for each in values]}; expected {expected}.")
