"""YARP ports: the captured exchange replayed, measurements, states, lies; and the handshake's bytes."""

import struct

import numpy as np
import pytest

from skincal.devices.family import HandshakeError
from skincal.devices.yarp import MESSAGE_MAX_BYTES, MessageSplitter, YarpHandshake, YarpPortDecoder, read_names
from skincal.model.readings import Loss, Stream
from tests.skincal.streams import maker_records as records
from tests.skincal.streams.maker_records import yarp_doubles, yarp_list, yarp_measures, yarp_message

NUMBER = records.YARP_NUMBER
MIXED = records.YARP_HEAD + bytes.fromhex(
    "0201ffffffffffffffff080000004000000000000000 000000007e440001 0001000006000000"
    "0a000000000000000000e03f 01000000feffffff 0100000003000000 0100000004000000 0a0000000000000000001540 0100000006000000"
)
"""Sent by a port of YARP 3.12.3: integers among the doubles, no envelope."""
HELLO = bytes.fromhex("5941641e0000525008000000736b696e63616c00")
BECOME_READER = bytes.fromhex("59410a00000052500101ffffffffffffffff0800000000000000000000007e720001")


def fed(data, carries=(Stream.WRENCH,), channels=None):
    decoder = YarpPortDecoder(channels, carries)
    return decoder.feed(NUMBER + data), decoder


def test_the_words_of_a_reader_are_those_that_real_ports_took():
    talk = YarpHandshake()
    assert talk.opening() == HELLO
    assert talk.on_data(NUMBER[:5]) == b""
    assert not talk.is_ready
    assert talk.on_data(NUMBER[5:]) == BECOME_READER
    assert talk.is_ready
    assert talk.on_data(records.YARP_VECTOR) == b""  # never an acknowledgement


def test_names_as_a_real_server_writes_them():
    answer = b"registration name /icub/right_arm/analog:o ip 127.0.0.1 port 10502 type tcp\r\n*** end of message\r\n"
    assert read_names(answer) == {"/icub/right_arm/analog:o": ("127.0.0.1", 10502)}
    assert read_names(b"*** end of message\r\n") == {}
    assert read_names(b"registration name /x ip 1.2.3.4 port 99999999 type tcp\r\n") == {}


def test_captured_vector_with_an_envelope():
    (batch,), decoder = fed(records.YARP_VECTOR)
    assert batch.values.tolist() == [list(records.VECTORS["yarp-port"].values[0])]
    assert batch.seq.tolist() == [236]
    assert batch.device_s.tolist() == [1795353452.30061]
    assert decoder.device_message == ""


def test_captured_bottle_with_integers_among_the_doubles():
    (batch,), _ = fed(MIXED)
    assert batch.values.tolist() == [[0.5, -2, 3, 4, 5.25, 6]]
    assert batch.seq.tolist() == [-1]
    assert np.isnan(batch.device_s).all()


@pytest.mark.parametrize("groups", [10, 12])
def test_measures_give_wrench_and_skin_by_their_places(groups):
    payload = yarp_measures(groups, records.WRENCH, [[1, 2], [3]])
    batches, _ = fed(yarp_message(payload, 5, 100.5), (Stream.WRENCH, Stream.SKIN), 3)
    wrench, skin = batches
    assert wrench.values.tolist() == [list(records.WRENCH)]
    assert skin.values.tolist() == [[1, 2, 3]]
    assert wrench.device_s.tolist() == [100.5]
    (batch,), _ = fed(yarp_message(payload))
    assert batch.device_s.tolist() == [1795354062.0748205]  # without an envelope the measurement's own


def test_measures_without_a_sensor_say_so():
    batches, decoder = fed(yarp_message(yarp_measures(12), 1, 1.0))
    assert batches == []
    assert decoder.counts == {Loss.BAD_WIDTH: 1}
    assert "none of what is wanted" in decoder.device_message


@pytest.mark.parametrize("count", [22, 24])
def test_joints_of_a_state_and_of_an_extended_one(count):
    ok = struct.pack("<i4s", 9, b"ok\x00\x00")
    angles = yarp_doubles([10.0, -20.0])
    pairs = yarp_list([angles, *([ok, yarp_doubles([0.0, 0.0])] * 11), ok][:count])
    for payload in (yarp_doubles([10.0, -20.0]), pairs):
        (batch,), _ = fed(yarp_message(payload, 1, 1.0), (Stream.JOINTS,))
        assert np.degrees(batch.values).tolist() == [pytest.approx([10, -20])]


