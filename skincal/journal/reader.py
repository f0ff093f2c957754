"""A session read back in order: what arrived and what the operator did, or without the bytes what the session took of them.

What is read is always the beginning of what was written, never a wrong value and never a hole: chunks and lines carry a
checksum, items and documents their number, and the lines of a segment say how many items there are. Items beyond those, which a
kill may leave, are not played: what they led to was not written any more.

A session that was cut off or damaged, made ready to go on: every segment is given an end, at its first damage.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, DataEnd, McapRecord, Message, Metadata, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from skincal import __version__
from skincal.journal import documents
from skincal.journal.documents import (
    FORMAT_WITH_NOTES,
    Ending,
    Lines,
    LineWriter,
    Note,
    SegmentMark,
    SessionEvent,
    Taken,
    Totals,
    from_document,
    lines_path,
    read_lines,
)
from skincal.journal.lock import writer_of
from skincal.journal.writer import EVENT_TOPIC, NOTE_TOPIC, RAW_TOPIC, SCENE_FILE, SCENE_FOLDER, scene_digest
from skincal.model.errors import InputError
from skincal.model.readings import Chunk
from skincal.model.scene import Scene, load_scene

LogItem: TypeAlias = Chunk | SessionEvent
LogState: TypeAlias = SessionEvent | Note
RECORD_LIMIT = 64 << 20
"""Bytes. A record that says it is larger is damaged."""
DAMAGE = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,  # among them: bad checksum, bad UTF-8
    KeyError,
    IndexError,
    AssertionError,
    EOFError,
    OverflowError,
    MemoryError,
)
"""What the MCAP library raises on damaged bytes."""


class SessionLog:
    """A session's folder, open for reading; nothing in it is changed. With `own` the reader holds the folder's lock itself.

    Raises
    ------
    InputError
        It is not a session's folder, or its scene cannot be read, or its first segment has no readable beginning.
    """

    def __init__(self, folder: Path, *, own: bool = False) -> None:
        self.folder, self.own = folder, own
        self.segments = find_segments(folder)
        self._digest = scene_digest(folder / SCENE_FOLDER)
        self._findings: list[str] = []
        first = next(Segment(self.segments[0], last=True).state(), None)
        if not isinstance(first, SegmentMark):
            raise InputError(
                f"{self.segments[0]}: holds nothing readable; it is another program's file, or damaged at its start."
            )
        self.links = first.links
        self.scene: Scene = load_scene(folder / SCENE_FOLDER / SCENE_FILE)
        self.scene_changed = self._differs(first)
        """The scene in the folder is not the one that was recorded with: what was made of the bytes no longer holds."""
        self.has_notes = first.format >= FORMAT_WITH_NOTES
        """Every segment read so far holds the session without the bytes."""
        self.written_by = "" if own else writer_of(folder)
        """Who records it at the moment, in words; empty where nobody does."""
        if self.written_by:
            self._findings.append(f"{folder}: is being recorded by {self.written_by}; read as far as it is written.")
        if self.scene_changed:
            self._findings.append(f"{self.scene.path}: was changed after the recording; the changed one is used.")

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences about damage; complete once `items` or `state` has been read to its end."""
        return tuple(self._findings)

    def items(self) -> Iterator[LogItem]:
        """Yield every item in the order in which it was taken, a `SegmentMark` where the session was opened to go on.

        Reading ends at the first damage, so that what comes out is a beginning of what happened and has no hole.
        """
        for segment in self._segments():
            for item in segment.items():
                if not (isinstance(item, SegmentMark) and item.continues):
                    yield item

    def state(self) -> Iterator[LogState]:
        """Yield what the session is without the bytes, in order: actions, and what was taken from the detector.

        What was read last says in `has_notes` and `scene_changed` whether that is enough. Damage of the bytes stays unseen.
        """
        ended = True
        for segment in self._segments():
            for item in segment.state():
                if isinstance(item, SegmentMark):
                    self.has_notes &= item.format >= FORMAT_WITH_NOTES
                    self.scene_changed |= self._differs(item)
                    if item.continues:
                        continue
                # The last counts stand behind the end.
                ended = isinstance(item, Ending) or (ended and isinstance(item, Totals))
                yield item
        if not ended and not self.written_by:
            self._findings.append(
                f"{self.segments[-1].name}: was not closed. At most the poke in progress is missing, "
                "and counts of readings may lack the last seconds."
            )

    def _segments(self) -> Iterator[Segment]:
        """Yield the segments to read, each after the one before was read without a hole."""
        for index, path in enumerate(self.segments):
            later = self.segments[index + 1 :]
            segment = Segment(path, last=not later)
            yield segment
            # Of a segment that grows, the end is never whole.
            if segment.finding and (later or not self.written_by):
                self._findings.append(f"{path.name}: {segment.finding}")
            if segment.has_hole and later:
                names = ", ".join(other.name for other in later)
                self._findings.append(f"{names}: not read, since what comes before it has a hole.")
                return

    def _differs(self, mark: SegmentMark) -> bool:
        """Return whether the scene is another one now."""
        if mark.digest is not None:
            return mark.digest != self._digest
        return bool(mark.scene) and _without_paths(mark.scene) != _without_paths(self.scene.text)


