"""Parameters: a tree of physical values that carries unit, bounds, scale and source of each.

A group is a frozen dataclass made with `@parameters`. Its `leaf` fields are numbers (or arrays over lanes)
and are what JAX sees and gradients reach; its `setting` fields are fixed choices, part of the tree's
structure, so that another choice compiles another program. Groups nest, and every leaf or setting is named
by its dotted path, `stance.shoe.threshold`.

What a leaf is good for is said where it is made, once: its `meaning`, whether tuning and sweeps vary it by
themselves (`tune`), whether it is an operating `point` of its detector, and under which settings it has an
effect at all (`when`). `active` and `tunable` read that, for any tree.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any, Literal, TypeVar, dataclass_transform

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from pedjax.errors import InputError, suggest

P = TypeVar("P")

Moves = Literal["threshold", "root", "search"]
"""How an operating point goes with the threshold of its detector's statistic, see `Spec`."""


@dataclasses.dataclass(frozen=True)
class Spec:
    """What is known of a leaf: `unit`, bounds `low` to `high`, `scale` it is searched on, `source`, and its
    `meaning` in a sentence. `tune`: worth varying by default; `point`: what a detector's statistic is held
    against, which `moves` along its ROC: as the `threshold` does, several in proportion; as its square
    `root`; or so far that as many windows pass (`search`; more must pass the larger it is)."""

    unit: str
    low: float
    high: float
    scale: Literal["log", "linear"]
    source: str
    meaning: str = ""
    tune: bool = False
    point: bool = False
    moves: Moves = "threshold"

    def to_free(self, value: ArrayLike) -> Array:
        """The unconstrained number of a value; a step of 1 is about one e-fold, or a tenth of the range."""
        fraction = (self._forward(value) - self._start) / self._range
        fraction = jnp.clip(fraction, 1e-4, 1 - 1e-4)
        return (jnp.log(fraction) - jnp.log1p(-fraction)) / self._gain

    def from_free(self, free: ArrayLike) -> Array:
        """The value of an unconstrained number, always inside the bounds."""
        inner = self._start + self._range * jax.nn.sigmoid(self._gain * jnp.asarray(free))
        return jnp.exp(inner) if self.scale == "log" else inner

    def _forward(self, value: ArrayLike) -> Array:
        return jnp.log(jnp.asarray(value)) if self.scale == "log" else jnp.asarray(value)

    @property
    def _start(self) -> float:
        return float(np.log(self.low)) if self.scale == "log" else self.low

    @property
    def _range(self) -> float:
        return (float(np.log(self.high)) if self.scale == "log" else self.high) - self._start

    @property
    def _gain(self) -> float:
        return 4.0 / self._range if self.scale == "log" else 0.4


@dataclasses.dataclass(frozen=True)
class Choice:
    """What is known of a setting: the allowed `choices` (empty: any value of its type), its `source` and its
    `meaning` in a sentence."""

    choices: tuple[Any, ...]
    source: str
    meaning: str = ""


When = Mapping[str, Any]
"""Settings under which something has an effect: name to the value, or the values, that it needs. A name is
looked for in the group itself, then in those around it."""


def leaf(
    value: float,
    *,
    unit: str,
    low: float,
    high: float,
    scale: Literal["log", "linear"] = "log",
    source: str,
    meaning: str = "",
    tune: bool = False,
    point: bool = False,
    moves: Moves = "threshold",
    when: When | None = None,
) -> Any:
    """A number that can be tuned. `meaning` says in a sentence what it is and what raising it does."""
    if not low <= value <= high or (scale == "log" and low <= 0):
        raise ValueError(f"default {value} or bounds {low} to {high} do not fit a {scale} scale")
    spec = Spec(unit, low, high, scale, source, meaning, tune, point, moves)
    return dataclasses.field(default=value, metadata={"spec": spec, "when": when or {}})


def setting(value: Any, *, choices: tuple[Any, ...] = (), source: str = "", meaning: str = "") -> Any:
    """A fixed choice (a name, a switch, a window length): changing it compiles another program."""
    return dataclasses.field(default=value, metadata={"choice": Choice(choices, source, meaning)})


