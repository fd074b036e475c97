import hashlib

import pytest

from rfpp.metrics import package_index
from rfpp.metrics.package_index import PackageIndexError, download_sdist

CONTENT = b"archive"
SHA256 = hashlib.sha256(CONTENT).hexdigest()
PAGE = b'<html><a href="../../files/my_pkg-1.0.tar.gz#sha256=0">x</a><a href="my_pkg-1.1.tar.gz">y</a></html>'


@pytest.fixture
def web(monkeypatch) -> dict[str, bytes]:
    """A web of given pages, seen through one configured index with a password in its address."""
    pages = {
        "https://user:secret@index.example/simple/my-pkg/": PAGE,
        "https://user:secret@index.example/files/my_pkg-1.0.tar.gz#sha256=0": CONTENT,
    }

    def get(url, _):
        if url not in pages:
            raise OSError("404")
        return pages[url]

    monkeypatch.setattr(package_index, "_get", get)
    monkeypatch.setattr(
        package_index, "_pip_settings", lambda: {"index-url": "https://user:secret@index.example/simple"}
    )
    return pages


def test_finds_the_file_by_the_index_page(web) -> None:
    assert download_sdist("my_pkg", "1.0", SHA256) == CONTENT


def test_a_wrong_hash_is_refused(web) -> None:
    with pytest.raises(PackageIndexError, match="another hash"):
        download_sdist("my_pkg", "1.0", "0" * 64)


def test_an_absent_version_is_said_without_the_password(web) -> None:
    with pytest.raises(PackageIndexError, match=r"index\.example has no my_pkg-9\.tar\.gz") as error:
        download_sdist("my_pkg", "9", SHA256)
    assert "secret" not in str(error.value)


def test_an_unreachable_index_is_named(web) -> None:
    web.clear()
    with pytest.raises(PackageIndexError, match=r"index\.example: 404"):
        download_sdist("my_pkg", "1.0", SHA256)


def test_the_next_index_is_asked(web, monkeypatch) -> None:
    settings = {
        "index-url": "https://empty.example/simple",
        "extra-index-url": "https://user:secret@index.example/simple",
    }
    monkeypatch.setattr(package_index, "_pip_settings", lambda: settings)
    assert download_sdist("my_pkg", "1.0", SHA256) == CONTENT


def test_the_environment_outranks_pips_files() -> None:
    listing = ":env:.index-url='https://env.example'\nglobal.cert='/ca.pem'\nglobal.index-url='https://file.example'\n"
    assert package_index._parse_settings(listing) == {"index-url": "https://env.example", "cert": "/ca.pem"}


def test_without_pip_the_public_index_is_asked() -> None:
    assert package_index._indexes(package_index._parse_settings("")) == [package_index.PUBLIC_INDEX]
