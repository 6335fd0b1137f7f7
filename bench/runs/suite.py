"""Reads a suite: a TOML file of materials × codecs × settings × seeds, each combination of which is a job.

    description = "what it is for"
    threads = 1                      # CPU threads of a fit and of timing; the bytes of a file depend on it
    seeds = [0]                      # repetitions
    materials = ["satin", "/data/my-btf"]      # a built-in name, a path, or {name, path, where}

    [data]                           # how materials are prepared: `bench.data.spec.Preparation`
    size = 64

    [[codecs]]
    codec = "pca"
    components = [8, 16]             # a list is a sweep: one job for each value
    materials = ["satin"]            # run it only on these of the suite's materials (default: all)

A table `[[codecs]]` gives a `CodecSpec` for each combination of its lists. docs/suites.md describes every key. The path
of a material is tried as written, then under `$NEUBTF_DATA`; that of a demand only as written.

Functions that ask codecs import `bench.codec`, and so PyTorch, themselves: what only reads a suite starts without it.
"""

import dataclasses
import difflib
import itertools
import math
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.codecs.registry import COMMAND, UNLABELLED, load_codec, make_codec
from bench.data.kinds import kind_of
from bench.data.spec import MaterialSpec, Preparation, changed, named
from bench.demand import UNIFORM
from bench.inputs.errors import CodecError, InputError, MissingDataError, did_you_mean, shown
from bench.inputs.settings import (
    Seed,
    Share,
    Threads,
    as_typed,
    converted,
    fields,
    parse_toml,
    read_toml,
    shipped_toml,
    table,
)
from bench.metrics import DEFAULTS, chosen_names, refuse_taken_names
from bench.records import Job
from bench.records.schema import job_name

MOST_JOBS = 100_000
Words = tuple[str, ...]
Seeds = tuple[Seed, ...]


@dataclass(frozen=True)
class CodecSpec:
    """A codec of a suite with the settings that differ from its defaults."""

    codec: str
    settings: dict[str, Any] = field(default_factory=dict)
    swept: tuple[str, ...] = ()  # the settings that the suite varies in a list
    materials: tuple[str, ...] = ()  # names of the materials to run it on; empty: all of the suite
    seeds: Seeds = ()  # of its repetitions; empty: those of the suite

    @property
    def called(self) -> str:
        """What tables call the codec: its name, or that which the suite gives the codec `command`."""
        return str(self.settings.get("called", COMMAND)) if self.codec == COMMAND else self.codec

    @property
    def label(self) -> str:
        """The row's name in tables: `pca components=16`."""
        return self._label(self.settings)

    @property
    def curve(self) -> str:
        """The name of its jobs' rate–distortion curve: the label without the swept settings.

        `scene` stays even if it is swept: models of a scene have a curve of their own.
        """
        fixed = {key: value for key, value in self.settings.items() if key not in self.swept or key == "scene"}
        return self._label(fixed)

    def _label(self, settings: dict[str, Any]) -> str:
        """The name of the codec with some settings, sorted by name: `pca bits=8 components=4`."""
        words = [self.called]
        for key, value in sorted(settings.items()):
            if self.codec == COMMAND and key in UNLABELLED:  # the user names it: command lines are no useful name
                continue
            words.append(f"{key}={as_typed(value)}")
        return " ".join(words)


@dataclass(frozen=True)
class Suite:
    """A suite as read from TOML."""

    name: str
    text: str  # the TOML it was read from
    description: str = ""  # what it is for
    threads: Threads = 1  # CPU threads of a fit and of timing; the bytes of a file depend on it
    seeds: Seeds = (0,)  # of the repetitions
    data: Preparation = field(default_factory=Preparation)
    materials: tuple[MaterialSpec, ...] = ()
    codecs: tuple[CodecSpec, ...] = ()
    variants: Words = ()  # executions and precisions that a trade tries besides `eager float32`
    demand: str = ""  # path of a scene's demand: it judges every codec, and codecs with scene = true are fitted to it
    uniform: Share = UNIFORM  # share of the samples of a fit to the scene that is spread uniformly
    metrics: Words = DEFAULTS  # `psnr_display` is measured in any case

    @property
    def cells(self) -> list[tuple[MaterialSpec, CodecSpec, int]]:
        """Material, codec and seed of each job, in order. A codec that names materials runs on these alone."""
        cells = []
        for material, codec in itertools.product(self.materials, self.codecs):
            if not codec.materials or material.name in codec.materials:
                cells += [(material, codec, seed) for seed in codec.seeds or self.seeds]
        return cells


