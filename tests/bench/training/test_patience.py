import importlib
from typing import Any

import pytest

from bench.codec import Fit
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf

CALLS = {
    "neubtf-direct": "bench.training.texture_fit",
    "neumip": "baselines.neumip",
    "rainer2019": "baselines.rainer2019",
}


@pytest.mark.parametrize("name", CALLS)
def test_codecs_hand_their_patience_to_the_fit(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def train(objective: Any, fit: Fit, steps: int, patience: int = 0) -> float:
        raise KeyboardInterrupt(steps, patience)

    monkeypatch.setattr(importlib.import_module(CALLS[name]), "train", train)
    with pytest.raises(KeyboardInterrupt) as call:
        load_codec(name)(steps=700, patience=300).encode(tiny_btf(), Fit())
    assert call.value.args == (700, 300)
