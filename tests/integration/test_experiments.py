import math

import pytest
from hydra.utils import instantiate
from omegaconf import OmegaConf
from small_data import make

from rfpp.commands import CONFIG_DIR
from rfpp.evaluation.tables.paper import TABLE_1, TABLE_2

PAPER = [f"paper/{path.stem}" for path in sorted((CONFIG_DIR / "experiment" / "paper").glob("*.yaml"))]
#: Experiments that change the network of another.
VARIANTS = [*PAPER, "known_light"]
#: Variants whose training step differs from the paper's in more than numbers.
OTHER_STEPS = [v for v in VARIANTS if "iteration" not in v and "finetuned" not in v]
#: Experiments with data of their own.
EXPERIMENTS = sorted({path.stem for path in (CONFIG_DIR / "experiment").glob("*.yaml")} - {*VARIANTS})
#: Method of known_light, which is not in the paper.
KNOWN_LIGHT = "RenderFormer++, known light"
METHODS = {row.method for table in (TABLE_1, TABLE_2) for block in table.blocks for row in block.rows}
VERBS = ("generate", "train", "evaluate")
GROUPS = ("family", "reference", "data", "size", "model", "loss", "optimizer", "datamodule", "trainer")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return make(tmp_path_factory.mktemp("data") / "small", splits={"train": 3, "validation": 1}).root


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_composes_for_every_verb_and_resolves(experiment, verb, composed):
    cfg = composed(verb, f"experiment={experiment}", "run_dir=unused", *(["checkpoint=x"] * (verb == "evaluate")))
    resolved = OmegaConf.to_container(cfg, resolve=True, throw_on_missing=True)
    assert experiment.startswith(resolved["name"].partition("-")[0])


@pytest.mark.parametrize("base", ["ablation", "large_scale"])
@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant_composes_under_a_name_of_its_own(variant, base, composed):
    cfg = composed("train", f"experiment=[{base},{variant}]", "run_dir=unused")
    resolved = OmegaConf.to_container(cfg, resolve=True, throw_on_missing=True)
    assert resolved["variant"] == variant.removeprefix("paper/")
    assert resolved["name"] == f"{resolved['data']['name']}-{resolved['variant']}"


def test_every_row_of_the_paper_has_an_experiment(composed):
    methods = [composed("train", f"experiment=[large_scale,{v}]", "run_dir=unused").method for v in VARIANTS]
    assert sorted([*methods, "RenderFormer++"]) == sorted(METHODS | {KNOWN_LIGHT})


def test_renderformer_has_as_many_parameters_as_the_released_one():
    from launch.parameters import counts_by_method

    counts = counts_by_method("base")
    assert counts.keys() == METHODS
    folded = (13 * 32 * 32 - 10) * 768  # patches of 13 channels where ours has ten numbers
    frequencies = 2 * 6  # constants in ours
    assert counts["RenderFormer"]["total"] + folded + frequencies == 205_173_391
    assert 0.9 < counts["RenderFormer++"]["total"] / 205_173_391 < 1


@pytest.mark.parametrize("group", GROUPS)
def test_every_choice_of_a_group_composes(group, composed):
    choices = sorted(path.stem for path in (CONFIG_DIR / group).glob("*.yaml"))
    assert choices
    for choice in choices:
        cfg = composed("train", f"{group}={choice}", "run_dir=unused")
        assert OmegaConf.to_container(cfg[group], resolve=True)


@pytest.mark.parametrize("benchmark", sorted(path.stem for path in (CONFIG_DIR / "benchmark").glob("*.yaml")))
def test_every_benchmark_composes(benchmark, composed):
    cfg = composed("benchmark", f"benchmark={benchmark}")
    assert OmegaConf.to_container(cfg.benchmark, resolve=True, throw_on_missing=True)


@pytest.mark.parametrize(
    "experiment", ["quickstart", "large_scale", "renderformer_data", *(f"[large_scale,{v}]" for v in OTHER_STEPS)]
)
def test_one_step_on_a_cpu_on_the_data_set_of_the_repository(experiment, composed, tmp_path):
    from launch.train import main

    cfg = composed(
        "train", f"experiment={experiment}", "debug=cpu", "logger=none", "steps=1", "loss.lpips_weight=0.0",
        "initial_weights=null", f"run_dir={tmp_path}",
    )  # fmt: skip
    assert main.__wrapped__(cfg) == tmp_path / "checkpoints" / "best.ckpt"


def test_large_scale_states_the_papers_settings(composed):
    cfg = composed("train", "experiment=large_scale", "run_dir=unused")
    assert cfg.steps == cfg.trainer.max_steps == cfg.schedule.total_steps == 500_000
    assert cfg.datamodule.batching.scenes_per_step * cfg.datamodule.batching.views_per_scene == 32
    assert (cfg.trainer.devices, cfg.trainer.strategy, cfg.trainer.precision) == (8, "ddp", "bf16-mixed")
    assert cfg.model.transport.iterations == 3
    assert cfg.model.tokenizer.queries == 8
    assert cfg.model.decoder.patch_size == 4
    assert list(cfg.model.decoder.gbuffer_channels) == ["albedo", "normal", "roughness"]
    assert cfg.model.exposure._target_.endswith(".UnitExposure")
    assert cfg.datamodule.augmentation.color is None
    assert (cfg.loss.l1_weight, cfg.loss.lpips_weight, cfg.loss.consistency_weight) == (1.0, 0.05, 0.1)
    assert cfg.loss.lpips_images_per_step is None
    assert (cfg.data.resolution, cfg.data.views, cfg.reference.samples) == (256, 4, 4096)
    optimizer = instantiate(cfg.optimizer)
    assert optimizer.keywords["lr"] == 1e-4
    assert math.isclose(optimizer.keywords["weight_decay"], 0.01)


def test_a_run_of_the_ablation_ends_with_a_checkpoint_and_a_panel(composed, data, tmp_path):
    from launch.train import main
    from rfpp.checkpoint.loading import load_network

    cfg = composed(
        "train", "experiment=[ablation,paper/renderformer]", "debug=cpu", "seed=1", f"data.root={data}",
        "data.resolution=8", "steps=2", "trainer.val_check_interval=2", "loss.lpips_weight=0.0",
        f"run_dir={tmp_path}/run", "logger=none",
    )  # fmt: skip
    _, info = load_network(main.__wrapped__(cfg))
    assert (info.method, info.seed, info.steps) == ("RenderFormer", 1, 2)
    assert (tmp_path / "run" / "panels" / "panels-000002.png").is_file()
