"""A session: what was measured, what the operator decided, and the estimates that follow from both."""
