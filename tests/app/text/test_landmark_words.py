"""Which pokes were at the landmark that the window asks for, and what it says of the landmarks; without a window."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.sound.cues import CueMemory, DueCue, due_cue
from app.state.policies import allowed
from app.state.running import Running
from app.text.guidance_text import gain_words, landmark_words, target_words, why_words
from app.text.now_text import NowMemory, Said, Tone, now_line
from skincal.contacts.outcome import Reason, Rejection
from skincal.following.session_guide import LandmarkGuide, SessionGuide, plan_of
from skincal.guide import guidance as landmarks_module
from skincal.guide.believed_positions import PlannedPlaces
from skincal.guide.guidance import GuidePhase, LandmarkTarget
from skincal.model.actions import FoundAtLandmark
from skincal.model.scene import Landmark
from skincal.part.part import Part
from skincal.pokes import NO_LANDMARK_POKES
from skincal.rig.expected_gain import Gain
from skincal.session.landmark_pokes import VISUAL_REACTION_TIME_S, LandmarkFinder, landmark_pokes
from skincal.session.snapshot import PokeRecord, Snapshot
from skincal.taxels.result import Method
from skincal.words.poke_words import REASON_WORDS
from tests.app.guide_support import guidance, target
from tests.app.scene3d_support import decided, laid
from tests.app.window_support import NAMES, PLAN, arm_scene, frame, part, session, slip, touch
from tests.approved import approved

UP = np.array([0.0, 0.0, 1.0])
CORNER, OTHER, SIDE = (
    Landmark(name, np.array(place), UP)
    for name, place in (("corner", (0.036, 0.036, 0.0)), ("other", (-0.036, -0.036, 0.0)), ("side", (-0.036, 0.036, 0.0)))
)
POINTS = (CORNER, OTHER, SIDE)


@pytest.fixture(autouse=True)
def three_are_enough(monkeypatch):
    """Three landmarks stand for as many as a correction takes: with four each case is longer and says the same."""
    monkeypatch.setattr(landmarks_module, "MIN_LANDMARKS", 3)


def of_pokes(*pokes, at=None, points=POINTS, excluded=()) -> Snapshot:
    """A session with these pokes, of which `at` are at landmarks: number to name."""
    made = session(len(pokes), pokes=pokes, excluded=excluded)
    there = landmark_pokes(pokes, points, at or {})
    made = replace(made, at_landmarks=at or {}, landmark_pokes=there)
    return decided(made, landmarks=tuple(points), excluded=frozenset(excluded))


def press(poke: int, start_s: float, place=CORNER.place, pose: str = "low") -> Rejection:
    """A poke straight into the part at a landmark, which no taxel answered."""
    force = np.array([0.0, 0.0, -10.0])
    nobody = np.empty(0, dtype=np.int64)
    return Rejection(
        poke,
        start_s,
        start_s + 0.3,
        Reason.NO_TAXEL,
        0.0,
        1.0,
        "",
        nobody,
        True,
        force,
        np.cross(place, force),
        np.eye(4),
        pose,
    )


LOW, HIGH = ("low", np.eye(4)), ("high", np.eye(4))  # Arm poses


class Landmarks(LandmarkGuide):
    """The guide of the landmarks, and what the pipeline makes of what it asks for."""

    def __init__(self, of: Part, plan: PlannedPlaces) -> None:
        super().__init__(of, plan)
        self._finder = LandmarkFinder(lambda: dict(zip(plan.channels.tolist(), plan.places, strict=True)), None)
        self._seen = 0

    def before_skin(self, skin, snapshot, pose, now_s):
        says = super().before_skin(skin, snapshot, pose, now_s)
        name = "" if says.landmark is None else says.landmark.landmark.name
        if name != self._finder.asked:
            self._finder.ask(name, now_s)
        return says

    def forget(self):
        super().forget()
        self._finder.ask("", 0.0)

    def begin(self, snapshot):
        """Start with pokes that were there already."""
        self._seen = snapshot.pokes[-1].outcome.poke if snapshot.pokes else 0

    def poked(self, snapshot) -> list[FoundAtLandmark]:
        """Return which new pokes were at the landmark that was asked for."""
        new = [poke.outcome for poke in snapshot.pokes if poke.outcome.poke > self._seen]
        self.begin(snapshot)
        decisions = snapshot.decisions
        return self._finder.find_landmark_pokes(
            new, NO_LANDMARK_POKES, decisions.landmarks, decisions.missed_landmarks, decisions.named_by_hand, part().scene.noise
        )


def asking(now_s: float = 100.0, snapshot: Snapshot | None = None, of: Part | None = None) -> Landmarks:
    """The landmarks, of which one is asked for since `now_s`."""
    landmarks = Landmarks(of or part(), plan_of(of or part()))
    landmarks.before_skin(guidance(target(3)), snapshot or of_pokes(), LOW, now_s)
    return landmarks


LATER = 100.0 + VISUAL_REACTION_TIME_S + 0.01


# Which poke was there


@pytest.mark.parametrize("reason", [each for each in Reason if each is not Reason.NO_TAXEL])
def test_a_poke_that_was_rejected_for_another_reason_is_not_at_it(reason):
    assert asking().poked(of_pokes(replace(press(1, LATER), reason=reason))) == []


def test_without_a_still_window_nothing_tells_where_it_was():
    assert asking().poked(of_pokes(replace(press(1, LATER), force=None))) == []
    assert asking().poked(of_pokes(slip(1, Reason.NO_TAXEL))) == []


def test_nothing_is_taken_where_nobody_wants_to_be_guided():
    guiding, at = SessionGuide(part()), of_pokes()
    guiding.landmarks = Landmarks(part(), guiding.plan)

    def follow(wanted: bool, now_s: float):
        guiding.wanted = wanted
        return guiding.next_target(at, LOW, Method.FREE, now_s)

    assert follow(True, 100.0).landmark is not None
    assert follow(False, 110.0) is None
    assert guiding.landmarks.poked(of_pokes(press(1, 120.0))) == []
    assert follow(True, 200.0).landmark is not None
    assert guiding.landmarks.poked(of_pokes(press(2, 150.0))) == [], "seen again since 200"
    assert guiding.landmarks.poked(of_pokes(press(3, 201.0))) == [FoundAtLandmark(3, "corner")]


# What is asked for


def shown(landmarks: Landmarks, snapshot: Snapshot, pose=LOW):
    return landmarks.before_skin(guidance(target(3)), snapshot, pose, 100.0)


def six(pose: str = "low"):
    """Two pokes at each landmark, and which these are."""
    pokes = [press(i + 1, 1.0 + i, POINTS[i % 3].place, pose) for i in range(6)]
    return pokes, {i + 1: POINTS[i % 3].name for i in range(6)}


def test_a_landmark_is_asked_for_until_there_are_enough_and_then_the_skin():
    landmarks = Landmarks(part(), plan_of(part()))
    pokes, at = six()
    for count in range(6):
        asked = shown(landmarks, of_pokes(*pokes[:count], at={n: at[n] for n in range(1, count + 1)}))
        assert asked.phase is GuidePhase.LANDMARKS
        assert (asked.landmark.done, asked.landmark.wanted) == (count, 6)
        assert asked.target.landmark == asked.landmark.landmark.name
        np.testing.assert_array_equal(asked.target.push, -UP)
    done = shown(landmarks, of_pokes(*pokes, at=at))
    assert (done.landmark, done.phase, done.target.channel) == (None, GuidePhase.SWEEP, 3)


def test_a_poke_that_does_not_count_any_more_is_asked_for_again():
    landmarks = Landmarks(part(), plan_of(part()))
    pokes, at = six()
    assert shown(landmarks, of_pokes(*pokes, at=at)).landmark is None
    assert shown(landmarks, of_pokes(*pokes, at=at, excluded=(2,))).landmark.done == 5
    assert shown(landmarks, of_pokes(*pokes, at={n: name for n, name in at.items() if n > 1})).landmark.done == 5
    assert shown(landmarks, of_pokes(*pokes, at=at | {1: "gone"})).landmark.done == 5, "a landmark that is no more"


def test_nothing_is_asked_for_without_landmarks_or_before_the_arm_pose_is_known():
    skin, landmarks = guidance(target(3)), Landmarks(part(), plan_of(part()))
    assert landmarks.before_skin(skin, of_pokes(points=()), LOW, 100.0) is skin
    on_arm = replace(part(), scene=arm_scene())
    landmarks = Landmarks(on_arm, plan_of(on_arm))
    assert landmarks.before_skin(skin, of_pokes(), ("", None), 100.0) is skin
    assert landmarks.before_skin(skin, of_pokes(), LOW, 100.0).landmark is not None
    landmarks = Landmarks(part(), plan_of(part()))
    assert landmarks.before_skin(skin, of_pokes(), ("", None), 100.0).landmark is not None, (
        "a part that no arm moves has one pose, without a name"
    )


def test_the_same_picture_asks_for_the_same_object():
    landmarks, skin, at = Landmarks(part(), plan_of(part())), guidance(target(3)), of_pokes()
    first = landmarks.before_skin(skin, at, LOW, 100.0)
    assert landmarks.before_skin(skin, at, LOW, 101.0) is first
    assert landmarks.before_skin(guidance(target(3)), at, LOW, 103.0) is not first


def test_one_is_skipped_or_all_of_the_pose():
    landmarks = Landmarks(part(), plan_of(part()))
    first = shown(landmarks, of_pokes()).target.landmark
    skips = (landmarks.skip(),)
    second = shown(landmarks, decided(of_pokes(), skips=skips))
    assert second.target.landmark != first
    assert shown(landmarks, decided(of_pokes(), skips=skips), HIGH).target.landmark == first, "in another pose it is asked for"
    shown(landmarks, decided(of_pokes(), skips=skips))
    skips = (*skips, landmarks.skip(all_of_pose=True))
    assert shown(landmarks, decided(of_pokes(), skips=skips)).landmark is None
    assert shown(landmarks, decided(of_pokes(), skips=skips), HIGH).landmark is not None
    assert landmarks.poked(of_pokes(press(1, 500.0))) != []


def test_what_is_skipped_is_the_landmark_or_else_the_taxel():
    guiding = SessionGuide(part())

    skips = []

    def follow():
        return guiding.next_target(decided(of_pokes(), skips=tuple(skips)), LOW, Method.FREE, 100.0)

    names = []
    for _ in POINTS:
        names.append(follow().target.landmark)
        skips.append(guiding.skip())
    assert set(names) == {"corner", "other", "side"}
    skin = follow()
    assert skin.landmark is None
    skips.append(guiding.skip())
    assert follow().target.channel != skin.target.channel


# What they are worth


def test_what_they_are_worth_is_said_and_falls_as_they_are_poked():
    landmarks = Landmarks(part(), plan_of(part()))
    four = (*POINTS, Landmark("end", np.array([0.036, -0.036, 0.0]), UP))
    pokes = [press(i + 1, 1.0 + i, four[i % 4].place) for i in range(6)]
    at = {i + 1: four[i % 4].name for i in range(6)}
    first = shown(landmarks, of_pokes(points=four)).gain
    assert first.pokes == 6
    assert 0 < first.after < first.now
    fifth = shown(landmarks, of_pokes(*pokes[:5], at={n: at[n] for n in range(1, 6)}, points=four)).gain
    assert (fifth.pokes, fifth.now) == (1, pytest.approx(first.now)), "fewer than six correct nothing"
    three = shown(Landmarks(part(), plan_of(part())), of_pokes()).gain
    assert three.after == three.now, "three landmarks correct nothing, however often they are poked"
    there = of_pokes(*pokes, touch(7), at=at, points=four)
    second = shown(landmarks, there, ("high", np.diag([-1.0, -1.0, 1.0, 1.0]))).gain
    assert second.pokes == 3
    assert second.after < second.now < first.now


def test_nothing_is_predicted_where_the_arm_or_the_taxels_are_not_known():
    landmarks = Landmarks(part(), plan_of(part()))
    unknown = shown(landmarks, of_pokes(), ("low", None))
    assert unknown.landmark is not None
    assert unknown.gain is None
    bare = replace(part(), laid=None)
    assert shown(Landmarks(bare, plan_of(bare)), of_pokes()).gain is None


def test_a_landmark_without_a_normal_is_pushed_from_outside():
    bare = Landmark("screw", np.array([0.036, 0.0, 0.0]), None)
    asked = shown(Landmarks(part(), plan_of(part())), of_pokes(points=[bare]))
    middle = laid(PLAN).places.mean(axis=0)
    np.testing.assert_allclose(asked.target.normal, (bare.place - middle) / np.linalg.norm(bare.place - middle))


# What is said and heard


def test_it_is_said_what_to_do_which_of_how_many_it_is_and_what_it_is_worth():
    asked = shown(Landmarks(part(), plan_of(part())), of_pokes())
    asked = replace(asked, gain=Gain(0.0071, 0.0025, 6))
    assert target_words(asked, asked.target, NAMES) == approved("landmark.ask", name="corner")
    worth = approved("landmark.worth", now_mm=7.1, then_mm=2.5, pokes=6)
    assert gain_words(asked.gain) == worth
    assert gain_words(replace(asked.gain, pokes=1)).startswith("after 1 poke ")
    assert gain_words(None) == ""
    assert landmark_words(LandmarkTarget(CORNER, 2, 6)) == approved("landmark.which_of", number=3, count=6)
    assert why_words(asked, asked.target, ()) == approved("landmark.which_of_and_worth", number=1, count=6, worth=worth)


@pytest.mark.parametrize("poke", [press(1, LATER), touch(1)], ids=["unanswered", "answered"])
def test_a_poke_at_a_landmark_is_named_and_heard_as_accepted(poke):
    asked = shown(Landmarks(part(), plan_of(part())), of_pokes())
    before, after = (replace(frame(at), guidance=asked) for at in (of_pokes(), of_pokes(poke, at={1: "corner"})))
    _, ear = due_cue(CueMemory(), before)
    due, ear = due_cue(ear, after)
    assert due is not None
    assert (due.sound.name, due.word) == ("ACCEPTED", "")
    assert due_cue(ear, after)[0] is None
    said, _ = now_line(now_line(NowMemory(), before)[1], after)
    assert said.result == Said(Tone.GOOD, approved("landmark.accepted", poke=1, name="corner"))
    assert said.headline == approved("landmark.ask", name="corner"), "what to do next is what is read first"


def test_elsewhere_a_poke_that_no_taxel_answered_is_rejected():
    _, ear = due_cue(CueMemory(), frame(of_pokes()))
    due, _ = due_cue(ear, frame(of_pokes(press(1, LATER))))
    assert due == DueCue(due.sound, REASON_WORDS[Reason.NO_TAXEL])
    assert due.sound.name == "REJECTED"
    said, _ = now_line(now_line(NowMemory(), frame(of_pokes()))[1], frame(of_pokes(press(1, LATER))))
    assert said.result.tone is Tone.BAD


def test_what_may_be_done_with_landmarks():
    def may(**changes):
        at = of_pokes()
        return allowed(at, Running.STREAMING, (), None, **changes)

    asked = shown(Landmarks(part(), plan_of(part())), of_pokes())
    assert (may().skip_landmarks, may(guidance=guidance(target(3))).skip_landmarks) == (False, False)
    assert may(guidance=asked).skip_landmarks
    assert may(guidance=asked).another
    assert may().correct is None


def test_a_poke_record_that_is_out_is_said_by_nobody():
    asked = shown(Landmarks(part(), plan_of(part())), of_pokes())
    out = replace(of_pokes(touch(1), at={1: "corner"}), pokes=(PokeRecord(touch(1), True),))
    said, _ = now_line(
        now_line(NowMemory(), replace(frame(of_pokes()), guidance=asked))[1], replace(frame(out), guidance=asked)
    )
    assert said.result is None
