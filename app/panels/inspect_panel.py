"""The panel of one taxel: its estimates by each method and its pokes; and the taxels that need pokes most."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QGridLayout,
    QLabel,
    QListWidget,
    QListWidgetItem,
    QPushButton,
    QScrollArea,
    QVBoxLayout,
    QWidget,
)

from app.panels.axis_diversity_panel import AxisDiversityPanel
from app.panels.texts import embolden, on_panel, put, put_rows, put_taxels, quiet, table
from app.state.policies import mark_of, worst
from app.state.view_state import ViewState
from app.text.errors_text import DOUBT_MARKED, FULL, TaxelPoke, rival_words, taxel_pokes
from app.text.guidance_text import needs_words
from app.text.outcomes import MARK_WORDS, METHOD_NAMES, find_estimate
from app.theme import GAP, Colours
from app.units import DASH, ChannelNames, count, direction, millimetres, number, point_mm
from skincal.sentences import state_sentence
from skincal.taxels.result import Estimate, Method, State

ROWS = ("Position, mm", "Predicted error", "Worst direction", "\N{PLUS-MINUS SIGN} along it", "Contacts", "State")
POKE_HEADINGS = ("Poke", "Weight k", "Trust", "Axis off by")
_POKE_HINTS = (
    "Number of the poke; a double click shows it in the list of pokes",
    "The taxel's answer in shares of the strongest in the poke: its weight in the solution",
    "How far the method believes the poke for this taxel: 1 counts fully",
    "Distance of the poke's axis from the estimate",
)
LEFT_OUT = (
    "The predicted error carries the noise of force, moment and touch. It leaves out wrong frames, a wrong arm chain, a "
    "wrong mesh and errors of the F/T matrix, which shift all taxels together."
)


def estimate_cells(estimate: Estimate | None) -> tuple[str, ...]:
    """Return the cells of `ROWS` for one estimate."""
    if estimate is None:
        return (DASH,) * len(ROWS)
    return (
        point_mm(estimate.position),
        millimetres(estimate.rms),
        direction(estimate.weakest),
        millimetres(estimate.sd),
        str(estimate.contacts),
        MARK_WORDS[mark_of(estimate)],
    )


def distance_words(first: Estimate | None, second: Estimate | None) -> str:
    """Return how far the two methods lie apart, empty where one of them does not know."""
    if first is None or second is None or first.position is None or second.position is None:
        return ""
    return f"The methods lie {millimetres(float(np.linalg.norm(first.position - second.position)))} apart."


class InspectPanel(QScrollArea):
    """Details of the selected taxel above, the worst below."""

    taxel_wanted = Signal(int)
    mark_dead_requested = Signal(int)
    revive_requested = Signal(int)
    poke_wanted = Signal(int)

    def __init__(self, methods: tuple[Method, ...], names: ChannelNames, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._methods = methods
        self._names = names
        self._shown: tuple[object, ...] = ()
        self._selected: int | None = None
        self._dead = False
        self.title = QLabel("No taxel selected")
        embolden(self.title, 2.0)
        self.cells = {method: [QLabel(DASH) for _ in ROWS] for method in methods}
        self.reason = quiet("Click a taxel on the map or in the 3D view.", wrap=True)
        self.use = QPushButton("Do not use this taxel")
        self.use.setEnabled(False)
        self.diversity = AxisDiversityPanel(names)
        self.rival = QLabel()
        self.rival.setWordWrap(True)
        self.pokes_title = quiet()
        self.pokes = table("pokes of the taxel", POKE_HEADINGS, _POKE_HINTS)
        self.pokes.setMinimumHeight(110)
        self.worst = QListWidget()
        self.worst.setAccessibleName("taxels that need pokes most")
        self._arrange()
        self.use.clicked.connect(self._use_clicked)
        self.worst.itemActivated.connect(self._worst_chosen)
        self.worst.itemClicked.connect(self._worst_chosen)
        self.pokes.itemActivated.connect(lambda item, _column: self.poke_wanted.emit(int(item.text(0))))
        self.setWhatsThis("The selected taxel by each method. " + LEFT_OUT)

    def _arrange(self) -> None:
        grid = QGridLayout()
        grid.setHorizontalSpacing(2 * GAP)
        grid.setVerticalSpacing(2)
        for column, method in enumerate(self._methods, start=1):
            grid.addWidget(quiet(METHOD_NAMES[method]), 0, column)
            grid.setColumnStretch(column, 1)
            for row, label in enumerate(self.cells[method], start=1):
                label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
                label.setWordWrap(True)
                grid.addWidget(label, row, column, Qt.AlignmentFlag.AlignTop)
        for row, text in enumerate(ROWS, start=1):
            grid.addWidget(quiet(text), row, 0, Qt.AlignmentFlag.AlignTop)
        inner = on_panel(self)
        panel = QVBoxLayout(inner)
        panel.setContentsMargins(GAP, GAP, GAP, GAP)
        panel.addWidget(self.title)
        panel.addWidget(self.diversity)
        panel.addLayout(grid)
        for widget in (self.rival, self.reason):
            panel.addWidget(widget)
        panel.addWidget(self.use, 0, Qt.AlignmentFlag.AlignLeft)
        panel.addWidget(self.pokes_title)
        panel.addWidget(self.pokes, 1)
        for empty in (self.diversity, self.rival, self.pokes_title, self.pokes):
            empty.hide()
        panel.addWidget(quiet("Need pokes most"))
        panel.addWidget(self.worst, 1)
        self.worst.setMinimumHeight(110)
        self.setWidget(inner)

    def show_state(self, state: ViewState) -> None:
        """Show the selected taxel of a tick and the worst; nothing happens where they are the same."""
        self.diversity.show_state(state)
        shown = (state.revision, state.method, state.guidance is None, state.selected)
        if shown == self._shown:
            return
        # Another selection changes the details, not the list of the worst.
        changed_worst = shown[:-1] != self._shown[:-1]
        self._shown = shown
        if changed_worst:
            put_taxels(self.worst, [(estimate.channel, self._worst_words(estimate)) for estimate in worst(state.estimates)])
        self._selected = state.selected
        if state.selected is not None:
            self._show_taxel(state, state.selected)

    def set_colours(self, colours: Colours) -> None:
        """Follow the theme."""
        self.diversity.set_colours(colours)

    def _show_taxel(self, state: ViewState, channel: int) -> None:
        found = {method: find_estimate(state.snapshot, method, channel) for method in self._methods}
        put(self.title, f"{self._names.short(channel)}   {self._names.long(channel)}")
        for method, estimate in found.items():
            for label, text in zip(self.cells[method], estimate_cells(estimate), strict=True):
                put(label, text)
        self._dead = channel in state.snapshot.dead
        shown = found.get(state.method)
        reason = state.snapshot.dead.get(channel) or state_sentence(None if shown is None else shown.reason)
        pair = [found.get(method) for method in (Method.FREE, Method.SURFACE)]
        needs = "" if state.guidance is None else needs_words(state.guidance, channel)
        sentences = (reason, distance_words(pair[0], pair[1]), needs and f"It {needs}.")
        put(self.reason, "  ".join(filter(None, sentences)))
        put(self.rival, f"\N{BLACK UP-POINTING TRIANGLE} {rival_words(shown)}")
        self.rival.setVisible(shown is not None and bool(rival_words(shown)))
        self._list_pokes(() if shown is None else taxel_pokes(state.snapshot, shown), state.method)
        put(self.use, "Use this taxel again" if self._dead else "Do not use this taxel")
        self.use.setEnabled(True)

    def _list_pokes(self, pokes: tuple[TaxelPoke, ...], method: Method) -> None:
        """List what each poke counts for the taxel; one that the method doubts has a sign as well."""
        put(self.pokes_title, f"Its pokes by the {METHOD_NAMES[method]} method, newest first")
        for widget in (self.pokes_title, self.pokes):
            widget.setVisible(bool(pokes))
        put_rows(self.pokes, [poke_cells(poke) for poke in pokes])

    def _worst_words(self, estimate: Estimate) -> str:
        name = self._names.short(estimate.channel)
        if estimate.state is State.ESTIMATED:
            return f"{name}   {millimetres(estimate.rms)} predicted error, {count(estimate.contacts, 'contact')}"
        return f"{name}   {MARK_WORDS[mark_of(estimate)]}"

    def _worst_chosen(self, item: QListWidgetItem) -> None:
        self.taxel_wanted.emit(int(item.data(Qt.ItemDataRole.UserRole)))

    def _use_clicked(self) -> None:
        if self._selected is not None:
            (self.revive_requested if self._dead else self.mark_dead_requested).emit(self._selected)


def poke_cells(poke: TaxelPoke) -> tuple[str, ...]:
    """Return the cells of `POKE_HEADINGS`."""
    sign = "\N{CIRCLE WITH LEFT HALF BLACK} " if poke.trust < DOUBT_MARKED else ""
    trust = "1" if poke.trust >= FULL else number(poke.trust, 2)
    return (str(poke.poke), number(poke.weight, 2), sign + trust, millimetres(poke.miss))
