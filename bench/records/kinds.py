"""The kinds of values that a field can hold, and the first field of a record that holds something else.

Records are lines of text, which people edit and write by hand. A reader of records relies only on what is checked here.
Fields that are not listed are free, but plain: no deep nesting, and finite numbers that tables can show.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from bench.inputs.errors import shown

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
    """Whether a value is a finite number of at most `LARGEST`; true and false are none."""
    if value.__class__ is float:
        return -LARGEST <= value <= LARGEST
    return isinstance(value, int | float) and not isinstance(value, bool) and -LARGEST <= value <= LARGEST


def _is_number_or_null(value: Any) -> bool:
    """Whether a value is such a number, or null."""
    if value.__class__ is float:  # the common case, without another call
        return -LARGEST <= value <= LARGEST
    return value is None or _is_number(value)


def _is_count(value: Any) -> bool:
    """Whether a value is a whole number from 0 to `WHOLE`; true and false are none."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= WHOLE


def _is_text(value: Any) -> bool:
    """Whether a value is a text of at most `LONGEST` characters."""
    return isinstance(value, str) and len(value) <= LONGEST


NUMBER = Plain("a finite number", _is_number)
NUMBER_OR_NULL = Plain(f"{NUMBER.words} or null", _is_number_or_null)
POSITIVE = Plain("a finite number > 0", lambda value: _is_number(value) and value > 0)
NOT_NEGATIVE = Plain("a finite number ≥ 0", lambda value: _is_number(value) and value >= 0)
COSINE = Plain("a number from 0 to 1", lambda value: _is_number(value) and 0 <= value <= 1)
COUNT = Plain("a whole number ≥ 0", _is_count)
TEXT = Plain("a text", _is_text)
NAME = Plain("a name", lambda value: _is_text(value) and bool(value.strip()))
SIDE = Plain("a whole number > 0", lambda value: _is_count(value) and value > 0)
DIGITS = Plain("64 hexadecimal digits", lambda value: _is_text(value) and bool(re.fullmatch("[0-9a-f]{64}", value)))
DIRECTION = Plain("'higher' or 'lower'", lambda value: isinstance(value, str) and value in ("higher", "lower"))
FLAG = Plain("true or false", lambda value: isinstance(value, bool))
SETTING = Plain(
    "a finite number, a text, true or false",
    lambda value: isinstance(value, bool) or _is_text(value) or _is_number(value) or _is_count(value),
)
# A codec file may hold any setting that its codec took; a record holds none beyond `LARGEST`.
ANY_SETTING = Plain(
    "a finite number, a text, true or false",
    lambda value: isinstance(value, str | int) or (isinstance(value, float) and math.isfinite(value)),
)
TEXT_OR_TEXTS = Plain(
    "a text, or texts by metric",
    lambda value: all(map(_is_text, value.values() if isinstance(value, dict) else [value])),
)
ANYTHING = Plain("", lambda value: True)


def missing(value: Mapping[str, Any], needed: tuple[str, ...], place: str = "") -> str:
    """The first needed field that is missing, in words; "" if none is."""
    for name in needed:
        if name not in value:
            return f"{place}/{name} is missing".lstrip("/")
    return ""


def fault_of(kind: Kind, value: Any, place: str = "", depth: int = 0) -> str:
    """The first fault of a value at a place, in words: `scores/heldout must be …`; "" for none.

    What has no kind of its own, `ANYTHING`, is still checked inside: objects and lists part by part, and the rest must
    be what a setting may be.
    """
    if isinstance(kind, Plain) and kind is not ANYTHING:  # a value without parts
        return "" if kind.test(value) else _told(place, f"must be {kind.words}, not {_shown(value)}")
    if depth > DEEPEST:
        return _told(place, "is nested too deeply")
    if isinstance(kind, Several) and (not isinstance(value, list) or kind.length not in (None, len(value))):
        length = f" of {kind.length}" if kind.length else ""
        return _told(place, f"must be a list{length}, not {_shown(value)}")
    if isinstance(kind, Each | Fields) and not isinstance(value, dict):
        return _told(place, f"must be an object, not {_shown(value)}")
    if isinstance(value, dict):
        return _fault_in_object(kind, value, place, depth)
    if isinstance(value, list):
        return _fault_in_list(kind, value, place, depth)
    if value is None:
        return ""
    return fault_of(SETTING, value, place, depth)


def _fault_in_object(kind: Kind, value: Mapping[str, Any], place: str, depth: int) -> str:
    """The first missing or wrong field of an object, in words; "" for none."""
    known: Mapping[str, Kind] = {}
    if isinstance(kind, Fields):
        known = kind.known
        absent = missing(value, kind.needed, place)
        if absent:
            return absent
    others = kind.item if isinstance(kind, Each) else ANYTHING  # the kind of fields that have none of their own
    for name, item in value.items():
        kind_of_item = known.get(name, others)
        # The common case is tested here, without a call: it occurs thousands of times a run.
        if kind_of_item.__class__ is Plain and kind_of_item is not ANYTHING and kind_of_item.test(item):
            continue
        of_item = f"{place}/{name:.60}"
        if item.__class__ is dict and kind_of_item.__class__ in (Each, Fields) and depth < DEEPEST:  # common, too
            fault = _fault_in_object(kind_of_item, item, of_item, depth + 1)
        else:
            fault = fault_of(kind_of_item, item, of_item, depth + 1)
        if fault:
            return fault
    return ""


def _fault_in_list(kind: Kind, values: list[Any], place: str, depth: int) -> str:
    """The fault of the first wrong item of a list, in words; "" for none. All items have the place of the list."""
    kind_of_item = kind.item if isinstance(kind, Several) else ANYTHING
    for item in values:
        fault = fault_of(kind_of_item, item, place, depth + 1)
        if fault:
            return fault
    return ""


def _told(place: str, wrong: str) -> str:
    """A fault with the place where it is: `scores/heldout must be …`."""
    return f"{place} {wrong}".lstrip("/ ")


def _shown(value: Any) -> str:
    """A value for a message; of an object or a list its size alone."""
    if isinstance(value, dict):
        return f"an object of {len(value)}"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    return shown(value)
