"""The map: all taxels at once, flat. Shape and fill say what is known of each, brightness what answers now, hue its module.

A cylinder in 3D always hides half of itself; the map never does. A taxel lies where the layout's own plane has it, turned by
quarters so that up on the map is up on the part as it is seen first, or in rows of channels where there is no layout. Its mark
is hollow, a quarter, half or wholly filled, a full square once it is done, a cross where it is not used.

Each kind of mark is drawn once, as a stamp, and put wherever it is needed: four thousand taxels cost a dozen milliseconds. The
marks are put again only when the estimates change; a tick draws the few taxels that answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from PySide6.QtCore import QEvent, QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import (
    QBrush,
    QColor,
    QHelpEvent,
    QKeyEvent,
    QMouseEvent,
    QPainter,
    QPen,
    QPixmap,
    QPolygonF,
    QResizeEvent,
    QWheelEvent,
)
from PySide6.QtWidgets import QComboBox, QFrame, QGridLayout, QSizePolicy, QToolTip, QWidget

from app.panels.widgets import FittedLabel, Painted, mix, plain_tip, quiet, theme_colours
from app.scene3d.camera import first_frame
from app.scene3d.scene_state import StaticScene
from app.state.policies import Mark, answer_levels, marks
from app.state.view_state import ViewState
from app.text.guidance_text import done_channels, needs_words
from app.text.outcomes import MARK_WORDS, METHOD_NAMES, error_words, pokes_words, summary_words
from app.text_size import scaled
from app.theme import GAP, HUES, Colours
from skincal.geometry import FloatArray, IntArray
from skincal.guide.guidance import Guidance
from skincal.model.scene import Scene
from skincal.model.skin import Layout
from skincal.taxels.result import Method
from skincal.words.units import ChannelNames, number

TURN_GAIN = 1.25
"""Where nobody knows how the skin lies on the part, the map is turned only if that makes it a quarter larger: a map that looks
like the drawing is worth more else."""
QUARTERS = tuple(np.round([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) for a in np.arange(4) * np.pi / 2)
"""(2, 2) float each: turns to the left by none, one, two and three quarters."""
NOTCH = 120.0
"""Qt's units of a notch of the wheel."""
NEARER = 1.25
"""Factor of one notch, or key."""
LARGEST = 16.0
"""Pixels. Radius of a mark up to which the map comes nearer."""
NAME_PX = 13
"""Pixels, height of the target's name: as tall as the window's own type, read from an arm's length."""
PLATE = 0.85
"""Opacity of what lies below it."""
SMALL = 3.0
"""Pixels. Below this radius a quarter looks like a half; strength says the state, beside the shape."""
_FILLED: dict[Mark, int] = {Mark.BLIND: 90, Mark.ROUGH: 180}
"""Degrees of the circle that are filled."""
_STRENGTH: dict[Mark, float] = {Mark.UNSEEN: 0.35, Mark.BLIND: 0.55, Mark.ROUGH: 0.75, Mark.GOOD: 1.0}
"""Of a small mark: where even a ring has no room all four are dots, and still differ."""
_HOLLOW = (Mark.UNSEEN, Mark.BLIND)
"""Small marks of taxels that have no estimate."""
LEGEND_PX = 22
"""Height of a row."""
LEGEND_MARK_PX, LEGEND_GAP_PX = 15, 11
"""Pixels from a mark's left to its words, and from these to the next mark."""
BESIDE_PX = 200
"""Width of what is said beside the map: the predicted error stands in two lines."""
BESIDE_GAIN = 1.1
"""How much larger it makes the map at least."""
MARGIN_PX = 6
SHARE_OF_SPACING = 0.30
"""Radius of a mark in spacings: neighbours do not touch, and an answer shows around it."""
NUMBER_SHARE = 0.42
"""Height of a module's number in heights of the module."""
NUMBER_INK = 0.35
"""Share of the text's colour in it: read where no taxel is, and in nobody's way."""
NUMBER_LEAST = 9
"""Pixels. A smaller number cannot be read and is left out."""
WEDGE_SHARE, WEDGE_LEAST = 0.85, 4.5
"""Size of the wedge of a taxel that may lie elsewhere: in radii of a mark, and pixels at least."""
TARGET_SHARE, TARGET_LEAST = 2.5, 9.0
"""Radius of the ring around the target: in radii of a mark, and pixels at least."""
REACH_PX = 14.0
"""A click this near to a taxel means it."""

