"""How far the modules method is from the exact answer on hard pokes: the part of `stability.py` that is about boards.

The error is that of the worst pad, each against its own bar; pads that must be called blind are to be called so, and no others.
Pads whose place the pokes do not determine at all have none that could be compared. Poke numbers change with the order, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from skincal.contacts.outcome import Contact
from skincal.geometry.arrays import FloatArray, IntArray
from skincal.mesh.surface import Surface, make_surface
from skincal.model.scene import NoiseSettings
from skincal.model.skin import Anchor, Layout, Module
from skincal.modules.estimate import estimate_modules
from skincal.modules.pose import ModuleModel, ModulePoses, Pads
from skincal.modules.pose_fit import ModuleRows, Touches, bends_of, find_touches, fit_modules, whitened
from skincal.studies import exact
from skincal.studies.bar import bar, over_bar
from skincal.studies.board_cases import KIND, PADS, BoardCase, BoardReadings
from skincal.studies.board_exact import BoardTruth
from skincal.studies.exact import NO_NUMBER
from skincal.taxels.contact_table import ContactTable

STEPS = 15
"""Of an alternative: more than the worst case needs."""


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """What a solver says of a module's k pads."""

    pads: FloatArray
    """(k, 3) float, metres; wherever it is, of pads that are not known."""
    blind: NDArray[np.bool_]
    """(k,) whether no estimate is given."""


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """A case as the program has it."""

    boards: ModuleModel
    ledger: ContactTable
    touches: Touches
    start: ModulePoses
    noise: NoiseSettings

    def laid(self, pose: ModulePoses) -> Pads:
        """Return where the pads of the board at one pose lie."""
        return self.boards.ground.laid(pose.take(np.zeros(PADS, dtype=np.int64)), self.boards.pads[0])


BoardSolver: TypeAlias = Callable[[Told], Placed]


def surface_of(case: BoardCase) -> Surface | None:
    """Return what the module lies on."""
    mesh = case.board.mesh
    return None if mesh is None else make_surface(mesh.vertices, mesh.triangles)


def told(case: BoardCase, readings: BoardReadings, surface: Surface | None) -> Told:
    """Return pokes as the program gets them, the module's start as its plan."""
    at = case.start
    anchor = Anchor(np.zeros(2), at.points[0], at.x[0], at.normals[0])
    layout = Layout((Module(0, KIND, 0, np.zeros(2), 0.0, case.board.mirror),), PADS + 1)
    boards = ModuleModel(layout, anchor, surface)
    ledger = ContactTable(_contacts(readings))
    evidence = ledger.evidence(boards.channels_of([0]))
    touches = find_touches(evidence, ledger.totals(evidence.pokes), boards, case.noise, [0])
    start = boards.plan(0)
    if start is None:
        raise ValueError(f"{case.name}: the search begins off the mesh")
    return Told(boards, ledger, touches, start, case.noise)


def _contacts(readings: BoardReadings) -> list[Contact]:
    answers = np.concatenate([readings.responses, readings.beside[:, None]], axis=1)
    return [
        Contact(
            number + 1, 0.0, 1.0, readings.forces[number], readings.moments[number], np.flatnonzero(row), row[row > 0],
            readings.poses[pose], f"pose {pose}", 0.0, True,
        )
        for number, (row, pose) in enumerate(zip(answers, readings.pose_of.tolist(), strict=True))
    ]  # fmt: skip


def shipped_board(one: Told) -> Placed:
    """Place the module as the program does; every poke counts fully."""
    fitted = fit_modules(one.touches, one.boards, one.start, one.noise, doubting=False)
    said = estimate_modules(one.ledger, one.boards, [0], one.noise, [], {}, doubting=False)
    return Placed(fitted.pads.points, np.array([said[channel].position is None for channel in range(PADS)]))


def judge_board(case: BoardCase, truth: BoardTruth, solver: BoardSolver) -> dict[str, Any]:
    """Return the record of a case."""
    surface = surface_of(case)
    found = [solver(told(case, case.readings.ordered(order), surface)) for order in _orders(case)]
    same = all(np.array_equal(one.pads, found[0].pads, equal_nan=True) for one in found)
    right = all(np.array_equal(one.blind, np.array(truth.blind)) for one in found)
    error, bound, size = _worst(case, truth, [one.pads for one in found])
    error = error if right else NO_NUMBER
    return {
        "name": case.name, "solver": "modules", "error": error, "bound": bound, "error_over_bound": over_bar(error, bound),
        "holds": bool(error <= bound and same), "same_bits": same, "size": size,
        "readings": len(case.readings.forces) * case.copies, "draws_by": "step", "blind_right": right,
        "compared": 0 if case.lost else sum(truth.determined),
    }  # fmt: skip


