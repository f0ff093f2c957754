"""Estimates of many taxels by all methods: pooled over all contacts, or per arm pose and averaged as in the paper (IV-B)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray
from skincal.model.scene import NoiseSettings
from skincal.modules.estimate import FittedModule, estimate_modules
from skincal.taxels.contact_table import ContactTable, Evidence
from skincal.taxels.exchanged import withdraw_claimed
from skincal.taxels.result import PER_TAXEL, Cause, Estimate, Method, State, StateReason, placed_state
from skincal.taxels.shared_errors import SharedRows, add_shared_errors
from skincal.taxels.solve import Solution, estimate_free, estimate_surface, solve

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface
    from skincal.modules.pose import ModuleModel

_NONE_DEAD: Mapping[int, str] = {}
_NONE_BEFORE: Mapping[int, Estimate] = {}
LEADING_METHOD_MIN_TAXEL_SHARE = 0.95
"""A method may lead if it knows at least this share of the taxels that the most complete method knows: a small error of few
taxels is no better calibration."""
_ANSWERS_PER_SOLVER_CALL = 20_000
"""Answers solved at once: their results, some 10 MB, stay in the processor's cache. More are solved in two threads."""
_FIRST_THREAD_PART_INTERVAL = 3
"""One part in this many is solved in the first thread, which also makes the estimates: both threads end about together."""

Estimates: TypeAlias = dict[Method, dict[int, Estimate]]
"""By method and channel."""


def estimate_taxels(
    contacts: Sequence[Contact],
    channels: Iterable[int],
    methods: Sequence[Method],
    noise: NoiseSettings,
    surface: Surface | None,
    dead: Mapping[int, str] = _NONE_DEAD,
    doubting: bool = True,
    model: ModuleModel | None = None,
    shared: SharedRows | None = None,
) -> Estimates:
    """Estimate each of `channels` from all contacts in which it answered, of any number of arm poses (eq. 6).

    The result depends neither on the order of the contacts nor on the other channels, to the last bit.

    Parameters
    ----------
    contacts : accepted and not excluded
    dead : unused channels with the reason
    doubting : contacts far from the prediction of a taxel's others count less
    model : needed by the modules method, which uses the contacts of all taxels of a module
    shared : errors shared by all contacts, which the covariances include

    Raises
    ------
    ValueError
        A contact has a number that is not finite, or a method lacks its surface or its model.
    """
    table, channels = ContactTable(contacts), [int(channel) for channel in channels]
    alone = [method for method in methods if method in PER_TAXEL]
    # Solved by the modules method alone, single taxels cost nothing.
    evidence = table.evidence([channel for channel in channels if channel not in dead] if alone else [])
    solved = estimate_from(evidence, channels, alone, noise, surface, dead, doubting=doubting)
    for method in alone:
        moved = add_shared_errors(evidence, list(solved[method].values()), noise, shared)
        solved[method] = {estimate.channel: estimate for estimate in moved}
    if Method.MODULES in methods:
        if model is None:
            raise ValueError("the modules method needs the modules of a layout")
        modules = model.modules_of(channels)
        # A distance links further modules.
        modules = list(range(len(model.pads))) if model.distances else modules
        begin = Method.FREE if surface is None else Method.SURFACE
        others = estimate_from(table, model.channels_of(modules), [begin], noise, surface, dead, doubting=doubting)
        kept: dict[int, FittedModule] | None = {} if model.distances else None
        found = estimate_modules(table, model, modules, noise, [others[begin]], dead, doubting, shared, kept)
        if kept:
            # Imported only where a scene knows distances.
            from skincal.modules.distances import apply_distances

            found |= apply_distances(model, kept, found, noise)[0]
        found |= withdraw_claimed(found, others[begin])
        solved[Method.MODULES] = {
            channel: found.get(channel) or _without(channel, Method.MODULES, dead) for channel in channels
        }
    return {method: solved[method] for method in methods}


