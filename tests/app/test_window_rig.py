"""The rig put right in the real window: landmarks asked for, poked, skipped; corrections offered, used, taken back."""

from __future__ import annotations

import multiprocessing
import re
import shutil
import time
from dataclasses import replace

import numpy as np
import pytest
from PySide6.QtCore import QSignalBlocker, Qt, QTimer
from PySide6.QtTest import QTest

from app.session import controller
from app.session.opening import OpenRequest
from app.state.running import Running
from app.text.message import STILL_SOLVING
from app.text.rig_text import offer_text
from skincal.contacts.outcome import Contact, PressPhase, Reason, Rejection
from skincal.guide.guidance import LANDMARK_POKE_MAX_OFFSET_M
from skincal.journal.writer import create_session
from skincal.mesh.load import load_surface
from skincal.model.actions import AtLandmark, SetPose, Undo
from skincal.model.errors import InputError
from skincal.model.readings import LinkEvent, LinkState
from skincal.rig.correction import RIG, Correction, UsedCorrection
from skincal.session import solving
from skincal.session.corrections import correct_action
from skincal.session.pipeline import Pipeline
from skincal.simulation.contacts import poke_landmarks
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import Rig
from skincal.streams.links import LinkSpec
from skincal.taxels.result import Method
from tests.app.whole_window import OPEN_MS
from tests.app.window_support import is_elided
from tests.app.workers.process_support import is_running
from tests.approved import approved
from tests.skincal.session.test_no_sensor import EVERY, chunks, scene_of, scene_text
from tests.skincal.session.test_tool_rig import STREAMS

Key = Qt.Key
SHIFT = Qt.KeyboardModifier.ShiftModifier
POSE = "1"


class Poked:
    """A session that streams, or looks as if it did, and a hand that pokes where it is told."""

    def __init__(self, bench, monkeypatch) -> None:
        self.bench = bench
        self.pipeline = pipeline = bench.recording.pipeline
        live = pipeline.live

        def ready(now_ns):
            view = live(now_ns)
            return replace(view, progress=replace(view.progress, phase=PressPhase.READY), links=())

        monkeypatch.setattr(pipeline, "live", ready)
        bench.controller._set_running(Running.STREAMING)
        self.said: list[str] = []
        bench.window.session_view.said.connect(lambda message: self.said.append(message.text))
        self.rng = np.random.default_rng(5)
        self.rig = Rig(pipeline.scene, pipeline.session.surface, RigErrors.paper(), np.random.default_rng(1))
        bench.controller.act(SetPose(POSE))
        bench.until(lambda: self.now.headline.text() == approved("landmark.ask", name=self.asked), 5000)

    @property
    def frame(self):
        return self.bench.window.session_view.state

    @property
    def asked(self) -> str:
        target = self.frame.target
        return "" if target is None else target.landmark

    @property
    def panel(self):
        return self.bench.window.session_view.workspace.panels["Rig"]

    @property
    def now(self):
        return self.bench.window.session_view.workspace.now

    def near(self) -> tuple[int, float]:
        """The taxel nearest to the landmark that is asked for, and how far it lies away, metres."""
        laid = self.bench.window.session_view.workspace.part.laid
        layout = self.pipeline.scene.skin.layout
        apart = np.linalg.norm(laid.places[layout.channels] - self.frame.target.place, axis=1)
        return int(layout.channels[apart.argmin()]), float(apart.min())

    def poke(self, *, answered: bool = False) -> int:
        """Poke the landmark that is asked for; return the number of the poke."""
        number, before = self.pipeline.session.last_poke + 1, self.frame
        landmark = next(each for each in self.pipeline.session.decisions.landmarks if each.name == self.asked)
        pokes = poke_landmarks(self.rig, (landmark,), 1, self.rng, number)
        made = next(poke for poke in pokes if poke.pose == POSE)
        start_s = time.monotonic() + 1.0
        rest = {"force": made.force, "moment": made.moment, "link_from_sensor": made.link_from_sensor, "pose": POSE}
        channels = np.array([self.near()[0]] if answered else [], dtype=np.int64)
        if answered:
            outcome = Contact(
                poke=number, start_s=start_s, end_s=start_s + 0.3, channels=channels,
                responses=np.array([50.0]), tare_change=0.05, final=True, **rest,
            )  # fmt: skip
        else:
            outcome = Rejection(number, start_s, start_s + 0.3, Reason.NO_TAXEL, 0.0, 1.0, "", channels, True, **rest)
        self.end_as(outcome)
        self.bench.until(lambda: self.frame is not before and number in self.bench.snapshot.at_landmarks, 5000)
        return number

    def end_as(self, outcome) -> None:
        """Have the pipeline settle a poke, as at the end of one that the devices reported."""
        self.pipeline._commit(LinkEvent("wrench", time.monotonic_ns(), LinkState.OPEN), [outcome])

    def until_offered(self) -> None:
        self.bench.until(lambda: bool(self.frame.offers), OPEN_MS)
        self.bench.qtbot.wait(50)


