"""Work spread over processes, of which any may die without harm to the rest.

``concurrent.futures`` gives up all work in hand when one process dies and does not tell whose fault
it was; here a death (out of memory, a crash in compiled code) costs the one item it was busy with.
Processes, because GTSAM's solver holds Python's global lock.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import traceback
from collections import Counter, deque
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING, Any, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Sequence
    from multiprocessing.context import SpawnProcess

Item = TypeVar("Item")
Result = TypeVar("Result")

THREAD_LIMITS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that limit the threads of linear algebra, read when NumPy is loaded."""


@dataclass(frozen=True)
class Lost:
    """Why an item has no result.

    Parameters
    ----------
    reason
        In one line.
    details
        Traceback of an unexpected exception, or nothing.
    died
        Whether its process ended, so that another attempt may succeed.
    """

    reason: str
    details: str = ""
    died: bool = field(default=False, compare=False)


@dataclass(eq=False)
class _Worker(Generic[Item]):
    process: SpawnProcess
    pipe: Connection[Any, Any]
    index: int


def run_isolated(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    *,
    workers: int,
    attempts: int = 1,
) -> Generator[tuple[int, Result | Lost], None, None]:
    """Yield index and result of each item as they are done, in whatever order.

    When the iteration is left early (Ctrl-C included) the processes are ended.

    Parameters
    ----------
    function
        Importable from a module, for it is called in fresh processes.
    items
        Its arguments, picklable.
    workers
        How many processes at most.
    attempts
        How often an item is begun at most whose process died.
    """
    waiting = deque(range(len(items)))
    died: Counter[int] = Counter()
    busy: list[_Worker[Item]] = []
    try:
        with _one_thread_each():
            while waiting and len(busy) < workers:
                busy.append(_start(function, items, waiting.popleft()))
        while busy:
            ready = wait([worker.pipe for worker in busy])
            for worker in [worker for worker in busy if worker.pipe in ready]:
                index, result = worker.index, _receive(worker)
                busy.remove(worker)
                died[index] += isinstance(result, Lost) and result.died
                again = 0 < died[index] < attempts
                if again:
                    waiting.append(index)
                if waiting:
                    busy.append(_next(worker, function, items, waiting.popleft()))
                else:
                    worker.pipe.close()
                if not again:
                    yield index, result
    finally:
        for worker in busy:
            worker.process.kill()
            worker.process.join()


def attempt(function: Callable[[Item], Result], item: Item) -> Result | Lost:
    """Return what a function gives for an item, or why it gives nothing."""
    try:
        return function(item)
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        return Lost(f"internal error, {reason}", traceback.format_exc())


def _start(function: Callable[[Item], Result], items: Sequence[Item], index: int) -> _Worker[Item]:
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(function, there), daemon=True)
    process.start()
    there.close()
    here.send(items[index])
    return _Worker(process, here, index)


def _next(
    worker: _Worker[Item],
    function: Callable[[Item], Result],
    items: Sequence[Item],
    index: int,
) -> _Worker[Item]:
    """Give a worker its next item, or the item to a new worker if it died."""
    try:
        worker.pipe.send(items[index])
    except OSError:
        with _one_thread_each():
            return _start(function, items, index)
    return _Worker(worker.process, worker.pipe, index)


def _receive(worker: _Worker[Item]) -> Any:
    try:
        return worker.pipe.recv()
    except (EOFError, OSError):
        worker.pipe.close()
        worker.process.join()
        return Lost(_cause(worker.process.exitcode), died=True)


def _cause(exitcode: int | None) -> str:
    if exitcode is None or exitcode >= 0:
        return f"its process ended early (exit status {exitcode})"
    name = signal.Signals(-exitcode).name
    hint = ", perhaps for lack of memory" if name == "SIGKILL" else ""
    return f"its process was ended by {name}{hint}"


def _serve(function: Callable[[Item], Result], pipe: Connection[Any, Any]) -> None:
    # Ctrl-C reaches the whole group of processes; the parent alone decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        try:
            item = pipe.recv()
        except (EOFError, OSError):
            return
        result = attempt(function, item)
        try:
            pipe.send(result)
        except OSError:
            return


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Keep processes that fill all cores from starting threads for all cores each."""
    unset = [name for name in THREAD_LIMITS if name not in os.environ]
    os.environ.update(dict.fromkeys(unset, "1"))
    try:
        yield
    finally:
        for name in unset:
            os.environ.pop(name, None)
