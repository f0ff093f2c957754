"""Guide of an open session: the next poke, landmarks first, the verdict, and when the modules method needs no more pokes.

Nothing here changes the session; `guided_session` records the requests.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from skincal.geometry import FloatArray
from skincal.guide.believed_positions import (
    PlannedPlaces,
    plan_from_layout,
    plan_without_positions,
    planned_sheet_pokes,
)
from skincal.guide.guidance import ClosingStep, Guidance, GuidePhase, LandmarkTarget, Target, landmark_targets, rig_error_sd
from skincal.guide.guide import MAX_SKIPS_PER_TAXEL_SIDE, Guide
from skincal.guide.predictable_pokes import PredictablePokes
from skincal.guide.progress import (
    MIN_CHECKED_POKES,
    AxisDiversity,
    ContactFacts,
    GuideSettings,
    Need,
    Why,
    count_pokes_from_start,
    find_needs,
)
from skincal.guide.robot_order import RobotPace
from skincal.guide.surroundings import Surroundings
from skincal.guide.verdict import Left, Verdict, held_out, verdict_of
from skincal.model.actions import AskPoke, BeginClosing, SkipClosing, SkipLandmark, SkipPoke
from skincal.model.scene import Landmark, NoiseSettings
from skincal.modules.pose import ModuleModel
from skincal.part.part import Part
from skincal.rig.closing import CLOSING_CHECK_MIN_PLACES, CLOSING_CHECK_PLACES, ClosingPlace, ClosingPlaces
from skincal.rig.correction import RIG
from skincal.rig.correction_fit import MIN_LANDMARKS, RigAnswer
from skincal.rig.expected_gain import (
    MAX_PREDICTED_ARM_POSES,
    Gain,
    expected_error,
    straight_pushes,
    taxel_pushes,
    unchecked_of,
)
from skincal.rig.part_agreement import agreement_at_landmarks
from skincal.rig.setup_check import frame_in_doubt
from skincal.session.arm_poses import CurrentPose
from skincal.session.closing_pokes import (
    ClosingProgress,
    ClosingRounds,
    begin_check,
    closings_of,
    first_taxels,
    is_due,
    strongest_of,
)
from skincal.session.decisions import ClosingRound
from skincal.session.landmark_pokes import landmark_normals
from skincal.session.snapshot import PokeRecord, Snapshot
from skincal.session.solving import methods_of
from skincal.taxels.result import Estimate, Method, State

if TYPE_CHECKING:
    from skincal.axes.module_axes import AxisFindings

Answer = TypeVar("Answer")
MAX_REMEMBERED_LANDMARK_ANSWERS = 4 * MAX_PREDICTED_ARM_POSES
"""Answers of the landmark guide that are kept: two for each arm pose, and as many again."""
ARM_STILL_MIN_S = 1.0
"""s. A landmark is requested once the arm has stood still for this long, not in poses that it only passes."""


class SessionGuide:
    """Chooses the next poke by the method that is shown, with or without a layout."""

    def __init__(self, part: Part) -> None:
        self._part, self._scene, self._surface = part, part.scene, part.surface
        self.plan = plan_of(part)
        self.landmarks = LandmarkGuide(part, self.plan)
        self.closing = ClosingGuide(part.scene.noise, self.landmarks)
        layout = part.scene.skin.layout
        self._module_model = None if layout is None else ModuleModel(layout, part.scene.skin.anchor, part.surface)
        self._guides: dict[Method, Guide] = {}
        """One for each method that was shown."""
        self.robot: RobotPace | None = None
        """Pace of the robot that pokes; `None` for a hand."""
        self._predictable = {
            method: PredictablePokes(self.plan.channels, method, self._scene.noise, self._surface, self._module_model)
            for method in Method
        }
        self._followed: tuple[Snapshot, Method] | None = None
        self._skin_guidance: Guidance | None = None
        """Guidance for the skin alone."""
        self._guidance: Guidance | None = None
        """Guidance that is shown."""
        self.wanted = True
        """The operator wants to be guided."""
        self.first_module_pokes = 0
        """Contacts on one module before the landmarks and the other modules: of a demonstration, which shows taxels at once."""
        self.surroundings = None if layout is None else Surroundings(layout, self.plan.channels)
        """Neighbours of the taxels; `None` without a layout."""
        self.costs = costs_of(self.plan, methods_of(part.scene, part.surface), part.scene.noise, self.surroundings)
        """Approximate pokes that each method takes until it is enough; empty if no layout places the taxels."""

    def prepare(self, method: Method) -> None:
        """Make what a method's targets need, which takes long for many taxels; `next_target` does it otherwise."""
        self._guide_of(method)

    def next_target(self, snapshot: Snapshot, pose: CurrentPose, method: Method, now_s: float) -> Guidance | None:
        """Choose the next target; `None` while guidance is off. The same snapshot and method cost nothing again.

        Parameters
        ----------
        pose : current arm pose
        now_s : host's monotonic clock, seconds, when it is seen
        """
        if not self.wanted:
            self._followed = self._guidance = None
            self.landmarks.forget()
            return None
        now = snapshot, method
        if now != self._followed:
            self._skin_guidance = self._ask(self._guide_of(method), snapshot)
            self._followed = now
        assert self._skin_guidance is not None
        if self.first_module_pokes and len(snapshot.contacts) < self.first_module_pokes:
            self._guidance = self._stay_on_module(self._skin_guidance, snapshot)
        else:
            before = self.landmarks.before_skin(self._skin_guidance, snapshot, pose, now_s)
            self._guidance = self.closing.after_skin(before, snapshot, pose[0])
        return self._guidance

    def _stay_on_module(self, guidance: Guidance, snapshot: Snapshot) -> Guidance:
        """Ask for the taxel of the last poke's module that is farthest from that poke."""
        plan = self.plan
        if not snapshot.contacts or not np.isfinite(plan.places).all():
            return guidance
        last = int(np.flatnonzero(plan.channels == snapshot.contacts[-1].strongest_channel)[0])
        distances = np.linalg.norm(plan.places - plan.places[last], axis=1)
        row = int(np.where(plan.modules == plan.modules[last], distances, -1.0).argmax())
        return replace(guidance, target=_straight(int(plan.channels[row]), plan.places[row], plan.normals[row]))

    def next_skin_target(self, snapshot: Snapshot, method: Method) -> Guidance:
        """Choose the next target on the skin, without landmarks. The question changes nothing."""
        if self._followed == (snapshot, method) and self._skin_guidance is not None:
            return self._skin_guidance
        return self._ask(self._new_guide(method, is_question=True), snapshot)

    def _ask(self, guide: Guide, snapshot: Snapshot) -> Guidance:
        """Let a guide of one method follow a snapshot, and choose the next target on the skin."""
        snapshot = snapshot.on_part
        guide.robot, method = self.robot, guide.method
        for skip in snapshot.decisions.skips[guide.session_skips :]:
            # A place without a known taxel is skipped for all methods.
            if isinstance(skip, SkipPoke) and (skip.method == method.value or skip.channel < 0):
                guide.skip(_target_of(skip, skip.push), is_impossible=bool(skip.reason))
        guide.session_skips = len(snapshot.decisions.skips)
        guidance = guide.update(
            snapshot,
            lambda poke: _asked_target(snapshot.record_of(poke)),
            rig_error_sd(snapshot.counting_landmark_pokes, self._scene.noise),
        )
        return self._with_test_poke(guide, guidance, snapshot)

    def _with_test_poke(self, guide: Guide, guidance: Guidance, snapshot: Snapshot) -> Guidance:
        """Ask for pokes that test the result, once no taxel needs any and too few others could be predicted."""
        if guidance.phase is not GuidePhase.ENOUGH or not guidance.finished:
            return guidance
        tested = self._predictable[guidance.method].count_held_out(snapshot, guide.estimate_of, MIN_CHECKED_POKES)
        missing = max(0, MIN_CHECKED_POKES - tested)
        if not missing:
            return guidance
        # Where as many held-out pokes cannot be predicted, as of a single taxel as a module, more pokes do not help.
        is_in_vain = len(held_out(snapshot.columns)[0]) - tested >= MIN_CHECKED_POKES
        target = None if is_in_vain else _test_target(guidance, snapshot)
        if target is None:
            return replace(guidance, tests_missing=missing)
        return replace(guidance, phase=GuidePhase.TEST, target=target, tests_missing=missing, pokes_left=missing)

    def remaining_work(self, snapshot: Snapshot, method: Method) -> Guidance:
        """List the remaining needs of a method, on the skin and at landmarks. This alone decides whether it is enough.

        It follows from the session alone, with its skips, and not from the time. A streamed arm counts as standing still in the
        pose of the last poke.
        """
        return self.landmarks.added(self.next_skin_target(snapshot, method), snapshot)

    def verdict(self, snapshot: Snapshot, method: Method, rig: RigAnswer | None = None) -> Verdict:
        """Judge the session by a method; `remaining_work` decides whether it is enough. The question changes nothing.

        Parameters
        ----------
        rig : fit to the landmark pokes; `None` if there was none
        """
        guidance = self.remaining_work(snapshot, method)
        estimates, noise, used = snapshot.estimates[method], self._scene.noise, snapshot.decisions.corrections.get(RIG)
        landmarks = agreement_at_landmarks(rig, used, snapshot.part_pose, snapshot.tip_frame, snapshot.driven_to_landmarks)
        verdict = verdict_of(guidance, snapshot, noise, self._surface, self._module_model, landmarks)
        pokes = snapshot.counting_landmark_pokes
        unchecked = None
        # A tip that the scene gives places the pokes alone: the sensor's errors do not move them.
        if self._scene.has_sensor and (self._scene.tool is None or self._scene.tool.tip is None):
            unchecked = unchecked_of(used, landmarks, estimates, snapshot.contacts, pokes, noise)
        left = tuple(_with_refusal(each, method, snapshot.decisions.skips) for each in verdict.left)
        doubt = frame_in_doubt(snapshot.wrench_frames, snapshot.contacts)
        closings = closings_of(snapshot, noise)
        has_arm = self._scene.arm is not None
        off_mesh = None if snapshot.off_mesh is None else snapshot.off_mesh.distance
        has_tool = self._scene.tool is not None
        verdict = replace(
            verdict, closings=closings, frame_in_doubt=doubt, has_arm=has_arm, has_tool=has_tool, off_mesh=off_mesh
        )
        part = snapshot.part_pose
        touched = None if part is None or unchecked is not None else part.landmark_places
        verdict = replace(verdict, wrong_scale=snapshot.wrong_scale, touched_landmarks=touched)
        return replace(verdict, unchecked=unchecked, left=left, axes=self._axis_findings(snapshot, method))

    def _axis_findings(self, snapshot: Snapshot, method: Method) -> AxisFindings | None:
        """Find mistakes of the axes; `None` for a skin of one axis, or before the first reading."""
        found = snapshot.axis_results(self._scene.skin.layout)
        return None if found is None or not found.turns.skin.taxels else found.findings(method)

    def axis_diversity(self, channel: int) -> AxisDiversity | None:
        """Describe the pokes of a channel; `None` while guidance is off or nothing is known. Call `next_target` before."""
        if not self.wanted or self._followed is None:
            return None
        snapshot, method = self._followed
        return self._guides[method].axis_diversity(channel, snapshot)

    def skip(self, reason: str = "") -> SkipClosing | SkipLandmark | SkipPoke | None:
        """Make the action that skips the current target; `None` without a target. `reason` as in `SkipPoke`."""
        now = self._guidance
        if now is None or now.target is None:
            return None
        if now.closing is not None:
            return SkipClosing(now.closing.place.at.value, now.closing.place.name)
        if now.landmark is not None:
            return self.landmarks.skip()
        channel = -1 if now.target.channel is None else now.target.channel
        return SkipPoke(now.method.value, channel, _numbers(now.target.place), _numbers(now.target.push), reason)

    def skip_landmarks(self) -> SkipClosing | SkipLandmark | None:
        """Make the action that skips all landmarks in this arm pose or ends the closing check; `None` if neither is active."""
        if self._guidance is not None and self._guidance.closing is not None:
            return SkipClosing("", "")
        return self.landmarks.skip(all_of_pose=True)

    def check_again(self, snapshot: Snapshot, pose: str) -> BeginClosing | None:
        """Make the action that begins another closing check; `None` if it would have no place."""
        now = self._guidance
        possible = now is not None and self.closing.begun(now, snapshot, pose) is not None
        return BeginClosing(wanted=True) if possible else None

    def _guide_of(self, method: Method) -> Guide:
        if method not in self._guides:
            self._guides[method] = self._new_guide(method)
        return self._guides[method]

    def _new_guide(self, method: Method, *, is_question: bool = False) -> Guide:
        """Make a guide of a method; the places that it pokes are marked in the part's own search, but not by a question."""
        search = self._part.cover
        if is_question and search is not None:
            search = search.unpoked()
        guide = Guide(self.plan, self._scene.noise, method, search=search, surroundings=self.surroundings)
        if self._scene.skin.axes is not None:
            from skincal.guide.turn_needs import TurnNeeds  # other skins do without

            guide.turns = TurnNeeds(self.plan.channels, guide.settings)
        return guide