@pytest.fixture
def poked(bench, recorded, tmp_path, monkeypatch):
    # What is poked here is in no recording: the others' session must not tell of it.
    folder = shutil.copytree(recorded, tmp_path / "mine")
    bench.open(OpenRequest(session=folder))
    bench.until_all_is_there()
    return Poked(bench, monkeypatch)


def assert_nothing_is_cut(poked) -> None:
    """Fail where words of the tab are not on the screen as a whole."""
    bench, panel, points = poked.bench, poked.panel, poked.panel.points
    bench.qtbot.wait(50)
    assert (bench.window.width(), bench.window.height()) == (1280, 720)
    assert panel.horizontalScrollBar().maximum() == 0
    for label in (panel.asked, panel.said):
        assert not label.isVisible() or label.heightForWidth(label.width()) <= label.height()
    for button in (panel.offer, panel.drop):
        assert not button.isVisible() or button.sizeHint().width() <= button.width()
    for row in range(points.topLevelItemCount()):
        for column in range(points.columnCount()):
            text = points.topLevelItem(row).text(column)
            assert points.fontMetrics().horizontalAdvance(text) < points.columnWidth(column), text
    last = points.visualItemRect(points.topLevelItem(points.topLevelItemCount() - 1))
    assert points.viewport().rect().contains(last), "all landmarks are seen without scrolling the list"


def moved(before, after) -> float:
    """How far a taxel moved at most between two sets of estimates, metres."""
    apart = [
        np.linalg.norm(first.position - second.position)
        for method, every in before.items()
        for first, second in zip(every, after[method], strict=True)
        if first.position is not None and second.position is not None
    ]
    assert apart
    return float(max(apart))


def test_a_landmark_is_asked_for_in_words_on_the_tab_and_n_skips_it(poked):
    bench = poked.bench
    bench.key(Key.Key_7)
    assert poked.panel.isVisible()
    first = poked.asked
    assert poked.now.headline.text() == approved("landmark.ask", name=first)
    assert poked.now.detail.text().startswith(approved("landmark.which_of", number=1, count=6))
    assert "after 6 pokes" in poked.now.detail.text()
    assert poked.panel.asked.isVisible()
    assert poked.panel.asked.text().startswith(approved("landmark.which_of_on_tab", number=1, count=6))
    rows = [poked.panel.points.topLevelItem(row).text(0) for row in range(poked.panel.points.topLevelItemCount())]
    assert [row for row in rows if row.endswith(first)] == [f"\N{BLACK RIGHT-POINTING TRIANGLE} {first}"]
    assert sum(row.startswith("\N{BLACK RIGHT-POINTING TRIANGLE}") for row in rows) == 1
    assert_nothing_is_cut(poked)
    bench.key(Key.Key_N)
    assert poked.asked not in ("", first)
    assert poked.now.headline.text() == approved("landmark.ask", name=poked.asked)
    assert bench.window.commands.actions["no landmarks"].isEnabled()
    bench.key(Key.Key_N, SHIFT)
    assert poked.asked == ""
    assert poked.frame.target.channel is not None
    assert not poked.panel.asked.isVisible()
    assert not bench.window.commands.actions["no landmarks"].isEnabled()
    bench.controller.act(SetPose("3"))
    assert poked.asked != "", "of another arm pose they are asked for"
    for landmark in bench.snapshot.decisions.landmarks:
        poked.now.headline.setText(approved("landmark.accepted", poke=1240, name=landmark.name))
        assert not is_elided(poked.now.headline)
    gain = approved("landmark.worth", now_mm=12.4, then_mm=10.5, pokes=6)
    longest = approved("landmark.which_of_and_worth", number=6, count=6, worth=gain)
    assert poked.now.detail.fontMetrics().horizontalAdvance(longest) <= poked.now.detail.width()


