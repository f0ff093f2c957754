"""Plays sounds and says words beside the window: nobody waits for one, and a machine without a sound device is merely silent.

A word is said by the system's own voice: speech-dispatcher or eSpeak on Linux, `say` on macOS, System.Speech on Windows.

One thread owns the device. It is opened once a session is, runs while sounds come, and rests after `LINGER_S`, so that nothing
wakes the processor while nobody pokes. It is not started anew for each sound: a desktop's sound server sends a device to sleep
after some five seconds, and a sound that wakes it is late. No Qt.
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
PERIOD_MS = 10
PERIODS = 4
"""The device holds so much that is not heard yet: 40 ms. More would be late, less would stutter while a picture is drawn."""
LINGER_S = 10.0
"""s. The device runs on for so long after a sound: from one poke to the next."""
LATE_S = 0.3
"""s. A sound that would come later than this, because the device was slow to open, would be of something that is over."""
GONE_S = 1.0
"""s. A device that has not taken up a sound by then is gone, whatever it says of itself."""
RETRY_S = 10.0
"""s. Where there is no device, it is looked for again so often, when a sound is due."""
STOP_S = 1.0
"""s. Closing waits this long for the device; its thread is a daemon and dies with the process."""

Stream = Generator[bytes, int, None]
"""Is sent how many samples the device wants, and gives them, or fewer: the rest is silence."""
_SYSTEM: Mapping[str, tuple[tuple[str, ...], ...]] = {
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
"""Commands that speak, the best first. The word is their last argument, on Windows their input: no word is ever a command."""


def speech_command(platform: str = sys.platform) -> tuple[str, ...]:
    """Return the command that speaks on this system; empty where it has none."""
    return next((command for command in _SYSTEM.get(platform, ()) if shutil.which(command[0])), ())


class Speaker:
    """Says one word at a time by a command; the next cuts off the one before."""

    def __init__(self, command: tuple[str, ...]) -> None:
        self._command = command
        self._voice: subprocess.Popen[bytes] | None = None

    def say(self, word: str) -> None:
        """Begin to say a word; does not wait for its end.

        Raises
        ------
        OSError
            The command cannot be run.
        """
        import subprocess  # only here: the window is on the screen some milliseconds earlier

        self.stop()
        by_input = self._command[0] == "powershell"
        self._voice = voice = subprocess.Popen(
            self._command if by_input else (*self._command, word),
            stdin=subprocess.PIPE if by_input else subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            # Windows would open a console for it.
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
        if voice.stdin is not None:
            voice.stdin.write(word.encode())
            voice.stdin.close()

    def stop(self) -> None:
        """Say no more."""
        voice, self._voice = self._voice, None
        if voice is not None:
            voice.kill()
            # Waited for, or the ended process would stay in the system's table.
            voice.wait()


class NoSoundError(Exception):
    """There is nothing to play on; the text says why, for the log."""


class Output(Protocol):
    """What plays a stream that was begun, in a thread of its own; it may be started again after a stop."""

    def start(self, stream: Stream, /) -> None:
        """Begin to play."""

    def stop(self) -> None:
        """Fall silent."""

    def close(self) -> None:
        """Let the device go."""


def open_output(*, real: bool = True) -> Output:
    """Open the sound device that the desktop uses; where not `real`, one that takes samples at the right pace, unheard.

    Raises
    ------
    NoSoundError
        There is none, or the library is not installed.
    """
    from app.sound.cues import RATE

    try:
        import miniaudio
    except (ImportError, OSError) as error:
        raise NoSoundError(f"the sound library cannot be loaded ({error})") from error
    kinds = miniaudio.Backend
    # Listed, or it would fall back to a device that nobody hears. JACK and ALSA fill stderr to say that they are not there.
    unwanted = {kinds.NULL, kinds.CUSTOM, kinds.JACK} | (set() if _has_cards() else {kinds.ALSA})
    # By their number the likeliest comes first.
    found = sorted(miniaudio.get_enabled_backends() - unwanted, key=lambda each: each.value)
    try:
        return miniaudio.PlaybackDevice(
            miniaudio.SampleFormat.SIGNED16,
            nchannels=1,
            sample_rate=RATE,
            buffersize_msec=PERIOD_MS,
            callback_periods=PERIODS,
            backends=found if real else [kinds.NULL],
            app_name="skincal",
        )
    except miniaudio.MiniaudioError as error:
        raise NoSoundError(f"no sound device ({error.args[0]})") from error


def _has_cards() -> bool:
    """Return whether there may be a sound card: on Linux those are listed."""
    return not sys.platform.startswith("linux") or any(Path("/dev/snd").glob("pcmC*D*p"))


@dataclass(slots=True)
class Line:
    """One sound on its way into the device, 16 bits a sample."""

    samples: bytes
    since_s: float = field(default_factory=time.monotonic)
    taken: int = 0
    """Bytes that the device has."""

    def take(self, frames: int) -> bytes:
        """Return the next samples; fewer at the end, then none."""
        part = self.samples[self.taken : self.taken + 2 * frames]
        self.taken += len(part)
        return part

    @property
    def stuck(self) -> bool:
        """The device should have begun long ago."""
        return not self.taken and bool(self.samples) and time.monotonic() - self.since_s > GONE_S


class _Outlet:
    """The device as its thread sees it: there or not, running or at rest."""

    def __init__(self, opener: Callable[[], Output]) -> None:
        self._open = opener
        self._output: Output | None = None
        self._line = Line(b"")
        self.running = False

    def ready(self) -> None:
        """Open the device unless it is open."""
        if self._output is None:
            self._output = self._open()

    def play(self, samples: bytes) -> None:
        """Play a sound; it cuts off the one before. A device that vanished is opened anew, once."""
        if self._line.stuck:
            self.close()
        self._line = Line(samples)
        try:
            self._start()
        except NoSoundError:
            raise
        except Exception as error:  # noqa: BLE001 - a device that vanished says so in many ways
            LOG.info("the sound device stopped: %s", error)
            self.close()
            self._start()

    def _start(self) -> None:
        self.ready()
        if self._output is not None and not self.running:
            stream = self._stream()
            # A generator can be sent something only once it waits at its first `yield`.
            next(stream)
            self._output.start(stream)
            self.running = True

    def _stream(self) -> Stream:
        """Give the device what it asks for, in its own thread."""
        frames = yield b""
        while True:
            frames = yield self._line.take(frames)

    def rest(self) -> None:
        """Let the device run no more, until the next sound."""
        if self._output is not None and self.running:
            self.running = False
            self._output.stop()

    def close(self) -> None:
        """Give the device back."""
        output, self._output, self.running = self._output, None, False
        if output is not None:
            output.close()


class Player:
    """Plays one sound at a time, and says a word after it, in its own thread.

    `opener` opens the device: it may take time, and may raise anything. `speech` is the command that says a word: by default
    the system's, none where empty.
    """

    def __init__(self, opener: Callable[[], Output] = open_output, speech: tuple[str, ...] | None = None) -> None:
        self.on = True
        """The operator wants to hear."""
        self.speaks = False
        """The operator wants words, too."""
        self.found: Callable[[bool], None] = lambda _there: None
        """Called in the player's thread when a device is found, or none."""
        self._opener = opener
        self._speech = speech_command() if speech is None else speech
        self._speaker = Speaker(self._speech)
        self._orders: queue.SimpleQueue[tuple[Cue | None, str, float] | None] = queue.SimpleQueue()
        """A sound, or None to get ready only; the word after it; since when it is due, s."""
        self._thread: threading.Thread | None = None
        self._closed = False
        self._there: bool | None = None
        self._retry_s = 0.0
        self._samples: dict[Cue, bytes] = {}

    @property
    def can_speak(self) -> bool:
        """The system has a command that speaks."""
        return bool(self._speech)

    def get_ready(self) -> None:
        """Import the library and open the device, so that the first sound is not late; returns at once."""
        self._order(None)

    def play(self, sound: Cue, word: str = "") -> None:
        """Play a sound, and say the word where words are wanted; returns at once.

        Nothing is heard where sounds are off or where there is no device.
        """
        self._order(sound, word)

    def close(self) -> None:
        """Give the device back, and play nothing any more."""
        self._closed = True
        thread, self._thread = self._thread, None
        if thread is not None:
            self._orders.put(None)
            thread.join(STOP_S)

    def _order(self, sound: Cue | None, word: str = "") -> None:
        if self._closed or not self.on:
            return
        if self._thread is None:
            self._thread = threading.Thread(target=self._loop, name="skincal-sound", daemon=True)
            self._thread.start()
        self._orders.put((sound, word, time.monotonic()))

    # In the thread

    def _loop(self) -> None:
        # Known here alone: a device that is still open when Python ends would wait for it, and Python for the device.
        outlet = _Outlet(self._opener)
        while True:
            try:
                order = self._orders.get(timeout=LINGER_S if outlet.running else None)
            except queue.Empty:
                self._guarded(outlet, outlet.rest)
                continue
            if order is None:
                break
            if self._there is not False or time.monotonic() >= self._retry_s:
                self._guarded(outlet, lambda order=order: self._do(outlet, *order))
        self._speaker.stop()
        self._guarded(outlet, outlet.close)

    def _do(self, outlet: _Outlet, sound: Cue | None, word: str, due_s: float) -> None:
        if not self._samples:
            from app.sound.cues import Cue, samples_of

            self._samples = {cue: samples_of(cue) for cue in Cue}
        outlet.ready()
        if sound is not None and time.monotonic() - due_s <= LATE_S:
            outlet.play(self._samples[sound])
            if word and self.speaks and self._speech:
                try:
                    self._speaker.say(word)
                except OSError as error:
                    LOG.info("nothing is said any more: %s", error)
                    self._speech = ()
        self._report(there=True)

    def _guarded(self, outlet: _Outlet, do: Callable[[], None]) -> None:
        """Do something with the device; whatever becomes of it, the program goes on without sound."""
        try:
            do()
        except Exception as error:  # noqa: BLE001 - whatever becomes of the device, the program goes on
            if self._there is not False:
                LOG.info("nothing is heard: %s", error)
            self._retry_s = time.monotonic() + RETRY_S
            self._report(there=False)
            with suppress(Exception):
                outlet.close()

    def _report(self, *, there: bool) -> None:
        if there is not self._there and not self._closed:
            self._there = there
            self.found(there)
