"""Figures of the studies: the only place of the core that draws, without a window.

Colours are those of Okabe and Ito (2008), which people with any colour vision tell apart; what matters is said in words
or by a mark's shape as well.
"""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any, TypeAlias

import matplotlib as mpl
from matplotlib import figure as mpl_figure

from skincal.model.errors import InputError

Figure: TypeAlias = Any
"""matplotlib.figure.Figure, whose type hints are too loose for strict checks."""
Axes: TypeAlias = Any
"""matplotlib.axes.Axes."""
_matplotlib: Any = mpl
_figures: Any = mpl_figure

BLACK, ORANGE, SKY, GREEN, YELLOW = "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442"
BLUE, VERMILION, PINK = "#0072B2", "#D55E00", "#CC79A7"
GREY = "#767676"
"""For what stands aside; 4.5 : 1 against white."""
DOTS_PER_INCH = 130
INCHES = (12.0, 7.0)
"""Width and height, unless a study sets its own."""
STYLE: dict[str, Any] = {
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.titlesize": 11,
    "font.size": 9.5,
    "legend.frameon": False,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    # The same result gives the same bytes.
    "svg.hashsalt": "skincal",
    "svg.fonttype": "none",
}


def write_figure(draw: Callable[[Figure], None], folder: Path, name: str) -> list[Path]:
    """Draw a figure and write it as SVG, for print, and PNG; return the files.

    Parameters
    ----------
    draw : fills an empty figure; may set its size
    folder : there already
    name : of the files, without their ending

    Raises
    ------
    InputError
        A file cannot be written.
    """
    written: list[Path] = []
    with _matplotlib.rc_context(STYLE):
        figure: Figure = _figures.Figure(figsize=INCHES, layout="constrained")
        draw(figure)
        for ending, metadata in (("svg", {"Date": None}), ("png", {"Software": None})):
            path, data = folder / f"{name}.{ending}", BytesIO()
            figure.savefig(data, format=ending, dpi=DOTS_PER_INCH, metadata=metadata)
            try:
                path.write_bytes(data.getvalue())
            except OSError as error:
                raise InputError(f"{path}: cannot be written ({error.strerror}); choose another folder by --out.") from None
            written.append(path)
    return written
