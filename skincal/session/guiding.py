"""Follows an open session for the operator: what to poke next, landmarks first, and whether the modules method needs no more.

Nothing here changes the session. A view that shows a landmark as the target sends `AskLandmark` to the pipeline.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from skincal.contacts.outcome import Contact, Rejection
from skincal.geometry import FloatArray
from skincal.guide.believed_positions import DEFAULT_SPACING_M, PlannedPlaces, plan_from_layout, plan_without_positions
from skincal.guide.guidance import ClosingStep, Guidance, GuidePhase, LandmarkTarget, Target, landmark_targets, rig_error_sd
from skincal.guide.guide import Guide
from skincal.guide.progress import AxisDiversity, ContactFacts, GuideSettings, Need, count_pokes_from_start, find_needs
from skincal.guide.verdict import Verdict, verdict_of
from skincal.model.actions import AskPoke, BeginClosing, SkipClosing, SkipLandmark, SkipPoke
from skincal.model.scene import Landmark, NoiseSettings
from skincal.modules.pose import ModuleModel
from skincal.rig.closing import CHECKED_PLACES, MIN_PLACES, ClosingPlace, ClosingPlaces
from skincal.rig.correction import RIG, RigPrior
from skincal.rig.correction_fit import LandmarkPoke, RigAnswer, landmark_agreement
from skincal.rig.expected_gain import MAX_POSES, Gain, PlannedPoke, expected_error, unchecked_of
from skincal.session.arm_poses import CurrentPose
from skincal.session.closing_pokes import (
    ClosingSoFar,
    at_landmarks,
    at_taxels,
    closing_rounds,
    closings_of,
    first_names,
    is_due,
)
from skincal.session.decisions import ClosingRound
from skincal.session.landmark_pokes import landmark_normals
from skincal.session.part import Part
from skincal.session.snapshot import Snapshot
from skincal.session.solving import methods_of
from skincal.taxels.contact_table import Evidence
from skincal.taxels.result import Estimate, Method, State

STILL_S = 1.0
"""s. Landmarks are asked for where the arm has stood so long: on its way it goes through poses in which nobody pokes."""


class SessionGuide:
    """Says what to poke next by the method that is shown, with or without a layout."""

    def __init__(self, part: Part) -> None:
        self._part, self._scene, self._surface = part, part.scene, part.surface
        self.plan = plan_of(part)
        """Where the layout puts the taxels."""
        self.landmarks = LandmarkGuide(part, self.plan)
        self.closing = ClosingGuide(part.scene.noise)
        layout = part.scene.skin.layout
        self._module_model = None if layout is None else ModuleModel(layout, part.scene.skin.anchor, part.surface)
        self._nothing: dict[tuple[Method, int], Estimate] = {}
        self._guides: dict[Method, Guide] = {}
        """One a method that was shown: what was skipped stays skipped, and one that comes again only takes what is new."""
        self._skipped: Counter[Method] = Counter()
        """How many of the session's skips each guide knows."""
        self._followed: tuple[Snapshot, Method] | None = None
        self._skin_guidance: Guidance | None = None
        """Of the skin alone."""
        self._guidance: Guidance | None = None
        """What is shown."""
        self.wanted = True
        """The operator wants to be guided."""
        self.costs = costs_of(self.plan, methods_of(part.scene, part.surface), on_mesh=part.surface is not None)
        """About how many pokes each method takes from the first to enough; nothing where no layout places the taxels."""

    def next_target(
        self,
        snapshot: Snapshot,
        pose: CurrentPose,
        method: Method,
        evidence: Callable[[Collection[int]], Evidence],
        now_s: float,
    ) -> Guidance | None:
        """Say what to poke next; `None` while guidance is off. The same snapshot and method cost nothing again.

        Parameters
        ----------
        pose : current arm pose
        evidence : rows of this snapshot's contacts for some channels
        now_s : host's monotonic clock, seconds, when it is seen
        """
        if not self.wanted:
            self._followed = self._guidance = None
            self.landmarks.forget()
            return None
        now = snapshot, method
        if now != self._followed:
            self._skin_guidance = self.next_skin_target(snapshot, method, evidence)
            self._followed = now
        assert self._skin_guidance is not None
        before = self.landmarks.before_skin(self._skin_guidance, snapshot, pose, now_s)
        self._guidance = self.closing.after_skin(before, snapshot, pose[0], self.landmarks)
        return self._guidance

    def next_skin_target(self, snapshot: Snapshot, method: Method, evidence: Callable[[Collection[int]], Evidence]) -> Guidance:
        """Say what to poke next on the skin, whatever landmarks there are."""
        guide = self._guide_of(method)
        for skip in snapshot.decisions.skips[self._skipped[method] :]:
            # A place where a taxel may be is left out for all methods.
            if isinstance(skip, SkipPoke) and (skip.method == method.value or skip.channel < 0):
                guide.skip(_target_of(skip, skip.push))
        self._skipped[method] = len(snapshot.decisions.skips)
        asked = {record.outcome.poke: record.asked for record in snapshot.pokes}
        return guide.update(
            _contacts(snapshot),
            {method: self._planned(method, every) for method, every in snapshot.estimates.items()},
            evidence,
            lambda poke: _asked_target(asked.get(poke)),
            {poke.poke: poke for poke in (record.outcome for record in snapshot.pokes) if isinstance(poke, Rejection)},
            self.landmarks.rig_error_sd(snapshot),
        )

    def remaining_work(self, snapshot: Snapshot, method: Method, evidence: Callable[[Collection[int]], Evidence]) -> Guidance:
        """Say what a method still needs, on the skin and at landmarks. This alone decides whether it is enough.

        It follows from the session alone, with its skips, and not from the time. A streamed arm counts as standing still in the
        pose of the last poke.
        """
        return self.landmarks.added(self.next_skin_target(snapshot, method, evidence), snapshot)

    def verdict(
        self,
        snapshot: Snapshot,
        method: Method,
        evidence: Callable[[Collection[int]], Evidence],
        rig: RigAnswer | None = None,
    ) -> Verdict:
        """Return what the session has come to by a method; `remaining_work` decides whether it is enough.

        Parameters
        ----------
        evidence : what the contacts of this snapshot say of some channels
        rig : what landmark pokes say; None where nobody has looked
        """
        guidance = self.remaining_work(snapshot, method, evidence)
        estimates, noise, used = snapshot.estimates[method], self._scene.noise, snapshot.decisions.corrections.get(RIG)
        landmarks = landmark_agreement(rig, used)
        verdict = verdict_of(
            guidance,
            estimates,
            _contacts(snapshot),
            evidence,
            noise,
            self._surface,
            GuideSettings(),
            self._module_model,
            landmarks,
            unchecked_of(used, landmarks, estimates, snapshot.contacts, self.landmarks.made(snapshot), noise),
        )
        return replace(verdict, closings=closings_of(snapshot, noise))

    def axis_diversity(self, channel: int, evidence: Callable[[Collection[int]], Evidence]) -> AxisDiversity | None:
        """Return what the contacts of a channel are like; None where nobody guides, or nothing is known of it.

        `evidence` is as in `follow`, which was called before.
        """
        if not self.wanted or self._followed is None:
            return None
        return self._guides[self._followed[1]].axis_diversity(channel, evidence)

    def skip(self) -> SkipClosing | SkipLandmark | SkipPoke | None:
        """Make the action that skips the current target; `None` without a target."""
        now = self._guidance
        if now is None or now.target is None:
            return None
        if now.closing is not None:
            return SkipClosing(now.closing.place.at.value, now.closing.place.name)
        if now.landmark is not None:
            return self.landmarks.skip()
        channel = -1 if now.target.channel is None else now.target.channel
        return SkipPoke(now.method.value, channel, _numbers(now.target.place), _numbers(now.target.push))

    def skip_landmarks(self) -> SkipClosing | SkipLandmark | None:
        """Make the action that skips all landmarks in this arm pose or ends the closing check; `None` if neither is active."""
        if self._guidance is not None and self._guidance.closing is not None:
            return SkipClosing("", "")
        return self.landmarks.skip(all_of_pose=True)

    def check_again(self, snapshot: Snapshot, pose: str) -> BeginClosing | None:
        """Make the action that begins another closing check; `None` if nothing would be asked for in it."""
        now = self._guidance
        possible = now is not None and self.closing.begun(now, snapshot, pose, self.landmarks) is not None
        return BeginClosing(wanted=True) if possible else None

    def _guide_of(self, method: Method) -> Guide:
        if method not in self._guides:
            layout, noise, cover = self._scene.skin.layout, self._scene.noise, self._part.cover
            spacing, on_surface = DEFAULT_SPACING_M if layout is None else layout.spacing, self._surface is not None
            self._guides[method] = Guide(self.plan, noise, method, spacing, search=cover, on_surface=on_surface)
        return self._guides[method]

    def _planned(self, method: Method, estimates: Sequence[Estimate]) -> Sequence[Estimate]:
        """Return one estimate for each channel of the plan, in its order."""
        channels = self.plan.channels.tolist()
        if [estimate.channel for estimate in estimates] == channels:
            return estimates
        known = {estimate.channel: estimate for estimate in estimates}
        # What is said of a channel that the session does not know is the same object each time: guides compare by it.
        unseen = self._nothing
        return [
            known.get(channel) or unseen.setdefault((method, channel), Estimate(channel, method, State.UNSEEN, 0))
            for channel in channels
        ]


