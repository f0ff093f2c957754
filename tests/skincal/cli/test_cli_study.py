"""`skincal study`: files, JSON on stdout, and a folder that cannot be used."""

import json
import subprocess
import sys
from importlib import import_module

import pytest

from skincal.studies import STUDIES, runtime
from tests.approved import approved
from tests.skincal.studies.studies_support import tiny


@pytest.fixture
def canned(monkeypatch):
    """Make the runtime study give a small result at once; return the list of what it was asked for."""
    asked = []

    def give(quick, progress):
        asked.append(quick)
        progress("measuring")
        return {"study": "runtime", "quick": quick, "bars": {}, "table": [], "poke": [], "left_out": ["nothing"]}

    monkeypatch.setattr(runtime, "run", give)
    monkeypatch.setattr(runtime, "draw", lambda _, figure: figure.add_subplot().plot([0, 1]))
    return asked


def test_a_study_writes_its_numbers_and_its_figure(run, tmp_path, monkeypatch):
    result, said = tiny()

    def measure(quick, progress):
        progress(said[0])
        return {**result, "quick": quick}

    monkeypatch.setattr(runtime, "run", measure)
    code, out, err = run("study", "runtime", "--quick", "--out", tmp_path / "new" / "measured")
    assert code == 0
    names = {path.name for path in (tmp_path / "new" / "measured").iterdir()}
    assert names == {"runtime.json", "runtime.svg", "runtime.png"}
    written = json.loads((tmp_path / "new" / "measured" / "runtime.json").read_text(encoding="utf-8"))
    assert written == {**result, "quick": True}
    assert "wrote " in out
    assert "surface, as shipped" in out
    assert "poking icub-forearm" in err


@pytest.mark.parametrize(
    ("options", "quick", "files"),
    [
        (["--json"], False, set()),
        ([], False, {"studies/runtime.json", "studies/runtime.svg", "studies/runtime.png"}),
        (["--json", "--quick", "--out", "x"], True, {"x/runtime.json", "x/runtime.svg", "x/runtime.png"}),
    ],
)
def test_json_goes_to_stdout_and_files_into_a_folder(run, tmp_path, monkeypatch, canned, options, quick, files):
    monkeypatch.chdir(tmp_path)
    code, out, err = run("study", "runtime", *options)
    assert (code, canned, err) == (0, [quick], "measuring\n")
    assert {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.*")} == files
    if "--json" in options:
        assert json.loads(out)["study"] == "runtime"
        assert not files or json.loads((tmp_path / "x" / "runtime.json").read_text(encoding="utf-8")) == json.loads(out)


@pytest.mark.parametrize(
    ("folder", "sentence"),
    [
        ("taken", approved("study.choose_out")),
        ("taken/below", approved("study.choose_out")),
        ("x" * 300, approved("study.choose_out")),
        ("there", "runtime.png"),
    ],
)
def test_what_is_in_the_way_is_one_sentence_before_anything_is_measured(run, tmp_path, canned, folder, sentence):
    (tmp_path / "taken").write_text("", encoding="utf-8")
    (tmp_path / "there" / "runtime.png").mkdir(parents=True)
    code, out, err = run("study", "runtime", "--out", tmp_path / folder)
    assert (code, out, err.count("\n"), canned) == (2, "", 1, [])
    assert sentence in err


def test_a_folder_that_cannot_be_written_to_is_one_sentence(run, tmp_path, canned, monkeypatch):
    def refuse(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.NamedTemporaryFile", refuse)
    code, _, err = run("study", "runtime", "--out", tmp_path)
    assert code == 2
    assert "Permission denied" in err
    assert err.count("\n") == 1
    assert canned == []


@pytest.mark.parametrize("name", STUDIES)
def test_each_study_is_found_by_its_name(run, tmp_path, monkeypatch, name):
    study = import_module(f"skincal.studies.{STUDIES[name][0]}")
    monkeypatch.setattr(study, "run", lambda quick, _: {"study": name, "quick": quick})
    monkeypatch.setattr(study, "summary", lambda result: [f"measured {result['study']}"])
    monkeypatch.setattr(study, "draw", lambda _, figure: figure.add_subplot().plot([0, 1]))
    code, out, _ = run("study", name, "--quick", "--out", tmp_path)
    assert code == 0
    assert f"measured {name}" in out
    assert {path.name for path in tmp_path.iterdir()} == {f"{name}.{ending}" for ending in ("json", "svg", "png")}


@pytest.mark.parametrize("misses", [[], ["distances between three modules"]])
@pytest.mark.parametrize("options", [["--json"], ["--out", "measured"]])
def test_a_case_that_does_not_hold_ends_the_study_with_exit_code_1(run, tmp_path, monkeypatch, canned, misses, options):
    monkeypatch.chdir(tmp_path)
    result = {**runtime.run(True, canned.append), "misses": misses}
    monkeypatch.setattr(runtime, "run", lambda *_: result)
    code, out, _ = run("study", "runtime", *options)
    assert code == (1 if misses else 0)
    assert "wrote " in out or json.loads(out) == result


def test_the_studies_are_listed_without_being_loaded():
    script = (
        "import sys\n"
        "from skincal.cli import main\n"
        "main(['study', '--help'])\n"
        "print('HEAVY', sorted({'matplotlib', 'scipy', 'skincal.studies.runtime', 'skincal.simulation'} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.rstrip().endswith("HEAVY []")
    assert all(name in done.stdout for name in STUDIES)
