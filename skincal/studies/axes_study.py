"""The turn of taxels of three axes: error against pokes and run time, module or taxel, and mistakes of the axes.

Four flat modules of eight taxels, each turned in its own way, are poked by hand: the tip misses its taxel by a millimetre and
leans to any side. The skins are `simulation/vector_skin.py`: one with noise and the steps of its readings only, one with
unequal gains, soft material that bulges, and crosstalk between neighbours, and one with crosstalk between the axes of a taxel,
which no poke can tell from a turn. The goals are those of the first one; how far soft material bulges is assumed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from time import process_time
from typing import Any, NamedTuple

import numpy as np

from skincal.axes.module_axes import AxisMistakeKind, ModulePlan, find_axes, has_shared_turn
from skincal.axes.push_offset import OffsetCorrection, TaxelOffsets
from skincal.axes.skin_turns import MIN_SHARE_OF_STRONGEST, find_turns
from skincal.axes.turn_fit import AxisPokes, TurnFit
from skincal.contacts.value_order import OrderOfValues, ValueOrderCounts, count_strongest
from skincal.geometry import FloatArray, fit_rotation, mean_rows, rotation_by, rotation_vector
from skincal.model.errors import InputError
from skincal.model.skin_axes import ResponseRule, SkinAxes, ValueOrder
from skincal.palette import BLUE, GREEN, VERMILION
from skincal.plotting import Figure
from skincal.simulation.simulated_rig import PressedPlaces, cone_tilts, push_directions, tangents
from skincal.simulation.vector_skin import VectorErrors, VectorSkin
from skincal.studies.harness import Bench, Findings, Study

MODULES, ROWS, COLUMNS = 4, 2, 4
SPACING_M = 0.004
"""m, of the taxels: PaXini's are 1.2 to 4.1 mm apart, XELA's 4.7 mm."""
AIM_SD_M = 0.001
FORCE_NOISE_N = 0.05
MOMENT_NOISE_NM = 0.005
"""N m: it gives the place of a contact to 0.6 to 1.3 mm. An FT45 resolves 0.005 N m."""
FORCES_N = (4.0, 8.0)
FRAMES_IN_MEAN = 15
"""Skin frames of a still window."""
MODULE_GLUE_SD = float(np.radians(3.0))
"""rad, turn of a module from its plan about each axis."""
CHI2_95 = {2: 5.991, 3: 7.815}
"""95 % quantiles of chi-square by degrees of freedom."""
VECTOR_SKINS: Mapping[str, VectorErrors] = {
    "noise": replace(VectorErrors.none(), noise=0.02, step=0.1),
    "skin": VectorErrors(),
    "crosstalk": replace(VectorErrors(), axis_crosstalk=0.01),
}
GOAL_LEAN_DEG, GOAL_TAXEL_POKES, GOAL_MODULE_POKES = 15.0, 20, 8
GOAL_NORMAL_DEG, GOAL_PLANE_DEG = 0.5, 1.5
GOAL_MODULE_NORMAL_DEG, GOAL_MODULE_PLANE_DEG = 1.0, 3.0
INSIDE_MIN = 0.90
MISTAKE_POKES = (4, 8, 12, 16, 20)
TRIED_MISTAKES: Mapping[str, tuple[FloatArray | None, AxisMistakeKind | None]] = {
    "none": (None, None),
    "mirrored": (np.diag([1.0, -1.0, 1.0]), AxisMistakeKind.OPPOSITE),
    "x and y exchanged": (np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), AxisMistakeKind.EXCHANGED),
    "z negated": (np.diag([1.0, 1.0, -1.0]), AxisMistakeKind.OPPOSITE),
    "a module turned": (np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), AxisMistakeKind.TURNED),
    "order of values": (None, AxisMistakeKind.ORDER),
}


@dataclass(frozen=True, slots=True)
class AxesSizes:
    """Numbers of sessions and pokes."""

    seeds: int = 6
    mistake_seeds: int = 20
    skins: tuple[str, ...] = tuple(VECTOR_SKINS)
    leans_deg: tuple[float, ...] = (0.0, 5.0, 15.0, 30.0)
    taxel_pokes: tuple[int, ...] = (5, 8, 20, 40)
    """Pokes on each taxel."""
    module_pokes: tuple[int, ...] = (4, 8, 16)
    """Pokes on each module."""
    robots: int = 0
    """Sessions of a robot in the physics engine, for each skin of a fingertip."""


class Task(NamedTuple):
    """One simulated session."""

    skin: str
    lean_deg: float
    pokes: int
    """On each taxel, or on each module."""
    by_module: bool
    """Taxels have the axes of their module, and pokes are counted by module."""
    seed: int


class MistakeTask(NamedTuple):
    """Sessions of 20 pokes with one mistake."""

    mistake: str
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class Poked:
    """A simulated session."""

    skin: VectorSkin
    plans: tuple[ModulePlan, ...]
    forces: FloatArray
    """(n, 3) float, N, as measured."""
    readings: FloatArray
    """(n, taxels, 3) float, N, as measured, axes of each taxel."""
    contacts: FloatArray
    """(n, 3) float, m: places of the contacts, as measured."""


def measure(bench: Bench, sizes: AxesSizes) -> Findings:
    """Measure.

    Returns
    -------
    JSON: `seeds`, `turns` (a row of each case, see `_row`), `mistakes` (a row of each mistake, see `_mistake_row`), `robots`
    (a row of each skin, see `robot_row` of `robot_axes.py`)
    """
    seeds = range(1, 1 + sizes.seeds)
    cases = [
        Task(name, lean, pokes, False, 0) for name in sizes.skins for lean in sizes.leans_deg for pokes in sizes.taxel_pokes
    ]
    cases += [Task(name, GOAL_LEAN_DEG, pokes, True, 0) for name in sizes.skins for pokes in sizes.module_pokes]
    turns = bench.rows([(case, [case._replace(seed=seed) for seed in seeds]) for case in cases], run_session, _row, _row_text)
    named = [(name, [MistakeTask(name, seed) for seed in range(1, 1 + sizes.mistake_seeds)]) for name in TRIED_MISTAKES]
    mistakes = bench.rows(named, pokes_until_named, _mistake_row, _mistake_text)
    numbers = {"seeds": sizes.seeds, "turns": turns, "mistakes": mistakes, "robots": _poke_with_robots(bench, sizes.robots)}
    return Findings(numbers, axis_limits(turns, mistakes))


def _poke_with_robots(bench: Bench, sessions: int) -> list[dict[str, Any]]:
    """Measure sessions of a robot; none without the physics engine."""
    if not sessions:
        return []
    from skincal.physics.engine import load_mujoco  # other sizes do without

    try:
        load_mujoco()
    except InputError as error:
        bench.say(f"no sessions of a robot: {error}")
        return []
    from skincal.studies.robot_axes import RobotTask, poke_fingertip, robot_row, robot_text

    cases = [(is_bonded, [RobotTask(is_bonded, seed) for seed in range(1, 1 + sessions)]) for is_bonded in (False, True)]
    return bench.rows(cases, poke_fingertip, robot_row, robot_text)


def poke_skin(task: Task, count: int, rng: np.random.Generator) -> Poked:
    """Simulate `count` pokes, aimed at taxels in turn: at each taxel equally, or at random ones of each module in turn."""
    places, normals, axes, plans = _lay_modules(rng)
    skin = VectorSkin(places, normals, VECTOR_SKINS[task.skin], rng, axes if task.by_module else None)
    taxels = len(places)
    if task.by_module:
        targets = (np.arange(count) % MODULES) * ROWS * COLUMNS + rng.integers(0, ROWS * COLUMNS, count)
    else:
        targets = np.arange(count) % taxels
    out = normals[targets]
    e1, e2 = tangents(out)
    off = AIM_SD_M * rng.standard_normal((count, 2))
    lean = np.radians(task.lean_deg)
    tilts = cone_tilts(count, lean, rng) if lean else np.zeros(count)
    directions = push_directions(out, tilts, rng.uniform(0.0, 2.0 * np.pi, count))
    size = rng.uniform(*FORCES_N, count)
    points = places[targets] + off[:, :1] * e1 + off[:, 1:] * e2
    pressed = PressedPlaces(targets, points, out, directions, size, rng.uniform(0.0, np.pi, count))
    forces = directions * size[:, None]
    true = skin.readings(pressed, forces)
    readings = np.mean([skin.measured(true, rng) for _ in range(FRAMES_IN_MEAN)], axis=0)
    measured = forces + FORCE_NOISE_N * rng.standard_normal((count, 3))
    off = MOMENT_NOISE_NM / size[:, None] * rng.standard_normal((count, 2))
    return Poked(skin, plans, measured, readings, points + off[:, :1] * e1 + off[:, 1:] * e2)


def _lay_modules(rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray, tuple[ModulePlan, ...]]:
    """Lay flat modules far from each other: places and normals (n, 3), axes (n, 3, 3) of their module, and their plans."""
    x, y = np.meshgrid(SPACING_M * np.arange(COLUMNS), SPACING_M * np.arange(ROWS))
    flat = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    places, axes, plans = list[FloatArray](), list[FloatArray](), list[ModulePlan]()
    for number in range(MODULES):
        plan = rotation_by(rng.uniform(-1.5, 1.5, 3))
        true = plan @ rotation_by(MODULE_GLUE_SD * rng.standard_normal(3))
        places.append(flat @ true.T + np.array([0.1 * number, 0.0, 0.0]))
        axes.append(np.tile(true, (len(flat), 1, 1)))
        first = number * len(flat)
        plans.append(ModulePlan(number, tuple(range(first, first + len(flat))), plan))
    turned = np.concatenate(axes)
    return np.concatenate(places), turned[:, :, 2], turned, tuple(plans)


def collect(forces: FloatArray, readings: FloatArray) -> dict[int, AxisPokes]:
    """Collect the pokes of each taxel, as `pokes_by_taxel` does from contacts; the answer is the length of a reading."""
    sizes = np.linalg.norm(readings, axis=2)
    pressed = sizes >= MIN_SHARE_OF_STRONGEST * sizes.max(axis=1, keepdims=True)
    return {
        taxel: AxisPokes(forces[own], readings[own, taxel], np.flatnonzero(own))
        for taxel, own in enumerate(pressed.T)
        if own.any()
    }


def axes_of_readings(response: FloatArray, axes: FloatArray) -> FloatArray:
    """Compute the axes (3, 3) that fit the exact readings of pushes around -z best: the housing's without crosstalk.

    Crosstalk between the axes of a taxel turns its readings, and no poke tells that from a turn of the taxel.

    Parameters
    ----------
    response : (3, 3) float, reading for a force in the link frame
    axes : (3, 3) float, of the housing
    """
    lean, azimuth = (each.ravel() for each in np.meshgrid(np.radians([5.0, 10.0, 15.0]), np.arange(12) * np.pi / 6.0))
    pushes = np.stack([np.sin(lean) * np.cos(azimuth), np.sin(lean) * np.sin(azimuth), -np.cos(lean)], axis=1) @ axes.T
    readings, best = pushes @ response.T, (np.inf, axes)
    for ratio in np.exp(np.linspace(-1.2, 0.6, 181)):
        felt = readings / [ratio, ratio, 1.0]
        felt /= np.linalg.norm(felt, axis=1)[:, None]
        turn = fit_rotation(pushes.T @ felt)
        best = min(best, (float(np.sum((felt @ turn.T - pushes) ** 2)), turn), key=lambda each: each[0])
    return best[1]


def offsets_of(poked: Poked, pokes: Mapping[int, AxisPokes]) -> dict[int, TaxelOffsets]:
    """Measure the offsets of the pushes from taxels, which lie as planned on modules that the contacts place."""
    found = dict[int, TaxelOffsets]()
    for plan in poked.plans:
        own = [channel for channel in plan.channels if channel in pokes]
        if not own:
            continue
        gaps = {channel: poked.contacts[pokes[channel].pokes] - poked.skin.places[channel] for channel in own}
        every = np.concatenate([gaps[channel] for channel in own])
        shift = mean_rows(every)
        spread = float(np.sum((every - shift) ** 2)) / (2.0 * len(every))
        covariance = spread / len(every) * np.eye(3)
        for channel in own:
            found[channel] = TaxelOffsets(gaps[channel] - shift, covariance, poked.skin.normals[channel])
    return found


def run_session(task: Task) -> dict[str, Any]:
    """Simulate a session and find its turns: errors in degrees, and the time."""
    rng = np.random.default_rng([task.seed, task.pokes, int(10 * task.lean_deg), int(task.by_module)])
    count = task.pokes * (MODULES if task.by_module else MODULES * ROWS * COLUMNS)
    poked = poke_skin(task, count, rng)
    begin = process_time()
    turns = find_turns(collect(poked.forces, poked.readings), FORCE_NOISE_N)
    findings = find_axes(turns, poked.plans)
    modules = {module.id: module.turn for module in findings.modules}
    shared = [module.id for module in findings.modules if has_shared_turn(module, findings.log_odds_shared)]
    corrected = OffsetCorrection().correct(turns, modules, shared, offsets_of(poked, turns.pokes))
    seconds = process_time() - begin
    if task.by_module:
        fits = [(turn.fit, turn.channels) for turn in corrected.modules.values()]
    else:
        fits = [(turn.fit, turn.channels) for turn in corrected.skin.taxels.values()]
    skin = poked.skin
    housings = [skin.axes[channels[0]] for _, channels in fits]
    read = [
        axes_of_readings(skin.response[list(each[1])].mean(axis=0), true) for each, true in zip(fits, housings, strict=True)
    ]
    errors, of_readings = (
        [_errors(fit, true) for (fit, _), true in zip(fits, every, strict=True)] for every in (housings, read)
    )
    return {
        "normal": [each[0] for each in errors], "plane": [each[1] for each in errors],
        "inside": [each[2] for each in of_readings], "housing_inside": [each[2] for each in errors],
        "known": [fit.is_in_plane_known for fit, _ in fits],
        "lean": [corrected.lean.value],
        "ms": 1e3 * seconds / len(turns.taxels),
        "right": [(module.is_shared if task.by_module else module.is_separate) for module in findings.modules],
        "wrong": [(module.is_separate if task.by_module else module.is_shared) for module in findings.modules],
    }  # fmt: skip


def _errors(fit: TurnFit, true: FloatArray) -> tuple[float, float, bool]:
    """Compute the errors of z and of the turn about it, degrees, and whether the truth is in the 95 % region."""
    normal = float(np.degrees(np.arccos(np.clip(fit.rotation[:, 2] @ true[:, 2], -1.0, 1.0))))
    off = rotation_vector(fit.rotation.T @ true)
    if fit.is_in_plane_known:
        square = off @ np.linalg.solve(fit.covariance[:3, :3], off)
        return normal, float(abs(np.degrees(off[2]))), bool(square <= CHI2_95[3])
    z = fit.rotation.T @ true[:, 2]
    lean = np.array([-z[1], z[0]])
    return normal, float("nan"), bool(lean @ np.linalg.solve(fit.covariance[:2, :2], lean) <= CHI2_95[2])


def _row(case: Task, found: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Summarize the sessions of a case.

    Returns
    -------
    JSON: `skin`, `lean_deg`, `pokes`, `by_module`, `normal_deg` and `plane_deg` (median and 95 %; `None` if no turn in the
    plane is known), `inside` (share of the turns of the readings in their 95 % regions), `housing_inside` (the same of the
    housings), `known` (share), `right` and `wrong` (shares of modules whose question is decided), `push_lean_deg_per_mm`
    (median), `ms` a taxel
    """
    joined = {
        name: np.concatenate([np.asarray(each[name], dtype=float) for each in found]) for name in found[0] if name != "ms"
    }
    plane = joined["plane"][np.isfinite(joined["plane"])]
    return {
        "skin": case.skin, "lean_deg": case.lean_deg, "pokes": case.pokes, "by_module": case.by_module,
        "normal_deg": [float(np.quantile(joined["normal"], q)) for q in (0.5, 0.95)],
        "plane_deg": [float(np.quantile(plane, q)) for q in (0.5, 0.95)] if len(plane) else None,
        **{name: float(joined[name].mean()) for name in ("inside", "housing_inside", "known", "right", "wrong")},
        "push_lean_deg_per_mm": float(np.degrees(np.median(joined["lean"])) * 1e-3),
        "ms": float(np.median([each["ms"] for each in found])),
    }  # fmt: skip


