import re
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Literal

import pytest
import torch

from bench.codec import Codec, Fit, described_settings, settings_dict
from bench.codecs.registry import codec_entries, load_codec
from bench.errors import InputError
from bench.settings import Count, Positive, Range, Share, described


class Sample(Codec):
    """A codec with a setting of each kind."""

    name, version = "sample", 1

    @dataclass(frozen=True)
    class Settings:
        count: int = 3
        rate: float = 0.5
        half: bool = True
        domain: Literal["log", "rgb"] = "log"


class Cooked(Sample):
    """A codec with a recipe of its own and one that a paper gives."""

    recipes = MappingProxyType({"paper": {"count": 9, "domain": "rgb"}})

    @dataclass(frozen=True)
    class Settings(Sample.Settings):
        recipe: Literal["ours", "paper"] = "ours"


def test_a_recipe_changes_defaults_and_what_is_named_changes_the_recipe():
    ours = {"count": 3, "rate": 0.5, "half": True, "domain": "log", "recipe": "ours"}
    assert settings_dict(Cooked()) == ours
    assert settings_dict(Cooked(recipe="paper")) == ours | {"recipe": "paper", "count": 9, "domain": "rgb"}
    assert settings_dict(Cooked(recipe="paper", count="4"))["count"] == 4
    # A file's header names every setting: it means what it says, whatever a recipe becomes later.
    assert Cooked(**(ours | {"recipe": "paper"})).settings.count == 3
    with pytest.raises(InputError, match="must be 'ours' or 'paper'"):
        Cooked(recipe="papper")


def test_settings_have_defaults_and_take_strings():
    assert settings_dict(Sample()) == {"count": 3, "rate": 0.5, "half": True, "domain": "log"}
    codec = Sample(count="7", rate="1e-3", half="false", domain="rgb")
    assert settings_dict(codec) == {"count": 7, "rate": 1e-3, "half": False, "domain": "rgb"}
    assert Sample(rate=2).settings.rate == 2.0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"coumt": 3}, "no setting 'coumt'; did you mean 'count'?"),
        ({"count": "many"}, "setting count of codec sample must be a whole number, not 'many'"),
        ({"count": 2.5}, "must be a whole number, not 2.5"),
        ({"count": True}, "must be a whole number, not True"),
        ({"rate": "fast"}, "must be a finite number, not 'fast'"),
        ({"half": "perhaps"}, "must be true or false, not 'perhaps'"),
        ({"half": 1}, "must be true or false, not 1"),
        ({"domain": "hsv"}, "must be 'log' or 'rgb', not 'hsv'"),
    ],
)
def test_bad_settings_are_named(settings, message):
    with pytest.raises(InputError) as error:
        Sample(**settings)
    assert message in str(error.value)


def test_a_fit_tells_its_progress_and_seeds_its_generator():
    seen = []
    fit = Fit(seed=5, show=lambda *state: seen.append(state))
    assert list(fit.progress("ab", "reading")) == ["a", "b"]
    assert seen == [("reading", 0, 2), ("reading", 1, 2), ("reading", 2, 2)]
    assert torch.equal(torch.rand(3, generator=fit.generator()), torch.rand(3, generator=Fit(seed=5).generator()))


class Ranged(Codec):
    """A codec whose settings have ranges."""

    name, version = "ranged", 1

    @dataclass(frozen=True)
    class Settings:
        count: Count = 3  # how many
        share: Share = 0.5  # of everything
        rate: Positive = 1.0
        level: Annotated[int, Range(2, 6)] = 4  # of detail


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"count": "0"}, "setting count of codec ranged must be a whole number ≥ 1, not '0'"),
        ({"count": 1e400}, "must be a whole number ≥ 1, not inf"),
        ({"share": 1.5}, "must be a finite number from 0 to 1, not 1.5"),
        ({"rate": 0}, "must be a finite number > 0, not 0"),
        ({"rate": "nan"}, "must be a finite number > 0, not 'nan'"),
        ({"rate": "inf"}, "must be a finite number > 0, not 'inf'"),
        ({"level": 7}, "must be a whole number from 2 to 6, not 7"),
    ],
)
def test_a_value_out_of_range_is_refused_and_the_range_named(settings, message):
    with pytest.raises(InputError, match=re.escape(message)):
        Ranged(**settings)
    assert Ranged(count=1, share="1", rate="1e-9", level=2).settings.level == 2


def test_settings_are_described_with_default_range_and_comment():
    shown = [(s.name, s.default, s.kind, s.meaning) for s in described_settings(Ranged)]
    assert shown[0] == ("count", "3", "a whole number ≥ 1", "how many")
    assert shown[2] == ("rate", "1.0", "a finite number > 0", "")
    assert [name for name, *_ in shown] == ["count", "share", "rate", "level", "zstd", "scene"]


@pytest.mark.parametrize("name", sorted(codec_entries()))
def test_every_installed_codec_refuses_numbers_that_are_not_finite_and_says_what_each_setting_means(name):
    codec = load_codec(name)
    for configured in filter(None, (codec, codec.network)):
        for setting in described(configured.Settings):
            assert setting.meaning, setting.name
            if "number" in setting.kind:
                for value in ("nan", "inf", "-inf", "1e400"):
                    with pytest.raises(InputError, match=f"setting {setting.name} of codec {name} must be"):
                        configured(**{setting.name: value})