class LandmarkGuide:
    """Says which landmark to poke before the skin. `LandmarkFinder` in the pipeline finds which poke was there."""

    def __init__(self, part: Part, plan: PlannedPlaces) -> None:
        self._scene, self._surface = part.scene, part.surface
        there = np.isfinite(plan.places).all(axis=1)
        self._taxels, self._outward = plan.places[there], plan.normals[there]
        """(n, 3) float each, metres and unit: the taxels that the layout places."""
        self._normals: dict[bytes, FloatArray] = {}
        self._targets: list[LandmarkTarget] = []
        """All that is asked for in this arm pose."""
        self._pose: CurrentPose = ("", None)
        self._since_s = -np.inf
        """When the arm came into this pose: host's monotonic clock, seconds."""
        self._known: tuple[object, ...] = ()
        self._shown: Guidance | None = None

    def forget(self) -> None:
        """Ask for nothing: guidance is off."""
        self._targets, self._known = [], ()

    def before_skin(self, guidance: Guidance, snapshot: Snapshot, pose: CurrentPose, now_s: float) -> Guidance:
        """Put a landmark before the skin's guidance, if one is asked for; `now_s` as for `SessionGuide.next_target`."""
        before, self._pose = self._pose[0], pose
        if pose[0] != before:
            # The first pose, and one that the scene names, are not on the way to another: they hold at once.
            is_named = self._scene.arm is None or pose[0] in self._scene.arm.poses
            self._since_s = now_s if before and not is_named else -np.inf
        still = now_s - self._since_s >= STILL_S
        known = snapshot, pose[0], still, guidance
        if known != self._known:
            self._known = known
            self._targets = self._plan(snapshot, pose[0]) if still else []
            now = self._targets[0] if self._targets else None
            self._shown = now and guidance.before_skin(now, self.normal(now.landmark), self._gain_of(snapshot))
        return self._shown or guidance

    def added(self, guidance: Guidance, snapshot: Snapshot) -> Guidance:
        """Put the landmarks before the skin's guidance that are missing by the session alone; see `remaining_work`."""
        pose = snapshot.decisions.pose
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
        skips = [(skip.pose, skip.name) for skip in decisions.skips if isinstance(skip, SkipLandmark)]
        return landmark_targets(decisions.landmarks, [(poke.pose, poke.name) for poke in self.made(snapshot)], pose, skips)

    def made(self, snapshot: Snapshot) -> list[LandmarkPoke]:
        """Return the landmark pokes that count."""
        return at_landmarks(snapshot)

    def rig_error_sd(self, snapshot: Snapshot) -> float:
        """Return by how much the rig moves estimates, by its landmark pokes: sd in each direction, metres."""
        return rig_error_sd(self.made(snapshot), self._scene.noise)

    def _gain_of(self, snapshot: Snapshot) -> Gain | None:
        """Predict what the landmarks of this arm pose are worth for the taxels that are poked in it and in those before."""
        name, here = self._pose
        if here is None or not len(self._taxels):
            return None
        contacts = snapshot.contacts
        often = [each for each, _ in Counter(contact.pose for contact in contacts).most_common(MAX_POSES)]
        poses = {contact.pose: contact.link_from_sensor for contact in contacts if contact.pose in often}
        poses[name] = here
        planned = [PlannedPoke(target.landmark.place, self.normal(target.landmark), here, name) for target in self._targets]
        made, noise = [poke for poke in self.made(snapshot) if poke.pose in poses], self._scene.noise
        return expected_error(RigPrior(), noise, made, planned, self._taxels, self._outward, poses)

    def skip(self, *, all_of_pose: bool = False) -> SkipLandmark | None:
        """Return what asks for the landmark no more in this arm pose, or for none; None where none is asked for."""
        if not self._targets:
            return None
        name, (pose, sensor) = "" if all_of_pose else self._targets[0].landmark.name, self._pose
        return SkipLandmark(name, pose, () if sensor is None else _numbers(sensor))

    def normal(self, landmark: Landmark) -> FloatArray:
        """Return the outward normal at a landmark: its own, else the surface's, else away from the skin's middle."""
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
    """Asks for some of the first places once more, when nothing else is asked for: three landmarks, or three taxels.

    Where one poke alone says that something moved, it asks for its place once more. What it asks for follows from the session
    alone.
    """

    def __init__(self, noise: NoiseSettings) -> None:
        self._noise = noise
        self._known: tuple[object, ...] = ()
        self._shown: Guidance | None = None

    def after_skin(self, guidance: Guidance, snapshot: Snapshot, pose: str, landmarks: LandmarkGuide) -> Guidance:
        """Add a place to repeat, once nothing else is asked for in the arm pose of that name."""
        known = guidance, snapshot, pose
        if known != self._known:
            self._known, self._shown = known, self._closing(guidance, snapshot, pose, landmarks)
        return self._shown or guidance

    def _closing(self, guidance: Guidance, snapshot: Snapshot, pose: str, landmarks: LandmarkGuide) -> Guidance | None:
        if guidance.phase is not GuidePhase.ENOUGH:
            return None
        rounds, asked = closing_rounds(snapshot, self._noise), None
        if rounds and not snapshot.decisions.closings[-1].ended and not rounds[-1].over:
            asked = self._next(rounds, snapshot.decisions.closings[-1], guidance, snapshot, pose, landmarks)
        return self.begun(guidance, snapshot, pose, landmarks) if asked is None and is_due(snapshot, rounds) else asked

    def begun(self, guidance: Guidance, snapshot: Snapshot, pose: str, landmarks: LandmarkGuide) -> Guidance | None:
        """Add the first place of a check that begins now; `None` before it is enough, or if the check would have no place."""
        if not guidance.enough:
            return None
        last = max((record.outcome.poke for record in snapshot.pokes), default=0)
        rounds = [*closing_rounds(snapshot, self._noise), ClosingSoFar()]
        return self._next(rounds, ClosingRound(last), guidance, snapshot, pose, landmarks)

    def _next(
        self,
        rounds: Sequence[ClosingSoFar],
        begun: ClosingRound,
        guidance: Guidance,
        snapshot: Snapshot,
        pose: str,
        landmarks: LandmarkGuide,
    ) -> Guidance | None:
        """Return the guidance with the next place of the last of the checks, which began so; None where it has no more."""
        *done, now = rounds
        before = frozenset[int]().union(*(each.made for each in done))
        for at, pokes, targets in (
            (ClosingPlaces.LANDMARKS, at_landmarks(snapshot), self._landmarks(snapshot, landmarks.normal)),
            (ClosingPlaces.TAXELS, at_taxels(snapshot), _taxel_targets(guidance, snapshot)),
        ):
            early = [poke for poke in pokes if poke.poke <= begun.after and poke.poke not in before]
            names = [name for name in first_names(early, pose, CHECKED_PLACES) if name in targets]
            if len(names) < MIN_PLACES:
                continue
            again = {poke.name for poke in pokes if poke.poke in now.made}
            places = [] if now.whole else [ClosingPlace(at, name) for name in names if name not in again]
            open_ = [place for place in places if place not in begun.skipped] or [now.once_more]
            place = open_[0]
            if place is None or place.at is not at or place.name not in targets:
                return None
            suspect = now.found.poke if place == now.once_more and now.found is not None else None
            step = ClosingStep(place, len(again & set(names)), len(names), len(rounds), suspect)
            target = targets[place.name]
            marks = {landmark.name: landmark for landmark in snapshot.decisions.landmarks}
            mark = LandmarkTarget(marks[target.landmark], step.done, step.places) if target.landmark else None
            return replace(guidance, phase=GuidePhase.CLOSING, target=target, landmark=mark, closing=step)
        return None

    def _landmarks(self, snapshot: Snapshot, normal: Callable[[Landmark], FloatArray]) -> dict[str, Target]:
        return {mark.name: _straight(None, mark.place, normal(mark), mark.name) for mark in snapshot.decisions.landmarks}


