"""The guide: follows what was measured, and says what to poke next, why, and when it is enough.

It knows no truth of its own: all of it follows from the contacts, the estimates and what the operator skipped.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from skincal.contacts.outcome import Contact
from skincal.estimate.evidence import Evidence
from skincal.estimate.result import Estimate, Method, State
from skincal.guide import choose
from skincal.guide.done import Facts, Need, needs
from skincal.guide.knowledge import Knowledge
from skincal.guide.places import Plan, believed
from skincal.guide.settings import GuideSettings
from skincal.readings import FloatArray, IntArray
from skincal.scene import NoiseSettings

BoolArray: TypeAlias = NDArray[np.bool_]

OTHERS = 0.3
"""Share of what a poke tells of the neighbours that counts in the phase of own pokes: none of it takes 6 % more pokes to 3 mm,
all of it pulls neighbours together in the long run."""
AIM_MAX = 0.002
"""m: no poke is asked for farther beside its taxel, or a neighbour would answer most."""
NEAR = 150
"""Taxels among which the free method's next target is looked for where there are more: two thirds of them those nearest to the
hand, one third the neediest."""
SAME_SIDE = float(np.cos(np.radians(25.0)))
"""Cosine of the angle within which two pushes come from the same side: half the way between two that are tried."""
SKIPPED = 2
"""A side of a taxel that was skipped so often is left out."""


class Phase(Enum):
    """What the guide is after; the value is its name."""

    SWEEP = "sweep"
    OWN = "own pokes"
    ENOUGH = "enough"


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """The poke that is asked for, link frame."""

    channel: int
    place: FloatArray
    """(3,) float, metres."""
    normal: FloatArray
    """(3,) float, unit, outward."""
    push: FloatArray
    """(3,) float, unit: which way the tool pushes."""
    tilt: float
    """rad, of the push from the normal."""
    before: float
    """m, the taxel's predicted rms error now."""
    after: float
    """m, and after the poke."""


@dataclass(frozen=True, slots=True, eq=False)
class Guidance:
    """What the guide says at one moment, of n taxels."""

    method: Method
    """The solver it follows."""
    phase: Phase
    target: Target | None
    channels: IntArray
    """(n,) ascending."""
    places: FloatArray
    """(n, 3) float, metres, believed; NaN where nothing is known."""
    rms: FloatArray
    """(n,) float, metres: predicted error; infinite while there is none."""
    diversity: FloatArray
    """(n,) float, rad."""
    own: IntArray
    """(n,) pokes of their own."""
    needs: tuple[tuple[Need, ...], ...]
    """For each taxel what is not met yet; none where it is done."""

    @property
    def done(self) -> int:
        """How many taxels are done."""
        return sum(not each for each in self.needs)


@dataclass(frozen=True, slots=True, eq=False)
class Felt:
    """Where a poke was by the answers, told from a taxel: its place is better known later on."""

    row: int
    """Index of the taxel that answered most; -1 where none is a taxel."""
    beside: FloatArray
    """(3,) float, metres; NaN where none is a taxel."""


