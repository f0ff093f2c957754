"""The client of the target lines on an arm without a physics engine: a poke, and everything that may go wrong in one.

`test_both_clients.py` has what every client must do.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.robot.aim_correction import AimCorrection
from skincal.robot.poking_client import (
    FORCE_ABOVE_LIMIT,
    MEASURE_AGAIN,
    NOT_AWAY,
    OUT_OF_REACH,
    PRESSED_AT_REST,
    WAY_BLOCKED,
    Phase,
    PokeSettings,
)
from skincal.robot.target_lines import Answer, AnswerKind, Held, NoTarget, PokeTarget
from tests.skincal.robot.client_benches import BOX, DOWN, HALF, Program, box
from tests.skincal.robot.plain_arm import WEIGHT

UP = -DOWN


def target(number, place=(0.01, 0.02, 0.02), push=DOWN, force=9.5, frame="box"):
    place, push = np.array(place, dtype=float), np.array(push, dtype=float)
    return PokeTarget(number, 3, place, push, frame=frame, force=force, hold=0.6)


class Bench(Program):
    """The client, asked by whole lines; conditions get the bench."""

    def ask(self, line):
        return self.say(line)

    def run(self, until, limit_s=40.0):
        return self.until(lambda: until(self), limit_s)


def answered(bench):
    return bool(bench.answers)


def test_a_target_in_another_frame_is_a_fault_and_ends_the_poke_before():
    bench = Bench().ask(target(1)).until_phase(Phase.TRAVEL).ask(target(2, frame="hand")).run(answered).rest(1.0)
    assert [(answer.kind, answer.number) for answer in bench.answers] == [(AnswerKind.FAULT, 2)]
    assert bench.answers[0].text == "the target is in the frame hand, this robot's part is box"
    assert bench.client.phase is Phase.IDLE
    assert not bench.forces.any()


def test_the_force_across_the_push_is_let_go_before_the_hold():
    bench = Bench()
    bench.arm.sideways = np.array([0.4, -0.3, 0.0])
    bench.ask(target(1)).until_phase(Phase.HOLD)
    force = bench.arm.wrench.force - WEIGHT
    # Else 4.7 N.
    assert np.linalg.norm(force[:2]) < 1.1
    assert -force[2] == pytest.approx(9.5, rel=0.08)


def test_a_tip_that_slides_on_a_slope_is_not_followed_far():
    push = np.array([0.35, 0.0, -0.94])
    bench = Bench().ask(target(1, push=push / np.linalg.norm(push))).until_phase(Phase.PRESS)
    felt_at = bench.arm.position
    bench.until_phase(Phase.HOLD).rest(1.0)
    way = bench.arm.position - felt_at
    aside = way - (way @ bench.arm.direction) * bench.arm.direction
    assert 0.002 < np.linalg.norm(aside) < 0.0032


def test_a_poke_presses_as_asked_lets_go_when_held_and_stands_off():
    bench = Bench().ask(target(1))
    bench.until_phase(Phase.HOLD).rest(0.3)
    assert bench.client.force == pytest.approx(9.5, rel=0.08)
    bench.ask(Held(1)).run(answered)
    assert bench.answers == [Answer(AnswerKind.REACHED, 1)]
    assert bench.forces.max() < 1.2 * 9.5
    np.testing.assert_allclose(bench.arm.position, [0.01, 0.02, 0.034], atol=2e-3)
    bench.rest(0.2)
    np.testing.assert_allclose(bench.tips[-1].place, bench.arm.position + 0.002 * DOWN, atol=1e-12)
    touched = np.flatnonzero(bench.forces)
    assert (np.diff(touched) == 1).all(), "one touch"


def test_without_held_the_poke_ends_after_its_hold():
    bench = Bench().ask(target(1)).until_phase(Phase.HOLD)
    begin = bench.arm.time_s
    bench.run(answered)
    assert 0.6 < bench.arm.time_s - begin < 4.0


@pytest.mark.parametrize("tilt", [0.0, 0.45], ids=["straight", "tilted"])
def test_the_way_to_the_other_side_of_the_part_keeps_its_distance(tilt):
    lean = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    bench = Bench().ask(target(1)).run(answered)
    bench.arm.course.clear()
    bench.ask(target(2, (0.0, 0.01, -0.02), lean)).until_phase(Phase.ENTER)
    gaps = np.array([gap for _, gap, _ in bench.arm.course])
    away = gaps > 0.027
    assert (np.diff(away.astype(int)) == 1).sum() == 1, "out once, straight"
    assert away[away.argmax() :].all(), "and around, with the clearance"
    assert gaps.min() > 0.009
    bench.run(lambda bench: len(bench.answers) == 2)
    assert bench.answers[1] == Answer(AnswerKind.REACHED, 2)


def test_pokes_side_by_side_need_no_way_around():
    bench = Bench().ask(target(1)).run(answered)
    bench.arm.course.clear()
    bench.ask(target(2, (0.012, 0.035, 0.02))).run(lambda bench: len(bench.answers) == 2)
    assert max(place[2] for place, _, _ in bench.arm.course) < 0.036


COURT = box(
    (np.array([0.0, 0.0, -0.02]), np.array([0.1, 0.1, 0.01])), (np.array([0.03, 0.0, 0.03]), np.array([0.005, 0.1, 0.05]))
)
IMPOSSIBLE = {
    "no way around": (BOX, target(1, (0.0, 0.0, -0.02), UP), lambda place, _: abs(place[2]) > 0.02, OUT_OF_REACH),
    "the part is in the way": (COURT, target(1, (0.02, 0.0, -0.01), (-0.5, 0.0, -0.8660254)), None, WAY_BLOCKED),
}


@pytest.mark.parametrize("case", IMPOSSIBLE)
def test_an_impossible_target_is_skipped_with_its_reason_and_without_a_motion(case):
    surface, asked, reach, reason = IMPOSSIBLE[case]
    bench = Bench(surface)
    bench.arm.reach = reach or bench.arm.reach
    bench.ask(asked).run(answered)
    assert bench.answers == [Answer(AnswerKind.SKIP, 1, reason)]
    assert (np.ptp([place for place, _, _ in bench.arm.course], axis=0) == 0.0).all()


@pytest.mark.parametrize("line", [NoTarget.STOP, NoTarget.WAIT, None], ids=["stop", "wait", "connection lost"])
@pytest.mark.parametrize("phase", [Phase.TRAVEL, Phase.TARE, Phase.ENTER, Phase.APPROACH, Phase.PRESS, Phase.HOLD])
def test_a_stop_ends_every_motion_and_lets_go_of_the_part(phase, line):
    bench = Bench().ask(target(1)).until_phase(phase).rest(0.02)
    bench.arm.course.clear()
    if line is None:
        bench.client.lose_connection()
    else:
        bench.ask(line)
    bench.rest(3.0)
    heights = np.array([place[2] for place, _, _ in bench.arm.course])
    assert (np.diff(heights) >= -1e-12).all(), "never towards the part"
    assert (heights[300:] == heights[300]).all(), "and then it stands"
    assert bench.forces[300:].max() == 0.0
    assert bench.answers == []
    bench.ask(target(2)).run(answered)
    assert bench.answers == [Answer(AnswerKind.REACHED, 2)]


@pytest.mark.parametrize("phase", [Phase.TRAVEL, Phase.ENTER, Phase.APPROACH, Phase.PRESS, Phase.HOLD])
def test_without_a_fresh_reading_nothing_moves_towards_the_part(phase):
    bench = Bench().ask(target(1)).until_phase(phase).rest(0.02)
    bench.arm.is_silent = True
    bench.rest(PokeSettings().force_max_age_s + 0.01)
    bench.arm.course.clear()
    bench.run(answered)
    assert (np.diff([place[2] for place, _, _ in bench.arm.course]) >= -1e-12).all()
    assert bench.answers == [Answer(AnswerKind.SKIP, 1)]
    bench.ask(target(2)).rest(2.0)
    assert bench.client.phase is Phase.IDLE, "it waits for readings"
    bench.arm.is_silent = False
    bench.run(lambda bench: len(bench.answers) == 2)
    assert bench.answers[1] == Answer(AnswerKind.REACHED, 2)


def test_it_retreats_from_a_force_above_the_limit():
    bench = Bench().ask(target(1)).until_phase(Phase.ENTER)
    bench.arm.obstacle = lambda centre: centre[2] < 0.04
    bench.run(answered)
    assert bench.answers == [Answer(AnswerKind.SKIP, 1)]
    struck = np.flatnonzero(bench.forces > 25.0)
    heights = np.array([place[2] for place, _, _ in bench.arm.course])
    assert (np.diff(heights[struck[0] + 1 :]) >= -1e-12).all()


def test_it_draws_back_from_what_it_meets_on_its_way():
    bench = Bench().ask(target(1)).run(answered)
    bench.ask(target(2, (0.0, 0.01, -0.02), UP)).until_phase(Phase.TRAVEL).rest(0.3)
    met = bench.arm.position
    bench.arm.obstacle = lambda centre: np.linalg.norm(centre - met) < 0.01
    bench.run(lambda bench: len(bench.answers) == 2)
    assert bench.answers[1] == Answer(AnswerKind.SKIP, 2)
    np.testing.assert_allclose(bench.arm.position - met, [0.0, 0.0, PokeSettings().back_off], atol=3e-3)
    assert bench.forces[-1] == 0.0
    bench.arm.obstacle = None
    bench.ask(target(3)).run(lambda bench: len(bench.answers) == 3)
    assert bench.answers[2] == Answer(AnswerKind.REACHED, 3)


def test_a_force_above_the_limit_is_not_tried():
    bench = Bench().ask(target(1, force=40.0)).run(answered)
    assert bench.answers == [Answer(AnswerKind.SKIP, 1, FORCE_ABOVE_LIMIT)]
    assert bench.forces.max() == 0.0


def test_an_arm_that_does_not_get_away_from_the_part_is_a_fault():
    bench = Bench().ask(target(1)).until_phase(Phase.HOLD)
    bench.arm.stop()
    bench.arm.command = lambda *_: None
    bench.run(answered)
    assert bench.answers == [Answer(AnswerKind.FAULT, 1, NOT_AWAY)]


def test_what_presses_at_rest_is_a_fault_and_the_next_target_begins_with_a_new_tare():
    bench = Bench().ask(target(1)).run(answered)
    bench.arm.obstacle = lambda _: True
    bench.rest(0.1).arm.course.clear()
    bench.ask(target(2)).run(lambda bench: len(bench.answers) == 2)
    assert bench.answers[1] == Answer(AnswerKind.FAULT, 2, PRESSED_AT_REST)
    assert (np.ptp([place for place, _, _ in bench.arm.course], axis=0) == 0.0).all()
    bench.ask(target(3)).run(lambda bench: len(bench.answers) == 3)
    assert bench.answers[2] == Answer(AnswerKind.REACHED, 3)


def test_held_before_the_press_does_not_end_it():
    bench = Bench().ask(target(1)).until_phase(Phase.ENTER).ask(Held(1)).run(answered)
    assert bench.forces.max() > 0.9 * 9.5


@pytest.mark.parametrize("phase", [Phase.TRAVEL, Phase.TARE, Phase.ENTER])
def test_the_same_target_with_another_number_does_not_stop_the_arm(phase):
    """The guide asks again where a jolt of the arm looked like a poke."""
    alone = Bench().ask(target(1)).run(answered)
    bench = Bench().ask(target(1)).until_phase(phase).rest(0.02)
    bench.ask(target(2, force=8.0)).run(answered)
    assert bench.answers == [Answer(AnswerKind.REACHED, 2)]
    assert bench.arm.time_s == pytest.approx(alone.arm.time_s, abs=0.1)
    assert bench.forces.max() == pytest.approx(8.0, rel=0.15)


@pytest.mark.parametrize(("error", "reason"), [(-0.03, "nothing was felt"), (0.025, "touched before")])
def test_three_failures_in_a_row_ask_to_measure_the_tip_and_the_part_again(error, reason):
    """The arm believes that its tip is 25 mm lower, or higher, than it is."""
    bench = Bench(tip_error=(0.0, 0.0, -error))
    for number in (1, 2, 3):
        bench.ask(target(number)).run(lambda bench, number=number: len(bench.answers) == number)
    assert [answer.kind for answer in bench.answers] == [AnswerKind.SKIP, AnswerKind.SKIP, AnswerKind.FAULT]
    assert reason in bench.answers[2].text
    assert bench.answers[2].text.endswith(MEASURE_AGAIN.rpartition(":")[2])
    assert all(not answer.text for answer in bench.answers[:2]), "the guide may ask for them again"
    assert bench.forces.max() < 25.0


@pytest.mark.parametrize("error", [0.005, -0.005])
def test_a_tip_that_is_wrong_by_five_millimetres_still_pokes(error):
    bench = Bench(tip_error=(0.003, 0.0, error)).ask(target(1)).run(answered)
    assert bench.answers == [Answer(AnswerKind.REACHED, 1)]
    assert bench.forces.max() < 1.2 * 9.5


@pytest.mark.parametrize("carries", [False, True])
def test_the_aim_is_corrected_by_the_force_axes(carries):
    """The robot's base is 5 mm and 1.5 degrees wrong, also for a part that it turns; half-way an axis comes from elsewhere."""
    rng, motion, turn = np.random.default_rng(1), np.array([0.004, -0.003, 0.001]), np.radians([1.0, -1.0, 0.5])
    aim = AimCorrection()
    for number in range(24):
        place = HALF * np.roll([1.0, *rng.uniform(-1.0, 1.0, 2)], number % 3)
        push = -np.eye(3)[number % 3]
        axis = place + 0.0005 * rng.standard_normal(3) + (0.03 if number == 12 else 0.0) * np.roll(push, 1)
        force = 9.0 * (push + 0.1 * rng.standard_normal(3))
        pose = np.eye(4)
        if carries:
            pose[:3, :3], pose[:3, 3] = Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.3, 0.3, 3)
        there = pose[:3, :3] @ place + pose[:3, 3]
        shift = pose[:3, :3].T @ (motion + np.cross(turn, there))
        aim.add_poke(place - shift, force, np.cross(axis, force), pose)
    off = aim.shift_at(place, pose) - shift
    assert np.linalg.norm(off) < 1e-3 < np.linalg.norm(motion)


