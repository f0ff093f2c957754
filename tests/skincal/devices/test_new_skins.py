"""Devices without a strong check of their bytes: damage, restarts and false marks are counted, and no reading is wrong."""

import struct

import numpy as np
import pytest

from skincal.devices.decoding import pack
from skincal.devices.flexitac import FRAME_MARK
from skincal.devices.inspire import TAXEL_READS, InspireHandshake, read_request
from skincal.devices.justfloat import FRAME_END
from skincal.devices.leptrino import STREAM_OFF, STREAM_ON, LeptrinoHandshake, message
from skincal.devices.paxini import REGISTERS_READ, PaxiniHandshake, lrc, request
from skincal.devices.paxini_module import ModuleHandshake
from skincal.devices.paxini_module import read_request as module_request
from skincal.devices.registry import load_family, parse_device
from skincal.devices.tsf85 import read_fields, start_request
from skincal.model.errors import InputError
from skincal.model.readings import TEMPERATURE_NAME, Loss, Stream
from skincal.model.scene import load_scene
from skincal.simulation.emulated_devices import MAKERS
from skincal.streams.decoders.auto_detect import make_decoder

SKIN, WRENCH = (Stream.SKIN,), (Stream.WRENCH,)
NAMES = ("paxini-module", "justfloat", "flexitac", "anyskin", "tsf85", "inspire", "paxini", "leptrino")
CHANNELS = {"tsf85": 56, "inspire": 1062, "leptrino": 6}
TOP = {"paxini": 25, "paxini-module": 25, "leptrino": 150}


def decoder_of(name, channels=None):
    carries = WRENCH if name == "leptrino" else SKIN
    return make_decoder(name, CHANNELS.get(name, 12) if channels is None else channels, carries)


def rows_of(name, count, seed=1):
    """Whole numbers that no two frames share, so that a wrong reading is known from every right one."""
    width = CHANNELS.get(name, 12)
    rng = np.random.default_rng([seed, len(name)])
    rows = rng.integers(1, TOP.get(name, 200), (count, width))
    rows = rows.astype(float)
    if name == "leptrino":
        rows[:, 3:] /= 32.0  # N m
    return rows


def bytes_of(name, rows):
    """Frames of the emulated device, one for each row, after what it tells first; written without code of the decoders."""
    encoder = MAKERS[name].encoder()
    stream = Stream.WRENCH if name == "leptrino" else Stream.SKIN
    first = b""
    if name in ("leptrino", "paxini"):
        vector = load_family(name).vectors[0]
        first = vector.data[: -len(vector.repeat)]
    if name == "paxini":  # one module of 12 taxels in place of the vector's two
        taxels = struct.pack("<2sBBHH", b"\xaa\x55", 0, 3, 0x30, 56) + bytes(12) + b"\x0c\x00" + bytes(42)
        first = first[:-65] + taxels + bytes((lrc(taxels),))
    frames = [encoder.record(stream, 1000 * at, row.tolist()) for at, row in enumerate(rows)]
    if name == "inspire":
        frames = [with_numbers(frame) for frame in frames]
    return first, frames


def with_numbers(frame, off=0, late=0):
    """Answers of the hand, with the number of the request so many before, plus `off`."""
    out, at = b"", 0
    for index, (_, registers) in enumerate(TAXEL_READS):
        size = 9 + 2 * registers
        out += struct.pack(">H", 8 + 16 * ((index - late) % len(TAXEL_READS)) + off) + frame[at + 2 : at + size]
        at += size
    return out


def closing(name):
    """Bytes that complete the last frame."""
    return {"flexitac": FRAME_MARK, "tsf85": b"\x9a"}.get(name, b"")


def values_of(decoder, data, cut=None):
    cut = cut or len(data)
    batches = [batch for at in range(0, len(data), cut) for batch in decoder.feed(data[at : at + cut])]
    return np.vstack([batch.values for batch in batches]) if batches else np.empty((0, 0))


def in_units(name, rows):
    """Rows as the decoder hands them on."""
    if name == "leptrino":  # counts of 1/10000 of the rating, in the vector's own ratings
        ratings, own = np.array([250, 250, 500, 5, 5, 5.0]), np.array([200, 200, 400, 8, 8, 8.0])
        return np.clip(np.rint(rows / own * 10000), -32768, 32767) * ratings / 10000
    return rows


