"""Gradients by materials and lights equal finite differences of rendered images."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from edited_scenes import MATTE, changed, lamp, recolored, scene
from networks import checkpoint_info, network

from rfpp import DifferentiableRenderer, Renderer
from rfpp.errors import SceneError, UserError
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR

SIDE = 16
COLUMNS = {"diffuse": DIFFUSE, "specular": SPECULAR, "roughness": ROUGHNESS, "emissive": EMISSION}
#: Half the step of the difference that a gradient is compared with; small where a change would let other rays of the
#: lobe on, for gradients are those of the rays as they are.
STEPS = {"diffuse": 0.02, "specular": 0.002, "roughness": 0.02, "emissive": 40.0}


@pytest.fixture(scope="module")
def ours() -> DifferentiableRenderer:
    return DifferentiableRenderer(Renderer.load("radiosity", "cpu", "fp32"))


@pytest.fixture(scope="module")
def still() -> PackedScene:
    """A shiny floor, peaks that differ, a white and a blue light, from one camera."""
    glossy = MATTE.model_copy(update={"diffuse": (0.2, 0.3, 0.4), "specular": (0.5, 0.4, 0.3), "roughness": 0.3})
    blue = lamp(700).model_copy(update={"emissive": (300.0, 500.0, 900.0)})
    edited = changed(recolored(scene()), "peak_2", material=glossy)
    edited = changed(edited, "floor", material=glossy.model_copy(update={"roughness": 0.5}))
    return pack(changed(edited, "spot", material=blue)).views([0])


def value(of: PackedScene, name: str, what: str) -> torch.Tensor:
    """A property of an object, that asks for a gradient."""
    triangles = of.triangles
    row = triangles.material[triangles.object_offsets[triangles.object_names.index(name)]]
    return torch.tensor(row[COLUMNS[what]][0] if what == "roughness" else row[COLUMNS[what]], requires_grad=True)


def edited(of: PackedScene, name: str, what: str, becomes: np.ndarray) -> PackedScene:
    triangles = of.triangles
    material = triangles.material.copy()
    material[triangles.object_index == triangles.object_names.index(name), COLUMNS[what]] = becomes
    return replace(of, triangles=replace(triangles, material=material))


@pytest.fixture(scope="module")
def gradients(ours, still) -> tuple[dict[tuple[str, str], np.ndarray], np.ndarray]:
    """Return gradients of a weighted sum of pixels by every property of every object, and the weights."""
    lights = still.triangles.light_names
    materials = {
        name: {what: value(still, name, what) for what in COLUMNS if (what == "emissive") == (name in lights)}
        for name in still.triangles.object_names
    }
    weights = np.random.default_rng(0).uniform(0.5, 1.5, (1, SIDE, SIDE, 3))
    image = ours.render(still, materials, SIDE)
    (image.double() * torch.from_numpy(weights)).sum().backward()
    return {(name, what): x.grad.numpy() for name, of in materials.items() for what, x in of.items()}, weights


COMPARED = [
    ("floor", "diffuse", 0), ("peak_0", "diffuse", 1), ("peak_2", "diffuse", 2),
    ("floor", "specular", 0), ("peak_2", "specular", 1), ("peak_0", "specular", 2),
    ("floor", "roughness", None), ("peak_2", "roughness", None),
    ("lamp", "emissive", 0), ("spot", "emissive", 2),
]  # fmt: skip


@pytest.mark.parametrize(("name", "what", "channel"), COMPARED, ids=[f"{n}-{w}" for n, w, _ in COMPARED])
def test_a_gradient_is_the_difference_of_two_renders(name, what, channel, ours, still, gradients):
    of_all, weights = gradients
    here, change = value(still, name, what).detach().numpy(), np.zeros(() if channel is None else 3, np.float32)
    change[() if channel is None else channel] = STEPS[what]
    more, less = (
        (ours.renderer.render(edited(still, name, what, there), SIDE).astype(np.float64) * weights).sum()
        for there in (here + change, here - change)
    )
    gradient = of_all[name, what][() if channel is None else channel]
    assert gradient == pytest.approx((more - less) / (2 * STEPS[what]), rel=0.01)


def test_the_image_equals_the_renderers(ours):
    views = pack(scene())
    color = torch.tensor([0.1, 0.7, 0.2], requires_grad=True)
    images = ours.render(views, {"peak_1": {"diffuse": color}}, (16, 24), light_samples=4, transports=2)
    assert images.shape == (3, 16, 24, 3)
    expected = ours.renderer.render(recolored(scene()), (16, 24), light_samples=4, transports=2)
    np.testing.assert_allclose(images.detach().numpy(), expected, rtol=1e-3, atol=1e-5)
    images[1].sum().backward()
    assert (color.grad > 0).all()


def test_without_gradients_there_is_no_graph(ours, still):
    image = ours.render(still, {"peak_0": {"diffuse": torch.tensor([0.1, 0.7, 0.2])}}, 16)
    assert not image.requires_grad
    expected = ours.renderer.render(edited(still, "peak_0", "diffuse", np.float32([0.1, 0.7, 0.2])), 16)
    np.testing.assert_allclose(image.numpy(), expected, rtol=1e-3, atol=1e-5)


def test_a_color_and_a_roughness_are_recovered_from_an_image(ours, still):
    target = torch.from_numpy(ours.renderer.render(still, SIDE))
    color, roughness = torch.full((3,), 0.5, requires_grad=True), torch.tensor(0.6, requires_grad=True)
    optimizer = torch.optim.Adam([color, roughness], lr=0.05)
    for step in range(30):
        image = ours.render(still, {"peak_0": {"diffuse": color}, "floor": {"roughness": roughness}}, SIDE)
        optimizer.param_groups[0]["lr"] = 0.05 * 0.9**step
        optimizer.zero_grad()
        (image - target).abs().mean().backward()
        optimizer.step()
    np.testing.assert_allclose(color.detach(), value(still, "peak_0", "diffuse").detach(), atol=0.03)
    assert roughness.item() == pytest.approx(0.5, abs=0.03)


GRAY = torch.full((3,), 0.5)
WRONG = {
    "an object that is not there": ({"ball": {"diffuse": GRAY}}, "'ball' does not exist: choose from floor, lamp"),
    "geometry": ({"floor": {"translation": GRAY}}, "has no gradient: choose from diffuse, specular"),
    "a number for a color": ({"floor": {"diffuse": torch.tensor(0.5)}}, "a tensor of three numbers"),
    "a color for a number": ({"floor": {"roughness": GRAY}}, "a tensor without axes"),
    "no tensor": ({"floor": {"diffuse": (0.5, 0.5, 0.5)}}, "tuple was given"),
    "more than all light": ({"floor": {"diffuse": 3 * GRAY}}, "must be between 0 and 1: clamp it"),
    "no number": ({"floor": {"roughness": torch.tensor(float("nan"))}}, "'roughness' of 'floor' is nan"),
    "a light that goes out": ({"lamp": {"emissive": 0 * GRAY}}, "a light cannot be switched off"),
    "a surface that lights up": ({"floor": {"emissive": GRAY}}, "other objects cannot become lights"),
}


@pytest.mark.parametrize(("materials", "named"), WRONG.values(), ids=WRONG.keys())
def test_invalid_materials_are_refused_by_name(materials, named, ours, still):
    with pytest.raises(UserError, match=named):
        ours.render(still, materials, 16)


def test_scenes_without_cameras_and_other_networks_are_refused(ours, still):
    with pytest.raises(SceneError, match="no camera"):
        ours.render(still.views([]), {}, 16)
    other = Renderer(network(), checkpoint_info(resolution=(16, 16)))
    with pytest.raises(UserError, match="gradients: this network's image is not a sum"):
        DifferentiableRenderer(other)
