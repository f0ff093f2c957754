"""Delimited text without a checksum, and which format a link is found to speak."""

from collections import Counter
from itertools import chain

import numpy as np
import pytest

from skincal.model.readings import Loss, Stream
from skincal.streams.decoders import delimited
from skincal.streams.decoders.auto_detect import ASSUME_TEXT_AFTER_BYTES, LinkDecoder
from skincal.streams.decoders.delimited import TextDecoder, whole_numbers
from tests.skincal.streams.maker_records import SKB_TAXELS, SKT_TAXELS

SKIN = (Stream.SKIN,)
WRENCH = (Stream.WRENCH,)
MS = 1_000_000
LOSSES = (Loss.BAD_WIDTH, Loss.UNREADABLE)


def values(batches):
    return [row for batch in batches for row in batch.values.tolist()]


# ------------------------------------------------------------------ separators, words, counts


@pytest.mark.parametrize(
    "line", ["1,2,3", "1, 2, 3", "1;2;3", "1\t2\t3", "1 2 3", "  1  2   3 ", "1,2,3,", "1;2;3;", "1.0,2e0,+3", "1,0;2,0;3,0"]
)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_separators_are_found(line, end):
    decoder = TextDecoder(3, SKIN)
    # The first line after opening may be cut: it is dropped without a count.
    assert values(decoder.feed(("2,3\n" + line + end).encode())) == [[1, 2, 3]]
    assert not decoder.counts


@pytest.mark.parametrize(("width", "is_both"), [(9, True), (10, True), (8, False), (4, False)])
def test_wrench_and_skin_on_one_line_are_asked_for_on_lines_of_their_own(width, is_both):
    """A board with a clock has one value more."""
    decoder = TextDecoder(3, (Stream.WRENCH, Stream.SKIN))
    decoder.feed(b"".join(b",".join(b"%d" % (7 * each) for each in range(width)) + b"\n" for _ in range(3)))
    assert f"Lines of {width} values arrive where 6 or 3 are expected" in decoder.device_message
    assert ("send wrench and skin on lines of their own" in decoder.device_message) == is_both


def test_words_are_passed_over_and_wrong_counts_are_counted():
    decoder = TextDecoder(3, SKIN)
    raw = b"\nTactile board v2 ready\nCFG,8,8\nflag\n1,2,3\n1,2\n4,5,6\n1,2,3,4\n1,,3\n1,x,3\n7,8,9\n\x80\x00\xff\xfe12,\x07\n"
    assert values(decoder.feed(raw)) == [[1, 2, 3], [4, 5, 6], [7, 8, 9]]
    # 1,2 · 1,2,3,4 · CFG,8,8 is mostly numbers · 1,,3 · 1,x,3 · the bytes that are no text
    assert decoder.counts == Counter({Loss.BAD_WIDTH: 2, Loss.UNREADABLE: 4})
    assert "Lines of 4 values" in decoder.device_message
    assert "3 are expected" in decoder.device_message


def test_not_a_number_is_kept_as_such_and_counted():
    decoder = TextDecoder(3, SKIN)
    (batch,) = decoder.feed(b"\n1,nan,inf\n")
    np.testing.assert_array_equal(batch.values, [[1, np.nan, np.nan]])
    assert decoder.counts == Counter({Loss.NOT_A_NUMBER: 1})


def test_endless_line_is_dropped_once():
    decoder = TextDecoder(3, SKIN)
    for _ in range(40):
        decoder.feed(b"1," * 10_000)
    assert values(decoder.feed(b"\n1,2,3\n4,5,6\n")) == [[1, 2, 3], [4, 5, 6]]
    assert not decoder.counts  # it began before the first line end, as after opening


# ------------------------------------------------------------------ a row a line


def rows_of(frames, blank="\n"):
    return "".join("".join(" ".join(map(str, row)) + "\n" for row in frame) + blank for frame in frames).encode()


def test_row_a_line_with_a_blank_line_after_each_frame():
    frames = np.arange(3 * 4 * 4).reshape(3, 4, 4)
    for raw in (b"\n" + rows_of(frames), b"\n" + rows_of(frames, "\r\n")):
        decoder = TextDecoder(16, SKIN)
        assert values(decoder.feed(raw)) == frames.reshape(3, 16).tolist()
        assert not decoder.counts


