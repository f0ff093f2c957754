"""The map: all taxels at once, flat. The mark tells the state of a taxel, the halo its answer, the hue its module.

A cylinder in 3D always hides half of itself; the map never does. Taxels have the positions of the flat layout, turned by
quarters so that up on the map is up in the first 3D view. Without a layout the channels are in rows. A mark is hollow, a
quarter, half or wholly filled, a square when the taxel is finished, a cross if it is not used. A dot in a hollow mark is an
inferred taxel, one without a contact of its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QEvent, QPointF, QRect, QRectF, QSize, Qt, Signal
from PySide6.QtGui import (
    QBrush,
    QColor,
    QFocusEvent,
    QFont,
    QKeyEvent,
    QMouseEvent,
    QPainter,
    QPainterPath,
    QPen,
    QPolygonF,
    QResizeEvent,
    QTransform,
    QWheelEvent,
)
from PySide6.QtWidgets import (
    QComboBox,
    QFrame,
    QGraphicsItem,
    QGraphicsSimpleTextItem,
    QGraphicsView,
    QGridLayout,
    QSizePolicy,
    QStyleOptionGraphicsItem,
    QWidget,
)

from app.panels.widgets import FittedLabel, escape_tooltip, mix, secondary_label, theme_colours
from app.scene3d.camera import first_axes
from app.scene3d.scene_state import StaticScene
from app.state.policies import Mark, answer_levels, marks
from app.state.view_state import ViewState
from app.text.guidance_text import done_channels, needs_words
from app.text.mark_text import LEGEND_WORDS, MARK_WORDS
from app.text_size import scaled
from app.theme import WIDGET_GAP_PX, Colours, module_hue
from skincal.geometry import FloatArray, IntArray
from skincal.guide.guidance import Guidance
from skincal.model.scene import Scene
from skincal.model.skin import Layout
from skincal.taxels.result import Method
from skincal.words.poke_words import poke_count_words
from skincal.words.taxel_words import skin_error_words, summary_words
from skincal.words.units import ChannelNames, number

MIN_HEIGHT_OVER_WIDTH_TO_TURN_MAP = 1.25
"""Without a laid skin, a map that is this many times higher than wide is turned by a quarter."""
QUARTER_ROTATIONS = tuple(np.round([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) for a in np.arange(4) * np.pi / 2)
"""(2, 2) float each: turns to the left by none, one, two and three quarters."""
ZOOM_FACTOR_PER_STEP = 1.25  # Factor of one notch of the wheel, or key
MAX_TAXEL_MARK_RADIUS_PX = 16.0  # Largest radius of a mark when the map is enlarged
SMALL_TAXEL_MARK_RADIUS_PX = 3.0
"""Below this radius a quarter looks like a half; strength tells the state in addition to the shape."""
MARK_OPACITY = {Mark.UNSEEN: 0.35, Mark.BLIND: 0.55, Mark.INFERRED: 0.55, Mark.ROUGH: 0.75, Mark.FINISHED_INFERRED: 0.75}
"""Of a small mark."""
MARK_RADIUS_OVER_TAXEL_SPACING = 0.30
"""Radius of a mark over the distance of neighbours: marks do not touch, and an answer shows around them."""
NUMBER_HEIGHT_OVER_MODULE_HEIGHT = 0.42  # Height of a module's number over that of the module
MIN_MODULE_NUMBER_HEIGHT_PX = 9.0  # A smaller number cannot be read
MODULE_NUMBER_OPACITY = 0.35  # Share of the text's colour in it: legible where no taxel is, and not distracting
RING_SHARE, TARGET_SHARE, MIN_TARGET_PX = 1.75, 2.5, 9.0
"""Radius of the rings around the selected taxel and the target over that of a mark; pixels of the latter at least."""
MIN_AMBIGUOUS_TAXEL_WEDGE_PX = 9.0  # Size of the wedge of an ambiguous taxel at least
NAME_PX, PLATE_OPACITY = 13, 0.85  # Height of the target's name, and the opacity of its background
MAX_CLICK_DISTANCE_PX = 14.0  # A click this near to a taxel means it
KEPT_AS_PIXELS = QGraphicsItem.CacheMode.DeviceCoordinateCache
"""Of modules and marks, which change after a poke. Halos, which change at each tick, are drawn between copies of them."""
ARROW_KEYS: dict[int, tuple[float, float]] = {
    Qt.Key.Key_Left: (-1, 0),
    Qt.Key.Key_Right: (1, 0),
    Qt.Key.Key_Up: (0, 1),
    Qt.Key.Key_Down: (0, -1),
}
ZOOM_KEYS: dict[int, float] = {
    Qt.Key.Key_Plus: ZOOM_FACTOR_PER_STEP,
    Qt.Key.Key_Equal: ZOOM_FACTOR_PER_STEP,
    Qt.Key.Key_Minus: 1 / ZOOM_FACTOR_PER_STEP,
    Qt.Key.Key_0: 0.0,
}


@dataclass(frozen=True, slots=True, eq=False)
class MapLayout:
    """Positions on the map; y points up, any unit."""

    channels: IntArray
    """(n,) channels that are drawn."""
    places: FloatArray
    """(n, 2) float."""
    spacing: float
    """Usual distance of neighbours."""
    outlines: tuple[FloatArray, ...] = ()
    """(v, 2) float a module."""
    labels: tuple[str, ...] = ()
    """One a module."""

    @property
    def bounds(self) -> QRectF:
        """Rectangle around everything, with a margin."""
        points = np.concatenate([self.places, *self.outlines])
        low, high = points.min(axis=0) - self.spacing, points.max(axis=0) + self.spacing
        return QRectF(*low.tolist(), *(high - low).tolist())


def quarter_turns(static: StaticScene) -> int | None:
    """Return the quarter turns to the left of a layout in the first 3D view; `None` if it is not on the part."""
    layout, known = static.scene.skin.layout, np.flatnonzero(np.isfinite(static.places[:, 0]))
    if layout is None or len(known) < 3:
        return None
    axes = first_axes(static.extent, static.facing)
    seen = known[static.normals[known] @ axes[2] > 0.0]
    rows = known if len(seen) < 3 else seen
    flat = layout.places[static.channels[rows]]
    slopes = np.linalg.lstsq(flat - flat.mean(axis=0), static.places[rows] - static.places[rows].mean(axis=0), rcond=None)[0]
    # Directions of the layout's x and y in the picture, right and up, (2, 2): a turn resembles it if the trace of their
    # product is large.
    drawn = axes[:2] @ slopes.T
    return int(np.argmax([np.sum(quarter * drawn) for quarter in QUARTER_ROTATIONS]))


def lay_out_map(layout: Layout | None, channels: IntArray, turns: int | None = None) -> MapLayout:
    """Place the channels of a skin on a flat map.

    Parameters
    ----------
    layout : None if the scene has none; then channels are in rows, first at the top left
    channels : (n,) channels that are taxels
    turns : see `quarter_turns`
    """
    if layout is None:
        # Wider than high, as the space for the map is.
        columns = max(1, math.ceil(math.sqrt(len(channels) * 1.6)))
        row, column = np.divmod(np.arange(len(channels)), columns)
        return MapLayout(channels, np.stack([column, -row], axis=1).astype(float), 1.0)
    if turns is None:
        across, up = np.ptp(layout.places[channels], axis=0)
        turns = 3 if up > MIN_HEIGHT_OVER_WIDTH_TO_TURN_MAP * across else 0
    turn = QUARTER_ROTATIONS[turns].T
    outlines = tuple(module.outline @ turn for module in layout.modules)
    labels = tuple(str(module.id) for module in layout.modules)
    return MapLayout(channels, layout.places[channels] @ turn, layout.spacing, outlines, labels)


def mark_path(mark: Mark) -> QPainterPath:
    """Return the shape of a mark, one unit wide; it is filled, without a pen."""
    path = QPainterPath()
    if mark is Mark.DEAD:
        bar = QPainterPath()
        bar.addRect(QRectF(-0.5, -0.08, 1.0, 0.16))
        return QTransform().rotate(45).map(bar).united(QTransform().rotate(-45).map(bar))
    # Odd and even: the hole of a ring or a frame is empty, and full where the pie or the dot is.
    if mark in (Mark.FINISHED, Mark.FINISHED_INFERRED):
        path.addRect(QRectF(-0.5, -0.5, 1.0, 1.0))
        if mark is Mark.FINISHED_INFERRED:
            path.addRect(QRectF(-0.37, -0.37, 0.74, 0.74))
            path.addRect(QRectF(-0.17, -0.17, 0.34, 0.34))
        return path
    path.addEllipse(QRectF(-0.56, -0.56, 1.12, 1.12))
    if mark is not Mark.GOOD:
        inner = QRectF(-0.43, -0.43, 0.86, 0.86)
        path.addEllipse(inner)
        if mark is Mark.INFERRED:
            path.addEllipse(QRectF(-0.23, -0.23, 0.46, 0.46))
        elif mark is not Mark.UNSEEN:
            path.moveTo(0.0, 0.0)
            path.arcTo(inner, 90.0, -90.0 if mark is Mark.BLIND else -180.0)
            path.closeSubpath()
    return path


def _wedge_path() -> QPainterPath:
    path = QPainterPath()
    path.addPolygon(QPolygonF([QPointF(0.0, -0.5), QPointF(0.43, 0.25), QPointF(-0.43, 0.25), QPointF(0.0, -0.5)]))
    return path


class ModulesItem(QGraphicsItem):
    """Outlines of all modules in the hues of a theme. One item, since each costs: a body has hundreds."""

    def __init__(self, plan: MapLayout) -> None:
        super().__init__()
        self._bounds = plan.bounds
        self._hues = [module_hue(index) for index in range(len(plan.outlines))]
        self._polygons = [QPolygonF([QPointF(*corner) for corner in line.tolist()]) for line in plan.outlines]
        self._looks: dict[str, tuple[QPen, QBrush]] = {}
        """By hue."""

    def set_colours(self, colours: Colours) -> None:
        self._looks = {
            hue: (pg.mkPen(mix(hue, colours.panel, 0.45), width=1.2), QBrush(mix(colours.panel, hue, 0.07)))
            for hue in {*self._hues}
        }
        self.update()

    def boundingRect(self) -> QRectF:  # noqa: N802
        return self._bounds

    def paint(self, painter: QPainter, option: QStyleOptionGraphicsItem, widget: QWidget | None = None) -> None:  # noqa: ARG002
        for hue, polygon in zip(self._hues, self._polygons, strict=True):
            if hue in self._looks:
                pen, brush = self._looks[hue]
                painter.setPen(pen)
                painter.setBrush(brush)
                painter.drawPolygon(polygon)


class TaxelMap(pg.GraphicsView):
    """The flat map of a skin."""

    taxel_clicked = Signal(int)
    _is_made = False
    """pyqtgraph sets palette and size while it makes the widget."""

    def __init__(self, scene: Scene, channels: IntArray, names: ChannelNames, turns: int | None = None) -> None:
        super().__init__(background=None)  # pyright: ignore[reportArgumentType]
        self._plan = lay_out_map(scene.skin.layout, channels, turns)
        self._row = {int(channel): row for row, channel in enumerate(channels)}
        self._width, self._names = scene.skin.channels, names
        owners = [names.module_index(channel) for channel in channels.tolist()]
        hues = {owner: "" if owner < 0 else module_hue(owner) for owner in {*owners}}
        self._hues = [hues[owner] for owner in owners]
        """One a channel of the map; empty without a module."""
        self._zoom, self._scale, self._dragged = 1.0, 1.0, QPointF()
        """Zoom over showing all, and pixels a unit of the map."""
        self._middle = np.array(self._plan.bounds.center().toTuple())
        """(2,) float: point of the map in the middle of the widget."""
        self._marks: IntArray = np.zeros(self._width, dtype=np.int64)
        self._levels: FloatArray = np.zeros(self._width)
        self._answers: FloatArray = np.zeros(self._width)
        self._rivals: frozenset[int] = frozenset()  # Channels that fit another position nearly as well
        self._guidance: Guidance | None = None
        self._target: int | None = None
        self._selected: int | None = None
        self.generation: tuple[object, ...] = ()  # Key of the marks: they change with it alone
        self._drawn: tuple[object, IntArray] = (None, np.empty(0, dtype=np.int64))
        """Theme and radius of the marks that are drawn, and the marks, (n,)."""
        self._module_colours: Colours | None = None
        self._lettered = set[int]()
        """Modules whose number has the look of the theme."""
        self._symbols = {mark.value: mark_path(mark) for mark in Mark}
        self._module_sizes = [float(np.ptp(line, axis=0).min()) for line in self._plan.outlines]
        """Shorter side of each module's box."""
        self._modules = ModulesItem(self._plan)
        self._numbers = [QGraphicsSimpleTextItem(label, self._modules) for label in self._plan.labels]
        self._halos, self._states, self._wedges, self._rings = (pg.ScatterPlotItem(antialias=True) for _ in range(4))
        self._no_pen, self._brushes = pg.mkPen(None), dict[tuple[str, float], QBrush]()
        """Kept: pyqtgraph keeps a symbol's pixels by the objects of its pen and its brush."""
        self._name = pg.TextItem()
        self._box = pg.ViewBox(enableMouse=False, enableMenu=False, defaultPadding=0.0)
        self._box.disableAutoRange()
        for item in (self._modules, self._halos, self._states, self._wedges, self._rings, self._name):
            self._box.addItem(item, ignoreBounds=True)
        self.setCentralItem(self._box)
        self.setAntialiasing(True)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setAccessibleName("map of the taxels")
        self.setWhatsThis(
            "Every taxel at its position in the maker's flat drawing. The fill tells its state, the halo how strongly "
            "it answers now, the white ring which taxel to press next. Click a taxel to select it, or use the arrow keys. The "
            "wheel, + and - zoom, a drag moves the map, 0 shows all of it."
        )
        self._is_made = True
        self._show_range()

    def sizeHint(self) -> QSize:
        return QSize(380, 260)

    def minimumSizeHint(self) -> QSize:
        return QSize(150, 100)

    def show_state(self, state: ViewState) -> None:
        """Show states, answers and the selection of a tick; draws nothing if all are the same."""
        self._guidance = state.guidance
        generation = (state.revision, state.method, state.guidance is None)
        if generation != self.generation:
            self.generation = generation
            self._marks = marks(state.estimates, self._width, done_channels(state.guidance))
            self._rivals = frozenset(e.channel for e in state.estimates if e.rival is not None)
            self._draw_states()
        target = None if state.target is None else state.target.channel
        if (state.selected, target) != (self._selected, self._target):
            wanted = target if target != self._target else state.selected
            self._selected, self._target = state.selected, target
            self._bring_into_view(wanted)
            self._draw_rings()
        if len(state.live.skin) == self._width:
            self._answers = state.live.skin
            levels = answer_levels(state.live.skin, state.scene.contacts)
            if not np.array_equal(levels, self._levels):
                self._levels = levels
                self._draw_halos()

    def counted(self) -> tuple[IntArray, int]:
        """Return the marks of the taxels on the map, (n,), and the number of taxels with a second possible position."""
        return self._marks[self._plan.channels], len(self._rivals)

    def channel_at(self, point: QPointF) -> int | None:
        """Return the channel whose mark is nearest to a point of the widget, `None` if there is none near it."""
        if not self._row:
            return None
        away = np.linalg.norm(self._plan.places - self._map_point(point), axis=1) * self._scale
        nearest = int(np.argmin(away))
        return int(self._plan.channels[nearest]) if away[nearest] <= max(MAX_CLICK_DISTANCE_PX, 2 * self._radius()) else None

    def place_of(self, channel: int) -> QPointF:
        """Return the position of a channel, pixels of the widget."""
        x, y = (self._plan.places[self._row[channel]] - self._middle) * self._scale
        return QPointF(self.width() / 2 + x, self.height() / 2 - y)

    def tell(self, channel: int) -> str:
        """Return the state of a channel, for its tooltip."""
        state = MARK_WORDS[Mark(int(self._marks[channel]))]
        answer = number(float(self._answers[channel]), 0)
        rival = "\nanother place fits nearly as well" if channel in self._rivals else ""
        name = self._names.long(channel)
        needs = "" if self._guidance is None else needs_words(self._guidance, channel)
        return "\n".join(filter(None, (name, f"{state}{rival}", needs, f"answers {answer} above its baseline")))

    def zoom(self, factor: float, point: QPointF) -> None:
        """Zoom by a factor, up to `MAX_TAXEL_MARK_RADIUS_PX` or until all is seen; a point of the widget stays where it is."""
        largest = MAX_TAXEL_MARK_RADIUS_PX / (self._plan.spacing * MARK_RADIUS_OVER_TAXEL_SPACING * self._scale / self._zoom)
        zoom, kept = min(max(1.0, self._zoom * factor), max(1.0, largest)), self._map_point(point)
        self._middle = kept + (self._middle - kept) * self._zoom / zoom
        self._zoom = zoom
        self._set_range()

    def resizeEvent(self, ev: QResizeEvent) -> None:
        super().resizeEvent(ev)
        if self._is_made:
            self._set_range()

    def changeEvent(self, event: QEvent) -> None:
        super().changeEvent(event)
        if event.type() is QEvent.Type.PaletteChange and self._is_made:
            self._draw_all()

    def close(self) -> bool:  # pyright: ignore[reportIncompatibleMethodOverride]
        # pyqtgraph takes the viewport away here, which ends the program while the map has the focus.
        return QGraphicsView.close(self)

    def wheelEvent(self, ev: QWheelEvent) -> None:
        self.zoom(ZOOM_FACTOR_PER_STEP ** (ev.angleDelta().y() / 120.0), ev.position())
        ev.accept()

    def mousePressEvent(self, ev: QMouseEvent) -> None:
        """Select the taxel under the pointer."""
        self._dragged = ev.position()
        channel = self.channel_at(ev.position())
        if channel is not None and ev.button() is Qt.MouseButton.LeftButton:
            self.taxel_clicked.emit(channel)

    def mouseMoveEvent(self, ev: QMouseEvent) -> None:
        """Drag a zoomed map; without a button tell about the taxel under the pointer."""
        if ev.buttons() & Qt.MouseButton.LeftButton and self._zoom > 1.0:
            step = ev.position() - self._dragged
            self._middle = self._middle - np.array([step.x(), -step.y()]) / self._scale
            self._dragged = ev.position()
            self._set_range()
        elif not ev.buttons():
            channel = self.channel_at(ev.position())
            self.setToolTip("" if channel is None else escape_tooltip(self.tell(channel)))

    def mouseReleaseEvent(self, ev: QMouseEvent) -> None:
        ev.accept()

    mouseDoubleClickEvent = mouseReleaseEvent

    def keyPressEvent(self, ev: QKeyEvent) -> None:
        """Zoom, or select the next taxel in the arrow's direction."""
        there = next((c for c in (self._selected, self._target) if c in self._row), None)
        at = QPointF(self.width() / 2, self.height() / 2) if there is None else self.place_of(there)
        if ev.key() in ZOOM_KEYS:
            self.zoom(ZOOM_KEYS[ev.key()], at)
        elif ev.key() in ARROW_KEYS:
            channel = self._next_channel(np.array(ARROW_KEYS[ev.key()]))
            if channel is not None:
                self.taxel_clicked.emit(channel)
        else:
            ev.ignore()

    def drawForeground(self, painter: QPainter, rect: QRectF | QRect) -> None:  # noqa: ARG002, N802
        if self.hasFocus():
            painter.resetTransform()
            painter.setPen(QColor(theme_colours().accent))
            painter.drawRect(QRectF(self.rect()).adjusted(1.5, 0.5, -1.5, -0.5))

    def focusInEvent(self, event: QFocusEvent) -> None:
        super().focusInEvent(event)
        self.viewport().update()

    def focusOutEvent(self, event: QFocusEvent) -> None:
        super().focusOutEvent(event)
        self.viewport().update()

    def _radius(self) -> float:
        return max(1.0, self._plan.spacing * self._scale * MARK_RADIUS_OVER_TAXEL_SPACING)

    def _map_point(self, point: QPointF) -> FloatArray:
        """Return (2,) the point of the map at a point of the widget."""
        return self._middle + np.array([point.x() - self.width() / 2, self.height() / 2 - point.y()]) / self._scale

    def _set_range(self) -> None:
        self._show_range()
        for item in (self._modules, self._states):
            # Qt would shift kept pixels, by whole ones, and draw only what came into view, even if all has changed.
            item.setCacheMode(QGraphicsItem.CacheMode.NoCache)
            item.setCacheMode(KEPT_AS_PIXELS)
        self._draw_all()

    def _show_range(self) -> None:
        """Show the part of the map around `_middle`, shifted so that the map fills the widget."""
        bounds, size = self._plan.bounds, np.array([max(1, self.width()), max(1, self.height())])
        whole = np.array([bounds.width(), bounds.height()])
        self._scale = float((size / whole).min()) * self._zoom
        half = size / self._scale / 2
        room, centre = np.maximum(whole / 2 - half, 0.0), np.array(bounds.center().toTuple())
        self._middle = np.clip(self._middle, centre - room, centre + room)
        low = self._middle - half
        self._box.setRange(QRectF(*low.tolist(), *(2 * half).tolist()), padding=0.0)

    def _bring_into_view(self, channel: int | None) -> None:
        if channel in self._row and self._zoom > 1.0 and not self.rect().contains(self.place_of(channel).toPoint()):
            self._middle = self._plan.places[self._row[channel]]
            self._set_range()

    def _next_channel(self, step: FloatArray) -> int | None:
        if self._selected not in self._row:
            return int(self._plan.channels[0]) if self._row else None
        away = self._plan.places - self._plan.places[self._row[self._selected]]
        along, across = away @ step, np.abs(away @ step[::-1])
        # Sideways counts twice: an arrow keeps to its row where it can.
        cost = np.where(along > 1.0 / self._scale, along + 2.0 * across, math.inf)
        best = int(np.argmin(cost))
        return int(self._plan.channels[best]) if math.isfinite(cost[best]) else None

    def _draw_all(self) -> None:
        self._draw_modules()
        self._draw_states()
        self._draw_halos()
        self._draw_rings()

    def _draw_modules(self) -> None:
        colours = theme_colours()
        if colours is not self._module_colours:
            self._module_colours = colours
            self._paint_modules(colours)
        for index, (size, text) in enumerate(zip(self._module_sizes, self._numbers, strict=True)):
            # The number of an only module tells nothing, and would lie under all of its taxels.
            is_large = size * NUMBER_HEIGHT_OVER_MODULE_HEIGHT * self._scale >= MIN_MODULE_NUMBER_HEIGHT_PX
            is_shown = is_large and len(self._numbers) > 1
            if is_shown and index not in self._lettered:
                self._lettered.add(index)
                self._letter_module(index, colours)
            text.setVisible(is_shown)

    def _paint_modules(self, colours: Colours) -> None:
        """Give the modules the colours of a theme."""
        self.setBackgroundBrush(QColor(colours.panel))
        self._lettered.clear()
        self._modules.set_colours(colours)

    def _letter_module(self, index: int, colours: Colours) -> None:
        """Give the number of a module its font, colour, size and place. Hidden ones wait: a large skin has hundreds."""
        text, font = self._numbers[index], QFont(self.font())
        font.setBold(True)
        font.setPixelSize(40)
        text.setFont(font)
        text.setBrush(QBrush(mix(colours.panel, colours.text, MODULE_NUMBER_OPACITY)))
        scale = self._module_sizes[index] * NUMBER_HEIGHT_OVER_MODULE_HEIGHT / 40.0
        middle = text.boundingRect().center()
        # Upright, although y of the map points up.
        move = QTransform.fromTranslate(*self._plan.outlines[index].mean(axis=0).tolist())
        text.setTransform(QTransform.fromTranslate(-middle.x(), -middle.y()) * QTransform.fromScale(scale, -scale) * move)

    def _draw_states(self) -> None:
        colours, radius = theme_colours(), self._radius()
        values, look = self._marks[self._plan.channels], (colours, radius)
        before_look, before = self._drawn
        self._drawn = look, values
        if look == before_look:
            # A poke changes few marks: only these are given their pixels again.
            rows = np.flatnonzero(values != before)
            spots = cast("NDArray[np.void]", self._states.data)
            changed = spots[rows]
            changed["symbol"], changed["brush"] = self._look_of(rows.tolist(), colours, radius)
            changed["sourceRect"] = 0
            spots[rows] = changed
            self._states.updateSpots()
        else:
            symbols, brushes = self._look_of(range(len(values)), colours, radius)
            self._states.setData(pos=self._plan.places, size=2.0 * radius, pen=self._no_pen, symbol=symbols, brush=brushes)
        # A wedge at the upper right of each taxel that may as well lie elsewhere.
        rivals = self._plan.places[np.isin(self._plan.channels, list(self._rivals))] + 0.9 * radius / self._scale
        self._wedges.setData(
            pos=rivals, size=max(MIN_AMBIGUOUS_TAXEL_WEDGE_PX, 1.8 * radius), symbol=_wedge_path(),
            brush=pg.mkBrush(colours.text), pen=pg.mkPen(colours.panel, width=1.2),
        )  # fmt: skip

    def _look_of(self, rows: Sequence[int], colours: Colours, radius: float) -> tuple[list[QPainterPath], list[QBrush]]:
        """Return symbols and brushes of the marks in some rows of the map."""
        values, brushes = self._marks[self._plan.channels].tolist(), dict[tuple[int, str], QBrush]()
        keys = [(values[row], self._hues[row]) for row in rows]
        for value, hue in {*keys}:
            colour = colours.muted if value == Mark.DEAD.value else hue or colours.muted
            opacity = MARK_OPACITY.get(Mark(value), 1.0) if radius < SMALL_TAXEL_MARK_RADIUS_PX else 1.0
            brushes[value, hue] = self._brush(colour, opacity)
        return [self._symbols[value] for value, _ in keys], [brushes[key] for key in keys]

    def _brush(self, colour: str, opacity: float) -> QBrush:
        """Return the brush of a colour, the same object each time."""
        if (colour, opacity) not in self._brushes:
            shown = QColor(colour)
            shown.setAlphaF(opacity)
            self._brushes[colour, opacity] = QBrush(shown)
        return self._brushes[colour, opacity]

    def _draw_halos(self) -> None:
        levels, colour = self._levels[self._plan.channels], theme_colours().text
        rows = np.flatnonzero(levels > 0)
        brushes = [self._brush(colour, 0.15 + 0.75 * level) for level in levels[rows].tolist()]
        size = 2.0 * self._radius() * (1.3 + 0.5 * levels[rows])
        self._halos.setData(pos=self._plan.places[rows], size=size, pen=self._no_pen, brush=brushes)

    def _draw_rings(self) -> None:
        """Draw rings around the selected taxel and, white in black, the target, and write the target's name."""
        colours, radius = theme_colours(), self._radius()
        rings: list[tuple[int, float, QPen]] = []
        if self._selected in self._row:
            pens = pg.mkPen(colours.panel, width=4.0), pg.mkPen(colours.text, width=2.0)
            rings += [(self._row[self._selected], RING_SHARE * radius, pen) for pen in pens]
        reach = max(MIN_TARGET_PX, TARGET_SHARE * radius)
        is_shown = self._target is not None and self._target in self._row
        if self._target is not None and is_shown:
            pens = pg.mkPen("k", width=6.5), pg.mkPen("w", width=2.5)
            rings += [(self._row[self._target], reach, pen) for pen in pens]
        places = self._plan.places[[row for row, _, _ in rings]]
        self._rings.setData(pos=places, size=[2 * r for _, r, _ in rings], pen=[pen for _, _, pen in rings], brush=None)
        self._name.setVisible(is_shown)
        if is_shown and self._target is not None:
            font, plate = QFont(self.font()), QColor(colours.panel)
            font.setBold(True)
            font.setPixelSize(scaled(NAME_PX))
            plate.setAlphaF(PLATE_OPACITY)
            self._name.setFont(font)
            self._name.setText(self._names.short(self._target), color=colours.text)
            self._name.fill = pg.mkBrush(plate)
            width, away = self._name.textItem.boundingRect().width(), reach + 5.0
            # Right of the ring, or left where the map ends.
            is_right = self.place_of(self._target).x() + away + width <= self.width()
            self._name.setAnchor((-away / width if is_right else 1.0 + away / width, 0.5))
            self._name.setPos(*places[-1].tolist())


