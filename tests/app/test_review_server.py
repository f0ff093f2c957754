"""The process that reviews the rig beside the window: asked by what changes, never waited for, ended with the session."""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import replace

import numpy as np
import pytest
from PySide6.QtCore import QProcess
from whole_window import OPEN_MS

from app.review_server import SKIN, ReviewServer
from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.model.scene import Scene, load_scene, resource
from skincal.rig.correction import RIG, Correction
from skincal.session.actions import AddLandmark, AtLandmark, Exclude, MarkDead, SetPose, Undo
from skincal.session.corrections import correct_action
from skincal.session.review import Asked, Reviewer
from skincal.session.session import Session
from skincal.simulate.contacts import poke_landmarks
from skincal.simulate.rig import Rig, RigErrors
from skincal.surface.mesh import Surface, load_surface


@pytest.fixture(scope="module")
def part() -> tuple[Scene, Surface]:
    scene = load_scene(resource("scenes/icub-forearm/scene.toml"))
    return scene, load_surface(scene.surface)[0]


@pytest.fixture
def session(part):
    """A session with pokes near three landmarks, of which none was told yet."""
    scene, surface = part
    rig, rng = Rig(scene, surface, RigErrors.paper(), np.random.default_rng(1)), np.random.default_rng(2)
    made = Session(scene, surface)
    nobody = np.empty(0, dtype=np.int64)
    for poke in poke_landmarks(rig, scene.landmarks, 3, rng)[:3]:
        made.add(
            Rejection(
                poke.poke, 0.0, 0.3, Reason.NO_TAXEL, 0.0, 1.0, "", nobody, True, poke.force, poke.moment,
                poke.link_from_sensor, poke.pose,
            )
        )  # fmt: skip
    return made


@pytest.fixture
def server(session, qapp):
    made = ReviewServer(session, qapp)
    yield made
    made.stop()
    made.deleteLater()


def tell(session, server, *numbers):
    """Say that pokes were at the landmarks in turn, and show that to the server."""
    for number in numbers:
        session.act(AtLandmark(number, session.landmarks[number - 1].name))
        server.follow(session.snapshot())


def alive(server) -> bool:
    return server._process.state() is not QProcess.ProcessState.NotRunning


def test_it_is_not_started_before_the_first_poke_at_a_landmark(session, server):
    server.follow(session.snapshot())
    assert not alive(server)
    server.stop()
    server.follow(session.snapshot())
    tell(session, server, 1)
    assert not alive(server), "what was stopped stays so"


def test_it_answers_what_the_session_itself_finds_and_ends_when_it_is_told(qtbot, session, server):
    answers = []
    server.reviewed.connect(answers.append)
    failed = []
    server.failed.connect(failed.append)
    tell(session, server, 1, 2, 3)
    qtbot.waitUntil(lambda: bool(answers), timeout=OPEN_MS)
    qtbot.wait(200)
    (answer,) = answers
    assert [one.poke for one in answer.pokes] == [1, 2, 3], "of the newest alone"
    reviewer = Reviewer(session.scene, session.surface)
    reviewer.take(Asked().change(session, session.snapshot()))
    own = reviewer.review(lambda: None)
    assert answer.told == own.told
    assert answer.frame.words == own.frame.words
    assert answer.rig.sentences == own.rig.sentences

    process = server._process.processId()
    server.stop()
    assert not alive(server)
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)
    tell(session, server, 1)
    assert not alive(server)
    assert failed == []


def test_a_process_that_dies_is_said_once(qtbot, session, server):
    failed, answers = [], []
    server.failed.connect(failed.append)
    server.reviewed.connect(answers.append)
    tell(session, server, 1)
    qtbot.waitUntil(lambda: bool(answers), timeout=OPEN_MS)
    os.kill(server._process.processId(), signal.SIGKILL)
    qtbot.waitUntil(lambda: bool(failed), timeout=OPEN_MS)
    assert "What reviews the rig ended" in failed[0]
    tell(session, server, 2, 3)
    qtbot.wait(100)
    server.stop()
    assert len(failed) == 1
    assert len(answers) == 1


