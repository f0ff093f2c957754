"""Work beside the window: in a thread, in a process, and the process that simulates devices."""
