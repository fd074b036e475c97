"""A small real data set: quickstart's family, rendered by Blender, once per session."""

from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from rfpp.commands import CONFIG_DIR


@pytest.fixture(scope="session")
def composed():
    """`composed(verb, *overrides)`: a verb's configuration."""

    def compose_verb(verb: str, *overrides: str) -> DictConfig:
        folder = CONFIG_DIR / "render" if verb in ("render", "relight") else CONFIG_DIR
        with initialize_config_dir(str(folder), version_base="1.3"):
            return compose(verb, overrides=list(overrides))

    return compose_verb


@pytest.fixture(scope="session")
def rendered_data(tmp_path_factory, composed) -> Path:
    """Folder of six scenes with four views of 32² each."""
    from launch.generate import main

    root = tmp_path_factory.mktemp("rendered") / "quickstart"
    splits = "data.splits={train: 3, train_newviews: 1, validation: 1, test: 2}"
    settings = ["experiment=quickstart", f"data.root={root}", "data.resolution=32", "data.scenes_per_shard=4", splits]
    main.__wrapped__(composed("generate", *settings))
    return root
