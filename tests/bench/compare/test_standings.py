from bench.compare.ranks import ranks, standings


def jobs(*psnrs):
    stats = [{"psnr_display": {"mean": psnr, "exact": 0, "slices": 4}} for psnr in psnrs]
    return [{"scores": {"all": {"metrics": each}}} for each in stats]


def test_ranks_are_means_over_materials_and_what_reads_alike_shares_one():
    cells = {
        "a": {"x": jobs(30.0, 32.0), "y": jobs(31.001), "z": jobs(20.0)},
        "b": {"x": jobs(25.0), "y": jobs(20.0), "z": jobs(21.0)},
    }
    x, y, z = standings(cells)
    assert (x.label, x.rank, x.wins, x.psnr, x.materials) == ("x", 1.25, 2, 28.0, 2)
    assert (y.label, y.rank, y.wins) == ("y", 2.25, 1)
    assert (z.label, z.rank, z.wins) == ("z", 2.5, 0)


def test_each_of_several_that_none_is_better_than_has_won():
    cells = {"a": {"x": jobs(30.0), "y": jobs(30.001), "z": jobs(30.002), "w": jobs(29.0)}}
    assert {each.label: (each.rank, each.wins) for each in standings(cells)} == {
        "x": (2.0, 1),
        "y": (2.0, 1),
        "z": (2.0, 1),
        "w": (4.0, 0),
    }


def test_ranks_say_nothing_of_one_codec_or_two_materials():
    scores = {"a": (30.0, 20.0, 25.0), "b": (31.0, 20.0, 27.0), "c": (29.0, 21.0, 20.0)}
    assert list(ranks(scores).mean) == ["b", "a", "c"]
    assert ranks({"a": (1.0, 2.0, 3.0)}) is ranks({"a": (1.0, 2.0), "b": (2.0, 1.0)}) is ranks({}) is None
