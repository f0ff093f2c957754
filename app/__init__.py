"""The window of skincal: knows `skincal`, and nothing knows it."""
