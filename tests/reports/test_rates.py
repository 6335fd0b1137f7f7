from bench.records import load_run
from reports.tables import all_tables


def test_each_codec_is_compared_with_each_other_at_equal_quality_and_at_equal_bytes(made):
    for i in range(5):
        for codec, size, quality in (("pca", 1000, 20.0), ("vq", 500, 20.0), ("relief", 1000, 50.0)):
            made.job(f"{codec} size={i}", psnr=quality + 3 * i, bytes={"total": size << i})
    made.job("table", psnr=60.0)
    made.job("vq beaten", psnr=20.5, bytes={"total": 1500})
    points, rates, quality = (table for table in all_tables(load_run(made.folder)) if table.kind == "rate")
    assert [name for name, _ in points.headers] == ["codec", "total", "bits per", "PSNR pooled"]
    assert [name for name, _ in rates.headers] == ["codec", "files", "1", "2", "3"]
    # Quality rises by 3 dB a doubling; relief reaches no quality of the others.
    assert rates.rows == [
        ["1 pca", "5 of 5", "", "+100", "—"],
        ["2 vq", "5 of 6", "-50", "", "—"],
        ["3 relief", "5 of 5", "—", "—", ""],
    ]
    assert [row[2:] for row in quality.rows] == [
        ["", "-3.00", "-30.00"],
        ["+3.00", "", "-27.00"],
        ["+30.00", "+27.00", ""],
    ]


def test_a_difference_that_rests_on_little_stands_in_brackets(made):
    for i in range(4):
        made.job(f"pca size={i}", psnr=20.0 + 3 * i, bytes={"total": 1000 << i})
        made.job(f"vq size={i}", psnr=28.0 + 3 * i, bytes={"total": 6000 << i})
    *_, rates, quality = (table for table in all_tables(load_run(made.folder)) if table.kind == "rate")
    assert rates.rows[1][2].startswith("(")
    assert quality.rows[1][2].startswith("(")


def test_one_ladder_has_no_table(made):
    for i in range(5):
        made.job(f"pca size={i}", psnr=20.0 + i, bytes={"total": 1000 << i})
    assert not [table for table in all_tables(load_run(made.folder)) if table.kind == "rate"]