def leading_method(estimates: Mapping[Method, Sequence[Estimate]]) -> Method | None:
    """Choose the method with the smallest mean predicted error among nearly complete ones; `None` without an estimate."""
    return leading_by({method: [found.rms for found in of if found.rms is not None] for method, of in estimates.items()})


def leading_by(errors: Mapping[Method, Sequence[float]]) -> Method | None:
    """Choose the leading method by the predicted errors, metres, of its estimates; see `leading_method`."""
    known = max(map(len, errors.values()), default=0)
    enough = {
        method: float(np.mean(rms))
        for method, rms in errors.items()
        if rms and len(rms) >= LEADING_METHOD_MIN_TAXEL_SHARE * known
    }
    return min(enough, key=enough.__getitem__, default=None)


def estimate_from(
    table: ContactTable | Evidence,
    channels: Iterable[int],
    methods: Sequence[Method],
    noise: NoiseSettings,
    surface: Surface | None,
    dead: Mapping[int, str] = _NONE_DEAD,
    last: Mapping[int, Estimate] = _NONE_BEFORE,
    doubting: bool = True,
) -> Estimates:
    """Estimate each of `channels` from a table by methods of `PER_TAXEL`; else as `estimate_taxels`.

    Parameters
    ----------
    table : or its evidence of the channels in use
    last : the surface method's last estimates, which only shorten its search
    """
    if Method.SURFACE in methods and surface is None:
        raise ValueError("the surface method needs a surface")
    channels = [int(channel) for channel in channels]
    evidence = table.evidence([channel for channel in channels if channel not in dead])
    solved: Estimates = {method: {} for method in methods}
    parts = [evidence.part(first, after) for first, after in _blocks(evidence)]
    for solution in _solve_parts(
        parts, lambda part, two: solve(part, methods, noise, surface, _triangles(part, last), doubting, two)
    ):
        for estimate in (*estimate_free(solution), *estimate_surface(solution, surface)):
            solved[estimate.method][estimate.channel] = estimate
    return {
        method: {channel: found.get(channel) or _without(channel, method, dead) for channel in channels}
        for method, found in solved.items()
    }


def _solve_parts(parts: Sequence[Evidence], work: Callable[[Evidence, bool], Solution]) -> Iterator[Solution]:
    """Yield the solution of each part, in any order; `work` gets True in the second thread, which does most parts."""
    if len(parts) < 2:
        yield from (work(part, False) for part in parts)
        return
    with ThreadPoolExecutor(1) as other:
        own = parts[_FIRST_THREAD_PART_INTERVAL - 1 :: _FIRST_THREAD_PART_INTERVAL]
        waiting = deque(other.submit(work, part, True) for i, part in enumerate(parts) if (i + 1) % _FIRST_THREAD_PART_INTERVAL)
        for part in own:
            yield work(part, False)
            while waiting and waiting[0].done():
                yield waiting.popleft().result()
        yield from (theirs.result() for theirs in waiting)


def _blocks(evidence: Evidence) -> list[tuple[int, int]]:
    """Cut the taxels into parts of about `_ANSWERS_PER_SOLVER_CALL` answers: first taxel, and the one after the last."""
    count = len(evidence.channels)
    edges = np.searchsorted(evidence.starts, np.arange(0, len(evidence.pokes), _ANSWERS_PER_SOLVER_CALL), side="left")
    cuts = sorted({*edges.tolist(), count})
    return [(a, b) for a, b in pairwise(cuts) if b > a]


def _triangles(evidence: Evidence, last: Mapping[int, Estimate]) -> IntArray:
    # -1 without a last estimate.
    before = [last.get(channel) for channel in evidence.channels.tolist()]
    return np.array([-1 if est is None or est.triangle is None else est.triangle for est in before], dtype=np.int64)


