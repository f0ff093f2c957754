"""What goes into the journal comes out of it; replay and resume give the same session to the last bit."""

import json
import os
import shutil
import time

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from skincal.journal import documents
from skincal.journal.documents import SegmentMark
from skincal.journal.reader import SessionLog
from skincal.journal.writer import JournalWriter, create_session
from skincal.model.actions import Exclude, MarkDead, Stamped, Undo
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, LinkEvent, LinkState, Sample
from skincal.session.pipeline import Pipeline
from skincal.session.replay import replay, resume
from tests.approved import approved, approved_pattern
from tests.skincal.poke_script import LINKS, as_chunks, outcome_key, same_estimates, some_pokes, write_scene


@pytest.fixture
def scene(tmp_path):
    return write_scene(tmp_path / "source")


def record(scene, folder, pokes=4, actions=(), seed=5):
    """A recorded session; `actions` are done at the shares of it that they name."""
    pipeline = Pipeline(scene, LINKS, None, create_session(folder, scene, LINKS))
    items = as_chunks(some_pokes(scene, pokes, seed).samples)
    due = {round(share * len(items)): action for share, action in actions}
    for k, item in enumerate(items):
        pipeline.feed(item)
        if k in due:
            pipeline.act(due[k], item.host_ns)
    return pipeline


def assert_same(first, second):
    a, b = first.snapshot(), second.snapshot()
    assert [outcome_key(record.outcome) for record in a.pokes] == [outcome_key(record.outcome) for record in b.pokes]
    assert [record.excluded for record in a.pokes] == [record.excluded for record in b.pokes]
    assert a.dead == b.dead
    assert a.can_undo == b.can_undo
    assert same_estimates(a, b)


def test_every_item_comes_back_as_it_was(scene, tmp_path):
    items = [
        LinkEvent("wrench", 5, LinkState.OPEN),
        Chunk("wrench", 7, b""),
        Chunk("skin", 8, bytes(range(256)) * 3),
        Stamped(9, Exclude(12)),
        LinkEvent("skin", 10, LinkState.LOST, "unplugged: \u00e4 \U0001f50c"),
        LinkEvent("skin", 10, LinkState.OPEN, tried=(115200, 460800)),
        Stamped(11, Undo()),
        Chunk("wrench", 2**62, b"\x00\xff\n"),
    ]
    journal = create_session(tmp_path / "s", scene, LINKS)
    for item in items:
        journal.write(item)
    journal.close()
    log = SessionLog(tmp_path / "s")
    begin, *back = log.items()
    assert isinstance(begin, SegmentMark)
    assert begin.number == 1
    assert back == items
    assert log.findings == ()
    assert log.links == LINKS


def test_a_session_carries_its_scene(scene, tmp_path):
    create_session(tmp_path / "s", scene, LINKS).close()
    shutil.rmtree(scene.path.parent)
    log = SessionLog(shutil.move(tmp_path / "s", tmp_path / "elsewhere"))
    assert log.scene.skin.layout.channels.tolist() == list(range(24))
    assert log.findings == ()


def test_files_that_lie_elsewhere_are_copied_and_named_anew(scene, tmp_path):
    folder = scene.path.parent
    (folder / "deep").mkdir()
    mesh = tmp_path / "part.stl"
    mesh.write_bytes(b"a mesh")
    path = folder / "deep" / "scene.toml"
    text = scene.text.replace('"modules.toml"', '"../modules.toml"')
    path.write_text(text + f"[surface]\nmesh = '{mesh}'\nunit = \"mm\"\n")
    from skincal.model.scene import load_scene

    create_session(tmp_path / "s", load_scene(path), LINKS).close()
    copied = SessionLog(tmp_path / "s").scene
    assert copied.surface.path == tmp_path / "s" / "scene" / "part.stl"
    assert copied.surface.path.read_bytes() == b"a mesh"
    assert copied.skin.layout is not None


def test_a_changed_scene_is_said(scene, tmp_path):
    record(scene, tmp_path / "s", pokes=1).close()
    with (tmp_path / "s" / "scene" / "scene.toml").open("a") as file:
        file.write("[contacts]\nforce_min = 5.0\n")
    assert approved("mesh.changed_after_recording") in replay(tmp_path / "s").findings[0]


