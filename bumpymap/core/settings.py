"""Settings are declared once, as fields of a dataclass; values from files, calls and options are checked against that.

A field's type says what a value is, a `Setting` in it what is allowed and how the command line shows it. From this come
the options of a command (`bumpymap.cli`), the keys of a TOML file (`read_settings_file`), the keywords of a Python call
(`settings_of_call`), a schema for editors (`settings_schema`), and what ``__post_init__`` checks (`check_settings`).
Vehicle profiles are parsed in the same way.

Libraries were weighed: pydantic 2.14 takes 0.18 s to import and 9 ms for each class, where all of ``--help`` takes
0.1 s; msgspec ends at the first fault. Either would replace the 80 lines of `_Parser`, and need as many for messages.
"""

import json
import math
import os
import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass, replace
from functools import cache
from itertools import pairwise
from numbers import Integral, Real
from pathlib import Path
from reprlib import Repr
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from bumpymap.core.errors import BumpymapError, UsageError
from bumpymap.core.files import plain_json, read_regular

_MOST_BYTES = 16 * 1024
"""Several times that of every setting with its description. Time and memory of ``tomllib`` grow with the square of the
parts of a dotted key: one of this size takes 3 s and 0.3 GB."""
_MESSAGE_CHARACTERS = 300
"""Characters of the parser's message that are shown at most: it may quote a key in full."""
_NAMED = 8
"""Keys that a message names at most."""
_BRIEF = 80
"""Characters of a field that `brief_repr` shows."""
_SHORT = Repr()
"""Shows values in messages: two levels of nesting, 80 characters of a text or number."""
_SHORT.maxlevel = 2
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 80


def read_toml(path: Path, what: str, error: type[BumpymapError]) -> dict[str, Any]:
    """Read a TOML file of at most 16 kB; a byte order mark at its start is skipped.

    ``what``: what the file contains, for messages, such as ``settings``; ``error``: raised if the file cannot be read:
    it is not a regular file, too large, not UTF-8, or not TOML.
    """
    try:
        return tomllib.loads(read_regular(path, _MOST_BYTES).decode("utf-8-sig"))
    except OSError as caught:
        raise error(f"cannot read {what} from {path}: {caught.strerror or caught}") from caught
    except UnicodeDecodeError as caught:
        place = f"not UTF-8 text at byte {caught.start}; save it as UTF-8"
        raise error(f"cannot read {what} from {path}: {place}") from caught
    except RecursionError as caught:
        raise error(f"cannot read {what} from {path}: lists or tables are nested too deep") from caught
    except ValueError as caught:  # not TOML, a number too long, over a limit
        raise error(f"cannot read {what} from {path}: {str(caught)[:_MESSAGE_CHARACTERS]}") from caught


def short_repr(value: Any) -> str:
    """Return a value as text for a message; the middle of a long one is left out."""
    return _SHORT.repr(value)


def brief_repr(record: Any) -> str:
    """Return a dataclass as a few lines; of an array its type and shape. To be used as its ``__repr__``."""
    parts = []
    for field in fields(record):
        value = getattr(record, field.name)
        text = f"{value.dtype}{list(value.shape)}" if hasattr(value, "dtype") else short_repr(value)
        parts.append(f"{field.name}={text if len(text) <= _BRIEF else text[: _BRIEF - 3] + '...'}")
    return f"{type(record).__name__}({', '.join(parts)})"


def short_names(names: list[str]) -> str:
    """Return keys as text for a message: the first few, each shortened if it is long."""
    first = [short_repr(name)[1:-1] for name in names[:_NAMED]]
    return ", ".join(first + ([f"{len(names) - _NAMED} more"] if len(names) > _NAMED else []))


UNFILLED = "?"
"""Placeholder, in a template file, for a value that the user must fill in."""
_MOST_FAULTS = 40
"""Faults that a message lists at most."""
_LONGEST_NAME = 255
"""Bytes of one component of a path: the limit of common file systems."""

NameOrFile = Annotated[str, "a name, or the path of a file"]
"""A file ends in ``.toml`` or ``.csv``, or contains a slash; a relative path in a settings file starts at the folder of
that file."""

