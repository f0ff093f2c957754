"""Makers' devices: published vectors, whole and byte by byte, garbage, and what is counted and said."""

import json
import struct
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skincal.devices.bota import BotaDecoder, crc_x25
from skincal.devices.decoding import pack
from skincal.devices.netft import given_page, read_page
from skincal.devices.robotiq import FRAME, HEAD, SATURATED_COUNT, START, START_ANSWER, crc_modbus
from skincal.model.readings import TEMPERATURE, JointsBatch, Loss, SideReading, Stream, WrenchBatch
from skincal.simulate.device import SkbEncoder, SktEncoder
from skincal.streams.decoders.auto_detect import NAMES, LinkDecoder, make_decoder
from tests.skincal.streams import maker_records as records

WRENCH, SKIN, JOINTS = (Stream.WRENCH,), (Stream.SKIN,), (Stream.JOINTS,)
XELA = json.dumps(
    {
        "message": 7,
        "2": {"taxels": 1, "data": "0003,0004,00FF"},
        "1": {"taxels": 2, "data": "7F3C,7B6C,000A,0001,0002,000B"},
    }
).encode()
CALIBRATED = json.dumps({"message": 1, "1": {"data": "1,2,3", "calibrated": [0.1, 0.2, 0.3]}}).encode()
GREETING = json.dumps({"message": "Welcome", "sensors": 2}).encode()


def bota(seq, force=1.0, status=0, temperature=30.0):
    data = struct.pack("<H6fIf", status, force, 2, 3, 0.1, 0.2, 0.3, seq * 1000 + 1, temperature)
    return b"\xaa" + data + struct.pack("<H", crc_x25(data))


def robotiq(counts):
    frame = HEAD + struct.pack("<6h", *counts)
    return frame + struct.pack("<H", crc_modbus(frame))


STREAMS = {
    "bota": (WRENCH, b"".join(bota(i) for i in range(6))),
    "robotiq": (WRENCH, b"".join(robotiq([i, -i, 3, 4, 5, 6]) for i in range(6))),
    "robotiq-text": (WRENCH, records.ROBOTIQ_TEXT * 6),
    "rdt": (WRENCH, records.rdt_packets([records.rdt_record(i) for i in range(6)])),
    "rtde": ((Stream.JOINTS, Stream.WRENCH), records.RTDE_ANSWERS + records.RTDE_DATA * 6),
    "xela": (SKIN, pack(1, GREETING) + b"".join(pack(1, XELA.replace(b": 7,", b": %d," % i)) for i in range(6))),
    "papillarray": (SKIN, records.PAPILLARRAY * 6),
    "yarp-port": (WRENCH, records.YARP_NUMBER + records.YARP_VECTOR * 5 + records.YARP_MIXED),
}
CHANNELS = {"xela": 3, "papillarray": 2}


def rows(batches):
    return [
        (type(batch).__name__, values.tolist(), None if np.isnan(stamp) else stamp)
        for batch in batches
        for values, stamp in zip(
            batch.wrench
            if isinstance(batch, WrenchBatch)
            else batch.angles
            if isinstance(batch, JointsBatch)
            else batch.values,
            batch.device_s.tolist(),
            strict=True,
        )
    ]


def decode(name, data, cuts=(), carries=None, channels=None):
    decoder = make_decoder(name, channels or CHANNELS.get(name), carries or STREAMS[name][0])
    edges = [0, *sorted(cuts), len(data)]
    found = [row for a, b in pairwise(edges) for row in rows(decoder.feed(data[a:b]))]
    # Two streams of one chunk come one after the other: the order between streams is the chunks' affair.
    return sorted(found, key=lambda row: row[0]), decoder


@pytest.mark.parametrize("name", STREAMS)
def test_whole_and_byte_by_byte_are_the_same(name):
    data = STREAMS[name][1]
    whole, decoder = decode(name, data)
    bytewise, other = decode(name, data, range(1, len(data)))
    assert whole == bytewise
    assert decoder.counts == other.counts
    per_packet = 2 if name == "rtde" else 1
    assert len(whole) == 6 * per_packet
    assert decoder.counts.total() == 0
    assert decoder.valid_records == 6


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(sorted(STREAMS)), st.data())
def test_garbage_and_any_cuts_raise_nothing_and_never_matter(name, data):
    stream = bytearray(STREAMS[name][1])
    for _ in range(data.draw(st.integers(0, 4))):
        at = data.draw(st.integers(0, len(stream)))
        stream[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=12))
    raw = bytes(stream)
    whole, decoder = decode(name, raw)
    pieces, other = decode(name, raw, data.draw(st.lists(st.integers(0, len(raw)), max_size=10)))
    assert whole == pieces
    assert decoder.counts == other.counts


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(sorted(STREAMS)), st.binary(max_size=400))
def test_noise_is_no_reading_and_little_is_kept(name, noise):
    _, decoder = decode(name, noise * 20)
    if name != "robotiq-text":
        assert decoder.valid_records == 0


