"""Chunks that are decoded many at a time give the readings and losses of chunks that are decoded one after the other."""

from collections import defaultdict
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skincal.devices.registry import FAMILIES, load_family
from skincal.model.readings import Stream
from skincal.simulation.board_formats import make_encoder
from skincal.streams.decoders.auto_detect import make_decoder
from skincal.streams.decoders.skb import SkbDecoder

VECTORS = {vector.format: vector for file in FAMILIES for vector in load_family(file).vectors if vector.repeat}
BOARD_STREAMS = (Stream.WRENCH, Stream.SKIN, Stream.JOINTS)
WIDTHS = {Stream.WRENCH: 6, Stream.SKIN: 24, Stream.JOINTS: 3}


def board_records(name, stream, first_us=0):
    """Records of a board with a header now and then; the clock begins at `first_us` and wraps on the way."""
    encoder = make_encoder(name, 255, WIDTHS[Stream.SKIN])
    rng = np.random.default_rng(1)
    values = rng.integers(0, 255, (60, WIDTHS[stream])).astype(float) * (1 if stream is Stream.SKIN else 0.125)
    times = (first_us + 10_000 * np.arange(60) + rng.integers(-900, 900, 60)) % 2**32
    records = [encoder.record(stream, int(at), row) for at, row in zip(times, values.tolist(), strict=True)]
    header = encoder.header(0, "board=a,n=24,kind=taxel", WIDTHS[stream])
    return [header, *records[:20], header, *records[20:]]


def decoded(decoder, chunks, blocks):
    """Decode the chunks, each of the `blocks` (numbers of chunks) at once where that is possible; return what came of it."""
    batches, at = defaultdict(list), 0
    together = 0
    for count in blocks:
        part, at = chunks[at : at + count], at + count
        found = decoder.feed_many(part) if count > 1 else None
        if found is not None:
            together += 1
            batch, ends = found
            assert len(ends) == len(part)
            for begin, end in pairwise([0, *ends]):
                assert end > begin
            batches[batch.stream] += [batch.rows(begin, end) for begin, end in pairwise([0, *ends])]
            continue
        for chunk in part:
            for batch in decoder.feed(chunk):
                batches[batch.stream].append(batch)
    rows = {
        stream: [np.concatenate([getattr(batch, name) for batch in found]) for name in ("seq", "device_s", "values")]
        + [np.concatenate([getattr(batch, name) for batch in found]) for name in ("saturated", "invalid")]
        for stream, found in batches.items()
    }
    return rows, [len(batch.seq) for found in batches.values() for batch in found], decoder, together


def assert_same(one, other):
    assert one[0].keys() == other[0].keys()
    for stream, columns in one[0].items():
        for column, same in zip(columns, other[0][stream], strict=True):
            np.testing.assert_array_equal(column, same)
    assert one[1] == other[1]
    assert one[2].counts == other[2].counts
    assert one[2].device_message == other[2].device_message
    assert one[2].units == other[2].units
    assert one[2].side_readings == other[2].side_readings


@st.composite
def damaged(draw, records):
    """Return chunks of the records, some of them damaged or cut elsewhere, and the sizes of the blocks."""
    records = list(records)
    for at in draw(st.lists(st.integers(0, len(records) - 1), max_size=2)):
        record = bytearray(records[at])
        if record:
            place = draw(st.integers(0, len(record) - 1))
            what = draw(st.sampled_from(["flip", "drop", "lose"]))
            if what == "flip":
                record[place] ^= 1 << draw(st.integers(0, 7))
            elif what == "drop":
                del record[place]
        records[at] = b"" if what == "lose" else bytes(record)
    sizes = draw(st.lists(st.integers(1, 5), min_size=len(records), max_size=len(records)))
    chunks, at = [], 0
    for size in sizes:
        if chunk := b"".join(records[at : at + size]):
            chunks.append(chunk)
        at += size
    if draw(st.booleans()):
        at = draw(st.integers(0, len(chunks) - 1))
        cut = draw(st.integers(0, len(chunks[at])))
        chunks[at : at + 1] = [piece for piece in (chunks[at][:cut], chunks[at][cut:]) if piece]
    return chunks, draw(st.lists(st.integers(1, 12), min_size=len(chunks), max_size=len(chunks)))


