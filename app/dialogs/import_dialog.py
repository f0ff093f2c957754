"""The dialog that makes a session of another program's recording: what it is taken for is seen before anything is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PySide6.QtCore import QPointF, Qt, QTimer, Signal
from PySide6.QtGui import QColor, QFontMetrics, QPainter, QPen, QPolygonF, QShowEvent
from PySide6.QtWidgets import (
    QComboBox,
    QDialog,
    QDialogButtonBox,
    QFileDialog,
    QFormLayout,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QLineEdit,
    QListWidget,
    QProgressBar,
    QPushButton,
    QScrollArea,
    QVBoxLayout,
    QWidget,
)

from app.dialogs.new_session import shipped_scenes
from app.panels.drop_target import DropTarget
from app.panels.widgets import (
    Painted,
    choose_scene,
    choose_session_folder,
    escape_tooltip,
    fit_rows,
    fit_to_screen,
    plain_buttons,
    put_rows,
    secondary_label,
    table,
)
from app.text.import_text import (
    HEADINGS,
    HOLDS_SESSION,
    IMPORTING,
    LOOKING,
    NO_FOLDER,
    NO_RECORDING,
    STOPPING,
    curve_words,
    kind_words,
    stream_row,
)
from app.text_size import scaled
from app.theme import GAP, Colours
from app.workers.processes import JobService, Watch, import_job, look_job
from app.workers.threads import ThreadService
from skincal.files.importers.preview import RecordingFiles, RecordingPreview, guess_streams
from skincal.files.importers.registry import IMPORTERS, RecordedPlace
from skincal.journal.writer import SCENE_FOLDER
from skincal.model.errors import InputError
from skincal.model.readings import Stream
from skincal.model.scene import Scene, load_scene
from skincal.session.importing import STOPPED, Imported, ImportRequest, missing_folders, take_away

SIZE = (760, 680)
"""Pixels at 100 %, where the screen has them."""
LOOK_MS = 400
"""Typing rests for so long before a recording is looked at."""
TOLD_MS = 100
"""Between two looks at how far the import is."""
PATIENCE_MS = 500
"""An import that is stopped ends by itself within this, or by force: one that reads a large log through hears nothing."""
KINDS_OF_FILES = f"Recordings (*{' *'.join(suffix for each in IMPORTERS for suffix in each.suffixes)});;All files (*)"
DOTS = "\N{HORIZONTAL ELLIPSIS}"
TITLES = {Stream.WRENCH: "&Force/torque", Stream.SKIN: "S&kin", Stream.JOINTS: "&Joints"}
HINTS = {
    Stream.WRENCH: "a folder with data.log, or a table",
    Stream.SKIN: "a folder with data.log, or a table",
    Stream.JOINTS: "only where they were recorded",
}


@dataclass(frozen=True, slots=True)
class SessionPlace:
    """What is found where the session is to lie."""

    objection: str
    """Why none can be made there; empty where nothing is known against it."""
    missing: tuple[Path, ...] = ()
    """Folders that are not there yet, the innermost first."""


class ForceCurve(Painted):
    """The force of a recording's first minute: its pokes are seen."""

    def __init__(self) -> None:
        super().__init__()
        self._preview: RecordingPreview | None = None
        self.setAccessibleName("force of the recording")
        self.setMinimumHeight(max(70, scaled(70)))

    def show_preview(self, preview: RecordingPreview | None) -> None:
        """Draw another recording, or nothing."""
        self._preview = preview
        words = "" if preview is None else curve_words(preview)
        self.setAccessibleDescription(words)
        self.setToolTip(escape_tooltip(words))
        self.update()

    def paint(self, painter: QPainter, colours: Colours) -> None:
        """Draw the curve above the words on it."""
        preview = self._preview
        if preview is None:
            return
        letters = QFontMetrics(self.font())
        painter.setPen(QColor(colours.muted))
        words = letters.elidedText(curve_words(preview), Qt.TextElideMode.ElideRight, self.width())
        painter.drawText(self.rect(), Qt.AlignmentFlag.AlignTop | Qt.AlignmentFlag.AlignLeft, words)
        known = np.isfinite(preview.force)
        if known.sum() < 2:
            return
        top, bottom = letters.height() + 2.0, self.height() - 2.0
        times, force = preview.times[known], preview.force[known]
        x = times / max(float(preview.times[-1]), 1e-9) * (self.width() - 2.0) + 1.0
        y = bottom - force / max(float(force.max()), 1e-9) * (bottom - top)
        painter.setPen(QPen(QColor(colours.line), 1.0))
        painter.drawLine(QPointF(0.0, bottom), QPointF(self.width(), bottom))
        painter.setPen(QPen(QColor(colours.accent), 1.5))
        painter.drawPolyline(QPolygonF([QPointF(*at) for at in zip(x.tolist(), y.tolist(), strict=True)]))


