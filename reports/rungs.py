"""The rungs of a run, the curves that they make, and what is read off these: numbers for tables and figures.

A *budget* is a limit on the bytes of a file, on the time of a query or on the time of a fit. Rungs are chosen by
validation pairs, and shown with their scores at test pairs. The *curve* of a line on a surface joins its rungs on the
upper convex hull of validation PSNR over log bytes; from the best rung it goes on level to the largest that was
measured, because a larger limit allows the smaller file, too. It is never extrapolated. docs/metrics.md has the rules.

Tables of lines have a row a line and a column a surface, with NaN where a line has no value.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from bench.compare.choosing import has_validation, validation_of
from bench.compare.frame import EAGER, FUSED, frame_of
from bench.compare.paired import AGAINST
from bench.compare.statistics import (
    Curve,
    at,
    bd_psnr,
    chance_if_equal,
    interval_over_surfaces,
    told_by_holm,
    upper_hull,
)
from bench.metrics import stats_of
from bench.records import FLIP, PSNR, SSIM, Job, Records, Run, fitted_to_scene, grouped, kind_order, view
from reports.numbers import as_read

BITS = (4, 8, 16, 32, 64, 128)  # bits of the whole file a texel
TIMES = (2, 4, 8, 16, 32)  # time of a query, × floor
SECONDS = (10, 100, 1000)  # of a processor, of a fit
BYTES, FIT = "bytes", "fit"  # kinds of budgets, beside those of times of a query
LEAST_RUNGS = 3  # of a codec on a surface, or it has no curve there
LEAST_SURFACES = 10  # below which no lead is told apart
DRAWS = 200  # how often seeds are drawn, of rungs that have several
FOOTPRINTS = ("1", "2", "4", "8")  # texels a side of a pixel, as records name them
# The budgets of each kind of time, which ascend.
_OF_TIME: dict[str, tuple[int, ...]] = {EAGER: TIMES, FUSED: TIMES, FIT: SECONDS}
# The columns of a rung's scores at test pairs, means over slices, and the family of metrics of each.
_TEST = {"psnr": PSNR, "ssim": SSIM, "flip": FLIP}
_SCORES = ["validation", *_TEST, *FOOTPRINTS]
_COSTS = ["total", "resident", EAGER, FUSED, FIT]


class Budget(NamedTuple):
    """A limit: bits a texel (`bytes`), a query's time, × floor (`eager`, `fused`), or processor seconds of a `fit`."""

    kind: str
    most: float

    @property
    def column(self) -> str:
        """The column of `Rungs.frame` that it limits."""
        return "bits" if self.kind == BYTES else self.kind


ENOUGH = Budget(BYTES, 32)  # the budget of ranks, and for questions about a single material or metric


class Hull(NamedTuple):
    """A curve by its rungs: log2 of bits a texel, which ascend, and the rungs by number; where it goes on level at its
    end, the last stands twice."""

    sizes: list[float]
    rungs: list[int]

    @property
    def once(self) -> list[int]:
        """Its rungs, each once."""
        return list(dict.fromkeys(self.rungs))


class _Places(NamedTuple):
    """Which line, setting and surface each rung is of, as numbers (rungs,); and the names of lines and surfaces."""

    line: np.ndarray
    setting: np.ndarray
    surface: np.ndarray
    lines: list[str]
    surfaces: list[str]


class Summary(NamedTuple):
    """A difference over surfaces: its median with a 95 % interval, and on how many it is above 0."""

    median: float
    won: int
    surfaces: int
    low: float
    high: float

    @property
    def apart(self) -> bool:
        """Whether there are enough surfaces, and the interval leaves out 0."""
        return self.surfaces >= LEAST_SURFACES and not self.low <= 0 <= self.high