_WORDS = {
    bool: ("true or false", "true or false"),
    int: ("a whole number", "whole numbers"),
    float: ("a number", "numbers"),
}
_TEXT = ("a string", "strings")
"""Names of a type for messages: singular and plural."""
_MISTAKEN = {
    "m": ("mm", 0.001),
    "m/s": ("km/h", 1 / 3.6),
    "deg": ("rad", math.degrees(1.0)),
    "rad": ("deg", math.radians(1.0)),
    "rad/m": ("deg/m", math.radians(1.0)),
}
"""The unit that is often used by mistake, and its size in the right one."""
_WRONG_TYPE = object()
"""Returned for a value that does not have its field's type."""


@dataclass(frozen=True, slots=True)
class Setting:
    """Limits of a field of a settings class beyond its type, and how the command line shows it.

    It stands in the field's type, such as ``Annotated[float, Setting("Tile size in metres", "M", 0.05, 1000.0, "m")]``.
    """

    help: str = ""
    """Text of the option, without its full stop; empty: there is no option."""
    metavar: str | None = None
    """Name of the option's value, such as ``FILE``."""
    low: float = -math.inf
    high: float = math.inf
    """Bounds of a number, or of each number of a list."""
    unit: str = ""
    """Of the bounds."""
    exclusive: bool = False
    """The bounds themselves are not allowed."""
    why: str = ""
    """Continues the message about a value out of bounds."""
    default: str | None = None
    """The default as the option's text shows it; None: that of the field; empty: none is shown."""
    option: str = ""
    """Name of the option, without dashes, where it is not that of the field."""
    group: str = "Run"
    """Heading of the help page that the option stands under."""
    rare: bool = False
    """True: no option of its own; it is set in a settings file, or with ``--set``."""

    def holds(self, value: float) -> bool:
        """Return whether a number is finite and within the bounds."""
        within = self.low < value < self.high if self.exclusive else self.low <= value <= self.high
        return within and abs(value) < math.inf

    def suggest_unit(self, value: Any) -> str:
        """Name the unit in which a number out of bounds would be within them; empty if there is none."""
        unit, factor = _MISTAKEN.get(self.unit, ("", 0.0))
        fits = unit and isinstance(value, float) and self.holds(value * factor)
        return f"; {value:g} {unit} would be {value * factor:.3g}" if fits else ""

    @property
    def bounds(self) -> str:
        """Description of the bounds; continues *a number*."""
        unit = self.unit and f" {self.unit}"
        if self.high < math.inf:
            low, high = ("between", "and") if self.exclusive else ("from", "to")
            return f" {low} {self.low:.7g} {high} {self.high:.7g}{unit}{self.why}"
        if self.low > -math.inf:
            return f"{' greater than' if self.exclusive else ', at least'} {self.low:g}{unit}{self.why}"
        return f"{unit and f' ({self.unit})'}{self.why}"


@dataclass(frozen=True, slots=True)
class Declared:
    """A field of a settings class."""

    name: str
    kind: Any
    """Its type, without None and without the `Setting`."""
    optional: bool
    setting: Setting | None
    """None: the type says all."""
    field: "Field[Any]"

    @property
    def default(self) -> Any:
        """Its default, made anew where there is a factory; None if it has none."""
        field = self.field
        default = field.default if field.default_factory is MISSING else field.default_factory()
        return None if default is MISSING else default

    @property
    def required(self) -> bool:
        """True if it has no default."""
        return self.field.default is MISSING and self.field.default_factory is MISSING


@cache
def declared_fields(owner: type) -> Mapping[str, Declared]:
    """Return the fields of a settings class by name, in their order."""
    found = {}
    for each in fields(owner):
        setting = next((note for note in get_args(each.type)[1:] if isinstance(note, Setting)), None)
        found[each.name] = Declared(each.name, _plain_type(each.type), _is_optional(each.type), setting, each)
    return found


def settings_with_options(owner: type) -> tuple[tuple[Declared, Setting], ...]:
    """Return the fields of a settings class that the command line knows by name, in their order; also rare ones."""
    every = declared_fields(owner).values()
    return tuple((each, each.setting) for each in every if each.setting and each.setting.help)


def _described(owner: type) -> Iterator[tuple[Declared, str]]:
    """Yield the fields that a settings file may hold, with what they mean.

    That is the docstring under a field, if the source of the class is there, else the text of its option.
    """
    import ast
    import inspect

    notes: dict[str, str] = {}
    with suppress(OSError, SyntaxError):
        body = ast.parse(inspect.cleandoc("\n" + inspect.getsource(owner))).body[0]
        for field, note in pairwise(body.body if isinstance(body, ast.ClassDef) else []):
            if isinstance(field, ast.AnnAssign) and isinstance(note, ast.Expr) and isinstance(note.value, ast.Constant):
                notes[ast.unparse(field.target)] = " ".join(str(note.value.value).split()).replace("``", "")
    for name, each in declared_fields(owner).items():
        # Python calls give objects of other types too.
        written = get_origin(each.kind) in (None, tuple, Literal, Annotated, Union, UnionType)
        if each.field.init and not each.required and written and not isinstance(each.kind, str):
            help_ = each.setting.help if each.setting else ""
            yield each, notes.get(name) or (help_ and f"{help_}.")