def test_a_poke_at_a_landmark_is_named_and_heard_as_accepted_whether_a_taxel_answered_or_not(poked):
    bench = poked.bench
    bench.player.played.clear()
    for answered in (False, True):
        while answered and poked.near()[1] > LANDMARK_POKE_MAX_OFFSET_M:
            bench.key(Key.Key_N)
        name = poked.asked
        number = poked.poke(answered=answered)
        assert bench.snapshot.at_landmarks[number] == name
        assert poked.now.result.text().endswith(approved("landmark.accepted", poke=number, name=name))
        assert poked.now.headline.text() == approved("landmark.ask", name=poked.asked)
        assert poked.asked != name
    assert [sound for sound, _ in bench.player.played] == ["ACCEPTED", "ACCEPTED"]
    assert bench.snapshot.can_undo == approved("landmark.undo_poke", poke=number, name=name)
    assert poked.frame.guidance.landmark.done == 2
    bench.key(Key.Key_Backspace)
    assert number not in bench.snapshot.at_landmarks
    assert poked.frame.guidance.landmark.done == 1
    bench.qtbot.wait(100)
    assert number not in bench.snapshot.at_landmarks, "what was taken back is not said again"
    bench.key(Key.Key_G)
    session = poked.pipeline.session
    unasked = replace(session.outcome(number - 1), poke=number + 1, start_s=time.monotonic() + 5.0)
    poked.end_as(unasked)
    bench.until(lambda: bench.snapshot.pokes[-1].outcome is unasked, 5000)
    bench.qtbot.wait(50)
    assert list(bench.snapshot.at_landmarks) == [number - 1], "without the guide none is asked for"


def test_the_session_goes_on_before_its_value_is_made_and_no_value_shows_half_of_it(poked, monkeypatch):
    workspace, states = poked.bench.window.session_view.workspace, []
    show = workspace.show_state
    monkeypatch.setattr(workspace, "show_state", lambda state, *words: (states.append(state), show(state, *words)))
    name, number = poked.asked, poked.poke()
    showing = [state for state in states if state.snapshot.pokes[-1].outcome.poke == number]
    assert showing
    assert {state.snapshot.at_landmarks.get(number) for state in showing} == {name}
    assert {state.target.landmark for state in showing} == {poked.asked}, "what is asked for next is in the same value"
    assert poked.pipeline.asked_landmark == poked.asked