@dataclass(frozen=True)
class Rungs:
    """The rungs of a run and its curves; `without` and `unlike` are the jobs that are left out.

    `frame` has a row a rung, numbered from 0: `line`, its `codec`, `label`, `setting`, `material`, `job` (of its first
    seed), `height` and `width` in texels, `bits` a texel and means over seeds: `total` bytes and those in memory,
    `resident`; `validation` PSNR, scores at test pairs `psnr`, `ssim`, `flip`, PSNR by footprint `1` to `8`,
    times `eager`, `fused` and `fit`; and `seeds`, the PSNR of each.
    """

    frame: pd.DataFrame
    surfaces: dict[str, str]  # the kind of each material that has a rung at some budget, in the order of records
    shapes: dict[str, tuple[int, int]]  # of each material: height and width in texels
    stale: set[tuple[str, str]]  # lines and materials with numbers that the installed versions cannot make again
    without: list[Job]  # without a score of validation pairs
    unlike: list[Job]  # not comparable with published jobs of their material or, without any, with the newest

    @property
    def times(self) -> list[str]:
        """The kinds of times that were measured."""
        return [kind for kind in _OF_TIME if self.frame[kind].notna().any()]

    @property
    def limits(self) -> list[Budget]:
        """The budgets: those of bytes first, then of each kind of time that was measured; those of a kind ascend."""
        limits = [Budget(BYTES, most) for most in BITS]
        for kind in self.times:
            limits += [Budget(kind, most) for most in _OF_TIME[kind]]
        return limits

    @property
    def kinds(self) -> dict[str, list[str]]:
        """The surfaces by kind, in the order of kinds."""
        by_kind = grouped(self.surfaces, lambda name: self.surfaces[name])
        return {kind: by_kind[kind] for kind in sorted(by_kind, key=kind_order)}

    def over_memory(self) -> "Rungs":
        """The rungs whose bytes in memory are known, with curves over these, as bits a texel."""
        frame = self.frame[self.frame["resident"].notna()].reset_index(drop=True)
        bits = 8 * frame["resident"] / (frame["height"] * frame["width"])
        return replace(self, frame=frame.assign(bits=bits))

    @cached_property
    def hulls(self) -> dict[str, dict[str, Hull]]:
        """By line and surface: its curve, where it has rungs enough."""
        hulls: dict[str, dict[str, Hull]] = {}
        sizes = np.log2(self.frame["bits"]).tolist()
        scores = self.frame["validation"].tolist()
        by_curve: dict[Any, Any] = self.frame.groupby(["line", "material"], sort=False).indices
        for (line, surface), rungs in by_curve.items():
            if len(rungs) < LEAST_RUNGS or surface not in self.surfaces:
                continue
            sizes_of_curve = [sizes[rung] for rung in rungs]
            places = upper_hull(sizes_of_curve, [scores[rung] for rung in rungs])
            hull = Hull([sizes_of_curve[place] for place in places], [int(rungs[place]) for place in places])
            largest = max(sizes_of_curve)
            if largest > hull.sizes[-1]:  # it goes on level
                hull.sizes.append(largest)
                hull.rungs.append(hull.rungs[-1])
            if len(hull.sizes) > 1:  # a single point is no curve
                hulls.setdefault(line, {})[surface] = hull
        return hulls

    @cached_property
    def _seeds(self) -> list[list[float]]:
        """The PSNR of each seed, by number of a rung."""
        return self.frame["seeds"].tolist()

    @cached_property
    def _columns(self) -> dict[str, np.ndarray]:
        """The numbers of all rungs, (rungs,), by name of their column."""
        return {name: self.frame[name].to_numpy(float) for name in ("bits", *_COSTS, *_SCORES)}

    @cached_property
    def _places(self) -> _Places:
        """Which line, setting and surface each rung is of."""
        line, lines = pd.factorize(self.frame["line"])
        surface, surfaces = pd.factorize(self.frame["material"])
        setting = self.frame.groupby(["line", "label"], sort=False).ngroup().to_numpy(int)
        return _Places(line, setting, surface, list(lines), list(surfaces))

    def curve(self, hull: Hull, score: str = "psnr") -> Curve | None:
        """The curve of a score at test pairs; None if one of its rungs was not scored so."""
        values = self._columns[score][hull.rungs]
        return None if np.isnan(values).any() else Curve(hull.sizes, values.tolist())

    def read(self, bits: float, score: str = "psnr", to_end: bool = False) -> pd.DataFrame:
        """A score of lines with curves at a size in bits a texel, by line and surface; NaN beyond a curve.

        With `to_end`, a curve that ends below the size counts by its end: a smaller file meets a larger limit, too.
        """
        size = float(np.log2(bits))
        values: dict[str, dict[str, float | None]] = {line: {} for line in self.hulls}  # then by surface
        for line, by_surface in self.hulls.items():
            for surface, hull in by_surface.items():
                curve = self.curve(hull, score)
                if curve:
                    values[line][surface] = at(curve, min(size, hull.sizes[-1]) if to_end else size)
        return pd.DataFrame([*values.values()], [*values], [*self.surfaces], dtype=float)

    def picks(self, budget: Budget, surfaces: Sequence[str]) -> pd.DataFrame:
        """By line and surface: the number of the best rung by validation pairs that fits the budget, among the settings
        that were measured on all these surfaces.

        Ties go to the smaller file, then to the one that takes less of the budget, then to the first. Lines without
        such a rung on each surface are left out.
        """
        places = self._places
        cost = self._columns[budget.column]
        allowed = self._of_common_settings(surfaces) & (cost <= budget.most)
        # From the best on, so that the first of each line and surface is the one.
        best_first = np.lexsort([cost, self._columns["bits"], -self._columns["validation"]])
        best_first = best_first[allowed[best_first]]
        cell_of_rung = places.line[best_first] * len(places.surfaces) + places.surface[best_first]
        cells, first = np.unique(cell_of_rung, return_index=True)
        table = np.full((len(places.lines), len(places.surfaces)), -1)  # −1: no rung
        table.flat[cells] = best_first[first]
        table = table[:, [places.surfaces.index(name) for name in surfaces]]
        full = np.flatnonzero((table >= 0).all(1))
        return pd.DataFrame(table[full], [places.lines[number] for number in full], [*surfaces])

    def _of_common_settings(self, surfaces: Sequence[str]) -> np.ndarray:
        """Of each rung, (rungs,), whether it is on one of these surfaces, and its setting was measured on all."""
        places = self._places
        is_on_one = np.isin(places.surface, [places.surfaces.index(name) for name in surfaces])
        surfaces_of_setting = np.bincount(places.setting[is_on_one], minlength=len(self.frame))
        is_common: np.ndarray = is_on_one & (surfaces_of_setting[places.setting] == len(surfaces))
        return is_common

    def of_picks(self, picks: pd.DataFrame, score: str = "psnr") -> pd.DataFrame:
        """A column of the rungs that `picks` names, by line and surface."""
        return pd.DataFrame(self.frame[score].to_numpy()[picks.to_numpy(int)], picks.index, picks.columns)

    def reached(self, budget: Budget, surfaces: Sequence[str], score: str = "psnr") -> pd.DataFrame:
        """What lines reach within a budget, by line and surface; without lines that reach nothing on some surface.

        Within a size it is read off curves, up to their ends, so that no step of a ladder decides; within a time, and
        for a line without a curve on each surface, it is that of the rung that is chosen.
        """
        of_rungs = self.of_picks(self.picks(budget, surfaces), score).dropna()
        if budget.kind != BYTES:  # no curve leads from one time to another
            return of_rungs
        of_curves = self.read(budget.most, score, to_end=True)[[*surfaces]].dropna()
        lines = of_rungs.index.union(of_curves.index, sort=False)
        return pd.concat([of_rungs[~of_rungs.index.isin(of_curves.index)], of_curves]).reindex(lines)

    def ranked(self, budget: Budget, surfaces: Sequence[str], score: str = "psnr") -> pd.Series:
        """By line: the median over surfaces of what it reaches within a budget, the best first."""
        return median_over(self.reached(budget, surfaces, score)).sort_values(ascending=score == "flip", kind="stable")

    def readings(self, budget: Budget, surfaces: Sequence[str]) -> pd.DataFrame:
        """By line: `value`, its median PSNR over surfaces at a size, the best first; without lines that don't reach it.

        `bound` is true of a line without a curve on any of the surfaces: its value is that of the best rungs within the
        size, and with a rung of just this size it might have more. Within a time the value is that of the best rungs in
        time, and `bound` is false.
        """
        of_rungs = median_over(self.of_picks(self.picks(budget, surfaces))).dropna()
        readings = pd.DataFrame({"value": of_rungs, "bound": budget.kind == BYTES})
        if budget.kind == BYTES:
            with_curves = [line for line, by_surface in self.hulls.items() if by_surface.keys() & set(surfaces)]
            of_curves = median_over(self.read(budget.most)[[*surfaces]]).dropna()
            bounds = readings[~readings.index.isin(with_curves)]
            readings = pd.concat([bounds, pd.DataFrame({"value": of_curves, "bound": False})])
        return readings.sort_values("value", ascending=False, kind="stable")

    def absent_leader(self, budget: Budget, surfaces: Sequence[str], to_end: bool = False) -> str:
        """A line that reaches a size on some of the surfaces alone, by its curve or a rung, but is ahead of the best of
        those that have a value on all, in the median over the surfaces that it has; "" if there is none. `to_end`: as
        for `read`.
        """
        if budget.kind != BYTES or not surfaces:
            return ""
        of_curves = self.read(budget.most, to_end=to_end)[[*surfaces]]
        of_rungs = self.of_picks(self.picks(budget, surfaces)).dropna()  # of lines without curves, too
        on_all = pd.concat([of_curves.dropna(), of_rungs[~of_rungs.index.isin(of_curves.index)]])
        if on_all.empty:
            return ""
        best = on_all.loc[str(median_over(on_all).idxmax())]
        on_each = {surface: self.of_picks(self.picks(budget, [surface]))[surface] for surface in surfaces}
        of_any_rungs = pd.DataFrame(on_each)  # NaN where a line has none
        of_any = pd.concat([of_curves, of_any_rungs[~of_any_rungs.index.isin(of_curves.index)]])
        for line in of_any.index.difference(on_all.index, sort=False):
            gaps = (of_any.loc[str(line)] - best).dropna().to_numpy(float)
            if len(gaps) and np.median(gaps) > 0:
                return str(line)
        return ""

    def is_outdone(self, budget: Budget, surfaces: Sequence[str]) -> bool:
        """Whether the best at a size has fewer dB, as tables read, than a line whose curves end before has at their
        end, so that to mark it would mislead."""
        if budget.kind != BYTES:
            return False
        here = self.readings(budget, surfaces)["value"]
        ended = [self._end(line, surfaces) for line in self.hulls if line not in here.index]
        values = [value for size, value in ended if size < np.log2(budget.most)]
        return bool(len(here) and values) and as_read(max(values), 1) > as_read(here.max(), 1)

    def _end(self, line: str, surfaces: Sequence[str]) -> tuple[float, float]:
        """The largest size that all curves of a line on these surfaces reach, as log2 of bits a texel, and its median
        PSNR there; infinite and NaN if they share no size, or if there is not one on each surface."""
        hulls = [hull for surface, hull in self.hulls[line].items() if surface in surfaces]
        size = min((hull.sizes[-1] for hull in hulls), default=np.inf)
        values = [at(curve, size) for hull in hulls if (curve := self.curve(hull))]
        reached = [value for value in values if value is not None]
        if len(reached) < len(surfaces):
            return np.inf, np.nan
        return size, float(np.median(reached))

    def told_apart(self, budget: Budget, surfaces: Sequence[str]) -> set[str]:
        """The lines with a rung on each surface whose differences over these tell them apart from `AGAINST`."""
        scores = self.of_picks(self.picks(budget, surfaces)).dropna()
        if AGAINST not in scores.index:
            return set()
        gaps = scores.drop(index=AGAINST) - scores.loc[AGAINST]
        return set(gaps.index[told_by_holm([chance_if_equal(row) for row in gaps.to_numpy()])])

    def lead(self, line: str, surfaces: Collection[str] = ()) -> Summary | None:
        """How far a line is ahead of `AGAINST` at equal bytes: BD-PSNR over some surfaces, or over all.

        Of a line without curves, each rung is compared with the other's curve at its own bytes. None for `AGAINST`
        itself, and where they share no bytes.
        """
        if line == AGAINST:
            return None
        gaps = self._gaps_of_draws[line] if line in self.hulls else self._gaps_of_rungs(line)
        chosen = {surface: of_draws for surface, of_draws in gaps.items() if not surfaces or surface in surfaces}
        return summarised(chosen) if chosen else None

    @cached_property
    def _gaps_of_draws(self) -> dict[str, dict[str, list[float]]]:
        """What `_drawn_gaps` says of each line with curves."""
        return {line: self._drawn_gaps(line) for line in self.hulls}

    def _drawn_gaps(self, line: str) -> dict[str, list[float]]:
        """By surface where a line and `AGAINST` have curves that share bytes: the BD-PSNR between them, then the same
        for `DRAWS` draws of the seeds of both."""
        gaps: dict[str, list[float]] = {}
        rng = np.random.default_rng(0)
        our_hulls, their_hulls = self.hulls[line], self.hulls.get(AGAINST, {})
        for surface in sorted(our_hulls.keys() & their_hulls.keys()):
            ours, theirs = our_hulls[surface], their_hulls[surface]
            our_curve, their_curve = self.curve(ours), self.curve(theirs)
            gap = bd_psnr(our_curve, their_curve) if our_curve and their_curve else None
            if gap is None:
                continue
            seeds = [self._seeds[rung] for hull in (ours, theirs) for rung in hull.once]
            of_draws = [gap] * DRAWS  # with one seed there is nothing to draw
            if any(len(of_rung) > 1 for of_rung in seeds):
                of_draws = (_drawn(seeds, rng) @ _weights(ours, theirs)).tolist()
            gaps[surface] = [gap, *of_draws]
        return gaps

    def _gaps_of_rungs(self, line: str) -> dict[str, list[float]]:
        """As `_drawn_gaps`, of a line without curves: the mean gap of its rungs to the curve of `AGAINST`."""
        gaps: dict[str, list[float]] = {}
        rungs = self.frame[self.frame["line"] == line]
        for surface, hull in sorted(self.hulls.get(AGAINST, {}).items()):
            curve = self.curve(hull)
            on_surface = rungs[rungs["material"] == surface]
            gaps_of_rungs = []
            for size, psnr in zip(np.log2(on_surface["bits"]).tolist(), on_surface["psnr"].tolist(), strict=True):
                theirs = at(curve, size) if curve else None
                if theirs is not None and not np.isnan(psnr):
                    gaps_of_rungs.append(psnr - theirs)
            if gaps_of_rungs:
                gaps[surface] = [fmean(gaps_of_rungs)] * (1 + DRAWS)
        return gaps


