"""A tool that pokes a still part: error against pokes and run time, by rig and by the knowledge of the part.

The sessions come from an independent simulator (`tool_simulator`) with all imperfections of a cobot or of a tracked probe. The
part's pose in the base is given, or nothing is known of the part: then all positions are in the base.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, inverse_pose
from skincal.mesh.surface import make_surface
from skincal.model.scene import Scene
from skincal.model.tool_rig import BASE_LINK, DEFAULT_TOOL_TURN_MAX_DEG, TIP_SD_DEFAULT_MM, TOOL_ARM_POSE, ToolSpec
from skincal.palette import BLACK, BLUE, GREEN, VERMILION
from skincal.plotting import Figure
from skincal.session.session import Session
from skincal.simulation.example_parts import forearm
from skincal.studies.error_numbers import error_numbers, mean_over_seeds
from skincal.studies.harness import Bench, Findings, Study
from skincal.studies.tool_simulator import NO_LANDMARK, TOOL_RIGS, ToolSession, simulate_tool_session
from skincal.taxels.result import Method

GOAL_POKES = 168
"""Two for each taxel of the forearm."""
POKE_CYCLE_S = 3.5
"""s, from one poke to the next: a robot's way, a rest and a press."""
BASE_ALONE, POSE_GIVEN = "nothing", "pose"
"""Knowledge of the part: none, so that positions are in the base; or its pose in the base, from the scene."""
METHOD_COLOURS = dict(zip(Method, (BLUE, GREEN, VERMILION), strict=True))


class ToolCase(NamedTuple):
    """Rig of `TOOL_RIGS`, what the scene knows of the part, and whether it has a mesh."""

    rig: str
    known: str
    landmarks: int
    has_mesh: bool

    @property
    def words(self) -> str:
        """Describe the case."""
        part = {BASE_ALONE: "positions in the base", POSE_GIVEN: "part's pose given"}[self.known]
        return f"{self.rig}, {part}, {self.landmarks} landmarks, {'mesh' if self.has_mesh else 'no mesh'}"


TOOL_CASES = (
    ToolCase("ideal", POSE_GIVEN, 0, has_mesh=True),
    ToolCase("wrist", POSE_GIVEN, 0, has_mesh=True),
    ToolCase("wrist", POSE_GIVEN, 0, has_mesh=False),
    ToolCase("wrist", BASE_ALONE, 0, has_mesh=False),
)


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
    return Findings({"seeds": sizes.seeds, "tool": rows})


def run_session(task: Task) -> dict[int, dict[str, Any]]:
    """Simulate a session and solve it after each of its counts of pokes.

    Returns
    -------
    JSON by count: `methods`, the numbers of `error_numbers` by method, and `seconds`, run time of the new pokes' solution
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
        surface = make_surface(poked.vertices, part.surface.triangles)
    session, contacts = Session(scene, surface), contacts_of(poked, scene)
    places = poked.places if case.known != BASE_ALONE else _carry(poked.base_from_part, poked.places)
    found: dict[int, dict[str, Any]] = {}
    done = 0
    for count in task.sizes.counts:
        start = time.perf_counter()
        for contact in contacts[done:count]:
            session.add(contact)
        done = count
        snapshot = session.snapshot()
        seconds = time.perf_counter() - start
        numbers = {method.value: error_numbers(each, places) for method, each in snapshot.estimates.items()}
        found[count] = {"methods": numbers, "seconds": seconds}
    return found


def scene_of(case: ToolCase, poked: ToolSession) -> Scene:
    """Describe a simulated session as its user would: the forearm's layout, the tool, and the knowledge of the part."""
    own = forearm().scene
    knows = case.known == POSE_GIVEN
    tool = ToolSpec(
        has_sensor=True,
        form=None,
        metres_per_unit=None,
        tool_from_sensor=poked.tool_from_sensor,
        link_from_base=inverse_pose(poked.base_from_part) if knows else np.eye(4),
        has_part_pose=knows,
        tip=poked.tip,
        tip_radius=0.0,
        tip_sd=TIP_SD_DEFAULT_MM * 1e-3,
        turn_max=float(np.radians(DEFAULT_TOOL_TURN_MAX_DEG)),
    )
    skin = own.skin if case.has_mesh else replace(own.skin, anchor=None)
    return replace(
        own, link=own.link if knows else BASE_LINK, arm=None, tool=tool, wrench_sign=1, skin=skin, landmarks=(),
        surface=own.surface if case.has_mesh else None, path=Path("tool.toml"),
    )  # fmt: skip


