"""One look for the whole window: colours and sizes, light and dark. Imports no Qt, as a picture without a window has them too.

Hue is kept for the identity of a module (Okabe-Ito, seven hues that colour-blind eyes tell apart); a state is shown by
shape and words as well as by colour: accepted is blue with a tick, rejected is vermillion with a cross.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from skincal.palette import BLUE, GREEN, METHODS, METHODS_ON_DARK, ORANGE, PINK, SKY, VERMILION, YELLOW

MODULE_HUES = (ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILION, PINK)
"""Okabe and Ito 2008, without black: seven, which repeat (`module_hue`)."""


def module_hue(index: int) -> str:
    """Return the hue of a module by its place in the layout, `#rrggbb`; hues repeat beyond seven modules."""
    return MODULE_HUES[index % len(MODULE_HUES)]


class Choice(Enum):
    """Theme that the operator chose."""

    SYSTEM = "system"
    LIGHT = "light"
    DARK = "dark"


@dataclass(frozen=True, slots=True)
class Colours:
    """Colours of a theme. Text on `window`, `panel` and `raised` has a contrast of 4.5:1 at least (WCAG AA)."""

    dark: bool
    window: str
    panel: str
    raised: str
    line: str
    edge: str
    """Borders of fields: at least 3:1 on `window` and `panel` (WCAG 1.4.11)."""
    text: str
    muted: str
    accent: str
    """Selection, accepted pokes, what to press next."""
    on_accent: str
    bad: str
    """Rejected pokes and lost devices, always with a cross or a word."""
    warn: str
    axes: tuple[str, str, str]
    """Curves of x, y and z."""
    methods: Mapping[str, str]
    """By the method's name in files; each method has its own symbol, too."""


_DARK_AND_LIGHT = {
    "window": ("#14171C", "#EEF0F3"),
    "panel": ("#1B1F26", "#FFFFFF"),
    "raised": ("#272C36", "#E2E6EB"),
    "line": ("#39404C", "#C3CAD4"),
    "edge": ("#757E8E", "#768091"),
    "text": ("#E8EBF0", "#171B21"),
    "muted": ("#A0A9B8", "#525C6B"),
    "accent": ("#5CA8FF", "#0B5CBF"),
    "on_accent": ("#0B1420", "#FFFFFF"),
    "bad": ("#FF8A5C", "#B03A06"),
    "warn": ("#E8B84A", "#7A5200"),
}
DARK, LIGHT = (
    Colours(dark, axes=axes, methods=methods, **{name: colours[not dark] for name, colours in _DARK_AND_LIGHT.items()})
    for dark, axes, methods in (
        (True, ("#FF8A7A", "#6FD08C", "#6FB4FF"), METHODS_ON_DARK), (False, ("#C2321F", "#0F7433", "#1463C4"), METHODS),
    )
)  # fmt: skip

WIDGET_GAP_PX = 8  # Pixels between things that belong together
HEADLINE_FONT_SIZE_PT = 28
"""Status line: readable from two metres on a 24 inch screen, where a small letter is 5 mm high."""
RESULT_FONT_SIZE_PT = 15  # Result of the last poke or action, above the status line: readable from one metre