def summarised(gaps: Mapping[str, Sequence[float]]) -> Summary:
    """The summary of a difference by surface: the difference itself, then that of each of `DRAWS` draws of seeds."""
    values = np.array(list(gaps.values()))  # (surfaces, 1 + DRAWS)
    low, high = interval_over_surfaces(values[:, 1:])
    measured = values[:, 0]
    won = int((measured > 0).sum())
    return Summary(float(np.median(measured)), won, len(values), low, high)


def _drawn(seeds: Sequence[Sequence[float]], rng: np.random.Generator) -> np.ndarray:
    """The mean of each rung over drawn seeds, (`DRAWS`, rungs): as many as it has, drawn with replacement.

    `seeds` has the PSNR of each seed by rung; some rung must have several.
    """
    counts = np.array([len(of_rung) for of_rung in seeds])
    several = counts[counts > 1]  # a rung with one seed has nothing to draw
    numbers = rng.integers(0, np.repeat(several, several), (DRAWS, several.sum()))  # of drawn seeds within their rung
    starts = np.cumsum([0, *several[:-1]])  # where the seeds of each such rung begin among the seeds of all these rungs
    places = np.repeat(starts, several) + numbers
    values = np.concatenate([of_rung for of_rung in seeds if len(of_rung) > 1])[places]
    means = np.tile([of_rung[0] for of_rung in seeds], (DRAWS, 1))
    means[:, counts > 1] = np.add.reduceat(values, starts, axis=1) / several
    return means


