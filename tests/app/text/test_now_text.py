"""What is said and what may be done: pure functions, without a window."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.panels.readings_panel import min_max_decimation
from app.session.opening import Addresses, dated_folder, link_specs
from app.state.policies import Mark, allowed, answer_levels, curve_range, marks, worst
from app.state.running import Running
from app.state.view_state import LinkStatus
from app.text.link_text import link_texts
from app.text.now_text import (
    IDLE_PHASE_DEBOUNCE_S,
    LAST_ACTION_SHOWN_S,
    MIN_POKE_RESULT_SHOWN_S,
    NowMemory,
    Said,
    Tone,
    begin_sentence,
    now_line,
)
from skincal.contacts.outcome import RAW_UNIT, PressPhase, Reason
from skincal.model.actions import Exclude, MissedLandmark, Revive
from skincal.model.readings import LinkAnswer, LinkState, LinkVerdict, Stream
from skincal.model.scene import load_scene
from skincal.session.undo import History, LastOperation, OperationKind
from skincal.taxels.poke_figures import pitch_of, tilt_of
from skincal.taxels.result import Estimate, Method, State
from skincal.words.link_words import preview_words
from skincal.words.outcome_words import outcome_detail, outcome_headline
from skincal.words.poke_words import rejection_words
from skincal.words.taxel_words import skin_error_words, summary_words
from skincal.words.units import DASH, ChannelNames, age, count, duration, number, point_mm, quantity, rate
from tests.app.guide_support import guidance, target
from tests.app.scene3d_support import decided, estimate
from tests.app.window_support import NAMES, PLAN, SCENE, arm_scene, frame, link, reading, session, slip, touch
from tests.approved import approved


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0021, "m", "2.1 mm"),
        (-0.0021, "m", "\N{MINUS SIGN}2.1 mm"),
        (-1e-9, "m", "0.0 mm"),
        (math.pi / 6, "rad", "30\N{DEGREE SIGN}"),
        (0.5, "N m", "500 N mm"),
        (11.24, "N", "11.2 N"),
        (3, "", "3"),
        (float("nan"), "m", DASH),
        (None, "m", DASH),
    ],
)
def test_si_becomes_what_an_operator_reads(value, unit, text):
    assert quantity(value, unit) == text


@given(st.floats(allow_nan=True, allow_infinity=True), st.integers(0, 3))
def test_a_number_is_never_nan_infinite_or_minus_zero(value, decimals):
    text = number(value, decimals)
    assert "nan" not in text
    assert "inf" not in text
    assert not (text.startswith("\N{MINUS SIGN}") and not any(c in text for c in "123456789"))


def test_small_words():
    assert [rate(0.0), rate(1000.2), rate(9.95)] == [DASH, "1000 Hz", "9.9 Hz"]
    assert [age(0.1), age(1.34), age(125)] == ["now", "1.3 s ago", "2 min ago"]
    assert [duration(14.2), duration(89.6), duration(91), duration(552)] == ["14 s", "90 s", "2 min", "9 min"]
    assert [count(1, "poke"), count(2, "poke")] == ["1 poke", "2 pokes"]
    assert point_mm(np.array([0.001, -0.02, 0.0])) == "1.0  \N{MINUS SIGN}20.0  0.0"
    assert [NAMES.short(3), NAMES.short(15), NAMES.long(15)] == [
        "3",
        "15",
        approved("now.taxel_in_full", pad=3, module=11, channel=15),
    ]
    assert [ChannelNames(None).short(7), ChannelNames(None).long(7)] == ["7", "taxel 7"]


def test_a_rejection_names_its_number_and_its_limit():
    assert rejection_words(slip(1)) == approved("now.too_slid", seen_mm=2.1, most_mm=1.5)
    assert rejection_words(slip(1, Reason.TOO_SOFT, 3.1, 4.0, "N")) == approved("now.too_soft", seen=3.1, least=4.0)
    assert rejection_words(slip(1, Reason.NOT_STILL, 0.12, 0.3, "s")) == approved("now.too_short", seen=0.12, least="0.30")
    assert rejection_words(slip(1, Reason.NOT_STILL, 0.08, 0.05, "1")) == approved("now.not_still", seen=8.0, most=5.0)
    assert rejection_words(slip(1, Reason.NO_TAXEL, 0, 1, "")) == "no taxel answered", "as sessions of old have it"
    assert rejection_words(slip(1, Reason.NO_TAXEL, 4.26, 12.0, RAW_UNIT)) == approved(
        "now.none_answered", largest=4.3, needed="12.0"
    )
    assert outcome_headline(slip(1, Reason.NO_TAXEL, 4.26, 12.0, RAW_UNIT), NAMES) == "rejected: no taxel answered"
    assert rejection_words(slip(1, Reason.TARE_CHANGED, math.nan, 1.0, "N")) == "sensor zero changed"


def test_an_accepted_poke_names_the_taxel_that_answered_most_and_the_force():
    poke = touch(1, (2, 5, 4), (20.0, 90.0, 30.0))
    assert outcome_headline(poke, NAMES) == "accepted: taxel 5, 11.2 N"
    twice = slip(1, Reason.TWO_CONTACTS, 0.0123, 0.008, "m")
    assert outcome_headline(twice, NAMES) == approved("now.rejected_two_contacts")
    says = outcome_detail(twice, None, math.inf, NAMES)
    assert says == approved("now.advice_two_contacts", seen_mm=12.3, most_mm=8.0)
    assert outcome_detail(slip(1), None, math.inf, NAMES) == approved("now.advice_slid")
    assert pitch_of(poke) == pytest.approx(0.002)


def test_an_address_keeps_its_small_letters():
    refused = "socket://127.0.0.1:37709: connection refused"
    assert begin_sentence(refused) == refused
    assert begin_sentence("reconnecting automatically") == "Reconnecting automatically"


def test_tilt_is_the_angle_to_the_inward_normal():
    upward = {3: estimate(3, (0, 0, 0))}
    assert tilt_of(touch(1), upward) == pytest.approx(0.0)
    slanted = touch(1, force=(0, 5.0, -5.0))
    assert tilt_of(slanted, upward) == pytest.approx(math.pi / 4)
    # The same poke, seen from a sensor that is turned by a quarter about x.
    turned = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    force = np.linalg.inv(turned[:3, :3]) @ slanted.force
    assert tilt_of(replace(slanted, force=force, link_from_sensor=turned), upward) == pytest.approx(math.pi / 4)
    assert tilt_of(touch(1), {}) is None


def test_the_state_of_a_session_in_words():
    known = session(known={3: estimate(3, (0, 0, 0), sd=1e-3), 4: estimate(4, (0, 0, 0), sd=3e-3)})
    assert summary_words(known.estimates[Method.FREE]) == "24 taxels: 2 touched, 22 untouched"
    gap = "\N{NARROW NO-BREAK SPACE}"
    many = summary_words(known.estimates[Method.FREE] * 600)
    assert many == f"14{gap}400 taxels: 1{gap}200 touched, 13{gap}200 untouched"
    assert skin_error_words(known.estimates[Method.FREE], known.part_size) == approved(
        "now.predicted", mean_mm=3.5, worst_mm=5.2
    )
    assert skin_error_words(session().estimates[Method.FREE], math.inf) == ""


def test_a_silent_link_says_when_not_how_long_so_that_nothing_moves():
    early, late = (link_texts(link(last_s=100.0), round(now * 1e9)) for now in (103.0, 130.0))
    assert early.look is LinkStatus.SILENT
    assert early == late


def test_looks_of_links():
    def look(health, now_s=100.1):
        return link_texts(health, round(now_s * 1e9)).look

    assert look(link()) is LinkStatus.STREAMING
    assert look(link(last_s=100.0), 101.9) is LinkStatus.STREAMING
    assert look(link(last_s=100.0), 102.1) is LinkStatus.SILENT
    assert look(link(last_host_ns=0)) is LinkStatus.WAITING
    assert look(link(state=LinkState.LOST)) is LinkStatus.LOST
    assert look(link(state=LinkState.FAILED, last_host_ns=0)) is LinkStatus.LOST
    assert look(link(state=LinkState.ENDED)) is LinkStatus.ENDED
    away = link_texts(link(state=LinkState.LOST), round(100.1e9), connected=False)
    assert (away.look, away.detail) == (LinkStatus.NOT_READ, "")
    assert link_texts(link(), round(100.1e9)).short == "force/torque sensor 1000 Hz"
    assert link_texts(link(), 0).losses == ((approved("now.checksum"), 3),)


def say(memory, at):
    """What came of the newest poke, where that is said, else what to do."""
    now, memory = now_line(memory, at)
    return now.headline if now.result is None else now.result.words, memory


def test_a_verdict_stays_long_enough_to_be_read_and_gives_way_to_the_next_poke():
    quiet = frame(session(1), reading(PressPhase.READY), 100.0)
    memory = NowMemory.from_snapshot(quiet.snapshot)
    _, memory = say(memory, quiet)
    text, memory = say(memory, frame(session(1), reading(PressPhase.READY), 100.0 + IDLE_PHASE_DEBOUNCE_S))
    assert text == "Ready"
    done = session(2, pokes=[slip(1)])
    text, memory = say(memory, frame(done, reading(PressPhase.TARING), 101.0))
    assert text == approved("now.rejected_slid", poke=1, seen_mm=2.1, most_mm=1.5)
    text, memory = say(memory, frame(done, reading(PressPhase.READY), 101.0 + MIN_POKE_RESULT_SHOWN_S - 0.01))
    assert text.startswith("Poke 1 rejected")
    text, _ = say(memory, frame(done, reading(PressPhase.PRESSING, 8.0), 101.5))
    assert text == "Hold still"
    text, memory = say(memory, frame(done, reading(PressPhase.READY), 101.0 + MIN_POKE_RESULT_SHOWN_S + 0.01))
    assert text == "Ready"


def test_a_poke_that_was_there_before_is_not_announced():
    old = session(1, pokes=[touch(1)])
    text, _ = say(NowMemory.from_snapshot(old), frame(old, reading(PressPhase.NO_DATA)))
    assert text == "Waiting for data"


def test_the_final_form_of_the_same_verdict_is_not_announced_again_but_another_is():
    first = session(1, pokes=[touch(1)])
    _, memory = say(NowMemory(), frame(first, reading(PressPhase.READY), 10.0))
    again = session(2, pokes=[touch(1)])
    text, memory = say(memory, frame(again, reading(PressPhase.READY), 10.0 + MIN_POKE_RESULT_SHOWN_S + 1))
    assert text == "Ready"
    turned = session(3, pokes=[slip(1, Reason.TARE_CHANGED, 1.4, 1.0, "N")])
    text, memory = say(memory, frame(turned, reading(PressPhase.READY), 20.0))
    assert text == approved("now.rejected_tare", poke=1)


def test_a_flicker_between_calm_phases_is_not_said():
    memory = NowMemory()
    said = []
    for i in range(40):
        phase = PressPhase.READY if i % 10 else PressPhase.TARING
        text, memory = say(memory, frame(view=reading(phase), now_s=10.0 + 0.033 * i))
        said.append(text)
    assert "Hands off" not in said
    assert said[-1] == "Ready"


def test_what_is_said_while_pressing():
    def pressed(phase, force):
        return now_line(NowMemory(), frame(view=reading(phase, force)))[0]

    assert pressed(PressPhase.PRESSING, 2.0).headline == "Press harder"
    assert pressed(PressPhase.PRESSING, 16.0).headline == "Press softer"
    assert pressed(PressPhase.STILL, 8.0).headline == "Hold still"
    assert pressed(PressPhase.HELD, 8.0).headline == "Release"


def test_trouble_goes_before_phases():
    lost = (link(state=LinkState.LOST, text="/dev/x was lost; plug it in."),)
    now, _ = now_line(NowMemory(), frame(view=reading(PressPhase.READY, links=lost)))
    assert (now.tone, now.headline, now.detail) == (
        Tone.BAD,
        "Force/torque sensor lost",
        "/dev/x was lost; plug it in.",
    )
    paused, _ = now_line(NowMemory(), frame(view=reading(PressPhase.PRESSING, 5.0), running=Running.PAUSED))
    assert paused.headline == "Paused"
    fresh = session(2, pokes=[touch(1)])
    now, _ = now_line(NowMemory(), frame(fresh, reading(PressPhase.READY, links=lost)))
    assert now.headline == "Force/torque sensor lost"
    waiting = (link(last_host_ns=0), link("skin"))
    now, _ = now_line(NowMemory(), frame(view=reading(PressPhase.NO_DATA, links=waiting), now_s=100.1))
    assert now.headline == "Waiting for sensor"


def test_a_link_without_good_readings_is_said_in_place_of_waiting():
    width = LinkVerdict(LinkAnswer.OTHER_WIDTH, Stream.SKIN, width=20, expected=64)
    links = (link(), link("skin", verdict=width))
    now, _ = now_line(NowMemory(), frame(view=reading(PressPhase.NO_DATA, links=links), now_s=100.1))
    assert (now.tone, now.headline.partition(":")[0]) == (Tone.BAD, "Skin")
    assert now.detail.startswith(approved("links.other_width", width=20, of="the scene has", expected=64))
    listening = (link(), link("skin", verdict=LinkVerdict(LinkAnswer.LISTENING, Stream.SKIN)))
    now, _ = now_line(NowMemory(), frame(view=reading(PressPhase.NO_DATA, links=listening), now_s=100.1))
    assert now.headline == "Waiting for skin"
    frozen = (link(verdict=LinkVerdict(LinkAnswer.FROZEN, Stream.WRENCH)), link("skin"))
    now, _ = now_line(NowMemory(), frame(view=reading(PressPhase.READY, links=frozen), now_s=100.1))
    assert (now.tone, now.headline, now.detail) == (
        Tone.BAD,
        "Force/torque sensor stuck",
        "It sends the same reading again and again",
    )


def test_a_link_without_readings_names_the_nearest_form_and_what_the_decoder_says():
    verdict = LinkVerdict(LinkAnswer.NO_READING, Stream.SKIN, line="$SKIN,1,2*00", nearest="$SKIN,1,2,3,4*1B")
    said = approved("links.no_reading_nearest", nearest=verdict.nearest)
    assert preview_words(link("skin", verdict=verdict)) == said
    unread = link("skin", verdict=verdict, text="Checksum *00 of a line is wrong; expected *1B")
    assert preview_words(unread) == f"{said}. {unread.text}"
    now, _ = now_line(NowMemory(), frame(view=reading(PressPhase.NO_DATA, links=(link(), unread)), now_s=100.1))
    assert verdict.line in now.detail


@pytest.mark.parametrize(
    ("answer", "look"),
    [
        (LinkAnswer.GOOD, LinkStatus.STREAMING),
        (LinkAnswer.LISTENING, LinkStatus.WAITING),
        (LinkAnswer.NO_READING, LinkStatus.WRONG),
        (LinkAnswer.OTHER_STREAM, LinkStatus.WRONG),
        (LinkAnswer.OTHER_WIDTH, LinkStatus.WRONG),
        (LinkAnswer.FROZEN, LinkStatus.FROZEN),
    ],
)
def test_a_light_is_that_of_a_good_link_for_good_readings_alone(answer, look):
    assert link_texts(link(verdict=LinkVerdict(answer, Stream.WRENCH)), round(100.1e9)).look is look


@pytest.mark.parametrize("phase", [PressPhase.TARING, PressPhase.READY])
def test_an_unknown_arm_pose_is_asked_before_anything_else_is(phase):
    unknown = reading(phase, pose="", link_from_sensor=None)
    now, _ = now_line(NowMemory(phase=phase), frame(session(), unknown, where=arm_scene()))
    assert (now.tone, now.headline) == (Tone.GO, "Choose the arm pose")
    assert "low, high" in now.detail
    joints = (link(), link("joints", last_host_ns=0))
    now, _ = now_line(NowMemory(phase=phase), frame(session(), replace(unknown, links=joints), where=arm_scene()))
    assert now.headline == "Waiting for the joints"
    known, _ = now_line(NowMemory(phase=phase), frame(session(), reading(phase), where=arm_scene()))
    assert "pose" not in known.headline


def test_what_may_be_done_follows_the_selection():
    pokes = [touch(1), slip(2), touch(3), touch(4)]
    at = session(1, {3: estimate(3, (0, 0, 0))}, pokes, excluded=[3], dead={7: "stuck"})
    may = allowed(at, Running.STREAMING, [1, 2, 3], 7)
    assert (may.exclude, may.taxel) == ((Exclude(1),), Revive(7))
    assert (may.export, may.switch_method, may.undo, may.space) == (True, True, "poke 4", "Pause")
    assert not may.another
    assert not may.verdict
    guided = allowed(at, Running.STREAMING, [], None, guidance(target(3)))
    assert (guided.another, guided.verdict, guided.ends, guided.space) == (True, True, False, "Pause")
    empty = allowed(session(), Running.OFFLINE, [], None)
    assert (empty.export, empty.exclude, empty.taxel, empty.undo, empty.space) == (False, (), None, "", "Connect")


@pytest.mark.parametrize(
    ("running", "space", "pause"),
    [
        (Running.STREAMING, "Verdict", "Pause"),
        (Running.PAUSED, "Continue", "Continue"),
        (Running.OFFLINE, "Connect", "Connect"),
        (Running.OPENING, "", ""),
    ],
)
def test_the_space_bar_shows_the_verdict_once_it_is_enough_and_p_still_pauses(running, space, pause):
    enough = guidance(None, done=PLAN.channels.tolist())
    may = allowed(session(), running, [], None, enough)
    assert (may.space, may.pause, may.ends) == (space, pause, space == "Verdict")
    assert may.verdict


def test_marks_and_the_worst():
    blind = Estimate(5, Method.FREE, State.BLIND, 1)
    known = {3: estimate(3, (0, 0, 0), sd=1e-3), 4: estimate(4, (0, 0, 0), sd=5e-3), 5: blind}
    known[6] = Estimate(6, Method.FREE, State.DEAD, 0)
    estimates = session(known=known).estimates[Method.FREE]
    found = marks(estimates, 24)
    shown = [Mark(int(found[channel])) for channel in (0, 3, 4, 5, 6)]
    assert shown == [Mark.UNSEEN, Mark.GOOD, Mark.ROUGH, Mark.BLIND, Mark.DEAD]
    ordered = [e.channel for e in worst(estimates, 24)]
    assert ordered[:-3] == sorted(set(range(24)) - {3, 4, 5, 6}), "never poked"
    assert ordered[-3:] == [5, 4, 3]
    assert 6 not in ordered


def test_an_axis_grows_at_once_and_shrinks_only_when_little_of_it_is_used():
    half = curve_range(0.0, 3.2, 1.0)
    assert half == 5.0
    assert curve_range(half, 4.9, 1.0) == 5.0
    assert curve_range(half, 5.1, 1.0) == 10.0
    assert curve_range(10.0, 4.0, 1.0) == 10.0
    assert curve_range(10.0, 3.0, 1.0) == 5.0
    assert curve_range(10.0, 0.0, 1.0) == 1.0


@given(st.floats(0, 1e6), st.floats(0, 1e6))
def test_an_axis_never_clips(shown, largest):
    assert curve_range(shown, largest, 1.0) >= largest


def test_answers_are_faint_at_the_threshold_full_at_ten_times_and_nan_is_none():
    delta = SCENE.contacts.response_min
    levels = answer_levels(np.array([0.0, 0.3 * delta, delta, 10 * delta, 100 * delta, np.nan, -50.0]), SCENE.contacts)
    assert levels.tolist() == [0.0, 0.0, 0.15, 1.0, 1.0, 0.0, 0.0]


def test_decimation_keeps_every_peak_and_stays_while_time_goes_on(rng):
    times = np.sort(rng.uniform(0, 10, 10_000))
    values = rng.normal(size=(10_000, 6))
    values[1234, 2] = 50.0
    values[7000, 4] = -50.0
    when, reduced = min_max_decimation(times, values, 500, 10.0)
    assert len(when) <= 1002
    assert np.all(np.diff(when) >= 0)
    assert reduced.max(axis=0).tolist() == values.max(axis=0).tolist()
    assert reduced.min(axis=0).tolist() == values.min(axis=0).tolist()
    # A second later the columns that are still there hold the same values.
    kept = times > 1.0
    later, shown = min_max_decimation(np.append(times[kept], 10.5), np.append(values[kept], values[:1], axis=0), 500, 10.0)
    old, new = dict(zip(when, reduced[:, 0], strict=True)), dict(zip(later, shown[:, 0], strict=True))
    both = [t for t in new if t in old and t > 1.1]
    assert len(both) > 800
    assert all(old[t] == new[t] for t in both)


def test_decimation_of_few_points_is_the_points():
    times, values = np.arange(10.0), np.arange(20.0).reshape(10, 2)
    assert min_max_decimation(times, values, 500, 10.0)[1] is values


def test_a_device_that_carries_both_streams_is_one_link():
    both = link_specs(Addresses("socket://h:1", "socket://h:1", ""))
    assert [(s.name, s.carries) for s in both] == [("board", (Stream.WRENCH, Stream.SKIN))]
    three = link_specs(Addresses("a", "b", "c"))
    assert [s.name for s in three] == ["wrench", "skin", "joints"]


def test_sessions_get_folders_of_their_own(tmp_path):
    now = datetime(2026, 5, 4, 3, 2, 1, tzinfo=UTC)
    first = dated_folder(tmp_path, now)
    first.mkdir()
    assert first.name == "2026-05-04_03-02-01"
    assert dated_folder(tmp_path, now).name == "2026-05-04_03-02-01_2"


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (OperationKind.UNDONE, approved("now.taken_back", what="poke 438")),
        (OperationKind.REDONE, approved("now.brought_again", what="poke 438")),
        (OperationKind.DONE, approved("now.done", what="poke 438")),
    ],
)
def test_what_was_taken_back_is_said_with_the_key_that_brings_it_again_also_while_the_next_poke_presses(kind, words):
    poke = touch(438)
    memory = NowMemory.from_snapshot(session(1, pokes=[poke]))
    after = replace(session(2, pokes=[poke], excluded=[438]), history=History(last=LastOperation(1, kind, "poke 438")))
    now, memory = now_line(memory, frame(after, reading(PressPhase.PRESSING, 8.0), 100.0))
    assert now.result == Said(Tone.CALM, words)
    assert now.headline == "Hold still", "beside what to do, not in its place"
    now, memory = now_line(memory, frame(after, reading(PressPhase.READY), 100.0 + LAST_ACTION_SHOWN_S - 0.1))
    assert now.result is not None
    now, _ = now_line(memory, frame(after, reading(PressPhase.READY), 100.0 + LAST_ACTION_SHOWN_S + 0.1))
    assert now.result is None
    now, _ = now_line(memory, frame(replace(after, pokes=(*after.pokes, *session(1, pokes=[touch(439)]).pokes)), now_s=101.0))
    assert now.result == Said(Tone.GOOD, "Poke 439 accepted: taxel 3, 11.2 N"), "a poke that ends is newer"


def test_what_was_done_before_the_session_was_opened_is_no_news():
    old = replace(session(2), history=History(last=LastOperation(3, OperationKind.UNDONE, "poke 5")))
    now, _ = now_line(NowMemory.from_snapshot(old), frame(old))
    assert now.result is None


def test_until_a_poke_counts_the_line_says_what_each_method_costs():
    costs = {Method.MODULES: 28, Method.SURFACE: 517}
    now, memory = now_line(NowMemory(), replace(frame(), costs=costs))
    assert now.result == Said(Tone.CALM, approved("now.costs", modules=30, surface=520))
    assert now_line(NowMemory(), replace(frame(), costs={Method.FREE: 500}))[0].result is None, "nothing to choose"
    poked = session(2, pokes=[touch(1)])
    now, _ = now_line(NowMemory.from_snapshot(poked), replace(frame(poked), costs=costs))
    assert now.result is None
    assert memory.deed is None


def test_a_poke_far_off_its_landmark_is_told_with_its_number():
    words = (
        approved("now.missed", poke=1, name="corner", seen_mm=52, most_mm=34),
        approved("now.missed_counts", poke=1, taxel="3", name="corner", seen_mm=52, most_mm=34),
    )
    for poke, said, tone in zip((slip(1, Reason.NO_TAXEL), touch(1)), words, (Tone.BAD, Tone.GOOD), strict=True):
        missed = decided(session(2, pokes=[poke]), missed_landmarks={1: MissedLandmark(1, "corner", 0.052, 0.0341)})
        now, _ = now_line(now_line(NowMemory(), frame())[1], frame(missed))
        assert now.result == Said(tone, said)


@pytest.mark.parametrize(
    ("sensor", "taring", "waiting"),
    [
        ("tool", ("Hold the tool above the part", "Zeroing sensor and skin"), "Sensor, skin and tool"),
        ("none", ("Hold the tip above the part", "Measuring the skin at rest"), "Skin and tool"),
    ],
)
def test_a_rig_with_a_tool_is_told_to_hold_it_and_names_its_streams(tmp_path, sensor, taring, waiting):
    (tmp_path / "scene.toml").write_text(
        f'name = "p"\nlink = "base"\n[skin]\nchannels = 9\n[tool]\nsensor = "{sensor}"\ntip_mm = [0, 0, 99]\n'
    )
    at = frame(view=replace(reading(PressPhase.TARING), link_from_sensor=np.eye(4)), where=load_scene(tmp_path / "scene.toml"))
    now = now_line(NowMemory(phase=PressPhase.TARING), at)[0]
    assert now.headline == taring[0]
    assert now.detail.startswith(taring[1])
    silent = replace(at, live=replace(at.live, progress=replace(at.live.progress, phase=PressPhase.NO_DATA), links=()))
    assert now_line(NowMemory(phase=PressPhase.NO_DATA), silent)[0].detail == f"{waiting} must stream before a poke counts"
