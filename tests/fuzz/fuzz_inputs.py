"""Fuzzes what is typed or kept beside results: suites, scenes, demands, records, trades and the facts of fits.

    python tests/fuzz/fuzz_inputs.py [--count 2000] [--seed 0] [--only TARGET ...] [--again N]

Values are replaced by hostile ones, keys are dropped and renamed, texts are damaged; checksums are computed again, and
half of the records have none, as those that are written by hand. See `fuzzing.py` for limits and exit code.
"""

import contextlib
import copy
import io
import json
import random
import shutil
import sys
import tomllib
import warnings
import zlib
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from fuzzing import Reading, Target, damaged, main, repacked, with_other_header

from bench.demand import demand as demands
from bench.demand.collect import collect
from bench.demand.overview import summarise
from bench.demand.scene import named_scene, read_scene
from bench.demand.text_scene import TextScene
from bench.inputs.errors import InputError
from bench.runs.suite import builtin_suites, canonical, load_suite, parse_suite

NUMBERS = (-1, 0, 1, 2, 255, 100_000, 10**8, 10**9, 2**62, -(2**63), 10**30, 1.5, -0.5, 1e-300, 1e308, -1e308)
PLAIN = (*NUMBERS, True, False, "", "x", "8", "nan", "é" * 99, "x" * 70_000, "../..", "\0", float("nan"), float("inf"))
HOSTILE = (*PLAIN, [], {}, [[]], [1, "x"], {"a": {"b": {}}}, list(range(1000)), [[1.0, 2.0]] * 50)


def toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml, value)) + "]"
    text = json.dumps(value)
    return {"NaN": "nan", "Infinity": "inf", "-Infinity": "-inf"}.get(text, text)


