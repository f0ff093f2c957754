"""The page on which a session is set up: which scene, which devices and what each says, which folder.

The same page changes the addresses of a session that is open. Links are looked at beside the window, and closed with the page.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from PySide6.QtCore import QPointF, Qt, QTimer, Signal
from PySide6.QtGui import QColor, QKeyEvent, QKeySequence, QPainter, QPen, QPolygonF, QShortcut
from PySide6.QtWidgets import (
    QComboBox,
    QCompleter,
    QDialog,
    QDialogButtonBox,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QScrollArea,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from app.panels.devices import link_sign
from app.panels.widgets import (
    Painted,
    choose_scene,
    choose_session_folder,
    compact_combo,
    digits_font,
    plain_buttons,
    secondary_label,
)
from app.session.opening import Addresses, OpenRequest, check_addresses, server_command
from app.session.previews import CURVE_POINTS, Preview, Previews, places_here
from app.session.recording import stop_all
from app.state.view_state import LinkStatus, link_status
from app.text.outcomes import preview_words
from app.text_size import scaled, set_font
from app.theme import GAP, Colours
from app.workers.threads import ThreadService
from skincal.model.errors import InputError, plain_text, shortened
from skincal.model.readings import Stream
from skincal.model.scene import Scene, load_scene, resource
from skincal.streams.links import parse_address
from skincal.words.units import rate

ADDRESS_HINT = "/dev/ttyUSB0@460800, COM3, socket://host:port or a file"
JOINTS_HINT = "only where the arm's joints are streamed"
NO_DEVICE = "Without any device a simulated rig is poked, and recorded to the folder like any other."
CHANGING = "The recording waits while this page is open, and goes on with what you name. F6 swaps F/T sensor and skin."
WAITS = "The recording of the open session waits while this page is open; Cancel goes on with it, in a new segment."
NOT_AGREED = "this session names it, not you: Enter connects"
LATER = "the line asks before the first poke"
LABELS = {Stream.WRENCH: "F/&T sensor", Stream.SKIN: "S&kin", Stream.JOINTS: "&Joints"}
SWAP_KEY = "F6"
LOOK_MS = 100
"""Ten looks a second: a hand that presses sees its own curve."""
CURVE_PX = 120, 26
VERDICT_PX = 34
WIDTH_PX = 700
MOST_PX = 1200, 660
"""What is larger, with large text, scrolls: a screen of 1280 x 720 shows all of it."""
NAME_MOST = 80
"""Letters of a port's own name."""
PLACES_SHOWN = 12


def shipped_scenes() -> list[tuple[str, Path]]:
    """Return name and file of every scene that ships with skincal."""
    try:
        folder = resource("scenes")
    except InputError:
        return []
    return [(path.parent.name, path) for path in sorted(folder.glob("*/scene.toml"))]