def _shows_part(snapshot: Snapshot, poked: set[str]) -> bool:
    """Whether the poked landmarks are enough to show the part's pose, where no sensor needs a correction."""
    part, known = snapshot.part_pose, {landmark.name for landmark in snapshot.decisions.landmarks}
    return part is not None and part.is_known and len(poked) >= min(MIN_LANDMARKS, len(known))


class LandmarkGuide:
    """Chooses the landmark to poke before the skin. `LandmarkFinder` in the pipeline finds the pokes at it."""

    def __init__(self, part: Part, plan: PlannedPlaces) -> None:
        self._scene, self._surface = part.scene, part.surface
        there = np.isfinite(plan.places).all(axis=1)
        self._taxels, self._outward = plan.places[there], plan.normals[there]
        """(n, 3) float each, metres and unit: the taxels that the layout places."""
        self._normals: dict[bytes, FloatArray] = {}
        self._targets: list[LandmarkTarget] = []
        """Landmarks to poke in this arm pose."""
        self._pose: CurrentPose = ("", None)
        self._since_s = -np.inf
        """Host's monotonic clock, seconds, at which the arm came into this pose."""
        self._known: tuple[object, ...] = ()
        self._shown: Guidance | None = None
        self._remembered: dict[Hashable, Any] = {}
        """Answers by everything that they depend on, the oldest first."""

    def forget(self) -> None:
        """Ask for nothing while guidance is off."""
        self._targets, self._known = [], ()

    def before_skin(self, guidance: Guidance, snapshot: Snapshot, pose: CurrentPose, now_s: float) -> Guidance:
        """Put a landmark before the skin's guidance, if one is needed; `now_s` as for `SessionGuide.next_target`."""
        before, self._pose = self._pose[0], pose
        if pose[0] != before:
            # The first pose, and one that the scene names, are not on the way to another: they hold at once.
            is_named = self._scene.arm is None or pose[0] in self._scene.arm.poses
            self._since_s = now_s if before and not is_named else -np.inf
        is_still = now_s - self._since_s >= ARM_STILL_MIN_S
        known = snapshot, pose[0], is_still, guidance
        if known != self._known:
            self._known = known
            self._targets = self._plan(snapshot, pose[0]) if is_still else []
            now = self._targets[0] if self._targets else None
            self._shown = now and guidance.before_skin(now, self.normal(now.landmark), self._gain_of(snapshot))
        return self._shown or guidance

    def added(self, guidance: Guidance, snapshot: Snapshot) -> Guidance:
        """Put missing landmarks first, judged by the session alone; see `SessionGuide.remaining_work`."""
        pose = self._scene.tool.arm_pose if self._scene.tool is not None else snapshot.decisions.pose
        if not pose and self._scene.arm is not None:
            named = list(self._scene.arm.poses)
            pose = named[0] if len(named) == 1 else ""
            pose = snapshot.pokes[-1].outcome.pose if snapshot.pokes else pose
        targets = self._plan(snapshot, pose)
        return guidance.before_skin(targets[0], self.normal(targets[0].landmark), None) if targets else guidance

    def _plan(self, snapshot: Snapshot, pose: str) -> list[LandmarkTarget]:
        decisions = snapshot.decisions
        if not decisions.landmarks or (self._scene.arm is not None and not pose):
            return []
        skips = [skip for skip in decisions.skips if isinstance(skip, SkipLandmark)]
        made = snapshot.counting_landmark_pokes
        if not self._scene.has_sensor and _shows_part(snapshot, set(made.name.tolist())):
            return []
        # If the arm carries the part to each poke, no pose gets all its landmarks: those of every pose count here.
        any_pose = changes_pose_at_most_pokes(snapshot)
        of_pokes = zip(made.pose.tolist(), made.name.tolist(), strict=True)
        poked, skipped = (
            tuple((pose if any_pose else there, name) for there, name in every)
            for every in (of_pokes, ((skip.pose, skip.name) for skip in skips))
        )
        marks = decisions.landmarks
        key = "targets", tuple((mark.name, mark.place.tobytes()) for mark in marks), poked, pose, skipped
        return self._remember(key, lambda: landmark_targets(marks, poked, pose, skipped))

    def _remember(self, key: Hashable, compute: Callable[[], Answer]) -> Answer:
        """Compute an answer, or look it up: it changes with landmark pokes and arm poses, not with each poke on the skin."""
        if key not in self._remembered:
            while len(self._remembered) >= MAX_REMEMBERED_LANDMARK_ANSWERS:
                del self._remembered[next(iter(self._remembered))]
            self._remembered[key] = compute()
        return self._remembered[key]

    def _gain_of(self, snapshot: Snapshot) -> Gain | None:
        """Predict how much landmark pokes in this arm pose reduce the errors of all taxels poked so far.

        `None` with `[tool]`: there they show the part's pose, whose error the snapshot has.
        """
        name, here = self._pose
        if here is None or not len(self._taxels) or self._scene.tool is not None:
            return None
        last = snapshot.columns.last_rows_of_poses(MAX_PREDICTED_ARM_POSES)
        poses = {
            each: sensor for each, row in last.items() if (sensor := snapshot.pokes[row].outcome.link_from_sensor) is not None
        }
        poses[name] = here
        places = np.array([target.landmark.place for target in self._targets]).reshape(-1, 3)
        normals = np.array([self.normal(target.landmark) for target in self._targets]).reshape(-1, 3)
        every = snapshot.counting_landmark_pokes
        made = every[np.isin(every.pose, list(poses))]

        def predict() -> Gain:
            planned = straight_pushes(places, normals, {name: here})
            return expected_error(made, planned, taxel_pushes(self._taxels, self._outward, poses), self._scene.noise)

        arrays = places, normals, made.number, made.force, made.moment, made.link_from_sensor, made.place, here, *poses.values()
        return self._remember(("gain", name, *poses, *(array.tobytes() for array in arrays)), predict)

    def skip(self, *, all_of_pose: bool = False) -> SkipLandmark | None:
        """Make the action that skips this landmark, or all, in this arm pose; `None` without a landmark."""
        if not self._targets:
            return None
        name, (pose, sensor) = "" if all_of_pose else self._targets[0].landmark.name, self._pose
        return SkipLandmark(name, pose, () if sensor is None else _numbers(sensor))

    def normal(self, landmark: Landmark) -> FloatArray:
        """Choose the outward normal at a landmark: its own, else the surface's, else away from the skin's middle."""
        key, place = landmark.place.tobytes(), landmark.place
        if key not in self._normals:
            (found,) = landmark_normals([landmark], self._surface)
            if found is None:
                away = place - self._taxels.mean(axis=0) if len(self._taxels) else place
                size = float(np.linalg.norm(away))
                found = away / size if size > 0 else np.array([0.0, 0.0, 1.0])
            self._normals[key] = found
        return self._normals[key]