@dataclass(frozen=True)
class Task:
    """One cell of a suite as a worker gets it: plain data."""

    run: str  # its name
    folder: Path  # of the run
    material: MaterialSpec
    data: Preparation
    codec: CodecSpec
    repetition: int
    threads: int
    demand: str = ""  # path of the demand to score with
    uniform: float = UNIFORM
    metrics: tuple[str, ...] = DEFAULTS  # as the suite names them
    only_material: bool = False  # whether the run has no other
    device: str = "cpu"
    scorers: int | None = None  # threads that score; None: one a core
    fresh: bool = False  # fit and score again, whatever earlier runs left
    earlier: Job | None = None  # the job's latest record, if it may still hold
    network: str = ""  # the file, in the run's folder, of the network that the codec shares over materials
    losses: int = 0  # workers that died while they ran this job

    @property
    def name(self) -> str:
        """The name of the job: material/label/seed."""
        return job_name(self.material.name, self.codec.label, self.repetition)

    @property
    def base(self) -> Job:
        """The fields with which each record of this job begins."""
        record: Job = {
            "kind": "job",
            "job": self.name,
            "run": self.run,
            "material": self.material.name,
            "codec": self.codec.codec,
            "label": self.codec.label,
            "curve": self.codec.curve,
            "seed": self.repetition,
            "split": self.data.split,
        }
        if self.codec.codec == COMMAND:
            record["called"] = self.codec.called
        return record


def builtin_suites() -> dict[str, str]:
    """The text of each built-in suite by name."""
    return shipped_toml("bench.runs.suites")


def load_suite(name: str) -> Suite:
    """Load a built-in suite by name, or a TOML file by path. `InputError` names the file and the wrong key."""
    builtin = builtin_suites()
    if name in builtin:
        return parse_suite(name, builtin[name])
    path = Path(name)
    if path.suffix != ".toml":
        raise InputError(f"no suite named {name!r}{did_you_mean(name, builtin)} (a file's name ends in .toml)")
    return parse_suite(path.stem, read_toml(path), name)


def parse_suite(name: str, text: str, file: str = "") -> Suite:
    """Parse a suite from TOML text; errors name it `file`, or `suite NAME` if that is "".

    All is checked before anything is opened. `InputError` names the wrong key.
    """
    where = file or f"suite {name}"
    entries = parse_toml(where, text)
    # Materials and codecs have forms of their own; all other keys are fields of `Suite`, and converted by their types.
    materials = entries.pop("materials", [])
    codecs = entries.pop("codecs", [])
    for key, value in (("materials", materials), ("codecs", codecs)):
        if not isinstance(value, list):
            raise InputError(f"{where}: {key} must be a list, not {shown(value)}")
    suite = Suite(
        name,
        text,
        materials=tuple(_material_spec(f"{where}: materials", entry) for entry in materials),
        codecs=tuple(_codec_specs(f"{where}: codecs", codecs)),
        **fields(where, Suite, entries, without=("name", "text")),
    )
    _check_names(where, suite)
    _check_jobs(where, _count_jobs(suite))
    return dataclasses.replace(suite, metrics=_metric_names(f"{where}: metrics", suite.metrics))


def _check_names(file: str, suite: Suite) -> None:
    """Raise `InputError`, which names the file, for what a suite lists twice, and for a material that it lacks."""
    materials = [spec.name for spec in suite.materials]
    _refuse_repeated(f"{file}: codecs", [spec.label for spec in suite.codecs])
    _refuse_repeated(f"{file}: materials", materials, "give one of them another name, as {name = …, path = …}")
    _refuse_repeated(f"{file}: seeds", map(str, suite.seeds))
    for spec in suite.codecs:
        foreign = set(spec.materials) - set(materials)
        if foreign:
            fault = f"codecs.materials names {min(foreign)!r}, which is not a material of this suite"
            raise InputError(f"{file}: {fault}{did_you_mean(min(foreign), materials)}")


def _refuse_repeated(key: str, names: Iterable[str], remedy: str = "leave one out") -> None:
    """Raise `InputError`, which begins with `key`, if a name is given more than once."""
    twice = _first_repeated(names)
    if twice:
        raise InputError(f"{key}: {twice!r} appears twice: {remedy}")


def _first_repeated(names: Iterable[str]) -> str:
    """The first name that is given more than once; "" if none is."""
    for name, count in Counter(names).items():
        if count > 1:
            return name
    return ""


