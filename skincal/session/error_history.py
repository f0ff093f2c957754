"""How the error fell over a session's pokes: for each of them, what the pokes up to it would have given.

A point of the course is solved from the first k pokes that count now, and from nothing else. A poke that was taken out
leaves no trace in it, and a session that is opened again has the course that it had live, to the last bit.

Where the taxels' places are known, the error is the distance of an estimate to its taxel's place. Where they are not, it
is the error that the estimate predicts of itself (`Estimate.rms`).

Whether modules lie as planned, worked out beside an open session: asked for nothing, it does nothing.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.files.reference import Reference
from skincal.geometry import FloatArray, IntArray
from skincal.model.scene import Scene
from skincal.modules.health import LayoutMend, judged_modules, mend_modules
from skincal.modules.pose import ModuleModel
from skincal.session.part import Part
from skincal.session.session import Session
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Estimate, Method

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface

POINTS_MAX = 256
"""Most points of a course: about half the pixels of a plot in a side panel."""
PAUSE_MAX_S = 60.0
"""s. Longest pause between two pokes on the axis of time: a night between two halves of a session would hide both."""
STEP_S = 0.03
"""s. The background works on the past for so long at a time: about a picture, so that a window keeps half of the machine."""
TAXELS, MEAN, P95, MAX = range(4)
"""Columns of a spread: how many taxels it is of, and metres."""

Spreads: TypeAlias = Mapping[Method, FloatArray]
"""Errors at one point of the course, (1 + modules, 4) float: all taxels, then each module; columns as for `spreads_of`."""
Run = Callable[[Callable[[], Any], Callable[[Any], None]], None]
"""Does work beside the session and hands its result over in a tick."""


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSeries:
    """The course of errors over a session. Values between two points were left out, never averaged."""

    counts: IntArray
    """(n,) number of pokes that count at each point, ascending."""
    pokes: IntArray
    """(n,) number in the session of the last of them."""
    times: FloatArray
    """(n,) s since the first poke that counts; pauses beyond `PAUSE_MAX_S` are cut to it."""
    spreads: Mapping[Method, FloatArray]
    """(n, 1 + modules, 4) float; see `Spreads`."""
    stride: int
    """Every how many pokes there is a point; the newest is always one."""
    missing: int
    """Points that are not worked out yet."""


def spreads_of(errors: FloatArray, groups: IntArray, count: int) -> FloatArray:
    """Return number, mean, 95th percentile (numpy's, linear) and maximum of the errors of each group, (count, 4) float.

    Parameters
    ----------
    errors : (n,) float, metres, finite
    groups : (n,) int, 0 to count - 1; negative for none. One without an error has the number 0, and NaN
    """
    result = np.full((count, 4), np.nan)
    result[:, TAXELS] = 0.0
    # Group by group, and by size within each, so that percentile and maximum are places in it.
    order = np.lexsort((errors, groups))
    errors, bounds = errors[order], np.searchsorted(groups[order], np.arange(count + 1))
    for group, (start, end) in enumerate(pairwise(bounds.tolist())):
        if start < end:
            own = errors[start:end]
            # Not `np.quantile`, which takes ten times as long, for every module of a body at every point.
            place = 0.95 * (len(own) - 1)
            low = own[int(place)]
            p95 = low + place % 1.0 * (own[math.ceil(place)] - low)
            result[group] = len(own), own.mean(), p95, own[-1]
    return result


Rule: TypeAlias = Callable[[Mapping[Method, Sequence[Estimate]]], Spreads]
"""What counts as the error of an estimate."""


def error_rule(scene: Scene, known: Mapping[int, FloatArray] | None) -> Rule:
    """Return what gives the errors of each method's estimates.

    Parameters
    ----------
    scene : says which module a channel is of
    known : places of taxels by channel, (3,) float, metres, link frame; None for the predicted error
    """
    width, layout = scene.skin.channels, scene.skin.layout
    modules = 0 if layout is None else len(layout.modules)
    module_of = np.full(width, -1, dtype=np.int64) if layout is None else layout.module_of
    places = np.full((width, 3), np.nan)
    for channel, place in (known or {}).items():
        if 0 <= channel < width:
            places[channel] = place

    def spreads(estimates: Sequence[Estimate]) -> FloatArray:
        found = [e for e in estimates if e.position is not None and e.rms is not None]
        channels = np.array([e.channel for e in found], dtype=np.int64)
        errors = np.array([e.rms for e in found], dtype=float)
        if known is not None:
            positions = np.array([e.position for e in found], dtype=float).reshape(-1, 3)
            errors = np.linalg.norm(positions - places[channels], axis=1)
        there = np.isfinite(errors)
        channels, errors = channels[there], errors[there]
        everything = spreads_of(errors, np.zeros(len(errors), dtype=np.int64), 1)
        return np.concatenate([everything, spreads_of(errors, module_of[channels], modules)])

    return lambda estimates: {method: spreads(found) for method, found in estimates.items()}


class Recount:
    """Works out points of a course, some at a time; it shares nothing with the session, so that any thread may do it.

    Parameters
    ----------
    contacts : those that count, in the order of their numbers
    dead : channels that are not used
    wanted : after how many contacts there is to be a point, ascending; one at least
    """

    def __init__(
        self,
        scene: Scene,
        surface: Surface | None,
        rule: Rule,
        contacts: Sequence[Contact],
        dead: Mapping[int, str],
        wanted: Sequence[int],
    ) -> None:
        # Fed poke by poke like the live one, so that each point has the bits that it had then.
        self._session = Session(scene, surface)
        self._session.find_dead(dead)
        self._rule, self._contacts = rule, contacts
        # Backwards, since `pop` takes from the end.
        self._wanted, self._taken = list(reversed(wanted)), 0
        self.reach = wanted[-1]
        """How many of the contacts the points are made from."""

    @property
    def done(self) -> bool:
        """Whether every point was worked out."""
        return not self._wanted

    def work(self, seconds: float = math.inf) -> dict[int, Spreads]:
        """Return the next points by their count of contacts: what can be had in `seconds`, and one at least."""
        end = time.monotonic() + seconds
        points: dict[int, Spreads] = {}
        while self._wanted and (not points or time.monotonic() <= end):
            count = self._wanted[-1]
            for contact in self._contacts[self._taken : count]:
                self._session.add(contact)
            self._taken = count
            points[count] = self._rule(self._session.snapshot().estimates)
            self._wanted.pop()
        return points


class ErrorHistory:
    """The course of errors of a session that goes on.

    `take` follows the session and costs what the errors of one snapshot cost; what is missing then (the past of a session
    that is opened again, everything after a poke that was taken out) is worked out by a `Recount`, in any thread, and
    given back by `put`.

    What is `known` is as for `error_rule`.
    """

    def __init__(self, scene: Scene, surface: Surface | None, known: Mapping[int, FloatArray] | None) -> None:
        self._scene, self._surface = scene, surface
        self._rule = error_rule(scene, known)
        self._contacts: tuple[Contact, ...] = ()
        self._dead: Mapping[int, str] = {}
        self._points: dict[int, Spreads] = {}
        self._stride = 1
        self._recount: Recount | None = None

    def take(self, snapshot: Snapshot) -> None:
        """Take the session as it stands: what no longer holds of the past is dropped, the newest point is added."""
        contacts = snapshot.contacts
        same = _common(self._contacts, contacts) if dict(self._dead) == dict(snapshot.dead) else 0
        if self._recount is not None and same < self._recount.reach:
            self._recount = None
        count = len(contacts)
        self._contacts, self._dead, self._stride = contacts, snapshot.dead, stride_of(count)
        self._points = {
            at: point for at, point in self._points.items() if at <= same and (at % self._stride == 0 or at == count)
        }
        if count and count not in self._points:
            self._points[count] = self._rule(snapshot.estimates)

    def recount(self) -> Recount | None:
        """Return what is to be worked out, and the same until it is done or no longer holds; None where nothing is missing."""
        if self._recount is None or self._recount.done:
            wanted = [at for at in range(self._stride, len(self._contacts), self._stride) if at not in self._points]
            self._recount = None
            if wanted:
                self._recount = Recount(self._scene, self._surface, self._rule, self._contacts, self._dead, wanted)
        return self._recount

    def put(self, recount: Recount, points: Mapping[int, Spreads]) -> bool:
        """Take points that were worked out; return whether they still hold."""
        if recount is not self._recount:
            return False
        self._points |= {count: point for count, point in points.items() if count % self._stride == 0}
        return True

    def series(self) -> ErrorSeries:
        """Return the course as far as it is known."""
        counts = np.array(sorted(self._points), dtype=np.int64)
        points = [self._points[count] for count in counts.tolist()]
        methods: tuple[Method, ...] = tuple(points[-1]) if points else ()
        expected = len(range(self._stride, len(self._contacts), self._stride)) + bool(self._contacts)
        return ErrorSeries(
            counts=counts,
            pokes=np.array([contact.poke for contact in self._contacts], dtype=np.int64)[counts - 1],
            times=poking_times([contact.end_s for contact in self._contacts])[counts - 1],
            spreads={method: np.stack([point[method] for point in points]) for method in methods},
            stride=self._stride,
            missing=expected - len(counts),
        )


class ErrorFollower:
    """Follows the course of errors of an open session against what the operator chose; asked for nothing, it does nothing.

    The past is worked out in the background, a moment at a time: other work comes in between, and what no longer holds after
    an undo or an exclusion is dropped.
    """

    def __init__(self, part: Part, run: Run) -> None:
        self._part, self._run = part, run
        self.sources: list[Reference | None] = [None] if part.plan is None else [part.plan, None]
        """What estimates can be compared with; None for the error that they predict of themselves."""
        self.source = self.sources[0]
        self.version = 0
        """Another number where the course or its source is another."""
        self._history = self._begun()
        self._revision: int | None = None
        self._busy = False
        self._failed_at: tuple[ErrorHistory, int | None] | None = None
        """Course and revision whose work failed: tried again when either is another, and not at every picture."""

    def _begun(self) -> ErrorHistory:
        known = None if self.source is None else self.source.places
        return ErrorHistory(self._part.scene, self._part.surface, known)

    def offer(self, reference: Reference) -> None:
        """Take what was found or chosen, in place of another of its origin, and compare with it."""
        self.sources = [reference, *(other for other in self.sources if other is None or other.origin is not reference.origin)]
        self.choose(0)

    def choose(self, index: int) -> None:
        """Compare with another of `sources`."""
        if self.sources[index] is not self.source:
            self.source = self.sources[index]
            self._history, self._revision = self._begun(), None
            self.version += 1

    def follow(self, snapshot: Snapshot, revision: int) -> None:
        """Take a session as it stands, and let the background go on with what is missing of the past.

        `revision` is another number where pokes, estimates or dead taxels changed.
        """
        if revision != self._revision:
            self._revision = revision
            self._history.take(snapshot)
            self.version += 1
        if not self._busy and self._failed_at != (self._history, self._revision):
            self._work()

    def series(self) -> ErrorSeries:
        """Return the course as far as it is known."""
        return self._history.series()

    def _work(self) -> None:
        history, recount = self._history, self._history.recount()
        if recount is None:
            return
        begun = history, self._revision

        def work() -> dict[int, Spreads]:
            try:
                return recount.work(STEP_S)
            except BaseException:
                # `run` reports why, and does not call `take` then.
                self._failed_at, self._busy = begun, False
                raise

        def take(points: dict[int, Spreads]) -> None:
            self._busy = False
            if history is self._history and history.put(recount, points):
                self.version += 1

        self._busy = True
        self._run(work, take)


def stride_of(count: int) -> int:
    """Return every how many of `count` pokes there is a point: a power of two, so that a longer session keeps points."""
    return 1 << max(0, (count - 1) // POINTS_MAX).bit_length()


def poking_times(ends_s: Sequence[float]) -> FloatArray:
    """Return the time spent at each poke since the first, (n,) float, seconds.

    The host's clock starts anew with the machine, and a session may be taken up days later: a step back counts as nothing,
    one of more than `PAUSE_MAX_S` as that.
    """
    return np.cumsum(np.clip(np.diff(np.array(ends_s, dtype=float), prepend=ends_s[:1]), 0.0, PAUSE_MAX_S))


def _common(first: Sequence[Contact], second: Sequence[Contact]) -> int:
    """Return with how many of the same contacts both begin."""
    shorter = min(len(first), len(second))
    return next((at for at in range(shorter) if first[at] is not second[at]), shorter)


@dataclass(frozen=True, slots=True, eq=False)
class ModulesFound:
    """What was found in the estimates of one moment."""

    method: Method
    """Whose estimates were judged."""
    mend: LayoutMend
    """What is wrong with the modules, and how the layout is put right."""
    judged: int
    """Modules of which enough is known."""


class ModulesCheck:
    """Looks for mirrored, turned and swapped modules; the newest moment is judged, those that came meanwhile are not.

    Without a layout there is nothing to look for.
    """

    def __init__(self, part: Part, run: Run) -> None:
        self._part, self._run = part, run
        self._module_model: ModuleModel | None = None
        self._busy = False
        self._asked: int | None = None
        self.found: ModulesFound | None = None
        """None while nothing was judged."""

    def follow(self, snapshot: Snapshot, revision: int) -> None:
        """Judge a session as it stands, unless an older moment is still being judged; `revision` as for `ErrorFollower`."""
        layout = self._part.scene.skin.layout
        if layout is None or self._busy or revision == self._asked:
            return
        method = Method.SURFACE if self._part.surface is not None else Method.FREE
        estimates = {estimate.channel: estimate for estimate in snapshot.estimates.get(method, ())}
        if self._module_model is None:
            self._module_model = ModuleModel(layout, self._part.scene.skin.anchor, self._part.surface)
        model = self._module_model

        def work() -> ModulesFound:
            try:
                return ModulesFound(method, mend_modules(model, estimates), judged_modules(model, estimates))
            except BaseException:
                # `run` reports why, and does not call `_take` then.
                self._busy = False
                raise

        self._busy, self._asked = True, revision
        self._run(work, self._take)

    def _take(self, found: ModulesFound) -> None:
        self._busy, self.found = False, found
