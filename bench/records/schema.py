"""The fields of every record: each states once its type, which shorter forms keep it, and how tables show it.

A record is a plain dictionary, of one of the classes here (docs/decisions/0096-records-are-typed-dictionaries.md).
Functions say which class they take, so a wrong name of a field, or a wrong type, is found before the code runs; what
comes from a file is checked by the same classes (`bench.records.fields`). Besides its type a field may state

- its `Use`: the shorter forms of a record that keep it (`kept`), or that it names a file of the run's folder;
- `Needed`: a comparison or a table requires it (`require`);
- `Shown`: tables, the page and published results have a column of it.

So a new number takes two edits: its measurement and its field. Fields that are not listed are free, but plain (`Free`);
the shorter forms drop them.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import Flag, auto
from typing import Annotated, Any, Literal, NamedTuple, NotRequired, Required

from annotated_types import Interval, Len, MaxLen
from typing_extensions import TypedDict  # pydantic cannot read the one of `typing` before Python 3.12


class Use(Flag):
    """What a field is used for."""

    REFERENCE = auto()  # kept in the reference of a suite
    RESULTS = auto()  # kept in published results, and on the page
    NAMES = auto()  # names the job
    CLAIM = auto()  # compared when a submitted record is verified
    ARTEFACT = auto()  # names a file of the run's folder
    APART = auto()  # not in the table of all numbers: it names the row, or has its own form
    MUST = auto()  # a record without it is refused; a record that is still being built may lack it


REFERENCE, RESULTS, NAMES, CLAIM, ARTEFACT, APART, MUST = Use
PUBLISHED = REFERENCE | RESULTS


class Needed(NamedTuple):
    """A job with a result needs the field, with these keys, to be compared, shown or verified."""

    by: Literal["comparison", "tables", "verification"]
    keys: tuple[str, ...] = ()


class Shown(NamedTuple):
    """A column of a number: its name, its unit with an arrow to the better end, its significant digits (0: whole)."""

    name: str
    unit: str
    digits: int = 3


LARGEST = 10**18  # a larger number is not a measurement
WHOLE = (1 << 63) - 1  # the largest whole number, which seeds reach
DEEPEST = 12  # the most levels of lists and objects in a free field
LONGEST = 1 << 20  # the most characters of a text; a traceback is far shorter


@dataclass(frozen=True)
class Rule:
    """What a value must be besides its type, in words, and the test of it."""

    words: str
    test: Callable[[Any], object]

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        """What pydantic asks a mark for: the check of the type `source`, then the test."""
        from pydantic_core import core_schema  # only where something is read

        return core_schema.no_info_after_validator_function(self._tested, handler(source))

    def _tested(self, value: Any) -> Any:
        """The value; `ValueError`, which pydantic makes its message from, if it fails the test."""
        if not self.test(value):
            raise ValueError(f"must be {self.words}")
        return value


def _is_plain(value: Any, depth: int = 0) -> bool:
    """Whether a value of JSON, with `depth` levels around it, has at most `DEEPEST` with them, and holds only numbers
    and texts that tables can show."""
    if isinstance(value, dict):
        return _is_plain(list(value.values()), depth)
    if isinstance(value, list):
        return depth < DEEPEST and all(_is_plain(item, depth + 1) for item in value)
    if isinstance(value, str):
        return len(value) <= LONGEST
    return value is None or -LARGEST <= value <= WHOLE


Number = Annotated[float, Interval(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Interval(gt=0, le=LARGEST)]
NotNegative = Annotated[float, Interval(ge=0, le=LARGEST)]
Cosine = Annotated[float, Interval(ge=0, le=1)]
Count = Annotated[int, Interval(ge=0, le=WHOLE)]
Side = Annotated[int, Interval(ge=1, le=WHOLE)]
Text = Annotated[str, MaxLen(LONGEST)]
Name = Annotated[Text, Rule("a name", str.strip)]
Digits = Annotated[str, Rule("64 hexadecimal digits", re.compile("[0-9a-f]{64}").fullmatch)]
Setting = bool | Annotated[int, Interval(ge=-LARGEST, le=WHOLE)] | Number | Text
Pair = Annotated[list[Number], Len(2, 2)]
Statistics = dict[str, Number | None]
Free = Annotated[Any, Rule("finite numbers, texts, true, false or null, not nested deeply", _is_plain)]


class Open(TypedDict, extra_items=Free):  # type: ignore[call-arg]  # PEP 728, which mypy does not know
    """What every record and every part of one is: fields that a class does not list are free."""


class MetricFacts(Open, total=False):
    """What tables say of a metric with its numbers."""

    unit: Required[Annotated[Text, PUBLISHED]]
    direction: Required[Annotated[Literal["higher", "lower"], PUBLISHED]]
    space: Annotated[Text, RESULTS]
    version: Required[Annotated[Count, PUBLISHED]]


class Group(Open, total=False):
    """The scores of a group of pairs."""

    slices: Count
    radiance: Number | None
    metrics: Required[dict[str, Statistics]]


class Point(Open, total=False):
    """A point of the curve of a fit."""

    step: Required[Count]
    seconds: Number
    psnr: Number


class FitKey(Open, total=False):
    """Everything that a file depends on."""

    codec: Annotated[Name, RESULTS | CLAIM]
    version: Annotated[Count, PUBLISHED | CLAIM]
    store: Annotated[Count, PUBLISHED]  # version of the store of textures
    settings: Annotated[dict[str, Setting], PUBLISHED | CLAIM]
    training: Annotated[Free, PUBLISHED | CLAIM]
    seed: Count
    threads: Count
    device: Annotated[Text, RESULTS]  # the kind that it was fitted on
    torch: Free
    code: Annotated[Free, RESULTS]
    libraries: dict[str, Text | None]
    shared: Annotated[Free, RESULTS | CLAIM]
    programs: Text  # of a codec that is two programs: a digest of them
    demand: Text  # of the scene that it was fitted to
    uniform: Number


class ScoreKey(Open, total=False):
    """Everything that scores depend on, besides the file."""

    sha256: Annotated[Text, RESULTS | CLAIM]
    code: Text
    scored: Count  # pairs, where not all are
    low_light: Count  # pairs of the group of that name, which the fingerprint leaves out
    between: Count  # pairs that are scored between texels, which the fingerprint leaves out, too
    btf: Annotated[Text, PUBLISHED | CLAIM]
    exposure: Annotated[Number, PUBLISHED | CLAIM]
    metrics: Annotated[dict[str, Count], RESULTS | CLAIM]
    footprints: Annotated[Free, PUBLISHED | CLAIM]
    demand: Annotated[Text | None, RESULTS]
    deciding: Annotated[Text | None, PUBLISHED | CLAIM]


class Bytes(Open, total=False):
    """The size of a file by part, and of the file of a network that it shares with others; empty without a file."""

    decoder: Count
    texture: Count
    encoder: Count
    sampling: Count
    other: Count
    header: Count
    shared: Count
    total: Required[Count]


class Cost(Open, total=False):
    """What a decoder holds and what a sample costs, by name of `bench.material.DecoderCost`."""

    parameters: Annotated[Count, CLAIM]
    texture_channels: Annotated[Count, RESULTS | CLAIM]
    texture_floats: Annotated[Count, CLAIM]
    flops_per_sample: Annotated[Count, RESULTS | CLAIM]
    bytes_per_sample: Annotated[Count, CLAIM]
    table_floats: Annotated[Count, CLAIM]


class Provenance(Open, total=False):
    """Where a BTF comes from."""

    source: Annotated[Free, RESULTS]
    material: Annotated[Free, RESULTS]
    parameters: Free
    renderer_version: Annotated[Free, RESULTS]
    path_version: Annotated[Free, RESULTS]
    surface: Annotated[Text, RESULTS]  # what a kind of surface of its own is called in tables
    free: Annotated[bool, RESULTS]  # whether its pictures may be published
    native: Annotated[Free, RESULTS]
    split: Annotated[Free, RESULTS]


class Machine(Open, total=False):
    """The machine of a job or a run; published without the host's name."""

    host: Setting | None
    system: Setting | None
    processor: Annotated[Setting | None, PUBLISHED]
    capability: Annotated[Setting | None, PUBLISHED]
    cores: Annotated[Setting | None, RESULTS]


