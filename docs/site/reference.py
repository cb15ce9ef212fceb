"""The pages of the reference that are made from the code: configuration keys, public names, messages.

`hooks.py` adds them to the site; tests/test_docs.py holds that nothing is missing in them.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import textwrap
from collections.abc import Iterator, Mapping
from enum import Enum
from pathlib import Path
from typing import Any, Final

from msgspec import NODEFAULT
from msgspec import inspect as types
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.polled.streams import FIRMWARE_OF, SENSED_RATES_HZ, STREAM_RATES_HZ
from companion.autopilot.readers import READERS
from companion.autopilot.sensors import SENSOR_READERS, attitude
from companion.autopilot.wire import COMPONENT_INFORMATION_BASIC, COMPONENT_METADATA, CURRENT_MODE
from companion.config.sections import Config, TrajectoryFile
from companion.gate import gate
from companion.geofence import FenceFile
from companion.remote_id.region import Region
from dmuca import ROOMS

ROOT: Final = Path(__file__).parents[2]
ROOM_PAGES: Final = {**ROOMS, "testing": "dmuca.testing"}
"""Name of each page of public names, and the module that it describes."""
_LOADED: Final = ("path", "fence", "region")
"""Fields of the configuration that no user writes: contents of the files that other keys name."""
_NEW: Final = {
    CURRENT_MODE: "CURRENT_MODE",
    COMPONENT_INFORMATION_BASIC: "COMPONENT_INFORMATION_BASIC",
    COMPONENT_METADATA: "COMPONENT_METADATA",
}
"""Messages that pymavlink's dialect does not know."""
_FILES: Final = {
    "Trajectory files": ("Named by `flight.trajectory`.", TrajectoryFile),
    "Fence files": ("Named by `limits.fence`.", FenceFile),
    "Region profiles": ("Named by `remote_id.region`.", Region),
}


def configuration() -> str:
    """The page of all keys of a configuration file and of the files that it names."""
    parts = [
        "# Configuration keys",
        "Made from the code. `config/companion.toml` shows the same keys in one file, and `companion init` "
        "writes such a file. A key without a default must be given. An unknown key is refused, and so is a "
        "value outside the range.",
    ]
    for field in _struct(Config).fields:
        if field.encode_name not in _LOADED:
            for kind in _structs(field.type):
                tag = f" {kind.tag}" if kind.tag else ""
                name = f"[[{field.encode_name}]]" if kind.tag else f"[{field.encode_name}]"
                parts += [f"## {name}{tag}", *_section(kind)]
    for heading, (words, file) in _FILES.items():
        parts += [f"## {heading}", words, *_section(_struct(file))]
    return "\n\n".join(parts) + "\n"


def _struct(cls: type) -> types.StructType:
    found = types.type_info(cls)
    assert isinstance(found, types.StructType)
    return found


def _structs(kind: types.Type) -> Iterator[types.StructType]:
    """The structs that a value of this type is made of, the outermost ones only."""
    if isinstance(kind, types.StructType):
        yield kind
    elif isinstance(kind, types.UnionType):
        for one in kind.types:
            yield from _structs(one)
    elif isinstance(kind, types.VarTupleType | types.ListType):
        yield from _structs(kind.item_type)
    elif isinstance(kind, types.DictType):
        yield from _structs(kind.value_type)


def _name(kind: types.StructType) -> str:
    return kind.cls.__name__.strip("_")


def _section(kind: types.StructType) -> Iterator[str]:
    """Words and table of one section, and then of the tables inside it."""
    yield _flat(inspect.getdoc(kind.cls) or "")
    words = dict(_words(kind.cls))
    rows = ["| key | value | default | meaning |", "|---|---|---|---|"]
    if kind.tag:
        rows.append(f'| `{kind.tag_field}` | `"{kind.tag}"` | must be given | the kind of this table |')
    inner = []
    for field in kind.fields:
        default = _default(field)
        meaning = words.get(field.name, "")
        rows.append(f"| `{field.encode_name}` | {_values(field.type)} | {default} | {_cell(meaning)} |")
        inner += list(_structs(field.type))
    if len(rows) > 2:
        yield "\n".join(rows)
    for struct in inner:
        yield f"### {_name(struct)}"
        yield from _section(struct)


def _words(cls: type) -> Iterator[tuple[str, str]]:
    """Each field of a class that is documented, and its words."""
    for base in reversed(cls.__mro__[:-1]):
        try:
            source = textwrap.dedent(inspect.getsource(base))
        except (OSError, TypeError):
            continue
        (node,) = ast.parse(source).body
        assert isinstance(node, ast.ClassDef)
        for field, after in zip(node.body, node.body[1:], strict=False):
            if (
                isinstance(field, ast.AnnAssign)
                and isinstance(field.target, ast.Name)
                and isinstance(after, ast.Expr)
                and isinstance(after.value, ast.Constant)
                and isinstance(after.value.value, str)
            ):
                yield field.target.id, _flat(after.value.value)


def _default(field: types.Field) -> str:
    if field.required:
        return "must be given"
    value: Any = field.default
    if value is NODEFAULT:
        value = field.default_factory() if callable(field.default_factory) else None
    if value is None or (isinstance(value, tuple | dict | list) and not value):
        return "none"
    if hasattr(value, "__struct_fields__"):
        return "its own defaults"
    if isinstance(value, Enum):
        return f"`{value.value}`"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, tuple):
        return _code(str(list(value)).replace("'", '"'))
    return _code(f'"{value}"' if isinstance(value, str) else f"{value}")


