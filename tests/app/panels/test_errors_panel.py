"""The panel of errors: what it claims, what it draws, and that it costs nothing while it is closed."""

from __future__ import annotations

import json
import math
import subprocess
import sys

import numpy as np
import pytest
from PySide6.QtCore import QPointF, QSettings, Qt
from PySide6.QtGui import QColor

from app.panels.plot_panels import ErrorsPanel
from app.panels.plots import TEXT_MARGIN, ErrorPlot
from app.session import opening
from app.session.opening import OpenRequest
from app.text.errors_text import (
    PAPER,
    Axis,
    axis_words,
    log_range,
    log_ticks,
    newest_words,
    paper_words,
    quantity_words,
    shown_range,
    source_words,
)
from app.theme import DARK, LIGHT
from app.workers.device_process import DeviceProcess
from skincal.files.reference import TRUTH_NAME, Origin, Reference
from skincal.model.errors import InputError
from skincal.model.scene import resource
from skincal.session.error_history import (
    MAX,
    MEAN,
    P95,
    TAXELS,
    ErrorCourse,
    ErrorFollower,
    ErrorSeries,
)
from skincal.session.part import Part, load_part
from skincal.session.session import Session
from skincal.taxels.result import Method
from tests.app.scene3d_support import estimate
from tests.app.whole_window import OPEN_MS, Bench, Paints
from tests.app.window_support import PLAN, SCENE, changed, frame, pixels, session, show_in, touch
from tests.approved import approved
from tests.skincal.poke_script import error_series

BOTH = (Method.FREE, Method.SURFACE)


def reference(origin: Origin, name: str = "truth.json", at=(0.0, 0.0, 0.0)) -> Reference:
    return Reference(origin, name, {channel: np.array(at) for channel in range(24)})


def test_a_plan_is_never_called_a_truth():
    plan = source_words(reference(Origin.PLAN, "part"))
    assert "plan" in plan
    assert approved("errors.plan_is_no_truth") in plan
    assert "truth" not in plan
    assert source_words(reference(Origin.TRUTH)) == approved("errors.against_truth", name="truth.json")
    chosen = source_words(reference(Origin.FILE, "right_forearm.txt"))
    assert chosen == "Error against right_forearm.txt"
    assert source_words(None).startswith("Predicted error;")
    assert (quantity_words(None), quantity_words(reference(Origin.PLAN))) == ("expected error, mm", "error, mm")


def test_the_papers_figures_are_labelled():
    assert {method: value * 1e3 for method, value in PAPER.items()} == pytest.approx({Method.FREE: 7.2, Method.SURFACE: 6.6})
    assert [paper_words(method) for method in BOTH] == ["\N{BLACK CIRCLE} paper 7.2", "\N{BLACK DIAMOND} paper 6.6"]


@pytest.mark.parametrize(
    ("low", "high", "shown"), [(0.7, 40.3, (0.5, 50)), (5, 10, (5, 10)), (1, 1, (1, 2)), (3, 101, (2, 200))]
)
def test_the_axis_ends_at_round_numbers(low, high, shown):
    assert log_range(low, high) == pytest.approx(shown)
    ticks = log_ticks(*log_range(low, high))
    assert ticks[0] == (pytest.approx(math.log10(shown[0])), f"{shown[0]:g}")
    assert ticks[-1][1] == f"{shown[1]:g}"


def test_the_range_shows_every_value_and_passes_over_what_is_unknown():
    low, high = shown_range([np.array([np.nan, 3.0, 0.0]), np.array([60.0])], 5.0, 10.0)
    assert low <= 3.0
    assert high >= 60.0
    assert shown_range([np.empty(0)], 6.6, 10.0) == pytest.approx((5.0, 10.0))


def series(values, missing: int = 0, stride: int = 1) -> ErrorSeries:
    """A course of the free method: mean in metres after each poke, p95 twice, max four times of it."""
    counts = stride * np.arange(1, len(values) + 1)
    spreads = np.full((len(values), 3, 4), np.nan)
    for row, mean in enumerate(values):
        spreads[row] = 5, mean, 2 * mean, 4 * mean
    return ErrorSeries(counts, counts, 3.0 * counts, {Method.FREE: spreads}, stride, missing)