class ProgramTime(Open):
    """How long a codec's own program took to answer."""

    queries: Count
    ns_per_query: NotNegative


class Scene(Open):
    """The quality in the frames of a scene."""

    name: Text
    queries: Count
    frames: Annotated[list[Count], Len(3, 3)]
    exposure: NotRequired[Number]
    metrics: Statistics


class Between(Open):
    """The display PSNR between texels, half a texel down and to the right of their centres: means over slices, dB."""

    mean: Number
    centres: Number  # of the same pairs at texel centres
    slices: Count


class Job(Open, total=False):
    """The result of a job: what was encoded, its bytes and errors, or why it failed."""

    kind: Annotated[Text, PUBLISHED | NAMES | APART]
    job: Annotated[Text, PUBLISHED | NAMES | APART]
    run: Annotated[Text, RESULTS | NAMES | APART, Needed("tables"), Needed("verification")]
    material: Annotated[Name, PUBLISHED | NAMES | APART, MUST]
    codec: Annotated[Name, PUBLISHED | NAMES | APART, MUST]
    called: Annotated[Name, PUBLISHED | NAMES | APART]  # what its suite calls the codec `command`; absent of others
    label: Annotated[Name, PUBLISHED | NAMES | APART, MUST]
    curve: Annotated[Name, RESULTS | NAMES, Needed("verification")]  # of sizes: the label without swept settings
    seed: Annotated[Count, PUBLISHED | NAMES | APART, MUST]
    split: Annotated[Text, RESULTS | CLAIM]
    status: Annotated[Literal["ok", "failed", "unavailable"], PUBLISHED | APART, MUST]
    error: Annotated[Text, RESULTS]
    traceback: Annotated[Text, APART]
    shape: Annotated[list[Count], Len(2, 2), RESULTS | CLAIM | APART, Needed("tables")]
    pairs: Annotated[dict[str, Count], RESULTS | CLAIM, Needed("tables", ("train",))]
    views: Annotated[Count, RESULTS]  # different view directions
    settings: Annotated[dict[str, Setting], RESULTS | CLAIM | APART]
    bytes: Annotated[Bytes, PUBLISHED | CLAIM]
    parameters: Annotated[Count | None, PUBLISHED | CLAIM]  # None: of a program, which does not tell
    resident: Annotated[Count | None, RESULTS]  # bytes of the decoded material in memory; None as for parameters
    cost: Annotated[Cost, RESULTS | CLAIM, Needed("tables", ("texture_channels",))]
    metrics: Annotated[dict[str, MetricFacts], PUBLISHED | CLAIM | APART]
    scores: Annotated[dict[str, Group], CLAIM]
    footprints: Annotated[dict[str, Statistics], PUBLISHED | CLAIM]
    between: Annotated[Between, RESULTS | CLAIM]  # absent where no pair was rendered between texels
    black: Annotated[Number, RESULTS]  # display PSNR of an all-black answer, where the material is badly exposed
    scene: Annotated[Scene, RESULTS]
    program: Annotated[ProgramTime, RESULTS]
    fit_key: Annotated[
        FitKey,
        PUBLISHED | CLAIM | APART,
        Needed("comparison", ("version", "settings", "training")),
        Needed("verification", ("version", "code")),
    ]
    fit_seconds: Annotated[NotNegative, RESULTS, Shown("CPU", "s", 2)]
    fit_memory: Annotated[Count, RESULTS]  # bytes at most while it was fitted, as `bench.machine.memory` counts
    fit_cached: bool
    fitted: Annotated[dict[str, Text | None], RESULTS]  # the time, and the revision of the code, as in `scored`
    history: Annotated[list[Point], RESULTS]
    faults: Annotated[list[Text], RESULTS]  # what is wrong with the fit; absent where nothing is
    score_key: Annotated[
        ScoreKey,
        PUBLISHED | CLAIM | APART,
        Needed("comparison", ("btf", "exposure")),
        Needed("tables"),
        Needed("verification", ("btf", "metrics")),
    ]
    scored: Annotated[dict[str, Text | None], RESULTS]
    verified: Annotated[bool, RESULTS | APART]  # it was handed in, and its file scored anew where the record was made
    provenance: Annotated[Provenance, RESULTS | APART]
    machine: Annotated[Machine, RESULTS]
    file: Annotated[Text, RESULTS | ARTEFACT, Needed("verification")]
    slices: Annotated[Text | dict[str, Text], ARTEFACT]  # by metric
    angular: Annotated[Text, ARTEFACT]
    pictures: Annotated[Text, ARTEFACT]
    frames: Annotated[Text, ARTEFACT]
    drawing: Annotated[Text, ARTEFACT]
    not_drawn: Text


