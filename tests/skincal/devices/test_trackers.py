"""Optical trackers: poses by hand from the makers' descriptions, lost and chosen bodies, damaged and restarted streams."""

from __future__ import annotations

import re
import socket
import struct
import time
from contextlib import closing, contextmanager, suppress

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.devices import natnet, qtm
from skincal.devices.decoding import pack
from skincal.devices.family import HandshakeError
from skincal.devices.link import LinkError
from skincal.devices.natnet import NatNetDecoder, NatNetHandshake, ServerInfo, read_frame
from skincal.devices.ndi import NdiDecoder, NdiHandshake, crc16, with_crc
from skincal.devices.qtm import QtmDecoder, QtmHandshake
from skincal.devices.tracked_bodies import write_options
from skincal.model.readings import Chunk, Loss, Stream
from skincal.simulation.emulated_devices import MAKERS
from skincal.simulation.emulated_transports import MakerOutlets, NatNetOutlet
from skincal.streams import tracker_search
from skincal.streams.decoders.auto_detect import make_decoder
from skincal.streams.links import open_link
from tests.skincal.meanwhile import meanwhile
from tests.skincal.streams.link_support import reading, spec

TOOL = (Stream.TOOL,)
PLACE_M = (0.1, -0.2, 0.3)
TURN = Rotation.from_euler("xyz", [10.0, 20.0, 30.0], degrees=True)
"""R = Rz(30) Ry(20) Rx(10): the truth of all vectors."""


def poses_of(decoder, data, size=0):
    """Poses (n, 3, 4) and times of bytes; with a size they come in pieces."""
    pieces = [data[at : at + size] for at in range(0, len(data), size)] if size else [data]
    batches = [batch for piece in pieces for batch in decoder.feed(piece)]
    assert all(batch.stream is Stream.TOOL for batch in batches)
    rows = [row.reshape(3, 4) for batch in batches for row in batch.values]
    return np.array(rows).reshape(-1, 3, 4), [stamp for batch in batches for stamp in batch.device_s.tolist()]


def assert_true(pose, atol=1e-6):
    np.testing.assert_allclose(pose[:, 3], PLACE_M, atol=atol)
    np.testing.assert_allclose(pose[:, :3], TURN.as_matrix(), atol=atol)


# ------------------------------------------------------------------ Qualisys

HERE = (100.0, -200.0, 300.0, *TURN.as_matrix().T.reshape(-1))
"""mm, and the columns of the matrix."""
LOST = (float("nan"),) * 12


def qtm_frame(number, *bodies, time_us=2_500_000, extra=b""):
    listed = struct.pack("<Ihh", len(bodies), 0, 0) + b"".join(struct.pack("<12f", *body) for body in bodies)
    component = struct.pack("<II", 8 + len(listed), 5) + listed
    content = struct.pack("<qII", time_us, number, 1 + bool(extra)) + extra + component
    return struct.pack("<II", 8 + len(content), 3) + content


def qtm_names(*names):
    text = "".join(f"<Body><Name>{name}</Name><Point><Name>corner</Name><X>1</X></Point></Body>" for name in names)
    return qtm.packet(2, f"<QTM><The_6D><Bodies>{len(names)}</Bodies>{text}</The_6D></QTM>\0".encode())


def qtm_start(body, *names):
    return qtm.packet(qtm.OPTIONS_KIND, write_options(body)) + qtm.command("QTM RT Interface connected") + qtm_names(*names)


def test_a_qtm_body_is_read_column_by_column_in_millimetres():
    decoder = QtmDecoder(None, TOOL)
    poses, times = poses_of(decoder, qtm_start("probe", "hat", "probe") + qtm_frame(1, LOST, HERE))
    assert_true(poses[0])
    assert times == [2.5]
    assert decoder.counts.total() == 0
    assert decoder.device_message == ""


@pytest.mark.parametrize("size", [1, 7, 64])
def test_qtm_packets_in_pieces_give_the_same_poses(size):
    data = qtm_start("probe", "probe") + b"".join(qtm_frame(number, HERE) for number in range(1, 4))
    poses, _ = poses_of(QtmDecoder(None, TOOL), data, size)
    assert len(poses) == 3


