"""Entries of glTF's JSON, whose values are checked when they are read."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import AfterValidator, Field, TypeAdapter, ValidationError

from rfpp.errors import SceneError
from rfpp.scene.io.limits import MAX_ENTRIES
from rfpp.scene.spec import first_problem

_Number = Annotated[float, Field(allow_inf_nan=False)]
_Index = Annotated[int, Field(ge=0, lt=2**53)]
# exporters round 1 up to a next float32
_Share = Annotated[float, Field(ge=0, le=1 + 1e-6), AfterValidator(lambda share: min(share, 1.0))]
_Positive = Annotated[float, Field(ge=0, allow_inf_nan=False)]

TEXT, FLAG, NUMBER = TypeAdapter(str), TypeAdapter(bool), TypeAdapter(_Number)
INDEX, INDICES = TypeAdapter(_Index), TypeAdapter(list[_Index])
SHARE, POSITIVE = TypeAdapter(_Share), TypeAdapter(_Positive)
RGB, RGBA = TypeAdapter(tuple[(_Positive,) * 3]), TypeAdapter(tuple[(_Share,) * 4])
PAIR, VECTOR, QUATERNION, MATRIX = (TypeAdapter(tuple[(_Number,) * width]) for width in (2, 3, 4, 16))
CONE = TypeAdapter(Annotated[float, Field(ge=0, le=math.pi / 2 + 1e-6)])
YFOV = TypeAdapter(Annotated[float, Field(gt=0, lt=3.14159)])


class Entry:
    """A JSON object; `where` is its place in the file. Every method raises SceneError naming the first bad value."""

    def __init__(self, values: Any, where: str = "") -> None:
        if not isinstance(values, dict):
            raise SceneError(f"{where}: a JSON object was expected: export it again")
        self.values, self.where = values, where

    def __contains__(self, key: str) -> bool:
        return self.values.get(key) is not None

    def get(self, key: str, kind: TypeAdapter, default: Any = None) -> Any:
        """Return a value, or `default` if it is missing."""
        value = self.values.get(key, default)
        if value is default:
            return default
        try:
            return kind.validate_python(value)
        except ValidationError as error:
            raise SceneError(f"{first_problem(error, self._place(key))}: export it again") from None

    def entry(self, *keys: str) -> Entry:
        """Return a nested object, empty if it is missing."""
        entry = self
        for key in keys:
            entry = Entry(entry.values.get(key, {}), entry._place(key))
        return entry

    def items(self, key: str) -> list[Any]:
        """Return a list, empty if it is missing."""
        items = self.values.get(key, [])
        if not isinstance(items, list) or len(items) > MAX_ENTRIES:
            raise SceneError(f"{self._place(key)}: a list of at most {MAX_ENTRIES:,} was expected: export it again")
        return items

    def at(self, key: str, index: int) -> Entry:
        """Return an object in a list."""
        items, where = self.items(key), f"{self._place(key)}.{index}"
        if index >= len(items):
            raise SceneError(f"{where} is referred to and does not exist: export it again")
        return Entry(items[index], where)

    def _place(self, key: str) -> str:
        return f"{self.where}.{key}".removeprefix(".")
