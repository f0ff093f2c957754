"""Thresholds that are changed in a session: what they judge, and that every way to open it gives the same numbers."""

import dataclasses
import json

import pytest

from skincal.cli import main
from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.journal.documents import Taken, from_document, note_to_json
from skincal.journal.writer import create_session
from skincal.model.actions import MarkDead, Redo, SetThresholds, Undo, from_json, to_json
from skincal.model.errors import InputError
from skincal.model.scene import ContactSettings
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay, resume
from skincal.session.session import Session
from tests.skincal.poke_script import (
    LINKS,
    as_chunks,
    killed,
    outcome_key,
    same_estimates,
    small_scene,
    some_pokes,
    write_scene,
)

HARDER = SetThresholds(("force_min",), (12.0,))
POKES = 8


@pytest.fixture
def scene(tmp_path):
    return write_scene(tmp_path / "source")


def feed(pipeline, items, actions=()):
    """Give a pipeline items; each action is done behind the item that it names."""
    due = dict(actions)
    for k, item in enumerate(items):
        pipeline.feed(item)
        if k in due:
            pipeline.act(due[k], item.host_ns)
    return pipeline


def recorded(scene, folder, items, actions):
    return feed(Pipeline(scene, LINKS, None, create_session(folder, scene, LINKS)), items, actions)


def keys(pipeline):
    return [outcome_key(record.outcome) for record in pipeline.snapshot().pokes]


def reasons(pipeline):
    return [getattr(record.outcome, "reason", None) for record in pipeline.snapshot().pokes]


def between(script, share):
    """The item at this share of the pokes' time, in the quiet between two pokes."""
    return round(share * len(as_chunks(script.samples)))


def test_thresholds_changed_at_the_start_are_those_of_a_scene_that_has_them():
    """By another route: the scene itself has them, and nothing is changed."""
    changed = ContactSettings(force_min=7.9, pitch_max=0.004, still_s=0.2, taxels_max=1, response_min=45.0, quiet_s=0.3)
    names = ("force_min", "pitch_max", "still_s", "taxels_max", "response_min", "quiet_s")
    action = SetThresholds(names, tuple(float(getattr(changed, name)) for name in names))
    items = as_chunks(some_pokes(small_scene(), POKES).samples)
    plain, other = small_scene(), small_scene(settings=changed)
    by_action, by_scene = Pipeline(plain, LINKS, None), feed(Pipeline(other, LINKS, None), items)
    by_action.act(action, 0)
    feed(by_action, items)
    assert by_action.session.decisions.thresholds == changed
    assert keys(by_action) == keys(by_scene)
    assert same_estimates(by_action.snapshot(), by_scene.snapshot())
    found = set(reasons(by_scene))
    assert None in found
    assert len(found) > 1
    assert reasons(feed(Pipeline(plain, LINKS, None), items)) != reasons(by_scene)


def test_only_pokes_that_begin_later_are_judged_by_them(scene):
    script = some_pokes(scene, POKES)
    items = as_chunks(script.samples)
    at = len(items) // 2
    pipeline = feed(Pipeline(scene, LINKS, None), items, [(at, HARDER)])
    when = items[at].host_ns * 1e-9
    for record in pipeline.snapshot().pokes:
        outcome = record.outcome
        assert isinstance(outcome, Rejection if outcome.start_s > when else Contact)
        if isinstance(outcome, Rejection):
            assert (outcome.reason, outcome.limit) == (Reason.TOO_SOFT, 12.0)
    assert {type(record.outcome) for record in pipeline.snapshot().pokes} == {Contact, Rejection}


def test_a_poke_in_progress_keeps_those_that_held_as_it_began(scene):
    script = some_pokes(scene, 3)
    items = as_chunks(script.samples)
    whole = feed(Pipeline(scene, LINKS, None), items)
    second = whole.snapshot().pokes[1].outcome
    inside = next(k for k, item in enumerate(items) if item.host_ns * 1e-9 > second.start_s)
    changed = feed(Pipeline(scene, LINKS, None), items, [(inside, HARDER)])
    assert reasons(changed) == [None, None, Reason.TOO_SOFT]
    assert keys(changed)[:2] == keys(whole)[:2]


def test_played_loaded_and_taken_up_sessions_are_the_one_that_was_lived(scene, tmp_path):
    items = as_chunks(some_pokes(scene, POKES).samples)
    at = [round(share * len(items)) for share in (0.2, 0.35, 0.5, 0.65, 0.8)]
    back = SetThresholds()
    actions = [HARDER, Undo(), Redo(), back, SetThresholds(("taxels_max", "still_change"), (2.0, 0.04))]
    live = recorded(scene, tmp_path / "s", items, list(zip(at, actions, strict=True)))
    live.close()
    assert {None, Reason.TOO_SOFT, Reason.TOO_MANY_TAXELS} <= set(reasons(live))
    for other in (replay(tmp_path / "s"), load(tmp_path / "s"), resume(tmp_path / "s")):
        assert not other.findings
        assert keys(other) == keys(live)
        assert same_estimates(other.snapshot(), live.snapshot())
        assert (
            other.session.decisions.thresholds
            == live.session.decisions.thresholds
            == ContactSettings(taxels_max=2, still_change=0.04)
        )
        other.close()


