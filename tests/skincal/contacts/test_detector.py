"""Pokes found in synthesised samples: numbers against the truth, every reason, order, determinism."""

import dataclasses

import numpy as np
import pytest

from skincal.contacts.detector import ContactDetector
from skincal.contacts.outcome import RAW_UNIT, Contact, PressPhase, Reason, Rejection
from skincal.geometry import Arm, DhLink
from skincal.model.scene import ArmSpec, ContactSettings
from tests.skincal.poke_script import PERIOD_S, Script, outcome_key, small_scene, some_pokes

FORCE = np.array([1.0, 2.0, -8.0])
POINT = np.array([0.02, 0.05, 0.10])
ANSWERS = {3: 80.0, 7: 40.0}


def quiet_script(**options):
    return Script(small_scene(), **options).quiet(1.0)


def only(outcomes, *, final=True):
    (outcome,) = [each for each in outcomes if each.final == final]
    return outcome


def rejected(script, reason, *, final=True, **how):
    outcome = only(script.run(**how), final=final)
    assert isinstance(outcome, Rejection), outcome
    assert outcome.reason is reason
    return outcome


def arm_spec():
    return ArmSpec(Arm((0,), (DhLink(0.1, 0.0, 0.0, 0.0),), np.eye(4)), {"up": np.zeros(1), "down": np.ones(1)})


def test_a_contact_has_the_force_and_moment_of_the_truth():
    contact = only(quiet_script().press(FORCE, POINT, ANSWERS).quiet().run())
    assert isinstance(contact, Contact)
    np.testing.assert_allclose(contact.force, FORCE, atol=1e-9)
    np.testing.assert_allclose(contact.moment, np.cross(POINT, FORCE), atol=1e-9)
    assert contact.channels.tolist() == [3, 7]
    np.testing.assert_allclose(contact.responses, [80.0, 40.0], atol=1e-9)


def test_with_noise_the_force_is_right_to_the_noise_of_its_means():
    errors = []
    for seed in range(12):
        script = Script(small_scene(), np.random.default_rng(seed), force_noise=0.05, moment_noise=0.004, skin_noise=1.0)
        contact = only(script.quiet().press(FORCE, POINT, ANSWERS).quiet().run())
        assert isinstance(contact, Contact)
        errors.append(contact.force - FORCE)
    # 15 frames held and 10 to 20 of quiet: 0.05 sqrt(1/15 + 1/10) = 0.02 N.
    assert 0.008 < np.std(errors) < 0.03


def test_offset_and_linear_drift_vanish_exactly():
    script = quiet_script(drift=np.array([0.2, -0.1, 0.3, 0.01, -0.02, 0.03]))
    outcomes = script.press(FORCE, POINT, ANSWERS).quiet().run()
    first, second = only(outcomes, final=False), only(outcomes)
    np.testing.assert_allclose(second.force, FORCE, atol=1e-9)
    np.testing.assert_allclose(second.moment, np.cross(POINT, FORCE), atol=1e-9)
    assert np.isnan(first.tare_change)
    assert np.abs(first.force - FORCE).max() > 0.05  # the tare before alone leaves the drift in
    assert second.tare_change == pytest.approx(np.linalg.norm([0.2, -0.1, 0.3]) * 1.5, rel=0.5)


def test_a_falling_skin_answers_too():
    script = Script(small_scene(polarity=-1)).quiet().press(FORCE, POINT, ANSWERS).quiet()
    assert only(script.run()).responses == pytest.approx([80.0, 40.0])


def test_without_a_layout_every_channel_is_a_candidate():
    script = Script(small_scene(channels=40, layout=False)).quiet().press(FORCE, POINT, {1: 50.0, 39: 20.0}).quiet()
    assert only(script.run()).channels.tolist() == [1, 39]


def test_a_channel_outside_the_layout_does_not_answer():
    script = Script(small_scene(channels=30)).quiet().press(FORCE, POINT, {3: 50.0, 27: 90.0}).quiet()
    assert only(script.run()).channels.tolist() == [3]


def test_the_outcome_comes_with_the_first_sample_below_the_release_force():
    detector = ContactDetector(small_scene())
    script = quiet_script().press(FORCE, POINT, ANSWERS).quiet()
    release = None
    for sample in script.samples:
        tared = np.linalg.norm(sample.wrench[:3] - script.offset[:3])
        outcomes = detector.feed(sample, np.eye(4), "")
        if outcomes and release is None:
            release = tared
            assert not outcomes[0].final
            break
    assert release is not None
    assert release < 0.6
    assert detector.progress(np.eye(4)).phase is PressPhase.READY


