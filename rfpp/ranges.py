"""Ranges of numbers, as annotations that are checked for settings and for the content of files."""

from typing import Annotated

from pydantic import Field

NonNegative = Annotated[int, Field(ge=0)]
Positive = Annotated[int, Field(ge=1)]
NonNegativeFloat = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
PositiveFloat = Annotated[float, Field(gt=0)]
PartOfMany = Annotated[float, Field(gt=0, lt=1)]
