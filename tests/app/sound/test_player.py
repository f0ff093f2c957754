"""The player never waits, plays what is due, and survives whatever a sound device does."""

from __future__ import annotations

import logging
import sys
import threading
import time

import pytest

from app.sound import player as sound_player
from app.sound.cues import SAMPLE_RATE_HZ, Cue, samples_of
from app.sound.player import Line, NoSoundError, Player, Speaker, open_output, speech_command
from tests.approved import approved

WAIT_S = 10.0  # Limit for what takes milliseconds on a quiet machine


class Tape:
    """Sound device that records what it reads; the test reads a period by `run`."""

    def __init__(self, fault: Exception | None = None) -> None:
        self.stream = None
        self.heard = b""
        self.calls: list[str] = []
        self.fault = fault

    def start(self, stream) -> None:
        self.calls.append("start")
        if self.fault is not None:
            raise self.fault
        self.stream = stream

    def close(self) -> None:
        self.calls.append("close")

    def run(self, frames: int = 480) -> bytes:
        part = self.stream.send(frames)
        self.heard += part
        return part


class Shop:
    """Opens one device after another; `None` and the end of the list are no device."""

    def __init__(self, *devices: Tape | None) -> None:
        self.devices = list(devices)
        self.opened = 0

    def __call__(self) -> Tape:
        self.opened += 1
        device = self.devices.pop(0) if self.devices else None
        if device is None:
            raise NoSoundError("no sound device (gone)")
        return device


def until(condition) -> None:
    end = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end, "that took too long"
        time.sleep(0.002)


def threads() -> list[threading.Thread]:
    return [t for t in threading.enumerate() if t.name == "skincal-sound"]


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
    assert not threads()


def test_a_sound_reaches_the_device_whole_and_a_new_one_interrupts_it(make):
    tape = Tape()
    player = make(Shop(tape))
    player.play(Cue.ACCEPTED)
    until(lambda: tape.stream is not None and tape.run())
    while tape.run():
        pass
    assert tape.heard == samples_of(Cue.ACCEPTED)
    player.play(Cue.DONE)
    until(lambda: tape.run() == samples_of(Cue.DONE)[:960])
    player.play(Cue.REJECTED)
    until(lambda: tape.run() == samples_of(Cue.REJECTED)[:960])
    assert tape.calls == ["start"]
    assert player.reported == [True]


def test_no_method_waits_for_the_device_and_a_late_sound_is_dropped(make, monkeypatch):
    monkeypatch.setattr(sound_player, "MAX_SOUND_DELAY_S", 0.05)
    monkeypatch.setattr(sound_player, "DEVICE_CLOSE_TIMEOUT_S", 0.1)
    tape, free = Tape(), threading.Event()
    player = make(lambda: free.wait() and tape)
    for _ in range(3):
        player.play(Cue.CONTACT)
    player.close()
    time.sleep(0.06)
    free.set()
    until(lambda: not threads())
    assert tape.calls == ["start", "close"]
    assert tape.run() == b""
    assert player.reported == []


def test_without_a_device_it_is_silent_until_it_is_asked_to_get_ready(make, caplog):
    caplog.set_level(logging.INFO)
    tape = Tape()
    shop = Shop(None, None, tape)
    player = make(shop)
    for _ in range(5):
        player.play(Cue.CONTACT)
    until(lambda: player.reported == [False])
    player.get_ready()
    until(lambda: shop.opened == 2)
    player.get_ready()
    until(lambda: player.reported == [False, True])
    player.play(Cue.CONTACT)
    until(lambda: tape.run())
    messages = [(record.getMessage(), record.levelno) for record in caplog.records]
    assert messages == [(approved("sound.nothing_heard", reason="no sound device (gone)"), logging.INFO)]


def test_a_library_that_cannot_be_imported_is_no_error(make, monkeypatch, caplog):
    caplog.set_level(logging.INFO)
    monkeypatch.setitem(sys.modules, "miniaudio", None)
    player = make(open_output)
    player.play(Cue.CONTACT)
    until(lambda: player.reported == [False])
    assert approved("sound.no_library") in caplog.text


@pytest.mark.parametrize("second", [Tape(), Tape(RuntimeError("the plug is out"))], ids=["another", "none"])
def test_a_device_that_reads_nothing_is_opened_again(make, monkeypatch, second):
    monkeypatch.setattr(sound_player, "REOPEN_STUCK_DEVICE_AFTER_S", 0.05)
    first = Tape()
    player = make(Shop(first, second))
    player.play(Cue.CONTACT)
    until(lambda: player.reported == [True])
    until(lambda: player._line.is_stuck)
    player.play(Cue.DONE)
    until(lambda: "start" in second.calls)
    assert first.calls == ["start", "close"]
    if second.fault is None:
        until(lambda: second.run() == samples_of(Cue.DONE)[:960])
    else:
        until(lambda: player.reported == [True, False])
        assert second.calls == ["start", "close"]


def test_sounds_that_are_off_open_nothing(make):
    shop = Shop(Tape())
    player = make(shop)
    player.on = False
    player.get_ready()
    player.play(Cue.CONTACT)
    assert not threads()
    assert shop.opened == 0


def test_the_library_reads_the_samples_as_they_are(make, monkeypatch):
    miniaudio = pytest.importorskip("miniaudio")
    output = open_output(real=False)
    assert (output.sample_rate, output.nchannels, output.sample_width) == (SAMPLE_RATE_HZ, 1, 2)
    assert output.backend == miniaudio.Backend.NULL.name.title()
    output.close()
    taken: list[bytes] = []
    take = Line.next_samples
    monkeypatch.setattr(Line, "next_samples", lambda line, frames: taken.append(take(line, frames)) or taken[-1])
    player = make(lambda: open_output(real=False))
    for each in (Cue.ACCEPTED, Cue.LOST):
        taken.clear()
        player.play(each)
        until(lambda each=each: b"".join(taken) == samples_of(each))
    player.close()
    count = len(taken)
    time.sleep(0.1)
    assert len(taken) == count


def test_a_word_is_spoken_after_the_sound_if_speech_is_on(make, tmp_path):
    tape, path = Tape(), tmp_path / "said"
    code = "import sys, time, pathlib; pathlib.Path(sys.argv[1]).write_text(sys.argv[2]); time.sleep(60)"
    player = make(Shop(tape), speech=(sys.executable, "-c", code, str(path)))
    player.play(Cue.REJECTED, "slid")
    until(lambda: tape.stream is not None and tape.run())
    assert not path.exists()
    player.speaks = True
    for word in ("too soft", "too hard"):
        player.play(Cue.REJECTED, word)
        until(lambda word=word: path.exists() and path.read_text() == word)
    player.close()


def test_a_speech_command_that_cannot_be_run_is_no_error(make, tmp_path):
    player = make(Shop(Tape()), speech=(str(tmp_path / "nothing"),))
    player.speaks = True
    for _ in range(2):
        player.play(Cue.REJECTED, "slid")
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
