"""The guide and the turns of taxels of three axes: leaning pushes while one is open, its gain, and nothing for one axis."""

import math
from dataclasses import replace

import numpy as np
import pytest
from guided_bench import PART, GuidedBench, make_guide

from app.text.guidance_text import why_words
from skincal.axes.skin_turns import fit_group, joined
from skincal.axes.turn_gain import in_plane_sds
from skincal.guide.candidates import candidate_pushes
from skincal.guide.progress import ContactFacts, GuideSettings, Need, Why, find_needs, give_up_reason
from skincal.guide.turn_needs import LEAN_MIN_RAD, TurnNeeds
from skincal.taxels.result import Method
from skincal.words.turn_words import IN_PLANE_UNKNOWN
from tests.skincal.axes.axis_support import NOISE, make_pokes
from tests.skincal.axes.turn_support import QUARTER, turn_of, turns_of

CHANNELS, SETTINGS = PART.plan.channels, GuideSettings()
UP = np.array([0.0, 0.0, 1.0])
TURNS = {int(channel): turn_of(int(channel), QUARTER, pokes=20) for channel in CHANNELS[:1]}
KNOWN = {int(channel): TURNS[int(CHANNELS[0])] for channel in CHANNELS}


def asked(bench, turns):
    guide = make_guide(Method.SURFACE)
    guide.turns = TurnNeeds(CHANNELS, SETTINGS)
    return guide.update(replace(bench.session.snapshot(), turns=turns), bench.targets.get)


def test_the_guide_leans_while_a_turn_is_open_and_presses_straight_after():
    bench = GuidedBench(Method.SURFACE)
    straight = bench.guidance.target
    assert straight.tilt == pytest.approx(0.0, abs=1e-6)
    assert math.isnan(straight.turn_now)
    open_ = asked(bench, turns_of({}))
    assert LEAN_MIN_RAD <= open_.target.tilt <= np.radians(20.0)
    assert open_.target.channel == straight.channel
    assert all(Need.TURN in needs for needs in open_.needs)
    assert open_.pokes_left >= bench.guidance.pokes_left
    assert IN_PLANE_UNKNOWN in why_words(open_, open_.target, ())
    known = asked(bench, turns_of(KNOWN))
    assert known.target.tilt == straight.tilt
    assert known.needs == bench.guidance.needs
    assert known.pokes_left == bench.guidance.pokes_left


def test_successive_leaning_pushes_come_from_other_sides():
    needs = TurnNeeds(CHANNELS, SETTINGS)
    first = needs.leaning_pushes(0, np.radians(28.0))
    pushes = candidate_pushes(UP[None], np.radians(28.0))[0]
    assert sorted(first) == list(range(1, 9))
    assert np.degrees(np.arccos(-pushes[first] @ UP)) == pytest.approx([16.8] * 8)
    # A tool that slides early leans as far as it may.
    assert needs.leaning_pushes(0, np.radians(14.0))[0] >= 9
    channel = int(CHANNELS[0])
    sides = []
    for count in (1, 2, 3):
        needs.update(turns_of({channel: turn_of(channel, QUARTER, pokes=count)}))
        sides.append(needs.leaning_pushes(0, np.radians(28.0))[0])
    assert len(set(sides)) == 3


@pytest.mark.parametrize(("pokes", "lean"), [(3, 10.0), (6, 10.0), (6, 0.0)])
def test_the_predicted_gain_is_that_of_the_poke(pokes, lean):
    """Of a push of 9 N that leans by 17 degrees: the median of the fits with it."""
    predicted, made = [], []
    for seed in range(6):
        rng = np.random.default_rng([pokes, seed])
        before = make_pokes(rng, QUARTER, pokes, lean)
        azimuth, tilt = rng.uniform(0.0, 2.0 * np.pi), np.radians(17.0)
        push = QUARTER @ [np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), -np.cos(tilt)]
        one = make_pokes(rng, QUARTER, 1, 0.0)
        reading = 0.4 * 9.0 * push @ QUARTER * [0.6, 0.6, 1.0] + 0.02 * rng.normal(size=3)
        force = 9.0 * push + 0.05 * rng.normal(size=3)
        after = joined([before, replace(one, forces=force[None], readings=reading[None])])
        turn = fit_group((0,), before, NOISE)
        now, sds = in_plane_sds(turn, NOISE, UP, np.array([push, -UP]))
        assert sds[0] < now
        assert sds[1] <= now
        assert now == turn.fit.in_plane_sd
        # A straight push shows nothing of a turn about it.
        assert lean or sds[1] > 0.9 * now
        predicted.append(sds[0])
        made.append(fit_group((0,), after, NOISE).fit.in_plane_sd)
    assert np.median(predicted) == pytest.approx(np.median(made), rel=0.5)


def test_a_turn_with_few_pokes_is_open_and_its_gain_is_said():
    channel = int(CHANNELS[0])
    turns = turns_of(KNOWN | {channel: turn_of(channel, QUARTER, lean_deg=6.0, pokes=6)})
    needs = TurnNeeds(CHANNELS, SETTINGS)
    assert needs.update(turns).tolist() == list(range(1, len(CHANNELS)))
    assert needs.is_open.tolist() == [True] + [False] * (len(CHANNELS) - 1)
    push = candidate_pushes(UP[None], np.radians(28.0))[0][1]
    now, after = needs.gain(0, UP, push)
    assert SETTINGS.turn_wanted < now < np.radians(20.0)
    assert after < now
    assert all(math.isnan(value) for value in needs.gain(1, UP, push))
    assert needs.update(turns).size == 0
    everything = np.ones(len(CHANNELS), dtype=bool)
    assert 1 <= needs.count_pokes_left(everything, PART.plan.modules) <= 40
    bench = GuidedBench(Method.SURFACE)
    guidance = asked(bench, turns)
    target = replace(guidance.target, turn_now=np.radians(12.0), turn_after=np.radians(3.0))
    assert "turn from 12\N{DEGREE SIGN} to 3.0\N{DEGREE SIGN}" in why_words(guidance, target, ())


def test_modules_that_share_a_turn_are_counted_once():
    needs = TurnNeeds(np.arange(8), SETTINGS)
    modules, everything = np.repeat([0, 1], 4), np.ones(8, dtype=bool)
    needs.update(replace(turns_of({}), module_of={channel: 5 + channel // 4 for channel in range(8)}))
    assert needs.count_pokes_left(everything, modules) == 2 * 4
    # Without a layout each taxel has a turn of its own.
    needs.update(turns_of({}))
    assert needs.count_pokes_left(everything, modules) == 8 * 4


def test_a_taxel_that_needs_its_turn_alone_is_given_up_at_last():
    facts = ContactFacts(own=12, contacts=12)
    why = give_up_reason((Need.TURN,), facts, SETTINGS, patience_exhausted=True, all_sides_skipped=False, tilt=0.4)
    assert why is Why.TURN_UNKNOWN
    both = give_up_reason(
        (Need.ACCURACY, Need.TURN), facts, SETTINGS, patience_exhausted=True, all_sides_skipped=False, tilt=0.4
    )
    assert both is Why.NOT_CONVERGED
    assert Need.TURN not in find_needs(
        GuidedBench().session.snapshot().estimates[Method.FREE][0], facts, Method.FREE, SETTINGS, 0.0005
    )
