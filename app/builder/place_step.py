"""Step 5: the layout on the part: a click places it, a drag slides it, the wheel turns it; one module can move alone."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from PySide6.QtCore import QSignalBlocker
from PySide6.QtWidgets import QGridLayout, QWidget

from app.builder.fields import VectorField, button, row_of, set_silently
from app.builder.step import Step
from app.dialogs.form_widgets import number_field
from app.panels.layouts import make_form
from app.panels.widgets import compact_combo, escape_tooltip, secondary_label
from app.scene3d.draft_state import TurnHandle
from app.scene3d.draft_view import Mode
from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.skin import Anchor
from skincal.part.draft_preview import PartPreview
from skincal.part.layout_placing import (
    anchor_at,
    anchor_of_module,
    nudged_anchor,
    turn_of,
    turned_anchor,
    with_module_anchor,
)
from skincal.part.part_draft import AnchorDraft, PartDraft

WHOLE_LAYOUT = -1  # Data of the entry for the whole layout
TURNS_DEG = (-15.0, -1.0, 1.0, 15.0)
ARROW_BUTTON_STEP_MM = 2.0
TURN_RING_RADIUS_OVER_LAYOUT = 1.15  # Radius of the ring that turns the layout, over that of the layout
ARROW_BUTTONS = (("\N{LEFTWARDS ARROW}", -1, 0, 1, 0), ("\N{RIGHTWARDS ARROW}", 1, 0, 1, 2), ("\N{UPWARDS ARROW}", 0, 1, 0, 1),
          ("\N{DOWNWARDS ARROW}", 0, -1, 2, 1))  # fmt: skip
"""Sign, step along the layout's x and y, row and column of the button."""


ANGLE_HELP = (
    "0: upright, the layout's x axis is level and its y axis as near to the link's z axis as the part allows. "
    "Counter-clockwise seen from outside."
)
NOT_ON_PART = "First click the part where the layout lies."
TYPED_POINT_MIN_DISTANCE_MM = 0.05
"""mm. A typed point nearer to the mesh is on it."""


def typed_point_words(typed: FloatArray, taken: FloatArray) -> str:
    """Give the distance of a typed point from the mesh, and the point that is used, both (3,) mm."""
    distance = float(np.linalg.norm(typed - taken))
    if distance < TYPED_POINT_MIN_DISTANCE_MM:
        return "This point is on the mesh."
    point = ", ".join(f"{round(value, 1) + 0.0:.1f}" for value in taken.tolist())
    return f"This point is {distance:.1f} mm from the mesh; the nearest point is used: {point} mm."


