"""Many photographs of as many materials: what they share is made once, each gets a folder, and a bad one stops none."""

import argparse
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from torchbrdf.command_line import BAD_INPUT, RESUMABLE, fail, in_words
from torchbrdf.commands._findings import Findings
from torchbrdf.commands._finished import lock_of, origin, record, said_before
from torchbrdf.commands._lit_sight import Inputs, LitSight, lit_sight
from torchbrdf.commands._photographs import Photograph
from torchbrdf.commands._reconstruction import Fit, Setting, notes, summary, weights_record
from torchbrdf.commands._results import (
    check_inputs_stay,
    failure,
    obsolete,
    products,
    say_doubts_of,
    write_table,
    write_views,
    written,
)
from torchbrdf.commands._said import Said, in_record, said_of, say
from torchbrdf.commands._weights import WEIGHTS, write_weights
from torchbrdf.files import writing_folder
from torchbrdf.images import read_mask
from torchbrdf.progress import progress_bar
from torchbrdf.report import Grade

_TOGETHER = 8
"""Tables that are combined in one pass over the library, and as many that wait to be written: 35 MB each."""

_ANEW = "interrupted; the same command begins anew, without --overwrite it goes on where it stopped"


@dataclass(frozen=True, eq=False)
class _Seen:
    """A photograph that was read, what its results will be made from, and what was said of it so far."""

    photograph: Photograph
    lit: LitSight
    made_from: dict[str, Any]
    said: list[Said]


def fit_each(options: argparse.Namespace, photographs: Sequence[Photograph], findings: Findings) -> int:
    """Explain every photograph, into `options.output`/NAME; returns the exit status.

    What is finished is left as it is, and its warnings are said again. Raises what is wrong with what they share.
    """
    if options.mask is not None:
        read_mask(options.mask)
    check_inputs_stay(options, [options.output / one.name for one in photographs])
    inputs = Inputs(options)
    if len({one.probe for one in photographs}) == 1:
        inputs.probe(photographs[0].probe)
    with progress_bar(total=len(photographs), desc="photographs") as bar:
        writer = _Writer()
        batch = _Batch(options, inputs, writer, bar.update, findings)
        try:
            with writer:
                batch.run(photographs)
        except KeyboardInterrupt as error:
            raise KeyboardInterrupt(str(error) or (_ANEW if options.overwrite else RESUMABLE)) from None
        finally:
            findings.add(photographs=[batch.told[one] for one in photographs if one in batch.told])
    for text in batch.failures.values():
        fail("torchbrdf", text)
    known, failed = len(batch.known), len(batch.failures)
    done = len(photographs) - known - failed
    parts = [f"wrote {done} of {len(photographs)} materials to {options.output}/NAME"]
    parts += [f"{known} were finished before (--overwrite makes them anew)"] if known else []
    if failed:
        parts.append(f"{failed} failed: {', '.join(one.name for one in batch.failures)}")
        findings.failed(parts[-1])
    findings.line("; ".join(parts))
    return BAD_INPUT if failed else 0


