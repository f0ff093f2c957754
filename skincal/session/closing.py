"""A segment without an end given one: its whole chunks as they stand, and the index that its writer did not come to write.

Chunks are copied as they are, so that what belongs together in one stays together, and an hour takes seconds.
"""

from __future__ import annotations

import os
import shutil
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from skincal.session.segment import (
    CHUNK_HEAD,
    DAMAGE,
    HEAD_SIZE,
    MAGIC,
    Span,
    description,
    index_head,
    inner_spans,
    message_head,
    open_chunk,
    read_body,
    read_chunk,
    spans,
    words_of,
)

_FOOTER_HEAD_SIZE = HEAD_SIZE + 8 + 8
"""Bytes of the footer that its checksum covers."""
_NAME_MAX = 16
"""Bytes. No compression has a longer name."""
CHECKED_BYTES = 64 << 20
"""Bytes at the end whose chunks are opened and checked: ten minutes at 1 kHz. What a crash or a power cut spoils is what the
system had not written yet, which is seconds old; older chunks are checked when the session is played from its bytes."""


@dataclass(slots=True)
class _ChunkFound:
    """A chunk that is whole, with what is known of its messages."""

    index: ChunkIndex
    counts: dict[int, int] = field(default_factory=dict[int, int])
    end: int = 0
    """End of the chunk, its message indexes included."""


@dataclass(slots=True)
class Survey:
    """What of a segment is whole."""

    end: int = len(MAGIC)
    """Bytes; what lies behind is lost, or is an index that is written anew."""
    damage: str = ""
    complete: bool = False
    """The writer came to the end of the data."""
    chunks: list[_ChunkFound] = field(default_factory=list[_ChunkFound])
    schemas: dict[int, Schema] = field(default_factory=dict[int, Schema])
    channels: dict[int, Channel] = field(default_factory=dict[int, Channel])
    metadata: list[MetadataIndex] = field(default_factory=list[MetadataIndex])
    attachments: list[AttachmentIndex] = field(default_factory=list[AttachmentIndex])

    @property
    def messages(self) -> int:
        """Messages in the whole chunks."""
        return sum(sum(chunk.counts.values()) for chunk in self.chunks)


def survey(path: Path) -> Survey:
    """Find the chunks of a segment up to the first damage."""
    found = Survey()
    checked_from = path.stat().st_size - CHECKED_BYTES
    with path.open("rb") as file:
        try:
            for span in spans(file):
                if span.opcode == Opcode.DATA_END:
                    found.complete = True
                    break
                _take(found, file, span, check=span.end > checked_from)
        except DAMAGE as error:
            found.damage = words_of(error)
        if found.chunks:
            _mend_last(found, file)
    return found


def close_copy(path: Path, fresh: Path, found: Survey) -> None:
    """Write a segment's whole part, closed, to another file; `OSError` where that is not possible."""
    last = found.chunks[-1] if found.chunks else None
    with path.open("rb") as source, fresh.open("wb") as target:
        shutil.copyfileobj(source, target, 1 << 20)
        target.truncate(found.end)
        target.seek(found.end)
        if last is not None and not last.index.message_index_length:
            for index in _indexes(source, last):
                last.index.message_index_offsets[index.channel_id] = target.tell()
                target.write(_built(index))
            last.index.message_index_length = target.tell() - found.end
        target.write(_built(DataEnd(0)))
        _write_summary(target, found)
        target.flush()
        os.fsync(target.fileno())


def _take(found: Survey, file: BinaryIO, span: Span, *, check: bool) -> None:
    start = span.start - HEAD_SIZE
    if span.opcode == Opcode.CHUNK:
        if not found.channels:  # the first chunk describes them
            _learn(found, open_chunk(read_chunk(read_body(file, span))))
        elif check:
            open_chunk(read_chunk(read_body(file, span)))
        file.seek(span.start)
        start_ns, end_ns, size, _, length = CHUNK_HEAD.unpack(file.read(CHUNK_HEAD.size))
        index = ChunkIndex(
            chunk_length=span.end - start,
            chunk_start_offset=start,
            compression=file.read(min(length, _NAME_MAX)).decode(),
            compressed_size=span.end - span.start - CHUNK_HEAD.size - length - 8,
            message_end_time=end_ns,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=start_ns,
            uncompressed_size=size,
        )
        found.chunks.append(_ChunkFound(index, end=span.end))
    elif span.opcode == Opcode.MESSAGE_INDEX and found.chunks:
        channel, count = index_head(file, span)
        chunk_found = found.chunks[-1]
        chunk_found.counts[channel] = count
        chunk_found.index.message_index_offsets[channel] = start
        chunk_found.index.message_index_length += span.end - start
        chunk_found.end = span.end
    elif span.opcode == Opcode.METADATA:
        name = Metadata.read(ReadDataStream(BytesIO(read_body(file, span)))).name
        found.metadata.append(MetadataIndex(offset=start, length=span.end - start, name=name))
    elif span.opcode == Opcode.ATTACHMENT:
        found.attachments.append(_attachment(file, span))
    found.end = span.end