def test_other_components_of_a_qtm_frame_are_passed_over():
    markers = struct.pack("<IIIhh3f", 28, 1, 1, 0, 0, 1.0, 2.0, 3.0)
    poses, _ = poses_of(QtmDecoder(None, TOOL), qtm_start("", "probe") + qtm_frame(1, HERE, extra=markers))
    assert_true(poses[0])


def test_a_lost_qtm_body_is_counted_and_no_pose():
    decoder = QtmDecoder(None, TOOL)
    poses, _ = poses_of(decoder, qtm_start("probe", "hat", "probe") + qtm_frame(1, HERE, LOST) + qtm_frame(2, HERE, LOST))
    assert len(poses) == 0
    assert decoder.counts == {Loss.NO_POSE: 2}
    assert decoder.device_message == "QTM does not see the body probe"
    poses, _ = poses_of(decoder, qtm_frame(3, LOST, HERE))
    assert_true(poses[0])
    assert decoder.device_message == ""


@pytest.mark.parametrize(
    ("body", "names", "sentence"),
    [
        ("", ("hat", "probe"), "The tracker sends several bodies (hat, probe): choose one by ?body=hat"),
        ("tool", ("hat", "probe"), "The tracker has no body tool; it sends hat, probe: correct the address, such as ?body=hat"),
        (
            "",
            ("Rigid Body 1+", "hat"),
            "The tracker sends several bodies (Rigid Body 1+, hat): choose one by ?body=Rigid%20Body%201%2B",
        ),
        ("hat", ("hat", "hat"), "2 bodies are called hat: give each its own name in the tracker's program"),
        ("", (), "The tracker sends no body: define a rigid body in its program, and enable it"),
        ("hat", ("hat",), "QTM sends 2 bodies and names 1: enable all of them in its project"),
    ],
)
def test_a_body_that_is_not_known_is_no_pose_and_named(body, names, sentence):
    decoder = QtmDecoder(None, TOOL)
    poses, _ = poses_of(decoder, qtm_start(body, *names) + qtm_frame(1, *[HERE] * (len(names) if len(names) != 1 else 2)))
    assert len(poses) == 0
    assert decoder.counts == {Loss.NO_POSE: 1}
    assert decoder.device_message == sentence


def test_names_that_may_have_changed_are_asked_again_before_a_pose_counts():
    decoder, handshake = QtmDecoder(None, TOOL), QtmHandshake()
    asked = [handshake.on_data(part) for part in (qtm.command("QTM RT Interface connected"), qtm.command("Version set to 1.8"))]
    asked.append(handshake.on_data(qtm_names("hat", "probe")))
    assert asked == [qtm.command(text) for text in ("Version 1.8", "GetParameters 6D", "StreamFrames AllFrames 6D")]
    assert handshake.is_ready
    other_file = qtm.packet(6, b"\x08")
    assert handshake.on_data(other_file) == qtm.command("GetParameters 6D")
    elsewhere = (900.0, *HERE[1:])
    data = qtm_start("probe", "hat", "probe") + qtm_frame(1, elsewhere, HERE) + other_file + qtm_frame(2, HERE, elsewhere)
    poses, _ = poses_of(decoder, data + qtm_names("probe", "hat") + qtm_frame(3, HERE, elsewhere))
    assert len(poses) == 2, "the frame between the event and the names may be of either order"
    assert_true(poses[1])
    assert decoder.counts == {Loss.UNREADABLE: 1}


def test_gaps_repeats_and_a_restart_of_qtm_are_counted():
    numbers = [1, 2, 3, 6, 6, 1, 2]
    decoder = QtmDecoder(None, TOOL)
    frames = [qtm_frame(number, HERE, time_us=10_000 * number) for number in numbers]
    poses, times = poses_of(decoder, qtm_start("probe", "probe") + b"".join(frames))
    assert len(poses) == 6
    assert times == [0.01, 0.02, 0.03, 0.06, 0.01, 0.02]
    assert decoder.counts == {Loss.MISSING: 2, Loss.REPEATED: 1}


