"""Sentences on links, as the window shows them: with their state at this tick."""

from __future__ import annotations

import time
from dataclasses import dataclass

from app.state.view_state import LinkStatus, ViewState, link_status
from skincal.model.readings import LinkHealth
from skincal.words.link_words import link_name, link_verdict_words
from skincal.words.units import age, rate


@dataclass(frozen=True, slots=True)
class LinkWords:
    """Texts for one link."""

    name: str
    look: LinkStatus
    short: str
    """For the status line: `"force/torque sensor 1000 Hz"`."""
    rate: str
    age: str
    detail: str
    """Problem of the link; empty if there is none."""
    losses: tuple[tuple[str, int], ...]
    """Reason and count, worst first."""


def link_texts(health: LinkHealth, now_ns: int, clock_offset: float = 0.0, *, connected: bool = True) -> LinkWords:
    """Make the texts for a link.

    A silent link shows the time of its last bytes rather than their age, so that the screen stays still while nothing streams.
    `now_ns` is the host's monotonic clock, `clock_offset`, s, converts it to the time of day; `connected` as for `link_status`.
    """
    look = link_status(health, now_ns, connected=connected)
    shown_rate, last = look.value, _last_words(health, clock_offset)
    if look is LinkStatus.STREAMING:
        shown_rate, last = rate(health.rate), age((now_ns - health.last_host_ns) * 1e-9)
    losses = sorted(((loss.value, n) for loss, n in health.losses.items() if n), key=lambda item: -item[1])
    detail = _link_detail(health, look, last)
    name = link_name(health)
    return LinkWords(name, look, f"{name} {shown_rate}", shown_rate, last, detail, tuple(losses))


def link_lines(at: ViewState) -> tuple[LinkWords, ...]:
    """Make the texts for each link of a tick."""
    return tuple(link_texts(link, at.now_ns, at.clock_offset, connected=at.connected) for link in at.live.links)


def link_detail(link: LinkHealth, at: ViewState) -> str:
    """Describe the problem of a link; empty if there is none."""
    return _link_detail(link, at.status_of(link), _last_words(link, at.clock_offset))


def _last_words(health: LinkHealth, clock_offset: float) -> str:
    if health.last_host_ns == 0:
        return "nothing yet"
    return time.strftime("%H:%M:%S", time.localtime(health.last_host_ns * 1e-9 + clock_offset))


def _link_detail(health: LinkHealth, look: LinkStatus, last: str) -> str:
    if look is LinkStatus.SILENT:
        return f"Connected, but no data since {last}. Check that the device sends."
    if look is LinkStatus.WAITING and health.last_host_ns == 0:
        return health.text or "Connected, no data yet. Check the address, the baud rate and that the device sends."
    if look in (LinkStatus.WRONG, LinkStatus.FROZEN):
        return link_verdict_words(health.verdict)
    return health.warning if look in (LinkStatus.STREAMING, LinkStatus.NOT_READ) else health.text