def group(cls: type[P], *, when: When | None = None) -> P:
    """A nested group with its own defaults."""
    return dataclasses.field(default_factory=cls, metadata={"group": True, "when": when or {}})


@dataclass_transform(frozen_default=True, kw_only_default=True)
def parameters(cls: type[P]) -> type[P]:
    """Make a class of `leaf`, `setting` and `group` fields a frozen dataclass that JAX treats as a tree."""
    made = dataclasses.dataclass(frozen=True)(cls)
    fields = dataclasses.fields(made)  # type: ignore[arg-type]
    data = [f.name for f in fields if "choice" not in f.metadata]
    meta = [f.name for f in fields if "choice" in f.metadata]
    return jax.tree_util.register_dataclass(made, data, meta)


def grown(base: type[P], groups: Mapping[str, type], name: str, about: str = "") -> type[P]:
    """A class of parameters with the fields of `base` and further groups behind them."""
    return _extended(base, {key: (cls, group(cls)) for key, cls in groups.items()}, name, about)


def _extended(base: type[P], new: Mapping[str, tuple[type, Any]], name: str, about: str | None) -> type[P]:
    """A class with further fields, name to type and what `leaf`, `setting` or `group` gave."""
    annotations = {key: kind for key, (kind, _) in new.items()}
    own = {key: made for key, (_, made) in new.items()}
    return parameters(type(name, (base,), {"__annotations__": annotations, "__doc__": about, **own}))


def redefined(cls: type[P], values: Mapping[str, tuple[Any, str]]) -> type[P]:
    """The class with other defaults: dotted path to value and source. A path that it has not is an
    `InputError`."""
    new: dict[str, tuple[type, Any]] = {}
    below: dict[str, dict[str, tuple[Any, str]]] = {}
    for path, (value, source) in values.items():
        name, _, rest = path.partition(".")
        field = cls.__dataclass_fields__.get(name)  # type: ignore[attr-defined]
        if field is None or ("group" in field.metadata) != bool(rest):
            raise InputError(f"{cls.__name__} has no '{path}' to give another default")
        if rest:
            below.setdefault(name, {})[rest] = (value, source)
            continue
        about = dict(field.metadata)
        key = "spec" if "spec" in about else "choice"
        about[key] = dataclasses.replace(about[key], source=source)
        if key == "spec" and not about[key].low <= value <= about[key].high:
            raise ValueError(f"default {value} of '{path}' is not within its bounds")
        new[name] = (field.type, dataclasses.field(default=value, metadata=about))
    for name, own in below.items():
        field = cls.__dataclass_fields__[name]  # type: ignore[attr-defined]
        kind = redefined(field.default_factory, own)
        new[name] = (kind, group(kind, when=field.metadata["when"]))
    return _extended(cls, new, cls.__name__, cls.__doc__)


_OFFERED: dict[type, type] = {}  # a class of parameters to its latest extension


def offer(cls: type[P], name: str, own: type, setting_name: str = "detector") -> None:
    """Add a choice to a class whose setting chooses among groups: the group `own` under that name. Trees made
    from now on have it; the same name once more replaces it."""
    base = latest(cls)
    chooser = base.__dataclass_fields__[setting_name]  # type: ignore[attr-defined]
    known: Choice = chooser.metadata["choice"]
    choices_ = tuple(dict.fromkeys([*known.choices, name]))
    chosen = setting(chooser.default, choices=choices_, source=known.source, meaning=known.meaning)
    new = {setting_name: (str, chosen), name: (own, group(own, when={setting_name: name}))}
    _OFFERED[cls] = _extended(base, new, cls.__name__, cls.__doc__)


def latest(cls: type) -> type:
    """The class with all choices that were added to it."""
    return _OFFERED.get(cls, cls)


def _walk(tree: Any, prefix: str = "") -> Iterator[tuple[str, Any, Spec | Choice]]:
    for f in dataclasses.fields(tree):
        value, path = getattr(tree, f.name), prefix + f.name
        if "group" in f.metadata:
            yield from _walk(value, path + ".")
        else:
            yield path, value, f.metadata.get("spec") or f.metadata["choice"]


