"""The house stands as it says: locks, sizes, what is imported, what is installed."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Collection, Iterator
from functools import cache
from pathlib import Path

import pytest
from packaging.markers import Marker
from packaging.requirements import Requirement

CHECKOUT = Path(__file__).resolve().parent.parent
LOCKS = ("requirements.lock", "requirements-dev.lock")
LINES_MAX = 900
MANY_PARAMETERS = 7
FUNCTIONS_WITH_MANY_PARAMETERS_MAX = 19
"""Ten of them are commands, whose parameters are their options. Lower it when you write one with fewer."""
PACKAGE_OF = {
    "bota_driver": "bota-driver",
    "PIL": "pillow",
    "PySide6": "PySide6-Essentials",
    "ruamel": "ruamel.yaml",
    "serial": "pyserial",
    "vtkmodules": "vtk",
}
"""Where the name that is imported is not the name that is installed."""
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
PLATFORMS = ("linux", "win32", "darwin")


def pins(lock: str) -> list[Requirement]:
    """Every `name==version ; marker` of a lock."""
    text = (CHECKOUT / lock).read_text(encoding="utf-8")
    return [Requirement(line.rstrip(" \\")) for line in text.splitlines() if re.match(r"[A-Za-z0-9]", line)]


def chosen(lock: str, python: str, platform: str = "linux") -> dict[str, str]:
    """Name to version of what a machine gets."""
    machine = {"python_version": python, "python_full_version": f"{python}.9", "sys_platform": platform}
    return {pin.name: str(pin.specifier) for pin in pins(lock) if pin.marker is None or pin.marker.evaluate(machine)}


def run(*arguments: str, timeout: float = 60.0, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=CHECKOUT,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )


@pytest.mark.parametrize("lock", LOCKS)
def test_the_qt_that_aborts_on_python_3_11_is_locked_out(lock: str) -> None:
    assert chosen(lock, "3.11")["pyside6-essentials"] != "==6.12.0"
    assert all("pyside6-essentials" in chosen(lock, python) for python in PYTHONS)


def test_the_qt_that_aborts_on_python_3_11_cannot_be_installed_with_the_package_either() -> None:
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [Requirement(text) for text in project["dependencies"] if text.startswith("PySide6")]
    for python, allowed in (("3.11", False), ("3.12", True)):
        here = [each for each in wanted if each.marker is None or each.marker.evaluate({"python_version": python})]
        assert len(here) == 1
        assert here[0].specifier.contains("6.12.0") is allowed


@pytest.mark.parametrize("lock", [*LOCKS, "requirements-uv.lock"])
def test_a_lock_names_no_host_and_has_hashes_for_every_file(lock: str) -> None:
    text = (CHECKOUT / lock).read_text(encoding="utf-8")
    assert not re.search(r"://|--index-url|--extra-index-url|--find-links|--trusted-host", text)
    blocks = re.split(r"^(?=[A-Za-z0-9])", text, flags=re.MULTILINE)[1:]
    assert len(blocks) == len(pins(lock))
    assert all(re.search(r"--hash=sha256:[0-9a-f]{64}", block) for block in blocks)


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("platform", PLATFORMS)
def test_tests_run_on_the_versions_that_users_get(python: str, platform: str) -> None:
    run_lock, test_lock = (chosen(lock, python, platform) for lock in LOCKS)
    assert run_lock.items() <= test_lock.items()


def test_every_dependency_is_locked() -> None:
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))
    dev = project["dependency-groups"]["dev"]
    for lock, wanted in ((LOCKS[0], project["project"]["dependencies"]), (LOCKS[1], dev)):
        locked = chosen(lock, "3.12")
        for requirement in map(Requirement, wanted):
            if requirement.marker is None or requirement.marker.evaluate({"python_version": "3.12", "sys_platform": "linux"}):
                version = locked[requirement.name.lower()].removeprefix("==")
                assert requirement.specifier.contains(version), requirement


def test_what_has_no_wheel_for_a_platform_is_not_wanted_there() -> None:
    """There the window is silent; it would otherwise not be installed at all."""
    markers = {pin.name: pin.marker for lock in LOCKS for pin in pins(lock) if pin.name in {"miniaudio", "cffi"}}
    for marker in markers.values():
        assert marker is not None
        for platform, machine, wanted in (("linux", "aarch64", False), ("linux", "x86_64", True), ("darwin", "arm64", True)):
            assert marker.evaluate({"sys_platform": platform, "platform_machine": machine}) is wanted
    assert len(markers) == 2


def test_markers_of_the_lock_are_about_python_and_platform_only() -> None:
    known = {"python_full_version", "python_version", "implementation_name", "sys_platform", "platform_machine"}
    markers = [str(pin.marker) for lock in LOCKS for pin in pins(lock) if pin.marker is not None]
    names = {name for marker in markers for name in re.findall(r"[a-z_]+(?= *[<>=!])", str(Marker(marker)))}
    assert names <= known


@cache
def nodes(path: Path) -> list[ast.AST]:
    """Functions without their bodies, imports, and calls that import or open a file: whole trees would take much memory."""
    found: list[ast.AST] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            found.append(ast.copy_location(ast.FunctionDef(node.name, node.args, [], []), node))
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found.append(node)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
            name = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
            found += [node] * (name in ("import_module", "read_text", "write_text"))
    return found


def python_files() -> list[Path]:
    folders = ("app", "skincal", "tests", "tools")
    return [*CHECKOUT.glob("*.py"), *(path for folder in folders for path in (CHECKOUT / folder).rglob("*.py"))]


def test_no_module_grows_too_long() -> None:
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in python_files()}
    assert {str(path): length for path, length in lengths.items() if length > LINES_MAX} == {}


def modules() -> dict[str, Path]:
    """Name and file of every module of the program and of its tools, with the commands of the checkout."""
    paths = [
        *CHECKOUT.glob("*.py"),
        *(path for folder in ("app", "skincal", "tools") for path in (CHECKOUT / folder).rglob("*.py")),
    ]
    return {".".join(path.relative_to(CHECKOUT).with_suffix("").parts).removesuffix(".__init__"): path for path in paths}


def test_few_functions_have_many_parameters() -> None:
    many: list[str] = []
    for name, path in modules().items():
        for node in nodes(path):
            if isinstance(node, ast.FunctionDef):
                given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                own = [each.arg for each in given if each.arg not in ("self", "cls")]
                many += [f"{name}.{node.name}: {len(own)}"] * (len(own) >= MANY_PARAMETERS)
    assert len(many) <= FUNCTIONS_WITH_MANY_PARAMETERS_MAX, "\n".join(many)


def test_each_folder_of_tests_is_a_room_of_the_program() -> None:
    """A room's tests are where the room is; `fuzz` and `consumers` are for all, others are run by their names."""
    files = [path.relative_to(CHECKOUT / "tests") for path in (CHECKOUT / "tests").rglob("*.py")]
    folders = {path.parent for path in files if not {"benchmarks", "consumers", "fuzz", "long"} & {*path.parts}} - {Path()}
    assert {str(folder) for folder in folders if not (CHECKOUT / folder / "__init__.py").is_file()} == set()
    names = [path.name for path in files if path.name != "conftest.py"]
    assert {name for name in names if names.count(name) > 1} == set()


