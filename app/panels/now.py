"""What is happening, in large type: a sign, a headline with the verb first, one line of detail, and the force.

It must be readable from two metres while both hands are busy, so shape, words and colour say the same thing.
"""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QPointF, QRectF, QSize, Qt
from PySide6.QtGui import QColor, QFontMetrics, QPainter, QPaintEvent, QPen, QPolygonF
from PySide6.QtWidgets import QFrame, QHBoxLayout, QSizePolicy, QVBoxLayout, QWidget

from app.display_units import newtons
from app.panels.dial import DIAL_PX, Dial
from app.panels.texts import ElidedLabel, FittedLabel
from app.state.view_state import ViewState
from app.text.now import Now, NowMemory, Tone, now_line
from app.theme import GAP, HEADLINE_PT, LIGHT, Colours, digits_font
from skincal.session.snapshot import Snapshot

SIGN_PX = 52
GAUGE_PX = 170


def tone_colour(tone: Tone, colours: Colours) -> str:
    """Return the colour of a tone; never the only thing that tells it."""
    return {
        Tone.GO: colours.accent,
        Tone.GOOD: colours.accent,
        Tone.HOLD: colours.warn,
        Tone.WAIT: colours.muted,
        Tone.CALM: colours.muted,
        Tone.BAD: colours.bad,
    }[tone]


class Sign(QWidget):
    """A ring with a sign of the tone; the ring fills while the poke is held still."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setFixedSize(SIGN_PX, SIGN_PX)
        self._tone = Tone.CALM
        self._share = 0.0
        self._colours = LIGHT

    def set(self, tone: Tone, share: float) -> None:
        """Show a tone and how full the still window is, 0 to 1."""
        if (tone, round(share, 2)) != (self._tone, round(self._share, 2)):
            self._tone, self._share = tone, share
            self.update()

    def set_colours(self, colours: Colours) -> None:
        """Follow the theme."""
        self._colours = colours
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        """Draw the ring, its filled part and the sign."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        ring = QRectF(5, 5, SIGN_PX - 10, SIGN_PX - 10)
        colour = QColor(tone_colour(self._tone, self._colours))
        painter.setPen(QPen(QColor(self._colours.line), 5))
        painter.drawEllipse(ring)
        share = self._share if self._tone is Tone.HOLD else (1.0 if self._tone in (Tone.GOOD, Tone.BAD, Tone.GO) else 0.0)
        pen = QPen(colour, 5)
        pen.setCapStyle(Qt.PenCapStyle.FlatCap)
        painter.setPen(pen)
        painter.drawArc(ring, 90 * 16, -round(share * 360 * 16))
        painter.translate(SIGN_PX / 2, SIGN_PX / 2)
        pen = QPen(colour, 4)
        pen.setCapStyle(Qt.PenCapStyle.RoundCap)
        pen.setJoinStyle(Qt.PenJoinStyle.RoundJoin)
        painter.setPen(pen)
        for line in _SIGNS[self._tone]:
            painter.drawPolyline(QPolygonF([QPointF(x, y) for x, y in line]))
        painter.end()


_SIGNS: dict[Tone, list[list[tuple[float, float]]]] = {
    Tone.GOOD: [[(-8, 1), (-2, 7), (9, -7)]],
    Tone.BAD: [[(-7, -7), (7, 7)], [(-7, 7), (7, -7)]],
    Tone.GO: [[(0, -9), (0, 8)], [(-7, 1), (0, 8), (7, 1)]],
    Tone.HOLD: [[(0, -8), (0, 8)], [(-7, 8), (7, 8)]],
    Tone.WAIT: [[(-8, 0), (-8, 0)], [(0, 0), (0, 0)], [(8, 0), (8, 0)]],
    Tone.CALM: [[(-7, 0), (7, 0)]],
}


