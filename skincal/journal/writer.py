"""Write a session to disk while it happens: bytes, actions and results.

A session is a folder: `segment-0001.mcap` with `segment-0001.jsonl` beside it, `segment-0002...`, and `scene/`. A new segment
begins each time the session is opened to go on, and every five minutes, so that MCAP's own index of what is open stays small
and little has to be written anew after a kill.

The MCAP file holds everything, for replay and for other programs: chunks of bytes as read (`/raw/LINK`) and events (`/events`,
JSON), which are the segment's *items*, numbered from 0 in MCAP's `sequence` in the order in which they were taken; notes on
what was made of them (`/session`, JSON), numbered with the events by their `n`; and decoded readings (`/wrench`, `/taxels`,
`/joints`, `/temperature`), which skincal does not read back. The other file holds events and notes alone, a line each: see
`documents`.

Every half second, and at every event and note, what is buffered becomes a chunk with a checksum in the MCAP file, and then is
vouched for in the lines; at every contact both are forced onto the medium. So a kill costs half a second of bytes, and whatever
the lines say, the bytes of it are there. A session that is made of another program's recording can be made again: of it two
seconds at a time are written, nothing is forced onto the medium before the end, and no decoded readings are added: other
programs read the recording itself.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import shutil
import time
import tomllib
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import lru_cache, wraps
from io import BufferedWriter
from pathlib import Path
from typing import Any, Concatenate, NoReturn, ParamSpec, cast

import numpy as np
from mcap.writer import Writer

from skincal import __version__
from skincal.geometry import FloatArray
from skincal.journal import documents
from skincal.journal.documents import (
    JOURNAL_FORMAT,
    Ending,
    Item,
    LineWriter,
    Note,
    event_to_json,
    key_of,
    lines_path,
    link_to_json,
    note_to_json,
)
from skincal.journal.lock import SessionLock, writer_of
from skincal.journal.mcap_file import EVENT_TOPIC, NOTE_TOPIC, RAW_TOPIC
from skincal.model.errors import InputError
from skincal.model.given import MESH_MOST, TEXT_MOST, read_regular
from skincal.model.readings import Chunk, Sample
from skincal.model.scene import Scene, load_scene
from skincal.model.tables import read_text
from skincal.streams.links import LinkSpec

FLUSH_NS = 500_000_000
"""ns. What is buffered for so long is written: the most that a kill may cost."""
FLUSH_COPY_NS = 2_000_000_000
"""ns. The same in a session that is made of a recording, by the recording's clock."""
WATCH_NS = 500_000_000
"""ns. So often it is looked whether the file is still where it was made: half a second, since a second is noticed."""
SEGMENT_NS = 300_000_000_000
"""ns. A segment that is so long is followed by another. While it is open the library holds its index, 2 kB a second; after a
kill it is written anew, which takes 1 s for each minute at 1 kHz."""
SEGMENT_NAME = "segment-{:04d}.mcap"
SCENE_FILE = "scene.toml"
MAX_SCENE_FILES = 16
"""TOML files of a scene's folder: a scene and its layout are two, and each may have 4 MB."""
SCENE_FOLDER = "scene"
"""The folder in a session's folder that holds copies of the scene's files, so that it opens on another machine."""
NAMED_FILES = (("skin", "modules"), ("surface", "mesh"))
"""Table and key of each file that a scene names."""
DIGEST_OF_ALL_FILES = "all-files:"
"""Begins a digest that covers the mesh, too. Digests without it are of the TOML files alone."""
_DECODED_TOPICS = {
    "/wrench": "geometry_msgs/msg/WrenchStamped",
    "/taxels": "skincal_msgs/msg/Taxels",
    "/joints": "sensor_msgs/msg/JointState",
    "/temperature": "sensor_msgs/msg/Temperature",
}
CHUNK_BYTES = 16 << 20
"""More than half a second brings, so that MCAP's writer never parts an item from its notes."""


class JournalFailure(Exception):  # noqa: N818 - it is the failure of a device, as LinkError is
    """The journal cannot be written any more: the message says why and what to do. Raised once; the session goes on without."""


