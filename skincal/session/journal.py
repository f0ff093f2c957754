"""What arrived and what the operator did, on the disk as it happens.

A session is a folder: `segment-0001.mcap`, `segment-0002.mcap` ... (one each time it is opened to go on) and `scene/`. The
evidence in a segment is its *items*: chunks as read (`/raw/LINK`), and changes of links and actions of the operator
(`/events`, JSON). Items are numbered from 0 in the order in which they were taken, in the MCAP message's `sequence`; the
first is an event that says what the segment is, and the last of one that was put down in good order says so. Beside them
stand *notes* (`/session`, JSON): what the session took from the detector with an item, and how many readings there were.
Events and notes tell the session without the bytes; their `n` counts both together, and a segment that is closed ends with all
of them once more in one piece (`outline`). Decoded readings (`/wrench`, `/taxels`,
`/joints`) are for other programs, such as Foxglove and PlotJuggler; skincal does not read them back.

Every half second, and at every contact, what is buffered becomes one compressed chunk with a checksum, so that a kill loses
half a second at most; at every contact it is also forced onto the medium. An item with notes has a chunk of its own with
them: whatever is cut off, an item is there with all its notes or not at all, and notes are found without opening the rest.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from io import BufferedWriter
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from mcap.writer import Writer

from skincal import __version__
from skincal.geometry.arrays import FloatArray
from skincal.journal.lock import SessionLock, writer_of
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, LinkEvent, Sample, Stream
from skincal.model.scene import Scene
from skincal.session import cdr
from skincal.session.actions import Stamped, to_json
from skincal.session.outline import MEDIA_TYPE, NAME, OutlineWriter
from skincal.session.packed import ChunkIndexes
from skincal.session.scene_copy import SCENE_FOLDER, copy_scene, scene_digest
from skincal.session.taken import Taken, taken_to_json
from skincal.session.totals import Totals, totals_to_json
from skincal.streams.links import LinkSpec

FORMAT = 2
"""Version of the folder's form; a reader refuses a newer one. 1 had no notes."""
FLUSH_NS = 500_000_000
"""ns. What is buffered for so long is written: the most that a kill may cost."""
SEGMENT_NAME = "segment-{:04d}.mcap"
RAW_TOPIC = "/raw/"
EVENT_TOPIC = "/events"
NOTE_TOPIC = "/session"
_CHUNK_SIZE = 16 << 20
"""Bytes. More than half a second brings, so that MCAP's writer never parts an item from its notes."""


@dataclass(frozen=True, slots=True)
class Ending:
    """Here the session was put down in good order."""

    host_ns: int


Item: TypeAlias = Chunk | LinkEvent | Stamped | Ending
Note: TypeAlias = Taken | Totals


class JournalFailure(Exception):  # noqa: N818 - it is the failure of a device, as LinkFailure is
    """The journal cannot be written any more: the message says why and what to do. Raised once; the session goes on without."""


def create_session(folder: Path, scene: Scene, links: Sequence[LinkSpec]) -> JournalWriter:
    """Make the folder of a new session and open its first segment.

    Raises
    ------
    InputError
        The folder holds a session already, or cannot be made, or the scene's files cannot be copied.
    """
    who = writer_of(folder)
    if who:
        raise InputError(f"{folder}: is being recorded by {who}; name another folder.")
    _demand_empty(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); name a folder where you may write.") from None
    lock = SessionLock(folder)
    try:
        _demand_empty(folder)  # another may have been quicker
        copy_scene(scene, folder / SCENE_FOLDER)
        return open_segment(folder, scene, links, lock)
    except InputError:
        lock.release()
        raise


def _demand_empty(folder: Path) -> None:
    if any(folder.glob("segment-*.mcap*")):
        raise InputError(f"{folder}: holds a session already; name another folder, or open this one to go on.")
    if (folder / SCENE_FOLDER).exists():
        raise InputError(f"{folder}: there is a folder {folder / 'scene'} already; name an empty or new folder.")


def open_next_segment(folder: Path, scene: Scene, links: Sequence[LinkSpec]) -> JournalWriter:
    """Open the segment after the last of a session that nobody writes; `InputError` where that is not possible."""
    lock = SessionLock(folder)
    try:
        return open_segment(folder, scene, links, lock)
    except InputError:
        lock.release()
        raise


def open_segment(folder: Path, scene: Scene, links: Sequence[LinkSpec], lock: SessionLock) -> JournalWriter:
    """Open the segment after the last of a session; `InputError` where that is not possible.

    Parameters
    ----------
    lock : of the folder; the new segment's from then on
    """
    number = len(list(folder.glob("segment-*.mcap"))) + 1
    path = folder / SEGMENT_NAME.format(number)
    try:
        return JournalWriter(path, number, scene, links, lock)
    except (OSError, JournalFailure) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{path}: cannot be written ({why}); check the folder's rights and the space on the disk.") from None


