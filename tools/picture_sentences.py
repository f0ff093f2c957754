"""Sentences in the pictures of the docs: stored next to the pictures, and compared with the texts of the program.

`tools/pictures.py` stores them when it makes a picture; `tests/tools/test_picture_sentences.py` finds those that the program no
longer says. Imports no Qt.
"""

from __future__ import annotations

import ast
import hashlib
import html
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

CHECKOUT_FOLDER = Path(__file__).resolve().parent.parent
PICTURES_FOLDER = CHECKOUT_FOLDER / "docs" / "pictures"
SENTENCES_FILE = PICTURES_FOLDER / "sentences.json"
STUDY_PICTURES = ("guidance", "paper", "runtime", "stability", "unmodelled")
"""Studies whose figure is in the docs."""
PICTURES_WITHOUT_WINDOW = ("headless", *STUDY_PICTURES)
SENTENCE_MIN_WORDS = 4
"""A shorter text that the program does not contain is data, such as the name of a link."""
VALUE_MAX_WORDS = 2
"""A field of a template with more words must be another text of the program."""
LABEL_MAX_WORDS = 5
"""A text with at most these words may be two of the program after each other: `"force/torque sensor not read"`."""
TEMPLATE_MIN_LETTERS = 2
FIELD_MARK = "\0"
_FORMAT_FIELD = re.compile(r"(?<!\{)\{[\w.\[\]!:,%+]*\}(?!\})")
_SENTENCE_END = re.compile(r"(?<=[.!?:;])\s+|\s*[\u00b7\u2013\u2022\u2190-\u2bff]\s*|\n+|\s{2,}")
"""End of a sentence, or a sign between two texts."""
_LIST_JOINT = re.compile(r",? and |, | or ")
_WORD_SPACE = re.compile(r",? and |, | or | ")
_COUNT_OR_NAME = re.compile(r" [\d.]+$|^\S*[\d_]\S* ")
"""At the end or the beginning of a text, such as of a row in a list."""


_FOLDERS_OF_A_PATH = re.compile(r"(?<![\w./])(?:/[\w.-]+)+/(?=[\w.-])")
"""The folders of an absolute path, which differ on each machine."""


class ProgramTexts:
    """Texts of the program's source: constants and templates, without docstrings, cut into sentences.

    >>> texts = ProgramTexts(['say(f"poke {number} counted for taxel {name}")', 'SIGN = "hold still"'])
    >>> texts.has("Poke 12 counted for taxel 24"), texts.has("hold still"), texts.has("poke 12 counted for 24-10")
    (True, True, False)
    """

    def __init__(self, sources: Iterable[str]) -> None:
        templates = {part for source in sources for text in _texts_of(source) for part in _sentences(text)}
        self._plain = {text for text in templates if FIELD_MARK not in text}
        self._templates: list[tuple[str, re.Pattern[str]]] = []
        for text in templates - self._plain:
            literals = text.split(FIELD_MARK)
            if sum(map(str.isalpha, "".join(literals))) >= TEMPLATE_MIN_LETTERS:
                pattern = "(.*?)".join(map(re.escape, literals))
                self._templates.append((max(literals, key=len), re.compile(pattern, re.DOTALL)))
        self._found: dict[str, bool] = {}

    def has(self, shown: str) -> bool:
        """Whether the program can say each sentence of a text; format fields match any value."""
        sentences = _sentences(shown)
        if len(sentences) == 1:
            return self._has_sentence(sentences[0])
        return all(map(self._is_value, sentences))

    def _has_sentence(self, text: str) -> bool:
        if text not in self._found:
            # Parts of a text are shorter than the text, so that this ends.
            self._found[text] = False
            self._found[text] = text in self._plain or self._fits_template(text) or self._is_joined(text)
        return self._found[text]

    def _fits_template(self, text: str) -> bool:
        for literal, pattern in self._templates:
            match = pattern.fullmatch(text) if literal in text else None
            if match is not None and all(map(self._is_value, match.groups())):
                return True
        return False

    def _is_value(self, text: str) -> bool:
        return _count_words(text) <= VALUE_MAX_WORDS or self.has(text)

    def _is_joined(self, text: str) -> bool:
        """Whether a text is another one with a count or name, or a list: `"2 of 3 are finished, 4 test pokes left"`."""
        rest = _COUNT_OR_NAME.sub("", text, count=1)
        if rest != text and self.has(rest):
            return True
        joints = (_WORD_SPACE if _count_words(text) <= LABEL_MAX_WORDS else _LIST_JOINT).finditer(text)
        pairs = ((text[: joint.start()], text[joint.end() :]) for joint in joints)
        return any(first and rest and self._is_item(first) and self._is_item(rest) for first, rest in pairs)

    def _is_item(self, text: str) -> bool:
        is_amount = text[0].isdigit() and _count_words(text) <= VALUE_MAX_WORDS
        return is_amount or self.has(text)


