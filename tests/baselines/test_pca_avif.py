import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from baselines.pca import PCA
from baselines.pca_avif import PCAAvif
from bench.codec import Fit
from bench.conformance.check import tiny_btf
from bench.inputs.errors import InputError
from tests.baselines.made import slices, stored, table


@pytest.mark.long
def test_at_the_best_quality_it_answers_as_pca(tmp_path: Path) -> None:
    btf = tiny_btf()
    (tmp_path / "pca").mkdir()
    expected = slices(stored(PCA(components=4), btf, tmp_path / "pca"), btf)
    found = slices(stored(PCAAvif(components=4, quality=100), btf, tmp_path), btf)
    error = np.linalg.norm(expected - table(btf))
    assert np.linalg.norm(found - table(btf)) <= 1.1 * error


@pytest.mark.long
def test_a_lower_quality_takes_fewer_bytes_and_answers_worse() -> None:
    btf = tiny_btf()
    sizes = [len(PCAAvif(quality=quality).encode(btf, Fit()).texture["coefficients"]) for quality in (100, 70, 20)]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-1] < sizes[0]


@pytest.mark.parametrize("data", [b"", b"no picture", "png", "larger"])
def test_bytes_that_are_no_picture_of_this_size_are_refused(data: bytes | str) -> None:
    codec = PCAAvif(components=2)
    parts = codec.encode(tiny_btf(), Fit())
    if isinstance(data, str):
        file = io.BytesIO()
        Image.new("L", (500, 500)).save(file, "PNG" if data == "png" else "AVIF")
        data = file.getvalue()
    changed = torch.frombuffer(bytearray(data), dtype=torch.uint8) if data else torch.zeros(0, dtype=torch.uint8)
    wrong = replace(parts, texture=parts.texture | {"coefficients": changed})
    with pytest.raises(ValueError, match="picture"):
        codec.decode(wrong, torch.device("cpu"))


def test_more_components_than_a_picture_has_room_for_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("baselines.pca_avif.MOST_SIDE", 10)
    with pytest.raises(InputError, match="fewer components"):
        PCAAvif(components=8).encode(tiny_btf(), Fit())
