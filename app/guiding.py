"""The guide of the open part, for the method that the window shows: told what is new, asked what to poke next."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

from app.landmark_round import Landmarks
from app.opening import Part
from app.scene3d.entry import skin_point
from skincal.contacts.outcome import Contact, Progress, Rejection
from skincal.geometry.arrays import FloatArray
from skincal.guide.coaching import Coaching, Smoothed, coach, smooth
from skincal.guide.guidance import Guidance, Target
from skincal.guide.guide import Guide
from skincal.guide.places import SPACING, PlannedPlaces, plan_from, unplaced
from skincal.guide.progress import AxisDiversity, GuideSettings
from skincal.guide.verdict import Verdict, verdict_of
from skincal.modules.pose import ModuleModel
from skincal.session.snapshot import Snapshot
from skincal.taxels.contact_table import Evidence
from skincal.taxels.result import Estimate, Method, State


class Guiding:
    """Follows a session, with or without a layout.

    Parameters
    ----------
    part : what is calibrated
    """

    def __init__(self, part: Part) -> None:
        self._scene, self._surface = part.scene, part.surface
        self._cover = part.cover
        self.plan = plan_of(part)
        """Where the layout puts the taxels."""
        self.landmarks = Landmarks(part, self.plan)
        layout = part.scene.skin.layout
        self._boards = None if layout is None else ModuleModel(layout, part.scene.skin.anchor, part.surface)
        self._nothing: dict[tuple[Method, int], Estimate] = {}
        self._guides: dict[Method, Guide] = {}
        """One a method that was shown: what was skipped stays skipped, and one that comes again only takes what is new."""
        self._told: tuple[int, Method] | None = None
        self._skin_guidance: Guidance | None = None
        """Of the skin alone."""
        self._guidance: Guidance | None = None
        """What is shown."""
        self._smoothed: Smoothed | None = None
        self._skin: tuple[Target, FloatArray] | None = None
        """The target and its place on the skin, (3,) float, metres."""
        self.wanted = True
        """The operator wants to be guided."""

    def follow(
        self,
        snapshot: Snapshot,
        revision: int,
        method: Method,
        evidence: Callable[[Collection[int]], Evidence],
        now_s: float,
    ) -> Guidance | None:
        """Return what to poke next; worked out anew only where the revision or the method is another. None: no guide.

        Parameters
        ----------
        revision : another number where pokes, estimates or dead taxels changed
        evidence : what the contacts of this snapshot say of some channels
        now_s : host's monotonic clock, seconds, when it is seen
        """
        if not self.wanted:
            self._told = self._guidance = None
            self.landmarks.forget()
            return None
        if (revision, method) != self._told:
            guide = self._guide_of(method)
            if self._told is None or self._told[1] is not method or self._guidance is not self._skin_guidance:
                # Meanwhile another target was shown, or none.
                guide.forget_target()
            self._skin_guidance = guide.update(
                _contacts(snapshot),
                self._estimates(snapshot),
                evidence,
                _rejections(snapshot),
                self.landmarks.rig_moves(snapshot),
            )
            self._told = revision, method
        assert self._skin_guidance is not None
        self._guidance = self.landmarks.before_skin(self._skin_guidance, snapshot, now_s)
        return self._guidance

    def verdict(self, guidance: Guidance, snapshot: Snapshot, evidence: Callable[[Collection[int]], Evidence]) -> Verdict:
        """Return what the session has come to.

        Parameters
        ----------
        guidance : of this snapshot
        evidence : what the contacts of this snapshot say of some channels
        """
        estimates, noise = snapshot.estimates[guidance.method], self._scene.noise
        contacts, settings = _contacts(snapshot), GuideSettings()
        return verdict_of(guidance, estimates, contacts, evidence, noise, self._surface, settings, self._boards)

    def coach(self, progress: Progress) -> Coaching | None:
        """Return the poke in progress beside the one that is asked for; None while nothing presses, or nobody guides."""
        self._smoothed = smooth(self._smoothed, progress)
        target = None if self._guidance is None or not self.wanted else self._guidance.target
        # What a rig's errors make of a tip on a landmark is what is to be found: nobody is told to aim by it.
        if target is None or target.landmark or self._smoothed is None:
            return None
        if self._skin is None or self._skin[0] is not target:
            self._skin = target, skin_point(self._surface, target.place, target.normal)
        return coach(self._smoothed, progress, target, self._skin[1])

    def sky(self, channel: int, evidence: Callable[[Collection[int]], Evidence]) -> AxisDiversity | None:
        """Return what the contacts of a channel are like; None where nobody guides, or nothing is known of it.

        Parameters
        ----------
        evidence : as in `follow`, which was called before
        """
        return self._guides[self._told[1]].axis_diversity(channel, evidence) if self.wanted and self._told is not None else None

    def skip(self) -> None:
        """Ask for another poke than the one that was asked for last."""
        if self._guidance is not None and self._guidance.landmark is not None:
            self.landmarks.skip()
        elif self._told is not None:
            self._guides[self._told[1]].skip()
            self._told = None

    def _guide_of(self, method: Method) -> Guide:
        if method not in self._guides:
            layout = self._scene.skin.layout
            spacing = SPACING if layout is None else layout.spacing
            on_surface = self._surface is not None
            self._guides[method] = Guide(
                self.plan, self._scene.noise, method, spacing, cover=self._cover, on_surface=on_surface
            )
        return self._guides[method]

    def _estimates(self, snapshot: Snapshot) -> Mapping[Method, Sequence[Estimate]]:
        """Return one estimate for each channel of the plan, in its order."""
        return {method: self._planned(method, every) for method, every in snapshot.estimates.items()}

    def _planned(self, method: Method, estimates: Sequence[Estimate]) -> Sequence[Estimate]:
        channels = self.plan.channels.tolist()
        if [one.channel for one in estimates] == channels:
            return estimates
        told = {one.channel: one for one in estimates}
        return [told.get(channel) or self._unseen(method, channel) for channel in channels]

    def _unseen(self, method: Method, channel: int) -> Estimate:
        """Return what is said of a channel that the session does not know; the same each time."""
        return self._nothing.setdefault((method, channel), Estimate(channel, method, State.UNSEEN, 0))


def plan_of(part: Part) -> PlannedPlaces:
    """Return where the part's layout puts the taxels; nowhere where there is no layout or it is not laid."""
    layout, laid = part.scene.skin.layout, part.laid
    plan = None if layout is None or laid is None else plan_from(layout, laid)
    return plan or unplaced(part.channels, None if layout is None else layout.module_of[part.channels])


def _contacts(snapshot: Snapshot) -> dict[int, Contact]:
    """Return the contacts that count, by the number of their poke."""
    counting = (record.outcome for record in snapshot.pokes if not record.excluded)
    return {outcome.poke: outcome for outcome in counting if isinstance(outcome, Contact)}


def _rejections(snapshot: Snapshot) -> dict[int, Rejection]:
    """Return the pokes that do not count by themselves, by their number."""
    outcomes = (record.outcome for record in snapshot.pokes)
    return {outcome.poke: outcome for outcome in outcomes if isinstance(outcome, Rejection)}
