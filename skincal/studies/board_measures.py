"""The modules method on one cell of the runtime study, beside a general solver of the same rows.

The alternative is scipy's Levenberg-Marquardt (`least_squares`, MINPACK) with a differenced Jacobian, each module by itself,
from the same start. It gets the method's own rows, whitened anew at each pose, and computes neither trust nor uncertainty:
both favour it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry.arrays import FloatArray
from skincal.methods import estimate_from, estimate_taxels
from skincal.modules.pose import ModuleModel, ModulePoses, Pads
from skincal.modules.pose_fit import Touches, find_touches, start_of, whitened
from skincal.studies import measures
from skincal.studies.clock import Spread, sampled, timed
from skincal.studies.measures import Cell, Positions, Row, positions_of
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Estimate, Method

GENERAL: dict[str, Any] = {"method": "lm", "xtol": 1e-10, "ftol": 1e-12, "gtol": 1e-12}
"""Unknowns are metres: it stops where a step is a hundredth of a micrometre of a pose some centimetres away."""


def modules(cell: Cell) -> Iterator[Row]:
    """Measure the modules method from contacts, with the surface method that it begins from; then what it is compared with."""
    row = measures.shipped(cell, Method.MODULES)
    yield row
    if len(cell.bench.rig.stances) > 1:
        yield measures.per_pose(cell, Method.MODULES)
    yield measures.beside(_general(cell), row)


def _general(cell: Cell) -> Row:
    contacts, boards = cell.runs[0], measures.boards_of(cell)
    front, start = timed(lambda: _begin(contacts, boards, cell), 1)
    found: Positions = {}

    def solve(module: int) -> None:
        found.update(_solved(start, boards, module, cell))

    order: list[int] = np.random.default_rng(3).permutation(list(start)).tolist()
    seconds = sampled((partial(solve, module) for module in order), cell.budget_s)
    total = Spread.of(seconds).times(len(order)).plus(front[0])
    part = None
    if len(seconds) < len(order):
        part = {"modules": len(seconds), "of_modules": len(order), "seconds": float(np.sum(seconds))}
    return _beside(cell, boards, cell.row("modules-general", total, [found], part), found)


def _beside(cell: Cell, boards: ModuleModel, row: Row, found: Positions) -> Row:
    """Return the row with how far its answers lie from ours, every poke counting fully, and what it errs more than ours."""
    errors, noise = cell.bench.errors, cell.bench.scene.noise

    def ours(*, doubting: bool) -> Positions:
        every = estimate_taxels(cell.runs[0], sorted(found), [Method.MODULES], noise, cell.surface, {}, doubting, boards)
        return positions_of(every[Method.MODULES])

    off = [float(np.linalg.norm(found[channel] - point)) for channel, point in ours(doubting=False).items()]
    as_shipped = ours(doubting=True)
    more = np.mean(errors({channel: found[channel] for channel in as_shipped})) - np.mean(errors(as_shipped))
    return {**row, "off_ours_m": max(off, default=None), "error_beside_ours_mm": 1e3 * float(more)}


Begun = Mapping[int, tuple[Touches, ModulePoses]]
"""The pokes and the start of each module that can be solved."""


def _begin(contacts: Sequence[Contact], boards: ModuleModel, cell: Cell) -> Begun:
    """Solve by the surface method, gather the pokes of each module and find where its search begins."""
    ledger, noise = ContactTable(contacts), cell.bench.scene.noise
    others = [estimate_from(ledger, cell.channels, [Method.SURFACE], noise, cell.surface)[Method.SURFACE]]
    return {
        module: begun
        for module in boards.modules_of(cell.channels)
        if (begun := _begin_one(ledger, boards, module, others, cell)) is not None
    }


def _begin_one(
    ledger: ContactTable, boards: ModuleModel, module: int, others: Sequence[Mapping[int, Estimate]], cell: Cell
) -> tuple[Touches, ModulePoses] | None:
    evidence = ledger.evidence(boards.channels_of([module]))
    pose = start_of(boards, module, others)
    touches = find_touches(evidence, ledger.totals(evidence.pokes), boards, cell.bench.scene.noise, [module])
    return None if pose is None or len(touches.of) < 2 else (touches, pose)


def _solved(begun: Begun, boards: ModuleModel, module: int, cell: Cell) -> Positions:
    """Return where a general solver puts a module's pads."""
    touches, start = begun[module]
    flat, of = boards.pads[module], np.zeros(len(boards.pads[module]), dtype=np.int64)

    def laid(move: FloatArray) -> Pads:
        return boards.ground.laid(boards.ground.moved(start, move[None]).take(of), flat)

    def misses(move: FloatArray) -> FloatArray:
        return whitened(touches, laid(move), cell.bench.scene.noise).misses.ravel()

    optimize: Any = import_module("scipy.optimize")
    move: FloatArray = optimize.least_squares(misses, np.zeros(boards.ground.unknowns), **GENERAL).x
    channels = boards.channels_of([module])
    return dict(zip(channels, laid(move).points, strict=True))
