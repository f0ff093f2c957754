"""The lines beside a segment: the same session as the MCAP file gives, and never instead of the truth."""

import json
import shutil

import numpy as np
import pytest
from mcap.reader import make_reader

from skincal.contacts.outcome import Reason, Rejection
from skincal.journal import mcap_file, reader
from skincal.journal.documents import LineWriter, Taken, Totals, key_of, lines_path, read_lines
from skincal.journal.reader import SessionLog
from skincal.journal.writer import create_session
from skincal.model.actions import Exclude, MarkDead, Restore, Undo
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay, resume
from tests.skincal.poke_script import (
    LINKS,
    SPOTS,
    Script,
    as_chunks,
    killed,
    outcome_key,
    same_estimates,
    small_scene,
    some_pokes,
    write_scene,
)

ACTIONS = [(0.3, Exclude(1)), (0.4, MarkDead(2)), (0.5, Restore(1)), (0.6, Undo()), (0.97, Exclude(2))]


@pytest.fixture
def scene(tmp_path):
    return write_scene(tmp_path / "source")


def record(scene, folder, script, actions=()):
    pipeline = Pipeline(scene, LINKS, None, create_session(folder, scene, LINKS))
    items = as_chunks(script.samples)
    due = {round(share * len(items)): action for share, action in actions}
    for k, item in enumerate(items):
        pipeline.feed(item)
        if k in due:
            pipeline.act(due[k], item.host_ns)
    return pipeline


