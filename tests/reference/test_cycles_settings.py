"""What concerns reference images but needs no Blender."""

import builtins
import dataclasses
import importlib.util
import subprocess

import numpy as np
import pytest
from known_scenes import still_life
from reference_presets import preset

from rfpp.errors import MissingDependencyError, UserError
from rfpp.reference import cycles


@pytest.mark.parametrize("name", ["preview", "training", "paper"])
def test_every_setting_is_stated_in_yaml(name):
    assert preset(name).keys() == {field.name for field in dataclasses.fields(cycles.CyclesSettings)}
    cycles.CyclesSettings(**preset(name))


def test_the_papers_reference_is_adaptive_and_denoised():
    paper = preset("paper")
    assert (paper["samples"], paper["adaptive_threshold"], paper["denoise"]) == (4096, 0.01, True)


@pytest.mark.parametrize(
    ("key", "value"), [("samples", 0), ("filter_width", 0.0), ("seed", -1), ("clamp_direct", -0.5)]
)
def test_a_setting_that_blender_would_silently_change_is_refused(key, value):
    with pytest.raises(UserError, match=rf"reference\.{key} is {value}"):
        cycles.CyclesSettings(**preset("preview") | {key: value})


def test_without_blender_the_error_says_how_to_install_it(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingDependencyError, match=r'pip install "rfpp\[blender\]"'):
        cycles.require_blender()


def test_a_missing_system_library_is_named_with_its_packages(monkeypatch):
    reason = "ImportError: libXrender.so.1: cannot open shared object file: No such file or directory"
    failed = subprocess.CompletedProcess([], 1, stdout="", stderr=f"Traceback …\n{reason}\n")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(subprocess, "run", lambda *args, **kwargs: failed)
    with pytest.raises(
        MissingDependencyError, match=r"libXrender\.so\.1.*apt-get install libxrender1 .*libgl1"
    ) as caught:
        cycles.require_blender()
    assert "\n" not in str(caught.value)


def test_rendering_without_blender_gives_the_same_advice(monkeypatch):
    original = builtins.__import__

    def without_bpy(name, *args, **kwargs):
        if name == "bpy":
            raise ImportError("No module named 'bpy'")
        return original(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without_bpy)
    with pytest.raises(MissingDependencyError, match=r"rfpp\[blender\]"):
        cycles.render(still_life(), np.eye(4)[None], np.array([40.0]), 8, 8, cycles.CyclesSettings(**preset("preview")))
