"""Texts of the demonstration with a simulated robot."""

from __future__ import annotations

from app.state.running import Running

FIRST_MINUTE = (
    (
        "This robot is simulated.",
        "Nothing is connected. A simulated hand presses the skin. Ctrl+Shift+N: describe your own part. Ctrl+N: start with "
        "your own devices.",
    ),
    (
        "The large line at the bottom tells you what to do.",
        "The small line shows the result of the last poke. The ring on the part shows where to press next.",
    ),
    ("Pokes are recorded automatically.", "Hands off, press, hold still, release. Backspace: undo. Ctrl+Y: redo. P: pause."),
    (
        "The demonstration ends in about two minutes.",
        "A few pokes are enough for each skin module. V: other methods. Then you can write the calibration file.",
    ),
)
"""Titles and texts of the first minute."""
FIRST_MINUTE_ROBOT = (
    ("This robot is simulated.", "Nothing is connected. An arm in the physics engine MuJoCo presses a simulated skin."),
    ("The arm pokes alone.", "The guide sends it one target after the other. The ball in the 3D view is its tip."),
    ("S stops the arm at once.", "S again: it goes on. N: another target. P: pause."),
    ("It needs about five minutes.", "Then you can write the calibration file. docs/robot.md: your own robot."),
)
"""The same for the demonstration with a robot that pokes."""
FIRST_MINUTE_COBOT = (
    ("This cobot is simulated.", "Nothing is connected. An arm in the physics engine MuJoCo presses a simulated skin."),
    (
        "It pokes alone, landmarks first.",
        "The place of the part is not measured: touches of landmarks show it. Until then the 3D view says what is missing.",
    ),
    *FIRST_MINUTE_ROBOT[2:3],
    ("It needs about five minutes.", "Then you can write the calibration file. docs/tool.md: your own cobot and skin."),
)
"""The same for a cobot that holds the tool."""
FIRST_MINUTE_END = "Esc or a click closes this card."

GO_ON_SIMULATED = (
    "A simulated hand made the pokes of this session. The same hand can go on with the same simulated rig.\n\n"
    "For devices of your own press Cancel, then A: change addresses."
)
"""Question before the simulated hand of a recorded session goes on."""
UNKNOWN_RIG = (
    "The pokes of this session are simulated, and its files do not name the simulated rig: no hand can go on here. Ctrl+N, "
    "then Try it with a simulated hand, starts a new session of this scene. A: connect devices of your own."
)

OTHER_RIG = (
    "This version of the program simulates another rig than that of the session: no hand can go on here. Ctrl+N, then Try it "
    "with a simulated hand, starts a new session of this scene."
)


def simulated_words(pace: int, running: Running) -> str:
    """Label of a simulated robot: `"SIMULATED  2x"`, with the pace of its operator; 0 without an operator."""
    if not pace:
        return "SIMULATED ROBOT"
    return f"SIMULATED  {pace}\N{MULTIPLICATION SIGN}" if running is Running.STREAMING else "SIMULATED"


def pace_words(pace: int) -> str:
    """Menu entry for the pace of the simulated operator."""
    return f"Pace of the simulated operator: {pace}\N{MULTIPLICATION SIGN}"
