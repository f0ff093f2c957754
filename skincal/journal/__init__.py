"""A session's folder: who writes it, what is written and how it is read back."""
