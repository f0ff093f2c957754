"""The guide: follows a session by one method, and says what to poke next, why, and when it is enough.

It keeps no truth of its own: all follows from the contacts, the estimates and the operator's skips. It gives numbers and
reasons (`guidance.py`); the sentences are made in `skincal.words` and by the window.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.outcome import Contact, Outcome, Reason
from skincal.geometry import BoolArray, FloatArray, IntArray, orthonormal_pair
from skincal.guide.believed_positions import PlannedPlaces, believed_from_measured, planned_sheet_pokes
from skincal.guide.candidates import (
    PUSH_AZIMUTHS_TRIED,
    PUSHES_PER_TAXEL,
    GainCache,
    PokeChoice,
    answer_offsets,
    candidate_pushes,
    find_answering,
    next_module_taxel,
    next_taxel,
)
from skincal.guide.followed_estimates import FollowedEstimates
from skincal.guide.guidance import Guidance, GuidePhase, Target
from skincal.guide.moment import Moment
from skincal.guide.poke_history import PokeHistory, TargetOfPoke, with_axis
from skincal.guide.progress import (
    AxisDiversity,
    ContactFacts,
    GuideSettings,
    Need,
    Why,
    count_module_pokes_left,
    count_pokes_left,
    count_sheet_pokes_left,
    find_needs,
    give_up_reason,
    poke_interval,
)
from skincal.guide.robot_order import RobotPace, nearest_open_taxel, travel_seconds
from skincal.guide.surroundings import Surroundings
from skincal.guide.taxel_statistics import TaxelStatistics
from skincal.model.scene import NoiseSettings
from skincal.modules.pose_fit import CONTACT_TO_PAD_CENTRE_SD_FACTOR
from skincal.taxels.result import Estimate, Method, State

if TYPE_CHECKING:
    from skincal.guide.surface_search import SurfaceSearch
    from skincal.guide.turn_needs import TurnNeeds

NEIGHBOUR_GAIN_WEIGHT_IN_SWEEP = 0.6
"""Share of a poke's gain at the neighbours that counts in the sweep. The free method needs 86 pokes to 5 mm (median of 20
rigs); with a share of 1 it needs 93. See `docs/decisions/neighbours-in-the-sweep.md`."""
NEIGHBOUR_GAIN_WEIGHT_IN_OWN_POKES = 0.3
"""The same in the phase of own pokes: with 0 it takes 6 % more pokes to 3 mm, with 1 neighbours are pulled together."""
TARGET_MAX_OFFSET_FROM_TAXEL_M = 0.002
"""Largest distance of a target from its taxel; beyond, a neighbour would answer most."""
TARGET_MAX_CELL_SHARE = 0.45
"""On a sheet, largest distance of a target from its taxel in each direction, over the spacing: to the edge of its cell. With
targets on the taxels 67 % of them were inside their predicted regions (8 sheets of 48 taxels, 48 pokes), with this 90 %."""
CELL_SEQUENCE_STEPS = 0.7548776662466927, 0.5698402909980532
"""Steps of an even sequence over a square: powers of the inverse of the plastic number (Roberts 2018)."""
MAX_CANDIDATE_TAXELS_COMPARED = 150
"""The free method's number of candidates for the next target: two thirds those nearest to the hand, one third the neediest."""
SAME_SIDE_COSINE = float(np.cos(np.radians(25.0)))
"""Two pushes within this angle come from the same side: half the angle between two that are tried."""
AZIMUTH_STEP_IN_EIGHTH_TURNS = 3
"""Eighths of a turn between tilted pushes on a module: eight pushes come from eight sides, successive ones far apart."""
TAXELS_UPDATED_AT_ONCE = 512
"""Bounds the memory of a first look at a long session."""
MAX_SKIPS_PER_TAXEL_SIDE = 2
"""A side of a taxel that was skipped so often is left out."""