def test_a_mirrored_qtm_matrix_and_a_damaged_packet_are_no_poses():
    decoder = QtmDecoder(None, TOOL)
    mirrored = (*HERE[:3], *(-value for value in HERE[3:6]), *HERE[6:])
    damaged = bytearray(qtm_frame(2, HERE))
    damaged[8 + 12] = 7  # more components than there are
    poses, _ = poses_of(decoder, qtm_start("probe", "probe") + qtm_frame(1, mirrored) + bytes(damaged))
    assert np.isnan(poses).all()
    assert decoder.counts == {Loss.NO_POSE: 1, Loss.UNREADABLE: 1}
    whole = qtm_frame(3, HERE)
    more = struct.pack("<I", len(whole) + 12) + whole[4:] + struct.pack("<II", 12, 9) + bytes(4)
    assert len(poses_of(decoder, more)[0]) == 0, "a component that its count leaves out"
    assert decoder.counts == {Loss.NO_POSE: 1, Loss.UNREADABLE: 2}
    decoder.feed(b"GET / HTTP/1.1\r\n")
    assert "is no QTM" in decoder.device_message


def test_a_refusal_of_qtm_is_quoted():
    with pytest.raises(HandshakeError, match=r"QTM answers: Connection refused\. Max number of clients reached\."):
        QtmHandshake().on_data(qtm.packet(0, b"Connection refused. Max number of clients reached.\0"))


def test_the_maker_s_export_has_the_columns_of_the_matrix_too():
    """A line of a public TSV export: roll, pitch and yaw in degrees, and the nine numbers beside them."""
    exported = [1.0, 0.00099, -0.00165, -0.00101, 0.99993, -0.01145, 0.00164, 0.01145, 0.99993]
    turn = Rotation.from_euler("xyz", [-0.65630, 0.09391, 0.05772], degrees=True).as_matrix()
    np.testing.assert_allclose(np.reshape(exported, (3, 3)).T, turn, atol=3e-5)
    assert np.abs(np.reshape(exported, (3, 3)) - turn).max() > 0.02


# ------------------------------------------------------------------ OptiTrack

QUATERNION = tuple(TURN.as_quat().tolist())
VERSIONS = [(3, 0), (3, 1), (4, 0), (4, 1), (4, 3)]


def natnet_body(number, pose=(*PLACE_M, *QUATERNION), *, tracked=True):
    return struct.pack("<i", number) + struct.pack("<8f", *pose, 0.0004) + struct.pack("<h", int(tracked))


def natnet_frame(number, version, *bodies, ticks=25_000_000):
    """A frame with everything that may stand around the bodies."""

    def section(*parts):
        size = struct.pack("<i", sum(map(len, parts))) if version >= (4, 1) else b""
        return struct.pack("<i", len(parts)) + size + b"".join(parts)

    vector = struct.pack("<3f", 9.0, 9.0, 9.0)
    data = (
        struct.pack("<i", number) + section(b"all\0" + struct.pack("<i", 2) + 2 * vector) + section(vector) + section(*bodies)
    )
    data += section(struct.pack("<2i", 1, 2) + natnet_body(1) + natnet_body(2))
    if version >= (4, 1):
        data += section(struct.pack("<2i", 5, 1) + natnet_body(1) + struct.pack("<i", 1) + bytes(26))
    data += section(bytes(26), bytes(26)) + section(struct.pack("<3if", 1, 1, 1, 3.5)) + section(struct.pack("<4i", 1, 2, 0, 0))
    data += struct.pack("<2id3Q", 0, 0, 1.5, ticks, ticks + 1, ticks + 2) + (bytes(8) if version >= (4, 0) else b"") + bytes(6)
    return pack(1, natnet.message(7, data))


def natnet_server(version, ticks_per_s=10_000_000):
    content = b"Motive".ljust(256, b"\0") + bytes((3, 1, 0, 0, *version, 0, 0))
    return pack(1, natnet.message(1, content + struct.pack("<QHB4s", ticks_per_s, 1511, 1, bytes((239, 255, 42, 99)))))


