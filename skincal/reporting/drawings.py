"""Pictures of a report, for paper and screen: the part from four sides, the map, and the error over the session.

Colours are those of the window and of the studies' figures; a legend says what they mean.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from skincal.following.error_history import MEAN, P95
from skincal.geometry import FloatArray, IntArray
from skincal.guide.progress import GuideSettings
from skincal.mesh.surface import Surface
from skincal.model.skin import Layout
from skincal.palette import BLACK, METHODS
from skincal.plotting import GREY, Axes, Figure, label_twos_and_fives, render
from skincal.reporting.session_facts import SessionFacts
from skincal.taxels.result import Method, State

VIEW_NAMES = ("front", "right", "back", "left")
"""The front is the side that most of the skin faces."""
ERROR_COLOUR_MAP = "viridis_r"
"""Bright for small errors, dark for large ones; it works in grey and for colour-blind readers."""
PICTURE_DOTS_PER_INCH = 160
LIGHT = np.array([0.3, 0.5, 0.81])
"""Direction to the light in the frame of a view: x right, y up, z to the viewer."""
DRAWN_TAXEL_MIN_FACING_COSINE = 0.0
"""A taxel is drawn in a view if the cosine between its normal and the direction to the viewer is larger."""


MAP_SIZE_PT = 330.0
"""Approximate length of the map's longer side on paper."""
MIN_HORIZONTAL_SHARE_OF_NORMALS = 0.1
"""The normals define the front if at least this share of their sum is horizontal."""


def draw_sides(facts: SessionFacts) -> bytes:
    """Return a PNG of the part from four sides with its taxels, by error."""

    def draw(figure: Figure) -> None:
        panels = figure.subplots(1, 4)
        for name, frame, axes in zip(VIEW_NAMES, side_frames(facts), panels, strict=True):
            _draw_side(axes, facts, frame)
            axes.set_title(name)
        _same_box(panels)
        _colour_bar(figure, panels, facts)

    return render(draw, (11.0, 4.2), ("png",), PICTURE_DOTS_PER_INCH)[0]


def side_frames(facts: SessionFacts) -> tuple[FloatArray, ...]:
    """Return for each of four views the rotation (3, 3) whose rows are right, up and to the viewer, in the link frame.

    Up is the link's axis along which the part is longest, the front where most of the skin looks, and the views follow each
    other around.
    """
    surface = facts.results.part.surface
    points = _positions(facts) if surface is None else surface.vertices
    extents = np.ptp(points, axis=0) if len(points) else np.ones(3)
    up, aside = np.eye(3)[extents.argmax()], np.eye(3)[extents.argmin()]
    out = _normals(facts).sum(axis=0)
    flat = out - (out @ up) * up
    # Where skin looks up all along, or nothing is known of it, the thinnest side is as good.
    front = (
        flat / np.linalg.norm(flat) if np.linalg.norm(flat) > MIN_HORIZONTAL_SHARE_OF_NORMALS * np.linalg.norm(out) else aside
    )
    right = np.cross(up, front)
    return tuple(
        np.stack([np.cross(up, towards), up, towards])
        for towards in (front, right, -front, -right)
    )  # fmt: skip