def _weights(ours: Hull, theirs: Hull) -> np.ndarray:
    """The weight of each rung of two hulls in their BD-PSNR, (rungs,), ours first.

    BD-PSNR is linear in the values of curves, so the weight of a rung is the BD-PSNR of curves that are 1 at this rung
    and 0 at all others.
    """
    weights = [bd_psnr(_one_at(ours, rung), _one_at(theirs)) for rung in ours.once]
    weights += [bd_psnr(_one_at(ours), _one_at(theirs, rung)) for rung in theirs.once]
    return np.array(weights, float)


def _one_at(hull: Hull, rung: int | None = None) -> Curve:
    """The curve of a hull with the value 1 at a rung, and 0 at all others; without a rung 0 at all."""
    return Curve(hull.sizes, [float(each == rung) for each in hull.rungs])


def median_over(table: pd.DataFrame) -> pd.Series:
    """The median of each row; NaN where a value is missing, because a median over fewer surfaces would not compare."""
    return table.median(axis=1, skipna=False)


@view
def rungs_of(run: Run) -> Rungs:
    """The rungs of a run: of jobs that were scored at validation pairs, of the whole material, and are comparable."""
    done = [job for job in run.jobs if job["status"] == "ok" and not fitted_to_scene(job)]
    scored = {job["job"]: job for job in done if has_validation(job)}
    without = [job for job in done if job["job"] not in scored]
    unlike: list[Job] = []
    comparable = frame_of(replace(run, jobs=Records(scored)), records=False)
    if scored:  # else it has no columns
        unlike = [scored[name] for name in comparable.loc[comparable["why"] != "", "job"]]
        comparable = comparable[comparable["why"] == ""]
    if comparable.empty:
        names = ["line", "codec", "label", "setting", "material", "job", "height", "width", "bits"]
        names += [*_COSTS, *_SCORES, "seeds"]
        return Rungs(pd.DataFrame(columns=names, dtype=float), {}, {}, set(), without, unlike)
    values = _values_of_jobs(comparable, [scored[name] for name in comparable["job"]])
    rungs = _means_over_seeds(values)
    within = _materials_within_budgets(rungs)
    rows = values.to_dict("records")  # of each material, its last job counts
    shapes = {row["material"]: (int(row["height"]), int(row["width"])) for row in rows}
    surfaces = {row["material"]: row["surface"] for row in rows if row["material"] in within}
    of_stale = values[values["stale"] != ""]
    stale = {*zip(of_stale["line"], of_stale["material"], strict=True)}
    return Rungs(rungs, surfaces, shapes, stale, without, unlike)