class ClosingGuide:
    """Asks to repeat three of the first places at the end: landmarks, else taxels.

    Its request follows from the session alone.
    """

    def __init__(self, noise: NoiseSettings, landmarks: LandmarkGuide) -> None:
        self._rounds, self._landmarks = ClosingRounds(noise), landmarks
        self._known: tuple[object, ...] = ()
        self._shown: Guidance | None = None

    def after_skin(self, guidance: Guidance, snapshot: Snapshot, pose: str) -> Guidance:
        """Add a place to repeat, once nothing else is needed in the arm pose of that name."""
        known = guidance, snapshot, pose
        if known != self._known:
            self._known, self._shown = known, self._closing(guidance, snapshot, pose)
        return self._shown or guidance

    def _closing(self, guidance: Guidance, snapshot: Snapshot, pose: str) -> Guidance | None:
        if guidance.phase is not GuidePhase.ENOUGH:
            return None
        rounds, asked = self._rounds.list_rounds(snapshot), None
        if rounds and not snapshot.decisions.closings[-1].ended and not rounds[-1].is_finished:
            asked = self._next(rounds, guidance, snapshot, pose)
        return self._first(rounds, guidance, snapshot, pose) if asked is None and is_due(snapshot, rounds) else asked

    def begun(self, guidance: Guidance, snapshot: Snapshot, pose: str) -> Guidance | None:
        """Add the first place of a check that begins now; `None` before it is enough, or if the check would have no place."""
        return self._first(self._rounds.list_rounds(snapshot), guidance, snapshot, pose)

    def _first(self, rounds: Sequence[ClosingProgress], guidance: Guidance, snapshot: Snapshot, pose: str) -> Guidance | None:
        """Add the first place of a check after the checks `rounds`; as `begun`."""
        if not guidance.enough:
            return None
        last = int(snapshot.columns.numbers.max(initial=0))
        return self._next([*rounds, begin_check(ClosingRound(last), rounds)], guidance, snapshot, pose)

    def _next(self, rounds: Sequence[ClosingProgress], guidance: Guidance, snapshot: Snapshot, pose: str) -> Guidance | None:
        """Add the next place of the last check; `None` if it has no more."""
        now = rounds[-1]
        for at in ClosingPlaces:
            poked, again, targets = self._places(at, guidance, snapshot, pose, now)
            names = [name for name in poked[:CLOSING_CHECK_PLACES] if name in targets]
            # A robot that drives to a landmark touches the same place again although the part has moved.
            is_driven = at is ClosingPlaces.LANDMARKS and bool(snapshot.decisions.driven_to_landmarks)
            if is_driven or len(names) < CLOSING_CHECK_MIN_PLACES:
                continue
            places = [] if now.is_complete else [ClosingPlace(at, name) for name in names if name not in again]
            place = next((place for place in places if place not in now.begun.skipped), now.repeat_place)
            if place is None or place.at is not at or place.name not in targets:
                return None
            suspect = now.found.poke if place == now.repeat_place and now.found is not None else None
            step = ClosingStep(place, len(again & set(names)), len(names), len(rounds), suspect)
            target = targets[place.name]
            marks = (each for each in snapshot.decisions.landmarks if each.name == target.landmark)
            mark = LandmarkTarget(next(marks), step.done, step.places) if target.landmark else None
            return replace(guidance, phase=GuidePhase.CLOSING, target=target, landmark=mark, closing=step)
        return None

    def _places(
        self, at: ClosingPlaces, guidance: Guidance, snapshot: Snapshot, pose: str, check: ClosingProgress
    ) -> tuple[Sequence[str], set[str], Mapping[str, Target]]:
        """List the first places of a kind that were poked in an arm pose before a check, those poked again, and all targets."""
        if at is ClosingPlaces.TAXELS:
            first, those = first_taxels(snapshot, check, pose), strongest_of(snapshot, check.pokes)
            return list(map(str, first)), set(map(str, those)), _taxel_targets(guidance, snapshot, {*first, *those})
        made, marks = snapshot.counting_landmark_pokes, snapshot.decisions.landmarks
        before = made[check.is_before(made.number)]
        targets = {mark.name: _straight(None, mark.place, self._landmarks.normal(mark), mark.name) for mark in marks}
        names = list(dict.fromkeys(before.name[before.pose == pose].tolist()))
        return names, set(made.name[np.isin(made.number, list(check.pokes))].tolist()), targets


