"""The turns of a session's taxels while it grows: a changed poke costs the taxels that it presses, and their module.

Each taxel is fitted from its counting pokes alone, in their order, as by `find_turns`. The noise that all of them share is
found from the first N contacts, and again when N doubles, so that not every poke changes every taxel. So the turns depend on
the contacts that count, and not on the way to them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skincal.axes.axis_checks import DeadAxis, find_dead_axes
from skincal.axes.module_axes import ModuleTurn, find_module_noise, has_shared_turn, module_turn
from skincal.axes.push_offset import OffsetCorrection, PushLean, TaxelOffsets
from skincal.axes.skin_turns import (
    ReadingOfForce,
    SkinTurns,
    Turn,
    as_pokes,
    find_noise,
    fit_group,
    joined,
    readings_of_contact,
)
from skincal.axes.turn_fit import START_ANGULAR_NOISE, AxisNoise, AxisPokes, TurnFit
from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray
from skincal.model.skin import Layout

FIRST_CONTACTS_OF_NOISE = 8
MAX_GROUPS_OF_NOISE = 12
"""Taxels, or modules, with the most pokes, from which the noise is found: 0.1 to 0.2 s."""
MAX_POKES_OF_NOISE = 40
"""Of each of them."""


@dataclass(frozen=True, slots=True, eq=False)
class ShownTurn:
    """The turn of a taxel for views: its own, or that of its module if the taxels share it."""

    turn: Turn
    module: ModuleTurn | None
    """Whose turn it is; `None` for the taxel's own."""
    is_mirrored: bool
    """Whether the axes of the skin are mirrored for certain: then y points to the other side."""

    @property
    def fit(self) -> TurnFit:
        """The fit of the hand that the skin has."""
        return self.turn.fits[int(self.is_mirrored)]

    @property
    def axes(self) -> FloatArray:
        """(3, 3) float: columns are x, y and z of the readings, frame of the part."""
        return self.fit.axes

    @property
    def _scatter(self) -> float:
        """Variance of z of the module's taxels about that of the module, rad^2, in each of two directions."""
        spread = 0.0 if self.module is None or not np.isfinite(self.module.spread) else self.module.spread
        return 0.5 * spread**2

    @property
    def covariance(self) -> FloatArray:
        """(3, 3) float, rad^2, of the turn in the link frame; with the scatter of the module's taxels."""
        across = self.fit.rotation[:, :2]
        return self.fit.turn_covariance + self._scatter * (across @ across.T)

    @property
    def normal_sd(self) -> float:
        """rad, standard deviation of the direction of z, in its worse direction; with the scatter of the module's taxels."""
        return float(np.sqrt(self.fit.normal_sd**2 + self._scatter))

    @property
    def in_plane_sd(self) -> float:
        """rad, standard deviation of the turn about z; see `is_in_plane_known`."""
        return self.fit.in_plane_sd

    @property
    def is_in_plane_known(self) -> bool:
        """Whether x and y are known."""
        return self.fit.is_in_plane_known


@dataclass(frozen=True, eq=False)
class SessionTurns:
    """The turns of taxels and modules at one moment of a session."""

    skin: SkinTurns
    modules: Mapping[int, ModuleTurn]
    """By id, of modules with pokes; empty without a layout."""
    module_of: Mapping[int, int]
    """Id of the module of each channel; empty without a layout."""
    lean: PushLean | None = None
    """Lean of answers to pushes next to the middle of a taxel, which the turns contain; `None` without known offsets."""

    @cached_property
    def is_mirrored(self) -> bool:
        """Whether the axes of the skin are mirrored for certain."""
        return self.skin.is_mirrored

    @cached_property
    def dead_axes(self) -> tuple[DeadAxis, ...]:
        """X and y of taxels that do not answer, by channel."""
        return find_dead_axes(self.skin)

    @cached_property
    def channels_with_dead_axis(self) -> frozenset[int]:
        """Channels of taxels whose x or y does not answer."""
        return frozenset(each.channel for each in self.dead_axes)

    @cached_property
    def log_odds_shared(self) -> float:
        """Natural logarithm of the odds that taxels report in the axes of their module, over all modules."""
        return float(sum(module.log_odds_shared for module in self.modules.values()))

    def of_channel(self, channel: int) -> ShownTurn | None:
        """Give the turn of a taxel; `None` before a poke presses it, or its module if the taxels share a turn."""
        module = self.modules.get(self.module_of.get(channel, -1))
        if module is not None and has_shared_turn(module, self.log_odds_shared):
            return ShownTurn(module.turn, module, self.is_mirrored)
        own = self.skin.taxels.get(channel)
        return None if own is None else ShownTurn(own, None, self.is_mirrored)


