"""The widget of the 3D view of a part draft: it reports clicks on links and on the part, and drags and turns of the layout."""

from __future__ import annotations

from enum import Enum
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import Qt, QTimer, Signal
from PySide6.QtGui import QCursor
from PySide6.QtWidgets import QToolTip, QWidget

from app.scene3d.canvas import Canvas
from app.scene3d.draft_state import DraftPicture
from app.scene3d.view import View3D
from skincal.geometry import FloatArray

if TYPE_CHECKING:
    from app.scene3d.draft_renderer import DraftRenderer

HOVER_REST_MS = 80  # The pointer rests on a link for so long until its name is shown
LAYOUT_TURN_PER_WHEEL_NOTCH_DEG = 5.0  # Turn of the layout for one notch of the wheel over it


RING_CLICKED = "That is the ring: drag it to turn the layout. To place the layout, click the part next to the ring."
CLICKED_BESIDE = "That click is not on the part: click the part itself."


def link_tooltip(name: str) -> str:
    """Return the tooltip of a link; the URDF of a stranger names it."""
    return f"<p>{escape(name)}</p>"


class Mode(Enum):
    """Meaning of a click."""

    NONE = "none"
    LINK = "link"
    POINT = "point"
    LAYOUT = "layout"
    """A click places the layout; a drag that begins on it slides it, one of the ring turns it, as does the wheel over it."""


class DraftView3D(View3D):
    """The 3D view of the page where a part is described."""

    link_picked = Signal(str)
    point_picked = Signal(object)  # (3,) float, metres, link frame: clicked point of the part
    drag_started = Signal(int, object)  # Index of the module under the pointer, and the point (3,) there
    layout_dragged = Signal(object)  # (3,) float, metres, link frame: the point of the part under the pointer
    layout_turned = Signal(float)  # Degrees, counter-clockwise seen from outside
    missed = Signal(str)  # Why a click did nothing, and what does
    turn_started = Signal()  # The ring around the layout was gripped; its turns follow

    def __init__(self, parent: QWidget | None = None, canvas: Canvas | None = None) -> None:
        super().__init__(parent, canvas)
        self.mode = Mode.NONE
        self._hovered = (0.0, 0.0)
        self._hover_timer = QTimer(self, singleShot=True)
        self._hover_timer.timeout.connect(self._name_link)
        self._angle: float | None = None
        """Degrees, of the pointer on the ring that is dragged; `None` if the layout is dragged."""

    @property
    def _draft_renderer(self) -> DraftRenderer | None:
        return self._renderer  # pyright: ignore[reportReturnType]

    def show_picture(self, picture: DraftPicture) -> None:
        self._state = picture
        if self.isVisible():
            self._show_state()

    def set_mode(self, mode: Mode) -> None:
        """Choose the meaning of clicks."""
        self.mode = mode
        if self._canvas is not None:
            is_point = mode in (Mode.POINT, Mode.LAYOUT)
            self._canvas.setCursor(Qt.CursorShape.CrossCursor if is_point else Qt.CursorShape.ArrowCursor)

    def hover(self, x: float, y: float) -> None:
        """Name the link under the pointer as soon as it rests: a search in all meshes takes some milliseconds."""
        if self._draft_renderer is not None and self._draft_renderer.links.is_shown:
            self._hovered = x, y
            QToolTip.hideText()
            self._hover_timer.start(HOVER_REST_MS)

    def _name_link(self) -> None:
        link = None if self._draft_renderer is None else self._draft_renderer.links.pick(*self._hovered)
        if link is not None and self._canvas is not None and self._canvas.underMouse():
            QToolTip.showText(QCursor.pos(), link_tooltip(link), self._canvas)

    def close_view(self) -> None:
        self._hover_timer.stop()
        super().close_view()

    def grip(self, x: float, y: float) -> bool:
        if self.mode is not Mode.LAYOUT:
            return False
        self._angle = self._ring_angle(x, y) if self._is_on_ring(x, y) else None
        if self._angle is not None:
            self.turn_started.emit()
            return True
        module, point = self._module_at(x, y), self._point_at(x, y)
        if module is None or point is None:
            return False
        self.drag_started.emit(module, point)
        return True

    def drag_grip(self, x: float, y: float) -> None:
        if self._angle is None:
            point = self._point_at(x, y)
            if point is not None:
                self.layout_dragged.emit(point)
            return
        angle = self._ring_angle(x, y)
        if angle is not None:
            self.layout_turned.emit((angle - self._angle + 180.0) % 360.0 - 180.0)
            self._angle = angle

    def turn_wheel(self, notches: float, x: float, y: float) -> bool:
        if self.mode is not Mode.LAYOUT or self._module_at(x, y) is None:
            return False
        self.layout_turned.emit(LAYOUT_TURN_PER_WHEEL_NOTCH_DEG * notches)
        return True

    def _point_at(self, x: float, y: float) -> FloatArray | None:
        """Return the point of the part at a pixel, (3,) float, metres; `None` next to the part."""
        return None if self._renderer is None else self._renderer.pick_surface(x + 0.5, y - 0.5)

    def _module_at(self, x: float, y: float) -> int | None:
        """Return the index of the module at a pixel; `None` if there is none."""
        point = self._point_at(x, y)
        picture: DraftPicture | None = self._state
        return None if point is None or picture is None else nearest_module(picture, point)

    def _is_on_ring(self, x: float, y: float) -> bool:
        """Whether the ring that turns the layout is at a pixel."""
        return self._draft_renderer is not None and self._draft_renderer.handle.is_at(x, y)

    @property
    def _is_proposed(self) -> bool:
        """Whether the layout is not placed yet: then a click on its ring places it, too."""
        picture: DraftPicture | None = self._state
        return picture is not None and picture.preview.proposed_anchor is not None

    def _ring_angle(self, x: float, y: float) -> float | None:
        """Return the angle of a pixel about the middle of that ring, degrees; `None` without a ring."""
        return None if self._draft_renderer is None else self._draft_renderer.handle.angle_at(x, y)

    def _mount(self, loaded: object) -> None:
        super()._mount(loaded)  # pyright: ignore[reportArgumentType]
        self.set_mode(self.mode)
        if self._canvas is not None:
            self._canvas.setMouseTracking(True)

    def pick(self, x: float, y: float) -> None:
        if self.mode is Mode.LINK:
            link = None if self._draft_renderer is None else self._draft_renderer.links.pick(x, y)
            if link is not None:
                self.link_picked.emit(link)
        elif self.mode is Mode.LAYOUT and self._is_on_ring(x, y) and not self._is_proposed:
            self.missed.emit(RING_CLICKED)
        elif self.mode in (Mode.POINT, Mode.LAYOUT):
            point = self._point_at(x, y)
            if point is not None:
                self.point_picked.emit(point)
            else:
                self.missed.emit(CLICKED_BESIDE)


def nearest_module(picture: DraftPicture, point: FloatArray) -> int | None:
    """Return the index of the module whose outline holds a point of the part, or nearly; `None` if none does."""
    laid = picture.preview.laid
    best, best_distance = None, np.inf
    for index, outline in enumerate(() if laid is None else laid.outlines):
        if len(outline) and np.isfinite(outline).all():
            middle = outline.mean(axis=0)
            distance = float(np.linalg.norm(point - middle))
            if distance <= float(np.linalg.norm(outline - middle, axis=1).max()) and distance < best_distance:
                best, best_distance = index, distance
    return best