def create_session(folder: Path, scene: Scene, links: Sequence[LinkSpec], *, copy: bool = False) -> JournalWriter:
    """Make the folder of a new session and open its first segment.

    Parameters
    ----------
    copy : it is made of a recording, and could be made again

    Raises
    ------
    InputError
        The folder holds a session already, or cannot be made, or the scene's files cannot be copied.
    """
    # Asked first: a folder that is being recorded to is not empty either, and this says more.
    if who := writer_of(folder):
        raise InputError(f"{folder}: is being recorded by {who}; name another folder.")
    _demand_empty(folder)
    made = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); name a folder where you may write.") from None
    with ExitStack() as at_failure:
        if made:
            at_failure.callback(_remove_empty, folder)
        lock = SessionLock(folder)
        at_failure.callback(lock.release)
        _demand_empty(folder)  # another may have been quicker
        at_failure.callback(shutil.rmtree, folder / SCENE_FOLDER, ignore_errors=True)
        copy_scene(scene, folder / SCENE_FOLDER)
        journal = open_segment(folder, scene, links, lock, copy=copy)
        at_failure.pop_all()
    return journal


def _remove_empty(folder: Path) -> None:
    # A folder that is not empty is in use by others.
    with contextlib.suppress(OSError):
        folder.rmdir()


def _demand_empty(folder: Path) -> None:
    if any(folder.glob("segment-*.mcap*")):
        raise InputError(f"{folder}: holds a session already; name another folder, or open this one to go on.")
    if (folder / SCENE_FOLDER).exists():
        raise InputError(f"{folder}: there is a folder {folder / SCENE_FOLDER} already; name an empty or new folder.")


def open_segment(
    folder: Path, scene: Scene, links: Sequence[LinkSpec], lock: SessionLock, *, copy: bool = False
) -> JournalWriter:
    """Open the segment after the last of a session; `InputError` where that is not possible.

    Parameters
    ----------
    lock : of the folder; the new segment's from then on
    copy : as for `create_session`
    """
    number = len(list(folder.glob("segment-*.mcap"))) + 1
    path = folder / SEGMENT_NAME.format(number)
    try:
        return JournalWriter(path, number, scene, links, lock, copy=copy)
    except OSError as error:
        why = error.strerror
        raise InputError(f"{path}: cannot be written ({why}); check the folder's rights and the space on the disk.") from None


P = ParamSpec("P")


def _guarded(work: Callable[Concatenate[JournalWriter, P], None]) -> Callable[Concatenate[JournalWriter, P], None]:
    """Let a method end the journal with a `JournalFailure` the first time that the disk refuses, and do nothing after that."""

    @wraps(work)
    def guarded(self: JournalWriter, /, *args: P.args, **options: P.kwargs) -> None:
        if self.failed:
            return
        try:
            work(self, *args, **options)
        except OSError as error:
            self.fail(error)

    return guarded


