"""Import pyvista's plotter without matplotlib's figures, which it needs for charts alone.

`matplotlib.pyplot` and its canvas take a quarter of the processor time to the first picture. Modules stand for them while the
plotter is imported; they import the real ones at the first use.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import Any


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


def import_plotter() -> None:
    """Import `pyvista.plotting`; does nothing if it is imported."""
    if "pyvista.plotting" in sys.modules:
        return
    figures, canvas = LateModule("matplotlib.pyplot"), LateModule("matplotlib.backends.backend_agg")
    late = [module for module in (figures, canvas) if module.__name__ not in sys.modules]
    sys.modules.update({module.__name__: module for module in late})
    # pyvista takes the name out of the module at once.
    canvas.__dict__["FigureCanvasAgg"] = LateClass(LateModule(canvas.__name__), "FigureCanvasAgg")
    try:
        importlib.import_module("pyvista.plotting")
    finally:
        for module in late:
            module.withdraw()
