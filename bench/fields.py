"""What each field of a record and of a trade holds, and the first field that holds something else.

Records are lines of text, which people edit and write by hand. A reader of records relies on nothing that is not
checked here. Fields that are not listed are free, but plain: finite numbers of a size that tables can show, and not
nested deeply.
"""

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Any

LARGEST = 1e18  # a number beyond is no measurement
WHOLE = (1 << 63) - 1  # seeds reach as far
DEEPEST = 12
LONGEST = 1 << 20  # characters of a text; a traceback is far shorter
STATES = ("ok", "failed", "unavailable")
VERDICTS = ("pass", "fail", "n/a")


@dataclass(frozen=True)
class Plain:
    """A value without parts."""

    words: str
    test: Callable[[Any], bool]


@dataclass(frozen=True)
class Each:
    """An object of any names whose values are all of one kind."""

    of: "Kind"


@dataclass(frozen=True)
class Several:
    """A list of values of one kind, of a length where that is given."""

    of: "Kind"
    length: int | None = None


@dataclass(frozen=True)
class Fields:
    """An object: its known fields, and which of them must be there."""

    known: "Mapping[str, Kind]"
    needed: tuple[str, ...] = ()


Kind = Plain | Each | Several | Fields


def _is_number(value: Any) -> bool:
    if value.__class__ is float:
        return -LARGEST <= value <= LARGEST
    return isinstance(value, int | float) and not isinstance(value, bool) and -LARGEST <= value <= LARGEST


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= WHOLE


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= LONGEST


def _is_text_or_texts(value: Any) -> bool:
    return all(map(_is_text, value.values())) if isinstance(value, dict) else _is_text(value)


def _one_of(*words: str) -> Plain:
    return Plain(" or ".join(map(repr, words)), lambda value: isinstance(value, str) and value in words)


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
FLAG = Plain("true or false", lambda value: isinstance(value, bool))
SETTING = Plain(
    "a finite number, a text, true or false",
    lambda value: isinstance(value, bool) or _is_text(value) or _is_number(value) or _is_count(value),
)
ANYTHING = Plain("", lambda value: True)
PAIR = Several(NUMBER, 2)

