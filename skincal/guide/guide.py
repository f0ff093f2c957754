"""The guide: follows a session by one method, and says what to poke next, why, and when it is enough.

It holds no truth of its own: all of it follows from the contacts, the estimates and what the operator skipped. It gives numbers
and reasons (`guidance.py`); sentences are made by the window.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.geometry import FloatArray, IntArray
from skincal.guide import candidates
from skincal.guide.guidance import Guidance, GuidePhase, Target
from skincal.guide.knowledge import PlannedPlaces, TaxelStatistics, believed_positions
from skincal.guide.poke_history import PokeHistory, TargetOfPoke, axis_of
from skincal.guide.progress import (
    AxisDiversity,
    Facts,
    GuideSettings,
    Need,
    Tried,
    Turns,
    Why,
    count_module_pokes_left,
    find_needs,
    give_up_reason,
    improvable_error,
    poke_interval,
    pokes_left,
)
from skincal.model.scene import NoiseSettings
from skincal.taxels.contact_table import Evidence
from skincal.taxels.result import Estimate, Method, State

if TYPE_CHECKING:
    from skincal.guide.candidates import Cover

BoolArray: TypeAlias = NDArray[np.bool_]

NEIGHBOUR_SHARE_SWEEP = 0.6
"""Share of a poke's gain at the neighbours that counts in the sweep. The free method needs 86 pokes to 5 mm (median of 20
rigs); with a share of 1 it needs 93. See `docs/decisions/neighbours-in-the-sweep.md`."""
OTHERS = 0.3
"""Share of what a poke says about the neighbours that counts in the phase of own pokes: none of it takes 6 % more pokes to 3
mm, all of it pulls neighbours together in the long run."""
AIM_MAX = 0.002
"""m: no poke is asked for farther beside its taxel, or a neighbour would answer most."""
NEAR = 150
"""Taxels among which the free method's next target is looked for where there are more: two thirds of them those nearest to the
hand, one third the neediest."""
SAME_SIDE = float(np.cos(np.radians(25.0)))
"""Cosine of the angle within which two pushes come from the same side: half the way between two that are tried."""
TURN = 3
"""Eighths of a turn from one tilted push on a module to the next: eight pushes come from eight sides, successive ones far
apart."""
SKIPPED = 2
"""A side of a taxel that was skipped so often is left out."""
_NOTHING_REJECTED: Mapping[int, Rejection] = {}


def _neighbour_share(phase: GuidePhase | None) -> float:
    return NEIGHBOUR_SHARE_SWEEP if phase is GuidePhase.SWEEP else OTHERS


class Guide:
    """Follows a session by one method.

    Parameters
    ----------
    plan : where the layout puts the taxels, if there is one
    spacing : m, usual distance of neighbours
    cover : places to poke while it is unknown where the taxels are; None with a layout
    on_surface : whether a mesh gives the depth; modules that lie free in space need tilted pushes for it
    """

    def __init__(
        self,
        plan: PlannedPlaces,
        noise: NoiseSettings,
        method: Method,
        spacing: float,
        settings: GuideSettings | None = None,
        cover: Cover | None = None,
        *,
        on_surface: bool = True,
    ) -> None:
        count = len(plan.channels)
        self.plan, self.method, self.settings = plan, method, settings or GuideSettings()
        self._noise, self._spacing, self._cover = noise, spacing, cover
        self._in_plane, self._tilted = method is not Method.FREE, method is Method.MODULES and not on_surface
        self._knowledge = TaxelStatistics(plan.channels, noise, self.settings.unknown, self._in_plane)
        self._pokes = PokeHistory(plan.channels, self.settings)
        self._places, self._normals = plan.places.copy(), plan.normals.copy()
        # (n,) channels that the plan puts nowhere: no taxels until they answer.
        self._loose: BoolArray = np.isnan(plan.places[:, 0])
        # m, sd of what the rig moves all estimates by, each direction.
        self._rig: float = 0.0
        self._gains_of: GuidePhase | None = None
        self._gains = np.full((count, candidates.TRIES), -np.inf)
        self._stale = np.ones(count, dtype=bool)
        self._usable = self._pokes.tilt.usable
        self._lay_out()
        self._state: candidates.ChoiceState | None = None
        self._last: Target | None = None
        # Index of the last target and of its push, as long as nothing but its numbers changed.
        self._kept: tuple[int, int] | None = None
        # Of the cover, where the last target is one of its places.
        self._place: int | None = None
        # The sides of each taxel, by its index, that were skipped.
        self._skips: dict[int, list[FloatArray]] = {}
        # Index of the taxel that was skipped last, until the next poke.
        self._not_now = -1
        self._estimates: list[Estimate | None] = [None] * count
        self._needs: list[tuple[Need, ...]] = [()] * count
        self._nothing = float(np.sqrt(3.0)) * self.settings.unknown
        self._solved = np.full(count, self._nothing)

    def update(
        self,
        contacts: Mapping[int, Contact],
        estimates: Mapping[Method, Sequence[Estimate]],
        evidence: Callable[[Collection[int]], Evidence],
        rejections: Mapping[int, Rejection] = _NOTHING_REJECTED,
        rig: float = 0.0,
        asked: TargetOfPoke | None = None,
    ) -> Guidance:
        """Follow the session to where it stands now, and say what is to be done.

        Contacts are those that count and rejections those that do not, by the number of their poke; estimates stand in the
        plan's order; `evidence` gives what the contacts say of some channels; `rig` is the sd of what the rig's errors move all
        estimates by in each direction, metres, 0 where nothing is known of it; `asked` gives what each poke was asked for, None
        where that is what was said last.
        """
        dirty = self._follow(contacts, estimates, rejections, rig, asked)
        if dirty:
            # A contact that the method doubts says less here, too.
            doubted = {each.channel: each.doubted for each in estimates[self.method] if each.channel in dirty}
            found = evidence(dirty)
            pairs = zip(found.channels[found.taxels].tolist(), found.pokes.tolist(), strict=True)
            trust = [doubted[channel].get(poke, 1.0) for channel, poke in pairs]
            drawn = self._drawn()
            centres = {poke: self._pokes.place(poke, drawn) for poke in set(found.pokes.tolist())}
            self._knowledge.renew(dirty, found.trusted(np.array(trust)), self._places, drawn, self._normals, centres)
            rows = np.array([self._knowledge.row(channel) for channel in dirty])
            self._stale |= np.isin(self._neighbours.rows, rows).any(axis=1)
        self._renew_needs(estimates[self.method], dirty)
        return self._guidance(estimates[self.method])

    def forget_target(self) -> None:
        """Take the next poke as not asked for: the last target was never shown."""
        self._last = self._kept = None

    def skip(self, target: Target | None = None) -> None:
        """Ask for something else than a target, by default the last; a side of a taxel that is skipped twice is left out."""
        self._kept, target = None, target or self._last
        if target is None:
            return
        if target.channel is None and self._cover is not None:
            self._cover.leave_out(target.place)
        elif target.channel is not None and self._knowledge.has(target.channel):
            self._not_now = self._knowledge.row(target.channel)
            self._skips.setdefault(self._not_now, []).append(target.push)
            self._stale[self._not_now] = True

    def _follow(
        self,
        contacts: Mapping[int, Contact],
        estimates: Mapping[Method, Sequence[Estimate]],
        rejections: Mapping[int, Rejection],
        rig: float,
        asked: TargetOfPoke | None,
    ) -> set[int]:
        """Add the pokes that are new or changed, drop those that are gone; return the channels of the taxels they touch."""
        rows, fresh, gone = self._pokes.follow(
            contacts, rejections, asked or self._last, self._drawn(), self._normals, self._pulls
        )
        if fresh or gone:
            self._kept = None
        if any(isinstance(poke, Contact) for poke in fresh):
            self._not_now = -1
        self._cover_with(fresh, contacts.keys() | rejections.keys())
        if rows or rig != self._rig:
            self._stale[:] |= rig != self._rig
            # Places on the mesh have the depth that few free pokes leave open.
            self._rig, best = rig, estimates.get(Method.SURFACE) or estimates[Method.FREE]
            self._places = believed_positions(self.plan, best, rig)
            self._find_loose(rows, best)
        if self._pokes.tilt.usable != self._usable:
            self._usable = self._pokes.tilt.usable
            self._pushes = candidates.candidate_pushes(self._normals, self._usable)
            self._stale[:], self._kept = True, None
        return {int(self.plan.channels[row]) for row in rows}

    def _drawn(self) -> FloatArray:
        """Return (n, 3) where the plan draws each taxel, metres; as believed where it does not.

        How far a poke was beside a taxel is measured on the plan: it stays the same while more becomes known of where the skin
        lies, and a session that is opened again finds the same.
        """
        return np.where(self._loose[:, None], self._places, self.plan.places)

    def _lay_out(self) -> None:
        """Work out what follows from where the taxels are believed to be."""
        self._neighbours = candidates.find_answering(self._places, self._spacing, self._noise)
        self._pulls = candidates.answer_offsets(self._places, self._neighbours)
        self._pushes = candidates.candidate_pushes(self._normals, self._usable)

    def _find_loose(self, rows: Collection[int], estimates: Sequence[Estimate]) -> None:
        """Take places and normals of channels that the plan puts nowhere from their estimates."""
        found = [row for row in rows if self._loose[row]]
        for row in found:
            normal = estimates[row].normal
            if normal is not None:
                self._normals[row] = normal
        if found:
            self._lay_out()
            self._stale[:] = True

    def _cover_with(self, fresh: Sequence[Contact | Rejection], numbers: Collection[int]) -> None:
        """Let the cover know where new pokes were, and which pokes still count."""
        if self._cover is None:
            return
        for poke in fresh:
            answered = isinstance(poke, Contact)
            axis = axis_of(poke) if answered or poke.reason is Reason.NO_TAXEL else None
            if axis is not None:
                self._cover.poked(poke.poke, axis, answered=answered)
        self._cover.keep(numbers)

    def _renew_needs(self, estimates: Sequence[Estimate], dirty: Collection[int]) -> None:
        """Renew what each taxel needs whose contacts or estimate changed."""
        know, turned = self._knowledge, list[int]()
        beside = np.sqrt(np.sum(know.beside * know.beside, axis=1))
        facts = zip(*map(np.ndarray.tolist, (self._own(), know.diversity, beside, know.pulled, know.moved)), strict=True)
        nothing: tuple[Need, ...] | None = None
        for row, (estimate, each) in enumerate(zip(estimates, facts, strict=True)):
            if estimate is self._estimates[row] and estimate.channel not in dirty:
                continue
            if estimate.state is State.UNSEEN and self._loose[row]:
                now = ()
            elif estimate.state is State.UNSEEN:
                # The same for all of them: in a large part they are thousands at first.
                nothing = now = nothing or find_needs(estimate, Facts(*each), self.method, self.settings, self._noise.skin)
            else:
                now = find_needs(estimate, Facts(*each), self.method, self.settings, self._noise.skin)
            if bool(self._needs[row]) != bool(now):
                turned.append(row)
            self._estimates[row], self._needs[row] = estimate, now
            error = estimate.sd if estimate.rms is None else estimate.rms
            self._solved[row] = min(self._nothing if error is None else error, self._nothing)
        self._stale |= np.isin(self._neighbours.rows, turned).any(axis=1)

    def _own(self) -> IntArray:
        """Return (n,) the pokes of their own; by the modules method those of their module."""
        own, modules = self._knowledge.own, self.plan.modules
        if self.method is not Method.MODULES:
            return own
        return np.bincount(modules, own).astype(np.int64)[modules]

    def _guidance(self, estimates: Sequence[Estimate]) -> Guidance:
        know, left = self._knowledge, self._given_up()
        rms = np.array([np.inf if each.rms is None else each.rms for each in estimates])
        open_ = np.array([bool(each) for each in self._needs])
        open_[list(left)] = False
        state = candidates.ChoiceState(
            self._places, self._pushes, self._neighbours, know.information, self._normals, self._pokes.sensor,
            self.settings.wanted, self._in_plane, open_.astype(np.float64), self._solved,
        )  # fmt: skip
        self._state = state
        phase, self._place = self._phase(open_)
        self._last = None
        if self._place is not None:
            self._last = self._somewhere(self._place)
        elif phase is not GuidePhase.ENOUGH:
            self._last = self._target(state, phase)
        beside = np.sqrt(np.sum(know.beside * know.beside, axis=1))
        if self.method is Method.MODULES:
            errors = np.array([improvable_error(each, self._noise.skin) for each in estimates])
            count = count_module_pokes_left(open_, self.plan.modules, self._own(), errors, self.settings)
        else:
            lopsided = np.maximum(beside, np.abs(know.pulled))
            count = pokes_left(self.method, open_, know.own, rms, lopsided, know.moved, self.settings)
        step = poke_interval(np.array([contact.start_s for contact in self._pokes.latest()]))
        shown = np.flatnonzero(~self._loose | (know.contacts > 0))
        return Guidance(
            method=self.method,
            phase=phase,
            target=self._last,
            channels=self.plan.channels[shown],
            places=self._places[shown],
            rms=rms[shown],
            diversity=know.diversity[shown],
            own=know.own[shown],
            needs=tuple(self._needs[row] for row in shown.tolist()),
            given_up={int(self.plan.channels[row]): why for row, why in left.items()},
            usable_tilt=self._usable,
            pokes_left=count,
            seconds_left=None if step is None else step * count,
        )

    def _given_up(self) -> dict[int, Why]:
        """Return which taxels are asked for no more though they need something, by their index."""
        know, settings, unanswered = self._knowledge, self.settings, self._pokes.unanswered
        # Of thousands of taxels only these can be given up: the rest is not looked at.
        patience = settings.module_patience if self.method is Method.MODULES else settings.patience
        often = self._own() >= patience
        tried_often = often | ((know.contacts == 0) & (unanswered >= settings.unanswered))
        if self._usable < settings.diversity:
            tried_often |= know.own >= settings.own_pokes
        found: dict[int, Why] = {}
        for row in {*np.flatnonzero(tried_often).tolist(), *self._skips}:
            tried = Tried(
                own=int(know.own[row]),
                often=bool(often[row]),
                contacts=int(know.contacts[row]),
                unanswered=int(unanswered[row]),
                shut=bool(self._left_out(row).all()),
                tilt=self._usable,
            )
            why = give_up_reason(self._needs[row], tried, settings)
            if why is not None:
                found[row] = why
        return found

    def _phase(self, open_: BoolArray) -> tuple[GuidePhase, int | None]:
        """Return what the guide is after, and the place of the cover that it asks for."""
        place = None if self._cover is None else self._cover.next(self._pokes.hand(self._places))
        if place is not None:
            return GuidePhase.COVER, place
        if not open_.any():
            # Where nothing answered yet, and no layout names taxels, there is nothing that could be enough.
            return (GuidePhase.COVER if self._loose.all() and not self._pokes.contacts else GuidePhase.ENOUGH), None
        if self._in_plane or self._loose.all() or len(self._pokes.contacts) >= self.settings.sweep * len(self.plan.channels):
            return GuidePhase.OWN, None
        return GuidePhase.SWEEP, None

    def _somewhere(self, place: int) -> Target:
        """Return a poke at a place of the cover, straight."""
        assert self._cover is not None
        normal = self._cover.normals[place]
        return Target(None, self._cover.places[place], normal, -normal, 0.0, float("inf"), float("inf"))

    def _target(self, state: candidates.ChoiceState, phase: GuidePhase) -> Target | None:
        if self._kept is not None and state.open[self._kept[0]] > 0:
            # Only the tare after a poke came: the hand is on its way already.
            return self._aimed(state, *self._kept)
        rows = self._eligible(state)
        if not rows.size:
            return None
        seconds = self.settings.poke_s + self._away(state.places[rows]) / self.settings.hand_speed
        if self._in_plane:
            row = self._in_turn(rows, seconds)
            push = self._push(row)
        else:
            # What a poke gains in a second: the way of the hand counts.
            near = self._near(rows, seconds)
            gains = self._fresh_gains(state, rows[near], phase) / seconds[near, None]
            best = int(gains.argmax())
            row, push = int(rows[near[best // gains.shape[1]]]), best % gains.shape[1]
        self._kept = row, push
        return self._aimed(state, row, push)

    def _eligible(self, state: candidates.ChoiceState) -> IntArray:
        """Return the taxels that may be asked for: open, with a place; the one just skipped only where it is the last."""
        rows = np.flatnonzero((state.open > 0) & np.isfinite(state.places).all(axis=1))
        others = rows[rows != self._not_now]
        return others if others.size else rows

    def _left_out(self, row: int) -> BoolArray:
        """Return (d,) which pushes at a taxel come from sides that were skipped."""
        skips = self._skips.get(row)
        if skips is None:
            return np.zeros(candidates.TRIES, dtype=bool)
        alike: FloatArray = self._pushes[row] @ np.array(skips).T
        often: IntArray = np.sum(alike > SAME_SIDE, axis=1)
        return often >= SKIPPED

    def _near(self, rows: IntArray, seconds: FloatArray) -> IntArray:
        """Return which of `rows` to look at: all where they are few."""
        if len(rows) <= NEAR:
            return np.arange(len(rows))
        known = self._knowledge.contacts[rows]
        nearest, neediest = seconds.argsort(kind="stable"), np.lexsort((seconds, known))
        both: IntArray = np.union1d(nearest[: 2 * NEAR // 3], neediest[: NEAR // 3])
        return both

    def _push(self, row: int) -> int:
        """Return which push is next at a taxel that needs no tilt: straight; in space, from another side each time."""
        order = list(range(candidates.TRIES))
        if self._tilted:
            # The pushes of the largest tilt stand last, one for each azimuth.
            turn, tilted = TURN * int(self._own()[row]), order[-candidates.AZIMUTHS :]
            order = [*(tilted[(turn + step) % candidates.AZIMUTHS] for step in range(candidates.AZIMUTHS)), *order]
        left_out = self._left_out(row)
        return next((push for push in order if not left_out[push]), order[0])

    def _in_turn(self, rows: IntArray, seconds: FloatArray) -> int:
        """Return the taxel whose turn it is; a module that never answers, or is skipped, has had its turn too."""
        asked, own = self._pokes.asked, self._knowledge.own
        if self.method is not Method.MODULES:
            return Turns(self._places, self.plan.modules, asked, own).taxel(rows, seconds)
        tried = np.maximum(asked, self._pokes.unanswered)
        for row, sides in self._skips.items():
            tried[row] += len(sides)
        return Turns(self._places, self.plan.modules, tried, own).module_taxel(rows, seconds)

    def _fresh_gains(self, state: candidates.ChoiceState, rows: IntArray, phase: GuidePhase) -> FloatArray:
        """Return (m, d) the gains at `rows`, computed again only where something around them changed."""
        if phase is not self._gains_of:
            self._gains_of, self._stale[:] = phase, True
        anew = rows[self._stale[rows]]
        if anew.size:
            self._gains[anew] = candidates.predict_gains(state, anew, self._noise, _neighbour_share(phase))
            for row in self._skips.keys() & set(anew.tolist()):
                self._gains[row, self._left_out(row)] = -np.inf
            self._stale[anew] = False
        return self._gains[rows]

    def _away(self, places: FloatArray) -> FloatArray:
        """Return (m,) how far the hand has to go, metres."""
        hand = self._pokes.hand(self._places)
        if hand is None:
            return np.zeros(len(places))
        return np.sqrt(np.sum((places - hand) ** 2, axis=1))

    def _aim(self, row: int, push: FloatArray, missing: Sequence[Need]) -> FloatArray:
        """Return (3,) where to press: on the taxel; beside it where only balance is missing.

        That is on the side that its pokes have missed; for a depth that is pulled inward on the side to which the push leans,
        else on the other: such a poke pulls it back.
        """
        know, normal, off = self._knowledge, self._normals[row], np.zeros(3)
        # A poke that pulls the depth back moves the taxel: it settles afterwards.
        lopsided = {Need.BALANCE, Need.DEPTH, Need.SETTLED} if Need.DEPTH in missing else {Need.BALANCE}
        if not lopsided.issuperset(missing):
            return self._places[row]
        if Need.BALANCE in missing:
            off -= know.own[row] * know.beside[row]
        if Need.DEPTH in missing:
            off += know.own[row] * know.pulled[row] * (push / (push @ normal) - normal)
        size = float(np.sqrt(off @ off))
        return self._places[row] + off * min(1.0, AIM_MAX / size if size > 0 else 0.0)

    def _predicted(self, state: candidates.ChoiceState, row: int, push: int) -> tuple[float, float]:
        """Return a taxel's predicted rms error now and after a push at it, metres."""
        if self.method is not Method.MODULES:
            return candidates.predict_error(state, row, push, self._noise)
        # A module is known from all its pokes alike: the variance falls as one over them.
        before, pokes = float(self._solved[row]), int(self._own()[row])
        return before, before * float(np.sqrt(pokes / (pokes + 1.0))) if pokes else self.settings.wanted_by(self.method)

    def _aimed(self, state: candidates.ChoiceState, row: int, push: int) -> Target:
        """Return a push at a taxel as a target, with what it is predicted to gain."""
        direction = state.pushes[row, push]
        before, after = self._predicted(state, row, push)
        cosine = -float(direction @ state.normals[row])
        return Target(
            channel=int(self.plan.channels[row]),
            place=self._aim(row, direction, self._needs[row]),
            normal=state.normals[row],
            push=direction,
            tilt=float(np.arccos(np.clip(cosine, -1.0, 1.0))),
            before=before,
            after=after,
        )

    def axis_diversity(self, channel: int, evidence: Callable[[Collection[int]], Evidence]) -> AxisDiversity | None:
        """Return from where a taxel was poked, and what each further push is worth; None for an unknown taxel or place.

        `update` was called before; `evidence` is as there.
        """
        state, row = self._state, self._knowledge.row(channel) if self._knowledge.has(channel) else -1
        if state is None or row < 0 or not np.isfinite(self._places[row]).all():
            return None
        found, normal, estimate = evidence([channel]), self._normals[row], self._estimates[row]
        pokes, drawn = found.pokes.tolist(), self._drawn()
        off = np.array([self._pokes.place(poke, drawn) for poke in pokes]).reshape(-1, 3) - drawn[row]
        doubted: Mapping[int, float] = {} if estimate is None else estimate.doubted
        worth = candidates.predict_gains(state, np.array([row]), self._noise, _neighbour_share(self._gains_of))[0]
        return AxisDiversity(
            channel=channel,
            normal=normal,
            pushes=found.directions,
            offsets=off - (off @ normal)[:, None] * normal,
            own=found.weights == 1.0,
            trust=np.array([doubted.get(poke, 1.0) for poke in pokes]),
            beside=self._knowledge.beside[row],
            diversity=float(self._knowledge.diversity[row]),
            usable_tilt=self._usable,
            tried=self._pushes[row],
            worth=np.where(self._left_out(row), 0.0, worth),
        )
