"""Fits codecs to a scene: to the part of the BTF in its demand, weighted by the demand, at the smallest size.

A scene model is a codec file fitted to a demand, the full model one fitted to the whole BTF. Codecs need no code for
this: they get a smaller BTF, and a `Fit` with a density, from which queries are drawn.
"""

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bench import timing
from bench.btf import BTF, Layout
from bench.codec import SCENE, Codec, Density, Fit, Parts, settings_dict
from bench.codecs import container, loading
from bench.codecs.container import Header
from bench.codecs.encoding import Encode, fit_to_file, naming_faults
from bench.codecs.scene_material import without_warnings
from bench.codecs.window import Window
from bench.demand import UNIFORM, require_demand
from bench.demand.demand import Demand
from bench.demand.frame_scorer import FLIP, PSNR, FrameScorer
from bench.demand.needed_part import NeededPart, pair_weights, shares_from_weights, shares_of_others
from bench.directions.interpolation import cosines
from bench.material import Material
from bench.metrics.angular import as_number
from bench.metrics.display import display_error, exposure
from bench.metrics.psnr import psnr
from bench.records import MOST_DB, SceneModel

EQUAL_DB = 0.2  # a scene model within this many dB of the full one counts as equally good
OUTSIDE_PAIRS = 48  # how many pairs, at most, measure the error outside the scene


@dataclass(frozen=True)
class Problem:
    """The input of a fit to a scene: the needed part of the BTF, the demand's density, and facts for the file."""

    needed: NeededPart
    btf: BTF
    density: Density
    facts: dict[str, Any]

    @classmethod
    def for_codec(cls, codec: Codec, btf: BTF, demand: Demand, uniform: float = UNIFORM) -> "Problem":
        """The problem of one codec, whatever its sizes; `uniform` is as in `density_of`."""
        needed = NeededPart.for_demand(btf, demand, every_pair=not codec.interpolates)
        cut = needed.cut(btf)
        density = density_of(demand, cut.layout, needed.window, uniform)
        return cls(needed, cut, density, needed.facts(demand) | {"uniform": uniform})

    def encode(self, codec: Codec, fit: Fit) -> Parts:
        """Fit the codec; returns the encoded parts."""
        parts = codec.encode(self.btf, dataclasses.replace(fit, density=self.density))
        return dataclasses.replace(parts, scene=self.facts)


def density_of(demand: Demand, layout: Layout, window: Window, uniform: float) -> Density:
    """The density of a demand of n queries over the pairs of a BTF cut to a window; see `Density` for its fields.

    `uniform` is the share of samples that is spread evenly.
    """
    # The k pairs around each query: `around.sample` are their numbers and `around.weight` their weights, (n, k) each.
    around = pair_weights(layout, demand)
    importance = demand.importance
    wi = torch.from_numpy(demand.wi)
    uv_of_texture = torch.from_numpy(demand.uv(window.size)).double()  # exact enough to be cut to a small window
    uv = window.within(uv_of_texture).float()
    footprint = torch.from_numpy(demand.footprint) * window.stretch
    cumulative = torch.from_numpy(importance).cumsum(0)
    # Radiance contains the cosine of its light. That of each pair's light (n, k) gives way to that of the query's.
    weight = around.weight * wi[:, 2:] / cosines(layout)[around.sample.long()]
    share = torch.from_numpy(shares_from_weights(around, importance, len(layout.view)))
    return Density(
        uv=uv,
        footprint=footprint,
        wo=torch.from_numpy(demand.wo),
        wi=wi,
        cumulative=cumulative,
        pair=around.sample,
        weight=weight,
        per_pair=share,
        uniform=uniform,
    )


def encode_of(codec: Codec, demand: Demand | None, uniform: float = UNIFORM) -> Encode:
    """What makes the parts of a codec's file: a fit to the demand if its settings ask for a scene, else its own
    `encode`. `uniform` is as in `density_of`. `InputError` if they ask for a scene and there is no demand."""
    require_demand(codec, demand)
    if not (codec.scene and demand):
        return codec.encode

    def to_scene(btf: BTF, fit: Fit) -> Parts:
        """Fit the codec to the demand, instead of to all pairs of the BTF."""
        return Problem.for_codec(codec, btf, demand, uniform).encode(codec, fit)

    return to_scene


@dataclass(frozen=True)
class Goal:
    """The goal for the frames of a scene: at least this PSNR in dB, at most this FLIP."""

    psnr: float | None = None
    flip: float | None = None

    def met(self, model: "Model") -> bool:
        """Whether a model reaches the goal; a FLIP of None was not measured."""
        psnr_is_enough = self.psnr is None or model.psnr >= self.psnr
        flip_is_enough = self.flip is None or model.flip is None or model.flip <= self.flip
        return psnr_is_enough and flip_is_enough