def test_what_is_recorded_after_a_kill_is_judged_by_them_too(scene, tmp_path):
    script = some_pokes(scene, POKES)
    items = as_chunks(script.samples)
    at = len(items) // 2
    live = recorded(scene, tmp_path / "s", items[: at + 1], [(at - 1, HARDER)])
    killed(live)
    again = resume(tmp_path / "s")
    feed(again, items[at + 1 :])
    again.close()
    late = [reason for reason, record in zip(reasons(again), again.snapshot().pokes, strict=True) if record.outcome.poke > 5]
    assert late
    assert set(late) == {Reason.TOO_SOFT}
    assert keys(replay(tmp_path / "s")) == keys(again)


def test_solve_honours_them(scene, tmp_path, capsys):
    items = as_chunks(some_pokes(scene, POKES).samples)
    recorded(scene, tmp_path / "s", items, [(2, HARDER)]).close()
    assert main(["solve", str(tmp_path / "s"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["accepted"] == 0
    main(["export", str(tmp_path / "s"), "--format", "json", "--out", str(tmp_path / "file.json")])
    exported = json.loads((tmp_path / "file.json").read_text())["contact_settings"]
    assert exported["force_min_N"] == 12.0


def test_a_crowded_poke_is_judged_again_by_those_of_its_time(scene, tmp_path):
    """A channel that turns out dead has rejected pokes judged again: by the thresholds under which they were made."""
    script = some_pokes(scene, POKES)
    items = as_chunks(script.samples)
    crowd = SetThresholds(("taxels_max",), (2.0,))
    at = len(items) // 2
    actions = [(2, crowd), (at, HARDER), (len(items) - 2, MarkDead(1))]
    live = recorded(scene, tmp_path / "s", items, actions)
    live.close()
    # Of three taxels two are left: enough, though by the last thresholds the force would be too small.
    before = reasons(feed(Pipeline(scene, LINKS, None), items, actions[:2]))
    assert before[1] is Reason.TOO_MANY_TAXELS
    assert reasons(live)[1] is None
    assert keys(replay(tmp_path / "s")) == keys(load(tmp_path / "s")) == keys(live)


def test_a_doubt_comes_back_with_its_thresholds(scene):
    script = some_pokes(scene, 3)
    pipeline = Pipeline(scene, LINKS, None)
    pipeline.act(SetThresholds(("taxels_max", "pitch_max"), (2.0, 0.0071)), 0)
    feed(pipeline, as_chunks(script.samples))
    outcome = pipeline.snapshot().pokes[1].outcome
    doubt = pipeline._detector.doubt(outcome)
    document = json.loads(json.dumps(note_to_json(Taken([(outcome, doubt)]))))
    ((_, read),) = from_document(document, scene.path).outcomes
    assert read.poke.thresholds == doubt.poke.thresholds == ContactSettings(taxels_max=2, pitch_max=0.0071)
    del document["outcomes"][0]["doubt"]["poke"]["thresholds"]
    ((_, old),) = from_document(document, scene.path).outcomes
    assert old.poke.thresholds is None
    document["outcomes"][0]["doubt"]["poke"]["thresholds"] = {"taxels_max": -3}
    with pytest.raises(InputError, match="taxels_max"):
        from_document(document, scene.path)


@pytest.mark.parametrize(
    ("names", "values", "what"),
    [
        (("force_least",), (4.0,), "force_least"),
        (("force_min",), (-4.0,), "above 0"),
        (("force_min",), (float("nan"),), "above 0"),
        (("force_max",), (float("inf"),), "to 1e.06"),
        (("still_s",), (61.0,), "to 60"),
        (("taxels_max",), (2.5,), "whole number"),
        (("force_min",), (15.0,), "rise"),
        (("touch_force", "touch_force"), (1.0, 1.1), "each name once"),
        (("touch_force",), (), "a value each"),
        ((), (), "in use already"),
        (("force_min",), (4.0,), "in use already"),
    ],
)
def test_what_no_rig_has_is_refused_and_changes_nothing(names, values, what):
    session = Session(small_scene(), None)
    before = session.snapshot()
    with pytest.raises(InputError, match=what):
        session.act(SetThresholds(names, values))
    assert session.decisions.thresholds == ContactSettings()
    assert session.snapshot() is before


def test_undo_redo_and_the_way_back_to_the_scene():
    session = Session(small_scene(settings=ContactSettings(force_max=20.0)), None)
    session.act(HARDER)
    session.act(SetThresholds(("force_max",), (13.0,)))
    assert session.decisions.thresholds == ContactSettings(force_max=13.0)
    assert session.snapshot().decisions.thresholds is session.decisions.thresholds
    session.act(Undo())
    assert session.decisions.thresholds == ContactSettings(force_min=12.0, force_max=20.0)
    assert session.snapshot().can_redo == "change of thresholds"
    session.act(Redo())
    session.act(SetThresholds())
    assert session.decisions.thresholds == ContactSettings(force_max=20.0)
    assert session.snapshot().can_undo == "return to the scene's thresholds"


def test_the_action_comes_back_from_json():
    for action in (HARDER, SetThresholds()):
        assert from_json(json.loads(json.dumps(to_json(action)))) == action
    with pytest.raises(InputError, match="expected"):
        from_json({"do": "set_thresholds", "names": ["force_min"], "values": ["4"]})
    assert all(field.default is not dataclasses.MISSING for field in dataclasses.fields(SetThresholds))
