"""Objects: connected pieces, not too many of them, none lost."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from rfpp.errors import SceneError
from rfpp.scene.io.grouping import MAX_OBJECTS, components, merged
from rfpp.scene.io.imported_scene import Part, plain_material
from rfpp.scene.triangles import EMISSION

FILE = Path("a.ply")


def ball(center, radius: float = 0.1, name: str = "ball", emission: float = 0.0) -> Part:
    mesh = trimesh.creation.icosphere(0, radius)
    material = plain_material(20)
    material[:, EMISSION] = emission
    return Part(name, mesh.vertices + np.asarray(center), np.asarray(mesh.faces, np.int64), material, smooth=True)


def together(parts: list[Part], unwelded: bool = False) -> Part:
    """As one soup, its faces shuffled."""
    corners = np.concatenate([part.corners for part in parts])
    material = np.repeat(np.arange(len(parts)), 20)[:, None] / 1000 + np.zeros((1, 10), np.float32)
    order = np.random.default_rng(0).permutation(len(corners))
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return Part("soup", corners[order].reshape(-1, 3), faces, material[order].astype(np.float32), smooth=True)


def test_a_soup_of_triangles_falls_into_its_pieces_with_their_materials() -> None:
    pieces = list(components(together([ball((i, 0, 0)) for i in range(5)])))
    assert [len(piece) for piece in pieces] == [20] * 5
    centers = [piece.vertices[:, 0].mean() for piece in pieces]
    assert sorted(np.round(centers)) == [0, 1, 2, 3, 4]
    for piece, center in zip(pieces, centers, strict=True):
        np.testing.assert_allclose(piece.material, round(center) / 1000, atol=1e-7)


def test_fragments_join_the_nearest_body_and_no_triangle_is_lost() -> None:
    bodies = [ball((i, 0, 0), 0.3) for i in range(MAX_OBJECTS)]
    fragments = [ball((i, 0.5, 0), 0.01) for i in range(0, MAX_OBJECTS, 2)]
    pieces = list(components(together(bodies + fragments)))
    assert len(pieces) == MAX_OBJECTS
    for piece in pieces:
        index = round(piece.vertices[:, 0].mean())
        assert len(piece) == (40 if index % 2 == 0 else 20)
        assert np.ptp(piece.vertices[:, 0]) < 0.7


def test_parts_beyond_the_most_are_joined_and_lights_never_to_surfaces() -> None:
    parts = [ball((i, 0, 0), 0.1 + 0.01 * (i >= 10), f"b{i}") for i in range(MAX_OBJECTS + 10)]
    parts += [ball((0, 0, 1), 0.01, "lamp", emission=9.0)]
    with pytest.warns(UserWarning, match=r"a\.ply: 81 parts became 71 objects: small ones were joined to others"):
        kept = merged(parts, FILE)
    assert sum(map(len, kept)) == sum(map(len, parts))
    assert [part.name for part in kept if part.is_light] == ["lamp"]
    assert max(kept, key=len).name == "b10"  # the nearest to all ten


def test_too_many_loose_pieces_are_refused_by_their_number(monkeypatch) -> None:
    monkeypatch.setattr("rfpp.scene.io.grouping._MAX_PIECES", 2)
    soup = together([ball((x, 0, 0)) for x in range(3)], unwelded=True)
    with pytest.raises(SceneError, match="3 loose pieces are more than 2: join its triangles"):
        list(components(soup))


def test_names_become_unique() -> None:
    names = ["a", "a", "a_2", "a", "b"]
    kept = merged([ball((i, 0, 0), name=name) for i, name in enumerate(names)], FILE)
    assert len({part.name for part in kept}) == 5
    assert [part.name for part in kept][0::2] == ["a", "a_2", "b"]


def test_a_hundred_thousand_pieces_take_no_time() -> None:
    specks = np.random.default_rng(0).uniform(size=(100_000, 1, 3))
    corners = np.add(specks, [[0, 0, 0], [1e-3, 0, 0], [0, 1e-3, 0]])
    faces = np.arange(300_000).reshape(-1, 3)
    soup = Part("dust", corners.reshape(-1, 3), faces, plain_material(100_000), smooth=False)
    assert sum(map(len, components(soup))) == 100_000
