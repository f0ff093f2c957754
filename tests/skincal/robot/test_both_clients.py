"""What a client that pokes for a robot must do: the program's and the template's, by the same tests."""

import numpy as np
import pytest

from skincal.robot.target_lines import AnswerKind, Held, NoTarget
from tests.skincal.robot.client_benches import Program, template

REACHED, SKIP, FAULT = AnswerKind.REACHED, AnswerKind.SKIP, AnswerKind.FAULT


@pytest.fixture(params=["program", "template"])
def client(request):
    if request.param == "program":
        yield Program()
        return
    with template() as example:
        yield example


def stands_off(client):
    return client.heights()[-1] == pytest.approx(client.standoff_m, abs=3e-3)


def never_goes_down(heights):
    return (np.diff(heights) >= -1e-12).all()


def test_it_presses_as_asked_lets_go_when_held_and_ends_without_held_too(client):
    client.ask(1).until(lambda: client.force() > 0.94 * 9.5)
    client.say(Held(1))
    client.until_answers()
    assert client.said() == [(REACHED, 1)]
    assert stands_off(client)
    client.ask(2).until_answers(2)
    assert client.said()[1] == (REACHED, 2)
    assert client.largest_force() < 1.2 * 9.5


def test_a_target_out_of_reach_is_skipped_without_a_motion(client):
    client.limit_reach(0.02)
    client.ask(1, x=0.025).until_answers()
    assert client.said() == [(SKIP, 1)]
    assert "out of reach" in client.text()
    assert len(set(client.heights().tolist())) <= 1
    client.ask(2).until_answers(2)
    assert client.said()[1] == (REACHED, 2)


def test_a_target_in_another_frame_is_a_fault_without_a_force(client):
    client.ask(1, frame="r_hand").until_answers()
    assert client.said() == [(FAULT, 1)]
    assert "the target is in the frame r_hand" in client.text()
    assert client.force() == 0.0
    client.ask(2).until_answers(2)
    assert client.said()[1] == (REACHED, 2)


@pytest.mark.parametrize("line", [NoTarget.STOP, NoTarget.WAIT])
def test_a_stop_lets_go_and_stays(client, line):
    client.ask(1).until_pressed()
    client.say(line)
    client.until(lambda: client.force() == 0.0 and client.is_at_rest()).rest(0.2)
    count = len(client.heights())
    client.rest(0.4)
    assert np.ptp(client.heights()[count - 1 :]) == 0.0
    assert client.said() == []


def test_nothing_moves_towards_the_part_without_a_fresh_force(client):
    client.ask(1).until(lambda: len(client.heights()) > 0 and 0.0 < client.heights()[-1] < 0.02)
    client.silence()
    client.rest(0.12)
    count = len(client.heights())
    client.rest(0.4)
    assert never_goes_down(client.heights()[count:])
    client.silence(silent=False)
    client.until_answers()
    assert client.said() == [(REACHED, 1)]


def test_a_pressing_tip_lets_go_once_the_force_is_old(client):
    client.ask(1).until_pressed()
    client.silence()
    client.until_answers()
    assert client.said() == [(client.gave_up_kind, 1)]
    assert stands_off(client)


def test_an_obstacle_on_the_way_stops_it(client):
    client.meet(0.1)
    client.ask(1).until_answers()
    assert client.said() == [(client.gave_up_kind, 1)]
    assert client.heights().min() > 0.09


def test_it_lets_go_without_skincal(client):
    client.ask(1).until_pressed()
    client.lose_skincal()
    client.until(lambda: client.force() == 0.0 and client.is_at_rest())
    assert client.said() == []