def specs(tree: Any) -> dict[str, Spec]:
    """Dotted path to `Spec` of every leaf."""
    return {path: about for path, _, about in _walk(tree) if isinstance(about, Spec)}


def choices(tree: Any) -> dict[str, Choice]:
    """Dotted path to `Choice` of every setting."""
    return {path: about for path, _, about in _walk(tree) if isinstance(about, Choice)}


def active(tree: Any) -> frozenset[str]:
    """Paths of the leaves that have an effect under the tree's settings."""
    return frozenset(path for path in specs(tree) if not idle_because(tree, path))


def _holds(when: When, scopes: tuple[Any, ...]) -> bool:
    for name, wanted in when.items():
        holder = next(scope for scope in scopes if hasattr(scope, name))
        if getattr(holder, name) not in (wanted if isinstance(wanted, tuple) else (wanted,)):
            return False
    return True


def idle_because(tree: Any, path: str) -> str:
    """Why a leaf has no effect, as `stance.detector is 'ared'`; empty where it has one."""
    node, prefix = tree, ""
    scopes: tuple[Any, ...] = (tree,)
    prefixes: tuple[str, ...] = ("",)
    for key in path.split("."):
        f = next(f for f in dataclasses.fields(node) if f.name == key)
        for name in f.metadata.get("when", {}):
            if not _holds({name: f.metadata["when"][name]}, scopes):
                k = next(i for i, scope in enumerate(scopes) if hasattr(scope, name))
                return f"{prefixes[k]}{name} is {getattr(scopes[k], name)!r}"
        node, prefix = getattr(node, key), f"{prefix}{key}."
        scopes, prefixes = (node, *scopes), (prefix, *prefixes)
    return ""


def tunable(tree: Any) -> tuple[str, ...]:
    """Paths that tuning and sweeps vary unless told otherwise: those made with `tune` that have an effect."""
    found = active(tree)
    return tuple(path for path, spec in specs(tree).items() if spec.tune and path in found)


def groups_of(tree: Any, kind: type, prefix: str = "") -> dict[str, Any]:
    """Dotted path to group of every group of that type, whatever its name."""
    found = {prefix: tree} if isinstance(tree, kind) else {}
    for f in dataclasses.fields(tree):
        if "group" in f.metadata:
            path = f"{prefix}.{f.name}" if prefix else f.name
            found |= groups_of(getattr(tree, f.name), kind, path)
    return found


def values(tree: Any) -> dict[str, Any]:
    """Dotted path to value of every leaf and setting."""
    return {path: value for path, value, _ in _walk(tree)}


def get(tree: Any, path: str) -> Any:
    """The value at a dotted path; an unknown one is an `InputError` with a suggestion."""
    known = values(tree)
    if path not in known:
        raise InputError(f"parameter '{path}' is unknown{suggest(path, known)}")
    return known[path]


def with_leaves(tree: P, new: Mapping[str, Any]) -> P:
    """The tree with the leaves at those paths replaced, unchecked: for use under `jit` and with lanes."""

    def rebuild(node: Any, prefix: str) -> Any:
        changes = {}
        for f in dataclasses.fields(node):
            path = prefix + f.name
            if path in new:
                changes[f.name] = new[path]
            elif "group" in f.metadata and any(p.startswith(path + ".") for p in new):
                changes[f.name] = rebuild(getattr(node, f.name), path + ".")
        return dataclasses.replace(node, **changes)

    return rebuild(tree, "")


def replace(tree: P, new: Mapping[str, Any], origin: str = "parameters") -> P:
    """The tree with the values at those paths replaced, checked against bounds, choices and types.

    `origin` names the source of the values (a file, an option) in the error.
    """
    known = {path: (value, about) for path, value, about in _walk(tree)}
    checked = {}
    for path, value in new.items():
        if path not in known:
            raise InputError(f"{origin}: parameter '{path}' is unknown{suggest(path, known)}")
        old, about = known[path]
        if isinstance(about, Spec):
            checked[path] = _checked_leaf(path, value, about, origin)
        else:
            checked[path] = _checked_setting(path, value, old, about, origin)
    return with_leaves(tree, checked)


