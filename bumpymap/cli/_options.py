"""Options of commands, made from the declaration of their settings, and which were given on the command line."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import wraps
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

import click
from click.core import ParameterSource

from bumpymap.cli._text import option_name, set_up_logging, spell_settings
from bumpymap.core import (
    Clash,
    Declared,
    UsageError,
    assigned_settings,
    default_of,
    override_settings,
    path_fault,
    read_settings_file,
    refuse_clashes,
    settings_with_options,
)

__all__ = [
    "FILE",
    "LOCATION",
    "PATH",
    "GroupedCommand",
    "changed_settings",
    "config_options",
    "given_options",
    "grouped_option",
    "jobs_option",
    "merge_settings",
    "output_options",
    "resume_option",
    "settings_options",
]

_Command = TypeVar("_Command", bound=Callable[..., Any])


class _NamedPath(click.Path):
    """A path that is not empty: an unset shell variable must not mean the current folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Convert a string to a Path."""
        if value == "":
            self.fail("the path is empty; is a variable unset? The current folder is called .", param, ctx)
        if isinstance(value, str) and (reason := path_fault(value)):
            self.fail(reason, param, ctx)
        if isinstance(value, str) and "://" in value:
            self.fail(f"{value} is a URL; URLs can be surveys, and the --out of batch", param, ctx)
        return super().convert(value, param, ctx)


PATH = _NamedPath(path_type=Path)
"""Type of every path on the command line."""
FILE = _NamedPath(dir_okay=False, path_type=Path)
"""Type of a path that must not be a folder."""


class _Location(_NamedPath):
    """A path, or a URL, which stays a string."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Convert a string to a Path, unless it is a URL."""
        return value if isinstance(value, str) and "://" in value else super().convert(value, param, ctx)


LOCATION = _Location(path_type=Path)
"""Type of surveys on the command line."""


class GroupedOption(click.Option):
    """An option that the help page shows under the heading of its group."""

    def __init__(self, *names: Any, group: str = "Run", key: str = "", **more: Any) -> None:
        super().__init__(*names, **more)
        self.group, self.key = group, key


def _refuse_moved(ctx: click.Context, option: click.Parameter, value: Any) -> None:
    """Raise UsageError if a setting is given as an option, where it has none."""
    if value not in (None, False) and isinstance(option, GroupedOption):
        shown = option.metavar if value is True else value
        raise UsageError(
            f"{option.opts[0]} is no option: write --set {option.key}={shown}, or put it into a file for --config "
            f"(bumpymap settings {ctx.info_name} prints one)"
        )


def grouped_option(*names: str, group: str, **more: Any) -> Callable[[_Command], _Command]:
    """Add an option that the help page shows under the heading of its group."""
    return click.option(*names, cls=GroupedOption, group=group, **more)


