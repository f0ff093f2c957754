"""A session loaded from what was made of its bytes is the one that was lived, and the one that is played again."""

import dataclasses
import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from skincal.cli import main
from skincal.contacts.detector import ContactDetector
from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.contacts.press import FinishedPress, StillMean
from skincal.contacts.tare import Tare
from skincal.journal.documents import (
    DetectorResult,
    LinkTotals,
    Totals,
    read_document,
    result_to_json,
)
from skincal.journal.reader import SessionLog
from skincal.journal.writer import create_session
from skincal.model.actions import Exclude, MarkDead, Revive, SetPose
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, Loss, Stream
from skincal.model.scene import load_scene, resource
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay, resume
from skincal.streams.links import LinkSpec
from tests.approved import approved, approved_pattern
from tests.build import feed, recording
from tests.skincal.journal.journal_support import assert_same
from tests.skincal.poke_script import (
    ANSWERS,
    LINKS,
    SPOTS,
    Script,
    as_chunks,
    killed,
    next_segment,
    skt_line,
    small_scene,
    some_pokes,
    torn,
    write_scene,
)

FORCE = np.array([1.0, 2.0, -8.0])


@pytest.fixture
def scene(tmp_path):
    return write_scene(tmp_path / "source")


def record(scene, folder, script, actions=(), links=LINKS, change=lambda items: items):
    return recording(scene, folder, as_chunks(script.samples), actions, links, change)


def test_several_segments(scene, tmp_path):
    folder = tmp_path / "s"
    record(scene, folder, some_pokes(scene, 2), [(0.9, Exclude(1))]).close()
    for seed in (7, 8):
        live = resume(folder)
        feed(live, as_chunks(some_pokes(scene, 2, seed).samples), [(0.5, Exclude(2 * seed - 11)), (0.7, MarkDead(seed))])
        live.close()
        assert_same(live, load(folder), replay(folder))
        assert live.totals() == load(folder).totals() == replay(folder).totals()
    assert [poke.outcome.poke for poke in live.snapshot().pokes] == [1, 2, 3, 4, 5, 6]
    assert live.totals().links[1].readings == 2 * len(some_pokes(scene, 2).samples) + len(some_pokes(scene, 2).samples)


def test_a_pause_and_a_new_start_of_the_program_are_the_same(scene, tmp_path):
    """What follows a break depends on the session alone: with the same bytes both ways give the same pokes."""
    first, then = as_chunks(some_pokes(scene, 2).samples), as_chunks(some_pokes(scene, 2, 9).samples)
    paused = Pipeline(scene, LINKS, None, create_session(tmp_path / "p", scene, LINKS))
    feed(paused, first)
    paused.close()
    shutil.copytree(tmp_path / "p", tmp_path / "r")
    paused.begin_segment(LINKS, next_segment(tmp_path / "p", scene, LINKS))
    started = resume(tmp_path / "r")
    for pipeline in (paused, started):
        feed(pipeline, then)
        pipeline.close()
    assert_same(paused, started, load(tmp_path / "p"), replay(tmp_path / "r"))


def crowded(scene, extra=20, count=14):
    """Pokes during which a far channel always answers, until it is found to be always on and the pokes are judged anew."""
    script = Script(scene, rng=np.random.default_rng(3), skin_noise=0.8).quiet(1.0)
    for k in range(count):
        script.press(FORCE, SPOTS[k % 3], ANSWERS[k % 3] | {extra: 60.0}, hold_s=0.4).quiet(0.6)
    return script


@pytest.mark.parametrize("way", ["found", "marked"])
def test_pokes_of_before_a_break_are_revised_after_it(scene, tmp_path, way):
    folder = tmp_path / "s"
    before = record(scene, folder, crowded(scene, count=2))
    before.close()
    assert [before.session.outcome(n).reason for n in (1, 2)] == [Reason.NOT_CONNECTED] * 2
    live = resume(folder)
    if way == "marked":
        live.act(MarkDead(20), 1)
    else:
        feed(live, as_chunks(crowded(scene).samples))
    assert all(isinstance(live.session.outcome(n), Contact) for n in (1, 2))
    live.close()
    assert_same(live, load(folder), replay(folder))
    again = load(folder)
    again.act(Revive(20), 2)
    assert isinstance(again.session.outcome(1), Rejection)


