"""References that are made beside the viewer."""

import queue

import pytest
from edited_scenes import scene

from rfpp.errors import UserError
from rfpp.scene.packed import pack
from rfpp.viewer import reference


@pytest.mark.parametrize(
    ("error", "told"), [(UserError("no Blender"), "no Blender"), (ZeroDivisionError("a defect"), "broke down")]
)
def test_what_goes_wrong_is_told(error, told, tracer, monkeypatch):
    def fails(*_):
        raise error

    monkeypatch.setattr(reference, "path_traced", fails)
    made, told_to = scene(), queue.Queue()
    packed = pack(made).seen_by(made.cameras[:1])
    tracer.trace(packed, made, made.cameras[0], (16, 16), told_to.put, told_to.put)
    assert told in told_to.get(timeout=30)
