"""Applies the descriptions of fields to a record: finds faults, makes shorter forms, checks needed fields.

The classes in `schema` describe fields by type hints. A hint such as `Annotated[float, NUMBER, RESULTS]` has *marks*:
the `Kind` of its values, and what the field is used for (`Use`, `Needed`, `Shown`).
"""

from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import (
    Any,
    Literal,
    NotRequired,
    Required,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

from bench.inputs.errors import InputError
from bench.records import kinds
from bench.records.kinds import Each, Fields, Kind, Plain, Several
from bench.records.schema import Job, Needed, RunStart, Shown, Stress, Timing, Trade, Use

Kept = TypeVar("Kept", Job, RunStart, Timing, Stress)

_RESULT_FIELDS = ("scores", "metrics", "bytes", "parameters")  # the fields of a job that has a result
# The fields of a choice of a trade: of every one that was timed, and of those that have a file, too.
_TIMED = ("ns_per_sample", "ratio_to_floor", "ratio_interval95", "batch", "threads")
_SCORED = ("bytes", "psnr", "worst", "flip")
_WITH_FILE = ("codec", "settings", "psnr", "worst", "flip", "of_limit", "fastest", "smallest")


@cache
def field_kind(hint: Any) -> Kind:
    """The kind of values that a type describes.

    A type that is marked with a kind is of that kind. Other marks, and `Required` or `NotRequired`, stand around the
    type that counts.
    """
    marks = getattr(hint, "__metadata__", ())
    for mark in marks:
        if isinstance(mark, Kind):
            return mark
    if marks or get_origin(hint) in (Required, NotRequired):
        return field_kind(get_args(hint)[0])
    if is_typeddict(hint):
        kind_of_field = {name: field_kind(each) for name, each in get_type_hints(hint, include_extras=True).items()}
        must = {*hint.__required_keys__, *field_names(Use.MUST, hint)}
        # In the order of their descriptions, because faults are told in this order.
        needed = tuple(name for name in kind_of_field if name in must)
        return Fields(kind_of_field, needed, hint)
    # A type without marks: `Literal["a", "b"]`, `dict[str, X]`, `list[X]`, `X | None`, or a plain one.
    generic = get_origin(hint)
    arguments = get_args(hint)
    if generic is Literal:
        return Plain(" or ".join(map(repr, arguments)), lambda value: isinstance(value, str) and value in arguments)
    if generic is dict:
        return Each(field_kind(arguments[1]))  # of the values; names are texts
    if generic is list:
        return Several(field_kind(arguments[0]))
    if type(None) in arguments:  # `X | None`
        plain: Any = field_kind(arguments[0])
        if plain is kinds.NUMBER:  # by far the most: a run has hundreds of thousands
            return kinds.NUMBER_OR_NULL
        return Plain(f"{plain.words} or null", lambda value: value is None or plain.test(value))
    kind_of_plain_type: dict[Any, Kind] = {bool: kinds.FLAG, Any: kinds.ANYTHING}
    return kind_of_plain_type[hint]


def fault(record: Mapping[str, Any]) -> str:
    """The first wrong field of a record, and what it must be; "" if all are right.

    A job with a result needs its numbers, and one that failed its error.
    """
    needed: tuple[str, ...] = ()
    if record["kind"] == "job" and "status" in record:
        needed = _RESULT_FIELDS if record["status"] == "ok" else ("error",)
    return kinds.missing(record, needed) or kinds.fault_of(FIELDS[record["kind"]], record)


def fault_of_trade(trade: Mapping[str, Any]) -> str:
    """The first wrong or missing field of the measurements of `neubtf-bench trade`, in words; "" if all are right."""
    wrong = fault_of(Trade, trade)
    if wrong:
        return wrong
    for row in trade["choices"]:
        needed: tuple[str, ...] = _TIMED
        if "error" in row:
            needed = _SCORED if "psnr" in row else ()  # some are scored, but their time cannot be measured
        elif "bytes" in row:  # the floor, a bare network, has no file and so no bytes
            needed = (*_TIMED, *_WITH_FILE)
        wrong = kinds.missing(row, needed, f"choices/{row['label']:.60}")
        if wrong:
            return wrong
    return ""


def fault_of(described: type, value: Any) -> str:
    """The first fault of an object that a class describes, such as the facts of a fit, in words; "" if it has none."""
    return kinds.fault_of(field_kind(described), value)


def kept(record: Kept, use: Use) -> Kept:
    """The shorter form of a record: its fields and nested fields of that use, in the order of their descriptions."""
    whole = cast(Mapping[str, Any], record)
    return cast(Kept, _shortened(FIELDS[whole["kind"]], whole, use))


def _shortened(kind: Kind, value: Any, use: Use) -> Any:
    """A value without what the use does not keep; an object none of whose fields says a use stays whole."""
    if isinstance(kind, Each) and isinstance(value, dict):
        return {name: _shortened(kind.item, item, use) for name, item in value.items()}
    if not isinstance(kind, Fields) or not isinstance(value, dict):
        return value
    names = field_names(use, kind.described)
    if not names:
        return value
    return {name: _shortened(kind.known[name], value[name], use) for name in names if name in value}


@cache
def field_names(use: Use, described: Any = Job) -> tuple[str, ...]:
    """The names of the fields of a use, by default those of a job."""
    names: dict[str, None] = {}
    for name, mark in _marks(described):
        if isinstance(mark, Use) and use & mark:
            names[name] = None
    return tuple(names)


@cache
def shown_columns() -> dict[str, Shown]:
    """The columns of the fields of a job, by the path of the field."""
    return {path: mark for path, mark in _marks(Job) if isinstance(mark, Shown)}


def require(job: Job, by: Literal["comparison", "tables", "verification"], folder: Path) -> None:
    """Check that a job has the fields needed for a use. `InputError` names a missing field."""
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
    for name, hint in get_type_hints(described, include_extras=True).items():
        while get_origin(hint) in (Required, NotRequired):
            hint = get_args(hint)[0]
        for mark in getattr(hint, "__metadata__", ()):
            yield name, mark


FIELDS = {
    name: field_kind(each) for name, each in {"run": RunStart, "job": Job, "timing": Timing, "stress": Stress}.items()
}
