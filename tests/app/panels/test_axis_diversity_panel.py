"""The axis diversity of a taxel: what is drawn of its contacts, for which method, and when."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from guide_support import eye_of, guidance, target
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor
from whole_window import Paints
from window_support import NAMES, changed, frame, pixels, session

from app.panels.inspect_panel import LEGENDS, PLOT_PX, AxisDiversityPanel, InspectPanel
from app.panels.top_view import AROUND_TAXEL, EDGE, GRAIN, diversity_view
from app.scene3d.camera import PLAIN_POSE
from app.session.opening import OpenRequest
from app.text.guidance_text import FOLLOWS, WHAT, diversity_words
from app.text.outcomes import METHOD_NAMES
from app.theme import DARK, LIGHT
from skincal.guide.candidates import push_directions
from skincal.guide.progress import AxisDiversity
from skincal.taxels.result import Method
from tests.app.window_support import show_in
from tests.approved import approved

UP = np.array([0.0, 0.0, 1.0])
USABLE = float(np.radians(28.0))


def push(tilt: float, azimuth: float) -> np.ndarray:
    """The push of a tool whose upper end leans to `azimuth`; degrees."""
    tilt, azimuth = np.radians([tilt, azimuth])
    return -np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])


def diversity(
    pushes=(), own=None, trust=None, offsets=None, best: float | None = 90.0, beside=(0.0, 0.0, 0.0), spread=9.0
) -> AxisDiversity:
    """Contacts; what is worth most is a push from `best` degrees, None where nothing is worth anything."""
    count = len(pushes)
    tried = push_directions(UP[None], USABLE)[0]
    worth = np.zeros(len(tried)) if best is None else 1e-3 * (1.2 + tried @ push(28.0, best))
    return AxisDiversity(
        channel=3, normal=UP, pushes=np.array(pushes).reshape(-1, 3),
        offsets=np.zeros((count, 3)) if offsets is None else np.array(offsets, dtype=float),
        own=np.ones(count, dtype=bool) if own is None else np.array(own),
        trust=np.ones(count) if trust is None else np.array(trust),
        beside=np.array(beside), diversity=float(np.radians(spread)), usable_tilt=USABLE, tried=tried, worth=worth,
    )  # fmt: skip


def test_a_contact_is_where_the_tools_upper_end_stood():
    view = diversity_view(diversity([push(0, 0), push(28, 0), push(28, 90), push(60, 180)]), Method.FREE, PLAIN_POSE)
    reach = np.sin(np.radians(28.0)) / EDGE
    np.testing.assert_allclose(view.dots, [[0, 0], [reach, 0], [0, reach], [-1, 0]], atol=1e-12)
    assert view.limit == pytest.approx(reach)
    assert view.middle is None
    turned = diversity_view(diversity([push(28, 0)]), Method.FREE, eye_of(PLAIN_POSE.up, -PLAIN_POSE.right))
    np.testing.assert_allclose(turned.dots, [[0, -reach]], atol=1e-12)


@pytest.mark.parametrize("best", [0.0, 90.0, 225.0])
def test_the_tint_is_deepest_where_the_next_poke_tells_most_and_ends_at_the_usable_tilt(best):
    view = diversity_view(diversity(best=best), Method.FREE, PLAIN_POSE)
    row, column = np.unravel_index(view.shade.argmax(), view.shade.shape)
    x, y = (column + 0.5) / GRAIN * 2 - 1, 1 - (row + 0.5) / GRAIN * 2
    side = np.array([np.cos(np.radians(best)), np.sin(np.radians(best))])
    assert np.array([x, y]) @ side > 0.9 * view.limit
    assert view.wanted is not None
    assert view.wanted @ side > 0.9 * view.limit
    step = (np.arange(GRAIN) + 0.5) / GRAIN * 2 - 1
    outside = np.hypot(*np.meshgrid(step, step)) > view.limit
    assert (view.shade[outside] == 0).all()
    assert (view.shade[~outside] > 0).all()


def test_where_nothing_is_worth_a_poke_nothing_is_tinted():
    view = diversity_view(diversity([push(10, 0)], best=None), Method.FREE, PLAIN_POSE)
    assert not view.shade.any()
    assert view.wanted is None


def test_for_the_surface_method_places_count_and_no_sides():
    view = diversity_view(
        diversity([push(28, 0)] * 2, offsets=[(0.002, 0, 0), (0, 0.02, 0)], beside=(0.001, 0.001, 0)),
        Method.SURFACE,
        PLAIN_POSE,
    )
    np.testing.assert_allclose(view.dots, [[0.4, 0], [0, 1]])
    np.testing.assert_allclose(view.middle, [0.2, 0.2])
    assert view.limit == pytest.approx(0.001 / AROUND_TAXEL)
    assert not view.shade.any()
    assert view.wanted is None


@pytest.fixture
def panel(qtbot):
    show_in(DARK)
    made = AxisDiversityPanel(NAMES)
    qtbot.addWidget(made)
    made.resize(420, 180)
    with qtbot.waitExposed(made):
        made.show()
    return made


def framed(says: AxisDiversity | None, selected=None, asked=3, method=Method.FREE, generation=1, **changes):
    asked_for = guidance(None if asked is None else target(asked), method=method)
    at = frame(session(generation), selected=selected, method=method)
    return replace(at, guidance=asked_for, diversity=says, **changes)


def ink(picture, colour) -> int:
    wanted = np.array(QColor(colour).getRgb()[:3])
    return int((np.abs(picture[..., :3].astype(int) - wanted).max(axis=2) < 8).sum())


@pytest.mark.parametrize("colours", [DARK, LIGHT])
def test_own_pokes_are_filled_others_hollow_and_doubted_ones_small(panel, colours):
    show_in(colours)
    filled = []
    for generation, (own, trust) in enumerate([(True, 1.0), (False, 1.0), (True, 0.1)], start=1):
        panel.show_state(framed(diversity([push(20, 135)], [own], [trust], best=None), generation=generation))
        view = diversity_view(diversity([push(20, 135)]), Method.FREE, PLAIN_POSE)
        at = panel.plot._at(view.dots[0])
        x, y = round(PLOT_PX / 2 + at.x()), round(PLOT_PX / 2 + at.y())
        filled.append(ink(pixels(panel.plot)[y - 8 : y + 9, x - 8 : x + 9], colours.text))
    whole, hollow, small = filled
    assert whole > 20
    assert hollow < 0.75 * whole
    assert small < 0.45 * whole


def test_the_next_side_is_a_square_and_the_tint_is_seen(panel):
    panel.show_state(framed(diversity(best=None)))
    plain = pixels(panel.plot)
    panel.show_state(framed(diversity(best=0.0), generation=2))
    east = pixels(panel.plot)
    assert changed(plain, east) > 2000
    moved = (plain != east).any(axis=2)
    half = PLOT_PX // 2
    assert ink(east[:, half:], "#FFFFFF") > 10
    assert ink(east[:, :half], "#FFFFFF") == 0
    assert not moved[:10].any()


def test_words_say_what_the_method_needs_and_which_the_guide_follows(panel):
    panel.show_state(framed(diversity([push(20, 0)] * 5, [True, True, False, False, False])))
    assert panel.whose.text() == "10-03, the target"
    assert panel.spread.text() == "Directions spread 9\N{DEGREE SIGN}, needs 15\N{DEGREE SIGN}"
    assert panel.contacts.text() == "5 pokes, 2 strongest here"
    assert "free method" in panel.follows.text()
    assert "tilt" in panel.follows.text()
    panel.show_state(framed(diversity([push(0, 0)], beside=(0.0013, 0, 0)), selected=5, method=Method.SURFACE))
    assert panel.spread.text() == approved("guide.middle_astray", miss_mm=1.3, most_mm=1.0)
    assert "surface method" in panel.follows.text()
    assert "evenness" in panel.follows.text()
    panel.show_state(framed(diversity(), method=Method.SURFACE))
    assert (panel.spread.text(), panel.contacts.text()) == ("Not poked yet", "")


def test_it_is_of_the_selected_taxel_else_of_the_target_and_goes_where_there_is_neither(panel):
    at = framed(diversity())
    assert (at.looked_at, replace(at, selected=15).looked_at, framed(None, asked=None).looked_at) == (3, 15, None)
    panel.show_state(at)
    assert panel.whose.text() == "10-03, the target"
    panel.show_state(replace(at, selected=15, diversity=replace(diversity(), channel=15)))
    assert panel.whose.text() == "11-03"
    panel.show_state(replace(framed(None, asked=None), selected=None))
    assert panel.isHidden()
    panel.show_state(replace(at, diversity=None, snapshot=replace(at.snapshot, generation=9)))
    assert panel.isHidden()


def test_the_same_sky_is_not_drawn_again(panel, qtbot):
    at = framed(diversity([push(20, 0)]))
    panel.show_state(at)
    qtbot.wait(30)
    paints = Paints(panel.plot)
    for _ in range(4):
        panel.show_state(replace(at, now_ns=at.now_ns + 1, eye=eye_of(PLAIN_POSE.right + 1e-4, PLAIN_POSE.up)))
    qtbot.wait(30)
    assert paints.count == 0
    turned = replace(at, eye=eye_of(PLAIN_POSE.up, -PLAIN_POSE.right))
    panel.show_state(turned)
    qtbot.wait(30)
    assert paints.count == 1
    panel.show_state(replace(turned, guidance=guidance(target(3)), diversity=diversity([push(20, 90)])))
    qtbot.wait(30)
    assert paints.count == 2, "what was skipped changes what is worth asking"


def test_the_window_asks_once_for_the_diversity_of_the_taxel_that_is_looked_at(bench, recorded, monkeypatch):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    bench.key(Qt.Key.Key_N, Qt.KeyboardModifier.ShiftModifier)
    view, asked = bench.window.session_view, []
    assert view.state.diversity.channel == view.state.target.channel
    diversity_of = view.guided.guide.axis_diversity
    monkeypatch.setattr(
        view.guided.guide, "axis_diversity", lambda channel, evidence: asked.append(channel) or diversity_of(channel, evidence)
    )
    other = next(
        channel for channel in bench.snapshot.pokes[0].outcome.channels.tolist() if channel != view.state.diversity.channel
    )
    view.select_taxel(other)
    assert view.state.diversity.channel == other
    for _ in range(4):
        view.show()
    assert asked == [other]
    bench.key(Qt.Key.Key_N)
    assert asked == [other, other], "what was skipped changes what is worth asking"
    bench.key(Qt.Key.Key_G)
    assert view.state.diversity is None


def test_the_taxel_tab_shows_the_diversity_of_the_target_before_anything_is_selected(qtbot):
    tab = InspectPanel((Method.FREE,), NAMES)
    qtbot.addWidget(tab)
    tab.resize(420, 500)
    with qtbot.waitExposed(tab):
        tab.show()
    tab.show_state(framed(diversity([push(20, 0)])))
    assert tab.diversity.isVisible()
    assert tab.title.text() == "No taxel selected"
    tab.show_state(replace(framed(diversity([push(20, 0)]), generation=2), guidance=None, diversity=None))
    assert not tab.diversity.isVisible()


def test_every_method_has_its_words_and_its_picture():
    for words in (FOLLOWS, LEGENDS, WHAT, METHOD_NAMES):
        assert set(words) == set(Method)
    of = diversity([push(28, 0)] * 2)
    for method in Method:
        assert diversity_words(of, method)
        assert (diversity_view(of, method, PLAIN_POSE).limit > 0) is (method is not Method.MODULES)
