"""Every action of the window with its key and its place in the menus.

Keys are given explicitly, so that one hand, a pedal or a test can do everything; each menu entry prints its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject
from PySide6.QtGui import QAction, QActionGroup, QKeySequence
from PySide6.QtWidgets import QMenuBar

from app.theme import Choice

if TYPE_CHECKING:
    from app.state.policies import Allowed


@dataclass(frozen=True, slots=True)
class Command:
    """One entry of a menu."""

    name: str
    """By which the window finds it."""
    menu: str
    text: str
    keys: tuple[str, ...]
    hint: str
    checkable: bool


SOUNDS = "Sounds"
CORRECT = "Correct the rig"
OBVIOUS = "Do the obvious thing"

_MENUS: dict[str, tuple[tuple[str, str, str, str], ...]] = {
    "Session": (
        ("new", "New session...", "Ctrl+N", "Choose a scene, the devices and a folder"),
        ("open", "Open session...", "Ctrl+O", "Go on with a recorded session"),
        ("import", "Import a recording...", "Ctrl+I", "Make a session of logs of yarpdatadumper or of CSV files"),
        ("addresses", "Device addresses...", "A", "Another port or host for a device of this session"),
        ("keep", "Keep this session", "Ctrl+S", "Keep this session; without it the window asks when it closes"),
        ("export", "Export calibration...", "Ctrl+E", "Write the file that the robot loads"),
        ("apply", "Apply to the robot...", "Ctrl+Shift+A", "Send the positions to a running skinManager; asks first"),
        ("reference", "Compare with...", "Ctrl+R", "Show the error against a calibration (JSON, CSV, iCub) or a truth.json"),
        ("verdict", "Verdict...", "F", "What is done, what is not and why; then export"),
        ("report", "Report...", "Ctrl+Shift+E", "Write what the session came to as one file for the browser and for paper"),
        ("picture", "Save 3D picture...", "Ctrl+P", "Write the 3D view as it stands"),
        ("pace", "Pace of the simulated operator", "Shift+P", "Once, twice or four times as quick as a careful hand"),
        ("quit", "Quit", "Ctrl+Q", "Everything recorded is on the disk already"),
    ),
    "Poke": (
        ("space", OBVIOUS, "Space", "Pause, go on, or show the verdict once it is enough"),
        ("pause", "Pause", "P", "Pause or go on, whatever the guide says"),
        ("another", "Another target", "N", "Ask for another poke; a side that is skipped twice is left out"),
        ("no landmarks", "No landmarks in this pose", "Shift+N", "Go on with the skin, or end the closing check; N skips one"),
        (
            "closing",
            "Closing check again",
            "Shift+F",
            "Once it is enough: poke some of the first places once more; whether anything moved",
        ),
        ("correct", CORRECT, "C", "Use the correction that landmark pokes offer; it can be undone"),
        ("undo", "Undo", "Backspace Ctrl+Z", "Take back the last poke or action"),
        ("redo", "Redo", "Ctrl+Y Ctrl+Shift+Z", "Bring again what was taken back last"),
        ("history", "History...", "H", "What was done and when; Enter takes back everything down to a line"),
        ("exclude", "Exclude selected pokes", "E", "Selected pokes count no more, or count again"),
        ("last", "Select last poke", "L", "Show the newest poke in the list"),
        ("dead", "Do not use selected taxel", "D", "Leave a taxel out that is stuck or always on, or use it again"),
        ("thresholds", "Thresholds...", "Shift+H", "What a poke must pass to count; a change holds for pokes from then on"),
        (
            "landmark",
            "Add landmark...",
            "K",
            "Name a known point of the part: a screw's head; click it, or K again types its place",
        ),
        ("pedals", "Pedals...", "F3", "Learn the keys of foot pedals for Space, Backspace and N"),
    ),
    "View": (
        ("method", "Next method", "V", "Show the next method's estimates; the guide follows it"),
        (
            "difference",
            "Lines to another method",
            "X",
            "Join each estimate to the surface method's, or where that is shown to the free method's",
        ),
        ("guide", "Guide", "G", "Say and show what to poke next"),
        ("sounds", SOUNDS, "M", "Hear contact, enough, verdict, taxel done, device lost"),
        ("speech", "Say why a poke is rejected", "Shift+M", "With the voice of the system"),
        ("turn", "Turn to the target", "T", "Turn the 3D view between pokes where it hides the target"),
        ("camera", "Whole part", "Home", "Bring the whole part into the 3D view"),
        ("larger", "Larger text", "Ctrl++ Ctrl+=", "Up to 200 % in the whole window"),
        ("smaller", "Smaller text", "Ctrl+-", "Down to 75 % in the whole window"),
        ("usual", "Text as usual", "Ctrl+0", "As large as the desktop's"),
        ("none", "Select nothing", "Esc", "Dismiss the message, or the selection"),
        ("full", "Full screen", "F11", ""),
    ),
    "Layers": (
        ("modules", "Plan of the skin", "Ctrl+1", "Outlines, numbers and places as the layout has them"),
        ("estimates", "Estimates", "Ctrl+2", "A ball for each taxel, with a hole where it lies below the skin"),
        ("axes", "Force axes", "Ctrl+3", "Of the poke in progress, and of the selected taxel's pokes"),
        ("uncertainty", "Ellipses", "Ctrl+4", "Where the worst taxel and the selected one may lie, at 95 %"),
        ("landmarks", "Landmarks", "Ctrl+5", "Known points of the part, with their names"),
        ("cone", "Cone of the target", "Ctrl+6", "How far a push may be off the arrow"),
    ),
    "Help": (
        ("what", "What is this?", "F1", "Then click what you want explained"),
        ("keys", "Keys", "F2", "Every key in one list"),
        ("about", "About skincal", "Shift+F2", "Version and licence"),
    ),
}
"""For each menu: name, text, keys and hint of each entry."""
LAYERS = tuple(name for name, *_ in _MENUS["Layers"])
"""What the 3D view can leave out, by the names that it knows."""
_CHECKABLE = ("difference", "guide", "sounds", "speech", "turn", "full", *LAYERS)
COMMANDS = tuple(
    Command(name, menu, text.replace("...", "\N{HORIZONTAL ELLIPSIS}"), tuple(keys.split()), hint, name in _CHECKABLE)
    for menu, entries in _MENUS.items()
    for name, text, keys, hint in entries
)


_THEMES = {
    Choice.SYSTEM: ("Colours of the desktop", "F7"),
    Choice.LIGHT: ("Light colours", "F8"),
    Choice.DARK: ("Dark colours", "F9"),
}


class Commands(QObject):
    """The actions, made once and enabled by policy."""

    def __init__(self, bar: QMenuBar, slots: dict[str, Callable[[], object]], parent: QObject | None = None) -> None:
        super().__init__(parent)
        self.actions: dict[str, QAction] = {}
        self.menus = {name: bar.addMenu(f"&{name}") for name in dict.fromkeys(c.menu for c in COMMANDS)}
        for command in COMMANDS:
            action = QAction(command.text, self)
            action.setShortcuts([QKeySequence(key) for key in command.keys])
            action.setStatusTip(command.hint)
            action.setCheckable(command.checkable)
            # A key that is held down would take back one poke after another.
            action.setAutoRepeat(False)
            # Lambdas drop the `checked` argument that Qt would pass.
            action.triggered.connect(lambda _checked=False, slot=slots[command.name]: slot())
            self.menus[command.menu].addAction(action)
            self.actions[command.name] = action

    def add_themes(self, chosen: Choice, choose: Callable[[Choice], None]) -> None:
        """Add the choice of the theme to the view menu."""
        self.menus["View"].addSeparator()
        group = QActionGroup(self)
        for choice in Choice:
            words, key = _THEMES[choice]
            action = self.menus["View"].addAction(words)
            action.setShortcut(QKeySequence(key))
            action.setCheckable(True)
            action.setChecked(choice is chosen)
            action.triggered.connect(lambda _checked=False, choice=choice: choose(choice))
            group.addAction(action)

    def add_tabs(self, titles: Iterable[str], show: Callable[[int], object]) -> list[QAction]:
        """Add an entry for each tab, with its number as the key; return the actions, to be removed with the tabs."""
        menu = self.menus["View"]
        added = [menu.addSeparator()]
        for index, title in enumerate(titles):
            action = menu.addAction(title)
            action.setShortcut(QKeySequence(str(index + 1)))
            action.triggered.connect(lambda _checked=False, index=index: show(index))
            added.append(action)
        return added

    def follow_sound(self, *, found: bool, can_speak: bool) -> None:
        """Enable sounds and speech where there is a device for them, and say where there is none."""
        self.actions["sounds"].setEnabled(found)
        self.actions["sounds"].setText(SOUNDS if found else f"{SOUNDS} (no sound device)")
        self.actions["speech"].setEnabled(found and can_speak)

    def taken(self) -> dict[str, str]:
        """Return what each key of the menus means, by its portable name."""
        portable = QKeySequence.SequenceFormat.PortableText
        return {
            key.toString(portable): action.text().rstrip("\N{HORIZONTAL ELLIPSIS}")
            for menu in self.menus.values()
            for action in menu.actions()
            for key in action.shortcuts()
        }

    def follow_text(self, percent: int, steps: Sequence[int]) -> None:
        """Name the size of the text, and enable what still changes it."""
        self.actions["larger"].setEnabled(percent < steps[-1])
        self.actions["smaller"].setEnabled(percent > steps[0])
        self.actions["usual"].setText(f"Text as usual (now {percent} %)")

    def follow_pace(self, words: str, *, served: bool) -> None:
        """Name the pace of a simulated operator, where there is one."""
        self.actions["pace"].setEnabled(served)
        self.actions["pace"].setText(words)

    def follow(self, may: Allowed, correct: str, *, can_keep: bool) -> None:
        """Enable what may be done, and name it."""
        excludes = bool(may.exclude or may.unname)
        exclude = "Restore selected pokes" if may.restore and not excludes else "Exclude selected pokes"
        for name, enabled, text in (
            ("undo", bool(may.undo), f"Undo {may.undo}".strip()),
            ("redo", bool(may.redo), f"Redo {may.redo}".strip()),
            ("exclude", excludes or bool(may.restore), exclude),
            ("dead", may.mark_dead or may.revive, "Use selected taxel again" if may.revive else "Do not use selected taxel"),
            ("correct", bool(correct), correct or CORRECT),
            ("space", bool(may.space), may.space or OBVIOUS),
            ("pause", bool(may.pause), may.pause or "Pause"),
        ):
            self.actions[name].setEnabled(enabled)
            self.actions[name].setText(text)
        for name, enabled in (
            ("export", may.export),
            ("apply", may.export),
            ("report", may.export),
            ("method", may.switch_method),
            ("difference", may.switch_method),
            ("keep", can_keep),
            ("another", may.another),
            ("no landmarks", may.skip_landmarks),
            ("verdict", may.verdict),
            ("closing", may.ends),
        ):
            self.actions[name].setEnabled(enabled)


_MORE_KEYS = (
    ("1 to 7", "Tabs"),
    ("F6", "Where devices are named: swap F/T sensor and skin"),
    ("F7, F8, F9", "Colours of the desktop, light, dark"),
    ("Arrows", "On the map: next taxel. In a list: next row"),
    ("Ctrl+C", "In a table: copies the selected rows, or all"),
    ("+, -, 0", "On the map: nearer, farther, all of it"),
    ("Tab", "The next part of the window"),
)


def key_words(columns: int) -> str:
    """Return every key with what it does, as a table in HTML with so many columns beside each other, as a screen is wide."""
    known = [(" or ".join(c.keys), c.text.rstrip("\N{HORIZONTAL ELLIPSIS}")) for c in COMMANDS if c.keys]
    # Or Qt would break a line within "Ctrl++".
    cell = "<td style='white-space: pre; padding-right: 8px'>"
    rows = [f"<tr>{cell}<b>{keys}</b></td>{cell}{words}</td></tr>" for keys, words in (*known, *_MORE_KEYS)]
    high = -(-len(rows) // columns)
    parts = (rows[at : at + high] for at in range(0, len(rows), high))
    tables = (f"<td><table cellpadding=0 cellspacing=1>{''.join(some)}</table></td>" for some in parts)
    return f"<table><tr>{''.join(tables)}</tr></table>"
