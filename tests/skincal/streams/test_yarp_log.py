import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skincal.model.errors import InputError
from skincal.model.readings import Batch, Loss, Stream
from skincal.streams.decoders.auto_detect import make_decoder
from skincal.streams.decoders.yarp_log import (
    BottleError,
    YarpDecoder,
    even_width,
    parse_bottle,
    read_table,
    split_line,
    split_stamps,
)

WRENCH = (1.5, -2.25, 30.0, 0.125, -0.5, 0.0625)
WORDS = " ".join(map(str, WRENCH))
START = 1_400_000_000.25


def first(batches):
    assert len(batches) == 1
    return batches[0]


def wrench(data: bytes, decoder: YarpDecoder | None = None) -> Batch:
    batch = first((decoder or YarpDecoder(None, (Stream.WRENCH,))).feed(data))
    assert batch.stream is Stream.WRENCH
    return batch


@pytest.mark.parametrize(("decoder", "stamps"), [("yarp", ""), ("yarp-tx-rx", f"{START + 0.004:.6f} "), ("yarp-rx", "")])
def test_the_stamp_of_a_reading_is_the_only_one_or_the_one_that_the_format_names(decoder, stamps):
    line = f"7 {START:.6f} {stamps}{WORDS}\n" if decoder != "yarp-rx" else f"7 0.0 {START:.6f} {WORDS}\n"
    batch = wrench(line.encode(), make_decoder(decoder, None, (Stream.WRENCH,)))
    assert (batch.seq.tolist(), batch.device_s.tolist(), batch.values.tolist()) == ([7], [START], [list(WRENCH)])


@pytest.mark.parametrize(
    "payload",
    [
        WORDS,
        f"({WORDS})",
        WORDS.replace(" ", ", "),
        f"() () () () () ((({WORDS}) 12.5)) () () () () () ()",
        f"() () () () (((36.5) 12.5)) ((({WORDS}) 12.5)) () () () ()",
        f"() () () () () ((({WORDS}) 12.5) ((9 9 9 9 9 9) 12.5)) () () () () () ()",
    ],
    ids=["plain", "in a list", "commas", "12 lists", "10 lists", "two sensors"],
)
def test_shapes_of_a_wrench(payload):
    np.testing.assert_array_equal(wrench(f"1 2.5 {payload}\r\n".encode()).values, [WRENCH])


@pytest.mark.parametrize(
    ("payload", "loss"),
    [
        ("", Loss.BAD_WIDTH),
        ("1 2 3 4 5", Loss.BAD_WIDTH),
        ("1 2 3 4 5 6 7", Loss.BAD_WIDTH),
        ("() () () () () () () () () () () ()", Loss.BAD_WIDTH),
        ("1 2 3 4 5 (6", Loss.UNREADABLE),
        ("1 2 3 4 5 6)", Loss.UNREADABLE),
        ("1 2 3 4 5 up", Loss.UNREADABLE),
        ('1 2 3 4 5 "up', Loss.UNREADABLE),
        ("1 2 3 4 5 6_0", Loss.UNREADABLE),
        ("00000000.ppm", Loss.UNREADABLE),
        ("(1 2 3 4 5 up)", Loss.UNREADABLE),
        ("1 2 3 4 5 \xff(", Loss.UNREADABLE),
    ],
)
def test_a_bad_payload_is_counted_and_the_next_line_read(payload, loss):
    decoder = YarpDecoder(None, (Stream.WRENCH,))
    good = f"1 2.5 {WORDS}\n".encode()
    batch = wrench(good + f"2 2.6 {payload}\n".encode("latin-1") + good.replace(b"1 2.5", b"3 2.7"), decoder)
    assert batch.seq.tolist() == [1, 3]
    assert decoder.counts == {loss: 1}


@pytest.mark.parametrize("line", ["x", "1", "1 2.5x 3", "one 2.5 3", "1 nan 3", f"{10**30} 2.5 {WORDS}"])
def test_a_line_that_is_no_record_is_counted(line):
    decoder = YarpDecoder(None, (Stream.WRENCH,))
    wrench(f"1 2.5 {WORDS}\n{line}\n".encode(), decoder)
    assert decoder.counts == {Loss.UNREADABLE: 1}


def test_blank_lines_and_what_old_dumpers_wrote_into_the_log_are_no_loss():
    decoder = YarpDecoder(None, (Stream.WRENCH,))
    wrench(f"Type: Bottle;\n\nSource: /icub/right_arm [connected]\n1 2.5 {WORDS}\n   \n".encode(), decoder)
    assert not decoder.counts


