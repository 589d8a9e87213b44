"""The content of a designer's code as a hash: of a class, what it inherits and all that both refer to.

Loaded code is hashed, not its text: a class of a notebook has no file, a file may have been edited after its import,
and two classes of one text may have other closures. Comments and line numbers do not count. Of libraries the version
counts, of the toolkit nothing: its version stands beside every stored number.
"""

from __future__ import annotations

import dataclasses
import dis
import functools
import hashlib
import importlib
import importlib.util
import sys
import types
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from ldctoolkit.errors import InputError, raised

_INSTALLED: Final = frozenset({"site-packages", "dist-packages"})  # folders of libraries

_GENERATED: Final = frozenset(
    {"__init__", "__repr__", "__eq__", "__hash__", "__setattr__", "__delattr__", "__replace__"}
)

# Objects that may change while laws run, a cache for one, with their content when they were first met
_first_met: dict[int, tuple[object, bytes]] = {}
_under_way: set[int] = set()


def content_of(kind: object) -> str:
    """Sixteen hexadecimal digits of the content of a class or function; empty for what is the toolkit's."""
    return "" if _top(getattr(kind, "__module__", None)) == "ldctoolkit" else _hashed(kind)[0]


def modules_of(kind: object) -> set[str]:
    """Names of the designer's modules that a class and what it refers to come from."""
    return _hashed(kind)[1]


def _top(module: str | None) -> str:
    """The package that a module belongs to."""
    return (module or "").partition(".")[0]


def _hashed(kind: object) -> tuple[str, set[str]]:
    """Digest of a class or function with all it uses, and the modules that it uses."""
    visitor = _Visitor(_top(getattr(kind, "__module__", None)))
    visitor.add(kind)
    return visitor.digest.hexdigest()[:16], visitor.modules


