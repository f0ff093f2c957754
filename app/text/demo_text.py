"""What is said of a rig that is simulated, and to somebody who sees the window for the first time."""

from __future__ import annotations

from app.state.running import Running

FIRST_MINUTE = (
    (
        "This robot is simulated.",
        "Nothing is connected; a simulated hand pokes, twice as quick as a careful one. Ctrl+N begins with your devices.",
    ),
    (
        "The large line at the bottom says what to do.",
        "Above it, smaller, stands what came of the last poke. The ring on the part shows where the next one goes.",
    ),
    (
        "No key takes a poke.",
        "Hands off, press, hold still, release. Backspace takes a poke back, Ctrl+Y brings it again, P pauses.",
    ),
    (
        "It comes to an end in about two minutes.",
        "By the modules method a few pokes place a whole module; V shows the other methods. The verdict leads to the file.",
    ),
)
"""Four things, each with what follows from it."""
FIRST_MINUTE_END = "Esc or a click closes this. It is said once."


def simulated_words(pace: int, running: Running) -> str:
    """Return what stands beside the line while the rig is simulated: `"SIMULATED  2x"`, with the operator's pace."""
    return f"SIMULATED  {pace}\N{MULTIPLICATION SIGN}" if running is Running.STREAMING else "SIMULATED"


def pace_words(pace: int) -> str:
    """Return the menu's entry for the pace of a simulated operator."""
    return f"Pace of the simulated operator: {pace}\N{MULTIPLICATION SIGN}"
