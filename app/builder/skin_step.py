"""Step 4: the skin: number of values, polarity, layout; a touch marks the channels that answer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from PySide6.QtWidgets import QFileDialog, QLabel, QLineEdit, QStackedWidget, QWidget

from app.builder.fields import button, choice, count_field, row_of, set_silently, show_choice
from app.builder.live_row import LiveRow
from app.builder.step import Step
from app.dialogs.form_widgets import number_field
from app.panels.layouts import make_form, make_row
from app.panels.widgets import secondary_label
from skincal.files.layout_sources import (
    GRID_ROWS_OR_COLUMNS_MAX,
    LAYOUT_ENDINGS,
    MAX_LAYOUT_CHANNELS,
    MAX_MODULES,
    Grid,
    parse_layout,
    read_layout_file,
    repeated_modules,
    text_with_kind,
)
from skincal.model.errors import InputError
from skincal.model.readings import Stream
from skincal.model.skin import MODULE_KINDS, SkinKind
from skincal.model.skin_axes import AXES_PER_TAXEL
from skincal.part.draft_preview import PartPreview
from skincal.part.layout_placing import middle_of
from skincal.part.part_draft import MM_DIGITS, AnchorDraft, layout_file_of, pushes_of, rounded
from skincal.part.touch_watch import TouchWatch, default_threshold
from skincal.streams.expected_readings import ExpectedReadings
from skincal.words.layout_words import layout_size, unsaid_kind_finding
from skincal.words.units import TIMES

POLARITY_CHOICES = {"up": "values rise", "down": "values fall"}
AXES_CHOICES = {"1": "one value", "3 N": "three values: x, y, z in N", "3": "three values: x, y, z, raw"}
"""Words by number and unit of the values of a taxel."""
LAYOUT_CHOICES = {
    "none": "none: the guide searches for the taxels",
    "file": "a file: .toml, .ini of iCub, table of positions",
    "grid": "a grid of taxels",
    "modules": "modules of one kind, edge to edge",
    "paxini": "PaXini modules, by your package paxini-sdk",
}
SKIN_CHOICES = {
    SkinKind.BOARD.value: "rigid boards: circuit boards, triangles",
    SkinKind.SHEET.value: "a soft sheet: foam, fabric, rubber",
}
LAYOUT_FILES = f"Layout ({' '.join(LAYOUT_ENDINGS)});;All files (*)"
KIND_NAMES = {"triangle_12": "triangle, 12 taxels (iCub, first skin)", "triangle_10pad": "triangle, 10 taxels (iCub, V2)"}
UNSAID_KIND = " The file does not say what the skin is: it is taken for rigid boards."
TOUCH_HINT = "Optional: connect the skin, keep hands off for a second, then press it. The channels that answer are marked."

NO_WIDTH_HINT = "To read the skin here, first choose a layout or type how many values a frame has."


class SkinStep(Step):
    """Channels and layout."""

    name = "skin"
    tab = "Skin"
    title = "Skin"
    hint = "How many values a frame of the skin has, and where its taxels lie relative to each other."

    def __init__(self) -> None:
        super().__init__()
        self.channels = count_field("values of a skin frame", 0, MAX_LAYOUT_CHANNELS)
        self.channels.setSpecialValueText("as the layout")
        self.channels.valueChanged.connect(lambda n: self.change(replace(self.draft, channels=n or None), "channels"))
        self.polarity = choice("values under pressure", POLARITY_CHOICES)
        self.polarity.activated.connect(lambda _: self.change(replace(self.draft, polarity=self.polarity.currentData())))
        self.axes = choice("values of a taxel", AXES_CHOICES)
        self.axes.activated.connect(lambda _: self._choose_axes())
        self.layout_kind = choice("layout", LAYOUT_CHOICES)
        self.layout_kind.activated.connect(lambda _: self._choose_kind())
        self._kind = "none"
        self.material = choice("what the skin is", SKIN_CHOICES)
        self.material.activated.connect(lambda _: self._choose_material())
        self._material: SkinKind | None = None
        self.pages = QStackedWidget()
        pages = QWidget(), self._make_file_page(), self._make_grid_page(), self._make_modules_page(), self._make_paxini_page()
        self.pages_by_kind = dict(zip(LAYOUT_CHOICES, pages, strict=True))
        for page in pages:
            self.pages.addWidget(page)
        self.found = QLabel(wordWrap=True)
        choices = ("V&alues a frame", self.channels), ("A taxel has", self.axes), ("Under pressure", self.polarity)
        self.form = make_form(*choices, ("Layo&ut", self.layout_kind), self.pages, ("The skin &is", self.material), self.found)
        self.live = LiveRow(Stream.SKIN)
        self.live.read.connect(self._take_frames)
        self.again = button("&Forget the touch", run=self._forget_touch)
        self.again.setVisible(False)
        self.touched = secondary_label(TOUCH_HINT, wrap=True)
        self.use_polarity = button("Use this: they fall", run=self._use_polarity)
        self.use_polarity.setVisible(False)
        self.threshold = secondary_label("", wrap=True)
        self.threshold.setVisible(False)
        self.use_threshold = button("Us&e this threshold", run=self._use_threshold)
        self.use_threshold.setVisible(False)
        touch = self.touched, self.threshold, self.live, row_of(self.again, self.use_polarity, self.use_threshold)
        self.fill(self.form, *touch)
        self._watch: TouchWatch | None = None
        self._falls = False
        self._proposed = 0.0

    def _make_file_page(self) -> QWidget:
        page = QWidget()
        self.file = QLineEdit()
        self.file.editingFinished.connect(self._take_typed)
        self.file.setAccessibleName("layout file")
        choose = button("Choose\N{HORIZONTAL ELLIPSIS}", "choose: layout file", self.choose_file)
        make_row((self.file, 1), choose, within=page, margins=0)
        return page

    def _make_grid_page(self) -> QWidget:
        page = QWidget()
        self.rows, self.columns = (
            count_field(name, 1, GRID_ROWS_OR_COLUMNS_MAX) for name in ("rows of the grid", "columns of the grid")
        )
        self.pitch = number_field("spacing of the grid", " mm", 1000.0, 2)
        self.pitch.setMinimum(0.1)
        for box, value in ((self.rows, 4), (self.columns, 4), (self.pitch, 10)):
            box.setValue(value)
            box.valueChanged.connect(self._use_grid)
        row = row_of(QLabel("rows"), self.rows, QLabel("columns"), self.columns, QLabel("every"), self.pitch)
        row.setContentsMargins(0, 0, 0, 0)
        page.setLayout(row)
        return page

    def _make_modules_page(self) -> QWidget:
        page = QWidget()
        self.kind = choice("kind of module", {kind: KIND_NAMES.get(kind, kind) for kind in MODULE_KINDS})
        self.kind.activated.connect(lambda _: self._use_modules())
        self.strips, self.in_strip = (count_field(name, 1, MAX_MODULES) for name in ("strips", "modules in a strip"))
        self.in_strip.setValue(4)
        for box in (self.strips, self.in_strip):
            box.valueChanged.connect(self._use_modules)
        strips = row_of(self.strips, QLabel("of"), self.in_strip, QLabel("modules"))
        make_form(("Kin&d", self.kind), ("Strips", strips), within=page, margins=0)
        return page

    def _make_paxini_page(self) -> QWidget:
        page = QWidget()
        self.paxini, self.paxini_sdk = QLineEdit(), QLineEdit()
        self.paxini.setAccessibleName("PaXini modules")
        self.paxini.setPlaceholderText("part code, model or number of taxels; several with commas")
        self.paxini_sdk.setAccessibleName("package paxini-sdk")
        self.paxini_sdk.setPlaceholderText("the installed package")
        self.paxini.returnPressed.connect(self.use_paxini)
        choose = button("Choose\N{HORIZONTAL ELLIPSIS}", "choose: wheel of paxini-sdk", self._choose_paxini_sdk)
        self.read_points = button("&Read the points", run=self.use_paxini)
        package = make_row((self.paxini_sdk, 1), choose, margins=0)
        make_form(("&Modules", self.paxini), ("Packa&ge", package), ("", row_of(self.read_points)), within=page, margins=0)
        return page

    def update_fields(self, preview: PartPreview) -> None:
        draft = preview.draft
        set_silently(self.channels, draft.channels or 0)
        self.channels.setSuffix("" if draft.axes == 1 else f" {TIMES} {draft.axes}")
        show_choice(self.polarity, draft.polarity)
        show_choice(self.axes, f"{draft.axes} {draft.skin_unit}".strip())
        if not draft.layout_text:
            self._kind = "file" if self._kind == "file" else "none"
        elif self._kind == "none":
            self._kind = "file"
            self.file.setText(draft.layout_name)
        show_choice(self.layout_kind, self._kind)
        self.pages.setCurrentWidget(self.pages_by_kind[self._kind])
        layout = preview.layout
        self.found.setText("")
        self.form.setRowVisible(self.material, layout is not None)
        if layout is not None:
            show_choice(self.material, layout.kind.value)
            unsaid = UNSAID_KIND if unsaid_kind_finding(layout) else ""
            self.found.setText(f"{layout_size(layout)}, channels up to {layout.width - 1}.{unsaid}")
        width = draft.channels or (0 if layout is None else layout.width)
        self.live.setEnabled(width > 0)
        if self._watch is None:
            self.touched.setText(TOUCH_HINT if width else NO_WIDTH_HINT)
        self.live.expect(ExpectedReadings(max(1, width) * draft.axes))

    def _choose_axes(self) -> None:
        axes, _, unit = str(self.axes.currentData()).partition(" ")
        self._forget_touch()
        self.change(replace(self.draft, axes=int(axes), skin_unit=unit))

    def _choose_kind(self) -> None:
        self._kind, self._material = str(self.layout_kind.currentData()), None
        self.pages.setCurrentWidget(self.pages_by_kind[self._kind])
        # Its button asks for a file: the arrow keys pass through this entry.
        if self._kind == "none":
            self.change(replace(self.draft, layout_text="", layout_name="", anchor=None))
        elif self._kind == "grid":
            self._use_grid()
        elif self._kind == "modules":
            self._use_modules()

    def _choose_material(self) -> None:
        """Take the operator's word on what the skin is; it holds until another layout is chosen."""
        self._material = SkinKind(self.material.currentData())
        if self.draft.layout_text:
            self.change(replace(self.draft, layout_text=text_with_kind(self.draft.layout_text, self._material)))

    def choose_file(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Layout", "", LAYOUT_FILES)
        if path:
            self.take_file(Path(path))

    def _take_typed(self) -> None:
        text = self.file.text().strip()
        if text and self.file.isModified():
            self.file.setModified(False)
            self.take_file(Path(text).expanduser())

    def take_file(self, path: Path) -> None:
        with self.report_failure():
            text = read_layout_file(path)
            self._kind, self._material = "file", None
            self.file.setText(str(path))
            self._use(text)

    def _choose_paxini_sdk(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Wheel of paxini-sdk", "", "Wheel (*.whl);;All files (*)")
        if path:
            self.paxini_sdk.setText(path)

    def use_paxini(self) -> None:
        """Take the layout of the named PaXini modules, whose taxels measure three axes in newtons."""
        from skincal.files.paxini_points import layout_text, read_modules  # other skins do without

        package = self.paxini_sdk.text().strip()
        with self.report_failure():
            names = [name for name in self.paxini.text().split(",") if name.strip()]
            if not names:
                raise InputError("Modules names no module; expected a part code, a model or a number of taxels.")
            text = layout_text(read_modules(names, Path(package).expanduser() if package else None))
            self._material = None
            draft = replace(self.draft, channels=None, axes=AXES_PER_TAXEL, skin_unit="N", polarity="up")
            self.change(replace(draft, layout_text=text, anchor=self._kept_anchor(text)))

    def _use_grid(self) -> None:
        self._use(Grid(self.rows.value(), self.columns.value(), self.pitch.value()).layout_text(), "grid")

    def _use_modules(self) -> None:
        with self.report_failure():
            kind = str(self.kind.currentData())
            self._use(repeated_modules(kind, self.strips.value(), self.in_strip.value()), "modules")

    def _use(self, text: str, merge: str = "") -> None:
        """Take another layout; its middle stays where the old one's point was."""
        text = text if self._material is None else text_with_kind(text, self._material)
        self.change(replace(self.draft, layout_text=text, anchor=self._kept_anchor(text)), merge)

    def _kept_anchor(self, text: str) -> AnchorDraft | None:
        anchor = self.draft.anchor
        if anchor is None:
            return None
        middle = middle_of(parse_layout(text, layout_file_of(self.draft)))
        return replace(anchor, at_mm=rounded(middle * 1e3, MM_DIGITS))

    # A touch

    def _take_frames(self, frames: list[np.ndarray]) -> None:
        if not frames:
            return
        frames = pushes_of(self.draft, frames)
        if self._watch is None:
            self._watch = TouchWatch(len(frames[0]), self.draft.skin_unit or self.live.skin_unit)
        for frame in frames:
            self._watch.feed(frame)
        if not self._watch.is_ready:
            self.touched.setText("Hands off: the values at rest are read.")
            return
        touch = self._watch.touch()
        self.again.setVisible(True)
        self.touched.setText(touch.sentence())
        self._falls = touch.falls
        differs = len(touch.channels) > 0 and touch.falls != (self.draft.polarity == "down")
        self.use_polarity.setText(f"Use this: they {'fall' if touch.falls else 'rise'}")
        self.use_polarity.setVisible(differs)
        self._show_threshold()
        before = self.answered
        if before is None or not np.array_equal(before, touch.channels):
            self.answered = touch.channels
            self.picture_changed.emit()

    def _show_threshold(self) -> None:
        """Compare noise and touch with the threshold of the part, and propose another one if it does not fit."""
        found = None if self._watch is None else self._watch.threshold()
        self.threshold.setVisible(found is not None)
        self.use_threshold.setVisible(False)
        if found is None or self._watch is None:
            return
        unit = self._watch.unit
        used = self.draft.response_min or default_threshold(unit)
        self.threshold.setText(found.sentence(used, unit))
        self._proposed = found.proposed
        self.use_threshold.setVisible(found.is_clear and not found.fits(used))

    def _use_threshold(self) -> None:
        self.change(replace(self.draft, response_min=self._proposed))
        self._show_threshold()

    def _use_polarity(self) -> None:
        self.use_polarity.setVisible(False)
        self.change(replace(self.draft, polarity="down" if self._falls else "up"))

    def _forget_touch(self) -> None:
        self._watch, self.answered = None, None
        self.again.setVisible(False)
        self.touched.setText(TOUCH_HINT)
        self.use_polarity.setVisible(False)
        self._show_threshold()
        self.picture_changed.emit()

    def leave(self) -> None:
        super().leave()
        self._forget_touch()
