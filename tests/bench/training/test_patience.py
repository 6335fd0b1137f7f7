import importlib
from typing import Any

import pytest

from bench.codec import Fit
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf


class TrainCalledError(Exception):
    pass


@pytest.mark.parametrize(
    ("name", "calls"),
    [
        ("neubtf-direct", "bench.training.texture_fit"),
        ("neumip", "baselines.neumip"),
        ("rainer2019", "baselines.rainer2019"),
    ],
)
def test_codecs_hand_their_patience_to_the_fit(name: str, calls: str, monkeypatch: pytest.MonkeyPatch) -> None:
    codec = load_codec(name)(steps=700, patience=300)

    def train(objective: Any, fit: Fit, steps: int, patience: int = 0) -> float:
        raise TrainCalledError(steps, patience)

    monkeypatch.setattr(importlib.import_module(calls), "train", train)
    with pytest.raises(TrainCalledError) as call:
        codec.encode(tiny_btf(), Fit())
    assert call.value.args == (700, 300)