class Noise(Open):
    """Samples and seconds until the noise in a scene is 1 %, by cosine and by lobes."""

    scene: Text
    samples: Annotated[list[NotNegative], Len(2, 2)]
    seconds: Annotated[list[NotNegative], Len(2, 2)]


class Ceiling(Open):
    """The measured rates of computing and reading of a machine."""

    device: Text
    dtype: Text
    threads: Count
    flops_per_ns: Positive
    bytes_per_ns: Positive


class Timing(Open, total=False):
    """A measured time of a sample, in turns with the floor: of a job's decoder, of a setting (it has `flops`), or of a
    trade (it has a `material`).

    A trade times *choices*: the file of the job `of` in an execution and a precision, with its quality. It may hold an
    `error` in place of numbers. The floor has one, too, which is `of` no job.
    """

    kind: Annotated[Text, PUBLISHED | APART]
    job: Annotated[Text, PUBLISHED | APART]  # its name: that of a job, or one by `setting_name` or `trade_name`
    run: Annotated[Text, PUBLISHED | APART, MUST]
    ns_per_sample: Annotated[Positive, PUBLISHED]
    interval95_ns: Annotated[Pair, PUBLISHED]
    iqr_ns: Number
    ratio_to_floor: Annotated[Positive, PUBLISHED]
    ratio_interval95: Annotated[Pair, PUBLISHED]
    ratio_least: Positive
    ratio_at_one_texel: Annotated[Positive, RESULTS]
    ratio_between_texels: Annotated[Positive, RESULTS]  # of a setting whose time is that at one texel
    label: Annotated[Name, RESULTS | APART]
    flops: Annotated[Count, RESULTS | APART]  # operations of a query
    rounds: Annotated[list[Positive], RESULTS | APART]  # × floor, in each round on each surface
    limit_ns: Annotated[NotNegative, RESULTS | APART]  # of a sample, by the machine's ceilings
    of_tolerance: Annotated[NotNegative, RESULTS | APART]  # largest difference from float64, over what is allowed
    read_bytes: Annotated[Count, RESULTS | APART]  # of a sample, on a GPU
    memory: Annotated[Count, RESULTS | APART]  # of the GPU, at most, while it answers the batch
    watts: Annotated[NotNegative, RESULTS | APART]  # that the GPU draws meanwhile
    floor_ns: Positive
    samples_ns: Annotated[Free, APART]
    floor_ratios: Annotated[Free, APART]
    batch: Annotated[Count, PUBLISHED]
    dtype: Annotated[Text, PUBLISHED]
    threads: Annotated[Count, PUBLISHED]
    device: Annotated[Text, PUBLISHED]
    execution: Annotated[Text, PUBLISHED]
    queries: Annotated[Text, PUBLISHED]
    gpu: Annotated[Text, PUBLISHED]
    # Of a trade: what was timed
    material: Annotated[Name, RESULTS | APART]
    of: Annotated[Text, RESULTS | APART]
    codec: Annotated[Text, RESULTS | APART]
    settings: Annotated[dict[str, Setting], RESULTS | APART]
    score_key: Annotated[ScoreKey, RESULTS | APART]  # that of the job
    bytes: Annotated[Count, RESULTS | APART]
    parameters: Annotated[Count | None, RESULTS | APART]
    emulated: Annotated[bool, RESULTS | APART]
    error: Annotated[Text, RESULTS | APART]
    # its quality: display PSNR in dB, of the mean and the worst slice, and against eager float32
    psnr: Annotated[Number | None, RESULTS | APART]
    worst: Annotated[Number | None, RESULTS | APART]
    from_float32: Annotated[Number | None, RESULTS | APART]
    flip: Annotated[Number | None, RESULTS | APART]
    validation: Annotated[Statistics, RESULTS | APART]
    noise: Annotated[Noise, RESULTS | APART]
    noise_error: Annotated[Text, RESULTS | APART]
    # of the floor of choices: the machine, and the variants that it only emulates and that were left out
    ceilings: Annotated[list[Ceiling], RESULTS | APART]
    left_out: Annotated[list[Text], RESULTS | APART]


