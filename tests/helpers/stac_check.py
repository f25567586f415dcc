"""Validation of STAC documents by the schemas that lie beside the tests; nothing is fetched."""

import json
from functools import cache
from pathlib import Path

from jsonschema import Draft7Validator
from referencing import Registry, Resource
from referencing.jsonschema import DRAFT7

SCHEMAS = Path(__file__).resolve().parents[1] / "layers" / "stac" / "schemas"
CORE = "https://schemas.stacspec.org/v1.1.0/{0}-spec/json-schema/{0}.json"


@cache
def registry():
    """All schemas by their ids; whoever asks for another one gets an error."""
    found = []
    for path in sorted(SCHEMAS.rglob("*.json")):
        schema = json.loads(path.read_text(encoding="utf-8"))
        resource = Resource.from_contents(schema, default_specification=DRAFT7)
        found.append((schema["$id"].rstrip("#"), resource))
        if path.name == "common.json":  # its own id lacks the dot
            found.append((schema["$id"].replace("commonjson", "common.json"), resource))
    return Registry().with_resources(found)


def faults(document):
    """What is wrong with an item or a collection, by the schemas of STAC and of the extensions that it names.

    ``eo`` has one field here, names of bands, which the tests read themselves.
    """
    kind = {"Feature": "item", "Collection": "collection"}[document["type"]]
    names = [CORE.format(kind), *(name for name in document.get("stac_extensions", []) if "/eo/" not in name)]
    return [
        f"{name}: {'/'.join(map(str, error.absolute_path))}: {error.message[:300]}"
        for name in names
        for error in Draft7Validator(
            registry().contents(name), registry=registry(), format_checker=Draft7Validator.FORMAT_CHECKER
        ).iter_errors(document)
    ]