class PlaceStep(Step):
    """Position of the layout."""

    name = "place"
    tab = "Place"
    title = "Place the layout"
    absent = "There is no layout to place: choose one in step 4, Skin."
    hint = (
        "Click the part where the middle of the layout lies. Drag the layout to slide it. Drag the ring around it to turn it, "
        "or turn the wheel over it. A drag elsewhere turns the view."
    )

    def __init__(self) -> None:
        super().__init__()
        self.mode = Mode.LAYOUT
        self.moved = compact_combo("what moves")
        self.moved.activated.connect(lambda _: self._choose_moved())
        self.point = VectorField("position on the part")
        self.point.edited.connect(self._take_typed)
        self.step = number_field("step of the arrows", " mm", 1000.0)
        self.step.setMinimum(0.1)
        self.step.setValue(ARROW_BUTTON_STEP_MM)
        self.turns = [
            button(f"{angle:+g}\N{DEGREE SIGN}", f"turn by {angle:g} degrees", partial(self.turn, angle)) for angle in TURNS_DEG
        ]
        pad = QWidget()
        grid = QGridLayout(pad)
        grid.setContentsMargins(0, 0, 0, 0)
        self.arrows = [
            button(sign, f"slide along the layout's {'x' if x else 'y'} axis, {x + y:+d}") for sign, x, y, _, _ in ARROW_BUTTONS
        ]
        for each, (_, x, y, row, column) in zip(self.arrows, ARROW_BUTTONS, strict=True):
            each.setAutoRepeat(True)
            each.clicked.connect(lambda _=False, x=x, y=y: self.nudge(x * self.step.value(), y * self.step.value()))
            grid.addWidget(each, row, column)
        self.back = button("Let this module &follow the layout again", run=self._let_follow)
        self.angle = number_field("turn of the layout", "\N{DEGREE SIGN}", 180.0)
        self.angle.setWrapping(True)
        self.angle.setToolTip(escape_tooltip(ANGLE_HELP))
        self.angle.valueChanged.connect(self._turn_to)
        turns = ("T&urn", self.angle), ("by", row_of(*self.turns))
        self.note = secondary_label(wrap=True)
        self.note.setAccessibleName("note on the position")
        slides = ("Slide by", row_of(self.step)), ("", row_of(pad))
        self.fill(make_form(("&Move", self.moved), ("Pos&ition", self.point), self.note, *turns, *slides, self.back))
        self._grip: FloatArray | None = None  # From the anchor's point to the point where a drag began, (3,) metres
        self._drag = 0
        self._typed: tuple[PartDraft, FloatArray, Anchor | None] | None = None
        """The draft after a position was typed, that position, (3,) mm, and the anchor before."""
        self._newest: tuple[PartDraft, int | None, Anchor] | None = None
        """The draft of the last move, what moved, and its anchor: the preview of that draft comes later."""

    def applies(self, preview: PartPreview) -> bool:
        return bool(preview.draft.layout_text)

    def update_fields(self, preview: PartPreview) -> None:
        layout = preview.layout
        names = [] if layout is None else [module.id for module in layout.modules]
        has_whole = layout is None or any(module.anchor is None for module in layout.modules)
        if self.module is None or self.module >= len(names):
            self.module = None if has_whole else 0
        with QSignalBlocker(self.moved):
            self.moved.clear()
            if has_whole:
                self.moved.addItem("the whole layout", WHOLE_LAYOUT)
            for index, name in enumerate(names if len(names) > 1 else []):
                self.moved.addItem(f"module {name} alone", index)
            self.moved.setCurrentIndex(self.moved.findData(WHOLE_LAYOUT if self.module is None else self.module))
        anchor = self._anchor()
        self._show_point(preview, anchor)
        set_silently(self.angle, 0.0 if anchor is None else turn_of(anchor))
        for widget in (*self.turns, *self.arrows, self.angle):
            widget.setEnabled(anchor is not None)
            if widget is not self.angle:
                widget.setToolTip(escape_tooltip(widget.accessibleName() if anchor is not None else NOT_ON_PART))
        is_alone = layout is not None and self.module is not None and layout.modules[self.module].anchor is not None
        self.back.setVisible(is_alone and self.draft.anchor is not None)

    def _show_point(self, preview: PartPreview, anchor: Anchor | None) -> None:
        """Show the position; one that was typed stays, with its distance to the mesh."""
        typed = None if self._typed is None or self._typed[0] is not self.draft else self._typed[1]
        self.note.setText("")
        if anchor is None:
            self.point.show_value(np.zeros(3))
        elif typed is None:
            self.point.show_value(anchor.point * 1e3)
        else:
            self.point.show_value(typed)
            if preview.surface is not None:
                self.note.setText(typed_point_words(typed, anchor.point * 1e3))

    def show_missed(self, words: str) -> None:
        """Explain a click that placed nothing."""
        self.note.setText(words)

    def _turn_to(self, degrees: float) -> None:
        anchor = self._anchor()
        if anchor is not None:
            self._move_to(turned_anchor(anchor, degrees - turn_of(anchor)), "turn to")

    def _take_typed(self, millimetres: tuple[float, float, float]) -> None:
        """Place the layout at the point of the mesh that is nearest to a typed one."""
        preview, typed = self.preview, np.array(millimetres)
        if preview is None or preview.layout is None:
            return
        # A number after another one starts where the layout was before both.
        is_next = self._typed is not None and self._typed[0] is self.draft
        before = self._typed[2] if self._typed is not None and is_next else self._anchor()
        self._move_to(anchor_at(preview.surface, preview.layout, typed * 1e-3, before), "typed")
        self._typed = self.draft, typed, before
        self._show_point(preview, self._anchor())

    def _choose_moved(self) -> None:
        index = int(self.moved.currentData())
        self.module = None if index == WHOLE_LAYOUT else index
        if self.preview is not None:
            self.update_fields(self.preview)
        self.picture_changed.emit()

    def _anchor(self) -> Anchor | None:
        """Anchor of what moves; `None` if it is not on the part."""
        preview = self.preview
        if preview is None or preview.layout is None:
            return None
        if self._newest is not None and self._newest[0] is self.draft and self._newest[1] == self.module:
            return self._newest[2]
        whole = preview.proposed_anchor if self.draft.anchor is None else self.draft.anchor.anchor()
        if self.module is None:
            return whole
        try:
            return anchor_of_module(preview.surface, preview.layout.modules[self.module], whole)
        except InputError:
            return None

    def _move_to(self, anchor: Anchor, merge: str) -> None:
        preview = self.preview
        assert preview is not None
        assert preview.layout is not None
        draft = AnchorDraft.from_anchor(anchor)
        if self.module is None:
            self.change(replace(self.draft, anchor=draft), merge and f"place {merge}")
            self._newest = self.draft, None, anchor
            return
        id_ = preview.layout.modules[self.module].id
        with self.report_failure():
            text = with_module_anchor(self.draft.layout_text, id_, draft)
            self.change(replace(self.draft, layout_text=text), merge and f"place {id_} {merge}")
            self._newest = self.draft, self.module, anchor

    def take_point(self, point: FloatArray) -> None:
        preview = self.preview
        if preview is None or preview.layout is None:
            return
        self._move_to(anchor_at(preview.surface, preview.layout, point, self._anchor()), "")

    def turn_handle(self) -> TurnHandle | None:
        anchor, laid = self._anchor(), None if self.preview is None else self.preview.laid
        if anchor is None or laid is None:
            return None
        corners = np.concatenate(laid.outlines) if self.module is None else laid.outlines[self.module]
        distances = np.linalg.norm(corners - anchor.point, axis=1)
        if not np.isfinite(distances).any():
            return None
        return TurnHandle(anchor, TURN_RING_RADIUS_OVER_LAYOUT * float(np.nanmax(distances)))

    def start_turn(self) -> None:
        """Begin a drag of the ring: its turns are undone together."""
        self._drag += 1

    def turn(self, degrees: float) -> None:
        """Turn what moves, counter-clockwise seen from outside."""
        anchor = self._anchor()
        if anchor is not None:
            self._move_to(turned_anchor(anchor, degrees), f"turn {self._drag}")

    def nudge(self, x_mm: float, y_mm: float) -> None:
        """Move the layout, or the chosen module, along the layout's axes."""
        anchor = self._anchor()
        if anchor is None or self.preview is None:
            return
        with self.report_failure():
            self._move_to(nudged_anchor(self.preview.surface, anchor, x_mm * 1e-3, y_mm * 1e-3), "nudge")

    def start_drag(self, module: int, point: FloatArray) -> None:
        """Begin to slide at a point of the layout; if one module moves alone, it is the one there, by its index."""
        if self.module is not None and self.module != module and self.preview is not None:
            self.module = module
            self.update_fields(self.preview)
            self.picture_changed.emit()
        anchor = self._anchor()
        self._grip = None if anchor is None else point - anchor.point
        self._drag += 1

    def drag_to(self, point: FloatArray) -> None:
        """Slide the layout so that the point where the drag began follows the mouse."""
        preview, anchor = self.preview, self._anchor()
        if preview is None or preview.layout is None or anchor is None or self._grip is None:
            return
        # Carried along the part, the grip would leave it: its part across the normal is kept.
        grip = self._grip - (self._grip @ anchor.normal) * anchor.normal
        self._move_to(anchor_at(preview.surface, preview.layout, point - grip, anchor), f"drag {self._drag}")

    def _let_follow(self) -> None:
        preview = self.preview
        if preview is None or preview.layout is None or self.module is None:
            return
        with self.report_failure():
            text = with_module_anchor(self.draft.layout_text, preview.layout.modules[self.module].id, None)
            self.change(replace(self.draft, layout_text=text))
