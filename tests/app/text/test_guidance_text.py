"""What the guide says to the operator, and the guide that the window follows: without a window."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from guide_support import guidance, target
from scene3d_support import layout, scene
from window_support import NAMES, PLAN, SCENE, frame, part, reading, session, slip, touch

from app.state.press_coach import LeanDirection, lean_of
from app.text.guidance_text import end_words, enough_words, target_words, why_words
from app.text.now_text import IDLE_PHASE_DEBOUNCE_S, NowMemory, Said, Tone, now_line
from skincal.contacts.outcome import PressPhase
from skincal.following.session_guide import SessionGuide, plan_of
from skincal.guide.guidance import ClosingStep, Guidance, GuidePhase
from skincal.guide.progress import Need
from skincal.part.part import Part
from skincal.rig.closing import ClosingPlace, ClosingPlaces
from skincal.session.session import Session
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Method
from tests.approved import approved

TILT = float(np.radians(28.0))
DEGREE, ARROW, BETWEEN = "\N{DEGREE SIGN}", "\N{RIGHTWARDS ARROW}", "  \N{MIDDLE DOT}  "


def test_a_target_is_said_verb_first_with_a_neighbour_for_its_direction():
    # The middle of a triangle is channel 3; its neighbours 2 and 4 lie at its lower right and left, 7 and 11 above it.
    straight, tilted = target(3, np.radians(4.0)), target(3, TILT, (0.866, -0.5, 0.0))
    assert target_words(guidance(straight), straight, NAMES) == approved("guide.straight", taxel="3")
    assert target_words(guidance(tilted), tilted, NAMES) == approved("guide.toward", taxel="3", degrees=28, neighbour="2")


def test_the_tool_leans_to_where_its_upper_end_is():
    for channel in (7, 11, 2, 4):
        towards = PLAN.places[channel] - PLAN.places[3]
        asked = target(3, TILT, (*(towards / np.linalg.norm(towards)), 0.0))
        assert lean_of(guidance(asked), asked) == LeanDirection(channel, away=False)
        assert asked.push @ np.array([*towards, 0.0]) < 0, "it pushes the other way"


def test_a_tool_that_leans_over_the_rim_leans_away_from_a_neighbour():
    # Channel 9 is the tip of the triangle, nothing lies above it.
    asked = target(9, TILT, (0.0, 1.0, 0.0))
    lean = lean_of(guidance(asked), asked)
    assert lean is not None
    assert lean.away
    assert target_words(guidance(asked), asked, NAMES) == approved(
        "guide.away", taxel="9", degrees=28, neighbour=NAMES.short(lean.channel)
    )
    # Nobody near: the tilt is said alone.
    alone = replace(guidance(asked), places=np.full((24, 3), 1.0))
    assert target_words(alone, asked, NAMES) == f"Press taxel 9, lean 28{DEGREE}"


def test_why_is_the_error_that_shrinks_or_else_what_is_missing():
    asked = target(3)
    assert why_words(guidance(asked, done=(1, 2)), asked, ()) == approved(
        "guide.depth", now_mm=12.4, then_mm=6.1, done=2, count=24
    )
    along = guidance(asked, method=Method.SURFACE)
    assert why_words(along, asked, {5: "stuck"}) == approved("guide.place", now_mm=12.4, then_mm=6.1, done=0, count=23)
    unseen = guidance(asked, rms=np.inf)
    assert why_words(unseen, asked, ()) == approved("guide.depth_unknown", done=0, count=24)
    balance = guidance(asked, needs={3: (Need.BALANCE,)})
    assert why_words(balance, asked, ()) == approved("guide.other_half", done=0, count=24)


def test_a_place_that_is_asked_for_because_of_one_poke_says_so():
    asked = replace(target(3), landmark="wrist, top")
    step = ClosingStep(ClosingPlace(ClosingPlaces.LANDMARKS, "wrist, top"), 3, 3, 1, suspect_poke=41)
    says = replace(guidance(asked), phase=GuidePhase.CLOSING, closing=step)
    assert why_words(says, asked, ()) == approved("closing.once_more", poke=41)


def test_enough_names_how_many_meet_what():
    every = guidance(done=range(24))
    assert enough_words(every, ()) == approved("guide.enough", count=24)
    assert end_words(every, ()) == approved("verdict.on_space_bar")
    assert enough_words(every, {4: "stuck"}) == approved("guide.enough", count=23)
    assert enough_words(guidance(done=range(20)), ()) == approved("guide.enough_given_up", done=20, count=24)
    assert end_words(every, {4: "stuck"}).startswith(f"1 disabled{BETWEEN}")


def guided(says: Guidance | None, pokes=(), generation: int = 1, phase: PressPhase = PressPhase.READY, now_s: float = 100.0):
    at = session(generation, pokes=pokes)
    return replace(frame(at, reading(phase, 8.0 if phase is PressPhase.PRESSING else 0.0), now_s), guidance=says)


def settled(says: Guidance | None, phase: PressPhase = PressPhase.READY):
    """What is said once the phase has lasted."""
    first = guided(says, phase=phase)
    _, memory = now_line(NowMemory.from_snapshot(first.snapshot), first)
    return now_line(memory, replace(first, now_ns=first.now_ns + round(IDLE_PHASE_DEBOUNCE_S * 1.1e9)))


def test_the_line_says_what_to_poke_when_ready_and_what_is_next_while_hands_are_off():
    asked = target(3)
    now, _ = settled(guidance(asked))
    assert (now.tone, now.headline) == (Tone.GO, approved("guide.straight", taxel="3"))
    assert now.detail == approved("guide.depth", now_mm=12.4, then_mm=6.1, done=0, count=24)
    now, _ = settled(guidance(asked), PressPhase.TARING)
    assert (now.headline, now.detail) == ("Hands off", approved("guide.next_while_taring", taxel="3"))
    now, _ = settled(guidance(done=range(24)))
    assert (now.tone, now.headline) == (Tone.GOOD, approved("guide.enough", count=24))
    assert settled(None)[0].headline == "Ready"
    assert settled(guidance())[0].headline == "Ready", "nothing that could be reached is left"


@pytest.mark.parametrize(
    ("peak", "said"), [(3, "Poke 1 accepted: taxel 3, 11.2 N"), (5, "Poke 1 accepted for taxel 5 (asked: taxel 3)")]
)
def test_a_poke_on_another_taxel_counts_where_it_landed(peak, said):
    _, memory = settled(guidance(target(3)))
    done = guided(guidance(target(7)), [touch(1, (peak,))], 2, PressPhase.TARING, 101.0)
    now, memory = now_line(memory, done)
    assert now.result == Said(Tone.GOOD, said)
    asks = Tone.GO, approved("guide.straight", taxel="7")
    assert (now.tone, now.headline) == asks, "a quick hand does not wait for the line to say it"
    assert ("asked: taxel 3" in now.result.words) == (peak == 5)
    # The same poke with its last tare changes nothing of it, though something else is asked for by now.
    now, memory = now_line(memory, guided(guidance(target(7)), [touch(1, (peak,))], 3, PressPhase.TARING, 101.5))
    assert now.result.words == said
    assert memory.asked == 7


def test_a_rejection_is_a_rejection_whatever_was_asked():
    _, memory = settled(guidance(target(5)))
    now, memory = now_line(memory, guided(guidance(target(5)), [slip(1)], 2, PressPhase.TARING, 101.0))
    assert now.result == Said(Tone.BAD, approved("now.rejected_slid", poke=1, seen_mm=2.1, most_mm=1.5))
    assert now.headline == approved("guide.straight", taxel="5"), "the target stays"
    now, _ = now_line(memory, guided(guidance(target(5)), [slip(1)], 2, PressPhase.PRESSING, 101.2))
    assert now.headline == "Hold still"


def test_without_a_guide_every_accepted_poke_is_accepted():
    _, memory = settled(None)
    now, _ = now_line(memory, guided(None, [touch(1, (5,))], 2, PressPhase.TARING, 101.0))
    assert now.result.words == "Poke 1 accepted: taxel 5, 11.2 N"
    assert now.headline == "Ready"


class Asked:
    """How often a snapshot's evidence was asked for."""

    def __init__(self, monkeypatch) -> None:
        self.times, gather = 0, Snapshot.evidence

        def evidence(snapshot, channels):
            self.times += 1
            return gather(snapshot, channels)

        monkeypatch.setattr(Snapshot, "evidence", evidence)