def _without(channel: int, method: Method, dead: Mapping[int, str]) -> Estimate:
    if channel in dead:
        return Estimate(channel, method, State.DEAD, 0, reason=StateReason(Cause.EXTERNAL_TEXT, text=dead[channel]))
    return Estimate(channel, method, State.UNSEEN, 0, reason=StateReason(Cause.UNPOKED))


def average_over_poses(
    contacts: Sequence[Contact],
    channels: Sequence[int],
    method: Method,
    noise: NoiseSettings,
    surface: Surface | None,
    model: ModuleModel | None = None,
    shared: SharedRows | None = None,
) -> dict[int, Estimate]:
    """Estimate each pose's contacts alone and average the positions with equal weights, the paper's IV-B.

    A pose without an estimate of a taxel does not count for it. Averages of the surface method leave the surface, as in the
    paper; their triangle is `None`.

    Parameters
    ----------
    contacts, channels, method, noise, surface, model, shared
        As for `estimate_taxels`; poses are distinguished by `Contact.pose`.
    """
    poses: dict[str, list[Contact]] = {}
    # Distances are the same evidence in every pose, and would count once for each.
    model = model if model is None or not model.distances else model.with_layout(model.layout)
    for contact in contacts:
        poses.setdefault(contact.pose, []).append(contact)
    # By name, so that the order of the poses does not matter. Without contacts every taxel is unseen.
    each = [poses[pose] for pose in sorted(poses)] or [[]]
    solved = [estimate_taxels(own, channels, [method], noise, surface, model=model, shared=shared)[method] for own in each]
    return {int(channel): _average([found[int(channel)] for found in solved]) for channel in channels}


def _average(of_poses: list[Estimate]) -> Estimate:
    """Average the estimates of one taxel from several arm poses."""
    seen = [estimate for estimate in of_poses if estimate.state not in (State.UNSEEN, State.DEAD)]
    if not seen:
        return of_poses[0]
    contacts = sum(estimate.contacts for estimate in seen)
    channel, method = seen[0].channel, seen[0].method
    good = [estimate for estimate in seen if estimate.position is not None and estimate.covariance is not None]
    if not good:
        best = max(seen, key=lambda estimate: estimate.contacts)
        reason = StateReason(Cause.BLIND_IN_POSES, len(seen), inner=best.reason)
        return Estimate(
            channel,
            method,
            State.BLIND,
            contacts,
            normal=best.normal,
            worst_direction=best.worst_direction,
            sd=best.sd,
            reason=reason,
        )
    position, covariance = np.zeros(3), np.zeros((3, 3))
    moves = [estimate.moved for estimate in good if estimate.moved is not None]
    for count, estimate in enumerate(good, start=1):
        # Running mean: exact for equal positions.
        position = position + (np.asarray(estimate.position) - position) / count
        covariance = covariance + np.asarray(estimate.covariance)
    # Shared errors do not shrink with the number of poses.
    moved = np.mean(moves, axis=0) if moves else None
    covariance = (covariance - sum(move @ move.T for move in moves)) / len(good) ** 2
    covariance = covariance if moved is None else covariance + moved @ moved.T
    values, axes = np.linalg.eigh(covariance)
    normals = np.sum([estimate.normal for estimate in good if estimate.normal is not None] or [np.zeros(3)], axis=0)
    length = float(np.linalg.norm(normals))
    doubted = {poke: trust for estimate in seen for poke, trust in estimate.doubted.items()}
    return Estimate(
        channel, method, placed_state(contacts, doubted), contacts, position=position,
        normal=normals / length if length > 0 else None,
        covariance=covariance, worst_direction=_unsigned(axes[:, -1]), sd=float(np.sqrt(values[-1])),
        rms=float(np.sqrt(np.trace(covariance))), moved=moved,
        reason=StateReason(Cause.MEAN_OF_POSES, len(good), blind=len(seen) - len(good)),
    )  # fmt: skip


def _unsigned(line: FloatArray) -> FloatArray:
    # A line has no sign: its largest component is made positive.
    return line * np.sign(line[np.abs(line).argmax()])