@pytest.mark.parametrize("cut", [None, 1, 37], ids=["at once", "byte by byte", "in pieces"])
@pytest.mark.parametrize("name", NAMES)
def test_the_emulated_device_is_read_however_its_bytes_are_cut(name, cut):
    count = 8 if name != "inspire" or cut is None else 3
    rows = rows_of(name, count)
    first, frames = bytes_of(name, rows)
    decoder = decoder_of(name)
    found = values_of(decoder, first + b"".join(frames) + closing(name), cut)
    missed = {"justfloat": 1, "anyskin": 1, "inspire": 1}.get(name, 0)  # before the first mark, and before the first palm
    assert found == pytest.approx(in_units(name, rows[missed:]), rel=1e-6)
    assert decoder.counts.total() == 0


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("damage", ["lost", "inserted", "doubled", "cut short", "garbage between"])
def test_damaged_bytes_are_counted_and_give_no_wrong_reading(name, damage):
    rows = rows_of(name, 40)
    first, frames = bytes_of(name, rows)
    rng = np.random.default_rng(5)
    for hit in (12, 20, 21, 30):
        frame = frames[hit]
        at = int(rng.integers(1, len(frame) - 1))
        frames[hit] = {
            "lost": frame[:at] + frame[at + 1 :],
            "inserted": frame[:at] + b"\x37" + frame[at:],
            "doubled": frame[: at + 1] + frame[at:],
            "cut short": frame[:at],
            "garbage between": frame + rng.integers(0, 256, 50, np.uint8).tobytes(),
        }[damage]
    decoder = decoder_of(name)
    found = values_of(decoder, first + b"".join(frames) + closing(name), 64)
    place = {tuple(np.round(row, 3)): at for at, row in enumerate(in_units(name, rows))}
    # Modbus TCP has no marks: TCP loses nothing, and a stream that breaks it ends.
    assert len(found) >= (10 if name == "inspire" else 20), decoder.counts
    order = [place[tuple(np.round(row, 3))] for row in found]
    assert order == sorted(set(order))
    assert decoder.counts.total() >= 1


