"""Write a session to disk while it is recorded: bytes, actions and results.

A session is a folder: `segment-0001.mcap` with the line file `segment-0001.jsonl`, `segment-0002...`, and `scene/`. A new
segment begins each time the session is opened to go on, and every five minutes: so the index of the open MCAP file stays small,
and little must be written again after a crash.

The MCAP file holds the inputs: chunks of bytes as read (`/raw/LINK`) and events (`/events`, JSON). These are the segment's
*items*, numbered from 0 in MCAP's `sequence`. For other programs it also holds decoded readings (`/wrench`, `/taxels`,
`/joints`, `/temperature`), which skincal does not read. The line file holds events and results: see `line_file`.

The buffer is written every 0.5 s and at every event and result: first the MCAP chunk, then the line that confirms it. Contacts
also force both files onto the disk; for a window a thread does (`disk_sync`), also at the end of a segment that another
follows. A crash loses at most 0.5 s of bytes, and every confirmed item is in the MCAP file. A session that is imported from
another program's recording can be imported again: it is written every 2 s, forced onto the disk only at the end, and has no
decoded readings.
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
from functools import cache, wraps
from io import BufferedWriter
from pathlib import Path
from typing import Any, Concatenate, NoReturn, ParamSpec

import numpy as np

from skincal.geometry import FloatArray
from skincal.journal import ros_messages
from skincal.journal.disk_sync import DiskSync
from skincal.journal.documents import (
    JOURNAL_FORMAT_VERSION,
    Item,
    Result,
    SessionClosed,
    WallClock,
    event_to_json,
    key_of,
    link_to_json,
    result_to_json,
)
from skincal.journal.line_file import LineWriter, lines_path
from skincal.journal.lock import SessionLock, describe_lock_holder
from skincal.journal.mcap_file import EVENT_TOPIC, RAW_TOPIC
from skincal.journal.mcap_writer import McapWriter
from skincal.journal.ros_messages import MESSAGE_SCHEMAS
from skincal.model.errors import InputError
from skincal.model.given import MAX_MESH_BYTES, MAX_TEXT_BYTES, read_regular
from skincal.model.readings import Chunk, Sample, Tick
from skincal.model.scene import Scene, load_scene
from skincal.model.tables import read_text
from skincal.streams.links import LinkSpec
from skincal.version import __version__

FLUSH_PERIOD_NS = 500_000_000
"""ns. Longest time in the buffer: the most that a crash may cost."""
IMPORT_FLUSH_PERIOD_NS = 2_000_000_000
"""ns. The same in an imported session, by the recording's clock."""
FILE_PRESENCE_CHECK_PERIOD_NS = 500_000_000
"""ns. Interval of the check that the file is still in its folder."""
SEGMENT_MAX_DURATION_NS = 300_000_000_000
"""ns. Longest segment. While it is open the writer holds its index, 2 kB a second; after a crash it is written again, which
takes 1 s for each minute at 1 kHz."""
SEGMENT_NAME = "segment-{:04d}.mcap"
SCENE_FILE = "scene.toml"
MAX_SCENE_FOLDER_FILES = 16
"""TOML files of a scene's folder: a scene and its layout are two, and each may have 4 MB."""
SCENE_FOLDER = "scene"
"""Folder in a session's folder with copies of the scene's files, so that the session opens on another machine."""
NAMED_FILES = (("skin", "modules"), ("surface", "mesh"), ("robot", "urdf"), ("robot", "mesh"))
"""Table and key of each file that a scene names."""
DIGEST_OF_ALL_FILES = "all-files:"
"""Start of a digest that covers the mesh. Older digests, without it, are of the TOML files only."""
DECODED_TOPICS = {
    "/wrench": "geometry_msgs/msg/WrenchStamped",
    "/taxels": "skincal_msgs/msg/Taxels",
    "/joints": "sensor_msgs/msg/JointState",
    "/temperature": "sensor_msgs/msg/Temperature",
}


class JournalFailure(Exception):  # noqa: N818 - it is the failure of a device, as LinkError is
    """The journal can no longer be written: the message says why and what to do. Raised once; the session goes on in memory."""


