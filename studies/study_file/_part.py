"""What the parts of a study file share."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict
from pydantic_core import PydanticCustomError


class Part(BaseModel):
    """A table of a study file: no unknown keys, no silent conversions, finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def fail(path: str, message: str) -> PydanticCustomError:
    """What a validator raises: the key path below the validated value, and what is wrong."""
    return PydanticCustomError("study", "{message}", {"path": path, "message": message})
