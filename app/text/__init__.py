"""Every sentence that an operator reads: pure functions of what a tick hands to the views."""
