"""Dialog for a new session: scene, devices with a preview of each, arm pose and folder.

The same dialog changes the addresses of an open session.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from html import escape
from pathlib import Path

import numpy as np
from PySide6.QtCore import Qt, QTimer, Signal
from PySide6.QtGui import QKeyEvent, QKeySequence, QShortcut
from PySide6.QtWidgets import (
    QComboBox,
    QCompleter,
    QDialogButtonBox,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QSizePolicy,
    QWidget,
)

from app.dialogs.dialog import Dialog, StandardButton
from app.dialogs.form_widgets import ScenePicker, Sparkline, path_row
from app.panels.devices import link_sign
from app.panels.layouts import make_row, scrolled
from app.panels.widgets import (
    choose_session_folder,
    compact_combo,
    digits_font,
    escape_tooltip,
    rich_label,
    secondary_label,
    theme_colours,
)
from app.session.opening import Addresses, OpenRequest, check_addresses, check_streams, server_command
from app.session.previews import PREVIEW_CURVE_POINTS, Preview, Previews, list_ports, list_topics, list_trackers
from app.session.recording import stop_all
from app.state.view_state import LinkStatus, link_status
from app.text_size import scaled, set_font
from app.theme import WIDGET_GAP_PX
from app.workers.threads import ThreadService
from skincal.geometry import FloatArray
from skincal.model.errors import InputError, plain_text, plural, shortened
from skincal.model.readings import Stream
from skincal.model.scene import Scene, load_scene
from skincal.part.part import why_not_simulated
from skincal.session.importing import joint_columns
from skincal.streams.decoders.line_parts import PartKind, split_parts
from skincal.streams.links import parse_address
from skincal.streams.ros_topics import FoundTopic, propose_topics
from skincal.words.link_words import STREAM_NAMES, preview_words
from skincal.words.units import rate

ADDRESS_HINT = "/dev/ttyUSB0@460800, COM3, socket://host:port or a file"
HINT_OF_STREAM = {
    Stream.JOINTS: "only if the arm sends its joints",
    Stream.TIP: "only if a robot or a tracker sends its position",
    Stream.TOOL: "poses of the tool: rtde://HOST, ros2:/TOPIC or socket://HOST:PORT",
}
NO_DEVICE = (
    "Without an address, Start records a simulated hand into the folder below. Try it with a simulated hand does the same, and "
    "asks about the folder when the session closes."
)
RECORDING_PAUSED_HERE = (
    "The recording is paused while this dialog is open, and continues with these addresses. F6 exchanges force/torque sensor "
    "and skin."
)
RECORDING_PAUSED = (
    "The recording of the open session is paused while this dialog is open. Cancel continues it in a new segment."
)
TRY_HELP = (
    "Starts a session of this scene at once, also if addresses are named: a simulated hand follows the guide. Its folder is "
    "asked about when it closes. Start does the same without an address, but in the folder of this dialog."
)
NEEDS_CONFIRMATION = "named by the session file: press Enter to connect"
POSE_ASKED_LATER = "choose later, before the first poke"
STREAM_LABELS = {
    Stream.WRENCH: "Force/&torque sensor", Stream.SKIN: "S&kin", Stream.JOINTS: "&Joints", Stream.TIP: "T&ip",
    Stream.TOOL: "Too&l",
}  # fmt: skip
SWAP_KEY = "F6"
LINK_PREVIEW_UPDATE_PERIOD_MS = 100
LINE_FONT_SIZE_PT = 9
LAST_LINE = "Last line"
CURVE_SIZE_PX = 120, 26
CURVE_LEAST_HEIGHTS = {
    Stream.WRENCH: (5.0, "N"), Stream.SKIN: (20.0, "counts"), Stream.JOINTS: (1.0, "\N{DEGREE SIGN}"), Stream.TIP: (2.0, "mm"),
    Stream.TOOL: (2.0, "mm"),
}  # fmt: skip
"""Least height of a small curve, with its unit: more than a sensor at rest moves, less than a hand."""
STATE_TEXT_MIN_HEIGHT_PX = 34  # Two lines, so that nothing moves when text appears
DIALOG_WIDTH_PX = 700
MAX_SIZE_PX = 1200, 660  # A larger form scrolls; a screen of 1280 x 720 shows all of it
MAX_PORT_NAME_CHARS = 80
MAX_LISTED_PORTS = 12


class StreamRow(QWidget):
    """One stream: address field with a list of ports, and the preview of its link."""

    agreed = Signal()  # The operator entered an address or agreed to the shown one

    def __init__(self, stream: Stream) -> None:
        super().__init__()
        name = STREAM_NAMES[stream]
        self.label = QLabel(STREAM_LABELS[stream])
        self.box = compact_combo(f"address of the {name}")
        self.box.setEditable(True)
        self.box.setInsertPolicy(QComboBox.InsertPolicy.NoInsert)
        self.box.setMaxVisibleItems(MAX_LISTED_PORTS)
        self.box.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.field = self.box.lineEdit() or QLineEdit()
        self.field.setPlaceholderText(HINT_OF_STREAM.get(stream, ADDRESS_HINT))
        # No completion: it would turn a half typed address into another one.
        self.box.setCompleter(QCompleter([], self))
        self.label.setBuddy(self.box)
        self.sign = rich_label()
        self.verdict = QLabel(wordWrap=True, alignment=Qt.AlignmentFlag.AlignTop)
        self.verdict.setMinimumHeight(scaled(STATE_TEXT_MIN_HEIGHT_PX))
        self.verdict.setAccessibleName(f"state of the {name}")
        self.line = rich_label(wrap=True)  # Last line of text that gives no readings; hidden without one
        set_font(self.line, digits_font(LINE_FONT_SIZE_PT), LINE_FONT_SIZE_PT)
        self.line.setVisible(False)
        self._shown_line = ""
        self.rate = QLabel()
        set_font(self.rate, digits_font(11), 11)
        self.curve = Sparkline(f"newest values of the {name}")
        self.curve.setFixedSize(*CURVE_SIZE_PX)
        self.curve_height = secondary_label()
        self.curve_height.setToolTip("the height of the curve")
        self._least_height, self._unit = CURVE_LEAST_HEIGHTS[stream]
        self.named = ""  # Address that the operator agreed to, which may be connected
        self._is_typed = False
        self.is_used = True
        self.field.textEdited.connect(self._mark_typed)
        self.field.returnPressed.connect(self.agree)
        self.field.editingFinished.connect(self.agree_if_typed)
        self.box.activated.connect(self._choose_port)

    def add_to(self, form: QGridLayout) -> None:
        """Place the parts of the row in a form of four columns."""
        at = form.rowCount()
        form.addWidget(self.label, at, 0)
        form.addWidget(self.box, at, 1, 1, 3)
        form.addWidget(self.sign, at + 1, 1, Qt.AlignmentFlag.AlignTop)
        form.addWidget(self.verdict, at + 1, 2)
        form.addWidget(self.line, at + 2, 1, 1, 3)
        form.addLayout(
            make_row(self.rate, self.curve, self.curve_height),
            at + 1,
            3,
            Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignTop,
        )

    @property
    def address(self) -> str:
        return self.field.text().strip() if self.is_used else ""

    def set_used(self, used: bool) -> None:
        """Show the row, or hide it because the scene has no use for its stream."""
        self.is_used = used
        for part in (self.label, self.box, self.sign, self.verdict, self.rate, self.curve, self.curve_height):
            part.setVisible(used)
        self.line.setVisible(used and bool(self._shown_line))

    def set_address(self, address: str, *, agreed: bool) -> None:
        self.box.setEditText(address)
        self._is_typed, self.named = False, address if agreed else ""

    def set_ports(self, ports: Sequence[tuple[str, str]]) -> None:
        """List addresses with their descriptions; the field stays unchanged."""
        text, cursor = self.field.text(), self.field.cursorPosition()
        self.box.clear()
        for address, what in ports:
            words = (plain_text(address), shortened(plain_text(what), MAX_PORT_NAME_CHARS))
            self.box.addItem("   ".join(filter(None, words)), address)
        self.box.setCurrentIndex(-1)
        self.box.setEditText(text)
        self.field.setCursorPosition(cursor)

    def show_preview(self, preview: Preview | None, words: str = "") -> None:
        """Show the preview of the link, or `words` without one."""
        look: LinkStatus | None = None
        if preview is not None:
            look, words = link_status(preview.health, preview.now_ns), preview_words(preview.health)
        self.sign.setText("" if look is None else link_sign(look))
        line = "" if preview is None else preview.health.verdict.line
        if (words, line) != (self.verdict.text(), self._shown_line):
            self.verdict.setText(words)
            self._shown_line = line
            self.line.setText(line_markup(line))
            self.line.setVisible(bool(line))
            # A screen reader reads it in the field.
            self.field.setAccessibleDescription(f"{words} {LAST_LINE}: {line}" if line else words)
        curve = () if preview is None else preview.curve
        self.rate.setText("" if preview is None else rate(preview.health.rate))
        height = curve_height(curve, self._least_height)
        # Without its height, the noise of a sensor at rest would look like a press.
        self.curve_height.setText(f"\N{UP DOWN ARROW} {height:g} {self._unit}" if curve else "")
        self.curve.show_curve(scroll_points(curve, height), f"{curve[-1]:.3g} {self._unit}" if curve else "")

    def agree(self) -> None:
        """Accept the address in the field, so that the program may connect to it."""
        self._is_typed = False
        self.named = self.address
        self.agreed.emit()

    def agree_if_typed(self) -> None:
        """Accept an address that was typed; moving through the field accepts nothing."""
        if self._is_typed:
            self.agree()

    def _mark_typed(self) -> None:
        self._is_typed = True

    def _choose_port(self, index: int) -> None:
        address = self.box.itemData(index)
        if address:
            self.box.setEditText(str(address))
            self.agree()


def line_markup(line: str) -> str:
    """Return a line as rich text that colours and counts what is understood of it; empty without a line."""
    if not line:
        return ""
    colours, parts = theme_colours(), split_parts(line)
    style = {
        PartKind.VALUE: f"color:{colours.accent}; font-weight:bold",
        PartKind.NAME: f"color:{colours.warn}",
        PartKind.FRONT: f"color:{colours.muted}",
        PartKind.SEPARATOR: f"color:{colours.muted}",
        PartKind.UNKNOWN: f"color:{colours.bad}; text-decoration:underline",
    }
    counts = Counter(part.kind for part in parts)
    words = [
        plural(counts[kind], noun)
        for kind, noun in ((PartKind.VALUE, "number"), (PartKind.NAME, "name"), (PartKind.UNKNOWN, "unknown part"))
        if counts[kind]
    ]
    shown = "".join(f'<span style="{style[part.kind]}">{escape(part.text)}</span>' for part in parts)
    return f"{LAST_LINE} ({', '.join(words) or 'nothing understood'}):<br>{shown}"


def curve_height(values: Sequence[float], least: float) -> float:
    """Return the range of values that a small curve shows: 1, 2 or 5 times a power of ten, at least `least`."""
    span = max(least, float(np.ptp(np.asarray(values)))) if values else least
    power = 10.0 ** np.floor(np.log10(span))
    # The slack keeps a round range that a rounding made a little too large.
    return float(next(step * power for step in (1.0, 2.0, 5.0, 10.0) if span <= step * power * (1 + 1e-9)))


def scroll_points(values: Sequence[float], height: float) -> FloatArray:
    """Scale values, the newest last, to points (n, 2) from 0 to 1 in a curve of this height; the newest is at the right."""
    if not values:
        return np.empty((0, 2))
    y = np.asarray(values)
    middle = (y.min() + y.max()) / 2.0
    return np.column_stack([1.0 + np.arange(1 - len(y), 1) / (PREVIEW_CURVE_POINTS - 1), 0.5 + (y - middle) / height])


class NewSessionDialog(Dialog):
    """Dialog for scene and devices of a new session, or for the device addresses of an open one.

    Parameters
    ----------
    proposed : scene, folder and addresses to begin with; the operator agreed to these addresses on the page before
    known : addresses that the operator agreed to before
    present : addresses and scene of the open session, to change its addresses
    paused : the recording of the open session is paused for this dialog
    parts : folder of the operator's own parts
    """

    request_chosen = Signal(object)
    addresses_chosen = Signal(object, object)  # `Addresses`, and the set of those that the operator agreed to

    def __init__(
        self,
        proposed: OpenRequest,
        parent: QWidget | None = None,
        known: Collection[str] = (),
        present: tuple[Addresses, Scene] | None = None,
        *,
        paused: bool = False,
        parts: Path | None = None,
    ) -> None:
        title = "New session" if present is None else "Device addresses"
        super().__init__(title, parent, StandardButton.Ok | StandardButton.Cancel)
        self._known, self._present, self._paused = tuple(known), present, paused
        self._scene: Scene | None = None
        self._note = secondary_label(wrap=True)
        self.scene = ScenePicker(proposed.scene, parts)
        self.rows = {stream: StreamRow(stream) for stream in Stream}
        self.fields = {stream.value: row.field for stream, row in self.rows.items()}
        self.pose_label, self.pose = QLabel("Arm &pose"), compact_combo("arm pose")
        self.pose_label.setBuddy(self.pose)
        self.folder = QLineEdit(str(proposed.folder or ""))
        self.proposal = QPushButton()  # Uses the topics of ROS 2 that look like the rig; hidden without them
        self.proposal.setVisible(False)
        # Reason for missing topics of ROS 2; hidden without one
        self.topics_note = QLabel(wordWrap=True, textFormat=Qt.TextFormat.PlainText)
        self.topics_note.setVisible(False)
        self.swap = QPushButton(f"E&xchange force/torque sensor and skin  ({SWAP_KEY})")
        self.objection = QLabel(wordWrap=True)
        previews = self._previews = Previews()
        # Also if the window closes with the dialog open.
        self.destroyed.connect(lambda: previews.stop_readers())
        self._ports: list[tuple[str, str]] = []
        self._topics: list[FoundTopic] = []
        self._trackers: list[tuple[str, str]] | None = None
        """Address and description of trackers; `None` before a scene with a tool is chosen."""
        self._port_search, self._topic_search, self._tracker_search, self._closing = (
            ThreadService(name, self) for name in ("ports", "topics", "trackers", "closing")
        )
        self._arrange()
        self._connect()
        self._set_ports([])
        self._port_search.submit(list_ports, self._set_ports, lambda _: None)
        self._topic_search.submit(list_topics, self._set_topics, lambda _: None)
        if present is None:
            for stream, row in self.rows.items():
                row.set_address(getattr(proposed.addresses, stream.value), agreed=True)
            self.scene.read()
            return
        for stream, row in self.rows.items():
            address = getattr(present[0], stream.value)
            row.set_address(address, agreed=address in self._known)
        self._take_scene(present[1], "")

    def _arrange(self) -> None:
        inner = QWidget()
        form = QGridLayout(inner)
        form.setColumnStretch(2, 1)
        form.setVerticalSpacing(WIDGET_GAP_PX // 2)
        is_new = self._present is None

        def add_row(row: tuple[QLabel, QHBoxLayout]) -> None:
            at = form.rowCount()
            form.addWidget(row[0], at, 0)
            form.addLayout(row[1], at, 1, 1, 3)

        if is_new:
            add_row(path_row("Sc&ene", self.scene, self.scene.choose))
        for row in self.rows.values():
            row.add_to(form)
        form.addWidget(self.proposal, form.rowCount(), 1, 1, 3, Qt.AlignmentFlag.AlignLeft)
        form.addWidget(self.topics_note, form.rowCount(), 1, 1, 3)
        at = form.rowCount()
        form.addWidget(self.swap, at, 1, 1, 3, Qt.AlignmentFlag.AlignLeft)
        form.addWidget(self.pose_label, at + 1, 0)
        form.addWidget(self.pose, at + 1, 1, 1, 3)
        if is_new:
            add_row(path_row("&Folder", self.folder, lambda: choose_session_folder(self.folder, self)))
        self._show_note()
        form.addWidget(self._note, form.rowCount(), 0, 1, 4)
        form.addWidget(self.objection, form.rowCount(), 0, 1, 4)
        form.setRowStretch(form.rowCount(), 1)
        self.area = scrolled(inner)
        self.area.setProperty("frameless", True)
        self.area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        if is_new:
            self.attempt = self.buttons.addButton("Try it with a si&mulated hand", QDialogButtonBox.ButtonRole.ActionRole)
            self.attempt.setToolTip(escape_tooltip(TRY_HELP))
            self.attempt.setAutoDefault(False)
            self.attempt.clicked.connect(self._try_simulated)
        start = self.button(StandardButton.Ok)
        start.setText("St&art" if is_new else "&Use these")
        self.fill((self.area, 1))
        height = inner.sizeHint().height() + self.buttons.sizeHint().height() + 8 * WIDGET_GAP_PX
        self.resize(min(scaled(DIALOG_WIDTH_PX), MAX_SIZE_PX[0]), min(height, MAX_SIZE_PX[1]))
        start.setFocus()

    def _connect(self) -> None:
        self.buttons.accepted.connect(self._try)
        self.swap.clicked.connect(self.swap_addresses)
        self.proposal.clicked.connect(self._use_proposal)
        QShortcut(QKeySequence(SWAP_KEY), self, self.swap_addresses)
        for row in self.rows.values():
            row.agreed.connect(self._choose_previews)
            row.field.textChanged.connect(self._show_pose)
            row.field.textChanged.connect(self._show_note)
        self.scene.scene_read.connect(self._take_scene)
        self._timer = QTimer(self, interval=LINK_PREVIEW_UPDATE_PERIOD_MS)
        self._timer.timeout.connect(self._show_previews)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Connect the device of a field on Enter; in the folder's field, start the session."""
        is_field = isinstance(self.focusWidget(), QLineEdit | QComboBox) and self.focusWidget() is not self.folder
        if is_field and event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            event.accept()
            return
        super().keyPressEvent(event)

    def _show_note(self) -> None:
        words = "" if any(row.address for row in self.rows.values()) else NO_DEVICE
        words = f"{words} {RECORDING_PAUSED if self._paused else ''}".strip()
        self._note.setText(words if self._present is None else RECORDING_PAUSED_HERE)

    @property
    def has_scene(self) -> bool:
        return self._scene is not None

    # Previews

    def _set_ports(self, ports: list[tuple[str, str]]) -> None:
        self._ports = ports
        self._list_addresses()

    def _search_trackers(self) -> None:
        """Search for trackers once: the search sends a broadcast, which other rigs have no use for."""
        if self._trackers is None:
            self._trackers = []
            self._tracker_search.submit(list_trackers, self._set_trackers, lambda _: None)

    def _set_trackers(self, trackers: list[tuple[str, str]]) -> None:
        self._trackers = trackers
        self._list_addresses()

    def _set_topics(self, found: tuple[list[FoundTopic], str]) -> None:
        topics, trouble = found
        self._topics = topics
        self.topics_note.setText(trouble)
        self.topics_note.setVisible(bool(trouble))
        proposed = propose_topics(topics, self._joints())
        names = ", ".join(plain_text(proposed[stream].topic) for stream in Stream if stream in proposed)
        self.proposal.setText(f"Use the &ROS 2 topics {shortened(names, MAX_PORT_NAME_CHARS)}")
        self.proposal.setVisible(bool(proposed))
        self._list_addresses()

    def _list_addresses(self) -> None:
        """List trackers and topics that look like the row's stream, then ports and other topics, then addresses used before."""
        topics = [(each.stream, (each.address, each.words)) for each in self._topics]
        listed = dict([*self._ports, *(self._trackers or ()), *(entry for _, entry in topics)])
        used = [(address, "used before") for address in self._known if address not in listed]
        for stream, row in self.rows.items():
            likely = [entry for of, entry in topics if of is stream]
            likely[:0] = (self._trackers or ()) if stream is Stream.TOOL else ()
            others = [entry for of, entry in topics if of is not stream]
            row.set_ports([*likely, *self._ports, *others, *reversed(used)])

    def _joints(self) -> tuple[str, ...]:
        """Names of the scene's joints; empty without a scene."""
        return () if self._scene is None else joint_columns(self._scene)

    def _use_proposal(self) -> None:
        for stream, topic in propose_topics(self._topics, self._joints()).items():
            self.rows[stream].set_address(topic.address, agreed=True)
        self._choose_previews()

    def _take_scene(self, scene: Scene | None, why: str) -> None:
        """Use the scene's number of channels and its arm."""
        self._scene = scene
        self._show_problem(why)
        self.pose.clear()
        poses = () if scene is None or scene.arm is None else tuple(scene.arm.poses)
        if len(poses) > 1 and self._present is None:
            self.pose.addItem(POSE_ASKED_LATER, "")
            for name in poses:
                self.pose.addItem(plain_text(name), name)
        has_tool = scene is not None and scene.tool is not None
        self.rows[Stream.TOOL].set_used(has_tool)
        if has_tool:
            self._search_trackers()
        has_wrench = scene is None or scene.has_sensor
        self.rows[Stream.WRENCH].set_used(has_wrench)
        self.swap.setVisible(has_wrench)
        for stream in (Stream.JOINTS, Stream.TIP):
            self.rows[stream].set_used(not has_tool)
        self._show_pose()
        self._choose_previews()

    def _show_pose(self) -> None:
        """Ask for the arm pose unless joints are streamed."""
        is_needed = self.rows[Stream.WRENCH].address and not self.rows[Stream.JOINTS].address
        for widget in (self.pose_label, self.pose):
            widget.setVisible(bool(is_needed and self.pose.count()))

    def _choose_previews(self) -> None:
        """Connect to the addresses that the operator confirmed, and show their readings beside the fields."""
        rows = {stream: row for stream, row in self.rows.items() if row.is_used and row.named}
        named = {stream: row.named for stream, row in rows.items() if not _address_problem(row.named)}
        self._previews.choose(named, self._scene)
        if named:
            self._timer.start()
        self._show_previews()

    def _show_previews(self) -> None:
        found = self._previews.update()
        for stream, row in self.rows.items():
            preview = found.get(stream)
            if preview is not None and row.address == row.named:
                row.show_preview(preview)
            elif row.address and not row.named and self._present is not None:
                row.show_preview(None, NEEDS_CONFIRMATION)
            else:
                row.show_preview(None, _address_problem(row.named) if row.named else "")

    def swap_addresses(self) -> None:
        if not self.rows[Stream.WRENCH].is_used:
            return
        wrench, skin = self.rows[Stream.WRENCH], self.rows[Stream.SKIN]
        for row in (wrench, skin):
            row.agree_if_typed()
        first, second = (wrench.address, wrench.named), (skin.address, skin.named)
        for row, (address, named) in ((wrench, second), (skin, first)):
            row.set_address(address, agreed=bool(named) and address == named)
        self._choose_previews()

    # Result

    def addresses(self) -> Addresses:
        """Give the addresses; `InputError` if a needed device is missing or an address has an unknown form."""
        given = Addresses(**{stream.value: row.address for stream, row in self.rows.items()})
        if given and self._scene is not None and self._scene.tool is not None:
            check_streams(given, self._scene)
        check_addresses(given)
        if given and self._scene is not None:
            check_streams(given, self._scene)
        if self._present is not None and not given:
            raise InputError("No device is named. Enter the addresses of force/torque sensor and skin.")
        return given

    def request(self) -> OpenRequest:
        """Give the request.

        Raises
        ------
        InputError
            The scene cannot be used, or a needed device is missing.
        """
        scene = self.scene.file()
        load_scene(scene)
        given = self.addresses()
        pose = "" if self.pose.isHidden() else str(self.pose.currentData() or "")
        folder = Path(self.folder.text())
        return OpenRequest(scene=scene, addresses=given, server=server_command(scene), folder=folder, pose=pose)

    def _try(self) -> None:
        try:
            chosen = self.request() if self._present is None else self.addresses()
        except InputError as error:
            self._show_problem(str(error))
            return
        # A click does not always move the focus out of a field.
        for row in self.rows.values():
            row.agree_if_typed()
        agreed = {row.named for row in self.rows.values() if row.named == row.address} - {""}

        def finish() -> None:
            self.accept()
            if isinstance(chosen, OpenRequest):
                self.request_chosen.emit(chosen)
            else:
                self.addresses_chosen.emit(chosen, agreed)

        self._close_links(finish)

    def _try_simulated(self) -> None:
        """Start a session of the scene without devices, in a folder that is asked about when it closes."""
        try:
            scene = self.scene.file()
            why = why_not_simulated(load_scene(scene))
            if why:
                raise InputError(why)
        except InputError as error:
            self._show_problem(str(error))
            return
        request = OpenRequest(scene=scene, server=server_command(scene))

        def finish() -> None:
            self.accept()
            self.request_chosen.emit(request)

        self._close_links(finish)

    def _show_problem(self, sentence: str) -> None:
        self.objection.setText(f"\N{BALLOT X} {sentence}" if sentence else "")
        if sentence:
            self.area.ensureWidgetVisible(self.objection)

    def _close_links(self, then: Callable[[], None]) -> None:
        """Close every link, then continue: the session opens the same ports."""
        self._timer.stop()
        readers = self._previews.stop_readers()
        if not readers:
            then()
            return
        self.button(StandardButton.Ok).setEnabled(False)
        self._closing.submit(lambda: stop_all(readers), lambda _: then())

    def done(self, result: int) -> None:
        self._timer.stop()
        self._previews.stop_readers()
        self.scene.close_threads()
        for service in (self._port_search, self._topic_search, self._tracker_search, self._closing):
            service.close(0.0)
        super().done(result)


def _address_problem(address: str) -> str:
    """Say why an address has an unknown form; empty if it is fine."""
    try:
        parse_address(address)
    except InputError as error:
        return str(error)
    return ""
