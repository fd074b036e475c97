"""Old `_target_` paths of renamed and moved classes, as stored in checkpoints."""

from __future__ import annotations

from typing import Any

#: `_target_` of then → of now.
_NOW = {
    "rfpp.model.exposure.ArrivingLight": "rfpp.model.exposure.MeanIrradianceExposure",
    "rfpp.model.film.CentreSample": "rfpp.model.pixel_filter.CentreSample",
    "rfpp.model.film.PixelFilter": "rfpp.model.pixel_filter.PixelFilter",
    "rfpp.model.source.CellLight": "rfpp.model.initial_light.CellLight",
    "rfpp.model.source.EmittedLight": "rfpp.model.initial_light.EmittedLight",
    "rfpp.model.source.FirstBounce": "rfpp.model.initial_light.FirstBounce",
}


def with_current_names(config: Any) -> Any:
    """A nested `_target_` config whose parts are called what they are called now; all else as it is."""
    if isinstance(config, list | tuple):
        return [with_current_names(item) for item in config]
    if not isinstance(config, dict):
        return config
    renamed = {key: with_current_names(value) for key, value in config.items()}
    target = renamed.get("_target_")
    return renamed | {"_target_": _NOW.get(target, target)} if isinstance(target, str) else renamed
