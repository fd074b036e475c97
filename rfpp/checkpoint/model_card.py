"""Model cards."""

from __future__ import annotations

from collections.abc import Mapping

from rfpp.checkpoint.loading import CheckpointInfo

_CARD = """\
---
license: mit
library_name: rfpp
tags: [rendering, global-illumination, renderformer]
---

# {method}

Renders global illumination of triangle meshes: {system}.

| | |
|---|---|
| Parameters | {parameters:.2f} million |
| Trained on | {dataset} (manifest {data_manifest}), {height} × {width} pixels |
| Steps, seed | {steps}, {seed} |
| Code | {commit} |

{metrics}
## Use

```python
from rfpp import Renderer, load_scene

images = Renderer.load("{folder}").render(load_scene("scene.json"))  # [views, height, width, 3], linear radiance
```

Trained for scenes in [-0.5, 0.5]³ lit by emissive triangles, diffuse and glossy surfaces, no
textures finer than a triangle, no transparency.
{notes}"""

#: Is it radiosity? → description.
_SYSTEMS = {
    True: "ray-cast radiosity with a learned refinement of the image",
    False: "a transformer, in one forward pass",
}


def model_card(
    info: CheckpointInfo,
    parameters: int,
    folder: str,
    metrics: Mapping[str, Mapping[str, float | str]],
    notes: str = "",
) -> str:
    """Return Markdown with the front matter that the Hugging Face hub reads.

    Args:
        metrics: Row → metric → number from an evaluation; may be empty.
    """
    height, width = info.resolution
    unknown = "unknown"
    return _CARD.format(
        method=info.method,
        system=_SYSTEMS[str(info.model.get("_target_")).startswith("rfpp.radiosity.")],
        parameters=parameters / 1e6,
        dataset=info.dataset,
        data_manifest=info.data_manifest[:12],
        height=height,
        width=width,
        steps=unknown if info.steps is None else info.steps,
        seed=info.seed,
        commit=info.commit or unknown,
        folder=folder,
        metrics=_table(metrics),
        notes=f"\n{notes.strip()}\n" if notes.strip() else "",
    )


def _table(metrics: Mapping[str, Mapping[str, float | str]]) -> str:
    if not metrics:
        return "Metrics: not evaluated.\n"
    names = list(dict.fromkeys(name for values in metrics.values() for name in values))
    rows = [
        f"| {row} | " + " | ".join(_cell(values.get(name, "")) for name in names) + " |"
        for row, values in metrics.items()
    ]
    return "\n".join([f"| Metrics | {' | '.join(names)} |", "|---" * (1 + len(names)) + "|", *rows, ""])


def _cell(number: float | str) -> str:
    return number if isinstance(number, str) else f"{number:.4g}"
