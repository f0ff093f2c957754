"""The contacts of one taxel as one looks down on it: from which sides they came, or where around it they lie.

For the free method the rim is a tilt of 45 degrees, each contact a dot where the tool's upper end stood, and tinted is where
the next contact would help most. For the surface method it is the skin around the taxel, and the middle of the contacts on it.

The panel of one taxel: its estimates by each method and its pokes; and the taxels that need pokes most.
"""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QPointF, QRectF, Qt, Signal
from PySide6.QtGui import QColor, QImage, QPainter, QPen, QPolygonF
from PySide6.QtWidgets import (
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QScrollArea,
    QVBoxLayout,
    QWidget,
)

from app.panels.top_view import AxisDiversityView, diversity_view
from app.panels.widgets import Painted, TaxelList, embolden, on_panel, put_rows, quiet, table
from app.state.policies import mark_of, worst
from app.state.view_state import ViewState
from app.text.errors_text import FULL_TRUST, MARKED_TRUST, TaxelPoke, rival_words, taxel_pokes
from app.text.guidance_text import FOLLOWS, contacts_words, diversity_words, needs_words
from app.text.outcomes import MARK_WORDS, METHOD_NAMES, find_estimate
from app.theme import GAP, Colours
from skincal.geometry import FloatArray
from skincal.guide.guidance import Guidance
from skincal.guide.progress import AxisDiversity
from skincal.taxels.result import Estimate, Method, State
from skincal.words.taxel_words import state_sentence
from skincal.words.units import DASH, ChannelNames, cell, count, direction, millimetres, number, point_mm

PLOT_PX = 152
TITLE_PT = 11
DOT_PX = 4.0
RADIUS_PX = PLOT_PX / 2 - DOT_PX - 3
DOUBT_LEAST = 0.45
"""A contact that is not believed at all is drawn in this share of the size."""
SHADE_MOST = 110
"""Opacity, 0 to 255, where the next contact would help most: dots must stand out on it."""
_PLACES = "\N{BLACK CIRCLE} its own  \N{WHITE CIRCLE} its neighbours'\n\N{MULTIPLICATION SIGN} their middle"
LEGENDS = {
    Method.FREE: "\N{BLACK CIRCLE} its own  \N{WHITE CIRCLE} its neighbours'  small: doubted\n"
    "Tinted: from there the next tells most",
    Method.SURFACE: _PLACES,
    Method.MODULES: _PLACES,
}


