import re
import sys
import types
from pathlib import Path

import numpy as np

from bench import metrics
from bench.conformance.check import tiny_btf
from bench.metrics import Metric
from bench.metrics.scoring import Scorer, summarise

PAGE = (Path(__file__).parents[3] / "docs" / "metrics.md").read_text(encoding="utf-8")


def test_every_metric_is_defined_with_its_unit_direction_space_and_version():
    for metric in metrics.REGISTERED:
        line = next(line for line in PAGE.splitlines() if line.startswith(f"| `{metric.name.format(ppd=67)}`"))
        _, _, unit, direction, space, version, _, _ = (cell.strip() for cell in line.split("|"))
        assert (unit, direction, space, int(version)) == (metric.unit, metric.direction, metric.space, metric.version)
        assert metric.periodic == ("_periodic" in line)


def test_the_line_of_a_new_metric_is_all_that_scoring_it_takes(monkeypatch):
    line = re.search(r'^(Metric\("shadow".*),$', PAGE, re.M).group(1)
    names: dict = {}
    exec(re.search(r"```python\n(# bench/metrics/shadow\.py.*?)```", PAGE, re.DOTALL).group(1), names)
    monkeypatch.setitem(sys.modules, "bench.metrics.shadow", types.SimpleNamespace(**names))
    monkeypatch.setattr(metrics, "REGISTERED", (*metrics.REGISTERED, eval(line, {"Metric": Metric})))
    btf = tiny_btf(16, 4, 4)
    scorer = Scorer(btf, metrics.chosen_names(["shadow"], btf.periodic))
    scores = scorer.score(range(3), lambda pair: btf[pair] * 0.9)
    summary = summarise(scores, btf.wo, btf.wi, {"all": np.arange(3)})["all"]["metrics"]
    assert summary["shadow"]["mean"] > 0
    assert metrics.label_of("shadow") == "shadow error"
