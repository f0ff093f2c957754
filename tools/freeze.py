"""Build a folder that runs skincal without Python, for the system it is built on: `python -m tools.freeze [--prove-only]`.

PyInstaller collects the program into `dist/skincal`. The folder is then tested without access to the checkout: `solve` and
`report` on the shipped session must equal the checkout's, and the window with its simulated rig must draw taxels and record
pokes. At the end the folder is packed, and sizes and times are printed.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import lzma
import os
import re
import shutil
import statistics
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import minimum_filter

from tools import checkout, install
from tools.checkout import StopError, say

if TYPE_CHECKING:
    from PySide6.QtGui import QImage

BUILD, DIST = checkout.CHECKOUT / "build", checkout.CHECKOUT / "dist"
FROZEN_FOLDER = DIST / "skincal"
FROZEN_PROGRAM = FROZEN_FOLDER / ("skincal.exe" if os.name == "nt" else "skincal")

WHOLE_PACKAGES = ("app", "skincal")
"""Packages that are included whole: many of their modules are imported by name at run time."""
BY_NAME = ("matplotlib.backends.backend_svg", "matplotlib.backends.backend_agg")
"""Modules that matplotlib imports by name to write a report's pictures; PyInstaller cannot see them."""
DATA_FILES = {
    "resources": "skincal/resources",
    "skincal/solver/solver.wasm": "skincal/solver",
    "skincal/reporting/report.html.jinja": "skincal/reporting",
}
UNUSED_MODULES = (
    "tkinter", "_tkinter", "IPython", "pytest", "_pytest", "hypothesis", "PIL.ImageQt", "PySide6.QtNetwork", "PySide6.QtQml",
    "PySide6.QtQuick", "PySide6.QtSql", "PySide6.QtTest", "matplotlib.backends.backend_qtagg", "trimesh", "quadprog",
    "pyqtgraph.examples", "pyqtgraph.opengl", "pyvista.trame", "cmcrameri", "sphinx", "docutils", "setuptools", "pip",
    "yaml", "gi", "zstandard.backend_cffi", "zstandard._cffi", "mkdocs", "airo_models", "jvrc_description", "PIL._avif",
    "PIL._webp", "PIL._imagingft", "PIL._imagingcms",
)  # fmt: skip
"""Optional modules of packages that the program never imports."""
UNUSED_FILES = (
    "PySide6/Qt/translations", "matplotlib/mpl-data/sample_data", "matplotlib/mpl-data/fonts/afm",
    "matplotlib/mpl-data/fonts/pdfcorefonts", "PySide6/Qt/plugins/platforms/libq[elnv]*", "PySide6/Qt/plugins/egl*",
    "PySide6/Qt/plugins/generic", "PySide6/Qt/plugins/platformthemes/libqgtk3*", "PySide6/Qt/plugins/imageformats/libq[jtw]*",
    "PySide6/Qt/plugins/networkinformation", "PySide6/Qt/plugins/tls",
)  # fmt: skip
"""Files of packages that the program never opens: translations, other fonts, displays without X11 and Wayland, pictures."""
CARD_VTK = ("ChartsCore", "PythonContext2D", "ViewsContext2D", "ViewsCore")
"""Modules that pyvista imports by name for the canvas of a graphics card."""
VTK_ROOMS = ("Common", "DataModel", "Filters", "Imaging", "Interaction", "Rendering", "ParallelCore", "IOCore", "IOImage")
"""Name prefixes of the VTK modules that compute and draw. Readers, accelerators and web parts are left out."""
UNUSED_VTK = (
    "FiltersParallel", "FiltersVerdict", "RenderingVR", "RenderingVtkJS", "RenderingWebXR", "RenderingParallel",
    "RenderingLICOpenGL2", "RenderingGL2PS", "RenderingExternal", "RenderingCellGrid", "CommonPython", "FiltersPoints",
    "FiltersMeshing", "FiltersFlowPaths", "FiltersCellGrid", "FiltersGeometryPreview", "FiltersAMR",
    "FiltersGeneric", "FiltersHyperTree", "FiltersSMP", "FiltersT", "FiltersImaging", "FiltersSelection",
    "FiltersProgrammable", "ImagingMorphological", "ImagingStencil", "ImagingFourier", "ImagingStatistics", "ImagingOpenGL2",
    "InteractionImage", "RenderingImage", "RenderingGridAxes", "RenderingLOD", "RenderingSceneGraph", "RenderingVolumeAMR",
)  # fmt: skip
"""Modules with these prefixes that the program never uses."""

