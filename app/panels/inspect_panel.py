"""The Taxel tab: contacts, estimates and pokes of one taxel, and the taxels that need pokes most.

The picture of the contacts looks down on the taxel. For the free method a dot is the direction of the tool's upper end, the rim
is a tilt of 45 degrees, and tint shows where the next contact would help most. For the other methods dots are contact points on
the skin around the taxel, and a cross is their mean.
"""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QColor, QImage, QPainter, QPen, QPolygonF
from PySide6.QtWidgets import QGridLayout, QLabel, QPushButton, QWidget

from app.panels.layouts import make_column, make_row
from app.panels.panel import Panel
from app.panels.top_view import AxisDiversityView, diversity_view
from app.panels.widgets import Painted, TaxelList, put_rows, secondary_label, set_bold, table
from app.state.memo import is_same
from app.state.policies import mark_of, worst
from app.state.view_state import ViewState
from app.text.guidance_text import GUIDE_SENTENCE_OF_METHOD, contacts_words, diversity_words, needs_words
from app.text.mark_text import MARK_WORDS
from app.theme import WIDGET_GAP_PX, Colours
from skincal.geometry import FloatArray
from skincal.guide.progress import AxisDiversity
from skincal.model.actions import MarkDead, Revive
from skincal.taxels.poke_figures import MIN_TRUST_SHOWN_AS_FULL, TaxelPoke, taxel_pokes
from skincal.taxels.result import MIN_TRUST_OF_A_TOUCH, Estimate, Method
from skincal.words.taxel_words import NOT_KNOWN_YET, rival_words, state_sentence, taxel_error_words
from skincal.words.units import DASH, ChannelNames, cell, count, direction, millimetres, number, point_mm

if TYPE_CHECKING:
    from app.panels.turn_section import TurnSection
    from skincal.following.guided_session import GuidedSession

PLOT_SIZE_PX = 152
TITLE_FONT_SIZE_PT = 11
CONTACT_DOT_SIZE_PX = 4.0
RADIUS_PX = PLOT_SIZE_PX / 2 - CONTACT_DOT_SIZE_PX - 3
UNTRUSTED_DOT_SIZE_RATIO = 0.45  # Size of a contact without trust over that of a trusted one
MAX_GAIN_SHADE_ALPHA_OF_255 = 110
"""Opacity of the tint, 0 to 255, where the next contact would help most; dots must be visible on it."""
_POSITION_LEGEND = (
    "\N{BLACK CIRCLE} strongest here  \N{WHITE CIRCLE} at a neighbour\n\N{MULTIPLICATION SIGN} mean contact point"
)
PICTURE_LEGENDS = {
    Method.FREE: "\N{BLACK CIRCLE} strongest here  \N{WHITE CIRCLE} at a neighbour  small: doubted\n"
    "Tint: best directions of the next poke",
    Method.SURFACE: _POSITION_LEGEND,
    Method.MODULES: _POSITION_LEGEND,
}


class AxisDiversityPlot(Painted):
    """Plot of the directions or points of a taxel's contacts, seen from above."""

    def __init__(self) -> None:
        super().__init__()
        self.setFixedSize(PLOT_SIZE_PX, PLOT_SIZE_PX)
        self._diversity: AxisDiversity | None = None
        self._view: AxisDiversityView | None = None
        self.setAccessibleName("contacts of the taxel, from above")

    def set(self, diversity: AxisDiversity, view: AxisDiversityView) -> None:
        self._diversity, self._view = diversity, view
        self.update()

    def paint(self, painter: QPainter, colours: Colours) -> None:
        diversity, view = self._diversity, self._view
        if diversity is None or view is None:
            return
        painter.translate(PLOT_SIZE_PX / 2, PLOT_SIZE_PX / 2)
        self._draw_scale(painter, view, colours)
        text, ground = QColor(colours.text), QColor(colours.window)
        for place, own, trust in zip(view.dots, diversity.own.tolist(), diversity.trust.tolist(), strict=True):
            size = CONTACT_DOT_SIZE_PX * (UNTRUSTED_DOT_SIZE_RATIO + (1.0 - UNTRUSTED_DOT_SIZE_RATIO) * trust)
            # Filled for its own, a ring for its neighbours': readable without colour.
            painter.setPen(QPen(ground, 1.0) if own else QPen(text, 1.4))
            painter.setBrush(text if own else ground)
            painter.drawEllipse(self._at(place), size, size)
        if view.middle is not None and len(view.dots):
            at = self._at(view.middle)
            # The broad stroke below separates the cross from the dots.
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
        """Draw a diamond around the best direction of the next contact."""
        corners = [at + QPointF(x, y) for x, y in ((0, -8), (8, 0), (0, 8), (-8, 0))]
        painter.setBrush(Qt.BrushStyle.NoBrush)
        # White in black is visible in both themes on any colour.
        for width, colour in ((4.5, Qt.GlobalColor.black), (1.8, Qt.GlobalColor.white)):
            painter.setPen(QPen(colour, width))
            painter.drawPolygon(QPolygonF(corners))