def _materials_within_budgets(rungs: pd.DataFrame) -> set[str]:
    """The materials that have a rung within the largest budget of some kind."""
    within = rungs["bits"] <= BITS[-1]
    for kind, budgets in _OF_TIME.items():
        within |= rungs[kind] <= budgets[-1]
    return set(rungs.loc[within, "material"])


def _values_of_jobs(frame: pd.DataFrame, jobs: Sequence[Job]) -> pd.DataFrame:
    """What rungs are made of: a row a job, with its names, scores and costs; `frame` has the rows of these jobs."""
    values = frame[["line", "codec", "label", "material", "surface", "setting", "job", "stale"]].copy()
    values[[EAGER, FUSED]] = frame[[EAGER, FUSED]].astype(float)
    values[FIT] = frame["fit_seconds"].astype(float).replace(0.0, np.nan)
    values[["height", "width"]] = [job["shape"] for job in jobs]
    values["total"] = [job["bytes"]["total"] for job in jobs]
    values["resident"] = _floats(job.get("resident") for job in jobs)
    values["validation"] = _floats(validation_of(job).get("mean") for job in jobs)
    for name, family in _TEST.items():
        values[name] = _floats(stats_of(job, family).get("mean") for job in jobs)
    for side in FOOTPRINTS:
        values[side] = _floats(job.get("footprints", {}).get(side, {}).get("mean") for job in jobs)
    return values


