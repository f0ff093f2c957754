"""The line file of a segment: it gives the same session as the bytes, and damage in it is noticed."""

import json

import numpy as np
import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader

from skincal.contacts.outcome import PressPhase, Reason, Rejection
from skincal.journal import mcap_file
from skincal.journal.documents import DetectorResult, Totals, key_of
from skincal.journal.line_file import LineWriter, lines_path, read_lines
from skincal.journal.reader import SessionLog
from skincal.model.actions import Exclude, MarkDead, Restore, Undo
from skincal.model.errors import InputError
from skincal.session.replay import load, replay, resume
from tests.skincal.journal.journal_support import assert_same, more_pokes, new_session, record, records_of, segment
from tests.skincal.poke_script import SPOTS, Script, as_chunks, killed, small_scene, some_pokes, write_scene

ACTIONS = [(0.3, Exclude(1)), (0.4, MarkDead(2)), (0.5, Restore(1)), (0.6, Undo()), (0.97, Exclude(2))]


@pytest.fixture
def scene(tmp_path):
    return write_scene(tmp_path / "source")


def test_a_session_that_is_closed_while_poking_was_closed(scene, tmp_path):
    """Closing in a hold, in a release, and before the tare after a poke: its last outcome is written behind the end mark."""
    samples, phases = some_pokes(scene, 2).samples, set()
    for end in range(len(samples) // 2, len(samples), 7):
        live = new_session(scene, tmp_path / str(end))
        for item in as_chunks(samples[:end]):
            live.feed(item)
        phases.add(live.phase)
        live.close()
        loaded = load(tmp_path / str(end))
        assert loaded.findings == ()
        assert_same(live, loaded)
    assert {PressPhase.READY, PressPhase.PRESSING, PressPhase.STILL, PressPhase.HELD} <= phases


def crowded(scene):
    """Pokes during which a far channel always answers, until it is found dead and the pokes are judged again."""
    script = Script(scene, skin_noise=0.8).quiet(1.0)
    for k in range(6):
        script.press(np.array([1.0, 2.0, -8.0]), SPOTS[k % 3], {3: 80.0, 7: 40.0, 20: 60.0}, hold_s=0.4).quiet(0.6)
    return script


@pytest.mark.parametrize(
    ("script", "actions"),
    [
        (lambda _: 5, ()),
        (lambda _: 6, ACTIONS),
        (crowded, ()),
        (crowded, [(0.3, MarkDead(20)), (0.5, Exclude(1)), (0.97, Undo())]),
    ],
    ids=["plain", "with actions", "judged again", "judged again by an action"],
)
def test_the_lines_give_the_session_that_the_bytes_give(scene, tmp_path, script, actions):
    live = record(scene, tmp_path / "s", script(scene), actions)
    with pytest.raises(InputError):  # and is not recorded
        live.act(Exclude(77), 1)
    live.close()
    loaded, played = load(tmp_path / "s"), replay(tmp_path / "s")
    assert loaded.findings == ()
    assert loaded.totals() == played.totals() == live.totals()
    assert_same(live, loaded, played)
    while loaded.snapshot().can_undo:
        for pipeline in (loaded, live, played):
            pipeline.act(Undo(), 1)
        assert_same(live, loaded, played)


def test_a_replaced_line_is_left_out(scene, tmp_path):
    record(scene, tmp_path / "s", 5).close()
    taken = [json.loads(line) for line in read_lines(segment(tmp_path / "s")).documents]
    first, *lines = [line for line in taken if line["type"] not in ("link", "end")]
    assert first["type"] == "segment"
    assert [line["type"] for line in lines] == ["taken"] * 5 + ["totals"]
    assert [line["outcomes"][0]["final"] for line in lines[:5]] == [True] * 5
    assert sum(isinstance(item, DetectorResult) for item in SessionLog(tmp_path / "s").state()) == 5


def test_a_first_outcome_stays_if_something_was_done_before_the_second(scene, tmp_path):
    """The steps of undo follow the order of accepted pokes and actions."""
    pipeline = new_session(scene, tmp_path / "s")
    for item in as_chunks(some_pokes(scene, 2).samples):
        pipeline.feed(item)
        if len(pipeline.session.contacts) == 2 and not pipeline.session.outcome(2).final and not pipeline.session.excluded:
            pipeline.act(Exclude(1), item.host_ns)
    pipeline.close()
    assert [line.count(b'"poke"') for line in read_lines(segment(tmp_path / "s")).documents if b"taken" in line] == [1, 1, 1]
    assert_same(load(tmp_path / "s"), pipeline)
    assert pipeline.snapshot().can_undo == "exclusion of poke 1"


def test_opening_reads_the_lines_alone(scene, tmp_path, monkeypatch):
    record(scene, tmp_path / "s", 6).close()
    monkeypatch.setattr(mcap_file, "_records", lambda *_, **__: pytest.fail("the MCAP file was read"))
    assert len(load(tmp_path / "s").session.contacts) == 6


def test_a_damaged_lost_or_moved_line_is_noticed(scene, tmp_path):
    live = record(scene, tmp_path / "s", 3)
    live.close()
    path = lines_path(segment(tmp_path / "s"))
    whole = path.read_bytes()
    count = len(read_lines(segment(tmp_path / "s")).documents)
    for at in range(0, len(whole), 37):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 16]) + whole[at + 1 :])
        back = read_lines(segment(tmp_path / "s"))
        assert not back.closed
        assert back.lost
        assert len(back.documents) <= count
    assert_same(load(tmp_path / "s"), live)  # from the bytes
    lines = whole.splitlines(keepends=True)
    for k in range(1, len(lines) - 1):
        for changed in ([*lines[:k], *lines[k + 1 :]], [*lines[:k], lines[k + 1], lines[k], *lines[k + 2 :]]):
            path.write_bytes(b"".join(changed))
            assert read_lines(segment(tmp_path / "s")).size == len(b"".join(lines[:k]))