class ForceGauge(QWidget):
    """The force of the poke in progress beside the window in which it counts."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setFixedWidth(GAUGE_PX)
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Expanding)
        self._force = 0.0
        self._window = (4.0, 15.0)
        self._colours = LIGHT
        self.setAccessibleName("force of the poke")

    def sizeHint(self) -> QSize:
        """Return the space for the number above the bar."""
        return QSize(GAUGE_PX, SIGN_PX)

    def set(self, force: float, low: float, high: float) -> None:
        """Show a force and the window in which it counts, N."""
        if round(force, 1) != round(self._force, 1) or (low, high) != self._window:
            self._force, self._window = force, (low, high)
            self.update()

    def set_colours(self, colours: Colours) -> None:
        """Follow the theme."""
        self._colours = colours
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        """Draw the number, the scale, the window and the bar."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        low, high = self._window
        full = high * 1.25
        metrics = QFontMetrics(painter.font())
        bar = QRectF(1, self.height() - metrics.height() - 13, self.width() - 2, 10)
        x = [bar.left() + bar.width() * min(1.0, v / full) for v in (low, high, self._force)]
        inside = low <= self._force <= high
        pressing = self._force > 0.05
        colour = QColor(self._colours.accent if inside else self._colours.bad if self._force > high else self._colours.warn)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(QColor(self._colours.raised))
        painter.drawRoundedRect(bar, 3, 3)
        painter.setBrush(QColor(self._colours.line))
        painter.drawRect(QRectF(x[0], bar.top(), x[1] - x[0], bar.height()))
        if pressing:
            painter.setBrush(colour)
            painter.drawRoundedRect(QRectF(bar.left(), bar.top() + 2, x[2] - bar.left(), bar.height() - 4), 2, 2)
        painter.setPen(QColor(self._colours.muted))
        for place, value in zip(x[:2], (low, high), strict=True):
            text = f"{value:.0f}"
            painter.drawText(QPointF(place - metrics.horizontalAdvance(text) / 2, bar.bottom() + metrics.ascent() + 1), text)
        painter.setPen(QColor(self._colours.text if pressing else self._colours.muted))
        painter.setFont(digits_font(15, bold=True))
        area = QRectF(0, 0, self.width(), bar.top() - 2)
        flags = Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignBottom
        painter.drawText(area, flags, newtons(self._force) if pressing else newtons(None) + " N")
        painter.end()


class NowPanel(QFrame):
    """The line that says what happens."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("card")
        self._memory = NowMemory()
        self._now = Now(Tone.CALM, "")
        self._colours = LIGHT
        self.sign = Sign()
        self.headline = FittedLabel()
        self.detail = ElidedLabel()
        self.detail.setProperty("quiet", True)
        self.gauge = ForceGauge()
        self.dial = Dial()
        self.dial.hide()
        font = self.headline.font()
        font.setPointSizeF(HEADLINE_PT)
        font.setBold(True)
        self.headline.setFont(font)
        self.headline.setAccessibleName("what is happening")
        self._arrange()
        self.setWhatsThis(
            "What is happening now and what to do: which taxel to poke, from which side, and why. The ring fills while a poke "
            "is held still; the bar is its force and the lighter band the range in which a poke counts."
        )

    def _arrange(self) -> None:
        words = QVBoxLayout()
        words.setSpacing(2)
        words.addStretch(1)
        words.addWidget(self.headline)
        words.addWidget(self.detail)
        words.addStretch(1)
        row = QHBoxLayout(self)
        row.setContentsMargins(2 * GAP, GAP, 2 * GAP, GAP)
        row.setSpacing(2 * GAP)
        row.addWidget(self.sign)
        row.addWidget(self.dial)
        row.addLayout(words, 1)
        row.addWidget(self.gauge)
        # The same height with the dial and without: nothing beside it moves when the guide is switched off.
        self.setFixedHeight(DIAL_PX + 2 * GAP + 2 * self.frameWidth() + 2)

    def begin(self, snapshot: Snapshot) -> None:
        """Start with a session whose pokes are known already."""
        self._memory = NowMemory.of(snapshot)

    def show_state(self, state: ViewState) -> None:
        """Say what happens now."""
        now, self._memory = now_line(self._memory, state)
        self.dial.show_state(state)
        progress, limits = state.live.progress, state.scene.contacts
        self.gauge.set(float(np.linalg.norm(progress.force)), limits.force_min, limits.force_max)
        self.say(now, progress.still)

    def say(self, now: Now, share: float = 0.0) -> None:
        """Show a line; nothing is drawn where it is shown already."""
        self.sign.set(now.tone, share)
        if now != self._now:
            self._now = now
            self.headline.setText(now.headline)
            self.detail.setText(now.detail)
            self._tint()

    def set_colours(self, colours: Colours) -> None:
        """Follow the theme."""
        self._colours = colours
        self.sign.set_colours(colours)
        self.gauge.set_colours(colours)
        self.dial.set_colours(colours)
        self._tint()

    def _tint(self) -> None:
        plain = self._now.tone in (Tone.WAIT, Tone.CALM)
        colour = self._colours.text if plain else tone_colour(self._now.tone, self._colours)
        self.headline.set_colour(QColor(colour))
        self.detail.set_colour(QColor(self._colours.muted))
