"""Read a session in order: either bytes and actions, or actions and results without the bytes.

What is read is always the beginning of what was written, never a wrong value and never a hole: chunks and lines carry a
checksum, items and documents their number, and the lines of a segment say how many items there are. Items beyond those, which a
kill may leave, are not played: what they led to was not written any more.

A session that was cut off or damaged, made ready to go on: every segment is given an end, at its first damage.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, TypeAlias

from mcap.records import Channel, Message, Metadata, Schema
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
    read_document,
    read_lines,
)
from skincal.journal.lock import writer_of
from skincal.journal.mcap_file import EVENT_TOPIC, RAW_TOPIC, DamagedError, McapFile, is_closed, is_item, tells_all
from skincal.journal.writer import DIGEST_OF_ALL_FILES, SCENE_FILE, SCENE_FOLDER, scene_digest, toml_digest
from skincal.model.errors import InputError
from skincal.model.readings import Chunk
from skincal.model.scene import Scene, load_scene

LogItem: TypeAlias = Chunk | SessionEvent
LogState: TypeAlias = SessionEvent | Note


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
        """Program that records it now, in words; empty if there is none."""
        if self.written_by:
            self._findings.append(f"{folder}: is being recorded by {self.written_by}; read as far as it is written.")
        if self.scene_changed:
            self._findings.append(
                f"{self.scene.path}: it, its layout or its mesh was changed after the recording; the changed one is used."
            )

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
        """Yield actions and the detector's results in order, without the bytes.

        What was read last says in `has_notes` and `scene_changed` whether that is enough. Of the bytes' damage only
        a file's missing end is seen.
        """
        ended = True
        for segment in self._segments():
            for item in segment.state():
                if isinstance(item, SegmentMark):
                    self.has_notes &= item.format >= FORMAT_WITH_NOTES
                    self.scene_changed |= self._differs(item)
                    if item.continues:
                        continue
                if isinstance(item, Taken):
                    self._demand_channels(item)
                # The last counts stand behind the end.
                ended = isinstance(item, Ending) or (ended and isinstance(item, Totals))
                yield item
        if not ended and not self.written_by:
            self._findings.append(
                f"{self.segments[-1].name}: was not closed. At most the poke in progress is missing, "
                "and counts of readings may lack the last seconds."
            )

    def _demand_channels(self, taken: Taken) -> None:
        """Refuse outcomes of taxels that the scene does not have."""
        width = self.scene.skin.channels
        named = [*(taken.dead or ()), *(int(c) for outcome, _ in taken.outcomes for c in outcome.channels)]
        if named and not 0 <= min(named) <= max(named) < width:
            raise InputError(f"{self.folder}: has a poke on channel {max(named)}; the scene has {width} channels, from 0.")

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
            covers_all = mark.digest.startswith(DIGEST_OF_ALL_FILES)
            return mark.digest != (self._digest if covers_all else toml_digest(self.folder / SCENE_FOLDER))
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
        # What is written to a link is written elsewhere.
        for each in (path, lines_path(path)):
            if each.is_symlink():
                raise InputError(f"{each}: is a link; expected the file itself: copy it there.")
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
            yield from (read_document(document, self.path) for document in lines.documents)
            self.has_hole = not lines.closed
            # The lines are closed after the other file, so that its end was whole then.
            if lines.closed and not is_closed(self.path):
                self.finding = (
                    "its end is missing or damaged; no poke is lost, and --replay plays what is left of its readings."
                )
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
                if count == due or not is_item(topic):
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
        event = read_document(message.data, self.path)
        if isinstance(event, Taken | Totals):
            raise DamagedError("a note stands where an event was expected")
        return event


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
    segments = find_segments(folder)
    for index, path in enumerate(segments):
        try:
            sentences, hole = _recover(path)
            said += sentences
            if hole:
                # From the last on: at every moment what is left has no gap.
                said += reversed([_after_damage(later, path.name) for later in reversed(segments[index + 1 :])])
                break
        except OSError as error:
            why = error.strerror
            raise InputError(f"{path}: cannot be recovered ({why}); check the folder's rights and the space.") from None
    return tuple(said)


def _after_damage(path: Path, broken: str) -> str:
    # Its lines first: alone they would be in the way of a new segment.
    _put_aside(lines_path(path), "after-damage")
    aside = _put_aside(path, "after-damage")
    return f"{path.name}: put aside as {aside}, since {broken} before it has a hole."


def _recover(path: Path) -> tuple[list[str], bool]:
    """Repair a segment; return sentences, and whether its end is lost."""
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
    if file.stat().st_nlink > 1:
        _part_from_links(file)
    if lines.lost:
        kept = _free_name(file, "damaged")
        shutil.copyfile(file, kept)
        os.truncate(file, lines.size)
        said = [f"{file.name}: {lines.lost} bytes were lost; the file as it was is {kept.name}."]
    LineWriter(file, lines).close(lines.items)
    return said


def _part_from_links(file: Path) -> None:
    """Have a file be its folder's own: what is written to one with a second name is written elsewhere, too.

    Tools that make backups of hard links leave such files, and a stranger may have made one.
    """
    fresh = _fresh_name(file)
    with file.open("rb") as source, fresh.open("xb") as target:
        shutil.copyfileobj(source, target)
        os.fsync(target.fileno())
    fresh.replace(file)


def _fresh_name(file: Path) -> Path:
    """Return the name under which a file is made that takes another's place; nothing lies there."""
    fresh = file.with_name(file.name + ".recovering")
    # A link of that name would lead elsewhere.
    fresh.unlink(missing_ok=True)
    return fresh


def _write_anew(path: Path, lines: Lines | None) -> tuple[str, bool]:
    """Rewrite an MCAP file up to its damage; return a sentence, and whether all its data is there.

    Where there is nothing in it, and no line beside it, it is put aside.
    """
    fresh, source = _fresh_name(path), McapFile(path)
    with fresh.open("xb") as target:
        count, why = _copy(source, target)
        # Whole on the medium before it takes the name of the file that it replaces.
        os.fsync(target.fileno())
    lost = source.lost
    if not count and lines is None:
        fresh.unlink()
        _put_aside(lines_path(path), "damaged")
        return f"{path.name}: holds nothing that can be read; put aside as {_put_aside(path, 'damaged')}.", False
    kept = _kept_beside(path, "damaged")
    # In one step: a kill leaves the one or the other.
    fresh.replace(path)
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


def _kept_beside(path: Path, ending: str) -> str:
    """Give a file a second name that no other has, and return it."""
    aside = _free_name(path, ending)
    try:
        aside.hardlink_to(path)
    except OSError:  # a file system without hard links
        shutil.copyfile(path, aside)
    return aside.name


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
