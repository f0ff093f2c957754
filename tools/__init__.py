"""What `start.py` and `check.py` share: a checkout's environment, made from Python's standard library alone."""