class _Visitor:
    """Feeds a digest with an object and all that it refers to, each once."""

    def __init__(self, package: str) -> None:
        self.package = package  # the designer's, also where it is installed
        self.digest = hashlib.sha256()
        self.modules: set[str] = set()
        self._place: dict[tuple[Any, ...], int] = {}
        self._alive: list[object] = []  # so that no number of an object is used twice

    def put(self, *words: object) -> None:
        for word in words:
            data = word if isinstance(word, bytes) else str(word).encode(errors="surrogatepass")
            self.digest.update(b"%d:" % len(data) + data)

    def add(self, value: Any, names: Iterable[str] = ()) -> None:
        """Add one object to the digest; of a module only the attributes in `names`."""
        if value is None or isinstance(value, bool | int | float | complex | str | types.EllipsisType):
            self.put(type(value).__name__, repr(value))
        elif isinstance(value, bytes | bytearray):
            self.put("bytes", bytes(value))
        elif isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
            self.put("array", value.dtype.str, value.shape, value.tobytes())
        elif isinstance(value, tuple):
            self.put("tuple", len(value))
            for item in value:
                self.add(item)
        elif isinstance(value, frozenset):
            self.put("set", *sorted(self._apart(item) for item in value))
        else:
            # what counts of a module depends on the names
            key = (id(value), *names) if isinstance(value, types.ModuleType) else (id(value),)
            if key in self._place:
                self.put("again", self._place[key])
            else:
                self._place[key] = len(self._place)
                self._alive.append(value)
                self._object(value, names)

    def _object(self, value: Any, names: Iterable[str]) -> None:
        if isinstance(value, types.ModuleType):
            self._module(value, names)
        elif isinstance(value, types.CodeType):
            self.put("code", value.co_code, value.co_names, value.co_varnames, value.co_freevars, value.co_flags)
            self.put(getattr(value, "co_exceptiontable", b""))
            self.add(value.co_consts)
        elif isinstance(value, types.FunctionType):
            self._function(value)
        elif isinstance(value, type):
            self._class(value)
        elif isinstance(value, types.CellType):
            try:
                self.add(value.cell_contents)
            except ValueError:
                self.put("empty")
        elif isinstance(value, types.MethodType | staticmethod | classmethod):
            self.add((value.__func__, getattr(value, "__self__", None)))
        elif isinstance(value, property):
            self.add((value.fget, value.fset))
        elif isinstance(value, functools.partial):
            self.add((value.func, value.args))
            self._items(value.keywords)
        elif (inner := _inside(value)) is not None:  # a decorated function
            self.put(type(value).__qualname__)
            self.add(inner)
        elif isinstance(value, np.ufunc) or (_top(type(value).__module__) == "builtins" and hasattr(value, "__name__")):
            self.put(type(value).__qualname__, getattr(value, "__module__", ""), value.__name__)
        else:
            self.put(self._as_first_met(value))

    def _as_first_met(self, value: Any) -> bytes:
        if id(value) in _under_way:
            return b"cycle"
        if id(value) not in _first_met:
            _under_way.add(id(value))
            try:
                _first_met[id(value)] = (value, self._apart(value, _Visitor._state))
            finally:
                _under_way.discard(id(value))
        return _first_met[id(value)][1]

    def _apart(self, value: Any, add: Any = add) -> bytes:
        """The digest of an object by itself."""
        visitor = _Visitor(self.package)
        add(visitor, value)
        self.modules |= visitor.modules
        return visitor.digest.digest()

    def _state(self, value: Any) -> None:
        """Add the state of an object to the digest: its type and what it holds."""
        self.put("object")
        self.add(type(value))
        if isinstance(value, set):
            self.add(frozenset(value))
        elif isinstance(value, dataclasses.Field):
            self.add((value.name, value.default, value.default_factory))
            self._items(value.metadata)
        elif dataclasses.is_dataclass(value):
            self._items({field.name: getattr(value, field.name, None) for field in dataclasses.fields(value)})
        else:
            try:
                reduced = _expression(value) or value.__reduce_ex__(4)
            except Exception:  # an object that cannot be copied, as a lock
                reduced = "closed"
            if isinstance(reduced, str):
                self.put(reduced)
                return
            for part in reduced[1:]:
                if isinstance(part, dict):
                    self._items(part)
                elif part is not None:
                    self.add(tuple(part) if hasattr(part, "__next__") else part)

    def _items(self, items: Mapping[Any, Any]) -> None:
        self.put("items", len(items))
        for key, item in items.items():
            self.add((key, item))

    def _library(self, module: str) -> str | None:
        """Name and version of the library that a module belongs to; None for the designer's own."""
        top = _top(module)
        if top == "ldctoolkit" or top in sys.stdlib_module_names:
            return top
        loaded = sys.modules.get(top)
        spec = getattr(loaded, "__spec__", None) if loaded else importlib.util.find_spec(top) if top else None
        if top == self.package or spec is None:
            return None
        folders = [Path(folder) for folder in spec.submodule_search_locations or (spec.origin or "",)]
        installed = any(_INSTALLED.intersection(folder.parts) for folder in folders)
        return f"{top} {getattr(loaded, '__version__', '')}" if installed else None

    def _module(self, module: types.ModuleType, names: Iterable[str]) -> None:
        library = self._library(module.__name__)
        self.put("module", module.__name__ if library is None else library)
        if library is None:
            self.modules.add(module.__name__)
            for name in names:
                if name in vars(module):
                    self.put(name)
                    self.add(vars(module)[name], names)

    def _function(self, function: types.FunctionType) -> None:
        if (library := self._library(function.__module__ or "")) is not None:
            self.put("library", library, function.__qualname__)
            return
        self.modules.add(function.__module__ or "")
        self.put("function", function.__name__)
        self.add((function.__code__, function.__defaults__, function.__closure__))
        self._items(function.__kwdefaults__ or {})
        self._items(vars(function))
        names = sorted({name for code in _codes(function.__code__) for name in code.co_names})
        for name in names:
            if name in function.__globals__:
                self.put(name)
                self.add(function.__globals__[name], names)
        for name, level in sorted(_imports(function.__code__)):
            module = name
            try:
                if level:
                    package = function.__globals__.get("__package__") or ""
                    module = importlib.util.resolve_name("." * level + name, package)
                library = self._library(module)
                self.put(library) if library else self.add(importlib.import_module(module), names)
            except Exception:  # the law raises the same when it is run
                self.put("missing", module)

    def _class(self, kind: type) -> None:
        if (library := self._library(kind.__module__)) is not None:
            self.put("library", library, kind.__qualname__)
            return
        self.modules.add(kind.__module__)
        self.put("class", kind.__name__)
        for base in kind.__bases__:
            self.add(base)
        for name, value in sorted(vars(kind).items()):
            written = isinstance(value, types.FunctionType | staticmethod | classmethod)
            # what `dataclass` made follows from the fields, what a class statement made from the rest
            derived = name == "_abc_impl" or (name.startswith("__") and not written and name != "__dataclass_fields__")
            if not derived and (name not in _GENERATED or value.__code__.co_filename != "<string>"):
                self.put(name)
                self.add(value)


