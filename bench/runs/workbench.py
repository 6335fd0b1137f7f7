"""Opens a material of a run once per process, and holds what its jobs share: split, exposure, scorer."""

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import torch

from bench.btf import BTF, Split
from bench.codec import Progress
from bench.data.kinds import kind_of
from bench.data.open import open_material
from bench.data.readers.checks import refuse_extremes
from bench.data.spec import MaterialSpec, Preparation
from bench.demand.demand import Demand
from bench.demand.demand import load as load_demand
from bench.demand.frame_scorer import FrameScorer, table_of
from bench.demand.mitsuba import load_path_tracer
from bench.demand.needed_part import pair_shares, shares_of_others
from bench.directions.hemisphere import to_degrees
from bench.directions.interpolation import PairInterpolator
from bench.inputs.errors import InputError
from bench.metrics import DEFAULTS, chosen_names
from bench.metrics.display import Exposed, exposed
from bench.metrics.scoring import Scorer
from bench.records import LOW_LIGHT, OUTSIDE, VALIDATION, deciding_group

log = logging.getLogger(__name__)
MOST_STORED = 16  # how many slices are stored as pictures, for the slice viewer of a report
CELL_DEG = 7.5  # a side of the cells of θ_o and θ_i in which pairs count as equally grazing
SHEET_ANGLES = ((10, 40), (40, 20), (68, 30), (30, 68))  # (θ_o, θ_i) in degrees of the slices that contact sheets show


@dataclass(frozen=True)
class Opening:
    """What a workbench is opened from: a material of a run, how it is prepared, and what scores it."""

    run: str  # its name: another run opens the material, and reads the demand, anew
    material: MaterialSpec
    data: Preparation
    metrics: tuple[str, ...] = DEFAULTS  # as a suite names them
    demand: str = ""  # the file of a scene's demand
    scorers: int | None = None  # threads that score; None: one a core


