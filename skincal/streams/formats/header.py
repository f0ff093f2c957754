"""The header record of SKT/1 and SKB/1: what the board says it sends."""

from __future__ import annotations


def parse_header(text: str) -> dict[str, str]:
    """Read `key=value,key=value`; a field without `=` is left out."""
    pairs = (field.partition("=") for field in text.split(","))
    return {key.strip(): value.strip() for key, equals, value in pairs if equals}


def header_problem(header: dict[str, str], channels: int | None) -> str:
    """Return the sentence for a board whose width is not that of the scene; empty if they agree or one is unknown."""
    n = header.get("n", "")
    if channels is None or not n.isdigit() or int(n) == channels or header.get("kind") == "ft":
        return ""
    board = header.get("board", "")
    return (
        f"The board{' ' + board if board else ''} says that it sends n={n} taxels where {channels} are expected; "
        "set [skin] channels of the scene, or the board's n, to the same number"
    )
