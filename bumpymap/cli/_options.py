"""Commands: their options, made from the declaration of their settings, which were given, and how results are printed.

A command is a function of a `Run` with the decorator `job`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, is_dataclass
from functools import wraps
from inspect import signature
from itertools import chain
from pathlib import Path
from typing import Any, Literal, NoReturn, TypeVar, get_args, get_origin

import click
from click.core import ParameterSource

from bumpymap.cli._output import (
    CommandProgress,
    Styled,
    Table,
    option_name,
    print_json,
    print_lines,
    set_up_logging,
    show_progress,
    spell_settings,
)
from bumpymap.core import (
    Clash,
    Declared,
    Setting,
    UsageError,
    assigned_settings,
    declared_fields,
    override_settings,
    path_fault,
    read_settings_file,
    refuse_clashes,
    settings_with_options,
)

_Command = TypeVar("_Command", bound=Callable[..., Any])


class _NamedPath(click.Path):
    """A path that is not empty: an unset shell variable must not mean the current folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Convert a string to a Path."""
        if value == "":
            self.fail("the path is empty; is a variable unset? The current folder is called .", param, ctx)
        if isinstance(value, str) and (reason := path_fault(value)):
            self.fail(reason, param, ctx)
        return super().convert(value, param, ctx)


PATH = _NamedPath(path_type=Path)
"""Type of every path on the command line."""
FILE = _NamedPath(dir_okay=False, path_type=Path)
"""Type of a path that must not be a folder."""


class GroupedOption(click.Option):
    """An option that the help page shows under the heading of its group."""

    def __init__(self, *names: Any, group: str = "Run", **more: Any) -> None:
        super().__init__(*names, **more)
        self.group = group


def grouped_option(*names: str, group: str, **more: Any) -> Callable[[_Command], _Command]:
    """Add an option that the help page shows under the heading of its group."""
    return click.option(*names, cls=GroupedOption, group=group, **more)


class GroupedCommand(click.Command):
    """A command whose help page shows its options in groups, each in its order."""

    owners: tuple[type, ...] = ()
    """Classes of its settings."""

    @property
    def moved(self) -> dict[str, tuple[str, str]]:
        """Key in a settings file and value of each setting that has no option, by the option that it would be."""
        given = {option for each in self.params for option in each.opts}
        return {option: (key, value) for option, key, value in _with_keys(self.owners) if option not in given}

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments; raise UsageError if a setting is given as an option, where it has none."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            if error.option_name not in self.moved:
                raise
            key, value = self.moved[error.option_name]
            raise UsageError(
                f"{error.option_name} is no option: write --set {key}={value}, or put it into a file for --config "
                f"(bumpymap settings{ctx.command_path.removeprefix(ctx.find_root().command_path)} prints one)"
            ) from error

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; messages name its settings as it takes them."""
        moved = {key.rpartition(".")[2]: f"--set {key}" for key, _ in self.moved.values()}
        spell_settings(moved | {each.name: each.opts[0] for each in self.params if isinstance(each, click.Option)})
        return super().invoke(ctx)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options under the headings of their groups."""
        rows: dict[str, list[tuple[str, str]]] = {group: [] for group in GROUPS}
        shown = [each for each in self.params if isinstance(each, GroupedOption) and each not in COMMON_OPTIONS]
        records = [(each.group, record) for each in shown if (record := each.get_help_record(ctx))]
        width = max((len(spelled) for _, (spelled, _) in records), default=0)
        if width:
            formatter.write_paragraph()
        for group, (spelled, text) in records:
            rows[group].append((spelled.ljust(width), text))
        for group, options in rows.items():
            if options:
                formatter.write_heading(group)
                with formatter.indentation():
                    formatter.write_dl(options, col_max=24)
        common = [f"{each.opts[0]} {each.metavar or ''}".strip() for each in COMMON_OPTIONS if each in self.params]
        formatter.write_paragraph()
        formatter.write_text(f"Also {', '.join(common)}: see bumpymap --help.")


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


_PARTLY_DONE = 4
"""Exit code if inputs were skipped."""


@dataclass
class Run:
    """A command that runs: settings by where they come from, and what its results are printed for."""

    ctx: click.Context
    owners: tuple[type, ...]
    """Classes of its settings."""
    clashes: Sequence[Clash]
    """Settings that exclude each other."""
    quiet: bool
    as_json: bool
    stored: dict[str, Any]
    """Settings of the file of ``--config``."""
    assigned: dict[str, Any]
    """Settings of ``--set``; a table of the file keeps its other values."""
    given: dict[str, Any]
    """Settings that are given by options and arguments, even with an empty value."""

    @property
    def from_file(self) -> dict[str, Any]:
        """Settings of ``--config`` and of ``--set``, which override them."""
        return merge_settings(self.stored, self.assigned, self.clashes)

    @property
    def settings(self) -> dict[str, Any]:
        """All settings. Those of the command line also override settings that contradict them."""
        return merge_settings(self.from_file, self.given, self.clashes)

    def required(self, **examples: str) -> dict[str, Any]:
        """Return all settings; raise UsageError if one of these is not there, with an example of how to give it."""
        settings = self.settings
        for name, example in examples.items():
            if not settings.get(name):
                raise UsageError(f"no {name} given: add {example}, or set {name} in a file for --config")
        return settings

    def changed(self) -> dict[str, Any]:
        """Return the settings that are given, or differ from their defaults: a settings file may state those too.

        Of a setting that several classes have, the default is that of the first of ``owners``.
        """
        own = reversed(self.owners)
        defaults = {name: each.default for owner in own for name, each in declared_fields(owner).items()}
        return {name: value for name, value in self.from_file.items() if value != defaults[name]} | self.given

    def progress(self) -> AbstractContextManager[CommandProgress]:
        """Return a context with the progress to hand over to the work."""
        return show_progress(quiet=self.quiet, as_json=self.as_json)

    def show(self, record: Mapping[str, Any], lines: Iterable[str | Styled | Table]) -> None:
        """Print the result: as JSON, or in lines; nothing if the command is to be quiet."""
        if self.as_json and not self.quiet:
            print_json(record)
        elif not self.quiet:
            print_lines(lines)

    def end_partly_done(self) -> NoReturn:
        """End with the exit code of a command that left out some of its inputs."""
        self.ctx.exit(_PARTLY_DONE)


def job(
    name: str,
    *parts: type | Iterable[click.Parameter],
    owners: tuple[type, ...] | None = None,
    clashes: Sequence[Clash] = (),
) -> Callable[[Callable[..., None]], click.Command]:
    """Make a command of a function, which gets a `Run`, and its own options and arguments by their names.

    ``parts``: classes of settings, whose options are all taken; or options, such as `settings_options`
    returns; ``owners``: classes whose fields ``--config`` and ``--set`` set, and arguments of the command; default:
    those in ``parts``. Empty: the command has no such options. ``clashes``: settings that exclude each other.
    """
    known = tuple(part for part in parts if isinstance(part, type)) if owners is None else owners

    def make(function: Callable[..., None]) -> click.Command:
        taken = signature(function).parameters

        @wraps(function)
        def run(*, quiet: bool, log_json: bool, **values: Any) -> None:
            set_up_logging(as_json=log_json)
            ctx = click.get_current_context()
            file, words = values.pop("config_file", None), values.pop("assigned", ())
            stored = read_settings_file(file, *known) if file else {}
            assigned = assigned_settings(words, stored, "--set", *known)
            own = {name: values.pop(name) for name in list(values) if name not in taken}
            typed = ParameterSource.COMMANDLINE
            given = {name: value for name, value in own.items() if ctx.get_parameter_source(name) is typed}
            function(Run(ctx, known, clashes, quiet, log_json, stored, assigned, given), **values)

        command = click.command(name, cls=GroupedCommand)(run)
        command.owners = known
        declared = [settings_options(part) if isinstance(part, type) else part for part in parts]
        common = COMMON_OPTIONS if known else COMMON_OPTIONS[2:]
        command.params = [*chain.from_iterable(declared), *command.params, *common]
        return command

    return make


_HELP_OF_SET = "Any setting of `bumpymap settings`, such as pixels=21."
COMMON_OPTIONS = (
    GroupedOption(["--config", "config_file"], type=PATH, metavar="FILE", help="TOML file with settings."),
    GroupedOption(["--set", "assigned"], multiple=True, metavar="KEY=VALUE", help=_HELP_OF_SET),
    GroupedOption(["--quiet"], is_flag=True, help="Print no progress and no summary."),
    GroupedOption(["--json", "log_json"], is_flag=True, help="Print result, events and errors as JSON."),
)
"""Options of all commands; the first two of those that have settings. The help page of bumpymap lists them."""
JOBS = GroupedOption(
    ["--jobs"], type=click.IntRange(min=1), metavar="N", help="Drives at a time, each a process [one per core]."
)


def settings_options(
    owner: type,
    *names: str,
    without: Sequence[str] = (),
    required: Sequence[str] = (),
    **texts: str,
) -> list[click.Parameter]:
    """Return the options of a settings class: those named, or all that it declares.

    ``owner``: dataclass whose fields hold a `Setting`. Each option's value comes under the field's name. ``*names``:
    fields to take; ``without``: fields to leave out, which are set by ``--set`` and ``--config`` alone, as those that
    are declared rare; ``required``: those whose option must be given; ``texts``: help texts of this command, without
    the full stop, instead of those of the declaration.
    """
    return [
        _option(each, setting, texts.get(each.name, setting.help), each.name in required)
        for each, setting in settings_with_options(owner)
        if not setting.rare and each.name not in without and (not names or each.name in names)
    ]


def _option(each: Declared, setting: Setting, text: str, required: bool) -> GroupedOption:
    default = _default_text(each.default) if setting.default is None else setting.default
    shown = f"{text} [{default}]." if default and "[" not in text else f"{text}."
    more: dict[str, Any] = {"flag_value": False, "type": bool} if each.default else {"is_flag": True}
    if each.kind is not bool:
        kind, several = _click_type(each.kind)
        more = {"type": kind, "multiple": several, "required": required, "metavar": setting.metavar}
    return GroupedOption([_spelled(each, setting), each.name], help=shown, group=setting.group, **more)


def _with_keys(owners: Iterable[type], table: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield for each setting of some classes the option that it would be, its key in a settings file, and a value."""
    for owner in owners:
        for each, setting in settings_with_options(owner):
            flag = "false" if each.default else "true"
            choices = "|".join(map(str, get_args(each.kind))) if get_origin(each.kind) is Literal else flag
            yield _spelled(each, setting), table + each.name, setting.metavar or choices
        tables = [each for each in declared_fields(owner).values() if is_dataclass(each.kind)]
        for each in tables:
            yield from _with_keys([each.kind], f"{each.name}.")


def _spelled(each: Declared, setting: Setting) -> str:
    return f"--{(setting.option or each.name).replace('_', '-')}"


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
    return {int: int, float: float, Path: PATH}.get(kind), False


def merge_settings(from_file: dict[str, Any], given: dict[str, Any], clashes: Sequence[Clash]) -> dict[str, Any]:
    """Merge the settings of a file and of the command line, which also override settings that contradict them.

    Raises UsageError: settings of one source contradict each other.
    """
    refuse_clashes(from_file, clashes)
    refuse_clashes(given, clashes, option_name)
    return override_settings(from_file, given, clashes)
