"""The line in large type and the tool from above: what fits, what is drawn, and when."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from PySide6.QtWidgets import QApplication, QSizePolicy

from app.panels.now_panel import TILT_DIAL_SIZE_PX, NowPanel
from app.panels.top_view import DIAL_RADIUS_M, axes_on, top_view
from app.scene3d.lines import DRAWN_TOOL_LENGTH_M
from app.state.camera_pose import PLAIN_POSE
from app.state.press_coach import HintKind, LeanDirection, PressHint
from app.state.running import Running
from app.text.guidance_text import enough_words, hint_words, lean_words
from app.text.now_text import Now, NowMemory, Said, Tone, now_line
from app.theme import DARK, HEADLINE_FONT_SIZE_PT, LIGHT
from skincal.contacts.outcome import PressPhase, Reason
from skincal.taxels.result import Method
from skincal.words.outcome_words import outcome_headline
from tests.app.guide_support import ASKED, TILT, TO_2, coaching_of, eye_of, guidance, held, target
from tests.app.window_support import (
    NAMES,
    PLAN,
    changed,
    frame,
    ink,
    is_elided,
    paints_from_now,
    pixels,
    reading,
    session,
    show_in,
    shown,
    slip,
    touch,
)
from tests.approved import approved

LEEWAY, DEGREE = float(np.radians(10.0)), "\N{DEGREE SIGN}"
WORST = {
    Reason.TOO_SOFT: (3.2, 4.0, "N"),
    Reason.TOO_HARD: (18.2, 15.0, "N"),
    Reason.NOT_STILL: (0.123, 0.05, "1"),
    Reason.SLID: (0.0121, 0.0015, "m"),
    Reason.TWO_CONTACTS: (0.0123, 0.008, "m"),
    Reason.NO_TAXEL: (0, 1, ""),
    Reason.TOO_MANY_TAXELS: (12, 6, ""),
    Reason.NOT_CONNECTED: (0.0543, 0.0081, "m"),
    Reason.SATURATED: (3, 0, ""),
    Reason.READINGS_LOST: (0.34, 0.06, "s"),
    Reason.NO_TARE: (62.0, 60.0, "s"),
    Reason.TARE_CHANGED: (11.4, 1.0, "N"),
    Reason.NO_POSE: (0, 1, ""),
    Reason.ARM_MOVED: (0.4, 0.01, "rad"),
}


class Long:
    """Names as long as they get: the whole body has 4200 taxels."""

    def short(self, channel: int) -> str:
        return f"{4100 + channel}"

    def taxel(self, channel: int) -> str:
        return f"taxel {self.short(channel)}"


def every_headline() -> list[str]:
    """What the line may say, at its longest."""
    lean, names = LeanDirection(7, away=True), Long()
    says = guidance(ASKED)
    said = [outcome_headline(slip(1, reason, *worst), NAMES) for reason, worst in WORST.items()]
    said += [outcome_headline(slip(1, Reason.NOT_STILL, 0.21, 0.3, "s"), NAMES), f"counted for {names.taxel(11)}  11.2 N"]
    said += [f"Press {names.taxel(11)}, lean 28{DEGREE} {lean_words(lean, names)}", enough_words(guidance(done=range(24)), ())]
    said += [
        hint_words(PressHint(ask, amount, lean), ASKED, names)
        for ask, amount in ((HintKind.AIM, 0.0149), (HintKind.MORE, 0.7), (HintKind.LESS, 0.7))
    ]
    said += [
        approved("now.waiting_for_all"),
        "No device connected",
        approved("guide.enough", count=4200),
        approved("guide.enough_given_up", done=4100, count=4200),
    ]
    for phase in PressPhase:
        for force in (2.0, 8.0, 16.0):
            at = replace(frame(view=reading(phase, force)), guidance=says)
            said.append(now_line(NowMemory.from_snapshot(at.snapshot), at)[0].headline)
    return said


@pytest.fixture
def panel(qtbot):
    """The panel as wide as in a window of 1280 pixels."""
    made = NowPanel()
    made.memory = NowMemory.from_snapshot(session())
    return shown(qtbot, made, (1264, made.height()))


def tell(panel, at):
    """Show a tick with its words, as the session's view does."""
    now, panel.memory = now_line(panel.memory, at)
    panel.show_state(at, now)


