"""Applies the descriptions of fields to a record: finds faults, makes shorter forms, checks needed fields.

The classes in `schema` describe fields by type hints. pydantic checks a record by them. A hint such as
`Annotated[Number, RESULTS]` has *marks*: besides the limits of its values, what the field is used for (`Use`, `Needed`,
`Shown`).
"""

import re
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    NotRequired,
    Required,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from typing_extensions import is_typeddict

from bench.inputs.errors import InputError, shown
from bench.records.schema import Job, Needed, RunStart, Shown, Stress, Timing, Use

if TYPE_CHECKING:
    from pydantic import TypeAdapter, ValidationError

Kept = TypeVar("Kept", Job, RunStart, Timing, Stress)

_RESULT_FIELDS = ("scores", "metrics", "bytes", "parameters")  # the fields of a job that has a result
# The fields of a time; of one that was measured in turns with the floor, for a trade; and of a choice with its quality.
_TIME = ("ns_per_sample", "interval95_ns")
_OF_TRADE = (*_TIME, "ratio_to_floor", "ratio_interval95", "batch", "threads")
_SCORED = ("codec", "settings", "score_key", "bytes", "psnr", "worst", "flip")


def fault_of_record(record: Mapping[str, Any]) -> str:
    """The first wrong field of a record, and what it must be; "" if all are right.

    A job with a result needs its numbers, and one that failed its error; a timing its time, unless it is of a trade.
    """
    described = FIELDS[record["kind"]]
    needed = field_names(Use.MUST, described)
    if described is Job:
        needed += _RESULT_FIELDS if record.get("status") == "ok" else ("error",)
    if described is Timing:
        needed += _needed_of_timing(record)
    for name in needed:
        if name not in record:
            return f"{name} is missing"
    return fault_of(described, record)


def _needed_of_timing(record: Mapping[str, Any]) -> tuple[str, ...]:
    """The fields that a timing needs: a choice of a trade may have an error, or be scored and not yet timed."""
    if "material" not in record:
        return _TIME
    needed: tuple[str, ...] = ("label", "execution", "dtype", "device")
    if "of" not in record:  # the floor
        return (*needed, *_OF_TRADE, "ceilings")
    if "psnr" in record or "error" not in record:
        needed += _SCORED
    if "ns_per_sample" in record:
        needed += (*_OF_TRADE, "limit_ns")
    return needed


def fault_of(described: type, value: Any) -> str:
    """The first fault of an object that a class describes, such as the facts of a fit, in words; "" if it has none."""
    from pydantic import ValidationError  # only where something is read: it takes a tenth of a second

    try:
        _adapter(described).validate_python(value)
    except ValidationError as error:
        return _error_in_words(value, error)
    return ""


@cache
def _adapter(described: Any) -> "TypeAdapter[Any]":
    """What checks an object that a class describes. A text is no number; fields that no class lists may be there."""
    from pydantic import ConfigDict, TypeAdapter, with_config

    return TypeAdapter(with_config(ConfigDict(strict=True, extra="allow", allow_inf_nan=False))(described))


def _error_in_words(value: Any, error: "ValidationError") -> str:
    """What is wrong at the first wrong place of a value, in words: `scores/heldout must be …, not 3`."""
    errors = error.errors(include_url=False, include_context=False)
    paths = [_path_and_value(value, each["loc"])[0] for each in errors]
    # Of a field of several types there is an error for each type: that of the type which fits best lies the deepest.
    place = max((path for path in paths if f"{path}/".startswith(f"{paths[0]}/")), key=len)
    at_place = [each for each, path in zip(errors, paths, strict=True) if path == place]
    _, wrong = _path_and_value(value, at_place[0]["loc"])
    if at_place[0]["type"] == "missing":
        return f"{place}/{at_place[0]['loc'][-1]} is missing".lstrip("/")
    # pydantic's "Input should be a valid string" becomes "must be a valid string".
    joined = " or ".join(dict.fromkeys(each["msg"] for each in at_place)).removeprefix("Value error, ")
    rule = re.sub("^(Input|List|String) should", "must", joined.replace(" or Input should be", " or"))
    rule = re.sub(r" after validation, not \d+$", "", rule)
    instead = f"an object of {len(wrong)} fields" if isinstance(wrong, dict) else shown(wrong)
    return f"{place} {rule}, not {instead}".lstrip()


