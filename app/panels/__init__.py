"""The window's panels, one widget a file: each shows the difference between two frames and owns no fact."""
