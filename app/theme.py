"""One look for the whole window: colours, sizes and the palette, light and dark.

Hue is kept for the identity of a module (Okabe-Ito, seven hues that colour-blind eyes tell apart); a state is shown by
shape and words as well as by colour: accepted is blue with a tick, rejected is vermillion with a cross.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Qt, Signal
from PySide6.QtGui import QColor, QFont, QFontDatabase, QPalette
from PySide6.QtWidgets import QApplication

if TYPE_CHECKING:
    from skincal.taxels.result import Method

HUES = ("#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7")
"""Okabe and Ito 2008, without black: module i has hue i modulo 7."""


class Choice(Enum):
    """Which theme the operator wants."""

    SYSTEM = "system"
    LIGHT = "light"
    DARK = "dark"


@dataclass(frozen=True, slots=True)
class Colours:
    """The colours of one theme; text on `window`, `panel` and `raised` has at least 4.5:1 contrast (WCAG AA)."""

    dark: bool
    window: str
    panel: str
    raised: str
    line: str
    text: str
    muted: str
    accent: str
    """Selection, the accepted, what may be pressed."""
    on_accent: str
    bad: str
    """The rejected and the lost; always with a cross or a word."""
    warn: str
    axes: tuple[str, str, str]
    """Curves of x, y and z."""
    methods: tuple[str, str, str]
    """Curves of the free, the surface and the modules method, near Okabe and Ito's hues; each has its own symbol, too."""


DARK = Colours(
    dark=True,
    window="#14171C",
    panel="#1B1F26",
    raised="#272C36",
    line="#39404C",
    text="#E8EBF0",
    muted="#A0A9B8",
    accent="#5CA8FF",
    on_accent="#0B1420",
    bad="#FF8A5C",
    warn="#E8B84A",
    axes=("#FF8A7A", "#6FD08C", "#6FB4FF"),
    methods=("#56B4E9", "#E69F00", "#35C596"),
)
LIGHT = Colours(
    dark=False,
    window="#EEF0F3",
    panel="#FFFFFF",
    raised="#E2E6EB",
    line="#C3CAD4",
    text="#171B21",
    muted="#525C6B",
    accent="#0B5CBF",
    on_accent="#FFFFFF",
    bad="#B03A06",
    warn="#7A5200",
    axes=("#C2321F", "#0F7433", "#1463C4"),
    methods=("#0072B2", "#D55E00", "#00795A"),
)

GAP = 8
"""Pixels between things that belong together."""
HEADLINE_PT = 28
"""The line that says what happens: readable from two metres on a 24 inch screen, where a small letter is 5 mm high."""


def method_hue(colours: Colours, method: Method) -> str:
    """Return the hue of a method's curves."""
    return colours.methods[list(type(method)).index(method)]


def system_colours() -> Colours:
    """Return the theme that the desktop asks for; light where it does not say."""
    hints = QApplication.styleHints()
    return DARK if hints.colorScheme() is Qt.ColorScheme.Dark else LIGHT


def qpalette(colours: Colours) -> QPalette:
    """Return the Qt palette of a theme; the desktop's own is never used, so the window looks alike everywhere."""
    role = QPalette.ColorRole
    palette = QPalette()
    for names, value in (
        ((role.Window, role.AlternateBase, role.ToolTipBase), colours.window),
        ((role.Base,), colours.panel),
        ((role.Button, role.Light, role.Midlight), colours.raised),
        ((role.Mid, role.Dark, role.Shadow), colours.line),
        ((role.WindowText, role.Text, role.ButtonText, role.ToolTipText, role.BrightText), colours.text),
        ((role.PlaceholderText,), colours.muted),
        ((role.Highlight, role.Link, role.LinkVisited, role.Accent), colours.accent),
        ((role.HighlightedText,), colours.on_accent),
    ):
        for name in names:
            palette.setColor(name, QColor(value))
    for name in (role.WindowText, role.Text, role.ButtonText):
        palette.setColor(QPalette.ColorGroup.Disabled, name, mix(colours.muted, colours.window, 0.45))
    return palette