XZ_FILTERS = ({"id": lzma.FILTER_X86}, {"id": lzma.FILTER_LZMA2, "preset": 9, "dict_size": 128 << 20})
"""Machine code is prepared for the compression, whose dictionary holds the largest libraries at once."""
WINDOW_HANGS_AFTER_S = 300.0
"""s. A window hangs if neither its picture nor its session changes for longer."""
MAX_POKES_WITHOUT_TAXEL = 60
"""Maximum accepted pokes before the first taxel is drawn."""
MIN_DRAWN_BALL_SIDE_PX = 7
"""px. A square of this side fits into a taxel's ball, but not into a line."""
STARTS_IN_MEDIAN_TIME = 5
"""Starts for the reported median time."""


def main() -> int:
    """Build, prove and pack the folder."""
    parser = argparse.ArgumentParser("tools.freeze", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--prove-only", action="store_true", help="take the folder that was built before")
    try:
        if not parser.parse_args().prove_only:
            _build()
        _prove()
        _pack()
    except StopError as stop:
        say(str(stop))
        return 1
    return 0


def _build() -> None:
    """Collect the program into the folder."""
    import wasmtime

    try:
        from PyInstaller.__main__ import run
    except ImportError as error:
        raise StopError("PyInstaller is not installed; expected what the tests need: run `python3 check.py` once.") from error

    packages = Path(wasmtime.__file__).parent.parent
    # wasmtime loads its library by path, which PyInstaller cannot see.
    libraries = [path for path in (packages / "wasmtime").rglob("*wasmtime.*") if path.suffix in (".so", ".dll", ".dylib")]
    options = ["--noconfirm", "--clean", "--name=skincal", "--contents-directory=parts", "--log-level=WARN"]
    options += [f"--distpath={DIST}", f"--workpath={BUILD}", f"--specpath={BUILD}", f"--paths={checkout.CHECKOUT}"]
    options += [f"--collect-submodules={name}" for name in WHOLE_PACKAGES]
    options += [f"--hidden-import={name}" for name in (*BY_NAME, *kept_vtk())]
    options += [f"--add-data={checkout.CHECKOUT / source}{os.pathsep}{target}" for source, target in DATA_FILES.items()]
    options += [f"--add-binary={library}{os.pathsep}{library.parent.relative_to(packages)}" for library in libraries]
    options += [f"--exclude-module={name}" for name in left_out()]
    run([*options, str(checkout.CHECKOUT / "app" / "__main__.py")])
    _slim()


def _slim() -> None:
    """Delete unused files; on Linux also libraries that only these need, and symbols for debuggers: half of VTK's size."""
    parts = FROZEN_FOLDER / "parts"
    before = _needed_libraries(parts)
    for pattern in UNUSED_FILES:
        for path in parts.glob(pattern):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    while unneeded := before - (needed := _needed_libraries(parts)):
        for name in unneeded:
            for path in parts.rglob(name):
                path.unlink()
        before = needed
    strip = shutil.which("strip") if sys.platform == "linux" else None
    # Libraries in *.libs were changed by auditwheel, and a strip can break those.
    libraries = [
        path for path in parts.rglob("*.so*") if path.is_file() and not path.is_symlink() and ".libs/" not in str(path)
    ]
    if strip is not None:
        for path in libraries:
            subprocess.run([strip, "--strip-unneeded", str(path)], check=True)


def _needed_libraries(parts: Path) -> set[str]:
    """List the libraries that the libraries of a folder load by name; empty on other systems than Linux."""
    libraries = [str(path) for path in parts.rglob("*.so*") if path.is_file()]
    if sys.platform != "linux" or shutil.which("readelf") is None:
        return set()
    read = subprocess.run(["readelf", "--dynamic", "--wide", *libraries], capture_output=True, text=True, check=False)
    return set(re.findall(r"\(NEEDED\).*\[(.*)\]", read.stdout))


def kept_vtk() -> list[str]:
    """List the VTK modules that are not left out: pyvista imports them by name, where PyInstaller cannot see it."""
    import vtkmodules

    names = {path.name.partition(".")[0] for path in Path(vtkmodules.__file__).parent.glob("vtk*.*") if path.suffix != ".pyi"}
    return sorted({f"vtkmodules.{name}" for name in names} - set(left_out()))


def left_out() -> list[str]:
    """Return the modules of the environment that are left out."""
    import vtkmodules

    names = {path.name.partition(".")[0] for path in Path(vtkmodules.__file__).parent.glob("vtk*")}
    kept = tuple(f"vtk{room}" for room in (*VTK_ROOMS, *CARD_VTK))
    dropped = tuple(f"vtk{name}" for name in UNUSED_VTK)
    unused = (name for name in sorted(names) if not name.startswith(kept) or name.startswith(dropped))
    return [*UNUSED_MODULES, "vtk", "vtkmodules.all", *(f"vtkmodules.{name}" for name in unused)]


def _prove() -> None:
    """Run the folder like a machine without Python. Raises StopError if a result differs from the checkout's."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sample = next(FROZEN_FOLDER.glob("*/skincal/resources/sessions/sample"))
        shutil.copytree(sample, folder / "sample")
        frozen, source = [str(FROZEN_PROGRAM)], [str(checkout.interpreter()), "-m", "app"]
        _same_estimates((frozen, source), folder)
        _same_reports((frozen, source), folder)
        say(f"solve on the sample: {_median_s(frozen, folder):.2f} s frozen, {_median_s(source, folder):.2f} s in the checkout")
        times = {}
        with _screen() as grab:
            for label, program in (("frozen", frozen), ("in the checkout", source)):
                times[label] = _time_window(program, folder / label.replace(" ", "-"), grab)
        say("first taxels in the window: " + ", ".join(f"{value:.1f} s {label}" for label, value in times.items()))


def _run(command: Sequence[str], folder: Path) -> str:
    """Run a command in a folder, without the checkout on any path, and return its output. Raises StopError on failure."""
    done = subprocess.run(command, cwd=folder, env=_environment(folder, command), capture_output=True, text=True, check=False)
    if done.returncode:
        raise StopError(f"{' '.join(command)} ended with {done.returncode}:\n{done.stderr[-2000:]}")
    return done.stdout


def _environment(folder: Path, command: Sequence[str]) -> dict[str, str]:
    """Return the environment for a command. The frozen program gets no path of the checkout."""
    environment = {key: value for key, value in install.environment().items() if not key.startswith("PYTHON")}
    environment["HOME"] = environment["XDG_CONFIG_HOME"] = str(folder)
    if command[0] != str(FROZEN_PROGRAM):
        environment["PYTHONPATH"], environment["PYTHONSAFEPATH"] = str(checkout.CHECKOUT), "1"
    return environment


def _median_s(program: Sequence[str], folder: Path) -> float:
    """Return the median wall time of `solve` on the sample, seconds."""
    times: list[float] = []
    for _ in range(STARTS_IN_MEDIAN_TIME):
        begin = time.monotonic()
        _run([*program, "solve", "sample", "--json"], folder)
        times.append(time.monotonic() - begin)
    return statistics.median(times)


def _same_estimates(programs: Sequence[Sequence[str]], folder: Path) -> None:
    """Compare the estimates of both programs."""
    found: list[str] = []
    for number, program in enumerate(programs):
        out = folder / f"{number}.csv"
        _run([*program, "export", "sample", "--format", "csv", "--out", str(out)], folder)
        found.append(out.read_text(encoding="utf-8"))
    if found[0] != found[1]:
        raise StopError("The frozen program's estimates of the sample differ from the checkout's.")


def _same_reports(programs: Sequence[Sequence[str]], folder: Path) -> None:
    """Compare sections, tables and pictures of both programs' reports."""
    found: list[list[str]] = []
    for number, program in enumerate(programs):
        out = folder / f"{number}.html"
        _run([*program, "report", "sample", "--out", str(out)], folder)
        text = out.read_text(encoding="utf-8")
        found.append([*re.findall(r"<h[1-6][^>]*>.*?</h[1-6]>|<(?:table|svg|img)\b", text, re.DOTALL)])
        say(f"report on the sample: {len(text) / 1e6:.1f} MB, {len(found[-1])} headings, tables and pictures")
    if not found[0] or found[0] != found[1]:
        raise StopError("The frozen program's report on the sample has other sections, tables or pictures than the checkout's.")


@contextlib.contextmanager
def _screen() -> Iterator[Callable[[], QImage]]:
    """Yield a function that grabs the screen; on Linux a virtual one."""
    from PySide6.QtGui import QGuiApplication

    with contextlib.ExitStack() as stack:
        if sys.platform == "linux":
            from pyvirtualdisplay.display import Display

            stack.enter_context(Display(visible=False, size=(1280, 800), color_depth=24))
            os.environ["QT_QPA_PLATFORM"] = "xcb"
        application = QGuiApplication(["freeze"])
        yield lambda: application.primaryScreen().grabWindow(0).toImage()
        application.shutdown()


class WindowProgress:
    """Progress of a window towards its first taxel: its picture and the session that it records."""

    def __init__(self, session: Path, grab: Callable[[], QImage]) -> None:
        self._session, self._grab = session, grab
        self._last: tuple[int, QImage | None] = 0, None
        self._changed_s = time.monotonic()
        self.pokes = 0
        """Number of contacts in the session."""

    def update(self) -> bool:
        """Read the session and the screen; return whether a taxel is visible."""
        lines = b"".join(path.read_bytes() for path in sorted(self._session.glob("segment-*.jsonl")))
        self.pokes = lines.count(b'"contact ')
        picture = self._grab()
        if self._last != (len(lines), picture):
            self._last, self._changed_s = (len(lines), picture), time.monotonic()
        return shows_taxels(picture)

    def is_stuck(self) -> bool:
        """Whether the window hangs, or pokes show no taxel."""
        return time.monotonic() - self._changed_s > WINDOW_HANGS_AFTER_S or self.pokes > MAX_POKES_WITHOUT_TAXEL


def _time_window(program: Sequence[str], folder: Path, grab: Callable[[], QImage]) -> float:
    """Open the window on the simulated rig; return the seconds until taxels are visible. Its session must have pokes."""
    folder.mkdir()
    command = [*program, "--new", str(folder / "session")]
    begin = time.monotonic()
    with subprocess.Popen(command, cwd=folder, env=_environment(folder, command)) as window:
        try:
            progress = WindowProgress(folder / "session", grab)
            while not progress.update():
                if window.poll() is not None:
                    raise StopError(f"{program[0]}: ended early with exit code {window.returncode}.")
                if progress.is_stuck():
                    after = f"{time.monotonic() - begin:.0f} s and {progress.pokes} pokes"
                    raise StopError(f"{program[0]}: no taxel is seen in its window after {after}.")
                time.sleep(0.1)
            seconds = time.monotonic() - begin
        finally:
            window.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                window.wait(10.0)
            window.kill()
    solved = json.loads(_run([*program, "solve", str(folder / "session"), "--json"], folder))
    if not solved["pokes"]:
        raise StopError(f"{program[0]}: the session of its window holds no poke.")
    return seconds


def shows_taxels(picture: QImage) -> bool:
    """Whether the 3D view shows balls in a module's hue; other coloured things there are thin."""
    picture = picture.convertToFormat(picture.Format.Format_RGB32)
    shape = (picture.height(), picture.bytesPerLine() // 4, 4)
    pixels = np.frombuffer(picture.constBits(), dtype=np.uint8).reshape(shape)[: shape[0] * 3 // 4, : shape[1] * 6 // 10, :3]
    most, least = pixels.max(axis=2).astype(int), pixels.min(axis=2).astype(int)
    hued = (most > 80) & (3 * (most - least) > most)
    return bool(minimum_filter(hued, MIN_DRAWN_BALL_SIDE_PX).any())


def _pack() -> None:
    """Pack the folder and print its size."""
    size = sum(path.stat().st_size for path in FROZEN_FOLDER.rglob("*") if path.is_file() and not path.is_symlink())
    if os.name == "nt":
        packed = Path(shutil.make_archive(str(FROZEN_FOLDER), "zip", DIST, FROZEN_FOLDER.name))
    else:
        packed = FROZEN_FOLDER.with_suffix(".tar.xz")
        with (
            lzma.open(packed, "wb", format=lzma.FORMAT_XZ, filters=XZ_FILTERS) as file,
            tarfile.open(fileobj=file, mode="w|") as archive,
        ):
            archive.add(FROZEN_FOLDER, FROZEN_FOLDER.name)
    say(f"{FROZEN_FOLDER}: {size / 1e6:.0f} MB; {packed.name}: {packed.stat().st_size / 1e6:.0f} MB")


if __name__ == "__main__":
    sys.exit(main())