def test_a_test_file_has_the_name_of_a_module_or_says_what_it_proves() -> None:
    """`test_links.py` or `test_links_lost.py` for `links.py` of its room; what goes across modules says so first."""
    nameless: list[str] = []
    for path in (CHECKOUT / "tests").rglob("test_*.py"):
        room = CHECKOUT / path.parent.relative_to(CHECKOUT / "tests")
        stem = path.stem.removeprefix("test_")
        of_module = any(f"{stem}_".startswith(f"{module.stem}_") for module in room.rglob("*.py"))
        if not of_module and ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) is None:
            nameless.append(str(path))
    assert nameless == []


def neighbours(path: Path, known: Collection[str]) -> set[str]:
    """Modules of `known` that a file imports, also inside functions and for type checkers alone."""
    found: set[str] = set()
    for node in nodes(path):
        if isinstance(node, ast.ImportFrom):
            full = (f"{node.module}.{alias.name}" for alias in node.names)
            found |= {name if name in known else str(node.module) for name in full}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found & set(known)


def test_no_files_import_each_other_in_a_circle() -> None:
    files = modules()
    graph = {module: neighbours(path, files) - {module} for module, path in files.items()}
    while ends := [module for module, imported in graph.items() if not imported & graph.keys()]:
        for module in ends:
            del graph[module]
    starts = dict(graph)
    while tops := [module for module in starts if not any(module in imported for imported in starts.values())]:
        for module in tops:
            del starts[module]
    assert sorted(starts) == [], "these and only these lie on or between circles"