def create_session(folder: Path, scene: Scene, links: Sequence[LinkSpec], *, copy: bool = False) -> JournalWriter:
    """Make the folder of a new session and open its first segment.

    Parameters
    ----------
    copy : the session is imported from a recording, and can be imported again

    Raises
    ------
    InputError
        The folder already holds a session, or cannot be made, or the scene's files cannot be copied.
    """
    # Checked first: a folder that is being recorded to is not empty either, and this sentence says more.
    if who := describe_lock_holder(folder):
        raise InputError(f"{folder}: is being recorded by {who}; name another folder.")
    _require_no_session(folder)
    is_new = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); name a folder where you may write.") from None
    with ExitStack() as on_error:
        if is_new:
            on_error.callback(_remove_if_empty, folder)
        lock = SessionLock(folder)
        on_error.callback(lock.release)
        _require_no_session(folder)  # another program may have been faster
        on_error.callback(shutil.rmtree, folder / SCENE_FOLDER, ignore_errors=True)
        copy_scene(scene, folder / SCENE_FOLDER)
        journal = open_segment(folder, scene, links, lock, copy=copy)
        on_error.pop_all()
    return journal


def _remove_if_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):
        folder.rmdir()


def _require_no_session(folder: Path) -> None:
    if any(folder.glob("segment-*.mcap*")):
        raise InputError(f"{folder}: holds a session already; name another folder, or open this one to go on.")
    if (folder / SCENE_FOLDER).exists():
        raise InputError(f"{folder}: there is a folder {folder / SCENE_FOLDER} already; name an empty or new folder.")


def open_segment(
    folder: Path,
    scene: Scene,
    links: Sequence[LinkSpec],
    lock: SessionLock,
    *,
    copy: bool = False,
    disk: DiskSync | None = None,
) -> JournalWriter:
    """Open the segment after the last of a session. Raises InputError: it cannot be written.

    Parameters
    ----------
    lock : of the folder; the new segment owns it from then on
    copy : as in `create_session`
    disk : forces the journal onto the disk in the background; without one the caller waits
    """
    number = len(list(folder.glob("segment-*.mcap"))) + 1
    path = folder / SEGMENT_NAME.format(number)
    try:
        return JournalWriter(path, scene, links, lock, copy=copy, disk=disk)
    except OSError as error:
        why = error.strerror
        raise InputError(f"{path}: cannot be written ({why}); check the folder's rights and the space on the disk.") from None


Params = ParamSpec("Params")


def _stops_on_disk_error(
    work: Callable[Concatenate[JournalWriter, Params], None],
) -> Callable[Concatenate[JournalWriter, Params], None]:
    """Let a method stop the recording with a `JournalFailure` at the first disk error, and do nothing after that."""

    @wraps(work)
    def guarded(self: JournalWriter, /, *args: Params.args, **options: Params.kwargs) -> None:
        if self.failed:
            return
        try:
            self.disk.raise_error()
            work(self, *args, **options)
        except OSError as error:
            self.stop_recording(error)

    return guarded


