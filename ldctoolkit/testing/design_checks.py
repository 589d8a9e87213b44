"""The part of the contract that a design keeps before it has met a plant."""

from __future__ import annotations

import copy
import dataclasses
import json
import math
import pickle
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ldctoolkit.control import Controller, check_class
from ldctoolkit.errors import InputError
from ldctoolkit.gains import Gain, GainValue, undeclared_fields
from ldctoolkit.testing.subject import Subject

_LOAD = """
import pickle, sys
sys.path[:] = pickle.load(sys.stdin.buffer)
sys.stdout.buffer.write(pickle.dumps(pickle.loads(pickle.load(sys.stdin.buffer))))
"""


def declared(subject: Subject) -> Iterator[str]:
    """The class is made as `Controller` asks for, and everything that it takes is declared and described."""
    kind = type(subject.design)
    check_class(kind)
    for name in undeclared_fields(kind):
        yield f"{kind.__name__}.{name} is a plain field; allowed: gain(...), option(...), or field(init=False)"
    for one in kind.gains():
        for attribute in ("unit", "description"):
            if not getattr(one, attribute):
                yield f"{kind.__name__}.{one.name}: its {attribute} is empty; allowed: some words"


def frozen(subject: Subject) -> Iterator[str]:
    """A design cannot be changed, equals its copy, and can be a key."""
    design = subject.design
    for one in design.gains():
        try:
            setattr(design, one.name, getattr(design, one.name))
        except dataclasses.FrozenInstanceError:
            continue
        yield f"{one.name} can be set on a finished design; allowed: a frozen dataclass"
    again = _rebuilt(design, {one.name: getattr(design, one.name) for one in design.gains()})
    if again != design or copy.deepcopy(design) != design:
        yield "a design made from the same values does not equal it; allowed: the comparison of a dataclass"
    elif hash(again) != hash(design):
        yield "two equal designs have different hashes; allowed: the hash of a frozen dataclass"


def picklable(subject: Subject) -> Iterator[str]:
    """A design reaches a worker process, also one that is started afresh."""
    design = subject.design
    try:
        sent = pickle.dumps(design)
    except Exception as error:  # whatever a class of its own raises
        yield f"cannot be pickled: {type(error).__name__}: {error}; allowed: a class at the top of a module"
        return
    if pickle.loads(sent) != design:
        yield "comes back from pickle as another design"
    given = pickle.dumps([word or str(Path.cwd()) for word in sys.path]) + pickle.dumps(sent)
    done = subprocess.run([sys.executable, "-c", _LOAD], input=given, capture_output=True, check=False)
    if done.returncode:
        last = (done.stderr.decode(errors="replace").strip().splitlines() or ["no message"])[-1]
        yield f"cannot be loaded in a fresh process: {last}; allowed: a class in a module that can be imported"
    elif pickle.loads(done.stdout) != design:
        yield "comes back from a fresh process as another design"


def bounds(subject: Subject) -> Iterator[str]:
    """Values outside the declaration are refused."""
    for one in subject.design.gains():
        for value in _outside(one):
            try:
                _rebuilt(subject.design, {one.name: value})
            except InputError:
                continue
            yield f"{one.name} = {value!r} is taken; allowed: an InputError, as __post_init__ of Controller raises it"


def toml(subject: Subject) -> Iterator[str]:
    """The gains, written as a study file and read again, make the same design."""
    design = subject.design
    values = {one.name: getattr(design, one.name) for one in design.gains()}
    text = "\n".join(["[design.gains]", *(f"{name} = {_word(value)}" for name, value in values.items())])
    try:
        read: dict[str, Any] = tomllib.loads(text)["design"]["gains"]
    except tomllib.TOMLDecodeError as error:
        yield f"its gains are no TOML: {error}"
        return
    again = _rebuilt(design, read)
    for name, value in values.items():
        back = getattr(again, name)
        if back != value or type(back) is not type(value):
            yield f"{name} = {value!r} comes back from TOML as {back!r}"
    if again != design:
        yield "comes back from TOML as another design"


def _rebuilt(design: Controller, values: dict[str, Any]) -> Controller:
    own = {one.name: getattr(design, one.name) for one in design.gains()}
    return type(design)(**(own | values))


def _outside(one: Gain) -> Iterator[Any]:
    if one.choices:
        yield "".join(one.choices) + "x"
    elif one.text or isinstance(one.default, bool):
        yield 0.5
    else:
        yield math.nan
        yield from (value for value in (one.lower - 1.0, one.upper + 1.0) if math.isfinite(value))


def _word(value: GainValue) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)