def test_an_arm_that_is_wrong_by_five_millimetres_learns_where_it_presses():
    bench, misses = Bench(tip_error=(0.004, -0.003, 0.0)), []
    for number, place in enumerate([(0.0, 0.0), (0.015, 0.03), (-0.015, 0.04), (0.01, -0.03)], start=1):
        bench.ask(target(number, (*place, 0.02))).until_phase(Phase.HOLD)
        misses.append(np.linalg.norm(bench.arm.contact()[2][:2] - place))
        bench.run(lambda bench, number=number: len(bench.answers) == number)
    assert misses[0] > 0.0045
    assert max(misses[1:]) < 0.001


def test_a_tip_that_slips_lets_go_and_the_poke_is_left_to_skincal():
    bench = Bench().ask(target(1)).until_phase(Phase.HOLD)
    bench.arm.grip = 0.2
    begin = bench.arm.time_s
    bench.run(answered)
    assert bench.answers == [Answer(AnswerKind.REACHED, 1)]
    assert bench.arm.time_s - begin < 0.5


def test_another_target_replaces_one_that_is_pressed():
    bench = Bench().ask(target(1)).until_phase(Phase.HOLD)
    bench.ask(target(2, (0.0, -0.02, 0.02))).run(answered)
    assert bench.answers == [Answer(AnswerKind.REACHED, 2)]
    np.testing.assert_allclose(bench.arm.position, [0.0, -0.02, 0.034], atol=2e-3)
