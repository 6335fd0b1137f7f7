import re

import pytest

from bench.records import load_run
from reports.fits import fit_tables
from reports.series import plots_of

CURVE = [(10, 1.0, 29.0), (20, 2.5, 31.0), (30, 3.5, 30.5)]


def test_the_table_says_steps_seconds_and_memory(made):
    history = [{"step": step, "seconds": seconds, "psnr": psnr} for step, seconds, psnr in CURVE]
    run = load_run(
        made.job("a", history=history, fit_memory=3 << 20).job("b", history=[{"step": 1, "seconds": 1.0}]).folder
    )
    (table,) = fit_tables(run)
    assert table.rows == [["a", "30.50", "30", "3.5", "3", "20", "2.5", "—", "—"]]


@pytest.mark.parametrize(
    ("settings", "shares"), [({"direct": 0.6}, ["60"]), ({"direct": 0.0}, []), ({"direct": 0.6, "recipe": "paper"}, [])]
)
def test_a_plot_says_where_a_stage_of_a_fit_ends(made, settings, shares):
    run = load_run(made.job("neubtf steps=9", settings=settings).job("pca").folder)
    (plot,) = [plot for plot in plots_of(run) if plot["kind"] == "fits"]
    assert re.findall(r"neubtf: .* (\d+) %", plot["note"]) == shares
