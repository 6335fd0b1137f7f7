"""The files that say how the project is developed: they are what their readers accept, and agree with each other."""

import re
import subprocess
import sys
import tomllib
from configparser import ConfigParser
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))
SCRIPTS = [ROOT / ".ci" / "run", ROOT / "tools" / "setup-ci", *sorted((ROOT / "tools" / "ci").iterdir())]


def environments() -> dict[str, str]:
    """The environments of tox.ini, each with the text of its section."""
    ini = ConfigParser(interpolation=None)
    ini.read(ROOT / "tox.ini")
    found: dict[str, str] = {}
    for section in ini.sections():
        if section.startswith("testenv:"):
            text = "\n".join(f"{key} = {value}" for key, value in ini[section].items())
            found |= dict.fromkeys(section.removeprefix("testenv:").strip("{}").split(","), text)
    return found


@pytest.mark.parametrize(
    ("kind", "paths"), [("workflows", WORKFLOWS), ("issue-forms", FORMS)], ids=["workflows", "forms"]
)
def test_github_accepts_them(kind: str, paths: list[Path]) -> None:
    check = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", f"vendor.github-{kind}", *map(str, paths)]
    done = subprocess.run(check, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(paths) > 1


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_runs_what_a_developer_can_run(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    runs = re.findall(r"(?:\.ci/run|tox -e|tools/setup-ci|neubtf-bench (?:run|compare))\b", text)
    assert {".ci/run", "tox -e", "neubtf-bench run"} & {*runs}
    stages = [*re.findall(r"tox -e ([a-z]\w*)", text), *re.findall(r"^ +(?:- )?stage: (\w+)$", text, re.M)]
    assert {*stages} <= environments().keys()
    assert {*re.findall(r"tox==\S+", text)} <= {*re.findall(r"tox==\S+", SCRIPTS[0].read_text(encoding="utf-8"))}


def test_every_environment_has_a_description() -> None:
    for name, text in environments().items():
        assert re.search(rf"^(?:description = |{name}: )\w", text, re.M), name


def test_the_check_runs_the_stages_that_run_alone() -> None:
    run = SCRIPTS[0].read_text(encoding="utf-8")
    for script in SCRIPTS[2:]:
        assert f"{{tox_root}}/tools/ci/{script.name}" in environments()[script.name]
        assert re.search(rf"^stage {script.name}\b", run, re.M)
    assert re.search(r'^"\$tox" -e tests$', run, re.M)


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_a_script_can_be_started(path: Path) -> None:
    assert path.stat().st_mode & 0o111
    assert subprocess.run(["bash", "-n", path], check=False).returncode == 0


def test_the_oldest_dependencies_are_those_that_the_package_allows() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    wanted = [*project["dependencies"], *(line for name, extra in extras.items() if name != "lint" for line in extra)]
    allowed = dict(found.groups() for line in wanted if (found := re.match(r"([\w-]+)[>=]=([\d.]+)$", line)))
    lines = (ROOT / "constraints-lowest.txt").read_text(encoding="utf-8").splitlines()
    held = dict(line.split("==") for line in lines if not line.startswith("#"))
    assert held.keys() == allowed.keys()
    for name, version in held.items():  # where an index lacks 77.0, it is 77.0.1
        assert f"{version}.".startswith(f"{allowed[name]}."), name