def test_the_newest_figures_in_words():
    words = newest_words(series([0.010, 0.0021]), Method.FREE, 0)
    assert [part in words for part in ("mean 2.1", "p95 4.2", "worst 8.4 mm", "5 taxels")] == [True] * 4
    assert "mean \N{EN DASH}" in newest_words(series([]), Method.SURFACE, 0)
    assert axis_words(series([0.01]), Axis.TIME) == "minutes of poking"
    assert axis_words(series([0.01], missing=7), Axis.POKES) == approved("errors.past_missing", count=7)
    assert axis_words(series([0.01], stride=4), Axis.POKES) == approved("errors.past_thinned", stride=4)


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


def poked(count: int) -> Session:
    """Pokes from above and aslant onto a few taxels of a part without a mesh."""
    made = Session(SCENE, None)
    rng = np.random.default_rng(5)
    for poke in range(1, count + 1):
        made.add(touch(poke, (3, 4, 5), (50.0, 30.0, 20.0), (*rng.uniform(-5, 5, 2), -9.0)))
    return made


def part(plan: Reference | None = None) -> Part:
    return Part(SCENE, None, None, PLAN.channels, (), plan)


def at(made: Session, **changes):
    return frame(made.snapshot(), **changes)


def course_of(bench):
    return bench.window.session_view.guided.errors.series()


def follow(course: ErrorFollower, state) -> None:
    course.follow(state.snapshot)


@pytest.fixture
def queue():
    return Queue()


@pytest.fixture
def course(queue):
    return ErrorFollower(part(reference(Origin.PLAN, "part")), queue)


@pytest.fixture
def panel(qtbot, course):
    """A panel on the screen with its plot."""
    show_in(DARK)
    made = ErrorsPanel((Method.FREE,), PLAN)
    show = made.show_state

    def follow_and_show(state) -> None:
        # As the window does: what a panel on the screen shows is followed first.
        if made.isVisible():
            follow(course, state)
        show(state)

    made.begin(course)
    made.show_state = follow_and_show
    made.resize(430, 350)
    qtbot.addWidget(made)
    with qtbot.waitExposed(made):
        made.show()
    made.show_state(frame(session(-1), now_s=90.0))
    qtbot.waitUntil(lambda: made.ready, timeout=20_000)
    return made


def line_of(widget, method: int = 0) -> int:
    """How many pixels have a method's hue, or nearly."""
    seen = pixels(widget)[..., :3].astype(int)
    hue = QColor(list(DARK.methods.values())[method]).getRgb()[:3]
    return int((np.abs(seen - hue).sum(axis=2) < 40).sum())


def test_the_past_of_a_session_that_is_open_already_is_worked_out_and_drawn(panel, course, queue):
    made = poked(12)
    empty = line_of(panel.plot)
    panel.show_state(at(made))
    assert "working out" in panel.plot.item.getAxis("bottom").labelText
    queue.finish()
    for now_s in range(101, 140):
        panel.show_state(at(made, now_s=float(now_s)))
        queue.finish()
    shown = course.series()
    assert shown.counts.tolist() == list(range(1, 13))
    wanted = error_series(SCENE, None, made.snapshot(), reference(Origin.PLAN).places)
    assert np.array_equal(shown.spreads[Method.FREE], wanted.spreads[Method.FREE], equal_nan=True)
    assert line_of(panel.plot) > empty + 100
    assert panel.plot.item.getAxis("bottom").labelText == "accepted pokes"
    assert "plan" in panel.source_box.currentText()


def test_each_poke_adds_its_point_and_an_exclusion_rewrites_the_course(panel, course, queue):
    from skincal.model.actions import Exclude

    made = Session(SCENE, None)
    whole = poked(8)
    for record in whole.snapshot().pokes:
        made.add(record.outcome)
        panel.show_state(at(made))
    assert not queue.waiting
    assert course.series().counts.tolist() == list(range(1, 9))
    before = pixels(panel.plot)
    made.act(Exclude(2))
    # A busy machine gets on by one point a step.
    for now_s in range(100, 130):
        panel.show_state(at(made, now_s=float(now_s)))
        queue.finish()
    assert course.series().pokes.tolist() == [1, 3, 4, 5, 6, 7, 8]
    assert changed(before, pixels(panel.plot)) > 20


