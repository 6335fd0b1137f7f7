"""The settings of a codec: converts them from strings, checks their ranges, and describes them.

`Settings` is a frozen dataclass of int, float, bool, str and `Literal` fields. A field may say its range:

    components: Count = 16  # eigen-ABRDFs
    kept: Annotated[float, Range(0.1, 1)] = 0.5
"""

import dataclasses
import inspect
import math
import re
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from bench.errors import InputError, did_you_mean


@dataclass(frozen=True)
class Range:
    """From `low` to `high`; with `above`, `low` itself is left out."""

    low: float = -math.inf
    high: float = math.inf
    above: bool = False

    def __contains__(self, value: float) -> bool:
        return (self.low < value or (self.low == value and not self.above)) and value <= self.high

    def __str__(self) -> str:
        if self.high == math.inf:
            return f"{'>' if self.above else '≥'} {self.low:g}"
        first = f"above {self.low:g} and up" if self.above else f"from {self.low:g}"
        return f"{first} to {self.high:g}"


Count = Annotated[int, Range(1)]
Natural = Annotated[int, Range(0)]
Positive = Annotated[float, Range(0, above=True)]
NotNegative = Annotated[float, Range(0)]
Share = Annotated[float, Range(0, 1)]

_WORDS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}


@dataclass(frozen=True)
class Setting:
    """The description of a setting: name, default, allowed values, and the comment beside it."""

    name: str
    default: str
    kind: str
    meaning: str


def parse(owner: str, settings: type, values: dict[str, Any]) -> Any:
    """Make the `Settings` object of the codec `owner`, with some fields set from Python values or strings.

    `InputError` where a field is unknown (with the nearest name), or a value does not convert or is out of range.
    """
    kinds = get_type_hints(settings, include_extras=True)
    for name in values:
        if name not in kinds:
            raise InputError(f"codec {owner} has no setting {name!r}{did_you_mean(name, kinds)}")
    return settings(**{name: convert(owner, name, kinds[name], value) for name, value in values.items()})


def convert(owner: str, name: str, kind: Any, value: Any) -> Any:
    """Convert the value of a setting. An `InputError` says which values are allowed."""
    try:
        found = _converted(kind, value)
    except (KeyError, ValueError, TypeError, OverflowError):
        found = None
    if found is None:
        raise InputError(f"setting {name} of codec {owner} must be {_wanted(kind)}, not {value!r}")
    return found


def _converted(kind: Any, value: Any) -> Any:
    """The converted value, or None where it is out of range; raises where it is of another type."""
    plain, limits = _parts(kind)
    if get_origin(plain) is Literal:
        return value if value in get_args(plain) else None
    if isinstance(value, str) and plain is bool:
        return _WORDS[value.lower()]
    if isinstance(value, bool) != (plain is bool):
        return None
    if plain is int and int(value) != float(value):
        return None
    found = plain(value)
    if plain in (int, float) and not (math.isfinite(found) and found in limits):
        return None
    return found


def _parts(kind: Any) -> tuple[Any, Range]:
    """The type of a field, and its range."""
    if get_origin(kind) is not Annotated:
        return kind, Range()
    plain, *extras = get_args(kind)
    return plain, next((extra for extra in extras if isinstance(extra, Range)), Range())


def _wanted(kind: Any) -> str:
    """The allowed values of a setting, in words."""
    plain, limits = _parts(kind)
    if get_origin(plain) is Literal:
        return " or ".join(map(repr, get_args(plain)))
    words = {bool: "true or false", int: "a whole number", float: "a finite number", str: "a word"}
    return words.get(plain, plain.__name__) + (f" {limits}" if limits != Range() else "")


def described(settings: type) -> list[Setting]:
    """Describe every setting of a `Settings` class, in order. Meanings are the comments in its source, if available."""
    kinds, comments = get_type_hints(settings, include_extras=True), _comments(settings)
    return [
        Setting(field.name, _shown(field.default), _wanted(kinds[field.name]), comments.get(field.name, ""))
        for field in dataclasses.fields(settings)
    ]


def _shown(value: Any) -> str:
    """A default as `--set` takes it."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _comments(settings: type) -> dict[str, str]:
    """The comment beside each field of a class and of those it derives from."""
    found: dict[str, str] = {}
    for owner in reversed(settings.__mro__[:-1]):
        try:
            source = inspect.getsource(owner)
        except (OSError, TypeError):  # a class without a source file
            continue
        found |= dict(re.findall(r"^\s+(\w+): [^#\n]*#\s*(.*)$", source, re.M))
    return found
