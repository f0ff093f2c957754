"""Base of the panels in the tabs: a panel redraws only after something it shows has changed."""

from __future__ import annotations

from enum import Enum

from PySide6.QtCore import QSettings, Signal
from PySide6.QtWidgets import QScrollArea

from app.state.view_state import ViewState

COMPARED_BY_VALUE = (bool, int, float, str, bytes, Enum, type(None))
"""Types compared by value; all else by identity, since `==` on a value with arrays compares every number."""


class Panel(QScrollArea):
    """One tab. A subclass names in `depends_on` all that it shows, and shows it in `update_view`."""

    taxel_wanted = Signal(int)
    """Select this channel in every view."""
    poke_wanted = Signal(int)
    """Show this poke in the list of pokes."""
    action_wanted = Signal(object)
    """Do this `Action` on the session."""
    command_wanted = Signal(str)
    """Run the command with this name."""

    def __init__(self) -> None:
        super().__init__()
        self._state: ViewState | None = None
        self._shown: tuple[object, ...] = ()

    def depends_on(self, state: ViewState) -> tuple[object, ...]:
        raise NotImplementedError

    def update_view(self, state: ViewState) -> None:
        raise NotImplementedError

    def show_state(self, state: ViewState) -> None:
        """Show a tick; nothing is redrawn while all that the panel depends on is the same."""
        self._state = state
        wanted = self.depends_on(state)
        if not is_same(wanted, self._shown):
            self._shown = wanted
            self.update_view(state)

    def show_again(self) -> None:
        """Redraw the newest tick, for example in other colours."""
        self._shown = ()
        if self._state is not None:
            self.show_state(self._state)

    recolour = show_again

    def restore(self, settings: QSettings) -> None:
        """Restore the choices of the last session."""

    def save(self, settings: QSettings) -> None:
        """Save the choices for the next session."""


def is_same(first: tuple[object, ...], second: tuple[object, ...]) -> bool:
    """Compare two tuples: plain values by value, objects by identity."""
    if len(first) != len(second):
        return False
    return all(
        a is b or (isinstance(a, COMPARED_BY_VALUE) and type(a) is type(b) and a == b)
        for a, b in zip(first, second, strict=True)
    )