def _taxel_targets(guidance: Guidance, snapshot: Snapshot) -> dict[str, Target]:
    """Return a straight poke at each taxel that is known, by its channel in words."""
    known = snapshot.estimates[guidance.method]
    return {
        str(each.channel): _straight(each.channel, each.position, each.normal)
        for each in known
        if each.position is not None and each.normal is not None
    }


def _straight(channel: int | None, place: FloatArray, normal: FloatArray, landmark: str = "") -> Target:
    return Target(channel, place, normal, -normal, 0.0, float("inf"), float("inf"), landmark)


def _numbers(values: FloatArray) -> tuple[float, ...]:
    return tuple(map(float, values.ravel()))


def asked_poke(guidance: Guidance | None) -> AskPoke:
    """Return which poke on the skin is asked for; none while a landmark is, or nobody guides."""
    target = None if guidance is None or guidance.landmark is not None else guidance.target
    if target is None:
        return AskPoke(-1, (), (), ())
    channel = -1 if target.channel is None else target.channel
    return AskPoke(channel, _numbers(target.place), _numbers(target.normal), _numbers(target.push))


def _target_of(asked: AskPoke | SkipPoke, normal: Sequence[float]) -> Target:
    """Return a poke of the past as a target; of one that was skipped the normal does not matter."""
    place, outward, push = (np.array(values) for values in (asked.place, normal, asked.push))
    tilt = float(np.arccos(np.clip(-(push @ outward), -1.0, 1.0)))
    channel = None if asked.channel < 0 else asked.channel
    return Target(channel, place, outward, push, tilt, float("inf"), float("inf"))


