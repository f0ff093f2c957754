"""Sets of taxel positions that can be compared, by their names for the operator.

Each set is (n, 3) float, metres, link frame, in the order of the part's channels; NaN where a position is unknown.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from app.state.view_state import ViewState
from skincal.geometry import FloatArray, IntArray
from skincal.taxels.differences import places_of
from skincal.taxels.result import Method

LAYOUT_SET = "Layout"


def method_label(method: Method) -> str:
    """Name the set of a method's estimates."""
    return f"{method.value.capitalize()} method"


def in_order(channels: IntArray, found: Mapping[int, FloatArray]) -> FloatArray:
    """Put positions by channel, (3,) float each, in the order of `channels`."""
    return np.array([found.get(channel, np.full(3, np.nan)) for channel in channels.tolist()]).reshape(-1, 3)


def position_sets(
    state: ViewState, channels: IntArray, methods: Sequence[Method], laid: FloatArray | None
) -> dict[str, FloatArray]:
    """Return the sets of a session: the layout if it is `laid` on the part, and each method.

    After a review of landmark pokes also each method without and with the correction of sensor and arm.
    """
    sets = {} if laid is None else {LAYOUT_SET: laid}
    own: dict[Method, FloatArray] = {}
    for method in methods:
        estimates = state.on_part.snapshot.estimates.get(method, ())
        own[method] = places_of(estimates) if len(estimates) == len(channels) else np.full((len(channels), 3), np.nan)
        sets[method_label(method)] = own[method]
    if state.review is not None:
        review = state.review
        reviewed = [method for method in methods if method in review.before or method in review.after]
        for when, found in (("before", review.before), ("after", review.after)):
            for method in reviewed:
                # The review holds one of the two; the session's own estimates are the other.
                by_channel = dict(zip(review.channels.tolist(), found.get(method, ()), strict=False))
                positions = in_order(channels, by_channel) if method in found else own[method]
                sets[f"{method.value.capitalize()} {when} correction"] = positions
    return sets


def default_pair(names: Sequence[str], shown: Method) -> tuple[str, str]:
    """Return the pair that is compared by default: the layout and the shown method, else the free and another method."""
    free, surface = method_label(Method.FREE), method_label(Method.SURFACE)
    if LAYOUT_SET in names:
        return LAYOUT_SET, method_label(shown)
    return free, surface if surface in names else next((name for name in names if name != free), free)


def unique_name(name: str, path: Path, taken: Mapping[str, Path | None]) -> str:
    """Return a name for positions read from `path`; if another path has it, with the folder added."""
    candidates = (name, f"{name} ({path.parent.name})", f"{name} ({path.parent})")
    return next((each for each in candidates if taken.get(each, path) == path), f"{name} ({path})")