def test_what_is_drawn_follows_axis_module_and_source(panel, queue):
    made = poked(6)
    for now_s in range(100, 130):
        panel.show_state(at(made, now_s=float(now_s)))
        queue.finish()
    pictures = [pixels(panel.plot)]
    for choose in (
        panel.axis_buttons[Axis.TIME].click,
        panel.axis_buttons[Axis.MODULES].click,
        panel.axis_buttons[Axis.POKES].click,
        lambda: (panel.module_box.setCurrentIndex(2), panel.module_box.activated.emit(2)),
        lambda: panel.source_box.activated.emit(1),
    ):
        choose()
        for now_s in range(130, 140):
            panel.show_state(at(made, now_s=float(now_s)))
            queue.finish()
        pictures.append(pixels(panel.plot))
    assert changed(pictures[0], pictures[1]) > 20
    assert changed(pictures[1], pictures[2]) > 20
    assert changed(pictures[0], pictures[3]) == 0
    assert changed(pictures[0], pictures[4]) > 20  # module 11 was not touched
    assert not any(line.isVisible() for line in panel.plot.papers.values())
    assert panel.plot.item.getAxis("left").labelText == "expected error, mm"


def test_the_papers_lines_are_drawn_where_an_error_is(panel):
    panel.show_state(at(poked(2)))
    line = panel.plot.papers[Method.FREE]
    assert line.isVisible()
    assert line.value() == pytest.approx(math.log10(7.2))
    low, high = panel.plot.item.viewRange()[1]
    assert low < line.value() < high
    with_line = pixels(panel.plot)
    line.hide()
    assert changed(with_line, pixels(panel.plot)) > 50


@pytest.mark.parametrize("width", [360, 900])
def test_the_labels_of_the_papers_lines_lie_at_the_rim_on_no_curve_and_apart(qtbot, width):
    plot = ErrorPlot(BOTH, ())
    plot.resize(900 + 360 - width, 220)
    qtbot.addWidget(plot)
    with qtbot.waitExposed(plot):
        plot.show()
    series = error_series(SCENE, None, poked(12).snapshot(), reference(Origin.PLAN).places)
    plot.draw(series, Axis.POKES, 0, "error, mm", paper=True)
    plot.resize(width, 220)
    qtbot.wait(50)
    item = plot.item
    newest = item.vb.mapViewToScene(QPointF(float(series.counts[-1]), 0.0)).x()
    edges = []
    for line in plot.papers.values():
        label = line.label.textItem
        box = label.mapRectToScene(label.boundingRect())
        assert box.left() > newest, "no curve goes so far"
        assert box.right() <= item.vb.sceneBoundingRect().right() + 1
        edges.append((box.top() + TEXT_MARGIN * box.height(), box.bottom() - TEXT_MARGIN * box.height()))
        on_line = item.vb.mapViewToScene(QPointF(0.0, line.value())).y()
        assert min(abs(on_line - edge) for edge in edges[-1]) < 2.0, "it touches its line"
    free, surface = edges
    assert free[1] < surface[0] + 1.0


def test_the_theme_reaches_the_plot(panel, qtbot):
    dark = pixels(panel.plot)[..., :3].mean()
    show_in(LIGHT)
    panel.recolour()
    qtbot.wait(20)
    assert pixels(panel.plot)[..., :3].mean() > dark + 100


def test_a_frame_that_brings_nothing_new_draws_nothing(panel, qtbot, queue):
    made = poked(3)
    for now_s in range(100, 110):
        panel.show_state(at(made, now_s=float(now_s)))
        queue.finish()
    qtbot.wait(50)
    paints = Paints(panel)
    for now_s in range(110, 140):
        panel.show_state(at(made, now_s=float(now_s)))
    qtbot.wait(50)
    assert paints.count == 0
    assert not queue.waiting


def test_a_panel_that_is_hidden_follows_nothing(panel, course, queue):
    panel.hide()
    panel.show_state(at(poked(5)))
    assert not queue.waiting
    assert not len(course.series().counts)


def test_work_for_another_source_is_dropped(queue):
    tracker = ErrorFollower(part(reference(Origin.PLAN, "part")), queue)
    made = at(poked(6))
    follow(tracker, made)
    (work, done), queue.waiting = queue.waiting[0], []
    tracker.choose(1)
    done(work())
    assert not len(tracker.series().counts)
    follow(tracker, made)
    for _ in range(10):
        queue.finish()
        follow(tracker, made)
    assert tracker.series().missing == 0
    known = [e.rms for e in made.snapshot.estimates[Method.FREE] if e.rms is not None]
    assert tracker.series().spreads[Method.FREE][-1, 0, MEAN] == pytest.approx(np.mean(known))


