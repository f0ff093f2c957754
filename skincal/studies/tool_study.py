"""A tool that pokes a still part: error against pokes and run time, by rig and by the knowledge of the part.

The sessions come from an independent simulator (`tool_simulator`) with all imperfections of a cobot or of a tracked probe. The
part's pose in the base is found from touches of landmarks, from the mesh and from the layout, or it is given, or nothing is
known of the part. While it is not known, positions are in the base, and their errors too.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from skincal.contacts.outcome import RAW_UNIT, Contact, Reason, Rejection
from skincal.geometry import FloatArray, inverse_pose
from skincal.guide.verdict import check, is_believed
from skincal.mesh.surface import make_surface
from skincal.model.actions import AtLandmark
from skincal.model.scene import Landmark, Scene
from skincal.model.tool_rig import (
    BASE_LINK,
    DEFAULT_TOOL_TURN_MAX_DEG,
    POINT_FORCE_N,
    PUSH_TURN_SD_RAD,
    TIP_SD_DEFAULT_MM,
    ToolSpec,
)
from skincal.palette import BLACK, BLUE, GREEN, VERMILION
from skincal.plotting import Figure
from skincal.rig.correction_fit import correct_rig
from skincal.rig.part_agreement import agreement_at_landmarks
from skincal.session.session import Session
from skincal.simulation.example_parts import forearm
from skincal.studies.error_numbers import error_numbers, mean_over_seeds
from skincal.studies.harness import Bench, Findings, Limits, Study
from skincal.studies.tool_simulator import NO_LANDMARK, TOOL_RIGS, ToolSession, simulate_tool_session
from skincal.taxels.result import Method

GOAL_POKES, GOAL_LANDMARKS = 168, 6
"""Two pokes for each taxel of the forearm."""
POKE_CYCLE_S = 3.5
"""s, from one poke to the next: a robot's way, a rest and a press."""
BASE_ALONE, POSE_GIVEN, POSE_FOUND = "nothing", "pose", "touches"
"""Knowledge of the part: none, so that positions are in the base; its pose in the base, from the scene; or its touches."""
GOALS_MM = {
    "wrist": {"modules": 0.8, "surface": 1.2, "free": 1.6},
    "none": {"modules": 1.0, "surface": 1.5, "free": 2.0},
}
"""Largest mean errors with six landmarks, the mesh and `GOAL_POKES`, by rig and method."""
COVERAGE_MIN, RATIO_MIN, RATIO_MAX = 0.90, 0.7, 1.5
"""Goals of the share of the taxels inside their 95 % regions, and of predicted over true error."""
BELIEVED_MIN, WRONGLY_BELIEVED_MAX = 0.80, 0.02
"""Goals: share of right sessions that the verdict believes, and of wrong ones."""
RIGHT_MIN_COVERAGE, WRONG_MAX_COVERAGE = 0.90, 0.80
"""Share of the taxels inside from which a prediction is right, and below which it is wrong."""
WRONG_LANDMARK, WRONG_LANDMARK_SHIFT_M = "one landmark 7 mm off", (0.006, 0.0, -0.004)
"""Mistake made on purpose in sessions of their own: the place of the first landmark, as a wrong drawing has it."""
LARGE_DRAWING, LARGE_DRAWING_SCALE = "landmarks 3 % too far apart", 1.03
"""Another one: all landmarks of a drawing that is too large."""
WIDE_MESH, WIDE_MESH_SCALES = "mesh 6 % too wide", (1.06, 1.0, 1.0)
"""Another one: the mesh, across the forearm."""
SCALE_NAMED_WHERE_RIGHT_MAX = 0.02
"""Goal: share of right sessions with a mesh whose drawing is named for its scale."""
METHOD_COLOURS = dict(zip(Method, (BLUE, GREEN, VERMILION), strict=True))


class ToolCase(NamedTuple):
    """Rig of `TOOL_RIGS`, what the scene knows of the part, and whether it has a mesh."""

    rig: str
    known: str
    landmarks: int
    has_mesh: bool
    mistake: str = ""
    """Made on purpose: `WRONG_LANDMARK`, `LARGE_DRAWING` or `WIDE_MESH`; empty for a right session."""

    @property
    def words(self) -> str:
        """Describe the case."""
        part = {BASE_ALONE: "positions in the base", POSE_GIVEN: "part's pose given", POSE_FOUND: "part's pose found"}[
            self.known
        ]
        wrong = f", {self.mistake}" if self.mistake else ""
        return f"{self.rig}, {part}, {self.landmarks} landmarks, {'mesh' if self.has_mesh else 'no mesh'}{wrong}"


