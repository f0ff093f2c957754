"""A session's report: what it came to, in one file that is read in a browser and on paper."""
