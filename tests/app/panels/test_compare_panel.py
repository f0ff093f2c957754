"""The Compare tab: what it says, what its arrows draw, and that it costs nothing while it is closed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from app.panels.compare_panel import ComparePanel
from app.scene3d.scene_state import DARK as DARK_LOOK
from app.scene3d.scene_state import LIGHT as LIGHT_LOOK
from app.scene3d.scene_state import Cloud, Comparison, Tint
from app.session.opening import OpenRequest
from app.state.place_sets import LAYOUT, PlaceOrigin, Places, Source, default_pair, other_source, sources_of
from app.text.compare_text import (
    MAX_LISTED_MODULES,
    difference_words,
    listed_modules,
    listed_words,
    misfit_words,
    module_cells,
    save_hint,
    saved_words,
    source_words,
    spacing_words,
)
from app.theme import DARK
from skincal.model.skin import Anchor
from skincal.modules import health
from skincal.modules.health import LayoutRepair, MisplacedModule, MisplacementKind, ModuleChange, Unrepaired, UnrepairedKind
from skincal.rig.correction_fit import RigAnswer
from skincal.session.error_history import ErrorFollower, ModulesCheck
from skincal.session.part import Part
from skincal.session.review import Review
from skincal.taxels.differences import ModuleDifference, Summary
from skincal.taxels.result import Method
from skincal.words.layout_words import left_sentences, misfit_sentence
from skincal.words.units import ChannelNames
from tests.app.scene3d_support import box, estimate, laid, scene
from tests.app.view3d_on_screen import KEPT, make_view, renderer_of, turn
from tests.app.view3d_on_screen import pixels as picture
from tests.app.whole_window import OPEN_MS, Bench, Paints
from tests.app.window_support import NAMES, PLAN, SCENE, frame, session, show_in
from tests.approved import approved

METHODS = (Method.SURFACE, Method.FREE, Method.MODULES)
FREE, SURFACE = (Source(PlaceOrigin.METHOD, method) for method in (Method.FREE, Method.SURFACE))
CHANNELS = PLAN.channels


@pytest.fixture(autouse=True)
def _windows():
    yield
    KEPT.clear()


def part(*, plan: bool = True, surface: bool = False) -> Part:
    """The small part: two modules on the plane z = 0."""
    where = SCENE if plan else scene(None)
    return Part(where, box() if surface else None, laid(PLAN) if plan else None, CHANNELS, ())


def known(shift=(0.0, 0.0, 0.0), method: Method = Method.FREE, rows=range(24)) -> dict:
    """Estimates that lie `shift` beside the layout."""
    places = laid(PLAN).places
    return {channel: estimate(channel, places[channel] + shift, method) for channel in rows}


def beside(x: float, y: float, z: float) -> np.ndarray:
    """The layout's places, shifted."""
    return laid(PLAN).places + np.array([x, y, z])


def at(free: dict, surface: dict | None = None, generation: int = 1, **changes):
    """A frame of a session with these estimates."""
    base = session(generation, free)
    estimates = dict(base.estimates)
    if surface is not None:
        estimates[Method.SURFACE] = tuple(surface.get(e.channel, e) for e in estimates[Method.FREE])
    return frame(replace(base, estimates=estimates), **changes)


def review(before: dict, after: dict, channels=CHANNELS) -> Review:
    answer = RigAnswer(None, False, float("nan"), float("nan"), 0, {}, {}, np.empty(0), np.empty(0))
    return Review((), {}, None, answer, channels, before, after)


# What there is


def test_every_set_that_there_is_can_be_chosen():
    both = (Method.SURFACE, Method.FREE)
    assert sources_of(both, None, laid=True) == (LAYOUT, SURFACE, FREE)
    assert sources_of(both, None, laid=False) == (SURFACE, FREE)
    places = np.zeros((24, 3))
    for answer in (review({Method.FREE: places}, {}), review({}, {Method.FREE: places})):
        found = sources_of(both, answer, laid=False)
        assert [source_words(source) for source in found[2:]] == ["Free before correction", "Free after correction"]
    assert [source_words(source) for source in (LAYOUT, SURFACE)] == ["Layout", "Surface method"]