def _worst(case: BoardCase, truth: BoardTruth, found: list[FloatArray]) -> tuple[float, float, float]:
    """Return error, bar and norm of the pad with the largest error over its bar."""
    sizes = [exact.distance(place) for place in truth.pads]
    worst = 0.0, bar(0.0, min(sizes)), min(sizes)
    if case.lost:
        return worst
    for pad in np.flatnonzero(truth.determined).tolist():
        bound = bar(truth.changes[pad], sizes[pad])
        error = max(exact.distance_to(pads[pad], truth.pads[pad]) for pads in found)
        worst = max(worst, (error, bound, sizes[pad]), key=lambda one: one[0] / one[1])
    return worst


def _orders(case: BoardCase) -> Iterator[IntArray]:
    """Yield the orders in which the pokes come: as they are, reversed, shuffled."""
    own = np.tile(np.arange(len(case.readings.forces)), case.copies)
    yield own
    if len(own) > 1:
        yield own[::-1]
        yield np.random.default_rng(len(own)).permutation(own)


def compare_board(case: BoardCase, truth: BoardTruth) -> list[dict[str, Any]]:
    """Return how other ways do on the case, if the pokes determine every pad: none of them says what is blind."""
    if case.lost or not all(truth.determined):
        return []
    records: list[dict[str, Any]] = []
    one = told(case, case.readings.ordered(next(_orders(case))), surface_of(case))
    for name, way in BOARD_ALTERNATIVES.items():
        error, bound, _ = _worst(case, truth, [way(one)])
        share = over_bar(error, bound)
        records.append({"name": case.name, "solver": "modules", "method": name, "error": error, "error_over_bound": share})
    return records


def by_normal_equations(one: Told) -> FloatArray:
    """Take the program's own steps from its own rows, by A'A - B and A'b."""
    pose = one.start
    for _ in range(STEPS):
        rows = whitened(one.touches, one.laid(pose), one.noise)
        a = rows.slopes.reshape(-1, rows.slopes.shape[2])
        right, plain = a.T @ rows.misses.ravel(), a.T @ a
        matrix = plain - np.sum(bends_of(one.touches, rows, one.boards.ground), axis=0)
        bent = bool(np.linalg.eigvalsh(matrix + matrix.T)[0] > 0.0)
        try:
            step = np.asarray(np.linalg.solve(matrix if bent else plain, right), dtype=np.float64)
        except np.linalg.LinAlgError:
            return np.full((PADS, 3), np.nan)
        step = step / max(1.0, float(np.abs(step).max()) / 0.015)
        pose = one.boards.ground.moved(pose, step[None])
        if float(np.abs(step).max()) < 1e-16:
            break
    return one.laid(pose).points


def by_differences(one: Told) -> FloatArray:
    """Minimise by `scipy.optimize.least_squares` with its differenced Jacobian.

    The noise is held as it is at the answer, so that the minimum is where the program looks for it.
    """
    ground, rows = one.boards.ground, _rows_at_answer(one)
    at, pairs = one.touches.rows, one.touches.evidence.pairs[one.touches.rows]

    def misses(move: FloatArray) -> FloatArray:
        places = one.touches.middles(one.laid(ground.moved(one.start, move[None])))[0]
        off = np.sum(pairs * (one.touches.evidence.nearest[at] - places)[:, None], axis=2)
        return np.sum(rows.whiten * off[:, None], axis=2).ravel()

    optimize: Any = import_module("scipy.optimize")
    found = optimize.least_squares(misses, np.zeros(ground.unknowns), method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return one.laid(ground.moved(one.start, np.asarray(found.x, dtype=np.float64)[None])).points


def _rows_at_answer(one: Told) -> ModuleRows:
    fitted = fit_modules(one.touches, one.boards, one.start, one.noise, doubting=False)
    return whitened(one.touches, fitted.pads, one.noise)


BOARD_ALTERNATIVES: dict[str, Callable[[Told], FloatArray]] = {
    "normal equations": by_normal_equations,
    "least_squares, differenced": by_differences,
}
