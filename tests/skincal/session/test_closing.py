"""The closing check: when it is asked for, what it finds, and that a session that is played again finds the same."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from math import ceil

import numpy as np
import pytest

from skincal.files.export import json_text
from skincal.following.session_guide import SessionGuide
from skincal.guide.guidance import GuidePhase
from skincal.model.actions import AtLandmark, BeginClosing, Exclude, FoundAtLandmark, Redo, SkipClosing, Undo
from skincal.part.part import lay_part
from skincal.pokes import LandmarkPokes, Pokes
from skincal.rig.closing import CLOSING_CHECK_PLACES, Closing, ClosingPlace, ClosingPlaces, closing_check
from skincal.session import closing_pokes
from skincal.session.closing_pokes import (
    CLOSING_CHECK_MAX_POKES_PER_PLACE,
    MAX_REPEATS_OF_DECIDING_PLACE,
    MIN_CONTACTS_BETWEEN_CLOSING_CHECKS,
    MIN_SHARE_BETWEEN_CLOSING_CHECKS,
    ClosingRounds,
    closing_rounds,
    closings_of,
    taxel_pokes,
)
from skincal.session.replay import load, replay
from skincal.session.session import Session
from skincal.simulation.contacts import poke_landmarks, simulate_contacts, unguided, unguided_presses
from skincal.simulation.operator import Habits
from skincal.simulation.rig_errors import RigErrors
from skincal.taxels.result import Method
from skincal.words.rig_words import closing_sentence, earlier_closings
from skincal.words.verdict_words import figures
from tests.approved import approved
from tests.build import landmark_outcome, recording
from tests.skincal.poke_script import as_chunks, some_pokes, write_scene
from tests.skincal.sim_support import make_rig

NOISE = make_rig(RigErrors.noise(), 1).scene.noise


def off_by(poke, offset):
    """The poke as it is where the tip was `offset` beside the place, link frame, metres."""
    return replace(
        poke, moment=poke.moment + np.cross(poke.link_from_sensor[..., :3, :3].swapaxes(-1, -2) @ offset, poke.force)
    )


def across(poke, size, rng):
    """The poke as it is where the tip was so many metres beside the place, across the push."""
    way = np.cross(poke.link_from_sensor[:3, :3] @ poke.force, rng.normal(size=3) if size else np.ones(3))
    return off_by(poke, size * way / np.linalg.norm(way))


class Sessions:
    """A session on a simulated rig, and the guide that follows it."""

    def __init__(self, errors: RigErrors, *, landmarks: bool = True, slips: float = 0.0) -> None:
        """At the first landmark the tip slips by so many metres."""
        self.rng = np.random.default_rng(3)
        self.rig = make_rig(errors, 1)
        scene = self.rig.scene if landmarks else replace(self.rig.scene, landmarks=())
        self.session = Session(scene, self.rig.surface)
        self.guide = SessionGuide(lay_part(scene, self.rig.surface, ()))
        self.slip, self.beside, self.number = np.zeros(3), slips, 0
        stance = self.rig.arm_pose()
        self.pose = stance.name, stance.reported
        for name in [landmark.name for landmark in scene.landmarks]:
            self.poke_landmark(name)
            self.beside = 0.0
        for contact in simulate_contacts(self.rig, unguided(self.rig, 2, self.rng), self.rng, first_poke=self.number + 1):
            self.session.add(contact)

    def slipped(self, poke):
        """The poke as it is after the part moved by `slip`, link frame, and the tip slipped by `beside`, metres."""
        return across(off_by(poke, self.slip), self.beside, self.rng)

    def poke_landmark(self, name: str) -> None:
        self.number = self.session.last_poke + 1
        landmark = next(each for each in self.session.decisions.landmarks if each.name == name)
        poke = self.slipped(poke_landmarks(self.rig, (landmark,), 1, self.rng, self.number)[0])
        self.session.add(landmark_outcome(poke))
        self.session.act(FoundAtLandmark(self.number, name))

    def poke_taxel(self, channel: int) -> None:
        """Poke it until it is the one that answers most."""
        for _ in range(20):
            pressed = unguided_presses(self.rig, np.array([channel]), Habits(aim=0.0005), self.rng)
            for contact in simulate_contacts(self.rig, pressed, self.rng, first_poke=self.session.last_poke + 1):
                if contact.strongest_channel == channel:
                    self.session.add(self.slipped(contact))
                    return
        raise AssertionError(channel)

    def look(self):
        snapshot = self.session.snapshot()
        return self.guide.next_target(snapshot, self.pose, Method.MODULES, 100.0)

    def close(self) -> list[str]:
        """Poke what the closing check asks for; return what that was."""
        asked: list[str] = []
        while (guidance := self.look()).phase is GuidePhase.CLOSING:
            if len(self.session.decisions.closings) < guidance.closing.number:
                self.session.act(BeginClosing())
            assert (guidance.closing.done, guidance.closing.places) == (min(len(asked), 3), 3)
            if guidance.landmark is not None:
                asked.append(guidance.landmark.landmark.name)
                self.poke_landmark(asked[-1])
            else:
                asked.append(str(guidance.target.channel))
                self.poke_taxel(guidance.target.channel)
        assert guidance.phase is GuidePhase.ENOUGH
        return asked

    def verdict(self):
        return self.guide.verdict(self.session.snapshot(), Method.MODULES)


def test_at_enough_three_landmarks_are_asked_for_once_more_and_nothing_moved():
    it = Sessions(RigErrors.noise())
    assert it.look().enough
    assert not it.verdict().closings
    first = it.session.landmark_pokes.name.tolist()[:3]
    assert it.close() == first
    (closing,) = it.verdict().closings
    assert (closing.at, closing.names) == (ClosingPlaces.LANDMARKS, tuple(sorted(first)))
    assert not closing.has_moved
    assert closing.shift < closing.limit < 0.012
    assert it.session.calibration().closings == (closing,)
    assert closing_sentence(closing) == approved(
        "closing.still", shift=f"{closing.shift * 1e3:.1f}", limit=f"{closing.limit * 1e3:.1f}", count=3, places="landmarks"
    )
    written = json.loads(json_text(it.session.calibration()))["closing_check"]
    assert (written["at"], written["shift_m"], written["moved"]) == ("landmarks", closing.shift, False)


def test_what_slipped_meanwhile_is_told_with_its_number():
    it = Sessions(RigErrors.noise())
    it.slip = np.array([0.0, 0.012, 0.0])
    it.close()
    verdict = it.verdict()
    (closing,) = verdict.closings
    assert closing.has_moved
    assert closing.shift == pytest.approx(0.012, abs=0.005)
    assert verdict.doubted
    assert closing_sentence(closing).startswith(
        approved("closing.moved_begin", what="the sensor or the arm", shift=f"{closing.shift * 1e3:.1f}")
    )


def with_one_far_off() -> tuple[Sessions, str]:
    """A session whose closing check has its three pokes, and the landmark at which the first of them slipped."""
    it = Sessions(RigErrors.noise())
    it.session.act(BeginClosing())
    first = it.look().landmark.landmark.name
    it.beside = 0.025
    for _ in range(3):
        guidance = it.look()
        assert guidance.closing.suspect_poke is None
        it.poke_landmark(guidance.landmark.landmark.name)
        it.beside = 0.0
    return it, first


@pytest.mark.parametrize(
    ("chance", "without_one", "has_moved", "single_poke"),
    [(0.005, 0.03, True, False), (0.005, 0.2, False, True), (0.03, 0.04, False, False), (0.5, 0.6, False, False)],
)
def test_a_movement_needs_all_pokes_and_any_one_left_out(chance, without_one, has_moved, single_poke):
    closing = Closing(ClosingPlaces.TAXELS, ("1", "2"), 0.004, 0.003, chance, chance_without_worst=without_one)
    assert (closing.has_moved, closing.single_poke_decides) == (has_moved, single_poke)


def test_one_poke_far_off_is_asked_for_once_more_and_nothing_has_moved():
    it, first = with_one_far_off()
    slipped = it.number - 2
    (closing,) = it.verdict().closings
    assert (closing.poke, closing.place, closing.has_moved, closing.single_poke_decides) == (slipped, first, False, True)
    assert closing_sentence(closing) == approved(
        "closing.lone", poke=slipped, place=first, shift=f"{closing.shift * 1e3:.1f}", limit=f"{closing.limit * 1e3:.1f}"
    )
    assert earlier_closings([closing, closing])[0].endswith(f"(only poke {slipped}).")
    written = json.loads(json_text(it.session.calibration()))["closing_check"]
    assert (written["moved"], written["poke_left_out"], written["place_left_out"]) == (False, slipped, first)
    assert written["chance_without_poke"] == closing.chance_without_worst
    guidance = it.look()
    shown = guidance.phase, guidance.closing.suspect_poke, guidance.landmark.landmark.name
    assert shown == (GuidePhase.CLOSING, slipped, first)
    asked = 0
    while it.look().phase is GuidePhase.CLOSING:
        it.poke_landmark(it.look().landmark.landmark.name)
        asked += 1
    assert 1 <= asked <= MAX_REPEATS_OF_DECIDING_PLACE
    assert not it.verdict().doubted
    # Where the operator says that it was not there, nothing hangs on it.
    it.session.act(AtLandmark(slipped, ""))
    assert not it.verdict().closings[-1].single_poke_decides


def test_where_an_early_poke_was_far_off_its_place_is_asked_for_twice_at_most():
    it = Sessions(RigErrors.noise(), slips=0.03)
    first = str(it.session.landmark_pokes.name[0])
    assert it.close().count(first) == 1 + MAX_REPEATS_OF_DECIDING_PLACE
    (closing,) = it.verdict().closings
    assert (closing.single_poke_decides, closing.place, closing.poke) == (True, first, 1)


def test_the_place_of_one_poke_is_asked_for_no_more_where_others_are_poked_instead():
    it, first = with_one_far_off()
    other = str(it.session.landmark_pokes.name[-1])
    assert other != first
    made = it.number
    for _ in range(CLOSING_CHECK_MAX_POKES_PER_PLACE):
        assert it.look().phase is GuidePhase.CLOSING
        it.poke_landmark(other)
    assert it.look().phase is GuidePhase.ENOUGH
    (round_,) = closing_rounds(it.session.snapshot(), it.rig.scene.noise)
    assert max(round_.pokes) == made, "those are not of the check"


def poke_more(it, count):
    """Press taxels at random."""
    presses = unguided_presses(it.rig, it.rng.choice(it.rig.channels, count), Habits(), it.rng)
    for contact in simulate_contacts(it.rig, presses, it.rng, first_poke=it.session.last_poke + 1):
        it.session.add(contact)


@pytest.mark.parametrize("landmarks", [True, False])
def test_checks_before_the_last_one_are_kept_and_are_those_of_a_fresh_look(landmarks, monkeypatch):
    it, made = Sessions(RigErrors.noise(), landmarks=landmarks), []
    progress = closing_pokes._progress
    monkeypatch.setattr(closing_pokes, "_progress", lambda *given: made.append(0) or progress(*given))
    noise = it.rig.scene.noise
    rounds = ClosingRounds(noise)

    def look(anew=None):
        """Compare with a fresh look; so many checks are determined anew."""
        snapshot = it.session.snapshot()
        made.clear()
        followed = rounds.list_rounds(snapshot)
        assert anew is None or len(made) == anew
        assert followed == closing_rounds(snapshot, noise)
        return followed

    for check in range(3):
        assert len(it.close()) == 3
        assert len(look(check + 1)) == check + 1, "a decision was made"
        it.slip += np.array([0.0, 0.004, 0.0])
        poke_more(it, 25)
        # Without landmarks, the estimates of their taxels may have moved.
        look(0 if landmarks else None)
        assert not look(0)[0].found.has_moved
        poke = it.session.snapshot().pokes[-1].outcome
        it.session.add(replace(poke, final=True, force=1.001 * poke.force))
        look(0 if landmarks else None)
    first = max(look(0)[0].pokes)
    it.session.act(AtLandmark(first, "") if landmarks else Exclude(first))
    look(3)
    it.session.act(Undo())
    assert first in look(3)[0].pokes
    # A contact among the pokes of the first check is reported once more.
    changed = it.session.snapshot().contacts[0] if landmarks else it.session.snapshot().contact(first)
    it.session.add(replace(changed, force=1.01 * changed.force))
    look(3)


def landmark_check(pokes):
    return closing_check(pokes[:6], pokes[6:], ClosingPlaces.LANDMARKS, NOISE)


def nine_pokes(seed, *, moved=0.0):
    """Six landmarks poked once, and three of them once more, after the part moved by so many metres."""
    rig, rng = make_rig(RigErrors.paper(), seed), np.random.default_rng(seed)
    pokes, way = poke_landmarks(rig, rig.scene.landmarks, 9, rng, 1)[:9], rng.normal(size=3)
    return LandmarkPokes.concatenate([pokes[:6], off_by(pokes[6:], moved * way / np.linalg.norm(way))])


def with_one_off(pokes, position, by):
    """The pokes, one of them beside its place by a vector, metres, link frame."""
    own = pokes[position : position + 1]
    return LandmarkPokes.concatenate([pokes[:position], off_by(own, by), pokes[position + 1 :]])


def test_one_poke_far_off_moves_nothing_wherever_it_is():
    before, now = [], []
    for seed in range(15):
        for position in (0, 4, 7):
            pokes, rng = nine_pokes(seed), np.random.default_rng([seed, position])
            push = pokes[position].link_from_sensor[:3, :3] @ pokes[position].force
            beside = np.cross(push, rng.normal(size=3))
            pokes = with_one_off(pokes, position, 0.020 * beside / np.linalg.norm(beside))
            closing = landmark_check(pokes)
            before.append(closing.chance < 0.01)
            now.append(closing.has_moved)
            assert not closing.single_poke_decides or closing.place == pokes[position].name
    assert (np.mean(before) > 0.4, np.mean(now) < 0.07) == (True, True)


def test_a_movement_shows_whichever_poke_is_left_out():
    found = [landmark_check(nine_pokes(seed, moved=0.016)) for seed in range(20)]
    assert np.mean([each.has_moved for each in found]) > 0.85
    assert all(each.chance_without_worst >= each.chance for each in found)


def test_a_poke_that_is_left_out_counts_as_if_it_had_not_been_made():
    pokes = nine_pokes(2)
    pokes = with_one_off(pokes, 4, np.array([0.0, 0.0, 0.2]))
    assert landmark_check(pokes).poke == 5
    alone = closing_check(pokes[[0, 1, 2, 3, 5]], pokes[6:], ClosingPlaces.LANDMARKS, NOISE)
    assert landmark_check(pokes).chance_without_worst == pytest.approx(alone.chance, rel=1e-6)


def test_without_landmarks_three_of_the_first_taxels_are_poked_once_more():
    it = Sessions(RigErrors.noise(), landmarks=False)
    first = list(dict.fromkeys(poke.name for poke in taxel_pokes(it.session.snapshot(), it.session.channels)))[:3]
    assert it.close() == first
    (closing,) = it.verdict().closings
    assert (closing.at, set(closing.names)) == (ClosingPlaces.TAXELS, set(first))
    assert not closing.has_moved
    it.session.snapshot()
    moved = replace(closing, chance=0.001, chance_without_worst=0.001)
    assert f"Since the start {approved('closing.skin_clause')}" in closing_sentence(moved)


def test_one_is_skipped_or_all_of_it():
    it = Sessions(RigErrors.noise())
    first = it.look().landmark.landmark.name
    it.session.act(it.guide.skip())
    assert it.look().landmark.landmark.name != first
    it.session.act(it.guide.skip_landmarks())
    assert it.look().phase is GuidePhase.ENOUGH
    # The place of a single poke that decides, too.
    it, first = with_one_far_off()
    it.look()
    assert it.guide.skip() == SkipClosing("landmarks", first)
    it.session.act(it.guide.skip())
    assert it.look().phase is GuidePhase.ENOUGH


def test_the_chance_is_what_it_says():
    """Of 60 rigs with the paper's errors, about one in ten shows a chance below a tenth, and hardly one below a hundredth."""
    chances = []
    for seed in range(60):
        rig, rng = make_rig(RigErrors.paper(), seed), np.random.default_rng(seed)
        pokes = poke_landmarks(rig, rig.scene.landmarks, 9, rng, 1)[:9]
        found = closing_check(pokes[:6], pokes[6:], ClosingPlaces.LANDMARKS, rig.scene.noise)
        chances.append(found.chance)
    assert np.mean(np.array(chances) < 0.1) < 0.2
    assert np.mean(np.array(chances) < 0.01) < 0.06
    assert 0.3 < np.mean(np.array(chances) < 0.5) < 0.7


