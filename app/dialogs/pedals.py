"""Foot pedals: keyboards with one key, which acts as the space bar, Backspace or N.

In the main window the pedal's key triggers a command. In a dialog it becomes the key that it stands for, so that it presses the
focused button. In a text field it types nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from PySide6.QtCore import QCoreApplication, QEvent, QKeyCombination, QObject, QSettings, Qt
from PySide6.QtGui import QAction, QKeyEvent, QKeySequence
from PySide6.QtWidgets import QApplication, QGridLayout, QKeySequenceEdit, QLabel, QPushButton, QWidget

from app.dialogs.dialog import Dialog
from app.panels.widgets import secondary_label, set_bold

Key = Qt.Key
PORTABLE_FORMAT = QKeySequence.SequenceFormat.PortableText


@dataclass(frozen=True, slots=True)
class Pedal:
    """Name, action and key of one pedal."""

    name: str
    """Of the command that it triggers."""
    key: Qt.Key
    """Key that it stands for."""
    title: str
    what: str


ALL_PEDALS: tuple[Pedal, ...] = (
    Pedal("space", Key.Key_Space, "Space bar", "pauses, continues, or presses the focused button"),
    Pedal("undo", Key.Key_Backspace, "Backspace", "undoes the last poke or action"),
    Pedal("another", Key.Key_N, "N", "asks for another target"),
)
USED_BY_WIDGETS: Mapping[str, str] = {
    "Return": "presses a button of a dialog",
    "Enter": "presses a button of a dialog",
    "Esc": "closes a dialog",
    "Tab": "goes to the next part of the window",
    "Shift+Tab": "goes to the previous part of the window",
    **dict.fromkeys(("Up", "Down", "Left", "Right", "PgUp", "PgDown", "Home", "End"), "moves in the map and in lists"),
    "Del": "deletes text",
    "Ctrl+C": "copies rows of a table",
}
"""Keys that have a use without a menu entry."""
IGNORED_MODIFIER = Qt.KeyboardModifier.KeypadModifier


def key_name(event: QKeyEvent) -> str:
    """Name the key of an event: `"F13"`, `"Ctrl+B"`; empty if it has no name."""
    key = Key(event.key())
    if key is Key.Key_unknown or event.key() == 0:
        return ""
    return QKeySequence(QKeyCombination(event.modifiers() & ~IGNORED_MODIFIER, key)).toString(PORTABLE_FORMAT)


def key_problem(name: str, taken: Mapping[str, str]) -> str:
    """Say why a key cannot be used for a pedal; empty if it can."""
    if name.startswith("Alt+"):
        return f"{name} may open a menu. Set the pedal to another key, for example F13."
    meaning = taken.get(name) or USED_BY_WIDGETS.get(name)
    return f"{name} has a use already: {meaning}. Set the pedal to another key, for example F13." if meaning else ""


class Pedals(QObject):
    """Keys of the pedals, saved in the settings. They act by an event filter of the application."""

    def __init__(
        self,
        actions: Mapping[str, QAction],
        taken: Callable[[], Mapping[str, str]],
        settings: QSettings,
        parent: QObject | None = None,
    ) -> None:
        super().__init__(parent)
        self._actions, self._taken, self._settings = actions, taken, settings
        self._is_installed = False
        self.keys: dict[str, str] = {}  # By the name of the pedal
        for pedal in ALL_PEDALS:
            name = str(settings.value(f"pedal/{pedal.name}", ""))
            if name and not self._problem(pedal.name, name):
                self.keys[pedal.name] = name
        self._install()

    def _problem(self, pedal: str, key: str) -> str:
        others = {k: f"it is the pedal for {p.title}" for p in ALL_PEDALS if (k := self.keys.get(p.name)) and p.name != pedal}
        return key_problem(key, {**self._taken(), **others})

    def set_key(self, pedal: str, key: str) -> str:
        """Use a key for a pedal; return why that is impossible, or an empty text."""
        refusal = self._problem(pedal, key)
        if not refusal:
            self.keys[pedal] = key
            self._settings.setValue(f"pedal/{pedal}", key)
            self._install()
        return refusal

    def forget_key(self, pedal: str) -> None:
        """Remove the pedal's key, so that the key has its normal meaning again."""
        self.keys.pop(pedal, None)
        self._settings.remove(f"pedal/{pedal}")
        self._install()

    def stop(self) -> None:
        """Ignore the pedals from now on; the settings keep them."""
        self.keys = {}
        self._install()

    def _install(self) -> None:
        """Filter events only while a pedal has a key."""
        application = QCoreApplication.instance()
        if application is None or bool(self.keys) == self._is_installed:
            return
        self._is_installed = bool(self.keys)
        if self._is_installed:
            application.installEventFilter(self)
        else:
            application.removeEventFilter(self)

    def eventFilter(self, _watched: QObject, event: QEvent) -> bool:
        if event.type() not in (QEvent.Type.KeyPress, QEvent.Type.KeyRelease) or not isinstance(event, QKeyEvent):
            return False
        name = key_name(event)
        pedal = next((p for p in ALL_PEDALS if self.keys.get(p.name) == name), None)
        popup = QApplication.activePopupWidget()
        target = QApplication.focusWidget() or QApplication.activeWindow() if popup is None else popup.focusWidget() or popup
        if pedal is None or target is None or _types(target, event):
            return False
        # A pedal that is held down repeats its key; one press counts once.
        if not event.isAutoRepeat():
            self._act(pedal, target, event.type())
        return True

    def _act(self, pedal: Pedal, target: QWidget, kind: QEvent.Type) -> None:
        action = self._actions[pedal.name]
        if target.window() is self.parent():
            if kind is QEvent.Type.KeyPress and action.isEnabled():
                action.trigger()
            return
        text = {Key.Key_Space: " ", Key.Key_N: "n"}.get(pedal.key, "")
        meant = QKeyEvent(kind, pedal.key, Qt.KeyboardModifier.NoModifier, text)
        if not _types(target, meant):
            QCoreApplication.sendEvent(target, meant)


