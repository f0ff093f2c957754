"""How a session ends: what is said of it, and the dialog that leads to the file, by keys alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication

from app.dialogs.export_dialog import ExportDialog
from app.dialogs.verdict_dialog import VerdictDialog
from app.session.opening import OpenRequest
from app.state.policies import Offer
from app.text.rig_text import rig_state
from skincal.contacts.poke_counts import PokeCounts
from skincal.following.review import Review
from skincal.guide.progress import Need, Why
from skincal.guide.verdict import Check, Left, Verdict
from skincal.pokes import NO_LANDMARK_POKES, LandmarkPokes
from skincal.rig.closing import Closing, ClosingPlaces
from skincal.rig.correction import RIG, Correction, UsedCorrection
from skincal.rig.correction_fit import (
    LANDMARKS_AGREE_MAX_MISS_RATIO,
    MIN_LANDMARK_POKES,
    MIN_LANDMARKS,
    LandmarkAgreement,
    RigAnswer,
)
from skincal.session.corrections import correct_action
from skincal.taxels.result import Method, State
from skincal.taxels.shared_errors import PredictedError
from skincal.words.rig_words import correction_sentence, rig_sentences
from skincal.words.taxel_words import error_words
from skincal.words.verdict_words import (
    WHY_WORDS,
    agreement_words,
    check_words,
    done_words,
    figures,
    left_words,
    verdict_headline,
    verdict_sentence,
)
from tests.app.window_support import NAMES, changed, pixels
from tests.approved import approved

Key = Qt.Key
UNUSED = Left(4, Why.DEAD, ())
GIVEN_UP = Left(7, Why.NEVER_FIRED, (Need.POKES, Need.ACCURACY))
NOT_POKED_ENOUGH = Left(9, Why.NOT_POKED_ENOUGH, (Need.BALANCE,))


AGREES = Check(14, 13)
PASSED = LandmarkAgreement(21, 0.94, corrected=True)
MISSED = LandmarkAgreement(21, 4.2, corrected=False)
NOISY = LandmarkAgreement(21, 0.94, corrected=True, noisier=2.8)
ERRORS = "1.1 mm mean, 2.1 mm worst"
APART = PredictedError(mean=0.0011, worst=0.0021, whole=0.0012, among=0.0005)


def verdict(
    *left: Left,
    checked: Check = AGREES,
    used: int = 24,
    landmarks: LandmarkAgreement | None = PASSED,
    unchecked: float | None = None,
    predicted: PredictedError | None = APART,
    closings: tuple[Closing, ...] = (),
) -> Verdict:
    done = used - sum(taxel.why is not Why.DEAD for taxel in left)
    enough = all(taxel.why is not Why.NOT_POKED_ENOUGH for taxel in left)
    return Verdict(
        Method.SURFACE,
        enough,
        0.003,
        done,
        used,
        left,
        checked,
        landmarks,
        predicted,
        PokeCounts(252),
        552.0,
        unchecked=unchecked,
        closings=closings,
    )


EXPECTED = approved("verdict.expected", predicted=ERRORS)
HEADLINES = [
    (verdict(), approved("verdict.all_done", count=24)),
    (verdict(UNUSED), approved("verdict.all_used_done", count=24)),
    (verdict(used=1), approved("verdict.only_one")),
    (verdict(UNUSED, GIVEN_UP), approved("verdict.given_up", done=23, count=24, left=1)),
    (verdict(NOT_POKED_ENOUGH), approved("verdict.not_enough", done=23, count=24)),
    (replace(verdict(), done=0), approved("verdict.none_determined", count=24)),
    (verdict(checked=Check(4, 4)), approved("verdict.tests_unpredicted", tested=4)),
    (replace(verdict(NOT_POKED_ENOUGH, checked=Check(0, 0)), done=0), approved("verdict.none_done", count=24, left=10)),
    (replace(verdict(), enough=False, landmarks_left=6), approved("verdict.landmarks_to_go", left=6)),
    (replace(verdict(checked=Check(6, 6)), enough=False), approved("verdict.tests_to_go", left=4)),
    (verdict(NOT_POKED_ENOUGH, checked=Check(6, 6)), approved("verdict.taxels_and_tests_to_go", done=23, count=24, left=4)),
]
"""Sessions without a doubt, and how their headline begins."""
TESTS = [
    (Check(14, 13), approved("verdict.tests_agree")),
    (Check(11, 9), approved("verdict.tests_agree")),
    (Check(11, 8), approved("verdict.tests_hardly")),
    (Check(14, 7), None),
    (Check(0, 0), ""),
    (Check(4, 4), ""),
]
"""Test pokes and what is said of them; `None` where they contradict the result."""
LANDMARKS = [
    (PASSED, approved("verdict.landmarks_agree")),
    (None, approved("verdict.no_landmarks")),
    (MISSED, None),
    (NOISY, approved("verdict.landmarks_agree_with_noise", noise="2.8")),
    (replace(NOISY, noisier=2.0), approved("verdict.landmarks_agree_with_noise", noise="2")),
    (replace(NOISY, noisier=1.4), approved("verdict.landmarks_agree")),
    (replace(NOISY, ratio=4.2), None),
]
"""Landmarks and what is said of them; `None` where they contradict the result."""
DOUBTS = {
    (False, False): "",
    (True, False): approved("verdict.but_tests"),
    (False, True): approved("verdict.but_landmarks"),
    (True, True): approved("verdict.but_both"),
}
"""End of the headline if test pokes, landmarks or both contradict the result."""


@pytest.mark.parametrize(("what", "said"), HEADLINES)
def test_a_headline_says_what_is_finished_or_missing(what, said):
    assert verdict_headline(what) == f"{said}."


@pytest.mark.parametrize(("landmarks", "of_landmarks"), LANDMARKS)
@pytest.mark.parametrize(("checked", "of_tests"), TESTS)
def test_a_verdict_joins_headline_doubts_error_test_pokes_and_landmarks(checked, of_tests, landmarks, of_landmarks):
    begin = approved("verdict.all_done", count=24)
    if not checked.has_enough:
        begin = approved("verdict.tests_unpredicted", tested=checked.checked)
    headline = f"{begin}{DOUBTS[of_tests is None, of_landmarks is None]}."
    said = " ".join(filter(None, (headline, EXPECTED, of_tests, of_landmarks)))
    assert verdict_sentence(verdict(checked=checked, landmarks=landmarks)) == said


def test_a_verdict_gives_the_error_only_of_a_whole_skin_and_counts_its_states():
    some = verdict(NOT_POKED_ENOUGH)
    assert verdict_sentence(some) == f"{verdict_headline(some)} {TESTS[0][1]} {LANDMARKS[0][1]}"
    states = replace(verdict(), states={State.TOUCHED: 20, State.INFERRED: 4})
    counted = approved("verdict.states", touched=20, inferred=4)
    assert verdict_sentence(states) == f"{verdict_headline(states)} {counted} {EXPECTED} {TESTS[0][1]} {LANDMARKS[0][1]}"
    assert verdict_sentence(verdict(UNUSED, used=0)) == approved("verdict.none_used")
    assert verdict_sentence(verdict(used=0)) == approved("verdict.none_answered")


def test_the_figures_are_those_of_the_verdict():
    assert figures(verdict(GIVEN_UP)) == (
        ("Finished", approved("verdict.done_of_method", done=23, count=24, method="surface")),
        ("Expected error", approved("verdict.predicted_apart", mean_mm="1.1", worst_mm="2.1", whole_mm="1.2", among_mm="0.5")),
        ("Finished means", approved("verdict.needs_surface", target_mm=3)),
        ("Test pokes", approved("verdict.check", good=13, held_out=14)),
        ("Landmarks", approved("verdict.landmarks_held_out", pokes=21, ratio="0.9")),
        ("Final check", approved("closing.none")),
        ("Work", approved("verdict.work", pokes=252, time="9 min")),
    )
    assert approved("verdict.check_against") in check_words(verdict(checked=Check(14, 7)))
    hardly = check_words(verdict(checked=Check(11, 8)))
    assert hardly == approved("verdict.check_hardly", good=8, held_out=11)
    assert check_words(verdict(checked=Check(4, 4))).endswith(approved("verdict.check_too_few"))
    assert check_words(verdict(checked=Check(0, 0))) == approved("verdict.check_none")


def test_what_moved_meanwhile_goes_before_all_else():
    moved = Closing(ClosingPlaces.LANDMARKS, ("a", "b"), 0.009, 0.006, 0.001)
    said = verdict(closings=(moved,))
    assert verdict_sentence(said) == approved("closing.in_verdict", count=24, predicted=ERRORS)
    assert said.doubted
    assert dict(figures(said))["Final check"].startswith(
        approved("closing.moved_begin", what="the sensor or the arm", shift="9.0")
    )
    assert not verdict(closings=(moved, replace(moved, chance=0.3))).doubted


def test_what_landmarks_say_and_what_nobody_checked_is_said():
    assert agreement_words(None, has_arm=True) == approved(
        "verdict.landmarks_none", pokes=MIN_LANDMARK_POKES, landmarks=MIN_LANDMARKS
    )
    assert agreement_words(MISSED, has_arm=True) == approved("verdict.landmarks_plain", pokes=21, ratio="4.2")
    assert agreement_words(NOISY, has_arm=True) == approved("verdict.landmarks_with_noise", pokes=21, noise="2.8", ratio="0.9")
    assert dict(figures(verdict(landmarks=None, unchecked=0.0071)))["Expected error"] == approved(
        "verdict.predicted_unchecked", mean_mm="1.1", worst_mm="2.1", unchecked_mm="7.1"
    )
    assert error_words(None, 0.0071, has_arm=True) == approved("verdict.predicted_none")
    assert "nan" not in " ".join(value for _, value in figures(verdict(used=0, predicted=None, landmarks=None)))


@pytest.mark.parametrize(
    ("what", "believed", "doubted"),
    [
        (verdict(), True, False),
        (verdict(landmarks=None), False, False),
        (verdict(landmarks=MISSED), False, True),
        (verdict(landmarks=LandmarkAgreement(21, LANDMARKS_AGREE_MAX_MISS_RATIO, corrected=True)), True, False),
        (verdict(landmarks=LandmarkAgreement(21, LANDMARKS_AGREE_MAX_MISS_RATIO + 1e-9, corrected=True)), False, True),
        (verdict(landmarks=NOISY), False, False),
        (verdict(landmarks=replace(NOISY, noisier=1.4)), True, False),
        (verdict(checked=Check(4, 4)), False, False),
        (verdict(checked=Check(11, 8)), False, False),
        (verdict(checked=Check(14, 7)), False, True),
    ],
)
def test_only_what_landmarks_and_the_skin_speak_for_is_believed(qtbot, what, believed, doubted):
    assert (what.believed, what.doubted) == (believed, doubted)
    dialog = VerdictDialog(what, NAMES)
    qtbot.addWidget(dialog)
    leads_to_file = what.is_finished and not doubted
    assert (dialog.export.isDefault(), dialog.go_on.isDefault()) == (leads_to_file, not leads_to_file)


def test_a_session_that_gave_up_every_taxel_does_not_lead_to_the_file(qtbot):
    for done, leads in ((0, False), (1, True)):
        dialog = VerdictDialog(replace(verdict(GIVEN_UP), done=done), NAMES)
        qtbot.addWidget(dialog)
        assert (dialog.export.isDefault(), dialog.go_on.isDefault()) == (leads, not leads)
        assert dialog.export.isEnabled(), "whoever wants the file gets it"


def test_what_a_taxel_needs_to_be_done_is_that_of_the_method():
    assert approved("verdict.needs_free_sides") in done_words(Method.FREE, 0.003)
    assert done_words(Method.MODULES, 0.002) == approved("verdict.needs_modules", target_mm=2)


def test_a_verdict_is_finished_only_if_it_was_tested_and_adds_what_was_not_checked():
    # By the modules method 1.5 mm are wanted of a part of the error, so the worst taxel may have a larger one.
    far = replace(verdict(), method=Method.MODULES, wanted=0.0015)
    assert EXPECTED in verdict_sentence(far)
    added = approved("verdict.predicted_unchecked", mean_mm="1.1", worst_mm="2.1", unchecked_mm="4.7")
    assert approved("verdict.expected", predicted=added) in verdict_sentence(verdict(unchecked=0.0047, landmarks=None))
    assert [verdict(checked=Check(n, n)).is_finished for n in (9, 10)] == [False, True]
    large = replace(verdict(used=4200), states={State.INFERRED: 4200})
    assert verdict_sentence(large).count("4\N{NARROW NO-BREAK SPACE}200") == 2, "one form of a number"


@pytest.mark.parametrize("why", list(Why))
def test_every_reason_is_said(why):
    assert left_words(Left(1, why, ())) == WHY_WORDS[why]
    assert left_words(Left(1, why, (Need.POKES, Need.SIDES))) == approved("verdict.left_pokes_and_sides", why=WHY_WORDS[why])


def shown(qtbot, *left: Left, checked: Check = AGREES, **changes) -> VerdictDialog:
    dialog = VerdictDialog(verdict(*left, checked=checked), NAMES, **changes)
    dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose, on=False)
    qtbot.addWidget(dialog)
    with qtbot.waitExposed(dialog):
        dialog.show()
    dialog.activateWindow()
    qtbot.waitUntil(lambda: dialog.isActiveWindow() and dialog.focusWidget() is not None)
    return dialog


def tap(qtbot, key) -> None:
    QTest.keyClick(QApplication.activeWindow().windowHandle(), key)
    qtbot.wait(20)


@pytest.mark.parametrize("key", [Key.Key_Space, Key.Key_Return])
def test_the_space_bar_and_enter_go_on_to_the_file(qtbot, key):
    dialog = shown(qtbot, GIVEN_UP)
    assert dialog.focusWidget() is dialog.export
    with qtbot.waitSignal(dialog.export_wanted):
        tap(qtbot, key)
    assert not dialog.isVisible()


def test_escape_goes_on_with_the_session(qtbot):
    dialog = shown(qtbot)
    with qtbot.assertNotEmitted(dialog.export_wanted):
        tap(qtbot, Key.Key_Escape)
    assert not dialog.isVisible()


def test_where_nothing_can_be_written_the_space_bar_goes_on(qtbot):
    dialog = shown(qtbot, can_export=False)
    assert not dialog.export.isEnabled()
    assert dialog.focusWidget() is dialog.go_on
    tap(qtbot, Key.Key_Space)
    assert not dialog.isVisible()


@pytest.mark.parametrize("key", [Key.Key_Space, Key.Key_Return])
def test_where_it_is_not_enough_the_space_bar_and_enter_go_on_with_the_session(qtbot, key):
    dialog = shown(qtbot, NOT_POKED_ENOUGH)
    assert dialog.export.isEnabled()
    assert dialog.go_on.isDefault()
    assert dialog.focusWidget() is dialog.go_on
    with qtbot.assertNotEmitted(dialog.export_wanted):
        tap(qtbot, key)
    assert not dialog.isVisible()


def test_what_speaks_against_it_or_is_offered_goes_before_the_file(qtbot):
    assert shown(qtbot, checked=Check(14, 7)).focusWidget().text() == "Continue poking"
    assert shown(qtbot, rig="It can be corrected.", settled=False).focusWidget().text() == "Continue poking"
    assert shown(qtbot, rig="nothing to correct").focusWidget().text().startswith("Export")


def test_of_a_rig_with_a_tool_the_row_is_about_tool_and_part(qtbot):
    dialog = VerdictDialog(replace(verdict(), has_tool=True), NAMES, rig="Part: known to 1 mm.")
    qtbot.addWidget(dialog)
    names = [name for name, _ in dialog.figures]
    assert "Tool and part" in names
    assert not any("Sensor" in name for name in names)


def test_all_that_is_said_is_seen(qtbot):
    dialog = VerdictDialog(verdict(checked=Check(14, 7)), NAMES, rig=30 * "The rig can be corrected. ")
    dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose, on=False)
    qtbot.addWidget(dialog)
    # Desktops begin with less: a dialog gets two thirds of the screen's height at most.
    dialog.resize(680, 200)
    with qtbot.waitExposed(dialog):
        dialog.show()
    qtbot.wait(50)
    for label in (dialog.sentence, *(value for _, value in dialog.figures)):
        assert label.height() >= label.heightForWidth(label.width()), label.text()


@pytest.mark.parametrize("percent", [100, 200])
def test_on_a_screen_of_720_pixels_the_buttons_are_seen_and_the_words_scroll(qtbot, bench, percent):
    bench.window.text_size.choose(percent)
    left = [Left(channel, Why.TILT, ()) for channel in range(24)]
    dialog = shown(qtbot, *left, rig=2 * "The rig can be corrected. ")
    qtbot.wait(50)
    assert dialog.height() <= 680
    assert dialog.rect().contains(dialog.buttons.geometry())
    for label in (dialog.sentence, *(value for _, value in dialog.figures)):
        assert label.height() >= label.heightForWidth(label.width()), label.text()
    assert dialog.area.horizontalScrollBar().maximum() == 0
    assert (dialog.area.verticalScrollBar().maximum() > 0) is (percent == 200)
    dialog.reject()


def test_what_is_known_of_the_rig_is_said():
    used = UsedCorrection(RIG, Correction(np.eye(6)), 0.0096, 0.0056, 6)
    offer = Offer(correct_action(UsedCorrection(RIG, Correction(np.eye(6)), 0.0096, 0.0056, 6)))
    assert rig_state((offer,), (), None).endswith(approved("verdict.rig_offer", after_mm=5.6))
    assert rig_state((), (used,), None) == correction_sentence(used, has_arm=True)
    assert rig_state((), (), None).startswith(approved("verdict.rig_unchecked"))
    few = RigAnswer(None, False, np.nan, np.nan, 2, {1: 1.0, 2: 1.0, 3: 1.0}, {}, np.zeros(42), np.ones(42))
    none = np.zeros((3, 3))
    pokes = LandmarkPokes(np.arange(1, 4), none, none, np.tile(np.eye(4), (3, 1, 1)), np.full(3, ""), np.full(3, "wrist"), none)
    for poked, said in ((pokes, rig_sentences(few, has_arm=True)[0]), (NO_LANDMARK_POKES, rig_state((), (), None))):
        review = Review(poked, {}, None, few, np.arange(24), {}, {})
        assert rig_state((), (), review) == said
    assert approved("rig.too_few_counts", pokes=3, landmarks=2) in rig_sentences(few, has_arm=True)[0]


def test_a_taxel_that_is_not_done_is_chosen_by_keys(qtbot):
    dialog = shown(qtbot, UNUSED, GIVEN_UP, NOT_POKED_ENOUGH)
    assert "3 taxels not finished" in dialog.heading.text()
    wanted: list[int] = []
    dialog.taxel_wanted.connect(wanted.append)
    for _ in range(6):
        if dialog.focusWidget() is dialog.left:
            break
        tap(qtbot, Key.Key_Tab)
    assert dialog.focusWidget() is dialog.left
    before = pixels(dialog.left)
    for key in (Key.Key_Home, Key.Key_Down, Key.Key_Return, Key.Key_Down, Key.Key_Enter):
        tap(qtbot, key)
    assert changed(before, pixels(dialog.left)) > 50
    assert wanted == [7, 9]
    assert dialog.isVisible(), "Enter in the table presses no button"
    model = dialog.left.model()
    texts = [[model.index(row, column).data() for column in (0, 1)] for row in range(3)]
    assert texts[1] == [NAMES.short(7), approved("verdict.left_never_answered")]
    assert texts[0] == [NAMES.short(4), "disabled"]


def test_nothing_is_listed_where_nothing_is_left(qtbot):
    dialog = shown(qtbot)
    assert not dialog.left.isVisible()
    assert not dialog.heading.isVisible()


def test_the_verdict_of_the_open_session_leads_to_its_file(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    session_view = bench.window.session_view
    bench.key(Key.Key_F)
    bench.until(lambda: any(isinstance(w, VerdictDialog) and w.isActiveWindow() for w in QApplication.topLevelWidgets()), 5000)
    dialog = next(w for w in QApplication.topLevelWidgets() if isinstance(w, VerdictDialog))
    assert dialog.sentence.text().startswith(approved("verdict.not_enough", done=0, count=84))
    assert {name: value.text() for name, value in dialog.figures}["Work"] == approved("verdict.work", pokes=3, time="4 s")
    assert dialog.left.model().rowCount() == 84
    on_map = pixels(session_view.workspace.map)
    dialog.left.setFocus()
    for key in (Key.Key_Home, Key.Key_Down, Key.Key_Return):
        tap(bench.qtbot, key)
    assert session_view.selected == session_view.state.guidance.channels[1]
    assert changed(on_map, pixels(session_view.workspace.map)) > 20
    dialog.export.setFocus()
    tap(bench.qtbot, Key.Key_Space)
    bench.until(lambda: any(isinstance(w, ExportDialog) and w.isActiveWindow() for w in QApplication.topLevelWidgets()), 5000)
    tap(bench.qtbot, Key.Key_Escape)

    bench.key(Key.Key_G)
    assert not bench.window.commands.actions["verdict"].isEnabled(), "nobody guides, so nothing was wanted"
