from dataclasses import dataclass
from typing import Literal

import pytest
import torch

from bench.codec import Codec, Fit, settings_dict
from bench.errors import InputError


class Sample(Codec):
    """A codec with a setting of each kind."""

    name, version = "sample", 1

    @dataclass(frozen=True)
    class Settings:
        count: int = 3
        rate: float = 0.5
        half: bool = True
        domain: Literal["log", "rgb"] = "log"


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
        ({"rate": "fast"}, "must be a number, not 'fast'"),
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
