"""The kinds of values that a field can hold, and the first field of a record that holds something else.

Records are lines of text, which people edit and write by hand. A reader of records relies only on what is checked here.
Fields that are not listed are free, but plain: no deep nesting, and finite numbers that tables can show.
"""

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import chain
from typing import Any

from bench.errors import shown

LARGEST = 1e18  # a larger number is not a measurement
WHOLE = (1 << 63) - 1  # the largest whole number, which seeds reach
DEEPEST = 12
LONGEST = 1 << 20  # the most characters of a text; a traceback is far shorter


@dataclass(frozen=True)
class Plain:
    """A value without parts."""

    words: str
    test: Callable[[Any], bool]


@dataclass(frozen=True)
class Each:
    """An object with any names, whose values are all of one kind."""

    item: "Kind"


@dataclass(frozen=True)
class Several:
    """A list of values of one kind, with a fixed length if one is given."""

    item: "Kind"
    length: int | None = None


@dataclass(frozen=True)
class Fields:
    """An object: its known fields, and which of them it must have."""

    known: "Mapping[str, Kind]"
    needed: tuple[str, ...] = ()
    described: Any = None  # the class that describes them


Kind = Plain | Each | Several | Fields


def _is_number(value: Any) -> bool:
    if value.__class__ is float:
        return -LARGEST <= value <= LARGEST
    return isinstance(value, int | float) and not isinstance(value, bool) and -LARGEST <= value <= LARGEST


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= WHOLE


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= LONGEST


def one_of(*words: str) -> Plain:
    """One of these texts."""
    return Plain(" or ".join(map(repr, words)), lambda value: isinstance(value, str) and value in words)


@cache
def maybe(kind: Plain) -> Plain:
    """The kind, or null."""
    test = kind.test
    return Plain(f"{kind.words} or null", lambda value: value is None or test(value))


NUMBER = Plain("a finite number", _is_number)
POSITIVE = Plain("a finite number > 0", lambda value: _is_number(value) and value > 0)
NOT_NEGATIVE = Plain("a finite number ≥ 0", lambda value: _is_number(value) and value >= 0)
COUNT = Plain("a whole number ≥ 0", _is_count)
TEXT = Plain("a text", _is_text)
NAME = Plain("a name", lambda value: _is_text(value) and bool(value.strip()))
SIDE = Plain("a whole number > 0", lambda value: _is_count(value) and value > 0)
DIGITS = Plain(
    "64 hexadecimal digits", lambda value: _is_text(value) and re.fullmatch("[0-9a-f]{64}", value) is not None
)
FLAG = Plain("true or false", lambda value: isinstance(value, bool))
SETTING = Plain(
    "a finite number, a text, true or false",
    lambda value: isinstance(value, bool) or _is_text(value) or _is_number(value) or _is_count(value),
)
TEXT_OR_TEXTS = Plain(
    "a text, or texts by metric",
    lambda value: all(map(_is_text, value.values() if isinstance(value, dict) else [value])),
)
ANYTHING = Plain("", lambda value: True)
NUMBER_OR_NULL = maybe(NUMBER)

Fault = tuple[str, str]  # the place of a field, `scores/heldout`, and what it must be


def in_words(fault: Fault | None) -> str:
    """A fault in words; "" for none."""
    return f"{fault[0].lstrip('/')} {fault[1]}" if fault else ""


def missing(value: Mapping[str, Any], needed: tuple[str, ...]) -> Fault | None:
    """The first needed field that is missing."""
    return next(((name, "is missing") for name in needed if name not in value), None)


def fault_of(kind: Kind, value: Any, depth: int = 0) -> Fault | None:
    """The first fault of a value, and its place within the value."""
    if kind.__class__ is Plain and kind is not ANYTHING:
        return None if kind.test(value) else ("", f"must be {kind.words}, not {_shown(value)}")
    if depth > DEEPEST:
        return "", "is nested too deeply"
    if isinstance(kind, Several) and (not isinstance(value, list) or kind.length not in (None, len(value))):
        return "", f"must be a list{f' of {kind.length}' if kind.length else ''}, not {_shown(value)}"
    if isinstance(kind, Each | Fields) and not isinstance(value, dict):
        return "", f"must be an object, not {_shown(value)}"
    if isinstance(value, dict):
        return _fault_of_object(kind, value, depth)
    if isinstance(value, list):
        each = kind.item if isinstance(kind, Several) else ANYTHING
        if _all_of_kind(NUMBER if each is ANYTHING else each, value):
            return None
        return next((fault for item in value if (fault := fault_of(each, item, depth + 1))), None)
    return None if value is None else fault_of(SETTING, value, depth)


def _fault_of_object(kind: Kind, value: Mapping[str, Any], depth: int) -> Fault | None:
    if isinstance(kind, Each) and _all_of_kind(kind.item, value.values()):
        return None  # the common case, tested thousands of times a run
    known: Mapping[str, Kind] = {}
    others: Kind = kind.item if isinstance(kind, Each) else ANYTHING
    if isinstance(kind, Fields):
        known = kind.known
        if absent := missing(value, kind.needed):
            return absent
    for name, item in value.items():
        each = known.get(name, others)
        if each.__class__ is Plain and each is not ANYTHING and each.test(item):
            continue
        if fault := fault_of(each, item, depth + 1):
            return f"{name:.60}/{fault[0]}".rstrip("/"), fault[1]
    return None


def _all_of_kind(kind: Kind, values: Collection[Any]) -> bool:
    """Whether all values are of a kind, by a fast test; False only says that this test cannot tell."""
    if isinstance(kind, Each):
        objects = {*map(type, values)} == {dict}
        return objects and _all_of_kind(kind.item, [*chain.from_iterable(map(dict.values, values))])
    if kind is NUMBER or kind is NUMBER_OR_NULL:
        known = {float, int} if kind is NUMBER else {float, int, type(None)}
        return {*map(type, values)} <= known and all(abs(value or 0) <= LARGEST for value in values)
    return isinstance(kind, Plain) and kind is not ANYTHING and all(map(kind.test, values))


def _shown(value: Any) -> str:
    if isinstance(value, dict | list):
        return f"{'an object' if isinstance(value, dict) else 'a list'} of {len(value)}"
    return shown(value)