def draw_map(facts: SessionFacts, layout: Layout) -> bytes:
    """Return an SVG of the layout unrolled, by error; the modules with their numbers."""

    def draw(figure: Figure) -> None:
        from matplotlib.collections import PolyCollection

        axes: Axes = figure.subplots()
        outlines: list[FloatArray] = [module.outline * 1e3 for module in layout.modules]
        axes.add_collection(PolyCollection(outlines, facecolors="#F4F4F4", edgecolors=GREY, linewidths=0.7))
        places = layout.places * 1e3
        scale = MAP_SIZE_PT / np.ptp(np.concatenate(outlines), axis=0).max()
        # A dot is half as wide as the way to the next, a number a sixth of its module.
        size = float(np.clip((0.5 * layout.spacing * 1e3 * scale) ** 2, 2.5, 45.0))
        _dots(axes, facts, {channel: places[channel] for channel in layout.channels.tolist()}, size)
        for module, outline in zip(layout.modules, outlines, strict=True):
            letters = float(np.clip(np.ptp(outline, axis=0).max() * scale / 6.0, 2.0, 7.0))
            axes.annotate(str(module.id), outline.mean(axis=0), ha="center", va="center", fontsize=letters, color=BLACK)
        axes.set_aspect("equal")
        axes.autoscale_view()
        axes.set(xlabel="mm, in the layout's plane", ylabel="mm")
        _colour_bar(figure, [axes], facts)

    return render(draw, (9.0, 5.5), ("svg",), PICTURE_DOTS_PER_INCH)[0]


def draw_course(facts: SessionFacts) -> bytes:
    """Return an SVG: the error of each method against pokes, against poking time, and against computing time.

    Some method knows a taxel: of nothing there is no course.
    """

    def draw(figure: Figure) -> None:
        by_poke, by_time, by_cost = figure.subplots(1, 3, sharey=True)
        series = facts.series
        for axes, x, label in (
            (by_poke, series.counts, "pokes that count"), (by_time, series.times / 60.0, "minutes of poking"),
        ):  # fmt: skip
            for method, spreads in series.spreads.items():
                _draw_course(axes, x, spreads, method)
            axes.set_xlabel(label)
        _draw_costs(by_cost, facts)
        by_poke.set_ylabel(f"{error_name(facts)} (mm)")
        by_poke.set_yscale("log")
        label_twos_and_fives(by_poke.yaxis)
        for axes in (by_poke, by_time, by_cost):
            axes.grid(visible=True)
        handles, names = by_poke.get_legend_handles_labels()
        figure.legend(handles, [f"{name}: mean, dotted 95 % below" for name in names], loc="outside upper center", ncols=3)

    return render(draw, (11.0, 3.9), ("svg",), PICTURE_DOTS_PER_INCH)[0]


def error_name(facts: SessionFacts) -> str:
    """Name the errors in `SessionFacts.errors`."""
    return "predicted error" if facts.truth is None else "error against the truth"


def _draw_course(axes: Axes, x: FloatArray | IntArray, spreads: FloatArray, method: Method) -> None:
    look = {"color": METHODS[method.value], "linewidth": 1.4}
    axes.plot(x, spreads[:, 0, MEAN] * 1e3, label=method.value, **look)
    axes.plot(x, spreads[:, 0, P95] * 1e3, linestyle=":", **look)


def _draw_costs(axes: Axes, facts: SessionFacts) -> None:
    for each in facts.methods:
        spreads = facts.series.spreads.get(each.method)
        if spreads is not None and np.isfinite(spreads[-1, 0, MEAN]):
            at = each.solve_s * 1e3, spreads[-1, 0, MEAN] * 1e3
            axes.plot(*at, marker="o", markersize=8, color=METHODS[each.method.value])
            axes.annotate(each.method.value, at, xytext=(7, 5), textcoords="offset points", fontsize=8.5)
    axes.set_xscale("log")
    axes.margins(x=0.4)
    label_twos_and_fives(axes.xaxis)
    axes.set_xlabel("ms to solve all taxels at the end")


