"""The corrected layout as a file: the text that was read, with the changes in it and all else as it was.

Comments, the order and the writing of what does not change stay, so that the two files can be compared line by line. What is
written is read back and must say what was meant.
"""

from __future__ import annotations

from collections.abc import MutableMapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from skincal.files.atomic import write_atomically
from skincal.model.errors import InputError
from skincal.model.skin import Layout, load_layout, read_layout
from skincal.modules.health import LayoutRepair, ModuleChange

SAME_ANGLE_TOLERANCE_RAD = 1e-7
"""rad: angles that differ by less are the same; a file has six digits of a degree."""


def write_layout(given: Layout, mend: LayoutRepair, path: Path) -> None:
    """Write the corrected layout to another file than was read; an older one there is kept as `.bak`; see `write_atomically`.

    Raises InputError: it is the file that was read, the layout is of no file, or the file cannot be written or would say
    something else; the file that was read is as it was.
    """
    if given.path is None:
        raise InputError(f"{path}: the layout was read from no file, so there is none to correct; expected one that was.")
    if _same_file(path, given.path):
        raise InputError(
            f"{path}: is the layout that was read, and is not changed; choose another name, such as corrected-{path.name}."
        )
    text = corrected_text(given.text, mend.changes)
    _check(read_layout(text, path, given.width), mend.layout, path)
    write_atomically(path, text.encode("utf-8"))
    _check(load_layout(path, given.width), mend.layout, path)


def corrected_text(text: str, changes: Sequence[ModuleChange]) -> str:
    """Return the text of a layout's file with some modules changed, and all else as it was.

    Raises InputError: it is written in a way that can be read, but not changed.
    """
    # Imported here: a layout is corrected once, and nothing else needs tomlkit.
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    # tomlkit ends what it adds in a line feed, so the rest gets line feeds too until it is done.
    windows = "\r\n" in text
    try:
        document = tomlkit.parse(text.replace("\r\n", "\n"))
    except TOMLKitError as error:
        raise InputError(f"the layout's file cannot be changed ({error}); change it by hand.") from None
    by_id = {change.module: change for change in changes}
    # A table of the file reads as a dictionary, whether it is written as [[modules]] or as a list of { }.
    for table in cast("list[MutableMapping[str, Any]]", document["modules"]):
        if (change := by_id.get(int(table["id"]))) is not None:
            for key, value in change.keys.items():
                set_key(table, key, value)
    done = tomlkit.dumps(document)
    return done.replace("\n", "\r\n") if windows else done


def set_key(table: MutableMapping[str, Any], key: str, value: Any) -> None:
    """Set a value of a table: in its place where there is one, else below the last value, above comments on the next table."""
    from tomlkit.items import Item, Table

    tail: list[Item] = []
    if key not in table and isinstance(table, Table):
        body = table.value.body
        while body and body[-1][0] is None:
            tail.insert(0, body.pop()[1])
    table[key] = value
    for item in tail:
        cast(Any, table).add(item)


def _check(found: Layout, meant: Layout, path: Path) -> None:
    """Raise InputError if the written file differs from the intended layout."""
    for module, wanted in zip(found.modules, meant.modules, strict=False):
        # Over the circle: angles that are whole turns apart are the same.
        turn = abs(float(np.angle(np.exp(1j * (module.angle - wanted.angle)))))
        same = (module.id, module.first_channel, module.mirror) == (wanted.id, wanted.first_channel, wanted.mirror)
        if not same or turn > SAME_ANGLE_TOLERANCE_RAD or not np.array_equal(module.place, wanted.place):
            raise InputError(
                f"{path}: module {wanted.id} would not be read as it was meant; change the layout by hand: "
                f"first_channel = {wanted.first_channel}, angle_deg = {np.degrees(wanted.angle):g}, "
                f"mirror = {str(wanted.mirror).lower()}."
            )
    if len(found.modules) != len(meant.modules):
        raise InputError(f"{path}: {len(found.modules)} modules would be read; {len(meant.modules)} were expected.")


def _same_file(path: Path, other: Path) -> bool:
    try:
        return path.samefile(other)
    except OSError:
        return path.absolute() == other.absolute()