def natnet_names(version, **numbers):
    def dataset(kind, content):
        return struct.pack("<i", kind) + (struct.pack("<i", len(content)) if version >= (4, 1) else b"") + content

    found = [dataset(0, b"all\0" + struct.pack("<i", 2) + b"a\0b\0")]
    for name, number in numbers.items():
        marker = struct.pack("<i3fi", 1, 0.0, 0.0, 0.0, 0) + (b"marker\0" if version >= (4, 0) else b"")
        turn = struct.pack("<4f", 0.0, 0.0, 0.0, 1.0) if version >= (4, 2) else b""
        found.append(dataset(1, name.encode() + b"\0" + struct.pack("<2i3f", number, -1, 0.0, 0.0, 0.0) + turn + marker))
    found.append(dataset(5, b"camera\0" + bytes(28)))
    return pack(1, natnet.message(5, struct.pack("<i", len(found)) + b"".join(found)))


def natnet_start(body, version=(3, 0), **numbers):
    return pack(0, write_options(body)) + natnet_server(version) + natnet_names(version, **numbers)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("body", ["probe", "7"])
def test_a_natnet_body_is_read_by_name_and_number(version, body):
    decoder = NatNetDecoder(None, TOOL)
    frame = natnet_frame(1, version, natnet_body(3, (1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0)), natnet_body(7))
    poses, times = poses_of(decoder, natnet_start(body, version, hat=3, probe=7) + frame)
    assert_true(poses[0])
    assert times == [2.5], "ticks of the middle of the exposure, by the server's clock"
    assert decoder.counts.total() == 0
    assert decoder.device_message == ""


def test_the_only_natnet_body_needs_no_name():
    poses, _ = poses_of(
        NatNetDecoder(None, TOOL), pack(0, write_options("")) + natnet_server((3, 0)) + natnet_frame(1, (3, 0), natnet_body(7))
    )
    assert_true(poses[0])


def test_a_lost_natnet_body_has_a_pose_that_is_not_used():
    decoder = NatNetDecoder(None, TOOL)
    lost, seen = natnet_body(7, (5.0, 5.0, 5.0, 0.0, 0.0, 0.0, 1.0), tracked=False), natnet_body(7)
    poses, _ = poses_of(decoder, natnet_start("probe", probe=7) + natnet_frame(1, (3, 0), lost))
    assert len(poses) == 0
    assert decoder.counts == {Loss.NO_POSE: 1}
    assert decoder.device_message == "Motive does not see the rigid body probe"
    assert_true(poses_of(decoder, natnet_frame(2, (3, 0), seen))[0][0])


@pytest.mark.parametrize("version", VERSIONS)
def test_a_natnet_frame_that_is_cut_or_of_another_version_is_no_pose(version):
    content = natnet_frame(1, version, natnet_body(3), natnet_body(7))[9:]
    assert read_frame(content, version) is not None
    assert all(read_frame(content[:end], version) is None for end in range(len(content) - 13))
    misread = [other for other in VERSIONS if (other >= (4, 1)) != (version >= (4, 1)) and read_frame(content, other)]
    assert misread == []
    decoder = NatNetDecoder(None, TOOL)
    whole = natnet_frame(1, version, natnet_body(7))
    cut = pack(1, whole[5:-40])
    poses, _ = poses_of(decoder, natnet_start("probe", version, probe=7) + cut)
    assert len(poses) == 0
    assert decoder.counts == {Loss.UNREADABLE: 1}


def test_gaps_repeats_and_a_new_server_of_natnet():
    decoder = NatNetDecoder(None, TOOL)
    data = natnet_start("probe", probe=7) + b"".join(
        natnet_frame(number, (3, 0), natnet_body(7)) for number in (1, 2, 3, 6, 6, 1)
    )
    assert len(poses_of(decoder, data)[0]) == 5
    assert decoder.counts == {Loss.MISSING: 2, Loss.REPEATED: 1}
    other = natnet_server((4, 1)) + natnet_frame(2, (4, 1), natnet_body(7))
    assert len(poses_of(decoder, other)[0]) == 0, "the names of the other server are not known yet"
    assert decoder.device_message == "Motive has not named its rigid bodies yet"
    assert decoder.counts.total() == 3, "frames before the names are not lost"
    newer = natnet_names((4, 1), probe=8) + natnet_frame(3, (4, 1), natnet_body(7), natnet_body(8))
    assert_true(poses_of(decoder, newer)[0][0])


