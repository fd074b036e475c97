"""The scene families of conf/family, and scenes drawn from them."""

from functools import cache
from pathlib import Path

import numpy as np
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

from rfpp.scene.sampling.family import SceneFamily
from rfpp.scene.spec import Scene

CONF = Path(__file__).parents[2] / "conf"


def family(name: str, *overrides: str) -> SceneFamily:
    """The family as `conf/family/<name>.yaml` describes it, with Hydra overrides."""
    with initialize_config_dir(config_dir=str(CONF), version_base="1.3"):
        cfg = compose(overrides=[f"+family={name}", *overrides])
    return instantiate(cfg.family, _convert_="all")


@cache
def scenes(name: str, count: int) -> tuple[Scene, ...]:
    """Training scenes 0 … count - 1 of a family."""
    source = family(name)
    return tuple(draw(source, [i, 0], [i, 1]) for i in range(count))


def draw(source: SceneFamily, scene_seed, camera_seed, held_out: bool = False) -> Scene:
    """The scene of these two seeds."""
    return source.sample(np.random.default_rng(scene_seed), np.random.default_rng(camera_seed), held_out=held_out)


def objects(scene: Scene, kind: str) -> list:
    """The scene's objects of one kind: "background", "object" or "light"."""
    return [item for item in scene.objects if item.name.startswith(f"{kind}_")]
