"""Pictures of the docs show what the program says today."""

import re

import pytest

from tools import picture_sentences
from tools.picture_sentences import (
    PICTURES_FOLDER,
    PICTURES_WITHOUT_WINDOW,
    ProgramTexts,
    choose_texts,
    picture_sum,
    program_texts,
    read_sentences,
    store_sentences,
)

STORED = read_sentences()
WINDOW_PICTURES = sorted({path.stem for path in PICTURES_FOLDER.glob("*.png")} - set(PICTURES_WITHOUT_WINDOW))
SOURCE = '''
"""A docstring says nothing on the screen."""
LABELS = {"next": "&Next", "skin": "Connect the <b>skin</b>. Then press it."}
def say(number, where, why):
    return f"Poke {number} counted for {where}: {why}"
WHY = "It was pressed hard enough to be measured. Go on with {count} pokes at the other end"
RIMS = "The mesh has open rims ({} edges)"
'''


@pytest.mark.parametrize("name", WINDOW_PICTURES)
def test_a_picture_shows_sentences_that_the_program_still_says(name):
    """Where this fails, make the picture again: `python -m tools.pictures`, see CONTRIBUTING.md."""
    sentences = STORED[name]["sentences"]
    assert len(sentences) >= 5
    assert [text for text in sentences if not program_texts().has(text)] == []


@pytest.mark.parametrize("name", WINDOW_PICTURES)
def test_a_picture_is_the_one_whose_sentences_are_stored(name):
    assert STORED[name]["sha256"] == picture_sum(name)


def test_every_picture_of_the_docs_is_stored_and_shown():
    assert sorted(STORED) == WINDOW_PICTURES
    checkout = PICTURES_FOLDER.parent.parent
    pages = [checkout / "README.md", *PICTURES_FOLDER.parent.rglob("*.md")]
    shown = {name for page in pages for name in re.findall(r"pictures/([\w-]+)\.png", page.read_text(encoding="utf-8"))}
    assert shown == {*WINDOW_PICTURES, *PICTURES_WITHOUT_WINDOW}


@pytest.mark.parametrize(
    ("shown", "known"),
    [
        ("Next", True),
        ("&Next", True),
        ("Connect the skin. Then press it.", True),
        ("Connect the robot. Then press it.", False),
        ("Poke 12 counted for taxel 3: It was pressed hard enough to be measured", True),
        ("Poke 12 counted for taxel 3: this sentence is in no file", False),
        ("Poke 12 for taxel 3 counted", False),
        ("The mesh has open rims (144 edges)", True),
        ("Next Next", True),
        ("Next foot", False),
        ("Go on with 4 pokes at the other end, Next", True),
        ("A docstring says nothing on the screen", False),
    ],
)
def test_a_text_is_looked_up_with_any_values(shown, known):
    assert ProgramTexts([SOURCE]).has(shown) is known


def test_short_texts_that_are_no_part_of_the_program_are_data():
    texts = ProgramTexts([SOURCE])
    assert choose_texts(["&Next", "l_forearm", "12.3", "a new sentence of mine"], texts) == ["Next", "a new sentence of mine"]


def test_of_a_path_the_last_name_is_stored():
    texts = ProgramTexts(['f"Recording in {folder}; Ctrl+S saves it now"'])
    shown = "Recording in /somewhere/of-mine/monday; Ctrl+S saves it now"
    assert choose_texts([shown, "rtde://127.0.0.1/a is the address here"], texts) == [
        "Recording in monday; Ctrl+S saves it now",
        "rtde://127.0.0.1/a is the address here",
    ]


def test_no_stored_sentence_has_a_path_of_a_machine():
    assert not [text for stored in STORED.values() for text in stored["sentences"] if re.search(r"(?<![\w./:])/\w+/", text)]


def test_sentences_are_stored_with_their_picture(tmp_path, monkeypatch):
    monkeypatch.setattr(picture_sentences, "PICTURES_FOLDER", tmp_path)
    monkeypatch.setattr(picture_sentences, "SENTENCES_FILE", tmp_path / "sentences.json")
    for name in ("one", "two"):
        (tmp_path / f"{name}.png").write_bytes(name.encode())
    store_sentences({"one": ["a"], "two": ["b"]})
    (tmp_path / "two.png").unlink()
    store_sentences({"one": ["c"]})
    assert {name: stored["sentences"] for name, stored in picture_sentences.read_sentences().items()} == {"one": ["c"]}