class Guide:
    """Follows a session by one method.

    Parameters
    ----------
    plan : where the layout puts the taxels
    noise : the rig's
    method : the solver whose needs count
    spacing : m, usual distance of neighbours
    """

    def __init__(
        self, plan: Plan, noise: NoiseSettings, method: Method, spacing: float, settings: GuideSettings | None = None
    ) -> None:
        self.plan, self.method, self.settings = plan, method, settings or GuideSettings()
        self._noise = noise
        self._in_plane = method is Method.SURFACE
        self._knowledge = Knowledge(plan.channels, noise, self.settings.unknown, self._in_plane)
        self._contacts: dict[int, Contact] = {}
        self._pokes: dict[int, Felt] = {}
        self._places = plan.places.copy()
        self._neighbours = choose.find_neighbours(self._places, spacing, noise)
        self._pulls = choose.pulls(self._places, self._neighbours)
        self._gains = np.full((len(plan.channels), choose.TRIES), -np.inf)
        self._pushes = choose.directions(plan.normals, self.settings.usable_tilt)
        self._gains_of: Phase | None = None
        self._stale = np.ones(len(plan.channels), dtype=bool)
        self._asked: IntArray = np.zeros(len(plan.channels), dtype=np.int64)
        """How often each taxel was the target of a poke."""
        self._last: Target | None = None
        self._skips: dict[int, list[FloatArray]] = {}
        """The sides of each taxel, by its index, that were skipped."""
        self._not_now = -1
        """Index of the taxel that was skipped last, until the next poke."""
        self._estimates: list[Estimate | None] = [None] * len(plan.channels)
        self._needs: list[tuple[Need, ...]] = [()] * len(plan.channels)
        self._nothing = float(np.sqrt(3.0)) * self.settings.unknown
        self._solved = np.full(len(plan.channels), self._nothing)
        self._hand: FloatArray | None = None
        self._sensor = np.zeros(3)

    def update(
        self,
        contacts: Mapping[int, Contact],
        estimates: Mapping[Method, Sequence[Estimate]],
        evidence: Callable[[Collection[int]], Evidence],
    ) -> Guidance:
        """Take what a session holds now, and say what is to be done.

        Parameters
        ----------
        contacts : those that count, by the number of their poke
        estimates : of each method, one a taxel in the plan's order
        evidence : gives what is known of some channels
        """
        dirty = self._take(contacts, estimates)
        if dirty:
            doubted = {one.channel: one.doubted for one in estimates[self.method] if one.channel in dirty}
            told = evidence(dirty)
            pairs = zip(told.channels[told.taxels].tolist(), told.pokes.tolist(), strict=True)
            trust = [doubted[channel].get(poke, 1.0) for channel, poke in pairs]
            centres = {poke: self._centre(poke) for poke in set(told.pokes.tolist())}
            self._knowledge.renew(dirty, told.trusted(np.array(trust)), self._places, self.plan.normals, centres)
            rows = np.array([self._knowledge.row(channel) for channel in dirty])
            self._stale |= np.isin(self._neighbours.rows, rows).any(axis=1)
        self._renew_needs(estimates[self.method], dirty)
        return self._guidance(estimates[self.method])

    def skip(self) -> None:
        """Ask for something else than the last target; a side of a taxel that is skipped twice is asked for no more."""
        if self._last is not None:
            self._not_now = self._knowledge.row(self._last.channel)
            self._skips.setdefault(self._not_now, []).append(self._last.push)
            self._stale[self._not_now] = True

    def _take(self, contacts: Mapping[int, Contact], estimates: Mapping[Method, Sequence[Estimate]]) -> set[int]:
        """Take the contacts that are new or changed, leave out those that are gone; return whose taxels they touch."""
        gone = [poke for poke in self._contacts if poke not in contacts]
        new = [poke for poke, contact in contacts.items() if self._contacts.get(poke) is not contact]
        touched = [self._contacts[poke] for poke in (*gone, *new) if poke in self._contacts]
        for poke in gone:
            del self._contacts[poke], self._pokes[poke]
        if not touched and not new:
            return set()
        best = estimates.get(Method.SURFACE) or estimates[Method.FREE]
        self._places = believed(self.plan, best)
        # A poke is told twice: it was asked for once.
        fresh = [contacts[poke] for poke in new if poke not in self._contacts]
        if fresh:
            self._not_now = -1
            self._count_asked(fresh)
        if new:
            told = [contacts[poke] for poke in new]
            touched += told
            self._contacts.update(zip(new, told, strict=True))
            self._pokes.update(zip(new, self._felt(told), strict=True))
            newest = contacts[max(new)]
            self._hand, self._sensor = self._centre(newest.poke), newest.link_from_sensor[:3, 3]
        return {channel for contact in touched for channel in contact.channels.tolist() if self._knowledge.has(channel)}

    def _count_asked(self, fresh: Sequence[Contact]) -> None:
        """Count whom new pokes were meant for: the target, if one was asked for, else who answered most."""
        if self._last is not None and len(fresh) == 1:
            self._asked[self._knowledge.row(self._last.channel)] += 1
            return
        for contact in fresh:
            peak = int(contact.channels[contact.responses.argmax()])
            if self._knowledge.has(peak):
                self._asked[self._knowledge.row(peak)] += 1

    def _centre(self, poke: int) -> FloatArray:
        """Return (3,) where a poke was by the answers, metres; NaN where no taxel answered."""
        felt = self._pokes[poke]
        return self._places[felt.row] + felt.beside

    def _felt(self, contacts: Sequence[Contact]) -> list[Felt]:
        """Return where pokes were by the answers.

        That is the middle of the taxels that answered, weighted by their answers, less what it is off where the taxel that
        answered most is poked right upon: at the skin's edge there is nobody to answer on the other side.
        """
        sizes = np.array([len(contact.channels) for contact in contacts])
        starts = np.concatenate([[0], sizes.cumsum()])
        owner = np.arange(len(contacts)).repeat(sizes)
        rows = self._knowledge.rows(np.concatenate([contact.channels for contact in contacts]))
        responses = np.where(rows >= 0, np.concatenate([contact.responses for contact in contacts]), 0.0)
        peaks = rows[[a + int(responses[a:b].argmax()) for a, b in pairwise(starts.tolist())]]
        sums = np.zeros((len(contacts), 4))
        np.add.at(sums[:, :3], owner, responses[:, None] * np.nan_to_num(self._places[rows] - self._places[peaks][owner]))
        np.add.at(sums[:, 3], owner, responses)
        with np.errstate(invalid="ignore"):
            beside = sums[:, :3] / sums[:, 3:] - self._pulls[peaks]
        return [Felt(int(peak), off) for peak, off in zip(peaks.tolist(), beside, strict=True)]

    def _renew_needs(self, estimates: Sequence[Estimate], dirty: Collection[int]) -> None:
        """Say anew what those taxels need whose contacts or estimates changed."""
        know, turned = self._knowledge, list[int]()
        beside = np.sqrt(np.sum(know.beside * know.beside, axis=1))
        facts = zip(*map(np.ndarray.tolist, (know.own, know.diversity, beside, know.moved)), strict=True)
        nothing: tuple[Need, ...] | None = None
        for row, (one, each) in enumerate(zip(estimates, facts, strict=True)):
            if one is self._estimates[row] and one.channel not in dirty:
                continue
            if one.state is State.UNSEEN:
                # The same for all of them: in a large part they are thousands at first.
                nothing = now = nothing or needs(one, Facts(*each), self.method, self.settings)
            else:
                now = needs(one, Facts(*each), self.method, self.settings)
            if bool(self._needs[row]) != bool(now):
                turned.append(row)
            self._estimates[row], self._needs[row] = one, now
            told = one.sd if one.rms is None else one.rms
            self._solved[row] = min(self._nothing if told is None else told, self._nothing)
        self._stale |= np.isin(self._neighbours.rows, turned).any(axis=1)

    def _guidance(self, estimates: Sequence[Estimate]) -> Guidance:
        know, missing = self._knowledge, tuple(self._needs)
        rms = np.array([np.inf if one.rms is None else one.rms for one in estimates])
        state = choose.State(
            self._places, self._pushes, self._neighbours, know.information,
            self.plan.normals, self._sensor, self.settings.wanted, self._in_plane,
            np.array([1.0 if each else 0.0 for each in missing]), self._solved,
        )  # fmt: skip
        phase = self._phase(missing)
        self._last = None if phase is Phase.ENOUGH else self._target(state, phase, missing)
        return Guidance(
            self.method,
            phase,
            self._last,
            self.plan.channels,
            self._places,
            rms,
            know.diversity.copy(),
            know.own.copy(),
            missing,
        )

    def _phase(self, missing: Sequence[tuple[Need, ...]]) -> Phase:
        if not any(missing):
            return Phase.ENOUGH
        if self._in_plane or len(self._contacts) >= self.settings.sweep * len(self.plan.channels):
            return Phase.OWN
        return Phase.SWEEP

    def _target(self, state: choose.State, phase: Phase, missing: Sequence[tuple[Need, ...]]) -> Target | None:
        rows = self._eligible(state)
        if not rows.size:
            return None
        seconds = self.settings.poke_s + self._away(state.places[rows]) / self.settings.hand_speed
        if self._in_plane:
            row = self._evenly(rows, seconds)
            push = int(self._left_out(state, row).argmin())
        else:
            near = self._near(rows, seconds)
            gains = self._fresh_gains(state, rows[near], phase) / seconds[near, None]
            best = int(gains.argmax())
            row, push = int(rows[near[best // gains.shape[1]]]), best % gains.shape[1]
        return self._told(state, row, push, missing)

    def _eligible(self, state: choose.State) -> IntArray:
        """Return the taxels that may be asked for: they need something, are somewhere, and some side of them is left."""
        rows = np.flatnonzero((state.open > 0) & np.isfinite(state.places).all(axis=1))
        shut = [row for row in self._skips if self._left_out(state, row).all()]
        others = rows[~np.isin(rows, [*shut, self._not_now])]
        return others if others.size else rows[~np.isin(rows, shut)]

    def _left_out(self, state: choose.State, row: int) -> BoolArray:
        """Return (d,) which pushes at a taxel come from sides that were skipped."""
        skips = self._skips.get(row)
        if skips is None:
            return np.zeros(choose.TRIES, dtype=bool)
        alike: FloatArray = state.pushes[row] @ np.array(skips).T
        often: IntArray = np.sum(alike > SAME_SIDE, axis=1)
        return often >= SKIPPED

    def _near(self, rows: IntArray, seconds: FloatArray) -> IntArray:
        """Return which of `rows` to look at, all of them where they are few."""
        if len(rows) <= NEAR:
            return np.arange(len(rows))
        known = self._knowledge.contacts[rows]
        nearest, neediest = seconds.argsort(kind="stable"), np.lexsort((seconds, known))
        both: IntArray = np.union1d(nearest[: 2 * NEAR // 3], neediest[: NEAR // 3])
        return both

    def _evenly(self, rows: IntArray, seconds: FloatArray) -> int:
        """Return the taxel whose turn it is, round by round; of several the one that is reached soonest.

        A poke of its own is a turn, asked for or not. One that was asked for and missed is asked for once more in a round, and
        no more often: who cannot be reached must not keep the others waiting.
        """
        asked, own = self._asked[rows], self._knowledge.own[rows]
        turn = np.maximum(own, np.maximum(np.minimum(asked, own + 1), asked - 1))
        first = np.flatnonzero(turn == turn.min())
        return int(rows[first[seconds[first].argmin()]])

    def _fresh_gains(self, state: choose.State, rows: IntArray, phase: Phase) -> FloatArray:
        """Return (m, d) the gains at `rows`, worked out anew only where something around them changed."""
        if phase is not self._gains_of:
            self._gains_of, self._stale[:] = phase, True
        anew = rows[self._stale[rows]]
        if anew.size:
            self._gains[anew] = choose.gains(state, anew, self._noise, 1.0 if phase is Phase.SWEEP else OTHERS)
            for row in self._skips.keys() & set(anew.tolist()):
                self._gains[row, self._left_out(state, row)] = -np.inf
            self._stale[anew] = False
        return self._gains[rows]

    def _away(self, places: FloatArray) -> FloatArray:
        """Return (m,) how far the hand has to go, metres."""
        if self._hand is None or not np.isfinite(self._hand).all():
            return np.zeros(len(places))
        return np.sqrt(np.sum((places - self._hand) ** 2, axis=1))

    def _aim(self, row: int, missing: Sequence[Need]) -> FloatArray:
        """Return (3,) where to press: where nothing but balance is missing, on the side that the taxel's pokes have missed."""
        know = self._knowledge
        off = -know.own[row] * know.beside[row] if tuple(missing) == (Need.BALANCE,) else np.zeros(3)
        size = float(np.sqrt(off @ off))
        return self._places[row] + off * min(1.0, AIM_MAX / size if size > 0 else 0.0)

    def _told(self, state: choose.State, row: int, push: int, missing: Sequence[tuple[Need, ...]]) -> Target:
        direction = state.pushes[row, push]
        before, after = choose.foretold(state, row, push, self._noise)
        cosine = -float(direction @ state.normals[row])
        return Target(
            channel=int(self.plan.channels[row]),
            place=self._aim(row, missing[row]),
            normal=state.normals[row],
            push=direction,
            tilt=float(np.arccos(np.clip(cosine, -1.0, 1.0))),
            before=before,
            after=after,
        )
