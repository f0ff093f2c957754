"""The Taxel tab: contacts of a taxel from above, its estimates and pokes, and what is doubted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from app.panels.inspect_panel import PICTURE_LEGENDS, PLOT_SIZE_PX, AxisDiversityPanel, InspectPanel, poke_cells
from app.panels.pokes_panel import PokesPanel
from app.panels.taxel_map import TaxelMap
from app.panels.top_view import CONTACT_PLOT_RADIUS_M, RIM_SINE, SHADE_POINTS_PER_SIDE, diversity_view
from app.session.opening import OpenRequest
from app.state.camera_pose import PLAIN_POSE
from app.text.guidance_text import GUIDE_SENTENCE_OF_METHOD, REDUCED_ERROR_WORDS, diversity_words
from app.theme import DARK, LIGHT
from skincal.guide.candidates import candidate_pushes
from skincal.guide.progress import AxisDiversity
from skincal.model.actions import MarkDead, Revive
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.poke_figures import MAX_LISTED_POKES_PER_TAXEL, doubting, miss_of, taxel_pokes, weight_of
from skincal.taxels.result import Estimate, Method, Rival, State
from skincal.words.taxel_words import doubt_mark, doubt_words, rival_words
from skincal.words.units import DASH
from tests.app.guide_support import eye_of, guidance, target
from tests.app.scene3d_support import contact, estimate
from tests.app.window_support import (
    NAMES,
    PLAN,
    SCENE,
    changed,
    context,
    frame,
    ink,
    paints_from_now,
    pixels,
    session,
    show_in,
    shown,
    touch,
)
from tests.approved import approved

UP = np.array([0.0, 0.0, 1.0])
USABLE = float(np.radians(28.0))


def push(tilt: float, azimuth: float) -> np.ndarray:
    """The push of a tool whose upper end leans to `azimuth`; degrees."""
    tilt, azimuth = np.radians([tilt, azimuth])
    return -np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])


def diversity(pushes=(), best: float | None = 90.0, **changes) -> AxisDiversity:
    """Contacts of taxel 3; a push from `best` degrees helps most, `None` if no push helps."""
    count = len(pushes)
    tried = candidate_pushes(UP[None], USABLE)[0]
    worth = np.zeros(len(tried)) if best is None else 1e-3 * (1.2 + tried @ push(28.0, best))
    made = AxisDiversity(
        channel=3, normal=UP, pushes=np.array(pushes).reshape(-1, 3), offsets=np.zeros((count, 3)),
        own=np.ones(count, dtype=bool), trust=np.ones(count), beside=np.zeros(3), diversity=float(np.radians(9.0)),
        usable_tilt=USABLE, tried=tried, worth=worth,
    )  # fmt: skip
    return replace(made, **{name: np.array(value) for name, value in changes.items()})


def test_a_contact_is_drawn_at_the_tools_upper_end():
    view = diversity_view(diversity([push(0, 0), push(28, 0), push(28, 90), push(60, 180)]), Method.FREE, PLAIN_POSE)
    reach = np.sin(np.radians(28.0)) / RIM_SINE
    np.testing.assert_allclose(view.dots, [[0, 0], [reach, 0], [0, reach], [-1, 0]], atol=1e-12)
    assert view.limit == pytest.approx(reach)
    assert view.middle is None
    turned = diversity_view(diversity([push(28, 0)]), Method.FREE, eye_of(PLAIN_POSE.up, -PLAIN_POSE.right))
    np.testing.assert_allclose(turned.dots, [[0, -reach]], atol=1e-12)


@pytest.mark.parametrize("best", [0.0, 90.0, 225.0])
def test_the_tint_is_deepest_in_the_best_direction_and_ends_at_the_usable_tilt(best):
    view = diversity_view(diversity(best=best), Method.FREE, PLAIN_POSE)
    row, column = np.unravel_index(view.shade.argmax(), view.shade.shape)
    deepest = np.array([(column + 0.5) / SHADE_POINTS_PER_SIDE * 2 - 1, 1 - (row + 0.5) / SHADE_POINTS_PER_SIDE * 2])
    side = np.array([np.cos(np.radians(best)), np.sin(np.radians(best))])
    assert deepest @ side > 0.9 * view.limit
    assert view.wanted @ side > 0.9 * view.limit
    step = (np.arange(SHADE_POINTS_PER_SIDE) + 0.5) / SHADE_POINTS_PER_SIDE * 2 - 1
    np.testing.assert_array_equal(view.shade > 0, np.hypot(*np.meshgrid(step, step)) <= view.limit)
    nothing = diversity_view(diversity([push(10, 0)], best=None), Method.FREE, PLAIN_POSE)
    assert not nothing.shade.any()
    assert nothing.wanted is None


def test_for_the_surface_method_contact_points_count_and_not_directions():
    says = diversity([push(28, 0)] * 2, offsets=[(0.002, 0, 0), (0, 0.02, 0)], beside=(0.001, 0.001, 0))
    view = diversity_view(says, Method.SURFACE, PLAIN_POSE)
    np.testing.assert_allclose(view.dots, [[0.4, 0], [0, 1]])
    np.testing.assert_allclose(view.middle, [0.2, 0.2])
    assert view.limit == pytest.approx(0.001 / CONTACT_PLOT_RADIUS_M)
    assert (view.shade.any(), view.wanted) == (False, None)


def test_every_method_has_its_words_and_its_picture():
    for words in (GUIDE_SENTENCE_OF_METHOD, PICTURE_LEGENDS, REDUCED_ERROR_WORDS):
        assert set(words) == set(Method)
    of = diversity([push(28, 0)] * 2)
    for method in Method:
        assert diversity_words(of, method)
        assert (diversity_view(of, method, PLAIN_POSE).limit > 0) is (method is not Method.MODULES)


@pytest.fixture
def panel(qtbot):
    return shown(qtbot, AxisDiversityPanel(NAMES), (420, 180))


def framed(says: AxisDiversity | None, selected=None, asked=3, method=Method.FREE, generation=1, **changes):
    asked_for = guidance(None if asked is None else target(asked), method=method)
    at = frame(session(generation), selected=selected, method=method)
    return replace(at, guidance=asked_for, diversity=says, **changes)


@pytest.mark.parametrize("colours", [DARK, LIGHT])
def test_own_pokes_are_filled_others_hollow_and_doubted_ones_small(panel, colours):
    show_in(colours)
    filled = []
    for generation, (own, trust) in enumerate([(True, 1.0), (False, 1.0), (True, 0.1)], start=1):
        panel.show_state(framed(diversity([push(20, 135)], None, own=[own], trust=[trust]), generation=generation))
        at = panel.plot._at(diversity_view(diversity([push(20, 135)]), Method.FREE, PLAIN_POSE).dots[0])
        x, y = round(PLOT_SIZE_PX / 2 + at.x()), round(PLOT_SIZE_PX / 2 + at.y())
        filled.append(ink(pixels(panel.plot)[y - 8 : y + 9, x - 8 : x + 9], colours.text))
    whole, hollow, small = filled
    assert whole > 20
    assert hollow < 0.75 * whole
    assert small < 0.45 * whole


def test_the_best_direction_is_a_diamond_and_the_tint_is_visible(panel):
    panel.show_state(framed(diversity(best=None)))
    plain = pixels(panel.plot)
    panel.show_state(framed(diversity(best=0.0), generation=2))
    east = pixels(panel.plot)
    assert changed(plain, east) > 2000
    half = PLOT_SIZE_PX // 2
    assert ink(east[:, half:], "#FFFFFF") > 10
    assert ink(east[:, :half], "#FFFFFF") == 0


def test_the_words_follow_taxel_and_method_and_the_panel_hides_without_a_taxel(panel):
    at = framed(diversity([push(20, 0)] * 5, own=[True, True, False, False, False]))
    panel.show_state(at)
    assert panel.whose.text() == "Taxel 3, the target"
    assert panel.spread.text() == diversity_words(at.diversity, Method.FREE).capitalize()
    assert panel.contacts.text() == "5 pokes, 2 with this taxel strongest"
    assert "free method" in panel.follows.text()
    panel.show_state(framed(diversity([push(0, 0)], beside=(0.0013, 0, 0)), selected=5, method=Method.SURFACE))
    assert panel.spread.text() == approved("guide.middle_astray", miss_mm=1.3, most_mm=1.0)
    assert "surface method" in panel.follows.text()
    panel.show_state(replace(at, selected=15, diversity=replace(diversity(), channel=15)))
    assert panel.whose.text() == "Taxel 15"
    states = (at, replace(at, selected=15), framed(None, asked=None))
    assert [state.focused_channel for state in states] == [3, 15, None]
    panel.show_state(states[2])
    assert panel.isHidden()


def test_the_picture_is_drawn_again_after_a_change_only(panel, qtbot):
    at = framed(diversity([push(20, 0)]))
    panel.show_state(at)
    paints = paints_from_now(qtbot, panel.plot)
    turned = replace(at, eye=eye_of(PLAIN_POSE.up, -PLAIN_POSE.right))
    skipped = replace(turned, guidance=guidance(target(3)), diversity=diversity([push(20, 90)]))
    slightly = replace(at, now_ns=at.now_ns + 1, eye=eye_of(PLAIN_POSE.right + 1e-4, PLAIN_POSE.up))
    for state, drawn in ((slightly, 0), (slightly, 0), (turned, 1), (skipped, 2)):
        panel.show_state(state)
        qtbot.wait(30)
        assert paints.count == drawn


def test_the_window_computes_the_diversity_of_the_focused_taxel_once(bench, recorded, monkeypatch):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    bench.key(Qt.Key.Key_N, Qt.KeyboardModifier.ShiftModifier)
    view, asked = bench.window.session_view, []
    assert view.state.diversity.channel == view.state.target.channel
    of = view.guided.guide.axis_diversity
    monkeypatch.setattr(view.guided.guide, "axis_diversity", lambda channel: asked.append(channel) or of(channel))
    channels = bench.snapshot.pokes[0].outcome.channels.tolist()
    other = next(channel for channel in channels if channel != view.state.diversity.channel)
    view.select_taxel(other)
    for _ in range(4):
        view.show()
    assert (view.state.diversity.channel, asked) == (other, [other])
    bench.key(Qt.Key.Key_N)
    assert asked == [other, other], "a skipped target changes what helps most"
    bench.key(Qt.Key.Key_G)
    assert view.state.diversity is None


# Estimates and pokes of a taxel


def ambiguous(channel: int = 3, odds: float = 3.2) -> Estimate:
    """A taxel with a second possible position, 34 mm along x."""
    there = Rival(np.array([0.034, 0.0, 0.0]), 1, odds)
    return replace(estimate(channel, (0.0, 0.0, 0.0), Method.SURFACE), rival=there)


def doubted(channel: int = 3, **trust: float) -> Estimate:
    return replace(estimate(channel, (0.0, 0.0, 0.0)), doubted={int(poke[1:]): value for poke, value in trust.items()})


def test_weight_and_miss_are_those_of_the_methods():
    poke = touch(1, (2, 3, 5), (40.0, 10.0, 25.0))
    assert [weight_of(poke, channel) for channel in (2, 3, 5)] == [1.0, 0.25, 0.625]
    assert ContactTable([poke]).evidence([2, 3, 5]).weights.tolist() == [1.0, 0.25, 0.625]
    for force in ((0.0, 0.0, -8.0), (3.0, 0.0, -4.0)):
        aside = np.cross(force, (0.0, 1.0, 0.0)) / np.linalg.norm(force)
        poke = contact(1, 3, 0.014 * aside, force)
        assert miss_of(poke, estimate(3, (0.0, 0.0, 0.0))) == pytest.approx(0.014)
        assert miss_of(poke, Estimate(3, Method.FREE, State.BLIND, 1)) is None


def test_the_pokes_of_a_taxel_come_newest_first_without_excluded_ones():
    at = session(1, {3: doubted(3, p2=0.2)}, [touch(1), touch(2), touch(3), touch(4, (5,))], excluded=[3])
    pokes = taxel_pokes(at.contacts_newest_first(), at.estimates[Method.FREE][3])
    assert [(poke.poke, poke.weight, poke.trust) for poke in pokes] == [(2, 1.0, 0.2), (1, 1.0, 1.0)]
    assert poke_cells(pokes[0])[:3] == ("2", "1.00", "\N{CIRCLE WITH LEFT HALF BLACK} 0.20")
    assert poke_cells(pokes[1])[2] == "1"
    assert taxel_pokes(at.contacts_newest_first(), Estimate(3, Method.FREE, State.DEAD, 0)) == ()
    many = session(1, {3: doubted(3)}, [touch(poke) for poke in range(2, MAX_LISTED_POKES_PER_TAXEL + 2)])
    unread = replace(many, pokes=(None, *many.pokes))
    listed = taxel_pokes(unread.contacts_newest_first(), many.estimates[Method.FREE][3])
    assert [poke.poke for poke in listed] == list(range(MAX_LISTED_POKES_PER_TAXEL + 1, 1, -1)), "older ones are not even read"


def test_a_doubted_poke_is_marked_with_the_taxel_and_the_reason(qtbot):
    poke = contact(7, 3, (0.014, 0.0, 0.0))
    doubters = doubting([doubted(4, p7=0.4), doubted(3, p7=0.2), doubted(5, p7=0.9, p8=1.0)])
    assert [e.channel for e in doubters[7]] == [3, 4, 5]
    assert 8 not in doubters
    assert doubt_mark(7, doubters[7], NAMES) == "weight 0.2 for taxel 3 +1"
    assert doubt_mark(7, doubters[7][2:], NAMES) == ""
    assert doubt_words(poke, doubters[7][0], NAMES) == approved("taxel.doubted", trust="0.20", taxel="3", miss_mm=14.0)
    panel = shown(qtbot, PokesPanel(context()))
    panel.show_state(frame(session(2, {3: doubted(3, p2=0.2)}, [touch(1), touch(2)])))
    assert panel.model.index(0, 1).data() == "\N{CIRCLE WITH LEFT HALF BLACK} weight 0.2 for taxel 3"
    assert "its force axis is" in panel.model.index(0, 1).data(Qt.ItemDataRole.ToolTipRole)
    assert panel.model.index(1, 1).data() == "\N{CHECK MARK} accepted"


def test_the_tab_shows_the_methods_the_reason_the_pokes_and_the_worst_taxels(qtbot):
    panel = shown(qtbot, InspectPanel(context()), (420, 700))
    panel.show_state(framed(diversity([push(20, 0)])))
    assert panel.diversity.isVisible()
    assert panel.heading.text() == NAMES.long(3).capitalize()
    assert panel.diversity.whose.text() == "Taxel 3, the target"
    assert not panel.use.isEnabled(), "the target may change before the click"
    at = session(2, {3: estimate(3, (0.001, 0.002, 0.003))}, dead={4: "stuck at 255"})
    panel.show_state(frame(at, selected=3))
    assert not panel.diversity.isVisible()
    assert panel.cells[Method.FREE][0].text() == "1.0  2.0  3.0"
    assert panel.cells[Method.FREE][3].text() == "1.0 mm"
    assert "Free and surface method place it" in panel.reason.text()
    assert not panel.pokes.isVisible()
    assert panel.worst.item(0).text().endswith("   untouched")
    for channel, action in ((3, MarkDead(3)), (4, Revive(4))):
        panel.show_state(frame(at, selected=channel))
        with qtbot.waitSignal(panel.action_wanted) as asked:
            QTest.mouseClick(panel.use, Qt.MouseButton.LeftButton)
        assert asked.args == [action]
    assert panel.reason.text() == "stuck at 255"
    with qtbot.waitSignal(panel.taxel_wanted):
        panel.worst.itemActivated.emit(panel.worst.item(2))
    known = {3: replace(ambiguous(), doubted={1: 0.25})}
    panel.show_state(frame(session(3, known, [touch(1, (3, 4), (10.0, 50.0)), touch(2)]), selected=3))
    assert panel.rival.isVisible()
    assert rival_words(known[3]) in panel.rival.text()
    rows = [[panel.pokes.topLevelItem(row).text(column) for column in range(4)] for row in range(2)]
    assert rows[0][:3] == ["2", "1.00", "1"]
    assert rows[1][:3] == ["1", "0.20", "\N{CIRCLE WITH LEFT HALF BLACK} 0.25"]
    with qtbot.waitSignal(panel.poke_wanted) as wanted:
        panel.pokes.itemActivated.emit(panel.pokes.topLevelItem(1), 0)
    assert wanted.args == [1]
    panel.show_state(frame(session(4), selected=4))
    assert not panel.rival.isVisible()
    panel.show_state(frame(session(5)))
    assert panel.heading.text() == "No taxel selected", "nothing is left of the taxel that was selected"
    assert panel.cells[Method.FREE][5].text() == DASH


def test_an_ambiguous_taxel_tells_how_far_how_likely_and_what_to_do():
    assert rival_words(ambiguous()) == approved("taxel.rival", away_mm=34, odds=3)
    assert rival_words(estimate(3, (0, 0, 0))) == rival_words(None) == ""


@pytest.mark.parametrize("size", [(420, 300), (60, 60)], ids=["shapes", "dots"])
def test_the_map_marks_an_ambiguous_taxel_by_a_shape_of_its_own(qtbot, size):
    view = shown(qtbot, TaxelMap(SCENE, PLAN.channels, NAMES), size)
    sure = {3: estimate(3, (0, 0, 0)), 20: estimate(20, (0, 0, 0))}
    view.show_state(frame(session(1, sure)))
    before = pixels(view)
    view.show_state(frame(session(2, {**sure, 3: ambiguous()})))
    after = pixels(view)

    def near(channel: int) -> tuple[slice, slice]:
        place = view.place_of(channel).toPoint()
        return np.s_[max(0, place.y() - 9) : place.y() + 9, max(0, place.x() - 9) : place.x() + 9]

    assert changed(before[near(3)], after[near(3)]) > 5
    assert changed(before[near(20)], after[near(20)]) == 0
    assert approved("taxel.rival_on_map") in view.tell(3)
    assert "another" not in view.tell(20)
