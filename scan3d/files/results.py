"""The files of a run: they appear together, and the report names the SHA-256 of each of the others."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scan3d.files.atomic import folder, in_a_sentence
from scan3d.files.journal import Work, digest, sweep, work_in
from scan3d.files.ownership import RECORDING, SCAN, Inputs, Kind, check_result, unchanged
from scan3d.files.text import to_json


@dataclass(frozen=True)
class Result:
    """The result of a run that is being written into a folder."""

    folder: Path
    work: Work
    inputs: Inputs
    option: str
    kind: Kind = SCAN

    def put(self, name: str, data: bytes) -> None:
        """Add a file to the result; it appears in the folder with all others."""
        with in_a_sentence(self.folder / name, self.option):
            self.work.put(name, data)

    def commit(self, report: Mapping[str, Any]) -> dict[str, Any]:
        """Let the result appear, with the report, which is returned with its sections `files` and `sha256`.

        Files of the result before that this one does not have are removed: those that are as the program wrote them, and are
        not read by this run.
        """
        with in_a_sentence(self.folder, self.option):
            report_name = self.kind.report
            earlier = unchanged(self.folder, self.kind)
            kept = self._kept()
            data = {
                **report,
                "files": [*(name for name in kept if name in earlier), *self.work.sha256, report_name],
                "sha256": {**kept, **self.work.sha256},
            }
            obsolete = {
                name: earlier[name] for name in earlier.keys() - self.work.sha256.keys() - kept.keys() - {report_name}
            }
            self.work.put(report_name, to_json(data))
            self.work.commit({name: sha256 for name, sha256 in obsolete.items() if not self._is_input(name)})
        return data

    def _kept(self) -> dict[str, str]:
        """The recording in the folder with its SHA-256, if it is the one that this run has read."""
        if self.work.sha256.keys() & set(RECORDING) or not all(self._is_input(name) for name in RECORDING):
            return {}
        return {name: digest(self.folder / name) for name in RECORDING}

    def _is_input(self, name: str) -> bool:
        path = self.folder / name
        sources = [Path(source) for source in self.inputs.values() if source is not None]
        return path.exists() and any(source.exists() and os.path.samefile(path, source) for source in sources)


@contextmanager
def opened(
    path: str | Path,
    *,
    with_recording: bool,
    inputs: Inputs | None = None,
    overwrite: bool = False,
    option: str = "--out",
    kind: Kind = SCAN,
) -> Iterator[Result]:
    """A result to be written into a folder, which is created if it is missing.

    with_recording
        whether the result has a recording.
    inputs
        what the run reads, which is not overwritten.
    overwrite
        whether files that the program did not write may be replaced.
    kind
        what is written: the results of a scan, or those of a batch.

    Raises InputError if the folder can't be written into, if another run is writing there, and if a file would be replaced that
    must not be.
    """
    names = (*(RECORDING if with_recording else ()), *kind.results)
    with folder(path, option) as place, ExitStack() as stack:
        with in_a_sentence(place, option):
            work = stack.enter_context(work_in(place))
            sweep(place)
        check_result(place, names, inputs or {}, overwrite, option, kind)
        yield Result(place, work, inputs or {}, option, kind)
