"""The arm's pose: chosen from those the scene names, or shown as the joints stream it."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QAbstractItemView, QLabel, QTreeWidget, QTreeWidgetItem, QVBoxLayout, QWidget

from app.display_units import degrees
from app.panels.texts import fit_rows, put, quiet
from app.state.view_state import ViewState
from app.theme import GAP
from skincal.contacts.outcome import Contact
from skincal.model.readings import Stream
from skincal.model.scene import ArmSpec


class ArmPanel(QWidget):
    """The poses of a scene; absent where a scene has no arm."""

    pose_requested = Signal(str)

    def __init__(self, arm: ArmSpec, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._shown: tuple[object, ...] = ()
        self._streamed = False
        self.current = QLabel("Arm pose unknown")
        font = self.current.font()
        font.setBold(True)
        self.current.setFont(font)
        self.current.setWordWrap(True)
        self.how = quiet(wrap=True)
        self.poses = QTreeWidget()
        self.poses.setAccessibleName("arm poses")
        self.poses.setHeaderLabels(["Pose", "Joints", "Contacts"])
        self.poses.setRootIsDecorated(False)
        self.poses.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self.rows = {name: QTreeWidgetItem(self.poses) for name in arm.poses}
        for name, row in self.rows.items():
            row.setData(0, Qt.ItemDataRole.UserRole, name)
            row.setText(1, "   ".join(degrees(float(angle), 1) for angle in np.atleast_1d(arm.poses[name])))
        column = QVBoxLayout(self)
        column.setContentsMargins(0, GAP, 0, 0)
        column.addWidget(self.current)
        column.addWidget(self.how)
        column.addWidget(self.poses)
        self.poses.itemActivated.connect(self._chosen)
        self.poses.itemClicked.connect(self._chosen)
        self.setWhatsThis(
            "The pose of the arm says where the sensor is in the frame of the part. Choose the one the arm stands in, or let "
            "the joints be streamed; a poke with an unknown pose does not count."
        )

    def show_state(self, state: ViewState) -> None:
        """Show the current pose and how it is known."""
        streamed = any(Stream.JOINTS in link.carries for link in state.live.links)
        shown = (state.revision, state.snapshot.pose, streamed)
        if shown == self._shown:
            return
        self._shown = shown
        pose = state.snapshot.pose
        put(self.current, f"Arm pose {pose}" if pose else "Arm pose unknown")
        put(self.how, "The joints are streamed." if streamed else "Click the pose in which the arm stands, after moving it.")
        self._streamed = streamed
        used = [p.outcome.pose for p in state.snapshot.pokes if isinstance(p.outcome, Contact) and not p.excluded]
        for name, row in self.rows.items():
            mark = "\N{BLACK CIRCLE}" if name == pose else "\N{WHITE CIRCLE}"
            _put(row, 0, f"{mark}  {name}")
            _put(row, 2, str(used.count(name)))
        fit_rows(self.poses)

    def _chosen(self, row: QTreeWidgetItem, _column: int) -> None:
        if not self._streamed:
            self.pose_requested.emit(str(row.data(0, Qt.ItemDataRole.UserRole)))


def _put(row: QTreeWidgetItem, column: int, text: str) -> None:
    if row.text(column) != text:
        row.setText(column, text)
