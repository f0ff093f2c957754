"""SKT/1 and SKB/1: published vectors, garbage, damage, and what is counted.

The published example records are those of the formats' description: `origin: built`, `source: this document`.
"""

from collections import Counter

import numpy as np
import pytest
from cobs import cobs as reference_cobs
from hypothesis import given, settings
from hypothesis import strategies as st

from skincal.devices.decoding import DeviceTime, SequenceCounter
from skincal.model.errors import InputError
from skincal.model.readings import Loss, Stream
from skincal.streams.decoders.auto_detect import NAMES, make_decoder
from skincal.streams.decoders.delimited import TextDecoder
from skincal.streams.decoders.skb import SkbDecoder, unstuffed
from skincal.streams.decoders.skt import SktDecoder
from tests.approved import approved
from tests.skincal.poke_script import skt_line
from tests.skincal.streams.cut_bytes import fed, readings
from tests.skincal.streams.maker_records import SKB_TAXELS, SKT_TAXELS, record_streams, skb, skb_skin, skb_wrench

ALL = (Stream.WRENCH, Stream.SKIN, Stream.JOINTS)
SKB_WRENCH = bytes.fromhex("020206D20450D412010103C03F010310C00103F0410101023E010102BF0103803D0101010366EC00")
SKT_WRENCH = b"F,1234,1234000,1.50,-2.25,30.00,0.1250,-0.5000,0.0625,0*512C\n"
SKT_HEADER = b"H,skt1,board=left-forearm-A,n=84,rate=50,unit=raw,bits=12*C2AD\n"


# ------------------------------------------------------------------ published vectors


@pytest.mark.parametrize(
    ("cls", "record", "stream", "seq", "device_s", "values"),
    [
        (SkbDecoder, SKB_TAXELS, Stream.SKIN, 17, 0.34, [201, 199, 2310, 200]),
        (SktDecoder, SKT_TAXELS, Stream.SKIN, 17, 0.34, [201, 199, 2310, 200]),
        (SkbDecoder, SKB_WRENCH, Stream.WRENCH, 1234, 1.234, [1.5, -2.25, 30, 0.125, -0.5, 0.0625]),
        (SktDecoder, SKT_WRENCH, Stream.WRENCH, 1234, 1.234, [1.5, -2.25, 30, 0.125, -0.5, 0.0625]),
    ],
)
def test_published_records(cls, record, stream, seq, device_s, values):
    for (batch,) in (cls(4, ALL).feed(record), fed(cls(4, ALL), record, range(1, len(record)))):
        assert (batch.stream, batch.seq.tolist(), batch.values.tolist()) == (stream, [seq], [values])
        assert batch.device_s.tolist() == pytest.approx([device_s], abs=1e-12)
        assert not batch.saturated.any()
        assert not batch.invalid.any()


@pytest.mark.parametrize(("channels", "words"), [(84, []), (384, ["left-forearm-A", "84", "384"])])
def test_published_header_record_is_compared_with_the_scene(channels, words):
    decoder = SktDecoder(channels, ALL)
    assert decoder.feed(SKT_HEADER) == []
    assert decoder.valid_records == 1
    assert bool(decoder.device_message) == bool(words)
    assert all(word in decoder.device_message for word in words)


# ------------------------------------------------------------------ garbage, damage


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(["skb", "skt"]), st.data())
def test_garbage_between_records_costs_no_record_that_is_delimited(name, data):
    cls = {"skb": SkbDecoder, "skt": SktDecoder}[name]
    mark, records = cls.mark, data.draw(record_streams(name))
    garbage = st.binary(max_size=60).filter(lambda b: mark not in b)
    raw = mark + b"".join(data.draw(garbage) + mark + record for record in records)
    clean = readings(cls(5, ALL).feed(mark + b"".join(records)))
    assert sum(map(len, clean.values())) == len(records)
    assert readings(cls(5, ALL).feed(raw)) == clean


