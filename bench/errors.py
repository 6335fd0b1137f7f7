"""The errors a user can mend: each message names the file, the field and the remedy, on one line."""

import errno

NO_PLACE = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG)  # no other job would fare better
_NOT_ALLOWED = (errno.EACCES, errno.EPERM, errno.EISDIR, errno.ENOTDIR, errno.ENAMETOOLONG)


class InputError(ValueError):
    """Input that cannot be used (a file, an option, a query). The command line prints it and exits with 2."""


class ContainerError(InputError):
    """A codec file that is truncated, altered, newer than this version, or not a codec file at all."""


class MissingDataError(InputError):
    """A material or a shared network that is known but not on this machine; the message says how to get it."""


def unwritable(error: OSError) -> str:
    """What to say of a file that could not be written, with its remedy; "" where the error is another."""
    place = f"{error.filename}: " if error.filename else ""
    if error.errno in NO_PLACE:
        return f"{place}cannot be written ({error.strerror}): make room, then give the same command again"
    if error.errno in _NOT_ALLOWED and error.filename:
        return f"{place}cannot be used ({error.strerror}): choose another place, or mend its permissions"
    return ""