def places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Every container in a tree with each of its keys."""
    for key, value in list(tree.items() if isinstance(tree, dict) else enumerate(tree)):
        yield tree, key
        if isinstance(value, dict | list):
            yield from places(value)


def changed(tree: Any, rng: random.Random) -> Any:
    """The tree with one to three values replaced, dropped, renamed, repeated or moved."""
    tree = copy.deepcopy(tree)
    for _ in range(rng.randint(1, 3)):
        found = list(places(tree))
        if not found:
            break
        owner, key = rng.choice(found)
        kind = rng.randrange(8)
        if kind < 5:
            owner[key] = copy.deepcopy(rng.choice(HOSTILE))
        elif kind == 5:
            del owner[key]
        elif kind == 6 and isinstance(owner, dict):
            owner[rng.choice(("x", "job", "kind", key[:-1]))] = owner.pop(key)
        else:
            other, name = rng.choice(found)
            with contextlib.suppress(LookupError, TypeError):
                owner[key] = copy.deepcopy(other[name])
    return tree


def written(path: Path, tree: Any, dumped: Callable[[Any], str], rng: random.Random) -> Path:
    """A file of a mutated tree, or of its damaged text."""
    if rng.random() < 0.75:
        path.write_bytes(dumped(changed(tree, rng)).encode("utf-8", "surrogatepass"))
    else:
        path.write_bytes(damaged(dumped(tree).encode(), rng))
    return path


def document(tree: Any) -> str:
    """A TOML document, one line a key; what is no table is written as a value that no document can be."""
    return "\n".join(f"{json.dumps(k)} = {toml(v)}" for k, v in tree.items()) if isinstance(tree, dict) else toml(tree)


SMALL = """
materials = ["satin"]
data = {size = 8, views = 4, lights = 4, heldout = 6}
[[codecs]]
codec = "mean-colour"
"""
SUITE = """
description = "a test"
variants = ["eager bfloat16"]
threads = 1
seeds = [0, 1]
metrics = ["ssim"]
demand = ""
uniform = 0.1
materials = ["satin", {name = "fabric", path = "ubo/fabric.btf", where = "ask for it"}]
data = {size = 16, directions = "ubo2003", views = 5, lights = 5, heldout = 9, split = "test", pairs = 0, repair = true}
codecs = [
    {codec = "mean-colour", half = true},
    {codec = "pca", components = [2, 4], domain = ["log", "rgb"], passes = 3, materials = ["satin"]},
    {codec = "neubtf-direct", layers = 3, width = 32, latents = 7, batch = 64, steps = 10, rate = 0.01},
    {codec = "vq", codes = 4, stages = 2, components = 3},
]
"""


def make_suites(folder: Path) -> None:
    for name, text in (builtin_suites() | {"all": SUITE}).items():
        (folder / f"{name}.toml").write_text(text)


def attack_suite(sample: Path, scratch: Path, rng: random.Random) -> Reading:
    whole = rng.random() < 0.6
    origin = sample / "all.toml" if whole else rng.choice(sorted(sample.glob("*.toml")))
    path = written(scratch / "bad.toml", tomllib.loads(origin.read_text()), document, rng)
    return partial(read_suite, path, rng.random() < 0.2)


def read_suite(path: Path, codecs: bool) -> None:
    suite = load_suite(str(path))
    assert len(suite.cells) <= 100_000
    if suite.materials and not suite.materials[0].path:
        suite.data.product()
    if codecs:
        canonical(suite)


def make_scenes(folder: Path) -> None:
    from bench.demand.scene import shipped

    for name, text in shipped().items():
        (folder / f"{name}.toml").write_text(text)


def attack_scene(sample: Path, scratch: Path, rng: random.Random) -> Reading:
    tree = tomllib.loads(rng.choice(sorted(sample.glob("*.toml"))).read_text())
    if "path" in tree["camera"]:
        tree["camera"]["path"] = tree["camera"]["path"][:3]
    return partial(read_a_scene, written(scratch / "bad.toml", tree, document, rng))


def read_a_scene(path: Path) -> None:
    demand = collect(TextScene(read_scene(path)), 500)
    for values in (demand.place, demand.footprint, demand.wo, demand.wi, demand.weight):
        assert np.isfinite(values).all()
    summarise(demand)


def make_demand(folder: Path) -> None:
    collect(TextScene(named_scene("wall")), 300).save(folder / "wall.npz")


def attack_demand(sample: Path, scratch: Path, rng: random.Random) -> Reading:
    path = Path(shutil.copy(sample / "wall.npz", scratch / "bad.npz"))
    spoil(path, rng)
    return partial(read_demand, path)


def spoil(path: Path, rng: random.Random) -> None:
    """Damage an archive of arrays, or a file of JSON."""
    if path.suffix == ".json":
        written(path, json.loads(path.read_text()), json.dumps, rng)
    elif rng.random() < 0.1:
        path.write_bytes(damaged(path.read_bytes(), rng))
    else:
        repacked(path, rng, bad_entry)


def bad_entry(name: str, content: bytes, rng: random.Random) -> bytes:
    """An array with another header, other values, or a size that only its compression makes small."""
    kind = rng.randrange(8)
    if kind > 5:
        return damaged(content[:200], rng) + content[200:]
    array = np.lib.format.read_array(io.BytesIO(content))
    if name == "about.npy":
        tree = json.loads(array.tobytes())
        text = json.dumps(changed(tree, rng)).encode("utf-8", "surrogatepass")
        array = np.frombuffer(text if kind < 4 else damaged(json.dumps(tree).encode(), rng), np.uint8)
    elif kind < 3 and array.size and array.ndim:
        array = array.copy()
        values = (0, 1, -1, 32767, -32768, *((np.nan, np.inf, 1e30) if array.dtype.kind == "f" else (99,)))
        array[rng.choice((slice(None), slice(0, 1), slice(-1, None)))] = np.array(rng.choice(values)).astype(
            array.dtype
        )
    elif kind == 3:
        array = rng.choice((array[:0], array[:1], array.reshape(-1), array.reshape(1, -1), array.ravel()[:1]))
    elif kind == 4:
        array = np.zeros((rng.choice((0, 10**5, 10**6)), *array.shape[1:]), array.dtype)
    else:
        return with_other_header(content, rng)
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array)
    return stream.getvalue()


def read_demand(path: Path) -> None:
    demand = demands.load(path)
    pictures = demand.pictures(np.ones((len(demand), 3)))
    assert np.isfinite(pictures).all()
    assert np.isfinite(demand.importance).all()
    summarise(demand)
    demand.name.encode()


@cache
def records_of_a_run() -> list[dict[str, Any]]:
    import tempfile

    from bench.runs import runner

    text = SMALL + '[[codecs]]\ncodec = "pca"\ncomponents = [1, 2]\n[[codecs]]\ncodec = "neubtf-direct"\nsteps = 2\n'
    with tempfile.TemporaryDirectory() as folder:
        for _ in runner.run(parse_suite("small", text), runner.Options(Path(folder))):
            pass
        found = [json.loads(line) for line in (Path(folder) / "records.jsonl").read_text().splitlines()]
        files = {path.relative_to(folder): path.read_bytes() for path in Path(folder).rglob("*") if path.is_file()}
    stress = {"kind": "stress", "subject": "pca", "extreme": "dark", "verdict": "pass", "figure": "", "detail": "why"}
    stress |= {"group": "data", "order": 1, "seconds": 0.5, "used": 0.25, "version": 2, "holds": "finite"}
    failed = {"kind": "job", "job": "satin/vq/0", "material": "satin", "codec": "vq", "label": "vq", "curve": "vq"}
    failed |= {"seed": 0, "status": "failed", "error": "ValueError: no", "run": found[0]["run"], "split": "test"}
    FILES.update(files)
    return [*found, stress, failed]


FILES: dict[Path, bytes] = {}


def make_run(folder: Path) -> None:
    found = records_of_a_run()
    for name, content in FILES.items():
        if "tables" not in name.parts and name.suffix in (".npz", ".json") and name.parts[0] != "files":
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
    (folder / "records.jsonl").write_text("".join(map(sealed, [*found, *trade(found)])))


def unsealed(record: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in record.items() if key != "crc32"}


def sealed(record: Any) -> str:
    """The line of a record with its checksum, or without, where it has none to begin with."""
    if not isinstance(record, dict) or "crc32" not in record:
        return json.dumps(record) + "\n"
    rest = unsealed(record)
    head = {key: rest[key] for key in ("kind", "job") if key in rest}
    text = json.dumps(head | rest)[1:]
    return f'{{"crc32": "{zlib.crc32(text.encode()):08x}", {text}\n'


def trade(found: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """What `neubtf-bench trade` would measure of a run."""
    plain = {"kind": "timing", "run": found[0]["run"], "material": "satin", "execution": "eager", "dtype": "float32"}
    plain |= {"device": "cpu", "batch": 65536, "threads": 1, "ns_per_sample": 100.0, "interval95_ns": [99.0, 101.0]}
    plain |= {"ratio_to_floor": 2.0, "ratio_interval95": [1.9, 2.1]}
    quality = {"worst": 20.0, "psnr": 30.0, "flip": 0.1, "bytes": 1000, "limit_ns": 10.0}
    quality |= {"validation": {"mean": 30.0, "slices": 4}}
    made = []
    for job in found:
        if job["kind"] == "job" and job["status"] == "ok":
            what = {key: job[key] for key in ("label", "codec", "settings", "score_key")}
            made.append(plain | quality | what | {"job": f"{job['job']}/eager float32/cpu", "of": job["job"]})
    ceiling = {"device": "cpu", "threads": 1, "dtype": "float32", "flops_per_ns": 90.0, "bytes_per_ns": 9.0}
    floor = plain | {"job": "satin/floor/eager float32/cpu", "label": "floor", "ceilings": [ceiling], "left_out": []}
    return [*made, floor]


def attack_records(sample: Path, scratch: Path, rng: random.Random) -> Reading:
    folder = shutil.copytree(sample, scratch / "run")
    records = [json.loads(line) for line in (folder / "records.jsonl").read_text().splitlines()]
    if rng.random() < 0.5:
        records = list(map(unsealed, records))
    for _ in range(rng.randint(1, 2)):
        which = rng.randrange(len(records))
        seal = isinstance(records[which], dict) and "crc32" in records[which]
        if isinstance(records[which], dict):
            records[which] = changed(unsealed(records[which]), rng) | ({"crc32": ""} if seal else {})
    text = "".join(map(sealed, records)).encode("utf-8", "surrogatepass")
    (folder / "records.jsonl").write_bytes(damaged(text, rng) if rng.random() < 0.15 else text)
    if rng.random() < 0.1:
        spoil(rng.choice(sorted(path for path in folder.rglob("*") if path.suffix in (".npz", ".json"))), rng)
    return partial(read_run, folder, sample, rng.random())


def attack_trade(sample: Path, scratch: Path, rng: random.Random) -> Reading:
    folder = shutil.copytree(sample, scratch / "run")
    records = [json.loads(line) for line in (folder / "records.jsonl").read_text().splitlines()]
    which = rng.choice([i for i, record in enumerate(records) if "material" in record and record["kind"] == "timing"])
    records[which] = changed(records[which], rng)
    text = "".join(map(sealed, records)).encode("utf-8", "surrogatepass")
    (folder / "records.jsonl").write_bytes(text)
    return partial(read_trade, folder, rng.random())


def read_run(folder: Path, sound: Path, share: float) -> None:
    """Whatever a user may ask of a run's records."""
    from bench.compare.comparison import compare
    from bench.compare.forms import annotations, junit, tracker
    from bench.compare.frame import load_runs
    from bench.records import load_run
    from reports import table_text, write_report
    from reports.comparison import markdown, terminal

    if share < 0.03:
        write_report(folder)
    elif share < 0.4:
        pair = (load_run(folder), load_run(sound)) if share < 0.2 else (load_run(sound), load_run(folder))
        found = compare(*pair)
        markdown(found), terminal(found), annotations(found), junit(found), tracker(load_run(folder))
    elif share < 0.55:
        from bench.cli.commands.history import _table_of_means

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # which lines were left out
            frame = load_runs([folder, sound])
        _table_of_means(frame)
    else:
        for form in ("text", "markdown", "latex", "csv"):
            table_text(folder, form)


