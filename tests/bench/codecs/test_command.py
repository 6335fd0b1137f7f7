import sys
import textwrap

import pytest

from bench import cli
from bench.codecs import container, loading
from bench.codecs.command import ProgramMaterial, Programs
from bench.inputs.errors import CodecError, ContainerError, InputError
from bench.records import load_run

ENCODE = """
    import sys, numpy as np
    btf, files = np.load(sys.argv[1]), sys.argv[2]
    btf["radiance"].mean(0).astype("<f2").tofile(files + "/mean.bin")
    open(files + "/size", "w").write("%d %d" % btf["radiance"].shape[1:3])
"""
DECODE = """
    import sys, numpy as np
    height, width = map(int, open(sys.argv[1] + "/size").read().split())
    mean = np.fromfile(sys.argv[1] + "/mean.bin", "<f2").reshape(height, width, 3).astype("<f4")
    for line in sys.stdin:
        queries, answers = line.rstrip("\\n").split("\\t")
        uv = np.load(queries)[:, :2]
        rows, columns = ((1 - uv[:, 1]) * height).astype(int) % height, (uv[:, 0] * width).astype(int) % width
        np.save(answers, mean[rows, columns])
        print("ok", flush=True)
"""


def suite(place, encode=ENCODE, decode=DECODE):
    for name, text in (("encode", encode), ("decode", decode)):
        (place / f"{name}.py").write_text(textwrap.dedent(text))
    run = f"{sys.executable} {place}"
    text = f"""
        materials = ["satin"]
        data = {{size = 12, views = 5, lights = 5, heldout = 8}}
        [[codecs]]
        codec = "command"
        called = "mine"
        encode = "{run}/encode.py {{btf}} {{files}}"
        decode = "{run}/decode.py {{files}}"
        [[codecs]]
        codec = "mean-colour"
    """
    (place / "suite.toml").write_text(text)
    return str(place / "suite.toml")


@pytest.fixture(autouse=True)
def brief(monkeypatch, undrawn):
    monkeypatch.setattr("bench.timing.TURNS", 3)
    monkeypatch.delenv("NEUBTF_PERMIT", raising=False)


@pytest.mark.long
def test_programs_are_scored_as_a_codec_is(tmp_path, capsys):
    assert cli.main(["run", suite(tmp_path), "--out", str(tmp_path / "run")]) == 0
    run = load_run(tmp_path / "run")
    mine, known = run.job("satin/mine/0"), run.job("satin/mean-colour/0")
    assert (mine["status"], mine["codec"], mine["called"]) == ("ok", "command", "mine")
    assert mine["bytes"]["texture"] == 12 * 12 * 3 * 2 + len("12 12")  # the files, to the byte
    assert mine["bytes"]["total"] == (tmp_path / "run" / mine["file"]).stat().st_size
    ours, theirs = (job["scores"]["heldout"]["metrics"]["psnr_display"]["pooled"] for job in (mine, known))
    assert ours == pytest.approx(theirs, abs=1e-6)
    assert mine["parameters"] is None
    assert run.timing(mine) is None
    assert run.timing(known)["ns_per_sample"] > 0
    assert mine["program"]["queries"] >= 12 * 12 * (25 + 8)  # every slice, and the coarser ones
    assert mine["program"]["ns_per_query"] > 0
    assert "program" not in known
    capsys.readouterr()
    assert cli.main(["results", "add", str(tmp_path / "run"), str(tmp_path / "records.jsonl")]) == 2
    assert "records.jsonl: " in capsys.readouterr().err
    assert cli.main(["results", "add", str(tmp_path / "run"), str(tmp_path / "kept.jsonl")]) == 0
    assert cli.main(["table", "main", str(tmp_path / "kept.jsonl")]) == 0
    shown = capsys.readouterr().out
    assert f"{mine['program']['ns_per_query']:,.0f} ns" in " ".join(shown.split())


@pytest.mark.long
def test_a_changed_program_is_not_answered_from_earlier_files(tmp_path):
    assert cli.main(["run", suite(tmp_path), "--out", str(tmp_path / "run")]) == 0
    before = load_run(tmp_path / "run").job("satin/mine/0")
    assert cli.main(["run", suite(tmp_path, ENCODE.replace("mean(0)", "max(0)")), "--out", str(tmp_path / "run")]) == 0
    after = load_run(tmp_path / "run").job("satin/mine/0")
    assert after["score_key"]["sha256"] != before["score_key"]["sha256"]


ANSWER = "mean[rows, columns]"
FAILURES = [
    ({"encode": "import sys; sys.exit('no licence')"}, "code 1: no"),
    ({"decode": DECODE.replace(ANSWER, f"{ANSWER} / 0.0")}, "finite"),
    ({"encode": "pass"}, "wrote no"),
    ({"encode": "import os, sys; os.mkdir(sys.argv[2] + '/inner')"}, "inner in"),
    ({"decode": "raise SystemExit('no licence')"}, "no licence"),
    ({"decode": DECODE.replace(ANSWER, "mean[rows, columns, :2]")}, "instead of"),
    ({"decode": DECODE.replace("np.save(answers", "open(answers, 'w').write('text'), (lambda *_: 0)(answers")}, "read"),
]


