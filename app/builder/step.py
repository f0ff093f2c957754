"""What all steps of the page have in common."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import ClassVar

import numpy as np
from PySide6.QtCore import Signal
from PySide6.QtWidgets import QLabel, QLayout, QWidget

from app.builder.live_row import LiveRow
from app.panels.layouts import make_column
from app.panels.widgets import secondary_label, set_bold
from app.scene3d.draft_state import TurnHandle
from app.scene3d.draft_view import Mode
from app.theme import WIDGET_GAP_PX
from skincal.geometry import FloatArray, IntArray
from skincal.model.errors import InputError
from skincal.part.draft_preview import PartPreview
from skincal.part.part_draft import PartDraft

NO_POINTS: FloatArray = np.empty((0, 3))
STEP_TITLE_FONT_SIZE_PT = 13.0


class Step(QWidget):
    """One step: it shows the preview of the draft, and proposes changes."""

    name: ClassVar[str]
    """As in `PartPreview.problems`."""
    tab: ClassVar[str]
    title: ClassVar[str]
    hint: ClassVar[str]
    absent: ClassVar[str] = ""
    """Why the step has nothing to decide, where it does not apply."""

    changed = Signal(object, str)
    """`PartDraft`, and the kind of the change: repeated changes of one kind are undone together. Empty for a change alone."""
    angles_changed = Signal(object)  # Shown angles of joints, rad, by name
    picture_changed = Signal()  # The 3D view shows something else: points, mode, module
    failed = Signal(str)  # Sentence on what cannot be done

    def __init__(self) -> None:
        super().__init__()
        self.draft = PartDraft()  # The newest draft; `preview` may be of an earlier one
        self.preview: PartPreview | None = None
        self.mode = Mode.NONE  # Meaning of clicks in the 3D view
        self.points = NO_POINTS  # (n, 3) float, metres: picked points to mark
        self.module: int | None = None
        self.answered: IntArray | None = None
        self.hint_label = secondary_label(self.hint, wrap=True)

    def fill(self, *items: QWidget | QLayout) -> None:
        """Put the fields of the step below its title and hint."""
        head = QLabel(self.title)
        set_bold(head, STEP_TITLE_FONT_SIZE_PT)
        make_column(head, self.hint_label, *items, 1, within=self, margins=WIDGET_GAP_PX, gap=WIDGET_GAP_PX)

    def applies(self, preview: PartPreview) -> bool:  # noqa: ARG002
        """Whether the step has something to decide for this part."""
        return True

    def show_preview(self, preview: PartPreview) -> None:
        """Show a draft."""
        self.preview = preview
        self.update_fields(preview)

    def update_fields(self, preview: PartPreview) -> None:
        """Show the values of a draft in the fields, without reporting changes."""

    def turn_handle(self) -> TurnHandle | None:
        """Give the ring that turns the layout; `None` if this step turns nothing."""
        return None

    def enter(self) -> None:
        """Begin: the step is on the screen, and reads its device."""
        for row in self.findChildren(LiveRow):
            row.resume()

    def leave(self) -> None:
        """End: another step is on the screen."""
        for row in self.findChildren(LiveRow):
            row.pause()

    def take_point(self, point: FloatArray) -> None:
        """Handle a click on the part, (3,) float, metres, link frame."""

    def take_link(self, link: str) -> None:
        """Handle a click on a link of the robot."""

    def change(self, draft: PartDraft, merge: str = "") -> None:
        """Propose a change."""
        self.changed.emit(draft, merge)

    @contextmanager
    def report_failure(self) -> Iterator[None]:
        """Report an `InputError`; the rest of the block is left out."""
        try:
            yield
        except InputError as error:
            self.failed.emit(str(error))

    def end(self) -> None:
        """Release the device that the step reads."""
        for row in self.findChildren(LiveRow):
            row.stop()