def _draw_side(axes: Axes, facts: SessionFacts, frame: FloatArray) -> None:
    """Draw the part as it is seen along a view: near triangles over far ones, then the taxels of this side."""
    if facts.results.part.surface is not None:
        _draw_surface(axes, facts.results.part.surface, frame)
    seen = _normals(facts) @ frame[2] > DRAWN_TAXEL_MIN_FACING_COSINE
    positions = _positions(facts) @ frame[:2].T * 1e3
    channels = [estimate.channel for estimate in facts.estimates if estimate.position is not None]
    _dots(axes, facts, {c: place for c, place, there in zip(channels, positions, seen, strict=True) if there}, 12.0)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _draw_surface(axes: Axes, surface: Surface, frame: FloatArray) -> None:
    from matplotlib.collections import PolyCollection

    corners = surface.corners @ frame.T * 1e3
    towards = surface.normals @ frame.T
    near = np.flatnonzero(towards[:, 2] > 0)
    # From the back to the front, so that what is nearer covers what is farther.
    order = near[np.argsort(corners[near, :, 2].mean(axis=1))]
    shades = 0.72 + 0.24 * np.clip(towards[order] @ LIGHT, 0.0, 1.0)
    colours = np.repeat(shades[:, None], 3, axis=1)
    # Edges of the same colour close the hairlines between triangles.
    outlines: Any = corners[order, :, :2]
    axes.add_collection(PolyCollection(outlines, facecolors=colours, edgecolors=colours, linewidths=0.3))
    axes.autoscale_view()


def _dots(axes: Axes, facts: SessionFacts, places: Mapping[int, FloatArray], size: float) -> None:
    """Draw taxels at (2,) millimetres by channel: filled by their error, rings where it is not known, crosses if not used."""
    states = {estimate.channel: estimate.state for estimate in facts.estimates}
    known = [channel for channel in places if channel in facts.errors]
    dead = [channel for channel in places if states.get(channel) is State.DEAD]
    rest = [channel for channel in places if channel not in facts.errors and channel not in dead]
    for channels, look in (
        (rest, {"facecolors": "white", "edgecolors": GREY}), (dead, {"marker": "x", "color": BLACK, "linewidths": 1.0}),
        (known, {"c": [facts.errors[c] * 1e3 for c in known], "cmap": ERROR_COLOUR_MAP, **_limits(facts), "edgecolors": BLACK}),
    ):  # fmt: skip
        if channels:
            at = np.array([places[channel] for channel in channels])
            axes.scatter(at[:, 0], at[:, 1], **{"s": size, "linewidths": 0.06 * size**0.5, "zorder": 3, **look})


def _limits(facts: SessionFacts) -> dict[str, Any]:
    """Return the ends of the colours, mm; the worst twentieth shares the darkest, or one taxel would make all others alike.

    The scale reaches to the wanted error at least, so that small errors are bright.
    """
    errors, wanted = np.array(list(facts.errors.values())) * 1e3, GuideSettings().wanted * 1e3
    return {"vmin": 0.0, "vmax": max(float(np.quantile(errors, 0.95)), wanted) if len(errors) else wanted}


def _colour_bar(figure: Figure, panels: Any, facts: SessionFacts) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    if facts.errors:
        colours: Any = ScalarMappable(Normalize(**_limits(facts)), ERROR_COLOUR_MAP)
        figure.colorbar(
            colours, ax=panels, orientation="horizontal", shrink=0.4, aspect=40, extend="max", label=f"{error_name(facts)} (mm)"
        )


def _same_box(panels: Any) -> None:
    """Give all views the scale of the widest, or narrow sides would look larger."""
    limits = np.array([[axes.get_xlim(), axes.get_ylim()] for axes in panels])
    halves = np.ptp(limits, axis=2).max(axis=0) / 2
    for axes, middle in zip(panels, limits.mean(axis=2), strict=True):
        axes.set_xlim(middle[0] - halves[0], middle[0] + halves[0])
        axes.set_ylim(middle[1] - halves[1], middle[1] + halves[1])


def _positions(facts: SessionFacts) -> FloatArray:
    """Return (n, 3) the positions of the taxels that have one."""
    return np.array([e.position for e in facts.estimates if e.position is not None], dtype=float).reshape(-1, 3)


def _normals(facts: SessionFacts) -> FloatArray:
    """Return (n, 3) their normals; zeros where not known."""
    known = [e for e in facts.estimates if e.position is not None]
    return np.array([np.zeros(3) if e.normal is None else e.normal for e in known], dtype=float).reshape(-1, 3)
