"""Torn, flipped and full: a damaged session is read as a beginning of the original, with a sentence about the rest."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from itertools import islice

import numpy as np
import pytest
from mcap.opcode import Opcode

from app.text.message import refused_words
from skincal.contacts.outcome import Contact
from skincal.journal.reader import SessionLog
from skincal.journal.writer import create_session
from skincal.model.errors import InputError
from skincal.model.readings import Chunk
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay, resume
from tests.approved import approved, approved_pattern
from tests.skincal.journal.journal_support import (
    feed,
    more_pokes,
    new_session,
    outcomes_of,
    process,
    record,
    records_of,
    refuse,
    segment,
)
from tests.skincal.poke_script import LINKS, as_chunks, next_segment, outcome_key, some_pokes, torn, write_scene


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A session that was closed: its folder and its items."""
    folder = tmp_path_factory.mktemp("damage")
    record(write_scene(folder / "source"), folder / "s").close()
    return folder / "s", list(SessionLog(folder / "s").items())


def damaged_copy(recorded, tmp_path, change=lambda data: data):
    folder, items = recorded
    target = shutil.copytree(folder, tmp_path / f"d{len(list(tmp_path.iterdir()))}")
    path = segment(target)
    path.write_bytes(change(bytearray(path.read_bytes())))
    return target, items


def read_all(folder):
    log = SessionLog(folder)
    return list(log.items()), log.findings


