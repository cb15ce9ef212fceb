"""Reads TOML files into structs. Errors name the key, its value and what is allowed.

This module knows no particular configuration: names, limits and tags are read from the structs.
"""

from __future__ import annotations

import difflib
import enum
import math
import re
import tomllib
import types
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Meta

from companion.errors import ConfigError

SECRET: Final = {"secret": True}
"""Use as `extra` of a key's Meta, so that no error text repeats the key's value."""

MOST_BYTES: Final = 4_000_000
"""Largest file that is read: far more than a trajectory or fence needs. A larger one is no such file."""

_LONG_KEY: Final = re.compile(
    r"""(?:^|[\[{,])[ \t]*(?:(?:[\w-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')[ \t]*\.[ \t]*){16}""", re.MULTILINE
)
"""A key of more than 16 parts, which no configuration has. The time to read one grows with the square of its
length: one of 20,000 parts takes half a minute on a small computer."""

T = TypeVar("T")


def decode_toml(path: Path, kind: type[T]) -> T:
    """Read a TOML file into a struct.

    Raises:
        ConfigError: names the file, the key, its value and what is allowed.
    """
    text = _text_of(path)
    if _LONG_KEY.search(text):
        raise ConfigError(f"{path}: a key has more than 16 parts")
    try:
        raw = tomllib.loads(text)
        _refuse_unusable(raw, str(path), "")
    except RecursionError as error:
        raise ConfigError(f"{path}: not valid TOML: nested too deeply") from error
    except ValueError as error:  # also of a number with more digits than Python converts
        raise ConfigError(f"{path}: not valid TOML: {error}") from error
    try:
        return msgspec.convert(raw, kind)
    except msgspec.ValidationError as error:
        try:
            words = _explain(str(error), raw, kind)
        except (LookupError, TypeError):  # the user's own key contains the signs that separate keys
            words = str(error)
        raise ConfigError(f"{path}: {words}") from error


def _text_of(path: Path) -> str:
    """Text of a file of at most `MOST_BYTES`.

    Raises:
        ConfigError: it cannot be read, is larger, or is not UTF-8.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    if len(data) > MOST_BYTES:
        raise ConfigError(f"{path}: more than {MOST_BYTES:,} bytes")
    try:
        # Editors on Windows begin a file with a byte order mark, and end lines with two characters.
        return data.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from error


def _refuse_unusable(value: object, name: str, key: str) -> None:
    """Refuse numbers that are not finite, and texts that no file name or address can contain."""
    if isinstance(value, dict):
        for k, v in value.items():
            _refuse_unusable(v, name, f"{key}.{k}" if key else k)
    elif isinstance(value, list):
        for i, v in enumerate(value):
            _refuse_unusable(v, name, f"{key}[{i}]")
    elif isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{name}: {key}: {value} is not a finite number")
    elif isinstance(value, str) and "\0" in value:
        raise ConfigError(f"{name}: {key}: contains the character NUL, which is not allowed")


def _explain(text: str, raw: object, kind: type) -> str:
    """Turn msgspec's message ("Expected `float` <= 50.0 - at `$.limits.max_speed_mps`") into ours."""
    what, _, where = text.partition(" - at `$")
    key = where.rstrip("`").lstrip(".")
    if what.startswith("Number"):
        return f"{key}: {what[0].lower()}{what[1:]}"
    if not what.startswith(("Expected", "Object", "Invalid")):
        # The message of a struct's own check of its keys' combination. It begins with the key's name.
        return f"{key}.{what}" if key else what
    if "unknown field" in what:
        field = what.split("`")[1]
        full = f"{key}.{field}" if key else field
        names = [f.name for f in msgspec.structs.fields(_structs_at(kind, key, raw)[0])]
        near = difflib.get_close_matches(field, names, n=1)
        if not near:  # perhaps a key of another section
            near = difflib.get_close_matches(field, keys := _keys_of_sections(kind), n=1, cutoff=0.85)
            near = [keys[n] for n in near]
        meant = "".join(f"did you mean {n}? " for n in near)
        return f"{full}: unknown key; {meant}allowed here: {', '.join(names) or 'no other key'}"
    if "missing required field" in what:
        field = what.split("`")[1]
        return f"{key}.{field}: missing" if key else f"{field}: missing"
    value = raw
    for part in re.findall(r"[^.\[\]]+", key):
        value = value[int(part)] if isinstance(value, list) else value[part]  # type: ignore[index]
    section, _, field = key.rpartition(".")
    tagged = [c.__struct_config__ for c in _structs_at(kind, section, raw)]
    if field in {c.tag_field for c in tagged}:
        return f"{key}: {value!r}: allowed: {_listed([c.tag for c in tagged])}"
    hint = _hint_at(kind, key, raw)
    if "Expected `array`" in what and _structs(hint):
        return f"{key}: one table for each {key} is needed: write [[{key}]]"
    if key.endswith("[...]"):
        return f"{key.removesuffix('[...]')}: every value in it must be {_wanted(hint)}"
    held = "" if _is_secret(hint) else f" {value!r}:"
    if what.startswith("Invalid enum value"):
        return f"{key}:{held} allowed: {_listed(_choices(hint))}"
    return f"{key}:{held} expected {_wanted(hint)}"