@pytest.mark.parametrize("name", NAMES)
def test_a_device_that_restarts_in_the_middle_of_a_frame_goes_on(name):
    rows = rows_of(name, 30)
    first, frames = bytes_of(name, rows)
    half = frames[10][: len(frames[10]) // 2]
    if name == "inspire":
        pytest.skip("a restart ends its TCP connection, and a new one has a decoder of its own")
    decoder = decoder_of(name)
    found = values_of(decoder, first + b"".join(frames[:10]) + half + first + b"".join(frames[11:]) + closing(name))
    allowed = {tuple(np.round(row, 3)) for row in in_units(name, rows)}
    assert all(tuple(np.round(row, 3)) in allowed for row in found)
    assert len(found) >= 22
    assert decoder.counts.total() >= 1


@pytest.mark.parametrize("name", ["justfloat", "flexitac", "anyskin", "tsf85", "leptrino", "paxini"])
def test_a_reader_that_joins_in_the_middle_loses_the_first_frames_alone(name):
    rows = rows_of(name, 20)
    first, frames = bytes_of(name, rows)
    decoder = decoder_of(name)
    found = values_of(decoder, first + (b"".join(frames) + closing(name))[7:], 50)
    assert np.round(found, 3).tolist() == np.round(in_units(name, rows[-len(found) :]), 3).tolist()
    assert len(found) >= 18
    assert decoder.counts.total() <= 1


# ------------------------------------------------------------------ frames with marks between them


@pytest.mark.parametrize(("name", "mark"), [("flexitac", FRAME_MARK), ("anyskin", b"\r\n"), ("justfloat", FRAME_END)])
def test_another_number_of_values_than_the_scene_has_is_said(name, mark):
    rows = rows_of(name, 60)
    _, frames = bytes_of(name, rows)
    decoder = decoder_of(name, 20)
    assert values_of(decoder, b"".join(frames), 100).size == 0
    assert "of 12 values arrive where 20 are expected" in decoder.device_message
    unknown = make_decoder(name, None, SKIN)
    assert values_of(unknown, b"".join(frames) + mark).shape[1] == 12


def test_two_taxels_that_equal_the_mark_while_it_is_joined_give_no_wrong_reading():
    """A published reader stays out of step for ever: the mark also repeats inside, a frame length apart."""
    steady = bytes([9, 0xAA, 0x55, 7, 8, 9, 10, 11])
    data = (FRAME_MARK + steady) * 40
    decoder = make_decoder("flexitac", 8, SKIN)
    assert values_of(decoder, data[5:]).size == 0
    assert "also repeats inside" in decoder.device_message
    pressed = bytes([9, 0xAB, 0x55, 7, 8, 9, 10, 11])
    found = values_of(decoder, (FRAME_MARK + pressed) * 10 + FRAME_MARK)
    assert {tuple(row) for row in found} <= {tuple(map(float, steady)), tuple(map(float, pressed))}
    assert len(found) >= 6
    assert decoder.device_message == ""


def test_a_mark_inside_a_frame_that_is_known_already_changes_nothing():
    plain, marked = bytes([9, 1, 2, 7]), bytes([9, 0xAA, 0x55, 7])
    data = (FRAME_MARK + plain) * 5 + (FRAME_MARK + marked) * 30 + FRAME_MARK
    decoder = make_decoder("flexitac", 4, SKIN)
    assert values_of(decoder, data).tolist() == [list(plain)] * 5 + [list(marked)] * 30
    assert decoder.counts.total() == 0


def test_the_end_of_an_anyskin_frame_inside_a_float_is_told_by_the_values():
    """0D 0A in a float that does not change: values from that place on would be none of a magnetometer."""
    odd = struct.unpack("<f", b"\x0d\x0a\x20\x41")[0]  # 10.0025...
    frame = struct.pack("<8f", 25, odd, 1.0, 2.0, 25, 3.0, 4.0, 5.0) + b"\r\n"
    decoder = make_decoder("anyskin", 6, SKIN)
    found = values_of(decoder, (frame * 30)[11:])
    assert len(found) >= 26
    assert np.unique(found, axis=0) == pytest.approx(np.array([[odd, 1.0, 2.0, 3.0, 4.0, 5.0]]))


def test_lines_of_text_are_no_frames_of_a_magnetometer():
    """ReSkin boards may send text; the bytes of its digits are small floats."""
    line = b"25.10\t-3.1\t40.25\t7.123456\t3.0000"[:32] + b"\r\n"
    decoder = make_decoder("anyskin", 2, SKIN)
    assert values_of(decoder, line * 50).size == 0
    assert decoder.valid_records == 0


def test_values_that_no_sensor_has_are_no_reading():
    frame = struct.pack("<3f", 1.0, 2.0, 3.0) + FRAME_END
    broken = struct.pack("<3f", 1.0, 2e35, 3.0) + FRAME_END
    decoder = make_decoder("justfloat", 3, SKIN)
    found = values_of(decoder, FRAME_END + frame * 5 + broken + frame * 2)
    assert (len(found), decoder.counts) == (7, {Loss.UNREADABLE: 1})


def test_the_temperature_of_magnetic_chips_is_kept_and_the_unit_says_what_a_channel_is():
    vectors = load_family("anyskin").vectors
    lengths, vectors = (make_decoder("anyskin", each.channels, SKIN) for each in vectors)
    for decoder, words in ((lengths, "the length of the magnetic field of each chip"), (vectors, "Bx By Bz of each chip")):
        decoder.feed(load_family("anyskin").vectors[0].data)
        assert decoder.side_readings[TEMPERATURE_NAME].now == 26.0
        assert words in decoder.units[Stream.SKIN]
        assert decoder.skin_unit == ""


# ------------------------------------------------------------------ Leptrino


def test_requests_of_leptrino_are_those_of_the_published_driver():
    assert message(0x2B) == bytes.fromhex("100204FF2B001003D3")
    assert message(STREAM_ON) == bytes.fromhex("100204FF32001003CA")
    assert message(STREAM_OFF) == bytes.fromhex("100204FF33001003CB")


def test_leptrino_is_started_after_its_ratings_and_asked_again_when_silent():
    handshake, vector = LeptrinoHandshake(), load_family("leptrino").vectors[0]
    assert handshake.opening() == message(STREAM_OFF) + message(0x2B)
    ratings = vector.data[: -len(vector.repeat)]
    assert handshake.on_data(ratings[:10]) == b""
    assert handshake.on_data(ratings[10:]) == message(STREAM_ON)
    assert handshake.on_data(vector.repeat) == b""
    assert handshake.on_silence() == handshake.opening()
    assert handshake.on_data(ratings) == message(STREAM_ON)


def test_leptrino_without_ratings_gives_no_readings_and_says_so():
    vector = load_family("leptrino").vectors[0]
    decoder = make_decoder("leptrino", None, WRENCH)
    assert values_of(decoder, vector.repeat * 3).size == 0
    assert decoder.counts == {Loss.UNREADABLE: 2}
    assert "before the sensor's ratings" in decoder.device_message
    assert len(values_of(decoder, vector.data)) == 1
    assert decoder.device_message == ""


def test_a_byte_that_is_stuffed_is_read_in_each_value():
    """The package myLepFT loses each frame that holds the byte 10 hex."""
    vector = load_family("leptrino").vectors[0]
    for axis in range(6):
        counts = [0] * 6
        counts[axis] = 0x1010
        body = b"\x14\xff\x32\x00" + struct.pack("<6h", *counts) + bytes(4)
        check = 3
        for byte in body:
            check ^= byte
        frame = b"\x10\x02" + body.replace(b"\x10", b"\x10\x10") + b"\x10\x03" + bytes((check,))
        decoder = make_decoder("leptrino", None, WRENCH)
        found = values_of(decoder, vector.data[: -len(vector.repeat)] + frame)[0]
        assert found[axis] == pytest.approx(0x1010 * (250, 250, 500, 5, 5, 5)[axis] / 10000)


@pytest.mark.parametrize(("count", "result", "saturated", "invalid"), [(10001, 0, True, False), (100, 2, False, True)])
def test_leptrino_beyond_its_rating_or_with_a_fault_is_said(count, result, saturated, invalid):
    vector = load_family("leptrino").vectors[0]
    body = bytes((0x14, 0xFF, 0x32, result)) + struct.pack("<6h", count, 0, 0, 0, 0, 0) + bytes(4)
    check = 3
    for byte in body:
        check ^= byte
    decoder = make_decoder("leptrino", None, WRENCH)
    frame = b"\x10\x02" + body.replace(b"\x10", b"\x10\x10") + b"\x10\x03" + bytes((check,))
    (batch,) = decoder.feed(vector.data[: -len(vector.repeat)] + frame)
    assert (batch.saturated.tolist(), batch.invalid.tolist()) == ([saturated], [invalid])
    assert decoder.device_message


# ------------------------------------------------------------------ Robotiq TSF-85


def finger(index, first, more=b""):
    fields = bytes((0x10 | index << 2,)) + np.arange(first, first + 28).astype(">u2").tobytes() + more
    return bytes((0x9A, 0, 0x61, len(fields))) + fields


def test_a_finger_of_tsf85_begins_as_the_published_bytes_and_the_start_is_the_makers():
    assert finger(1, 0)[:5].hex() == "9a00613914"
    assert start_request().hex() == "9a0058010a"


@pytest.mark.parametrize("clock", [2, 8], ids=["older clock", "newer clock"])
def test_fields_behind_the_pressure_are_passed_over(clock):
    more = b"\x20\x00\x01" + b"\x70" + bytes(clock)
    decoder = make_decoder("tsf85", 56, SKIN)
    found = values_of(decoder, finger(0, 100, more) + finger(1, 200, more) + b"\x9a")
    assert found.tolist() == [[*range(100, 128), *range(200, 228)]]
    assert [kind for kind, _, _ in read_fields(finger(0, 100, more)[4:])] == [0x10, 0x20, 0x70]


def test_a_stray_start_byte_costs_nothing_and_a_lost_finger_is_counted():
    decoder = make_decoder("tsf85", 56, SKIN)
    data = b"\x9a" + finger(0, 1) + finger(1, 2) + finger(0, 3) + finger(0, 5) + finger(1, 6) + b"\x9a"
    assert [row[0] for row in values_of(decoder, data).tolist()] == [1, 5]
    assert decoder.counts == {Loss.MISSING: 1}


def test_fingers_before_and_after_lost_bytes_are_no_pair():
    decoder = make_decoder("tsf85", 56, SKIN)
    lost = finger(1, 2)[:40] + finger(0, 3)[30:]
    found = values_of(decoder, finger(0, 1) + lost + finger(1, 4) + finger(0, 5) + finger(1, 6) + b"\x9a")
    assert [(row[0], row[28]) for row in found.tolist()] == [(5, 6)]


def test_one_finger_alone_is_named_and_a_scene_of_one_finger_is_told_what_to_type():
    alone = make_decoder("tsf85", 56, SKIN)
    assert values_of(alone, finger(1, 7) * 30 + b"\x9a").size == 0
    assert "Only finger 1 sends" in alone.device_message
    one = make_decoder("tsf85", 28, SKIN)
    one.feed((finger(0, 1) + finger(1, 2)) * 3 + b"\x9a")
    assert "?channels=0-27&of=56" in one.device_message
    assert one.counts == {Loss.BAD_WIDTH: 3}


# ------------------------------------------------------------------ Inspire


def test_a_request_of_inspire_is_that_of_the_published_client():
    assert read_request(0).hex() == "0008000000060103" + "0bb80069"
    assert sum(registers for _, registers in TAXEL_READS) == 1062
    assert max(registers for _, registers in TAXEL_READS) <= 125


@pytest.mark.parametrize("off", [0, 1, -1, 2], ids=str)
def test_answers_with_a_number_that_is_off_are_the_patches_that_they_are(off):
    rows = rows_of("inspire", 4)
    _, frames = bytes_of("inspire", rows)
    shifted = b"".join(with_numbers(frame, off) for frame in frames)
    assert values_of(decoder_of("inspire"), shifted).tolist() == rows[1:].tolist()


def test_answers_with_the_number_of_the_request_before_are_read_too():
    rows = rows_of("inspire", 4)
    _, frames = bytes_of("inspire", rows)
    late = b"".join(with_numbers(frame, late=1) for frame in frames)
    assert values_of(decoder_of("inspire"), late).tolist() == rows[1:].tolist()


def test_an_answer_that_comes_twice_or_is_missing_costs_its_reading():
    rows = rows_of("inspire", 6)
    _, frames = bytes_of("inspire", rows)
    size = 9 + 2 * 105
    twice = frames[2][:size] * 2 + frames[2][size:]
    missing = frames[4][size:]
    decoder = decoder_of("inspire")
    found = values_of(decoder, b"".join([*frames[:2], twice, frames[3], missing, frames[5]]))
    assert found.tolist() == rows[[1, 3, 5]].tolist() or found.tolist() == rows[[1, 2, 3, 5]].tolist()
    assert decoder.counts.total() >= 1


def test_little_endian_values_and_refusals_are_said():
    _, frames = bytes_of("inspire", np.full((2, 1062), 200.0))
    swapped = b"".join(frames).replace(b"\x00\xc8", b"\xc8\x00")
    decoder = decoder_of("inspire")
    assert values_of(decoder, swapped).size == 0
    assert "51200, expected 0 to 4095" in decoder.device_message
    refused = decoder_of("inspire")
    refused.feed(bytes.fromhex("000800000003018302"))
    assert "Modbus error 2" in refused.device_message
    assert refused.counts == {Loss.UNREADABLE: 1}
    broken = decoder_of("inspire")
    broken.feed(b"HTTP/1.0 400 Bad Request\r\n")
    assert "no Modbus TCP" in broken.device_message


def test_inspire_is_asked_for_one_patch_after_the_other_and_again_after_silence():
    handshake = InspireHandshake()
    _, frames = bytes_of("inspire", rows_of("inspire", 1))
    assert handshake.opening() == read_request(0)
    assert handshake.on_silence() == read_request(0)
    asked, at = [], 0
    for _, registers in TAXEL_READS:
        size = 9 + 2 * registers
        assert handshake.on_data(frames[0][at : at + 20]) == b""
        asked.append(handshake.on_data(frames[0][at + 20 : at + size]))
        at += size
    assert asked == [read_request(index) for index in (*range(1, 11), 0)]


# ------------------------------------------------------------------ PaXini


def paxini_frame(payload, error=0):
    frame = b"\xaa\x56\x00" + struct.pack("<HB", len(payload) + 1, error) + payload
    return frame + bytes((lrc(frame),))


PAXINI = load_family("paxini").vectors[0]
REGISTERS = PAXINI.data[: -len(PAXINI.repeat)]


def test_paxini_gives_three_values_for_each_taxel_where_the_scene_has_them():
    decoder = make_decoder("paxini", 6, SKIN)
    assert values_of(decoder, PAXINI.data)[0] == pytest.approx([0, 0, 0.4, -0.3, 0.5, 3.0])
    assert decoder.units[Stream.SKIN] == "Fx Fy Fz of each taxel, module by module, in N"
    assert decoder.skin_unit == "N"


@pytest.mark.parametrize(
    ("payload", "error", "loss", "words"),
    [
        (bytes.fromhex("0000000028000000 00000000"), 0, Loss.DEAD_BLOCK, ""),
        (bytes.fromhex("0000D8FF0000000000000000"), 0, Loss.DEAD_BLOCK, ""),
        (bytes.fromhex("000000000900000000000000"), 0, None, ""),
        (bytes.fromhex("000000000900000000000000"), 4, Loss.INVALID, "error 04"),
        (bytes(15), 0, Loss.BAD_WIDTH, "15 bytes arrive where its modules need 12"),
    ],
    ids=["dead block", "dead block, sum across", "small sum", "error", "other modules"],
)
def test_frames_of_paxini_that_are_no_reading_are_counted_by_their_reason(payload, error, loss, words):
    decoder = make_decoder("paxini", 2, SKIN)
    found = values_of(decoder, REGISTERS + PAXINI.repeat + paxini_frame(payload, error))
    assert len(found) == (2 if loss is None else 1)
    assert decoder.counts == ({} if loss is None else {loss: 1})
    assert words in decoder.device_message


def test_paxini_without_registers_or_with_sums_alone_says_what_to_do():
    joined = make_decoder("paxini", 2, SKIN)
    assert values_of(joined, PAXINI.repeat * 3).size == 0
    assert "before the board's registers" in joined.device_message
    sums = make_decoder("paxini", 2, SKIN)
    content = bytes.fromhex("AA5500031600010001")
    sums.feed(REGISTERS + content + bytes((lrc(content),)) + paxini_frame(bytes(6)))
    assert "send taxels" in sums.device_message


def test_paxini_is_stopped_read_and_started_and_again_after_silence():
    handshake = PaxiniHandshake()
    stop, start = (request(0x10, 0x17, 1, bytes((on,))) for on in (0, 1))
    assert handshake.opening() == stop == handshake.closing_bytes
    assert handshake.on_silence() == request(3, *REGISTERS_READ[0])
    answers = [REGISTERS[:13], REGISTERS[13:23], REGISTERS[23:]]
    said = [handshake.on_data(answer) for answer in answers]
    assert said == [request(3, *REGISTERS_READ[1]), request(3, *REGISTERS_READ[2]), start]
    assert handshake.on_data(PAXINI.repeat) == b""
    assert handshake.on_silence() == stop
    assert handshake.on_silence() == request(3, *REGISTERS_READ[0])


# ------------------------------------------------------------------ PaXini, one module


def module_answer(data, status=1, address=0x03F0):
    head = struct.pack("<2sHBBBIH", b"\xaa\x55", 10 + len(data), 1, 0, 0xFB, address, len(data))
    frame = head + bytes((status,)) + data
    return frame + bytes((lrc(frame),))


@pytest.mark.parametrize("status", [0, 1])
def test_both_good_statuses_of_a_module_are_readings(status):
    """The package tacstack refuses status 1, which boards send with each good read."""
    decoder = make_decoder("paxini-module", 2, SKIN)
    data = bytes((0, 0, 34)) + bytes(27) + bytes.fromhex("000004FD051E")
    assert values_of(decoder, module_answer(data, status))[0] == pytest.approx([0.4, 3.0])


@pytest.mark.parametrize(
    ("answer", "loss", "words"),
    [
        (module_answer(bytes((0, 0, 40)) + bytes(33)), Loss.DEAD_BLOCK, ""),
        (module_answer(bytes(36), 7), Loss.INVALID, "no data (status 07)"),
        (module_answer(bytes(30)), Loss.BAD_WIDTH, ""),
    ],
    ids=["dead block", "status", "no taxels"],
)
def test_answers_of_a_module_that_are_no_reading_are_counted(answer, loss, words):
    decoder = make_decoder("paxini-module", 2, SKIN)
    assert values_of(decoder, answer + answer).size == 0
    assert decoder.counts == {loss: 1}, "a first frame may be the end of one"
    assert words in decoder.device_message


def test_modules_are_tried_in_turn_until_one_answers_and_a_missing_number_of_taxels_is_refused():
    handshake = ModuleHandshake(2)
    assert handshake.opening() == module_request(1, 2)
    assert [handshake.on_silence()[4] for _ in range(4)] == [3, 0, 2, 4]
    assert handshake.on_data(module_answer(bytes(36)))[4] == 4
    assert [handshake.on_silence()[4] for _ in range(2)] == [4, 4]
    with pytest.raises(InputError, match="taxels is missing; expected the number of taxels of the module"):
        parse_device("paxini-module:COM3")
    assert parse_device("paxini-module:COM3@115200?taxels=52").baud == 115200


def test_the_request_of_a_module_is_that_of_the_published_program():
    """The maker's program asks for 03 bytes at 03F0 and so on; the package builds the same head and check byte."""
    assert module_request(1, 2).hex() == "55aa0900" + "0100fb" + "f0030000" + "2400" + "e5"


# ------------------------------------------------------------------ taxels of three axes

VECTOR_SCENE = """name = "tip"
link = "tip"
[skin]
channels = 4
axes = 3
unit = "N"
"""


def test_the_emulated_xela_server_sends_calibrated_forces_to_a_scene_in_newtons(tmp_path):
    (tmp_path / "scene.toml").write_text(VECTOR_SCENE)
    scene, encoder = load_scene(tmp_path / "scene.toml"), MAKERS["xela"].encoder()
    encoder.skin_axes, encoder.skin_unit = 3, "N"
    frame = [0.1, -0.2, 3.0, 0.0, 0.0, 0.4, -1.2, 2.5, 7.1, 0.3, 0.0, 0.0]
    decoder = make_decoder("xela", scene.skin.frame_width, SKIN)
    found = values_of(decoder, b"".join(pack(1, encoder.record(Stream.SKIN, 1000 * at, frame)) for at in range(5)))
    assert found[-1] == pytest.approx(frame)


@pytest.mark.parametrize("name", ["paxini", "paxini-module", "anyskin", "justfloat", "papillarray", "xela"])
def test_a_scene_of_three_axes_reads_the_vectors_of_each_device_that_has_them(tmp_path, name):
    (tmp_path / "scene.toml").write_text(VECTOR_SCENE)
    scene = load_scene(tmp_path / "scene.toml")
    vectors = np.array([[0.1, -0.2, 3.0], [0.0, 0.0, 0.4], [-1.2, 2.5, 7.1], [0.3, 0.0, 0.0]])
    frame = (100 * vectors + 300 if name == "xela" else vectors).ravel().tolist()
    encoder = MAKERS[name].encoder()
    encoder.skin_axes = 3
    records = [encoder.record(Stream.SKIN, 1000 * at, frame) for at in range(5)]
    if name == "xela":
        records = [pack(1, record) for record in records]
    first = b""
    if name == "paxini":
        first = PAXINI.data[: -len(PAXINI.repeat)][:-65]
        taxels = struct.pack("<2sBBHH", b"\xaa\x55", 0, 3, 0x30, 56) + bytes(12) + b"\x04\x00" + bytes(42)
        first += taxels + bytes((lrc(taxels),))
    decoder = make_decoder(name, scene.skin.frame_width, SKIN)
    found = values_of(decoder, first + b"".join(records))
    assert found[-1] == pytest.approx(np.trunc(frame) if name == "xela" else frame, abs=1e-6)
    on_taxel = scene.skin.axes.sort_values(found[-1])
    assert (on_taxel[:, 2] <= 0).all(), "a push has a negative z"
    assert MAKERS[name].has_vectors
    assert MAKERS[name].skin_factor(scene, 20.0) == 1.0


def test_a_device_of_one_value_a_taxel_is_not_emulated_for_a_scene_of_three_axes(tmp_path):
    (tmp_path / "scene.toml").write_text(VECTOR_SCENE)
    with pytest.raises(InputError, match="axes = 3, and a taxel of the device of --as one value"):
        MAKERS["tsf85"].skin_factor(load_scene(tmp_path / "scene.toml"), 20.0)
