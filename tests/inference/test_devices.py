"""A device that does not exist is refused before anything runs on it."""

import pytest
import torch

from rfpp.errors import UserError
from rfpp.inference.devices import available_device


@pytest.mark.parametrize("name", ["nonsense", "cuda:99", "meta"])
def test_unavailable_devices_are_refused(name):
    with pytest.raises(UserError, match=f"device={name}: is not available .*: give cpu, or null to choose"):
        available_device(name)


def test_without_a_name_there_is_always_a_device():
    assert available_device(None).type in ("cpu", "cuda")
    assert available_device("cpu") == torch.device("cpu")