def find_segments(folder: Path) -> list[Path]:
    """Return a session's segments in their order; InputError where the folder holds none, or one is missing."""
    paths = sorted(folder.glob("segment-*.mcap"))
    if not paths:
        no_folder = "it is no folder" if folder.exists() else "there is no such folder"
        what = "no segment-0001.mcap in it" if folder.is_dir() else no_folder
        raise InputError(f"{folder}: not a session ({what}); expected a folder that skincal recorded.")
    for number, path in enumerate(paths, start=1):
        if path.name != f"segment-{number:04d}.mcap":
            raise InputError(f"{folder}: segment-{number:04d}.mcap is missing; put it back, or take the later segments away.")
    return paths


class Segment:
    """One segment, read once by one of its methods; the `last` one may end anywhere."""

    def __init__(self, path: Path, *, last: bool) -> None:
        self.path = path
        self.finding = ""
        """What is wrong, in words without the file's name; empty while nothing is."""
        self.has_hole = False
        """Something is missing at the end."""
        self._mcap = McapFile(path)
        self._lines = read_lines(path)
        lines = self._lines
        # The last segment may be growing: only a line that does not fit is damage there.
        if lines is None or lines.closed or (last and not lines.lost):
            return
        self.finding = f"{lines_path(path).name} is damaged"
        whole = tells_all(path)
        if whole or not lines.documents:
            self.finding += " and is not read" + ("; nothing is lost." if whole else ".")
            self._lines = None
        else:
            self.finding += f"; the session is read up to there, the last {lines.lost} bytes are lost."

    def state(self) -> Iterator[LogState]:
        """Yield events and notes, up to the first damage."""
        lines = self._lines
        if lines is not None:
            yield from (from_document(json.loads(document), self.path) for document in lines.documents)
            self.has_hole = not lines.closed
            return
        try:
            for document in self._mcap.documents():
                yield from_document(document, self.path)
        except DamagedError as error:
            self.has_hole = True
            self.finding = f"{error}; the session is read up to there, {self._mcap.lost} are lost."

    def items(self) -> Iterator[Chunk | SessionEvent]:
        """Yield items up to the first damage, as many as the lines vouch for."""
        due = None if self._lines is None else self._lines.items
        count, first_ns, last_ns, why = 0, 0, 0, ""
        try:
            for topic, message in self._mcap.messages():
                # What lies behind the last item that is vouched for led to something that was not written any more.
                if count == due or not _is_item(topic):
                    continue
                if topic != EVENT_TOPIC:
                    first_ns, last_ns = first_ns or message.log_time, message.log_time
                count += 1
                yield self._item(topic, message)
        except DamagedError as error:
            why = str(error)
        lines = self._lines
        missing = not self._mcap.complete if lines is None else count < lines.items
        self.has_hole = missing or not (lines is None or lines.closed)
        if missing:
            read = f"{count} items over {(last_ns - first_ns) * 1e-9:.1f} s were read"
            self.finding = f"{why or 'items are missing'}; {read}, {self._mcap.lost} are lost."
        elif self.has_hole:
            self.finding = self.finding or f"was not closed; {count} items over {(last_ns - first_ns) * 1e-9:.1f} s were read."
        elif why:
            self.finding = f"its index is damaged ({why}); no reading is lost."

    def _item(self, topic: str, message: Message) -> Chunk | SessionEvent:
        if topic != EVENT_TOPIC:
            return Chunk(topic.removeprefix(RAW_TOPIC), *documents.decode_chunk(message.data))
        event = from_document(json.loads(message.data), self.path)
        assert not isinstance(event, Taken | Totals)
        return event


