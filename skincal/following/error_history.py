"""Course of the error over a session's pokes, and the check whether modules lie as planned. Both run beside an open session.

Point k of the course is solved from the first k pokes that count now. An excluded poke leaves no trace, and a reopened session
has the same course to the last bit. The error is the distance to the taxel's known position, else the predicted error
(`known_error`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.files.reference import TaxelPositions
from skincal.following.background import BackgroundJob, Run
from skincal.geometry import FloatArray, IntArray
from skincal.model.actions import Exclude, Restore
from skincal.model.scene import Scene
from skincal.modules.health import LayoutRepair, count_judged_modules, repair_layout
from skincal.modules.pose import ModuleModel
from skincal.part.part import Part
from skincal.rig.correction import RIG, Correction
from skincal.session.session import Session
from skincal.session.snapshot import Snapshot, snapshot_of
from skincal.taxels.result import Estimate, Method
from skincal.taxels.shared_errors import known_error

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface

ERROR_HISTORY_MAX_POINTS = 256
"""Maximum number of points: about half the pixels of a plot in a side panel."""
SHOWN_PAUSE_MAX_S = 60.0
"""s. Longer pauses are cut to this on the time axis: a night between two halves of a session would hide both."""
MAX_WORK_PER_STEP_S = 0.03
"""s of one background step: about one picture, so that the window keeps half of the machine."""
TAXELS, MEAN, P95, MAX = range(4)
"""Columns of a spread: number of taxels, then metres."""

Spreads: TypeAlias = Mapping[Method, FloatArray]
"""Errors at one point of the course, (1 + modules, 4) float: all taxels, then each module; columns as for `spreads_of`."""


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSeries:
    """Course of errors over a session, thinned and never averaged."""

    counts: IntArray
    """(n,) number of counting pokes at each point, ascending."""
    pokes: IntArray
    """(n,) poke number of the last of them."""
    times: FloatArray
    """(n,) s since the first counting poke, with pauses up to `SHOWN_PAUSE_MAX_S`."""
    spreads: Mapping[Method, FloatArray]
    """(n, 1 + modules, 4) float; see `Spreads`."""
    stride: int
    """Number of pokes between points; the newest is always a point."""
    missing: int
    """Number of points that are not solved yet."""


def spreads_of(errors: FloatArray, groups: IntArray, count: int) -> FloatArray:
    """Compute number, mean, 95th percentile (numpy's, linear) and maximum of the errors of each group, (count, 4) float.

    Parameters
    ----------
    errors : (n,) float, metres, finite
    groups : (n,) int, 0 to count - 1; negative for none. A group without errors has the number 0, and NaN
    """
    result = np.full((count, 4), np.nan)
    result[:, TAXELS] = 0.0
    # Sorted by size within each group, so that percentile and maximum are entries.
    order = np.lexsort((errors, groups))
    errors, bounds = errors[order], np.searchsorted(groups[order], np.arange(count + 1))
    for group, (start, end) in enumerate(pairwise(bounds.tolist())):
        if start < end:
            own = errors[start:end]
            # `np.quantile` takes ten times as long.
            place = 0.95 * (len(own) - 1)
            low = own[int(place)]
            p95 = low + place % 1.0 * (own[math.ceil(place)] - low)
            result[group] = len(own), own.mean(), p95, own[-1]
    return result


Rule: TypeAlias = Callable[[Snapshot], Spreads]
"""Computes the errors of a snapshot's estimates."""


def error_rule(scene: Scene, known: Mapping[int, FloatArray] | None) -> Rule:
    """Make the function that computes the errors of each method's estimates.

    Parameters
    ----------
    scene : for the modules of the channels
    known : positions of taxels by channel, (3,) float, metres, link frame; `None` for the predicted error
    """
    width, layout = scene.skin.channels, scene.skin.layout
    modules = 0 if layout is None else len(layout.modules)
    module_of = np.full(width, -1, dtype=np.int64) if layout is None else layout.module_of
    places = np.full((width, 3), np.nan)
    for channel, place in (known or {}).items():
        if 0 <= channel < width:
            places[channel] = place

    def spreads(estimates: Sequence[Estimate], part_size: float) -> FloatArray:
        found = [e for e in estimates if e.position is not None and e.rms is not None]
        channels = np.array([e.channel for e in found], dtype=np.int64)
        errors = np.array([known_error(e, part_size) for e in found], dtype=float)
        if known is not None:
            positions = np.array([e.position for e in found], dtype=float).reshape(-1, 3)
            errors = np.linalg.norm(positions - places[channels], axis=1)
        there = np.isfinite(errors)
        channels, errors = channels[there], errors[there]
        everything = spreads_of(errors, np.zeros(len(errors), dtype=np.int64), 1)
        return np.concatenate([everything, spreads_of(errors, module_of[channels], modules)])

    return lambda now: {method: spreads(found, now.part_size) for method, found in now.estimates.items()}


def _count_common(first: Snapshot, second: Snapshot) -> int:
    """Count the equal contacts at the beginning of two moments; 0 if dead channels or the rig's correction differ."""
    if dict(first.dead) != dict(second.dead) or _rig_correction(first) is not _rig_correction(second):
        return 0
    return _common(first.contacts, second.contacts)


def _rig_correction(snapshot: Snapshot) -> Correction | None:
    """Find the correction of the rig in use, whose uncertainty is part of the predicted error."""
    used = snapshot.decisions.corrections.get(RIG)
    return None if used is None else used.correction


class ErrorCourse:
    """Course of errors of an open session.

    `update` adds the newest point from a snapshot. The points before it that are missing (after a session is opened, or after a
    poke is excluded) are solved by `work`, in any one thread, and added by `add_points`.

    Parameters
    ----------
    known : as for `error_rule`
    """

    def __init__(self, scene: Scene, surface: Surface | None, known: Mapping[int, FloatArray] | None) -> None:
        self._rule = error_rule(scene, known)
        self._newest = snapshot_of((), {})
        self._points: Mapping[int, Spreads] = {}
        """By the number of contacts; replaced and never changed, since `work` reads it."""
        self._stride = 1
        self._scene, self._surface = scene, surface
        self._fed: tuple[Contact, ...] = ()
        """Contacts that count in `_replica`."""

    def update(self, snapshot: Snapshot) -> None:
        """Remove outdated points of the error curve, and add the newest."""
        before, self._newest = self._newest, snapshot
        same, count = _count_common(snapshot, before), len(snapshot.contacts)
        self._stride = stride_of(count)
        points = {at: point for at, point in self._points.items() if at <= same and (at % self._stride == 0 or at == count)}
        if count and count not in points:
            points[count] = self._rule(snapshot)
        self._points = points

    @property
    def missing(self) -> list[int]:
        """Numbers of contacts whose points are not solved yet, ascending."""
        return [at for at in range(self._stride, len(self._newest.contacts), self._stride) if at not in self._points]

    @cached_property
    def _replica(self) -> Session:
        """Session that solves the past; made in the background, since a large part takes a tenth of a second."""
        return Session(self._scene, self._surface)

    def work(self, seconds: float = math.inf) -> tuple[Snapshot, dict[int, Spreads]]:
        """Compute missing points of the error curve for about `seconds`, one at least, for `add_points`."""
        end, of, points = time.monotonic() + seconds, self._newest, dict[int, Spreads]()
        self._replica.set_detected_dead(of.dead)
        self._replica.assume_corrected(_rig_correction(of))
        for count in self.missing:
            # Poke by poke as in the live session, so that a point has the same bits.
            self._feed(of.contacts[:count])
            points[count] = self._rule(self._replica.snapshot())
            if time.monotonic() > end:
                break
        return of, points

    def add_points(self, of: Snapshot, points: Mapping[int, Spreads]) -> bool:
        """Add solved points that are still valid; return whether there are any."""
        same = _count_common(self._newest, of)
        held = {at: point for at, point in points.items() if at <= same and at % self._stride == 0}
        self._points = {**self._points, **held}
        return bool(held)

    def _feed(self, contacts: tuple[Contact, ...]) -> None:
        """Make the replica session use exactly these contacts."""
        same = _common(self._fed, contacts)
        wanted = {contact.poke for contact in contacts[same:]}
        for contact in self._fed[same:]:
            if contact.poke not in wanted:
                self._replica.act(Exclude(contact.poke))
        out = set(self._replica.excluded)
        for contact in contacts[same:]:
            self._replica.add(contact)
            if contact.poke in out:
                self._replica.act(Restore(contact.poke))
        self._fed = contacts

    def series(self) -> ErrorSeries:
        """Give the solved part of the course."""
        counts = np.array(sorted(self._points), dtype=np.int64)
        points = [self._points[count] for count in counts.tolist()]
        methods: tuple[Method, ...] = tuple(points[-1]) if points else ()
        contacts = self._newest.contacts
        return ErrorSeries(
            counts=counts,
            pokes=np.array([contact.poke for contact in contacts], dtype=np.int64)[counts - 1],
            times=poking_times([contact.end_s for contact in contacts])[counts - 1],
            spreads={method: np.stack([point[method] for point in points]) for method in methods},
            stride=self._stride,
            missing=len(self.missing),
        )


class ErrorFollower:
    """Course of errors against a source that the operator chose. The past is solved in the background in short steps."""

    def __init__(self, part: Part, run: Run) -> None:
        self._part, self._job = part, BackgroundJob(run)
        self.sources: list[TaxelPositions | None] = [None] if part.plan is None else [part.plan, None]
        """Positions to compare estimates with; `None` for the predicted error."""
        self.source = self.sources[0]
        self.version = 0
        """Changes whenever the course or its source changes."""
        self._course = self._new_course()
        self._seen: Snapshot | None = None
        self._failed_at: tuple[ErrorCourse, Snapshot] | None = None
        """Course and snapshot whose work failed; no retry before either changes."""

    def _new_course(self) -> ErrorCourse:
        known = None if self.source is None else self.source.places
        return ErrorCourse(self._part.scene, self._part.surface, known)

    def offer(self, reference: TaxelPositions) -> None:
        """Add a reference for the errors, in place of one of the same origin, and use it."""
        self.sources = [reference, *(other for other in self.sources if other is None or other.origin is not reference.origin)]
        self.choose(0)

    def choose(self, index: int) -> None:
        """Use another of `sources` as the reference for the errors."""
        if self.sources[index] is not self.source:
            self.source = self.sources[index]
            self._course, self._seen = self._new_course(), None
            self.version += 1

    def update(self, snapshot: Snapshot) -> None:
        """Follow a session, and let the background solve missing points."""
        if snapshot is not self._seen:
            self._seen = snapshot
            self._course.update(snapshot)
            self.version += 1
        course, at = self._course, (self._course, snapshot)
        if self._job.is_busy or self._failed_at == at or not course.missing:
            return

        def add(solved: tuple[Snapshot, dict[int, Spreads]]) -> None:
            self._failed_at = None
            if course.add_points(*solved) and course is self._course:
                self.version += 1

        self._failed_at = at  # Unless `add` gets the result
        self._job.start(lambda: course.work(MAX_WORK_PER_STEP_S), add)

    def series(self) -> ErrorSeries:
        """Give the solved part of the course."""
        return self._course.series()


def stride_of(count: int) -> int:
    """Choose the stride for `count` pokes: a power of two, so that a growing session keeps its points."""
    return 1 << max(0, (count - 1) // ERROR_HISTORY_MAX_POINTS).bit_length()


def poking_times(ends_s: Sequence[float]) -> FloatArray:
    """Compute the time since the first poke, (n,) float, seconds.

    The host's clock restarts with the machine, and a session may continue days later: a step back counts as 0, one of more than
    `SHOWN_PAUSE_MAX_S` as that.
    """
    return np.cumsum(np.clip(np.diff(np.array(ends_s, dtype=float), prepend=ends_s[:1]), 0.0, SHOWN_PAUSE_MAX_S))


def _common(first: Sequence[Contact], second: Sequence[Contact]) -> int:
    shorter = min(len(first), len(second))
    return next((at for at in range(shorter) if first[at] is not second[at]), shorter)


@dataclass(frozen=True, slots=True, eq=False)
class ModulesFound:
    """Result of the modules check for one snapshot."""

    method: Method
    """Method whose estimates were checked."""
    mend: LayoutRepair
    """Misplaced modules, and how to repair the layout."""
    judged: int
    """Number of modules with enough estimates."""


class ModulesCheck:
    """Looks for mirrored, turned and swapped modules in the newest snapshot. Without a layout it does nothing."""

    def __init__(self, part: Part, run: Run) -> None:
        self._part, self._job = part, BackgroundJob(run)
        self._module_model: ModuleModel | None = None
        self._asked: Snapshot | None = None
        self.found: ModulesFound | None = None
        """`None` before the first result."""

    def check_snapshot(self, snapshot: Snapshot) -> None:
        """Check a snapshot, unless an older one is still being checked."""
        layout = self._part.scene.skin.layout
        if layout is None or self._job.is_busy or snapshot is self._asked:
            return
        method = Method.SURFACE if self._part.surface is not None else Method.FREE
        estimates = {estimate.channel: estimate for estimate in snapshot.estimates.get(method, ())}
        if self._module_model is None:
            self._module_model = ModuleModel(layout, self._part.scene.skin.anchor, self._part.surface)
        model = self._module_model

        def work() -> ModulesFound:
            return ModulesFound(method, repair_layout(model, estimates), count_judged_modules(model, estimates))

        def finish(found: ModulesFound) -> None:
            self.found = found

        self._asked = snapshot
        self._job.start(work, finish)
