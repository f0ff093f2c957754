"""A panel redraws after a change of what it shows, and only then."""

from __future__ import annotations

import numpy as np
import pytest

from app.panels.panel import Panel, is_same
from app.theme import Choice
from tests.app.window_support import frame

ONE = np.zeros(3)


class Counting(Panel):
    """Counts how often it is drawn."""

    def __init__(self, shown):
        super().__init__()
        self.shown = shown
        self.drawn = 0

    def depends_on(self, _state):
        return self.shown

    def update_view(self, _state):
        self.drawn += 1


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        ((1, "a" * 30, None), (1, "".join(["a"] * 30), None), True),
        ((300,), (int("300"),), True),
        ((ONE,), (ONE,), True),
        ((ONE,), (np.zeros(3),), False),
        ((1,), (True,), False),
        ((1, 2), (1,), False),
        ((Choice.DARK,), (Choice.LIGHT,), False),
    ],
)
def test_plain_values_are_compared_by_value_and_objects_by_identity(first, second, same):
    assert is_same(first, second) is same


def test_it_is_drawn_after_a_change_and_when_it_is_to_be_shown_again(qtbot):
    panel = Counting(("x",))
    qtbot.addWidget(panel)
    panel.show_again()
    assert panel.drawn == 0
    for shown, drawn in ((("x",), 1), (("x",), 1), (("y",), 2)):
        panel.shown = shown
        panel.show_state(frame())
        assert panel.drawn == drawn
    panel.show_again()
    assert panel.drawn == 3
