"""The viewer's server, without a browser."""

import pytest
from edited_scenes import scene

from rfpp.errors import UserError
from rfpp.viewer.server import Viewer


@pytest.mark.parametrize(
    ("host", "port", "named"), [("127.0.0.1", 70000, "port=70000"), ("203.0.113.7", 0, "host=203")]
)
def test_an_address_that_is_not_ours_is_refused(renderer, tracer, host, port, named):
    with pytest.raises(UserError, match=named):
        Viewer(renderer, scene(), {}, tracer, host, port, longer_side=64, moving_seconds=1)