def test_frame_with_a_row_lost_is_counted_and_the_next_is_whole():
    frames = np.arange(3 * 4 * 4).reshape(3, 4, 4).tolist()
    del frames[1][2]
    decoder = TextDecoder(16, SKIN)
    found = values(decoder.feed(b"\n" + rows_of(frames)))
    assert found == [list(chain(*frames[0])), list(chain(*frames[2]))]
    assert decoder.counts == Counter({Loss.BAD_WIDTH: 1})


def test_opening_in_the_middle_of_a_frame_of_rows_gives_no_wrong_frame():
    frames = np.arange(4 * 4 * 4).reshape(4, 4, 4)
    raw = rows_of(frames)
    for start in range(1, len(rows_of(frames[:1]))):
        for row in values(TextDecoder(16, SKIN).feed(raw[start:])):
            assert row in frames.reshape(4, 16).tolist()


# ------------------------------------------------------------------ several streams, named columns


def test_count_of_values_says_what_a_line_is():
    decoder = TextDecoder(4, (Stream.WRENCH, Stream.SKIN))
    wrench, skin = decoder.feed(b"\n1,2,3,4,5,6\n1,2,3,4\n7,8,9,10,11,12\n")
    assert wrench.values.tolist() == [[1, 2, 3, 4, 5, 6], [7, 8, 9, 10, 11, 12]]
    assert skin.values.tolist() == [[1, 2, 3, 4]]
    assert wrench.seq.tolist() == [-1, -1]
    assert np.isnan(wrench.device_s).all()


def test_joints_are_degrees_and_of_the_first_width():
    decoder = TextDecoder(4, (Stream.JOINTS,))
    (batch,) = decoder.feed(b"\n90 180\n0 -90\n1 2 3\n")
    np.testing.assert_allclose(batch.values, [[np.pi / 2, np.pi], [0, -np.pi / 2]], rtol=1e-15)
    assert decoder.counts[Loss.BAD_WIDTH] == 1


@pytest.mark.parametrize(
    ("header", "line", "seq", "device_s"),
    [
        ("t,a,b", "1.5,7,8", -1, 1.5),
        ("Time,a,b", "1.5,7,8", -1, 1.5),
        ("seq,t_us,a,b", "5,250000,7,8", 5, 0.25),
        ('"t_ms";"a";"b"', "20;7;8", -1, 0.02),
        ("t_s seq a b", "3 9 7 8", 9, 3.0),
    ],
)
def test_header_line_names_leading_columns(header, line, seq, device_s):
    decoder = TextDecoder(2, SKIN)
    (batch,) = decoder.feed(f"{header}\n{line}\n".encode())
    assert batch.values.tolist() == [[7, 8]]
    assert batch.seq.tolist() == [seq]
    assert batch.device_s.tolist() == [device_s]


def test_named_numbers_and_microseconds():
    decoder = TextDecoder(1, SKIN)
    top = 1 << 32
    (batch,) = decoder.feed(f"seq,t_us,a\n1,{top - 20_000},0\n2,0,0\n6,80000,0\n".encode())
    assert decoder.counts == Counter({Loss.MISSING: 3})
    np.testing.assert_allclose(np.diff(batch.device_s), [0.02, 0.08], atol=1e-9)


# ------------------------------------------------------------------ detection


def feed_all(decoder, chunks):
    return [item for host_ns, data in chunks for item in decoder.feed(data, host_ns)]


def test_one_good_checksum_decides_and_keeps_what_came_with_it():
    for mark, record, name in ((b"\x00", SKB_TAXELS, "SKB/1"), (b"\n", SKT_TAXELS, "SKT/1")):
        decoder = LinkDecoder("auto", 4, SKIN)
        assert decoder.current.name == ""
        found = feed_all(decoder, [(5, b"boot junk 1,2,3,4" + mark), (6, record[:7]), (7, record[7:])])
        assert decoder.current.name == name
        assert [(host_ns, batch.seq.tolist()) for host_ns, batch in found] == [(7, [17])]