_ARROWS: dict[int, tuple[float, float]] = {
    Qt.Key.Key_Left: (-1, 0),
    Qt.Key.Key_Right: (1, 0),
    Qt.Key.Key_Up: (0, -1),
    Qt.Key.Key_Down: (0, 1),
}
_ZOOMS: dict[int, float] = {Qt.Key.Key_Plus: NEARER, Qt.Key.Key_Equal: NEARER, Qt.Key.Key_Minus: 1 / NEARER, Qt.Key.Key_0: 0.0}
_SHORT = {
    Mark.UNSEEN: "unseen",
    Mark.BLIND: "blind",
    Mark.ROUGH: "> 3 mm",
    Mark.GOOD: "to 3 mm",
    Mark.DONE: "done",
    Mark.DEAD: "unused",
}


@dataclass(frozen=True, slots=True, eq=False)
class MapPlan:
    """The map before it has a size; y points up, any unit."""

    channels: IntArray
    """(n,) channels that are drawn."""
    places: FloatArray
    """(n, 2) float."""
    spacing: float
    """Usual distance of neighbours."""
    outlines: tuple[FloatArray, ...]
    """(v, 2) float a module."""
    labels: tuple[str, ...]
    """One a module."""
    turns: int | None
    """Quarters to the left by which up becomes up on the part; None where that is not known."""

    @property
    def bounds(self) -> FloatArray:
        """(2, 2) float: lowest and highest x and y, with a margin."""
        points = np.concatenate([self.places, *self.outlines])
        return np.stack([points.min(axis=0) - self.spacing, points.max(axis=0) + self.spacing])


def turns_of(static: StaticScene) -> int | None:
    """Return by how many quarters to the left a layout is turned as its skin is seen first; None where it is not laid."""
    layout, known = static.scene.skin.layout, np.flatnonzero(np.isfinite(static.places[:, 0]))
    if layout is None or len(known) < 3:
        return None
    _, axes = first_frame(static.extent, static.facing)
    seen = known[static.normals[known] @ axes[2] > 0.0]
    rows = known if len(seen) < 3 else seen
    flat = layout.places[static.channels[rows]]
    slopes = np.linalg.lstsq(flat - flat.mean(axis=0), static.places[rows] - static.places[rows].mean(axis=0), rcond=None)[0]
    # How x and y of the layout run in the picture: right and up, (2, 2), which a turn resembles as its trace with it is large.
    drawn = axes[:2] @ slopes.T
    return int(np.argmax([np.sum(quarter * drawn) for quarter in QUARTERS]))


def plan_map(layout: Layout | None, channels: IntArray, turns: int | None = None) -> MapPlan:
    """Place the channels of a skin on a flat map.

    Parameters
    ----------
    layout : None where the scene has none; then channels stand in rows, first at the top left
    channels : (n,) channels that are taxels
    turns : see `MapPlan`; without a layout there are none
    """
    if layout is None:
        # Wider than high, as is the place of the map.
        columns = max(1, math.ceil(math.sqrt(len(channels) * 1.6)))
        row, column = np.divmod(np.arange(len(channels)), columns)
        return MapPlan(channels, np.stack([column, -row], axis=1).astype(float), 1.0, (), (), 0)
    return MapPlan(
        channels=channels,
        places=layout.places[channels],
        spacing=layout.spacing,
        outlines=tuple(module.outline for module in layout.modules),
        labels=tuple(str(module.id) for module in layout.modules),
        turns=turns,
    )


@dataclass(frozen=True, slots=True)
class Fit:
    """From the plan to pixels: quarters to the left, one scale for both axes, y down."""

    scale: float = 1.0
    shift: tuple[float, float] = (0.0, 0.0)
    turns: int = 0

    def pixels(self, points: FloatArray) -> FloatArray:
        """Return (n, 2) pixels of (n, 2) points of the plan."""
        return points @ QUARTERS[self.turns].T * (self.scale, -self.scale) + self.shift

    def points(self, pixels: FloatArray) -> FloatArray:
        """Return (n, 2) points of the plan of (n, 2) pixels."""
        return (pixels - self.shift) / (self.scale, -self.scale) @ QUARTERS[self.turns]


def fit(plan: MapPlan, room: QRectF) -> Fit:
    """Return how a plan fills a room, in the middle and with its proportions kept."""
    low, high = plan.bounds
    across, up = np.maximum(high - low, 1e-9)
    plain = min(room.width() / across, room.height() / up)
    turned = min(room.width() / up, room.height() / across)
    turns = plan.turns
    if turns is None:
        turns = 3 if turned > TURN_GAIN * plain else 0
    return centred(Fit(turned if turns % 2 else plain, turns=turns), (low + high) / 2, room)


