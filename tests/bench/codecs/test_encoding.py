"""What a codec does wrong while it encodes is one error that names it, and the process stays as it was."""

import importlib
import os
import re
import textwrap
import threading
from asyncio import CancelledError
from pathlib import Path

import numpy as np
import pytest

from baselines.mean_colour import MeanColour
from bench import cli
from bench.btf import BTF, ArraySource
from bench.codec import Fit
from bench.codecs import loading
from bench.codecs.encoding import error_in_words, fit_codec, fit_to_file, naming_faults
from bench.conformance.check import leaves_the_process, tiny_btf
from bench.conformance.verdicts import check
from bench.inputs.errors import EncodeError, InputError
from tests.bench.outside import install


def with_encode(encode):
    return type("Mine", (MeanColour,), {"encode": encode})


def fails(error):
    def encode(self, btf, fit):
        raise error

    return with_encode(encode)


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (ValueError("mine"), "ValueError: mine"),
        (KeyError("x"), "KeyError: 'x'"),
        (SystemExit(0), "exit code 0"),
        (SystemExit("no GPU"), "'no GPU'"),
        (SystemExit(None), "exit code 0"),
        (ValueError(""), "ValueError"),
        (CancelledError(), "CancelledError"),
    ],
)
def test_any_error_of_a_codec_names_codec_data_and_line(error, says):
    codec = fails(error)()
    with pytest.raises(EncodeError) as raised:
        fit_codec(codec, tiny_btf(), Fit(), naming_faults(codec))
    message = str(raised.value)
    assert re.match(f"codec mean-colour.* check: .*{says}", message)
    assert f"{Path(__file__).name}:" in message
    assert "\n" not in message


@pytest.mark.parametrize("inside", ["lib/python3/site-packages", "lib/python3/dist-packages"])
def test_what_is_installed_beside_a_codec_is_not_its_authors_line(inside, tmp_path, monkeypatch):
    packages = tmp_path / ".venv" / inside
    packages.mkdir(parents=True)
    (packages / "a_library.py").write_text("def fails(x):\n    raise ValueError(x)\n")
    codec = "from bench.codec import Codec\nimport a_library\n\n\nclass Mine(Codec):\n    name, version = 'mine', 1\n\n"
    codec += "    def encode(self, btf, fit):\n        a_library.fails(1)\n"
    (tmp_path / "a_codec_beside_it.py").write_text(codec)
    monkeypatch.syspath_prepend(str(packages))
    monkeypatch.syspath_prepend(str(tmp_path))
    mine = importlib.import_module("a_codec_beside_it").Mine()
    with pytest.raises(ValueError, match="1") as raised:
        mine.encode(None, None)
    assert error_in_words(raised.value, mine).endswith("a_codec_beside_it.py:9)")


def test_bad_input_and_a_full_disk_are_not_the_codecs_fault():
    for error in (InputError("bad input"), OSError(28, "No space left on device")):
        codec = fails(error)()
        with pytest.raises(type(error)) as raised:
            fit_codec(codec, tiny_btf(), Fit(), naming_faults(codec))
        assert raised.value is error


