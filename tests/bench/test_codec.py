import re
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, ClassVar, Literal

import pytest
import torch

from bench.codec import Codec, Fit, described_settings, settings_dict
from bench.codecs.registry import codec_entries, load_codec
from bench.inputs.errors import InputError
from bench.inputs.settings import Count, Positive, Range, Share, convert, descriptions


class Sample(Codec):
    name, version = "sample", 1

    @dataclass(frozen=True)
    class Settings:
        count: Count = 3  # how many
        rate: float = 0.5
        half: bool = True
        domain: Literal["log", "rgb"] = "log"
        share: Share = 0.5  # of everything
        above: Positive = 1.0
        level: Annotated[int, Range(2, 6)] = 4  # of detail
        units: ClassVar[str] = "dB"


class Cooked(Sample):
    recipes = MappingProxyType({"paper": {"count": 9, "domain": "rgb"}})

    @dataclass(frozen=True)
    class Settings(Sample.Settings):
        recipe: Literal["ours", "paper"] = "ours"


def test_a_recipe_changes_defaults_and_what_is_named_changes_the_recipe():
    ours = {"count": 3, "rate": 0.5, "half": True, "domain": "log"}
    ours |= {"share": 0.5, "above": 1.0, "level": 4, "recipe": "ours"}
    assert settings_dict(Cooked()) == ours
    strings = {"count": "7", "rate": "1e-3", "half": "false", "domain": "rgb", "share": "1", "above": 2, "level": "2"}
    taken = {"count": 7, "rate": 1e-3, "half": False, "domain": "rgb", "share": 1.0, "above": 2.0, "level": 2}
    assert settings_dict(Cooked(**strings)) == ours | taken
    assert settings_dict(Cooked(recipe="paper")) == ours | {"recipe": "paper", "count": 9, "domain": "rgb"}
    assert settings_dict(Cooked(recipe="paper", count="4"))["count"] == 4
    # A file's header names every setting: it means what it says, whatever a recipe becomes later.
    assert Cooked(**(ours | {"recipe": "paper"})).settings.count == 3
    with pytest.raises(InputError, match=r"recipe.*'paper'"):
        Cooked(recipe="papper")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"coumt": 3}, "did you mean 'count'?"),
        ({"units": "W"}, "did you mean "),
        ({"count": "many"}, "a whole number ≥ 1, not 'many'"),
        ({"count": 2.5}, "a whole number ≥ 1, not 2.5"),
        ({"count": True}, "a whole number ≥ 1, not True"),
        ({"count": "0"}, "a whole number ≥ 1, not '0'"),
        ({"count": 1e400}, "a whole number ≥ 1, not inf"),
        ({"rate": "fast"}, "a finite number, not 'fast'"),
        ({"half": "perhaps"}, "true or false, not 'perhaps'"),
        ({"half": 1}, "true or false, not 1"),
        ({"domain": "hsv"}, "'log' or 'rgb', not 'hsv'"),
        ({"share": 1.5}, "a finite number from 0 to 1, not 1.5"),
        ({"above": 0}, "a finite number > 0, not 0"),
        ({"above": "nan"}, "a finite number > 0, not 'nan'"),
        ({"level": 7}, "a whole number from 2 to 6, not 7"),
    ],
)
def test_bad_settings_are_named(settings, message):
    with pytest.raises(InputError, match=rf"{next(iter(settings))}\b.*{re.escape(message)}"):
        Sample(**settings)


def test_a_fit_tells_its_progress_and_seeds_its_generator():
    seen = []
    fit = Fit(seed=5, show=lambda *state: seen.append(state))
    assert list(fit.progress("ab", "reading")) == ["a", "b"]
    assert seen == [("reading", 0, 2), ("reading", 1, 2), ("reading", 2, 2)]
    assert torch.equal(torch.rand(3, generator=fit.generator()), torch.rand(3, generator=Fit(seed=5).generator()))


def test_a_point_of_a_curve_is_stamped_with_the_seconds_of_the_fit():
    fit = Fit()
    fit.log(10, psnr=20.0)
    fit.log(20, psnr=21.0, seconds=5.0)
    first, second = fit.history
    assert (first["step"], first["psnr"], second["seconds"]) == (10, 20.0, 5.0)
    assert 0 <= first["seconds"] < 60


def test_settings_are_described_with_default_range_and_comment():
    shown = {s.name: (s.default, s.kind, s.meaning) for s in described_settings(Sample)}
    assert shown["count"][::2] == ("3", "how many")
    assert "≥ 1" in shown["count"][1]
    assert shown["above"][::2] == ("1.0", "")
    assert "> 0" in shown["above"][1]
    assert list(shown) == ["count", "rate", "half", "domain", "share", "above", "level", "scene"]


@pytest.mark.parametrize("name", sorted(codec_entries()))
def test_every_installed_codec_refuses_numbers_that_are_not_finite_and_says_what_each_setting_means(name):
    codec = load_codec(name)
    for configured in filter(None, (codec, codec.network)):
        for setting in descriptions(configured.Settings):
            assert setting.meaning, setting.name
            if "number" in setting.kind:
                for value in ("nan", "inf", "-inf", "1e400"):
                    with pytest.raises(InputError, match=f"setting {setting.name} of codec {name} must be"):
                        configured(**{setting.name: value})


def test_a_fraction_is_none_of_some_whole_numbers():
    assert convert("sample", "bits", Literal[2, 4], "4") == 4
    with pytest.raises(InputError, match=r"2 or 4, not 2\.5"):
        convert("sample", "bits", Literal[2, 4], 2.5)