def pushed_down(rng: np.random.Generator, moved: tuple[float, float, float] = (0.0, 0.0, 0.0)):
    """Six landmarks of a flat part, all pushed within 5 degrees of straight down, and three once more after it moved."""
    places = np.array([[x, y, 0.12] for x in (-0.04, 0.0, 0.04) for y in (-0.02, 0.02)])
    numbers, wrenches = [*range(6), *range(3)], []
    for number, which in enumerate(numbers):
        force = 8.0 * np.array([*rng.normal(0.0, np.radians(2.5), 2), -1.0])
        place = places[which] + (np.array(moved) if number >= 6 else 0.0)
        moment = np.cross(place, force) + rng.normal(0.0, 0.010, 3)
        wrenches.append([force, moment])
    force, moment = np.array(wrenches).transpose(1, 0, 2)
    every = Pokes(np.arange(9), force, moment, np.tile(np.eye(4), (9, 1, 1)), np.full(9, "home"))
    pokes = LandmarkPokes.at(every, list(map(str, numbers)), places[numbers])
    return pokes[:6], pokes[6:]


def test_nothing_is_told_of_a_movement_along_pushes_that_are_all_alike():
    noise, found = make_rig(RigErrors.noise(), 1).scene.noise, []
    for seed in range(60):
        found.append(closing_check(*pushed_down(np.random.default_rng(seed)), ClosingPlaces.LANDMARKS, noise))
    assert {each.observable_directions for each in found} == {2}
    assert max(each.shift for each in found) < 0.012
    assert sum(each.has_moved for each in found) <= 2
    assert closing_sentence(found[0]).endswith(approved("closing.across", limit=f"{found[0].limit * 1e3:.1f}"))
    along = closing_check(*pushed_down(np.random.default_rng(0), (0.0, 0.0, 0.03)), ClosingPlaces.LANDMARKS, noise)
    assert (along.observable_directions, along.has_moved) == (2, False)
    across = closing_check(*pushed_down(np.random.default_rng(0), (0.02, 0.0, 0.0)), ClosingPlaces.LANDMARKS, noise)
    assert across.has_moved
    assert across.shift == pytest.approx(0.02, abs=0.008)


