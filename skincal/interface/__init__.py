"""The Python interface for scripts and notebooks: what `import skincal` offers. `docs/python.md` is its tutorial."""