def imports(path: Path) -> Iterator[str]:
    """Modules that a file imports, also by `import_module("name")`."""
    for node in nodes(path):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "import_module":
            yield from (argument.value for argument in node.args if isinstance(argument, ast.Constant))


def test_sentences_of_the_window_need_what_the_room_of_words_may_not_import() -> None:
    """A file of `app/text` needs the window's state, or a room above `words`; see docs/decisions/words.md."""
    contracts = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    layers = next(each["layers"] for each in contracts if each["name"] == "imports run downward")
    above = ("app.state.", *(f"skincal.{room}." for room in layers[: layers.index("words")]))
    of_the_window = {"__init__.py", "help_text.py", "message.py"}
    files = [path for path in (CHECKOUT / "app" / "text").glob("*.py") if path.name not in of_the_window]
    assert len(files) > 5
    assert [path.name for path in files if not any(name.startswith(above) for name in imports(path))] == []


def test_what_is_imported_is_declared_and_what_is_declared_is_imported() -> None:
    files = [path for folder in ("app", "skincal") for path in (CHECKOUT / folder).rglob("*.py")]
    imported = {name.partition(".")[0] for path in files for name in imports(path)}
    foreign = imported - set(sys.stdlib_module_names) - {"app", "skincal"}
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    optional = [text for texts in project["optional-dependencies"].values() for text in texts]
    declared = {Requirement(text).name for text in (*project["dependencies"], *optional)}
    assert {PACKAGE_OF.get(name, name) for name in foreign} == declared


def test_files_and_folders_that_the_pages_name_exist() -> None:
    """By the whole path or the end of it, as `guide/progress.py`, `links.py` or `panels/`."""
    folders = [
        path for folder in ("app", "skincal", "tools", "tests", "resources", "docs") for path in (CHECKOUT / folder).rglob("*")
    ]
    there = {f"/{path.relative_to(CHECKOUT)}" for path in (*folders, *CHECKOUT.iterdir())}
    gone: list[str] = []
    for page in (CHECKOUT / "README.md", *(CHECKOUT / "docs").rglob("*.md")):
        text = page.read_text(encoding="utf-8")
        named = re.findall(r"`([\w./]+(?:\.py|\.h|/))`", text)
        gone += [f"{page.name}: {name}" for name in named if not any(path.endswith(f"/{name.rstrip('/')}") for path in there)]
        linked = re.findall(r"\]\(([^)#:]+)", text)
        gone += [f"{page.name}: {name}" for name in linked if not (page.parent / name).exists()]
    assert gone == []


def test_files_are_opened_with_a_named_encoding() -> None:
    """On Windows the default is not UTF-8."""
    bare: list[str] = []
    for path in (path for path in python_files() if "tests" not in path.parts):
        for node in nodes(path):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                keywords = {keyword.arg for keyword in node.keywords}
                if node.func.attr in {"read_text", "write_text"} and not keywords & {"encoding", None} and len(node.args) < 2:
                    bare.append(f"{path.relative_to(CHECKOUT)}:{node.lineno}")
    assert bare == []