def test_the_layout_is_compared_with_the_shown_method_and_free_with_surface_without_one():
    assert default_pair((LAYOUT, SURFACE, FREE), Method.FREE) == (LAYOUT, FREE)
    assert default_pair((SURFACE, FREE), Method.FREE) == (FREE, SURFACE)
    assert default_pair((FREE,), Method.FREE) == (FREE, FREE)


def test_places_stand_in_the_order_of_the_channels_and_are_worked_out_once():
    places = Places(CHANNELS, laid(PLAN).places)
    moment = at(known((0.0, 0.0, 0.001), rows=[3, 5]))
    found = places.find(FREE, moment)
    assert np.flatnonzero(np.isfinite(found[:, 0])).tolist() == [3, 5]
    np.testing.assert_allclose(found[[3, 5], 2], 0.001)
    assert places.find(FREE, moment) is found
    assert places.find(FREE, at(known())) is not found
    np.testing.assert_array_equal(places.find(LAYOUT, moment), laid(PLAN).places)


def test_a_review_holds_one_side_of_a_correction_and_the_session_the_other():
    before = np.arange(6.0).reshape(2, 3)
    used = review({Method.FREE: before}, {}, np.array([7, 9]))
    places, moment = Places(CHANNELS, None), at(known((0.0, 0.0, 0.001)))
    first, second = (Source(origin, Method.FREE) for origin in (PlaceOrigin.BEFORE, PlaceOrigin.AFTER))
    found = places.find(first, replace(moment, review=used))
    np.testing.assert_array_equal(found[[7, 9]], before)
    assert np.isnan(np.delete(found, [7, 9], axis=0)).all()
    np.testing.assert_allclose(places.find(second, replace(moment, review=used)), beside(0.0, 0.0, 0.001))
    offered = review({}, {Method.FREE: before}, np.array([7, 9]))
    np.testing.assert_allclose(places.find(first, replace(moment, review=offered)), beside(0.0, 0.0, 0.001))
    np.testing.assert_array_equal(places.find(second, replace(moment, review=offered))[[7, 9]], before)


# What is said


def test_the_summary_is_one_line():
    summary = Summary(84, 0.0021, 0.003, 0.0063, 4)
    assert difference_words(summary, (LAYOUT, FREE), NAMES, CHANNELS.tolist()) == approved(
        "compare.summary", count=84, mean_mm=2.1, largest_mm=6.3, taxel="10-04"
    )
    assert difference_words(None, (LAYOUT, FREE), NAMES, []) == approved("compare.none_known")
    assert difference_words(summary, (FREE, FREE), NAMES, []).startswith(approved("compare.same_twice"))


def test_a_module_says_how_many_of_its_taxels_are_known_and_never_nan():
    cells = module_cells(ModuleDifference(0, 12, 0.0021, 0.002, 0.0005), 17, 12, 0.934)
    assert cells == ("17", "2.1", "2.0", "0.5", "0.93")
    cells = module_cells(ModuleDifference(0, 2, 0.0021, 0.002, None), 17, 12, float("nan"))
    assert cells == ("17  2/12", "2.1", "2.0", "\N{EN DASH}", "\N{EN DASH}")


def test_of_too_many_modules_the_worst_are_listed():
    few = [ModuleDifference(index, 12, 0.001 * (index % 7), 0.0, 0.0) for index in range(MAX_LISTED_MODULES)]
    assert listed_modules(few) == few
    assert listed_words(MAX_LISTED_MODULES) == ""
    many = [*few, ModuleDifference(99, 12, 0.02, 0.0, 0.0)]
    listed = listed_modules(many)
    assert (len(listed), listed[0].module) == (MAX_LISTED_MODULES, 99)
    assert [module.mean for module in listed] == sorted((module.mean for module in listed), reverse=True)
    assert listed_words(41) == approved("compare.worst_modules", listed=40, count=41)


def test_spacing_is_said_of_every_method_that_knows():
    ratios = {Method.SURFACE: 0.93, Method.FREE: float("nan"), Method.MODULES: 1.0}
    assert spacing_words(ratios) == approved("compare.spacing", surface=0.93, modules="1.00")
    assert spacing_words({Method.FREE: float("nan")}) == ""


