from bench.records import load_run
from reports.fits import fit_tables

CURVE = [(10, 1.0, 29.0), (20, 2.5, 31.0), (30, 3.5, 30.5)]


def test_the_table_says_steps_and_seconds_to_each_goal(made):
    history = [{"step": step, "seconds": seconds, "psnr": psnr} for step, seconds, psnr in CURVE]
    run = load_run(made.job("a", history=history).job("b", history=[{"step": 1, "seconds": 1.0}]).folder)
    (table,) = fit_tables(run)
    assert table.rows == [["a", "30.50", "30", "3.5", "20", "2.5", "—", "—"]]
