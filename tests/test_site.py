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


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site of the documentation, and how it was built."""
    pytest.importorskip("mkdocstrings")
    folder = tmp_path_factory.mktemp("site")
    return folder, build(CHECKOUT, folder)


def test_every_link_leads_somewhere(site):
    folder, built = site
    assert built == (0, [])
    pages = {path.relative_to(CHECKOUT / "docs").with_suffix("") for path in (CHECKOUT / "docs").rglob("*.md")}
    missing = [
        page
        for page in pages
        if not any((folder / place).exists() for place in (page / "index.html", f"{page}.html", page.parent / "index.html"))
    ]
    assert missing == []
    start = (CHECKOUT / "docs/index.md").read_text(encoding="utf-8")
    assert [page.name for page in pages if page.parent == Path() and page.name != "index" and f"({page}.md)" not in start] == []


def test_the_reference_has_every_public_name_with_its_types(site):
    page = (site[0] / "api" / "index.html").read_text(encoding="utf-8")
    assert {name for name in skincal.__all__ if not re.search(rf'id="skincal[\w.]*\.{name}"', page)} == set()
    text = re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", "", page)))
    assert "load(path: str | Path) -> Scene" in text
    assert "(n, 6) float, N and N m, sensor frame" in text


def test_each_link_to_nowhere_is_found(tmp_path):
    pytest.importorskip("mkdocstrings")
    (tmp_path / "docs").mkdir()
    links = ("gone.md", "index.md#nowhere", "gone.png", "elsewhere")
    (tmp_path / "docs/index.md").write_text("".join(f"[here]({link})\n" for link in links))
    (tmp_path / "mkdocs.yml").write_bytes((CHECKOUT / "mkdocs.yml").read_bytes())
    code, warnings = build(tmp_path, tmp_path / "site")
    assert code == 1
    for link in links:
        assert sum(f"'{link}'" in warning for warning in warnings) == 1, (link, warnings)
