"""How codecs stand over materials."""

from bench.compare.standings import standings


def jobs(*psnrs):
    return [
        {"scores": {"all": {"metrics": {"psnr_display": {"mean": psnr, "exact": 4 * (psnr == 100), "slices": 4}}}}}
        for psnr in psnrs
    ]


def test_ranks_are_means_over_materials_and_what_reads_alike_shares_one():
    cells = {
        "a": {"x": jobs(30.0, 32.0), "y": jobs(31.001), "z": jobs(20.0)},
        "b": {"x": jobs(25.0), "y": jobs(20.0), "z": jobs(21.0)},
    }
    x, y, z = standings(cells)
    assert (x.label, x.rank, x.wins, x.psnr, x.materials) == ("x", 1.25, 2, 28.0, 2)
    assert (y.label, y.rank, y.wins) == ("y", 2.25, 1)
    assert (z.label, z.rank, z.wins) == ("z", 2.5, 0)


def test_no_error_is_the_best_and_who_lacks_a_material_is_not_ranked():
    cells = {"a": {"pca": jobs(30.0), "table": jobs(100.0)}}
    cells["b"] = {"part": jobs(9.0), "table": jobs(100.0), "pca": jobs(8.0), "none": []}
    table, pca, part = standings(cells)
    assert (table.label, table.psnr, table.rank, table.wins) == ("table", 100.0, 1.0, 2)
    assert (pca.label, pca.rank, part.label, part.rank, part.materials) == ("pca", 2.0, "part", None, 1)
    assert standings({}) == []