def mix(first: str, second: str, share: float) -> QColor:
    """Return the colour that lies `share` of the way from `first` to `second`."""
    a, b = QColor(first), QColor(second)
    return QColor.fromRgbF(
        a.redF() + (b.redF() - a.redF()) * share,
        a.greenF() + (b.greenF() - a.greenF()) * share,
        a.blueF() + (b.blueF() - a.blueF()) * share,
    )


def style_sheet(colours: Colours) -> str:
    """Return the few rules that a palette cannot say: flat tabs, quiet headers, thin splitters."""
    return f"""
    QToolTip {{ color: {colours.text}; background: {colours.raised}; border: 1px solid {colours.line}; padding: 4px; }}
    QMenuBar {{ background: {colours.window}; border-bottom: 1px solid {colours.line}; }}
    QMenuBar::item {{ padding: 5px 10px; background: transparent; }}
    QMenuBar::item:selected {{ background: {colours.raised}; }}
    QStatusBar {{ border-top: 1px solid {colours.line}; }}
    QStatusBar::item {{ border: none; }}
    QSplitter::handle {{ background: {colours.window}; }}
    QTabWidget::pane {{ border: none; border-top: 1px solid {colours.line}; background: {colours.panel}; }}
    QTabBar::tab {{ padding: 6px 10px; border: none; color: {colours.muted}; background: transparent; }}
    QTabBar::tab:selected {{ color: {colours.text}; border-bottom: 2px solid {colours.accent}; }}
    QTabBar::tab:hover {{ color: {colours.text}; }}
    QHeaderView::section {{ color: {colours.muted}; background: {colours.panel}; border: none; padding: 4px 6px;
        border-bottom: 1px solid {colours.line}; }}
    QTableView {{ border: none; background: {colours.panel}; gridline-color: {colours.raised};
        selection-background-color: {colours.accent}; selection-color: {colours.on_accent}; }}
    QToolButton[choice="true"] {{ padding: 2px 8px; border: 1px solid {colours.line}; border-radius: 3px; }}
    QToolButton[choice="true"]:checked {{ color: {colours.on_accent}; background: {colours.accent}; }}
    QFrame#card {{ background: {colours.panel}; border: 1px solid {colours.line}; border-radius: 6px; }}
    QLabel[quiet="true"] {{ color: {colours.muted}; }}
    """


def digits_font(points: float | None = None, *, bold: bool = False) -> QFont:
    """Return a font whose digits have one width, so that live numbers do not jump."""
    font = QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont)
    if points is not None:
        font.setPointSizeF(points)
    font.setBold(bold)
    return font


class Theme(QObject):
    """Which colours hold now: the operator's choice, or the desktop's where the choice is left to it."""

    changed = Signal(object)
    """`Colours`, after they were applied to the application."""

    def __init__(self, choice: Choice = Choice.SYSTEM, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._choice = choice
        self.colours = LIGHT
        QApplication.styleHints().colorSchemeChanged.connect(self._system_changed)
        self.apply()

    @property
    def choice(self) -> Choice:
        """What the operator chose."""
        return self._choice

    def choose(self, choice: Choice) -> None:
        """Take the operator's choice and apply it."""
        self._choice = choice
        self.apply()

    def apply(self) -> None:
        """Give the whole application the colours that hold."""
        chosen = {Choice.LIGHT: LIGHT, Choice.DARK: DARK}
        self.colours = chosen.get(self._choice) or system_colours()
        app = QApplication.instance()
        if isinstance(app, QApplication):
            app.setStyle("Fusion")
            app.setPalette(qpalette(self.colours))
            app.setStyleSheet(style_sheet(self.colours))
        self.changed.emit(self.colours)

    def _system_changed(self) -> None:
        if self._choice is Choice.SYSTEM:
            self.apply()
