"""The zip file of the add-on."""

import ast
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from rfpp.errors import UserError
from rfpp.serve.extension import FOLDER, write_extension

ROOT = Path(__file__).parents[2]


def test_the_zip_file_holds_the_add_on(tmp_path):
    path = write_extension(tmp_path / "new")
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert path.name == f"rfpp-{version}.zip"  # the add-on is of the package's version
    with zipfile.ZipFile(path) as archive:
        names = set(archive.namelist())
        assert names == {file.name for file in FOLDER.iterdir() if file.suffix in (".py", ".toml")}
        assert tomllib.loads(archive.read("blender_manifest.toml").decode())["blender_version_min"] == "4.2.0"
    assert write_extension(tmp_path / "named.zip").read_bytes() == path.read_bytes()


def test_an_unwritable_target_is_reported(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match="cannot be written"):
        write_extension(tmp_path / "file" / "here")


def test_the_add_on_imports_only_modules_of_blender():
    known = sys.stdlib_module_names | {"bpy", "gpu", "gpu_extras", "mathutils", "numpy"}
    for file in FOLDER.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module]
            assert {name.split(".")[0] for name in names} <= known, file.name