class TurnSolving:
    """Keeps the turns of a session; `layout` may be `None`, `force_noise` is the sd of each force component, N."""

    def __init__(self, layout: Layout | None, force_noise: float) -> None:
        self._module_of: dict[int, int] = {}
        if layout is not None:
            self._module_of = {channel: module.id for module in layout.modules for channel in module.channels.tolist()}
        self._noise = self._module_noise = AxisNoise(force_noise, 0.0, START_ANGULAR_NOISE)
        self._start = self._noise
        self._rows: dict[int, dict[int, ReadingOfForce]] = {}
        """By channel and poke."""
        self._channels_of: dict[int, tuple[int, ...]] = {}
        """Pressed taxels of each contact that counts."""
        self._pokes: dict[int, AxisPokes] = {}
        self._taxels: dict[int, Turn] = {}
        self._modules: dict[int, Turn] = {}
        self._waiting, self._waiting_modules = set[int](), set[int]()
        self._noise_pokes: tuple[int, ...] = ()
        """Contacts that show the noise."""
        self._is_noise_stale = False
        self._skin: SkinTurns | None = None
        """`None` after a change."""
        self._correction = OffsetCorrection()

    @property
    def waiting(self) -> int:
        """Number of taxels and modules to fit."""
        return len(self._waiting) + len(self._waiting_modules)

    def pokes_changed(self, pokes: Collection[int], kept: Sequence[Contact]) -> None:
        """Take pokes that changed, with the contacts among them that count."""
        counting = {contact.poke: contact for contact in kept}
        for poke in sorted(pokes):
            self.poke_changed(poke, counting.get(poke))

    def poke_changed(self, poke: int, contact: Contact | None) -> None:
        """Take a contact that counts in place of an earlier one of its number; `None` if it counts no more."""
        changed = set(self._channels_of.pop(poke, ()))
        for channel in changed:
            del self._rows[channel][poke]
        rows = [] if contact is None else readings_of_contact(contact)
        for channel, row in rows:
            self._rows.setdefault(channel, {})[poke] = row
            changed.add(channel)
        if rows:
            self._channels_of[poke] = tuple(channel for channel, _ in rows)
        if not changed:
            return
        self._is_noise_stale |= bool(self._noise_pokes) and poke <= self._noise_pokes[-1]
        self._wait_for(changed)

    def _wait_for(self, channels: Collection[int]) -> None:
        self._skin = None
        for channel in channels:
            if not self._rows.get(channel):
                self._rows.pop(channel, None)
                self._pokes.pop(channel, None)
                self._taxels.pop(channel, None)
                self._waiting.discard(channel)
            else:
                self._waiting.add(channel)
            if channel in self._module_of:
                self._waiting_modules.add(self._module_of[channel])

    def solve(self, within_s: float = math.inf) -> None:
        """Fit what changed; after `within_s`, or little later, the rest waits for the next call."""
        end = time.perf_counter() + within_s
        for channel in sorted(self._waiting):
            rows = self._rows[channel]
            self._pokes[channel] = as_pokes([rows[poke] for poke in sorted(rows)])
        if self._skin is None:
            self._update_noise()
        for channel in sorted(self._waiting):
            self._taxels[channel] = fit_group((channel,), self._pokes[channel], self._noise)
            self._waiting.discard(channel)
            if time.perf_counter() > end:
                return
        for number in sorted(self._waiting_modules):
            self._fit_module(number)
            self._waiting_modules.discard(number)
            if time.perf_counter() > end:
                return

    def _fit_module(self, number: int) -> None:
        channels = self._channels_of_module(number)
        if not channels:
            self._modules.pop(number, None)
            return
        pokes = joined([self._pokes[channel] for channel in channels])
        self._modules[number] = fit_group(channels, pokes, self._module_noise)

    def _channels_of_module(self, number: int) -> tuple[int, ...]:
        return tuple(channel for channel in sorted(self._pokes) if self._module_of.get(channel) == number)

    def _update_noise(self) -> None:
        """Find the noise again if it is of other contacts than before; then everything is fitted again."""
        # Without the newest contact, whose tare may still change.
        numbers, count = sorted(self._channels_of), FIRST_CONTACTS_OF_NOISE
        if len(numbers) - 1 < count:
            first: tuple[int, ...] = ()
        else:
            while 2 * count <= len(numbers) - 1:
                count *= 2
            first = tuple(numbers[:count])
        if first == self._noise_pokes and not self._is_noise_stale:
            return
        self._noise_pokes, self._is_noise_stale = first, False
        before = self._noise, self._module_noise
        self._noise = self._module_noise = self._start
        if first:
            taxels = {channel: own for channel, pokes in self._pokes.items() if len(own := _up_to(pokes, first[-1]))}
            by_module: dict[int, list[AxisPokes]] = {}
            for channel, own in sorted(taxels.items()):
                if channel in self._module_of:
                    by_module.setdefault(self._module_of[channel], []).append(own)
            self._noise = find_noise(_largest([own for _, own in sorted(taxels.items())]), self._start.force)
            modules = [joined(own) for _, own in sorted(by_module.items())]
            self._module_noise = find_module_noise(_largest(modules), self._noise)
        if before != (self._noise, self._module_noise):
            self._wait_for(list(self._rows))

    @property
    def pokes(self) -> Mapping[int, AxisPokes]:
        """Pokes of each taxel, by channel, as the last solution has them."""
        return self._pokes

    def turns(self, normals: Mapping[int, FloatArray], offsets: Mapping[int, TaxelOffsets]) -> SessionTurns:
        """Give the turns, once nothing waits.

        Parameters
        ----------
        normals : (3,), unit, outward, of the skin at the taxels, by channel, where a mesh gives them
        offsets : of the pushes, by channel, of taxels whose position is known
        """
        if self._skin is None:
            self._skin = SkinTurns(dict(sorted(self._taxels.items())), self._noise, dict(sorted(self._pokes.items())))
        taxels = self._skin.taxels
        modules = {number: module_turn(number, turn, taxels, normals) for number, turn in sorted(self._modules.items())}
        found = SessionTurns(self._skin, modules, self._module_of)
        if not offsets:
            return found
        shared = [number for number, module in modules.items() if has_shared_turn(module, found.log_odds_shared)]
        turns = {number: module.turn for number, module in modules.items()}
        corrected = self._correction.correct(self._skin, turns, shared, offsets)
        modules = {number: replace(module, turn=corrected.modules[number]) for number, module in modules.items()}
        return SessionTurns(corrected.skin, modules, self._module_of, corrected.lean)


def _up_to(pokes: AxisPokes, last: int) -> AxisPokes:
    """Leave out pokes after the poke `last`, and those beyond the first `MAX_POKES_OF_NOISE`."""
    count = min(int(np.searchsorted(pokes.pokes, last, side="right")), MAX_POKES_OF_NOISE)
    return AxisPokes(pokes.forces[:count], pokes.readings[:count], pokes.pokes[:count])


def _largest(groups: Sequence[AxisPokes]) -> list[AxisPokes]:
    """Choose the groups with the most pokes, the first ones of equal ones."""
    return sorted(groups, key=lambda pokes: -len(pokes))[:MAX_GROUPS_OF_NOISE]
