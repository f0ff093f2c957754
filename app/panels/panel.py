"""Base of the panels in the tabs: a panel redraws only after something that it shows has changed."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from PySide6.QtCore import QSettings, Signal
from PySide6.QtGui import QHideEvent, QShowEvent
from PySide6.QtWidgets import QScrollArea, QVBoxLayout

from app.panels.layouts import Item, Margins, make_column
from app.panels.widgets import panel_scroll_area
from app.state.memo import is_same
from app.state.view_state import ViewState

if TYPE_CHECKING:
    from skincal.files.reference import TaxelPositions
    from skincal.following.guided_session import GuidedSession


class Panel(QScrollArea):
    """One tab. A subclass names in `depends_on` everything that it shows, and shows it in `update_view`.

    It is made from the followers of the session, which last as long as the session.
    """

    title: ClassVar[str]
    """Text of the tab."""
    taxel_wanted = Signal(int)  # Select this channel in every view
    poke_wanted = Signal(int)  # Show this poke in the list of pokes
    action_wanted = Signal(object)  # Do this `Action` on the session
    command_wanted = Signal(str)  # Run the command with this name
    follow_wanted = Signal()  # Follow the session again: the panel needs something else from now on
    comparison_changed = Signal(object)  # Show this `Comparison` in the 3D view; `None` for the estimates
    message_ready = Signal(str)  # Tell this to the operator
    seen = Signal(bool)  # It is on the screen from now on, or no longer

    def __init__(self, _guided: GuidedSession | None = None) -> None:
        super().__init__()
        self.setAccessibleName(self.title)
        self._state: ViewState | None = None
        self._shown: tuple[object, ...] = ()

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        self.seen.emit(True)

    def hideEvent(self, event: QHideEvent) -> None:
        super().hideEvent(event)
        # A minimized window is seen again at any moment.
        if not event.spontaneous():
            self.seen.emit(False)

    def fill(self, *items: Item, margins: Margins = 0, gap: int | None = None) -> QVBoxLayout:
        """Put items below each other in the panel, as `make_column`."""
        return make_column(*items, within=panel_scroll_area(self), margins=margins, gap=gap)

    def depends_on(self, state: ViewState) -> tuple[object, ...]:
        raise NotImplementedError

    def update_view(self, state: ViewState) -> None:
        raise NotImplementedError

    def show_state(self, state: ViewState) -> None:
        """Show a tick; nothing is redrawn before a value in `depends_on` changes."""
        self._state = state
        wanted = self.depends_on(state)
        if not is_same(wanted, self._shown):
            self._shown = wanted
            self.update_view(state)

    def show_again(self) -> None:
        """Redraw the newest tick, for example in other colours; a hidden panel does so when it is shown."""
        self._shown = ()
        if self._state is not None and self.isVisible():
            self.show_state(self._state)

    def recolour(self) -> None:
        self.show_again()

    def add_reference(self, reference: TaxelPositions) -> None:
        """Offer known positions of the taxels to compare with."""

    def restore(self, settings: QSettings) -> None:
        """Restore the choices of the last session."""

    def save(self, settings: QSettings) -> None:
        """Save the choices for the next session."""