def centred(made: Fit, middle: FloatArray, room: QRectF) -> Fit:
    """Return a fit moved such that a point of the plan, (2,), is in the middle of a room."""
    x, y = replace(made, shift=(0.0, 0.0)).pixels(middle[None])[0].tolist()
    return replace(made, shift=(room.center().x() - x, room.center().y() - y))


def nearer(plan: MapPlan, room: QRectF, zoom: float, middle: FloatArray) -> Fit:
    """Return a fit `zoom` times as large, with a point of the plan, (2,), as near to the middle as leaves no room empty."""
    whole = fit(plan, room)
    made = centred(replace(whole, scale=whole.scale * zoom), middle, room)
    ends = made.pixels(plan.bounds)
    low, high = ends.min(axis=0), ends.max(axis=0)
    start, end = np.array([room.left(), room.top()]), np.array([room.right(), room.bottom()])
    # Where it is smaller than the room it stands in the middle.
    aside = np.where(high - low < end - start, (start + end - low - high) / 2, np.clip(0.0, end - high, start - low))
    return replace(made, shift=(made.shift[0] + float(aside[0]), made.shift[1] + float(aside[1])))


def draw_mark(painter: QPainter, centre: QPointF, radius: float, mark: Mark, hue: QColor, crossed: QColor) -> None:
    """Draw one taxel; below `SMALL` there is no room for quarters and halves: a ring or a dot has the strength of its state."""
    # On whole pixels, or a small square's corners are as soft as a dot's.
    reach = radius if radius >= SMALL else float(max(1, round(radius)))
    circle = QRectF(centre.x() - reach, centre.y() - reach, 2 * reach, 2 * reach)
    if mark is Mark.DEAD:
        arm = 0.8 * reach
        painter.setPen(QPen(crossed, max(1.0, 0.3 * arm)))
        for sign in (-1, 1):
            painter.drawLine(centre + QPointF(-arm, -sign * arm), centre + QPointF(arm, sign * arm))
    elif mark is Mark.DONE:
        painter.fillRect(circle, hue)
    elif radius < SMALL:
        _draw_dot(painter, circle, mark, hue)
    else:
        painter.setPen(QPen(hue, max(1.0, 0.26 * radius)))
        painter.setBrush(QBrush(hue) if mark is Mark.GOOD else Qt.BrushStyle.NoBrush)
        painter.drawEllipse(circle)
        if mark in _FILLED:
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(QBrush(hue))
            painter.drawPie(circle, 90 * 16, -_FILLED[mark] * 16)


def _draw_dot(painter: QPainter, circle: QRectF, mark: Mark, hue: QColor) -> None:
    colour = QColor(hue)
    colour.setAlphaF(_STRENGTH[mark])
    painter.setPen(Qt.PenStyle.NoPen)
    painter.setBrush(QBrush(colour))
    painter.drawEllipse(circle)
    if mark in _HOLLOW:
        # Cut out, not painted over: the stamp is put upon whatever lies below.
        painter.setCompositionMode(QPainter.CompositionMode.CompositionMode_Clear)
        painter.drawEllipse(circle.adjusted(1.0, 1.0, -1.0, -1.0))
        painter.setCompositionMode(QPainter.CompositionMode.CompositionMode_SourceOver)


def draw_wedge(painter: QPainter, centre: QPointF, reach: float, colour: QColor, around: QColor) -> None:
    """Draw the small triangle that says that a taxel may lie elsewhere, in a rim that sets it off from the mark below."""
    corners = [(0.0, -1.0), (0.87, 0.5), (-0.87, 0.5)]
    painter.setPen(QPen(around, 1.2))
    painter.setBrush(QBrush(colour))
    painter.drawPolygon(QPolygonF([QPointF(centre.x() + reach * x, centre.y() + reach * y) for x, y in corners]))


def blank(width: float, height: float, ratio: float) -> QPixmap:
    """Return an empty picture; in device pixels, `ratio` of them a pixel, since a dense screen would show it blurred."""
    picture = QPixmap(math.ceil(width * ratio), math.ceil(height * ratio))
    picture.setDevicePixelRatio(ratio)
    picture.fill(Qt.GlobalColor.transparent)
    return picture


def soft(picture: QPixmap) -> QPainter:
    """Return what paints into a picture, with soft edges; to be ended."""
    painter = QPainter(picture)
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    return painter