def changes_pose_at_most_pokes(snapshot: Snapshot) -> bool:
    """Whether the arm pose changed between most pokes, as when a robot carries the part to a fixed tip."""
    poses = snapshot.columns.poses
    changes = int(np.count_nonzero(np.diff(poses)))
    return changes >= 2 and 2 * changes > len(poses) - 1


def _taxel_targets(guidance: Guidance, snapshot: Snapshot, channels: Collection[int]) -> dict[str, Target]:
    """Make a straight poke at each known one of some taxels, by its channel in words."""
    found = (snapshot.estimate_of(channel, guidance.method) for channel in channels)
    return {
        str(each.channel): _straight(each.channel, each.position, each.normal)
        for each in found
        if each is not None and each.position is not None and each.normal is not None
    }


def _test_target(guidance: Guidance, snapshot: Snapshot) -> Target | None:
    """Choose the finished taxel that was requested least; `None` if the operator or the robot skipped all of them twice."""
    targets = _taxel_targets(guidance, snapshot, set(guidance.channels.tolist()))
    skips = Counter(
        skip.channel for skip in snapshot.decisions.skips if isinstance(skip, SkipPoke) and skip.method == guidance.method.value
    )
    asked = Counter(record.asked.channel for record in snapshot.pokes if record.asked is not None)
    best: tuple[int, int] | None = None
    for channel, own, needs in zip(guidance.channels.tolist(), guidance.own.tolist(), guidance.needs, strict=True):
        if needs or str(channel) not in targets or skips[channel] >= MAX_SKIPS_PER_TAXEL_SIDE:
            continue
        key = max(own, asked[channel]) + skips[channel], channel
        best = key if best is None else min(best, key)
    return None if best is None else targets[str(best[1])]


