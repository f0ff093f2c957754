"""The approved texts are what the tests expect: every one is used, and none is written a second time in a test."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from string import Formatter

import pytest

from tests.approved import TEXTS, approved, fields

HERE = Path(__file__)
FILES = sorted(set(HERE.parent.rglob("*.py")) - {HERE, HERE.with_name("approved.py")})
WORDS_MIN = 4
"""Shorter words and parts of sentences may stand in the tests."""


def calls(path: Path) -> Iterator[tuple[str, set[str]]]:
    """Give the key, and the names of the values, of every use of an approved text in a file."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id.startswith("approved"):
            key = node.args[0]
            assert isinstance(key, ast.Constant), f"{path}:{node.lineno}: the key is no plain text"
            yield key.value, {str(keyword.arg) for keyword in node.keywords}


def test_every_text_is_used_with_its_values():
    used = {key: names for path in FILES for key, names in calls(path)}
    assert used.keys() == TEXTS.keys()
    assert used == {key: fields(text) for key, text in TEXTS.items()}


def pattern(text: str) -> str:
    """A text as a pattern, whatever its values are."""
    return "".join(re.escape(part) + ("" if name is None else ".+") for part, name, _, _ in Formatter().parse(text))


def test_no_text_stands_a_second_time_in_a_test():
    whole = re.compile("|".join(pattern(text) for text in TEXTS.values() if len(text.split()) >= WORDS_MIN))
    found = [
        f"{path.name}:{node.lineno}: {node.value}"
        for path in FILES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and whole.fullmatch(node.value)
    ]
    assert found == []


def test_a_value_that_is_missing_or_not_in_the_text_is_refused():
    with pytest.raises(AssertionError):
        approved("guide.straight")
    with pytest.raises(AssertionError):
        approved("verdict.none_used", count=3)
