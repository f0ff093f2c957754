"""Foot pedals, keyboards of one key: each learns a key that means nothing yet, and acts as the space bar, Backspace or N.

A pedal's key is turned where it arrives: in the main window it does what the menu entry with that key does, anywhere else it
is pressed and let go as that key, so that it presses the focused button of a dialog. In a field for text it types nothing.
In the dialog a pedal is learnt by pressing it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from PySide6.QtCore import QCoreApplication, QEvent, QKeyCombination, QObject, QSettings, Qt
from PySide6.QtGui import QAction, QHideEvent, QKeyEvent, QKeySequence
from PySide6.QtWidgets import QApplication, QDialog, QDialogButtonBox, QGridLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from app.panels.widgets import plain_buttons, secondary_label, set_bold

Key = Qt.Key


@dataclass(frozen=True, slots=True)
class Pedal:
    """One pedal that can be learnt."""

    name: str
    """Of the menu entry that it triggers."""
    key: Qt.Key
    """As which it acts."""
    title: str
    what: str


PEDALS: tuple[Pedal, ...] = (
    Pedal("space", Key.Key_Space, "Space bar", "does the obvious thing: pauses, goes on, presses the focused button"),
    Pedal("undo", Key.Key_Backspace, "Backspace", "takes back the last poke or action"),
    Pedal("another", Key.Key_N, "N", "asks for another target"),
)

USED_BY_WIDGETS: Mapping[str, str] = {
    "Return": "presses a dialog's button",
    "Enter": "presses a dialog's button",
    "Esc": "closes a dialog",
    "Tab": "goes to the next part of the window",
    "Shift+Tab": "goes to the part of the window before",
    **dict.fromkeys(("Up", "Down", "Left", "Right", "PgUp", "PgDown", "Home", "End"), "moves in the map and in lists"),
    "Del": "deletes text",
    "Ctrl+C": "copies rows of a table",
}
"""Keys without an entry in a menu that mean something, and what."""
MODIFIERS: Mapping[Qt.Key, str] = {
    Key.Key_Shift: "Shift", Key.Key_Control: "Ctrl", Key.Key_Alt: "Alt", Key.Key_Meta: "Meta", Key.Key_AltGr: "AltGr",
    Key.Key_CapsLock: "Caps Lock", Key.Key_NumLock: "Num Lock",
}  # fmt: skip
KEPT = (
    Qt.KeyboardModifier.ShiftModifier
    | Qt.KeyboardModifier.ControlModifier
    | Qt.KeyboardModifier.AltModifier
    | Qt.KeyboardModifier.MetaModifier
)
"""Modifiers that make another key of a key; the keypad's does not."""


def key_name(event: QKeyEvent) -> str:
    """Return the key of an event in portable words: `"F13"`, `"Ctrl+B"`; empty where it has no name."""
    key = Key(event.key())
    if key is Key.Key_unknown or event.key() == 0:
        return ""
    if key in MODIFIERS:
        return MODIFIERS[key]
    return QKeySequence(QKeyCombination(event.modifiers() & KEPT, key)).toString(QKeySequence.SequenceFormat.PortableText)


def objection(name: str, taken: Mapping[str, str]) -> str:
    """Return why a key cannot be a pedal's; empty where it can."""
    if not name:
        return "The desktop knows no name for this key; set the pedal to another one, F13 for example."
    if name in MODIFIERS.values():
        return f"{name} only changes other keys; set the pedal to another one, F13 for example."
    if name.startswith("Alt+"):
        return f"{name} may open a menu; set the pedal to another key, F13 for example."
    meaning = taken.get(name) or USED_BY_WIDGETS.get(name)
    return f"{name} means something already: {meaning}. Set the pedal to another key, F13 for example." if meaning else ""


