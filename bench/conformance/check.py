"""The promises that a renderer relies on: each check is a function that raises `CheckError` and says what is wrong.

A codec under test encodes a small synthetic BTF, writes the file, and decodes it, here and in a fresh process. The
docstring of a check is the promise, as reports show it. A check that passes returns a note for the codec's author, or
None.
"""

import itertools
import math
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import chdir
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from bench.btf import BTF, ArraySource
from bench.codec import Codec, Fit, Progress, TrainedNetwork, settings_dict, silent
from bench.codecs import container, loading, shared
from bench.codecs.encoding import error_in_words, fit_codec, fit_to_file, own_frames
from bench.conformance import counting, emulated, frame
from bench.directions.hemisphere import thinned_product, ubo2003, uniform
from bench.inputs.errors import InputError, answered
from bench.machine.devices import is_gpu
from bench.machine.threads import torch_threads
from bench.material import Material, texel_centres

# Float32 sums of a few hundred terms in another order differ by about 1e-6 of their size; allow ten times that.
ROUNDING = 1e-5
QUERIES = 500  # random queries that most checks ask
GRAZING = math.radians(89.9)  # a light just above the horizon
MOST_LEFT = 0.01  # at `GRAZING`, at most this share of the mean answer to a light at the zenith


class NotApplicable(Exception):  # noqa: N818 (it is not an error)
    """The reason why a check does not apply to a codec, or cannot be tried here."""


class CheckError(AssertionError):
    """A codec breaks a promise of the interface. `figure` is the measured number that is wrong, as a table shows it."""

    def __init__(self, message: str, figure: str = ""):
        super().__init__(message)
        self.figure = figure


def tiny_btf(size: int = 8, views: int = 9, lights: int = 9) -> BTF:
    """A small smooth material in closed form: coloured waves, Lambert plus a broad highlight; periodic."""
    wo, wi = thinned_product(ubo2003(), views, lights)
    row, col = np.mgrid[:size, :size] / size
    values = tiny_radiance(row, col, wo[:, None, None], wi[:, None, None]).astype(np.float32)
    return BTF("check", wo, wi, ArraySource(values), periodic=True)


def tiny_radiance(row: np.ndarray, col: np.ndarray, wo: np.ndarray, wi: np.ndarray) -> np.ndarray:
    """The radiance (…, 3) of `tiny_btf` for directions (…, 3), at any row and column (…) as shares of the picture."""
    waves = [np.sin(2 * np.pi * row), np.cos(2 * np.pi * col), np.sin(2 * np.pi * (row + col))]
    albedo = 0.4 + 0.3 * np.stack(waves, -1)
    half = (wo + wi) / np.linalg.norm(wo + wi, axis=-1, keepdims=True)
    gloss = 0.5 * half[..., 2:] ** 20 * (1 + np.sin(2 * np.pi * col))[..., None]
    return (albedo / np.pi + gloss) * wi[..., 2:]


def others(btf: BTF) -> list[BTF]:
    """Five materials that a shared network is trained on beside a BTF: its colour channels in every other order."""
    values = np.stack(list(btf))
    recoloured = []
    _, *orders = itertools.permutations(range(3))  # the first is the order that the BTF has
    for channels in orders:
        source = ArraySource(values[..., channels])
        recoloured.append(BTF(f"colours {channels}", btf.wo, btf.wi, source, periodic=True))
    return recoloured