def legend_words(marks_of_taxels: IntArray, rivals: int) -> list[tuple[str, str]]:
    """Return symbol and words of each mark with its count."""
    counted = np.bincount(marks_of_taxels, minlength=len(Mark))
    words = [(LEGEND_WORDS[mark][0], f"{LEGEND_WORDS[mark][1]} {counted[mark.value]}") for mark in Mark]
    shown = [entry for mark, entry in zip(Mark, words, strict=True) if counted[mark.value]]
    return shown + ([("\N{BLACK UP-POINTING TRIANGLE}", f"ambiguous {rivals}")] if rivals else [])


class MapCard(QFrame):
    """The map, with summary and method above and the legend below."""

    def __init__(self, parent: QWidget | None, made: TaxelMap, methods: Sequence[Method]) -> None:
        super().__init__(parent)
        self.setObjectName("card")
        self.map, self.legend = made, secondary_label(wrap=True)
        self.legend.setTextFormat(Qt.TextFormat.PlainText)
        self.legend.setAccessibleName("legend of the map")
        self.progress, self.errors, self.methods = FittedLabel(), secondary_label(wrap=True), QComboBox()
        self.pokes = secondary_label(wrap=True)
        self.wrapped = (self.pokes, self.errors, self.legend)
        for method in methods:
            self.methods.addItem(method.value.capitalize() + " method", method)
        self.methods.setVisible(len(methods) > 1)
        self.methods.setToolTip("Method whose estimates are shown and whose needs the guide follows (V)")
        self.methods.setAccessibleName("method")
        self.methods.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        grid = QGridLayout(self)
        grid.setContentsMargins(WIDGET_GAP_PX + 4, WIDGET_GAP_PX // 2, WIDGET_GAP_PX // 2, 1)
        grid.setVerticalSpacing(0)
        grid.addWidget(self.progress, 0, 0, 1, 2)
        grid.addWidget(self.pokes, 1, 0, 1, 2)
        grid.addWidget(self.errors, 2, 0)
        grid.addWidget(self.methods, 2, 1)
        grid.addWidget(self.map, 3, 0, 1, 2)
        grid.addWidget(self.legend, 4, 0, 1, 2)
        grid.setRowStretch(3, 1)
        grid.setColumnStretch(0, 1)

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Leave the texts the lines that they need at another width."""
        for text in self.wrapped:
            text.setMinimumHeight(0)
        super().resizeEvent(event)

    def show_state(self, state: ViewState, *, is_changed: bool) -> None:
        """Show a tick; `is_changed` if the estimates may have changed."""
        before = self.map.generation
        self.map.show_state(state)
        if self.map.generation != before:
            entries = legend_words(*self.map.counted())
            # A line breaks between entries alone.
            texts = (f"{symbol} {words}".replace(" ", "\N{NO-BREAK SPACE}") for symbol, words in entries)
            self.legend.setText("   ".join(texts))
            self.legend.setAccessibleDescription(", ".join(words for _, words in entries))
        if is_changed:
            self.progress.setText(summary_words(state.estimates))
            self.pokes.setText(poke_count_words(state.snapshot.poke_counts))
            self.errors.setText(skin_error_words(state.estimates, state.snapshot.part_size))
            self.methods.setCurrentIndex(self.methods.findData(state.method))
        if is_changed or self.map.generation != before:
            # The map keeps its place when a line goes.
            for text in self.wrapped:
                text.setMinimumHeight(max(text.heightForWidth(text.width()), text.minimumHeight()))
