"""Dialog that writes the calibration: format, method and file, then the remarks of the check on it."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QCheckBox, QComboBox, QFileDialog, QLabel, QLineEdit, QPushButton, QWidget

from app.dialogs.task_dialog import TaskDialog
from app.panels.layouts import make_row
from app.panels.widgets import secondary_label
from skincal.files.formats import ExportFormat, ExportOptions, Inertia
from skincal.taxels.result import Method
from skincal.words.units import count


class ExportDialog(TaskDialog):
    """Choice of format, method and file, and the remarks on the written file."""

    write_requested = Signal(str, object, object, object)  # Format, path, method, options

    def __init__(
        self,
        methods: tuple[Method, ...],
        shown: Method,
        stem: Path,
        parent: QWidget | None = None,
        usual: ExportFormat = ExportFormat.ICUB,
    ) -> None:
        super().__init__("Export calibration", "Write file", methods, shown, parent)
        self._stem = stem
        self._named_by_hand = False
        self.format = QComboBox()
        for each in ExportFormat:
            self.format.addItem(each.title, each)
        self.about = secondary_label(wrap=True)
        self.path = QLineEdit()
        self.path.setAccessibleName("file")
        self.browse = QPushButton("Choose\N{HORIZONTAL ELLIPSIS}")
        self.remarks.setAccessibleName("remarks")
        self.prefix = QLineEdit()
        self.prefix.setPlaceholderText("the link's name and _")
        self.into = QLineEdit()
        self.into.setAccessibleName("robot")
        self.into.setPlaceholderText("none: a file of the taxels alone")
        self.choose_robot = QPushButton("Choose\N{HORIZONTAL ELLIPSIS}")
        self.inertia = QCheckBox("1 &mg for each taxel, for PyBullet and urchin")
        self._robot_row = make_row((self.into, 1), self.choose_robot)
        label = QLabel("F&ile")
        label.setBuddy(self.path)
        self.form.addRow("&Format", self.format)
        self.form.addRow("", self.about)
        self.form.addRow("&Method", self.method)
        self.form.addRow("&Prefix", self.prefix)
        self.form.addRow("Robot", self._robot_row)
        self.form.addRow("", self.inertia)
        self.form.addRow(label, make_row((self.path, 1), self.browse))
        # Space and Enter write the proposed file, then close.
        self.start.setDefault(True)
        self.start.setFocus()
        self.format.currentIndexChanged.connect(self._format_chosen)
        self.method.currentIndexChanged.connect(self._propose_name)
        self.path.textChanged.connect(self._clear_outcome)
        self.method.currentIndexChanged.connect(self._clear_outcome)
        # Only typing emits `textEdited`; `textChanged` also comes with proposed names.
        self.path.textEdited.connect(self._path_edited)
        self.browse.clicked.connect(self._browse)
        self.choose_robot.clicked.connect(self._choose_robot)
        self.prefix.textChanged.connect(self._clear_outcome)
        self.into.textChanged.connect(self._clear_outcome)
        self.inertia.toggled.connect(self._clear_outcome)
        self.start.clicked.connect(self._write)
        self.setMinimumHeight(max(map(self._height_of_format, range(self.format.count()))))
        self.format.setCurrentIndex(self.format.findData(usual))
        self._format_chosen()

    def show_written(self, sentences: tuple[str, ...]) -> None:
        """Show that the file is written, with the remarks on it."""
        found = count(len(sentences), "remark") if sentences else "no remarks"
        self.show_outcome(f"Written to {self.path.text()}: {found}.", sentences, good=True)

    def show_failure(self, sentence: str) -> None:
        self.show_outcome(sentence, good=False)
        self.path.setFocus()

    def _clear_outcome(self) -> None:
        self.outcome.setText("")
        self.remarks.hide()

    def _height_of_format(self, index: int) -> int:
        """Show a format, and return the height that its rows need: the largest keeps the buttons in their place."""
        self.format.setCurrentIndex(index)
        self._format_chosen()
        return self.column.totalHeightForWidth(self.minimumWidth())

    def _chosen(self) -> ExportFormat:
        return self.format.currentData()

    def _format_chosen(self) -> None:
        words = self._chosen()
        self.about.setText(words.description)
        self.method.setEnabled(not words.holds_all_methods)
        for feature, row in (("prefix", self.prefix), ("into", self._robot_row), ("inertia", self.inertia)):
            self.form.setRowVisible(row, feature in words.options)
        if self._named_by_hand:
            self.path.setText(str(Path(self.path.text()).with_suffix(words.suffix)))
        self._propose_name()

    def _propose_name(self) -> None:
        if not self._named_by_hand:
            method = f"-{self.method.currentText()}" if self.method.isEnabled() else ""
            self.path.setText(str(self._stem.with_name(f"{self._stem.name}{method}{self._chosen().suffix}")))

    def _path_edited(self) -> None:
        self._named_by_hand = True

    def _browse(self) -> None:
        words = self._chosen()
        path, _ = QFileDialog.getSaveFileName(self, "Export calibration", self.path.text(), f"{words.title} (*{words.suffix})")
        if path:
            self._named_by_hand = True
            self.path.setText(path)

    def _choose_robot(self) -> None:
        ending = ".sdf" if self._chosen() is ExportFormat.SDF else ".urdf"
        path, _ = QFileDialog.getOpenFileName(self, "The robot's own file", self.into.text(), f"Robot (*{ending})")
        if path:
            self.into.setText(path)

    def _options(self) -> ExportOptions:
        """Return the filled-in options that the format knows."""
        inertia = Inertia.TINY if self.inertia.isChecked() else Inertia.NONE
        into = Path(self.into.text()) if self.into.text() else None
        return ExportOptions(None, self.prefix.text() or None, inertia, into).for_format(self._chosen())

    def _write(self) -> None:
        self.begin_task("Writing \N{HORIZONTAL ELLIPSIS}")
        self.write_requested.emit(self._chosen().value, Path(self.path.text()), self.method.currentData(), self._options())