def _values(kind: types.Type) -> str:
    """The values of a type, in words."""
    if isinstance(kind, types.Metadata):
        return _values(kind.type)
    if isinstance(kind, types.UnionType):
        return " or ".join(_values(one) for one in kind.types if not isinstance(one, types.NoneType))
    if isinstance(kind, types.LiteralType):
        return ", ".join(_code(f'"{value}"') for value in kind.values)
    if isinstance(kind, types.EnumType):
        return ", ".join(f"{value.value} {value.name.lower()}" for value in kind.cls)
    if isinstance(kind, types.BoolType):
        return "true or false"
    if isinstance(kind, types.IntType | types.FloatType):
        return f"{'integer' if isinstance(kind, types.IntType) else 'number'}{_range(kind)}"
    if isinstance(kind, types.StrType):
        return f"text{_length(kind)}{f', as {_code(kind.pattern)}' if kind.pattern else ''}"
    if isinstance(kind, types.VarTupleType | types.ListType):
        return f"list of {_values(kind.item_type)}{_length(kind)}"
    if isinstance(kind, types.TupleType):
        return f"list of {len(kind.item_types)}: {', '.join(_values(item) for item in kind.item_types)}"
    if isinstance(kind, types.DictType):
        return f"table of {_values(kind.value_type)}"
    if isinstance(kind, types.StructType):
        return f"table {_name(kind)}"
    return "any value"


def _range(kind: types.IntType | types.FloatType) -> str:
    limits = [
        f"{words} {limit:g}"
        for words, limit in (
            ("above", kind.gt),
            ("at least", kind.ge),
            ("below", kind.lt),
            ("at most", kind.le),
        )
        if limit is not None
    ]
    return f", {', '.join(limits)}" if limits else ""


def _length(kind: Any) -> str:
    if kind.max_length is not None:
        return f" ({kind.min_length or 0} to {kind.max_length})"
    return f" (at least {kind.min_length})" if kind.min_length else ""


def public_names() -> dict[str, str]:
    """A page for each public room, for mkdocstrings: all its public names."""
    pages = {}
    for name, module in ROOM_PAGES.items():
        lines = [f"# {module}", _flat(importlib.import_module(module).__doc__ or "").split(". ")[0] + ".", ""]
        for public in importlib.import_module(module).__all__:
            lines += [f"::: {module}.{public}", ""]
        pages[name] = "\n".join(lines)
    return pages


def messages() -> str:
    """The page of MAVLink messages and of the texts that the pilot may read."""
    read = [
        f"| {_message(number)} | {_rate(number)} | {_first_sentence(reader)} |"
        for number, reader in READERS.items()
    ]
    sensed = [
        f"| {_message(number)} | {_rate(number, SENSED_RATES_HZ)} | {_first_sentence(reader)} |"
        for number, reader in [(mavlink.MAVLINK_MSG_ID_ATTITUDE, attitude), *SENSOR_READERS.items()]
    ]
    free = sorted(_message(number) for number in gate._FREE)
    texts = "\n".join(f"| {_code(text)} | `{where}` |" for text, where in pilot_texts())
    return "\n\n".join(
        (
            "# Messages",
            "Made from the code. [The gate](../gate.md) says which rules each message that leaves must keep.",
            "## Read from the vehicle",
            "Beside HEARTBEAT, STATUSTEXT, TIMESYNC, RADIO_STATUS and the answers of the mission, parameter "
            "and command protocols. The rate is the one that is asked for.",
            "\n".join(("| message | rate | what is read |", "|---|---|---|", *read)),
            "With `sensed.use`, besides, from the vehicle and its sensors ([sensed.md](../sensed.md)):",
            "\n".join(("| message | rate | what is read |", "|---|---|---|", *sensed)),
            "## Sent to the vehicle",
            "Always allowed, because they command nothing: " + ", ".join(free) + ".",
            "Only while the companion has authority, and only within the gate's bounds: "
            f"{_message(gate._SETPOINT)}, and {_message(gate._COMMAND)} for modes, speeds and message rates.",
            "## Texts for the pilot",
            "STATUSTEXT messages, with the file of the code where each is written. A word in braces stands "
            "for what was found in flight.",
            "| text | where |\n|---|---|\n" + texts,
        )
    )


def _message(number: int) -> str:
    known = mavlink.mavlink_map.get(number)
    return f"{known.msgname if known else _NEW[number]} ({number})"


def _rate(number: int, rates: Mapping[int, float] = STREAM_RATES_HZ) -> str:
    only = f", {FIRMWARE_OF[number].value} only" if number in FIRMWARE_OF else ""
    return f"{rates[number]:g}/s{only}" if number in rates else "not asked for"


def pilot_texts() -> list[tuple[str, str]]:
    """Each text for the pilot, and the file where it is written."""
    found: dict[str, str] = {}
    for path in sorted((ROOT / "companion").rglob("*.py")):
        tree = ast.parse(path.read_text())
        formatted = [node for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)]
        inside = {id(part) for node in formatted for part in node.values}
        for node in ast.walk(tree):
            text = None
            if isinstance(node, ast.JoinedStr):
                text = "".join(_part(part) for part in node.values)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inside:
                text = node.value
            if text and text.startswith(("DMUCA: ", "DMUCA ")):
                found.setdefault(text, str(path.relative_to(ROOT)))
    return sorted(found.items())


def _part(part: ast.expr) -> str:
    if isinstance(part, ast.Constant):
        return str(part.value)
    assert isinstance(part, ast.FormattedValue)
    return f"{{{ast.unparse(part.value)}}}"


def _first_sentence(described: object) -> str:
    return _cell(_flat(inspect.getdoc(described) or "").split(". ")[0])


def _flat(text: str) -> str:
    return " ".join(text.split())


def _code(text: str) -> str:
    return f"`{_cell(text)}`"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
