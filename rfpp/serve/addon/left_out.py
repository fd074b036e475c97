"""What of a scene cannot be represented, for Blender's report."""

from __future__ import annotations

_NAMES = 4


class LeftOut:
    """Collects it: a kind of thing, and which ones."""

    def __init__(self) -> None:
        self._names: dict[str, dict[str, None]] = {}

    def add(self, what: str, name: str = "") -> None:
        """For example "hair", "Suzanne"."""
        self._names.setdefault(what, {})[name] = None

    def lines(self) -> list[str]:
        """One for each kind."""
        return [f"{what}{_listed(list(filter(None, names)))}" for what, names in self._names.items()]


def _listed(names: list[str]) -> str:
    if not names:
        return ""
    more = f" and {len(names) - _NAMES} more" if len(names) > _NAMES else ""
    return f": {', '.join(names[:_NAMES])}{more}"
