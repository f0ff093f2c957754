"""All sentences and units that operators read: shared by the window, the commands and the report."""
