"""The journal gives back its input; replay and resume give the same session to the last bit."""

import json
import os
import shutil
import time

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2._dynamic import generate_dynamic
from mcap_ros2.decoder import DecoderFactory

from skincal.journal import ros_messages, writer
from skincal.journal.documents import SegmentHeader
from skincal.journal.reader import SessionLog
from skincal.journal.writer import create_session
from skincal.model.actions import Exclude, TimedAction, Undo
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, LinkEvent, LinkState, Sample
from skincal.model.scene import load_scene, resource
from skincal.session.replay import replay, resume
from tests.approved import approved, approved_pattern
from tests.skincal.journal.journal_support import assert_same, new_session, record, segment
from tests.skincal.poke_script import LINKS, as_chunks, some_pokes, write_scene


@pytest.fixture
def scene(tmp_path):
    return write_scene(tmp_path / "source")


def decoded(folder, *topics):
    with segment(folder).open("rb") as file:
        messages = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(topics=list(topics))
        return [(channel.topic, message.log_time, content) for _, channel, message, content in messages]


def test_every_item_comes_back_as_it_was(scene, tmp_path):
    items = [
        LinkEvent("wrench", 5, LinkState.OPEN),
        Chunk("wrench", 7, b""),
        Chunk("skin", 8, bytes(range(256)) * 3),
        TimedAction(9, Exclude(12)),
        LinkEvent("skin", 10, LinkState.LOST, "unplugged: \u00e4 \U0001f50c"),
        LinkEvent("skin", 10, LinkState.OPEN, tried=(115200, 460800)),
        TimedAction(11, Undo()),
        Chunk("wrench", 2**62, b"\x00\xff\n"),
    ]
    journal = create_session(tmp_path / "s", scene, LINKS)
    for item in items:
        journal.write(item)
    journal.close()
    log = SessionLog(tmp_path / "s")
    begin, *back = log.items()
    assert isinstance(begin, SegmentHeader)
    assert begin.number == 1
    assert back == items
    assert (log.findings, log.links) == ((), LINKS)


def test_a_session_carries_its_scene(scene, tmp_path):
    create_session(tmp_path / "s", scene, LINKS).close()
    shutil.rmtree(scene.path.parent)
    log = SessionLog(shutil.move(tmp_path / "s", tmp_path / "elsewhere"))
    assert log.scene.skin.layout.channels.tolist() == list(range(24))
    assert log.findings == ()


def test_a_copied_scene_is_the_same_scene(tmp_path):
    """Its files may lie in other folders, a landmark may be named as the mesh, and a layout as the scene."""
    source = tmp_path / "source"
    shutil.copytree(resource("scenes/icub-forearm"), source)
    (source / "layouts").mkdir()
    (source / "modules.toml").rename(source / "layouts" / "scene.toml")
    text = (source / "scene.toml").read_text()
    text = text.replace('"forearm.obj"', '"../mesh.obj"').replace('"modules.toml"', '"layouts/scene.toml"')
    (source / "forearm.obj").rename(tmp_path / "mesh.obj")
    (source / "scene.toml").write_text(text.replace('"elbow, outer"', '"../mesh.obj"'))
    copy = load_scene(writer.copy_scene(load_scene(source / "scene.toml"), tmp_path / "copy"))
    assert copy.landmarks[0].name == "../mesh.obj"
    assert copy.surface.path == tmp_path / "copy" / "mesh.obj"
    assert len(copy.skin.layout.channels) == 84


def test_a_changed_scene_is_reported_and_actions_that_do_not_fit_are_left_out(scene, tmp_path):
    record(scene, tmp_path / "s", 2, [(0.9, Exclude(1))]).close()
    with (tmp_path / "s" / "scene" / "scene.toml").open("a") as file:
        file.write("[contacts]\nforce_min = 12.0\n")
    pipeline = replay(tmp_path / "s")
    assert approved("mesh.changed_after_recording") in pipeline.findings[0]
    assert pipeline.session.contacts == ()
    assert any("no longer fits" in sentence and "Poke 1" in sentence for sentence in pipeline.findings)


def test_resume_in_the_middle_of_a_poke_loses_that_poke_alone(scene, tmp_path):
    folder, script = tmp_path / "s", some_pokes(scene, 2)
    items = as_chunks(script.samples)
    pipeline = new_session(scene, folder)
    for item in items[: round(len(items) * 0.72)]:  # the second poke is held
        pipeline.feed(item)
    pipeline.close()
    again = resume(folder)
    assert [contact.poke for contact in again.session.contacts] == [1]
    assert again.snapshot().pokes[0].outcome.final
    for item in items:
        again.feed(item)
    again.close()
    assert len(again.session.contacts) == 3
    assert_same(again, replay(folder))


def test_a_new_session_does_not_write_into_an_old_one(scene, tmp_path):
    create_session(tmp_path / "s", scene, LINKS).close()
    with pytest.raises(InputError, match=approved_pattern("session.holds_one")):
        create_session(tmp_path / "s", scene, LINKS)


