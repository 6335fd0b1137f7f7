from pathlib import Path

import pytest

from bench import cli
from bench.cli.commands.table import _is_of_one_thread
from bench.compare.frame import gpu_times
from bench.inputs.errors import InputError
from bench.records import Run
from reports import parameters_text
from reports.choice import Choice
from reports.parameters import parameters_table


def job(codec, parameters, channels, label="", run="1", **settings):
    counts = {"parameters": parameters, "cost": {"texture_channels": channels}, "settings": settings}
    label = label or codec
    return {"status": "ok", "job": label, "codec": codec, "label": label} | counts | ({"run": run} if run else {})


def test_ours_stand_beside_the_paper_s_with_the_difference():
    jobs = [job("rainer2020", 38_269, 38), job("neubtf", 3_011, 14), job("pca", 0, 16), job("neumip", 3_254, 14)]
    table = parameters_table(jobs)
    assert table.rows == [
        ["NeuBTF", "neubtf", "3,011", "3,011", "0", "14", "14", "0"],
        ["NeuMIP", "neumip", "3,254", "3,332", "-78", "14", "14", "0"],
        ["Rainer 2020", "rainer2020", "38,269", "38,269", "0", "38", "38", "0"],
    ]
    page = (Path(__file__).parents[2] / "docs" / "metrics.md").read_text(encoding="utf-8")
    assert "| Rainer 2020 | 32 latents, and the same 6 |" in page
    assert "Biplane, NeuralBTF: " in table.notes[-1]


def test_a_decoder_has_the_times_of_any_settings_that_leave_it_alike():
    fused = job("neubtf", 3_011, 14, "neubtf steps=9") | {"ns": {"fused": 144.2}}
    table = parameters_table([job("neubtf", 3_011, 14) | {"ns": {"eager": 387.0}}, fused, job("neumip", 3_332, 14)])
    assert [row[-3:] for row in table.rows] == [["387", "144", "251.4 ± 44.8"], ["—"] * 3]


def test_the_time_of_a_row_is_that_of_the_job_that_names_it():
    other = job("neubtf", 3_011, 14, "neubtf texels=2") | {"ns": {"eager": 900.0}}
    for jobs in ([job("neubtf", 3_011, 14) | {"ns": {"eager": 400.0}}, other], [other]):
        (row,) = parameters_table(jobs).rows
        assert row[-3] == ("400" if len(jobs) > 1 else "900")


def test_times_of_a_gpu_or_of_two_threads_are_none_of_one_processor_thread():
    timing = {"device": "cpu", "threads": 1}
    assert [_is_of_one_thread(timing | more) for more in ({}, {"threads": 2}, {"device": "cuda"})] == [
        True,
        False,
        False,
    ]


def test_a_time_on_a_gpu_stands_beside_the_paper_s_with_the_name_of_the_gpu():
    timed = job("neubtf", 3_011, 14) | {"ns": {"eager": 387.0, "gpu": 2.497}, "gpu": "NVIDIA H100"}
    table = parameters_table([timed, job("neumip", 3_332, 14)])
    assert [row[-4:] for row in table.rows] == [["387", "—", "2.5", "251.4 ± 44.8"], ["—"] * 4]
    assert "GPU: NVIDIA H100;" in table.notes[-1]


def test_the_time_on_a_gpu_is_that_of_the_quickest_execution_in_float32():
    def timing(execution, dtype, batch, ns, device="cuda"):
        of = {"label": "neubtf", "of_tolerance": 0.1, "execution": execution, "dtype": dtype, "batch": batch}
        return of | {"device": device, "ns_per_sample": ns}

    timings = [timing("eager", "float32", 64, 5.0), timing("compiled", "float32", 64, 2.5)]
    timings += [timing("compiled", "float16", 64, 2.0), timing("eager", "float32", 16, 1.0)]  # most are of 64
    timings += [timing("eager", "float32", 64, 0.5, "cpu")]
    assert gpu_times(Run(Path(), timings=timings)) == {"neubtf": timings[1]}


def test_every_count_of_the_papers_is_met_by_a_recipe_as_published(monkeypatch, capsys):
    monkeypatch.chdir(Path(__file__).parents[2])
    files = map(str, Path("docs/results").glob("*.jsonl"))
    assert cli.main(["table", "parameters", *files, "--format", "csv"]) == 0
    rows = [line.split(",") for line in capsys.readouterr().out.splitlines()[1:] if line.count(",") >= 7]
    first = {row[0]: row for row in reversed(rows)}
    published = {"NeuBTF": 3011, "NeuMIP": 3332, "Rainer 2019": 35725, "Rainer 2020": 38269, "Biplane": 136451}
    published |= {"Zeltner 2024 (code)": 819, "Triple plane": 3011, "Hierarchical": 8026, "NeuralBTF": 556038}
    assert {method: int(row[2]) for method, row in first.items() if row[4] == "0"} == published


def test_chosen_codecs_alone_are_shown_and_one_that_is_not_there_is_named():
    jobs = [job("neubtf", 3_011, 14), job("neumip", 3_332, 14, "neumip bits=2"), job("neumip", 3_254, 14)]
    text = parameters_text(jobs, "csv", Choice(codecs=["neumip bits=2"]))
    assert "neumip bits=2" in text
    assert "NeuBTF" not in text
    with pytest.raises(InputError, match=r"neumib.*neumip"):
        parameters_text(jobs, "csv", Choice(codecs=["neumib"]))
