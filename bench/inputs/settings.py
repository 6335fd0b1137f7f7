"""Values that a user gives: converts them, checks their types and ranges, and describes them.

The settings of a codec are a frozen dataclass of int, float, bool, str and `Literal` fields; those of a suite or a
scene may also be tuples and nested dataclasses. A field may give its range:

    components: Count = 16  # eigen-ABRDFs
    share: Annotated[float, Range(0.1, 1)] = 0.5

`parse` takes the settings of a codec, as values or strings; `table` takes a table of a TOML file, read by `read_toml`,
in which strings are not converted to numbers.

Throughout, `kind` is the type of a field as it is annotated: `int`, `Count`, `Literal["log", "rgb"]`, `tuple[int,
...]`, a dataclass. With `words`, values may be strings as on a command line: `"16"` for 16, `"true"` for True. Errors
are an `InputError` that says which values are allowed.
"""

import dataclasses
import inspect
import math
import re
import tomllib
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from bench.inputs.errors import InputError, did_you_mean, readable, refuse_pipe, shown


@dataclass(frozen=True)
class Range:
    """From `low` to `high`; with `above`, `low` itself is excluded, with `below`, `high`."""

    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    below: bool = False

    def __contains__(self, value: float) -> bool:
        """Whether a value lies in the range."""
        high_enough = self.low < value or (self.low == value and not self.above)
        low_enough = value < self.high or (value == self.high and not self.below)
        return high_enough and low_enough

    def __str__(self) -> str:
        """As messages and lists show it: `≥ 1`, `> 0`, `from 0 to 1`, `from 0 to below 1` or `above 0 and up to 1`."""
        if self.high == math.inf:
            return f"{'>' if self.above else '≥'} {self.low:g}"
        first = f"above {self.low:g} and up" if self.above else f"from {self.low:g}"
        return f"{first} to {'below ' if self.below else ''}{self.high:,.10g}"


Count = Annotated[int, Range(1)]
Natural = Annotated[int, Range(0)]
Seed = Annotated[int, Range(0, 2**31 - 1)]  # of a repetition of a fit
Positive = Annotated[float, Range(0, above=True)]
NotNegative = Annotated[float, Range(0)]
Share = Annotated[float, Range(0, 1)]
Threads = Annotated[int, Range(1, 1024)]
# Limits of a network; larger values are not useful for a decoder, and could exhaust memory.
Layers = Annotated[int, Range(1, 64)]
Width = Annotated[int, Range(1, 4096)]
BatchSize = Annotated[int, Range(1, 1 << 22)]

# Metadata of a setting that files hold only where it differs from its default. A setting that an older codec is given
# later has it, so that files without the new feature stay what they were.
IF_SET = {"written": "if set"}

WORD = 1 << 12  # the most characters of a string
TOML = 1 << 20  # the most bytes of a file of settings
WHOLE = 1 << 53  # larger whole numbers are not exact as floats

# What a command line may give for a bool.
_WORDS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}


@dataclass(frozen=True)
class Setting:
    """The description of a setting for a reader, in words."""

    name: str
    default: str  # as a command line takes it
    kind: str  # the allowed values: `a whole number ≥ 1`
    meaning: str  # the comment beside the field; "" without one


def parse(owner: str, settings: type, values: dict[str, Any]) -> Any:
    """Make the `Settings` object of the codec `owner`, with some fields set from Python values or strings. Raises
    `InputError` if a field is unknown (with the nearest name), or a value does not convert or is out of range."""
    kinds = _kinds(settings)
    for name in values:
        if name not in kinds:
            raise InputError(f"codec {owner} has no setting {name!r}{did_you_mean(name, kinds)}")
    converted_values = {name: convert(owner, name, kinds[name], value) for name, value in values.items()}
    return settings(**converted_values)


def convert(owner: str, name: str, kind: Any, value: Any) -> Any:
    """Convert the value, or the string for it, of the setting `name` of the codec `owner`, whose type is `kind`."""
    return converted(f"setting {name} of codec {owner}", kind, value, words=True)


