"""Says a word with the system's own voice: speech-dispatcher or eSpeak on Linux, `say` on macOS, System.Speech on Windows."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import subprocess

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
    """Says one word at a time; the next cuts off the one before.

    Parameters
    ----------
    command : that speaks; see `speech_command`
    """

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
            voice.wait()