class JournalWriter:
    """One segment, open for writing.

    Parameters
    ----------
    path : a file that does not exist yet
    number : of the segment, from 1
    scene, links : written at the start
    lock : of the session's folder, let go with the segment's end
    """

    def __init__(self, path: Path, number: int, scene: Scene, links: Sequence[LinkSpec], lock: SessionLock) -> None:
        self.path = path
        self._lock = lock
        self._holds_lock = False  # before it stands, the lock is the caller's
        self.failed = ""
        """Why nothing is written any more; empty while all is well."""
        self._file: BufferedWriter = path.open("xb")
        self._mcap = Writer(self._file, chunk_size=_CHUNK_SIZE)
        # The library has no way to do this. Where it names its list otherwise, memory grows and nothing else happens.
        vars(self._mcap)["_Writer__chunk_indices"] = ChunkIndexes()
        self._channels: dict[str, int] = {}
        self._items = 0
        self._told = 0
        self._outline = OutlineWriter()
        self._frames = 0
        self._flushed_ns: int | None = None
        self._buffered = False
        # Chunks carry the monotonic clock; files of other programs want the time of day. One pair of both maps them.
        self._monotonic_ns, self._unix_ns = time.monotonic_ns(), time.time_ns()
        self._frame = scene.link
        self._guarded(lambda: self._begin(number, scene, links))
        self._holds_lock = True

    def write(self, item: Item, notes: Sequence[Note] = ()) -> None:
        """Append one item and what it led to.

        Raises
        ------
        JournalFailure
            The first time that the disk refuses; later items are dropped silently, the session lives on in memory.
        """
        self._guarded(lambda: self._write(item, notes))

    def write_sample(self, sample: Sample) -> None:
        """Append a skin frame, and the joint angles with it, decoded, for other programs."""
        self._guarded(lambda: self._write_sample(sample))

    def write_wrenches(self, times_s: FloatArray, wrenches: FloatArray) -> None:
        """Append decoded wrenches, for other programs.

        Parameters
        ----------
        times_s : (n,) float, s, host's monotonic clock
        wrenches : (n, 6) float, N and N m, sensor frame
        """
        self._guarded(lambda: self._write_wrenches(times_s, wrenches))

    def tick(self, now_ns: int) -> None:
        """Write what is buffered if half a second passed since the last time; call it in any rhythm."""
        if self._flushed_ns is None:
            self._flushed_ns = now_ns
        if self._buffered and now_ns - self._flushed_ns >= FLUSH_NS:
            self._flushed_ns = now_ns
            self._guarded(self._flush)

    def sync(self) -> None:
        """Force everything onto the medium."""
        self._guarded(lambda: self._flush(sync=True))

    def close(self) -> None:
        """Finish the segment, with its index, and let others write."""
        if not self._file.closed:
            self._guarded(self._finish)
        self._let_go()

    def open_next(self, scene: Scene, links: Sequence[LinkSpec]) -> JournalWriter:
        """Open the segment that follows, which keeps the lock; this one stays open until `close`.

        Raises
        ------
        InputError
            It cannot be opened; this one goes on as if nothing had happened.
        """
        following = open_segment(self.path.parent, scene, links, self._lock)
        self._holds_lock = False
        return following

    def unix_ns(self, host_ns: int) -> int:
        """Return the time of day of a moment of the monotonic clock, ns since 1970."""
        return max(0, host_ns - self._monotonic_ns + self._unix_ns)

    def _begin(self, number: int, scene: Scene, links: Sequence[LinkSpec]) -> None:
        self._mcap.start(profile="ros2", library=f"skincal {__version__}")
        about = {
            "format": FORMAT,
            "segment": number,
            "skincal": __version__,
            "numpy": np.__version__,
            "scene": scene.text,
            "scene_digest": scene_digest(self.path.parent / SCENE_FOLDER),
            "links": [_link_json(link) for link in links],
            "monotonic_ns": self._monotonic_ns,
            "unix_ns": self._unix_ns,
        }
        texts = {key: value if isinstance(value, str) else json.dumps(value) for key, value in about.items()}
        self._mcap.add_metadata("skincal", texts)
        schemas = {name: self._mcap.register_schema(name, "ros2msg", text.encode()) for name, text in cdr.SCHEMAS.items()}
        json_schema = self._mcap.register_schema("skincal.event", "jsonschema", b'{"type": "object"}')
        for topic in (EVENT_TOPIC, NOTE_TOPIC):
            self._channels[topic] = self._mcap.register_channel(topic, "json", json_schema)
        for link in links:
            topic = RAW_TOPIC + link.name
            self._channels[topic] = self._mcap.register_channel(topic, "cdr", schemas["skincal_msgs/msg/Chunk"])
        for topic, name in (
            ("/wrench", "geometry_msgs/msg/WrenchStamped"),
            ("/taxels", "skincal_msgs/msg/Taxels"),
            ("/joints", "sensor_msgs/msg/JointState"),
        ):
            self._channels[topic] = self._mcap.register_channel(topic, "cdr", schemas[name])
        self._add_event(self._monotonic_ns, {"type": "segment", **about})
        self._flush(sync=True)

    def _write(self, item: Item, notes: Sequence[Note]) -> None:
        apart = bool(notes) or isinstance(item, Stamped | Ending)
        if apart:
            self._flush()
        self._add(item)
        for note in notes:
            kind, body = ("taken", taken_to_json(note)) if isinstance(note, Taken) else ("totals", totals_to_json(note))
            self._add_json(NOTE_TOPIC, item.host_ns, {"type": kind, **body}, self._items - 1, note)
        if apart:
            self._flush()
        self.tick(item.host_ns)

    def _add(self, item: Item) -> None:
        if isinstance(item, Chunk):
            at = self.unix_ns(item.host_ns)
            data = cdr.encode_chunk(item.host_ns, item.data)
            self._mcap.add_message(self._channels[RAW_TOPIC + item.link], at, data, at, sequence=self._items)
            self._items += 1
            self._buffered = True
        elif isinstance(item, LinkEvent):
            event = {"type": "link", "link": item.link, "state": item.state.value, "text": item.text}
            self._add_event(item.host_ns, event)
        elif isinstance(item, Ending):
            self._add_event(item.host_ns, {"type": "end"})
        else:
            self._add_event(item.host_ns, {"type": "action", **to_json(item.action)})

    def _write_sample(self, sample: Sample) -> None:
        at = self.unix_ns(round(sample.host_s * 1e9))
        values = cdr.encode_taxels(at, self._frame, self._frames, 0, sample.skin)
        self._frames += 1
        self._mcap.add_message(self._channels["/taxels"], at, values, at)
        if sample.angles is not None:
            names = tuple(f"joint{k}" for k in range(len(sample.angles)))
            self._mcap.add_message(self._channels["/joints"], at, cdr.encode_joints(at, self._frame, names, sample.angles), at)
        self._buffered = True

    def _write_wrenches(self, times_s: FloatArray, wrenches: FloatArray) -> None:
        for host_s, wrench in zip(times_s.tolist(), wrenches, strict=True):
            at = self.unix_ns(round(host_s * 1e9))
            self._mcap.add_message(self._channels["/wrench"], at, cdr.encode_wrench(at, "ft_sensor", wrench), at)
        self._buffered = True

    def _add_event(self, host_ns: int, event: dict[str, Any]) -> None:
        self._add_json(EVENT_TOPIC, host_ns, {"host_ns": host_ns, **event}, self._items)
        self._items += 1

    def _add_json(self, topic: str, host_ns: int, document: dict[str, Any], sequence: int, note: Note | None = None) -> None:
        at = self.unix_ns(host_ns)
        data = json.dumps({"n": self._told, **document}, allow_nan=False).encode()
        self._outline.add(data, note)
        self._mcap.add_message(self._channels[topic], at, data, at, sequence=sequence)
        self._told += 1
        self._buffered = True

    def _flush(self, *, sync: bool = False) -> None:
        self._mcap.flush()  # a chunk without messages is not written
        self._buffered = False
        if sync:
            os.fsync(self._file.fileno())

    def _finish(self) -> None:
        self._flush()
        outline = self._outline.finish()
        if outline:
            now_ns = time.time_ns()
            self._mcap.add_attachment(now_ns, now_ns, NAME, MEDIA_TYPE, outline)
        self._mcap.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()

    def _let_go(self) -> None:
        if self._holds_lock:
            self._lock.release()

    def _guarded(self, work: Callable[[], None]) -> None:
        """Do work on the file; a refusal of the disk ends the journal, once."""
        if self.failed:
            return
        try:
            work()
        except OSError as error:
            self.failed = (
                f"{self.path}: cannot be written any more ({error.strerror}). Pokes from here on are kept in memory only: "
                "export the calibration now, make space, and open the session again to record on."
            )
            with contextlib.suppress(OSError):
                self._file.close()  # tries to write once more, and is closed all the same
            self._let_go()
            raise JournalFailure(self.failed) from error


def _link_json(link: LinkSpec) -> dict[str, Any]:
    return {
        "name": link.name,
        "address": link.address,
        "carries": [stream.value for stream in link.carries],
        "format": link.format,
    }


def link_specs(documents: Iterable[dict[str, Any]]) -> tuple[LinkSpec, ...]:
    """Return the links that a segment was recorded from."""
    return tuple(
        LinkSpec(
            name=str(link["name"]),
            address=str(link["address"]),
            carries=tuple(Stream(value) for value in link["carries"]),
            format=str(link["format"]),
        )
        for link in documents
    )
