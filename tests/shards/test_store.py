"""Data sets behind a URL: each file is fetched once, the cache is bounded, and failures are named."""

import hashlib
import http.server
import json
import multiprocessing
import os
import shutil
import tarfile
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from rfpp.errors import MissingDependencyError, ShardError, UserError
from rfpp.shards import store
from rfpp.shards.cache import ShardCache
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.manifest import MANIFEST_FILE
from rfpp.shards.tar import unpack


class Handler(http.server.SimpleHTTPRequestHandler):
    """Serves a folder and records requests; the first answers for names in `cut` are truncated."""

    def do_GET(self):
        name = self.path.rpartition("/")[2]
        self.server.requests.append(name)
        if self.server.cut.get(name, 0) > 0:
            self.server.cut[name] -= 1
            content = Path(self.translate_path(self.path)).read_bytes()
            self.send_response(200)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content[: len(content) // 2])
            return
        if name in self.server.slow:
            self.send_response(200)
            self.send_header("Content-Length", "1000")
            self.end_headers()
            for _ in range(40):
                self.wfile.write(b"x" * self.server.slow[name])
                time.sleep(0.05)
            return
        super().do_GET()

    def log_message(self, *_):
        pass


@pytest.fixture
def server(finished):
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(finished.root))) as running:
        running.requests, running.cut, running.slow = [], {}, {}
        running.url = f"http://127.0.0.1:{running.server_port}"
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield running
        running.shutdown()
        thread.join()


@pytest.fixture
def cache(tmp_path):
    return ShardCache(tmp_path / "cache", gigabytes=1)


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    monkeypatch.setattr(store, "_PAUSES", (0.0, 0.0))


def cached(cache: ShardCache, pattern: str) -> list[str]:
    """Return the names of cached files without their hash."""
    return sorted(path.name.partition("-")[2] for path in cache.folder.glob(pattern))


def test_a_remote_data_set_equals_its_folder_and_each_file_is_fetched_once(server, finished, cache):
    local, remote = ShardSplit(finished.root, "train"), ShardSplit(server.url, "train", cache)
    assert remote.manifest.hash == finished.hash
    assert server.requests == ["manifest.json"]
    for index in (4, 0, 1, 4):
        np.testing.assert_array_equal(remote[index].images, local[index].images)
    remote.close()
    assert remote[0].key == ShardSplit(server.url + "/", "train", cache)[0].key == "train-000000"
    files = [name for name in server.requests if name != "manifest.json"]
    assert sorted(files) == ["train-00000.json", "train-00000.tar", "train-00002.json", "train-00002.tar"]


def read_all(url: str, cache: ShardCache, results) -> None:
    split = ShardSplit(url, "train", cache)
    results.put([split[i].key for i in range(len(split))])


def test_several_processes_fetch_a_shard_once(server, finished, cache):
    context = multiprocessing.get_context("spawn")
    results = context.Queue()
    readers = [context.Process(target=read_all, args=(server.url, cache, results)) for _ in range(2)]
    for reader in readers:
        reader.start()
    keys = [results.get(timeout=120) for _ in readers]
    for reader in readers:
        reader.join()
    assert keys == 2 * [[entry.key for entry in finished.samples("train")]]
    tars = [name for name in server.requests if name.endswith(".tar")]
    assert sorted(tars) == [shard.listed.file for shard in finished.shards("train")]


def test_the_cache_evicts_least_recently_used_files_without_disturbing_readers(server, finished, tmp_path):
    sizes = [shard.listed.bytes + shard.listed.index_bytes for shard in finished.shards("train")]
    cache = ShardCache(tmp_path / "cache", gigabytes=(sizes[0] + sizes[1] + 100) / 1e9)
    split = ShardSplit(server.url, "train", cache)
    first = split[0].images
    split[2]
    for name in cached(cache, "*00000*"):  # used again: shard 1 is the oldest now
        os.utime(next(cache.folder.glob(f"*-{name}")))
    split[4]
    assert cached(cache, "*.tar") == ["train-00000.tar", "train-00002.tar"]
    assert sum(path.stat().st_size for path in cache.folder.glob("[!.]*")) <= cache.gigabytes * 1e9
    shutil.rmtree(cache.folder)
    np.testing.assert_array_equal(split[0].images, first)
    assert split[3].key == "train-000003"  # open files remain readable after their removal


