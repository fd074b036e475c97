"""OpenEXR files: exact round trips, and one clear error for damaged ones."""

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from rfpp.errors import UserError
from rfpp.imaging.exr import (
    HALF_MAX,
    ImageFileError,
    compact,
    decode_exr,
    encode_exr,
    exr_attributes,
    read_exr,
    write_exr,
)


@pytest.fixture
def layers():
    rng = np.random.default_rng(0)
    return {
        "RGB": rng.lognormal(0, 3, (9, 13, 3)).astype(np.float16),
        "albedo": rng.random((9, 13, 3)).astype(np.float32),
        "depth": rng.random((9, 13)).astype(np.float32),
        "object": rng.integers(0, 2**32 - 1, (9, 13), dtype=np.uint32),
    }


def test_layers_and_attributes_round_trip(layers):
    before = {name: layer.copy() for name, layer in layers.items()}
    decoded = decode_exr(encode_exr(layers))
    assert decoded.keys() == layers.keys()
    for name, layer in before.items():
        assert decoded[name].dtype == layer.dtype
        np.testing.assert_array_equal(decoded[name], layer)
        np.testing.assert_array_equal(layers[name], layer)
    transposed = layers["RGB"].transpose(1, 0, 2)
    np.testing.assert_array_equal(decode_exr(encode_exr({"RGB": transposed}))["RGB"], transposed)
    data = encode_exr(layers, {"settings": "samples: 16\nseed: 0"})
    assert exr_attributes(data)["settings"] == "samples: 16\nseed: 0"


@pytest.mark.parametrize(
    "bad",
    [
        {},
        {"RGB": np.zeros((4, 4, 2), np.float16)},
        {"RGB": np.zeros((4, 4, 6), np.float16)},
        {"RGB": np.zeros((4, 4, 3), np.float64)},
        {"RGB": np.zeros((4, 4, 3), np.float16), "depth": np.zeros((4, 5), np.float32)},
    ],
)
def test_unsupported_shapes_and_types_are_refused(bad):
    with pytest.raises(ValueError, match="layer"):
        encode_exr(bad)


@pytest.mark.parametrize("kept", [0.0, 0.1, 0.5, 0.99])
def test_truncated_data_is_one_clear_error(layers, kept):
    data = encode_exr(layers)
    with pytest.raises(ImageFileError, match=r"^shard-0007/12\.exr: .*OpenEXR") as caught:
        decode_exr(data[: int(kept * len(data))], "shard-0007/12.exr")
    assert "\n" not in str(caught.value)


def test_damaged_and_missing_files_are_an_error():
    data = bytearray(encode_exr({"RGB": np.random.default_rng(0).random((64, 64, 3)).astype(np.float16)}))
    data[len(data) // 2] ^= 0xFF
    with pytest.raises(ImageFileError):
        decode_exr(bytes(data))
    with pytest.raises(ImageFileError, match="absent.exr"):
        read_exr(Path("absent.exr"))


def test_values_beyond_half_floats_stay_in_single_precision():
    usual, bright = np.full((2, 2, 3), 3.0, np.float32), np.full((2, 2, 3), 2 * HALF_MAX, np.float32)
    assert compact(usual).dtype == np.float16
    np.testing.assert_array_equal(compact(bright), bright)


def test_a_full_disk_names_the_path_and_keeps_the_old_file(layers, tmp_path, monkeypatch):
    path = write_exr(tmp_path / "new" / "view.exr", {"RGB": layers["RGB"]})

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(UserError, match=r"view\.exr.*No space left"):
        write_exr(path, {"RGB": layers["RGB"] * 2})
    np.testing.assert_array_equal(read_exr(path)["RGB"], layers["RGB"])
    assert [p.name for p in path.parent.iterdir()] == ["view.exr"]
