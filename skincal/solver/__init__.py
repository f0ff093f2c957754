"""The compiled solver: `solver.wasm`, built from `source` by `python -m tools.solver`, and its Python side.

`tables.py` has the structs and numbers that both share, `machine.py` the memory that it works in.

`skincal.taxels`, `skincal.modules` and `skincal.mesh` call it. Why WebAssembly: `docs/decisions/compiled-solver.md`.
"""