def test_a_misfit_is_an_offer_with_a_sign():
    misfit = MisplacedModule(17, MisplacementKind.MIRRORED, 0.01, 0.002)
    mend = LayoutRepair((misfit,), PLAN, (ModuleChange(17, mirror=True),), (Unrepaired(UnrepairedKind.NO_NEARER, (17,)),))
    head, sentence, left = misfit_words(mend, 7, Method.SURFACE)
    assert head.startswith(approved("modules_check.misfits_of_method", count=1, method="surface"))
    assert approved("modules_check.nothing_by_itself") in head
    assert (sentence, left) == (misfit_sentence(misfit), left_sentences(mend)[0])
    assert approved("modules_check.save_hint", module=17) in save_hint(mend)
    saved = saved_words(Path("folder") / "new.toml", mend)
    assert saved.startswith(approved("modules_check.saved", path=Path("folder") / "new.toml"))
    assert approved("modules_check.saved_command") in saved
    right = LayoutRepair((), PLAN, (), ())
    assert misfit_words(right, 7, Method.FREE) == (approved("modules_check.all_as_planned", count=7, method="free"),)
    assert misfit_words(right, 0, Method.FREE) == (), "of nothing that is known nothing is said"


# The panel


class Queue:
    """A background whose work is done when the test says so."""

    def __init__(self) -> None:
        self.waiting = []

    def __call__(self, work, done) -> None:
        self.waiting.append((work, done))

    def finish(self) -> None:
        while self.waiting:
            work, done = self.waiting.pop(0)
            done(work())


def make_panel(qtbot, of: Part, methods=METHODS):
    show_in(DARK)
    panel = ComparePanel(of, methods, NAMES if of.scene.skin.layout is not None else ChannelNames(None))
    panel.drawn = []
    panel.comparison_changed.connect(panel.drawn.append)
    panel.resize(430, 600)
    qtbot.addWidget(panel)
    with qtbot.waitExposed(panel):
        panel.show()
    return panel


def modules_of(panel) -> list[list[str]]:
    tree = panel.modules
    return [[tree.topLevelItem(row).text(column) for column in range(5)] for row in range(tree.topLevelItemCount())]


def test_it_says_how_far_the_shown_method_lies_from_the_layout(qtbot):
    panel = make_panel(qtbot, part())
    free = known((0.0, 0.003, 0.0)) | known((0.0, 0.003, 0.004), rows=[15])
    panel.show_state(at(free))
    assert [box.currentText() for box in panel.boxes] == ["Layout", "Free method"]
    assert panel.summary.text() == approved("compare.summary", count=24, mean_mm=3.1, largest_mm=5.0, taxel="11-03")
    rows = modules_of(panel)
    assert [row[0] for row in rows] == ["10", "11"]
    assert rows[0][1:] == ["3.0", "3.0", "0.0", "1.00"]
    assert rows[1][3] != "0.0"
    assert panel.worst.item(0).text() == "11-03   5.0 mm"
    assert panel.worst.count() == 10
    assert "1.0" in panel.spacing.text()
    assert "true to scale" in panel.legend.text()


def test_a_click_on_the_worst_wants_that_taxel(qtbot):
    panel = make_panel(qtbot, part())
    panel.show_state(at(known() | known((0.0, 0.0, 0.004), rows=[15])))
    panel.worst.scrollToItem(panel.worst.item(0))
    panel.ensureWidgetVisible(panel.worst)
    with qtbot.waitSignal(panel.taxel_wanted) as wanted:
        middle = panel.worst.visualItemRect(panel.worst.item(0)).center()
        QTest.mouseClick(panel.worst.viewport(), Qt.MouseButton.LeftButton, pos=middle)
    assert wanted.args == [15]