def test_a_truncated_copy_is_fetched_again(server, cache):
    ShardSplit(server.url, "train", cache)[0]
    path = next(cache.folder.glob("*.tar"))
    os.truncate(path, 1000)
    assert ShardSplit(server.url, "train", cache)[0].key == "train-000000"
    assert server.requests.count("train-00000.tar") == 2


def test_a_truncated_download_is_retried_then_named(server, cache):
    server.cut["train-00000.tar"] = 2
    assert ShardSplit(server.url, "train", cache)[0].key == "train-000000"
    server.cut["train-00001.tar"] = 3
    with pytest.raises(UserError, match=r"http.*train-00001\.tar: cannot be fetched after 3 attempts"):
        ShardSplit(server.url, "train", cache)[2]
    assert cached(cache, "*.tar") == ["train-00000.tar"]


@pytest.mark.parametrize("bytes_at_once", [0, 1])
def test_a_slow_or_silent_server_is_left(server, cache, monkeypatch, bytes_at_once):
    monkeypatch.setattr(store, "_GRACE", 0.2)
    server.slow["train-00000.tar"] = bytes_at_once
    with pytest.raises(UserError, match=r"train-00000\.tar: cannot be fetched after 3 attempts \((slower|FSTimeout)"):
        ShardSplit(server.url, "train", cache)[0]
    assert server.requests.count("train-00000.tar") == 3
    assert ShardSplit(server.url, "train", cache)[2].key == "train-000002"


def test_a_shard_of_another_size_is_named(copied, cache):
    with (copied / "train-00000.tar").open("ab") as file:
        file.write(bytes(512))
    with pytest.raises(ShardError, match=r"train-00000\.tar.*truncated or altered: \d+ bytes, the manifest says \d+"):
        ShardSplit(f"file://{copied}", "train", cache)[0]


def test_a_missing_shard_or_index_is_named(copied, cache):
    (copied / "train-00000.tar").unlink()
    (copied / "train-00001.json").unlink()
    split = ShardSplit(f"file://{copied}", "train", cache)
    with pytest.raises(ShardError, match=r"train-00000\.tar: the file is missing"):
        split[0]
    with pytest.raises(ShardError, match=r"train-00001\.json: the file is missing"):
        split[2]
    assert split[4].key == "train-000004"


def test_damage_names_the_url_and_the_cached_copy(copied, cache):
    content = bytearray((copied / "train-00000.tar").read_bytes())
    content[5000] ^= 1
    (copied / "train-00000.tar").write_bytes(content)
    expected = r"file://.*train-00000\.tar: sample train-000000 .*sha256: delete \*-train-00000\.tar.*cache\.folder"
    with pytest.raises(ShardError, match=expected):
        ShardSplit(f"file://{copied}", "train", cache)[0]


def test_missing_data_server_library_or_cache_is_named(server, cache, finished):
    with pytest.raises(ShardError, match=r"http.*nowhere/manifest\.json: there is no finished data set here"):
        ShardSplit(f"{server.url}/nowhere", "train", cache)
    with pytest.raises(UserError, match=r"http://127\.0\.0\.1:9/manifest\.json: cannot be fetched after 3 attempts"):
        ShardSplit("http://127.0.0.1:9", "train", cache)
    with pytest.raises(MissingDependencyError, match=r"s3://bucket/manifest\.json: Install s3fs"):
        ShardSplit("s3://bucket", "train", cache)
    with pytest.raises(UserError, match="Protocol not known: nonsense"):
        ShardSplit("nonsense://x", "train", cache)
    with pytest.raises(UserError, match=r"needs a cache: set datamodule\.source\.cache"):
        ShardSplit(server.url, "train")


