"""The program is written in plain words: counts of unclear ones may fall, never rise."""

import ast
import re
from collections import Counter
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parent.parent
LIMITS = {"riddles": 6, "returns": 1, "idioms": 86, "constants": 21, "verbs": 5, "long": 4}
"""Counts at the last change. Lower them when you write more plainly."""
RELATIVE = re.compile(r"\b(what|where|which|that|who|whose|than|whom)\b", re.IGNORECASE)
RETURNS = re.compile(r"(Return|Yield|Say|Tell|Give) (what|where|how|which|that|who)\b")
IDIOMS = re.compile(
    r"\b(of which|by which|in which|to which|(?:is|are) (?:said|told)|was told|told apart|likewise|whoever|whatever|"
    r"anew|asked for|once more|so many|none (?:was|is)|nobody|as (?:it is|they are)|all that|lest|nought|"
    r"by (?:it|them)sel(?:f|ves)|"
    r"brings? again|taken back|takes? back|stands? (?:beside|behind|in|above|below)|what it (?:is|has|does)|"
    r"what (?:is|was|are|were) (?:said|seen|asked|found|known|left)|nothing of|much of|such a|is due|as far as|worked out|"
    r"laid on|lies? (?:beside|off|on))\b",
    re.IGNORECASE,
)
VAGUE_VERBS = (
    "take put hear follow look done moved told said beside of note begin step holds give find laid solved drawn kept heard "
    "taken seen made found left wanted asked shown known near far alike apart moves stays comes goes"
)
FIELD_CONSTANTS = "LOG VERSION TYPES NAMES METHODS COLUMNS HEADINGS UNITS HELP KEYS DARK LIGHT EPS PI CRC MAGIC HEADER"
LONG_SENTENCE_WORDS = 32


def count_code(text):
    """Counts of one module."""
    found, tree = Counter(), ast.parse(text)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        for child in body if isinstance(body, list) else []:
            match child:
                case ast.Expr(ast.Constant(str(words))) if words.strip():
                    first = words.strip().splitlines()[0]
                    found["riddles"] += len(RELATIVE.findall(first)) >= 3
                    found["returns"] += RETURNS.match(first) is not None
        if isinstance(node, ast.FunctionDef) and node.name.strip("_") in VAGUE_VERBS.split():
            found["verbs"] += 1
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        names = [target.id.strip("_") for target in targets if isinstance(target, ast.Name) and target.id.isupper()]
        found["constants"] += sum("_" not in name and name not in FIELD_CONSTANTS.split() for name in names)
    found["idioms"] += len(IDIOMS.findall(text))
    return found


def count_page(text):
    """Counts of one page in Markdown, without its code and tables."""
    body = re.sub(r"```.*?```|^\|.*?$|!\[.*?\)|\]\(.*?\)", " ", text, flags=re.DOTALL | re.MULTILINE)
    paragraphs = (" ".join(paragraph.split()) for paragraph in re.split(r"\n\s*\n", body))
    sentences = [each for words in paragraphs for each in re.split(r"(?<=[.!?:;])\s+(?=[A-Z*`\[])", words)]
    return Counter(long=sum(len(each.split()) > LONG_SENTENCE_WORDS for each in sentences), idioms=len(IDIOMS.findall(body)))


def test_counts_of_unclear_words_do_not_rise():
    found = Counter()
    for folder in ("app", "skincal", "tools"):
        for path in (CHECKOUT / folder).rglob("*.py"):
            found += count_code(path.read_text(encoding="utf-8"))
    for path in (CHECKOUT / "README.md", *(CHECKOUT / "docs").rglob("*.md")):
        found += count_page(path.read_text(encoding="utf-8"))
    assert {name: found[name] for name, limit in LIMITS.items() if found[name] > limit} == {}


def test_each_kind_is_counted():
    code = '''
USUAL = 1.0
"""What it is that stands where nobody knows which."""
def take(note):
    """Return what is asked for."""
'''
    assert count_code(code) == Counter(riddles=1, returns=1, constants=1, verbs=1, idioms=3)
    assert count_page(" ".join(["word"] * 33) + ". Short.")["long"] == 1
