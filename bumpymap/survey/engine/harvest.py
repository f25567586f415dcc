"""What comes back from the workers that read: kept by file, until a file is whole and found sound.

A sound file is noted on disk, so that a run that goes on does not read it again. A bad one is forgotten as a whole.
"""

import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core import BadInputError, atomic, parse_json
from bumpymap.readers import PointStats, SurveyReader, Version, changed
from bumpymap.survey.engine.catalogue import Catalogue
from bumpymap.survey.engine.parts import Part
from bumpymap.survey.engine.tasks import PartRead
from bumpymap.survey.engine.workspace import Workspace
from bumpytiles import Pack

__all__ = ["Adoption", "Harvest"]

_RECORDS = "cluster-files"


class Harvest:
    """Takes the results of parts; see the module.

    Parameters
    ----------
    readers : sequence of SurveyReader
    parts : sequence of Part
    space : Workspace
    points : Path
        Folder of packs of points, with a folder for each attempt.
    kinds : sequence of str
        Of `Job`.
    refuse : callable
        Told of a bad file; raises, or notes that it is skipped.
    may_skip : bool
        Whether ``refuse`` may return.
    """

    def __init__(
        self,
        readers: Sequence[SurveyReader],
        parts: Sequence[Part],
        space: Workspace,
        points: Path,
        kinds: Sequence[str],
        refuse: Callable[[SurveyReader, BadInputError], None],
        *,
        may_skip: bool,
    ) -> None:
        self._readers, self._parts, self._space, self._points, self._kinds = readers, parts, space, points, kinds
        self._refuse, self._may_skip = refuse, may_skip
        self.catalogue = Catalogue()
        """Of the points that wait."""
        self.tallies = [PointStats() for _ in readers]
        self.flagged = False
        """Whether any point of a sound file is ground."""
        self.early: list[Pack] = []
        """Packs of the first of ``kinds`` with blocks that are finished."""
        self.skipped: set[int] = set()
        self._left = np.bincount([part.file for part in parts], minlength=len(readers))
        self._held: dict[int, dict[int, PartRead]] = {}
        self._bad: dict[int, BadInputError] = {}
        self._sound: set[int] = set()
        self._records = space.scratch / _RECORDS
        self._records.mkdir(parents=True, exist_ok=True)
        self._take_up()
        self._adoption = Adoption(space, [f"{kind}-early" for kind in kinds])

    def wanted(self, number: int) -> bool:
        """Whether a part is still to be read."""
        return self._parts[number].file not in self._sound

    def take(self, number: int, read: PartRead) -> None:
        """Take the result of a part.

        Raises
        ------
        BadInputError
            The file is bad and may not be skipped.
        """
        file = self._parts[number].file
        held = self._held.setdefault(file, {})
        held[number] = read
        self._left[file] -= 1
        if read.error is not None and not self._may_skip:
            self._refuse(self._readers[file], read.error)
        if not self._left[file]:
            self._judge(file, [held[place] for place in sorted(held)])
            del self._held[file]

    def close(self) -> None:
        """Skip the bad files, in their order: all parts are read."""
        for file in sorted(self._bad):
            self._refuse(self._readers[file], self._bad[file])
            self.skipped.add(file)

    def _judge(self, file: int, reads: Sequence[PartRead]) -> None:
        tally = PointStats()
        for read in reads:
            tally = tally.merge(read.tally)
        try:
            for read in reads:
                if read.error is not None:
                    raise read.error
            self._refuse_versions(file, reads)
            self._readers[file].judge(tally)
        except BadInputError as error:
            self._bad[file] = error
            if not self._may_skip:
                self._refuse(self._readers[file], error)
            return
        numbers = [number for read in reads for number in self._adoption.take(read.tiles)]
        packs = [
            [str(path.relative_to(self._points)), blocks.tolist()] for read in reads for path, blocks in read.packs
        ]
        flagged = any(read.flagged for read in reads)
        record = {"tally": tally.to_record(), "flagged": flagged, "packs": packs, "early": numbers}
        with atomic(self._records / f"{file}.json") as temporary:
            temporary.write_text(json.dumps(record), encoding="utf-8")
        self._keep(file, record)

    def _refuse_versions(self, file: int, reads: Sequence[PartRead]) -> None:
        """Refuse parts of several versions; copies on several machines may differ in the time of their writing."""
        seen: dict[str, Version | None] = {}
        for host, version in (read.seen for read in reads if read.seen is not None):
            if seen.setdefault(host, version) != version:
                raise changed(self._readers[file].info.path, f"workers on {host} saw several versions of it")

    def _keep(self, file: int, record: dict[str, Any]) -> None:
        self._sound.add(file)
        self.tallies[file] = PointStats.from_record(record["tally"])
        self.flagged |= record["flagged"]
        for path, blocks in record["packs"]:
            self.catalogue.add(self._points / path, np.array(blocks, np.int64))
        self.early += [Pack(_name(self._space, f"{self._kinds[0]}-early", number)) for number in record["early"]]

    def _take_up(self) -> None:
        """Take up the files that an earlier run found sound; forget what it had finished of others."""
        records = {int(path.stem): parse_json(path.read_text("utf-8")) for path in self._records.glob("[0-9]*.json")}
        records = {file: record for file, record in records.items() if self._is_whole(record)}
        known = {number for record in records.values() for number in record["early"]}
        for path in self._space.tiles("*-early"):
            if int(path.stem[-6:]) not in known:
                path.unlink()
        attempts = {Path(path).parts[0] for record in records.values() for path, _ in record["packs"]}
        for folder in self._points.iterdir():
            if folder.is_dir() and folder.name not in attempts:
                shutil.rmtree(folder, ignore_errors=True)
        for file, record in sorted(records.items()):
            self._keep(file, record)

    def _is_whole(self, record: Mapping[str, Any]) -> bool:
        early = [
            _name(self._space, f"{kind}-early", number).exists() for kind in self._kinds for number in record["early"]
        ]
        return all(early) and all((self._points / path).exists() for path, _ in record["packs"])


class Adoption:
    """Gives packs of finished tiles the names under which they count.

    Parameters
    ----------
    space : Workspace
    kinds : sequence of str
        Of `TileSink`.
    """

    def __init__(self, space: Workspace, kinds: Sequence[str]) -> None:
        self._space, self._kinds = space, kinds
        taken = (int(path.stem[-6:]) for kind in kinds for path in space.tiles(kind))
        self._next = 1 + max(taken, default=-1)

    def take(self, packs: Sequence[Sequence[Path]]) -> list[int]:
        """Take, for each kind, as many packs as for any other; gives the numbers in their new names."""
        first = self._next
        for alike in zip(*packs, strict=True):
            for kind, path in zip(self._kinds, alike, strict=True):
                os.replace(path, _name(self._space, kind, self._next))  # noqa: PTH105 (the name says that it replaces)
            self._next += 1
        return list(range(first, self._next))


def _name(space: Workspace, kind: str, number: int) -> Path:
    return space.folder / f"tiles-{kind}-{number:06d}.pack"