def _count_jobs(suite: Suite) -> int:
    """The number of a suite's jobs, without making `suite.cells`: a short file may ask for billions."""
    jobs = 0
    for spec in suite.codecs:
        materials = set(spec.materials) or suite.materials
        seeds = spec.seeds or suite.seeds
        jobs += len(materials) * len(seeds)
    return jobs


def _check_jobs(file: str, jobs: int) -> None:
    """Raise `InputError`, which names the file, for more jobs than `MOST_JOBS`."""
    if jobs > MOST_JOBS:
        raise InputError(f"{file}: it has {jobs:,} jobs, but the limit is {MOST_JOBS:,}: split it")


def with_metrics(suite: Suite, names: list[str]) -> Suite:
    """The suite with more metrics than its own. `InputError` if one names no metric."""
    return dataclasses.replace(suite, metrics=_metric_names("--metric", [*suite.metrics, *names]))


def _metric_names(key: str, names: Iterable[str]) -> tuple[str, ...]:
    """The names of metrics without duplicates. `InputError`, which begins with `key`, if one names no metric."""
    try:
        refuse_taken_names()
        return chosen_names(list(names), periodic=False)
    except InputError as error:
        raise InputError(f"{key}: {error}") from None


def with_changes(
    suite: Suite, materials: list[str], codecs: list[str], changes: dict[str, str], seeds: Sequence[int] = ()
) -> Suite:
    """The suite with the choices of the command line; an empty choice leaves it as it is.

    With `materials`, every codec runs on these alone. With `codecs`, only these run, by default settings if the suite
    does not name them. `changes` are values of settings by `data.KEY`, by `CODEC.KEY`, or by `KEY` for every codec that
    has it. With `seeds`, these are the only ones. `InputError` for a change that changes nothing, and for a material or
    a seed that is given twice.
    """
    if materials:
        suite = _with_materials(suite, materials)
    if codecs:
        suite = _with_codecs(suite, codecs)
    suite = _with_settings(suite, changes)
    if seeds:
        suite = _with_seeds(suite, seeds)
    return suite


def _with_materials(suite: Suite, names: list[str]) -> Suite:
    """The suite on these materials alone, each a name of the suite's, a built-in one, or a path."""
    spec_of_name = {spec.name: spec for spec in suite.materials}
    chosen = []
    for name in names:
        chosen.append(spec_of_name.get(name) or named(name))
    on_all_materials = tuple(dataclasses.replace(spec, materials=()) for spec in suite.codecs)
    return dataclasses.replace(suite, materials=with_distinct_names(chosen), codecs=on_all_materials)


def _with_codecs(suite: Suite, names: list[str]) -> Suite:
    """The suite with all its entries of these codecs alone; a codec that it does not have has its default settings."""
    chosen: list[CodecSpec] = []
    for name in names:
        of_suite = [spec for spec in suite.codecs if spec.codec == name]
        chosen += of_suite or [CodecSpec(name)]
    return dataclasses.replace(suite, codecs=tuple(chosen))


def _with_settings(suite: Suite, changes: dict[str, str]) -> Suite:
    """The suite with settings of its data and its codecs changed; see `with_changes`."""
    # Settings of the data are changed together, because not every one goes with the suite's others.
    of_data = {key: value for key, value in changes.items() if key.startswith("data.")}
    suite = dataclasses.replace(suite, data=changed(suite.data, of_data))
    for key, value in changes.items():
        if key in of_data:
            _refuse_ignored(suite, key)
        else:
            suite = _with_change(suite, key, value)
    return suite


def _with_seeds(suite: Suite, seeds: Sequence[int]) -> Suite:
    """The suite with these seeds for every codec. `InputError` if one is given twice."""
    _refuse_repeated("--seed", map(str, seeds))
    without_own = tuple(dataclasses.replace(spec, seeds=()) for spec in suite.codecs)
    return dataclasses.replace(suite, seeds=tuple(seeds), codecs=without_own)


def require_materials(suite: Suite, key: str) -> None:
    """Raise `InputError`, which begins with `key`, if a material is not to be found: before the first job rather than
    hours later.

    A material that is missing, but whose entry says where to get it, only leaves its jobs not available.
    """
    for spec in suite.materials:
        try:
            kind_of(spec).look_for(spec)
        except MissingDataError:
            continue
        except InputError as error:
            raise InputError(f"{key}: {error}") from None