def pokes_until_named(task: MistakeTask) -> tuple[int | None, bool]:
    """Count the pokes, of `MISTAKE_POKES`, until the mistake is named; `None` if it is not. Also: whether another one was."""
    rng = np.random.default_rng([task.seed, 77])
    matrix, kind = TRIED_MISTAKES[task.mistake]
    poked = poke_skin(Task("skin", GOAL_LEAN_DEG, 0, True, task.seed), MISTAKE_POKES[-1], rng)
    readings = poked.readings
    if matrix is not None:
        is_turned = np.zeros(readings.shape[1], dtype=bool)
        is_turned[: ROWS * COLUMNS] = True
        changed = readings @ matrix.T
        readings = np.where(is_turned[:, None], changed, readings) if kind is AxisMistakeKind.TURNED else changed
    for count in MISTAKE_POKES:
        named = _named(poked, readings[:count], kind is AxisMistakeKind.ORDER)
        if named:
            return (count, False) if named == {kind} else (count if kind in named else None, True)
    return None, False


def _named(poked: Poked, readings: FloatArray, is_sent_by_axis: bool) -> set[AxisMistakeKind]:
    """Name the mistakes of the first pokes of a session, from the frames that the device sends."""
    order = ValueOrder.BY_AXIS if is_sent_by_axis else ValueOrder.BY_TAXEL
    sent = SkinAxes(order, (1, 1, 1), (0, 1, 2), ResponseRule.LENGTH, "N")
    read = replace(sent, order=ValueOrder.BY_TAXEL)
    frames, counts = sent.as_frames(readings), ValueOrderCounts()
    for frame in frames:
        counts = counts.plus(count_strongest(read, frame))
    turns = find_turns(collect(poked.forces[: len(frames)], read.sort_values(frames)), FORCE_NOISE_N)
    return {mistake.kind for mistake in find_axes(turns, poked.plans, OrderOfValues(counts, read.order)).mistakes}