def test_it_tells_what_to_do_the_ring_fills_and_a_rejection_is_bad(panel):
    tell(panel, frame(view=reading(PressPhase.PRESSING, 8.0, still=0.1)))
    assert panel.headline.text() == "Hold still"
    little = pixels(panel.sign)
    tell(panel, frame(view=reading(PressPhase.STILL, 8.0, still=0.9)))
    assert changed(little, pixels(panel.sign)) > 200
    tell(panel, frame(session(2, pokes=[slip(1)]), reading(PressPhase.TARING)))
    assert panel.result.text().endswith(approved("now.rejected_slid", poke=1, seen_mm=2.1, most_mm=1.5))
    assert ink(pixels(panel), DARK.bad, 1) > 100


def test_without_devices_no_force_is_shown(panel):
    pictures = []
    for running, force in (
        (Running.STREAMING, 0.0),
        (Running.PAUSED, 8.0),
        (Running.STREAMING, 8.0),
        (Running.STREAMING, 14.0),
    ):
        tell(panel, frame(view=reading(PressPhase.STILL, force), running=running))
        pictures.append(pixels(panel.gauge))
    assert [changed(a, b) > 200 for a, b in pairwise(pictures)] == [False, True, True]
    assert changed(pictures[0], pictures[1]) == 0


def pressed(panel, view=None, asked=ASKED, method=Method.FREE, eye=PLAIN_POSE):
    """Show a frame in which a tool presses, or none."""
    coached = None if view is None else coaching_of(view.progress, asked)
    at = replace(frame(view=view or reading()), guidance=guidance(asked, method=method), coaching=coached, eye=eye)
    tell(panel, at)
    return at


def test_every_headline_fits_at_1280_pixels_beside_the_dial(panel):
    assert set(WORST) == set(Reason)
    pressed(panel)
    assert panel.dial.isVisible()
    assert panel.headline.font().pointSizeF() == HEADLINE_FONT_SIZE_PT
    cut = []
    for words in every_headline():
        panel.say(Now(Tone.BAD, words, result=Said(Tone.BAD, words)))
        if (
            is_elided(panel.headline)
            or panel.headline.fitted().pointSizeF() < 0.85 * HEADLINE_FONT_SIZE_PT
            or is_elided(panel.result)
        ):
            cut.append(words)
    assert not cut


def test_the_panel_keeps_its_height_with_and_without_a_target(panel):
    pressed(panel)
    wide, high = panel.headline.width(), panel.sizeHint().height()
    tell(panel, frame())
    QApplication.processEvents()
    assert not panel.dial.isVisible()
    assert panel.sizeHint().height() == panel.minimumSizeHint().height() == high > TILT_DIAL_SIZE_PX
    assert panel.sizePolicy().verticalPolicy() is QSizePolicy.Policy.Fixed
    assert panel.headline.width() > wide


def of(view=None, asked=ASKED, eye=PLAIN_POSE, max_angle_error=LEEWAY):
    return top_view(guidance(asked), asked, None if view is None else coaching_of(view.progress, asked), max_angle_error, eye)


def test_the_picture_from_above_is_what_one_sees_from_above():
    seen = of()
    # Looked at along -z with x to the right: places are where the plan has them.
    for channel, place in zip(seen.channels.tolist(), seen.taxels, strict=True):
        np.testing.assert_allclose(place, PLAN.places[channel] - PLAN.places[3], atol=1e-12)
    assert 3 not in seen.channels
    assert np.linalg.norm(seen.taxels, axis=1).max() < DIAL_RADIUS_M
    np.testing.assert_allclose(seen.wanted, DRAWN_TOOL_LENGTH_M * np.sin(TILT) * np.array(TO_2[:2]), atol=1e-12)
    assert seen.tip is None
    assert seen.upper is None