def settings_template(owners: Sequence[type]) -> str:
    """Return a TOML file with every setting of some classes, its description and its default, all commented out."""
    from textwrap import wrap

    lines: list[str] = []
    tables: list[tuple[str, Any]] = [("", owner) for owner in owners]
    written: set[tuple[str, str]] = set()
    while tables:
        table, owner = tables.pop(0)
        lines += ["", f"#[{table}]"] if table else []
        for each, note in _described(owner):
            if (table, each.name) in written:
                continue
            written.add((table, each.name))
            if is_dataclass(each.kind):
                tables.append((f"{table}.{each.name}".lstrip("."), each.kind))
                continue
            default = each.setting.default if each.setting else None
            allowed = allowed_values(each.kind, each.setting)
            shown = f" [default: {default}]" if default else ""
            text = f"{note} {allowed[0].upper()}{allowed[1:]}{shown}.".strip()
            lines += ["", *(f"# {line}" for line in wrap(text, 100))]
            value = None if default else plain_json(each.default)
            # A value of JSON, or a list of them, is one of TOML.
            lines.append(f"#{each.name} =" + ("" if value is None else f" {json.dumps(value)}"))
    return "\n".join(lines[1:]) + "\n"


def settings_schema(owners: Sequence[type]) -> dict[str, Any]:
    """Return a JSON schema of the settings file of some classes, by which editors complete and check it."""
    return {"$schema": "http://json-schema.org/draft-07/schema#", **_schema_of_table(owners)}


def _schema_of_table(owners: Iterable[Any]) -> dict[str, Any]:
    properties: dict[str, Any] = {}
    for owner in owners:
        for each, note in _described(owner):
            kind, setting = each.kind, each.setting or Setting()
            is_table = is_dataclass(kind)
            found = _schema_of_table([kind]) if is_table else _schema_of(kind, setting)
            default = None if is_table or setting.default else plain_json(each.default)
            more = {} if default is None else {"default": default}
            properties.setdefault(each.name, {"description": note} | found | more)
    return {"type": "object", "properties": properties, "additionalProperties": False}


def _schema_of(kind: Any, setting: Setting) -> dict[str, Any]:
    items = get_args(kind)
    if get_origin(kind) is tuple:
        count = {} if items[-1] is Ellipsis else {"minItems": len(items), "maxItems": len(items)}
        return {"type": "array", "items": _schema_of(items[0], setting)} | count
    if get_origin(kind) is Literal:
        return {"enum": list(items)}
    names = ("exclusiveMinimum", "exclusiveMaximum") if setting.exclusive else ("minimum", "maximum")
    bounds = zip(names, (setting.low, setting.high), strict=True)
    limits = {name: bound for name, bound in bounds if abs(bound) < math.inf and kind in (int, float)}
    return {"type": {bool: "boolean", int: "integer", float: "number"}.get(kind, "string")} | limits


def check_settings(settings: object) -> None:
    """Check the fields of a settings object against their declaration; to be called by its ``__post_init__``.

    Raises UsageError: a number is out of bounds, or a value is none of those to choose from.
    """
    owner: type = type(settings)
    for each in declared_fields(owner).values():
        value, setting = getattr(settings, each.name), each.setting
        if setting and not (each.optional and value is None) and not _is_allowed(value, each.kind, setting):
            name = f"`{each.name}`" if setting.help else each.name
            shown = ", ".join(map(str, value))[:_BRIEF] if isinstance(value, tuple) else short_repr(value)
            raise UsageError(f"{name} is {shown}; it must be {allowed_values(each.kind, setting)}")


def _is_allowed(value: Any, kind: Any, setting: Setting) -> bool:
    """Return whether a value is a number within bounds, or one of those to choose from; other types are not checked."""
    if get_origin(kind) is tuple:
        return isinstance(value, list | tuple) and all(_is_allowed(item, get_args(kind)[0], setting) for item in value)
    if get_origin(kind) is Literal:
        return type(value) in {str, int} and value in get_args(kind)
    if kind not in (int, float):
        return True
    is_number = isinstance(value, int if kind is int else int | float) and not isinstance(value, bool)
    return is_number and setting.holds(value)


