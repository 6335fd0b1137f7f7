import re

import pytest

from bench.codecs import alike
from bench.codecs.registry import codec_entries, current_versions, load_codec
from bench.training import stored_texture


def job(label="pca", seed=0, run="1", **key):
    fit = {"version": 4, "store": 2, "code": "a", "training": "t"}
    fit |= {name: value for name, value in key.items() if name in fit}
    score = {"btf": "f", "exposure": 1.0, "metrics": {"psnr_display": key.get("metric", 2)}}
    named = {"job": f"satin/{label}/{seed}/{run}", "material": "satin", "label": label, "codec": label.split()[0]}
    return named | {"seed": seed, "run": run, "status": "ok", "fit_key": fit, "score_key": score}


def test_versions_are_read_from_the_source_without_importing_it():
    for name in codec_entries():
        codec, store = load_codec(name), stored_texture.VERSION
        assert current_versions(name) == {"version": codec.version, "store": store}
        for recipe in codec.recipes:
            assert current_versions(name, recipe) == {"version": codec.version_of({"recipe": recipe}), "store": store}
    assert current_versions("neubtf", "paper") != current_versions("neubtf")
    assert current_versions("nobody's") == {}


@pytest.mark.parametrize("key", ["version", "store"])
def test_a_record_of_another_version_is_stale(key):
    now = current_versions("pca")
    fresh = job() | {"fit_key": now}
    older = fresh | {"job": "older", "fit_key": now | {key: now[key] - 1}}
    without_store = fresh | {"job": "without store", "fit_key": {"version": now["version"]}}
    nobodys = fresh | {"job": "nobody's", "codec": "nobody's", "fit_key": {"version": 1}}
    handed_in = fresh | {"job": "handed in", "fit_key": {}}
    why = alike.stale([fresh, older, without_store, nobodys, handed_in])
    assert set(why) == {"older", "without store"}
    assert re.search(rf"{key}.* {now[key] - 1} .*{now[key]}$", why["older"])
    assert re.search(f"store.*None.*{now['store']}$", why["without store"])


def test_versions_of_a_codec_do_not_mix_over_seeds_or_settings_and_the_newest_stands():
    jobs = [job(run="2"), job("pca components=8", run="1", version=3), job("vq", run="1", version=3)]
    ((name, why),) = alike.obstacles(jobs).items()
    assert name == "satin/pca components=8/0/1"
    assert re.search("version 3.*4", why)


def test_seeds_fitted_to_other_training_pairs_do_not_mix():
    """Each seed has test pairs of its own, so these tell nothing; but all seeds share their training pairs."""
    jobs = [job(seed=0, run="2"), job(seed=1, training="other"), job("vq", run="2")]
    ((name, why),) = alike.obstacles(jobs).items()
    assert name == "satin/pca/1/1"
    assert "training" in why
    without = job(seed=1) | {"fit_key": {"version": 4, "store": 2}}  # handed in without
    assert alike.obstacles([job(seed=0, run="2"), without]) == {}


def test_a_recipe_may_have_a_version_of_its_own():
    """A change of the paper's recipe makes no row of ours stale, and both may stand in one table."""
    ours = job("neubtf") | {"fit_key": current_versions("neubtf"), "settings": {"recipe": "ours"}}
    paper = job("neubtf recipe=paper") | {"settings": {"recipe": "paper"}}
    paper |= {"fit_key": current_versions("neubtf", "paper")}
    assert alike.stale([ours, paper]) == {}
    (why,) = alike.stale([paper | {"fit_key": ours["fit_key"]}]).values()
    assert why.startswith("codec version")
    assert alike.obstacles([ours, paper]) == {}


def test_code_of_one_s_own_codec_does_not_mix_between_seeds(monkeypatch):
    """The suite's own codecs have a version for that; their code changes with every word of `bench`."""
    jobs = [job("mine", seed=0, code="old"), job("mine", seed=1, run="2"), job("mine x=1", code="old")]
    assert alike.obstacles(jobs) == {}
    monkeypatch.setattr(alike, "from_outside", lambda name: name == "mine")
    (why,) = alike.obstacles(jobs).values()
    assert "code" in why