class Pedals(QObject):
    """The keys that were learnt; they are kept in the settings."""

    def __init__(
        self,
        actions: Mapping[str, QAction],
        taken: Callable[[], Mapping[str, str]],
        settings: QSettings,
        parent: QObject | None = None,
    ) -> None:
        super().__init__(parent)
        self._actions, self._taken, self._settings = actions, taken, settings
        self._listener: Callable[[str], None] | None = None
        self._installed = False
        self.keys: dict[str, str] = {}
        """Key of each pedal that was learnt, by the pedal's name."""
        for pedal in PEDALS:
            name = str(settings.value(f"pedal/{pedal.name}", ""))
            if name and not self.objection(pedal.name, name):
                self.keys[pedal.name] = name
        self._watch()

    def objection(self, pedal: str, key: str) -> str:
        """Return why a key cannot be learnt for a pedal; empty where it can."""
        others = {k: f"it is the pedal for {p.title}" for p in PEDALS if (k := self.keys.get(p.name)) and p.name != pedal}
        return objection(key, {**self._taken(), **others})

    def learn(self, pedal: str, key: str) -> str:
        """Learn a key; return why it cannot be, empty where it is learnt."""
        refused = self.objection(pedal, key)
        if not refused:
            self.keys[pedal] = key
            self._settings.setValue(f"pedal/{pedal}", key)
            self._watch()
        return refused

    def forget(self, pedal: str) -> None:
        """Let a key be itself again."""
        self.keys.pop(pedal, None)
        self._settings.remove(f"pedal/{pedal}")
        self._watch()

    def listen(self, listener: Callable[[str], None] | None) -> None:
        """Give the name of every key that is pressed from now on to `listener`, and to nobody else; None ends it."""
        self._listener = listener
        self._watch()

    def stop(self) -> None:
        """Leave all keys alone."""
        self.keys, self._listener = {}, None
        self._watch()

    def _watch(self) -> None:
        """See every event of the program, but only while there is a key to see."""
        application = QCoreApplication.instance()
        wanted = bool(self.keys) or self._listener is not None
        if application is None or wanted == self._installed:
            return
        self._installed = wanted
        if wanted:
            application.installEventFilter(self)
        else:
            application.removeEventFilter(self)

    def eventFilter(self, _watched: QObject, event: QEvent) -> bool:
        """Turn the keys of pedals into those as which they act."""
        if event.type() not in (QEvent.Type.KeyPress, QEvent.Type.KeyRelease) or not isinstance(event, QKeyEvent):
            return False
        name, is_press = key_name(event), event.type() is QEvent.Type.KeyPress
        if self._listener is not None:
            if is_press and not event.isAutoRepeat():
                self._listener(name)
            return is_press
        pedal = next((p for p in PEDALS if self.keys.get(p.name) == name), None)
        target = _target()
        if pedal is None or target is None or _takes(target, event):
            return False
        # A pedal that is held down repeats its key; a press counts once.
        if not event.isAutoRepeat():
            self._act(pedal, target, is_press)
        return True

    def _act(self, pedal: Pedal, target: QWidget, is_press: bool) -> None:
        action = self._actions[pedal.name]
        if target.window() is self.parent():
            if is_press and action.isEnabled():
                action.trigger()
            return
        pressed = QKeyEvent(QEvent.Type.KeyPress, pedal.key, Qt.KeyboardModifier.NoModifier, _text(pedal.key))
        if _takes(target, pressed):
            return  # It would be typed.
        kind = QEvent.Type.KeyPress if is_press else QEvent.Type.KeyRelease
        QCoreApplication.sendEvent(target, QKeyEvent(kind, pedal.key, Qt.KeyboardModifier.NoModifier, _text(pedal.key)))


def _target() -> QWidget | None:
    """Return who gets the keys."""
    popup = QApplication.activePopupWidget()
    if popup is not None:
        return popup.focusWidget() or popup
    return QApplication.focusWidget() or QApplication.activeWindow()


def _text(key: Qt.Key) -> str:
    return {Key.Key_Space: " ", Key.Key_N: "n"}.get(key, "")


