"""Peculiarities of makers' devices: status, units, gaps. What all families share is in `devices/test_families.py`."""

import json
import struct

import numpy as np
import pytest

from skincal.devices.bota import crc_x25
from skincal.devices.decoding import pack
from skincal.devices.netft_page import read_page
from skincal.devices.robotiq import FRAME_HEAD, SATURATED_RAW_COUNT, START_ANSWER, START_BYTES, crc_modbus
from skincal.model.readings import TEMPERATURE_NAME, Loss, SideReading, Stream
from skincal.simulation.board_formats import SkbEncoder, SktEncoder
from skincal.streams.decoders.auto_detect import NAMES, LinkDecoder, make_decoder
from tests.skincal.streams.maker_records import RDT_PAGE, VECTORS, WRENCH, rdt_packets, rdt_record

CALIBRATED = pack(1, json.dumps({"message": 1, "1": {"data": "1,2,3", "calibrated": [0.1, 0.2, 0.3]}}).encode())
RDT_SATURATED = bytes.fromhex("FFFFFFFF8000000080020000FFFFFFFF00000002FFFFFFFD00000004FFFFFFFB00000006")
"""A record of the tests of a public client."""
BOTA, ROBOTIQ, PAPILLARRAY, XELA = (VECTORS[name].data for name in ("bota", "robotiq", "papillarray", "xela"))


def decode(name, data, carries=(Stream.WRENCH,), channels=None):
    """The readings in bytes, one array, and the decoder."""
    decoder = make_decoder(name, channels, carries)
    batches = decoder.feed(data)
    return (np.vstack([batch.values for batch in batches]) if batches else np.empty((0, 0))), decoder, batches


def bota(status):
    data = struct.pack("<H6fIf", status, 1, 2, 3, 0.1, 0.2, 0.3, 1001, 30.0)
    return b"\xaa" + data + struct.pack("<H", crc_x25(data))


AXIA_BUSY, AXIA_RANGE, AXIA_BROKEN, ANY_ERROR = 8, 1 << 30, 1 << 2, 1 << 31


@pytest.mark.parametrize(
    ("name", "data", "saturated", "invalid", "words"),
    [
        ("bota", bota(0), False, False, ""),
        ("bota", bota(1), False, False, "it skips samples"),
        ("bota", bota(2), True, False, "beyond its range"),
        ("bota", bota(4), False, True, "invalid"),
        ("bota", bota(8), False, True, "raw measurements"),
        ("bota", bota(3), True, False, "it skips samples: make its filter (sinc length) longer; the force or torque is beyond"),
        ("robotiq", b"", True, False, ""),
        ("rdt", rdt_packets([RDT_SATURATED]), True, False, "80020000"),
        ("rdt", rdt_packets([rdt_record(1, status=AXIA_BUSY)], RDT_PAGE), False, False, ""),
        ("rdt", rdt_packets([rdt_record(1, status=AXIA_RANGE)], RDT_PAGE), True, False, "beyond its range"),
        ("rdt", rdt_packets([rdt_record(1, status=AXIA_BROKEN)], RDT_PAGE), False, True, "broken"),
        ("rdt", rdt_packets([rdt_record(1, status=ANY_ERROR)], RDT_PAGE), False, True, "error"),
    ],
)
def test_the_status_of_a_device_is_a_sentence_and_flags_its_readings(name, data, saturated, invalid, words):
    if name == "robotiq":
        data = FRAME_HEAD + struct.pack("<6h", SATURATED_RAW_COUNT, 0, 0, 0, 0, 0)
        data += struct.pack("<H", crc_modbus(data))
    _, decoder, (batch,) = decode(name, data)
    assert (batch.saturated.tolist(), batch.invalid.tolist()) == ([saturated], [invalid])
    assert words in decoder.device_message
    assert bool(decoder.device_message) == bool(words)
    if name == "rdt":
        decoder.feed(rdt_packets([rdt_record(2)])), decoder.feed(rdt_packets([rdt_record(3)]))
        assert decoder.device_message == "", "a status ends with its cause"


def test_checksums_are_those_of_their_standards():
    assert crc_x25(b"123456789") == 0x906E
    assert crc_modbus(b"123456789") == 0x4B37
    for words in (START_BYTES, START_ANSWER):
        assert crc_modbus(words[:-2]) == int.from_bytes(words[-2:], "little")


def test_the_temperature_of_bota_is_kept():
    assert decode("bota", BOTA)[1].side_readings == {TEMPERATURE_NAME: SideReading(36.5, 36.5, 36.5)}


@pytest.mark.parametrize("size", [1, 5, 200])
@pytest.mark.parametrize(
    ("answer", "bad"),
    [(START_ANSWER, 0), (START_ANSWER * 2, 0), (START_ANSWER[:-1] + b"?", 1)],
    ids=["once", "twice", "damaged"],
)
def test_a_robotiq_that_was_started_again_lost_nothing(size, answer, bad):
    decoder = make_decoder("robotiq", None, (Stream.WRENCH,))
    data = ROBOTIQ * 2 + answer + ROBOTIQ * 2
    found = [batch for at in range(0, len(data), size) for batch in decoder.feed(data[at : at + size])]
    assert sum(len(batch.seq) for batch in found) == 4
    assert decoder.counts == ({Loss.BAD_CHECKSUM: 1} if bad else {})