def _types(target: QWidget, event: QKeyEvent) -> bool:
    """Whether a widget uses a key as text input, as text fields do."""
    question = QKeyEvent(QEvent.Type.ShortcutOverride, event.key(), event.modifiers(), event.text())
    # An event starts as accepted.
    question.ignore()
    QCoreApplication.sendEvent(target, question)
    return question.isAccepted()


class PedalField(QKeySequenceEdit):
    """Records the next key."""

    def __init__(self, pedal: Pedal) -> None:
        super().__init__()
        self.setMaximumSequenceLength(1)
        self.setAccessibleName(f"pedal for {pedal.title}")

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Leave Escape to the dialog."""
        if event.key() == Key.Key_Escape:
            event.ignore()
        else:
            super().keyPressEvent(event)


class PedalsDialog(Dialog):
    """Sets and removes the keys of pedals; each change takes effect at once."""

    def __init__(self, pedals: Pedals, parent: QWidget | None = None) -> None:
        super().__init__("Pedals", parent)
        self.setMinimumWidth(640)
        self._pedals = pedals
        self.fields = {pedal.name: PedalField(pedal) for pedal in ALL_PEDALS}
        self.forget = {pedal.name: QPushButton("Forget") for pedal in ALL_PEDALS}
        self.outcome = secondary_label(wrap=True)
        grid = QGridLayout()
        grid.setColumnStretch(1, 1)
        for row, pedal in enumerate(ALL_PEDALS):
            title = QLabel(pedal.title)
            set_bold(title)
            forget = self.forget[pedal.name]
            forget.setAccessibleName(f"forget the pedal for {pedal.title}")
            for column, widget in enumerate((title, secondary_label(pedal.what), self.fields[pedal.name], forget)):
                grid.addWidget(widget, row, column)
            self.fields[pedal.name].editingFinished.connect(lambda pedal=pedal: self._set_key(pedal))
            forget.clicked.connect(lambda _=False, pedal=pedal: self._forget_key(pedal))
        about = secondary_label("Click a field, then press the pedal. Its key must have no other use.", wrap=True)
        self.fill(about, grid, self.outcome)
        self._show_keys()
        self.fields["space"].setFocus()

    def _set_key(self, pedal: Pedal) -> None:
        key = self.fields[pedal.name].keySequence().toString(PORTABLE_FORMAT)
        if not key or key == self._pedals.keys.get(pedal.name):
            return
        refusal = self._pedals.set_key(pedal.name, key)
        self._show_keys()
        if refusal:
            self.outcome.setText(f"\N{BALLOT X} {refusal}")
            return
        self.outcome.setText(f"\N{CHECK MARK} {key} is the pedal for {pedal.title}.")
        self.button().setFocus()

    def _forget_key(self, pedal: Pedal) -> None:
        self._pedals.forget_key(pedal.name)
        self.outcome.setText(f"{pedal.title} has no pedal now.")
        self.fields[pedal.name].setFocus()
        self._show_keys()

    def _show_keys(self) -> None:
        for pedal in ALL_PEDALS:
            key = self._pedals.keys.get(pedal.name, "")
            self.fields[pedal.name].setKeySequence(QKeySequence(key))
            self.forget[pedal.name].setEnabled(bool(key))
