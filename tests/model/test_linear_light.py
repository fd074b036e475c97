"""Networks whose light comes from cells: what physics asks of them, whatever their weights."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from networks import network
from random_scenes import random_cells
from stored_sample import stored_sample

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError
from rfpp.raycast.first_hit import CHANNELS, LIGHT_CHANNELS
from rfpp.imaging.radiance import log_decode
from rfpp.model.bounces import light_after
from rfpp.model.couplings import Corrections, DenseCouplings
from rfpp.model.form_factors import CastFormFactors, UnoccludedFormFactors
from rfpp.model.linear_transport import HIGHEST_ALBEDO
from rfpp.model.lit_cells import Reflectance
from rfpp.model.radiosity import UnlearnedRadiosity
from rfpp.packed_cells import LIGHT, PackedCells
from rfpp.shards.views import select_views

LINEAR = ("experiment=quickstart",)
CORRECTED = ("experiment=quickstart", "model=corrected_light")


@pytest.fixture(scope="module")
def sample():
    return stored_sample()


@pytest.fixture(params=[LINEAR, CORRECTED], ids=["linear", "corrected"])
def net(request):
    return network(*request.param)


@pytest.fixture
def linear():
    return network(*LINEAR)


def batch_of(net, sample, light: np.ndarray | float = 1.0, channel_light: dict | None = None) -> RaggedBatch:
    """The sample with its light times a factor, one for all or one for each colour."""
    views = select_views(sample, range(len(sample.fov)), net.gbuffer_channels)
    gbuffer, start = views.gbuffer.copy(), 0
    for name in net.gbuffer_channels:
        if name in LIGHT_CHANNELS:
            gbuffer[:, start : start + 3] *= np.broadcast_to(light, 3)[:, None, None]
        start += CHANNELS[name]
    material = views.triangles.material.copy()
    material[:, 7:] *= light
    cells = replace(views.cells, **{name: getattr(views.cells, name) * np.float32(light) for name in LIGHT})
    triangles = replace(views.triangles, material=material)
    return RaggedBatch.pack([replace(views, gbuffer=gbuffer, triangles=triangles, cells=cells)])


@torch.no_grad()
def image(net, batch: RaggedBatch) -> torch.Tensor:
    """Linear radiance in double precision, as far as the logarithm keeps it."""
    return log_decode(net(batch).log_radiance.double())


def test_lights_add_up(linear, sample):
    red, rest = np.array([1, 0, 0.25]), np.array([0, 1, 0.75])
    together = image(linear, batch_of(linear, sample))
    apart = image(linear, batch_of(linear, sample, red)) + image(linear, batch_of(linear, sample, rest))
    torch.testing.assert_close(together, apart, rtol=1e-5, atol=1e-6)


def test_twice_the_light_is_twice_the_image(net, sample):
    once, twice = image(net, batch_of(net, sample)), image(net, batch_of(net, sample, 2.0))
    assert once.max() > 0
    torch.testing.assert_close(twice, 2 * once, rtol=1e-5, atol=1e-6)


def test_images_whose_light_ends_are_compared_with_light_that_ends(linear, sample):
    """After n bounces: n − 1 between cells and the last one to pixels; each scene of a batch as its own images do."""
    views = select_views(sample, range(len(sample.fov)), linear.gbuffer_channels)
    ends = (1, 3, None)
    mixed = image(linear, RaggedBatch.pack([replace(views, bounces=n) for n in ends]))
    assert mixed[0].sum() < mixed[1].sum() < mixed[2].sum()
    trained_for = linear.transport.iterations
    for scene, n in zip(mixed, ends, strict=True):
        linear.transport.iterations = trained_for if n is None else n - 1
        torch.testing.assert_close(scene, image(linear, RaggedBatch.pack([views]))[0], rtol=1e-5, atol=1e-7)


def test_without_light_it_is_exactly_black(net, sample):
    assert not image(net, batch_of(net, sample, 0.0)).any()


@pytest.mark.parametrize("brightness", [1.0, 1e5])
def test_nothing_is_negative_and_nothing_overflows(net, sample, brightness):
    radiance = image(net, batch_of(net, sample, brightness))
    assert torch.isfinite(radiance).all() and (radiance >= 0).all()


def test_weights_know_no_light(linear, sample):
    """What they are computed from is the same to the bit whatever the lights, and light only scales."""
    dark, bright = (linear.encode(batch_of(linear, sample, factor)).tokens for factor in (0.25, 4.0))
    torch.testing.assert_close(dark.features, bright.features, rtol=0, atol=0)
    torch.testing.assert_close(dark.cells.features, bright.cells.features, rtol=0, atol=0)
    torch.testing.assert_close(16 * dark.cells.arriving, bright.cells.arriving, rtol=1e-6, atol=0)


def test_every_part_of_the_image_comes_through_cells_or_is_known(linear, sample):
    batch = batch_of(linear, sample)
    dark = {name: torch.zeros_like(getattr(batch.cells, name)) for name in LIGHT}
    known_alone = replace(batch, cells=replace(batch.cells, **dark))
    gathered = image(linear, batch) - image(linear, known_alone)
    assert (gathered > -1e-6).all() and gathered.max() > 0


def test_gradients_reach_every_parameter(net, sample):
    net.train()
    net(batch_of(net, sample)).log_radiance.sum().backward()
    assert not [name for name, p in net.named_parameters() if p.grad is None or not p.grad.any()]


def closed_box(count: int = 6) -> PackedCells:
    """Cells that see each other and nothing else, equally lit."""
    cells = random_cells(np.random.default_rng(0), count, per_object=1)
    hits = np.stack([np.delete(np.arange(count), cell) for cell in range(count)]).astype(np.int32)
    cells = replace(cells, hits=hits, onward=hits[:, ::-1], arriving=np.ones_like(cells.arriving))
    return PackedCells.pack([cells], [count])


@pytest.mark.parametrize("share", [0.0, 0.6], ids=["dull", "shiny"])
@pytest.mark.parametrize("albedo", [0.3, 0.9, HIGHEST_ALBEDO])
def test_in_a_closed_box_light_is_the_geometric_series(albedo, share):
    """Bounce by bounce, whatever share of the albedo is specular: where all is equally bright, nobody sees a lobe."""
    cells = closed_box()
    specular = torch.full_like(cells.arriving, share * albedo)
    cells = replace(cells, highlights=specular)  # emitters light all of it by 1
    factors = CastFormFactors()
    assert not factors(cells).escaping.any()
    dull = torch.full_like(specular, albedo)
    reflectance = Reflectance(dull - specular, specular)
    states = light_after(cells.arriving, factors.bounce(cells, reflectance), 40)
    for k, state in enumerate(states):
        expected = (1 - albedo ** (k + 1)) / (1 - albedo)
        torch.testing.assert_close(state, torch.full_like(state, expected), rtol=1e-5, atol=0)


def test_energy_never_grows(linear, sample):
    """Whatever was learned: row sums of A of at most 1, albedos below, so that what is added falls bounce by bounce."""
    batch = batch_of(linear, sample)
    _, (_, states) = linear.transported_each(*linear.tokenize(batch), 12)
    added = [(b - a).max().item() for a, b in pairwise(states)]
    for two_before, before, now in zip(added, added[1:], added[2:], strict=False):
        assert now <= HIGHEST_ALBEDO * max(before, two_before) + 1e-9  # what a lobe sends back is of two bounces ago
    assert min((b - a).min().item() for a, b in pairwise(states)) >= -1e-6


def test_form_factors_by_formula_are_those_by_rays_where_nothing_stands_between():
    """Of two small squares that face each other at distance 1: A / π, whatever is in between for the formula."""
    cells = random_cells(np.random.default_rng(0), 2, per_object=1)
    centre, normal = np.float32([[0, 0, 0], [0, 0, 1]]), np.float32([[0, 0, 1], [0, 0, -1]])
    area = np.float32([0.01, 0.01])
    packed = PackedCells.pack([replace(cells, centre=centre, normal=normal, area=area)], [2])
    share = UnoccludedFormFactors()(packed).share
    expected = 0.01 / (np.pi + 0.01)
    torch.testing.assert_close(share[0], torch.tensor([[0, expected], [expected, 0]]), rtol=1e-5, atol=1e-8)


def test_padding_is_no_cell():
    """Scenes with more and fewer cells: one by one and together the same."""
    rng = np.random.default_rng(1)
    few, many = random_cells(rng, 2, per_object=2), random_cells(rng, 5, per_object=3)
    together, alone = PackedCells.pack([few, many], [2, 5]), PackedCells.pack([few], [2])
    leaving = torch.rand(len(together), 3)
    for factors in (CastFormFactors(), UnoccludedFormFactors()):
        both, one = factors(together), factors(alone)
        torch.testing.assert_close(both.arriving(leaving)[:4], one.arriving(leaving[:4]))
        assert torch.isfinite(both.share).all()


def test_rays_couple_cells_as_the_matrix_of_what_they_see():
    """Corrected: what arrives, and how far that is from what the rays see."""
    rng = np.random.default_rng(2)
    scenes = [random_cells(rng, objects, per_object=2) for objects in (2, 5)]
    hits = [rng.integers(-1, len(cells), cells.hits.shape).astype(np.int32) for cells in scenes]
    cells = PackedCells.pack([replace(c, hits=h) for c, h in zip(scenes, hits, strict=True)], [2, 5])
    learned = Corrections(torch.randn(len(cells), 4), torch.randn(len(cells), 4), torch.randn(len(cells)), bound=1.0)
    by_rays = CastFormFactors()(cells, learned)
    seen = torch.zeros(2, 10, 10)
    for scene, of_scene in enumerate(hits):
        for cell, ends in enumerate(of_scene):
            for end in ends[ends >= 0]:
                seen[scene, cell, end] += 1 / len(ends)
    sink = (1 - seen.sum(-1)) * cells.padded(learned.of_escape())
    by_matrix = DenseCouplings(cells, seen * learned.of_pairs(cells), sink)
    leaving = torch.rand(len(cells), 3)
    torch.testing.assert_close(by_rays.arriving(leaving), by_matrix.arriving(leaving))
    torch.testing.assert_close(by_rays.divergence(), by_matrix.divergence())
    assert by_rays.divergence() > 0.01 and CastFormFactors()(cells).divergence() < 1e-6


def test_what_cells_do_not_fit_is_refused(sample):
    four = network(*LINEAR, "model.tokenizer.queries=4")
    with pytest.raises(UserError, match="eight tokens an object"):
        four(batch_of(four, sample))
    net = network(*LINEAR)
    with pytest.raises(ValueError, match="carries none"):
        net(replace(batch_of(net, sample), cells=None))


def test_the_rival_that_learns_nothing_is_linear_too(sample):
    rival = UnlearnedRadiosity()
    once, thrice = image(rival, batch_of(rival, sample)), image(rival, batch_of(rival, sample, 3.0))
    assert once.max() > 0
    torch.testing.assert_close(thrice, 3 * once, rtol=1e-5, atol=1e-6)


def test_an_untrained_network_is_that_rival(sample):
    """Corrections start at nothing; all that differs is how shiny surfaces count, and the head's first guess."""
    net, rival = network(*CORRECTED).eval(), UnlearnedRadiosity()
    mine, its = image(net, batch_of(net, sample)), image(rival, batch_of(rival, sample))
    assert (mine - its).abs().mean() < 0.1 * its.mean()
