"""Dialog that imports a recording of another program: first it shows what the recording contains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from PySide6.QtCore import Qt, QTimer, Signal
from PySide6.QtGui import QShowEvent
from PySide6.QtWidgets import (
    QComboBox,
    QCompleter,
    QFileDialog,
    QLabel,
    QLineEdit,
    QListWidget,
    QProgressBar,
    QPushButton,
    QWidget,
)

from app.dialogs.dialog import Dialog, StandardButton
from app.dialogs.form_widgets import BUTTON_ELLIPSIS, FramePicture, ScenePicker, Sparkline, path_row
from app.panels.drop_target import DropTarget
from app.panels.layouts import make_column, make_form, make_row, scrolled
from app.panels.widgets import choose_session_folder, fit_rows, fit_to_screen, put_rows, secondary_label, table
from app.text.import_text import (
    HEADINGS,
    HOLDS_SESSION,
    IMPORTING_TEXT,
    NO_FOLDER,
    NO_RECORDING,
    READING_TEXT,
    STOPPING_TEXT,
    curve_words,
    frame_words,
    kind_words,
    stream_row,
)
from app.text_size import scaled
from app.theme import WIDGET_GAP_PX
from app.workers.processes import JobQueue, import_job, preview_job
from app.workers.threads import ThreadService
from skincal.files.importers.preview import RecordingFiles, RecordingPreview, guess_streams
from skincal.files.importers.registry import RECORDING_IMPORTERS, RecordedPlace, StoppedError
from skincal.geometry import FloatArray
from skincal.journal.writer import SCENE_FOLDER
from skincal.model.errors import InputError
from skincal.model.readings import Stream
from skincal.model.scene import Scene
from skincal.session.importing import Imported, ImportRequest, joint_columns, missing_folders, of_scene, take_away

SIZE_PX = (760, 680)
TYPING_PAUSE_BEFORE_PREVIEW_MS = 400  # A recording is previewed after this pause in typing
PROGRESS_BAR_UPDATE_PERIOD_MS = 100  # Between two updates of the progress bar
KILL_STOPPED_IMPORT_AFTER_MS = 500
"""A stopped import ends within this time, or is killed: while it reads a large log, it does not react."""
FILE_FILTER = f"Recordings (*{' *'.join(suffix for each in RECORDING_IMPORTERS for suffix in each.suffixes)});;All files (*)"
STREAM_TITLES = {Stream.WRENCH: "&Force/torque sensor", Stream.SKIN: "S&kin", Stream.JOINTS: "&Joints", Stream.TOOL: "&Tool"}
STREAM_HINTS = {
    Stream.WRENCH: "a folder with data.log, a table, or BAG::TOPIC",
    Stream.SKIN: "a folder with data.log, a table, or BAG::TOPIC",
    Stream.JOINTS: "optional",
    Stream.TOOL: "poses of the tool: a table, or BAG::TOPIC",
}


class ImportDialog(Dialog):
    """Dialog that previews a recording and imports it as a session.

    Parameters
    ----------
    paths : files or a folder of the recording; empty to choose them here
    scene : file of the proposed scene
    folder : proposed for the session
    parts : folder of the operator's own parts
    """

    imported = Signal(object, str)  # `Imported`, and the file of the chosen scene

    def __init__(
        self, paths: Sequence[Path], scene: Path, folder: Path, parent: QWidget | None = None, parts: Path | None = None
    ) -> None:
        super().__init__("Import a recording", parent, StandardButton.Ok | StandardButton.Cancel)
        self._jobs = JobQueue(self)
        self._finds, self._places = (ThreadService(name, self) for name in ("recordings", "places"))
        self._scene: Scene | None = None
        self._proposed = RecordingFiles()
        self._scene_trouble = ""  # Why there is no scene; empty while it is read
        self._preview: RecordingPreview | None = None
        self._trouble = ""  # Why there is no preview
        self._folder_problem = ""  # Why no session can be created there; empty if nothing is known
        self._missing_folders: Sequence[Path] = ()  # To create for it, the innermost first
        self._place_pending = False  # A check runs; `_folder_problem` is of the folder before
        self._starts_later = False  # The import starts after that check
        self._share = 0.0  # Finished share of the import; written in another thread
        self.importing = False
        self.take_folder, self.take_files = QPushButton(f"F&older{BUTTON_ELLIPSIS}"), QPushButton(f"Fi&les{BUTTON_ELLIPSIS}")
        self.fields = {stream: QLineEdit() for stream in STREAM_TITLES}
        self.form = QWidget()
        self.scene, self.pose, self.folder = ScenePicker(scene, parts), QComboBox(), QLineEdit(str(folder))
        self.kind = secondary_label(wrap=True)
        self.streams = table("streams of the recording", HEADINGS)
        self.curve, self.curve_words = Sparkline("force of the recording"), secondary_label(wrap=True)
        self.frame, self.frame_words = FramePicture("mean frame of the skin"), secondary_label(wrap=True)
        self.findings = QListWidget()
        self.objection = QLabel(wordWrap=True)
        self.progress = QProgressBar(minimum=0, maximum=1000)
        self.start, self.stop = self.button(StandardButton.Ok), self.button(StandardButton.Cancel)
        self._typing = QTimer(self, interval=TYPING_PAUSE_BEFORE_PREVIEW_MS, singleShot=True)
        self._progressing = QTimer(self, interval=PROGRESS_BAR_UPDATE_PERIOD_MS)
        self._patience = QTimer(self, interval=KILL_STOPPED_IMPORT_AFTER_MS, singleShot=True)
        self._arrange()
        self._rows.setRowVisible(self._row_of[Stream.TOOL], False)
        self._connect()
        self._take_preview(None)
        self.scene.read()
        self._check_folder()
        if paths:
            self.assign_files(paths)

    def _arrange(self) -> None:
        rows = {
            stream: path_row(STREAM_TITLES[stream], field, lambda field=field: self._choose_file(field))
            for stream, field in self.fields.items()
        }
        self._row_of = {stream: row for stream, (_, row) in rows.items()}
        self._rows = make_form(
            ("Recording", make_row(self.take_folder, self.take_files, secondary_label("or drop it here"), 1)),
            *rows.values(),
            path_row("&Scene", self.scene, self.scene.choose),
            ("Arm &pose", self.pose),
            path_row("Session &in", self.folder, lambda: choose_session_folder(self.folder, self)),
            within=self.form,
            margins=0,
        )
        for stream, field in self.fields.items():
            field.setPlaceholderText(STREAM_HINTS[stream])
        self.pose.setAccessibleName("arm pose")
        self.findings.setWordWrap(True)
        self.findings.setAccessibleName("remarks")
        self.findings.setMinimumHeight(scaled(60))
        self.curve.setMinimumHeight(max(60, scaled(60)))
        self.frame.setMinimumHeight(max(80, scaled(80)))
        inner = QWidget()
        shown = self.form, self.kind, self.streams, self.curve_words, self.curve, self.frame_words, self.frame, self.findings
        make_column(*shown, 1, within=inner, margins=(0, 0, WIDGET_GAP_PX, 0))
        self.progress.setAccessibleName("import")
        self.progress.hide()
        self.start.setText("Import")
        self.fill((scrolled(inner), 1), self.objection, self.progress)

    def _connect(self) -> None:
        self._typing.timeout.connect(self._request_preview)
        self._progressing.timeout.connect(lambda: self.progress.setValue(round(1000 * self._share)))
        self._patience.timeout.connect(self._kill_import)
        for field in self.fields.values():
            field.textChanged.connect(self._files_changed)
        self.take_folder.clicked.connect(self._choose_recording_folder)
        self.take_files.clicked.connect(self._choose_recording_files)
        self.scene.currentTextChanged.connect(self._scene_changed)
        self.scene.scene_read.connect(self._take_scene)
        self.pose.currentIndexChanged.connect(self._update_problems)
        self.folder.textChanged.connect(self._check_folder)
        dropped = DropTarget(self)
        dropped.recording_dropped.connect(self.assign_files)
        dropped.refused.connect(self._show_problem)
        dropped.request_made.connect(lambda _: self._show_problem(NO_RECORDING))
        self.buttons.accepted.connect(self._start_import)

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        fit_to_screen(self, SIZE_PX)

    # Choices

    def assign_files(self, paths: Sequence[Path]) -> None:
        """Assign files, or those of a folder, to the streams by their content."""
        if self.importing:
            return
        self.kind.setText(READING_TEXT)
        self._finds.renew()
        channels = 0 if self._scene is None else self._scene.skin.frame_width
        joints = () if self._scene is None else joint_columns(self._scene)
        self._finds.submit(
            lambda: _find_streams(paths, channels, joints), self._show_files, lambda why: self._take_preview(None, why)
        )

    def _show_files(self, found: RecordingFiles) -> None:
        if self.importing:
            return
        self._proposed = found
        for stream, path in zip(self.fields, (found.wrench, found.skin, found.joints, found.tool), strict=True):
            self.fields[stream].setText("" if path is None else str(path))
            completer = QCompleter([str(each) for each in found.candidates], self.fields[stream])
            completer.setFilterMode(Qt.MatchFlag.MatchContains)
            self.fields[stream].setCompleter(completer)
        self._typing.stop()
        self._request_preview()

    def files(self) -> RecordingFiles:
        """Give the chosen files; `InputError` if a needed one is missing."""
        texts = (field.text().strip() for field in self.fields.values())
        files = RecordingFiles(*(RecordedPlace.parse(text) if text else None for text in texts))
        # The topics that the operator typed have no others.
        proposed = self._proposed.places.items() & files.places.items()
        others = {stream: self._proposed.others.get(stream, ()) for stream, _ in proposed}
        files = replace(files, tied=self._proposed.tied, others=others)
        # A skin of another width is previewed, too.
        return replace(files, tool=None) if self._scene is None else replace(of_scene(files, self._scene), channels=0)

    def _choose_recording_folder(self) -> None:
        path = QFileDialog.getExistingDirectory(self, "Folder of a recording")
        if path:
            self.assign_files([Path(path)])

    def _choose_recording_files(self) -> None:
        paths, _ = QFileDialog.getOpenFileNames(self, "Files of a recording", "", FILE_FILTER)
        if paths:
            self.assign_files([Path(path) for path in paths])

    def _choose_file(self, field: QLineEdit) -> None:
        path, _ = QFileDialog.getOpenFileName(self, field.accessibleName(), field.text(), FILE_FILTER)
        if path:
            field.setText(path)

    def _files_changed(self) -> None:
        self._jobs.drop()
        self._take_preview(None)
        self._typing.start()

    def _scene_changed(self) -> None:
        self._scene, self._scene_trouble = None, ""
        self._update_problems()

    def _take_scene(self, scene: Scene | None, trouble: str) -> None:
        """Offer the arm poses of the scene; a single one is chosen."""
        self._scene, self._scene_trouble = scene, trouble
        chosen = self.pose.currentText()
        self.pose.clear()
        poses = [] if scene is None or scene.arm is None else list(scene.arm.poses)
        self.pose.addItems(poses if len(poses) == 1 else ["", *poses])
        self.pose.setCurrentText(chosen)
        self._show_streams()
        self._update_problems()

    def _show_streams(self) -> None:
        """Show the fields that the scene has a use for; read the recording again if they are others now."""
        tool = None if self._scene is None else self._scene.tool
        used = {Stream.WRENCH: tool is None or tool.has_sensor, Stream.JOINTS: tool is None, Stream.TOOL: tool is not None}
        changed = [stream for stream, is_used in used.items() if self._rows.isRowVisible(self._row_of[stream]) != is_used]
        for stream in changed:
            self._rows.setRowVisible(self._row_of[stream], used[stream])
        if changed and any(field.text().strip() for field in self.fields.values()):
            self._typing.start()

    def _check_folder(self) -> None:
        """Check the session's folder in the background: a disk may be slow."""
        self._place_pending, self._starts_later, text = True, False, self.folder.text().strip()
        self._places.renew()
        self._places.submit(lambda: _check_place(text), self._take_place)

    def _take_place(self, found: tuple[str, Sequence[Path]]) -> None:
        starts, self._starts_later, self._place_pending = self._starts_later, False, False
        self._folder_problem, self._missing_folders = found
        self._update_problems()
        if starts and self.start.isEnabled():
            self._start_import()

    # Preview

    def _request_preview(self) -> None:
        self._jobs.drop()
        try:
            files = self.files()
            _ = files.importer
        except InputError as error:
            self._take_preview(None, str(error) if any(field.text().strip() for field in self.fields.values()) else "")
            return
        self.kind.setText(READING_TEXT)
        self._jobs.submit(preview_job, (files,), self._take_preview, lambda sentence: self._take_preview(None, sentence))

    def _take_preview(self, preview: RecordingPreview | None, trouble: str = "") -> None:
        self._preview, self._trouble = preview, trouble
        self.kind.setText("" if preview is None else kind_words(preview))
        put_rows(self.streams, [] if preview is None else [stream_row(stream) for stream in preview.streams])
        fit_rows(self.streams)
        words = "" if preview is None else curve_words(preview)
        self.curve_words.setText(words)
        self.curve.show_curve(np.empty((0, 2)) if preview is None else force_points(preview), words)
        seen = "" if preview is None else frame_words(preview)
        self.frame_words.setText(seen)
        self.frame.show_frame(np.empty((0, 0)) if preview is None else preview.frame, seen)
        self.findings.clear()
        self.findings.addItems([] if preview is None else list(preview.findings))
        for widget in (self.streams, self.curve_words, self.curve):
            widget.setVisible(preview is not None)
        for widget in (self.frame_words, self.frame):
            widget.setVisible(preview is not None and preview.frame.size > 0)
        self.findings.setVisible(self.findings.count() > 0)
        self._update_problems()

    def _update_problems(self) -> None:
        if self.importing:
            return
        preview, has_joints = self._preview, self._has_joints
        self.pose.setEnabled(self.pose.count() > 1 and not has_joints)
        found: Sequence[str] = (self._trouble,)
        if preview is not None:
            pose = "" if has_joints else self.pose.currentText()
            found = (self._scene_trouble,) if self._scene is None else preview.misfits(self._scene, pose)
        problems = " ".join(filter(None, (*found, self._folder_problem)))
        self._show_problem(problems)
        self.start.setEnabled(preview is not None and self._scene is not None and not problems)

    @property
    def _has_joints(self) -> bool:
        """Whether a recording of the joints is named; a part that is poked by a tool with poses has none."""
        has_tool = self._scene is not None and self._scene.tool is not None
        return not has_tool and bool(self.fields[Stream.JOINTS].text().strip())

    def _show_problem(self, sentence: str) -> None:
        self.objection.setText(f"\N{BALLOT X} {sentence}")
        self.objection.setVisible(bool(sentence))

    # Import

    def _start_import(self) -> None:
        if self._place_pending:
            self._starts_later = True
            return
        files, folder = self.files(), Path(self.folder.text().strip())
        pose = "" if files.joints is not None else self.pose.currentText()
        request = ImportRequest(files, self.scene.file(), pose, folder)
        missing = self._missing_folders
        self._set_importing(True)

        def undo(_result: object = None) -> None:
            take_away(folder, missing)

        def set_share(share: float) -> None:
            # In another thread, which must not touch a widget.
            self._share = share

        self._jobs.submit(import_job, (request,), self._finish, self._fail, set_share, undo)

    def _set_importing(self, importing: bool) -> None:
        self.importing, self._share = importing, 0.0
        self.form.setEnabled(not importing)
        self.start.setEnabled(not importing)
        self.progress.setVisible(importing)
        self.progress.setValue(0)
        self.progress.setFormat(f"{IMPORTING_TEXT} %p %")
        self.stop.setText("Stop" if importing else "Cancel")
        self.stop.setEnabled(True)
        self._patience.stop()
        if importing:
            self._show_problem("")
            self.stop.setFocus()
            self._progressing.start()
        else:
            self._progressing.stop()

    def _finish(self, imported: Imported) -> None:
        self._set_importing(False)
        self.imported.emit(imported, str(self.scene.file()))
        self.accept()

    def _fail(self, sentence: str) -> None:
        self._set_importing(False)
        self._update_problems()
        self._show_problem(sentence)
        self.start.setFocus()

    def reject(self) -> None:
        """Close the dialog; during an import stop it and delete its files instead."""
        if self.importing:
            self.stop.setEnabled(False)
            self.progress.setFormat(STOPPING_TEXT)
            self._jobs.interrupt()
            self._patience.start()
            return
        super().reject()

    def _kill_import(self) -> None:
        self._jobs.drop()
        self._fail(str(StoppedError()))

    def done(self, result: int) -> None:
        self._typing.stop()
        self.end()
        super().done(result)

    def end(self) -> None:
        """Kill all background work; the files of an unfinished import are deleted."""
        self._progressing.stop()
        self._patience.stop()
        self._jobs.close()
        self.scene.close_threads()
        for service in (self._finds, self._places):
            service.close(0.0)


def force_points(preview: RecordingPreview) -> FloatArray:
    """Scale the force of a preview, (n, 2), to 0 to 1 on both axes; unknown forces are left out."""
    known = np.isfinite(preview.force)
    if known.sum() < 2:
        return np.empty((0, 2))
    times, force = preview.times[known], preview.force[known]
    return np.column_stack([times / max(float(preview.times[-1]), 1e-9), force / max(float(force.max()), 1e-9)])


def _find_streams(paths: Sequence[Path], channels: int, joints: Sequence[str]) -> RecordingFiles:
    try:
        return guess_streams(paths, channels, joints)
    except OSError as error:
        raise InputError(str(error)) from error


def _check_place(text: str) -> tuple[str, Sequence[Path]]:
    """Say why no session can be created in a folder, empty if it can, and list the folders to create; may be slow."""
    if not text:
        return NO_FOLDER, ()
    folder = Path(text)
    try:
        is_taken = (folder / SCENE_FOLDER).exists() or any(folder.glob("segment-*"))
        return HOLDS_SESSION if is_taken else "", missing_folders(folder)
    except (OSError, ValueError) as error:
        return f"{text}: cannot be read ({error}). Choose another folder.", ()
