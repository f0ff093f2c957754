"""How each device does: rate, age of the last packet, what was lost and why."""

from __future__ import annotations

from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QColor, QPainter, QPen, QPolygonF
from PySide6.QtWidgets import QFrame, QGridLayout, QHBoxLayout, QLabel, QScrollArea, QVBoxLayout, QWidget

from app.panels.widgets import ElidedLabel, Painted, digits_font, embolden, on_panel, quiet
from app.state.view_state import LinkLook, ViewState
from app.text.outcomes import LinkWords, link_lines
from app.theme import GAP, Colours
from app.units import count
from skincal.model.readings import LinkHealth

ICON_PX = 18
BEHIND_SAID_S = 0.6
"""s. A shorter delay is not said: a hand does not notice it."""
REFRESH_S = 0.25
"""s between two changes of the numbers of a device: faster ones cannot be read."""


class LinkIcon(Painted):
    """State of a link by shape: full disc, hollow ring, bar in a ring, cross, square."""

    def __init__(self) -> None:
        super().__init__()
        self.setFixedSize(ICON_PX, ICON_PX)
        self._look = LinkLook.WAITING

    def set(self, look: LinkLook) -> None:
        """Show another state."""
        if look is not self._look:
            self._look = look
            self.setToolTip(look.value)
            self.update()

    def paint(self, painter: QPainter, colours: Colours) -> None:
        """Paint the shape."""
        inks = {LinkLook.STREAMING: colours.accent, LinkLook.SILENT: colours.warn, LinkLook.LOST: colours.bad}
        colour = QColor(inks.get(self._look, colours.muted))
        painter.setPen(QPen(colour, 2))
        area = QRectF(3, 3, ICON_PX - 6, ICON_PX - 6)
        if self._look is LinkLook.STREAMING:
            painter.setBrush(colour)
            painter.drawEllipse(area)
        elif self._look is LinkLook.LOST:
            painter.drawLine(area.topLeft(), area.bottomRight())
            painter.drawLine(area.topRight(), area.bottomLeft())
        elif self._look is LinkLook.SILENT:
            painter.drawPolygon(QPolygonF([QPointF(ICON_PX / 2, 3), area.bottomRight(), area.bottomLeft()]))
        elif self._look is LinkLook.ENDED:
            painter.drawRect(area.adjusted(1, 1, -1, -1))
        else:
            painter.drawEllipse(area)


class LinkCard(QFrame):
    """One link."""

    def __init__(self, address: str) -> None:
        super().__init__()
        self.setObjectName("card")
        self.icon = LinkIcon()
        self.name = QLabel()
        embolden(self.name)
        self.rate = QLabel()
        self.rate.setFont(digits_font(13))
        self.rate.setAlignment(Qt.AlignmentFlag.AlignRight)
        self.about = ElidedLabel("muted")
        self._address = address
        self.detail = quiet(wrap=True)
        self.losses = QLabel()
        self.losses.setWordWrap(True)
        grid = QGridLayout(self)
        grid.setContentsMargins(GAP, GAP, GAP, GAP)
        grid.setVerticalSpacing(3)
        grid.setColumnStretch(1, 1)
        grid.addWidget(self.icon, 0, 0)
        grid.addWidget(self.name, 0, 1)
        grid.addWidget(self.rate, 0, 2)
        grid.addWidget(self.about, 1, 1, 1, 2)
        grid.addWidget(self.detail, 2, 1, 1, 2)
        grid.addWidget(self.losses, 3, 1, 1, 2)

    def set(self, words: LinkWords, health: LinkHealth) -> None:
        """Show how the link does."""
        self.icon.set(words.look)
        self.name.setText(words.name)
        self.rate.setText(words.rate)
        carried = ", ".join(stream.value for stream in health.carries)
        about = [health.format or "format not known yet", self._address]
        # What a link carries is said only where its name does not say it.
        if carried != words.name:
            about.insert(0, carried)
        self.about.setText(f"last bytes {words.age}  \N{MIDDLE DOT}  " + "  \N{MIDDLE DOT}  ".join(filter(None, about)))
        self.detail.setText(words.detail)
        self.detail.setVisible(bool(words.detail))
        lost = "\n".join(f"{n:,}  {reason}".replace(",", "\N{NARROW NO-BREAK SPACE}") for reason, n in words.losses)
        self.losses.setText(f"{count(health.readings, 'good reading')}" + (f"; lost:\n{lost}" if lost else "; nothing lost"))


