"""The compiled solver: `solver.wasm`, built from `source` by `python -m tools.solver`, and the memory it works in.

Its mathematics stands in `source`; what it is asked and what it answers, in numpy's arrays, in `skincal.taxels` and
`skincal.mesh`. Why WebAssembly: `docs/decisions/compiled-solver.md`.
"""
