"""The documentation: its site builds, links and commands exist, and texts stay short."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
PAGES = [
    "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "data/README.md", "data/conventions.md",
    *(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")),
]  # fmt: skip


def test_site_builds_without_warnings(tmp_path):
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-c", "docs", "-b", "html"]
    done = subprocess.run(
        [*command, ".", str(tmp_path / "html"), "-d", str(tmp_path / "trees")],
        cwd=ROOT, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "RenderFormer++" in (tmp_path / "html" / "docs" / "index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES)
def test_linked_files_exist(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)#\s]+)[^)]*\)", text) + re.findall(r'src="([^"]+)"', text)
    assert [link for link in links if "://" not in link and not ((ROOT / page).parent / link).exists()] == []


@pytest.mark.parametrize("page", [page for page in PAGES if page != "CHANGELOG.md"])
def test_named_scripts_configurations_and_modules_exist(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    files = [ROOT / script for script in re.findall(r"launch/[\w/]+\.(?:py|sbatch)", text)]
    for group, names in (("experiment", r"\bexperiment=\[?([\w,/]+)"), ("benchmark", r"\bbenchmark=(\w+)")):
        chosen = [name for several in re.findall(names, text) for name in several.split(",")]
        files += [ROOT / "conf" / group / f"{name}.yaml" for name in chosen]
    modules = [ROOT / name.replace(".", "/") for name in re.findall(r"python -m (rfpp[\w.]+)", text)]
    files += [module / "__main__.py" if module.is_dir() else module.with_suffix(".py") for module in modules]
    assert [str(file) for file in files if not file.is_file()] == []


@pytest.mark.parametrize("page", [page for page in PAGES if page != "CHANGELOG.md"])
def test_named_source_folders_and_files_exist(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    named = re.findall(r"`((?:rfpp|conf|data/models|data/scenes)/[\w/.]+)`", text)
    assert [path for path in named if not (ROOT / path).exists()] == []


def test_the_python_of_the_rendering_page_runs():
    code = "".join(re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "rendering.md").read_text("utf-8"), re.S))
    names: dict = {}
    exec(code, names)
    assert names["images"].shape == (3, 256, 256, 3)
    assert 0.05 < names["image"].mean() < 0.2
    assert str(names["Scene"](objects=(names["floor"],))) == "<Scene 'scene': 1 objects, 2 triangles, 0 cameras>"


def test_tour_lists_every_package():
    listed = re.findall(r"^\| `(rfpp/\w+)` \|", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), re.M)
    assert sorted(listed) == sorted(f"rfpp/{path.parent.name}" for path in (ROOT / "rfpp").glob("*/__init__.py"))


def test_texts_stay_short():
    def words(*patterns: str) -> int:
        return sum(len(path.read_text(encoding="utf-8").split()) for p in patterns for path in ROOT.glob(p))

    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 100
    assert words("docs/*.md") - words("docs/api.md") <= 10_000
    assert words("data/README.md", "data/conventions.md") <= 4_000
    assert words("CONTRIBUTING.md") <= 1_200


def test_docstrings_begin_with_a_noun_or_a_verb():
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for path in ROOT.glob("rfpp/**/*.py"):
        nodes = [node for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, documented)]
        first_words = [(ast.get_docstring(node) or "").partition(" ")[0] for node in nodes]
        assert not {"What", "Of", "How", "As", "Whether", "Where"} & set(first_words), path


def test_commit_hooks_run_the_tools_of_make_check():
    tools = set(re.findall(r"^\t\$\(VENV\)/bin/(\S+)", (ROOT / "Makefile").read_text(), re.MULTILINE))
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"][0]["hooks"]
    assert {hook["entry"].split()[0] for hook in hooks} == tools == {"ruff", "lint-imports", "mypy"}