class DevicesPanel(QScrollArea):
    """One card a link, and what was lost between them."""

    def __init__(self) -> None:
        super().__init__()
        self.cards: dict[str, LinkCard] = {}
        self.unpaired = quiet(wrap=True)
        self.addresses: dict[str, str] = {}
        """Where each link is connected to."""
        self._shown: tuple[object, ...] = ()
        self._shown_s = 0.0
        inner = on_panel(self)
        self._column = QVBoxLayout(inner)
        self._column.setContentsMargins(GAP, GAP, GAP, GAP)
        self._column.addWidget(self.unpaired)
        self._column.addStretch(1)
        self.setWidget(inner)
        self.setWhatsThis(
            "Each device with its rate, when its last bytes came, and every reading that was lost, by reason. A device that "
            "vanishes is taken up again by itself."
        )

    def show_state(self, state: ViewState) -> None:
        """Show the links; numbers change a few times a second, states at once."""
        links = link_lines(state)
        looks = tuple((words.name, words.look, words.detail) for words in links)
        if looks == self._shown and state.now_s - self._shown_s < REFRESH_S:
            return
        self._shown, self._shown_s = looks, state.now_s
        for words, health in zip(links, state.live.links, strict=True):
            self._card(words.name).set(words, health)
        missing = state.live.losses_unpaired
        self.unpaired.setText(f"{count(missing, 'skin frame')} without a wrench." if missing else "")

    def _card(self, name: str) -> LinkCard:
        if name not in self.cards:
            self.cards[name] = LinkCard(self.addresses.get(name, ""))
            # Above the line of unpaired frames and the stretch.
            self._column.insertWidget(len(self.cards) - 1, self.cards[name])
        return self.cards[name]


class LinkChips(QWidget):
    """The links in one short line, for the foot of the window."""

    def __init__(self) -> None:
        super().__init__()
        self._row = QHBoxLayout(self)
        self._row.setContentsMargins(0, 0, GAP, 0)
        self._row.setSpacing(4)
        self._chips: dict[str, tuple[LinkIcon, QLabel]] = {}
        self.behind = QLabel()
        self.behind.hide()
        self._row.addWidget(self.behind)
        self._shown_s = 0.0
        self._looks: tuple[object, ...] = ()

    def show_state(self, state: ViewState) -> None:
        """Show state and rate of each link, and how far behind the readings the program is."""
        self._show_behind(state.behind_s)
        links = link_lines(state)
        looks = tuple((words.name, words.look) for words in links)
        # The foot of the window is seen from the corner of the eye: once a second is enough.
        if looks == self._looks and state.now_s - self._shown_s < 4 * REFRESH_S:
            return
        self._looks, self._shown_s = looks, state.now_s
        for words in links:
            icon, label = self._chips.get(words.name) or self._add(words.name)
            icon.set(words.look)
            label.setText(words.short)

    def _show_behind(self, behind_s: float) -> None:
        """Say that the program works on older readings than the newest; shown in whole seconds."""
        late = behind_s >= BEHIND_SAID_S
        self.behind.setText(f"catching up, {round(behind_s)} s behind" if late else "")
        self.behind.setVisible(late)

    def _add(self, name: str) -> tuple[LinkIcon, QLabel]:
        icon, label = self._chips[name] = LinkIcon(), quiet()
        label.setContentsMargins(0, 0, GAP, 0)
        self._row.addWidget(icon)
        self._row.addWidget(label)
        return icon, label
