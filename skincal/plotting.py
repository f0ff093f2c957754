"""Matplotlib set-up that the studies' figures and a report's pictures share. Colours are those of the window (`palette`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from typing import Any, TypeAlias

Figure: TypeAlias = Any
"""matplotlib.figure.Figure, whose type hints are too loose for strict checks."""
Axes: TypeAlias = Any
"""matplotlib.axes.Axes."""
GREY = "#767676"
"""For what is of less weight; contrast of 4.5 : 1 on white."""
PLOT_STYLE: Mapping[str, Any] = {
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.titlesize": 11,
    "font.size": 9.5,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    # The same result gives the same bytes.
    "svg.hashsalt": "skincal",
    "svg.fonttype": "none",
}


def render(
    draw: Callable[[Figure], None], inches: tuple[float, float], kinds: Sequence[str], dots_per_inch: int
) -> list[bytes]:
    """Draw a figure and encode it as each of `kinds` ("svg", "png")."""
    # Imported here: processes that only measure or gather do not load matplotlib.
    import matplotlib as mpl
    from matplotlib import figure as mpl_figure

    matplotlib: Any = mpl
    figures: Any = mpl_figure
    encoded: list[bytes] = []
    with matplotlib.rc_context(dict(PLOT_STYLE)):
        figure: Figure = figures.Figure(figsize=inches, layout="constrained")
        draw(figure)
        for kind in kinds:
            data = BytesIO()
            # Without a date and a version, the same figure has the same bytes.
            figure.savefig(data, format=kind, dpi=dots_per_inch, metadata={"Date" if kind == "svg" else "Software": None})
            encoded.append(data.getvalue())
    return encoded


def set_log_scales(axes: Axes, x: Mapping[float, str] | None = None, y: Mapping[float, str] | None = None) -> None:
    """Make both axes logarithmic. `x` and `y` set ticks with their labels."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    for ticks, set_ticks in ((x, axes.set_xticks), (y, axes.set_yticks)):
        if ticks is not None:
            set_ticks(list(ticks), list(ticks.values()))
            set_ticks([], minor=True)
    axes.grid(visible=True)


def label_twos_and_fives(axis: Any, write: Callable[[float], str] = "{:g}".format) -> None:
    """Label a logarithmic axis at 1, 2 and 5 times each power of ten, without exponents."""

    def label(value: float, _: int) -> str:
        return write(value) if f"{value:.0e}"[0] in "125" else ""

    axis.set_major_formatter(label)
    axis.set_minor_formatter(label)


def tick_labels(numbers: Sequence[float]) -> dict[float, str]:
    """Map numbers to their labels, thousands separated."""
    return {number: f"{number:,g}" if number < 1e4 else f"{number:,.0f}" for number in numbers}


def add_common_legend(figure: Figure, panels: Any, columns: int) -> None:
    """Put one legend below the figure that names each mark of `panels` once."""
    found = [panel.get_legend_handles_labels() for panel in panels.axes]
    marks = {label: handle for handles, labels in found for handle, label in zip(handles, labels, strict=True)}
    figure.legend(marks.values(), marks.keys(), loc="outside lower center", ncols=columns)


def draw_predicted_and_true(
    axes: Axes, places: Sequence[float], predicted: Sequence[float], true: Sequence[float], look: Mapping[str, Any]
) -> None:
    """Draw a predicted error (hollow) and the true one (full) along x, joined by a line, at each of `places` along y.

    `look` has the `color` and the `label` of both, and may have a `marker`.
    """
    colour, label = look["color"], look["label"]
    marks = {"marker": look.get("marker", "o"), "s": 28, "zorder": 3}
    axes.hlines(places, predicted, true, color=colour, linewidth=1.0)
    axes.scatter(true, places, color=colour, label=f"true, {label}", **marks)
    axes.scatter(predicted, places, color="white", edgecolors=colour, label=f"predicted, {label}", **marks)
