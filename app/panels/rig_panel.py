"""The Rig tab: landmarks of the part, errors of the rig that their pokes show, and the arm's pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QAbstractItemView, QLabel, QPushButton, QTreeWidgetItem, QWidget

from app.panels.layouts import make_column, make_row
from app.panels.panel import Panel
from app.panels.widgets import fit_columns, fit_rows, put_rows, secondary_label, set_bold, table
from app.state.memo import is_same
from app.state.view_state import ViewState
from app.text.guidance_text import gain_words, landmark_words
from app.text.part_pose_text import tool_state
from app.text.rig_text import landmark_rows, offer_text, review_words
from app.theme import WIDGET_GAP_PX
from skincal.contacts.outcome import Contact
from skincal.model.actions import SetPose, Uncorrect
from skincal.model.readings import Stream
from skincal.model.scene import ArmSpec
from skincal.words.tip_words import tip_sentence
from skincal.words.units import cell

if TYPE_CHECKING:
    from skincal.following.guided_session import GuidedSession

HEADINGS = ("Landmark", "Pokes in\nthis pose", "Pokes in\nall poses", "Miss\nmm")
_COLUMN_HINTS = (
    "A known point of the part, from the scene or added by hand; a diamond in the 3D view",
    "Its pokes in the present arm pose",
    "Its pokes in all arm poses",
    "Distance of the force axes from it, as reported and with the correction that was found",
)
NO_LANDMARKS = "No landmarks. Name some in the scene ([[landmarks]]), or press K and click a known point of the part."
REVIEW_RUNNING = "Computing the errors of the rig …"
NO_LANDMARK_POKES = "Press landmarks: three pokes check the sensor's frame. Six or more, at four landmarks, can correct them."


class ArmPanel(QWidget):
    """The arm poses of a scene, to choose from, or the streamed pose."""

    pose_wanted = Signal(str)

    def __init__(self, arm: ArmSpec) -> None:
        super().__init__()
        self._shown: tuple[object, ...] = ()
        self._streamed = False
        self.current = QLabel("Arm pose unknown", wordWrap=True)
        set_bold(self.current)
        self.how = secondary_label(wrap=True)
        self.poses = table("arm poses", ("Pose", "Joints, \N{DEGREE SIGN}", "Contacts"))
        # Seven joints are wider than their column.
        self.poses.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAsNeeded)
        self.poses.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self.rows = {name: QTreeWidgetItem(self.poses) for name in arm.poses}
        for name, row in self.rows.items():
            # The text of the row has a mark before the name.
            row.setData(0, Qt.ItemDataRole.UserRole, name)
            row.setText(1, "   ".join(cell(float(angle), "rad") for angle in np.atleast_1d(arm.poses[name])))
        make_column(self.current, self.how, self.poses, within=self, margins=(0, WIDGET_GAP_PX, 0, 0))
        self.poses.itemActivated.connect(self._chosen)
        self.poses.itemClicked.connect(self._chosen)
        self.setWhatsThis(
            "The arm pose gives the position of the sensor relative to the part. Choose the pose of the arm, or stream the "
            "joints; a poke in an unknown pose does not count."
        )

    def show_state(self, state: ViewState) -> None:
        streamed = any(Stream.JOINTS in link.carries for link in state.live.links)
        shown = (state.revision, state.live.pose, streamed)
        if is_same(shown, self._shown):
            return
        self._shown = shown
        pose = state.live.pose
        self.current.setText(f"Arm pose {pose}" if pose else "Arm pose unknown")
        self.how.setText("The joints are streamed." if streamed else "Click the pose of the arm after each move.")
        self._streamed = streamed
        used = [p.outcome.pose for p in state.snapshot.pokes if isinstance(p.outcome, Contact) and not p.excluded]
        for name, row in self.rows.items():
            mark = "\N{BLACK CIRCLE}" if name == pose else "\N{WHITE CIRCLE}"
            row.setText(0, f"{mark}  {name}")
            row.setText(2, str(used.count(name)))
        fit_columns(self.poses)
        fit_rows(self.poses)

    def _chosen(self, row: QTreeWidgetItem, _column: int) -> None:
        if not self._streamed:
            self.pose_wanted.emit(str(row.data(0, Qt.ItemDataRole.UserRole)))


class RigPanel(Panel):
    """Errors of the rig, and the correction that is available or in use."""

    title = "Rig"

    def __init__(self, guided: GuidedSession) -> None:
        super().__init__()
        arm, self._setup = guided.part.scene.arm, guided.setup
        self.arm = None if arm is None else ArmPanel(arm)
        self.points = table("landmarks", HEADINGS, _COLUMN_HINTS)
        self.points.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        # A tool has another pose at each poke.
        self.points.setColumnHidden(1, guided.part.scene.tool is not None)
        self.asked, self.tip, self.said = (secondary_label(wrap=True) for _ in range(3))
        self.said.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.offer, self.drop = QPushButton(), QPushButton()
        offers, arm = make_row(self.offer, self.drop, 1), () if self.arm is None else (self.arm,)
        self.fill(self.asked, self.said, self.tip, offers, self.points, *arm, 1, margins=WIDGET_GAP_PX)
        self.offer.hide()
        self.drop.hide()
        self.offer.clicked.connect(lambda: self.command_wanted.emit("correct"))
        self.drop.clicked.connect(self._drop_correction)
        if self.arm is not None:
            self.arm.pose_wanted.connect(lambda name: self.action_wanted.emit(SetPose(name)))
        self.setWhatsThis(
            "Pokes at landmarks, known points of the part, show errors of the rig: the sensor's frame, its matrix, the poses "
            "of an arm. A correction is applied only if you choose it, and can be undone. One landmark in four is left out "
            "of the fit; a correction is offered only if it lowers the error there."
        )

    def show_state(self, state: ViewState) -> None:
        if self.arm is not None:
            self.arm.show_state(state)
        super().show_state(state)

    def depends_on(self, state: ViewState) -> tuple[object, ...]:
        snapshot = state.snapshot
        shown = state.revision, state.live.pose, snapshot.decisions, state.review, state.offers, state.guidance, state.method
        return *shown, self._setup.sentences, *(link.pose_delay for link in state.live.links)

    def update_view(self, state: ViewState) -> None:
        guidance = state.guidance
        self._list_points(state)
        landmark = None if guidance is None else guidance.landmark
        asked = (
            ()
            if guidance is None or landmark is None
            else (landmark_words(landmark, has_tool=state.scene.tool is not None), gain_words(guidance.gain))
        )
        self.asked.setText("; ".join(filter(None, asked)))
        self.asked.setVisible(bool(asked))
        self.said.setText("\n".join([*self._setup.sentences, _words(state)]))
        tip = _tip_words(state)
        self.tip.setVisible(bool(tip))
        self.tip.setText(tip)
        offer = f"{offer_text(state.offers[0])}  (C)" if state.offers else ""
        drop = "Remove this correction" if state.snapshot.decisions.corrections else ""
        for button, text in ((self.offer, offer), (self.drop, drop)):
            button.setVisible(bool(text))
            button.setText(text)

    def _list_points(self, state: ViewState) -> None:
        rows = landmark_rows(state.snapshot, state.review, state.live.pose)
        self.points.setVisible(bool(rows))
        asked = "" if state.target is None else state.target.landmark
        sign = "\N{BLACK RIGHT-POINTING TRIANGLE} "
        put_rows(self.points, [(sign * (name == asked) + name, *others) for name, *others in rows])
        fit_rows(self.points)

    def _drop_correction(self) -> None:
        # The newest first: it was found under the others.
        corrections = () if self._state is None else tuple(self._state.snapshot.decisions.corrections)
        if corrections:
            self.action_wanted.emit(Uncorrect(corrections[-1]))


def _words(state: ViewState) -> str:
    if not state.snapshot.decisions.landmarks:
        return NO_LANDMARKS
    if not state.scene.has_sensor:
        return ""
    if state.review is None:
        return REVIEW_RUNNING if state.snapshot.at_landmarks else NO_LANDMARK_POKES
    return "\n".join(
        review_words(state.review, state.snapshot, state.method, state.estimates, has_arm=state.scene.arm is not None)
    )


def _tip_words(state: ViewState) -> str:
    """Describe the tip's positions, or the tip of a tool and the part's pose in the base; empty without them."""
    if state.scene.tool is not None:
        return tool_state(state)
    snapshot = state.snapshot
    return "" if snapshot.tip_frame is None else tip_sentence(snapshot.tip_frame)
