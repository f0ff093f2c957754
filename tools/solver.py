"""Build the compiled solver from its source: `python -m tools.solver`.

The compiler comes from the package index like any other tool, and the result has the same bytes on every machine;
`tests/skincal/solver/test_machine.py` builds it again and compares.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from skincal.solver.machine import PROGRAM

C_SOURCE = PROGRAM.with_name("source") / "solver.c"
COMPILER_FLAGS = [
    "-target", "wasm32-freestanding", "-nostdlib", "-std=c11", "-O3", "-msimd128", "-mbulk-memory", "-ffp-contract=off",
    "-fvisibility=hidden", "-Wall", "-Wextra", "-Werror", "-Wl,--no-entry", "-Wl,--export-dynamic", "-Wl,-s",
]  # fmt: skip

TRAP_FLAGS = ("-fsanitize=undefined,local-bounds,implicit-conversion", "-fsanitize-trap=all")
"""Undefined behaviour of C ends a program with these flags. The tests run such a build."""


def build(*flags: str) -> bytes:
    """Compile the solver with additional flags and return the program. Raises CalledProcessError on compiler errors."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / PROGRAM.name
        # From its own folder: no path of the machine gets into the program.
        command = [sys.executable, "-m", "ziglang", "cc", *COMPILER_FLAGS, *flags, "-o", str(out), C_SOURCE.name]
        subprocess.run(command, cwd=C_SOURCE.parent, check=True)
        return out.read_bytes()


if __name__ == "__main__":
    PROGRAM.write_bytes(build())
    print(f"{PROGRAM}: {PROGRAM.stat().st_size} bytes")