def test_a_session_that_was_cut_off_loses_nothing(scene, tmp_path):
    killed(record(scene, tmp_path / "s", 3))
    assert not read_lines(segment(tmp_path / "s")).closed
    loaded = load(tmp_path / "s")
    assert any("was not closed" in sentence for sentence in loaded.findings)
    assert len(loaded.session.contacts) == 3
    again = resume(tmp_path / "s")
    again.close()
    assert all(read_lines(segment(tmp_path / "s", number)).closed for number in (1, 2))
    assert_same(load(tmp_path / "s"), again)


def test_damaged_readings_of_a_closed_segment_cost_no_poke(scene, tmp_path):
    live = record(scene, tmp_path / "s", 4)
    live.close()
    path = segment(tmp_path / "s")
    data = bytearray(path.read_bytes())
    for begin, _ in list(records_of(data, Opcode.CHUNK))[1:]:
        data[begin] = 0x86
    path.write_bytes(data)
    assert_same(load(tmp_path / "s"), live)
    killed(more_pokes(resume(tmp_path / "s")))
    assert path.read_bytes() == data  # nothing is cut away
    third = resume(tmp_path / "s")
    assert any("segment-0002.mcap" in sentence for sentence in third.findings)
    assert path.read_bytes() == data
    assert len(third.session.contacts) == 5
    third.close()


def test_other_programs_read_the_lines_and_the_events(scene, tmp_path):
    record(scene, tmp_path / "s", 1).close()
    lines = [json.loads(line) for line in lines_path(segment(tmp_path / "s")).read_text().splitlines()]
    assert [line[1] for line in lines] == sorted(line[1] for line in lines)
    with segment(tmp_path / "s").open("rb") as file:
        events = [
            json.loads(message.data) for _, _, message in make_reader(file).iter_messages(["/events"], log_time_order=False)
        ]
    assert events == [line[3] for line in lines if len(line) == 4 and line[3]["type"] not in ("taken", "totals")]


def test_lines_outlive_a_damaged_index(scene, tmp_path):
    live = record(scene, tmp_path / "s", 3)
    live.close()
    path = segment(tmp_path / "s")
    written = read_lines(path)
    path.write_bytes(path.read_bytes()[:-400])
    again = resume(tmp_path / "s")
    assert "nothing is lost" in again.findings[0]
    again.close()
    assert read_lines(path) == written
    with path.open("rb") as file:
        assert make_reader(file, validate_crcs=True).get_summary().statistics.message_count > 0
    assert_same(live, load(tmp_path / "s"), replay(tmp_path / "s"))


def test_only_a_second_outcome_of_the_same_kind_replaces_the_first(tmp_path):
    contact, other = some_pokes(small_scene(), 1).run()
    rejection = Rejection(1, 0.0, 1.0, Reason.SLID, 1.0, 0.5, "", np.empty(0, dtype=np.int64), final=True)
    writer = LineWriter(tmp_path / "x.jsonl")
    for document, result in (
        ("first", DetectorResult([contact])),
        ("second", DetectorResult([other])),
        ("counts", Totals()),
        ("third", DetectorResult([contact])),
        ("dead", DetectorResult([other], {3: "stuck"})),
        ("both", DetectorResult([contact, other])),
        ("event", None),
        ("more counts", Totals()),
        ("fourth", DetectorResult([other])),
        ("rejected", DetectorResult([rejection])),
    ):
        writer.add(7, "" if result is None else key_of(result), json.dumps(document).encode())
    writer.close(7)
    kept = [json.loads(document) for document in read_lines(tmp_path / "x.mcap").documents]
    assert kept == ["third", "dead", "both", "event", "fourth", "rejected", "more counts"]