def converted(what: str, kind: Any, value: Any, words: bool = False) -> Any:
    """Convert a value, which errors call `what`, to the type `kind`. With `words` it may be a string for the value.

    An `InputError` says which values are allowed.
    """
    try:
        return _value_of_kind(what, kind, value, words)
    except InputError:  # of a value inside a list or a table, which it names
        raise
    except (KeyError, ValueError, TypeError, OverflowError):
        raise InputError(f"{what} must be {_allowed_in_words(kind)}, not {shown(value)}") from None


def table(where: str, kind: type, given: Any) -> Any:
    """Make an object of the dataclass `kind` from `given`, the value in a file that should be a table (a dict).

    An `InputError` names `where` (the file and the place in it), and the field that is missing, unknown or wrong.
    """
    values = fields(where, kind, given)
    for field in dataclasses.fields(kind):
        has_default = field.default is not dataclasses.MISSING or field.default_factory is not dataclasses.MISSING
        if field.name not in values and not has_default:
            raise InputError(f"{where}: {field.name} is missing")
    try:
        return kind(**values)
    except InputError as error:  # values that do not go together, found by the class itself
        raise InputError(f"{where}: {error}") from None


def fields(where: str, kind: type, given: Any, without: Collection[str] = ()) -> dict[str, Any]:
    """The converted values of a table, by name of a field of the dataclass `kind`. Fields may be missing.

    Fields in `without` are no keys of this table. `given` and `where` are those of `table`.
    """
    if not isinstance(given, dict):
        raise InputError(f"{where} must be a table, not {shown(given)}")
    kinds = {name: kind_of_field for name, kind_of_field in _kinds(kind).items() if name not in without}
    for name in given:
        if name not in kinds:
            raise InputError(f"{where}: no key {shown(name)}{did_you_mean(name, kinds)}")
    return {name: converted(f"{where}: {name}", kinds[name], value) for name, value in given.items()}


def read_toml(path: Path) -> str:
    """The text of a TOML file of settings, not parsed. `InputError` if it cannot be read or is larger than 1 MiB."""
    refuse_pipe(path)
    with readable(str(path), "give a text file of settings"):
        if path.stat().st_size > TOML:
            raise InputError(f"{path}: it is larger than {TOML >> 20} MiB, too large for a file of settings")
        return path.read_text(encoding="utf-8-sig")  # some editors begin a file with a mark


def shipped_toml(package: str) -> dict[str, str]:
    """The text of each TOML file in a package of this suite, by the file's name without the ending."""
    shipped = (file for file in files(package).iterdir() if file.name.endswith(".toml"))
    return {file.name.removesuffix(".toml"): file.read_text(encoding="utf-8") for file in sorted(shipped, key=str)}


def parse_toml(where: str, text: str) -> dict[str, Any]:
    """The table of a TOML text, from keys to values. `InputError`, which names `where`, if it is not TOML, or nested
    too deeply."""
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise InputError(f"{where}: it is nested too deeply") from error
    except ValueError as error:  # from TOML, or from a number with thousands of digits
        raise InputError(f"{where}: it is not TOML: {error}") from error


@cache
def _kinds(kind: type) -> dict[str, Any]:
    """The type of each field of a dataclass, with its range, by name."""
    kinds = get_type_hints(kind, include_extras=True)  # the extras are the ranges; class variables are there, too
    return {field.name: kinds[field.name] for field in dataclasses.fields(kind)}


def _value_of_kind(what: str, kind: Any, value: Any, words: bool) -> Any:
    """The converted value; the arguments are those of `converted`.

    Raises `ValueError`, or what Python's conversion raises, if the value has another type or is out of range.
    """
    plain, limits = _type_and_range(kind)
    if get_origin(plain) is Literal:
        return _choice(get_args(plain), value, words)
    if get_origin(plain) is tuple:
        return _tuple(what, get_args(plain), value, words)
    if dataclasses.is_dataclass(plain):
        return table(what, plain, value)  # type: ignore[arg-type]
    if plain is bool:
        if isinstance(value, bool):
            return value
        _need(words and isinstance(value, str))  # 1 is no bool; a word that is none raises a `KeyError` below
        return _WORDS[value.lower()]
    if plain is str:
        _need(isinstance(value, str) and len(value) <= WORD)
        return str(value)
    return _number(plain, limits, value, words)


