"""Sentences on outcomes, estimates and links, as the window shows them.

A sentence says what happened, then the deciding number with its limit, then what to do.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from app.state.policies import GOOD_RMS, Mark
from app.state.view_state import LinkStatus, ViewState, link_status
from skincal.contacts.outcome import Contact, Outcome, Rejection
from skincal.model.readings import LinkAnswer, LinkHealth
from skincal.pokes import Pokes
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Estimate, Method, State
from skincal.taxels.shared_errors import predicted_error
from skincal.words.link_words import link_name, link_verdict_words, nearest_form_words
from skincal.words.poke_words import REASON_WORDS, rejection_advice, rejection_words
from skincal.words.taxel_words import NOT_KNOWN_YET, predicted_words, state_count_words, state_sentence, taxel_error_words
from skincal.words.units import ChannelNames, age, count, millimetres, newtons, rate

MARK_WORDS: Mapping[Mark, str] = {
    Mark.UNSEEN: State.UNSEEN.value,
    Mark.BLIND: State.BLIND.value,
    Mark.INFERRED: f"{State.INFERRED.value} (no contact of its own that counts)",
    Mark.ROUGH: f"{State.TOUCHED.value}, expected error above {millimetres(GOOD_RMS, 0)}",
    Mark.GOOD: f"{State.TOUCHED.value}, expected error up to {millimetres(GOOD_RMS, 0)}",
    Mark.FINISHED_INFERRED: f"{State.INFERRED.value} (no contact of its own that counts), finished",
    Mark.FINISHED: f"{State.TOUCHED.value}, finished",
    Mark.DEAD: State.DEAD.value,
}

HEADLINE_REASON_MAX_CHARS = 36  # Characters that large type has room for next to "rejected", in a window of 1280 pixels


def _headline_reason(rejection: Rejection) -> str:
    words = rejection_words(rejection)
    return words if len(words) <= HEADLINE_REASON_MAX_CHARS else REASON_WORDS[rejection.reason]


def peak_channel(outcome: Outcome) -> int | None:
    """Give the channel with the strongest response, for a rejected poke the first; `None` if none answered."""
    if not len(outcome.channels):
        return None
    if isinstance(outcome, Contact):
        return int(outcome.channels[int(np.argmax(outcome.responses))])
    return int(outcome.channels[0])


def landed_words(outcome: Outcome, names: ChannelNames) -> str:
    """Describe the outcome of a poke away from its landmark: `"accepted for taxel 204: "`."""
    peak = peak_channel(outcome)
    return f"accepted for {names.taxel(peak)}: " if isinstance(outcome, Contact) and peak is not None else "rejected: "


def verdict_words(outcome: Outcome, names: ChannelNames) -> str:
    """Describe the outcome of a poke; `verdict_detail` has the numbers of a long reason."""
    if isinstance(outcome, Rejection):
        return f"rejected: {_headline_reason(outcome)}"
    return accepted_words(outcome, names)


def accepted_words(contact: Contact, names: ChannelNames, asked: int | None = None) -> str:
    """Say for which taxel a poke counts, and which one was `asked` for instead."""
    peak = peak_channel(contact)
    taxel = "" if peak is None else names.taxel(peak)
    if asked is None:
        return f"accepted: {taxel}, {newtons(force_of(contact))}"
    return f"accepted for {taxel} (asked: {names.taxel(asked)})"


def verdict_detail(outcome: Outcome, snapshot: Snapshot, method: Method, names: ChannelNames) -> str:
    """Describe the effect of a poke, or give advice."""
    if isinstance(outcome, Rejection):
        words = rejection_words(outcome)
        left = "" if _headline_reason(outcome) == words else f"{words.removeprefix(REASON_WORDS[outcome.reason]).strip(': ')}. "
        return left + rejection_advice(outcome)
    peak = peak_channel(outcome)
    parts = [f"{count(len(outcome.channels), 'taxel')} answered"]
    estimate = find_estimate(snapshot, method, peak)
    if estimate is not None and peak is not None and estimate.position is not None:
        pokes = count(estimate.contacts, "poke")
        error = taxel_error_words(estimate, snapshot.part_size)
        now = "" if error == NOT_KNOWN_YET else "now "
        parts.append(f"{names.taxel(peak)}: expected error {now}{error} ({pokes})")
    elif estimate is not None and estimate.reason is not None:
        parts.append(state_sentence(estimate.reason))
    return "  \N{MIDDLE DOT}  ".join(parts)


def find_estimate(snapshot: Snapshot, method: Method, channel: int | None) -> Estimate | None:
    """Find a channel's estimate by a method; `None` if it has none."""
    return next((e for e in snapshot.estimates.get(method, ()) if e.channel == channel), None)


def force_of(contact: Contact) -> float:
    """Magnitude of the contact force, N."""
    return float(np.linalg.norm(contact.force))


def pitch_of(contact: Contact) -> float:
    """Magnitude of the wrench pitch (eq. 3), metres."""
    return abs(float(Pokes.collect([contact]).pitch[0]))


def tilt_of(contact: Contact, estimates: Mapping[int, Estimate]) -> float | None:
    """Compute the angle between the force and the inward normal of the strongest taxel, rad; `None` if it is not estimated.

    `estimates` are by channel.
    """
    peak = peak_channel(contact)
    estimate = None if peak is None else estimates.get(peak)
    if estimate is None or estimate.normal is None:
        return None
    return float(Pokes.collect([contact]).tilt(estimate.normal)[0])


def summary_words(estimates: Sequence[Estimate]) -> str:
    """Count the taxels of one method by their state: `"48 taxels: 28 touched, 20 inferred"`."""
    return f"{count(len(estimates), 'taxel')}: {state_count_words(estimates)}"


def error_words(estimates: Sequence[Estimate], part_size: float) -> str:
    """Say the expected error of the estimated taxels; empty if there are none. `part_size` is that of the snapshot."""
    found = predicted_error(estimates, part_size)
    return "" if found is None else f"expected error {predicted_words(found, apart=False)}"


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


def link_words(health: LinkHealth, now_ns: int, clock_offset: float = 0.0, *, connected: bool = True) -> LinkWords:
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
    return tuple(link_words(link, at.now_ns, at.clock_offset, connected=at.connected) for link in at.live.links)


def link_detail(link: LinkHealth, at: ViewState) -> str:
    """Describe the problem of a link; empty if there is none."""
    return _link_detail(link, at.look(link), _last_words(link, at.clock_offset))


def preview_words(health: LinkHealth) -> str:
    """Describe the readings of a previewed link, or why it does not open."""
    words = link_verdict_words(health.verdict)
    if health.frames and health.verdict.answer is LinkAnswer.GOOD:
        words += f", in the frame {' and '.join(health.frames)}"
    if health.verdict.answer is LinkAnswer.NO_READING and health.verdict.line:
        # The line itself is shown below, in colours.
        words = f"data arrives, but no readings. {nearest_form_words(health.verdict)}"
        return f"{words}. {health.text}" if health.text else words
    return f"{words}: {health.text}" if health.text and health.verdict.answer is LinkAnswer.NO_ANSWER else words


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
    return health.warning if look in (LinkStatus.STREAMING, LinkStatus.AWAY) else health.text