TOOL_CASES = (
    ToolCase("ideal", POSE_FOUND, 6, has_mesh=True),
    ToolCase("wrist", POSE_GIVEN, 0, has_mesh=True),
    ToolCase("wrist", BASE_ALONE, 0, has_mesh=False),
    ToolCase("good_wrist", POSE_FOUND, 6, has_mesh=True),
    *(
        ToolCase(rig, POSE_FOUND, count, has_mesh=mesh)
        for rig in ("wrist", "none", "probe") for mesh in (True, False) for count in (6, 3, 0)
    ),
    *(
        ToolCase(rig, POSE_FOUND, 6, True, mistake)
        for mistake in (WRONG_LANDMARK, LARGE_DRAWING, WIDE_MESH) for rig in ("wrist", "none")
    ),
)  # fmt: skip
QUICK_CASES = tuple(case for case in TOOL_CASES if case.has_mesh and not case.mistake and case.landmarks in (0, GOAL_LANDMARKS))


@dataclass(frozen=True, slots=True)
class ToolSizes:
    """Numbers of sessions and pokes."""

    seeds: int = 20
    counts: tuple[int, ...] = (42, 84, 126, 168, 252, 336)
    """Numbers of pokes on the skin after which a session is solved."""
    cases: tuple[ToolCase, ...] = TOOL_CASES


class Task(NamedTuple):
    """One simulated session."""

    case: ToolCase
    seed: int
    sizes: ToolSizes


def measure(bench: Bench, sizes: ToolSizes) -> Findings:
    """Measure.

    Returns
    -------
    JSON: `seeds`, `tool` (a row for each case, see `_row`)
    """
    seeds = range(1, 1 + sizes.seeds)
    cases = [(Task(case, 1, sizes), [Task(case, seed, sizes) for seed in seeds]) for case in sizes.cases]
    rows = bench.rows(cases, run_session, _row, _row_text)
    return Findings({"seeds": sizes.seeds, "tool": rows}, tool_limits(rows))


def run_session(task: Task) -> dict[int, dict[str, Any]]:
    """Simulate a session and solve it after each of its counts of pokes.

    Returns
    -------
    JSON by count: `methods`, the numbers of `error_numbers` by method, and `seconds`, processor time of the new pokes' solution
    """
    case, part = task.case, forearm()
    poked = simulate_tool_session(
        part.scene,
        part.surface.vertices,
        part.surface.triangles,
        TOOL_RIGS[case.rig],
        task.seed,
        (case.landmarks, max(task.sizes.counts)),
    )
    scene, surface = scene_of(case, poked), None
    if case.has_mesh:
        scales = np.array(WIDE_MESH_SCALES if case.mistake == WIDE_MESH else np.ones(3))
        surface = make_surface(poked.vertices * scales, part.surface.triangles)
    session, contacts = Session(scene, surface), contacts_of(poked, scene)
    touch_landmarks(session, poked)
    found: dict[int, dict[str, Any]] = {}
    done = 0
    for count in task.sizes.counts:
        start = time.process_time()
        for contact in contacts[done:count]:
            session.add(contact)
        done = count
        snapshot = session.snapshot()
        seconds = time.process_time() - start
        in_part = case.known != BASE_ALONE and snapshot.is_placed
        places = poked.places if in_part else _carry(poked.base_from_part, poked.places)
        numbers = {method.value: error_numbers(each, places) for method, each in snapshot.estimates.items()}
        found[count] = {"methods": numbers, "seconds": seconds, "placed": in_part, "believed": {}}
        found[count]["scale_named"] = snapshot.wrong_scale is not None
        if count == GOAL_POKES and in_part:
            found[count]["believed"] = _believed(session)
    return found