def read_settings_file(path: Path, *owners: type) -> dict[str, Any]:
    """Read settings from a TOML file.

    ``path``: path of the file. Relative paths in the file start at its folder. ``*owners``: dataclasses that the
    settings are for; see `parse_record`. Returns arguments of ``owners`` for the fields that the file sets. Raises
    UsageError: no such file, not TOML, an unknown key, a value of the wrong type or out of range; the message lists all
    faults.
    """
    arguments, faults = parse_record(read_toml(path, "settings", UsageError), owners, path.parent)
    refuse_faults(faults, str(path), UsageError)
    return arguments


def assigned_settings(
    assignments: Iterable[str], before: Mapping[str, Any], origin: str, *owners: type
) -> dict[str, Any]:
    """Read settings that are given as ``KEY=VALUE``, a table's as ``TABLE.KEY=VALUE``.

    ``assignments``: the value is TOML; quotes of a text and brackets of a list may be left out; ``before``: settings
    that these override; a table keeps its other values; ``origin``: where they come from, for messages; ``*owners``:
    dataclasses that the settings are for; see `parse_record`. Returns arguments of ``owners`` for the fields that are
    set. Raises UsageError: not of this form, an unknown key, a value of the wrong type or out of range; the message
    lists all faults.
    """
    known, record = _fields_of(owners), dict[str, Any]()
    for text in assignments:
        key, equals, value = text.partition("=")
        *table, name = key.strip().split(".")
        if not equals or len(table) > 1 or not name:
            raise UsageError(f"{origin} {short_repr(text)[1:-1]}: give KEY=VALUE, such as pixels=21")
        place = record.setdefault(table[0], {}) if table else record
        if not isinstance(place, dict):
            raise UsageError(f"{origin} gives {table[0]} both as a value and as a table")
        outer = known.get(table[0]) if table else None
        inside = _fields_of((outer.kind,)) if outer and is_dataclass(outer.kind) else {} if table else known  # type: ignore[arg-type]
        place[name] = value_of_text(value.strip(), inside[name].kind if name in inside else None)
    parser, arguments = _Parser(Path()), {}
    for name, each in known.items():
        if isinstance(record.get(name), dict) and is_dataclass(each.kind):
            own = parser.table(record.pop(name), (each.kind,), name, complete=False)  # type: ignore[arg-type]
            base = before.get(name) or each.default
            arguments[name] = base if parser.faults else replace(base, **own)
    arguments |= parser.table(record, owners, "", complete=False)
    refuse_faults(parser.faults, origin, UsageError)
    return arguments


def value_of_text(text: str, kind: Any) -> Any:
    """Return a value of a type, as TOML or without the quotes of a text and the brackets of a list; or a percentage."""
    is_list = get_origin(kind) is tuple
    for toml in (text, f"[{text}]") if is_list else (text,):
        with suppress(ValueError, RecursionError):
            value = tomllib.loads(f"value = {toml}")["value"]
            if isinstance(value, list) == is_list and (kind is not str or isinstance(value, str)):
                return value
    if kind is float and text.endswith("%"):
        with suppress(ValueError):
            share = float(text[:-1]) / 100.0
            return share if 0.0 <= share <= 1.0 else text
    return [part.strip() for part in text.split(",")] if is_list else text


def settings_of_call(
    given: Mapping[str, Any], owner: type, function: str, known: Collection[str] = ()
) -> dict[str, Any]:
    """Check the keyword arguments of a Python call in the same way as the settings of a file.

    ``given``: name -> value. Tables may be dicts or dataclasses, paths any path-like object; None means not given.
    ``owner``: dataclass that the settings are for, see `parse_record`; ``function``: name of the called function, for
    messages; ``known``: names that may be given; default is those of all fields. Returns arguments of ``owner``. Raises
    UsageError: a name that is not known; values of the wrong type or out of range; the message lists all faults.
    """
    refuse_unknown(given, known or [field.name for field in fields(owner)], function)
    record = {name: _plain(value) for name, value in given.items() if value is not None}
    arguments, faults = parse_record(record, owner, Path())
    refuse_faults(faults, function, UsageError)
    return arguments