class Curve(Painted):
    """The newest values of a stream, as high as the widget."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self._values: tuple[float, ...] = ()
        self.setFixedSize(*CURVE_PX)
        self.setAccessibleName(name)

    def set(self, values: tuple[float, ...]) -> None:
        """Show values, the newest last."""
        if values != self._values:
            self._values = values
            self.setAccessibleDescription(f"{values[-1]:.3g}" if values else "")
            self.update()

    def paint(self, painter: QPainter, colours: Colours) -> None:
        """Paint them from the right."""
        if len(self._values) < 2:
            return
        painter.setPen(QPen(QColor(colours.line), 1.0))
        painter.drawRect(self.rect().adjusted(0, 0, -1, -1))
        low, high = min(self._values), max(self._values)
        room, step = self.height() - 6.0, (self.width() - 6.0) / (CURVE_POINTS - 1)
        span, right = high - low or 1.0, self.width() - 3.0
        last = len(self._values) - 1
        points = [QPointF(right - step * (last - i), 3 + room * (high - v) / span) for i, v in enumerate(self._values)]
        painter.setPen(QPen(QColor(colours.accent), 1.5))
        painter.drawPolyline(QPolygonF(points))


class StreamRow(QWidget):
    """One stream: a field with a list of what is there, and what its link brings."""

    agreed = Signal()
    """The operator named an address, or agreed to the one that stands there."""

    def __init__(self, stream: Stream) -> None:
        super().__init__()
        self.stream = stream
        self.label = QLabel(LABELS[stream])
        self.box = compact_combo(f"address of the {stream.value}")
        self.box.setEditable(True)
        self.box.setInsertPolicy(QComboBox.InsertPolicy.NoInsert)
        self.box.setMaxVisibleItems(PLACES_SHOWN)
        self.box.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.field = self.box.lineEdit() or QLineEdit()
        self.field.setPlaceholderText(JOINTS_HINT if stream is Stream.JOINTS else ADDRESS_HINT)
        # What is half typed would be another address, completed.
        self.box.setCompleter(QCompleter([], self))
        self.label.setBuddy(self.box)
        self.sign = QLabel()
        self.sign.setProperty("rich", True)
        self.verdict = QLabel()
        self.verdict.setWordWrap(True)
        # Room for two lines from the first: nothing jumps as words come and go.
        self.verdict.setMinimumHeight(scaled(VERDICT_PX))
        self.verdict.setAlignment(Qt.AlignmentFlag.AlignTop)
        self.verdict.setAccessibleName(f"what is found of the {stream.value}")
        self.rate = QLabel()
        set_font(self.rate, digits_font(11), 11)
        self.curve = Curve(f"newest values of the {stream.value}")
        self.named = ""
        """The address that is agreed to; it may be connected."""
        self._typed = False
        self.field.textEdited.connect(self._type)
        self.field.returnPressed.connect(self.agree)
        self.field.editingFinished.connect(self.leave)
        self.box.activated.connect(self._choose)

    @property
    def address(self) -> str:
        """What stands in the field."""
        return self.field.text().strip()

    def put(self, address: str, *, agreed: bool) -> None:
        """Have an address stand in the field."""
        self.box.setEditText(address)
        self._typed, self.named = False, address if agreed else ""

    def offer(self, places: Sequence[tuple[str, str]]) -> None:
        """List addresses with what is known of each; the field stays as it is."""
        text, at = self.field.text(), self.field.cursorPosition()
        self.box.clear()
        for address, what in places:
            self.box.addItem("   ".join(filter(None, (plain_text(address), shortened(plain_text(what), NAME_MOST)))), address)
        self.box.setCurrentIndex(-1)
        self.box.setEditText(text)
        self.field.setCursorPosition(at)

    def show_words(self, look: LinkStatus | None, words: str) -> None:
        """Show what is found, in words and by a sign."""
        self.sign.setText("" if look is None else link_sign(look))
        if words != self.verdict.text():
            self.verdict.setText(words)
            # A screen reader in the field says it, too.
            self.field.setAccessibleDescription(words)

    def show_preview(self, preview: Preview, now_ns: int) -> None:
        """Show what a link brings."""
        health = preview.health
        self.show_words(link_status(health, now_ns), preview_words(health))
        self.rate.setText(rate(health.rate))
        self.curve.set(preview.curve)

    def clear(self, words: str = "") -> None:
        """Show that nothing is looked at, and why."""
        self.show_words(None, words)
        self.rate.setText("")
        self.curve.set(())

    def agree(self) -> None:
        """Take what stands in the field for named."""
        self._typed = False
        self.named = self.address
        self.agreed.emit()

    def _type(self) -> None:
        self._typed = True

    def leave(self) -> None:
        """Take what was typed for named; who only passes through the field names nothing."""
        if self._typed:
            self.agree()

    def _choose(self, index: int) -> None:
        address = self.box.itemData(index)
        if address:
            self.box.setEditText(str(address))
            self.agree()


class NewSessionDialog(QDialog):
    """Gathers an `OpenRequest` and checks it before it is emitted; of an open session the addresses alone.

    Parameters
    ----------
    known : addresses that the operator named or agreed to before
    present : the addresses of the session that is open, and its scene, where these are to be changed
    waits : whether the recording of the session that is open waits for this page
    """

    request_chosen = Signal(object)
    addresses_chosen = Signal(object, object)
    """`Addresses`, and the set of those that the operator named or agreed to."""
    _scene: Scene | None = None

    def __init__(
        self,
        scene: Path | None,
        folder: Path,
        parent: QWidget | None = None,
        known: Collection[str] = (),
        present: tuple[Addresses, Scene] | None = None,
        *,
        waits: bool = False,
    ) -> None:
        super().__init__(parent)
        self.setWindowTitle("New session" if present is None else "Device addresses")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self._known, self._present = tuple(known), present
        self._waits, self._note = waits, secondary_label(wrap=True)
        self.scene = QComboBox()
        self.scene.setEditable(True)
        self.scene.setAccessibleName("scene")
        for name, path in shipped_scenes():
            self.scene.addItem(name, str(path))
        if scene is not None:
            index = self.scene.findData(str(scene))
            self.scene.setCurrentIndex(index) if index >= 0 else self.scene.setEditText(str(scene))
        self.rows = {stream: StreamRow(stream) for stream in Stream}
        self.fields = {stream.value: row.field for stream, row in self.rows.items()}
        self.pose_label = QLabel("Arm &pose")
        self.pose = compact_combo("arm pose")
        self.pose_label.setBuddy(self.pose)
        self.folder = QLineEdit(str(folder))
        self.browse_scene, self.browse_folder = (QPushButton("Choose\N{HORIZONTAL ELLIPSIS}") for _ in range(2))
        self.swap = QPushButton(f"&Swap F/T sensor and skin  ({SWAP_KEY})")
        self.objection = QLabel()
        self.objection.setWordWrap(True)
        buttons = QDialogButtonBox.StandardButton
        self.buttons = QDialogButtonBox(buttons.Ok | buttons.Cancel)
        previews = self._previews = Previews()
        # Also where the window goes while the page is open.
        self.destroyed.connect(lambda: previews.let_go())
        self._look_for, self._read = (ThreadService(name, self) for name in ("places", "set-up"))
        self._arrange()
        self._connect()
        self._begin()

    def _arrange(self) -> None:
        inner = QWidget()
        form = QGridLayout(inner)
        form.setColumnStretch(2, 1)
        form.setVerticalSpacing(GAP // 2)
        new = self._present is None
        if new:
            _add_row(form, "Sc&ene", self.scene, self.browse_scene)
        for row in self.rows.values():
            at = form.rowCount()
            form.addWidget(row.label, at, 0)
            form.addWidget(row.box, at, 1, 1, 3)
            form.addWidget(row.sign, at + 1, 1, Qt.AlignmentFlag.AlignTop)
            form.addWidget(row.verdict, at + 1, 2)
            side = QHBoxLayout()
            side.addWidget(row.rate)
            side.addWidget(row.curve)
            form.addLayout(side, at + 1, 3, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignTop)
        at = form.rowCount()
        form.addWidget(self.swap, at, 1, 1, 3, Qt.AlignmentFlag.AlignLeft)
        form.addWidget(self.pose_label, at + 1, 0)
        form.addWidget(self.pose, at + 1, 1, 1, 3)
        if new:
            _add_row(form, "&Folder", self.folder, self.browse_folder)
        self._show_note()
        form.addWidget(self._note, form.rowCount(), 0, 1, 4)
        form.addWidget(self.objection, form.rowCount(), 0, 1, 4)
        form.setRowStretch(form.rowCount(), 1)
        self._finish(inner)

    def _finish(self, inner: QWidget) -> None:
        """Put the form into what scrolls where the screen is too low, with the buttons below."""
        self.area = QScrollArea()
        self.area.setWidgetResizable(True)
        self.area.setFrameShape(QScrollArea.Shape.NoFrame)
        self.area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.area.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.area.setWidget(inner)
        start = self.buttons.button(QDialogButtonBox.StandardButton.Ok)
        start.setText("St&art" if self._present is None else "&Use these")
        plain_buttons(self.buttons)
        for button in self.findChildren(QPushButton):
            button.setAutoDefault(False)
        column = QVBoxLayout(self)
        column.addWidget(self.area, 1)
        column.addWidget(self.buttons)
        height = inner.sizeHint().height() + self.buttons.sizeHint().height() + 8 * GAP
        self.resize(min(scaled(WIDTH_PX), MOST_PX[0]), min(height, MOST_PX[1]))
        start.setFocus()

    def _connect(self) -> None:
        self.browse_scene.clicked.connect(lambda: choose_scene(self.scene, self))
        self.browse_folder.clicked.connect(lambda: choose_session_folder(self.folder, self))
        self.buttons.accepted.connect(self._try)
        self.buttons.rejected.connect(self.reject)
        self.swap.clicked.connect(self.swap_addresses)
        QShortcut(QKeySequence(SWAP_KEY), self, self.swap_addresses)
        for row in self.rows.values():
            row.agreed.connect(self._look_at_addresses)
            row.field.textChanged.connect(self._follow_pose)
            row.field.textChanged.connect(self._show_note)
        self.scene.currentTextChanged.connect(self._read_scene)
        self._timer = QTimer(self)
        self._timer.setInterval(LOOK_MS)
        self._timer.timeout.connect(self._look)

    def _begin(self) -> None:
        self._offer([])
        self._look_for.submit(places_here, self._offer, lambda _: None)
        if self._present is None:
            self._read_scene()
            return
        given, scene = self._present
        for stream, row in self.rows.items():
            address = getattr(given, stream.value)
            row.put(address, agreed=address in self._known)
        self._take_scene(scene)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Leave Enter in a field to the field: it connects, and starts nothing; in that of the folder it starts."""
        field = isinstance(self.focusWidget(), QLineEdit | QComboBox) and self.focusWidget() is not self.folder
        if field and event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            event.accept()
            return
        super().keyPressEvent(event)

    def _show_note(self) -> None:
        rig = "" if any(row.address for row in self.rows.values()) else NO_DEVICE
        words = f"{rig} {WAITS if self._waits else ''}".strip()
        self._note.setText(words if self._present is None else CHANGING)

    # What is there, and what it says

    def _offer(self, places: list[tuple[str, str]]) -> None:
        named = [(address, "used before") for address in self._known if address not in dict(places)]
        for row in self.rows.values():
            row.offer([*places, *reversed(named)])

    def _scene_file(self) -> Path:
        # Not the box's index, which stays as it was when another text is typed.
        index = self.scene.findText(self.scene.currentText())
        return Path(self.scene.itemData(index) if index >= 0 else self.scene.currentText())

    def _read_scene(self) -> None:
        """Read the scene beside the window: it says how many values a skin has, and whether there is an arm."""
        self._read.renew()
        path = self._scene_file()
        self._read.submit(lambda: load_scene(path), self._take_scene, lambda why: self._take_scene(None, why))

    def _take_scene(self, scene: Scene | None, why: str = "") -> None:
        self._scene = scene
        self._object(why)
        self.pose.clear()
        poses = () if scene is None or scene.arm is None else tuple(scene.arm.poses)
        if len(poses) > 1 and self._present is None:
            self.pose.addItem(LATER, "")
            for name in poses:
                self.pose.addItem(plain_text(name), name)
        self._follow_pose()
        self._look_at_addresses()

    def _follow_pose(self) -> None:
        """Ask for the arm's pose where nothing else says it."""
        named = self.rows[Stream.WRENCH].address and not self.rows[Stream.JOINTS].address
        for widget in (self.pose_label, self.pose):
            widget.setVisible(bool(named and self.pose.count()))

    def _look_at_addresses(self) -> None:
        """Look at what the operator named, beside the window."""
        named = {stream: row.named for stream, row in self.rows.items() if row.named and _refusal(row.named) == ""}
        self._previews.choose(named, self._scene)
        if named:
            self._timer.start()
        self._look()

    def _look(self) -> None:
        found = self._previews.look()
        for stream, row in self.rows.items():
            preview = found.get(stream)
            if preview is not None and row.address == row.named:
                row.show_preview(preview, preview.now_ns)
            elif row.address and not row.named and self._present is not None:
                row.clear(NOT_AGREED)
            else:
                row.clear(_refusal(row.named) if row.named else "")

    def swap_addresses(self) -> None:
        """Have F/T sensor and skin change places."""
        wrench, skin = self.rows[Stream.WRENCH], self.rows[Stream.SKIN]
        for row in (wrench, skin):
            row.leave()
        first, second = (wrench.address, wrench.named), (skin.address, skin.named)
        for row, (address, named) in ((wrench, second), (skin, first)):
            row.put(address, agreed=bool(named) and address == named)
        self._look_at_addresses()

    # The end

    def addresses(self) -> Addresses:
        """Return what stands in the fields; InputError where a device that a poke needs is missing, or none that is known."""
        given = Addresses(*(self.fields[name].text().strip() for name in ("wrench", "skin", "joints")))
        check_addresses(given)
        if self._present is not None and not given:
            raise InputError("No device is named; expected the addresses of both the wrench and the skin.")
        return given

    def request(self) -> OpenRequest:
        """Return what was chosen.

        Raises
        ------
        InputError
            The scene cannot be used, or one of the two devices that a poke needs is missing.
        """
        scene = self._scene_file()
        load_scene(scene)
        given = self.addresses()
        pose = "" if self.pose.isHidden() else str(self.pose.currentData() or "")
        folder = Path(self.folder.text())
        return OpenRequest(scene=scene, addresses=given, server=server_command(scene), folder=folder, pose=pose)

    def _try(self) -> None:
        try:
            chosen = self.request() if self._present is None else self.addresses()
        except InputError as error:
            self._object(str(error))
            return
        # A click need not take the focus out of a field.
        for row in self.rows.values():
            row.leave()
        agreed = {row.named for row in self.rows.values() if row.named == row.address} - {""}

        def leave() -> None:
            self.accept()
            if isinstance(chosen, OpenRequest):
                self.request_chosen.emit(chosen)
            else:
                self.addresses_chosen.emit(chosen, agreed)

        self._close_links(leave)

    def _object(self, sentence: str) -> None:
        self.objection.setText(f"\N{BALLOT X} {sentence}" if sentence else "")
        if sentence:
            self.area.ensureWidgetVisible(self.objection)

    def _close_links(self, then: Callable[[], None]) -> None:
        """Go on once every link is closed: the session opens the same ports."""
        self._timer.stop()
        readers = self._previews.let_go()
        if not readers:
            then()
            return
        self.buttons.button(QDialogButtonBox.StandardButton.Ok).setEnabled(False)
        self._read.renew()
        self._read.submit(lambda: stop_all(readers), lambda _: then())

    def done(self, result: int) -> None:
        """Close every link with the page."""
        self._timer.stop()
        self._previews.let_go()
        for service in (self._look_for, self._read):
            service.close(0.0)
        super().done(result)


def _refusal(address: str) -> str:
    """Return why an address cannot be one; empty where it can."""
    try:
        parse_address(address)
    except InputError as error:
        return str(error)
    return ""


def _add_row(form: QGridLayout, text: str, field: QWidget, button: QPushButton) -> None:
    label = QLabel(text)
    label.setBuddy(field)
    at = form.rowCount()
    form.addWidget(label, at, 0)
    row = QHBoxLayout()
    row.addWidget(field, 1)
    row.addWidget(button)
    form.addLayout(row, at, 1, 1, 3)