@dataclass(frozen=True)
class Model:
    """One fitted codec file and its scores in the scene."""

    header: Header
    material: Material
    psnr: float  # of the frames, in dB, `MOST_DB` without error
    flip: float | None
    steps: int  # steps of the fit; 0 if it has none
    seconds: float  # of the fit, processor time


@dataclass(frozen=True)
class SearchResult:
    """The result of a search: the full model, the scene model or None, and the time of the search."""

    full: Model
    scene: Model | None
    why: str  # why there is no scene model, why it is smaller than the full one, or that both miss the goal
    met: bool  # whether the goal is reached
    fits: int
    seconds: float  # processor time of all fits except the full model's

    @property
    def chosen(self) -> Model:
        """The scene model; the full one if there is none."""
        return self.scene or self.full


@dataclass
class Search:
    """Searches for the smallest model of a codec that is as good in a scene as the full one, or reaches a goal."""

    codec: Codec
    btf: BTF  # training pairs
    scorer: FrameScorer
    fit: Callable[[], Fit]  # a fresh one for each fit
    folder: Path  # for the files of the search
    uniform: float = UNIFORM  # share of samples that is spread evenly

    @cached_property
    def problem(self) -> Problem:
        """The input of every fit to the scene."""
        return Problem.for_codec(self.codec, self.btf, self.scorer.demand, self.uniform)

    def run(self, goal: Goal | None = None) -> SearchResult:
        """Search; the default goal is the PSNR of the full model less `EQUAL_DB`."""
        full = self.model(sized(self.codec, size_count(self.codec), scene=False), "full")
        goal = goal or Goal(psnr=full.psnr - EQUAL_DB)
        models = list(self.ladder(goal))
        seconds = sum(model.seconds for model in models)
        scene, why = self._best_of(models, full, goal)
        return SearchResult(full, scene, why, goal.met(scene or full), len(models), seconds)

    def _best_of(self, models: list[Model], full: Model, goal: Goal) -> tuple[Model | None, str]:
        """The scene model to use, None if the full one is the better choice, and why; see `SearchResult`."""
        full_meets = goal.met(full)
        meeting = [model for model in models if goal.met(model)]
        if meeting:
            smallest = min(meeting, key=lambda model: model.header.file_bytes)
            if full_meets and smallest.header.file_bytes >= full.header.file_bytes:
                return None, "the scene needs everything"
            return smallest, what_is_needed(self.problem.needed, self.btf)
        if full_meets:
            return None, "no model of the scene is as good"
        # Both miss the goal, so the better of the two is chosen.
        finest = max(models, key=lambda model: model.psnr)
        return finest if finest.psnr > full.psnr else None, "no model reaches the goal"

    def ladder(self, goal: Goal) -> Iterator[Model]:
        """Fit models of the scene, and yield each.

        Quality rises with size, so the smallest size that meets the goal is found by bisection. If the largest misses
        the goal, it is the only one.
        """
        low, high = 1, size_count(self.codec)  # the smallest size that meets the goal lies between, both included
        largest = self.model(sized(self.codec, high), f"scene{high}")
        yield largest
        if not goal.met(largest):
            return
        while low < high:
            middle = (low + high) // 2
            model = self.model(sized(self.codec, middle), f"scene{middle}")
            yield model
            if goal.met(model):
                high = middle
            else:
                low = middle + 1

    def model(self, codec: Codec, name: str) -> Model:
        """Fit a codec, to the scene if its settings say so, else to the BTF; decode and score its file, `name`."""
        fit = self.fit()
        path = self.folder / f"{name}{container.SUFFIX}"

        def to_scene(_: BTF, fit: Fit) -> Parts:
            """Fit the codec to the scene; the BTF is that of the problem, which is cut already."""
            return self.problem.encode(codec, fit)  # the same problem for every size

        how = naming_faults(codec, to_scene if codec.scene else codec.encode)
        header, seconds = fit_to_file(codec, self.btf, fit, path, how)
        material = without_warnings(loading.load(header.path, fit.device).material)
        score = self.scorer.score(material, (PSNR, FLIP))
        psnr_of_frames = score[PSNR]
        assert psnr_of_frames is not None  # its window is one pixel, and a demand sees some
        steps = int(fit.history[-1]["step"]) if fit.history else 0
        return Model(header, material, psnr_of_frames, score.get(FLIP), steps, seconds)


