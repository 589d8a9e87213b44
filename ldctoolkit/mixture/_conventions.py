"""Scikit-learn's conventions for an estimator's parameters, without depending on it."""

from __future__ import annotations

import inspect
from typing import Any, Self

from ldctoolkit.errors import InputError, nearest


class Parameters:
    """Constructor arguments that are kept as attributes of the same name."""

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """The constructor's arguments (scikit-learn's convention)."""
        del deep
        return {
            name: getattr(self, name) for name in inspect.signature(type(self).__init__).parameters if name != "self"
        }

    def set_params(self, **params: Any) -> Self:
        """Change constructor arguments (scikit-learn's convention)."""
        known = self.get_params()
        for name, value in params.items():
            if name not in known:
                raise InputError(f"{type(self).__name__}: no parameter {name!r}; {nearest(name, known)}")
            setattr(self, name, value)
        return self

    def __repr__(self) -> str:
        default = {k: v.default for k, v in inspect.signature(type(self).__init__).parameters.items()}
        shown = ", ".join(f"{k}={v!r}" for k, v in self.get_params().items() if v is not default[k])
        return f"{type(self).__name__}({shown})"