class GroupedCommand(click.Command):
    """A command whose help page shows its options in groups, each in its order."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; messages name its settings as it takes them."""
        options = [each for each in self.params if isinstance(each, GroupedOption) and each.name]
        spell_settings({each.name: f"--set {each.key}" if each.key else each.opts[0] for each in options if each.name})
        return super().invoke(ctx)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options under the headings of their groups."""
        rows: dict[str, list[tuple[str, str]]] = {group: [] for group in GROUPS}
        shown = [each for each in self.get_params(ctx) if isinstance(each, click.Option)]
        records = [(getattr(each, "group", "Run"), each.get_help_record(ctx)) for each in shown]
        width = max(len(record[0]) for _, record in records if record)
        for group, record in records:
            if record:
                rows[group].append((record[0].ljust(width), record[1]))
        formatter.write_paragraph()
        for group, options in rows.items():
            if options:
                formatter.write_heading(group)
                with formatter.indentation():
                    formatter.write_dl(options, col_max=24)


GROUPS = ("Input", "Way", "Ground", "Vehicle", "Output", "Run")
"""Headings of help pages, in their order."""


class NumberList(click.ParamType):  # type: ignore[type-arg]
    """Numbers with commas between them."""

    name = "list"

    def __init__(self, kind: type[int] | type[float] = float) -> None:
        self._kind = kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """Convert a string to numbers."""
        try:
            return tuple(self._kind(word) for word in str(value).split(","))
        except ValueError:
            whole = "whole " if self._kind is int else ""
            self.fail(f"{value!r} is no list of {whole}numbers; give one such as 1,2,5", param, ctx)


def output_options(what: str = "Print no progress and no summary.") -> Callable[[_Command], _Command]:
    """Add ``--quiet`` and ``--json``, by which logs are printed; ``what`` is the help text of ``--quiet``."""

    def add(command: Callable[..., Any]) -> Any:
        @wraps(command)
        def run(*values: Any, **options: Any) -> Any:
            set_up_logging(as_json=options["log_json"])
            return command(*values, **options)

        log_json = click.option("--json", "log_json", is_flag=True, help="Print result, events and errors as JSON.")
        old = gone_option("--log-json", "give --json, as to every command")
        return click.option("--quiet", is_flag=True, help=what)(old(log_json(run)))

    return add


def gone_option(name: str, instead: str) -> Callable[[_Command], _Command]:
    """Add an option that there was, which only says what to do ``instead``."""

    def refuse(_ctx: click.Context, _option: click.Parameter, value: bool) -> None:
        if value:
            raise UsageError(f"{name} is gone: {instead}")

    dest = "gone" + name.replace("-", "_")
    return click.option(name, dest, is_flag=True, hidden=True, expose_value=False, callback=refuse)


resume_option = gone_option("--resume", "the same command continues an interrupted run, so leave it out")


def jobs_option(command: _Command) -> _Command:
    """Add ``--jobs`` for drives of the simulation."""
    text = "Drives at a time, each a process [one per core]."
    return click.option("--jobs", type=click.IntRange(min=1), metavar="N", help=text)(command)


def config_options(*owners: type, clashes: Sequence[Clash] = (), apart: bool = False) -> Callable[[_Command], _Command]:
    """Add ``--config`` and ``--set``, which set any field of the settings classes ``owners``.

    The command gets ``stored``: name -> value, with those of ``--set`` in the place of those of the file; or, if they
    are kept ``apart``, those of the file, and as ``assigned`` those of ``--set``.
    """

    def add(command: Callable[..., Any]) -> Any:
        @wraps(command)
        def run(*values: Any, config_file: Path | None, assigned: tuple[str, ...], **options: Any) -> Any:
            stored = read_settings_file(config_file, *owners) if config_file else {}
            own = assigned_settings(assigned, stored, "--set", *owners)
            if apart:
                return command(*values, stored=stored, assigned=own, **options)
            return command(*values, stored=merge_settings(stored, own, clashes), **options)

        text = "Any setting of `bumpymap settings`, such as pixels=21"
        assign = click.option("--set", "assigned", multiple=True, metavar="KEY=VALUE", help=f"{text}.")
        file = click.option("--config", "config_file", type=PATH, metavar="FILE", help="TOML file with settings.")
        return file(assign(run))

    return add


def settings_options(
    owner: type,
    *names: str,
    without: Sequence[str] = (),
    required: Sequence[str] = (),
    moved: Sequence[str] = (),
    table: str = "",
    **texts: str,
) -> Callable[[_Command], _Command]:
    """Add the options of a settings class: those named, or all that it declares.

    Parameters
    ----------
    owner : type
        Dataclass whose fields hold a `Setting`. Each option's value comes under the field's name.
    *names, without, required : str
        Fields to take; fields to leave out; those whose option must be given.
    moved : str
        Fields that this command takes by ``--set`` and ``--config`` alone, besides those that are declared rare.
    table : str
        Table of a settings file that holds these fields; empty: none.
    **texts : str
        Help texts of this command, without the full stop, instead of those of the declaration.
    """
    every = [each for each in settings_with_options(owner) if each.name not in without]
    declared = [each for each in every if not names or each.name in names]

    def add(command: _Command) -> _Command:
        for each in reversed(declared):
            if each.setting.rare or each.name in moved:
                command = _moved(each, f"{table}.{each.name}" if table else each.name)(command)
            else:
                command = _option(each, texts.get(each.name, each.setting.help), each.name in required)(command)
        return command

    return add


def _option(each: Declared, text: str, required: bool) -> Callable[[_Command], _Command]:
    """Return a decorator that adds one option."""
    setting = each.setting
    spelled = _spelled(each)
    default = _default_text(each.default) if setting.default is None else setting.default
    shown = f"{text} [{default}]." if default and "[" not in text else f"{text}."
    if each.kind is bool:
        as_flag: dict[str, Any] = {"flag_value": False, "type": bool} if each.default else {"is_flag": True}
        return grouped_option(spelled, each.name, help=shown, group=setting.group, **as_flag)
    kind, several = _click_type(each.kind)
    more: dict[str, Any] = {"multiple": several, "required": required, "metavar": setting.metavar}
    return grouped_option(spelled, each.name, type=kind, help=shown, group=setting.group, **more)


def _moved(each: Declared, key: str) -> Callable[[_Command], _Command]:
    """Return a decorator that adds an option which is there only to say how this setting is given."""
    more: dict[str, Any] = {"metavar": each.setting.metavar}
    if each.kind is bool:
        more = {"is_flag": True, "metavar": "false" if each.default else "true"}
    return grouped_option(
        _spelled(each), each.name, group="Run", key=key, hidden=True, expose_value=False, callback=_refuse_moved, **more
    )


def _spelled(each: Declared) -> str:
    return f"--{(each.setting.option or each.name).replace('_', '-')}"


def _default_text(value: Any) -> str:
    """Return a default as help texts show it; empty for a flag, and where nothing is set."""
    if value is None or isinstance(value, bool) or value == ():
        return ""
    if isinstance(value, tuple):
        return ",".join(map(_default_text, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _click_type(kind: Any) -> tuple[Any, bool]:
    """Return the type of an option, and whether it may be given several times."""
    items = get_args(kind)
    if get_origin(kind) is Literal:
        return (click.Choice(items) if isinstance(items[0], str) else type(items[0])), False
    if get_origin(kind) is tuple:
        return (NumberList(items[0]), False) if items[0] in (int, float) else (_click_type(items[0])[0], True)
    return {int: int, float: float, Path: PATH, Path | str: LOCATION}.get(kind), False


def given_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that were given on the command line, even with an empty value; leave out defaults.

    Parameters
    ----------
    options : mapping
        Name -> value of all options of the current command.
    """
    source = click.get_current_context().get_parameter_source
    return {name: value for name, value in options.items() if source(name) is ParameterSource.COMMANDLINE}


def changed_settings(stored: Mapping[str, Any], *owners: type) -> dict[str, Any]:
    """Return the settings that differ from their defaults: a settings file may state those too."""
    defaults = {field.name: default_of(field) for owner in reversed(owners) for field in fields(owner)}
    return {name: value for name, value in stored.items() if value != defaults[name]}


def merge_settings(from_file: dict[str, Any], given: dict[str, Any], clashes: Sequence[Clash]) -> dict[str, Any]:
    """Merge the settings of a file and of the command line, which also override settings that contradict them.

    Raises
    ------
    UsageError
        Settings of one source contradict each other.
    """
    refuse_clashes(from_file, clashes)
    refuse_clashes(given, clashes, option_name)
    return override_settings(from_file, given, clashes)
