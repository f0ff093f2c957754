"""The Errors tab: words, plot, the course of errors behind it, and that it costs nothing while it is closed."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from PySide6.QtCore import QSettings, Qt

from app.panels.compare_panel import ComparePanel
from app.panels.errors_panel import ErrorsPanel, log_ticks, round_range
from app.session import opening
from app.session.opening import OpenRequest
from app.text.errors_text import Axis, axis_words, newest_words, quantity_words, source_words
from app.theme import DARK, LIGHT
from app.workers.device_process import DeviceProcess
from skincal.files.reference import TRUTH_NAME, Origin, TaxelPositions, error_summary, find_truth, read_reference
from skincal.following.error_history import MAX, MEAN, P95, TAXELS, ErrorCourse, ErrorFollower, ErrorSeries, ModulesCheck
from skincal.model.actions import Exclude
from skincal.model.errors import InputError
from skincal.model.scene import resource
from skincal.part.part import load_part
from skincal.session.session import Session
from skincal.taxels.result import Method
from tests.app.scene3d_support import estimate, laid
from tests.app.whole_window import OPEN_MS, Bench
from tests.app.window_support import (
    PLAN,
    SCENE,
    Paints,
    Queue,
    changed,
    context,
    frame,
    ink,
    paints_from_now,
    part,
    pixels,
    session,
    show_in,
    shown,
    touch,
)
from tests.approved import approved
from tests.skincal.poke_script import error_series

BOTH = (Method.FREE, Method.SURFACE)


def reference(origin: Origin, name: str = "truth.json", at=(0.0, 0.0, 0.0)) -> TaxelPositions:
    return TaxelPositions(name, "", {channel: np.array(at) for channel in range(24)}, origin=origin)


PLANNED = part(replace(SCENE, name="part"), laid=replace(laid(PLAN), places=np.zeros((24, 3))))


def series(values, missing: int = 0, stride: int = 1) -> ErrorSeries:
    """Errors of the free method: mean in metres after each poke, p95 twice, max four times of it."""
    counts = stride * np.arange(1, len(values) + 1)
    spreads = np.full((len(values), 3, 4), np.nan)
    for row, mean in enumerate(values):
        spreads[row] = 5, mean, 2 * mean, 4 * mean
    return ErrorSeries(counts, counts, 3.0 * counts, {Method.FREE: spreads}, stride, missing)


def test_words_name_reference_and_figures():
    plan = source_words(reference(Origin.PLAN, "part"))
    assert "plan" in plan
    assert "truth" not in plan
    assert source_words(reference(Origin.TRUTH)) == approved("errors.against_truth", name="truth.json")
    assert source_words(reference(Origin.FILE, "right_forearm.txt")) == "Error against right_forearm.txt"
    assert source_words(None).startswith("Expected error")
    assert (quantity_words(None), quantity_words(reference(Origin.PLAN))) == ("expected error, mm", "error, mm")
    words = newest_words(series([0.010, 0.0021]), Method.FREE, 0)
    assert all(each in words for each in ("mean 2.1", "p95 4.2", "worst 8.4 mm", "5 taxels"))
    assert "mean \N{EN DASH}" in newest_words(series([]), Method.SURFACE, 0)
    assert axis_words(series([0.01]), Axis.TIME) == "minutes of poking"
    assert axis_words(series([0.01], missing=7), Axis.POKES) == approved("errors.past_missing", count=7)
    assert axis_words(series([0.01], stride=4), Axis.POKES) == approved("errors.past_thinned", stride=4)


@pytest.mark.parametrize(
    ("low", "high", "ends"), [(0.7, 40.3, (0.5, 50)), (5, 10, (5, 10)), (1, 1, (1, 2)), (3, 101, (2, 200))]
)
def test_the_axis_ends_at_round_numbers(low, high, ends):
    assert round_range(low, high) == pytest.approx(ends)
    ticks = log_ticks(*round_range(low, high))
    assert ticks[0] == (pytest.approx(math.log10(ends[0])), f"{ends[0]:g}")
    assert ticks[-1][1] == f"{ends[1]:g}"


def poked(count: int) -> Session:
    """Pokes from above and at an angle onto a few taxels of a part without a mesh."""
    made = Session(SCENE, None)
    rng = np.random.default_rng(5)
    for poke in range(1, count + 1):
        made.add(touch(poke, (3, 4, 5), (50.0, 30.0, 20.0), (*rng.uniform(-5, 5, 2), -9.0)))
    return made


@pytest.fixture
def queue():
    return Queue()


@pytest.fixture
def panel(qtbot, queue):
    return shown(qtbot, ErrorsPanel(context(PLANNED, (Method.FREE,), compute=queue)), (430, 350))


def follow(panel: ErrorsPanel, made: Session, queue: Queue, from_s: float = 100.0) -> None:
    """Show a session as the window does, some time, until nothing is missing."""
    for step in range(20):
        if panel.isVisible():
            panel.course.update(made.snapshot())
        panel.show_state(frame(made.snapshot(), now_s=from_s + step))
        queue.finish()


def test_the_past_of_an_open_session_is_computed_and_drawn(panel, queue):
    made, hue = poked(12), DARK.methods["free"]
    empty = ink(pixels(panel.plot), hue, 20)
    panel.course.update(made.snapshot())
    panel.show_state(frame(made.snapshot()))
    assert "computing" in panel.plot.item.getAxis("bottom").labelText
    follow(panel, made, queue)
    found = panel.course.series()
    assert found.counts.tolist() == list(range(1, 13))
    wanted = error_series(SCENE, None, made.snapshot(), reference(Origin.PLAN).places)
    assert np.array_equal(found.spreads[Method.FREE], wanted.spreads[Method.FREE], equal_nan=True)
    assert ink(pixels(panel.plot), hue, 20) > empty + 100
    assert panel.plot.item.getAxis("bottom").labelText == "accepted pokes"
    assert "plan" in panel.source_box.currentText()
    dark = pixels(panel.plot)[..., :3].mean()
    show_in(LIGHT)
    panel.recolour()
    assert pixels(panel.plot)[..., :3].mean() > dark + 100


def test_an_exclusion_rewrites_the_course_and_the_same_state_draws_nothing(panel, queue, qtbot):
    made = Session(SCENE, None)
    for record in poked(8).snapshot().pokes:
        made.add(record.outcome)
        panel.course.update(made.snapshot())
    assert not queue.waiting, "each new poke adds its point at once"
    follow(panel, made, queue)
    before = pixels(panel.plot)
    made.act(Exclude(2))
    follow(panel, made, queue, 130.0)
    assert panel.course.series().pokes.tolist() == [1, 3, 4, 5, 6, 7, 8]
    assert changed(before, pixels(panel.plot)) > 20
    paints = paints_from_now(qtbot, panel)
    follow(panel, made, queue, 160.0)
    qtbot.wait(50)
    assert paints.count == 0
    panel.hide()
    made.add(touch(9))
    follow(panel, made, queue, 190.0)
    assert len(panel.course.series().counts) == 7, "a hidden panel follows nothing"


def test_the_plot_follows_axis_module_and_source(panel, queue):
    made = poked(6)
    follow(panel, made, queue)
    pictures = [pixels(panel.plot)]
    for choose in (
        panel.axis_buttons[Axis.TIME].click,
        panel.axis_buttons[Axis.MODULES].click,
        panel.axis_buttons[Axis.POKES].click,
        lambda: (panel.module_box.setCurrentIndex(2), panel.module_box.activated.emit(2)),
        lambda: panel.source_box.activated.emit(1),
    ):
        choose()
        follow(panel, made, queue, 130.0)
        pictures.append(pixels(panel.plot))
    assert changed(pictures[0], pictures[1]) > 20
    assert changed(pictures[1], pictures[2]) > 20
    assert changed(pictures[0], pictures[3]) == 0
    assert changed(pictures[0], pictures[4]) > 20  # module 11 was not touched
    assert panel.plot.item.getAxis("left").labelText == "expected error, mm"


# The course behind it


def finish(tracker: ErrorFollower, made: Session, queue: Queue) -> None:
    for _ in range(10):
        tracker.update(made.snapshot())
        queue.finish()


def test_work_for_another_source_is_dropped(queue):
    tracker, made = ErrorFollower(PLANNED, queue), poked(6)
    tracker.update(made.snapshot())
    tracker.choose(1)
    queue.finish()
    assert not len(tracker.series().counts)
    finish(tracker, made, queue)
    assert tracker.series().missing == 0
    known = [e.rms for e in made.snapshot().estimates[Method.FREE] if e.rms is not None]
    assert tracker.series().spreads[Method.FREE][-1, 0, MEAN] == pytest.approx(np.mean(known))


def test_work_that_fails_is_tried_again_after_a_change_of_the_session(queue, monkeypatch):
    def broken(*_):
        raise RuntimeError("of the estimate")

    tracker, made = ErrorFollower(part(laid=None), queue), poked(6)
    assert (tracker.source, tracker.sources) == (None, [None])
    tracker.update(made.snapshot())
    with monkeypatch.context() as fault:
        fault.setattr("skincal.following.error_history.spreads_of", broken)
        with pytest.raises(RuntimeError, match="of the estimate"):
            queue.finish()
    tracker.update(made.snapshot())
    assert not queue.waiting
    made.add(touch(7))
    finish(tracker, made, queue)
    whole = error_series(SCENE, None, made.snapshot(), None)
    assert tracker.series().missing == 0
    assert np.array_equal(tracker.series().spreads[Method.FREE], whole.spreads[Method.FREE], equal_nan=True)


def test_a_file_replaces_the_file_before_and_the_plan_stays(panel):
    for name in ("a.json", "b.json"):
        panel.add_reference(reference(Origin.FILE, name))
    panel.add_reference(reference(Origin.TRUTH))
    assert [source and source.name for source in panel.course.sources] == ["truth.json", "b.json", "part", None]
    assert panel.source_box.currentText() == approved("errors.against_truth", name="truth.json")


def test_a_taxel_estimated_at_its_known_position_has_no_error():
    history = ErrorCourse(SCENE, None, {3: np.array([0.01, 0.0, 0.0])})
    history.update(session(1, {3: estimate(3, (0.01, 0.0, 0.0)), 4: estimate(4, (0.0, 0.0, 0.0))}, [touch(1)]))
    assert history.series().spreads[Method.FREE][-1, 0].tolist() == [1.0, 0.0, 0.0, 0.0]


# In the window


def test_closed_it_costs_nothing_while_pokes_come(bench, qtbot, monkeypatch):
    calls: list[str] = []
    for owner, name in (
        *((ErrorCourse, name) for name in ("update", "series", "work")),
        *((ErrorFollower, "update"), (ModulesCheck, "check_snapshot"), (ComparePanel, "update_view")),
    ):
        real = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda *args, real=real, name=name: calls.append(name) or real(*args))
    bench.open_served("flat-patch")
    panel = bench.panel(ErrorsPanel)
    paints = Paints(panel)
    bench.until(lambda: len(bench.accepted()) >= 1)
    assert (calls, paints.count) == ([], 0)
    assert bench.panel(ComparePanel)._neighbours is None
    bench.key(Qt.Key.Key_6)
    accepted = len(bench.accepted())
    bench.until(lambda: len(bench.accepted()) > accepted)
    bench.until(lambda: len(panel.course.series().counts) > 0 and panel.course.series().counts[-1] > accepted, 5000)
    bench.key(Qt.Key.Key_1)
    qtbot.wait(100)
    calls.clear()
    paints.count = 0
    accepted = len(bench.accepted())
    bench.until(lambda: len(bench.accepted()) > accepted)
    assert (calls, paints.count) == ([], 0)


def open_errors(bench, folder) -> ErrorsPanel:
    bench.open(OpenRequest(session=folder))
    bench.until_all_is_there()
    bench.key(Qt.Key.Key_6)
    panel = bench.panel(ErrorsPanel)
    bench.until(lambda: len(panel.course.series().counts) > 0 and not panel.course.series().missing, OPEN_MS)
    return panel


def test_the_followers_know_what_is_seen_and_nothing_of_widgets(bench, recorded):
    """Each follower held a method of a widget, which outlives no window."""
    open_errors(bench, recorded)
    guided = bench.window.session_view.guided
    assert (guided.shows_errors, guided.shows_modules) == (True, False)
    bench.key(Qt.Key.Key_4)
    assert (guided.shows_errors, guided.shows_modules) == (False, True)
    bench.key(Qt.Key.Key_1)
    assert (guided.shows_errors, guided.shows_modules) == (False, False)


def test_the_error_against_truth_and_file_follows_an_exclusion_and_is_kept(bench, qtbot, recorded, tmp_path):
    panel = open_errors(bench, recorded)
    bench.until(lambda: panel.source_box.currentText() == approved("errors.against_truth", name="truth.json"), 5000)
    bench.until(lambda: panel.course.series().missing == 0 and len(panel.course.series().counts) > 0, OPEN_MS)
    truth = read_reference(recorded / "truth.json")
    before = panel.course.series()
    for method in BOTH:
        summary, last = error_summary(bench.snapshot.estimates[method], truth), before.spreads[method][-1, 0]
        assert last[TAXELS] == (0 if summary is None else summary.taxels)
        if summary is not None:
            assert last[[MEAN, P95, MAX]] == pytest.approx([summary.mean, summary.p95, summary.max])
    paints = paints_from_now(qtbot, bench.window)
    qtbot.wait(1500)
    assert paints.count == 0
    first = bench.accepted()[0].poke
    bench.window.session_view.select_poke(first)
    for key, is_there in ((Qt.Key.Key_E, False), (Qt.Key.Key_Backspace, True)):
        bench.key(key)
        bench.key(Qt.Key.Key_6)
        bench.until(
            lambda is_there=is_there: (first in panel.course.series().pokes) is is_there and not panel.course.series().missing,
            5000,
        )
    after = panel.course.series()
    for method in BOTH:
        assert np.array_equal(before.spreads[method], after.spreads[method], equal_nan=True)
    a_file_is_compared_and_tab_and_axis_are_kept(bench, panel, recorded, tmp_path)


def a_file_is_compared_and_tab_and_axis_are_kept(bench, panel, recorded, tmp_path):
    panel.axis_buttons[Axis.TIME].click()
    bench.key(Qt.Key.Key_1)
    path = tmp_path / "mine.json"
    link = bench.window.session_view.workspace.part.scene.link
    taxels = [{"channel": c, "position_m": [0.0, 0.0, 0.0]} for c in range(400)]
    path.write_text(json.dumps({"link": link, "taxels": taxels}))
    bench.window.session_view.compare_with(path)
    bench.until(lambda: panel.source_box.currentText() == "Error against mine.json", 5000)
    assert panel.isVisible()
    path.write_text(json.dumps({"link": "elsewhere", "taxels": taxels}))
    bench.window.session_view.compare_with(path)
    bench.until(lambda: approved("errors.other_link", link="elsewhere") in bench.window.messages.text.text(), 5000)
    assert panel.source_box.currentText() == "Error against mine.json"
    bench.window.close()
    assert QSettings("skincal", "test").value("window/tab") == "Errors"
    other = Bench(bench.qtbot, tmp_path)
    other.open(OpenRequest(session=recorded))
    assert other.window.session_view.workspace.current_panel() is other.panel(ErrorsPanel)
    assert other.panel(ErrorsPanel).axis is Axis.TIME
    other.window.close()


def test_a_simulated_rig_sends_its_truth_and_the_session_keeps_it(qtbot, tmp_path):
    made = load_part(resource("scenes/flat-patch/scene.toml"))
    channel = int(made.channels[0])
    announced = {
        "links": [{"name": "skin", "address": "socket://127.0.0.1:9", "carries": ["skin"]}],
        "link": made.scene.link,
        "taxels": [{"channel": channel, "position_m": [0.0, 0.1, 0.2]}],
    }
    server, truths = DeviceProcess(), []
    server.truth_printed.connect(truths.append)
    with qtbot.waitSignal(server.served, timeout=OPEN_MS) as served:
        server.start((sys.executable, "-c", f"print({json.dumps(announced)!r}, flush=True); input()"))
        server.listen()
    server.stop()
    folder, linked, letter = tmp_path / "new", tmp_path / "linked", tmp_path / "letter"
    opening.begin_session(made, served.args[0], folder, truths[0]).close()
    linked.mkdir()
    letter.write_text("dear", encoding="utf-8")
    (linked / TRUTH_NAME).symlink_to(letter)
    with pytest.raises(InputError, match="is a link"):
        opening.begin_session(made, served.args[0], linked, truths[0])
    assert letter.read_text(encoding="utf-8") == "dear"
    found = find_truth(folder, made.scene.link, made.channels.tolist())
    assert found.origin is Origin.TRUTH
    assert found.places[channel].tolist() == [0.0, 0.1, 0.2]
