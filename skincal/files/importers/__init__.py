"""Recordings of other programs as the chunks of a session."""
