"""The compiled solver: `solver.wasm`, built from `source` by `python -m tools.solver`, and the memory it works in.

`skincal.taxels`, `skincal.modules` and `skincal.mesh` call it. Why WebAssembly: `docs/decisions/compiled-solver.md`.
"""