def test_an_action_that_no_longer_fits_a_changed_scene_is_said_and_left_out(scene, tmp_path):
    record(scene, tmp_path / "s", pokes=2, actions=[(0.9, Exclude(1))]).close()
    with (tmp_path / "s" / "scene" / "scene.toml").open("a") as file:
        file.write("[contacts]\nforce_min = 12.0\n")
    pipeline = replay(tmp_path / "s")
    assert pipeline.session.contacts == ()
    assert any("no longer fits" in sentence and "Poke 1" in sentence for sentence in pipeline.findings)


def test_replay_is_the_live_session_bit_for_bit(scene, tmp_path):
    live = record(scene, tmp_path / "s")
    live.close()
    assert len(live.session.contacts) == 4
    assert_same(live, replay(tmp_path / "s"))


def test_replay_does_what_the_operator_did(scene, tmp_path):
    actions = [(0.5, Exclude(1)), (0.6, MarkDead(2)), (0.8, Undo()), (0.97, Exclude(2))]
    live = record(scene, tmp_path / "s", actions=actions)
    live.close()
    assert live.session.excluded == (1, 2, 3)  # poke 3 by undo
    assert_same(live, replay(tmp_path / "s"))


def test_a_refused_wish_is_not_recorded(scene, tmp_path):
    live = record(scene, tmp_path / "s", pokes=1)
    with pytest.raises(InputError):
        live.act(Exclude(77), 1)
    live.close()
    assert_same(live, replay(tmp_path / "s"))


def test_resume_goes_on_in_a_new_segment(scene, tmp_path):
    folder = tmp_path / "s"
    first = record(scene, folder, pokes=3)
    first.close()
    second = resume(folder)
    for item in as_chunks(some_pokes(scene, 2, seed=9).samples):
        second.feed(item)
    second.act(Exclude(2), 1)
    second.close()
    assert [record.outcome.poke for record in second.snapshot().pokes] == [1, 2, 3, 4, 5]
    assert sorted(path.name for path in folder.glob("*.mcap")) == ["segment-0001.mcap", "segment-0002.mcap"]
    third = resume(folder)
    third.close()
    assert_same(second, third)
    assert_same(third, replay(folder))


def test_resume_in_the_middle_of_a_poke_loses_that_poke_alone(scene, tmp_path):
    folder = tmp_path / "s"
    pipeline = Pipeline(scene, LINKS, None, create_session(folder, scene, LINKS))
    items = as_chunks(some_pokes(scene, 2).samples)
    for item in items[: round(len(items) * 0.72)]:  # the second poke is held
        pipeline.feed(item)
    pipeline.close()
    assert len(pipeline.session.contacts) == 1
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


@pytest.mark.parametrize("name", ["nothing", "empty", "other"])
def test_what_is_no_session_is_refused_with_a_sentence(tmp_path, name):
    if name != "nothing":
        (tmp_path / name).mkdir()
    if name == "other":
        (tmp_path / name / "segment-0001.mcap").write_bytes(b"not an MCAP file at all")
    with pytest.raises(InputError):
        SessionLog(tmp_path / name)


def test_a_missing_segment_is_said(scene, tmp_path):
    record(scene, tmp_path / "s", pokes=1).close()
    (tmp_path / "s" / "segment-0001.mcap").rename(tmp_path / "s" / "segment-0002.mcap")
    with pytest.raises(InputError, match=r"segment-0001\.mcap is missing"):
        SessionLog(tmp_path / "s")


def test_other_programs_read_the_decoded_readings(scene, tmp_path):
    live = record(scene, tmp_path / "s", pokes=1)
    live.close()
    found = {}
    with (tmp_path / "s" / "segment-0001.mcap").open("rb") as file:
        for _, channel, message, decoded in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(
            topics=["/wrench", "/taxels"]
        ):
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
    frames = some_pokes(scene, 1).samples
    assert abs(len(found["/wrench"]) - 4 * len(frames)) <= 8
    assert abs(len(found["/taxels"]) - len(frames)) <= 2
    log_ns, wrench = found["/wrench"][0]
    assert wrench.wrench.force.z == pytest.approx(frames[0].wrench[2], abs=1e-6)
    assert wrench.header.stamp.sec * 1_000_000_000 + wrench.header.stamp.nanosec == log_ns
    _, taxels = found["/taxels"][0]
    np.testing.assert_allclose(taxels.values, frames[0].skin, atol=0.006)
    assert taxels.header.frame_id == "table"


