"""The dialog for a new session: which scene, which devices, which folder."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QComboBox,
    QDialog,
    QDialogButtonBox,
    QFileDialog,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from app.panels.widgets import plain_buttons, quiet
from app.session.opening import Addresses, OpenRequest, check_addresses, server_command
from skincal.model.errors import InputError
from skincal.model.scene import load_scene, resource

ADDRESS_HINT = "/dev/ttyUSB0@460800, COM3, socket://host:port or a file"


def shipped_scenes() -> list[tuple[str, Path]]:
    """Return name and file of every scene that ships with skincal."""
    try:
        folder = resource("scenes")
    except InputError:
        return []
    return [(path.parent.name, path) for path in sorted(folder.glob("*/scene.toml"))]


class NewSessionDialog(QDialog):
    """Gathers an `OpenRequest` and checks it before it is emitted."""

    request_chosen = Signal(object)

    def __init__(self, scene: Path | None, folder: Path, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("New session")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.scene = QComboBox()
        self.scene.setEditable(True)
        for name, path in shipped_scenes():
            self.scene.addItem(name, str(path))
        if scene is not None:
            index = self.scene.findData(str(scene))
            self.scene.setCurrentIndex(index) if index >= 0 else self.scene.setEditText(str(scene))
        self.browse_scene = QPushButton("Choose\N{HORIZONTAL ELLIPSIS}")
        self.fields = {name: QLineEdit() for name in ("wrench", "skin", "joints")}
        self.folder = QLineEdit(str(folder))
        self.browse_folder = QPushButton("Choose\N{HORIZONTAL ELLIPSIS}")
        self.objection = QLabel()
        self.objection.setWordWrap(True)
        buttons = QDialogButtonBox.StandardButton
        self.buttons = QDialogButtonBox(buttons.Ok | buttons.Cancel)
        self._arrange()
        self.browse_scene.clicked.connect(self._choose_scene)
        self.browse_folder.clicked.connect(self._choose_folder)
        self.buttons.accepted.connect(self._try)
        self.buttons.rejected.connect(self.reject)

    def _arrange(self) -> None:
        form = QFormLayout()
        _add_row(form, "&Scene", self.scene, self.browse_scene)
        for name, field in self.fields.items():
            field.setPlaceholderText(ADDRESS_HINT if name != "joints" else "only where the arm's joints are streamed")
            form.addRow(f"&{name.capitalize()}", field)
        _add_row(form, "&Folder", self.folder, self.browse_folder)
        self.buttons.button(QDialogButtonBox.StandardButton.Ok).setText("Start")
        plain_buttons(self.buttons)
        column = QVBoxLayout(self)
        column.addLayout(form)
        column.addWidget(
            quiet("Without any device a simulated rig is poked, and recorded to the folder like any other.", wrap=True)
        )
        column.addWidget(self.objection)
        column.addWidget(self.buttons)
        self.setMinimumWidth(560)
        self.buttons.button(QDialogButtonBox.StandardButton.Ok).setFocus()

    def request(self) -> OpenRequest:
        """Return what was chosen.

        Raises
        ------
        InputError
            The scene cannot be used, or one of the two devices that a poke needs is missing.
        """
        # Not the box's index, which stays as it was when another text is typed.
        index = self.scene.findText(self.scene.currentText())
        scene = Path(self.scene.itemData(index) if index >= 0 else self.scene.currentText())
        load_scene(scene)
        given = Addresses(*(self.fields[name].text().strip() for name in ("wrench", "skin", "joints")))
        check_addresses(given)
        return OpenRequest(scene=scene, addresses=given, server=server_command(scene), folder=Path(self.folder.text()))

    def _try(self) -> None:
        try:
            request = self.request()
        except InputError as error:
            self.objection.setText(f"\N{BALLOT X} {error}")
            return
        self.request_chosen.emit(request)
        self.accept()

    def _choose_scene(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Scene", self.scene.currentText(), "Scene (*.toml)")
        if path:
            self.scene.setEditText(path)

    def _choose_folder(self) -> None:
        path = QFileDialog.getExistingDirectory(self, "Folder of the new session", str(Path(self.folder.text()).parent))
        if path:
            self.folder.setText(path)


def _add_row(form: QFormLayout, text: str, field: QWidget, button: QPushButton) -> None:
    label = QLabel(text)
    label.setBuddy(field)
    row = QHBoxLayout()
    row.addWidget(field, 1)
    row.addWidget(button)
    form.addRow(label, row)
