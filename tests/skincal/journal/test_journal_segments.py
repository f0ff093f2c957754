"""A long session consists of several segments; a change of segment leaves no trace in it."""

import os
import random
import shutil

import pytest
from mcap.reader import make_reader

from skincal.journal import writer
from skincal.journal.documents import SegmentHeader, SessionClosed
from skincal.journal.line_file import lines_path
from skincal.journal.reader import SessionLog
from skincal.journal.writer import create_session
from skincal.model.actions import Exclude, MarkDead, Undo
from skincal.model.readings import Chunk
from skincal.model.scene import resource
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay, resume
from tests.skincal.journal.journal_support import assert_same, more_pokes, outcomes_of, record, refuse, segment
from tests.skincal.poke_script import LINKS, as_chunks, killed, outcome_key, some_pokes, write_scene

SEGMENT_NS = 700_000_000
"""Shorter than the time until a poke is final."""


@pytest.fixture
def scene(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "SEGMENT_MAX_DURATION_NS", SEGMENT_NS)
    return write_scene(tmp_path / "source")


def test_segments_follow_each_other_in_the_middle_of_a_poke(scene, tmp_path, monkeypatch):
    actions = [(0.4, Exclude(1)), (0.6, MarkDead(2)), (0.8, Undo())]
    live = record(scene, tmp_path / "s", 4, actions)
    live.close()
    monkeypatch.undo()
    whole = record(scene, tmp_path / "whole", 4, actions)
    whole.close()
    assert len(list((tmp_path / "s").glob("*.mcap"))) > 6
    assert len(list((tmp_path / "whole").glob("*.mcap"))) == 1
    assert_same(live, whole, load(tmp_path / "s"), replay(tmp_path / "s"))
    assert load(tmp_path / "s").totals() == replay(tmp_path / "s").totals() == whole.totals()
    assert load(tmp_path / "s").findings == replay(tmp_path / "s").findings == ()
    one, other = ([item for item in SessionLog(tmp_path / name).items() if isinstance(item, Chunk)] for name in ("s", "whole"))
    assert one == other
    for path in (tmp_path / "s").glob("*.mcap"):
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            topics = {channel.topic for channel in reader.get_summary().channels.values()}
            assert [metadata.name for metadata in reader.iter_metadata()] == ["skincal"]
        assert {"/raw/wrench", "/raw/skin", "/wrench", "/taxels", "/joints", "/events"} <= topics


def test_times_go_on_from_one_segment_to_the_next(scene, tmp_path):
    record(scene, tmp_path / "s").close()
    ends = []
    for path in sorted((tmp_path / "s").glob("*.mcap")):
        with path.open("rb") as file:
            times = [message.log_time for _, _, message in make_reader(file).iter_messages(topics=["/raw/skin"])]
        ends += [times[0], times[-1]] if times else []
    assert ends == sorted(ends)
    assert ends[-1] - ends[0] < 12e9


@pytest.mark.parametrize("seed", range(2))
def test_a_kill_at_any_moment_leaves_a_session_that_goes_on(scene, tmp_path, seed):
    """The folder copied in the middle of the recording is what a kill leaves."""
    rng = random.Random(seed)
    pipeline = Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
    items = as_chunks(some_pokes(scene, 4).samples)
    moments = sorted(rng.sample(range(20, len(items)), 4))
    final = {}
    for k, item in enumerate(items):
        pipeline.feed(item)
        if k in moments:
            shutil.copytree(tmp_path / "s", tmp_path / f"killed-{k}")
            final[k] = [outcome_key(poke.outcome) for poke in pipeline.snapshot().pokes if poke.outcome.final]
    pipeline.close()
    for k in moments:
        folder = tmp_path / f"killed-{k}"
        loaded, played = load(folder), replay(folder)
        assert_same(loaded, played)
        assert outcomes_of(loaded)[: len(final[k])] == final[k]
        again = more_pokes(resume(folder))
        again.close()
        assert_same(again, load(folder), replay(folder))
        assert replay(folder).findings == ()


