"""Runs suites: jobs, the processes that run them, the files that they write, and results derived from records."""
