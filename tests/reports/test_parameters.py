from bench.records import load_run
from reports import parameters_text, table_text
from reports.parameters import parameters_table


def job(codec, parameters, channels, label=""):
    cost = {"texture_channels": channels}
    return {"status": "ok", "codec": codec, "label": label or codec, "parameters": parameters, "cost": cost}


def test_ours_stand_beside_the_paper_s_with_the_difference():
    jobs = [job("rainer2020", 38_269, 38), job("neubtf", 3_011, 14), job("pca", 0, 16), job("neumip", 3_254, 14)]
    table = parameters_table(jobs)
    assert table.rows == [
        ["NeuBTF", "neubtf", "3,011", "3,011", "0", "14", "14", "0"],
        ["NeuMIP", "neumip", "3,254", "3,332", "-78", "14", "14", "0"],
        ["Rainer 2020", "rainer2020", "38,269", "38,269", "0", "38", "38", "0"],
    ]
    assert "Channels of Rainer 2020: 32 latents, and the mean and the deviation" in " ".join(table.notes)
    assert table.notes[-1].endswith(
        "Rainer 2019, Zeltner 2024, Triple plane, Biplane, NeuralBTF: no codec of it has been measured."
    )


def test_decoders_that_differ_are_told_apart_and_equal_ones_are_one_row():
    jobs = [
        job("neumip", 3_332, 14, "neumip steps=9"),
        job("neumip", 3_332, 14),
        job("neumip", 3_254, 14, "neumip outputs=3"),
    ]
    assert [row[1:3] for row in parameters_table(jobs).rows] == [
        ["neumip steps=9", "3,332"],
        ["neumip outputs=3", "3,254"],
    ]


def test_it_is_one_of_a_run_s_tables_and_has_every_format(made):
    made.start().job("neubtf-direct").job("pca components=8")
    text = table_text(made.folder, kind="parameters")
    assert text.count("3,011") == 2
    jobs = load_run(made.folder).jobs
    assert parameters_text(jobs) == text
    assert parameters_text(jobs, "csv").splitlines()[1] == "NeuBTF,neubtf-direct,3011,3011,0,14,14,0"
    assert "| NeuBTF" in parameters_text(jobs, "markdown")
    assert "3,011" in parameters_text(jobs, "latex")


def test_a_run_without_such_codecs_has_no_such_table(made):
    made.start().job()
    assert table_text(made.folder, kind="parameters").strip() == ""
