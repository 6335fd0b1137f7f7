"""Runs suites: jobs, where they work, what they leave; and what is derived from their records."""