def _straight(channel: int | None, place: FloatArray, normal: FloatArray, landmark: str = "") -> Target:
    return Target(channel, place, normal, -normal, 0.0, float("inf"), float("inf"), landmark)


def _with_refusal(left: Left, method: Method, skips: Sequence[SkipPoke | SkipLandmark]) -> Left:
    """Add the robot's last reason to a taxel that is out of reach."""
    if left.why is not Why.OUT_OF_REACH:
        return left
    own = (skip for skip in skips if isinstance(skip, SkipPoke) and (skip.method, skip.channel) == (method.value, left.channel))
    return replace(left, refusal=next((skip.reason for skip in reversed([*own]) if skip.reason), ""))


def _numbers(values: FloatArray) -> tuple[float, ...]:
    return tuple(map(float, values.ravel()))


def asked_poke(guidance: Guidance | None) -> AskPoke:
    """Make the request for a poke on the skin; an empty one for a landmark or while guidance is off."""
    target = None if guidance is None or guidance.landmark is not None else guidance.target
    if target is None:
        return AskPoke(-1, (), (), ())
    channel = -1 if target.channel is None else target.channel
    return AskPoke(channel, _numbers(target.place), _numbers(target.normal), _numbers(target.push))


def _target_of(asked: AskPoke | SkipPoke, normal: Sequence[float]) -> Target:
    """Make a target of an earlier request; for a skipped one the normal does not matter."""
    place, outward, push = (np.array(values) for values in (asked.place, normal, asked.push))
    tilt = float(np.arccos(np.clip(-(push @ outward), -1.0, 1.0)))
    channel = None if asked.channel < 0 else asked.channel
    return Target(channel, place, outward, push, tilt, float("inf"), float("inf"))


