"""Bags of ROS 1 without an index, such as the `.bag.active` of a killed recorder, read from their beginning.

A recorder writes chunks of connections and messages one after the other, and the index last. The length of its last chunk is
still 0 when it is killed, so that the messages in it follow as records of the file itself. Source: ROS bag format 2.0
(wiki.ros.org/Bags/Format/2.0).
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

BAG_MAGIC = b"#ROSBAG V2.0\n"


class UnfinishedBag:
    """A bag of ROS 1 without an index, with the methods of the readers of `rosbags`. It is read to the first damage."""

    is_indexed = False
    """Messages of a time are found by reading all before."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.connections: list[Any] = []
        """As `rosbags` describes them."""
        self.start_time, self.end_time = 0, 0
        """First and last arrival, ns."""
        self.cut_off = "it has no index"
        """Why it is read in this way."""
        self._known: dict[int, Any] = {}
        counts, first = Counter[int](), None
        for number, arrival_ns, _ in self._records():
            counts[number] += 1
            first = arrival_ns if first is None else min(first, arrival_ns)
            self.end_time = max(self.end_time, arrival_ns)
        self.start_time = first or 0
        self.connections = [each._replace(msgcount=counts[number]) for number, each in self._known.items()]

    def close(self) -> None:
        """Do nothing, since no file is open between two readings."""

    def messages(
        self, connections: Collection[Any], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Any, int, bytes]]:
        """Yield connection, arrival (ns) and bytes of the messages of some connections from `start` to before `stop`."""
        wanted = {each.id: each for each in connections}
        for number, arrival_ns, data in self._records():
            in_time = (start is None or arrival_ns >= start) and (stop is None or arrival_ns < stop)
            if number in wanted and in_time:
                yield wanted[number], arrival_ns, data

    def _records(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield connection, arrival (ns) and bytes of each message."""
        with self.path.open("rb") as file:
            if file.read(len(BAG_MAGIC)) != BAG_MAGIC:
                return
            size = os.fstat(file.fileno()).st_size
            while file.tell() < size:
                try:
                    found = list(self._read_record(file))
                except Exception:  # noqa: BLE001 - damaged bytes can raise anything in the library
                    return
                yield from found

    def _read_record(self, file: BinaryIO) -> Iterator[tuple[int, int, bytes]]:
        """Read a record; yield its message, or those of a chunk. Raises any exception: it is damaged or cut off."""
        from rosbags.rosbag1.reader import Compression, Header, RecordType, decompressors, read_bytes, read_uint32

        header = Header.read(file)
        kind = header.get_uint8("op")
        if kind == RecordType.CONNECTION:
            self._add_connection(header, Header.read(file))
            return
        if kind == RecordType.CHUNK and header.get_string("compression") == Compression.NONE.value:
            # Its records follow as if they were the file's own. The last chunk of a killed recorder has the length 0.
            read_uint32(file)
            return
        data = read_bytes(file, read_uint32(file))
        if kind == RecordType.MSGDATA:
            yield header.get_uint32("conn"), header.get_time("time"), data
        elif kind == RecordType.CHUNK and data:
            inside = BytesIO(decompressors[header.get_string("compression")](data))
            size = inside.getbuffer().nbytes
            while inside.tell() < size:
                yield from self._read_record(inside)

    def _add_connection(self, header: Any, described: Any) -> None:
        from rosbags.interfaces import Connection, ConnectionExtRosbag1, MessageDefinition, MessageDefinitionFormat
        from rosbags.typesys.msg import normalize_msgtype

        number = header.get_uint32("conn")
        if number not in self._known:
            definition = MessageDefinition(MessageDefinitionFormat.MSG, described.get_string("message_definition"))
            type_name = normalize_msgtype(described.get_string("type"))
            self._known[number] = Connection(
                number, header.get_string("topic"), type_name, definition, "", 0, ConnectionExtRosbag1(None, None), self
            )