def _path_and_value(value: Any, parts: tuple[int | str, ...]) -> tuple[str, Any]:
    """The path of a place that pydantic names, such as `scores/heldout`, and what stands there.

    Parts that are not in the value are left out: a missing field, or one of the types that a field may have.
    """
    path = []
    there = value  # at the path so far
    for part in parts:
        if (isinstance(there, dict) and part in there) or (isinstance(there, list) and isinstance(part, int)):
            there = there[part]  # type: ignore[index]
            path.append(f"{part:.60}" if isinstance(part, str) else str(part))
    return "/".join(path), there


def kept(record: Kept, use: Use) -> Kept:
    """The shorter form of a record: its fields and nested fields of that use, in the order of their descriptions."""
    whole = cast(Mapping[str, Any], record)
    return cast(Kept, _shortened(FIELDS[whole["kind"]], whole, use))


def _shortened(hint: Any, value: Any, use: Use) -> Any:
    """A value of the type `hint` without what the use does not keep; an object without a field of it stays whole."""
    if not isinstance(value, dict):
        return value
    if get_origin(hint) in (Annotated, Required, NotRequired):
        return _shortened(get_args(hint)[0], value, use)
    if get_origin(hint) is dict:
        return {name: _shortened(get_args(hint)[1], item, use) for name, item in value.items()}
    names = field_names(use, hint) if is_typeddict(hint) else ()
    if not names:
        return value
    return {name: _shortened(_hints(hint)[name], value[name], use) for name in names if name in value}


@cache
def _hints(described: Any) -> dict[str, Any]:
    """The types of the fields of a class, with their marks."""
    return get_type_hints(described, include_extras=True)


@cache
def field_names(use: Use, described: Any = Job) -> tuple[str, ...]:
    """The names of the fields of a use, by default those of a job."""
    names = [name for name, mark in _marks(described) if isinstance(mark, Use) and use & mark]
    return tuple(dict.fromkeys(names))  # each once, though a field may have two marks


@cache
def shown_columns() -> dict[str, Shown]:
    """The columns of the fields of a job, by the path of the field."""
    return {path: mark for path, mark in _marks(Job) if isinstance(mark, Shown)}


def require(job: Job, by: Literal["comparison", "tables", "verification"], folder: Path) -> None:
    """Check that a job has the fields needed for a use. `InputError` names a missing field, and the run's `folder`."""
    for path in _needed_paths(by):
        value: Any = job
        for part in path.split("/"):
            if not isinstance(value, dict) or part not in value:
                raise InputError(f"{folder}: {job['job']} has no {path!r}: another version wrote it: run it again")
            value = value[part]


@cache
def _needed_paths(by: str) -> list[str]:
    """The paths of the fields that a use of jobs needs: of a field, and of keys in it, as `fit_key/settings`."""
    paths = []
    for name, mark in _marks(Job):
        if isinstance(mark, Needed) and mark.by == by:
            paths += [name, *(f"{name}/{key}" for key in mark.keys)]
    return paths


def _marks(described: Any) -> Iterator[tuple[str, Any]]:
    """The name of each field of a class with each mark that describes it; a field with two marks comes twice."""
    for name, hint in _hints(described).items():
        while get_origin(hint) in (Required, NotRequired):
            hint = get_args(hint)[0]
        for mark in getattr(hint, "__metadata__", ()):
            yield name, mark


FIELDS: dict[str, Any] = {"run": RunStart, "job": Job, "timing": Timing, "stress": Stress}