def test_work_that_fails_is_tried_again_once_the_session_is_another(queue, monkeypatch):
    def broken(*_):
        raise RuntimeError("of the estimate")

    tracker = ErrorFollower(part(None), queue)
    made = poked(6)
    follow(tracker, at(made))
    with monkeypatch.context() as fault:
        fault.setattr("skincal.session.error_history.spreads_of", broken)
        with pytest.raises(RuntimeError, match="of the estimate"):
            queue.finish()
    follow(tracker, at(made, now_s=101.0))
    assert not queue.waiting
    made.add(touch(7))
    for _ in range(10):
        follow(tracker, at(made))
        queue.finish()
    whole = error_series(SCENE, None, made.snapshot(), None)
    assert tracker.series().missing == 0
    assert np.array_equal(tracker.series().spreads[Method.FREE], whole.spreads[Method.FREE], equal_nan=True)


def test_where_no_place_is_known_it_is_the_predicted_error(queue):
    tracker = ErrorFollower(part(None), queue)
    assert (tracker.source, tracker.sources) == (None, [None])
    assert ErrorFollower(part(reference(Origin.PLAN, "part")), queue).source.origin is Origin.PLAN


def test_a_file_takes_the_place_of_the_file_before_and_the_plan_stays(queue):
    tracker = ErrorFollower(part(reference(Origin.PLAN, "part")), queue)
    for name in ("a.json", "b.json"):
        tracker.offer(reference(Origin.FILE, name))
    tracker.offer(reference(Origin.TRUTH))
    assert [source and source.name for source in tracker.sources] == ["truth.json", "b.json", "part", None]
    assert tracker.source.origin is Origin.TRUTH


