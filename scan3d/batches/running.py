"""The runs of a batch, given to an executor, with a second attempt for those whose worker is lost."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import NamedTuple

from scan3d.batches.runs import Outcome, Run, perform
from scan3d.errors import InputError
from scan3d.files.whole import REPORT, clean
from scan3d.workers import Workers

# A run whose worker is lost is tried so many times: the worker may have been ended for another reason, but a run that ends
# every worker must not be tried for ever.
_ATTEMPTS = 2
# Seconds for which results of another machine are awaited in a shared folder.  Network file systems show new files after
# seconds; longer, a batch whose folder is not shared is slow to say so.
_PATIENCE_S = 30.0
# Seconds after which the progress is shown again, so that the time left counts down.
_SHOWN_EVERY_S = 1.0
# Seconds between two looks for finished runs.  Longer, workers are idle between short runs; shorter, looking takes time.
_LOOK_EVERY_S = 0.02


class BatchProgress(NamedTuple):
    """How far a batch is."""

    done: int
    """Runs that are finished, those of earlier calls and failures included."""
    total: int
    failed: int
    seconds_left: float | None
    """Estimated by the runs of this call; None before the first of them is finished."""


Report = Callable[[BatchProgress], None]


def outcomes(runs: Sequence[Run], executor: Executor | None, total: int, report: Report) -> list[Outcome]:
    """What becomes of each run, in their order; without an executor they are made here, one after the other.

    `total` is the number of all runs of the batch, with those that are done already.
    """
    watch = _Watch(len(runs), total, report)
    if executor is None:
        found = []
        for run in runs:
            found.append(perform(run))
            watch.count(found[-1])
        return found
    collected: dict[int, Outcome] = {}
    with ExitStack() as stack:
        pending: dict[Future[Outcome], tuple[int, int]] = {}
        try:
            _collect(runs, executor, stack, pending, collected, watch)
        except BaseException:
            for future in pending:
                future.cancel()
            if isinstance(executor, Workers):
                executor.kill()
                executor.shutdown(cancel_futures=True)  # when it returns, the processes have ended
                _tidy(runs[number] for number, _ in pending.values())
            raise
    return [collected[number] for number in range(len(runs))]


def _collect(
    runs: Sequence[Run],
    executor: Executor,
    stack: ExitStack,
    pending: dict[Future[Outcome], tuple[int, int]],
    collected: dict[int, Outcome],
    watch: _Watch,
) -> None:
    """Submit the runs and wait for all of them; `pending` has the number and the attempt of each that is not finished."""
    attempts = [(number, 1) for number in range(len(runs))]
    while attempts or pending:
        for number, attempt in attempts:
            try:
                pending[executor.submit(perform, runs[number], attempt)] = number, attempt
            except BrokenExecutor:
                # what it had begun is gone on with in workers that do not concern each other
                executor = stack.enter_context(Workers(getattr(executor, "_max_workers", 1)))
                pending[executor.submit(perform, runs[number], attempt)] = number, attempt
            except (RuntimeError, OSError) as error:
                collected[number] = _lost(error, watch)
        attempts = []
        for future in _finished(pending):
            number, attempt = pending.pop(future)
            try:
                outcome = future.result()
            # a run tells its own failures: what is raised here concerns the worker, in the words of its executor
            except Exception as error:
                if attempt < _ATTEMPTS:
                    attempts.append((number, attempt + 1))
                    continue
                outcome = _lost(error, watch)
            if not outcome.error and not _appears(Path(runs[number].folder)):
                outcome = outcome._replace(
                    error=f"the worker has not written into {runs[number].folder}; workers on other machines need a folder "
                    "that all of them share"
                )
            collected[number] = outcome
            watch.count(outcome)
        watch.show()


def _finished(pending: dict[Future[Outcome], tuple[int, int]]) -> list[Future[Outcome]]:
    """The futures that are finished, in the order of their runs; none if that takes longer than the progress is shown.

    Ctrl-C is postponed within Python's own waits (`scan3d.cli.interruptions`), and not while this function sleeps.
    """
    end = time.monotonic() + _SHOWN_EVERY_S
    while not (done := [future for future in pending if future.done()]) and time.monotonic() < end:
        time.sleep(_LOOK_EVERY_S)
    return sorted(done, key=pending.__getitem__)


def _lost(error: Exception, watch: _Watch) -> Outcome:
    reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    if isinstance(error, BrokenExecutor):
        reason = "the operating system may have ended it for lack of memory"
    return Outcome(f"its worker was lost {_ATTEMPTS} times ({' '.join(reason.split())})", watch.seconds())


def _appears(folder: Path) -> bool:
    """Whether the results are in a folder, or appear there soon."""
    end = time.monotonic() + _PATIENCE_S
    while not (folder / REPORT).exists():
        if time.monotonic() > end:
            return False
        time.sleep(0.1)
    return True


def _tidy(runs: Iterable[Run]) -> None:
    """Remove what runs that were ended have left behind."""
    for run in runs:
        folder = Path(run.folder)
        if folder.is_dir():
            with suppress(OSError, InputError):
                clean(folder)
            with suppress(OSError):  # it holds earlier results
                folder.rmdir()


class _Watch:
    """Counts runs, and estimates the time that is left."""

    def __init__(self, number: int, total: int, report: Report) -> None:
        self._number, self._total, self._report = number, total, report
        self._finished = self._failed = 0
        self._start = time.monotonic()
        self.show()

    def seconds(self) -> float:
        return round(time.monotonic() - self._start, 3)

    def count(self, outcome: Outcome) -> None:
        self._finished += 1
        self._failed += bool(outcome.error)
        self.show()

    def show(self) -> None:
        left = self._number - self._finished
        seconds = self.seconds() / self._finished * left if self._finished else None
        self._report(BatchProgress(self._total - left, self._total, self._failed, seconds))