@pytest.mark.parametrize(
    ("programs", "why"), [*FAILURES[:2], *(pytest.param(*each, marks=pytest.mark.long) for each in FAILURES[2:])]
)
def test_a_program_that_fails_is_a_failed_job_that_says_why(tmp_path, programs, why):
    assert cli.main(["run", suite(tmp_path, **programs), "--out", str(tmp_path / "run")]) == 3
    run = load_run(tmp_path / "run")
    assert why in run.job("satin/mine/0")["error"]
    assert run.job("satin/mean-colour/0")["status"] == "ok"


@pytest.mark.parametrize("first", ["", 'sys.stdout.write("half a line"); sys.stdout.flush(); '])
def test_a_program_that_does_not_answer_is_ended(first):
    command = f"{sys.executable} -c 'import sys, time; {first}time.sleep(3600)' {{files}}"
    material = ProgramMaterial((4, 4), {}, command, 0.2)
    with pytest.raises(CodecError, match=r"seconds.*0\.2"):
        material.slice([0.0, 0.0, 1.0], [0.0, 0.0, 1.0])
    process, folder = material.process, material.folder
    del material
    assert process.poll() is not None
    assert not folder.exists()


@pytest.mark.parametrize(
    ("answers", "why"),
    [("np.full((n, 3), 'a')", "cannot be read"), ("np.full((n, 3), 1e300)", "finite"), ("np.zeros((n, 2))", "instead")],
)
def test_answers_that_are_no_float32_numbers_are_the_programs_fault(answers, why, tmp_path):
    decode = f"""
        import sys, numpy as np
        for line in sys.stdin:
            queries, answers = line.rstrip("\\n").split("\\t")
            n = len(np.load(queries))
            np.save(answers, {answers})
            print("ok", flush=True)
    """
    (tmp_path / "decode.py").write_text(textwrap.dedent(decode))
    material = ProgramMaterial((4, 4), {}, f"{sys.executable} {tmp_path}/decode.py {{files}}", 60.0)
    with pytest.raises(CodecError, match=why):
        material.slice([0.0, 0.0, 1.0], [0.0, 0.0, 1.0])


@pytest.mark.long
def test_programs_must_name_their_files(tmp_path, capsys):
    path = suite(tmp_path)
    text = (tmp_path / "suite.toml").read_text().replace(" {btf}", "")
    (tmp_path / "suite.toml").write_text(text)
    assert cli.main(["run", path, "--out", str(tmp_path / "run")]) == 3
    assert "{btf}" in load_run(tmp_path / "run").job("satin/mine/0")["error"]


def test_command_lines_are_one_line_of_words_and_a_script_may_stand_in_them():
    for line in ("a\nb {files}", "a 'b {files}"):
        with pytest.raises(InputError, match="setting decode"):
            Programs(decode=line)
    script = "print(0); " * 100  # longer than any name of a file
    assert Programs(encode=f"python3 -c '{script}' {{btf}} {{files}}", decode="python3 a.py {files}").digest


@pytest.mark.parametrize("called", ["", " ", "my codec", "mine ", "my\\tcodec"])
def test_a_name_of_several_words_or_none_is_refused(tmp_path, capsys, called):
    path = suite(tmp_path)
    text = (tmp_path / "suite.toml").read_text().replace('"mine"', f'"{called}"')
    (tmp_path / "suite.toml").write_text(text)
    assert cli.main(["run", path, "--out", str(tmp_path / "run")]) == 2
    assert "setting called" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "run" / "records.jsonl").exists()


def test_a_file_starts_nothing_that_the_user_did_not_allow(tmp_path, monkeypatch):
    spy = DECODE + f"\n    open({str(tmp_path / 'started')!r}, 'w')\n"
    assert cli.main(["run", suite(tmp_path, decode=spy), "--out", str(tmp_path / "run")]) == 0
    file = tmp_path / "run" / load_run(tmp_path / "run").job("satin/mine/0")["file"]
    monkeypatch.delenv("NEUBTF_PERMIT")
    (tmp_path / "started").unlink(missing_ok=True)
    with pytest.raises(ContainerError, match="NEUBTF_PERMIT"):
        loading.load(file)
    assert not (tmp_path / "started").exists()
    monkeypatch.setenv("NEUBTF_PERMIT", container.read_header(file).settings["decode"])
    assert loading.load(file).material.slice([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]).shape == (12, 12, 3)


def test_verifying_an_archive_starts_nothing(tmp_path, capsys, monkeypatch):
    assert cli.main(["run", suite(tmp_path), "--out", str(tmp_path / "run")]) == 0
    words = ["results", "pack", str(tmp_path / "run"), "--codec", "command"]
    assert cli.main([*words, "-o", str(tmp_path / "a.zip")]) == 0
    monkeypatch.delenv("NEUBTF_PERMIT")
    capsys.readouterr()
    assert cli.main(["results", "verify", str(tmp_path / "a.zip"), "--out", str(tmp_path / "verified")]) == 4
    assert "NEUBTF_PERMIT" in capsys.readouterr().out
    assert not (tmp_path / "verified" / "records.jsonl").exists()