def test_nan_in_a_wrench_is_counted_and_never_hidden():
    decoder = YarpDecoder(None, (Stream.WRENCH,))
    batch = wrench(b"1 2.5 1 2 nan 4 5 -inf\n", decoder)
    assert decoder.counts == {Loss.NOT_A_NUMBER: 1}
    assert not np.isfinite(batch.values).all()


def test_a_skin_frame_has_the_width_of_the_scene():
    decoder = YarpDecoder(4, (Stream.SKIN,))
    patches = "() () () () () () () () (((1 2) 9.5) ((3 4) 9.5)) () () ()"
    batch = first(decoder.feed(f"1 2.5 244 240 0 12\n2 2.52 (1 2 3 nan)\n3 2.54 1 2 3\n4 2.56 {patches}\n".encode()))
    assert batch.stream is Stream.SKIN
    np.testing.assert_array_equal(batch.values, [[244, 240, 0, 12], [1, 2, 3, np.nan], [1, 2, 3, 4]])
    assert decoder.counts == {Loss.NOT_A_NUMBER: 1, Loss.BAD_WIDTH: 1}


def test_joints_are_degrees_in_yarp_and_radians_here():
    batch = first(YarpDecoder(None, (Stream.JOINTS,)).feed(b"1 2.5 0 90 -45 94\n"))
    assert batch.stream is Stream.JOINTS
    np.testing.assert_allclose(batch.values, [[0, math.pi / 2, -math.pi / 4, 94 * math.pi / 180]], rtol=1e-15)


def test_a_log_carries_one_stream():
    with pytest.raises(InputError, match="one file each"):
        YarpDecoder(4, (Stream.WRENCH, Stream.SKIN))


@pytest.mark.parametrize(
    ("numbers", "missing"),
    [
        ([1, 2, 3, 4, 7, 8], 2),
        ([0, 9, 18, 27, 45, 54], 1),
        ([0, 0, 0, 0], 0),
        ([-1, -1, -1], 0),
        ([5, 6, 7, 1, 2, 3], 0),
        ([0, 9, 18, 28, 37], 0),
    ],
    ids=["steps of one", "steps of nine", "no envelope", "no stamp", "sender started anew", "odd steps"],
)
def test_numbers_missing_in_the_sequence_are_counted(numbers, missing):
    decoder = YarpDecoder(None, (Stream.WRENCH,))
    for number in numbers:
        decoder.feed(f"{number} 2.5 {WORDS}\n".encode())
    assert decoder.counts[Loss.MISSING] == missing


def test_an_endless_line_is_counted_once_and_left():
    decoder = YarpDecoder(None, (Stream.WRENCH,))
    wrench(f"1 2.5 {WORDS}\n".encode(), decoder)
    for _ in range(5):
        assert decoder.feed(b"7" * 600_000) == []
    assert first(decoder.feed(f"\n2 2.6 {WORDS}\n".encode())).seq.tolist() == [2]
    assert decoder.counts == {Loss.UNREADABLE: 1}


def as_text(item: object) -> str:
    if isinstance(item, list):
        return "(" + " ".join(map(as_text, item)) + ")"
    if isinstance(item, str):
        return '"' + item.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return repr(item)


ITEMS = st.recursive(
    st.one_of(st.floats(allow_nan=False), st.text(alphabet='ab ()"\\\t,[{é', max_size=6)),
    lambda inner: st.lists(inner, max_size=4),
    max_leaves=20,
)


@given(st.lists(ITEMS, max_size=5))
def test_a_bottle_reads_back_what_was_written(bottle):
    text = " ".join(map(as_text, bottle))
    assert parse_bottle(text) == bottle


@given(st.lists(ITEMS, min_size=1, max_size=3))
def test_a_bottle_with_half_a_pair_is_refused(bottle):
    text = " ".join(map(as_text, [bottle]))
    with pytest.raises(BottleError):
        parse_bottle(text[:-1])
    with pytest.raises(BottleError):
        parse_bottle(text + ")")


USUAL = st.builds(lambda at: f"{at} {START + at * 1e-3:.6f} 1.5 -2e-3 30 .125 -0.5 6.25\n", st.integers(0, 10**6))
ODD = st.sampled_from(
    [
        "\n",
        "Stamp: rx;\n",
        "7 1400000000.25 1 2 3\n",
        "7 1400000000.25 1 2 3 4 5 nan\n",
        "7 1400000000.25 1 2 3 4 5 1_0\n",
        "7 1400000000.25 1,2,3,4,5,6\n",
        "7 1400000000.25 (1 2 3 4 5 6)\n",
        "7.0 1400000000.25 1 2 3 4 5 6\n",
        "7 1400000000.25 1 2 3 4 5 6\r\n",
        "7\t1400000000.25  1 2 3 4 5 6 \n",
        "7 1400000000.25 1 2 3 4 5\x1f6\n",
        "7 1400000000.25 1 2 3 4 5 6\r8 1400000000.5 1 2 3 4 5 6\n\n",
        "7 9e9 1 2 3 4 5 6\n",
        "7 1400000000.25 1 2",
        "-1 1400000000.25 1 2 3 4 5 6\n",
    ]
)


