"""The delay of a tool's poses: presses made by hand with a known delay, foam that yields, and hands that differ."""

import numpy as np
import pytest

from skincal.contacts.pose_delay_watch import PoseDelayWatch, Way, find_delay
from skincal.contacts.pose_delays import PoseDelay, PoseDelays, combine_delays
from skincal.words.tool_words import pose_delay_sentence, pose_stream_faults

PERIOD_S, PRESS_S, HIGH_M, FOAM_M = 0.02, 4.0, 0.006, 0.002
PUSH = np.array([0.48, -0.6, 0.64])


def depth_at(times, speed):
    """Way of the tip along the push: down from `HIGH_M` above the foam into it, a rest of a second, and back."""
    down = np.clip(speed * (times % PRESS_S - 1.0), 0.0, HIGH_M + FOAM_M)
    up = np.clip(speed * (times % PRESS_S - 2.2), 0.0, HIGH_M + FOAM_M)
    return down - up - HIGH_M


def force_of(depth):
    """Foam that becomes stiffer."""
    pressed = np.maximum(depth, 0.0) / FOAM_M
    return 4.0 * pressed + 6.0 * pressed**3


def watched(delay_s, *, speed=0.03, presses=5, noise=0.0, creep=0.0, shift_s=0.0, seed=1):
    """Follow presses whose poses are stamped `delay_s` late, while `shift_s` of it is corrected."""
    rng, watch = np.random.default_rng(seed), PoseDelayWatch(has_sensor=True)
    for t in np.arange(0.0, presses * PRESS_S, PERIOD_S).tolist():
        reported = depth_at(np.array(t - delay_s + shift_s), speed)
        place = np.array([0.3, 0.1, 0.2]) + PUSH * (reported + noise * rng.standard_normal())
        depth = depth_at(np.array(t), speed) - creep * np.clip(t % PRESS_S - 1.3, 0.0, 1.0)
        force = float(force_of(depth))
        watch.feed(t, place, (force, 20.0 * force), shift_s, presses=force > 1.0)
    return watch.delays


def test_a_delay_is_a_fault_beyond_its_error_and_that_against_the_wrench_leads():
    assert [PoseDelay(delay_s, 0.03, 5).is_late for delay_s in (0.15, -0.15, 0.17, -0.17)] == [False, False, True, True]
    slow, sure = PoseDelays(of_skin=np.full(5, 0.3), of_skin_sd=np.full(5, 0.01)), np.full(5, 0.02)
    assert slow.leading.delay_s == 0.3
    both = PoseDelays(slow.of_skin, slow.of_skin_sd, sure, sure)
    assert both.leading.delay_s == 0.02, "foam answers slowly"


@pytest.mark.parametrize("delay_s", [-0.2, 0.0, 0.013, 0.12, 0.4])
def test_the_edges_of_presses_show_the_delay_of_the_poses(delay_s):
    found = watched(delay_s)
    assert found.against_wrench.presses >= 4
    assert found.against_wrench.delay_s == pytest.approx(delay_s, abs=0.003)
    assert found.against_skin.delay_s == pytest.approx(delay_s, abs=0.003)


def test_what_is_corrected_already_is_part_of_the_delay():
    assert watched(0.15, shift_s=0.1).leading.delay_s == pytest.approx(0.15, abs=0.003)


@pytest.mark.parametrize("speed", [0.012, 0.03, 0.1])
def test_foam_that_yields_and_noise_stay_within_the_predicted_error(speed):
    found = watched(0.05, speed=speed, noise=0.0001, creep=0.0002).leading
    assert abs(found.delay_s - 0.05) < 2.0 * found.sd_s
    # 0.2 mm over the speeds of both edges, with the period of the readings.
    assert found.sd_s < 2.0 * 0.0002 / speed + 0.01


def test_a_press_without_a_fast_edge_shows_nothing():
    assert watched(0.05, speed=0.0035).leading is None


def one_press(speed, hold_s, *, delay_s=0.05, waver=0.0, noise=0.0):
    """Delay of one press by 2 mm from above the foam, whose poses waver by `waver` before it, and have noise while it holds."""
    times = np.arange(0.0, 6.0, PERIOD_S)

    def depth_of(t):
        ramp = 0.002 / speed
        ways = [np.clip((t - begin) / ramp, 0.0, 1.0) for begin in (2.0, 2.0 + ramp + hold_s)]
        return 0.002 * (ways[0] - ways[1]) - 0.001

    depth, tremble = depth_of(times), np.random.default_rng(1).standard_normal(len(times))
    held = (times > 2.0 + 0.002 / speed) & (times < 2.0 + 0.002 / speed + hold_s)
    seen = depth + waver * np.sin(2.0 * np.pi * times / 0.2) * (times < 1.95) + noise * tremble * held
    answer = 100.0 * np.maximum(depth, 0.0) / 0.001
    return find_delay(Way(times + delay_s, seen), times, answer, answer > 5.0, 1.0)


def test_edges_that_are_too_slow_show_no_delay():
    assert one_press(0.0045, 1.0).delay_s == pytest.approx(0.05, abs=0.01)
    assert one_press(0.0035, 1.0) is None


def test_a_tool_that_wavers_before_a_short_press_has_the_delay_of_its_edges():
    assert one_press(0.05, 0.1, waver=0.0004).delay_s == pytest.approx(0.05, abs=0.005)


def test_noise_of_the_poses_is_in_the_error_of_the_delay():
    quiet, noisy = one_press(0.02, 1.0), one_press(0.02, 1.0, noise=0.0005)
    assert noisy.sd_s > 2.0 * quiet.sd_s


def test_one_press_that_slid_does_not_move_the_delay():
    assert combine_delays(np.array([0.02, 0.021, 0.3, 0.019]), np.full(4, 0.008)).delay_s == pytest.approx(0.0205)
    assert combine_delays(np.array([0.02, 0.021]), np.full(2, 0.008)) is None


def test_late_and_repeated_poses_are_named_with_the_remedy_and_usual_ones_are_not():
    usual, late = watched(0.03), watched(0.2)
    assert pose_stream_faults(usual) == () == pose_stream_faults(None)
    assert pose_delay_sentence(usual).startswith("Poses of the tool come 30 ms later than the wrench and 30 ms later than")
    (said,) = pose_stream_faults(late)
    assert said.startswith("Poses of the tool are 200 ms late.")
    assert "buffer" in said
    (said,) = pose_stream_faults(PoseDelays(repeated_s=0.2))
    assert "changes only every 0.20 s" in said
    assert pose_delay_sentence(PoseDelays()) == ""


def test_a_delay_that_slow_edges_show_is_not_called_corrected():
    """The pipeline corrects a delay that is known to 30 ms."""
    known, unknown = (
        PoseDelays(of_wrench=np.full(4, 0.25), of_wrench_sd=np.full(4, sd), of_skin=np.full(4, 0.25), of_skin_sd=np.full(4, sd))
        for sd in (0.028, 0.032)
    )
    for delays, is_corrected in ((known, True), (unknown, False)):
        (fault,) = pose_stream_faults(delays)
        for said in (pose_delay_sentence(delays), fault):
            assert ("is corrected" in said, "not corrected" in said) == (is_corrected, not is_corrected)


def test_parts_of_a_session_are_joined():
    joined = watched(0.03, presses=3).plus(watched(0.03, presses=4))
    assert len(joined.of_wrench) == len(watched(0.03, presses=3).of_wrench) + len(watched(0.03, presses=4).of_wrench)