def test_a_session_that_is_let_go_takes_its_process_along(qtbot, session):
    server = ReviewServer(session)
    failed = []
    server.failed.connect(failed.append)
    tell(session, server, 1)
    process = server._process.processId()
    assert process
    with qtbot.waitSignal(server.destroyed, timeout=OPEN_MS):
        server.release()
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)
    assert failed == []


class Told(list):
    """Stands in for the process's input."""

    def __call__(self, message):
        self.append(message)


@pytest.fixture
def asked(server, monkeypatch):
    """What a server asks, in order; nothing is started."""
    told = Told()
    monkeypatch.setattr(server, "_start", lambda: setattr(server, "_started", True))
    monkeypatch.setattr(server, "_tell", told)
    return told


def test_only_what_is_reviewed_is_asked_about(session, server, asked):
    tell(session, server, 1)
    assert [one.generation for one in asked] == [1]
    server.follow(session.snapshot())
    session.set_current_pose("2", np.eye(4))
    server.follow(session.snapshot())
    session.act(SetPose("2"))
    server.follow(session.snapshot())
    assert len(asked) == 1, "where the arm stands tells nothing"
    tell(session, server, 2)
    session.act(AddLandmark("screw", 0.01, 0.02, 0.03))
    server.follow(session.snapshot())
    session.act(MarkDead(session.channels[0]))
    server.follow(session.snapshot())
    session.add(replace(session.outcome(1), end_s=9.0))
    server.follow(session.snapshot())
    assert [one.generation for one in asked] == [1, 2, 3, 4, 5]
    assert list(asked[-1].pokes) == [1], "a landmark poke that is told again"
    session.act(correct_action(RIG, Correction(1.01 * np.eye(6)), 0.01, 0.001, 6))
    server.follow(session.snapshot())
    assert len(asked) == 6
    assert asked[-1].corrected


def on_skin(session, number: int) -> Contact:
    """A poke that a taxel answered."""
    told, channel = session.outcome(1), session.channels[0]
    return Contact(
        number, 0.0, 0.3, told.force, told.moment, np.array([channel]), np.array([50.0]), told.link_from_sensor, told.pose,
        float("nan"), False,
    )  # fmt: skip


def test_pokes_on_the_skin_are_told_by_tens_and_one_that_is_taken_out_at_once(session, server, asked):
    tell(session, server, 1)
    for number in range(11, 11 + SKIN):
        assert len(asked) == 1, number
        session.add(on_skin(session, number))
        server.follow(session.snapshot())
    assert list(asked[-1].pokes) == list(range(11, 11 + SKIN))
    session.add(replace(on_skin(session, 11), final=True))
    server.follow(session.snapshot())
    assert len(asked) == 2, "with the tare after it, it tells nearly the same"
    session.act(Exclude(12))
    server.follow(session.snapshot())
    assert (len(asked), asked[-1].gone, list(asked[-1].pokes)) == (3, (12,), [11])
    session.act(Undo())
    server.follow(session.snapshot())
    assert (len(asked), list(asked[-1].pokes)) == (4, [12])


def test_an_answer_to_what_was_asked_before_is_not_passed_on(session, server, asked, monkeypatch):
    answers = []
    server.reviewed.connect(answers.append)
    reviewer = Reviewer(session.scene, session.surface)
    found = []
    for number in (1, 2):
        tell(session, server, number)
        reviewer.take(asked[-1])
        found.append(reviewer.review(lambda: None))
    monkeypatch.setattr(server._unpacker, "feed", lambda _data: iter(found))
    server._read()
    assert [one.generation for one in answers] == [2]


def test_a_sentence_in_place_of_an_answer_is_said_and_the_rest_is_silence(session, server, asked, monkeypatch):
    failed, answers = [], []
    server.failed.connect(failed.append)
    server.reviewed.connect(answers.append)
    tell(session, server, 1)
    monkeypatch.setattr(server._unpacker, "feed", lambda _data: iter(["The mesh changed."]))
    server._read()
    server._finished()
    tell(session, server, 2)
    assert failed == ["The mesh changed."]
    assert len(asked) == 1
    assert answers == []


def test_a_program_that_cannot_be_started_is_said(qtbot, session, server, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/there-is-no-such-program")
    with qtbot.waitSignal(server.failed, timeout=OPEN_MS) as failed:
        tell(session, server, 1)
    assert "What reviews the rig cannot be started" in failed.args[0]
    assert not alive(server)