def test_a_cache_that_cannot_be_written_is_named(server, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=r"file/cache: cannot be written \(Not a directory\)"):
        ShardSplit(server.url, "train", ShardCache(tmp_path / "file" / "cache", 1))[0]


def listed(folder: Path, change) -> None:
    """Change the first training shard in the manifest of a data set."""
    content = json.loads((folder / MANIFEST_FILE).read_bytes())
    change(content["splits"]["train"][0])
    (folder / MANIFEST_FILE).write_text(json.dumps(content))


@pytest.mark.parametrize(
    "change",
    [
        {"file": "x/../../../victim.txt"}, {"file": "/tmp/victim.tar"}, {"file": "..tar"}, {"file": "victim.txt"},
        {"sha256": "/absolute/path"}, {"index_sha256": "../" * 30}, {"bytes": -1}, {"bytes": 1e300}, {"samples": True},
    ],
    ids=str,
)  # fmt: skip
def test_a_manifest_cannot_name_files_outside_its_folder(finished, tmp_path, change):
    root = Path(shutil.copytree(finished.root, tmp_path / "data"))
    victim = tmp_path / "victim.txt"
    victim.write_text("mine")
    listed(root, lambda shard: shard.update(change))
    with pytest.raises(ShardError, match=r"manifest\.json: not a data set manifest"):
        ShardSplit(root, "train")
    assert victim.read_text() == "mine"


@pytest.mark.parametrize("key", ["/tmp/victim", "../victim", "", "a/b"])
def test_an_index_cannot_name_files_outside_its_folder(finished, tmp_path, key):
    root = Path(shutil.copytree(finished.root, tmp_path / "data"))
    file = root / "train-00000.json"
    index = json.loads(file.read_bytes())
    index["samples"][0][0] = key
    file.write_text(json.dumps(index))
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    listed(root, lambda shard: shard.update(index_sha256=digest, index_bytes=file.stat().st_size))
    with pytest.raises(ShardError, match=r"train-00000\.json: not the index of a shard"):
        ShardSplit(root, "train")[0]


def test_a_link_in_a_tar_is_refused():
    entry = tarfile.TarInfo("train-000001.meta.json")
    entry.type, entry.linkname = tarfile.SYMTYPE, "/etc/passwd"
    with pytest.raises(tarfile.TarError, match="not a plain file"):
        unpack(entry.tobuf(tarfile.USTAR_FORMAT))


def test_a_sparse_file_in_a_tar_is_refused_before_it_is_filled():
    entry = tarfile.TarInfo("train-000001.meta.json")
    entry.type = tarfile.GNUTYPE_SPARSE
    header = bytearray(entry.tobuf(tarfile.GNU_FORMAT))
    header[386:398], header[398:410], header[483:495] = b"00000000000\0", b"00000000001\0", b"77777777777\0"
    header[148:156] = b"%06o\0 " % (sum(header[:148]) + 8 * 32 + sum(header[156:512]))
    with pytest.raises(tarfile.TarError, match="not a plain file"):
        unpack(bytes(header) + bytes(1024))


def test_names_that_lead_to_names_without_end_are_refused():
    entry = tarfile.TarInfo("././@LongLink")
    entry.type, entry.size = tarfile.GNUTYPE_LONGNAME, 10
    with pytest.raises(tarfile.TarError, match="header is damaged"):
        unpack((entry.tobuf(tarfile.GNU_FORMAT) + b"a".ljust(512, b"\0")) * 2000)


def test_a_pipe_in_place_of_an_index_or_a_manifest_is_refused(finished, tmp_path):
    root = Path(shutil.copytree(finished.root, tmp_path / "data"))
    (root / "train-00000.json").unlink()
    os.mkfifo(root / "train-00000.json")
    with pytest.raises(ShardError, match=r"train-00000\.json: the index cannot be read \(not a regular file\)"):
        ShardSplit(root, "train")[0]
    (root / "manifest.json").unlink()
    os.mkfifo(root / "manifest.json")
    with pytest.raises(ShardError, match="there is no finished data set here"):
        ShardSplit(root, "train")