def test_natnet_2_is_refused_with_a_sentence():
    decoder = NatNetDecoder(None, TOOL)
    poses, _ = poses_of(decoder, pack(0, write_options("")) + natnet_server((2, 9)) + natnet_frame(1, (3, 0), natnet_body(7)))
    assert len(poses) == 0
    assert decoder.device_message == "The server speaks NatNet 2.9; versions 3 and 4 are read: use Motive 2 or 3"


def test_the_handshake_asks_for_names_and_connects_again():
    handshake = NatNetHandshake()
    assert handshake.opening() == natnet.message(0)
    assert handshake.on_data(natnet_server((4, 1))) == natnet.message(4)
    assert handshake.is_ready
    frame = natnet_frame(1, (4, 1), natnet_body(7))
    asked = [handshake.on_data(frame) for _ in range(600)]
    assert [each for each in asked if each] == [natnet.message(0)] * 3


def test_a_server_says_where_it_multicasts():
    found = ServerInfo.read(natnet_server((3, 1))[9:])
    assert found == ServerInfo((3, 1), 10_000_000, ("239.255.42.99", 1511))


@contextmanager
def sent_over(outlet, maker):
    """A tracker that sends the true pose of its tool every 5 ms."""
    encoder, pose = MAKERS[maker].encoder(), [*PLACE_M, *TURN.as_quat().tolist()]

    def send(over):
        count = 0
        while not over.wait(0.005):
            count += 1
            outlet.poll()
            outlet.write(encoder.record(Stream.TOOL, 5000 * count, pose))

    with closing(outlet), meanwhile(send):
        yield


def test_a_multicast_of_the_server_is_read_and_that_of_others_is_not():
    outlet, decoder = NatNetOutlet("239.255.42.99", 15117), NatNetDecoder(None, TOOL)
    with sent_over(outlet, "natnet"), closing(open_link(spec(outlet.address, TOOL))) as link:
        poses, end = np.zeros((0, 3, 4)), time.monotonic() + 5.0
        while not len(poses) and time.monotonic() < end:
            poses = poses_of(decoder, link.read(0.2))[0]
    assert_true(poses[0], atol=2e-4)


def test_a_host_without_motive_is_named():
    with pytest.raises(LinkError, match=r"natnet://127\.0\.0\.1:9: (nothing listens there|no answer within 1 s)"):
        open_link(spec("natnet://127.0.0.1:9", TOOL))


# ------------------------------------------------------------------ NDI

SEEN = "+09515+00381+01893+02393+010000-020000+030000+00012"
"""q0 qx qy qz, x y z and error, as the tracker writes the pose of all vectors."""


def ndi_answer(frame, *tools):
    listed = "".join(f"{handle}{pose}00000031{frame:08X}\n" for handle, pose in tools)
    return with_crc(f"{len(tools):02X}{listed}0000".encode())


def ndi_start(body):
    return with_crc(b"SKINCAL " + write_options(body)) + with_crc(b"OKAY") + with_crc(b"020100102001")


def test_the_check_sum_is_that_of_the_public_library():
    assert f"{crc16(b'TX:0001'):04X}" == "031A"
    assert f"{crc16(b'INIT:'):04X}" == "E3A5"


@pytest.mark.parametrize("size", [0, 1, 13])
def test_a_tool_of_ndi_is_read_by_its_handle(size):
    decoder = NdiDecoder(None, TOOL)
    data = ndi_start("0A") + ndi_answer(298, ("01", "MISSING"), ("0A", SEEN), ("0B", "DISABLED"), ("0C", "UNOCCUPIED"))
    poses, _ = poses_of(decoder, data, size)
    assert_true(poses[0], atol=1e-4)
    assert decoder.counts.total() == 0
    assert decoder.device_message == ""


def test_a_lost_tool_of_ndi_is_counted_though_its_frames_go_on():
    decoder = NdiDecoder(None, TOOL)
    lost = b"".join(ndi_answer(frame, ("01", "MISSING")) for frame in (1, 2, 3))
    poses, _ = poses_of(decoder, ndi_start("01") + ndi_answer(0, ("01", SEEN)) + lost)
    assert len(poses) == 1
    assert decoder.counts == {Loss.NO_POSE: 3}
    assert decoder.device_message == "The tracker does not see the tool 01"


