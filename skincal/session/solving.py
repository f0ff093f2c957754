"""Cached estimates of a session's taxels. Only taxels with changed input are solved again."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import IntArray
from skincal.methods import estimate_from
from skincal.model.scene import Scene
from skincal.model.skin import SkinKind
from skincal.modules.estimate import FittedModule, estimate_modules
from skincal.modules.pose import ModuleModel
from skincal.rig.tip_fusion import TipFusion
from skincal.taxels.contact_table import ContactTable, TableState
from skincal.taxels.exchanged import withdraw_claimed
from skincal.taxels.result import PER_TAXEL, Cause, Estimate, Method, State, StateReason
from skincal.taxels.shared_errors import SharedRows, add_shared_errors

if TYPE_CHECKING:
    from skincal.axes.session_turns import SessionTurns, TurnSolving
    from skincal.mesh.surface import Surface
    from skincal.modules.distances import TriedDistance

MODULES_AT_ONCE, SHEETS_AT_ONCE, TAXELS_AT_ONCE = 4, 1, 64
"""Solved between two looks at the clock: some 40 ms by the modules method, less for taxels alone."""


PLACING_METHODS = (Method.MODULES, Method.SURFACE, Method.FREE)
"""Methods that place taxels for the offsets of pushes, the best first."""
PARTS_JOINED_WITHOUT_LIMIT = 12
"""Parts that are solved together without a limit of time: 48 modules."""


def methods_of(scene: Scene, surface: Surface | None) -> tuple[Method, ...]:
    """List the methods that a scene allows."""
    layout = scene.skin.layout
    # The shape of a sheet is that of the part: without a mesh it is not known.
    laid = layout is not None and (layout.kind is SkinKind.BOARD or surface is not None)
    there = {Method.SURFACE: surface is not None, Method.MODULES: laid}
    return tuple(method for method in Method if there.get(method, True))


class OrderedEstimates(dict[int, Estimate]):
    """Estimates of one method by channel. `enter` changes them, and `of_channels` lists them after each poke."""

    def __init__(self) -> None:
        super().__init__()
        self._listed: list[Estimate] = []
        self._order: Sequence[int] = ()
        self._row_of: dict[int, int] = {}
        self._changed = set[int]()

    def enter(self, found: Mapping[int, Estimate]) -> None:
        """Enter estimates, by channel."""
        self.update(found)
        self._changed.update(found)

    def of_channels(self, channels: Sequence[int]) -> tuple[Estimate, ...]:
        """List the estimates of `channels`. As long as these stay, only changed ones are looked up."""
        if channels is not self._order:
            self._order, self._row_of = channels, {channel: row for row, channel in enumerate(channels)}
            self._listed = [self[channel] for channel in channels]
        else:
            for channel in self._changed & self._row_of.keys():
                self._listed[self._row_of[channel]] = self[channel]
        self._changed.clear()
        return tuple(self._listed)


class Solving:
    """Solves the taxels that changed; parameters as for `Session`."""

    def __init__(self, scene: Scene, surface: Surface | None, methods: Collection[Method] | None) -> None:
        self.methods = tuple(method for method in methods_of(scene, surface) if methods is None or method in methods)
        layout = scene.skin.layout
        solved = Method.MODULES in self.methods
        self.module_model: ModuleModel | None = None
        """`None` if the modules method is not solved."""
        if layout is not None and solved:
            self.module_model = ModuleModel(layout, scene.skin.anchor, surface, scene.distances)
        self._apart: dict[int, Estimate] = {}
        """Estimates of the modules method before known distances are applied; empty without distances."""
        self._fitted: dict[int, FittedModule] | None = {} if self.module_model and self.module_model.distances else None
        self.tried_distances: tuple[TriedDistance, ...] = ()
        """For each known distance, whether it is used."""
        self._noise, self._surface = scene.noise, surface
        self.shared: SharedRows | None = None
        """Errors shared by all pokes, which the covariances include."""
        self.tips: TipFusion | None = None
        """Positions of the tip; `None` while they are not used."""
        self.is_placed = True
        """Whether the contacts are in the part's frame; in the base of a tool's poses only the free method knows a taxel."""
        self._turns: TurnSolving | None = None
        """`None` for taxels of one axis."""
        if scene.skin.axes is not None:
            from skincal.axes.session_turns import TurnSolving  # other scenes do without

            self._turns = TurnSolving(layout, scene.noise.force)
        self._alone = [method for method in self.methods if method in PER_TAXEL]
        self._table = self._shown = ContactTable()
        """Input of the next solution, and of the shown one; they differ only while taxels wait."""
        self._estimates = {method: OrderedEstimates() for method in self.methods}
        self._alike: dict[Method, dict[int, Estimate]] = {method: {} for method in self._alone}
        """The same without shared errors: start of the search for the modules, which shared errors may not change."""
        self._claimed: dict[int, Estimate] = {}
        """Estimates of the modules method before `withdraw_claimed`, of the taxels that it changed."""
        self._contradicted = set[int]()
        """Taxels that pokes contradict by the modules method, before `withdraw_claimed`: usually none."""
        self._pokes, self._channels, self._fresh = set[int](), set[int](), set[int]()
        """Pokes to update in the table; taxels to solve; taxels for the next `take_fresh`."""

    @property
    def waiting(self) -> int:
        """Number of taxels to solve."""
        return len(self._channels) + (0 if self._turns is None else self._turns.waiting)

    @property
    def turns(self) -> SessionTurns | None:
        """Turns of the taxels in the frame of the contacts, once nothing waits; `None` for taxels of one axis."""
        if self._turns is None or not self.is_placed:
            return None
        from skincal.axes.push_offset import measure_offsets  # other scenes do without

        on_mesh = self._estimates.get(Method.SURFACE, OrderedEstimates())
        normals = {channel: each.normal for channel, each in on_mesh.items() if each.normal is not None}
        pokes = self._turns.pokes
        return self._turns.turns(normals, measure_offsets(self._table.evidence(pokes.keys()), self._placed(pokes), pokes))

    def _placed(self, channels: Iterable[int]) -> dict[int, Estimate]:
        """Find the best estimate of each channel that has a position: by the plan of a module it follows no poke of its own."""
        found = dict[int, Estimate]()
        for channel in channels:
            every = (self._estimates[method].get(channel) for method in PLACING_METHODS if method in self._estimates)
            best = next((each for each in every if each is not None and each.position is not None), None)
            if best is not None:
                found[channel] = best
        return found

    def poke_changed(self, poke: int, channels: Iterable[int]) -> None:
        """Mark a contact as changed, with the channels that answered."""
        self._pokes.add(poke)
        self._channels.update(channels)

    def taxels_changed(self, channels: Iterable[int]) -> None:
        """Mark channels as changed."""
        self._channels.update(channels)

    def solve(
        self,
        channels: Collection[int],
        known: Collection[int],
        kept: Callable[[Iterable[int]], Sequence[Contact]],
        dead: Mapping[int, str],
        within_s: float,
    ) -> None:
        """Solve the taxels that changed, or some of them.

        Parameters
        ----------
        channels : the taxels
        known : all pokes
        kept : gives the counting contacts of some pokes
        dead : unused channels with the reason
        within_s : s. The work ends after this or little later; the rest waits
        """
        end = time.perf_counter() + within_s
        self._fresh.update(self._channels)
        self._channels.intersection_update(channels)
        parts = self._parts(sorted(self._channels), within_s)
        if len(parts) > 1 and not math.isinf(within_s) and self._table is self._shown:
            # The last snapshot reads its evidence from the old table until everything is solved.
            self._table = ContactTable(self._with_tips(kept(known)))
        else:
            for poke in self._pokes:
                self._table.drop(poke)
            self._table.add(self._with_tips(kept(self._pokes)))
        if self._turns is not None:
            self._turns.pokes_changed(self._pokes, kept(self._pokes))
        self._pokes.clear()
        if self._claimed:
            self._update_placed(self._claimed)
        for part in parts:
            self._solve(part, dead)
            self._channels.difference_update(part)
            if time.perf_counter() > end:
                break
        if not self._channels:
            self._shown = self._table
            if parts and self._fitted is not None:
                self._refine()
        if self.module_model is not None:
            self._withdraw_claimed()
        if self._turns is not None:
            self._turns.solve(end - time.perf_counter())

    def _with_tips(self, contacts: Sequence[Contact]) -> Sequence[Contact]:
        return contacts if self.tips is None else self.tips.moved_axes(contacts)

    def _refine(self) -> None:
        # Imported only where a scene knows distances.
        from skincal.modules.distances import apply_distances

        assert self.module_model is not None
        assert self._fitted is not None
        moved, self.tried_distances = apply_distances(self.module_model, self._fitted, self._apart, self._noise)
        self._update_placed({**self._apart, **moved})

    def _update_placed(self, found: Mapping[int, Estimate]) -> None:
        """Enter estimates of the modules method, by channel."""
        self._estimates[Method.MODULES].enter(found)
        self._contradicted.difference_update(found)
        self._contradicted.update(channel for channel, estimate in found.items() if estimate.is_contradicted)

    def _withdraw_claimed(self) -> None:
        if not self._contradicted:
            # Without it each poke would cost a pass over the taxels of the whole body.
            self._claimed = {}
            return
        placed = self._estimates[Method.MODULES]
        found = withdraw_claimed(placed, self._alike[self._alone[-1]] if self._alone else {})
        self._claimed = {channel: placed[channel] for channel in found}
        placed.enter(found)

    def estimates(self, channels: Sequence[int]) -> dict[Method, tuple[Estimate, ...]]:
        """Look up by method the estimates of some channels, one a channel."""
        found = {method: of.of_channels(channels) for method, of in self._estimates.items()}
        on_mesh, surface, tips = found.get(Method.SURFACE), self._surface, self.tips
        if on_mesh is not None and surface is not None and tips is not None and tips.places_pokes and self.is_placed:
            found[Method.SURFACE] = tips.joined_on_mesh(on_mesh, self._shown, surface)
        return found

    def take_fresh(self) -> IntArray:
        """Give the channels that were solved since the last call, ascending."""
        fresh = np.array(sorted(self._fresh), dtype=np.int64)
        self._fresh.clear()
        return fresh

    @property
    def table_state(self) -> TableState:
        """The contacts of the shown solution, which `Snapshot.evidence` reads until they change."""
        return TableState(self._shown)

    def _parts(self, channels: Sequence[int], within_s: float) -> Sequence[Sequence[int]]:
        """Split channels into parts to solve; a module's stay together.

        Without a limit of time the parts are larger: they bound the memory of the solver, which does not shrink.
        """
        factor = PARTS_JOINED_WITHOUT_LIMIT if math.isinf(within_s) else 1
        if self.module_model is None:
            at_once = factor * TAXELS_AT_ONCE
            return [channels[at : at + at_once] for at in range(0, len(channels), at_once)]
        modules = self.module_model.modules_of(channels)
        at_once = factor * (SHEETS_AT_ONCE if self.module_model.layout.kind is SkinKind.SHEET else MODULES_AT_ONCE)
        some = [modules[at : at + at_once] for at in range(0, len(modules), at_once)]
        return [[channel for channel in self.module_model.channels_of(part) if channel in self._channels] for part in some]

    def _solve(self, channels: Sequence[int], dead: Mapping[int, str]) -> None:
        last = self._alike.get(Method.SURFACE, {})
        evidence = self._table.evidence([channel for channel in channels if channel not in dead])
        alone = self._alone if self.is_placed else [method for method in self._alone if method is Method.FREE]
        solved = estimate_from(evidence, channels, alone, self._noise, self._surface, dead, last)
        for method, estimates in solved.items():
            self._alike[method].update(estimates)
            moved = add_shared_errors(evidence, list(estimates.values()), self._noise, self.shared)
            if self.tips is not None and method is Method.FREE:
                moved = self.tips.with_depth(moved, evidence)
            self._estimates[method].enter({estimate.channel: estimate for estimate in moved})
        if not self.is_placed:
            self._leave_unplaced(channels, dead)
        elif self.module_model is not None:
            modules = self.module_model.modules_of(channels)
            # The surface method's first, if any: the search for a module starts from the best.
            others = [self._alike[method] for method in reversed(self._alone)]
            table, kept = self._table, self._fitted
            found = estimate_modules(
                table, self.module_model, modules, self._noise, others, dead, shared=self.shared, fitted_modules=kept
            )
            self._update_placed(found)
            if kept is not None:
                self._apart.update(found)

    def _leave_unplaced(self, channels: Sequence[int], dead: Mapping[int, str]) -> None:
        """Give no estimates by methods that need the part's place."""
        for method in self.methods:
            if method is Method.FREE:
                continue
            found = {channel: _unplaced(channel, method, dead) for channel in channels}
            self._estimates[method].enter(found)
            if method in self._alike:
                self._alike[method].update(found)
            if method is Method.MODULES and self._fitted is not None:
                self._apart.update(found)


def _unplaced(channel: int, method: Method, dead: Mapping[int, str]) -> Estimate:
    if channel in dead:
        return Estimate(channel, method, State.DEAD, 0, reason=StateReason(Cause.EXTERNAL_TEXT, text=dead[channel]))
    return Estimate(channel, method, State.BLIND, 0, reason=StateReason(Cause.PART_UNPLACED))
