"""Bags of ROS 1 and ROS 2 as topics and messages in bytes.

A bag is a `.bag` file (ROS 1), a folder with `metadata.yaml`, or a single `.mcap` or `.db3` file (ROS 2). A folder whose
recorder was killed has no `metadata.yaml`. The files of a folder are read one by one. Files and messages that are compressed
by zstd are unpacked. `rosbags`, which is imported with the first bag, reads all but MCAP files (`mcap_bag`) and unfinished bags
of ROS 1 (`unfinished_bag`).
"""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from heapq import merge
from pathlib import Path
from typing import Any, Literal

import zstandard

from skincal.files.importers.file_order import messages_in_file_order
from skincal.files.importers.mcap_bag import McapFile
from skincal.files.importers.unfinished_bag import UnfinishedBag
from skincal.model.errors import InputError
from skincal.ros.types import MessageTypes

CLOCK_SET_BACK = "the recorder's clock was set back, as by a simulation that began again: its file's order was kept."
METADATA_NAME = "metadata.yaml"
STORAGE_SUFFIXES = (".mcap", ".db3")
ROS1_SUFFIXES = (".bag", ".active")
ZSTD_SUFFIXES = (".zstd", ".zst")
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""No message of ROS 2 begins with it: its first byte is 0."""
MESSAGE_MAX_BYTES = 1 << 28
"""Of an unpacked message: a damaged one must not fill the memory."""
SPREAD_PARTS = 16
"""Parts of a bag from which messages are read to see whether they change."""
SPREAD_PART_NS = 500_000_000
"""ns. Topics of 5 Hz have two messages in each part."""
LEFT_OUT_TOPICS_LISTED_MAX = 6
"""Topics without messages of ROS that a sentence lists."""


@dataclass(frozen=True, slots=True)
class BagTopic:
    """A topic of a bag."""

    name: str
    type_name: str
    """Empty if its messages are of several types."""
    messages: int
    """Number, as the bag's index has it."""
    encoding: str = ""
    """Of messages that are not those of ROS and are not read; empty for others."""

    @property
    def kind(self) -> str:
        """Type or encoding of its messages for the operator."""
        return self.encoding or self.type_name or "several types"


