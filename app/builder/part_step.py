"""Step 1: the mesh of the part or the robot's URDF; unit or link."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from PySide6.QtCore import QSignalBlocker, Qt
from PySide6.QtWidgets import QComboBox, QFileDialog, QLabel, QLineEdit, QTreeWidget, QTreeWidgetItem

from app.builder.fields import choice, show_choice
from app.builder.step import Step
from app.dialogs.form_widgets import path_row
from app.panels.layouts import make_form
from app.panels.widgets import compact_combo, secondary_label
from app.scene3d.draft_view import Mode
from app.session.opening import PART_FILES
from skincal.mesh.findings import box_words
from skincal.model.length_units import METRES_PER_UNIT
from skincal.model.urdf import Robot
from skincal.part.draft_preview import PartPreview
from skincal.part.mesh_units import choose_unit, has_no_unit
from skincal.part.part_changes import with_link, with_part_file, with_unit
from skincal.part.robot_mesh import with_own_mesh

FILE_FILTER = f"Part ({' '.join(f'*{ending}' for ending in PART_FILES)});;All files (*)"
UNIT_NAMES = {"mm": "millimetres", "cm": "centimetres", "m": "metres", "in": "inches"}


class PartStep(Step):
    """Mesh or URDF."""

    name = "part"
    tab = "Part"
    title = "Part"
    hint = (
        "Choose the mesh of the part (STL, OBJ, PLY, OFF, COLLADA, GLB), or the URDF of the robot that carries it. Or drop the "
        "file on the window."
    )

    def __init__(self) -> None:
        super().__init__()
        self.file = QLineEdit()
        self.file.editingFinished.connect(self._take_typed)
        self.part_name = QLineEdit(maxLength=80)
        self.part_name.setAccessibleName("name of the part")
        self.part_name.editingFinished.connect(self._rename)
        self.unit = choice("unit of the mesh", UNIT_NAMES)
        self.unit.activated.connect(lambda _: self.change(with_unit(self.draft, self.unit.currentData())))
        self.size_text = QLabel(wordWrap=True)
        self.tree = QTreeWidget()
        self.tree.setHeaderHidden(True)
        self.tree.setAccessibleName("links with a shape")
        self.tree.setMinimumHeight(150)
        self.tree.itemSelectionChanged.connect(self._choose_in_tree)
        self.frame: QComboBox = compact_combo("frame of all positions")
        self.frame.activated.connect(lambda _: self.take_link(self.frame.currentText()))
        self.tree_note = secondary_label("Click the link that carries the skin, in the view or in this list.", wrap=True)
        self.frame_note = secondary_label(
            "Positions are given in this frame. All listed frames are fixed to the link.", wrap=True
        )
        self.own_mesh = QLineEdit(placeholderText="that of the URDF; choose a file if it cannot be read")
        self.own_mesh.editingFinished.connect(self._take_own_mesh)
        mesh_label, self.mesh_row = path_row("&Mesh", self.own_mesh, self._choose_own_mesh)
        self.package = QLineEdit()
        self.package.editingFinished.connect(self._take_package)
        self.package_label, self.package_row = path_row("Pac&kage", self.package, self._choose_package)
        self.form = make_form(
            path_row("Mesh or &URDF", self.file, self.choose_file), ("Part's &name", self.part_name), ("Un&it", self.unit),
            ("Size", self.size_text), self.tree_note, self.tree, ("F&rame", self.frame), self.frame_note,
            (mesh_label, self.mesh_row), (self.package_label, self.package_row),
        )  # fmt: skip
        self.fill(self.form)
        self._robot: Robot | None = None
        self._show_rows(has_robot=False, has_mesh=False, has_unit=False)

    def choose_file(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Mesh or URDF", self._named(), FILE_FILTER)
        if path:
            self.take_file(Path(path))

    def _take_typed(self) -> None:
        text = self.file.text().strip()
        if text and text != self._named():
            self.take_file(Path(text).expanduser())

    def _named(self) -> str:
        return str(self.draft.urdf or self.draft.mesh or "")

    def _take_own_mesh(self) -> None:
        text = self.own_mesh.text().strip()
        mesh = Path(text).expanduser() if text else None
        if self.draft.urdf is not None and self._robot is not None and mesh != self.draft.mesh:
            with self.report_failure():
                unit = "mm" if mesh is None else choose_unit(mesh)
                changed = with_own_mesh(self.draft, self._robot, mesh, "", unit)
                self.change(replace(changed, is_unit_guessed=mesh is not None and has_no_unit(mesh)))

    def _choose_own_mesh(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Mesh of the link", self._named(), FILE_FILTER)
        if path:
            self.own_mesh.setText(path)
            self._take_own_mesh()

    def _take_package(self) -> None:
        text = self.package.text().strip()
        if text and self.preview is not None and self.preview.missing_packages:
            packages = {**dict(self.draft.packages), self.preview.missing_packages[0]: Path(text).expanduser()}
            self.package.clear()
            self.change(replace(self.draft, packages=tuple(packages.items())))

    def _choose_package(self) -> None:
        path = QFileDialog.getExistingDirectory(self, self.package_label.text().replace("&", ""), self._named())
        if path:
            self.package.setText(path)
            self._take_package()

    def take_file(self, path: Path) -> None:
        with self.report_failure():
            self.change(with_part_file(self.draft, path))

    def take_link(self, link: str) -> None:
        if self._robot is not None:
            self.change(with_link(self.draft, self._robot, link))

    def update_fields(self, preview: PartPreview) -> None:
        draft = preview.draft
        if not (self.file.hasFocus() and self.file.isModified()):
            self.file.setText(str(draft.urdf or draft.mesh or ""))
        if not self.part_name.hasFocus():
            self.part_name.setText(draft.name)
            self.part_name.setPlaceholderText(draft.link if draft.urdf is not None else "part")
        if not self.own_mesh.hasFocus():
            self.own_mesh.setText("" if draft.mesh is None else str(draft.mesh))
        show_choice(self.unit, draft.unit)
        has_own_unit = bool(draft.mesh and draft.unit)
        doubt = "?  If that is wrong, choose another unit." if draft.is_unit_guessed else ""
        self._list_units(preview)
        self.size_text.setText("" if preview.size_mm is None else f"{box_words(preview.size_mm)}{doubt}")
        has_mesh = preview.size_mm is not None
        self._show_rows(has_robot=draft.urdf is not None, has_mesh=has_mesh, has_unit=has_own_unit)
        self.mode = Mode.LINK if draft.urdf is not None else Mode.NONE
        if preview.robot is not self._robot:
            self._robot = preview.robot
            self._fill_tree()
        self._show_link(preview)

    def _list_units(self, preview: PartPreview) -> None:
        """Name the units, each with the size that the part has in it."""
        for index, (unit, name) in enumerate(UNIT_NAMES.items()):
            size = ""
            if preview.size_mm is not None and preview.draft.unit:
                now, other = METRES_PER_UNIT[preview.draft.unit], METRES_PER_UNIT[unit]
                size = f": {box_words(side * other / now for side in preview.size_mm)}"
            self.unit.setItemText(index, f"{name}{size}")

    def _show_rows(self, *, has_robot: bool, has_mesh: bool, has_unit: bool) -> None:
        for row in (self.tree_note, self.tree, self.frame, self.frame_note, self.mesh_row):
            self.form.setRowVisible(row, has_robot)
        missing = () if self.preview is None else self.preview.missing_packages
        self.form.setRowVisible(self.package_row, has_robot and bool(missing))
        if missing:
            self.package_label.setText(f"Pac&kage {missing[0]}")
            self.package.setPlaceholderText(f"folder of the ROS package {missing[0]}")
        self.form.setRowVisible(self.unit, has_unit)
        self.form.setRowVisible(self.size_text, has_mesh)

    def _fill_tree(self) -> None:
        """List the links with a shape, each below the nearest link above it that has one; all links if none has."""
        with QSignalBlocker(self.tree):
            self.tree.clear()
            robot = self._robot
            if robot is None:
                return
            items: dict[str, QTreeWidgetItem] = {}
            for link in sorted(robot.shapes or robot.links, key=lambda link: len(robot.path_to_root(link))):
                above = [joint.parent for joint in robot.path_to_root(link)]
                parent = next((items[each] for each in above if each in items), None)
                item = QTreeWidgetItem(self.tree if parent is None else parent, [link])
                items[link] = item
            self.tree.expandAll()

    def _show_link(self, preview: PartPreview) -> None:
        robot = preview.robot
        if robot is None:
            return
        shown = preview.mesh_link or preview.draft.link
        found = self.tree.findItems(shown, Qt.MatchFlag.MatchExactly | Qt.MatchFlag.MatchRecursive)
        with QSignalBlocker(self.tree):
            self.tree.clearSelection()
            if found and shown:
                found[0].setSelected(True)
                self.tree.setCurrentItem(found[0])
                self.tree.scrollToItem(found[0])
        frames = [preview.draft.link]
        if preview.draft.link in robot.links:
            sensor = robot.sensor_named(preview.draft.sensor, "").joint if preview.draft.sensor else ""
            frames = list(robot.fixed_frames(preview.draft.link, sensor))
        with QSignalBlocker(self.frame):
            self.frame.clear()
            self.frame.addItems(frames)

    def _choose_in_tree(self) -> None:
        chosen = self.tree.selectedItems()
        if chosen and self.preview is not None and chosen[0].text(0) != self.preview.mesh_link:
            self.take_link(chosen[0].text(0))

    def _rename(self) -> None:
        name = self.part_name.text().strip()
        if name != self.draft.name:
            self.change(replace(self.draft, name=name))


assert set(UNIT_NAMES) == set(METRES_PER_UNIT)
