"""The paper study's figure: its figures 4 and 5 done again, what landmarks do, and the good rig's course."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from skincal.studies.figure import BLACK, BLUE, GREEN, GREY, VERMILION, Axes, Figure

LOOKS: dict[str, tuple[str, str]] = {"free": (BLUE, "free"), "surface": (VERMILION, "surface"), "modules": (GREEN, "modules")}
"""Colour and words of each method."""
COURSES: dict[str, tuple[str, str, str]] = {
    **{name: (colour, words, "-") for name, (colour, words) in LOOKS.items()},
    "modules_21": (BLACK, "modules, rig corrected by 21 landmark pokes", "--"),
}
"""Colour, words and line of each course."""
WIDTH = 0.26


def draw_paper(result: dict[str, Any], figure: Figure) -> None:
    """Draw six panels."""
    figure.set_size_inches(13.0, 14.0)
    figure.suptitle(f"The paper's experiment on {result['seeds']} simulated rigs, each as wrong as the paper's")
    (alone, averaged), (landmarks, good), (pokes, times) = figure.subplots(3, 2)
    _draw_alone(alone, result)
    _draw_averaged(averaged, result)
    _draw_landmarks(landmarks, result)
    _draw_good(good, result)
    _draw_pokes(pokes, result)
    _draw_times(times, result)


def _bars(axes: Axes, rows: dict[str, list[dict[str, Any]]], names: list[str]) -> None:
    for offset, (method, (colour, words)) in enumerate(LOOKS.items()):
        places = [place + (offset - 1) * WIDTH for place in range(len(names))]
        means, sds = [row["mean"] for row in rows[method]], [row["sd"] for row in rows[method]]
        axes.bar(places, means, width=WIDTH, color=colour, label=words)
        axes.errorbar(places, means, yerr=sds, fmt="none", ecolor=GREY, elinewidth=1.0)
    axes.set_xticks(range(len(names)), names)
    axes.set_ylabel("error of 84 taxels (mm): mean and sd")
    axes.grid(visible=True, axis="y")


def _draw_alone(axes: Axes, result: dict[str, Any]) -> None:
    poses = list(result["minutes"])
    rows = {method: [result["per_pose_mm"][method][pose] for pose in poses] for method in LOOKS}
    _bars(axes, rows, [f"{pose}\n{result['minutes'][pose]:g} min" for pose in poses])
    for place, (method, (low, high)) in zip((6.75, 6.95), result["published"]["per_pose_mean_mm"].items(), strict=True):
        axes.plot([place, place], [low, high], color=LOOKS[method][0], linewidth=5.0, solid_capstyle="butt")
    axes.text(6.85, -0.02, "paper's\nrange", transform=axes.get_xaxis_transform(), ha="center", va="top", fontsize=8.5)
    axes.set_title("Each arm pose alone (figure 4)")
    axes.set_ylim(top=24.0)
    axes.legend(fontsize=8.5, loc="upper left", ncols=3)


def _draw_averaged(axes: Axes, result: dict[str, Any]) -> None:
    rows = {method: result["averaged_mm"][method] for method in LOOKS}
    _bars(axes, rows, [f"1 to {last}" if last > 1 else "1" for last in range(1, 8)])
    for method, value in result["published"]["averaged_mean_mm"].items():
        axes.axhline(value, color=LOOKS[method][0], linestyle="--", linewidth=1.2, label=f"paper, {method} {value}")
    axes.set_xlabel("arm poses averaged one after another")
    axes.set_title("Averaged (figure 5)")
    axes.legend(fontsize=8.5, loc="upper right")


def _draw_landmarks(axes: Axes, result: dict[str, Any]) -> None:
    counts = [0, *(one["landmark_pokes"] for one in result["landmarks"])]
    for offset, (method, (colour, words)) in enumerate(LOOKS.items()):
        values = [result["mean_mm"][method], *(one["mean_mm"][method] for one in result["landmarks"])]
        places = [place + (offset - 1) * WIDTH for place in range(len(counts))]
        axes.bar(places, values, width=WIDTH, color=colour, label=words)
        for place, value in zip(places, values, strict=True):
            axes.text(place, value, f"{value:.1f}", ha="center", va="bottom", fontsize=8.5)
    axes.set_xticks(range(len(counts)), [f"{count} landmark pokes" for count in counts])
    axes.set_ylabel("mean error (mm), all poses pooled")
    axes.set_title("The rig corrected from pokes at landmarks")
    axes.grid(visible=True, axis="y")
    axes.legend(fontsize=8.5)


def _draw_good(axes: Axes, result: dict[str, Any]) -> None:
    course = result["course_mm"]
    for method, (colour, words) in LOOKS.items():
        known = [(pokes, error) for pokes, error in zip(course["pokes"], course[method], strict=True) if error is not None]
        axes.plot([pokes for pokes, _ in known], [error for _, error in known], color=colour, marker="o", label=words)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(course["pokes"], [f"{at:,}" for at in course["pokes"]])
    axes.set_xticks([], minor=True)
    axes.set_yticks([0.2, 0.5, 1, 2, 5, 10], ["0.2", "0.5", "1", "2", "5", "10"])
    axes.set_yticks([], minor=True)
    axes.set_xlabel("pokes in one arm pose, unguided")
    axes.set_ylabel("mean error (mm) of those with an estimate")
    times = ", ".join(f"{LOOKS[method][1]} {milliseconds:.0f} ms" for method, milliseconds in result["runtime_ms"].items())
    axes.set_title(f"A rig that is only noisy\nsolving {result['pokes']:,} pokes: {times}")
    axes.grid(visible=True)
    axes.legend(fontsize=8.5)


def _draw_pokes(axes: Axes, result: dict[str, Any]) -> None:
    course = result["bad_course_mm"]
    _lines(axes, course["pokes"], {name: (course["pokes"], course[name]) for name in COURSES})
    axes.set_xticks(course["pokes"], [f"{at:,}" for at in course["pokes"]])
    axes.set_xlabel("pokes, of all seven arm poses from the first on")
    axes.set_title("As wrong as the paper's: error against pokes")


def _draw_times(axes: Axes, result: dict[str, Any]) -> None:
    course, times = result["bad_course_mm"], result["bad_course_ms"]
    until = {name: ([None if one is None else one / 1e3 for one in times[name]], course[name]) for name in COURSES}
    every = [one for some, _ in until.values() for one in some if one is not None]
    ticks = [at for at in (0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100) if min(every) / 2 <= at <= 2 * max(every)]
    _lines(axes, ticks, until)
    axes.set_xticks(ticks, [f"{at:g}" for at in ticks])
    axes.set_xlabel("processor time (s) of all solves until then, each poke solved as it comes")
    axes.set_title("The same against processor time")


def _lines(
    axes: Axes, ticks: Sequence[float], courses: Mapping[str, tuple[Sequence[float | None], Sequence[float | None]]]
) -> None:
    """Draw errors, mm, of each of `COURSES`, where both numbers are known."""
    for name, (colour, words, line) in COURSES.items():
        known = [(at, error) for at, error in zip(*courses[name], strict=True) if at is not None and error is not None]
        axes.plot([at for at, _ in known], [error for _, error in known], line, color=colour, marker="o", label=words)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(ticks)
    axes.set_xticks([], minor=True)
    axes.set_yticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
    axes.set_yticks([], minor=True)
    axes.set_ylabel("mean error (mm) of those with an estimate")
    axes.grid(visible=True)
    axes.legend(fontsize=8.5)