def shown(batches):
    return [[array.tobytes() for array in (batch.seq, batch.device_s, batch.values)] for batch in batches]


@given(st.lists(st.lists(st.one_of(USUAL, USUAL, USUAL, ODD), min_size=1, max_size=4).map("".join), min_size=1, max_size=6))
def test_many_pieces_are_read_as_one_after_the_other(texts):
    """Whatever stands among them: what many at a time cannot take is left, whole, to be taken one by one."""
    pieces = [text.encode() for text in texts]
    alone, together = YarpDecoder(None, (Stream.WRENCH,)), YarpDecoder(None, (Stream.WRENCH,))
    for decoder in (alone, together):
        decoder.feed(b"1 1400000000 1 2 3 4 5 6\n2 1400000001 1 2 3 4 5 6\n3 1400000002 1 2 3 4 5 6\n")
    expected = [alone.feed(piece) for piece in pieces]
    found = together.feed_many(pieces)
    if found is None:
        assert [shown(together.feed(piece)) for piece in pieces] == [shown(batches) for batches in expected]
    else:
        assert shown([found[0].rows(*span) for span in pairwise([0, *found[1]])]) == [
            row for batches in expected for row in shown(batches)
        ]
    end = b"2000009 1400000009 1 2 3 4 5 6\n"
    assert shown(together.feed(end)) == shown(alone.feed(end)), "and what comes after finds the same decoder"
    assert (together.counts, together.valid_records) == (alone.counts, alone.valid_records)


@pytest.mark.parametrize("mark", ["\r", "\x1c", "\x1d", "\x1e", "\x1f", "_", "\xa0", "\n\n", "#", '"', ",", "\n5 "])
def test_what_parts_words_otherwise_is_no_table(mark):
    assert read_table(b"1 2 3\n4 2 3\n") is not None
    assert read_table(f"1 2 3\n4 2{mark}3\n".encode("latin1")) is None


def test_usual_pieces_are_read_many_at_a_time():
    pieces = [f"{at} {START + at:.6f} {WORDS}\n{at + 1} {START + at + 1:.6f} {WORDS}\n".encode() for at in range(0, 20, 2)]
    batch, ends = YarpDecoder(None, (Stream.WRENCH,)).feed_many(pieces)
    assert batch.values.tolist() == [list(WRENCH)] * 20
    assert ends == list(range(2, 22, 2))


@pytest.mark.parametrize("stamps", [1, 2])
@given(data=st.data())
def test_stamps_of_many_lines_are_those_of_each(stamps, data):
    digits = data.draw(st.sampled_from(["{:.6f}", "{:.0f}", "{:.3f}", "{:.9f}", "{:g}", "{!r}"]))
    times = data.draw(st.lists(st.floats(0, 6e9), min_size=1, max_size=5))
    lines = [f"{k + 8} {' '.join([digits.format(time)] * stamps)} 1 2\n".encode() for k, time in enumerate(times)]
    expected = [split_line(line, stamps) for line in lines]
    found = split_stamps(lines, stamps)
    if None in expected:
        assert found is None
    else:
        assert found.tolist() == [list(line.stamps) for line in expected]


@pytest.mark.parametrize(
    ("text", "width"),
    [
        ("1 2 3\n4 5 6\n", 3),
        ("1\n2\n", 1),
        ("1 2 3\n4 5\n", 0),
        ("1  2\n4 5 6\n", 0),
        (" 1 2\n", 0),
        ("1 2 \n", 0),
        ("1 2\n3 4", 0),
        ("1 2\n\n", 0),
        ("1\t2\n3\t4\n", 0),
        ("1 2\r\n", 0),
    ],
)
def test_the_width_of_even_lines(text, width):
    assert even_width(text.encode()) == width


@pytest.mark.parametrize("word", ["1e400", "-0", "inf", "NaN", "1e-400", ".5", "5.", "+3", "0.1", "1.7976931348623157e308"])
def test_a_tables_words_are_those_of_python_to_the_last_bit(word):
    table = read_table(f"1 {word}\n".encode())
    assert table["values"].tobytes() == np.array([[float(word)]]).tobytes()
    assert table["number"].tolist() == [1]