def _mistake_row(mistake: str, found: Sequence[tuple[int | None, bool]]) -> dict[str, Any]:
    """Summarize: `mistake`, `named` (share), `pokes` (largest number until it is named), `wrong` (share with another name)."""
    counts = [count for count, _ in found if count is not None]
    return {
        "mistake": mistake, "named": len(counts) / len(found), "pokes": max(counts, default=None),
        "wrong": float(np.mean([other for _, other in found])),
    }  # fmt: skip


def axis_limits(
    turns: Sequence[Mapping[str, Any]], mistakes: Sequence[Mapping[str, Any]]
) -> dict[str, tuple[float, str, float]]:
    """List the limits: errors and coverage of the goals, and the mistakes."""
    by_case = {(row["skin"], row["lean_deg"], row["pokes"], row["by_module"]): row for row in turns}
    taxel = by_case["noise", GOAL_LEAN_DEG, GOAL_TAXEL_POKES, False]
    module = by_case["noise", GOAL_LEAN_DEG, GOAL_MODULE_POKES, True]
    goal_lean = [row for row in turns if row["lean_deg"] == GOAL_LEAN_DEG]
    named = [row for row in mistakes if row["mistake"] != "none"]
    return {
        "axes_normal_deg": (taxel["normal_deg"][0], "<=", GOAL_NORMAL_DEG),
        "axes_plane_deg": (taxel["plane_deg"][0], "<=", GOAL_PLANE_DEG),
        "axes_module_normal_deg": (module["normal_deg"][0], "<=", GOAL_MODULE_NORMAL_DEG),
        "axes_module_plane_deg": (module["plane_deg"][0], "<=", GOAL_MODULE_PLANE_DEG),
        "axes_inside": (min(row["inside"] for row in goal_lean), ">=", INSIDE_MIN),
        "axes_wrong_decisions": (max(row["wrong"] for row in goal_lean), "<=", 0.05),
        "axes_mistakes_named": (min(row["named"] for row in named), ">=", 0.95),
        "axes_other_mistakes_named": (max(row["wrong"] for row in mistakes), "<=", 0.05),
    }


