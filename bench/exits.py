"""The exit codes of the command line."""

FINE = 0
NO = 1  # the verdict is no: a regression, a failed check
USAGE = 2  # bad usage or input
FAILED = 3  # some or all jobs failed
NOTHING = 4  # nothing was measured, or nothing is comparable
INTERNAL = 70
INTERRUPTED = 130
