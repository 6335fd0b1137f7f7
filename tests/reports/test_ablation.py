from bench.records import load_run
from reports.paper import ablation_table


def test_each_change_is_held_against_the_codec_as_it_is_on_every_material(made):
    made.start("2", suite="ablation")
    for material, psnr in (("satin", 30.0), ("wool", 25.0)):
        made.job("neubtf-direct steps=9", material, run="2", psnr=psnr)
        made.job("neubtf-direct activation=relu steps=9", material, run="2", psnr=psnr - 1.25)
    made.job("neubtf-direct loss=l1 steps=9", run="2", psnr=29.0)  # of the first material alone, so far
    made.job("neubtf steps=5", run="2", psnr=28.0).job("neubtf direct=0.0 steps=3", run="2", psnr=28.5)
    table = ablation_table(load_run(made.folder))
    rows = table.rows
    assert table.notes[-1].startswith("—: ")
    assert [row[:3] for row in rows] == [
        ["neubtf-direct", "as it is", "3,011"],
        ["neubtf-direct", "activation=relu", "3,011"],
        ["neubtf-direct", "loss=l1", "3,011"],
        ["neubtf", "as it is", "3,011"],
        ["neubtf", "direct=0.0 steps=3", "3,011"],
    ]
    assert rows[0][4:] == ["30.00", "", "0.750", "25.00", "", "0.750"]
    assert rows[1][4:] == ["28.75", "−1.25", "0.750", "23.75", "−1.25", "0.750"]
    assert rows[2][4:] == ["29.00", "−1.00", "0.750", "—", "", "—"]
    assert rows[4][4:] == ["28.50", "+0.50", "0.750", "—", "", "—"]


def test_the_codec_as_it_is_may_be_unfinished_and_a_setting_may_be_left_out(made):
    made.start("2", suite="ablation").unfinished("failed", "Error: no", label="neubtf-direct steps=9", run="2")
    made.job("neubtf-direct activation=relu steps=9", run="2")
    made.job("neubtf recipe=paper steps=9", run="2").job("neubtf steps=9", run="2")
    rows = ablation_table(load_run(made.folder)).rows
    assert [row[1] for row in rows] == ["activation=relu", "as it is", "without recipe=paper"]


def test_the_note_on_flop_stays_with_its_column_alone(made):
    made.start("2", suite="ablation").job("neubtf-direct steps=9", run="2")
    table = ablation_table(load_run(made.folder))
    place = table.headers.index(("a sample", "FLOP"))
    note = "FLOP: of the decoder's network."
    assert note in table.of_columns([0, 1, place]).notes
    assert note not in table.of_columns([0, 1, place + 1]).notes