def test_the_guide_is_asked_once_for_what_is_new(monkeypatch):
    of, guiding = Session(SCENE, None), SessionGuide(part())
    asked = Asked(monkeypatch)
    first = guiding.next_target(of.snapshot(), ("", None), Method.FREE, 0.0)
    assert first is not None
    assert first.target is not None
    assert guiding.next_target(of.snapshot(), ("", None), Method.FREE, 0.0) is first
    of.add(touch(1, (int(first.target.channel),)))
    second = guiding.next_target(of.snapshot(), ("", None), Method.FREE, 0.0)
    assert second is not None
    assert second is not first
    assert second.own.sum() == 1
    assert guiding.next_target(of.snapshot(), ("", None), Method.FREE, 0.0) is second
    assert asked.times == 1
    guiding.wanted = False
    assert guiding.next_target(of.snapshot(), ("", None), Method.FREE, 0.0) is None
    assert asked.times == 1


def test_a_target_that_is_skipped_gives_way_to_another():
    of, guiding = Session(SCENE, None), SessionGuide(part())
    assert guiding.skip() is None
    first = guiding.next_target(of.snapshot(), ("", None), Method.FREE, 0.0)
    of.act(guiding.skip())
    second = guiding.next_target(of.snapshot(), ("", None), Method.FREE, 0.0)
    assert first is not None
    assert second is not None
    assert first.target is not None
    assert second.target is not None
    assert second.target.channel != first.target.channel