def test_the_tool_is_drawn_where_it_is_and_how_it_leans():
    across = (-TO_2[1], TO_2[0], 0.0)
    seen = of(held(20.0, across, aside=(0.003, -0.001, 0.0)))
    np.testing.assert_allclose(seen.tip, [0.003, -0.001], atol=1e-9)
    np.testing.assert_allclose(
        seen.upper - seen.tip, DRAWN_TOOL_LENGTH_M * np.sin(np.radians(20.0)) * np.array(across[:2]), atol=1e-9
    )
    np.testing.assert_allclose(seen.wanted - seen.tip, of().wanted, atol=1e-9)


@pytest.mark.parametrize(("tilt", "right"), [(28.0, True), (37.0, True), (19.0, True), (39.0, False), (17.0, False)])
def test_the_upper_end_is_in_its_room_exactly_where_the_tilt_is_as_asked(tilt, right):
    seen = of(held(tilt, aside=(0.002, 0.001, 0.0)))
    assert seen.right is right
    assert inside(seen.upper, seen.room) is right


def inside(point, corners) -> bool:
    """Whether a point lies in a convex outline."""
    away, sides = point - corners, np.roll(corners, -1, axis=0) - corners
    turn = sides[:, 0] * away[:, 1] - sides[:, 1] * away[:, 0]
    return bool((turn > 0).all() or (turn < 0).all())


@pytest.mark.parametrize("seed", range(6))
def test_up_in_the_picture_is_up_in_the_3d_view(seed):
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    normal, eye = turn[2], eye_of(turn[0], turn[1])
    np.testing.assert_allclose(axes_on(normal, eye), turn[:2], atol=1e-12)
    for slant in (30.0, 80.0, 90.0, 130.0):
        c, s = np.cos(np.radians(slant)), np.sin(np.radians(slant))
        # The part tips over to the right: up stays up.
        tipped = c * normal + s * turn[0]
        right, up = axes_on(tipped, eye)
        assert up @ turn[1] == pytest.approx(1.0)
        assert abs(right @ tipped) < 1e-12
        np.testing.assert_allclose(np.cross(right, up), tipped, atol=1e-12)


@pytest.mark.parametrize("colours", [DARK, LIGHT])
def test_the_dial_shows_the_tool_and_nothing_of_it_without_a_tool(panel, colours):
    show_in(colours)
    pressed(panel)
    empty = pixels(panel.dial)
    pressed(panel, held(28.0, landed=3))
    right = pixels(panel.dial)
    assert changed(empty, right) > 150
    assert ink(right, colours.accent, 4) > 60
    assert ink(right, colours.bad, 4) == 0
    pressed(panel, held(5.0, landed=3))
    wrong = pixels(panel.dial)
    assert ink(wrong, colours.bad, 4) > 30
    assert ink(wrong, colours.accent, 4) == 0
    pressed(panel)
    assert changed(empty, pixels(panel.dial)) == 0


def test_a_tip_outside_the_picture_is_a_wedge_at_the_rim_on_its_side(panel):
    pressed(panel, held(28.0, aside=(0.04, 0.0, 0.0), landed=15))
    seen, edge = pixels(panel.dial), round(0.8 * TILT_DIAL_SIZE_PX)
    assert ink(seen[:, edge:], DARK.bad, 4) > 30
    assert ink(seen[:, :edge], DARK.bad, 4) == 0


def test_the_dial_turns_with_the_3d_view_and_is_drawn_after_a_change_only(panel, qtbot):
    view = held(20.0, landed=3)
    pressed(panel, view)
    one = pixels(panel.dial)
    paints = paints_from_now(qtbot, panel.dial)
    for _ in range(5):
        pressed(panel, view)
    qtbot.wait(30)
    assert paints.count == 0
    pressed(panel, held(24.0, landed=3))
    qtbot.wait(30)
    assert paints.count == 1
    pressed(panel, view, eye=eye_of(PLAIN_POSE.up, -PLAIN_POSE.right))
    assert changed(one, pixels(panel.dial)) > 100


def test_a_verdict_leaves_the_dial_to_the_next_target(panel):
    pressed(panel, held(28.0, landed=3))
    before = pixels(panel.dial)
    other = target(7)
    at = replace(frame(session(2, pokes=[touch(1)]), reading(PressPhase.TARING)), guidance=guidance(other))
    tell(panel, at)
    assert changed(before, pixels(panel.dial)) > 100
    assert "accepted" in panel.result.text()