def _asked_target(asked: AskPoke | None) -> Target | None:
    if asked is None or not asked.place or not asked.normal or not asked.push:
        return None
    return _target_of(asked, asked.normal)


class ModulesEnough:
    """Notices once that the modules method needs no more pokes, while the method that is shown asks for hundreds."""

    def __init__(self, plan: PlannedPlaces, skin: float) -> None:
        self._plan, self._skin, self._settings = plan, skin, GuideSettings()
        self._seen: Snapshot | None = None
        self._noticed = False

    def is_news(self, snapshot: Snapshot, guidance: Guidance | None, method: Method, *, streaming: bool) -> bool:
        """Return whether it is enough by the modules method, and was not noticed before.

        `guidance` is by the method that is shown, None where nobody guides; `streaming` says that the devices are read.
        """
        asked = guidance is not None and not guidance.enough
        # Seen by that method, it is no news any more.
        self._noticed |= method is Method.MODULES and not asked and guidance is not None
        if self._noticed or not asked or method is Method.MODULES or not streaming or snapshot is self._seen:
            return False
        self._seen = snapshot
        self._noticed = self._enough(snapshot)
        return self._noticed

    def _enough(self, snapshot: Snapshot) -> bool:
        """Return whether no taxel of the plan needs anything by the modules method."""
        module_of = dict(zip(self._plan.channels.tolist(), self._plan.modules.tolist(), strict=True))
        enough = self._settings.module_pokes
        known = [estimate for estimate in snapshot.estimates.get(Method.MODULES, ()) if estimate.channel in module_of]
        if all(estimate.state is State.DEAD for estimate in known) or any(self._needs(estimate, enough) for estimate in known):
            return False  # whatever was poked where
        own = Counter(module_of.get(contact.strongest_channel) for contact in snapshot.contacts)
        return not any(self._needs(estimate, own[module_of[estimate.channel]]) for estimate in known)

    def _needs(self, estimate: Estimate, pokes: int) -> tuple[Need, ...]:
        """Return what a taxel needs whose module has so many pokes; nothing else of the facts is looked at."""
        return find_needs(estimate, ContactFacts(pokes), Method.MODULES, self._settings, self._skin)


def costs_of(plan: PlannedPlaces, methods: Iterable[Method], *, on_mesh: bool) -> Mapping[Method, int]:
    """Return about how many pokes each method takes from the first to enough, the cheapest first; see `SessionGuide.costs`."""
    if not len(plan.channels) or not np.isfinite(plan.places).all():
        return {}
    pokes = {method: count_pokes_from_start(method, plan.modules, GuideSettings(), on_mesh=on_mesh) for method in methods}
    return dict(sorted(pokes.items(), key=lambda item: item[1]))


def plan_of(part: Part) -> PlannedPlaces:
    """Return where the part's layout puts the taxels; nowhere where there is no layout or it is not laid."""
    layout, laid = part.scene.skin.layout, part.laid
    plan = None if layout is None or laid is None else plan_from_layout(layout, laid)
    return plan or plan_without_positions(part.channels, None if layout is None else layout.module_of[part.channels])


def _contacts(snapshot: Snapshot) -> dict[int, Contact]:
    """Return the contacts that count, by the number of their poke."""
    return {contact.poke: contact for contact in snapshot.contacts}