class Guide:
    """Chooses the next poke of a session by the needs of one method.

    Parameters
    ----------
    plan : positions of the taxels by the layout, if there is one
    search : places to poke without a layout; None with a layout
    surroundings : neighbours of the plan's taxels, for the modules method; None without a layout
    """

    def __init__(
        self,
        plan: PlannedPlaces,
        noise: NoiseSettings,
        method: Method,
        settings: GuideSettings | None = None,
        search: SurfaceSearch | None = None,
        surroundings: Surroundings | None = None,
    ) -> None:
        count = len(plan.channels)
        self.plan, self.method, self.settings = plan, method, settings or GuideSettings()
        self._noise, self._search = noise, search
        self._is_sheet = method is Method.MODULES and plan.sheet is not None
        self._in_plane, self._tilted = method is not Method.FREE, method is Method.MODULES and not plan.on_surface
        self._statistics = TaxelStatistics(plan.channels, noise, self.settings.unknown, self._in_plane)
        self._pokes = PokeHistory(plan.channels, self.settings)
        self._places, self._normals = plan.places.copy(), plan.normals.copy()
        # (n,) channels without a planned position: no taxels until they answer.
        self._unplanned: BoolArray = np.isnan(plan.places[:, 0])
        self._rig = 0.0
        self._others = NEIGHBOUR_GAIN_WEIGHT_IN_OWN_POKES
        self._gains = GainCache(count)
        followed = {Method.SURFACE, Method.FREE, method}
        self._followed: dict[Method, FollowedEstimates] = {
            each: FollowedEstimates(plan.channels, each, noise.skin) for each in followed
        }
        self._own_estimates = self._followed[method]
        self._moment: Moment | None = None
        self._usable_tilt = self._pokes.tilt.usable
        self._find_neighbours()
        self._choice: PokeChoice | None = None
        # Taxel and push of the last target, while nothing but its numbers changed.
        self._kept: tuple[int, int] | None = None
        # Skipped pushes of each taxel, by its index; and the taxel skipped last, until the next poke.
        self._skips: dict[int, list[FloatArray]] = {}
        self._just_skipped = -1
        self.session_skips = 0
        """Number of the session's skips that the guide knows."""
        self.robot: RobotPace | None = None
        """Pace of the robot that pokes; `None` for a hand."""
        self._needs: list[tuple[Need, ...]] = [()] * count
        # (n,) taxels with a need, those that need nothing but a touch, nothing but their turn, and those that need agreement.
        self._is_open, self._needs_touch_alone, self._needs_turn_alone, self._needs_agreement = np.zeros((4, count), dtype=bool)
        self.turns: TurnNeeds | None = None
        """Turns of taxels of three axes; `None` for other skins."""
        self._surroundings = surroundings if method is Method.MODULES else None
        # (n,) taxels that are touched, as they were at the last look, and those that are touched or surrounded by touched ones.
        self._touched: BoolArray = np.zeros(count, dtype=bool)
        self._covered: BoolArray = np.full(count, self._surroundings is None)
        self._unknown_error = float(np.sqrt(3.0)) * self.settings.unknown
        self._solved = np.full(count, self._unknown_error)

    def update(self, moment: Moment, target_of: TargetOfPoke, rig: float = 0.0) -> Guidance:
        """Update the guide to the session's present state, and choose the next poke.

        Only taxels whose pokes or estimates changed since the last update are computed again.

        Parameters
        ----------
        target_of : gives the target that was shown for a poke
        rig : m, sd of the shift of all estimates by the rig's errors in each direction, 0 if unknown
        """
        outcomes = moment.changes_since(self._moment)
        self._moment = moment
        # Positions on the mesh have the depth that few free pokes leave open.
        best = Method.SURFACE if moment.estimates.get(Method.SURFACE) else Method.FREE
        changed = {method: self._followed[method].update(moment.estimates[method]) for method in {best, self.method}}
        dirty = self._update_statistics(outcomes, self._followed[best], rig, target_of)
        for first in range(0, len(dirty), TAXELS_UPDATED_AT_ONCE):
            self._update_contacts(moment, dirty[first : first + TAXELS_UPDATED_AT_ONCE])
        turned = () if self.turns is None else self.turns.update(moment.turns)
        self._update_needs(np.union1d(changed[self.method], turned).astype(np.int64), dirty)
        return self._guidance()

    def _update_contacts(self, moment: Moment, dirty: IntArray) -> None:
        """Compute the statistics of the contacts of taxels, given by their indices (m,), again."""
        found, estimates = moment.evidence(self.plan.channels[dirty].tolist()), self._own_estimates.estimates
        trust = np.ones(len(found.pokes))
        rows: list[int] = self._pokes.rows(found.channels).tolist()
        for place, row in enumerate(rows):
            # A contact that the method doubts counts less here, too.
            if (estimate := estimates[row]) is not None and estimate.doubted:
                own = slice(*found.starts[place : place + 2].tolist())
                trust[own] = [estimate.doubted.get(poke, 1.0) for poke in found.pokes[own].tolist()]
        drawn = self._plan_positions()
        centres = {poke: self._pokes.place(poke, drawn) for poke in set(found.pokes.tolist())}
        self._statistics.recompute(dirty, found.trusted(trust), self._places, drawn, self._normals, centres)
        self._mark_stale_near(dirty)

    def estimate_of(self, channel: int) -> Estimate | None:
        """Estimate of a channel by the guide's method at the last `update`; `None` if the plan has no such taxel."""
        row = self._statistics.row_of.get(channel)
        return None if row is None else self._own_estimates.estimates[row]

    def skip(self, target: Target, *, is_impossible: bool = False) -> None:
        """Request another poke instead of a target. A side of a taxel that is skipped twice, or is impossible, is left out."""
        self._kept = None
        if target.channel is None and self._search is not None:
            self._search.skip(target.place)
        elif target.channel is not None and target.channel in self._statistics.row_of:
            self._just_skipped = self._statistics.row_of[target.channel]
            count = MAX_SKIPS_PER_TAXEL_SIDE if is_impossible else 1
            self._skips.setdefault(self._just_skipped, []).extend([target.push] * count)
            self._gains.mark_stale(self._just_skipped)

    def _update_statistics(
        self, outcomes: Mapping[int, Outcome | None], best: FollowedEstimates, rig: float, target_of: TargetOfPoke
    ) -> IntArray:
        """Follow the pokes; return the indices of the taxels with new, changed or removed contacts, ascending."""
        rows, added, removed = self._pokes.update(
            outcomes, target_of, self._plan_positions(), self._normals, self._answer_offsets
        )
        if added or removed:
            self._kept = None
        if any(isinstance(poke, Contact) for poke in added):
            self._just_skipped = -1
        if self._search is not None:
            for poke in added:
                answered = isinstance(poke, Contact)
                pressed = with_axis(poke) if answered or poke.reason is Reason.NO_TAXEL else None
                if pressed is not None:
                    self._search.add_poke(pressed, answered=answered)
            self._search.count_pokes({poke: outcome is not None for poke, outcome in outcomes.items()})
        if rows or rig != self._rig:
            if rig != self._rig:
                self._gains.mark_stale()
            self._rig = rig
            self._places = believed_from_measured(self.plan, best.positions, best.precisions, rig)
            self._add_unplanned([row for row in rows if self._unplanned[row]], best.estimates)
        if self._pokes.tilt.usable != self._usable_tilt:
            self._usable_tilt = self._pokes.tilt.usable
            self._pushes = candidate_pushes(self._normals, self._usable_tilt)
            self._gains.mark_stale()
            self._kept = None
        return np.array(sorted(rows), dtype=np.int64)

    def _plan_positions(self) -> FloatArray:
        """Positions (n, 3), metres, by the plan; believed ones of taxels without a plan.

        Offsets of pokes are measured from the plan: they stay the same while the skin's position becomes better known, and
        after a session is opened again.
        """
        return np.where(self._unplanned[:, None], self._places, self.plan.places)

    def _find_neighbours(self) -> None:
        self._neighbours = find_answering(self._places, self.plan.spacing, self._noise)
        self._answer_offsets = answer_offsets(self._places, self._neighbours)
        self._pushes = candidate_pushes(self._normals, self._usable_tilt)

    def _mark_stale_near(self, rows: Sequence[int] | IntArray) -> None:
        # The methods in the plane compare no gains.
        if len(rows) and not self._in_plane:
            self._gains.mark_stale(np.asarray(np.isin(self._neighbours.rows, rows).any(axis=1)))

    def _add_unplanned(self, rows: Sequence[int], estimates: Sequence[Estimate | None]) -> None:
        """Take the normals of channels without a planned position from their estimates."""
        for row in rows:
            estimate = estimates[row]
            if estimate is not None and estimate.normal is not None:
                self._normals[row] = estimate.normal
        if rows:
            self._find_neighbours()
            self._gains.mark_stale()

    def _update_needs(self, changed: IntArray, dirty: IntArray) -> None:
        """Find the needs of each taxel whose contacts or estimate changed.

        Parameters
        ----------
        changed, dirty : indices of the taxels with another estimate, and with other contacts
        """
        know, own = self._statistics, self._own_estimates
        rows = np.union1d(changed, dirty)
        if self._surroundings is not None:
            touched = np.flatnonzero(own.touched != self._touched)
            if len(touched):
                covered = self._surroundings.update_covered(self._covered, own.touched, touched)
                rows, self._covered = np.union1d(rows, np.flatnonzero(covered != self._covered)), covered
                self._touched[touched] = own.touched[touched]
        numbers = self._own(), know.diversity, know.offset_size, know.depth_bias, know.last_shift, self._covered
        facts = zip(*(column[rows].tolist() for column in numbers), strict=True)
        unseen: tuple[Need, ...] | None = None
        turned, indices = list[int](), list[int](rows.tolist())
        for row, each in zip(indices, facts, strict=True):
            estimate = own.estimates[row]
            assert estimate is not None
            if estimate.state is State.UNSEEN and self._unplanned[row]:
                needs = ()
            elif estimate.state is State.UNSEEN and unseen is not None:
                needs = unseen
            else:
                needs = find_needs(estimate, ContactFacts(*each), self.method, self.settings, self._noise.skin)
                # The same for all unseen taxels: on a large part they are thousands at first.
                unseen = needs if estimate.state is State.UNSEEN else unseen
            self._needs_touch_alone[row], self._needs_agreement[row] = needs == (Need.TOUCH,), Need.AGREEMENT in needs
            needs = self._with_turn(row, estimate, needs)
            if bool(self._needs[row]) != bool(needs):
                turned.append(row)
            self._needs[row], self._is_open[row] = needs, bool(needs)
            self._needs_turn_alone[row] = needs == (Need.TURN,)
        self._solved[rows] = np.minimum(own.errors[rows], self._unknown_error)
        self._mark_stale_near(turned)

    def _with_turn(self, row: int, estimate: Estimate, needs: tuple[Need, ...]) -> tuple[Need, ...]:
        """Add the need of a turn."""
        is_taxel = estimate.state is not State.DEAD and not (estimate.state is State.UNSEEN and self._unplanned[row])
        return (*needs, Need.TURN) if self.turns is not None and is_taxel and self.turns.is_open[row] else needs

    def _own(self) -> IntArray:
        """Own pokes (n,) of each taxel; by the modules method those of its module."""
        return self._of_module(self._statistics.own)

    def _of_module(self, counts: IntArray) -> IntArray:
        """By the modules method sum the taxels' counts (n,) over each one's module."""
        if self.method is not Method.MODULES:
            return counts
        return np.bincount(self.plan.modules, counts).astype(np.int64)[self.plan.modules]

    @cached_property
    def _planned_pokes(self) -> int:
        """Pokes that the sheets need by their plan."""
        return planned_sheet_pokes(self.plan, self._noise, self.settings) or 0

    def _guidance(self) -> Guidance:
        know, given_up, rms = self._statistics, self._given_up(), self._own_estimates.rms
        open_ = self._is_open.copy()
        open_[list(given_up)] = False
        choice = self._choice = PokeChoice(
            self._places, self._pushes, self._neighbours, know.information, self._normals, self._pokes.sensor,
            self.settings.wanted, self._in_plane, open_.astype(np.float64), self._solved, self._noise,
        )  # fmt: skip
        phase, place = self._phase(open_)
        target = None
        if place is not None and self._search is not None:
            normal = self._search.normals[place]
            target = Target(None, self._search.places[place], normal, -normal, 0.0, float("inf"), float("inf"))
        elif phase is not GuidePhase.ENOUGH:
            target = self._target(choice, phase)
        if self.method is Method.MODULES:
            errors = self._own_estimates.improvable
            touches = 0 if self._surroundings is None else self._surroundings.count_touches(open_ & ~self._covered)
            if self._is_sheet:
                pokes = int(know.own.sum())
                count = count_sheet_pokes_left(self._planned_pokes, pokes, open_, errors, self.settings, touches)
            else:
                count = count_module_pokes_left(open_, self.plan.modules, self._own(), errors, self.settings, touches)
        else:
            count = count_pokes_left(self.method, open_, know, rms, self.settings)
        if self.turns is not None:
            count = max(count, self.turns.count_pokes_left(open_, self.plan.modules))
        interval = poke_interval(self._pokes.latest_starts())
        shown = np.flatnonzero(~self._unplanned | (know.contacts > 0))
        return Guidance(
            method=self.method,
            phase=phase,
            target=target,
            channels=self.plan.channels[shown],
            places=self._places[shown],
            rms=rms[shown],
            diversity=know.diversity[shown],
            own=know.own[shown],
            needs=tuple(map(self._needs.__getitem__, shown.tolist())),
            given_up={int(self.plan.channels[row]): why for row, why in given_up.items()},
            usable_tilt=self._usable_tilt,
            pokes_left=count,
            seconds_left=None if interval is None else interval * count,
        )

    def _given_up(self) -> dict[int, Why]:
        """Find the taxels that the guide gives up although they need pokes, by their index."""
        know, settings, unanswered = self._statistics, self.settings, self._pokes.unanswered
        if self.method is Method.MODULES and not self._is_sheet:
            # Pokes that are aimed at a taxel, and answered by another module, must have an end, too.
            exhausted = np.maximum(self._own(), self._of_module(self._pokes.asked)) >= settings.module_patience
        else:
            exhausted = np.maximum(know.own, self._pokes.asked) >= settings.patience
        if self._surroundings is not None:
            # On a large module more taxels need a touch than a pose needs pokes: here each taxel has its own patience.
            exhausted = np.where(self._needs_touch_alone, self._pokes.asked >= settings.touch_patience, exhausted)
        tries = np.maximum(know.own, self._pokes.asked)
        exhausted = np.where(self._needs_agreement, tries >= settings.touch_patience, exhausted)
        exhausted = np.where(self._needs_turn_alone, tries >= settings.turn_patience, exhausted)
        # Of thousands of taxels only these can be given up: the others are not looked at.
        candidates = exhausted | ((know.contacts == 0) & (unanswered >= settings.unanswered))
        if self._usable_tilt < settings.diversity:
            candidates |= know.own >= settings.own_pokes
        candidates &= self._is_open
        found: dict[int, Why] = {}
        for row in {*np.flatnonzero(candidates).tolist(), *self._skips}:
            why = give_up_reason(
                self._needs[row],
                ContactFacts(int(know.own[row]), contacts=int(know.contacts[row]), unanswered=int(unanswered[row])),
                settings,
                patience_exhausted=bool(exhausted[row]),
                all_sides_skipped=bool(self._skipped_pushes(row).all()),
                tilt=self._usable_tilt,
            )
            if why is not None:
                found[row] = why
        return found

    def _phase(self, open_: BoolArray) -> tuple[GuidePhase, int | None]:
        """Choose the guide's phase (search or sweep), and the next point to press while it searches for taxels."""
        place = None if self._search is None else self._search.next_place(self._pokes.hand(self._places))
        if place is not None:
            return GuidePhase.COVER, place
        if not open_.any():
            # If nothing answered yet and no layout names taxels, nothing can be enough.
            return (GuidePhase.COVER if self._unplanned.all() and not self._pokes.contacts else GuidePhase.ENOUGH), None
        swept = len(self._pokes.contacts) >= self.settings.sweep * len(self.plan.channels)
        return (GuidePhase.OWN if self._in_plane or self._unplanned.all() or swept else GuidePhase.SWEEP), None

    def _target(self, choice: PokeChoice, phase: GuidePhase) -> Target | None:
        if self._kept is not None and choice.open[self._kept[0]] > 0:
            # Only the tare after a poke came: the hand is on its way already.
            return self._make_target(choice, *self._kept)
        rows = np.flatnonzero((choice.open > 0) & np.isfinite(choice.places).all(axis=1))
        # The one just skipped comes last.
        rows = others if (others := rows[rows != self._just_skipped]).size else rows
        if not rows.size:
            return None
        hand = self._pokes.hand(self._places)
        way = np.zeros(len(rows)) if hand is None else np.sqrt(np.sum((choice.places[rows] - hand) ** 2, axis=1))
        seconds = travel_seconds(way, self.robot, self.settings)
        if self._in_plane or self._needs_turn_alone[rows].all():
            # Taxels that need nothing but their turn gain no position.
            row = self._next_in_turn(rows, seconds)
            push = self._next_push(row)
        else:
            rows, seconds = self._stay(rows, seconds, phase)
            near = self._preselect(rows, seconds)
            self._others = NEIGHBOUR_GAIN_WEIGHT_IN_SWEEP if phase is GuidePhase.SWEEP else NEIGHBOUR_GAIN_WEIGHT_IN_OWN_POKES
            skipped = {row: self._skipped_pushes(row) for row in self._skips}
            gains = self._gains.gains(choice, rows[near], self._others, skipped) / seconds[near, None]
            best = int(gains.argmax())
            row, push = int(rows[near[best // gains.shape[1]]]), best % gains.shape[1]
            push = self._next_push(row) if self._needs_turn_alone[row] else push
        self._kept = row, push
        return self._make_target(choice, row, push)

    def _stay(self, rows: IntArray, seconds: FloatArray, phase: GuidePhase) -> tuple[IntArray, FloatArray]:
        """Keep a robot at the nearest open taxel, for pokes of several tilts in a row, once the sweep is over."""
        if self.robot is None or phase is GuidePhase.SWEEP:
            return rows, seconds
        row = nearest_open_taxel(rows, seconds, self._tried(), self._statistics.own, self.settings.own_pokes)
        return np.array([row]), seconds[rows == row]

    def _tried(self) -> IntArray:
        """Count (n,) the targets set at each taxel, also those that were skipped or not answered."""
        tried = np.maximum(self._pokes.asked, self._pokes.unanswered)
        for row, sides in self._skips.items():
            tried[row] += len(sides)
        return tried

    def _skipped_pushes(self, row: int) -> BoolArray:
        """Pushes (d,) at a taxel from sides that were skipped too often."""
        skips = self._skips.get(row)
        if skips is None:
            return np.zeros(PUSHES_PER_TAXEL, dtype=bool)
        same_side = self._pushes[row] @ np.array(skips).T > SAME_SIDE_COSINE
        return np.sum(same_side, axis=1) >= MAX_SKIPS_PER_TAXEL_SIDE

    def _preselect(self, rows: IntArray, seconds: FloatArray) -> IntArray:
        """Select the indices of `rows` to compare; all if they are few."""
        if len(rows) <= MAX_CANDIDATE_TAXELS_COMPARED:
            return np.arange(len(rows))
        nearest, neediest = seconds.argsort(kind="stable"), np.lexsort((seconds, self._statistics.contacts[rows]))
        return np.union1d(nearest[: 2 * MAX_CANDIDATE_TAXELS_COMPARED // 3], neediest[: MAX_CANDIDATE_TAXELS_COMPARED // 3])

    def _next_push(self, row: int) -> int:
        """Choose the push at a taxel in turn: along the normal; for modules without a mesh, from another side each time."""
        order = list(range(PUSHES_PER_TAXEL))
        if self._tilted:
            # The pushes of the largest tilt come last, one for each azimuth.
            turn, tilted = AZIMUTH_STEP_IN_EIGHTH_TURNS * int(self._own()[row]), order[-PUSH_AZIMUTHS_TRIED:]
            order = [*(tilted[(turn + step) % PUSH_AZIMUTHS_TRIED] for step in range(PUSH_AZIMUTHS_TRIED)), *order]
        elif self.turns is not None and self.turns.is_open[row]:
            order = [*self.turns.leaning_pushes(row, self._usable_tilt), *order]
        skipped = self._skipped_pushes(row)
        return next((push for push in order if not skipped[push]), order[0])

    def _next_in_turn(self, rows: IntArray, seconds: FloatArray) -> int:
        """Choose the taxel in turn; a module that never answers, or is skipped, has had its turn too."""
        own = self._statistics.own
        if self.method is not Method.MODULES:
            return next_taxel(rows, seconds, self._pokes.asked, own)
        return next_module_taxel(rows, seconds, self._tried(), own, self.plan.modules, self._places)

    def _aim(self, row: int, push: FloatArray, missing: Sequence[Need]) -> FloatArray:
        """Choose where to press, (3,) metres: on the taxel, or off it if nothing but balance is missing.

        A poke on the half that the contacts missed balances them. A depth that is biased inward is corrected on the side to
        which the push leans, one biased outward on the other.
        """
        know, normal, off = self._statistics, self._normals[row], np.zeros(3)
        if self._is_sheet:
            # A taxel that lacks a touch alone, or contradicts its place, is to answer, and not a neighbour.
            is_on_taxel = Need.AGREEMENT in missing or tuple(missing) == (Need.TOUCH,)
            return self._places[row] + (np.zeros(3) if is_on_taxel else self._off_taxel(row))
        # A poke that corrects the depth moves the taxel: it settles afterwards.
        balancing = {Need.BALANCE, Need.DEPTH, Need.SETTLED} if Need.DEPTH in missing else {Need.BALANCE}
        if not balancing.issuperset(missing):
            return self._places[row]
        if Need.BALANCE in missing:
            off -= know.own[row] * know.offset[row]
        if Need.DEPTH in missing:
            off += know.own[row] * know.depth_bias[row] * (push / (push @ normal) - normal)
        size = float(np.sqrt(off @ off))
        return self._places[row] + off * min(1.0, TARGET_MAX_OFFSET_FROM_TAXEL_M / size if size > 0 else 0.0)

    def _off_taxel(self, row: int) -> FloatArray:
        """Choose how far off a sheet's taxel to press, (3,) metres: all over its cell, and at its middle if it did not answer.

        Presses at the believed position confirm it, right or wrong, while no neighbour is near enough to answer in its place.
        """
        unanswered = self._pokes.unanswered
        # The cell of a single taxel has no size.
        if unanswered[row] or not np.isfinite(self.plan.spacing):
            return np.zeros(3)
        number = len(self._pokes.contacts) + int(unanswered.sum())
        shares = (0.5 + number * np.array(CELL_SEQUENCE_STEPS)) % 1.0 - 0.5
        return 2.0 * TARGET_MAX_CELL_SHARE * self.plan.spacing * shares @ orthonormal_pair(self._normals[row][None])[0]

    def _make_target(self, choice: PokeChoice, row: int, push: int) -> Target:
        direction = choice.pushes[row, push]
        if self._is_sheet:
            # A poke tells where the taxel is to the contact's noise; the rest of the sheet tells the error before.
            before, poke = float(self._solved[row]), 2.0 * (CONTACT_TO_PAD_CENTRE_SD_FACTOR * self._noise.contact) ** 2
            after = float(np.sqrt(1.0 / (1.0 / before**2 + 1.0 / poke)))
        elif self.method is Method.MODULES:
            # A module is known from all its pokes alike: the variance falls as one over them.
            before, pokes = float(self._solved[row]), int(self._own()[row])
            after = before * float(np.sqrt(pokes / (pokes + 1.0))) if pokes else self.settings.wanted_by(self.method)
        else:
            before, after = choice.predict_error(row, push)
        cosine = -float(direction @ choice.normals[row])
        turn_now, turn_after = (np.nan, np.nan) if self.turns is None else self.turns.gain(row, choice.normals[row], direction)
        return Target(
            channel=int(self.plan.channels[row]),
            place=self._aim(row, direction, self._needs[row]),
            normal=choice.normals[row],
            push=direction,
            tilt=float(np.arccos(np.clip(cosine, -1.0, 1.0))),
            rms_now=before,
            rms_after=after,
            turn_now=turn_now,
            turn_after=turn_after,
        )

    def axis_diversity(self, channel: int, moment: Moment) -> AxisDiversity | None:
        """Describe the contacts of a taxel and the gain of each further push; `None` before `update`, or without a position.

        `moment` is that of the last `update`.
        """
        choice, row = self._choice, self._statistics.row_of.get(channel, -1)
        if choice is None or row < 0 or not np.isfinite(self._places[row]).all():
            return None
        found, normal = moment.evidence([channel]), self._normals[row]
        pokes, drawn = found.pokes.tolist(), self._plan_positions()
        off = np.array([self._pokes.place(poke, drawn) for poke in pokes]).reshape(-1, 3) - drawn[row]
        estimate = self._own_estimates.estimates[row]
        doubted: Mapping[int, float] = {} if estimate is None else estimate.doubted
        worth = choice.predict_gains(np.array([row]), self._others)[0]
        return AxisDiversity(
            channel=channel,
            normal=normal,
            pushes=found.directions,
            offsets=off - (off @ normal)[:, None] * normal,
            own=found.weights == 1.0,
            trust=np.array([doubted.get(poke, 1.0) for poke in pokes]),
            beside=self._statistics.offset[row],
            diversity=float(self._statistics.diversity[row]),
            usable_tilt=self._usable_tilt,
            tried=self._pushes[row],
            worth=np.where(self._skipped_pushes(row), 0.0, worth),
        )
