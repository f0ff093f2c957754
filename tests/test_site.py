"""The documentation is a site in which every link leads to a page, a heading or a picture."""

import html
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import skincal

CHECKOUT = Path(__file__).resolve().parent.parent


def build(folder, site):
    """Build the site of a folder with mkdocs.yml; return its warnings."""
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(site)]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, check=False
    )
    assert "Traceback" not in done.stderr
    return done.returncode, [line for line in done.stderr.splitlines() if line.startswith("WARNING")]


def test_every_link_leads_somewhere(tmp_path):
    pytest.importorskip("mkdocstrings")
    assert build(CHECKOUT, tmp_path) == (0, [])
    pages = {path.relative_to(CHECKOUT / "docs").with_suffix("") for path in (CHECKOUT / "docs").rglob("*.md")}
    missing = [
        page
        for page in pages
        if not any((tmp_path / place).exists() for place in (page / "index.html", f"{page}.html", page.parent / "index.html"))
    ]
    assert missing == []
    start = (CHECKOUT / "docs/index.md").read_text(encoding="utf-8")
    assert [page.name for page in pages if page.parent == Path() and page.name != "index" and f"({page}.md)" not in start] == []


def test_the_reference_has_every_public_name_with_its_types(tmp_path):
    pytest.importorskip("mkdocstrings")
    assert build(CHECKOUT, tmp_path) == (0, [])
    page = (tmp_path / "api" / "index.html").read_text(encoding="utf-8")
    assert {name for name in skincal.__all__ if not re.search(rf'id="skincal[\w.]*\.{name}"', page)} == set()
    text = re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", "", page)))
    assert "load(path: str | Path) -> Scene" in text
    assert "(n, 6) float, N and N m, sensor frame" in text


@pytest.mark.parametrize("link", ["nowhere.md", "index.md#nowhere", "nowhere.png", "elsewhere"])
def test_a_link_to_nowhere_is_found(tmp_path, link):
    pytest.importorskip("mkdocstrings")
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/index.md").write_text(f"[here]({link})\n")
    (tmp_path / "mkdocs.yml").write_bytes((CHECKOUT / "mkdocs.yml").read_bytes())
    code, warnings = build(tmp_path, tmp_path / "site")
    assert code == 1
    assert "nowhere" in warnings[0] or "elsewhere" in warnings[0]
