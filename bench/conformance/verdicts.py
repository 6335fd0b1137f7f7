"""The conformance test that anyone can run against their own codec: `neubtf-bench check NAME`."""

import dataclasses
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from bench.codec import Codec, SharedNetwork
from bench.codecs.registry import load_codec
from bench.conformance import stability
from bench.conformance.check import CHECKS, Bench
from bench.material import parameters
from bench.records import Record


@dataclass(frozen=True)
class Result:
    """One check: its name, what was wrong, empty where it passed, and the reason where it does not apply."""

    name: str
    failure: str = ""
    reason: str = ""


def check(codec: Codec, network: SharedNetwork | None = None) -> Iterator[Result]:
    """Run every check against a codec, yielding each result; what a codec itself raises is a failed check.

    The last of them are the quick extremes of `bench.conformance.stability`. A codec that shares a network over
    materials is tried with a small one of its own, or that of `network`.
    """
    if network is None and codec.network is not None:
        network = codec.network().brief()
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(codec, Path(folder), network)
        for one in CHECKS:
            try:
                one(bench)
                yield Result(one.__doc__ or one.__name__)
            except Exception as error:  # whatever a foreign codec raises is its failure, and the next check still runs
                yield Result(one.__doc__ or one.__name__, f"{type(error).__name__}: {error}".splitlines()[0])
        yield from _extremes(bench)


def _extremes(bench: Bench) -> Iterator[Result]:
    subject = stability.Subject(bench)
    for case in stability.CASES:
        if case.cheap:
            found = stability.judge(case, subject)
            failure = found.detail if found.verdict == "fail" else ""
            yield Result(f"{case.name}: {case.holds}", failure, found.detail if found.verdict == "n/a" else "")


def count(name: str) -> Record:
    """What a codec's decoder holds, counted in a file of the small material: `label`, `parameters`, `cost` of a record.

    A codec that is fitted in `steps` takes one, which changes no count.
    """
    found = load_codec(name)
    fitted = "steps" in {field.name for field in dataclasses.fields(found.Settings)}
    codec = found(steps=1) if fitted else found()
    with tempfile.TemporaryDirectory() as folder:
        material = Bench(codec, Path(folder), codec.network().brief() if codec.network else None).material
    return {
        "codec": name,
        "label": name,
        "status": "ok",
        "parameters": parameters(material),
        "cost": dataclasses.asdict(material.cost),
    }
