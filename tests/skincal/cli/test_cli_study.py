"""`skincal study`: files, JSON on stdout, and a folder that cannot be used."""

import json
import subprocess
import sys
from importlib import import_module

import pytest

from skincal.studies import STUDIES
from skincal.studies.harness import Findings, Study
from tests.approved import approved


def replace_study(monkeypatch, name, numbers, asked):
    """Make a study give these numbers at once, and append whether quick sizes were asked for."""
    module = import_module(f"skincal.studies.{STUDIES[name].module}")
    study = Study(
        name, quick=True, full=False, measure=lambda bench, quick: (asked.append(quick), bench.say("measuring"), numbers)[-1],
        lines=lambda result: [f"measured {result['study']}"], draw=lambda _, figure: figure.add_subplot().plot([0, 1]),
        in_processes=False,
    )  # fmt: skip
    monkeypatch.setattr(module, "THIS_STUDY", study)


@pytest.fixture
def canned(monkeypatch):
    """Make the runtime study give a small result at once; return the list of what it was asked for."""
    asked = []
    replace_study(monkeypatch, "runtime", Findings({"table": []}), asked)
    return asked


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
def test_each_study_is_found_by_its_name_and_writes_its_numbers_and_its_figure(run, tmp_path, monkeypatch, name):
    asked = []
    replace_study(monkeypatch, name, Findings({"numbers": [1]}, {"one": (1.0, "<=", 2.0)}), asked)
    folder = tmp_path / "new" / "measured"
    code, out, err = run("study", name, "--quick", "--out", folder)
    assert (code, asked, err) == (0, [True], "measuring\n")
    assert f"measured {name}" in out
    assert "one: 1, limit <= 2: holds" in out
    assert "wrote " in out
    assert {path.name for path in folder.iterdir()} == {f"{name}.{ending}" for ending in ("json", "svg", "png")}
    written = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    assert list(written) == ["study", "quick", "numbers", "bars"]
    assert (written["study"], written["quick"], written["numbers"]) == (name, True, [1])


@pytest.mark.parametrize("misses", [[], ["distances between three modules"]])
@pytest.mark.parametrize("options", [["--json"], ["--out", "measured"]])
def test_a_case_that_does_not_hold_ends_the_study_with_exit_code_1(run, tmp_path, monkeypatch, misses, options):
    monkeypatch.chdir(tmp_path)
    replace_study(monkeypatch, "runtime", Findings({"misses": misses}), [])
    code, out, _ = run("study", "runtime", *options)
    assert code == (1 if misses else 0)
    assert "wrote " in out or json.loads(out) == {"study": "runtime", "quick": False, "misses": misses}


def test_a_study_without_its_package_says_what_to_type_before_anything_is_made(run, tmp_path, monkeypatch):
    monkeypatch.setattr("skincal.studies.find_spec", lambda _: None)
    code, out, err = run("study", "stability", "--out", tmp_path / "measured")
    assert (code, out) == (2, "")
    assert err == f"skincal: {approved('study.needs_package', study='stability', package='mpmath')}\n"
    assert not (tmp_path / "measured").exists()


def test_only_the_study_that_needs_80_digits_loads_them():
    script = (
        "import sys\n"
        "from skincal.studies import STUDIES, load_study\n"
        "import skincal.cli\n"
        "for name in STUDIES.keys() - {'stability'}: load_study(name)\n"
        "print('LOADED', 'mpmath' in sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == "LOADED False\n"


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
