"""Write XML that QGIS reads, with the same bytes for the same content."""

import re
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree as ET

from bumpymap.core import atomic

__all__ = ["QGIS_VERSION", "add", "write_qgis"]

QGIS_VERSION = "3.22.0"
"""The version of QGIS whose form the files have; newer ones read it too."""
_DOCTYPE = b"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def add(
    parent: ET.Element, tag: str, attributes: Mapping[str, str] | None = None, text: str | None = None
) -> ET.Element:
    """Append an element to another one and return it."""
    element = ET.SubElement(parent, tag, dict(attributes or {}))
    element.text = text
    return element


def write_qgis(root: ET.Element, path: Path) -> None:
    """Write a style or a project, whole or not at all.

    What XML cannot hold (control characters, bytes that are not UTF-8), as in the name of a CRS, becomes U+FFFD.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    ET.indent(root, " ")
    text = _NOT_XML.sub("\ufffd", ET.tostring(root, encoding="unicode"))
    with atomic(path) as temporary:
        temporary.write_bytes(_DOCTYPE + text.encode() + b"\n")
