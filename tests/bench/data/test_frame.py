import numpy as np
import pytest

from bench import cli
from bench.btf import BTF, ArraySource
from bench.conformance.check import tiny_btf
from bench.data.convert import write_btf
from bench.data.materials import load
from bench.data.portrait import mean_lobe
from bench.directions.hemisphere import from_degrees
from tests.tiers import long


def mirrored(btf, side="wi"):
    """The table as it is where one side's azimuths were noted clockwise."""
    turned = {"wo": btf.wo, "wi": btf.wi} | {side: getattr(btf, side) * np.array([1, -1, 1], np.float32)}
    return BTF("mirrored", turned["wo"], turned["wi"], btf.source)


@pytest.mark.parametrize("directions", [25, long(81)])
@pytest.mark.parametrize("name", ["satin", "leather", "gravel", "grass"])
def test_a_mirrored_side_is_told_from_the_frame_of_the_suite(name, directions):
    btf = load(name, 16, views=directions, lights=directions, heldout=0)
    lobe = mean_lobe(btf)
    assert lobe.difference_share > 0.6
    assert lobe.difference_share > 2 * lobe.sum_share
    assert not lobe.looks_mirrored
    for side in ("wo", "wi"):
        wrong = mean_lobe(mirrored(btf, side))
        assert wrong.looks_mirrored
        assert (wrong.difference_share, wrong.sum_share) == pytest.approx(
            (lobe.sum_share, lobe.difference_share), abs=1e-6
        )


def test_a_highlight_lies_in_the_mirror_direction_wherever_the_frame_is_turned():
    btf = load("satin", 16, views=81, lights=81, heldout=0)
    assert mean_lobe(btf).peak_deg == pytest.approx(180, abs=5)
    turn = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], np.float32)  # of the lights, by a quarter
    turned = mean_lobe(BTF("turned", btf.wo, btf.wi @ turn, btf.source))
    assert turned.peak_deg == pytest.approx(270, abs=30)  # half the step between the azimuths that are looked at


def test_what_cannot_be_checked_has_no_lobe():
    btf = tiny_btf(8, 9, 9)  # too few azimuths
    assert mean_lobe(btf) is None
    whole = load("satin", 8, views=25, lights=25, heldout=10)
    assert mean_lobe(whole) is not None  # the held-out pairs are no part of the product
    assert mean_lobe(whole.subset(np.arange(620))) is None  # no product
    ring = from_degrees(np.full(6, 60), np.arange(6) * 60)
    dark = np.zeros((36, 2, 2, 3), np.float32)
    wo, wi = np.repeat(ring, 6, 0), np.tile(ring, (6, 1))
    assert mean_lobe(BTF("dark", wo, wi, ArraySource(dark))) is None
    assert mean_lobe(BTF("matt", wo, wi, ArraySource(dark + 0.5))) is None


def test_info_tells_the_frame_and_warns_of_a_mirrored_one(tmp_path, capsys):
    btf = load("satin", 8, views=25, lights=25, heldout=0)

    def told(each):
        write_btf(each, tmp_path / f"{each.name}.npz")
        assert cli.main(["info", str(tmp_path / f"{each.name}.npz")]) == 0
        return capsys.readouterr().out

    assert "explains): 0.67" in told(btf)
    assert "mirrored" in told(mirrored(btf)).partition("warnings")[2]
    assert "not checked" in told(tiny_btf(8, 5, 5))  # too few pairs