def _means_over_seeds(values: pd.DataFrame) -> pd.DataFrame:
    """The rungs of the jobs of `_values_of_jobs`, as `Rungs.frame` has them."""
    # By label, which names what differs from the defaults: a setting that is added later splits no rung.
    by_rung = values.groupby(["line", "label", "material"], sort=False)
    rungs = by_rung[["codec", "setting", "job", "height", "width"]].first()
    rungs = rungs.join(by_rung[[*_SCORES, *_COSTS]].mean())
    seeds: list[list[float]] = [[] for _ in range(len(rungs))]
    for rung, psnr in zip(by_rung.ngroup().tolist(), values["psnr"].tolist(), strict=True):
        seeds[rung].append(psnr)
    rungs["seeds"] = seeds
    for name in _SCORES:  # a mean of some seeds would not compare
        rungs.loc[by_rung[name].count() < by_rung.size(), name] = np.nan
    rungs = rungs.reset_index()
    # Lines in the order of records, and of each its settings.
    order = np.lexsort([pd.factorize(rungs["label"])[0], pd.factorize(rungs["line"])[0]])
    rungs = rungs.iloc[order].reset_index(drop=True)
    rungs["total"] = rungs["total"].round()  # the mean of files; the largest would grow with the number of seeds
    rungs["bits"] = 8 * rungs["total"] / (rungs["height"] * rungs["width"])
    return rungs


def _floats(values: Iterable[float | None]) -> list[float]:
    """Numbers with NaN where nothing was measured."""
    return [np.nan if value is None else value for value in values]
