"""What a training step sees: a pure function of seed, epoch and scene, moved rigidly, in an order all ranks share."""

from itertools import chain

import numpy as np
import pytest
from small_data import make
from two_lights import TwoLights, invented_lights

from rfpp.errors import ShardError, UserError
from rfpp.gbuffer.first_hit import first_hit, stack_channels
from rfpp.imaging.exr import decode_exr
from rfpp.scene.triangles import DIFFUSE, EMISSION, SPECULAR
from rfpp.shards import sample
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.order import ShuffledOrder
from rfpp.shards.views import AllViews, select_views
from rfpp.training.dealing import BySize, Dealing, InOrder
from rfpp.training.views import ColourPermutation, GlobalBatches, LightMixing, RigidAugmentation, TrainingViews, moved

CHANNELS = ("albedo", "normal", "position")


@pytest.fixture(scope="module")
def split(tmp_path_factory):
    manifest = make(tmp_path_factory.mktemp("views") / "small", splits={"train": 4})
    return ShardSplit(manifest.root, "train")


def test_selected_views_are_the_stored_ones(split):
    stored = split[1]
    views = select_views(stored, [1], CHANNELS)
    np.testing.assert_array_equal(views.image[0], stored.images[1].transpose(2, 0, 1))
    np.testing.assert_array_equal(views.c2w[0], stored.c2w[1])
    assert views.gbuffer.shape == (1, 9, 8, 8)


def test_a_draw_depends_on_seed_epoch_and_scene_only(split):
    augmentation = RigidAugmentation(rotation=1.0, translation=0.25)
    first, again = (TrainingViews(split, CHANNELS, 1, augmentation, None, seed=3)[5, 2] for _ in range(2))
    np.testing.assert_array_equal(first.triangles.positions, again.triangles.positions)
    np.testing.assert_array_equal(first.image, again.image)
    for other in (
        TrainingViews(split, CHANNELS, 1, augmentation, None, seed=4)[5, 2],
        TrainingViews(split, CHANNELS, 1, augmentation, None, seed=3)[6, 2],
    ):
        assert not np.allclose(first.triangles.positions, other.triangles.positions)


def test_all_views_of_a_scene_come_up(split):
    images = {TrainingViews(split, CHANNELS, 1, None, None, seed=0)[epoch, 0].image.tobytes() for epoch in range(20)}
    assert len(images) == 2


def test_moving_scene_and_camera_leaves_gbuffers_and_images(split):
    views = AllViews(split, CHANNELS)[0]
    rng = np.random.default_rng(0)
    turned = RigidAugmentation(rotation=1.0, translation=0.25)(views, rng)
    assert not np.allclose(turned.triangles.positions, views.triangles.positions, atol=0.1)
    np.testing.assert_array_equal(turned.image, views.image)
    for v in range(2):
        fov = float(turned.fov[v])
        seen = first_hit(turned.triangles, turned.c2w[v], fov, 8, 8)
        channels = stack_channels(seen, turned.triangles.material, fov, CHANNELS)
        agreeing = np.isclose(channels, views.gbuffer[v], atol=2e-3).all(axis=0)
        assert agreeing.mean() > 0.95  # a pixel on an edge may see the other side of it


def test_a_move_is_rigid_and_right_handed(split):
    views = AllViews(split, CHANNELS)[0]
    turned = RigidAugmentation(rotation=2.0, translation=1.0)(views, np.random.default_rng(1))
    before, after = (np.linalg.norm(np.diff(v.triangles.positions, axis=1), axis=-1) for v in (views, turned))
    np.testing.assert_allclose(after, before, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(turned.c2w[:, :3, :3]), 1, rtol=1e-5)


def test_augmentation_has_the_documented_spread(split):
    views = AllViews(split, CHANNELS)[0]
    augmentation = RigidAugmentation(rotation=0.0, translation=0.25)
    rng = np.random.default_rng(2)
    shifts = np.array([augmentation(views, rng).c2w[0, :3, 3] - views.c2w[0, :3, 3] for _ in range(300)])
    np.testing.assert_allclose(shifts.std(axis=0), 0.25, rtol=0.15)
    np.testing.assert_allclose(shifts.mean(axis=0), 0, atol=0.05)


def test_moved_rotates_normals_with_the_triangles(split):
    views = AllViews(split, CHANNELS)[0]
    quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    turned = moved(views, quarter, np.zeros(3))
    np.testing.assert_allclose(turned.triangles.normals[..., 1], views.triangles.normals[..., 0], atol=1e-6)


def triangles_of(draw: tuple[int, int]) -> int:
    return 2 ** draw[1]


def global_batches(dealing: Dealing, **how) -> list[list[tuple[int, int]]]:
    order = ShuffledOrder([2, 3, 1], seed=1, window=2)
    return list(GlobalBatches(order, dealing, triangles_of, **{"scenes_per_batch": 4, "batches": 6, **how}))


DEALINGS = (InOrder(), BySize())


