from pathlib import Path

from bench.compare.frame import EAGER, frame_of
from bench.records import Run, append, load_run
from bench.records.schema import setting_name
from reports import table_text
from reports.tables import all_tables
from reports.times import variant_tables

CONDITIONS = {"run": "1", "batch": 16384, "dtype": "float32", "threads": 1, "device": "cpu", "execution": "eager"}
CONDITIONS |= {"queries": "random", "texture_fetch": True, "ns_per_sample": 400.0, "interval95_ns": [390.0, 410.0]}


def test_budgets_use_the_times_of_settings_alone_where_there_are_any(made):
    """A time is that of a setting, and of the operations that a surface's file needs."""
    group = made._group(30.0)
    scores = {"heldout": group, "train": group, "validation": group}
    for label, flops in (("relief", 100), ("relief bits=2", 140), ("pca", 50)):
        cost = {"flops_per_sample": flops, "texture_channels": 1}
        made.job(label, "satin", scores=scores, cost=cost).timing(label, "satin", ratio_to_floor=99.0)
    assert set(frame_of(load_run(made.folder))[EAGER]) == {99.0}

    for label, flops, median in (("relief", 100, 8.0), ("relief", 140, 12.0), ("relief bits=2", 140, 13.0)):
        more = {"flops": flops, "rounds": [7.0, 8.0], "ratio_to_floor": median}
        append(made.folder, {"kind": "timing", "job": setting_name(label, flops), "label": label} | CONDITIONS | more)
    times = frame_of(load_run(made.folder)).set_index("job")[EAGER].dropna()
    assert times.to_dict() == {"satin/relief/0": 8.0, "satin/relief bits=2/0": 13.0}
    shown = table_text(made.folder, kind="times")
    assert shown.count("relief") == 3
    assert "pca" not in shown


def test_starts_without_a_name_as_references_have_them_leave_the_times_readable(made):
    append(made.folder, {"kind": "run", "suite": "made", "machine": {"processor": "of another run"}})
    more = {"flops": 50, "rounds": [7.0, 8.0], "ratio_to_floor": 7.5, "ratio_interval95": [7.0, 8.0]}
    append(made.folder, {"kind": "timing", "job": setting_name("pca", 50), "label": "pca"} | CONDITIONS | more)
    assert ": a processor, 1 thread" in table_text(made.folder, kind="times")


def test_a_timing_by_hand_that_names_no_execution_is_none_of_a_step(made):
    bare = {"kind": "timing", "job": "satin/pca/0", "run": "1", "ns_per_sample": 1.0, "interval95_ns": [1.0, 1.0]}
    append(made.job("pca").folder, bare)
    assert all_tables(load_run(made.folder), kind="times") == []


def test_a_batch_that_only_a_setting_of_one_batch_has_is_no_column():
    run = Run(Path())
    for label, batch in (("pca", 64), ("pca", 256), ("vq", 64), ("ntc", 1024)):
        timing = CONDITIONS | {"job": f"{label}/{batch}", "label": label, "batch": batch, "of_tolerance": 0.1}
        run.timings.put(timing["job"], timing)
    (batches,) = [table for table in variant_tables(run, "times") if table.title.startswith("Batches")]
    assert [name for name, _ in batches.headers[2:]] == ["64", "256"]


def test_each_device_has_tables_of_its_own():
    run = Run(Path())
    for device, ns in (("cpu", 1000.0), ("cuda", 2.0)):
        timing = CONDITIONS | {"job": f"pca/{device}", "label": "pca", "device": device, "of_tolerance": 0.1}
        run.timings.put(timing["job"], timing | {"ns_per_sample": ns, "limit_ns": ns / 2})
    on_cpu, on_gpu = variant_tables(run, "times")
    assert (on_cpu.rows, on_gpu.rows) == ([["pca", "1,000, 50"]], [["pca", "2.00, 50"]])


def setting(label, flops, ratio, **more):
    """The time of a setting, × floor."""
    of = {"kind": "timing", "job": setting_name(label, flops), "label": label, "flops": flops}
    return of | CONDITIONS | {"rounds": [ratio, ratio], "ratio_to_floor": ratio} | more


def test_a_setting_that_needs_other_operations_since_has_no_row_of_before(made):
    for one in (setting("pca", 50, 5.0), setting("neumip", 900, 12.0), setting("neumip", 400, 6.0, run="2")):
        append(made.folder, one)
    shown = table_text(made.folder, kind="times")
    assert ("5.00" in shown, "6.00" in shown, "12.0" in shown) == (True, True, False)


def test_times_of_settings_under_other_conditions_have_a_table_of_their_own(made):
    append(made.folder, setting("pca", 50, 5.0))
    append(made.folder, setting("neumip", 400, 60.0, device="cuda", gpu="NVIDIA H200", batch=2**20))
    on_cpu, on_gpu = all_tables(load_run(made.folder), kind="times")
    assert ([row[0] for row in on_cpu.rows], [row[0] for row in on_gpu.rows]) == (["pca"], ["neumip"])
    assert ("NVIDIA H200" in on_cpu.title, "NVIDIA H200" in on_gpu.title) == (False, True)