class _Batch:
    """The photographs of one command.

    failures  why a photograph has no results
    known     those that were finished before
    told      what a script is told of each that is done with
    """

    def __init__(
        self,
        options: argparse.Namespace,
        inputs: Inputs,
        writer: "_Writer",
        advance: Callable[[], object],
        findings: Findings,
    ) -> None:
        self._options, self._inputs, self._writer, self._advance = options, inputs, writer, advance
        self._findings = findings
        self._together = _TOGETHER if options.no_report and not options.align else 1
        self.failures: dict[Photograph, str] = {}
        self.known: list[Photograph] = []
        self.told: dict[Photograph, dict[str, Any]] = {}

    def run(self, photographs: Sequence[Photograph]) -> None:
        """Explain and write all that are not finished."""
        library = self._inputs.library.source  # opened before any: that it cannot be is not a photograph's fault
        seen: list[_Seen] = []
        for one in photographs:
            with self._failing(one):
                own = one.its(self._options)
                made_from = origin(own, library)
                if self._is_finished(one, made_from):
                    continue
                said: list[Said] = []
                with said_of(one.path, said):
                    lit = lit_sight(own, self._inputs)
                seen.append(_Seen(one, lit, made_from, said))
            if len(seen) == self._together:
                self._explain(seen)
                seen = []
        self._explain(seen)

    def _is_finished(self, one: Photograph, made_from: dict[str, Any]) -> bool:
        said = None if self._options.overwrite else said_before(self._options.output / one.name, made_from)
        if said is None:
            return False
        say(said)
        self.known.append(one)
        self._done_with(one, said)
        return True

    def _done_with(
        self, one: Photograph, said: Sequence[Said], fitted: Fit | None = None, grade: Grade | None = None
    ) -> None:
        """Results are there: tell of them."""
        folder, files = self._options.output / one.name, products(self._options)
        if self._options.json:
            self.told[one] = written(one.path, folder, files, in_record(said), fitted, grade=grade)
        if fitted is not None:
            self._findings.add_files(*(folder / file for file in files))
        self._advance()

    def _explain(self, seen: Sequence[_Seen]) -> None:
        """Solve photographs, make their tables in one pass, and have them written."""
        groups: dict[tuple[str, str], list[_Seen]] = {}
        for one in seen:
            groups.setdefault((one.lit.probe.fingerprint, one.lit.view.fingerprint), []).append(one)
        solved = [pair for group in groups.values() for pair in self._solved(group)]
        if self._options.no_report and solved:
            self._writer.settle()
            fits = self._inputs.estimates.combined([fitted for _, fitted in solved])
            solved = [(one, fitted) for (one, _), fitted in zip(solved, fits, strict=True)]
        for one, fitted in solved:
            self._finish(one, fitted)

    def _solved(self, group: Sequence[_Seen]) -> list[tuple[_Seen, Fit]]:
        """Photographs of one light and view."""
        lit, estimates = group[0].lit, self._inputs.estimates
        setting: Setting | None = None
        try:
            setting = estimates.setting(lit.probe, lit.view, lit.basis)
            return list(zip(group, estimates.fits([one.lit.observation for one in group], setting), strict=True))
        except ValueError:
            if len(group) > 1:
                return [pair for one in group for pair in self._solved([one])]
            with self._failing(group[0].photograph):
                raise
        return []

    def _finish(self, one: _Seen, fitted: Fit) -> None:
        def done(grade: Grade | None = None) -> None:
            judged = "" if grade is None else f"; {grade}"
            self._findings.line(f"{one.photograph.name}: {summary(fitted)}{judged}")
            self._findings.notes.extend(f"{one.photograph.path}: {note}" for note in notes(fitted))
            self._done_with(one.photograph, one.said, fitted, grade)

        if self._options.no_report:
            with said_of(one.photograph.path, one.said):
                say_doubts_of(fitted)
            self._writer.submit(lambda: self._write(one, fitted, nullcontext()), done)
        else:
            done(self._write(one, fitted, said_of(one.photograph.path, one.said)))

    def _write(self, one: _Seen, fitted: Fit, listening: AbstractContextManager[None]) -> Grade | None:
        options = one.photograph.its(self._options)
        folder = options.output / one.photograph.name
        with writing_folder(folder, WEIGHTS, obsolete(folder), lock_of(options.output)) as temporary:
            write_table(temporary, fitted, options.uncertainty)
            with listening:
                grade = write_views(temporary, one.lit, fitted, options)
            made = {"primaries": options.primaries} | record(one.made_from, temporary, one.said)
            write_weights(temporary, weights_record(fitted) | made)
        return grade

    @contextmanager
    def _failing(self, photograph: Photograph) -> Iterator[None]:
        """What is wrong with a photograph stops no other."""
        try:
            yield
        except (ValueError, OSError) as error:
            self.failures[photograph] = Said(in_words(error)).about(photograph.path).text
            self.told[photograph] = failure(photograph.path, self.failures[photograph])
            self._advance()


class _Writer:
    """A thread that writes while photographs are read and solved; what it began, it ends, also where that is not."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1)
        self._due: deque[tuple[Future[object], Callable[[], None]]] = deque()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, _: BaseException | None, __: TracebackType | None) -> None:
        try:
            if kind is None:
                self.settle()
        finally:
            self._pool.shutdown(cancel_futures=True)

    def submit(self, write: Callable[[], object], done: Callable[[], None]) -> None:
        """Have something written, and `done` called after that by `settle`."""
        self._due.append((self._pool.submit(write), done))

    def settle(self) -> None:
        """Wait for all that is to be written; raises what went wrong."""
        while self._due:
            future, done = self._due.popleft()
            future.result()
            done()
