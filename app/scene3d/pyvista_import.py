"""Import pyvista's plotter without matplotlib, which it needs for charts and colour maps alone, and without its downloader.

They take more processor time than pyvista itself. Modules stand for them while the plotter is imported; they import the real
ones at the first use.
"""

from __future__ import annotations

import importlib
import sys
import threading
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skincal.geometry import FloatArray

LATE_FIGURES = ("matplotlib", "matplotlib.colors", "matplotlib.pyplot", "matplotlib.backends.backend_agg")
LATE_DOWNLOADER = "pooch"
"""Names of the modules that stand-ins replace."""
DEFAULT_MAP = "viridis"
"""Default colour map of pyvista's themes."""

_IMPORT_LOCK = threading.Lock()


class LateModule(ModuleType):
    """A module that is imported at the first use of a name in it."""

    def __getattr__(self, name: str) -> Any:
        # The import system asks for `__path__` and others.
        if name.startswith("__"):
            raise AttributeError(name)
        self.withdraw()
        return getattr(importlib.import_module(self.__name__), name)

    def withdraw(self) -> None:
        """Let the next import of the name find the real module."""
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]


class LateClass:
    """A class that is imported when the first object of it is made."""

    def __init__(self, module: LateModule, name: str) -> None:
        self._module, self._name = module, name

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return getattr(self._module, self._name)(*arguments, **options)


class LateType(type):
    """A class that stands for one of a module in annotations and `isinstance`."""

    def __instancecheck__(cls, value: object) -> bool:
        real = sys.modules.get(cls.__module__)
        # Before the module is imported there are no objects of its classes.
        return real is not None and not isinstance(real, LateModule) and isinstance(value, getattr(real, cls.__name__))


class LateMaps:
    """matplotlib's colour maps, imported at the first look-up of one that is not the theme's default.

    Each new mapper of pyvista fills its table with the default map. The program's meshes have colours of their own: they get
    grey ones.
    """

    def __init__(self, module: LateModule) -> None:
        self._module = module

    def __getitem__(self, name: str) -> Any:
        return map_to_grey if name == DEFAULT_MAP else self._module.colormaps[name]


def map_to_grey(shares: FloatArray) -> FloatArray:
    """Map shares, (n,) float from 0 to 1, to opaque grey, (n, 4) float."""
    import numpy as np  # the window is on the screen before it

    return np.column_stack([shares, shares, shares, np.ones_like(shares)])


def import_plotter() -> None:
    """Import `pyvista.plotting`; does nothing if it is imported, and waits for another thread that imports it."""
    with _IMPORT_LOCK:
        if "pyvista.plotting" not in sys.modules:
            _import_plotter()


def _import_plotter() -> None:
    late: dict[str, LateModule] = {}
    maps = LateMaps(LateModule("matplotlib"))
    if not any(name in sys.modules for name in LATE_FIGURES):
        late = {name: LateModule(name) for name in LATE_FIGURES}
        _fill_in_names(late, maps)
    if LATE_DOWNLOADER not in sys.modules:
        late[LATE_DOWNLOADER] = LateModule(LATE_DOWNLOADER)
    sys.modules.update(late)
    try:
        importlib.import_module("pyvista.plotting")
    finally:
        for module in late.values():
            module.withdraw()


def _fill_in_names(late: dict[str, LateModule], maps: LateMaps) -> None:
    """Add the names that pyvista imports from the stand-ins."""
    root, colors, canvas = (late[name] for name in ("matplotlib", "matplotlib.colors", "matplotlib.backends.backend_agg"))
    colors.__dict__["ListedColormap"] = LateClass(LateModule(colors.__name__), "ListedColormap")
    colors.__dict__["Colormap"] = LateType("Colormap", (), {"__module__": colors.__name__})
    canvas.__dict__["FigureCanvasAgg"] = LateClass(LateModule(canvas.__name__), "FigureCanvasAgg")
    root.__dict__.update(colors=colors, pyplot=late["matplotlib.pyplot"], colormaps=maps)