def describe(result: Mapping[str, Any]) -> list[str]:
    """Describe each case."""
    head = f"{MODULES} modules of {ROWS * COLUMNS} taxels, {result['seeds']} sessions of each kind (median, 95 %):"
    lines = [head, *map(_row_text, result["turns"]), *map(_mistake_text, result["mistakes"])]
    if result.get("robots"):
        from skincal.studies.robot_axes import robot_text

        lines += map(robot_text, result["robots"])
    return lines


def _row_text(row: Mapping[str, Any]) -> str:
    plane = "unknown" if row["plane_deg"] is None else "{:.2f}, {:.2f}".format(*row["plane_deg"])
    each = "a module" if row["by_module"] else "a taxel"
    housing = f", of the housings {row['housing_inside']:.2f}" if row["skin"] == "crosstalk" else ""
    return (
        f"  {row['skin']}, leans up to {row['lean_deg']:g} deg, {row['pokes']} pokes {each}: normal "
        f"{row['normal_deg'][0]:.2f}, {row['normal_deg'][1]:.2f} deg; turn in the plane {plane} deg, known {row['known']:.2f}; "
        f"inside {row['inside']:.2f}{housing}; module or taxel: right {row['right']:.2f}, wrong {row['wrong']:.2f}; "
        f"{row['ms']:.0f} ms a taxel"
    )