def test_a_torn_session_is_a_beginning(recorded, tmp_path):
    rng = random.Random(1)
    size = (recorded[0] / "segment-0001.mcap").stat().st_size
    lengths = []
    for at in sorted(rng.sample(range(size // 4, size - 8), 30)):
        folder, items = damaged_copy(recorded, tmp_path, lambda data, at=at: data[:at])
        back, findings = read_all(folder)
        assert back == items[: len(back)]
        assert len(findings) == 1, findings
        lengths.append(len(back))
    assert lengths == sorted(lengths)
    assert lengths[-1] == len(items)  # only the index was cut off
    assert lengths[0] < len(items) / 2


def test_a_flipped_bit_never_gives_a_wrong_value(recorded, tmp_path):
    rng = random.Random(2)
    size = (recorded[0] / "segment-0001.mcap").stat().st_size
    shorter = 0
    for _ in range(60):
        at, bit = rng.randrange(6000, size), 1 << rng.randrange(8)

        def flip(data, at=at, bit=bit):
            data[at] ^= bit
            return data

        folder, items = damaged_copy(recorded, tmp_path, flip)
        back, findings = read_all(folder)
        assert back == items[: len(back)]
        if len(back) < len(items):
            shorter += 1
            assert findings
            assert "lost" in findings[0]
    assert shorter > 20


def test_a_chunk_that_loses_its_kind_leaves_no_hole(recorded, tmp_path):
    """A record of a kind that no reader knows is skipped by the format; the numbers of the items tell."""

    def hide(data):
        chunks = list(records_of(data, Opcode.CHUNK))
        data[chunks[len(chunks) // 2][0]] = 0x86
        return data

    folder, items = damaged_copy(recorded, tmp_path, hide)
    back, findings = read_all(folder)
    assert 0 < len(back) < len(items)
    assert back == items[: len(back)]
    assert "missing" in findings[0]


def test_zeros_at_the_end_are_cut_off(recorded, tmp_path):
    folder, items = damaged_copy(recorded, tmp_path, lambda data: data[:-20000] + bytes(20000))
    back, findings = read_all(folder)
    assert back == items[: len(back)]
    assert len(findings) == 1


def test_a_torn_session_is_recovered_and_goes_on(recorded, tmp_path):
    folder, items = damaged_copy(recorded, tmp_path)
    torn(folder, (folder / "segment-0001.mcap").stat().st_size * 2 // 3)
    before, _ = read_all(folder)
    assert len(items) / 4 < len(before) < len(items)
    pipeline = resume(folder)
    assert (folder / "segment-0001.mcap.damaged").exists()
    assert "recovered" in pipeline.findings[0]
    assert "bytes were lost" in pipeline.findings[0]
    more_pokes(pipeline).close()
    assert {path.name for path in folder.glob("*.mcap")} == {"segment-0001.mcap", "segment-0002.mcap"}
    again, findings = read_all(folder)
    assert again[: len(before)] == before
    assert findings == ()
    assert outcomes_of(replay(folder)) == outcomes_of(pipeline)


def test_segments_after_a_hole_are_put_aside(recorded, tmp_path):
    folder, items = damaged_copy(recorded, tmp_path)
    resume(folder).close()
    torn(folder, (folder / "segment-0001.mcap").stat().st_size // 2)
    back, findings = read_all(folder)
    assert back == items[: len(back)]
    assert "segment-0002.mcap: not read" in findings[1]
    assert "segment-0002.mcap: not read" in load(folder).findings[1]
    pipeline = resume(folder)
    pipeline.close()
    assert {path.name for path in folder.glob("segment-0002*after-damage")} == {
        "segment-0002.mcap.after-damage",
        "segment-0002.jsonl.after-damage",
    }
    assert any("put aside" in sentence for sentence in pipeline.findings)
    assert load(folder).findings == replay(folder).findings == ()


def test_lost_bytes_of_an_earlier_segment_cost_no_poke(recorded, tmp_path):
    """The lines tell what was made of them, and that bytes lack; playing these ends there, and says so."""
    folder, _ = damaged_copy(recorded, tmp_path)
    resume(folder).close()
    path = folder / "segment-0001.mcap"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    for cut in (True, False):
        loaded, played = load(folder), replay(folder)
        # Recovering gives the file an end again.
        assert [approved("session.torn_bytes") in finding for finding in loaded.findings] == [True] * cut
        assert 0 < len(played.session.contacts) < len(loaded.session.contacts) == 4
        assert "lost" in played.findings[0]
        assert approved("session.hole") in played.findings[1]
        pipeline = resume(folder)
        assert len(pipeline.session.contacts) == 4
        pipeline.close()
    assert [path.name for path in folder.glob("*.damaged")] == ["segment-0001.mcap.damaged"]
    assert list(folder.glob("*after-damage")) == []


def test_torn_lines_are_read_up_to_there_and_the_bytes_with_them(recorded, tmp_path):
    """A disk that loses power keeps what was forced onto it, and of the rest any beginning of each file."""
    rng = random.Random(3)
    data = (recorded[0] / "segment-0001.jsonl").read_bytes()
    counts = []
    for at in [0, 1, *sorted(rng.sample(range(data.index(b"\n") + 1, len(data)), 3))]:
        folder, _ = damaged_copy(recorded, tmp_path, lambda data: data[: len(data) - 40])  # no end, either
        lines = folder / "segment-0001.jsonl"
        lines.write_bytes(lines.read_bytes()[:at] + bytes(rng.randrange(200)))
        loaded, played = load(folder), replay(folder)
        assert loaded.findings
        assert outcomes_of(loaded) == outcomes_of(played)
        counts.append(len(loaded.session.contacts))
        pipeline = more_pokes(resume(folder))
        pipeline.close()
        assert outcomes_of(pipeline) == outcomes_of(load(folder)) == outcomes_of(replay(folder))
    assert counts[0] == counts[1] == 4, "without a line there is the MCAP file"
    assert counts[2:] == sorted(counts[2:])
    assert counts[2] < 4


def test_a_flipped_bit_of_a_line_costs_nothing_while_the_bytes_are_whole(recorded, tmp_path):
    rng = random.Random(4)
    data = (recorded[0] / "segment-0001.jsonl").read_bytes()
    whole = load(recorded[0])
    for _ in range(10):
        folder, items = damaged_copy(recorded, tmp_path)
        changed = bytearray(data)
        changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        (folder / "segment-0001.jsonl").write_bytes(changed)
        loaded = load(folder)
        assert outcomes_of(loaded) == outcomes_of(whole)
        assert "segment-0001.jsonl" in loaded.findings[0]
        assert read_all(folder)[0] == items


def test_reading_is_lazy(recorded):
    log = SessionLog(recorded[0])
    assert len(list(islice(log.items(), 5))) == 5


RECORDER = """
pipeline = Pipeline(scene, LINKS, None, create_session(folder / "s", scene, LINKS))
items = as_chunks(some_pokes(scene, 60).samples)
print("begin", flush=True)
for count, item in enumerate(items):
    pipeline.feed(item)
    if count % 20 == 0:
        print(count, sum(record.outcome.final for record in pipeline.snapshot().pokes), flush=True)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no kill -9")
def test_kill_9_loses_at_most_the_poke_in_progress(tmp_path):
    recorder = process(RECORDER, tmp_path)
    recorder.stdout.readline()
    time.sleep(0.5)
    recorder.kill()
    rest = recorder.communicate()[0].splitlines()
    fed, final = (int(word) for word in rest[-2].split())  # the last line may be torn
    again = resume(tmp_path / "s")
    again.close()
    contacts = again.session.contacts
    assert len(contacts) >= final
    scene = write_scene(tmp_path / "source")
    items = as_chunks(some_pokes(scene, 60).samples)
    whole = Pipeline(scene, LINKS, None)
    read = [item for item in SessionLog(tmp_path / "s").items() if isinstance(item, Chunk)]
    chunks = [item for item in items if isinstance(item, Chunk)]
    assert read == chunks[: len(read)]
    lost_s = (chunks[fed - 2].host_ns - read[-1].host_ns) * 1e-9
    assert lost_s <= 0.6
    for item in items[:fed]:
        whole.feed(item)
    for ours, theirs in zip(contacts, whole.session.contacts, strict=False):
        if ours.final and theirs.final and not np.isnan(ours.tare_change):
            assert outcome_key(ours) == outcome_key(theirs)


FULL_DISK = """
import resource
pipeline = Pipeline(scene, LINKS, None, create_session(folder / "s", scene, LINKS))
resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, 150_000))
for item in as_chunks(some_pokes(scene, 8).samples):
    pipeline.feed(item)
pipeline.close()
print(len(pipeline.session.contacts))
print(pipeline.journal_failure)
print(len(replay(folder / "s").session.contacts))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="this system has no limit on a file's size")
def test_a_full_disk_ends_the_journal_and_nothing_else(tmp_path):
    full = process(FULL_DISK, tmp_path, stderr=subprocess.PIPE)
    out, errors = full.communicate()
    assert (full.returncode, errors) == (0, "")
    live, sentence, kept = out.splitlines()
    assert int(live) == 8
    assert 0 < int(kept) < 8
    assert approved("session.not_written") in sentence
    assert approved("session.export_now") not in sentence
    assert approved("session.export_now") in refused_words(sentence)


def test_a_disk_that_refuses_says_so_once(tmp_path, monkeypatch):
    scene = write_scene(tmp_path / "source")
    pipeline = new_session(scene, tmp_path / "s")
    monkeypatch.setattr(os, "fsync", refuse)
    feed(pipeline, some_pokes(scene, 2))
    assert "No space left" in pipeline.journal_failure
    assert pipeline.journal is None
    assert sum(isinstance(record.outcome, Contact) for record in pipeline.snapshot().pokes) == 2
    monkeypatch.undo()
    with pytest.raises(InputError, match=approved_pattern("session.open_again")):
        pipeline.begin_segment(LINKS, next_segment(tmp_path / "s", scene, LINKS))
    (tmp_path / "s" / "segment-0002.mcap").unlink()
    kept = replay(tmp_path / "s").session.contacts
    assert len(kept) == 1


def test_a_failed_writer_stays_silent(tmp_path, monkeypatch):
    scene = write_scene(tmp_path / "source")
    journal = create_session(tmp_path / "s", scene, LINKS)
    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(Exception, match=approved_pattern("session.not_written")):
        journal.sync()
    journal.write(Chunk("skin", 1, b"x"))
    journal.sync()
    journal.close()
