"""The page where a part is described: one file a step."""
