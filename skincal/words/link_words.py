"""Sentences on links to devices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from skincal.model.errors import SENTENCE_MOST, plural
from skincal.model.readings import LinkAnswer, LinkHealth, LinkVerdict, SideReading, Stream

if TYPE_CHECKING:
    pass


SENTENCE_ROOM = 30
"""Characters for what follows on silent links: `"No session was made."`."""


def silent_links(links: Sequence[LinkHealth]) -> str:
    """Return sentences on the links that gave no reading that could be used; empty if all gave some."""
    said = [
        " ".join(
            f"{link.link} gave no reading that can be used: {_why_silent(link, brief=brief).rstrip('.')}."
            for link in links
            if not link.readings
        )
        for brief in (False, True)
    ]
    return said[0] if len(said[0]) < SENTENCE_MOST - SENTENCE_ROOM else said[1]


def _why_silent(link: LinkHealth, *, brief: bool) -> str:
    verdict = link.verdict
    if verdict.answer is LinkAnswer.OTHER_STREAM and verdict.found is not None:
        return (
            f"this is the {STREAM_NAMES[verdict.found]}: its lines have {verdict.width} values; give each address to its stream"
        )
    if link.text:  # the device's own last words say more than what can be guessed from its bytes
        # What to do was said as it failed.
        return link.text.partition(";")[0] if brief else link.text
    if not link.last_host_ns:
        return "nothing arrived; check the device's power, its cable and its baud rate"
    expected = " and ".join(stream.value for stream in link.carries)
    return f"bytes arrived, but none of them {expected} readings; check the baud rate and what the device sends"


STREAM_NAMES = {Stream.WRENCH: "F/T sensor", Stream.SKIN: "skin", Stream.JOINTS: "joints"}
_HAS = {Stream.WRENCH: "a wrench has", Stream.SKIN: "the scene has", Stream.JOINTS: "the arm needs"}


def link_verdict_words(verdict: LinkVerdict) -> str:
    """Return what is found of a link, in few words; a sentence on why it does not open is the link's own."""
    match verdict.answer:
        case LinkAnswer.GOOD:
            return "good; no value has changed yet, press the skin once" if verdict.unchanged else "good"
        case LinkAnswer.NO_READING:
            tried = f" (tried {', '.join(map(str, verdict.tried))})" if verdict.tried else " Another device?"
            return f"bytes arrive but none is a reading: another baud rate?{tried}"
        case LinkAnswer.OTHER_STREAM:
            found = STREAM_NAMES[verdict.found or Stream.SKIN]
            return f"this is the {found}: its lines have {verdict.width} values. Swap?"
        case LinkAnswer.OTHER_WIDTH:
            return f"{plural(verdict.width, 'value')} where {_HAS[verdict.stream or Stream.SKIN]} {verdict.expected}"
        case LinkAnswer.FROZEN:
            return "values never change: the sensor stopped, or its driver repeats one reading"
        case LinkAnswer.LISTENING | LinkAnswer.NO_ANSWER:
            return verdict.answer.value


def beside_words(beside: Mapping[str, SideReading]) -> str:
    """Return what a device measured beside its readings: the newest, and between what it was."""
    named = ((*name.partition(", ")[::2], found) for name, found in beside.items())
    return ", ".join(f"{what} {at.now:.1f} {unit} ({at.least:.1f} to {at.most:.1f})" for what, unit, at in named)