def test_painting_changes_nothing_of_the_session(poked, monkeypatch):
    bench, pipeline = poked.bench, poked.pipeline
    poked.poke()
    view, snapshot, asked = bench.window.session_view, pipeline.snapshot(), pipeline.asked_landmark
    # A poke that nobody has seen yet, at the landmark that is asked for.
    unseen = replace(pipeline.session.outcome(pipeline.session.last_poke), poke=pipeline.session.last_poke + 1, start_s=1e9)
    bench.controller.stop()
    poked.end_as(unseen)
    changed = pipeline.snapshot()
    assert changed is not snapshot
    touched = []
    for owner, names in (
        (pipeline, ("feed", "act", "apply_note", "begin_segment")),
        (pipeline.session, ("act", "add", "set_detected_dead", "finalize_outcomes")),
        (view.guided.guide, ("next_target", "skip")),
        (view.guided.errors, ("update", "choose")),
        (bench.controller, ("act", "publish_again", "tick", "pause", "resume")),
    ):
        for name in names:
            monkeypatch.setattr(owner, name, lambda *_, name=name: touched.append(name))
    panels = [view.workspace.tabs.widget(index) for index in range(view.workspace.tabs.count())]
    for panel in panels:
        with QSignalBlocker(view.workspace.tabs):
            view.workspace.tabs.setCurrentWidget(panel)
        before = view.state
        view.show()
        bench.window.repaint()
        for name in ("snapshot", "live", "guidance", "review", "offers", "may", "revision", "coaching"):
            assert getattr(view.state, name) is getattr(before, name), name
    view.select_taxel(poked.near()[0])
    view.recolour()
    assert view.state.selected == poked.near()[0]
    assert touched == []
    assert pipeline.snapshot() is changed
    assert pipeline.asked_landmark == asked


def test_a_correction_is_offered_used_by_a_key_taken_back_and_dropped(poked):
    bench, panel = poked.bench, poked.panel
    bench.key(Key.Key_7)
    bench.key(Key.Key_V)
    assert not bench.window.commands.actions["correct"].isEnabled()
    for _ in range(6):
        poked.poke()
    assert poked.asked == "", "these are enough for this arm pose"
    poked.until_offered()
    (offer,) = poked.frame.offers
    assert offer_text(offer) == "Correct sensor and arm"
    assert len(poked.said) == 1
    assert approved("rig.correctable_begin") in poked.said[0]
    assert approved("rig.offer_keys") in poked.said[0]
    assert panel.offer.isVisible()
    assert bench.window.commands.actions["correct"].text().startswith(offer_text(offer))
    before = bench.snapshot.estimates
    assert_nothing_is_cut(poked)

    bench.key(Key.Key_C)
    bench.until(lambda: RIG in bench.snapshot.decisions.corrections, 5000)
    assert bench.snapshot.decisions.corrections[RIG].pokes == 6
    assert bench.snapshot.can_undo == approved("rig.undo_correction")
    bench.until(lambda: approved("rig.has_moved_clause") in panel.said.text(), OPEN_MS)
    assert approved("rig.corrected_begin", pokes=6) in poked.said[-1]
    assert poked.frame.offers == ()
    assert_nothing_is_cut(poked)
    assert (panel.offer.isVisible(), panel.drop.isVisible()) == (False, True)
    assert not bench.window.commands.actions["correct"].isEnabled()
    assert moved(before, bench.snapshot.estimates) > 1e-3

    bench.key(Key.Key_Backspace)
    bench.until(lambda: not bench.snapshot.decisions.corrections, 5000)
    assert moved(before, bench.snapshot.estimates) == 0.0
    poked.until_offered()

    QTest.mouseClick(panel.offer, Qt.MouseButton.LeftButton)
    bench.until(lambda: RIG in bench.snapshot.decisions.corrections and panel.drop.isVisible(), 5000)
    bench.qtbot.wait(50)
    QTest.mouseClick(panel.drop, Qt.MouseButton.LeftButton)
    bench.until(lambda: not bench.snapshot.decisions.corrections, 5000)
    assert bench.snapshot.can_undo == approved("rig.undo_end")
    assert moved(before, bench.snapshot.estimates) == 0.0

    (process,) = (child.pid for child in multiprocessing.active_children())
    bench.window.close()
    bench.until(lambda: not is_running(process), 5000)