@dataclass
class Workbench:
    """An open material with everything its jobs share. A pair is known by its index in the BTF."""

    btf: BTF
    name: str  # as the suite calls the material
    scorers: int | None = None  # threads that score; None: one a core
    demand: Demand | None = None  # of a scene to score in
    most_scored: int = 0  # the most training pairs, and pairs of held-out views and lights, that are scored; 0: all
    metrics: tuple[str, ...] = DEFAULTS  # as a suite names them
    split: Split = field(init=False)

    def __post_init__(self) -> None:
        """Split the pairs. `InputError` if none is left for training, or if their values are too extreme."""
        self.split = self.btf.split()
        if not len(self.split.train):
            raise InputError(f"{self.name}: no training pairs are left: hold out fewer")
        refuse_extremes(self.training)

    @cached_property
    def training(self) -> BTF:
        """The part of the BTF that codecs are fitted to."""
        return self.btf.subset(self.split.train)

    @cached_property
    def scorer(self) -> Scorer:
        """What scores slices against the BTF by the chosen metrics, at one exposure."""
        # The training pairs set the exposure, so a material has the same one for any draw of test pairs.
        names = chosen_names(self.metrics, self.btf.periodic)
        return Scorer(self.btf, names, threads=self.scorers, sampled=self.training)

    @cached_property
    def frame_scorer(self) -> FrameScorer | None:
        """The scorer of the scene's frames; None without a demand."""
        return None if self.demand is None else FrameScorer(table_of(self.btf), self.demand)

    @cached_property
    def scene_shares(self) -> np.ndarray | None:
        """The share (N,) of each pair in the scene's demand, 0 for those of low light; None without a demand."""
        if self.demand is None:
            return None
        shares = np.zeros(len(self.btf))
        usual = np.delete(np.arange(len(self.btf)), self.split.low_light)
        shares[usual] = pair_shares(self.btf.without_low_light().layout, self.demand)
        return shares

    @cached_property
    def heldout_shares(self) -> np.ndarray | None:
        """The demand (N,) around each held-out pair, 0 at other pairs.

        None without a demand, without held-out pairs, or where the scene comes near none of them.
        """
        pairs = self.groups.get("heldout")
        if self.demand is None or pairs is None:
            return None
        shares = np.zeros(len(self.btf))
        directions = self.btf.wo[pairs], self.btf.wi[pairs]
        shares[pairs] = shares_of_others(self.training.layout, self.demand, *directions)
        if not shares.any():
            return None
        return shares

    @property
    def exposure(self) -> float:
        """The factor that brings radiance into the range of a display."""
        return self.scorer.exposure

    @cached_property
    def exposed(self) -> Exposed:
        """How well the exposure shows the slices that decide."""
        return exposed((self.btf[int(pair)] for pair in self.deciding), self.exposure)

    @cached_property
    def at_centres(self) -> np.ndarray:
        """The held-out pairs (n,) that `BTF.between` has between texels, in its order; none without it."""
        if self.btf.between is None:
            return np.empty(0, int)
        heldout = self.groups["heldout"]
        pairs_there = _as_points(self.btf.wo[heldout], self.btf.wi[heldout])
        pairs_between = _as_points(self.btf.between.wo, self.btf.between.wi)
        cosines = pairs_there @ pairs_between.T  # the sum of two: of the views, and of the lights
        return heldout[cosines.argmax(0)]  # it is largest where both are equal

    @cached_property
    def groups(self) -> dict[str, np.ndarray]:
        """The indices of the pairs of each group, by the name under which reports show it. Empty groups are left out.

        Pairs of low light are in their own group alone.
        """
        everything = np.delete(np.arange(len(self.btf)), self.split.low_light)
        heldout = np.sort(np.concatenate([np.empty(0, int), *self.split.heldout.values()])).astype(int)
        groups = {"all": everything, "train": self.split.train, "heldout": heldout}
        if len(self.split.heldout) > 1:  # views, lights or pairs of both were held out, each a group of its own
            groups |= {f"heldout, {name}": pairs for name, pairs in self.split.heldout.items()}
        if len(heldout):
            groups |= self._groups_by_hull(heldout)
        groups[VALIDATION] = self.split.validation
        if self.scene_shares is not None:
            groups[OUTSIDE] = everything[self.scene_shares[everything] == 0]
        groups[LOW_LIGHT] = self.split.low_light
        return {name: pairs for name, pairs in groups.items() if len(pairs)}

    def _groups_by_hull(self, heldout: np.ndarray) -> dict[str, np.ndarray]:
        """The held-out pairs (n,) inside the hull, where training pairs lie around them in each direction, and those
        outside, where a decoder must extrapolate: as many inside as outside, at about the same θ_o and θ_i."""
        wo = torch.from_numpy(self.btf.wo[heldout])
        wi = torch.from_numpy(self.btf.wi[heldout])
        is_outside = PairInterpolator(self.training.layout).outside(wo, wi).numpy()
        inside, outside = self._at_equal_angles(heldout[~is_outside], heldout[is_outside])
        return {"heldout, inside hull": inside, "heldout, outside hull": outside}

    def _at_equal_angles(self, inside: np.ndarray, outside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As many pairs inside a hull (n,) as outside (m,) in every cell of `CELL_DEG` over θ_o and θ_i.

        Directions outside a hull are mostly grazing, where all codecs are worse; so only the hull makes a difference.
        """
        theta_o, _ = to_degrees(self.btf.wo)
        theta_i, _ = to_degrees(self.btf.wi)
        cell = 1000 * (theta_o // CELL_DEG) + theta_i // CELL_DEG  # (N,), a number for each
        kept_inside = [np.empty(0, int)]
        kept_outside = [np.empty(0, int)]
        for common in np.intersect1d(cell[inside], cell[outside]):
            inside_in_cell = inside[cell[inside] == common]
            outside_in_cell = outside[cell[outside] == common]
            count = min(len(inside_in_cell), len(outside_in_cell))
            kept_inside.append(_evenly_among(inside_in_cell, count))
            kept_outside.append(_evenly_among(outside_in_cell, count))
        return np.sort(np.concatenate(kept_inside)), np.sort(np.concatenate(kept_outside))

    @cached_property
    def scored(self) -> np.ndarray:
        """The pairs that are scored, ascending: all, or the held-out ones and a fixed draw of the training pairs.

        Held-out pairs that were drawn or declared are all scored. Held-out views and lights of a measurement have
        thousands of pairs, of which a fixed draw is scored. With a scene's demand, which weights all pairs, all are
        scored. Pairs of low light are not among them: they are scored apart.
        """
        if self.demand or not self.most_scored:
            return self.groups["all"]
        scored_of_groups = []
        for name in ("train", "heldout", VALIDATION):
            pairs = self.groups.get(name, np.empty(0, int))
            # The BTF's `heldout` is set where test pairs were drawn or declared.
            may_be_thinned = name == "train" or self.btf.heldout is None
            if len(pairs) > self.most_scored and may_be_thinned:
                pairs = np.random.default_rng(0).choice(pairs, self.most_scored, replace=False)
            scored_of_groups.append(pairs)
        return np.unique(np.concatenate(scored_of_groups))

    @cached_property
    def sheet(self) -> np.ndarray:
        """The few pairs (n,) that a contact sheet shows: of those that decide, the nearest to each of
        `SHEET_ANGLES`."""
        theta_o, _ = to_degrees(self.btf.wo[self.deciding])
        theta_i, _ = to_degrees(self.btf.wi[self.deciding])
        angles = np.stack([theta_o, theta_i], 1)  # (pairs that decide, 2)
        nearest = []  # the place of a pair among those that decide, for each of the wanted angles
        for wanted in np.array(SHEET_ANGLES):
            distances = np.linalg.norm(angles - wanted, axis=1)
            nearest.append(int(distances.argmin()))
        return self.deciding[np.unique(nearest)]

    @cached_property
    def shown(self) -> np.ndarray:
        """The pairs (n,) whose slices are stored as pictures: those of `sheet`, then in each step the one that is
        farthest from all before, up to `MOST_STORED`."""
        points = _as_points(self.btf.wo[self.deciding], self.btf.wi[self.deciding])
        chosen = np.flatnonzero(np.isin(self.deciding, self.sheet)).tolist()  # numbers of points
        distance = np.linalg.norm(points[:, None] - points[chosen], axis=2).min(1)  # to the nearest chosen one
        while len(chosen) < min(MOST_STORED, len(points)):
            farthest = int(distance.argmax())
            chosen.append(farthest)
            distance = np.minimum(distance, np.linalg.norm(points - points[farthest], axis=1))
        return np.sort(self.deciding[np.unique(chosen)])

    @cached_property
    def deciding(self) -> np.ndarray:
        """The pairs that decide a comparison: the scored held-out pairs, or all pairs if none are held out."""
        return np.intersect1d(self.scored, self.groups[deciding_group(self.groups)])


def _as_points(wo: np.ndarray, wi: np.ndarray) -> np.ndarray:
    """Pairs of directions, (n, 3) each, as points (n, 6)."""
    return np.concatenate([wo, wi], 1)


def _evenly_among(pairs: np.ndarray, count: int) -> np.ndarray:
    """So many of some pairs (n,), evenly spread over their order."""
    places = np.linspace(0, len(pairs) - 1, count).round().astype(int)
    return pairs[places]


FEW_PAIRS = 5  # fewer that decide say little of a material, and a warning says so
_latest: dict[object, Workbench] = {}  # the last one that was opened, no more: a scorer keeps hundreds of megabytes
_ONE_AT_A_TIME = threading.Lock()  # threads of a process share PyTorch's thread count and the open material


@lru_cache(maxsize=1)
def demand_of(run: str, path: str) -> Demand:
    """The demand in a file, read once per process and `run`, its name. `InputError` if the file is not a demand."""
    return load_demand(Path(path))


@contextmanager
def open_workbench(what: Opening, show: Progress) -> Iterator[Workbench]:
    """The workbench of a material, for one thread at a time; consecutive jobs on one material share it."""
    with _ONE_AT_A_TIME:
        if what not in _latest:
            _latest.clear()
            workbench = _new_workbench(what, show)
            _warn_of_faults(workbench, what.material)
            _latest[what] = workbench
        yield _latest[what]


def _new_workbench(what: Opening, show: Progress) -> Workbench:
    """A new workbench."""
    demand = demand_of(what.run, what.demand) if what.demand else None
    btf = open_material(what.material, what.data, show, 0, load_path_tracer)  # every run has the first draw
    if what.data.texels:
        btf.gather([0], [0], [0])  # writes the scratch file, if there is one, so that no fit's time includes it
    return Workbench(btf, what.material.name, what.scorers, demand, what.data.scored, what.metrics)


def _warn_of_faults(workbench: Workbench, material: MaterialSpec) -> None:
    """Warn of a material that its exposure shows badly, and of one with fewer than `FEW_PAIRS` that decide."""
    if workbench.exposed.fault:
        log.warning("%s: %s", material.name, workbench.exposed.fault)
    if len(workbench.deciding) < FEW_PAIRS:
        heldout_is_ignored = kind_of(material).ignores(material, "data.heldout")
        setting = "data.holdout" if heldout_is_ignored else "data.heldout"
        few = "%s: %d pair(s) decide: mark more as held out, or raise %s"
        log.warning(few, material.name, len(workbench.deciding), setting)