class Bag:
    """An open bag; use it in a `with` statement.

    Raises InputError: there is no bag, it cannot be read, or the package `rosbags` is missing.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.findings: list[str] = []
        """Sentences on the state of the bag."""
        self.damage = ""
        """Why reading ended before the end of a file of the bag; empty if it did not."""
        self._stack = contextlib.ExitStack()
        self._readers: list[Any] = []
        self.ros: Literal[1, 2] = 1 if self.path.suffix in ROS1_SUFFIXES else 2
        self.types = MessageTypes(self.ros)
        """Definitions of the types of those topics that were defined by `define`."""
        try:
            self._open()
        except BaseException:
            self.close()
            raise
        if any(isinstance(each, McapFile) and each.ros == 1 for each in self._readers):
            self.ros, self.types = 1, MessageTypes(1)
        self._connections = [each for reader in self._readers for each in reader.connections]
        self.topics = self._find_topics()
        """By name."""

    def _open(self) -> None:
        broken: list[InputError] = []
        for file in self._files():
            try:
                reader = self._open_file(self._unpacked(file))
            except Exception as error:  # noqa: BLE001 - a damaged file can raise anything in the library
                broken.append(self._broken(file, error))
                continue
            self._readers.append(reader)
            self._stack.callback(reader.close)
            if isinstance(reader, McapFile | UnfinishedBag) and reader.cut_off:
                self.findings.append(
                    f"{file.name} is damaged, or its recorder was killed ({reader.cut_off}): it was read up to its last whole "
                    "part, and everything after it is missing."
                )
        if broken and not self._readers:
            raise broken[0]
        self.findings += [f"{error} Its messages are missing." for error in broken]

    def _open_file(self, file: Path) -> Any:
        """Open a file. Raises any exception: it cannot be read."""
        if file.suffix == ".mcap":
            found = McapFile(file)
            if not found.connections and not found.left_out and found.cut_off:
                found.close()
                raise ValueError(f"it is cut off before its first message: {found.cut_off}")
            return found
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2

        reader: Any = (Reader1 if file.suffix in ROS1_SUFFIXES else Reader2)(file)
        try:
            reader.open()
        except KeyError:
            # The recorder found no definition of a type, and says that its language is "unknown", which the library refuses.
            reader = Reader2(self._without_unknown_definitions(file))
            reader.open()
        except Exception:
            if file.suffix not in ROS1_SUFFIXES or not (unfinished := UnfinishedBag(file)).connections:
                raise
            return unfinished
        return reader

    def _without_unknown_definitions(self, file: Path) -> Path:
        """Copy a database of ROS 2 and empty the definitions in it that are in no known language."""
        copied = self._make_folder() / file.name
        shutil.copyfile(file, copied)
        with contextlib.closing(sqlite3.connect(copied)) as database:
            database.execute(
                "UPDATE message_definitions SET encoding = 'ros2msg', encoded_message_definition = '' "
                "WHERE encoding NOT IN ('ros2msg', 'ros2idl')"
            )
            database.commit()
        return copied

    def _make_folder(self) -> Path:
        """Make a temporary folder that lives as long as the bag is open."""
        return Path(self._stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True)))

    def _unpacked(self, file: Path) -> Path:
        """Unpack a file that is compressed by zstd into a temporary folder."""
        if file.suffix not in ZSTD_SUFFIXES:
            return file
        folder = self._make_folder()
        with file.open("rb") as packed, (folder / file.stem).open("wb") as unpacked:
            zstandard.ZstdDecompressor().copy_stream(packed, unpacked)
        return folder / file.stem

    def _files(self) -> list[Path]:
        path = self.path
        if not path.exists():
            raise InputError(f"{path}: there is no such bag; expected a .bag file, or the folder that `ros2 bag record` made.")
        if path.is_file():
            return [path]
        if (path / METADATA_NAME).is_file() and (named := self._files_of_metadata()):
            return named
        files = sorted(each for each in path.iterdir() if _is_storage(each))
        if not files:
            raise InputError(
                f"{path}: the folder has no {METADATA_NAME} and no .mcap or .db3 file, nor a .zstd file of one; "
                "expected a bag of ROS 2."
            )
        if logs := [each.name for each in files if each.with_name(f"{each.name}-wal").exists()]:
            self.findings.append(
                f"the recorder of {logs[0]} was killed: its last messages are in {logs[0]}-wal and are not read. To have them, "
                f"run: sqlite3 {logs[0]} 'PRAGMA wal_checkpoint'."
            )
        lack = "no usable" if (path / METADATA_NAME).is_file() else "no"
        self.findings.append(
            f"it has {lack} {METADATA_NAME}, since its recorder was killed or it was copied in part; "
            f"{', '.join(f.name for f in files)} was read."
        )
        return files

    def _files_of_metadata(self) -> list[Path]:
        """List the files that the metadata of a folder names and that are there, to read each alone."""
        from ruamel.yaml import YAML

        try:
            metadata: Any = YAML(typ="safe").load(self.path / METADATA_NAME)  # pyright: ignore[reportUnknownMemberType]
            names = metadata["rosbag2_bagfile_information"]["relative_file_paths"]
            parts = [self.path / Path(name).name for name in names]
        except Exception:  # noqa: BLE001 - damaged YAML can raise anything in the library
            return []
        # Unpacked by hand, a file has the name without `.zstd`.
        parts = [part if part.is_file() or part.suffix not in ZSTD_SUFFIXES else part.with_suffix("") for part in parts]
        found = [part for part in parts if part.is_file() and _is_storage(part)]
        if not found:
            return []
        self.findings += [
            f"{part.name}, which its {METADATA_NAME} names, is not there. Its messages are missing."
            for part in parts
            if part not in found
        ]
        return found

    def _broken(self, file: Path, error: Exception) -> InputError:
        """Make a sentence of an error of the library at opening."""
        why = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        advice = "It is damaged or no bag"
        if file.suffix == ".db3":
            advice += "; if it was cut off, repair a copy of it: sqlite3 FILE .recover | sqlite3 NEW"
        return InputError(f"{file}: the bag cannot be opened ({why}). {advice}.")

    def _find_topics(self) -> dict[str, BagTopic]:
        by_name = dict[str, list[Any]]()
        for each in self._connections:
            by_name.setdefault(each.topic, []).append(each)
        return {
            name: BagTopic(name, _only_type(found), sum(each.msgcount for each in found)) for name, found in by_name.items()
        } | {name: BagTopic(name, "", 0, encoding) for name, encoding in self._left_out().items() if name not in by_name}

    def _left_out(self) -> dict[str, str]:
        """Report the topics without messages of ROS, and return their encodings by name."""
        found = dict[str, str]()
        for reader in self._readers:
            found |= getattr(reader, "left_out", {})
        if found:
            words = [f"{name} ({encoding})" for name, encoding in list(found.items())[:LEFT_OUT_TOPICS_LISTED_MAX]]
            more = len(found) - len(words)
            self.findings.append(
                f"left out, since the messages are not those of ROS: {', '.join(words)}{f' and {more} more' if more else ''}."
            )
        return found

    def define(self, topic: str) -> None:
        """Add the definition that the bag has of a topic's type. Raises InputError: it cannot be used."""
        for each in self._connections:
            if each.topic != topic or not each.msgdef.data:
                continue
            try:
                self.types.add_definition(each.msgtype, each.msgdef.data, "idl" if each.msgdef.format.name == "IDL" else "msg")
            except InputError:
                # The definition of ROS itself is known.
                if not self.types.is_standard(each.msgtype):
                    raise

    def messages(self, topics: Collection[str], *, in_file_order: bool = False) -> Iterator[tuple[str, int, bytes]]:
        """Yield topic, time of arrival (ns) and bytes of the messages of some topics, in order of arrival.

        With `in_file_order` they follow each other as in the file, if the recorder's clock was set back.

        Where a file is damaged its messages end, and `damage` says why; those of the other files go on.
        """
        self.damage = ""
        wanted_of = [
            (reader, wanted)
            for reader in self._readers
            if (wanted := [each for each in reader.connections if each.topic in topics])
        ]
        sources = [self._messages_of(*each) for each in wanted_of]
        if in_file_order and len(wanted_of) == 1:
            # A damaged file is read as any other one, which says where.
            with contextlib.suppress(Exception):
                if (read := messages_in_file_order(*wanted_of[0])) is not None:
                    sources = [self._messages_of(*wanted_of[0], read=read)]
                    self.findings.append(CLOCK_SET_BACK)
        for connection, arrival_ns, data in sources[0] if len(sources) == 1 else merge(*sources, key=_arrival_of):
            yield connection.topic, arrival_ns, data

    def spread_messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield some messages of topics from all parts of the bag: where there is an index, without reading the others."""
        for reader in self._readers:
            wanted = [each for each in reader.connections if each.topic in topics]
            first, last = reader.start_time, reader.end_time
            if not wanted or last < first:
                continue
            if not getattr(reader, "is_indexed", True):
                yield from self._every_nth(reader, wanted)
                continue
            for part in range(SPREAD_PARTS):
                start = first + (last - first) * part // SPREAD_PARTS
                seen = set[str]()
                for connection, arrival_ns, data in self._messages_of(reader, wanted, start, start + SPREAD_PART_NS):
                    if connection.topic not in seen:
                        seen.add(connection.topic)
                        yield connection.topic, arrival_ns, data

    def _every_nth(self, reader: Any, wanted: Sequence[Any]) -> Iterator[tuple[str, int, bytes]]:
        steps = {each.id: max(1, each.msgcount // SPREAD_PARTS) for each in wanted}
        counts = dict.fromkeys(steps, 0)
        for connection, arrival_ns, data in self._messages_of(reader, wanted):
            if counts[connection.id] % steps[connection.id] == 0:
                yield connection.topic, arrival_ns, data
            counts[connection.id] += 1

    def _messages_of(
        self,
        reader: Any,
        wanted: Sequence[Any],
        start: int | None = None,
        stop: int | None = None,
        read: Callable[[], Iterator[tuple[Any, int, bytes]]] | None = None,
    ) -> Iterator[tuple[Any, int, bytes]]:
        try:
            for connection, arrival_ns, data in reader.messages(wanted, start, stop) if read is None else read():
                yield connection, arrival_ns, _unpack_message(data) if data[:4] == ZSTD_MAGIC else data
        except Exception as error:  # noqa: BLE001 - a damaged file can raise anything in the library
            why = " ".join(str(error).split()).rstrip(".") or type(error).__name__
            where = f"{reader.path.name}: " if len(self._readers) > 1 else ""
            self.damage = "; ".join(filter(None, [self.damage, where + why]))

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last arrival, ns, as the bag's index has them."""
        return min(each.start_time for each in self._readers), max(each.end_time for each in self._readers)

    def close(self) -> None:
        """Close its files."""
        with contextlib.suppress(Exception):
            self._stack.close()

    def __enter__(self) -> Bag:
        """Return the bag."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close its files."""
        self.close()


def _only_type(connections: list[Any]) -> str:
    names = {each.msgtype for each in connections}
    return names.pop() if len(names) == 1 else ""


def _is_storage(file: Path) -> bool:
    """Whether a file is named like one of a bag of ROS 2, compressed or not."""
    name = file.with_suffix("") if file.suffix in ZSTD_SUFFIXES else file
    return name.suffix in STORAGE_SUFFIXES


def _unpack_message(data: bytes) -> bytes:
    """Unpack a message that is compressed by zstd; a damaged one is returned unchanged, and no message of its type."""
    try:
        return zstandard.ZstdDecompressor().stream_reader(data).read(MESSAGE_MAX_BYTES)
    except zstandard.ZstdError:
        return data


def _arrival_of(message: tuple[Any, int, bytes]) -> int:
    return message[1]
