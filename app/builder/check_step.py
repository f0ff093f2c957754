"""Step 6: landmarks, the summary, and the folder of the scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import QCheckBox, QFileDialog, QLabel, QLineEdit, QListWidget, QListWidgetItem, QWidget

from app.builder.fields import VectorField, button, row_of
from app.builder.step import Step
from app.dialogs.form_widgets import path_row
from app.dialogs.landmark_dialog import free_name, name_problem
from app.panels.layouts import make_column, make_form
from app.panels.widgets import secondary_label, set_bold
from app.scene3d.draft_view import Mode
from app.session.opening import is_shipped
from app.theme import WIDGET_GAP_PX
from skincal.geometry import FloatArray
from skincal.mesh.laid_check import LANDMARK_OFF_MESH_MIN_DISTANCE_M, off_mesh_words
from skincal.mesh.search import nearest_points
from skincal.part.draft_preview import PartPreview, completed_draft
from skincal.part.draft_summary import State, summarize, why_not_simulated
from skincal.part.part_draft import METRE_DIGITS, LandmarkDraft, free_scene_path, rounded
from skincal.part.robot_copy import is_with_robot, size_words

LANDMARK_NORMAL_DECIMALS = 3
STATE_SIGNS = {State.COMPLETE: "\N{CHECK MARK}", State.OPTIONAL: "\N{BLACK UP-POINTING TRIANGLE}", State.NEEDED: "\N{BALLOT X}"}
LANDMARK_LIST_MAX_HEIGHT_PX = 110
TRY_HINT = "Saves the part, and starts a session: a simulated hand follows the guide. No device is needed."


class CheckStep(Step):
    """Landmarks and summary."""

    name = "check"
    tab = "Check"
    title = "Landmarks and check"
    hint = (
        "Click screw heads and corners: known points that you can poke. Three or more show a common shift, a turned sensor "
        "frame and joint errors."
    )

    try_wanted = Signal()
    """Save the part, and poke it with a simulated hand."""

    def __init__(self, scenes: Path) -> None:
        super().__init__()
        self._scenes = scenes
        self._is_typed_folder = self._is_typed_place = False
        self._summary_labels: list[QLabel] = []
        self.mode = Mode.POINT
        self.list = QListWidget()
        self.list.setAccessibleName("landmarks")
        self.list.setMaximumHeight(LANDMARK_LIST_MAX_HEIGHT_PX)
        self.list.currentRowChanged.connect(self._show_chosen)
        self.mark_name = QLineEdit()
        self.mark_name.setAccessibleName("name of the landmark")
        self.mark_name.editingFinished.connect(self._rename)
        self.mark_name.returnPressed.connect(self._end_naming)
        self.place = VectorField("position of the landmark")
        self.place.edited.connect(self._move)
        self.add, self.remove = button("&Add at the position", run=self._add), button("&Remove", run=self._remove)
        self.add_other = button("An&other landmark", run=self._describe_another)
        self.distance = secondary_label(wrap=True)
        self.distance.setAccessibleName("distance of the landmark from the mesh")
        self.nearest = button("Use the nearest point of the mesh", run=self._use_nearest)
        rows = (
            self.list, ("&Name", self.mark_name), ("Pos&ition", self.place), self.distance, ("", row_of(self.nearest)),
            ("", row_of(self.add, self.add_other, self.remove)),
        )  # fmt: skip
        head, summary = QLabel("Summary"), QWidget()
        set_bold(head)
        summary.setAccessibleName("summary")
        self._lines = make_column(within=summary, margins=0, gap=WIDGET_GAP_PX // 2)
        self.folder = QLineEdit()
        self.folder.textEdited.connect(self._type_folder)
        self.copies = QCheckBox()
        self.copies.setToolTip("The folder can then be moved to another computer")
        self.copies.clicked.connect(lambda on: self.change(replace(self.draft, copies_robot=on)))
        where = make_form(path_row("&Folder", self.folder, self._choose_folder), ("", self.copies))
        self.attempt = button("Try it with a si&mulated hand", run=self.try_wanted.emit)
        self.attempt_note = secondary_label(wrap=True)
        self.form = make_form(*rows)
        self.fill(self.form, head, summary, where, row_of(self.attempt), self.attempt_note)

    def scene_path(self) -> Path:
        source = self.draft.source
        folder = Path(self.folder.text())
        if source is not None and folder == source.parent:
            return source
        return folder / "scene.toml"

    def summary(self) -> list[str]:
        return [label.text() for label in self._summary_labels]

    def update_fields(self, preview: PartPreview) -> None:
        marks = preview.draft.landmarks
        row = min(self.list.currentRow(), len(marks) - 1)
        with QSignalBlocker(self.list):
            self.list.clear()
            for mark in marks:
                self.list.addItem(QListWidgetItem(mark.name))
            self.list.setCurrentRow(row)
        self._show_chosen(row)
        self._show_summary(preview)
        why = why_not_simulated(preview)
        self.attempt.setEnabled(not why)
        self.attempt_note.setText(why or TRY_HINT)
        if not self._is_typed_folder:
            source = None if preview.draft.source is None or is_shipped(preview.draft.source) else preview.draft.source
            name = completed_draft(preview).name
            self.folder.setText(str(free_scene_path(self._scenes, name).parent if source is None else source.parent))
        self._show_copies()

    def _show_copies(self) -> None:
        """Offer to copy the robot's files beside the scene, unless they are there."""
        urdf, files, path = self.draft.urdf, None if self.preview is None else self.preview.robot_files, self.scene_path()
        is_offered = urdf is not None and path != self.draft.source and not is_with_robot(urdf, path.parent)
        self.copies.setVisible(is_offered and files is not None)
        self.copies.setChecked(self.draft.copies_robot)
        if files is not None:
            self.copies.setText(f"Copy the robot into it: {size_words(len(files.sources), files.size)}")

    def _show_summary(self, preview: PartPreview) -> None:
        texts = [f"{STATE_SIGNS[line.state]}  {line.text}" for line in summarize(preview)]
        if texts == self.summary():
            return
        for label in self._summary_labels:
            self._lines.removeWidget(label)
            label.deleteLater()
        self._summary_labels = []
        for text in texts:
            label = QLabel(text, wordWrap=True, textInteractionFlags=Qt.TextInteractionFlag.TextSelectableByMouse)
            self._lines.addWidget(label)
            self._summary_labels.append(label)

    def _show_chosen(self, row: int) -> None:
        """Show the chosen landmark; without one the fields keep what was typed for the next."""
        marks = self.draft.landmarks
        has_mark = 0 <= row < len(marks)
        if has_mark:
            if marks[row].name != self.mark_name.text() and not self.mark_name.hasFocus():
                self.mark_name.setText(marks[row].name)
            self.place.show_value([1e3 * value for value in marks[row].place])
        self.add.setVisible(not has_mark)
        self.add_other.setVisible(has_mark)
        self.remove.setEnabled(has_mark)
        self.remove.setToolTip("" if has_mark else "Choose a landmark in the list first.")
        self._show_distance()

    def _show_distance(self) -> None:
        """Show the distance of a landmark from the mesh, and offer the nearest point."""
        found = None if self.list.currentRow() < 0 and not self._is_typed_place else self._nearest()
        is_off = found is not None and float(np.linalg.norm(found[0] - found[1])) > LANDMARK_OFF_MESH_MIN_DISTANCE_M
        self.distance.setText(off_mesh_words("This point", *found) if found is not None and is_off else "")
        for each in (self.distance, self.nearest):
            each.setVisible(is_off)

    def _nearest(self) -> tuple[FloatArray, FloatArray] | None:
        """Return the point in the fields and the nearest one of the mesh, (3,) metres; `None` without a mesh."""
        surface = None if self.preview is None else self.preview.surface
        if surface is None:
            return None
        point = np.array(self.place.value()) * 1e-3
        return point, nearest_points(surface, point[None])[0][0]

    def _use_nearest(self) -> None:
        found = self._nearest()
        if found is not None:
            self.place.show_value((1e3 * found[1]).tolist())
            self._move(self.place.value())

    def _describe_another(self) -> None:
        """Leave the chosen landmark: the fields then describe the next one."""
        self.list.setCurrentRow(-1)
        self.mark_name.clear()
        self._is_typed_place = False
        self._show_chosen(-1)
        self.mark_name.setFocus()

    def take_point(self, point: FloatArray, *, on_mesh: bool = True) -> None:
        """Add a landmark at a point, (3,) float, metres, link frame; a name that was typed before is its name."""
        marks = self.draft.landmarks
        taken = {mark.name for mark in marks}
        typed = self.mark_name.text().strip() if self.list.currentRow() < 0 else ""
        problem = name_problem(typed, taken) if typed else ""
        if problem:
            self.failed.emit(problem)
            return
        name = typed or free_name(taken)
        surface = None if self.preview is None else self.preview.surface
        normal = None
        if surface is not None:
            near, triangles = nearest_points(surface, point[None])
            normal = rounded(surface.normals[triangles[0]], LANDMARK_NORMAL_DECIMALS)
            point = near[0] if on_mesh else point
        mark = LandmarkDraft(name, rounded(point, METRE_DIGITS), normal)
        self.change(replace(self.draft, landmarks=(*marks, mark)))
        with QSignalBlocker(self.list):
            self.list.addItem(QListWidgetItem(name))
            self.list.setCurrentRow(len(marks))
        self.mark_name.setText(name)
        self._show_chosen(len(marks))
        self.mark_name.setFocus()
        self.mark_name.selectAll()

    def _add(self) -> None:
        self.take_point(np.array(self.place.value()) * 1e-3, on_mesh=False)

    def _rename(self) -> None:
        row, name = self.list.currentRow(), self.mark_name.text().strip()
        marks = self.draft.landmarks
        if not 0 <= row < len(marks) or marks[row].name == name:
            return
        problem = name_problem(name, {mark.name for mark in marks})
        if problem:
            self.failed.emit(problem)
            return
        self._replace(row, replace(marks[row], name=name), "")

    def _end_naming(self) -> None:
        """After Enter the fields describe the next landmark: a name that is typed now is its name."""
        row, marks = self.list.currentRow(), self.draft.landmarks
        self._rename()
        if 0 <= row < len(marks) and self.draft.landmarks[row].name == self.mark_name.text().strip():
            self._describe_another()

    def _move(self, millimetres: tuple[float, float, float]) -> None:
        row = self.list.currentRow()
        if 0 <= row < len(self.draft.landmarks):
            place = rounded(np.array(millimetres) * 1e-3, METRE_DIGITS)
            self._replace(row, replace(self.draft.landmarks[row], place=place), f"landmark {row}")
        self._is_typed_place = True
        self._show_distance()

    def _replace(self, row: int, mark: LandmarkDraft, merge: str) -> None:
        marks = list(self.draft.landmarks)
        marks[row] = mark
        self.change(replace(self.draft, landmarks=tuple(marks)), merge)

    def _remove(self) -> None:
        row = self.list.currentRow()
        marks = self.draft.landmarks
        self.change(replace(self.draft, landmarks=(*marks[:row], *marks[row + 1 :])))

    def _type_folder(self) -> None:
        self._is_typed_folder = True
        self._show_copies()

    def _choose_folder(self) -> None:
        path = QFileDialog.getExistingDirectory(self, "Folder of the new scene", str(Path(self.folder.text()).parent))
        if path:
            self.folder.setText(path)
            self._type_folder()