class JournalWriter:
    """A session, open for writing; the session lives on in memory where the disk refuses: see `_guarded`.

    Parameters
    ----------
    path, number : of the first segment, a file that does not exist yet, from 1
    scene, links : written at the start of each segment
    lock : of the session's folder, let go at the end
    copy : as for `create_session`

    Raises
    ------
    OSError
        The segment cannot be written; what was made of it is taken away again.
    """

    def __init__(
        self, path: Path, number: int, scene: Scene, links: Sequence[LinkSpec], lock: SessionLock, *, copy: bool = False
    ) -> None:
        self.path = path
        self.failed = ""
        """Why nothing is written any more; empty while all is well."""
        self._number = number
        self._scene, self._links = scene, tuple(links)
        self._frames = 0
        # Chunks carry the monotonic clock; files of other programs want the time of day. One pair of both maps them.
        self._monotonic_ns, self._unix_ns = time.monotonic_ns(), time.time_ns()
        self._flushed_ns: int | None = None
        self._watched_ns = 0
        self._lock = lock
        self._holds_lock = True
        self._copy, self._flush_ns = copy, FLUSH_COPY_NS if copy else FLUSH_NS
        self.wants_decoded = not copy
        """Whether decoded readings are to be added."""
        self._open_segment(self._monotonic_ns, continues=False)

    @_guarded
    def write(self, item: Item, notes: Sequence[Note] = ()) -> None:
        """Append one item and what it led to."""
        if self._begun_ns is None:
            self._begun_ns = item.host_ns
        # An ending belongs to what it ends; its successor may be open already.
        if item.host_ns - self._begun_ns >= SEGMENT_NS and not isinstance(item, Ending):
            self._follow(item.host_ns)
        if isinstance(item, Chunk):
            data = documents.encode_chunk(item.host_ns, item.data)
            self._add(RAW_TOPIC + item.link, self.unix_ns(item.host_ns), data, self._items)
            self._items += 1
        else:
            self._add_event(event_to_json(item))
        for note in notes:
            self._add_document(NOTE_TOPIC, item.host_ns, note_to_json(note), self._items - 1, key_of(note))
        if self._lines_due and not self._copy:
            self._flush()
        self.tick(item.host_ns)

    @_guarded
    def write_sample(self, sample: Sample) -> None:
        """Append a skin frame, and the joint angles with it, decoded, for other programs."""
        at, frame = self.unix_ns(round(sample.host_s * 1e9)), self._scene.link
        self._add("/taxels", at, documents.encode_taxels(at, frame, self._frames, 0, sample.skin))
        self._frames += 1
        if sample.angles is not None:
            self._add("/joints", at, documents.encode_joints(at, frame, _joint_names(len(sample.angles)), sample.angles))

    @_guarded
    def write_wrenches(self, times_s: FloatArray, wrenches: FloatArray) -> None:
        """Append decoded wrenches, for other programs: (n,) s of the host's monotonic clock, (n, 6) N and N m, sensor frame."""
        at = np.maximum(0, np.rint(times_s * 1e9).astype(np.int64) - self._monotonic_ns + self._unix_ns)
        for unix_ns, message in zip(at.tolist(), documents.encode_wrenches(at, "ft_sensor", wrenches), strict=True):
            self._add("/wrench", unix_ns, message.tobytes())

    @_guarded
    def write_temperature(self, host_ns: int, link: str, celsius: float) -> None:
        """Append the temperature that a link's device says, for other programs."""
        at = self.unix_ns(host_ns)
        self._add("/temperature", at, documents.encode_temperature(at, link, celsius))

    @_guarded
    def tick(self, now_ns: int) -> None:
        """Write what is buffered if half a second passed since the last time; call it in any rhythm."""
        if self._flushed_ns is None:
            self._flushed_ns = now_ns
        if self._buffered and now_ns - self._flushed_ns >= self._flush_ns:
            self._flushed_ns = now_ns
            self._flush()
        if now_ns - self._watched_ns >= WATCH_NS:
            self._watched_ns = now_ns
            self._demand_there()

    @_guarded
    def sync(self) -> None:
        """Force everything onto the medium; of what could be made again nothing."""
        if not self._copy:
            self._flush(sync=True)

    def close(self) -> None:
        """Finish the segment, with its index, and let others write."""
        if not self._file.closed:
            self._close_segment()
        self._let_go()

    def fail(self, error: OSError) -> NoReturn:
        """End the journal, since the disk refused: nothing is written any more, and others may write."""
        self.failed = (
            f"{self.path}: cannot be written any more ({error.strerror}); see where the folder is and that there is space."
        )
        self._abandon()
        self._let_go()
        raise JournalFailure(self.failed) from error

    def open_next(self, scene: Scene, links: Sequence[LinkSpec]) -> JournalWriter:
        """Open the segment that follows, which keeps the lock; this one stays open until `close`.

        Raises
        ------
        InputError
            It cannot be opened; this one goes on as if nothing had happened. Or this one failed, and its lock is let go.
        """
        if self.failed:
            raise InputError(self.failed)
        following = open_segment(self.path.parent, scene, links, self._lock)
        self._holds_lock = False
        return following

    @property
    def clock(self) -> documents.WallClock:
        """What time of day it was when this began."""
        return documents.WallClock(self._monotonic_ns / 1e9, self._unix_ns / 1e9)

    def unix_ns(self, host_ns: int) -> int:
        """Return the time of day of a moment of the monotonic clock, ns since 1970."""
        # MCAP's times have no sign.
        return max(0, host_ns - self._monotonic_ns + self._unix_ns)

    def _open_segment(self, host_ns: int, *, continues: bool) -> None:
        self._items = self._vouched = self._documents = 0
        self._lines_due: list[tuple[int, str, bytes]] = []
        self._begun_ns: int | None = None
        self._file: BufferedWriter = self.path.open("xb")
        try:
            self._lines = LineWriter(lines_path(self.path))
            try:
                self._begin(host_ns, continues=continues)
            except OSError:
                self._abandon()
                lines_path(self.path).unlink()
                raise
        except OSError:
            self._file.close()
            self.path.unlink()
            raise

    def _begin(self, host_ns: int, *, continues: bool) -> None:
        self._mcap = Writer(self._file, chunk_size=CHUNK_BYTES)
        self._mcap.start(profile="ros2", library=f"skincal {__version__}")
        about = {
            "format": JOURNAL_FORMAT,
            "segment": self._number,
            "continues": continues,
            "skincal": __version__,
            "numpy": np.__version__,
            "scene": self._scene.text,
            "scene_digest": scene_digest(self.path.parent / SCENE_FOLDER),
            "links": [link_to_json(link) for link in self._links],
            "monotonic_ns": self._monotonic_ns,
            "unix_ns": self._unix_ns,
        }
        texts = {key: value if isinstance(value, str) else json.dumps(value) for key, value in about.items()}
        self._mcap.add_metadata("skincal", texts)
        schemas = {
            name: self._mcap.register_schema(name, "ros2msg", text.encode()) for name, text in documents.MESSAGE_SCHEMAS.items()
        }
        json_schema = self._mcap.register_schema("skincal.event", "jsonschema", b'{"type": "object"}')
        carried = {RAW_TOPIC + link.name: "skincal_msgs/msg/Chunk" for link in self._links}
        carried |= _DECODED_TOPICS if self.wants_decoded else {}
        self._channels = {topic: self._mcap.register_channel(topic, "json", json_schema) for topic in (EVENT_TOPIC, NOTE_TOPIC)}
        self._channels |= {topic: self._mcap.register_channel(topic, "cdr", schemas[name]) for topic, name in carried.items()}
        self._add_event({"host_ns": host_ns, "type": "segment", **about})
        # On the medium at once: a session whose first segment has no beginning is none.
        self._flush(sync=True)

    def _follow(self, host_ns: int) -> None:
        """Go on in another segment."""
        self._close_segment()
        self._number += 1
        self.path = self.path.with_name(SEGMENT_NAME.format(self._number))
        self._open_segment(host_ns, continues=True)
        self._begun_ns = host_ns

    def _add(self, topic: str, unix_ns: int, data: bytes, sequence: int = 0) -> None:
        self._mcap.add_message(self._channels[topic], unix_ns, data, unix_ns, sequence=sequence)
        self._buffered = True

    def _add_event(self, event: dict[str, Any]) -> None:
        self._items += 1
        self._add_document(EVENT_TOPIC, event["host_ns"], event, self._items - 1)

    def _add_document(self, topic: str, host_ns: int, document: dict[str, Any], sequence: int, key: str = "") -> None:
        # A NaN that slipped through would make a line that only Python can read.
        data = json.dumps({"n": self._documents, **document}, allow_nan=False).encode()
        self._add(topic, self.unix_ns(host_ns), data, sequence)
        self._documents += 1
        self._lines_due.append((self._items, key, data))

    def _flush(self, *, sync: bool = False) -> None:
        self._mcap.flush()  # a chunk without messages is not written
        if sync:
            os.fsync(self._file.fileno())
        # Only now: a line vouches for what lies in the other file.
        for line in self._lines_due:
            self._lines.add(*line)
        if self._lines_due:
            self._lines_due = []
        elif self._items > self._vouched:
            self._lines.vouch(self._items)
        self._vouched = self._items
        self._lines.flush(sync=sync)
        self._buffered = False

    @_guarded
    def _close_segment(self) -> None:
        self._flush()
        self._mcap.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        # Last: "closed" vouches for the end of the other file.
        self._lines.close(self._items)
        self._file.close()

    def _demand_there(self) -> None:
        """Raise OSError if the file is no longer in its folder: later writes would be lost."""
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            if os.path.samestat(os.fstat(self._file.fileno()), self.path.stat()):
                return
        raise OSError(errno.ENOENT, "its folder was deleted, moved or unmounted")

    def _abandon(self) -> None:
        """Close the files without an end; an error of the last write is ignored."""
        with contextlib.suppress(OSError):
            self._file.close()
        with contextlib.suppress(OSError, AttributeError):
            self._lines.abandon()

    def _let_go(self) -> None:
        if self._holds_lock:
            self._lock.release()


