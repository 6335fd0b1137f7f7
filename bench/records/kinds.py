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


def _is_count(value: Any) -> bool:
    """Whether a value is a whole number from 0 to `WHOLE`; true and false are none."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= WHOLE


def _is_text(value: Any) -> bool:
    """Whether a value is a text of at most `LONGEST` characters."""
    return isinstance(value, str) and len(value) <= LONGEST


NUMBER = Plain("a finite number", _is_number)
POSITIVE = Plain("a finite number > 0", lambda value: _is_number(value) and value > 0)
NOT_NEGATIVE = Plain("a finite number ≥ 0", lambda value: _is_number(value) and value >= 0)
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
    known: Mapping[str, Kind] = kind.known if isinstance(kind, Fields) else {}
    others = kind.item if isinstance(kind, Each | Several) else ANYTHING
    wrong = ""
    if isinstance(kind, Plain) and kind is not ANYTHING:
        wrong = "" if kind.test(value) else f"must be {kind.words}, not {_shown(value)}"
    elif depth > DEEPEST:
        wrong = "is nested too deeply"
    elif isinstance(kind, Several) and (not isinstance(value, list) or kind.length not in (None, len(value))):
        length = f" of {kind.length}" if kind.length else ""
        wrong = f"must be a list{length}, not {_shown(value)}"
    elif isinstance(kind, Each | Fields) and not isinstance(value, dict):
        wrong = f"must be an object, not {_shown(value)}"
    elif isinstance(value, dict):
        absent = missing(value, kind.needed, place) if isinstance(kind, Fields) else ""
        if absent:
            return absent
        for name, item in value.items():
            each = known.get(name, others)
            # The common case is tested here, without a call: it occurs thousands of times a run.
            if each.__class__ is Plain and each is not ANYTHING and each.test(item):
                continue
            fault = fault_of(each, item, f"{place}/{name:.60}", depth + 1)
            if fault:
                return fault
    elif isinstance(value, list):
        for item in value:
            fault = fault_of(others, item, place, depth + 1)
            if fault:
                return fault
    elif value is not None:
        return fault_of(SETTING, value, place, depth)
    return f"{place} {wrong}".lstrip("/ ") if wrong else ""


def _shown(value: Any) -> str:
    """A value for a message; of an object or a list its size alone."""
    if isinstance(value, dict):
        return f"an object of {len(value)}"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    return shown(value)