def job_name(material: str, label: str, seed: int) -> str:
    """The name of a job: `satin/pca components=4/0`."""
    return f"{material}/{label}/{seed}"


def setting_name(label: str, flops: int) -> str:
    """The name of the timing of a setting whose files take so many operations a query."""
    return f"any surface/{label}/{flops} operations"


def trade_name(of: str, device: str, *conditions: str) -> str:
    """The name of what a trade timed on a device, under some conditions, in words: `of` is a job, or a floor."""
    return "/".join((of, *conditions, device))


class Stress(Open, total=False):
    """One extreme, tried on one codec or metric."""

    kind: Text
    subject: Required[Name]
    extreme: Required[Name]
    group: Required[Name]
    verdict: Required[Literal["pass", "fail", "n/a"]]
    detail: Required[Text]
    figure: Required[Text]
    order: Required[Count]
    holds: Text
    used: Number | None
    version: Count | None


class RunStart(Open, total=False):
    """The provenance of a run, once a start."""

    kind: Annotated[Text, PUBLISHED]
    run: Annotated[Text, RESULTS]
    suite: Annotated[Text, PUBLISHED]
    text: Text  # of the suite's file
    device: Annotated[Text, PUBLISHED]
    threads: Annotated[Count, PUBLISHED]
    seeds: Annotated[list[Count], RESULTS]
    data: Annotated[Free, RESULTS]
    materials: Annotated[Free, RESULTS]
    jobs: Annotated[list[Text], RESULTS]
    git: Annotated[Text | None, RESULTS]
    python: Text
    packages: Annotated[dict[str, Text | None], PUBLISHED]
    ceilings: Annotated[Free, RESULTS]  # of the machine: flops and bytes a ns
    machine: Annotated[Machine, PUBLISHED]
    metrics: Annotated[dict[str, MetricFacts], RESULTS]  # in published results: of its jobs, which do not repeat them


