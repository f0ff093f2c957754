"""Channels that cannot be trusted are found, said with a sentence, and good ones are not."""

import numpy as np
import pytest

from skincal.contacts.channel_health import DeadCause
from skincal.contacts.detector import ContactDetector
from skincal.contacts.outcome import Contact
from tests.skincal.poke_script import ANSWERS, SPOTS, Script, small_scene

FORCE = np.array([1.0, 2.0, -8.0])
POINT = np.array([0.02, 0.05, 0.10])


def _detector_after(script, change=lambda skin: skin):
    detector = ContactDetector(script.scene)
    for sample in script.samples:
        change(sample.skin)
        detector.feed(sample, np.eye(4), "")
    return detector


def _set(channel, value):
    def change(skin):
        skin[channel] = value

    return change


def test_a_channel_without_numbers_is_dead_until_it_has_some():
    script = Script(small_scene(), skin_noise=1.0).quiet(4.0)
    detector = _detector_after(script, _set(5, np.nan))
    assert list(detector.dead) == [5]
    assert "no number" in detector.dead[5]
    script.samples.clear()
    for sample in script.quiet(2.0).samples:
        detector.feed(sample, np.eye(4), "")
    assert detector.dead == {}


def test_nan_never_answers_and_the_poke_counts_for_the_others():
    script = Script(small_scene()).quiet().press(FORCE, POINT, {3: 80.0, 7: 40.0}).quiet()
    detector = ContactDetector(script.scene)
    outcomes = []
    for sample in script.samples:
        sample.skin[7] = np.nan
        outcomes += detector.feed(sample, np.eye(4), "")
    assert isinstance(outcomes[-1], Contact)
    assert outcomes[-1].channels.tolist() == [3]


def _rounded(skin):
    skin[:] = np.round(skin)


@pytest.mark.parametrize(
    ("noise", "seconds", "change", "words"),
    [
        (1.0, 12.0, _set(5, 255.0), "pressed end"),
        (1.0, 12.0, _set(5, 0.0), ""),  # the other end
        (1.0, 62.0, _set(5, 77.0), "77"),  # one constant among noisy channels
        (0.25, 65.0, _rounded, ""),  # a coarse skin keeps its values
    ],
)
def test_a_channel_that_keeps_its_value_is_stuck_if_others_vary(noise, seconds, change, words):
    dead = _detector_after(Script(small_scene(limits=(0.0, 255.0)), skin_noise=noise).quiet(seconds), change).dead
    assert list(dead) == ([5] if words else [])
    assert words in dead.get(5, "")


@pytest.mark.parametrize("cause", DeadCause)
def test_a_dead_channel_of_an_older_session_is_recognized_by_its_sentence(cause):
    """Journals hold the sentences: each cause ends in its own way."""
    script = Script(small_scene(), skin_noise=1.0).quiet(3.0)
    detector = ContactDetector(script.scene, last_poke=4, dead={5: f"{cause.value} for a while"})
    script.run(detector)
    assert list(detector.dead) == ([5] if cause is DeadCause.ALWAYS_ON else [])


def test_a_taxel_that_never_moves_while_its_neighbours_are_poked_is_stuck():
    script = Script(small_scene()).quiet()
    for _ in range(7):
        script.press(FORCE, POINT, {3: 80.0, 2: 30.0}, hold_s=0.4).quiet(0.4)
    dead = _detector_after(script, _set(7, 100.0)).dead
    # 7 is a neighbour of 3 that never moved; 2 answered.
    assert 7 in dead
    assert 2 not in dead
    assert "neighbours" in dead[7]


def test_a_taxel_that_always_answers_is_found_and_spoils_nothing():
    script = Script(small_scene(), skin_noise=0.5).quiet()
    for k in range(9):
        script.press(FORCE, SPOTS[k % 3], ANSWERS[k % 3] | {18: 60.0}, hold_s=0.4).quiet(0.6)
    detector = ContactDetector(script.scene)
    last = {}
    for outcome in script.run(detector):
        last[outcome.poke] = outcome
    assert list(detector.dead) == [18]
    assert "always on" in detector.dead[18]
    assert all(isinstance(outcome, Contact) for outcome in last.values())
    assert not any(18 in outcome.channels for outcome in last.values())


def test_without_a_layout_a_taxel_that_answers_everywhere_is_found():
    script = Script(small_scene(channels=40, layout=False), skin_noise=0.5).quiet()
    for k in range(12):
        script.press(FORCE, POINT, {2 * k: 80.0, 2 * k + 1: 40.0, 39: 60.0}, hold_s=0.4).quiet(0.4)
    detector = ContactDetector(script.scene)
    script.run(detector)
    assert list(detector.dead) == [39]


def test_good_taxels_under_many_pokes_are_not_blamed():
    script = Script(small_scene(), skin_noise=0.5).quiet()
    for k in range(24):
        script.press(FORCE, SPOTS[k % 3], ANSWERS[k % 3], hold_s=0.36).quiet(0.4)
    assert _detector_after(script).dead == {}
