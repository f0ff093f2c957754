"""The Devices tab: rate of each device, age of its last data, lost readings and why. Also the line at the window's foot."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFrame, QGridLayout, QLabel, QPushButton

from app.panels.panel import Panel
from app.panels.widgets import ElidedLabel, digits_font, escape_tooltip, rich_label, secondary_label, set_bold, theme_colours
from app.state.view_state import LinkStatus, ViewState
from app.text.guidance_text import DOT_SEPARATOR
from app.text.link_text import LinkWords, link_lines
from app.text_size import scaled, set_font
from app.theme import WIDGET_GAP_PX
from skincal.model.readings import LinkHealth, Stream
from skincal.words.link_words import STREAM_NAMES, beside_words, outage_words
from skincal.words.units import count, point_mm

if TYPE_CHECKING:
    from skincal.following.guided_session import GuidedSession

MIN_SHOWN_READING_DELAY_S = 0.6  # A hand does not notice a shorter delay
NUMBERS_PERIOD_S, CHIPS_PERIOD_S = 0.25, 1.0
"""Faster numbers cannot be read; the foot of the window is read from the corner of the eye."""


_LINK_SIGNS = {
    LinkStatus.STREAMING: ("\N{BLACK CIRCLE}", "accent"),
    LinkStatus.WAITING: ("\N{WHITE CIRCLE}", "muted"),
    LinkStatus.WRONG: ("\N{WHITE UP-POINTING TRIANGLE}", "warn"),
    LinkStatus.FROZEN: ("\N{MULTIPLICATION X}", "bad"),
    LinkStatus.SILENT: ("\N{WHITE UP-POINTING TRIANGLE}", "warn"),
    LinkStatus.LOST: ("\N{MULTIPLICATION X}", "bad"),
    LinkStatus.ENDED: ("\N{WHITE SQUARE}", "muted"),
    LinkStatus.NOT_READ: ("\N{WHITE CIRCLE}", "muted"),
}
"""Shape and colour of the theme for each state."""
STATUS_SYMBOL_SIZE_PX = 18
RATE_FONT_SIZE_PT = 13
CARD_MARGINS_PX = (WIDGET_GAP_PX, WIDGET_GAP_PX // 2, WIDGET_GAP_PX, WIDGET_GAP_PX // 2)


def link_sign(look: LinkStatus) -> str:
    """Return the sign of a link's state as rich text."""
    sign, ink = _LINK_SIGNS[look]
    style = f"font-size:{scaled(STATUS_SYMBOL_SIZE_PX)}px; font-weight:bold; color:{getattr(theme_colours(), ink)}"
    return f'<span style="{style}">{sign}</span>'