def test_one_frame_of_ndi_that_is_read_twice_is_one_pose():
    decoder = NdiDecoder(None, TOOL)
    poses, _ = poses_of(
        decoder, ndi_start("") + 3 * ndi_answer(7, ("01", SEEN)) + ndi_answer(8, ("01", SEEN)) + ndi_answer(1, ("01", SEEN))
    )
    assert len(poses) == 3
    assert decoder.counts.total() == 0


def test_two_tools_of_ndi_without_a_choice_are_named():
    decoder = NdiDecoder(None, TOOL)
    poses, _ = poses_of(decoder, ndi_start("") + ndi_answer(1, ("01", SEEN), ("02", SEEN)))
    assert len(poses) == 0
    assert decoder.device_message == "The tracker sends several bodies (01, 02): choose one by ?body=01"


def test_a_damaged_answer_of_ndi_is_counted():
    whole = ndi_answer(1, ("01", SEEN))
    for at in range(len(whole) - 1):
        decoder = NdiDecoder(None, TOOL)
        damaged = whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :]
        poses, _ = poses_of(decoder, ndi_start("") + damaged + ndi_answer(2, ("01", SEEN)))
        assert len(poses) == 1, damaged
        assert decoder.counts == {Loss.BAD_CHECKSUM: 1}


def dialogue(handshake, answers):
    """Commands of a handshake without check sum, each answered by the first text whose pattern fits."""
    said, sent = [], handshake.opening()
    while sent and len(said) < 60:
        command = sent[:-5].decode()
        assert with_crc(command.encode()) == sent
        said.append(command)
        answer = next(text for pattern, text in answers.items() if re.match(pattern, command))
        sent = handshake.on_data(with_crc(answer.encode()))
    return said


def test_a_passive_tool_is_written_initialised_and_tracked_as_the_public_library_does():
    rom = bytes(range(256)) * 2 + b"abc"
    answers = {"TSTOP": "ERROR0C", "PHSR:01": "0109000", "PHRQ": "01", "PHSR:02": "0101001", "PHSR:03": "0101011", "": "OKAY"}
    said = dialogue(NdiHandshake(rom), answers)
    assert said[:5] == ["TSTOP:", "INIT:", "PHSR:01", "PHF:09", "PHRQ:*********1****"]
    written = said[5:21]
    assert [command[:11] for command in written] == [f"PVWR:01{64 * k:04X}" for k in range(16)]
    assert bytes.fromhex("".join(command[11:] for command in written)) == rom.ljust(1024, b"\0")
    assert said[21:] == ["PHSR:02", "PINIT:01", "PHSR:03", "PENA:01D", "TSTART:"]


def test_ndi_is_asked_for_the_next_pose_after_a_pause_and_never_twice_at_once():
    handshake = NdiHandshake()
    dialogue(handshake, {"PHSR:01": "00", "PHSR:02": "00", "PHSR:03": "0101011", "": "OKAY"})
    request = with_crc(b"TX:0001")
    assert handshake.on_silence() == request
    assert [handshake.on_silence() for _ in range(200)] == [b""] * 200
    assert handshake.on_data(ndi_answer(1, ("01", SEEN))) == b""
    assert handshake.on_silence() == request
    asked_again = [handshake.on_silence() for _ in range(300)]
    assert [each for each in asked_again if each] == [request], "an answer that was lost on the way"


def test_a_damaged_answer_to_a_command_repeats_the_command():
    handshake = NdiHandshake()
    handshake.opening()
    assert handshake.on_data(with_crc(b"OKAY")) == with_crc(b"INIT:")
    assert handshake.on_data(b"OKAX1234\r") == with_crc(b"INIT:")


@pytest.mark.parametrize(
    ("answers", "sentence"),
    [
        (
            {"PHSR": "00", "": "OKAY"},
            "the tracker has no tool: name the definition file of the tool by ?rom=FILE, or plug it in",
        ),
        (
            {"PHSR": "0101001", "PINIT": "ERROR13", "": "OKAY"},
            "the tracker answers ERROR13 to PINIT: the tool cannot be initialised",
        ),
    ],
)
def test_a_tracker_without_a_usable_tool_says_so(answers, sentence):
    with pytest.raises(HandshakeError, match=re.escape(sentence)):
        dialogue(NdiHandshake(), answers)