def _shade(shade: FloatArray, colour: QColor) -> QImage:
    """Return the shade in one colour, with the contrast stretched from its smallest to its largest value."""
    inside = shade[shade > 0]
    least, most = float(inside.min()), float(inside.max())
    share = np.where(shade > 0, (shade - least) / max(most - least, 1e-9), 0.0)
    pixels = np.zeros((*shade.shape, 4), dtype=np.uint8)
    pixels[..., :3] = colour.red(), colour.green(), colour.blue()
    pixels[..., 3] = np.round(MAX_GAIN_SHADE_ALPHA_OF_255 * share)
    height, width = shade.shape
    # Copied, since the bytes are released with this function.
    return QImage(pixels.tobytes(), width, height, 4 * width, QImage.Format.Format_RGBA8888).copy()


class AxisDiversityPanel(QWidget):
    """Panel with the contact plot of the selected taxel or the target, and its description."""

    def __init__(self, names: ChannelNames) -> None:
        super().__init__()
        self._names = names
        self._key: tuple[object, ...] = ()
        self.plot = AxisDiversityPlot()
        self.whose, self.spread = QLabel(), QLabel(wordWrap=True)
        self.contacts, self.legend, self.follows = (secondary_label(wrap=True) for _ in range(3))
        words = make_column(self.whose, self.spread, self.contacts, self.legend, self.follows, 1, gap=4)
        make_row((self.plot, 0, Qt.AlignmentFlag.AlignTop), (words, 1), within=self, margins=0, gap=2 * WIDGET_GAP_PX)
        self.setWhatsThis(
            "The contacts of the taxel from above, up as in the 3D view. For the free method: tool directions; the rim is "
            "45 degrees, the dashed circle the largest tilt of a target, the diamond the best direction of the next "
            "poke. For the other methods: contact points around the taxel; the rim is 5 mm. For the surface method "
            "their mean must come into the dashed circle."
        )

    def show_state(self, state: ViewState) -> None:
        target = None if state.target is None else state.target.channel
        channel = state.focused_channel
        # Rounded: a smaller turn of the camera is not visible.
        camera = np.round(np.concatenate([state.eye.right, state.eye.up]), 2).tobytes()
        key = (state.revision, state.method, channel, channel == target, camera, state.guidance)
        if is_same(key, self._key):
            return
        self._key = key
        diversity = state.diversity
        self.setVisible(diversity is not None)
        if diversity is None:
            return
        self.whose.setText(f"Taxel {self._names.short(diversity.channel)}{', the target' if channel == target else ''}")
        self.contacts.setText(contacts_words(diversity))
        self.spread.setText(diversity_words(diversity, state.method).capitalize())
        self.legend.setText(PICTURE_LEGENDS[state.method])
        self.follows.setText(GUIDE_SENTENCE_OF_METHOD[state.method])
        self.plot.set(diversity, diversity_view(diversity, state.method, state.eye))


NO_TAXEL, HOW_TO_SELECT = "No taxel selected", "Click a taxel on the map or in the 3D view."
ESTIMATE_ROWS = ("Position, mm", "Expected error", "Worst direction", "\N{PLUS-MINUS SIGN} along it", "Contacts", "State")
POKE_HEADINGS = ("Poke", "Weight k", "Trust", "Axis off by, mm")
_POKE_HINTS = (
    "Number of the poke; a double click shows it in the list of pokes",
    "Response of the taxel divided by the strongest response of the poke: its weight in the solution",
    "Trust of the method in the poke for this taxel; 1 counts fully",
    "Distance of the poke's force axis from the estimate",
)
NOT_COVERED = (
    "The expected error covers noise of force, moment and touch. It does not cover errors that shift all taxels together: "
    "wrong frames, a wrong arm chain, a wrong mesh, an error of the force/torque matrix."
)


