"""What is open: the recording, where it lies, and the tick that drives it; no widgets."""
