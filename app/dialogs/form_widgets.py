"""Widgets that several dialogs share: the choice of a scene, a field with a button to choose a path, and a small curve."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
from PySide6.QtCore import QLocale, QPointF, QRectF, Signal
from PySide6.QtGui import QColor, QPainter, QPen, QPolygonF
from PySide6.QtWidgets import QComboBox, QDoubleSpinBox, QFileDialog, QHBoxLayout, QLabel, QPushButton, QWidget

from app.panels.layouts import make_row
from app.panels.widgets import Painted
from app.theme import Colours
from app.workers.threads import ThreadService
from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.scene import load_scene, resource

BUTTON_ELLIPSIS = "\N{HORIZONTAL ELLIPSIS}"


def _scenes_in(folder: Path) -> list[Path]:
    """List the scenes in a folder of scenes; empty if it cannot be read."""
    try:
        return sorted(folder.glob("*/scene.toml"))
    except OSError:
        return []


class ScenePicker(QComboBox):
    """Editable list of the operator's own parts and of the shipped scenes. Each choice is read in the background."""

    scene_read = Signal(object, str)  # `Scene`, or `None` and the reason

    def __init__(self, scene: Path | None, parts: Path | None = None) -> None:
        super().__init__()
        self.setEditable(True)
        self.setAccessibleName("scene")
        # A copy of the program may come without scenes.
        shipped: list[Path] = []
        with suppress(InputError):
            shipped = _scenes_in(resource("scenes"))
        names = {path.parent.name for path in shipped}
        for path in [] if parts is None else _scenes_in(parts):
            name = path.parent.name
            self.addItem(f"{name} (own)" if name in names else name, str(path))
        for path in shipped:
            self.addItem(path.parent.name, str(path))
        if scene is not None:
            index = self.findData(str(scene))
            self.setCurrentIndex(index) if index >= 0 else self.setEditText(str(scene))
        self._threads = ThreadService("scenes", self)
        self.currentTextChanged.connect(self.read)

    def file(self) -> Path:
        # Not the current index, which does not follow typed text.
        index = self.findText(self.currentText())
        return Path(self.itemData(index) if index >= 0 else self.currentText())

    def read(self) -> None:
        """Read the chosen scene; `scene_read` follows."""
        path = self.file()
        self._threads.renew()
        self._threads.submit(
            lambda: load_scene(path),
            lambda scene: self.scene_read.emit(scene, ""),
            lambda why: self.scene_read.emit(None, why),
        )

    def choose(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Scene", self.currentText(), "Scene (*.toml)")
        if path:
            self.setEditText(path)

    def close_threads(self) -> None:
        self._threads.close(0.0)


def number_field(name: str, suffix: str, limit: float, decimals: int = 1, prefix: str = "") -> QDoubleSpinBox:
    """Make a field for a number from -limit to limit."""
    box = QDoubleSpinBox(decimals=decimals, prefix=prefix, suffix=suffix)
    box.setKeyboardTracking(False)
    box.setLocale(QLocale.c())  # a decimal point, as in all numbers of the window
    box.setRange(-limit, limit)
    box.setAccessibleName(name)
    # Without its arrows a number box is lower than the other fields.
    box.setMinimumHeight(QComboBox().sizeHint().height())
    return box


def path_row(title: str, field: QWidget, choose: Callable[[], object]) -> tuple[QLabel, QHBoxLayout]:
    """Make the label of a field, and a row of the field with a button that calls `choose`."""
    label, button = QLabel(title), QPushButton(f"Choose{BUTTON_ELLIPSIS}")
    label.setBuddy(field)
    name = title.replace("&", "")
    field.setAccessibleName(name)
    button.setAccessibleName(f"choose: {name}")
    button.clicked.connect(lambda: choose())
    return label, make_row((field, 1), button)


class FramePicture(Painted):
    """Mean frame of a skin as a picture: the larger a value, the stronger the colour."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self._frame = np.empty((0, 0))
        self.setAccessibleName(name)

    def show_frame(self, frame: FloatArray, words: str) -> None:
        """Draw a (rows, columns) frame; a channel without a reading stays empty. `words` describe it to screen readers."""
        self._frame = frame
        self.setAccessibleDescription(words)
        self.update()

    def paint(self, painter: QPainter, colours: Colours) -> None:
        known = self._frame[np.isfinite(self._frame)]
        if not known.size:
            return
        rows, columns = self._frame.shape
        side = min((self.width() - 4.0) / columns, (self.height() - 4.0) / rows)
        low, span = float(known.min()), float(np.ptp(known)) or 1.0
        painter.setPen(QPen(QColor(colours.line), 1.0))
        colour = QColor(colours.accent)
        for row, values in enumerate(self._frame.tolist()):
            for column, value in enumerate(values):
                if np.isfinite(value):
                    colour.setAlphaF(0.1 + 0.9 * (value - low) / span)
                    painter.fillRect(QRectF(2.0 + column * side, 2.0 + row * side, side, side), colour)
        painter.drawRect(QRectF(2.0, 2.0, columns * side, rows * side))


class Sparkline(Painted):
    """Small curve without axes."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self._points = np.empty((0, 2))
        self.setAccessibleName(name)

    def show_curve(self, points: FloatArray, words: str) -> None:
        """Draw (n, 2) points, from 0 to 1 on both axes; `words` describe the curve to screen readers."""
        if not np.array_equal(points, self._points):
            self._points = points
            self.update()
        self.setAccessibleDescription(words)

    def paint(self, painter: QPainter, colours: Colours) -> None:
        if len(self._points) < 2:
            return
        width, height = self.width() - 4.0, self.height() - 4.0
        painter.setPen(QPen(QColor(colours.line), 1.0))
        painter.drawLine(QPointF(2.0, height + 2.0), QPointF(width + 2.0, height + 2.0))
        painter.setPen(QPen(QColor(colours.accent), 1.5))
        painter.drawPolyline(QPolygonF([QPointF(2.0 + x * width, 2.0 + (1.0 - y) * height) for x, y in self._points.tolist()]))
