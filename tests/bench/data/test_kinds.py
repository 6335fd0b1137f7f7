"""A kind of surface is one file: what it says is asked wherever kinds differ."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

import bench
from bench.codec import silent
from bench.data import kinds
from bench.data.kinds import kind_of
from bench.data.open import open_material, open_named
from bench.data.spec import MaterialSpec, Preparation
from bench.inputs.errors import InputError
from bench.records import kind_of as kind_of_job
from bench.records import load_run, pictures_are_free
from bench.runs.runner import Options, run
from bench.runs.suite import parse_suite
from reports import table_text

CHESS = '''"""Chess boards: a file that says how bright the squares are."""

import numpy as np

from bench.btf import ArraySource, BTF
from bench.data.kinds import Kind
from bench.directions.hemisphere import uniform


class Chess(Kind):
    rendered = True

    def knows(self, spec):
        return spec.path.endswith(".chess")

    def open(self, spec, data, show, draw, path_tracer):
        bright = float(spec.required_path().read_text())
        rng = np.random.default_rng(draw)
        wo, wi = uniform(rng, 12), uniform(rng, 12)
        squares = (np.indices((data.size, data.size)).sum(0) % 2)[None, ..., None] * np.ones((12, 1, 1, 3))
        values = (bright * squares * wi[:, 2, None, None, None]).astype(np.float32)
        notes = {"surface": "printed", "free": True}
        return BTF(spec.name, wo, wi, ArraySource(values), heldout=np.arange(12) >= 9, provenance=notes)

    def ignores(self, spec, key):
        return "every board has twelve pairs" if key == "data.views" else ""


KIND = Chess()
'''


@pytest.fixture
def board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A kind of surface in a folder of its own, and a surface of that kind."""
    folder = tmp_path / "more_kinds"
    folder.mkdir()
    (folder / "chess.py").write_text(CHESS)
    monkeypatch.setattr(kinds, "__path__", [*kinds.__path__, str(folder)])
    kinds._kinds.cache_clear()
    path = tmp_path / "board.chess"
    path.write_text("0.5")
    yield path
    kinds._kinds.cache_clear()


def test_a_kind_of_one_file_is_opened_run_and_told_in_tables(board: Path, tmp_path: Path) -> None:
    text = f"""
        threads = 1
        [[materials]]
        name = "board"
        path = {json.dumps(str(board))}
        [data]
        size = 8
        [[codecs]]
        codec = "mean-colour"
    """
    folder = tmp_path / "run"
    list(run(parse_suite("boards", text), Options(folder)))
    (job,) = load_run(folder).jobs
    assert job["status"] == "ok"
    assert (kind_of_job(job), kind_of_job({"provenance": {}})) == ("printed", "measured")
    assert pictures_are_free(job)
    assert "mean-colour" in table_text(folder, kind="main")


def test_what_a_kind_ignores_is_refused_and_its_test_pairs_are_drawn_anew(board: Path) -> None:
    with pytest.raises(InputError, match=r"data\.views: .*twelve"):
        open_named(str(board), {"data.views": "9"})
    spec = MaterialSpec("board", str(board))
    one, other = (open_material(spec, Preparation(size=8), silent, draw) for draw in (0, 1))
    assert one.fingerprint != other.fingerprint


def test_without_it_the_same_path_is_measured_data(tmp_path: Path) -> None:
    path = tmp_path / "board.chess"
    path.write_text("0.5")
    assert type(kind_of(MaterialSpec("board", str(path)))).__name__ == "Measured"
    assert kind_of(MaterialSpec("satin")).rendered
    assert not kind_of(MaterialSpec("a", "a.btf")).rendered


def test_the_bytes_of_a_bake_count_all_tables() -> None:
    data = Preparation(8, views=3, lights=2, heldout=5, validation=True, low_light=4, between=9)
    tables = data.tables("a", seed=0, draw=0)
    pairs = sum(len(table.pairs[0]) for table in tables)
    assert data.bytes_rendered == 12 * 8 * 8 * pairs


def test_the_library_takes_values_as_they_are(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    assert bench.open("satin", size=8, views=4, lights=4, heldout=3, validation=True).shape == (8, 8)
    with pytest.raises(InputError, match=r"data\.size: "):
        bench.open("satin", size="8")
