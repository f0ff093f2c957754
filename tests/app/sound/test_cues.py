"""Which sound is due when: one poke after another, nothing of old ones, and what a small device gets to play of it."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from guide_support import guidance, target
from window_support import NAMES, frame, link, reading, session, slip, touch

from app.sound.cues import (
    CUE_PEAK_OVER_FULL_SCALE,
    DEVICE_LOST_ALARM_PERIOD_S,
    MAX_CUE_LENGTH_S,
    NOTE_FADE_TIME_S,
    SAMPLE_RATE_HZ,
    Cue,
    CueMemory,
    DueCue,
    due_cue,
    samples_of,
)
from app.state.running import Running
from app.text.now_text import NowMemory, now_line
from skincal.contacts.outcome import PressPhase, Reason
from skincal.model.readings import LinkState
from skincal.taxels.result import Method
from tests.approved import approved

READY, PRESSING, STILL, HELD = PressPhase.READY, PressPhase.PRESSING, PressPhase.STILL, PressPhase.HELD


def at(phase=READY, pokes=(), guided=None, now_s=100.0, lost=(), **changes):
    """A frame; `lost` are links that are lost."""
    names = ("wrench", "skin")
    links = [link(n, LinkState.LOST if n in lost else LinkState.OPEN, last_s=now_s) for n in names]
    made = frame(session(pokes=pokes), reading(phase, links=tuple(links)), now_s, **changes)
    return replace(made, guidance=guided)


def cues_of(*frames, memory=None):
    """What is heard in these frames, None where nothing is."""
    memory, sounds = memory or CueMemory(), []
    for each in frames:
        due, memory = due_cue(memory, each)
        sounds.append(None if due is None else due.sound)
    return sounds


ONE, AGAIN = (touch(1),), (touch(1),)
EVERY = tuple(range(24))
NONE_DONE, ONE_DONE = guidance(target(5)), guidance(target(5), done=(3,))
NEARLY, ENOUGH = guidance(target(5), done=EVERY[:-1]), guidance(done=EVERY)
SURFACE = guidance(target(5), done=(3, 4), method=Method.SURFACE)


@pytest.mark.parametrize(
    ("frames", "heard"),
    [
        (
            [*map(at, (READY, PRESSING, PRESSING, STILL, HELD, HELD)), at(pokes=ONE), at(pokes=ONE)],
            [None, Cue.CONTACT, None, None, Cue.HELD, None, Cue.ACCEPTED, None],
        ),
        (map(at, (HELD, STILL, HELD)), [Cue.HELD, None, None]),
        (map(at, (HELD, READY, PRESSING, HELD)), [Cue.HELD, None, Cue.CONTACT, Cue.HELD]),
        # The final form of an outcome is not heard again, another outcome is.
        (
            [at(), at(pokes=ONE), at(pokes=AGAIN), at(pokes=(slip(1, Reason.TARE_CHANGED),))],
            [None, Cue.ACCEPTED, None, Cue.REJECTED],
        ),
        # A finished taxel rings instead of the accepted poke, also if the tare after the poke finishes it.
        ([at(guided=NONE_DONE), at(pokes=ONE, guided=ONE_DONE)], [None, Cue.DONE]),
        (
            [at(guided=NONE_DONE), at(pokes=ONE, guided=NONE_DONE), at(pokes=AGAIN, guided=ONE_DONE)],
            [None, Cue.ACCEPTED, Cue.DONE],
        ),
        # Only a poke rings: not the guide, a change of the method, a later calculation or undo.
        ([at(pokes=ONE), at(pokes=ONE, guided=ONE_DONE)], [Cue.ACCEPTED, None]),
        ([at(pokes=ONE, guided=NONE_DONE), at(pokes=ONE, guided=SURFACE)], [Cue.ACCEPTED, None]),
        ([at(pokes=ONE, guided=NONE_DONE), at(pokes=ONE, guided=ONE_DONE)], [Cue.ACCEPTED, None]),
        ([at(pokes=(*ONE, slip(2)), guided=NONE_DONE), at(pokes=ONE, guided=ONE_DONE)], [Cue.REJECTED, None]),
        # The end of the session is a chord, once, if it comes while the guide serves the same method.
        ([at(guided=NEARLY), at(pokes=ONE, guided=ENOUGH), at(pokes=ONE, guided=ENOUGH)], [None, Cue.ENOUGH, None]),
        ([at(), at(guided=ENOUGH)], [None, None]),
        ([at(guided=NEARLY), at(guided=guidance(done=EVERY, method=Method.SURFACE))], [None, None]),
    ],
)
def test_what_is_heard_in_each_frame(frames, heard):
    assert cues_of(*frames) == heard


def test_a_rejection_comes_with_its_word():
    _, memory = due_cue(CueMemory(), at())
    due, _ = due_cue(memory, at(pokes=(slip(1, Reason.TOO_SOFT),)))
    assert due == DueCue(Cue.REJECTED, "too soft")


def test_earlier_and_undone_pokes_are_not_heard():
    three = (touch(1), touch(2), slip(3))
    memory = CueMemory.from_snapshot(session(pokes=three))
    assert cues_of(at(pokes=three), at(pokes=three[:2]), at(pokes=three[:1]), at(), memory=memory) == [None] * 4
    assert cues_of(at(pokes=three), at(pokes=(*three, touch(4))), memory=memory) == [None, Cue.ACCEPTED]


def test_a_lost_device_is_heard_slowly_and_nothing_else_meanwhile():
    times = np.arange(100.0, 100.0 + 2.5 * DEVICE_LOST_ALARM_PERIOD_S, 0.5)
    sounds = cues_of(*(at(now_s=t, lost=("skin",)) for t in times))
    assert [t - 100.0 for t, sound in zip(times, sounds, strict=True) if sound is Cue.LOST] == [
        0.0,
        DEVICE_LOST_ALARM_PERIOD_S,
        2 * DEVICE_LOST_ALARM_PERIOD_S,
    ]
    assert cues_of(at(now_s=1, lost=("skin",)), at(now_s=2, lost=("skin", "wrench"))) == [Cue.LOST, Cue.LOST]
    assert cues_of(at(lost=("skin",)), at(PRESSING, (touch(1),), lost=("skin",)), at(READY, (touch(1),))) == [
        Cue.LOST,
        None,
        None,
    ]


@pytest.mark.parametrize("running", [Running.PAUSED, Running.OFFLINE, Running.OPENING])
def test_nothing_is_heard_while_nothing_streams(running):
    frames = (at(), at(PRESSING, (touch(1),), lost=("skin",), running=running), at(READY, (touch(1),)))
    assert cues_of(*frames) == [None, None, None]


def test_whatever_is_heard_is_said_in_the_same_frame():
    nearly = guidance(target(5), done=tuple(range(2)))
    rung, enough = guidance(target(5), done=tuple(range(3))), guidance(done=tuple(range(24)))
    pokes = (touch(1), slip(2), touch(3), touch(4))
    frames = {
        Cue.CONTACT: at(PRESSING, guided=nearly),
        Cue.HELD: at(HELD, guided=nearly),
        Cue.ACCEPTED: at(READY, pokes[:1], nearly),
        Cue.REJECTED: at(READY, pokes[:2], nearly),
        Cue.DONE: at(READY, pokes[:3], rung),
        Cue.ENOUGH: at(READY, pokes, enough),
        Cue.LOST: at(READY, pokes, enough, lost=("skin",)),
    }
    said = {
        Cue.CONTACT: "Press harder",
        Cue.HELD: "Release",
        Cue.ACCEPTED: "Poke 1 accepted for taxel 3",
        Cue.REJECTED: "rejected: tip slid",
        Cue.DONE: f"taxel newly finished: {NAMES.short(2)}",
        Cue.ENOUGH: approved("guide.enough", count=24),
        Cue.LOST: "Skin lost",
    }
    assert set(said) == set(Cue)
    cues, line = due_cue(CueMemory(), at(guided=nearly))[1], now_line(NowMemory(), at(guided=nearly))[1]
    for sound, each in frames.items():
        due, cues = due_cue(cues, each)
        now, line = now_line(line, each)
        assert due is not None
        assert due.sound is sound
        assert said[sound] in f"{now.result.words if now.result else ''} {now.headline} {now.detail}"


def test_taxels_that_one_poke_finishes_are_named_until_there_are_too_many():
    _, memory = now_line(NowMemory(), at(guided=guidance(target(5))))
    for done, words in (
        ((1, 2), f"2 taxels newly finished: {NAMES.short(1)}, {NAMES.short(2)}"),
        (tuple(range(5)), f"5 taxels newly finished: {NAMES.short(0)}, {NAMES.short(1)}, {NAMES.short(2)}, ..."),
    ):
        now, _ = now_line(memory, at(pokes=(touch(1),), guided=guidance(target(5), done=done)))
        assert words in now.detail
        assert now.headline == approved("guide.straight", taxel=NAMES.short(5))


def wave(sound: Cue) -> np.ndarray:
    return np.frombuffer(samples_of(sound), np.int16) / np.iinfo(np.int16).max


def rhythm(sound: Cue) -> list[tuple[float, float]]:
    """Begin and length of each beat of a sound, s, by how loud it is."""
    loud = np.convolve(np.abs(wave(sound)), np.ones(96) / 96.0, "same") > 0.02
    edges = np.flatnonzero(np.diff(np.concatenate([[False], loud, [False]]).astype(int)))
    return [(a / SAMPLE_RATE_HZ, (b - a) / SAMPLE_RATE_HZ) for a, b in edges.reshape(-1, 2)]


@pytest.mark.parametrize("sound", Cue)
def test_a_sound_is_short_never_too_loud_and_begins_and_ends_softly(sound):
    heard_ = wave(sound)
    assert 0.01 < len(heard_) / SAMPLE_RATE_HZ <= MAX_CUE_LENGTH_S
    assert np.abs(heard_).max() == pytest.approx(CUE_PEAK_OVER_FULL_SCALE, abs=1e-3)
    edge = round(0.1 * NOTE_FADE_TIME_S * SAMPLE_RATE_HZ)
    assert np.abs(heard_[:edge]).max() < 0.03
    assert np.abs(heard_[-edge:]).max() < 0.03
    assert abs(heard_.mean()) < 0.01
    assert samples_of(sound) == samples_of(sound)


@pytest.mark.parametrize(("one", "other"), list(itertools.combinations(Cue, 2)))
def test_any_two_sounds_differ_in_rhythm(one, other):
    """In the count of beats, or in the length of one by a third and at least 15 ms: what an memory tells apart."""
    first, second = rhythm(one), rhythm(other)
    if len(first) != len(second):
        return
    lengths = [abs(a[1] - b[1]) / max(a[1], b[1]) for a, b in zip(first, second, strict=True)]
    apart = [abs(a[1] - b[1]) for a, b in zip(first, second, strict=True)]
    assert any(share > 1 / 3 and gap > 0.015 for share, gap in zip(lengths, apart, strict=True)), (first, second)


def test_a_rejection_sounds_low_and_an_acceptance_rises():
    def pitch(part: np.ndarray) -> float:
        return float(np.argmax(np.abs(np.fft.rfft(part, SAMPLE_RATE_HZ))))

    low, rising = wave(Cue.REJECTED), wave(Cue.ACCEPTED)
    assert pitch(low) < 250
    assert pitch(rising[: round(0.03 * SAMPLE_RATE_HZ)]) + 200 < pitch(rising[round(0.045 * SAMPLE_RATE_HZ) :])