def _inside(width: int, height: int) -> QRectF:
    """Return what a map so large leaves free of its margin."""
    return QRectF(MARGIN_PX, MARGIN_PX, max(10, width - 2 * MARGIN_PX), max(10, height - 2 * MARGIN_PX))


class Stamps:
    """Marks of one size, drawn once each; `radius` in pixels, `ratio` in device pixels a pixel."""

    def __init__(self, radius: float, ratio: float, crossed: QColor) -> None:
        self._radius, self._ratio, self._crossed = radius, ratio, crossed
        self._made: dict[tuple[int, str], QPixmap] = {}
        self.reach = math.ceil(1.2 * radius) + 1.0
        """Pixels from a stamp's corner to its centre."""

    def get(self, mark: int, hue: str) -> QPixmap:
        """Return the stamp of a mark's value in a hue."""
        key = (mark, hue)
        if key not in self._made:
            stamp = self._made[key] = blank(2 * self.reach, 2 * self.reach, self._ratio)
            painter = soft(stamp)
            draw_mark(painter, QPointF(self.reach, self.reach), self._radius, Mark(mark), QColor(hue), self._crossed)
            painter.end()
        return self._made[key]


class TaxelMap(Painted):
    """The flat map of a skin."""

    taxel_clicked = Signal(int)

    def __init__(self, scene: Scene, channels: IntArray, names: ChannelNames, turns: int | None = None) -> None:
        super().__init__()
        self._plan: MapPlan = plan_map(scene.skin.layout, channels, turns)
        self._zoom, self._dragged = 1.0, QPointF()
        self._middle: FloatArray = self._plan.bounds.mean(axis=0)
        """(2,) float, of the plan: what is looked at, where the map is zoomed."""
        self._width = scene.skin.channels
        self._names = names
        owners = [names.module_index(int(channel)) for channel in channels]
        self._hues = ["" if owner < 0 else HUES[owner % len(HUES)] for owner in owners]
        """One a channel of the plan; empty where there is no module."""
        self._fit = Fit()
        self._places: FloatArray = np.zeros((len(channels), 2))
        self._marks: IntArray = np.zeros(self._width, dtype=np.int64)
        self._levels: FloatArray = np.zeros(self._width)
        self._answers: FloatArray = np.zeros(self._width)
        self._rivals: frozenset[int] = frozenset()
        """Channels that may as well lie elsewhere."""
        self._guidance: Guidance | None = None
        self._target: int | None = None
        """Channel that is to be poked next."""
        self._selected: int | None = None
        self.generation: tuple[object, ...] = ()
        """Of what the marks were made: they change with it alone."""
        self._base = self._states = QPixmap()
        self._drawn_in = theme_colours()
        """The colours of these two."""
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setAccessibleName("map of the taxels")
        self.setWhatsThis(
            "Every taxel at its place in the maker's flat drawing. The fill says what is known, the halo how strongly "
            "it answers now, the white ring which to poke next. Click one to select it, or use the arrow keys. The wheel or + "
            "and - come nearer, a drag moves the map, 0 shows all of it."
        )

    def sizeHint(self) -> QSize:
        """Return a size at which each of 84 taxels is seen."""
        return QSize(380, 260)

    def minimumSizeHint(self) -> QSize:
        """Return the size below which nothing of a forearm is told apart; it zooms where that is too small."""
        return QSize(150, 100)

    def show_state(self, state: ViewState) -> None:
        """Show states, answers and the selection of a tick; draws nothing where all are the same."""
        self._guidance = state.guidance
        generation = (state.revision, state.method, state.guidance is None)
        if generation != self.generation:
            self.generation = generation
            self._marks = marks(state.estimates, self._width, done_channels(state.guidance))
            self._rivals = frozenset(e.channel for e in state.estimates if e.rival is not None)
            # Empty: drawn again when it is painted next, and only then.
            self._states = QPixmap()
            self.update()
        target = None if state.target is None else state.target.channel
        if (state.selected, target) != (self._selected, self._target):
            wanted = target if target != self._target else state.selected
            self._selected, self._target = state.selected, target
            self._bring(wanted)
            self.update()
        if len(state.live.skin) == self._width:
            self._answers = state.live.skin
            levels = answer_levels(state.live.skin, state.scene.contacts)
            if not np.array_equal(levels, self._levels):
                self._levels = levels
                self.update()

    def counted(self) -> tuple[IntArray, int]:
        """Return the marks of the taxels that are drawn, (n,), and how many may as well lie elsewhere."""
        return self._marks[self._plan.channels], len(self._rivals)

    def channel_at(self, point: QPointF) -> int | None:
        """Return the channel whose mark is nearest to a point of the widget, None where none is near."""
        if not len(self._places):
            return None
        distance = np.hypot(self._places[:, 0] - point.x(), self._places[:, 1] - point.y())
        nearest = int(np.argmin(distance))
        return int(self._plan.channels[nearest]) if distance[nearest] <= max(REACH_PX, self._radius() * 2) else None

    def place_of(self, channel: int) -> QPointF:
        """Return where a channel is drawn, pixels of the widget."""
        row = int(np.flatnonzero(self._plan.channels == channel)[0])
        return QPointF(float(self._places[row, 0]), float(self._places[row, 1]))

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Fit the plan into the new size."""
        super().resizeEvent(event)
        self._refit()

    def scale_in(self, width: int, height: int) -> float:
        """Return pixels a unit of the plan, if the map were so large and showed all of it."""
        return fit(self._plan, _inside(width, height)).scale

    def _room(self) -> QRectF:
        return _inside(self.width(), self.height())

    def _refit(self) -> None:
        room = self._room()
        self._fit = nearer(self._plan, room, self._zoom, self._middle)
        self._middle = self._plan_at(room.center())
        self._places = self._fit.pixels(self._plan.places)
        self._base = self._states = QPixmap()
        self.update()

    def _plan_at(self, point: QPointF) -> FloatArray:
        """Return (2,) the point of the plan that is drawn at a point of the widget."""
        return self._fit.points(np.array([[point.x(), point.y()]]))[0]

    def zoom(self, factor: float, point: QPointF) -> None:
        """Come nearer by a factor, up to `LARGEST`, or go away until all is seen; a point of the widget stays where it is."""
        scale = self._plan.spacing * SHARE_OF_SPACING * self._fit.scale / self._zoom
        zoom = min(max(1.0, self._zoom * factor), max(1.0, LARGEST / scale))
        kept = self._plan_at(point)
        self._middle = kept + (self._plan_at(self._room().center()) - kept) * self._zoom / zoom
        self._zoom = zoom
        self._refit()

    def _bring(self, channel: int | None) -> None:
        """Move a zoomed map so that a channel is seen."""
        rows = np.flatnonzero(self._plan.channels == channel)
        if self._zoom > 1.0 and len(rows) and not self._room().contains(self.place_of(int(self._plan.channels[rows[0]]))):
            self._middle = self._plan.places[rows[0]]
            self._refit()

    def _looked_at(self) -> QPointF:
        """Return where keys come nearer to: the selected taxel, else the target, else the middle."""
        there = [c for c in (self._selected, self._target) if c is not None and c in self._plan.channels]
        return self.place_of(there[0]) if there else self._room().center()

    def wheelEvent(self, event: QWheelEvent) -> None:
        """Come nearer to what is under the pointer, or go away."""
        self.zoom(NEARER ** (event.angleDelta().y() / NOTCH), event.position())
        event.accept()

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        """Move a zoomed map along."""
        if event.buttons() & Qt.MouseButton.LeftButton and self._zoom > 1.0:
            self._middle = self._plan_at(self._room().center() - (event.position() - self._dragged))
            self._dragged = event.position()
            self._refit()

    def mousePressEvent(self, event: QMouseEvent) -> None:
        """Select the taxel under the pointer."""
        self.setFocus(Qt.FocusReason.MouseFocusReason)
        self._dragged = event.position()
        channel = self.channel_at(event.position())
        if channel is not None and event.button() is Qt.MouseButton.LeftButton:
            self.taxel_clicked.emit(channel)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Move the selection to the next taxel in the arrow's direction; come nearer, or go away."""
        step = _ARROWS.get(event.key())
        if event.key() in _ZOOMS:
            self.zoom(_ZOOMS[event.key()], self._looked_at())
            return
        if step is None:
            super().keyPressEvent(event)
            return
        channel = self._next(step)
        if channel is not None:
            self.taxel_clicked.emit(channel)

    def event(self, event: QEvent) -> bool:
        """Say which taxel is under the pointer."""
        if event.type() == QEvent.Type.ToolTip and isinstance(event, QHelpEvent):
            channel = self.channel_at(QPointF(event.pos()))
            QToolTip.showText(event.globalPos(), "" if channel is None else plain_tip(self.tell(channel)), self)
            return True
        return super().event(event)

    def tell(self, channel: int) -> str:
        """Return what is known of a channel, for its tooltip."""
        state = MARK_WORDS[Mark(int(self._marks[channel]))]
        answer = number(float(self._answers[channel]), 0)
        rival = "\nanother place fits nearly as well" if channel in self._rivals else ""
        name = f"{self._names.short(channel)}  ({self._names.long(channel)})"
        needs = "" if self._guidance is None else needs_words(self._guidance, channel)
        return "\n".join(filter(None, (name, f"{state}{rival}", needs, f"answers {answer} above its baseline")))

    def _radius(self) -> float:
        return max(1.0, self._plan.spacing * self._fit.scale * SHARE_OF_SPACING)

    def _next(self, step: tuple[float, float]) -> int | None:
        if self._selected is None or self._selected not in self._plan.channels:
            return int(self._plan.channels[0]) if len(self._plan.channels) else None
        start = self.place_of(self._selected)
        away = self._places - np.array([start.x(), start.y()])
        along = away @ np.array(step)
        across = np.abs(away @ np.array([-step[1], step[0]]))
        # Sideways counts twice: an arrow keeps to its row where it can.
        cost = np.where(along > 1.0, along + 2.0 * across, math.inf)
        best = int(np.argmin(cost))
        return int(self._plan.channels[best]) if math.isfinite(cost[best]) else None

    def paint(self, painter: QPainter, colours: Colours) -> None:
        """Paint the modules, the answers, the states, the selection and the target, in that order."""
        if colours is not self._drawn_in:
            self._base = self._states = QPixmap()
            self._drawn_in = colours
        if self._base.isNull():
            self._base = self._drawn(self._draw_modules, colours)
        if self._states.isNull():
            self._states = self._drawn(self._draw_states, colours)
        painter.drawPixmap(0, 0, self._base)
        self._draw_answers(painter, QColor(colours.text))
        painter.drawPixmap(0, 0, self._states)
        painter.setBrush(Qt.BrushStyle.NoBrush)
        if self._selected is not None and self._selected in self._plan.channels:
            self._ring(painter, self._selected, self._radius() * 1.75, ((4.0, colours.panel), (2.0, colours.text)))
        if self._target is not None and self._target in self._plan.channels:
            # White in black, outside the ring of a selected one.
            radius = max(TARGET_LEAST, self._radius() * TARGET_SHARE)
            self._ring(painter, self._target, radius, ((6.5, "black"), (2.5, "white")))
            self._draw_name(painter, self._target, radius, colours)
        if self.hasFocus():
            painter.setPen(QColor(colours.accent))
            painter.drawRect(QRectF(self.rect()).adjusted(1.5, 0.5, -1.5, -0.5))

    def _draw_name(self, painter: QPainter, channel: int, radius: float, colours: Colours) -> None:
        """Write a taxel's name beside its ring: right of it, or left where the map ends."""
        font = self.font()
        font.setBold(True)
        font.setPixelSize(scaled(NAME_PX))
        painter.setFont(font)
        words, at = self._names.short(channel), self.place_of(channel)
        width, height = painter.fontMetrics().horizontalAdvance(words) + 6, painter.fontMetrics().height()
        away = radius + 5.0
        left = at.x() + away if at.x() + away + width <= self.width() else at.x() - away - width
        top = min(max(0.0, at.y() - height / 2), self.height() - height)
        plate, area = QColor(colours.panel), QRectF(left, top, width, height)
        plate.setAlphaF(PLATE)
        painter.fillRect(area, plate)
        painter.setPen(QColor(colours.text))
        painter.drawText(area, Qt.AlignmentFlag.AlignCenter, words)

    def _ring(self, painter: QPainter, channel: int, radius: float, pens: Sequence[tuple[float, str]]) -> None:
        for width, colour in pens:
            painter.setPen(QPen(QColor(colour), width))
            painter.drawEllipse(self.place_of(channel), radius, radius)

    def _drawn(self, draw: Callable[[QPainter, Colours], None], colours: Colours) -> QPixmap:
        picture = blank(self.width(), self.height(), self.devicePixelRatioF())
        painter = soft(picture)
        draw(painter, colours)
        painter.end()
        return picture

    def _draw_modules(self, painter: QPainter, colours: Colours) -> None:
        panel, ink = colours.panel, mix(colours.panel, colours.text, NUMBER_INK)
        looks = [(QPen(mix(hue, panel, 0.45), 1.2), mix(panel, hue, 0.07)) for hue in HUES]
        for index, outline in enumerate(self._plan.outlines):
            pen, brush = looks[index % len(HUES)]
            corners = self._fit.pixels(outline).tolist()
            painter.setPen(pen)
            painter.setBrush(brush)
            painter.drawPolygon(QPolygonF([QPointF(x, y) for x, y in corners]))
            self._draw_number(painter, self._plan.labels[index], corners, ink)

    def _draw_number(self, painter: QPainter, text: str, corners: list[list[float]], ink: QColor) -> None:
        """Write a module's number across it, large and faint, so that it takes no place from the taxels."""
        xs, ys = zip(*corners, strict=True)
        size = min(max(xs) - min(xs), max(ys) - min(ys))
        if size * NUMBER_SHARE < NUMBER_LEAST:
            return
        font = self.font()
        font.setBold(True)
        font.setPixelSize(round(size * NUMBER_SHARE))
        painter.setFont(font)
        painter.setPen(ink)
        area = QRectF(sum(xs) / len(xs) - size, sum(ys) / len(ys) - size, 2 * size, 2 * size)
        painter.drawText(area, Qt.AlignmentFlag.AlignCenter, text)

    def _draw_answers(self, painter: QPainter, colour: QColor) -> None:
        painter.setPen(Qt.PenStyle.NoPen)
        radius = self._radius()
        levels = self._levels[self._plan.channels]
        for row in np.flatnonzero(levels > 0):
            level = float(levels[row])
            colour.setAlphaF(0.15 + 0.75 * level)
            painter.setBrush(colour)
            reach = radius * (1.3 + 0.5 * level)
            painter.drawEllipse(QPointF(float(self._places[row, 0]), float(self._places[row, 1])), reach, reach)

    def _draw_states(self, painter: QPainter, colours: Colours) -> None:
        values = self._marks[self._plan.channels].tolist()
        radius, text, panel = self._radius(), QColor(colours.text), QColor(colours.panel)
        stamps = Stamps(radius, self.devicePixelRatioF(), QColor(colours.muted))
        for value, hue, (x, y) in zip(values, self._hues, (self._places - stamps.reach).tolist(), strict=True):
            painter.drawPixmap(QPointF(x, y), stamps.get(value, hue or colours.muted))
        # A wedge at the upper right of each taxel that may as well lie elsewhere.
        away = 0.9 * radius
        for x, y in self._places[np.isin(self._plan.channels, list(self._rivals))].tolist():
            draw_wedge(painter, QPointF(x + away, y - away), max(WEDGE_LEAST, WEDGE_SHARE * radius), text, panel)