def test_joint_states_decode_too(scene, tmp_path):
    journal = create_session(tmp_path / "s", scene, LINKS)
    angles = np.array([0.1, -0.2, 0.3])
    journal.write_sample(Sample(12.5, np.array([1.0, np.nan]), np.zeros(6), 1, saturated=False, angles=angles))
    journal.close()
    with (tmp_path / "s" / "segment-0001.mcap").open("rb") as file:
        messages = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(topics=["/joints", "/taxels"])
        decoded = {channel.topic: message for _, channel, _, message in messages}
    assert list(decoded["/joints"].position) == angles.tolist()
    assert list(decoded["/joints"].name) == ["joint0", "joint1", "joint2"]
    assert np.isnan(decoded["/taxels"].values[1])


def test_raw_chunks_decode_by_their_own_schema(scene, tmp_path):
    journal = create_session(tmp_path / "s", scene, LINKS)
    journal.write(Chunk("skin", 123, b"\x01\x02\x03"))
    journal.close()
    with (tmp_path / "s" / "segment-0001.mcap").open("rb") as file:
        ((_, _, _, message),) = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(
            topics=["/raw/skin"]
        )
    assert (message.host_ns, bytes(message.data)) == (123, b"\x01\x02\x03")


@pytest.mark.parametrize("frame", ["", "a", "ab", "abc", "abcd", "abcdefg"])
def test_alignment_holds_for_every_length_of_a_name(frame):
    from mcap_ros2._dynamic import generate_dynamic

    name = "geometry_msgs/msg/WrenchStamped"
    decode = generate_dynamic(name, documents.MESSAGE_SCHEMAS[name])[name]
    times = np.array([3, 1_500_000_000_000_000_007])
    message = decode(documents.encode_wrenches(times, frame, np.arange(-6.0, 6.0).reshape(2, 6))[1].tobytes())
    assert message.header.frame_id == frame
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_500_000_000, 7)
    assert [message.wrench.force.x, message.wrench.torque.z] == [0.0, 5.0]
    name = "skincal_msgs/msg/Taxels"
    message = generate_dynamic(name, documents.MESSAGE_SCHEMAS[name])[name](
        documents.encode_taxels(3, frame, 9, 77, np.array([1.5, 2.5]))
    )
    assert (message.seq, message.device_time_us, list(message.values)) == (9, 77, [1.5, 2.5])
    name = "sensor_msgs/msg/JointState"
    message = generate_dynamic(name, documents.MESSAGE_SCHEMAS[name])[name](
        documents.encode_joints(3, frame, ("x", frame), np.array([1.0, 2.0]))
    )
    assert (list(message.name), list(message.position), list(message.effort)) == (["x", frame], [1.0, 2.0], [])


def test_metadata_says_what_the_file_is(scene, tmp_path):
    create_session(tmp_path / "s", scene, LINKS).close()
    with (tmp_path / "s" / "segment-0001.mcap").open("rb") as file:
        (metadata,) = [metadata for metadata in make_reader(file).iter_metadata() if metadata.name == "skincal"]
    assert metadata.metadata["scene"] == scene.text
    assert [link["name"] for link in json.loads(metadata.metadata["links"])] == ["wrench", "skin"]
    assert abs(int(metadata.metadata["unix_ns"]) - time.time_ns()) < 60e9


def test_what_is_buffered_is_written_after_half_a_second(scene, tmp_path):
    journal = create_session(tmp_path / "s", scene, LINKS)
    path = tmp_path / "s" / "segment-0001.mcap"
    size = path.stat().st_size
    journal.write(Chunk("skin", 1_000_000_000, os.urandom(5000)))
    journal.tick(1_400_000_000)
    assert path.stat().st_size == size
    journal.tick(1_600_000_000)
    assert path.stat().st_size > size + 5000
    assert list(SessionLog(tmp_path / "s").items())[1].host_ns == 1_000_000_000
    journal.close()


def test_every_contact_is_forced_onto_the_medium(scene, tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(JournalWriter, "sync", lambda self: synced.append(self._items))
    record(scene, tmp_path / "s", pokes=3).close()
    assert len(synced) == 6  # at its release and when it is final
