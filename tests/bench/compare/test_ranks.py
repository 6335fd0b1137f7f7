from bench.compare.ranks import ranks


def test_ranks_say_nothing_of_one_codec_or_two_materials():
    scores = {"a": (30.0, 20.0, 25.0), "b": (31.0, 20.0, 27.0), "c": (29.0, 21.0, 20.0)}
    assert list(ranks(scores).mean) == ["b", "a", "c"]
    assert ranks({"a": (1.0, 2.0, 3.0)}) is ranks({"a": (1.0, 2.0), "b": (2.0, 1.0)}) is ranks({}) is None
