"""Outcomes, estimates and links put into words; pure functions of core values, without Qt.

Every sentence starts with what happened, then the number that decided and its limit, then what to do.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from app.state.policies import GOOD_RMS, Mark
from app.state.view_state import LinkLook, ViewState, link_look
from skincal.contacts.outcome import RAW, Contact, Outcome, Reason, Rejection
from skincal.geometry import move_wrench, pitch
from skincal.model.readings import LinkAnswer, LinkHealth
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Estimate, Method, State
from skincal.taxels.shared_errors import predicted_error
from skincal.words.link_words import link_verdict_words
from skincal.words.taxel_words import predicted_words, state_sentence
from skincal.words.units import ChannelNames, age, count, grouped, millimetres, newtons, number, quantity, rate

ADVICE: Mapping[Reason, str] = {
    Reason.TOO_SOFT: "Press harder, then hold.",
    Reason.TOO_HARD: "Press less.",
    Reason.NOT_STILL: "Press, then hold without moving until the ring is full.",
    Reason.SLID: "Keep the tip in one place while you press.",
    Reason.TWO_CONTACTS: "Touch with the tip only; keep the other hand off.",
    Reason.NO_TAXEL: "Poke nearer to a taxel.",
    Reason.TOO_MANY_TAXELS: "Use a smaller tip, or press less.",
    Reason.NOT_CONNECTED: "Something else touches the skin: clear it.",
    Reason.SATURATED: "Beyond the sensor's range: press less.",
    Reason.READINGS_LOST: "See Devices for what was lost or late.",
    Reason.NO_TARE: "Keep hands off for half a second before each poke.",
    Reason.TARE_CHANGED: "Keep hands off between pokes; something leaned on the part, or the sensor drifted.",
    Reason.NO_POSE: "Choose the arm pose, or connect its joints.",
    Reason.ARM_MOVED: "Keep the arm still during a poke.",
}

MISSED_ADVICE = "Poke the landmark itself; where you did, its place in the scene may be wrong, and N leaves it out."
"""Said of a poke that passed the landmark that was asked for too far."""

METHOD_NAMES: Mapping[Method, str] = {Method.FREE: "free", Method.SURFACE: "surface", Method.MODULES: "modules"}

MARK_WORDS: Mapping[Mark, str] = {
    Mark.UNSEEN: "not poked yet",
    Mark.BLIND: "axes do not determine it",
    Mark.ROUGH: f"estimated, error above {GOOD_RMS * 1e3:.0f} mm",
    Mark.GOOD: f"estimated, error up to {GOOD_RMS * 1e3:.0f} mm",
    Mark.DONE: "done, the guide needs nothing more of it",
    Mark.DEAD: "not used",
}

REASON_LETTERS = 36
"""Letters of a reason that large type has room for beside "rejected", in a window of 1280 pixels."""
_SHORT: Mapping[Reason, str] = {
    Reason.TWO_CONTACTS: "two contacts?",
    Reason.NOT_CONNECTED: "far apart",
    Reason.NO_TARE: "old tare",
}
"""Reasons for a column of the list of pokes, where the words of the others have room with their number."""
_BARE = (Reason.NO_TAXEL, Reason.NO_POSE, Reason.SATURATED)
"""Reasons that say all without a number."""


def reason_short(rejection: Rejection) -> str:
    """Return why a poke does not count, in few words with its number alone: `"slid 2.1 mm"`."""
    words = reason_words(rejection).partition(",")[0].replace(":", "")
    return words.replace(rejection.reason.value, _SHORT.get(rejection.reason, rejection.reason.value))


def reason_words(rejection: Rejection) -> str:
    """Return why a poke does not count, with its number and limit: `"slid 2.1 mm, at most 1.5 mm"`."""
    reason, value, limit = rejection.reason, rejection.value, rejection.limit
    if rejection.unit == RAW and math.isfinite(value):
        return f"{reason.value}: largest {number(value, 1)}, needed {number(limit, 1)}"
    if reason in _BARE or not (math.isfinite(value) and math.isfinite(limit)):
        return reason.value
    bound = "at least" if value < limit else "at most"
    if reason is Reason.NOT_STILL and rejection.unit == "s":
        return f"held {quantity(value, 's')}, {bound} {quantity(limit, 's')}"
    if rejection.unit == "1":
        return f"{reason.value}: {number(100.0 * value, 1)} %, {bound} {number(100.0 * limit, 1)} %"
    colon = "" if reason is Reason.SLID else ":"
    return f"{reason.value}{colon} {quantity(value, rejection.unit)}, {bound} {quantity(limit, rejection.unit)}"


def _headline_reason(rejection: Rejection) -> str:
    words = reason_words(rejection)
    return words if len(words) <= REASON_LETTERS else rejection.reason.value


def peak_channel(outcome: Outcome) -> int | None:
    """Return the channel that answered most; for a rejected poke the first, None where none did."""
    if not len(outcome.channels):
        return None
    if isinstance(outcome, Contact):
        return int(outcome.channels[int(np.argmax(outcome.responses))])
    return int(outcome.channels[0])


def landed_words(outcome: Outcome, names: ChannelNames) -> str:
    """Return what became of a poke that was not at the landmark: `"counted for 17-04: "`."""
    peak = peak_channel(outcome)
    return f"counted for {names.short(peak)}: " if isinstance(outcome, Contact) and peak is not None else "rejected: "


def verdict_words(outcome: Outcome, names: ChannelNames) -> str:
    """Return how a poke ended, verb first; the numbers of a long reason are left to `verdict_detail`."""
    if isinstance(outcome, Rejection):
        return f"rejected: {_headline_reason(outcome)}"
    return counted_words(outcome, names, "accepted")


def counted_words(contact: Contact, names: ChannelNames, how: str = "counted for") -> str:
    """Return for which taxel a poke counts that was meant for another."""
    peak = peak_channel(contact)
    return f"{how} {'' if peak is None else names.short(peak)}  {newtons(force_of(contact))}"


def verdict_detail(outcome: Outcome, snapshot: Snapshot, method: Method, names: ChannelNames) -> str:
    """Return what a poke changed, or what to do better."""
    if isinstance(outcome, Rejection):
        words = reason_words(outcome)
        left = "" if _headline_reason(outcome) == words else f"{words.removeprefix(outcome.reason.value).strip(': ')}. "
        return left + ADVICE[outcome.reason]
    peak = peak_channel(outcome)
    parts = [f"{count(len(outcome.channels), 'taxel')} answered"]
    estimate = find_estimate(snapshot, method, peak)
    if estimate is not None and peak is not None and estimate.state is State.ESTIMATED:
        contacts = count(estimate.contacts, "contact")
        parts.append(f"{names.short(peak)} is known to {millimetres(estimate.rms)} from {contacts}")
    elif estimate is not None and estimate.reason is not None:
        parts.append(state_sentence(estimate.reason))
    return "  \N{MIDDLE DOT}  ".join(parts)


def find_estimate(snapshot: Snapshot, method: Method, channel: int | None) -> Estimate | None:
    """Return a channel's estimate by a method, None where there is none."""
    return next((e for e in snapshot.estimates.get(method, ()) if e.channel == channel), None)


