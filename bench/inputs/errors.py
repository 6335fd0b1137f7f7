"""Errors that a user can correct, "did you mean" suggestions, and exit codes.

A message is one line: what is wrong, then after a colon the *remedy*, which is what the user can do about it. Names and
values in it may come from files of others, so `visible` and `shown` make them harmless and short.
"""

import difflib
import errno
import re
import unicodedata
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

FINE = 0  # exit codes
NO = 1  # negative verdict: a regression, a failed check
USAGE = 2  # bad usage or input
FAILED = 3  # some or all jobs failed
NOTHING = 4  # nothing was measured, or nothing is comparable
INTERNAL = 70
INTERRUPTED = 130
UNREAD = 141  # nobody reads the output any more, as after `| head`: what the code would be was not said

NO_PLACE = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG)  # with these, every other job would fail too
# Of Unicode: control characters, ends of lines, marks such as of direction, and bytes of a name that is not UTF-8.
_CONTROL = ("Cc", "Zl", "Zp", "Cf", "Cs")
# `::` and `##` that begin a line, or follow a space: a table may fold a text at any space.
_COMMAND = re.compile(r"(?<!\S)(::|##)")
# With these, the path is to blame.
_NOT_ALLOWED = (errno.EACCES, errno.EPERM, errno.EISDIR, errno.ENOTDIR, errno.ENAMETOOLONG)


class InputError(ValueError):
    """Input that cannot be used (a file, an option, a query). The command line prints it and exits with 2."""


class ContainerError(InputError):
    """A codec file that is truncated, altered, newer than this version, or not a codec file at all."""


class CodecError(InputError):
    """A codec fails on import or construction, or one of its methods returns a wrong type; the message names it."""


class EncodeError(CodecError):
    """A codec's `encode` raises, ends the process, or returns what no codec file can hold; exit code 3."""


class MissingDataError(InputError):
    """A known material or shared network is not on this machine; the message says how to get it."""


def visible(text: str) -> str:
    """The text on one line, with every control character written out, such as `\\n` and `\\x1b`.

    A name that comes from a file must neither steer a terminal nor command a CI service: a `::` or `##` that may come
    to stand at the start of a line is written `\\x3a:` or `\\x23#`.
    """
    printable = text if text.isprintable() else "".join(map(_written_out, text))
    return _COMMAND.sub(_with_first_written_out, printable)


def _with_first_written_out(command: re.Match[str]) -> str:
    """A match of `_COMMAND`, with the first of its two characters in hexadecimal digits: `\\x3a:` for `::`."""
    matched = command[0]
    return f"\\x{ord(matched[0]):02x}{matched[1]}"


def _written_out(character: str) -> str:
    """A character, or its escape, such as `\\n` or `\\x1b`, if it is a control character."""
    if unicodedata.category(character) not in _CONTROL:
        return character
    return character.encode("unicode_escape").decode()


def answered(
    method: Callable[..., object], answer: object, due: str, kind: type[CodecError] = CodecError
) -> CodecError:
    """The error for a codec's method that returned something else than `due`; it names the method's file and line.

    `answer` is what it returned, or words for it; `due` says in words what it must return. `kind` is the error's class.
    """
    code = getattr(method, "__code__", None)  # only functions in Python have it
    place = f" ({code.co_filename}:{code.co_firstlineno})" if code else ""
    # `Class.method`, also where the class is made inside a function.
    called = getattr(method, "__qualname__", str(method)).rpartition("<locals>.")[2]
    what = answer if isinstance(answer, str) else f"a {type(answer).__name__}"
    return kind(f"{called}{place} returned {what}, but must return {due}")


@contextmanager
def writable(path: object, remedy: str = "choose another place") -> Iterator[None]:
    """Turn an `OSError` into an `InputError` that names `path` and the remedy."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}): {remedy}") from error


@contextmanager
def installed(message: str) -> Iterator[None]:
    """Turn an `ImportError` into an `InputError` that says what is needed, and how to install it."""
    try:
        yield
    except ImportError as error:
        raise InputError(f"{message} ({error})") from error


def unwritable(error: OSError) -> str:
    """The message for an error of a file that could not be written or used, with the remedy; "" for any other error."""
    place = f"{error.filename}: " if error.filename else ""
    if error.errno == errno.EROFS:  # one of `NO_PLACE`, but making room would not help
        remedy = "choose another place, and another $NEUBTF_CACHE if this is the cache"
        return f"{place}cannot be written ({error.strerror}): {remedy}"
    if error.errno in NO_PLACE:
        return f"{place}cannot be written ({error.strerror}): make room, then give the same command again"
    if error.errno in _NOT_ALLOWED and error.filename:
        return f"{place}cannot be used ({error.strerror}): choose another place, or mend its permissions"
    return ""


def said_by(error: BaseException) -> str:
    """The class of an error and the first line of its message that is not empty; works for any error, even one whose
    `__str__` fails."""
    kind = type(error).__name__
    try:
        lines = str(error).split("\n")
    except Exception:  # a `__str__` of a codec's author
        return f"{kind}, whose message cannot be shown"
    written = [line.strip() for line in lines if line.strip()]
    return f"{kind}: {written[0]}" if written else kind


def refuse_pipe(path: Path) -> None:
    """Raise an `InputError` for a pipe, a socket or a device, which would make a reader wait, or never end."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise InputError(f"{path}: it is neither a file nor a folder: save its output as a file")


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The end of a message on an unknown name: `; did you mean 'pca'?` if a known one is similar, else `; known: …`."""
    in_order = sorted(known)
    similar = difflib.get_close_matches(name, in_order, n=1)
    return f"; did you mean {similar[0]!r}?" if similar else f"; known: {', '.join(in_order) or 'none'}"


def shown(value: object) -> str:
    """An untrusted value for a message: on one line, cut to 60 characters."""
    if isinstance(value, int) and abs(value) >= 1 << 63:  # beyond 64 bits
        return "a number of absurd size"
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # a list with a number of thousands of digits, a list in a list in a list …
        return f"a {type(value).__name__} of absurd size"
    return text if len(text) <= 60 else f"{text[:60]} …"


@contextmanager
def readable(label: str, remedy: str = "the file is damaged; get it again") -> Iterator[None]:
    """Turn any exception of a decoder into an `InputError` that names `label`, what is read, and says the remedy.

    A `MemoryError` stays as it is.
    """
    try:
        yield
    except (InputError, MemoryError):  # the first has a message of its own; for the second the bytes are not to blame
        raise
    # For hostile bytes decoders raise many types, from struct.error to tokenize.TokenError; no list is complete.
    except Exception as error:
        is_of_label = isinstance(error, OSError) and str(error.filename) == label  # and not of a file that it names
        if is_of_label and isinstance(error, FileNotFoundError):
            raise InputError(f"{label}: there is no such file: check the path") from error
        if is_of_label and isinstance(error, IsADirectoryError):
            raise InputError(f"{label}: it is a folder: give a file") from error
        if is_of_label and isinstance(error, PermissionError):  # its content is not to blame
            raise InputError(f"{label}: cannot be read ({error.strerror}): mend its permissions") from error
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{label}: cannot be read ({reason[:200]}): {remedy}") from error
