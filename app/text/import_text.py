"""Texts of the import of recordings of other programs."""

from __future__ import annotations

import numpy as np

from skincal.files.importers.preview import RecordingPreview, StreamPreview
from skincal.model.errors import plain_text
from skincal.model.readings import Stream
from skincal.session.importing import Imported
from skincal.words.link_words import STREAM_NAMES
from skincal.words.units import DASH, count, grouped, number, rate

UNITS_OF = {Stream.WRENCH: "N, N m", Stream.SKIN: "raw", Stream.JOINTS: "\N{DEGREE SIGN}"}
HEADINGS = ("Stream", "Rows", "Rate", "Lasts, s", "Values", "First row")
READING_TEXT = "Reading the recording \N{HORIZONTAL ELLIPSIS}"
IMPORTING_TEXT = "Importing \N{HORIZONTAL ELLIPSIS}"
STOPPING_TEXT = "Stopping \N{HORIZONTAL ELLIPSIS}"
HOLDS_SESSION = "This folder already has a session. Choose another one."
NO_RECORDING = "This is not a recording of another program. Close this dialog and drop it onto the window."
NO_FOLDER = "Choose a folder for the session."


def kind_words(preview: RecordingPreview) -> str:
    """Name the kind of a recording and its streams."""
    streams = ", ".join(STREAM_NAMES[stream.stream] for stream in preview.streams)
    return f"{preview.importer.title}: {streams}." + ("" if preview.findings else " No problems with its times.")


def stream_row(stream: StreamPreview) -> tuple[str, ...]:
    """Make the cells of one stream, as in `HEADINGS`."""
    values = "  ".join(number(value, 1) for value in stream.first)
    more = "  \N{HORIZONTAL ELLIPSIS}" if stream.width > len(stream.first) else ""
    first = f"{values}{more}  {UNITS_OF[stream.stream]}" if values else DASH
    return (
        STREAM_NAMES[stream.stream].capitalize(), grouped(stream.rows), rate(stream.rate),
        number(stream.seconds, 1), str(stream.width or DASH), first,
    )  # fmt: skip


def curve_words(preview: RecordingPreview) -> str:
    """Describe the force curve for screen readers."""
    known = preview.force[np.isfinite(preview.force)]
    if not len(known):
        return "No force could be read."
    return f"Change of force, first {number(preview.times[-1], 0)} s: up to {number(known.max(), 1)} N."


def frame_words(preview: RecordingPreview) -> str:
    """Describe the mean frame of the skin; empty without readings."""
    known = preview.frame[np.isfinite(preview.frame)]
    if not known.size:
        return ""
    rows, columns = preview.frame.shape
    size = f"{rows} x {columns}" if rows > 1 else f"{columns} channels in a row"
    return f"Mean frame, {size}: {number(known.min(), 1)} to {number(known.max(), 1)}. Channel 0 is at the top left."


def imported_words(imported: Imported) -> str:
    """Announce the imported session."""
    pokes = count(imported.pokes, "poke")
    folder, found = plain_text(str(imported.folder)), "".join(f" {each}" for each in imported.findings)
    if imported.unpoked:
        return f"{imported.unpoked} The recording is the session {folder}.{found}"
    return f"The recording is the session {folder}: {pokes}, {imported.accepted} accepted.{found}"
