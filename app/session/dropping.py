"""Files and folders that are dropped onto the window: a request to open or import them, or a refusal. No Qt."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from app.session.opening import PART_FILES, OpenRequest, server_command
from skincal.model.errors import InputError

DROP_ADVICE = (
    "Drop the folder of a session, a scene (*.toml), a mesh, a URDF, or a recording: of yarpdatadumper, in CSV files, or a bag "
    "of ROS."
)


def request_of(paths: Sequence[Path]) -> OpenRequest | tuple[Path, ...]:
    """Decide what to open: a session, a scene with simulated devices, a new part, or files or a folder to import.

    Raises
    ------
    InputError
        It cannot be opened; the sentence says what to do.
    """
    from skincal.files.importers.registry import is_recording

    try:
        if len(paths) > 1 and all(map(is_recording, paths)):
            return tuple(paths)
        if len(paths) == 1:
            return _request_of(paths[0])
    except OSError as error:
        raise InputError(f"{paths[0]}: cannot be read ({error.strerror}). Check its permissions.") from None
    raise InputError(f"{len(paths)} files of this computer were dropped; expected one. {DROP_ADVICE}")


def _request_of(path: Path) -> OpenRequest | tuple[Path, ...]:
    from skincal.files.importers.registry import is_recording
    from skincal.journal.writer import SCENE_FILE, SCENE_FOLDER

    kind = path.suffix.lower()
    if (path / SCENE_FOLDER / SCENE_FILE).is_file():
        return OpenRequest(session=path)
    if is_recording(path):
        return (path,)
    if path.is_dir():
        raise InputError(f"{path}: is not the folder of a session. {DROP_ADVICE}")
    if not path.is_file():
        raise InputError(f"{path}: there is no such file. {DROP_ADVICE}")
    if kind == ".toml":
        return OpenRequest(scene=path, server=server_command(path))
    if kind in PART_FILES:
        return OpenRequest(part=path)
    raise InputError(f"{path}: cannot be opened. {DROP_ADVICE}")
