"""Sentences on the skin of a session: the polarity, and readings that a device rounds."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.answers_of_skin import answers_of
from skincal.contacts.outcome import Reason
from skincal.contacts.skin_condition import SkinCondition, SkinWatch
from skincal.contacts.skin_drift import SkinDrift
from skincal.words.skin_words import skin_sentences
from tests.skincal.contacts.test_three_axes import PRESSED, axes_with, press_once
from tests.skincal.poke_script import small_scene


def test_pokes_against_the_polarity_name_it_and_its_remedy():
    pulled = press_once(axes_with(), {PRESSED: (0.0, 0.0, 80.0)})
    assert pulled.reason is Reason.NO_TARE
    scene = small_scene()
    three = replace(scene, skin=replace(scene.skin, axes=axes_with()))
    (of_one,) = skin_sentences(SkinCondition(), [pulled] * 2, scene, scene.contacts)
    (of_three,) = skin_sentences(SkinCondition(), [pulled] * 2, three, scene.contacts)
    assert "in 2 of 2 pokes: by the scene their values rise" in of_one
    assert "their values of z rise" in of_three
    assert 'polarity = "down"' in of_one
    pressed = press_once(axes_with())
    for outcomes in ([pulled], [pulled] * 2 + [pressed] * 3):
        assert skin_sentences(SkinCondition(), outcomes, scene, scene.contacts) == []


@pytest.mark.parametrize("is_normalised", [False, True])
def test_coarse_steps_at_rest_are_no_normalised_frames(is_normalised):
    """A taxel that rounds to 0.1 N has 0 and 0.1 in each frame at rest."""
    scene, rng = small_scene(), np.random.default_rng(3)
    width = scene.skin.channels
    answers = answers_of(scene.skin)
    watch = SkinWatch(scene, np.arange(width), answers)
    watch.on_frame(np.linspace(0.0, 9.0, width))  # a press
    for _ in range(300):
        frame = rng.uniform(0.01, 0.09, width) if is_normalised else 0.1 * (rng.random(width) < 0.01)
        low, high = rng.choice(width, 2, replace=False)
        frame[low], frame[high] = 0.0, 0.1
        watch.on_frame(frame)
    assert watch.condition(SkinDrift(np.arange(width), width, answers), None).is_normalised == is_normalised
