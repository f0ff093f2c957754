"""Plays sounds and speaks words in a thread of its own; without a sound device the program is silent.

Words are spoken by the system: speech-dispatcher or eSpeak on Linux, `say` on macOS, System.Speech on Windows. No Qt.
"""

from __future__ import annotations

import logging
import queue
import shutil
import sys
import threading
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import subprocess

    from app.sound.cues import Cue

LOG = logging.getLogger(__name__)
AUDIO_PERIOD_MS = 10
BUFFERED_AUDIO_PERIODS = 4
"""The device buffers 40 ms: more would delay a sound, less would stutter while a picture is drawn."""
MAX_SOUND_DELAY_S = 0.3  # A later sound is not played: its cause is over
REOPEN_STUCK_DEVICE_AFTER_S = 1.0  # A device that has not read a sound for this long is opened again
DEVICE_CLOSE_TIMEOUT_S = 1.0  # Closing waits this long for the device

Stream = Generator[bytes, int, None]
"""Receives the number of wanted samples and yields at most as many; the device fills up with silence."""
_SPEECH_COMMANDS: Mapping[str, tuple[tuple[str, ...], ...]] = {
    "linux": (("spd-say", "--"), ("espeak-ng", "--"), ("espeak", "--")),
    "darwin": (("say", "--"),),
    "win32": (
        (
            "powershell",
            "-NoProfile",
            "-Command",
            "Add-Type -AssemblyName System.Speech;"
            "(New-Object System.Speech.Synthesis.SpeechSynthesizer).Speak([Console]::In.ReadToEnd())",
        ),
    ),
}
"""Commands that speak, the best first. The word is the last argument, on Windows the input, so it never runs as a command."""


def speech_command(platform: str = sys.platform) -> tuple[str, ...]:
    """Find the command that speaks on this system; empty if there is none."""
    return next((command for command in _SPEECH_COMMANDS.get(platform, ()) if shutil.which(command[0])), ())


