"""The house's rules, held by reading the source: who imports what, names, signatures; and what an install brings."""

import ast
import csv
import importlib.util
import re
import subprocess
import sys
import tokenize
import tomllib
from collections import defaultdict
from functools import cache
from importlib.metadata import distributions
from itertools import pairwise
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name
from small_surveys import write_survey

ROOT = Path(__file__).resolve().parents[1]
ROOMS = {
    # room: (other rooms, packages of others that only some rooms may import)
    "core": (set(), {"blake3", "numpy", "onnxruntime", "pyproj", "rasterio", "scipy"}),
    "readers": ({"core"}, {"lazrs", "numpy", "pyarrow", "pypcd4", "pyproj", "pyulog", "rasterio", "rosbags", "scipy"}),
    "patches": ({"core"}, {"CSF", "numpy"}),
    "rating": ({"core"}, {"numpy", "scipy"}),
    "layers": (
        {"core"},
        {*("laspy", "lazrs", "numpy", "pyarrow", "pyogrio", "pyproj", "rasterio", "shapely"), *("skimage", "xarray")},
    ),
    "views": ({"core", "layers"}, {"PIL", "jinja2", "numpy", "open3d", "pyproj", "rosbags", "scipy", "shapely"}),
    "survey": ({"core", "readers", "patches", "rating", "layers", "views"}, {"numpy"}),
    "scan": (
        {"core", "readers", "patches", "rating", "layers", "views"},
        {"numpy", "pyproj", "scipy", "skimage", "small_gicp"},
    ),
    "route": ({"core", "rating", "layers", "views"}, {"numpy", "scipy", "skimage"}),
    "change": ({"core", "layers", "views"}, {"numpy", "scipy"}),
    "check": ({"core", "rating", "readers", "layers", "route", "views"}, {"numpy", "pyproj", "scipy"}),
    "lab": ({"core", "readers", "patches", "rating", "scan"}, {"dartpy", "numpy", "onnx", "scipy", "sklearn", "torch"}),
    "cli": (
        {"core", "readers", "rating", "layers", "views", "survey", "scan", "route", "change", "check", "lab"},
        {"click", "rich"},
    ),
}
ABOVE = {
    "__init__.py": (set(), set()),
    "__main__.py": ({"cli"}, set()),
    "api.py": ({"core", "layers", "route", "survey", "views"}, {"geopandas", "xarray"}),
}
"""What stands above the rooms: what it may import, likewise."""
ENGINE = {"dask", "distributed", "numpy"}
"""What bumpytiles may import."""
GUARDED = set().union(*(packages for _, packages in ROOMS.values())) | ENGINE | {"geopandas", "pandas", "xarray"}
ONE_PLACE = {
    "blake3": {"bumpymap/core/run_folder.py"},
    "jinja2": {"bumpymap/views/page/page.py"},
    "onnxruntime": {"bumpymap/core/onnx_file.py"},
    "distributed": {"tiles/bumpytiles/_dask.py"},
}
"""The only files that import a package."""


def files_of(room):
    folder = ROOT / "tiles" / "bumpytiles" if room == "bumpytiles" else ROOT / "bumpymap" / room
    return sorted(folder.rglob("*.py"))


SOURCES = {
    **{path: path.relative_to(ROOT) for path in (ROOT / "bumpymap").rglob("*.py")},
    **{path: path.relative_to(ROOT / "tiles") for path in (ROOT / "tiles" / "bumpytiles").rglob("*.py")},
}
MODULES = {".".join(short.with_suffix("").parts).removesuffix(".__init__"): path for path, short in SOURCES.items()}


@cache
def tree_of(file):
    return ast.parse(file.read_text(encoding="utf-8"))


