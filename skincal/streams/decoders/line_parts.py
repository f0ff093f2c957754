"""Parts of a line of text, and which of them are understood: values, names, and what a log prints first."""

from __future__ import annotations

import re
from enum import Enum
from typing import NamedTuple

from skincal.streams.decoders.line_forms import LINE_SHOWN_MAX_CHARS, NUMBER_PATTERN, find_prefix, has_hex_letters, split_fields

_PART_RE = re.compile(
    r"(?P<name>(?<!\w)(?:r(?:ow)?[ _]?\d+[ _]*c(?:ol)?[ _]?\d+|[A-Za-z_][A-Za-z_ ]*?[ _]?[\[(]?\d*[\])]?)(?=\"?\s*[:=])"
    r"|(?<!\w)[A-Za-z]+\d+(?=[\s,;|]))"
    rf"|(?P<value>0x[0-9A-Fa-f]+(?![\w.])|(?:{NUMBER_PATTERN})(?![\w.]))|(?P<other>[A-Za-z_]\w*|.)",
    re.DOTALL | re.IGNORECASE,
)
_CUT_END_RE = re.compile(r"[^\s,;|]*\.\.\.$")
_SEPARATOR_CHARS = " \t,;|:=[](){}\"'"


class PartKind(Enum):
    """Meaning of a part of a line."""

    VALUE = "value"
    NAME = "name"
    FRONT = "front"
    """Time or tag of a log or a monitor."""
    SEPARATOR = "separator"
    UNKNOWN = "unknown"


class LinePart(NamedTuple):
    """A part of a line."""

    text: str
    kind: PartKind


def split_parts(line: str) -> tuple[LinePart, ...]:
    """Split a line into its parts; joined they are the line."""
    begin = find_prefix(line)
    parts = [LinePart(line[:begin], PartKind.FRONT)] if begin else []
    # The last word of a line that was cut may be any part of one.
    cut = _CUT_END_RE.search(line, begin) if len(line) == LINE_SHOWN_MAX_CHARS else None
    rest = line[begin : cut.start() if cut else None]
    is_hex = has_hex_letters(split_fields(rest))
    for found in _PART_RE.finditer(rest) if not is_hex else re.finditer(r"(?P<value>\w+)|(?P<other>.)", rest):
        kind = PartKind(found.lastgroup) if found.lastgroup != "other" else PartKind.UNKNOWN
        kind = PartKind.SEPARATOR if found[0] in _SEPARATOR_CHARS else kind
        if parts and parts[-1].kind is kind is not PartKind.VALUE:
            parts[-1] = LinePart(parts[-1].text + found[0], kind)
        else:
            parts.append(LinePart(found[0], kind))
    return (*parts, LinePart(cut[0], PartKind.SEPARATOR)) if cut else tuple(parts)