class Speaker:
    """Speaks one word at a time by a command; a new word interrupts the one before."""

    def __init__(self, command: tuple[str, ...]) -> None:
        self._command = command
        self._voice: subprocess.Popen[bytes] | None = None

    def say(self, word: str) -> None:
        """Start to speak; `OSError` if the command cannot be run."""
        import subprocess  # delays the window by some milliseconds, so not at the start

        self.stop()
        by_input = self._command[0] == "powershell"
        self._voice = voice = subprocess.Popen(
            self._command if by_input else (*self._command, word),
            stdin=subprocess.PIPE if by_input else subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            # Windows would open a console.
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
        if voice.stdin is not None:
            voice.stdin.write(word.encode())
            voice.stdin.close()

    def stop(self) -> None:
        voice, self._voice = self._voice, None
        if voice is not None:
            voice.kill()
            # Without it the ended process would stay in the system's table.
            voice.wait()


class NoSoundError(Exception):
    """There is no sound device, or no library; the text gives the reason for the log."""


class Output(Protocol):
    """Sound device that reads a stream in a thread of its own."""

    def start(self, stream: Stream, /) -> None: ...

    def close(self) -> None: ...


def open_output(*, real: bool = True) -> Output:
    """Open the sound device of the desktop; if not `real`, a silent one that reads at the right pace.

    Raises
    ------
    NoSoundError
        There is no device, or the library is not installed.
    """
    from app.sound.cues import SAMPLE_RATE_HZ

    try:
        import miniaudio
    except (ImportError, OSError) as error:
        raise NoSoundError(f"the sound library cannot be loaded ({error})") from error
    kinds = miniaudio.Backend
    # Without the list it falls back to a silent device. JACK and ALSA print errors if they are missing.
    has_cards = not sys.platform.startswith("linux") or any(Path("/dev/snd").glob("pcmC*D*p"))
    unwanted = {kinds.NULL, kinds.CUSTOM, kinds.JACK} | (set() if has_cards else {kinds.ALSA})
    # The likeliest has the smallest number.
    found = sorted(miniaudio.get_enabled_backends() - unwanted, key=lambda each: each.value)
    try:
        return miniaudio.PlaybackDevice(
            miniaudio.SampleFormat.SIGNED16,
            nchannels=1,
            sample_rate=SAMPLE_RATE_HZ,
            buffersize_msec=AUDIO_PERIOD_MS,
            callback_periods=BUFFERED_AUDIO_PERIODS,
            backends=found if real else [kinds.NULL],
            app_name="skincal",
        )
    except miniaudio.MiniaudioError as error:
        raise NoSoundError(f"no sound device ({error.args[0]})") from error


@dataclass(slots=True)
class Line:
    """Samples of one sound on their way to the device, 16 bits each."""

    samples: bytes
    since_s: float = field(default_factory=time.monotonic)
    taken: int = 0
    """Bytes that the device has read."""

    def next_samples(self, frames: int) -> bytes:
        """Return the next samples of the sound; fewer at the end, then none."""
        part = self.samples[self.taken : self.taken + 2 * frames]
        self.taken += len(part)
        return part

    @property
    def is_stuck(self) -> bool:
        return not self.taken and bool(self.samples) and time.monotonic() - self.since_s > REOPEN_STUCK_DEVICE_AFTER_S


class Player:
    """Plays one sound at a time and speaks a word after it; no method waits.

    The device is opened once and stays open. After a failure the player is silent until `get_ready`.

    Parameters
    ----------
    opener : opens the device; may take time and raise anything
    speech : command that speaks; by default the system's, empty for none
    """

    def __init__(self, opener: Callable[[], Output] = open_output, speech: tuple[str, ...] | None = None) -> None:
        self.on = True  # The operator wants sounds
        self.speaks = False  # The operator wants words, too
        self.found: Callable[[bool], None] = lambda _there: None
        """Called in the player's thread if a device appears or disappears."""
        self._opener = opener
        self._speech = speech_command() if speech is None else speech
        self._orders: queue.SimpleQueue[tuple[Cue | None, str, float] | None] = queue.SimpleQueue()
        """Sound (`None`: only open the device), word, and time of the order in s; `None` ends the thread."""
        self._thread: threading.Thread | None = None
        self._closed = False
        self._is_there: bool | None = None
        self._output: Output | None = None
        self._line = Line(b"")

    @property
    def can_speak(self) -> bool:
        return bool(self._speech)

    def get_ready(self) -> None:
        """Open the device, so that the first sound is not late."""
        self.play(None)

    def play(self, sound: Cue | None, word: str = "") -> None:
        """Play a sound, then speak the word if speech is on; a new sound interrupts the one before. `None`: open the device."""
        if self._closed or not self.on:
            return
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="skincal-sound", daemon=True)
            self._thread.start()
        self._orders.put((sound, word, time.monotonic()))

    def close(self) -> None:
        """Close the device and end the thread."""
        self._closed = True
        thread, self._thread = self._thread, None
        if thread is not None:
            self._orders.put(None)
            thread.join(DEVICE_CLOSE_TIMEOUT_S)

    # In the thread

    def _run(self) -> None:
        speaker = Speaker(self._speech)
        while (order := self._orders.get()) is not None:
            sound, word, ordered_s = order
            if self._is_there is False and sound is not None:
                continue
            try:
                self._open()
                if sound is None or time.monotonic() - ordered_s > MAX_SOUND_DELAY_S:
                    continue
                from app.sound.cues import samples_of

                self._line = Line(samples_of(sound))
            except Exception as error:  # noqa: BLE001 - devices fail in many ways, and the program goes on without sound
                if self._is_there is not False:
                    LOG.info("nothing is heard: %s", error)
                self._close_device()
                self._report(there=False)
                continue
            if word and self.speaks and self._speech:
                try:
                    speaker.say(word)
                except OSError as error:
                    LOG.info("speech is off: %s", error)
                    self._speech = ()
        speaker.stop()
        self._close_device()

    def _open(self) -> None:
        if self._line.is_stuck:
            self._close_device()
        if self._output is None:
            self._output = self._opener()
            stream = self._stream()
            # A generator accepts values only after its first `yield`.
            next(stream)
            self._output.start(stream)
        self._report(there=True)

    def _stream(self) -> Stream:
        """Feed the device, in its own thread."""
        frames = yield b""
        while True:
            frames = yield self._line.next_samples(frames)

    def _close_device(self) -> None:
        output, self._output, self._line = self._output, None, Line(b"")
        if output is not None:
            with suppress(Exception):
                output.close()

    def _report(self, *, there: bool) -> None:
        if there is not self._is_there and not self._closed:
            self._is_there = there
            self.found(there)