def force_of(contact: Contact) -> float:
    """Return the size of the contact's force, N."""
    return float(np.linalg.norm(contact.force))


def pitch_of(contact: Contact) -> float:
    """Return the contact's pitch (eq. 3), metres, without sign."""
    return abs(float(pitch(contact.force, contact.moment)))


def tilt_of(contact: Contact, estimates: Mapping[int, Estimate]) -> float | None:
    """Return the angle between the push and the inward normal of the taxel that answered most, rad; None where it is unknown.

    `estimates` are by channel.
    """
    peak = peak_channel(contact)
    estimate = None if peak is None else estimates.get(peak)
    if estimate is None or estimate.normal is None:
        return None
    force, _ = move_wrench(contact.link_from_sensor, contact.force, contact.moment)
    cosine = -float(force @ estimate.normal) / float(np.linalg.norm(force))
    # Rounding may bring a cosine past 1, where there is no angle.
    return math.acos(min(1.0, max(-1.0, cosine)))


def summary_words(estimates: Sequence[Estimate]) -> str:
    """Return how far the session is by one method."""
    known = sum(e.state is State.ESTIMATED for e in estimates)
    used = sum(e.state is not State.DEAD for e in estimates)
    return f"{grouped(known)} of {count(used, 'taxel')} estimated"