def test_noise_about_the_release_force_neither_ends_nor_begins_a_poke():
    script = quiet_script()
    script.press(FORCE, POINT, ANSWERS, hold_s=0.4)
    for k in range(30):  # between release and touch force, from above: still the same poke
        script.step(np.r_[FORCE / np.linalg.norm(FORCE) * (0.95 if k % 2 else 0.65), np.zeros(3)], {})
    assert len([each for each in script.quiet().run() if each.final]) == 1
    idle = quiet_script()
    for k in range(30):  # from below: none begins
        idle.step(np.r_[0, 0, 0.95 if k % 2 else 0.65, np.zeros(3)], {})
    assert not idle.quiet().run()


def test_pokes_are_numbered_and_ordered():
    outcomes = some_pokes(small_scene(), 5).run()
    assert [outcome.poke for outcome in outcomes if not outcome.final] == [1, 2, 3, 4, 5]
    assert [outcome.poke for outcome in outcomes if outcome.final] == [1, 2, 3, 4, 5]
    assert [(outcome.poke, outcome.final) for outcome in outcomes] == [(n, f) for n in range(1, 6) for f in (False, True)]


def test_a_poke_right_after_another_shares_the_tares_around_both():
    script = quiet_script(drift=np.array([0.2, 0, 0, 0, 0, 0.01]))
    script.press(FORCE, POINT, ANSWERS).quiet(0.08).press(FORCE, POINT, ANSWERS).quiet()
    outcomes = script.run()
    assert [(outcome.poke, outcome.final) for outcome in outcomes] == [(1, False), (2, False), (1, True), (2, True)]
    for outcome in outcomes[2:]:
        np.testing.assert_allclose(outcome.force, FORCE, atol=1e-9)


def test_the_same_samples_give_the_same_outcomes_bit_for_bit():
    script = some_pokes(small_scene(), 4)
    assert [outcome_key(each) for each in script.run()] == [outcome_key(each) for each in script.run()]


def press(**how):
    return quiet_script().press(FORCE, POINT, ANSWERS, **how).quiet()


def saturated(**change):
    script = quiet_script().press(FORCE, POINT, ANSWERS)
    script.samples[-20] = dataclasses.replace(script.samples[-20], **change)
    return script.quiet()


def lost_readings():
    script = quiet_script().press(FORCE, POINT, ANSWERS, hold_s=0.4)
    del script.samples[-14:-8]
    return script.quiet()


def two_contacts():
    script = quiet_script()
    for _ in range(30):
        script.step(TWO_CONTACTS, ANSWERS)
    return script.quiet()


def never_quiet():
    script = quiet_script()
    for k in range(600):
        script.step(np.r_[0, 0, 0.45 * (-1) ** k, np.zeros(3)])
    return script.press(FORCE, POINT, ANSWERS).quiet()


def changed_tare():
    script = quiet_script().press(FORCE, POINT, ANSWERS)
    script.offset = script.offset + np.array([0.55, 0, 0, 0, 0, 0])
    script.scene = dataclasses.replace(script.scene, contacts=ContactSettings(tare_change_max=0.5))
    return script.quiet()


SIZE = np.linalg.norm(FORCE)
LAYOUT = small_scene().skin.layout
FAR = np.linalg.norm(LAYOUT.places[5] - LAYOUT.places[1])
SPEED = np.array([0.01, 0.0, 0.0])
ACROSS = np.linalg.norm(SPEED - FORCE * (SPEED @ FORCE) / SIZE**2) * 14 * PERIOD_S
"""m, travel within the 14 periods of a still window."""
SECOND = np.array([0, 4.0, 0])
TWO_CONTACTS = np.r_[FORCE + SECOND, np.cross(POINT, FORCE) + np.cross([-0.06, 0.0, 0.0], SECOND)]
TWO_PITCH = abs(TWO_CONTACTS[:3] @ TWO_CONTACTS[3:]) / (TWO_CONTACTS[:3] @ TWO_CONTACTS[:3])


def sparse():
    """Make a press of 0.46 s that lacks every second sample: too few for a still window, and no gap of three periods."""
    script = quiet_script()
    start = len(script.samples)
    script.press(FORCE, POINT, ANSWERS, hold_s=0.4)
    del script.samples[start::2]
    return script.quiet()