def test_a_panel_that_was_never_open_imports_no_plots():
    code = (
        "import sys; from PySide6.QtWidgets import QApplication; app = QApplication([]);"
        "from app.panels.plot_panels import ErrorsPanel;"
        "from skincal.taxels.result import Method; panel = ErrorsPanel((Method.FREE,), None);"
        "sys.exit('pyqtgraph' in sys.modules or panel._threads is not None)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


TYPES = """
import sys
from PySide6 import QtCore, QtGui, QtWidgets
app = QtWidgets.QApplication([])
from app.panels import plot_panels
left = None
def look():
    global left
    left = [name for module in (QtCore, QtGui, QtWidgets) for name in dir(module) if name not in vars(module)]
plot_panels._import_pyqtgraph = look
panel = plot_panels.ReadingsPanel()
panel.make = QtWidgets.QWidget
panel.show()
panel.show_state(None)
while not panel._imported:
    app.processEvents()
sys.exit(", ".join(left) or 0)
"""
"""What is named while the import runs would be made in its thread."""


def test_no_type_of_qt_is_made_in_another_thread():
    """What the window uses while it is made elsewhere ends the program."""
    done = subprocess.run([sys.executable, "-c", TYPES], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


class Calls:
    """Counts what the course of errors costs."""

    def __init__(self, monkeypatch) -> None:
        self.count = 0
        for owner, name in ((ErrorCourse, "update"), (ErrorCourse, "series"), (ErrorCourse, "work"), (ErrorFollower, "follow")):
            monkeypatch.setattr(owner, name, self._counted(getattr(owner, name)))

    def _counted(self, method):
        def call(*args, **kwargs):
            self.count += 1
            return method(*args, **kwargs)

        return call


def test_closed_it_costs_nothing_while_pokes_come(bench, qtbot, monkeypatch):
    calls = Calls(monkeypatch)
    bench.open_served("flat-patch")
    workspace = bench.window.session_view.workspace
    paints = Paints(workspace.error_course)
    bench.until(lambda: len(bench.accepted()) >= 1)
    assert calls.count == 0
    assert paints.count == 0
    assert workspace.error_course.plot is None
    bench.key(Qt.Key.Key_6)
    assert workspace.tabs.currentWidget() is workspace.error_course
    bench.until(lambda: workspace.error_course.plot is not None, OPEN_MS)
    accepted = len(bench.accepted())
    bench.until(lambda: len(bench.accepted()) > accepted)
    bench.until(lambda: course_of(bench).counts[-1] > accepted, 5000)
    bench.key(Qt.Key.Key_1)
    qtbot.wait(100)
    calls.count = paints.count = 0
    accepted = len(bench.accepted())
    bench.until(lambda: len(bench.accepted()) > accepted)
    assert (calls.count, paints.count) == (0, 0)


def open_errors(bench, folder) -> ErrorsPanel:
    bench.open(OpenRequest(session=folder))
    bench.until_all_is_there()
    bench.key(Qt.Key.Key_6)
    panel = bench.window.session_view.workspace.error_course
    bench.until(lambda: panel.ready and not course_of(bench).missing, OPEN_MS)
    return panel


def test_a_simulated_sessions_truth_is_found_and_its_error_is_that_of_the_report(bench, qtbot, recorded):
    from skincal.files.reference import error_summary, read_reference

    panel = open_errors(bench, recorded)
    bench.until(lambda: panel.source_box.currentText() == approved("errors.against_truth", name="truth.json"), 5000)
    bench.until(
        lambda: course_of(bench).missing == 0 and len(course_of(bench).counts) > 0,
        OPEN_MS,
    )
    truth = read_reference(recorded / "truth.json")
    for method in BOTH:
        summary = error_summary(bench.snapshot.estimates[method], truth)
        last = course_of(bench).spreads[method][-1, 0]
        assert last[TAXELS] == (0 if summary is None else summary.taxels)
        if summary is not None:
            assert last[[MEAN, P95, MAX]] == pytest.approx([summary.mean, summary.p95, summary.max])
    qtbot.wait(600)
    paints = Paints(bench.window)
    qtbot.wait(1500)
    assert paints.count == 0


def test_excluded_by_key_a_poke_leaves_the_course_and_comes_back(bench, recorded):
    open_errors(bench, recorded)
    before = course_of(bench)
    first = bench.accepted()[0].poke
    bench.window.session_view.select_poke(first)
    bench.key(Qt.Key.Key_E)
    bench.key(Qt.Key.Key_6)
    bench.until(
        lambda: first not in course_of(bench).pokes and not course_of(bench).missing,
        5000,
    )
    bench.key(Qt.Key.Key_Backspace)
    bench.until(
        lambda: first in course_of(bench).pokes and not course_of(bench).missing,
        5000,
    )
    after = course_of(bench)
    for method in BOTH:
        assert np.array_equal(before.spreads[method], after.spreads[method], equal_nan=True)


def test_a_file_is_compared_with_and_a_wrong_one_is_said(bench, recorded, tmp_path):
    panel = open_errors(bench, recorded)
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


def test_the_open_tab_and_the_axis_are_kept(bench, qtbot, recorded, tmp_path):
    panel = open_errors(bench, recorded)
    panel.axis_buttons[Axis.TIME].click()
    bench.window.close()
    settings = QSettings("skincal", "test")
    assert settings.value("window/tab") == "Errors"
    other = Bench(qtbot, tmp_path)
    other.open(OpenRequest(session=recorded))
    workspace = other.window.session_view.workspace
    assert workspace.tabs.currentWidget() is workspace.error_course
    assert workspace.error_course.axis is Axis.TIME
    other.window.close()


def test_a_simulated_rig_tells_where_its_taxels_are_and_the_session_keeps_it(qtbot, tmp_path):
    scene = resource("scenes/flat-patch/scene.toml")
    made = load_part(scene)
    channel = int(made.channels[0])
    announced = {
        "links": [{"name": "skin", "address": "socket://127.0.0.1:9", "carries": ["skin"]}],
        "link": made.scene.link,
        "taxels": [{"channel": channel, "position_m": [0.0, 0.1, 0.2]}],
    }
    server, order = DeviceProcess(), []
    server.truth_printed.connect(lambda truth: order.append(truth))
    with qtbot.waitSignal(server.served, timeout=OPEN_MS) as served:
        server.start((sys.executable, "-c", f"print({json.dumps(announced)!r}, flush=True); input()"))
    server.stop()
    folder, linked, letter = tmp_path / "new", tmp_path / "linked", tmp_path / "letter"
    pipeline = opening.begin_session(made, served.args[0], folder, order[0])
    pipeline.close()
    linked.mkdir()
    letter.write_text("dear", encoding="utf-8")
    (linked / TRUTH_NAME).symlink_to(letter)
    with pytest.raises(InputError, match="is a link"):
        opening.begin_session(made, served.args[0], linked, order[0])
    assert letter.read_text(encoding="utf-8") == "dear"
    found = opening.find_truth_of(folder, made)
    assert found.origin is Origin.TRUTH
    assert found.places[channel].tolist() == [0.0, 0.1, 0.2]


def test_a_taxel_estimated_where_it_is_known_to_be_has_no_error():
    history = ErrorCourse(SCENE, None, {3: np.array([0.01, 0.0, 0.0])})
    history.update(session(1, {3: estimate(3, (0.01, 0.0, 0.0)), 4: estimate(4, (0.0, 0.0, 0.0))}, [touch(1)]))
    assert history.series().spreads[Method.FREE][-1, 0].tolist() == [1.0, 0.0, 0.0, 0.0]
