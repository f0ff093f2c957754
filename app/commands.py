"""Every action of the window. A new command, key or menu entry is one `Command` in `WINDOW_COMMANDS`.

Keys are explicit, so that one hand, a pedal or a test can do everything. Each menu entry shows its own key.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from PySide6.QtCore import QObject, QSettings
from PySide6.QtGui import QAction, QKeySequence
from PySide6.QtWidgets import QWhatsThis

from app.text.demo_text import pace_words
from app.text_size import TEXT_SIZES_PERCENT
from app.theme import Choice

if TYPE_CHECKING:
    from app.state.policies import Allowed

# `Any`, since the modules of the window and the session view import this one.
Window: TypeAlias = Any
SessionView: TypeAlias = Any
Enabled: TypeAlias = "Callable[[Window], bool | str]"


def always(_window: Window) -> bool:
    """Enable a command in every state."""
    return True


def view(run: Callable[[SessionView], object]) -> Callable[[Window], object]:
    """Run something on the session view; do nothing while no session is open."""
    return lambda window: None if window.session_view is None else run(window.session_view)


def may(field: Callable[[Allowed], bool | str]) -> Enabled:
    """Enable a command while a field of `Allowed` permits it; nothing is allowed before the first picture."""
    return lambda window: window.may is not None and field(window.may)


def _correction_label(allowed: Allowed) -> str:
    from app.text.rig_text import offer_text  # needs numpy

    return "" if allowed.correct is None else offer_text(allowed.correct)


@dataclass(frozen=True, slots=True)
class Command:
    """One menu entry."""

    name: str
    """Unique; the window finds the action by it."""
    menu: str
    text: str
    keys: str
    """Separated by spaces."""
    hint: str
    run: Callable[[Window], object]
    enabled: Enabled = always
    """Whether the command can be used now. A text means yes, and replaces `text`."""
    switch: bool | None = None
    """State of a switch for a new user; `None` if the entry is no switch."""
    setting: str = ""
    """Setting that keeps a switch; empty if none does."""
    why_disabled: str = ""
    """Shown after `text` while the command is disabled."""


# fmt: off
WINDOW_COMMANDS = (
    Command("part", "Session", "New part…", "Ctrl+Shift+N", "Describe your own part: mesh or URDF, sensor, skin, landmarks",
            lambda w: w.ask_part()),
    Command("change part", "Session", "Change a part…", "Ctrl+Shift+O", "Open a scene file, to change what it says of the part",
            lambda w: w.ask_scene()),
    Command("new", "Session", "New session…", "Ctrl+N", "Choose a scene, the devices and a folder", lambda w: w.ask_new()),
    Command("open", "Session", "Open session…", "Ctrl+O", "Continue a recorded session", lambda w: w.ask_session()),
    Command("import", "Session", "Import a recording…", "Ctrl+I", "Make a session from bags, logs and tables of other programs",
            lambda w: w.ask_import()),
    Command("addresses", "Session", "Device addresses…", "A", "Another port or host for a device of this session",
            lambda w: w.ask_addresses()),
    Command("fixed point", "Session", "Fixed-point test…", "Ctrl+T",
            "Touch one point from four sides with the tool: finds its tip, and a wrong form of its poses",
            lambda w: w.ask_fixed_point(), lambda w: w.has_tool),
    Command("keep", "Session", "Keep this session", "Ctrl+S", "Keep this session; otherwise the window asks when it closes",
            lambda w: w.controller.keep(), lambda w: w.controller.can_keep),
    Command("export", "Session", "Export calibration…", "Ctrl+E", "Write the file that the robot loads",
            view(lambda v: v.ask_export()), may(lambda m: m.export)),
    Command("apply", "Session", "Apply to the robot…", "Ctrl+Shift+A",
            "Send the positions to a running skinManager; asks first",
            view(lambda v: v.ask_apply()), may(lambda m: m.export)),
    Command("reference", "Session", "Compare with…", "Ctrl+R",
            "Show the error against a calibration (JSON, CSV, iCub) or truth.json",
            view(lambda v: v.ask_reference())),
    Command("verdict", "Session", "Verdict…", "F", "Show what is finished, what is not and why; then export",
            view(lambda v: v.ask_verdict()), may(lambda m: m.verdict)),
    Command("report", "Session", "Report…", "Ctrl+Shift+E", "Write the results as one file for the browser and for paper",
            view(lambda v: v.ask_report()), may(lambda m: m.export)),
    Command("picture", "Session", "Save 3D picture…", "Ctrl+P", "Write the 3D view to an image file",
            view(lambda v: v.ask_picture())),
    Command("pace", "Session", "Pace of the simulated operator", "Shift+P", "One, two or four times as fast as a careful hand",
            lambda w: w.change_pace(), lambda w: w.controller.has_simulator and pace_words(w.controller.pace)),
    Command("quit", "Session", "Quit", "Ctrl+Q", "Everything recorded is on the disk already", lambda w: w.close()),

    Command("space", "Poke", "Pause or continue", "Space", "Pause or continue; show the verdict when all taxels are finished",
            lambda w: w.pause_or_show_verdict(), may(lambda m: m.space)),
    Command("pause", "Poke", "Pause", "P", "Pause or continue, without the verdict", lambda w: w.controller.toggle(),
            may(lambda m: m.pause)),
    Command("another", "Poke", "Another target", "N", "Ask for another poke; a direction that is skipped twice is left out",
            view(lambda v: v.skip_target()), may(lambda m: m.another)),
    Command("stop robot", "Poke", "Stop the robot", "S", "Stop the robot that pokes, at once; S again lets it go on",
            lambda w: w.controller.stop_robot(), lambda w: w.controller.stop_words),
    Command("no landmarks", "Poke", "No landmarks in this pose", "Shift+N",
            "Continue with the skin, or end the final check; N skips one",
            view(lambda v: v.skip_landmarks()), may(lambda m: m.skip_landmarks)),
    Command("closing", "Poke", "Repeat the final check", "Shift+F",
            "Poke some of the first points again, to see if anything moved",
            view(lambda v: v.check_again()), may(lambda m: m.ends)),
    Command("correct", "Poke", "Correct errors of the rig", "C",
            "Apply the correction that landmark pokes offer; it can be undone",
            view(lambda v: v.correct()), may(lambda m: _correction_label(m))),
    Command("undo", "Poke", "Undo", "Backspace Ctrl+Z", "Undo the last poke or action",
            view(lambda v: v.undo()), may(lambda m: m.undo and f"Undo {m.undo}")),
    Command("redo", "Poke", "Redo", "Ctrl+Y Ctrl+Shift+Z", "Redo what was undone last",
            view(lambda v: v.redo()), may(lambda m: m.redo and f"Redo {m.redo}")),
    Command("history", "Poke", "History…", "H", "All actions with their times; Enter undoes everything down to a line",
            view(lambda v: v.show_history())),
    Command("exclude", "Poke", "Exclude selected pokes", "E", "Do not use the selected pokes, or use them again",
            view(lambda v: v.exclude_or_restore()), may(lambda m: m.exclude_text)),
    Command("last", "Poke", "Select last poke", "L", "Show the newest poke in the list", view(lambda v: v.select_last())),
    Command("dead", "Poke", "Do not use selected taxel", "D", "Leave out a taxel that is stuck or always on, or use it again",
            view(lambda v: v.mark_or_revive()), may(lambda m: m.taxel_text)),
    Command("thresholds", "Poke", "Thresholds…", "Shift+H", "Limits that a poke must meet; a change applies to later pokes",
            view(lambda v: v.show_thresholds())),
    Command("landmark", "Poke", "Add landmark…", "K",
            "Name a known point of the part, for example a screw: click it, or K again to type",
            view(lambda v: v.ask_landmark())),
    Command("name landmarks", "Poke", "Name landmarks of pokes", "Shift+K",
            "Find which recorded pokes were at which landmark, where it is sure",
            view(lambda v: v.name_landmarks()), lambda w: w.session_view is not None),
    Command("pedals", "Poke", "Pedals…", "F3", "Assign foot pedals to Space, Backspace and N", lambda w: w.ask_pedals()),

    Command("method", "View", "Next method", "V", "Show the next method's estimates; the guide follows it",
            view(lambda v: v.next_method()), may(lambda m: m.switch_method)),
    Command("difference", "View", "Lines to another method", "X", "Join each estimate to that of another method",
            view(lambda v: v.follow_switches()), may(lambda m: m.switch_method), switch=False),
    Command("guide", "View", "Guide", "G", "Tell and show where to poke next",
            view(lambda v: v.follow_switches()), switch=True, setting="window/guide"),
    Command("sounds", "View", "Sounds", "M", "Hear contact, finished session, verdict, finished taxel, lost device",
            lambda w: w.switch_sounds(), lambda w: w.has_sound, switch=True, setting="window/sounds",
            why_disabled="no sound device"),
    Command("speech", "View", "Say why a poke is rejected", "Shift+M", "With the voice of the system",
            lambda w: w.switch_sounds(), lambda w: w.has_sound and w.player.can_speak, switch=False, setting="window/speech"),
    Command("turn", "View", "Turn to the target", "T", "Turn the 3D view between pokes if the target is hidden",
            view(lambda v: v.follow_switches()), switch=True, setting="window/turn"),
    Command("camera", "View", "Whole part", "Home", "Show the whole part in the 3D view",
            lambda w: w.reset_camera()),
    Command("larger", "View", "Larger text", "Ctrl++ Ctrl+=", f"Up to {TEXT_SIZES_PERCENT[-1]} % in the whole window",
            lambda w: w.text_size.larger(), lambda w: w.text_size.percent < TEXT_SIZES_PERCENT[-1]),
    Command("smaller", "View", "Smaller text", "Ctrl+-", f"Down to {TEXT_SIZES_PERCENT[0]} % in the whole window",
            lambda w: w.text_size.smaller(), lambda w: w.text_size.percent > TEXT_SIZES_PERCENT[0]),
    Command("usual", "View", "Normal text", "Ctrl+0", "The text size of the desktop",
            lambda w: w.text_size.choose(), lambda w: f"Normal text (now {w.text_size.percent} %)"),
    Command("enlarge", "View", "Enlarge the panels", "F12", "Give the tabs most of the window; again: as before",
            view(lambda v: v.workspace.docks.enlarge()), lambda w: w.session_view is not None),
    Command("detach", "View", "Detach the open tab", "Shift+F12", "Make the tab a window of its own; closing puts it back",
            view(lambda v: v.workspace.detach_current()), lambda w: w.session_view is not None),
    Command("arrange", "View", "First arrangement", "Ctrl+F12", "Put map and tabs back to their first places",
            view(lambda v: v.workspace.docks.restore_first()), lambda w: w.session_view is not None),
    Command("none", "View", "Select nothing", "Esc", "Close the message, or clear the selection", lambda w: w.escape()),
    Command("full", "View", "Full screen", "F11", "", lambda w: w.toggle_full_screen(), switch=False),
    *(Command(choice.value, "View", text, key, "", lambda w, choice=choice: w.choose_theme(choice), switch=False)
      for choice, text, key in ((Choice.SYSTEM, "Colours of the desktop", "F7"), (Choice.LIGHT, "Light colours", "F8"),
                                (Choice.DARK, "Dark colours", "F9"))),

    *(Command(name, "Layers", text, f"Ctrl+{number}", hint, view(lambda v: v.follow_switches()), switch=True,
            setting=f"layers/{name}")
      for number, (name, text, hint) in enumerate((
          ("modules", "Planned skin", "Outlines, numbers and planned taxels of the layout"),
          ("estimates", "Estimates", "A ball for each taxel"),
          ("axes", "Force axes", "Of the current poke, and of the selected taxel's pokes"),
          ("uncertainty", "Ellipses", "95 % regions of the worst taxel and the selected one"),
          ("landmarks", "Landmarks", "Known points of the part, with their names"),
          ("cone", "Cone of the target", "Accepted directions of the next push")), 1)),
    Command("turns", "Layers", "Axes of the taxels", "Ctrl+7", "x red, y green and z blue, of taxels that measure three axes",
            view(lambda v: v.follow_switches()),
            lambda w: w.session_view is not None and w.session_view.has_turns, switch=True, setting="layers/turns"),

    Command("what", "Help", "What is this?", "F1", "Then click something to see its explanation",
            lambda _: QWhatsThis.enterWhatsThisMode()),
    Command("keys", "Help", "Keys", "F2", "Every key in one list", lambda w: w.show_keys()),
    Command("messages", "Help", "Messages…", "F4", "Messages about this session with their times", lambda w: w.show_messages()),
    Command("documents", "Help", "Documents", "Shift+F1", "Open the manual and the other pages", lambda w: w.open_documents()),
    Command("about", "Help", "About skincal", "Shift+F2", "Version and licence", lambda w: w.show_about()),
)
# fmt: on
GROUP_STARTS = frozenset(
    (
        "new",
        "addresses",
        "export",
        "pace",
        "quit",
        "no landmarks",
        "undo",
        "turns",
        "exclude",
        "thresholds",
        "sounds",
        "turn",
        "larger",
        "enlarge",
        "none",
        "system",
        "documents",
    )
)  # fmt: skip
"""Names of commands with a line above them in the menu."""
LAYER_NAMES = tuple(command.name for command in WINDOW_COMMANDS if command.menu == "Layers")
"""Layers of the 3D view that can be hidden."""


class Commands(QObject):
    """The menus of a window and their actions."""

    def __init__(self, window: Window) -> None:
        super().__init__(window)
        self._window = window
        self.actions: dict[str, QAction] = {}
        self.menus = {name: window.menuBar().addMenu(f"&{name}") for name in dict.fromkeys(c.menu for c in WINDOW_COMMANDS)}
        for command in WINDOW_COMMANDS:
            action = QAction(command.text, self)
            action.setShortcuts([QKeySequence(key) for key in command.keys.split()])
            action.setStatusTip(command.hint)
            action.setCheckable(command.switch is not None)
            # A key that is held down would undo one poke after another.
            action.setAutoRepeat(False)
            action.triggered.connect(lambda _checked=False, run=command.run: run(window))
            if command.name in GROUP_STARTS:
                self.menus[command.menu].addSeparator()
            self.menus[command.menu].addAction(action)
            self.actions[command.name] = action

    def update_actions(self) -> None:
        """Enable the commands that can be used now, and label them."""
        for command in WINDOW_COMMANDS:
            enabled, action = command.enabled(self._window), self.actions[command.name]
            note = f" ({command.why_disabled})" if command.why_disabled and not enabled else ""
            action.setEnabled(bool(enabled))
            action.setText(enabled if enabled and isinstance(enabled, str) else command.text + note)

    def is_on(self, name: str) -> bool:
        return self.actions[name].isChecked()

    def restore(self, settings: QSettings) -> None:
        for command in WINDOW_COMMANDS:
            if command.setting:
                # A settings file holds words: "false" would be true without its type.
                self.actions[command.name].setChecked(bool(settings.value(command.setting, command.switch, type=bool)))

    def save(self, settings: QSettings) -> None:
        for command in WINDOW_COMMANDS:
            if command.setting:
                settings.setValue(command.setting, self.is_on(command.name))

    def add_tabs(self, titles: Iterable[str], show: Callable[[int], object]) -> list[QAction]:
        """Add an entry for each tab, with its number as the key; return the actions, which go with the tabs."""
        added = [self.menus["View"].addSeparator()]
        for index, title in enumerate(titles):
            action = self.menus["View"].addAction(title)
            action.setShortcut(QKeySequence(str(index + 1)))
            action.triggered.connect(lambda _checked=False, index=index: show(index))
            added.append(action)
        return added

    def meaning_of_keys(self) -> dict[str, str]:
        """Return the meaning of each key of the menus, by the key's portable name."""
        portable = QKeySequence.SequenceFormat.PortableText
        actions = [action for menu in self.menus.values() for action in menu.actions()]
        return {key.toString(portable): action.text().rstrip("…") for action in actions for key in action.shortcuts()}


_MORE_KEYS = (
    ("1 to 7", "Tabs"),
    ("F6", "Where devices are named: swap sensor and skin"),
    ("Arrows", "On the map: next taxel. In a list: next row"),
    ("Ctrl+C", "In a table: copy the selected rows, or all"),
    ("+, -, 0", "On the map: enlarge, reduce, show all"),
    ("Tab", "The next part of the window"),
)


def key_words(columns: int) -> str:
    """Return every key with its meaning as a table in HTML, in this number of columns."""
    known = [(" or ".join(c.keys.split()), c.text.rstrip("…")) for c in WINDOW_COMMANDS]
    # Otherwise Qt would break a line within "Ctrl++".
    cell = "<td style='white-space: pre; padding-right: 8px'>"
    rows = [f"<tr>{cell}<b>{keys}</b></td>{cell}{words}</td></tr>" for keys, words in (*known, *_MORE_KEYS)]
    height = -(-len(rows) // columns)
    parts = (rows[at : at + height] for at in range(0, len(rows), height))
    tables = (f"<td><table cellpadding=0 cellspacing=1>{''.join(some)}</table></td>" for some in parts)
    return f"<table><tr>{''.join(tables)}</tr></table>"