class MapLegend(Painted):
    """What the marks mean and how many there are of each, in as many rows as its width needs."""

    def __init__(self) -> None:
        super().__init__()
        self._entries: tuple[tuple[Mark | None, str], ...] = ()
        """Each mark with its words; None is the wedge."""
        policy = QSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Fixed)
        policy.setHeightForWidth(True)
        self.setSizePolicy(policy)
        self.setAccessibleName("legend of the map")

    def count(self, marks_of_taxels: IntArray, rivals: int) -> None:
        """Count marks, by their values, and taxels that may as well lie elsewhere."""
        counted = np.bincount(marks_of_taxels, minlength=len(Mark))
        entries: list[tuple[Mark | None, str]] = [
            (mark, f"{_SHORT[mark]} {counted[mark.value]}") for mark in Mark if mark is Mark.UNSEEN or counted[mark.value]
        ]
        entries += [(None, f"2 places {rivals}")] if rivals else []
        if tuple(entries) != self._entries:
            self._entries = tuple(entries)
            self.setAccessibleDescription(", ".join(words for _, words in entries))
            self.updateGeometry()
            self.update()

    def hasHeightForWidth(self) -> bool:
        """Return that it may take several rows."""
        return True

    def heightForWidth(self, width: int) -> int:
        """Return the height of all rows."""
        rows = self._laid(width)
        return scaled(LEGEND_PX) * (1 + (rows[-1][1] if rows else 0))

    def sizeHint(self) -> QSize:
        """Return the size in one row, which may be cut into several."""
        return QSize(scaled(200), self.heightForWidth(max(self.width(), scaled(200))))

    def minimumSizeHint(self) -> QSize:
        """Return a width that holds any entry."""
        return QSize(scaled(100), scaled(LEGEND_PX))

    def _laid(self, width: int) -> list[tuple[float, int]]:
        """Return where each entry begins, pixels from the left, and in which row."""
        left, row, laid = float(MARGIN_PX), 0, list[tuple[float, int]]()
        for _, words in self._entries:
            long = self.fontMetrics().horizontalAdvance(words) + scaled(LEGEND_MARK_PX)
            if left + long > width and left > MARGIN_PX:
                left, row = float(MARGIN_PX), row + 1
            laid.append((left, row))
            left += long + scaled(LEGEND_GAP_PX)
        return laid

    def paint(self, painter: QPainter, colours: Colours) -> None:
        """Paint the entries, row by row."""
        painter.setFont(self.font())
        text, muted, high = QColor(colours.text), QColor(colours.muted), scaled(LEGEND_PX)
        for (mark, words), (left, row) in zip(self._entries, self._laid(self.width()), strict=True):
            at, radius = QPointF(left + scaled(6), high * (row + 0.5)), float(scaled(5))
            if mark is None:
                draw_wedge(painter, at, radius, text, QColor(colours.panel))
            else:
                draw_mark(painter, at, radius, mark, text, text)
            painter.setPen(muted)
            area = QRectF(left + scaled(LEGEND_MARK_PX), high * row, self.width(), high)
            painter.drawText(area, Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft, words)