def refuse_unknown(given: Iterable[str], known: Collection[str], function: str) -> None:
    """Raise UsageError if a Python call names a setting that is not there."""
    if unknown := [name for name in given if name not in known]:
        raise UsageError(f"{function}: {unknown_text(unknown, known)}")


def unknown_text(unknown: list[str], known: Collection[str], kind: str = "setting") -> str:
    """Return what is wrong with names that are not known, and what to give instead; ``kind``: what they are of."""
    from difflib import get_close_matches

    near = get_close_matches(unknown[0][:_LONGEST_NAME], known, 1)
    meant = f". Did you mean {near[0]}?" if near else ""
    return f"unknown {kind} {short_names(unknown)}; there are: {', '.join(known)}{meant}"


def path_of_call(name: str, place: str | os.PathLike[str]) -> str:
    """Return a path that a Python call gives as text; raise UsageError if it is not a valid path."""
    if not isinstance(place, str | os.PathLike):
        raise UsageError(f"{name} is {short_repr(place)}; it must be a path")
    text = os.fspath(place)
    if reason := path_fault(text) or ("" if text else "the path is empty; the current folder is called ."):
        raise UsageError(f"{name}: {reason}")
    return text


def _plain(value: Any) -> Any:
    """Convert a Python value to the value that a TOML file would contain."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, bool) or not isinstance(value, Real):
        return value
    return int(value) if isinstance(value, Integral) else float(value)  # NumPy scalars too


def parse_record(
    record: Any, owner: type | tuple[type, ...], folder: Path, *, complete: bool = False
) -> tuple[dict[str, Any], list[str]]:
    """Turn nested dictionaries into the arguments of a dataclass.

    ``record``: as read from a TOML or JSON file; ``owner``: dataclass, or several whose fields stand side by side. A
    field may be a bool, a number, a str, a Path, a ``NameOrFile``, a Literal of strings, a tuple of one of these, a
    dataclass (a table in the file), any of them or None, or any of them ``Annotated`` with a `Setting`. ``folder``:
    folder at which relative paths start; ``complete``: whether a missing field without a default is a fault. In nested
    tables it always is. Returns arguments for the fields that ``record`` sets; and its faults, each with the
    key, its value and what is allowed.
    """
    parser, owners = _Parser(folder), owner if isinstance(owner, tuple) else (owner,)
    if not isinstance(record, dict):
        return {}, [f"it holds {short_repr(record)}; it must hold a table with {', '.join(_fields_of(owners))}"]
    return parser.table(record, owners, "", complete=complete), parser.faults


def refuse_faults(faults: list[str], origin: str, error: type[BumpymapError], more: str = "") -> None:
    """Raise an error that lists all faults, if there are any; ``more`` follows their number in the message."""
    if len(faults) == 1:
        raise error(f"{origin}: {faults[0]}")
    if faults:
        lines = [f"  {fault}" for fault in faults[:_MOST_FAULTS]]
        left = len(faults) - len(lines)
        raise error(f"{origin}: {len(faults)} errors{more}", *lines, *([f"  and {left} more"] if left else []))


class _Parser:
    """Converts values to the types of fields, and collects faults."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.faults: list[str] = []

    def table(self, record: dict[str, Any], owners: tuple[type, ...], table: str, *, complete: bool) -> dict[str, Any]:
        """Return the arguments of dataclasses; ``table`` is the name of their table, empty for the top level."""
        known = _fields_of(owners)
        unknown = sorted(set(record) - set(known))
        if unknown:
            where = f"[{table}]: " if table else ""
            self.faults.append(f"{where}{unknown_text(unknown, known)}")
        arguments = {}
        for name, each in known.items():
            full = f"{table}.{name}" if table else name
            if name in record:
                arguments[name] = self._value(record[name], each.kind, each.setting, full)
            elif complete and each.required:
                self.faults.append(f"missing {full}: {_allowed(each.kind, each.setting, full)}")
        return arguments

    def _value(self, value: Any, kind: Any, setting: Setting | None, name: str) -> Any:
        """Convert a value to the type of its field and check it against its `Setting`."""
        before = len(self.faults)
        found = self._converted(value, kind, name)
        if len(self.faults) > before:
            return found
        if isinstance(value, str) and value == UNFILLED:
            self.faults.append(f"{name} is not filled in: {_allowed(kind, setting, name)}")
        elif found is _WRONG_TYPE or (setting is not None and not _is_allowed(found, kind, setting)):
            hint = "" if setting is None else setting.suggest_unit(found)
            self.faults.append(f"{name} is {short_repr(value)}; it must be {_allowed(kind, setting, name)}{hint}")
        return found

    def _converted(self, value: Any, kind: Any, name: str) -> Any:
        items = get_args(kind)
        if is_dataclass(kind) and isinstance(value, dict):
            return self._built(value, kind, name)
        fits = isinstance(value, list | tuple) and get_origin(kind) is tuple
        if fits and (items[-1] is Ellipsis or len(items) == len(value)):
            return tuple(
                self._value(item, items[0], None, f"value {number} of {name}") for number, item in enumerate(value, 1)
            )
        if kind in (Path, NameOrFile) and isinstance(value, str):
            return self._placed(value, kind, name)
        if kind is float and type(value) is int and abs(value) < 2**1023:
            return float(value)
        of_kind = _is_allowed(value, kind, Setting()) if get_origin(kind) is Literal else type(value) is kind
        return value if of_kind else _WRONG_TYPE

    def _built(self, record: dict[str, Any], kind: Any, name: str) -> Any:
        """Create the dataclass of a table."""
        before = len(self.faults)
        arguments = self.table(record, (kind,), name, complete=True)
        if len(self.faults) > before:
            return _WRONG_TYPE
        try:
            return kind(**arguments)
        except UsageError as error:
            keys = str(error).replace("`", "")  # of this table: no options of the command line
            self.faults.append(f"[{name}]: {keys}")
            return _WRONG_TYPE

    def _placed(self, text: str, kind: Any, name: str) -> Path | str:
        """Resolve a relative path against the folder of the file; leave names as they are."""
        if reason := path_fault(text):
            self.faults.append(f"{name}: {reason}")
        if kind == NameOrFile:
            is_file = text.endswith((".toml", ".csv")) or "/" in text
            return str(self._folder / text) if is_file else text
        return self._folder / text


