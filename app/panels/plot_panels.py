"""The panels whose plots need pyqtgraph, which is imported beside the window once such a panel is seen; the plots come then.

One has the curves of force and moment; the other the errors of each method, against pokes, time or modules.
"""

from __future__ import annotations

import importlib
import time
from abc import abstractmethod
from collections.abc import Iterator
from functools import partial
from html import escape
from types import ModuleType
from typing import TYPE_CHECKING

from PySide6 import QtCore, QtGui, QtWidgets
from PySide6.QtCore import QSettings, Qt, QTimer, Signal
from PySide6.QtWidgets import (
    QButtonGroup,
    QComboBox,
    QHBoxLayout,
    QLabel,
    QScrollArea,
    QSizePolicy,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from app.panels.widgets import AbstractWidget, on_panel, plain_tip, quiet, short_box, theme_colours
from app.state.view_state import ViewState
from app.text.errors_text import SYMBOLS, Axis, newest_words, quantity_words, source_words
from app.text.outcomes import METHOD_NAMES
from app.theme import GAP, method_hue
from app.workers.threads import ThreadService
from skincal.model.errors import InputError
from skincal.model.skin import Layout
from skincal.session.error_history import ErrorFollower
from skincal.taxels.result import Method

if TYPE_CHECKING:
    from app.panels.plots import CurvesPanel, ErrorPlot

DRAW_S = 0.2
"""s between two drawings while the past is being worked out."""
TYPES_S = 0.005
"""s. Types of Qt are made for so long at once: all of them take 0.17 s."""


class PlotPanel(QScrollArea, metaclass=AbstractWidget):
    """The place of plots, which scrolls where letters are large; subclasses say which, and draw them.

    A panel that was never on the screen imports nothing.
    """

    def __init__(self) -> None:
        super().__init__()
        self.ready = False
        """Whether the plots are there."""
        self._state: ViewState | None = None
        self._threads: ThreadService | None = None
        """Imports, once it was asked to."""
        self._imported = False
        self._label = quiet("The curves are loading \N{HORIZONTAL ELLIPSIS}")
        self._label.setContentsMargins(GAP, GAP, GAP, GAP)
        inner = on_panel(self)
        self._column = QVBoxLayout(inner)
        self._column.setContentsMargins(0, 0, 0, 0)
        self._column.setSpacing(0)
        self._column.addWidget(self._label)
        self.setWidget(inner)

    @abstractmethod
    def make(self) -> QWidget:
        """Make the plots; pyqtgraph is imported."""

    @abstractmethod
    def draw_state(self, state: ViewState) -> None:
        """Show a tick on the plots."""

    def show_state(self, state: ViewState) -> None:
        """Show a tick; before there is anything to show nothing is loaded, so that the 3D view comes first."""
        self._state = state
        if self.ready:
            self.draw_state(state)
        elif self.isVisible() and self._threads is None:
            self._threads = ThreadService("curves", self)
            self._make_types(self._threads, _types_of_qt())
        # It was imported while the panel was hidden.
        elif self.isVisible() and self._imported:
            self._make(state)

    def _make_types(self, threads: ThreadService, left: Iterator[tuple[ModuleType, str]]) -> None:
        """Have PySide6 make its types in this thread, a few at a time, then import beside the window.

        They are made when they are first named, and pyqtgraph names all. One that is used here while another thread makes it
        ends the program: PySide6 6.11 did, in 4 of 70 starts on a busy machine.
        """
        end_s = time.perf_counter() + TYPES_S
        for module, name in left:
            getattr(module, name)
            if time.perf_counter() > end_s:
                QTimer.singleShot(0, self, partial(self._make_types, threads, left))
                return
        threads.submit(_import_pyqtgraph, self._take_imported, self._label.setText)

    def _take_imported(self, _nothing: None) -> None:
        self._imported = True
        if self._state is not None and self.isVisible():
            self._make(self._state)

    def _make(self, state: ViewState) -> None:
        self._column.addWidget(self.make(), 1)
        self._label.hide()
        self.ready = True
        self.draw_state(state)


def _types_of_qt() -> Iterator[tuple[ModuleType, str]]:
    """Yield what pyqtgraph copies, by module and name."""
    return ((module, name) for module in (QtCore, QtGui, QtWidgets) for name in dir(module))


def _import_pyqtgraph() -> None:
    try:
        importlib.import_module("pyqtgraph")
    except ImportError as error:
        # A library that is missing is no fault of the program: the panel says it, and the rest goes on.
        raise InputError(f"There are no curves: {error}") from error


class ReadingsPanel(PlotPanel):
    """Curves of force and moment, once they can be drawn."""

    def __init__(self) -> None:
        super().__init__()
        self.curves: CurvesPanel | None = None

    def make(self) -> QWidget:
        """Make the curves."""
        from app.panels.plots import CurvesPanel

        self.curves = CurvesPanel()
        return self.curves

    def draw_state(self, state: ViewState) -> None:
        """Draw the newest readings."""
        if self.curves is not None:
            self.curves.show_state(state)

    def recolour(self) -> None:
        """Follow the theme."""
        if self.curves is not None:
            self.curves.recolour()


class ErrorsPanel(PlotPanel):
    """Mean, 95th percentile and maximum of each method, against what is known of the taxels' places."""

    source_chosen = Signal()
    """Estimates are to be compared with something else from now on."""

    def __init__(self, methods: tuple[Method, ...], layout: Layout | None) -> None:
        super().__init__()
        self._methods = [method for method in Method if method in methods]
        self._modules = [] if layout is None else [str(module.id) for module in layout.modules]
        self._course: ErrorFollower | None = None
        self._drawn: object = None
        self._drawn_s = -DRAW_S
        self.plot: ErrorPlot | None = None
        self.source_box = short_box("compared with")
        self.axis_buttons = {axis: QToolButton() for axis in Axis}
        self.module_box = QComboBox()
        self.lines = {method: QLabel() for method in self._methods}
        self._fill()
        self._column.insertLayout(0, self._head())
        self._column.setAlignment(self._label, Qt.AlignmentFlag.AlignTop)
        self.source_box.activated.connect(self._source_chosen)
        self.module_box.activated.connect(self._show_again)
        self._group.buttonClicked.connect(self._axis_chosen)
        self.setWhatsThis(
            "How far the estimates lie from where the taxels are known to be, for the pokes up to each one; or, where "
            "nothing else is known, how far off they say they are. A poke that was taken out leaves no trace in the course."
        )

    def _fill(self) -> None:
        self._group = QButtonGroup(self)
        for axis, button in self.axis_buttons.items():
            button.setText(axis.value)
            button.setCheckable(True)
            button.setProperty("choice", True)
            button.setToolTip(plain_tip(f"Draw the error against {axis.value}"))
            self._group.addButton(button)
        self.axis_buttons[Axis.POKES].setChecked(True)
        self.axis_buttons[Axis.MODULES].setVisible(bool(self._modules))
        self.module_box.addItems(["all taxels", *(f"module {name}" for name in self._modules)])
        self.module_box.setVisible(bool(self._modules))
        self.module_box.setAccessibleName("taxels")
        self.source_box.setToolTip("What the estimates are compared with; Ctrl+R takes a file")
        self.source_box.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)

    def _head(self) -> QVBoxLayout:
        choices = QHBoxLayout()
        choices.addWidget(quiet("against"))
        for button in self.axis_buttons.values():
            choices.addWidget(button)
        choices.addStretch(1)
        choices.addWidget(self.module_box)
        figures = QVBoxLayout()
        figures.setSpacing(0)
        for label in self.lines.values():
            label.setTextFormat(Qt.TextFormat.RichText)
            label.setProperty("rich", True)
            # A narrow panel cuts the end off, rather than growing wider.
            label.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
            figures.addWidget(label)
        head = QVBoxLayout()
        head.setContentsMargins(GAP, GAP // 2, GAP, 0)
        head.setSpacing(GAP // 2)
        head.addWidget(self.source_box)
        head.addLayout(choices)
        head.addLayout(figures)
        return head

    def begin(self, course: ErrorFollower) -> None:
        """Take what follows the course of errors; it is followed while the panel is open."""
        self._course = course
        self.show_sources()

    def show_sources(self) -> None:
        """List what estimates can be compared with."""
        if self._course is not None:
            self.source_box.clear()
            self.source_box.addItems([source_words(source) for source in self._course.sources])
            self.source_box.setCurrentIndex(self._course.sources.index(self._course.source))

    def make(self) -> QWidget:
        """Make the plot."""
        from app.panels.plots import ErrorPlot

        self.plot = ErrorPlot(self._methods, self._modules)
        return self.plot

    @property
    def axis(self) -> Axis:
        """What errors are drawn against."""
        return next(axis for axis, button in self.axis_buttons.items() if button.isChecked())

    def draw_state(self, state: ViewState) -> None:
        """Draw what is new; nothing happens where nothing is, or where nobody sees it."""
        course = self._course
        if course is None or not self.isVisible():
            return
        wanted = (course.version, self.axis, self.module_box.currentIndex())
        series = None if wanted == self._drawn else course.series()
        if series is None or (series.missing and 0.0 <= state.now_s - self._drawn_s < DRAW_S):
            return
        self._drawn, self._drawn_s = wanted, state.now_s
        row = self.module_box.currentIndex()
        for method, label in self.lines.items():
            mark = f'<span style="color:{method_hue(theme_colours(), method)}">{SYMBOLS[method]}</span>'
            words = escape(newest_words(series, method, row)).replace(" ", "&nbsp;")
            label.setText(f"{mark} <b>{METHOD_NAMES[method]}</b>&nbsp;&nbsp;{words}")
        if self.plot is not None:
            self.plot.draw(series, self.axis, row, quantity_words(course.source), paper=course.source is not None)

    def recolour(self) -> None:
        """Follow the theme."""
        self._drawn = None
        if self.plot is not None:
            self.plot.recolour()

    def restore(self, settings: QSettings) -> None:
        """Draw against what was drawn against."""
        kept = settings.value("window/errors_against", "")
        axis = next((axis for axis in Axis if axis.value == kept), Axis.POKES)
        if axis is not Axis.MODULES or self._modules:
            self.axis_buttons[axis].setChecked(True)
            self._axis_chosen()

    def save(self, settings: QSettings) -> None:
        """Remember what is drawn against."""
        settings.setValue("window/errors_against", self.axis.value)

    def _axis_chosen(self) -> None:
        self.module_box.setEnabled(self.axis is not Axis.MODULES)
        self._show_again()

    def _source_chosen(self, index: int) -> None:
        if self._course is not None:
            self._course.choose(index)
        self.source_chosen.emit()
        self._show_again()

    def _show_again(self) -> None:
        if self._state is not None and self.ready:
            self.draw_state(self._state)