def test_a_dead_channel_stays_dead_after_a_break_until_it_shows_otherwise(scene, tmp_path):
    folder = tmp_path / "s"

    def silent(script):
        for sample in script.samples:
            sample.skin[5] = np.nan
        return script

    record(scene, folder, silent(Script(scene, skin_noise=1.0).quiet(4.0))).close()
    live = resume(folder)
    assert "no number" in live.session.dead[5]
    feed(live, as_chunks(silent(Script(scene, skin_noise=1.0).quiet(1.6)).samples))
    assert 5 in live.session.dead
    live.close()
    assert_same(live, load(folder), replay(folder))
    live = resume(folder)
    feed(live, as_chunks(Script(scene, skin_noise=1.0).quiet(3.0).samples))
    assert live.session.dead == {}
    live.close()
    assert_same(live, load(folder), replay(folder))


@pytest.mark.parametrize(
    ("why", "change"),
    [
        (approved("taxel.stuck", value=120), {}),
        (approved("taxel.always_on", count=5), {"quiet": True}),
    ],
)
def test_a_verdict_of_before_needs_new_evidence_to_fall(why, change):
    script = Script(small_scene(), skin_noise=1.0).quiet(3.0)
    detector = ContactDetector(script.scene, last_poke=4, dead={5: why})
    for sample in script.samples:
        if not change:
            sample.skin[5] = 120.0
        detector.feed(sample, np.eye(4), "")
    assert detector.dead == {5: why}
    script.samples.clear()
    for k in range(5 if change else 0):
        script.press(FORCE, SPOTS[k % 3], {k + 12: 80.0}).quiet(0.6)
    outcomes = [outcome for sample in script.quiet(2.0).samples for outcome in detector.feed(sample, np.eye(4), "")]
    assert detector.dead == {}
    assert not change or outcomes[0].poke == 5


def arm_scene(folder):
    scene = write_scene(folder)
    with scene.path.open("a") as file:
        file.write(
            "[arm]\njoints = [1, 2]\ndh = [[0.1, 0.0, 0.0, 0.0], [0.2, 0.0, 30.0, 0.0]]\n"
            "base_from_sensor = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
            "[arm.poses]\nup = [5, 10]\ndown = [25, 35]\n"
        )
    return load_scene(scene.path)


def test_arm_poses_chosen_and_streamed(tmp_path):
    scene = arm_scene(tmp_path / "source")
    links = (*LINKS, LinkSpec("joints", "file:none", (Stream.JOINTS,), "skt"))

    def with_joints(items):
        joints = [
            Chunk("joints", item.host_ns - 5_000_000, skt_line(f"J,{k & 0xFFFF},{k * 10_000},50.0,25.02,34.99,40.0"))
            for k, item in enumerate(items)
            if isinstance(item, Chunk) and item.link == "wrench"
        ]
        return sorted([*items, *joints], key=lambda item: item.host_ns)

    folder = tmp_path / "s"
    live = record(scene, folder, some_pokes(scene, 2), links=links, change=with_joints)
    live.close()
    assert_same(live, load(folder), replay(folder))
    live = resume(folder, LINKS)  # nothing streams any more
    assert live.live(0).link_from_sensor is None
    live.act(SetPose("up"), 5)
    feed(live, as_chunks(some_pokes(scene, 2, 9).samples), [(0.7, SetPose("down"))])
    live.close()
    assert [contact.pose for contact in live.session.contacts][:3] == ["down", "down", "up"]
    assert_same(live, load(folder), replay(folder))


