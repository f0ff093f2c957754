"""Available corrections of sensor and arm, their words, and the Rig tab."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from app.panels.rig_panel import NO_LANDMARK_POKES, NO_LANDMARKS, REVIEW_RUNNING, RigPanel
from app.state.policies import RigReview, allowed, offers_of
from app.state.running import Running
from app.text.rig_text import (
    corrected_words,
    landmark_rows,
    moved_words,
    offer_news,
    offer_text,
    offer_words,
    review_words,
    rig_state,
)
from skincal.contacts.outcome import Reason
from skincal.following.review import Review
from skincal.geometry import FloatArray
from skincal.model.actions import Uncorrect
from skincal.model.scene import Landmark
from skincal.pokes import LandmarkPokes
from skincal.rig.correction import FRAME, RIG, Correction, UsedCorrection
from skincal.rig.correction_fit import RigAnswer
from skincal.rig.frame_check import FrameDiagnosis
from skincal.rig.scene_mistakes import Mistake, MistakeKind
from skincal.session.corrections import correction_of
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Method
from skincal.words.mistake_words import frame_sentence
from skincal.words.rig_words import correction_sentence, rig_sentences
from skincal.words.units import DASH
from tests.app.scene3d_support import decided, estimate
from tests.app.window_support import PLAN, arm_scene, context, frame, part, session, shown, slip, touch
from tests.approved import approved

CORNER, OTHER = (Landmark(name, np.array([x, 0.0, 0.0]), None) for name, x in (("corner", 0.03), ("other", -0.03)))
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
MATRIX = 1.02 * np.eye(6)
NOBODY = np.empty(0)
RIGHT = FrameDiagnosis(True, True, True, 0.0074, 0.0074, Mistake(MistakeKind.NONE))
WRONG = FrameDiagnosis(False, True, True, 0.051, 0.006, Mistake(MistakeKind.AXES, axes=TURN, moment_scale=1e-3))


def rig(*, used: bool = True, correction: Correction | None = None, distances: Mapping | None = None, doubted: float = 1.0):
    """An answer from six pokes; how much the last of them counts."""
    trust = dict.fromkeys(range(1, 7), 1.0) | {6: doubted}
    off = distances or dict.fromkeys(trust, 0.001)
    return RigAnswer(correction or Correction(MATRIX), used, 0.0074, 0.0012, 6, trust, off, NOBODY, NOBODY)


TOO_FEW = RigAnswer(None, False, float("nan"), float("nan"), 2, {1: 1.0, 2: 1.0}, {}, NOBODY, NOBODY)


def pokes_at_corner(count: int) -> LandmarkPokes:
    none = np.zeros((count, 3))
    poses, names = np.tile(np.eye(4), (count, 1, 1)), np.full(count, "corner")
    return LandmarkPokes(np.arange(1, count + 1), none - [0, 0, 9.0], none, poses, np.full(count, "low"), names, none)


def review(
    answer: RigAnswer | None = None,
    diagnosis: FrameDiagnosis | None = RIGHT,
    pokes: int = 6,
    reported: Mapping[int, float] | None = None,
    before: Mapping[Method, FloatArray] | None = None,
    after: Mapping[Method, FloatArray] | None = None,
) -> Review:
    return Review(pokes_at_corner(pokes), reported or {}, diagnosis, answer or rig(), PLAN.channels, before or {}, after or {})


def at(*used: UsedCorrection, known: Mapping | None = None, pokes=(), at_landmarks=None, excluded=()):
    """A session with these corrections in use."""
    made = session(1, known, pokes, excluded)
    corrections = {correction.of: correction for correction in used}
    there = replace(made, at_landmarks=at_landmarks or {})
    return decided(there, corrections=corrections, landmarks=(CORNER, OTHER))


def offers(answer: Review | None, moment: Snapshot):
    """What a review offers that was made of this very session."""
    return offers_of(None if answer is None else replace(answer, used=moment.decisions.corrections), moment)


def in_use(of: str = RIG, pokes: int = 6) -> UsedCorrection:
    return UsedCorrection(of, Correction(MATRIX), 0.0074, 0.0012, pokes)


# What is offered


def test_nothing_is_offered_before_a_review_or_from_too_few_pokes():
    assert offers(None, at()) == ()
    assert offers(review(TOO_FEW, None, 2), at()) == ()
    assert offers(review(TOO_FEW, RIGHT, 3), at()) == ()


def test_a_rig_is_offered_only_where_held_out_pokes_speak_for_it():
    (offer,) = offers(review(), at())
    assert offer_text(offer) == "Correct sensor and arm"
    assert "1.2 mm" in offer_words(offer)
    assert "from 7.4 to 1.2 mm" in offer_words(offer)
    action = offer.action
    assert (action.of, action.before, action.after, action.pokes) == (RIG, 0.0074, 0.0012, 6)
    np.testing.assert_array_equal(correction_of(action).matrix, MATRIX)
    assert offers(review(rig(used=False)), at()) == ()


def test_a_part_without_joints_is_offered_a_correction_of_its_sensor():
    moment, used = at(), at(in_use())
    answer = replace(review(), used=moment.decisions.corrections)
    (offer,) = offers_of(answer, moment, has_arm=False)
    said = (
        offer_text(offer),
        offer_words(offer),
        offer_news(offer),
        corrected_words(offer),
        rig_state((), (), None, has_arm=False),
    )
    words = review_words(replace(answer, used=used.decisions.corrections), used, Method.FREE, (), has_arm=False)
    assert [each for each in (*said, *words) if " arm" in each] == []
    assert offer_text(offer) == approved("rig.offer_sensor")


def test_the_frame_goes_first_with_its_misses():
    (offer,) = offers(review(diagnosis=WRONG), at())
    assert offer_text(offer) == approved("rig.offer_frame")
    assert offer_words(offer) == frame_sentence(WRONG, has_arm=True)
    action = offer.action
    assert (action.of, action.before, action.after, action.pokes) == (FRAME, 0.051, 0.006, 6)
    found = correction_of(action)
    np.testing.assert_array_equal(found.matrix, np.kron(np.diag([1.0, 1e-3]), TURN))
    (offer,) = offers(review(TOO_FEW, replace(WRONG, sure=False), 3), at())
    assert approved("sensor_frame.rival") in offer_words(offer)


def test_a_frame_found_under_another_builds_on_it():
    """What is offered replaces what is in use; under a corrected frame the check reports only what is left."""
    used = in_use(FRAME)
    (offer,) = offers(review(diagnosis=WRONG), at(used))
    found = np.kron(np.diag([1.0, 1e-3]), TURN)
    np.testing.assert_allclose(correction_of(offer.action).matrix, found @ used.correction.matrix, atol=1e-15)
    (offer,) = offers(review(), at(in_use(FRAME)))
    assert offer.action.of == RIG


def test_what_is_in_use_is_offered_again_only_from_more_pokes():
    assert offers(review(), at(in_use(pokes=6))) == ()
    for pokes in (5, 7):
        (offer,) = offers(review(pokes=pokes), at(in_use(pokes=6)))
        assert offer_text(offer) == approved("rig.offer_anew")
        assert offer.action.pokes == pokes
    (offer,) = offers(review(diagnosis=WRONG), at(in_use(pokes=6)))
    assert offer.action.of == FRAME, "a wrong frame is said whatever else is in use"


def test_the_key_does_what_is_offered_first():
    def may(offers):
        return allowed(at(), Running.STREAMING, (), None, None, offers).correct

    assert offer_text(may(offers(review(), at()))) == "Correct sensor and arm"
    assert offer_text(may(offers(review(diagnosis=WRONG), at()))) == approved("rig.offer_frame")
    assert may(()) is None


def test_an_offer_is_announced_once_and_made_once():
    rig_review, none = RigReview(), at()
    used = at(in_use())
    now, then = (replace(review(), used=moment.decisions.corrections) for moment in (none, used))
    assert (rig_review.offers(none), rig_review.news(none)) == ((), None)
    rig_review.review = now
    made = rig_review.offers(none)
    assert rig_review.offers(replace(none, generation=9)) is made
    news = offer_news(rig_review.news(none))
    assert offer_words(made[0]).startswith(approved("rig.correctable_begin"))
    assert news.startswith(approved("rig.correctable_begin"))
    assert " mm" not in news, "later landmark pokes change the numbers"
    assert approved("rig.offer_keys") in news
    assert rig_review.in_use(none) is now
    assert rig_review.in_use(used) is None, "it says nothing of a session that uses another correction"
    assert (rig_review.offers(used), rig_review.news(used)) == ((), None)
    rig_review.review = replace(now)
    assert rig_review.offers(none) is not made
    assert rig_review.news(none) is None, "it was said, and was taken back"
    rig_review.review = then
    assert rig_review.offers(used) == ()
    rig_review.review = replace(then, pokes=review(pokes=9).pokes)
    assert "C: apply" in offer_news(rig_review.news(used)), "another one is offered"


# What is said


@pytest.mark.parametrize(("of", "what"), [(RIG, "Sensor and arm"), (FRAME, "The sensor frame")])
def test_what_is_in_use_is_said_with_its_misses(of, what):
    words = correction_sentence(in_use(of, 21), has_arm=True)
    assert words.startswith(what)
    assert all(each in words for each in ("21", "1.2 mm", "7.4 mm"))
    assert ("left out of the fit" in words) == (of == RIG)


PLACES = np.tile([0.0, 0.0, 0.01], (24, 1))


def known(shift: Mapping[int, float]):
    """Estimates beside `PLACES`, by the channel."""
    return {channel: estimate(channel, PLACES[channel] + [aside, 0.0, 0.0]) for channel, aside in shift.items()}


def test_how_far_the_taxels_move_is_said_for_the_method_that_is_shown():
    moment = at(known=known({3: 0.002, 5: 0.004}))
    shown = moment.estimates[Method.FREE]
    assert moved_words(review(after={Method.FREE: PLACES}), Method.FREE, shown) == approved(
        "rig.would_move", mean_mm=3.0, most_mm=4.0
    )
    assert moved_words(review(before={Method.FREE: PLACES}), Method.FREE, shown) == approved(
        "rig.has_moved", mean_mm=3.0, most_mm=4.0
    )
    assert moved_words(review(after={Method.FREE: PLACES}), Method.SURFACE, shown) == ""
    assert moved_words(review(), Method.FREE, shown) == ""
    nowhere = PLACES.copy()
    nowhere[5] = np.nan
    assert approved("rig.moved_figures", mean_mm=2.0, most_mm=2.0) in moved_words(
        review(after={Method.FREE: nowhere}), Method.FREE, shown
    )
    assert moved_words(review(after={Method.FREE: np.full((24, 3), np.nan)}), Method.FREE, shown) == ""


def test_the_frame_is_said_first_and_what_is_in_use_takes_the_place_of_what_could_be():
    answer = review(rig(doubted=0.0, distances={6: 0.014}), after={Method.FREE: PLACES})
    moment = at(known=known({3: 0.002}))
    frame_, could, moved, doubt = review_words(answer, moment, Method.FREE, moment.estimates[Method.FREE])
    assert frame_ == frame_sentence(RIGHT, has_arm=True)
    assert could == rig_sentences(answer.rig, has_arm=True)[0]
    assert "would move" in moved
    assert doubt == approved("rig.poke_not_counted", poke=6, miss_mm=14)
    used = at(in_use(FRAME), in_use(RIG))
    assert review_words(answer, used, Method.FREE, ()) == (
        frame_sentence(RIGHT, has_arm=True),
        *(correction_sentence(in_use(each), has_arm=True) for each in (FRAME, RIG)),
        doubt,
    )
    few = review_words(review(TOO_FEW, None, 2), at(), Method.FREE, ())
    needs = approved("rig.pokes_needed", pokes=6, landmarks=4)
    assert few == (approved("rig.too_few", needs=needs, pokes=2, landmarks=2),)


# The list


def here(number: int, pose: str = "low"):
    return replace(touch(number), pose=pose)


def test_each_landmark_has_its_pokes_and_how_far_they_pass_it():
    pokes = (here(1), here(2, "high"), slip(3, Reason.NO_TAXEL), here(4), here(5))
    named = {1: "corner", 2: "corner", 3: "other", 4: "corner", 9: "other"}
    moment = at(pokes=pokes, at_landmarks=named, excluded=(4,))
    answer = review(rig(distances={1: 0.001, 2: 0.001, 4: 0.5}), reported={1: 0.003, 2: 0.004, 4: 0.5})
    first, second = landmark_rows(moment, answer, "low")
    assert first == ("corner", "1", "2", "3.5, corrected 1.0")
    assert second == ("other", "0", "1", DASH)
    useless = replace(answer, rig=replace(answer.rig, used=False))
    assert landmark_rows(moment, useless, "low")[0][3] == "3.5"
    assert [row[3] for row in landmark_rows(moment, None, "low")] == [DASH, DASH]
    only = landmark_rows(moment, review(TOO_FEW, reported={1: 0.003, 2: 0.004}), "low")
    assert only[0][3] == "3.5"
    assert landmark_rows(decided(moment, landmarks=()), answer, "low") == []


# The tab


@pytest.fixture
def panel(qtbot):
    return shown(qtbot, RigPanel(context(part(arm_scene()))), (430, 500))


def state_of(moment, answer=None, **changes):
    return replace(frame(moment, where=arm_scene(), **changes), review=answer, offers=offers(answer, moment))


def cells(panel) -> list[list[str]]:
    points = panel.points
    return [[points.topLevelItem(row).text(column) for column in range(4)] for row in range(points.topLevelItemCount())]


def test_the_tab_says_what_is_missing_and_lists_what_is_there(panel):
    panel.show_state(state_of(decided(at(), landmarks=())))
    assert panel.said.text() == NO_LANDMARKS
    assert not panel.points.isVisible()
    panel.show_state(state_of(replace(at(pokes=(here(1),), at_landmarks={1: "corner"}), generation=2)))
    assert panel.said.text() == REVIEW_RUNNING
    assert cells(panel) == [["corner", "1", "1", DASH], ["other", "0", "0", DASH]]
    panel.show_state(state_of(replace(decided(at(), landmarks=(OTHER,)), generation=3)))
    assert panel.said.text() == NO_LANDMARK_POKES
    assert cells(panel) == [["other", "0", "0", DASH]]
    assert not panel.offer.isVisible()
    assert not panel.drop.isVisible()


def test_the_buttons_use_what_is_offered_and_drop_what_was_used_last(qtbot, panel):
    answer = review()
    panel.show_state(state_of(at(), answer))
    assert panel.offer.text().startswith("Correct sensor and arm")
    assert panel.offer.isVisible()
    with qtbot.waitSignal(panel.command_wanted) as wanted:
        panel.offer.click()
    assert wanted.args == ["correct"]
    panel.show_state(state_of(replace(at(in_use(FRAME), in_use(RIG)), generation=2), answer))
    assert not panel.offer.isVisible()
    assert panel.drop.isVisible()
    for generation, used in ((2, (FRAME, RIG)), (3, (FRAME,))):
        panel.show_state(state_of(replace(at(*map(in_use, used)), generation=generation), answer))
        with qtbot.waitSignal(panel.action_wanted) as dropped:
            panel.drop.click()
        assert dropped.args == [Uncorrect(used[-1])]


def test_streamed_joints_that_name_the_same_pose_again_draw_nothing(panel, monkeypatch):
    drawn = []
    monkeypatch.setattr(panel, "_list_points", drawn.append)
    moment, answer = at(), review()
    for pose in ("low", "".join(["l", "ow"]), "high"):
        state = state_of(moment, answer)
        panel.show_state(replace(state, live=replace(state.live, pose=pose), offers=()))
    assert len(drawn) == 2