def test_what_is_drawn_leads_from_one_to_the_other_as_long_as_asked(qtbot):
    panel = make_panel(qtbot, part())
    panel.show_state(at(known((0.0, 0.003, 0.0))))
    drawn = panel.drawn[-1]
    places = laid(PLAN).places
    assert [cloud.tint for cloud in drawn.clouds] == [Tint.FROM, Tint.TO]
    np.testing.assert_allclose(drawn.clouds[1].places, beside(0.0, 0.003, 0.0))
    np.testing.assert_allclose(drawn.arrows, np.stack([places, beside(0.0, 0.003, 0.0)], axis=1))
    panel.scale.setCurrentIndex(2)
    panel.scale.activated.emit(2)
    np.testing.assert_allclose(panel.drawn[-1].arrows[:, 1], beside(0.0, 0.03, 0.0))
    np.testing.assert_allclose(panel.drawn[-1].clouds[1].places, beside(0.0, 0.003, 0.0), err_msg="dots lie true")
    assert approved("compare.scaled") in panel.legend.text()
    panel.all.setChecked(True)
    assert [cloud.tint for cloud in panel.drawn[-1].clouds] == [Tint.LAYOUT, Tint.SURFACE, Tint.FREE, Tint.MODULES]
    assert approved("compare.layout_to_free") in panel.legend.text()
    panel.hide()
    assert panel.drawn[-1] is None


def choose(panel, row: int, text: str) -> None:
    box_ = panel.boxes[row]
    index = box_.findText(text)
    assert index >= 0, text
    box_.setCurrentIndex(index)
    box_.activated.emit(index)


def test_the_operators_choice_stays_and_before_and_after_come_with_a_review(qtbot):
    panel = make_panel(qtbot, part())
    panel.show_state(at(known((0.0, 0.003, 0.0))))
    panel.show_state(at(known((0.0, 0.003, 0.0)), generation=2, method=Method.SURFACE))
    assert panel.boxes[1].currentText() == "Surface method", "it follows the method while nothing was chosen"
    answer = review({Method.FREE: beside(0.008, 0.0, 0.0)}, {Method.FREE: beside(0.001, 0.0, 0.0)})
    reviewed = replace(at(known(), generation=3), review=answer)
    panel.show_state(reviewed)
    choose(panel, 0, "Free before correction")
    choose(panel, 1, "Free after correction")
    assert panel.summary.text().startswith("24 taxels, mean 7.0 mm")
    choose(panel, 0, "Layout")
    assert panel.summary.text().startswith("24 taxels, mean 1.0 mm")
    panel.show_state(replace(reviewed, method=Method.SURFACE, snapshot=replace(reviewed.snapshot, generation=4)))
    assert panel.boxes[1].currentText() == "Free after correction"
    panel.show_state(at(known(), generation=5))
    assert [each.currentText() for each in panel.boxes] == ["Layout", "Free method"], "what is gone is not compared"


def test_without_layout_and_surface_it_has_no_modules_and_says_what_is_missing(qtbot):
    panel = make_panel(qtbot, part(plan=False), (Method.FREE,))
    panel.show_state(at(known(), where=scene(None)))
    assert panel.summary.text().startswith(approved("compare.same_twice"))
    assert panel.worst.count() == 0
    assert not panel.modules.isVisible()
    assert not panel.spacing.isVisible()
    assert panel.spacing.text() == ""
    both = make_panel(qtbot, part(plan=False, surface=True), (Method.SURFACE, Method.FREE))
    both.show_state(at(known(), known((0.0, 0.0, 0.002), Method.SURFACE), where=scene(None)))
    assert [each.currentText() for each in both.boxes] == ["Free method", "Surface method"]
    assert both.summary.text().startswith("24 taxels, mean 2.0 mm")
    assert "ch " in both.worst.item(0).text()


def test_the_same_frame_draws_nothing_and_a_hidden_panel_works_nothing(qtbot):
    panel = make_panel(qtbot, part())
    moment = at(known())
    panel.show_state(moment)
    qtbot.wait(50)
    paints, drawn = Paints(panel), len(panel.drawn)
    for now_s in range(20):
        panel.show_state(replace(moment, now_ns=now_s))
    qtbot.wait(50)
    assert (paints.count, len(panel.drawn)) == (0, drawn)
    panel.hide()
    drawn = len(panel.drawn)
    panel.show_state(at(known((0.0, 0.0, 0.001)), generation=9))
    assert len(panel.drawn) == drawn
    panel.show()
    assert panel.summary.text().startswith("24 taxels, mean 1.0 mm")


