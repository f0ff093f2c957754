"""What is said of a recording of another program, before and after it becomes a session. No Qt."""

from __future__ import annotations

import numpy as np

from skincal.files.importers.overview import RecordingKind, RecordingPreview, StreamPreview
from skincal.model.errors import plain_text
from skincal.model.readings import Stream
from skincal.session.importing import Imported
from skincal.words.units import DASH, count, number, rate

NAMES = {Stream.WRENCH: "Force/torque", Stream.SKIN: "Skin", Stream.JOINTS: "Joints"}
UNITS_OF = {Stream.WRENCH: "N, N m", Stream.SKIN: "raw", Stream.JOINTS: "\N{DEGREE SIGN}"}
KINDS = {RecordingKind.YARP: "Logs of yarpdatadumper", RecordingKind.CSV: "CSV tables"}
HEADINGS = ("Stream", "Rows", "Rate", "Lasts, s", "Values", "First row")
LOOKING = "Looking at the recording \N{HORIZONTAL ELLIPSIS}"
IMPORTING = "Importing \N{HORIZONTAL ELLIPSIS}"
STOPPING = "Stopping \N{HORIZONTAL ELLIPSIS}"
HOLDS_SESSION = "There is a session in this folder already; name another one."
NO_RECORDING = "That is no recording of another program; drop it onto the window once this is closed."
NO_FOLDER = "No folder for the session is named; name one where you may write."


def kind_words(preview: RecordingPreview) -> str:
    """Return what a recording is taken for, with its streams."""
    streams = ", ".join(NAMES[stream.stream].lower() for stream in preview.streams)
    return f"{KINDS[preview.kind]}: {streams}." + ("" if preview.findings else " Nothing to remark on its times.")


def stream_row(stream: StreamPreview) -> tuple[str, ...]:
    """Return the cells of one stream, as in `HEADINGS`."""
    values = "  ".join(number(value, 1) for value in stream.first)
    more = "  \N{HORIZONTAL ELLIPSIS}" if stream.width > len(stream.first) else ""
    first = f"{values}{more}  {UNITS_OF[stream.stream]}" if values else DASH
    return (
        NAMES[stream.stream], f"{stream.rows:,}".replace(",", "\N{NARROW NO-BREAK SPACE}"), rate(stream.rate),
        number(stream.seconds, 1), str(stream.width or DASH), first,
    )  # fmt: skip


def curve_words(preview: RecordingPreview) -> str:
    """Return what the curve of the force shows, for who does not see it."""
    known = preview.force[np.isfinite(preview.force)]
    if not len(known):
        return "No force could be read."
    return f"Force beside its rest, first {number(preview.times[-1], 0)} s: up to {number(known.max(), 1)} N."


def imported_words(imported: Imported) -> str:
    """Return what was made of a recording."""
    pokes = count(imported.pokes, "poke")
    if imported.unpoked:
        return f"{imported.unpoked} The recording is the session {plain_text(str(imported.folder))}."
    return f"The recording is the session {plain_text(str(imported.folder))}: {pokes}, of which {imported.accepted} count."