class AxisDiversityPlot(Painted):
    """The picture alone."""

    def __init__(self) -> None:
        super().__init__()
        self.setFixedSize(PLOT_PX, PLOT_PX)
        self._diversity: AxisDiversity | None = None
        self._view: AxisDiversityView | None = None
        self.setAccessibleName("contacts of the taxel, from above")

    def set(self, diversity: AxisDiversity, view: AxisDiversityView) -> None:
        """Show the contacts of a taxel."""
        self._diversity, self._view = diversity, view
        self.update()

    def paint(self, painter: QPainter, colours: Colours) -> None:
        """Paint the rim, what is worth most, the limit, the contacts and the next."""
        diversity, view = self._diversity, self._view
        if diversity is None or view is None:
            return
        painter.translate(PLOT_PX / 2, PLOT_PX / 2)
        self._draw_scale(painter, view, colours)
        text, ground = QColor(colours.text), QColor(colours.window)
        for place, own, trust in zip(view.dots, diversity.own.tolist(), diversity.trust.tolist(), strict=True):
            size = DOT_PX * (DOUBT_LEAST + (1.0 - DOUBT_LEAST) * trust)
            # Full for its own, a ring for its neighbours': the shape says it without a colour.
            painter.setPen(QPen(ground, 1.0) if own else QPen(text, 1.4))
            painter.setBrush(text if own else ground)
            painter.drawEllipse(self._at(place), size, size)
        if view.middle is not None and len(view.dots):
            at = self._at(view.middle)
            # The broad stroke below sets the cross off from the dots.
            for width, colour in ((5.0, colours.window), (2.2, colours.accent)):
                painter.setPen(QPen(QColor(colour), width, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
                for x in (5.0, -5.0):
                    painter.drawLine(at + QPointF(x, 5.0), at - QPointF(x, 5.0))
        if view.wanted is not None:
            self._draw_wanted(painter, self._at(view.wanted))

    def _at(self, point: FloatArray) -> QPointF:
        x, y = (RADIUS_PX * point).tolist()
        return QPointF(x, -y)

    def _draw_scale(self, painter: QPainter, view: AxisDiversityView, colours: Colours) -> None:
        middle = QPointF(0, 0)
        painter.setPen(QPen(QColor(colours.line), 1.5))
        painter.setBrush(QColor(colours.window))
        painter.drawEllipse(middle, RADIUS_PX, RADIUS_PX)
        if view.shade.any():
            area = QRectF(-RADIUS_PX, -RADIUS_PX, 2 * RADIUS_PX, 2 * RADIUS_PX)
            painter.drawImage(area, _shade(view.shade, QColor(colours.accent)))
        painter.setPen(QPen(QColor(colours.line), 1.0))
        painter.drawLine(QPointF(-RADIUS_PX, 0), QPointF(RADIUS_PX, 0))
        painter.drawLine(QPointF(0, -RADIUS_PX), QPointF(0, RADIUS_PX))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.setPen(QPen(QColor(colours.muted), 1.2, Qt.PenStyle.DashLine))
        painter.drawEllipse(middle, RADIUS_PX * view.limit, RADIUS_PX * view.limit)

    def _draw_wanted(self, painter: QPainter, at: QPointF) -> None:
        """Draw a square on its tip around the side from which the next one helps most."""
        corners = [at + QPointF(x, y) for x, y in ((0, -8), (8, 0), (0, 8), (-8, 0))]
        painter.setBrush(Qt.BrushStyle.NoBrush)
        # White within black stands out in both themes, whatever lies below.
        for width, colour in ((4.5, Qt.GlobalColor.black), (1.8, Qt.GlobalColor.white)):
            painter.setPen(QPen(colour, width))
            painter.drawPolygon(QPolygonF(corners))


def _shade(shade: FloatArray, colour: QColor) -> QImage:
    """Return the shade in one colour: contrast from the least to the most that is worth anything."""
    inside = shade[shade > 0]
    least, most = float(inside.min()), float(inside.max())
    share = np.where(shade > 0, (shade - least) / max(most - least, 1e-9), 0.0)
    pixels = np.zeros((*shade.shape, 4), dtype=np.uint8)
    pixels[..., :3] = colour.red(), colour.green(), colour.blue()
    pixels[..., 3] = np.round(SHADE_MOST * share)
    height, width = shade.shape
    # The picture keeps a copy of its own: the bytes go with this function.
    return QImage(pixels.tobytes(), width, height, 4 * width, QImage.Format.Format_RGBA8888).copy()


class AxisDiversityPanel(QWidget):
    """The picture with its words; of the target where no taxel is selected."""

    def __init__(self, names: ChannelNames) -> None:
        super().__init__()
        self._names = names
        self._key: tuple[object, ...] = ()
        self._guidance: Guidance | None = None
        self.plot = AxisDiversityPlot()
        self.whose, self.spread = QLabel(), QLabel()
        self.contacts, self.legend, self.follows = quiet(wrap=True), quiet(wrap=True), quiet(wrap=True)
        self.spread.setWordWrap(True)
        words = QVBoxLayout()
        words.setSpacing(4)
        for label in (self.whose, self.spread, self.contacts, self.legend, self.follows):
            words.addWidget(label)
        words.addStretch(1)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(2 * GAP)
        row.addWidget(self.plot, 0, Qt.AlignmentFlag.AlignTop)
        row.addLayout(words, 1)
        self.setWhatsThis(
            "The contacts of the taxel as one looks down on it, up as in the 3D view. For the free method: from which sides "
            "they came, the rim is 45 degrees, the dashed circle what a push is asked to lean at most, and the square the side "
            "from which the next one tells most. For the others: where they lie around it, the rim is 5 mm; for the "
            "surface method their middle must come into the dashed circle."
        )

    def show_state(self, state: ViewState) -> None:
        """Show the selected taxel of a tick, or the target; nothing happens where it is the same."""
        target = None if state.target is None else state.target.channel
        channel = state.looked_at
        # A camera that turned by less than what is seen draws nothing anew.
        stand = np.round(np.concatenate([state.eye.right, state.eye.up]), 2).tobytes()
        key = (state.revision, state.method, channel, channel == target, stand)
        if key == self._key and state.guidance is self._guidance:
            return
        self._key, self._guidance = key, state.guidance
        diversity = state.diversity
        self.setVisible(diversity is not None)
        if diversity is None:
            return
        self.whose.setText(f"{self._names.short(diversity.channel)}{', the target' if channel == target else ''}")
        self.contacts.setText(contacts_words(diversity))
        self.spread.setText(diversity_words(diversity, state.method).capitalize())
        self.legend.setText(LEGENDS[state.method])
        self.follows.setText(FOLLOWS[state.method])
        self.plot.set(diversity, diversity_view(diversity, state.method, state.eye))


ROWS = ("Position, mm", "Predicted error", "Worst direction", "\N{PLUS-MINUS SIGN} along it", "Contacts", "State")
POKE_HEADINGS = ("Poke", "Weight k", "Trust", "Axis off by, mm")
_POKE_HINTS = (
    "Number of the poke; a double click shows it in the list of pokes",
    "The taxel's answer in shares of the strongest in the poke: its weight in the solution",
    "How far the method believes the poke for this taxel: 1 counts fully",
    "Distance of the poke's axis from the estimate",
)
LEFT_OUT = (
    "The predicted error carries the noise of force, moment and touch. It leaves out wrong frames, a wrong arm chain, a "
    "wrong mesh and errors of the F/T matrix, which shift all taxels together."
)


def estimate_cells(estimate: Estimate | None) -> tuple[str, ...]:
    """Return the cells of `ROWS` for one estimate."""
    if estimate is None:
        return (DASH,) * len(ROWS)
    return (
        point_mm(estimate.position),
        millimetres(estimate.rms),
        direction(estimate.worst_direction),
        millimetres(estimate.sd),
        str(estimate.contacts),
        MARK_WORDS[mark_of(estimate)],
    )


def distance_words(first: Estimate | None, second: Estimate | None) -> str:
    """Return how far the two methods lie apart, empty where one of them does not know."""
    if first is None or second is None or first.position is None or second.position is None:
        return ""
    return f"The methods lie {millimetres(float(np.linalg.norm(first.position - second.position)))} apart."


class InspectPanel(QScrollArea):
    """Details of the selected taxel above, the worst below."""

    taxel_wanted = Signal(int)
    mark_dead_requested = Signal(int)
    revive_requested = Signal(int)
    poke_wanted = Signal(int)

    def __init__(self, methods: tuple[Method, ...], names: ChannelNames) -> None:
        super().__init__()
        self._methods = methods
        self._names = names
        self._shown: tuple[object, ...] = ()
        self._selected: int | None = None
        self._dead = False
        self.title = QLabel("No taxel selected")
        embolden(self.title, TITLE_PT)
        self.cells = {method: [QLabel(DASH) for _ in ROWS] for method in methods}
        self.reason = quiet("Click a taxel on the map or in the 3D view.", wrap=True)
        self.use = QPushButton("Do not use this taxel")
        self.use.setEnabled(False)
        self.diversity = AxisDiversityPanel(names)
        self.rival = QLabel()
        self.rival.setWordWrap(True)
        self.pokes_title = quiet()
        self.pokes = table("pokes of the taxel", POKE_HEADINGS, _POKE_HINTS)
        self.pokes.setMinimumHeight(110)
        self.worst = TaxelList("taxels that need pokes most")
        self._arrange()
        self.use.clicked.connect(self._use_clicked)
        self.worst.taxel_wanted.connect(self.taxel_wanted)
        self.pokes.itemActivated.connect(lambda item, _column: self.poke_wanted.emit(int(item.text(0))))
        self.setWhatsThis("The selected taxel by each method. " + LEFT_OUT)

    def _arrange(self) -> None:
        grid = QGridLayout()
        grid.setHorizontalSpacing(2 * GAP)
        grid.setVerticalSpacing(2)
        for column, method in enumerate(self._methods, start=1):
            grid.addWidget(quiet(METHOD_NAMES[method]), 0, column)
            grid.setColumnStretch(column, 1)
            for row, label in enumerate(self.cells[method], start=1):
                label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
                label.setWordWrap(True)
                grid.addWidget(label, row, column, Qt.AlignmentFlag.AlignTop)
        for row, text in enumerate(ROWS, start=1):
            grid.addWidget(quiet(text), row, 0, Qt.AlignmentFlag.AlignTop)
        inner = on_panel(self)
        panel = QVBoxLayout(inner)
        panel.setContentsMargins(GAP, GAP, GAP, GAP)
        panel.addWidget(self.title)
        panel.addWidget(self.diversity)
        panel.addLayout(grid)
        for widget in (self.rival, self.reason):
            panel.addWidget(widget)
        panel.addWidget(self.use, 0, Qt.AlignmentFlag.AlignLeft)
        panel.addWidget(self.pokes_title)
        panel.addWidget(self.pokes, 1)
        for empty in (self.diversity, self.rival, self.pokes_title, self.pokes):
            empty.hide()
        panel.addWidget(quiet("Need pokes most"))
        panel.addWidget(self.worst, 1)
        self.setWidget(inner)

    def show_state(self, state: ViewState) -> None:
        """Show the selected taxel of a tick and the worst; nothing happens where they are the same."""
        self.diversity.show_state(state)
        shown = (state.revision, state.method, state.guidance is None, state.selected)
        if shown == self._shown:
            return
        # Another selection changes the details, not the list of the worst.
        changed_worst = shown[:-1] != self._shown[:-1]
        self._shown = shown
        if changed_worst:
            self.worst.show_taxels([(estimate.channel, self._worst_words(estimate)) for estimate in worst(state.estimates)])
        self._selected = state.selected
        if state.selected is not None:
            self._show_taxel(state, state.selected)

    def _show_taxel(self, state: ViewState, channel: int) -> None:
        found = {method: find_estimate(state.snapshot, method, channel) for method in self._methods}
        self.title.setText(f"{self._names.short(channel)}   {self._names.long(channel)}")
        for method, estimate in found.items():
            for label, text in zip(self.cells[method], estimate_cells(estimate), strict=True):
                label.setText(text)
        self._dead = channel in state.snapshot.dead
        shown = found.get(state.method)
        reason = state.snapshot.dead.get(channel) or state_sentence(None if shown is None else shown.reason)
        pair = [found.get(method) for method in (Method.FREE, Method.SURFACE)]
        needs = "" if state.guidance is None else needs_words(state.guidance, channel)
        sentences = (reason, distance_words(pair[0], pair[1]), needs and f"It {needs}.")
        self.reason.setText("  ".join(filter(None, sentences)))
        self.rival.setText(f"\N{BLACK UP-POINTING TRIANGLE} {rival_words(shown)}")
        self.rival.setVisible(shown is not None and bool(rival_words(shown)))
        self._list_pokes(() if shown is None else taxel_pokes(state.snapshot, shown), state.method)
        self.use.setText("Use this taxel again" if self._dead else "Do not use this taxel")
        self.use.setEnabled(True)

    def _list_pokes(self, pokes: tuple[TaxelPoke, ...], method: Method) -> None:
        self.pokes_title.setText(f"Its pokes by the {METHOD_NAMES[method]} method, newest first")
        for widget in (self.pokes_title, self.pokes):
            widget.setVisible(bool(pokes))
        put_rows(self.pokes, [poke_cells(poke) for poke in pokes])

    def _worst_words(self, estimate: Estimate) -> str:
        name = self._names.short(estimate.channel)
        if estimate.state is State.ESTIMATED:
            return f"{name}   {millimetres(estimate.rms)} predicted error, {count(estimate.contacts, 'contact')}"
        return f"{name}   {MARK_WORDS[mark_of(estimate)]}"

    def _use_clicked(self) -> None:
        if self._selected is not None:
            (self.revive_requested if self._dead else self.mark_dead_requested).emit(self._selected)


def poke_cells(poke: TaxelPoke) -> tuple[str, ...]:
    """Return the cells of `POKE_HEADINGS`."""
    sign = "\N{CIRCLE WITH LEFT HALF BLACK} " if poke.trust < MARKED_TRUST else ""
    trust = "1" if poke.trust >= FULL_TRUST else number(poke.trust, 2)
    return (str(poke.poke), number(poke.weight, 2), sign + trust, cell(poke.miss, "m"))
