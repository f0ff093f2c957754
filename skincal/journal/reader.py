"""Read a session in order: either bytes and actions, or actions and results without the bytes.

The result of reading is always a beginning of the session: no wrong value and no hole. Chunks and lines have checksums, items
have numbers, and the lines of a segment confirm its items. Unconfirmed items, which a crash may leave, are not played: their
results were never written. A segment with a damaged line file is played from its bytes.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, TypeAlias

from mcap.records import Channel, Message, Metadata, Schema
from mcap.writer import Writer

from skincal.journal import ros_messages
from skincal.journal.documents import (
    DetectorResult,
    Result,
    SegmentHeader,
    SessionClosed,
    SessionEvent,
    Totals,
    read_document,
)
from skincal.journal.line_file import Lines, lines_path, read_lines, write_closed_copy
from skincal.journal.lock import describe_lock_holder
from skincal.journal.mcap_file import EVENT_TOPIC, RAW_TOPIC, DamagedError, McapFile, is_closed
from skincal.journal.writer import DIGEST_OF_ALL_FILES, SCENE_FILE, SCENE_FOLDER, scene_digest, toml_digest
from skincal.model.errors import InputError
from skincal.model.readings import Chunk
from skincal.model.scene import Scene, load_scene
from skincal.version import __version__

LogItem: TypeAlias = Chunk | SessionEvent
LogState: TypeAlias = SessionEvent | Result


class SessionLog:
    """A session's folder, open for reading; nothing in it is changed. With `own` the reader holds the folder's lock itself.

    Raises
    ------
    InputError
        It is not a session's folder, its scene cannot be read, or its first segment has no readable beginning.
    """

    def __init__(self, folder: Path, *, own: bool = False) -> None:
        self.folder, self.own = folder, own
        self.segments = find_segments(folder)
        self._digest = scene_digest(folder / SCENE_FOLDER)
        self._findings: list[str] = []
        first = Segment(self.segments[0], last=True).header()
        if first is None:
            raise InputError(
                f"{self.segments[0]}: holds nothing readable; it is another program's file, or damaged at its start."
            )
        self.links = first.links
        self.scene: Scene = load_scene(folder / SCENE_FOLDER / SCENE_FILE)
        self.scene_changed = self._has_other_scene(first)
        """The scene in the folder was changed after the recording: the results no longer hold."""
        self.has_results = True
        """Every segment read so far by `state` has a usable line file."""
        self.written_by = "" if own else describe_lock_holder(folder)
        """Program that records it now, in words; empty if there is none."""
        if self.written_by:
            self._findings.append(f"{folder}: is being recorded by {self.written_by}; it was read up to its present end.")
        if self.scene_changed:
            self._findings.append(
                f"{self.scene.path}: it, its layout or its mesh was changed after the recording; the changed one is used."
            )

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences about damage; complete once `items` or `state` has been read to its end."""
        return tuple(self._findings)

    def items(self) -> Iterator[LogItem]:
        """Yield every item in its order, and a `SegmentHeader` for each time that the session was opened to go on.

        Reading ends at the first damage, so the items are a beginning of the session without a hole.
        """
        for segment in self._segments():
            for item in segment.items():
                if not (isinstance(item, SegmentHeader) and item.continues):
                    yield item

    def state(self) -> Iterator[LogState]:
        """Yield actions and the detector's results in their order, without the bytes.

        It ends early if `has_results` turns false: then only `items` give the session, as when `scene_changed` turns true.
        Damage of the bytes is noticed only by a missing end of the file.
        """
        ended = True
        for segment in self._segments():
            if not segment.has_lines:
                if not segment.is_empty:
                    self.has_results = False
                    return
                continue
            for item in segment.state():
                if isinstance(item, SegmentHeader):
                    self.scene_changed |= self._has_other_scene(item)
                    if item.continues:
                        continue
                    ended = False
                if isinstance(item, DetectorResult):
                    self._check_channels(item)
                # The results of closing are behind the end mark: the last outcome, its landmark and the last counts.
                ended |= isinstance(item, SessionClosed)
                yield item
        if not ended and not self.written_by:
            self._findings.append(
                f"{self.segments[-1].name}: was not closed. At most the poke in progress is missing, "
                "and counts of readings may lack the last seconds."
            )

    def _check_channels(self, result: DetectorResult) -> None:
        """Refuse outcomes of taxels that the scene does not have."""
        width = self.scene.skin.channels
        named = [*(result.dead or ()), *(c for outcome in result.outcomes for c in outcome.channels.tolist())]
        if named and not 0 <= min(named) <= max(named) < width:
            raise InputError(f"{self.folder}: has a poke on channel {max(named)}; the scene has {width} channels, from 0.")

    def _segments(self) -> Iterator[Segment]:
        """Yield the segments to read, each after the one before was read without a hole."""
        for index, path in enumerate(self.segments):
            later = self.segments[index + 1 :]
            segment = Segment(path, last=not later)
            yield segment
            # The end of a growing segment is never whole.
            if segment.finding and (later or not self.written_by):
                self._findings.append(f"{path.name}: {segment.finding}")
            if segment.has_hole and later:
                names = ", ".join(other.name for other in later)
                self._findings.append(f"{names}: not read, since what comes before it has a hole.")
                return

    def _has_other_scene(self, header: SegmentHeader) -> bool:
        if header.digest is None:
            return False
        covers_all = header.digest.startswith(DIGEST_OF_ALL_FILES)
        return header.digest != (self._digest if covers_all else toml_digest(self.folder / SCENE_FOLDER))