def test_text_is_believed_after_300_ms_and_nothing_is_lost_or_dated_late():
    decoder = LinkDecoder("auto", 2, SKIN)
    chunks = [(1000 * MS + i * 20 * MS, f"{i},{i}\n".encode()) for i in range(30)]
    found = feed_all(decoder, chunks)
    assert decoder.current.name == "text"
    assert [batch.values[0, 0] for _, batch in found] == list(range(1, 30))
    assert [host_ns for host_ns, _ in found] == [host_ns for host_ns, _ in chunks[1:]]


def test_binary_after_a_long_banner_is_still_found():
    decoder = LinkDecoder("auto", 4, SKIN)
    assert feed_all(decoder, [(i * 100 * MS, b"waiting for the sensor...\n") for i in range(50)]) == []
    found = feed_all(decoder, [(6000 * MS, b"\x00" + SKB_TAXELS)])
    assert decoder.current.name == "SKB/1"
    assert len(found) == 1


def test_file_read_at_once_and_end_of_a_short_one():
    fast = LinkDecoder("auto", 2, SKIN)
    assert fast.feed(b"1,2\n" * ASSUME_TEXT_AFTER_BYTES, 7)
    short = LinkDecoder("auto", 2, SKIN)
    assert short.feed(b"1,2\n3,4\n", 7) == []
    ((host_ns, batch),) = short.finish()
    assert host_ns == 7
    assert batch.values.tolist() == [[3, 4]]
    assert short.finish() == []


def test_given_format_is_not_questioned():
    decoder = LinkDecoder("skt", 4, SKIN)
    assert decoder.current.name == "SKT/1"
    assert decoder.feed(SKB_TAXELS, 0) == []
    assert len(decoder.feed(b"\n" + SKT_TAXELS, 1)) == 1


def large_frames(count=3, width=4200):
    frames = np.random.default_rng(3).integers(0, 70_000, (count, width))
    return frames, "seq,t_us," + ",".join(f"c{number}" for number in range(width))


def test_a_large_frame_of_whole_numbers_is_read_in_arrays_and_the_same_to_the_last_bit():
    frames, header = large_frames()
    lines = [f"{row + 7},{4_294_000_000 + 20_000 * row}," + ",".join(map(str, frame)) for row, frame in enumerate(frames)]
    # A decimal point sends a line the other way.
    other = [line.replace(",", ".0,", 1) for line in lines]
    assert whole_numbers(lines[0].encode()) is not None
    assert whole_numbers(other[0].encode()) is None
    found = []
    for each in (lines, other):
        decoder = TextDecoder(frames.shape[1], (Stream.SKIN,))
        (batch,) = decoder.feed("\n".join([header, *each, ""]).encode())
        found.append((batch.seq.tobytes(), batch.device_s.tobytes(), batch.values.dtype, batch.values.tobytes()))
    assert found[0] == found[1]
    np.testing.assert_array_equal(batch.values, frames)


@pytest.mark.parametrize("line", ["1,,2", "1,2,", ",1", "1,-2", "1;2", "1 2", "1,2e3", "1,1234567890123456", "1_0,2", ""])
def test_other_lines_are_not_read_in_arrays(line):
    assert whole_numbers(line.encode()) is None
    np.testing.assert_array_equal(whole_numbers(b"0,007,65535,123456789012345"), [0.0, 7.0, 65535.0, 123456789012345.0])


def test_the_repeated_header_of_a_large_skin_is_checked_once(monkeypatch):
    frames, header = large_frames(1)
    decoder, checked = TextDecoder(frames.shape[1], (Stream.SKIN,)), []
    is_names = delimited._may_be_names
    monkeypatch.setattr(delimited, "_may_be_names", lambda names: checked.append(len(names)) or is_names(names))
    line = "1,20000," + ",".join(map(str, frames[0]))
    (batch,) = decoder.feed("\n".join([header, line, header, line, header, line, ""]).encode())
    assert (len(batch.values), checked) == (3, [4200])
    assert not decoder.counts