class ImportDialog(QDialog):
    """Gathers an `ImportRequest`, shows what the recording holds, and has it imported.

    Parameters
    ----------
    paths : files or a folder that hold the recording; none where they are still to be named
    scene : file of the scene that is proposed
    folder : proposed for the session
    """

    imported = Signal(object, str)
    """`Imported`: the session is there; and the scene's file that was chosen for it."""
    _scene: Scene | None = None
    _scene_trouble = ""
    """Why there is no scene; empty also while it is read."""
    _asks = False
    """The session's folder is looked at, and `_place` is of the one before."""
    _begins = False
    """The import begins once that is done."""
    _share = 0.0
    """Of the import, told in the thread that waits for it."""

    def __init__(self, paths: Sequence[Path], scene: Path, folder: Path, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Import a recording")
        self._jobs = JobService(self)
        self._scenes, self._finds, self._places = (ThreadService(name, self) for name in ("scenes", "recordings", "places"))
        self._preview: RecordingPreview | None = None
        self._trouble = ""
        """Why there is no preview."""
        self._place = SessionPlace("")
        self.importing = False
        self.take_folder, self.take_files = QPushButton(f"A f&older{DOTS}"), QPushButton(f"Fi&les{DOTS}")
        self.fields = {stream: QLineEdit() for stream in TITLES}
        self.form = QWidget()
        self.scene, self.pose, self.folder = QComboBox(), QComboBox(), QLineEdit(str(folder))
        self.kind = secondary_label(wrap=True)
        self.streams = table("streams of the recording", HEADINGS)
        self.curve = ForceCurve()
        self.findings = QListWidget()
        self.objection = QLabel()
        self.progress = QProgressBar()
        standard = QDialogButtonBox.StandardButton
        self.buttons = QDialogButtonBox(standard.Ok | standard.Cancel)
        self.start, self.stop = self.buttons.button(standard.Ok), self.buttons.button(standard.Cancel)
        self._settled, self._watching, self._patience = QTimer(self), QTimer(self), QTimer(self)
        self._fill_scenes(scene)
        self._arrange()
        self._connect()
        self._scene_chosen()
        self._folder_chosen()
        if paths:
            self.take(paths)

    # Making it

    def _fill_scenes(self, scene: Path) -> None:
        self.scene.setEditable(True)
        self.scene.setAccessibleName("scene")
        for name, path in shipped_scenes():
            self.scene.addItem(name, str(path))
        index = self.scene.findData(str(scene))
        self.scene.setCurrentIndex(index) if index >= 0 else self.scene.setEditText(str(scene))

    def _fill_form(self) -> None:
        form = QFormLayout(self.form)
        form.setContentsMargins(0, 0, 0, 0)
        form.addRow("Recording", _row(self.take_folder, self.take_files, secondary_label("or drop it here")))
        for stream, field in self.fields.items():
            field.setPlaceholderText(HINTS[stream])
            form.addRow(*self._with_choice(TITLES[stream], field, lambda field=field: self._choose_file(field)))
        form.addRow(*self._with_choice("&Scene", self.scene, lambda: choose_scene(self.scene, self)))
        label = QLabel("Arm &pose")
        label.setBuddy(self.pose)
        self.pose.setAccessibleName("arm pose")
        form.addRow(label, self.pose)
        form.addRow(*self._with_choice("Session &in", self.folder, lambda: choose_session_folder(self.folder, self)))

    def _arrange(self) -> None:
        self._fill_form()
        self.findings.setWordWrap(True)
        self.findings.setAccessibleName("what was found")
        self.findings.setMinimumHeight(scaled(60))
        self.streams.header().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        self.streams.header().setStretchLastSection(True)
        area = QScrollArea()
        inner = QWidget()
        column = QVBoxLayout(inner)
        column.setContentsMargins(0, 0, GAP, 0)
        for widget in (self.form, self.kind, self.streams, self.curve, self.findings):
            column.addWidget(widget)
        column.addStretch(1)
        area.setFrameShape(QScrollArea.Shape.NoFrame)
        # It follows the focus of what stands in it.
        area.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        area.setWidgetResizable(True)
        area.setWidget(inner)
        self.objection.setWordWrap(True)
        self.progress.setAccessibleName("import")
        self.progress.setRange(0, 1000)
        self.progress.hide()
        self.start.setText("Import")
        plain_buttons(self.buttons)
        outer = QVBoxLayout(self)
        outer.addWidget(area, 1)
        for widget in (self.objection, self.progress, self.buttons):
            outer.addWidget(widget)
        self._show_preview(None)

    def _with_choice(self, title: str, field: QWidget, choose: object) -> tuple[QLabel, QHBoxLayout]:
        label, button = QLabel(title), QPushButton(f"Choose{DOTS}")
        label.setBuddy(field)
        name = title.replace("&", "")
        field.setAccessibleName(name)
        button.setAccessibleName(f"choose: {name}")
        button.clicked.connect(choose)
        row = QHBoxLayout()
        row.addWidget(field, 1)
        row.addWidget(button)
        return label, row

    def _connect(self) -> None:
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        for timer, each_ms, once, do in (
            (self._settled, LOOK_MS, True, self._look),
            (self._watching, TOLD_MS, False, self._show_share),
            (self._patience, PATIENCE_MS, True, self._stop_by_force),
        ):
            timer.setInterval(each_ms)
            timer.setSingleShot(once)
            timer.timeout.connect(do)
        for field in self.fields.values():
            field.textChanged.connect(self._files_changed)
        self.take_folder.clicked.connect(self._choose_recording_folder)
        self.take_files.clicked.connect(self._choose_recording_files)
        self.scene.currentTextChanged.connect(self._scene_chosen)
        self.pose.currentIndexChanged.connect(self._judge)
        self.folder.textChanged.connect(self._folder_chosen)
        dropped = DropTarget(self)
        dropped.recording_dropped.connect(self.take)
        dropped.refused.connect(self._object)
        dropped.request_made.connect(lambda _: self._object(NO_RECORDING))
        self.buttons.accepted.connect(self._import)
        self.buttons.rejected.connect(self.reject)

    def showEvent(self, event: QShowEvent) -> None:
        """Be on the screen as a whole."""
        super().showEvent(event)
        fit_to_screen(self, SIZE)

    # What is chosen

    def take(self, paths: Sequence[Path]) -> None:
        """Take files, or a folder of them: each is taken for the stream that it looks like."""
        if self.importing:
            return
        self.kind.setText(LOOKING)
        self._finds.renew()
        self._finds.submit(lambda: _find(paths), self._found, lambda why: self._looked(None, why))

    def _found(self, found: RecordingFiles) -> None:
        if self.importing:
            return
        for stream, place in zip(self.fields, (found.wrench, found.skin, found.joints), strict=True):
            self.fields[stream].setText("" if place is None else str(place))
        self._settled.stop()
        self._look()

    def files(self) -> RecordingFiles:
        """Return which files are named."""
        places = (RecordedPlace.parse(text) if (text := field.text().strip()) else None for field in self.fields.values())
        return RecordingFiles(*places)

    def _scene_file(self) -> Path:
        # Not the box's index, which stays as it was when another text is typed.
        index = self.scene.findText(self.scene.currentText())
        return Path(self.scene.itemData(index) if index >= 0 else self.scene.currentText())

    def _choose_recording_folder(self) -> None:
        path = QFileDialog.getExistingDirectory(self, "Folder of a recording")
        if path:
            self.take([Path(path)])

    def _choose_recording_files(self) -> None:
        paths, _ = QFileDialog.getOpenFileNames(self, "Files of a recording", "", KINDS_OF_FILES)
        if paths:
            self.take([Path(path) for path in paths])

    def _choose_file(self, field: QLineEdit) -> None:
        path, _ = QFileDialog.getOpenFileName(self, field.accessibleName(), field.text(), KINDS_OF_FILES)
        if path:
            field.setText(path)

    def _files_changed(self) -> None:
        self._jobs.drop()
        self._preview, self._trouble = None, ""
        self._show_preview(None)
        self._settled.start()
        self._judge()

    def _scene_chosen(self) -> None:
        """Read the scene beside the window."""
        self._scene, self._scene_trouble = None, ""
        path = self._scene_file()
        self._scenes.renew()
        self._scenes.submit(lambda: load_scene(path), self._take_scene, lambda why: self._take_scene(None, why))
        self._judge()

    def _take_scene(self, scene: Scene | None, trouble: str = "") -> None:
        """Offer the arm poses of the scene; the only one is taken."""
        self._scene, self._scene_trouble = scene, trouble
        chosen = self.pose.currentText()
        self.pose.clear()
        poses = [] if scene is None or scene.arm is None else list(scene.arm.poses)
        self.pose.addItems(poses if len(poses) == 1 else ["", *poses])
        self.pose.setCurrentText(chosen)
        self._judge()

    def _folder_chosen(self) -> None:
        """Look at the session's folder beside the window: a disk may be slow, and one on a network silent."""
        self._asks, self._begins, text = True, False, self.folder.text().strip()
        self._places.renew()
        self._places.submit(lambda: _place_of(text), self._take_place)

    def _take_place(self, place: SessionPlace) -> None:
        begins, self._begins, self._asks = self._begins, False, False
        self._place = place
        self._judge()
        if begins and self.start.isEnabled():
            self._import()

    # What is seen

    def _look(self) -> None:
        """Look at the files that are named, in a process."""
        self._jobs.drop()
        try:
            files = self.files()
            _ = files.importer
        except InputError as error:
            self._looked(None, str(error) if any(field.text().strip() for field in self.fields.values()) else "")
            return
        self.kind.setText(LOOKING)
        self._jobs.submit(look_job, (files,), self._looked, lambda sentence: self._looked(None, sentence), Watch())

    def _looked(self, preview: RecordingPreview | None, trouble: str = "") -> None:
        self._preview, self._trouble = preview, trouble
        self._show_preview(preview)
        self._judge()

    def _show_preview(self, preview: RecordingPreview | None) -> None:
        self.kind.setText("" if preview is None else kind_words(preview))
        put_rows(self.streams, [] if preview is None else [stream_row(stream) for stream in preview.streams])
        fit_rows(self.streams)
        self.curve.show_preview(preview)
        self.findings.clear()
        self.findings.addItems([] if preview is None else list(preview.findings))
        for widget in (self.streams, self.curve):
            widget.setVisible(preview is not None)
        self.findings.setVisible(self.findings.count() > 0)

    def _objections(self) -> tuple[str, ...]:
        """Return why nothing can be imported yet."""
        preview = self._preview
        pose = "" if self.fields[Stream.JOINTS].text().strip() else self.pose.currentText()
        self.pose.setEnabled(self.pose.count() > 1 and not self.fields[Stream.JOINTS].text().strip())
        if preview is None:
            found = (self._trouble,)
        else:
            found = (self._scene_trouble,) if self._scene is None else preview.misfits(self._scene, pose)
        return (*filter(None, (*found, self._place.objection)),)

    def _judge(self) -> None:
        """Say what is in the way, and enable the import where nothing is."""
        if self.importing:
            return
        found = self._objections()
        self._object(" ".join(found))
        self.start.setEnabled(self._preview is not None and self._scene is not None and not found)

    def _object(self, sentence: str) -> None:
        self.objection.setText(f"\N{BALLOT X} {sentence}")
        self.objection.setVisible(bool(sentence))

    # The import

    def _import(self) -> None:
        if self._asks:
            self._begins = True
            return
        files, folder = self.files(), Path(self.folder.text().strip())
        pose = "" if files.joints is not None else self.pose.currentText()
        request = ImportRequest(files, self._scene_file(), pose, folder)
        missing = self._place.missing
        self._set_importing(True)

        def undo(_result: object = None) -> None:
            take_away(folder, missing)

        self._jobs.submit(import_job, (request,), self._imported, self._failed, Watch(self._hear, undo), undo)

    def _hear(self, share: float) -> None:
        # In another thread, which must not touch a widget.
        self._share = share

    def _set_importing(self, importing: bool) -> None:
        self.importing, self._share = importing, 0.0
        self.form.setEnabled(not importing)
        self.start.setEnabled(not importing)
        self.progress.setVisible(importing)
        self.progress.setValue(0)
        self.progress.setFormat(f"{IMPORTING} %p %")
        self.stop.setText("Stop" if importing else "Cancel")
        self.stop.setEnabled(True)
        if importing:
            self._object("")
            self.stop.setFocus()
            self._watching.start()
        else:
            self._watching.stop()
            self._patience.stop()

    def _show_share(self) -> None:
        self.progress.setValue(round(1000 * self._share))

    def _imported(self, imported: Imported) -> None:
        self._set_importing(False)
        self.imported.emit(imported, str(self._scene_file()))
        self.accept()

    def _failed(self, sentence: str) -> None:
        self._set_importing(False)
        self._judge()
        self._object(sentence)
        self.start.setFocus()

    def reject(self) -> None:
        """Close; an import is stopped first, and what it made is taken away."""
        if self.importing:
            self.stop.setEnabled(False)
            self.progress.setFormat(STOPPING)
            self._jobs.interrupt()
            self._patience.start()
            return
        super().reject()

    def _stop_by_force(self) -> None:
        """End an import that does not end by itself; what it made is taken away beside the window."""
        self._jobs.drop()
        self._failed(STOPPED)

    def done(self, result: int) -> None:
        """Close, and look at nothing any more."""
        self._settled.stop()
        self.end()
        super().done(result)

    def end(self) -> None:
        """End what is done beside the window, by force; of an import nothing is left behind."""
        self._watching.stop()
        self._patience.stop()
        self._jobs.close()
        for service in (self._scenes, self._finds, self._places):
            service.close(0.0)


def _find(paths: Sequence[Path]) -> RecordingFiles:
    try:
        return guess_streams(paths)
    except OSError as error:
        raise InputError(str(error)) from error


def _place_of(text: str) -> SessionPlace:
    """Return whether a session can be made in a folder; in a thread."""
    if not text:
        return SessionPlace(NO_FOLDER)
    folder = Path(text)
    try:
        taken = (folder / SCENE_FOLDER).exists() or any(folder.glob("segment-*"))
        return SessionPlace(HOLDS_SESSION if taken else "", tuple(missing_folders(folder)))
    except (OSError, ValueError) as error:
        return SessionPlace(f"{text}: cannot be looked at ({error}); name another folder.")


def _row(*widgets: QWidget) -> QHBoxLayout:
    row = QHBoxLayout()
    for widget in widgets:
        row.addWidget(widget)
    row.addStretch(1)
    return row
