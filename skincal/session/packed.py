"""Bytes that grow all session long, held compressed until its end."""

from __future__ import annotations

from collections.abc import Iterator

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex


class Packed:
    """Collects bytes and compresses them as they come."""

    def __init__(self) -> None:
        self._packer = zstandard.ZstdCompressor().compressobj()
        self._parts: list[bytes] = []

    def add(self, data: bytes) -> None:
        """Append bytes."""
        part = self._packer.compress(data)
        if part:
            self._parts.append(part)

    def finish(self) -> bytes:
        """Return what was added, compressed; nothing may be added after it."""
        self._parts.append(self._packer.flush())
        return b"".join(self._parts)


class _Records:
    """Records as they stand in a file; written as one record is."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def write(self, stream: RecordBuilder) -> None:
        """Write them."""
        stream.write(self._data)


class ChunkIndexes:
    """Takes the place of the list in which MCAP's writer collects where its chunks lie, until it writes them at its end.

    As objects they cost 3 kB a second of recording, more than all else that a session holds.
    """

    def __init__(self) -> None:
        self._packed = Packed()

    def append(self, index: ChunkIndex) -> None:
        """Take the next chunk's."""
        builder = RecordBuilder()
        index.write(builder)
        self._packed.add(builder.end())

    def __iter__(self) -> Iterator[_Records]:
        """Yield them all at once, for the end."""
        with zstandard.ZstdDecompressor().stream_reader(self._packed.finish()) as stream:
            yield _Records(stream.read())
