"""A segment that was cut off or damaged, made whole again up to its first damage."""

from __future__ import annotations

from pathlib import Path

from skincal.model.errors import InputError
from skincal.session.closing import close_copy, survey
from skincal.session.log import find_segments
from skincal.session.outline import read_outline
from skincal.session.segment import SegmentReader, has_end


def recover_session(folder: Path) -> tuple[str, ...]:
    """Make every segment of a session readable for other programs too, and ready to go on.

    A damaged segment is written anew up to its damage, and the damaged file is kept beside it as `*.mcap.damaged`. Segments
    after a hole cannot be played on what is left, and are put aside as `*.mcap.after-damage`. A segment whose outline is whole
    is left as it is: all of its pokes are known, whatever became of the readings between them.

    Returns
    -------
    Sentences on what was done; empty where everything was whole.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    said: list[str] = []
    broken = ""
    for path in find_segments(folder):
        if broken:
            aside = _free_name(path, "after-damage")
            path.rename(aside)
            said.append(f"{path.name}: put aside as {aside.name}, since {broken} before it has a hole.")
            continue
        try:
            sentence, hole = _recover(path)
        except OSError as error:
            why = error.strerror
            raise InputError(f"{path}: cannot be recovered ({why}); check the folder's rights and the space.") from None
        said.extend([sentence] if sentence else [])
        broken = path.name if hole else ""
    return tuple(said)


def _recover(path: Path) -> tuple[str, bool]:
    """Return a sentence if the segment had to be written anew, and whether something is missing at its end for sure."""
    if read_outline(path) is not None:
        return "", False
    if has_end(path):
        reader = SegmentReader(path, (), sparse=True)
        for _ in reader.records():
            pass
        if reader.whole:
            return "", False
    whole = survey(path)
    fresh = path.with_name(path.name + ".recovering")
    close_copy(path, fresh, whole)
    kept = _free_name(path, "damaged")
    path.rename(kept)
    fresh.rename(path)
    if whole.complete:
        return (
            f"{path.name}: its index was damaged and is written anew; nothing is lost; the file as it was is {kept.name}.",
            False,
        )
    lost = kept.stat().st_size - whole.end
    said = (
        f"{path.name}: {whole.damage or 'it was not closed'}; recovered {whole.messages} messages, {lost} bytes were lost; "
        f"the file as it was is {kept.name}."
    )
    return said, True


def _free_name(path: Path, ending: str) -> Path:
    """Return a name beside `path` that no file has."""
    name, number = path.with_name(f"{path.name}.{ending}"), 1
    while name.exists():
        number += 1
        name = path.with_name(f"{path.name}.{ending}-{number}")
    return name