def test_a_tracker_that_is_not_ready_yet_is_asked_again_and_not_for_ever():
    handshake = NdiHandshake()
    dialogue(handshake, {"PHSR:01": "00", "PHSR:02": "00", "PHSR:03": "0101011", "": "OKAY"})
    refused = with_crc(b"ERROR0C")
    for _ in range(50):
        assert handshake.on_silence() == with_crc(b"TX:0001")
        assert handshake.on_data(refused) == b""
    handshake.on_silence()
    handshake.on_data(ndi_answer(1, ("01", SEEN)))
    for _ in range(99):
        handshake.on_silence()
        handshake.on_data(refused)
    handshake.on_silence()
    with pytest.raises(HandshakeError, match="the tracker answers ERROR0C to TX: not possible in its present mode"):
        handshake.on_data(refused)


def test_a_definition_file_that_is_none_is_refused(tmp_path):
    with pytest.raises(LinkError, match=r"missing\.rom cannot be read"):
        open_link(spec(f"ndi://127.0.0.1:9?rom={tmp_path}/missing.rom", TOOL))
    (tmp_path / "large.rom").write_bytes(bytes(4000))
    with pytest.raises(LinkError, match=r"has 4000 bytes; expected a tool definition of 1 to 2048 bytes"):
        open_link(spec(f"ndi://127.0.0.1:9?rom={tmp_path}/large.rom", TOOL))


# ------------------------------------------------------------------ search


@contextmanager
def answering(make_answer):
    """A program that answers each datagram on loopback; its port."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as program:
        program.bind(("127.0.0.1", 0))
        program.settimeout(0.05)

        def answer(over):
            while not over.is_set():
                with suppress(TimeoutError):
                    data, host = program.recvfrom(100)
                    to, reply = make_answer(data, host)
                    program.sendto(reply, to)

        with meanwhile(answer):
            yield program.getsockname()[1]


def test_trackers_that_answer_a_broadcast_are_listed_with_their_addresses(monkeypatch):
    monkeypatch.setattr(tracker_search, "BROADCAST_ADDRESS", "127.0.0.1")

    def as_qtm(data, host):
        assert data[:8] == struct.pack("<2I", 10, 7)
        text = b"lab, QTM 2024.3 (build 1), 8 cameras\0"
        return (host[0], int.from_bytes(data[8:], "big")), struct.pack("<2I", 10 + len(text), 1) + text + struct.pack(
            ">H", 22222
        )

    def as_natnet(data, host):
        assert data == natnet.message(0)
        return host, natnet_server((4, 1))[5:]

    with answering(as_qtm) as qtm_port, answering(as_natnet) as natnet_port:
        found = tracker_search.find_trackers(qtm_port, natnet_port, 0.5)
    assert found == [
        (f"natnet://127.0.0.1:{natnet_port}", "OptiTrack Motive, NatNet 4.1, by multicast to 239.255.42.99"),
        ("qtm://127.0.0.1", "Qualisys QTM: lab, QTM 2024.3 (build 1), 8 cameras"),
    ]
    with answering(lambda _, host: (host, b"\x01\x02")) as port:
        assert tracker_search.find_trackers(port, port, 0.2) == []


# ------------------------------------------------------------------ over loopback


@pytest.mark.parametrize("maker", ["qtm", "natnet", "ndi"])
def test_a_tracker_s_pose_comes_over_loopback(maker):
    outlet, decoder = MakerOutlets(64).open(maker, Stream.TOOL, tcp=True), make_decoder(maker, None, TOOL)
    with sent_over(outlet, maker), reading(outlet.address, TOOL) as items:
        poses = np.zeros((0, 3, 4))
        while not len(poses):
            item = items.get(timeout=5.0)
            poses = poses_of(decoder, item.data)[0] if isinstance(item, Chunk) else poses
    assert_true(poses[0], atol=2e-4)
