"""Adding a landmark, a known point of the part: a click on the part or typed coordinates, then a name."""

from __future__ import annotations

from collections.abc import Callable, Collection

import numpy as np
from PySide6.QtCore import QObject, Signal
from PySide6.QtWidgets import QLabel, QLineEdit, QWidget

from app.dialogs.dialog import Dialog, StandardButton
from app.dialogs.form_widgets import number_field
from app.panels.layouts import make_form, make_row
from app.panels.widgets import secondary_label
from app.scene3d.view import View3D
from app.text.message import Message
from app.theme import WIDGET_GAP_PX
from skincal.geometry import FloatArray
from skincal.model.actions import Action, AddLandmark
from skincal.model.tables import MAX_LENGTH_M
from skincal.words.units import UNITS

MILLIMETRE_INPUT_DECIMALS = 2
PICKED_NOTE = "The point that you clicked, in the frame {link}. A drawing may be more accurate."
TYPED_NOTE = "From a drawing, in the frame {link}."
CLICK_REQUEST = Message("Click the point on the part. K: type its position. Esc: cancel.", asks=True)


class LandmarkDialog(Dialog):
    """Dialog for position and name of a new landmark; its name must be unique.

    Parameters
    ----------
    position : (3,) float, metres, link frame; `None` if nothing was clicked
    taken : names of the present landmarks
    link : name of the frame
    """

    given = Signal(str, object)  # Name, and position (3,) float, metres, link frame

    def __init__(self, position: FloatArray | None, taken: Collection[str], link: str, parent: QWidget | None = None) -> None:
        super().__init__("Add landmark", parent, StandardButton.Ok | StandardButton.Cancel)
        self.setMinimumWidth(480)
        self._taken = taken
        self.name = QLineEdit(free_name(taken))
        unit, limit = UNITS["m"].text, 1e3 * MAX_LENGTH_M
        self.coordinates = [
            number_field(f"{axis} in {unit}", f" {unit}", limit, MILLIMETRE_INPUT_DECIMALS, f"{axis}  ") for axis in "xyz"
        ]
        for box, value in zip(self.coordinates, np.zeros(3) if position is None else 1e3 * position, strict=True):
            # The button may be clicked while a number is being typed.
            box.setKeyboardTracking(True)
            box.setValue(float(value))
        self.objection = QLabel(wordWrap=True)
        self.button(StandardButton.Ok).setText("Add")
        self.button(StandardButton.Ok).setDefault(True)
        label = QLabel("&Position")
        label.setBuddy(self.coordinates[0])
        row = make_row(*((box, 1) for box in self.coordinates), gap=WIDGET_GAP_PX)
        note = secondary_label((TYPED_NOTE if position is None else PICKED_NOTE).format(link=link), wrap=True)
        self.fill(make_form(("&Name", self.name), (label, row), ("", note)), self.objection)
        self.name.selectAll()
        self.name.setFocus()
        self.buttons.accepted.connect(self._try)

    def position(self) -> FloatArray:
        """Give the position, (3,) float, metres, link frame."""
        return 1e-3 * np.array([box.value() for box in self.coordinates])

    def _try(self) -> None:
        name = self.name.text().strip()
        problem = name_problem(name, self._taken)
        if problem:
            self.objection.setText(f"\N{BALLOT X} {problem}")
            self.name.setFocus()
            return
        self.given.emit(name, self.position())
        self.accept()


def free_name(taken: Collection[str]) -> str:
    """Find the first unused name of "landmark 1", "landmark 2" and so on."""
    return next(name for number in range(1, len(taken) + 2) if (name := f"landmark {number}") not in taken)


def name_problem(name: str, taken: Collection[str]) -> str:
    """Say why a landmark cannot have this name; empty if it can."""
    if not name:
        return "The landmark has no name. Enter one that tells where it is on the part, for example: screw at the wrist."
    return f"There is a landmark {name!r} already. Enter another name." if name in taken else ""


class LandmarkPicking(QObject):
    """Steps from the command to the new landmark: click or coordinates, dialog, action."""

    said = Signal(object)  # `Message` that asks for a click
    unsaid = Signal(object)  # `Message` that is over

    def __init__(
        self, view: View3D, names: Callable[[], Collection[str]], act: Callable[[Action], object], link: str, parent: QObject
    ) -> None:
        super().__init__(parent)
        self._view, self._names, self._act, self._link = view, names, act, link
        self._window: QWidget | None = None
        view.surface_picked.connect(self._take_click)

    @property
    def waiting(self) -> bool:
        """Whether the dialog waits for a click on the part."""
        return self._view.picking

    def ask(self, window: QWidget) -> None:
        """Wait for a click on the part; on a second call, or without a surface, ask for coordinates."""
        self._window = window
        if self.waiting or not self._view.can_pick:
            self.stop()
            self._open_dialog(None)
            return
        self._view.set_picking(True)
        self.said.emit(CLICK_REQUEST)

    def stop(self) -> None:
        self._view.set_picking(False)
        self.unsaid.emit(CLICK_REQUEST)

    def _take_click(self, position: FloatArray) -> None:
        self.unsaid.emit(CLICK_REQUEST)
        self._open_dialog(position)

    def _open_dialog(self, position: FloatArray | None) -> None:
        dialog = LandmarkDialog(position, self._names(), self._link, self._window)
        dialog.given.connect(lambda name, at: self._act(AddLandmark(name, *at.tolist())))
        dialog.open()
