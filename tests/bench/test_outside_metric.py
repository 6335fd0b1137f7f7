"""A metric of another package: run, shown, listed; what is wrong with one is one line that names it."""

import re
import subprocess
import sys
import tomllib

import numpy as np
import pytest

from bench import cli, metrics
from bench.conformance.check import tiny_btf
from bench.inputs.errors import InputError
from bench.inputs.plugins import PluginError
from bench.metrics import outside
from bench.metrics.scoring import Scorer, polar_maps, summarise, weighted
from tests.bench.outside import install

SMALL = [part for key in ("size=16", "views=4", "lights=4", "heldout=4") for part in ("--set", f"data.{key}")]
SOURCE = """
import numpy as np
from bench.metrics import Metric
from bench.metrics.base import SliceMetric

METRIC = Metric("dark", "1", "lower", "display", 1, "dark:Dark", "darkness")

class Dark(SliceMetric):
    def reference_side(self, reference):
        return reference.display

    def compare(self, side, test):
        return np.abs(side - test.display).mean(0)
"""
COMPARE = "def compare"  # before it a test adds another method


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Installs modules as a package of metrics, and forgets all metrics of earlier ones."""

    def forget():
        for cached in (outside.entries, outside._imported_or_error, metrics.find, metrics._member):
            cached.cache_clear()

    def make(source, name="dark", package="shades"):
        site = install(tmp_path / package, package, {name: "dark:METRIC"}, {"dark": source}, outside.GROUP)
        monkeypatch.syspath_prepend(str(site))
        monkeypatch.delitem(sys.modules, "dark", raising=False)
        forget()
        return site

    make.forget = forget
    yield make
    sys.modules.pop("dark", None)
    forget()


def scores_of(name):
    btf = tiny_btf(16, 4, 4)
    scorer = Scorer(btf, metrics.chosen_names([name], btf.periodic))
    return btf, scorer.score(range(3), lambda pair: btf[pair] * 0.9)


def scored(name="dark"):
    btf, scores = scores_of(name)
    return summarise(scores, btf.wo, btf.wi, {"all": np.arange(3)})["all"]["metrics"]


@pytest.mark.long
@pytest.mark.usefixtures("brief", "undrawn")
def test_it_runs_and_tables_and_lists_show_it(installed, tmp_path, capsys):
    site = installed(SOURCE)

    def neubtf_bench(*words):
        assert cli.main([*map(str, words)]) == 0
        return capsys.readouterr().out

    assert re.search(r"^ *dark  .*lower", neubtf_bench("list", "metrics"), re.M)
    chosen = ["--material", "satin", "--codec", "mean-colour", "--metric", "dark"]
    neubtf_bench("run", "quick", *chosen, *SMALL, "--out", tmp_path / "run")
    assert "darkness" in neubtf_bench("table", "main", tmp_path / "run")
    sys.path.remove(str(site))
    installed.forget()
    assert "dark" in neubtf_bench("table", "main", tmp_path / "run")  # where it is not installed, by its name


@pytest.mark.long
@pytest.mark.usefixtures("brief", "undrawn")
def test_a_job_that_it_fails_is_scored_again_once_it_is_mended(installed, tmp_path, capsys):
    words = ["run", "quick", "--material", "satin", "--codec", "mean-colour", "--metric", "dark", *SMALL]
    words += ["--out", str(tmp_path / "run")]
    installed(SOURCE.replace("np.abs(side", "np.nan * abs(side"))
    assert cli.main(words) == 3
    assert "dark of shades 1.0 fails in compare: " in " ".join(capsys.readouterr().out.split())
    installed(SOURCE, package="mended")
    assert cli.main(words) == 0
    assert "1 scored again" in " ".join(capsys.readouterr().out.split())


def test_it_is_scored_as_any_other(installed):
    installed(SOURCE)
    assert scored()["dark"]["mean"] > 0
    assert metrics.label_of("dark") == "darkness"
    assert metrics.family_of("dark") == "dark"


def test_a_unit_changes_nothing_in_silence(installed):
    installed(SOURCE.replace('"1", "lower"', '"dB", "lower"'))
    assert "worst" not in scored()["dark"]
    assert not metrics.in_decibels("dark")
    installed(SOURCE.replace('"darkness")', '"darkness", decibels=True)'), package="others")
    assert "worst" in scored()["dark"]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("import numpy", "import no_such_module, numpy", "ModuleNotFound.*uninstall shades"),
        ("import numpy", "raise SystemExit(3)\nimport numpy", "SystemExit"),
        ("METRIC = Metric(", "METRIC = (", r"dark:METRIC .*tuple.* bench\.metrics\.Metric"),
        ('Metric("dark"', 'Metric("light"', "'light'.*'dark'"),
        ('"lower"', '"smaller"', "direction.*'smaller'.*'lower'"),
        ('display", 1', "display\", '1'", "version.*'1'"),
        ('"darkness")', '"dark", default=True)', "default=True"),
        ('"darkness")', '"dark", family="ssim")', "family 'ssim'"),
        ("dark:Dark", "dark:Lost", "AttributeError"),
        ("(SliceMetric)", "", "a Dark.*SliceMetric"),
        ("return reference.display", "return 1 / 0", "reference_side: ZeroDivisionError"),
        ("np.abs(side - test.display)", "np.nan * side", "compare.*not finite"),
        ("np.abs(side - test.display).mean(0)", "0.5", r"compare.*\(\), not a map"),
        ("np.abs(side - test.display).mean(0)", "side", r"compare.*\(3, 3, 16, 16\), not a map"),
        (COMPARE, f"def for_material(self, sample):\n        exit()\n\n    {COMPARE}", "for_material: SystemExit"),
        (COMPARE, f"def for_material(self, sample):\n        pass\n\n    {COMPARE}", "for_material.*NoneType"),
        (COMPARE, f"def fixed(self):\n        return self.lost\n\n    {COMPARE}", "fixed: AttributeError"),
        (COMPARE, f"def values(self, raw):\n        return None\n\n    {COMPARE}", "values.*TypeError"),
        (COMPARE, f"def pool(self, raw):\n        return None\n\n    {COMPARE}", "pool: TypeError"),
    ],
)
def test_what_is_wrong_with_it_is_one_line_that_names_it(installed, old, new, says):
    assert old in SOURCE
    installed(SOURCE.replace(old, new))
    with pytest.raises(PluginError, match=f"metric dark of shades 1.0.*{says}") as raised:
        scored()
    assert "\n" not in str(raised.value)


def test_polar_maps_and_weighted_means_name_one_that_fails(installed):
    installed(SOURCE.replace(COMPARE, f"def values(self, raw):\n        return 1 / 0\n\n    {COMPARE}"))
    btf, scores = scores_of("dark")
    with pytest.raises(PluginError, match=r"metric dark of shades 1\.0 fails in pool: ZeroDivisionError"):
        polar_maps(scores, btf.wo, btf.wi)
    with pytest.raises(PluginError, match=r"metric dark of shades 1\.0 fails in values: ZeroDivisionError"):
        weighted(scores, np.ones(len(btf)))


def test_one_that_fails_is_listed_so_and_older_records_of_it_keep_their_name(installed):
    installed("1 / 0")
    assert metrics.listed()["dark"].startswith("FAILS: metric dark of shades 1.0 ")
    assert metrics.label_of("dark") == "dark"
    assert metrics.metric_of(["dark", "ssim"], "ssim") == "ssim"


@pytest.mark.parametrize("name", ["ssim", "ssim_periodic", "flip_ldr_33ppd"])
def test_the_name_of_a_built_in_metric_is_refused(installed, tmp_path, capsys, name):
    installed(SOURCE, name)
    assert cli.main(["run", "quick", "--metric", "ssim", "--out", str(tmp_path / "run")]) == 2
    assert f"metric {name} of shades 1.0 " in capsys.readouterr().err


def test_two_packages_with_one_name_are_refused(installed):
    installed(SOURCE)
    site = installed(SOURCE, package="others")
    (site / "others-1.0.dist-info" / "entry_points.txt").write_text(f"[{outside.GROUP}]\ndark = other:METRIC\n")
    outside.entries.cache_clear()
    with pytest.raises(InputError, match=r"'dark'.*uninstall"):
        metrics.get("dark")


def test_a_new_metric_is_a_package_whose_test_passes(installed, tmp_path):
    assert cli.main(["new", "metric", "deep-shade", "--out", str(tmp_path)]) == 0
    folder = tmp_path / "deep-shade-metric"
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    places = project["entry-points"][outside.GROUP]
    assert places == {"deep_shade": "deep_shade_metric:METRIC"}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    site = installed(SOURCE)  # forgets; the new one is then beside it
    text = (folder / "deep_shade_metric.py").read_text()
    install(site, "deep", places, {"deep_shade_metric": text}, outside.GROUP)
    outside.entries.cache_clear()
    assert scored("deep_shade")["deep_shade"]["mean"] > 0
    assert cli.main(["new", "metric", "deep-shade", "--out", str(tmp_path / "again")]) == 2
