import json

import numpy as np
import pytest

from bench.records import MOST_DB, append
from tests.reports.browser import chromium

METRICS = {
    "psnr_display": {"unit": "dB", "direction": "higher", "space": "display", "version": 1},
    "psnr_log1p": {"unit": "dB", "direction": "higher", "space": "log1p", "version": 1},
    "rmse_linear": {"unit": "radiance", "direction": "lower", "space": "linear", "version": 1},
    "ssim_periodic": {"unit": "1", "direction": "higher", "space": "display luma", "version": 1},
    "flip_ldr_67ppd_periodic": {"unit": "1", "direction": "lower", "space": "display", "version": 1},
}
SIDE, PAIRS, SHOWN = 8, 12, (1, 6, 9)


class RunMaker:
    def __init__(self, folder):
        self.folder = folder
        folder.mkdir(exist_ok=True)

    def start(self, run="1", suite="made"):
        machine = {"cores": 2, "processor": "a processor"}
        append(self.folder, {"kind": "run", "run": run, "suite": suite, "device": "cpu", "machine": machine})
        return self

    def job(self, label="pca components=8", material="satin", **changes):
        """One finished job; `psnr=100` makes it exact, `metrics`, `btf`, `exposure` change its score key."""
        psnr, run, seed = min(changes.pop("psnr", 30.0), MOST_DB), changes.pop("run", "1"), changes.pop("seed", 0)
        key = {"btf": changes.pop("btf", "f"), "exposure": changes.pop("exposure", 1.5), "sha256": "0"}
        key["metrics"] = changes.pop("metrics", {name: metric["version"] for name, metric in METRICS.items()})
        key |= {"deciding": changes.pop("deciding")} if "deciding" in changes else {}
        stem = f"{len(list(self.folder.rglob('*.npz')))}"
        job = {"kind": "job", "job": f"{material}/{label}/{seed}", "run": run, "material": material, "label": label}
        job |= {"status": "ok", "codec": label.split()[0], "curve": label.split()[0], "seed": seed, "score_key": key}
        job |= {"shape": [SIDE, SIDE], "pairs": {"all": PAIRS, "train": 8, "heldout": 4}, "settings": {"a": 1}}
        job |= {"bytes": {"decoder": 1200, "texture": 34567, "other": 10, "header": 333, "total": 36110}}
        job |= {"parameters": 3011, "cost": {"texture_channels": 14}, "metrics": METRICS, "fit_seconds": 1.25}
        groups = ["all", "train", "heldout", "heldout, grazing view", "heldout, new view"]
        job["scores"] = {name: self._group(psnr) for name in [*groups, "heldout, new view, grazing light"]}
        footprint = {"psnr_display": psnr, "mean": psnr, "exact": 0, "slices": 4}
        job["footprints"] = dict.fromkeys(("1", "2", "4", "8"), footprint)
        job["history"] = [{"step": 10, "seconds": 0.5, "psnr": 25.0}, {"step": 20, "seconds": 1.0, "psnr": 31.0}]
        job |= {"slices": self._slices(stem, psnr), "pictures": self._pictures(stem), "angular": self._angular(stem)}
        job |= changes
        if "recipe=paper" in label.split():
            job["settings"] = {**job["settings"], "recipe": "paper"}
        append(self.folder, job)
        return self

    def unfinished(self, status, error, label="vq", material="satin", run="1"):
        job = {"kind": "job", "job": f"{material}/{label}/0", "run": run, "material": material, "label": label}
        append(self.folder, job | {"codec": label.split()[0], "status": status, "error": error, "seed": 0})
        return self

    def timing(self, label="pca components=8", material="satin", run="1", **changes):
        timing = {"kind": "timing", "job": f"{material}/{label}/0", "run": run, "batch": 16384, "dtype": "float32"}
        timing |= {"threads": 2, "device": "cpu", "execution": "eager", "queries": "random", "texture_fetch": True}
        timing |= {"ns_per_sample": 123.4, "iqr_ns": 2.0, "interval95_ns": [120.5, 130.5], "ratio_to_floor": 1.75}
        append(self.folder, timing | {"samples_ns": [1.0], "floor_ratios": [1.0]} | changes)
        return self

    def trade(self, *labels, material="satin"):
        """A choice of the job of each label, and the floor."""
        row = {"kind": "timing", "run": "1", "material": material, "execution": "eager", "dtype": "float32"}
        row |= {"device": "cpu", "ns_per_sample": 100.0, "interval95_ns": [99.0, 101.0], "ratio_to_floor": 2.0}
        row |= {"ratio_interval95": [1.9, 2.1], "batch": 65536, "threads": 1}
        choice = row | {"codec": "pca", "psnr": 30.0, "worst": 25.0, "flip": 0.1, "bytes": 1000, "limit_ns": 10.0}
        choice |= {"settings": {}, "score_key": {"sha256": "0"}}
        for label in labels:
            of = f"{material}/{label}/0"
            append(self.folder, choice | {"job": f"{of}/eager float32/cpu", "of": of, "label": label})
        ceiling = {"device": "cpu", "threads": 1, "dtype": "float32", "flops_per_ns": 90.0, "bytes_per_ns": 9.0}
        floor = row | {"job": f"{material}/floor/eager float32/cpu", "label": "floor", "ceilings": [ceiling]}
        append(self.folder, floor)
        return self

    def _group(self, psnr):
        exact = 4 if psnr >= MOST_DB else 0
        pooled = None if exact else psnr  # of no error at all it is infinite, which no record holds
        quality = {"mean": psnr, "std": 1.5, "worst": psnr - 3, "pooled": pooled, "exact": exact, "slices": 4}
        unit = {"mean": 0.75, "std": 0.125, "pooled": 0.75, "exact": exact, "slices": 4}
        radiance = {"mean": 0.02, "std": 0.01, "pooled": 0.025, "exact": exact, "slices": 4, "relative": 0.333}
        by_unit = {"dB": quality, "1": unit, "radiance": radiance}
        return {"slices": 4, "radiance": 0.1, "metrics": {name: by_unit[m["unit"]] for name, m in METRICS.items()}}

    def _slices(self, stem, psnr):
        rng = np.random.default_rng(1)
        raw = np.full(PAIRS, 10 ** (-psnr / 10) if psnr < MOST_DB else 0.0)
        angles = rng.uniform((0, 0), (75, 360), (PAIRS, 2))
        content = {"pairs": np.arange(PAIRS), "heldout": np.arange(PAIRS) % 3 == 0, "wo_deg": angles}
        content |= {"wi_deg": angles[::-1], "abrdf": np.full((SIDE, SIDE), raw[0])} | dict.fromkeys(METRICS, raw)
        return self._keep(f"slices-{stem}.npz", content)

    def _pictures(self, stem):
        rng = np.random.default_rng(2)
        shape = (len(SHOWN), SIDE, SIDE, 3)
        content = {name: rng.integers(0, 256, shape, np.uint8) for name in ("truth", "decoded", "flip")}
        content["pairs"] = np.array(SHOWN)
        return self._keep(f"pictures-{stem}.npz", content | dict.fromkeys(("wo_deg", "wi_deg"), np.full((3, 2), 40.0)))

    def _angular(self, stem):
        value = [[0.25] * 12 for _ in range(5)] + [[None] * 12]
        side = {"theta_edges_deg": [0, 15, 30, 45, 60, 75, 90], "phi_centres_deg": [30 * i for i in range(12)]}
        polar = dict.fromkeys(("view", "light"), side | {"value": value})
        (self.folder / f"angular-{stem}.json").write_text(json.dumps({"polar": dict.fromkeys(METRICS, polar)}))
        return f"angular-{stem}.json"

    def _keep(self, name, content):
        np.savez(self.folder / name, **content)
        return name


@pytest.fixture(scope="session")
def run_maker():
    return RunMaker


@pytest.fixture(scope="session")
def browser():
    with chromium() as launched:
        yield launched


@pytest.fixture
def made(tmp_path):
    return RunMaker(tmp_path / "run").start()
