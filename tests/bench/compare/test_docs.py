"""What docs/ci.md shows is checked as its readers would use it."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from bench import cli
from bench.runs.suite import parse_suite

TEXT = (Path(__file__).parents[3] / "docs" / "ci.md").read_text()


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```$", TEXT, re.M | re.S)


def commands():
    """Every command of the page: of the code blocks, and of the steps of the workflow."""
    folded = re.sub(r">-\n((?: {10}.*\n)+)", lambda m: " ".join(m[1].split()) + "\n", "\n".join(blocks("yaml")))
    lines = [*"\n".join(blocks("")).splitlines(), *re.findall(r"run: (.*)", folded)]
    return [match[0] for line in lines if (match := re.search(r"neubtf-bench [^#;]*", line))]


def test_the_workflow_is_one_that_github_accepts(tmp_path):
    (workflow,) = blocks("yaml")
    check = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.github-workflows"]
    good, bad = tmp_path / "good.yml", tmp_path / "bad.yml"
    good.write_text(workflow)
    bad.write_text(workflow.replace("timeout-minutes: 30", "timeout: 30"))
    assert "ok" in subprocess.run([*check, str(good)], capture_output=True, text=True, check=True).stdout
    assert subprocess.run([*check, str(bad)], capture_output=True, check=False).returncode == 1


@pytest.mark.parametrize("command", commands())
def test_every_command_of_the_page_exists(command):
    words = shlex.split(command)[1:]
    cli.parser(words[:1]).parse_args([word.replace("$seed", "3") for word in words])


def test_the_suite_of_the_page_is_a_suite():
    (toml,) = blocks("toml")
    suite = parse_suite("tracking", toml)
    assert suite.codecs[1].codec == "ptm"
    assert suite.data.split == "validation"  # or margins would be those of pairs, ten times those of fits
