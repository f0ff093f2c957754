"""Exchanged channels: the pokes of one, taken alone, lie where the other one should be."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from skincal.geometry import FloatArray
from skincal.taxels.result import Cause, Estimate, State, StateReason

EXCHANGED_MAX_SHARE_OF_DISTANCE = 0.4
"""Largest distance of a taxel's own pokes from the other one's place, over the distance of the two places."""
MIN_CONTRADICTING_POKES = 2
"""Own pokes that deny a taxel's place for it to be named, or to name one without own pokes: a single one may be a bad poke."""


def find_claims(placed: Iterable[Estimate], alone: Mapping[int, Estimate]) -> dict[int, int]:
    """Find for each contradicted channel the channel at whose place its pokes lie, if that place has no poke of its own.

    Parameters
    ----------
    placed : estimates by modules
    alone : estimates of the same taxels from their own contacts, such as those of the surface method, by channel
    """
    estimates = list(placed)
    suspects = [each for each in estimates if each.is_contradicted]
    if not suspects:
        return {}
    candidates = [each for each in estimates if each.is_contradicted or each.state is State.INFERRED]
    found, places = dict[int, int](), np.array([_place_by_module(each) for each in candidates])
    for each in suspects:
        known = alone.get(each.channel)
        if known is None or known.position is None:
            continue
        distances = np.linalg.norm(places - known.position, axis=1)
        best = int(distances.argmin())
        apart = float(np.linalg.norm(places[best] - _place_by_module(each)))
        if candidates[best] is not each and float(distances[best]) <= EXCHANGED_MAX_SHARE_OF_DISTANCE * apart:
            found[each.channel] = candidates[best].channel
    return found


def _place_by_module(estimate: Estimate) -> FloatArray:
    place = estimate.contradicted_place if estimate.position is None else estimate.position
    assert place is not None, "a candidate has a place"
    return place


def _is_sure(estimate: Estimate) -> bool:
    """Tell whether enough pokes contradict a taxel to name it without another one."""
    reason = estimate.reason
    return reason is not None and reason.cause is Cause.CONTRADICTED and reason.count >= MIN_CONTRADICTING_POKES


def find_exchanged(placed: Sequence[Estimate], alone: Sequence[Estimate]) -> tuple[tuple[int, int], ...]:
    """List pairs of channels that look exchanged, each channel in one pair at most; see `find_claims`."""
    claims = find_claims(placed, {each.channel: each for each in alone})
    sure = {each.channel for each in placed if _is_sure(each)}
    claimed = Counter(claims.values())
    pairs = set[tuple[int, int]]()
    for channel, other in claims.items():
        is_mutual = claims.get(other) == channel
        is_alone = other not in claims and claimed[other] == 1 and channel not in claimed
        if is_mutual or (is_alone and channel in sure):
            pairs.add((min(channel, other), max(channel, other)))
    return tuple(sorted(pairs))


def find_denied(placed: Iterable[Estimate], exchanged: Collection[tuple[int, int]]) -> tuple[int, ...]:
    """List contradicted channels; of those with one poke, which may be a bad one, the `exchanged` alone."""
    paired = {channel for pair in exchanged for channel in pair}
    several = {
        each.channel for each in placed if _is_sure(each) or (each.reason is not None and each.reason.cause is Cause.CLAIMED)
    }
    return tuple(sorted(paired | several))


def withdraw_claimed(placed: Mapping[int, Estimate], alone: Mapping[int, Estimate]) -> dict[int, Estimate]:
    """Withdraw the places of inferred taxels where another channel's pokes lie; return the changed estimates by channel."""
    claims, found = find_claims(placed.values(), alone), dict[int, Estimate]()
    for channel, other in claims.items():
        if placed[other].state is State.INFERRED and _is_sure(placed[channel]):
            found[other] = contradicted(placed[other], StateReason(Cause.CLAIMED, channel))
    return found


def contradicted(estimate: Estimate, reason: StateReason) -> Estimate:
    """Withdraw the position of a placed taxel that pokes contradict. Its predicted error means nothing."""
    return replace(
        estimate, state=State.BLIND, reason=reason, contradicted_place=estimate.position, position=None, normal=None,
        covariance=None, worst_direction=None, sd=None, rms=None, triangle=None, moved=None,
    )  # fmt: skip