def test_a_vector_fixes_the_width_of_one_stream_alone():
    """A listener that takes every stream: the first vector is a skin's, one of another width can still be the joints'."""
    messages = yarp_message(yarp_doubles([1.0] * 16), 1, 1.0) + yarp_message(yarp_doubles([10.0, 20.0]), 2, 1.1)
    batches, decoder = fed(messages, (Stream.SKIN, Stream.JOINTS))
    assert [batch.stream for batch in batches] == [Stream.SKIN, Stream.JOINTS]
    assert Loss.BAD_WIDTH not in decoder.counts


def test_gaps_of_the_envelope_are_counted_also_where_the_step_is_not_one():
    for step in (1, 3):
        numbers = [step * i for i in (0, 1, 2, 3, 6, 7)]
        _, decoder = fed(b"".join(yarp_message(yarp_doubles(range(6)), n, n * 0.01) for n in numbers))
        assert decoder.counts == {Loss.MISSING: 2}


def header(blocks, *lengths):
    return records.YARP_HEAD + bytes(blocks) + b"\xff" * 8 + struct.pack(f"<{len(lengths)}i", *lengths)


LIES = {
    "2 GB": header((1, 1), 2**31 - 1, 0),
    "just too much": header((1, 1), MESSAGE_MAX_BYTES + 1, 0),
    "sum": header((255, 1), *[2**31 - 1] * 255, 0),
    "negative": header((1, 1), -1, 0),
    "no message": b"HTTP/1.1 400 Bad Request\r\n",
    "another int": b"YA\x00\x00\x00\x00RP" * 9,
}


@pytest.mark.parametrize("name", LIES)
def test_a_lie_about_a_length_is_one_sentence_and_keeps_nothing(name):
    decoder = YarpPortDecoder(None, (Stream.WRENCH,))
    data = NUMBER + records.YARP_VECTOR + LIES[name]
    readings = sum(len(batch.seq) for at in range(len(data)) for batch in decoder.feed(data[at : at + 1]))
    assert readings == 1
    for _ in range(100):
        assert decoder.feed(bytes(10_000)) == []
    assert decoder.counts == {Loss.UNREADABLE: 1}
    assert decoder.device_message.startswith(("It announces", "What"))
    messages = MessageSplitter()
    messages.split(data + bytes(100_000))
    assert len(messages._rest) == 0
    talk = YarpHandshake()
    with pytest.raises(HandshakeError):
        talk.on_data(data)


BAD_PAYLOADS = {
    "count beyond": struct.pack("<ii", 266, 2**31 - 1),
    "negative count": struct.pack("<ii", 256, -5),
    "string beyond": struct.pack("<iiii", 256, 1, 4, 2**30),
    "unknown kind": struct.pack("<iii", 256, 1, 77),
    "too deep": struct.pack("<ii", 256, 1) * 3000,
    "no list": struct.pack("<ii", 1, 5),
    "words": struct.pack("<iiii4s", 256, 1, 4, 4, b"calm"),
    "empty": b"",
}


@pytest.mark.parametrize("name", BAD_PAYLOADS)
def test_a_bottle_that_cannot_be_right_costs_itself_alone(name):
    batches, decoder = fed(yarp_message(BAD_PAYLOADS[name], 1, 1.0) + records.YARP_VECTOR)
    assert sum(len(batch.seq) for batch in batches) == 1
    assert decoder.counts.total() == 1
    assert decoder.device_message


def test_an_envelope_that_cannot_be_right_costs_its_message_alone():
    good = yarp_message(yarp_doubles(range(6)), 1, 1.0)
    for wrong in (
        good.replace(b"D 1 1\x00", b"D x 1\x00"),
        good.replace(b"D 1 1\x00", b"D 1 i\x00"),
        good.replace(b"D 1 1\x00", b"D 1 n\x00"),
    ):
        assert wrong != good
        batches, decoder = fed(wrong + good)
        assert sum(len(batch.seq) for batch in batches) == 1
        assert decoder.counts == {Loss.UNREADABLE: 1}