_NUMBER_OR_NULL = maybe(NUMBER)
_STATISTICS = Each(_NUMBER_OR_NULL)
_METRIC = Fields(
    {"unit": TEXT, "direction": _one_of("higher", "lower"), "space": TEXT, "version": COUNT},
    ("unit", "direction", "version"),
)
_GROUP = Fields({"slices": COUNT, "radiance": _NUMBER_OR_NULL, "metrics": Each(_STATISTICS)}, ("metrics",))
_POINT = Fields({"step": COUNT, "seconds": NUMBER, "psnr": NUMBER}, ("step",))
_JOB = Fields(
    {
        **dict.fromkeys(("material", "label", "codec", "curve"), NAME),
        **dict.fromkeys(
            ("job", "run", "error", "traceback", "split", "pictures", "angular", "drawing", "not_drawn", "file"), TEXT
        ),
        "status": _one_of(*STATES),
        "seed": COUNT,
        "scores": Each(_GROUP),
        "slices": Plain("a text, or texts by metric", _is_text_or_texts),
        "metrics": Each(_METRIC),
        "bytes": Fields(
            dict.fromkeys(("decoder", "texture", "encoder", "sampling", "other", "header", "total"), COUNT), ("total",)
        ),
        "parameters": maybe(COUNT),
        "cost": Each(COUNT),
        "footprints": Each(_STATISTICS),
        "fit_key": Fields({"codec": NAME, "version": COUNT, "settings": Each(SETTING), "libraries": Each(maybe(TEXT))}),
        "score_key": Fields(
            {
                "sha256": TEXT,
                "btf": TEXT,
                "exposure": NUMBER,
                "metrics": Each(COUNT),
                "demand": maybe(TEXT),
                "deciding": maybe(TEXT),
            }
        ),
        "settings": Each(SETTING),
        "shape": Several(COUNT, 2),
        "pairs": Each(COUNT),
        "history": Several(_POINT),
        "fit_seconds": NOT_NEGATIVE,
        "fit_cached": FLAG,
        "machine": Each(maybe(SETTING)),
        "provenance": Each(ANYTHING),
        "fitted": Each(maybe(TEXT)),
        "scored": Each(maybe(TEXT)),
        "program": Fields({"queries": COUNT, "ns_per_query": NOT_NEGATIVE}, ("queries", "ns_per_query")),
        "scene": Fields(
            {"name": TEXT, "queries": COUNT, "frames": Several(COUNT, 3), "metrics": _STATISTICS},
            ("name", "queries", "frames", "metrics"),
        ),
    },
    ("material", "label", "seed", "status"),
)
_MEASURED = ("scores", "metrics", "bytes", "parameters")
_TIMING = Fields(
    {
        **dict.fromkeys(("job", "run", "dtype", "device", "execution", "queries", "unrest"), TEXT),
        **dict.fromkeys(("ns_per_sample", "ratio_to_floor"), POSITIVE),
        **dict.fromkeys(("interval95_ns", "ratio_interval95"), PAIR),
        **dict.fromkeys(("batch", "threads"), COUNT),
        "texture_fetch": FLAG,
        "iqr_ns": NUMBER,
    },
    ("ns_per_sample", "interval95_ns", "run"),
)
_STRESS = Fields(
    {
        **dict.fromkeys(("subject", "extreme", "group"), NAME),
        **dict.fromkeys(("detail", "figure", "holds"), TEXT),
        "verdict": _one_of(*VERDICTS),
        "order": COUNT,
        "used": maybe(NUMBER),
        "version": maybe(COUNT),
    },
    ("subject", "extreme", "group", "verdict", "detail", "figure", "order"),
)
_RUN = Fields(
    {
        **dict.fromkeys(("run", "suite", "text", "device", "python"), TEXT),
        "git": maybe(TEXT),
        "jobs": Several(TEXT),
        "seeds": Several(COUNT),
        "packages": Each(maybe(TEXT)),
        "machine": Each(maybe(SETTING)),
        "threads": COUNT,
    }
)
_COSINE_AND_LOBES = Several(NOT_NEGATIVE, 2)
_NOISE = Fields(
    {"scene": TEXT, "samples": _COSINE_AND_LOBES, "seconds": _COSINE_AND_LOBES}, ("scene", "samples", "seconds")
)
_CHOICE = Fields(
    {
        **dict.fromkeys(("material", "label"), NAME),
        **dict.fromkeys(("job", "codec", "execution", "precision", "device", "error", "unrest", "sha256"), TEXT),
        "noise": _NOISE,
        "noise_error": TEXT,
        "settings": Each(SETTING),
        **dict.fromkeys(("psnr", "worst", "flip"), maybe(NUMBER)),
        **dict.fromkeys(("bytes", "parameters", "batch", "threads"), COUNT),
        **dict.fromkeys(("ns_per_sample", "ratio_to_floor"), POSITIVE),
        "ratio_interval95": PAIR,
        "of_limit": NUMBER,
        **dict.fromkeys(("fastest", "smallest", "emulated"), FLAG),
    },
    ("material", "label", "execution", "precision", "device"),
)
_TIMED = ("ns_per_sample", "ratio_to_floor", "ratio_interval95", "batch", "threads")
_CHOSEN = ("codec", "settings", "psnr", "worst", "flip", "of_limit", "fastest", "smallest")
_PROFILE = Fields(
    {
        **dict.fromkeys(("material", "name"), NAME),
        **dict.fromkeys(("part", "unrest"), TEXT),
        **dict.fromkeys(("batch", "threads"), COUNT),
        "coherent": FLAG,
        "footprint": NOT_NEGATIVE,
        "ns_per_sample": POSITIVE,
    },
    ("material", "name", "part", "batch", "coherent", "footprint", "threads", "ns_per_sample"),
)
_CEILING = Fields(
    {
        **dict.fromkeys(("device", "dtype"), TEXT),
        "threads": COUNT,
        **dict.fromkeys(("flops_per_ns", "bytes_per_ns"), POSITIVE),
    },
    ("device", "dtype", "threads", "flops_per_ns", "bytes_per_ns"),
)
_TRADE = Fields(
    {
        "choices": Several(_CHOICE),
        "profiles": Several(_PROFILE),
        "ceilings": Several(_CEILING),
        "answers": Several(TEXT),
        "left_out": Several(TEXT),
    },
    ("choices", "profiles", "ceilings", "answers"),
)
_FACTS = Fields(
    {name: _JOB.known[name] for name in ("history", "fit_seconds", "fitted")} | {"sha256": TEXT},
    ("fit_key", "sha256", "fit_seconds", "history"),
)
_DIGITS = Plain("64 hexadecimal digits", lambda value: _is_text(value) and bool(re.fullmatch("[0-9a-f]{64}", value)))
_SIDE = Plain("a whole number > 0", lambda value: _is_count(value) and value > 0)
_SCENE = Fields(
    {
        **dict.fromkeys(("name", "demand"), TEXT),
        "size": Several(_SIDE, 2),
        "window": Several(COUNT, 4),
        "factor": _SIDE,
        "pairs": COUNT,
        **dict.fromkeys(("finest", "uniform"), NOT_NEGATIVE),
        **dict.fromkeys(("views", "lights"), _DIGITS),
    },
    ("name", "demand", "size", "window", "factor", "pairs", "finest", "uniform", "views", "lights"),
)
_FORMER = Fields({})  # rates of older runs, which nothing reads: they are compared when a table is made
RECORDS = {"run": _RUN, "job": _JOB, "timing": _TIMING, "stress": _STRESS, "rate": _FORMER}