def touch_landmarks(session: Session, poked: ToolSession) -> None:
    """Add the touches at the landmarks, which no taxel answers, and name the landmark of each."""
    scene = session.scene
    assert scene.tool is not None
    for row in np.flatnonzero(poked.landmark != NO_LANDMARK).tolist():
        force, moment = _wrench_of(poked, row, scene)
        session.add(
            Rejection(
                poke=row + 1, start_s=POKE_CYCLE_S * row, end_s=POKE_CYCLE_S * row + scene.contacts.still_s,
                reason=Reason.NO_TAXEL, value=0.0, limit=scene.contacts.response_min, unit=RAW_UNIT,
                channels=np.empty(0, np.int64), final=True, force=force, moment=moment,
                link_from_sensor=scene.tool.link_from_sensor(poked.base_from_tool[row]), pose=scene.tool.arm_pose,
            )
        )  # fmt: skip
        session.act(AtLandmark(row + 1, scene.landmarks[int(poked.landmark[row])].name))


def _wrench_of(poked: ToolSession, row: int, scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Give force and moment of a poke; without a sensor a unit force along the tool, through the tip."""
    if scene.has_sensor:
        return poked.wrench[row, :3], poked.wrench[row, 3:]
    return np.array([0.0, 0.0, POINT_FORCE_N]), np.zeros(3)


def _believed(session: Session) -> dict[str, bool]:
    """Tell by method whether the verdict believes the predicted errors, as the window would."""
    snapshot, scene = session.snapshot(), session.scene
    rig = correct_rig(session.rig_request()) if scene.has_sensor else None
    landmarks = agreement_at_landmarks(rig, None, snapshot.part_pose, snapshot.tip_frame)
    return {
        method.value: snapshot.wrong_scale is None
        and is_believed(
            check(snapshot, session.channels, method, scene.noise, session.surface, session.module_model), landmarks
        )
        for method in session.methods
    }


def scene_of(case: ToolCase, poked: ToolSession) -> Scene:
    """Describe a simulated session as its user would: the forearm's layout, the tool, and the knowledge of the part."""
    own, model = forearm().scene, TOOL_RIGS[case.rig]
    is_given = case.known == POSE_GIVEN
    middle_of_ball = poked.tip - [0.0, 0.0, model.tip_radius]
    at_tip = np.eye(4)
    at_tip[:3, 3] = middle_of_ball
    tool = ToolSpec(
        has_sensor=model.has_sensor,
        form=None,
        metres_per_unit=None,
        tool_from_sensor=poked.tool_from_sensor if model.has_sensor else at_tip,
        link_from_base=inverse_pose(poked.base_from_part) if is_given else np.eye(4),
        has_part_pose=is_given,
        part_pose_sd=0.0,  # the exact one is given
        tip=middle_of_ball,
        tip_radius=model.tip_radius,
        tip_sd=TIP_SD_DEFAULT_MM * 1e-3,
        turn_max=float(np.radians(DEFAULT_TOOL_TURN_MAX_DEG)),
    )
    # As a scene file without a sensor is read.
    of_points = replace(own.noise, force=PUSH_TURN_SD_RAD * POINT_FORCE_N, moment=tool.tip_sd * POINT_FORCE_N)
    names = [each.name for each in own.landmarks]
    places = poked.landmark_places.copy()
    if case.mistake == WRONG_LANDMARK:
        places[0] += WRONG_LANDMARK_SHIFT_M
    if case.mistake == LARGE_DRAWING:
        places *= LARGE_DRAWING_SCALE
    landmarks = tuple(Landmark(*each, None) for each in zip(names, places, strict=True))[: case.landmarks]
    return replace(
        own, link=BASE_LINK if case.known == BASE_ALONE else own.link, arm=None, tool=tool, wrench_sign=1, landmarks=landmarks,
        skin=replace(own.skin, anchor=None) if case.known == BASE_ALONE else own.skin,
        surface=own.surface if case.has_mesh else None, path=Path("tool.toml"),
        noise=own.noise if model.has_sensor else of_points,
    )  # fmt: skip


def contacts_of(poked: ToolSession, scene: Scene) -> list[Contact]:
    """Make the contacts on the skin as the detector would, with the sensor's pose of each."""
    assert scene.tool is not None
    contacts: list[Contact] = []
    for row in np.flatnonzero(poked.landmark == NO_LANDMARK).tolist():
        own = np.flatnonzero(poked.responses[row] > scene.contacts.response_min)
        force, moment = _wrench_of(poked, row, scene)
        contacts.append(
            Contact(
                poke=row + 1, start_s=POKE_CYCLE_S * row, end_s=POKE_CYCLE_S * row + scene.contacts.still_s, force=force,
                moment=moment, channels=poked.channels[own], responses=poked.responses[row, own],
                link_from_sensor=scene.tool.link_from_sensor(poked.base_from_tool[row]), pose=scene.tool.arm_pose,
                tare_change=0.0, final=True, rest_wrench=poked.rest_wrench[row] if scene.has_sensor else None,
            )
        )  # fmt: skip
    return contacts


def _carry(pose: FloatArray, points: FloatArray) -> FloatArray:
    return points @ pose[:3, :3].T + pose[:3, 3]


def _row(case: Task, found: Sequence[Mapping[int, Mapping[str, Any]]]) -> dict[str, Any]:
    """Average over seeds.

    Returns
    -------
    JSON: `rig`, `known`, `landmarks`, `mesh`, `mistake`, `pokes`, `seconds` and `scale_named`, the share of sessions
    whose drawing is named for its scale (lists over `pokes`), and by method lists over
    `pokes` of the numbers of `error_numbers`, with `ratio`, predicted over true error in the directions that the covariance has
    """
    about, counts = case.case, case.sizes.counts
    methods: dict[str, Any] = {}
    for name in found[0][counts[0]]["methods"]:
        means = [mean_over_seeds([session[count]["methods"][name] for session in found]) for count in counts]
        own: dict[str, list[float | None]] = {key: [each[key] for each in means] for key in means[0]}
        own["mean_mm"] = own.pop("mean")
        pairs = zip(own["predicted"], own["true_along"], strict=True)
        own["ratio"] = [predicted / true if predicted and true else None for predicted, true in pairs]
        methods[name] = own | {"sessions": _sessions(name, found)}
    placed = np.mean([[session[count]["placed"] for count in counts] for session in found], axis=0)
    named = np.mean([[session[count]["scale_named"] for count in counts] for session in found], axis=0)
    seconds = np.mean([[session[count]["seconds"] for count in counts] for session in found], axis=0)
    return {
        "rig": about.rig, "known": about.known, "landmarks": about.landmarks, "mesh": about.has_mesh, "mistake": about.mistake,
        "pokes": list(counts),
        "seconds": seconds.round(4).tolist(), "placed": placed.tolist(),
        "scale_named": named.tolist(), "methods": methods,
    }  # fmt: skip


def _sessions(method: str, found: Sequence[Mapping[int, Mapping[str, Any]]]) -> list[dict[str, Any]]:
    """List for each session after `GOAL_POKES` the share of taxels inside, and whether it is believed; empty without it."""
    last = [session[GOAL_POKES] for session in found if GOAL_POKES in session]
    inside = [each["methods"][method]["inside"] for each in last]
    return [
        {"inside": None if np.isnan(share) else share, "believed": each["believed"].get(method, False)}
        for share, each in zip(inside, last, strict=True)
    ]


def tool_limits(rows: Sequence[Mapping[str, Any]]) -> Limits:
    """List the goals of the rigs with six landmarks and the mesh, and of belief over all sessions, for `check_limits`."""
    limits: dict[str, tuple[float, str, float]] = {}
    for row in rows:
        goals = GOALS_MM.get(row["rig"], {})
        if row["landmarks"] < GOAL_LANDMARKS or not row["mesh"] or row["mistake"] or GOAL_POKES not in row["pokes"]:
            continue
        at = row["pokes"].index(GOAL_POKES)
        for method, goal in goals.items():
            numbers = row["methods"][method]
            name = f"tool_{row['rig']}_{method}"
            values = {key: np.nan if numbers[key][at] is None else numbers[key][at] for key in ("mean_mm", "inside", "ratio")}
            limits[f"{name}_mean_mm"] = (values["mean_mm"], "<=", goal)
            limits[f"{name}_inside"] = (values["inside"], ">=", COVERAGE_MIN)
            limits[f"{name}_ratio_least"] = (values["ratio"], ">=", RATIO_MIN)
            limits[f"{name}_ratio_most"] = (values["ratio"], "<=", RATIO_MAX)
    return limits | _belief_limits(rows)


def _belief_limits(rows: Sequence[Mapping[str, Any]]) -> dict[str, tuple[float, str, float]]:
    every = [
        (each, bool(row["mistake"])) for row in rows if row["landmarks"] >= GOAL_LANDMARKS and row["rig"] in GOALS_MM
        for numbers in row["methods"].values() for each in numbers["sessions"] if each["inside"] is not None
    ]  # fmt: skip
    right = [each["believed"] for each, is_wrong in every if not is_wrong and each["inside"] >= RIGHT_MIN_COVERAGE]
    wrong = [each["believed"] for each, is_wrong in every if is_wrong or each["inside"] < WRONG_MAX_COVERAGE]
    limits: dict[str, tuple[float, str, float]] = {}
    if right:
        limits["tool_believed_where_right"] = (float(np.mean(right)), ">=", BELIEVED_MIN)
    if wrong:
        limits["tool_believed_where_wrong"] = (float(np.mean(wrong)), "<=", WRONGLY_BELIEVED_MAX)
    named = [share for row in rows if row["landmarks"] and row["mesh"] and not row["mistake"] for share in row["scale_named"]]
    if named:
        limits["tool_scale_named_where_right"] = (float(np.mean(named)), "<=", SCALE_NAMED_WHERE_RIGHT_MAX)
    return limits


def describe(result: Mapping[str, Any]) -> list[str]:
    """Describe each case."""
    counts = ", ".join(map(str, result["tool"][0]["pokes"]))
    head = f"forearm, a tool on a still part, {result['seeds']} sessions of each kind, mean error after {counts} pokes:"
    return [head, *(line for row in result["tool"] for line in _row_text(row).splitlines())]


def _row_text(row: Mapping[str, Any]) -> str:
    case = ToolCase(row["rig"], row["known"], row["landmarks"], row["mesh"], row["mistake"])
    placed = " ".join(f"{share:.0%}" for share in row["placed"])
    lines = [f"  {case.words}: {placed} of the sessions have positions on the part"]
    for name, own in row["methods"].items():
        errors, inside, ratio = (
            " ".join("-" if each is None else f"{each:.2f}" for each in own[key]) for key in ("mean_mm", "inside", "ratio")
        )
        lines.append(f"    {name}: {errors} mm; inside {inside}; predicted/true {ratio}")
    return "\n".join(lines)


def draw(result: Mapping[str, Any], figure: Figure) -> None:
    """Draw the error of cases with a mesh against the number of pokes and against run time, by method."""
    rows = [row for row in result["tool"] if row["mesh"] and row["landmarks"] in (0, GOAL_LANDMARKS) and not row["mistake"]]
    panels = figure.subplots(2, len(rows), sharey=True, squeeze=False)
    for column, row in enumerate(rows):
        case = ToolCase(row["rig"], row["known"], row["landmarks"], row["mesh"], row["mistake"])
        times = np.cumsum(row["seconds"])
        for method, colour in METHOD_COLOURS.items():
            own = row["methods"].get(method.value)
            if own is None:
                continue
            means = [np.nan if mean is None else mean for mean in own["mean_mm"]]
            look = {"color": colour, "marker": "o", "markersize": 3, "label": method.value}
            panels[0, column].plot(row["pokes"], means, **look)
            panels[1, column].plot(times, means, **look)
        panels[0, column].set_title(case.words.replace(", ", "\n", 1), fontsize=8)
        panels[0, column].set_xlabel("pokes")
        panels[1, column].set_xlabel("run time, s")
        for axes in panels[:, column]:
            axes.set_yscale("log")
            axes.axhline(1.0, color=BLACK, linewidth=0.5)
            axes.grid(visible=True)
    for axes in panels[:, 0]:
        axes.set_ylabel("mean error, mm")
    panels[0, 0].legend()


THIS_STUDY = Study(
    "tool",
    quick=ToolSizes(seeds=2, counts=(84, GOAL_POKES), cases=QUICK_CASES),
    full=ToolSizes(),
    measure=measure,
    lines=describe,
    draw=draw,
)
