"""One run of a feed: journal, engine, output, and what becomes of rows that fail."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from geograph.errors import GeographError, InputError, told
from geograph.feed.intake import Batch
from geograph.feed.output import estimate_line

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from geograph.feed.assemble import Assembler
    from geograph.feed.engine import Engine, Estimate
    from geograph.feed.journal import Journal, Resumed
    from geograph.feed.output import Output
    from geograph.feed.rows import Line, Row


@dataclass
class Counts:
    """What became of the rows.

    Attributes
    ----------
    updates
        Updates, those repeated from a journal among them.
    used
        Rows that the engine took.
    left_out
        Lines and rows that could not be used, each of which was reported.
    known
        Rows passed over because the journal had them.
    """

    updates: int = 0
    used: int = 0
    left_out: int = 0
    known: int = 0


@dataclass(eq=False)
class Session:
    """Takes batches of rows, one after the other.

    Parameters
    ----------
    engine
        Its state is that of all batches so far.
    assembler
        Makes tables of rows.
    output
        Where lines go.
    report
        Called once for each row that cannot be used, with what is wrong.
    journal
        Where rows go before they are used.
    watch
        Called after every update, with the estimate.
    """

    engine: Engine
    assembler: Assembler
    output: Output
    report: Callable[[str], None]
    journal: Journal | None = None
    watch: Callable[[Estimate], None] | None = None
    counts: Counts = field(default_factory=Counts)
    _rejected: frozenset[str] = frozenset()

    def resume(self, resumed: Resumed) -> None:
        """Make the updates of a journal again; what failed then fails again, without a report."""
        for number, batch in enumerate(resumed.batches, start=1):
            estimate = self._update(batch.rows, quiet=True)
            self.counts.updates = number
            self._rejected = _names(estimate.rejected)
            last = number == len(resumed.batches)
            self.output.resume(estimate_line(estimate, update=number), number, last=last)
            if self.watch is not None:
                self.watch(estimate)

    def take(self, batch: Batch) -> Estimate | None:
        """Check, journal and use rows, and put out the estimate; None: there was nothing to use.

        Raises
        ------
        OSError
            If the journal or the output cannot be written.
        """
        rows, _, errors = self.assembler.check(batch.rows)
        for error in errors:
            self.leave_out(error)
        if not rows:
            return None
        if self.journal is not None:
            self.journal.append(Batch(rows, batch.last))
        estimate = self._update(rows, quiet=False)
        self.counts.updates += 1
        self._put_out(estimate, final=False)
        return estimate

    def finish(self) -> Estimate:
        """Use what still waits in the engine, and put out the last estimate."""
        try:
            estimate = self.engine.finish()
        except GeographError as error:
            self.report(f"the last look at what waited failed: {error}")
            estimate = self.engine.estimate
        if self.counts.updates:
            self._put_out(estimate, final=True)
        return estimate

    def leave_out(self, error: InputError) -> None:
        """Report a line or a row that cannot be used."""
        self.counts.left_out += 1
        self.report(f"{error}; this line is left out")

    def _put_out(self, estimate: Estimate, *, final: bool) -> None:
        line = estimate_line(estimate, update=self.counts.updates, final=final)
        self.output.write(line, self.counts.updates, final=final)
        if not final:
            for name in estimate.late:
                self.report(f"{name}: came later than the lag allows and is not used")
        rejected = _names(estimate.rejected)
        for name in sorted(rejected - self._rejected):
            self.report(f"{name}: does not fit what came after it and is not used")
        self._rejected = rejected
        if self.watch is not None:
            self.watch(estimate)

    def _update(self, rows: Sequence[Row], *, quiet: bool) -> Estimate:
        """Use rows; where the engine raises, use all but those that it raises for.

        A failed update leaves the engine as it was. So halves are tried, and halves of these, until
        the rows that fail stand alone.
        """
        try:
            estimate = self.engine.update(self.assembler.tables(rows))
        except Exception as error:
            if len(rows) > 1:
                middle = len(rows) // 2
                self._update(rows[:middle], quiet=quiet)
                return self._update(rows[middle:], quiet=quiet)
            if not quiet:
                self.leave_out(_at(rows[0], error))
            return self.engine.estimate
        self.counts.used += len(rows)
        return estimate


def _names(rows: Sequence[object]) -> frozenset[str]:
    return frozenset(str(row) for row in rows)


def _at(row: Row, error: Exception) -> InputError:
    """Return what is wrong with a row that the engine raised for."""
    if isinstance(error, InputError):
        reason, column = error.reason, error.column
    else:
        known = isinstance(error, GeographError)
        reason = str(error) if known else told(error)
        column = None
    return InputError(reason, path=row.place, line=row.line, column=column)


class Known:
    """Tells which rows of a feed the journal has already.

    Parameters
    ----------
    resumed
        What the journal held.
    numbered
        Whether lines keep their numbers (a file, a recording): then what was read is passed over by
        number, and the journal's rows must be those of the file. Otherwise, a pipe or a connection,
        a row is known if the journal has one that says the same.
    counts
        Where known rows are counted.
    """

    def __init__(self, resumed: Resumed, *, numbered: bool, counts: Counts) -> None:
        self._numbered = numbered
        self._last = resumed.last
        self._counts = counts
        rows = resumed.rows()
        self._keys = set() if numbered else {row.key for row in rows}
        self._rows = {row.number: row.key for row in rows} if numbered else {}

    def __call__(self, item: Line | Row) -> bool:
        """Tell whether a line, or the row made of it, is to be passed over.

        Raises
        ------
        InputError
            If a line of a file is another than the journal has.
        """
        from geograph.feed.rows import Row

        if not self._numbered:
            if not isinstance(item, Row) or item.key not in self._keys:
                return False
        elif item.number > self._last:
            return False
        elif item.number in self._rows:
            if not isinstance(item, Row):
                return False
            if item.key != self._rows[item.number]:
                raise InputError(
                    "is not what the journal has of that line; expected the file that the journal "
                    "was begun with; begin another journal",
                    path=item.place,
                    line=item.line,
                )
        self._counts.known += isinstance(item, Row)
        return True
