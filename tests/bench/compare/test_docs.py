import re
import subprocess
import sys
from pathlib import Path

from bench.runs.suite import parse_suite

TEXT = (Path(__file__).parents[3] / "docs" / "ci.md").read_text()


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```$", TEXT, re.M | re.S)


def test_the_workflow_is_one_that_github_accepts(tmp_path):
    (workflow,) = blocks("yaml")
    check = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.github-workflows"]
    good, bad = tmp_path / "good.yml", tmp_path / "bad.yml"
    good.write_text(workflow)
    bad.write_text(workflow.replace("timeout-minutes: 30", "timeout: 30"))
    assert "ok" in subprocess.run([*check, str(good)], capture_output=True, text=True, check=True).stdout
    assert subprocess.run([*check, str(bad)], capture_output=True, check=False).returncode == 1


def test_the_suite_of_the_page_is_a_suite():
    (toml,) = blocks("toml")
    suite = parse_suite("tracking", toml)
    assert suite.codecs[1].codec == "polynomial"
    assert suite.data.split == "validation"  # or margins would be those of pairs, ten times those of fits
