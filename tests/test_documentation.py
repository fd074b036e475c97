"""The documentation: its site builds, every link in it leads somewhere, and README stays short."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]


def test_the_site_builds_without_a_broken_link(tmp_path):
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-c", "docs", "-b", "html"]
    done = subprocess.run(
        [*command, ".", str(tmp_path / "html"), "-d", str(tmp_path / "trees")],
        cwd=ROOT, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "RenderFormer++" in (tmp_path / "html" / "docs" / "index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", ["README.md", *(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))])
def test_what_a_page_links_to_is_there(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)#\s]+)[^)]*\)", text) + re.findall(r'src="([^"]+)"', text)
    gone = [link for link in links if "://" not in link and not ((ROOT / page).parent / link).exists()]
    assert links and not gone


@pytest.mark.parametrize("page", ["README.md", *(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))])
def test_commands_name_what_there_is(page):
    """Scripts, experiments, benchmarks and modules."""
    text = (ROOT / page).read_text(encoding="utf-8")
    for script in re.findall(r"(launch/[\w/]+\.(?:py|sbatch))", text):
        assert (ROOT / script).is_file(), script
    for group, names in (("experiment", r"\bexperiment=\[?([\w,]+)"), ("benchmark", r"\bbenchmark=(\w+)")):
        for name in ",".join(re.findall(names, text)).split(","):
            assert not name or (ROOT / "conf" / group / f"{name}.yaml").is_file(), f"{group}={name}"
    for module in re.findall(r"python -m (rfpp[\w.]+)", text):
        assert (ROOT / module.replace(".", "/")).with_suffix(".py").is_file() or (
            ROOT / module.replace(".", "/")
        ).is_dir()


def test_the_tour_says_of_every_folder_what_the_folder_says_of_itself():
    listed = re.findall(r"^\| `(rfpp[\w/]*)` \| (.+) \|$", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), re.M)
    packages = {path.parent for path in (ROOT / "rfpp").rglob("__init__.py")} - {ROOT / "rfpp"}
    said = {
        p.relative_to(ROOT).as_posix(): ast.get_docstring(ast.parse((p / "__init__.py").read_text())) for p in packages
    }
    assert dict(listed) == {folder: text.splitlines()[0] for folder, text in said.items()}


def test_readme_is_read_in_a_few_minutes():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) < 1000


def test_a_commit_is_checked_by_what_make_check_runs():
    tools = set(re.findall(r"^\t\$\(VENV\)/bin/(\S+)", (ROOT / "Makefile").read_text(), re.MULTILINE))
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"][0]["hooks"]
    assert {hook["entry"].split()[0] for hook in hooks} == tools == {"ruff", "lint-imports", "mypy"}
