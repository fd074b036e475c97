import numpy as np
import pytest

from rfpp.scene.sampling.objects.space_curves import Curve, handle, knot, pipe, ring, spring

CURVES = [handle, ring, pipe, spring, knot]


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("draw", CURVES, ids=lambda f: f.__name__)
def test_frames_are_right_handed_and_turn_smoothly(draw, closed):
    for seed in range(10):
        curve = draw(np.random.default_rng(seed), 60)
        tangents, (normals, binormals) = curve.tangents(), curve.frames(turns=int(closed))
        frames = np.stack([tangents, normals, binormals], axis=1)
        assert frames @ frames.transpose(0, 2, 1) == pytest.approx(np.tile(np.eye(3), (60, 1, 1)), abs=1e-9)
        assert np.linalg.det(frames) == pytest.approx(1)
        following = np.roll(frames, -1, axis=0) if curve.closed else frames[1:]
        cosine = np.einsum("sij,sij->si", frames[: len(following)], following)
        assert cosine.min() > 0.5  # also where a closed curve's ends meet


def test_neighboring_turns_of_a_spring_limit_its_thickness():
    angle = np.linspace(0, 8 * np.pi, 120)
    helix = Curve(np.stack([np.cos(angle), np.sin(angle), 0.05 * angle], axis=1), closed=False)
    assert helix.free_radius() == pytest.approx(0.05 * np.pi, rel=0.05)
