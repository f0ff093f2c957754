"""The window's panels, one widget a file: each shows the difference between two ticks and owns no fact."""
