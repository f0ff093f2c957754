"""Turns of taxels by a few pokes, for tests of what follows them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from skincal.axes.module_axes import module_turn
from skincal.axes.session_turns import SessionTurns
from skincal.axes.skin_turns import SkinTurns, Turn, fit_group
from skincal.geometry import rotation_by
from tests.skincal.axes.axis_support import NOISE, make_pokes

QUARTER = rotation_by(np.array([0.0, 0.0, np.pi / 2]))


def turn_of(channel: int, axes: np.ndarray, lean_deg: float = 15.0, pokes: int = 10) -> Turn:
    """The turn of a taxel with these axes by pokes that lean up to `lean_deg`."""
    return fit_group((channel,), make_pokes(np.random.default_rng([9, channel]), axes, pokes, lean_deg), NOISE)


def turns_of(taxels: Mapping[int, Turn], modules: Mapping[int, tuple[int, ...]] | None = None) -> SessionTurns:
    """The turns of a session; `modules` share the turn of their first taxel."""
    shared = {}
    for number, channels in (modules or {}).items():
        first = taxels[channels[0]]
        shared[number] = replace(module_turn(number, first, taxels, {}), taxels=len(channels), log_odds_shared=9.0)
    module_of = {channel: number for number, channels in (modules or {}).items() for channel in channels}
    return SessionTurns(SkinTurns(taxels, NOISE, {}), shared, module_of)
