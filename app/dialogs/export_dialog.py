"""The dialog that writes the calibration: format, method and place, then what the lint says about it."""

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
    QListWidget,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from app.panels.widgets import plain_buttons, quiet
from app.text.outcomes import METHOD_NAMES
from app.units import count
from skincal.files.formats import FORMATS, ExportFormat, FormatWords
from skincal.taxels.result import Method


class ExportDialog(QDialog):
    """Gathers what to write and shows what was found."""

    write_requested = Signal(str, object, object)
    """Format, path, method."""

    def __init__(self, methods: tuple[Method, ...], shown: Method, stem: Path, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Export calibration")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self._stem = stem
        self._named_by_hand = False
        self.format = QComboBox()
        for format_, words in FORMATS.items():
            self.format.addItem(words.title, format_)
        self.about = quiet(wrap=True)
        self.method = QComboBox()
        for method in methods:
            self.method.addItem(METHOD_NAMES[method], method)
        self.method.setCurrentIndex(self.method.findData(shown))
        self.path = QLineEdit()
        self.browse = QPushButton("Choose\N{HORIZONTAL ELLIPSIS}")
        self.outcome = quiet(wrap=True)
        self.findings = QListWidget()
        self.findings.setWordWrap(True)
        self.findings.setAccessibleName("what was found")
        self.buttons = QDialogButtonBox(QDialogButtonBox.StandardButton.Close)
        self.write = self.buttons.addButton("Write file", QDialogButtonBox.ButtonRole.ActionRole)
        self._arrange()
        self._connect()
        self._format_chosen()

    def _arrange(self) -> None:
        place = QHBoxLayout()
        place.addWidget(self.path, 1)
        place.addWidget(self.browse)
        form = QFormLayout()
        form.addRow("&Format", self.format)
        form.addRow("", self.about)
        form.addRow("&Method", self.method)
        label = QLabel("F&ile")
        label.setBuddy(self.path)
        form.addRow(label, place)
        self.path.setAccessibleName("file")
        column = QVBoxLayout(self)
        column.addLayout(form)
        column.addWidget(self.outcome)
        column.addWidget(self.findings, 1)
        column.addWidget(self.buttons)
        self.findings.hide()
        self.write.setDefault(True)
        plain_buttons(self.buttons)
        self.setMinimumWidth(560)
        # Space and Enter go on: they write what is proposed, and then close.
        self.write.setFocus()

    def _connect(self) -> None:
        self.format.currentIndexChanged.connect(self._format_chosen)
        self.method.currentIndexChanged.connect(self._name)
        self.path.textChanged.connect(self._forget)
        self.method.currentIndexChanged.connect(self._forget)
        # `textEdited` comes of the operator's hand alone, `textChanged` also of what the dialog proposes.
        self.path.textEdited.connect(self._edited)
        self.browse.clicked.connect(self._browse)
        self.write.clicked.connect(self._write)
        self.buttons.rejected.connect(self.reject)

    def show_findings(self, sentences: tuple[str, ...]) -> None:
        """Say that the file is written and what was found on the way."""
        self.write.setEnabled(True)
        found = count(len(sentences), "remark") if sentences else "nothing to remark"
        self.outcome.setText(f"\N{CHECK MARK} Written to {self.path.text()}: {found}.")
        self.findings.clear()
        self.findings.addItems(list(sentences))
        self.findings.setVisible(bool(sentences))

    def show_failure(self, sentence: str) -> None:
        """Say why there is no file."""
        self.write.setEnabled(True)
        self.outcome.setText(f"\N{BALLOT X} {sentence}")
        self.path.setFocus()

    def reject(self) -> None:
        """Close, but not before it is said what became of the file."""
        if self.write.isEnabled():
            super().reject()

    def _forget(self) -> None:
        """Take away what was said of another file."""
        self.outcome.setText("")
        self.findings.hide()

    def _chosen(self) -> ExportFormat:
        return self.format.currentData()

    def _words(self) -> FormatWords:
        return FORMATS[self._chosen()]

    def _format_chosen(self) -> None:
        words = self._words()
        self.about.setText(words.about)
        self.method.setEnabled(not words.every_method)
        if self._named_by_hand:
            self.path.setText(str(Path(self.path.text()).with_suffix(words.ending)))
        self._name()

    def _name(self) -> None:
        if not self._named_by_hand:
            method = f"-{self.method.currentText()}" if self.method.isEnabled() else ""
            self.path.setText(str(self._stem.with_name(f"{self._stem.name}{method}{self._words().ending}")))

    def _edited(self) -> None:
        self._named_by_hand = True

    def _browse(self) -> None:
        words = self._words()
        path, _ = QFileDialog.getSaveFileName(self, "Export calibration", self.path.text(), f"{words.title} (*{words.ending})")
        if path:
            self._named_by_hand = True
            self.path.setText(path)

    def _write(self) -> None:
        # The next Space or Enter closes. A button that is disabled while it has the focus would hand that on to any other.
        self.buttons.button(QDialogButtonBox.StandardButton.Close).setFocus()
        self.write.setEnabled(False)
        self.outcome.setText("Writing \N{HORIZONTAL ELLIPSIS}")
        self.write_requested.emit(self._chosen().value, Path(self.path.text()), self.method.currentData())
