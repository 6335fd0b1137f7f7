"""Steps that are replayed as graphs, on an emulated GPU: the same files as step by step."""

from typing import Any

import pytest
import torch
from torch import Tensor

from bench.codec import Fit, Parts, settings_dict
from bench.codecs import shared
from bench.codecs.registry import load_codec
from bench.data.materials import load
from bench.training import replay
from neubtf.direct import Direct
from tests.tiers import short_for

SMALL = {"steps": 10, "batch": 32, "patch": 2, "channels": 2, "latents": 2, "fine": 2, "coarse": 2, "texels": 8}
SETTINGS: dict[str, dict[str, Any]] = {  # of every learned codec; a word after the name is a case
    "bcf": {},
    "biplane": {},
    "hierarchical": {},
    "hierarchical paper": {"recipe": "paper"},
    "neubtf": {"steps": 40, "explore": 0.5, "keep_scale": 1.0},
    "neubtf-direct": {"half": 2, "offset": 4, "loss": "display", "weights": "int8"},
    "neumip": {"weights": "int8"},
    "neumip paper": {"recipe": "paper"},
    "neuralbtf": {},
    "ntc": {"rounding": "noise"},
    "rainer2019": {},
    "relief": {"relief": False},
    "svbrdf": {},
    "relief height": {"steps": 24},
    "triple-plane": {},
    "zeltner2024": {},
}


@pytest.fixture
def kinds(monkeypatch: pytest.MonkeyPatch) -> dict[Any, replay.Program]:
    """The kinds of steps of all fits of a test."""
    found = dict[Any, replay.Program]()
    take = replay.Steps.take

    def noted(self: replay.Steps, progress: float, rates: list[float]) -> Tensor:
        loss = take(self, progress, rates)
        found.update(self.programs)
        return loss

    monkeypatch.setattr(replay.Steps, "take", noted)
    return found


def fitted(called: str, device: torch.device) -> Parts:
    name = called.split()[0]
    kind = load_codec(name)
    settings = {key: value for key, value in SMALL.items() if key in settings_dict(kind())}
    codec = kind(**settings | SETTINGS[called])
    size, views = (16, 9) if called == "relief height" else (8, 5)  # of the smaller no height stands
    btf = load("cable-knit", size, views=views, lights=5, heldout=0)
    return codec.encode(btf, Fit(device=device, network=shared.find_for(codec)))


def step_by_step(name: str, device: torch.device, monkeypatch: pytest.MonkeyPatch) -> Parts:
    with monkeypatch.context() as patched:
        patched.setattr(replay, "records_graphs", lambda device: False)
        return fitted(name, device)


def require_equal(ours: Parts, theirs: Parts) -> None:
    for part in ("decoder", "texture", "other"):
        torch.testing.assert_close(getattr(ours, part), getattr(theirs, part), rtol=0, atol=0)


@pytest.mark.parametrize("name", short_for(SETTINGS, "bcf"))
def test_replayed_steps_give_the_same_file(
    name: str, gpu: torch.device, kinds: dict[Any, replay.Program], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("baselines.relief.codec.RENEWED_EVERY", 3)  # also between steps that are replayed
    monkeypatch.setattr("baselines.relief.codec.HEIGHT_RATE", 1.0)  # so that few steps move it by what a file can hold
    ours = fitted(name, gpu)
    replayed = {phase for (phase, _), program in kinds.items() if program.replay is not None}
    assert replayed == {phase for phase, _ in kinds} != set()
    assert ("height" in ours.texture) == (name == "relief height")
    require_equal(ours, step_by_step(name, gpu, monkeypatch))


@pytest.mark.long
@pytest.mark.parametrize("fault", ["waits", "changes numbers on the host"])
def test_a_step_that_cannot_be_recorded_is_taken_without_a_graph(
    fault: str, gpu: torch.device, kinds: dict[Any, replay.Program], monkeypatch: pytest.MonkeyPatch
) -> None:
    loss = Direct.loss

    def changed(self: Direct, generator: torch.Generator, progress: float) -> Tensor:
        found = loss(self, generator, progress)
        if fault == "waits":
            return found * (1 if found.isfinite() else 0)
        noise = torch.rand(2, generator=generator) * 2
        return found * noise.to(found.device).mean()

    monkeypatch.setattr(Direct, "loss", changed)
    ours = fitted("neubtf-direct", gpu)
    assert not any(program.replay for program in kinds.values())
    require_equal(ours, step_by_step("neubtf-direct", gpu, monkeypatch))


@pytest.mark.long
def test_kinds_beyond_the_most_are_taken_without_a_graph(
    gpu: torch.device, kinds: dict[Any, replay.Program], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replay, "MOST_GRAPHS", 1)
    ours = fitted("neubtf-direct", gpu)
    assert [program.replay is not None for program in kinds.values()] == [True, False]
    require_equal(ours, step_by_step("neubtf-direct", gpu, monkeypatch))


def test_the_host_may_give_a_plan_alone() -> None:
    with replay.Drawing(torch.Generator()):
        given = replay.on_host(lambda progress: replay.FromHost([], plan=progress), 0.5, torch.device("cpu"))
        assert torch.ones(2).sum() == 2  # any operation after it
    assert given.plan == 0.5
