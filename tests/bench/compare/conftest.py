import pytest

from bench.records import MOST_DB, append, load_run

PSNR, FLIP, SSIM = "psnr_display", "flip_ldr_67ppd_periodic", "ssim_periodic"
METRICS = {
    PSNR: {"unit": "dB", "direction": "higher", "space": "display", "version": 1},
    FLIP: {"unit": "1", "direction": "lower", "space": "display", "version": 1},
    SSIM: {"unit": "1", "direction": "higher", "space": "display luma", "version": 1},
}


class Maker:
    def __init__(self, folder):
        self.folder = folder

    def job(self, label="pca", material="satin", seed=0, psnr=30.0, flip=0.1, **changes):
        """One finished job; `psnr=100.0` makes it exact. `version`, `training`, `btf`, `exposure`, `size` and
        `settings` change what their names say, `versions` those of metrics (0: not measured).
        """
        get = changes.pop
        psnr = None if psnr is None else min(psnr, MOST_DB)
        record = {"kind": "job", "job": f"{material}/{label}/{seed}", "run": get("run", "1"), "material": material}
        record |= {"label": label, "codec": label.split()[0], "seed": seed, "status": "ok", "parameters": 3011}
        settings = get("settings", {"components": 8})
        record["fit_key"] = {"version": get("version", 1), "settings": settings, "training": get("training", "t")}
        record["score_key"] = {"btf": get("btf", "b"), "exposure": get("exposure", 1.5)}
        record["score_key"]["sha256"] = get("sha256", f"of {psnr} dB")  # another file for each quality
        record["score_key"] |= {"deciding": changes.pop("deciding")} if "deciding" in changes else {}
        versions = dict.fromkeys(METRICS, 1) | get("versions", {})
        measured = ((name, version) for name, version in versions.items() if version)
        record["metrics"] = {name: METRICS[name] | {"version": version} for name, version in measured}
        numbers = {PSNR: psnr, FLIP: flip, SSIM: get("ssim", 0.9)}
        stats = {name: self._stats(numbers[name]) for name in record["metrics"]}
        record["scores"] = {name: {"slices": 4, "metrics": stats} for name in ("all", "train", "heldout")}
        footprint = {"psnr_display": psnr, "mean": psnr, "exact": 4 * (psnr is None), "slices": 4}
        record["footprints"] = dict.fromkeys(("1", "2"), footprint)
        size = get("size", 64_000)
        record["bytes"] = {"decoder": 6_000, "texture": size - 6_500, "other": 0, "header": 500, "total": size}
        return record | changes

    def seeds(self, psnrs, label="vq", **changes):
        return [self.job(label, seed=seed, psnr=psnr, **changes) for seed, psnr in enumerate(psnrs)]

    def three(self, label="pca", **changes):
        return [self.job(label, seed=seed, **changes) for seed in range(3)]

    def unfinished(self, status, label="pca", material="satin", seed=0, error="RuntimeError: no luck"):
        record = {"kind": "job", "job": f"{material}/{label}/{seed}", "run": "1", "material": material}
        return record | {"label": label, "codec": label.split()[0], "seed": seed, "status": status, "error": error}

    def timing(self, label="pca", material="satin", seed=0, ns=500.0, spread=5.0, run="1", floor=100.0, **changes):
        record = {"kind": "timing", "job": f"{material}/{label}/{seed}", "run": run, "ns_per_sample": ns}
        record |= {"interval95_ns": [ns - spread, ns + spread], "batch": 16384, "dtype": "float32", "threads": 1}
        record |= {"ratio_to_floor": ns / floor, "ratio_interval95": [(ns - spread) / floor, (ns + spread) / floor]}
        return record | {"device": "cpu", "execution": "eager", "samples_ns": [ns], "floor_ratios": [2.0]} | changes

    def run(self, name, *records, seeds=(0, 1, 2), **start):
        (self.folder / name).mkdir()
        first = {"kind": "run", "run": "1", "suite": "made", "device": "cpu", "threads": 1, "seeds": list(seeds)}
        first |= {"packages": {"torch": "2.13.0"}, "machine": {"processor": "P", "system": "Linux-host"}}
        append(self.folder / name, first | start)
        for record in records:
            append(self.folder / name, record)
        return load_run(self.folder / name)

    @staticmethod
    def _stats(number):
        return {"mean": number, "std": 0.5, "pooled": number, "exact": 4 * (number is None), "slices": 4}


@pytest.fixture
def make(tmp_path):
    return Maker(tmp_path)