class LinkCard(QFrame):
    """State, rate and losses of one link."""

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("card")
        self.sign, self.name = rich_label(), QLabel()
        set_bold(self.name)
        self.rate = QLabel(alignment=Qt.AlignmentFlag.AlignRight)
        set_font(self.rate, digits_font(RATE_FONT_SIZE_PT), RATE_FONT_SIZE_PT)
        self.about = ElidedLabel("muted")
        self.detail = secondary_label(wrap=True)
        self.losses = QLabel(wordWrap=True)
        grid = QGridLayout(self)
        # Three cards fit into a window of 720 pixels.
        grid.setContentsMargins(*CARD_MARGINS_PX)
        grid.setVerticalSpacing(0)
        grid.setColumnStretch(1, 1)
        for column, widget in enumerate((self.sign, self.name, self.rate)):
            grid.addWidget(widget, 0, column)
        for row, widget in enumerate((self.about, self.detail, self.losses), start=1):
            grid.addWidget(widget, row, 1, 1, 2)

    def show_link(self, words: LinkWords, health: LinkHealth, unpaired: int) -> None:
        """Show a link; `unpaired` skin frames had no wrench, which is shown at the link that carries the wrench."""
        self.sign.setText(link_sign(words.look))
        self.sign.setToolTip(escape_tooltip(words.look.value))
        self.name.setText(words.name)
        self.rate.setText(words.rate)
        carried = ", ".join(STREAM_NAMES[stream] for stream in health.carries)
        # The most important first: a narrow window cuts off the end.
        about = ["" if carried == words.name else carried, health.address, health.format or "format not known yet"]
        self.about.setText(DOT_SEPARATOR.join(filter(None, (*about, f"last bytes {words.age}"))))
        self.detail.setText(words.detail)
        self.detail.setVisible(bool(words.detail))
        lost = "\n".join(count(n, f" {reason}", f" {reason}") for reason, n in words.losses)
        broken = outage_words(health.outages)
        good = count(health.readings, "good", "good")
        # Beside a device that is lost, "none lost" would say the opposite.
        whole = "" if broken or words.look is LinkStatus.LOST else ", none lost"
        said = f"{good}{f', {broken}' if broken else ''}" + (f"; lost:\n{lost}" if lost else whole)
        late = ""
        if unpaired and Stream.WRENCH in health.carries:
            frames = count(unpaired, "skin frame")
            late = f"{frames} had no force/torque reading at their time: it came late, in bursts, or not at all."
        read = DOT_SEPARATOR.join(filter(None, (health.units, beside_words(health.beside), said)))
        pose = "" if health.sent_pose is None else f"tool at ({point_mm(np.array(health.sent_pose.position))}) mm"
        self.losses.setText("\n".join(filter(None, (read, pose, late, health.pose_delay))))


class DevicesPanel(Panel):
    """One card for each link."""

    title = "Devices"

    def __init__(self, _guided: GuidedSession | None = None) -> None:
        super().__init__()
        self.cards: dict[str, LinkCard] = {}
        self.change = QPushButton("Change addresses…  (A)")
        self.change.clicked.connect(lambda: self.command_wanted.emit("addresses"))
        self._column = self.fill(
            (self.change, 0, Qt.AlignmentFlag.AlignLeft), 1, margins=CARD_MARGINS_PX, gap=WIDGET_GAP_PX // 2
        )
        self.setWhatsThis(
            "Each device with its rate, the check of its readings, the age of its last data, and every lost reading by reason. "
            "The program reconnects a lost device automatically; a device that was moved needs another address."
        )

    def depends_on(self, state: ViewState) -> tuple[object, ...]:
        return int(state.now_s / NUMBERS_PERIOD_S), *((words.name, words.look, words.detail) for words in link_lines(state))

    def update_view(self, state: ViewState) -> None:
        links = link_lines(state)
        for name in self.cards.keys() - {words.name for words in links}:
            self.cards.pop(name).deleteLater()
        for words, health in zip(links, state.live.links, strict=True):
            if words.name not in self.cards:
                self.cards[words.name] = LinkCard()
                # Above the button and the stretch.
                self._column.insertWidget(len(self.cards) - 1, self.cards[words.name])
            self.cards[words.name].show_link(words, health, state.live.losses_unpaired)


class LinkChips(QLabel):
    """The links in one short line, and the delay of the readings."""

    def __init__(self) -> None:
        super().__init__()
        self.setContentsMargins(0, 0, WIDGET_GAP_PX, 0)
        self.setMinimumHeight(STATUS_SYMBOL_SIZE_PX)
        self.setProperty("quiet", True)
        self.setProperty("rich", True)
        self.setTextFormat(Qt.TextFormat.RichText)
        self._shown: tuple[object, ...] = ()

    def show_state(self, state: ViewState) -> None:
        links = link_lines(state)
        late = f"catching up, {round(state.behind_s)} s behind" if state.behind_s >= MIN_SHOWN_READING_DELAY_S else ""
        looks = (words.look for words in links)
        shown = (theme_colours(), late, int(state.now_s / CHIPS_PERIOD_S), *looks)
        if shown != self._shown:
            self._shown = shown
            chips = [late, *(f"{link_sign(words.look)}&nbsp;{escape(words.short)}" for words in links)]
            self.setText("&nbsp;&nbsp; ".join(filter(None, chips)))