CASES = {
    "too soft": (lambda: quiet_script().press(FORCE * 0.4, POINT, ANSWERS).quiet(), Reason.TOO_SOFT, SIZE * 0.4, 4.0, "N"),
    "too hard": (lambda: quiet_script().press(FORCE * 2.5, POINT, ANSWERS).quiet(), Reason.TOO_HARD, SIZE * 2.5, 15.0, "N"),
    "a wobbling force": (lambda: press(wobble=0.2), Reason.NOT_STILL, 0.2, 0.05, "1"),
    "a short tap": (lambda: press(hold_s=0.2), Reason.NOT_STILL, 0.26, 0.3, "s"),
    "few samples": (sparse, Reason.NOT_STILL, 12, 15, ""),
    "slid": (lambda: press(slide=SPEED), Reason.SLID, ACROSS, 0.0015, "m"),
    "two contacts": (two_contacts, Reason.TWO_CONTACTS, TWO_PITCH, 0.008, "m"),
    "a torque": (lambda: press(torque=0.1 * FORCE / SIZE), Reason.TWO_CONTACTS, 0.1 / SIZE, 0.008, "m"),
    "no taxel": (lambda: quiet_script().press(FORCE, POINT, {3: 9.0}).quiet(), Reason.NO_TAXEL, 9.0, 10.0, RAW_UNIT),
    "many taxels": (
        lambda: quiet_script().press(FORCE, POINT, dict.fromkeys(range(12), 50.0)).quiet(), Reason.TOO_MANY_TAXELS, 12, 6, ""
    ),
    "not connected": (
        lambda: quiet_script().press(FORCE, POINT, {5: 50.0, 1: 30.0}).quiet(),
        *(Reason.NOT_CONNECTED, FAR, 1.6 * LAYOUT.spacing, "m"),
    ),
    "saturated": (lambda: saturated(saturated=True), Reason.SATURATED, 1, 0, ""),
    "not a number": (lambda: saturated(wrench=np.full(6, np.nan)), Reason.SATURATED, 1, 0, ""),
    "readings lost": (lost_readings, Reason.READINGS_LOST, 7 * PERIOD_S, 3 * PERIOD_S, "s"),
    "never quiet": (never_quiet, Reason.NO_TARE, 12.1, 10.0, "s"),
    "tare changed": (changed_tare, Reason.TARE_CHANGED, 0.55, 0.5, "N"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_a_rejection_has_its_reason_number_and_limit(case):
    script, reason, value, limit, unit = CASES[case]
    found = rejected(script(), reason)
    assert (found.value, found.limit, found.unit) == (pytest.approx(value, rel=0.02), pytest.approx(limit), unit)


def test_a_hand_that_tilts_about_the_contact_does_not_slide():
    script = quiet_script()
    for k in range(40):
        angle = 0.006 * k  # 0.3 rad/s: 50 mm from the contact this would be 4 mm
        force = 8.0 * np.array([np.sin(angle), 0.0, -np.cos(angle)])
        script.step(np.r_[force, np.cross(POINT, force)], ANSWERS)
    assert isinstance(only(script.quiet().run()), Contact)


def test_noise_is_no_slide():
    for seed in range(20):
        script = Script(small_scene(), np.random.default_rng(seed), force_noise=0.03, moment_noise=0.003)
        assert isinstance(only(script.quiet().press(FORCE * 0.7, np.add(POINT, [0, 0, 0.1]), ANSWERS).quiet().run()), Contact)


def test_an_answer_must_stand_above_the_channels_own_noise():
    script = Script(small_scene(), skin_noise=6.0).quiet(3.0).press(FORCE, POINT, {3: 80.0, 7: 15.0}).quiet()
    assert only(script.run()).channels.tolist() == [3]


def test_one_missing_frame_is_no_loss():
    script = quiet_script().press(FORCE, POINT, ANSWERS)
    del script.samples[-20]
    assert isinstance(only(script.quiet().run()), Contact)


def test_no_pose():
    script = Script(small_scene(arm=arm_spec())).quiet().press(FORCE, POINT, ANSWERS).quiet()
    detector = ContactDetector(script.scene)
    outcomes = [each for sample in script.samples for each in detector.feed(sample, None, "")]
    assert {outcome.reason for outcome in outcomes} == {Reason.NO_POSE}


def test_arm_moved():
    scene = small_scene(arm=arm_spec())
    script = Script(scene, angles=np.zeros(1)).quiet()
    for k in range(40):
        script.angles = np.array([0.0 if k < 25 else 0.02])
        script.step(np.r_[FORCE, np.cross(POINT, FORCE)], ANSWERS)
    found = rejected(script.quiet(), Reason.ARM_MOVED, pose="up")
    assert (found.value, found.limit) == (pytest.approx(0.02), pytest.approx(np.radians(0.5)))


def test_another_pose_chosen_in_a_poke_is_an_arm_that_moved():
    scene = small_scene(arm=arm_spec())
    up, down = (scene.arm.arm.link_from_sensor(scene.arm.poses[name]) for name in ("up", "down"))
    script = Script(scene).quiet().press(FORCE, POINT, ANSWERS).quiet()
    detector = ContactDetector(scene)
    half = len(script.samples) - 70
    outcomes = [
        each
        for k, sample in enumerate(script.samples)
        for each in detector.feed(sample, up if k < half else down, "up" if k < half else "down")
    ]
    assert outcomes[0].reason is Reason.ARM_MOVED
    assert outcomes[0].value == pytest.approx(1.0)


def test_an_arm_that_moves_between_pokes_is_tared_anew_and_poked_on():
    scene = small_scene(arm=arm_spec())
    script = Script(scene, angles=np.zeros(1)).quiet()
    for k in range(25):  # the arm turns by 30 degrees and the weight on the sensor changes by 9 N
        script.angles = np.array([np.radians(30) * k / 24])
        script.step(np.array([9.0 * k / 24, 0, 0, 0.1 * k / 24, 0, 0]))
    script.offset = script.offset + np.array([9.0, 0, 0, 0.1, 0, 0])
    outcomes = script.quiet(0.7).press(FORCE, POINT, ANSWERS).quiet().run()
    assert isinstance(outcomes[-1], Contact)
    np.testing.assert_allclose(outcomes[-1].force, FORCE, atol=1e-9)


def test_something_leaning_at_the_start_keeps_it_taring_until_it_leaves():
    script = Script(small_scene(), force_noise=0.5)
    detector = ContactDetector(script.scene)
    for _ in range(300):
        script.step(np.array([0, 0, -5.0, 0, 0, 0]), {3: 50.0})
    assert not script.run(detector)
    assert detector.progress(np.eye(4)).phase is PressPhase.TARING
    script.samples.clear()
    script.force_noise = 0.01
    assert isinstance(only(script.quiet(1.0).press(FORCE, POINT, ANSWERS).quiet().run(detector)), Contact)


def test_a_poke_from_the_first_sample_on_costs_that_poke_alone():
    """It is tared away; once it leaves, the skin below its baseline shows it, and the rhythm of pokes goes on."""
    script = Script(small_scene(), force_noise=0.05, moment_noise=0.003, skin_noise=0.8)
    script.press(FORCE, POINT, ANSWERS, hold_s=1.0, ramp_s=0.02)
    for _ in range(3):
        script.quiet(0.5).press(FORCE, POINT, ANSWERS)
    first, *others = [each for each in script.quiet().run() if each.final]
    assert isinstance(first, Rejection)
    assert (first.poke, first.reason, first.value, first.limit, first.unit) == (1, Reason.NO_TARE, 0.0, 0.2, "s")
    assert [other.poke for other in others] == [2, 3, 4]
    for other in others:
        assert isinstance(other, Contact)
        np.testing.assert_allclose(other.force, FORCE, atol=0.1)


def test_skin_below_its_baseline_drops_no_tare_that_a_poke_has_proved():
    """As of foam that was tared before it had recovered: a press beside the skin is a press beside the skin."""
    script = quiet_script(force_noise=0.02).press(FORCE, POINT, ANSWERS).quiet()
    script.press(FORCE, POINT, {3: -20.0}).quiet().press(FORCE, POINT, ANSWERS).quiet()
    outcomes = [each for each in script.run() if each.final]
    assert [type(outcome) for outcome in outcomes] == [Contact, Rejection, Contact]
    assert outcomes[1].reason is Reason.NO_TAXEL


def test_a_force_that_never_falls_is_tared_away_after_ten_seconds():
    script = quiet_script(force_noise=0.02)
    script.offset = script.offset + np.array([5.0, 0, 0, 0, 0, 0])  # the sensor jumped
    script.quiet(11.5)
    detector = ContactDetector(script.scene)
    found = only(script.run(detector))
    assert found.reason is Reason.NO_TARE
    assert detector.progress(np.eye(4)).phase is PressPhase.READY
    script.samples.clear()
    outcomes = script.press(FORCE, POINT, ANSWERS).quiet().run(detector)
    assert [type(outcome) for outcome in outcomes] == [Contact, Contact]
    np.testing.assert_allclose(outcomes[-1].force, FORCE, atol=0.1)


def test_a_tool_that_still_leans_is_not_tared_away_at_once():
    script = quiet_script()
    script.press(FORCE, POINT, ANSWERS, hold_s=15.0).quiet()
    outcomes = script.run()
    assert [outcome.reason for outcome in outcomes] == [Reason.NO_TARE]  # and no poke of minus that force follows


def test_a_reset_ends_the_poke_in_progress_and_settles_those_that_wait():
    script = quiet_script().press(FORCE, POINT, ANSWERS).quiet(0.1)
    script.press(FORCE, POINT, ANSWERS)
    del script.samples[-10:]
    detector = ContactDetector(script.scene)
    script.run(detector)
    outcomes = detector.reset(script.now + 1.0)
    assert [(outcome.poke, type(outcome), outcome.final) for outcome in outcomes] == [
        (2, Rejection, False),
        (1, Contact, True),
        (2, Rejection, True),
    ]
    assert outcomes[0].reason is Reason.READINGS_LOST
    assert detector.progress(None).phase is PressPhase.NO_DATA
    script.samples.clear()
    assert only(script.quiet().press(FORCE, POINT, ANSWERS).quiet().run(detector)).poke == 3


@pytest.mark.parametrize(("left_out", "expected"), [(3, None), (24, Reason.NOT_STILL)])
def test_a_poke_in_progress_at_the_end_is_judged_by_its_readings(left_out, expected):
    """Nothing was lost: held long enough it counts, else it was not held still."""
    script = quiet_script().press(FORCE, POINT, ANSWERS)
    del script.samples[-left_out:]
    detector = ContactDetector(script.scene)
    script.run(detector)
    last = detector.reset(is_loss=False)[-1]
    assert last.final
    assert (None if isinstance(last, Contact) else last.reason) is expected


def test_phases_follow_the_poke():
    detector = ContactDetector(small_scene())
    script = quiet_script().press(FORCE, POINT, ANSWERS).quiet()
    seen = [detector.progress(None).phase]
    for sample in script.samples:
        detector.feed(sample, np.eye(4), "")
        phase = detector.progress(np.eye(4)).phase
        if phase is not seen[-1]:
            seen.append(phase)
    assert seen == [
        PressPhase.NO_DATA,
        PressPhase.TARING,
        PressPhase.READY,
        PressPhase.PRESSING,
        PressPhase.STILL,
        PressPhase.HELD,
        PressPhase.READY,
    ]


def test_progress_gives_the_axis_in_the_link_frame():
    scene = small_scene()
    pose = np.eye(4)
    pose[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    pose[:3, 3] = [0.3, -0.2, 0.1]
    detector = ContactDetector(scene)
    script = quiet_script().press(FORCE, POINT, ANSWERS)
    for sample in script.samples[:-5]:
        detector.feed(sample, pose, "")
    progress = detector.progress(pose)
    contact = pose[:3, :3] @ POINT + pose[:3, 3]
    np.testing.assert_allclose(progress.force, pose[:3, :3] @ FORCE, atol=1e-9)
    np.testing.assert_allclose(np.cross(progress.force, contact - progress.axis_point), 0.0, atol=1e-9)
    assert progress.channels.tolist() == [3, 7]
    assert progress.still == 1.0
    detector.ignore_channels({7})
    assert detector.progress(pose).channels.tolist() == [3], "a channel that is left out answers nothing"


def test_a_slower_device_is_followed():
    script = quiet_script().press(FORCE, POINT, ANSWERS).quiet()
    slow = [dataclasses.replace(sample, host_s=2000.0 + k * 0.1) for k, sample in enumerate(quiet_script().quiet(3.0).samples)]
    detector = ContactDetector(script.scene)
    script.run(detector)
    for sample in slow:
        detector.feed(sample, np.eye(4), "")
    assert detector.progress(np.eye(4)).phase is PressPhase.READY


@pytest.mark.parametrize("bad", [3, 7])
def test_a_dead_channel_is_left_out_of_later_pokes(bad):
    script = quiet_script().press(FORCE, POINT, ANSWERS).quiet()
    detector = ContactDetector(script.scene)
    detector.ignore_channels({bad})
    assert only(script.run(detector)).channels.tolist() == [10 - bad]


def test_a_channel_marked_dead_gives_back_the_pokes_it_spoilt():
    script = quiet_script().press(FORCE, POINT, {3: 80.0, 7: 40.0, 16: 60.0}).quiet()
    detector = ContactDetector(script.scene)
    assert only(script.run(detector)).reason is Reason.NOT_CONNECTED
    (contact,) = detector.ignore_channels({16})
    assert isinstance(contact, Contact)
    assert (contact.poke, contact.channels.tolist(), contact.final) == (1, [3, 7], True)
    (again,) = detector.ignore_channels(set())
    assert again.reason is Reason.NOT_CONNECTED