@pytest.mark.parametrize("dealing", DEALINGS)
def test_ranks_share_each_global_batch_and_epochs_are_complete(dealing):
    whole = global_batches(dealing)
    assert whole == global_batches(InOrder())
    for ranks, accumulate in ((2, 1), (4, 1), (2, 2), (1, 2), (1, 4)):
        parts = [global_batches(dealing, rank=rank, ranks=ranks, accumulate=accumulate) for rank in range(ranks)]
        steps = [[part[i * accumulate : (i + 1) * accumulate] for part in parts] for i in range(6)]
        assert {len(batch) for step in steps for part in step for batch in part} == {4 // (ranks * accumulate)}
        dealt = [[draw for part in step for batch in part for draw in batch] for step in steps]
        assert [sorted(step) for step in dealt] == [sorted(batch) for batch in whole]
        assert dealt == whole or isinstance(dealing, BySize)
    draws = list(chain.from_iterable(whole))
    for epoch in range(4):
        assert sorted(index for e, index in draws if e == epoch) == list(range(6))


def test_ranks_are_balanced_however_they_accumulate():
    """Dealt to all parts at once, one rank could get all the large ones."""
    at_once = [global_batches(BySize(), rank=rank, ranks=2) for rank in (0, 1)]
    one_by_one = [global_batches(BySize(), rank=rank, ranks=2, accumulate=2) for rank in (0, 1)]
    for whole, singles in zip(at_once, one_by_one, strict=True):
        assert [sorted(batch) for batch in whole] == [
            sorted(a + b) for a, b in zip(singles[::2], singles[1::2], strict=True)
        ]


@pytest.mark.parametrize("dealing", DEALINGS)
@pytest.mark.parametrize("start", range(7))
def test_a_run_that_goes_on_gives_the_rest_of_the_batches(start, dealing):
    for rank in (0, 1):
        rest = global_batches(dealing, start=start, rank=rank, ranks=2)
        assert rest == global_batches(dealing, rank=rank, ranks=2)[start:]


def test_a_batch_that_does_not_divide_among_ranks_is_refused():
    with pytest.raises(ValueError, match="5 scenes per step do not divide among 2 ranks"):
        global_batches(InOrder(), scenes_per_batch=5, ranks=2)


def test_a_training_draw_decodes_its_views_alone(split, monkeypatch):
    decoded = []
    monkeypatch.setattr(sample, "decode_exr", lambda data, name: decoded.append(name) or decode_exr(data, name))
    views = TrainingViews(split, CHANNELS, 1, None, None, seed=0)[0, 1]
    assert views.image.shape[0] == 1
    assert len(decoded) == 2  # the image and its surfaces, no direct light
    assert len({name.split(".")[1] for name in decoded}) == 1


def test_colour_channels_trade_places_everywhere_at_once(split):
    views = AllViews(split, CHANNELS)[0]
    rng = np.random.default_rng(0)
    for _ in range(8):
        swapped = ColourPermutation()(views, CHANNELS, rng)
        order = [int(np.argmax(np.isclose(swapped.image[0, c], views.image[0]).all((1, 2)))) for c in range(3)]
        assert sorted(order) == [0, 1, 2]
        for columns in (DIFFUSE, SPECULAR, EMISSION):
            before, after = (v.triangles.material[:, columns] for v in (views, swapped))
            np.testing.assert_array_equal(after, before[:, order])
        np.testing.assert_array_equal(swapped.gbuffer[:, :3], views.gbuffer[:, order])
        np.testing.assert_array_equal(swapped.object_light, views.object_light[:, order])
        np.testing.assert_array_equal(swapped.gbuffer[:, 3:], views.gbuffer[:, 3:])
        np.testing.assert_array_equal(swapped.triangles.material[:, 6], views.triangles.material[:, 6])


@pytest.fixture(scope="module")
def by_light(tmp_path_factory):
    root = tmp_path_factory.mktemp("lights") / "apart"
    make(root, TwoLights(), render_lights=invented_lights, splits={"train": 2}, by_light=True)
    return ShardSplit(root, "train")


def test_lights_are_mixed_draw_by_draw(by_light):
    lit = (*CHANNELS, "direct_diffuse")
    mixing = LightMixing(power=4.0, saturation=0.5)
    draw, again = (TrainingViews(by_light, lit, 2, None, None, 0, mixing)[0, 1] for _ in range(2))
    plain = TrainingViews(by_light, lit, 2, None, None, 0)[0, 1]
    np.testing.assert_array_equal(draw.image, again.image)
    np.testing.assert_array_equal(draw.c2w, plain.c2w)
    factors = draw.triangles.material[-2:, EMISSION] / plain.triangles.material[-2:, EMISSION]
    assert not np.allclose(factors[0], factors[1], rtol=0.05)
    for factor in factors:
        assert (factor > 0.5 / 4).all() and (factor < 4).all() and factor.min() >= 0.5 * factor.max()
    np.testing.assert_array_equal(draw.gbuffer[:, :9], plain.gbuffer[:, :9])
    brighter = draw.gbuffer[:, 9:].sum((0, 2, 3)) / plain.gbuffer[:, 9:].sum((0, 2, 3))
    assert (brighter >= np.min(factors, axis=0) * 0.99).all() and (brighter <= np.max(factors, axis=0) * 1.01).all()
    others = TrainingViews(by_light, lit, 2, None, None, 0, mixing)
    assert not np.allclose(draw.image.mean(), others[1, 1].image.mean(), rtol=1e-3)


def test_without_lights_apart_they_cannot_be_mixed(split):
    with pytest.raises(ShardError, match="light_augmentation=null"):
        TrainingViews(split, CHANNELS, 1, None, None, 0, LightMixing(power=2.0, saturation=0.0))[0, 0]


@pytest.mark.parametrize(("power", "saturation"), [(0.5, 0.0), (2.0, 1.0), (2.0, -0.1)])
def test_mixing_refuses_what_is_no_range(power, saturation):
    with pytest.raises(UserError, match="light_augmentation"):
        LightMixing(power, saturation)
