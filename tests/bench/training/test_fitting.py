import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from bench.btf import BTF
from bench.codec import Fit
from bench.conformance.check import tiny_btf
from bench.inputs.errors import InputError
from bench.training import fitting as training
from bench.training import samples as sampling
from bench.training.fitting import DivergedError, Objective, better_start, train
from bench.training.optimiser import ParameterGroup
from bench.training.samples import Batch, Samples, gain_of


@pytest.fixture(scope="module")
def btf() -> BTF:
    return tiny_btf()


class Mean(Objective):
    def __init__(self, samples: Samples, lr: float = 0.1):
        super().__init__(samples, None)
        self.lr = lr
        self.colour = nn.Parameter(torch.zeros(samples.texels, 3))
        self.calls = 0
        self.bad_calls: set[int] = set()
        self.stop_at = -1

    def groups(self) -> list[ParameterGroup]:
        return [{"params": [self.colour], "lr": self.lr}]

    def predict(self, batch: Batch, progress: float) -> Tensor:
        return self.colour[batch.texel]

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        self.calls += 1
        if self.calls == self.stop_at:
            raise KeyboardInterrupt
        batch = self.samples.draw(256, generator)
        loss = (self.predict(batch, progress) - batch.target).square().mean()
        return loss * torch.nan if self.calls in self.bad_calls else loss


def objective(btf: BTF, **settings: Any) -> Mean:
    return Mean(Samples(btf, gain_of(btf, Fit()), Fit()), **settings)


@pytest.mark.parametrize("memory_limit", [1 << 20, 0])
def test_samples_are_the_log_of_the_data(btf: BTF, memory_limit: int) -> None:
    samples = Samples(btf, 2.5, Fit(), memory_limit)
    batch, again, many = (samples.draw(count, torch.Generator().manual_seed(1)) for count in (500, 500, 20_000))
    assert torch.equal(batch.target, again.target)
    assert (many.texel.unique().tolist(), many.pair.unique().tolist()) == (list(range(64)), list(range(len(btf))))
    truth = btf.gather(batch.pair.numpy(), *np.divmod(batch.texel.numpy(), btf.shape[1]))
    # Values in memory are half floats: 2⁻¹¹ of each.
    np.testing.assert_allclose(batch.target, np.log1p(2.5 * truth), rtol=5e-4, atol=1e-6)
    texels = torch.tensor([5, 60])
    every = samples.abrdfs(texels)
    assert every.shape == (2, len(btf), 3)
    one = samples.at(texels, torch.tensor([7, 8])).target
    torch.testing.assert_close(every[[0, 1], [7, 8]], one, rtol=1e-6, atol=1e-6)


def test_a_fit_finds_the_mean_and_says_how(btf: BTF) -> None:
    shown: list[tuple[str, int, int]] = []
    fit = Fit(show=lambda label, done, total: shown.append((label, done, total)))
    mean = objective(btf)
    train(mean, fit, 600)
    truth = np.log1p(mean.samples.gain * np.stack(list(btf))).mean(0).reshape(-1, 3)
    # The samples of the last steps, some dozens a texel, scatter by about 0.3: their mean by a few hundredths.
    assert np.abs(mean.colour.detach().numpy() - truth).max() < 0.1
    assert [point["step"] for point in fit.history] == [100, 200, 300, 400, 500, 600]
    assert fit.history[-1]["psnr"] > fit.history[0]["psnr"]
    assert all(a["seconds"] < b["seconds"] for a, b in zip(fit.history, fit.history[1:], strict=False))
    assert "dB" in shown[-1][0]
    assert shown[-1][1:] == (600, 600)


@pytest.mark.parametrize("killed", [1, 150, 399])
def test_a_killed_fit_goes_on_to_the_same_result(
    btf: BTF, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, killed: int
) -> None:
    monkeypatch.setattr(training, "SAVE_SECONDS", 0.0)
    whole = objective(btf)
    train(whole, Fit(), 400)

    state = tmp_path / "runs" / "state"
    halted = objective(btf)
    halted.stop_at = killed
    with pytest.raises(KeyboardInterrupt):
        train(halted, Fit(checkpoint=state), 400)
    assert state.exists() == (killed > 100)
    resumed, fit = objective(btf), Fit(checkpoint=state)
    train(resumed, fit, 400)
    assert torch.equal(resumed.colour, whole.colour)
    assert [point["step"] for point in fit.history] == [100, 200, 300, 400]
    assert [path.name for path in state.parent.iterdir()] == ["state"]


def test_the_state_of_another_fit_is_refused(btf: BTF, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "SAVE_SECONDS", 0.0)
    state = tmp_path / "state"
    halted = objective(btf)
    halted.stop_at = 150
    with pytest.raises(KeyboardInterrupt):
        train(halted, Fit(checkpoint=state), 400)
    with pytest.raises(InputError, match="another fit"):
        train(Mean(Samples(tiny_btf(4), 1.0, Fit())), Fit(checkpoint=state), 400)
    state.write_bytes(b"nonsense")
    with pytest.raises(InputError, match="state"):
        train(objective(btf), Fit(checkpoint=state), 400)
    with pytest.raises(InputError, match="steps = 0"):
        train(objective(btf), Fit(), 0)