@pytest.mark.parametrize("again", [replay, load])
def test_a_session_played_again_began_it_after_the_same_poke(tmp_path, again):
    scene = write_scene(tmp_path / "source")
    items = as_chunks(some_pokes(scene, 4).samples)
    pipeline = recording(scene, tmp_path / "s", items, [(0.5, BeginClosing())])
    for action in (SkipClosing("landmarks", "elbow"), BeginClosing(wanted=True), SkipClosing("", "")):
        pipeline.act(action, items[-1].host_ns)
    pipeline.close()
    first, second = pipeline.snapshot().decisions.closings
    assert (first.skipped, first.ended) == (frozenset({ClosingPlace(ClosingPlaces.LANDMARKS, "elbow")}), False)
    assert (second.skipped, second.ended) == (frozenset(), True)
    assert 0 < first.after < 4 == second.after
    other = again(tmp_path / "s")
    assert other.snapshot().decisions.closings == (first, second)
    assert closings_of(other.snapshot(), scene.noise) == closings_of(pipeline.snapshot(), scene.noise)


def test_made_again_the_last_one_counts_and_those_before_are_kept():
    it = Sessions(RigErrors.noise())
    it.slip = np.array([0.0, 0.012, 0.0])
    it.close()
    assert it.verdict().doubted
    # Fastened where it was, and checked again: pokes that were made while it was off do not speak against it.
    it.slip = np.zeros(3)
    it.session.act(BeginClosing(wanted=True))
    assert len(it.close()) == 3
    verdict = it.verdict()
    first, second = verdict.closings
    assert (first.has_moved, second.has_moved, verdict.doubted) == (True, False, False)
    for poke in range(first.after + 1, first.after + 4):
        it.session.act(AtLandmark(poke, ""))
    alone = it.verdict().closings[-1]
    assert second.shift == pytest.approx(alone.shift, rel=1e-9), "as if those of the first check had not been made"
    for _ in range(3):
        it.session.act(Undo())
    assert first.after < second.after
    assert dict(figures(verdict))["Final check"].endswith(
        approved("closing.earlier", shift=f"{first.shift * 1e3:.1f}", poke=first.after)
    )
    written = json.loads(json_text(it.session.calibration()))
    assert (written["closing_check"]["moved"], written["closing_check"]["after_poke"]) == (False, second.after)
    assert [each["moved"] for each in written["closing_checks_before"]] == [True]


