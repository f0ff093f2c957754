"""Foot pedals: press one, and it is learnt."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtGui import QHideEvent
from PySide6.QtWidgets import QDialog, QDialogButtonBox, QGridLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from app.panels.texts import plain_buttons, put, quiet
from app.pedal import PEDALS, Pedal, Pedals

ASK = "Press the pedal now. Esc leaves it as it is."


class PedalsDialog(QDialog):
    """Learns and forgets the keys of pedals; what is learnt holds at once."""

    def __init__(self, pedals: Pedals, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Pedals")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self._pedals = pedals
        self._asked: Pedal | None = None
        self.keys = {pedal.name: QLabel() for pedal in PEDALS}
        self.learn = {pedal.name: QPushButton("Learn") for pedal in PEDALS}
        self.forget = {pedal.name: QPushButton("Forget") for pedal in PEDALS}
        self.outcome = quiet(wrap=True)
        self.buttons = QDialogButtonBox(QDialogButtonBox.StandardButton.Close)
        self.buttons.rejected.connect(self.reject)
        self._arrange()
        self._show_keys()
        self.learn["space"].setFocus()

    def _arrange(self) -> None:
        grid = QGridLayout()
        grid.setColumnStretch(1, 1)
        for row, pedal in enumerate(PEDALS):
            self.learn[pedal.name].setAccessibleName(f"learn the pedal for {pedal.title}")
            self.forget[pedal.name].setAccessibleName(f"forget the pedal for {pedal.title}")
            self.learn[pedal.name].clicked.connect(lambda _=False, pedal=pedal: self._ask(pedal))
            self.forget[pedal.name].clicked.connect(lambda _=False, pedal=pedal: self._forget(pedal))
            widgets = (QLabel(f"<b>{pedal.title}</b>"), quiet(pedal.what), self.keys[pedal.name])
            for column, widget in enumerate((*widgets, self.learn[pedal.name], self.forget[pedal.name])):
                grid.addWidget(widget, row, column)
        plain_buttons(self.buttons)
        column = QVBoxLayout(self)
        column.addWidget(quiet("A foot pedal is a keyboard of one key. It may have any key that means nothing yet.", wrap=True))
        column.addLayout(grid)
        column.addWidget(self.outcome)
        column.addWidget(self.buttons)
        self.setMinimumWidth(640)

    def _ask(self, pedal: Pedal) -> None:
        self._asked = pedal
        self._pedals.listen(self._take)
        put(self.outcome, f"{pedal.title}: {ASK}")
        self._show_keys()

    def _take(self, key: str) -> None:
        """Take the key that was pressed; one that cannot be learnt is said, and the next one is waited for."""
        pedal = self._asked
        if pedal is None:
            return
        refused = "" if key == "Esc" else self._pedals.learn(pedal.name, key)
        if refused:
            put(self.outcome, f"\N{BALLOT X} {refused}")
            return
        self._end()
        put(self.outcome, "" if key == "Esc" else f"\N{CHECK MARK} {key} is the pedal for {pedal.title}.")
        self.buttons.button(QDialogButtonBox.StandardButton.Close).setFocus()

    def _forget(self, pedal: Pedal) -> None:
        self._end()
        self._pedals.forget(pedal.name)
        put(self.outcome, f"{pedal.title} has no pedal any more.")
        self.learn[pedal.name].setFocus()
        self._show_keys()

    def _end(self) -> None:
        self._asked = None
        self._pedals.listen(None)
        self._show_keys()

    def _show_keys(self) -> None:
        for pedal in PEDALS:
            key = self._pedals.keys.get(pedal.name, "")
            put(self.keys[pedal.name], "\N{HORIZONTAL ELLIPSIS}" if pedal is self._asked else key or "no pedal")
            self.forget[pedal.name].setEnabled(bool(key))

    def hideEvent(self, event: QHideEvent) -> None:
        """Listen no more, however the dialog is left."""
        self._pedals.listen(None)
        super().hideEvent(event)