def _inside(value: Any) -> Any:
    """The function inside a cached property, a cached or a compiled function, or another decorator."""
    if _top(type(value).__module__) == "numba":
        return getattr(value, "py_func", None)
    return value.func if isinstance(value, functools.cached_property) else getattr(value, "__wrapped__", None)


def _expression(value: Any) -> str:
    """A symbolic expression of CasADi, which cannot be copied, as text; empty for anything else."""
    if _top(type(value).__module__) != "casadi" or type(value).__name__ not in ("MX", "SX"):
        return ""
    import casadi

    return str(casadi.Function("f", casadi.symvar(value), [value]).serialize())


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """The code of a function and of the functions inside it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _codes(constant)


def _imports(code: types.CodeType) -> set[tuple[str, int]]:
    """Names and levels of the imports inside a function."""
    imports: set[tuple[str, int]] = set()
    for inner in _codes(code):
        before: list[Any] = [0, 0]
        for step in dis.get_instructions(inner):
            if step.opname == "IMPORT_NAME":
                imports.add((str(step.argval), before[0]))
            before = [before[1], step.argval]
    return imports


def pickled_by_value(content: object, modules: Iterable[str]) -> bytes:
    """An object as bytes, with its classes of some modules by value."""
    import cloudpickle

    known = {*cloudpickle.list_registry_pickle_by_value()}
    by_value = [sys.modules[name] for name in sorted(modules) if name in sys.modules and name not in known]
    for module in by_value:
        cloudpickle.register_pickle_by_value(module)
    try:
        return bytes(cloudpickle.dumps(content))
    finally:
        for module in by_value:
            cloudpickle.unregister_pickle_by_value(module)


def _loaded(path: Path, text: str) -> types.ModuleType:
    """The module of a file with this text, run anew: what it reads may have changed."""
    name = f"{path.stem}_{hashlib.sha256(f'{path}{text}'.encode()).hexdigest()[:8]}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    sys.path.insert(0, str(path.parent))  # it may import its neighbours
    try:
        exec(compile(text, str(path), "exec"), vars(module))
    except BaseException:
        del sys.modules[name]
        raise
    finally:
        sys.path.remove(str(path.parent))
    return module


def from_file(path: str, name: str, folder: Path, allowed: str) -> Any:
    """What a designer's file defines, by ``my_file.py:Name``; the file is relative to a folder.

    Raises `InputError` at `path` for a name of another form, a file that is not there or raises, and a name that it
    does not have.
    """
    file, colon, attribute = name.rpartition(":")
    if not (colon and file.endswith(".py") and attribute.isidentifier()):
        raise InputError(path, value=name, allowed=allowed)
    target = (folder / file).resolve()
    try:
        module = _loaded(target, target.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError):
        raise InputError(path, "the file cannot be read", value=name, allowed=allowed) from None
    except Exception as error:  # whatever a designer's code raises
        raise InputError(path, raised(error), value=name, allowed=allowed) from error
    if not hasattr(module, attribute):
        names = [key for key, value in vars(module).items()
                 if getattr(getattr(value, "function", value), "__module__", "") == module.__name__]  # fmt: skip
        raise InputError(path, f"{file} has no {attribute}", value=name, allowed=names)
    return getattr(module, attribute)