@pytest.mark.parametrize(
    ("module", "command"),
    [
        ("app", ["--help"]),
        ("app", ["solve", "--help"]),
        ("skincal.cli", ["export", "--help"]),
        ("skincal.cli", ["simulate", "--help"]),
    ],
)
def test_a_command_imports_neither_qt_nor_vtk_nor_scipy(module: str, command: list[str]) -> None:
    script = (
        "import runpy, sys\n"
        f"sys.argv = ['skincal', *{command!r}]\n"
        "try:\n"
        f"    runpy.run_module({module!r}, run_name='__main__', alter_sys=True)\n"
        "except SystemExit as end:\n"
        "    assert not end.code, end.code\n"
        "heavy = {'PySide6', 'vtkmodules', 'vtk', 'pyvista', 'pyvistaqt', 'pyqtgraph', 'matplotlib', 'scipy'}\n"
        "print('HEAVY', sorted(heavy & set(sys.modules)))\n"
    )
    done = run("-c", script)
    assert done.returncode == 0, done.stderr
    assert done.stdout.rstrip().endswith("HEAVY []")
    assert "skincal" in done.stdout


THREADS = """
import ctypes, importlib, pathlib
importlib.import_module({module!r})
import numpy, scipy.linalg
for package in (numpy, scipy):
    place = pathlib.Path(package.__file__).parent
    for library in [*(place.parent / f"{{package.__name__}}.libs").glob("*openblas*"), *place.glob(".dylibs/*openblas*")]:
        blas = ctypes.CDLL(str(library))
        names = ("scipy_openblas_get_num_threads64_", "scipy_openblas_get_num_threads")
        print(next(getattr(blas, name)() for name in names if hasattr(blas, name)))
"""
"""Prints how many threads numpy's and scipy's OpenBLAS take; nothing where they bring none (Accelerate)."""


@pytest.mark.skipif(os.cpu_count() == 1, reason="one core: there is nothing to see")
@pytest.mark.parametrize("wanted", [None, "2"])
@pytest.mark.parametrize("module", ["app.__main__", "skincal.cli", "skincal"])
def test_linear_algebra_takes_one_thread_unless_the_environment_says_otherwise(module: str, wanted: str | None) -> None:
    environment = {name: value for name, value in os.environ.items() if not name.endswith(("NUM_THREADS", "MAXIMUM_THREADS"))}
    if wanted:
        environment["OPENBLAS_NUM_THREADS"] = wanted
    done = run("-c", THREADS.format(module=module), environment=environment)
    assert done.returncode == 0, done.stderr
    assert set(done.stdout.split()) <= {wanted or "1"}


@pytest.mark.skipif(os.cpu_count() == 1, reason="one core: there is nothing to see")
def test_processes_beside_the_studies_take_one_thread_each() -> None:
    environment = {name: value for name, value in os.environ.items() if not name.endswith(("NUM_THREADS", "MAXIMUM_THREADS"))}
    inside = THREADS.format(module="skincal")
    script = f"from skincal.studies.harness import processes\nprocesses().submit(exec, {inside!r}, {{}}).result()\n"
    done = run("-c", script, environment=environment)
    assert done.returncode == 0, done.stderr
    assert set(done.stdout.split()) <= {"1"}


def test_qt_survives_more_void_calls_than_none_has_references() -> None:
    """A broken PySide6 loses one reference to None a call; it starts with some 5,000 (docs/decisions/dependencies.md)."""
    script = (
        "import os; os.environ['QT_QPA_PLATFORM'] = 'offscreen'\n"
        "from PySide6.QtWidgets import QApplication, QWidget\n"
        "application = QApplication([]); widget = QWidget()\n"
        "for _ in range(20_000):\n"
        "    widget.update()\n"
        "print('alive')\n"
    )
    assert run("-c", script).stdout == "alive\n"
