"""What becomes of files and folders that are dropped onto the window: opened, imported, or a sentence says why not. No Qt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from app.session.opening import MESHES, OpenRequest, server_command
from skincal.files.importers.registry import is_recording
from skincal.model.errors import InputError

EXPECTED = "drop the folder of a session, a scene (*.toml), a mesh, or a recording of yarpdatadumper or in CSV files."


@dataclass(frozen=True, slots=True)
class DroppedRecording:
    """Files, or a folder of them, of another program's recording."""

    paths: tuple[Path, ...]


def request_of(paths: Sequence[Path]) -> OpenRequest | DroppedRecording:
    """Return what to open for what was dropped: a session, a scene with a simulated rig, a mesh, or a recording to import.

    Raises
    ------
    InputError
        It cannot be opened; the sentence says what to do with it.
    """
    try:
        if len(paths) > 1 and all(map(is_recording, paths)):
            return DroppedRecording(tuple(paths))
        if len(paths) == 1:
            return _request_of(paths[0])
    except OSError as error:
        raise InputError(f"{paths[0]}: cannot be looked at ({error.strerror}); check its rights.") from None
    raise InputError(f"{len(paths)} files were dropped that lie on this machine; expected one: {EXPECTED}")


def _request_of(path: Path) -> OpenRequest | DroppedRecording:
    from skincal.journal.writer import SCENE_FILE, SCENE_FOLDER

    kind = path.suffix.lower()
    if (path / SCENE_FOLDER / SCENE_FILE).is_file():
        return OpenRequest(session=path)
    if is_recording(path):
        return DroppedRecording((path,))
    if path.is_dir():
        raise InputError(f"{path}: is not the folder of a session; {EXPECTED}")
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; {EXPECTED}")
    if kind == ".toml":
        return OpenRequest(scene=path, server=server_command(path))
    if kind in MESHES:
        return OpenRequest(mesh=path)
    raise InputError(f"{path}: is nothing that can be opened; {EXPECTED}")