def _wanted(hint: object, bounds: Meta | None = None) -> str:
    """Values that a key accepts, in words."""
    if get_origin(hint) is Annotated:
        inner, *metas = get_args(hint)
        return _wanted(inner, metas[0])
    if get_origin(hint) in (types.UnionType, Union):
        return " or ".join(dict.fromkeys(_wanted(a) for a in get_args(hint) if a is not types.NoneType))
    choices = _choices(hint)
    if get_origin(hint) in (tuple, list):
        return f'a list such as ["{choices[0]}"]' if choices else "a list"
    if choices:
        return f"one of {_listed(choices)}"
    if hint is str:
        length = _range(bounds.min_length, bounds.max_length) if bounds else ""
        return f"text of {length} characters" if length else "text"
    if hint is int or hint is float:
        above = f"more than {bounds.gt:g}" if bounds and bounds.gt is not None else ""
        limits = " and ".join(filter(None, (above, _range(bounds.ge, bounds.le) if bounds else "")))
        return ("a whole number" if hint is int else "a number") + (f", {limits}" if limits else "")
    return "true or false" if hint is bool else "a table"


def _range(low: float | None, high: float | None) -> str:
    if low is not None and high is not None:
        return f"{low:g} to {high:g}"
    if low is not None:
        return f"at least {low:g}"
    return "" if high is None else f"at most {high:g}"


def _listed(values: list[object]) -> str:
    return ", ".join(repr(v) for v in values)


def _choices(hint: object) -> list[object]:
    """Values of an enumeration or of literals, at any depth of a type."""
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return [member.value for member in hint]
    if get_origin(hint) is Literal:
        return list(get_args(hint))
    return [choice for inner in get_args(hint) for choice in _choices(inner)]


def _hint_at(kind: type, key: str, raw: object) -> Any:
    """Type of the value at `key`, or of the elements in it if `key` ends in "[...]"."""
    name = re.sub(r"(\[[^]]*\])+$", "", key)
    section, _, field = name.rpartition(".")
    hint = get_type_hints(_structs_at(kind, section, raw)[0], include_extras=True)[field]
    for inside in re.findall(r"\[([^]]*)\]", key[len(name) :]):
        while get_origin(hint) is Annotated:
            hint = get_args(hint)[0]
        hint = get_args(hint)[1 if inside == "..." else 0]
    return hint


def _structs_at(kind: type, key: str, raw: object) -> list[type[msgspec.Struct]]:
    """Structs that may describe the section at `key`; those whose tag is in `raw` come first."""
    value, found = raw, [kind]
    for part in re.findall(r"[^.\[\]]+", key):
        if not part.isdigit():
            found = list(_structs(get_type_hints(found[0])[part]))
        value = value[int(part)] if isinstance(value, list) else value[part]  # type: ignore[index]
        found = [c for c in found if _is_tagged(c, value)] + [c for c in found if not _is_tagged(c, value)]
    return found


def _keys_of_sections(kind: type) -> dict[str, str]:
    """The keys in the sections of a struct, each as the first section has it: `{"floor": "limits.floor"}`."""
    found: dict[str, str] = {}
    for section, hint in get_type_hints(kind).items():
        for struct in _structs(hint):
            for field in msgspec.structs.fields(struct):
                found.setdefault(field.name, f"{section}.{field.name}")
    return found


def _structs(hint: object) -> list[type[msgspec.Struct]]:
    """All structs in a type, at any depth."""
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return [hint]
    return [struct for inner in get_args(hint) for struct in _structs(inner)]


def _is_tagged(struct: type[msgspec.Struct], value: object) -> bool:
    tag = struct.__struct_config__
    return tag.tag_field is not None and isinstance(value, dict) and value.get(tag.tag_field) == tag.tag


def _is_secret(hint: object) -> bool:
    """Whether a key's value must not be repeated in any text."""
    if get_origin(hint) is Annotated and any(meta.extra == SECRET for meta in get_args(hint)[1:]):
        return True
    return any(_is_secret(inner) for inner in get_args(hint))


def without_none(value: object) -> Any:
    """Plain data without the keys whose value is None, which TOML cannot hold."""
    if isinstance(value, dict):
        return {k: without_none(v) for k, v in value.items() if v is not None}
    if isinstance(value, list | tuple):
        return [without_none(v) for v in value]
    return value