def _mistake_text(row: Mapping[str, Any]) -> str:
    if row["mistake"] == "none":
        return f"  no mistake: another one named in {row['wrong']:.2f} of the sessions"
    until = "not named" if row["pokes"] is None else f"within {row['pokes']} pokes"
    return f"  {row['mistake']}: named in {row['named']:.2f}, {until}; another one named in {row['wrong']:.2f}"


def draw(result: Mapping[str, Any], figure: Figure) -> None:
    """Draw the errors of z and of the turn about it against the pokes on a taxel; a column for each skin."""
    panels = figure.subplots(2, len(VECTOR_SKINS), sharex=True, sharey="row")
    rows = [row for row in result["turns"] if not row["by_module"]]
    leans = sorted({row["lean_deg"] for row in rows})
    colours = dict(zip(leans, ("#888888", VERMILION, BLUE, GREEN), strict=False))
    for column, name in enumerate(VECTOR_SKINS):
        for lean in leans:
            own = [row for row in rows if row["skin"] == name and row["lean_deg"] == lean]
            for line, key in enumerate(("normal_deg", "plane_deg")):
                known = [(row["pokes"], row[key][0]) for row in own if row[key] is not None]
                if known:
                    axes = panels[line][column]
                    axes.loglog(*zip(*known, strict=True), "o-", color=colours[lean], label=f"leans up to {lean:g} degrees")
        panels[0][column].set_title(name)
        panels[1][column].set_xlabel("pokes on a taxel")
        for line, goal in enumerate((GOAL_NORMAL_DEG, GOAL_PLANE_DEG)):
            panels[line][column].axhline(goal, color="#BBBBBB", linewidth=0.8)
            panels[line][column].grid(visible=True)
    panels[0][0].set_ylabel("error of the normal, degrees")
    panels[1][0].set_ylabel("error of the turn in the plane, degrees")
    panels[0][0].legend()


QUICK_SIZES = AxesSizes(seeds=2, mistake_seeds=4, leans_deg=(5.0, 15.0), taxel_pokes=(8, 20), module_pokes=(8,))
THIS_STUDY = Study("axes", quick=QUICK_SIZES, full=AxesSizes(robots=4), measure=measure, lines=describe, draw=draw)