def find_segments(folder: Path) -> list[Path]:
    """List a session's segments in their order. Raises InputError: the folder has none, or one is missing."""
    paths = sorted(folder.glob("segment-*.mcap"))
    if not paths:
        no_folder = "it is no folder" if folder.exists() else "there is no such folder"
        what = "no segment-0001.mcap in it" if folder.is_dir() else no_folder
        raise InputError(f"{folder}: not a session ({what}); expected a folder that skincal recorded.")
    for number, path in enumerate(paths, start=1):
        if path.name != f"segment-{number:04d}.mcap":
            raise InputError(f"{folder}: segment-{number:04d}.mcap is missing; put it back, or take the later segments away.")
        # A link would be written through, to a file elsewhere.
        for each in (path, lines_path(path)):
            if each.is_symlink():
                raise InputError(f"{each}: is a link; expected the file itself: copy it there.")
    return paths


class Segment:
    """One segment of a recording; call one of its methods, once. Only the `last` segment may be cut off."""

    def __init__(self, path: Path, *, last: bool) -> None:
        self.path = path
        self.finding = ""
        """Description of the damage without the file's name; empty without damage."""
        self.has_hole = False
        """Something is missing at the end."""
        self._mcap = McapFile(path)
        lines = self._lines = read_lines(path)
        # The last segment may be growing: there only a line that does not fit is damage.
        if lines is None or lines.closed or (last and not lines.lost):
            return
        self.finding = f"{lines_path(path).name} is damaged"
        if _is_unusable(path, lines):
            self.finding += "; the session is played from its bytes."
            self._lines = None
        else:
            self.finding += f"; the session is read up to there, the last {lines.lost} bytes are lost."

    @property
    def has_lines(self) -> bool:
        """The line file can be used."""
        return self._lines is not None

    @property
    def is_empty(self) -> bool:
        """Whether the segment has no readable item, since a crash came before the first."""
        return next(self.items(), None) is None

    def header(self) -> SegmentHeader | None:
        """Read the first event; `None` if it cannot be read."""
        first = next(self.state() if self.has_lines else self.items(), None)
        return first if isinstance(first, SegmentHeader) else None

    def state(self) -> Iterator[LogState]:
        """Yield events and results of the line file."""
        lines = self._lines
        assert lines is not None
        yield from (read_document(document, self.path) for document in lines.documents)
        self.has_hole = not lines.closed
        # The lines are closed after the MCAP file, which was whole then.
        if lines.closed and not is_closed(self.path):
            self.finding = (
                "its end is missing or damaged; no poke is lost, and `skincal solve --replay` uses its other readings."
            )

    def items(self) -> Iterator[LogItem]:
        """Yield items up to the first damage; only those that the lines confirm, if there are lines."""
        lines = self._lines
        confirmed = None if lines is None else lines.confirmed_items
        count, first_ns, last_ns, why = 0, 0, 0, ""
        try:
            for topic, message in self._mcap.items():
                if count == confirmed:
                    continue  # not `break`: the end of the file is checked, too
                if topic != EVENT_TOPIC:
                    first_ns, last_ns = first_ns or message.log_time, message.log_time
                count += 1
                yield self._read_item(topic, message)
        except DamagedError as error:
            why = str(error)
        is_missing = not self._mcap.complete if confirmed is None else count < confirmed
        self.has_hole = is_missing or not (lines is None or lines.closed)
        read = f"{count} items over {(last_ns - first_ns) * 1e-9:.1f} s were read"
        if is_missing:
            self.finding = f"{why or 'items are missing'}; {read}, {self._mcap.lost} are lost."
        elif self.has_hole:
            self.finding = self.finding or f"was not closed; {read}."
        elif why:
            self.finding = f"its index is damaged ({why}); no reading is lost."

    def _read_item(self, topic: str, message: Message) -> LogItem:
        if topic != EVENT_TOPIC:
            return Chunk(topic.removeprefix(RAW_TOPIC), *ros_messages.decode_chunk(message.data))
        event = read_document(message.data, self.path)
        if isinstance(event, DetectorResult | Totals):
            raise DamagedError("a result is in the place of an event")
        return event


