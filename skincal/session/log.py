"""A session read back in order: what arrived and what the operator did, or without the bytes what the session took of them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from mcap.records import Channel

from skincal.journal.lock import writer_of
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, LinkEvent, LinkState
from skincal.model.scene import Scene, load_scene
from skincal.session import cdr
from skincal.session.actions import Stamped, from_json
from skincal.session.journal import EVENT_TOPIC, FORMAT, NOTE_TOPIC, RAW_TOPIC, Ending, Note, link_specs
from skincal.session.outline import read_outline
from skincal.session.scene_copy import SCENE_FILE, SCENE_FOLDER, scene_digest
from skincal.session.segment import RawMessage, SegmentReader
from skincal.session.taken import Taken, taken_from_json
from skincal.session.totals import Totals, totals_from_json
from skincal.streams.links import LinkSpec


@dataclass(frozen=True, slots=True)
class SegmentMark:
    """Here the session was opened to go on."""

    number: int
    host_ns: int
    links: tuple[LinkSpec, ...]


LogItem: TypeAlias = Chunk | LinkEvent | Stamped | SegmentMark | Ending
LogState: TypeAlias = SegmentMark | LinkEvent | Stamped | Ending | Note
FORMAT_WITH_NOTES = 2
_NOTES: dict[str, Callable[[Mapping[str, Any]], Note]] = {"taken": taken_from_json, "totals": totals_from_json}


class SessionLog:
    """A session's folder, open for reading; nothing in it is changed.

    Parameters
    ----------
    folder : of the session
    own : the reader holds the folder's lock itself

    Raises
    ------
    InputError
        It is not a session's folder, or its scene cannot be read, or its first segment has no readable beginning.
    """

    def __init__(self, folder: Path, *, own: bool = False) -> None:
        self.folder = folder
        self.own = own
        self.segments = find_segments(folder)
        self._findings: list[str] = []
        first = next(_SegmentItems(self.segments[0]).read(), None)
        if not isinstance(first, _Beginning):
            raise InputError(
                f"{self.segments[0]}: holds nothing readable; it is another program's file, or damaged at its start."
            )
        self.links = first.mark.links
        self.scene: Scene = load_scene(folder / SCENE_FOLDER / SCENE_FILE)
        self.scene_changed = first.differs(folder, self.scene)
        """The scene in the folder is not the one that was recorded with: what was made of the bytes no longer holds."""
        self.has_notes = first.format >= FORMAT_WITH_NOTES
        """Every segment read so far tells the session without the bytes."""
        self.whole = True
        """Every segment read to its end so far was closed, and nothing is wrong with it."""
        self.written_by = "" if own else writer_of(folder)
        """Who records it at the moment, in words; empty where nobody does."""
        if self.written_by:
            self._findings.append(f"{folder}: is being recorded by {self.written_by}; read as far as it is written.")
        if self.scene_changed:
            self._findings.append(f"{self.scene.path}: was changed after the recording; the changed one is used.")

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences about damage; complete once `items` has been read to its end."""
        return tuple(self._findings)

    def items(self) -> Iterator[LogItem]:
        """Yield every item in the order in which it was taken, a `SegmentMark` at the beginning of each segment.

        Reading ends at the first damage, so that what comes out is a beginning of what happened and has no hole.
        """
        for segment in self._segments(sparse=False):
            for item in segment.read():
                if isinstance(item, _Beginning):
                    yield item.mark
                elif not isinstance(item, Taken | Totals):
                    yield item

    def state(self) -> Iterator[LogState]:
        """Yield what tells the session without the bytes, in order: actions, and what was taken from the detector.

        What was read last says in `has_notes` and `scene_changed` whether that is enough; it is read from the outlines of
        segments that were closed, else without the other chunks of the file, whose damage stays unseen.
        """
        ended = True
        for segment in self._segments(sparse=True):
            ended = False
            for item in segment.read():
                if isinstance(item, _Beginning):
                    self.has_notes &= item.format >= FORMAT_WITH_NOTES
                    self.scene_changed |= item.differs(self.folder, self.scene)
                    yield item.mark
                elif not isinstance(item, Chunk):
                    ended |= isinstance(item, Ending)
                    yield item
        if not ended and not self.written_by:
            self._findings.append(
                f"{self.segments[-1].name}: was not closed. At most the poke in progress is missing, "
                "and counts of readings may lack the last seconds."
            )

    def _segments(self, *, sparse: bool) -> Iterator[_SegmentItems]:
        """Yield the segments to read, each after the one before was read without a hole."""
        for index, path in enumerate(self.segments):
            segment = _SegmentItems(path, sparse=sparse)
            yield segment
            self.whole &= segment.whole
            sentence = segment.finding()
            # Of a segment that grows, the end is never whole.
            if sentence and not (self.written_by and path == self.segments[-1]):
                self._findings.append(sentence)
            later = self.segments[index + 1 :]
            if not segment.complete and later:
                names = ", ".join(other.name for other in later)
                self._findings.append(f"{names}: not read, since what comes before it has a hole.")
                return


def read_session(folder: Path) -> SessionLog:
    """Open a session's folder for reading; see `SessionLog`."""
    return SessionLog(folder)


def find_segments(folder: Path) -> list[Path]:
    """Return a session's segments in their order.

    Raises
    ------
    InputError
        The folder holds none, or one is missing.
    """
    paths = sorted(folder.glob("segment-*.mcap"))
    if not paths:
        what = "there is no such folder" if not folder.is_dir() else "no segment-0001.mcap in it"
        raise InputError(f"{folder}: not a session ({what}); expected a folder that skincal recorded.")
    for number, path in enumerate(paths, start=1):
        if path.name != f"segment-{number:04d}.mcap":
            raise InputError(f"{folder}: segment-{number:04d}.mcap is missing; put it back, or take the later segments away.")
    return paths