@pytest.mark.long
@pytest.mark.usefixtures("decodes_here")
def test_the_working_directory_is_restored_and_a_check_says_that_it_was_left(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def wanders(self, btf, fit):
        Path("elsewhere").mkdir(exist_ok=True)
        os.chdir("elsewhere")
        return MeanColour.encode(self, btf, fit)

    fit_to_file(with_encode(wanders)(), tiny_btf(), Fit(), Path("a.nbtf"))
    assert Path.cwd() == tmp_path
    assert (tmp_path / "a.nbtf").exists()  # a path is relative to where the fit began
    said = {result.name: result.failure for result in check(with_encode(wanders)())}
    assert f"{tmp_path}/elsewhere" in said[leaves_the_process.__doc__]
    assert Path.cwd() == tmp_path


@pytest.mark.long
@pytest.mark.usefixtures("decodes_here")
def test_a_codec_that_removes_its_working_directory_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def removes(self, btf, fit):
        Path("gone").mkdir()
        os.chdir("gone")
        (tmp_path / "gone").rmdir()
        return MeanColour.encode(self, btf, fit)

    said = {result.name: result.failure for result in check(with_encode(removes)())}
    assert "working directory" in said[leaves_the_process.__doc__]


@pytest.mark.usefixtures("decodes_here")
def test_a_thread_that_is_left_running_is_named():
    done = threading.Event()

    def lingers(self, btf, fit):
        threading.Thread(target=done.wait, name="my-thread").start()
        return MeanColour.encode(self, btf, fit)

    try:
        said = {result.name: result.failure for result in check(with_encode(lingers)())}
        assert "my-thread" in said[leaves_the_process.__doc__]
    finally:
        done.set()
    for thread in threading.enumerate():
        if thread.name == "my-thread":
            thread.join()


FAULTY = """
import os, sys
import torch
from baselines.mean_colour import MeanColour
from bench.codec import Parts

class Quits(MeanColour):
    name = "quits"
    def encode(self, btf, fit):
        sys.exit(0)

class Stores(MeanColour):
    name = "stores"
    def encode(self, btf, fit):
        mean = super().encode(btf, fit).texture["mean"]
        return Parts(texture={"mean": mean}, other={"x": mean.to(torch.uint16)})
"""


def test_a_codec_that_cannot_be_made_or_cannot_decode_is_one_line(tmp_path, monkeypatch, capsys):
    source = """
        import sys
        from baselines.mean_colour import MeanColour

        class Unmade(MeanColour):
            name = "unmade"
            def __init__(self, **settings):
                raise RuntimeError("first\\nsecond")

        class Leaves(MeanColour):
            name = "leaves"
            def decode(self, parts, device):
                sys.exit("no GPU")
    """
    codecs = {"unmade": "odd:Unmade", "leaves": "odd:Leaves"}
    monkeypatch.syspath_prepend(install(tmp_path / "site", "odd", codecs, {"odd": textwrap.dedent(source)}))
    monkeypatch.chdir(tmp_path)
    words = ["encode", "satin", "--set", "data.size=8", "--set", "data.views=3", "--set", "data.lights=3"]
    for command, code in (["check", "unmade"], 2), ([*words, "--codec", "unmade", "-o", "a.nbtf"], 2):
        assert cli.main(command) == code
        error = capsys.readouterr().err
        assert "codec unmade" in error
        assert "RuntimeError: first" in error
        assert error.count("\n") == 1
    assert cli.main([*words, "--codec", "leaves", "-o", "a.nbtf"]) == 3
    assert "'no GPU'" in capsys.readouterr().err
    assert cli.main(["score", "a.nbtf", *words[1:]]) == 2
    error = capsys.readouterr().err
    assert "no GPU" in error
    assert error.count("\n") == 1


def test_the_command_ends_with_3_and_one_line_and_with_debug_the_traceback(tmp_path, monkeypatch, capsys):
    codecs = {"quits": "faulty:Quits", "stores": "faulty:Stores"}
    monkeypatch.syspath_prepend(install(tmp_path / "site", "faulty", codecs, {"faulty": FAULTY}))
    monkeypatch.chdir(tmp_path)
    words = ["encode", "satin", "--set", "data.size=8", "--set", "data.views=3", "--set", "data.lights=3"]
    for name, says in (("quits", "ends the process with exit code 0"), ("stores", "other/x is of type uint16")):
        assert cli.main([*words, "--codec", name, "-o", "a.nbtf"]) == 3
        error = capsys.readouterr().err
        assert f"codec {name}" in error
        assert says in error
        assert error.count("\n") == 1
        assert cli.main([*words, "--codec", name, "-o", "a.nbtf", "--debug"]) == 3
        assert "Traceback" in capsys.readouterr().err
        assert cli.main(["check", name]) == 1
        assert says in capsys.readouterr().out
    assert not Path("a.nbtf").exists()


def test_data_with_a_light_below_the_horizon_leave_a_readable_file(tmp_path):
    like = tiny_btf()
    wi = like.wi.copy()
    wi[0, 2] = -wi[0, 2]
    btf = BTF("below", like.wo, wi, ArraySource(np.stack(list(like))))
    path = tmp_path / "below.nbtf"
    fit_to_file(MeanColour(), btf, Fit(), path)
    assert loading.load(path).header.lowest_light == 0