def test_undo_takes_a_check_back_with_its_pokes():
    it = Sessions(RigErrors.noise())
    it.slip = np.array([0.0, 0.012, 0.0])
    it.close()
    it.slip = np.zeros(3)
    it.session.act(BeginClosing(wanted=True))
    it.close()
    for _ in range(3):
        assert len(it.verdict().closings) == 2 or it.verdict().has_moved
        it.session.act(Undo())
    assert [each.has_moved for each in it.verdict().closings] == [True]
    assert it.look().phase is GuidePhase.CLOSING
    it.session.act(Undo())
    assert it.look().phase is GuidePhase.ENOUGH
    it.session.act(Redo())
    assert it.look().closing.number == 2


def test_it_is_begun_again_only_where_something_can_be_poked_once_more():
    it = Sessions(RigErrors.noise())
    it.close()
    it.look()
    assert it.guide.check_again(it.session.snapshot(), it.pose[0]) == BeginClosing(wanted=True)
    it.pose = "nobody has poked in it", np.eye(4)
    it.look()
    assert it.guide.check_again(it.session.snapshot(), it.pose[0]) is None
    begun = SessionGuide(lay_part(it.rig.scene, it.rig.surface, ()))
    assert begun.check_again(it.session.snapshot(), it.pose[0]) is None, "before anything is asked for"