def from_notes(folder):
    """The session as it is read where there are no lines."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reader, "read_lines", lambda _: None)
        return load(folder)


def assert_same(first, second):
    one, other = first.snapshot(), second.snapshot()
    assert [outcome_key(record.outcome) for record in one.pokes] == [outcome_key(record.outcome) for record in other.pokes]
    assert [record.excluded for record in one.pokes] == [record.excluded for record in other.pokes]
    assert list(one.dead.items()) == list(other.dead.items())
    assert one.can_undo == other.can_undo
    assert same_estimates(one, other)
    assert first.totals() == second.totals()
    assert sorted(first._doubts) == sorted(second._doubts)


def path_of(folder, number=1):
    return folder / f"segment-{number:04d}.mcap"


def crowded(scene):
    """Pokes during which a far channel always answers, until it is found dead and the pokes are judged anew."""
    script = Script(scene, skin_noise=0.8).quiet(1.0)
    for k in range(6):
        script.press(np.array([1.0, 2.0, -8.0]), SPOTS[k % 3], {3: 80.0, 7: 40.0, 20: 60.0}, hold_s=0.4).quiet(0.6)
    return script


@pytest.mark.parametrize(
    ("script", "actions"),
    [
        (lambda scene: some_pokes(scene, 5), ()),
        (lambda scene: some_pokes(scene, 6), ACTIONS),
        (crowded, ()),
        (crowded, [(0.3, MarkDead(20)), (0.5, Exclude(1)), (0.97, Undo())]),
    ],
    ids=["plain", "with actions", "judged anew", "judged anew by an action"],
)
def test_the_lines_give_the_session_that_the_notes_give(scene, tmp_path, script, actions):
    live = record(scene, tmp_path / "s", script(scene), actions)
    live.close()
    loaded = load(tmp_path / "s")
    assert loaded.findings == ()
    assert_same(loaded, from_notes(tmp_path / "s"))
    assert_same(loaded, live)
    while loaded.snapshot().can_undo:
        loaded.act(Undo(), 1)
        live.act(Undo(), 1)
        assert_same(loaded, live)


def test_what_the_next_line_replaces_is_left_out(scene, tmp_path):
    record(scene, tmp_path / "s", some_pokes(scene, 5)).close()
    taken = [json.loads(line) for line in read_lines(path_of(tmp_path / "s")).documents]
    first, *lines = [line for line in taken if line["type"] not in ("link", "end")]
    assert first["type"] == "segment"
    assert [line["type"] for line in lines] == ["taken"] * 5 + ["totals"]
    assert [line["outcomes"][0]["final"] for line in lines[:5]] == [True] * 5
    notes = [item for item in SessionLog(tmp_path / "s").state() if isinstance(item, Taken)]
    assert len(notes) == 5


def test_a_first_outcome_stays_where_something_was_done_before_the_second(scene, tmp_path):
    """The steps of undo follow the order in which a poke was accepted and an action done."""
    script = some_pokes(scene, 2)
    pipeline = Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
    for item in as_chunks(script.samples):
        pipeline.feed(item)
        if len(pipeline.session.contacts) == 2 and not pipeline.session.outcome(2).final and not pipeline.session.excluded:
            pipeline.act(Exclude(1), item.host_ns)
    pipeline.close()
    assert [line.count(b'"poke"') for line in read_lines(path_of(tmp_path / "s")).documents if b"taken" in line] == [1, 1, 1]
    assert_same(load(tmp_path / "s"), pipeline)
    assert pipeline.snapshot().can_undo == "exclusion of poke 1"


def test_opening_reads_the_lines_alone(scene, tmp_path, monkeypatch):
    record(scene, tmp_path / "s", some_pokes(scene, 6)).close()
    monkeypatch.setattr(mcap_file, "_records", lambda *_, **__: pytest.fail("the MCAP file was read"))
    assert len(load(tmp_path / "s").session.contacts) == 6


def test_a_damaged_line_is_not_believed(scene, tmp_path):
    live = record(scene, tmp_path / "s", some_pokes(scene, 3))
    live.close()
    path = lines_path(path_of(tmp_path / "s"))
    whole = path.read_bytes()
    written = read_lines(path_of(tmp_path / "s")).documents
    for at in range(0, len(whole), 37):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 16]) + whole[at + 1 :])
        back = read_lines(path_of(tmp_path / "s"))
        assert back is None or (not back.closed and back.lost)
        assert back is None or len(back.documents) <= len(written)
    assert_same(load(tmp_path / "s"), live)


def test_a_line_that_is_lost_or_moved_is_missed(scene, tmp_path):
    record(scene, tmp_path / "s", some_pokes(scene, 3)).close()
    path = lines_path(path_of(tmp_path / "s"))
    lines = path.read_bytes().splitlines(keepends=True)
    for k in range(1, len(lines) - 1):
        for changed in ([*lines[:k], *lines[k + 1 :]], [*lines[:k], lines[k + 1], lines[k], *lines[k + 2 :]]):
            path.write_bytes(b"".join(changed))
            assert read_lines(path_of(tmp_path / "s")).size == len(b"".join(lines[:k]))


def test_a_session_that_was_cut_off_loses_nothing(scene, tmp_path):
    live = record(scene, tmp_path / "s", some_pokes(scene, 3))
    killed(live)
    assert not read_lines(path_of(tmp_path / "s")).closed
    loaded = load(tmp_path / "s")
    assert any("was not closed" in sentence for sentence in loaded.findings)
    assert len(loaded.session.contacts) == 3
    again = resume(tmp_path / "s")
    again.close()
    assert all(read_lines(path_of(tmp_path / "s", number)).closed for number in (1, 2))
    assert same_estimates(load(tmp_path / "s").snapshot(), again.snapshot())


def test_damaged_readings_and_notes_of_a_closed_segment_cost_no_poke(scene, tmp_path):
    live = record(scene, tmp_path / "s", some_pokes(scene, 4))
    live.close()
    path = path_of(tmp_path / "s")
    data = bytearray(path.read_bytes())
    with path.open("rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    for chunk in chunks[1:]:
        data[chunk.chunk_start_offset] = 0x86
    path.write_bytes(data)
    assert_same(load(tmp_path / "s"), live)
    again = resume(tmp_path / "s")
    assert path.read_bytes() == data  # nothing is cut away
    for item in as_chunks(some_pokes(scene, 1, 9).samples):
        again.feed(item)
    killed(again)  # killed: the second segment has to be recovered, the first must not be cut
    third = resume(tmp_path / "s")
    assert any("segment-0002.mcap" in sentence for sentence in third.findings)
    assert path.read_bytes() == data
    assert len(third.session.contacts) == 5
    third.close()


def test_other_programs_read_the_lines_and_the_notes(scene, tmp_path):
    record(scene, tmp_path / "s", some_pokes(scene, 1)).close()
    lines = [json.loads(line) for line in lines_path(path_of(tmp_path / "s")).read_text().splitlines()]
    assert [line[1] for line in lines] == sorted(line[1] for line in lines)
    with path_of(tmp_path / "s").open("rb") as file:
        messages = list(make_reader(file, validate_crcs=True).iter_messages(topics=["/session", "/events"]))
    written = [line[3] for line in lines if len(line) == 4]
    assert written == sorted((json.loads(message.data) for _, _, message in messages), key=lambda document: document["n"])


def test_lines_outlive_a_damaged_index(scene, tmp_path):
    """A segment that was torn behind its data is closed anew."""
    live = record(scene, tmp_path / "s", some_pokes(scene, 3))
    live.close()
    path = path_of(tmp_path / "s")
    written = read_lines(path)
    path.write_bytes(path.read_bytes()[:-400])
    again = resume(tmp_path / "s")
    assert "nothing is lost" in again.findings[0]
    again.close()
    assert read_lines(path) == written
    with path.open("rb") as file:
        assert make_reader(file, validate_crcs=True).get_summary().statistics.message_count > 0
    shutil.rmtree(tmp_path / "source")
    assert_same(load(tmp_path / "s"), replay(tmp_path / "s"))


def test_only_a_second_outcome_of_the_same_kind_takes_the_place_of_the_first(tmp_path):
    """What was a contact and is none any more leaves the steps of undo, so both are kept."""
    contact, other = some_pokes(small_scene(), 1).run()
    rejection = Rejection(1, 0.0, 1.0, Reason.SLID, 1.0, 0.5, "", np.empty(0, dtype=np.int64), final=True)
    writer = LineWriter(tmp_path / "x.jsonl")
    for document, note in (
        ("first", Taken([(contact, None)])),
        ("second", Taken([(other, None)])),
        ("counts", Totals()),
        ("third", Taken([(contact, None)])),
        ("dead", Taken([(other, None)], {3: "stuck"})),
        ("both", Taken([(contact, None), (other, None)])),
        ("event", None),
        ("more counts", Totals()),
        ("fourth", Taken([(other, None)])),
        ("rejected", Taken([(rejection, None)])),
    ):
        writer.add(7, key_of(note), json.dumps(document).encode())
    writer.close(7)
    kept = [json.loads(document) for document in read_lines(tmp_path / "x.mcap").documents]
    assert kept == ["third", "dead", "both", "event", "fourth", "rejected", "more counts"]
