"""Bags of ROS 1 and ROS 2 as topics and messages in bytes, read by `rosbags`, which is imported with the first bag.

A bag is a `.bag` file (ROS 1), a folder with `metadata.yaml`, or a single `.mcap` or `.db3` file (ROS 2). A folder whose
recorder was killed has no `metadata.yaml`. Several files of a folder are read one by one.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from heapq import merge
from pathlib import Path
from typing import Any, Literal

from skincal.model.errors import InputError
from skincal.ros.types import MessageTypes

METADATA_NAME = "metadata.yaml"
STORAGE_SUFFIXES = (".mcap", ".db3")
ROS1_SUFFIXES = (".bag", ".active")
_REPAIR_COMMANDS = {
    ".bag": "rosbag reindex FILE",
    ".active": "rosbag reindex FILE",
    ".mcap": "mcap recover FILE -o NEW",
    ".db3": "sqlite3 FILE .recover | sqlite3 NEW",
}
"""Command of the recorder's makers that repairs a file."""


@dataclass(frozen=True, slots=True)
class BagTopic:
    """A topic of a bag."""

    name: str
    type_name: str
    """Empty if its messages are of several types."""
    messages: int
    """Number, as the bag's index has it."""


class Bag:
    """An open bag; use it in a `with` statement.

    Raises InputError: there is no bag, it cannot be read, or the package `rosbags` is missing.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.ros: Literal[1, 2] = 1 if path.suffix in ROS1_SUFFIXES else 2
        self.types = MessageTypes(self.ros)
        """Definitions of the types of those topics that were defined by `define`."""
        self.findings: list[str] = []
        """Sentences on the state of the bag."""
        self.damage = ""
        """Why reading ended before the end of a file of the bag; empty if it did not."""
        self._stack = contextlib.ExitStack()
        self._readers: list[Any] = []
        try:
            self._open()
        except BaseException:
            self.close()
            raise
        self._connections = [each for reader in self._readers for each in reader.connections]
        self.topics = self._find_topics()
        """By name."""

    def _open(self) -> None:
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2

        broken: list[InputError] = []
        for file in self._files():
            try:
                reader = (Reader1 if self.ros == 1 else Reader2)(file)
                reader.open()
            except Exception as error:  # noqa: BLE001 - a damaged file can raise anything in the library
                broken.append(self._broken(file, error))
                continue
            self._readers.append(reader)
            self._stack.callback(reader.close)
        if broken and not self._readers:
            raise broken[0]
        self.findings += [f"{error} Its messages are missing." for error in broken]

    def _files(self) -> list[Path]:
        path = self.path
        if not path.exists():
            raise InputError(f"{path}: there is no such bag; expected a .bag file, or the folder that `ros2 bag record` made.")
        if path.is_file():
            return [path]
        if (path / METADATA_NAME).is_file():
            return self._parts() or [path]
        files = sorted(each for each in path.iterdir() if each.suffix in STORAGE_SUFFIXES)
        if not files:
            raise InputError(f"{path}: the folder has no {METADATA_NAME} and no .mcap or .db3 file; expected a bag of ROS 2.")
        if logs := [each.name for each in files if each.with_name(f"{each.name}-wal").exists()]:
            self.findings.append(
                f"the recorder of {logs[0]} was killed: its last messages are in {logs[0]}-wal and are not read. To have them, "
                f"run: sqlite3 {logs[0]} 'PRAGMA wal_checkpoint'."
            )
        self.findings.append(
            f"it has no {METADATA_NAME}, since its recorder was killed; {', '.join(f.name for f in files)} was read."
        )
        return files

    def _parts(self) -> list[Path]:
        """List the files of a folder with several, to read each alone: a damaged one then leaves the others; else nothing."""
        from ruamel.yaml import YAML

        try:
            metadata: Any = YAML(typ="safe").load(self.path / METADATA_NAME)  # pyright: ignore[reportUnknownMemberType]
            known = metadata["rosbag2_bagfile_information"]
            parts = [self.path / Path(name).name for name in known["relative_file_paths"]]
            is_compressed = str(known.get("compression_mode") or "NONE").upper() != "NONE"
        except Exception:  # noqa: BLE001 - the library that reads the folder as a whole says what is wrong
            return []
        found = [part for part in parts if part.is_file()]
        if len(parts) < 2 or is_compressed or not found:
            return []
        missing = [part.name for part in parts if part not in found]
        self.findings += [
            f"{name}, which its {METADATA_NAME} names, is not there. Its messages are missing." for name in missing
        ]
        return found

    def _broken(self, file: Path, error: Exception) -> InputError:
        """Make a sentence of an error of the library at opening."""
        why = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        inside = [file] if file.is_file() else sorted(each for each in file.iterdir() if each.suffix in STORAGE_SUFFIXES)
        repair = _REPAIR_COMMANDS.get(inside[0].suffix if inside else "", "ros2 bag reindex FOLDER")
        return InputError(f"{file}: the bag cannot be opened ({why}). It may be cut off; repair a copy of it: {repair}")

    def _find_topics(self) -> dict[str, BagTopic]:
        by_name = dict[str, list[Any]]()
        for each in self._connections:
            by_name.setdefault(each.topic, []).append(each)
        return {
            name: BagTopic(name, _only_type(found), sum(each.msgcount for each in found)) for name, found in by_name.items()
        }

    def define(self, topic: str) -> None:
        """Add the definition that the bag has of a topic's type. Raises InputError: it cannot be used."""
        for each in self._connections:
            if each.topic == topic and each.msgdef.data:
                self.types.add_definition(each.msgtype, each.msgdef.data)

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield topic, time of arrival (ns) and bytes of the messages of some topics, in order of arrival.

        Where a file is damaged its messages end, and `damage` says why; those of the other files go on.
        """
        self.damage = ""
        sources = [
            self._messages_of(reader, wanted)
            for reader in self._readers
            if (wanted := [each for each in reader.connections if each.topic in topics])
        ]
        for connection, arrival_ns, data in sources[0] if len(sources) == 1 else merge(*sources, key=_arrival_of):
            yield connection.topic, arrival_ns, data

    def _messages_of(self, reader: Any, wanted: Sequence[Any]) -> Iterator[tuple[Any, int, bytes]]:
        try:
            yield from reader.messages(connections=wanted)
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


def _arrival_of(message: tuple[Any, int, bytes]) -> int:
    return message[1]