def estimate_cells(estimate: Estimate | None, part_size: float) -> tuple[str, ...]:
    """Make the cells of `ESTIMATE_ROWS` for an estimate; `part_size` is that of the snapshot."""
    if estimate is None:
        return (DASH,) * len(ESTIMATE_ROWS)
    return (
        point_mm(estimate.position),
        taxel_error_words(estimate, part_size),
        direction(estimate.worst_direction),
        millimetres(estimate.sd),
        str(estimate.contacts),
        MARK_WORDS[mark_of(estimate)],
    )


def distance_words(first: Estimate | None, second: Estimate | None) -> str:
    """Give the distance between the estimates of the free and the surface method; empty if one is unknown."""
    if first is None or second is None or first.position is None or second.position is None:
        return ""
    apart = millimetres(float(np.linalg.norm(first.position - second.position)))
    return f"Free and surface method place it {apart} apart."


class InspectPanel(Panel):
    """Details of the selected taxel above, the worst taxels below."""

    title = "Taxel"

    def __init__(self, guided: GuidedSession) -> None:
        super().__init__()
        methods, names = guided.methods, guided.names
        self._methods, self._names = methods, names
        self._listed: tuple[object, ...] = ()
        self.heading = QLabel(NO_TAXEL)
        set_bold(self.heading, TITLE_FONT_SIZE_PT)
        selectable = Qt.TextInteractionFlag.TextSelectableByMouse
        self.cells = {
            method: [QLabel(DASH, wordWrap=True, textInteractionFlags=selectable) for _ in ESTIMATE_ROWS] for method in methods
        }
        self.reason = secondary_label(HOW_TO_SELECT, wrap=True)
        self.use = QPushButton("Do not use this taxel")
        self.use.setEnabled(False)
        self.diversity = AxisDiversityPanel(names)
        self.rival = QLabel(wordWrap=True)
        self.pokes_title = secondary_label()
        self.pokes = table("pokes of the taxel", POKE_HEADINGS, _POKE_HINTS)
        self.pokes.setMinimumHeight(110)
        self.worst = TaxelList("taxels that need pokes most")
        grid = QGridLayout()
        grid.setHorizontalSpacing(2 * WIDGET_GAP_PX)
        grid.setVerticalSpacing(2)
        for column, method in enumerate(self._methods, start=1):
            grid.addWidget(secondary_label(method.value), 0, column)
            grid.setColumnStretch(column, 1)
            for row, label in enumerate(self.cells[method], start=1):
                grid.addWidget(label, row, column, Qt.AlignmentFlag.AlignTop)
        for row, text in enumerate(ESTIMATE_ROWS, start=1):
            grid.addWidget(secondary_label(text), row, 0, Qt.AlignmentFlag.AlignTop)
        self.turn = _turn_section(guided)
        turn = () if self.turn is None else (self.turn,)
        self.fill(
            self.heading, self.diversity, grid, *turn, self.rival, self.reason, (self.use, 0, Qt.AlignmentFlag.AlignLeft),
            self.pokes_title, (self.pokes, 1), secondary_label("Need pokes most"), (self.worst, 1), margins=WIDGET_GAP_PX,
        )  # fmt: skip
        for empty in (self.diversity, self.rival, self.pokes_title, self.pokes):
            empty.hide()
        self.use.clicked.connect(self._switch_use)
        self.worst.taxel_wanted.connect(self.taxel_wanted)
        self.pokes.itemActivated.connect(lambda item, _column: self.poke_wanted.emit(int(item.text(0))))
        self.setWhatsThis("The selected taxel by each method; without one, the target. " + NOT_COVERED)

    def show_state(self, state: ViewState) -> None:
        self.diversity.show_state(state)
        super().show_state(state)

    def depends_on(self, state: ViewState) -> tuple[object, ...]:
        return state.revision, state.method, state.guidance is None, state.selected, state.focused_channel

    def update_view(self, state: ViewState) -> None:
        # Another selection changes the details, not the list of the worst.
        listed = state.revision, state.method
        if listed != self._listed:
            self._listed, part_size = listed, state.snapshot.part_size
            self.worst.show_taxels(
                [(estimate.channel, self._worst_words(estimate, part_size)) for estimate in worst(state.estimates)]
            )
        channel = state.focused_channel
        if channel is None:
            self._show_none()
        else:
            self._show_taxel(state, channel)
        # The target may change just before a click.
        self.use.setEnabled(state.selected is not None)

    def _show_none(self) -> None:
        self.heading.setText(NO_TAXEL)
        for label in chain.from_iterable(self.cells.values()):
            label.setText(DASH)
        self.reason.setText(HOW_TO_SELECT)
        if self.turn is not None:
            self.turn.hide()
        for widget in (self.rival, self.pokes_title, self.pokes):
            widget.hide()

    def _show_taxel(self, state: ViewState, channel: int) -> None:
        found = {method: state.snapshot.estimate_of(channel, method) for method in self._methods}
        self.heading.setText(self._names.long(channel).capitalize())
        for method, estimate in found.items():
            for label, text in zip(self.cells[method], estimate_cells(estimate, state.snapshot.part_size), strict=True):
                label.setText(text)
        shown = found.get(state.method)
        if self.turn is not None:
            self.turn.show_turn(state.snapshot.shown_turn(channel), None if shown is None else shown.normal)
        reason = state.snapshot.dead.get(channel) or state_sentence(None if shown is None else shown.reason)
        pair = [found.get(method) for method in (Method.FREE, Method.SURFACE)]
        needs = "" if state.guidance is None else needs_words(state.guidance, channel)
        sentences = (reason, distance_words(pair[0], pair[1]), needs and f"It {needs}.")
        self.reason.setText("  ".join(filter(None, sentences)))
        self.rival.setText(f"\N{BLACK UP-POINTING TRIANGLE} {rival_words(shown)}")
        self.rival.setVisible(shown is not None and bool(rival_words(shown)))
        self._list_pokes(() if shown is None else taxel_pokes(state.snapshot.contacts_newest_first(), shown), state.method)
        self.use.setText("Use this taxel again" if channel in state.snapshot.dead else "Do not use this taxel")

    def _list_pokes(self, pokes: tuple[TaxelPoke, ...], method: Method) -> None:
        self.pokes_title.setText(f"Its pokes by the {method.value} method, newest first")
        for widget in (self.pokes_title, self.pokes):
            widget.setVisible(bool(pokes))
        put_rows(self.pokes, [poke_cells(poke) for poke in pokes])

    def _worst_words(self, estimate: Estimate, part_size: float) -> str:
        name = self._names.taxel(estimate.channel)
        if estimate.position is not None:
            error = taxel_error_words(estimate, part_size)
            words = f"expected error {error}" if error == NOT_KNOWN_YET else f"{error} expected error"
            return f"{name}   {words}, {count(estimate.contacts, 'contact')}"
        return f"{name}   {MARK_WORDS[mark_of(estimate)]}"

    def _switch_use(self) -> None:
        state = self._state
        if state is not None and state.selected is not None:
            is_dead = state.selected in state.snapshot.dead
            self.action_wanted.emit(Revive(state.selected) if is_dead else MarkDead(state.selected))


def _turn_section(guided: GuidedSession) -> TurnSection | None:
    """Make the section on the turn of a taxel; `None` for taxels of one axis."""
    if guided.part.scene.skin.axes is None:
        return None
    from app.panels.turn_section import TurnSection  # other skins do without

    return TurnSection()


def poke_cells(poke: TaxelPoke) -> tuple[str, ...]:
    """Make the cells of `POKE_HEADINGS`."""
    sign = "\N{CIRCLE WITH LEFT HALF BLACK} " if poke.trust < MIN_TRUST_OF_A_TOUCH else ""
    trust = "1" if poke.trust >= MIN_TRUST_SHOWN_AS_FULL else number(poke.trust, 2)
    return (str(poke.poke), number(poke.weight, 2), sign + trust, cell(poke.miss, "m"))