@cache
def imported(file):
    """(module, name) pairs that a file imports, anywhere in it; name None for ``import module``."""
    found = []
    for node in ast.walk(tree_of(file)):
        if isinstance(node, ast.Import):
            found += [(alias.name, None) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: relative import"
            found += [(node.module, alias.name) for alias in node.names]
    return found


def room_of(module):
    """Room of a module of ours; the package itself for what stands outside of rooms."""
    parts = module.split(".")
    return parts[1] if parts[0] == "bumpymap" and len(parts) > 1 else parts[0]


def crossings(file, room):
    """(room, module) of every import that leaves a room."""
    for module, name in imported(file):
        if module.split(".")[0] in {"bumpymap", "bumpytiles"}:
            whole = f"{module}.{name}" if f"{module}.{name}" in MODULES else module
            if room_of(whole) != room and not whole.endswith("._loops_base"):
                yield room_of(whole), whole


def test_every_room_has_a_row():
    assert {path.parent.name for path in (ROOT / "bumpymap").glob("*/__init__.py")} == set(ROOMS)
    assert {path.name for path in (ROOT / "bumpymap").glob("*.py")} == set(ABOVE)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_what_its_row_says_and_its_row_says_no_more(room):
    rooms, packages = ROOMS[room]
    used = {other for file in files_of(room) for other, _ in crossings(file, room)}
    assert used - {"bumpytiles"} == rooms
    heavy = {module.split(".")[0] for file in files_of(room) for module, _ in imported(file)} & GUARDED
    assert heavy == packages


@pytest.mark.parametrize("name", ABOVE)
def test_what_stands_above_the_rooms_imports_what_its_row_says_and_its_row_says_no_more(name):
    file, (rooms, packages) = ROOT / "bumpymap" / name, ABOVE[name]
    crossed = list(crossings(file, "bumpymap"))
    assert {room for room, _ in crossed} == rooms
    assert {whole for _, whole in crossed} == {f"bumpymap.{room}" for room in rooms}
    assert {module.split(".")[0] for module, _ in imported(file)} & GUARDED == packages


def test_the_engine_does_not_know_bumpymap():
    for file in files_of("bumpytiles"):
        tops = {module.split(".")[0] for module, _ in imported(file)}
        assert "bumpymap" not in tops
        assert not (tops & GUARDED) - ENGINE


def test_imports_go_through_the_door_of_a_room():
    for room in [*ROOMS, "bumpytiles"]:
        for file in files_of(room):
            for other, whole in crossings(file, room):
                door = "bumpytiles" if other == "bumpytiles" else f"bumpymap.{other}"
                assert whole == door, f"{file}: import from {door}, not {whole}"


def test_a_door_names_what_there_is():
    """The stubs beside the lazy ``__init__.py``: a name that has gone fails only where it is used."""
    for stub in (ROOT / "bumpymap").rglob("__init__.pyi"):
        package = ".".join(stub.parent.relative_to(ROOT).parts)
        for node in ast.walk(ast.parse(stub.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                module = f"{package}.{node.module}"
                assert module in MODULES, f"{stub}: there is no {module}"
                source = MODULES[module].with_suffix(".pyi" if MODULES[module].name == "__init__.py" else ".py")
                text = source.read_text(encoding="utf-8")
                for alias in node.names:
                    assert re.search(rf"\b{alias.name}\b", text), f"{stub}: {module} has no {alias.name}"


def test_no_two_files_import_each_other():
    """Neither two nor a longer circle."""
    assert not circles(arrows())


def test_no_two_parts_of_a_room_import_each_other():
    """Neither two nor a longer circle of modules and folders in it; lab's settings take defaults of its simulate."""
    for room in set(ROOMS) - {"lab"}:
        parts = defaultdict(set)
        for module, others in arrows().items():
            if module.startswith(f"bumpymap.{room}."):
                part = module.split(".")[2]
                parts[part] |= {m.split(".")[2] for m in others if m.startswith(f"bumpymap.{room}.")} - {part}
        assert not circles(parts), room


@cache
def arrows():
    """Modules that each module of ours imports."""
    return {
        module: {f"{m}.{n}" if f"{m}.{n}" in MODULES else m for m, n in imported(file)} & set(MODULES)
        for module, file in MODULES.items()
    }


def circles(ways):
    """What is left when, again and again, all that imports nothing of the rest is taken away."""
    while ready := {module for module, others in ways.items() if not others - {module}}:
        ways = {module: others - ready for module, others in ways.items() if module not in ready}
    return ways


@pytest.mark.parametrize("package", ONE_PLACE)
def test_one_file_imports_a_package_that_needs_care(package):
    """ONNX Runtime: telemetry off first. Dask: the seam."""
    importing = {
        str(file.relative_to(ROOT))
        for folder in ("bumpymap", "tiles", "docs")
        for file in (ROOT / folder).rglob("*.py")
        if package in {module.split(".")[0] for module, _ in imported(file)}
    }
    assert importing == ONE_PLACE[package]


def test_json_of_others_is_parsed_to_a_bounded_depth():
    for file, short in SOURCES.items():
        if short.parts[0] == "bumpymap" and short != Path("bumpymap/core/files.py"):
            calls = [node for node in ast.walk(tree_of(file)) if isinstance(node, ast.Call)]
            own = [node for node in calls if ast.unparse(node.func) in {"json.loads", "json.load"}]
            foreign = [node for node in own if not ast.unparse(node.args[0]).startswith("json.dumps")]
            assert not foreign, f"{file}: use parse_json"


def test_a_class_name_is_used_once():
    places = defaultdict(set)
    for file in SOURCES:
        for node in ast.walk(tree_of(file)):
            if isinstance(node, ast.ClassDef):
                places[node.name].add(str(file.relative_to(ROOT)))
    assert not {name: found for name, found in places.items() if len(found) > 1}


def docstrings(tree):
    """Strings that stand alone: of modules, classes, functions and values."""
    for node in ast.walk(tree):
        for child in getattr(node, "body", None) or () if not isinstance(node, ast.Lambda | ast.IfExp) else ():
            if (
                isinstance(child, ast.Expr)
                and isinstance(child.value, ast.Constant)
                and isinstance(child.value.value, str)
            ):
                yield child.value.value


def test_docstrings_say_what_a_thing_is():
    """They begin with a noun or a verb, not with What, Which or Whether."""
    texts = [text for room in ROOMS for file in files_of(room) for text in docstrings(tree_of(file))]
    assert texts
    assert not [text for text in texts if re.match(r"(What|Which|Whether)\b", text)]
    sources = [path for part in ("bumpymap", "tiles") for path in (ROOT / part).rglob("*.[ch]pp")]
    for path in sources:
        lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines()]
        first = [line for before, line in pairwise(["", *lines]) if not before.startswith("//")]
        assert not [line for line in first if re.match(r"// (What|Which|Whether)\b", line)], path
    assert sources


HOUSE_WORDS = re.compile(r"\b(things?|so many|(what|whatever) stands|told|in relief|at hand)\b", re.IGNORECASE)
"""The worst of the words that the table in CONTRIBUTING.md replaces."""
IN_PLAIN_WORDS = {
    "pages": [ROOT / "README.md", ROOT / "SECURITY.md", *(ROOT / "docs" / "pages").glob("*.md")],
    **{
        folder: [path for suffix in ("py", "cpp", "hpp") for path in (ROOT / folder).rglob(f"*.{suffix}")]
        for folder in ("bumpymap", "tiles/bumpytiles")
    },
}
"""Files whose text, docstrings, comments and messages have none of them."""


def prose(path):
    """Texts of a page, the strings and comments of a module, without code in them; all of C++."""
    if path.suffix != ".py":
        text = path.read_text(encoding="utf-8")
        yield re.sub(r"(?ms)^ *```.*?^ *```", "", text) if path.suffix == ".md" else re.sub(r"(?m)^ *//", "", text)
        return
    with tokenize.open(path) as file:
        for token in tokenize.generate_tokens(file.readline):
            if tokenize.tok_name[token.type] in {"COMMENT", "STRING", "FSTRING_MIDDLE"}:
                yield token.string.lstrip("# ")


@pytest.mark.parametrize("place", IN_PLAIN_WORDS)
def test_words_are_those_of_the_field(place):
    assert IN_PLAIN_WORDS[place]
    for path in IN_PLAIN_WORDS[place]:
        text = " ".join(re.sub(r"`+[^`]+`+", "", " ".join(prose(path))).split())
        assert not HOUSE_WORDS.findall(text), f"{path.relative_to(ROOT)}: see the table in CONTRIBUTING.md"


def _is_number(value):
    if isinstance(value, ast.Constant):
        return type(value.value) in (int, float)
    if isinstance(value, ast.Tuple):
        return bool(value.elts) and all(map(_is_number, value.elts))
    parts = {ast.UnaryOp: ("operand",), ast.BinOp: ("left", "right")}.get(type(value), ())
    return bool(parts) and all(_is_number(getattr(value, part)) for part in parts)


def test_numbers_have_words():
    """Under a number at module level, or a tuple of them, stands what it is; else behind it on its line."""
    bare = []
    for path in SOURCES:
        lines, body = path.read_text(encoding="utf-8").splitlines(), tree_of(path).body
        for node, after in zip(body, [*body[1:], None], strict=True):
            if not (isinstance(node, ast.Assign | ast.AnnAssign) and node.value and _is_number(node.value)):
                continue
            target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
            has_words = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            if not has_words and "#" not in lines[node.end_lineno - 1] and not isinstance(target, ast.Attribute):
                bare.append(f"{path.relative_to(ROOT)}: {ast.unparse(target)}")
    assert bare == []


def test_no_function_takes_more_than_eight_parameters():
    longer = {}
    for file in SOURCES:
        for node in ast.walk(tree_of(file)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                arguments = node.args
                count = len(arguments.posonlyargs + arguments.args + arguments.kwonlyargs)
                if count + bool(arguments.vararg) + bool(arguments.kwarg) > 8:
                    longer[f"{file.relative_to(ROOT)}: {node.name}"] = count
    assert not longer


def loaded_by(code, *arguments):
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


@pytest.mark.parametrize(
    ("modules", "heavy"),
    [
        ("bumpymap", GUARDED),
        ("bumpymap.survey.pipeline, bumpymap.cli.map_command", {"torch", "dask", "dartpy", "sklearn", "pandas"}),
    ],
)
def test_the_package_is_light_and_the_main_job_loads_no_workshop(modules, heavy):
    assert not (heavy | {"geopandas", "matplotlib"}) & loaded_by(f"import {modules}, sys; print(*sys.modules)")


def test_no_help_loads_anything_heavy():
    code = (
        "import sys\nfrom bumpymap.cli import _COMMANDS, main\n"
        "for name in _COMMANDS:\n    main([name, '--help'], standalone_mode=False)\n"
        "print(*(f'module:{name}' for name in sys.modules))"
    )
    loaded = {word.removeprefix("module:") for word in loaded_by(code) if word.startswith("module:")}
    assert "bumpymap.lab.settings" in loaded
    assert GUARDED & loaded <= {"blake3", "click"}


def test_a_run_does_not_load_pandas(tmp_path):
    survey = write_survey(tmp_path / "site.laz")
    code = "import sys; from bumpymap.cli import main; main(standalone_mode=False); print(*sys.modules)"
    # pyarrow looks for pandas when a thread makes the first table before the one that hides it is done: rare, harmless.
    runs = (loaded_by(code, "map", str(survey), "--out", str(tmp_path / name)) for name in "abc")
    loaded = next((names for names in runs if "pandas" not in names), {"pandas"})
    assert {"pyarrow", "pyogrio"} <= loaded
    assert not {"pandas", "geopandas"} & loaded


CI = ROOT / ".ci"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
CONDA = {"lazrs": "lazrs-python", "lazy-loader": "lazy_loader"}
"""Packages that have another name on conda-forge."""


def test_the_conda_package_needs_what_the_wheel_needs():
    recipe = yaml.safe_load((CI / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
    wanted = {f"python {PROJECT['project']['requires-python']}"}
    for line in PROJECT["project"]["dependencies"]:
        one = Requirement(line)
        wanted.add(f"{CONDA.get(one.name, one.name)} {one.specifier}")
        wanted |= {CONDA.get(extra, extra) for extra in one.extras}  # conda has no extras: laspy[lazrs] is two packages
    assert set(recipe["requirements"]["run"]) == wanted
    assert PROJECT["build-system"]["requires"] == [
        line.replace(" ", "") for line in recipe["requirements"]["host"][-2:]
    ]


def test_the_container_copies_what_the_wheel_is_built_from():
    containerfile = (ROOT / "Containerfile").read_text(encoding="utf-8")
    copied = " ".join(re.findall(r"^COPY (?!--from)(.*) \S+$", containerfile, re.MULTILINE)).split()
    assert all((ROOT / name).exists() for name in copied)
    own = PROJECT["project"]
    wheel = PROJECT["tool"]["scikit-build"]["wheel"]
    assert {"pyproject.toml", own["readme"], *own["license-files"], ".ci/hashes.txt", ".ci/install"} <= set(copied)
    assert {package.split("/")[0] for package in wheel["packages"]} <= set(copied)
    sample = re.search(r"sample_data/\S+\.laz", (ROOT / "tiles" / "CMakeLists.txt").read_text(encoding="utf-8"))
    assert sample[0] in copied


# --- the pinned versions install on every Python that the package names, and every file is held against its hash ---
def lines_of(file):
    return [line for line in (CI / file).read_text(encoding="utf-8").splitlines() if not line.startswith("#")]


def pins(file):
    return dict(line.split(" ")[0].split("==") for line in lines_of(file))


def test_no_pin_wants_a_newer_python_than_the_package():
    pinned = {canonicalize_name(name): version for name, version in pins("constraints.txt").items()}
    held = {
        one.name: one.metadata.get("Requires-Python")
        for one in distributions()
        if pinned.get(canonicalize_name(one.name)) == one.version.partition("+")[0]
    }
    assert len(held) > 20
    assert {name: wants for name, wants in held.items() if wants and not SpecifierSet(wants).contains("3.11.0")} == {}


def test_every_pin_has_hashes_that_are_required_and_no_index_is_named():
    for file, held in ((CI / "install", "$here/hashes.txt"), (ROOT / "Makefile", ".ci/hashes.txt")):
        assert f"--require-hashes --constraint {held}" in file.read_text(encoding="utf-8")
    assert pins("hashes.txt") == pins("constraints.txt")
    hashed = r"\S+==\S+( --hash=sha256:[0-9a-f]{64})+"
    assert [line for line in lines_of("hashes.txt") if not re.fullmatch(hashed, line)] == []


# --- what an install brings is under licences that go with Apache-2.0, and the page lists it ---
_SPEC = importlib.util.spec_from_file_location("list_licences", ROOT / "docs" / "licences" / "list_licences.py")
licences = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(licences)


@pytest.mark.slow
@pytest.mark.parametrize("extra", ["default", *licences.extras()])
def test_every_package_says_a_licence_that_goes_with_ours(extra):
    found = licences.needed([] if extra == "default" else [extra])
    assert found
    known = {name: licence for name, licence in found.items() if licence is not None}
    assert {name: licence.said for name, licence in known.items() if not licence.families} == {}
    assert {name: licence.said for name, licence in known.items() if licence.refused} == {}
    missing = set(found) - set(known)
    if missing:
        pytest.skip(f"the licences of all others are fine; not installed here: {', '.join(sorted(missing))}")


@pytest.mark.slow
def test_the_page_lists_every_package_with_a_licence_that_it_has_and_nothing_else():
    with licences.TABLE.open(encoding="utf-8", newline="") as file:
        rows = {row["package"]: set(row["licence"].split(", ")) for row in csv.DictReader(file)}
    for extra in ([], *([name] for name in licences.extras())):
        for name, licence in licences.needed(extra).items():
            assert name in rows, f"run: python docs/licences/list_licences.py --write ({name} is not listed)"
            assert licence is None or rows[name] & set(licence.families), f"{name} is under {licence.said}"
    assert set(rows) <= {canonicalize_name(name) for name in pins("constraints.txt")}


@pytest.mark.parametrize(
    ("expression", "classifier", "text", "families", "refused"),
    [
        ("", "License :: OSI Approved :: GNU General Public License v3 or later (GPLv3+)", "", ("GPL",), True),
        ("GPL-3.0-or-later", "", "MIT", ("GPL",), True),
        ("LGPL-2.1-or-later", "", "", ("LGPL",), True),
        ("", "", "GNU GENERAL PUBLIC LICENSE\n Version 3", ("GPL",), True),
        ("MIT AND GPL-2.0-only", "", "", ("GPL", "MIT"), True),
        ("MIT OR GPL-2.0-only", "", "", ("MIT",), False),
        ("LGPL-3.0-only OR GPL-2.0-only", "", "", ("LGPL", "GPL"), True),
        ("Apache-2.0 WITH LLVM-exception", "", "", ("Apache-2.0",), False),
        ("", "License :: OSI Approved :: MIT License", "GPL", ("MIT",), False),
        ("", "License :: OSI Approved", "BSD 3-Clause License\n\nCopyright", ("BSD",), False),
        ("", "", "", (), False),
        ("", "", "Permission is granted to limited users", (), False),
    ],
)
def test_what_a_package_says_is_understood(expression, classifier, text, families, refused):
    found = licences.licence_of({"License-Expression": expression, "License": text}, [classifier])
    assert (found.families, found.refused) == (families, refused)
