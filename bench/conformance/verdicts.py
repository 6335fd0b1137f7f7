"""The conformance test that anyone can run against their own codec: `neubtf-bench check NAME`.

A check is one promise of the codec interface, an extreme a case of `bench.conformance.stress`. The record of the stress
test, which is committed, says which built-in codecs pass each extreme.
"""

import dataclasses
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

from bench.codec import Codec, Progress, followed, settings_dict, silent
from bench.codecs.encoding import error_in_words
from bench.codecs.registry import load_codec, make_codec
from bench.conformance import emulated, stress
from bench.conformance.check import STAGES, Check, CodecUnderTest, NotApplicable, more_steps
from bench.conformance.stress.case import Measured, short, verdict_of
from bench.material import parameters
from bench.records import Cost, Job, Stress, load_run


@dataclass(frozen=True)
class Result:
    """One check: its name, the failure ("" if it passed), the reason if it does not apply, and a note."""

    name: str
    failure: str = ""
    reason: str = ""
    note: str = ""


def check(codec: str | Codec, show: Progress = silent, **settings: Any) -> Iterator[Result]:
    """Run the checks on a codec and yield each result; any exception of the codec is a failed check.

    `codec` is a name, with its `settings` and otherwise short fits, or a codec as it is, which takes no settings.
    `InputError` if there is no such codec, or it has no such settings.

    The codec encodes and answers; its answers repeat; they follow the material: if one of these stages fails, later
    ones are not tried, because they would fail for the same reason. The promises to a renderer and the quick extremes
    of `bench.conformance.stress` do not depend on each other: all of them are tried.
    """
    if isinstance(codec, str):
        codec = codec_to_check(codec, settings)
    with suppress(emulated.NoEmulationError):
        emulated.register()
    with tempfile.TemporaryDirectory() as folder:
        tested = CodecUnderTest(codec, Path(folder), show=show)
        stages = [*(partial(_stage, tested, stage) for stage in STAGES), partial(_extremes, tested)]
        for number, stage in enumerate(stages):
            show("stages of the check", number, len(stages))
            failed = False
            for result in stage():
                failed |= bool(result.failure)
                yield result
            if failed and number < len(STAGES) - 1:
                break
        show("stages of the check", len(stages), len(stages))


def planned() -> int:
    """The number of results if all stages are tried."""
    return sum(map(len, STAGES)) + sum(case.cheap for case in stress.CASES)


def codec_to_check(name: str, settings: dict[str, Any]) -> Codec:
    """The codec of that name for the check: with these settings, and otherwise with short fits."""
    kind = type(make_codec(name, settings))  # `InputError` in words if it cannot be made
    return kind(**short(kind) | settings)


def _stage(tested: CodecUnderTest, checks: tuple[Check, ...]) -> Iterator[Result]:
    """Run the checks of one stage and yield each result, whose name is the docstring of the check."""

    def with_note(promise: Check) -> Measured:
        """Run a check; the detail is its note."""
        return Measured(detail=promise(tested) or "")

    field_of_detail = {"fail": "failure", "n/a": "reason", "pass": "note"}  # by verdict
    for promise in checks:
        verdict = verdict_of(partial(with_note, promise), NotApplicable, partial(error_in_words, codec=tested.codec))
        yield Result(promise.__doc__ or promise.__name__, **{field_of_detail[verdict.verdict]: verdict.detail})


def _extremes(tested: CodecUnderTest) -> Iterator[Result]:
    """Try the cheap extremes of the stress test and yield each result; one detail is given in full only once."""
    subject = stress.Subject(tested)
    cases = [case for case in stress.CASES if case.cheap]
    first_with: dict[str, str] = {}  # by detail, the first extreme that gave it
    hint = more_steps(tested.codec)  # said once, of the first quality that is missed
    for case in followed(tested.show, cases, "extremes", len(cases)):
        verdict = stress.judge(case, subject)
        first = first_with.setdefault(verdict.detail, case.name)
        promise = f"{case.name}: {case.holds}"
        if verdict.verdict != "fail":
            yield Result(promise, reason=verdict.detail if verdict.verdict == "n/a" else "")
            continue
        failure = verdict.detail if first == case.name else f"the same as for {first!r}"
        failure += met_by_others(case.name)
        if case.group == "data":  # only these are of quality
            failure += hint
            hint = ""
        yield Result(promise, failure)


def stress_reference() -> Path:
    """The committed record of the stress test: the results of the built-in codecs for each extreme."""
    return Path(str(files("bench") / "compare" / "references" / "stress.jsonl"))


@cache
def _stress_records() -> tuple[Stress, ...]:
    """The lines of the committed record of the stress test; () where the package comes without it."""
    path = stress_reference()
    if not path.is_file():
        return ()
    return tuple(load_run(path).stress)


def met_by_others(extreme: str) -> str:
    """Say how many built-in codecs pass an extreme, at the end of a message about a codec that fails it."""
    of_extreme = [record["verdict"] for record in _stress_records() if record["extreme"] == extreme]
    tried = [verdict for verdict in of_extreme if verdict != "n/a"]
    passed = tried.count("pass")
    if not passed:
        return ""
    count = f"all {passed}" if passed == len(tried) else f"{passed} of {len(tried)}"
    return f"; {count} built-in codecs to which it applies pass"


def job_of_counts(name: str) -> Job:
    """A record of a codec whose decoder is counted in a file of the small material: `settings`, `parameters`, `cost`.

    It also has what names it, and no scores. A codec with the recipe `paper` is counted as published.
    """
    codec_class = load_codec(name)
    names = {field.name for field in dataclasses.fields(codec_class.Settings)}
    # A fit that is only counted: one step of a small batch, and a texture of halves, for which no bits are chosen.
    smallest = {"steps": 1, "batch": 64, "bits": 16}
    settings: dict[str, Any] = {key: value for key, value in smallest.items() if key in names}
    if "paper" in codec_class.recipes:
        settings["recipe"] = "paper"
    codec = codec_class(**settings)
    with tempfile.TemporaryDirectory() as folder:
        material = CodecUnderTest(codec, Path(folder)).material
    label = f"{name} recipe=paper" if "recipe" in settings else name
    return {
        "codec": name,
        "job": label,
        "label": label,
        "status": "ok",
        "settings": settings_dict(codec),
        "parameters": parameters(material),
        "cost": cast(Cost, dataclasses.asdict(material.cost)),
    }
