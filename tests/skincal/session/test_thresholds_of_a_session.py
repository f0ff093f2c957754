"""Thresholds that are changed in a session: what they judge, and that every way to open it gives the same numbers."""

import json

import pytest

from skincal.cli import main
from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.journal.documents import DetectorResult, read_document, result_to_json
from skincal.model.actions import MarkDead, Redo, SetThresholds, Undo
from skincal.model.errors import InputError
from skincal.model.scene import ContactSettings
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay, resume
from tests.build import feed, recording
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


@pytest.fixture
def items(scene):
    return as_chunks(some_pokes(scene, POKES).samples)


def fed(scene, items, actions=()):
    return feed(Pipeline(scene, LINKS, None), items, actions)


def keys(pipeline):
    return [outcome_key(record.outcome) for record in pipeline.snapshot().pokes]


def reasons(pipeline):
    return [getattr(record.outcome, "reason", None) for record in pipeline.snapshot().pokes]


def test_thresholds_changed_at_the_start_are_those_of_a_scene_that_has_them(items):
    """By another route: the scene itself has them, and nothing is changed."""
    changed = ContactSettings(force_min=7.9, pitch_max=0.004, still_s=0.2, taxels_max=1, response_min=45.0, quiet_s=0.3)
    names = ("force_min", "pitch_max", "still_s", "taxels_max", "response_min", "quiet_s")
    by_action, by_scene = Pipeline(small_scene(), LINKS, None), fed(small_scene(settings=changed), items)
    by_action.act(SetThresholds(names, tuple(float(getattr(changed, name)) for name in names)), 0)
    feed(by_action, items)
    assert by_action.session.decisions.thresholds == changed
    assert keys(by_action) == keys(by_scene)
    assert same_estimates(by_action.snapshot(), by_scene.snapshot())
    assert None in reasons(by_scene)
    assert len(set(reasons(by_scene))) > 1
    assert reasons(fed(small_scene(), items)) != reasons(by_scene)


def test_only_pokes_that_begin_later_are_judged_by_them(scene, items):
    at = len(items) // 2
    pipeline, when = fed(scene, items, [(at, HARDER)]), items[at].host_ns * 1e-9
    for record in pipeline.snapshot().pokes:
        outcome = record.outcome
        assert isinstance(outcome, Rejection if outcome.start_s > when else Contact)
        if isinstance(outcome, Rejection):
            assert (outcome.reason, outcome.limit) == (Reason.TOO_SOFT, 12.0)
    assert {type(record.outcome) for record in pipeline.snapshot().pokes} == {Contact, Rejection}
    # A poke in progress keeps those that held as it began.
    second = pipeline.snapshot().pokes[1].outcome
    inside = next(k for k, item in enumerate(items) if item.host_ns * 1e-9 > second.start_s)
    assert reasons(fed(scene, items, [(inside, HARDER)])) == [None, None] + [Reason.TOO_SOFT] * (POKES - 2)


def test_played_loaded_and_resumed_sessions_are_the_live_one(scene, items, tmp_path, capsys):
    actions = [HARDER, Undo(), Redo(), SetThresholds(), SetThresholds(("taxels_max", "still_change"), (2.0, 0.04))]
    live = recording(scene, tmp_path / "s", items, list(zip((0.2, 0.35, 0.5, 0.65, 0.8), actions, strict=True)))
    live.close()
    assert {None, Reason.TOO_SOFT, Reason.TOO_MANY_TAXELS} <= set(reasons(live))
    for other in (replay(tmp_path / "s"), load(tmp_path / "s"), resume(tmp_path / "s")):
        assert (other.findings, keys(other)) == ((), keys(live))
        assert same_estimates(other.snapshot(), live.snapshot())
        assert other.session.decisions.thresholds == live.session.decisions.thresholds
        other.close()
    assert live.session.decisions.thresholds == ContactSettings(taxels_max=2, still_change=0.04)
    main(["export", str(tmp_path / "s"), "--format", "json", "--out", str(tmp_path / "file.json")])
    assert json.loads((tmp_path / "file.json").read_text())["contact_settings"]["taxels_max"] == 2
    capsys.readouterr()


def test_what_is_recorded_after_a_kill_is_judged_by_them_too(scene, items, tmp_path):
    at = len(items) // 2
    killed(recording(scene, tmp_path / "s", items[: at + 1], [(at - 1, HARDER)]))
    again = feed(resume(tmp_path / "s"), items[at + 1 :])
    again.close()
    late = {reason for reason, record in zip(reasons(again), again.snapshot().pokes, strict=True) if record.outcome.poke > 5}
    assert late == {Reason.TOO_SOFT}
    assert keys(replay(tmp_path / "s")) == keys(again)


def test_a_crowded_poke_is_judged_again_by_those_of_its_time(scene, items, tmp_path):
    """A channel that turns out dead has rejected pokes judged again: by the thresholds under which they were made."""
    actions = [(2, SetThresholds(("taxels_max",), (2.0,))), (len(items) // 2, HARDER), (len(items) - 2, MarkDead(1))]
    live = recording(scene, tmp_path / "s", items, actions)
    live.close()
    # Of three taxels two are left: enough, though by the last thresholds the force would be too small.
    assert reasons(fed(scene, items, actions[:2]))[1] is Reason.TOO_MANY_TAXELS
    assert reasons(live)[1] is None
    assert keys(replay(tmp_path / "s")) == keys(load(tmp_path / "s")) == keys(live)


def test_a_doubt_comes_back_with_its_thresholds(scene):
    pipeline = Pipeline(scene, LINKS, None)
    pipeline.act(SetThresholds(("taxels_max", "pitch_max"), (2.0, 0.0071)), 0)
    outcome = feed(pipeline, as_chunks(some_pokes(scene, 3).samples)).snapshot().pokes[1].outcome
    document = result_to_json(DetectorResult([outcome]))

    def read_back():
        (read,) = read_document(json.dumps(document).encode(), scene.path).outcomes
        return read.press.thresholds

    assert read_back() == outcome.press.thresholds == ContactSettings(taxels_max=2, pitch_max=0.0071)
    stored = document["outcomes"][0]["doubt"]["poke"]
    stored["thresholds"] = {"taxels_max": -3}
    with pytest.raises(InputError, match="taxels_max"):
        read_back()
    del stored["thresholds"]
    assert read_back() is None
