"""The player: it never waits, it plays what is due, and nothing that a sound device may do to it disturbs anybody."""

from __future__ import annotations

import logging
import sys
import threading
import time

import numpy as np
import pytest

from app.sound import player as sound_player
from app.sound.cues import RATE, Cue, samples_of
from app.sound.player import NoSoundError, Player, Speaker, open_output, speech_command
from tests.approved import approved

WAIT_S = 5.0
"""s. What takes milliseconds is waited for so long, on a busy machine."""


class Tape:
    """A sound device that writes down what it is given, as fast as it is read from."""

    def __init__(self, *, deaf: bool = False) -> None:
        self.stream = None
        self.heard = b""
        self.calls: list[str] = []
        self.deaf = deaf
        self.fault: Exception | None = None

    def start(self, stream) -> None:
        self.calls.append("start")
        if self.fault is not None:
            raise self.fault
        self.stream = stream

    def stop(self) -> None:
        self.calls.append("stop")

    def close(self) -> None:
        self.calls.append("close")

    def run(self, frames: int = 480) -> bytes:
        """Take one period, as the device's own thread would."""
        part = b"" if self.deaf else self.stream.send(frames)
        self.heard += part
        return part


class Shop:
    """Opens one device after another; None is none."""

    def __init__(self, *devices: Tape | None) -> None:
        self.devices = list(devices)
        self.opened = 0

    def __call__(self) -> Tape:
        self.opened += 1
        device = self.devices.pop(0) if self.devices else None
        if device is None:
            raise NoSoundError("no sound device (gone)")
        return device


def until(what) -> None:
    end = time.monotonic() + WAIT_S
    while not what():
        assert time.monotonic() < end, "that took too long"
        time.sleep(0.002)


@pytest.fixture
def make():
    made: list[Player] = []

    def player(opener, **options) -> Player:
        made.append(Player(opener, **{"speech": ()} | options))
        made[-1].reported = []
        made[-1].found = made[-1].reported.append
        return made[-1]

    yield player
    for each in made:
        each.close()
    assert not [t for t in threading.enumerate() if t.name == "skincal-sound"]


def test_a_sound_reaches_the_device_whole_and_then_there_is_silence(make):
    tape = Tape()
    player = make(Shop(tape))
    player.play(Cue.ACCEPTED)
    until(lambda: tape.stream is not None)
    sizes = {len(tape.run()) for _ in range(15)}
    assert tape.heard == samples_of(Cue.ACCEPTED)
    assert 0 in sizes
    assert 960 in sizes
    player.play(Cue.DONE)
    until(lambda: tape.run())
    for _ in range(15):
        tape.run()
    assert tape.heard == samples_of(Cue.ACCEPTED) + samples_of(Cue.DONE)
    assert tape.calls == ["start"]
    assert player.reported == [True]


def test_a_new_sound_cuts_off_the_one_before(make):
    tape = Tape()
    player = make(Shop(tape))
    player.play(Cue.DONE)
    until(lambda: tape.stream is not None)
    assert tape.run() == samples_of(Cue.DONE)[:960]
    player.play(Cue.REJECTED)
    until(lambda: tape.run() == samples_of(Cue.REJECTED)[:960])


def test_asking_for_a_sound_takes_no_time_whatever_the_device_does(make):
    free = threading.Event()

    def slow() -> Tape:
        free.wait(WAIT_S)
        return Tape()

    player = make(slow)
    times = []
    for _ in range(200):
        begin = time.perf_counter()
        player.play(Cue.CONTACT)
        times.append(time.perf_counter() - begin)
    free.set()
    assert np.median(times) < 1e-3
    assert sum(taken > 5e-3 for taken in times) < 5, "a busy machine may pause any of them"


def test_what_waited_too_long_for_the_device_is_not_played(make, monkeypatch):
    monkeypatch.setattr(sound_player, "LATE_S", 0.05)
    tape, free = Tape(), threading.Event()

    def slow() -> Tape:
        free.wait(WAIT_S)
        return tape

    player = make(slow)
    player.play(Cue.REJECTED)
    time.sleep(0.1)
    free.set()
    until(lambda: player.reported == [True])
    assert tape.calls == []