class DamagedError(Exception):
    """What follows in a file cannot be believed; the message says why."""


class McapFile:
    """A segment's MCAP file, read by the library up to the first damage, where its methods raise `DamagedError`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._good_bytes = self._items = 0
        self._topics: dict[int, str] = {}
        self.complete = False
        """All data was read, though the index behind it may be damaged."""

    @property
    def lost(self) -> str:
        """How much of the file was not read, in words."""
        size = self._path.stat().st_size
        return f"the last {size - self._good_bytes} of {size} bytes"

    def records(self) -> Iterator[McapRecord]:
        """Yield every record but chunks, whose content is yielded, checked."""
        count = 0
        with self._path.open("rb") as file:
            try:
                for record in StreamReader(file, validate_crcs=True, record_size_limit=RECORD_LIMIT).records:
                    if isinstance(record, Message):
                        count += 1
                        self._demand_next(record)
                    elif isinstance(record, Channel):
                        self._topics[record.id] = record.topic
                    elif isinstance(record, Statistics) and record.message_count != count:
                        self.complete = False
                        raise DamagedError(f"{record.message_count - count} messages are missing")
                    # Only the index comes behind it.
                    self.complete |= isinstance(record, DataEnd)
                    if not self.complete:
                        self._good_bytes = file.tell()
                    yield record
            except DAMAGE as error:
                raise DamagedError(_words_of(error)) from None

    def _demand_next(self, message: Message) -> None:
        if _is_item(self._topics[message.channel_id]):
            if message.sequence != self._items:
                raise DamagedError(f"item {self._items} is missing")
            self._items += 1

    def messages(self) -> Iterator[tuple[str, Message]]:
        """Yield each message with its topic."""
        return ((self._topics[record.channel_id], record) for record in self.records() if isinstance(record, Message))

    def documents(self) -> Iterator[dict[str, Any]]:
        """Yield events and notes."""
        for count, message in enumerate(self._document_messages()):
            document = json.loads(message.data)
            # Without notes nothing counts the events alone; such a segment is played from its bytes in the end.
            if document.get("n", count) != count:
                raise DamagedError(f"note {count} is missing")
            yield document

    def _document_messages(self) -> Iterator[Message]:
        topics = (EVENT_TOPIC, NOTE_TOPIC)
        found: list[Message] = []
        if is_closed(self._path):
            # All of them or an exception: what the index leads to is whole, or the file is read from its beginning.
            with self._path.open("rb") as file, contextlib.suppress(*DAMAGE):
                reader = make_reader(file, validate_crcs=True)
                found = [message for _, _, message in reader.iter_messages(topics, log_time_order=False)]
        yield from found or (message for topic, message in self.messages() if topic in topics)


def _is_item(topic: str) -> bool:
    return topic == EVENT_TOPIC or topic.startswith(RAW_TOPIC)


def is_closed(path: Path) -> bool:
    """Return whether an MCAP file ends with an index; what comes before is not looked at."""
    try:
        with path.open("rb") as file:
            return make_reader(file).get_summary() is not None
    except (*DAMAGE, OSError):  # an empty file cannot be sought in
        return False


def tells_all(path: Path) -> bool:
    """Return whether an MCAP file was closed and none of its events and notes is missing."""
    try:
        return is_closed(path) and sum(1 for _ in McapFile(path).documents()) > 0
    except DamagedError:
        return False


def _words_of(error: Exception) -> str:
    """Say what is wrong with bytes that raised one of `DAMAGE`."""
    if "EndOfFile" in type(error).__name__ or isinstance(error, EOFError | struct.error):
        return "it ends in the middle of a record"
    return "a checksum does not fit" if "CRC" in type(error).__name__ else "its bytes make no sense"


def _without_paths(text: str) -> str:
    """Return the scene's text without the names of the files, which the copy may have changed."""
    return re.sub(r"^\s*(mesh|modules)\s*=.*$", "", text, flags=re.MULTILINE)