def test_robotiq_text_may_begin_within_a_reading():
    assert decode("robotiq-text", b"0 , 0.0625)" + VECTORS["robotiq-text"].data)[0].tolist() == [list(WRENCH)]


@pytest.mark.parametrize(
    ("sent", "kept", "losses"),
    [
        ((5, 6, 9, 8, 10, 10, 11), [5, 6, 9, 10, 11], {Loss.MISSING: 2, Loss.LATE: 2}),
        ((2**32 - 3, 2**32 - 1, 0, 1), [2**32 - 3, 2**32 - 1, 2**32, 2**32 + 1], {Loss.MISSING: 1}),
        ((500_000, 1, 2), [500_000, 1, 2], {}),
    ],
    ids=["gaps and overtaken records", "over the wrap", "restarted"],
)
def test_rdt_numbers(sent, kept, losses):
    _, decoder, batches = decode("rdt", rdt_packets([rdt_record(number) for number in sent]))
    assert [number for batch in batches for number in batch.seq.tolist()] == kept
    assert decoder.counts == losses


def test_rdt_units_and_pages_that_are_none():
    page = b"<cfgcpf>1000</cfgcpf><scfgfu>lbf</scfgfu><cfgcpt>2000</cfgcpt><scfgtu>lbf-in</scfgtu>"
    sensor = read_page(page)
    assert 1000 / sensor.per_newton == pytest.approx(4.4482216)
    assert 2000 / sensor.per_newton_metre == pytest.approx(0.11298483)
    for wrong in (b"", b"<cfgcpf>0</cfgcpf><cfgcpt>1</cfgcpt>", b"<cfgcpf>nan</cfgcpf>", page.replace(b"lbf<", b"stone<")):
        with pytest.raises(ValueError, match="its page"):
            read_page(wrong)


def test_frames_of_another_length_are_counted():
    _, decoder, _ = decode("rdt", rdt_packets([b"x" * 35, rdt_record(1)]))
    assert decoder.counts == {Loss.BAD_WIDTH: 1}
    assert "35 bytes" in decoder.device_message
    assert decode("rtde", VECTORS["rtde"].repeat)[1].counts == {Loss.BAD_WIDTH: 1}, "two streams come where one is wanted"


@pytest.mark.parametrize(
    ("name", "data", "channels", "values", "unit"),
    [
        ("xela", XELA, 3, [10.0, 11.0, 255.0], "the force across the skin of each taxel, as raw words"),
        ("xela", XELA, 9, [0x7F3C, 0x7B6C, 10, 1, 2, 11, 3, 4, 255], "x y z of each taxel, as raw words"),
        ("xela", CALIBRATED, 1, [0.3], "the force across the skin of each taxel, in N"),
        ("papillarray", PAPILLARRAY, 2, [3.0, 6.0], "the force along each pillar, in N"),
        ("papillarray", PAPILLARRAY, 6, [1, 2, 3, -4, 5, 6], "Fx Fy Fz of each pillar, in N"),
    ],
)
def test_a_channel_is_the_normal_force_or_each_component_and_the_unit_says_which(name, data, channels, values, unit):
    found, decoder, _ = decode(name, data, (Stream.SKIN,), channels)
    assert found.tolist() == [values]
    assert decoder.units[Stream.SKIN] == unit


def test_xela_counts_missing_messages_and_refuses_what_is_no_reading():
    greeting = b'{"message": "Welcome", "sensors": 2}'
    messages = [XELA[5:].replace(b": 7,", b": %d," % i) for i in (1, 2, 3, 6)]
    hostile = [b"[" * 5000, b"5", b'{"message": 9, "1": 5}', b'{"message": 9, "1": {"data": "zz"}}', b"\xff"]
    data = b"".join(pack(1, message) for message in [greeting, *messages, *hostile])
    found, decoder, _ = decode("xela", data, (Stream.SKIN,), 3)
    assert (len(found), decoder.counts) == (4, {Loss.MISSING: 2, Loss.UNREADABLE: 5})


def test_every_decoder_names_its_values_and_their_unit():
    for name in NAMES[1:]:
        # Those of files carry one stream.
        units = make_decoder(name, None, (Stream.SKIN,) if name.startswith(("yarp", "csv", "records")) else tuple(Stream)).units
        assert units[Stream.WRENCH] == "Fx Fy Fz in N, Mx My Mz in N m"
        assert "degrees" in units[Stream.JOINTS]
        assert units[Stream.SKIN]


@pytest.mark.parametrize(
    ("unit", "words"), [("kPa", "values in kPa"), ("raw", "raw values"), ("x" * 50, f"values in {'x' * 20}")]
)
def test_a_board_names_the_unit_of_its_skin(unit, words):
    for encoder in (SkbEncoder("f32"), SktEncoder("f32")):
        decoder = make_decoder(type(encoder).__name__[:3].lower(), 4, (Stream.SKIN,))
        decoder.feed(encoder.header(0, f"n=4,unit={unit},kind=taxel", 4) + encoder.header(0, "unit=N,kind=ft", 6))
        assert decoder.units[Stream.SKIN] == words


def test_noise_is_taken_for_no_device():
    """Ten seconds of a line at the wrong baud rate, and more."""
    link = LinkDecoder("auto", None, (Stream.WRENCH,))
    noise = np.random.default_rng(1).integers(0, 256, 1_000_000, np.uint8).tobytes()
    for at in range(0, len(noise), 4096):
        assert link.feed(noise[at : at + 4096], at * 90_000) == []