def anchored(mirror: bool) -> Part:
    """The small part in space, module 10 mounted as planned or planned mirrored."""
    anchor = Anchor(np.zeros(2), np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    modules = (replace(PLAN.modules[0], mirror=mirror), *PLAN.modules[1:])
    skin = replace(SCENE.skin, layout=type(PLAN)(modules, PLAN.width), anchor=anchor)
    return Part(replace(SCENE, skin=skin), None, laid(PLAN), CHANNELS, ())


def judge(check: ModulesCheck, state) -> None:
    check.follow(state.snapshot)


def judged_and_shown(panel: ComparePanel, of: Part, queue: Queue):
    """Return what shows a state as the window does: the modules of what is on the screen are judged first."""
    check = ModulesCheck(of, queue)

    def show(state) -> None:
        judge(check, state)
        panel.show_state(replace(state, modules=check.found))

    return show


@pytest.mark.parametrize("mirror", [False, True])
def test_a_mirrored_module_is_named_beside_the_window(qtbot, mirror):
    of, queue = anchored(mirror), Queue()
    panel = make_panel(qtbot, of)
    show, moment = judged_and_shown(panel, of, queue), at(known())
    show(moment)
    assert not panel.health.isVisible()
    assert len(queue.waiting) == 1, "it is worked out in the background, once"
    show(moment)
    assert len(queue.waiting) == 1
    queue.finish()
    show(moment)
    assert panel.health.isVisible()
    if mirror:
        assert approved("modules_check.misfits", count=1) in panel.health.text()
        assert approved("modules_check.mirrored_clause", module=10) in panel.health.text()
    else:
        assert panel.health.text() == approved("modules_check.all_as_planned", count=2, method="free")
    assert not queue.waiting


def test_modules_are_judged_again_for_what_came_meanwhile(monkeypatch):
    of, queue = anchored(mirror=False), Queue()
    watch = ModulesCheck(of, queue)
    for generation in (1, 2, 3):
        judge(watch, at(known(), generation=generation))
    assert len(queue.waiting) == 1
    queue.finish()
    judge(watch, at(known(), generation=3))
    assert len(queue.waiting) == 1
    queue.finish()
    judge(watch, at(known(), generation=3))
    assert not queue.waiting

    def broken(*_):
        raise RuntimeError("of the modules")

    monkeypatch.setattr("skincal.session.error_history.repair_layout", broken)
    judge(watch, at(known(), generation=4))
    with pytest.raises(RuntimeError, match="of the modules"):
        queue.finish()
    monkeypatch.setattr("skincal.session.error_history.repair_layout", health.repair_layout)
    judge(watch, at(known(), generation=4))
    assert not queue.waiting, "not at every picture"
    judge(watch, at(known(), generation=5))
    queue.finish()
    assert watch.found.judged == 2


# The picture


def tinted(seen: np.ndarray, look, tint: Tint) -> int:
    """How many pixels have a tint, or nearly."""
    return int((np.abs(seen.astype(int) - look.tints[tint]).max(axis=-1) < 25).sum())


def comparison(shift=(0.0, 0.006, 0.0)) -> Comparison:
    places = laid(PLAN).places
    there = beside(*shift)
    return Comparison((Cloud(Tint.FROM, places), Cloud(Tint.TO, there)), np.stack([places, there], axis=1))


@pytest.mark.parametrize(("dark", "look"), [(True, DARK_LOOK), (False, LIGHT_LOOK)], ids=["dark", "light"])
def test_dots_and_arrows_appear_in_their_tints_and_go(qtbot, dark, look):
    view = make_view(qtbot)
    view.set_dark(dark)
    moment = session(1, known())
    view.show_moment(moment, None, Method.FREE, None)
    before = picture(view)
    view.set_comparison(comparison())
    after = picture(view)
    assert tinted(after, look, Tint.TO) > tinted(before, look, Tint.TO) + 400
    layer = renderer_of(view).compare
    assert (layer.dots.actor.visibility, renderer_of(view).estimates.balls.actor.visibility) == (True, False)
    longer = replace(comparison(), arrows=comparison((0.0, 0.018, 0.0)).arrows)
    view.set_comparison(longer)
    assert tinted(picture(view), look, Tint.TO) > tinted(after, look, Tint.TO) + 300
    view.set_comparison(None)
    np.testing.assert_array_equal(picture(view), before)


def test_a_comparison_stays_while_moments_pass_and_only_a_new_one_draws(qtbot):
    view = make_view(qtbot)
    view.show_moment(session(1, known()), None, Method.FREE, None)
    view.set_comparison(comparison())
    shown = picture(view)
    assert not view.show_moment(session(1, known()), None, Method.FREE, None)
    np.testing.assert_array_equal(picture(view), shown)
    points = renderer_of(view).compare.dots.mesh.GetPoints()
    view.set_comparison(comparison((0.0, 0.0, 0.009)))
    picture(view)
    assert renderer_of(view).compare.dots.mesh.GetPoints() is points, "arrays are changed in place"


def test_a_difference_into_the_part_is_seen_along_its_whole_length_and_the_far_side_is_left_out(qtbot):
    view = make_view(qtbot)
    view.show_moment(session(1, {}), None, Method.FREE, None)
    view.set_comparison(comparison((0.004, 0.0, -0.01)))
    seen = tinted(picture(view), DARK_LOOK, Tint.TO)
    assert seen > 400
    turn(view, 0.0, -179.0)
    assert tinted(picture(view), DARK_LOOK, Tint.TO) < 0.1 * seen


# The whole window


def open_compare(bench: Bench, folder) -> ComparePanel:
    bench.open(OpenRequest(session=folder))
    bench.until_all_is_there()
    bench.key(Qt.Key.Key_4)
    panel = bench.window.session_view.workspace.compare
    assert panel.isVisible()
    return panel


def test_in_the_window_it_is_drawn_while_it_is_open_and_a_click_selects(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    workspace = bench.window.session_view.workspace
    before = picture(workspace.view)
    panel = open_compare(bench, recorded)
    # Three pokes tell the modules method nothing.
    bench.window.session_view.show_method(Method.SURFACE)
    workspace = bench.window.session_view.workspace
    bench.until(lambda: tinted(picture(workspace.view), DARK_LOOK, Tint.TO) > tinted(before, DARK_LOOK, Tint.TO) + 50, OPEN_MS)
    assert "taxel" in panel.summary.text()
    worst = panel.worst.item(0)
    panel.worst.itemClicked.emit(worst)
    assert bench.window.session_view.selected == worst.data(Qt.ItemDataRole.UserRole)
    bench.key(Qt.Key.Key_1)
    assert not renderer_of(workspace.view).compare.dots.actor.GetVisibility()


def test_closed_it_costs_nothing_while_pokes_come(bench, monkeypatch):
    calls = []
    for owner, name in ((ModulesCheck, "follow"), (ErrorFollower, "follow"), (Places, "find"), (ComparePanel, "show_state")):
        monkeypatch.setattr(owner, name, lambda *_, name=name: calls.append(name))
    bench.open_served("flat-patch")
    bench.until(lambda: len(bench.accepted()) >= 1)
    assert calls == []
    assert bench.window.session_view.workspace.compare._neighbours is None


def test_two_sessions_of_one_name_are_told_apart_and_one_that_is_read_again_is_the_same():
    monday, tuesday = Path("/a/monday/session"), Path("/a/tuesday/session")
    first = other_source("session, free method", monday, ())
    second = other_source("session, free method", tuesday, (first,))
    third = other_source("session, free method", Path("/b/tuesday/session"), (first, second))
    names = [each.name for each in (first, second, third)]
    assert names == ["session, free method", "session, free method (tuesday)", f"session, free method ({Path('/b/tuesday')})"]
    assert other_source("session, free method", tuesday, (first, second, third)) == second
    places = Places(np.arange(2), None)
    for source, x in ((first, 1.0), (second, 2.0), (first, 3.0)):
        places.offer(source, {0: np.array([x, 0.0, 0.0])})
    assert places.others == (first, second)