def test_the_device_runs_only_while_sounds_come(make, monkeypatch):
    monkeypatch.setattr(sound_player, "LINGER_S", 0.1)
    tape = Tape()
    player = make(Shop(tape))
    player.get_ready()
    until(lambda: player.reported == [True])
    assert tape.calls == []
    player.play(Cue.CONTACT)
    until(lambda: tape.calls == ["start", "stop"])
    player.play(Cue.CONTACT)
    until(lambda: tape.calls == ["start", "stop"] * 2)
    player.close()
    assert tape.calls[-1] == "close"


def test_no_device_is_no_error_is_logged_once_and_is_looked_for_again_later(make, monkeypatch, caplog):
    caplog.set_level(logging.INFO)
    tape = Tape()
    shop = Shop(None, None, tape)
    player = make(shop)
    for _ in range(5):
        player.play(Cue.CONTACT)
    until(lambda: player.reported == [False])
    time.sleep(0.05)
    assert shop.opened == 1
    monkeypatch.setattr(sound_player, "RETRY_S", 0.0)
    player._retry_s = 0.0
    player.play(Cue.CONTACT)
    until(lambda: shop.opened == 2)
    assert player.reported == [False]
    player.play(Cue.CONTACT)
    until(lambda: player.reported == [False, True])
    until(lambda: tape.run())
    assert [r.getMessage() for r in caplog.records] == [approved("sound.nothing_heard", reason="no sound device (gone)")]
    assert max(r.levelno for r in caplog.records) == logging.INFO


def test_a_library_that_cannot_be_imported_is_no_error(make, monkeypatch, caplog):
    caplog.set_level(logging.INFO)
    monkeypatch.setitem(sys.modules, "miniaudio", None)
    player = make(open_output)
    player.play(Cue.CONTACT)
    until(lambda: player.reported == [False])
    assert approved("sound.no_library") in caplog.text


def test_a_device_that_vanished_gives_way_to_the_next(make, monkeypatch):
    monkeypatch.setattr(sound_player, "LINGER_S", 0.05)
    first, second = Tape(), Tape()
    player = make(Shop(first, second))
    player.play(Cue.CONTACT)
    until(lambda: "stop" in first.calls)
    first.fault = RuntimeError("the plug is out")
    player.play(Cue.DONE)
    until(lambda: second.stream is not None)
    assert second.run() == samples_of(Cue.DONE)[:960]
    assert first.calls[-1] == "close"
    assert False not in player.reported


def test_a_device_that_takes_nothing_any_more_is_given_up(make, monkeypatch):
    monkeypatch.setattr(sound_player, "GONE_S", 0.05)
    first, second = Tape(deaf=True), Tape()
    player = make(Shop(first, second))
    player.play(Cue.CONTACT)
    until(lambda: first.stream is not None)
    time.sleep(0.1)
    player.play(Cue.DONE)
    until(lambda: second.stream is not None)
    assert first.calls == ["start", "close"]


def test_a_device_that_vanished_for_good_leaves_silence(make):
    first = Tape()
    first.fault = RuntimeError("the plug is out")
    player = make(Shop(first))
    player.play(Cue.CONTACT)
    until(lambda: player.reported == [False])
    assert first.calls == ["start", "close"]


def test_sounds_that_are_off_open_nothing(make):
    shop = Shop(Tape())
    player = make(shop)
    player.on = False
    player.get_ready()
    player.play(Cue.CONTACT)
    time.sleep(0.02)
    assert shop.opened == 0
    assert not [t for t in threading.enumerate() if t.name == "skincal-sound"]


