"""The errors a user can mend: each message names the file, the field and the remedy, on one line."""


class InputError(ValueError):
    """Input that cannot be used (a file, an option, a query). The command line prints it and exits with 2."""


class ContainerError(InputError):
    """A codec file that is truncated, altered, newer than this version, or not a codec file at all."""


class MissingDataError(InputError):
    """A material or a shared network that is known but not on this machine; the message says how to get it."""
