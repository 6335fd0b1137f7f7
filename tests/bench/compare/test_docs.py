import subprocess
import sys
from pathlib import Path

WORKFLOW = Path(__file__).parents[3] / ".github" / "workflows" / "quality.yml"


def test_the_workflow_that_the_page_names_is_one_that_github_accepts(tmp_path):
    workflow = WORKFLOW.read_text(encoding="utf-8")
    check = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.github-workflows"]
    good, bad = tmp_path / "good.yml", tmp_path / "bad.yml"
    good.write_text(workflow)
    bad.write_text(workflow.replace("timeout-minutes: 30", "timeout: 30"))
    assert "ok" in subprocess.run([*check, str(good)], capture_output=True, text=True, check=True).stdout
    assert subprocess.run([*check, str(bad)], capture_output=True, check=False).returncode == 1
