"""The sentences that tests expect, from `approved_texts.toml`: a changed sentence is changed there and nowhere else."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from string import Formatter

FILE = Path(__file__).with_name("approved_texts.toml")
TEXTS = {
    f"{room}.{name}": text
    for room, texts in tomllib.loads(FILE.read_text(encoding="utf-8")).items()
    for name, text in texts.items()
}


def fields(text: str) -> set[str]:
    """Names in braces in a text."""
    return {name for _, name, _, _ in Formatter().parse(text) if name is not None}


def approved(key: str, /, **values: object) -> str:
    """Give the sentence `key` with its values; each of them must be in the sentence, and each of its braces be given."""
    text = TEXTS[key]
    assert values.keys() == fields(text), f"{key} has {sorted(fields(text))}, not {sorted(values)}"
    return text.format(**values)


def approved_pattern(key: str, /, **values: object) -> str:
    """Give the sentence as a pattern for `pytest.raises(match=...)`."""
    return re.escape(approved(key, **values))