def error_words(estimates: Sequence[Estimate]) -> str:
    """Return the predicted error of the taxels that are estimated; empty where none is."""
    found = predicted_error(estimates)
    return "" if found is None else f"predicted error {predicted_words(found, apart=False)}"


def rejections(snapshot: Snapshot) -> list[Rejection]:
    """Return the pokes that do not count by themselves; none that was at a landmark, where no taxel need answer."""
    outcomes = (record.outcome for record in snapshot.pokes)
    return [each for each in outcomes if isinstance(each, Rejection) and each.poke not in snapshot.at_landmarks]


def pokes_words(snapshot: Snapshot, why: str = "") -> str:
    """Return how many pokes there are and how many do not count; `why` is said of those rejected."""
    rejected = len(rejections(snapshot))
    excluded = sum(p.excluded for p in snapshot.pokes)
    some = {"at landmarks": len(snapshot.at_landmarks), f"rejected{why}": rejected, "excluded": excluded}
    return ", ".join(
        [count(len(snapshot.pokes), "poke"), *(f"{number_of} {what}" for what, number_of in some.items() if number_of)]
    )


@dataclass(frozen=True, slots=True)
class LinkWords:
    """What is said of a link."""

    name: str
    look: LinkLook
    short: str
    """For the status line: `"wrench 1000 Hz"`."""
    rate: str
    age: str
    detail: str
    """A sentence where something is wrong, else empty."""
    losses: tuple[tuple[str, int], ...]
    """Reason and count, worst first."""


def link_words(health: LinkHealth, now_ns: int, clock_offset: float = 0.0, *, connected: bool = True) -> LinkWords:
    """Return what is said of a link.

    A silent link says when its last bytes came, not how long ago, so that nothing on the screen changes while nothing streams.
    `now_ns` is the host's monotonic clock, and `clock_offset`, s, makes it the time of day; `connected` as for `link_look`.
    """
    look = link_look(health, now_ns, connected=connected)
    shown_rate, last = look.value, _last_words(health, clock_offset)
    if look is LinkLook.STREAMING:
        shown_rate, last = rate(health.rate), age((now_ns - health.last_host_ns) * 1e-9)
    losses = sorted(((loss.value, n) for loss, n in health.losses.items() if n), key=lambda item: -item[1])
    detail = _link_detail(health, look, last)
    return LinkWords(health.link, look, f"{health.link} {shown_rate}", shown_rate, last, detail, tuple(losses))


def link_lines(at: ViewState) -> tuple[LinkWords, ...]:
    """Return what is said of each link of a tick."""
    return tuple(link_words(link, at.now_ns, at.clock_offset, connected=at.connected) for link in at.live.links)


def link_detail(link: LinkHealth, at: ViewState) -> str:
    """Return what is said where something is wrong with one of a tick's links; else empty."""
    return _link_detail(link, at.look(link), _last_words(link, at.clock_offset))


def preview_words(health: LinkHealth) -> str:
    """Return what is found of a link that is looked at before a session, and why it does not open."""
    words = link_verdict_words(health.verdict)
    return f"{words}: {health.text}" if health.text and health.verdict.answer is LinkAnswer.NO_ANSWER else words


def _last_words(health: LinkHealth, clock_offset: float) -> str:
    if health.last_host_ns == 0:
        return "nothing yet"
    return time.strftime("%H:%M:%S", time.localtime(health.last_host_ns * 1e-9 + clock_offset))


def _link_detail(health: LinkHealth, look: LinkLook, last: str) -> str:
    if look is LinkLook.SILENT:
        return f"Open, but no bytes since {last}: check that the device is sending."
    if look is LinkLook.WAITING and health.last_host_ns == 0:
        return health.text or "Open, no bytes yet: check the address, the speed and that the device is sending."
    if look in (LinkLook.WRONG, LinkLook.FROZEN):
        return link_verdict_words(health.verdict)
    return "" if look in (LinkLook.STREAMING, LinkLook.AWAY) else health.text