def _attachment(file: BinaryIO, span: Span) -> AttachmentIndex:
    attachment = Attachment.read(ReadDataStream(BytesIO(read_body(file, span))))
    return AttachmentIndex(
        offset=span.start - HEAD_SIZE,
        length=span.end - span.start + HEAD_SIZE,
        log_time=attachment.log_time,
        create_time=attachment.create_time,
        data_size=len(attachment.data),
        name=attachment.name,
        media_type=attachment.media_type,
    )


def _learn(found: Survey, data: bytes) -> None:
    for span in inner_spans(data):
        if span.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            record = description(span.opcode, data[span.start : span.end])
            if isinstance(record, Schema):
                found.schemas[record.id] = record
            else:
                found.channels[record.id] = record


def _mend_last(found: Survey, file: BinaryIO) -> None:
    """Take the last chunk without its indexes where they may be cut off."""
    last = found.chunks[-1]
    if found.complete or not found.damage or found.end != last.end:
        return
    found.end = last.index.chunk_start_offset + last.index.chunk_length
    last.index.message_index_offsets, last.index.message_index_length = {}, 0
    last.counts = {index.channel_id: len(index.records) for index in _indexes(file, last)}


def _indexes(file: BinaryIO, chunk: _ChunkFound) -> Iterator[MessageIndex]:
    """Yield the message indexes of a chunk, made from its messages."""
    start = chunk.index.chunk_start_offset
    span = Span(Opcode.CHUNK, start + HEAD_SIZE, start + chunk.index.chunk_length)
    data = open_chunk(read_chunk(read_body(file, span)))
    places: dict[int, list[tuple[int, int]]] = {}
    for inner in inner_spans(data):
        if inner.opcode == Opcode.MESSAGE:
            channel, log_ns = message_head(data, inner)
            places.setdefault(channel, []).append((log_ns, inner.start - HEAD_SIZE))
    yield from (MessageIndex(channel, entries) for channel, entries in places.items())


def _write_summary(target: BinaryIO, found: Survey) -> None:
    start = target.tell()
    times = [(chunk.index.message_start_time, chunk.index.message_end_time) for chunk in found.chunks] or [(0, 0)]
    counts: dict[int, int] = {}
    for chunk in found.chunks:
        for channel, count in chunk.counts.items():
            counts[channel] = counts.get(channel, 0) + count
    statistics = Statistics(
        attachment_count=len(found.attachments),
        channel_count=len(found.channels),
        channel_message_counts=counts,
        chunk_count=len(found.chunks),
        message_count=found.messages,
        message_end_time=max(end for _, end in times),
        message_start_time=min(begin for begin, _ in times),
        metadata_count=len(found.metadata),
        schema_count=len(found.schemas),
    )
    groups = [*found.schemas.values(), *found.channels.values(), statistics]
    records = [*groups, *(chunk.index for chunk in found.chunks), *found.metadata]
    summary = b"".join(_built(record) for record in records)
    offsets = 0
    if found.attachments:
        attached = b"".join(_built(record) for record in found.attachments)
        place = SummaryOffset(Opcode.ATTACHMENT_INDEX, start + len(summary), len(attached))
        offsets = start + len(summary) + len(attached)
        summary += attached + _built(place)
    footer = _built(Footer(summary_start=start, summary_offset_start=offsets, summary_crc=0))
    crc = zlib.crc32(footer[:_FOOTER_HEAD_SIZE], zlib.crc32(summary))
    target.write(summary + _built(Footer(summary_start=start, summary_offset_start=offsets, summary_crc=crc)) + MAGIC)


def _built(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
