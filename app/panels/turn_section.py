"""The turn of the selected taxel, in the Taxel tab of skins that measure three axes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QGridLayout, QLabel, QWidget

from app.panels.widgets import secondary_label
from app.theme import WIDGET_GAP_PX
from skincal.geometry import FloatArray
from skincal.words.turn_words import TURN_ROWS, turn_cells

if TYPE_CHECKING:
    from skincal.axes.session_turns import ShownTurn
    from skincal.axes.taxel_frames import FrameState


class TurnSection(QWidget):
    """Directions of the three axes of the taxel in the frame of the part, with errors and state."""

    def __init__(self) -> None:
        super().__init__()
        selectable = Qt.TextInteractionFlag.TextSelectableByMouse
        self.cells = [QLabel(wordWrap=True, textInteractionFlags=selectable) for _ in TURN_ROWS]
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setHorizontalSpacing(2 * WIDGET_GAP_PX)
        grid.setVerticalSpacing(2)
        grid.setColumnStretch(1, 1)
        for row, (name, label) in enumerate(zip(TURN_ROWS, self.cells, strict=True)):
            grid.addWidget(secondary_label(name), row, 0, Qt.AlignmentFlag.AlignTop)
            grid.addWidget(label, row, 1, Qt.AlignmentFlag.AlignTop)
        self.setWhatsThis(
            "Where the axes of the taxel's readings point, as unit vectors in the frame of the part. The errors cover noise of "
            "force and readings. They do not cover crosstalk between the axes of a taxel, which looks like a turn."
        )
        self.hide()

    def show_turn(self, turn: ShownTurn | FrameState | None, normal: FloatArray | None) -> None:
        """Show the turn of a taxel, as `turn_cells`, with the skin's outward normal there, (3,) unit; `None` while unknown."""
        for label, text in zip(self.cells, turn_cells(turn, normal), strict=True):
            label.setText(text)
        self.show()