def test_a_fit_that_diverges_once_goes_back_and_slows_down(btf: BTF, caplog: pytest.LogCaptureFixture) -> None:
    mean = objective(btf)
    mean.bad_calls = {250}
    with caplog.at_level(logging.WARNING):
        train(mean, Fit(), 400)
    assert mean.colour.isfinite().all()
    assert mean.calls == 500  # steps 200 to 300 were taken twice
    assert "step 200 " in caplog.text
    mean.bad_calls = set(range(2000))
    with pytest.raises(DivergedError, match="4 times"):
        train(mean, Fit(), 400)


def test_a_fit_that_ran_away_has_diverged_though_every_number_is_finite(
    btf: BTF, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(DivergedError), caplog.at_level(logging.WARNING):
        train(objective(btf, lr=1e6), Fit(), 200)
    assert "learning rate" in caplog.text


def test_a_fit_whose_parameters_ran_away_has_diverged_though_its_answers_are_small(btf: BTF) -> None:
    mean = objective(btf, lr=1e15)
    mean.predict = lambda batch, progress: mean.colour[batch.texel].clamp(0, 1)  # type: ignore[method-assign]
    with pytest.raises(DivergedError, match="4 times"):
        train(mean, Fit(), 200)


def test_a_patient_fit_ends_where_its_curve_is_flat_and_says_so(btf: BTF, monkeypatch: pytest.MonkeyPatch) -> None:
    for patience, steps in ((200, 300), (0, 2000)):
        mean, fit = objective(btf), Fit()
        monkeypatch.setattr(mean, "rate", lambda step, steps, group: 1.0 if step < 100 else 0.0)
        assert train(mean, fit, 2000, patience) == steps / 2000
        assert (fit.history[-1]["step"], "ended" in fit.history[-1]) == (steps, patience > 0)
    assert train(objective(btf, lr=1e-3), Fit(), 400, patience=100) == 1  # it still gains


def test_a_fit_that_stands_still_says_so(btf: BTF, caplog: pytest.LogCaptureFixture) -> None:
    for rate, stands_still in ((0.0, True), (0.01, False)):
        caplog.clear()
        fit = Fit()
        train(objective(btf, lr=rate), fit, 600)
        assert bool(fit.faults) == stands_still
        assert ("stands still" in caplog.text) == stands_still


def test_the_rate_warms_up_and_ends_at_nothing() -> None:
    rates = [training.rate(step, 1000) for step in range(1000)]
    assert rates[0] < 0.011
    assert max(rates) == pytest.approx(rates[100], rel=1e-6)
    assert rates[-1] < 1e-5


def test_the_levels_of_detail_are_made_in_one_reading_and_are_those_made_one_by_one(btf: BTF) -> None:
    starts: list[bool] = []
    levels = Samples.levels(btf, 3, 2.5, Fit(show=lambda label, done, total: starts.append(done == 0)))
    assert sum(starts) == 1
    for level, samples in enumerate(levels):
        single = Samples(btf.downsample(2**level), 2.5, Fit())
        assert samples.table is not None
        torch.testing.assert_close(samples.table, single.table, rtol=0, atol=0)


def test_coarser_levels_of_a_large_btf_are_kept_at_some_of_its_pairs(btf: BTF, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampling, "COARSE_PAIRS", 6)
    monkeypatch.setattr(sampling, "MEMORY_LIMIT", 6 * (btf.shape[0] // 2) * (btf.shape[1] // 2) * 6)
    finest, coarse, _ = Samples.levels(btf, 3, 2.5, Fit())
    assert (finest.table, finest.pairs) == (None, len(btf))
    assert coarse.table is not None
    assert coarse.pairs == 6
    batch = coarse.draw(50, torch.Generator().manual_seed(0))
    for texel, pair, target in zip(*batch, strict=True):
        same = (np.abs(btf.wo - coarse.wo[pair].numpy()) + np.abs(btf.wi - coarse.wi[pair].numpy())).sum(1).argmin()
        truth = np.log1p(2.5 * btf.downsample(2)[int(same)].reshape(-1, 3)[int(texel)])
        np.testing.assert_allclose(target, truth, rtol=5e-4, atol=1e-6)


def test_the_better_of_two_starts_goes_on(btf: BTF) -> None:
    fit = Fit(seed=3)
    rates: dict[int, float] = {}  # by seed: the first start hardly moves

    def made(start: Fit) -> Mean:
        rates.setdefault(start.seed, 1e-6 if not rates else 0.1)
        return objective(btf, lr=rates[start.seed])

    chosen = better_start(made, fit, steps=40)
    assert [*rates] == [3, chosen.seed]
    assert chosen.history is fit.history
    assert fit.history == []  # short starts leave no points on the curve
    rates.clear()
    rates |= {3: 0.1, chosen.seed: 1e-6}
    assert better_start(made, fit, steps=40).seed == 3
