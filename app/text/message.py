"""Messages at the head of the window, and what its foot says of the recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from skincal.model.errors import plain_text

if TYPE_CHECKING:
    from skincal.session.part import Part

REPORTING = "The report is being written; it is said when it is there."
ADDRESS_WIDTH = 120
"""Characters of a line of the question about addresses: one word that long fits a window of 1280 pixels."""
NO_ADDRESSES = "No device of this session has an address: its rig is simulated, or nothing is open. Ctrl+N names devices."
NO_SESSION = "No session is open; open one first."
STILL_SOLVING = "All taxels are being solved anew, and what is shown is from before: try again in some seconds."


@dataclass(frozen=True, slots=True)
class Message:
    """A message to the operator."""

    text: str
    error: bool = False
    """It stays until it is dismissed."""
    asks: bool = False
    """It asks for something, and stays until that is done."""
    found: bool = False
    """It says what was found, neither a success nor a fault."""


def refused_words(failure: str) -> str:
    """Return what is said where the disk takes nothing more, for the reason `failure`."""
    return (
        f"{failure} Recording is paused, and what is not on the disk is in memory only: export the calibration now, "
        "then open the session again to record on."
    )


def connect_words(addresses: Sequence[str]) -> str:
    """Return what is asked before devices that a recorded session names are connected for the first time."""
    # Whole, and no wider than a screen: what is left out could be what matters.
    shown = map(plain_text, addresses)
    lines = [text[at : at + ADDRESS_WIDTH] for text in shown for at in range(0, len(text), ADDRESS_WIDTH)]
    return "This session names devices that were not connected here before:\n\n" + "\n".join(lines)


def look_words(sentence: str) -> str:
    """Return what is asked where `sentence` says that another process records a session."""
    return f"{sentence}\n\nIt can be looked at as far as it is written now; nothing in it is changed, and nothing is recorded."


def kept_words(folder: Path) -> str:
    """Say that a session is kept."""
    return f"This session is kept in {folder}."


def report_words(path: Path, verdict: str) -> str:
    """Return where a report is, and its verdict."""
    return f"The report is in {path}. {verdict}"


def keep_question(pokes: int) -> tuple[str, str]:
    """Ask whether to keep a session of so many pokes, and say what follows from the answer."""
    number = f"{pokes} poke{'' if pokes == 1 else 's'}"
    return f"Keep this session, with its {number}?", "Do not keep deletes its folder from the documents."


def mesh_words(part: Part) -> str:
    """Return what is said where a mesh alone became a scene: where that is, how large the part is, and what it lacks."""
    import numpy as np

    scene, surface = part.scene, part.surface
    sides = np.zeros(3) if surface is None else np.ptp(surface.vertices, axis=0) * 1e3
    missing = [f"how many channels the skin has (taken for {scene.skin.channels})"]
    missing += ["the layout of its modules"] if scene.skin.layout is None else []
    missing += ["where the sensor is"] if scene.arm is None and (scene.sensor_pose == np.eye(4)).all() else []
    return (
        f"The mesh is the part of a scene now, {scene.path}: {' x '.join(f'{side:.0f}' for side in sides)} mm. To be poked the "
        f"scene has to say {', '.join(missing[:-1])}{' and ' if missing[1:] else ''}{missing[-1]}; write that into it, then "
        "Ctrl+N names the devices."
    )


def copy_words(shipped: Path) -> str:
    """Say that a copy of a shipped session was opened."""
    return (
        f"{shipped} ships with skincal and stays as it is. This is a copy; the window asks whether to keep it when it closes."
    )


def place_words(folder: Path, *, provisional: bool, copied: bool = False) -> str:
    """Say where a recording is, for the foot of the window.

    Parameters
    ----------
    provisional : the operator has not decided yet to keep it
    copied : it is a copy of a session that ships
    """
    if not provisional:
        return f"Session in {folder}"
    return f"{'Copy' if copied else 'Recording'} in {folder}; Ctrl+S keeps it without a question"
