"""Fields of the page: numbers with units, three coordinates, choices. A field reports edits of the operator only."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

from PySide6.QtCore import QObject, QSignalBlocker, Signal
from PySide6.QtWidgets import (
    QAbstractSpinBox,
    QComboBox,
    QDoubleSpinBox,
    QHBoxLayout,
    QLineEdit,
    QPushButton,
    QSpinBox,
    QWidget,
)

from app.dialogs.form_widgets import number_field
from app.panels.layouts import make_row
from app.panels.widgets import compact_combo, escape_tooltip
from app.theme import WIDGET_GAP_PX
from skincal.model.tables import MAX_LENGTH_M


def count_field(name: str, least: int, most: int) -> QSpinBox:
    """Make a field for a whole number."""
    box = QSpinBox()
    box.setRange(least, most)
    box.setKeyboardTracking(False)
    box.setAccessibleName(name)
    box.setMinimumHeight(QComboBox().sizeHint().height())
    return box


def set_silently(box: QDoubleSpinBox | QSpinBox, value: float) -> None:
    """Show a number without reporting it. A field that is being edited is not changed."""
    line = box.lineEdit()
    if line.isModified() and box.hasFocus():
        return
    with QSignalBlocker(box):
        if isinstance(box, QSpinBox):
            box.setValue(round(value))
        else:
            box.setValue(value)


def take_typed(field: QObject) -> None:
    """Report what is typed in a field, as if the focus left it."""
    if isinstance(field, QAbstractSpinBox) and field.lineEdit().isModified():
        field.interpretText()
        field.editingFinished.emit()
    elif isinstance(field, QLineEdit) and field.isModified():
        field.editingFinished.emit()


class VectorField(QWidget):
    """Three numbers in a row: a point in millimetres, or a direction.

    They are reported together: after Enter, an arrow key, or when the focus leaves all three.
    """

    edited = Signal(object)  # Tuple of three numbers

    def __init__(self, name: str, *, is_direction: bool = False) -> None:
        super().__init__()
        limit, suffix = (1.0, "") if is_direction else (1e3 * MAX_LENGTH_M, " mm")
        self.boxes = [number_field(f"{name}, {axis}", suffix, limit, 3 if is_direction else 2, f"{axis}  ") for axis in "xyz"]
        self.setAccessibleName(name)
        make_row(*((box, 1) for box in self.boxes), within=self, margins=0, gap=WIDGET_GAP_PX // 2)
        for box in self.boxes:
            box.setButtonSymbols(QDoubleSpinBox.ButtonSymbols.NoButtons)
            box.setMinimumWidth(1)
            box.valueChanged.connect(partial(self._on_change, box))
            box.editingFinished.connect(partial(self._report, box))
        self._is_changed = False
        # Without a policy of its own the key of a label would not reach the proxy.
        self.setFocusPolicy(self.boxes[0].focusPolicy())
        self.setFocusProxy(self.boxes[0])

    def _on_change(self, box: QDoubleSpinBox, _: float) -> None:
        self._is_changed = True
        # A typed number waits for Enter or for the end of the editing.
        if not box.hasFocus() or not box.lineEdit().isModified():
            self._report(box)

    def _report(self, box: QDoubleSpinBox) -> None:
        """Report a change in one box, unless the focus went on to another of the three."""
        if self._is_changed and not any(each.hasFocus() for each in self.boxes if each is not box):
            self._is_changed = False
            self.edited.emit(self.value())

    def value(self) -> tuple[float, float, float]:
        x, y, z = (box.value() for box in self.boxes)
        return x, y, z

    def show_value(self, values: Iterable[float]) -> None:
        """Show three numbers in the fields; no change is signalled."""
        for box, value in zip(self.boxes, values, strict=True):
            set_silently(box, float(value))


def choice(name: str, entries: Mapping[str, str] | Sequence[tuple[str, str]]) -> QComboBox:
    """Make a list of texts, each with a value as its data."""
    box = compact_combo(name)
    for value, text in dict(entries).items():
        box.addItem(text, value)
    return box


def show_choice(box: QComboBox, value: object) -> None:
    """Show the entry with a value without reporting it."""
    with QSignalBlocker(box):
        box.setCurrentIndex(box.findData(value))


def button(text: str, name: str = "", run: Callable[[], object] | None = None) -> QPushButton:
    """Make a button that calls `run`; `name` is read by screen readers where the text is a sign."""
    made = QPushButton(text, autoDefault=False)
    if run is not None:
        made.clicked.connect(lambda: run())
    if name:
        made.setAccessibleName(name)
        made.setToolTip(escape_tooltip(name))
    return made


def row_of(*widgets: QWidget) -> QHBoxLayout:
    """Make a row of widgets, side by side."""
    return make_row(*widgets, 1, gap=WIDGET_GAP_PX // 2)