def _is_unusable(path: Path, lines: Lines) -> bool:
    """Whether a damaged line file is worth less than the MCAP file: it has no content, or the MCAP file was closed."""
    return not lines.documents or (bool(lines.lost) and is_closed(path))


def recover_session(folder: Path) -> tuple[str, ...]:
    """Give every segment of a session a readable end, so that it can be continued. The caller holds its lock.

    A file that is written again is kept as `*.damaged`. If the end of a segment is lost, the segments after it are set aside as
    `*.after-damage`.

    Returns sentences on what was done; empty if everything was whole. Raises InputError: the folder cannot be written.
    """
    sentences: list[str] = []
    segments = find_segments(folder)
    for index, path in enumerate(segments):
        try:
            repairs, end_is_lost = _recover(path)
            sentences += repairs
            if end_is_lost:
                # From the last on: at every moment the rest has no gap.
                aside = [_set_aside_segment(later, path.name) for later in reversed(segments[index + 1 :])]
                return (*sentences, *reversed(aside))
        except OSError as error:
            why = error.strerror
            raise InputError(f"{path}: cannot be recovered ({why}); check the folder's rights and the space.") from None
    return tuple(sentences)


def _set_aside_segment(path: Path, damaged: str) -> str:
    # Its lines first: alone they would be in the way of a new segment.
    _set_aside(lines_path(path), "after-damage")
    return f"{path.name}: put aside as {_set_aside(path, 'after-damage')}, since {damaged} before it has a hole."


def _recover(path: Path) -> tuple[list[str], bool]:
    """Repair one segment. Return sentences, and whether data at its end is missing."""
    sentences: list[str] = []
    lines, file = read_lines(path), lines_path(path)
    ended = lines is not None and lines.closed
    if lines is not None and not ended:
        if _is_unusable(path, lines):
            aside = _set_aside(file, "damaged")
            sentences.append(f"{file.name}: is damaged; put aside as {aside}, the session is played from its bytes.")
            lines = None
        else:
            sentences += _close_lines(file, lines)
    if is_closed(path) and (lines is not None or _is_whole(path)):
        return sentences, lines is not None and not ended
    sentence, complete = _rewrite(path, lines)
    return [sentence, *sentences], not (ended or (lines is None and complete))


def _is_whole(path: Path) -> bool:
    try:
        return sum(1 for _ in McapFile(path).records()) > 0
    except DamagedError:
        return False


def _close_lines(file: Path, lines: Lines) -> list[str]:
    """Close a line file behind its last good line."""
    sentences: list[str] = []
    if lines.lost:
        kept = _keep_copy(file)
        sentences = [f"{file.name}: {lines.lost} bytes were lost; the file as it was is {kept}."]
    fresh = _fresh_name(file)
    write_closed_copy(file, lines, fresh)
    fresh.replace(file)
    return sentences


def _rewrite(path: Path, lines: Lines | None) -> tuple[str, bool]:
    """Write an MCAP file again up to its damage; return a sentence, and whether all its data is there.

    An empty one without lines is set aside.
    """
    fresh, source = _fresh_name(path), McapFile(path)
    with fresh.open("xb") as target:
        count, why = _copy_records(source, target)
        # Whole on the disk before it replaces the other.
        os.fsync(target.fileno())
    lost = source.lost
    if not count and lines is None:
        fresh.unlink()
        _set_aside(lines_path(path), "damaged")
        return f"{path.name}: holds nothing that can be read; put aside as {_set_aside(path, 'damaged')}.", False
    kept = _keep_copy(path)
    fresh.replace(path)
    if source.complete:
        return f"{path.name}: its index was damaged and is written again; nothing is lost; the file as it was is {kept}.", True
    return f"{path.name}: {why}; recovered {count} messages, {lost} were lost; the file as it was is {kept}.", False


def _copy_records(source: McapFile, target: BinaryIO) -> tuple[int, str]:
    """Copy all readable records; return the number of messages, and the reason why there are no more."""
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


def _fresh_name(file: Path) -> Path:
    """Name of the new file that will replace another. Never written in place: the file may have a second name elsewhere."""
    fresh = file.with_name(file.name + ".recovering")
    fresh.unlink(missing_ok=True)  # a link of that name would lead elsewhere
    return fresh


def _keep_copy(path: Path) -> str:
    """Copy a file to a free name, and return that."""
    aside = _free_name(path, "damaged")
    shutil.copyfile(path, aside)
    return aside.name


def _set_aside(path: Path, ending: str) -> str:
    """Rename a file, if it exists, to a free name, and return that."""
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
