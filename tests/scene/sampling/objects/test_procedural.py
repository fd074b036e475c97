from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chisquare

from rfpp.errors import SceneError
from rfpp.scene.sampling.objects.deformation import DEFORMATIONS
from rfpp.scene.sampling.objects.procedural import KINDS, ProceduralObjects
from rfpp.scene.sampling.objects.refinement import is_closed
from rfpp.scene.sampling.objects.solid import volume

OBJECTS = ProceduralObjects(list(KINDS), pool=1000, held_out=0.2, stretched=0.5, deformed=0.2)


def one_kind(kind, deformed=0.0):
    return replace(OBJECTS, kinds=[kind], deformed=deformed)


def times_covered(mesh, points):
    """[P] how many times the surface winds around each point, by the sum of solid angles (Van Oosterom 1983)."""
    a, b, c = (mesh.corners[None, :, k].astype(np.float64) - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    det = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
    dots = (np.einsum("pfi,pfi->pf", u, v) * w for u, v, w in ((a, b, lc), (b, c, la), (c, a, lb)))
    return 2 * np.arctan2(det, la * lb * lc + sum(dots)).sum(axis=1) / (4 * np.pi)


@pytest.mark.parametrize("deformed", [0.0, 1.0])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("target", [12, 50, 151, 300, 1200])
def test_every_kind_is_closed_outward_normalized_and_of_the_asked_count(kind, target, deformed):
    source = one_kind(kind, deformed)
    for number in range(5):
        mesh = source.mesh(number, target)
        assert len(mesh) == target // 2 * 2
        assert is_closed(mesh)
        assert volume(mesh) > 0
        assert mesh.vertices.mean(axis=0) == pytest.approx(0, abs=1e-5)
        assert np.linalg.norm(mesh.vertices, axis=1).max() == pytest.approx(0.5, abs=1e-5)


@pytest.mark.parametrize("deformed", [0.0, 1.0])
@pytest.mark.parametrize("kind", KINDS)
def test_no_solid_passes_through_itself_or_turns_inside_out(kind, deformed):
    points = np.random.default_rng(0).uniform(-0.4, 0.4, (150, 3))
    source = one_kind(kind, deformed)
    covered = np.concatenate([times_covered(source.mesh(number, 400), points) for number in range(12)])
    # Where a coarse surface dents, a point in a thousand may lie beyond it.
    assert np.mean(np.minimum(np.abs(covered), np.abs(covered - 1)) < 0.01) > 0.999
    assert np.mean(covered > 0.5) > 0.003


def test_an_object_depends_on_its_number_alone():
    first, again, other = (OBJECTS.mesh(number, 200) for number in (1, 1, 2))
    assert np.array_equal(first.vertices, again.vertices)
    assert np.array_equal(first.faces, again.faces)
    assert first.vertices.shape != other.vertices.shape or not np.allclose(first.vertices, other.vertices)


def test_test_scenes_and_training_scenes_share_no_object(monkeypatch):
    drawn, box = [], one_kind("primitive").mesh(0, 12)
    monkeypatch.setattr(ProceduralObjects, "mesh", lambda self, number, target_faces: drawn.append(number) or box)
    rng = np.random.default_rng(0)
    for held_out in [False, True] * 4000:
        OBJECTS.sample(rng, 100, held_out)
    training, test = np.array(drawn[::2]), np.array(drawn[1::2])
    assert training.max() < 800 <= test.min()
    assert test.max() < 1000
    assert chisquare(np.histogram(training, bins=20, range=(0, 800))[0]).pvalue > 0.01
    assert chisquare(np.histogram(test, bins=20, range=(800, 1000))[0]).pvalue > 0.01


def test_every_kind_and_deformation_is_equally_frequent(monkeypatch):
    drawn = []

    def noted(name, mesh):
        return lambda *_: drawn.append(name) or mesh

    box = one_kind("primitive").mesh(0, 12)
    for kind in KINDS:
        monkeypatch.setitem(KINDS, kind, noted(kind, box))
    for name in DEFORMATIONS:
        monkeypatch.setitem(DEFORMATIONS, name, noted(name, lambda points: points))
    for number in range(2000):
        OBJECTS.mesh(number, 12)
    assert chisquare([drawn.count(kind) for kind in KINDS]).pvalue > 0.01
    assert chisquare([drawn.count(name) for name in DEFORMATIONS]).pvalue > 0.01
    assert sum(map(drawn.count, DEFORMATIONS)) / 2000 == pytest.approx(0.2, abs=0.03)


def test_wrong_requests_are_refused_by_name():
    with pytest.raises(SceneError, match="'teapot': choose from superellipsoid"):
        one_kind("teapot")
    with pytest.raises(SceneError, match="kinds: the list is empty"):
        replace(OBJECTS, kinds=[])
    with pytest.raises(SceneError, match="11 triangles are too few"):
        OBJECTS.mesh(0, 11)


@pytest.mark.parametrize("part", [{"held_out": 0.0}, {"held_out": 1.0}, {"pool": 2, "held_out": 0.1}])
def test_each_part_has_at_least_one_object(part):
    with pytest.raises(SceneError, match="leaves one part empty"):
        replace(OBJECTS, **part)
