"""Figures of taxels for notebooks and papers: three sides with matplotlib, in space with pyvista."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from skincal.model.errors import InputError
from skincal.palette import BLUE, GREEN, ORANGE, PINK, SKY, VERMILION, YELLOW
from skincal.plotting import PLOT_STYLE

if TYPE_CHECKING:
    from skincal.geometry import FloatArray, IntArray
    from skincal.mesh.surface import Surface

MODULE_COLOURS = (ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILION, PINK)
"""Module i has colour i modulo 7, as in the window."""
SIDE_AXES = (("x", "y"), ("x", "z"), ("y", "z"))
DOT_AREA_PT2 = 22.0
BALL_RADIUS_TO_SIZE = 0.012
"""Radius of a taxel's ball over the size of all taxels."""


class NotebookFigure(Figure):
    """A figure of matplotlib that a notebook shows, also if pyplot was not imported."""

    def _repr_png_(self) -> bytes:
        encoded = BytesIO()
        figure: Any = self
        figure.savefig(encoded, format="png")
        return encoded.getvalue()


def draw_three_sides(places: FloatArray, covariances: FloatArray, modules: IntArray, title: str) -> NotebookFigure:
    """Draw taxels (n, 3), metres, along the link's axes, millimetres, with a bar of one predicted error each way."""
    matplotlib: Any = mpl
    places = places * 1e3
    sds = np.sqrt(np.einsum("nii->ni", covariances)) * 1e3
    colours = _colours(modules)
    with matplotlib.rc_context(dict(PLOT_STYLE)):
        figure: Any = NotebookFigure(figsize=(11.0, 3.9), layout="constrained")
        for axes, (across, up) in zip(figure.subplots(1, len(SIDE_AXES)), SIDE_AXES, strict=True):
            i, j = "xyz".index(across), "xyz".index(up)
            bars = {"xerr": sds[:, i], "yerr": sds[:, j]} if np.isfinite(sds).all() and len(places) else {}
            axes.errorbar(places[:, i], places[:, j], **bars, fmt="none", ecolor="#999999", elinewidth=0.7, zorder=1)
            axes.scatter(places[:, i], places[:, j], s=DOT_AREA_PT2, c=colours, edgecolors="black", linewidths=0.4, zorder=2)
            axes.set(xlabel=f"{across} (mm)", ylabel=f"{up} (mm)")
            axes.set_aspect("equal")
        figure.suptitle(title)
    return figure


def draw_in_space(
    places: FloatArray, normals: FloatArray, modules: IntArray, surface: Surface | None, picture: Path | None
) -> Any:
    """Draw taxels as balls with their normals, all (n, 3) metres, and a mesh; return pyvista's plotter.

    With the file of a `picture` it is drawn without a window, and closed.
    """
    try:
        import pyvista
    except ImportError:
        raise InputError("plot_3d needs the package pyvista; install it: pip install pyvista.") from None
    view: Any = pyvista
    plotter = view.Plotter(off_screen=picture is not None)
    if surface is not None:
        faces = np.insert(surface.triangles, 0, 3, axis=1)
        plotter.add_mesh(view.PolyData(surface.vertices, faces.ravel()), color="#C8C8C8", opacity=0.6)
    size = float(np.linalg.norm(np.ptp(places, axis=0))) if len(places) else 0.0
    radius, colours = max(BALL_RADIUS_TO_SIZE * size, 1e-4), np.array(_colours(modules))
    for colour in sorted(set(colours.tolist())):
        balls = view.PolyData(places[colours == colour]).glyph(geom=view.Sphere(radius=radius), scale=False, orient=False)
        plotter.add_mesh(balls, color=colour)
    aimed = np.isfinite(normals).all(axis=1)
    if aimed.any():
        plotter.add_arrows(places[aimed], normals[aimed], mag=4 * radius, color="black")
    plotter.add_axes()
    if picture is not None:
        plotter.screenshot(str(picture))
        plotter.close()
    return plotter


def _colours(modules: IntArray) -> list[str]:
    return [MODULE_COLOURS[module % len(MODULE_COLOURS)] for module in modules.tolist()]
