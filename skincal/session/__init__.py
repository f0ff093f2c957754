"""A session: its pokes, the operator's decisions, and the estimates."""
