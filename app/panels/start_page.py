"""The window without a session: what can be done now."""

from __future__ import annotations

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QPushButton, QWidget

from app.panels.layouts import make_column
from app.panels.widgets import secondary_label
from app.text_size import scaled
from app.theme import WIDGET_GAP_PX

START_BUTTON_WIDTH_PX = 420
BUTTON_TEXTS = {
    "part": "&Describe your own part\N{HORIZONTAL ELLIPSIS}   Ctrl+Shift+N",
    "new": "&New session\N{HORIZONTAL ELLIPSIS}   Ctrl+N",
    "open": "&Open a recorded session\N{HORIZONTAL ELLIPSIS}   Ctrl+O",
    "import": "&Import a recording\N{HORIZONTAL ELLIPSIS}   Ctrl+I",
}
"""Texts of the buttons, by the name of their command."""
PART_HINT = "A mesh or a URDF is enough to begin; you can also drop it here."


class StartPage(QWidget):
    """A line of text, and a button for each offer."""

    command_wanted = Signal(str)  # Name of a command

    def __init__(self) -> None:
        super().__init__()
        self.words, self.hint = secondary_label(), secondary_label(PART_HINT)
        for label in (self.words, self.hint):
            label.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.buttons = {name: QPushButton(text) for name, text in BUTTON_TEXTS.items()}
        for name, button in self.buttons.items():
            button.setFixedWidth(scaled(START_BUTTON_WIDTH_PX))
            button.clicked.connect(lambda _=False, name=name: self.command_wanted.emit(name))
        buttons = ((button, 0, Qt.AlignmentFlag.AlignHCenter) for button in self.buttons.values())
        self._column = make_column(1, self.words, *buttons, self.hint, 1, within=self, gap=WIDGET_GAP_PX)

    def show_words(self, words: str, *, offers: bool, part_first: bool) -> None:
        """Show a line; with `offers` the buttons, too, and the new part above the others if `part_first`."""
        self.words.setText(words)
        for widget in (*self.buttons.values(), self.hint):
            widget.setVisible(offers)
        order = ["part", "new", "open", "import"] if part_first else ["new", "open", "part", "import"]
        for index, name in enumerate(order):
            self._column.removeWidget(self.buttons[name])
            self._column.insertWidget(2 + index, self.buttons[name], 0, Qt.AlignmentFlag.AlignHCenter)
        if offers:
            self.buttons[order[0]].setFocus()