class MapCard(QFrame):
    """The map, with what is said of it above and below, or beside it where that leaves the map larger."""

    def __init__(self, parent: QWidget, made: TaxelMap, methods: Sequence[Method]) -> None:
        super().__init__(parent)
        self.setObjectName("card")
        self.map, self.legend = made, MapLegend()
        self.progress, self.errors, self.methods = FittedLabel(), quiet(wrap=True), QComboBox()
        for method in methods:
            self.methods.addItem(METHOD_NAMES[method].capitalize() + " method", method)
        self.methods.setVisible(len(methods) > 1)
        self.methods.setToolTip("Whose estimates are shown, and whose needs the guide follows (V)")
        self.methods.setAccessibleName("method")
        self.methods.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self._grid = QGridLayout(self)
        self._grid.setContentsMargins(GAP + 4, GAP // 2, GAP // 2, 1)
        self._grid.setVerticalSpacing(0)
        self._beside: bool | None = None
        self._arrange(beside=False)

    def show_state(self, state: ViewState, *, anew: bool) -> None:
        """Show a tick; what is said of the estimates only where it may be another."""
        before = self.map.generation
        self.map.show_state(state)
        if self.map.generation != before:
            self.legend.count(*self.map.counted())
        if anew:
            self.progress.setText(f"{summary_words(state.estimates)}, {pokes_words(state.snapshot)}")
            self.errors.setText(error_words(state.estimates))
            self.methods.setCurrentIndex(self.methods.findData(state.method))

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Put what is said of the map where it leaves the map larger."""
        super().resizeEvent(event)
        across, row = self.width(), self.progress.sizeHint().height()
        said = max(row, self.methods.sizeHint().height()) + scaled(LEGEND_PX)
        above = self.map.scale_in(across, self.height() - row - said)
        beside = self.map.scale_in(across - scaled(BESIDE_PX), self.height() - row)
        # It moves only for a map that is clearly larger, so that dragging an edge does not throw it to and fro.
        self._arrange(beside=beside > above * (1.0 if self._beside else BESIDE_GAIN))

    def _arrange(self, *, beside: bool) -> None:
        if beside is self._beside:
            return
        self._beside, grid = beside, self._grid
        grid.addWidget(self.progress, 0, 0, 1, 2)
        if beside:
            grid.addWidget(self.map, 1, 0, 4, 1)
            for row, widget in enumerate((self.errors, self.methods, self.legend), start=1):
                grid.addWidget(widget, row, 1)
        else:
            grid.addWidget(self.errors, 1, 0)
            grid.addWidget(self.methods, 1, 1)
            grid.addWidget(self.map, 2, 0, 1, 2)
            grid.addWidget(self.legend, 3, 0, 1, 2)
        for widget in (self.errors, self.methods, self.legend):
            # Beside the map they take what is given to them, so that no number changes the size of the map.
            policy = widget.sizePolicy()
            policy.setHorizontalPolicy(QSizePolicy.Policy.Ignored if beside else QSizePolicy.Policy.Preferred)
            widget.setSizePolicy(policy)
        for row, stretch in enumerate((0, 0, 0, 0, 1) if beside else (0, 0, 1, 0, 0)):
            grid.setRowStretch(row, stretch)
        grid.setColumnStretch(0, 1)
        grid.setColumnMinimumWidth(1, scaled(BESIDE_PX) if beside else 0)