@cache
def program_texts() -> ProgramTexts:
    """Texts of `app` and `skincal` of this checkout."""
    files = (path for folder in ("app", "skincal") for path in sorted((CHECKOUT_FOLDER / folder).rglob("*.py")))
    return ProgramTexts(path.read_text(encoding="utf-8") for path in files)


def choose_texts(shown: Iterable[str], texts: ProgramTexts) -> list[str]:
    """Choose what is stored of a window's texts: each that the program contains, and each sentence; short others are data.

    Of a path only the last name is stored.
    """
    plain = dict.fromkeys(_FOLDERS_OF_A_PATH.sub("", _plain(text)).strip() for text in shown)
    return [text for text in plain if _count_words(text) and (_count_words(text) >= SENTENCE_MIN_WORDS or texts.has(text))]


def read_sentences() -> dict[str, dict[str, Any]]:
    """Read the stored sentences: by the picture's name `sentences`, and the picture's `sha256`."""
    return json.loads(SENTENCES_FILE.read_text(encoding="utf-8")) if SENTENCES_FILE.is_file() else {}


def store_sentences(made: Mapping[str, list[str]]) -> None:
    """Store the sentences of pictures that were just made; those of pictures that no longer exist are removed."""
    stored = read_sentences() | {name: {"sha256": picture_sum(name), "sentences": texts} for name, texts in made.items()}
    kept = {name: stored[name] for name in sorted(stored) if (PICTURES_FOLDER / f"{name}.png").is_file()}
    SENTENCES_FILE.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n", encoding="utf-8", newline="\n")


def picture_sum(name: str) -> str:
    """Compute the SHA-256 of a picture."""
    return hashlib.sha256((PICTURES_FOLDER / f"{name}.png").read_bytes()).hexdigest()


def _texts_of(source: str) -> Iterator[str]:
    """Find the strings of a source file, with `FIELD_MARK` for each field; docstrings are left out."""
    tree = ast.parse(source)
    skipped = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if id(node) in skipped:
            continue
        if isinstance(node, ast.JoinedStr):
            skipped |= {id(part) for part in node.values}
            yield "".join(
                _FORMAT_FIELD.sub(FIELD_MARK, str(part.value)) if isinstance(part, ast.Constant) else FIELD_MARK
                for part in node.values
            )
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield _FORMAT_FIELD.sub(FIELD_MARK, node.value)


def _count_words(text: str) -> int:
    """Count words with two letters; a path or a name of a link is one."""
    return sum(re.search("[A-Za-z]{2}", word) is not None for word in text.split())


def _sentences(text: str) -> list[str]:
    """Cut a text into sentences without marks at their ends, in small letters."""
    parts = (" ".join(part.split()).strip(" .:;,!?()").casefold() for part in _SENTENCE_END.split(_plain(text)))
    return [part for part in parts if part]


def _plain(text: str) -> str:
    """Remove tags, and the marks of keys; a paragraph is a line."""
    lines = re.sub(r"</?(?:br|p|tr|td|li|h\d|div)\b[^>]*>", "\n", text)
    return html.unescape(re.sub(r"</?[a-z][^>]*>", "", lines)).replace("&", "")