def read_trade(folder: Path, share: float) -> None:
    """Whatever a user may ask of a run's trade."""
    from bench.compare.choosing import Limits, best_choices_in_words, best_rung, choice_in_words, nearest, usable_rungs
    from bench.records import load_run
    from reports import table_text, write_report

    if share < 0.03:
        write_report(folder)
    elif share < 0.5:
        for form in ("text", "markdown", "latex", "csv"):
            table_text(folder, form, "trade")
    elif found := load_run(folder).choices:
        rungs = usable_rungs(found, "satin")
        limits = Limits(500_000, 90.0, 25.0)
        if rungs:
            choice_in_words((best_rung(rungs, limits) or nearest(rungs, limits)).of)
        list(best_choices_in_words(found, "satin"))


@cache
def job() -> Any:
    """A finished job whose file can be found again."""
    import tempfile

    from bench.runs.job import Attempt, Opening, Task, open_workbench

    suite = parse_suite("small", SMALL)
    folder = Path(tempfile.mkdtemp(prefix="fuzz-facts-"))
    task = Task("run", folder, suite.materials[0], suite.data, suite.codecs[0], 0, 1)
    what = Opening(task.run, task.material, task.data)
    workbench = open_workbench(what, lambda *_: None).__enter__()
    made = Attempt(task, workbench, lambda *_: None)
    made._file_and_facts()
    return made


