"""Optical trackers: poses by hand from the makers' descriptions, lost and chosen bodies, damaged and restarted streams."""

from __future__ import annotations

import struct
from contextlib import closing

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.devices import qtm
from skincal.devices.family import HandshakeError
from skincal.devices.qtm import QtmDecoder, QtmHandshake
from skincal.devices.tracked_bodies import write_options
from skincal.model.readings import Chunk, Loss, Stream
from skincal.simulation.emulated_devices import MAKERS
from skincal.simulation.emulated_transports import MakerOutlets
from skincal.streams.decoders.auto_detect import make_decoder
from tests.skincal.meanwhile import meanwhile
from tests.skincal.streams.link_support import reading

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
        ("tool", ("hat", "probe"), "The tracker has no body tool; it sends hat, probe: correct ?body= of the address"),
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


# ------------------------------------------------------------------ over loopback


@pytest.mark.parametrize("maker", ["qtm"])
def test_a_tracker_s_pose_comes_over_loopback(maker):
    outlet, encoder = MakerOutlets(64).open(maker, Stream.TOOL, tcp=True), MAKERS[maker].encoder()
    sent = [*PLACE_M, *TURN.as_quat().tolist()]

    def send(over):
        count = 0
        while not over.wait(0.005):
            count += 1
            outlet.poll()
            outlet.write(encoder.record(Stream.TOOL, 5000 * count, sent))

    decoder = make_decoder(maker, None, TOOL)
    with closing(outlet), meanwhile(send), reading(outlet.address, TOOL) as items:
        poses = np.zeros((0, 3, 4))
        while not len(poses):
            item = items.get(timeout=5.0)
            poses = poses_of(decoder, item.data)[0] if isinstance(item, Chunk) else poses
    assert_true(poses[0], atol=2e-4)
