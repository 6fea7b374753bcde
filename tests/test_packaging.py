"""What pyproject.toml, the README and CI promise, checked without installing anything."""

from __future__ import annotations

import importlib
import os
import re
import shlex
import subprocess
import tomllib
from importlib.metadata import version
from pathlib import Path

import jaxtyping
import pytest
import torch
import yaml

import decomotion
from decomotion.extras import EXTRA_OF

ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
HATCH = PYPROJECT["tool"]["hatch"]["build"]
COMMANDS = PYPROJECT["project"]["scripts"]
README = (ROOT / "README.md").read_text()
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def shell_blocks(markdown: str) -> list[list[str]]:
    blocks = re.findall(r"^```sh\n(.*?)^```", markdown, re.MULTILINE | re.DOTALL)
    return [block.replace("\\\n", " ").splitlines() for block in blocks]


def test_version_is_that_of_the_source():
    assert version("decomotion") == decomotion.__version__, "pip install -e '.[dev]' again"


def test_wheel_editable_install_and_pyright_see_the_same_packages():
    packages = HATCH["targets"]["wheel"]["packages"]
    parents = {str(Path(package).parent) for package in packages}
    assert parents == set(HATCH["dev-mode-dirs"]) == {".", *PYPROJECT["tool"]["pyright"]["extraPaths"]}
    assert {Path(package).name for package in packages} == {target.split(".")[0] for target in COMMANDS.values()}
    for package in packages:
        assert (ROOT / package / "py.typed").is_file()
        assert importlib.import_module(Path(package).name).__file__ == str(ROOT / package / "__init__.py")


def test_version_changelog_and_citation_agree():
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    releases = re.findall(r"^## \[(\d+\.\d+\.\d+)\] - (\d{4}-\d\d-\d\d)$", changelog, re.MULTILINE)
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert (citation["version"], citation["date-released"].isoformat()) == releases[0]
    assert releases[0][0] == decomotion.__version__
    assert citation["license"] == PYPROJECT["project"]["license"]
    assert citation["references"][0]["title"] == "Decomposition Betters Tracking Everything Everywhere"


def test_the_matrix_is_of_all_that_the_package_says_it_runs_on():
    project = PYPROJECT["project"]
    named = [found[1] for each in project["classifiers"] if (found := re.search(r"Python :: (3\.\d+)$", each))]
    assert project["requires-python"] == f">={named[0]}"
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "matrix.yml").read_text(encoding="utf-8"))
    for job in workflow["jobs"].values():
        assert job["strategy"]["matrix"]["python"] == named
        assert len(job["strategy"]["matrix"]["os"]) == len([e for e in project["classifiers"] if "Operating" in e])


def test_a_release_is_built_by_the_script_and_published_without_a_token():
    text = (ROOT / ".github" / "workflows" / "release.yml").read_text(encoding="utf-8")
    build, publish = yaml.safe_load(text)["jobs"].values()
    assert ".ci/package dist" in [step.get("run") for step in build["steps"]]
    assert publish["permissions"] == {"id-token": "write"}
    assert "secrets." not in text
    assert os.access(ROOT / ".ci" / "package", os.X_OK)


def test_the_extra_of_each_library_installs_it():
    requirements = PYPROJECT["project"]["optional-dependencies"]
    for library, extra in EXTRA_OF.items():
        names = {extra: [re.split(r"[^\w-]", each)[0] for each in of] for extra, of in requirements.items()}
        assert library in names[extra]
        assert library not in names["train"]
        assert not [each for each in PYPROJECT["project"]["dependencies"] if each.startswith(library)]


def test_a_wrong_shape_fails_in_tests():
    """The pytest option `--jaxtyping-packages` at work: unchecked, these two would broadcast."""
    from decomotion.compositing import composite

    with pytest.raises(jaxtyping.TypeCheckError, match="composite"):
        composite(torch.ones(2, 5), torch.ones(5, 3))


def test_readme_begins_with_two_one_line_commands():
    main_job, tests = shell_blocks(README)[0]
    assert "'.[train]'" in main_job
    further = (
        "decomo-prepare",
        "decomo-info",
        "decomo-convert",
        "decomo-flow",
        "decomo-propagate",
        "decomo-measure",
        "decomo-render",
        "decomo-view",
        "decomo-batch",
        "decomo-bench",
    )
    assert all(command in main_job for command in COMMANDS if command not in further)
    assert "'.[dev]'" in tests
    assert tests.endswith("pytest")


def test_ci_runs_the_readme_s_test_command():
    """The line that .ci/run cuts out of the README is the second one of its first block."""
    cut = next(line for line in (ROOT / ".ci" / "run").read_text().splitlines() if line.startswith("test_command="))
    result = subprocess.run(
        ["bash", "-c", f'{cut}\necho "$test_command"'], cwd=ROOT, capture_output=True, text=True, timeout=60
    )
    assert result.stdout.strip() == shell_blocks(README)[0][1]


def documented_options(command: str) -> set[str]:
    """The options with which `command` stands in the shell blocks of the README and docs/."""
    lines = [line for page in PAGES for block in shell_blocks(page.read_text()) for line in block]
    calls = [shlex.split(call, comments=True) for line in lines for call in re.split(r"&&|\||\s--\s", line)]
    calls = [[f"decomo-{call[1]}", *call[2:]] if call[:1] == ["decomo"] and call[1:] else call for call in calls]
    return {word for call in calls if call[:1] == [command] for word in call[1:] if word.startswith("--")}


@pytest.mark.parametrize("command", COMMANDS)
def test_documented_options_exist(command: str, capsys: pytest.CaptureFixture[str]):
    module, function = COMMANDS[command].split(":")
    main = getattr(importlib.import_module(module), function)
    assert main(["tapvid", "--help"] if command == "decomo-eval" else ["--help"]) == 0
    existing = set(re.findall(r"--[\w-]+", capsys.readouterr().out))
    assert documented_options(command) <= existing


def anchors(page: Path) -> set[str]:
    """Of its headings, as GitHub and the site make them."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page: Path):
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#]*)#?([^)]*)\)", page.read_text()):
        path = page.parent / target if target else page
        assert path.exists(), target
        assert not anchor or anchor in anchors(path), f"{target}#{anchor}"