def _asked_target(record: PokeRecord | None) -> Target | None:
    asked = None if record is None else record.asked
    if asked is None or not asked.place or not asked.normal or not asked.push:
        return None
    return _target_of(asked, asked.normal)


class ModulesEnough:
    """Detects once that the modules method needs no more pokes while the shown method needs many."""

    def __init__(self, plan: PlannedPlaces, skin: float, surroundings: Surroundings | None) -> None:
        self._plan, self._skin, self._settings, self._surroundings = plan, skin, GuideSettings(), surroundings
        self._seen: Snapshot | None = None
        self._noticed = False

    def is_news(self, snapshot: Snapshot, guidance: Guidance | None, method: Method, *, streaming: bool) -> bool:
        """Whether the modules method needs no more pokes, for the first time in this session.

        Parameters
        ----------
        guidance : by the shown method; `None` while guidance is off
        streaming : the devices are read
        """
        asked = guidance is not None and not guidance.enough
        # An operator who saw it by that method knows.
        self._noticed |= method is Method.MODULES and not asked and guidance is not None
        if self._noticed or not asked or method is Method.MODULES or not streaming or snapshot is self._seen:
            return False
        self._seen = snapshot
        self._noticed = self._enough(snapshot)
        return self._noticed

    def _enough(self, snapshot: Snapshot) -> bool:
        if len(snapshot.contacts) < MIN_CHECKED_POKES:
            return False
        module_of = dict(zip(self._plan.channels.tolist(), self._plan.modules.tolist(), strict=True))
        enough = self._settings.module_pokes
        known = [estimate for estimate in snapshot.estimates.get(Method.MODULES, ()) if estimate.channel in module_of]
        if all(estimate.state is State.DEAD for estimate in known) or any(self._needs(estimate, enough) for estimate in known):
            return False
        own = Counter(module_of.get(contact.strongest_channel) for contact in snapshot.contacts)
        if any(self._needs(estimate, own[module_of[estimate.channel]]) for estimate in known):
            return False
        touched = {estimate.channel for estimate in known if estimate.contacts}
        dead = {estimate.channel for estimate in known if estimate.state is State.DEAD}
        channels = self._plan.channels
        covered = (
            None if self._surroundings is None else self._surroundings.touched_or_surrounded(np.isin(channels, list(touched)))
        )
        return covered is None or set(channels[~covered].tolist()) <= dead

    def _needs(self, estimate: Estimate, pokes: int) -> tuple[Need, ...]:
        return find_needs(estimate, ContactFacts(pokes), Method.MODULES, self._settings, self._skin)


def costs_of(
    plan: PlannedPlaces,
    methods: Iterable[Method],
    noise: NoiseSettings,
    surroundings: Surroundings | None = None,
) -> Mapping[Method, int]:
    """Estimate how many pokes each method takes until it is enough, the cheapest first; see `SessionGuide.costs`."""
    if not len(plan.channels) or not np.isfinite(plan.places).all():
        return {}
    settings = GuideSettings()
    on_sheets = planned_sheet_pokes(plan, noise, settings)
    pokes = {
        method: count_pokes_from_start(
            method, plan.modules, settings, surroundings, on_mesh=plan.on_surface, on_sheets=on_sheets
        )
        for method in methods
    }
    return dict(sorted(pokes.items(), key=lambda item: item[1]))


def plan_of(part: Part) -> PlannedPlaces:
    """Collect the planned taxel positions of the part's layout; none without a laid layout."""
    layout, laid = part.scene.skin.layout, part.laid
    plan = None if layout is None or laid is None else plan_from_layout(layout, laid, part.surface)
    if plan is None:
        plan = plan_without_positions(part.channels, None if layout is None else layout.module_of[part.channels])
        plan = plan if layout is None else replace(plan, spacing=layout.spacing)
    return replace(plan, on_surface=part.surface is not None)
