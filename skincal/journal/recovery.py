"""A session that was cut off or damaged, made ready to go on: every segment is given an end, at its first damage."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import BinaryIO

from mcap.records import Channel, Message, Metadata, Schema
from mcap.writer import Writer

from skincal import __version__
from skincal.journal.lines import Lines, LineWriter, lines_path, read_lines
from skincal.journal.reader import DamagedError, McapFile, find_segments, is_closed, tells_all
from skincal.model.errors import InputError


def recover_session(folder: Path) -> tuple[str, ...]:
    """Make every segment of a session readable for other programs too, and ready to be followed by another; hold its lock.

    A file that is written anew up to its damage is kept beside as `*.damaged`. Where it is not known any more what happened at
    a segment's end, the segments after it are put aside as `*.after-damage`.

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
        try:
            if broken:
                aside = _put_aside(path, "after-damage")
                _put_aside(lines_path(path), "after-damage")
                said.append(f"{path.name}: put aside as {aside}, since {broken} before it has a hole.")
                continue
            sentences, hole = _recover(path)
        except OSError as error:
            why = error.strerror
            raise InputError(f"{path}: cannot be recovered ({why}); check the folder's rights and the space.") from None
        said += sentences
        broken = path.name if hole else ""
    return tuple(said)


def _recover(path: Path) -> tuple[list[str], bool]:
    """Return what was done to a segment, and whether it is not known any more what happened at its end."""
    said: list[str] = []
    lines, name = read_lines(path), lines_path(path).name
    ended = lines is not None and lines.closed
    if lines is not None and not ended:
        if not lines.documents or tells_all(path):
            aside = _put_aside(lines_path(path), "damaged")
            said.append(f"{name}: has no end; put aside as {aside}, the MCAP file is read in its place.")
            lines = None
        else:
            said += _end_lines(path, lines)
    if is_closed(path) and lines is not None:
        return said, not ended
    if tells_all(path):
        return said, False
    sentence, complete = _write_anew(path, lines)
    return [sentence, *said], not (ended or (lines is None and complete))


def _end_lines(path: Path, lines: Lines) -> list[str]:
    """Give a segment's lines an end behind the last one that is whole."""
    said: list[str] = []
    file = lines_path(path)
    if lines.lost:
        kept = _free_name(file, "damaged")
        shutil.copyfile(file, kept)
        os.truncate(file, lines.size)
        said.append(f"{file.name}: {lines.lost} bytes were lost; the file as it was is {kept.name}.")
    LineWriter(file, lines).close(lines.items)
    return said


def _write_anew(path: Path, lines: Lines | None) -> tuple[str, bool]:
    """Write an MCAP file anew up to its damage; return what was done, and whether all its data is there.

    Where there is nothing in it, and no line beside it, it is put aside.
    """
    fresh = path.with_name(path.name + ".recovering")
    source = McapFile(path)
    # Made anew, so that a link of that name leads nowhere.
    fresh.unlink(missing_ok=True)
    with fresh.open("xb") as target:
        count, why = _copy(source, target)
        os.fsync(target.fileno())
    lost = source.lost
    kept = _put_aside(path, "damaged")
    if not count and lines is None:
        fresh.unlink()
        _put_aside(lines_path(path), "damaged")
        return f"{path.name}: holds nothing that can be read; put aside as {kept}.", False
    fresh.rename(path)
    if source.complete:
        return f"{path.name}: its index was damaged and is written anew; nothing is lost; the file as it was is {kept}.", True
    return f"{path.name}: {why}; recovered {count} messages, {lost} were lost; the file as it was is {kept}.", False


def _copy(source: McapFile, target: BinaryIO) -> tuple[int, str]:
    """Copy what can be read to an open file; return the number of messages, and why there are no more."""
    writer = Writer(target)
    writer.start(profile="ros2", library=f"skincal {__version__}")
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    count, why = 0, ""
    try:
        for record in source.records():
            if isinstance(record, Message):
                at, publish = record.log_time, record.publish_time
                writer.add_message(channels[record.channel_id], at, record.data, publish, record.sequence)
                count += 1
            elif isinstance(record, Schema) and record.id not in schemas:
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, Channel) and record.id not in channels:
                channels[record.id] = writer.register_channel(record.topic, record.message_encoding, schemas[record.schema_id])
            elif isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
    except DamagedError as error:
        why = str(error)
    writer.finish()
    target.flush()
    return count, why


def _put_aside(path: Path, ending: str) -> str:
    """Give a file, where there is one, a name that no other has, and return it."""
    aside = _free_name(path, ending)
    if path.exists():
        path.rename(aside)
    return aside.name


def _free_name(path: Path, ending: str) -> Path:
    name, number = path.with_name(f"{path.name}.{ending}"), 1
    while name.exists() or name.is_symlink():
        number += 1
        name = path.with_name(f"{path.name}.{ending}-{number}")
    return name