@pytest.mark.parametrize("name", ["bota", "robotiq", "papillarray"])
def test_frames_after_garbage_are_found_again(name):
    data = STREAMS[name][1]
    broken = bytearray(data)
    broken[len(data) // 2] ^= 0x40
    found, decoder = decode(name, bytes(broken) + data * 200)
    assert len(found) >= 1100
    assert decoder.counts[Loss.BAD_CHECKSUM] == 1


# ------------------------------------------------------------------ published vectors


def test_bota_vectors():
    (row,), decoder = decode("bota", records.BOTA)
    assert row == ("WrenchBatch", list(records.WRENCH), 0.123456)
    assert decoder.side_readings == {TEMPERATURE: SideReading(36.5, 36.5, 36.5)}
    assert decoder.device_message == ""
    assert crc_x25(b"123456789") == 0x906E
    over = BotaDecoder(None, WRENCH)
    (batch,) = over.feed(records.BOTA_OVER)
    assert batch.saturated.tolist() == [True]
    assert "beyond its range" in over.device_message
    over.feed(records.BOTA)
    assert over.device_message == ""


@pytest.mark.parametrize(
    ("status", "saturated", "invalid", "words"),
    [
        (1, False, False, "it skips samples"),
        (2, True, False, "beyond its range"),
        (4, False, True, "invalid"),
        (8, False, True, "raw measurements"),
        (3, True, False, "it skips samples: make its filter (sinc length) longer; the force or torque is beyond"),
        (0, False, False, ""),
    ],
)
def test_each_status_bit_of_bota_is_a_sentence_and_what_it_says_is_heeded(status, saturated, invalid, words):
    decoder = BotaDecoder(None, WRENCH)
    (batch,) = decoder.feed(bota(1, status=status))
    assert (batch.saturated.tolist(), batch.invalid.tolist()) == ([saturated], [invalid])
    assert words in decoder.device_message
    assert bool(decoder.device_message) == bool(words)


def test_robotiq_vectors():
    (row,), _ = decode("robotiq", records.ROBOTIQ)
    assert row == ("WrenchBatch", list(records.RDT_WRENCH), None)
    (row,), _ = decode("robotiq-text", b"0 , 0.0625)" + records.ROBOTIQ_TEXT)
    assert row[1] == list(records.WRENCH)
    assert crc_modbus(b"123456789") == 0x4B37
    for words in (START, START_ANSWER):
        assert crc_modbus(words[:-2]) == int.from_bytes(words[-2:], "little")
    batch = make_decoder("robotiq", None, WRENCH).feed(robotiq([SATURATED_COUNT, 0, 0, 0, 0, 0]))[0]
    assert batch.saturated.tolist() == [True]
    assert FRAME.size == 16


@pytest.mark.parametrize("size", [1, 5, 200])
@pytest.mark.parametrize(
    ("answer", "bad"),
    [(START_ANSWER, 0), (START_ANSWER * 2, 0), (START_ANSWER[:-1] + b"?", 1)],
    ids=["once", "twice", "damaged"],
)
def test_a_robotiq_that_was_started_again_lost_nothing(size, answer, bad):
    decoder = make_decoder("robotiq", None, WRENCH)
    data = records.ROBOTIQ * 2 + answer + records.ROBOTIQ * 2
    read = rows([batch for at in range(0, len(data), size) for batch in decoder.feed(data[at : at + size])])
    assert [row[1] for row in read] == [list(records.RDT_WRENCH)] * 4
    assert decoder.counts == ({Loss.BAD_CHECKSUM: 1} if bad else {})


def test_rdt_vectors():
    found, decoder = decode("rdt", records.rdt_packets([records.RDT_RECORD]))
    assert found[0][1] == pytest.approx(records.RDT_WRENCH)
    found, _ = decode("rdt", records.rdt_packets([records.HEX_RECORD], given_page(1e4, 1e5, "OnRobot HEX")))
    assert found[0][1] == pytest.approx(records.RDT_WRENCH)
    decoder = make_decoder("rdt", None, WRENCH)
    (batch,) = decoder.feed(records.rdt_packets([records.RDT_SATURATED]))
    assert batch.wrench[0].tolist() == pytest.approx([-1e-6, 2e-6, -3e-6, 4e-6, -5e-6, 6e-6])
    assert batch.saturated.tolist() == [True]
    assert "saturated" in decoder.device_message
    assert "80020000" in decoder.device_message
    decoder.feed(records.rdt_packets([records.rdt_record(0)]))
    assert decoder.device_message == ""


@pytest.mark.parametrize(
    ("status", "saturated", "invalid", "words"),
    [
        (1 << 30, True, False, "beyond its range"),
        (1 << 2, False, True, "broken"),
        (8, False, False, ""),
        (1 << 31, False, True, "error"),
    ],
)
def test_axia_has_a_table_of_its_own(status, saturated, invalid, words):
    decoder = make_decoder("rdt", None, WRENCH)
    (batch,) = decoder.feed(records.rdt_packets([records.rdt_record(1, status=status)], records.RDT_PAGE))
    assert (batch.saturated.tolist(), batch.invalid.tolist()) == ([saturated], [invalid])
    assert words in decoder.device_message
    assert bool(decoder.device_message) == bool(words)


def test_rdt_counts_what_is_missing_and_leaves_out_what_was_overtaken():
    numbers = [5, 6, 9, 8, 10, 10, 11, 2**32 - 3, 2**32 - 1, 0, 1]
    found, decoder = decode("rdt", records.rdt_packets([records.rdt_record(n) for n in numbers[:7]]))
    assert len(found) == 5
    assert decoder.counts == {Loss.MISSING: 2, Loss.LATE: 2}
    found, decoder = decode("rdt", records.rdt_packets([records.rdt_record(n) for n in numbers[7:]]))
    assert (len(found), decoder.counts) == (4, {Loss.MISSING: 1})  # over the wrap
    found, decoder = decode("rdt", records.rdt_packets([records.rdt_record(n) for n in (500_000, 1, 2)]))
    assert (len(found), decoder.counts.total()) == (3, 0)  # it began anew


@pytest.mark.parametrize(
    ("sent", "told"), [((2**32 - 1, 0, 3), (2**32 - 1, 2**32, 2**32 + 3)), ((500_000, 1, 2), (500_000, 1, 2))]
)
def test_rdt_numbers_go_on_over_the_wrap_and_begin_anew_with_the_sensor(sent, told):
    batches = make_decoder("rdt", None, WRENCH).feed(records.rdt_packets([records.rdt_record(n) for n in sent]))
    assert [number for batch in batches for number in batch.seq.tolist()] == list(told)


def test_rdt_units_and_pages_that_are_none():
    page = b"<cfgcpf>1000</cfgcpf><scfgfu>lbf</scfgfu><cfgcpt>2000</cfgcpt><scfgtu>lbf-in</scfgtu>"
    sensor = read_page(page)
    assert 1000 / sensor.per_newton == pytest.approx(4.4482216)
    assert 2000 / sensor.per_newton_metre == pytest.approx(0.11298483)
    for wrong in (b"", b"<cfgcpf>0</cfgcpf><cfgcpt>1</cfgcpt>", b"<cfgcpf>nan</cfgcpf>", page.replace(b"lbf<", b"stone<")):
        with pytest.raises(ValueError, match="its page"):
            read_page(wrong)


def test_datagram_of_another_length_is_counted():
    _, decoder = decode("rdt", records.rdt_packets([b"x" * 35, records.rdt_record(1)]))
    assert decoder.counts == {Loss.BAD_WIDTH: 1}
    assert "35 bytes" in decoder.device_message


def test_rtde_vector():
    found, decoder = decode("rtde", records.RTDE_ANSWERS + records.RTDE_DATA)
    joints, wrench = found
    assert joints[1] == pytest.approx(records.RTDE_Q)
    assert joints[2] == 12.5
    assert wrench == ("WrenchBatch", list(records.WRENCH), 12.5)
    assert decoder.counts.total() == 0
    _, decoder = decode("rtde", records.RTDE_DATA, carries=WRENCH)
    assert decoder.counts == {Loss.BAD_WIDTH: 1}


def test_papillarray_vector():
    (row,), _ = decode("papillarray", records.PAPILLARRAY)
    assert row == ("SkinBatch", [3.0, 6.0], 987.654321)
    (row,), _ = decode("papillarray", records.PAPILLARRAY, channels=6)
    assert row[1] == [1, 2, 3, -4, 5, 6]


def test_xela_takes_the_normal_or_all_three():
    found, _ = decode("xela", pack(1, GREETING) + pack(1, XELA))
    assert found[0][1] == [10.0, 11.0, 255.0]
    found, _ = decode("xela", pack(1, XELA), channels=9)
    assert found[0][1] == [0x7F3C, 0x7B6C, 10, 1, 2, 11, 3, 4, 255]
    found, _ = decode("xela", pack(1, CALIBRATED), channels=1)
    assert found[0][1] == [0.3]


@pytest.mark.parametrize(
    ("name", "data", "channels", "words"),
    [
        ("xela", pack(1, XELA), None, "the force across the skin of each taxel, as raw words"),
        ("xela", pack(1, XELA), 9, "x y z of each taxel, as raw words"),
        ("xela", pack(1, CALIBRATED), 1, "the force across the skin of each taxel, in N"),
        ("papillarray", records.PAPILLARRAY, 2, "the force along each pillar, in N"),
        ("papillarray", records.PAPILLARRAY, 6, "Fx Fy Fz of each pillar, in N"),
    ],
)
def test_what_a_channel_is_is_said_beside_its_unit(name, data, channels, words):
    _, decoder = decode(name, data, channels=channels)
    assert decoder.units[Stream.SKIN] == words


def test_every_decoder_names_what_it_sends_with_its_unit():
    for name in NAMES[1:]:
        # Those of files carry one stream.
        units = make_decoder(name, None, SKIN if name.startswith(("yarp", "csv")) else tuple(Stream)).units
        assert units[Stream.WRENCH] == "Fx Fy Fz in N, Mx My Mz in N m"
        assert "degrees" in units[Stream.JOINTS]
        assert units[Stream.SKIN]


def test_a_board_names_the_unit_of_its_skin():
    for encoder in (SkbEncoder("f32"), SktEncoder("f32")):
        for unit, words in (("kPa", "values in kPa"), ("raw", "raw values"), ("x" * 50, "values in " + "x" * 20)):
            decoder = make_decoder(type(encoder).__name__[:3].lower(), 4, SKIN)
            decoder.feed(encoder.header(0, f"n=4,unit={unit},kind=taxel", 4) + encoder.header(0, "unit=N,kind=ft", 6))
            assert decoder.units[Stream.SKIN] == words


def test_xela_counts_missing_messages_and_refuses_what_is_no_reading():
    messages = [XELA.replace(b": 7,", b": %d," % i) for i in (1, 2, 3, 6)]
    hostile = [b"[" * 5000, b"5", b'{"message": 9, "1": 5}', b'{"message": 9, "1": {"data": "zz"}}', b"\xff"]
    _, decoder = decode("xela", b"".join(pack(1, message) for message in messages + hostile))
    assert decoder.counts == {Loss.MISSING: 2, Loss.UNREADABLE: 5}


# ------------------------------------------------------------------ told apart by themselves


@pytest.mark.parametrize("name", ["bota", "robotiq", "papillarray"])
def test_a_serial_stream_is_told_apart_by_itself(name):
    link = LinkDecoder("auto", CHANNELS.get(name), STREAMS[name][0])
    data = STREAMS[name][1]
    found = [batch for at in range(0, len(data), 10) for batch in link.feed(data[at : at + 10], at * 1_000_000)]
    assert link.name == make_decoder(name, None, WRENCH).name
    assert sum(len(batch.seq) for _, batch in found) == 6


def test_noise_is_taken_for_no_device():
    """Ten seconds of a line at the wrong baud rate, and more."""
    link = LinkDecoder("auto", None, WRENCH)
    noise = np.random.default_rng(1).integers(0, 256, 1_000_000, np.uint8).tobytes()
    for at in range(0, len(noise), 4096):
        assert link.feed(noise[at : at + 4096], at * 90_000) == []
