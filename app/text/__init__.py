"""Every sentence that an operator reads: pure functions of frozen values, without Qt and without state."""