def recover_session(folder: Path) -> tuple[str, ...]:
    """Make every segment of a session readable for other programs too, and ready to be followed by another; hold its lock.

    A file that is written anew up to its damage is kept beside as `*.damaged`. Where it is not known any more what happened at
    a segment's end, the segments after it are put aside as `*.after-damage`.

    Returns sentences on what was done; empty where everything was whole. InputError where the folder cannot be written.
    """
    said: list[str] = []
    broken = ""
    for path in find_segments(folder):
        try:
            if broken:
                aside = _put_aside(path, "after-damage")
                _put_aside(lines_path(path), "after-damage")
                said.append(f"{path.name}: put aside as {aside}, since {broken} before it has a hole.")
                continue
            sentences, hole = _recover(path)
        except OSError as error:
            why = error.strerror
            raise InputError(f"{path}: cannot be recovered ({why}); check the folder's rights and the space.") from None
        said += sentences
        broken = path.name if hole else ""
    return tuple(said)


def _recover(path: Path) -> tuple[list[str], bool]:
    """Return what was done to a segment, and whether it is not known any more what happened at its end."""
    said: list[str] = []
    lines, name = read_lines(path), lines_path(path).name
    ended = lines is not None and lines.closed
    if lines is not None and not ended:
        if not lines.documents or tells_all(path):
            aside = _put_aside(lines_path(path), "damaged")
            said.append(f"{name}: has no end; put aside as {aside}, the MCAP file is read in its place.")
            lines = None
        else:
            said += _end_lines(lines_path(path), lines)
    if is_closed(path) and lines is not None:
        return said, not ended
    if tells_all(path):
        return said, False
    sentence, complete = _write_anew(path, lines)
    return [sentence, *said], not (ended or (lines is None and complete))


def _end_lines(file: Path, lines: Lines) -> list[str]:
    """Give a segment's lines an end behind the last one that is whole."""
    said: list[str] = []
    if lines.lost:
        kept = _free_name(file, "damaged")
        shutil.copyfile(file, kept)
        os.truncate(file, lines.size)
        said = [f"{file.name}: {lines.lost} bytes were lost; the file as it was is {kept.name}."]
    LineWriter(file, lines).close(lines.items)
    return said


def _write_anew(path: Path, lines: Lines | None) -> tuple[str, bool]:
    """Write an MCAP file anew up to its damage; return what was done, and whether all its data is there.

    Where there is nothing in it, and no line beside it, it is put aside.
    """
    fresh = path.with_name(path.name + ".recovering")
    source = McapFile(path)
    # Made anew, so that a link of that name leads nowhere.
    fresh.unlink(missing_ok=True)
    with fresh.open("xb") as target:
        count, why = _copy(source, target)
        # Whole on the medium before it takes the name of the file that it replaces.
        os.fsync(target.fileno())
    lost = source.lost
    kept = _put_aside(path, "damaged")
    if not count and lines is None:
        fresh.unlink()
        _put_aside(lines_path(path), "damaged")
        return f"{path.name}: holds nothing that can be read; put aside as {kept}.", False
    fresh.rename(path)
    if source.complete:
        return f"{path.name}: its index was damaged and is written anew; nothing is lost; the file as it was is {kept}.", True
    return f"{path.name}: {why}; recovered {count} messages, {lost} were lost; the file as it was is {kept}.", False


def _copy(source: McapFile, target: BinaryIO) -> tuple[int, str]:
    """Copy what can be read to an open file; return the number of messages, and why there are no more."""
    writer = Writer(target)
    writer.start(profile="ros2", library=f"skincal {__version__}")
    schemas, channels = dict[int, int](), dict[int, int]()
    count, why = 0, ""
    try:
        for record in source.records():
            if isinstance(record, Message):
                at, publish = record.log_time, record.publish_time
                writer.add_message(channels[record.channel_id], at, record.data, publish, record.sequence)
                count += 1
            elif isinstance(record, Schema) and record.id not in schemas:
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, Channel) and record.id not in channels:
                channels[record.id] = writer.register_channel(record.topic, record.message_encoding, schemas[record.schema_id])
            elif isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
    except DamagedError as error:
        why = str(error)
    writer.finish()
    target.flush()
    return count, why


def _put_aside(path: Path, ending: str) -> str:
    """Give a file, where there is one, a name that no other has, and return it."""
    aside = _free_name(path, ending)
    if path.exists():
        path.rename(aside)
    return aside.name


def _free_name(path: Path, ending: str) -> Path:
    name, number = path.with_name(f"{path.name}.{ending}"), 1
    while name.exists() or name.is_symlink():
        number += 1
        name = path.with_name(f"{path.name}.{ending}-{number}")
    return name