def within(tree: Any, new: Mapping[str, float]) -> dict[str, float]:
    """The values moved to the nearest bound of their paths where they lie outside."""
    known = specs(tree)
    return {path: float(np.clip(value, known[path].low, known[path].high)) for path, value in new.items()}


def _checked_leaf(path: str, value: Any, spec: Spec, origin: str) -> float:
    if isinstance(value, bool | str) or not np.isscalar(value):
        raise InputError(f"{origin}: {path} = {value!r} is not a number; its unit is {spec.unit}")
    number = float(value)  # type: ignore[arg-type]
    slack = 1e-9 * max(abs(spec.low), abs(spec.high)) if spec.scale == "linear" else 0.0
    if not spec.low * (1 - 1e-9) - slack <= number <= spec.high * (1 + 1e-9) + slack:
        raise InputError(
            f"{origin}: {path} = {number:g} {spec.unit} is outside its bounds, {spec.low:g} to {spec.high:g}"
        )
    return number


def _checked_setting(path: str, value: Any, old: Any, about: Choice, origin: str) -> Any:
    if about.choices and value not in about.choices:
        known = [str(c) for c in about.choices]
        raise InputError(f"{origin}: {path} = {value!r} is not a choice{suggest(str(value), known)}")
    if isinstance(old, bool) != isinstance(value, bool):
        raise InputError(f"{origin}: {path} = {value!r} must be of the same kind as its default, {old!r}")
    if isinstance(old, float) and isinstance(value, int | float):
        if not np.isfinite(value) or value < 0:
            raise InputError(f"{origin}: {path} = {value!r} must be a number that is not negative")
        return float(value)
    if not isinstance(value, type(old)):
        raise InputError(f"{origin}: {path} = {value!r} must be of the same kind as its default, {old!r}")
    return value


def cast(tree: P, dtype: Any) -> P:
    """Every leaf as an array of that dtype."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype), tree)


def to_nested(tree: Any) -> dict[str, Any]:
    """Plain nested dictionaries of floats and settings, ready for TOML or JSON."""
    nested: dict[str, Any] = {}
    for path, value, about in _walk(tree):
        *groups, name = path.split(".")
        node = nested
        for key in groups:
            node = node.setdefault(key, {})
        node[name] = float(value) if isinstance(about, Spec) else value
    return nested


def flatten(nested: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Dotted paths of nested dictionaries, as they come from TOML."""
    flat: dict[str, Any] = {}
    for key, value in nested.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{key}.")
        else:
            flat[prefix + key] = value
    return flat


def _told(allowed: tuple[Any, ...]) -> str:
    """Choices in a line; whole numbers without a gap by the first and the last."""
    if len(allowed) > 2 and all(isinstance(c, int) and c == allowed[0] + k for k, c in enumerate(allowed)):
        return f"{allowed[0]} to {allowed[-1]}"
    return " | ".join(str(c) for c in allowed)


def table(tree: Any) -> str:
    """Two lines for each leaf and setting: path, value, unit, bounds, source, and what it means. A leaf that
    has no effect under these settings says why."""
    rows, meanings = [], []
    for path, value, about in _walk(tree):
        if isinstance(about, Spec):
            bounds = f"{about.low:g} to {about.high:g}, {about.scale}"
            rows.append((path, f"{float(value):.6g}", about.unit, bounds, about.source))
            idle = idle_because(tree, path)
            meanings.append(about.meaning + (f" [no effect: {idle}]" if idle else ""))
        else:
            allowed = _told(about.choices)
            rows.append((path, str(value), "setting", allowed, about.source))
            meanings.append(about.meaning)
    widths = [max(len(row[i]) for row in rows) for i in range(4)]
    lines = []
    for row, meaning in zip(rows, meanings, strict=True):
        cells = (c.ljust(w) for c, w in zip(row, widths, strict=False))
        lines.append("  ".join([*cells, row[4]]))
        lines += [f"    {meaning.strip()}"] if meaning.strip() else []
    return "\n".join(lines)