def size_count(codec: Codec) -> int:
    """The number of sizes that a codec can have: the value of its leading setting of size, 1 if it has no such one."""
    return int(getattr(codec.settings, codec.sizes[0])) if codec.sizes else 1


def sized(codec: Codec, size: int, scene: bool = True) -> Codec:
    """The codec, to be fitted to a scene or not, with its leading size at `size` and the others in proportion."""
    share = size / size_count(codec)
    sizes = {}
    for name in codec.sizes:
        sizes[name] = max(1, round(share * getattr(codec.settings, name)))
    return type(codec)(**(settings_dict(codec) | sizes | {SCENE: scene}))


def what_is_needed(needed: NeededPart, btf: BTF) -> str:
    """Say in words how much of a BTF a demand needs, as the reason why the model of the scene is smaller."""
    words = []
    window = needed.window
    if not window.full:
        words.append(f"{window.height} × {window.width} of {btf.shape[0]} × {btf.shape[1]} texels are seen")
    if window.factor > 1:
        words.append(f"nothing finer than boxes of {window.factor} × {window.factor} texels is seen")
    if len(needed.pairs) < len(btf):
        words.append(f"{len(needed.pairs):,} of {len(btf):,} pairs lie around its directions")
    if not words:  # the demand needs all of the BTF: a smaller network and texture were good enough
        return "only its size"
    return "; ".join(words)


def psnr_outside(scorer: FrameScorer, material: Material) -> float | None:
    """Display PSNR in dB, pooled, of slices at pairs that the scene does not use, against the BTF; None if it uses all,
    or without error. Measured at `OUTSIDE_PAIRS` pairs, evenly among them."""
    untouched = np.flatnonzero(scorer.shares == 0)
    if not len(untouched):
        return None
    places = np.linspace(0, len(untouched) - 1, min(OUTSIDE_PAIRS, len(untouched)))
    measured = untouched[places.astype(int)]
    scale = exposure(scorer.btf)
    errors = [_slice_error(scorer.btf, int(pair), material, scale) for pair in measured]
    return as_number(float(psnr(float(np.mean(errors)), peak=1.0)))


def psnr_held_out(btf: BTF, scorer: FrameScorer, material: Material) -> float | None:
    """The mean display PSNR in dB of slices at the held-out pairs that lie in the scene, weighted by the demand around
    them; None if there is none. A slice counts as `MOST_DB` at most, also without error. `btf` has held-out pairs
    alone. No fit saw them, unlike the pairs of the frames."""
    shares = shares_of_others(scorer.btf.layout, scorer.demand, btf.wo, btf.wi)
    if not shares.any():
        return None
    used = np.flatnonzero(shares)  # the held-out pairs that lie in the scene
    scale = exposure(scorer.btf)
    values = []
    for pair in used:
        error = _slice_error(btf, int(pair), material, scale)
        values.append(min(MOST_DB, float(psnr(error, peak=1.0))))
    return float(np.average(values, weights=shares[used]))


def _slice_error(btf: BTF, pair: int, material: Material, scale: float) -> float:
    """The display error of a material's slice at one pair of a BTF, at the exposure `scale`."""
    decoded = material.slice(btf.wo[pair].tolist(), btf.wi[pair].tolist(), btf.shape).cpu().numpy()
    return display_error(btf[pair], decoded, scale)


def rows(result: SearchResult, scorer: FrameScorer, threads: int, held: BTF) -> list[SceneModel]:
    """The costs and scores of the full model and the scene model, each as named numbers. `held` are the held-out pairs.
    Times are of whole queries of the scene in random order, the models in turns."""
    models = {"full": result.full}
    if result.scene:
        models["scene"] = result.scene
    order = np.random.default_rng(0).permutation(len(scorer.demand))[: timing.BATCH]
    device = result.full.material.device
    size = result.full.material.size
    queries = [torch.from_numpy(column[order]).to(device) for column in scorer.demand.queries(size)]
    calls = {name: partial(model.material.query, *queries) for name, model in models.items()}
    timings = timing.in_turns(calls, len(order), size, threads, device)
    table: list[SceneModel] = []
    for name, model in models.items():
        table.append(
            {
                "model": name,
                "bytes": model.header.file_bytes,
                "ns": timings[name].summary()["ns_per_sample"],
                "steps": model.steps,
                "seconds": model.seconds,
                "psnr": model.psnr,
                "flip": model.flip,
                "outside": psnr_outside(scorer, model.material),
                "held_out": psnr_held_out(held, scorer, model.material),
                "settings": model.header.settings,
            }
        )
    return table
