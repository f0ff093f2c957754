"""How each device does: rate, age of the last packet, what was lost and why."""

from __future__ import annotations

from html import escape

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QFrame, QGridLayout, QLabel, QPushButton, QScrollArea, QVBoxLayout

from app.panels.widgets import ElidedLabel, digits_font, embolden, on_panel, plain_tip, quiet, theme_colours
from app.state.view_state import LinkLook, ViewState
from app.text.guidance_text import BETWEEN
from app.text.outcomes import LinkWords, link_lines
from app.text_size import scaled, set_font
from app.theme import GAP
from skincal.model.readings import LinkHealth, Stream
from skincal.words.link_words import beside_words
from skincal.words.units import count

BEHIND_SAID_S = 0.6
"""s. A shorter delay is not said: a hand does not notice it."""
REFRESH_S = 0.25
"""s between two changes of the numbers of a device: faster ones cannot be read."""


_SIGNS = {
    LinkLook.STREAMING: ("\N{BLACK CIRCLE}", "accent"),
    LinkLook.WAITING: ("\N{WHITE CIRCLE}", "muted"),
    LinkLook.WRONG: ("\N{WHITE UP-POINTING TRIANGLE}", "warn"),
    LinkLook.FROZEN: ("\N{MULTIPLICATION X}", "bad"),
    LinkLook.SILENT: ("\N{WHITE UP-POINTING TRIANGLE}", "warn"),
    LinkLook.LOST: ("\N{MULTIPLICATION X}", "bad"),
    LinkLook.ENDED: ("\N{WHITE SQUARE}", "muted"),
    LinkLook.AWAY: ("\N{WHITE CIRCLE}", "muted"),
}
"""The state of a link by shape, and which of the theme's colours says it again."""

SIGN_PX = 18
RATE_PT = 13


def link_sign(look: LinkLook) -> str:
    """Return the sign of a link's state in its colour, as rich text."""
    sign, ink = _SIGNS[look]
    return f'<span style="font-size:{scaled(SIGN_PX)}px; font-weight:bold; color:{getattr(theme_colours(), ink)}">{sign}</span>'


class LinkCard(QFrame):
    """One link."""

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("card")
        self.sign = QLabel()
        self.sign.setProperty("rich", True)
        self.name = QLabel()
        embolden(self.name)
        self.rate = QLabel()
        set_font(self.rate, digits_font(RATE_PT), RATE_PT)
        self.rate.setAlignment(Qt.AlignmentFlag.AlignRight)
        self.about = ElidedLabel("muted")
        self.detail = quiet(wrap=True)
        self.losses = QLabel()
        self.losses.setWordWrap(True)
        grid = QGridLayout(self)
        # Three cards are seen whole at 720 pixels.
        grid.setContentsMargins(GAP, GAP // 2, GAP, GAP // 2)
        grid.setVerticalSpacing(0)
        grid.setColumnStretch(1, 1)
        grid.addWidget(self.sign, 0, 0)
        grid.addWidget(self.name, 0, 1)
        grid.addWidget(self.rate, 0, 2)
        grid.addWidget(self.about, 1, 1, 1, 2)
        grid.addWidget(self.detail, 2, 1, 1, 2)
        grid.addWidget(self.losses, 3, 1, 1, 2)

    def set(self, words: LinkWords, health: LinkHealth, unpaired: int) -> None:
        """Show how the link does; `unpaired` skin frames found no wrench, which is said where the wrench comes from."""
        self.sign.setText(link_sign(words.look))
        self.sign.setToolTip(plain_tip(words.look.value))
        self.name.setText(words.name)
        self.rate.setText(words.rate)
        carried = ", ".join(stream.value for stream in health.carries)
        # What a link carries is said only where its name does not say it. The end is what a narrow window cuts off.
        about = ["" if carried == words.name else carried, health.address, health.format or "format not known yet"]
        self.about.setText(BETWEEN.join(filter(None, (*about, f"last bytes {words.age}"))))
        self.detail.setText(words.detail)
        self.detail.setVisible(bool(words.detail))
        lost = "\n".join(count(n, f" {reason}", f" {reason}") for reason, n in words.losses)
        said = count(health.readings, "good", "good") + (f"; lost:\n{lost}" if lost else ", none lost")
        late = ""
        if unpaired and Stream.WRENCH in health.carries:
            late = f"{count(unpaired, 'skin frame')} had no wrench at their time: it came late, in bursts, or not at all."
        read = BETWEEN.join(filter(None, (health.units, beside_words(health.beside), said)))
        self.losses.setText("\n".join(filter(None, (read, late))))


class DevicesPanel(QScrollArea):
    """One card a link."""

    change_wanted = Signal()
    """The devices are elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.cards: dict[str, LinkCard] = {}
        self.change = QPushButton("Change addresses\N{HORIZONTAL ELLIPSIS}  (A)")
        self.change.clicked.connect(self.change_wanted)
        self._shown: tuple[object, ...] = ()
        self._shown_s = 0.0
        inner = on_panel(self)
        self._column = QVBoxLayout(inner)
        self._column.setContentsMargins(GAP, GAP // 2, GAP, GAP // 2)
        self._column.setSpacing(GAP // 2)
        self._column.addWidget(self.change, 0, Qt.AlignmentFlag.AlignLeft)
        self._column.addStretch(1)
        self.setWidget(inner)
        self.setWhatsThis(
            "Each device with its rate, what is found of its readings, when its last bytes came, and every reading that was "
            "lost, by reason. A device that vanishes is taken up again by itself; one that is elsewhere gets another address."
        )

    def show_state(self, state: ViewState) -> None:
        """Show the links; numbers change a few times a second, states at once."""
        links = link_lines(state)
        looks = (theme_colours(), *((words.name, words.look, words.detail) for words in links))
        if looks == self._shown and state.now_s - self._shown_s < REFRESH_S:
            return
        self._shown, self._shown_s = looks, state.now_s
        for name in self.cards.keys() - {words.name for words in links}:
            self.cards.pop(name).deleteLater()
        for words, health in zip(links, state.live.links, strict=True):
            self._card(words.name).set(words, health, state.live.losses_unpaired)

    def _card(self, name: str) -> LinkCard:
        if name not in self.cards:
            self.cards[name] = LinkCard()
            # Above the button and the stretch.
            self._column.insertWidget(len(self.cards) - 1, self.cards[name])
        return self.cards[name]


class LinkChips(QLabel):
    """The links in one short line, for the foot of the window, and how far behind the readings the program is."""

    def __init__(self) -> None:
        super().__init__()
        self.setContentsMargins(0, 0, GAP, 0)
        self.setMinimumHeight(SIGN_PX)
        self.setProperty("quiet", True)
        self.setProperty("rich", True)
        self.setTextFormat(Qt.TextFormat.RichText)
        self._shown: tuple[object, ...] = ()
        self._shown_s = 0.0

    def show_state(self, state: ViewState) -> None:
        """Show state and rate of each link, and that the program works on older readings than the newest."""
        links = link_lines(state)
        late = f"catching up, {round(state.behind_s)} s behind" if state.behind_s >= BEHIND_SAID_S else ""
        shown = (theme_colours(), late, *((words.name, words.look) for words in links))
        # The foot of the window is seen from the corner of the eye: once a second is enough.
        if shown == self._shown and state.now_s - self._shown_s < 4 * REFRESH_S:
            return
        self._shown, self._shown_s = shown, state.now_s
        chips = [late, *(f"{link_sign(words.look)}&nbsp;{escape(words.short)}" for words in links)]
        self.setText("&nbsp;&nbsp; ".join(filter(None, chips)))
