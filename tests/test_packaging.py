"""The container and the conda package are made of what pyproject.toml names."""

import ast
import re
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement

from bumpytiles import compile_packages, native

ROOT = Path(__file__).resolve().parents[1]
CONDA = {"lazrs": "lazrs-python", "lazy-loader": "lazy_loader"}
"""Packages that have another name on conda-forge."""


@pytest.fixture(name="project", scope="module")
def project_fixture():
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


@pytest.fixture(name="recipe", scope="module")
def recipe_fixture():
    return yaml.safe_load((ROOT / ".ci" / "conda" / "recipe.yaml").read_text(encoding="utf-8"))


@pytest.fixture(name="containerfile", scope="module")
def containerfile_fixture():
    return (ROOT / "Containerfile").read_text(encoding="utf-8")


def test_the_conda_package_needs_what_the_wheel_needs(project, recipe):
    wanted = {f"python {project['project']['requires-python']}"}
    for line in project["project"]["dependencies"]:
        one = Requirement(line)
        wanted.add(f"{CONDA.get(one.name, one.name)} {one.specifier}")
        wanted |= {CONDA.get(extra, extra) for extra in one.extras}  # conda has no extras: laspy[lazrs] is two packages
    assert set(recipe["requirements"]["run"]) == wanted
    assert project["build-system"]["requires"] == [recipe["requirements"]["host"][-1].replace(" ", "")]


def test_the_container_copies_what_the_wheel_is_built_from(project, containerfile):
    copied = " ".join(re.findall(r"^COPY (?!--from)(.*) \S+$", containerfile, re.MULTILINE)).split()
    assert all((ROOT / name).exists() for name in copied)
    own = project["project"]
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    packages = [*wheel["packages"], *wheel["shared-scripts"]]
    assert {"pyproject.toml", own["readme"], *own["license-files"], ".ci/hashes.txt", ".ci/install"} <= set(copied)
    assert {package.split("/")[0] for package in packages} <= set(copied)
    assert set(project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]) <= set(copied)


def test_the_container_and_make_demo_compile_when_they_install(containerfile):
    assert 'RUN ["/opt/bumpymap/bin/bumpymap", "compile"]' in containerfile
    make = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert "bumpymap compile" in make[make.index("$(VENV)/.installed:") : make.index("touch")]


def test_all_kernels_are_compiled(monkeypatch):
    compiled = []
    monkeypatch.setattr("bumpytiles.native._compile_beside", lambda: compiled.extend(native._kernels))
    compile_packages("bumpymap", "bumpytiles")
    sources = [*(ROOT / "bumpymap").rglob("*.py"), *(ROOT / "tiles" / "bumpytiles").rglob("*.py")]
    assert sorted(name.rpartition(".")[2] for name in compiled if name.startswith("bumpy")) == sorted(
        path.stem for path in sources if _decorated(path)
    )
    assert len(compiled) > 10


def _decorated(path):
    """Whether a file has functions under ``@kernel``."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    return any(ast.unparse(one) == "kernel" for node in functions for one in node.decorator_list)