def with_distinct_names(materials: list[MaterialSpec]) -> tuple[MaterialSpec, ...]:
    """The materials, with the names of folders before equal names: `coin-dirs.lp` and `tablet-dirs.lp`.

    Jobs, records and tables know a material by its name alone. `InputError` if one material is given twice.
    """
    paths = [_absolute_path(spec) for spec in materials]  # texts; of a built-in material its name
    twice = _first_repeated(paths)
    if twice:
        raise InputError(f"--material {twice}: it is given twice: leave one out")
    names = [spec.name for spec in materials]
    # Names that are still equal get one folder more in each turn, until no path has any left.
    for folders in range(1, max(len(Path(path).parts) for path in paths)):
        ambiguous = {name for name, count in Counter(names).items() if count > 1}
        for place, path in enumerate(paths):
            if names[place] in ambiguous:
                names[place] = "-".join(Path(path).parts[-1 - folders :])  # so many folders, and the last part
    twice = _first_repeated(names)
    if twice:
        raise InputError(f"--material: two materials are named {twice}: rename a folder")
    return tuple(dataclasses.replace(spec, name=name) for spec, name in zip(materials, names, strict=True))


def _absolute_path(spec: MaterialSpec) -> str:
    """The absolute path of a material's file or folder; the name of a built-in one."""
    if not spec.path:
        return spec.name
    return os.path.abspath(spec.existing_path() or spec.path)  # the path as written, if it is nowhere to be found


def canonical(suite: Suite) -> Suite:
    """The suite without settings that equal their defaults, and without the duplicates that this leaves.

    Equal jobs then have equal names, however the suite spells them. Loads the codecs. `InputError` if duplicates have
    other seeds.
    """
    try:
        specs = [dataclasses.replace(spec, settings=changed_settings(spec)) for spec in suite.codecs]
        merged = _merged(specs)
    except InputError as error:
        raise InputError(f"suite {suite.name}: {error}") from error
    return dataclasses.replace(suite, codecs=merged)


def _merged(specs: Sequence[CodecSpec]) -> tuple[CodecSpec, ...]:
    """The entries of a suite, of which those with equal labels become one, on the materials of all of them.

    `InputError` if their seeds differ: not every material would have all of them.
    """
    unique: dict[str, CodecSpec] = {}  # by label
    for spec in specs:
        if spec.label not in unique:
            unique[spec.label] = spec
            continue
        first = unique[spec.label]
        if spec.seeds != first.seeds:
            raise InputError(f"codecs: {spec.label!r} appears twice, with other seeds: give both the same ones")
        if first.materials and spec.materials:
            materials = tuple(dict.fromkeys(first.materials + spec.materials))  # those of both, each once
        else:
            materials = ()  # one of the two is for all materials, so both together are
        unique[spec.label] = dataclasses.replace(first, materials=materials)
    return tuple(unique.values())


def changed_settings(spec: CodecSpec) -> dict[str, Any]:
    """The settings of a codec that differ from its recipe's defaults, as the codec parses them.

    A recipe is a named set of defaults, such as `recipe=paper`, the settings that were published. A codec that cannot
    be made keeps the settings as they are given.
    """
    from bench.codec import RECIPE, settings_dict

    recipe = {key: value for key, value in spec.settings.items() if key == RECIPE}
    try:
        codec = make_codec(spec.codec, spec.settings)
        chosen = settings_dict(codec)
        default = settings_dict(make_codec(spec.codec, recipe))
        if recipe:  # the recipe itself is a setting, whose default is not the recipe that is given
            default |= {RECIPE: codec.Settings.recipe}  # type: ignore[attr-defined]
    except CodecError:  # its jobs fail with this error
        return spec.settings
    # The values in force, since a recipe may overrule settings; a setting without a field keeps the value given.
    parsed = spec.settings | dataclasses.asdict(codec.settings) | chosen
    return {key: parsed[key] for key in spec.settings if chosen.get(key) != default.get(key)}


def _refuse_ignored(suite: Suite, key: str) -> None:
    """Raise `InputError` if all materials of a suite, which may have none, ignore a setting like "data.views"."""
    reasons = [kind_of(spec).ignores(spec, key) for spec in suite.materials]  # "" where a material heeds it
    if reasons and all(reasons):
        raise InputError(f"--set {key}: {reasons[0]}")


def _with_change(suite: Suite, key: str, value: str) -> Suite:
    """The suite with one setting of its codecs changed, KEY or CODEC.KEY. `InputError` if it changes nothing."""
    scope, _, name = key.rpartition(".")  # the scope is "" or a codec
    having_it = {spec.codec for spec in suite.codecs if _has_setting(spec.codec, scope, name)}
    if not having_it:
        raise InputError(f"--set {key}: no codec of this run has a setting {name!r}{_hint(suite, scope, name)}")
    codecs = [_with_setting(spec, name, value) if spec.codec in having_it else spec for spec in suite.codecs]
    return dataclasses.replace(suite, codecs=_merged(codecs))  # a sweep over the changed setting has become one job