def test_closing_does_not_wait_for_a_device_that_hangs(make, monkeypatch):
    monkeypatch.setattr(sound_player, "STOP_S", 0.1)
    free = threading.Event()

    def hangs() -> Tape:
        free.wait(WAIT_S)
        return Tape()

    player = make(hangs)
    player.play(Cue.CONTACT)
    begin = time.monotonic()
    player.close()
    assert time.monotonic() - begin < 1.0
    player.play(Cue.CONTACT)
    free.set()
    until(lambda: not [t for t in threading.enumerate() if t.name == "skincal-sound"])
    assert player.reported == []


def test_the_library_takes_the_samples_at_their_pace(make, monkeypatch):
    """With the library's own device that nobody hears."""
    pytest.importorskip("miniaudio")
    taken: list[tuple[float, int]] = []
    take = sound_player.Line.take

    def watched(line: sound_player.Line, frames: int) -> bytes:
        part = take(line, frames)
        taken.append((time.monotonic(), len(part)))
        return part

    monkeypatch.setattr(sound_player.Line, "take", watched)
    player = make(lambda: open_output(real=False))
    player.get_ready()
    until(lambda: player.reported == [True])
    assert not taken
    for each in (Cue.ACCEPTED, Cue.LOST):
        taken.clear()
        player.play(each)
        until(lambda each=each: sum(n for _, n in taken) == len(samples_of(each)))
        until(lambda: taken[-1][1] == 0)
    begin, count = taken[0][0], len(taken)
    time.sleep(0.5)
    pace = (len(taken) - count) * sound_player.PERIOD_MS * 1e-3 / 0.5
    assert 0.5 < pace < 1.5, f"after {taken[-1][0] - begin:.3f} s"
    player.close()
    count = len(taken)
    time.sleep(0.1)
    assert len(taken) == count


def test_samples_are_what_the_device_is_opened_for():
    assert {s: len(samples_of(s)) % 2 for s in Cue} == dict.fromkeys(Cue, 0)
    miniaudio = pytest.importorskip("miniaudio")
    output = open_output(real=False)
    assert (output.sample_rate, output.nchannels, output.sample_width) == (RATE, 1, 2)
    assert output.backend == miniaudio.Backend.NULL.name.title()
    output.close()


def spoken(path, **options):
    """A speech command that writes down its word."""
    code = "import sys, time, pathlib; pathlib.Path(sys.argv[1]).write_text(sys.argv[2]); time.sleep(60)"
    return {"speech": (sys.executable, "-c", code, str(path))} | options


def test_a_word_is_said_after_the_sound_where_that_is_wanted(make, tmp_path):
    tape, path = Tape(), tmp_path / "said"
    player = make(Shop(tape), **spoken(path))
    player.play(Cue.REJECTED, "slid")
    until(lambda: tape.stream is not None)
    time.sleep(0.05)
    assert not path.exists()
    player.speaks = True
    taken = []
    for _ in range(5):
        begin = time.perf_counter()
        player.play(Cue.REJECTED, "too soft")
        taken.append(time.perf_counter() - begin)
    assert min(taken) < 0.02, "a busy machine may pause any of them"
    until(lambda: path.exists() and path.read_text() == "too soft")
    player.play(Cue.REJECTED, "too hard")
    until(lambda: path.read_text() == "too hard")
    player.close()


def test_a_speech_command_that_cannot_be_run_is_no_error(make, tmp_path):
    tape = Tape()
    player = make(Shop(tape), speech=(str(tmp_path / "nothing"),))
    player.speaks = True
    for _ in range(2):
        player.play(Cue.REJECTED, "slid")
    until(lambda: tape.stream is not None)
    until(lambda: not player.can_speak)
    assert player.reported == [True]


def test_each_system_has_its_voice(monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: None if name == "spd-say" else f"/bin/{name}")
    assert speech_command("linux") == ("espeak-ng", "--")
    assert speech_command("darwin") == ("say", "--")
    assert speech_command("win32")[0] == "powershell"
    assert speech_command("freebsd13") == ()
    monkeypatch.setattr("shutil.which", lambda _: None)
    assert speech_command("linux") == ()
    Speaker(()).stop()
