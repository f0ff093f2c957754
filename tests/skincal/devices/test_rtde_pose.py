"""The pose of the flange by RTDE: the vector of public facts, and the tool centre point taken out."""

import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.devices.family import HandshakeError
from skincal.devices.rtde import RtdeDecoder, RtdeHandshake, packet, recipe
from skincal.model.readings import Stream

POSE = bytes.fromhex("3fb999999999999abfc999999999999a3fd33333333333333fb3d8b2fb7951973fd8a168798045413fdf2279c7bcd6ec")
"""x y z = (0.1, -0.2, 0.3) m, R = Rz(30) Ry(20) Rx(10) degrees, as the controller sends it."""


def data(pose, offset, time_s=12.5, wrench=()):
    return packet(ord("U"), b"\x01" + struct.pack("!d", time_s) + struct.pack(f"!{len(wrench)}d", *wrench) + pose + offset)


def decoded(frames, carries=(Stream.TOOL,)):
    decoder = RtdeDecoder(None, carries)
    batches = [batch for frame in frames for batch in decoder.feed(frame)]
    return decoder, {batch.stream: batch.values for batch in batches}


def test_a_pose_without_a_tool_centre_point_is_that_of_the_flange():
    _, found = decoded([data(POSE, bytes(48))])
    (row,) = found[Stream.TOOL]
    pose = np.asarray(row, dtype=float).reshape(-1)
    matrix = pose.reshape(4, 4) if pose.size == 16 else pose.reshape(3, 4)
    np.testing.assert_allclose(matrix[:3, 3], [0.1, -0.2, 0.3], atol=1e-12)
    np.testing.assert_allclose(matrix[:3, :3], Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix(), atol=1e-9)


def test_the_tool_centre_point_is_taken_out():
    flange = np.eye(4)
    flange[:3, :3], flange[:3, 3] = Rotation.from_rotvec([0.2, -2.9, 0.4]).as_matrix(), [0.3, 0.5, -0.2]
    offset = np.eye(4)
    offset[:3, :3], offset[:3, 3] = Rotation.from_rotvec([0.1, 0.0, 0.7]).as_matrix(), [0.01, -0.02, 0.15]
    sent = [np.concatenate([m[:3, 3], Rotation.from_matrix(m[:3, :3]).as_rotvec()]) for m in (flange @ offset, offset)]
    _, found = decoded([data(*(struct.pack("!6d", *each) for each in sent))])
    pose = np.asarray(found[Stream.TOOL][0], dtype=float).reshape(-1, 4)
    np.testing.assert_allclose(pose[:3], flange[:3], atol=1e-12)


def test_wrench_and_pose_come_by_one_link():
    wrench = (1.0, -2.0, 3.0, 0.1, 0.2, -0.3)
    _, found = decoded([data(POSE, bytes(48), wrench=wrench)], (Stream.WRENCH, Stream.TOOL))
    np.testing.assert_allclose(np.ravel(found[Stream.WRENCH]), wrench)
    assert len(found[Stream.TOOL]) == 1


def test_a_changed_tool_centre_point_is_said():
    other = struct.pack("!6d", 0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
    decoder, _ = decoded([data(POSE, bytes(48)), data(POSE, other)])
    assert "tool centre point was changed" in decoder.device_message


def test_both_fields_are_requested_and_an_old_controller_is_named():
    assert recipe((Stream.WRENCH, Stream.TOOL)) == ["timestamp", "ft_raw_wrench", "actual_TCP_pose", "tcp_offset"]
    handshake = RtdeHandshake((Stream.TOOL,))
    assert b"timestamp,actual_TCP_pose,tcp_offset" in handshake.on_data(packet(ord("V"), b"\x01"))
    with pytest.raises(HandshakeError, match=r"no tcp_offset; it needs newer software$"):
        handshake.on_data(packet(ord("O"), b"\x01DOUBLE,VECTOR6D,NOT_FOUND"))
