"""The process that reviews the rig beside the window: asked by what changes, never waited for, ended with the session."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from app.workers.processes import SKIN_POKES_PER_RIG_REVIEW, ReviewClient, WorkerProcess
from app.workers.threads import ThreadService
from skincal.contacts.outcome import Contact
from skincal.following.review import ReviewRequest, review_rig
from skincal.mesh.load import load_surface
from skincal.mesh.surface import Surface
from skincal.model.actions import AddLandmark, AtLandmark, Exclude, MarkDead, SetPose, Undo
from skincal.model.scene import Scene, load_scene, resource
from skincal.rig.correction import RIG, Correction, UsedCorrection
from skincal.session.corrections import correct_action
from skincal.session.session import Session
from skincal.simulation.contacts import poke_landmarks
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import Rig
from skincal.words.mistake_words import frame_sentence
from skincal.words.rig_words import rig_sentences
from tests.app.whole_window import OPEN_MS
from tests.app.workers.process_support import is_running
from tests.approved import approved
from tests.build import landmark_outcome


@pytest.fixture(scope="module")
def part() -> tuple[Scene, Surface]:
    scene = load_scene(resource("scenes/icub-forearm/scene.toml"))
    return scene, load_surface(scene.surface)[0]


@pytest.fixture
def session(part):
    """A session with pokes near three landmarks, of which none was named yet."""
    scene, surface = part
    rig, rng = Rig(scene, surface, RigErrors.paper(), np.random.default_rng(1)), np.random.default_rng(2)
    made = Session(scene, surface)
    for poke in poke_landmarks(rig, scene.landmarks, 3, rng)[:3]:
        made.add(landmark_outcome(poke))
    return made


@pytest.fixture
def processes():
    made = WorkerProcess()
    yield made
    made.close()


@pytest.fixture
def client(session, processes, qapp):
    made = ReviewClient(session, processes, qapp)
    yield made
    made.stop()
    made.deleteLater()


@pytest.fixture
def heard(client):
    """Reviews and sentences that came."""
    found = Heard()
    client.reviewed.connect(found.reviews.append)
    client.failed.connect(found.failures.append)
    return found


class Heard:
    def __init__(self):
        self.reviews, self.failures = [], []


def tell(session, client, *numbers):
    """Say that pokes were at the landmarks in turn, and show that to the client."""
    for number in numbers:
        session.act(AtLandmark(number, session.decisions.landmarks[number - 1].name))
        client.follow_session(session.snapshot())


def test_no_process_is_started_before_the_first_poke_at_a_landmark(qtbot, session, client, processes):
    client.follow_session(session.snapshot())
    qtbot.wait(50)
    assert processes.pid is None
    client.stop()
    client.follow_session(session.snapshot())
    tell(session, client, 1)
    qtbot.wait(50)
    assert processes.pid is None, "what was stopped stays so"


def test_it_answers_what_the_session_itself_finds_until_the_window_closes(qtbot, session, client, processes, heard):
    tell(session, client, 1, 2, 3)
    qtbot.waitUntil(lambda: bool(heard.reviews), timeout=OPEN_MS)
    qtbot.wait(200)
    (answer,) = heard.reviews
    assert answer.pokes.number.tolist() == [1, 2, 3], "of the newest alone"
    assert answer.used is session.snapshot().decisions.corrections
    own = review_rig(ReviewRequest.from_session(session))
    assert answer.reported == own.reported
    assert frame_sentence(answer.frame, has_arm=True) == frame_sentence(own.frame, has_arm=True)
    assert rig_sentences(answer.rig, has_arm=True) == rig_sentences(own.rig, has_arm=True)
    assert answer.rig.unknowns.tolist() == own.rig.unknowns.tolist()

    pid = processes.pid
    assert is_running(pid)
    client.stop()
    processes.close()
    assert not is_running(pid)
    tell(session, client, 1)
    qtbot.wait(50)
    assert heard.failures == []


def test_a_process_that_dies_is_replaced_and_told_all(qtbot, session, client, processes, heard):
    tell(session, client, 1)
    qtbot.waitUntil(lambda: bool(heard.reviews), timeout=OPEN_MS)
    os.kill(processes.pid, signal.SIGKILL)
    tell(session, client, 2, 3)
    qtbot.waitUntil(lambda: len(heard.reviews) > 1, timeout=OPEN_MS)
    assert heard.reviews[-1].pokes.number.tolist() == [1, 2, 3]
    assert heard.failures == []


def test_processes_that_die_again_and_again_are_said_once(qtbot, session, client, processes, heard):
    tell(session, client, 1)
    killed = set()

    def kill():
        if processes.pid not in (None, *killed):
            killed.add(processes.pid)
            os.kill(processes.pid, signal.SIGKILL)
        return bool(heard.failures)

    qtbot.waitUntil(kill, timeout=OPEN_MS)
    assert len(killed) == 2, "asked again once"
    assert approved("workers.review_process_gone", code=-9) in heard.failures[0]
    tell(session, client, 2, 3)
    qtbot.wait(100)
    assert len(heard.failures) == 1
    assert heard.reviews == []


def test_a_session_that_is_let_go_asks_and_hears_no_more_and_the_next_takes_its_process(qtbot, session, part, processes):
    client, heard = ReviewClient(session, processes), []
    client.reviewed.connect(heard.append)
    client.failed.connect(heard.append)
    tell(session, client, 1)
    qtbot.waitUntil(lambda: processes.pid is not None, timeout=OPEN_MS)
    with qtbot.waitSignal(client.destroyed, timeout=OPEN_MS):
        client.stop()
        client.deleteLater()
    other = Session(*part)
    other.add(session.outcome(1))
    following, reviews = ReviewClient(other, processes), []
    following.reviewed.connect(reviews.append)
    tell(other, following, 1)
    qtbot.waitUntil(lambda: bool(reviews), timeout=OPEN_MS)
    assert heard == []
    following.stop()


def test_a_fault_of_a_review_is_said_and_logged(qtbot, session, client, processes, heard, caplog, monkeypatch):
    def fault(*_arguments):
        raise ZeroDivisionError("ours")

    monkeypatch.setattr(processes, "ask", fault)
    tell(session, client, 1)
    qtbot.waitUntil(lambda: bool(heard.failures), timeout=5000)
    assert heard.failures == [approved("workers.review_failed", error="ZeroDivisionError('ours')")]
    assert "Traceback" in caplog.text


def test_a_mesh_that_changed_is_said_and_the_rest_is_silence(qtbot, session, client, heard):
    session.surface = SimpleNamespace(sha256="0" * 64, size=0.1)
    tell(session, client, 1)
    qtbot.waitUntil(lambda: bool(heard.failures), timeout=OPEN_MS)
    assert approved("mesh.changed_after_opening") in heard.failures[0]
    tell(session, client, 2)
    qtbot.wait(50)
    assert (len(heard.failures), heard.reviews) == (1, [])


@pytest.fixture
def asked(monkeypatch):
    """What a client asks, in order; each is answered at once with nothing, and no process is started."""
    changes = []
    monkeypatch.setattr(
        ThreadService, "submit", lambda _service, work, done, _failed: (changes.append(work.args[-1]), done(None))
    )
    return changes


def test_only_what_is_reviewed_is_asked_about(session, client, asked):
    tell(session, client, 1)
    client.follow_session(session.snapshot())
    session.act(SetPose("2"))
    client.follow_session(session.snapshot())
    assert len(asked) == 1, "where the arm stands tells nothing"
    tell(session, client, 2)
    session.act(AddLandmark("screw", 0.01, 0.02, 0.03))
    client.follow_session(session.snapshot())
    session.act(MarkDead(session.channels[0]))
    client.follow_session(session.snapshot())
    # A landmark poke that is reported again.
    session.add(replace(session.outcome(1), end_s=9.0))
    client.follow_session(session.snapshot())
    assert [len(request.landmarks) for request in asked] == [1, 2, 2, 2, 2]
    session.act(correct_action(UsedCorrection(RIG, Correction(1.01 * np.eye(6)), 0.01, 0.001, 6)))
    client.follow_session(session.snapshot())
    assert [RIG in request.used for request in asked] == [False] * 5 + [True]


def on_skin(session, number: int) -> Contact:
    """A poke that a taxel answered."""
    first, channel = session.outcome(1), session.channels[0]
    return Contact(
        number, 0.0, 0.3, first.force, first.moment, np.array([channel]), np.array([50.0]), first.link_from_sensor, first.pose,
        float("nan"), False,
    )  # fmt: skip


def test_pokes_on_the_skin_are_sent_by_tens_and_one_that_is_taken_out_at_once(session, client, asked):
    tell(session, client, 1)
    for number in range(11, 11 + SKIN_POKES_PER_RIG_REVIEW):
        assert len(asked) == 1, number
        session.add(on_skin(session, number))
        client.follow_session(session.snapshot())
    assert [poke.poke for poke in asked[-1].contacts] == list(range(11, 11 + SKIN_POKES_PER_RIG_REVIEW))
    session.add(replace(on_skin(session, 11), final=True))
    client.follow_session(session.snapshot())
    assert len(asked) == 2, "with the tare after it, it tells nearly the same"
    session.act(Exclude(12))
    client.follow_session(session.snapshot())
    assert (len(asked), len(asked[-1].contacts)) == (3, SKIN_POKES_PER_RIG_REVIEW - 1)
    session.act(Undo())
    client.follow_session(session.snapshot())
    assert (len(asked), len(asked[-1].contacts)) == (4, SKIN_POKES_PER_RIG_REVIEW)


def test_one_review_at_a_time_and_the_newest_next(session, client, processes, heard, monkeypatch):
    waiting, tickets = [], []
    monkeypatch.setattr(ThreadService, "submit", lambda _service, work, done, _failed: waiting.append((work.args, done)))
    next_id = processes.next_id
    monkeypatch.setattr(processes, "next_id", lambda: tickets.append(next_id()) or tickets[-1])
    tell(session, client, 1, 2, 3)
    ((arguments, done),) = waiting
    assert arguments[0] < tickets[-1], "the work gives way"
    done(None)
    (_, (newest, finish)) = waiting
    assert newest[0] == tickets[-1]
    assert newest[-1].landmarks.number.tolist() == [1, 2, 3]
    finish(None)
    assert len(waiting) == 2
    assert heard.reviews == []


def test_a_review_that_took_long_is_passed_on_although_newer_was_asked(session, client, heard, monkeypatch):
    waiting = []
    monkeypatch.setattr(ThreadService, "submit", lambda _service, work, done, _failed: waiting.append((work.args, done)))
    tell(session, client, 1)
    used = session.snapshot().decisions.corrections
    session.act(correct_action(UsedCorrection(RIG, Correction(1.01 * np.eye(6)), 0.01, 0.001, 6)))
    tell(session, client, 2)
    waiting[0][1](review_rig(waiting[0][0][-1]))
    (review,) = heard.reviews
    assert review.used is used, "as of when it was asked"
    assert len(waiting) == 2
    assert RIG in waiting[1][0][-1].used
