"""Build the compiled solver from its source: `python -m tools.solver`.

It writes `tables.h` from `skincal/solver/tables.py`, then compiles. The compiler comes from the package index like any other
tool, and the result has the same bytes on every machine; `tests/skincal/solver/` makes both again and compares.
"""

import subprocess
import sys
import tempfile
import textwrap
from pathlib import Path

from skincal.solver.machine import SOLVER_PROGRAM
from skincal.solver.tables import SHARED_NUMBERS, SHARED_TABLES, TABLE_OF_FUNCTION, Table, layout_number

C_SOURCE = SOLVER_PROGRAM.with_name("source") / "solver.c"
HEADER = C_SOURCE.with_name("tables.h")
COMPILER_FLAGS = [
    "-target", "wasm32-freestanding", "-nostdlib", "-std=c11", "-O3", "-msimd128", "-mbulk-memory", "-ffp-contract=off",
    "-fvisibility=hidden", "-Wall", "-Wextra", "-Werror", "-Wl,--no-entry", "-Wl,--export-dynamic", "-Wl,-s",
]  # fmt: skip

TRAP_FLAGS = ("-fsanitize=undefined,local-bounds,implicit-conversion", "-fsanitize-trap=all")
"""Undefined behaviour of C ends a program with these flags. The tests run such a build."""

_HEADER_BEGIN = """\
/* Written by `python -m tools.solver` from `skincal/solver/tables.py`, where the numbers have their reasons. Do not edit. */
#ifndef TABLES_H
#define TABLES_H

#include "base.h"

#define LAYOUT_NUMBER {layout}

{numbers}

#define OFFSET(table, field, bytes) _Static_assert(__builtin_offsetof(table, field) == bytes, #table "." #field)
#define SIZE(table, bytes) _Static_assert(sizeof(table) == bytes, #table)
"""


def header() -> str:
    """Write the structs and numbers that Python and the solver share as a C header."""
    numbers = [
        f"enum {{ {name} = {value} }};" if isinstance(value, int) else f"static const double {name} = {value!r};"
        for name, value in SHARED_NUMBERS.items()
    ]
    questions = "\n".join(f"    {table} {function};" for function, table in TABLE_OF_FUNCTION.items())
    return "\n".join(
        [
            _HEADER_BEGIN.format(layout=layout_number(), numbers="\n".join(numbers)),
            *(_struct(table) for table in SHARED_TABLES.values()),
            f"/* The question of each function. */\ntypedef union {{\n{questions}\n}} Questions;\n",
            "#endif\n",
        ]
    )


def _struct(table: Table) -> str:
    lines = [f"/* {table.meaning} */", "typedef struct {"]
    for field in table.fields.values():
        lines.append(f"    {field.declaration}{f' /* {field.meaning} */' if field.meaning else ''}")
    lines.append(f"}} {table.name};")
    checks = [f"OFFSET({table.name}, {name}, {table.offsets[name]});" for name in table.fields]
    lines += textwrap.wrap(" ".join([*checks, f"SIZE({table.name}, {table.dtype.itemsize});"]), 128, break_long_words=False)
    return "\n".join([*lines, ""])


def build(*flags: str) -> bytes:
    """Compile the solver with additional flags and return the program. Raises CalledProcessError on compiler errors."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / SOLVER_PROGRAM.name
        # From its own folder: no path of the machine gets into the program.
        command = [sys.executable, "-m", "ziglang", "cc", *COMPILER_FLAGS, *flags, "-o", str(out), C_SOURCE.name]
        subprocess.run(command, cwd=C_SOURCE.parent, check=True)
        return out.read_bytes()


if __name__ == "__main__":
    HEADER.write_text(header(), encoding="utf-8")
    SOLVER_PROGRAM.write_bytes(build())
    print(f"{SOLVER_PROGRAM}: {SOLVER_PROGRAM.stat().st_size} bytes")