@pytest.mark.parametrize(
    ("cls", "record"), [(SkbDecoder, SKB_TAXELS), (SkbDecoder, SKB_WRENCH), (SktDecoder, SKT_TAXELS), (SktDecoder, SKT_WRENCH)]
)
def test_no_flipped_bit_gives_a_wrong_reading(cls, record):
    """Every single bit, and every pair of neighbouring bytes inverted: the original reading or none."""
    good = readings(cls(4, ALL).feed(cls.mark + record))
    for bit in range(8 * len(record)):
        damaged = bytearray(record)
        damaged[bit // 8] ^= 1 << bit % 8
        decoder = cls(4, ALL)
        found = readings(decoder.feed(cls.mark + bytes(damaged) + cls.mark))
        for kind, rows in found.items():
            assert all(row in good[kind] for row in rows), f"bit {bit}"
        assert not any(found.values()) or bytes(damaged)[:-1] == record[:-1], f"bit {bit}"
        if damaged[-1] == record[-1] and cls.mark not in damaged[:-1]:
            assert sum(decoder.counts[loss] for loss in (Loss.BAD_CHECKSUM, Loss.UNREADABLE, Loss.BAD_WIDTH)) == 1
    for at in range(len(record) - 2):
        damaged = bytearray(record)
        damaged[at] ^= 0xFF
        damaged[at + 1] ^= 0xFF
        assert not any(readings(cls(4, ALL).feed(cls.mark + bytes(damaged) + cls.mark)).values())


def test_lost_byte_costs_its_own_record_only():
    records = [skb_skin(i, 1000 * i + 1, [1, 2, 3, 400 + i]) for i in range(6)]
    for at in range(1, len(records[2]) - 1):
        decoder = SkbDecoder(4, ALL)
        raw = b"".join(records[:2]) + records[2][:at] + records[2][at + 1 :] + b"".join(records[3:])
        (batch,) = decoder.feed(raw)
        assert batch.seq.tolist() == [0, 1, 3, 4, 5]
        assert decoder.counts[Loss.MISSING] == 1
        assert decoder.counts[Loss.BAD_CHECKSUM] + decoder.counts[Loss.UNREADABLE] == 1


@pytest.mark.parametrize(("cls", "record"), [(SkbDecoder, SKB_TAXELS), (SktDecoder, SKT_TAXELS)])
def test_first_partial_record_after_opening_is_no_error(cls, record):
    for start in range(1, len(record)):
        decoder = cls(4, ALL)
        (batch,) = decoder.feed(record[start:] + record)
        assert batch.seq.tolist() == [17]
        assert not decoder.counts


# ------------------------------------------------------------------ what is counted


def test_record_over_the_size_limit_is_dropped_and_counted_once():
    longest = list(range(1, (1024 - 8) // 2 + 1))
    assert SkbDecoder(None, ALL).feed(skb_skin(1, 1, longest))[0].values.tolist() == [longest]
    for cls, record in ((SkbDecoder, SKB_TAXELS), (SktDecoder, SKT_TAXELS)):
        raw = cls.mark + b"\x05" * (5 * cls.limit) + cls.mark + record
        for cuts in ((), range(1, len(raw))):
            decoder = cls(4, ALL)
            (batch,) = fed(decoder, raw, cuts)
            assert batch.seq.tolist() == [17]
            assert decoder.counts == Counter({Loss.UNREADABLE: 1})


@pytest.mark.parametrize(
    ("decoder", "data", "streams"),
    [
        (SkbDecoder(4, ALL), skb(99, 0, 5, b"whatever") + SKB_TAXELS + skb(7, 1, 6, b""), [Stream.SKIN]),
        (SktDecoder(4, ALL), skt_line("Q,1,2,3") + b"# a comment\r\n" + SKT_TAXELS, [Stream.SKIN]),
        (SktDecoder(4, (Stream.WRENCH,)), SKT_TAXELS + SKT_WRENCH, [Stream.WRENCH]),
    ],
    ids=["types", "letters and comments", "streams that are not carried"],
)
def test_other_records_are_skipped_without_a_count(decoder, data, streams):
    assert [batch.stream for batch in decoder.feed(data)] == streams
    assert not decoder.counts


def test_all_ways_to_send_skin_and_joints():
    decoder = SkbDecoder(3, ALL)
    skin, joints = decoder.feed(
        skb_skin(0, 10, [1, 2, 3], "u1")
        + skb_skin(0, 20, [300, 2, 3], "<u2")
        + skb_skin(0, 30, [1.5, 2, np.nan], "<f4")
        + skb(5, 0, 40, np.array([90, -45], "<f4").tobytes())
    )
    np.testing.assert_array_equal(skin.values, [[1, 2, 3], [300, 2, 3], [1.5, 2, np.nan]])
    np.testing.assert_allclose(joints.values, [[np.pi / 2, -np.pi / 4]], rtol=1e-15)
    skin, joints = SktDecoder(3, ALL).feed(skt_line("T,0,10,1,2.5,nan") + skt_line("J,0,40,90,-45").replace(b"\n", b"\r\n"))
    np.testing.assert_array_equal(skin.values, [[1, 2.5, np.nan]])
    np.testing.assert_allclose(joints.values, [[np.pi / 2, -np.pi / 4]], rtol=1e-15)


@pytest.mark.parametrize("channels", [5, None])
def test_a_wrong_width_is_counted_with_a_sentence(channels):
    """Without a scene the first frame gives the width."""
    for cls, record in ((SkbDecoder, SKB_TAXELS), (SktDecoder, SKT_TAXELS)):
        decoder = cls(channels, ALL)
        longer = skb_skin(18, 360000, [1] * 5) if cls is SkbDecoder else skt_line("T,18,360000,1,1,1,1,1")
        assert len(decoder.feed(record + (record if channels else longer))) == (0 if channels else 1)
        assert decoder.counts[Loss.BAD_WIDTH] == 1  # the first record after opening is not counted
        came, expected = (4, 5) if channels else (5, 4)
        assert f"{came} values" in decoder.device_message
        assert f"{expected} are expected" in decoder.device_message


def test_an_error_of_the_board_is_a_sentence():
    decoder = SktDecoder(4, ALL)
    decoder.feed(skt_line("E,3,mux stuck"))
    assert decoder.device_message == approved("links.board_error", code=3, words="mux stuck")


def test_status_bits_and_numbers_that_are_none_are_kept_marked_and_counted():
    decoder = SkbDecoder(4, ALL)
    (batch,) = decoder.feed(
        skb_wrench(0, 1000, [1] * 6, 0)
        + skb_wrench(1, 2000, [1] * 6, 1)
        + skb_wrench(2, 3000, [1] * 6, 2)
        + skb_wrench(3, 4000, [1] * 6, 3)
        + skb_wrench(4, 5000, [np.nan] + [1] * 5)
        + skb_wrench(5, 6000, [np.inf] + [1] * 5)
    )
    assert batch.saturated.tolist() == [False, True, False, True, False, False]
    assert batch.invalid.tolist() == [False, False, True, True, False, False]
    assert decoder.counts == Counter({Loss.SATURATED: 2, Loss.INVALID: 2, Loss.NOT_A_NUMBER: 2})
    (skin,) = SktDecoder(2, ALL).feed(skt_line("T,0,1,inf,5"))
    np.testing.assert_array_equal(skin.values, [[np.nan, 5]])


def test_good_checksum_around_nonsense_is_unreadable():
    decoder = SktDecoder(4, ALL)
    decoder.feed(b"\n")
    for text in ("T,1", "T,x,1,1,2,3,4", "T,1,2,3,four,5,6", "T,70000,1,1,2,3,4", "T,-1,1,1,2,3,4", "F,1,1,1,2,3,4,5,6,status"):
        assert decoder.feed(skt_line(text)) == []
    assert decoder.counts == Counter({Loss.UNREADABLE: 6})
    decoder.feed(skt_line("F,1,1,1,2,3"))
    assert decoder.counts[Loss.BAD_WIDTH] == 1


def test_numbers_beyond_every_integer_are_no_fault():
    (batch,) = SktDecoder(4, ALL).feed(skt_line("F,1,1,1e999,2,3,4,5,6," + "3" * 40))
    assert batch.saturated.tolist() == [True]
    (batch,) = TextDecoder(1, ALL).feed(b"seq,t,a\n1e300,1e300,5\n")
    assert batch.seq.tolist() == [-1]
    assert np.isnan(batch.device_s).all()


# ------------------------------------------------------------------ sequences and clocks


def test_sequence_wraps_and_counts_what_is_missing():
    """Each kind of record has its own counter."""
    decoder = SkbDecoder(1, ALL)
    numbers = [65533, 65534, 65535, 0, 1, 5, 6]
    raw = b"".join(
        skb_skin(n, 20_000 * (i + 1) + (60_000 if i > 4 else 0), [i]) + skb_wrench(i, 20_000 * (i + 1), [0] * 6)
        for i, n in enumerate(numbers)
    )
    skin = next(batch for batch in decoder.feed(raw) if batch.stream is Stream.SKIN)
    assert skin.seq.tolist() == [65533, 65534, 65535, 65536, 65537, 65541, 65542]
    assert decoder.counts == Counter({Loss.MISSING: 3})


@pytest.mark.parametrize("last", [100, 40_000, 65_000])
@pytest.mark.parametrize("uptime_min", [1, 30, 60])
def test_board_that_starts_anew_is_no_gap(last, uptime_min):
    sequence, clock = SequenceCounter(), DeviceTime()
    start_us = uptime_min * 60_000_000
    for i in range(50):
        sequence.unwrap(last - 49 + i, clock.unwrap(start_us + 20_000 * i))
    total, missing = sequence.unwrap(0, clock.unwrap(500_000))
    assert missing == 0
    assert total == last + 1


def test_device_clock_wraps_once_for_all_records():
    clock = DeviceTime()
    top = 1 << 32
    stamps = [clock.unwrap(raw % top) for raw in (top - 1_000, top + 1_000, top - 500, top + 2_000)]
    np.testing.assert_allclose(np.diff(stamps), [0.002, -0.0015, 0.0025], atol=1e-9)


# ------------------------------------------------------------------ stuffing and registry


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=600))
def test_unstuffing_accepts_what_the_reference_library_accepts(piece):
    try:
        expected = reference_cobs.decode(piece)
    except reference_cobs.DecodeError:
        expected = None
    assert unstuffed(piece) == (expected if piece else None)


def test_unknown_format_is_named_with_the_known_ones():
    with pytest.raises(InputError, match=r"'xml'.*skb, skt, text"):
        make_decoder("xml", 4, ALL)
    for name in ("skb", "skt", "text"):
        assert name in NAMES
        assert make_decoder(name, 4, ALL).feed(b"") == []
