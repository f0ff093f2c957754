"""The course of errors: the same live, opened again, in pieces and after an undo; nothing of it is averaged."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skincal.contacts.outcome import Contact
from skincal.files.reference import Origin, error_summary, find_truth, load_reference, plan_reference
from skincal.following.error_history import (
    ERROR_HISTORY_MAX_POINTS,
    MAX,
    MEAN,
    P95,
    SHOWN_PAUSE_MAX_S,
    TAXELS,
    ErrorCourse,
    poking_times,
    spreads_of,
    stride_of,
)
from skincal.model.actions import Exclude, MarkDead, Restore, Revive, Undo
from skincal.model.errors import InputError
from skincal.model.scene import resource
from skincal.rig.correction import RIG, Correction, RigPrior, UsedCorrection
from skincal.session.corrections import correct_action
from skincal.session.replay import load
from skincal.session.session import Session
from skincal.taxels.result import Method
from tests.approved import approved_pattern
from tests.build import session_of
from tests.skincal.poke_script import error_series

POKES = 14


@pytest.fixture(scope="module")
def sample():
    """A recorded session: its pipeline, the truth, and its first contacts."""
    folder = resource("sessions/sample")
    pipeline = load(folder)
    truth = find_truth(folder, pipeline.scene.link, pipeline.session.channels)
    return pipeline, truth, pipeline.session.contacts[:POKES]


def poked(pipeline, contacts) -> Session:
    return session_of(contacts, pipeline.scene, pipeline.session.surface)


def history_of(pipeline, truth) -> ErrorCourse:
    return ErrorCourse(pipeline.scene, pipeline.session.surface, None if truth is None else truth.places)


def whole(session, truth):
    """The course of a session at once."""
    return error_series(session.scene, session.surface, session.snapshot(), None if truth is None else truth.places)


def finish(history: ErrorCourse):
    while history.missing:
        assert history.add_points(*history.work(0.0))
    return history.series()


def same(one, other) -> bool:
    return (
        np.array_equal(one.counts, other.counts)
        and np.array_equal(one.pokes, other.pokes)
        and np.array_equal(one.times, other.times)
        and all(np.array_equal(one.spreads[m], other.spreads[m], equal_nan=True) for m in (Method.FREE, Method.SURFACE))
        and (one.stride, one.missing) == (other.stride, other.missing)
    )


def test_each_point_is_the_summary_of_a_session_that_ended_there_and_of_each_module(sample):
    pipeline, truth, contacts = sample
    series = whole(poked(pipeline, contacts), truth)
    assert series.counts.tolist() == list(range(1, POKES + 1))
    assert (series.stride, series.missing) == (1, 0)
    assert series.pokes.tolist() == [contact.poke for contact in contacts]
    for count in (1, 5, POKES):
        snapshot = poked(pipeline, contacts[:count]).snapshot()
        for method in (Method.FREE, Method.SURFACE):
            for row, channels in enumerate((None, *(module.channels for module in pipeline.scene.skin.layout.modules))):
                inside = [each for each in snapshot.estimates[method] if channels is None or each.channel in channels]
                summary, point = error_summary(inside, truth.places), series.spreads[method][count - 1, row]
                assert point[TAXELS] == (0 if summary is None else summary.taxels)
                if summary is not None:
                    assert point[[MEAN, P95, MAX]] == pytest.approx([summary.mean, summary.p95, summary.max], rel=1e-12)
        predicted = [each.rms for each in snapshot.estimates[Method.SURFACE] if each.rms is not None]
        own = whole(poked(pipeline, contacts[:count]), None).spreads[Method.SURFACE][-1, 0]
        assert own[[MEAN, MAX]] == pytest.approx([np.mean(predicted), max(predicted)]), "without a reference"
    empty = whole(poked(pipeline, ()), truth)
    assert (len(empty.counts), len(empty.times), empty.missing) == (0, 0, 0)


def test_followed_live_opened_late_and_in_pieces_it_is_the_same_to_the_last_bit(sample):
    pipeline, truth, contacts = sample
    live, session = history_of(pipeline, truth), Session(pipeline.scene, pipeline.session.surface)
    for contact in contacts:
        # As the detector gives them: once at the release, and again when the tare after it is known.
        session.add(replace(contact, moment=contact.moment * 1.01, final=False))
        live.update(session.snapshot())
        session.add(contact)
        live.update(session.snapshot())
        assert not live.missing
    late = history_of(pipeline, truth)
    late.update(session.snapshot())
    assert late.series().missing == POKES - 1
    assert same(live.series(), whole(session, truth))
    assert same(finish(late), whole(session, truth))


def test_an_undo_drops_the_end_and_an_exclusion_rewrites_what_follows(sample):
    pipeline, truth, contacts = sample
    history, session = history_of(pipeline, truth), poked(pipeline, contacts)
    history.update(session.snapshot())
    before = finish(history)
    session.act(Undo())
    history.update(session.snapshot())
    assert not history.missing
    assert same(
        history.series(),
        whole(poked(pipeline, contacts[:-1]), truth),
    )
    session.act(Restore(contacts[-1].poke))
    session.act(Exclude(contacts[3].poke))
    history.update(session.snapshot())
    after = finish(history)
    assert contacts[3].poke not in after.pokes
    left_out = (*contacts[:3], *contacts[4:])
    assert same(after, whole(poked(pipeline, left_out), truth))
    session.act(Restore(contacts[3].poke))
    history.update(session.snapshot())
    assert same(finish(history), before)


def test_a_taxel_that_is_not_used_leaves_the_whole_course(sample):
    pipeline, truth, contacts = sample
    history, session = history_of(pipeline, truth), poked(pipeline, contacts)
    history.update(session.snapshot())
    before = finish(history)
    dead = int(contacts[0].channels[0])
    session.act(MarkDead(dead))
    history.update(session.snapshot())
    assert finish(history).spreads[Method.SURFACE][0, 0, TAXELS] == before.spreads[Method.SURFACE][0, 0, TAXELS] - 1
    session.act(Revive(dead))
    history.update(session.snapshot())
    assert same(finish(history), before)


CHANGES = {
    "a poke before it was excluded": (lambda session, contacts: session.act(Exclude(contacts[0].poke)), False),
    "another poke came": (lambda session, contacts: session.add(contacts[-1]), True),
    "the last poke was reported again": (lambda session, contacts: session.add(contacts[-2]), True),
    "an earlier poke was reported again": (lambda session, contacts: session.add(contacts[1]), False),
}


@pytest.mark.parametrize("change", CHANGES)
def test_work_under_way_counts_as_far_as_it_still_holds(sample, change):
    pipeline, truth, contacts = sample
    history, session = history_of(pipeline, truth), poked(pipeline, contacts[:-1])
    for each in (contacts[1], contacts[-2]):
        session.add(replace(each, moment=each.moment * 1.01, final=False))
    history.update(session.snapshot())
    solved = history.work()
    do, holds = CHANGES[change]
    do(session, contacts)
    history.update(session.snapshot())
    history.add_points(*solved)
    assert (5 in history.series().counts.tolist()) == holds
    assert same(finish(history), whole(session, truth))


def test_recounted_points_carry_what_the_correction_in_use_does_not_know(sample):
    """Both kinds of points predict an error by the same definition, so the course has no jump at its end."""
    pipeline, _, contacts = sample
    correction = Correction(np.eye(6), np.eye(4), {}, np.diag(0.3 * RigPrior().scales(0)))
    session = poked(pipeline, contacts)
    session.act(correct_action(UsedCorrection(RIG, correction, 0.01, 0.001, 20)))
    live, late = history_of(pipeline, None), history_of(pipeline, None)
    for contact in contacts:
        session.act(Exclude(contact.poke))
    for contact in contacts:
        session.act(Restore(contact.poke))
        live.update(session.snapshot())
    late.update(session.snapshot())
    assert same(finish(late), live.series())
    plain = whole(poked(pipeline, contacts), None)
    assert (live.series().spreads[Method.SURFACE][5:, 0, MEAN] > 1.05 * plain.spreads[Method.SURFACE][5:, 0, MEAN]).all()


def test_thinning_keeps_every_nth_poke_and_the_newest_as_they_were(sample, monkeypatch):
    pipeline, truth, contacts = sample
    monkeypatch.setattr("skincal.following.error_history.ERROR_HISTORY_MAX_POINTS", 4)
    live, session = history_of(pipeline, truth), Session(pipeline.scene, pipeline.session.surface)
    for contact in contacts:
        session.add(contact)
        live.update(session.snapshot())
    late = whole(session, truth)
    monkeypatch.undo()
    full = whole(session, truth)
    assert late.stride == 4
    assert late.counts.tolist() == [4, 8, 12, 14]
    assert np.array_equal(live.series().counts, late.counts)
    for method in late.spreads:
        assert np.array_equal(late.spreads[method], full.spreads[method][late.counts - 1], equal_nan=True)
        assert np.array_equal(live.series().spreads[method], late.spreads[method], equal_nan=True)


@given(st.integers(0, 10**6))
def test_a_course_has_at_most_a_few_hundred_points(count):
    assert count / stride_of(count) <= ERROR_HISTORY_MAX_POINTS
    assert stride_of(count) == 1 or count / stride_of(count) > ERROR_HISTORY_MAX_POINTS / 2


@given(st.lists(st.tuples(st.floats(0, 1), st.integers(-1, 3)), max_size=40))
def test_spreads_are_those_of_numpy(pairs):
    errors = np.array([error for error, _ in pairs], dtype=float)
    groups = np.array([group for _, group in pairs], dtype=np.int64)
    found = spreads_of(errors, groups, 4)
    for group in range(4):
        inside = errors[groups == group]
        assert found[group, TAXELS] == len(inside)
        if len(inside):
            wanted = [inside.mean(), np.percentile(inside, 95), inside.max()]
            assert found[group, MEAN:] == pytest.approx(wanted, rel=1e-12, abs=1e-300)
        else:
            assert np.isnan(found[group, MEAN:]).all()


def test_time_never_runs_backwards_and_a_night_counts_a_minute():
    times = poking_times([100.0, 103.0, 103.0 + 8 * 3600, 5.0, 9.0])
    assert times.tolist() == [0.0, 3.0, 3.0 + SHOWN_PAUSE_MAX_S, 3.0 + SHOWN_PAUSE_MAX_S, 7.0 + SHOWN_PAUSE_MAX_S]
    assert len(poking_times([])) == 0


def test_a_reference_says_what_it_is_and_is_of_this_part(sample, tmp_path):
    pipeline, truth, _ = sample
    assert (truth.origin, truth.name) == (Origin.TRUTH, "truth.json")
    channels = pipeline.session.channels
    path = tmp_path / "places.json"
    taxel = {"channel": int(channels[0]), "position_m": [0.0, 0.1, 0.2]}
    path.write_text(json.dumps({"link": pipeline.scene.link, "taxels": [taxel]}))
    chosen = load_reference(path, pipeline.scene.link, channels)
    assert (chosen.origin, chosen.name, list(chosen.places)) == (Origin.FILE, "places.json", [channels[0]])
    with pytest.raises(InputError, match=approved_pattern("errors.other_link_clause")):
        load_reference(path, "another_link", channels)
    path.write_text(json.dumps({"taxels": [{**taxel, "channel": 100_000}]}))
    with pytest.raises(InputError, match="knows none"):
        load_reference(path, pipeline.scene.link, channels)
    assert find_truth(tmp_path, pipeline.scene.link, channels) is None


def test_a_plan_is_called_a_plan_and_leaves_out_what_it_does_not_place():
    places = np.full((4, 3), np.nan)
    assert plan_reference("part", places) is None
    places[2] = 0.1, 0.2, 0.3
    plan = plan_reference("part", places)
    assert plan.origin is Origin.PLAN
    assert {channel: place.tolist() for channel, place in plan.places.items()} == {2: [0.1, 0.2, 0.3]}


def test_places_of_channels_that_the_skin_does_not_have_are_passed_over(sample):
    pipeline, truth, contacts = sample
    more = {**truth.places, 100_000: np.zeros(3)}
    session = poked(pipeline, contacts[:3])
    assert isinstance(contacts[0], Contact)
    one = error_series(pipeline.scene, pipeline.session.surface, session.snapshot(), more)
    assert same(one, whole(session, truth))