def test_where_the_plan_leaves_a_taxel_out_the_guide_does():
    whole = part()
    whole.laid.places[5] = np.nan
    plan = plan_of(whole)
    assert plan is not None
    assert plan.channels.tolist() == [c for c in range(24) if c != 5]
    assert plan.modules.tolist() == 11 * [0] + 12 * [1]
    of, guiding = Session(SCENE, None), SessionGuide(whole)
    of.add(touch(1, (5, 6), (50.0, 20.0)))
    of.add(touch(2, (23,)))
    says = guiding.next_target(of.snapshot(), ("", None), Method.FREE, 0.0)
    assert says is not None
    assert dict(zip(says.channels.tolist(), says.own.tolist(), strict=True))[23] == 1


def test_without_a_layout_on_the_part_taxels_are_guided_on_once_they_answered():
    bare = scene(None)
    for nowhere in (Part(bare, None, None, np.arange(24), ()), Part(SCENE, None, None, layout().channels, ())):
        guiding = SessionGuide(nowhere)
        of = Session(nowhere.scene, None)
        says = guiding.next_target(of.snapshot(), ("", None), Method.FREE, 0.0)
        assert says.phase is GuidePhase.COVER
        assert says.target is None, "nowhere to look without a surface"
        assert not len(says.channels)
        for poke, (x, y) in enumerate([(0.0, 0.0), (3.0, 0.0), (0.0, 3.0)], 1):
            of.add(touch(poke, (5, 6), (50.0, 20.0), force=(x, y, -10.0)))
        says = guiding.next_target(of.snapshot(), ("", None), Method.FREE, 0.0)
        assert says.phase is GuidePhase.OWN
        assert says.channels.tolist() == [5, 6]
        assert says.own.tolist() == [3, 0]
        assert says.target.channel in (5, 6)


def test_a_layout_that_lies_nowhere_still_tells_of_modules():
    """Or all of them would count as one, known from four pokes."""
    nowhere = Part(SCENE, None, None, layout().channels, ())
    assert plan_of(nowhere).modules.tolist() == 12 * [0] + 12 * [1]
    guiding, of = SessionGuide(nowhere), Session(SCENE, None)
    for poke, (x, y) in enumerate([(0.0, 0.0), (3.0, 0.0), (0.0, 3.0), (2.0, 2.0), (-3.0, 0.0)], 1):
        of.add(touch(poke, (poke, poke + 1), (50.0, 20.0), force=(x, y, -10.0)))
    of.add(touch(6, (15, 16), (50.0, 20.0)))
    says = guiding.next_target(of.snapshot(), ("", None), Method.MODULES, 0.0)
    needs = dict(zip(says.channels.tolist(), says.needs, strict=True))
    assert Need.POKES in needs[15]
    assert Need.POKES not in needs[3]


def test_a_poke_that_is_taken_back_is_not_said_to_count():
    poke = touch(1, (3,))
    before = NowMemory.from_snapshot(session())
    now, memory = now_line(before, frame(session(2, pokes=[poke]), now_s=1.0))
    assert now.result.words.startswith("Poke 1 accepted")
    now, memory = now_line(memory, frame(session(3, pokes=[poke], excluded=[1]), now_s=1.1))
    assert now.result is None
    later, _ = now_line(memory, frame(session(3, pokes=[poke], excluded=[1]), now_s=1.2))
    assert later.result is None