@lru_cache
def _joint_names(count: int) -> tuple[str, ...]:
    return tuple(f"joint{k}" for k in range(count))


def copy_scene(scene: Scene, folder: Path) -> Path:
    """Copy the scene file and the files it names into `folder`, and return the copy's path.

    The copy names its files by their bare names; all else in it stays as it was, word for word.

    Raises
    ------
    InputError
        A file cannot be read, or the copy does not read as the same scene.
    """
    text = scene.text or read_text(scene.path)
    document = tomllib.loads(text)
    try:
        folder.mkdir(parents=True)
        for table, key in NAMED_FILES:
            if key in document.get(table, {}):
                text = _copy_named(text, table, key, scene.path.parent, folder)
        target = folder / SCENE_FILE
        # Without `newline` Windows would write other line ends than the text has.
        target.write_text(text, encoding="utf-8", newline="")
    except OSError as error:
        why = error.strerror
        raise InputError(f"{folder}: the scene cannot be copied ({why}); check {scene.path} and the space.") from None
    # Refused now, and not when the recorded session is opened.
    load_scene(target)
    if _without_names(tomllib.loads(text)) != _without_names(document):
        raise InputError(
            f"{target}: the copy does not read as {scene.path} does; write the scene's tables in their usual form."
        )
    return target