def fault(record: Mapping[str, Any]) -> str:
    """The first field of a record that is not what it must be, and what it must be; "" where all are."""
    needed: tuple[str, ...] = ()
    if record["kind"] == "job" and "status" in record:
        needed = _MEASURED if record["status"] == "ok" else ("error",)
    return told(_missing(record, needed) or _fault(RECORDS[record["kind"]], record, 0))


def fault_of_trade(found: Mapping[str, Any]) -> str:
    """The same of the measurements of `neubtf-bench trade`."""
    if wrong := _fault(_TRADE, found, 0):
        return told(wrong)
    for row in found["choices"]:
        needed = () if "error" in row else (*_TIMED, *(_CHOSEN if "bytes" in row else ()))
        if wrong := _missing(row, needed):
            return told((f"choices/{row['label']:.60}/{wrong[0]}", wrong[1]))
    return ""


def fault_of_facts(found: Any) -> str:
    """The same of the facts of a fit, which lie beside a codec file."""
    return told(_fault(_FACTS, found, 0))


def fault_of_scene(found: Any) -> str:
    """The same of the scene that a codec file was fitted to; see `bench.demand.need`."""
    return told(_fault(_SCENE, found, 0))


Fault = tuple[str, str]  # the place of a field, `scores/heldout`, and what it must be


def told(found: Fault | None) -> str:
    """A fault in words; "" for none."""
    return f"{found[0].lstrip('/')} {found[1]}" if found else ""


def _missing(value: Mapping[str, Any], needed: tuple[str, ...]) -> Fault | None:
    return next(((name, "is missing") for name in needed if name not in value), None)


def _fault(kind: Kind, value: Any, depth: int) -> Fault | None:
    """The first fault of a value, at a place within it."""
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
        each = kind.of if isinstance(kind, Several) else ANYTHING
        if _plainly(NUMBER if each is ANYTHING else each, value):
            return None
        return next((found for item in value if (found := _fault(each, item, depth + 1))), None)
    return None if value is None else _fault(SETTING, value, depth)


def _fault_of_object(kind: Kind, value: Mapping[str, Any], depth: int) -> Fault | None:
    if isinstance(kind, Each) and _plainly(kind.of, value.values()):
        return None  # the common case, thousands of times a run
    known: Mapping[str, Kind] = {}
    others: Kind = kind.of if isinstance(kind, Each) else ANYTHING
    if isinstance(kind, Fields):
        known = kind.known
        if absent := _missing(value, kind.needed):
            return absent
    for name, item in value.items():
        each = known.get(name, others)
        if each.__class__ is Plain and each is not ANYTHING and each.test(item):
            continue
        if found := _fault(each, item, depth + 1):
            return f"{name:.60}/{found[0]}".rstrip("/"), found[1]
    return None


def _plainly(kind: Kind, values: Collection[Any]) -> bool:
    """Whether some values are all of a kind, where that can be seen at once; False says nothing."""
    if isinstance(kind, Each):
        objects = {*map(type, values)} == {dict}
        return objects and _plainly(kind.of, [*chain.from_iterable(map(dict.values, values))])
    if kind is NUMBER or kind is _NUMBER_OR_NULL:
        known = {float, int} if kind is NUMBER else {float, int, type(None)}
        return {*map(type, values)} <= known and all(map(LARGEST.__ge__, map(abs, filter(None, values))))
    return isinstance(kind, Plain) and kind is not ANYTHING and all(map(kind.test, values))


def _shown(value: Any) -> str:
    if isinstance(value, dict | list):
        return f"{'an object' if isinstance(value, dict) else 'a list'} of {len(value)}"
    text = repr(value) if not isinstance(value, int) or abs(value) <= WHOLE else "a number of absurd size"
    return text if len(text) <= 60 else f"{text[:60]} …"
