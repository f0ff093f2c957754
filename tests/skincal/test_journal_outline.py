"""The outline of a closed segment: the same session as its notes give, in one piece, and never instead of the truth."""

import json
import shutil

import numpy as np
import pytest
from mcap.reader import make_reader

from skincal.contacts.outcome import Reason, Rejection
from skincal.session import log, outline, segment
from skincal.session.actions import Exclude, MarkDead, Restore, Undo
from skincal.session.journal import create_session
from skincal.session.log import read_session
from skincal.session.outline import MEDIA_TYPE, NAME, OutlineWriter, read_outline
from skincal.session.replay import load, replay, resume
from skincal.session.road import Road
from skincal.session.taken import Taken
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
    road = Road(scene, LINKS, None, create_session(folder, scene, LINKS))
    items = as_chunks(script.samples)
    due = {round(share * len(items)): action for share, action in actions}
    for k, item in enumerate(items):
        road.feed(item)
        if k in due:
            road.act(due[k], item.host_ns)
    return road


def from_notes(folder):
    """The session as it is read where there is no outline."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(log, "read_outline", lambda _: None)
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


def place_of(path):
    """Where the outline lies in the file: start and length of its record."""
    with path.open("rb") as file:
        (index,) = make_reader(file).get_summary().attachment_indexes
    return index.offset, index.length


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
def test_the_outline_gives_the_session_that_the_notes_give(scene, tmp_path, script, actions):
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
    taken = [json.loads(line) for line in read_outline(path_of(tmp_path / "s"))]
    first, *lines = [line for line in taken if line["type"] not in ("link", "end")]
    assert first["type"] == "segment"
    assert [line["type"] for line in lines] == ["taken"] * 5 + ["totals"]
    assert [line["outcomes"][0]["final"] for line in lines[:5]] == [True] * 5
    notes = [item for item in read_session(tmp_path / "s").state() if isinstance(item, Taken)]
    assert len(notes) == 5


def test_a_first_outcome_stays_where_something_was_done_before_the_second(scene, tmp_path):
    """The steps of undo follow the order in which a poke was accepted and an action done."""
    script = some_pokes(scene, 2)
    road = Road(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
    for item in as_chunks(script.samples):
        road.feed(item)
        if len(road.session.contacts) == 2 and not road.session.outcome(2).final and not road.session.excluded:
            road.act(Exclude(1), item.host_ns)
    road.close()
    assert [line.count('"poke"') for line in read_outline(path_of(tmp_path / "s")) if "taken" in line] == [1, 1, 1]
    assert_same(load(tmp_path / "s"), road)
    assert road.snapshot().can_undo == "exclusion of poke 1"


def test_an_outline_is_read_in_one_piece(scene, tmp_path, monkeypatch):
    record(scene, tmp_path / "s", some_pokes(scene, 6)).close()
    monkeypatch.setattr(segment, "parts", lambda _: pytest.fail("the file was stepped through"))
    opened = []
    original = segment.open_chunk
    monkeypatch.setattr(segment, "open_chunk", lambda chunk: opened.append(chunk) or original(chunk))
    assert len(load(tmp_path / "s").session.contacts) == 6
    assert len(opened) == 1  # the segment's beginning, which says what it is


def test_a_damaged_outline_is_not_believed(scene, tmp_path):
    live = record(scene, tmp_path / "s", some_pokes(scene, 3))
    live.close()
    path = path_of(tmp_path / "s")
    whole = path.read_bytes()
    start, length = place_of(path)
    for at in range(start, start + length, 37):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 16]) + whole[at + 1 :])
        assert read_outline(path) is None
    loaded = load(tmp_path / "s")
    assert_same(loaded, live)


def test_a_damaged_end_is_not_believed(scene, tmp_path):
    live = record(scene, tmp_path / "s", some_pokes(scene, 2))
    live.close()
    path = path_of(tmp_path / "s")
    whole = path.read_bytes()
    start, length = place_of(path)
    told = list(read_outline(path))
    for at in range(start + length, len(whole)):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        back = read_outline(path)
        assert back is None or list(back) == told


def test_a_session_that_was_cut_off_has_none_and_loses_nothing(scene, tmp_path):
    live = record(scene, tmp_path / "s", some_pokes(scene, 3))
    killed(live)
    assert read_outline(path_of(tmp_path / "s")) is None
    loaded = load(tmp_path / "s")
    assert any("was not closed" in sentence for sentence in loaded.findings)
    assert len(loaded.session.contacts) == 3
    again = resume(tmp_path / "s")
    again.close()
    assert read_outline(path_of(tmp_path / "s", 2)) is not None
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


def test_other_programs_see_an_attachment(scene, tmp_path):
    record(scene, tmp_path / "s", some_pokes(scene, 1)).close()
    with path_of(tmp_path / "s").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        (attachment,) = reader.iter_attachments()
        assert reader.get_summary().statistics.attachment_count == 1
        assert list(reader.iter_messages(topics=["/session"]))
    assert (attachment.name, attachment.media_type) == (NAME, MEDIA_TYPE)


def test_an_outline_outlives_a_damaged_index(scene, tmp_path):
    """A segment that was torn behind its outline is closed anew, with it."""
    live = record(scene, tmp_path / "s", some_pokes(scene, 3))
    live.close()
    path = path_of(tmp_path / "s")
    start, length = place_of(path)
    told = list(read_outline(path))
    path.write_bytes(path.read_bytes()[: start + length + 40])
    resume(tmp_path / "s").close()
    assert list(read_outline(path)) == told
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert [one.name for one in reader.iter_attachments()] == [NAME]
        assert reader.get_summary().statistics.attachment_count == 1
    shutil.rmtree(tmp_path / "source")
    assert_same(load(tmp_path / "s"), replay(tmp_path / "s"))


def test_an_outline_that_no_reader_would_take_is_not_written(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(outline, "RECORD_LIMIT", 100)
    live = record(scene, tmp_path / "s", some_pokes(scene, 2))
    live.close()
    assert read_outline(path_of(tmp_path / "s")) is None
    assert_same(load(tmp_path / "s"), live)


def test_only_a_second_outcome_of_the_same_kind_takes_the_place_of_the_first():
    """What was a contact and is none any more leaves the steps of undo, so both are told."""
    contact, other = some_pokes(small_scene(), 1).run()
    rejection = Rejection(1, 0.0, 1.0, Reason.SLID, 1.0, 0.5, "", np.empty(0, dtype=np.int64), final=True)
    writer = OutlineWriter()
    writer.add(b"first", Taken([(contact, None)]))
    writer.add(b"second", Taken([(other, None)]))
    writer.add(b"dead", Taken([(other, None)], {3: "stuck"}))
    writer.add(b"both", Taken([(contact, None), (other, None)]))
    writer.add(b"event", None)
    writer.add(b"third", Taken([(other, None)]))
    writer.add(b"rejected", Taken([(rejection, None)]))
    lines = list(outline._lines(writer.finish()))
    assert lines == ["second\n", "dead\n", "both\n", "event\n", "third\n", "rejected\n"]