def test_a_kill_between_two_segments(scene, tmp_path):
    """The one is closed, and the other has nothing in it yet, or not even a file beside it."""
    live = killed(record(scene, tmp_path / "s"))
    last = max((tmp_path / "s").glob("*.mcap"))
    contents = [b"", b"\x89MCAP0\r\n", last.read_bytes()[:150]]
    for k, data in enumerate(contents):
        folder = shutil.copytree(tmp_path / "s", tmp_path / f"k{k}")
        (folder / last.name).write_bytes(data)
        lines_path(folder / last.name).write_bytes(b"") if k else lines_path(folder / last.name).unlink()
        before = load(folder)
        assert 2 <= len(before.session.contacts) <= len(live.session.contacts)
        again = resume(folder)
        assert any(last.name in sentence for sentence in again.findings)
        again.close()
        assert_same(again, load(folder), replay(folder))
        assert load(folder).findings == replay(folder).findings == ()


def test_lines_without_a_byte_of_the_other_file_still_give_the_session(scene, tmp_path):
    live = record(scene, tmp_path / "s")
    live.close()
    for path in (tmp_path / "s").glob("*.mcap"):
        path.write_bytes(bytes(5000))
    assert_same(live, load(tmp_path / "s"))
    again = resume(tmp_path / "s")
    assert all("were lost" in sentence for sentence in again.findings)
    again.close()
    assert_same(again, load(tmp_path / "s"))
    assert "lost" in replay(tmp_path / "s").findings[0]


def test_a_pause_of_a_long_session(scene, tmp_path):
    """The end of a segment belongs to it, even if the next one is open already."""
    pipeline = record(scene, tmp_path / "s")
    following = pipeline.journal.open_next(scene, LINKS)
    pipeline.close()
    pipeline.begin_segment(LINKS, following)
    more_pokes(pipeline).close()
    assert_same(pipeline, load(tmp_path / "s"), replay(tmp_path / "s"))
    assert load(tmp_path / "s").findings == ()


def test_a_disk_that_takes_no_further_segment_ends_the_journal(scene, tmp_path, monkeypatch):
    pipeline = Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
    items = as_chunks(some_pokes(scene, 3).samples)
    for item in items[: len(items) // 2]:
        pipeline.feed(item)
    begun = len(list((tmp_path / "s").glob("*.mcap")))

    monkeypatch.setattr(writer, "LineWriter", refuse)
    for item in items[len(items) // 2 :]:
        pipeline.feed(item)
    assert "No space left" in pipeline.journal_failure
    assert len(pipeline.session.contacts) == 3
    assert len(list((tmp_path / "s").glob("*.mcap"))) == begun
    assert len(load(tmp_path / "s").session.contacts) >= 1
    assert_same(load(tmp_path / "s"), replay(tmp_path / "s"))


def test_the_shipped_session_goes_on(tmp_path):
    folder = shutil.copytree(resource("sessions/sample"), tmp_path / "s")
    path = segment(folder)
    before = path.read_bytes()
    first = load(folder)
    assert len(first.session.contacts) > 10
    again = resume(folder)
    assert again.findings == ()
    again.act(Exclude(first.session.contacts[0].poke), 1)
    again.close()
    assert path.read_bytes() == before
    assert_same(again, load(folder))


def test_the_end_of_a_session_belongs_to_its_last_segment(scene, tmp_path):
    journal = create_session(tmp_path / "s", scene, LINKS)
    journal.write(Chunk("skin", 1, b"x"))
    following = journal.open_next(scene, LINKS)
    journal.write(SessionClosed(10 * SEGMENT_NS))
    journal.close()
    following.close()
    assert len(list((tmp_path / "s").glob("*.mcap"))) == 2
    assert [type(item) for item in SessionLog(tmp_path / "s").items()] == [SegmentHeader, Chunk, SessionClosed, SegmentHeader]


def test_at_a_contact_both_files_are_forced_onto_the_disk_the_bytes_first(tmp_path, monkeypatch):
    scene = write_scene(tmp_path / "source")
    pipeline = Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
    names = {path.stat().st_ino: path.suffix for path in (tmp_path / "s").glob("segment-*")}
    synced = []
    monkeypatch.setattr(os, "fsync", lambda file: synced.append((names[os.fstat(file).st_ino], os.fstat(file).st_size)))
    for item in as_chunks(some_pokes(scene, 1).samples):
        before, known = len(synced), [record.outcome for record in pipeline.snapshot().pokes]
        pipeline.feed(item)
        if [record.outcome for record in pipeline.snapshot().pokes] != known:
            new = synced[before:]
            assert [suffix for suffix, _ in new] == [".mcap", ".jsonl"]
            assert new[1][1] == len(lines_path(tmp_path / "s" / "segment-0001.mcap").read_bytes())
        else:
            assert synced[before:] == []
    assert len(synced) == 4  # at its release and when it is final
    monkeypatch.undo()
    pipeline.close()
