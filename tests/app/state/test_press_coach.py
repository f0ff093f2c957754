"""What is said to the hand that presses: the one thing that matters most, without flicker, and nothing while it counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.state.press_coach import AIM_SHOWN, HINT_DEBOUNCE_S, HintKind, LeanDirection, tilt_hint
from app.text.now_text import NowMemory, Tone, now_line
from skincal.contacts.outcome import PressPhase
from skincal.following.guided_session import PressCoach
from skincal.following.session_guide import SessionGuide
from skincal.guide.press_coaching import max_angle_error
from skincal.part.part import Part
from skincal.session.session import Session
from skincal.taxels.result import Method
from tests.app.guide_support import ASKED, TILT, TO_2, coaching_of, guidance, held, target
from tests.app.scene3d_support import box
from tests.app.window_support import PLAN, SCENE, frame, part, reading, session
from tests.approved import approved

DEGREE, BETWEEN = "\N{DEGREE SIGN}", "  \N{MIDDLE DOT}  "
TICK = 1 / 30


class Line:
    """The line, tick after tick."""

    def __init__(self, asked=ASKED, method=Method.FREE) -> None:
        self.says, self.asked = guidance(asked, method=method), asked
        self.memory, self.now_s = NowMemory.from_snapshot(session()), 100.0
        self.said: list[str] = []

    def show(self, view, seconds: float = 0.0):
        """Show the same reading for some time; return what is said at its end."""
        found = None if self.asked is None else coaching_of(view.progress, self.asked)
        now = None
        for _ in range(1 + round(seconds / TICK)):
            at = replace(frame(session(), view, self.now_s), guidance=self.says, coaching=found)
            now, self.memory = now_line(self.memory, at)
            self.said.append(now.headline)
            self.now_s += TICK
        return now


def test_force_goes_before_all_else_and_the_rest_is_a_detail():
    line = Line()
    now = line.show(held(10.0, newtons=3.0), 2 * HINT_DEBOUNCE_S)
    assert (now.tone, now.headline) == (Tone.HOLD, "Press harder")
    assert now.detail == approved("press.too_soft_and_tilt", seen=3.0, least=4.0, degrees=18, neighbour="2")
    now = line.show(held(10.0, newtons=16.0), 2 * HINT_DEBOUNCE_S)
    assert (now.tone, now.headline) == (Tone.BAD, "Press softer")


def test_a_tilt_that_is_off_is_said_with_the_way_once_it_held():
    line = Line()
    assert line.show(held(10.0)).headline == "Hold still"
    assert line.show(held(10.0), HINT_DEBOUNCE_S / 2).headline == "Hold still"
    now = line.show(held(10.0), HINT_DEBOUNCE_S)
    assert (now.tone, now.headline) == (Tone.HOLD, approved("press.more_tilt", degrees=18, neighbour="2"))
    assert now.detail == approved("press.force_aim_tilt", newtons=8.0, aim_mm=0.0, degrees=10, wanted=28)


def test_a_push_within_ten_degrees_is_as_asked():
    assert Line().show(held(18.5), 1.0).headline == "Hold still"
    assert Line().show(held(37.5), 1.0).headline == "Hold still"
    assert Line().show(held(17.5), 1.0).headline.startswith("Lean 1")
    assert Line().show(held(38.5), 1.0).headline == f"Lean 10{DEGREE} less"


def test_nothing_is_said_of_a_poke_that_counts():
    line = Line()
    assert line.show(held(8.0), 1.0).headline.startswith("Lean")
    now = line.show(held(8.0, phase=PressPhase.STILL, still=0.3))
    assert now.headline == "Hold still", "at once"
    assert line.show(held(8.0, phase=PressPhase.STILL, still=0.9), 2.0).headline == "Hold still"
    now = line.show(held(8.0, phase=PressPhase.HELD, still=1.0), 1.0)
    assert (now.tone, now.headline) == (Tone.GOOD, "Release")
    assert now.detail == approved("press.aim_tilt", aim_mm=0.0, degrees=8, wanted=28)


def test_the_hint_comes_back_only_where_the_hand_goes_on_moving():
    line = Line()
    line.show(held(8.0), 1.0)
    line.said.clear()
    # Still for a moment, then not, again and again: a hint would jump in and out.
    for _ in range(8):
        line.show(held(8.0, phase=PressPhase.STILL, still=0.3), 0.1)
        line.show(held(8.0), 0.1)
    assert set(line.said) == {"Hold still"}
    assert line.show(held(8.0), 0.5).headline.startswith("Lean")


def test_the_line_does_not_flicker_at_its_limits():
    rng = np.random.default_rng(2)
    sway = np.sin(np.arange(120) * TICK * 2.0 * np.pi)
    same = np.ones(120)
    for tilts, newtons in (
        (rng.normal(18.0, 1.0, 120), 8.0 * same),
        (17.7 + 1.5 * sway, 8.0 * same),
        (28.0 * same, rng.normal(4.0, 0.08, 120)),
        (28.0 * same, 4.1 + 0.15 * sway),
    ):
        line = Line()
        for tilt, force in zip(tilts, newtons, strict=True):
            line.show(held(tilt, newtons=force))
        turns = sum(first != second for first, second in zip(line.said, line.said[1:], strict=False))
        assert turns <= 2


def test_a_number_is_not_said_anew_for_the_trembling_of_a_hand():
    line = Line()
    first = line.show(held(8.0), 1.0).headline
    line.said.clear()
    for tick in range(90):
        line.show(held(8.0 + 2.5 * np.sin(tick * TICK * 2.0 * np.pi)))
    assert set(line.said) == {first}
    for tilt in np.random.default_rng(3).normal(14.0, 0.4, 30):
        said = line.show(held(tilt)).headline
    assert said in {approved("press.more_tilt", degrees=n, neighbour="2") for n in (13, 14, 15)}, (
        "a hand that trembles has moved, too"
    )


def test_a_tip_on_another_taxel_is_said_before_its_tilt_and_only_if_far():
    line = Line()
    off = np.array(TO_2) * 0.0062
    now = line.show(held(5.0, aside=off, landed=2), 1.0)
    assert now.headline == "Move the tip 6 mm toward taxel 3"
    assert now.detail == approved("press.counts_there_and_tilt", newtons=8.0, taxel="2", degrees=5, wanted=28)
    near = np.array(TO_2) * 0.9 * AIM_SHOWN
    assert Line().show(held(28.0, aside=near, landed=2), 1.0).headline == "Hold still"
    assert Line().show(held(28.0, aside=off, landed=3), 1.0).headline == "Hold still", (
        "the target answers: its place is not known"
    )


def test_who_pokes_elsewhere_altogether_is_not_called_back():
    now = Line().show(held(0.0, aside=(0.03, 0.0, 0.0), landed=15), 1.0)
    assert (now.headline, now.detail) == ("Hold still", approved("press.counts_there", newtons=8.0, taxel="15"))


def test_the_surface_method_asks_for_no_tilt_and_takes_any_that_does_not_slide():
    straight = target(3)
    for method, tilt, headline in (
        (Method.SURFACE, 20.0, "Hold still"),
        (Method.SURFACE, 31.0, f"Lean 31{DEGREE} less"),
        (Method.FREE, 20.0, f"Lean 20{DEGREE} less"),
    ):
        assert Line(straight, method).show(held(tilt, asked=straight), 1.0).headline == headline
    says = guidance(ASKED, method=Method.SURFACE)
    assert max_angle_error(replace(says, usable_tilt=0.3)) == 0.3
    assert np.degrees(max_angle_error(replace(says, method=Method.FREE))) == pytest.approx(10.0)


def test_a_place_without_a_taxel_is_met_by_whatever_answers():
    place = target(3, TILT, TO_2)
    place = replace(place, channel=None)
    now = Line(place).show(held(28.0, aside=(0.006, 0.0, 0.0), landed=15, asked=place), 1.0)
    assert (now.headline, now.detail) == (
        "Hold still",
        approved("press.force_aim_tilt", newtons=8.0, aim_mm=6.0, degrees=28, wanted=28),
    )


def test_without_a_target_the_line_says_what_it_always_said():
    line = Line(None)
    now = line.show(held(20.0), 1.0)
    assert (now.headline, now.detail) == ("Hold still", approved("press.keep_still", newtons=8.0))
    assert line.show(held(20.0, phase=PressPhase.HELD)).detail == approved("press.window_full")


@pytest.mark.parametrize(
    ("tilt", "turn", "expected"),
    [
        (10.0, 0.0, (HintKind.MORE, LeanDirection(2, away=False))),
        (45.0, 0.0, (HintKind.LESS, None)),
        (28.0, 90.0, (HintKind.MORE, None)),
        (1.0, 0.0, (HintKind.MORE, LeanDirection(2, away=False))),
    ],
)
def test_the_way_is_less_where_the_tool_leans_that_way_already(tilt, turn, expected):
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    lean = (c * TO_2[0] - s * TO_2[1], s * TO_2[0] + c * TO_2[1], 0.0)
    found = coaching_of(held(tilt, lean).progress, ASKED)
    assert found is not None
    hint = tilt_hint(guidance(ASKED), ASKED, found)
    assert hint.ask is expected[0]
    if turn == 0.0:
        assert hint.toward == expected[1]
    else:
        # From a quarter turn beside: the way leads between taxel 2 and straight.
        assert hint.toward is not None
        way = PLAN.places[hint.toward.channel] - PLAN.places[3]
        assert (way @ found.lean[:2]) * (-1 if hint.toward.away else 1) > 0.8 * np.linalg.norm(way)


def coaching(surface):
    """What a coach says of one reading after another."""
    coach = PressCoach(surface)

    def coached(progress, target):
        coach.follow_reading(progress, target)
        return coach.coaching

    return coached


def test_the_guide_of_the_window_compares_with_its_own_target_on_the_skin():
    of, guiding, coached = Session(SCENE, None), SessionGuide(part()), coaching(part().surface)
    assert coached(held(20.0).progress, None) is None, "nobody guides yet"
    assert coached(reading().progress, None) is None
    says = guiding.next_target(of.snapshot(), ("", None), Method.FREE, 0.0)
    assert says is not None
    assert says.target is not None
    view = held(20.0, asked=says.target, landed=says.target.channel)
    found = coached(view.progress, says.target)
    assert found is not None
    assert found.away < 1e-9
    assert np.degrees(found.tilt) == pytest.approx(20.0)
    assert coached(replace(view.progress, phase=PressPhase.READY), says.target) is None
    assert coached(view.progress, None) is None


def test_the_tip_is_measured_on_the_mesh_where_there_is_one():
    whole = part()
    sunk = replace(whole.laid, places=whole.laid.places - [0.0, 0.0, 0.004])
    of, guiding = Session(SCENE, None), SessionGuide(Part(SCENE, box(), sunk, PLAN.channels, ()))
    says = guiding.next_target(of.snapshot(), ("", None), Method.FREE, 0.0)
    assert says is not None
    assert says.target is not None
    # The layout is believed 4 mm below the box's top; a tool that leans by 45 degrees touches the top right above it.
    up = replace(says.target, place=says.target.place + np.array([0.0, 0.0, 0.004]))
    found = coaching(box())(held(45.0, asked=up).progress, says.target)
    assert found is not None
    assert found.away < 1e-7
