"""One file from the package index that pip is configured to use, without running anything in it.

`pip download` of a source package executes its build script to learn its metadata; reading the index's "simple"
page (PEP 503) and checking a sha256 known in advance does not.
"""

from __future__ import annotations

import ast
import base64
import hashlib
import http.client
import re
import ssl
import subprocess
import sys
from html.parser import HTMLParser
from urllib.parse import urljoin, urlsplit, urlunsplit
from urllib.request import Request, urlopen

PUBLIC_INDEX = "https://pypi.org/simple"
TIMEOUT_SECONDS = 30


class PackageIndexError(Exception):
    """No configured index could deliver the file."""


def download_sdist(name: str, version: str, sha256: str) -> bytes:
    """The bytes of `<name>-<version>.tar.gz` whose hash is `sha256`, from the first index that has it.

    Raises:
        PackageIndexError: one line saying what each index answered.
    """
    filename, project = f"{name}-{version}.tar.gz", re.sub(r"[-_.]+", "-", name).lower()
    settings = _pip_settings()
    context = ssl.create_default_context(cafile=settings.get("cert"))
    answers = []
    for index in _indexes(settings):
        page = f"{index.rstrip('/')}/{project}/"
        try:
            links = _Links.parse(_get(page, context).decode())
            link = next(link for link in links if urlsplit(link).path.endswith(f"/{filename}"))
            content = _get(urljoin(page, link), context)
        except StopIteration:
            answers.append(f"{_shown(index)} has no {filename}")
        except (OSError, ValueError, http.client.HTTPException) as error:
            answers.append(f"{_shown(index)}: {getattr(error, 'reason', None) or error}")
        else:
            if hashlib.sha256(content).hexdigest() == sha256:
                return content
            answers.append(f"{_shown(index)} has {filename} with another hash")
    raise PackageIndexError("; ".join(answers))


def _pip_settings() -> dict[str, str]:
    """pip's options by name, from its files and the environment; empty where there is no pip."""
    listing = subprocess.run([sys.executable, "-m", "pip", "config", "list"], capture_output=True, text=True)
    return _parse_settings(listing.stdout)


def _parse_settings(listing: str) -> dict[str, str]:
    """Lines such as `global.index-url='…'`, of which the environment (`:env:`) has the last word."""
    pairs = [line.split("=", 1) for line in listing.splitlines() if "=" in line]
    pairs.sort(key=lambda pair: pair[0].startswith(":env:"))
    return {key.rpartition(".")[2]: ast.literal_eval(value) for key, value in pairs}


def _indexes(settings: dict[str, str]) -> list[str]:
    return [settings.get("index-url", PUBLIC_INDEX), *settings.get("extra-index-url", "").split()]


def _get(url: str, context: ssl.SSLContext) -> bytes:
    parts = urlsplit(url)
    request = Request(urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2])))
    if parts.username:
        token = base64.b64encode(f"{parts.username}:{parts.password or ''}".encode()).decode()
        request.add_unredirected_header("Authorization", f"Basic {token}")
    with urlopen(request, timeout=TIMEOUT_SECONDS, context=context) as response:
        return response.read()


def _shown(url: str) -> str:
    """The host only: an index URL may carry a password."""
    parts = urlsplit(url)
    return parts.hostname or url


class _Links(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []

    @classmethod
    def parse(cls, page: str) -> list[str]:
        parser = cls()
        parser.feed(page)
        return parser.links

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.links += [value for key, value in attrs if tag == "a" and key == "href" and value]