def _takes(target: QWidget, event: QKeyEvent) -> bool:
    """Return whether a widget keeps a key from being a shortcut, as fields for text do with what they type."""
    asked = QKeyEvent(QEvent.Type.ShortcutOverride, event.key(), event.modifiers(), event.text())
    # An event begins as accepted: whoever wants this key has to accept it.
    asked.ignore()
    QCoreApplication.sendEvent(target, asked)
    return asked.isAccepted()


ASK = "Press the pedal now. Esc leaves it as it is."


class PedalsDialog(QDialog):
    """Learns and forgets the keys of pedals; what is learnt holds at once."""

    def __init__(self, pedals: Pedals, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Pedals")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self._pedals = pedals
        self._asked: Pedal | None = None
        self.keys = {pedal.name: QLabel() for pedal in PEDALS}
        self.learn = {pedal.name: QPushButton("Learn") for pedal in PEDALS}
        self.forget = {pedal.name: QPushButton("Forget") for pedal in PEDALS}
        self.outcome = secondary_label(wrap=True)
        self.buttons = QDialogButtonBox(QDialogButtonBox.StandardButton.Close)
        self.buttons.rejected.connect(self.reject)
        self._arrange()
        self._show_keys()
        self.learn["space"].setFocus()

    def _arrange(self) -> None:
        grid = QGridLayout()
        grid.setColumnStretch(1, 1)
        for row, pedal in enumerate(PEDALS):
            self.learn[pedal.name].setAccessibleName(f"learn the pedal for {pedal.title}")
            self.forget[pedal.name].setAccessibleName(f"forget the pedal for {pedal.title}")
            self.learn[pedal.name].clicked.connect(lambda _=False, pedal=pedal: self._ask(pedal))
            self.forget[pedal.name].clicked.connect(lambda _=False, pedal=pedal: self._forget(pedal))
            title = QLabel(pedal.title)
            set_bold(title)
            widgets = (title, secondary_label(pedal.what), self.keys[pedal.name])
            for column, widget in enumerate((*widgets, self.learn[pedal.name], self.forget[pedal.name])):
                grid.addWidget(widget, row, column)
        plain_buttons(self.buttons)
        column = QVBoxLayout(self)
        column.addWidget(
            secondary_label("A foot pedal is a keyboard of one key. It may have any key that means nothing yet.", wrap=True)
        )
        column.addLayout(grid)
        column.addWidget(self.outcome)
        column.addWidget(self.buttons)
        self.setMinimumWidth(640)

    def _ask(self, pedal: Pedal) -> None:
        self._asked = pedal
        self._pedals.listen(self._take)
        self.outcome.setText(f"{pedal.title}: {ASK}")
        self._show_keys()

    def _take(self, key: str) -> None:
        """Take the key that was pressed; where it cannot be learnt, say so and wait for the next."""
        pedal = self._asked
        if pedal is None:
            return
        refused = "" if key == "Esc" else self._pedals.learn(pedal.name, key)
        if refused:
            self.outcome.setText(f"\N{BALLOT X} {refused}")
            return
        self._end()
        self.outcome.setText("" if key == "Esc" else f"\N{CHECK MARK} {key} is the pedal for {pedal.title}.")
        self.buttons.button(QDialogButtonBox.StandardButton.Close).setFocus()

    def _forget(self, pedal: Pedal) -> None:
        self._end()
        self._pedals.forget(pedal.name)
        self.outcome.setText(f"{pedal.title} has no pedal any more.")
        self.learn[pedal.name].setFocus()
        self._show_keys()

    def _end(self) -> None:
        self._asked = None
        self._pedals.listen(None)
        self._show_keys()

    def _show_keys(self) -> None:
        for pedal in PEDALS:
            key = self._pedals.keys.get(pedal.name, "")
            self.keys[pedal.name].setText("\N{HORIZONTAL ELLIPSIS}" if pedal is self._asked else key or "no pedal")
            self.forget[pedal.name].setEnabled(bool(key))

    def hideEvent(self, event: QHideEvent) -> None:
        """Listen no more, however the dialog is left."""
        self._pedals.listen(None)
        super().hideEvent(event)