@pytest.mark.parametrize("name", ["skb", "skt", "text"])
@pytest.mark.parametrize("stream", BOARD_STREAMS)
@settings(max_examples=30)
@given(data=st.data())
def test_a_boards_chunks(name, stream, data):
    first_us = data.draw(st.sampled_from([0, 1, 123_456, 2**32 - 300_000]))
    chunks, blocks = data.draw(damaged(board_records(name, stream, first_us)))
    new = [make_decoder(name, WIDTHS[Stream.SKIN], (stream,)) for _ in range(2)]
    assert_same(decoded(new[0], chunks, blocks), decoded(new[1], chunks, [1] * len(chunks)))


@pytest.mark.parametrize("name", sorted(VECTORS))
@settings(max_examples=8)
@given(data=st.data())
def test_a_devices_chunks(name, data):
    vector = VECTORS[name]
    chunks, blocks = data.draw(damaged([vector.data, *[vector.repeat] * 20]))
    new = [make_decoder(name, vector.channels, vector.carries) for _ in range(2)]
    assert_same(decoded(new[0], chunks, blocks), decoded(new[1], chunks, [1] * len(chunks)))


@pytest.mark.parametrize("spoilt", [False, True])
def test_records_of_a_wide_skin_are_decoded_at_once(spoilt):
    encoder = make_encoder("skb", 255, 384)
    values = np.random.default_rng(1).integers(0, 40, (30, 384)).astype(float)
    chunks = [b"".join(encoder.encode(Stream.SKIN, np.array([20_000 * at]), values[at : at + 1])) for at in range(30)]
    chunks[7] = encoder.header(0, "board=a,n=384,kind=taxel", 384) + chunks[7]
    chunks[3] = chunks[3][: -9 if spoilt else None]
    new = [make_decoder("skb", 384, (Stream.SKIN,)) for _ in range(2)]
    many = decoded(new[0], chunks, [30])
    assert_same(many, decoded(new[1], chunks, [1] * 30))
    assert many[3] == (not spoilt)


@pytest.mark.parametrize(
    "noise", [b"\0", b"\1\0", b"\1\0" * 40, b"\2\7\0", b"\5\0\0", b"\xff" * 1100 + b"\0"], ids=lambda noise: noise[:3].hex()
)
def test_frames_without_a_record_are_as_one_after_the_other(noise):
    records = [*board_records("skb", Stream.WRENCH)[:6], noise, *board_records("skb", Stream.WRENCH)[7:9]]
    new = [make_decoder("skb", None, (Stream.WRENCH,)) for _ in range(2)]
    assert_same(decoded(new[0], records, [3, 6]), decoded(new[1], records, [1] * 9))


def test_a_record_that_is_longer_than_the_protocol_allows_is_lost_also_among_many():
    encoder = make_encoder("skb", 255, 1200)
    chunks = encoder.encode(Stream.SKIN, np.arange(4) * 20_000, np.full((4, 1200), 3.0))
    assert len(chunks[0]) > SkbDecoder.limit
    new = [make_decoder("skb", 1200, (Stream.SKIN,)) for _ in range(2)]
    assert_same(decoded(new[0], chunks, [4]), decoded(new[1], chunks, [1] * 4))


@pytest.mark.parametrize("stream", BOARD_STREAMS)
def test_whole_records_of_a_board_are_decoded_at_once(stream):
    records = board_records("skb", stream, 7)
    chunks = [records[0] + records[1], *records[2:21], records[21] + records[22], *records[23:]]
    decoder = make_decoder("skb", WIDTHS[Stream.SKIN], (stream,))
    assert decoded(decoder, chunks, [30, 30])[3] == 2
