"""Messages at the top of the window, and the status text on the recording."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from skincal.model.errors import plain_text

REPORT_WORK = "report"
REPORT_IN_PROGRESS = "Writing the report. A message follows when it is finished."
ADDRESS_LINE_MAX_CHARS = 120  # Line length of the question about addresses, in characters; fits a window of 1280 pixels
NO_ADDRESSES = "This session has no device with an address. Ctrl+N: new session with devices."
PART_NOT_SAVED = "The description of this part is not saved. Save it before the page is left?"
NO_SESSION = "No session is open; open one first."
STILL_SOLVING = "All taxels are being recomputed. Try again in a few seconds."


@dataclass(frozen=True, slots=True)
class Message:
    """A message to the operator."""

    text: str
    error: bool = False
    """Stays until it is dismissed."""
    asks: bool = False
    """Asks for an action, and stays until that is done."""
    found: bool = False
    """Reports a finding, neither a success nor an error."""
    file: Path | None = None
    """Written file that a button of the message opens."""
    work: str = ""
    """Work whose progress or result it gives: a newer message on the same work takes its place. Empty for none."""


def message_sign(message: Message) -> str:
    """Return the sign before a message: a cross for an error, an arrow for a request, a dot for a finding, else a tick."""
    if message.error:
        return "\N{BALLOT X}"
    if message.found:
        return "\N{BULLET}"
    return "\N{RIGHTWARDS ARROW}" if message.asks else "\N{CHECK MARK}"


def kept_messages_text(kept: Iterable[tuple[datetime, Message]]) -> str:
    """List messages with their times of day, the newest first."""
    lines = [f"{at:%H:%M:%S}  {message_sign(message)}  {message.text}" for at, message in kept]
    return "\n\n".join(reversed(lines)) or "There is no message yet."


def tip_words(changed: Mapping[str, Any], files: Sequence[Path]) -> str:
    """Ask whether to write a tip that the fixed-point test found, with the form of the poses if it is another one.

    Parameters
    ----------
    changed : values by their key in `[tool]`; `None` for a key that is left out
    """
    words = {key: json.dumps(value) for key, value in changed.items() if value is not None}
    if tip_mm := changed.get("tip_mm"):
        words["tip_mm"] = f"[{', '.join(f'{value:g}' for value in tip_mm)}]"
    lines = [f"{key} = {word}" for key, word in words.items()]
    return (
        f"{' and '.join(lines)} will be written into [tool] of\n\n"
        + "\n".join(plain_text(str(path)) for path in files)
        + "\n\nThe session is then opened again, and its pokes are found again with this tip from what was recorded."
    )


def tip_written_words(files: Sequence[Path], *, is_session: bool) -> str:
    """Name the files that got a tip, and the consequence for the session."""
    written = f"The tip is written into {' and '.join(plain_text(str(path)) for path in files)}."
    return f"{written} The pokes of this session are found again with it." if is_session else written


def refused_words(failure: str) -> str:
    """Report that the disk refuses data, for the reason `failure`."""
    return (
        f"{failure} Recording is paused. The newest pokes are only in memory: export the calibration now, then open the "
        "session again."
    )


def missing_end_words(failure: str) -> str:
    """Report that the disk refused the end of a session that is closed now, for the reason `failure`."""
    return f"{failure} The end of the session is not on the disk: open the session, and look at its last pokes."


def connect_words(addresses: Sequence[str]) -> str:
    """Ask before the devices of a recorded session are connected for the first time."""
    # In full: the part left out could be the one that matters.
    shown = map(plain_text, addresses)
    lines = [text[at : at + ADDRESS_LINE_MAX_CHARS] for text in shown for at in range(0, len(text), ADDRESS_LINE_MAX_CHARS)]
    return "This session uses devices that were not connected on this computer before:\n\n" + "\n".join(lines)


def look_words(sentence: str) -> str:
    """Message that offers to look at a session that another process records."""
    return f"{sentence}\n\nYou can view what is recorded so far. Nothing is changed or recorded."


def kept_words(folder: Path) -> str:
    """Report that a session is saved."""
    return f"This session is saved in {folder}."


def closed_words(folder: Path) -> str:
    """Report that the session that was open before is saved."""
    return f"The session that was open is saved in {folder}."


def empty_words(folder: Path) -> str:
    """Report that a session without a poke is not kept."""
    return f"The session that was open had no poke, and is not kept. Its folder was {folder}."


def report_words(path: Path, verdict: str) -> str:
    """Give the path of a report, and its verdict."""
    return f"The report is in {path}. {verdict}"


def keep_question(pokes: int) -> tuple[str, str]:
    """Ask whether to keep a session with this many pokes so far, and explain the answers."""
    number = f"{pokes} poke{'' if pokes == 1 else 's'}"
    return f"Keep this session with {number}?", "Otherwise its folder is deleted from the documents."


def copy_words(shipped: Path) -> str:
    """Report that a copy of a shipped session is open."""
    return f"{shipped} is part of skincal and is not changed. This is a copy; you can keep it when you close it."


def place_words(folder: Path, *, provisional: bool, copied: bool = False) -> str:
    """Give the folder of a recording, for the status bar.

    Parameters
    ----------
    provisional : the operator has not decided yet to keep it
    copied : a copy of a shipped session
    """
    if not provisional:
        return f"Session in {folder}"
    return f"{'Copy' if copied else 'Recording'} in {folder}; Ctrl+S saves it now"
