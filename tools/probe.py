"""Find out, in the finished environment and in a process of its own, whether what the window is made of loads at all.

`python probe.py draw` or `python probe.py show`. Ends with 0, or with 1 and the linker's words. It also leaves behind what a
first start would otherwise wait for: compiled modules and matplotlib's list of fonts, which pyvista asks for.
"""

import ctypes
import importlib
import sys
from pathlib import Path

MODULES = (
    "PySide6.QtWidgets",
    "PySide6.QtOpenGLWidgets",
    "PySide6.QtSvg",
    "vtkmodules.vtkRenderingOpenGL2",
    "matplotlib.font_manager",
    "pyvista.plotting",
    "scipy.optimize",
)


def main() -> int:
    """Load everything; say what does not."""
    try:
        for module in MODULES:
            importlib.import_module(module)
        if sys.argv[1] == "show" and sys.platform.startswith("linux"):
            pyside = importlib.import_module("PySide6")
            ctypes.CDLL(str(Path(str(pyside.__file__)).parent / "Qt" / "plugins" / "platforms" / "libqxcb.so"))
    except (ImportError, OSError) as error:
        print(error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
