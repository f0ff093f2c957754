"""Sentences on the outcome of a poke: headline, advice and effect.

A sentence says what happened, then the deciding number with its limit, then what to do.
"""

from __future__ import annotations

from skincal.contacts.outcome import Contact, Outcome, Rejection
from skincal.taxels.poke_figures import force_of, peak_channel
from skincal.taxels.result import Estimate
from skincal.words.poke_words import reason_words, rejection_advice, rejection_words
from skincal.words.taxel_words import NOT_KNOWN_YET, state_sentence, taxel_error_words
from skincal.words.units import ChannelNames, count, newtons

HEADLINE_REASON_MAX_CHARS = 36  # Characters that large type has room for next to "rejected", in a window of 1280 pixels


def _headline_reason(rejection: Rejection) -> str:
    words = rejection_words(rejection)
    return words if len(words) <= HEADLINE_REASON_MAX_CHARS else reason_words(rejection)


def landed_words(outcome: Outcome, names: ChannelNames) -> str:
    """Describe the outcome of a poke away from its landmark: `"accepted for taxel 204: "`."""
    peak = peak_channel(outcome)
    return f"accepted for {names.taxel(peak)}: " if isinstance(outcome, Contact) and peak is not None else "rejected: "


def outcome_headline(outcome: Outcome, names: ChannelNames) -> str:
    """Describe the outcome of a poke; `outcome_detail` has the numbers of a long reason."""
    if isinstance(outcome, Rejection):
        return f"rejected: {_headline_reason(outcome)}"
    return accepted_words(outcome, names)


def accepted_words(contact: Contact, names: ChannelNames, asked: int | None = None) -> str:
    """Say for which taxel a poke counts, and which one was `asked` for instead."""
    peak = peak_channel(contact)
    taxel = "" if peak is None else names.taxel(peak)
    if asked is None:
        force = force_of(contact)
        return f"accepted: {taxel}" if force is None else f"accepted: {taxel}, {newtons(force)}"
    return f"accepted for {taxel} (asked: {names.taxel(asked)})"


def outcome_detail(outcome: Outcome, estimate: Estimate | None, part_size: float, names: ChannelNames) -> str:
    """Describe the effect of a poke, or give advice.

    Parameters
    ----------
    estimate : of the taxel that answered most; `None` if it has none
    part_size : m, as of the snapshot
    """
    if isinstance(outcome, Rejection):
        words = rejection_words(outcome)
        left = "" if _headline_reason(outcome) == words else f"{words.removeprefix(reason_words(outcome)).strip(': ')}. "
        return left + rejection_advice(outcome)
    peak = peak_channel(outcome)
    parts = [f"{count(len(outcome.channels), 'taxel')} answered"]
    if estimate is not None and peak is not None and estimate.position is not None:
        pokes = count(estimate.contacts, "poke")
        error = taxel_error_words(estimate, part_size)
        now = "" if error == NOT_KNOWN_YET else "now "
        parts.append(f"{names.taxel(peak)}: expected error {now}{error} ({pokes})")
    elif estimate is not None and estimate.reason is not None:
        parts.append(state_sentence(estimate.reason))
    return "  \N{MIDDLE DOT}  ".join(parts)