class JournalWriter:
    """A session, open for writing. After a disk error it lives on in memory: see `_stops_on_disk_error`.

    Parameters
    ----------
    path : of the first segment, a new file, with its number in its name
    scene, links : written at the start of each segment
    lock : of the session's folder, released at the end
    copy : as in `create_session`
    disk : as in `open_segment`

    Raises
    ------
    OSError
        The segment cannot be written; its files are removed again.
    """

    def __init__(
        self,
        path: Path,
        scene: Scene,
        links: Sequence[LinkSpec],
        lock: SessionLock,
        *,
        copy: bool = False,
        disk: DiskSync | None = None,
    ) -> None:
        self.path = path
        self.failed = ""
        """Sentence on the disk error that stopped the recording; empty without one."""
        self._number = int(path.stem.removeprefix("segment-"))
        self._scene, self._links = scene, tuple(links)
        self._frames = 0
        # Chunks have the monotonic clock; other programs need the time of day. One pair of both maps them.
        self._monotonic_ns, self._unix_ns = time.monotonic_ns(), time.time_ns()
        self._flushed_ns: int | None = None
        self._watched_ns = 0
        self.syncs_in_background = disk is not None
        """A thread forces the files onto the disk, as a window needs it; its error stops the recording later."""
        self.disk = disk or DiskSync()
        self._lock = lock
        self._holds_lock = True
        self._copy, self._flush_ns = copy, IMPORT_FLUSH_PERIOD_NS if copy else FLUSH_PERIOD_NS
        self.wants_decoded = not copy
        """Decoded readings are added, too."""
        self._open_files(self._monotonic_ns, continues=False)

    @_stops_on_disk_error
    def write(self, item: Item, results: Sequence[Result] = ()) -> None:
        """Append one item and its results."""
        # The end of a session belongs to its last segment; the next one may be open already.
        if not isinstance(item, SessionClosed):
            self._begin_segment_if_due(item.host_ns)
        if isinstance(item, Chunk):
            self._add_chunk(item)
        else:
            self._add_event(event_to_json(item))
        for result in results:
            self._lines_due.append((self._items, key_of(result), _json_bytes(result_to_json(result))))
        if self._lines_due and not self._copy:
            self._flush()
        self._flush_if_due(item.host_ns)

    @_stops_on_disk_error
    def write_run(self, entries: Sequence[Chunk | Tick | Sample]) -> None:
        """Append chunks without results, and decoded skin frames with their joint angles, for other programs."""
        for entry in entries:
            if isinstance(entry, Sample):
                self._add_sample(entry)
                continue
            if isinstance(entry, Chunk):
                self._begin_segment_if_due(entry.host_ns)
                self._add_chunk(entry)
            self._flush_if_due(entry.host_ns)

    def _begin_segment_if_due(self, host_ns: int) -> None:
        if self._begun_ns is None:
            self._begun_ns = host_ns
        if host_ns - self._begun_ns >= SEGMENT_MAX_DURATION_NS:
            self._continue_in_next(host_ns)

    def _add_chunk(self, chunk: Chunk) -> None:
        data = ros_messages.encode_chunk(chunk.host_ns, chunk.data)
        self._add(RAW_TOPIC + chunk.link, self.unix_ns(chunk.host_ns), data, self._items)
        self._items += 1

    def _add_sample(self, sample: Sample) -> None:
        at, frame = self.unix_ns(round(sample.host_s * 1e9)), self._scene.link
        self._add("/taxels", at, ros_messages.encode_taxels(at, frame, self._frames, sample.skin))
        self._frames += 1
        if sample.angles is not None:
            names = _joint_names(len(sample.angles))
            self._add("/joints", at, ros_messages.encode_joints(at, frame, names, sample.angles))

    @_stops_on_disk_error
    def write_wrenches(self, times_s: FloatArray, wrenches: FloatArray) -> None:
        """Append decoded wrenches, for other programs: (n,) s of the host's monotonic clock, (n, 6) N and N m, sensor frame."""
        at = np.maximum(0, np.rint(times_s * 1e9).astype(np.int64) - self._monotonic_ns + self._unix_ns)
        self._mcap.add_messages(self._channels["/wrench"], at, ros_messages.encode_wrenches(at, "ft_sensor", wrenches))
        self._buffered = True

    @_stops_on_disk_error
    def write_temperature(self, host_ns: int, link: str, celsius: float) -> None:
        """Append the temperature of a link's device, for other programs."""
        at = self.unix_ns(host_ns)
        self._add("/temperature", at, ros_messages.encode_temperature(at, link, celsius))

    @_stops_on_disk_error
    def tick(self, now_ns: int) -> None:
        """Write the buffer if half a second passed since the last time; call it at any rate."""
        self._flush_if_due(now_ns)

    def _flush_if_due(self, now_ns: int) -> None:
        if self._flushed_ns is None:
            self._flushed_ns = now_ns
        if self._buffered and now_ns - self._flushed_ns >= self._flush_ns:
            self._flushed_ns = now_ns
            self._flush()
        if now_ns - self._watched_ns >= FILE_PRESENCE_CHECK_PERIOD_NS:
            self._watched_ns = now_ns
            self._check_file_still_there()

    @_stops_on_disk_error
    def sync(self) -> None:
        """Force everything onto the disk, unless the session can be imported again."""
        if not self._copy:
            self._sync()

    def _sync(self) -> None:
        self._flush(sync=not self.syncs_in_background)
        if self.syncs_in_background:
            self.disk.request(self._file.fileno(), self._lines.fileno())

    def close(self) -> None:
        """Finish the segment, with its index, and release the lock.

        It is on the disk then, unless another segment of the session follows.
        """
        if self._is_open:
            self._close_segment(waits=self._holds_lock)
        self._release_lock()

    def stop_recording(self, error: OSError) -> NoReturn:
        """End the journal after a disk error: nothing is written any more, and others may write."""
        self.failed = (
            f"{self.path}: cannot be written any more ({error.strerror}); see where the folder is and that there is space."
        )
        self._abandon()
        self._release_lock()
        raise JournalFailure(self.failed) from error

    def open_next(self, scene: Scene, links: Sequence[LinkSpec]) -> JournalWriter:
        """Open the next segment, which takes the lock; this one stays open until `close`.

        Raises
        ------
        InputError
            It cannot be opened, and this one is unchanged. Or this one failed before, and its lock is released.
        """
        if self.failed:
            raise InputError(self.failed)
        disk = self.disk if self.syncs_in_background else None
        following = open_segment(self.path.parent, scene, links, self._lock, disk=disk)
        self._holds_lock = False
        return following

    @property
    def clock(self) -> WallClock:
        """Time of day at the beginning."""
        return WallClock(self._monotonic_ns / 1e9, self._unix_ns / 1e9)

    def unix_ns(self, host_ns: int) -> int:
        """Convert a time of the monotonic clock to the time of day, ns since 1970."""
        # MCAP's times have no sign.
        return max(0, host_ns - self._monotonic_ns + self._unix_ns)

    def _open_files(self, host_ns: int, *, continues: bool) -> None:
        self._items = self._confirmed = 0
        self._lines_due: list[tuple[int, str, bytes]] = []
        self._begun_ns: int | None = None
        lines = lines_path(self.path)
        with ExitStack() as on_error:
            self._file: BufferedWriter = self.path.open("xb")
            self._is_open = True
            on_error.callback(self.path.unlink)
            on_error.callback(self._abandon)
            self._lines = LineWriter(lines)
            on_error.callback(lines.unlink)
            on_error.callback(self._abandon)
            self._write_header(host_ns, continues=continues)
            on_error.pop_all()

    def _write_header(self, host_ns: int, *, continues: bool) -> None:
        self._mcap = McapWriter(self._file, profile="ros2", library=f"skincal {__version__}")
        about = {
            "format": JOURNAL_FORMAT_VERSION,
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
        schemas = {name: self._mcap.register_schema(name, "ros2msg", text.encode()) for name, text in MESSAGE_SCHEMAS.items()}
        json_schema = self._mcap.register_schema("skincal.event", "jsonschema", b'{"type": "object"}')
        carried = {RAW_TOPIC + link.name: "skincal_msgs/msg/Chunk" for link in self._links}
        carried |= DECODED_TOPICS if self.wants_decoded else {}
        self._channels = {topic: self._mcap.register_channel(topic, "cdr", schemas[name]) for topic, name in carried.items()}
        self._channels[EVENT_TOPIC] = self._mcap.register_channel(EVENT_TOPIC, "json", json_schema)
        self._add_event({"host_ns": host_ns, "type": "segment", **about})
        # On the disk at once: a session needs the beginning of its first segment.
        self._sync()

    def _continue_in_next(self, host_ns: int) -> None:
        self._close_segment(waits=False)
        self._number += 1
        self.path = self.path.with_name(SEGMENT_NAME.format(self._number))
        self._open_files(host_ns, continues=True)
        self._begun_ns = host_ns

    def _add(self, topic: str, unix_ns: int, data: bytes, sequence: int = 0) -> None:
        self._mcap.add_message(self._channels[topic], unix_ns, data, sequence)
        self._buffered = True

    def _add_event(self, event: dict[str, Any]) -> None:
        data = _json_bytes(event)
        self._add(EVENT_TOPIC, self.unix_ns(event["host_ns"]), data, self._items)
        self._items += 1
        self._lines_due.append((self._items, "", data))

    def _flush(self, *, sync: bool = False) -> None:
        self._mcap.flush()  # writes no empty chunk
        if sync:
            os.fsync(self._file.fileno())
        # Only now: a line confirms items of the MCAP file.
        for line in self._lines_due:
            self._lines.add(*line)
        if not self._lines_due and self._items > self._confirmed:
            self._lines.confirm_items(self._items)
        self._lines_due = []
        self._confirmed = self._items
        self._lines.flush(sync=sync)
        self._buffered = False

    @_stops_on_disk_error
    def _close_segment(self, *, waits: bool) -> None:
        """Finish the segment. With `waits`, or without a thread for it, it is on the disk then."""
        waits = waits or not self.syncs_in_background
        if waits:
            self.disk.wait()
            self.disk.raise_error()
        # A system writes a deleted file without an error.
        self._check_file_still_there()
        self._flush()
        self._mcap.finish()
        self._file.flush()
        if not waits:
            self._is_open = False
            # Before the next segment begins: a segment without its closing line hides the later ones.
            self.disk.force_and_close(self._file, self._lines.end(self._items))
            return
        os.fsync(self._file.fileno())
        # Last: "closed" confirms the end of the MCAP file.
        self._lines.close(self._items)
        self._file.close()
        self._is_open = False

    def _check_file_still_there(self) -> None:
        """Raise OSError if the file is no longer in its folder: later data would be lost."""
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            if os.path.samestat(os.fstat(self._file.fileno()), self.path.stat()):
                return
        raise OSError(errno.ENOENT, "its folder was deleted, moved or unmounted")

    def _abandon(self) -> None:
        """Close the files without an end; errors of the last write are ignored."""
        self._is_open = False
        self.disk.wait()
        with contextlib.suppress(OSError):
            self._file.close()
        with contextlib.suppress(OSError, AttributeError):
            self._lines.abandon()

    def _release_lock(self) -> None:
        if self._holds_lock:
            self._lock.release()


@cache
def _joint_names(count: int) -> tuple[str, ...]:
    return tuple(f"joint{k}" for k in range(count))


def _json_bytes(document: dict[str, Any]) -> bytes:
    # A NaN would make a line that only Python can read.
    return json.dumps(document, allow_nan=False).encode()


def copy_scene(scene: Scene, folder: Path) -> Path:
    """Copy the scene file and the files it names into `folder`, and return the copy's path.

    The copy names its files without folders; the rest of its text is unchanged.

    Raises
    ------
    InputError
        A file cannot be read, or the copy does not read as the same scene.
    """
    text = scene.text or read_text(scene.path)
    document = tomllib.loads(text)
    try:
        folder.mkdir(parents=True)
        if scene.robot is not None and scene.robot.mesh is not None and "mesh" not in document["robot"]:
            # The URDF names a file of a package, which another machine does not have: the copy names its own.
            text = _with_value(text, "robot", "mesh", str(scene.robot.mesh[0].resolve()))
        for table, key in NAMED_FILES:
            if key in tomllib.loads(text).get(table, {}):
                text = _copy_named(text, table, key, scene.path.parent, folder)
        target = folder / SCENE_FILE
        # Without `newline` Windows would write other line ends than the text has.
        target.write_text(text, encoding="utf-8", newline="")
    except OSError as error:
        why = error.strerror
        raise InputError(f"{folder}: the scene cannot be copied ({why}); check {scene.path} and the space.") from None
    load_scene(target)  # refused now, and not when the recorded session is opened
    copied = tomllib.loads(text)
    for table, key in NAMED_FILES:
        if key in copied.get(table, {}):
            document[table][key] = copied[table][key]
    if copied != document:
        raise InputError(
            f"{target}: the copy does not read as {scene.path} does; write the scene's tables in their usual form."
        )
    return target


def _copy_named(text: str, table: str, key: str, source: Path, folder: Path) -> str:
    """Copy the file that a scene names under `[table] key`; return the scene's text with the copy's bare name."""
    named = str(tomllib.loads(text)[table][key])
    bare = Path(named).name
    while (folder / bare).exists() or bare == SCENE_FILE:
        bare = f"_{bare}"
    data = read_regular(source / named, MAX_MESH_BYTES)
    (folder / bare).write_bytes(data)
    if bare == named:
        return text
    return _with_value(text, table, key, bare)


def _with_value(text: str, table: str, key: str, value: str) -> str:
    import tomlkit  # 50 ms, for scenes whose files lie elsewhere

    document: Any = tomlkit.parse(text)
    document[table][key] = value
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
                digest.update(read_regular(folder / str(named), MAX_MESH_BYTES))
    return DIGEST_OF_ALL_FILES + digest.hexdigest()


def toml_digest(folder: Path) -> str:
    """Compute the checksum of a scene folder's TOML files alone, as sessions recorded before the mesh was covered hold it.

    Raises InputError: there are too many, or one cannot be read.
    """
    digest = hashlib.sha256()
    paths = sorted(folder.glob("*.toml"))
    if len(paths) > MAX_SCENE_FOLDER_FILES:
        raise InputError(
            f"{folder}: has {len(paths)} TOML files; expected at most {MAX_SCENE_FOLDER_FILES}: move the others away."
        )
    for path in paths:
        text = read_regular(path, MAX_TEXT_BYTES)
        digest.update(f"{path.name} {len(text)}\n".encode())
        digest.update(text)
    return digest.hexdigest()
