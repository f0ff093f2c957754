"""Adding a landmark, a known point of the part: a click on it or its coordinates, then its name."""

from __future__ import annotations

from collections.abc import Callable, Collection

import numpy as np
from PySide6.QtCore import QLocale, QObject, Qt, Signal
from PySide6.QtWidgets import (
    QDialog,
    QDialogButtonBox,
    QDoubleSpinBox,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QVBoxLayout,
    QWidget,
)

from app.panels.widgets import plain_buttons, secondary_label
from app.scene3d.view import View3D
from app.text.message import Message
from app.theme import GAP
from skincal.geometry import FloatArray
from skincal.model.actions import Action, AddLandmark
from skincal.model.tables import LENGTH_MAX
from skincal.words.units import UNITS, in_metres, in_millimetres

AXES = ("x", "y", "z")
DECIMALS = 2
"""Of a millimetre: a drawing says no more."""
PICKED = "Where you clicked, in the frame {link}. A drawing may know it better."
TYPED = "From a drawing, in the frame {link}."

ASK = Message("Click the point on the part, or K again to type its place; Esc ends.", asks=True)


class LandmarkDialog(QDialog):
    """Gathers a name that no other landmark has, and a place.

    Parameters
    ----------
    place : (3,) float, metres, link frame; None where nothing was clicked
    taken : names of the landmarks that there are
    link : the frame's name
    """

    given = Signal(str, object)
    """The name, and (3,) float, metres, link frame."""

    def __init__(self, place: FloatArray | None, taken: Collection[str], link: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Add landmark")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self._taken = taken
        self.name = QLineEdit(free_name(taken))
        self.coordinates = [_millimetres(axis) for axis in AXES]
        for box, value in zip(self.coordinates, np.zeros(3) if place is None else in_millimetres(place), strict=True):
            box.setValue(float(value))
        self.objection = QLabel()
        self.objection.setWordWrap(True)
        standard = QDialogButtonBox.StandardButton
        self.buttons = QDialogButtonBox(standard.Ok | standard.Cancel)
        self._arrange((TYPED if place is None else PICKED).format(link=link))
        self.buttons.accepted.connect(self._try)
        self.buttons.rejected.connect(self.reject)

    def _arrange(self, about: str) -> None:
        row = QHBoxLayout()
        row.setSpacing(GAP)
        for box in self.coordinates:
            row.addWidget(box, 1)
        form = QFormLayout()
        form.addRow("&Name", self.name)
        label = QLabel("&Place")
        label.setBuddy(self.coordinates[0])
        form.addRow(label, row)
        form.addRow("", secondary_label(about, wrap=True))
        self.buttons.button(QDialogButtonBox.StandardButton.Ok).setText("Add")
        self.buttons.button(QDialogButtonBox.StandardButton.Ok).setDefault(True)
        plain_buttons(self.buttons)
        column = QVBoxLayout(self)
        column.addLayout(form)
        column.addWidget(self.objection)
        column.addWidget(self.buttons)
        self.setMinimumWidth(480)
        self.name.selectAll()
        self.name.setFocus()

    def place(self) -> FloatArray:
        """Return (3,) float, metres, link frame."""
        return in_metres(np.array([box.value() for box in self.coordinates]))

    def _try(self) -> None:
        name = self.name.text().strip()
        refused = objection_to(name, self._taken)
        if refused:
            self.objection.setText(f"\N{BALLOT X} {refused}")
            self.name.setFocus()
            return
        self.given.emit(name, self.place())
        self.accept()


def free_name(taken: Collection[str]) -> str:
    """Return the first of "landmark 1", "landmark 2" and so on that no landmark has."""
    # One number more than there are names: one of them is free.
    return next(name for number in range(1, len(taken) + 2) if (name := f"landmark {number}") not in taken)


def objection_to(name: str, taken: Collection[str]) -> str:
    """Return why a landmark cannot be called so; empty where it can."""
    if not name:
        return "The landmark has no name; give it one by which you find it on the part, such as the screw's place."
    return f"There is a landmark {name!r} already; give this one another name." if name in taken else ""


def _millimetres(axis: str) -> QDoubleSpinBox:
    box = QDoubleSpinBox()
    # The same point in every number of the window.
    box.setLocale(QLocale.c())
    most = float(in_millimetres(LENGTH_MAX))
    box.setRange(-most, most)
    box.setDecimals(DECIMALS)
    box.setPrefix(f"{axis}  ")
    box.setSuffix(f" {UNITS['m'].text}")
    box.setAccessibleName(f"{axis} in {UNITS['m'].text}")
    return box


class LandmarkPicking(QObject):
    """Leads from the command to the landmark."""

    said = Signal(object)
    """`Message`: what to do now."""
    unsaid = Signal(object)
    """`Message` that holds no more."""

    def __init__(
        self, view: View3D, names: Callable[[], Collection[str]], act: Callable[[Action], object], link: str, parent: QObject
    ) -> None:
        super().__init__(parent)
        self._view, self._names, self._act, self._link = view, names, act, link
        self._window: QWidget | None = None
        view.surface_picked.connect(self._take)

    @property
    def waiting(self) -> bool:
        """Whether a click is waited for."""
        return self._view.picking

    def ask(self, window: QWidget) -> None:
        """Wait for a click on the part; asked again, or where there is nothing to click on, ask for coordinates."""
        self._window = window
        if self.waiting:
            self.stop()
            self._open(None)
            return
        if not self._view.can_pick:
            self._open(None)
            return
        self._view.set_picking(True)
        self.said.emit(ASK)

    def stop(self) -> None:
        """Wait for a click no more."""
        self._view.set_picking(False)
        self.unsaid.emit(ASK)

    def _take(self, place: FloatArray) -> None:
        self.unsaid.emit(ASK)
        self._open(place)

    def _open(self, place: FloatArray | None) -> None:
        dialog = LandmarkDialog(place, self._names(), self._link, self._window)
        dialog.given.connect(self._add)
        dialog.open()

    def _add(self, name: str, place: FloatArray) -> None:
        x, y, z = place.tolist()
        self._act(AddLandmark(name, x, y, z))
