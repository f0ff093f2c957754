"""The approved texts are what the tests expect: every one is used, with its values."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.approved import TEXTS, approved, fields

HERE = Path(__file__)
FILES = sorted(set(HERE.parent.rglob("*.py")) - {HERE, HERE.with_name("approved.py")})


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
    plain = {key: names for key, names in used.items() if "None" not in names}  # None: values that are handed on as `**values`
    assert plain == {key: fields(TEXTS[key]) for key in plain}


def test_a_value_that_is_missing_or_not_in_the_text_is_refused():
    with pytest.raises(AssertionError):
        approved("guide.straight")
    with pytest.raises(AssertionError):
        approved("verdict.none_used", count=3)