def path_fault(text: str) -> str:
    """Return why no file can have this path; empty if the path is valid."""
    if "\0" in text:
        return "a path cannot hold the character NUL"
    if "://" in text:
        return f"{text} is a URL; give a path of this machine. rclone copyurl URL FILE copies a file of a server here"
    longest = max((len(os.fsencode(name)) for name in text.split("/")), default=0)
    if longest > _LONGEST_NAME:
        return f"the path has a name of {longest} bytes; names have up to {_LONGEST_NAME}"
    return ""


def _plain_type(kind: Any) -> Any:
    """Return the type without None (which means that the setting is left out), its rule and its `Setting`."""
    if get_origin(kind) is Annotated:
        base, *notes = get_args(kind)
        kept = tuple(note for note in notes if isinstance(note, str))
        kind = Annotated[base, *kept] if kept else base
    return Union[tuple(item for item in get_args(kind) if item is not NoneType)] if _is_optional(kind) else kind  # noqa: UP007


def _is_optional(kind: Any) -> bool:
    """Return whether a type, or the one that is annotated, is a union with None."""
    base = get_args(kind)[0] if get_origin(kind) is Annotated else kind
    return get_origin(base) in (Union, UnionType) and NoneType in get_args(base)


def _fields_of(owners: tuple[type, ...]) -> dict[str, Declared]:
    """Return the fields of dataclasses by name; of one that several have, that of the first."""
    return {name: each for owner in reversed(owners) for name, each in declared_fields(owner).items()}


def _allowed(kind: Any, setting: Setting | None, name: str) -> str:
    """Describe the values that a field can have."""
    if is_dataclass(kind):
        return f"a table, [{name}], with {', '.join(each.name for each in fields(kind))}"
    return allowed_values(kind, setting)


def allowed_values(kind: Any, setting: Setting | None) -> str:
    """Describe the values that a type without None and its `Setting` allow, such as ``a number from 0.1 to 20 m``."""
    items, bounds = get_args(kind), setting.bounds if setting else ""
    article = "a finite number" if setting and setting.high == math.inf else "a number"
    if get_origin(kind) is tuple:
        count = "" if items[-1] is Ellipsis else f"{len(items)} "
        if get_origin(items[0]) is Literal:
            return f"a list of {count}{_TEXT[1]}: {', '.join(get_args(items[0]))}"
        return f"a list of {count}{_WORDS.get(items[0], _TEXT)[1]}{bounds}"
    if get_origin(kind) is Literal:
        return f"one of {', '.join(map(str, items))}"
    return f"{article if kind is float else _WORDS.get(kind, _TEXT)[0]}{bounds}"