@dataclass(frozen=True, slots=True)
class _Beginning:
    """The first item of a segment."""

    mark: SegmentMark
    format: int
    scene: str
    digest: str | None
    """Of the scene's folder; None where the format has none."""

    def differs(self, folder: Path, scene: Scene) -> bool:
        """Tell whether the scene is another one now."""
        if self.digest is not None:
            return self.digest != scene_digest(folder / SCENE_FOLDER)
        return bool(self.scene) and _without_paths(self.scene) != _without_paths(scene.text)


_Record: TypeAlias = Chunk | LinkEvent | Stamped | Ending | Taken | Totals | _Beginning


class _SegmentItems:
    """The items of one segment, in order and without a hole; with `sparse` its events and notes alone."""

    def __init__(self, path: Path, *, sparse: bool = False) -> None:
        topics = (EVENT_TOPIC, NOTE_TOPIC) if sparse else (RAW_TOPIC, EVENT_TOPIC)
        self.reader = SegmentReader(path, topics, sparse=sparse)
        self.path = path
        self.hole = ""
        self.count = 0
        self._sparse = sparse
        self._outlined = False
        self._first_ns = self._last_ns = 0
        self._topics: dict[int, str] = {}

    @property
    def complete(self) -> bool:
        """Everything that was written was read."""
        return self._outlined or (self.reader.data_complete and not self.hole)

    @property
    def whole(self) -> bool:
        """The segment was closed, and nothing is known to be wrong with it."""
        return self._outlined or (self.reader.whole and not self.hole)

    def read(self) -> Iterator[_Record]:
        """Yield the items up to the first damage."""
        lines = read_outline(self.path) if self._sparse else None
        if lines is None:
            yield from self._read_chunks()
            return
        for line in lines:
            document = json.loads(line)
            del document["n"]
            yield _told(document, self.path)
        self._outlined = True

    def _read_chunks(self) -> Iterator[_Record]:
        for record in self.reader.records():
            if isinstance(record, Channel):
                self._topics[record.id] = record.topic
            elif isinstance(record, RawMessage):
                item = self._item(record)
                if item is None:
                    return
                self._last_ns = record.log_ns
                self._first_ns = self._first_ns or record.log_ns
                self.count += 1
                yield item

    def _item(self, record: RawMessage) -> _Record | None:
        """Return a message's item; None where it is not the one that is due."""
        topic = self._topics[record.channel]
        document: dict[str, Any] = {} if topic.startswith(RAW_TOPIC) else json.loads(record.data)
        told = document.pop("n", None)
        number = told if self._sparse and told is not None else record.sequence
        # Without notes nothing counts the events alone; such a segment is played from its bytes in the end.
        if number != self.count and not (self._sparse and told is None):
            self.hole = f"{'note' if self._sparse else 'item'} {self.count} is missing"
            return None
        if topic.startswith(RAW_TOPIC):
            host_ns, raw = cdr.decode_chunk(record.data)
            return Chunk(topic.removeprefix(RAW_TOPIC), host_ns, raw)
        return _told(document, self.path)

    def finding(self) -> str:
        """Return a sentence about what was lost; empty if nothing was."""
        why = self.hole or self.reader.damage
        if not why:
            return ""
        size = self.path.stat().st_size
        lost = size - self.reader.good_bytes
        seconds = (self._last_ns - self._first_ns) * 1e-9
        if self.complete:
            return f"{self.path.name}: its index is damaged ({why}); no reading is lost."
        if self._sparse:
            return f"{self.path.name}: {why}; the session is read up to there, the last {lost} of {size} bytes are lost."
        about = f", about {seconds * lost / self.reader.good_bytes:.1f} s" if self.reader.good_bytes and seconds > 0 else ""
        return (
            f"{self.path.name}: {why}; {self.count} items over {seconds:.1f} s were read, "
            f"the last {lost} of {size} bytes are lost{about}."
        )


def _told(document: dict[str, Any], path: Path) -> LinkEvent | Stamped | Ending | Note | _Beginning:
    """Return the event or the note of a JSON object."""
    return _note(document, path) if document.get("type") in _NOTES else _event(document, path)


def _event(event: dict[str, Any], path: Path) -> LinkEvent | Stamped | Ending | _Beginning:
    host_ns = int(event.pop("host_ns", 0))
    kind = event.pop("type", None)
    if kind == "link":
        return LinkEvent(event["link"], host_ns, LinkState(event["state"]), event["text"])
    if kind == "action":
        return Stamped(host_ns, from_json(event))
    if kind == "end":
        return Ending(host_ns)
    if kind == "segment":
        return _beginning(host_ns, event, path)
    raise InputError(f"{path}: has an event or note {kind!r}, which this version does not know; open it with a newer skincal.")


def _note(note: dict[str, Any], path: Path) -> Note:
    kind = note.pop("type")
    try:
        return _NOTES[kind](note)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path}: a note of kind {kind!r} does not fit ({error!r}); play the session from its bytes."
        ) from None


def _beginning(host_ns: int, event: dict[str, Any], path: Path) -> _Beginning:
    if event["format"] > FORMAT:
        raise InputError(f"{path}: was written by skincal {event['skincal']}, a newer one; expected format {FORMAT} at most.")
    mark = SegmentMark(int(event["segment"]), host_ns, link_specs(event["links"]))
    return _Beginning(mark, int(event["format"]), event["scene"], event.get("scene_digest"))


def _without_paths(text: str) -> str:
    """Return the scene's text without the names of the files, which the copy may have changed."""
    return re.sub(r"^\s*(mesh|modules)\s*=.*$", "", text, flags=re.MULTILINE)
