"""How the operator tells a known point of the part: a click on it, or its coordinates, then its name."""

from __future__ import annotations

from collections.abc import Callable, Collection

from PySide6.QtCore import QObject, Signal
from PySide6.QtWidgets import QWidget

from app.dialogs.landmark import LandmarkDialog
from app.panels.message_bar import Message
from app.scene3d.view import View3D
from skincal.geometry.arrays import FloatArray
from skincal.session.actions import Action, AddLandmark

ASK = Message("Click the point on the part; Esc ends.", asks=True)


class Marking(QObject):
    """Leads from the command to the landmark.

    Parameters
    ----------
    view : in which the point is clicked
    names : gives those of the landmarks that there are
    act : does it
    link : name of the frame
    """

    said = Signal(object)
    """`Message`: what to do now."""
    unsaid = Signal(object)
    """`Message` that holds no more."""

    def __init__(
        self,
        view: View3D,
        names: Callable[[], Collection[str]],
        act: Callable[[Action], object],
        link: str,
        parent: QObject | None = None,
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
        """Wait for a click on the part, or no more; where there is nothing to click on, ask for coordinates at once.

        Parameters
        ----------
        window : over which the dialog appears
        """
        if self.waiting:
            self.stop()
            return
        self._window = window
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