@pytest.mark.parametrize(
    ("files", "sentence"),
    [
        (None, "there is no such folder"),
        ({}, "no segment-0001.mcap in it"),
        ({"segment-0001.mcap": b"not an MCAP file at all"}, "there is no such file"),
        ({"segment-0002.mcap": b""}, r"segment-0001\.mcap is missing"),
    ],
)
def test_a_folder_that_is_no_session_is_refused(tmp_path, files, sentence):
    if files is not None:
        (tmp_path / "s").mkdir()
    for name, data in (files or {}).items():
        (tmp_path / "s" / name).write_bytes(data)
    with pytest.raises(InputError, match=sentence):
        SessionLog(tmp_path / "s")


def test_other_programs_read_the_decoded_readings(scene, tmp_path):
    record(scene, tmp_path / "s", 1).close()
    found = decoded(tmp_path / "s", "/wrench", "/taxels")
    wrenches, taxels = ([(at, content) for topic, at, content in found if topic == name] for name in ("/wrench", "/taxels"))
    frames = some_pokes(scene, 1).samples
    assert abs(len(wrenches) - 4 * len(frames)) <= 8
    assert abs(len(taxels) - len(frames)) <= 2
    log_ns, wrench = wrenches[0]
    assert wrench.wrench.force.z == pytest.approx(frames[0].wrench[2], abs=1e-6)
    assert wrench.header.stamp.sec * 1_000_000_000 + wrench.header.stamp.nanosec == log_ns
    np.testing.assert_allclose(taxels[0][1].values, frames[0].skin, atol=0.006)
    assert taxels[0][1].header.frame_id == "table"


def test_joint_states_and_raw_chunks_decode_too(scene, tmp_path):
    journal = create_session(tmp_path / "s", scene, LINKS)
    angles = np.array([0.1, -0.2, 0.3])
    journal.write_run([Sample(12.5, np.array([1.0, np.nan]), np.zeros(6), 1, saturated=False, angles=angles)])
    journal.write(Chunk("skin", 123, b"\x01\x02\x03"))
    journal.close()
    found = {topic: content for topic, _, content in decoded(tmp_path / "s", "/joints", "/taxels", "/raw/skin")}
    assert list(found["/joints"].position) == angles.tolist()
    assert list(found["/joints"].name) == ["joint0", "joint1", "joint2"]
    assert np.isnan(found["/taxels"].values[1])
    assert (found["/raw/skin"].host_ns, bytes(found["/raw/skin"].data)) == (123, b"\x01\x02\x03")


@pytest.mark.parametrize("frame", ["", "a", "ab", "abc", "abcd", "abcdefg"])
def test_alignment_holds_for_every_length_of_a_name(frame):
    def decode(name, message):
        return generate_dynamic(name, ros_messages.MESSAGE_SCHEMAS[name])[name](message)

    times = np.array([3, 1_500_000_000_000_000_007])
    rows = ros_messages.encode_wrenches(times, frame, np.arange(-6.0, 6.0).reshape(2, 6))
    message = decode("geometry_msgs/msg/WrenchStamped", rows[1].tobytes())
    assert message.header.frame_id == frame
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_500_000_000, 7)
    assert [message.wrench.force.x, message.wrench.torque.z] == [0.0, 5.0]
    message = decode("skincal_msgs/msg/Taxels", ros_messages.encode_taxels(3, frame, 9, np.array([1.5, 2.5])))
    assert (message.seq, list(message.values)) == (9, [1.5, 2.5])
    joints = ros_messages.encode_joints(3, frame, ("x", frame), np.array([1.0, 2.0]))
    message = decode("sensor_msgs/msg/JointState", joints)
    assert (list(message.name), list(message.position), list(message.effort)) == (["x", frame], [1.0, 2.0], [])


def test_metadata_describes_the_file(scene, tmp_path):
    create_session(tmp_path / "s", scene, LINKS).close()
    with segment(tmp_path / "s").open("rb") as file:
        (metadata,) = [metadata for metadata in make_reader(file).iter_metadata() if metadata.name == "skincal"]
    assert metadata.metadata["scene"] == scene.text
    assert [link["name"] for link in json.loads(metadata.metadata["links"])] == ["wrench", "skin"]
    assert abs(int(metadata.metadata["unix_ns"]) - time.time_ns()) < 600e9


def test_the_buffer_is_written_after_half_a_second(scene, tmp_path):
    journal = create_session(tmp_path / "s", scene, LINKS)
    path = segment(tmp_path / "s")
    size = path.stat().st_size
    journal.write(Chunk("skin", 1_000_000_000, os.urandom(5000)))
    journal.tick(1_400_000_000)
    assert path.stat().st_size == size
    journal.tick(1_600_000_000)
    assert path.stat().st_size > size + 5000
    assert list(SessionLog(tmp_path / "s").items())[1].host_ns == 1_000_000_000
    journal.close()