def _without_names(document: dict[str, Any]) -> dict[str, Any]:
    """Copy a scene's document without the names of its files."""
    left_out = dict(NAMED_FILES)
    return {
        table: {key: value for key, value in cast("dict[str, Any]", content).items() if key != left_out.get(table)}
        if isinstance(content, dict)
        else content
        for table, content in document.items()
    }


def _copy_named(text: str, table: str, key: str, source: Path, folder: Path) -> str:
    """Copy the file that a scene names under `[table] key`; return the scene's text with the copy's bare name."""
    named = str(tomllib.loads(text)[table][key])
    bare = Path(named).name
    while (folder / bare).exists() or bare == SCENE_FILE:
        bare = f"_{bare}"
    data = read_regular(source / named, MESH_MOST)
    (folder / bare).write_bytes(data)
    if bare == named:
        return text
    import tomlkit  # 50 ms, for scenes whose files lie elsewhere

    document: Any = tomlkit.parse(text)
    document[table][key] = bare
    return str(tomlkit.dumps(document))


def scene_digest(folder: Path) -> str:
    """Compute a checksum of the scene, its layout and its mesh in a session's scene folder.

    Raises InputError: a file cannot be read.
    """
    digest = hashlib.sha256(toml_digest(folder).encode())
    with contextlib.suppress(tomllib.TOMLDecodeError):
        document = tomllib.loads(read_text(folder / SCENE_FILE))
        for table, key in NAMED_FILES:
            named = document.get(table, {}).get(key)
            if named is not None:
                digest.update(read_regular(folder / str(named), MESH_MOST))
    return DIGEST_OF_ALL_FILES + digest.hexdigest()


def toml_digest(folder: Path) -> str:
    """Compute the checksum of a scene folder's TOML files alone, as sessions recorded before the mesh was covered hold it.

    Raises InputError: there are too many, or one cannot be read.
    """
    digest = hashlib.sha256()
    paths = sorted(folder.glob("*.toml"))
    if len(paths) > MAX_SCENE_FILES:
        raise InputError(f"{folder}: has {len(paths)} TOML files; expected at most {MAX_SCENE_FILES}: move the others away.")
    for path in paths:
        text = read_regular(path, TEXT_MOST)
        digest.update(f"{path.name} {len(text)}\n".encode())
        digest.update(text)
    return digest.hexdigest()