def attack_facts(sample: Path, scratch: Path, rng: random.Random) -> Reading:
    made = job()
    origin = made.task.folder / made.file
    facts = json.loads(origin.with_suffix(".fit.json").read_text())
    facts["history"] = [{"step": 1, "seconds": 0.5, "psnr": 20.0}]
    path = scratch / origin.name
    shutil.copy(origin, path)
    written(path.with_suffix(".fit.json"), facts, json.dumps, rng)
    return partial(read_facts, made, path)


def read_facts(made: Any, path: Path) -> None:
    """Find the file again, or not; what is found goes into a record and into tables."""
    from bench.records import Records, Run, append
    from reports.tables import all_tables

    found = made._reusable_file(path)
    if found is None:
        raise InputError("fitted again")
    record = next(each for each in records_of_a_run() if each.get("kind") == "job" and each["codec"] == "mean-colour")
    append(path.parent, record | found[1])
    jobs = Records()
    jobs.put("a", record | found[1])
    all_tables(Run(path.parent, jobs=jobs))


def make_facts(folder: Path) -> None:
    """The sample is made once a process."""
    job()
    records_of_a_run()


TARGETS = [
    Target("suites", make_suites, attack_suite),
    Target("scenes", make_scenes, attack_scene),
    Target("demands", make_demand, attack_demand),
    Target("records", make_run, attack_records),
    Target("trades", make_run, attack_trade),
    Target("facts", make_facts, attack_facts),
]

if __name__ == "__main__":
    sys.exit(main(TARGETS, __file__, __doc__))