def _hint(suite: Suite, scope: str, name: str) -> str:
    """The end of a message on an unknown setting: that the suite does not run its codec, or else which setting of a
    codec or of the data was probably meant."""
    from bench.codec import setting_names

    codecs = {spec.codec for spec in suite.codecs}
    if scope and scope not in codecs:
        return f": it runs no codec {scope!r}{did_you_mean(scope, [*codecs, 'data'])}"
    # How each setting is written by its bare name, because the scope may be forgotten.
    written = {each.name: f"data.{each.name}" for each in dataclasses.fields(Preparation)}
    for codec in {scope} if scope else codecs:  # without a scope, any codec may be meant
        with suppress(CodecError):  # its jobs fail with this error
            written |= {setting: setting for setting in setting_names(load_codec(codec))}
    near = difflib.get_close_matches(name, sorted(written), n=1)
    if near:
        return f"; did you mean {written[near[0]]!r}?"
    return ": `neubtf-bench list codecs NAME` shows those of a codec"


def described_changes(suite: Suite, changes: dict[str, str]) -> list[str]:
    """Lines on changes of settings: which codecs each one changes, and why a material ignores one of the data."""
    codecs = dict.fromkeys(spec.codec for spec in suite.codecs)  # each once, in order
    lines = []
    for key, value in changes.items():
        scope, _, name = key.rpartition(".")
        if scope == "data":
            reasons = [kind_of(spec).ignores(spec, key) for spec in suite.materials]
            lines += [f"--set {key}={value}: {reason}" for reason in reasons if reason]
        else:
            reached = [codec for codec in codecs if _has_setting(codec, scope, name)]
            lines.append(f"--set {key}={value} changes {', '.join(reached)}")
    return lines


def _has_setting(codec: str, scope: str, setting: str) -> bool:
    """Whether a codec has a setting, and is of this scope: a codec's name, or "" for all codecs."""
    from bench.codec import setting_names

    if scope not in ("", codec):
        return False
    try:
        return setting in setting_names(load_codec(codec))
    except CodecError:  # its jobs fail with this error
        return False


def _with_setting(spec: CodecSpec, setting: str, value: str) -> CodecSpec:
    """The entry of a suite with one setting changed, whose value is a word of the command line."""
    from bench.codec import SCENE

    codec = make_codec(spec.codec, {setting: value})  # which converts the word
    holder = codec if setting == SCENE else codec.settings
    return dataclasses.replace(spec, settings=spec.settings | {setting: getattr(holder, setting)})


def _material_spec(where: str, entry: Any) -> MaterialSpec:
    """A material of a suite: its name alone, or a table."""
    if isinstance(entry, str):
        return named(converted(where, str, entry))
    spec: MaterialSpec = table(where, MaterialSpec, entry)
    return spec


def _codec_specs(where: str, entries: list[Any]) -> Iterator[CodecSpec]:
    """The codecs of all tables: for each table, one for each combination of its listed values."""
    jobs = 0
    for entry in entries:
        if not isinstance(entry, dict):
            raise InputError(f"{where} must be tables, not {shown(entry)}")
        settings = dict(entry)
        codec = converted(f"{where}.codec", str, settings.pop("codec", None))
        materials = converted(f"{where}.materials", Words, settings.pop("materials", []))
        seeds = converted(f"{where}.seeds", Seeds, settings.pop("seeds", []))
        _refuse_repeated(f"{where}.seeds", map(str, seeds))
        swept = tuple(key for key, value in settings.items() if isinstance(value, list))
        values_of_key = {key: value if key in swept else [value] for key, value in settings.items()}
        for key, values in values_of_key.items():
            _check_values(f"{where}.{key}", values)
        jobs += math.prod(map(len, values_of_key.values()))
        _check_jobs(where, jobs)  # before they are made: a short file may ask for billions
        for combination in itertools.product(*values_of_key.values()):
            yield CodecSpec(codec, dict(zip(settings, combination, strict=True)), swept, materials, seeds)


def _check_values(key: str, values: list[Any]) -> None:
    """Raise `InputError` unless a setting has values: texts, true or false, or numbers. The codec checks more."""
    if not values:
        raise InputError(f"{key} is an empty list: give at least one value, or leave it out")
    for value in values:
        value_type = type(value) if isinstance(value, str | bool) else float
        converted(key, value_type, value)
