"""The Compare tab: sets of positions, words, arrows, the check of the layout, and that it costs nothing while closed."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QFileDialog

from app.panels.compare_panel import ComparePanel
from app.scene3d.scene_state import DARK as SCENE_DARK
from app.scene3d.scene_state import LIGHT as SCENE_LIGHT
from app.scene3d.scene_state import Comparison
from app.session.opening import OpenRequest
from app.state.position_sets import LAYOUT_SET, default_pair, position_sets, unique_name
from skincal.files.reference import TaxelPositions
from skincal.following.error_history import ModulesCheck
from skincal.following.review import Review
from skincal.model.skin import Anchor, load_layout
from skincal.modules.health import LayoutRepair, MisplacedModule, MisplacementKind, ModuleChange, Unrepaired, UnrepairedKind
from skincal.part.part import Part
from skincal.rig.correction_fit import RigAnswer
from skincal.taxels.differences import ModuleDifference, Summary
from skincal.taxels.result import Method
from skincal.words.compare_words import (
    MAX_LISTED_MODULES,
    difference_words,
    listed_modules,
    listed_words,
    misfit_words,
    module_cells,
    save_hint,
    saved_words,
    spacing_words,
)
from skincal.words.layout_words import left_sentences, misfit_sentence
from tests.app.scene3d_support import box, estimate, laid, scene, tick_of
from tests.app.view3d_on_screen import KEPT, make_view, renderer_of, turn
from tests.app.view3d_on_screen import pixels as picture
from tests.app.whole_window import OPEN_MS, Bench
from tests.app.window_support import NAMES, PLAN, SCENE, Queue, context, frame, paints_from_now, part, session, shown
from tests.approved import approved
from tests.skincal.sim_support import sample_with

METHODS = (Method.SURFACE, Method.FREE, Method.MODULES)
BOTH = METHODS[:2]
FREE, SURFACE = "Free method", "Surface method"
CHANNELS = PLAN.channels


@pytest.fixture(autouse=True)
def _windows():
    yield
    KEPT.clear()


def known(shift=(0.0, 0.0, 0.0), method: Method = Method.FREE, rows=range(24)) -> dict:
    """Estimates that are shifted from the layout."""
    places = laid(PLAN).places
    return {channel: estimate(channel, places[channel] + shift, method) for channel in rows}


def shifted(x: float, y: float, z: float) -> np.ndarray:
    return laid(PLAN).places + np.array([x, y, z])


def at(free: dict, surface: dict | None = None, generation: int = 1, **changes):
    """A state of a session with these estimates."""
    base = session(generation, free)
    estimates = dict(base.estimates)
    if surface is not None:
        estimates[Method.SURFACE] = tuple(surface.get(e.channel, e) for e in estimates[Method.FREE])
    return frame(replace(base, estimates=estimates), **changes)


def review(before: dict, after: dict, channels=CHANNELS) -> Review:
    answer = RigAnswer(None, False, float("nan"), float("nan"), 0, {}, {}, np.empty(0), np.empty(0))
    return Review((), {}, None, answer, channels, before, after)


# Sets and words


def test_the_sets_are_layout_methods_and_both_sides_of_a_correction():
    moment = at(known((0.0, 0.0, 0.001), rows=[3, 5]))
    sets = position_sets(moment, CHANNELS, BOTH, laid(PLAN).places)
    assert list(sets) == [LAYOUT_SET, SURFACE, FREE]
    assert list(position_sets(moment, CHANNELS, BOTH, None)) == [SURFACE, FREE]
    np.testing.assert_array_equal(sets[LAYOUT_SET], laid(PLAN).places)
    assert np.flatnonzero(np.isfinite(sets[FREE][:, 0])).tolist() == [3, 5]
    np.testing.assert_allclose(sets[FREE][[3, 5], 2], 0.001)
    moment, other = at(known((0.0, 0.0, 0.001))), np.arange(6.0).reshape(2, 3)
    for held, (here, there) in (("before", ("before", "after")), ("after", ("after", "before"))):
        halves = ({Method.FREE: other}, {}) if held == "before" else ({}, {Method.FREE: other})
        sets = position_sets(replace(moment, review=review(*halves, np.array([7, 9]))), CHANNELS, BOTH, None)
        assert list(sets)[2:] == ["Free before correction", "Free after correction"]
        found = sets[f"Free {here} correction"]
        np.testing.assert_array_equal(found[[7, 9]], other)
        assert np.isnan(np.delete(found, [7, 9], axis=0)).all()
        np.testing.assert_allclose(sets[f"Free {there} correction"], shifted(0.0, 0.0, 0.001))


def test_the_layout_is_compared_with_the_shown_method_and_free_with_surface_without_one():
    assert default_pair((LAYOUT_SET, SURFACE, FREE), Method.FREE) == (LAYOUT_SET, FREE)
    assert default_pair((SURFACE, FREE), Method.FREE) == (FREE, SURFACE)
    assert default_pair((FREE,), Method.FREE) == (FREE, FREE)


def test_two_sessions_with_one_name_get_different_names_and_a_reread_one_the_same():
    name, taken = "session, free method", {}
    for path, wanted in (
        (Path("/a/monday/session"), name),
        (Path("/a/tuesday/session"), f"{name} (tuesday)"),
        (Path("/b/tuesday/session"), f"{name} ({Path('/b/tuesday')})"),
        (Path("/a/tuesday/session"), f"{name} (tuesday)"),
    ):
        assert unique_name(name, path, taken) == wanted
        taken[wanted] = path


def test_the_words_of_differences_modules_and_spacing():
    summary = Summary(84, 0.0021, 0.003, 0.0063, 4)
    assert difference_words(summary, (LAYOUT_SET, FREE), NAMES, CHANNELS.tolist()) == approved(
        "compare.summary", count=84, mean_mm=2.1, largest_mm=6.3, taxel="4"
    )
    assert difference_words(None, (LAYOUT_SET, FREE), NAMES, []) == approved("compare.none_known")
    assert difference_words(summary, (FREE, FREE), NAMES, []).startswith(approved("compare.same_twice"))
    assert module_cells(ModuleDifference(0, 12, 0.0021, 0.002, 0.0005), 17, 12, 0.934) == ("17", "2.1", "2.0", "0.5", "0.93")
    some = module_cells(ModuleDifference(0, 2, 0.0021, 0.002, None), 17, 12, float("nan"))
    assert some == ("17  2/12", "2.1", "2.0", "\N{EN DASH}", "\N{EN DASH}")
    few = [ModuleDifference(index, 12, 0.001 * (index % 7), 0.0, 0.0) for index in range(MAX_LISTED_MODULES)]
    assert (listed_modules(few), listed_words(MAX_LISTED_MODULES)) == (few, "")
    listed = listed_modules([*few, ModuleDifference(99, 12, 0.02, 0.0, 0.0)])
    assert (len(listed), listed[0].module) == (MAX_LISTED_MODULES, 99)
    assert [module.mean for module in listed] == sorted((module.mean for module in listed), reverse=True)
    assert listed_words(41) == approved("compare.worst_modules", listed=40, count=41)
    ratios = {Method.SURFACE: 0.93, Method.FREE: float("nan"), Method.MODULES: 1.0}
    assert spacing_words(ratios) == approved("compare.spacing", surface=0.93, modules="1.00")
    assert spacing_words({Method.FREE: float("nan")}) == ""


def test_the_words_of_the_layout_check():
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
    assert misfit_words(right, 0, Method.FREE) == ()


# The panel


def make_panel(qtbot, of: Part | None = None, methods=METHODS, **services) -> ComparePanel:
    panel = ComparePanel(context(of, methods, **services))
    panel.drawn = []
    panel.comparison_changed.connect(panel.drawn.append)
    return shown(qtbot, panel, (430, 600))


def modules_of(panel) -> list[list[str]]:
    tree = panel.modules
    return [[tree.topLevelItem(row).text(column) for column in range(5)] for row in range(tree.topLevelItemCount())]


def chosen(panel) -> list[str]:
    return [each.currentText() for each in panel.boxes]


def choose(panel, which: int, text: str) -> None:
    combo = panel.boxes[which]
    assert combo.findText(text) >= 0, text
    combo.setCurrentText(text)
    combo.activated.emit(combo.currentIndex())


def test_it_shows_the_differences_and_a_click_selects_the_worst(qtbot):
    panel = make_panel(qtbot)
    panel.show_state(at(known((0.0, 0.003, 0.0)) | known((0.0, 0.003, 0.004), rows=[15])))
    assert chosen(panel) == [LAYOUT_SET, FREE]
    assert panel.summary.text() == approved("compare.summary", count=24, mean_mm=3.1, largest_mm=5.0, taxel="15")
    rows = modules_of(panel)
    assert [row[0] for row in rows] == ["10", "11"]
    assert rows[0][1:] == ["3.0", "3.0", "0.0", "1.00"]
    assert rows[1][3] != "0.0"
    assert "1.0" in panel.spacing.text()
    assert (panel.worst.item(0).text(), panel.worst.count()) == ("taxel 15   5.0 mm", 10)
    panel.ensureWidgetVisible(panel.worst)
    with qtbot.waitSignal(panel.taxel_wanted) as wanted:
        middle = panel.worst.visualItemRect(panel.worst.item(0)).center()
        QTest.mouseClick(panel.worst.viewport(), Qt.MouseButton.LeftButton, pos=middle)
    assert wanted.args == [15]


def test_the_drawn_arrows_go_from_one_set_to_the_other_and_can_be_lengthened(qtbot):
    panel = make_panel(qtbot)
    panel.show_state(at(known((0.0, 0.003, 0.0))))
    drawn, places = panel.drawn[-1], laid(PLAN).places
    assert list(drawn.sets) == ["from", "to"]
    np.testing.assert_allclose(drawn.sets["to"], shifted(0.0, 0.003, 0.0))
    np.testing.assert_allclose(drawn.arrows, np.stack([places, shifted(0.0, 0.003, 0.0)], axis=1))
    assert "true to scale" in panel.legend.text()
    panel.scale.setCurrentIndex(2)
    panel.scale.activated.emit(2)
    np.testing.assert_allclose(panel.drawn[-1].arrows[:, 1], shifted(0.0, 0.03, 0.0))
    np.testing.assert_allclose(panel.drawn[-1].sets["to"], shifted(0.0, 0.003, 0.0), err_msg="dots are true")
    assert approved("compare.scaled") in panel.legend.text()
    panel.all.setChecked(True)
    assert list(panel.drawn[-1].sets) == ["layout", "surface", "free", "modules"]
    assert approved("compare.layout_to_free") in panel.legend.text()
    panel.hide()
    assert panel.drawn[-1] is None


def test_the_operators_choice_stays_as_long_as_both_sets_exist(qtbot):
    panel = make_panel(qtbot)
    panel.show_state(at(known((0.0, 0.003, 0.0))))
    panel.show_state(at(known((0.0, 0.003, 0.0)), generation=2, method=Method.SURFACE))
    assert chosen(panel)[1] == SURFACE, "the default follows the method"
    answer = review({Method.FREE: shifted(0.008, 0.0, 0.0)}, {Method.FREE: shifted(0.001, 0.0, 0.0)})
    reviewed = replace(at(known(), generation=3), review=answer)
    panel.show_state(reviewed)
    choose(panel, 0, "Free before correction")
    choose(panel, 1, "Free after correction")
    assert panel.summary.text().startswith("24 taxels, mean 7.0 mm")
    choose(panel, 0, LAYOUT_SET)
    assert panel.summary.text().startswith("24 taxels, mean 1.0 mm")
    panel.show_state(replace(reviewed, method=Method.SURFACE, snapshot=replace(reviewed.snapshot, generation=4)))
    assert chosen(panel)[1] == "Free after correction"
    panel.show_state(at(known(), generation=5))
    assert chosen(panel) == [LAYOUT_SET, FREE]
    found = [TaxelPositions(name, "", {3: np.zeros(3)}) for name in ("monday, free method", "monday, surface method")]
    panel.add_sets(Path("/a/monday"), found)
    assert chosen(panel) == [LAYOUT_SET, "monday, free method"]


def test_without_layout_and_surface_it_has_no_modules(qtbot):
    panel = make_panel(qtbot, part(scene(None), laid=None), (Method.FREE,))
    panel.show_state(at(known(), where=scene(None)))
    assert panel.summary.text().startswith(approved("compare.same_twice"))
    assert panel.worst.count() == 0
    assert not panel.modules.isVisible()
    assert (panel.spacing.isVisible(), panel.spacing.text()) == (False, "")
    both = make_panel(qtbot, part(scene(None), laid=None, surface=box()), BOTH)
    both.show_state(at(known(), known((0.0, 0.0, 0.002), Method.SURFACE), where=scene(None)))
    assert chosen(both) == [FREE, SURFACE]
    assert both.summary.text().startswith("24 taxels, mean 2.0 mm")
    assert "taxel " in both.worst.item(0).text()


def test_the_same_state_draws_nothing_and_a_hidden_panel_works_nothing(qtbot):
    panel = make_panel(qtbot)
    moment = at(known())
    panel.show_state(moment)
    paints, drawn = paints_from_now(qtbot, panel), len(panel.drawn)
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


# The layout check


def anchored(mirror: bool) -> Part:
    """The small part in space; module 10 is mounted as planned, or planned mirrored."""
    anchor = Anchor(np.zeros(2), np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    modules = (replace(PLAN.modules[0], mirror=mirror), *PLAN.modules[1:])
    return part(replace(SCENE, skin=replace(SCENE.skin, layout=type(PLAN)(modules, PLAN.width), anchor=anchor)))


@pytest.mark.parametrize("mirror", [False, True])
def test_a_mirrored_module_is_found_in_the_background_and_its_layout_can_be_saved(qtbot, mirror):
    queue, asked = Queue(), []
    panel = make_panel(qtbot, anchored(mirror), compute=queue)

    def show(state) -> None:
        panel.modules_check.check_snapshot(state.snapshot)
        panel.show_state(state)

    moment = at(known())
    show(moment)
    assert not panel.health.isVisible()
    show(moment)
    assert len(queue.waiting) == 1
    queue.finish()
    show(moment)
    assert panel.health.isVisible()
    assert panel.save_button.isVisible() is mirror
    if not mirror:
        assert panel.health.text() == approved("modules_check.all_as_planned", count=2, method="free")
        return
    assert approved("modules_check.misfits", count=1) in panel.health.text()
    assert approved("modules_check.mirrored_clause", module=10) in panel.health.text()
    assert "module 10: mirror = false" in panel.save_button.toolTip()
    panel.layout_wanted.connect(lambda: asked.append(1))
    QTest.keyClick(panel.save_button, Qt.Key.Key_Return)
    assert (asked, queue.waiting) == ([1], [])
    for _ in range(2):  # too few taxels of module 10
        show(at(known(rows=range(9, 24)), generation=2))
        queue.finish()
    assert not panel.save_button.isVisible()


def test_modules_are_checked_again_for_the_newest_state_and_after_a_failure(monkeypatch):
    queue = Queue()
    check = ModulesCheck(anchored(mirror=False), queue)

    def follow(generation: int) -> int:
        check.check_snapshot(at(known(), generation=generation).snapshot)
        return len(queue.waiting)

    newest = at(known(), generation=3).snapshot
    assert [follow(generation) for generation in (1, 2, 3)] == [1, 1, 1]
    for waiting in (1, 0):
        queue.finish()
        check.check_snapshot(newest)
        assert len(queue.waiting) == waiting

    def broken(*_):
        raise RuntimeError("of the modules")

    with monkeypatch.context() as fault:
        fault.setattr("skincal.following.error_history.repair_layout", broken)
        failing = at(known(), generation=4).snapshot
        check.check_snapshot(failing)
        with pytest.raises(RuntimeError, match="of the modules"):
            queue.finish()
    check.check_snapshot(failing)
    assert not queue.waiting, "not at every tick"
    assert follow(5) == 1
    queue.finish()
    assert check.found.judged == 2


# The picture


def comparison(shift=(0.0, 0.006, 0.0)) -> Comparison:
    places, there = laid(PLAN).places, shifted(*shift)
    return Comparison({"from": places, "to": there}, np.stack([places, there], axis=1))


def tinted(seen: np.ndarray, colours=SCENE_DARK) -> int:
    return int((np.abs(seen.astype(int) - colours.tints["to"]).max(axis=-1) < 25).sum())


@pytest.mark.parametrize(("dark", "colours"), [(True, SCENE_DARK), (False, SCENE_LIGHT)], ids=["dark", "light"])
def test_dots_and_arrows_appear_in_their_colours_stay_and_go(qtbot, dark, colours):
    view = make_view(qtbot)
    view.set_dark(dark)
    moment = session(1, known())
    view.show_state(tick_of(moment, None, Method.FREE, None))
    before = picture(view)
    view.set_comparison(comparison())
    after = picture(view)
    assert tinted(after, colours) > tinted(before, colours) + 400
    layer = renderer_of(view).compare
    assert (layer.dots.actor.visibility, renderer_of(view).estimates.balls.actor.visibility) == (True, False)
    assert not view.show_state(tick_of(session(1, known()), None, Method.FREE, None))
    np.testing.assert_array_equal(picture(view), after)
    points = layer.dots.mesh.GetPoints()
    view.set_comparison(replace(comparison(), arrows=comparison((0.0, 0.018, 0.0)).arrows))
    assert tinted(picture(view), colours) > tinted(after, colours) + 300
    assert layer.dots.mesh.GetPoints() is points, "arrays are changed in place"
    view.set_comparison(None)
    np.testing.assert_array_equal(picture(view), before)


def test_a_difference_into_the_part_is_seen_and_the_far_side_is_left_out(qtbot):
    view = make_view(qtbot)
    view.show_state(tick_of(session(1, {}), None, Method.FREE, None))
    view.set_comparison(comparison((0.004, 0.0, -0.01)))
    seen = tinted(picture(view))
    assert seen > 400
    turn(view, 0.0, -179.0)
    assert tinted(picture(view)) < 0.1 * seen


# The whole window


def open_compare(bench: Bench, folder) -> ComparePanel:
    bench.open(OpenRequest(session=folder))
    bench.until_all_is_there()
    bench.key(Qt.Key.Key_4)
    panel = bench.panel(ComparePanel)
    assert panel.isVisible()
    return panel


@pytest.fixture(scope="module")
def mirrored_once(tmp_path_factory):
    """The sample session, which has a poke on each taxel, recorded with its first module mirrored in the layout."""
    return sample_with(tmp_path_factory.mktemp("mirrored"), "modules.toml", ("mirror = false", "mirror = true  # so"))


def test_in_the_window_a_click_selects_and_the_corrected_layout_is_saved_by_keys(bench, mirrored_once, tmp_path, monkeypatch):
    folder = shutil.copytree(mirrored_once, tmp_path / "session")
    panel, given = open_compare(bench, folder), (folder / "scene" / "modules.toml")
    view, message = bench.window.session_view.workspace.view, bench.window.messages.text
    bench.until(lambda: tinted(picture(view)) > 50, OPEN_MS)
    worst = panel.worst.item(0)
    panel.worst.itemClicked.emit(worst)
    assert bench.window.session_view.selected == worst.data(Qt.ItemDataRole.UserRole)
    bench.key(Qt.Key.Key_1)
    assert not renderer_of(view).compare.dots.actor.GetVisibility()
    bench.key(Qt.Key.Key_4)

    def is_offered() -> bool:
        bench.window.session_view.follow_again()
        return panel.save_button.isVisible()

    bench.until(is_offered, OPEN_MS)
    assert approved("modules_check.mirrored_clause", module=17) in panel.health.text()
    path, answers = tmp_path / "corrected.toml", []

    def save_as(answer: Path) -> None:
        monkeypatch.setattr(
            QFileDialog, "getSaveFileName", lambda _, title, name, *__: answers.append((title, name)) or (str(answer), "")
        )

    save_as(path)
    bench.window.activateWindow()
    bench.until(bench.window.isActiveWindow, 5000)
    panel.scale.setFocus()
    QTest.keyClick(panel.scale, Qt.Key.Key_Tab)
    bench.until(panel.save_button.hasFocus, 2000)
    QTest.keyClick(panel.save_button, Qt.Key.Key_Return)
    bench.until(lambda: str(path) in message.text(), OPEN_MS)
    name = str(folder / "icub-right-forearm-v1-corrected.modules.toml")
    assert answers == [(approved("modules_check.save"), name)]
    assert "mirror = false  # so" in path.read_text(encoding="utf-8")
    assert load_layout(path, bench.window.session_view.workspace.part.scene.skin.layout.width).modules[0].mirror is False
    for refused, why in ((tmp_path / "none" / "new.toml", "does not exist"), (given, approved("layout_file.the_same_clause"))):
        save_as(refused)
        panel.save_button.click()
        bench.until(lambda why=why: why in message.text(), OPEN_MS)
    assert "mirror = true  # so" in given.read_text(encoding="utf-8")
