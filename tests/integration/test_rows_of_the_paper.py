"""From a checkpoint of every row of the paper's tables to complete tables."""

import csv

import pytest
import torch
from hydra.utils import instantiate
from networks import SMALLEST, checkpoint_info
from omegaconf import OmegaConf
from small_data import make

from rfpp.checkpoint.loading import CHECKPOINT_KEY, NETWORK_PREFIX
from rfpp.commands import CONFIG_DIR
from rfpp.evaluation.tables.__main__ import main as write_tables

VARIANTS = sorted(path.stem for path in (CONFIG_DIR / "experiment" / "paper").glob("*.yaml"))
DATA = ("small_scale", "large_scale", "renderformer")


@pytest.fixture(scope="module")
def checkpoints(composed, tmp_path_factory) -> list[str]:
    """Untrained small networks, saved as in training."""
    folder = tmp_path_factory.mktemp("runs")
    paths = []
    for experiment in ("large_scale", *(f"[large_scale,paper/{variant}]" for variant in VARIANTS)):
        cfg = composed("train", f"experiment={experiment}", "size=tiny", *SMALLEST, "run_dir=unused")
        model = OmegaConf.to_container(cfg.model, resolve=True)
        info = checkpoint_info(model, dataset="small_scale", method=cfg.method)
        state = {NETWORK_PREFIX + k: v for k, v in instantiate(cfg.model, _convert_="all").state_dict().items()}
        path = folder / cfg.variant / "checkpoints" / "last.ckpt"
        path.parent.mkdir(parents=True)
        torch.save({CHECKPOINT_KEY: info.to_dict(), "state_dict": state}, path)
        paths.append(str(path))
    return paths


def test_every_row_is_evaluated_and_in_the_tables(checkpoints, composed, tmp_path):
    from launch.evaluate import main

    for name in DATA:
        splits = {"train": 2, "train_newviews": 2, "test": 2}
        root = make(tmp_path / name, name=name, splits=splits, resolution=16).root
        cfg = composed(
            "evaluate", f"data.root={root}", f"checkpoint=[{','.join(checkpoints)}]", "evaluation.lpips=false",
            "evaluation.bootstrap.resamples=50", "evaluation.ablation_scenes=0", "device=cpu",
        )  # fmt: skip
        assert len(main.__wrapped__(cfg)) == len(checkpoints)

    write_tables([checkpoints[0].split("/rfpp/")[0], "--output", str(tmp_path / "tables")])
    for table, rows in (("table1", 6), ("table2", 10)):
        text = (tmp_path / "tables" / f"{table}.md").read_text()
        assert "not run" not in text
        written = list(csv.DictReader((tmp_path / "tables" / f"{table}.csv").open()))
        assert len({tuple(list(row.values())[:2]) for row in written}) >= rows
