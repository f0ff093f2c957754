"""The page where a part is described in six steps, with the 3D view at its side.

The state is one frozen `PartDraft` with its history. A change makes another draft. `PartPreviewer` previews it in a thread,
and the newest result is shown. Widgets decide nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from PySide6.QtCore import QEvent, QObject, Qt, QTimer, Signal
from PySide6.QtGui import QKeyEvent, QKeySequence, QShortcut
from PySide6.QtWidgets import (
    QAbstractSpinBox,
    QButtonGroup,
    QFrame,
    QLabel,
    QLineEdit,
    QSplitter,
    QStackedWidget,
    QStyle,
    QToolButton,
    QWidget,
)

from app.builder.check_step import CheckStep
from app.builder.fields import button, take_typed
from app.builder.joints_step import JointsStep
from app.builder.part_step import PartStep
from app.builder.place_step import PlaceStep
from app.builder.sensor_step import SensorStep
from app.builder.skin_step import SkinStep
from app.builder.step import Step
from app.panels.layouts import make_column, make_row, scrolled
from app.panels.widgets import escape_tooltip, theme_colours
from app.scene3d.draft_state import DraftPicture, DraftStatic
from app.scene3d.draft_view import DraftView3D
from app.session.opening import Addresses
from app.text_size import scaled
from app.theme import WIDGET_GAP_PX
from app.workers.threads import ThreadService
from skincal.model.errors import InputError
from skincal.part.draft_preview import PartPreview, PartPreviewer, completed_draft
from skincal.part.draft_summary import State, can_start, summarize, why_not_simulated
from skincal.part.part_changes import with_part_file
from skincal.part.part_draft import DraftHistory, PartDraft, open_draft, save_draft
from skincal.part.tool_draft import Rig

FIELDS_COLUMN_WIDTH_PX = 500  # Width of the side with the fields at 100 %
UNDO_BUTTON_WIDTH_PX = 36
FINDINGS_SHOWN_MAX = 3


class BuilderPage(QWidget):
    """The page; call `build_view` once it is on the screen."""

    start_wanted = Signal(object, object)
    """`Path` of the saved scene, and the `Addresses` that were named on the page."""
    try_wanted = Signal(object)  # `Path` of the saved scene, to be poked by a simulated hand
    failed = Signal(str)  # Sentence on what cannot be done
    left = Signal()

    def __init__(self, scenes: Path, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.history = DraftHistory()
        self.angles: dict[str, float] = {}
        self.preview: PartPreview | None = None
        self.view = DraftView3D()
        self.joints, self.skin, self.place, self.check = JointsStep(), SkinStep(), PlaceStep(), CheckStep(scenes)
        self.sensor = SensorStep()
        self.steps: tuple[Step, ...] = (PartStep(), self.sensor, self.joints, self.skin, self.place, self.check)
        self._saved = self.history.now
        self._previewer, self._threads = PartPreviewer(), ThreadService("draft", self)
        self._is_busy = self._must_repeat = False
        self._warned_step: Step | None = None  # The step whose missing things Next has said
        self._when_settled: Callable[[], object] | None = None  # Waits until the newest change is previewed
        self._arrange()
        self._connect()
        self.show_step(self.steps[0])

    # Widgets

    def _arrange(self) -> None:
        self.tabs, self.stack = QButtonGroup(self), QStackedWidget()
        for number, step in enumerate(self.steps, start=1):
            tab = QToolButton()
            tab.setCheckable(True)
            tab.setProperty("choice", True)
            tab.setStyleSheet("padding: 3px 4px")
            # Not the button's own shortcut, which each new text removes.
            QShortcut(QKeySequence(f"Alt+{number}"), self, partial(self._show_numbered, number))
            self.tabs.addButton(tab, number - 1)
            area = scrolled(step)
            # The colour of the card around it.
            for widget in (step, area.viewport()):
                widget.setAutoFillBackground(False)
            area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
            self.stack.addWidget(area)
        self.findings = QLabel(wordWrap=True)
        self.findings.setAccessibleName("findings of this step")
        self.undo_button = button("\N{LEFTWARDS ARROW WITH HOOK}", "undo (Ctrl+Z)", self.undo)
        self.redo_button = button("\N{RIGHTWARDS ARROW WITH HOOK}", "redo (Ctrl+Y)", self.redo)
        for each in (self.undo_button, self.redo_button):
            each.setEnabled(False)
        self.leave_button, self.start = button("&Close", run=self.left.emit), button("Save and s&tart", run=self.save_and_start)
        self.back = button("\N{LEFTWARDS ARROW} &Back", run=partial(self._go, -1))
        self.next = button("Ne&xt", run=partial(self._go, 1))
        buttons = self.undo_button, self.redo_button, self.leave_button, 1, self.back, self.next, self.start
        self._side = side = QFrame()
        side.setObjectName("card")
        tabs = make_row(*self.tabs.buttons(), 1, gap=2)
        make_column(tabs, (self.stack, 1), self.findings, make_row(*buttons), within=side, gap=WIDGET_GAP_PX)
        self.across = QSplitter(Qt.Orientation.Horizontal, self, childrenCollapsible=False, handleWidth=WIDGET_GAP_PX)
        self.across.addWidget(self.view)
        self.across.addWidget(side)
        self.across.setStretchFactor(0, 1)
        make_column(self.across, within=self, margins=WIDGET_GAP_PX)
        self._fit_fields()
        for field in (*self.findChildren(QAbstractSpinBox), *self.findChildren(QLineEdit)):
            field.installEventFilter(self)

    def _fit_fields(self) -> None:
        """Make the side as wide as its widest step and the names of all steps need with this text."""
        for each in (self.undo_button, self.redo_button):
            each.setFixedWidth(scaled(UNDO_BUTTON_WIDTH_PX))
        bar = self.style().pixelMetric(QStyle.PixelMetric.PM_ScrollBarExtent)
        self.stack.setMinimumWidth(max(step.minimumSizeHint().width() for step in self.steps) + bar)
        column = self._side.layout()
        assert column is not None
        column.activate()
        wanted = max(scaled(FIELDS_COLUMN_WIDTH_PX), column.minimumSize().width())
        if wanted != self._side.minimumWidth():
            self._side.setMinimumWidth(wanted)
            self.across.setSizes([10_000, wanted])

    def changeEvent(self, event: QEvent) -> None:
        super().changeEvent(event)
        if event.type() == QEvent.Type.FontChange:
            # The widgets in the page get their font after it.
            QTimer.singleShot(0, self, self._fit_fields)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Take a typed number before a key with Alt acts, which leaves the focus in its field."""
        if (
            event.type() == QEvent.Type.ShortcutOverride
            and isinstance(event, QKeyEvent)
            and event.modifiers() == Qt.KeyboardModifier.AltModifier
        ):
            take_typed(watched)
        return False

    def _connect(self) -> None:
        self.tabs.idClicked.connect(lambda index: self.show_step(self.steps[index]))
        for step in self.steps:
            step.changed.connect(self.change)
            step.angles_changed.connect(self.turn_joints)
            step.picture_changed.connect(self.show_picture)
            step.failed.connect(self.failed)
        view, place = self.view, self.place
        view.point_picked.connect(lambda point: self.open_step.take_point(point))
        view.link_picked.connect(lambda link: self.open_step.take_link(link))
        view.drag_started.connect(place.start_drag)
        view.layout_dragged.connect(place.drag_to)
        view.turn_started.connect(place.start_turn)
        view.missed.connect(place.show_missed)
        self.check.try_wanted.connect(self.save_and_try)
        view.layout_turned.connect(place.turn)
        for keys, run in (("Ctrl+Z", self.undo), ("Ctrl+Y", self.redo), ("Ctrl+Shift+Z", self.redo)):
            QShortcut(QKeySequence(keys), self, run)

    # The draft

    def build_view(self) -> None:
        """Start to build the 3D view; call once the page is on the screen."""
        self.recolour()
        self.view.build_scene(DraftStatic())
        self._request()

    def open_scene(self, path: Path) -> None:
        """Change an existing scene.

        Raises InputError: it cannot be changed here.
        """
        self._set_history(DraftHistory(now=open_draft(path)))
        self._saved = self.history.now

    def take_part(self, path: Path) -> None:
        """Start with a mesh or a URDF.

        Raises InputError: it cannot be read.
        """
        self.change(with_part_file(self.history.now, path))

    @property
    def is_changed(self) -> bool:
        """Whether the draft was not saved."""
        return self.history.now != self._saved

    def change(self, draft: PartDraft, merge: str = "") -> None:
        """Replace the draft; changes of one kind in a row are undone together."""
        self._set_history(self.history.changed(draft, merge))

    def undo(self) -> None:
        self._set_history(self.history.undone())

    def redo(self) -> None:
        self._set_history(self.history.redone())

    def _set_history(self, history: DraftHistory) -> None:
        self.history = history
        for step in self.steps:
            step.draft = history.now
        self.undo_button.setEnabled(bool(history.past))
        self.redo_button.setEnabled(bool(history.future))
        self._request()

    def turn_joints(self, angles: Mapping[str, float]) -> None:
        """Show other angles of joints, rad, by name."""
        self.angles.update(angles)
        self._request()

    def _request(self) -> None:
        """Preview the newest draft in the thread. During a preview only the newest draft waits."""
        if self._is_busy:
            self._must_repeat = True
            return
        self._is_busy, self._must_repeat = True, False
        draft, angles = self.history.now, dict(self.angles)
        self._threads.submit(lambda: self._previewer.preview(draft, angles), self._take_preview, ended=self._finish)

    def _finish(self) -> None:
        self._is_busy = False
        if self._must_repeat:
            self._request()
        elif self._when_settled is not None:
            run, self._when_settled = self._when_settled, None
            run()

    @property
    def is_settled(self) -> bool:
        """Whether the newest draft is shown."""
        return not self._is_busy and self.preview is not None and self.preview.draft == self.history.now

    def _take_preview(self, preview: PartPreview) -> None:
        self.preview = preview
        for step in self.steps:
            step.show_preview(preview)
        self._show_tabs()
        self._show_findings()
        self.show_picture()

    def show_picture(self) -> None:
        """Show the newest result in the 3D view, as the open step needs it."""
        if self.preview is not None:
            step = self.open_step
            self.view.set_mode(step.mode)
            shown = DraftPicture(self.preview, step.name, step.module, step.points, step.answered, step.turn_handle())
            self.view.show_picture(shown)

    # Steps

    @property
    def open_step(self) -> Step:
        return self.steps[max(0, self.stack.currentIndex())]

    def show_step(self, step: Step) -> None:
        self.open_step.leave()
        self._warned_step = None
        self.stack.setCurrentIndex(self.steps.index(step))
        step.enter()
        self._show_tabs()
        self._show_findings()
        self.show_picture()

    def _show_numbered(self, number: int) -> None:
        """Open the step with this number; if it has nothing to decide, say why."""
        step = self.steps[number - 1]
        if step in self._shown_steps():
            self.show_step(step)
        else:
            self.findings.setText(f"\N{BULLET} {step.absent}")

    def _go(self, way: int) -> None:
        """Open the next step, after a note on missing things, or the one before."""
        steps, needed = self._shown_steps(), self._needed(self.open_step)
        if way > 0 and needed and self._warned_step is not self.open_step:
            self._warned_step = self.open_step
            self.findings.setText(f"\N{BALLOT X} {needed[0]} Press Next again to do it later.")
            return
        at = steps.index(self.open_step) + way
        if 0 <= at < len(steps):
            self.show_step(steps[at])
            self.open_step.setFocus()

    def _needed(self, step: Step | None = None) -> list[str]:
        """List what is missing or wrong, of one step or of all, so that nothing can start."""
        lines = () if self.preview is None else summarize(self.preview)
        return [line.text for line in lines if line.state is State.NEEDED and (step is None or line.step == step.name)]

    def _shown_steps(self) -> list[Step]:
        preview = self.preview
        return [step for step in self.steps if step is self.open_step or preview is None or step.applies(preview)]

    def _show_tabs(self) -> None:
        shown = self._shown_steps()
        preview = self.preview
        states: dict[str, State] = {}
        for line in () if preview is None else summarize(preview):
            order = (State.COMPLETE, State.OPTIONAL, State.NEEDED)
            states[line.step] = max(states.get(line.step, State.COMPLETE), line.state, key=order.index)
        signs = {State.COMPLETE: " \N{CHECK MARK}", State.OPTIONAL: "", State.NEEDED: ""}
        for index, step in enumerate(self.steps):
            tab = self.tabs.button(index)
            tab.setEnabled(step in shown)
            tab.setToolTip("" if step in shown else escape_tooltip(step.absent))
            tab.setText(f"{index + 1} {step.tab}{signs[states.get(step.name, State.OPTIONAL)]}")
            tab.setChecked(step is self.open_step)
        self._fit_fields()
        at = shown.index(self.open_step)
        self.back.setEnabled(at > 0)
        is_last = at == len(shown) - 1
        self.next.setVisible(not is_last)
        self.start.setVisible(is_last)
        self.start.setEnabled(preview is not None and can_start(preview))
        needed = self._needed()
        self.start.setToolTip(escape_tooltip(needed[0]) if needed else "")

    def _show_findings(self) -> None:
        preview = self.preview
        if preview is None or self.open_step is self.check:
            self.findings.setText("")
            return
        problem = preview.problems.get(self.open_step.name)
        lines = [f"\N{BALLOT X} {problem}"] if problem else []
        found = preview.findings.get(self.open_step.name, ())
        sign = "\N{BULLET}" if self.open_step.name == "part" else "\N{BLACK UP-POINTING TRIANGLE}"
        lines += [f"{sign} {sentence}" for sentence in found if sentence not in (problem or "")][:FINDINGS_SHOWN_MAX]
        self.findings.setText("\n".join(lines))

    # The end

    def save(self) -> Path | None:
        """Write the scene; return its path, or `None` if that failed."""
        if self.preview is None:
            return None
        try:
            saved = save_draft(completed_draft(self.preview), self.check.scene_path())
        except InputError as error:
            self.failed.emit(str(error))
            return None
        self._saved = saved
        self._set_history(self.history.saved_as(saved))
        return saved.source

    def save_then(self, then: Callable[[Path], object]) -> None:
        """Save as soon as the newest change is previewed; call `then` with the scene's path unless that failed."""
        if not self.is_settled:
            self._when_settled = partial(self.save_then, then)
            return
        path = self.save()
        if path is not None:
            then(path)

    def save_and_start(self) -> None:
        """Save, and ask for the devices."""
        self._when_settled = None if self.is_settled else self.save_and_start
        if self.is_settled and self.preview is not None and can_start(self.preview):
            addresses = Addresses(skin=self.skin.live.row.named, joints=self.joints.live.row.named, tool=self._tool_address())
            self.save_then(lambda path: self.start_wanted.emit(path, addresses))

    def _tool_address(self) -> str:
        """Address that the fixed-point test read, for a rig that has a tool."""
        return "" if self.history.now.rig is Rig.BELOW else self.sensor.tool.address

    def save_and_try(self) -> None:
        """Save, and start a session with a simulated hand."""
        self._when_settled = None if self.is_settled else self.save_and_try
        if self.is_settled and self.preview is not None and not why_not_simulated(self.preview):
            self.save_then(self.try_wanted.emit)

    def recolour(self) -> None:
        self.view.set_dark(theme_colours().dark)

    def close_page(self) -> None:
        """Release the 3D view, the thread and all devices."""
        for step in self.steps:
            step.end()
        self._threads.close()
        self.view.close_view()