def test_all_taxels_are_solved_anew_in_several_ticks_while_other_work_waits(poked, monkeypatch, tmp_path):
    bench = poked.bench
    for module, name in (
        (controller, "SOLVING_TIME_PER_TICK_S"),
        (controller, "SHOW_SOLVING_AFTER_S"),
        (controller, "MIN_BUSY_PICTURE_INTERVAL_S"),
    ):
        monkeypatch.setattr(module, name, 0.0)
    monkeypatch.setattr(solving, "MODULES_AT_ONCE", 1)
    shown: list[tuple[object, int, str]] = []
    bench.controller.ticked.connect(lambda it: shown.append((it.snapshot, it.unsolved, poked.now.headline.text())))
    before = bench.snapshot
    matrix = np.eye(6) + 1e-3 * np.arange(36).reshape(6, 6) / 36
    assert bench.controller.act(correct_action(UsedCorrection(RIG, Correction(matrix), 0.009, 0.002, 6)))
    bench.until(lambda: RIG in bench.snapshot.decisions.corrections, 5000)

    waiting = [left for snapshot, left, _ in shown if snapshot is before]
    assert len(waiting) >= 6, "84 taxels of seven modules, a module in each tick"
    assert waiting == sorted(waiting, reverse=True)
    assert all(snapshot is before for snapshot, left, _ in shown if left)
    assert "Recomputing" in [words.split()[0] for _, left, words in shown if left]
    bench.until(lambda: not poked.now.headline.text().startswith("Recomputing"), 5000)
    assert moved(before.estimates, bench.snapshot.estimates) > 1e-5

    # Meanwhile an action and an export wait, with a sentence.
    bench.controller.act(Undo())
    bench.until(lambda: not bench.snapshot.decisions.corrections, 5000)
    monkeypatch.setattr(controller, "MAX_UNSOLVED_TAXELS", 10)
    ticks = next(
        timer
        for timer in bench.controller.findChildren(QTimer, options=Qt.FindChildOption.FindDirectChildrenOnly)
        if timer.isActive()
    )
    ticks.stop()
    assert bench.controller.act(correct_action(UsedCorrection(RIG, Correction(matrix), 0.009, 0.002, 6)))
    assert not bench.snapshot.decisions.corrections
    assert not bench.controller.act(SetPose(""))
    assert bench.messages[-1].text == STILL_SOLVING
    with pytest.raises(InputError, match=re.escape(STILL_SOLVING)):
        bench.controller.export_work("csv", tmp_path / "c.csv", Method.SURFACE, None)
    ticks.start()
    bench.until(lambda: RIG in bench.snapshot.decisions.corrections, 5000)
    assert bench.controller.act(Undo())
    bench.until(lambda: not bench.snapshot.decisions.corrections, 5000)


def test_landmarks_of_recorded_pokes_are_named_by_a_key(bench, tmp_path):
    """Four touches of landmarks by a tool, of which three have their names."""
    scene = scene_of(tmp_path, scene_text())
    links = [LinkSpec(name, f"simulated:{name}", (STREAMS[name],)) for name in ("skin", "tool")]
    pipeline = Pipeline(scene, links, load_surface(scene.surface)[0], create_session(tmp_path / "s", scene, links))
    pipeline.feed_many([LinkEvent(name, 1, LinkState.OPEN) for name in ("skin", "tool")])
    pipeline.feed_many(list(chunks(EVERY[:4])))
    for row in range(3):
        pipeline.act(AtLandmark(row + 1, f"m{row}"), 10**10)
    pipeline.close()
    bench.open(OpenRequest(session=tmp_path / "s"))
    assert bench.snapshot.at_landmarks == {1: "m0", 2: "m1", 3: "m2"}
    said = []
    bench.window.session_view.said.connect(said.append)
    bench.key(Key.Key_K, SHIFT)
    bench.until(lambda: bench.snapshot.at_landmarks == {1: "m0", 2: "m1", 3: "m2", 4: "m3"}, 5000)
    assert bench.snapshot.can_undo == "poke 4 at m3"
    assert "1 poke is at landmarks now: 4 at m3" in said[-1].text