def contacts_of(poked: ToolSession, scene: Scene) -> list[Contact]:
    """Make the contacts on the skin as the detector would, with the sensor's pose of each."""
    assert scene.tool is not None
    contacts: list[Contact] = []
    for row in np.flatnonzero(poked.landmark == NO_LANDMARK).tolist():
        own = np.flatnonzero(poked.responses[row] > scene.contacts.response_min)
        pose = poked.base_from_tool[row]
        contacts.append(
            Contact(
                poke=row + 1, start_s=POKE_CYCLE_S * row, end_s=POKE_CYCLE_S * row + scene.contacts.still_s,
                force=poked.wrench[row, :3], moment=poked.wrench[row, 3:], channels=poked.channels[own],
                responses=poked.responses[row, own], link_from_sensor=scene.tool.link_from_sensor(pose), pose=TOOL_ARM_POSE,
                tare_change=0.0, final=True,
            )
        )  # fmt: skip
    return contacts


def _carry(pose: FloatArray, points: FloatArray) -> FloatArray:
    return points @ pose[:3, :3].T + pose[:3, 3]


def _row(case: Task, found: Sequence[Mapping[int, Mapping[str, Any]]]) -> dict[str, Any]:
    """Average over seeds.

    Returns
    -------
    JSON: `rig`, `known`, `landmarks`, `mesh`, `pokes`, `seconds` (lists over `pokes`), and by method lists over `pokes` of the
    numbers of `error_numbers`, with `ratio`, predicted over true error in the directions that the covariance has
    """
    about, counts = case.case, case.sizes.counts
    methods: dict[str, Any] = {}
    for name in found[0][counts[0]]["methods"]:
        means = [mean_over_seeds([session[count]["methods"][name] for session in found]) for count in counts]
        own: dict[str, list[float | None]] = {key: [each[key] for each in means] for key in means[0]}
        own["mean_mm"] = own.pop("mean")
        pairs = zip(own["predicted"], own["true_along"], strict=True)
        own["ratio"] = [predicted / true if predicted and true else None for predicted, true in pairs]
        methods[name] = own
    seconds = np.mean([[session[count]["seconds"] for count in counts] for session in found], axis=0)
    return {
        "rig": about.rig, "known": about.known, "landmarks": about.landmarks, "mesh": about.has_mesh, "pokes": list(counts),
        "seconds": seconds.round(4).tolist(), "methods": methods,
    }  # fmt: skip


def describe(result: Mapping[str, Any]) -> list[str]:
    """Describe each case."""
    counts = ", ".join(map(str, result["tool"][0]["pokes"]))
    head = f"forearm, a tool on a still part, {result['seeds']} sessions of each kind, mean error after {counts} pokes:"
    return [head, *(line for row in result["tool"] for line in _row_text(row).splitlines())]


def _row_text(row: Mapping[str, Any]) -> str:
    case = ToolCase(row["rig"], row["known"], row["landmarks"], row["mesh"])
    lines = [f"  {case.words}:"]
    for name, own in row["methods"].items():
        errors, inside, ratio = (
            " ".join("-" if each is None else f"{each:.2f}" for each in own[key]) for key in ("mean_mm", "inside", "ratio")
        )
        lines.append(f"    {name}: {errors} mm; inside {inside}; predicted/true {ratio}")
    return "\n".join(lines)


def draw(result: Mapping[str, Any], figure: Figure) -> None:
    """Draw each case's error against the number of pokes and against run time, by method."""
    rows = result["tool"]
    panels = figure.subplots(2, len(rows), sharey=True, squeeze=False)
    for column, row in enumerate(rows):
        case = ToolCase(row["rig"], row["known"], row["landmarks"], row["mesh"])
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
    quick=ToolSizes(seeds=3, counts=(42, 84, GOAL_POKES)),
    full=ToolSizes(),
    measure=measure,
    lines=describe,
    draw=draw,
)
