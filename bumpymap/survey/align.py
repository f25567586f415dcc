"""Taking steps between flight lines off before a survey is mapped: ``align="on"``."""

from dataclasses import replace

from bumpymap.core import BadInputError, MapConfig, Progress, Stopwatch
from bumpymap.readers import LineSums, ReadOptions, file_changed, reopen_survey
from bumpymap.survey.flight_lines import FlightLines, compare_lines
from bumpymap.survey.inputs import SurveyInputs, read_options

__all__ = ["AlignedInputs"]


class AlignedInputs:
    """The inputs of a run, with the corrections of their flight lines.

    Parameters
    ----------
    inputs : SurveyInputs
    options : ReadOptions
        The settings that these were opened with.
    before : FlightLines or None
        The lines before any correction, with what is taken off; None without ``align="on"``.
    """

    def __init__(self, inputs: SurveyInputs, options: ReadOptions, before: FlightLines | None) -> None:
        self.inputs, self.options, self._before = inputs, options, before

    @classmethod
    def of(cls, config: MapConfig, inputs: SurveyInputs, progress: Progress, clock: Stopwatch) -> "AlignedInputs":
        """Read all points once more if the settings ask for it, and open the files again with what is to be taken off.

        Raises
        ------
        BadInputError
            A file is bad and may not be skipped, or has changed.
        """
        options = read_options(config)
        if config.align != "on":
            return cls(inputs, options, None)
        with clock.stage("align"):
            found, adjustment = compare_lines(_sums(inputs, progress), adjust=True)
        found = replace(found, corrections=adjustment.corrections)
        if not found.corrections:
            return cls(inputs, options, found)
        options = replace(options, corrections=found.corrections)
        readers = [reopen_survey(reader.info.path, options) for reader in inputs.readers]
        for old, new in zip(inputs.readers, readers, strict=True):
            if old.info.version != new.info.version:
                raise file_changed(old.info.path, "it was written again after its flight lines were compared")
        return cls(replace(inputs, readers=readers), options, found)

    def outcome(self, sums: LineSums) -> FlightLines:
        """Return the lines as they are in the layers, by the sums of the points that were mapped."""
        before = self._before
        if before is None:
            return compare_lines(sums)[0]
        pairs = compare_lines(sums)[0].pairs if before.corrections else before.pairs
        return replace(before, pairs=pairs, before=before.pairs)


def _sums(inputs: SurveyInputs, progress: Progress) -> LineSums:
    """Return the sums of all files; a bad file that may be skipped has none here, and is skipped when it is mapped."""
    progress.start("comparing flight lines", sum(reader.info.point_count for reader in inputs.readers))
    sums = LineSums()
    for reader in inputs.readers:
        try:
            for cloud in reader.clouds():
                progress.advance(cloud.easting.size)
        except BadInputError:
            if not inputs.skip_bad:
                raise
            continue
        sums = sums.merge(reader.lines)
    return sums
