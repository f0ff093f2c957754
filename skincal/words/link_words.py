"""Sentences on links to devices.

The sentence for a lost link: a transport words the reason (`streams/transports/`), `app/text/now_text.py` has the headline.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from skincal.model.errors import ERROR_SENTENCE_MAX_CHARS
from skincal.model.readings import Freeze, LinkAnswer, LinkHealth, LinkVerdict, Outages, SideReading, Stream
from skincal.words.units import count

FILE_SCHEME = "file:"
CHARS_KEPT_FOR_NEXT_SENTENCE = 30
"""Characters kept free for the sentence that follows: `"No session was made."`."""


def silent_links(links: Sequence[LinkHealth]) -> str:
    """Name the links without a usable reading, with the reason; empty if all gave some."""
    said = [
        " ".join(
            f"No usable readings from the {link_name(link)}: {_why_silent(link, brief=brief).rstrip('.')}."
            for link in links
            if not link.has_usable
        )
        for brief in (False, True)
    ]
    return said[0] if len(said[0]) < ERROR_SENTENCE_MAX_CHARS - CHARS_KEPT_FOR_NEXT_SENTENCE else said[1]


def _why_silent(link: LinkHealth, *, brief: bool) -> str:
    verdict = link.verdict
    if link.is_mixture:
        return (
            "they alternate between two series: two runs lie over each other, as of a simulation whose clock began again, "
            "or two programs send on one topic" + ("" if brief else ". Record each alone")
        )
    if link.readings:
        every = f"all its {link.readings} readings" if link.readings > 1 else "its only reading"
        advice = "" if brief else ". Check the sensor and the program that published them"
        return f"{every} are NaN or infinite{advice}"
    if verdict.answer is LinkAnswer.OTHER_STREAM and verdict.found is not None:
        return f"this is the {STREAM_NAMES[verdict.found]} ({verdict.width} values a line). Exchange the addresses"
    if link.text:  # the device's own error text says more than its bytes
        # The advice in it was shown when the link failed.
        return link.text.partition(";")[0] if brief else link.text
    if link.address.startswith(FILE_SCHEME):
        return _why_unread(link)
    if not link.last_host_ns:
        return "nothing arrived. Check the power, the cable and the baud rate of the device"
    expected = " and ".join(STREAM_NAMES[stream] for stream in link.carries)
    if verdict.answer is LinkAnswer.NO_READING and verdict.line:
        return f"data arrived, but no readings of the {expected}: {_unread_line(verdict)}"
    return f"data arrived, but no readings of the {expected}. Check the baud rate and the format of the device"


def _unread_line(verdict: LinkVerdict) -> str:
    """Show a line of text that gives no reading, and the nearest form that is read."""
    return f'the last line is "{verdict.line}". {nearest_form_words(verdict)}'


def nearest_form_words(verdict: LinkVerdict) -> str:
    """Show the nearest form of lines that is read."""
    return f'The nearest form that is read is "{verdict.nearest}"'


def _why_unread(link: LinkHealth) -> str:
    """Say why a file gives no readings; no cable or baud rate is to blame."""
    losses = ", ".join(f"{count} {loss.value}" for loss, count in sorted(link.losses.items(), key=lambda each: -each[1]))
    lines = f"its lines hold none ({losses})" if losses else "it holds none"
    return f"{lines}. Check which file is named for it, and the columns and format of that file"


STREAM_NAMES = {
    Stream.WRENCH: "force/torque sensor", Stream.SKIN: "skin", Stream.JOINTS: "joints", Stream.TIP: "tip", Stream.TOOL: "tool",
}  # fmt: skip
_LINK_NAMES = {stream.value: name for stream, name in STREAM_NAMES.items()}
EXPECTED_BY = {
    Stream.WRENCH: "a force/torque sensor has",
    Stream.SKIN: "the scene has",
    Stream.JOINTS: "the arm needs",
    Stream.TIP: "a tip has",
    Stream.TOOL: "a pose has",
}


BINARY_LEVELS = ((0.0, 100.0), (0.0, 255.0))
"""Values of a skin that skinManager made binary: it writes 0 and 100; its help and the simulator say 255."""


def binary_skin(levels: Sequence[float]) -> str:
    """Warn of a skin whose only values are the two `levels`; empty without them."""
    if not levels:
        return ""
    off = "skinManager was binarising" if tuple(levels) in BINARY_LEVELS else "it is made binary"
    return (
        f"every value is {levels[0]:g} or {levels[1]:g}: {off}, so all taxels of a poke weigh the same; record raw values (of "
        "skinManager: set binarization off, or the raw port), and expect worse positions from these."
    )


def freeze_sentences(freezes: Sequence[Freeze], begin_ns: int) -> list[str]:
    """Say when streams repeated one reading, in seconds from `begin_ns`."""
    return [
        f"{each.stream.value}: repeats one reading {_when(each, begin_ns)}: the {STREAM_NAMES[each.stream]} or its program "
        "stopped, and pokes in this time are lost. Check its power, cable and publisher."
        for each in freezes
    ]


def _when(freeze: Freeze, begin_ns: int) -> str:
    begin_s = max(0.0, (freeze.from_ns - begin_ns) * 1e-9)
    if freeze.until_ns is not None:
        return f"from {begin_s:.1f} to {(freeze.until_ns - begin_ns) * 1e-9:.1f} s"
    return f"from {begin_s:.1f} s on"


def link_name(link: LinkHealth) -> str:
    """Name a link by its stream, or by its own name if that is another one."""
    return _LINK_NAMES.get(link.link, link.link)


def link_verdict_words(verdict: LinkVerdict) -> str:
    """Describe in a few words what a link carries."""
    match verdict.answer:
        case LinkAnswer.GOOD:
            return "good, but no value has changed yet: press the skin once" if verdict.unchanged else "good"
        case LinkAnswer.NO_READING:
            if verdict.stream is Stream.TOOL:
                return "data arrives, but no pose of the tool"
            if verdict.line:
                return f"data arrives, but no readings: {_unread_line(verdict)}"
            tried = f" (tried {', '.join(map(str, verdict.tried))})" if verdict.tried else ""
            return f"data arrives, but no readings: wrong baud rate{tried} or wrong device?"
        case LinkAnswer.OTHER_STREAM:
            found = STREAM_NAMES[verdict.found or Stream.SKIN]
            return f"this is the {found} ({verdict.width} values a line). Exchange the addresses?"
        case LinkAnswer.OTHER_WIDTH:
            return f"{count(verdict.width, 'value')} where {EXPECTED_BY[verdict.stream or Stream.SKIN]} {verdict.expected}"
        case LinkAnswer.FROZEN:
            return "it sends the same reading again and again"
        case LinkAnswer.LISTENING | LinkAnswer.NO_ANSWER:
            return verdict.answer.value


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


def outage_words(outages: Outages) -> str:
    """Count the breaks of a connection: `"interrupted once, 15 s without readings"`; empty without any."""
    if not outages.count:
        return ""
    times = "once" if outages.count == 1 else f"{outages.count} times"
    return f"interrupted {times}, {outages.seconds:.0f} s without readings"


def beside_words(beside: Mapping[str, SideReading]) -> str:
    """Format the additional values of a device: newest, smallest and largest."""
    named = ((*name.partition(", ")[::2], found) for name, found in beside.items())
    return ", ".join(f"{what} {at.now:.1f} {unit} ({at.least:.1f} to {at.most:.1f})" for what, unit, at in named)
