"""The panel of the rig: the landmarks of the part, what pokes at them say of the sensor and the arm, and the arm's pose.

The pose is chosen from those that the scene names, or shown as the joints stream it.
"""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QAbstractItemView,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QPushButton,
    QTreeWidgetItem,
    QVBoxLayout,
    QWidget,
)

from app.panels.panel import Panel, is_same
from app.panels.widgets import embolden, fit_rows, on_panel, put_rows, quiet, table
from app.state.policies import Offer
from app.state.view_state import ViewState
from app.text.guidance_text import gain_words, landmark_words
from app.text.rig_text import landmark_rows, offer_text, review_words
from app.theme import GAP
from skincal.contacts.outcome import Contact
from skincal.model.readings import Stream
from skincal.model.scene import ArmSpec
from skincal.words.units import cell

HEADINGS = ("Landmark", "Here", "All", "Off by, mm")
_HINTS = (
    "A known point of the part, of the scene or added by hand; a diamond in the 3D view",
    "Pokes at it in the present arm pose",
    "Pokes at it in all arm poses",
    "How far their axes pass it, as the rig says and under the correction that was found",
)
NO_POINTS = "No landmarks: the scene may name some ([[landmarks]]), or K adds one that you click on the part."
WAITING = "What the landmarks tell is being worked out \N{HORIZONTAL ELLIPSIS}"
NOT_YET = (
    "Poke landmarks: three tell whether the sensor's frame is right, six or more, at four different ones, correct the rig."
)


class ArmPanel(QWidget):
    """The poses of a scene; absent where a scene has no arm."""

    pose_requested = Signal(str)

    def __init__(self, arm: ArmSpec) -> None:
        super().__init__()
        self._shown: tuple[object, ...] = ()
        self._streamed = False
        self.current = QLabel("Arm pose unknown")
        embolden(self.current)
        self.current.setWordWrap(True)
        self.how = quiet(wrap=True)
        self.poses = table("arm poses", ("Pose", "Joints, \N{DEGREE SIGN}", "Contacts"))
        # Seven joints are wider than their column: the operator widens it, or scrolls.
        self.poses.header().setSectionResizeMode(QHeaderView.ResizeMode.Interactive)
        self.poses.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAsNeeded)
        self.poses.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self.rows = {name: QTreeWidgetItem(self.poses) for name in arm.poses}
        for name, row in self.rows.items():
            # Kept apart: the text gets a mark before the name.
            row.setData(0, Qt.ItemDataRole.UserRole, name)
            row.setText(1, "   ".join(cell(float(angle), "rad") for angle in np.atleast_1d(arm.poses[name])))
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
        shown = (state.revision, state.live.pose, streamed)
        if is_same(shown, self._shown):
            return
        self._shown = shown
        pose = state.live.pose
        self.current.setText(f"Arm pose {pose}" if pose else "Arm pose unknown")
        self.how.setText("The joints are streamed." if streamed else "Click the pose in which the arm stands, after moving it.")
        self._streamed = streamed
        used = [p.outcome.pose for p in state.snapshot.pokes if isinstance(p.outcome, Contact) and not p.excluded]
        for name, row in self.rows.items():
            mark = "\N{BLACK CIRCLE}" if name == pose else "\N{WHITE CIRCLE}"
            row.setText(0, f"{mark}  {name}")
            row.setText(2, str(used.count(name)))
        fit_rows(self.poses)

    def _chosen(self, row: QTreeWidgetItem, _column: int) -> None:
        if not self._streamed:
            self.pose_requested.emit(str(row.data(0, Qt.ItemDataRole.UserRole)))


class RigPanel(Panel):
    """What is known of the rig, and what could put it right."""

    correct_requested = Signal(object)
    """`Correct`."""
    uncorrect_requested = Signal(str)
    """What is to be corrected no more."""

    def __init__(self, arm: ArmSpec | None) -> None:
        super().__init__()
        self._offer: Offer | None = None
        self._used = ""
        self.arm = None if arm is None else ArmPanel(arm)
        self.points = table("landmarks", HEADINGS, _HINTS)
        self.points.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self.points.header().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        self.points.header().setSectionResizeMode(0, QHeaderView.ResizeMode.Stretch)
        self.asked = quiet(wrap=True)
        self.said = quiet(wrap=True)
        self.said.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.offer = QPushButton()
        self.drop = QPushButton()
        self._arrange()
        self.offer.clicked.connect(self._offer_taken)
        self.drop.clicked.connect(lambda: self.uncorrect_requested.emit(self._used))
        self.setWhatsThis(
            "Pokes at landmarks, known points of the part, tell what is wrong with the rig: the sensor's frame, its matrix, "
            "the arm's poses. What is found is only offered; what is used can be taken back. One landmark in four is held "
            "out, and a correction of the rig is offered only if it meets these better."
        )

    def _arrange(self) -> None:
        inner = on_panel(self)
        column = QVBoxLayout(inner)
        column.setContentsMargins(GAP, GAP, GAP, GAP)
        column.addWidget(self.asked)
        column.addWidget(self.said)
        row = QHBoxLayout()
        row.addWidget(self.offer)
        row.addWidget(self.drop)
        row.addStretch(1)
        column.addLayout(row)
        column.addWidget(self.points)
        if self.arm is not None:
            column.addWidget(self.arm)
        column.addStretch(1)
        self.offer.hide()
        self.drop.hide()
        self.setWidget(inner)

    def show_state(self, state: ViewState) -> None:
        if self.arm is not None:
            self.arm.show_state(state)
        super().show_state(state)

    def depends_on(self, state: ViewState) -> tuple[object, ...]:
        snapshot = state.snapshot
        shown = (
            state.revision,
            state.live.pose,
            snapshot.decisions.landmarks,
            state.review,
            state.offers,
            state.guidance,
            state.method,
        )
        return (*shown, None if state.target is None else state.target.landmark)

    def update_view(self, state: ViewState) -> None:
        guidance = state.guidance
        self._list_points(state)
        landmark = None if guidance is None else guidance.landmark
        asked = () if guidance is None or landmark is None else (landmark_words(landmark), gain_words(guidance.gain))
        self.asked.setText("; ".join(filter(None, asked)))
        self.asked.setVisible(bool(asked))
        self.said.setText(_words(state))
        self._offer = state.offers[0] if state.offers else None
        # The newest one goes first: it was found under the others.
        self._used = next(reversed(tuple(state.snapshot.decisions.corrections)), "")
        offer = "" if self._offer is None else f"{offer_text(self._offer)}  (C)"
        for button, text in ((self.offer, offer), (self.drop, "Do without this correction" if self._used else "")):
            button.setVisible(bool(text))
            button.setText(text)

    def _list_points(self, state: ViewState) -> None:
        rows = landmark_rows(state.snapshot, state.review, state.live.pose)
        self.points.setVisible(bool(rows))
        asked = "" if state.target is None else state.target.landmark
        sign = "\N{BLACK RIGHT-POINTING TRIANGLE} "
        cells = [(sign * (row.name == asked) + row.name, str(row.here), str(row.every), row.off) for row in rows]
        put_rows(self.points, cells)
        fit_rows(self.points)

    def _offer_taken(self) -> None:
        if self._offer is not None:
            self.correct_requested.emit(self._offer.action)


def _words(state: ViewState) -> str:
    if not state.snapshot.decisions.landmarks:
        return NO_POINTS
    if state.review is None:
        return WAITING if state.snapshot.at_landmarks else NOT_YET
    return "\n".join(review_words(state.review, state.snapshot, state.method, state.estimates))