@dataclass
class CodecUnderTest:
    """One codec under test, encoded once."""

    codec: Codec
    folder: Path  # for its files
    trained: TrainedNetwork | None = None  # the shared network to use; None: the one that `shared` finds
    show: Progress = silent
    moved_to: str = ""  # the working directory that the codec left behind

    @cached_property
    def btf(self) -> BTF:
        """The small material."""
        return tiny_btf()

    @cached_property
    def network(self) -> TrainedNetwork | None:
        """The network that the codec shares over materials; None if it shares none."""
        return self.trained or shared.find_for(self.codec)

    def encode(self, name: str, btf: BTF | None = None) -> container.Header:
        """Encode a BTF, by default the small material, into a file of that name."""
        fit = Fit(seed=1, network=self.network, show=self.show)
        before = os.getcwd()
        # Not by `fit_to_file`, which restores the random state of the process after a fit. Here that state moves on:
        # so a codec that draws from it, and not from its seed, writes another file the second time, which is an error.
        # Fits need gradients, even if the caller has switched them off. `chdir` returns to where it was at the end.
        with chdir(before), torch.enable_grad():
            parts = fit_codec(self.codec, btf or self.btf, fit).parts
            after = _working_directory()
            if after != before:
                self.moved_to = after
        return container.save(self.folder / name, self.codec, parts)

    @cached_property
    def header(self) -> container.Header:
        """The file of the small material."""
        return self.encode("a" + container.SUFFIX)

    @cached_property
    def material(self) -> Material:
        """The small material, decoded from its file."""
        return loading.load(self.header.path, network=self.network).material

    @cached_property
    def frame_answers(self) -> frame.FrameAnswers:
        """The codec's answers on the material on which every arrangement looks different."""
        return self.answers_given(frame.truth)

    def answers_given(self, radiance: frame.Radiance) -> frame.FrameAnswers:
        """The codec's answers on the material of `frame` with this radiance."""
        btf = frame.material(radiance)
        header = self.encode(f"frame{container.SUFFIX}", btf)
        with torch_threads(1):
            decoded = loading.load(header.path, network=self.network).material
            return frame.FrameAnswers.at_texel_centres(decoded, btf)

    @cached_property
    def queries(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Random queries: uv over several periods, directions up to 89°, footprints up to half the picture."""
        rng = np.random.default_rng(0)
        uv = torch.from_numpy(rng.uniform(-3, 3, (QUERIES, 2)).astype(np.float32))
        wo = torch.from_numpy(uniform(rng, QUERIES, theta_max_deg=89))
        wi = torch.from_numpy(uniform(rng, QUERIES, theta_max_deg=89))
        footprint = torch.from_numpy(rng.uniform(0, 0.5, QUERIES).astype(np.float32))
        return uv, wo, wi, footprint

    @cached_property
    def answers(self) -> Tensor:
        """The answers (QUERIES, 3) of the small material to `queries`."""
        with torch_threads(1):  # as the fresh process has, whose answers must be these bit for bit
            return self.material.query(*self.queries)


def _working_directory() -> str:
    """The working directory of this process, for a message: it may be gone."""
    try:
        return os.getcwd()
    except FileNotFoundError:
        return "a folder that is gone"


def _difference(ours: Tensor, theirs: Tensor, tolerance: float) -> tuple[float, float]:
    """The largest difference of two answers, and what is allowed: `tolerance` × the larger of 1 and any of `theirs`."""
    return (ours - theirs).abs().max().item(), tolerance * max(1.0, theirs.abs().max().item())


def _require_same(what: str, ours: Tensor, theirs: Tensor, tolerance: float) -> None:
    """Raise `CheckError` unless two answers have the same shape, and differ by no more than `_difference` allows."""
    if ours.shape != theirs.shape:
        raise CheckError(f"{what}: answers have the shape {tuple(ours.shape)}, not {tuple(theirs.shape)}")
    worst, allowed = _difference(ours, theirs, tolerance)
    if not worst <= allowed:  # NaN is no agreement
        raise CheckError(f"{what}: answers differ by {worst:.3g}, allowed {allowed:.3g}", f"{worst:.2g}")


# What the fresh process runs: argv has the codec file, the file of the queries and that of the answers.
FRESH = """
import sys, torch
from safetensors.torch import load_file, save_file
from bench.codecs import loading
torch.set_num_threads(1)
queries = load_file(sys.argv[2])
rgb = loading.load(sys.argv[1]).material.query(*(queries[k] for k in ("uv", "wo", "wi", "footprint")))
save_file({"rgb": rgb}, sys.argv[3])
"""


def fresh_process(tested: CodecUnderTest) -> None:
    """a fresh process decodes the file to the same answers, bit for bit"""
    from safetensors.torch import load_file, save_file

    queries_file, answers_file = tested.folder / "queries", tested.folder / "answers"
    save_file(dict(zip(("uv", "wo", "wi", "footprint"), tested.queries, strict=True)), queries_file)
    command = [sys.executable, "-c", FRESH, str(tested.header.path), str(queries_file), str(answers_file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.splitlines() or ["no message"]
        raise CheckError(f"the fresh process failed: {lines[-1]}")
    _require_same("fresh process", load_file(answers_file)["rgb"], tested.answers, tolerance=0.0)


def same_bytes(tested: CodecUnderTest) -> None:
    """the same seed and threads give the same bytes"""
    if tested.encode("b" + container.SUFFIX).sha256 != tested.header.sha256:
        raise CheckError("two fits of the same seed gave different files: draw from fit.generator() or fit.seed alone")


def batches(tested: CodecUnderTest) -> None:
    """one batch answers as many small ones do"""
    uv, wo, wi, footprint = tested.queries
    pieces = []
    for start in range(0, QUERIES, 7):
        rows = slice(start, start + 7)
        pieces.append(tested.material.query(uv[rows], wo[rows], wi[rows], footprint[rows]))
    _require_same("batches of 7", torch.cat(pieces), tested.answers, ROUNDING)
    if tested.material.query(uv[:0], wo[:0], wi[:0], footprint[:0]).shape != (0, 3):
        raise CheckError("an empty batch must give (0, 3)")


def order(tested: CodecUnderTest) -> None:
    """the order of queries does not matter"""
    backward = [column.flip(0) for column in tested.queries]  # uv, ω_o, ω_i, footprint: the last query comes first
    _require_same("reversed", tested.material.query(*backward).flip(0), tested.answers, ROUNDING)


def wraps(tested: CodecUnderTest) -> None:
    """uv is periodic"""
    # Quarters of a texel are exact in float32 a few periods out, so the answers may differ by rounding alone.
    uv, wo, wi, footprint = tested.queries
    exact = (uv * 32).round() / 32
    periods_away = tested.material.query(exact + torch.tensor([2.0, -3.0]), wo, wi, footprint)
    _require_same("uv + (2, −3)", periods_away, tested.material.query(exact, wo, wi, footprint), ROUNDING)


def refuses(tested: CodecUnderTest) -> None:
    """a query that is not finite is refused, and the row is named"""
    uv, wo, wi, footprint = (column.clone() for column in tested.queries)
    wo[123, 1] = float("nan")  # any row in the middle of the batch
    try:
        tested.material.query(uv, wo, wi, footprint)
    except InputError as error:
        if "row 123" not in str(error):
            raise CheckError(f"the error does not name the row: {error}") from error
        return
    raise CheckError("a direction of NaN was answered")


def counted(tested: CodecUnderTest) -> str | None:
    """declared parameters, channels and numbers in textures are those that are counted"""
    _, parts = container.read_parts(tested.header.path)
    fault = counting.fault(tested.material, parts)
    if fault:
        raise CheckError(fault)
    constant = counting.constant_bytes(parts)
    if not constant:
        return None
    what = ", ".join(f"{name} ({size:,} bytes)" for name, size in constant.items())
    return f"the file stores one number many times: {what}"


def leaves_the_process(tested: CodecUnderTest) -> None:
    """encoding leaves the process as it was: the working directory, and no thread that runs on"""
    before = set(threading.enumerate())
    tested.encode("c" + container.SUFFIX)
    if tested.moved_to:
        raise CheckError(f"encode changes the working directory to {tested.moved_to}: give paths instead")
    # Python waits at its end for threads that are no daemons.
    running = [thread.name for thread in threading.enumerate() if thread not in before and not thread.daemon]
    if running:
        raise CheckError(f"encode leaves {', '.join(running)} running: end each thread, or make it a daemon")


def follows_data(tested: CodecUnderTest) -> None:
    """it follows the data: nearer to the training slices than their one mean colour"""
    btf = tested.btf
    truth = torch.from_numpy(np.stack(list(btf)))
    pairs = zip(btf.wo.tolist(), btf.wi.tolist(), strict=True)
    decoded = torch.stack([tested.material.slice(wo, wi) for wo, wi in pairs])
    error = ((decoded - truth) ** 2).mean().item()
    floor = truth.var(dim=(0, 1, 2), correction=0).mean().item()  # the error of one mean colour for all
    if not error < floor:
        fault = f"mean squared error {error:.3g} is no less than that of one constant colour, {floor:.3g}"
        raise CheckError(fault + more_steps(tested.codec))


def more_steps(codec: Codec) -> str:
    """What to try for a codec that is fitted in steps, of which `check` takes few; "" for any other."""
    steps = settings_dict(codec).get("steps")
    if steps is None:
        return ""
    return f"; this fit had {steps:,} steps: if the codec learns slowly, give more by --set steps={10 * steps}"


def fades(tested: CodecUnderTest) -> None:
    """its answers fade as the light sets"""
    uv, wo, wi, footprint = tested.queries
    azimuth = wi[:, :2] / torch.linalg.vector_norm(wi[:, :2], dim=1, keepdim=True)
    grazing = torch.tensor(GRAZING)
    low = torch.cat([azimuth * grazing.sin(), grazing.cos().expand(len(uv), 1)], 1)
    high = torch.tensor([0.0, 0.0, 1.0]).expand(len(uv), 3)
    ours = tested.material.query(uv, wo, low, footprint).mean().item()
    most = MOST_LEFT * tested.material.query(uv, wo, high, footprint).mean().item()
    if not ours <= most:
        raise CheckError(f"with the light at 89.9° its mean answer is {ours:.3g}, more than the allowed {most:.3g}")


def slices(tested: CodecUnderTest) -> None:
    """a slice holds the answers at its texel centres, row 0 on top"""
    height, width = tested.material.size
    if (height, width) != tested.btf.shape:
        raise CheckError(f"size is {(height, width)}, the BTF's is {tested.btf.shape}")
    wo, wi = tested.btf.wo[5], tested.btf.wi[5]  # any pair that is not the first
    uv = texel_centres(height, width)
    view = torch.from_numpy(wo).expand(len(uv), 3)
    light = torch.from_numpy(wi).expand(len(uv), 3)
    answers = tested.material.query(uv, view, light, 1 / max(height, width))
    picture = answers.reshape(height, width, 3)
    _require_same("slice", tested.material.slice(wo.tolist(), wi.tolist()), picture, tolerance=0.0)


def encodes(tested: CodecUnderTest) -> None:
    """it encodes, and its file decodes and answers"""
    answers = tested.answers
    if answers.shape != (QUERIES, 3):
        raise CheckError(f"{QUERIES} queries must give ({QUERIES}, 3), not {tuple(answers.shape)}")


def repeats(tested: CodecUnderTest) -> None:
    """the same queries get the same answers"""
    worst, allowed = _difference(tested.material.query(*tested.queries), tested.answers, ROUNDING)
    if not worst <= allowed:
        what = f"other answers to the same queries (they differ by {worst:.2g})"
        raise answered(tested.material.evaluate, what, "the same answer (a decoder draws no random numbers)")


def on_a_gpu(tested: CodecUnderTest) -> None:
    """it encodes, decodes and answers on a GPU (an emulated one), as on the CPU"""
    if tested.material.opaque:
        raise NotApplicable("another program answers")
    codec = _in_few_steps(tested.codec)
    path = tested.folder / f"gpu{container.SUFFIX}"
    queries = [column[:64] for column in tested.queries]
    try:
        with emulated.emulated() as device, torch_threads(1):
            fit_to_file(codec, tested.btf, Fit(seed=1, network=tested.network, device=device), path)
            _, parts = container.read_parts(path)
            material = loading.decoded(codec, replace(parts, network=tested.network), device)
            answers = _answers_on(device, material, codec, queries)
            material.slice(tested.btf.wo[0].tolist(), tested.btf.wi[0].tolist())
    except emulated.NoEmulationError as error:
        raise NotApplicable(str(error)) from error
    except RuntimeError as error:
        _refuse_tensor_of_cpu(error, codec)
        raise
    on_the_cpu = loading.load(path, network=tested.network).material
    _require_same("on the GPU", answers, on_the_cpu.query(*queries), ROUNDING)


def _in_few_steps(codec: Codec) -> Codec:
    """The codec with 4 steps of its fit, if it has any: they run all code of a fit, and an emulated GPU is slow."""
    settings = settings_dict(codec)
    if "steps" in settings:
        settings["steps"] = 4
    return type(codec)(**settings)


def _refuse_tensor_of_cpu(error: RuntimeError, codec: Codec) -> None:
    """Raise a `CheckError` that names the CPU's tensor which caused an error, if a line of the codec has one."""
    frames = list(own_frames(error, codec))
    if emulated.DIFFERENT not in str(error).lower() or not frames:
        return
    innermost, line = frames[-1]
    left = ", ".join(f"`{name}`" for name in emulated.left_in(innermost, line))
    if left:
        remedy = "move it by .to(fit.device), in a material by .to(wi.device)"
        raise CheckError(f"{left} on the CPU: {remedy} ({error_in_words(error, codec)})") from error


def _answers_on(device: torch.device, material: Material, codec: Codec, queries: list[Tensor]) -> Tensor:
    """The answers of a material on a device, or a `CheckError` that names what its decoder leaves on the CPU."""
    left = ", ".join(f"`{name}`" for name in emulated.left_behind(material))
    if not is_gpu(material.device):
        what = f"leaves {left} on the CPU" if left else "does not tell its material that it is on a GPU"
        raise CheckError(f"your decoder {what}: return `material.to(device)`")
    try:
        return material.query(*(column.to(device) for column in queries)).cpu()
    except RuntimeError as error:
        if not left:
            raise
        raise CheckError(f"your decoder leaves {left} on the CPU ({error_in_words(error, codec)})") from error


def framed(tested: CodecUnderTest) -> str | None:
    """frame, order of channels and directions, and units are those of the truth"""
    answers = tested.frame_answers
    for words, mistake in answers.suspicions():
        if tested.answers_given(mistake.undone).error() < frame.PROVEN * answers.error():
            raise CheckError(words)
    undecided = answers.undecided()
    if not undecided:
        return None
    count = f"{len(undecided)} mistake{'s' if len(undecided) > 1 else ''}"
    return f"{count} cannot be told from its answers, which would be the same {'; '.join(undecided)}"


Check = Callable[[CodecUnderTest], str | None]  # raises on failure; returns a note or None
STAGES: tuple[tuple[Check, ...], ...] = (  # each needs those before it
    (encodes,),
    (repeats,),
    (follows_data, fades, slices),
    (framed, same_bytes, fresh_process, leaves_the_process, batches, order, wraps, refuses, counted, on_a_gpu),
)