def _choice(choices: tuple[Any, ...], value: Any, words: bool) -> Any:
    """One of the values of a `Literal`, texts or whole numbers."""
    as_string = words and isinstance(value, str) and value not in choices  # only a number may still be meant
    choice = int(value) if as_string else value
    _need(type(choice) in (str, int) and choice in choices)  # by type, because True equals 1
    return choice


def _tuple(what: str, kinds: tuple[Any, ...], value: Any, words: bool) -> tuple[Any, ...]:
    """A tuple from a list: `tuple[X, ...]` has any number of values of one type, `tuple[X, Y]` one of each type."""
    _need(isinstance(value, list))
    kind_of_each = (kinds[0],) * len(value) if kinds[-1] is ... else kinds
    _need(len(value) == len(kind_of_each))
    return tuple(converted(what, kind, item, words) for kind, item in zip(kind_of_each, value, strict=True))


def _number(plain: type, limits: Range, value: Any, words: bool) -> Any:
    """An int or a float within its limits. True and false are no numbers, and an int must not lose digits."""
    _need(not isinstance(value, bool) and (words or not isinstance(value, str)))
    if plain is int:
        _need(int(value) == float(value))
    number = plain(value)
    _need(math.isfinite(number) and number in limits)
    if plain is int:
        _need(abs(number) <= WHOLE)
    return number


def _need(condition: bool) -> None:
    """Raise a `ValueError`, from which `converted` makes its message, unless the condition holds."""
    if not condition:
        raise ValueError


def _type_and_range(kind: Any) -> tuple[Any, Range]:
    """The type of a field without None and without its range, and the range; one without limits if it gives none."""
    if get_origin(kind) is UnionType:  # `X | None`
        kind = next(each for each in get_args(kind) if each is not NoneType)
    if get_origin(kind) is not Annotated:
        return kind, Range()
    plain, *extras = get_args(kind)
    for extra in extras:
        if isinstance(extra, Range):
            return plain, extra
    return plain, Range()


def _allowed_in_words(kind: Any) -> str:
    """The values that a field of some type allows, in words for messages and lists."""
    plain, limits = _type_and_range(kind)
    if get_origin(plain) is Literal:
        return " or ".join(map(repr, get_args(plain)))
    if get_origin(plain) is tuple:
        first, *others = get_args(plain)
        any_number = others == [...]  # `tuple[X, ...]`
        count = "" if any_number else f"{1 + len(others)} "
        return f"a list of {count}values, each {_allowed_in_words(first)}"
    words = {bool: "true or false", int: "a whole number", float: "a finite number", str: "a text"}
    allowed = words.get(plain, "a table")  # a dataclass
    return allowed if limits == Range() else f"{allowed} {limits}"


def descriptions(settings: type) -> list[Setting]:
    """Describe every setting of a `Settings` class, in order. Meanings are the comments in its source, if available."""
    kinds = _kinds(settings)
    comments = _comments(settings)
    described = []
    for field in dataclasses.fields(settings):
        allowed = _allowed_in_words(kinds[field.name])
        described.append(Setting(field.name, as_typed(field.default), allowed, comments.get(field.name, "")))
    return described


def as_typed(value: object) -> str:
    """The value of a setting as TOML and `--set` take it: `true`, not `True`."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _comments(settings: type) -> dict[str, str]:
    """The comment beside each field of a class and of those it derives from, by the field's name."""
    comments: dict[str, str] = {}
    # From the outermost base class on, without `object`, so that a class's own comments replace inherited ones.
    for owner in reversed(settings.__mro__[:-1]):
        try:
            source = inspect.getsource(owner)
        except (OSError, TypeError):  # a class without a source file, whose fields stay without comments
            continue
        # Lines of the form `name: type = default  # comment`.
        comments |= dict(re.findall(r"^\s+(\w+): [^#\n]*#\s*(.*)$", source, re.M))
    return comments