@pytest.mark.parametrize("share", [0.35, 0.62, 0.81, 0.97])
def test_whatever_is_cut_off_loading_and_playing_agree(scene, tmp_path, share):
    """A session killed or torn anywhere, with bytes behind its last outcome: the same session both ways, also later on."""
    folder = tmp_path / "s"
    pipeline = record(scene, folder, some_pokes(scene, 5), [(0.5, Exclude(1)), (0.7, MarkDead(4))])
    whole = len(killed(pipeline).snapshot().pokes)
    torn(folder, round(share * (folder / "segment-0001.mcap").stat().st_size))
    loaded = load(folder)
    assert_same(loaded, replay(folder))
    assert 0 < len(loaded.snapshot().pokes) <= whole
    assert any("was not closed" in sentence for sentence in loaded.findings)
    live = resume(folder)
    assert all(poke.outcome.final for poke in live.snapshot().pokes)
    feed(live, as_chunks(some_pokes(scene, 2, 9).samples))
    assert len(live.snapshot().pokes) == len(loaded.snapshot().pokes) + 2
    live.close()
    assert_same(live, load(folder), replay(folder))


def test_a_recovered_segment_is_whole_for_other_programs(scene, tmp_path):
    folder = tmp_path / "s"
    killed(record(scene, folder, some_pokes(scene, 3)))
    path = folder / "segment-0001.mcap"
    beside = path.with_suffix(".jsonl")
    whole, lines = path.read_bytes(), beside.read_bytes()
    for cut in (len(whole), len(whole) - 3, len(whole) - 150, len(whole) // 2):
        path.write_bytes(whole)
        beside.write_bytes(lines)
        torn(folder, cut)
        before = list(SessionLog(folder).items())
        resume(folder).close()
        for second in folder.glob("segment-0002*"):
            second.unlink()
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            summary = reader.get_summary()
            messages = list(reader.iter_messages(log_time_order=False))
            assert [each.name for each in reader.iter_metadata()] == ["skincal"]
            skin = list(reader.iter_messages(topics=["/raw/skin"]))
        assert summary.statistics.message_count == len(messages) == sum(summary.statistics.channel_message_counts.values())
        assert len(skin) == sum(isinstance(item, Chunk) and item.link == "skin" for item in before)
        log = SessionLog(folder)
        assert list(log.items()) == before
        assert log.findings == ()


@pytest.mark.parametrize("name", ["scene.toml", "modules.toml"])
def test_a_changed_scene_is_not_answered_from_notes(scene, tmp_path, name):
    record(scene, tmp_path / "s", some_pokes(scene, 2)).close()
    path = tmp_path / "s" / "scene" / name
    if name == "scene.toml":
        path.write_text(path.read_text() + "[contacts]\nforce_min = 12.0\n")
    else:
        path.write_text(path.read_text().split("[[modules]]\nid = 1")[0])
    loaded = load(tmp_path / "s")
    assert any(approved("mesh.changed_after_recording") in sentence for sentence in loaded.findings)
    assert_same(loaded, replay(tmp_path / "s"))
    assert name == "modules.toml" or loaded.session.contacts == ()


def test_an_exchanged_mesh_is_said(tmp_path):
    scene = load_scene(resource("scenes/icub-forearm/scene.toml"))
    record(scene, tmp_path / "s", some_pokes(scene, 1)).close()
    assert load(tmp_path / "s").findings == ()
    mesh = tmp_path / "s" / "scene" / "forearm.obj"
    mesh.write_text(mesh.read_text() + "\n# other\n")
    assert any(approved("mesh.changed_after_recording") in sentence for sentence in load(tmp_path / "s").findings)


ODD = np.array([0.1, -0.0, 5e-324, 1.7976931348623157e308, math.nan, math.inf, -math.inf, 1 / 3])
MEASURED = np.array([1 / 3, 1e12, -5e-324])
"""Odd as well, but within what a session takes for measured."""


def odd_outcomes():
    tare = Tare(1 / 3, 0.1, 0.2, ODD[:6], np.arange(3.0))
    still = StillMean(0.1, 0.2, 0.15, ODD[:6], np.eye(4) / 3, "up", math.inf, math.nan)
    poke = FinishedPress(7, 0.1, 0.2, 0.02, 8.1, 0, 0.0, 0.0, tare, still, np.array([3, 9]), np.array([1 / 3, 2.0]))
    contact = Contact(
        7, 0.1, 1 / 3, ODD[:3], MEASURED, np.array([3, 9]), MEASURED[:2], np.eye(4) / 3, 'a "pose"\n', math.nan, final=False
    )
    rejection = Rejection(8, 0.1, 0.2, Reason.NOT_STILL, math.inf, -0.0, "1", np.empty(0, dtype=np.int64), final=True)
    unstill = dataclasses.replace(poke, still=None, channels=np.empty(0, dtype=np.int64), responses=np.empty(0))
    unposed = dataclasses.replace(poke, still=dataclasses.replace(still, link_from_sensor=None))
    presses = [(poke, tare), (unstill, None), (unposed, None)]
    return [contact, *(dataclasses.replace(rejection, press=press, tare_after=after) for press, after in presses)]


def deep_key(value):
    if dataclasses.is_dataclass(value) or isinstance(value, tuple):
        parts = value if isinstance(value, tuple) else [getattr(value, f.name) for f in dataclasses.fields(value)]
        left_out = 1 if isinstance(value, Tare) else 0  # the skin's baseline stays out
        return [deep_key(part) for part in list(parts)[: len(list(parts)) - left_out]]
    return np.asarray(value).tobytes() if isinstance(value, np.ndarray | float) else value


def back_from_json(result):
    return read_document(json.dumps(result_to_json(result), allow_nan=False).encode(), Path())


def test_every_bit_of_a_note_comes_back():
    taken = DetectorResult(odd_outcomes(), {5: "stuck", 3: "gives no number"})
    back = back_from_json(taken)
    assert [deep_key(entry) for entry in back.outcomes] == [deep_key(entry) for entry in taken.outcomes]
    assert list(back.dead.items()) == list(taken.dead.items())
    assert back.outcomes[0].channels.dtype == np.int64
    totals = Totals((LinkTotals("skin", "SKB/1", 9, {Loss.BAD_CHECKSUM: 2}),), 4)
    for note in (DetectorResult([]), totals):
        assert back_from_json(note) == note


def test_commands_say_the_same_from_notes_and_from_bytes_and_what_was_damaged(scene, tmp_path, capsys):
    killed(record(scene, tmp_path / "s", some_pokes(scene, 3), [(0.9, Exclude(1))]))
    assert main(["solve", str(tmp_path / "s"), "--json"]) == 0
    assert any("was not closed" in finding for finding in json.loads(capsys.readouterr().out)["findings"])
    assert main(["export", str(tmp_path / "s"), "--format", "csv", "--out", str(tmp_path / "c.csv")]) == 0
    assert "was not closed" in capsys.readouterr().out
    record(scene, tmp_path / "whole", some_pokes(scene, 3), [(0.9, Exclude(1))]).close()
    said = []
    for options in ([], ["--replay"]):
        assert main(["solve", str(tmp_path / "whole"), "--json", *options]) == 0
        said.append(json.loads(capsys.readouterr().out))
    assert said[0] == said[1]
    assert said[0]["links"]["skin"]["readings"] == len(some_pokes(scene, 3).samples)


def test_a_session_that_ships_is_not_gone_on_with():
    sample = resource("sessions/sample")
    before = sorted(sample.rglob("*"))
    with pytest.raises(InputError, match=approved_pattern("session.ships", folder=sample)):
        resume(sample)
    assert main(["landmarks", str(sample), "--add", "tip", "0", "0", "0"]) == 2
    assert sorted(sample.rglob("*")) == before