Record = RunStart | Job | Timing | Stress  # a line of a run's records


class Facts(Open, total=False):
    """The facts of a fit, stored beside a codec file and not in it, so that its bytes do not change."""

    fit_key: Required[FitKey]
    sha256: Required[Text]
    fit_seconds: Required[NotNegative]
    history: Required[list[Point]]
    faults: list[Text]  # what is wrong with a fit that ended, if anything is
    fit_memory: Count
    fitted: dict[str, Text | None]


class FileScene(Open):
    """The scene that a codec file was fitted to; see `bench.demand.needed_part`."""

    name: Text
    demand: Text
    size: Annotated[list[Side], Len(2, 2)]  # (H, W) of the whole texture, in texels
    window: Annotated[list[Count], Len(4, 4)]  # top, left, height and width, in these texels
    factor: Side  # texels of the whole texture a side of each stored one
    pairs: Count
    finest: NotNegative  # a footprint in longer sides of the texture: 1 % of the demand is finer
    uniform: NotNegative  # the share of the fit that is spread evenly over all pairs
    views: Digits  # the maps of demanded directions, as `bench.codecs.window.to_hex` writes them
    lights: Digits


class FileMetadata(Open, total=False):
    """What the header of a codec file says of it, besides its tensors."""

    codec: Required[Text]
    version: Required[Count]
    settings: Required[dict[str, bool | int | float | str]]
    kind: Literal["material", "shared"]
    lowest_light: Cosine  # cos θ of the lowest light that was fitted
    scene: FileScene
    shared: Digits  # the hash of the network that decodes it, if it shares one
    provenance: dict[str, Free]  # sources of the file other than a BTF


class SceneModel(Open):
    """A model of a search for the smallest file for a scene: "full", of the whole material, or "scene"."""

    model: Text
    bytes: Count
    ns: Positive  # of a query of the scene
    steps: Count | None
    seconds: NotNegative  # of the fit
    psnr: Number | None  # dB, in the frames
    flip: Number | None
    outside: Number | None  # dB, at pairs that the scene does not use
    held_out: Number | None  # dB, at held-out pairs that lie in the scene
    settings: dict[str, Setting]