def test_after_more_work_it_is_asked_for_again():
    it = Sessions(RigErrors.noise())
    it.close()
    pokes = simulate_contacts(it.rig, unguided(it.rig, 1, it.rng), it.rng, first_poke=it.session.last_poke + 1)
    before = len(it.session.snapshot().contacts)
    wait = max(MIN_CONTACTS_BETWEEN_CLOSING_CHECKS, ceil(MIN_SHARE_BETWEEN_CLOSING_CHECKS * before))
    for contact in pokes[: wait - 1]:
        it.session.add(contact)
    assert it.look().phase is GuidePhase.ENOUGH
    it.session.add(pokes[wait - 1])
    assert it.look().closing.number == 2
    it.close()
    assert [each.has_moved for each in it.verdict().closings] == [False, False]


def test_after_days_of_work_checks_are_few():
    """A check is asked for after a tenth more contacts, not after each ten."""
    it = Sessions(RigErrors.noise())
    pokes = simulate_contacts(it.rig, unguided(it.rig, 12, it.rng), it.rng, first_poke=it.session.last_poke + 1)
    first, asked, step = len(it.session.snapshot().contacts), list[int](), 12
    for start in range(0, len(pokes), step):
        for contact in pokes[start : start + step]:
            it.session.add(contact)
        if it.look().phase is GuidePhase.CLOSING:
            it.session.act(BeginClosing())
            it.session.act(SkipClosing("", ""))
            asked.append(len(it.session.snapshot().contacts))
    assert asked[0] == first + step
    assert asked[-1] > 500, "enough contacts to tell"
    of_check = CLOSING_CHECK_MAX_POKES_PER_PLACE * CLOSING_CHECK_PLACES
    for before, now in pairwise(asked):
        least = max(MIN_CONTACTS_BETWEEN_CLOSING_CHECKS, MIN_SHARE_BETWEEN_CLOSING_CHECKS * before)
        assert least <= now - before <= (1.0 + MIN_SHARE_BETWEEN_CLOSING_CHECKS) * of_check + least + step


def test_a_landmark_that_is_called_as_a_channel_is_no_taxel():
    """A skipped landmark does not keep the taxel with the same number from being asked for."""
    it = Sessions(RigErrors.noise(), landmarks=False)
    first = it.look().closing.place
    assert first.at is ClosingPlaces.TAXELS
    it.session.act(BeginClosing())
    it.session.act(SkipClosing("landmarks", first.name))
    assert it.look().closing.place == first
    it.session.act(SkipClosing("taxels", first.name))
    assert it.look().closing.place != first
